"""Noise as an autoregression: its coefficients from residuals, and what it leaves of a series."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from sdp_vs_penalty.robot.arrays import Array

ORDER = 4


class Pieces(tuple[NDArray[np.intp], ...]):
    """Index arrays of uninterrupted rows of a series, in order, and where an autoregression predicts."""

    @cached_property
    def predicted(self) -> NDArray[np.intp]:
        """The rows that have a past of ORDER rows in their piece."""
        return np.concatenate([np.arange(0), *(p[ORDER:] for p in self)])

    @cached_property
    def past(self) -> list[NDArray[np.intp]]:
        """The rows 1, 2, ... ORDER before each of those."""
        lags = range(1, ORDER + 1)
        return [np.concatenate([np.arange(0), *(p[ORDER - k : -k] for p in self)]) for k in lags]

    def filter(self, ar: Array, count: int) -> sparse.csr_array:
        """(count, count) what an autoregression does to a series: each predicted row less what its past
        says of it, zero rows elsewhere; the last is kept."""
        key = ar.tobytes(), count
        if key not in self._filters:
            rows, last = self.predicted, np.zeros(count + 1, np.intp)
            last[rows + 1] = ORDER + 1
            places = np.column_stack([*reversed(self.past), rows]).ravel()
            weights = np.tile(np.append(-ar[::-1], 1.0), len(rows))
            self._filters.clear()
            self._filters[key] = sparse.csr_array(
                (weights, places, np.cumsum(last)), shape=(count, count)
            )
        return self._filters[key]

    @cached_property
    def _filters(self) -> dict[tuple[bytes, int], sparse.csr_array]:
        return {}


def autoregression(x: Array, pieces: Pieces) -> tuple[Array, float, float]:
    """AR coefficients (ORDER,), standard deviation of the innovations, degrees of freedom."""
    count = len(pieces.predicted)
    if count < 4 * ORDER:
        every = np.concatenate([x[p] for p in pieces]) if pieces else x
        return np.zeros(ORDER), max(float(every.std()), 1e-12), max(len(every) - 1.0, 1.0)
    matrix, target = np.column_stack([x[k] for k in pieces.past]), x[pieces.predicted]
    a = np.linalg.lstsq(matrix, target, rcond=1e-10)[0]
    rest = target - matrix @ a
    sigma = float(np.sqrt(rest @ rest / (count - ORDER)))
    smallest = max(1e-9 * float(np.abs(x).max(initial=1.0)), 1e-15)
    return np.asarray(a, float), max(sigma, smallest), float(count - ORDER)
