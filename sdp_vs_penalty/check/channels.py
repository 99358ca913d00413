"""One torque channel unlike the others: its gain or unit, a delay, a filter, gravity taken out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check import events
from sdp_vs_penalty.check.hypothesis import ENOUGH, LEAST, Hypothesis, Number, best_number, propose
from sdp_vs_penalty.check.issue import joints_text
from sdp_vs_penalty.check.physics import Physics
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array

#: Gains that are tried; nearer to 1 than the second figure none is named: so far drives are calibrated.
_GAINS = (1e-3, 1e-2, 0.1, 0.5, 0.8, 1.0, 1.25, 2.0, 10.0, 100.0, 1000.0)
_SMALLEST_GAIN, _GROSS_GAIN = 0.06, 0.2
#: Logarithm by which the channels of one arm, as its drives are calibrated, differ.
_USUAL_GAIN = 0.1
#: A model of channels that differ by less is wrong by as much, but not meaningless.
_MEANINGLESS = 0.5
#: Known ratios of units, and what a channel is in when its torque has to be multiplied by one.
_UNITS = {1e-2: "N cm", 1e-3: "mN m", 9.80665: "kgf m", 1.355818: "lbf ft", 0.1129848: "lbf in"}
#: Delays and time constants [s] that are tried.
_LATE = (-0.12, -0.06, -0.02, 0.0, 0.02, 0.06, 0.12)
_SLOW = (0.0, 0.05, 0.12, 0.25)
#: Shares of the weight that may be left in a channel.
_WEIGHTS = (-0.05, 0.0, 0.1, 0.3, 1.0)
_MOSTLY_GONE = 0.5


def gain(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """A torque channel too large or too small beside its neighbours'."""
    n, same = physics.n, np.arange(physics.n)
    alive = np.std(physics.channels, axis=0) > 1e-9 * np.abs(physics.channels).max(axis=0)
    if np.sum(moving & alive) < 2:
        return  # a joint that moves alone has none to be compared with
    for j in np.flatnonzero(moving & alive):

        def scaled(log: float, j: int = int(j)) -> Array:
            scale = np.ones(n)
            scale[j] = np.exp(log)
            return scale

        def score(log: float, scaled: Callable[[float], Array] = scaled) -> float:
            return physics.with_channels(scaled(log), same).evidence.misfit

        found = best_number(score, np.log(_GAINS).tolist())
        unit = next((u for u in _UNITS if abs(found - np.log(u)) < (0.1 if u < 0.05 else 0.02)), None)
        if abs(found) < np.log1p(_SMALLEST_GAIN):
            continue
        factor = float(np.exp(found)) if unit is None else unit
        size = f"{1.0 / factor:.3g} times too large" if factor < 1.0 else f"{factor:.3g} times too small"
        what = f"the torque of joint {j + 1} is {size} beside those of the joints that it moves with"
        texts = ("torque gain", joints_text([j]), what + ".", f"multiply tau{j + 1} by {factor:.3g}")
        if unit is not None and (unit < 0.05 or unit > 5.0):
            texts = ("torque unit", joints_text([j]), f"{what}: it is in {_UNITS[unit]}.", texts[3])
        scale = scaled(float(np.log(factor)))
        yield propose(
            partial(Physics.with_channels, scale=scale, order=same), 2, texts,
            partial(_scaled, scale=scale), joints=[int(j) + 1], factor=factor,
            gross=abs(found) > np.log1p(_GROSS_GAIN),
            severity="error" if abs(found) > np.log1p(_MEANINGLESS) else "warning",
            number=Number(found, partial(_gained, scaled), _USUAL_GAIN),
        )  # fmt: skip


def _gained(scaled: Callable[[float], Array], log: float) -> Callable[[Physics], Physics]:
    scale = scaled(log)
    return partial(Physics.with_channels, scale=scale, order=np.arange(len(scale)))


