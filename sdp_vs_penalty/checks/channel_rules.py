"""Rules about what channels can show: standing joints, dead and clipped torque, coarse steps, rates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.checks.constants import CLIPPED, COARSE, LONG, MIRRORED, SAMPLES_A_PERIOD
from sdp_vs_penalty.checks.glance import Glance, constant_parts, evened, lattice_step
from sdp_vs_penalty.checks.issue import Finding, Issue, Rule, joints_text
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.plausibility import beside_range, check_plausible, extremes, far_outside
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.preprocessing import low_passed
from sdp_vs_penalty.signals.runs import spans
from sdp_vs_penalty.signals.spectrum import highest_harmonic

#: Names of constant ratios of a velocity channel to the derivative of its position, within a tenth.
_RATIOS = {
    1.0: "", 180.0 / np.pi: "degrees per second", 30.0 / np.pi: "revolutions per minute",
    -1.0: "the other direction",
}  # fmt: skip


def idle(g: Glance) -> Iterator[Finding]:
    if len(joints := np.flatnonzero(~g.moving)):
        yield joints_text(joints), None, {"joints": (joints + 1).tolist()}


def stand_still(g: Glance) -> Iterator[Finding]:
    share = 1.0 - float(g.movement.moves.mean())
    if share > 0.01:
        seconds, grave = share * float(g.run.t[-1] - g.run.t[0]), "warning" if share > 0.5 else "note"
        yield f"{100.0 * share:.0f} % of the run", None, {"seconds": seconds, "severity": grave}


def dead(g: Glance) -> Iterator[Finding]:
    """Torque channels that never change."""
    for j in np.flatnonzero(np.ptp(g.run.tau, axis=0) == 0.0).tolist():
        figures = {"value": float(g.run.tau[0, j]), "unit": g.robot.torque_units[j]}
        yield f"tau{j + 1}", None, {"joints": [j + 1], **figures}


def magnitude(g: Glance) -> Iterator[Finding]:
    """Torques that are never negative because their sign is lost."""
    tau, moving = g.run.tau, np.flatnonzero(g.moving).tolist()
    every = len(moving) > 2 and all(tau[:, j].min() >= 0.0 for j in moving)
    joints = [j for j in moving if every or _mirrored(tau[:, j])]
    if joints:
        yield ", ".join(f"tau{j + 1}" for j in joints), None, {"joints": [j + 1 for j in joints]}


def _mirrored(x: Array) -> bool:
    """Whether a channel comes down to zero and turns there, without slowing down before."""
    if x.min() < 0.0 or np.ptp(x) == 0.0 or x.min() > 0.01 * x.max():
        return False
    low = spans(x < 0.05 * x.max())
    low = low[(low[:, 0] > 3) & (low[:, 1] < len(x) - 4)]
    slope = np.abs(x[low[:, 0] - 3] - x[low[:, 0]]) / 3.0
    way = np.array([np.abs(np.diff(x[a:b])).sum() / max(b - a, 1) for a, b in low])
    return len(low) >= 3 and bool(np.mean(way > 0.5 * slope) > MIRRORED)


def clipped(g: Glance) -> Iterator[Finding]:
    """A torque that stays exactly at its largest value while it is never constant elsewhere."""
    for j, x in enumerate(g.run.tau.T):
        parts = constant_parts(x)
        lengths = np.diff(parts)[:, 0] + 1 if len(parts) else np.zeros(0)
        ends = np.isin(x[parts[:, 0]], (x.min(), x.max())) if len(parts) else lengths > 0
        elsewhere = int(lengths[~ends].max(initial=1))
        for limit in (x.max(), x.min()) if np.ptp(x) else ():
            at = x[parts[:, 0]] == limit if len(parts) else ends
            longest = int(lengths[at].max(initial=0))
            if longest < max(CLIPPED[1] * elsewhere, CLIPPED[0]):
                continue
            start, count = int(parts[at][np.argmax(lengths[at]), 0]), int(np.sum(x == limit))
            more = f" and {count - longest} more rows" if count > longest else ""
            yield f"tau{j + 1}, rows {start + 2} to {start + 1 + longest}{more}", None, {
                "channel": f"tau{j + 1}", "joint": j + 1, "limit": float(limit), "longest": longest,
                "unit": g.robot.torque_units[j], "samples": count, "elsewhere": elsewhere,
            }  # fmt: skip


def quantised(g: Glance) -> Iterator[Finding]:
    """Noise from rounding, in the band that identification uses, beside the signal itself."""
    assert g.settings.state_cutoff is not None
    cutoff, dt, run = g.settings.state_cutoff, g.step, g.run
    motion, tau = low_passed(run, g.settings, 500)
    for name, values, signal in (("q", run.q, motion.ddq), ("tau", run.tau, tau)):
        for j in np.flatnonzero(g.moving).tolist():
            step, size = lattice_step(values[:, j]), float(np.std(signal[:, j]))
            # Rounding errors renew themselves when the level changes; of their power the part below the
            # cut-off stays, and a second derivative weighs it with (2 pi f)^4.
            lasts = dt * len(run.t) / max(int(np.count_nonzero(np.diff(values[:, j]))), 1)
            noise = step / np.sqrt(12.0) * np.sqrt(min(1.0, 2.0 * cutoff * lasts))
            noise *= (2.0 * np.pi * cutoff) ** 2 / np.sqrt(5.0) if name == "q" else 1.0
            if step > 0.0 and size > 0.0 and noise >= COARSE * size:
                units = g.robot.position_units if name == "q" else g.robot.torque_units
                yield f"{name}{j + 1}", None, {
                    "joint": j + 1, "step": step, "unit": units[j], "hertz": cutoff,
                    "percent": 100.0 * noise / size, "seen": "acceleration" if name == "q" else "torque",
                }  # fmt: skip


def sample_rate(g: Glance) -> Iterator[Finding]:
    """Whether the motion's fastest part is sampled often enough to be differentiated twice.

    Stamps of a coarse clock make a motion look fast: it has to be as fast over the row number.
    """
    rate, highest = 1.0 / g.step, highest_harmonic(g.run)
    if rate < SAMPLES_A_PERIOD * highest:
        highest = min(highest, highest_harmonic(evened(g.run, LONG * g.step)))
    needed = SAMPLES_A_PERIOD * highest
    if rate < needed:
        yield "column t", None, {"rate_hz": rate, "highest_hz": highest, "needed": needed}


def velocity(g: Glance) -> Iterator[Finding]:
    """Measured velocities beside the derivative of the positions; identification uses the latter."""
    if g.run.dq is None:
        return
    motion, measured = low_passed(replace(g.run, tau=g.run.dq), g.settings, 500)
    wrong: dict[tuple[str, float], list[int]] = {}
    for j in np.flatnonzero(g.moving).tolist():
        own, other = motion.dq[:, j], measured[:, j]
        ratio = float(own @ other) / max(float(own @ own), 1e-300)
        left = float(np.linalg.norm(other - ratio * own) / max(float(np.linalg.norm(other)), 1e-300))
        known = next((k for k in _RATIOS if abs(ratio / k - 1.0) < 0.1), ratio)
        if left > 0.3:
            wrong.setdefault(("not the velocity of that joint", 0.0), []).append(j)
        elif known != 1.0:
            name = _RATIOS.get(known, f"{ratio:.4g} times the velocity of the joint (a gear?)")
            wrong.setdefault((name, known), []).append(j)
    for (name, known), joints in wrong.items():
        scale = np.ones(g.run.n)
        scale[joints] = 1.0 / (known or 1.0)

        def rescaled(r: Measurements, known: float = known, scale: Array = scale) -> Measurements:
            return replace(r, dq=r.dq * scale if known and r.dq is not None else None)

        how = ("certain: compared over the whole run", "rescale the channel") if known else (
            "likely: they do not agree", "delete the dq columns; identification differentiates q"
        )  # fmt: skip
        figures = {"name": name, "sure": how[0], "remedy": how[1], "joints": [j + 1 for j in joints]}
        named = ", ".join(f"dq{j + 1}" for j in joints)
        yield named, rescaled, figures | {"factors": scale[joints].tolist()}


def implausible(g: Glance) -> Iterator[Issue]:
    """What an identification would refuse, whatever the fit says of it; joints beside their range."""
    robot, run = g.robot, g.run
    beside = list(beside_range(robot, run.q))
    kind, severity, joints = "encoder offset", "warning", beside
    what, remedy = "", "correct the zeros of these joints: the travel fits the range"
    try:
        check_plausible(robot, run)
        if not beside:
            return
        what = f"{joints_text(joints)}: positions outside the range all or part of the time."
    except InputError as error:
        severity, what = "error", f"{error.what.rstrip('.')}."
        if not beside:
            ends = zip(*extremes(run.q), robot.joints, strict=True)
            joints = [j for j, (low, high, joint) in enumerate(ends) if far_outside(low, high, joint)]
            reach = np.ptp(run.q, axis=0) * np.pi / 360.0
            degrees = [j for j in joints if robot.joints[j].kind == "revolute" and reach[j] < np.pi]
            kind, joints = "position unit" if degrees else "position range", degrees or joints
            remedy = error.remedy or "choose the problem that belongs to this file"
    yield Issue(
        kind, severity, joints_text(joints) if joints else "positions", what,
        "certain: outside what the joint can reach", remedy, None, {"joints": [j + 1 for j in joints]},
    )  # fmt: skip


_READ, _STILL = "certain: read from the file", "certain: the positions change by noise only"
NO_MOTION = Rule(
    "no motion", "error", "no joint moves: these data contain only static friction and the weight "
    "in one pose.", _STILL, "record a motion of all joints",
    lambda g: iter([("all joints", None, {})]),
)  # fmt: skip
DEAD = Rule(
    "dead channel", "error", "{where} is {value:g} {unit} in every row.", _READ,
    "find out why the logger wrote a constant", dead,
)  # fmt: skip
MAGNITUDE = Rule(
    "torque magnitude", "error", "{where} never changes sign: the logger wrote magnitudes.",
    "likely: a torque passes through zero, and does not turn round there",
    "log the torque with its sign", magnitude,
)  # fmt: skip
IDLE = Rule(
    "idle joints", "warning", "{where} never moves: friction and inertia about that axis are "
    "not identifiable, and the torque there is stiction.", _STILL, "move every joint, or add "
    "a run that does", idle,
)  # fmt: skip
STAND_STILL = Rule(
    "stand-still", "note", "the arm stands still for {seconds:.3g} s in total; these rows are "
    "not used.", "certain: no joint moves for half a second", "no action needed, or record a "
    "longer motion", stand_still,
)  # fmt: skip
VELOCITY = Rule(
    "velocity channel", "warning", "{where}: {name}, compared with the derivative of the "
    "position.", "{sure}", "{remedy}", velocity,
)  # fmt: skip
SATURATION = Rule(
    "saturation", "warning", "{channel} is stuck at {limit:.6g} {unit} for up to {longest} "
    "consecutive samples ({samples} in total): the channel is clipped.", "likely: elsewhere "
    "it is never constant for more than {elsewhere} samples", "record again with a larger "
    "range, or slower; delete those rows until then", clipped,
)  # fmt: skip
QUANTISATION = Rule(
    "quantisation", "warning", "{where} is quantised in steps of {step:.3g} {unit}, which "
    "adds noise of about {percent:.0f} % of the {seen} below {hertz:.3g} Hz.",
    "likely: the steps are read from the file, the noise is estimated", "log more digits, or "
    "move faster; a lower cut-off helps a little", quantised,
)  # fmt: skip
RATE = Rule(
    "low sample rate", "warning", "the motion reaches {highest_hz:.3g} Hz, and {rate_hz:.3g} "
    "samples per second are too few to differentiate it twice: {needed:.0f} Hz are needed.",
    "certain: from the spectrum of the positions", "log faster, or move slower", sample_rate,
)  # fmt: skip
