"""What may be wrong with positions, with the clock and with the base: units, signs, order, zeros, rate,
mounting."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Likelihood, Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import Element, Number, Transformation, choices
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import STANDARD_GRAVITY

#: True time over the file's that is tried.
_RATES = (0.5, 0.75, 1.4, 2.0)
#: Gravity on Earth [m/s^2]; a problem whose gravity is of another size is corrected.
_EARTH = max(map(abs, STANDARD_GRAVITY))


class Degrees(Transformation):
    """Positions in degrees: of all revolute joints, or of one of them."""

    def proposals(self, log: Likelihood, now: Repair, score: Score) -> Iterator[Repair]:
        reach = np.abs(now.positions(log.data.motion.q)).max(axis=0)
        far = [j for j in log.revolute if reach[j] > 2.0 * np.pi]
        for joints in [log.revolute, *([j] for j in far if log.n > 1)] if far else ():
            yield now.times("scale", joints, float(np.radians(1.0)))

    def elements(self, log: Likelihood, repair: Repair) -> Iterator[Element]:
        if not (joints := tuple(np.flatnonzero(np.abs(repair.scale) < 0.1).tolist())):
            return
        without = repair.times("scale", joints, float(np.degrees(1.0)))
        reach = float(np.abs(without.positions(log.data.motion.q)[:, joints]).max())
        every, named = joints == tuple(log.revolute), ", ".join(f"q{j + 1}" for j in joints)
        what = f"the position of {joints_text(joints)} is in degrees, not in radians"
        yield Element(
            "positions in degrees" if every else "position unit", "error", joints,
            f"{what} (reaching {reach:.4g}).", f"multiply {named} (and dq) by pi / 180", without,
            c.ODDS if every else len(joints) * choices(log.n), named,
        )  # fmt: skip


class Clock(Transformation):
    """A clock at another rate, or rows in reverse order: inertia beside the weight tells the rate,
    friction the direction."""

    def proposals(self, log: Likelihood, now: Repair, score: Score) -> Iterator[Repair]:
        yield replace(now, reversed=not now.reversed)
        for factor in _RATES if any(now.gravity) else ():
            yield replace(now, rate=now.rate * factor)

    def elements(self, log: Likelihood, repair: Repair) -> Iterator[Element]:
        if repair.reversed:
            what = "the rows are in reverse order: friction would drive the motion."
            remedy, without = "reverse q and tau in time", replace(repair, reversed=False)
            yield Element("time reversed", "error", (), what, remedy, without, place="all rows")
        if (factor := repair.rate) != 1.0:
            word, at = "fast" if factor < 1.0 else "slow", lambda x: replace(repair, rate=x)
            yield Element(
                "clock rate", "error", (),
                f"time runs {max(factor, 1.0 / factor):.3g} times too {word}: the inertia in the "
                "torques does not fit the weight.",
                f"multiply t by {factor:.3g} (find out the log's true rate)",
                Number.factor(factor, at, (min(_RATES), max(_RATES))),  # a half or twice is round
                place="column t",
            )  # fmt: skip


class Sign(Transformation):
    """Joints and torques that count the other way: the torque's sign, the position's, or both."""

    def proposals(self, log: Likelihood, now: Repair, score: Score) -> Iterator[Repair]:
        for turned in (range(log.n), *((j,) for j in range(log.n))):
            yield now.times("gain", turned, -1.0)
        for j in np.flatnonzero(score.poor).tolist():
            yield now.times("scale", (j,), -1.0)
            yield now.times("scale", (j,), -1.0).times("gain", (j,), -1.0)

    def elements(self, log: Likelihood, repair: Repair) -> Iterator[Element]:
        q, tau = np.array(repair.scale) < 0.0, np.array(repair.gain) < 0.0
        for j in np.flatnonzero(q).tolist():
            without, k = repair.times("scale", (j,), -1.0), j + 1
            kind, what = "position sign", f"the position of joint {k} has the wrong sign."
            remedy = f"flip the sign of q{k} (and dq{k})"
            if tau[j]:
                without = without.times("gain", (j,), -1.0)
                kind, what = "joint sign", f"joint {k} counts the other way, position and torque alike."
                remedy = f"flip the signs of q{k}, dq{k} and tau{k}"
            yield Element(kind, "error", (j,), what, remedy, without, choices(log.n))
        if alone := tuple(np.flatnonzero(tau & ~q).tolist()):
            every = len(alone) == log.n
            cost = choices(1) if every else len(alone) * choices(log.n)
            what = f"the torque of {'every joint' if every else joints_text(alone)} has the wrong sign."
            remedy = "flip the sign of " + ", ".join(f"tau{j + 1}" for j in alone)
            without = repair.times("gain", alone, -1.0)
            yield Element("torque sign", "error", alone, what, remedy, without, cost)


class Exchange(Transformation):
    """Channels of other joints: positions, torques, or both exchanged."""

    def proposals(self, log: Likelihood, now: Repair, score: Score) -> Iterator[Repair]:
        for a, b in combinations(log.joints, 2):
            yield now.with_swap(a, b, "tau_order")
            if score.poor[a] or score.poor[b]:
                yield now.with_swap(a, b, "order")
                yield now.with_swap(a, b, "order", "tau_order")

    def elements(self, log: Likelihood, repair: Repair) -> Iterator[Element]:
        none, p, s = tuple(range(log.n)), repair.order, repair.tau_order
        told = [
            ("position order", "the positions", "q and dq", p, replace(repair, order=none)),
            ("torque order", "the torques", "tau", s, replace(repair, tau_order=none)),
        ]
        if p == s:
            without = replace(repair, order=none, tau_order=none)
            told = [("joint order", "positions and torques", "q, dq and tau", p, without)]
        for kind, word, names, order, without in told:
            if changed := tuple(j for j, k in enumerate(order) if j != k):
                how = ", ".join(f"column {order[j] + 1} is joint {j + 1}'s" for j in changed)
                what = f"{word} of {joints_text(changed)} are swapped"
                yield Element(
                    kind, "error", changed, f"{what}{'' if len(changed) == 2 else f': {how}'}.",
                    f"rename the columns of {names}", without,
                    (len(changed) - 1) * choices(log.n * (log.n - 1) // 2),
                )  # fmt: skip


class Zero(Transformation):
    """Encoders that count from another zero than the robot's kinematics: what is to be added to one
    joint's position [rad]; of prismatic joints in lengths of the arm."""

    quarters = -np.pi / 2, np.pi / 2, np.pi

    def proposals(self, log: Likelihood, now: Repair, score: Score) -> Iterator[Repair]:
        ats = [partial(_shifted, log, now, j) for j in log.joints]
        steps, spreads = log.screen.steps(now, ats, np.array(now.zero)[log.joints], 0.01)
        for j, at, step, spread in zip(log.joints, ats, steps.tolist(), spreads.tolist(), strict=True):
            if not np.isfinite(spread):
                continue  # nothing of it is seen, however large
            unit = 1.0 if j in log.revolute else _length(log)
            quarters = self.quarters if j in log.revolute and score.poor.any() else ()
            for x in (float(np.clip(step, -0.7 * unit, 0.7 * unit)), *quarters):
                if x:
                    yield at(now.zero[j] + x)

    def elements(self, log: Likelihood, repair: Repair) -> Iterator[Element]:
        for j in np.flatnonzero(repair.zero).tolist():
            x, turns = repair.zero[j], j in log.revolute
            unit = 1.0 if turns else _length(log)
            tolerance, gross = (x * unit * (1.0 if turns else 0.25) for x in (c.CALIBRATED, c.GROSS))
            text, snaps = (_degrees, self.quarters) if turns else ("{:.4g} m".format, ())
            yield Element(
                "encoder offset", "error" if abs(x) > gross else "warning", (j,),
                f"the zero of {joints_text([j])} is {text(-x)} away from the robot's kinematics.",
                f"add {x:+.5g} {log.problem.robot.position_units[j]} to q{j + 1}",
                Number(x, partial(_shifted, log, repair, j), tolerance, 0.35 * unit, text, snaps),
                choices(log.n), figures={"shifts": [x]},
            )  # fmt: skip


