"""The spectra of a run: of positions, what the robot was told to do and how sharply it
moved; of torque, what is noise above the band of the motion, and whether it was
smoothed before it was logged."""

from collections.abc import Sequence

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals import constants as c
from sdp_vs_penalty.signals.kernels import Kernel
from sdp_vs_penalty.signals.repetition import ALIKE
from sdp_vs_penalty.signals.runs import Stretch, moving_joints, no_motion, split_at_gaps


def highest_harmonic(run: Measurements) -> float:
    """Highest frequency [Hz] at which some joint's position has 1 % of its largest
    amplitude.

    Raises InputError for a run without motion, or with gaps everywhere.
    """
    moving = moving_joints(run)
    if not moving.any():
        raise no_motion(run)
    harmonics = [
        _last_harmonic(part, part.q[:, moving])
        for part in split_at_gaps(run)
        if part.count >= 16
    ]
    highest = max(harmonics, default=0.0)
    if highest == 0.0:
        what = f"{len(run.t)} samples, but no 16 consecutive ones without a gap in time"
        raise InputError(what, "record longer", run.names[0])
    return highest


def _last_harmonic(part: Stretch, values: Array) -> float:
    """Highest frequency [Hz] at which one of some signals (N, n) has 1 % of its largest
    amplitude."""
    power, f = _power(part, values)
    return float(f[np.any(power > 1e-4 * power.max(axis=0), axis=1)].max(initial=0.0))


