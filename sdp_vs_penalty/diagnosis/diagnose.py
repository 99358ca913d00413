"""The verb: which effect does the model miss?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.sources import Source, as_measurements
from sdp_vs_penalty.diagnosis import explanations
from sdp_vs_penalty.diagnosis.candidates import Candidate
from sdp_vs_penalty.diagnosis.curves.measure import measured_curves, stood_in
from sdp_vs_penalty.diagnosis.findings import (
    EFFECT_MISSING,
    NOTHING_MISSING,
    UNKNOWN,
    Diagnosis,
    Finding,
    Invisible,
)
from sdp_vs_penalty.diagnosis.held_out import HeldOut, OnFolds, OnTest
from sdp_vs_penalty.diagnosis.ladder import MIN_GAIN, refines
from sdp_vs_penalty.diagnosis.library import turning
from sdp_vs_penalty.diagnosis.own_shapes import moved
from sdp_vs_penalty.diagnosis.parsimony import (
    INVISIBLE,
    believable,
    bent,
    correlated,
    overshadowed,
    seen_sliding,
)
from sdp_vs_penalty.diagnosis.remaining import remaining
from sdp_vs_penalty.diagnosis.retunes import retunes
from sdp_vs_penalty.diagnosis.rows import diagnosis_rows, with_estimate
from sdp_vs_penalty.diagnosis.scoring import score_library
from sdp_vs_penalty.diagnosis.search import Found, reverted, search
from sdp_vs_penalty.diagnosis.sizes import coefficients, torque_errors
from sdp_vs_penalty.diagnosis.stage import quiet
from sdp_vs_penalty.diagnosis.state import SearchState
from sdp_vs_penalty.diagnosis.where_it_fails import carriers
from sdp_vs_penalty.estimation.drive_torque import driven
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.known_load import independent_gains
from sdp_vs_penalty.estimation.sources import as_estimate
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.excerpt import MOST_SEARCHED, excerpt, excerpt_sentence
from sdp_vs_penalty.signals.motion import record_motion
from sdp_vs_penalty.signals.noise import REPETITION
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.segments import segmented

#: How many times farther than Coulomb friction turns a law of velocity has to reach to be none of it.
_BEYOND = 2.0
#: By so much other constants of the model may raise a joint's held-out error before they are taken back.
_RAISED = 1.01


def diagnose(
    estimate: Estimate | str | Path,
    measurements: Source,
    test: Source = None,
    *,
    frozen: bool = False,
    seed: int = 0,
    progress: Callable[[str], None] = quiet,
    noise_from: Source = None,
    gain_uncertainty: float | None = None,
) -> Diagnosis:
    """Which physical effects the model misses, judged against the noise; see :class:`Diagnosis`.

    estimate : the model in question, or its model.json; measurements : the runs to search in, whatever
    :func:`~sdp_vs_penalty.data.sources.as_measurements` takes; test : a run only for the held-out
    errors (without it, folds that no selection saw).
    frozen : keep the model's parameters, so that changes of the links
    show (a payload); otherwise they are refitted along with every candidate. seed : of the random
    signs that the tests compare with; progress : called with a short text of where the search stands;
    noise_from : the runs whose repetition shows the noise (default: those that the measurements are
    windows of, or the measurements); gain_uncertainty : relative
    standard deviation of the torque channels' gains; default: the model's. In a long recording windows
    are searched (:mod:`~sdp_vs_penalty.signals.excerpt`), and a remark says so.
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
    recording, whole, given = measurements, None, measurements.whole
    measurements = excerpt(recording, settings, MOST_SEARCHED)
    looked = excerpt_sentence(measurements, recording, "effects were searched for in")
    test = None if test is None else excerpt(test, settings, MOST_SEARCHED)
    rows = diagnosis_rows(measurements, estimate, settings)
    if noise_from is not None:
        given = as_measurements(noise_from, names=names, what="diagnose(noise_from=...)")
    if given is not None and not (looked and given is recording):
        estimate.require_joints(given, "runs for the noise")
        _, given = driven(whole_estimate, given)
        whole = with_estimate(segmented(excerpt(given, settings), settings), estimate)
    found = search(rows, estimate, frozen, seed, progress, whole)
    progress("held-out errors")
    gain_errors = estimate.uncertainty.gain_errors
    if gain_uncertainty is not None:
        gain_errors = independent_gains(gain_uncertainty, estimate.robot.n)
    share = None if test is None else _new_motion(estimate, measurements, test, settings, frozen)
    done = conclude(found, measurements, test, settings, gain_errors, share)
    return replace(done, remarks=(looked, *done.remarks)) if looked else done


