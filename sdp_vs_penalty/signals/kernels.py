"""The low-pass of positions, columns and torque as a kernel, with its first two derivatives.

A windowed sinc of half-length 2 / cut-off, made maximally flat: its moments of order 2, 4 and 6
vanish, so that it is exact on polynomials of degree 7 and its gain differs from 1 by 5e-8 at a tenth
of the cut-off, 1 % at half of it; at the cut-off it is 1/2 (what forward and backward Butterworth
filtering gives).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft, sparse

from sdp_vs_penalty.robot.arrays import Array


class LowPass:
    """A symmetric kernel (2 half + 1,) of a low-pass on a uniform grid."""

    def __init__(self, value: Array) -> None:
        self.value, self.half = value, len(value) // 2

    def decimator(self, length: int, at: NDArray[np.int64]) -> sparse.csr_array:
        """(len(at), length) matrix: the low-pass evaluated at the samples ``at`` only."""
        width = 2 * self.half + 1
        columns = (at[:, None] - self.half + np.arange(width)).ravel()
        values = np.tile(self.value[::-1], len(at))
        starts = np.arange(len(at) + 1) * width
        return sparse.csr_array((values, columns, starts), shape=(len(at), length))

    def steps(self, length: int, at: NDArray[np.int64]) -> Steps:
        """The same at samples that are equally far from each other."""
        step = int(at[1] - at[0]) if len(at) > 1 else 1
        return Steps(self.value, length, int(at[0]) - self.half, step, len(at))


class Steps:
    """The (count, length) matrix that takes a kernel's (K,) products with a series at every ``step``-th
    of its samples from ``first`` on.

    out_m = sum_p sum_k h_(k step + p) x_(first + (m + k) step + p): one product of the series, read as a
    matrix with rows of ``step`` samples, with the kernel read alike, and shifted sums of its columns.
    """

    def __init__(self, kernel: Array, length: int, first: int, step: int, count: int) -> None:
        self.kernel, self.first, self.step, self.count = kernel, first, step, count
        self.shape = count, length
        self._turns = -(-len(kernel) // step)
        padded = np.append(kernel[::-1], np.zeros(self._turns * step - len(kernel)))
        self._filter = padded.reshape(self._turns, step)

    def __abs__(self) -> Steps:
        return Steps(np.abs(self.kernel), self.shape[1], self.first, self.step, self.count)

    def part(self, start: int, stop: int) -> tuple[Steps, slice]:
        """Some of the rows, as products with some of the samples."""
        count = min(stop, self.count) - start
        begin = self.first + start * self.step
        length = (count - 1) * self.step + len(self.kernel)
        return Steps(self.kernel, length, 0, self.step, count), slice(begin, begin + length)

    def __matmul__(self, x: Array) -> Array:
        """Of a series (length,) or of several (length, k)."""
        if x.ndim == 1:
            return (self @ x[:, None])[:, 0]
        rows = self.count + self._turns - 1
        whole = min(rows, (len(x) - self.first) // self.step)
        last = self.first + whole * self.step
        steps = np.ascontiguousarray(x, float)[self.first : last].reshape(whole, self.step, -1)
        if x.shape[1] == 1:
            products = (steps[:, :, 0] @ self._filter.T)[:, :, None]
        else:
            products = self._filter @ steps
        if whole < rows:  # the kernel's end reaches into a part of the last step
            end = self._filter[:, : len(x) - last] @ x[last : last + self.step]
            products = np.concatenate([products, end[None]])
        out = products[: self.count, 0].copy()
        for k in range(1, self._turns):
            out += products[k : k + self.count, k]
        return np.asarray(out)


class Kernel(LowPass):
    """A low-pass and its first two derivatives, sampled at dt.

    h(t) = sinc(t) hann(u) (c_0 + c_1 u^2 + c_2 u^4 + c_3 u^6), u = t / support, with c such that its
    moments are those of an impulse up to order 7; the derivatives' moments are those of an
    impulse's derivatives.
    """

    def __init__(self, cutoff: float, dt: float) -> None:
        self.cutoff, self.dt = cutoff, dt
        self.half = int(np.ceil(2.0 / cutoff / dt))
        support = (self.half + 1) * dt  # the window is zero one sample beyond the ends
        t = np.arange(-self.half, self.half + 1) * dt
        u, w, a = t / support, 2.0 * np.pi * cutoff, np.pi / support
        safe = np.where(t == 0.0, 1.0, t)
        sinc = np.where(t == 0.0, w, np.sin(w * t) / safe)
        sinc1 = np.where(t == 0.0, 0.0, (w * np.cos(w * t) - sinc) / safe)
        sinc2 = np.where(t == 0.0, -(w**3) / 3.0, (-(w**2) * np.sin(w * t) - 2.0 * sinc1) / safe)
        hann, hann1, hann2 = (
            0.5 + 0.5 * np.cos(a * t),
            -0.5 * a * np.sin(a * t),
            -0.5 * a**2 * np.cos(a * t),
        )
        h = sinc * hann
        h1 = sinc1 * hann + sinc * hann1
        h2 = sinc2 * hann + 2.0 * sinc1 * hann1 + sinc * hann2
        c = _moment_factor(h, u, (0, 2, 4, 6), (1.0, 0.0, 0.0, 0.0))
        c1, c2 = c.deriv(1), c.deriv(2)
        self.value = h * c(u)
        first = h1 * c(u) + h * c1(u) / support
        second = h2 * c(u) + 2.0 * h1 * c1(u) / support + h * c2(u) / support**2
        # The moments of the samples differ a little from those of the function that they sample.
        self.first = first * _moment_factor(first, u, (1, 3, 5, 7), (-1.0 / support, 0.0, 0.0, 0.0))(u)
        self.second = second * _moment_factor(
            second, u, (0, 2, 4, 6), (0.0, 2.0 / support**2, 0.0, 0.0)
        )(u)

    def states(self, q: Array) -> tuple[Array, Array, Array]:
        """q, dq, ddq (N - 2 half, n) from positions (N, n)."""
        centred = q - q[:1]  # keeps the rounding of the transforms relative to the motion
        low, first, second = convolve(centred, self.value, self.first, self.second)
        return low + q[:1], first, second

    def sampled(self, stride: int) -> LowPass:
        """The same low-pass on a grid ``stride`` times coarser: the same response below its rate."""
        if stride == 1:
            return self
        offsets = np.arange(-(self.half // stride), self.half // stride + 1)
        value = self.value[self.half + stride * offsets]
        u = offsets / max(offsets[-1], 1)
        return LowPass(value * _moment_factor(value, u, (0, 2, 4, 6), (1.0, 0.0, 0.0, 0.0))(u))


def convolve(x: Array, *kernels: Array) -> list[Array]:
    """x (N, n) convolved with each kernel (K,), where the two overlap fully: (N - K + 1, n).

    By one Fourier transform of x for all kernels; what wraps around lies outside. (scipy.signal does
    the same, but its import takes longer than to identify a robot.)
    """
    length = fft.next_fast_len(len(x), real=True)
    spectrum = fft.rfft(x, length, axis=0)
    return [
        fft.irfft(spectrum * fft.rfft(kernel, length)[:, None], length, axis=0)[len(kernel) - 1 : len(x)]
        for kernel in kernels
    ]


def _moment_factor(
    kernel: ArrayLike, u: ArrayLike, orders: Sequence[int], moments: Sequence[float]
) -> np.polynomial.Polynomial:
    """The even polynomial c(u) with sum kernel c(u) u^k = moment for each order k."""
    powers = 2 * np.arange(len(orders))
    u, kernel = (np.asarray(x, float)[:, None] for x in (u, kernel))
    matrix = (u ** np.array(orders)).T @ (kernel * u**powers)
    coefficients = np.zeros(powers[-1] + 1)
    coefficients[powers] = np.linalg.solve(matrix, np.array(moments))
    return np.polynomial.Polynomial(coefficients)
