"""The spectra of a run: of positions, what the robot was told to do and how sharply it
moved; of torque, what is noise above the band of the motion, and whether it was
smoothed before it was logged."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array, Mask
from sdp_vs_penalty.signals.constants import (
    MOTION_OVER_NOISE,
    NOISE_IN_ACCELERATION,
    NOISE_LIKE,
    QUIET_SHARE,
    REVERSAL_SHIFT,
    SAMPLES,
    STATE_CUTOFF_RATIO,
    STOP_BAND,
    USED_SHARE_OF_RATE,
)
from sdp_vs_penalty.signals.kernels import Kernel
from sdp_vs_penalty.signals.repetition import SAME_MOTION
from sdp_vs_penalty.signals.runs import Stretch, moving_joints, no_motion, split_at_gaps

#: Fewest samples of a spectrum.
_FEWEST_SAMPLES = 16
#: Degree of the polynomial that is taken out of each window of torque or position.
_DEGREE = 3
#: A frequency is used if a window without its polynomial keeps at least this share of
#: the power of white noise there.
_PASSED = 0.5
#: Quiet windows contradict a fit where they hold less than this share of its power.
_CONTRADICTED = 0.8
#: Power of 1 % of an amplitude, as a share of the largest [-].
_SMALLEST_POWER = 1e-4


def highest_harmonic(run: Measurements) -> float:
    """Return the highest frequency [Hz] at which some joint's position has 1 % of its
    largest amplitude.

    The reference is the largest amplitude in the run, not in the stretch: in a short
    stretch between two gaps a joint may hardly move, and its noise would count as
    motion.

    Raises
    ------
    InputError
        For a run without motion, or with gaps everywhere.
    """
    moving = moving_joints(run)
    if not moving.any():
        raise no_motion(run)
    parts = [part for part in split_at_gaps(run) if part.count >= _FEWEST_SAMPLES]
    highest = 0.0
    if parts:
        highest = _highest_strong_frequency(
            parts, [part.q[:, moving] for part in parts]
        )
    if highest == 0.0:
        what = (
            f"{len(run.t)} samples, but no {_FEWEST_SAMPLES} consecutive ones without a"
            " gap in time"
        )
        raise InputError(what, "record longer", run.names[0])
    return highest


def _highest_strong_frequency(
    parts: Sequence[Stretch], signals: Sequence[Array]
) -> float:
    """Return the highest frequency [Hz] at which one of n signals, (N, n) for each
    stretch, has 1 % of its largest amplitude in any stretch.

    The reference is at least a hundredth of the largest amplitude of all signals: a
    joint that is held still trembles at any frequency, and that is no motion.
    """
    spectra = []
    frequencies = []
    for part, signal in zip(parts, signals, strict=True):
        power, frequency = _power(part, signal)
        # Of a sine, the power grows with the length of its stretch.
        spectra.append(power / min(part.count, SAMPLES))
        frequencies.append(frequency)
    largest = np.max([spectrum.max(axis=0) for spectrum in spectra], axis=0)
    largest = np.maximum(largest, _SMALLEST_POWER * largest.max())
    highest = 0.0
    for spectrum, frequency in zip(spectra, frequencies, strict=True):
        is_strong = np.any(spectrum > _SMALLEST_POWER * largest, axis=1)
        highest = max(highest, float(frequency[is_strong].max(initial=0.0)))
    return highest


def _power(part: Stretch, values: Array) -> tuple[Array, Array]:
    """Estimate the power spectra (F, n) of n signals (N, n) of a stretch, in units of
    the signals' variance, and their frequencies (F,) [Hz].

    A long stretch is cut into pieces, whose periodograms are averaged (Welch 1967).
    """
    length = min(part.count, SAMPLES)
    n_pieces = -(-part.count // length)  # rounded up
    starts = np.linspace(0, part.count - length, n_pieces).astype(int)
    pieces = [part.resampled(values, start, start + length) for start in starts]
    spectra = [periodograms(piece, length)[0] for piece in pieces]
    frequency = np.asarray(np.fft.rfftfreq(length, part.dt), float)
    return np.mean(spectra, axis=0), frequency


def periodograms(x: Array, length: int, degree: int = 0) -> Array:
    """Compute periodograms of overlapping windows of n signals x (N, n); white noise of
    unit variance has a mean of one.

    A polynomial is taken out of each window first: a slow course would leak into higher
    frequencies, and hide that a torque was smoothed.

    Parameters
    ----------
    length : int
        Samples of a window; windows overlap by half.
    degree : int
        Degree of the polynomial that is taken out.

    Returns
    -------
    (W, F, n) array
        Periodograms of W windows at F = length // 2 + 1 frequencies; 0 for a signal
        that is constant in a window.
    """
    window = np.hanning(length)[:, None]
    # Orthonormal polynomials, (length, degree + 1).
    places = np.linspace(-1.0, 1.0, length)
    powers = np.vander(places, degree + 1)
    polynomials = np.linalg.qr(powers)[0]
    starts = range(0, len(x) - length + 1, length // 2)
    pieces = np.stack([x[k : k + length] for k in starts])
    changes = np.ptp(pieces, axis=1, keepdims=True) > 0.0
    without_course = pieces - polynomials @ (polynomials.T @ pieces)
    # A constant channel has no spectrum, rather than one of rounding errors.
    pieces = np.where(changes, without_course, 0.0)
    spectrum = np.fft.rfft(pieces * window, axis=1)
    return np.abs(spectrum) ** 2 / np.sum(window**2)


def sharpest_cutoff(
    runs: Sequence[Measurements], torque_cutoff: float, highest: float
) -> float:
    """Choose the cut-off of the filter of q, dq, ddq.

    It is STATE_CUTOFF_RATIO times that of the torque's low-pass, so that all that this passes is
    whole in the states. It is lower where noise of a velocity, of standard deviation
    s_v, would turn dry friction round at the wrong time: within s_v / a of a reversal
    with an acceleration a. That time has to be short, REVERSAL_SHIFT, beside the time constant
    1 / (2 pi torque_cutoff) over which the torque is averaged.

    Returns the cut-off [Hz].

    Parameters
    ----------
    torque_cutoff : float
        Cut-off of the torque's low-pass [Hz], the lowest that is tried.
    highest : float
        The highest cut-off that is tried [Hz].
    """
    # From the highest cut-off down, in steps of a quarter of an octave or less.
    n_octaves = np.log2(max(min(STATE_CUTOFF_RATIO, highest / torque_cutoff), 1.0))
    widths = 2.0 ** np.linspace(n_octaves, 0.0, 1 + int(np.ceil(4.0 * n_octaves)))
    spectra = [_PositionSpectrum.from_run(run) for run in runs]
    for cutoff in torque_cutoff * widths:
        early = max(x.time_of_noise(cutoff, torque_cutoff) for x in spectra)
        if early < REVERSAL_SHIFT / (2.0 * np.pi * torque_cutoff):
            break
    return float(cutoff)


@dataclass(frozen=True)
class _PositionSpectrum:
    """Power of the positions of a run's moving joints, in its longest stretch."""

    #: (F, n) power, in units of the positions' variance.
    powers: Array
    #: (F,) frequencies [Hz].
    frequency: Array
    #: Samples of a spectrum.
    length: int
    #: Time between two samples [s].
    dt: float

    @classmethod
    def from_run(cls, run: Measurements) -> Self:
        """Estimate the spectrum of a run."""
        part = max(split_at_gaps(run), key=lambda p: p.count)
        powers, frequency = _power(part, part.q[:, moving_joints(run)])
        return cls(powers, frequency, min(part.count, SAMPLES), part.dt)

    def time_of_noise(self, state_cutoff: float, torque_cutoff: float) -> float:
        """Return the largest ratio s_v / a of the joints [s]: by so much, noise of the
        velocity shifts the sign of a velocity at a reversal.

        s_v is the velocity's noise behind the low-pass of the states, a the acceleration
        behind that of the torque (both root mean squares; cut-offs in Hz). 0 for a run
        shorter than the filter.
        """
        if self._is_shorter_than_filter(state_cutoff):
            return 0.0
        # A derivative by time multiplies the power by w^2, w = 2 pi frequency.
        w_squared = (2.0 * np.pi * self.frequency) ** 2
        velocity_gain = w_squared * self._gain(state_cutoff) ** 2
        acceleration_gain = w_squared**2 * self._gain(torque_cutoff) ** 2
        # At the highest frequencies there is only noise; it is taken for white.
        is_noise = self.frequency > USED_SHARE_OF_RATE / self.dt
        noise = self.powers[is_noise].mean(axis=0)
        velocity_noise = noise * velocity_gain.sum()
        acceleration = acceleration_gain @ self.powers
        ratios = velocity_noise / np.maximum(acceleration, np.finfo(float).tiny)
        return float(np.sqrt(ratios.max(initial=0.0)))

    def errors(self, cutoffs: Array, torque_cutoff: float) -> Array:
        """Compute the errors that low-passes make in the accelerations of the joints.

        Parameters
        ----------
        cutoffs : (C,) array
            Cut-offs of the low-pass of the states [Hz].
        torque_cutoff : float
            Cut-off of the torque's low-pass, through which accelerations pass too [Hz].

        Returns
        -------
        (2, joints, C) array
            Squared errors over the mean square acceleration: of the motion that a
            filter takes away, and of the noise that it lets through. No joints for a
            run shorter than the filter.
        """
        errors = []
        if not self._is_shorter_than_filter(cutoffs[0]):
            frequency = self.frequency
            # From the power of a position to that of its acceleration: w^4.
            w_to_fourth = (2.0 * np.pi * frequency) ** 4
            acceleration_gain = w_to_fourth * self._gain(torque_cutoff) ** 2
            gains = np.array([self._gain(cutoff) for cutoff in cutoffs])  # (C, F)
            share_taken = (1.0 - gains.T) ** 2
            noise_gain = w_to_fourth @ gains.T**2
            for power in self.powers.T:  # of each joint
                motion, noise = self._split_motion_from_noise(power)
                acceleration = motion * acceleration_gain
                total = acceleration.sum()
                if acceleration.any():
                    lost = acceleration @ share_taken / total
                    errors.append((lost, noise * noise_gain / total))
        return np.array(errors).reshape(-1, 2, len(cutoffs)).swapaxes(0, 1)

    def _split_motion_from_noise(self, power: Array) -> tuple[Array, float]:
        """Return the power (F,) of a joint's motion, and that of its white noise.

        Noise is what the highest frequencies hold. The motion ends at the first
        frequency where the power, smoothed over 1 Hz, is less than MOTION_OVER_NOISE
        times the noise.
        """
        frequency = self.frequency
        is_high = frequency > USED_SHARE_OF_RATE / self.dt
        noise = float(power[is_high].mean())
        width = min(max(1, int(1.0 / frequency[1])), len(frequency))
        smooth = np.convolve(power, np.ones(width) / width, mode="same")
        is_noise = smooth < MOTION_OVER_NOISE * noise
        end_of_motion = min(frequency[is_noise], default=np.inf)
        return np.where(frequency < end_of_motion, power, 0.0), noise

    def _is_shorter_than_filter(self, cutoff: float) -> bool:
        """Whether the stretch is shorter than twice a kernel, which reaches 2 / cut-off
        each way."""
        return self.length * self.dt * cutoff < 8.0

    def _gain(self, cutoff: float) -> Array:
        """Return the gain (F,) of a low-pass of this cut-off [Hz] at the frequencies.

        The kernel is rolled so that its middle is at sample 0: its transform is then
        real.
        """
        kernel = Kernel(cutoff, self.dt)
        padded = np.pad(kernel.value, (0, self.length - len(kernel.value)))
        centred = np.roll(padded, -kernel.half)
        return np.fft.rfft(centred).real


