"""Does the arm's own dynamics explain the torque as it was recorded, or better otherwise?

A few hundred rows of a run are enough to tell a flipped sign from a right one. Rigid body, friction
and offset make up columns Y_j of joint j's torque at the low-passed motion; the torque channels of
the file are C. Every hypothesis says which columns and which channel belong together, and is
judged by the share of the torque's energy that is left over,

    E = min over theta of sum_j |Y_j theta - s_j C_k(j)|^2 / |C_k(j)|^2 / n,

all joints sharing one theta: that couples them, so that E knows a channel's sign and place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check.evidence import Evidence, left_out, solve
from sdp_vs_penalty.effects.effect import JointEffect, Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot

#: Independent samples for each parameter, below which a good fit says nothing.
_SPARE = 1.5
#: Filtered rows that repeat each other count once: rows per independent sample.
OVERSAMPLING = 4.0
#: A joint slides above this share of its usual speed.
_SLIDES = 0.2


@dataclass(frozen=True)
class Own:
    """Columns that each joint's own motion makes (friction, offset, rotor), low-passed as the torque is.

    Friction is far sharper at reversals than low-passed states. columns (n, M, k); indices (n, k) where
    their parameters sit in theta, those of what the model may lack (see beyond.py) behind the model's;
    offered (n, M, l) all columns of what it may lack.
    To exchange joints or turn them round exchanges or turns columns.
    """

    columns: Array
    indices: NDArray[np.intp]
    offered: Array

    def part(self, rows: slice | NDArray[np.intp]) -> Own:
        return replace(self, columns=self.columns[:, rows], offered=self.offered[:, rows])

    def moved(self, scale: Array, order: NDArray[np.intp]) -> Own:
        sign = np.sign(scale)[:, None, None]
        return replace(self, columns=sign * self.columns[order], offered=sign * self.offered[order])

    def first(self, parameters: int) -> Own:
        """Those of so many parameters."""
        k = int(np.sum(self.indices[0] < parameters))
        return replace(self, columns=self.columns[:, :, :k], indices=self.indices[:, :k])


@dataclass(frozen=True)
class Physics:
    """One run's low-passed motion and torque channels (M, n), and the model that should explain them.

    rate : (M, n) time derivative of the channels; nominal : (p,) parameters of a plausible arm;
    weight : (n,) share of the gravity torque that each channel holds; parent : the data of which these
    are rows, for delays; own : see there; heard : (M, n) 0 where nothing is asked of a joint's torque.
    """

    model: Model
    motion: Motion
    channels: Array
    rate: Array
    nominal: Array
    weight: tuple[float, ...] | None = None
    parent: tuple[Physics, NDArray[np.intp]] | None = None
    own: Own | None = None
    heard: Array | None = None

    @property
    def n(self) -> int:
        return self.model.robot.n

    @property
    def p(self) -> int:
        """Length of theta: the model's parameters, and those of what was added beyond the model."""
        own = -1 if self.own is None else int(self.own.indices.max(initial=-1))
        return max(len(self.model.parameters), own + 1)

    @property
    def narrow(self) -> Physics:
        """Without what the model may lack."""
        own = self.own
        return self if own is None else replace(self, own=own.first(len(self.model.parameters)))

    @cached_property
    def energy(self) -> Array:
        """(n,) mean square of each channel, at least a trace of the largest."""
        energy = np.mean(self.channels**2, axis=0)
        return np.maximum(energy, 1e-12 * max(float(energy.max(initial=0.0)), 1e-300))

    @cached_property
    def columns(self) -> list[Array]:
        """Per joint the columns (M, p) of all parameters, zero where they do not act on it."""
        full = self.columns_of(self.model)
        if self.heard is not None:
            full = [c * h[:, None] for c, h in zip(full, self.heard.T, strict=True)]
        if self.weight is None:
            return full
        still = self.columns_of(turned_gravity(self.model, (0.0, 0.0, 0.0)))
        return [s + w * (f - s) for s, f, w in zip(still, full, self.weight, strict=True)]

    def columns_of(self, model: Model) -> list[Array]:
        if self.own is None:
            return wide_columns(model, self.motion)
        out = [np.zeros((len(self.motion.t), self.p)) for _ in range(self.n)]
        rest = [k for k in range(len(model.effects)) if k not in own_effects(model)]
        where = np.concatenate([np.arange(0), *(model.indices[k] for k in rest)]).astype(int)
        part = Model(model.robot, tuple(model.effects[k] for k in rest))
        for j, block in enumerate(part.columns(self.motion) if rest else []):
            out[j][:, where[block.indices]] = block.columns
        for j, columns in enumerate(self.own.columns):
            out[j][:, self.own.indices[j]] = columns
        return out

    @cached_property
    def grams(self) -> Array:
        """(n, p, p) normal equations of each joint's columns."""
        return np.array([c.T @ c for c in self.columns])

    @cached_property
    def evidence(self) -> Evidence:
        """What one arm explains of the channels."""
        heard = 1.0 if self.heard is None else self.heard
        return Evidence.of(self.grams, self.columns, heard * self.channels)

    @cached_property
    def sliding(self) -> Physics:
        """The same, a joint's torque counted only where it moves at a share of its usual speed.

        Around a reversal dry friction holds any torque between two limits, sooner or later than a law
        of velocity says; inertia and weight are as late as the file is.
        """
        speed = np.abs(self.motion.dq)
        return replace(self, heard=(speed > _SLIDES * np.sqrt(np.mean(speed**2, axis=0))).astype(float))

    @cached_property
    def left_out(self) -> Array:
        """(PARTS, n) share of each part's energy that the arm of all other parts leaves of it."""
        return left_out(self.columns, self.channels)

    def _other_channels(self, channels: Array, rate: Array) -> Physics:
        """Other channels on the same motion: the columns, which are dear, are kept."""
        made = replace(self, channels=channels, rate=rate, parent=None)
        for name in ("columns", "grams"):
            if name in self.__dict__:
                made.__dict__[name] = self.__dict__[name]
        return made

    def part(self, rows: slice | NDArray[np.intp]) -> Physics:
        """The same on some of the rows."""
        m = self.motion
        motion = Motion(m.t[rows], m.q[rows], m.dq[rows], m.ddq[rows])
        channels, rate = self.channels[rows], self.rate[rows]
        own = None if self.own is None else self.own.part(rows)
        whole, places = self.parent or (self, np.arange(len(self.channels)))
        parent = (whole, places[rows])
        heard = None if self.heard is None else self.heard[rows]
        made = replace(self, motion=motion, channels=channels, rate=rate, heard=heard)
        return replace(made, own=own, parent=parent)

    def with_motion(self, scale: Array, order: NDArray[np.intp], offset: Array | float = 0.0) -> Physics:
        """The hypothesis that joint j's position is scale_j times the channel order_j + offset_j."""
        m = self.motion
        q, dq, ddq = (scale * x[:, order] for x in (m.q, m.dq, m.ddq))
        own = None if self.own is None else self.own.moved(scale, order)
        return replace(self, motion=Motion(m.t, q + offset, dq, ddq), own=own)

    def with_channels(self, scale: Array, order: NDArray[np.intp]) -> Physics:
        """The hypothesis that joint j's torque is scale_j times the file's channel order_j."""
        return self._other_channels(*(scale * x[:, order] for x in (self.channels, self.rate)))

    def with_lead(self, seconds: Array, order: int = 2) -> Physics:
        """Each channel ``seconds`` (n,) earlier: delays (order 2) or first-order lags (order 1)."""
        if order == 1:
            channels = self.channels + seconds * self.rate
        else:
            whole, rows = self.parent or (self, np.arange(len(self.channels)))
            channels = self.channels.copy()
            for j in np.flatnonzero(seconds):
                late = (whole.motion.t, whole.channels[:, j], whole.rate[:, j])
                channels[:, j] = hermite(whole.motion.t[rows] + seconds[j], *late)
        return self._other_channels(channels, self.rate)

    def without(self, torque: Array) -> Physics:
        """The channels less a torque (M, n)."""
        return self._other_channels(self.channels - torque, self.rate)

    def with_clock(self, factor: float) -> Physics:
        """The hypothesis that the true time is ``factor`` times the file's."""
        m = self.motion
        motion = Motion(m.t[0] + factor * (m.t - m.t[0]), m.q, m.dq / factor, m.ddq / factor**2)
        return replace(self, motion=motion, rate=self.rate / factor)

    def reversed(self) -> Physics:
        """The hypothesis that time runs from the last row to the first."""
        m = self.motion
        motion = Motion(m.t[0] + (m.t[-1] - m.t[::-1]), m.q[::-1], -m.dq[::-1], m.ddq[::-1])
        channels, rate = self.channels[::-1], -self.rate[::-1]
        turned = self.part(slice(None, None, -1)).own
        own = None if turned is None else turned.moved(-np.ones(self.n), np.arange(self.n))
        return replace(self, motion=motion, channels=channels, rate=rate, own=own)

    def with_weight(self, share: Array) -> Physics:
        """The hypothesis that of the gravity torque only this share (n,) is in the channels."""
        return replace(self, weight=tuple(share.tolist()))

    def with_gravity(self, gravity: Sequence[float]) -> Physics:
        """The hypothesis that gravity is this vector in the base frame."""
        return replace(self, model=turned_gravity(self.model, gravity))

    def agreement_with_weight(self) -> float:
        """Correlation, over all joints, of the torque with that of the nominal arm at rest."""
        rest = np.zeros_like(self.motion.q)
        still = wide_columns(self.model, Motion(self.motion.t, self.motion.q, rest, rest))
        weight = np.column_stack([columns @ self.nominal for columns in still])
        size = float(np.linalg.norm(weight) * np.linalg.norm(self.channels))
        return float(np.sum(weight * self.channels)) / size if size > 0.0 else 0.0

    @cached_property
    def alone(self) -> Array:
        """(n, n) share of channel k left over by joint j's columns alone, theta free for each pair."""
        out = np.ones((self.n, self.n))
        for j, columns in enumerate(self.columns):
            gram, cross = columns.T @ columns, columns.T @ self.channels
            explained = np.sum(cross * solve(gram, cross), axis=0)
            out[j] = 1.0 - explained / (len(columns) * self.energy)
        return np.clip(out, 1e-12, 1.0)

    @cached_property
    def form(self) -> Array:
        """(n, n) matrix Q with E = s^T Q s for gains (or signs) s of the channels."""
        weights = 1.0 / (len(self.channels) * self.energy * self.n)
        gram = sum(w * c.T @ c for w, c in zip(weights, self.columns, strict=True))
        cross = np.column_stack(
            [w * c.T @ y for w, c, y in zip(weights, self.columns, self.channels.T, strict=True)]
        )
        return np.asarray(np.eye(self.n) / self.n - cross.T @ solve(gram, cross), float)

    @property
    def unexplained(self) -> float:
        """E of the data as they are."""
        return max(float(self.form.sum()), 1e-12)

    @cached_property
    def dissipation(self) -> tuple[Array, Array]:
        """Mean power [W] that each joint's friction takes out of the motion, and its standard deviation.

        From each joint fitted alone. Friction never drives: a power well below zero is a flipped sign.
        """
        friction = [
            k for k, p in enumerate(self.model.parameters) if "friction" in p.effect and p.lower == 0.0
        ]
        if friction:  # further laws of it, behind the rotors
            friction += range(len(self.model.parameters) + self.n, self.p)
        power, deviation = np.zeros(self.n), np.full(self.n, np.inf)
        for j, columns in enumerate(self.columns):
            own = [k for k in friction if np.any(columns[:, k])]
            if not own:
                continue
            gram, y = columns.T @ columns, self.channels[:, j]
            # d power / d theta: what a unit of each coefficient dissipates in the mean.
            slope = np.zeros(columns.shape[1])
            slope[own] = columns[:, own].T @ self.motion.dq[:, j] / len(y)
            influence = solve(gram, slope[:, None])[:, 0]
            theta = solve(gram, (columns.T @ y)[:, None])[:, 0]
            residual = y - columns @ theta
            samples = max(len(y) / OVERSAMPLING, 1.0)
            variance = float(residual @ residual) / len(y) * OVERSAMPLING
            power[j] = slope @ theta
            # At least what model error does, beside the noise: one part in a thousand of the power.
            least = 1e-3 * np.sqrt(np.mean(y**2) * np.mean(self.motion.dq[:, j] ** 2) / samples)
            deviation[j] = np.hypot(np.sqrt(max(variance * float(slope @ influence), 0.0)), least)
        return power, deviation

    @cached_property
    def inertia(self) -> Array:
        """(n,) significance z_j: with signs s of the channels, s^T z standard deviations above zero is

        the mean of ddq^T M(q) ddq of the fitted arm. Inertia is positive: far below zero means that
        all signs are turned.
        """
        weights = 1.0 / (len(self.channels) * self.energy * self.n)
        rest = np.zeros_like(self.motion.q)
        weightless = turned_gravity(self.model, (0.0, 0.0, 0.0))
        m = self.motion
        pushed = wide_columns(weightless, Motion(m.t, m.q, rest, m.ddq))
        gram = sum(w * c.T @ c for w, c in zip(weights, self.columns, strict=True))
        own, rigid = len(self.model.parameters), self.model.rigid_indices
        slope = np.zeros(self.p)
        slope[rigid] = (sum(c.T @ a for c, a in zip(pushed, m.ddq.T, strict=True)) / len(m.t))[rigid]
        if self.p > own:
            slope[own : own + self.n] = np.mean(m.ddq**2, axis=0)
        influence = solve(np.asarray(gram, float), slope[:, None])[:, 0]
        power = np.array(
            [
                influence @ (w * c.T @ y)
                for w, c, y in zip(weights, self.columns, self.channels.T, strict=True)
            ]
        )
        variance = self.unexplained / (len(self.channels) * self.n) * OVERSAMPLING
        deviation = np.sqrt(max(variance * float(slope @ influence), 1e-300))
        return np.asarray(power / deviation, float)

    def determined(self, cutoff: float, share: float = 1.0) -> bool:
        """Whether a share of the run, low-passed at ``cutoff`` [Hz], has samples to spare for theta."""
        seconds = float(self.motion.t[-1] - self.motion.t[0])
        return bool(2.0 * cutoff * seconds * share * self.n > _SPARE * self.p)


