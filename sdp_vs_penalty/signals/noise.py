"""The noise of measured torque, from repetition: free of any model's error.

Where a motion repeats, a model's residual r repeats too, whatever the model gets wrong,
and r(t) - r(t + T) holds only noise (twice), events, and what depends on time instead
of motion: drift. Drift is taken out by regression on its columns, events by their local
energy; what is left gives the noise floor and an autoregression that makes the noise
white. r(t + T) is read by a cubic spline from samples at eight times the cut-off, at
which the low-passed residual is a smooth curve: read between samples at its own rate,
noise would be averaged and its floor too low.

Where nothing repeats, the spectra of torque and positions above the motion's band give
the noise (:func:`spectral_floor`). Where the log holds nothing there, the residual itself
has to stand in, and the noise is a guess.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from sdp_vs_penalty.effects.effect import smooth_sign
from sdp_vs_penalty.robot.arrays import Array, Mask, nonzero_or_one
from sdp_vs_penalty.signals.coloured_noise import (
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
    motions_of_rows,
    pairs,
    recurring_differences,
)
from sdp_vs_penalty.signals.segments import SegmentedRuns
from sdp_vs_penalty.signals.spectrum import position_noise, torque_spectrum
from sdp_vs_penalty.signals.splines import CubicSpline
from sdp_vs_penalty.signals.standstill import STILL

#: Where the noise is known from.
REPETITION = "repetition"
SPECTRUM = "spectrum"
RESIDUAL = "residual"
#: How well the spectrum shows the noise: .8 to 1.2 of the true floor in our own
#: simulations, .5 to 1.7 of it in another author's, and .6 to 4.2 of what repetition
#: shows on a real Panda. In a third author's worlds the torque's part is within a factor
#: of two for 117 of 134 joints, and never too small; the others are base joints that
#: their servos shake. The positions' part is noise of the modelled torque, not of the
#: sensor: with it the floor is up to 40 times the sensor's noise there.
_HOW_ROUGH = (
    "within a factor of two in simulations, up to four times too large on a real arm;"
    " what encoder steps and an uneven clock make of the modelled torque is in it"
)
SPECTRUM_KNOWN = f"rough ({_HOW_ROUGH})"


def said_before(text: str) -> str:
    """Return a text without what stands in parentheses in SPECTRUM_KNOWN, for a reader
    who knows how rough a noise from the spectrum is."""
    return text.replace(f" ({_HOW_ROUGH})", "")


#: Frequencies and poses over which the noise of positions is averaged.
_FREQUENCIES = 2001
_POSES = 40
#: Fewest differences from which a floor is believed.
_FEWEST = 60
#: Share of a joint's torque (RMS) up to which a floor is no noise: filters, reading
#: between rows and the digits of numbers leave up to 5e-6 of it in logs without noise,
#: and sensors of arms, behind the same low-pass, 1e-4 and more.
_LEFT_BY_NUMBERS = 1e-5
#: Shown where no floor is known.
NOISE_UNKNOWN = "no noise could be measured: no motion repeats, or it repeats exactly"


@dataclass(frozen=True)
class Noise:
    """The noise of each joint, below the cut-off of the runs that it was measured in."""

    #: (n,) standard deviation of the noise [N m or N].
    floor: Array
    #: (n, ORDER) coefficients of the noise's autoregression [-].
    ar: Array
    #: (n,) standard deviation of the whitened noise [N m or N].
    sigma: Array
    #: (n,) degrees of freedom behind ``sigma``.
    degrees: Array
    #: REPETITION, SPECTRUM or RESIDUAL (a guess: the model's error is in it).
    source: str
    #: (M, n) flags of the rows where the repetition shows an event.
    suspect: Mask
    #: (M, n) factor by which the motion swells the noise, around 1 [-].
    profile: Array
    #: (M, n) standard deviation of the unknown friction of a joint that stands still [N
    #: m or N]; 0 where it moves.
    standstill_std: Array
    #: Rows whose motion repeats at other instants.
    repeats: tuple[Repeat, ...] = ()

    @cached_property
    def scale(self) -> Array:
        """(M, n) standard deviation of the noise's innovations in each row [N m or N].

        An innovation is the part of the noise that the autoregression does not predict
        from the rows before. Its variance is (sigma profile)^2 + s^2, with s =
        ``standstill_std``, plus a_k^2 s^2 of the k-th row before for each coefficient
        a_k: friction of a joint at rest disturbs the predictions of later rows as well.
        """
        variance = (self.sigma * self.profile) ** 2 + self.standstill_std**2
        for lag, a in enumerate(self.ar.T, start=1):
            variance[lag:] += (a * self.standstill_std[:-lag]) ** 2
        return np.sqrt(variance)

    @cached_property
    def worth(self) -> Array:
        """(M, n) share of a row's information that is left where a joint stands still,
        0 to 1.

        It is sigma^2 profile^2 / scale^2: 1 for a moving joint, less where unknown dry
        friction adds to the noise.
        """
        return (self.sigma * self.profile / self.scale) ** 2

    def whiten(self, values: Array, joint: int, pieces: Pieces) -> Array:
        """Whiten columns of a joint (from 0): make its noise independent from row to
        row, of variance 1.

        Each row is replaced by (x_i - sum_k a_k x_(i-k)) / scale_i, with the
        autoregression a of the joint's noise.

        Parameters
        ----------
        values : (M, k) or (M,) array
            Columns, or a series, at all rows.
        pieces : Pieces
            Uninterrupted pieces of rows. The first ORDER rows of each have no past;
            they become zero.

        Returns
        -------
        array
            Whitened values, of the same shape.
        """
        white = pieces.filter(self.ar[joint], len(self.scale)) @ values
        scale = self.scale[:, joint]
        return white / (scale if values.ndim == 1 else scale[:, None])


def noise_of(runs: SegmentedRuns, noise_runs: SegmentedRuns | None = None) -> Noise:
    """Measure the noise of each joint's torque from the best source that the runs have.

    1. Repeated motion: differences of the residual between repetitions.
    2. The torque's spectrum above the band of the motion, but no more than the model's
       residual.
    3. The model's residual itself.

    The first two count where they show noise (:func:`_is_noise`) in every joint with a
    torque.

    Without repetition the noise is taken to be white: a colour estimated from the
    residual would be that of the model's error, and would hide missing effects.

    Parameters
    ----------
    noise_runs : SegmentedRuns, optional
        The complete measurements, where ``runs`` are windows of them: a motion may
        repeat in them, but not within a window.

    Returns
    -------
    Noise
        Its arrays of M rows belong to the rows of ``runs``.
    """
    known = _from_repetition(noise_runs or runs, runs)
    if known is not None and _is_noise(known.floor, runs):
        return known
    guess = noise_in(runs, runs.residual)
    of_spectrum = spectral_floor(runs)
    floor = guess.floor
    source = RESIDUAL
    if of_spectrum is not None and _is_noise(of_spectrum, runs):
        floor = np.minimum(of_spectrum, guess.floor)
        source = SPECTRUM
    return replace(
        guess,
        floor=floor,
        sigma=floor,
        ar=np.zeros_like(guess.ar),  # white
        source=source,
    )


def _is_noise(floor: Array, runs: SegmentedRuns) -> bool:
    """Whether floors (n,) [N m or N] exceed what numbers leave of each joint's torque;
    a joint without any torque says nothing."""
    torque = np.sqrt(np.mean(runs.torque**2, axis=0))
    return bool(np.all((floor > _LEFT_BY_NUMBERS * torque) | (torque == 0.0)))


def noise_in(runs: SegmentedRuns, residual: Array) -> Noise:
    """Return the noise model of a residual, as if the residual were noise alone.

    This is a guess: the model's error is part of the residual.

    Parameters
    ----------
    residual : (M, n) array
        Measured less modelled torque [N m or N].

    Returns
    -------
    Noise
        Fitted to the rows in which a joint moves; to all rows if those are too few.
    """
    n = runs.n
    moving = []
    for joint in range(n):
        is_still = runs.still[:, joint] >= STILL
        moving.append(_without_rows(runs.pieces[joint], is_still))
    fits = [autoregression(residual[:, joint], moving[joint]) for joint in range(n)]
    ar, sigma, degrees = map(np.array, zip(*fits, strict=True))
    floor = []
    for joint, pieces in enumerate(moving):
        has_rows = len(pieces) > 0
        floor.append(residual[np.concatenate(pieces), joint].std() if has_rows else 0.0)
    return Noise(
        floor=np.array(floor),
        ar=ar,
        sigma=sigma,
        degrees=degrees,
        source=RESIDUAL,
        suspect=np.zeros_like(runs.keep),
        profile=np.ones_like(residual),
        standstill_std=runs.standstill_std,
    )


def _without_rows(pieces: Pieces, marked: Mask) -> Pieces:
    """Return pieces of rows without the marked ones (M,).

    The pieces are returned unchanged if fewer than _FEWEST rows would remain that an
    autoregression can predict.
    """
    others = Pieces(piece[~marked[piece]] for piece in pieces)
    return others if len(others.predicted) >= _FEWEST else pieces


def _from_repetition(runs: SegmentedRuns, shown: SegmentedRuns) -> Noise | None:
    """Measure the noise of ``runs`` where their motion repeats; None if fewer than
    _FEWEST rows repeat.

    The rows that the result describes (profile, suspect, repeats) are those of ``shown``:
    the same runs, or windows of them.
    """
    repeats = runs.repeats()
    if sum(len(r.rows) for r in repeats) < _FEWEST:
        return None
    repeated = _RepeatedRows(runs, repeats)
    rates_shown = repeated.rates if shown is runs else rate_features(shown)
    joints = [repeated.joint(j, rates_shown[j]) for j in range(runs.n)]
    floor, ar, sigma, degrees, suspects, profiles = zip(*joints, strict=True)
    suspect = np.column_stack(suspects)
    if shown is not runs:
        suspect = _suspect_rows_of_windows(suspect, runs, shown)
        repeats = shown.repeats()
    standstill_std, no_law = shown.unexplained_standstill_torque
    suspect &= ~no_law
    return Noise(
        floor=np.array(floor),
        ar=np.stack(ar),
        sigma=np.array(sigma),
        degrees=np.array(degrees),
        source=REPETITION,
        suspect=suspect,
        profile=np.column_stack(profiles),
        standstill_std=standstill_std,
        repeats=repeats,
    )


class _JointNoise(NamedTuple):
    """The noise of one joint, as :class:`Noise` describes it for all."""

    #: Standard deviation of the noise [N m or N].
    floor: float
    #: (ORDER,) coefficients of the noise's autoregression [-].
    ar: Array
    #: Standard deviation of the whitened noise [N m or N].
    sigma: float
    #: Degrees of freedom behind ``sigma``.
    degrees: float
    #: (M,) flags of the rows where the repetition shows an event.
    suspect: Mask
    #: (M,) factor by which the motion swells the noise, around 1 [-].
    profile: Array


class _RepeatedRows:
    """D differences of the residuals of n joints between rows with the same motion.

    - ``difference`` (D, n): noise, with the variance of one residual [N m or N].
    - ``both`` (D, 2): the rows at the two instants; ``earlier_rows`` (D,) the first.
    - ``pieces``: stretches of differences without an interruption.
    - ``stuck`` (D, n): whether the joint stands, and no law of friction says what torque
      holds it.
    - ``independent_share``: share of the differences that do not repeat another one.
    - ``rates`` (n, M, 2): squared rates of torque and velocity (:func:`rate_features`).
    """

    def __init__(self, runs: SegmentedRuns, repeats: tuple[Repeat, ...]) -> None:
        """Subtract the residuals of ``runs`` between rows with the same motion, which
        ``repeats`` lists; D differences.
        """
        self.runs = runs
        self.n_rows = len(runs.t)
        self.difference = differences(runs, repeats)
        self.both = pairs(repeats)
        self.earlier_rows, later_rows = self.both.T
        self.pieces = Pieces(consecutive(repeats))
        # A joint that stands still does so again when the motion repeats, and friction
        # may hold another torque: this is no noise of the sensor.
        no_law = runs.unexplained_standstill_torque[1]
        self.stuck = no_law[self.earlier_rows] | no_law[later_rows]
        n_independent, phase = motions_of_rows(self.both, self.n_rows)
        self.independent_share = min(1.0, n_independent / len(self.earlier_rows))
        self.rates = rate_features(runs)
        # Seconds from the earlier to the later instant of each difference, (D,).
        gaps = [repeat.later - runs.t[repeat.rows] for repeat in repeats]
        self._gap = np.concatenate(gaps)
        # Number of rows within which two phases of the motion count as the same.
        reach = max(1, round(SAME_PHASE * runs.rate))
        # Flags which of marked differences (D,) recur at other instants with the
        # same motion: noise that the motion amplifies, and no single events.
        self._recurs = partial(recurring_differences, self.both, phase, reach)

    def joint(self, j: int, rates_shown: Array) -> _JointNoise:
        """Measure the noise of joint j (from 0) from its D differences.

        Drift and events are taken out of the differences, an autoregression is fitted to
        what is left, and the dependence of the noise on the motion's rates is estimated.

        Parameters
        ----------
        rates_shown : (M, 2) array
            Squared rates (:func:`rate_features`) of the rows for which the profile is
            returned.
        """
        rates = self.rates[j][self.earlier_rows]
        drift = self._drift(j)
        pieces = _without_rows(self.pieces, self.stuck[:, j])
        without_drift, is_undisturbed = _without_events(
            self.difference[:, j], drift, rates, pieces, self.runs.n, self._recurs
        )
        undisturbed = Pieces(p[is_undisturbed[p]] for p in pieces)
        ar, deviation, degrees = autoregression(without_drift, undisturbed)
        n_used = sum(map(len, undisturbed))
        # The fitted drift takes as many degrees of freedom as it has columns.
        rank = int(np.linalg.matrix_rank(drift * is_undisturbed[:, None]))
        n_free = max(n_used - rank, 1)
        squares = sum(np.sum(without_drift[p] ** 2) for p in undisturbed)
        # The profile is estimated on rows that repeat; the floor is that of all rows.
        white = undisturbed.filter(ar, len(without_drift)) @ without_drift
        profile = noise_profile(white, rates, self.rates[j])
        mean_profile = np.sqrt(np.mean(profile[self.runs.keep[:, j]] ** 2))
        # An event may have happened at either of the two instants of a difference.
        suspect = np.zeros(self.n_rows, bool)
        suspect[self.both[~is_undisturbed]] = True
        return _JointNoise(
            floor=float(np.sqrt(squares / n_free) * mean_profile),
            ar=ar,
            sigma=float(deviation * np.sqrt(n_used / n_free)),
            degrees=float(max(self.independent_share * degrees - rank, 1.0)),
            suspect=suspect,
            profile=noise_profile(white, rates, rates_shown),
        )

    def _drift(self, j: int) -> Array:
        """Return the columns (D, 6), of unit norm, that drifts leave in joint j's
        differences.

        Offset, Coulomb friction and viscous friction are taken to drift with time, at a
        rate that is constant (3 columns) or changes linearly (3 more). A difference
        holds the rate times the time between its two instants.
        """
        t = self.runs.t[self.earlier_rows]
        dq = self.runs.dq[self.earlier_rows, j]
        laws = np.column_stack([np.ones_like(t), smooth_sign(dq), dq])
        since = t - t.mean()
        growing = np.column_stack([laws, since[:, None] * laws])
        drift = self._gap[:, None] * growing
        return drift / nonzero_or_one(np.linalg.norm(drift, axis=0))


def _suspect_rows_of_windows(
    suspect: Mask, runs: SegmentedRuns, windows: SegmentedRuns
) -> Mask:
    """Return the suspect rows (M, n) of windows of runs, whose rows lie at other instants.

    A window's row is suspect if one of its two neighbours among the rows of ``runs`` is;
    ``suspect`` flags these.
    """
    of_windows = []
    for window in windows.segments:
        is_suspect = np.zeros((len(window.t), runs.n), bool)
        for number, source_segment in enumerate(runs.segments):
            if is_part(window, source_segment):
                suspect_rows = suspect[runs.segment == number]
                row_after = np.searchsorted(source_segment.t, window.t)
                for neighbour in (row_after - 1, row_after):
                    row = np.clip(neighbour, 0, len(suspect_rows) - 1)
                    is_suspect |= suspect_rows[row]
        of_windows.append(is_suspect)
    return np.concatenate(of_windows)


def differences(runs: SegmentedRuns, repeats: Sequence[Repeat]) -> Array:
    """Subtract residuals with the same motion: (r(t) - r(t + T)) / sqrt(2).

    r is measured less modelled torque. r(t + T) is read between rows by a cubic spline
    on a dense grid.

    Parameters
    ----------
    runs : SegmentedRuns
        The rows, with the torque of a model.
    repeats : sequence of Repeat
        Which rows are repeated, and at what instants.

    Returns
    -------
    (D, n) array
        Differences [N m or N]; they have the variance of the noise of a single
        residual.
    """

    residuals = [
        CubicSpline(s.t_dense, s.torque_dense - s.dense @ s.motion.modelled)
        for s in runs.segments
    ]
    parts = [runs.residual[r.rows] - residuals[r.other](r.later) for r in repeats]
    return np.concatenate(parts) / np.sqrt(2.0)


def _without_events(
    differences: Array,
    drift: Array,
    rates: Array,
    pieces: Pieces,
    n_joints: int,
    recurs: Callable[[Mask], Mask],
) -> tuple[Array, Mask]:
    """Separate the noise in differences from drift and events.

    Drift is estimated without events, and events are found without drift: three turns,
    because each spoils the estimate of the other.

    Parameters
    ----------
    differences : (D,) array
        Differences of one joint's residual [N m or N].
    drift : (D, k) array
        Columns that drifts leave in them.
    rates : (D, r) array
        Squared rates that may increase the noise.
    pieces : Pieces
        Stretches of differences without an interruption.
    n_joints : int
        Number of joints that are searched for events (for the rate of false events).
    recurs : callable
        Returns which of marked differences (D,) recur; these are no events.

    Returns
    -------
    without_drift : (D,) array
        Differences without the drift [N m or N].
    is_undisturbed : (D,) array of bool
        Differences that are not part of an event; all, if more than RARE of them were.
    """
    count = len(differences)
    is_undisturbed = np.ones(count, bool)
    for _ in range(3):
        drift_sizes = np.linalg.lstsq(
            drift[is_undisturbed], differences[is_undisturbed], rcond=1e-10
        )[0]
        without_drift = differences - drift @ drift_sizes
        undisturbed = Pieces(p[is_undisturbed[p]] for p in pieces)
        ar = autoregression(without_drift, undisturbed).coefficients
        # Whitened differences of variance about 1, with 0 where there is no past.
        white = pieces.filter(ar, count) @ without_drift
        white /= noise_profile(white, rates, rates)
        white /= max(robust_scale(white[white != 0.0]), 1e-12)
        is_event = local_excess(white, pieces, n_joints, count)
        is_event &= ~recurs(is_event)
        is_undisturbed = ~is_event
        if is_undisturbed.mean() < 1.0 - RARE:
            # Noise that is not stationary, rather than events.
            is_undisturbed[:] = True
    return without_drift, is_undisturbed


def rate_features(runs: SegmentedRuns) -> Array:
    """Return the squares of two rates that may increase the noise of a torque.

    They are the time derivative of the modelled torque and the velocity: a clock that
    jitters turns rates of change into noise.

    Parameters
    ----------
    runs : SegmentedRuns
        The rows, with the torque of a model.

    Returns
    -------
    (n, M, 2) array
        For each joint and row, the square of the torque's rate [(N m/s)^2 or (N/s)^2]
        and of the velocity [(rad/s)^2 or (m/s)^2].
    """
    rates = [
        s.low_pass @ np.gradient(s.motion.modelled, s.motion.t, axis=0)
        for s in runs.segments
    ]
    features = np.stack([np.concatenate(rates), runs.dq], axis=2)
    return np.swapaxes(features**2, 0, 1)


def spectral_floor(runs: SegmentedRuns) -> Array | None:
    """Estimate the noise of the filtered rows from spectra above the motion.

    floor^2 = mean over all frequencies of S |H|^2, plus the part of the positions'
    noise (:func:`_floor_of_positions`). S is the density of the torque's noise
    (:func:`~sdp_vs_penalty.signals.spectrum.torque_spectrum`), and H its low-pass.

    Returns
    -------
    (n,) array or None
        Standard deviation of the noise of a filtered row [N m or N]. None where the log
        shows no noise there: nothing above the motion, a torque smoothed before it was
        logged, or a spectrum that comes and goes with the motion.
    """
    stretches = [s.stretch for s in runs.segments]
    noise = torque_spectrum(stretches, runs.cutoff)
    if noise is None or noise.is_smoothed or noise.is_uneven:
        return None
    dt = stretches[0].dt
    frequency = noise.frequency
    passed = _power_gain(runs.cutoff, dt, frequency)
    # All frequencies but 0 and the last one stand for a negative one as well.
    has_negative = (frequency > 0.0) & (frequency < 0.5 / dt)
    weight = np.where(has_negative, 2.0, 1.0)
    variance = noise.spectrum @ (weight * passed) / np.sum(weight)
    return np.sqrt(variance + _floor_of_positions(runs) ** 2)


def _floor_of_positions(runs: SegmentedRuns) -> Array:
    """Return the noise (n,) of filtered rows that the positions' noise makes [N m or N].

    White noise of a position passes the low-pass of the states, two derivatives, the
    inertia, and the low-pass of the torque. It is 0 without a model of the arm, or
    where the log does not show the noise.
    """
    stretches = [s.stretch for s in runs.segments]
    deviation = position_noise(stretches, runs.cutoff)
    motion = runs.segments[0].motion
    if deviation is None or motion.current is None:
        return np.zeros(runs.n)
    dt = stretches[0].dt
    frequency = np.linspace(0.0, 0.5 / dt, _FREQUENCIES)
    passed = _power_gain(runs.state_cutoff, dt, frequency)
    passed *= _power_gain(runs.cutoff, dt, frequency)
    twice_derived = (2.0 * np.pi * frequency) ** 4
    # Variance of each joint's filtered acceleration [(rad/s^2)^2 or (m/s^2)^2].
    acceleration = deviation**2 * np.mean(twice_derived * passed)
    evenly_spread = np.linspace(0, len(motion.t) - 1, _POSES).astype(np.intp)
    poses = motion.part(evenly_spread)
    variance = np.zeros(runs.n)
    for joint in range(runs.n):
        # (_POSES, n) torque of all joints per acceleration of this one.
        inertia = poses.derivatives(joint)[2]
        variance += np.mean(inertia**2, axis=0) * acceleration[joint]
    return np.sqrt(variance)


def _power_gain(cutoff: float, dt: float, frequency: Array) -> Array:
    """Return the power |H|^2 (F,) that a low-pass of this cut-off [Hz], sampled every
    ``dt`` [s], passes at frequencies (F,) [Hz]."""
    kernel = Kernel(cutoff, dt).value
    size = max(2 * len(frequency) - 2, 4 * len(kernel))
    gain = np.abs(np.fft.rfft(kernel, size))
    return np.interp(frequency, np.fft.rfftfreq(size, dt), gain**2)
