"""The stage of a search: rows, their noise, the candidates; and the search run on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.fit import Rows
from sdp_vs_penalty.diagnosis.ladder import MISFIT, Search
from sdp_vs_penalty.diagnosis.library import Library, build_library, spread_columns
from sdp_vs_penalty.diagnosis.rows import DiagnosisRows
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.signals.autoregression import ORDER
from sdp_vs_penalty.signals.noise import RESIDUAL, Noise, noise_in, noise_of
from sdp_vs_penalty.signals.repetition import repeat_period

Array = NDArray[np.float64]

_BLOCKS = 60
#: How often the noise is estimated anew where only the residual shows it.
_ROUNDS = 12
_PHASE_FOLDS = 5


def quiet(_: str) -> None:
    pass


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
    progress: Callable[[str], None] = quiet,
) -> Stage:
    """Noise, whitening, candidates."""
    residual = rows.residual
    progress("noise from repetition")
    noise = noise_of(rows)
    if noise.suspect.any():
        rows = rows.with_masked(noise.suspect)
    progress("columns of all candidates")
    library = build_library(rows, estimate.model, frozen)
    white = library.whitened(noise, rows)
    base = model_columns(rows, estimate, frozen)
    labels = label_rows(rows)
    columns, target = white_rows(rows, noise, base, residual)
    known = frozenset((e.name, j) for e in estimate.model.effects for j in e.joints)
    search = Search(rows, noise, labels, columns, target, white, known, seed)
    return Stage(rows, noise, labels, base, residual, library, white, search, frozen)


def search_through(stage: Stage, estimate: Estimate) -> Stage:
    """Run the search.

    Where only the residual shows the noise, it begins as what the model leaves beside the best
    explanation and is known better after each round. Its colour hides what resembles it; when
    nothing more is found with it, one more look takes the noise as white.
    """
    if stage.noise.source != RESIDUAL:
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
        columns = new.search.candidates.white_columns(pick.hypothesis.effect)
        hypothesis = replace(pick.hypothesis, columns=columns)
        new.search.picks.append(replace(pick, hypothesis=hypothesis))
    new.search.settle()
    return new


def _noise_beside(stage: Stage, effects: Sequence[Effect]) -> Noise:
    """The noise as what the model leaves when it has these effects as well."""
    return noise_in(stage.rows, residual_beside(stage, effects))


def residual_beside(stage: Stage, effects: Sequence[Effect]) -> Array:
    """(M, n) what the model leaves, not whitened, when it has these effects as well."""
    columns = [spread_columns(stage.rows, effect) for effect in effects]
    everything = np.concatenate([stage.base, *columns], axis=2)
    return stage.residual - (everything @ least_squares(stage, stage.rows, everything)).T


def with_noise(stage: Stage, estimate: Estimate, noise: Noise) -> Stage:
    """The same stage with another idea of the noise, its search at the beginning."""
    white = stage.library.whitened(noise, stage.rows)
    columns, target = white_rows(stage.rows, noise, stage.base, stage.residual)
    known = frozenset((e.name, j) for e in estimate.model.effects for j in e.joints)
    search = Search(stage.rows, noise, stage.labels, columns, target, white, known, stage.search.seed)
    return replace(stage, noise=noise, white=white, search=search)


def model_columns(rows: DiagnosisRows, estimate: Estimate, frozen: bool = False) -> Array:
    """(n, M, p) filtered columns of the model's own parameters; none of a frozen model's."""
    if frozen:
        return np.zeros((rows.n, len(rows.t), 0))
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
    seen = np.array([sum(max(len(p) - 4, 0) for p in rows.pieces(j)) for j in range(rows.n)], float)
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
        pieces = rows.pieces(j)
        columns[j] = noise.whiten(base[j], j, pieces)
        target[j] = noise.whiten(residual[:, j], j, pieces)
    return columns.reshape(n * M, -1), target.ravel()


def least_squares(stage: Stage, rows: DiagnosisRows, columns: Array, balanced: bool = False) -> Array:
    """(p,) smallest change of parameters that fits white columns (n, M, p) to the residual.

    balanced : a joint whose error is more than noise counts by that error, once more, so that it does
    not spoil the others for its own sake.
    """
    n, M, p = columns.shape
    if p == 0:
        return np.zeros(0)
    white, b = np.zeros((n, M, p)), np.zeros((n, M))
    for j in range(n):
        pieces = rows.pieces(j)
        white[j] = stage.noise.whiten(columns[j], j, pieces)
        b[j] = stage.noise.whiten(stage.residual[:, j], j, pieces)
    theta = _solved(white, b)
    if balanced:
        left = np.sum((b - white @ theta) ** 2, axis=1) / np.maximum(np.sum(b != 0.0, axis=1), 1)
        level = np.sqrt(np.where(left > MISFIT, left, 1.0))
        if np.any(level > 1.0):
            theta = _solved(white / level[:, None, None], b / level[:, None])
    return theta


def _solved(white: Array, b: Array) -> Array:
    A = white.reshape(-1, white.shape[2])
    norms = np.linalg.norm(A, axis=0)
    unit = np.where(norms > 1e-12 * norms.max(initial=0.0), norms, np.inf)
    return np.asarray(np.linalg.lstsq(A / unit, b.ravel(), rcond=1e-8)[0] / unit)
