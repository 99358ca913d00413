"""How far a finding can be trusted: a table of named reasons for doubt.

A finding without doubts is confident. One with doubts is weak and lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from sdp_vs_penalty.diagnosis.constants import ABSORBED, EVIDENCE_TO_ADD
from sdp_vs_penalty.diagnosis.curves.measure import Measured
from sdp_vs_penalty.diagnosis.diagnosis_data import Invisible
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.sizes import Size, is_insignificant, is_uncertain, size_of
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import Effect


@dataclass(frozen=True)
class Judged:
    """One finding with all that decides its confidence."""

    #: The model with all findings.
    search: Search
    #: The finding.
    term: ScoredEffect
    #: The finding's parameters with their covariance.
    size: Size
    #: The measured curves that were accepted.
    curves: Sequence[Measured] = ()
    #: Whether the rows in which its joints slide contradict its size, or do not show it.
    is_contradicted: bool = False

    @property
    def effect(self) -> Effect:
        """The effect of the finding, with its shape constants."""
        return self.term.form.effect

    @property
    def joints(self) -> list[int]:
        """The joints (from 0) on which the finding acts, in ascending order."""
        return sorted(self.term.joints)

    @cached_property
    def value_and_std(self) -> tuple[float, float]:
        """The finding's size and its standard deviation, in the SI unit of the size.

        The standard deviation is that for exact shape constants: a different exponent
        of a friction law, for example, changes the number, but hardly the torque.
        """
        return size_of(
            self.effect, self.size.beta, self.size.covariance_given_constants
        )

    @property
    def resembles(self) -> tuple[str, ...]:
        """Names of effects that make nearly the same torque over what was travelled.

        Friction that turns round over a travel may be stiction where these runs leave
        that travel, and with it the size, open; no joint has to stand for that.
        """
        coverage = self.search.data.rows.coverage(self.effect.joints[0])
        alike = self.effect.resembles_over(coverage)
        turns = self.effect.has_memory and self.effect.at_rest == "turns"
        if not (
            turns and self.size_is_open and not is_insignificant(*self.value_and_std)
        ):
            return alike
        holding = [x for x, kind in effect_types().items() if kind.at_rest == "holds"]
        return (*alike, *holding)

    @property
    def size_is_open(self) -> bool:
        """Whether nothing tells the size from zero, with the errors of its shape
        constants."""
        beta, covariance = self.size.beta, self.size.covariance
        return is_insignificant(*size_of(self.effect, beta, covariance))

    @property
    def looks_like(self) -> str:
        """A sentence about another cause that would look like this effect in the rows.

        The effect decides from its size and from the travel and resolution that the
        rows show of its first joint. "" if there is no such cause.
        """
        coverage = self.search.data.rows.coverage(self.effect.joints[0])
        size, _ = self.value_and_std
        return self.effect.looks_like(size, coverage)


def _makes_no_torque(x: Judged) -> bool:
    """Return whether nothing tells the torque from zero: neither its own interval, nor
    that of the size if the shape constants were exact.

    A law of friction shares its torque with the model's own law, so that its interval
    alone is wide. A size that follows its constants may be anything, and its torque is
    known.
    """
    torque = x.size.torque
    return is_insignificant(torque.rms, torque.std) and is_insignificant(
        *x.value_and_std
    )


def _is_small(x: Judged) -> bool:
    """Return whether a finding's evidence J is at most twice that to be added."""
    return not x.term.evidence > 2.0 * EVIDENCE_TO_ADD  # "not ... >": True for NaN


#: By the name of a reason for doubt (a key of REASONS): whether it applies to a finding.
DOUBTS: Mapping[str, Callable[[Judged], bool]] = {
    "rivals": lambda x: bool(x.term.rivals or x.effect.resembles),
    # As if its shape constants were exact; "insignificant" counts their errors too.
    "uncertain": lambda x: is_uncertain(*x.value_and_std),
    # With the errors of the shape constants.
    "insignificant": lambda x: x.size_is_open,
    "no_torque": _makes_no_torque,
    "small": _is_small,
    "sticks": lambda x: x.is_contradicted,
    # What looks like a law of how friction turns round is such a law.
    "looks_like": lambda x: bool(x.looks_like) and x.effect.at_rest != "turns",
    "sharp": lambda x: bool(x.looks_like) and x.effect.at_rest == "turns",
    "stand_in": lambda x: x.effect.is_stand_in,
    "curve": lambda x: any(x.term in c.replaced for c in x.curves),
}


def reasons_for_doubt(x: Judged) -> tuple[Doubt, ...]:
    """List the reasons to doubt a finding; a finding without any is confident.

    Reasons about the finding itself: another effect fits as well; its size is
    uncertain, or not different from zero; its size is smaller where the joints slide; its
    evidence is small. Reasons about its surroundings: another cause would look like it;
    a measured curve fits better.
    """
    return tuple(
        Doubt(reason, cause=x.looks_like if reason in ("looks_like", "sharp") else "")
        for reason, holds in DOUBTS.items()
        if holds(x)
    )


def invisible_effects(search: Search) -> tuple[Invisible, ...]:
    """List the effects that these recordings cannot show, since the model absorbs them.

    The model's columns can explain all but 0.01 % (ABSORBED) of the squares of their
    white torque, for all shape constants tried. Effects that were found nevertheless
    are not listed. Empty if the model is held fixed: it then absorbs nothing.
    """
    if search.data.frozen:
        return ()
    fit = search.score.fit(())
    # By key (effect name, joint): the smallest share absorbed over all shape constants.
    smallest_shares = dict[tuple[str, int | None], float]()
    for batch in search.library.batches:
        absorbed = search.score.absorbed(fit, batch)
        for form, share in zip(batch.forms, absorbed.tolist(), strict=True):
            share_so_far = smallest_shares.get(form.key, 1.0)
            smallest_shares[form.key] = min(share_so_far, share)
    keys_found = {t.key for t in search.terms}
    invisible = []
    for (name, joint), share in smallest_shares.items():
        if share > 1.0 - ABSORBED and (name, joint) not in keys_found:
            joints = () if joint is None else (joint + 1,)
            invisible.append(Invisible(name, joints, share))
    return tuple(invisible)
