"""How well one arm explains a repaired log: the one score by which all hypotheses are compared.

With S_j the squared residual of joint j's torque under one theta for all joints, each joint with noise
of its own, the Gaussian log-likelihood is, up to constants,

    L = -M/2 sum_j log(S_j / |tau_j|^2),

M the number of independent samples. It is free of units and gains. Own columns (friction, rotor,
offset) are projected out of each joint's rows once; what is left couples the joints. Physics adds what
L cannot know: the probability that inertia is positive and that friction takes power,

    sum log Phi(z),   z = estimate / standard deviation,

which tells a sign from a reversed clock. Prior costs of a repair are the search's matter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from sdp_vs_penalty.checks.columns import under_gravity
from sdp_vs_penalty.checks.regression_data import LEADS, RegressionData
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.robot.arrays import Array

#: Relative ridge of the normal equations: directions that the motion does not excite stay quiet.
_RIDGE = 1e-9
#: A residual below 0.3 % of the torque is explained: friction laws and filters are no better.
FLOOR = 1e-5
#: Rounds of reweighting each joint by its own residual.
_ROUNDS = 3
#: Parts of the log that are left out in turn.
PARTS = 8
#: Physics may speak with so much (natural logarithm) on each joint: estimates of friction are rough.
_LOUDEST = 60.0


@dataclass(frozen=True)
class Joint:
    """One joint's rows: basis (M, k) of its own columns; columns (M, s) of shared parameters with the
    own ones projected out; drag (M,), whose product with the torque less the links' is the mean power
    that friction takes [W]; spin (M,) likewise ddq^T J ddq of the rotor; raw (M, s) before the
    projection."""

    basis: Array
    columns: Array
    raw: Array
    drag: Array
    spin: Array


class Likelihood:
    """Of one log's rows: repairs are values that are asked for; what depends on the motion alone is kept
    for repairs of the torque."""

    def __init__(self, data: RegressionData) -> None:
        self.data = data
        #: By motion what tells inertia and weight, see :class:`Score`.
        self.pushed: dict[object, tuple[Array, Array]] = {}
        self._joints: dict[object, list[Joint]] = {}
        self._normal: dict[object, Array] = {}
        self._bases: dict[object, tuple[Array, Array, Array]] = {}
        self._columns: dict[object, list[Array]] = {}
        self._channels: dict[tuple[int, float], tuple[Array, Array]] = {}

    def forget(self) -> None:
        """Let go of what was kept for the next repair: it can be worked out again."""
        for kept in (
            self.pushed, self._joints, self._normal, self._bases, self._columns, self._channels
        ):  # fmt: skip
            kept.clear()  # type: ignore[attr-defined]

    # -- what a repair makes of the rows ---------------------------------------------------------

    def channels(self, repair: Repair) -> Array:
        """(M, n) the torque as repaired, 0 where it is not asked for."""
        out = np.empty((self.data.count, self.data.n))
        for j, k in enumerate(repair.tau_order):
            value, rate = self._at(k, repair.lead[j])
            out[:, j] = repair.gain[j] * (value + repair.lag[j] * rate)
        return out * self._heard(repair)

    def _heard(self, repair: Repair) -> Array:
        return self.data.heard[:, list(repair.order)]

    def _at(self, k: int, lead: float) -> tuple[Array, Array]:
        """Channel k and its rate, so much later [s]: cubic between the leads that were filtered."""
        if (k, lead) not in self._channels:
            _keep(self._channels, (k, lead), self._interpolated(k, lead), 200)
        return self._channels[k, lead]

    def _interpolated(self, k: int, lead: float) -> tuple[Array, Array]:
        x, dx = self.data.torque[:, :, k], self.data.rate[:, :, k]
        i = int(np.clip(np.searchsorted(LEADS, lead, "right") - 1, 0, len(LEADS) - 2))
        h = float(LEADS[1] - LEADS[0])
        u = (lead - float(LEADS[i])) / h
        a, b = (1.0 + 2.0 * u) * (1.0 - u) ** 2, u**2 * (3.0 - 2.0 * u)
        value = a * x[i] + b * x[i + 1] + h * (u * (1.0 - u) ** 2 * dx[i] - u**2 * (1.0 - u) * dx[i + 1])
        return value, (1.0 - u) * dx[i] + u * dx[i + 1]

    def motion(self, repair: Repair) -> Motion:
        """States as repaired."""
        m, order, scale = self.data.motion, list(repair.order), np.array(repair.scale)
        dq, ddq = scale * m.dq[:, order] / repair.rate, scale * m.ddq[:, order] / repair.rate**2
        return Motion(m.t[0] + repair.rate * (m.t - m.t[0]), repair.positions(m.q), dq, ddq)

    def joints(self, repair: Repair) -> list[Joint]:
        """The joints' rows under a repair of the motion."""
        key = repair.motion_key, repair.events, repair.reversed
        if key not in self._joints:
            heard, made = self._heard(repair), []
            columns = self._shared(repair)
            for j in range(self.data.n):
                basis, drag, spin = self._own(repair, j)
                raw = heard[:, j : j + 1] * columns[j]
                made.append(Joint(basis, raw - basis @ (basis.T @ raw), raw, drag, spin))
            _keep(self._joints, key, made)
        return self._joints[key]

    def _shared(self, repair: Repair) -> list[Array]:
        """Per joint (M, s) the columns of the parameters that joints share."""
        shared, keep = self.data.shared, self.data.independent
        if shared is None:
            return [np.zeros((self.data.count, 0))] * self.data.n
        still = repair.motion_key[:4]
        needed = [(0.0, 0.0, 0.0), *([repair.gravity] if any(repair.gravity) else [])]
        if all(w == 1.0 for w in repair.weight):
            needed = [repair.gravity]
        made = []
        for gravity in needed:
            key = still, gravity
            if key not in self._columns:
                blocks = under_gravity(shared, gravity).columns(self.motion(repair))
                _keep(self._columns, key, [b.wide(len(keep))[:, keep] for b in blocks], 12)
            else:
                self._columns[key] = self._columns.pop(key)
            made.append(self._columns[key])
        if len(made) == 1:
            return made[0]
        return [w * b + (1.0 - w) * a for w, a, b in zip(repair.weight, *made, strict=True)]

    def last_link(self, repair: Repair) -> list[Array]:
        """Per joint (M, 10) the columns of the last link's parameters, own columns projected out."""
        assert self.data.shared is not None
        model, heard, out = under_gravity(self.data.shared, repair.gravity), self._heard(repair), []
        blocks = model.columns(self.motion(repair))
        for j, (b, x) in enumerate(zip(blocks, self.joints(repair), strict=True)):
            c = heard[:, j, None] * b.wide(len(self.data.independent))[:, model.rigid_indices[-10:]]
            out.append(c - x.basis @ (x.basis.T @ c))
        return out

    def nominal_weight(self, repair: Repair) -> Array:
        """(M, n) the weight of a plausible arm at the repaired positions."""
        m, shared = self.motion(repair), self.data.shared
        rest = np.zeros_like(m.q)
        if shared is None or not len(shared.rigid_indices):
            return rest
        robot = under_gravity(shared, repair.gravity).robot
        return np.asarray(robot.regressor(m.q, rest, rest) @ self.data.nominal)

    def _own(self, repair: Repair, j: int) -> tuple[Array, Array, Array]:
        """Basis of a joint's own columns as repaired, and the rows that read friction and rotor."""
        k, events = repair.order[j], tuple(e for e in repair.events if e.joint == j)
        key = k, events
        if key not in self._bases:
            data, heard = self.data, self.data.heard[:, k]
            t = data.motion.t
            more = [
                (t - t[0]) / max(t[-1] - t[0], 1e-300) if e.at is None else (t > e.at) * 1.0
                for e in events
            ]
            columns = heard[:, None] * np.column_stack([data.own[k], *more])
            sizes = np.linalg.norm(columns, axis=0)
            columns = columns / np.where(sizes > 0.0, sizes, 1.0)
            u, s, vt = np.linalg.svd(columns, full_matrices=False)
            kept = s > 1e-6 * s.max(initial=0.0)
            u, back = u[:, kept], (vt[kept] / s[kept, None]).T
            dq, ddq = data.motion.dq[:, k] * heard, data.motion.ddq[:, k] * heard
            friction = columns.T @ dq / data.count
            friction[[0, 1]] = 0.0
            friction[data.own.shape[2] :] = 0.0
            rotor = np.zeros(len(friction))
            rotor[0] = (columns.T @ ddq)[0] / data.count
            self._bases[key] = u, u @ (back.T @ friction), u @ (back.T @ rotor)
        basis, drag, spin = self._bases[key]
        turned = np.sign(repair.scale[j]) * (-1.0 if repair.reversed else 1.0)
        return basis, turned * drag, np.sign(repair.scale[j]) * spin

    def slope(self, at: Callable[[float], Repair], value: float, h: float, theta: Array) -> Array:
        """(M, n) d(y - Y theta)/dx of a number at a value, by central differences."""
        ends = []
        for x in (value + h, value - h):
            raw = [j.raw @ theta for j in self.joints(at(x))]
            ends.append(self.channels(at(x)) - np.column_stack(raw))
        return np.asarray((ends[0] - ends[1]) / (2.0 * h))

    # -- the likelihood ----------------------------------------------------------------------------

    def scores(self, repairs: Sequence[Repair]) -> list[Score]:
        """One arm fitted to each; those of one motion side by side."""
        groups: dict[object, list[int]] = {}
        for i, r in enumerate(repairs):
            groups.setdefault((r.motion_key, r.events, r.reversed), []).append(i)
        out: dict[int, Score] = {}
        for places in groups.values():
            joints = self.joints(repairs[places[0]])
            key = repairs[places[0]].motion_key, repairs[places[0]].events
            if key not in self._normal:
                _keep(self._normal, key, np.stack([j.columns.T @ j.columns for j in joints]))
            y = np.stack([self.channels(repairs[i]) for i in places])
            for i, score in zip(places, self._solve(joints, self._normal[key], y), strict=True):
                out[i] = score
        return [out[i] for i in range(len(repairs))]

    def _solve(self, joints: list[Joint], gram: Array, y: Array) -> list[Score]:
        """gram (n, s, s); y (K, M, n)."""
        whole = np.einsum("kmj,kmj->kj", y, y)
        floor = 1e-12 * whole.max(axis=1, keepdims=True) + 1e-280
        whole = np.maximum(whole, floor)
        rest = np.stack(
            [y[:, :, j] - (y[:, :, j] @ x.basis) @ x.basis.T for j, x in enumerate(joints)], axis=1
        )
        cross = np.stack([rest[:, j] @ x.columns for j, x in enumerate(joints)], axis=1)
        energy = np.maximum(np.einsum("kjm,kjm->kj", rest, rest), 0.0)
        heard = np.where(self.data.moving, 1.0, 0.0)
        theta, left = minimised(gram, cross, energy, whole, heard)
        return [Score(self, joints, gram, *parts) for parts in zip(y, theta, left, whole, strict=True)]

    def left_out(self, repair: Repair) -> Array:
        """(PARTS, n) share of each part's energy that the arm of all other parts leaves of it."""
        joints, y = self.joints(repair), self.channels(repair)
        edges = np.linspace(0, self.data.count, PARTS + 1).astype(int)
        columns = [np.hstack([x.basis, x.raw]) for x in joints]
        out = np.empty((PARTS, self.data.n))
        grams = [_by_part(c, y[:, j], edges) for j, c in enumerate(columns)]
        widths = np.array([x.basis.shape[1] for x in joints])
        score = self.scores([repair])[0]
        weights = np.where(self.data.moving, 1.0 / np.maximum(score.left, FLOOR * score.whole), 0.0)
        for k in range(PARTS):
            theta, own = joint_fit(
                [g.sum(axis=0) - g[k] for g, *_ in grams],
                [c.sum(axis=0) - c[k] for _, c, _ in grams],
                widths,
                weights,
            )
            for j, (g, c, e) in enumerate(grams):
                x = np.concatenate([own[j], theta])
                left = e[k] - 2.0 * c[k] @ x + x @ g[k] @ x
                out[k, j] = max(left / max(e[k], 1e-280), FLOOR)
        return out


