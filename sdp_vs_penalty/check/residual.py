"""What the best fit of this arm leaves over, overall and joint by joint: is it what such arms leave?

Judged on the rows that an identification is made of, so that both quote the same share. Two witnesses
for each joint: how much one arm leaves of its torque, and how much more that is than a model of this
joint alone would leave. Data of one arm make the second ratio small, whatever its friction: a joint that
only fits by itself contradicts its neighbours.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check.evidence import Evidence, alone_left_out
from sdp_vs_penalty.check.issue import Issue, joints_text
from sdp_vs_penalty.check.physics import Physics
from sdp_vs_penalty.problem.problem import Problem

#: What an ordinary arm leaves of its torques (root mean square, all joints together): with joint torque
#: sensors, and with torques from motor currents, whose friction is part of them.
_TYPICAL = {"link": 0.05, "motor": 0.1}
#: So many times as much is a warning.
_TIMES = 3.0
#: A joint contradicts its neighbours where one arm leaves this many times the energy that the joint's
#: own model leaves, and at least this share (root mean square).
_CONTRADICTS, _AT_LEAST = 6.0, 0.02
#: Far from the others: this many times the median of the moving joints' shares, and at least this.
_FAR, _FAR_AT_LEAST = 15.0, 0.05
#: Above this share of its energy a joint's own torque is as good as unexplained by its own motion.
_OWN = 0.5


def overall(evidence: Evidence) -> float:
    """|tau - tau_hat|^2 / |tau|^2 over all joints: what `identify` quotes the root of."""
    return float(evidence.left.sum() / evidence.energy.sum())


def find(
    evidence: Evidence, physics: Physics, problem: Problem, moving: NDArray[np.bool_], tried: bool
) -> Iterator[Issue]:
    """A warning where what is left over is more than such an arm leaves. tried : whether causes were.

    evidence : of the rows and the model of an identification, which is quoted; physics : with rotors
    and further laws of friction (see beyond.py). What that explains is the model's matter. A joint's
    own model, which has as many parameters as the arm, is asked about parts that it was not fitted to.
    """
    wide, own = physics.evidence, alone_left_out(physics.columns, physics.channels)
    shares, alone = evidence.shares, np.minimum(evidence.alone, wide.alone)
    total = overall(evidence) ** 0.5
    # Where a joint rests, dry friction holds any torque between two limits.
    as_it_is = np.minimum(shares, wide.shares)
    least = np.minimum(as_it_is, physics.sliding.evidence.shares)
    ratio = np.minimum(shares / evidence.alone, wide.shares / np.maximum(wide.alone, own))
    usual = _TYPICAL[problem.torque_side]
    against = moving & (ratio > _CONTRADICTS) & (np.sqrt(least) > _AT_LEAST)
    poor = moving & (alone > _OWN)
    middle = float(np.median(np.sqrt(as_it_is[moving]))) if moving.any() else 0.0
    far = moving & (np.sqrt(least) > max(_FAR * middle, _FAR_AT_LEAST)) & ~against & ~poor
    figures = {"percent": (100.0 * np.sqrt(shares)).round(2).tolist(), "overall_percent": 100.0 * total}
    listed = ", ".join(f"{100.0 * x:.2g}" for x in np.sqrt(shares))
    rest = (
        "signs, orders, gains, zeros, delays, units and gravity were tried, and none of them explains it"
        if tried
        else "no cause was tried"
    )
    for joints, what in (
        (against, "cannot belong to the same arm as the other joints' torques"),
        (poor & ~against, "has little to do with that joint's motion"),
        (far, "is explained far worse than the other joints'"),
    ):
        if joints.any():
            where = np.flatnonzero(joints)
            left = ", ".join(f"{100.0 * np.sqrt(shares[j]):.2g} %" for j in where)
            yield Issue(
                "unexplained torque", "warning", joints_text(where),
                f"the torque of {joints_text(where)} {what}: {left} of it stays unexplained"
                + (f", {ratio[where].max():.0f} times the energy that the joint's own model leaves."
                   if joints is against else "."),
                f"certain: by the best fit of this arm; {rest}",
                "look at that channel: `diagnose` draws what is left; check its source, gain and zero",
                None, {**figures, "joints": (where + 1).tolist()},
            )  # fmt: skip
    if min(total, overall(wide) ** 0.5) > _TIMES * usual and not (against | poor | far).any():
        worst = int(np.argmax(np.where(moving, shares * evidence.energy, 0.0)))
        yield Issue(
            "unexplained torque", "warning", joints_text([worst]),
            f"{100.0 * total:.2g} % of the torque stays unexplained, {total / usual:.1f} times what "
            f"arms with torque on the {problem.torque_side} side usually leave (by joint: {listed} %).",
            f"certain: by the best fit of this arm; {rest}",
            "check that robot, mounting and torque side are those of the problem; `diagnose` looks for "
            "effects that the model is missing",
            None, {**figures, "joints": [worst + 1]},
        )  # fmt: skip
