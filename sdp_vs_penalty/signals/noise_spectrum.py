"""The noise of measured torque from its spectrum above the band of the motion.

Above the frequencies that a motion holds a torque's spectrum is that of its noise. It is modelled as a
first-order autoregression, S(w) = c / (1 + a^2 - 2 a cos(w)), fitted to lower quartiles over windows
of periodograms (friction that turns round, or a blow, spoils some windows), and continued below,
where it passes the low-pass H of the rows: floor^2 = mean over w of S |H|^2. A spectrum that no such
autoregression follows is what a filter has left of a noise (drives log smoothed currents): it says
nothing of the noise below.
"""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.runs import Stretch
from sdp_vs_penalty.signals.segments import SegmentedRuns

#: What the noise is known from.
SPECTRUM = "spectrum"
#: How well (.52 to 1.3 of the true floor): said wherever it is used.
SPECTRUM_KNOWN = "right within a factor of two"
#: In torque cut-offs: where the motion has ended. In sample rates: the last frequency, and the last one
#: at which the band may begin.
_ABOVE, _LAST, _LATEST = 2.0, 0.45, 0.33
#: Windows are so many periods of the cut-off long, and at least so many samples; fewest windows.
_PERIODS, _SHORTEST, _FEWEST = 2.5, 32, 12
#: Share of the windows that are quiet at least, and degree of the motion's course within one.
_QUIET, _DEGREE = 0.15, 3
#: Coefficients a of the autoregression that are tried.
_COLOURS = np.linspace(-0.5, 0.97, 148)


def spectral_floor(runs: SegmentedRuns) -> Array | None:
    """(n,) standard deviation of the noise in the filtered rows [N m or N]; None where the logs are too
    short, or sampled too slowly, to show anything above the motion, and where a filter has taken it."""
    parts = [s.standstill.stretch for s in runs.segments]
    found = [_powers(part, runs.cutoff) for part in parts]
    known = [p for p in found if p is not None]
    if not known or sum(len(p) for p in known) < _FEWEST:
        return None
    part = next(p for p, f in zip(parts, found, strict=True) if f is not None)
    known = [p for p in known if p.shape[1] == known[0].shape[1]]
    # A periodogram of noise is exponential: so much of its mean is its quantile.
    powers = np.quantile(np.concatenate(known), _QUIET, axis=0) / -np.log1p(-_QUIET)
    size = 2 * (powers.shape[0] - 1)
    frequency = np.fft.rfftfreq(size, part.dt)
    first = min(_ABOVE * runs.cutoff, _LATEST / part.dt)
    band = (frequency >= first) & (frequency <= _LAST / part.dt)
    largest = max(float(np.abs(p.tau).max()) for p in parts)
    if band.sum() < 4 or largest == 0.0:
        return None
    # Channels that are stuck have the noise of rounding, beside the others'.
    powers = np.maximum(powers, (64.0 * np.finfo(float).eps * largest) ** 2)
    turns = np.cos(2.0 * np.pi * frequency * part.dt)
    shapes = 1.0 / (1.0 + _COLOURS[:, None] ** 2 - 2.0 * _COLOURS[:, None] * turns)
    kernel = next(s.standstill for s in runs.segments if s.standstill.stretch is part).kernels[1]
    response = np.abs(np.fft.rfft(kernel.value, max(size, 4 * len(kernel.value)))) ** 2
    passed = np.interp(frequency, np.fft.rfftfreq(max(size, 4 * len(kernel.value)), part.dt), response)
    weight = np.where((frequency > 0.0) & (frequency < 0.5 / part.dt), 2.0, 1.0)
    out = np.zeros(powers.shape[1])
    for j, own in enumerate(np.log(powers[band]).T):
        apart = own - np.log(shapes[:, band])
        best = int(np.argmin(np.var(apart, axis=1)))
        level = np.mean(apart[best])
        # It is the autoregression's where half of its amplitudes are within the factor of two that is
        # promised. Panda, TX40, UR10e, EMPS: medians .1 to .9; a UR10's smoothed torque: 2.2 to 2.5.
        if np.median(np.abs(apart[best] - level)) > 2.0 * np.log(2.0):
            return None
        density = np.exp(level) * shapes[best]
        out[j] = np.sqrt(np.sum(weight * density * passed) / np.sum(weight))
    return out


def _powers(part: Stretch, cutoff: float) -> Array | None:
    """(W, F, n) periodograms of windows of a stretch's torque, of unit mean for white noise of unit
    variance; None where it holds no window."""
    length = max(_SHORTEST, 2 * round(0.5 * _PERIODS / cutoff / part.dt))
    if part.count < length or cutoff * part.dt > _LATEST:
        return None
    window = np.hanning(length)[:, None]
    x = part.resampled(part.tau, 0, part.count)
    starts = np.arange(0, len(x) - length + 1, length // 2)
    pieces = np.stack([x[k : k + length] for k in starts])
    course = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, length), _DEGREE + 1))[0]
    pieces = pieces - course @ (course.T @ pieces)
    return np.asarray(np.abs(np.fft.rfft(pieces * window, axis=1)) ** 2 / np.sum(window**2))
