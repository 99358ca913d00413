"""The low-pass of positions, columns and torque as a kernel, with its first two
derivatives.

A windowed sinc of half-length 2 / cut-off, made maximally flat: its moments of order 2,
4 and 6 vanish, so that it is exact on polynomials of degree 7 and its gain differs from
1 by 5e-8 at a tenth of the cut-off, 1 % at half of it; at the cut-off it is 1/2 (what
forward and backward Butterworth filtering gives).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import ArrayLike

from sdp_vs_penalty.robot.arrays import Array, Indices


class LowPass:
    """A low-pass filter on a uniform grid: a symmetric kernel (2 half + 1,), to
    convolve samples with."""

    def __init__(self, value: Array) -> None:
        """Keep the kernel ``value`` (2 half + 1,)."""
        self.value = value
        self.half = len(value) // 2


#: Rows of one dense block of a decimator.
_ROWS_PER_BLOCK = 16


class Decimator:
    """The matrix (M, N) that low-passes N samples and takes M of the outputs.

    Output m is the low-passed signal at sample ``at[m]``, in ascending order. The
    matrix consists of dense blocks of a few rows: neighbouring rows share most of their
    samples, which makes it several times as fast as sparse rows.
    """

    def __init__(self, kernel: LowPass, at: Indices) -> None:
        """Make the blocks of the matrix whose outputs are the low-passed signal at the
        samples ``at`` (M,), in ascending order."""
        self.kernel = kernel
        self.at = at
        size = len(kernel.value)
        #: The samples that each block reads, and the block.
        self.blocks: list[tuple[slice, Array]] = []
        known: dict[bytes, Array] = {}  # evenly spaced rows share one block
        for start in range(0, len(at), _ROWS_PER_BLOCK):
            block_rows = at[start : start + _ROWS_PER_BLOCK]
            places = block_rows - block_rows[0]
            block = known.get(places.tobytes())
            if block is None:
                block = known[places.tobytes()] = np.zeros(
                    (len(block_rows), places[-1] + size)
                )
                taps = places[:, None] + np.arange(size)
                rows = np.arange(len(block_rows))[:, None]
                block[rows, taps] = kernel.value[::-1]
            begin = int(block_rows[0]) - kernel.half
            self.blocks.append((slice(begin, begin + block.shape[1]), block))

    def __matmul__(self, x: Array) -> Array:
        """Return the low-passed rows (M, ...) of signals x (N, ...)."""
        shape = x.shape[1:]
        flat = x.reshape(len(x), int(np.prod(shape)))
        none = flat[:0]  # a decimator may have no rows
        parts = [block @ flat[samples] for samples, block in self.blocks]
        return np.concatenate([none, *parts]).reshape(len(self.at), *shape)

    def part(self, start: int, stop: int) -> tuple[Decimator, slice]:
        """Return the decimator of a slice of the rows, for a chunk of the samples.

        Parameters
        ----------
        start, stop : int
            First row, and one past the last.

        Returns
        -------
        Decimator
            Its samples count from the first one that these rows need.
        slice
            The samples that the rows need, from half a kernel before the first row to
            half a kernel behind the last.
        """
        at = self.at[start:stop]
        half = self.kernel.half
        first = int(at[0]) - half
        last = int(at[-1]) + half
        return Decimator(self.kernel, at - first), slice(first, last + 1)

    def __abs__(self) -> Decimator:
        """Return the decimator with the absolute values of the kernel, to bound what it
        passes."""
        return Decimator(LowPass(np.abs(self.kernel.value)), self.at)


class Kernel(LowPass):
    """A low-pass and its first two derivatives, sampled at dt.

    h(t) = sinc(t) hann(u) (c_0 + c_1 u^2 + c_2 u^4 + c_3 u^6), u = t / support, with c
    such that its moments are those of an impulse up to order 7; the derivatives'
    moments are those of an impulse's derivatives.
    """

    def __init__(self, cutoff: float, dt: float) -> None:
        """Sample the low-pass of a cut-off [Hz], and its first two derivatives, every
        ``dt`` [s].

        Each is a product of sinc, Hann window and polynomial, by the product rule; each
        is then multiplied by a polynomial that makes the moments of its samples exact.
        """
        self.cutoff = cutoff
        self.dt = dt
        self.half = int(np.ceil(2.0 / cutoff / dt))
        support = (self.half + 1) * dt  # the window is zero one sample beyond the ends
        t = np.asarray(np.arange(-self.half, self.half + 1) * dt, float)
        u = t / support
        sinc, sinc1, sinc2 = _sinc_derivatives(2.0 * np.pi * cutoff, t)
        a = np.pi / support
        cosine = np.cos(a * t)
        hann = 0.5 + 0.5 * cosine
        hann1 = -0.5 * a * np.sin(a * t)
        hann2 = -0.5 * a**2 * cosine
        h = sinc * hann
        h1 = sinc1 * hann + sinc * hann1
        h2 = sinc2 * hann + 2.0 * sinc1 * hann1 + sinc * hann2
        even = (0, 2, 4, 6)
        odd = (1, 3, 5, 7)
        polynomial = _moment_factor(h, u, even, (1.0, 0.0, 0.0, 0.0))
        c = polynomial(u)
        c1 = polynomial.deriv(1)(u)
        c2 = polynomial.deriv(2)(u)
        self.value = h * c
        first = h1 * c + h * c1 / support
        second = h2 * c + 2.0 * h1 * c1 / support + h * c2 / support**2
        # The moments of the samples differ a little from those of the function that
        # they sample.
        slope = (-1.0 / support, 0.0, 0.0, 0.0)
        bend = (0.0, 2.0 / support**2, 0.0, 0.0)
        self.first = first * _moment_factor(first, u, odd, slope)(u)
        self.second = second * _moment_factor(second, u, even, bend)(u)

    def states(self, q: Array) -> tuple[Array, Array, Array]:
        """Filter positions, and differentiate them twice.

        Parameters
        ----------
        q : (N, n) array
            Positions, sampled every dt [rad or m].

        Returns
        -------
        q, dq, ddq : (N - 2 half, n) arrays
            Low-passed positions and their first and second derivative by time, at the
            samples with half a kernel on either side.
        """
        # Relative to the first row, so that rounding errors are relative to the motion.
        centred = q - q[:1]
        low, first, second = convolve(centred, self.value, self.first, self.second)
        return low + q[:1], first, second

    def sampled(self, stride: int) -> LowPass:
        """Return the same low-pass on a coarser grid, with the same response below half
        of its rate.

        Parameters
        ----------
        stride : int
            How many times coarser the grid is.
        """
        if stride == 1:
            return self
        offsets = np.arange(-(self.half // stride), self.half // stride + 1)
        value = self.value[self.half + stride * offsets]
        u = offsets / max(offsets[-1], 1)
        factor = _moment_factor(value, u, (0, 2, 4, 6), (1.0, 0.0, 0.0, 0.0))
        return LowPass(value * factor(u))


def _sinc_derivatives(w: float, t: Array) -> tuple[Array, Array, Array]:
    """Return sin(w t) / t and its first and second derivative by t, each (N,), at
    instants t (N,) [s]; w [rad/s]. At t = 0 they are w, 0 and -w^3 / 3."""
    safe = np.where(t == 0.0, 1.0, t)
    sine = np.sin(w * t)
    cosine = np.cos(w * t)
    value = np.where(t == 0.0, w, sine / safe)
    first = np.where(t == 0.0, 0.0, (w * cosine - value) / safe)
    second = (-(w**2) * sine - 2.0 * first) / safe
    return value, first, np.where(t == 0.0, -(w**3) / 3.0, second)


def convolve(x: Array, *kernels: Array) -> list[Array]:
    """Convolve channels x (N, n) with several kernels (K,) of one odd length, where
    kernel and channel overlap fully.

    Returns one array (N - K + 1, n) a kernel; its columns are contiguous in memory. One
    Fourier transform of x serves all kernels; what wraps around is cut off.
    scipy.signal does the same, but takes longer to import than a robot to identify.
    """
    length = scipy.fft.next_fast_len(len(x), real=True)
    spectrum = scipy.fft.rfft(x.T, length)
    filtered = list[Array]()
    for kernel in kernels:
        out = scipy.fft.irfft(spectrum * scipy.fft.rfft(kernel, length), length)
        filtered.append(out[:, len(kernel) - 1 : len(x)].T)
    return filtered


def autoregressive(poles: ArrayLike, inputs: Array) -> Array:
    """Filter samples (N,) by 1 / poles: sum over m of poles_m y_(i - m) = inputs_i,
    with poles (1 + k,), 1 first.

    The filter is at rest before the first sample. scipy.signal does the same, but takes
    longer to import than a robot to identify.
    """
    # A banded triangular system: BLAS holds its diagonals as rows.
    diagonals = np.repeat(np.asarray(poles, float)[:, None], len(inputs), axis=1)
    solved = scipy.linalg.blas.dtbsv(
        len(diagonals) - 1, np.asfortranarray(diagonals), inputs, lower=1, diag=1
    )
    return solved


def _moment_factor(
    kernel: ArrayLike, u: ArrayLike, orders: Sequence[int], moments: Sequence[float]
) -> np.polynomial.Polynomial:
    """Return the even polynomial c(u) that gives a kernel prescribed moments.

    For each order k and its moment m_k: sum over the samples of kernel c(u) u^k = m_k.

    Parameters
    ----------
    kernel, u : (N,) array
        Samples of the kernel, and their places.
    orders, moments : sequence of K numbers
        The conditions; the polynomial has the K powers 0, 2, ... 2 K - 2.
    """
    powers = 2 * np.arange(len(orders))
    u = np.asarray(u, float)
    weights = np.asarray(kernel, float)[:, None]
    raised = np.vander(u, 2 * len(orders), increasing=True)
    matrix = raised[:, orders].T @ (weights * raised[:, powers])
    coefficients = np.zeros(powers[-1] + 1)
    coefficients[powers] = np.linalg.solve(matrix, np.array(moments))
    return np.polynomial.Polynomial(coefficients)
