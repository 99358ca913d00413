"""How well one arm explains a repaired log: the one score by which all hypotheses are compared.

With S_j the squared residual of joint j's torque under one theta for all joints, each joint with noise
of its own, the Gaussian log-likelihood is, up to constants,

    L = -M/2 sum_j log(S_j / |tau_j|^2),

M the number of independent samples. It is free of units and gains. Own columns (friction, rotor,
offset) are projected out of each joint's rows once; what is left couples the joints, as normal equations
that add: of parts of a log, and of several logs. Physics adds what L cannot know: the probability that
inertia and masses are positive and that friction takes power,

    sum log Phi(z),   z = estimate / standard deviation,

which tells a sign from a reversed clock. Prior costs of a repair are the search's matter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.checks.constants import FLOOR, LOUDEST, PARTS, RIDGE, ROUNDS
from sdp_vs_penalty.checks.regression_data import RegressionData, under_gravity
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.robot.arrays import Array, or_one

T = TypeVar("T")


@dataclass(frozen=True)
class Equations:
    """Normal equations of n joints' rows: gram (n, s, s), cross (n, s), energy (n,) of the torque with
    own columns projected out, whole (n,) before; own (n, k, s + 1) what these columns take of the shared
    ones and of the torque."""

    gram: Array
    cross: Array
    energy: Array
    whole: Array
    own: Array

    @classmethod
    def of(cls, full: Array, k: int) -> Equations:
        """full (n, w, w) : Gram matrices of k own columns, the shared ones and the torque."""
        size = np.trace(full[:, :k, :k], axis1=1, axis2=2)[:, None, None] / max(k, 1)
        # A joint that rests in these rows has nothing of its own there.
        mine = full[:, :k, :k] + np.maximum(1e-6 * size, 1e-280) * np.eye(k)
        own = np.linalg.solve(mine, full[:, :k, k:])
        rest = full[:, k:, k:] - full[:, k:, :k] @ own
        energy = np.maximum(rest[:, -1, -1], 0.0)
        return cls(rest[:, :-1, :-1], rest[:, :-1, -1], energy, full[:, -1, -1], own)

    def all_of(self, theta: Array) -> Array:
        """(n, w) factors of own columns, shared ones and the torque, whose sum is the error."""
        mine = self.own[:, :, :-1] @ theta - self.own[:, :, -1]
        shared = np.broadcast_to(np.append(theta, -1.0), (len(mine), len(theta) + 1))
        return np.hstack([-mine, shared])

    def solved(self, weights: Array) -> Array:
        """(s,) parameters of weighted (n,) least squares."""
        return solve(np.tensordot(weights, self.gram, 1), (weights @ self.cross)[:, None])[:, 0]

    def fitted(self, asked: Array) -> tuple[Array, Array]:
        """(s,) parameters at the maximum of L and (n,) squared residuals there, at least FLOOR of the
        whole; asked (n,) 0 for joints that are not."""
        whole = np.maximum(self.whole, 1e-280)
        theta, left = minimised(self.gram, self.cross[None], self.energy[None], whole[None], asked)
        return theta[0], np.maximum(left[0], FLOOR * whole)


@dataclass(frozen=True)
class Rows:
    """What a repair of the motion makes of the rows of n joints: basis (n, M, k) of own columns, raw and
    columns (n, M, s) of shared parameters before and after these are projected out, gram (n, s, s); drag
    (n, M), whose product with the torque less the links' is the mean power that friction takes [W], and
    spin (n, M) likewise ddq^T J ddq of the rotor."""

    basis: Array
    raw: Array
    columns: Array
    gram: Array
    drag: Array
    spin: Array

    def rest(self, y: Array) -> Array:
        """(n, M, K) torques or columns with own columns projected out."""
        return np.asarray(y - self.basis @ (np.swapaxes(self.basis, 1, 2) @ y))


class Likelihood:
    """Of one log's rows: repairs are values that are asked for; what depends on the motion alone is kept
    for repairs of the torque."""

    def __init__(self, data: RegressionData) -> None:
        self.data = data
        self._kept: dict[str, dict[object, Any]] = {}

    def _once(self, kind: str, most: int, key: object, make: Callable[[], T]) -> T:
        """What was made for a key, or is now; of a kind so many are remembered."""
        kept = self._kept.setdefault(kind, {})
        if key not in kept:
            if len(kept) >= most:
                del kept[next(iter(kept))]
            kept[key] = make()
        return cast(T, kept[key])

    # -- what a repair makes of the rows ---------------------------------------------------------

    def channels(self, repair: Repair) -> Array:
        """(n, M) the torque as repaired, 0 where it is not asked for."""
        out = np.empty((self.data.n, self.data.count))
        for j, k in enumerate(repair.tau_order):
            value, rate = self._at(k, repair.lead[j])
            if repair.bend[j]:
                limit = max(float(self.data.largest[k]) / repair.bend[j], 1e-300)  # a dead channel
                value = limit * np.arctanh(np.clip(value / limit, -0.999, 0.999))
            out[j] = repair.gain[j] * (value + repair.lag[j] * rate)
        return out * self._heard(repair)

    def _heard(self, repair: Repair) -> Array:
        return self.data.heard.T[list(repair.order)]

    def _at(self, k: int, lead: float) -> tuple[Array, Array]:
        """Channel k and its rate, so much later [s]."""
        torque, t = self.data.torque, self.data.motion.t + lead
        late = np.clip(t, torque.x[0], torque.x[-1])
        both = self._once("torque", 40, lead, lambda: (torque(late), torque(late, 1)))
        return both[0][:, k], both[1][:, k]

    def motion(self, repair: Repair) -> Motion:
        """States as repaired."""
        m, order, scale = self.data.motion, list(repair.order), np.array(repair.scale)
        dq, ddq = scale * m.dq[:, order] / repair.rate, scale * m.ddq[:, order] / repair.rate**2
        return Motion(m.t[0] + repair.rate * (m.t - m.t[0]), repair.positions(m.q), dq, ddq)

    def rows(self, repair: Repair) -> Rows:
        """What depends on the motion alone, worked out once for repairs of the torque."""

        def make() -> Rows:
            basis, drag, spin = self._own(repair)
            raw = self.raw(repair)
            columns = raw - basis @ (np.swapaxes(basis, 1, 2) @ raw)
            return Rows(basis, raw, columns, np.swapaxes(columns, 1, 2) @ columns, drag, spin)

        return self._once("rows", 6, (repair.motion_key, repair.events, repair.reversed), make)

    def raw(self, repair: Repair) -> Array:
        """(n, M, s) the columns of the parameters that joints share, 0 where torque is not asked for."""
        weight = np.array(repair.weight)[:, None, None]
        columns = self._under(repair, repair.gravity)
        if np.any(weight != 1.0):
            columns = weight * columns + (1.0 - weight) * self._under(repair, (0.0, 0.0, 0.0))
        return np.asarray(self._heard(repair)[:, :, None] * columns)

    def _under(self, repair: Repair, gravity: tuple[float, float, float]) -> Array:
        """(n, M, s) the same of whole channels."""
        keep = self.data.independent
        return self._once(
            "columns", 12, (repair.motion_key[:4], gravity),
            lambda: self._shared(gravity, self.motion(repair))[:, :, keep],
        )  # fmt: skip

    def _shared(self, gravity: Sequence[float], motion: Motion) -> Array:
        """(n, M, p) the columns of all parameters that joints share."""
        shared, width = self.data.shared, len(self.data.independent)
        if shared is None:
            return np.zeros((self.data.n, len(motion.t), 0))
        return np.stack([b.wide(width) for b in under_gravity(shared, gravity).columns(motion)])

    def last_link(self, repair: Repair) -> Array:
        """(n, M, 10) the columns of the last link's parameters."""
        assert self.data.shared is not None
        columns = self._shared(repair.gravity, self.motion(repair))
        return self._heard(repair)[:, :, None] * columns[:, :, self.data.shared.rigid_indices[-10:]]

    def nominal(self, repair: Repair, still: bool) -> Array:
        """(M, n) torque of a plausible arm on the repaired motion, or its weight in these poses."""
        m, shared, none = self.motion(repair), self.data.shared, 0.0 * self.data.motion.q
        if shared is None or not len(shared.rigid_indices):
            return none
        robot = under_gravity(shared, repair.gravity).robot
        states = (m.q, none, none) if still else (m.q, m.dq, m.ddq)
        return np.asarray(robot.regressor(*states) @ self.data.nominal)

    def _own(self, repair: Repair) -> tuple[Array, Array, Array]:
        """(n, M, k) bases of the joints' own columns, 0 for columns that depend on others; (n, M) the
        rows that read the power of friction and of the rotor."""

        def make() -> tuple[Array, Array, Array]:
            data, m, order = self.data, self.data.motion, list(repair.order)
            shapes = [e.shape(m.t) * (np.arange(data.n) == e.joint)[:, None] for e in repair.events]
            columns = np.concatenate([data.own[order], *(x[:, :, None] for x in shapes)], axis=2)
            columns = columns * data.heard.T[order][:, :, None]
            sizes = np.linalg.norm(columns, axis=1, keepdims=True)
            columns = columns / or_one(sizes)
            u, s, vt = np.linalg.svd(columns, full_matrices=False)
            kept = s > 1e-6 * s.max(axis=1, keepdims=True)
            u, back = u * kept[:, None], vt / np.where(kept, s, np.inf)[:, :, None]
            power = np.swapaxes(columns, 1, 2) @ np.stack([m.dq.T[order], m.ddq.T[order]], axis=2)
            # The rotor comes first; it, the offset and events are no friction.
            power[:, [0, 1, *range(data.own.shape[2], columns.shape[2])], 0] = power[:, 1:, 1] = 0.0
            drag, spin = np.moveaxis(u @ (back @ power) / data.count, 2, 0)
            return u, drag, spin

        basis, drag, spin = self._once("own", 20, (repair.order, repair.events), make)
        sign = np.sign(repair.scale)[:, None]
        return basis, drag * (-sign if repair.reversed else sign), spin * sign

    def slope(self, at: Callable[[float], Repair], value: float, h: float, theta: Array) -> Array:
        """(n, M) d(y - Y theta)/dx of a number at a value, by a difference forward."""
        here, there = (self.channels(at(x)) - self.raw(at(x)) @ theta for x in (value, value + h))
        return np.asarray((there - here) / h)

    def parts(self, repair: Repair, count: int = PARTS, more: Array | None = None) -> tuple[Array, int]:
        """(count, n, w, w) Gram matrices of that many parts of the log, which add, and how many of their
        columns are own ones; more (n, M, r) : further columns that joints share."""
        rows, y = self.rows(repair), self.channels(repair)[:, :, None]
        further = y[:, :, :0] if more is None else more
        full = np.concatenate([rows.basis, rows.raw, further, y], axis=2)
        edges = np.linspace(0, self.data.count, count + 1).astype(int)
        parts = [full[:, a:b] for a, b in pairwise(edges.tolist())]
        return np.stack([np.swapaxes(p, 1, 2) @ p for p in parts]), rows.basis.shape[2]

    # -- the likelihood ----------------------------------------------------------------------------

    def scores(self, repairs: Sequence[Repair]) -> list[Score]:
        """One arm fitted to each; those of one motion side by side."""
        groups: dict[object, list[int]] = {}
        for i, r in enumerate(repairs):
            groups.setdefault((r.motion_key, r.events, r.reversed), []).append(i)
        out: dict[int, Score] = {}
        asked = np.where(self.data.moving, 1.0, 0.0)
        for places in groups.values():
            rows = self.rows(repairs[places[0]])
            y = np.stack([self.channels(repairs[i]) for i in places], axis=2)
            rest = rows.rest(y)
            whole = np.sum(y**2, axis=1).T
            whole = np.maximum(whole, 1e-12 * whole.max(axis=1, keepdims=True) + 1e-280)
            cross = np.moveaxis(np.swapaxes(rows.columns, 1, 2) @ rest, 2, 0)
            theta, left = minimised(rows.gram, cross, np.sum(rest**2, axis=1).T, whole, asked)
            for i, *found in zip(places, np.moveaxis(y, 2, 0), theta, left, whole, strict=True):
                out[i] = Score(self, rows, *found)
        return [out[i] for i in range(len(repairs))]

    def score(self, repair: Repair) -> Score:
        """One arm fitted to one repair."""
        return self.scores([repair])[0]

    def left_out(self, repair: Repair) -> Array:
        """(PARTS, n) share of each part's energy that the arm of all other parts leaves of it."""
        (parts, k), weights = self.parts(repair), self.score(repair).weights
        rests = [Equations.of(parts.sum(axis=0) - part, k) for part in parts]
        v = np.stack([rest.all_of(rest.solved(weights)) for rest in rests])
        left = np.einsum("pjw,pjwx,pjx->pj", v, parts, v) / np.maximum(parts[..., -1, -1], 1e-280)
        return np.maximum(left, FLOOR)

    def change(self, at: Callable[[float], Repair], value: float, h: float) -> tuple[float, float]:
        """By how much a number has to change, to first order, and the standard deviation of that.

        By leaving out parts of the log (a delete-a-group jackknife): what the model lacks makes it vary
        from part to part, and noise alone would make it look exact."""
        repair = at(value)
        score = self.score(repair)
        slope = self.slope(at, value, h, score.theta)
        size = float(np.linalg.norm(slope)) / max(float(np.linalg.norm(score.rows.raw[0])), 1e-300)
        if size == 0.0:
            return 0.0, np.inf
        parts, k = self.parts(repair, PARTS, -slope[:, :, None] / size)
        logs = [parts.sum(axis=0), *(parts.sum(axis=0) - parts)]
        best, *found = (float(Equations.of(x, k).solved(score.weights)[-1]) / size for x in logs)
        return best, float(np.sqrt((PARTS - 1) * np.var(found)))

    def pushed(self, repair: Repair) -> Array:
        """(2, s) what the mean of ddq^T M(q) ddq is of the shared parameters, and the weight's mean
        product with the weight of a plausible arm."""

        def make() -> Array:
            m = self.motion(repair)
            rest, loads = np.zeros_like(m.q), self.nominal(repair, still=True)
            ways = (((0.0, 0.0, 0.0), m.ddq, m.ddq), (repair.gravity, rest, loads))
            made = [
                np.einsum("jms,mj->s", self._shared(gravity, Motion(m.t, m.q, rest, ddq)), along)
                for gravity, ddq, along in ways
            ]
            return np.array(made)[:, self.data.independent] / self.data.count

        return self._once("pushed", 6, repair.motion_key, make)


