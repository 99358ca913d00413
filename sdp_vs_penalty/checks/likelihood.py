"""How well one arm explains a repaired log: the one score by which all hypotheses are
compared.

With S_j the squared residual of joint j's torque under one theta for all joints, each
joint with noise of its own, the Gaussian log-likelihood is, up to constants,

    L = -M/2 sum_j log(S_j / |tau_j|^2),

M the number of independent samples. It is free of units and gains. Own columns
(friction, rotor, offset) are projected out of each joint's normal equations, which add:
of parts of a log, and of several logs. The prior costs of a repair are the search's
matter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import TypeAlias

import numpy as np
import scipy

from sdp_vs_penalty.checks.arm_fit import ArmFit, RepairedRows
from sdp_vs_penalty.checks.constants import LOUDEST, LOUDEST_INERTIA, PARTS
from sdp_vs_penalty.checks.regression_data import RegressionData, on_robot
from sdp_vs_penalty.checks.repair import LogEvent, LogTransform, Numbers, Order
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.normal_equations import (
    FLOOR,
    RIDGE,
    Normal,
    NormalEquations,
    jackknifed,
    positive,
    solve,
    standard_errors_above_zero,
)
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one

#: Up to so many rows the columns of all repairs that a search proposes are kept: the
#: next round proposes them again.
FEW_ROWS = 128
#: A repair by one number.
At: TypeAlias = Callable[[float], LogTransform]


class Likelihood:
    """Of one problem and one log's rows; what depends on a part of a repair is kept for
    repairs of the rest."""

    def __init__(self, problem: Problem, data: RegressionData) -> None:
        self.problem = problem
        self.data = data
        self.n = len(data.moving)
        self.moving = data.moving
        self.joints: list[int] = np.flatnonzero(self.moving).tolist()
        kinds = [joint.kind for joint in problem.robot.joints]
        self.revolute = [j for j in self.joints if kinds[j] == "revolute"]
        self.as_logged = LogTransform.unchanged(self.n, problem.robot.gravity)
        self.columns = lru_cache(128 if data.count <= FEW_ROWS else 12)(
            self._make_columns
        )
        self._rows = lru_cache(6)(self._make_rows)
        self._raw = lru_cache(6)(self._make_raw)
        self._model = lru_cache(12)(self._make_model)
        self._basis = lru_cache(20)(self._make_basis)
        self._inertia_and_weight = lru_cache(12)(self._make_inertia_and_weight)
        self._channels_at = lru_cache(40)(self._interpolate_channels)

    @classmethod
    def together(cls, logs: Sequence[Likelihood]) -> Likelihood:
        """Of the rows of several logs of one problem, as one log; a single one itself."""
        if len(logs) == 1:
            return logs[0]
        return cls(logs[0].problem, RegressionData.together([x.data for x in logs]))

    @cached_property
    def beside_physics(self) -> Likelihood:
        """With all laws of a joint's own motion that an arm may have as own columns:
        what these explain is no fault of the log."""
        return Likelihood(
            self.problem, self.data.with_laws(self.nominal(self.as_logged))
        )

    @cached_property
    def screen(self) -> Likelihood:
        """Of fewer rows: enough to see which hypotheses are worth a closer look."""
        return self.some(slice(None, None, 3))

    def some(self, rows: slice) -> Likelihood:
        """Of some of the rows."""
        return Likelihood(self.problem, self.data.some(rows))

    @cached_property
    def spare(self) -> float:
        """Share of the log's independent samples that are more than one arm has
        parameters."""
        seconds = float(np.ptp(self.data.motion.t))
        n_samples = 2.0 * self.data.cutoff * seconds * len(self.joints)
        n_shared = len(self.score(self.as_logged).theta)
        n_parameters = n_shared + self.n * self.data.own_columns.shape[2]
        return 1.0 - n_parameters / max(n_samples, 1.0)

    # -- torques and motion as repaired

    def channels(self, repair: LogTransform) -> Array:
        """(n, M) the torque as repaired, 0 where it is not asked for."""
        if not any((*repair.lead, *repair.lag, *repair.bend)):
            # As most repairs, which leave time and shape of the channels alone.
            values = self._channels_at(0.0)[0].T[list(repair.tau_order)]
            return np.array(repair.gain)[:, None] * values * self.filter_gain(repair)
        out = np.empty((self.n, self.data.count))
        for j, k in enumerate(repair.tau_order):
            values, rates = self._channels_at(repair.lead[j])
            value = values[:, k]
            if repair.bend[j]:
                # A dead channel has no limit.
                limit = max(float(self.data.largest[k]) / repair.bend[j], 1e-300)
                value = limit * np.arctanh(np.clip(value / limit, -0.999, 0.999))
            out[j] = repair.gain[j] * (value + repair.lag[j] * rates[:, k])
        return out * self.filter_gain(repair)

    def filter_gain(self, repair: LogTransform) -> Array:
        """(n, M) 1 where a joint's torque is asked for."""
        return self.data.heard.T[list(repair.order)]

    def _interpolate_channels(self, lead: float) -> tuple[Array, Array]:
        """(M, n) all channels and their rates, so much later [s]."""
        torque = self.data.torque
        instants = np.clip(
            self.data.motion.t + lead,
            torque.x[0],
            torque.x[-1],
        )
        return torque(instants), torque(instants, 1)

    def motion(
        self,
        repair: LogTransform,
        speed: float = 1.0,
        push: float = 1.0,
    ) -> Motion:
        """States as repaired, with so many times their velocity and acceleration."""
        logged = self.data.motion
        order = list(repair.order)
        scale = np.array(repair.scale)
        return Motion(
            logged.t[0] + repair.rate * (logged.t - logged.t[0]),
            repair.positions(logged.q),
            speed * scale * logged.dq[:, order] / repair.rate,
            push * scale * logged.ddq[:, order] / repair.rate**2,
        )

    # -- columns

    def rows(self, repair: LogTransform) -> RepairedRows:
        """What depends on the motion alone."""
        return self._rows(repair.of_motion)

    def _make_rows(self, repair: LogTransform) -> RepairedRows:
        return RepairedRows(self._basis(repair.order, repair.events), self.raw(repair))

    def raw(self, repair: LogTransform) -> Array:
        """(n, M, s) the columns of the parameters that joints share, 0 where torque is
        not asked for."""
        return self._raw(repair.of_motion.reset("events"))

    def _make_raw(self, repair: LogTransform) -> Array:
        columns = self.shared(repair)
        if any(repair.lacks):
            weight = self.shared(repair, 0.0, 0.0)
            columns = columns - np.array(repair.lacks)[:, None, None] * weight
        columns *= self.filter_gain(repair)[:, :, None]
        return columns

    def _make_model(
        self,
        gravity: tuple[float, ...],
        longer: Numbers,
    ) -> Model | None:
        """What joints share, under another gravity, with other distances between joints
        [m]."""
        if self.data.shared is None:
            return None
        joints = list(self.problem.robot.joints)
        for j in np.flatnonzero(longer).tolist():
            placement = joints[j].placement.copy()
            distance = nonzero_or_one(np.linalg.norm(placement[:3, 3]))
            placement[:3, 3] *= 1.0 + longer[j] / distance
            joints[j] = replace(joints[j], placement=placement)
        robot = replace(
            self.problem.robot,
            gravity=gravity,
            joints=tuple(joints),
        )
        return on_robot(self.data.shared, robot)

    def _make_columns(
        self,
        repair: LogTransform,
        speed: float = 1.0,
        push: float = 1.0,
    ) -> Array:
        """(n, M, p) columns of all parameters that joints share, of ``motion``."""
        model = self._model(repair.gravity, repair.longer)
        if model is None:
            return np.zeros((self.n, self.data.count, 0))
        motion = self.motion(repair, speed, push)
        return model.dense_columns(motion)

    def shared(
        self,
        repair: LogTransform,
        speed: float = 1.0,
        push: float = 1.0,
    ) -> Array:
        """(n, M, s) those that say all that the others do."""
        columns = self.columns(repair.of_arm, speed, push)
        return np.take(columns, self.data.independent, axis=2)

    def nominal(self, repair: LogTransform, speed: float = 1.0) -> Array:
        """(M, n) torque of a plausible arm on the repaired motion, of its weight what
        channels hold; where speed is 0, all of its weight."""
        model = self.data.shared
        rigid = np.arange(0) if model is None else model.rigid_indices
        columns = self.columns(repair.of_arm, speed, speed)[:, :, rigid]
        links = self.problem.nominal_links.ravel()[: len(rigid)]
        torque = np.asarray(np.swapaxes(columns @ links, 0, 1), float)
        if speed and any(repair.lacks):
            torque = torque - np.array(repair.lacks) * self.nominal(repair, 0.0)
        return torque

    def _make_basis(
        self,
        order: Order,
        events: tuple[LogEvent, ...],
    ) -> Array:
        """(n, M, k) bases of the joints' own columns, 0 for columns that depend on
        others."""
        columns = [self.data.own_columns[list(order)]]
        columns += [self._columns_of_event(event, order) for event in events]
        full = np.concatenate(columns, axis=2)
        full = full * self.data.heard.T[list(order)][:, :, None]
        full = full / nonzero_or_one(np.linalg.norm(full, axis=1, keepdims=True))
        u, s, _ = np.linalg.svd(full, full_matrices=False)
        is_independent = s > 1e-6 * s.max(axis=1, keepdims=True)
        return np.asarray(u * is_independent[:, None])

    def _columns_of_event(self, event: LogEvent, order: Order) -> Array:
        """(n, M, r) columns of one joint, 0 for the others."""
        if isinstance(event.at, str):
            shape = self.data.laws[event.at][[order[event.joint]]]
        else:
            shape = event.shape(self.data.motion.t)[None]
        is_joint = np.arange(self.n)[:, None] == event.joint
        return np.asarray(shape * is_joint[:, :, None])

    def unexplained(self, repair: LogTransform, theta: Array) -> Array:
        """(n, M) what an arm (s,) leaves of the channels, its joints' own columns
        apart."""
        return np.asarray(self.channels(repair) - self.raw(repair) @ theta)

    # -- fits

    def parts(
        self,
        repair: LogTransform,
        count: int = PARTS,
        more: Array | None = None,
    ) -> tuple[Array, int]:
        """Gram matrices of that many parts of the log, which add.

        more (n, M, r) : further columns that joints share. Returns the matrices
        (count, n, w, w) and how many of their columns are own ones.
        """
        rows = self.rows(repair)
        torque = self.channels(repair)[:, :, None]
        further = torque[:, :, :0] if more is None else more
        full = np.concatenate([rows.basis, rows.raw, further, torque], axis=2)
        edges = np.linspace(0, self.data.count, count + 1).astype(int).tolist()
        parts = [full[:, a:b] for a, b in pairwise(edges)]
        grams = np.stack([np.swapaxes(part, 1, 2) @ part for part in parts])
        return grams, rows.basis.shape[2]

    def scores(self, repairs: Sequence[LogTransform]) -> list[ArmFit]:
        """One arm fitted to each; repairs of the same motion share its rows."""
        by_motion: dict[LogTransform, list[int]] = {}
        for k, repair in enumerate(repairs):
            by_motion.setdefault(repair.of_motion, []).append(k)
        fits: dict[int, ArmFit] = {}
        for numbers in by_motion.values():
            of_motion = self._fits_of_motion([repairs[k] for k in numbers])
            fits.update(zip(numbers, of_motion, strict=True))
        return [fits[k] for k in range(len(repairs))]

    def _fits_of_motion(self, repairs: Sequence[LogTransform]) -> list[ArmFit]:
        """One arm fitted to each of K repairs, which differ in their torques alone."""
        rows = self.rows(repairs[0])
        channels = np.stack([self.channels(repair) for repair in repairs], axis=2)
        left = rows.rest(channels)  # (n, M, K)
        equations = NormalEquations(
            gram=rows.gram,
            cross=(np.swapaxes(channels, 1, 2) @ rows.apart).swapaxes(0, 1),
            energy=np.sum(np.square(left), axis=1).T,
            total=positive(np.sum(np.square(channels), axis=1).T),
        )
        thetas, lefts = equations.fitted(self.moving)
        return [
            ArmFit(
                moving=self.moving,
                rows=rows,
                channels=channels[:, :, k],
                theta=thetas[k],
                left=lefts[k],
                total=equations.total[k],
            )
            for k in range(len(repairs))
        ]

    def score(self, repair: LogTransform) -> ArmFit:
        """One arm fitted to one repair."""
        return self.scores([repair])[0]

    def jackknife_errors(
        self,
        repair: LogTransform,
        weights: Array,
        more: Array | None = None,
        others: Normal | None = None,
    ) -> tuple[Array, Array]:
        """Errors on each part of the log, left out in turn (a delete-a-group jackknife).

        Parameters
        ----------
        weights : (n,) array
            Of the joints.
        more : (n, M, r) array, optional
            Further columns that joints share.
        others : normal equations, optional
            Of other logs, which have no further columns.

        Returns
        -------
        arms : (PARTS, s) array
            The arms of all other parts.
        errors : (PARTS, n) array
            What they leave of the part, over the mean energy of a part.
        """
        parts, n_own = self.parts(repair, PARTS, more)
        rests = NormalEquations.of(parts.sum(axis=0) - parts, n_own)
        gram, cross = rests.normal(weights)
        if others is not None:
            s = len(others[1])
            gram[:, :s, :s] += others[0]
            cross[:, :s] += others[1]
        arms = solve(gram, cross[..., None])[..., 0]
        total = np.maximum(parts[..., -1, -1].sum(axis=0), 1e-280)
        errors = PARTS * rests.left_of(parts, arms[:, None]) / total
        return arms, np.maximum(errors, FLOOR)

    def alone(self, repair: LogTransform) -> Array:
        """(n,) share of each channel that its joint's own model leaves of parts it was
        not fitted to."""
        parts, n_own = self.parts(repair)
        rests = NormalEquations.of(parts.sum(axis=0) - parts, n_own)
        models = solve(rests.gram, rests.cross[..., None])[..., 0]
        left = rests.left_of(parts, models).sum(axis=0)
        return np.maximum(left / positive(parts[..., -1, -1].sum(axis=0)), FLOOR)

    def first_order_steps(
        self,
        now: LogTransform,
        ats: Sequence[At],
        values: Array,
        h: Array,
    ) -> tuple[Array, Array]:
        """By how much each of r numbers of a repair would have to change alone.

        To first order: with A, c the normal equations of the arm and a, b, c_x those of
        d(y - Y theta)/dx,

            change = (c_x - b^T A^-1 c) / (a - b^T A^-1 b).

        The standard deviations are a jackknife's, because what the model lacks varies
        from part to part: noise alone would look exact.

        Parameters
        ----------
        now : LogTransform
            The repair with the present values.
        ats : sequence of r functions
            The repair with another value of one number.
        values, h : (r,) arrays
            The present values, and the steps of the slopes.

        Returns
        -------
        change, spread : (r,) arrays
            The steps and their standard deviations, infinite where the arm's
            parameters take the number's place.
        """
        score = self.score(now)
        slopes = self._slopes(score.theta, now, ats, values, h)
        sizes = np.linalg.norm(slopes, axis=(0, 1))
        scaled = slopes / nonzero_or_one(sizes)
        parts, n_own = self.parts(now, PARTS, -scaled)
        rests = NormalEquations.of(parts.sum(axis=0) - parts, n_own)
        gram, cross = rests.normal(score.weights)
        s = gram.shape[-1] - len(ats)
        full = np.concatenate([gram, cross[:, :, None]], axis=2)
        arm = solve(full[:, :s, :s], full[:, :s, s:])
        remainder = full[:, s:, s:] - full[:, s:, :s] @ arm
        of_numbers = np.einsum("pkk->pk", remainder[..., :-1])
        total = np.einsum("pkk->pk", full[:, s:, s:-1])
        steps = remainder[..., -1] / np.maximum(of_numbers + RIDGE * total, 1e-300)
        change, spread = jackknifed(steps / nonzero_or_one(sizes))
        is_seen = sizes > FLOOR * np.linalg.norm(score.channels)
        is_determined = is_seen & (of_numbers.sum(axis=0) > FLOOR * total.sum(axis=0))
        return change, np.where(is_determined, spread, np.inf)

    def _slopes(
        self,
        theta: Array,
        now: LogTransform,
        ats: Sequence[At],
        values: Array,
        h: Array,
    ) -> Array:
        """(n, M, r) slopes of what an arm leaves, by each of r numbers."""
        residual = self.unexplained(now, theta)
        slopes = np.zeros((self.n, self.data.count, len(ats)))
        for r, at in enumerate(ats):
            moved = self.unexplained(at(values[r] + h[r]), theta)
            slopes[..., r] = (moved - residual) / h[r]
        return slopes

    def predicts(self, before: Array, after: Array) -> float:
        """By how many standard errors the second of what two repairs leave (PARTS, n)
        of parts that were left out is less, all joints that move together."""
        fall = np.log(before / after)[:, self.moving].sum(axis=1)
        return standard_errors_above_zero(fall)

    # -- what the fit alone does not tell

    def samples(self, fit: ArmFit) -> float:
        """How many independent samples of its rows no parameter takes."""
        return max(self.spare, 0.1) * fit.independent_rows

    def physics(
        self,
        fit: ArmFit,
        repair: LogTransform,
        samples: float,
    ) -> float:
        """log-probability that inertia and masses are positive and friction takes power.

        It is the sum of log Phi(estimate / standard deviation) of three kinds of power:
        the mean of dq_j times what the links leave of joint j's torque, of ddq^T times
        the inertial torque, and of the weight times that of a plausible arm. It tells a
        sign from a reversed clock, which fit the same.
        """

        states = self._centred_states(repair)
        left = fit.channels - fit.rows.raw @ fit.theta
        powers = np.sum(states * left, axis=2)
        of_theta = -(states[:, :, None, :] @ fit.rows.raw)[:, :, 0]
        noise = fit.left / samples * np.sum(states**2, axis=2)
        slopes = self._inertia_and_weight(repair.of_motion)
        inertia_and_weight = slopes @ fit.theta + [powers[1].sum(), 0.0]
        values = np.append(powers[0], inertia_and_weight)
        of_inertia = np.outer([1.0, 0.0], of_theta[1].sum(axis=0))
        gradient = np.vstack([of_theta[0], slopes + of_inertia])
        normal = np.tensordot(
            fit.weights * samples,
            fit.rows.gram,
            1,
        )
        variance = np.append(noise[0], [noise[1].sum(), 0.0])
        variance += np.sum(gradient.T * solve(normal, gradient.T), axis=0)
        z = values / np.sqrt(np.maximum(variance, 1e-300))
        loudest = np.full(len(z), LOUDEST)
        loudest[-2] = LOUDEST_INERTIA
        is_asked = np.append(self.moving, [True, True])
        return float(np.maximum(scipy.special.log_ndtr(z), -loudest)[is_asked].sum())

    def _centred_states(self, repair: LogTransform) -> Array:
        """(2, n, M) velocity and acceleration over M, without their means: what is
        constant, as a weight, is neither friction nor inertia."""
        motion = self.motion(repair)
        dq = -motion.dq.T if repair.reversed else motion.dq.T
        states = np.stack([dq, motion.ddq.T]) / len(motion.t)
        states = states - states.mean(axis=2, keepdims=True)
        return np.asarray(states * self.filter_gain(repair))

    def _make_inertia_and_weight(self, repair: LogTransform) -> Array:
        """(2, s) what the mean of ddq^T M(q) ddq is of the shared parameters, and the
        weight's mean product with the weight of a plausible arm."""
        ddq = self.motion(repair).ddq
        weight = self.shared(repair, 0.0, 0.0)
        inertial = self.shared(repair, 0.0, 1.0) - weight
        power = np.tensordot(
            ddq,
            inertial,
            ((1, 0), (0, 1)),
        )
        likeness = np.tensordot(
            self.nominal(repair, 0.0),
            weight,
            ((1, 0), (0, 1)),
        )
        return np.array([power, likeness]) / self.data.count