def own_effects(model: Model) -> list[int]:
    """Which of the model's effects have one column on every joint, made by that joint's motion."""
    every = list(range(model.robot.n))
    return [
        k for k, e in enumerate(model.effects) if isinstance(e, JointEffect) and list(e.joints) == every
    ]


def hermite(at: Array, t: Array, x: Array, slope: Array) -> Array:
    """Cubic interpolation of x (M,) with known slopes; constant beyond the ends."""
    at = np.clip(at, t[0], t[-1])
    k = np.clip(np.searchsorted(t, at, "right") - 1, 0, len(t) - 2)
    h = np.maximum(t[k + 1] - t[k], np.finfo(float).tiny)  # a clock that stands still for a sample
    u = (at - t[k]) / h
    value = (1.0 + 2.0 * u) * (1.0 - u) ** 2 * x[k] + u**2 * (3.0 - 2.0 * u) * x[k + 1]
    return np.asarray(value + h * (u * (1.0 - u) ** 2 * slope[k] - u**2 * (1.0 - u) * slope[k + 1]))


def wide_columns(model: Model, motion: Motion) -> list[Array]:
    """Per joint (M, p) the columns of all parameters."""
    out = []
    for block in model.columns(motion):
        wide = np.zeros((len(motion.t), len(model.parameters)))
        wide[:, block.indices] = block.columns
        out.append(wide)
    return out


def turned_gravity(model: Model, gravity: Sequence[float]) -> Model:
    x, y, z = (float(g) for g in gravity)
    robot: Robot = replace(model.robot, gravity=(x, y, z))
    return Model(robot, tuple(type(e)(robot, e.asked_joints, **e.shape) for e in model.effects))
