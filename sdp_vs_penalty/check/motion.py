"""Positions in degrees, with another sign or zero, or of other joints; a clock at another rate."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check.columns import added, interpolation, only_links
from sdp_vs_penalty.check.hypothesis import Hypothesis, Number, best_numbers, propose
from sdp_vs_penalty.check.issue import Repair, joints_text
from sdp_vs_penalty.check.physics import Physics, settled
from sdp_vs_penalty.check.signals import angle_scale
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.plausibility import beside_range
from sdp_vs_penalty.robot.arrays import Array

#: What makes hypotheses of one kind: from the test's data and which joints move.
Family = Callable[[Physics, NDArray[np.bool_]], Iterator[Hypothesis]]
#: Kind, place, sentence and remedy of an issue.
Texts = tuple[str, str, str, str]
#: Offsets of an encoder that are tried [degrees], the best one then refined.
_OFFSETS = (-90.0, -25.0, -6.0, 6.0, 25.0, 90.0, 180.0)
#: ... of a prismatic joint, as shares of the arm's length; and from which share of these on, or from how
#: many degrees, an offset is no matter of calibration.
_SHIFTS, _GROSS_SHIFT, _GROSS_DEGREES = (-0.2, -0.05, 0.05, 0.2), 0.03, 10.0
#: Offsets this near to a quarter turn are one: two conventions of the same arm [rad].
_QUARTER = 0.04
#: Factors between the file's clock and the true one that are tried; nearer to 1 is no other clock.
_RATES = (0.3, 0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.3)
_SMALLEST_RATE, _GROSS_RATE = 0.07, 0.2
#: The weight against inertia tells the clock's rate, and slow motion has little inertia.
_RATE_NEEDED = 2.0


def degrees(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """All positions in degrees, or a single one."""
    robot = physics.model.robot
    scale = angle_scale(robot)
    if np.all(scale == 1.0):
        return
    same = np.arange(robot.n)
    reach = np.abs(physics.motion.q).max(axis=0)
    largest = float(reach[scale != 1.0].max(initial=0.0))
    if largest < np.pi:
        return
    single = [k for k in np.flatnonzero(moving) if scale[k] != 1.0 and reach[k] > np.pi]
    groups = [(list(range(robot.n)), scale)]
    groups += [([int(k)], np.where(same == k, scale, 1.0)) for k in single if robot.n > 1]
    scores = [physics.with_motion(factor, same).evidence.score for _, factor in groups]
    for joints, factor in [groups[int(np.argmin(scores))]]:
        every = len(joints) == robot.n
        named = ("q1" if robot.n == 1 else f"q1 to q{robot.n}") if every else f"q{joints[0] + 1}"
        what = "the positions are" if every else f"the position of {joints_text(joints)} is"
        yield propose(
            partial(Physics.with_motion, scale=factor, order=same), 0 if every else 1, (
            "positions in degrees" if every else "position unit", named,
            f"{what} in degrees, not in radians (reaching {reach[joints].max():.4g}).",
            f"multiply q (and dq) of {'revolute joints' if every else named} by pi / 180"),
            motion_repair(factor, same), largest=largest, joints=[j + 1 for j in joints],
        )  # fmt: skip


def motion_repair(scale: Array, order: NDArray[np.intp], offset: Array | float = 0.0) -> Repair:
    def repair(run: Measurements) -> Measurements:
        dq = None if run.dq is None else scale * run.dq[:, order]
        return replace(run, q=scale * run.q[:, order] + offset, dq=dq)

    return repair


def _both(physics: Physics, scale: Array, order: NDArray[np.intp]) -> Physics:
    """Positions and torques turned or exchanged alike."""
    return physics.with_motion(scale, order).with_channels(scale, order)


def _changed(
    scale: Array, order: NDArray[np.intp], joints: list[int], alone: Texts, both: Texts
) -> Iterator[Hypothesis]:
    """The positions of joints turned or exchanged alone, or together with their torques."""
    motion, numbers = motion_repair(scale, order), [j + 1 for j in joints]

    def every(run: Measurements) -> Measurements:
        return replace(motion(run), tau=scale * run.tau[:, order])

    yield propose(
        partial(Physics.with_motion, scale=scale, order=order), 3, alone, motion, joints=numbers
    )
    yield propose(partial(_both, scale=scale, order=order), 2, both, every, joints=numbers)


def turned(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """A joint that counts the other way: its position alone, or position and torque together."""
    for j in np.flatnonzero(moving).tolist():
        name, k = joints_text([j]), j + 1
        alone = (
            "position sign", name, f"the position of {name} has the wrong sign.",
            f"flip the sign of q{k} (and dq{k})",
        )  # fmt: skip
        both = (
            "joint sign", name, f"{name} counts the other way, position and torque alike.",
            f"flip the signs of q{k}, dq{k} and tau{k}",
        )  # fmt: skip
        same = np.arange(physics.n)
        yield from _changed(np.where(same == j, -1.0, 1.0), same, [j], alone, both)


def exchanged(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """The positions of two joints exchanged, or all channels of two joints."""
    for a, b in combinations(np.flatnonzero(moving).tolist(), 2):
        order: NDArray[np.intp] = np.arange(physics.n, dtype=np.intp)
        order[[a, b]] = order[[b, a]]
        name, swap = joints_text([a, b]), f"swap q{a + 1} and q{b + 1}"
        alone = ("position order", name, f"the positions of {name} are swapped.", f"{swap} (and dq)")
        both = (
            "joint order", name, f"{name} are swapped, positions and torques alike.",
            f"{swap}, dq and tau",
        )  # fmt: skip
        yield from _changed(np.ones(physics.n), order, [a, b], alone, both)


def offsets(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """Encoders that count from another zero than the robot's kinematics."""
    robot = physics.model.robot
    at = {j: at_zeros(physics, j) for j in np.flatnonzero(moving).tolist()}

    def left(asked: Sequence[tuple[int, float]]) -> list[float]:
        return [e.misfit for e in settled(at[j](shift) for j, shift in asked)]

    length = float(robot.link_reach().sum())
    grids = {
        j: np.radians(_OFFSETS) if robot.joints[j].kind == "revolute" else length * np.array(_SHIFTS)
        for j in at
    }
    asked = [(j, x) for j, grid in grids.items() for x in grid.tolist()]
    tried = dict(zip(asked, left(asked), strict=True))
    base = physics.evidence.misfit
    best = sorted(tried, key=lambda key: tried[key])[:3]
    for j in dict.fromkeys(j for j, _ in best):
        revolute = robot.joints[j].kind == "revolute"
        coarse = min(grids[j].tolist(), key=lambda x: tried[j, x])
        if tried[j, coarse] > base - 0.3:
            continue
        wide = revolute and abs(coarse) > np.radians(60.0)
        near = [0.3 * coarse, coarse, 1.7 * coarse]
        near = [coarse + x for x in np.radians((-40.0, 0.0, 40.0)).tolist()] if wide else near
        (found,) = best_numbers(lambda wanted, j=j: left([(j, x) for _, x in wanted]), [near], 4)  # type: ignore[misc]
        quarter = 0.5 * np.pi * round(found / (0.5 * np.pi))
        found = quarter if revolute and quarter and abs(found - quarter) < _QUARTER else found
        if abs(found) > (np.radians(1.5) if revolute else 2e-3 * length):
            gross = np.radians(_GROSS_DEGREES) if revolute else _GROSS_SHIFT * length
            yield zero_offset(physics, (j,), (found,), abs(found) > gross)


