"""Noise as an autoregression: its coefficients from residuals, also where columns were projected out."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.kernels import fast_length

ORDER = 4
#: Lags after which the noise has forgotten, and steps of its estimate beside other columns.
_MEMORY, _STEPS = 64, 4


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


def innovations(values: Array, ar: Array, pieces: Sequence[NDArray[np.intp]]) -> Array:
    """values (M, ...) less what the autoregression predicts; zero on the first ORDER rows of a piece."""
    pieces = pieces if isinstance(pieces, Pieces) else Pieces(pieces)
    white = pieces.filter(ar, len(values)) @ values.reshape(len(values), -1)
    return np.asarray(white).reshape(values.shape)


def autoregression(x: Array, pieces: Sequence[NDArray[np.intp]]) -> tuple[Array, float, float]:
    """AR coefficients (ORDER,), standard deviation of the innovations, degrees of freedom."""
    pieces = pieces if isinstance(pieces, Pieces) else Pieces(pieces)
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


def beside(
    rest: Array, pieces: Sequence[NDArray[np.intp]], nuisance: Array
) -> tuple[float, Array, float, int]:
    """Standard deviation, AR coefficients and innovation of noise of which ``rest`` is what the
    columns ``nuisance`` leave; and the rank of those.

    Slow columns take slow noise with them: the autoregression of the rest shows too little of it. The
    coefficients are those whose expected products of lags, once the columns are projected out, are
    the ones found (a few steps of indirect inference: Gourieroux, Monfort, Renault 1993).
    """
    u, values, _ = np.linalg.svd(nuisance, full_matrices=False)
    Q = u[:, values > 1e-9 * values[:1].sum()] if values.any() else u[:, :0]
    count = sum(len(p) for p in pieces)
    found, sigma, _ = autoregression(rest, pieces)
    energy = float(sum(np.sum(rest[p] ** 2) for p in pieces))
    if not found.any() or not Q.shape[1] or energy == 0.0:
        left = max(count - Q.shape[1], 1)
        return float(np.sqrt(energy / left)), found, sigma * np.sqrt(count / left), Q.shape[1]
    a, best = found, found
    for _ in range(_STEPS):
        products = _expected_products(a, pieces, Q)
        expected = np.linalg.solve(products[1:, 1:], products[1:, 0])
        a = best = a + found - expected
        if not _stationary(a):
            a = best = found
            break
    products = _expected_products(best, pieces, Q)
    whitener = np.concatenate([[1.0], -found])
    used = sum(max(len(p) - ORDER, 0) for p in pieces)
    size = sigma * np.sqrt((used - ORDER) / (whitener @ products @ whitener))
    variance = _autocovariance(best)[0]
    seen = _expected_energy(best, pieces, Q) / variance
    return float(np.sqrt(energy / max(seen, 1.0))), best, float(size), Q.shape[1]


def _stationary(a: Array) -> bool:
    return bool(np.all(np.abs(np.roots(np.concatenate([[1.0], -a]))) < 0.99))


def _autocovariance(a: Array) -> Array:
    """(_MEMORY,) autocovariances of the autoregression driven by white noise of unit variance."""
    impulse = np.zeros(4 * _MEMORY)
    impulse[0] = 1.0
    recursion = np.tile(np.concatenate([[1.0], -a])[:, None], len(impulse))
    response = linalg.solve_banded((len(a), 0), recursion, impulse)
    return np.correlate(response, response, mode="full")[len(response) - 1 :][:_MEMORY]


def _with_covariance(a: Array, pieces: Sequence[NDArray[np.intp]], Q: Array) -> Array:
    """The noise's covariance, pieces apart from each other, times Q (M, r)."""
    half = _autocovariance(a)
    kernel = np.concatenate([half[:0:-1], half])
    out = np.zeros_like(Q)
    for piece in pieces:
        if len(piece):
            length = fast_length(len(piece) + len(kernel) - 1)
            spectrum = np.fft.rfft(Q[piece], length, axis=0) * np.fft.rfft(kernel, length)[:, None]
            full = np.fft.irfft(spectrum, length, axis=0)
            out[piece] = full[_MEMORY - 1 : _MEMORY - 1 + len(piece)]
    return out


def _expected_products(a: Array, pieces: Sequence[NDArray[np.intp]], Q: Array) -> Array:
    """(ORDER + 1, ORDER + 1) of E sum_t y(t - i) y(t - k), y noise with the columns Q projected out.

    E y y' = (1 - Q Q') C (1 - Q Q') with C the covariance for innovations of unit variance.
    """
    covariance, G = _autocovariance(a), _with_covariance(a, pieces, Q)
    H = Q.T @ G
    lags = range(ORDER + 1)
    pieces = pieces if isinstance(pieces, Pieces) else Pieces(pieces)
    lagged = [pieces.predicted, *pieces.past]
    q, g = Q[lagged], G[lagged]
    mixed = np.tensordot(q, g, axes=([1, 2], [1, 2]))
    own = len(pieces.predicted) * covariance[np.abs(np.subtract.outer(lags, lags))]
    return np.asarray(own + np.tensordot(q @ H, q, axes=([1, 2], [1, 2])) - mixed - mixed.T)


def _expected_energy(a: Array, pieces: Sequence[NDArray[np.intp]], Q: Array) -> float:
    """E y'y of the same noise."""
    G = _with_covariance(a, pieces, Q)
    count = sum(len(p) for p in pieces)
    return float(count * _autocovariance(a)[0] - np.sum(Q * G))
