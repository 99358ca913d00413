"""Rules about what channels can show: standing joints, dead and clipped torque, coarse steps, rates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from sdp_vs_penalty.checks.glance import Glance, constant_parts, lattice_step
from sdp_vs_penalty.checks.issue import Issue, joints_text
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.plausibility import beside_range, check_plausible, extremes, far_outside
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.low_passed import low_passed
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.runs import spans
from sdp_vs_penalty.signals.spectrum import highest_harmonic

_READ = "certain: read from the file"
#: Noise of quantisation above this share of the signal is worth a warning.
_COARSE = 0.05
#: A clipped channel stays at its end for so many samples, and so many times longer than at any other
#: value.
_CLIP, _TIMES = 10, 3.0
#: The filters need so many samples a period of the fastest motion.
_SAMPLES = 30.0
#: A mirrored torque turns at zero as fast as it came, in this share of its approaches at least.
_MIRRORED = 0.6


def idle(g: Glance) -> Iterator[Issue]:
    """Joints, and times, at which nothing moves."""
    if (still := ~g.moving).any():
        joints = np.flatnonzero(still)
        yield Issue(
            "idle joints", "warning", joints_text(joints),
            f"{joints_text(joints)} never {'moves' if len(joints) == 1 else 'move'}: friction and "
            f"inertia "
            "about that axis are not identifiable, and the torque there is stiction.",
            "certain: the positions change by noise only", "move every joint, or add a run that does",
            None, {"joints": (joints + 1).tolist()},
        )  # fmt: skip
    share = 1.0 - float(g.movement.moves.mean())
    if share > 0.01:
        seconds, most = share * float(g.run.t[-1] - g.run.t[0]), share > 0.5
        yield Issue(
            "stand-still", "warning" if most else "note", f"{100.0 * share:.0f} % of the run",
            f"the arm stands still for {seconds:.3g} s in total; these rows are not used.",
            "certain: no joint moves for half a second",
            "cut these rows off, or record a longer motion" if most else "no action needed", None,
            {"share": share, "seconds": seconds},
        )  # fmt: skip


def dead(g: Glance) -> Iterator[Issue]:
    """Torque channels that never change, and that are never negative because their sign is lost."""
    tau, units = g.run.tau, g.robot.torque_units
    for j in np.flatnonzero(np.ptp(tau, axis=0) == 0.0).tolist():
        yield Issue(
            "dead channel", "error", f"tau{j + 1}", f"tau{j + 1} is {tau[0, j]:g} {units[j]} in "
            f"every row.",
            _READ, "find out why the logger wrote a constant", None,
            {"joint": j + 1, "value": float(tau[0, j])},
        )  # fmt: skip
    moving = np.flatnonzero(g.moving).tolist()
    every = len(moving) > 2 and all(tau[:, j].min() >= 0.0 for j in moving)
    joints = [j for j in moving if every or _mirrored(tau[:, j])]
    if joints:
        named = ", ".join(f"tau{j + 1}" for j in joints)
        yield Issue(
            "torque magnitude", "error", named,
            f"{named} never {'changes' if len(joints) == 1 else 'change'} sign: the logger wrote "
            f"magnitudes.",
            "likely: a torque passes through zero, and does not turn round there",
            "log the torque with its sign", None, {"joints": [j + 1 for j in joints]},
        )  # fmt: skip


def _mirrored(x: Array) -> bool:
    """Whether a channel comes down to zero and turns there, without slowing down before."""
    if x.min() < 0.0 or np.ptp(x) == 0.0 or x.min() > 0.01 * x.max():
        return False
    low = spans(x < 0.05 * x.max())
    low = low[(low[:, 0] > 3) & (low[:, 1] < len(x) - 4)]
    if len(low) < 3:
        return False
    slope = np.abs(x[low[:, 0] - 3] - x[low[:, 0]]) / 3.0
    way = np.array([np.abs(np.diff(x[a:b])).sum() / max(b - a, 1) for a, b in low])
    return bool(np.mean(way > 0.5 * slope) > _MIRRORED)


def clipped(g: Glance) -> Iterator[Issue]:
    """A torque that stays exactly at its largest value while it is never constant elsewhere."""
    for j, x in enumerate(g.run.tau.T):
        parts = constant_parts(x)
        if not len(parts):
            continue
        lengths = parts[:, 1] - parts[:, 0] + 1
        ends = np.isin(x[parts[:, 0]], (x.min(), x.max()))
        elsewhere = int(lengths[~ends].max(initial=1))
        for side, limit in (("largest", x.max()), ("smallest", x.min())):
            at = x[parts[:, 0]] == limit
            longest = int(lengths[at].max(initial=0))
            if longest < max(_TIMES * elsewhere, _CLIP) or np.ptp(x) == 0.0:
                continue
            start = int(parts[at][np.argmax(lengths[at]), 0])
            count = int(np.sum(x == limit))
            yield Issue(
                "saturation", "warning", f"tau{j + 1}, rows {start + 2} to {start + 1 + longest}"
                + (f" and {count - longest} more rows" if count > longest else ""),
                f"tau{j + 1} is stuck at its {side} value, {limit:.6g} {g.robot.torque_units[j]}, "
                f"for up to "
                f"{longest} consecutive samples ({count} in total): the channel is clipped.",
                f"likely: elsewhere it is never constant for more than {elsewhere} samples",
                "record again with a larger range, or slower; delete those rows until then", None,
                {"joint": j + 1, "limit": float(limit), "samples": count},
            )  # fmt: skip


def quantised(g: Glance, settings: Preprocessing) -> Iterator[Issue]:
    """Noise from rounding, in the band that identification uses, beside the signal itself."""
    assert settings.state_cutoff is not None
    cutoff, dt, run = settings.state_cutoff, g.step, g.run
    motion, tau = low_passed(run, settings, 500)
    for name, values, signal in (("q", run.q, motion.ddq), ("tau", run.tau, tau)):
        for j in np.flatnonzero(g.moving).tolist():
            step, size = lattice_step(values[:, j]), float(np.std(signal[:, j]))
            if step == 0.0 or size == 0.0:
                continue
            # Rounding errors renew themselves when the level changes; of their power the part below the
            # cut-off stays, and a second derivative weighs it with (2 pi f)^4.
            lasts = dt * len(run.t) / max(int(np.count_nonzero(np.diff(values[:, j]))), 1)
            noise = step / np.sqrt(12.0) * np.sqrt(min(1.0, 2.0 * cutoff * lasts))
            if name == "q":
                noise *= (2.0 * np.pi * cutoff) ** 2 / np.sqrt(5.0)
            if noise < _COARSE * size:
                continue
            unit = (g.robot.position_units if name == "q" else g.robot.torque_units)[j]
            seen = "acceleration" if name == "q" else "torque"
            yield Issue(
                "quantisation", "warning", f"{name}{j + 1}",
                f"{name}{j + 1} is quantised in steps of {step:.3g} {unit}, which adds noise of about "
                f"{100.0 * noise / size:.0f} % of the {seen} below {cutoff:.3g} Hz.",
                "likely: the steps are read from the file, the noise is estimated",
                "log more digits, or move faster; a lower cut-off helps a little", None,
                {"joint": j + 1, "step": step, "noise_share": noise / size},
            )  # fmt: skip


def sample_rate(g: Glance) -> Iterator[Issue]:
    """Whether the motion's fastest part is sampled often enough to be differentiated twice."""
    rate, highest = 1.0 / g.step, highest_harmonic(g.run)
    if rate < _SAMPLES * highest:
        yield Issue(
            "low sample rate", "warning", "column t",
            f"the motion reaches {highest:.3g} Hz, and {rate:.3g} samples per second are too few to "
            f"differentiate it twice: {_SAMPLES * highest:.0f} Hz are needed.",
            "certain: from the spectrum of the positions", "log faster, or move slower", None,
            {"rate_hz": rate, "highest_hz": highest},
        )  # fmt: skip


