"""What the page shows of a model: errors beside the noise, where it fails, its torques as curves."""

import base64
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements, Runs
from sdp_vs_penalty.diagnosis.comparison import compare, predicted
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.where_it_fails import sentences, where_it_fails
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.drive_torque import driven
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.shapes import asked_effects
from sdp_vs_penalty.estimators.estimator import Progress
from sdp_vs_penalty.exporters.friction_table import friction_curves
from sdp_vs_penalty.files import write_bytes
from sdp_vs_penalty.reports.parameters import caveats, half_axes, link_rows, standard_rows
from sdp_vs_penalty.reports.sections import certificate_rows, judged_row
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.preprocessing import filtered_torque


@dataclass(frozen=True)
class ModelStep:
    """One model of a session's history, judged; plain JSON apart from being a class.

    file : its model.json, beside it the .npz of each run's torques; runs : names of those, training runs
    first, a part of a run by its seconds; judged_on : the runs behind comparison and failures (as
    `compare --json` writes them); judged, about : what ``judged_row`` and :func:`about` say; label,
    added : what it is called and the effects added to the step below, with the others held where frozen;
    opened : the file that a person brought, if any; servo : whether it knows the servos of a log
    without torque; findings : what it lacks, if it was diagnosed, and what `add` calls its curves.
    """

    file: str
    runs: list[str]
    judged_on: list[str]
    method: str
    effects: list[str]
    comparison: dict[str, Any]
    failures: list[dict[str, Any]]
    judged: list[str]
    about: dict[str, Any]
    on_bounds: list[str]
    seconds: float
    label: str = ""
    added: tuple[str, ...] = ()
    frozen: bool = False
    opened: str = ""
    servo: bool = False
    findings: Diagnosis | None = None
    curve_texts: Sequence[str] = ()


def about(estimate: Estimate) -> dict[str, Any]:
    """The parameters as the page shows them: rows, links, words and friction as in the report, and the
    arm in 3D (:func:`drawn_arm`)."""
    return {
        "rows": standard_rows(estimate),
        "links": link_rows(estimate),
        "words": caveats(estimate),
        "friction": [
            {"velocity": c.velocity, "torque": c.torque, "half": NORMAL_95 * c.std}
            for c in friction_curves(estimate)
        ],
        "certificate": certificate_rows([estimate]),
        **drawn_arm(estimate.robot, estimate.links if len(estimate.model.rigid_indices) else []),
    }


def drawn_arm(
    robot: Robot, links: Iterable[Array], hulls: Sequence[Sequence[Array]] = ()
) -> dict[str, Any]:
    """The arm in 3D: of each joint its parent and place there, of each link its joint and ellipsoid, and
    the convex hulls of a URDF's shapes and meshes (robot/geometry.py) with their joint, as STL."""
    bodies, shapes = [], []
    for k, some in enumerate(hulls):
        frame = robot.tree[robot.link_joints[k]].link_frame
        placed = [corners @ frame[:3, :3].T + frame[:3, 3] for corners in some]
        shapes += [{"joint": robot.link_joints[k], "stl": _stl(corners)} for corners in placed]
    for k, link in enumerate(links):
        if (body := half_axes(link)) is not None:
            frame = robot.tree[robot.link_joints[k]].link_frame
            half, axes, com = body
            place = frame @ np.block([[axes, com[:, None]], [np.zeros(3), np.ones(1)]])
            bodies.append({"link": k, "joint": robot.link_joints[k], "half": half, "place": place})
    joints = [{"parent": j.parent, "at": j.placement[:3, 3]} for j in robot.tree]
    return {"bodies": bodies, "joints": joints, "shapes": shapes}


def _stl(corners: Array) -> str:
    """Triangles (k, 3, 3) as a binary STL file, in base 64."""
    file = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("end", "<u2")])
    file["corners"] = corners
    head = bytes(80) + len(corners).to_bytes(4, "little")
    return base64.b64encode(head + file.tobytes()).decode()


def placed(robot: Robot, t: Array, q: Array, frames: int = 160) -> tuple[Array, Array]:
    """(F,) some instants of a motion q (N, n) at t (N,), and (F, joints, 4, 4) the poses there, between
    which the page interpolates."""
    keep = np.unique(np.linspace(0, len(t) - 1, frames).astype(int))
    return t[keep], robot.poses(robot.tree_state(q[keep])[0]).astype(np.float32)


def save_arrays(file: Path, arrays: dict[str, Any]) -> None:
    """As .npz, whole or not at all."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    write_bytes(file, buffer.getvalue())


def _named(runs: Sequence[Measurements]) -> list[str]:
    """Their names; parts of one run by their seconds too."""
    names = [run.names[0] for run in runs]
    return [
        name if names.count(name) == 1 else f"{name}, {run.t[0]:.4g} to {run.t[-1]:.4g} s"
        for name, run in zip(names, runs, strict=True)
    ]


def summary(estimate: Estimate, given: Runs, out: Path, seconds: float, progress: Progress) -> ModelStep:
    """Save a model at ``out`` and its curves beside it; judge it.

    Curves, an .npz a run, training runs first: t, torque, modelled, its motion q, dq, ddq, and tf (F,),
    poses (F, joints, 4, 4) of some instants for the 3D view.
    """
    progress("comparing measured with modelled")
    comparison = compare({"model": estimate}, given.judge, noise_from=given.whole)[0]
    (arm, judge), (_, train) = driven(estimate, given.judge), driven(estimate, given.train)
    settings = estimate.preprocessing.resolve(judge)
    estimate.provenance["verdict"] = comparison.verdict.to_dict()
    runs = [*train.runs(), *(judge.runs() if given.test is not None else ())]
    for k, run in enumerate(runs):
        rows = filtered_torque(run, arm.model, settings)
        motion = rows.motion
        found = {"torque": rows.torque, "modelled": predicted(rows, arm.theta)}
        found |= {name: getattr(motion, name) for name in ("q", "dq", "ddq")}
        arrays = {"t": motion.t, **{name: x.astype(np.float32) for name, x in found.items()}}
        arrays["tf"], arrays["poses"] = placed(estimate.robot, motion.t, motion.q)
        save_arrays(out.with_name(f"{out.stem}-{k}.npz"), arrays)
    progress("looking where it fails")
    try:
        failing = where_it_fails(estimate, judge, noise_from=given.whole, noise=comparison.noise)
        units = estimate.robot.torque_units
        failures = [{**f.to_dict(), "sentences": sentences(f, units[f.joint - 1])} for f in failing]
    except InputError:  # too short to say: the errors stand on their own
        failures = []
    estimate.save(out)
    return ModelStep(
        file=str(out),
        runs=_named(runs),
        judged_on=list(judge.names),
        method=estimate.method,
        effects=asked_effects(estimate.model.effects, estimate.details.get("shapes", ())),
        comparison=comparison.to_dict(),
        failures=failures,
        judged=judged_row(comparison),
        about=about(estimate),
        on_bounds=estimate.details.get("on_bounds") or [],
        seconds=seconds,
        servo=arm is not estimate,
    )
