"""Isolated disturbances: what happens once and is no function of the motion, such as a
contact or a knock; and hums above the band of the motion.

Events are rows in which the final model's residual is an outlier: windows of whitened
residual with too much energy (:mod:`~sdp_vs_penalty.signals.coloured_noise`), in only
one repetition where the motion repeats. A hum is a line in the spectrum: the power of
whitened noise at the frequencies of a periodogram is distributed exponentially.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.constants import MINOR
from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.results.remedy import Change, Remedy
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask, nonzero_or_one
from sdp_vs_penalty.signals.coloured_noise import (
    FALSE_EVENT,
    RARE,
    cut_into_stretches,
    local_excess,
    lone_windows,
    noise_profile,
    robust_scale,
)
from sdp_vs_penalty.signals.constants import SAME_PHASE
from sdp_vs_penalty.signals.runs import Stretch, split_at_gaps
from sdp_vs_penalty.signals.spectrum import periodograms
from sdp_vs_penalty.signals.standstill import SLOW
from sdp_vs_penalty.signals.timing import largest_timing_errors, torque_rates

#: Times a joint's RMS error that a peak has to reach to be reported. In rows without
#: noise the smallest error of a model stands out of the noise: such windows of fresh
#: arms reach 0.3 to 1.
_LARGE = 2.0
#: Times the largest power within _NEAR [Hz] that the power of a hum has to reach. The
#: lines that a model's error takes from the motion stand side by side.
_ALONE = 5.0
_NEAR = 2.0
#: Half width of a line in a spectrum with a Hann window, in steps of its frequencies:
#: the main lobe reaches two.
_LOBE = 2.5


@dataclass(frozen=True)
class Event(JsonRecord):
    """What happened once in the measurements: an isolated disturbance or a hum."""

    #: Number of the joint, from 1.
    joint: int
    #: Begin [s] on the clock of the measurements.
    t_start: float
    #: End [s] on the clock of the measurements.
    t_end: float
    #: "local" for an isolated disturbance, or "hum".
    what: str = "local"
    #: Frequency of a hum [Hz], else None.
    frequency: float | None = None
    #: Amplitude of a hum [N m or N], else None.
    amplitude: float | None = None
    #: Name of the recording; "" for a hum.
    run: str = ""

    @property
    def sentence(self) -> str:
        """What happened, and when."""
        what = f"isolated disturbance on joint {self.joint}"
        return f"{what}: {self.t_start:.2f} s to {self.t_end:.2f} s"

    @property
    def remedy(self) -> Remedy:
        """What would keep a disturbance out of the model: leaving its span out."""
        span = [self.t_start, self.t_end]
        words = f"leave {span[0]:.2f} s to {span[1]:.2f} s of {self.run} out"
        change = Change("cut", words, {"run": self.run, "spans": [span]})
        return Remedy(self.sentence, "possible", "it happens once", change)

    def order(self) -> tuple[float, int]:
        """Return what events are sorted by: the time at which they begin, then the
        joint.
        """
        return self.t_start, self.joint


def find_events(
    data: WhiteData, outlier_rows: Mask, residual: Array, unexplained: Sequence[int]
) -> list[Event]:
    """List the isolated disturbances that the final model leaves.

    Parameters
    ----------
    outlier_rows
        (M, n) rows in which the residual is an outlier.
    residual
        (M, n) what the model leaves [N m or N].
    unexplained
        Joints (from 0) with unexplained torque: their outliers are no events.

    Returns
    -------
    list of Event
        By time. A disturbance is cut to the rows that hold nearly all of its energy.
    """
    rows = data.rows
    mask = outlier_rows.copy()
    mask[:, list(unexplained)] = False
    out = []
    rates = torque_rates(rows)
    for j in range(rows.n):
        for group in _groups_in_time(data, mask[:, j], j):
            core = _core_of_event(group, residual[:, j])
            limits = np.maximum(
                _LARGE * _rms(residual[:, j]),
                _timing_limits(data, residual[:, j], rates[:, j], core, j),
            )
            if (np.abs(residual[core, j]) < limits).all():
                continue
            begin = float(rows.t[core[0]])
            end = float(rows.t[core[-1]])
            run = rows.names[int(rows.run[core[0]])].partition(", ")[0]  # of a window
            out.append(Event(j + 1, begin, end, run=run))
    return sorted(out, key=Event.order)


def _groups_in_time(data: WhiteData, outlier_rows: Mask, joint: int) -> list[Indices]:
    """Divide the outlier rows of one joint into groups, one for each event.

    A gap of more than 2 SAME_PHASE seconds between two outlier rows begins a new group.

    ``joint`` counts from 0.

    Parameters
    ----------
    data
        White rows (weighted so that the noise is independent with variance 1).
    outlier_rows
        (M,) flags of the outlier rows.

    Returns
    -------
    list of int arrays
        The row numbers of each group.
    """
    rows = data.rows
    out = []
    all_rows = replace(rows, masked=np.zeros((0, 0), bool))  # masked ones, too
    for piece in all_rows.pieces[joint]:
        event_rows = piece[outlier_rows[piece]]
        if len(event_rows):
            is_far = np.diff(rows.t[event_rows]) > 2.0 * SAME_PHASE
            out += np.split(event_rows, np.flatnonzero(is_far) + 1)
    return out


def _core_of_event(group: Indices, residual: Array) -> Indices:
    """Cut an event to the rows between the first and the last that carry its energy.

    These are the rows with the largest squared residuals that together hold 99 % of the
    energy. The cut is needed since the windows that are searched are longer than
    events.

    Parameters
    ----------
    group
        Row numbers of the event.
    residual
        (M,) residual of the joint [N m or N].
    """
    squares = residual[group] ** 2
    largest_first = np.argsort(-squares)
    most_of_energy = (1.0 - MINOR) * squares.sum()
    energy = np.cumsum(squares[largest_first])
    n_needed = int(np.searchsorted(energy, most_of_energy)) + 1
    places = largest_first[:n_needed]
    return group[places.min() : places.max() + 1]


def _timing_limits(
    data: WhiteData, residual: Array, rates: Array, event: Indices, joint: int
) -> Array:
    """Return the largest errors that being late explains in the rows of an event.

    How late the torque is the log shows elsewhere: farther than SAME_PHASE seconds from
    the event.

    ``joint`` counts from 0.

    Parameters
    ----------
    residual
        (M,) residual of the joint [N m or N].
    rates
        (M,) rate of the joint's modelled torque [N m/s or N/s].
    event
        (K,) row numbers of the event, in order.

    Returns
    -------
    (K,) array
        Absolute errors [N m or N].
    """
    rows = data.rows
    begin, end = rows.t[event[[0, -1]]]
    is_near = (rows.t > begin - SAME_PHASE) & (rows.t < end + SAME_PHASE)
    is_elsewhere = ~is_near | (rows.segment != rows.segment[event[0]])
    size = max(2, round(2.0 * SAME_PHASE * rows.rate))
    stretches = cut_into_stretches(rows.pieces[joint], size)
    elsewhere = [stretch[is_elsewhere[stretch]] for stretch in stretches]
    return largest_timing_errors(residual, rates, elsewhere)[event]


def outliers(data: WhiteData, white: Array, residual: Array) -> Mask:
    """Flag the rows with isolated disturbances, in which the residual is an outlier.

    An outlier is a window of rows with too much energy for the noise. It is a
    disturbance only if no other window in the same state of motion, and no other
    repetition of the motion, shows the like: what repeats is an error of the model.
    Rows in which a repetition differs from the others are suspect in any case.

    Parameters
    ----------
    data
        White rows (weighted so that the noise is independent with variance 1).
    white
        (M, n) whitened residual; 0 where there is none.
    residual
        (M, n) residual [N m or N].

    Returns
    -------
    (M, n) bool array
    """
    rows = data.rows
    noise = data.noise
    unrepeated = _unrepeated_rows(data, residual)
    out = np.zeros(white.shape, bool)
    for j in range(rows.n):
        # The noise may be larger than estimated. A scale from the median corrects that,
        # and is not changed by an event.
        is_known = white[:, j] != 0.0
        # Errors of timing grow with the rate of the torque: the corner of a trapezoid
        # move has the largest rate of a log, and is no event.
        rates = data.rates[j]
        swells = noise_profile(white[:, j], rates, rates)
        even = white[:, j] / swells
        steady = even / max(robust_scale(even[is_known]), 1.0)
        degrees = float(noise.degrees[j])
        is_outlier = local_excess(steady, rows.pieces[j], rows.n, degrees)
        suspect = unrepeated[:, j]
        if is_outlier.any() or suspect.any():
            slow = (rows.slow[:, j] > SLOW) | (rows.still[:, j] > 0.0)
            # A push of a second stands out of the torque in N m rather than out of the
            # whitened one, in which slow changes are small.
            torque = residual[:, j] * is_known / swells
            # Alone among the windows of its state of motion, in N m or whitened; or far
            # above all windows while the joint moves fast.
            lone = _lone_rows(data, torque, j, slow)
            lone |= _lone_rows(data, even, j, slow)
            lone |= ~slow & _stands_out(torque, rows.pieces[j], rows.n)
            is_outlier &= lone
            # Repetitions also differ while a joint is slow, by friction.
            suspect = suspect & (lone | ~slow)
        # Outliers in many rows are an error of the model, and no events.
        if is_outlier.sum() < RARE * rows.keep[:, j].sum():
            out[:, j] = is_outlier
        out[:, j] |= suspect
    return out & ~_repeated_outliers(data, out)


def _lone_rows(data: WhiteData, series: Array, joint: int, slow: Mask) -> Mask:
    """Flag the rows (M,) of outlier windows for which no other window in the same state
    of motion has a similar residual.

    ``joint`` counts from 0.

    Parameters
    ----------
    series
        (M,) residual of the joint.
    slow
        (M,) flags the rows in which the joint moves slowly or reverses: one of two
        states.
    """
    rows = data.rows
    return lone_windows(series, rows.pieces[joint], slow, rows.rate, rows.n)


def _rms(torque: Array) -> float:
    """Return the root mean square of a residual (M,) over its rows that are not zero.

    Zero marks rows without a residual. The result is 1 if all are zero, since it
    divides.
    """
    n_known = max(float(np.count_nonzero(torque)), 1.0)
    return float(nonzero_or_one(np.sqrt(np.sum(torque**2) / n_known)))


def _stands_out(torque: Array, pieces: Sequence[Indices], tests: int) -> Mask:
    """Flag the rows (M,) of windows with much more energy than the others of all
    motion.

    The residual is divided by its RMS, and windows are tested as if it were white
    noise.

    Parameters
    ----------
    torque
        (M,) residual of a joint [N m or N]; 0 where there is none.
    pieces
        Row numbers of each uninterrupted piece of the motion.
    tests
        Number of joints that are searched, for the chance of a false alarm.
    """
    degrees = max(float(np.count_nonzero(torque)), 1.0)
    return local_excess(torque / _rms(torque), pieces, tests, degrees)


def _near_in_time(mask: Mask, rate: float) -> Mask:
    """Flag the rows (M, n) within SAME_PHASE seconds of a flagged row; rate in Hz."""
    return _sums_near_in_time(mask.astype(float), rate) > 0.5


def _sums_near_in_time(series: Array, rate: float) -> Array:
    """Sum a series (M, n) over the rows within SAME_PHASE seconds of each; ``rate`` in
    Hz.
    """
    width = np.ones(2 * max(1, round(SAME_PHASE * rate)) + 1)
    return np.array([np.convolve(x, width, mode="same") for x in series.T]).T


def _repeated_outliers(data: WhiteData, is_outlier: Mask) -> Mask:
    """Flag the outlier rows (M, n) at whose phase another repetition has an outlier,
    too.

    The phases may differ by SAME_PHASE seconds.
    """
    near = _near_in_time(is_outlier, data.rows.rate)
    out = np.zeros_like(is_outlier)
    for repeat in data.noise.repeats:
        # Numbers of the rows of one repetition, and of another at the same phases.
        in_both = near[repeat.rows] & near[repeat.there]
        out[repeat.rows] |= in_both
        np.logical_or.at(out, repeat.there, in_both)  # rows may come twice
    return out


def _unrepeated_rows(data: WhiteData, residual: Array) -> Mask:
    """Flag the rows (M, n) that differ from another repetition of the same motion.

    ``noise.suspect`` flags both repetitions. Of the two only the one with more energy
    of the residual (M, n) near that phase keeps its flag.
    """
    rows = data.rows
    repeats = data.noise.repeats
    suspect = data.noise.suspect
    if not suspect.any():
        return suspect
    is_near_suspect = _near_in_time(suspect, rows.rate)
    energy = _sums_near_in_time(residual**2, rows.rate)
    out = suspect.copy()
    for repeat in repeats:
        # Numbers of the rows of one repetition, and of another at the same phases.
        first = repeat.rows
        second = repeat.there
        first_has_less = energy[first] <= energy[second]
        out[first] &= ~(is_near_suspect[second] & first_has_less)
        cleared = np.zeros_like(out)
        second_has_less = is_near_suspect[first] & ~first_has_less
        np.logical_or.at(cleared, second, second_has_less)  # rows may come twice
        out &= ~cleared
    return out


def refined_line(t: Array, series: Array, line: float, step: float) -> float:
    """Return the frequency [Hz] near a spectral line at which a series (N,) at times t
    (N,) [s] has most power.

    Parameters
    ----------
    line
        Frequency of the line [Hz].
    step
        Largest distance [Hz] from the line; frequencies a twentieth of it apart are
        compared.
    """
    if not len(t):
        return line
    frequencies = line + step * np.linspace(-1.0, 1.0, 41)
    # One frequency at a time: a log may have millions of rows.
    amplitudes = [abs(line_phasor(t, series, f)) for f in frequencies]
    return float(frequencies[np.argmax(amplitudes)])


def line_phasor(t: Array, series: Array, frequency: float) -> complex:
    """Return amplitude and phase of a sine wave of a frequency [Hz] in a series (N,) at
    times t (N,) [s], as a complex number."""
    if not len(t):
        return 0j
    return complex(2.0 * np.mean(series * np.exp(-2j * np.pi * frequency * t)))


def hann_spectrum(series: Array, rate: float) -> tuple[Array, Array]:
    """Return the power of a series (N,) with a Hann window, and its frequencies [Hz].

    The series has a sampling rate [Hz]; its mean is taken out.
    """
    spectrum = np.fft.rfft((series - series.mean()) * np.hanning(len(series)))
    frequency = np.asarray(np.fft.rfftfreq(len(series), 1.0 / rate))
    return np.abs(spectrum) ** 2, frequency


def is_of_line(line: float, frequency: Array) -> Mask:
    """Return which frequencies (K,) [Hz] of a spectrum with a Hann window belong to the
    line at a frequency [Hz].
    """
    return np.abs(frequency - line) < _LOBE * frequency[1]


def stands_alone(line: float, power: Array, frequency: Array) -> bool:
    """Return whether a line's power is five times that of any other within 2 Hz.

    Parameters
    ----------
    line
        Frequency of the line [Hz].
    power, frequency
        (K,) a spectrum with a Hann window, and its frequencies [Hz].
    """
    is_line = is_of_line(line, frequency)
    is_neighbour = (np.abs(frequency - line) < _NEAR) & ~is_line
    largest_beside = power[is_neighbour].max(initial=0.0)
    return bool(power[is_line].max() > _ALONE * largest_beside)


def _median_of_neighbours(power: Array, half: int) -> Array:
    """Return the median of each value of a spectrum (K,) and ``half`` values on each
    side of it.

    The first value stands for those before it. The last ones are mirrored: a line there
    is no neighbour of its own.
    """
    if len(power) <= half:
        return scipy.ndimage.median_filter(power, size=2 * half + 1, mode="nearest")
    padded = np.pad(power, (half, 0), mode="edge")
    padded = np.pad(padded, (0, half), mode="reflect")
    median = scipy.ndimage.median_filter(padded, size=2 * half + 1)
    return median[half : half + len(power)]


def spectral_lines(
    series: Sequence[Array],
    rate: float,
    tests: int,
    lowest: float = 0.8,
    smooth: float = 1.0,
    highest: float = np.inf,
) -> list[float]:
    """Find frequencies [Hz] at which a periodogram, of a sampling rate [Hz], stands out
    of its surroundings.

    Parameters
    ----------
    series
        Records of one channel, each at least 2 s long; their periodograms are summed.
    tests
        Number of channels tested, for the chance of a false line.
    lowest
        Frequency [Hz] below which lines are the motion's own harmonics.
    smooth
        Width [Hz] over which the noise's spectrum is taken as flat.
    highest
        Frequency [Hz] above which a filter has made the spectrum fall: a line below it
        is compared with its neighbours below it.
    """
    length = min((len(s) for s in series), default=0)
    if length < 2.0 * rate:
        return []
    pieces = list[Array]()
    for values in series:
        starts = range(0, len(values) - length + 1, length)
        pieces += [values[start : start + length] for start in starts]
    power = periodograms(np.stack(pieces, axis=1), length)[0].sum(axis=1)
    pooled = len(pieces)
    frequency = np.fft.rfftfreq(length, 1.0 / rate)
    # At least 8 neighbours on each side, and no more than there are, whatever the clock.
    half = max(8, min(int(smooth / frequency[1]), length))
    in_band = frequency <= highest
    power = power[in_band]
    frequency = frequency[in_band]
    median = _median_of_neighbours(power, half)
    # The sum of ``pooled`` exponentials has a gamma distribution: its mean from its
    # median, and 2 pooled times power over mean is chi-squared.
    level = median / float(scipy.special.gammaincinv(pooled, 0.5)) * pooled
    with np.errstate(divide="ignore", invalid="ignore"):
        excess = np.where(level > 0.0, power / level, 0.0) * 2 * pooled
    false_chance = FALSE_EVENT / (len(power) * tests)
    limit = float(scipy.special.chdtri(2 * pooled, false_chance))
    # The median of 2 half + 1 values is itself uncertain by about 1 / sqrt(half).
    limit *= 1.0 + 4.0 / np.sqrt(2.0 * half * pooled)
    is_line = (excess > limit) & (frequency > lowest)
    # One line spreads over some bins: the largest of 7 counts.
    peaks = is_line & (excess >= scipy.ndimage.maximum_filter1d(excess, 7))
    return [float(f) for f in frequency[peaks]]


# Hums above the band of the motion. The filter of a diagnosis removes them with all else
# above its cut-off, so that they are looked for in the torque as it was logged.

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