def left_out_alone(score: Score) -> Array:
    """(n,) share of each channel that its joint's own model leaves of parts that it was not fitted
    to.
    """
    data, out = score.of.data, np.ones(len(score.joints))
    edges = np.linspace(0, data.count, PARTS + 1).astype(int)
    for j, x in enumerate(score.joints):
        columns = np.hstack([x.basis, x.columns])
        gram, cross, energy = _by_part(columns, score.channels[:, j], edges)
        left = 0.0
        for k in range(PARTS):
            theta = solve(gram.sum(axis=0) - gram[k], cross.sum(axis=0) - cross[k])
            left += energy[k] - 2.0 * cross[k] @ theta + theta @ gram[k] @ theta
        out[j] = max(left / score.whole[j], FLOOR)
    return out


def _keep(kept: dict[Any, Any], key: object, value: object, most: int = 6) -> None:
    """Remember a value, and no more than so many of them."""
    if len(kept) >= most:
        del kept[next(iter(kept))]
    kept[key] = value


def _by_part(columns: Array, y: Array, edges: Array) -> tuple[Array, Array, Array]:
    """Normal equations of each part of the rows."""
    parts = [slice(a, b) for a, b in pairwise(edges.tolist())]
    gram = np.stack([columns[p].T @ columns[p] for p in parts])
    cross = np.stack([columns[p].T @ y[p] for p in parts])
    return gram, cross, np.array([y[p] @ y[p] for p in parts])


