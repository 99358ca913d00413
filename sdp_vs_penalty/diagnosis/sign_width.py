"""The velocity over which a joint's dry friction changes its sign, and all effects that
have that sign.

Coulomb friction f_c tanh(dq / v_s) turns round over v_s, and so do all other effects on
its joint with the sign of the velocity (Stribeck friction, friction by load). A model
without such an effect has estimated v_s without it, and may be wrong. The search alone
changes v_s in the column of Coulomb friction only; here it changes in all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdp_vs_penalty.diagnosis.constants import EVIDENCE_TO_ADD
from sdp_vs_penalty.diagnosis.late_torque import (
    beside_model,
    refer_columns_to_current_model,
)
from sdp_vs_penalty.diagnosis.library import Candidate, Key
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect
from sdp_vs_penalty.diagnosis.own_constants import with_constants
from sdp_vs_penalty.diagnosis.refine import Judge, refine_constants
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.velocity_friction import STAND_FOR_WIDTH
from sdp_vs_penalty.estimators.estimator import Progress, no_progress

#: The constant that is the width of a sign [rad/s, m/s].
WIDTH = "v_s"
#: Searches with new widths. The second follows what the first has found.
_ROUNDS = 3


@dataclass(frozen=True)
class _WidthInDoubt:
    """A joint whose findings contradict the width over which its friction turns round."""

    #: The model's effect that has the width, (name, joint from 0).
    key: tuple[str, int]
    #: The findings that stand for another width.
    stand_ins: tuple[ScoredEffect, ...]
    #: The other findings whose columns follow the width.
    with_sign: tuple[ScoredEffect, ...]


def refer_signs_to_current_model(
    search: Search, progress: Progress = no_progress
) -> Search:
    """Continue a search with the widths of signs that its findings show.

    A width is in doubt where a finding replaces it, or where a sigmoid stands for it,
    beside other findings with the joint's sign. It is estimated in the columns of all
    of them. If that explains the rows better than the finding does, the search goes on
    with the new width, without the finding. The result is kept if its criterion (BIC,
    with the price of the width) is lower by EVIDENCE_TO_ADD or more.

    Parameters
    ----------
    progress
        Called with a short text whenever an effect is added.

    Returns
    -------
    Search
        The continued search, whose model has the new widths; its first terms are these
        as re-estimated constants. The given search if no width is in doubt.
    """
    best = search
    widths = dict[Key, ScoredEffect]()
    for _ in range(_ROUNDS):
        new = dict[Key, ScoredEffect]()
        stand_ins = list[ScoredEffect]()
        for doubt in _widths_in_doubt(best):
            width = _width_of_all_signs(best, doubt)
            if width is not None:
                new[doubt.key] = width
                stand_ins += doubt.stand_ins
        if not new:
            break
        current = _continued(best, stand_ins, [*new.values()], progress)
        price = float(np.log(search.data.y.size)) * len(new.keys() - widths.keys())
        if best.criterion - current.criterion - price < EVIDENCE_TO_ADD:
            break
        widths |= new
        best = current
    return _with_widths(best, widths)


def _widths_in_doubt(search: Search) -> Iterator[_WidthInDoubt]:
    """Yield the widths that the findings of a search contradict, one a joint at most."""
    for key, (effect, _) in search.data.own_effects.items():
        if WIDTH not in effect.estimated:
            continue
        _, joint = key
        on_joint = [t for t in search.terms if joint in t.joints]
        keys = key, *((name, joint) for name in STAND_FOR_WIDTH)
        stand_ins = tuple(t for t in on_joint if t.key in keys)
        with_sign = tuple(
            t for t in on_joint if t not in stand_ins and not t.form.effect.signless
        )
        if stand_ins and with_sign:
            yield _WidthInDoubt(key, stand_ins, with_sign)


def _width_of_all_signs(search: Search, doubt: _WidthInDoubt) -> ScoredEffect | None:
    """Estimate the width of a joint's sign in the columns of all findings that have it.

    Parameters
    ----------
    doubt
        The joint, its stand-ins, and the findings whose columns follow the width.

    Returns
    -------
    ScoredEffect or None
        The model's effect with the width of the lowest deviance, which it lowers from
        that with the present width. None if the deviance with the stand-ins is as low.
    """
    data = search.data
    effect, _ = data.own_effects[doubt.key]
    in_doubt = *doubt.stand_ins, *doubt.with_sign
    others = [t for t in search.terms if t not in in_doubt]

    def scored(form: Candidate) -> ScoredEffect:
        """Score the model's effect with another width, as the search does."""
        return search.evidence_of(search.bare, form)

    def drop(form: Candidate) -> float:
        """Return the drop of the deviance by a width in all columns of the sign."""
        rows = data.rows.with_sign_of(form.effect)
        over_width = replace(data, rows=rows)
        with_sign = [
            replace(t, columns=over_width.columns(t.form.effect))
            for t in doubt.with_sign
        ]
        fit = search.score.fit([*others, scored(form), *with_sign])
        return -float(fit.own_deviance)

    grid = effect.shapes[WIDTH].on(effect.robot.joints[doubt.key[1]].kind).grid
    present = Candidate(doubt.key, effect, replaces_own_constant=True)
    forms = [present.with_shape(**{WIDTH: width}) for width in grid]
    best = max(forms, key=drop)
    refined = refine_constants(Judge(scored, drop), scored(best))
    lowest = -drop(refined.form)
    if search.fit.own_deviance - lowest < EVIDENCE_TO_ADD:
        return None
    return replace(refined, drop=-drop(present) - lowest)


def _continued(
    search: Search,
    stand_ins: Sequence[ScoredEffect],
    widths: Sequence[ScoredEffect],
    progress: Progress,
) -> Search:
    """Continue a search beside the model with new widths, without their stand-ins."""
    without = search.with_terms([t for t in search.terms if t not in stand_ins])
    out = beside_model(without, with_constants(search.data.estimate, widths))
    joints = frozenset(joint for width in widths for joint in width.joints)

    def follows_a_width(effect: Effect) -> bool:
        """Return whether an effect's columns follow a width that has changed."""
        return not (effect.signless or joints.isdisjoint(effect.joints))

    out.library = search.library.with_columns_of(follows_a_width, out.data)
    out.terms = out.drop_weak(out.terms, on=joints)
    out.run(progress)
    return refer_columns_to_current_model(out, progress)


def _with_widths(search: Search, widths: dict[Key, ScoredEffect]) -> Search:
    """Put new widths before the terms of a search, as re-estimated constants.

    One that the search has re-estimated once more is among its terms already.
    """
    again = {t.key for t in search.terms if t.form.replaces_own_constant}
    new = [term for key, term in widths.items() if key not in again]
    return search.with_terms([*new, *search.terms]) if new else search
