"""How well one arm explains a repaired log: the one score by which all hypotheses are
compared.

With S_j the squared residual of joint j's torque under one theta for all joints, each
joint with noise of its own, the Gaussian log-likelihood is, up to constants,

    L = -M/2 sum_j log(S_j / |tau_j|^2),

M the number of independent samples. It is free of units and gains. Own columns
(friction, rotor, offset) are projected out of each joint's normal equations, which add:
of parts of a log, and of several logs. The prior odds of a transform are not in L: the race
adds them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, wraps
from typing import Any, TypeVar

import numpy as np

from sdp_vs_penalty.data.stretches.gaps import recorded_seconds
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.race.arm_fit import ArmFit, RepairedRows, orthonormal
from sdp_vs_penalty.race.chain import LogEvent, LogTransform, Order
from sdp_vs_penalty.race.constants import PARTS
from sdp_vs_penalty.race.rows import RegressionData, on_robot
from sdp_vs_penalty.regression.normal_equations import (
    FLOOR,
    NormalEquations,
    positive,
    solve,
)
from sdp_vs_penalty.robot.arrays import Array, Indices
from sdp_vs_penalty.signals.filtered import joined

#: Up to so many rows the columns of all transforms that a search proposes stay in memory:
#: the next round of the search proposes them again.
FEW_ROWS = 128
#: Rows of several repaired motions that are computed at a time.
ROWS_AT_A_TIME = 2000
T = TypeVar("T")


def keep_recent(results: dict[Any, T], key: Any, result: T, size: int) -> T:
    """Store a result as the latest one and return it; only the ``size`` latest are
    kept."""
    results.pop(key, None)
    results[key] = result
    if len(results) > size:
        del results[next(iter(results))]
    return result


def recent(
    size: int, depends_on: Callable[..., Any] | None = None
) -> Callable[[Callable[..., T]], Callable[..., T]]:
    """Return a decorator that caches a method's last ``size`` results in its object, so
    that they are freed with it: rows are large.

    Parameters
    ----------
    depends_on : callable, optional
        Maps the argument to the part of it that the result depends on: the cache's key,
        and what the method is called with. Default: all arguments.
    """

    def decorate(method: Callable[..., T]) -> Callable[..., T]:
        @wraps(method)
        def cached(self: Any, *arguments: Any) -> T:
            results = self.__dict__.setdefault(f"_last_{method.__name__}", {})
            key = arguments if depends_on is None else (depends_on(*arguments),)
            result = results[key] if key in results else method(self, *key)
            return keep_recent(results, key, result, size)

        return cached

    return decorate


class Likelihood:
    """Fit arms to the rows of one log under any transform, of M rows and n joints.

    "Shared" columns belong to parameters that joints share (links); "own" columns to
    one joint (friction, rotor, offset).
    """

    def __init__(self, problem: Problem, data: RegressionData) -> None:
        """Prepare fits of arms to the rows ``data`` of one log; nothing is computed
        yet.

        Every cached function here takes the part of a transform that its result depends
        on, so that transforms that differ elsewhere share it.
        """
        self.problem = problem
        self.data = data
        self.n = len(data.moving)
        self.moving = data.moving
        self.joints: list[int] = np.flatnonzero(self.moving).tolist()
        kinds = [joint.kind for joint in problem.robot.joints]
        self.revolute = [j for j in self.joints if kinds[j] == "revolute"]
        self.as_logged = LogTransform.unchanged(self.n, problem.robot.gravity)
        # About as many as one round of a search proposes; fewer where rows are many.
        self.n_kept = 128 if data.count <= FEW_ROWS else 12
        #: The columns used last, by transform and whether the arm stands still.
        self._kept_columns: dict[tuple[LogTransform, bool], Array] = {}

    @classmethod
    def of_all_runs(cls, logs: Sequence[Likelihood]) -> Likelihood:
        """Return one likelihood of several runs of one robot, their rows put one after
        the other.

        Parameters
        ----------
        logs : sequence of Likelihood
            One a run; all of one robot and one logger.

        Returns
        -------
        Likelihood
            Of all rows, thinned to as many as one log has; of a single run the run's
            likelihood itself.
        """
        if len(logs) == 1:
            return logs[0]
        data = RegressionData.concatenate([log.data for log in logs])
        return cls(logs[0].problem, data)

    @cached_property
    def with_all_laws(self) -> Likelihood:
        """The likelihood of the same rows with a richer model of each joint.

        It has more columns of each joint alone, for laws that an arm may have: springs,
        drag, hysteresis, friction that grows with load. What these explain is no fault
        of the log.
        """
        torque = self.nominal(self.as_logged)
        return Likelihood(self.problem, self.data.with_laws(torque))

    def torque_unit(self, j: int) -> str:
        """Return the unit of joint j's torque in words: "N m"."""
        return plain_unit(self.problem.robot.torque_units[j])

    def select_rows(self, rows: slice | Indices) -> Likelihood:
        """Return the likelihood of some of the rows."""
        return Likelihood(self.problem, self.data.select_rows(rows))

    @cached_property
    def spare_share(self) -> float:
        """Degrees of freedom as a share of the log's independent samples,
        1 - parameters / samples; negative where the arm has more parameters than samples.

        A torque behind a low-pass of f Hz has 2 f independent samples a second.
        """
        seconds = recorded_seconds(self.data.motion.t)
        n_samples = 2.0 * self.data.cutoff * seconds * len(self.joints)
        n_shared = len(self.fit(self.as_logged).theta)
        n_parameters = n_shared + self.n * self.data.own_columns.shape[2]
        return 1.0 - n_parameters / max(n_samples, 1.0)

    # -- torques and motion as repaired

    def channels(self, transform: LogTransform) -> Array:
        """Return the joints' torques (n, M) as repaired [N m or N]; 0 where they are not
        used (see :meth:`torque_mask`)."""
        return self.torques(transform) * self.torque_mask(transform)

    def torques(self, transform: LogTransform) -> Array:
        """Return the joints' torques (n, M) as repaired, also where a joint does not
        slide [N m or N]; see :meth:`channels`.
        """
        order = list(transform.tau_order)
        if not transform.changes_shape:
            # Most transforms leave time and shape of the channels as they are.
            return transform.torques(self.channels_at(0.0)[0].T[order])
        pairs = [self.channels_at(lead) for lead in transform.lead]
        of_joints = [
            (x[:, k], rate[:, k]) for k, (x, rate) in zip(order, pairs, strict=True)
        ]
        channels, rates = np.array(of_joints).swapaxes(0, 1)
        return transform.torques(channels, rates, self.data.largest[order])

    def torque_mask(self, transform: LogTransform) -> Array:
        """Return which torques are used, (n, M): 1 where the joint slides, and 0
        elsewhere. Which joint slides depends on the transform's order of position channels.

        A joint at rest is held by dry friction, which may have any value up to its
        size: its torque tells nothing of the arm.
        """
        return self.data.torque_mask.T[list(transform.order)]

    @recent(40)
    def channels_at(self, lead: float) -> tuple[Array, Array]:
        """Return all torque channels (M, n) and their time derivatives (M, n), ``lead``
        seconds after each row; instants beyond the log are moved to its ends.
        """
        torque = self.data.torque
        instants = np.clip(self.data.motion.t + lead, torque.x[0], torque.x[-1])
        return torque(instants), torque(instants, 1)

    def motion(self, transform: LogTransform, is_still: bool = False) -> Motion:
        """Return the repaired motion of M rows, for the columns of an arm.

        q_j = scale_j raw_order[j] + zero_j, and time runs ``rate`` times as fast as in
        the file, so that velocities are divided by rate and accelerations by rate^2.

        Parameters
        ----------
        transform : LogTransform
            How the log is repaired.
        is_still : bool
            Whether the arm stands still at each row: its torque is then its weight.

        Returns
        -------
        Motion
            Positions, velocities, accelerations (M, n).
        """
        logged = self.data.motion
        order = list(transform.order)
        # Velocities and accelerations of an arm that stands still are 0.
        scale = (not is_still) * transform.position_factors
        return Motion(
            logged.t[0] + transform.rate * (logged.t - logged.t[0]),
            transform.positions(logged.q),
            transform.of_joints(scale * logged.dq[:, order] / transform.rate),
            transform.of_joints(scale * logged.ddq[:, order] / transform.rate**2),
        )

    # -- columns

    @recent(6, depends_on=lambda transform: transform.motion_part)
    def rows(self, transform: LogTransform) -> RepairedRows:
        """Return the columns of an arm's parameters in the rows that it is fitted to.

        They do not depend on what the transform does to torque channels, so that transforms
        of the same motion share one cached result.

        Parameters
        ----------
        transform : LogTransform
            How the log is repaired.

        Returns
        -------
        RepairedRows
            Columns of the shared parameters, and a basis of each joint's own columns.
        """
        return RepairedRows.from_basis(self.basis(transform), self.raw(transform))

    def basis(self, transform: LogTransform) -> Array:
        """Return an orthonormal basis (n, M, k) of each joint's own columns under a
        transform: friction, rotor inertia, offset, and events of the log."""
        return self._basis(transform.order, transform.events)

    @recent(
        6, depends_on=lambda transform: transform.motion_part.with_defaults("events")
    )
    def raw(self, transform: LogTransform) -> Array:
        """Return the columns (n, M, s) of the s parameters that joints share (of the
        links).

        Columns of single joints (friction, offset) are not projected out. Entries are 0
        where a joint's torque is not used. If a controller has taken a share of the
        weight out of the measured torque, that share of the weight's columns is taken
        out as well.

        Parameters
        ----------
        transform : LogTransform
            How the log is repaired.

        Returns
        -------
        (n, M, s) array
            Torque per unit of each parameter.
        """
        columns = self.shared(transform)
        if any(transform.missing_weight):
            weight = self.shared(transform, is_still=True)
            columns = (
                columns - np.array(transform.missing_weight)[:, None, None] * weight
            )
        return columns * self.torque_mask(transform)[:, :, None]

    @recent(12)
    def _model(self, gravity: tuple[float, ...]) -> Model | None:
        """Return the model of the links under a gravity of the base frame [m/s^2]; None if
        the problem's model has no parameters that joints share."""
        if self.data.shared is None:
            return None
        return on_robot(self.data.shared, replace(self.problem.robot, gravity=gravity))

    def columns(self, transform: LogTransform, is_still: bool = False) -> Array:
        """Return the columns (n, M, p) of all p parameters of the links, linearly
        dependent ones too: combinations of the independent ones, see :meth:`shared`."""
        return self.shared(transform, is_still) @ self.data.dependence

    def shared(self, transform: LogTransform, is_still: bool = False) -> Array:
        """Return the columns (n, M, s) of s linearly independent parameters of the
        links, which span the same torques as those of all.

        Parameters
        ----------
        transform : LogTransform
            How the log is repaired; only its :attr:`~LogTransform.arm_part` counts.
        is_still : bool
            Whether they are of the weight alone.

        Returns
        -------
        (n, M, s) array
            Torque per unit of each parameter; s is 0 where joints share none.
        """
        key = transform.arm_part, is_still
        columns = self._kept_columns.get(key)
        if columns is None:
            columns = self._make_columns([transform.arm_part], is_still)[0]
        return keep_recent(self._kept_columns, key, columns, self.n_kept)

    def _make_columns(
        self, transforms: Sequence[LogTransform], is_still: bool = False
    ) -> list[Array]:
        """Make the columns (n, M, s) of the links' independent parameters under each of
        several transforms, as torques of the logged motors.

        The transforms must have the same gravity: one model makes all columns, from the
        rows of all repaired motions one after the other.
        """
        model = self._model(transforms[0].gravity)
        if model is None:
            return [np.zeros((self.n, self.data.count, 0)) for _ in transforms]
        motions = [self.motion(transform, is_still) for transform in transforms]
        rows = motions[0] if len(motions) == 1 else joined(motions)
        of_all = model.dense_columns(rows, self.data.independent)
        columns = np.split(of_all, len(transforms), axis=1)
        for k, transform in enumerate(transforms):
            a = transform.joints_by_motors
            if a is not None:  # torques of motors: A^T tau
                columns[k] = np.tensordot(a.T, columns[k], 1)
        return columns

    def prepare_columns(self, transforms: Sequence[LogTransform]) -> None:
        """Cache the links' columns of the moving arm under several transforms, so that
        :meth:`shared` finds them.

        Repairs under the same gravity are computed together: one model evaluates the rows
        of many motions faster than those of one motion after another.
        """
        uncached_by_gravity: dict[tuple[float, ...], list[LogTransform]] = {}
        for arm_part in dict.fromkeys(transform.arm_part for transform in transforms):
            if (arm_part, False) not in self._kept_columns:
                of_gravity = uncached_by_gravity.setdefault(arm_part.gravity, [])
                of_gravity.append(arm_part)
        n_at_a_time = max(1, ROWS_AT_A_TIME // self.data.count)
        for gravity, arm_parts in uncached_by_gravity.items():
            model = self._model(gravity)
            if model is None:
                continue  # no columns to compute
            # The torque of an effect with memory depends on the rows before: motions
            # must not follow each other as rows of one. shared() makes each by itself.
            if any(effect.has_memory for effect in model.effects):
                continue
            for first in range(0, len(arm_parts), n_at_a_time):
                batch = arm_parts[first : first + n_at_a_time]
                made_columns = self._make_columns(batch)
                for arm_part, columns in zip(batch, made_columns, strict=True):
                    key = arm_part, False
                    keep_recent(self._kept_columns, key, columns, self.n_kept)

    def nominal(self, transform: LogTransform, is_still: bool = False) -> Array:
        """Return the torque (M, n) of the problem's nominal links on the repaired
        motion [N m or N]; their full weight if the arm is still.

        The nominal links stand for a plausible arm. Weight that a controller has taken
        out of the torques is left out, unless the arm is still.
        """
        model = self.data.shared
        rigid = np.arange(0) if model is None else model.rigid_indices
        columns = self.columns(transform, is_still)[:, :, rigid]
        links = self.problem.prior_links.ravel()[: len(rigid)]
        torque = np.asarray((columns @ links).T, float)
        if not is_still and any(transform.missing_weight):
            torque = torque - np.array(transform.missing_weight) * self.nominal(
                transform, True
            )
        return torque

    @recent(20)
    def _basis(self, order: Order, events: tuple[LogEvent, ...]) -> Array:
        """Make an orthonormal basis (n, M, k) of each joint's own columns.

        These are friction, rotor inertia, offset, and events of the log, 0 where the
        torque is not used. A joint with fewer than k independent columns has zeros in
        place of the missing vectors.

        Parameters
        ----------
        order : tuple of int
            Position channel that each joint takes.
        events : tuple of LogEvent
            Events of the log's torques.
        """
        # The columns are made of position channels, and go with them to the joints.
        basis = self._basis_of_channels[list(order)]
        if not events:
            return basis
        columns = [self.data.own_columns[list(order)]]
        columns += [self._columns_of_event(event) for event in events]
        used = np.concatenate(columns, axis=2)
        used = used * self.data.torque_mask.T[list(order)][:, :, None]
        # Joints without an event keep their basis. A basis has no more vectors than rows.
        n_vectors = min(used.shape[1:])
        with_events = np.zeros((*used.shape[:2], n_vectors))
        with_events[:, :, : basis.shape[2]] = basis
        joints = sorted({event.joint for event in events})
        with_events[joints] = orthonormal(used[joints])
        return with_events

    @cached_property
    def _basis_of_channels(self) -> Array:
        """An orthonormal basis (n, M, k) of the own columns that each position channel
        makes, without events."""
        return orthonormal(self.data.own_columns * self.data.torque_mask.T[:, :, None])

    def _columns_of_event(self, event: LogEvent) -> Array:
        """Return the column (n, M, 1) of an event of one joint's torque, a step or a
        drift; 0 for other joints."""
        is_joint = np.arange(self.n)[:, None] == event.joint
        shape = event.shape(self.data.motion.t)[None]
        return shape * is_joint[:, :, None]

    def unexplained(self, transform: LogTransform, theta: Array) -> Array:
        """Return the torque (n, M) that the links of an arm, theta (s,), do not
        explain, tau - Y theta [N m or N].

        It still holds the friction, rotor inertia and offset of each joint.
        """
        return self.channels(transform) - self.raw(transform) @ theta

    # -- fits

    @recent(8)
    def fit(self, transform: LogTransform) -> ArmFit:
        """Fit the arm of the largest likelihood to the log under a transform.

        Each joint's own parameters (friction, offset) are eliminated: their columns are
        projected out of the shared columns and of the torque.
        """
        rows, torque = self.rows(transform), self.channels(transform)
        beside_own = rows.project_out_own(torque[:, :, None])[:, :, 0]
        equations = NormalEquations(
            gram=rows.gram,
            cross=(torque[:, None, :] @ rows.projected)[:, 0],
            energy=np.sum(beside_own**2, axis=1),
            total=positive(np.sum(torque**2, axis=1)),
        )
        theta, left = equations.fitted(self.moving)
        return ArmFit(self.moving, rows, torque, theta, left, equations.total)

    def shares_left_by_own_models(self, transform: LogTransform) -> Array:
        """Return the share (n,) of each torque's energy that the joint's own model
        leaves, on parts of the log that the model was not fitted to.

        Each joint is fitted by itself, with all parameters of the arm. This shows how
        well its torque can be explained at all, whatever the other joints say.

        Parameters
        ----------
        transform : LogTransform
            How the log is repaired.

        Returns
        -------
        (n,) array
            Shares of the squared torque, at least FLOOR [-].
        """
        rows = self.rows(transform)
        torque = self.channels(transform)[:, :, None]
        columns = np.concatenate([rows.basis, rows.raw, torque], axis=2)
        by_part = np.array_split(columns, PARTS, axis=1)
        parts = np.stack([part.swapaxes(1, 2) @ part for part in by_part])
        n_own = rows.basis.shape[2]
        other_parts = NormalEquations.eliminating(parts.sum(axis=0) - parts, n_own)
        models = solve(other_parts.gram, other_parts.cross[..., None])[..., 0]
        energy_left = other_parts.left_of(parts, models).sum(axis=0)
        energy = positive(parts[..., -1, -1].sum(axis=0))
        return np.maximum(energy_left / energy, FLOOR)
