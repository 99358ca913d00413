"""White rows: the log's rows in units of their noise, the model's own columns on them,
and their clusters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.constants import CLUSTERS, FORGETS
from sdp_vs_penalty.effects.effect import Effect, Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.sensitivity import ShapeSensitivity, sensitivities
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import RESIDUAL, Noise, noise_of
from sdp_vs_penalty.signals.phases import PhaseFolds, motion_clocks
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.segments import SegmentedRuns, segmented


def diagnosis_rows(
    measurements: Measurements,
    estimate: Estimate,
    settings: Preprocessing,
) -> SegmentedRuns:
    """Filter all runs; ``settings`` must be resolved. The current model is the
    estimate.

    Raises InputError where no run is long enough for the filters.
    """
    runs = segmented(measurements, settings)
    if not runs.segments:
        raise InputError(
            "no rows are left after filtering",
            "record longer runs in which the robot moves, or raise the cut-offs",
            ", ".join(runs.names),
        )
    return with_estimate(runs, estimate)


def with_estimate(
    runs: SegmentedRuns,
    estimate: Estimate,
    other_effects: Sequence[tuple[Effect, Array]] = (),
) -> SegmentedRuns:
    """The same runs with an estimate as the current model; other_effects : effects beside it,
    with their parameters, whose torque passes the channels as well."""
    model = estimate.model

    def beside(motion: Motion) -> Motion:
        if not other_effects:
            return motion
        torque_of_others = sum(e.torque(theta, motion) for e, theta in other_effects)
        return replace(
            motion,
            torque=motion.model_torque
            + torque_of_others * np.array(model.gains or (1.0,)),
        )

    return runs.with_model(
        lambda m: model.seen_along(estimate.theta, m),
        beside,
        model.gains,
    )


#: What errors of an effect's free shape constants make of torque, white.
ConstantErrors = tuple[ShapeSensitivity, dict[int, Array]]


@dataclass(frozen=True)
class WhiteData:
    """Rows whose noise is white and of unit variance, joint by joint.

    X (n, M, p), y (n, M) : the model's own columns and the torque, or what a frozen
    model leaves, white; clusters : (M,) labels, by time and by phase; count (n,) : rows
    that carry information; frozen : X has no columns.
    """

    rows: SegmentedRuns
    noise: Noise
    estimate: Estimate
    X: Array
    y: Array
    clusters: tuple[NDArray[np.intp], ...]
    count: Array
    frozen: bool

    @property
    def n(self) -> int:
        return self.rows.n

    @property
    def known(self) -> bool:
        """Whether the size of the noise is known, rather than taken from what the model
        leaves."""
        return self.noise.source != RESIDUAL

    @cached_property
    def own_effects(self) -> dict[tuple[str, int], tuple[Effect, int]]:
        """By name and joint the model's own effects, each alone, whose shape constant
        may be another one: with one column a joint; and where that stands in X."""
        if self.frozen:
            return {}
        model = self.estimate.model
        return {
            (e.name, j): (e.with_shape([j]), int(column))
            for e, columns in model.parts
            if e.estimated and len(columns) == len(e.joints)
            for j, column in zip(e.joints, columns, strict=True)
        }

    def constant_error_columns(
        self,
        effects: Sequence[Effect] = (),
        thetas: Sequence[Array] = (),
    ) -> list[ConstantErrors]:
        """What errors of the free shape constants of effects, and of the model's own
        beside them, make of white torque: what turns over another velocity looks like
        friction of another size."""
        model = self.estimate.model
        theta = self.estimate.theta
        if not self.frozen:
            effects = [*effects, *model.effects]
            thetas = [
                *thetas,
                *(theta[k] for k in model.indices),
            ]
        return [(s, self.columns(s)) for s in sensitivities(effects, thetas)]

    @cached_property
    def constants(self) -> dict[tuple[str, int], Array]:
        """(M, s) by name and joint the same of the model's own effects in ``own``."""
        columns_by_effect = (
            (s.effect.name, columns) for s, columns in self.constant_error_columns()
        )
        return {
            (name, j): z
            for name, by in columns_by_effect
            for j, z in by.items()
            if (name, j) in self.own_effects
        }

    @cached_property
    def raw(self) -> Array:
        """(n, M, p) the model's own columns, not white."""
        return model_columns(self.rows, self.estimate, self.frozen)

    def white(self, columns: Array, joint: int) -> Array:
        """(M, ...) columns of one joint's torque, white."""
        return self.noise.whiten(
            columns,
            joint,
            self.rows.pieces[joint],
        )

    def columns(self, effect: Effect) -> dict[int, Array]:
        """(M, k) white columns of an effect, of each joint whose torque it changes."""
        wide = spread_columns(self.rows, effect)
        return {
            b.joint: self.white(wide[b.joint], b.joint)
            for b in self.rows.blocks(effect)
        }


def cluster_sums(
    clusters: Sequence[NDArray[np.intp]], scores: Array
) -> Iterator[Array]:
    """(clusters, k) sums of scores (M, k), by each way to cluster rows."""
    for labels in clusters:
        yield np.stack([np.bincount(labels, column) for column in scores.T], axis=1)


