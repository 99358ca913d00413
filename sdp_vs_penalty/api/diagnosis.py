"""The verb ``diagnose``, with the check of the data first."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path

from sdp_vs_penalty.api.identification import gate_of
from sdp_vs_penalty.arguments import checked_arguments
from sdp_vs_penalty.checks.check import check_runs
from sdp_vs_penalty.checks.gate import Gate, issues_by_run, needs_check, raise_on_errors
from sdp_vs_penalty.checks.issue import Issue
from sdp_vs_penalty.data.files import Source, as_measurements, training_runs
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.adding import add
from sdp_vs_penalty.diagnosis.comparison import compare
from sdp_vs_penalty.diagnosis.diagnose import diagnose as find_missing_effects
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.passing.cause import Span, beside_spans
from sdp_vs_penalty.diagnosis.sizes_in_model import with_sizes_of
from sdp_vs_penalty.effects import EFFECTS
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.memory import give_back_memory
from sdp_vs_penalty.results.remedy import Remedy
from sdp_vs_penalty.threads import on_one_thread


@on_one_thread
@checked_arguments
def diagnose(
    estimate: Estimate | str | Path,
    measurements: Source,
    test: Source = None,
    *,
    frozen: bool = False,
    seed: int = 0,
    progress: Progress = no_progress,
    noise_from: Source = None,
    check: bool | Gate = True,
    judged_recordings: Source = None,
) -> Diagnosis:
    """Which physical effects a model misses, judged against the noise.

    Parameters
    ----------
    estimate : Estimate, str or Path
        The model in question, or its model.json.
    measurements : path, arrays, DataFrame, Measurements, list of these
        The runs to search in. In a long recording windows are searched, and a remark
        says so.
    test : the same, optional
        A run for held-out errors only. Without it, folds by the phase of the motion.
    frozen : bool
        Keep the model's parameters, so that changes of the links show (a payload).
        Otherwise they are fitted again along with every candidate.
    seed : int
        Of the draws of a curve's band.
    progress : callable
        Hears where the search stands.
    noise_from : the same as measurements, optional
        The runs whose repetition shows the noise; default: the measurements.
    check : bool or Gate
        Whether the fast part of `check` looks at the measurements first. What it finds
        wrong for certain raises InputError, other remarks are issued as UserWarning. A
        model that was identified from these runs without it is not asked again.
    judged_recordings : the same as measurements, optional
        Of which the test run, or the measurements without one, are windows. Errors are
        shown beside the noise floor that `compare` has of them.

    Returns
    -------
    Diagnosis
        Findings with size, interval, rivals and held-out errors; what is left.

    Raises
    ------
    InputError
        Where model and measurements do not belong together, or nothing is left after
        filtering.

    Examples
    --------
    >>> from sdp_vs_penalty import diagnose, identify, simulate
    >>> runs = simulate("two_link", hide="joint_spring:1", seed=1)
    >>> model = identify("two_link", runs.test)
    >>> found = diagnose(model, runs.test)
    >>> [finding.effect for finding in found.effects][:1]
    ['joint_spring']
    """
    return diagnose_and_add(
        estimate,
        measurements,
        test,
        frozen=frozen,
        seed=seed,
        progress=progress,
        noise_from=noise_from,
        check=check,
        judged_recordings=judged_recordings,
    )[0]


def diagnose_and_add(
    estimate: Estimate | str | Path,
    measurements: Source,
    test: Source,
    *,
    frozen: bool,
    seed: int = 0,
    progress: Progress,
    noise_from: Source,
    check: bool | Gate,
    judged_recordings: Source,
) -> tuple[Diagnosis, Estimate | None]:
    """Return what :func:`diagnose` does, and the model with all that helps; None if
    nothing does, or if it cannot be added."""
    model = as_estimate(estimate, "diagnose(estimate=...)")
    recording = as_measurements(
        training_runs(measurements),
        names=model.problem.channel_names,
        what="diagnose(measurements=...)",
    )
    model.require_joints(recording, "measurements")
    issues: Mapping[str, Sequence[Issue]] = {}
    if check and needs_check(model, recording):
        progress("checking the measurements")
        issues = raise_on_errors(
            model.problem,
            recording,
            "diagnose",
            gate_of(check, model.problem, measurements, stacklevel=6),
        )
        give_back_memory(recording.samples)
    read_beside = partial(_read_runs, model, recording)
    test_run = read_beside(test, "test")
    judged = read_beside(judged_recordings, "judged_recordings")
    if test_run is not None and _is_part_of(test_run, recording):
        remark = (
            "the test run is a training run: parts of the training runs judge in turn"
        )
        warnings.warn(f"{remark}; record another one", Remark, stacklevel=6)
        test_run = judged = None
    spans = _spans_named(issues, recording)
    spans_of_test: tuple[Span, ...] = ()
    if spans and test_run is not None:
        reports = check_runs(model.problem, test_run.runs(), thorough=False)
        spans_of_test = _spans_named(issues_by_run(reports, test_run), test_run)
    diagnosis = find_missing_effects(
        model,
        recording,
        test_run,
        frozen=frozen,
        seed=seed,
        progress=progress,
        noise_from=read_beside(noise_from, "noise_from"),
        judged_recordings=judged,
        left_out=spans,
        left_out_of_test=spans_of_test,
    )
    return add_certain_findings(
        _beside_check(diagnosis, issues),
        model,
        recording,
        test_run,
        judged,
        frozen=frozen,
        seed=seed,
        progress=progress,
    )


def _is_part_of(test: Measurements, training: Measurements) -> bool:
    """Return whether each test run is one of the training runs, so that nothing is
    left out that could judge."""
    trained = {run.data_hash for run in training.runs()}
    return trained.issuperset(run.data_hash for run in test.runs())


def _spans_named(
    issues: Mapping[str, Sequence[Issue]], runs: Measurements
) -> tuple[Span, ...]:
    """Return the spans of runs in which the check calls it likely that something acts;
    ``issues`` are by the run's hash."""
    several = len(runs.names) > 1
    return tuple(
        Span(run.names[0] if several else "", *issue.span)
        for run in runs.runs()
        for issue in issues.get(run.data_hash, ())
        if issue.span is not None and issue.is_likely
    )