def _new_motion(
    estimate: Estimate,
    searched: Measurements,
    test: Measurements,
    settings: Preprocessing,
    frozen: bool,
) -> float | None:
    """Share of the test run's motion that neither the search nor a frozen model has seen."""
    record, known = record_motion(searched, settings), estimate.training_motion
    if frozen and record is not None:
        record = None if known is None else record.joined(known)
    return None if record is None else record.new_share_of(test, settings)


def conclude(
    found: Found,
    data: Measurements,
    test: Measurements | None,
    settings: Preprocessing,
    gain_errors: Array,
    new_share: float | None = None,
) -> Diagnosis:
    """Verdict, findings and held-out errors of a search that has come to its end."""
    found, held_out = _offered(found, lambda f: OnFolds(f) if test is None else OnTest(f, data, test))
    major = held_out.minor.count(False)
    estimate, state, stage = found.estimate, found.state, found.state.stage
    left, events = remaining(state)
    retuned = retunes(found.shapes, estimate.robot, held_out.before, held_out.ladder[0])
    errors = torque_errors(stage, estimate, gain_errors) if state.picks else np.zeros((0, 0))
    # What minor ones share with the others costs nothing when they are left out.
    lean = found
    if major < len(state.picks):
        lean = replace(found, state=state.with_picks(state.picks[:major]))
    every = [
        _finding(lean if k < major else found, k, held_out, errors) for k in range(len(state.picks))
    ]
    findings, minor = tuple(every[:major]), tuple(replace(f, confidence="minor") for f in every[major:])
    doubted = explanations.doubts(findings)
    rows = None if test is None else (diagnosis_rows(test, estimate, settings), estimate)
    measured = measured_curves(state, left, [j - 1 for _, j in doubted], rows)
    findings = stood_in(explanations.doubtful(findings, doubted), measured)
    verdict = EFFECT_MISSING if findings else NOTHING_MISSING
    if left.matters or doubted or measured.curves:
        verdict = UNKNOWN
    return Diagnosis(
        verdict,
        findings,
        stage.noise.floor,
        invisible_effects(state),
        events,
        stage.noise.source,
        left.share,
        held_out.ladder[major],
        stage.rows.cutoff,
        explanations.remarks(
            stage.noise.source,
            (
                *doubted.values(),
                explanations.standstill(held_out.moving, held_out.ladder[-1]),
                explanations.negligible(left),
                explanations.turning(left) if stage.noise.source == REPETITION else "",
            ),
            held_out.source,
            new_share,
        ),
        held_out.before if retuned else held_out.ladder[0],
        held_out.source,
        stage.frozen,
        new_share,
        retuned,
        measured.curves,
        tuple(carriers(stage.rows, state.residual, left.matters)),
        tuple((j + 1, float(left.beyond[j])) for j in left.matters),
        minor,
    )


