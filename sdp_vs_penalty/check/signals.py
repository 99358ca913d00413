"""Channels one by one: saturation, quantisation, stand-still, sample rate, measured velocity."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check.issue import Issue, Repair, joints_text
from sdp_vs_penalty.check.physics import Physics
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.plausibility import beside_range, check_plausible, extremes, far_outside
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.low_passed import low_passed
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.runs import movement, moving_joints, spans
from sdp_vs_penalty.signals.spectrum import highest_harmonic

#: Noise of quantisation above this share of the signal is worth a warning.
_COARSE = 0.05
#: A clipped channel stays at its extreme this many times longer than it is constant anywhere else.
_STUCK = 3.0
_SHORTEST_CLIP = 10  # samples


def find(run: Measurements, robot: Robot, settings: Preprocessing) -> Iterator[Issue]:
    """Problems of single channels; ``settings`` resolved."""
    yield from _stand_still(run, settings)
    yield from velocity(run, settings)
    yield from _saturation(run, robot)
    yield from _quantisation(run, robot, settings)
    yield from _sample_rate(run)


def frozen(run: Measurements, physics: Physics) -> Iterator[Issue]:
    """Positions that are the same number in every row, of joints whose torque says that they move."""
    constant = np.ptp(run.q, axis=0) == 0.0
    if np.mean(moving_joints(run)) < 0.5:
        return  # joints are moved one by one, the others held
    for j in np.flatnonzero(constant):
        left = float(np.sqrt(physics.evidence.alone[j]))
        if left < _HELD:
            continue
        yield Issue(
            "frozen position", "error", f"q{j + 1}",
            f"q{j + 1} is {run.q[0, j]:g} in every row, yet {100.0 * left:.0f} % of that joint's torque "
            "is not that of a joint at rest: the position channel is frozen.",
            "likely: the torque of a joint that is held follows from the motion of the others",
            "record again with that channel; leave the run out until then", None,
            {"joints": [int(j) + 1], "unexplained": left},
        )  # fmt: skip


#: A joint at rest leaves less than this share of its torque unexplained by the others' motion.
_HELD = 0.15


def implausible(run: Measurements, robot: Robot) -> Iterator[Issue]:
    """What an identification would refuse, whatever the fit says of it; joints beside their range."""
    beside = list(beside_range(robot, run.q))
    try:
        check_plausible(robot, run)
    except InputError as error:
        low, high = extremes(run.q)
        far = [j for j, joint in enumerate(robot.joints) if far_outside(low[j], high[j], joint)]
        reach = 0.5 * (high - low) * angle_scale(robot)
        degrees = [j for j in far if robot.joints[j].kind == "revolute" and reach[j] < np.pi]
        kind = "encoder offset" if beside else "position unit" if degrees else "position range"
        joints = beside or degrees or far
        severity, what, remedy = "error", f"{error.what.rstrip('.')}.", error.remedy
    else:
        if not beside:
            return
        kind, severity, joints = "encoder offset", "warning", beside
        what = f"{joints_text(joints)} is outside its range all or part of the time."
        remedy = ""
    if beside:
        remedy = f"correct the zero of {joints_text(joints)}: the travel fits the range"
    where = joints_text(joints) if joints else "positions"
    remedy = remedy or "convert degrees to radians, or choose the problem that belongs to this file"
    sure = "certain: outside what the joint can reach"
    yield Issue(
        kind, severity, where, what, sure, remedy, None, {"joints": [j + 1 for j in joints]}
    )  # fmt: skip


def no_motion() -> Iterator[Issue]:
    """For a run in which no joint moves."""
    yield Issue(
        "no motion", "error", "all joints",
        "no joint moves: these data contain only static friction and the weight in one pose.",
        "certain: the positions change by noise only", "record a motion of all joints",
    )  # fmt: skip


def _stand_still(run: Measurements, settings: Preprocessing) -> Iterator[Issue]:
    idle = ~moving_joints(run)
    if idle.any():
        yield Issue(
            "idle joints", "warning", joints_text(np.flatnonzero(idle)),
            f"{joints_text(np.flatnonzero(idle))} never {'moves' if idle.sum() == 1 else 'move'}: "
            "friction and inertia about that axis are not identifiable, and the torque there is "
            "stiction.", "certain: the positions change by noise only",
            "move every joint, or add a run that does", None,
            {"joints": (np.flatnonzero(idle) + 1).tolist()},
        )  # fmt: skip
    at_rest = 1.0 - float(movement(run, settings.standstill).moves.mean())
    if at_rest > 0.01:
        seconds = at_rest * (run.t[-1] - run.t[0])
        most = at_rest > 0.5
        yield Issue(
            "stand-still", "warning" if most else "note", f"{100.0 * at_rest:.0f} % of the run",
            f"the arm stands still for {seconds:.3g} s in total; these rows are not used.",
            "certain: no joint moves for half a second",
            "cut these rows off, or record a longer motion" if most else "no action needed", None,
            {"share": at_rest, "seconds": seconds},
        )  # fmt: skip


def _longest(flags: NDArray[np.bool_]) -> tuple[int, int]:
    """Length and start of the longest run of True."""
    found = spans(flags)
    if not len(found):
        return 0, 0
    start, end = found[np.argmax(found[:, 1] - found[:, 0])]
    return int(end - start), int(start)


def _saturation(run: Measurements, robot: Robot) -> Iterator[Issue]:
    """A torque that stays exactly at its largest value while it is never constant elsewhere."""
    for j, tau in enumerate(run.tau.T):
        if np.ptp(tau) == 0.0:
            yield Issue(
                "dead channel", "error", f"tau{j + 1}",
                f"tau{j + 1} is {tau[0]:g} {robot.torque_units[j]} in every row.",
                "certain: read from the file", "find out why the logger wrote a constant", None,
                {"joint": j + 1, "value": float(tau[0])},
            )  # fmt: skip
            continue
        inner = (tau > tau.min()) & (tau < tau.max())
        elsewhere, _ = _longest((np.diff(tau) == 0.0) & inner[1:])
        needed = max(_STUCK * (elsewhere + 1), _SHORTEST_CLIP)
        for side, limit in (("largest", tau.max()), ("smallest", tau.min())):
            length, start = _longest(tau == limit)
            if length < needed:
                continue
            count = int(np.sum(tau == limit))
            yield Issue(
                "saturation", "warning", f"tau{j + 1}, rows {start + 2} to {start + 1 + length}"
                + (f" and {count - length} more rows" if count > length else ""),
                f"tau{j + 1} is stuck at its {side} value, {limit:.6g} {robot.torque_units[j]}, for "
                f"up to {length} consecutive samples ({count} in total): the channel is clipped.",
                f"likely: elsewhere it is never constant for more than {elsewhere + 1} samples",
                "record again with a larger range, or slower; delete those rows until then", None,
                {"joint": j + 1, "limit": float(limit), "samples": count},
            )  # fmt: skip


def _quantisation(run: Measurements, robot: Robot, settings: Preprocessing) -> Iterator[Issue]:
    """Noise from rounding, in the band that identification uses, beside the signal itself."""
    assert settings.state_cutoff is not None
    cutoff, dt = settings.state_cutoff, float(np.median(np.diff(run.t)))
    motion, tau = low_passed(run, settings, 500)
    for name, values, signal in (("q", run.q, motion.ddq), ("tau", run.tau, tau)):
        for j in np.flatnonzero(moving_joints(run)):
            step = lattice_step(values[:, j])
            size = float(np.std(signal[:, j]))
            if step == 0.0 or size == 0.0:
                continue
            # Rounding errors renew themselves when the level changes; of their power the part
            # below the cut-off stays, and a second derivative weighs it with (2 pi f)^4.
            changes = max(int(np.count_nonzero(np.diff(values[:, j]))), 1)
            lasts = dt * len(run.t) / changes
            noise = step / np.sqrt(12.0) * np.sqrt(min(1.0, 2.0 * cutoff * lasts))
            if name == "q":
                noise *= (2.0 * np.pi * cutoff) ** 2 / np.sqrt(5.0)
            share = noise / size
            if share < _COARSE:
                continue
            unit = robot.position_units[j] if name == "q" else robot.torque_units[j]
            seen = "acceleration" if name == "q" else "torque"
            yield Issue(
                "quantisation", "warning", f"{name}{j + 1}",
                f"{name}{j + 1} is quantised in steps of {step:.3g} {unit}, which adds noise of "
                f"about {100.0 * share:.0f} % of the {seen} below {cutoff:.3g} Hz.",
                "likely: the steps are read from the file, the noise is estimated",
                "log more digits, or move faster; a lower cut-off helps a little", None,
                {"joint": int(j) + 1, "step": step, "noise_share": share},
            )  # fmt: skip


def lattice_step(values: Array) -> float:
    """The smallest step between different values of a channel, rounding errors of the file apart."""
    levels = np.unique(values)
    steps = np.diff(levels)
    steps = steps[steps > 1e-9 * (levels[-1] - levels[0])]
    return float(steps.min()) if len(steps) else 0.0


def _sample_rate(run: Measurements) -> Iterator[Issue]:
    """Whether the motion's fastest part is sampled often enough to be differentiated twice."""
    rate = 1.0 / float(np.median(np.diff(run.t)))
    highest = highest_harmonic(run)
    # The filter may reach a tenth of the rate; below three times the motion's band it bends it.
    if rate >= 30.0 * highest:
        return
    yield Issue(
        "low sample rate", "warning", "column t",
        f"the motion reaches {highest:.3g} Hz, and {rate:.3g} samples per second are too few to "
        f"differentiate it twice: {30.0 * highest:.0f} Hz are needed.",
        "certain: from the spectrum of the positions", "log faster, or move slower", None,
        {"rate_hz": rate, "highest_hz": highest},
    )  # fmt: skip


