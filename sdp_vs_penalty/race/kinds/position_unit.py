"""The unit of positions: of all revolute joints, or degrees of one of them.

Small units are tried where positions reach beyond a turn; turns and shares of the range,
which look like radians of a small motion, and degrees of a smaller one, where the arm explains
the torques poorly.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.plausibility import ENCODER_ZERO, radians_per_percent
from sdp_vs_penalty.data.words.units import ENCODER_BITS, LARGEST_PERCENT
from sdp_vs_penalty.data.words.units import UNITS as NAMED
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, joints_text, prior_of_one_of
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis, Number

_TURN = NAMED["turns"]
#: Natural logarithm of the odds that tell radians from another unit.
_LEAST_TO_TELL = 6.0
#: Prior standard deviation of the size of a count (natural logarithm, from radians):
#: encoders have a hundred counts a turn, or a million. Half of the widest interval of the
#: size with which positions are repaired; a wider one is asked for.
_SPREAD_OF_COUNTS, _KNOWN = 6.0, 0.03
#: First digits of counts a turn that people choose: fractions of a degree, or one digit.
_CHOSEN = (1.0, 2.0, 3.6, 4.0, 5.0, 8.0)
#: Half of the widest interval with which it is said at all that positions are counts.
_WIDEST = 1.5
#: A joint that is identified moves farther than this [rad].
_LITTLE = 0.5
#: Joints travel about a radian: standard deviation of the travel's natural logarithm.
_SPREAD_OF_TRAVEL = 1.0


class ScaleAndMiddle(NamedTuple):
    """A joint's angle in radians is scale times the logged number, plus middle."""

    #: Radians of a unit.
    scale: float
    #: Radians of the unit's zero.
    middle: float


@dataclass(frozen=True)
class PositionUnit:
    """A unit of revolute positions: radians are scale times the logged number, plus
    middle."""

    #: Its name in the kind of issue; "" of degrees that a part of the joints has.
    unit: str
    #: What the positions are in, in words.
    words: str
    #: What they are multiplied by, in words.
    factor: str
    #: Radians of a unit; of a share of a joint's range, per cent of it, -100 to 100.
    scale: float
    #: Radians of the unit's zero; of a share, of half the range.
    middle: float = 0.0
    #: Whether it is a share of a joint's range.
    is_share: bool = False
    #: Logs that are in it for one in degrees.
    usual: float = 2e-3
    #: Its name where a command says the unit; "" of one that is said by its factors.
    name: str = ""

    @property
    def kind(self) -> str:
        """Kind of hypothesis and issue."""
        return f"positions in {self.unit}" if self.unit else "position unit"

    @property
    def repaired_by(self) -> tuple[str, str]:
        """The word of `--apply` that undoes it, and the channel."""
        return self.unit.replace(" ", "") or "degrees", "q"

    @property
    def is_small(self) -> bool:
        """Whether angles are larger numbers in it than in radians."""
        return self.scale <= 1.0

    def scales_and_middles(
        self, log: Likelihood
    ) -> Mapping[int, ScaleAndMiddle] | None:
        """Return scale and middle [rad] of the unit for each revolute joint, by its index.

        None if a joint has no range to share, or moves farther in this unit than any joint
        can.
        """
        robot, q = log.problem.robot, log.data.motion.q
        of_all = ScaleAndMiddle(self.scale, self.middle)
        numbers = dict.fromkeys(log.revolute, of_all)
        if self.is_share:
            percent = radians_per_percent(robot, 0.0 * q)
            if percent is None:
                return None
            middle_percent = 100.0 * self.middle
            for j in log.revolute:
                scale, middle = percent[j]
                numbers[j] = ScaleAndMiddle(
                    self.scale * scale, middle + middle_percent * scale
                )
                farthest = np.abs(self.scale * q[:, j] + middle_percent).max()
                if farthest > LARGEST_PERCENT:
                    return None
        # Channels may be in the wrong order: any channel may belong to the joint of the
        # largest range.
        ranges = [robot.joints[j].upper - robot.joints[j].lower for j in numbers]
        travels = [scale * np.ptp(q[:, j]) for j, (scale, _) in numbers.items()]
        if max(travels, default=0.0) > max(ranges, default=0.0) + ENCODER_ZERO:
            return None
        return numbers


