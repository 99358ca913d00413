"""Whether a shape constant that was found says anything of motion that it was not found on.

In-sample, slow noise and what the model lacks look like evidence: a constant that takes a hundred times
the noise's variance from the error of one run may add as much to that of another. So every fold of the
motion is left out once, all constants are found anew from the rest, and the fold is predicted with a
constant as found there and as the model has it. With r what the former leaves of the torque and d the
difference of the two predictions, it takes

    sum_k |d_k|^2 + 2 r_k'd_k

from the squared error of all folds k. A constant is confirmed where that exceeds Student's 95 % quantile
times its own deviation: the larger of sqrt(sum_k (2 r_k'd_k)^2), which holds for noise of any colour,
and what white noise would make of it. Where the folds do not confirm it, the model's own value stays:
the simpler model unless another is significantly better (Breiman et al., Classification and Regression
Trees, 1984, sec. 3.4.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from sdp_vs_penalty.estimation.normal_equations import Normal, total
from sdp_vs_penalty.estimation.shape_profiles import (
    ShapeBank,
    ShapeEstimate,
    combined,
    curves_of,
    left_by,
    pooled,
    settled,
)
from sdp_vs_penalty.robot.arrays import Array

#: Folds of the motion.
FOLDS = 10


def confirmed(
    found: Sequence[ShapeEstimate],
    folds: Sequence[Normal],
    base: NDArray[np.intp],
    banks: Sequence[ShapeBank],
    variance: float,
) -> list[ShapeEstimate]:
    """What was found, where folds that are left out confirm it; elsewhere the constants of before.

    folds : normal equations of each fold, in the columns of base and banks; variance : as of
    :func:`best_shapes`.
    """
    moved = [k for k, s in enumerate(found) if s.after != s.before]
    if not moved:
        return list(found)
    quantile = stdtrit(len(folds) - 1, 0.975)
    pool = pooled(banks)
    both = np.hstack([_visible(total(folds), base), np.eye(len(folds[0].right))[:, pool]])
    small = [fold.through(both, np.zeros(len(fold.right))) for fold in folds]
    shown = np.eye(both.shape[1])[:, : both.shape[1] - len(pool)]
    trials = []
    for k, fold in enumerate(small):
        rest = total([*small[:k], *small[k + 1 :]])
        left = left_by(rest, np.arange(shown.shape[1], both.shape[1]), shown)
        trials.append(_trial(rest.through(*left), fold.through(*left), banks, variance))
    out = list(found)
    for k in moved:
        gains, changes = np.array([t[k] for t in trials]).T
        noise = max(float(np.sum((gains - changes) ** 2)), 4.0 * variance * float(changes.sum()))
        if not gains.sum() > quantile * np.sqrt(noise):
            out[k] = replace(found[k], after=found[k].before, std=np.inf, gain=0.0, at_end=False)
    return out


def _visible(data: Normal, base: NDArray[np.intp]) -> Array:
    """(p, r) combinations of the columns ``base`` that the data show, orthonormal there."""
    own = data.gram[np.ix_(base, base)]
    norms = np.sqrt(np.maximum(np.diagonal(own), 0.0))
    unit = np.where(norms > 1e-10 * norms.max(initial=0.0), norms, np.inf)
    values, vectors = np.linalg.eigh(own / np.outer(unit, unit))
    good = values > 1e-12 * values.max(initial=0.0)
    out = np.zeros((len(data.right), int(good.sum())))
    out[base] = vectors[:, good] / np.sqrt(values[good]) / unit[:, None]
    return out


def _trial(
    rest: Normal, fold: Normal, banks: Sequence[ShapeBank], variance: float
) -> list[tuple[float, float]]:
    """Of each constant, found from the rest: what it takes from a fold's squared error, and |d|^2; of
    both what all other columns, fitted to the rest, leave."""
    curves, before = curves_of(rest, banks), [bank.now for bank in banks]
    plain, out = combined(rest, curves, before), []
    for k, s in enumerate(settled(rest, curves, variance)):
        theta = plain
        if s.after != s.before:
            theta = combined(rest, curves, [*before[:k], s.after, *before[k + 1 :]])
        change = theta - plain
        out.append((fold.left(plain) - fold.left(theta), float(change @ fold.gram @ change)))
    return out
