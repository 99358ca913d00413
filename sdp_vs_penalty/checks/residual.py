"""What the repaired log leaves over: is it what such arms leave, everywhere and all the time?

Two witnesses for each joint: how much one arm leaves of its torque, and how much more that is than a
model of this joint alone would leave. Friction, however odd, is in both.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.checks.issue import Issue, joints_text
from sdp_vs_penalty.checks.likelihood import FLOOR, Score, joint_fit, left_out_alone
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformations import Scene
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array

#: What an arm leaves of its torques (root mean square, all joints together): with joint torque
#: sensors, and with torques from motor currents, whose friction is part of them. So many times as much
#: is a warning.
_TYPICAL, _TIMES = {"link": 0.05, "motor": 0.1}, 2.0
#: Above this share of the energy, half of the torque, the arm's dynamics do not make it.
UNRELATED = 0.25
#: A joint contradicts its neighbours where one arm leaves so many times the energy that the joint's own
#: model leaves of it, and at least this share of the torque (root mean square).
_CONTRADICTS, _AT_LEAST = 6.0, 0.02
#: Instants, as shares of the log, at which it is cut in two; and for each joint the natural logarithm of
#: the energy by which two arms in turn must explain it better than two in stripes (as many parameters).
_CUTS, _STRIPES, _TWO = np.linspace(0.2, 0.8, 13), 20, 1.5
#: A one-off event is a peak of the error so many times any other one, that lasts at most so long [s].
_PEAK, _WIDTH = 3.0, 1.0


def overall(score: Score) -> float:
    """Share of the torques' energy that the arm leaves, all joints together."""
    moving = score.of.data.moving
    return float(score.left[moving].sum() / score.whole[moving].sum())


def find(scene: Scene, score: Score, settled: bool) -> Iterator[Issue]:
    """A warning where more is left over than such an arm leaves; an error where nothing is explained.

    settled : whether there are samples to spare for the parameters."""
    moving, shares = scene.moving, score.shares
    if float(np.mean(shares[moving])) > UNRELATED:
        percent = 100.0 * float(np.mean(shares[moving]))
        yield Issue(
            "torque not explained", "error", "all torque channels",
            f"No inertia and friction of this arm explain {percent:.0f} % of the torque energy.",
            "certain: none of the tried signs, orders, units, zeros, delays and directions of "
            "gravity helps",
            "check that this is the right robot, that the columns are joint torques, and that "
            "positions and "
            "torques come from the same recording", None, {"unexplained_percent": percent},
        )  # fmt: skip
        return
    if not settled:
        return
    yield from _unexplained(scene, score)
    yield from _knock(scene, score)


def _unexplained(scene: Scene, score: Score) -> Iterator[Issue]:
    moving, shares, alone = scene.moving, score.shares, left_out_alone(score)
    usual, total = _TYPICAL[scene.problem.torque_side], overall(score) ** 0.5
    against = moving & (shares > _CONTRADICTS * alone) & (np.sqrt(shares) > _AT_LEAST)
    poor = moving & (score.alone > 2.0 * UNRELATED) & ~against
    listed = ", ".join(f"{100.0 * x:.2g}" for x in np.sqrt(shares))
    figures = {"percent": (100.0 * np.sqrt(shares)).round(2).tolist(), "overall_percent": 100.0 * total}
    sure = (
        "certain: by the best fit of this arm; signs, orders, gains, zeros, delays, units and "
        "gravity were "
        "tried, and none of them explains it"
    )
    for joints, what in (
        (against, "cannot belong to the same arm as the other joints' torques"),
        (poor, "has little to do with that joint's motion"),
    ):
        if joints.any():
            where = np.flatnonzero(joints)
            left = ", ".join(f"{100.0 * np.sqrt(shares[j]):.2g} %" for j in where)
            yield Issue(
                "unexplained torque", "warning", joints_text(where),
                f"the torque of {joints_text(where)} {what}: {left} of it stays unexplained.", sure,
                "look at that channel: `diagnose` draws what is left; check its source, gain and zero",
                None, {**figures, "joints": (where + 1).tolist()},
            )  # fmt: skip
    if total > _TIMES * usual and not (against | poor).any():
        worst = int(np.argmax(np.where(moving, score.left, 0.0)))
        yield Issue(
            "unexplained torque", "warning", joints_text([worst]),
            f"{100.0 * total:.2g} % of the torque stays unexplained, {total / usual:.1f} times what "
            f"arms "
            f"with torque on the {scene.problem.torque_side} side usually leave (by joint: {listed} %).",
            sure, "check that robot, mounting and torque side are those of the problem; `diagnose` "
                "looks for "
            "effects that the model is missing", None, {**figures, "joints": [worst + 1]},
        )  # fmt: skip


