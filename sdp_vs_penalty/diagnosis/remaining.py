"""What is left beyond the noise after the best explanation: nothing, or something without a name.

The error of each joint in N m, on rows that are evidence, against the noise floor. Rows of standstill
are none: dry friction holds any torque up to its own there. Nor are those of a slow joint: where
friction turns round any law of it is only nearly right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from sdp_vs_penalty.diagnosis.constants import CHANCE, MATTERS, WITHIN
from sdp_vs_penalty.diagnosis.score import Fit
from sdp_vs_penalty.diagnosis.whitening import WhiteData, spread_columns
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import REPETITION
from sdp_vs_penalty.signals.standstill import SLOW, STILL


@dataclass(frozen=True)
class Remainder:
    """share (n,) : variance of what is left over that of the noise, less one; beyond (n,) [N m or N] :
    its RMS beyond the noise while the joint slides, slow (n,) : while it is slow; matters : the joints
    (from 0) on which something is left that matters; residual (M, n) [N m or N]; odd (M, n) : rows that
    are outliers of it."""

    share: Array
    beyond: Array
    slow: Array
    matters: tuple[int, ...]
    residual: Array
    odd: NDArray[np.bool_]


def remainder(data: WhiteData, fit: Fit, residual: Array, odd: NDArray[np.bool_]) -> Remainder:
    """residual (M, n) [N m or N], white in ``fit``; odd (M, n) : rows of events, left out."""
    rows, noise = data.rows, data.noise
    white = (fit.residual * fit.level[:, None]).T
    keep = rows.keep & (white != 0.0) & (noise.worth > 0.5) & (rows.still <= STILL) & ~odd
    slides = keep & (rows.slow <= SLOW)
    leverage = np.sum(fit.basis**2, axis=2).T

    def mean(squares: Array, which: NDArray[np.bool_]) -> Array:
        degrees = np.maximum((which * (1.0 - leverage)).sum(axis=0), 1.0)
        return np.asarray((which * squares).sum(axis=0) / degrees)

    variance = mean(white**2, slides)
    squares = mean(residual**2, slides), mean(residual**2, keep & ~slides)
    beyond, slow = (np.sqrt(np.maximum(x - noise.floor**2, 0.0)) for x in squares)
    # Of one log's joints the spectrum is wrong by much the same.
    beside = WITHIN * max(float(np.median(variance)), 1.0)
    more = (1.0 + MATTERS) ** 2
    least = np.full(len(variance), min(WITHIN**2 * more, beside))
    if noise.source == REPETITION:  # as the mean of so many squares is itself known
        least = more * noise.degrees / special.chdtri(noise.degrees, 1.0 - CHANCE)
    with np.errstate(divide="ignore", invalid="ignore"):
        raised = np.hypot(beyond, noise.floor) / noise.floor - 1.0
    found = (variance > least) & (raised > MATTERS) & data.known
    matters = tuple(np.flatnonzero(found).tolist())
    return Remainder(mean(white**2, keep) - 1.0, beyond, slow, matters, residual, odd)


def refitted(data: WhiteData, effects: Sequence[Effect]) -> tuple[Array, Array]:
    """(p + k,) parameters of the model and of effects beside it, and (M, n) [N m or N] what these leave:
    least squares on the white rows and on what is known of the effects' sizes, joints weighted by what
    is left of them; parameters that rows do not tell are the model's."""
    columns = [data.raw, *(spread_columns(data.rows, e) for e in effects)]
    everything = np.concatenate(columns, axis=2)
    n, _, p = everything.shape
    theta, torque = np.zeros(p), data.rows.residual
    if not data.frozen:
        theta[: data.raw.shape[2]] = data.estimate.theta
        torque = torque + (data.raw @ data.estimate.theta).T
    if not p:
        return theta, torque
    known = [np.zeros(data.raw.shape[2])]
    known += [np.zeros(len(e.parameters)) if e.plausible is None else 1.0 / e.plausible for e in effects]
    white = np.stack([data.white(everything[j], j) for j in range(n)])
    first, level, prior = theta, np.ones(n), np.diag(np.concatenate(known))
    target = data.y - white @ first
    for _ in range(3):
        A = np.vstack([(white / level[:, None, None]).reshape(-1, p), prior])
        norms = np.linalg.norm(A, axis=0)
        unit = np.where(norms > 1e-12 * norms.max(initial=0.0), norms, np.inf)
        wanted = np.append(target / level[:, None], np.zeros(p))
        theta = first + np.linalg.lstsq(A / unit, wanted, rcond=1e-8)[0] / unit
        left = np.sum((data.y - white @ theta) ** 2, axis=1) / np.maximum(data.count, 1.0)
        level = np.sqrt(np.maximum(left, 1.0 if data.known else 1e-12))
    return theta, np.asarray(torque - (everything @ theta).T)