#: Positions that are an encoder's counts.
COUNTS = "counts"
_DEGREES = PositionUnit(
    "degrees", "degrees", "pi / 180", NAMED["deg"], usual=1.0, name="deg"
)
UNITS = (
    _DEGREES,
    PositionUnit(
        "per cent",
        "per cent of each joint's range, from -100 to 100, as LeRobot writes them",
        "a hundredth of half of the range",
        1.0,
        is_share=True,
    ),
    PositionUnit("mrad", "milliradians", "0.001", NAMED["mrad"], name="mrad"),
    PositionUnit("mdeg", "millidegrees", "pi / 180000", NAMED["mdeg"], name="mdeg"),
    *(
        PositionUnit(
            COUNTS,
            f"counts of an encoder with {2**bits} a turn{words}",
            f"2 pi / {2**bits}",
            _TURN / 2**bits,
            middle,
            usual=0.02,
        )
        for bits, middle, words in (
            (12, -np.pi, ", the middle at 2048"),
            *((bits, 0.0, "") for bits in ENCODER_BITS),
        )
    ),
    PositionUnit("turns", "turns", "2 pi", _TURN, usual=0.02, name="turns"),
    PositionUnit(
        "shares",
        "shares of each joint's range, from -1 to 1",
        "half of the range",
        100.0,
        is_share=True,
    ),
    PositionUnit(
        "shares",
        "shares of each joint's range, from 0 to 1",
        "all of the range",
        200.0,
        -1.0,
        is_share=True,
    ),
)
_OF_A_PART = replace(_DEGREES, unit="")
#: What positions of prismatic joints may have been multiplied by. A program that makes
#: degrees of all columns changes rails, too.
_OF_RAILS = (
    PositionUnit("mm", "in millimetres", "0.001", NAMED["mm"]),
    replace(
        _OF_A_PART, words="57.3 times too large, as if degrees were made of radians"
    ),
)