def least_error_cutoff(
    runs: Sequence[Measurements], lowest: float, torque_cutoff: float, highest: float
) -> float:
    """Choose the cut-off [Hz] of the filter of q, dq, ddq with the least error in
    acceleration, for a log without torque: load and drive torque come from the same
    states, so that neither is filtered less than the other.

    The error has two parts, both within the band of the torque: motion that the filter
    takes away, and noise of the positions that it lets through. Cut-offs are tried in
    steps of half an octave. The lowest stays if it takes away less than SAME_MOTION,
    1 %, of the acceleration: repetitions of one motion differ by as much. A higher one
    whose noise on some joint is more than NOISE_IN_ACCELERATION times the acceleration
    is not taken. Robots that stick at reversals move more sharply than commanded, and
    need a higher cut-off.

    Parameters
    ----------
    lowest, highest : float
        The lowest and the highest cut-off that is tried [Hz].
    torque_cutoff : float
        Cut-off of the torque's low-pass [Hz].
    """
    n_octaves = np.log2(max(highest / lowest, 1.0))
    steps = np.arange(1 + int(2.0 * n_octaves))
    candidates = np.asarray(lowest * 2.0 ** (0.5 * steps), np.float64)
    # Mean squares over that of the acceleration; (joints of all runs, candidates).
    spectra = [_PositionSpectrum.from_run(run) for run in runs]
    errors_by_run = [spectrum.errors(candidates, torque_cutoff) for spectrum in spectra]
    motion_lost, noise_passed = np.concatenate(errors_by_run, axis=1)
    has_no_rows = not len(motion_lost)
    if has_no_rows or motion_lost[:, 0].mean() < SAME_MOTION**2:
        return lowest
    mean_error = (motion_lost + noise_passed).mean(axis=0)
    is_too_noisy = noise_passed.max(axis=0) > NOISE_IN_ACCELERATION**2
    # The lowest cut-off is always allowed.
    mean_error = np.where(is_too_noisy & (candidates > lowest), np.inf, mean_error)
    return float(candidates[np.argmin(mean_error)])


