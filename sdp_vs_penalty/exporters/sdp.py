"""An identification SDP as a file for any solver: sparse SDPA (.dat-s) or conic
benchmark format (.cbf).

Both formats hold a linear objective; SDPA's holds matrix inequalities only. The problem
is rewritten exactly (:mod:`solvers.rewrite`), numbers have 17 digits, so that nothing
is lost. Neither format has a place for a constant: FILE.json beside the file says how
its optimum becomes identification's objective, and between which proved bounds that
lies.

Sources: the SDPA format as in Borchers, SDPLIB (Optim. Methods Softw. 1999); H. A.
Friberg, CBF format reference, version 3.
"""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sdp_vs_penalty.data.files import Source
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import PoseOptions, build_problem
from sdp_vs_penalty.estimation.identify import certify
from sdp_vs_penalty.estimation.proofs import proved
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.lmi_sdp import ATTEMPTS, LmiSdp, interior_point
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.solvers.conic import cbf_text, sdpa_text
from sdp_vs_penalty.solvers.identification import SdpProblem, least_squares_sdp
from sdp_vs_penalty.solvers.rewrite import linear_objective, suited

#: Ending of the sparse SDPA format.
_SDPA = ".dat-s"
#: Method whose SDP is written in that format if none is named: it has no exponential
#: cone.
SDPA_METHOD = "lmi-sdp-thickness"


def check_format(path: str | Path, exponential: bool) -> None:
    """Raise InputError if a file of this name cannot hold the problem.

    Its suffix must be .dat-s or .cbf; the former has no exponential cone.

    Parameters
    ----------
    exponential : bool
        Whether the problem has an exponential cone.
    """
    name = Path(path).name
    if not name.endswith((_SDPA, ".cbf")):
        raise InputError(
            "unknown suffix",
            "name the file .dat-s (sparse SDPA) or .cbf (conic benchmark format)",
            path,
        )
    if exponential and name.endswith(_SDPA):
        raise InputError(
            "the SDPA format has no exponential cone, which the entropic regulariser"
            " needs",
            "write a .cbf file instead, or name a method without one, such as"
            f" {SDPA_METHOD}",
            path,
        )


def export_sdp(
    sdp: SdpProblem,
    path: str | Path,
    interval: tuple[str, str] | None,
    status: str = "optimum proved",
    **more: Any,
) -> dict[str, Any]:
    """Write a semidefinite program, and FILE.json that explains its optimum.

    Parameters
    ----------
    path : path
        The file to write, .dat-s or .cbf.
    interval : tuple of str, or None
        Proved lower and upper bound of the loss as decimal text, rounded outward.
    more : any
        Further entries of the JSON.

    Raises
    ------
    InputError
        For another suffix, or a format without one of the problem's cones.
    """
    check_format(path, any(c.kind == "exp" for c in sdp.conic.cones))
    if Path(path).name.endswith(_SDPA):
        written = suited(sdp.conic, {"nonnegative", "psd"})
        text = sdpa_text(written.problem)
    else:
        written = linear_objective(sdp.conic)
        text = cbf_text(written.problem)
    write_text(path, text)
    about = {
        "file": Path(path).name,
        "sha256": hashlib.sha256(text.encode()).hexdigest(),
        "sense": "min",
        "status": status,
        "offset": sdp.offset + sdp.loss_scale**2 * written.constant,
        "scale": sdp.loss_scale**2,
        "lower": float(interval[0]) if interval else None,
        "upper": float(interval[1]) if interval else None,
        "meaning": (
            "objective = offset + scale * (optimum of the file); lower <= objective <="
            " upper is proved in exact arithmetic for the identification problem, whose"
            " numbers the file holds rounded to doubles; the parameters are theta ="
            " centre + theta_scale * (the first variables of the file)"
        ),
        "centre": sdp.centre.tolist(),
        "theta_scale": sdp.theta_scale.tolist(),
        "variables": len(written.problem.q),
        "rows": len(written.problem.b),
        "nonzeros": int(written.problem.A.nnz),
        **more,
    }
    write_text(f"{path}.json", json.dumps(about, indent=1, allow_nan=False) + "\n")
    return about


def write_posed(
    problem: str | Path | Problem,
    measurements: Source,
    out: str | Path,
    method: str | None = None,
    options: PoseOptions | None = None,
) -> dict[str, Any]:
    """Write the SDP that ``identify`` solves, and OUT.json with the proved interval of
    its optimum.

    The variables are centred at the solution, which helps other solvers.

    Parameters
    ----------
    problem : Problem, str or Path
        The robot, as ``identify`` takes it.
    measurements : Source
        The runs, as ``identify`` takes them.
    out : path
        The file to write, .dat-s or .cbf.
    method : str or None
        None for the default method; for .dat-s, whose format lacks exponential cones,
        that is SDPA_METHOD.
    options : PoseOptions, optional
        Effects, weights and so on, as for ``identify``.

    Raises
    ------
    InputError
        If the method does not solve a single SDP, or the input cannot be used.
    """
    method = method or (
        SDPA_METHOD if Path(out).name.endswith(".dat-s") else DEFAULT_METHOD
    )
    estimator = make_estimator(method)
    if not isinstance(estimator, LmiSdp):
        raise InputError(
            f"method {method} is not a single SDP",
            "choose lmi-sdp, lmi-sdp-thickness, lmi-sdp-plain or lmi-sdp-entropic",
        )
    check_format(out, estimator.entropy > 0.0)
    estimation = build_problem(problem, measurements, options)
    task = estimation.task
    runs = estimation.runs
    convex = estimator.posed(task)
    task.progress("proving the optimum")
    fit = estimator.fit(task)
    proof = proved(task, fit, certify(task, fit)[0], method)
    centre = fit.theta
    # The cones are scaled at a point between optimum and interior point, close to the
    # optimum, as in the second attempt of our own solver. Scaled at the interior point
    # itself, csdp's optimum is off by 2e-6 on the TX40; 0.03 to 0.3 of the way make no
    # difference on three arms.
    share_of_way, _ = ATTEMPTS[1]
    to_interior = interior_point(task, convex.constraints) - centre
    inside = centre + share_of_way * to_interior
    smallest = convex.least_squares.loss_scale(centre)
    sdp = least_squares_sdp(convex, inside, centre, least_loss=smallest)
    return export_sdp(
        sdp,
        out,
        (proof["lower"], proof["upper"]),
        problem=estimation.problem.name,
        method=method,
        effects=[effect.text for effect in task.model.effects],
        gravity=list(estimation.problem.robot.gravity),
        filters=asdict(
            estimation.problem.preprocessing if runs is None else runs.settings
        ),
        weighting=estimation.weighting,
        data_hash=estimation.measurements.data_hash,
    )
