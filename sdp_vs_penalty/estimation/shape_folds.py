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

from sdp_vs_penalty.estimation.normal_equations import Normal, times
from sdp_vs_penalty.estimation.shape_profiles import (
    ShapeBank,
    ShapeEstimate,
    beside,
    combined,
    estimated,
    left_by,
    pooled,
    settled,
)
from sdp_vs_penalty.robot.arrays import Array

#: Folds of the motion.
FOLDS = 10


def confirmed_shapes(
    folds: Normal, base: NDArray[np.intp], banks: Sequence[ShapeBank], variance: float
) -> list[ShapeEstimate]:
    """The constants that together explain most, where folds that are left out confirm it; elsewhere as
    they were.

    folds : normal equations (F, ...) of each fold, in the columns of base and banks; variance : as of
    :func:`best_shapes`.
    """
    pool = pooled(banks)
    shown = _visible(folds.total(), base)
    small = folds.through(np.hstack([shown, np.eye(len(shown))[:, pool]]))
    data, r = small.total(), shown.shape[1]
    shown, pool = np.eye(r + len(pool))[:, :r], np.arange(r, r + len(pool))
    out = estimated(banks, settled(beside(data, pool, shown), banks, variance))
    moved = [k for k, s in enumerate(out) if s.after != s.before]
    if not moved:
        return out
    rest = data.without(small)
    left = left_by(rest, pool, shown)
    rest, folded = rest.through(*left), small.through(*left)
    found = settled(rest, banks, variance)[0]
    now = np.broadcast_to([float(b.now) for b in banks], found.shape)
    plain, quantile = combined(rest, banks, now), stdtrit(len(found) - 1, 0.975)
    for k in moved:
        theta = combined(rest, banks, np.where(np.arange(len(banks)) == k, found, now))
        gains, change = folded.left(plain) - folded.left(theta), theta - plain
        changes = np.sum(change * times(folded.gram, change), axis=-1)
        noise = max(float(np.sum((gains - changes) ** 2)), 4.0 * variance * float(changes.sum()))
        if not gains.sum() > quantile * np.sqrt(noise):
            out[k] = replace(out[k], after=out[k].before, std=np.inf, gain=0.0, at_end=False)
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
