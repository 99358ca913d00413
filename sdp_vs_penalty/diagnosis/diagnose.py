"""The verb: which effect does the model miss?"""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path

from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.candidates import Key, list_candidates
from sdp_vs_penalty.diagnosis.comparison import noise_floor
from sdp_vs_penalty.diagnosis.conclude import SearchOutcome, conclude, what_is_left
from sdp_vs_penalty.diagnosis.constants import MINOR, THIRDS
from sdp_vs_penalty.diagnosis.curves.measure import Measured, in_parts, measured_curves
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.held_out import HeldOutData, harm, lowers
from sdp_vs_penalty.diagnosis.score import ScoredEffect
from sdp_vs_penalty.diagnosis.search import Search, changed
from sdp_vs_penalty.diagnosis.whitening import (
    diagnosis_rows,
    folds_of,
    whiten_rows,
    with_estimate,
)
from sdp_vs_penalty.effects.model import depends
from sdp_vs_penalty.estimation.build_problem import independent_gains
from sdp_vs_penalty.estimation.drive_torque import driven
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.estimation.shapes import with_shapes
from sdp_vs_penalty.estimation.verdict import MOSTLY_NEW
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.motion import record_motion
from sdp_vs_penalty.signals.segments import (
    segmented,
    subsample_sentence,
    window_subsample,
)


def diagnose(
    estimate: Estimate | str | Path,
    measurements: Source,
    test: Source = None,
    *,
    frozen: bool = False,
    seed: int = 0,
    progress: Progress = no_progress,
    noise_from: Source = None,
    gain_uncertainty: float | None = None,
    judged_recordings: Source = None,
) -> Diagnosis:
    """Which physical effects the model misses, judged against the noise; see
    :class:`Diagnosis`.

    estimate : the model in question, or its model.json; measurements : the runs to search in, whatever
    :func:`~sdp_vs_penalty.data.files.as_measurements` takes; test : a run only for the held-out
    errors (without it, folds by the phase of the motion).
    frozen : keep the model's parameters, so that changes of the links
    show (a payload); otherwise they are refitted along with every candidate. seed : of the draws of a
    curve's band; progress : called with a short text of where the search stands;
    noise_from : the runs whose repetition shows the noise (default: the measurements);
    gain_uncertainty : relative
    standard deviation of the torque channels' gains; default: the model's; judged_recordings : of which
    the test run, or the measurements without one, are windows: errors are shown beside the noise floor
    that :func:`~.comparison.compare` has of them. In a long recording windows
    are searched (:mod:`~sdp_vs_penalty.signals.segments`), and a remark says so.
    Raises InputError where model and measurements do not belong together or nothing is left after
    filtering.
    """
    model_given = as_estimate(estimate, "diagnose(estimate=...)")

    def logged(source: Source, argument: str, what: str) -> Measurements:
        runs = as_measurements(
            source,
            names=model_given.robot.joint_names,
            what=f"diagnose({argument}=...)",
        )
        model_given.require_joints(runs, what)
        return runs

    recording = logged(measurements, "measurements", "measurements")
    test_as_given = test
    test = None if test is None else logged(test, "test", "test run")
    settings = model_given.preprocessing.resolve(recording)
    estimate, recording = driven(model_given, recording)

    def windows(run: Measurements) -> Measurements:
        return window_subsample(driven(model_given, run)[1], settings)

    progress("filtering the runs")
    searched = window_subsample(recording, settings)
    noise_rows = None
    looked = subsample_sentence(searched, recording, "effects were searched for in")
    test = None if test is None else windows(test)
    rows = diagnosis_rows(searched, estimate, settings)
    if noise_from is not None:
        noisy = windows(logged(noise_from, "noise_from", "runs for the noise"))
        noise_rows = with_estimate(segmented(noisy, settings), estimate)
    progress("noise, and columns of all candidates")
    data = whiten_rows(rows, estimate, frozen, noise_rows)
    search = Search(data, list_candidates(data))
    search.run(progress)
    before = list[set[Key]]()
    while (
        search.delays_torque and (keys := {t.key for t in search.terms}) not in before
    ):
        before.append(keys)
        search = search.refer_to_current_model()
        search.library = search.library.with_current_columns(search.data)
        search.terms = search.refine_and_drop(
            search.terms, frozenset(range(search.data.n))
        )
        search.run(progress)
    progress("held-out errors")
    unseen = None if test is None else diagnosis_rows(test, estimate, settings)
    outcome = accept_on_held_out_data(search, HeldOutData(estimate, unseen, frozen))
    gain_errors = estimate.uncertainty.gain_errors
    if gain_uncertainty is not None:
        gain_errors = independent_gains(gain_uncertainty, estimate.robot.n)
    record = (
        None if test is None else record_motion(FilteredRuns.of(searched, settings))
    )
    if (
        frozen and record is not None
    ):  # a frozen model has seen what it was identified from, too
        known_motion = estimate.training_motion
        record = None if known_motion is None else record.joined(known_motion)
    share = None
    if record is not None and test is not None:
        share = record.new_share(FilteredRuns.of(test, settings))
    done = conclude(outcome, gain_errors, share, seed)
    judged = judged_recordings or test_as_given or measurements
    floor, _ = noise_floor(
        model_given, logged(judged, "judged_recordings", "judged runs")
    )
    done = done if floor is None else replace(done, noise_floor=floor)
    return replace(done, remarks=(looked, *done.remarks)) if looked else done


