"""Makes the diagnosis of what explains the torque: findings with sizes and doubts, the
verdict, and unexplained torque.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.comparison import resolution
from sdp_vs_penalty.diagnosis.confidence import (
    Judged,
    invisible_effects,
    reasons_for_doubt,
)
from sdp_vs_penalty.diagnosis.constants import MINOR, SURE_HELP
from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.diagnosis.curves.measure import Measured
from sdp_vs_penalty.diagnosis.diagnosis_data import Remaining
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.diagnosis.explanation import Explanation, Ladder
from sdp_vs_penalty.diagnosis.finding import (
    Finding,
    Retune,
    effect_on,
    main_joint_of,
    other_names_of_law,
)
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect
from sdp_vs_penalty.diagnosis.notices import find_notices
from sdp_vs_penalty.diagnosis.own_constants import constant_std, retune
from sdp_vs_penalty.diagnosis.passing.cause import PassingCause
from sdp_vs_penalty.diagnosis.passing.search import passing_causes
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.sizes import size_of, sizes_with_intervals, torque_errors
from sdp_vs_penalty.diagnosis.sliding import contradicted_by_sliding
from sdp_vs_penalty.diagnosis.unexplained import Remainder
from sdp_vs_penalty.diagnosis.white_rows import ConstantErrors, WhiteData
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.written import WrittenEffect, read_effect
from sdp_vs_penalty.estimation.verdict import MOSTLY_NEW
from sdp_vs_penalty.exporters.export import files_without_place
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import NOISE_UNKNOWN, RESIDUAL, SPECTRUM


@dataclass(frozen=True)
class Conclusion:
    """The results of all steps, from which a diagnosis is made."""

    #: The model with the findings, in order.
    explanation: Explanation
    #: Torque that the findings leave unexplained.
    left: Remainder
    #: The accepted measured curves.
    curves: tuple[Measured, ...]
    #: Errors on data left out, with one finding added after the other.
    ladder: Ladder
    #: Share (0 to 1) of the test run's motion that is new, None if unknown.
    new_motion_share: float | None
    #: Seed of the random draws of a curve's band.
    seed: int

    @property
    def search(self) -> Search:
        """The findings beside the model, as a search."""
        return self.explanation.search

    @property
    def data(self) -> WhiteData:
        """The white rows that were searched."""
        return self.search.data

    @property
    def known_floor(self) -> Array:
        """(n,) noise floor [N m or N], zero where the noise is not known."""
        return self.data.noise.floor * self.data.noise_is_known

    @cached_property
    def errors_of_constants(self) -> list[ConstantErrors]:
        """White derivatives of torque by the shape constants of findings and model.

        One pair an effect: the effect's constants, and their columns by joint.
        """
        terms = self.search.terms
        return self.data.constant_error_columns(
            [t.form.effect for t in terms], [t.beta for t in terms]
        )

    @cached_property
    def findings_alone(self) -> list[Finding]:
        """The findings with sizes and reasons for doubt, each judged by itself.

        Whether they help together (:attr:`help_together`) is not considered.
        """
        search = self.search
        torque_in_doubt = torque_errors(self.data, self.explanation.estimate)
        sizes = sizes_with_intervals(search, torque_in_doubt, self.errors_of_constants)
        fit = search.score.fit(search.terms, search.fit)
        contradicted = contradicted_by_sliding(self.data, fit, search.terms)
        findings = []
        stated = self.explanation.estimate.provenance.get("torque_unit", "")
        for term, size, sticks in zip(search.terms, sizes, contradicted, strict=True):
            judged = Judged(search, term, size, self.curves, sticks)
            found = describe_finding(judged, reasons_for_doubt(judged))
            findings.append(found.in_unit(stated))
        return findings

    @cached_property
    def help_together(self) -> list[bool]:
        """Flags: which constants and findings lower the error on data left out, together.

        First come the flags of re-estimated shape constants, then those of findings.
        """
        least_help = [least_help_of(finding) for finding in self.findings_alone]
        is_doubted = [bool(finding.doubts) for finding in self.findings_alone]
        return self.ladder.help_together(least_help, is_doubted, self.known_floor)

    @cached_property
    def findings(self) -> list[Finding]:
        """The findings, and which of them help; one that does not is weak."""
        findings = []
        helpful = self.help_together[self.ladder.n_own :]  # behind own constants
        for finding, helps in zip(self.findings_alone, helpful, strict=True):
            doubts = finding.doubts if helps else (*finding.doubts, Doubt("alone"))
            findings.append(replace(finding, helps=helps, doubts=doubts))
        return findings

    @property
    def _told(self) -> tuple[list[Finding], dict[tuple[str, ...], Array]]:
        """The findings that are told, each with its main joint; and the errors (n,) with the
        first 0, 1, ... of them [N m or N]."""
        told = [finding for finding in self.findings if is_told(finding)]
        firsts: list[tuple[Finding | Retune, ...]]
        firsts = [(*self.retunes, *told[:k]) for k in range(len(told) + 1)]
        errors = self._errors_with(firsts)
        steps = pairwise(errors.values())
        return [
            replace(finding, main_joint=main_joint_of(finding.joints, before, after))
            for finding, (before, after) in zip(told, steps, strict=True)
        ], errors

    def _acting_for_a_time(
        self, certain: Sequence[ScoredEffect]
    ) -> tuple[PassingCause, ...]:
        """Return what acts for a part of the runs, beside effects whose torque is certain;
        nothing where no joint errs by more than a sensor resolves."""
        least = resolution(self.data.rows.torque, self.explanation.estimate)
        if not np.any(self.ladder.held_out.errors(()) > least):
            return ()
        return passing_causes(self.search, certain)

    def diagnosis(self) -> Diagnosis:
        """Return the diagnosis: findings, verdict, and what is left.

        The verdict is "unknown_effect" if a joint has unexplained torque or a measured
        curve, else "effect_missing" if there are findings, else "nothing_missing". A
        finding that is doubted and does not help is not told: it stands for errors that the others are
        judged beside, such as of friction that sticks. A curve that was measured beside
        it, and not in its place, would not be right without it.
        """
        remaining = self.left
        noise = self.data.noise
        held_out = self.ladder.held_out
        told, errors = self._told
        untold = [finding for finding in self.findings if not is_told(finding)]
        replaces_untold = all(f.fits_a_curve for f in untold)
        curves = self.described_curves if replaces_untold else ()
        # By joint (from 0): RMS torque beyond the noise [N m or N].
        unexplained = {
            j: float(remaining.beyond[j]) for j in remaining.joints_unexplained
        }
        joints_without_name = {*unexplained, *(c.joint - 1 for c in curves)}
        verdict: Literal["effect_missing", "nothing_missing", "unknown_effect"]
        verdict = "effect_missing" if told else "nothing_missing"
        if joints_without_name:
            verdict = "unknown_effect"
        certain = [
            term
            for term, finding in zip(self.search.terms, self.findings, strict=True)
            if finding.torque_is_certain
        ]
        diagnosis = Diagnosis(
            verdict=verdict,
            effects=tuple(told),
            noise_floor=noise.floor,
            invisible=invisible_effects(self.search),
            passing=self._acting_for_a_time(certain),
            notices=find_notices(self.search, self.explanation.estimate),
            noise_source=noise.source,
            unexplained=remaining.in_sample_excess_variance,
            band_hz=self.data.rows.cutoff,
            remarks=self.remarks,
            held_out_rmse_before=held_out.errors(()),
            held_out_source=held_out.source,
            frozen=self.data.frozen,
            new_motion_share=self.new_motion_share,
            retuned=self.retunes,
            curves=curves,
            torque_units=self.explanation.estimate.torque_units,
            remains=tuple(Remaining(j + 1, x) for j, x in sorted(unexplained.items())),
        ).with_errors(errors)
        laws = [term.held_law for term in self.search.terms]
        of_laws = {(law.text,): law.rmse for law in laws if law is not None}
        of_one = self._errors_with(diagnosis.offers.selections_of_one)
        diagnosis = diagnosis.with_errors(of_one | of_laws)
        # What goes together follows from what each does alone.
        of_several = self._errors_with(diagnosis.offers.selections_of_several)
        diagnosis = diagnosis.with_errors(of_several)
        # What shows that it helps follows from the pairs.
        of_shown = self._errors_with(diagnosis.offers.selections_of_shown)
        return diagnosis.with_errors(of_shown)

    def _errors_with(
        self, selections: Iterable[Sequence[Finding | Retune]]
    ) -> dict[tuple[str, ...], Array]:
        """Return the errors on data left out with each of several selections, by their
        texts."""
        texts = [*(r.text for r in self.retunes), *(f.text for f in self.findings)]
        numbers = dict(zip(texts, self.ladder.offered, strict=True))
        chosen = [tuple(found.text for found in added) for added in selections]
        errors = self.ladder.held_out.errors
        return {added: errors([numbers[x] for x in added]) for added in chosen}

    @property
    def retunes(self) -> tuple[Retune, ...]:
        """The shape constants of the model that should change."""
        helpful = self.help_together
        errors = self.errors_of_constants
        return tuple(
            retune(
                constant,
                std=constant_std(self.search.fit, errors, constant),
                robot=self.explanation.estimate.robot,
                before=self.ladder.errors_without(k),
                after=self.ladder.held_out.errors(self.ladder.offered),
                is_harmful=not helpful[k],
            )
            for k, constant in enumerate(self.explanation.shapes)
        )

    @property
    def described_curves(self) -> tuple[Curve, ...]:
        """The accepted curves as they are reported: points, values and band.

        The share of error that a curve explains is counted above the joint's noise
        floor [N m or N], which is 0 if the noise is not known.
        """
        return tuple(
            c.to_curve(self.seed + k, float(self.known_floor[c.joint]))
            for k, c in enumerate(self.curves)
        )

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences about the diagnosis as a whole, for the user.

        They warn of a noise that no repetition shows, of a test run with little new
        motion, and of a missing test run.
        """
        has_test_run = self.ladder.held_out.source != "folds"
        sentences = (
            NOTES_ON_NOISE.get(self.data.noise.source),
            repeatability_warning(self.new_motion_share),
            None if has_test_run else _FOLDS,
        )
        return tuple(text for text in sentences if text)


