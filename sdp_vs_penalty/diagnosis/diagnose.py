"""The verb: which effect does the model miss?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis import explanations
from sdp_vs_penalty.diagnosis.events import (
    Event,
    intervals,
    local_excess,
    noise_profile,
    robust_scale,
    spectral_lines,
)
from sdp_vs_penalty.diagnosis.findings import (
    EFFECT_MISSING,
    NOTHING_MISSING,
    UNKNOWN,
    Diagnosis,
    Finding,
    Invisible,
)
from sdp_vs_penalty.diagnosis.held_out import HeldOut, held_out_errors, least_squares
from sdp_vs_penalty.diagnosis.ladder import Pick, Search
from sdp_vs_penalty.diagnosis.library import Library, build_library, spread_columns
from sdp_vs_penalty.diagnosis.rows import DiagnosisRows, diagnosis_rows
from sdp_vs_penalty.diagnosis.scoring import Fit, Rows, score_library
from sdp_vs_penalty.diagnosis.verdict import Remainder, remainder
from sdp_vs_penalty.diagnosis.whitening import ORDER, Noise, noise_of, pieces_of, rate_features
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimate import Estimate
from sdp_vs_penalty.measurements import Measurements
from sdp_vs_penalty.noise import repeat_period
from sdp_vs_penalty.preprocessing import Preprocessing

Array = NDArray[np.float64]

#: An effect of which the model absorbs more than this share cannot be seen.
INVISIBLE = 0.999
#: Events are rare: what fills more than this share of a joint's rows is something else.
MOST_EVENTS = 0.15
_BLOCKS = 60
#: Hz: below, lines are the motion's own harmonics.
_SLOWEST_HUM = 0.8
#: In units of the row rate: above, what the low-pass folds has no flat surroundings.
_FASTEST_HUM = 0.45
#: How often the noise is estimated anew where only the residual shows it.
_ROUNDS = 12
_PHASE_FOLDS = 5


def _quiet(_: str) -> None:
    pass


def diagnose(
    estimate: Estimate,
    measurements: Measurements,
    test: Measurements | None = None,
    *,
    frozen: bool = False,
    seed: int = 0,
    progress: Callable[[str], None] = _quiet,
) -> Diagnosis:
    """Which physical effects the model misses, judged against the noise; see :class:`Diagnosis`.

    estimate : the model in question; measurements : the runs to search in; test : a run only for the
    held-out errors (without it, folds that no selection saw).
    frozen : keep the model's parameters, so that changes of the links
    show (a payload); otherwise they are refitted along with every hypothesis. seed : of the random
    signs that the tests compare with; progress : called with a short text of where the search stands.
    Raises InputError where model and measurements do not belong together or nothing is left after
    filtering.
    """
    for what, m in (("measurements", measurements), ("test run", test)):
        if m is not None and m.n != estimate.robot.n:
            raise InputError(
                f"The {what} have {m.n} joint(s), the model's robot has {estimate.robot.n}: choose "
                "the model that belongs to them."
            )
    settings = estimate.preprocessing.resolve(measurements)
    progress("filtering the runs")
    rows = diagnosis_rows(measurements, estimate, settings)
    stage = prepare(rows, estimate, frozen, seed, progress)
    progress("searching for what is missing")
    stage = search_through(stage, estimate)
    progress("held-out errors")
    return conclude(estimate, stage, test, settings)


def search_through(stage: Stage, estimate: Estimate) -> Stage:
    """Run the search.

    Where only the residual shows the noise, it begins as what the model leaves beside the best
    explanation and is known better after each round. Its colour hides what resembles it; when
    nothing more is found with it, one more look takes the noise as white.
    """
    if stage.noise.source != "residual":
        stage.search.run()
        return stage
    best = _with_white_noise(stage, estimate).search
    contenders = best.contenders(best.fit(), best.scaled)[:1]
    stage = with_noise(stage, estimate, _noise_beside(stage, [h.effect for h in contenders]))
    stage.search.run()
    for _ in range(_ROUNDS):
        found = len(stage.search.picks)
        stage = _renewed(stage, estimate)
        stage.search.run()
        if len(stage.search.picks) == found:
            plain = _with_white_noise(stage, estimate)
            plain.search.run()
            if len(plain.search.picks) == found:
                break
            stage = plain
    return _renewed(stage, estimate)


def _renewed(stage: Stage, estimate: Estimate) -> Stage:
    """The same picks with the noise as what is left beside them."""
    noise = _noise_beside(stage, [p.hypothesis.effect for p in stage.search.picks])
    return _carried(stage, with_noise(stage, estimate, noise))


def _with_white_noise(stage: Stage, estimate: Estimate) -> Stage:
    """The same picks with white noise as large as what is left beside them."""
    noise = _noise_beside(stage, [p.hypothesis.effect for p in stage.search.picks])
    plain = replace(noise, ar=np.zeros((stage.rows.n, ORDER)), sigma=noise.floor)
    return _carried(stage, with_noise(stage, estimate, plain))


def _carried(old: Stage, new: Stage) -> Stage:
    """The picks of the old stage in the new one, their columns whitened anew."""
    for pick in old.search.picks:
        columns = new.search.white_columns(pick.hypothesis.effect)
        hypothesis = replace(pick.hypothesis, columns=columns)
        new.search.picks.append(replace(pick, hypothesis=hypothesis))
    new.search.settle()
    return new


def _noise_beside(stage: Stage, effects: Sequence[Effect]) -> Noise:
    """The noise as what the model leaves when it has these effects as well."""
    columns = [spread_columns(stage.rows, effect) for effect in effects]
    everything = np.concatenate([stage.base, *columns], axis=2)
    theta = least_squares(stage, stage.rows, everything)
    return noise_of(stage.rows, [], stage.residual - (everything @ theta).T)


def with_noise(stage: Stage, estimate: Estimate, noise: Noise) -> Stage:
    """The same stage with another idea of the noise, its search at the beginning."""
    white = stage.library.whitened(noise, stage.rows)
    columns, target = white_rows(stage.rows, noise, stage.base, stage.residual)
    known = frozenset((e.name, j) for e in estimate.model.effects for j in e.joints)
    search = Search(stage.rows, noise, stage.labels, columns, target, white, known, stage.search.seed)
    return replace(stage, noise=noise, white=white, search=search)


def conclude(
    estimate: Estimate, stage: Stage, test: Measurements | None, settings: Preprocessing
) -> Diagnosis:
    """Verdict, findings and held-out errors of a search that has run."""
    left, events = _remaining(stage.search.fit(), stage)
    picks = stage.search.picks
    held_out = held_out_errors(estimate, stage, picks, test, settings)
    return _diagnosis(estimate, stage, picks, left, events, held_out)


@dataclass(frozen=True)
class Stage:
    """Everything prepared for a search: the rows, their noise, the library, the model's own columns."""

    rows: DiagnosisRows
    noise: Noise
    labels: Rows
    base: Array
    residual: Array
    library: Library
    white: Library
    search: Search
    frozen: bool


