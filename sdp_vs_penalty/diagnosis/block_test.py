"""Whether what a candidate explains is more than chance, without a noise model: sums over blocks of
time, their robust Wald statistic, and the largest that random signs of the blocks bring about.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from sdp_vs_penalty.diagnosis.fit import WhiteFit
from sdp_vs_penalty.diagnosis.library import Batch, Key, Library
from sdp_vs_penalty.diagnosis.scoring import Scores
from sdp_vs_penalty.robot.arrays import Array

#: Columns of a group that random signs are tried on: the work grows with the fourth power of them.
_MOST = 12
#: Draws of signs, the share of them that makes the threshold, and groups that are drawn at once.
_DRAWS, _SHARE, _AT_ONCE = 200, 0.99, 32
#: Where exponents end.
_HIGHEST = 300.0


@dataclass(frozen=True)
class BlockSums:
    """Of partialled columns z (n M, k) and the residual r, block by block: scores z_b'r_b (G, B, k)
    and grams z_b'z_b (G, B, k, k), for a batch of G groups of equal k."""

    scores: Array
    grams: Array

    @classmethod
    def of(cls, fit: WhiteFit, partialled: Array, k: int) -> BlockSums:
        """From partialled columns (n M, G k) of G groups side by side."""
        rows = fit.rows
        scores = rows.block_sums(partialled * fit.residual[:, None])
        B, G = rows.blocks, partialled.shape[1] // k
        grams = np.empty((G, B, k, k))
        for a in range(k):
            for b in range(a, k):
                product = rows.block_sums(partialled[:, a::k] * partialled[:, b::k])
                grams[:, :, a, b] = grams[:, :, b, a] = product.T
        return cls(np.swapaxes(scores.reshape(B, G, k), 0, 1), grams)

    @classmethod
    def joined(cls, parts: Sequence[BlockSums]) -> BlockSums:
        """Of all groups of batches of equal k."""
        return cls(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("scores", "grams")))


def wald_exponent(sums: BlockSums) -> Array:
    """(G,) -log10 p of the block-robust Wald test; p is chi-square's with k degrees of freedom."""
    k = sums.scores.shape[2]
    return _exponent(wald(sums), k)


def _exponent(W: Array, k: int) -> Array:
    p = special.chdtrc(k, np.maximum(W, 0.0))
    return np.asarray(-np.log10(np.maximum(p, 10.0**-_HIGHEST)))


def wald(sums: BlockSums) -> Array:
    """(G,) the block-robust Wald statistic.

    With beta = (sum D_b)^-1 sum s_b, s_b the score and D_b the gram of block b, and u_b = s_b - D_b
    beta the score that beta leaves, W = (sum s_b)' V^-1 (sum s_b) with V = sum u_b u_b', the
    cluster-robust sandwich (Liang, Zeger 1986), which needs no noise model but independent blocks.
    Few blocks (an effect that shows only at reversals) can make the sandwich too small by chance:
    the smaller W of it and of V = sum D_b, noise of unit variance, counts.
    """
    s, D = sums.scores, sums.grams
    pull = s.sum(axis=1)
    beta = np.linalg.solve(_ridged(D.sum(axis=1)), pull[:, :, None])[:, :, 0]
    u = s - np.einsum("gbkl,gl->gbk", D, beta)
    spread = np.einsum("gbk,gbl->gkl", u, u)
    return _wald(pull[:, None], beta[:, None], spread[:, None], s)[:, 0]