def is_told(finding: Finding) -> bool:
    """Return whether a finding helps, or nothing but that it does not speaks against it."""
    return finding.helps or finding.doubts == (Doubt("alone"),)


def least_help_of(finding: Finding) -> float:
    """Return by how much a finding has to lower the sum of log errors on data left out
    to be told and added: one that is doubted on a test run by more than the spread, too.

    A torque that may not be there has to lower it by 5 %, any other one by 1 %. One
    whose size may be zero as well is not added, and this is infinite.
    """
    may_be_zero = Doubt("insignificant") in finding.doubts
    is_forbidden = any(doubt.forbids_adding for doubt in finding.doubts)
    if is_forbidden or (finding.has_open_torque and may_be_zero):
        return np.inf
    return SURE_HELP if finding.has_open_torque else MINOR


def describe_finding(judged: Judged, doubts: Sequence[Doubt]) -> Finding:
    """Make the report of a finding; the main joint of one on the whole robot is known
    once it is among those that are told.

    Parameters
    ----------
    judged
        The finding with all that it is judged by.
    doubts
        Reasons for doubt; without any the finding is confident.
    """
    term, known, effect = judged.term, judged.size, judged.effect
    size, std = size_of(effect, known.beta, known.covariance)
    std_of_law = known.std_of_law(effect)
    std = float(np.hypot(std, std_of_law))
    _, std_of_rows = size_of(effect, known.beta, known.covariance_of_rows)
    joints = () if effect.whole_robot else tuple(j + 1 for j in effect.joints)
    rivals = [_rival_of(effect, r.form.effect) for r in term.rivals]
    rivals += [effect_on(name, joints) for name in judged.resembles]
    known_names = {effect.name, *other_names_of_law(effect.name, effect.shape)}
    rivals += [
        effect_on(name, joints)
        for rival in term.rivals
        if rival.form.effect.joints == effect.joints
        for name in other_names_of_law(rival.form.effect.name, rival.form.effect.shape)
        if name not in known_names
    ]
    first = dict[str, WrittenEffect]()  # of those that sentences say alike
    for rival in rivals:
        is_other = rival.name != effect.name
        first.setdefault(rival.name if is_other else rival.text, rival)
    parameters = zip(effect.parameters, known.beta, strict=True)
    law = term.held_law
    return Finding(
        effect=effect.name,
        joints=joints,
        shape=dict(effect.shape),
        size=size,
        unit=effect.parameters[effect.sized_by][0].unit,
        std=std,
        std_of_rows=std_of_rows,
        std_of_law=std_of_law,
        size_in_search=size,
        torque_rms=known.torque.rms,
        torque_std=known.torque.std,
        torque_unit=effect.robot.torque_units[known.torque.joint],
        parameters={p.name: float(b) for p, b in parameters},
        rivals=tuple(first.values()),
        main_joint=joints[0] if joints else 0,
        physics=physics_of(effect, size),
        text=effect.text,
        gain=term.evidence,
        doubts=tuple(doubts),
        constants=effect.constants,
        no_place_in=files_without_place(effect, judged.search.data.estimate),
        held_law="" if law is None else law.text,
        held_law_in=() if law is None else law.files,
    )


