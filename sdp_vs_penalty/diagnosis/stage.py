"""The stage of a search: rows, an idea of their noise, the model's own columns and all candidates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.candidates import Candidates
from sdp_vs_penalty.diagnosis.coloured import Coloured, JointRows
from sdp_vs_penalty.diagnosis.fit import RowLabels, Weighting, WhiteFit, orthonormal
from sdp_vs_penalty.diagnosis.library import Candidacy, Key, Library, spread_columns
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.autoregression import ORDER, Pieces
from sdp_vs_penalty.signals.noise import Noise, noise_in, noise_of
from sdp_vs_penalty.signals.phases import MotionClock, PhaseFolds, motion_clocks
from sdp_vs_penalty.signals.repetition import is_part
from sdp_vs_penalty.signals.segments import Segment, SegmentedRuns

#: Residual variance over that of the noise from which the evidence is not taken at its word.
MISFIT = 1.3
_BLOCKS = 60
_PHASE_FOLDS = 5
#: How many fits a stage keeps.
_FITS = 3


def quiet(_: str) -> None:
    pass


@dataclass(frozen=True)
class Stage:
    """Everything that stays the same during a search.

    columns (n, M, p), residual (M, n) : the model's own filtered columns and what it leaves, not
    whitened; known : effects that the model has, by joint. With another noise (``replace``) it is
    another stage: what is white is worked out from these.
    """

    rows: SegmentedRuns
    noise: Noise
    labels: RowLabels
    columns: Array
    residual: Array
    candidacy: Candidacy
    known: frozenset[Key]
    seed: int
    frozen: bool

    @property
    def white(self) -> Library:
        """The library's columns, white."""
        return self.candidates.white

    @cached_property
    def candidates(self) -> Candidates:
        return Candidates(self.rows, self.noise, self.candidacy)

    @cached_property
    def plain_weighting(self) -> Weighting:
        """All joints alike, nothing but noise in their error."""
        n = self.rows.n
        inner = (Pieces(p[ORDER:] for p in self.rows.pieces(j) if len(p) > 2 * ORDER) for j in range(n))
        return Weighting(np.ones(n), np.zeros((n, ORDER)), tuple(inner))

    def with_noise(self, noise: Noise) -> Stage:
        """The same with another idea of the noise."""
        labels = replace(self.labels, count=informative(self.rows, noise))
        return replace(self, noise=noise, labels=labels)

    def on(self, rows: SegmentedRuns) -> Stage:
        """The same with other rows masked."""
        labels = replace(self.labels, count=informative(rows, self.noise))
        return replace(self, rows=rows, labels=labels)

    def release(self) -> None:
        """Forget what is large and follows from the rest: it is made again where it is asked for."""
        for name in ("candidates", "white_rows", "_white_model", "_joints", "_fits"):
            vars(self).pop(name, None)

    def fit(self, weighting: Weighting) -> WhiteFit:
        """The model alone, fitted to its weighted white residual; the last few are kept, with a colour
        those with the last one: each of these holds the library behind its filter."""
        colour = weighting.colour.tobytes()
        key = weighting.level.tobytes() + colour
        if key not in self._fits:
            for old, fit in list(self._fits.items()):
                other = weighting.colour.any() and fit.weighting.colour.any()
                if len(self._fits) >= _FITS or (other and not old.endswith(colour)):
                    del self._fits[old]
            self._fits[key] = self._coloured(weighting).fit(self.labels, weighting)
        return self._fits[key]

    def levelled(self, weighting: Weighting, white: Sequence[Array]) -> WhiteFit:
        """The fit with white columns (n M, k) more, or one on fewer rows that leaves joints the same."""
        few = self._coloured(weighting).compressed(self.labels, white, weighting)
        return self.fit(weighting).extended(*white) if few is None else few

    def _coloured(self, weighting: Weighting) -> Coloured:
        """The model behind the colour's filter; kept of each joint without one and with the last."""
        columns, target = (x.reshape(self.rows.n, len(self.rows.t), -1) for x in self._white_model)
        out = []
        for j, colour in enumerate(weighting.colour):
            key = j, colour.tobytes()
            if key not in self._joints:
                for old in [k for k in self._joints if k[0] == j and any(k[1])]:
                    del self._joints[old]
                filtered = JointRows.of(columns[j], target[j, :, 0], weighting.filter_of(j))
                self._joints[key] = filtered
            out.append(self._joints[key])
        return Coloured(tuple(out))

    @cached_property
    def _joints(self) -> dict[tuple[int, bytes], JointRows]:
        return {}

    @cached_property
    def _fits(self) -> dict[bytes, WhiteFit]:
        return {}

    @cached_property
    def white_rows(self) -> tuple[Array, Array]:
        """The model's own columns (n M, p) and what it leaves (n M,), white."""
        return white_rows(self.rows, self.noise, self.columns, self.residual)

    @cached_property
    def _white_model(self) -> tuple[Array, Array]:
        columns, target = self.white_rows
        return orthonormal(columns), target

    def residual_beside(self, effects: Sequence[Effect]) -> Array:
        """(M, n) what the model leaves, not whitened, when it has these effects as well."""
        columns = [spread_columns(self.rows, effect) for effect in effects]
        everything = np.concatenate([self.columns, *columns], axis=2)
        return self.residual - (everything @ self.least_squares(everything)).T

    def noise_beside(self, effects: Sequence[Effect]) -> Noise:
        """The noise as what the model leaves when it has these effects as well."""
        return noise_in(self.rows, self.residual_beside(effects))

    def least_squares(
        self, columns: Array, rows: SegmentedRuns | None = None, balanced: bool = False
    ) -> Array:
        """(p,) smallest change of parameters that fits white columns (n, M, p) to the residual.

        rows : with some of them masked; balanced : a joint whose error is more than noise counts by
        that error, once more, so that it does not spoil the others for its own sake.
        """
        n, M, p = columns.shape
        if p == 0:
            return np.zeros(0)
        white, b = white_rows(self.rows if rows is None else rows, self.noise, columns, self.residual)
        white, b = white.reshape(n, M, p), b.reshape(n, M)
        theta = _solved(white, b)
        if balanced:
            left = np.sum((b - white @ theta) ** 2, axis=1) / np.maximum(np.sum(b != 0.0, axis=1), 1)
            level = np.sqrt(np.where(left > MISFIT, left, 1.0))
            if np.any(level > 1.0):
                theta = _solved(white / level[:, None, None], b / level[:, None])
        return theta


