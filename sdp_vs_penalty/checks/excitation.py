"""What this motion cannot show, in words: parameters, and errors of the log."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from sdp_vs_penalty.checks.issue import Issue, joints_text
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import Number, Scene
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.estimation.uncertainty import NOT_SEEN, counts, of_regression
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.signals.preprocessing import Preprocessing

#: Up to this share of unseen base parameters is what an ordinary motion of a good arm leaves.
_FEW = 0.1
#: Names written out before "and so many more".
_NAMED = 8
#: Smaller errors of a zero are no matter of a file but of calibration [rad].
_SMALL = np.radians(2.0)


def find(problem: Problem, run: Measurements, settings: Preprocessing) -> Iterator[Issue]:
    """Base parameters that the data do not determine; those of idle joints are named elsewhere."""
    model = problem.model()
    known = of_regression(problem, model, compress(run, model, settings), white=True)
    count, total = counts(known.base), len(known.base)
    dark = [i.name.split(" ")[0] for i in known.base if i.verdict == NOT_SEEN]
    figures = {"base_parameters": total, **count, "names": dark}
    sure = "likely: by least squares, were its error white noise"
    if not dark:
        yield Issue(
            "excitation", "note", "the motion",
            f"all {total} base parameters are visible: {count['identifiable']} identifiable, "
            f"{count['weakly']} weakly identifiable.", sure, "no action needed", None, figures,
        )  # fmt: skip
        return
    by_joint: dict[int, list[str]] = {}
    joint_of = {p.name: p.joint for p in model.parameters}
    for name in dark:
        by_joint.setdefault(joint_of[name], []).append(name)
    travel, units, texts = np.ptp(run.q, axis=0), model.robot.position_units, []
    for joint, names in sorted(by_joint.items()):
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        what = f"{', '.join(names[:_NAMED])}{more}"
        moves = f" (it moves over {travel[joint - 1]:.2g} {units[joint - 1]})" if joint else ""
        texts.append(f"of joint {joint}{moves}: {what}" if joint else f"of the robot: {what}")
    joints = sorted(j - 1 for j in by_joint if j)
    yield Issue(
        "poor excitation", "warning" if len(dark) > _FEW * total else "note",
        joints_text(joints) if joints else "the robot",
        f"{len(dark)} of {total} base parameters are not identifiable from this motion: "
        f"{'; '.join(texts)}.", sure,
        "move these joints farther, faster and independently of each other, or add runs that do",
        None, figures,
    )  # fmt: skip


def hidden_errors(scene: Scene, repair: Repair) -> Iterator[Issue]:
    """One note: from which size on the zero of a joint would be named (few rows tell)."""
    scene = replace(scene, judged=scene.tried)
    zeros = {j + 1: 3.0 * scene.deviation(_zero(repair, j)) for j in scene.revolute}
    hidden = [
        f"joint {j}{'' if not x < np.pi else f' below {np.degrees(x):.2g} degrees'}"
        for j, x in zeros.items()
        if not x < _SMALL
    ]
    if hidden:
        yield Issue(
            "not visible", "note", "the motion",
            f"errors of these joints' zeros could not be seen in this motion: {', '.join(hidden)}.",
            "likely: to first order, from what the arm leaves unexplained",
            "move these joints farther, and in other poses of the joints before them", None,
            {"zeros": zeros},
        )  # fmt: skip


def _zero(repair: Repair, j: int) -> Number:
    return Number(repair.zero[j], partial(repair.with_entries, "zero", (j,)), _SMALL, 0.0, str)