@dataclass(frozen=True)
class TorqueNoise:
    """The noise of a torque above a low-pass, as a first-order autoregression."""

    #: (F,) frequencies [Hz].
    frequency: Array
    #: (n, F) power, of unit mean for white noise of unit variance.
    spectrum: Array
    #: Whether the torque was smoothed before it was logged.
    is_smoothed: bool
    #: Whether loud windows are far above quiet ones, so that it is not noise alone.
    is_uneven: bool


def torque_spectrum(parts: Sequence[Stretch], cutoff: float) -> TorqueNoise | None:
    """Fit the noise of the torque above a low-pass, with its cut-off [Hz], by a
    first-order autoregression.

    Its spectrum is S(w) = c / (1 + a^2 - 2 a cos(w)), w [rad/sample]. It is fitted to a
    low quantile (QUIET_SHARE) of periodograms over windows, because friction at reversals, or
    a blow, makes some windows loud. At no frequency is the noise more than these quiet
    windows hold (:func:`_lowered_to_quiet_windows`). The torque counts as smoothed unless half of each
    joint's amplitudes are within a factor NOISE_LIKE of S: drives smooth currents
    before they log them, and the noise below the low-pass then stays unknown. The
    torque counts as uneven if loud windows exceed quiet ones by more than that factor.

    Parameters
    ----------
    parts : sequence of Stretch
        The stretches; only those with the first one's sample time are used.

    Returns
    -------
    TorqueNoise or None
        None if the stretches are too short, or sampled too slowly, to show any noise.
    """
    if not parts:
        return None
    dt = parts[0].dt
    windows, frequency = _windows(parts, cutoff, [p.tau for p in parts])
    band = (frequency >= STOP_BAND * cutoff) & (frequency <= USED_SHARE_OF_RATE / dt)
    largest = max(float(np.abs(p.tau).max()) for p in parts)
    # A quantile needs some windows below it, a colour some frequencies.
    n_windows = sum(map(len, windows))
    if n_windows * QUIET_SHARE < 2.0 or band.sum() < 4 or largest == 0.0:
        return None
    joined = np.concatenate(windows)
    # Channels that are stuck have the noise of rounding, beside the others'.
    rounding = (64.0 * np.finfo(float).eps * largest) ** 2
    quiet = np.maximum(_mean_by_quantile(joined, QUIET_SHARE), rounding)
    loud = np.maximum(_mean_by_quantile(joined, 1.0 - QUIET_SHARE), quiet)
    spectrum, deviation = _autoregression(quiet, 2.0 * np.pi * frequency * dt, band)
    swings = np.sqrt(loud / quiet)[band].mean(axis=0).max()
    return TorqueNoise(
        frequency,
        _lowered_to_quiet_windows(spectrum, quiet.T),
        is_smoothed=bool(deviation > 2.0 * np.log(NOISE_LIKE)),
        is_uneven=bool(swings > NOISE_LIKE),
    )


