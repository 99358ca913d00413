"""White rows: the log's rows weighted so that their noise is independent with variance
1, with the model's own columns on them, and clusters of rows that err together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.constants import CLUSTERS, FORGETS
from sdp_vs_penalty.effects.effect import Effect, Motion
from sdp_vs_penalty.effects.model import depends
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.sensitivity import ShapeSensitivity, sensitivities
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask
from sdp_vs_penalty.signals.noise import RESIDUAL, Noise, noise_of, rate_features
from sdp_vs_penalty.signals.phases import PhaseFolds, motion_clocks
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.segments import Segment, SegmentedRuns, segmented


def diagnosis_rows(
    measurements: Measurements, estimate: Estimate, settings: Preprocessing
) -> SegmentedRuns:
    """Filter all runs and attach a model to them.

    Parameters
    ----------
    estimate
        The model. Columns of effects that need joint torque or links (a gain, load
        friction) are computed from it.
    settings
        Filters, resolved for these measurements (:meth:`Preprocessing.resolve`).

    Raises
    ------
    InputError
        No run is long enough for the filters.
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
    """Attach a model to filtered runs, from which torque-dependent columns follow.

    Columns of effects that need joint torque or links (a gain, a delay, load friction)
    are computed from the model and the motion.

    Parameters
    ----------
    other_effects
        Effects in addition to the model, each with its parameters (k,). Their torque is
        added to the model's, through the gains of the torque channels.

    Returns
    -------
    SegmentedRuns
        The same rows with that model.
    """
    model = estimate.model

    def add_torque_of_others(motion: Motion) -> Motion:
        """Add the torque of ``other_effects`` to the model's torque in a motion."""
        if not other_effects:
            return motion
        torque_of_others = sum(e.torque(theta, motion) for e, theta in other_effects)
        gains = np.array(model.gains or (1.0,))  # no gains: all are 1
        return motion.with_torque(motion.model_torque + torque_of_others * gains)

    # Adds the model's torque and links to a motion.
    attach = partial(model.seen_along, estimate.theta)
    return runs.with_model(attach, add_torque_of_others, model.gains)


#: What errors of an effect's free shape constants make of torque, white.
ConstantErrors = tuple[ShapeSensitivity, dict[int, Array]]


@dataclass(frozen=True)
class WhiteData:
    """White rows: weighted so that each joint's noise is independent with variance 1."""

    #: The filtered rows before weighting.
    rows: SegmentedRuns
    #: The noise of each joint.
    noise: Noise
    #: The model.
    estimate: Estimate
    #: (n joints, M rows, p) white columns of the model's parameters; none if the model
    #: is held fixed.
    X: Array
    #: (n, M) white torque; if the model is held fixed, the white residual of the model.
    y: Array
    #: Labels (M,) of rows that err together, by time and by phase of the motion.
    clusters: tuple[Indices, ...]
    #: (n,) number of rows that carry information.
    count: Array
    #: Whether the model is held fixed.
    frozen: bool

    @property
    def n(self) -> int:
        """The number of joints."""
        return self.rows.n

    @property
    def noise_is_known(self) -> bool:
        """Whether the noise was measured; if not, it is the model's own residual."""
        return self.noise.source != RESIDUAL

    def has_columns_of(self, estimate: Estimate, noise: Noise, frozen: bool) -> bool:
        """Return whether another estimate has the same white columns on these rows.

        That is so where the effects of both models are the same, and follow from the
        motion alone. ``frozen`` : whether the other model is held fixed.
        """
        if frozen or self.frozen or noise is not self.noise:
            return False
        model = self.estimate.model
        other = estimate.model
        if model.gains != other.gains or model.sign_width != other.sign_width:
            return False
        if len(model.effects) != len(other.effects) or model.known != other.known:
            return False
        return all(
            a.same_columns(b) and not depends(a)
            for a, b in zip(model.effects, other.effects, strict=True)
        )

    @cached_property
    def own_effects(self) -> dict[tuple[str, int], tuple[Effect, int]]:
        """The model's own effects that have a shape constant to estimate again, such as
        the velocity of Coulomb friction's sign.

        By (name, joint from 0): the effect on that joint alone, and the number of its
        column in X. An effect with several columns a joint is left out, since one
        number cannot name them; a model that is held fixed has none.
        """
        if self.frozen:
            return {}
        out = dict[tuple[str, int], tuple[Effect, int]]()
        for effect, columns in self.estimate.model.parts:
            if not effect.estimated or len(columns) != len(effect.joints):
                continue
            for joint, column in zip(effect.joints, columns, strict=True):
                on_joint = effect.with_shape([joint])
                out[effect.name, joint] = on_joint, int(column)
        return out

    @cached_property
    def signed_effects(self) -> dict[tuple[str, int], int]:
        """The numbers of the columns in X whose parameter must not be negative, of the
        model's effects with one column a joint, by (name, joint from 0); none if the
        model is held fixed.
        """
        if self.frozen:
            return {}
        parameters = self.estimate.model.parameters
        out = dict[tuple[str, int], int]()
        for effect, columns in self.estimate.model.parts:
            if len(columns) == len(effect.joints):
                for joint, column in zip(effect.joints, columns.tolist(), strict=True):
                    if parameters[column].lower == 0.0:
                        out[effect.name, joint] = column
        return out

    @cached_property
    def rates(self) -> Array:
        """(n, M, 2) squared rates of torque and velocity, with which errors of timing
        grow (:func:`~sdp_vs_penalty.signals.noise.rate_features`).
        """
        return rate_features(self.rows)

    def constant_error_columns(
        self, effects: Sequence[Effect] = (), thetas: Sequence[Array] = ()
    ) -> list[ConstantErrors]:
        """Return white derivatives of torque by the shape constants of effects.

        They are the torque that an error of a constant causes, to first order. Such
        errors matter for sizes: friction that reverses over another velocity, for
        example, looks like friction of another size.

        Parameters
        ----------
        effects
            Effects in addition to the model. The model's own effects are appended,
            unless it is held fixed.
        thetas
            Parameters (k,) of each of ``effects``.

        Returns
        -------
        list of (ShapeSensitivity, dict)
            For each effect with free constants: the derivatives of its torque by these,
            and their white columns, (M, constants) by joint.
        """
        model = self.estimate.model
        if not self.frozen:
            thetas_of_model = [self.estimate.theta[k] for k in model.indices]
            effects = [*effects, *model.effects]
            thetas = [*thetas, *thetas_of_model]
        derivatives = sensitivities(effects, thetas)
        return [(d, self.columns(d)) for d in derivatives]

    @property
    def raw(self) -> Array:
        """(n, M, p) the model's own filtered columns, not whitened; put together at each
        call."""
        return model_columns(self.rows, self.estimate, self.frozen)

    def white(self, columns: Array, joint: int) -> Array:
        """Weight columns (M, ...) of one joint's torque so that their noise is white.

        White noise is independent from row to row, with variance 1; ``joint`` counts
        from 0.
        """
        return self.noise.whiten(columns, joint, self.rows.pieces[joint])

    def columns(self, effect: Effect) -> dict[int, Array]:
        """Return an effect's white columns, (M, k) by joint (from 0) that it acts on."""
        columns_of_joints = spread_columns(self.rows, effect)
        return {
            b.joint: self.white(columns_of_joints[b.joint], b.joint)
            for b in self.rows.blocks(effect)
        }


