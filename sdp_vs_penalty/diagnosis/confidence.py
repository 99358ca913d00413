"""How far a finding is to be believed: one table of named doubts.

A finding with no doubt is confident; a weak one prints its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sdp_vs_penalty.diagnosis.constants import (
    ABSORBED,
    EVIDENCE_TO_ADD,
    IMPLAUSIBLE_SIGMAS,
    SIGNIFICANT,
    UNCERTAIN,
)
from sdp_vs_penalty.diagnosis.curves.measure import Measured
from sdp_vs_penalty.diagnosis.findings import REASONS, Invisible
from sdp_vs_penalty.diagnosis.held_out import lowers
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.sizes import Size, size_of
from sdp_vs_penalty.diagnosis.unexplained import Remainder
from sdp_vs_penalty.diagnosis.white_rows import spread_columns
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class Judged:
    """A finding and all that its confidence is judged by.

    left : of all findings; errors (2, n) : held out, before and after it; curves : that
    were measured.
    """

    search: Search
    left: Remainder
    term: ScoredEffect
    size: Size
    errors: Array
    curves: Sequence[Measured] = ()

    @property
    def effect(self) -> Effect:
        """The effect that was found."""
        return self.term.form.effect

    @property
    def joints(self) -> list[int]:
        """The joints (from 0) on which it acts."""
        return sorted(self.term.joints)

    @cached_property
    def value_and_std(self) -> tuple[float, float]:
        """Its size and the standard deviation where its shape constants are exact.

        An error of an exponent changes the number, and hardly the torque.
        """
        return size_of(
            self.effect,
            self.size.beta,
            self.size.covariance_given_constants,
        )

    @property
    def looks_like(self) -> str:
        """What else a model may lack that passes for it, in words."""
        coverage = self.search.data.rows.seen(self.effect.joints[0])
        return self.effect.looks_like(self.value_and_std[0], coverage)


def _is_uncertain(x: Judged) -> bool:
    """Nothing is known of a size of zero."""
    size, std = x.value_and_std
    return not std < UNCERTAIN * abs(size)


def _is_insignificant(x: Judged) -> bool:
    """Its size is not told from zero, its shape constants being as uncertain as they
    are."""
    size, std = size_of(
        x.effect,
        x.size.beta,
        x.size.covariance,
    )
    return not std < SIGNIFICANT * abs(size)


def _leaves_more(x: Judged) -> bool:
    """More is left on its joints than it explains there, or in all: a wrong gain shows
    on those that it keeps from a fit."""
    if not x.search.data.known:
        return False
    gained = x.errors[0] ** 2 - x.errors[1] ** 2
    on_joints = float(np.sum(np.maximum(gained[x.joints], 0.0)))
    explained = max(on_joints, float(np.sum(gained)))
    return bool(explained < np.sum(x.left.beyond[x.joints] ** 2))


def _is_shared(x: Judged) -> bool:
    """Other findings make most of its energy beside the model's columns."""
    search = x.search
    others = [t for t in search.terms if t != x.term]
    alone = search.score.fit([], search.fit).energy(x.term)
    beside = search.score.fit(others, search.fit).energy(x.term)
    return 1.0 - beside / max(alone, 1e-300) > 1.0 - UNCERTAIN


def _is_implausible(x: Judged) -> bool:
    """It makes more torque than there is, or is larger than its effect says is
    plausible."""
    rows = x.search.data.rows
    beta = x.size.beta
    torque = np.mean((spread_columns(rows, x.effect) @ beta) ** 2, axis=1)
    if np.any(torque > np.mean(rows.torque**2, axis=0)):
        return True
    plausible = x.effect.plausible
    if plausible is None:
        return False
    sigmas = np.sqrt(np.mean((beta / plausible) ** 2))
    return bool(sigmas > IMPLAUSIBLE_SIGMAS)


#: What speaks against a finding, by the names of REASONS.
DOUBTS: Mapping[str, Callable[[Judged], bool]] = {
    "rivals": lambda x: bool(x.term.rivals or x.effect.resembles),
    "uncertain": _is_uncertain,
    "insignificant": _is_insignificant,
    "small": lambda x: not x.term.evidence > 2.0 * EVIDENCE_TO_ADD,
    "not_held_out": lambda x: not lowers(*x.errors[:, x.joints]),
    "more_left": _leaves_more,
    "shared": _is_shared,
    "implausible": _is_implausible,
    "looks_like": lambda x: bool(x.looks_like),
    "curve": lambda x: any(x.term in c.replaced for c in x.curves),
}


def reasons_for_doubt(x: Judged) -> dict[str, str]:
    """Why a finding is weak, by name, with what is said of it.

    About the finding: another effect fits as well, the size is uncertain, not told from
    zero or not plausible, the gain is small, no held-out error falls. About what is around it: more
    is left than explained, other findings make most of its torque, something else looks
    so, a curve does better.
    """
    sentences = {**REASONS, "looks_like": x.looks_like}
    return {name: sentences[name] for name, holds in DOUBTS.items() if holds(x)}


def invisible_effects(search: Search) -> tuple[Invisible, ...]:
    """Candidates whose energy the model's own columns absorb, whatever their shape.

    What was found all the same has shown itself, and its standard deviation says how
    well.
    """
    if search.data.frozen:
        return ()
    fit = search.score.fit(())
    shares = dict[tuple[str, int | None], float]()
    for batch in search.library.batches:
        absorbed = search.score.absorbed(fit, batch)
        for form, share in zip(batch.forms, absorbed.tolist(), strict=True):
            shares[form.key] = min(shares.get(form.key, 1.0), share)
    found = {t.key for t in search.terms}
    return tuple(
        Invisible(
            name,
            () if joint is None else (joint + 1,),
            share,
        )
        for (name, joint), share in shares.items()
        if share > 1.0 - ABSORBED and (name, joint) not in found
    )
