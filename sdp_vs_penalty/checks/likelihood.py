"""How well one arm explains a repaired log: the one score by which all hypotheses are
compared.

With S_j the squared residual of joint j's torque under one theta for all joints, each
joint with noise of its own, the Gaussian log-likelihood is, up to constants,

    L = -M/2 sum_j log(S_j / |tau_j|^2),

M the number of independent samples. It is free of units and gains. Own columns
(friction, rotor, offset) are projected out of each joint's normal equations, which add:
of parts of a log, and of several logs. Physics adds what L cannot know: the probability
that inertia and masses are positive and that friction takes power,

    sum log Phi(z),   z = estimate / standard deviation,

which tells a sign from a reversed clock. Prior costs of a repair are the search's
matter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.checks.constants import (
    FLOOR,
    LOUDEST,
    LOUDEST_INERTIA,
    PARTS,
    RIDGE,
    ROUNDS,
)
from sdp_vs_penalty.checks.regression_data import RegressionData, on_robot
from sdp_vs_penalty.checks.repair import LogEvent, LogTransform, Numbers, Order
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one

#: Weighted normal equations (s, s), (s,); a repair by one number.
Normal: TypeAlias = tuple[Array, Array]
At: TypeAlias = Callable[[float], LogTransform]


@dataclass(frozen=True)
class Equations:
    """Normal equations of n joints' rows, of one log or of several (..., n): gram (...,
    n, s, s), cross (..., n, s), energy (..., n) of the torque with own columns
    projected out, whole (..., n) before; own (..., n, k, s + 1) what these columns take
    of the shared ones and of the torque."""

    gram: Array
    cross: Array
    energy: Array
    total: Array
    channel_solution: Array = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(cls, full: Array, k: int) -> Equations:
        """full (..., n, w, w) : Gram matrices of k own columns, the shared ones and the
        torque."""
        size = np.trace(full[..., :k, :k], axis1=-2, axis2=-1)[..., None, None] / max(
            k, 1
        )
        # A joint that rests in these rows has nothing of its own there.
        mine = full[..., :k, :k] + np.maximum(1e-6 * size, 1e-280) * np.eye(k)
        channel_solution = np.linalg.solve(mine, full[..., :k, k:])
        remainder = full[..., k:, k:] - full[..., k:, :k] @ channel_solution
        energy = np.maximum(remainder[..., -1, -1], 0.0)
        total = _positive(full[..., -1, -1])
        return cls(
            remainder[..., :-1, :-1],
            remainder[..., :-1, -1],
            energy,
            total,
            channel_solution,
        )

    @classmethod
    def together(cls, logs: Sequence[Equations]) -> Equations:
        """The joints of several logs (1, n, ...) side by side, to fit one arm to them."""
        names = "gram", "cross", "energy", "total"
        return cls(
            *(
                np.concatenate([getattr(x, name) for x in logs], axis=1)
                for name in names
            )
        )

    def left_of(self, full: Array, theta: Array) -> Array:
        """(..., n) squared residuals that each joint's parameters (..., n, s), with the
        own ones they go with, leave of rows with such Gram matrices (..., n, w, w)."""
        v = np.append(theta, -np.ones((*theta.shape[:-1], 1)), axis=-1)[..., None]
        v = np.concatenate(
            [
                -self.channel_solution @ v,
                np.broadcast_to(v, (*full.shape[:-2], *v.shape[-2:])),
            ],
            axis=-2,
        )
        return np.asarray(np.sum(v * (full @ v), axis=(-2, -1)))

    def normal(self, weights: Array) -> tuple[Array, Array]:
        """(..., s, s) and (..., s) : sums over joints of such weights (..., n)."""
        s = self.gram.shape[-1]
        flat = weights[..., None, :] @ self.gram.reshape(*self.gram.shape[:-2], s * s)
        return flat.reshape(*flat.shape[:-2], s, s), np.einsum(
            "...j,...js->...s", weights, self.cross
        )

    def fitted(self, chosen: NDArray[np.bool_]) -> tuple[Array, Array]:
        """(..., s) parameters at the maximum of L, by reweighting each joint, and (...,
        n) squared residuals there, at least FLOOR of the whole; chosen (n,) : which
        joints move."""
        left = self.total
        for _ in range(ROUNDS):
            gram, cross = self.normal(chosen / left)
            theta = solve(gram, cross[..., None])[..., 0]
            bent = (self.gram @ theta[..., None, :, None])[..., 0] - 2.0 * self.cross
            left = self.energy + np.einsum("...js,...s->...j", bent, theta)
            left = np.maximum(left, FLOOR * self.total)
        return theta, left


class Likelihood:
    """Of one problem and one log's rows; what depends on a part of a repair is kept for
    repairs of the rest."""

    def __init__(self, problem: Problem, data: RegressionData) -> None:
        self.problem = problem
        self.data = data
        self.n = len(data.moving)
        self.moving = data.moving
        self.joints: list[int] = np.flatnonzero(self.moving).tolist()
        self.revolute = [
            j for j in self.joints if problem.robot.joints[j].kind == "revolute"
        ]
        self.none = LogTransform.none(self.n, problem.robot.gravity)
        self._rows, self.columns = (
            lru_cache(6)(partial(RepairedRows, self)),
            lru_cache(12)(self._made_columns),
        )
        self._model = lru_cache(12)(self._made_model)
        self._basis, self._late = (
            lru_cache(20)(self._made_basis),
            lru_cache(40)(self._shifted),
        )

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
        return Likelihood(self.problem, self.data.with_laws(self.nominal(self.none)))

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
        held = 2.0 * self.data.cutoff * float(np.ptp(self.data.motion.t))
        score = self.score(self.none)
        n_parameters = len(score.theta) + self.n * self.data.own_columns.shape[2]
        return 1.0 - n_parameters / max(held * len(self.joints), 1.0)

    def channels(self, repair: LogTransform) -> Array:
        """(n, M) the torque as repaired, 0 where it is not asked for."""
        out = np.empty((self.n, self.data.count))
        for j, k in enumerate(repair.tau_order):
            value, rate = (x[:, k] for x in self._late(repair.lead[j]))
            if repair.bend[j]:
                limit = max(
                    float(self.data.largest[k]) / repair.bend[j], 1e-300
                )  # a dead channel
                value = limit * np.arctanh(np.clip(value / limit, -0.999, 0.999))
            out[j] = repair.gain[j] * (value + repair.lag[j] * rate)
        return out * self.filter_gain(repair)

    def filter_gain(self, repair: LogTransform) -> Array:
        """(n, M) 1 where a joint's torque is asked for."""
        return self.data.heard.T[list(repair.order)]

    def _shifted(self, lead: float) -> tuple[Array, Array]:
        """(M, n) all channels and their rates, so much later [s]."""
        torque = self.data.torque
        instants = np.clip(self.data.motion.t + lead, torque.x[0], torque.x[-1])
        return torque(instants), torque(instants, 1)

    def motion(
        self, repair: LogTransform, speed: float = 1.0, push: float = 1.0
    ) -> Motion:
        """States as repaired, with so many times their velocity and acceleration."""
        m = self.data.motion
        order = list(repair.order)
        scale = np.array(repair.scale)
        dq = speed * scale * m.dq[:, order] / repair.rate
        ddq = push * scale * m.ddq[:, order] / repair.rate**2
        return Motion(
            m.t[0] + repair.rate * (m.t - m.t[0]), repair.positions(m.q), dq, ddq
        )

    def rows(self, repair: LogTransform) -> RepairedRows:
        """What depends on the motion alone."""
        return self._rows(repair.of_motion)

    def raw(self, repair: LogTransform) -> Array:
        """(n, M, s) the columns of the parameters that joints share, 0 where torque is
        not asked for."""
        columns = self.shared(repair)
        if any(repair.lacks):
            weight = self.shared(repair, 0.0, 0.0)
            columns = columns - np.array(repair.lacks)[:, None, None] * weight
        return np.asarray(self.filter_gain(repair)[:, :, None] * columns)

    def _made_model(self, gravity: tuple[float, ...], longer: Numbers) -> Model | None:
        """What joints share, under another gravity, with other distances between joints
        [m]."""
        robot = self.problem.robot
        joints = list(self.problem.robot.joints)
        for j in np.flatnonzero(longer).tolist():
            placement = joints[j].placement.copy()
            placement[:3, 3] *= 1.0 + longer[j] / nonzero_or_one(
                np.linalg.norm(placement[:3, 3])
            )
            joints[j] = replace(joints[j], placement=placement)
        robot = replace(robot, gravity=gravity, joints=tuple(joints))
        shared = self.data.shared
        return None if shared is None else on_robot(shared, robot)

    def _made_columns(
        self, repair: LogTransform, speed: float = 1.0, push: float = 1.0
    ) -> Array:
        """(n, M, p) columns of all parameters that joints share, of ``motion``."""
        model = self._model(repair.gravity, repair.longer)
        motion = self.motion(repair, speed, push)
        return (
            np.zeros((self.n, self.data.count, 0))
            if model is None
            else model.dense_columns(motion)
        )

    def shared(
        self, repair: LogTransform, speed: float = 1.0, push: float = 1.0
    ) -> Array:
        """(n, M, s) those that say all that the others do."""
        return self.columns(repair.of_arm, speed, push)[
            :, :, list(self.data.independent)
        ]

    def nominal(self, repair: LogTransform, speed: float = 1.0) -> Array:
        """(M, n) torque of a plausible arm on the repaired motion, of its weight what
        channels hold; where speed is 0, all of its weight."""
        known = self.data.shared
        rigid = np.arange(0) if known is None else known.rigid_indices
        columns = self.columns(repair.of_arm, speed, speed)
        links = self.problem.nominal_links.ravel()
        torque = np.asarray(
            np.swapaxes(columns[:, :, rigid] @ links[: len(rigid)], 0, 1), float
        )
        if speed and any(repair.lacks):
            torque = torque - np.array(repair.lacks) * self.nominal(repair, 0.0)
        return torque

    def _made_basis(self, order: Order, events: tuple[LogEvent, ...]) -> Array:
        """(n, M, k) bases of the joints' own columns, 0 for columns that depend on
        others."""
        data = self.data
        joint_index = np.arange(self.n)[:, None]
        shapes = [
            (
                data.laws[e.at][[order[e.joint]]]
                if isinstance(e.at, str)
                else e.shape(data.motion.t)
            )
            for e in events
        ]
        shapes = [
            x * (joint_index == e.joint)[:, :, None]
            for e, x in zip(events, shapes, strict=True)
        ]
        columns = np.concatenate([data.own_columns[list(order)], *shapes], axis=2)
        columns = columns * data.heard.T[list(order)][:, :, None]
        columns = columns / nonzero_or_one(
            np.linalg.norm(columns, axis=1, keepdims=True)
        )
        u, s, _ = np.linalg.svd(columns, full_matrices=False)
        return np.asarray(u * (s > 1e-6 * s.max(axis=1, keepdims=True))[:, None])

    def unexplained(self, repair: LogTransform, theta: Array) -> Array:
        """(n, M) what an arm (s,) leaves of the channels, its joints' own columns
        apart."""
        return np.asarray(self.channels(repair) - self.raw(repair) @ theta)

    def parts(
        self, repair: LogTransform, count: int = PARTS, more: Array | None = None
    ) -> tuple[Array, int]:
        """(count, n, w, w) Gram matrices of that many parts of the log, which add, and
        how many of their columns are own ones; more (n, M, r) : further columns that
        joints share."""
        rows = self.rows(repair)
        y = self.channels(repair)[:, :, None]
        further = y[:, :, :0] if more is None else more
        full = np.concatenate([rows.basis, rows.raw, further, y], axis=2)
        edges = np.linspace(0, self.data.count, count + 1).astype(int)
        parts = [full[:, a:b] for a, b in pairwise(edges.tolist())]
        return np.stack([np.swapaxes(p, 1, 2) @ p for p in parts]), rows.basis.shape[2]

    def scores(self, repairs: Sequence[LogTransform]) -> list[ArmFit]:
        """One arm fitted to each."""
        rows = [self.rows(r) for r in repairs]
        y = [self.channels(r) for r in repairs]
        gram = np.stack([x.gram for x in rows])
        cross = np.stack(
            [np.einsum("jms,jm->js", x.apart, z) for x, z in zip(rows, y, strict=True)]
        )
        rests = [x.rest(z[:, :, None])[:, :, 0] for x, z in zip(rows, y, strict=True)]
        energy = np.sum(np.square(rests), axis=2)
        total = np.sum(np.square(y), axis=2)
        theta, left = Equations(gram, cross, energy, total := _positive(total)).fitted(
            self.moving
        )
        both = zip(rows, y, theta, left, total, strict=True)
        return [ArmFit(self, *fit_parts) for fit_parts in both]

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
        """By leaving out each part of the log in turn (a delete-a-group jackknife):
        (PARTS, s) the arms of all other parts, whose joints weigh (n,), and of other
        logs' normal equations, which further columns (n, M, r) are no part of; (PARTS,
        n) what they leave of the part, over the mean energy of a part."""
        parts, k = self.parts(repair, PARTS, more)
        rests = Equations.of(parts.sum(axis=0) - parts, k)
        gram, cross = rests.normal(weights)
        if others is not None:
            s = len(others[1])
            gram[:, :s, :s] += others[0]
            cross[:, :s] += others[1]
        arms = solve(gram, cross[..., None])[..., 0]
        total = np.maximum(parts[..., -1, -1].sum(axis=0), 1e-280)
        return arms, np.maximum(
            PARTS * rests.left_of(parts, arms[:, None]) / total, FLOOR
        )

    def alone(self, repair: LogTransform) -> Array:
        """(n,) share of each channel that its joint's own model leaves of parts it was
        not fitted to."""
        parts, k = self.parts(repair)
        rests = Equations.of(parts.sum(axis=0) - parts, k)
        left = rests.left_of(parts, solve(rests.gram, rests.cross[..., None])[..., 0])
        return np.maximum(
            left.sum(axis=0) / _positive(parts[..., -1, -1].sum(axis=0)), FLOOR
        )

    def first_order_steps(
        self, now: LogTransform, ats: Sequence[At], values: Array, h: Array
    ) -> tuple[Array, Array]:
        """(r,) by how much each of some numbers of ``now`` would have to change alone,
        to first order, and (r,) the standard deviations of that, infinite where the
        arm's parameters take its place: by a jackknife, because what the model lacks
        varies from part to part: noise alone would look exact. With A, c the normal
        equations of the arm and a, b, c_x those of d(y - Y theta)/dx,

            change = (c_x - b^T A^-1 c) / (a - b^T A^-1 b)."""
        score = self.score(now)
        residual_now = self.unexplained(now, score.theta)
        slopes = np.zeros((self.n, self.data.count, len(ats)))
        for r, at in enumerate(ats):
            slopes[..., r] = (
                self.unexplained(at(values[r] + h[r]), score.theta) - residual_now
            ) / h[r]
        sizes = np.linalg.norm(slopes, axis=(0, 1))
        parts, k = self.parts(now, PARTS, -slopes / nonzero_or_one(sizes))
        gram, cross = Equations.of(parts.sum(axis=0) - parts, k).normal(score.weights)
        s = gram.shape[-1] - len(ats)
        full = np.concatenate([gram, cross[:, :, None]], axis=2)
        arm = solve(full[:, :s, :s], full[:, :s, s:])
        remainder = full[:, s:, s:] - full[:, s:, :s] @ arm
        channel_part = np.einsum("pkk->pk", remainder[..., :-1])
        total = np.einsum("pkk->pk", full[:, s:, s:][..., :-1])
        change, spread = jackknifed(
            remainder[..., -1]
            / np.maximum(channel_part + RIDGE * total, 1e-300)
            / nonzero_or_one(sizes)
        )
        is_determined = sizes > FLOOR * np.linalg.norm(score.channels)
        is_determined &= channel_part.sum(axis=0) > FLOOR * total.sum(axis=0)
        return change, np.where(is_determined, spread, np.inf)

    def predicts(self, before: Array, after: Array) -> float:
        """By how many standard errors the second of what two repairs leave (PARTS, n)
        of parts that were left out is less, all joints that move together."""
        change = np.log(before / after)[:, self.moving].sum(axis=1)
        return float(np.mean(change) / max(np.std(change) / np.sqrt(PARTS), 1e-300))


