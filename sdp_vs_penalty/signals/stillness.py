"""When a joint stands still, as far as its positions can tell.

Dry friction that holds a joint is anything between minus and plus its size: no law of sliding says more,
and a torque measured meanwhile is no evidence for or against any.
"""

from __future__ import annotations

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
