"""Which effects does a model miss? The method, one function a step."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.candidates import list_candidates
from sdp_vs_penalty.diagnosis.comparison import noise_floor
from sdp_vs_penalty.diagnosis.conclude import Conclusion
from sdp_vs_penalty.diagnosis.curves.accept import accept_curves
from sdp_vs_penalty.diagnosis.curves.measure import measure_curves
from sdp_vs_penalty.diagnosis.equivalence import with_equivalence_sets
from sdp_vs_penalty.diagnosis.explanation import (
    Ladder,
    drop_harmful,
    explain_in_order,
    held_out_errors,
    judge_without_events,
)
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.held_out import HeldOutData
from sdp_vs_penalty.diagnosis.late_torque import refer_columns_to_current_model
from sdp_vs_penalty.diagnosis.library import Library
from sdp_vs_penalty.diagnosis.rules import ALL_RULES, Rules
from sdp_vs_penalty.diagnosis.search import search
from sdp_vs_penalty.diagnosis.unexplained import unexplained_error
from sdp_vs_penalty.diagnosis.white_rows import (
    WhiteData,
    diagnosis_rows,
    whiten_rows,
    with_estimate,
)
from sdp_vs_penalty.estimation.build_problem import independent_gains
from sdp_vs_penalty.estimation.drive_torque import driven
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.memory import give_back_memory
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.motion import record_motion
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.segments import (
    SegmentedRuns,
    segmented,
    subsample_sentence,
    window_subsample,
)


def diagnose(
    model: Estimate,
    measurements: Measurements,
    test: Measurements | None = None,
    *,
    frozen: bool = False,
    seed: int = 0,
    progress: Progress = no_progress,
    noise_from: Measurements | None = None,
    gain_uncertainty: float | None = None,
    judged_recordings: Measurements | None = None,
    rules: Rules = ALL_RULES,
) -> Diagnosis:
    """The diagnosis of a model on recordings that are read already; ``rules`` may leave
    steps of the search out."""
    progress("filtering the runs")
    runs = DiagnosisRuns(model, measurements, test, noise_from, frozen)
    diagnosis = diagnose_runs(
        runs,
        seed=seed,
        progress=progress,
        gain_uncertainty=gain_uncertainty,
        rules=rules,
    )
    del runs  # with all filtered rows
    give_back_memory(measurements.samples)
    floor, _ = noise_floor(model, judged_recordings or test or measurements)
    return diagnosis if floor is None else replace(diagnosis, noise_floor=floor)


def diagnose_runs(
    runs: DiagnosisRuns,
    *,
    seed: int = 0,
    progress: Progress = no_progress,
    gain_uncertainty: float | None = None,
    rules: Rules = ALL_RULES,
) -> Diagnosis:
    """The method, one function a step. Rows and candidates are computed once for the
    same ``runs``, whatever the rules."""
    progress("noise, and columns of all candidates")
    found = search(runs.white_data, runs.candidates, rules, progress)
    found = refer_columns_to_current_model(found, progress)
    progress("held-out errors")
    judge = HeldOutData(runs.estimate, runs.test_rows, runs.frozen)
    explanation = explain_in_order(found, runs.estimate)
    judged = explanation.terms
    held_out = held_out_errors(explanation, judge)
    explanation = drop_harmful(explanation, held_out, found)
    left = unexplained_error(explanation.search)
    explanation, left = judge_without_events(explanation, left)
    explanation = with_equivalence_sets(explanation, judge)
    measured = measure_curves(explanation.search, left.joints_above_noise)
    curves = accept_curves(explanation.search, measured, judge)
    conclusion = Conclusion(
        explanation=explanation,
        left=left,
        curves=curves,
        ladder=Ladder.of(explanation, held_out, judged),
        gain_errors=gain_errors(runs.estimate, gain_uncertainty),
        new_motion_share=runs.new_motion_share,
        seed=seed,
    )
    diagnosis = conclusion.diagnosis()
    if runs.subsample_remark:
        remarks = (runs.subsample_remark, *diagnosis.remarks)
        diagnosis = replace(diagnosis, remarks=remarks)
    return diagnosis


def gain_errors(model: Estimate, gain_uncertainty: float | None) -> Array:
    """(n, e) a factor of the covariance of the torque channels' gains."""
    if gain_uncertainty is None:
        return model.uncertainty.gain_errors
    return independent_gains(gain_uncertainty, model.robot.n)


@dataclass(frozen=True)
class DiagnosisRuns:
    """Recordings as a diagnosis sees them: with the drives' torque, windows of what is
    long, filtered.

    noise_from : the runs whose repetition shows the noise, if not the measurements;
    frozen : whether the model's parameters are kept.
    """

    model: Estimate
    measurements: Measurements
    test: Measurements | None
    noise_from: Measurements | None = None
    frozen: bool = False

    def __post_init__(self) -> None:
        named = {
            "measurements": self.measurements,
            "test run": self.test,
            "runs for the noise": self.noise_from,
        }
        for what, runs in named.items():
            if runs is not None:
                self.model.require_joints(runs, what)

    @cached_property
    def _driven(self) -> tuple[Estimate, Measurements]:
        return driven(self.model, self.measurements)

    @property
    def estimate(self) -> Estimate:
        """The model that predicts torque, whatever it was made from."""
        return self._driven[0]

    @cached_property
    def settings(self) -> Preprocessing:
        """The model's filters."""
        return self.model.preprocessing.resolve(self.measurements)

    @cached_property
    def searched(self) -> Measurements:
        """What effects are searched in."""
        return window_subsample(self._driven[1], self.settings)

    @property
    def subsample_remark(self) -> str | None:
        """What is said where only windows are searched."""
        return subsample_sentence(
            self.searched,
            self._driven[1],
            "effects were searched for in",
        )

    @cached_property
    def white_data(self) -> WhiteData:
        """The rows that are searched, white."""
        return whiten_rows(self.rows, self.estimate, self.frozen, self.noise_rows)

    @cached_property
    def candidates(self) -> Library:
        """What a search chooses from."""
        return list_candidates(self.white_data)

    @property
    def rows(self) -> SegmentedRuns:
        """Filtered rows of what is searched."""
        return diagnosis_rows(self.searched, self.estimate, self.settings)

    @property
    def noise_rows(self) -> SegmentedRuns | None:
        """What the noise is measured in, if not in the rows."""
        if self.noise_from is None:
            return None
        return with_estimate(
            segmented(self._windows(self.noise_from), self.settings), self.estimate
        )

    @cached_property
    def _test_windows(self) -> Measurements | None:
        return None if self.test is None else self._windows(self.test)

    @cached_property
    def test_rows(self) -> SegmentedRuns | None:
        """Filtered rows of the test run."""
        if self._test_windows is None:
            return None
        return diagnosis_rows(self._test_windows, self.estimate, self.settings)

    def _windows(self, runs: Measurements) -> Measurements:
        return window_subsample(driven(self.model, runs)[1], self.settings)

    @cached_property
    def new_motion_share(self) -> float | None:
        """Of the test run's rows those whose motion is not in the runs that were
        searched; nor, of a frozen model, in those that it was identified from."""
        if self._test_windows is None:
            return None
        record = record_motion(FilteredRuns.of(self.searched, self.settings))
        if self.frozen and record is not None:
            known = self.estimate.training_motion
            record = None if known is None else record.joined(known)
        if record is None:
            return None
        return record.new_share(FilteredRuns.of(self._test_windows, self.settings))
