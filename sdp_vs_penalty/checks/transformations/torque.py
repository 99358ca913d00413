"""What may be wrong with torque channels: gain, delay, filter, weight, bends, drifts and steps."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Likelihood, Score
from sdp_vs_penalty.checks.regression_data import LAWS
from sdp_vs_penalty.checks.repair import Event, Repair
from sdp_vs_penalty.checks.transformation import Element, Number, Transformation, choices
from sdp_vs_penalty.data.formats.recognition import UNITS as NAMED

#: Factors of units, and what a channel is in whose torque has to be multiplied by one.
UNITS = {NAMED["mnm"]: "mN m", NAMED["ncm"]: "N cm", NAMED["kgfm"]: "kgf m", NAMED["lbfin"]: "lbf in"}
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

    def proposals(self, log: Likelihood, now: Repair, score: Score) -> Iterator[Repair]:
        for j in log.joints if len(log.joints) > 1 else ():
            yield from (now.times("gain", (j,), factor) for factor in _GAINS)

    def elements(self, log: Likelihood, repair: Repair) -> Iterator[Element]:
        gross = c.GROSS / c.CALIBRATED * c.CALIBRATED_GAIN
        for j in np.flatnonzero(np.abs(repair.gain) != 1.0).tolist():
            g = abs(repair.gain[j])
            unit = next((name for u, name in UNITS.items() if abs(g / u - 1.0) < 1e-9), None)
            kind, how = ("torque unit", f": it is in {unit}") if unit else ("torque gain", "")
            size = f"{1.0 / g:.3g} times too large" if g < 1.0 else f"{g:.3g} times too small"
            at = lambda x, j=j, g=g: repair.times("gain", (j,), x / g)  # noqa: E731
            yield Element(
                kind, "error" if abs(np.log(g)) > gross else "warning", (j,),
                f"the torque of {joints_text([j])} is {size} beside those of its neighbours{how}.",
                f"multiply tau{j + 1} by {g:.3g}", Number.factor(g, at, tuple(UNITS)), choices(log.n),
                figures={"factor": g},
            )  # fmt: skip


class Delay(Transformation):
    """Torque later than the motion, or through a causal filter: one channel, or all. Nothing brings one
    channel ahead of the others: what looks like that is a law of its joint."""

    def proposals(self, log: Likelihood, now: Repair, score: Score) -> Iterator[Repair]:
        each = [(j,) for j in log.joints] if len(log.joints) > 1 else []
        for name, tried in _LATE.items():
            yield from (now.with_entries(name, range(log.n), x) for x in tried)
            yield from (now.with_entries(name, one, x) for one in each for x in tried if x > 0.0)

    def elements(self, log: Likelihood, repair: Repair) -> Iterator[Element]:
        for name, joints, x in ((k, *found) for k in _LATE for found in repair.changed(k)):
            every, late = len(joints) == log.n, name == "lead"
            place = "all torque channels" if every and log.n > 1 else ""
            channel = "the torques" if every else f"tau{joints[0] + 1}"
            beside = "the positions have not" if every else "the other torques have not"
            kind, low = "filter", f"{1.0 / (2.0 * np.pi * max(x, 1e-6)):.2g} Hz ({1e3 * x:.0f} ms)"
            what = f"a causal low-pass of {low} on {channel}; {beside} one."
            remedy = f"log {channel} unfiltered, or filter every channel alike and without lag"
            if late:
                kind, later = "delay", "later" if x > 0.0 else "earlier"
                what = f"{1e3 * abs(x):.0f} ms {later} than the motion: {channel}; {beside} moved."
                remedy = f"shift {channel} in time (and log all channels from one source)"
            text = lambda v: f"{1e3 * v:.0f} ms"  # noqa: E731
            kind = f"channel {kind}" if not every else kind if late else f"torque {kind}"
            yield Element(
                kind, "warning", joints, what, remedy,
                Number.of(repair, name, joints, x, c.USUAL_DELAY, 0.06, text),
                choices(1 if every else log.n), place, late,
            )  # fmt: skip


class Weight(Transformation):
    """The arm's weight taken out of one channel, or of all, by the controller."""

    def proposals(self, log: Likelihood, now: Repair, score: Score) -> Iterator[Repair]:
        # The weight that a wrist's last link holds is within the error of its friction's law: of one
        # channel alone it has to be half (8 s of the real Panda, tests/test_docs.py::test_the_tutorial).
        held = np.sqrt(np.mean(log.nominal(now, 0.0) ** 2, axis=0))
        logged = np.sqrt(np.mean(log.data.torque(log.data.motion.t) ** 2, axis=0))
        each = [(j,) for j in np.flatnonzero(held > 0.5 * logged).tolist()]
        every = range(log.n)
        # A little weight that is left makes the rest look like inertia under another clock.
        for joints, lacks in ((every, 1.0), (every, 0.8), *((one, 1.0) for one in each)):
            if any(now.gravity):
                yield now.with_entries("lacks", joints, lacks)

    def elements(self, log: Likelihood, repair: Repair) -> Iterator[Element]:
        for joints, lacks in repair.changed("lacks"):
            common = len(joints) == log.n
            gx, gy, gz = (float(round((1.0 - lacks) * v, 3)) + 0.0 for v in repair.gravity)
            of = "the torques" if common else f"the torque of {joints_text(joints)}"
            how = f", or identify with --gravity {gx:g},{gy:g},{gz:g}" if common else ""
            yield Element(
                "gravity removed", "error", joints,
                f"{_percent(lacks)} of the weight is missing from {of}.",
                f"log the torques before gravity compensation{how}",
                Number.of(repair, "lacks", joints, lacks, c.CALIBRATED_GAIN, 0.4, _percent, (1.0,)),
                choices(1 if common else log.n), mends=False,
            )  # fmt: skip


