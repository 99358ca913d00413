"""Whether a swing has a direction in time.

A link swings on its gear after it is pushed, never before. Errors of the positions have
no such direction: encoder steps make the modelled torque too large at high frequencies,
and a law that lessens it there explains the error, whatever its phase.
"""

from __future__ import annotations

from dataclasses import replace

from sdp_vs_penalty.diagnosis.constants import EVIDENCE_TO_DISTINGUISH
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.effects.links import swing_both_ways


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
    both_ways = swing_both_ways(term.form.effect)
    if both_ways is None:
        return False
    columns = search.data.columns(both_ways)
    others = [t for t in search.terms if t is not term]
    fit = search.score.fit(search.nuisances.with_law_misfits(others), search.fit)
    one_way = search.score.evidence_of(fit, term.form, term.columns)
    form = replace(term.form, effect=both_ways)
    rival = search.score.evidence_of(fit, form, columns)
    margin = EVIDENCE_TO_DISTINGUISH * one_way.rows_worth_one
    return one_way.drop - rival.drop < margin
