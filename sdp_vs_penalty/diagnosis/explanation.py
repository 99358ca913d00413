"""What explains the torque: the findings beside the model, with re-estimated constants
of its own effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from sdp_vs_penalty.diagnosis.constants import MINOR, SURE_HELP
from sdp_vs_penalty.diagnosis.held_out import HeldOut, HeldOutData
from sdp_vs_penalty.diagnosis.late_torque import (
    beside_constants,
    delays_torque,
    refer_once,
)
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect
from sdp_vs_penalty.diagnosis.own_constants import changed_constants
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.effects.model import depends
from sdp_vs_penalty.estimation.certificate import NOT_CERTIFIED
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.shapes import ShapeEstimate
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class Explanation:
    """Findings beside a model with re-estimated shape constants."""

    #: The model as it was given.
    first: Estimate
    #: Candidates that replace the model's own effects, with other constants.
    constants: tuple[ScoredEffect, ...]
    #: The findings beside the model, in order.
    search: Search

    @property
    def estimate(self) -> Estimate:
        """The model with re-estimated constants, to which the findings are added."""
        return self.search.data.estimate

    @property
    def shapes(self) -> tuple[ShapeEstimate, ...]:
        """The re-estimated shape constants (such as a Stribeck velocity), with the
        values before and after.
        """
        return tuple(changed_constants(self.constants, self.first.model))

    @property
    def terms(self) -> list[ScoredEffect]:
        """All effects of the explanation: re-estimated constants, then findings."""
        return [*self.constants, *self.search.terms]


def explain(
    search: Search,
    first: Estimate,
    constants: Sequence[ScoredEffect],
    findings: Sequence[ScoredEffect],
) -> Explanation:
    """Judge findings beside each other and the model with re-estimated shape constants.

    Parameters
    ----------
    search
        The search that has found the effects.
    first
        The model before any constant was re-estimated.
    constants
        Candidates that replace the model's own effects, with other constants.

    Returns
    -------
    Explanation
        The model with all of them.
    """
    refitted = copy(search)
    refitted.terms = [*findings]
    if search.constants or any(t.form.replaces_own_constant for t in search.terms):
        refitted = beside_constants(refitted, first, constants)
    refers_to_model = any(depends(t.form.effect) for t in refitted.terms)
    if constants or refers_to_model or delays_torque(refitted):
        refitted = refer_once(refitted)
    return Explanation(first, refitted.constants, refitted.without_refuted())


def explain_in_order(search: Search, first: Estimate) -> Explanation:
    """Explain the torque by all that a search has found, sorted by evidence, highest
    first.

    Parameters
    ----------
    first
        The model before any constant was re-estimated.
    """
    findings = [t for t in search.terms if not t.form.replaces_own_constant]
    constants = [t for t in search.all_constants if changed_constants([t], first.model)]
    out = explain(search, first, constants, findings)
    in_order = copy(out.search)
    in_order.terms = sorted(out.search.terms, key=lambda t: -t.evidence)
    return replace(out, search=in_order)


def held_out_errors(explanation: Explanation, judge: HeldOutData) -> HeldOut:
    """Return an object that computes errors on data left out for any selection of
    effects.

    Effects are numbered: re-estimated constants first, then findings. Errors are those
    of the test run. Without one, they are those of three folds by the phase of the
    motion: what selects a model has to leave much out (Shao 1993).

    Parameters
    ----------
    explanation
        The model with constants and findings.
    """
    # The given model's constants: those re-estimated are among the effects to choose.
    theta = explanation.estimate.theta
    estimate = replace(explanation.first, theta=theta, certificate=NOT_CERTIFIED)
    effects = [t.form.effect for t in explanation.terms]
    return judge.held_out_errors(explanation.search.data.rows, effects, estimate)


def drop_harmful(
    explanation: Explanation, held_out: HeldOut, search: Search
) -> Explanation:
    """Drop constants and findings that raise the error on data left out.

    The harm of an effect is what it adds to the sum of the joints' log errors, beside
    all others. The most harmful effect is dropped while its harm is 1 % or more. If the
    noise is unknown, an effect has to lower the sum by 1 % to stay, since evidence
    against a guessed noise proves nothing.

    Parameters
    ----------
    explanation
        The model with constants and findings.
    held_out
        Errors on data left out, with the effects in the explanation's order.
    search
        The search, for fitting again what remains.
    """
    terms = explanation.terms
    n_own = len(explanation.constants)
    # Evidence against a noise that is guessed proves nothing by itself.
    every = range(len(terms))
    least_help = {} if search.data.noise_is_known else dict.fromkeys(every, MINOR)
    order = held_out.drop_harmful(every, least_help)
    constants = [terms[k] for k in order if k < n_own]
    findings = [terms[k] for k in order if k >= n_own]
    if len(order) < len(terms):
        return explain(search, explanation.first, constants, findings)
    return explanation


@dataclass(frozen=True)
class Ladder:
    """Errors on data left out, with one finding after the other."""

    #: Errors on data left out of any selection of effects.
    held_out: HeldOut
    #: Numbers of the constants (the first ``n_own``) and of the findings among the
    #: effects of ``held_out``.
    offered: tuple[int, ...]
    #: Number of re-estimated constants.
    n_own: int

    @classmethod
    def from_explanation(
        cls, explanation: Explanation, held_out: HeldOut, judged: Sequence[ScoredEffect]
    ) -> Ladder:
        """Make the ladder of an explanation: the order in which its effects are added.

        Parameters
        ----------
        held_out
            Errors on data left out of any selection of the judged effects.
        judged
            All effects that ``held_out`` knows, in its order; some may have been
            dropped since.
        """
        place = {t.text: k for k, t in enumerate(judged)}
        offered = tuple(place[t.text] for t in explanation.terms)
        return cls(held_out, offered, len(explanation.constants))

    def errors_without(self, k: int) -> Array:
        """Return the errors (n,) with all offered effects except the one at place k [N
        m or N].
        """
        others = [i for i in self.offered if i != self.offered[k]]
        return self.held_out.errors(others)

    def help_together(
        self, least_help: Sequence[float], is_doubted: Sequence[bool], floor: Array
    ) -> list[bool]:
        """Return for each constant and each finding whether it helps together with all
        others that help. `add` takes those that do.

        It lowers the sum of the joints' log errors in the rows that tell of it, and no
        joint's error on one recording left out is above 1.05 times that without any
        effect. Those whose torque is in doubt come last, one or two at once.

        Parameters
        ----------
        least_help
            By how much each finding has to lower that sum; infinite for one that cannot
            help. Re-estimated constants may raise it by 1 %.
        is_doubted
            Which findings are doubted: these have to show it on all data.
        floor
            (n,) noise of the joints [N m or N], zero where it is not known.

        Returns
        -------
        list of bool
            Constants first, then findings.
        """
        findings = self.offered[self.n_own :]
        of_findings = dict(zip(findings, least_help, strict=True))
        doubted = {k for k, x in zip(findings, is_doubted, strict=True) if x}
        in_doubt = [k for k, x in of_findings.items() if SURE_HELP <= x < np.inf]
        helpful = [k for k in self.offered if of_findings.get(k, 0.0) < SURE_HELP]
        n_before = len(helpful) + 1
        while len(helpful) < n_before:
            n_before = len(helpful)
            helpful = self.held_out.drop_harmful(helpful, of_findings, doubted)
            helpful = self.held_out.drop_harmful_to_a_joint(helpful, floor)
        helpful = self.held_out.with_helpful(helpful, in_doubt, floor)
        return [number in helpful for number in self.offered]
