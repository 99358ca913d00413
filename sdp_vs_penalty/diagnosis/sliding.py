"""Sizes of findings from the rows in which the joints slide, beside those from all rows.

Where a joint stands or turns round, dry friction holds any torque up to its limit, and
no law of sliding is right to the last row. An effect of another name may explain some
of that. What acts at all rows has the same size without these rows: a size that the
sliding rows contradict is of friction that sticks (a specification test: Hausman,
Econometrica 1978).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect, WhiteFit
from sdp_vs_penalty.diagnosis.sizes import largest_sums_of_scores
from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.robot.arrays import Mask
from sdp_vs_penalty.signals.segments import SegmentedRuns
from sdp_vs_penalty.signals.standstill import SLOW, STILL

#: A contradicted size falls by more than this share of itself, and by more than two
#: standard deviations. True findings of 18 worlds in MuJoCo (results/bench/red_team.py)
#: fell by 15 % at most.
_FALL = 0.25


def joints_slide(rows: SegmentedRuns) -> Mask:
    """Return the rows (M, n) in which a joint neither stands still nor turns round."""
    return (rows.still <= STILL) & (rows.slow <= SLOW)


def contradicted_by_sliding(
    data: WhiteData, fit: WhiteFit, terms: Sequence[ScoredEffect]
) -> list[bool]:
    """Return of each finding whether the rows in which the joints slide contradict its
    size.

    With the orthonormal columns B of the fit, its residual r and the sliding rows D, the
    coefficients change by c = (B'DB)^-1 B'D r. A finding's size is the length of its
    scaled coefficients b, and b'(b + c_b) / |b| on sliding rows, with a variance from the
    scores' sums over clusters.
    """
    rows = data.rows
    slides = (rows.keep & joints_slide(rows)).T
    if slides.all() or not slides.any():
        return [False] * len(terms)
    B = fit.basis * slides[:, :, None]
    gram = np.tensordot(B, B, axes=((0, 1), (0, 1))) + fit.precision
    inverse = np.linalg.pinv(gram, rcond=1e-10, hermitian=True)
    change = inverse @ np.tensordot(B, fit.residual, axes=((0, 1), (0, 1)))
    residual = fit.residual - B @ change
    out = []
    for term in terms:
        places = fit.design.columns_by_text[term.text]
        b = fit.theta[places]
        size = float(np.linalg.norm(b))
        along = (b / max(size, 1e-300)) @ fit.whitener[places]
        fall = -float(along @ change)
        influence = B @ (inverse @ along)
        scores = np.sum(influence * residual, axis=0)[:, None]
        std = float(np.linalg.norm(largest_sums_of_scores(data.clusters, scores)))
        out.append(fall > max(_FALL * size, 2.0 * std))
    return out
