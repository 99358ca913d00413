"""What explains the torque: findings beside the model, with constants of its own."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from sdp_vs_penalty.diagnosis.held_out import HeldOut, HeldOutData
from sdp_vs_penalty.diagnosis.late_torque import (
    beside_model,
    delays_torque,
    refer_once,
)
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect
from sdp_vs_penalty.diagnosis.own_constants import changed_constants
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.unexplained import Remainder, unexplained_error
from sdp_vs_penalty.effects.model import depends
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.shapes import ShapeEstimate, with_shapes
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class Explanation:
    """Findings beside the model with re-estimated constants of its own.

    first : the model as it was given; constants : terms that stand in the place of the
    model's own effects; search : the findings beside it, in order.
    """

    first: Estimate
    constants: tuple[ScoredEffect, ...]
    search: Search

    @property
    def estimate(self) -> Estimate:
        """The model beside the findings."""
        return self.search.data.estimate

    @property
    def shapes(self) -> tuple[ShapeEstimate, ...]:
        """The re-estimated constants."""
        return tuple(changed_constants(self.constants, self.first.model))

    @property
    def terms(self) -> list[ScoredEffect]:
        """Constants first, then the findings."""
        return [*self.constants, *self.search.terms]


def explain(
    search: Search,
    first: Estimate,
    constants: Sequence[ScoredEffect],
    findings: Sequence[ScoredEffect],
) -> Explanation:
    """Findings judged beside the model with some constants of its own; those that have
    evidence against them there go."""
    now = first
    if constants:
        effects = with_shapes(
            first.model.effects, changed_constants(constants, first.model)
        )
        now = replace(first, model=replace(first.model, effects=effects))
    refitted = copy(search)
    refitted.terms = [*findings]
    if any(t.form.replaces_own_constant for t in search.terms):
        refitted = beside_model(refitted, now)
    while True:
        refers = any(depends(t.form.effect) for t in refitted.terms)
        if constants or refers or delays_torque(refitted):
            refitted = refer_once(refitted)
        left = refitted.drop_disfavoured(refitted.terms)
        if len(left.terms) == len(refitted.terms):
            return Explanation(first, tuple(constants), left)
        refitted = left  # no part of the torque that others delay


def explain_in_order(search: Search, first: Estimate) -> Explanation:
    """All that a search has found, the findings with most evidence first."""
    constants = [t for t in search.terms if t.form.replaces_own_constant]
    findings = [t for t in search.terms if not t.form.replaces_own_constant]
    out = explain(search, first, constants, findings)
    in_order = copy(out.search)
    in_order.terms = sorted(out.search.terms, key=lambda t: -t.evidence)
    return replace(out, search=in_order)


def held_out_errors(explanation: Explanation, judge: HeldOutData) -> HeldOut:
    """Errors on data left out of models with some of the constants and findings.

    A test run has the last word. Without one three folds by the phase of the motion have
    it; each leaves out a third: what chooses a model has to leave much out (Shao 1993).
    At each step the model is fitted as `add` fits it.
    """
    estimate = replace(explanation.first, theta=explanation.estimate.theta)
    effects = [t.form.effect for t in explanation.terms]
    return judge.held_out_errors(explanation.search.data.rows, effects, estimate)


def drop_harmful(
    explanation: Explanation,
    held_out: HeldOut,
    search: Search,
) -> Explanation:
    """The constants and findings that data left out do not speak against.

    The harm of a finding, or of another constant, is what it adds to the logarithms of
    all joints' errors beside all others. The most harmful one goes while that is 1 % or
    more. Where nothing shows the noise each has to lower the sum by as much.
    """
    terms = explanation.terms
    n_own = len(explanation.constants)
    # Evidence against a noise that is guessed proves nothing by itself.
    order = held_out.drop_harmful(range(len(terms)), needed=not search.data.known)
    constants = [terms[k] for k in order if k < n_own]
    findings = [terms[k] for k in order if k >= n_own]
    if len(order) < len(terms):
        return explain(search, explanation.first, constants, findings)
    judged = explanation.search.drop_disfavoured(findings)
    return replace(explanation, search=judged)


def judge_without_events(
    explanation: Explanation, left: Remainder
) -> tuple[Explanation, Remainder]:
    """The same where rows of events are no evidence, if less is left without them:
    what happens once is no evidence of anything else."""
    rules = explanation.search.rules
    if not (left.joints_unexplained and left.outlier_rows.any()):
        return explanation, left
    if not rules.without_events:
        return explanation, left
    search = beside_model(explanation.search, explanation.estimate, left.outlier_rows)
    search = search.drop_disfavoured(search.terms)
    without = unexplained_error(search, left.outlier_rows)
    if len(without.joints_unexplained) < len(left.joints_unexplained):
        return replace(explanation, search=search), without
    return explanation, left


@dataclass(frozen=True)
class Ladder:
    """Errors on data left out, with one finding after the other.

    offered : where the constants (the first ``n_own``) and the findings stand among the
    effects of ``held_out``.
    """

    held_out: HeldOut
    offered: tuple[int, ...]
    n_own: int

    @classmethod
    def of(
        cls,
        explanation: Explanation,
        held_out: HeldOut,
        judged: Sequence[ScoredEffect],
    ) -> Ladder:
        """Of what is left of an explanation of all ``judged`` terms."""
        place = {t.text: k for k, t in enumerate(judged)}
        offered = tuple(place[t.text] for t in explanation.terms)
        return cls(held_out, offered, len(explanation.constants))

    @property
    def errors(self) -> Array:
        """(findings + 1, n) with all constants and none of the findings, then with one
        finding more each."""
        steps = range(self.n_own, len(self.offered) + 1)
        return np.array([self.held_out.errors(self.offered[:k]) for k in steps])

    def errors_without(self, k: int) -> Array:
        """(n,) with all but the one that stands at k of those offered."""
        others = [i for i in self.offered if i != self.offered[k]]
        return self.held_out.errors(others)

    def harmful_together(self, is_sure: Sequence[bool]) -> list[bool]:
        """Which constants and findings do harm beside those that are sure; is_sure : by
        finding."""
        flags = zip(
            self.offered[self.n_own :],
            is_sure,
            strict=True,
        )
        sure = [
            *self.offered[: self.n_own],
            *(k for k, yes in flags if yes),
        ]
        harmless = self.held_out.drop_harmful(sure)
        harmless = self.held_out.drop_harmful_to_a_joint(harmless)
        harmful = set(sure).difference(harmless)
        return [k in harmful for k in self.offered]