class RepairedRows:
    """What a repair of the motion makes of the rows of n joints: basis (n, M, k) of own
    columns, raw (n, M, s) columns of the shared parameters, apart (n, M, s) the same
    with own columns projected out, gram (n, s, s) of these."""

    def __init__(self, of: Likelihood, repair: LogTransform) -> None:
        self.of = of
        self.repair = repair
        self.basis, self.raw = of._basis(repair.order, repair.events), of.raw(repair)
        left = self.rest(self.raw)
        is_visible = np.linalg.norm(left, axis=1) > 1e-6 * np.linalg.norm(
            self.raw, axis=1
        )
        self.apart = (
            left * is_visible[:, None]
        )  # rounding errors of the others are no columns
        self.gram = np.swapaxes(self.apart, 1, 2) @ self.apart

    def rest(self, y: Array) -> Array:
        """(n, M, K) torques or columns with own columns projected out."""
        return np.asarray(y - self.basis @ (np.swapaxes(self.basis, 1, 2) @ y))

    @cached_property
    def pushed(self) -> Array:
        """(2, s) what the mean of ddq^T M(q) ddq is of the shared parameters, and the
        weight's mean product with the weight of a plausible arm."""
        of = self.of
        repair = self.repair
        ddq = of.motion(repair).ddq
        weight = of.shared(repair, 0.0, 0.0)
        torque = of.shared(repair, 0.0, 1.0) - weight, weight
        both = zip(torque, (ddq, of.nominal(self.repair, 0.0)), strict=True)
        return (
            np.array([np.tensordot(along, x, ((1, 0), (0, 1))) for x, along in both])
            / of.data.count
        )


