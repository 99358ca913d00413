"""How much of the residual a candidate explains, in sample and out of it.

Everything is small linear algebra on sums over the white rows of a :class:`~.fit.WhiteFit`.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.fit import ROUNDING, WhiteFit
from sdp_vs_penalty.diagnosis.library import Library, grams
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class Scores:
    """Of every group: chi2 (the drop of the squared residual), absorbed share of its energy; by batch
    what they follow from (None: not asked for); spread : of those on several joints, joint by joint."""

    chi2: Array
    absorbed: Array
    batches: tuple[Solved | None, ...]
    spread: Spread


@dataclass(frozen=True)
class Solved:
    """Of the groups of a batch: coefficients beta (G, k), partialled gram (G, k, k) and z'r (G, k)."""

    beta: Array
    gram: Array
    pull: Array


@dataclass(frozen=True)
class Spread:
    """Of columns z that act on several joints, joint by joint: Q_j'z_j (n, r, C) and z_j'r_j (n, C)."""

    overlaps: Array
    pulls: Array

    def left(self, fit: WhiteFit, columns: NDArray[np.intp], gram: Array, beta: Array) -> Array:
        """(n, G) squared weighted residual that groups of columns (G, k) leave with coefficients beta
        (G, k), in units of noise; gram (n, G, k, k) : z_j'z_j."""
        G, k = columns.shape
        own = self.overlaps[:, :, columns.ravel()].reshape(*self.overlaps.shape[:2], G, k)
        c = np.einsum("nrgk,gk->nrg", own, beta)
        total, (H, p) = c.sum(axis=0), fit.joint_products
        cross = p @ total - np.einsum("ngk,gk->ng", self.pulls[:, columns], beta)
        cross -= np.einsum("nrg,rg->ng", c, total)
        squares = np.einsum("gk,ngkl,gl->ng", beta, gram, beta)
        squares += np.einsum("rg,nrg->ng", total, H @ total) + 2.0 * cross
        return fit.joint_chi2[:, None] + fit.weighting.level[:, None] ** 2 * squares


def score_library(fit: WhiteFit, library: Library, on: Set[int] | None = None) -> Scores:
    """Score all groups of a library, white and scaled like the fit's rows; on : only those on these
    joints or several, nothing is said of the others.

    Coefficients that are known beforehand are held by that: as penalised least squares has them.
    """
    spread = Spread(fit.overlaps(library, None), fit.pulls(library, None))
    robot = spread.overlaps.sum(axis=0), spread.pulls.sum(axis=0)
    chi2, absorbed = np.zeros(len(library.groups)), np.ones(len(library.groups))
    batches: list[Solved | None] = []
    for batch, own in zip(library.batches, library.grams, strict=True):
        j = batch.joint
        if j is None:
            (overlaps, pulls), gram = robot, own.sum(axis=0)
        elif on is None or j in on:
            overlaps, pulls, gram = fit.overlaps(library, j), fit.pulls(library, j), own
        else:
            batches.append(None)
            continue
        pull, raw = pulls[batch.columns], np.diagonal(gram, axis1=1, axis2=2)
        left = gram - grams(overlaps[:, batch.columns.ravel()], len(gram))
        found = solve_groups(left, raw, pull, batch.signed, batch.known)
        chi2[batch.groups], absorbed[batch.groups] = found[0], found[2]
        batches.append(Solved(found[1], left, pull))
    return Scores(chi2, absorbed, tuple(batches), spread)


def solve_group(
    gram: Array, raw: Array, right: Array, signed: bool, known: Array | None = None
) -> tuple[float, Array, float]:
    """chi2, coefficients and absorbed share from partialled gram (k, k), raw energies, z'r (k,)."""
    if len(raw) == 1:  # what a search asks most often
        left, energy, pull = float(gram[0, 0]), float(raw[0]), float(right[0])
        if not energy > 0.0:
            return 0.0, np.zeros(1), 1.0
        used = left > ROUNDING * energy and not (signed and pull < 0.0)
        b = pull / left if used else 0.0
        return b * pull, np.array([b]), min(max(1.0 - left / energy, 0.0), 1.0)
    chi2, beta, absorbed = solve_groups(gram[None], raw[None], right[None], signed, known)
    return float(chi2[0]), beta[0], float(absorbed[0])


