"""Which measured curves are offered: those that data left out confirm."""

from collections.abc import Sequence
from dataclasses import replace

from sdp_vs_penalty.diagnosis.constants import MINOR
from sdp_vs_penalty.diagnosis.curves.measure import Measured
from sdp_vs_penalty.diagnosis.held_out import HeldOutData, harm, lowers
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.estimation.verdict import MOSTLY_NEW


def accept_curves(
    search: Search,
    curves: Sequence[Measured],
    judge: HeldOutData,
) -> tuple[Measured, ...]:
    """Those that lower their joint's held-out error by more than what is minor, raise no
    other's, and whose tables the test run does not leave for most of its rows.

    Held-out errors use the values that the other folds' rows make.
    """
    if not curves:
        return ()
    terms = search.terms
    tables = {len(terms) + k: c for k, c in enumerate(curves)}
    effects = [
        *(t.form.effect for t in terms),
        *(c.table for c in curves),
    ]
    by_fold = {k: c.by_fold for k, c in tables.items()}
    rows = search.data.rows
    held_out = judge.held_out_errors(rows, effects, search.data.estimate, by_fold)
    before = held_out.errors(range(len(terms)))
    out = list[Measured]()
    accepted = list[int]()
    for k, curve in tables.items():
        replaced = {t for c in (*out, curve) for t in c.replaced}
        beside = [i for i, t in enumerate(terms) if t not in replaced]
        after = held_out.errors([*beside, *accepted, k])
        joint = [curve.joint]
        helps = lowers(before[joint], after[joint]) and harm(before, after) < MINOR
        # Most of the test run has to be where the table is no constant.
        if helps and judge.outside(curve.table) <= MOSTLY_NEW:
            error_before = float(before[curve.joint])
            out.append(replace(curve, before=error_before, errors=after))
            before = after
            accepted.append(k)
    return tuple(out)