@dataclass
class ArmFit:
    """One arm fitted to one repaired log: channels (n, M), theta (s,), left and whole
    (n,) [(N m)^2]."""

    of: Likelihood
    rows: RepairedRows
    channels: Array
    theta: Array
    left: Array
    total: Array

    @cached_property
    def shares(self) -> Array:
        """(n,) share of each channel's energy that is left over."""
        return self.left / self.total

    @property
    def unexplained(self) -> float:
        """The same of all joints that move together."""
        return float(self.left[self.of.moving].sum() / self.total[self.of.moving].sum())

    @property
    def mean_share(self) -> float:
        """The mean of the shares of joints that move."""
        return float(np.mean(self.shares[self.of.moving]))

    @cached_property
    def score(self) -> float:
        """sum_j log of what is left, of joints that move."""
        return float(np.log(self.shares)[self.of.moving].sum())

    @property
    def poor(self) -> NDArray[np.bool_]:
        """(n,) joints of whose torque more is unexplained than what friction laws and
        filters are worth: their motion may be another one."""
        return np.asarray(self.of.moving & (self.shares > 2.0 * FLOOR))

    @cached_property
    def residual(self) -> Array:
        """(n, M) what the arm leaves of the channels."""
        return (
            self.rows.rest(self.channels[:, :, None])[:, :, 0]
            - self.rows.apart @ self.theta
        )

    def gained(self, x: Array) -> Array:
        """(n, K) by how much log S_j falls with one more own column of joint j, of x
        (n, M, K) without what the own ones explain: a score test, less what the arm's
        parameters take of it."""
        pull = np.einsum("jm,jmk->jk", self.residual, x) ** 2
        shared = np.swapaxes(self.rows.apart, 1, 2) @ x
        normal = np.tensordot(self.weights, self.rows.gram, 1)
        taken = self.weights[:, None] * np.sum(shared * solve(normal, shared), axis=1)
        energy = np.sum(x**2, axis=1)
        visible_energy = np.maximum(energy - taken, 1e-3 * energy) * self.left[:, None]
        return np.asarray(np.log1p(pull / np.maximum(visible_energy, 1e-280)))

    @cached_property
    def samples(self) -> float:
        """How many independent samples M rows hold whose neighbours are alike, and no
        parameter takes: M / (1 + 2 sum_k rho_k) of the median joint, over lags before
        what the arm leaves is correlated no more (Geyer 1992)."""
        left = self.residual[self.of.moving]
        count = self.channels.shape[1]
        power = (
            np.abs(np.fft.rfft(left - left.mean(axis=1, keepdims=True), 2 * count)) ** 2
        )
        rho = np.fft.irfft(power)[:, :count]
        rho = rho / nonzero_or_one(rho[:, :1])
        lasts = 2.0 * np.sum(rho * np.cumprod(rho > 0.0, axis=1), axis=1) - 1.0
        return max(self.of.spare, 0.1) * count / max(float(np.median(lasts)), 1.0)

    @cached_property
    def weights(self) -> Array:
        """(n,) of each joint's rows, 0 where it does not move."""
        return np.where(self.of.moving, 1.0 / self.left, 0.0)

    def physics(self, repair: LogTransform, samples: float) -> float:
        """log-probability that inertia and masses are positive and friction takes
        power: the mean of dq_j times what the links leave of joint j's torque, of ddq^T
        times the inertial torque, and of the weight times that of a plausible arm."""
        from scipy.special import log_ndtr

        m = self.of.motion(repair)
        slopes = self.rows.pushed
        states = np.stack([-m.dq.T if repair.reversed else m.dq.T, m.ddq.T]) / len(m.t)
        states -= states.mean(
            axis=2, keepdims=True
        )  # what is constant, as a weight, is neither
        states = states * self.of.filter_gain(repair)
        values = np.sum(states * (self.channels - self.rows.raw @ self.theta), axis=2)
        gradients = -(states[:, :, None, :] @ self.rows.raw)[:, :, 0]
        noise = self.left / samples * np.sum(states**2, axis=2)
        turned = np.outer([1.0, 0.0], gradients[1].sum(axis=0))
        value = np.append(values[0], slopes @ self.theta + [values[1].sum(), 0.0])
        gradient = np.vstack([gradients[0], slopes + turned])
        normal = np.tensordot(self.weights * samples, self.rows.gram, 1)
        spread = np.append(noise[0], [noise[1].sum(), 0.0])
        spread += np.sum(gradient.T * solve(normal, gradient.T), axis=0)
        z = value / np.sqrt(np.maximum(spread, 1e-300))
        chosen = np.append(self.of.moving, [True, True])
        loudest = np.full(len(z), LOUDEST)
        loudest[-2] = LOUDEST_INERTIA
        return float(np.maximum(log_ndtr(z), -loudest)[chosen].sum())


def _positive(energy: Array) -> Array:
    """(..., n) energies of torques, none of them 0."""
    return np.maximum(
        energy, 1e-12 * energy.max(axis=-1, keepdims=True, initial=0.0) + 1e-280
    )


def jackknifed(estimates: Array) -> tuple[Array, Array]:
    """Numbers and their standard deviations, from their values (PARTS, ...) without one
    part each."""
    return np.mean(estimates, axis=0), np.sqrt((PARTS - 1) * np.var(estimates, axis=0))


def solve(gram: Array, right: Array) -> Array:
    """(..., s, r) (G + ridge)^-1 B with columns of G (..., s, s) scaled to one; zero
    for those that are not there."""
    norms = np.sqrt(np.maximum(np.diagonal(gram, axis1=-2, axis2=-1), 0.0))
    nonzero = norms > 1e-9 * norms.max(axis=-1, keepdims=True, initial=0.0)
    scale = np.where(nonzero, 1.0 / np.where(nonzero, norms, 1.0), 0.0)[..., None]
    unit = scale * gram * np.swapaxes(scale, -1, -2)
    np.einsum("...ii->...i", unit)[...] += np.where(nonzero, RIDGE, 1.0)
    return np.asarray(scale * np.linalg.solve(unit, scale * right))