def solve_groups(
    gram: Array, raw: Array, right: Array, signed: bool, known: Array | None = None
) -> tuple[Array, Array, Array]:
    """chi2 (G,), coefficients (G, k), absorbed shares (G,) of G groups of k columns.

    From partialled grams (G, k, k), raw energies (G, k) and z'r (G, k); ``signed`` : a single
    coefficient that may not be negative; known (k,) : coefficients' standard deviations about zero
    beforehand, whose information is added to that of the rows.
    """
    energy = raw.sum(axis=1)
    alive = energy > 0.0
    safe = np.where(alive, energy, 1.0)
    trace = np.trace(gram, axis1=1, axis2=2)
    absorbed = np.where(alive, np.clip(1.0 - trace / safe, 0.0, 1.0), 1.0)
    if raw.shape[1] == 1:
        left, pull = gram[:, 0, 0], right[:, 0]
        used = alive & (left > ROUNDING * energy) & ~(signed & (pull < 0.0))
        beta = np.where(used, pull / np.where(used, left, 1.0), 0.0)
        return beta * pull, beta[:, None], absorbed
    if known is not None:  # scales what has no energy, too: a vertical axis feels no height
        gram, raw = gram + np.diag(known**-2.0), raw + known**-2.0
    scale = 1.0 / np.sqrt(np.maximum(raw, 1e-300))
    values, vectors = np.linalg.eigh(gram * scale[:, :, None] * scale[:, None, :])
    good = (values > ROUNDING) & alive[:, None]
    part = np.where(good, np.einsum("gij,gi->gj", vectors, right * scale), 0.0)
    weighted = part / np.where(good, values, 1.0)
    beta = np.where(alive[:, None], scale * np.einsum("gij,gj->gi", vectors, weighted), 0.0)
    return np.sum(part * weighted, axis=1), beta, absorbed


@dataclass(frozen=True)
class Beside:
    """Weighted columns z of an effect beside the basis Q of a fit: C = Q'z (r, k), what Q leaves of
    their gram (k, k), their raw energies and z'r (k,); own : z by joint, of those that it acts on."""

    C: Array
    gram: Array
    raw: Array
    right: Array
    own: dict[int, Array]

    @classmethod
    def of(cls, fit: WhiteFit, columns: Array) -> Beside:
        """From white columns (n M, k)."""
        M = len(fit.rows.block)
        parts = enumerate(columns.reshape(fit.rows.n, M, -1))
        return cls.on(fit, {j: fit.weighting.apply(z, j) for j, z in parts if z.any()}, columns.shape[1])

    @classmethod
    def on(cls, fit: WhiteFit, own: dict[int, Array], k: int) -> Beside:
        """From weighted columns (M, k) of some joints."""
        M, C = len(fit.rows.block), np.zeros((fit.Q.shape[1], k))
        gram, raw, right = np.zeros((k, k)), np.zeros(k), np.zeros(k)
        for j, z in own.items():
            mine = slice(j * M, (j + 1) * M)
            C += fit.Q[mine].T @ z
            gram += z.T @ z
            raw += np.einsum("mk,mk->k", z, z)
            right += z.T @ fit.residual[mine]
        return cls(C, gram - C.T @ C, raw, right, own)

    def solved(self, effect: Effect) -> tuple[float, Array]:
        """chi2 and coefficients."""
        chi2, beta, _ = solve_group(self.gram, self.raw, self.right, signed(effect), effect.plausible)
        if np.any(beta[bounded(effect)] < 0.0):
            return passive(self.gram, self.right)
        return chi2, beta

    def left(self, fit: WhiteFit, beta: Array) -> Array:
        """(n,) squared weighted residual of each joint that these coefficients leave, in units of noise:
        of joints on which it does not act, from what the model takes up alone."""
        M, c = len(fit.rows.block), self.C @ beta
        grams, pulls = fit.joint_products
        squares = fit.joint_chi2 / fit.weighting.level**2 + 2.0 * pulls @ c + (grams @ c) @ c
        for j, z in self.own.items():
            mine = slice(j * M, (j + 1) * M)
            left = fit.residual[mine] - z @ beta + fit.Q[mine] @ c
            squares[j] = left @ left
        return fit.weighting.level**2 * squares


