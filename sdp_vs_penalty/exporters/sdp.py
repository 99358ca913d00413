"""An identification SDP as a file for any solver: sparse SDPA (.dat-s) or conic benchmark format (.cbf).

Both formats hold a linear objective; SDPA's holds matrix inequalities only. The problem is rewritten
exactly (:mod:`solvers.rewrite`), numbers have 17 digits, so that nothing is lost. Neither format has a
place for a constant: FILE.json beside the file says how its optimum becomes the loss of identification,
and between which proved bounds that lies.

Sources: the SDPA format as in Borchers, SDPLIB (Optim. Methods Softw. 1999); H. A. Friberg, CBF
format reference, version 3.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sdp_vs_penalty.constraints.constraint import ConstraintSet
from sdp_vs_penalty.data.sources import Source, as_measurements
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp, essential, interior_point, solve_sdp
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.solvers.cbf_file import cbf_text
from sdp_vs_penalty.solvers.conic import ConicProblem
from sdp_vs_penalty.solvers.identification import SdpProblem, least_squares_sdp
from sdp_vs_penalty.solvers.objective import Objective
from sdp_vs_penalty.solvers.proof import Proof, optimum_proof
from sdp_vs_penalty.solvers.rewrite import Rewritten, linear_matrix_inequalities, linear_objective
from sdp_vs_penalty.solvers.sdpa_file import sdpa_text
from sdp_vs_penalty.solvers.verified import repaired_as_written

#: What the file beside an exported problem says of its numbers.
MEANING = (
    "loss = offset + scale * (optimum of the file); lower <= loss <= upper is proved in exact "
    "arithmetic for the identification problem, whose numbers the file holds rounded to doubles"
)


def rewritten(problem: ConicProblem, path: str | Path) -> tuple[Rewritten, str]:
    """The problem as the format of the file's ending, .dat-s or .cbf, can hold it, and the text.

    Raises InputError for another ending, or where the format lacks one of the problem's cones.
    """
    name = Path(path).name
    if name.endswith(".dat-s"):
        if any(c.kind == "exp" for c in problem.cones):
            raise InputError(
                "the SDPA format has no exponential cone, which the entropic regulariser needs",
                "write a .cbf file instead, or name a method without one",
                path,
            )
        made = linear_matrix_inequalities(problem)
        return made, sdpa_text(made.problem)
    if name.endswith(".cbf"):
        made = linear_objective(problem)
        return made, cbf_text(made.problem)
    raise InputError(
        "unknown suffix", "name the file .dat-s (sparse SDPA) or .cbf (conic benchmark format)", path
    )


def export_sdp(
    sdp: SdpProblem,
    path: str | Path,
    interval: tuple[str, str] | None,
    status: str = "optimum proved",
    **more: Any,
) -> dict[str, Any]:
    """Write the problem, and beside it FILE.json with what its optimum means; returns what that holds.

    interval : (lower, upper) bounds of the loss as decimal text, rounded outward; None where none is
    proved. status : what is proved; more : further entries of the JSON.
    """
    made, text = rewritten(sdp.conic, path)
    write_text(path, text)
    about = {
        "file": Path(path).name,
        "sha256": hashlib.sha256(text.encode()).hexdigest(),
        "sense": "min",
        "status": status,
        "offset": sdp.offset + sdp.loss_scale**2 * made.constant,
        "scale": sdp.loss_scale**2,
        "lower": float(interval[0]) if interval else None,
        "upper": float(interval[1]) if interval else None,
        "meaning": MEANING,
        "variables": len(made.problem.q),
        "rows": len(made.problem.b),
        "nonzeros": int(made.problem.A.nnz),
        **more,
    }
    write_text(f"{path}.json", json.dumps(about, indent=1, allow_nan=False) + "\n")
    return about


def prove(task: Task, objective: Objective, constraints: ConstraintSet) -> Proof:
    """The proof of an optimum by the default path; its "lower" and "upper" are rounded outward.

    Raises InputError where the solver gives up, ValueError where nothing can be proved.
    """
    fit = solve_sdp(task, objective, constraints, "clarabel", 1e-10)
    assert fit.multipliers is not None
    assert fit.interior is not None
    theta = repaired_as_written(constraints.convex, fit.theta, fit.interior)
    names = [p.name for p in task.model.parameters]
    return optimum_proof(
        objective, constraints, fit.multipliers, theta, task.bound, fit.entropy_slopes, names
    )


def write_posed(
    problem: str | Path | Problem,
    data: Source,
    out: str | Path,
    method: str = "lmi-sdp",
    effects: str | Sequence[Effect] | None = None,
) -> dict[str, Any]:
    """Write the SDP of identifying a problem from measured runs, centred and scaled, and beside it
    OUT.json with what it means and the proved interval of the loss; returns what that holds.

    Raises InputError where the method solves no one-step SDP, the input cannot be used, or as
    :func:`rewritten` does.
    """
    from sdp_vs_penalty.estimators import make_estimator
    from sdp_vs_penalty.estimators.task import make_task
    from sdp_vs_penalty.regression.regression import compress

    estimator = make_estimator(method)
    if not isinstance(estimator, LmiSdp):
        raise InputError(
            f"method {method} is not a single SDP",
            "choose lmi-sdp, lmi-sdp-thickness, lmi-sdp-plain or lmi-sdp-entropic",
        )
    robot = as_problem(problem, "posed(problem=...)")
    measurements = as_measurements(data, robot.robot.n, robot.robot.joint_names, "posed(data=...)")
    model = robot.model(effects)
    regression = compress(measurements, model, robot.preprocessing.resolve(measurements))
    task = make_task(robot, model, regression)
    objective, constraints = estimator.posed(task)
    interior = interior_point(task, constraints)
    sent = essential(constraints, objective)
    least = 1e-6 * objective.least_squares.tau_squared
    sdp = least_squares_sdp(objective, sent, interior, task.bound, interior, least_loss=least)
    rewritten(sdp.conic, out)  # refuses a suffix before anything is solved
    proof = prove(task, objective, constraints)
    name = problem.name if isinstance(problem, Problem) else str(problem)
    return export_sdp(sdp, out, (proof["lower"], proof["upper"]), problem=name, method=method)
