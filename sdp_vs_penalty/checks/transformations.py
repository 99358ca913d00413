"""What may be wrong with a log, a class for each kind: the repairs that it proposes,
what these cost beforehand, and what is said of them."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import ArmFit, At, Likelihood
from sdp_vs_penalty.checks.regression_data import LAWS
from sdp_vs_penalty.checks.repair import LogEvent, LogTransform
from sdp_vs_penalty.data.formats.recognition import UNITS as NAMED
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import STANDARD_GRAVITY

#: Factors of units, and what a channel is in whose torque has to be multiplied by one.
UNITS = {
    NAMED["mnm"]: "mN m",
    NAMED["ncm"]: "N cm",
    NAMED["kgfm"]: "kgf m",
    NAMED["lbfin"]: "lbf in",
}
#: Factors that are tried beside the nearest: units, and a grid whose steps the
#: refinement bridges.
_GAINS = (*UNITS, 0.1, 0.3, 3, 100, 1e3)
#: True time over the file's that is tried; the ends are round.
_RATES = (0.5, 0.75, 1.4, 2.0)
#: Delays (``lead`` of a repair) and time constants (``lag``) that are tried [s].
_LATE = {
    "lead": (-0.12, -0.06, -0.025, -0.01, 0.01, 0.025, 0.06, 0.12),
    "lag": (0.01, 0.04, 0.1, 0.2),
}
#: Below this bend, the largest logged torque over the limit, a channel is as straight
#: as sensors are.
_STRAIGHT = 0.2
#: Share of the time on either side of a step that the joint has to move each way: else
#: it is friction's.
_WAYS = 0.15
#: Gravity on Earth [m/s^2]; a problem whose gravity is of another size is corrected.
_EARTH = max(map(abs, STANDARD_GRAVITY))


@dataclass(frozen=True)
class FaultSize:
    """One number of a repair, 0 where the log is right; ``at`` gives the repair with
    another one.

    tolerance : what arms and loggers differ by themselves, in the number's own unit;
    search_radius : how far to either side the best value is looked for; text : with unit; snaps
    : round values, tried beside it.
    """

    value: float
    at: At
    tolerance: float
    search_radius: float
    text: Callable[[float], str]
    round_values: tuple[float, ...] = ()

    def round_within(self, reach: float) -> list[float]:
        """The nearest round value, where it is nearer than that."""
        by_distance = sorted(self.round_values, key=lambda x: abs(x - self.value))
        return [x for x in by_distance[:1] if abs(x - self.value) < reach]

    @classmethod
    def factor(cls, x: float, at: At, snaps: tuple[float, ...]) -> "FaultSize":
        """The natural logarithm of a factor x, which ``at`` and snaps count in."""
        logs = tuple(float(np.log(s)) for s in snaps)
        text = lambda v: f"a factor of {np.exp(v):.3g}"  # noqa: E731
        return cls(
            float(np.log(x)),
            lambda v: at(float(np.exp(v))),
            c.CALIBRATED_GAIN,
            0.5,
            text,
            logs,
        )


def choices(count: int) -> float:
    """Natural logarithm of the odds against one of so many alike, none of them likelier
    than another."""
    return c.ODDS + float(np.log(max(count, 1)))


@dataclass(frozen=True)
class Fault:
    """One thing that a repair does, and what is said of it; ``of`` : the repair without
    it, or its number.

    cost : natural logarithm of the odds against it; place : default: the joints; mends
    : whether a repaired log can be written.
    """

    kind: str
    severity: str
    joints: tuple[int, ...]
    what: str
    remedy: str
    of: LogTransform | FaultSize
    cost: float = c.ODDS
    place: str = ""
    mends: bool = True
    figures: Mapping[str, Any] = field(default_factory=dict)

    @property
    def number(self) -> FaultSize | None:
        return self.of if isinstance(self.of, FaultSize) else None

    @property
    def odd(self) -> bool:
        """Whether it is a number that is not round."""
        return (
            isinstance(self.of, FaultSize)
            and not np.isclose(self.of.value, self.of.round_values).any()
        )

    @property
    def without(self) -> LogTransform:
        return self.of.at(0.0) if isinstance(self.of, FaultSize) else self.of

    @property
    def name(self) -> tuple[str, tuple[int, ...]]:
        return self.kind, self.joints


class Transformation(ABC):
    """One kind of change of a log."""

    @abstractmethod
    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        """Repairs that differ from ``now``, whose score is given, by one more thing of
        this kind."""

    @abstractmethod
    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """What a repair does of this kind."""


class Degrees(Transformation):
    """Positions in degrees: of all revolute joints, or of one of them."""

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        reach = np.abs(now.positions(log.data.motion.q)).max(axis=0)
        far = [j for j in log.revolute if reach[j] > 2.0 * np.pi]
        for joints in [log.revolute, *([j] for j in far if log.n > 1)] if far else ():
            yield now.times("scale", joints, float(np.radians(1.0)))

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        if not (joints := tuple(np.flatnonzero(np.abs(repair.scale) < 0.1).tolist())):
            return
        without = repair.times("scale", joints, float(np.degrees(1.0)))
        reach = float(np.abs(without.positions(log.data.motion.q)[:, joints]).max())
        is_all_joints, named = (
            joints == tuple(log.revolute),
            ", ".join(f"q{j + 1}" for j in joints),
        )
        kind, cost = "positions in degrees", c.ODDS
        if not is_all_joints:
            kind, cost = "position unit", len(joints) * choices(log.n)
        what = (
            f"the position of {joints_text(joints)} is in degrees: it reaches"
            f" {reach:.4g}."
        )
        remedy = f"multiply {named} (and dq) by pi / 180"
        yield Fault(kind, "warning", joints, what, remedy, without, cost, named)


class Clock(Transformation):
    """A clock at another rate, or rows in reverse order: inertia beside the weight
    tells the rate, friction the direction."""

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        yield replace(now, reversed=not now.reversed)
        for factor in _RATES if any(now.gravity) else ():
            yield replace(now, rate=now.rate * factor)

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        if repair.reversed:
            what = "the rows are in reverse order: friction would drive the motion."
            remedy, without = "reverse q and tau in time", repair.reset("reversed")
            yield Fault(
                "time reversed", "warning", (), what, remedy, without, place="all rows"
            )
        if (x := repair.rate) != 1.0:
            word, at = "fast" if x < 1.0 else "slow", lambda v: replace(repair, rate=v)
            what = (
                f"time runs {max(x, 1.0 / x):.3g} times too {word}: inertia does not"
                " fit the weight."
            )
            remedy = f"multiply t by {x:.3g} (find out the log's true rate)"
            number = FaultSize.factor(x, at, (min(_RATES), max(_RATES)))
            yield Fault(
                "clock rate", "warning", (), what, remedy, number, place="column t"
            )


class Sign(Transformation):
    """Joints and torques that count the other way: the torque's sign, the position's,
    or both."""

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        for turned in (range(log.n), *((j,) for j in range(log.n))):
            yield now.times("gain", turned, -1.0)
        for j in np.flatnonzero(score.poor).tolist():
            yield now.times("scale", (j,), -1.0)
            yield now.times("scale", (j,), -1.0).times("gain", (j,), -1.0)

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        q, tau = np.array(repair.scale) < 0.0, np.array(repair.gain) < 0.0
        for j in np.flatnonzero(q).tolist():
            without, k = repair.times("scale", (j,), -1.0), j + 1
            kind, what = (
                "position sign",
                f"the position of joint {k} has the wrong sign.",
            )
            remedy = f"flip the sign of q{k} (and dq{k})"
            if tau[j]:
                without = without.times("gain", (j,), -1.0)
                kind, what = (
                    "joint sign",
                    f"joint {k} counts the other way, position and torque alike.",
                )
                remedy = f"flip the signs of q{k}, dq{k} and tau{k}"
            yield Fault(kind, "warning", (j,), what, remedy, without, choices(log.n))
        if torque_only := tuple(np.flatnonzero(tau & ~q).tolist()):
            is_all_joints = len(torque_only) == log.n
            cost = c.ODDS if is_all_joints else len(torque_only) * choices(log.n)
            what = (
                f"the torque of {'every joint' if is_all_joints else joints_text(torque_only)} has"
                " the wrong sign."
            )
            remedy = "flip the sign of " + ", ".join(f"tau{j + 1}" for j in torque_only)
            without = repair.times("gain", torque_only, -1.0)
            yield Fault(
                "torque sign", "warning", torque_only, what, remedy, without, cost
            )


class Exchange(Transformation):
    """Channels of other joints: positions, torques, or both exchanged."""

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        for a, b in combinations(log.joints, 2):
            yield now.with_swap(a, b, "tau_order")
            if score.poor[a] or score.poor[b]:
                yield now.with_swap(a, b, "order")
                yield now.with_swap(a, b, "order", "tau_order")

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        swaps: list[tuple[str, str, str, tuple[str, ...]]] = [
            ("position order", "the positions", "q and dq", ("order",)),
            ("torque order", "the torques", "tau", ("tau_order",)),
        ]
        if repair.order == repair.tau_order:
            swaps = [
                (
                    "joint order",
                    "positions and torques",
                    "q, dq and tau",
                    ("order", "tau_order"),
                )
            ]
        for kind, word, columns, names in swaps:
            order = getattr(repair, names[0])
            if changed := tuple(j for j, k in enumerate(order) if j != k):
                how = ", ".join(
                    f"column {order[j] + 1} is joint {j + 1}'s" for j in changed
                )
                how = "" if len(changed) == 2 else f": {how}"
                what = f"{word} of {joints_text(changed)} are swapped{how}."
                cost = (len(changed) - 1) * choices(log.n * (log.n - 1) // 2)
                remedy = f"rename the columns of {columns}"
                yield Fault(
                    kind, "warning", changed, what, remedy, repair.reset(*names), cost
                )


class Mounting(Transformation):
    """Gravity along another direction of the base: its six axes first, then around the
    assumed one."""

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        gravity_now = np.array(now.gravity)
        size = float(np.linalg.norm(gravity_now))
        known = _earthly(size)
        if any(now.lacks):
            return
        for axis in (*np.eye(3), *-np.eye(3)):
            yield _under(now, (size if known else _EARTH) * axis)
        if known:
            across = np.linalg.svd(gravity_now[None, :])[2][1:]
            ats = [_turned(now, gravity_now, gravity_now + size * x) for x in across]
            steps, _ = log.screen.first_order_steps(
                now, ats, np.zeros(2), np.full(2, 0.02)
            )
            turned = gravity_now + size * np.clip(steps, -0.5, 0.5) @ across
            yield _under(now, size * turned / np.linalg.norm(turned))

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        assumed, g = np.array(log.problem.robot.gravity), np.array(repair.gravity)
        if np.allclose(assumed, g, rtol=0.0, atol=1e-6):
            return
        gravity_size = float(np.linalg.norm(assumed))
        cosine = assumed @ g / max(gravity_size * float(np.linalg.norm(g)), 1e-300)
        angle = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
        x, y, z = (float(round(v, 2)) + 0.0 for v in g)
        kind, remedy = "gravity direction", f"identify with --gravity {x:g},{y:g},{z:g}"
        of: LogTransform | FaultSize = _under(repair, assumed)
        if not _earthly(gravity_size):
            kind, remedy = (
                "gravity of the problem",
                f"{remedy}, or correct the problem's gravity",
            )
        elif np.count_nonzero(np.abs(g) > 1e-9) > 1:
            of = FaultSize(
                angle, _turned(repair, assumed, g), c.CALIBRATED, 0.5, _degrees
            )
        visible_angle, description = (
            ", ".join(f"{float(f'{v:.3f}') + 0.0:g}" for v in g) for g in (g, assumed)
        )
        what = (
            f"the weight in the torques points along ({visible_angle}) m/s^2,"
            f" {np.degrees(angle):.0f} degrees away from the assumed ({description})."
        )
        severity = "warning"
        figures = {"angle_degrees": float(np.degrees(angle)), "vector": [x, y, z]}
        yield Fault(
            kind, severity, (), what, remedy, of, c.ODDS, "the base", False, figures
        )


def _earthly(size: float) -> bool:
    return abs(size / _EARTH - 1.0) < c.CALIBRATED_GAIN


def _turned(
    repair: LogTransform, assumed: Array, g: Array
) -> Callable[[float], LogTransform]:
    """The repair with gravity turned by an angle from the assumed vector towards g."""
    size = float(np.linalg.norm(assumed))
    a = assumed / size
    across = g - (g @ a) * a
    across = across / np.linalg.norm(across)
    return lambda v: _under(repair, size * (np.cos(v) * a + np.sin(v) * across))


def _under(repair: LogTransform, g: Array) -> LogTransform:
    return replace(repair, gravity=tuple(g.tolist()))


class Weight(Transformation):
    """The arm's weight taken out of one channel, or of all, by the controller."""

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        # The weight that a wrist's last link holds is within the error of its
        # friction's law: of one channel alone it has to be half (8 s of the real Panda,
        # tests/test_docs.py::test_the_tutorial).
        held = np.sqrt(np.mean(log.nominal(now, 0.0) ** 2, axis=0))
        logged = np.sqrt(np.mean(log.data.torque(log.data.motion.t) ** 2, axis=0))
        single_joints = [(j,) for j in np.flatnonzero(held > 0.5 * logged).tolist()]
        all_joints = range(log.n)
        # A little weight that is left makes the rest look like inertia under another
        # clock.
        for joints, lacks in (
            (all_joints, 1.0),
            (all_joints, 0.8),
            *((one, 1.0) for one in single_joints),
        ):
            if any(now.gravity):
                yield now.with_entries("lacks", joints, lacks)

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        for joints, x in repair.changed("lacks"):
            of, how = f"the torque of {joints_text(joints)}", ""
            if len(joints) == log.n:
                left = ",".join(
                    f"{float(round((1.0 - x) * v, 3)) + 0.0:g}" for v in repair.gravity
                )
                of, how = "the torques", f", or identify with --gravity {left}"
            what = f"{_percent(x)} of the weight is missing from {of}."
            remedy = f"log the torques before gravity compensation{how}"
            at = partial(repair.with_entries, "lacks", joints)
            number = FaultSize(x, at, c.CALIBRATED_GAIN, 0.4, _percent, (1.0,))
            cost = choices(log.n // len(joints))
            yield Fault(
                "gravity removed",
                "warning",
                joints,
                what,
                remedy,
                number,
                cost,
                mends=False,
            )


class Gain(Transformation):
    """Channels too large or too small beside their neighbours'. A factor that all have
    in common is not seen by what joints share: see residual.py."""

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        joints = log.joints if len(log.joints) > 1 else []
        # A small one is seen at its best value alone: a step of the grid off, the fit
        # is as bad.
        ats: list[At] = [partial(now.times, "gain", (j,)) for j in joints]
        steps, _ = log.screen.first_order_steps(
            now, ats, np.ones(len(ats)), np.full(len(ats), 0.01)
        )
        for at, best in zip(ats, np.clip(1.0 + steps, 0.5, 2.0).tolist(), strict=True):
            yield from map(at, (*_GAINS, best))

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        for j in np.flatnonzero(np.abs(repair.gain) != 1.0).tolist():
            x = abs(repair.gain[j])
            unit = next(
                (name for u, name in UNITS.items() if abs(x / u - 1.0) < 1e-9), None
            )
            kind, how = (
                ("torque unit", f": it is in {unit}") if unit else ("torque gain", "")
            )
            size = (
                f"{1.0 / x:.3g} times too large"
                if x < 1.0
                else f"{x:.3g} times too small"
            )
            what = (
                f"the torque of {joints_text([j])} is {size} beside those of its"
                f" neighbours{how}."
            )
            at = lambda v, j=j: repair.with_entries(  # noqa: E731
                "gain", (j,), v * np.sign(repair.gain[j])
            )
            yield Fault(
                kind,
                "warning",
                (j,),
                what,
                f"multiply tau{j + 1} by {x:.3g}",
                FaultSize.factor(x, at, tuple(UNITS)),
                choices(log.n),
                figures={"factor": x},
            )


class TimeDelay(Transformation):
    """Torque later than the motion, or through a causal filter: one channel, or all.
    Nothing brings one channel ahead of the others: what looks like that is a law of its
    joint."""

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        single_joints = [(j,) for j in log.joints] if len(log.joints) > 1 else []
        for name, tried in _LATE.items():
            yield from (now.with_entries(name, range(log.n), x) for x in tried)
            yield from (
                now.with_entries(name, one, x)
                for one in single_joints
                for x in tried
                if x > 0.0
            )

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        for name, joints, x in (
            (k, *joints_and_value)
            for k in _LATE
            for joints_and_value in repair.changed(k)
        ):
            place, channel, extra = (
                "",
                f"tau{joints[0] + 1}",
                "the other torques have not",
            )
            kind, is_all_joints = (
                f"channel {'delay' if name == 'lead' else 'filter'}",
                len(joints) == log.n,
            )
            if is_all_joints:
                kind = "delay" if name == "lead" else "torque filter"
                place, channel = (
                    "all torque channels" if log.n > 1 else "",
                    "the torques",
                )
                extra = "the positions have not"
            low = f"{1.0 / (2.0 * np.pi * max(x, 1e-6)):.2g} Hz ({1e3 * x:.0f} ms)"
            what = f"a causal low-pass of {low} on {channel}; {extra} one."
            remedy = (
                f"log {channel} unfiltered, or filter every channel alike and"
                " without lag"
            )
            if name == "lead":
                later = "later" if x > 0.0 else "earlier"
                what = (
                    f"{1e3 * abs(x):.0f} ms {later} than the motion: {channel};"
                    f" {extra} moved."
                )
                remedy = (
                    f"shift {channel} in time (and log all channels from one source)"
                )
            text, at = (
                lambda v: f"{1e3 * v:.0f} ms",
                partial(repair.with_entries, name, joints),
            )
            number, cost = (
                FaultSize(x, at, c.USUAL_DELAY, 0.06, text),
                choices(log.n // len(joints)),
            )
            yield Fault(
                kind,
                "warning",
                joints,
                what,
                remedy,
                number,
                cost,
                place,
                mends=name == "lead",
            )


class Beside(Transformation):
    """What one joint's torque holds beside the arm's: a law of its own motion that the
    model lacks, no fault of the log, which contends with all that may be; a drift with
    time; a step at some moment (a contact, a load, a zero set anew). Proposed by a
    score test: of each shape the part that the arm leaves, against the residual."""

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        motion, order, laws = log.data.motion, list(now.order), log.data.laws
        span, heard = float(np.ptp(motion.t)), log.filter_gain(now)[:, :, None]
        gains = [
            score.gained(score.rows.rest(heard * x[order])).max(axis=1)
            for x in laws.values()
        ]
        for j in np.flatnonzero(score.poor).tolist():  # the likeliest of each
            yield now.with_event(LogEvent(j, [*laws][int(np.argmax(gains, axis=0)[j])]))
        steps = np.linspace(
            0.12, 0.88, c.ROWS // 2
        )  # two rows each: the wrong moment explains nothing
        events = [None, *(float(motion.t[0] + s * span) for s in steps)]
        shapes = np.hstack([LogEvent(0, at).shape(motion.t) for at in events])
        gained = score.gained(score.rows.rest(heard * shapes)) * log.moving[:, None]
        forth = (motion.dq[:, order].T > 0.0) * 1.0
        for side in (shapes[:, 1:] > 0.0, shapes[:, 1:] <= 0.0):
            share = forth @ side / np.maximum(side.sum(axis=0), 1)
            gained[:, 1:] *= np.minimum(share, 1.0 - share) > _WAYS
        for some, at in ((gained[:, :1], events[:1]), (gained[:, 1:], events[1:])):
            j, k = divmod(int(np.argmax(some)), len(at))
            if some[j, k] > 0.0:
                yield now.with_event(LogEvent(j, at[k]))

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        for event in repair.events:
            j, t, without = event.joint, event.at, repair.without(event)
            name, unit = joints_text([j]), log.problem.robot.torque_units[j]
            if isinstance(t, str):
                what = (
                    f"the torque of {name} holds a law that the model lacks, most like"
                    f" {t}."
                )
                remedy, cost = (
                    "identify, and let `diagnose` name it",
                    choices(log.n * len(LAWS)),
                )
                yield Fault(
                    f"law: {t}", "note", (j,), what, remedy, without, cost, mends=False
                )
                continue
            # As far as the fit of its joint needs it.
            score, lacking, shape = (
                log.score(repair),
                log.rows(without),
                event.shape(log.data.motion.t),
            )
            x = lacking.rest(log.filter_gain(repair)[:, :, None] * shape)[j, :, 0]
            residual = score.channels[j] - lacking.apart[j] @ score.theta
            size = float(x @ residual / max(x @ x, 1e-300))
            kind, many, place, figures = "torque drift", log.n, "", {"size": size}
            how = f"drifts by {size:+.3g} {unit} from the first row to the last"
            remedy = "let the sensor warm up and set its zero before the run"
            if t is not None:
                # Moments that a low-passed torque tells apart.
                kind, many, place = (
                    "torque step",
                    log.n * c.ROWS // c.PARTS,
                    f"{name}, t = {t:.4g} s",
                )
                how = f"steps by {size:+.3g} {unit} at t = {t:.4g} s and stays there"
                remedy, figures["t"] = (
                    "cut the run there, or find out what touched the arm",
                    t,
                )
            what, cost = f"the torque of {name} {how}.", choices(many) + 2.0 * c.ODDS
            yield Fault(
                kind,
                "warning",
                (j,),
                what,
                remedy,
                without,
                cost,
                place,
                False,
                figures,
            )


class Place(Transformation):
    """Joints that are elsewhere than the robot's kinematics say. Encoders that count
    from another zero: what is to be added to one joint's position [rad], of prismatic
    joints in lengths of the arm; and joints farther apart or nearer, along the line
    between them [m]."""

    quarters = -np.pi / 2, np.pi / 2, np.pi

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        joints, quarters = (
            log.problem.robot.joints,
            self.quarters if score.poor.any() else (),
        )
        apart = [
            j for j, joint in enumerate(joints) if j and joint.placement[:3, 3].any()
        ]
        turns = [*(False for _ in apart), *(j in log.revolute for j in log.joints)]
        ats: list[At] = [partial(now.with_entries, "longer", (j,)) for j in apart]
        ats += [partial(_shifted, log, now, j) for j in log.joints]
        values = [*(now.longer[j] for j in apart), *(now.zero[j] for j in log.joints)]
        units = np.where(turns, 1.0, _length(log))
        steps, spreads = log.screen.first_order_steps(
            now, ats, np.array(values), 0.01 * units
        )
        first = np.clip(steps, -0.7 * units, 0.7 * units).tolist()
        for k in np.flatnonzero(
            np.isfinite(spreads)
        ).tolist():  # of the others nothing is seen
            for x in (first[k], *(quarters if turns[k] else ())):
                yield ats[k](values[k] + x)

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        length, metres, cost = _length(log), "{:.4g} m".format, choices(log.n)
        for j in np.flatnonzero(repair.longer).tolist():
            x, at = repair.longer[j], partial(repair.with_entries, "longer", (j,))
            how = (
                f"{metres(abs(x))} {'farther from' if x > 0.0 else 'nearer to'}"
                f" joint {j}"
            )
            what = f"joint {j + 1} is {how} than in the robot's kinematics."
            remedy = (
                "correct the kinematics, or choose the problem of the robot that was"
                " logged"
            )
            number = FaultSize(
                x, at, 0.25 * c.CALIBRATED * length, 0.35 * length, metres
            )
            yield Fault(
                "link length", "warning", (j,), what, remedy, number, cost, mends=False
            )
        for j in np.flatnonzero(repair.zero).tolist():
            x, turns, back = (
                repair.zero[j],
                j in log.revolute,
                partial(_shifted, log, repair, j),
            )
            unit, text = (1.0, _degrees) if turns else (0.25 * length, metres)
            reach, snaps = (
                (0.35, (*self.quarters, -np.pi)) if turns else (0.35 * length, ())
            )
            opposite_text = lambda v, text=text: text(-v)  # noqa: E731
            number = FaultSize(
                x, back, unit * c.CALIBRATED, reach, opposite_text, snaps
            )
            severity = "warning"
            what = (
                f"the zero of joint {j + 1} is {opposite_text(x)} away from the robot's"
                " kinematics."
            )
            remedy = f"add {x:+.5g} {log.problem.robot.position_units[j]} to q{j + 1}"
            shift = {"shifts": [x]}
            yield Fault(
                "encoder offset",
                severity,
                (j,),
                what,
                remedy,
                number,
                cost,
                figures=shift,
            )


class Saturation(Transformation):
    """A channel that bends towards a limit: tau_log = s tanh(tau / s), an amplifier
    near its end."""

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        for j in log.joints:
            for x in (0.5 * _STRAIGHT, 0.1 * _STRAIGHT):
                yield now.with_entries("bend", (j,), 1.0 - x)

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        for j in np.flatnonzero(repair.bend).tolist():
            x, k = repair.bend[j], repair.tau_order[j]
            limit = f"{log.data.largest[k] / x:.3g} {log.problem.robot.torque_units[j]}"
            what = (
                f"the torque of {joints_text([j])} bends towards its amplifier's limit"
                f" of {limit}."
            )
            remedy = "record again with a larger range, or slower"
            at = lambda v, j=j: repair.with_entries(  # noqa: E731
                "bend", (j,), float(np.clip(v, 0.0, 0.995))
            )
            number = FaultSize(
                x,
                at,
                _STRAIGHT,
                0.25,
                lambda v: f"{_percent(v)} of the limit is reached",
            )
            yield Fault(
                "saturation",
                "warning",
                (j,),
                what,
                remedy,
                number,
                choices(log.n),
                mends=False,
            )


def _length(log: Likelihood) -> float:
    """What a radian is to an angle: a length of this arm's size [m]."""
    return 0.3 * float(log.problem.robot.link_reach().sum())


def _shifted(log: Likelihood, now: LogTransform, j: int, x: float) -> LogTransform:
    """An angle in (-pi, pi]; a length as it is."""
    wrapped = float(np.pi - (np.pi - x) % (2.0 * np.pi)) if j in log.revolute else x
    return now.with_entries("zero", (j,), wrapped)


def _degrees(angle: float) -> str:
    return f"{np.degrees(angle):.4g} degrees"


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


#: What is tried, in the order of the words; of what explains alike the first.
TRANSFORMATIONS: tuple[Transformation, ...] = (
    Degrees(),
    Clock(),
    Sign(),
    Exchange(),
    Mounting(),
    Weight(),
    Beside(),
    Gain(),
    TimeDelay(),
    Place(),
    Saturation(),
)