def whiten_rows(
    rows: SegmentedRuns,
    estimate: Estimate,
    frozen: bool = False,
    noise_rows: SegmentedRuns | None = None,
) -> WhiteData:
    """Measure the noise of filtered rows, and make white rows of them.

    White rows are weighted so that their noise is independent with variance 1. Two
    kinds of rows are masked: those at the begin of a log, where friction still depends
    on the motion before, and those in which repetitions of the motion disagree.

    Parameters
    ----------
    estimate
        The model whose columns are whitened too.
    frozen
        True: the model is held fixed, and only what it leaves is explained.
    noise_rows
        Rows in which the noise is measured; default: ``rows``.

    Returns
    -------
    WhiteData
        White rows with the model's columns.
    """
    noise = noise_of(rows, noise_rows)
    masked = noise.suspect | mask_unsettled_rows(rows)
    if masked.any():
        rows = replace(rows, masked=masked)
    return whiten_with_noise(rows, noise, estimate, frozen)


def mask_unsettled_rows(rows: SegmentedRuns) -> Mask:
    """Return (M, n) flags of rows in which friction may depend on the time before.

    Friction with a memory forgets its initial state over a travel of FORGETS (0.03 rad
    or m). Rows of a segment are flagged until the joint has travelled as far; a joint
    that never does has no rows flagged.
    """
    out = []
    for segment in rows.segments:
        q = segment.motion.q
        steps = np.abs(np.diff(q, axis=0, prepend=q[:1]))
        travel = np.cumsum(steps, axis=0)
        out.append(travel[segment.low_pass.at] < FORGETS)
    is_unsettled = np.concatenate(out)
    never_settles = is_unsettled.all(axis=0)
    return is_unsettled & ~never_settles


