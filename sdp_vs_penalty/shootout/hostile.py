"""Instances that break solvers: what users do, and what data do to them.

Each starts from the simulated Panda run with a minimum thickness and changes one thing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.constraints import constraint as build
from sdp_vs_penalty.constraints.constraint import Constraint, ConstraintSet
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.regression.regression import LeastSquares, triangular
from sdp_vs_penalty.shootout import regular
from sdp_vs_penalty.shootout.instance import Instance, in_units
from sdp_vs_penalty.signals.preprocessing import filtered_rows
from sdp_vs_penalty.simulation.experiment import experiment
from sdp_vs_penalty.solvers.objective import Objective


def _panda(name: str, shape: str = "gyration") -> Instance:
    made = regular.simulated(name, "hostile", "panda", "one-step", shape, 14.0)
    return replace(made, hostile=True)


def _with_data(instance: Instance, data: LeastSquares) -> Instance:
    return replace(instance, task=replace(instance.task, data=data), objective=Objective(data))


def _with_constraints(instance: Instance, convex: tuple[Constraint, ...]) -> Instance:
    return replace(instance, task=replace(instance.task, constraints=ConstraintSet(convex)))


def _units(mass: float, length: float) -> Callable[[str], Instance]:
    return lambda name: replace(in_units(_panda(name), mass, length), formulation="gram")


def _scaled_units(mass: float, length: float) -> Callable[[str], Instance]:
    return lambda name: in_units(_panda(name), mass, length)


def no_scaling(name: str) -> Instance:
    """Our residual form without a centre and without scales."""
    return replace(_panda(name), formulation="rows")


def unidentifiable(name: str) -> Instance:
    """No bounds on size: the set of optima is unbounded; the certificate holds within |theta| <= B."""
    made = _panda(name, "plain")
    open_families = ("trace", "range", "bounding ellipsoid", "total mass")
    kept = [c for c in made.constraints.convex if c.family not in open_families]
    kept = [
        build.linear("mass", c.name, c.indices, [[1.0]], [0.0]) if c.family == "mass" else c
        for c in kept
    ]
    wide = _with_constraints(made, tuple(kept))
    return replace(wide, task=replace(wide.task, bound=1e3 * made.task.bound))


def rank_deficient(name: str) -> Instance:
    """Half a second of motion: far fewer directions than parameters are seen."""
    made = regular.simulated(name, "hostile", "panda", "one-step", "gyration", 1.0)
    data = made.data
    keep = data.R[:: max(1, len(data.R) // 20)]
    few = LeastSquares(
        keep,
        data.rho[:: max(1, len(data.R) // 20)],
        data.residual_norm,
        data.tau_squared,
        data.rows,
    )
    return replace(_with_data(made, few), hostile=True)


def noise_free(name: str) -> Instance:
    """Torque of the nominal robot, exactly: the optimum is zero."""
    made = _panda(name)
    rho = made.data.R @ made.task.nominal
    return _with_data(made, LeastSquares(made.data.R, rho, 0.0, float(rho @ rho), made.data.rows))


def _total_mass_at_least(shift: float) -> Callable[[str], Instance]:
    """The lower bound on the total mass ``shift`` (relative) above what the links may weigh together."""

    def make(name: str) -> Instance:
        made = _panda(name)
        upper = 0.0
        for c in made.constraints.convex:
            if c.family == "mass":
                upper += min(
                    -float(c0 / c1)
                    for c0, c1 in zip(c.constant, c.coefficients[0], strict=True)
                    if c1 < 0
                )
        masses = made.task.links[:, 0]
        least = (1.0 + shift) * upper
        demand = build.linear("total mass", "robot", masses, np.ones((len(masses), 1)), [-least])
        kept = [c for c in made.constraints.convex if c.family != "total mass"]
        return _with_constraints(made, (*kept, demand))

    return make


def thick_beyond_bounds(name: str) -> Instance:
    """Radii of gyration that the bounds on the moments exclude."""
    made = _panda(name, "plain")
    demands = made.task.minimum_thickness(3.0)
    return _with_constraints(made, (*made.constraints.convex, *demands))


def float32_data(name: str) -> Instance:
    """The factor in single precision; what is solved and certified is the problem that this leaves."""
    made = _panda(name)
    data = made.data
    R, rho = (x.astype(np.float32).astype(float) for x in (data.R, data.rho))
    return _with_data(made, replace(data, R=R, rho=rho))


def float32_gram(name: str) -> Instance:
    return replace(_panda(name), formulation="gram in float32")


def raw_rows(name: str) -> Instance:
    """Every filtered row instead of the factor, as users pass them; the same optimum."""
    problem = load_problem("panda")
    described = experiment(problem)
    run: Measurements = described.training_run(seed=0).window(0.0, 14.0)
    model = problem.model(described.effects)
    settings = problem.preprocessing.resolve(run)
    p = len(model.parameters)
    stack = []
    for rows in filtered_rows(run, model, settings):
        for joint, columns in enumerate(rows.columns):
            wide = np.zeros((len(rows.torque), p + 1))
            wide[:, columns.indices] = columns.columns
            wide[:, p] = rows.torque[:, joint]
            stack.append(wide)
    raw = np.vstack(stack)
    triangle = triangular([raw])
    tau_squared = float(raw[:, p] @ raw[:, p])
    data = LeastSquares(
        np.ascontiguousarray(triangle[:p, :p]),
        triangle[:p, p].copy(),
        float(abs(triangle[p, p])),
        tau_squared,
        len(raw),
    )
    made = _with_data(_panda(name), data)
    uncompressed = LeastSquares(np.ascontiguousarray(raw[:, :p]), raw[:, p], 0.0, tau_squared, len(raw))
    return replace(made, formulation="rows", raw=uncompressed)


BUILDERS: dict[str, Callable[[str], Instance]] = {
    "hostile gram kg m": _units(1.0, 1.0),
    "hostile gram g mm": _units(1e-3, 1e-3),
    "hostile gram t km": _units(1e3, 1e3),
    "hostile units g mm": _scaled_units(1e-3, 1e-3),
    "hostile units t km": _scaled_units(1e3, 1e3),
    "hostile no scaling": no_scaling,
    "hostile unidentifiable links": unidentifiable,
    "hostile rank-deficient": rank_deficient,
    "hostile noise-free": noise_free,
    "hostile nearly infeasible 1e-3": _total_mass_at_least(-1e-3),
    "hostile nearly infeasible 1e-6": _total_mass_at_least(-1e-6),
    "hostile infeasible 1e-3": _total_mass_at_least(1e-3),
    "hostile infeasible 1e-6": _total_mass_at_least(1e-6),
    "hostile infeasible thickness": thick_beyond_bounds,
    "hostile float32 data": float32_data,
    "hostile float32 gram": float32_gram,
    "hostile raw rows": raw_rows,
}
QUICK = ("hostile gram g mm", "hostile float32 gram", "hostile infeasible 1e-3", "hostile noise-free")
