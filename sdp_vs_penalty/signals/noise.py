"""The noise of measured torque, from repetition: free of any model's error.

Where a motion repeats, a model's residual r repeats too, whatever the model gets wrong,
and r(t) - r(t + T) holds only noise (twice), events, and what depends on time instead
of motion: drift. Drift is taken out by regression on its columns, events by their local
energy; what is left gives the noise floor and an autoregression that makes the noise
white. r(t + T) is read by a cubic spline from samples at eight times the cut-off, at
which the low-passed residual is a smooth curve: read between samples at its own rate,
noise would be averaged and its floor too low.

Where nothing repeats it is that of the torque's spectrum above the motion's band
(:func:`spectral_floor`); where the log holds nothing there the residual itself has to
stand in, and what is called noise is a guess.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import smooth_sign
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.signals.coloured_noise import (
    ORDER,
    RARE,
    Pieces,
    autoregression,
    local_excess,
    noise_profile,
    robust_scale,
)
from sdp_vs_penalty.signals.constants import SAME_PHASE
from sdp_vs_penalty.signals.kernels import Kernel
from sdp_vs_penalty.signals.repetition import (
    Repeat,
    consecutive,
    is_part,
    new_differences,
    pairs,
    phases,
    recurring,
)
from sdp_vs_penalty.signals.segments import SegmentedRuns
from sdp_vs_penalty.signals.spectrum import torque_spectrum
from sdp_vs_penalty.signals.standstill import STILL

#: What the noise is known from.
REPETITION = "repetition"
SPECTRUM = "spectrum"
RESIDUAL = "residual"
#: How well from the spectrum (.52 to 1.3 of the true floor): said wherever it is used.
SPECTRUM_KNOWN = "right within a factor of two"
#: Fewest differences from which a floor is believed.
_FEWEST = 60


@dataclass(frozen=True)
class Noise:
    """The noise of each joint, below the cut-off of the runs that it was measured in.

    floor (n,) [N m or N]: its standard deviation; ar (n, ORDER) : autoregression; sigma
    (n,) : standard deviation of the whitened noise; degrees (n,) of freedom behind it;
    source : REPETITION, SPECTRUM or RESIDUAL (a guess: the model's error is in it);
    suspect (M, n) : rows where the repetition shows an event; profile (M, n) : how the
    motion swells the noise, around 1; held (M, n) : standard deviation of what friction
    adds while a joint stands still; repeats : what repeats what.
    """

    floor: Array
    ar: Array
    sigma: Array
    degrees: Array
    source: str
    suspect: NDArray[np.bool_]
    profile: Array
    held: Array
    repeats: tuple[Repeat, ...] = ()

    @cached_property
    def scale(self) -> Array:
        """(M, n) standard deviation of the innovations; rows that follow one of a joint
        that stood still remember it."""
        variance = (self.sigma * self.profile) ** 2 + self.held**2
        for lag, a in enumerate(self.ar.T, start=1):
            variance[lag:] += (a * self.held[:-lag]) ** 2
        return np.sqrt(variance)

    @cached_property
    def worth(self) -> Array:
        """(M, n) how much of a row's information standing still has left, from 0 to 1."""
        return np.asarray((self.sigma * self.profile / self.scale) ** 2)

    def whiten(self, values: Array, joint: int, pieces: Pieces) -> Array:
        """(M, k) columns or (M,) a series, filtered to white noise of unit variance.

        The first ORDER rows of each piece have no past and become zero.
        """
        white = np.asarray(pieces.filter(self.ar[joint], len(self.scale)) @ values)
        scale = self.scale[:, joint]
        return np.asarray(white / (scale if values.ndim == 1 else scale[:, None]))


def noise_of(runs: SegmentedRuns, noise_runs: SegmentedRuns | None = None) -> Noise:
    """The noise from repetition; where too little repeats from the torque's spectrum,
    at most the model's residual, or from that residual alone, and then taken for white:
    a colour would be that of the model's error, and hide what is looked for.

    noise_runs : all that was measured, where ``runs`` are windows of it: the noise is that
    of the whole, which may repeat what a window does not; profile, suspect and repeats
    are of the rows of ``runs``.
    """
    known = _from_repetition(noise_runs or runs, runs)
    if known is not None:
        return known
    guess = noise_in(runs, runs.residual)
    floor = spectral_floor(runs)
    floor_estimate = guess.floor if floor is None else np.minimum(floor, guess.floor)
    source = RESIDUAL if floor is None else SPECTRUM
    return replace(
        guess,
        floor=floor_estimate,
        sigma=floor_estimate,
        ar=np.zeros_like(guess.ar),
        source=source,
    )


def noise_in(runs: SegmentedRuns, residual: Array) -> Noise:
    """A guess: all of a residual (M, n) taken for noise, in rows during which the joint
    moves."""
    n = runs.n
    moving = [_without(runs.pieces[j], runs.still[:, j] >= STILL) for j in range(n)]
    parts = [autoregression(residual[:, j], moving[j]) for j in range(n)]
    ar, sigma, degrees = (np.array(values) for values in zip(*parts, strict=True))
    floor = np.array(
        [
            residual[np.concatenate(p), j].std() if p else 0.0
            for j, p in enumerate(moving)
        ]
    )
    suspect = np.zeros_like(runs.keep)
    return Noise(
        floor, ar, sigma, degrees, RESIDUAL, suspect, np.ones_like(residual), runs.held
    )


def _without(pieces: Pieces, marked: NDArray[np.bool_]) -> Pieces:
    """Without the rows that are marked, unless too few would be left."""
    others = Pieces(p[~marked[p]] for p in pieces)
    return others if len(others.predicted) >= _FEWEST else pieces


def _from_repetition(runs: SegmentedRuns, shown: SegmentedRuns) -> Noise | None:
    """The noise of ``runs``, on the rows of ``shown``: theirs, or those of windows of
    them.

    A joint that stands still does so again when the motion repeats, and what friction
    holds there too: it is no noise, but evidence only as far as a law of friction says
    it.
    """
    repeats = runs.repeats()
    if sum(len(r.rows) for r in repeats) < _FEWEST:
        return None
    n = runs.n
    count = len(runs.t)
    difference = differences(runs, repeats)
    both = pairs(repeats)
    index, later = both.T
    differences_of_repeats = Pieces(consecutive(repeats))
    stuck = (
        runs.unexplained_standstill_torque[1][index]
        | runs.unexplained_standstill_torque[1][later]
    )
    share = min(1.0, new_differences(both, count) / len(index))
    reach = max(1, round(SAME_PHASE * runs.rate))
    comes_back = partial(recurring, both, phases(both, count), reach)
    # What offset and frictions leave of a difference when they drift, ever slower or
    # faster.
    t = runs.t[index]
    speed = runs.dq[index]
    rates = rate_features(runs)
    gap = np.concatenate([r.later - runs.t[r.rows] for r in repeats])
    since = t - t.mean()

    rates_shown = rates if shown is runs else rate_features(shown)
    profile = np.ones((rates_shown.shape[1], n))
    suspect = np.zeros((count, n), bool)
    floor = np.zeros(n)
    ar = np.zeros((n, ORDER))
    sigma = np.zeros(n)
    degrees = np.zeros(n)
    for j, dq in enumerate(speed.T):
        laws = np.column_stack([np.ones_like(t), smooth_sign(dq), dq])
        drift = gap[:, None] * np.column_stack([laws, since[:, None] * laws])
        drift /= nonzero_or_one(np.linalg.norm(drift, axis=0))
        pieces = _without(differences_of_repeats, stuck[:, j])
        differences_without_drift, good = _without_events(
            difference[:, j], drift, rates[j][index], pieces, n, comes_back
        )
        steady = Pieces(p[good[p]] for p in pieces)
        ar[j], deviation, free = autoregression(differences_without_drift, steady)
        used = sum(map(len, steady))
        rank = int(np.linalg.matrix_rank(drift * good[:, None]))
        left = max(used - rank, 1)  # slow columns take noise with them
        floor[j] = np.sqrt(
            sum(np.sum(differences_without_drift[p] ** 2) for p in steady) / left
        )
        sigma[j], degrees[j] = (
            deviation * np.sqrt(used / left),
            max(share * free - rank, 1.0),
        )
        # Known on the rows that repeat, wanted on all.
        white = (
            steady.filter(ar[j], len(differences_without_drift))
            @ differences_without_drift
        )
        swell = noise_profile(white, rates[j][index], rates[j])
        floor[j] *= np.sqrt(np.mean(swell[runs.keep[:, j]] ** 2))
        profile[:, j] = noise_profile(white, rates[j][index], rates_shown[j])
        suspect[both[~good], j] = True  # an event may have happened at either instant
    if shown is not runs:
        suspect = _carried(suspect, runs, shown)
        repeats = shown.repeats()
    held, no_law = shown.unexplained_standstill_torque
    suspect &= ~no_law
    return Noise(floor, ar, sigma, degrees, REPETITION, suspect, profile, held, repeats)


def _carried(
    suspect: NDArray[np.bool_], runs: SegmentedRuns, shown: SegmentedRuns
) -> NDArray[np.bool_]:
    """(M, n) whether the rows of windows ``shown`` are within a row of what is suspect
    in ``runs``."""
    out = []
    for window in shown.segments:
        marked = np.zeros((len(window.t), runs.n), bool)
        for number, source_segment in enumerate(runs.segments):
            if is_part(window, source_segment):
                rows_here = suspect[runs.segment == number]
                at = np.searchsorted(source_segment.t, window.t)
                for k in (at - 1, at):
                    marked |= rows_here[np.clip(k, 0, len(rows_here) - 1)]
        out.append(marked)
    return np.concatenate(out)


def differences(runs: SegmentedRuns, repeats: Sequence[Repeat]) -> Array:
    """(D, n) of noise with the variance of one residual: (r(t) - r(t + T)) / sqrt(2)."""
    from scipy.interpolate import CubicSpline

    left = (
        (s.t_dense, s.torque_dense - s.dense @ s.motion.modelled) for s in runs.segments
    )
    dense = [CubicSpline(*both) for both in left]
    parts = [runs.residual[r.rows] - dense[r.other](r.later) for r in repeats]
    return np.concatenate(parts) / np.sqrt(2.0)


def _without_events(
    x: Array,
    drift: Array,
    rates: Array,
    pieces: Pieces,
    tests: int,
    comes_back: Callable[[NDArray[np.bool_]], NDArray[np.bool_]],
) -> tuple[Array, NDArray[np.bool_]]:
    """What the drift leaves of differences x (D,), and which of them are no event's; in
    turns, because each spoils the other. comes_back : which of marked differences are
    no events."""
    good = np.ones(len(x), bool)
    for _ in range(3):
        without_drift = (
            x - drift @ np.linalg.lstsq(drift[good], x[good], rcond=1e-10)[0]
        )
        ar = autoregression(without_drift, Pieces(p[good[p]] for p in pieces))[0]
        white = pieces.filter(ar, len(without_drift)) @ without_drift
        white /= noise_profile(white, rates, rates)
        white /= max(robust_scale(white[white != 0.0]), 1e-12)
        is_event = local_excess(white, pieces, tests, len(x))
        is_event &= ~comes_back(is_event)
        good = ~is_event
        if good.mean() < 1.0 - RARE:
            good[:] = True  # noise that is not stationary, rather than an event
    return without_drift, good


def rate_features(runs: SegmentedRuns) -> Array:
    """(n, M, 2): for each joint the squares of its modelled torque's rate and of its
    velocity."""
    rates = [
        s.low_pass @ np.gradient(s.motion.modelled, s.motion.t, axis=0)
        for s in runs.segments
    ]
    return np.swapaxes(np.stack([np.concatenate(rates), runs.dq], axis=2) ** 2, 0, 1)


def spectral_floor(runs: SegmentedRuns) -> Array | None:
    """(n,) standard deviation of the noise in the filtered rows [N m or N], the density
    S of the noise continued below the motion's band through the low-pass H: floor^2 =
    mean over w of S |H|^2. None where the logs show nothing above the motion, only what
    a filter has left of it, or what comes and goes with the motion."""
    stretches = [s.stretch for s in runs.segments]
    spectrum = torque_spectrum(stretches, runs.cutoff)
    if spectrum is None or any(spectrum[2:]):
        return None
    (frequency, density, *_), dt = spectrum, stretches[0].dt
    kernel = Kernel(runs.cutoff, dt).value
    size = max(2 * len(frequency) - 2, 4 * len(kernel))
    passed = np.interp(
        frequency, np.fft.rfftfreq(size, dt), np.abs(np.fft.rfft(kernel, size)) ** 2
    )
    weight = np.where((frequency > 0.0) & (frequency < 0.5 / dt), 2.0, 1.0)
    return np.asarray(np.sqrt(density @ (weight * passed) / np.sum(weight)))
