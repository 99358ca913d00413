"""When a joint stands still, as far as its positions can tell.

Dry friction that holds a joint is anything between minus and plus its size: no law of sliding says more,
and a torque measured meanwhile is no evidence for or against any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.kernels import Kernel, convolve
from sdp_vs_penalty.signals.runs import Stretch

#: Positions are alike within so many standard deviations of their own noise.
_ALIKE = 4.0
#: How much farther than the noise a moving joint comes in three times the time: 27 times as far where
#: its velocity passes through zero, as its cube, and 9 where it turns round. Farther: it stood.
_TURNS = 27.0
#: Ratio of the lengths of time that are looked at, and their largest share of a stretch.
_FINER, _LONGEST = 1.4, 0.1
#: Share of a row from a standstill above which its torque is what holds the joint; fewest rows in motion
#: that show how large friction is there; how often it has to turn round.
_AT_REST, _FEWEST, _TWICE = 0.9, 20, 2


@dataclass(frozen=True)
class Standstill:
    """When the joints of a stretch stand still, as its filtered rows see it: worked out when it is
    asked for, since only guessed noise needs it. kernel : the low-pass; rows (M,) : their samples."""

    stretch: Stretch
    kernel: Kernel
    rows: NDArray[np.int64]

    @cached_property
    def share(self) -> Array:
        """(M, n) how much of a unit torque, whatever its sign, reaches each row from a standstill."""
        q = self.stretch.resampled(self.stretch.q, 0, self.stretch.count)
        (reaching,) = convolve(still(q).astype(float), np.abs(self.kernel.value))
        return reaching[self.rows - self.kernel.half]


def still(q: Array) -> NDArray[np.bool_]:
    """(N, n) whether positions (N, n), sampled uniformly, stand still: for longer than a smooth motion
    at the same place would stay within the resolution of the positions."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    N, out = len(q), np.zeros(q.shape, bool)
    if N < 16:
        return out
    # Of fourth differences motion is no part, and white noise has 70 times its variance in them.
    alike = _ALIKE * np.median(np.abs(np.diff(q, 4, axis=0)), axis=0) / (0.6745 * np.sqrt(70.0))
    half = 1
    while half < _LONGEST * N:
        width = 2 * half + 1
        highest, lowest = (f(q, width, axis=0) for f in (maximum_filter1d, minimum_filter1d))
        quiet = highest - lowest <= 2.0 * alike
        if quiet.any():
            padded = np.pad(q, ((3 * half, 3 * half), (0, 0)), mode="edge")
            away = np.maximum(np.abs(padded[: -6 * half] - q), np.abs(padded[6 * half :] - q))
            out |= maximum_filter1d((quiet & (away > _TURNS * alike)).view(np.int8), width, axis=0) > 0
        half = max(half + 1, int(_FINER * half))
    return out


def turned_at_rest(
    friction: Array, rates: Array, share: Array, pieces: Sequence[NDArray[np.intp]]
) -> bool:
    """Whether friction held a joint while it changed by more than its own size, at least twice: then no
    travel that these positions tell turns it round.

    friction, share (M,) : what the links leave of the torque, and how much of each row is from a
    standstill; rates (M, 2) : velocity, acceleration; pieces : consecutive rows. Dahl's friction changes
    by 2 (1 - exp(-s / d)) times its size over a travel s: by more than its size where s > 0.7 d. A
    difference of what a constant, Coulomb and viscous friction and a rotor leave in motion is allowed
    for.
    """
    moving = np.concatenate([np.zeros(0, np.intp), *(p[share[p] < 1.0 - _AT_REST] for p in pieces)])
    if len(moving) < _FEWEST:
        return False
    v = rates[moving]
    laws = np.column_stack([np.ones(len(v)), np.sign(v[:, 0]), v])
    law = np.linalg.lstsq(laws, friction[moving], rcond=None)[0]
    left = np.median(np.abs(friction[moving] - laws @ law)) / 0.6745
    turned = 0
    for piece in pieces:
        rest = share[piece] > _AT_REST
        for part in np.split(piece, np.flatnonzero(np.diff(rest)) + 1):
            turned += bool(share[part[0]] > _AT_REST and np.ptp(friction[part]) > law[1] + 1.4 * left)
    return bool(law[1] > 0.0 and turned >= _TWICE)