#: Names of constant ratios of a velocity channel to the derivative of its position, within a tenth.
_RATIOS = {
    1.0: "", 180.0 / np.pi: "degrees per second", 30.0 / np.pi: "revolutions per minute",
    -1.0: "the other direction",
}  # fmt: skip


def velocity(g: Glance, settings: Preprocessing) -> Iterator[Issue]:
    """Measured velocities beside the derivative of the positions; identification uses the latter."""
    if g.run.dq is None:
        return
    motion, measured = low_passed(replace(g.run, tau=g.run.dq), settings, 500)
    wrong: dict[tuple[str, float], list[int]] = {}
    for j in np.flatnonzero(g.moving).tolist():
        own, other = motion.dq[:, j], measured[:, j]
        ratio = float(own @ other / (own @ own))
        left = float(np.linalg.norm(other - ratio * own) / max(float(np.linalg.norm(other)), 1e-300))
        if left > 0.3:
            wrong.setdefault(("not the velocity of that joint", 0.0), []).append(j)
            continue
        known = next((k for k in _RATIOS if abs(ratio / k - 1.0) < 0.1), ratio)
        if known != 1.0:
            name = _RATIOS.get(known, f"{ratio:.4g} times the velocity of the joint (a gear?)")
            wrong.setdefault((name, known), []).append(j)
    for (name, known), joints in wrong.items():
        scale = np.ones(g.run.n)
        scale[joints] = 1.0 / (known or 1.0)
        yield Issue(
            "velocity channel", "warning", ", ".join(f"dq{j + 1}" for j in joints),
            f"the velocity of {joints_text(joints)} is {name}, compared with the derivative of the "
            "position.",
            "certain: both were compared over the whole run" if known else "likely: they do not agree",
            "rescale the channel" if known else "delete the dq columns; identification differentiates q",
            partial(_rescaled, scale=scale if known else None),
            {"joints": [j + 1 for j in joints], "factors": scale[joints].tolist()},
        )  # fmt: skip