def prepare(
    rows: DiagnosisRows,
    estimate: Estimate,
    frozen: bool,
    seed: int,
    progress: Callable[[str], None] = _quiet,
) -> Stage:
    """Noise, whitening, candidates."""
    residual = np.concatenate([s.torque - s.low_pass @ s.motion.model_torque for s in rows.segments])
    dense = [s.torque_dense - s.dense @ s.motion.model_torque for s in rows.segments]
    progress("noise from repetition")
    noise = noise_of(rows, dense, residual)
    if noise.suspect.any():
        rows = rows.with_masked(noise.suspect)
    progress("columns of all candidates")
    library = build_library(rows, estimate.model, frozen)
    white = library.whitened(noise, rows)
    base = np.zeros((rows.n, len(rows.t), 0)) if frozen else model_columns(rows, estimate)
    labels = label_rows(rows)
    columns, target = white_rows(rows, noise, base, residual)
    known = frozenset((e.name, j) for e in estimate.model.effects for j in e.joints)
    search = Search(rows, noise, labels, columns, target, white, known, seed)
    return Stage(rows, noise, labels, base, residual, library, white, search, frozen)


def model_columns(rows: DiagnosisRows, estimate: Estimate) -> Array:
    """(n, M, p) filtered columns of the model's own parameters."""
    out = np.zeros((rows.n, len(rows.t), len(estimate.theta)))
    first = 0
    for segment in rows.segments:
        M = len(segment.t)
        bare = replace(segment.motion, torque=None, current=None)
        for joint, c in enumerate(estimate.model.columns(bare)):
            out[joint, first : first + M][:, c.indices] = segment.low_pass @ c.columns
        first += M
    return out