class Saturation(Transformation):
    """A channel that bends towards a limit: tau_log = s tanh(tau / s), an amplifier near its end."""

    def proposals(self, log: Likelihood, now: Repair, score: Score) -> Iterator[Repair]:
        for j in log.joints:
            for x in (0.5 * _STRAIGHT, 0.1 * _STRAIGHT):
                yield now.with_entries("bend", (j,), 1.0 - x)

    def elements(self, log: Likelihood, repair: Repair) -> Iterator[Element]:
        for j in np.flatnonzero(repair.bend).tolist():
            x, k = repair.bend[j], repair.tau_order[j]
            limit, unit = log.data.largest[k] / x, log.problem.robot.torque_units[j]
            at = lambda v, j=j: repair.with_entries("bend", (j,), float(np.clip(v, 0.0, 0.995)))  # noqa: E731
            what = f"the torque of {joints_text([j])} bends towards a limit of {limit:.3g} {unit}"
            yield Element(
                "saturation", "warning", (j,), f"{what}: its sensor or amplifier is near its end.",
                "record again with a larger range, or slower",
                Number(x, at, _STRAIGHT, 0.25, lambda v: f"{_percent(v)} of the limit is reached"),
                choices(log.n), mends=False,
            )  # fmt: skip


class Law(Transformation):
    """Laws that the arm has and the model lacks: they contend with all that may be wrong with a log, and
    what they explain is said in a note."""

    def proposals(self, log: Likelihood, now: Repair, score: Score) -> Iterator[Repair]:
        heard, order = log.heard(now)[:, :, None], list(now.order)
        laws = log.data.laws
        gains = [score.gained(score.rows.rest(heard * x[order])).max(axis=1) for x in laws.values()]
        for j in np.flatnonzero(score.poor).tolist():  # the likeliest of each
            event = Event(j, [*laws][int(np.argmax(gains, axis=0)[j])])
            if event not in now.events:
                yield replace(now, events=(*now.events, event))

    def elements(self, log: Likelihood, repair: Repair) -> Iterator[Element]:
        for event in repair.events:
            if isinstance(event.at, str):
                what = (
                    f"the torque of {joints_text([event.joint])} holds a law of its own motion that the"
                )
                yield Element(
                    f"law: {event.at}", "note", (event.joint,),
                    f"{what} model lacks, most like {event.at}.", "identify, and let `diagnose` name it",
                    repair.without(event), choices(log.n * len(LAWS)), mends=False,
                )  # fmt: skip


class Change(Transformation):
    """A channel that drifts with time, or that steps once: a contact, a load, a zero set anew. Proposed
    by a score test: of each shape the part that the arm leaves, against the residual."""

    def proposals(self, log: Likelihood, now: Repair, score: Score) -> Iterator[Repair]:
        motion = log.data.motion
        t, span = motion.t, float(np.ptp(motion.t))
        steps = np.linspace(0.12, 0.88, c.ROWS // 2)  # two rows each: the wrong moment explains nothing
        events = [None, *(float(t[0] + s * span) for s in steps)]
        shapes = np.hstack([Event(0, at).shape(t) for at in events])
        x = score.rows.rest(log.heard(now)[:, :, None] * shapes)
        found = score.gained(x)
        forth = (motion.dq[:, list(now.order)].T > 0.0) * 1.0
        for side in (shapes[:, 1:] > 0.0, shapes[:, 1:] <= 0.0):
            share = forth @ side / np.maximum(side.sum(axis=0), 1)
            found[:, 1:] *= np.minimum(share, 1.0 - share) > _WAYS
        found[~log.moving] = 0.0
        for drift in (True, False):
            some = found * (drift == (np.arange(len(events)) == 0))
            j, k = divmod(int(np.argmax(some)), len(events))
            event = Event(j, events[k])
            if event not in now.events and found[j, k] > 0.0:
                yield replace(now, events=(*now.events, event))

    def elements(self, log: Likelihood, repair: Repair) -> Iterator[Element]:
        for event in repair.events:
            if isinstance(event.at, str):
                continue
            j, t = event.joint, event.at
            name, unit = joints_text([j]), log.problem.robot.torque_units[j]
            without = repair.without(event)
            # As far as the fit of its joint needs it.
            score, lacking, shape = log.score(repair), log.rows(without), event.shape(log.data.motion.t)
            x = lacking.rest(log.heard(repair)[:, :, None] * shape)[j, :, 0]
            away = score.channels[j] - lacking.apart[j] @ score.theta
            size = float(x @ away / max(x @ x, 1e-300))
            kind, many, place = "torque drift", log.n, ""
            how = f"drifts by {size:+.3g} {unit} from the first row to the last"
            remedy = "let the sensor warm up and set its zero before the run"
            if t is not None:
                # Moments that a low-passed torque tells apart.
                kind, many, place = "torque step", log.n * c.ROWS // c.PARTS, f"{name}, t = {t:.4g} s"
                how = f"steps by {size:+.3g} {unit} at t = {t:.4g} s and stays there"
                remedy = "cut the run there, or find out what touched the arm"
            yield Element(
                kind, "warning", (j,), f"the torque of {name} {how}.", remedy, without,
                choices(many) + 2.0 * c.ODDS, place, False, {"size": size} | ({"t": t} if t else {}),
            )  # fmt: skip


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"
