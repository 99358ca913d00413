"""Hums of a torque channel above the band of the motion: spectral lines of the logged
torque that keep their phase from the begin of a run to its end.

The filter of a diagnosis removes them with all else above its cut-off. So they are
looked for in the torque as it was logged.
"""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.events import (
    Event,
    hann_spectrum,
    is_of_line,
    refined_line,
    spectral_lines,
    stands_alone,
)
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.signals.runs import Stretch, split_at_gaps

#: Parts of a run in which a hum has to have one amplitude and one phase.
_PARTS = 8
#: Length of the mean of the parts' phasors over their RMS length, from which a line
#: keeps its phase. A ripple that a joint passes at changing speed reaches 0.4.
_COHERENT = 0.9
#: Share of the torque's variance above the band from which a hum is reported.
_LARGE_SHARE = 0.1
#: A run shorter than this [s] shows no phase that is kept.
_SHORTEST = 4.0


def find_hums_above(measurements: Measurements, cutoff: float) -> list[Event]:
    """List the hums of the logged torque above a frequency.

    A hum is a line of the torque's spectrum that stands alone, keeps amplitude and
    phase over the run, and makes a tenth of the variance above the band.

    Parameters
    ----------
    cutoff
        Upper end [Hz] of the band that the model is judged in.

    Returns
    -------
    list of Event
        One for each joint and run: the largest hum, with its amplitude.
    """
    out = []
    for run in measurements.runs():
        stretches = list(split_at_gaps(run))
        if not stretches:
            continue
        longest = max(stretches, key=lambda s: s.count)
        for joint in range(run.n):
            hum = _largest_hum(longest, joint, cutoff)
            if hum is not None:
                out.append(hum)
    return out


def _largest_hum(run: Stretch, joint: int, cutoff: float) -> Event | None:
    """Return the largest hum of a joint (from 0) in a stretch without gaps, or None."""
    t = run.t
    duration = t[-1] - t[0]
    if duration < _SHORTEST:
        return None
    rate = (len(t) - 1) / duration
    if 2.0 * cutoff >= rate:
        return None
    torque = run.tau[:, joint]
    window = np.hanning(len(t))
    power, frequency = hann_spectrum(torque, rate)
    above = power * (frequency > cutoff)
    lines = spectral_lines([torque], rate, run.tau.shape[1], lowest=cutoff)
    largest = 0.0
    hum = None
    for line in lines:
        energy = float(np.sum(above[is_of_line(line, frequency)]))
        is_large = energy >= max(largest, _LARGE_SHARE * float(above.sum()))
        if not is_large or not stands_alone(line, above, frequency):
            continue
        exact = refined_line(t, torque * window, line, frequency[1])
        phasor = _steady_phasor(t, torque, exact)
        if phasor is not None:
            largest = energy
            hum = Event(
                joint + 1,
                float(t[0]),
                float(t[-1]),
                what="hum",
                frequency=exact,
                amplitude=abs(phasor),
            )
    return hum


def _steady_phasor(t: Array, torque: Array, frequency: float) -> complex | None:
    """Return amplitude and phase of a line at a frequency [Hz] in a joint's torque (N,)
    at times t (N,) [s], as a complex number [N m or N].

    None if the parts of the run do not agree on it.
    """
    phasors = np.array(
        [
            _phasor_beside_parabola(t[rows], torque[rows], frequency)
            for rows in np.array_split(np.arange(len(t)), _PARTS)
        ]
    )
    mean = complex(phasors.mean())
    rms = float(nonzero_or_one(np.sqrt(np.mean(np.abs(phasors) ** 2))))
    return mean if abs(mean) > _COHERENT * rms else None


def _phasor_beside_parabola(t: Array, torque: Array, frequency: float) -> complex:
    """Fit a sine wave and a parabola to torque (N,) [N m or N], and return amplitude
    and phase of the wave as a complex number.

    :func:`line_phasor` of events.py fits no parabola: it takes the mean of a residual
    times the wave.
    """
    angle = 2.0 * np.pi * frequency * t
    place = np.linspace(-1.0, 1.0, len(t))
    window = np.hanning(len(t))
    columns = np.column_stack(
        [np.cos(angle), np.sin(angle), np.ones_like(place), place, place**2]
    )
    weighted = columns * window[:, None]
    fit = np.linalg.lstsq(weighted, torque * window, rcond=None)[0]
    return complex(fit[0], -fit[1])