def joint_fit(
    grams: list[Array], crosses: list[Array], widths: Array, weights: Array
) -> tuple[Array, list[Array]]:
    """Shared and own parameters from normal equations whose first ``widths[j]`` are joint j's own."""
    s = grams[0].shape[0] - int(widths[0])
    total, right, back = np.zeros((s, s)), np.zeros(s), []
    for g, c, k, w in zip(grams, crosses, widths.tolist(), weights, strict=True):
        # A joint that rests in these rows has nothing of its own there.
        ridge = max(1e-6 * float(np.trace(g[:k, :k])) / max(k, 1), 1e-280)
        own = g[:k, :k] + ridge * np.eye(k)
        solved = np.linalg.solve(own, np.column_stack([g[:k, k:], c[:k]])) if k else np.zeros((0, s + 1))
        total += w * (g[k:, k:] - g[k:, :k] @ solved[:, :-1])
        right += w * (c[k:] - g[k:, :k] @ solved[:, -1])
        back.append(solved)
    theta = solve(total, right)
    return theta, [b[:, -1] - b[:, :-1] @ theta for b in back]


def solve(gram: Array, right: Array) -> Array:
    """(G + ridge)^-1 b with columns scaled to one; zero for columns that are not there."""
    norms = np.sqrt(np.maximum(np.diagonal(gram), 0.0))
    seen = np.flatnonzero(norms > 1e-9 * norms.max(initial=0.0))
    out = np.zeros_like(right)
    if len(seen):
        scale = 1.0 / norms[seen]
        unit = scale[:, None] * gram[np.ix_(seen, seen)] * scale + _RIDGE * np.eye(len(seen))
        out[seen] = (np.linalg.solve(unit, (scale * right[seen].T).T).T * scale).T
    return out