def accept_on_held_out_data(search: Search, judge: HeldOutData) -> SearchOutcome:
    """Findings and constants in order that data left out do not speak against."""
    first = judge.first
    own_constants = [t for t in search.terms if t.form.replaces_own_constant]

    def refit_beside(
        kept_constants: Sequence[ScoredEffect], findings: Sequence[ScoredEffect]
    ) -> tuple[Estimate, Search]:
        """Findings beside the model with other constants of its own."""
        effects = with_shapes(first.model.effects, changed(kept_constants, first.model))
        now = (
            replace(first, model=replace(first.model, effects=effects))
            if kept_constants
            else first
        )
        refitted_search = copy(search)
        refitted_search.terms = [*findings]
        if own_constants:
            refitted_search = refitted_search.beside_model(now)
        while True:
            if (
                kept_constants
                or refitted_search.delays_torque
                or any(depends(t.form.effect) for t in refitted_search.terms)
            ):
                refitted_search = refitted_search.refer_to_current_model()
            left = refitted_search.drop_disfavoured(refitted_search.terms)
            if len(left.terms) == len(refitted_search.terms):
                return left.data.estimate, left
            refitted_search = left  # no part of the torque that others delay

    now, final = refit_beside(
        own_constants, [t for t in search.terms if not t.form.replaces_own_constant]
    )
    terms = [*own_constants, *sorted(final.terms, key=lambda t: -t.evidence)]
    effects = [t.form.effect for t in terms]
    held_out = judge.held_out_errors(
        final.data.rows, effects, replace(first, theta=now.theta)
    )
    # Evidence against a noise that is guessed proves nothing by itself.
    order = held_out.drop_harmful(range(len(terms)), needed=not search.data.known)
    kept_constants = [terms[k] for k in order if (k < len(own_constants)) is True]
    left_in = [terms[k] for k in order if (k < len(own_constants)) is False]
    if len(order) < len(terms):
        now, final = refit_beside(kept_constants, left_in)
    else:  # in the order of evidence
        final = final.drop_disfavoured(left_in)
    left = what_is_left(final)
    if (
        left.joints_unexplained and left.outlier_rows.any()
    ):  # what happens once is no evidence, if it is that alone
        without_outliers = final.beside_model(now, left.outlier_rows)
        without_outliers = without_outliers.drop_disfavoured(without_outliers.terms)
        left_without_outliers = what_is_left(without_outliers, left.outlier_rows)
        if len(left_without_outliers.joints_unexplained) < len(left.joints_unexplained):
            final = without_outliers
            left = left_without_outliers
    shapes = tuple(changed(kept_constants, first.model))
    stay = {t.text for t in final.terms}
    order = [k for k in order if k < len(own_constants) or terms[k].text in stay]
    outcome = SearchOutcome(first, now, shapes, final, left, held_out, tuple(order))
    parts = in_parts(final)
    if not left.joints_above_noise and not parts:
        return outcome
    curves = measured_curves(
        final, left.joints_above_noise, parts, folds_of(final.data.rows, THIRDS)
    )
    return _with_curves(outcome, curves, judge) if curves else outcome


def _with_curves(
    outcome: SearchOutcome, curves: Sequence[Measured], judge: HeldOutData
) -> SearchOutcome:
    """Those curves that lower their joint's held-out error by more than what is minor,
    raise no other's, and whose tables the test run does not leave; each with what it
    does to the errors."""
    named = [t.form.effect for t in outcome.search.terms]
    out = list[Measured]()
    places = range(len(named), len(named) + len(curves))
    effects = [*named, *(c.table for c in curves)]
    by_fold = {k: c.by_fold for k, c in zip(places, curves, strict=True)}
    held = judge.held_out_errors(
        outcome.search.data.rows, effects, outcome.estimate, by_fold
    )
    before = held.errors(range(len(named)))
    taken = list[int]()
    for k, curve in zip(places, curves, strict=True):
        gone = {t for c in (*out, curve) for t in c.replaced}
        terms = [i for i, t in enumerate(outcome.search.terms) if t not in gone]
        after = held.errors([*terms, *taken, k])
        on = [curve.joint]
        helps = lowers(before[on], after[on]) and harm(before, after) < MINOR
        # Most of the test run has to be where the table is no constant.
        if helps and judge.outside(curve.table) <= MOSTLY_NEW:
            out.append(replace(curve, before=float(before[curve.joint]), errors=after))
            before = after
            taken = [*taken, k]
    return replace(outcome, curves=tuple(out))
