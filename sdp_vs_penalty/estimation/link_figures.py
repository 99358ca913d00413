"""What is certified of a model's links and parameters without the data."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.certificate import Certificate
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.solvers.rigorous_bounds import violations


def certified_content(problem: Problem, model: Model, theta: Array) -> str:
    """Return the hash of what a certificate certifies: values of named parameters
    within the bounds of a problem."""
    out = hashlib.sha256()
    for values in (theta, problem.box, np.array(problem.total_mass)):
        out.update(np.ascontiguousarray(values, float).tobytes())
    out.update("\n".join(p.name for p in model.parameters).encode())
    return out.hexdigest()


def certificate_without_data(
    problem: Problem, model: Model, theta: Array
) -> Certificate:
    """Certify parameters (p,) that no data gave: violations, and figures of the links;
    there is no loss and no optimum."""
    links = theta[model.rigid_indices].reshape(-1, 10)
    return Certificate(
        violations(problem.constraints(model), theta),
        certifies=certified_content(problem, model, theta),
        **link_figures(problem, links),
    )


def link_figures(problem: Problem, links: Array) -> dict[str, Any]:
    """Return the fields of a Certificate that describe the links.

    Parameters
    ----------
    problem : Problem
        Robot, and bodies of the links.
    links : (n, 10) array
        Standard parameters of the links.

    Returns
    -------
    dict
        Share of poses with M(q) > 0, smallest thickness [m], largest radius of gyration
        [m], its ratio to the body, density [kg/m^3]; empty for a model without links.
    """
    if not len(links):
        return {}
    gyration = inertia.gyration(links)
    bodies = problem.link_bodies
    # Consistent links make M(q) positive definite at every pose: no need to sample.
    is_consistent = consistent(links)
    pairs = zip(links[:, 0].tolist(), bodies, strict=True)
    densities = [mass / body.volume for mass, body in pairs if body.volume is not None]
    return {
        "positive_definite_share": (
            1.0 if is_consistent else positive_definite_share(problem.robot, links)
        ),
        "at_every_pose": is_consistent,
        "smallest_thickness": float(inertia.thickness(links).min()),
        "largest_gyration": float(gyration.max()),
        "body_share": float(np.max(gyration / [body.reach for body in bodies])),
        "density": [min(densities), max(densities)] if densities else None,
    }


def consistent(links: Array) -> bool:
    """Return whether the pseudo-inertia of every link is positive definite, beyond
    rounding.

    Then M(q) = sum J_i' I_i J_i is positive definite in every pose, since whatever
    moves a joint moves a link (Traversaro et al., IROS 2016).

    Parameters
    ----------
    links : (n, 10) array
        Standard parameters of the links.

    Returns
    -------
    bool
        True if all links are physically consistent.
    """
    eigenvalues = np.linalg.eigvalsh(inertia.pseudo_inertia(links))  # ascending
    rounding = 1e-12 * eigenvalues[:, -1]
    return bool(np.all(eigenvalues[:, 0] > rounding))


def positive_definite_share(robot: Robot, links: Array, poses: int = 10_000) -> float:
    """Return the share of random poses at which the inertia matrix M(q) is positive
    definite.

    Parameters
    ----------
    links : (links, 10) array
        Standard parameters of the links.

    Returns
    -------
    float
        Share from 0 to 1.
    """
    matrices = robot.mass_matrices(links, robot.random_configurations(poses, 0))
    return float(np.mean(np.linalg.eigvalsh(matrices)[:, 0] > 0.0))