def _length(log: Likelihood) -> float:
    """What a radian is to an angle: a length of this arm's size [m]."""
    return 0.3 * float(log.problem.robot.link_reach().sum())


def _shifted(log: Likelihood, now: Repair, j: int, x: float) -> Repair:
    """An angle in (-pi, pi]; a length as it is."""
    wrapped = float(np.pi - (np.pi - x) % (2.0 * np.pi)) if j in log.revolute else x
    return now.with_entries("zero", (j,), wrapped)


class Length(Transformation):
    """Joints farther apart or nearer than the problem says, along the line between them [m]."""

    def proposals(self, log: Likelihood, now: Repair, score: Score) -> Iterator[Repair]:
        most, joints = 0.7 * _length(log), log.problem.robot.joints
        apart = [j for j, joint in enumerate(joints) if j and joint.placement[:3, 3].any()]
        ats = [partial(now.with_entries, "longer", (j,)) for j in apart]
        steps, _ = log.screen.steps(now, ats, np.array(now.longer)[apart], most / 70.0)
        for j, at, step in zip(apart, ats, np.clip(steps, -most, most).tolist(), strict=True):
            yield at(now.longer[j] + step)

    def elements(self, log: Likelihood, repair: Repair) -> Iterator[Element]:
        for j in np.flatnonzero(repair.longer).tolist():
            x, unit, text = repair.longer[j], _length(log), "{:.4g} m".format
            how = "farther from" if x > 0.0 else "nearer to"
            yield Element(
                "link length", "warning", (j,),
                f"joint {j + 1} is {text(abs(x))} {how} joint {j} than in the robot's kinematics.",
                "correct the kinematics, or choose the problem of the robot that was logged",
                Number.of(repair, "longer", (j,), x, 0.25 * c.CALIBRATED * unit, 0.35 * unit, text),
                choices(log.n), mends=False,
            )  # fmt: skip


