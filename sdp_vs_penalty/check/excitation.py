"""What this motion cannot show, in words: parameters, and errors of the file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check.channels import gain_number
from sdp_vs_penalty.check.hypothesis import Number
from sdp_vs_penalty.check.issue import Issue, joints_text
from sdp_vs_penalty.check.physics import OVERSAMPLING, Physics
from sdp_vs_penalty.estimation.intervals import NOT_SEEN, counts
from sdp_vs_penalty.estimation.uncertainty import of_regression
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import Factor, Regression, TimeBlock, triangular

_BLOCKS = 20
#: Up to this share of unseen base parameters is what an ordinary motion of a good arm leaves.
_FEW = 0.1
#: Names written out before "and so many more".
_NAMED = 8


def find(problem: Problem, physics: Physics) -> Iterator[Issue]:
    """Base parameters that the data do not determine; those of idle joints are named elsewhere."""
    known = of_regression(problem, physics.model, regression_of(physics), white=True)
    count = counts(known.base)
    total = len(known.base)
    dark = [i.name.split(" ")[0] for i in known.base if i.verdict == NOT_SEEN]
    figures = {"base_parameters": total, **count, "names": dark}
    if not dark:
        yield Issue(
            "excitation", "note", "the motion",
            f"all {total} base parameters are visible: {count['identifiable']} identifiable, "
            f"{count['weakly']} weakly identifiable.",
            "likely: by least squares, were its error white noise", "no action needed", None,
            figures,
        )  # fmt: skip
        return
    by_joint: dict[int, list[str]] = {}
    joint_of = {p.name: p.joint for p in physics.model.parameters}
    for name in dark:
        by_joint.setdefault(joint_of[name], []).append(name)
    travel = np.ptp(physics.motion.q, axis=0)
    units = physics.model.robot.position_units
    texts = []
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
        f"{'; '.join(texts)}.", "likely: by least squares, were its error white noise",
        "move these joints farther, faster and independently of each other, or add runs that do",
        None, figures,
    )  # fmt: skip


def regression_of(physics: Physics) -> Regression:
    """The rows of the test, compressed, of the model alone."""
    t, own = physics.motion.t, len(physics.model.parameters)
    edges = np.linspace(0, len(t), min(_BLOCKS, max(len(t) // 4, 2)) + 1).astype(int).tolist()
    blocks, factors = [], []
    every = replace(physics, independent=None).columns
    for b, (start, stop) in enumerate(pairwise(edges)):
        rows = slice(start, stop)
        for j, columns in enumerate(every):
            used = np.flatnonzero(np.any(columns[:, :own] != 0.0, axis=0))
            stack = np.column_stack([columns[rows][:, used], physics.channels[rows, j]])
            factors.append(Factor(j, b, used, triangular([stack]), stop - start))
        blocks.append(TimeBlock(0, float(t[start]), float(t[stop - 1])))
    return Regression(
        physics.model.parameters, physics.n, tuple(blocks), tuple(factors), oversampling=OVERSAMPLING
    )


#: Smaller ones are no matter of a file but of calibration [rad].
_SMALL = np.radians(2.0)


def hidden_errors(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Issue]:
    """One note: from which size on a zero or a gain would be named, joint by joint."""
    robot, same = physics.model.robot, np.arange(physics.n)

    def turned(j: int) -> Callable[[float], Callable[[Physics], Physics]]:
        return lambda x: partial(
            Physics.with_motion, scale=np.ones(physics.n), order=same, offset=x * (same == j)
        )

    revolute = [j for j in np.flatnonzero(moving).tolist() if robot.joints[j].kind == "revolute"]
    zeros = {j + 1: Number(0.0, turned(j)).smallest(physics) for j in revolute}
    gains = {j + 1: gain_number(j, physics.n).smallest(physics) for j in np.flatnonzero(moving).tolist()}
    hidden = [
        f"joint {j}{'' if x > np.pi else f' below {np.degrees(x):.2g} degrees'}"
        for j, x in zeros.items()
        if x > _SMALL
    ]
    weak = [
        f"joint {j}" + ("" if x > np.log(10.0) else f" below {100.0 * np.expm1(x):.2g} %")
        for j, x in gains.items()
    ]
    if not hidden:
        return
    yield Issue(
        "not visible", "note", "the motion",
        f"errors of these joints' zeros could not be seen in this motion: {', '.join(hidden)}; of the "
        f"gains of their torques: {', '.join(weak)}.",
        "likely: to first order, from what the arm leaves unexplained",
        "move these joints farther, and in other poses of the joints before them",
        None, {"zeros": zeros, "gains": gains},
    )  # fmt: skip
