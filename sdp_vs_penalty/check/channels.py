"""Torque channels unlike the others: gain or unit, a delay, a filter, gravity taken out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check.hypothesis import ENOUGH, LEAST, Hypothesis, Number, all_fitted, propose
from sdp_vs_penalty.check.issue import joints_text
from sdp_vs_penalty.check.physics import Physics, settled
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.robot.arrays import Array

#: Gains that are tried; nearer to 1 than the second figure none is named: so far drives are calibrated.
_GAINS = (1e-3, 1e-2, 0.1, 0.5, 0.8, 1.0, 1.25, 2.0, 10.0, 100.0, 1000.0)
_SMALLEST_GAIN, _GROSS_GAIN = 0.06, 0.2
_DECADE = float(np.log(10.0))
#: Logarithm by which the channels of one arm, as its drives are calibrated, differ.
_USUAL_GAIN = 0.1
#: A model of channels that differ by less is wrong by as much, but not meaningless.
_MEANINGLESS = 0.5
#: Known ratios of units, and what a channel is in when its torque has to be multiplied by one.
_UNITS = {1e-2: "N cm", 1e-3: "mN m", 9.80665: "kgf m", 1.355818: "lbf ft", 0.1129848: "lbf in"}
#: Delays and time constants [s] that are tried.
_LATE = (-0.2, -0.12, -0.06, -0.02, 0.0, 0.02, 0.06, 0.12, 0.2)
_SLOW = (0.0, 0.05, 0.12, 0.25)
#: ... and less is none: drives and their drivers take as long.
_SMALLEST_DELAY = 0.005
#: Shares of the weight that may be left in a channel.
_WEIGHTS = (-0.05, 0.0, 0.1, 0.3, 1.0)
_MOSTLY_GONE = 0.5


def gain(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """A torque channel too large or too small beside its neighbours'."""
    n, same = physics.n, np.arange(physics.n)
    alive = np.std(physics.channels, axis=0) > 1e-9 * np.abs(physics.channels).max(axis=0)
    if np.sum(moving & alive) < 2:
        return  # a joint that moves alone has none to be compared with
    asked = np.flatnonzero(moving & alive).tolist()
    numbers = all_fitted([gain_number(j, n) for j in asked], physics, np.log(_GAINS).tolist())
    for j, number in zip(asked, numbers, strict=True):
        found = number.value
        unit = next((u for u in _UNITS if abs(found - np.log(u)) < (0.1 if u < 0.05 else 0.02)), None)
        if abs(found) < np.log1p(_SMALLEST_GAIN):
            continue
        told = number.where(physics)
        tried = settled(number.at(found + x)(told) for x in (0.0, -_DECADE, _DECADE))
        best, *others = (e.misfit for e in tried)
        if min(others) < best + LEAST:
            continue  # any size explains as much: a channel that is clipped, or none of this arm's
        factor = float(np.exp(found)) if unit is None else unit
        size = f"{1.0 / factor:.3g} times too large" if factor < 1.0 else f"{factor:.3g} times too small"
        what = f"the torque of joint {j + 1} is {size} beside those of the joints that it moves with"
        texts = ("torque gain", joints_text([j]), what + ".", f"multiply tau{j + 1} by {factor:.3g}")
        if unit is not None and (unit < 0.05 or unit > 5.0):
            texts = ("torque unit", joints_text([j]), f"{what}: it is in {_UNITS[unit]}.", texts[3])
        scale = np.where(same == j, factor, 1.0)
        yield propose(
            replace(number, value=float(np.log(factor))), 2, texts,
            partial(_scaled, scale=scale), joints=[j + 1],
            factor=factor, gross=abs(found) > np.log1p(_GROSS_GAIN),
            severity="error" if abs(found) > np.log1p(_MEANINGLESS) else "warning",
        )  # fmt: skip


def gain_number(j: int, n: int) -> Number:
    """The gain of a channel as the logarithm of what it has to be multiplied by, 0."""

    def at(x: float) -> Callable[[Physics], Physics]:
        scale = np.where(np.arange(n) == j, np.exp(x), 1.0)
        return partial(Physics.with_channels, scale=scale, order=np.arange(n))

    return Number(0.0, at, _USUAL_GAIN, where=lambda p: p.sliding)