def largest_wald(sums: BlockSums, signs: Array) -> Array:
    """(S,) the largest statistic :func:`wald` of all groups when the blocks' scores change sign by
    the rows of ``signs`` (S, B).

    V = sum s s' - (C + C') + Q with C = sum eps_b s_b (D_b beta)' and Q = sum D_b beta beta' D_b: sums
    over blocks that do not depend on the signs, or are linear in them.
    """
    s, D = sums.scores, sums.grams
    G, B, k = s.shape
    pull = (signs @ s.transpose(1, 0, 2).reshape(B, G * k)).reshape(-1, G, k).transpose(1, 0, 2)
    inverse = np.linalg.inv(_ridged(D.sum(axis=1)))
    beta = pull @ inverse  # (G, S, k); the gram is symmetric
    products = np.einsum("gbk,gblm->bgklm", s, D).reshape(B, G * k**3)
    linear = (signs @ products).reshape(-1, G, k, k, k)
    cross = np.einsum("sgklm,gsm->gskl", linear, beta, optimize=True)
    flat = D.reshape(G, B, k * k)
    fourth = (flat.transpose(0, 2, 1) @ flat).reshape(G, k, k, k, k)  # [k, m, l, n] of D_km D_ln
    squares = (beta[..., :, None] * beta[..., None, :]).reshape(G, -1, k * k)
    kernel = fourth.transpose(0, 2, 4, 1, 3).reshape(G, k * k, k * k)  # [(m, n), (k, l)]
    quadratic = (squares @ kernel).reshape(G, -1, k, k)
    fixed = np.einsum("gbk,gbl->gkl", s, s)
    spread = fixed[:, None] - cross - np.swapaxes(cross, 2, 3) + quadratic
    return np.asarray(_wald(pull, beta, spread, s).max(axis=0))


def _ridged(total: Array) -> Array:
    trace = np.trace(total, axis1=1, axis2=2)
    ridge = np.where(trace > 0.0, 1e-9 * trace, 1.0)
    return total + ridge[:, None, None] * np.eye(total.shape[1])


def _wald(pull: Array, beta: Array, spread: Array, scores: Array) -> Array:
    """(G, S) from pull, beta (G, S, k), spread (G, S, k, k) and all scores (G, B, k)."""
    k = pull.shape[2]
    # The sums above cancel to rounding only: the spread is never smaller than that.
    size = np.trace(spread, axis1=2, axis2=3)
    rounding = 1e-12 * np.sum(scores**2, axis=(1, 2))[:, None] + 1e-300
    spread = spread + (1e-9 * np.maximum(size, 0.0) + rounding)[:, :, None, None] * np.eye(k)
    return np.minimum(_energy(spread, pull), np.sum(pull * beta, axis=2))


def _energy(A: Array, x: Array) -> Array:
    """x'A^-1 x of positive definite A (..., k, k) and x (..., k): nearly all groups are of one column or
    two, for which LAPACK's calls would cost more than the work."""
    if x.shape[-1] == 1:
        return np.asarray(x[..., 0] ** 2 / A[..., 0, 0])
    if x.shape[-1] == 2:
        along = x[..., 0] ** 2 / A[..., 0, 0]
        across = x[..., 1] - A[..., 1, 0] * x[..., 0] / A[..., 0, 0]
        return np.asarray(along + across**2 / (A[..., 1, 1] - A[..., 1, 0] ** 2 / A[..., 0, 0]))
    return np.asarray(np.sum(x * np.linalg.solve(A, x[..., None])[..., 0], axis=-1))


def flip_threshold(fit: WhiteFit, library: Library, eligible: Set[Key], seed: int) -> float:
    """99th percentile of the largest Wald exponent of what is ``eligible`` when blocks change sign at
    random.

    What cannot be added makes no false claim, and does not hide what can: a few stretches of error that
    resemble a finer law whatever their signs would otherwise outshine the plain one.
    """
    signs = _signs(fit, seed)
    sums: dict[int, list[BlockSums]] = {}
    for batch in library.batches:
        columns = batch.columns[_allowed(library, batch, eligible)]
        if len(columns):
            k = columns.shape[1]
            fresh = _seen(fit, library, batch.joint, columns)
            sums.setdefault(k, []).append(BlockSums.of(fit, fresh, k))
    exponents = [
        _exponent(largest_wald(BlockSums.joined(parts), signs), k)
        for k, parts in sums.items()
        if any(len(p.scores) for p in parts)
    ]
    return float(np.quantile(np.max(exponents, axis=0), _SHARE)) if exponents else 0.0


