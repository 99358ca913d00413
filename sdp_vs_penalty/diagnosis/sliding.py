"""What the rows in which the joints slide say of findings and of errors.

Where a joint stands or turns round, dry friction holds any torque up to its limit, and
no law of sliding is right to the last row. An effect of another name may explain some
of that. What acts at all rows has the same size without these rows: a size that the
sliding rows contradict is of friction that sticks (a specification test: Hausman,
Econometrica 1978). And what is evident only where friction may hold any torque is not
evident, unless it is a law of that friction.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sdp_vs_penalty.diagnosis.constants import EVIDENCE_TO_ADD
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect, WhiteFit
from sdp_vs_penalty.diagnosis.sizes import largest_sums_of_scores
from sdp_vs_penalty.diagnosis.white_rows import WhiteData

#: A contradicted size changes by more than this share of itself, and by more than two
#: standard deviations. True findings of 18 worlds in MuJoCo (results/bench/red_team.py)
#: fell by 15 % at most.
_CHANGE = 0.25


def contradicted_by_sliding(
    data: WhiteData, fit: WhiteFit, terms: Sequence[ScoredEffect]
) -> list[bool]:
    """Return of each finding whether the rows in which the joints slide contradict its
    size, or hold too little evidence of it.

    With the orthonormal columns B of the fit, its residual r and the sliding rows D, the
    coefficients change by c = (B'DB)^-1 B'D r. A finding's size is the length of its
    scaled coefficients b, and x = b'(b + c_b) / |b| on sliding rows, with a variance s^2
    from the scores' sums over clusters. Their evidence is (x / s)^2 less the finding's
    price, as in the search. A law of the joint's own dry friction may show at reversals
    alone.
    """
    rows = data.rows
    slides = (rows.keep & rows.slides).T
    if slides.all() or not slides.any():
        return [False] * len(terms)
    B = fit.basis * slides[:, :, None]
    gram = np.tensordot(B, B, axes=((0, 1), (0, 1))) + fit.precision
    # What no sliding row shows has a variance of 1e10 here, not zero.
    inverse = np.linalg.inv(gram + 1e-10 * np.eye(len(gram)))
    change = inverse @ np.tensordot(B, fit.residual, axes=((0, 1), (0, 1)))
    residual = fit.residual - B @ change
    out = []
    for term in terms:
        places = fit.design.columns_by_text[term.text]
        coefficients = fit.theta[places]
        size = float(np.linalg.norm(coefficients))
        # The size's gradient by the coefficients of B.
        along = (coefficients / max(size, 1e-300)) @ fit.whitener[places]
        difference = float(along @ change)
        influence = B @ (inverse @ along)
        scores = np.sum(influence * residual, axis=0)[:, None]
        std = float(np.linalg.norm(largest_sums_of_scores(data.clusters, scores)))
        std_of_independent_rows = float(along @ inverse @ along) ** 0.5
        std = max(std, std_of_independent_rows)
        is_other_size = abs(difference) > max(_CHANGE * size, 2.0 * std)
        evidence = max(size + difference, 0.0) ** 2 / std**2 - term.price
        is_evident = evidence > EVIDENCE_TO_ADD or term.form.effect.is_dry_friction
        out.append(is_other_size or not is_evident)
    return out
