"""Conic solvers, one small file each: a subclass of :class:`~solvers.solver.Solver`
registers it."""

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.plugins import Registry, lazy_exports
from sdp_vs_penalty.solvers.solver import Solver

SOLVERS = Registry[type[Solver]]("solver", __name__, Solver)
#: Every solver class by name, installed or not.
solver_types = SOLVERS.all


def make_solver(name: str) -> Solver:
    """Return the solver with a name.

    Parameters
    ----------
    name : str
        A name that `sdp-vs-penalty list solvers` prints.

    Raises
    ------
    InputError
        For an unknown or missing solver, with what installs it.
    """
    chosen = SOLVERS.get(name)()
    if chosen.absent:
        raise InputError(f"solver {name} cannot be used here", chosen.absent)
    return chosen


__getattr__ = lazy_exports(
    __name__,
    conic="Cone ConicProblem Solution",
    convex_problem="ConvexProblem Entropy",
    identification="conic_problem least_squares_sdp scaled SdpProblem",
    fit="repair",
    clarabel="Clarabel",
    extremes="Slice",
    proof="optimum_proof",
    rewrite="reorder",
    rigorous_bounds="certainly_feasible",
    through_cvxpy="ThroughCvxpy",
)