def label_rows(rows: DiagnosisRows) -> Rows:
    """Blocks of equal length within runs; folds: whole runs, or phases of the one run's period."""
    run, t = rows.run, rows.t
    spans = [t[run == r][-1] - t[run == r][0] for r in np.unique(run)]
    length = max(0.5, sum(spans) / _BLOCKS)
    block = np.zeros(len(t), np.intp)
    fold = np.zeros(len(t), np.intp)
    count = 0
    for f, r in enumerate(np.unique(run)):
        mine = run == r
        pieces = max(1, round((t[mine][-1] - t[mine][0]) / length))
        edges = np.linspace(t[mine][0], t[mine][-1], pieces + 1)[1:-1]
        block[mine] = count + np.searchsorted(edges, t[mine], side="right")
        count += pieces
        fold[mine] = f
    if len(spans) == 1:
        fold = phase_folds(rows)
    _, block = np.unique(block, return_inverse=True)
    seen = np.array([sum(max(len(p) - 4, 0) for p in pieces_of(rows, j)) for j in range(rows.n)], float)
    return Rows(rows.n, block, fold, seen)


def phase_folds(rows: DiagnosisRows) -> NDArray[np.intp]:
    """Folds of one run: samples one period apart share a fold; without a period, stretches of time."""
    t = rows.t
    longest = max(rows.segments, key=lambda s: len(s.t))
    period = repeat_period(longest.t_dense, longest.q_dense)
    span = t[-1] - t[0]
    cycle = span * (1.0 + 1e-9) if period is None else period
    # Each fold is made of two stretches, so that training data surround it.
    slot = np.floor((t - t[0]) % cycle / cycle * 2 * _PHASE_FOLDS).astype(np.intp)
    return slot % _PHASE_FOLDS


def white_rows(rows: DiagnosisRows, noise: Noise, base: Array, residual: Array) -> tuple[Array, Array]:
    """White model columns (n M, p) and residual (n M,) from (n, M, p) and (M, n)."""
    n, M = rows.n, len(rows.t)
    columns, target = np.zeros((n, M, base.shape[2])), np.zeros((n, M))
    for j in range(n):
        pieces = pieces_of(rows, j)
        columns[j] = noise.whiten(base[j], j, pieces)
        target[j] = noise.whiten(residual[:, j], j, pieces)
    return columns.reshape(n * M, -1), target.ravel()


def _remaining(fit: Fit, stage: Stage) -> tuple[Remainder, tuple[Event, ...]]:
    """What is left once events are set aside, and the events.

    Windows of too much energy are events only if they are few and nothing repeatable is left
    beside them: otherwise they are the peaks of the model's error.
    """
    rows, noise = stage.rows, stage.noise
    n, M = rows.n, len(rows.t)
    white = (fit.residual.reshape(n, M) * fit.weighting.level[:, None]).T
    left = remainder(fit, rows, noise)
    mask = np.zeros((M, n), bool)
    rates = rate_features(rows)
    for j in range(n):
        steady = white[:, j] / noise_profile(white[:, j], rates[j], rates[j])
        # The noise may be larger than the repetition let on; its median does not see an event.
        steady /= max(robust_scale(steady[steady != 0.0]), 1.0)
        found = local_excess(steady, pieces_of(rows, j), n, float(noise.degrees[j]))
        if found.sum() < MOST_EVENTS * rows.keep[:, j].sum():
            mask[:, j] = found
    repeats = _repeating(mask, stage)
    mask &= ~repeats
    if repeats.any():
        left = replace(left, remains=True)
    if mask.any():
        without = remainder(fit, rows, noise, mask)
        if without.remains:
            mask[:] = False
        else:
            left = without
    mask |= noise.suspect
    whole = rows.with_masked(np.zeros((0, 0), bool))
    events = [
        Event(j, start, end)
        for j in range(n)
        for start, end in intervals(mask[:, j], rows.t, pieces_of(whole, j), gap=1.0)
    ]
    events += _hums(stage)
    return left, tuple(sorted(events, key=lambda e: (e.t_start, e.joint)))


def _hums(stage: Stage) -> list[Event]:
    """One event a run for each joint in whose residual a spectral line stands.

    The residual is not whitened for it: an autoregression takes a sine for its own colour.
    """
    rows = stage.rows
    columns = [spread_columns(rows, p.hypothesis.effect) for p in stage.search.picks]
    everything = np.concatenate([stage.base, *columns], axis=2)
    left = stage.residual - (everything @ least_squares(stage, rows, everything)).T
    out = []
    for j in range(rows.n):
        pieces = pieces_of(rows, j)
        longest = max((len(p) for p in pieces), default=0)
        pieces = [p for p in pieces if 2 * len(p) > longest]
        series = [left[p, j] for p in pieces]
        lines = [
            f
            for f in spectral_lines(series, rows.rate, rows.n, _SLOWEST_HUM)
            if f < _FASTEST_HUM * rows.rate
        ]
        for piece in pieces if lines else ():
            first, last = rows.t[piece[0]], rows.t[piece[-1]]
            out.append(Event(j, float(first), float(last), "hum", lines[0]))
    return out