def minimised(
    gram: Array, cross: Array, energy: Array, whole: Array, heard: Array
) -> tuple[Array, Array]:
    """theta (K, s) and squared residuals (K, n) at the maximum of L, by reweighting each joint.

    gram (n, s, s) of all, cross (K, n, s), energy (K, n) with the own columns projected out, whole (K,
    n) before; heard (n,) 0 for joints that are not asked.
    """
    k, n, s = cross.shape
    theta, left = np.zeros((k, s)), energy.copy()
    if not s:
        return theta, left
    flat, sizes = gram.reshape(n, s * s), np.diagonal(gram, axis1=1, axis2=2)
    weights = heard / whole
    for _ in range(_ROUNDS):
        normal = (weights @ flat).reshape(k, s, s)
        norms = np.sqrt(np.maximum(weights @ sizes, 0.0))
        seen = norms > 1e-9 * norms.max(axis=1, keepdims=True, initial=0.0)
        scale = np.where(seen, 1.0 / np.where(seen, norms, 1.0), 0.0)
        normal *= scale[:, :, None]
        normal *= scale[:, None, :]
        normal.reshape(k, -1)[:, :: s + 1] += np.where(seen, _RIDGE, 1.0)
        right = scale * np.einsum("kj,kjs->ks", weights, cross)
        theta = scale * np.linalg.solve(normal, right[..., None])[..., 0]
        bent = np.einsum("jst,kt->kjs", gram, theta) - 2.0 * cross
        left = np.maximum(energy + np.einsum("kjs,ks->kj", bent, theta), 0.0)
        weights = heard / np.maximum(left, FLOOR * whole)
    return theta, left


