"""Instrumental variables as an ordinary regression: the noise of the regressor leaves the estimate.

With columns Z that share the signal of the columns X of tau = X theta + error and not their noise, the
estimate solves Z'(tau - X theta^) = 0 (Young 2011, ch. 7; Janot, Vandanjon, Gautier, IEEE Trans. Control
Systems Technology 2014). In

    tau^ = tau - X theta^ + Z theta^,     min |tau^ - Z theta|^2

it is the minimiser, the residual there is that of tau = X theta^, and the scores are the instruments':
the rows [Z, tau^] are a regression like any other. Constraints, weights, intervals and cross-validation
need not know; the problem stays convex. tau^ is linear in the compressed rows [Z, X, tau].
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.model import JointColumns, Model
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.preprocessing import Preprocessing, Rows, filtered_rows
from sdp_vs_penalty.signals.runs import movement

#: Directions of theta in which the instruments' columns, of unit norm, are shorter than this share of
#: the longest are not told: noise of X alone would decide them.
_RANK = 1e-6
#: Passes in which joints are weighted by their residuals.
_PASSES = 3

#: One joint's rows in one block: its number, the parameters (k,), and the rows (r, 2 k + 1) [Z, X, tau].
Instrumented = tuple[int, NDArray[np.intp], Array]


def instrumented_rows(run: Measurements, model: Model, settings: Preprocessing) -> Iterator[Rows]:
    """The rows of a run. Where it holds a simulated motion (positions "qsim") with the same columns on
    that motion before them: [Z, X], the parameters of Z counted behind the model's."""
    if "qsim" not in run.commanded:
        yield from filtered_rows(run, model, settings)
        return
    p, moving = len(model.parameters), movement(run, settings.standstill)
    told = {**run.commanded, "isum": run.commanded["isim"]}
    simulated = replace(run, q=run.commanded["qsim"], commanded=told)
    beside = filtered_rows(simulated, model, settings, moving)
    for rows, other in zip(filtered_rows(run, model, settings, moving), beside, strict=True):
        both = [
            JointColumns(np.append(z.indices + p, x.indices), np.hstack([z.columns, x.columns]))
            for z, x in zip(other.columns, rows.columns, strict=True)
        ]
        yield replace(rows, columns=both)


def instrumented(factors: Sequence[Instrumented], p: int) -> list[Array]:
    """Of each factor the rows (r, k + 1) [Z, tau^] in p parameters."""
    theta = _estimate(factors, p)
    out = []
    for _, indices, rows in factors:
        k = len(indices)
        Z, X = rows[:, :k], rows[:, k : 2 * k]
        out.append(np.column_stack([Z, rows[:, -1] + (Z - X) @ theta[indices]]))
    return out


def _estimate(factors: Sequence[Instrumented], p: int) -> Array:
    """theta^ (p,), joints weighted by their residuals."""
    joints = sorted({joint for joint, *_ in factors})
    grams = np.zeros((len(joints), 3, p, p))  # Z'Z, Z'X, X'X
    right, squares = np.zeros((len(joints), 2, p)), np.zeros(len(joints))
    for joint, indices, rows in factors:
        j, k = joints.index(joint), len(indices)
        Z, X, tau = rows[:, :k], rows[:, k : 2 * k], rows[:, -1]
        for m, (a, b) in enumerate(((Z, Z), (Z, X), (X, X))):
            grams[j, m][np.ix_(indices, indices)] += a.T @ b
        right[j, 0, indices] += Z.T @ tau
        right[j, 1, indices] += X.T @ tau
        squares[j] += tau @ tau
    weights, theta = np.ones(len(joints)), np.zeros(p)
    for _ in range(_PASSES):
        zz, zx, _ = np.einsum("j,jmkl->mkl", weights, grams)
        size = np.sqrt(np.diag(zz))
        seen = np.flatnonzero(size > 1e-10 * size.max(initial=0.0))
        values, vectors = np.linalg.eigh(zz[np.ix_(seen, seen)] / np.outer(size[seen], size[seen]))
        told = values > _RANK**2 * values.max(initial=0.0)
        V = vectors[:, told] / size[seen, None]
        theta = np.zeros(p)
        middle = V.T @ zx[np.ix_(seen, seen)] @ V
        theta[seen] = V @ np.linalg.lstsq(middle, V.T @ (weights @ right[:, 0])[seen], rcond=None)[0]
        left = squares - 2.0 * right[:, 1] @ theta + np.einsum("k,jkl,l->j", theta, grams[:, 2], theta)
        weights = 1.0 / np.maximum(left, 1e-12 * max(float(left.max()), 1e-300))
        weights /= weights.max()
    return theta