def _beside_check(
    diagnosis: Diagnosis, issues: Mapping[str, Sequence[Issue]]
) -> Diagnosis:
    """Join to a diagnosis what the check calls certain or likely of the log. Each
    statement comes once; one that a finding makes as well is left out.
    """
    faults = dict[str, list[Remedy]]()
    explained = dict[tuple[str, str], Sequence[int]]()
    for issue in chain.from_iterable(issues.values()):
        if issue.doubtful_findings == "none" or _states(diagnosis, issue):
            continue
        if issue.doubtful_findings == "all":
            faults[issue.what] = issue.repairs_of_rows
        else:
            explained[issue.kind, issue.what] = issue.joints
    for (kind, what), joints in explained.items():
        diagnosis = diagnosis.beside_explanation_of_log(kind, what, joints)
    return diagnosis.beside_faults_of_log([*chain.from_iterable(faults.values())])


def _states(diagnosis: Diagnosis, issue: Issue) -> bool:
    """Return whether a finding that helps, or what acts for a part of the time, states
    an issue of the check too."""
    return any(
        issue.kind in EFFECTS.get(f.effect).faults and f.joints in ((), issue.joints)
        for f in diagnosis.effects
        if f.torque_is_certain
    ) or (
        any(span.covers(issue.at) for span in diagnosis.left_out)
        if issue.at is not None
        else bool(diagnosis.passing) and issue.arm_difference == "load"
    )


def _read_runs(
    model: Estimate, recording: Measurements, source: Source, argument: str
) -> Measurements | None:
    """Read recordings of the model's robot by what ``recording`` has told of its recorder;
    None stays None.

    ``argument`` is the name of the argument of `diagnose`, for error messages.
    """
    if source is None:
        return None
    return as_measurements(
        source,
        names=model.problem.channel_names,
        what=f"diagnose({argument}=...)",
        recorders=recording.recorders,
    )


def add_certain_findings(
    diagnosis: Diagnosis,
    model: Estimate,
    measurements: Measurements,
    test: Measurements | None = None,
    judged_recordings: Measurements | None = None,
    *,
    frozen: bool = False,
    seed: int = 0,
    progress: Progress = no_progress,
) -> tuple[Diagnosis, Estimate | None]:
    """Add the certain findings of a diagnosis to its model, and report that model's
    numbers.

    Sizes and intervals of these findings become those of the new model, and the errors
    on the test run those of `compare`, so that `add` and `compare` print the same ones.

    Parameters
    ----------
    model
        The model without the findings.
    measurements
        The recordings that were searched.
    test
        The recording for errors on data left out, if there is one.
    judged_recordings
        Recordings of which the test run is a window; they have the noise floor that is
        reported.

    Returns
    -------
    Diagnosis
        With sizes, intervals and errors of the new model. If the findings cannot be
        added, a remark says why.
    Estimate or None
        The model with all certain findings; None if there are none, if they cannot be
        added, or if no torque was logged.
    """
    give_back_memory(measurements.samples)
    better = None
    n_added = None
    can_add = measurements.torque_logged
    # Its sizes may show that a torque is not there, which is then not added.
    while can_add and diagnosis.helpful and n_added != len(diagnosis.helpful):
        n_added = len(diagnosis.helpful)
        progress("adding what helps")
        try:
            better = add(
                model,
                diagnosis.selected(helpful=True),
                measurements,
                frozen=frozen,
                seed=seed,
                progress=progress,
            )
        except InputError as error:
            remark = f"What helps cannot be added to this model: {error}"
            return replace(diagnosis, remarks=(*diagnosis.remarks, remark)), None
        diagnosis = with_sizes_of(diagnosis, better)
    if not diagnosis.helpful:
        better = None
    if test is not None and diagnosis.held_out_source == "test":
        progress("judging on the test run")
        models = [model] if better is None else [model, better]
        judged = beside_spans(test, diagnosis.left_out_of_test)
        compared = compare(models, judged, noise_from=judged_recordings or test)
        is_unmade = better is None and bool(diagnosis.helpful)
        after = None if is_unmade else compared[-1].rmse
        diagnosis = diagnosis.with_judged_errors(compared[0].rmse, after)
    return diagnosis, better