def whiten_rows(
    rows: SegmentedRuns,
    estimate: Estimate,
    frozen: bool = False,
    noise_rows: SegmentedRuns | None = None,
) -> WhiteData:
    """White rows with a model attached; noise_rows : what the noise is measured in, if not
    these."""
    noise = noise_of(rows, noise_rows)
    masked = noise.suspect | mask_unsettled_rows(rows)
    if masked.any():
        rows = replace(rows, masked=masked)
    return whitened(rows, noise, estimate, frozen)


def mask_unsettled_rows(rows: SegmentedRuns) -> NDArray[np.bool_]:
    """(M, n) rows before a joint has come so far that friction with a memory has
    forgotten what bent it before the log began. Of a joint that never comes so far,
    none."""
    out = []
    for s in rows.segments:
        path = np.cumsum(
            np.abs(np.diff(s.motion.q, axis=0, prepend=s.motion.q[:1])), axis=0
        )
        out.append(path[s.low_pass.at] < FORGETS)
    masked = np.concatenate(out)
    return masked & ~masked.all(axis=0)


def whitened(
    rows: SegmentedRuns,
    noise: Noise,
    estimate: Estimate,
    frozen: bool,
) -> WhiteData:
    """The same where the noise is known."""
    torque = rows.residual if frozen else rows.torque
    X, y = white_rows(
        rows,
        noise,
        model_columns(rows, estimate, frozen),
        torque,
    )
    clusters = cluster_rows(rows)
    # Rows behind the past that whitening needs, each by its worth.
    count = np.array(
        [noise.worth[rows.pieces[j].predicted, j].sum() for j in range(rows.n)]
    )
    return WhiteData(rows, noise, estimate, X, y, clusters, count, frozen)


def white_rows(
    rows: SegmentedRuns,
    noise: Noise,
    columns: Array,
    residual: Array,
) -> tuple[Array, Array]:
    """White columns (n, M, p) and residual (n, M) from (n, M, p) and (M, n)."""
    white = np.zeros(columns.shape)
    target = np.zeros(columns.shape[:2])
    for j in range(rows.n):
        pieces = rows.pieces[j]
        white[j] = noise.whiten(columns[j], j, pieces)
        target[j] = noise.whiten(
            residual[:, j],
            j,
            pieces,
        )
    return white, target


def spread_columns(rows: SegmentedRuns, effect: Effect) -> Array:
    """(n, M, k) columns of one effect on all joints, not white."""
    out = np.zeros((rows.n, len(rows.t), len(effect.parameters)))
    for block in rows.blocks(effect):
        out[block.joint][:, block.parameters] = block.columns
    return out


def model_columns(
    rows: SegmentedRuns,
    estimate: Estimate,
    frozen: bool = False,
) -> Array:
    """(n, M, p) filtered columns of the model's own parameters; none of a frozen
    model's."""
    if frozen:
        return np.zeros((rows.n, len(rows.t), 0))
    return np.concatenate(
        [spread_columns(rows, e) for e in estimate.model.effects], axis=2
    )


def cluster_rows(
    rows: SegmentedRuns,
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(M,) labels of rows that err together: stretches of time, and stretches of the
    motion's phase.

    What a model lacks comes back with the motion.
    """
    return time_clusters(rows), stretches(rows, CLUSTERS)[1]


def time_clusters(rows: SegmentedRuns) -> NDArray[np.intp]:
    """(M,) labels of stretches of equal length within runs, of half a second at least."""
    run = rows.run
    t = rows.t
    spans = [np.ptp(t[run == r]) for r in np.unique(run)]
    length = max(0.5, sum(spans) / CLUSTERS)
    label = np.zeros(len(t), np.intp)
    count = 0
    for r, span in zip(np.unique(run), spans, strict=True):
        mine = run == r
        pieces = max(1, round(span / length))
        edges = np.linspace(t[mine][0], t[mine][-1], pieces + 1)[1:-1]
        label[mine] = count + np.searchsorted(edges, t[mine], side="right")
        count += pieces
    return np.unique(label, return_inverse=True)[1]


def folds_of(rows: SegmentedRuns, count: int) -> NDArray[np.intp]:
    """(M,) folds by phase, so many at most."""
    return np.unique(stretches(rows, count)[0], return_inverse=True)[1]


def stretches(
    rows: SegmentedRuns, count: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(M,) folds, each one stretch of every motion's clock; and (M,) labels of stretch
    and motion. A run's clock is that of its longest segment."""
    runs = dict.fromkeys(s.run for s in rows.segments)
    longest = [
        max((s for s in rows.segments if s.run == r), key=lambda s: len(s.t))
        for r in runs
    ]
    clocks = motion_clocks([(s.t_dense, s.q_dense) for s in longest])
    fold, motion = np.zeros((2, len(rows.t)), np.intp)
    for run, clock in zip(runs, clocks, strict=True):
        mine = rows.run == run
        fold[mine] = PhaseFolds((clock,), count).fold(0, rows.t[mine])
        motion[mine] = clock.motion
    return fold, np.unique(motion * count + fold, return_inverse=True)[1]