def passive(gram: Array, right: Array) -> tuple[float, Array]:
    """chi2 and coefficients of non-negative least squares (Lawson and Hanson 1974), from the partialled
    gram (k, k) and z'r (k,)."""
    from scipy.optimize import nnls

    values, vectors = np.linalg.eigh(gram)
    kept = values > ROUNDING * values[-1]
    root = (vectors[:, kept] * np.sqrt(values[kept])).T
    beta = nnls(root, (vectors[:, kept].T @ right) / np.sqrt(values[kept]))[0]
    return float(2.0 * beta @ right - beta @ gram @ beta), beta


def bounded(effect: Effect) -> list[bool]:
    """Which of its parameters may not be negative."""
    return [p.lower == 0.0 for p in effect.parameters]


def signed(effect: Effect) -> bool:
    """Whether an effect has one coefficient, which may not be negative."""
    parameters = effect.parameters
    return len(parameters) == 1 and parameters[0].lower == 0.0


def evidence(chi2: Array | float, k: Array | float) -> Array:
    """Twice the log Bayes factor for k columns against none, chi2 their drop of the squared residual.

    Zellner's g-prior with g chosen by the data (local empirical Bayes, George and Foster 2000):
    chi2 - k - k log(chi2 / k), zero below chi2 = k.
    """
    ratio = np.maximum(np.asarray(chi2, float) / k, 1.0)
    return k * (ratio - 1.0 - np.log(ratio))


def averaged(values: Array, sizes: NDArray[np.intp]) -> list[float]:
    """2 log of the mean Bayes factor over shapes, of as many values in a row as ``sizes`` says: what a
    free shape constant costs is built in."""
    starts = np.cumsum(sizes) - sizes
    top = np.maximum(np.maximum.reduceat(values, starts), 0.0) if len(sizes) else np.zeros(0)
    shares = np.exp(0.5 * (values - np.repeat(top, sizes)))
    mean = np.add.reduceat(shares, starts) / sizes if len(sizes) else top
    return list((top + 2.0 * np.log(mean)).tolist())


def effective(gram: Array, known: Array | None) -> float:
    """How many of k coefficients the rows determine, rather than what is ``known`` of them: trace of
    G (G + diag(1 / known^2))^-1, with their partialled gram G (k, k)."""
    if known is None:
        return float(len(gram))
    return float(np.trace(np.linalg.solve(gram + np.diag(known**-2.0), gram)))


def cross_validate(
    fit: WhiteFit,
    shapes: Sequence[Array],
    signed: bool,
    folds: NDArray[np.intp],
    known: Array | None = None,
) -> Array:
    """(B,) gain of each block in squared white residual, from fits on the other folds.

    shapes : white columns (n M, k) of one candidate with different shape constants; each fold
    takes the one that explains its own training data best. folds : (M,) labels.
    """
    gain, M = np.zeros(len(fit.target)), len(fit.rows.block)
    acts = np.any([np.any(Z.reshape(fit.rows.n, -1), axis=1) for Z in shapes], axis=0)
    joints = np.flatnonzero(acts)  # all rows of these columns outside of theirs are zero
    part = slice(M * int(joints[0]), M * int(joints[-1] + 1)) if len(joints) else slice(0)
    mine = np.zeros(len(fit.target), bool)
    mine[part] = True
    own, Q, target = [Z[part] for Z in shapes], fit.Q[part], fit.target[part]
    whole = [(Z, Q.T @ Z, Z.T @ Z, Z.T @ target, np.sum(Z**2, axis=0)) for Z in own]
    for f in fit.without_folds(folds):
        here, there = f.out[part], mine[f.out]
        Q_out, target_out = f.Q[there], f.target[there]
        best, change = 0.0, np.zeros(len(f.error))
        for Z, overlap, square, right, raw in whole:
            Z_out = Z[here]
            C = overlap - Q_out.T @ Z_out
            gram = square - Z_out.T @ Z_out - C.T @ f.inverse @ C
            pull = right - Z_out.T @ target_out - C.T @ f.theta
            chi2, beta, _ = solve_group(gram, raw, pull, signed, known)
            if chi2 > best:
                best = chi2
                change = np.negative(f.Q @ (f.inverse @ (C @ beta)))
                change[there] += Z_out @ beta
        gain[f.out] = f.error**2 - (f.error - change) ** 2
    return fit.rows.block_sums(gain)