def _rescaled(run: Measurements, scale: Array | None) -> Measurements:
    return replace(run, dq=None if run.dq is None or scale is None else run.dq * scale)


def implausible(g: Glance) -> Iterator[Issue]:
    """What an identification would refuse, whatever the fit says of it; joints beside their range."""
    robot, run = g.robot, g.run
    beside = list(beside_range(robot, run.q))
    try:
        check_plausible(robot, run)
        if not beside:
            return
        kind, severity, joints = "encoder offset", "warning", beside
        what, remedy = f"{joints_text(joints)} is outside its range all or part of the time.", ""
    except InputError as error:
        low, high = extremes(run.q)
        far = [j for j, joint in enumerate(robot.joints) if far_outside(low[j], high[j], joint)]
        reach = 0.5 * (high - low) * np.pi / 180.0
        degrees = [j for j in far if robot.joints[j].kind == "revolute" and reach[j] < np.pi]
        kind = "encoder offset" if beside else "position unit" if degrees else "position range"
        joints = beside or degrees or far
        severity, what, remedy = "error", f"{error.what.rstrip('.')}.", error.remedy or ""
    if beside:
        remedy = f"correct the zero of {joints_text(joints)}: the travel fits the range"
    yield Issue(
        kind, severity, joints_text(joints) if joints else "positions", what,
        "certain: outside what the joint can reach",
        remedy or "convert degrees to radians, or choose the problem that belongs to this file",
        None, {"joints": [j + 1 for j in joints]},
    )  # fmt: skip


def no_motion() -> Issue:
    """For a run in which no joint moves."""
    return Issue(
        "no motion", "error", "all joints",
        "no joint moves: these data contain only static friction and the weight in one pose.",
        "certain: the positions change by noise only", "record a motion of all joints",
    )  # fmt: skip
