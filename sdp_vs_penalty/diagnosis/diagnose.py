"""The verb: which effect does the model miss?"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.conclude import (
    Found,
    conclude,
    what_is_left,
)
from sdp_vs_penalty.diagnosis.constants import APART, MINOR
from sdp_vs_penalty.diagnosis.curves.measure import Measured, in_parts, measured_curves
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.held_out import Judge, harm, lowers
from sdp_vs_penalty.diagnosis.library import library
from sdp_vs_penalty.diagnosis.remaining import refitted
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.whitening import diagnosis_rows, folds_of, prepare, with_estimate
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.constants import CHANGES, TURNS
from sdp_vs_penalty.estimation.drive_torque import driven
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.estimation.known_load import independent_gains
from sdp_vs_penalty.estimation.shape_constants import settled
from sdp_vs_penalty.estimation.shapes import (
    ShapeEstimate,
    at_end,
    estimate_shapes,
    with_shapes,
)
from sdp_vs_penalty.estimation.verdict import MOSTLY_NEW
from sdp_vs_penalty.estimators.estimator import Progress, make_task, no_progress
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.motion import record_motion
from sdp_vs_penalty.signals.noise import REPETITION
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.segments import (
    SegmentedRuns,
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
) -> Diagnosis:
    """Which physical effects the model misses, judged against the noise; see :class:`Diagnosis`.

    estimate : the model in question, or its model.json; measurements : the runs to search in, whatever
    :func:`~sdp_vs_penalty.data.files.as_measurements` takes; test : a run only for the held-out
    errors (without it, folds by the phase of the motion).
    frozen : keep the model's parameters, so that changes of the links
    show (a payload); otherwise they are refitted along with every candidate. seed : of the draws of a
    curve's band; progress : called with a short text of where the search stands;
    noise_from : the runs whose repetition shows the noise (default: the measurements);
    gain_uncertainty : relative
    standard deviation of the torque channels' gains; default: the model's. In a long recording windows
    are searched (:mod:`~sdp_vs_penalty.signals.segments`), and a remark says so.
    Raises InputError where model and measurements do not belong together or nothing is left after
    filtering.
    """
    estimate = as_estimate(estimate, "diagnose(estimate=...)")
    names = estimate.robot.joint_names
    measurements = as_measurements(measurements, names=names, what="diagnose(measurements=...)")
    if test is not None:
        test = as_measurements(test, names=names, what="diagnose(test=...)")
    for what, m in (("measurements", measurements), ("test run", test)):
        if m is not None:
            estimate.require_joints(m, what)
    settings, whole_estimate = estimate.preprocessing.resolve(measurements), estimate
    estimate, measurements = driven(whole_estimate, measurements)
    if test is not None:
        _, test = driven(whole_estimate, test)
    progress("filtering the runs")
    recording, whole = measurements, None
    measurements = window_subsample(recording, settings)
    looked = subsample_sentence(measurements, recording, "effects were searched for in")
    test = None if test is None else window_subsample(test, settings)
    rows = diagnosis_rows(measurements, estimate, settings)
    if noise_from is not None:
        given = as_measurements(noise_from, names=names, what="diagnose(noise_from=...)")
        estimate.require_joints(given, "runs for the noise")
        _, given = driven(whole_estimate, given)
        whole = with_estimate(segmented(window_subsample(given, settings), settings), estimate)
    judge, shapes, before = Judge(estimate, measurements, test, frozen), list[ShapeEstimate](), None
    if not frozen:
        progress("the model's own shape constants")
        every = opened(estimate.model)
        known = estimate_shapes(every, measurements, settings, estimate.weighting, widest=TURNS[-1])
        estimate, shapes, before = retuned(judge, rows, known)
    progress("noise, and columns of all candidates")
    data = prepare(with_estimate(rows, estimate) if shapes else rows, estimate, frozen, whole)
    search = Search(data, library(data))
    search.run(progress)
    progress("held-out errors")
    found = _offered(search, judge, shapes, before, settings)
    gain_errors = estimate.uncertainty.gain_errors
    if gain_uncertainty is not None:
        gain_errors = independent_gains(gain_uncertainty, estimate.robot.n)
    record = None if test is None else record_motion(measurements, settings)
    if frozen and record is not None:  # a frozen model has seen what it was identified from, too
        seen = estimate.training_motion
        record = None if seen is None else record.joined(seen)
    share = None if record is None or test is None else record.new_share_of(test, settings)
    done = conclude(found, gain_errors, share, seed)
    return replace(done, remarks=(looked, *done.remarks)) if looked else done


def _offered(
    search: Search,
    judge: Judge,
    shapes: Sequence[ShapeEstimate],
    before: Array | None,
    settings: Preprocessing,
) -> Found:
    """Findings in order that data left out do not speak against."""
    now, beside = referred(search)
    # What the model's own shape constants make as well is none, where these settle and are confirmed.
    doubted = beside.limited(beside.terms, beside.data.doubted).terms
    lost = [t for t, d in zip(beside.terms, doubted, strict=True) if d.J <= APART]
    if lost:
        others = beside.limited([t for t in beside.terms if t not in lost])
        known = {(s.effect, s.joint, s.shape): s for s in shapes}
        new = settled_on({j for t in lost for j in t.joints}, others, judge, settings)
        for s in new:
            key = s.effect, s.joint, s.shape
            known[key] = replace(s, before=known[key].before) if key in known else s
        now, shapes, before = retuned(judge, beside.data.rows, list(known.values()))
        moved = {s.joint for s in shapes} & {s.joint for s in new}
        named = [t for t in beside.terms if t not in lost or not t.joints <= moved]
        beside = beside.limited(named).carried(now)
    beside = beside.limited(beside.terms)
    terms = sorted(beside.terms, key=lambda t: -t.J)
    held_out = judge.of(beside.data.rows, [t.form.effect for t in terms], now)
    # Evidence against a noise that is guessed proves nothing by itself.
    order = held_out.offered(range(len(terms)), needed=beside.data.noise.source != REPETITION)
    final = beside.limited([terms[k] for k in order])
    left = what_is_left(final)
    if left.matters and left.odd.any():  # what happens once is no evidence, if it is that alone
        beside = final.carried(now, left.odd)
        beside = beside.limited(beside.terms)
        rest = what_is_left(beside, left.odd)
        if len(rest.matters) < len(left.matters):
            final, left = beside, rest
    before = held_out.errors(()) if before is None else before
    found = Found(judge.first, now, tuple(shapes), final, left, held_out, tuple(order), before)
    parts = in_parts(final)
    if not left.matters and not parts:
        return found
    curves = measured_curves(final, left.matters, parts, folds_of(final.data.rows))
    return _with_curves(found, curves, judge) if curves else found


def opened(model: Model, beside: Sequence[Effect] = ()) -> Model:
    """The model, all of whose shape constants are to be estimated, with effects more."""
    return replace(model, effects=(*(e.opened(e.shapes) for e in model.effects), *beside))


def settled_on(
    joints: Collection[int], search: Search, judge: Judge, settings: Preprocessing
) -> list[ShapeEstimate]:
    """The constants of the model's own effects on some joints (from 0) where they explain most beside
    the findings, within their range."""
    model = opened(search.data.estimate.model, [t.form.effect for t in search.terms]).reference_free
    there = [
        (e, j, k)
        for e in model.effects
        for k, shape in e.shapes.items()
        if shape.role == "estimated" and k not in e.given and len(e.parameters) == len(e.joints)
        for j in e.joints
        if j in joints
    ]
    now = [ShapeEstimate(e.name, j, k, e.shape[k], e.shape[k]) for e, j, k in there]
    single = replace(model, effects=with_shapes(model.effects, now))
    wanted = {(s.effect, s.joint, s.shape) for s in now}
    best = settled(single, wanted, lambda m: compress(judge.data, m, settings), judge.first.weighting)
    values = {
        (e.name, j, k): v for e in best.model.effects for j in e.joints for k, v in e.shape.items()
    }
    found = [replace(s, after=values[s.effect, s.joint, s.shape]) for s in now]
    kinds = [judge.first.robot.joints[j].kind for _, j, _ in there]
    ends = [e.shapes[k].on(x).bounds or (0.0, np.inf) for (e, _, k), x in zip(there, kinds, strict=True)]
    return [s for s, x in zip(found, ends, strict=True) if not at_end(*np.log([s.after, *x]).tolist())]


def retuned(
    judge: Judge, rows: SegmentedRuns, found: Sequence[ShapeEstimate]
) -> tuple[Estimate, list[ShapeEstimate], Array | None]:
    """The model with those constants of its own that data left out do not speak against; these; and the
    errors of the model as it was given, if it has others."""
    first = judge.first
    shapes = [s for s in found if abs(np.log(s.after / s.before)) > CHANGES]
    before = judge.of(rows, (), first).errors(()) if shapes else None
    while shapes and before is not None:
        now = adopted(first, shapes, judge.data)
        after = judge.of(rows, (), now).errors(())
        kept = [s for s in shapes if after[s.joint] < before[s.joint]]
        if len(kept) == len(shapes):
            return now, shapes, before
        shapes = kept
    return first, [], None


def _with_curves(found: Found, curves: Sequence[Measured], judge: Judge) -> Found:
    """Those curves that lower their joint's held-out error by more than what is minor, raise no other's,
    and whose tables the test run does not leave; each with what it does to the errors."""
    named, out = [t.form.effect for t in found.search.terms], list[Measured]()
    places = range(len(named), len(named) + len(curves))
    effects = [*named, *(c.table for c in curves)]
    by_fold = {k: c.by_fold for k, c in zip(places, curves, strict=True)}
    held = judge.of(found.search.data.rows, effects, found.estimate, by_fold)
    before, taken = held.errors(range(len(named))), list[int]()
    for k, curve in zip(places, curves, strict=True):
        gone = {t for c in (*out, curve) for t in c.replaced}
        terms = [i for i, t in enumerate(found.search.terms) if t not in gone]
        after, on = held.errors([*terms, *taken, k]), [curve.joint]
        helps = lowers(before[on], after[on]) and harm(before, after) < MINOR
        # Most of the test run has to be where the table is no constant.
        if helps and judge.outside(curve.table) <= MOSTLY_NEW:
            out.append(replace(curve, before=float(before[curve.joint]), errors=after))
            before, taken = after, [*taken, k]
    return replace(found, curves=tuple(out))


def adopted(estimate: Estimate, shapes: Sequence[ShapeEstimate], measurements: Measurements) -> Estimate:
    """The model with other shape constants, refitted by least squares."""
    model = replace(estimate.model, effects=with_shapes(estimate.model.effects, shapes))
    regression = compress(measurements, model, estimate.preprocessing)
    theta = make_task(estimate.problem, model, regression, estimate.weighting).ols
    return replace(estimate, model=model, theta=theta)


def referred(search: Search) -> tuple[Estimate, Search]:
    """Where columns refer to the model: that with the parameters that it has beside the findings, and
    these carried on (a step of Gauss and Newton). Fitted without them it has taken a part of their
    torque; of play in a gear 14 % of the size were left out."""
    effects, estimate = [t.form.effect for t in search.terms], search.data.estimate
    if not search.data.frozen and any(e.needs_torque or e.needs_links for e in effects):
        theta = refitted(search.data, effects)[0][: len(estimate.theta)]
        estimate = replace(estimate, theta=theta)
        search = search.carried(estimate)
    return estimate, search
