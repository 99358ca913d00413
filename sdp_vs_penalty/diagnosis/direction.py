"""Whether a swing has a direction in time.

A link swings on its gear after it is pushed, never before. Errors of the positions have
no such direction: encoder steps make the modelled torque too large at high frequencies,
and a law that lessens it there explains the error, whatever its phase.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sdp_vs_penalty.diagnosis.constants import EVIDENCE_TO_DISTINGUISH
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.effects.links import JointResonance
from sdp_vs_penalty.robot.arrays import Array


class SwingBothWays(JointResonance):
    """A resonance without a direction in time: half of the swing comes before its cause.

    Let G(w) be the response of the resonance at the angular frequency w. This one's is
    its real part, (G(w) + G(-w)) / 2: the amplitude in phase, and none in quadrature.
    """

    def lag(
        self, torque: Array, step: float, compliance: float, slopes: Sequence[Array]
    ) -> Array:
        """Compute the mean (N,) [rad, m] of the lag in the log as it is and in the log
        played backwards, where velocities have the other sign."""
        by_q, by_dq, by_ddq = slopes
        backwards = by_q[::-1], -by_dq[::-1], by_ddq[::-1]
        after = super().lag(torque, step, compliance, slopes)
        before = super().lag(torque[::-1], step, compliance, backwards)
        return (after + before[::-1]) / 2.0


def has_no_direction(search: Search, term: ScoredEffect) -> bool:
    """Return whether a swing both ways explains the torque of a resonance as well.

    Both have the same constants, and are judged beside all other findings. The
    resonance is told from a swing both ways where its evidence is larger by 6 (odds of
    20 to 1). False for all other effects.

    Parameters
    ----------
    search
        The model with all findings.
    """
    effect = term.form.effect
    if not isinstance(effect, JointResonance):
        return False
    both_ways = SwingBothWays(effect.robot, effect.joints, **effect.shape)
    columns = search.data.columns(both_ways)
    others = [t for t in search.terms if t is not term]
    fit = search.score.fit(search.nuisances.with_law_misfits(others), search.fit)
    one_way = search.score.evidence_of(fit, term.form, term.columns)
    form = replace(term.form, effect=both_ways)
    rival = search.score.evidence_of(fit, form, columns)
    margin = EVIDENCE_TO_DISTINGUISH * one_way.rows_worth_one
    return one_way.drop - rival.drop < margin