def _offered(found: Found, on: Callable[[Found], OnFolds | OnTest]) -> tuple[Found, HeldOut]:
    """The search without the picks that may be what others leave, and those that do not lower their
    joints' error on data left out; with the constants that the model was given on joints whose error
    there other ones raise. Those that are minor come last."""
    found = replace(found, state=seen_sliding(found.state))
    judge, back = on(found), frozenset[int]()
    while True:
        found = replace(found, state=believable(found.state))
        picks = found.state.picks
        kept = [p for p, pays in zip(picks, judge.pays(picks), strict=True) if pays]
        if len(kept) < len(picks):
            found = replace(found, state=found.state.with_picks(kept))
            continue
        held_out = judge.errors(picks)
        worse = held_out.ladder[-1] > _RAISED * held_out.before
        raised = [j for j in moved(found.first, found.estimate) if worse[j]]
        if not back.issuperset(raised):
            back |= frozenset(raised)
            found = reverted(found, raised)
            judge = on(found)
        else:
            break
    order = sorted(range(len(picks)), key=lambda k: held_out.minor[k])
    if order != list(range(len(picks))):
        found = replace(found, state=found.state.with_picks([picks[k] for k in order]))
        ladder = judge.errors(found.state.picks).ladder
        minor = tuple(held_out.minor[k] for k in order)
        held_out = replace(held_out, ladder=ladder, minor=minor)
    return found, held_out


def _finding(found: Found, k: int, held_out: HeldOut, errors: Array) -> Finding:
    estimate, state = found.estimate, found.state
    pick = state.picks[k]
    h = pick.candidate
    beta, covariance = coefficients(state, k, errors)
    parameters = h.effect.parameters
    size, std = explanations.size_of(h.effect, beta, covariance)
    joints = () if h.effect.whole_robot else tuple(j + 1 for j in h.effect.joints)
    sharing = correlated(state, k)
    # What a law is with time is no other law than the steady one that it starts from, and a finer form
    # of it, which fits as well, does not speak against the plain one.
    others = [r for r in pick.rivals if not refines(r, h)]
    finer = [r.key[0] for r in pick.rivals if refines(r, h) and not r.effect.follows_clock]
    alike = [*others, *(p.candidate for p in sharing)]
    rivals = tuple(dict.fromkeys(_rival_name(h, r) for r in alike))
    uncertain, small = not abs(size) > 5.0 * std, not pick.gain > 2.0 * MIN_GAIN
    looks_like = h.effect.looks_like(size, state.stage.rows.seen(h.effect.joints[0]))
    if h.effect.shape.get(h.effect.beyond_turning, np.inf) < _BEYOND * turning(
        state.stage.rows, h.effect
    ):
        looks_like = (
            "it hardly outlasts the velocity over which Coulomb friction turns: a width looks so"
        )
    over = overshadowed(state, k)
    larger = bent(estimate, h.effect, size) if over is None else over.candidate.effect.name
    weak = explanations.weaknesses(bool(others), uncertain, small, bool(sharing), larger, looks_like)
    return Finding(
        h.effect.name,
        joints,
        dict(h.effect.shape),
        size,
        parameters[h.effect.sized_by][0].unit,
        std,
        {p.name: float(b) for p, b in zip(parameters, beta, strict=True)},
        "weak" if weak else "confident",
        rivals,
        held_out.ladder[k],
        held_out.ladder[k + 1],
        explanations.sentence(h.effect, size, std, rivals, finer),
        h.effect.text,
        pick.gain,
        weak,
        h.effect.constants,
        tuple(dict.fromkeys(finer)),
    )


def _rival_name(own: Candidate, other: Candidate) -> str:
    """The rival's name; with its joint, or its constants, where that alone would be the finding's."""
    if other.key == own.key:
        return other.effect.text
    if other.key[0] == own.key[0] and other.key[1] is not None:
        return f"{other.key[0]}:{other.key[1] + 1}"
    return other.key[0]


def invisible_effects(state: SearchState) -> tuple[Invisible, ...]:
    """Candidates whose energy the model's own columns absorb, whatever their shape."""
    stage = state.stage
    if stage.frozen:
        return ()
    scores = score_library(stage.fit(stage.plain_weighting), stage.white)
    shares: dict[tuple[str, int | None], float] = {}
    for group, absorbed in zip(stage.white.groups, scores.absorbed, strict=True):
        shares[group.key] = min(shares.get(group.key, 1.0), float(absorbed))
    return tuple(
        Invisible(name, () if joint is None else (joint + 1,), share)
        for (name, joint), share in shares.items()
        if share > INVISIBLE
    )
