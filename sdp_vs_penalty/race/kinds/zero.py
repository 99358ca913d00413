"""Joints that are elsewhere than the robot's kinematics say: encoders that count from another
zero."""

import operator
from collections.abc import Callable, Iterator
from functools import partial
from itertools import combinations, product

import numpy as np

from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import (
    Fault,
    degrees_text,
    length_like_a_radian,
    prior_of_one_of,
)
from sdp_vs_penalty.race.kinds import position_unit
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis, Number

#: Lengths are known better than angles by this factor [-].
_LENGTH_OVER_ANGLE = 0.25
#: Turns of joints that are set a quarter of a turn off, or more [rad].
_QUARTERS = -np.pi / 2, np.pi / 2, np.pi
#: Standard deviation beforehand of a zero, in radians or lengths that matter as much; of a
#: joint that was set anew [rad].
_SD, _SD_OF_TURN = 0.3, 1.5


def zero_number(log: Likelihood, j: int, sd: float = _SD) -> Number:
    """Return the number of joint j's encoder zero, which is added to its position [rad, m],
    with a prior standard deviation ``sd`` [rad, or lengths that matter as much]."""
    if j not in log.revolute:
        unit = length_like_a_radian(log)
        usual = _LENGTH_OVER_ANGLE * c.CALIBRATED * unit
        return Number("zero", (j,), sd * unit, usual, step=0.01 * unit)
    turns = (*_QUARTERS, -np.pi)
    return Number("zero", (j,), sd, c.CALIBRATED, widest=c.WIDEST, round_sizes=turns)


#: A hypothesis about zeros of encoders.
_hypothesis = partial(Hypothesis, "encoder offset", may_begin_in_run=True)


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield another zero of each joint's encoder: near the present one, and a quarter or
    half turn off if the arm is poorly explained; of two joints at once if several mistakes
    may hide each other."""
    log, current = evidence.log, fit.transform
    prior = prior_of_one_of(log.n)
    for j in log.joints:
        number = zero_number(log, j)
        yield _hypothesis((j,), prior, current, number)
        if j not in log.revolute or not fit.is_poorly_explained.any():
            continue
        for turn in _QUARTERS:
            transform = _turned(current, j, turn)
            number = zero_number(log, j, _SD_OF_TURN)
            odds = prior - np.log(len(_QUARTERS))
            yield _hypothesis((j,), odds, transform, number)
    if not fit.may_be_rearranged:
        return
    # If two joints are turned, undoing one of them alone explains little.
    joints = [j for j in log.revolute if j]
    for a, b in combinations(joints, 2):
        for first, second in product(_QUARTERS, _QUARTERS):
            transform = _turned(_turned(current, a, first), b, second)
            odds = 2.0 * (prior - np.log(len(_QUARTERS)))
            yield _hypothesis((a, b), odds, transform)


def _turned(transform: LogTransform, j: int, turn: float) -> LogTransform:
    """Return the transform with joint j's zero turned [rad], to within half a turn."""
    zero = float(np.pi - (np.pi - transform.zero[j] - turn) % (2.0 * np.pi))
    return transform.with_entries("zero", (j,), zero)


def list_faults(log: Likelihood, transform: LogTransform) -> Iterator[Fault]:
    """Yield a fault for each joint whose zero the transform changes, by more than its
    unit of positions does."""
    _, of_unit = position_unit.undone_unit(log, transform)
    middles = np.zeros(log.n)
    for j, numbers in of_unit.items():
        middles[j] = numbers.middle
    # What the repair adds [rad, m]; the encoder's zero is off by minus that.
    offsets = np.array(transform.zero) - middles
    for j in np.flatnonzero(offsets).tolist():
        offset = float(offsets[j])
        size_text = degrees_text if j in log.revolute else _metres
        unit = log.problem.robot.position_units[j]
        # A base that is turned about the first axis has the same effect.
        is_mounting = j == 0 and j in log.revolute
        base = ", or its base is turned as much about that axis" * is_mounting
        yield Fault(
            kind="encoder offset",
            of_positions="zero",
            joints=(j,),
            what=f"the zero of joint {j + 1} is {size_text(-offset)} away from the robot's"
            f" kinematics{base}.",
            remedy=f"add {offset:+.5g} {unit} to q{j + 1}",
            without=transform.with_entries("zero", (j,), float(middles[j])),
            number=None if middles[j] else zero_number(log, j),
            in_words=partial(_minus, size_text),
            sort_key=operator.neg,
            repaired_by=("zero", "q"),
            figures={"shifts": [offset]},
        )


def _metres(length: float) -> str:
    """Return a length [m] in words: "0.25 m"."""
    return f"{length:.4g} m"


def _minus(in_words: Callable[[float], str], size: float) -> str:
    """Return in words how far a zero is off: minus what the repair adds."""
    return in_words(-size)