def late(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """One torque channel later than the others, or all than the motion; or through a causal filter.

    A joint that moves alone has no others.
    """
    groups = [[j] for j in np.flatnonzero(moving).tolist()] if moving.sum() > 1 else []
    groups.append(list(range(physics.n)))
    channels = [np.isin(np.arange(physics.n), joints).astype(float) for joints in groups]
    delays = all_fitted([_lead(x, 2) for x in channels], physics, _LATE)
    lags = all_fitted([_lead(x, 1) for x in channels], physics, _SLOW)
    for joints, delay, lag in zip(groups, delays, lags, strict=True):
        yield from _late(physics, joints, delay, lag)


def _late(physics: Physics, joints: list[int], number: Number, lag: Number) -> Iterator[Hypothesis]:
    every = len(joints) == physics.n
    one = np.isin(np.arange(physics.n), joints).astype(float)

    where = "all torque channels" if every else joints_text(joints)
    of = "the torques" if every else f"the torque of {where}"
    numbers = [j + 1 for j in joints]
    delay = number.value
    if abs(delay) > _SMALLEST_DELAY:
        word = "later" if delay > 0.0 else "earlier"
        beside = "the positions." if every else "the motion; the other torques do not."
        yield propose(
            number, 1 if every else 2,
            (
                "delay" if every else "channel delay", where,
                f"{of} {'come' if every else 'comes'} {1e3 * abs(delay):.0f} ms {word} than {beside}",
                f"shift {'the torques' if every else f'tau{joints[0] + 1}'} in time (and log all "
                "channels from one source)",
            ),
            partial(shifted, channels=one, seconds=delay),
            severity="warning", seconds=delay, joints=numbers,
        )  # fmt: skip
    slow = lag.value
    if slow > (1 if every else 2) * _SMALLEST_DELAY:
        others = "the positions have not." if every else "the other torques have not."
        yield propose(
            lag, 2 if every else 3,
            (
                "torque filter" if every else "channel filter", where,
                f"{of} {'have' if every else 'has'} passed a causal low-pass of {_hertz(slow)}; "
                + others,
                f"log {'the torques' if every else f'tau{joints[0] + 1}'} unfiltered, or filter every "
                "channel alike and without lag",
            ),
            None, severity="warning", seconds=slow, joints=numbers,
        )  # fmt: skip


def _lead(channels: Array, order: int) -> Number:
    """A delay (order 2) or a lag (order 1) of the channels (n,) that are 1.

    Where a joint sticks its torque is early or late by itself. That of one channel alone is what its
    joint's friction may look like: only a large one tells.
    """
    least = LEAST if channels.all() else ENOUGH
    return Number(
        0.0, lambda x: lambda p: p.with_lead(x * channels, order), least=least,
        where=lambda p: p.sliding,
    )  # fmt: skip


def _scaled(run: Measurements, scale: Array) -> Measurements:
    return replace(run, tau=run.tau * scale)


def _hertz(seconds: float) -> str:
    return f"{1.0 / (2.0 * np.pi * seconds):.2g} Hz ({1e3 * seconds:.0f} ms)"


def shifted(run: Measurements, channels: Array, seconds: float) -> Measurements:
    """Torques that are 1 in channels (n,) ``seconds`` earlier; rows at the end that lose theirs go."""
    t = run.t
    keep = (t + seconds >= t[0]) & (t + seconds <= t[-1])
    earlier = np.column_stack([np.interp(t[keep] + seconds, t, x) for x in run.tau.T])
    return replace(run.rows(keep), tau=np.where(channels == 1.0, earlier, run.tau[keep]))


def weight(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """The weight of the arm taken out of one channel, or of all, by the controller."""
    robot = physics.model.robot
    if not any(robot.gravity):
        return
    n = physics.n
    groups = [*([j] for j in range(n)), list(range(n))]
    for joints in groups:
        number = _weightless(np.isin(np.arange(n), joints))
        tried = settled(number.at(x - 1.0)(physics) for x in _WEIGHTS[:-1])
        if min(e.score for e in tried) > physics.evidence.score - LEAST:
            continue
        x = 1.0 + number.fitted(physics, [x - 1.0 for x in _WEIGHTS]).value
        x = 0.0 if abs(x) < 0.03 else x
        if not _WEIGHTS[0] + 0.01 < x < 0.7:
            continue  # at the edge of what is tried there is no minimum
        every = len(joints) == n
        gone = f"{100.0 * (1.0 - x):.0f} % of the weight is"
        of = "the torques" if every else f"the torque of {joints_text(joints)}"
        gx, gy, gz = (float(round(x * v, 3)) + 0.0 for v in robot.gravity)
        how = "log the torques before gravity compensation"
        if every:
            how += f", or identify with --gravity {gx:g},{gy:g},{gz:g}"
        texts = ("gravity removed", joints_text(joints), f"{gone} missing from {of}.", how)
        yield propose(
            replace(number, value=x - 1.0), 2, texts, None,
            gravity=(gx, gy, gz) if every else None, joints=[j + 1 for j in joints], share_left=x,
            gross=x < _MOSTLY_GONE,
        )  # fmt: skip


def _weightless(joints: NDArray[np.bool_]) -> Number:
    """The change of the share of the weight that these joints' channels hold."""
    return Number(0.0, lambda x: lambda p: p.with_weight(np.where(joints, 1.0 + x, 1.0)))
