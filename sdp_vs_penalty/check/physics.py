"""Does the arm's own dynamics explain the torque as it was recorded, or better otherwise?

A few hundred rows of a run are enough to tell a flipped sign from a right one. Rigid body, friction
and offset make up columns Y_j of joint j's torque at the low-passed motion; the torque channels of
the file are C. Every hypothesis says which columns and which channel belong together, and is
judged by the share of the torque's energy that is left over,

    E = min over theta of sum_j |Y_j theta - s_j C_k(j)|^2 / |C_k(j)|^2 / n,

all joints sharing one theta: that couples them, so that E knows a channel's sign and place.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check.columns import (
    added,
    columns_of,
    hermite,
    only_links,
    slowed,
    turned_gravity,
    wide_columns,
)
from sdp_vs_penalty.check.evidence import Evidence, Grams, energy_of, left_out, settle, solve
from sdp_vs_penalty.check.own import Own
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import JointColumns, Model
from sdp_vs_penalty.robot.arrays import Array

#: Independent samples for each parameter, below which a good fit says nothing.
_SPARE = 1.5
#: Filtered rows that repeat each other count once: rows per independent sample.
OVERSAMPLING = 4.0
#: A joint slides above this share of its usual speed.
_SLIDES = 0.2


@dataclass(frozen=True)
class Physics:
    """One run's low-passed motion and torque channels (M, n), and the model that should explain them.

    rate : (M, n) time derivative of the channels; nominal : (p,) parameters of a plausible arm;
    weight : (n,) share of the gravity torque that each channel holds; parent : the data of which these
    are rows, for delays; independent : (p,) of the model's parameters those that stand for all, see
    columns.py; own : see there; heard : (M, n) 0 where nothing is asked of a joint's torque.
    """

    model: Model
    motion: Motion
    channels: Array
    rate: Array
    nominal: Array
    weight: tuple[float, ...] | None = None
    parent: tuple[Physics, NDArray[np.intp]] | None = None
    independent: NDArray[np.bool_] | None = None
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
        own, known = self.own, len(self.model.parameters)
        if own is None:
            return self
        made = replace(self, own=own.first(known))
        if "acting" in self.__dict__:
            kept = [(c, np.flatnonzero(c.indices < known)) for c in self.acting]
            made.__dict__["acting"] = [JointColumns(c.indices[k], c.columns[:, k]) for c, k in kept]
        return made

    @cached_property
    def energy(self) -> Array:
        """(n,) mean square of each channel, at least a trace of the largest."""
        energy = np.mean(self.channels**2, axis=0)
        return np.maximum(energy, 1e-12 * max(float(energy.max(initial=0.0)), 1e-300))

    @cached_property
    def columns(self) -> list[Array]:
        """Per joint the columns (M, p) of all parameters, zero where they do not act on it."""
        return [c.wide(self.p) for c in self.acting]

    @cached_property
    def acting(self) -> list[JointColumns]:
        """Per joint the columns of those parameters that act on it."""
        if self.weight is None:
            return columns_of(self, self.model)
        return added([(1.0, self.pulled[0]), (np.array(self.weight), self.pulled[1])])

    @cached_property
    def pulled(self) -> tuple[list[JointColumns], list[JointColumns]]:
        """The columns of the arm without weight, and what its weight adds to them."""
        if "by_gravity" in self.__dict__:
            still, *axes = self.by_gravity
            return still, added(zip(self.model.robot.gravity, axes, strict=True))
        still = columns_of(self, turned_gravity(self.model, (0.0, 0.0, 0.0)))
        full = self.acting if self.weight is None else columns_of(self, self.model)
        return still, added([(1.0, full), (-1.0, still)])

    @cached_property
    def by_gravity(self) -> list[list[JointColumns]]:
        """The columns of the arm without weight, and what 1 m/s^2 along x, y and z adds to them."""
        vectors = np.vstack([np.zeros(3), np.eye(3)])
        still, *full = (columns_of(self, turned_gravity(self.model, g)) for g in vectors.tolist())
        return [still, *(added([(1.0, x), (-1.0, still)]) for x in full)]

    @cached_property
    def grams(self) -> Grams:
        """Normal equations of each joint's columns."""
        return Grams.of([(c.indices, c.columns) for c in self.acting], self.p)

    @cached_property
    def evidence(self) -> Evidence:
        """What one arm explains of the channels."""
        cross = np.zeros((self.n, self.p))
        for out, c, y in zip(cross, self.acting, self.counted.T, strict=True):
            out[c.indices] = c.columns.T @ y
        return Evidence(self.grams, cross, energy_of(self.counted))

    @property
    def counted(self) -> Array:
        """(M, n) the channels, 0 where nothing is asked of them, as the columns are there."""
        return self.channels if self.heard is None else self.heard * self.channels

    @cached_property
    def sliding(self) -> Physics:
        """The same, a joint's torque counted only where it moves at a share of its usual speed.

        Around a reversal dry friction holds any torque between two limits, sooner or later than a law
        of velocity says; inertia and weight are as late as the file is.
        """
        speed = np.abs(self.motion.dq)
        heard = (speed > _SLIDES * np.sqrt(np.mean(speed**2, axis=0))).astype(float)
        made = replace(self, heard=heard)
        made.__dict__["acting"] = [
            replace(c, columns=c.columns * h[:, None]) for c, h in zip(self.acting, heard.T, strict=True)
        ]
        return made

    @cached_property
    def left_out(self) -> Array:
        """(PARTS, n) share of each part's energy that the arm of all other parts leaves of it."""
        return left_out(self.columns, self.counted)

    def _other_channels(self, channels: Array, rate: Array) -> Physics:
        """Other channels on the same motion: the columns, which are dear, are kept."""
        made = replace(self, channels=channels, rate=rate, parent=None)
        made.__dict__.update(acting=self.acting, grams=self.grams)
        kept = self.__dict__.keys() & {"columns", "pulled"}
        made.__dict__.update({name: self.__dict__[name] for name in kept})
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
        made = replace(self, motion=motion, channels=channels, rate=rate, own=own)
        made = replace(made, parent=parent, heard=heard)
        if "acting" in self.__dict__:
            made.__dict__["acting"] = [replace(c, columns=c.columns[rows]) for c in self.acting]
        return made

    def with_motion(self, scale: Array, order: NDArray[np.intp], offset: Array | float = 0.0) -> Physics:
        """The hypothesis that joint j's position is scale_j times the channel order_j + offset_j."""
        asked = (*scale.tolist(), *order.tolist(), *np.atleast_1d(offset).tolist())
        if asked not in self._moved:  # of the last one alone, which is asked for several times in turn
            m = self.motion
            q, dq, ddq = (scale * x[:, order] for x in (m.q, m.dq, m.ddq))
            own = None if self.own is None else self.own.moved(scale, order)
            self._moved.clear()
            self._moved[asked] = replace(self, motion=Motion(m.t, q + offset, dq, ddq), own=own)
        return self._moved[asked]

    @cached_property
    def _moved(self) -> dict[tuple[float, ...], Physics]:
        return {}

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
        made = replace(self, motion=motion, rate=self.rate / factor)
        if only_links(self) and self.weight is None:
            made.__dict__["acting"] = slowed(*self.pulled, factor, len(self.model.rigid_indices))
        return made

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
        made = replace(self, weight=tuple(share.tolist()))
        made.__dict__["pulled"] = self.pulled
        return made

    def with_gravity(self, gravity: Sequence[float]) -> Physics:
        """The hypothesis that gravity is this vector in the base frame."""
        made = replace(self, model=turned_gravity(self.model, gravity))
        if "by_gravity" in self.__dict__ and self.weight is None:
            still, *axes = self.by_gravity
            made.__dict__["acting"] = added([(1.0, still), *zip(gravity, axes, strict=True)])
        return made

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
        for j, (k, columns) in enumerate((c.indices, c.columns) for c in self.acting):
            gram, cross = self.grams.each[j][np.ix_(k, k)], columns.T @ self.channels
            explained = np.sum(cross * solve(gram, cross), axis=0)
            out[j] = 1.0 - explained / (len(columns) * self.energy)
        return np.clip(out, 1e-12, 1.0)

    @cached_property
    def form(self) -> Array:
        """(n, n) matrix Q with E = s^T Q s for gains (or signs) s of the channels."""
        gram, cross = self._weighted
        return np.asarray(np.eye(self.n) / self.n - cross.T @ solve(gram, cross), float)

    @cached_property
    def _weighted(self) -> tuple[Array, Array]:
        """(p, p) Gram matrix and (p, n) products with the channels, each of which counts alike."""
        weights = 1.0 / (len(self.channels) * self.energy * self.n)
        return np.tensordot(weights, self.grams.each, 1), weights * self.evidence.cross.T

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
            gram, y = self.grams.each[j], self.channels[:, j]
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
        gram, cross = self._weighted
        rest = np.zeros_like(self.motion.q)
        weightless = turned_gravity(self.model, (0.0, 0.0, 0.0))
        m = self.motion
        pushed = wide_columns(weightless, Motion(m.t, m.q, rest, m.ddq))
        own, rigid = len(self.model.parameters), self.model.rigid_indices
        slope = np.zeros(self.p)
        slope[rigid] = (sum(c.T @ a for c, a in zip(pushed, m.ddq.T, strict=True)) / len(m.t))[rigid]
        if self.p > own:
            slope[own : own + self.n] = np.mean(m.ddq**2, axis=0)
        influence = solve(gram, slope[:, None])[:, 0]
        power = influence @ cross
        variance = self.unexplained / (len(self.channels) * self.n) * OVERSAMPLING
        deviation = np.sqrt(max(variance * float(slope @ influence), 1e-300))
        return np.asarray(power / deviation, float)

    def determined(self, cutoff: float, share: float = 1.0) -> bool:
        """Whether a share of the run, low-passed at ``cutoff`` [Hz], has samples to spare for theta."""
        seconds = float(self.motion.t[-1] - self.motion.t[0])
        return bool(2.0 * cutoff * seconds * share * self.n > _SPARE * self.p)


def settled(many: Iterable[Physics]) -> list[Evidence]:
    """The evidence of each, found side by side."""
    out = [physics.evidence for physics in many]
    settle(out)
    return out