@dataclass
class Score:
    """One arm fitted to one repaired log: channels (n, M), theta (s,), left and whole (n,) [(N m)^2]."""

    of: Likelihood
    rows: Rows
    channels: Array
    theta: Array
    left: Array
    whole: Array

    @property
    def moving(self) -> NDArray[np.bool_]:
        return self.of.data.moving

    @cached_property
    def shares(self) -> Array:
        """(n,) share of each channel's energy that is left over."""
        return np.maximum(self.left / self.whole, FLOOR)

    @cached_property
    def misfit(self) -> float:
        """sum_j log of what is left, of joints that move; without the floor, for the best number."""
        return float(np.log(np.maximum(self.left / self.whole, 1e-9))[self.moving].sum())

    @cached_property
    def score(self) -> float:
        return float(np.log(self.shares)[self.moving].sum())

    @cached_property
    def residual(self) -> Array:
        """(n, M) what the arm leaves of the channels."""
        rest = self.rows.rest(self.channels[:, :, None])[:, :, 0]
        return np.asarray(rest - self.rows.columns @ self.theta)

    @cached_property
    def weights(self) -> Array:
        """(n,) of each joint's rows, 0 where it does not move."""
        return np.where(self.moving, 1.0 / np.maximum(self.left, FLOOR * self.whole), 0.0)

    def physics(self, repair: Repair, samples: float) -> float:
        """log-probability that inertia and masses are positive and friction takes power."""
        from scipy.special import log_ndtr

        rows, away = self.rows, self.channels - self.rows.raw @ self.theta
        slopes = self.of.pushed(repair)
        noise = self.left / samples

        def read(readers: Array) -> tuple[Array, Array, Array]:
            """Of r_j^T (y_j - Y_j theta): value, minus its gradient, variance by noise, each joint."""
            gradient = np.einsum("jm,jms->js", readers, rows.raw)
            return np.sum(readers * away, axis=1), gradient, noise * np.sum(readers**2, axis=1)

        power, drag, shaken = read(rows.drag)
        turned, spin, spun = read(rows.spin)
        values = np.append(power, slopes @ self.theta + [turned.sum(), 0.0])
        gradients = np.vstack([-drag, slopes - [spin.sum(axis=0), 0.0 * spin[0]]])
        normal = np.tensordot(self.weights * samples, rows.gram, 1)
        spread = np.append(shaken, [spun.sum(), 0.0])
        spread += np.sum(gradients.T * solve(normal, gradients.T), axis=0)
        z = values / np.sqrt(np.maximum(spread, 1e-300))
        asked = np.append(self.moving, [True, True])
        return float(np.maximum(log_ndtr(z), -LOUDEST)[asked].sum())


