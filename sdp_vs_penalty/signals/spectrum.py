"""The spectra of a run: of positions, what the robot was told to do and how sharply it moved; of torque,
what is noise above the band of the motion, and whether it was smoothed before it was logged."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.kernels import Kernel
from sdp_vs_penalty.signals.runs import Stretch, moving_joints, no_motion, stretches

#: Samples of one spectrum; a longer stretch has the mean of the spectra of so many samples each.
_SPECTRUM = 1 << 18
#: Share of a joint's acceleration that a filter may take away unnoticed.
_BENT = 0.01
#: Share of it that the noise of a joint's positions may be behind a wider one.
_NOISY = 0.03
#: Motion is what has so many times the power of the noise.
_ABOVE = 10.0
#: Width [Hz] over which a spectrum is smoothed before it is compared with the noise.
_SMOOTH = 1.0
#: In torque cut-offs: where the motion has ended. In sample rates: the last frequency, and the one from
#: which on a log holds noise alone.
_MOTION_ENDS, _LAST, _LATEST = 2.0, 0.45, 0.33
#: Windows are so many periods of the cut-off long; fewest windows.
_PERIODS, _WINDOWS = 2.5, 12
#: Share of the windows that are quiet at least, and degree of the motion's course within one.
_QUIET, _DEGREE = 0.15, 3
#: Share of the windows that are no louder than the loud ones; so many times the quiet ones' amplitude is
#: more than noise. Panda and UR10e: 1.0 to 2.7; TX40 3.4 and 16 (its halves' floors differ 31-fold).
_LOUD, _UNEVEN = 0.9, 3.0
#: Coefficients a of the autoregression that are tried.
_COLOURS = np.linspace(-0.5, 0.97, 148)


def highest_harmonic(run: Measurements) -> float:
    """Highest frequency [Hz] at which some joint's position has 1 % of its largest amplitude.

    Raises InputError for a run without motion, or with gaps everywhere.
    """
    highest = 0.0
    moving = moving_joints(run)
    for part in stretches(run):
        count = part.count
        if count < 16:
            continue
        for j in np.flatnonzero(moving).tolist():
            length = min(count, _SPECTRUM)
            highest = max(highest, _last_harmonic(part, part.q[:, j], length))
    if highest == 0.0:
        if not moving.any():
            raise no_motion(run)
        raise InputError(
            f"{len(run.t)} samples, but no 16 consecutive ones without a gap in time",
            "record longer",
            run.names[0],
        )
    return highest


def _last_harmonic(part: Stretch, values: Array, length: int) -> float:
    """Highest frequency [Hz] at which a signal (N,) has 1 % of its largest amplitude."""
    amplitude = _amplitude(part, values, length)
    present = np.flatnonzero(amplitude > 0.01 * amplitude.max())
    return int(present.max(initial=0)) / (length * part.dt)


def _amplitude(part: Stretch, values: Array, length: int) -> Array:
    """Amplitudes of a signal (N,), at multiples of 1 / (length dt): the root of the sum of squares
    over pieces of that many samples (Welch 1967)."""
    starts = np.linspace(0, part.count - length, -(-part.count // length)).astype(int)
    power = np.zeros(length // 2 + 1)
    for start in starts:
        x = part.resampled(values[:, None], start, start + length)[:, 0]
        power += np.abs(np.fft.rfft(np.hanning(length) * (x - x.mean()))) ** 2 if np.ptp(x) else 0.0
    return np.sqrt(power)


def unbent_cutoff(runs: Sequence[Measurements], cutoff: float, band: float, highest: float) -> float:
    """The cut-off [Hz] of a state filter, from ``cutoff`` to ``highest``, that leaves the least error in
    the acceleration: what it bends of the motion within the ``band`` [Hz] of the torque, and the noise
    of the positions that it lets through.

    A robot that sticks at its reversals moves more sharply than it was told to. The given cut-off stays
    where it takes away less than a hundredth of the acceleration, or wider ones are noisy on some joint.
    """
    steps = np.arange(1 + int(2.0 * np.log2(max(highest / cutoff, 1.0))))
    tried = np.asarray(cutoff * 2.0 ** (0.5 * steps), np.float64)
    bent, noise = np.concatenate([_errors(run, tried, band) for run in runs], axis=1)
    if not len(bent) or bent[:, 0].mean() < _BENT**2:
        return cutoff
    noisy = noise.max(axis=0) > _NOISY**2
    error = np.where(noisy & (tried > cutoff), np.inf, (bent + noise).mean(axis=0))
    return float(tried[np.argmin(error)])


def _errors(run: Measurements, cutoffs: Array, band: float) -> Array:
    """(2, joints, C) squares of the shares of moving joints' acceleration which filters with
    these cut-offs take away, and of the noise that they let through."""
    part = max(stretches(run), key=lambda p: p.count)
    length = min(part.count, _SPECTRUM)
    if length * part.dt * cutoffs[0] < 8.0:  # the kernel is no shorter than the stretch
        return np.zeros((2, 0, len(cutoffs)))
    f = np.fft.rfftfreq(length, part.dt)
    twice = (2.0 * np.pi * f) ** 4
    seen = twice * _gain(Kernel(band, part.dt), length) ** 2
    gains = np.array([_gain(Kernel(c, part.dt), length) for c in cutoffs])
    found = []
    for j in np.flatnonzero(moving_joints(run)).tolist():
        power = _amplitude(part, part.q[:, j], length) ** 2
        noise = float(power[f > _LATEST / part.dt].mean())
        wide = np.ones(max(1, int(_SMOOTH / f[1])))
        below = np.convolve(power, wide / len(wide), mode="same") < _ABOVE * noise
        motion = np.where(f < min(f[below], default=np.inf), power, 0.0) * seen
        if motion.any():
            passed = noise * (twice @ gains.T**2)
            found.append((motion @ (1.0 - gains.T) ** 2 / motion.sum(), passed / motion.sum()))
    return np.array(found).reshape(-1, 2, len(cutoffs)).swapaxes(0, 1)


def _gain(kernel: Kernel, length: int) -> Array:
    """(length // 2 + 1,) of a low-pass, at multiples of 1 / (length dt)."""
    padded = np.zeros(length)
    padded[: len(kernel.value)] = kernel.value
    return np.asarray(np.fft.rfft(np.roll(padded, -kernel.half)).real)


@dataclass(frozen=True)
class TorqueSpectrum:
    """The noise of a torque by its spectrum above the motion: a first-order autoregression
    S(w) = c / (1 + a^2 - 2 a cos(w)), fitted to lower quartiles over windows of periodograms (friction
    that turns round, or a blow, spoils some windows).

    part : whose rate is that of the frequencies (F,) [Hz]; density (n, F) : S, of unit mean for white
    noise of unit variance. smoothed : that no autoregression follows the spectrum of some joint, as a
    filter leaves it (drives log smoothed currents), which says nothing of the noise below; uneven : that
    some joint's loud windows are far above its quiet ones, so that what is there is not noise alone.
    """

    part: Stretch
    frequency: Array
    density: Array
    smoothed: bool
    uneven: bool


def torque_spectrum(parts: Sequence[Stretch], cutoff: float) -> TorqueSpectrum | None:
    """The noise of the torque of some stretches above a low-pass [Hz]; None where they are too short, or
    sampled too slowly, to show any."""
    found = [_powers(part, cutoff) for part in parts]
    known = [p for p in found if p is not None]
    if not known or sum(len(p) for p in known) < _WINDOWS:
        return None
    part = next(p for p, f in zip(parts, found, strict=True) if f is not None)
    known = [p for p in known if p.shape[1] == known[0].shape[1]]
    # A periodogram of noise is exponential: so much of its mean is its quantile.
    quiet, loud = (
        np.quantile(np.concatenate(known), q, axis=0) / -np.log1p(-q) for q in (_QUIET, _LOUD)
    )
    frequency: Array = np.asarray(np.fft.rfftfreq(2 * (quiet.shape[0] - 1), part.dt), float)
    first = min(_MOTION_ENDS * cutoff, _LATEST / part.dt)
    band = (frequency >= first) & (frequency <= _LAST / part.dt)
    largest = max(float(np.abs(p.tau).max()) for p in parts)
    if band.sum() < 4 or largest == 0.0:
        return None
    # Channels that are stuck have the noise of rounding, beside the others'.
    powers = np.maximum(quiet, (64.0 * np.finfo(float).eps * largest) ** 2)
    turns = np.cos(2.0 * np.pi * frequency * part.dt)
    shapes = 1.0 / (1.0 + _COLOURS[:, None] ** 2 - 2.0 * _COLOURS[:, None] * turns)
    density: Array = np.zeros(powers.T.shape)
    away: Array = np.zeros(powers.shape[1])
    for j, own in enumerate(np.log(powers[band]).T):
        apart = own - np.log(shapes[:, band])
        best = int(np.argmin(np.var(apart, axis=1)))
        level = np.mean(apart[best])
        density[j] = np.exp(level) * shapes[best]
        away[j] = np.median(np.abs(apart[best] - level))
    # Half of the amplitudes are within the factor of two that is promised of the floor. Medians of
    # Panda, TX40, UR10e, EMPS: .1 to .9; of a UR10's smoothed torque: 1.8 to 2.5.
    smoothed = bool(away.max() > 2.0 * np.log(2.0))
    swings = np.sqrt(np.maximum(loud, powers) / powers)[band].mean(axis=0)
    return TorqueSpectrum(part, frequency, density, smoothed, bool(swings.max() > _UNEVEN))


def smoothed_cutoff(runs: Sequence[Measurements], cutoff: float) -> float:
    """The cut-off [Hz] of a torque filter, at most the one given, below which there is torque: where
    every run's was smoothed before it was logged, the last frequency at which a joint's has 1 % of its
    largest amplitude, but a quarter of the one given. Above it columns would hold what torque lost."""
    last = 0.0
    for run in runs:
        found = torque_spectrum(parts := list(stretches(run)), cutoff)
        if found is None or not found.smoothed:
            return cutoff
        part = max(parts, key=lambda p: p.count)
        length = min(part.count, _SPECTRUM)
        last = max(last, *(_last_harmonic(part, x, length) for x in part.tau.T))
    return min(cutoff, max(last, 0.25 * cutoff))


def _powers(part: Stretch, cutoff: float) -> Array | None:
    """(W, F, n) periodograms of windows of a stretch's torque, of unit mean for white noise of unit
    variance; None where it holds no window."""
    length = 2 * round(0.5 * _PERIODS / cutoff / part.dt)
    if part.count < length or cutoff * part.dt > _LATEST:
        return None
    window = np.hanning(length)[:, None]
    x = part.resampled(part.tau, 0, min(part.count, _SPECTRUM))
    starts = np.arange(0, len(x) - length + 1, length // 2)
    pieces = np.stack([x[k : k + length] for k in starts])
    course = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, length), _DEGREE + 1))[0]
    pieces = pieces - course @ (course.T @ pieces)
    return np.asarray(np.abs(np.fft.rfft(pieces * window, axis=1)) ** 2 / np.sum(window**2))
