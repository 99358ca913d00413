"""From what explains the torque to a diagnosis: findings, verdict, what is left, what
happened once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.confidence import (
    Judged,
    invisible_effects,
    reasons_for_doubt,
)
from sdp_vs_penalty.diagnosis.curves.curve import CURVE, Curve
from sdp_vs_penalty.diagnosis.curves.measure import Measured
from sdp_vs_penalty.diagnosis.events import find_events
from sdp_vs_penalty.diagnosis.explanation import Explanation, Ladder
from sdp_vs_penalty.diagnosis.findings import (
    REASONS,
    Diagnosis,
    Finding,
    Remaining,
    Retune,
    format_size,
)
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect
from sdp_vs_penalty.diagnosis.own_constants import constant_std, retune
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.sizes import (
    Size,
    size_of,
    sizes_with_intervals,
    torque_errors,
)
from sdp_vs_penalty.diagnosis.unexplained import Remainder
from sdp_vs_penalty.diagnosis.white_rows import ConstantErrors, WhiteData
from sdp_vs_penalty.effects import effect_in_words, effect_name
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.verdict import MOSTLY_NEW
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import RESIDUAL, SPECTRUM, SPECTRUM_KNOWN
from sdp_vs_penalty.signals.standstill import STILL


@dataclass(frozen=True)
class Conclusion:
    """All that a diagnosis is made of.

    explanation : findings in order beside the model; left : by these; ladder : of
    held-out errors; gain_errors (n, e) : a factor of the covariance of the torque
    channels' gains; new_motion_share : of the test run; seed : of the draws of a curve's
    band.
    """

    explanation: Explanation
    left: Remainder
    curves: tuple[Measured, ...]
    ladder: Ladder
    gain_errors: Array
    new_motion_share: float | None
    seed: int

    @property
    def search(self) -> Search:
        """The findings beside the model."""
        return self.explanation.search

    @property
    def data(self) -> WhiteData:
        """The rows that were searched."""
        return self.search.data

    def diagnosis(self) -> Diagnosis:
        """What is told of it."""
        left = self.left
        noise = self.data.noise
        held_out = self.ladder.held_out
        findings = self.findings_alone
        harmful = self.harmful_together
        for i, is_harmful in enumerate(harmful[self.ladder.n_own :]):
            if is_harmful:
                findings[i] = _weakened(findings[i], "alone")
        unexplained = {j: float(left.beyond[j]) for j in left.joints_unexplained}
        unnamed = {*unexplained, *(c.joint for c in self.curves)}
        verdict: Literal["effect_missing", "nothing_missing", "unknown_effect"]
        verdict = "effect_missing" if findings else "nothing_missing"
        if unnamed:
            verdict = "unknown_effect"
        happened = find_events(
            self.data,
            left.outlier_rows,
            left.residual,
            sorted(unnamed),
        )
        return Diagnosis(
            verdict=verdict,
            effects=tuple(findings),
            noise_floor=noise.floor,
            invisible=invisible_effects(self.search),
            events=tuple(happened),
            noise_source=noise.source,
            unexplained=left.in_sample_excess_variance,
            held_out_rmse=self.ladder.errors[-1],
            band_hz=self.data.rows.cutoff,
            remarks=self.remarks,
            held_out_rmse_before=held_out.errors(()),
            held_out_source=held_out.source,
            frozen=self.data.frozen,
            new_motion_share=self.new_motion_share,
            retuned=self.retunes(harmful),
            curves=self.described_curves,
            torque_units=self.explanation.estimate.robot.torque_units,
            remains=tuple(Remaining(j + 1, x) for j, x in sorted(unexplained.items())),
        )

    @cached_property
    def errors_of_constants(self) -> list[ConstantErrors]:
        """What errors of shape constants make of torque, white."""
        terms = self.search.terms
        return self.data.constant_error_columns(
            [t.form.effect for t in terms], [t.beta for t in terms]
        )

    @cached_property
    def findings_alone(self) -> list[Finding]:
        """The findings, each with the doubts about itself."""
        doubt = torque_errors(self.data, self.explanation.estimate, self.gain_errors)
        sizes = sizes_with_intervals(self.search, doubt, self.errors_of_constants)
        errors = self.ladder.errors
        out = []
        for k, (term, size) in enumerate(zip(self.search.terms, sizes, strict=True)):
            step = errors[k : k + 2]
            judged = Judged(
                self.search,
                self.left,
                term,
                size,
                step,
                self.curves,
            )
            out.append(describe_finding(term, size, reasons_for_doubt(judged), step))
        return out

    @cached_property
    def harmful_together(self) -> list[bool]:
        """Which constants and findings do harm beside those that are sure: data left out
        have the last word on these, too, as a whole."""
        is_sure = [f.torque_is_certain for f in self.findings_alone]
        harmful = self.ladder.harmful_together(is_sure)
        if any(harmful) and not self.search.rules.second_veto:
            return [False] * len(harmful)
        return harmful

    def retunes(self, harmful: Sequence[bool]) -> tuple[Retune, ...]:
        """The constants of the model's own effects that should change."""
        return tuple(
            retune(
                s,
                std=constant_std(self.search.fit, self.errors_of_constants, s),
                robot=self.explanation.estimate.robot,
                before=self.ladder.errors_without(k),
                after=self.ladder.errors[-1],
                is_harmful=harmful[k],
            )
            for k, s in enumerate(self.explanation.shapes)
        )

    @property
    def described_curves(self) -> tuple[Curve, ...]:
        """The measured curves for a reader."""
        floor = self.data.noise.floor if self.data.known else np.zeros(self.data.n)
        return tuple(
            c.to_curve(self.seed + k, float(floor[c.joint]))
            for k, c in enumerate(self.curves)
        )

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences about the diagnosis as a whole."""
        source = self.ladder.held_out.source
        sentences = (
            _NOISE.get(self.data.noise.source),
            _standstill(self.data, self.left.residual),
            repeatability_warning(self.new_motion_share),
            _FOLDS if source == "folds" else None,
        )
        return tuple(text for text in sentences if text)


def _weakened(finding: Finding, reason: str) -> Finding:
    """A finding with one more doubt."""
    remarks = *finding.remarks, REASONS[reason]
    return replace(finding, confidence="weak", remarks=remarks)


def describe_finding(
    term: ScoredEffect,
    known: Size,
    doubts: Mapping[str, str],
    errors: Array,
) -> Finding:
    """A finding for a reader; errors (2, n) : held out, before and after it."""
    effect = term.form.effect
    size, std = size_of(effect, known.beta, known.covariance)
    names = [_rival_name(effect, r.form.effect) for r in term.rivals]
    rivals = dict.fromkeys([*names, *effect.resembles])
    equivalents = (*rivals, CURVE) if "curve" in doubts else tuple(rivals)
    parameters = zip(effect.parameters, known.beta, strict=True)
    return Finding(
        effect=effect.name,
        joints=() if effect.whole_robot else tuple(j + 1 for j in effect.joints),
        shape=dict(effect.shape),
        size=size,
        unit=effect.parameters[effect.sized_by][0].unit,
        std=std,
        parameters={p.name: float(b) for p, b in parameters},
        confidence="weak" if doubts else "confident",
        indistinguishable_from=equivalents,
        held_out_rmse_before=errors[0],
        held_out_rmse_after=errors[1],
        explanation=sentence(effect, size, std, tuple(rivals)),
        text=effect.text,
        gain=term.evidence,
        remarks=tuple(doubts.values()),
        constants=effect.constants,
    )


def _rival_name(effect: Effect, other: Effect) -> str:
    """The rival's name; with its joint, or its constants, where that alone would be the
    finding's."""
    if other.name != effect.name:
        return other.name
    if other.joints == effect.joints:
        return other.text
    return f"{other.name}:{other.joints[0] + 1}"