def above_chance(
    fit: WhiteFit, library: Library, scores: Scores, eligible: Set[Key], seed: int, exponent: float
) -> bool:
    """Whether an exponent is at least :func:`flip_threshold`: decided as soon as enough draws exceed it,
    or no more can (sequential Monte Carlo: Besag and Clifford 1991).

    Which groups can exceed it, and in which draws, is seen from the classical statistic s'D^-1 s of the
    blocks' scores, of which :func:`wald` is never more. scores : of the library.
    """
    if exponent >= _HIGHEST:
        return True
    signs, blocks = _signs(fit, seed), _block_scores(fit, library)
    place = _SHARE * (len(signs) - 1)
    enough, allowed = len(signs) - int(place), len(signs) - 1 - int(np.ceil(place))
    pending: list[tuple[int, float, int | None, NDArray[np.intp]]] = []
    for batch, solved in zip(library.batches, scores.batches, strict=True):
        which = _allowed(library, batch, eligible)
        if solved is None or not which.any():
            continue
        columns = batch.columns[which]
        limit = float(special.chdtri(columns.shape[1], 10.0**-exponent))
        could = (_classical(columns, solved.gram[which], blocks[batch.joint], signs) > limit).sum(axis=1)
        order = np.argsort(-could)[: np.count_nonzero(could)]
        for start in range(0, len(order), _AT_ONCE):
            part = order[start : start + _AT_ONCE]
            pending.append((int(could[part[0]]), limit, batch.joint, columns[part]))
    exceeded = np.zeros(len(signs), bool)
    for _, limit, joint, columns in sorted(pending, key=lambda p: -p[0]):
        sums = BlockSums.of(fit, _seen(fit, library, joint, columns), columns.shape[1])
        if len(sums.scores):
            exceeded |= largest_wald(sums, signs) > limit
        if exceeded.sum() >= enough:
            return False
    return bool(exceeded.sum() <= allowed) or exponent >= flip_threshold(fit, library, eligible, seed)


def _signs(fit: WhiteFit, seed: int) -> Array:
    return np.random.default_rng(seed).choice([-1.0, 1.0], (_DRAWS, fit.rows.blocks))


def _allowed(library: Library, batch: Batch, eligible: Set[Key]) -> NDArray[np.bool_]:
    """(G,) which groups of a batch random signs are tried on."""
    few = batch.columns.shape[1] <= _MOST
    return np.array([few and library.groups[g].key in eligible for g in batch.groups], bool)


def _block_scores(fit: WhiteFit, library: Library) -> dict[int | None, Array]:
    """(B, C) scores z_b'r_b of the library's partialled columns, by joint (None: on several)."""
    sums, residual = fit.rows.products, fit.residual.reshape(fit.rows.n, -1)

    def summed(columns: Iterable[Array], residual: Array) -> Array:
        return np.sum([sums(z, r) for z, r in zip(columns, residual, strict=True)], axis=0)

    model = summed(fit.Q.reshape(*residual.shape, -1), residual)
    weighted = residual / np.reshape(library.divisors, (-1, 1))
    robot = summed(library.robot, weighted) - model @ fit.overlaps(library, None).sum(axis=0)
    out: dict[int | None, Array] = {None: robot}
    for j, (z, r) in enumerate(zip(library.joints, weighted, strict=True)):
        out[j] = sums(z, r) - model @ fit.overlaps(library, j)
    return out


def _classical(columns: NDArray[np.intp], grams: Array, blocks: Array, signs: Array) -> Array:
    """(G, S) s'D^-1 s of groups of columns (G, k), partialled grams (G, k, k), when the blocks' scores
    (B, C) change sign."""
    G, k = columns.shape
    pull = (signs @ blocks[:, columns.ravel()]).reshape(-1, G, k).transpose(1, 0, 2)
    beta = pull @ np.linalg.inv(_ridged(grams))
    return np.asarray(np.sum(pull * beta, axis=2))


def _seen(fit: WhiteFit, library: Library, joint: int | None, columns: NDArray[np.intp]) -> Array:
    """(n M, G k) what the model leaves of groups of columns (G', k), side by side; of those groups of
    which it leaves anything."""
    M = len(fit.rows.block)
    if joint is None:
        parts = zip(library.robot, library.divisors, strict=True)
        Z = np.concatenate([z[:, columns.ravel()] / divisor for z, divisor in parts])
        fresh = Z - fit.Q @ (fit.Q.T @ Z)
    else:
        Z = library.joints[joint][:, columns.ravel()] / library.divisors[joint]
        mine = slice(joint * M, (joint + 1) * M)
        fresh = np.negative(fit.Q @ (fit.Q[mine].T @ Z))
        fresh[mine] += Z
    left, energy = (np.einsum("nc,nc->c", x, x).reshape(columns.shape) for x in (fresh, Z))
    seen = np.all(left > 1e-7 * energy, axis=1)
    return fresh if seen.all() else fresh[:, np.repeat(seen, columns.shape[1])]