def prepare(
    rows: SegmentedRuns,
    estimate: Estimate,
    frozen: bool,
    seed: int,
    progress: Callable[[str], None] = quiet,
    whole: SegmentedRuns | None = None,
) -> Stage:
    """Noise, columns of the model and of all candidates; ``whole`` : what the noise is measured in."""
    residual = rows.residual
    progress("noise from repetition")
    noise = noise_of(rows, whole)
    if noise.suspect.any():
        rows = rows.with_masked(noise.suspect)
    progress("columns of all candidates")
    columns = model_columns(rows, estimate, frozen)
    known = frozenset((e.name, j) for e in estimate.model.effects for j in e.joints)
    candidacy = Candidacy(rows, estimate.model, frozen)
    labels = label_rows(rows, noise, whole)
    return Stage(rows, noise, labels, columns, residual, candidacy, known, seed, frozen)


def model_columns(rows: SegmentedRuns, estimate: Estimate, frozen: bool = False) -> Array:
    """(n, M, p) filtered columns of the model's own parameters; none of a frozen model's."""
    if frozen:
        return np.zeros((rows.n, len(rows.t), 0))
    out, model = np.zeros((rows.n, len(rows.t), len(estimate.theta))), estimate.model
    if not model.needs_reference:
        for effect, indices in zip(model.effects, model.indices, strict=True):
            for block in rows.blocks(effect):
                out[block.joint][:, indices[block.parameters]] += block.columns
        return out
    first = 0
    for segment in rows.segments:
        M = len(segment.t)
        bare = replace(segment.motion, torque=None, current=None)
        for joint, c in enumerate(model.columns(bare)):
            out[joint, first : first + M][:, c.indices] += segment.low_pass @ c.columns
        first += M
    return out


