"""The noise of measured torque from its spectrum above the band of the motion (:mod:`.spectrum`),
continued below, where it passes the low-pass H of the rows: floor^2 = mean over w of S |H|^2."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.segments import SegmentedRuns
from sdp_vs_penalty.signals.spectrum import torque_spectrum

#: What the noise is known from.
SPECTRUM = "spectrum"
#: How well (.52 to 1.3 of the true floor): said wherever it is used.
SPECTRUM_KNOWN = "right within a factor of two"


def spectral_floor(runs: SegmentedRuns) -> Array | None:
    """(n,) standard deviation of the noise in the filtered rows [N m or N]; None where the logs are too
    short, or sampled too slowly, to show anything above the motion, and where a filter has taken it."""
    found = torque_spectrum([s.standstill.stretch for s in runs.segments], runs.cutoff)
    if found is None or found.smoothed:
        return None
    kernel = next(s.standstill for s in runs.segments if s.standstill.stretch is found.part).kernels[1]
    frequency, size = found.frequency, max(2 * len(found.frequency) - 2, 4 * len(kernel.value))
    response = np.abs(np.fft.rfft(kernel.value, size)) ** 2
    passed = np.interp(frequency, np.fft.rfftfreq(size, found.part.dt), response)
    weight = np.where((frequency > 0.0) & (frequency < 0.5 / found.part.dt), 2.0, 1.0)
    return np.asarray(np.sqrt(found.density @ (weight * passed) / np.sum(weight)))