def _power(part: Stretch, values: Array) -> tuple[Array, Array]:
    """(F, n) the periodogram of signals (N, n), of a long stretch the mean over pieces
    (Welch 1967), and its frequencies [Hz]."""
    length = min(part.count, c.SAMPLES)
    starts = np.linspace(0, part.count - length, -(-part.count // length)).astype(int)
    spectra = (
        periodograms(part.resampled(values, k, k + length), length)[0] for k in starts
    )
    frequency: Array = np.asarray(np.fft.rfftfreq(length, part.dt), float)
    return np.asarray(np.mean(list(spectra), axis=0)), frequency


def periodograms(x: Array, length: int, degree: int = 0) -> Array:
    """(W, F, n) of windows of ``length`` samples of x (N, n), without their course of
    that degree, as what leaks of it hides that a torque was smoothed: of unit mean for
    white noise of unit variance."""
    window = np.hanning(length)[:, None]
    course = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, length), degree + 1))[0]
    pieces = np.stack(
        [x[k : k + length] for k in range(0, len(x) - length + 1, length // 2)]
    )
    moves = np.ptp(pieces, axis=1, keepdims=True) > 0.0
    pieces = np.where(moves, pieces - course @ (course.T @ pieces), 0.0)
    return np.asarray(
        np.abs(np.fft.rfft(pieces * window, axis=1)) ** 2 / np.sum(window**2)
    )


def unbent_cutoff(
    runs: Sequence[Measurements], cutoff: float, band: float, highest: float
) -> float:
    """The cut-off [Hz] of a state filter, from ``cutoff`` to ``highest``, that leaves
    the least error in the acceleration: what it bends of the motion within the ``band``
    [Hz] of the torque, and the noise of the positions that it lets through.

    A robot that sticks at its reversals moves more sharply than it was told to. The
    given cut-off stays where it takes away less of the acceleration than motions that
    are alike differ by, or wider ones are noisy on some joint.
    """
    steps = np.arange(1 + int(2.0 * np.log2(max(highest / cutoff, 1.0))))
    tried = np.asarray(cutoff * 2.0 ** (0.5 * steps), np.float64)
    bent, noise = np.concatenate([_errors(run, tried, band) for run in runs], axis=1)
    if not len(bent) or bent[:, 0].mean() < ALIKE**2:
        return cutoff
    noisy = noise.max(axis=0) > c.NOISY**2
    error = np.where(noisy & (tried > cutoff), np.inf, (bent + noise).mean(axis=0))
    return float(tried[np.argmin(error)])


def _errors(run: Measurements, cutoffs: Array, band: float) -> Array:
    """(2, joints, C) squares of the shares of moving joints' acceleration which filters
    with these cut-offs take away, and of the noise that they let through."""
    part = max(split_at_gaps(run), key=lambda p: p.count)
    length = min(part.count, c.SAMPLES)
    if length * part.dt * cutoffs[0] < 8.0:  # the kernel is no shorter than the stretch
        return np.zeros((2, 0, len(cutoffs)))
    powers, f = _power(part, part.q[:, moving_joints(run)])
    twice = (2.0 * np.pi * f) ** 4
    transfer = twice * _gain(Kernel(band, part.dt), length) ** 2
    gains = np.array([_gain(Kernel(x, part.dt), length) for x in cutoffs])
    # The spectrum is smoothed over 1 Hz.
    wide = np.ones(max(1, int(1.0 / f[1])))
    errors = []
    for power in powers.T:
        noise = float(power[f > c.LAST / part.dt].mean())
        below = np.convolve(power, wide / len(wide), mode="same") < c.ABOVE * noise
        motion = np.where(f < min(f[below], default=np.inf), power, 0.0) * transfer
        if motion.any():
            passed = noise * (twice @ gains.T**2)
            errors.append(
                (motion @ (1.0 - gains.T) ** 2 / motion.sum(), passed / motion.sum())
            )
    return np.array(errors).reshape(-1, 2, len(cutoffs)).swapaxes(0, 1)


def _gain(kernel: Kernel, length: int) -> Array:
    """(length // 2 + 1,) of a low-pass, at multiples of 1 / (length dt)."""
    padded = np.pad(kernel.value, (0, length - len(kernel.value)))
    return np.asarray(np.fft.rfft(np.roll(padded, -kernel.half)).real)


def torque_spectrum(
    parts: Sequence[Stretch], cutoff: float
) -> tuple[Array, Array, bool, bool] | None:
    """The noise of the torque of some stretches above a low-pass [Hz]: a first-order
    autoregression S(w) = c / (1 + a^2 - 2 a cos(w)), fitted to the quantiles QUIET over
    windows of periodograms (friction that turns round, or a blow, spoils some windows).

    Returns frequencies (F,) [Hz] at the first stretch's rate; S (n, F), of unit mean
    for white noise of unit variance; whether it was smoothed, and whether it is uneven.
    Unless half of some joint's amplitudes are within a factor NOISE_LIKE of S the
    torque was smoothed, as drives log currents, which says nothing of the noise below;
    where loud windows are farther than that above quiet ones it is uneven, and not
    noise alone. None where stretches are too short, or sampled too slowly, to show any.
    """
    if not parts:
        return None
    part = parts[0]
    length = 2 * round(1.0 / cutoff / part.dt)  # as far as the low-pass reaches
    known = [
        periodograms(p.resampled(p.tau, 0, min(p.count, c.SAMPLES)), length, degree=3)
        for p in parts
        if p.count >= length and p.dt == part.dt
    ]
    frequency: Array = np.asarray(np.fft.rfftfreq(length, part.dt), float)
    band = (frequency >= c.STOPS * cutoff) & (frequency <= c.LAST / part.dt)
    largest = max(float(np.abs(p.tau).max()) for p in parts)
    # A quantile needs some windows below it, a colour some frequencies.
    if sum(map(len, known)) * c.QUIET < 2.0 or band.sum() < 4 or largest == 0.0:
        return None
    # A periodogram of noise is exponential: so much of its mean is its quantile.
    quiet, loud = (
        np.quantile(np.concatenate(known), q, axis=0) / -np.log1p(-q)
        for q in (c.QUIET, 1.0 - c.QUIET)
    )
    # Channels that are stuck have the noise of rounding, beside the others'.
    powers = np.maximum(quiet, (64.0 * np.finfo(float).eps * largest) ** 2)
    turns = np.cos(2.0 * np.pi * frequency * part.dt)
    a = np.linspace(-0.9, 0.9, 181)[:, None]  # beyond, its corner is far below the band
    shapes = 1.0 / (1.0 + a**2 - 2.0 * a * turns)
    apart = np.log(
        powers[band].T[:, None] / shapes[:, band]
    )  # (n, colours, frequencies)
    best = np.argmin(np.var(apart, axis=2), axis=1)
    apart = np.take_along_axis(apart, best[:, None, None], axis=1)[:, 0]
    level = apart.mean(axis=1, keepdims=True)
    deviation = np.median(np.abs(apart - level), axis=1).max()
    swings = np.sqrt(np.maximum(loud, powers) / powers)[band].mean(axis=0).max()
    smoothed = deviation > 2.0 * np.log(c.NOISE_LIKE)
    uneven = swings > c.NOISE_LIKE
    return frequency, np.exp(level) * shapes[best], bool(smoothed), bool(uneven)


def smoothed_cutoff(runs: Sequence[Measurements], cutoff: float) -> float:
    """The cut-off [Hz] of a torque filter, at most the one given, below which there is
    torque: where every run's was smoothed before it was logged, the last frequency at
    which a joint's has 1 % of its largest amplitude, but a quarter of the one given.
    Above it columns would hold what torque lost."""
    last = 0.0
    for run in runs:
        spectrum = torque_spectrum(parts := list(split_at_gaps(run)), cutoff)
        if spectrum is None or not spectrum[2]:
            return cutoff
        longest = max(parts, key=lambda p: p.count)
        last = max(last, _last_harmonic(longest, longest.tau))
    return min(cutoff, max(last, 0.25 * cutoff))