@dataclass
class Score:
    """One arm fitted to one repaired log."""

    of: Likelihood
    joints: list[Joint]
    gram: Array
    channels: Array
    theta: Array
    left: Array
    whole: Array

    @cached_property
    def shares(self) -> Array:
        """(n,) share of each channel's energy that is left over."""
        return np.maximum(self.left / self.whole, FLOOR)

    @cached_property
    def misfit(self) -> float:
        """sum_j log of what is left, of joints that move; without the floor, for the best number."""
        return float(np.log(np.maximum(self.left / self.whole, 1e-9))[self.of.data.moving].sum())

    @cached_property
    def score(self) -> float:
        return float(np.log(self.shares)[self.of.data.moving].sum())

    @cached_property
    def alone(self) -> Array:
        """(n,) share with a theta of its own for each joint: no arm does better."""
        out = np.ones(len(self.joints))
        for j, x in enumerate(self.joints):
            y = self.channels[:, j] - x.basis @ (x.basis.T @ self.channels[:, j])
            fit = solve(self.gram[j], x.columns.T @ y)
            out[j] = max(float(y @ y - fit @ (x.columns.T @ y)), 0.0)
        return np.maximum(out / self.whole, FLOOR)

    @cached_property
    def residual(self) -> Array:
        """(M, n) what the arm leaves of the channels."""
        rest = [
            y - x.basis @ (x.basis.T @ y) - x.columns @ self.theta
            for y, x in zip(self.channels.T, self.joints, strict=True)
        ]
        return np.column_stack(rest)

    def _z(self, slope: Array, readers: Array, samples: float) -> float:
        """Of a mean power slope^T theta + sum_j r_j^T (y_j - S_j theta), readers r (M, n): over its
        standard deviation."""
        value, gradient, spread = float(slope @ self.theta), slope.copy(), 0.0
        for x, r, y, left in zip(self.joints, readers.T, self.channels.T, self.left, strict=True):
            if r.any():
                value += float(r @ (y - x.raw @ self.theta))
                gradient -= x.raw.T @ r
                spread += float(left / samples * (r @ r))
        normal = np.tensordot(self._weights * samples, self.gram, 1)
        spread += float(gradient @ solve(normal, gradient))
        return value / np.sqrt(max(spread, 1e-300))

    def newton(self, slope: Array) -> float:
        """The step of a number whose change makes d(y - Y theta)/dx = slope (M, n), to first order; 0
        where nothing tells of it."""
        weights, right, size, pull = self._weights, np.zeros(len(self.theta)), 0.0, 0.0
        for x, d, r, w in zip(self.joints, slope.T, self.residual.T, weights, strict=True):
            d = d - x.basis @ (x.basis.T @ d)
            right, size, pull = right + w * (x.columns.T @ d), size + w * (d @ d), pull + w * (d @ r)
        left = size - right @ solve(np.tensordot(weights, self.gram, 1), right)
        return float(-pull / left) if left > 1e-3 * size > 0.0 else 0.0

    @property
    def _weights(self) -> Array:
        return self.of.data.moving / np.maximum(self.left, FLOOR * self.whole)

    def friction(self, samples: float) -> Array:
        """(n,) z of the mean power that each joint's friction takes; 0 where a joint is not asked."""
        drag, zero = np.column_stack([x.drag for x in self.joints]), np.zeros(len(self.theta))
        one = np.eye(len(self.joints))
        asked = self.of.data.moving
        return np.array(
            [self._z(zero, drag * one[j], samples) if asked[j] else 0.0 for j in range(len(asked))]
        )

    def inertia(self, repair: Repair, samples: float) -> float:
        """z of the mean of ddq^T M(q) ddq of the fitted arm, rotors included."""
        return self._z(self._pushed(repair)[0], np.column_stack([x.spin for x in self.joints]), samples)

    def weight(self, repair: Repair, samples: float) -> float:
        """z of the fitted weight's component along that of a nominal arm: masses are positive."""
        return self._z(self._pushed(repair)[1], np.zeros_like(self.channels), samples)

    def _pushed(self, repair: Repair) -> tuple[Array, Array]:
        """(s,) what the mean of ddq^T M(q) ddq is of the shared parameters, and the weight's mean
        product with the nominal weight."""
        data, key = self.of.data, repair.motion_key
        if data.shared is None:
            return np.zeros(0), np.zeros(0)
        if key not in self.of.pushed:
            m, keep, made = self.of.motion(repair), data.independent, []
            rest, loads = np.zeros_like(m.q), self.of.nominal_weight(repair)
            ways = (((0.0, 0.0, 0.0), m.ddq, m.ddq), (repair.gravity, rest, loads))
            for gravity, ddq, along in ways:
                blocks = under_gravity(data.shared, gravity).columns(Motion(m.t, m.q, rest, ddq))
                some = zip(blocks, along.T, strict=True)
                made.append(sum(b.wide(len(keep))[:, keep].T @ a for b, a in some) / data.count)
            _keep(self.of.pushed, key, (made[0], made[1]))
        return self.of.pushed[key]


