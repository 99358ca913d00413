"""A common factor of all positions: an encoder's counts a turn are any number, and a unit
that nobody named, or one that was named wrongly, is a factor too."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.race import constants as c
from sdp_vs_penalty.race.chain import LogTransform
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.fault import Fault, prior_of_one_of
from sdp_vs_penalty.race.kinds.position_unit import COUNTS, counts_a_turn, undone_unit
from sdp_vs_penalty.race.likelihood import Likelihood
from sdp_vs_penalty.race.records import Hypothesis, Number, at_sizes

#: Factors that are tried [-].
_FACTORS = (1.0, 0.75, 1.35)
_TURN = 2.0 * np.pi


def _number(log: Likelihood) -> Number:
    """Return the common factor of the revolute joints' positions."""
    return Number(
        "scale",
        tuple(log.revolute),
        sd=0.5,
        usual=c.CALIBRATED_GAIN,
        is_factor=True,
        widest=c.WIDEST,
        known_within=c.WIDEST,
        limits=(-2.0, 2.0),
    )


def _factor_in_words(log_factor: float) -> str:
    """Write a factor, by its natural logarithm."""
    return f"a factor of {np.exp(log_factor):.4g}"


def _counts_in_words(log_count: float) -> str:
    """Write the counts a turn, by the natural logarithm of a count [rad]."""
    return f"{_TURN / np.exp(log_count):.5g}"


def propose(evidence: Evidence, fit: ViewFit) -> Iterator[Hypothesis]:
    """Yield another factor of all positions of an arm that is poorly explained, where they
    are radians."""
    log, now = evidence.log, fit.chain
    is_in_radians = bool(np.all(np.abs(now.scale)[log.revolute] == 1.0))
    if not is_in_radians or len(log.revolute) < 2 or not fit.is_poorly_explained.any():
        return
    prior = prior_of_one_of(1)
    yield from at_sizes("position scale", prior, now, _number(log), np.log(_FACTORS))


def list_faults(log: Likelihood, chain: LogTransform) -> Iterator[Fault]:
    """Yield one fault about all revolute joints whose factor is no unit's."""
    scales = {abs(chain.scale[j]) for j in log.revolute}
    if len(log.revolute) < 2 or len(scales) > 1 or scales == {1.0}:
        return
    _, joints_of_unit = undone_unit(log, chain)
    if joints_of_unit:
        return
    (scale,) = scales
    kind, number = "position scale", _number(log)
    are = f"are {1.0 / scale:.3g} times too large"
    if scale < c.LARGEST_COUNT:
        kind, number = COUNTS, counts_a_turn(log)
        are = f"are in counts of an encoder with {_TURN / scale:.5g} a turn"
    channels = ", ".join(f"q{j + 1}" for j in log.revolute)
    # The sign of a position is a fault of its own.
    without = replace(
        chain,
        scale=tuple(
            math.copysign(1.0, present) if j in log.revolute else present
            for j, present in enumerate(chain.scale)
        ),
    )
    yield Fault(
        kind=kind,
        joints=tuple(log.revolute),
        what=f"the positions of all joints {are}.",
        remedy=f"multiply {channels} (and dq) by {scale:.5g}",
        without=without,
        number=number,
        in_words=_counts_in_words if kind == COUNTS else _factor_in_words,
        place=channels,
        figures={"factor": scale},
    )
