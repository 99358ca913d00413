"""An identification SDP as a file for any solver: sparse SDPA (.dat-s) or conic benchmark format (.cbf).

Both formats hold a linear objective; SDPA's holds matrix inequalities only. The problem is rewritten
exactly (:mod:`solvers.rewrite`) and read back by :func:`read_sdpa` and :func:`read_cbf`. Numbers are
written with 17 digits, so that nothing is lost.

Sources: the SDPA format as in Borchers, SDPLIB (Optim. Methods Softw. 1999); H. A. Friberg, CBF
format reference, version 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.solvers.cbf_file import cbf_text
from sdp_vs_penalty.solvers.conic import ConicProblem
from sdp_vs_penalty.solvers.identification import least_squares_sdp
from sdp_vs_penalty.solvers.rewrite import linear_matrix_inequalities, linear_objective
from sdp_vs_penalty.solvers.sdpa_file import sdpa_text


def export_sdp(problem: ConicProblem, path: str | Path) -> None:
    """Write the problem in the format of the file's ending, .dat-s or .cbf.

    Raises InputError for another ending, or where the format lacks one of the problem's cones.
    """
    name = Path(path).name
    if name.endswith(".dat-s"):
        if any(c.kind == "exp" for c in problem.cones):
            raise InputError(
                (
                    "the SDPA format has no exponential cone, which the entropic regulariser "
                    "needs; write a .cbf file instead, or name a method without one."
                ),
                where=path,
            )
        write_text(path, sdpa_text(linear_matrix_inequalities(problem).problem))
    elif name.endswith(".cbf"):
        write_text(path, cbf_text(linear_objective(problem).problem))
    else:
        raise InputError(
            "name the file .dat-s (sparse SDPA) or .cbf (conic benchmark format).", where=path
        )


def posed(
    problem: str, data: Sequence[Path], method: str = "lmi-sdp", effects: str | None = None
) -> ConicProblem:
    """The conic form of identifying a problem from measured runs, centred and scaled.

    Raises InputError where the method solves no one-step SDP, or the input cannot be used.
    """
    from sdp_vs_penalty.data.files import load_measurements
    from sdp_vs_penalty.estimators import make_estimator
    from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp, essential, interior_point
    from sdp_vs_penalty.estimators.task import make_task
    from sdp_vs_penalty.problem.load import load_problem
    from sdp_vs_penalty.regression.regression import compress

    estimator = make_estimator(method)
    if not isinstance(estimator, LmiSdp):
        raise InputError(
            f"method {method} is not a single SDP",
            "choose lmi-sdp, lmi-sdp-thickness, lmi-sdp-plain or lmi-sdp-entropic",
        )
    robot = load_problem(problem)
    names = [joint.name for joint in robot.robot.joints]
    measurements = load_measurements(*data, joints=robot.robot.n, names=names)
    model = robot.model(effects)
    regression = compress(measurements, model, robot.preprocessing.resolve(measurements))
    task = make_task(robot, model, regression)
    objective, constraints = estimator.posed(task)
    interior = interior_point(task, constraints)
    sent = essential(constraints, objective)
    least = 1e-6 * objective.least_squares.tau_squared
    return least_squares_sdp(objective, sent, interior, task.bound, interior, least_loss=least).conic