def log_phi(z: Array | float) -> Array:
    """log of the normal distribution's cumulative function, at least -_LOUDEST."""
    from scipy.special import log_ndtr

    return np.maximum(np.asarray(log_ndtr(z), float), -_LOUDEST)


def physics(score: Score, repair: Repair, samples: float) -> float:
    """log-probability that inertia and masses are positive and friction takes power."""
    return float(
        log_phi(score.inertia(repair, samples))
        + log_phi(score.weight(repair, samples))
        + log_phi(score.friction(samples))[score.of.data.moving].sum()
    )


def independent_samples(residual: Array, heard: Iterable[bool]) -> float:
    """How many independent samples rows (M, n) hold whose neighbours are alike: M (1 - rho) / (1 + rho)
    of the median lag-1 correlation rho."""
    count = len(residual)
    x = residual - residual.mean(axis=0)
    x = x[:, np.array(list(heard), bool)]
    if count < 4 or not x.shape[1]:
        return float(count)
    rho = np.sum(x[1:] * x[:-1], axis=0) / np.maximum(np.sum(x * x, axis=0), 1e-300)
    r = float(np.clip(np.median(rho), 0.0, 0.95))
    return count * (1.0 - r) / (1.0 + r)


def deviation(of: Likelihood, at: Callable[[float], Repair], value: float, usual: float) -> float:
    """Standard deviation of a number, by leaving out parts of the log.

    What the model lacks makes a number wrong by as much as it varies from part to part; noise alone
    would make it look exact. To first order the number is one column more beside the arm's, d(y - Y
    theta)/dx; leaving out parts in turn (a delete-a-group jackknife) moves its size.
    """
    here = at(value)
    (score,) = of.scores([here])
    slope = of.slope(at, value, 0.3 * usual, score.theta)
    scale = float(np.linalg.norm(slope)) / max(float(np.linalg.norm(of.joints(here)[0].raw)), 1e-300)
    if scale == 0.0:
        return np.inf
    slope = slope / scale
    joints, residual = of.joints(here), score.channels
    edges = np.linspace(0, of.data.count, PARTS + 1).astype(int)
    columns = [np.hstack([x.basis, x.raw, -slope[:, j : j + 1]]) for j, x in enumerate(joints)]
    grams = [_by_part(c, residual[:, j], edges) for j, c in enumerate(columns)]
    widths = np.array([x.basis.shape[1] for x in joints])
    found = []
    for k in range(PARTS):
        some = [(g.sum(axis=0) - g[k], c.sum(axis=0) - c[k]) for g, c, _ in grams]
        left, right = [g for g, _ in some], [c for _, c in some]
        found.append(float(joint_fit(left, right, widths, score._weights)[0][-1]))
    spread = np.array(found)
    return float(np.sqrt((PARTS - 1) / PARTS * np.sum((spread - spread.mean()) ** 2))) / scale