def _windows(
    parts: Sequence[Stretch], cutoff: float, signals: Sequence[Array]
) -> tuple[list[Array], Array]:
    """Return the periodograms (W, F, n) of the windows of each stretch, and their
    frequencies (F,) [Hz].

    A window is as long as a low-pass of this cut-off [Hz] reaches. ``signals`` are (N, n)
    at the samples of each stretch. Stretches that are shorter than a window, or have not
    the first one's sample time, are left out.
    """
    dt = parts[0].dt
    length = 2 * round(1.0 / cutoff / dt)
    windows = []
    for part, signal in zip(parts, signals, strict=True):
        if part.count >= length and part.dt == dt:
            samples = part.resampled(signal, 0, min(part.count, SAMPLES))
            windows.append(periodograms(samples, length, _DEGREE))
    return windows, np.asarray(np.fft.rfftfreq(length, dt), float)


def _lowered_to_quiet_windows(spectrum: Array, quiet: Array) -> Array:
    """Return a fitted spectrum of noise (n, F), lowered where quiet windows (n, F) hold
    less.

    Whatever quiet windows hold is noise and perhaps more, so that the noise is at most
    that. The fit is to frequencies above the motion. Below them it is too large where
    the drive has filtered its torque: noise behind a low-pass is flat there.
    """
    passed = _passed_by_windows(2 * (quiet.shape[1] - 1))
    # Below this frequency the polynomial of a window has taken so much of its power that
    # the rest says little.
    first_used = int(np.argmax(passed >= _PASSED))
    ratio = quiet[:, first_used:] / passed[first_used:] / spectrum[:, first_used:]
    # The last frequency is real: its power is not exponential, as a quantile assumes.
    ratio[:, -1] = ratio[:, -2]
    # A mean over three neighbours: a single frequency may be low by chance.
    padded = np.pad(ratio, ((0, 0), (1, 1)), mode="edge")
    ratio = (padded[:, :-2] + ratio + padded[:, 2:]) / 3.0
    lowered = spectrum.copy()
    lowered[:, first_used:] *= np.minimum(ratio, 1.0)
    # A fit that quiet windows contradict at some frequency is not trusted below the
    # first used one: its power there is at most that at the first used one.
    is_contradicted = ratio.min(axis=1) < _CONTRADICTED
    flat = np.minimum(lowered[:, :first_used], lowered[:, [first_used]])
    lowered[is_contradicted, :first_used] = flat[is_contradicted]
    return lowered


