"""Conic solvers, one small file each: a subclass of :class:`~solvers.solver.Solver`
registers it."""

from functools import cache
from importlib.metadata import entry_points

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.plugins import by_word, classes, lazy_exports, load_class
from sdp_vs_penalty.solvers.solver import Solver

#: Where a package of others names its subclasses of Solver, one an entry point.
ENTRY_POINTS = "sdp_vs_penalty.solvers"


@cache
def solver_types() -> dict[str, type[Solver]]:
    """Return every solver class by name, installed or not: of this folder, and of
    packages that name theirs as entry points of the group ENTRY_POINTS.

    Raises InputError for an entry point that does not name a Solver.
    """
    found = [(kind.name, kind) for kind in classes(__name__, __path__, Solver).values()]
    for point in entry_points(group=ENTRY_POINTS):
        try:
            kind = point.load()
        except Exception as error:
            what = f"entry point {point.name} = {point.value}: {error}"
            raise InputError(what, "repair or uninstall its package") from error
        if not (isinstance(kind, type) and issubclass(kind, Solver)):
            what = f"entry point {point.name} = {point.value} is no Solver"
            raise InputError(what, "repair or uninstall its package")
        found.append((kind.name, kind))
    return by_word(found)


def solver(name: str) -> Solver:
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