def whiten_with_noise(
    rows: SegmentedRuns,
    noise: Noise,
    estimate: Estimate,
    frozen: bool,
    like: WhiteData | None = None,
) -> WhiteData:
    """Weight filtered rows with a known noise, so that it is independent, variance 1.

    Parameters
    ----------
    noise
        The noise of each joint.
    estimate
        The model whose columns are weighted too.
    frozen
        True: the model is held fixed, and the torque is what it leaves unexplained.
    like
        The same rows with another estimate. Where its white columns are those of this
        one, they are used again.
    """
    if like is not None and like.has_columns_of(estimate, noise, frozen):
        return replace(like, rows=rows, estimate=estimate)
    torque = rows.residual if frozen else rows.torque
    columns = model_columns(rows, estimate, frozen)
    if not frozen and estimate.model.known_values:
        # What is known is not fitted: its torque is no part of the rows.
        known = list(estimate.model.known_values)
        torque = torque - (columns[:, :, known] @ estimate.theta[known]).T
        columns[:, :, known] = 0.0
    X, y = (white_rows(rows, noise, x) for x in (columns, torque.T))
    # An error of the model recurs whenever the motion repeats.
    _, phase_clusters = phase_stretches(rows, CLUSTERS)
    # The first rows of each piece only serve to whiten the next ones. Each other row
    # counts by its worth (0 to 1): less where the joint stands still.
    count = np.array(
        [noise.worth[rows.pieces[j].predicted, j].sum() for j in range(rows.n)]
    )
    return WhiteData(
        rows=rows,
        noise=noise,
        estimate=estimate,
        X=X,
        y=y,
        clusters=(time_clusters(rows), phase_clusters),
        count=count,
        frozen=frozen,
    )


def white_rows(rows: SegmentedRuns, noise: Noise, values: Array) -> Array:
    """Weight columns (n, M, p) or torques (n, M) of n joints so that each joint's noise is
    white: independent from row to row, with variance 1."""
    return np.stack([noise.whiten(x, j, rows.pieces[j]) for j, x in enumerate(values)])


def spread_columns(rows: SegmentedRuns, effect: Effect) -> Array:
    """Return an effect's filtered columns of torque as one array (n joints, M rows, k).

    Column i is the torque of a unit of the effect's parameter i; it is zero on joints
    on which that parameter does not act.
    """
    out = np.zeros((rows.n, len(rows.t), len(effect.parameters)))
    for block in rows.blocks(effect):
        # block.parameters: which of the k parameters act on this joint.
        out[block.joint][:, block.parameters] = block.columns
    return out


def model_columns(
    rows: SegmentedRuns, estimate: Estimate, frozen: bool = False
) -> Array:
    """Return the filtered columns (n joints, M rows, p) of the model's parameters.

    Column i is the torque of a unit of parameter i. p is 0 if the model is held fixed
    (``frozen``): it has no parameters to fit.
    """
    if frozen:
        return np.zeros((rows.n, len(rows.t), 0))
    return np.concatenate(
        [spread_columns(rows, e) for e in estimate.model.effects], axis=2
    )


def time_clusters(rows: SegmentedRuns) -> Indices:
    """Label the rows (M,) by intervals of equal duration within each run.

    There are about CLUSTERS (50) intervals, each at least half a second long. Labels
    count from 0 over all runs.
    """
    t_by_run = {r: rows.t[rows.run == r] for r in np.unique(rows.run)}
    seconds = sum(np.ptp(t) for t in t_by_run.values())
    duration = max(0.5, seconds / CLUSTERS)
    label = np.zeros(len(rows.t), np.intp)
    n_before = 0  # intervals of the runs before
    for run, t in t_by_run.items():
        n_intervals = max(1, round(np.ptp(t) / duration))
        inner_edges = np.linspace(t[0], t[-1], n_intervals + 1)[1:-1]
        interval = np.searchsorted(inner_edges, t, side="right")
        label[rows.run == run] = n_before + interval
        n_before += n_intervals
    return np.unique(label, return_inverse=True)[1]  # numbered without gaps


def folds_of(rows: SegmentedRuns, count: int) -> Indices:
    """Number the rows (M,) by folds of the motion's phase, from 0.

    There are at most ``count`` folds; each is the same phase interval in all motions.
    Empty folds are left out of the numbering.
    """
    return np.unique(phase_stretches(rows, count)[0], return_inverse=True)[1]


def phase_stretches(rows: SegmentedRuns, count: int) -> tuple[Indices, Indices]:
    """Divide the phase of each motion into ``count`` intervals.

    The phase tells where a repeated motion is in its cycle; that of a run is computed
    from its longest segment.

    Returns
    -------
    (M,) array
        The interval of each row, from 0: a fold is the same phase in all motions.
    (M,) array
        A label of interval and motion together, from 0 without gaps.
    """
    longest = dict[int, Segment]()  # by run
    for segment in rows.segments:
        longest_so_far = longest.setdefault(segment.run, segment)
        if len(segment.t) > len(longest_so_far.t):
            longest[segment.run] = segment
    clocks = motion_clocks([(s.t_dense, s.q_dense) for s in longest.values()])
    fold = np.zeros(len(rows.t), np.intp)
    motion = np.zeros(len(rows.t), np.intp)  # runs of one motion have one number
    for run, clock in zip(longest, clocks, strict=True):
        in_run = rows.run == run
        fold[in_run] = PhaseFolds((clock,), count).fold(0, rows.t[in_run])
        motion[in_run] = clock.motion
    fold_and_motion = motion * count + fold
    labels = np.unique(fold_and_motion, return_inverse=True)[1]  # without gaps
    return fold, labels