def _passed_by_windows(length: int) -> Array:
    """Return the share (F,) of the power of white noise that a window keeps at each
    frequency when its polynomial of _DEGREE is taken out.
    """
    window = np.hanning(length)
    places = np.linspace(-1.0, 1.0, length)
    polynomials = np.linalg.qr(np.vander(places, _DEGREE + 1))[0]
    # The polynomials are orthonormal: each takes its own power out of white noise.
    spectra = np.fft.rfft(window[:, None] * polynomials, axis=0)
    taken = np.sum(np.abs(spectra) ** 2, axis=1) / np.sum(window**2)
    return 1.0 - taken


def position_noise(parts: Sequence[Stretch], cutoff: float) -> Array | None:
    """Estimate the white noise of positions from their spectrum above the motion.

    It is that of the encoders' steps, and of a clock that jitters, which turns velocity
    into noise.

    Parameters
    ----------
    parts : sequence of Stretch
        The stretches; only those with the first one's sample time are used.
    cutoff : float
        Cut-off of the torque's low-pass [Hz].

    Returns
    -------
    (n,) array or None
        Standard deviation of each joint's position [rad or m]; None if the stretches
        are too short, or sampled too slowly, to show any noise.
    """
    if not parts:
        return None
    windows, frequency = _windows(parts, cutoff, [p.q for p in parts])
    above = frequency >= max(STOP_BAND * cutoff, 0.25 / parts[0].dt)
    if not windows or not above.any():
        return None
    power = np.concatenate(windows)[:, above].mean(axis=(0, 1))
    return np.sqrt(power)


