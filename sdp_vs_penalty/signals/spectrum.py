"""The spectrum of a run's positions: what the robot was told to do, and how sharply it moved."""

from __future__ import annotations

from collections.abc import Sequence

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
#: Above this share of the sample rate positions are noise; motion is what has so many times its power.
_NOISE_FROM, _ABOVE = 0.3, 10.0
#: Width [Hz] over which a spectrum is smoothed before it is compared with the noise.
_SMOOTH = 1.0


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
            amplitude = _amplitude(part, j, length)
            present = np.flatnonzero(amplitude > 0.01 * amplitude.max())
            if len(present):
                highest = max(highest, int(present[-1]) / (length * part.dt))
    if highest == 0.0:
        if not moving.any():
            raise no_motion(run)
        raise InputError(
            f"{len(run.t)} samples, but no 16 consecutive ones without a gap in time",
            "record longer",
            run.names[0],
        )
    return highest


def _amplitude(part: Stretch, j: int, length: int) -> Array:
    """Amplitudes of a joint's position, at multiples of 1 / (length dt): the root of the sum of squares
    over pieces of that many samples (Welch 1967)."""
    starts = np.linspace(0, part.count - length, -(-part.count // length)).astype(int)
    power = np.zeros(length // 2 + 1)
    for start in starts:
        q = part.resampled(part.q[:, j : j + 1], start, start + length)[:, 0]
        power += np.abs(np.fft.rfft(np.hanning(length) * (q - q.mean()))) ** 2 if np.ptp(q) else 0.0
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
        power = _amplitude(part, j, length) ** 2
        noise = float(power[f > _NOISE_FROM / part.dt].mean())
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