def _repeating(mask: NDArray[np.bool_], stage: Stage) -> NDArray[np.bool_]:
    """Rows (M, n) of windows that come back when the motion does: error of the model, no event."""
    out = np.zeros_like(mask)
    starts = np.cumsum([0, *(len(s.t) for s in stage.rows.segments)])
    wide = np.array([np.convolve(m, np.ones(3), mode="same") > 0 for m in mask.T]).T
    for repeat in stage.noise.repeats:
        times = stage.rows.segments[repeat.other].t
        later = starts[repeat.other] + np.clip(np.searchsorted(times, repeat.later), 0, len(times) - 1)
        both = mask[repeat.rows] & wide[later]
        out[repeat.rows] |= both
        out[later] |= both & mask[later]
    return out


def _diagnosis(
    estimate: Estimate,
    stage: Stage,
    picks: Sequence[Pick],
    left: Remainder,
    events: tuple[Event, ...],
    held_out: HeldOut,
) -> Diagnosis:
    findings = tuple(
        _finding(stage, picks, k, left, held_out.ladder[k], held_out.ladder[k + 1])
        for k in range(len(picks))
    )
    unknown_function = explanations.unrelated_ripples(findings)
    if left.remains or unknown_function:
        verdict = UNKNOWN
    else:
        verdict = EFFECT_MISSING if findings else NOTHING_MISSING
    return Diagnosis(
        verdict,
        findings,
        stage.noise.floor,
        invisible_effects(stage),
        events,
        stage.noise.source,
        left.share,
        held_out.ladder[-1],
        stage.rows.cutoff,
        explanations.remarks(stage.noise.source, left.p, unknown_function, held_out.source),
    )


def _finding(
    stage: Stage, picks: Sequence[Pick], k: int, left: Remainder, before: Array, after: Array
) -> Finding:
    pick = picks[k]
    h = pick.hypothesis
    fit = stage.search.fit(without=k)
    fresh = fit.partialled(fit.scaled(h.columns))
    gram = fresh.T @ fresh
    beta = np.asarray(np.linalg.lstsq(fresh, fit.residual, rcond=1e-9)[0], float)
    covariance = np.asarray(np.linalg.pinv(gram, rcond=1e-12), float)
    parameters = h.effect.parameters
    size, std = explanations.size_of(h.effect, beta, covariance)
    joints = () if h.effect.whole_robot else tuple(j + 1 for j in h.effect.joints)
    rivals = tuple(dict.fromkeys(_rival_name(h.key, r.key) for r in pick.rivals))
    sure = not rivals and abs(size) > 5.0 * std and pick.gain > 2.0 * 15.0
    return Finding(
        h.effect.name,
        joints,
        dict(h.effect.shape),
        size,
        parameters[0].unit,
        std,
        {p.name: float(b) for p, b in zip(parameters, beta, strict=True)},
        "confident" if sure else "weak",
        rivals,
        before,
        after,
        explanations.sentence(h.effect, size, std, rivals),
        h.effect.text,
        pick.gain,
    )


def _rival_name(own: tuple[str, int | None], other: tuple[str, int | None]) -> str:
    """The rival's name; with its joint where the name alone would be that of the finding."""
    if other[0] == own[0] and other[1] is not None:
        return f"{other[0]}:{other[1] + 1}"
    return other[0]


def invisible_effects(stage: Stage) -> tuple[Invisible, ...]:
    """Candidates whose energy the model's own columns absorb, whatever their shape."""
    if stage.frozen:
        return ()
    search = stage.search
    plain = replace(search.weighting, level=np.ones(stage.rows.n))
    scores = score_library(Fit.of(stage.labels, search.basis, search.target, plain), stage.white)
    shares: dict[tuple[str, int | None], float] = {}
    for group, absorbed in zip(stage.white.groups, scores.absorbed, strict=True):
        shares[group.key] = min(shares.get(group.key, 1.0), float(absorbed))
    return tuple(
        Invisible(name, () if joint is None else (joint + 1,), share)
        for (name, joint), share in shares.items()
        if share > INVISIBLE
    )