def late(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """One torque channel later than the others, or passed through a causal filter."""
    for j in np.flatnonzero(moving):
        one = np.eye(physics.n)[j]

        def score(seconds: float, order: int, one: Array = one) -> float:
            return physics.with_lead(seconds * one, order).evidence.misfit

        delay = best_number(partial(score, order=2), _LATE)
        slow = best_number(partial(score, order=1), _SLOW)
        if abs(delay) > 0.005:
            word = "later" if delay > 0.0 else "earlier"
            yield propose(
                partial(Physics.with_lead, seconds=delay * one), 2,
                (
                    "channel delay", joints_text([j]),
                    f"the torque of joint {j + 1} comes {1e3 * abs(delay):.0f} ms {word} than the "
                    "motion; the other torques do not.",
                    f"shift tau{j + 1} in time (and log all channels from one source)",
                ),
                partial(shifted_channel, j=int(j), seconds=delay),
                severity="warning", joints=[int(j) + 1], seconds=delay, number=leads(delay, one),
            )  # fmt: skip
        if slow > 0.01:
            yield propose(
                partial(Physics.with_lead, seconds=slow * one, order=1), 3,
                (
                    "channel filter", joints_text([j]),
                    f"the torque of joint {j + 1} has passed a causal low-pass of "
                    f"{_hertz(slow)}; the other torques have not.",
                    f"log tau{j + 1} unfiltered, or filter every channel alike and without lag",
                ),
                None, severity="warning", joints=[int(j) + 1], seconds=slow,
                number=leads(slow, one, 1),
            )  # fmt: skip


def filtered(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """All torques passed through the same causal filter."""
    one = np.ones(physics.n)
    slow = best_number(lambda s: physics.with_lead(s * one, 1).evidence.misfit, _SLOW)
    if slow > 0.005:
        yield propose(
            partial(Physics.with_lead, seconds=slow * one, order=1), 2,
            (
                "torque filter", "all torque channels",
                f"the torques have passed a causal low-pass of {_hertz(slow)}, the positions have not.",
                "log the torques unfiltered, or filter positions and torques alike",
            ),
            None, severity="warning", seconds=slow, number=leads(slow, one, 1),
        )  # fmt: skip


def leads(seconds: float, channels: Array, order: int = 2) -> Number:
    """A delay (order 2) or a lag (order 1) of the channels (n,) that are 1.

    That of one channel alone is what its joint's friction may look like: only a large one tells.
    """
    least = LEAST if channels.all() else ENOUGH
    return Number(seconds, lambda x: lambda p: p.with_lead(x * channels, order), least=least)


def _scaled(run: Measurements, scale: Array) -> Measurements:
    return replace(run, tau=run.tau * scale)


def _score_of_weight(physics: Physics, shares: Callable[[float], Array], share: float) -> float:
    return physics.with_weight(shares(share)).evidence.misfit


def _weighing(shares: Callable[[float], Array], change: float) -> Callable[[Physics], Physics]:
    return partial(Physics.with_weight, share=shares(1.0 + change))


def _hertz(seconds: float) -> str:
    return f"{1.0 / (2.0 * np.pi * seconds):.2g} Hz ({1e3 * seconds:.0f} ms)"


def shifted_channel(run: Measurements, j: int, seconds: float) -> Measurements:
    """One torque ``seconds`` earlier; the rows at the end that lose theirs are left out."""
    moved = events.shifted(run, seconds)
    keep = np.isin(run.t, moved.t)
    tau = run.tau[keep].copy()
    tau[:, j] = moved.tau[:, j]
    return replace(moved, tau=tau)


def weight(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """The weight of the arm taken out of one channel, or of all, by the controller."""
    robot = physics.model.robot
    if not any(robot.gravity):
        return
    n = physics.n
    groups = [*([j] for j in range(n)), list(range(n))]
    for joints in groups:
        share = np.ones(n)

        def left(x: float, joints: list[int] = joints) -> Array:
            share = np.ones(n)
            share[joints] = x
            return share

        score = {x: physics.with_weight(left(x)).evidence.score for x in _WEIGHTS[:-1]}
        best = min(score, key=lambda x: score[x])
        if score[best] > physics.evidence.score - LEAST:
            continue
        x = best_number(partial(_score_of_weight, physics, left), _WEIGHTS)
        x = 0.0 if abs(x) < 0.03 else x
        if not _WEIGHTS[0] + 0.01 < x < 0.7:
            continue  # at the edge of what is tried there is no minimum
        share = left(x)
        every = len(joints) == n
        gone = f"{100.0 * (1.0 - x):.0f} % of the weight is"
        of = "the torques" if every else f"the torque of {joints_text(joints)}"
        gx, gy, gz = (float(round(x * v, 3)) + 0.0 for v in robot.gravity)
        how = "log the torques before gravity compensation"
        if every:
            how += f", or identify with --gravity {gx:g},{gy:g},{gz:g}"
        texts = ("gravity removed", joints_text(joints), f"{gone} missing from {of}.", how)
        yield propose(
            partial(Physics.with_weight, share=share), 2, texts, None,
            gravity=(gx, gy, gz) if every else None, joints=[j + 1 for j in joints], share_left=x,
            gross=x < _MOSTLY_GONE,
            number=Number(x - 1.0, partial(_weighing, left)),
        )  # fmt: skip