def _knock(scene: Scene, score: Score) -> Iterator[Issue]:
    """A moment at which the error is far larger than at any other: contact, a push."""
    t = scene.judged.data.motion.t
    for j in scene.joints:
        error = np.abs(score.residual[:, j])
        k = int(np.argmax(error))
        elsewhere = error[np.abs(t - t[k]) > _WIDTH]
        if min(t[k] - t[0], t[-1] - t[k]) < 3.0 * _WIDTH or not len(elsewhere):
            continue  # the arm starts or comes to rest there: stiction
        if error[k] > _PEAK * elsewhere.max():
            at, unit = float(t[k]), scene.problem.robot.torque_units[j]
            yield Issue(
                "one-off event", "warning", f"t = {at:.3g} s, {joints_text([j])}",
                f"a one-off event at t = {at:.3g} s (a knock, a contact, a lost packet): the error "
                f"there is "
                f"{error[k]:.3g} {unit} in joint {j + 1}, over {_PEAK:g} times that at any other "
                f"moment.",
                "likely: an effect of the arm itself would recur", f"exclude {_WIDTH:g} s around it",
                partial(_cut, at=at), {"t": at, "joints": [j + 1]},
            )  # fmt: skip
            return


def _cut(run: Measurements, at: float) -> Measurements:
    return run.rows(np.abs(run.t - at) > 0.5 * _WIDTH)


def two_parts(scene: Scene, repair: Repair, score: Score) -> Iterator[Issue]:
    """Two parts of a log that no one arm explains: a load picked up, or two arms' logs in one file.

    Two arms in stripes that take turns have as many parameters, and no reason to explain it better.
    """
    data, moving, count = scene.judged.data, scene.moving, scene.judged.data.count
    u = (data.motion.t - data.motion.t[0]) / max(float(np.ptp(data.motion.t)), 1e-300)
    weights = moving / np.maximum(score.left, FLOOR * score.whole)
    columns = [np.hstack([x.basis, x.raw]) for x in score.joints]
    widths = np.array([x.basis.shape[1] for x in score.joints])

    def left(rows: NDArray[np.bool_]) -> Array:
        """(n,) what one arm of these rows leaves of them."""
        parts = [(c[rows], y[rows]) for c, y in zip(columns, score.channels.T, strict=True)]
        grams, crosses = [c.T @ c for c, _ in parts], [c.T @ y for c, y in parts]
        theta, own = joint_fit(grams, crosses, widths, weights)
        fits = (np.concatenate([x, theta]) for x in own)
        return np.array([np.sum((y - c @ x) ** 2) for (c, y), x in zip(parts, fits, strict=True)])

    odd = (np.arange(count) * _STRIPES // count) % 2 == 1
    stripes = left(odd) + left(~odd)
    halves = [left(u <= c) + left(u > c) for c in _CUTS]
    gains = [
        np.log(np.maximum(stripes, FLOOR * score.whole) / np.maximum(h, FLOOR * score.whole))
        for h in halves
    ]
    each = [float(np.median(g[moving])) for g in gains]
    best = int(np.argmax(each))
    if each[best] < _TWO or best in (0, len(_CUTS) - 1) or repair.events:
        return
    t = float(data.motion.t[0] + _CUTS[best] * np.ptp(data.motion.t))
    one, two = (100.0 * np.sqrt(np.mean(x / score.whole)) for x in (score.left, halves[best]))
    yield Issue(
        "two arms", "error" if one > 3.0 * two else "warning", f"t = {t:.4g} s",
        f"before and after t = {t:.4g} s these are not the torques of one arm: it picked up or put "
        f"down a "
        "load, or two logs are in one file.",
        f"likely: two arms leave {two:.3g} % of the torques unexplained, one leaves {one:.3g} %",
        "cut the run there and use each part by itself (--window)", None, {"t": t},
    )  # fmt: skip
