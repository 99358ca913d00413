"""Rules about what channels can show: idle joints, dead and clipped torque, coarse steps, rates."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.checks.constants import SAMPLES_A_PERIOD, STUCK, TIMES, TYPICAL
from sdp_vs_penalty.checks.issue import Issue, joints_text
from sdp_vs_penalty.checks.rules import Glance, lattice_step
from sdp_vs_penalty.data.plausibility import beside_range
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.preprocessing import Preprocessing, low_passed
from sdp_vs_penalty.signals.runs import spans
from sdp_vs_penalty.signals.spectrum import highest_harmonic

_READ, _STILL = "certain: read from the file", "certain: the positions change by noise only"


def idle(g: Glance) -> Iterator[Issue]:
    """Joints that never move, or all of them."""
    joints = np.flatnonzero(~g.moving)
    if len(joints) == g.run.n:
        yield Issue(
            "no motion", "error", "all joints",
            "no joint moves: these data contain only static friction and the weight in one pose.",
            _STILL, "record a motion of all joints",
        )  # fmt: skip
    elif len(joints):
        yield Issue(
            "idle joints", "warning", joints_text(joints),
            f"{joints_text(joints)} never moves: friction and inertia about that axis are not "
            "identifiable, and the torque there is stiction.", _STILL,
            "move every joint, or add a run that does", None, {"joints": (joints + 1).tolist()},
        )  # fmt: skip


def beside(g: Glance) -> Iterator[Issue]:
    if joints := beside_range(g.robot, g.run.q):
        yield Issue(
            "encoder offset", "warning", joints_text(joints),
            f"{joints_text(joints)}: positions outside the range all or part of the time.",
            "certain: outside what the joint can reach",
            "correct the zeros of these joints: the travel fits the range", None,
            {"joints": [j + 1 for j in joints]},
        )  # fmt: skip


def dead(g: Glance) -> Iterator[Issue]:
    """Torque channels that never change."""
    for j in np.flatnonzero(np.ptp(g.run.tau, axis=0) == 0.0).tolist():
        yield Issue(
            "dead channel", "error", f"tau{j + 1}",
            f"tau{j + 1} is {g.run.tau[0, j]:g} {g.robot.torque_units[j]} in every row.", _READ,
            "find out why the logger wrote a constant", None,
            {"joints": [j + 1], "value": float(g.run.tau[0, j])},
        )  # fmt: skip


def magnitude(g: Glance) -> Iterator[Issue]:
    """Torques that are never negative because their sign is lost: they come down to zero and turn there,
    without slowing down before."""
    joints = [j for j in np.flatnonzero(g.moving).tolist() if _mirrored(g.run.tau[:, j])]
    if joints:
        where = ", ".join(f"tau{j + 1}" for j in joints)
        yield Issue(
            "torque magnitude", "error", where,
            f"{where} never changes sign: the logger wrote magnitudes.",
            "likely: a torque passes through zero, and does not turn round there",
            "log the torque with its sign", None, {"joints": [j + 1 for j in joints]},
        )  # fmt: skip


def _mirrored(x: Array) -> bool:
    if x.min() < 0.0 or np.ptp(x) == 0.0 or x.min() > 0.01 * x.max():
        return False
    low = spans(x < 0.05 * x.max())
    low = low[(low[:, 0] > 3) & (low[:, 1] < len(x) - 4)]
    slope = np.abs(x[low[:, 0] - 3] - x[low[:, 0]]) / 3.0
    way = np.array([np.abs(np.diff(x[a:b])).sum() / max(b - a, 1) for a, b in low])
    return len(low) >= 3 and bool(np.mean(way > 0.5 * slope) > 0.5)


def clipped(g: Glance) -> Iterator[Issue]:
    """A torque that stays exactly at its largest value while it is never constant elsewhere."""
    for j, x in enumerate(g.run.tau.T):
        parts = spans(np.diff(x) == 0.0)
        if not len(parts) or not np.ptp(x):
            continue
        lengths, values = np.diff(parts)[:, 0] + 1, x[parts[:, 0]]
        ends = np.isin(values, (x.min(), x.max()))
        elsewhere, k = int(lengths[~ends].max(initial=1)), int(np.argmax(lengths * ends))
        if ends[k] and lengths[k] >= max(TIMES * elsewhere, STUCK):
            samples = int(np.sum(x == values[k]))
            yield Issue(
                "saturation", "warning", f"tau{j + 1}",
                f"tau{j + 1} is stuck at {values[k]:.6g} {g.robot.torque_units[j]} for up to "
                f"{lengths[k]} consecutive samples ({samples} in total): the channel is clipped.",
                f"likely: elsewhere it is never constant for more than {elsewhere} samples",
                "record again with a larger range, or slower; delete those rows until then", None,
                {"joint": j + 1, "limit": float(values[k]), "elsewhere": elsewhere}
                | {"longest": int(lengths[k]), "samples": samples},
            )  # fmt: skip


def quantised(g: Glance, settings: Preprocessing) -> Iterator[Issue]:
    """Noise from rounding, in the band that identification uses, beside the signal itself."""
    assert settings.state_cutoff is not None
    cutoff, robot = settings.state_cutoff, g.robot
    motion, tau = low_passed(g.run, settings, 500)
    # A second derivative weighs the power of rounding errors with (2 pi f)^4.
    twice = (2.0 * np.pi * cutoff) ** 2 / np.sqrt(5.0)
    signals = {
        "q": (motion.ddq, twice, "acceleration", robot.position_units),
        "tau": (tau, 1.0, "torque", robot.torque_units),
    }
    for name, j, x in (c for c in g.channels if g.moving[c[1]]):
        signal, weight, seen, units = signals[name.rstrip("0123456789")]
        step, size = lattice_step(x), float(np.std(signal[:, j]))
        # They renew themselves when the level changes; the part below the cut-off stays.
        lasts = g.step * len(x) / max(int(np.count_nonzero(np.diff(x))), 1)
        noise = weight * step / np.sqrt(12.0) * np.sqrt(min(1.0, 2.0 * cutoff * lasts))
        if step > 0.0 and size > 0.0 and noise >= TYPICAL["link"] * size:
            yield Issue(
                "quantisation", "warning", name,
                f"{name} is quantised in steps of {step:.3g} {units[j]}, which adds noise of about "
                f"{100.0 * noise / size:.0f} % of the {seen} below {cutoff:.3g} Hz.",
                "likely: the steps are read from the file, the noise is estimated",
                "log more digits, or move faster", None,
                {"joint": j + 1, "step": step, "percent": 100.0 * noise / size},
            )  # fmt: skip


def sample_rate(g: Glance) -> Iterator[Issue]:
    """Whether the motion's fastest part is sampled often enough to be differentiated twice."""
    rate, highest = 1.0 / g.step, highest_harmonic(g.run)
    if rate < (needed := SAMPLES_A_PERIOD * highest):
        yield Issue(
            "low sample rate", "warning", "column t",
            f"the motion reaches {highest:.3g} Hz, and {rate:.3g} samples per second are too few to "
            f"differentiate it twice: {needed:.0f} Hz are needed.",
            "certain: from the spectrum of the positions", "log faster, or move slower", None,
            {"rate_hz": rate, "highest_hz": highest, "needed": needed},
        )  # fmt: skip
