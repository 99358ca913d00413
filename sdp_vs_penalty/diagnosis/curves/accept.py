"""Which measured curves are offered: those that data left out confirm."""

from collections.abc import Sequence
from dataclasses import replace

from sdp_vs_penalty.diagnosis.constants import MINOR
from sdp_vs_penalty.diagnosis.curves.measure import Measured
from sdp_vs_penalty.diagnosis.held_out import HeldOutData, harm, lowers
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.estimation.verdict import MOSTLY_NEW


def accept_curves(
    search: Search, curves: Sequence[Measured], judge: HeldOutData
) -> tuple[Measured, ...]:
    """Accept the measured curves that data left out confirm, one after the other.

    Three conditions: the curve lowers its joint's RMS error on data left out by 1 %,
    the sum of the joints' log errors does not rise by 1 %, and most of the data left
    out lie where the curve was measured (elsewhere, the table is held constant). Each
    curve is judged together with those accepted before it.

    Parameters
    ----------
    search
        The findings beside the model.
    judge
        The data left out: a test run, or folds. On a fold, a curve has the values that
        the other folds' rows give.

    Returns
    -------
    tuple of Measured
        The accepted curves, with the errors before and after each.
    """
    if not curves:
        return ()
    # Effects are chosen by number: the findings first, then the curves.
    terms = search.terms
    effects = [t.form.effect for t in terms]
    effects += [c.table for c in curves]
    curve_by_number = dict(enumerate(curves, start=len(terms)))
    held_out = judge.held_out_errors(
        search.data.rows,
        effects,
        search.data.estimate,
        by_fold={k: c.by_fold for k, c in curve_by_number.items()},
    )
    before = held_out.errors(range(len(terms)))
    accepted = dict[int, Measured]()
    for number, curve in curve_by_number.items():
        replaced = set(curve.replaced)
        for other in accepted.values():
            replaced.update(other.replaced)
        findings = [i for i, t in enumerate(terms) if t not in replaced]
        # (n,) errors with the findings, the curves accepted so far, and this one.
        after = held_out.errors([*findings, *accepted, number])
        joint = curve.joint
        lowers_its_joint = lowers(before[[joint]], after[[joint]])
        helps = lowers_its_joint and harm(before, after) < MINOR
        if not helps:
            continue
        share_outside = judge.outside(search.data.rows, curve.table, curve.by_fold)
        if share_outside <= MOSTLY_NEW:
            accepted[number] = replace(curve, before=float(before[joint]), errors=after)
            before = after
    return tuple(accepted.values())
