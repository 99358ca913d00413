"""Which effects does a model miss? The method, one function a step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.candidates import list_candidates
from sdp_vs_penalty.diagnosis.comparison import noise_floor
from sdp_vs_penalty.diagnosis.conclude import Conclusion
from sdp_vs_penalty.diagnosis.curves.measure import accept_curves, measure_curves
from sdp_vs_penalty.diagnosis.equivalence import with_equivalence_sets
from sdp_vs_penalty.diagnosis.explanation import (
    Ladder,
    drop_harmful,
    explain_in_order,
    held_out_errors,
)
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.held_out import HeldOutData
from sdp_vs_penalty.diagnosis.late_torque import refer_columns_to_current_model
from sdp_vs_penalty.diagnosis.library import Library
from sdp_vs_penalty.diagnosis.passing.cause import ENOUGH, Span, without_spans
from sdp_vs_penalty.diagnosis.search import Search, search
from sdp_vs_penalty.diagnosis.unexplained import unexplained_error
from sdp_vs_penalty.diagnosis.white_rows import (
    WhiteData,
    diagnosis_rows,
    whiten_rows,
    with_estimate,
)
from sdp_vs_penalty.estimation.drive_torque import driven
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.memory import give_back_memory
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.motion import record_motion
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.runs import Movement, still_seconds
from sdp_vs_penalty.signals.segments import (
    SegmentedRuns,
    segmented,
    subsample_sentence,
    window_subsample,
)

#: The most causes that act for a part of the time.
_MOST_PASSING = 3
_SPANS_LEFT_OUT = (
    "All else was judged without the spans in which something acts for a time; `add"
    " --from` leaves them out as well."
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
    judged_recordings: Measurements | None = None,
    left_out: tuple[Span, ...] = (),
    left_out_of_test: tuple[Span, ...] = (),
) -> Diagnosis:
    """Find the effects that a model lacks, in recordings that have been read.

    Parameters
    ----------
    test
        A recording for errors on data left out; default: folds of the searched ones.
    frozen
        True: the model's parameters stay fixed.
    seed
        Of the random draws of a curve's band.
    progress
        Is called with a short text.
    noise_from
        Recordings whose repetition shows the noise; default: ``measurements``.
    judged_recordings
        Recordings of which the test run is a window; they have the noise floor that is
        reported.
    left_out, left_out_of_test
        Spans of the measurements and of the test run in which the check says that
        something acts.

    Returns
    -------
    Diagnosis
        What :func:`diagnose_beside_passing` finds, with the noise floor of the judged
        recordings and the time for which the arm stands still in them.
    """
    progress("filtering the runs")
    runs = DiagnosisRuns(
        model=model,
        measurements=measurements,
        test=test,
        noise_from=noise_from,
        frozen=frozen,
        left_out=left_out,
        left_out_of_test=left_out_of_test,
        progress=progress,
    ).with_enough_rows
    diagnosis = diagnose_beside_passing(
        runs, partial(diagnose_runs, seed=seed, progress=progress)
    )
    del runs  # the filtered rows are the largest arrays: their memory is free now
    give_back_memory(measurements.samples)
    judged = test or measurements
    floor, _ = noise_floor(model, judged_recordings or judged)
    share = model.preprocessing.standstill
    still = sum(
        still_seconds(run, Movement(run, share)) for run in judged.cut_at_pauses.runs()
    )
    return replace(
        diagnosis,
        standstill_left_out=still,
        noise_floor=diagnosis.noise_floor if floor is None else floor,
    )


def diagnose_beside_passing(
    runs: DiagnosisRuns, diagnose: Callable[[DiagnosisRuns], Diagnosis]
) -> Diagnosis:
    """Diagnose recordings, and again without the spans in which something acts.

    A load that is carried for a time would otherwise be explained by effects that act
    all the time. What is found without its spans is the result, with all that acts for
    a part of the time. The spans stay in where less than ENOUGH of the samples would be
    left. Spans of the test run are left out as well.

    Parameters
    ----------
    runs
        The recordings and the model.
    diagnose
        Runs all steps on recordings.
    """
    diagnosis = diagnose(runs)
    passing = new = diagnosis.passing
    judged = runs
    # What acts in the spans of the first causes may hide further ones.
    while new and len(passing) < _MOST_PASSING:
        spans = tuple(span for cause in passing for span in cause.spans)
        rest = replace(runs, left_out=(*runs.left_out, *spans))
        if rest.searched.samples < ENOUGH * runs.searched.samples:
            break
        judged, diagnosis = rest, diagnose(rest)
        new = diagnosis.passing
        passing += new
    if not judged.left_out:
        return diagnosis
    # The spans that the check has named were left out from the first.
    return replace(
        diagnosis,
        passing=passing,
        named_by_check=runs.left_out,
        left_out_of_test=judged.left_out_of_test,
        remarks=(*diagnosis.remarks, _SPANS_LEFT_OUT),
    )


def diagnose_runs(
    runs: DiagnosisRuns, *, seed: int = 0, progress: Progress = no_progress
) -> Diagnosis:
    """Run all steps of a diagnosis on filtered recordings.

    The steps are: search, errors on data left out, rivals, unexplained torque, measured
    curves, conclusion. Rows and candidates are stored in ``runs``, so that a
    second call computes only the steps.

    Parameters
    ----------
    runs
        The recordings and the model.
    seed
        Seed of the random draws for the band of a curve.
    progress
        Called with a short text at each step.
    """
    searched = _searched(runs, progress)
    progress("held-out errors")
    judge = HeldOutData(runs.estimate, runs.test_rows, runs.frozen)
    offered = explain_in_order(searched, runs.estimate)
    held_out = held_out_errors(offered, judge)
    explanation = drop_harmful(offered, held_out, searched)
    if not {t.text for t in explanation.terms} <= {t.text for t in offered.terms}:
        # Constants that were fitted again without what was dropped are other effects.
        offered, held_out = explanation, held_out_errors(explanation, judge)
    explanation = with_equivalence_sets(explanation, judge)
    ladder = Ladder.from_explanation(explanation, held_out, offered.terms)
    give_back_memory(runs.searched.samples)
    left = unexplained_error(explanation.search)
    measured = measure_curves(explanation.search, left.joints_above_noise)
    conclusion = Conclusion(
        explanation=explanation,
        ladder=ladder,
        left=left,
        curves=accept_curves(explanation.search, measured, judge),
        new_motion_share=runs.new_motion_share,
        seed=seed,
    )
    diagnosis = conclusion.diagnosis()
    if runs.subsample_remark:
        remarks = (runs.subsample_remark, *diagnosis.remarks)
        diagnosis = replace(diagnosis, remarks=remarks)
    return diagnosis


def _searched(runs: DiagnosisRuns, progress: Progress) -> Search:
    """Search the effects that a model lacks, with columns that follow from the torque that
    was found."""
    progress("measuring the noise")
    candidates = runs.candidates
    give_back_memory(runs.searched.samples)
    out = search(runs.white_data, candidates, progress)
    out = refer_columns_to_current_model(out, progress)
    give_back_memory(runs.searched.samples)
    return out


@dataclass(frozen=True)
class DiagnosisRuns:
    """Recordings as a diagnosis needs them: torque at the joints, windows of long ones,
    filtered."""

    #: The model to diagnose.
    model: Estimate
    #: The recordings to search in.
    measurements: Measurements
    #: The run for errors on data left out, or None.
    test: Measurements | None
    #: The runs whose repetition shows the noise, or None for those that the
    #: measurements were cut from.
    noise_from: Measurements | None = None
    #: Whether the model's parameters stay fixed.
    frozen: bool = False
    #: Spans of time that are not searched.
    left_out: tuple[Span, ...] = ()
    #: Spans of time of the test run that errors leave out.
    left_out_of_test: tuple[Span, ...] = ()
    #: Called with a text that says how many candidates have their columns.
    progress: Progress = no_progress

    def __post_init__(self) -> None:
        """Raise InputError if a recording has not as many joints as the model."""
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
        """The model without its drives, and the measurements with the torque at the
        joints.

        If the model has drives, their model computes that torque from the motor
        currents; else both are unchanged.
        """
        return driven(self.model, self.measurements)

    @property
    def estimate(self) -> Estimate:
        """The model that predicts joint torque, without its drives."""
        return self._driven[0]

    @cached_property
    def settings(self) -> Preprocessing:
        """The model's filter settings, resolved for the measurements."""
        return self.model.preprocessing.resolve(self.measurements)

    @cached_property
    def searched(self) -> Measurements:
        """The windows of the measurements in which effects are searched."""
        windows = window_subsample(self._driven[1], self.settings)
        return without_spans(windows, self.left_out) if self.left_out else windows

    @property
    def with_enough_rows(self) -> DiagnosisRuns:
        """The recordings without the spans that are left out, or with all rows if too
        few would be left."""
        whole = replace(self, left_out=())
        is_enough = self.searched.samples >= ENOUGH * whole.searched.samples
        return self if is_enough else whole

    @property
    def subsample_remark(self) -> str | None:
        """A sentence for the user if only windows of long measurements are searched,
        else None.
        """
        return subsample_sentence(
            self.searched, self._driven[1], "effects were searched for in"
        )

    @cached_property
    def white_data(self) -> WhiteData:
        """The searched rows, weighted so that their noise is independent with variance
        1.
        """
        return whiten_rows(self.rows, self.estimate, self.frozen, self.noise_rows)

    @cached_property
    def candidates(self) -> Library:
        """All candidates of the search."""
        return list_candidates(self.white_data, self.progress)

    @property
    def rows(self) -> SegmentedRuns:
        """The filtered rows of the searched windows."""
        return diagnosis_rows(self.searched, self.estimate, self.settings)

    @property
    def noise_rows(self) -> SegmentedRuns | None:
        """The filtered rows in which the noise is measured.

        None if it is measured in the searched rows.
        """
        recordings = self.noise_from or self.measurements.recording
        if recordings is self.measurements:
            return None
        return with_estimate(
            segmented(self._windows(recordings), self.settings), self.estimate
        )

    @cached_property
    def _test_windows(self) -> Measurements | None:
        """The windows of the test run that are judged on; None without a test run."""
        if self.test is None:
            return None
        windows = self._windows(self.test)
        spans = self.left_out_of_test
        return without_spans(windows, spans) if spans else windows

    @cached_property
    def test_rows(self) -> SegmentedRuns | None:
        """The filtered rows of the test run; None without one."""
        if self._test_windows is None:
            return None
        return diagnosis_rows(self._test_windows, self.estimate, self.settings)

    def _windows(self, runs: Measurements) -> Measurements:
        """Return windows of long recordings, with the torque at the joints."""
        return window_subsample(driven(self.model, runs)[1], self.settings)

    @cached_property
    def new_motion_share(self) -> float | None:
        """Share (0 to 1) of the test run's motion that no recording used for the model
        contains.

        Those are the searched recordings and, for a frozen model, those it was
        identified from. None if there is no test run, or if the motion of those is not
        recorded.
        """
        if self._test_windows is None:
            return None
        record = record_motion(FilteredRuns.filtering(self.searched, self.settings))
        if self.frozen and record is not None:
            known = self.estimate.training_motion
            record = None if known is None else record.joined(known)
        if record is None:
            return None
        return record.new_share(
            FilteredRuns.filtering(self._test_windows, self.settings)
        )
