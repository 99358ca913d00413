"""A common factor of all positions: an encoder's counts a turn are any number, and a unit
that nobody named, or one that was named wrongly, is a factor too."""

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


def _factor(size: float) -> str:
    """Return a factor in words, by its natural logarithm."""
    return f"a factor of {np.exp(size):.4g}"


def _turns(size: float) -> str:
    """Return the counts a turn in words, by the natural logarithm of a count [rad]."""
    return f"{_TURN / np.exp(size):.5g}"


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
    scales = np.abs(chain.scale)[log.revolute]
    is_common = len(scales) > 1 and np.ptp(scales) == 0.0
    if not is_common or scales[0] == 1.0 or undone_unit(log, chain)[1]:
        return
    scale = float(scales[0])
    kind, number = "position scale", _number(log)
    are = f"are {1.0 / scale:.3g} times too large"
    if scale < c.LARGEST_COUNT:
        kind, number = COUNTS, counts_a_turn(log)
        are = f"are in counts of an encoder with {_TURN / scale:.5g} a turn"
    channels = ", ".join(f"q{j + 1}" for j in log.revolute)
    as_logged = np.where(np.isin(range(log.n), log.revolute), np.sign(chain.scale), 0.0)
    entries = np.where(as_logged != 0.0, as_logged, chain.scale).tolist()
    yield Fault(
        kind=kind,
        joints=tuple(log.revolute),
        what=f"the positions of all joints {are}.",
        remedy=f"multiply {channels} (and dq) by {scale:.5g}",
        without=replace(chain, scale=tuple(entries)),
        number=number,
        in_words=_turns if kind == COUNTS else _factor,
        place=channels,
        figures={"factor": scale},
    )
