"""Instances that break solvers: what users do, and what data do to them.

Each takes a standard instance, such as the simulated Panda with a minimum thickness, and changes one
thing.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet
from sdp_vs_penalty.shootout.instance import Instance, in_units
from sdp_vs_penalty.solvers.objective import Objective

Change = Callable[[Instance], Instance]


def _with_data(instance: Instance, data: LeastSquares) -> Instance:
    return replace(instance, task=replace(instance.task, data=data), objective=Objective(data))


def _with_constraints(instance: Instance, convex: tuple[Constraint, ...]) -> Instance:
    return replace(instance, task=replace(instance.task, constraints=ConstraintSet(convex)))


def posed_as(formulation: str, mass: float = 1.0, length: float = 1.0) -> Change:
    """In units of ``mass`` kg and ``length`` m, in one of the formulations of an instance."""
    return lambda made: replace(in_units(made, mass, length), formulation=formulation)


def unidentifiable(made: Instance) -> Instance:
    """No bounds on size: the set of optima is unbounded; the certificate holds within |theta| <= B."""
    open_families = ("trace", "range", "bounding ellipsoid", "total mass", "minimum thickness")
    kept = [c for c in made.constraints.convex if c.family not in open_families]
    kept = [
        build.linear("mass", c.name, c.indices, [[1.0]], [0.0]) if c.family == "mass" else c
        for c in kept
    ]
    wide = _with_constraints(made, tuple(kept))
    return replace(wide, task=replace(wide.task, bound=1e3 * made.task.bound))


def rank_deficient(made: Instance) -> Instance:
    """Some twenty rows of the factor: far fewer directions than parameters are seen."""
    data, step = made.data, max(1, len(made.data.R) // 20)
    few = replace(data, R=data.R[::step], rho=data.rho[::step])
    return _with_data(made, few)


def noise_free(made: Instance) -> Instance:
    """Torque of the nominal robot, exactly: the optimum is zero."""
    rho = made.data.R @ made.task.nominal
    return _with_data(made, LeastSquares(made.data.R, rho, 0.0, float(rho @ rho), made.data.rows))


def total_mass_at_least(shift: float) -> Change:
    """The lower bound on the total mass ``shift`` (relative) above what the links may weigh together."""

    def change(made: Instance) -> Instance:
        rows = [(c.constant, c.coefficients[0]) for c in made.constraints.convex if c.family == "mass"]
        upper = sum(float(min(-c0[c1 < 0] / c1[c1 < 0])) for c0, c1 in rows)
        masses = made.task.links[:, 0]
        least = (1.0 + shift) * upper
        demand = build.linear("total mass", "robot", masses, np.ones((len(masses), 1)), [-least])
        kept = [c for c in made.constraints.convex if c.family != "total mass"]
        return _with_constraints(made, (*kept, demand))

    return change


def thick_beyond_bounds(made: Instance) -> Instance:
    """Radii of gyration that the bounds on the moments exclude."""
    kept = [c for c in made.constraints.convex if c.family != "minimum thickness"]
    return _with_constraints(made, (*kept, *made.task.minimum_thickness(3.0)))


def float32_data(made: Instance) -> Instance:
    """The factor in single precision; what is solved and certified is the problem that this leaves."""
    data = made.data
    R, rho = (x.astype(np.float32).astype(float) for x in (data.R, data.rho))
    return _with_data(made, replace(data, R=R, rho=rho))


#: One thing that users do, or data do to them, and how it is told in the library; the last one is not in
#: it: its file would have other numbers than its proof.
CHANGES: dict[str, tuple[Change, str]] = {
    "gram kg m": (posed_as("gram"), "as the bare quadratic form of the Gram matrix"),
    "gram g mm": (posed_as("gram", 1e-3, 1e-3), "as the bare quadratic form, in grams and millimetres"),
    "gram t km": (posed_as("gram", 1e3, 1e3), "as the bare quadratic form, in tons and kilometres"),
    "units g mm": (posed_as("residual", 1e-3, 1e-3), "in grams and millimetres"),
    "units t km": (posed_as("residual", 1e3, 1e3), "in tons and kilometres"),
    "no scaling": (posed_as("rows"), "without a centre and without scales"),
    "unidentifiable links": (unidentifiable, "without bounds on size: the optima are unbounded"),
    "rank-deficient": (rank_deficient, "from twenty rows only"),
    "noise-free": (noise_free, "of exact torques: the optimum is zero"),
    "nearly infeasible 1e-3": (
        total_mass_at_least(-1e-3),
        "with masses within 0.1 % of the most that their bounds allow",
    ),
    "nearly infeasible 1e-6": (
        total_mass_at_least(-1e-6),
        "with masses within a millionth of the most that their bounds allow",
    ),
    "infeasible 1e-3": (total_mass_at_least(1e-3), "with 0.1 % more mass than the bounds allow"),
    "infeasible 1e-6": (total_mass_at_least(1e-6), "with a millionth more mass than the bounds allow"),
    "infeasible thickness": (thick_beyond_bounds, "with links thicker than their bounds allow"),
    "float32 data": (float32_data, "from data rounded to single precision"),
    "float32 gram": (posed_as("gram in float32"), ""),
}
