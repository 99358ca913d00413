"""What may be wrong with torque channels: gain, delay, filter, weight, bends, drifts and steps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Event, Repair
from sdp_vs_penalty.checks.transformation import Element, Number, Scene, Transformation, choices

#: Factors of units, and what a channel is in whose torque has to be multiplied by one.
UNITS = {1e-3: "mN m", 1e-2: "N cm", 9.80665: "kgf m", 0.1129848: "lbf in"}
#: Factors that are tried: units, and a grid whose steps the refinement bridges.
_GAINS = (*UNITS, 0.1, 0.3, 0.6, 0.85, 1.17, 1.7, 3, 100, 1e3)
#: Delays (``lead`` of a repair) and time constants (``lag``) that are tried [s].
_LATE = {"lead": (-0.12, -0.06, -0.025, -0.01, 0.01, 0.025, 0.06, 0.12), "lag": (0.01, 0.04, 0.1, 0.2)}
#: Below this bend, the largest logged torque over the limit, a channel is as straight as sensors are.
_STRAIGHT = 0.2
#: Share of the time on either side of a step that the joint has to move each way: else it is friction's.
_WAYS = 0.15


class Gain(Transformation):
    """Channels too large or too small beside their neighbours'. A factor that all have in common is not
    seen by what joints share: see residual.py."""

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        for j in scene.joints if len(scene.joints) > 1 else ():
            yield from (now.times("gain", (j,), factor) for factor in _GAINS)

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        for j in np.flatnonzero(np.abs(repair.gain) != 1.0).tolist():
            g, sign = abs(repair.gain[j]), float(np.sign(repair.gain[j]))
            unit = next((name for u, name in UNITS.items() if abs(g / u - 1.0) < 1e-9), None)
            size = f"{1.0 / g:.3g} times too large" if g < 1.0 else f"{g:.3g} times too small"
            what = f"the torque of {joints_text([j])} is {size} beside those of its neighbours"
            at = lambda x, j=j, s=sign: repair.with_entries("gain", (j,), s * x)  # noqa: E731
            gross = c.GROSS / c.CALIBRATED * c.CALIBRATED_GAIN
            yield Element(
                "torque gain" if unit is None else "torque unit",
                "error" if abs(np.log(g)) > gross else "warning", (j,),
                f"{what}." if unit is None else f"{what}: it is in {unit}.",
                f"multiply tau{j + 1} by {g:.3g}", choices(scene.n), at(1.0),
                Number.factor(g, at, c.CALIBRATED_GAIN, 0.5, tuple(UNITS)), figures={"factor": g},
            )  # fmt: skip


class Delay(Transformation):
    """Torque later than the motion, or through a causal filter: one channel, or all."""

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        each = [(j,) for j in scene.joints] if len(scene.joints) > 1 else []
        for name, tried in _LATE.items():
            for joints in (range(scene.n), *each):
                yield from (now.with_entries(name, joints, x) for x in tried)

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        for name, joints, x in ((k, *found) for k in _LATE for found in repair.changed(k, 0.0)):
            every = len(joints) == scene.n
            channel = "the torques" if every else f"tau{joints[0] + 1}"
            beside = "the positions have not" if every else "the other torques have not"
            if name == "lead":
                kind, later = "delay", "later" if x > 0.0 else "earlier"
                what = f"{1e3 * abs(x):.0f} ms {later} than the motion: {channel}; {beside} moved."
                remedy = f"shift {channel} in time (and log all channels from one source)"
            else:
                kind, low = "filter", f"{1.0 / (2.0 * np.pi * max(x, 1e-6)):.2g} Hz ({1e3 * x:.0f} ms)"
                what = f"a causal low-pass of {low} on {channel}; {beside} one."
                remedy = f"log {channel} unfiltered, or filter every channel alike and without lag"
            at = partial(repair.with_entries, name, joints)
            yield Element(
                f"{'channel ' if not every else 'torque ' * (name == 'lag')}{kind}", "warning", joints,
                what, remedy, choices(1 if every else scene.n), at(0.0),
                Number(x, at, c.USUAL_DELAY, 0.06, lambda v: f"{1e3 * v:.0f} ms"), mends=name == "lead",
                place="all torque channels" if every and scene.n > 1 else "", figures={"seconds": x},
            )  # fmt: skip


class Weight(Transformation):
    """The arm's weight taken out of one channel, or of all, by the controller."""

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        # The weight that a wrist's last link holds is within the error of its friction's law: of one
        # channel alone it has to be half (8 s of the real Panda, tests/test_docs.py::test_the_tutorial).
        data = scene.likelihood.data
        held = np.sqrt(np.mean(scene.likelihood.nominal(now, still=True) ** 2, axis=0))
        logged = np.sqrt(np.mean(data.torque(data.motion.t) ** 2, axis=0))
        each = [(j,) for j in np.flatnonzero(held > 0.5 * logged).tolist()]
        for joints in (range(scene.n), *each) if any(now.gravity) else ():
            yield now.with_entries("weight", joints, 0.0)

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        for joints, left in repair.changed("weight", 1.0):
            at = lambda x, some=joints: repair.with_entries("weight", some, 1.0 + x)  # noqa: E731
            common = len(joints) == scene.n
            gx, gy, gz = (float(round(left * v, 3)) + 0.0 for v in repair.gravity)
            of = "the torques" if common else f"the torque of {joints_text(joints)}"
            how = f", or identify with --gravity {gx:g},{gy:g},{gz:g}" if common else ""
            yield Element(
                "gravity removed", "error", joints,
                f"{100.0 * (1.0 - left):.0f} % of the weight is missing from {of}.",
                f"log the torques before gravity compensation{how}",
                choices(1 if common else scene.n), at(0.0),
                Number(left - 1.0, at, 0.2, 0.4, lambda v: f"{-100.0 * v:.0f} %", (-1.0,)),
                mends=False, figures={"share_left": left},
            )  # fmt: skip