def _mean_by_quantile(powers: Array, share: float) -> Array:
    """Estimate the mean (F, n) of periodograms (W, F, n) of noise by their quantile
    ``share`` over the windows, which loud windows do not disturb.

    A periodogram of noise is exponential: its quantile is -log(1 - share) of its mean.
    """
    quantile = np.quantile(powers, share, axis=0)
    return quantile / -np.log1p(-share)


def _autoregression(powers: Array, angle: Array, band: Mask) -> tuple[Array, float]:
    """Fit the spectrum c / (1 + a^2 - 2 a cos(w)) of a first-order autoregression to
    powers, and tell how far they are off it.

    Parameters
    ----------
    powers : (F, n) array
        Powers of n joints' noise.
    angle : (F,) array
        Frequencies w [rad/sample].
    band : (F,) array of bool
        Frequencies that are fitted.

    Returns
    -------
    (n, F) array
        The fitted spectra, at all frequencies.
    float
        How far the worst joint is off the law, in natural logarithms of power. It is the
        median absolute deviation over the band, or how much louder the band's lowest
        half octave is, if that is more: from there the law is continued down to the
        motion's frequencies.
    """
    # Coefficients that are tried; beyond, the corner is far below the band.
    a = np.linspace(-0.9, 0.9, 181)[:, None]
    shapes = 1.0 / (1.0 + a**2 - 2.0 * a * np.cos(angle))  # (181, F)
    # log c of each joint and coefficient is the mean of these over the band; the best
    # coefficient is the one with which they vary least. (n, 181, frequencies of band)
    log_ratio = np.log(powers[band].T[:, None] / shapes[:, band])
    best = np.argmin(np.var(log_ratio, axis=2), axis=1)
    log_ratio = np.take_along_axis(log_ratio, best[:, None, None], axis=1)[:, 0]
    log_c = log_ratio.mean(axis=1, keepdims=True)
    off_law = log_ratio - log_c  # (n, frequencies of band)
    is_lowest = angle[band] <= np.sqrt(2.0) * angle[band][0]
    louder = np.median(off_law[:, is_lowest], axis=1).max()
    deviation = max(np.median(np.abs(off_law), axis=1).max(), louder)
    return np.exp(log_c) * shapes[best], float(deviation)


def smoothed_cutoff(runs: Sequence[Measurements], cutoff: float) -> float:
    """Lower the cut-off [Hz] of a torque filter, if the torque was smoothed before it
    was logged.

    It is then the highest frequency at which some joint's torque has 1 % of its largest
    amplitude: above it the columns of a model would hold torque that the log has lost.

    Returns
    -------
    float
        The cut-off [Hz], from a quarter of the given one to the given one; the given
        one unless all runs were smoothed.
    """
    highest = 0.0
    for run in runs:
        parts = list(split_at_gaps(run))
        noise = torque_spectrum(parts, cutoff)
        if noise is None or not noise.is_smoothed:
            return cutoff
        longest = max(parts, key=lambda p: p.count)
        of_run = _highest_strong_frequency([longest], [longest.tau])
        highest = max(highest, of_run)
    return min(cutoff, max(highest, 0.25 * cutoff))
