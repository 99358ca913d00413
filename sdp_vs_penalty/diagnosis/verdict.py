"""Whether something repeatable remains that nothing in the library explains.

Two tests on what the ladder leaves, white and of unit variance if only noise is left:

- products of instants at which the motion repeats: noise is new each time, a model's error is not.
  This needs no noise level at all;
- the variance of each joint against that of the noise, where the noise is known from repetition.

White values weigh each frequency by how quiet it is there: what they show surely may be too little to
matter. So the error is compared with the noise in N m as well, and with the torque. Rows of standstill
are no evidence: dry friction holds any torque up to its own there, comes back with the motion, and is no
function of it. Nor are rows of a slow joint: where friction turns round any law of it is only nearly
right, and what it gets wrong comes back, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from sdp_vs_penalty.diagnosis.fit import WhiteFit
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import REPETITION, Noise
from sdp_vs_penalty.signals.segments import SegmentedRuns
from sdp_vs_penalty.signals.stillness import SLOW, STILL

Mask = NDArray[np.bool_]

#: Family-wise probability of calling Gaussian noise a repeatable error; a log's has heavier tails.
FALSE_UNKNOWN = 5e-4
#: Share by which what repeats has to raise a joint's error above its noise to matter.
_MATTERS = 0.1
#: Share of a joint's torque (RMS) below which nothing is told from links that are not quite as long as
#: the model says: 1 mm in 0.3 m, and 0.1 degrees.
NOMINAL = 0.005


@dataclass(frozen=True)
class Remainder:
    """share (n,) : variance above the noise over that of the noise, in motion; p : smallest p value,
    corrected for the number of tests (1 where only the residual shows the noise: nothing can be tested
    then); remains : whether that is below FALSE_UNKNOWN, or windows of too much energy repeat; joints :
    those on which it is, from 0; beyond, floor (n,) [N m or N]: RMS of what is not noise while the joint
    slides, and of the noise; slow (n,) the same as beyond while it is slow; torque (n,) : RMS."""

    share: Array
    p: float
    remains: bool
    joints: tuple[int, ...]
    beyond: Array
    floor: Array
    slow: Array
    torque: Array

    @property
    def matters(self) -> tuple[int, ...]:
        """The joints (from 0) whose error it raises noticeably above their noise."""
        least = NOMINAL * self.torque
        raised = zip(self.joints, self.raised, strict=True)
        return tuple(j for j, r in raised if r > _MATTERS and self.beyond[j] > least[j])

    @property
    def raised(self) -> Array:
        """Share by which it raises the errors of ``joints`` above their noise."""
        at = list(self.joints)
        total, floor = np.hypot(self.beyond, self.floor)[at], self.floor[at]
        return np.divide(total, floor, out=np.full(len(at), np.inf), where=floor > 0.0) - 1.0


def remainder(
    fit: WhiteFit, rows: SegmentedRuns, noise: Noise, residual: Array, ignore: Mask | None = None
) -> Remainder:
    """Test what is left: ``residual`` (M, n) [N m or N], white in ``fit``; ``ignore`` (M, n) are rows of
    events."""
    n, M = rows.n, len(rows.t)
    white = (fit.residual.reshape(n, M) * fit.weighting.level[:, None]).T
    keep = rows.keep & (white != 0.0) & (noise.worth > 0.5) & (rows.still <= STILL)
    if ignore is not None:
        keep &= ~ignore
    slides = keep & (rows.slow <= SLOW)
    leverage = np.sum(fit.Q**2, axis=1).reshape(n, M).T

    def mean(squares: Array, which: Mask) -> tuple[Array, Array]:
        degrees = np.maximum((which * (1.0 - leverage)).sum(axis=0), 1.0)
        return (which * squares).sum(axis=0) / degrees, degrees

    variance, degrees = mean(white**2, slides)
    p_values = []
    if noise.source == REPETITION:
        p_values += list(special.fdtrc(degrees, noise.degrees, variance))
        p_values += _repeated_products(white, slides, rows, noise)
    p = min(1.0, min(p_values, default=1.0) * max(len(p_values), 1))
    small = {k % n for k, each in enumerate(p_values) if each * len(p_values) < FALSE_UNKNOWN}
    beyond, slow = (
        np.sqrt(np.maximum(mean(residual**2, which)[0] - noise.floor**2, 0.0))
        for which in (slides, keep & ~slides)
    )
    return Remainder(
        mean(white**2, keep)[0] - 1.0,
        float(p),
        p < FALSE_UNKNOWN,
        tuple(sorted(small)),
        beyond,
        noise.floor,
        slow,
        np.sqrt(np.mean(rows.torque**2, axis=0)),
    )


def _repeated_products(white: Array, keep: Mask, rows: SegmentedRuns, noise: Noise) -> list[float]:
    """One p value a joint: the mean of w(t) w(t + T), against its scatter over stretches of 1 s."""
    starts = np.cumsum([0, *(len(s.t) for s in rows.segments)])
    sums: list[Array] = []
    for repeat in noise.repeats:
        other = rows.segments[repeat.other]
        spacing = 1.0 / rows.rate
        # Rows of white noise cannot be interpolated without mixing: the nearer row on each side.
        position = (repeat.later - other.t[0]) / spacing
        below = np.floor(position).astype(np.intp)
        weight = position - below
        inside = (below >= 0) & (below + 1 < len(other.t))
        low = starts[repeat.other] + np.where(inside, below, 0)
        high = low + inside
        later = (1.0 - weight)[:, None] * white[low] + weight[:, None] * white[high]
        good = inside[:, None] & keep[repeat.rows] & keep[low] & keep[high]
        product = np.where(good, white[repeat.rows] * later, 0.0)
        width = max(1, round(rows.rate))
        for first in range(0, len(product), width):
            sums.append(product[first : first + width].sum(axis=0))
    if len(sums) < 6:
        return []
    s = np.array(sums)
    total, spread = s.sum(axis=0), np.sqrt(np.sum(s**2, axis=0))
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(spread > 0.0, total / spread, 0.0)
    # Under sign changes of stretches, t^2 / (B - t^2) (B - 1) is F with (1, B - 1).
    B = len(s)
    student = t * np.sqrt((B - 1) / np.maximum(B - t**2, 1e-9))
    return [float(p) for p in special.stdtr(B - 1, -student)]
