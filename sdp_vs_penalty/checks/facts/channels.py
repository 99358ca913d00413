"""Facts about the channels of a run."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.certainty import likely, told_by
from sdp_vs_penalty.checks.glance import Rows, RunSummary
from sdp_vs_penalty.checks.issue import Issue, Left, make_issue
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.plausibility import beside_range
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.results.remedy import Change
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.encoder import lattice_step, lattice_step_bound
from sdp_vs_penalty.signals.filtered import joined
from sdp_vs_penalty.signals.spectrum import highest_harmonic

#: Velocities so many times the derivative of their position [rad/s] are in degrees a
#: second: 57 times, or nearly 1; the geometric mean of the two.
_IN_DEGREES_A_SECOND = 8.0


def find_channels_without_numbers(glance: RunSummary) -> Iterator[Issue]:
    """Yield an error for each channel without a number in any row: deleting rows cannot
    help.
    """
    for name, x in glance.run.groups.items():
        for j in np.flatnonzero(~np.any(np.isfinite(x), axis=0)):
            yield make_issue(
                kind="channel without numbers",
                severity="error",
                joints=[j],
                what=f"{name}{j + 1} is never a number, in any of {len(x)} rows.",
                remedy="find out why the logger wrote none (a driver that does not"
                " report it); there is no repair",
                where=f"{name}{j + 1}",
                left=Left.NOTHING,
            )


def find_wrapped_angles(glance: RunSummary) -> Iterator[Issue]:
    """Yield an error where revolute positions jump by a full turn between two rows.

    A jump by 2 pi is a wrapped angle; by 360, the position is in degrees as well.
    """
    steps = np.abs(np.diff(glance.run.q, axis=0))
    is_revolute = _revolute_joints(glance.robot)
    in_degrees = is_revolute & _jumps_by(steps, 360.0)
    if in_degrees.any():
        yield _degrees(glance)
        return
    jumping = is_revolute & _jumps_by(steps, 2.0 * np.pi)
    if jumping.any():
        what = (
            "the position of {where} jumps by a full turn between two rows: the angle"
            " is wrapped."
        )
        yield make_issue(
            kind="wrapped angle",
            severity="error",
            joints=np.flatnonzero(jumping),
            what=what,
            remedy="unwrap the angle",
            repair=lambda r: replace(
                r, q=np.where(jumping, np.unwrap(r.q, axis=0), r.q)
            ),
        )


def _jumps_by(steps: Array, turn: float) -> Rows:
    """Return which channels (n,) jump by a turn: some of their steps (N - 1, n) is a
    turn, and the usual steps are far smaller."""
    tolerance = 0.05 * turn
    is_turn = np.abs(steps - turn) < tolerance
    return np.any(is_turn, axis=0) & (np.median(steps, axis=0) < tolerance)


def _revolute_joints(robot: Robot) -> Rows:
    """Return which joints (n,) are revolute."""
    return np.array([joint.kind == "revolute" for joint in robot.joints])


def _degrees(glance: RunSummary) -> Issue:
    """Return the error that all revolute positions are in degrees, and wrapped."""
    joints = np.flatnonzero(_revolute_joints(glance.robot))
    largest = float(np.abs(glance.run.q[:, joints]).max())
    return make_issue(
        kind="positions in degrees",
        position_unit="degrees",
        severity="error",
        joints=joints,
        what="the positions of {where} are in degrees and wrapped at 360: they reach"
        f" {largest:.4g}.",
        remedy="unwrap q and multiply it by pi / 180",
        repair=partial(_in_radians, robot=glance.robot),
    )


def _in_radians(run: Measurements, robot: Robot) -> Measurements:
    """Return the run with jumps of revolute positions by 360 degrees undone, converted to
    radians.

    Logged velocities are converted where they are in degrees a second: far larger than the
    derivative of the converted position.
    """
    is_revolute = _revolute_joints(robot)
    radians_per_degree = float(np.radians(1.0))
    unwrapped = np.unwrap(run.q, period=360.0, axis=0)
    q = _into_range(robot, unwrapped * radians_per_degree)
    q = np.where(is_revolute, q, run.q)
    if run.dq is None:
        return replace(run, q=q)
    logged = np.abs(run.dq).sum(axis=0)
    derived = np.abs(np.gradient(q, run.t, axis=0)).sum(axis=0)
    in_degrees = is_revolute & (logged > _IN_DEGREES_A_SECOND * derived)
    dq = np.where(in_degrees, run.dq * radians_per_degree, run.dq)
    return replace(run, q=q, dq=dq)


def _into_range(robot: Robot, q: Array) -> Array:
    """Return positions q (N, n) [rad] moved by whole turns, so that each joint's median
    is as near as possible to the middle of its range (to 0 where it has none)."""
    low = np.array([joint.lower for joint in robot.joints])
    high = np.array([joint.upper for joint in robot.joints])
    has_range = np.isfinite(high - low)
    middle = 0.5 * (np.where(has_range, low, 0.0) + np.where(has_range, high, 0.0))
    turns = np.round((np.median(q, axis=0) - middle) / (2.0 * np.pi))
    return q - 2.0 * np.pi * turns


def find_positions_outside_range(glance: RunSummary) -> Iterator[Issue]:
    """Yield a warning about joints whose positions leave the range, while their travel
    fits into it: the encoder's zero is the usual cause.
    """
    if joints := beside_range(glance.robot, glance.run.q):
        yield make_issue(
            kind="encoder offset",
            of_positions="zero",
            joints=joints,
            what="{where}: positions outside the range all or part of the time.",
            certainty=likely(
                "outside what the joint can reach, certainly; its zero is"
                " the usual cause"
            ),
            remedy="correct the zeros of these joints: the travel fits the range",
        )


#: Channels of no more different values are coarse, whether in counts or not.
_FEWEST_COUNTS = 20


#: Drives reach no more than this of their rated torque [permil].
_LARGEST_PERMIL = 4000.0


def find_torques_in_counts(glance: RunSummary) -> Iterator[Issue]:
    """Yield a warning where every torque is a whole number, of many different ones:
    counts of a drive, and not N m.
    """
    tau = glance.run.tau[:, glance.moving]
    if not np.all(tau == np.round(tau)):
        return
    if min(len(np.unique(x)) for x in tau.T) > _FEWEST_COUNTS:
        largest = float(np.abs(tau).max())
        unit = ", as permil of its rated torque" if largest <= _LARGEST_PERMIL else ""
        yield make_issue(
            kind="torque in counts",
            in_doubt="torque in counts",
            what=f"every torque is a whole number, up to {largest:.4g}: counts of the"
            f" drive{unit}.",
            certainty=likely(
                "the whole numbers are read from the file, not what they count"
            ),
            remedy="multiply each channel by its rated torque / 1000 (or its gain, gear"
            " ratio included); otherwise the model's ratios are right for a joint, its"
            " kilograms are not",
            where="all torque channels",
            changes=(
                Change("read", "read tau by its gains", {"scale": {"tau": None}}),
            ),
            left=Left.RATIOS,
            figures={"largest": largest},
        )


def find_coarse_sampling(glance: RunSummary) -> Iterator[Issue]:
    """Yield warnings where positions are too coarse to be differentiated twice: in
    time, for the fastest harmonic of the motion, or in their resolution; none for a run
    too short to be filtered."""
    if glance.filtered is None:
        return
    settings = glance.filtered.settings
    rate = 1.0 / glance.usual_step
    try:
        highest = highest_harmonic(glance.run)
    except InputError:  # no stretch is long enough for a spectrum
        return
    needed = c.SAMPLES_A_PERIOD * highest
    if rate < needed:
        yield make_issue(
            kind="low sample rate",
            what=f"the motion reaches {highest:.3g} Hz, and {rate:.3g} samples per second"
            f" are too few to differentiate it twice: {needed:.0f} Hz are needed.",
            certainty=told_by("from the spectrum of the positions"),
            remedy="log faster, or move slower",
            where="column t",
            figures={"rate_hz": rate, "needed": needed},
        )
    assert settings.state_cutoff is not None
    assert settings.torque_cutoff is not None
    band = min(settings.state_cutoff, settings.torque_cutoff)
    sizes = joined(glance.filtered.states()).ddq.std(axis=0)
    for j in np.flatnonzero(glance.moving).tolist():
        yield from _quantised(glance, j, float(sizes[j]), band)


def _quantised(
    glance: RunSummary, j: int, size: float, cutoff: float
) -> Iterator[Issue]:
    """Yield a warning where rounding of joint j's position spoils its acceleration: the
    error [rad/s^2, m/s^2] is too large a share of it.

    The error of rounding to steps d has variance d^2 / 12, and changes with the level,
    so that its spectrum is flat up to the rate of changes. The part below the cut-off f
    [Hz] of the filter stays. A second derivative weighs its power with (2 pi f)^4,
    whose mean over the band is a fifth of that: hence the root of 60.
    """
    x = glance.run.q[:, j]
    n_changes = max(int(np.count_nonzero(np.diff(x))), 1)
    seconds_per_level = glance.usual_step * len(x) / n_changes
    bands_of_rounding = max(1.0, 0.5 / (cutoff * seconds_per_level))
    noise_per_step = (2.0 * np.pi * cutoff) ** 2 / np.sqrt(60.0 * bands_of_rounding)
    least = c.TYPICAL["link"] * size
    if not noise_per_step * lattice_step_bound(x) > least > 0.0:
        return
    step = lattice_step(x)
    noise = noise_per_step * step
    if noise <= least:
        return
    yield make_issue(
        kind="quantisation",
        of_positions="steps",
        joints=[j],
        what=f"q{j + 1} is quantised in steps of {step:.3g} {glance.robot.position_units[j]}:"
        f" noise of about {100.0 * noise / size:.0f} % of the acceleration below"
        f" {cutoff:.3g} Hz.",
        certainty=likely("the steps are read from the file, the noise is estimated"),
        remedy="log more digits, or move faster",
        where=f"q{j + 1}",
        figures={"step": step},
    )