#: Names of constant ratios of a velocity channel to the derivative of its position.
_RATIOS = {
    180.0 / np.pi: "degrees per second", 30.0 / np.pi: "revolutions per minute",
    -1.0: "the other direction",
}  # fmt: skip


def velocity(run: Measurements, settings: Preprocessing) -> Iterator[Issue]:
    """Measured velocities beside the derivative of the positions; identification uses the latter."""
    if run.dq is None:
        return
    motion, measured = low_passed(replace(run, tau=run.dq), settings, 500)
    moves = moving_joints(run)
    wrong: dict[str, list[int]] = {}
    factors = np.ones(run.n)
    for j in np.flatnonzero(moves):
        own, other = motion.dq[:, j], measured[:, j]
        ratio = float(own @ other / (own @ own))
        left = float(np.linalg.norm(other - ratio * own) / max(float(np.linalg.norm(other)), 1e-300))
        if left > 0.3:
            wrong.setdefault("not the velocity of that joint", []).append(int(j))
            continue
        if abs(ratio - 1.0) < 0.1:
            continue
        for known, name in _RATIOS.items():
            if abs(ratio / known - 1.0) < 0.1:
                wrong.setdefault(name, []).append(int(j))
                factors[j] = 1.0 / known
                break
        else:
            wrong.setdefault(f"{ratio:.4g} times the velocity of the joint (a gear?)", []).append(int(j))
            factors[j] = 1.0 / ratio
    for name, joints in wrong.items():
        scale = np.ones(run.n)
        scale[joints] = factors[joints]
        mendable = bool(np.all(scale[joints] != 1.0))
        yield Issue(
            "velocity channel", "warning", ", ".join(f"dq{j + 1}" for j in joints),
            f"the velocity of {joints_text(joints)} is {name}, compared with the derivative of the "
            "position.", "certain: both were compared over the whole run" if mendable
            else "likely: they do not agree", "rescale the channel" if mendable
            else "delete the dq columns; identification differentiates q",
            _rescaled_velocity(scale) if mendable else (lambda run: replace(run, dq=None)),
            {"joints": [j + 1 for j in joints], "factors": scale[joints].tolist()},
        )  # fmt: skip


def _rescaled_velocity(scale: Array) -> Repair:
    return lambda run: replace(run, dq=None if run.dq is None else run.dq * scale)


def angle_scale(robot: Robot) -> Array:
    """(n,) what degrees have to be multiplied by: pi / 180 for revolute joints, 1 for prismatic ones."""
    return np.array([np.pi / 180.0 if j.kind == "revolute" else 1.0 for j in robot.joints])