def at_zeros(physics: Physics, j: int) -> Callable[[float], Physics]:
    """The data with what is to be added to joint j's position, a few regressors for all of them."""
    unit, one, same = np.eye(physics.n)[j], np.ones(physics.n), np.arange(physics.n)

    def moved(x: float) -> Physics:
        return physics.with_motion(one, same, x * unit)

    if not only_links(physics) or physics.weight is not None:
        return moved
    places, shares = interpolation(physics.model.robot.joints[j].kind)
    made = [(moved(x) if x else physics).acting for x in places]

    def at(x: float) -> Physics:
        out = replace(moved(x))
        out.__dict__["acting"] = added(zip(shares(x), made, strict=True))
        return out

    return at


def two_quarters(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """Two joints a quarter turn off at once: another convention of the same arm (DH against URDF)."""
    robot = physics.model.robot
    revolute = [int(j) for j in np.flatnonzero(moving) if robot.joints[j].kind == "revolute"]
    for pair in combinations(revolute, 2):
        for turns in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            yield zero_offset(physics, pair, tuple(0.5 * np.pi * k for k in turns))


def zero_offset(
    physics: Physics, joints: tuple[int, ...], shifts: tuple[float, ...], gross: bool = False
) -> Hypothesis:
    """shifts : what is to be added to each joint's position [rad, m]."""
    robot = physics.model.robot
    offset = np.zeros(physics.n)
    offset[list(joints)] = shifts
    one, same = np.ones(physics.n), np.arange(physics.n)
    sizes = " and ".join(
        f"{np.degrees(-x):.4g} degrees" if robot.joints[j].kind == "revolute" else f"{-x:.4g} m"
        for j, x in zip(joints, shifts, strict=True)
    )
    change = " and ".join(
        f"{x:+.5g} {robot.position_units[j]} to q{j + 1}" for j, x in zip(joints, shifts, strict=True)
    )

    shift = Number(1.0, lambda x: partial(Physics.with_motion, scale=one, order=same, offset=x * offset))
    # What brings a joint back into its range needs no other reason.
    known = beside_range(robot, physics.motion.q) == joints
    known &= not beside_range(robot, physics.motion.q + offset)
    return propose(
        shift,
        0 if known else 2 + len(joints),
        (
            "encoder offset", joints_text(joints),
            f"the zero of {joints_text(joints)} is {sizes} away from the robot's kinematics.",
            f"add {change}",
        ),
        motion_repair(one, same, offset), gross=gross, joints=[j + 1 for j in joints],
        shifts=list(shifts),
    )  # fmt: skip


def clock(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """Time stamps that run too fast or too slow: inertia and weight then belong to different arms."""
    if not any(physics.model.robot.gravity):
        return

    rate = Number(0.0, lambda x: lambda p: p.with_clock(float(np.exp(x))))
    rate = rate.fitted(physics, np.log(_RATES).tolist())
    factor = float(np.exp(rate.value))
    if abs(rate.value) < np.log1p(_SMALLEST_RATE):
        return
    word = "fast" if factor < 1.0 else "slow"
    yield propose(
        rate, 3,
        (
            "clock rate", "column t",
            f"time runs {max(factor, 1.0 / factor):.3g} times too {word}: the inertia in the "
            "torques does not fit the weight.",
            f"multiply t by {factor:.3g} (find out the log's true rate)",
        ),
        lambda run: replace(run, t=run.t[0] + factor * (run.t - run.t[0]),
                            dq=None if run.dq is None else run.dq / factor),
        needed=_RATE_NEEDED, factor=factor, gross=abs(rate.value) > np.log1p(_GROSS_RATE),
    )  # fmt: skip