class Mounting(Transformation):
    """Gravity along another direction of the base: its six axes first, then around the assumed one."""

    def proposals(self, log: Likelihood, now: Repair, score: Score) -> Iterator[Repair]:
        given = np.array(now.gravity)
        size = float(np.linalg.norm(given))
        known = abs(size / _EARTH - 1.0) < c.CALIBRATED_GAIN
        if any(now.lacks):
            return
        for axis in (*np.eye(3), *-np.eye(3)):
            yield _under(now, (size if known else _EARTH) * axis)
        if known:
            across = np.linalg.svd(given[None, :])[2][1:]
            ats = [_turned(now, given, given + size * x) for x in across]
            steps, _ = log.screen.steps(now, ats, np.zeros(2), 0.02)
            turned = given + size * np.clip(steps, -0.5, 0.5) @ across
            yield _under(now, size * turned / np.linalg.norm(turned))

    def elements(self, log: Likelihood, repair: Repair) -> Iterator[Element]:
        assumed, g = np.array(log.problem.robot.gravity), np.array(repair.gravity)
        if np.allclose(assumed, g, rtol=0.0, atol=1e-6):
            return
        given = float(np.linalg.norm(assumed))
        cosine = assumed @ g / max(given * float(np.linalg.norm(g)), 1e-300)
        angle = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
        straight = np.count_nonzero(np.abs(g) > 1e-9) == 1
        earthly = abs(given / _EARTH - 1.0) < c.CALIBRATED_GAIN
        x, y, z = (float(round(v, 2)) + 0.0 for v in g)
        kind, remedy = "gravity direction", f"identify with --gravity {x:g},{y:g},{z:g}"
        if not earthly:
            kind, remedy = "gravity of the problem", f"{remedy}, or correct the problem's gravity"
        of: Repair | Number = _under(repair, assumed)
        if earthly and not straight:
            of = Number(angle, _turned(repair, assumed, g), c.CALIBRATED, 0.5, _degrees)
        seen, told = (
            ", ".join(f"{float(f'{v:.3f}') + 0.0:g}" for v in vector) for vector in (g, assumed)
        )
        yield Element(
            kind, "warning" if earthly and angle < c.GROSS else "error", (),
            f"the weight in the torques points along ({seen}) m/s^2, {np.degrees(angle):.0f} degrees "
            f"away from the assumed ({told}).", remedy,
            of, mends=False, place="the base",
            figures={"angle_degrees": float(np.degrees(angle)), "vector": [x, y, z]},
        )  # fmt: skip


def _turned(repair: Repair, assumed: Array, g: Array) -> Callable[[float], Repair]:
    """The repair with gravity turned by an angle from the assumed vector towards g."""
    size = float(np.linalg.norm(assumed))
    a = assumed / size
    across = g - (g @ a) * a
    across = across / np.linalg.norm(across)
    return lambda v: _under(repair, size * (np.cos(v) * a + np.sin(v) * across))


def _under(repair: Repair, g: Array) -> Repair:
    x, y, z = g.tolist()
    return replace(repair, gravity=(x, y, z))


def _degrees(angle: float) -> str:
    return f"{np.degrees(angle):.4g} degrees"