def label_rows(rows: SegmentedRuns, noise: Noise, whole: SegmentedRuns | None = None) -> RowLabels:
    """Blocks of equal length within runs; folds: whole motions, or phases of the one that there is.

    whole : what the runs may be windows of, and in which a motion may repeat.
    """
    run, t = rows.run, rows.t
    spans = [t[run == r][-1] - t[run == r][0] for r in np.unique(run)]
    length = max(0.5, sum(spans) / _BLOCKS)
    block = np.zeros(len(t), np.intp)
    count = 0
    for r in np.unique(run):
        mine = run == r
        pieces = max(1, round((t[mine][-1] - t[mine][0]) / length))
        edges = np.linspace(t[mine][0], t[mine][-1], pieces + 1)[1:-1]
        block[mine] = count + np.searchsorted(edges, t[mine], side="right")
        count += pieces
    clocks = clocks_of(rows, whole)
    motion = np.array([clocks[r].motion if r in clocks else 0 for r in range(run.max() + 1)])[run]
    found, fold = np.unique(motion, return_inverse=True)
    if len(found) == 1:
        fold = phase_folds(rows, clocks)
    _, block = np.unique(block, return_inverse=True)
    return RowLabels(rows.n, block, fold, informative(rows, noise))


def informative(rows: SegmentedRuns, noise: Noise) -> Array:
    """(n,) rows that carry information: behind the past that whitening needs, each by its worth."""
    return np.array([noise.worth[rows.pieces(j).predicted, j].sum() for j in range(rows.n)])


def clocks_of(rows: SegmentedRuns, whole: SegmentedRuns | None = None) -> dict[int, MotionClock]:
    """The clock of each run's motion by the run's index; that of the whole that a run is a window of."""
    windows = _longest(rows)
    measured = windows if whole is None else _longest(whole)
    clocks = motion_clocks([(s.t_dense, s.q_dense) for s in measured.values()])
    if whole is None:
        return dict(zip(measured, clocks, strict=True))
    out = {}
    for run, window in windows.items():
        pairs = zip(clocks, measured.values(), strict=True)
        found = [clock for clock, segment in pairs if is_part(window, segment)]
        if not found:
            return clocks_of(rows)
        out[run] = found[0]
    return out


def _longest(rows: SegmentedRuns) -> dict[int, Segment]:
    """The longest segment of each run, by the run's index."""
    out: dict[int, Segment] = {}
    for segment in rows.segments:
        if segment.run not in out or len(segment.t) > len(out[segment.run].t):
            out[segment.run] = segment
    return out


def phase_folds(rows: SegmentedRuns, clocks: dict[int, MotionClock]) -> NDArray[np.intp]:
    """(M,) folds by phase: what the motion repeats shares a fold; else stretches of time.

    Each fold is made of two stretches of every motion's clock, so that training data surround it.
    """
    out = np.zeros(len(rows.t), np.intp)
    for run, clock in clocks.items():
        mine = rows.run == run
        out[mine] = PhaseFolds((clock,), 2 * _PHASE_FOLDS).fold(0, rows.t[mine])
    return out % _PHASE_FOLDS


def stretches(rows: SegmentedRuns, count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(M,) folds, each one stretch of every motion's clock; and (M,) numbers of stretch and motion."""
    fold, motion = np.zeros((2, len(rows.t)), np.intp)
    for run, clock in clocks_of(rows).items():
        mine = rows.run == run
        fold[mine] = PhaseFolds((clock,), count).fold(0, rows.t[mine])
        motion[mine] = clock.motion
    _, cell = np.unique(motion * count + fold, return_inverse=True)
    return fold, cell


def white_rows(
    rows: SegmentedRuns, noise: Noise, columns: Array, residual: Array
) -> tuple[Array, Array]:
    """White columns (n M, p) and residual (n M,) from (n, M, p) and (M, n)."""
    n, M = rows.n, len(rows.t)
    white, target = np.zeros((n, M, columns.shape[2])), np.zeros((n, M))
    for j in range(n):
        pieces = rows.pieces(j)
        white[j] = noise.whiten(columns[j], j, pieces)
        target[j] = noise.whiten(residual[:, j], j, pieces)
    return white.reshape(n * M, -1), target.ravel()


def _solved(white: Array, b: Array) -> Array:
    A = white.reshape(-1, white.shape[2])
    norms = np.linalg.norm(A, axis=0)
    unit = np.where(norms > 1e-12 * norms.max(initial=0.0), norms, np.inf)
    return np.asarray(np.linalg.lstsq(A / unit, b.ravel(), rcond=1e-8)[0] / unit)