def left_out_alone(score: Score, repair: Repair) -> Array:
    """(n,) share of each channel that its joint's own model leaves of parts it was not fitted to."""
    parts = score.of.parts(repair)[0]
    rests = parts.sum(axis=0) - parts
    v = np.insert(
        solve(rests[..., :-1, :-1], rests[..., :-1, -1:])[..., 0], parts.shape[-1] - 1, -1.0, -1
    )
    return np.maximum(np.einsum("pjw,pjwx,pjx->j", v, parts, v) / score.whole, FLOOR)


def independent_samples(residual: Array, asked: NDArray[np.bool_]) -> float:
    """How many independent samples rows (n, M) hold whose neighbours are alike: M (1 - rho) / (1 + rho)
    of the median lag-1 correlation rho."""
    count = residual.shape[1]
    x = (residual - residual.mean(axis=1, keepdims=True))[asked]
    if count < 4 or not len(x):
        return float(count)
    rho = np.sum(x[:, 1:] * x[:, :-1], axis=1) / np.maximum(np.sum(x * x, axis=1), 1e-300)
    r = float(np.clip(np.median(rho), 0.0, 0.95))
    return count * (1.0 - r) / (1.0 + r)


def solve(gram: Array, right: Array) -> Array:
    """(..., s, r) (G + ridge)^-1 B with columns of G (..., s, s) scaled to one; zero for those that are
    not there."""
    norms = np.sqrt(np.maximum(np.diagonal(gram, axis1=-2, axis2=-1), 0.0))
    seen = norms > 1e-9 * norms.max(axis=-1, keepdims=True, initial=0.0)
    scale = np.where(seen, 1.0 / np.where(seen, norms, 1.0), 0.0)[..., None]
    unit = scale * gram * np.swapaxes(scale, -1, -2)
    np.einsum("...ii->...i", unit)[...] += np.where(seen, RIDGE, 1.0)
    return np.asarray(scale * np.linalg.solve(unit, scale * right))


def minimised(
    gram: Array, cross: Array, energy: Array, whole: Array, asked: Array
) -> tuple[Array, Array]:
    """theta (K, s) and squared residuals (K, n) at the maximum of L, by reweighting each joint.

    gram (n, s, s) of all, cross (K, n, s), energy (K, n) with the own columns projected out, whole (K,
    n) before; asked (n,) 0 for joints that are not.
    """
    theta, left, weights = np.zeros(0), energy, asked / whole
    for _ in range(ROUNDS):
        right = np.einsum("kj,kjs->ks", weights, cross)
        theta = solve(np.tensordot(weights, gram, 1), right[..., None])[..., 0]
        bent = np.einsum("jst,kt->kjs", gram, theta) - 2.0 * cross
        left = np.maximum(energy + np.einsum("kjs,ks->kj", bent, theta), 0.0)
        weights = asked / np.maximum(left, FLOOR * whole)
    return theta, left