#: What is said of a noise that no repetition shows, by its source; and of errors
#: without a test run.
_NOISE = {
    RESIDUAL: (
        "No motion repeats and the log shows no steady noise above the motion's band"
        " (too slow, smoothed before it was logged, or louder in motion), so noise and"
        " model error cannot be separated: the noise shown is the error itself. Record"
        " a run with more than one period."
    ),
    SPECTRUM: (
        "No motion repeats: the noise is that of the torque's spectrum above the"
        f" motion's band, {SPECTRUM_KNOWN}. Record a run with more than one period to"
        " know it better."
    ),
}
_FOLDS = (
    "Held-out errors come from folds by the phase of the motion: sizes from the other"
    " folds, the choice of effects and constants from all rows. A test run (--test)"
    " judges both."
)


def _standstill(data: WhiteData, residual: Array) -> str:
    """Where most of what is left (M, n) is of standstill."""
    keep = data.rows.keep
    moves = data.rows.keep & (data.rows.still <= STILL)
    all_energy = np.sum(residual**2 * keep, axis=0)
    moving = np.sum(residual**2 * moves, axis=0)
    mostly = [int(j) + 1 for j in np.flatnonzero(all_energy > 2.0 * moving)]
    if not mostly:
        return ""
    moving = np.sqrt(moving / np.maximum(moves.sum(axis=0), 1))
    values_in_words = ", ".join(f"{moving[j - 1]:.2g}" for j in mostly)
    return (
        f"Most of the error that is left on {formatting.joints(mostly)} is of"
        " standstill, where dry friction holds any torque up to its own: in motion it"
        f" is {values_in_words} N m or N."
    )


def sentence(
    effect: Effect,
    size: float,
    std: float,
    rivals: Sequence[str],
) -> str:
    """What was found, in one or two sentences."""
    unit = effect.parameters[effect.sized_by][0].unit
    where = (
        "the whole robot"
        if effect.whole_robot
        else "joint " + "+".join(str(j + 1) for j in effect.joints)
    )
    amount = format_size(size, std, unit)
    head = f"{formatting.sentence(effect_name(effect.name))} on {where}: {amount}"
    head += f" ({effect.constants})" if effect.constants else ""
    text = f"{head}. {effect.explanation} {effect.remark(size)}".rstrip()
    if rivals:
        named = ", ".join(map(effect_in_words, rivals))
        text += f" Indistinguishable in these data from {named}."
    return text


def repeatability_warning(new_share: float | None) -> str | None:
    """One sentence where most of the judged motion is the training motion again, else
    None."""
    if new_share is None or new_share >= MOSTLY_NEW:
        return None
    percent = f"{100.0 * new_share:.0f}"
    return (
        f"{'None' if percent == '0' else f'Only {percent} %'} of the judged motion is"
        " new to the model: these errors show repeatability; judge on another motion"
        " to see how it generalises."
    )
