"""Estimators, one file a family."""

from dataclasses import replace
from typing import Any

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import Estimator
from sdp_vs_penalty.plugins import Registry, lazy_exports
from sdp_vs_penalty.solvers import make_solver

DEFAULT_METHOD = "lmi-sdp"


ESTIMATORS = Registry[type[Estimator]]("method", __name__, Estimator)
estimator_types = ESTIMATORS.all


def make_estimator(method: str | Estimator) -> Estimator:
    """Return the estimator with a name, with its default settings.

    Parameters
    ----------
    method : str or Estimator
        Name of a method, or an estimator, which is returned as it is.

    Returns
    -------
    Estimator
        Raises InputError for an unknown name.
    """
    if isinstance(method, Estimator):
        return method
    return ESTIMATORS.get(method)()


def with_solver(method: str, solver_name: str | None) -> Estimator | str:
    """Return a method with another solver.

    Parameters
    ----------
    solver_name : str or None
        Name of a solver; None: the method's own.

    Returns
    -------
    Estimator or str
        Raises InputError if the method solves no SDP.
    """
    if solver_name is None:
        return method
    estimator: Any = make_estimator(method)
    if not hasattr(estimator, "solver"):
        raise InputError(
            f"--solver {solver_name}: method {method} solves no SDP",
            "leave --solver out",
        )
    make_solver(solver_name)
    return replace(estimator, solver=solver_name)


__getattr__ = lazy_exports(
    __name__,
    estimator="Fit joint_weights make_task Task",
    lmi_sdp="interior_point LmiSdp LmiSdpThickness LmiSdpTwoStep PosedSdp",
    penalty_paper="PenalisedLoss PenaltyPaper",
    ols="condition_number",
    penalty="Penalty PenaltyTwoStep ShiftedPenalty",
)
