"""How far a finding can be trusted: a table of named reasons for doubt.

A finding without doubts is confident. One with doubts is weak and lists them.
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
    """One finding with all that its confidence is judged by.

    search : all findings beside the model; left : the torque that all findings leave
    unexplained; term : the finding; size : its parameters with covariance; errors (2,
    n) : RMS error of each joint [N m or N] on data left out, without and with it;
    curves : the measured curves that were accepted.
    """

    search: Search
    left: Remainder
    term: ScoredEffect
    size: Size
    errors: Array
    curves: Sequence[Measured] = ()

    @property
    def effect(self) -> Effect:
        """The effect of the finding, with its shape constants."""
        return self.term.form.effect

    @property
    def joints(self) -> list[int]:
        """The joints (from 0) on which it acts."""
        return sorted(self.term.joints)

    @cached_property
    def value_and_std(self) -> tuple[float, float]:
        """The finding's size and its standard deviation for exact shape constants, in
        SI units.

        The error of a shape constant is left out here: a different exponent changes the
        number, but hardly the torque.
        """
        return size_of(
            self.effect,
            self.size.beta,
            self.size.covariance_given_constants,
        )

    @property
    def looks_like(self) -> str:
        """What else a model may lack that these rows would show as this effect, in
        words.

        Empty where there is nothing.
        """
        coverage = self.search.data.rows.seen(self.effect.joints[0])
        return self.effect.looks_like(self.value_and_std[0], coverage)


def _is_uncertain(x: Judged) -> bool:
    """Return whether the relative standard deviation of the size is above UNCERTAIN (20
    %).

    It is computed for exact shape constants. A size of zero counts as uncertain.
    """
    size, std = x.value_and_std
    return not std < UNCERTAIN * abs(size)


def _is_insignificant(x: Judged) -> bool:
    """Return whether the size is less than two standard deviations (SIGNIFICANT) from
    zero.

    The standard deviation includes the errors of the shape constants.
    """
    size, std = size_of(
        x.effect,
        x.size.beta,
        x.size.covariance,
    )
    return not std < SIGNIFICANT * abs(size)


def _leaves_more(x: Judged) -> bool:
    """Return whether more squared error is left on the finding's joints than it
    explains.

    Explained is the fall of the squared held-out error, on its joints or over all
    joints, whichever is larger: removing a wrong gain of one channel helps other joints
    too. Always False where the size of the noise is unknown, since what is left is then
    not known either.
    """
    if not x.search.data.noise_is_known:
        return False
    gained = x.errors[0] ** 2 - x.errors[1] ** 2
    on_joints = float(np.sum(np.maximum(gained[x.joints], 0.0)))
    explained = max(on_joints, float(np.sum(gained)))
    return bool(explained < np.sum(x.left.beyond[x.joints] ** 2))


def _is_shared(x: Judged) -> bool:
    """Return whether other findings can make more than 80 % of this finding's torque.

    Compared are the squares of the torque that the model's columns leave of it, without
    and with the other findings' columns. The standard deviation of its size is then
    more than 2.2 times as large as alone.
    """
    search = x.search
    others = [t for t in search.terms if t is not x.term]
    fit_of_model = search.score.fit([], search.fit)
    fit_with_others = search.score.fit(others, search.fit)
    energy_alone = max(fit_of_model.energy(x.term), 1e-300)
    share_left = fit_with_others.energy(x.term) / energy_alone
    return 1.0 - share_left > 1.0 - UNCERTAIN


def _is_implausible(x: Judged) -> bool:
    """Return whether the size is impossible, or far above what its effect calls
    plausible.

    Impossible: its mean squared torque exceeds the measured one on some joint. Far
    above: the RMS of its parameters is more than three of their plausible standard
    deviations.
    """
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
    """List the reasons to doubt a finding; a finding without any is confident.

    Reasons about the finding itself: another effect fits as well; its size is
    uncertain, not different from zero, or not plausible; its evidence is small; it
    lowers no joint's error on data left out. Reasons about its surroundings: more is
    left unexplained than it explains; other findings can make most of its torque;
    something else looks like it; a measured curve does better.

    Parameters
    ----------
    x
        The finding with all that it is judged by.

    Returns
    -------
    dict of str to str
        A sentence for each reason, by the name of the reason (the keys of REASONS).
    """
    sentences = {**REASONS, "looks_like": x.looks_like}
    return {name: sentences[name] for name, holds in DOUBTS.items() if holds(x)}


def invisible_effects(search: Search) -> tuple[Invisible, ...]:
    """List the effects that no such recording can show, since the model absorbs their
    torque.

    The model's own columns absorb all but ABSORBED (0.1 %) of their white torque's
    squares, for every shape tried. Effects that were found nevertheless are not listed.
    Empty for a model held fixed, which absorbs nothing.
    """
    if search.data.frozen:
        return ()
    fit = search.score.fit(())
    shares = dict[tuple[str, int | None], float]()
    for batch in search.library.batches:
        absorbed = search.score.absorbed(fit, batch)
        for form, share in zip(batch.forms, absorbed.tolist(), strict=True):
            shares[form.key] = min(shares.get(form.key, 1.0), share)
    keys_found = {t.key for t in search.terms}
    invisible = []
    for (name, joint), share in shares.items():
        if share > 1.0 - ABSORBED and (name, joint) not in keys_found:
            joints = () if joint is None else (joint + 1,)
            invisible.append(Invisible(name, joints, share))
    return tuple(invisible)
