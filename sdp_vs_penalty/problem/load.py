"""A problem from its name, its folder or a URDF file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.texts import numbers, pairs
from sdp_vs_penalty.errors import InputError, given
from sdp_vs_penalty.files import problems_folder
from sdp_vs_penalty.problem.bodies import link_bodies
from sdp_vs_penalty.problem.folder import load_folder
from sdp_vs_penalty.problem.names import entries
from sdp_vs_penalty.problem.nominal import plausible_links
from sdp_vs_penalty.problem.problem import DEFAULT_LINK_MASS, Problem, default_mass
from sdp_vs_penalty.robot.geometry import link_geometry
from sdp_vs_penalty.robot.urdf import load_urdf


def problem_names() -> list[str]:
    return sorted(p.parent.name for p in problems_folder().glob("*/problem.toml"))


def as_problem(source: str | Path | Problem, what: str = "problem") -> Problem:
    """A Problem as it is, or that of a built-in name, a folder or a URDF file.

    what : how messages call it, such as "identify(problem=...)". Raises InputError as
    :func:`load_problem` does, and naming what was given where it is none of these.
    """
    if isinstance(source, Problem):
        return source
    if isinstance(source, str | Path):
        return load_problem(source)
    raise InputError(
        "no problem",
        f"give a built-in name ({', '.join(problem_names())}), a folder with a problem.toml, a "
        "URDF file, or a Problem",
        what.replace("...", given(source)),
    )


def load_problem(source: str | Path, gravity: Sequence[float] | None = None) -> Problem:
    """The problem of ``source``: a built-in name, a folder with a problem.toml, or a URDF file.

    gravity : the gravity vector in the base frame [m/s^2], for a robot mounted otherwise.
    Raises InputError where there is no such problem, or its files contradict themselves.
    """
    path = Path(source)
    if str(source) in problem_names():
        problem = load_folder(problems_folder() / str(source))
    elif (path / "problem.toml").is_file():
        problem = load_folder(path)
    elif path.is_file():
        problem = _from_urdf(path)
    else:
        raise InputError(
            f"problem {str(source)!r} does not exist",
            f"name a folder with a problem.toml, a URDF file, or one of {', '.join(problem_names())}",
        )
    if gravity is not None:
        if len(gravity) != 3 or not np.all(np.isfinite(gravity)):
            raise InputError(f"gravity {gravity!r} is not three finite numbers", "write x,y,z in m/s^2")
        problem = problem.with_gravity(gravity)
    return problem


def with_filters(problem: Problem, cutoffs: str | None) -> Problem:
    """The same with other cut-offs [Hz] of the filters, "states,torque"; as it is for None."""
    if cutoffs is None:
        return problem
    state, torque = numbers("--filters", cutoffs, 2)
    settings = replace(problem.preprocessing, state_cutoff=state, torque_cutoff=torque)
    return replace(problem, preprocessing=settings)


def with_bounds(problem: Problem, text: str | None) -> Problem:
    """The same with other bounds, "m2=1:5,c2x=-0.1:,total=:20" [kg, m, kg m^2]; as it is for None.

    The names are those of a ``bounds.csv``, and ``total``; an end that is left out is none (a mass has
    zero). A nominal link outside of its new mass is scaled to the nearer end. Raises InputError for
    another text, a name of no link, or ends that are swapped.
    """
    if text is None:
        return problem
    places, box, links = entries(problem.robot.links), problem.box.copy(), problem.nominal_links.copy()
    total = problem.total_mass
    for name, ends in (pairs("--bounds", text) or {}).items():
        low, _, high = ends.partition(":")
        mass = name.startswith(("m", "total"))
        try:
            new = float(low or (0.0 if mass else -np.inf)), float(high or np.inf)
            if name == "total":
                total = new
            else:
                box[places[name]] = new
        except (ValueError, KeyError):
            raise InputError(
                f"--bounds {name}={ends}",
                "write NAME=LOWER:UPPER, of m1, c1x, I1xx, total",
            ) from None
    now = links[:, 0]
    links *= (np.clip(now, *box[:, 0].T) / np.where(now > 0.0, now, 1.0))[:, None]
    return replace(problem, box=box, total_mass=total, nominal_links=links)


def _from_urdf(path: Path) -> Problem:
    robot, given_links = load_urdf(path)
    box = np.full((robot.links, 10, 2), (-np.inf, np.inf))
    box[:, 0] = [(DEFAULT_LINK_MASS[0], default_mass(mass)) for mass in given_links[:, 0]]
    bodies = link_bodies(robot, box[:, 1:4], given_links, link_geometry(path))
    nominal, sources = plausible_links(robot, given_links, bodies)
    title = f"{robot.name} from {path.name}"
    return Problem(robot.name, title, robot, box, nominal, bodies=bodies, nominal_from=sources)
