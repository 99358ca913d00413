"""Rules about what channels can show: standing joints, dead and clipped torque, coarse steps, rates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.checks.constants import CLIPPED, COARSE, LONG, MIRRORED, SAMPLES_A_PERIOD
from sdp_vs_penalty.checks.glance import Glance, constant_parts, evened, lattice_step
from sdp_vs_penalty.checks.issue import Issue, joints_text
from sdp_vs_penalty.checks.words import said
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.plausibility import beside_range, check_plausible, extremes, far_outside
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.low_passed import low_passed
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.runs import spans
from sdp_vs_penalty.signals.spectrum import highest_harmonic

#: Names of constant ratios of a velocity channel to the derivative of its position, within a tenth.
_RATIOS = {
    1.0: "", 180.0 / np.pi: "degrees per second", 30.0 / np.pi: "revolutions per minute",
    -1.0: "the other direction",
}  # fmt: skip


def idle(g: Glance) -> Iterator[Issue]:
    """Joints, and times, at which nothing moves."""
    if len(joints := np.flatnonzero(~g.moving)):
        yield said("idle joints", joints_text(joints), joints=(joints + 1).tolist())
    share = 1.0 - float(g.movement.moves.mean())
    if share > 0.01:
        seconds = share * float(g.run.t[-1] - g.run.t[0])
        severity = "warning" if share > 0.5 else "note"
        yield said("stand-still", f"{100.0 * share:.0f} % of the run", None, severity, seconds=seconds)


def dead(g: Glance) -> Iterator[Issue]:
    """Torque channels that never change, and that are never negative because their sign is lost."""
    tau = g.run.tau
    for j in np.flatnonzero(np.ptp(tau, axis=0) == 0.0).tolist():
        unit = g.robot.torque_units[j]
        yield said("dead channel", f"tau{j + 1}", joints=[j + 1], value=float(tau[0, j]), unit=unit)
    moving = np.flatnonzero(g.moving).tolist()
    every = len(moving) > 2 and all(tau[:, j].min() >= 0.0 for j in moving)
    joints = [j for j in moving if every or _mirrored(tau[:, j])]
    if joints:
        named = ", ".join(f"tau{j + 1}" for j in joints)
        yield said("torque magnitude", named, joints=[j + 1 for j in joints])


def _mirrored(x: Array) -> bool:
    """Whether a channel comes down to zero and turns there, without slowing down before."""
    if x.min() < 0.0 or np.ptp(x) == 0.0 or x.min() > 0.01 * x.max():
        return False
    low = spans(x < 0.05 * x.max())
    low = low[(low[:, 0] > 3) & (low[:, 1] < len(x) - 4)]
    slope = np.abs(x[low[:, 0] - 3] - x[low[:, 0]]) / 3.0
    way = np.array([np.abs(np.diff(x[a:b])).sum() / max(b - a, 1) for a, b in low])
    return len(low) >= 3 and bool(np.mean(way > 0.5 * slope) > MIRRORED)


def clipped(g: Glance) -> Iterator[Issue]:
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
            yield said(
                "saturation", f"tau{j + 1}, rows {start + 2} to {start + 1 + longest}{more}",
                channel=f"tau{j + 1}", joint=j + 1, limit=float(limit), unit=g.robot.torque_units[j],
                longest=longest, samples=count, elsewhere=elsewhere,
            )  # fmt: skip


def quantised(g: Glance, settings: Preprocessing) -> Iterator[Issue]:
    """Noise from rounding, in the band that identification uses, beside the signal itself."""
    assert settings.state_cutoff is not None
    cutoff, dt, run = settings.state_cutoff, g.step, g.run
    motion, tau = low_passed(run, settings, 500)
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
                yield said(
                    "quantisation", f"{name}{j + 1}", joint=j + 1, step=step, unit=units[j],
                    hertz=cutoff, percent=100.0 * noise / size,
                    seen="acceleration" if name == "q" else "torque",
                )  # fmt: skip


def sample_rate(g: Glance) -> Iterator[Issue]:
    """Whether the motion's fastest part is sampled often enough to be differentiated twice.

    Stamps of a coarse clock make a motion look fast: it has to be as fast over the row number.
    """
    rate, highest = 1.0 / g.step, highest_harmonic(g.run)
    if rate < SAMPLES_A_PERIOD * highest:
        highest = min(highest, highest_harmonic(evened(g.run, LONG * g.step)))
    needed = SAMPLES_A_PERIOD * highest
    if rate < needed:
        yield said("low sample rate", "column t", rate_hz=rate, highest_hz=highest, needed=needed)


def velocity(g: Glance, settings: Preprocessing) -> Iterator[Issue]:
    """Measured velocities beside the derivative of the positions; identification uses the latter."""
    if g.run.dq is None:
        return
    motion, measured = low_passed(replace(g.run, tau=g.run.dq), settings, 500)
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
        yield said(
            "velocity channel", ", ".join(f"dq{j + 1}" for j in joints), rescaled, name=name,
            sure=how[0], remedy=how[1], joints=[j + 1 for j in joints], factors=scale[joints].tolist(),
        )  # fmt: skip


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
        what = f"{joints_text(joints)} is outside its range all or part of the time."
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
