"""Conic solvers, one small file each: a subclass of :class:`~solvers.solver.Solver`
registers it."""

from functools import cache

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.plugins import classes, lazy_exports, load_class
from sdp_vs_penalty.solvers.solver import Solver


@cache
def solver_types() -> dict[str, type[Solver]]:
    """Return every solver class of this folder by name, installed or not."""
    return classes(__name__, __path__, Solver)


def solver(name: str) -> Solver:
    """Return the solver with a name.

    Parameters
    ----------
    name : str
        A name that `sdp-vs-penalty list solvers` prints.

    Returns
    -------
    Solver
        An installed solver.

    Raises
    ------
    InputError
        For an unknown or missing solver, with what installs it.
    """
    chosen: Solver = load_class(
        "solver", __name__, __path__, Solver, name, solver_types
    )()
    if chosen.absent:
        raise InputError(f"solver {name} cannot be used here", chosen.absent)
    return chosen


__getattr__ = lazy_exports(
    __name__,
    conic="Cone ConicProblem Solution",
    objective="Entropy Objective",
    identification="conic_problem least_squares_sdp scaled SdpProblem",
    fit="repair",
    clarabel="Clarabel",
    extremes="Slice",
    proof="optimum_proof",
    rewrite="reorder",
    rigorous_bounds="certainly_feasible",
    through_cvxpy="ThroughCvxpy",
)