class Saturation(Transformation):
    """A channel that bends towards a limit: tau_log = s tanh(tau / s), an amplifier near its end."""

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        for j in scene.joints:
            yield now.with_entries("bend", (j,), 1.0 - 0.5 * _STRAIGHT)

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        for j in np.flatnonzero(repair.bend).tolist():
            x, k = repair.bend[j], repair.tau_order[j]
            limit, unit = scene.likelihood.data.largest[k] / x, scene.problem.robot.torque_units[j]
            at = lambda v, j=j: repair.with_entries("bend", (j,), float(np.clip(v, 0.0, 0.995)))  # noqa: E731
            what = f"the torque of {joints_text([j])} bends towards a limit of {limit:.3g} {unit}"
            yield Element(
                "saturation", "warning", (j,), f"{what}: its sensor or amplifier is near its end.",
                "record again with a larger range, or slower", choices(scene.n), at(0.0),
                Number(x, at, _STRAIGHT, 0.25, lambda v: f"{100.0 * v:.0f} % of the limit is reached"),
                mends=False, figures={"limit": limit},
            )  # fmt: skip


class Change(Transformation):
    """A channel that drifts with time, or that steps once: a contact, a load, a zero set anew. Proposed
    by a score test: of each shape the part that the arm leaves, against the residual."""

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        motion = scene.likelihood.data.motion
        t, span = motion.t, float(np.ptp(motion.t))
        steps = np.linspace(0.12, 0.88, c.ROWS // c.PARTS)
        events = [None, *(float(t[0] + s * span) for s in steps)]
        shapes = np.column_stack([Event(0, at).shape(t) for at in events])
        heard = scene.likelihood.data.heard.T[list(now.order)]
        x = score.rows.rest(heard[:, :, None] * shapes)
        pull = np.einsum("jm,jmk->jk", score.residual, x) ** 2
        found = np.log1p(pull / np.maximum(np.sum(x**2, axis=1) * score.left[:, None], 1e-280))
        forth = (motion.dq[:, list(now.order)].T > 0.0) * 1.0
        for side in (shapes[:, 1:] > 0.0, shapes[:, 1:] <= 0.0):
            share = forth @ side / np.maximum(side.sum(axis=0), 1)
            found[:, 1:] *= np.minimum(share, 1.0 - share) > _WAYS
        found[~scene.moving] = 0.0
        for drift in (True, False):
            some = found[:, :1] if drift else found * (np.arange(len(events)) > 0)
            j, k = divmod(int(np.argmax(some)), some.shape[1])
            event = Event(j, events[k])
            if event not in now.events and found[j, k] > 0.0:
                yield replace(now, events=(*now.events, event))

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        for event in repair.events:
            j, t = event.joint, event.at
            name, unit = joints_text([j]), scene.problem.robot.torque_units[j]
            without = replace(repair, events=tuple(e for e in repair.events if e != event))
            size = _size(scene, repair, without, event)
            kind, many, place = "torque drift", scene.n, ""
            how = f"drifts by {size:+.3g} {unit} from the first row to the last"
            remedy = "let the sensor warm up and set its zero before the run"
            if t is not None:
                kind, many, place = "torque step", scene.n * c.ROWS // c.PARTS, f"{name}, t = {t:.4g} s"
                how = f"steps by {size:+.3g} {unit} at t = {t:.4g} s and stays there"
                remedy = "cut the run there, or find out what touched the arm"
            yield Element(
                kind, "warning", (j,), f"the torque of {name} {how}.", remedy,
                choices(many) + c.SLOW_ODDS, without, mends=False, place=place,
                figures={"size": size} | ({} if t is None else {"t": t}),
            )  # fmt: skip


def _size(scene: Scene, repair: Repair, without: Repair, event: Event) -> float:
    """How far the torque drifts or steps [N m, N]: by how much the fit of its joint needs it."""
    score, j = scene.likelihood.score(repair), event.joint
    lacking, shape = scene.likelihood.rows(without), event.shape(scene.likelihood.data.motion.t)
    heard = scene.likelihood.data.heard[:, repair.order[j]]
    x = lacking.rest(np.repeat((heard * shape)[None, :, None], scene.n, axis=0))[j, :, 0]
    away = score.channels[j] - lacking.raw[j] @ score.theta
    return float(x @ away / max(x @ x, 1e-300))