def counts_a_turn(log: Likelihood) -> Number:
    """Return the number of an encoder's count [rad], common to all revolute joints.

    Its round sizes are those of a power of two a turn, as most encoders have, and of a round
    number a turn.
    """
    exact = [unit.scale for unit in UNITS if unit.is_small and not unit.is_share]
    exact += [_TURN / (x * 10.0**k) for x in _CHOSEN for k in range(3, 6)]
    return Number(
        "scale",
        tuple(log.revolute),
        sd=_SPREAD_OF_COUNTS,
        is_factor=True,
        widest=_WIDEST,
        round_sizes=tuple(dict.fromkeys(float(np.log(x)) for x in exact)),
        rounded_within=0.5 * _KNOWN,
        known_within=_KNOWN,
    )


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield units of angles. If prismatic joints are far beyond their ranges, yield what
    they may have been multiplied by, and units of angles beside each of these."""
    log = evidence.log
    largest = np.abs(fit.transform.positions(log.data.motion.q)).max(axis=0)  # (n,)
    rails = tuple(j for j in _prismatic(log) if largest[j] > _farthest(log, j))
    if not rails:
        yield from _of_angles(log, fit, fit.transform, largest)
        return
    for unit in _OF_RAILS:
        transform = fit.transform.with_multiplied("scale", rails, unit.scale)
        yield _hypothesis(unit, rails, prior_of_one_of(1), transform)
        yield from _of_angles(log, fit, transform, largest)


def _of_angles(
    log: Likelihood, fit: ViewFit, transform: LogTransform, largest: NDArray[np.float64]
) -> Iterator[Hypothesis]:
    """Yield units of angles: of all revolute joints, and degrees of each single joint that
    moves beyond a turn.

    largest : (n,) largest position of each joint [rad, m].
    """
    beyond_turn = [j for j in log.revolute if largest[j] > _TURN]
    if not beyond_turn and not fit.is_poorly_explained.any():
        return
    yield from _units_of_all(log, transform, bool(beyond_turn))
    if log.n == 1:
        return  # the only joint is all joints
    for j in beyond_turn:
        in_degrees = transform.with_multiplied("scale", (j,), _DEGREES.scale)
        yield _hypothesis(_OF_A_PART, (j,), prior_of_one_of(log.n), in_degrees)


def _hypothesis(
    unit: PositionUnit,
    joints: tuple[int, ...],
    log_prior: float,
    transform: LogTransform,
    number: Number | None = None,
) -> Hypothesis:
    """Return the hypothesis that positions of joints are in a unit."""
    return Hypothesis(
        unit.kind, joints, log_prior, transform, number, position_unit=unit.unit
    )


def _units_of_all(
    log: Likelihood, current: LogTransform, is_beyond_turn: bool
) -> Iterator[Hypothesis]:
    """Yield the units that all revolute positions may be in; nothing if the transform has
    changed their unit already.

    Small units are tried if some joint moves beyond a turn, else large ones and degrees.
    The prior of a unit falls with the distance of the largest travel from a radian.
    """
    if any(abs(current.scale[j]) != 1.0 for j in log.revolute):
        return
    for unit in UNITS:
        is_of_little_motion = not unit.is_small or unit is _DEGREES
        is_tried = unit.is_small if is_beyond_turn else is_of_little_motion
        numbers = unit.scales_and_middles(log) if is_tried else None
        if not numbers:
            continue
        # Counts about a middle are those of one encoder; of others the size is estimated.
        has_free_count = unit.unit == COUNTS and not unit.middle
        number = counts_a_turn(log) if has_free_count else None
        transform = _in_radians(current, numbers)
        travels = np.ptp(transform.positions(log.data.motion.q), axis=0)[log.revolute]
        log_travel = float(np.log(max(travels.max(), 1e-9)))
        prior = prior_of_one_of(1) + float(np.log(unit.usual))
        prior -= 0.5 * (log_travel / _SPREAD_OF_TRAVEL) ** 2
        yield _hypothesis(unit, tuple(numbers), prior, transform, number)


def _prismatic(log: Likelihood) -> list[int]:
    """List the joints whose positions are lengths."""
    return [j for j in range(log.n) if j not in log.revolute]


def _farthest(log: Likelihood, j: int) -> float:
    """Return twice the farthest that joint j can be from its zero [rad, m]: positions
    beyond have another unit."""
    joint = log.problem.robot.joints[j]
    return 2.0 * max(abs(joint.lower), abs(joint.upper))


def _in_radians(
    transform: LogTransform, numbers: Mapping[int, ScaleAndMiddle]
) -> LogTransform:
    """Return a transform that also converts joints to radians, each from a unit of its
    scale and middle."""
    for j, (scale, middle) in numbers.items():
        transform = transform.with_multiplied("scale", (j,), scale)
        transform = transform.with_entries("zero", (j,), transform.zero[j] + middle)
    return transform


def as_likely_as_radians(evidence: Evidence, fit: ViewFit) -> list[PositionUnit]:
    """List the units that such numbers may be in, and under which an arm explains the
    torques as well as it does in radians: degrees where a joint moves over a turn, turns
    and shares of the range where all are below one and move little."""
    log, current = evidence.log, fit.transform
    q = log.data.motion.q[:, log.revolute]
    travel = float(np.ptp(q, axis=0).max(initial=0.0))
    if any(abs(scale) != 1.0 for scale in current.scale):
        return []
    units = list[PositionUnit]()
    if travel >= _TURN:
        units = [_DEGREES]
    elif travel <= _LITTLE and np.abs(q).max(initial=0.0) < 1.0:
        units = [unit for unit in UNITS if not unit.is_small]
    alike = list[PositionUnit]()
    for unit in units:
        if numbers := unit.scales_and_middles(log):
            view = replace(fit.view, transform=_in_radians(current, numbers))
            if (
                fit.log_evidence - evidence.fit(view, fit.rows_worth_one).log_evidence
                < _LEAST_TO_TELL
            ):
                alike.append(unit)
    return alike


def undone_unit(
    log: Likelihood, transform: LogTransform
) -> tuple[PositionUnit, dict[int, ScaleAndMiddle]]:
    """Return the unit that a transform converts to radians, with the scale and middle of
    each joint that was in it; no joints if the factors are those of no unit.

    Of several units with these factors it is the one whose middles are nearest. If only a
    part of the joints has a unit, it is degrees.
    """
    sizes = np.abs(transform.scale)
    changed = [j for j in log.revolute if not np.isclose(sizes[j], 1.0)]
    in_degrees = [j for j in changed if np.isclose(sizes[j], _DEGREES.scale)]
    best = _DEGREES
    numbers = dict.fromkeys(in_degrees, ScaleAndMiddle(_DEGREES.scale, 0.0))
    if not changed or changed != log.revolute:
        return best, numbers
    least = np.inf
    for unit in UNITS:
        of_unit = unit.scales_and_middles(log) or {}
        scales = [scale for scale, _ in of_unit.values()]
        if of_unit and np.allclose(sizes[list(of_unit)], scales, rtol=1e-6):
            distance = sum(
                abs(transform.zero[j] - x.middle) for j, x in of_unit.items()
            )
            if distance < least:
                best, least, numbers = unit, distance, dict(of_unit)
    return best, numbers


def list_faults(log: Likelihood, transform: LogTransform) -> Iterator[Fault]:
    """Yield one fault about all revolute joints, or those in degrees, and one about
    prismatic joints."""
    sizes = np.abs(transform.scale)
    for unit in _OF_RAILS:
        long = [j for j in _prismatic(log) if np.isclose(sizes[j], unit.scale)]
        if not long:
            continue
        lengths = ", ".join(f"q{j + 1}" for j in long)
        yield Fault(
            kind=unit.kind,
            joints=tuple(long),
            what=f"the positions of {joints_text(long)} are {unit.words}: they reach"
            f" {np.abs(log.data.motion.q[:, long]).max():.4g}.",
            remedy=f"multiply {lengths} (and their dq) by {unit.factor}",
            without=transform.with_multiplied("scale", long, 1.0 / unit.scale),
            place=lengths,
            repaired_by=unit.repaired_by,
            position_unit=unit.unit,
            is_of_columns=True,
        )
    unit, numbers = undone_unit(log, transform)
    joints = tuple(numbers)
    if not joints:
        return
    without = transform
    for j, (scale, middle) in numbers.items():
        without = without.with_multiplied("scale", (j,), 1.0 / scale)
        without = without.with_entries("zero", (j,), transform.zero[j] - middle)
    largest = np.abs(log.data.motion.q[:, list(joints)]).max()
    places, are, they_reach = "positions", "are", "they reach"
    if len(joints) == 1:
        places, are, they_reach = "position", "is", "it reaches"
    channels = ", ".join(f"q{j + 1}" for j in joints)
    of_fault = unit if len(joints) == len(log.revolute) else _OF_A_PART
    yield Fault(
        kind=of_fault.kind,
        joints=joints,
        what=f"the {places} of {joints_text(joints)} {are} in {unit.words}:"
        f" {they_reach} {largest:.4g}.",
        remedy=f"multiply {channels} (and dq) by {unit.factor}",
        without=without,
        place=channels,
        repaired_by=of_fault.repaired_by,
        position_unit=of_fault.unit,
        is_of_columns=True,
    )