def _rival_of(effect: Effect, other: Effect) -> WrittenEffect:
    """Return a rival effect, ``other``, with its constants if these are all that differs
    from the finding's."""
    written = read_effect(other.text)
    is_same = (other.name, other.joints) == (effect.name, effect.joints)
    return written if is_same else WrittenEffect(written.name, written.joints)


#: What is said of a noise that no repetition shows, by its source; and of errors without
#: a test run. How rough a noise from the spectrum is stands in the headline.
NOTES_ON_NOISE = {
    RESIDUAL: (
        f"{formatting.sentence(NOISE_UNKNOWN)}. The log shows no steady noise above the"
        " motion's band either (too slow, smoothed before it was logged, or louder in"
        " motion), so noise and model error cannot be separated: the noise shown is the"
        " error itself. Record a run with more than one period."
    ),
    SPECTRUM: (
        "No motion repeats: the noise is that of the torque's spectrum above the"
        " motion's band. Record a run with more than one period to know it better."
    ),
}
_FOLDS = (
    "Held-out errors come from folds by the phase of the motion: sizes from the other"
    " folds, the choice of effects and constants from all rows. A test run (--test)"
    " judges both."
)


def physics_of(effect: Effect, size: float) -> str:
    """Return the physics of an effect in a sentence or two, with what its size means.

    size : in the SI unit of the effect's sizing parameter.
    """
    return f"{effect.explanation} {effect.remark(size)}".rstrip()


def repeatability_warning(new_share: float | None) -> str | None:
    """Return a warning if most of the judged motion was used for training, else None.

    new_share : share (0 to 1) of the judged motion that is new to the model; None if
    not known, in which case there is no warning. The limit is MOSTLY_NEW.
    """
    if new_share is None or new_share >= MOSTLY_NEW:
        return None
    percent = f"{100.0 * new_share:.0f}"
    return (
        f"{'None' if percent == '0' else f'Only {percent} %'} of the judged motion is"
        " new to the model: these errors show repeatability; judge on another motion"
        " to see how it generalises."
    )
