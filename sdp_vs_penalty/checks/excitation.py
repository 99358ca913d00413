"""What this motion cannot show, in words: parameters, and errors of the log."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from sdp_vs_penalty.checks.constants import CALIBRATED, UNRELATED
from sdp_vs_penalty.checks.issue import Issue, joints_text
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import Scene
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.estimation.uncertainty import NOT_SEEN, counts, of_regression
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.signals.preprocessing import Preprocessing


def find(problem: Problem, run: Measurements, settings: Preprocessing) -> Iterator[Issue]:
    """Base parameters that the data do not determine; those of idle joints are named elsewhere."""
    model = problem.model()
    known = of_regression(problem, model, compress(run, model, settings), white=True)
    dark = [i.name.split(" ")[0] for i in known.base if i.verdict == NOT_SEEN]
    if not dark:
        return
    total, joint_of = len(known.base), {p.name: p.joint for p in model.parameters}
    joints = sorted({joint_of[name] - 1 for name in dark if joint_of[name]})
    yield Issue(
        "poor excitation", "warning" if len(dark) > UNRELATED * total else "note",
        joints_text(joints) if joints else "the robot",
        f"{len(dark)} of {total} base parameters are not identifiable from this motion: "
        f"{', '.join(dark)}.", "likely: by least squares, were its error white noise",
        "move these joints farther, faster and independently of each other, or add runs that do",
        None, {"base_parameters": total, **counts(known.base), "names": dark},
    )  # fmt: skip


def hidden_errors(scene: Scene, repair: Repair) -> Iterator[Issue]:
    """One note: from which size on the zero of a joint would be named (few rows tell)."""
    zeros = {}
    for j in scene.revolute:
        at = partial(repair.with_entries, "zero", (j,))
        zeros[j + 1] = 3.0 * scene.tried.change(at, repair.zero[j], 0.3 * CALIBRATED)[1]
    hidden = [
        f"joint {j}{'' if not x < np.pi else f' below {np.degrees(x):.2g} degrees'}"
        for j, x in zeros.items()
        if not x < CALIBRATED
    ]
    if hidden:
        yield Issue(
            "not visible", "note", "the motion",
            f"errors of these joints' zeros could not be seen in this motion: {', '.join(hidden)}.",
            "likely: to first order, from what the arm leaves unexplained",
            "move these joints farther, and in other poses of the joints before them", None,
            {"zeros": zeros},
        )  # fmt: skip
