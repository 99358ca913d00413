"""What is left beyond the noise after the best explanation: nothing, or something
without a name.

The error of each joint in N m, on rows that are evidence, against the noise floor. Rows
of standstill are none: dry friction holds any torque up to its own there. Nor are those
of a slow joint: where friction turns round any law of it is only nearly right.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
import scipy

from sdp_vs_penalty.diagnosis.causes import (
    JointError,
    States,
    columns_of_causes,
    held_out_share,
)
from sdp_vs_penalty.diagnosis.constants import (
    CHANCE,
    FOLDS,
    MIN_ERROR_RISE,
    SPECTRUM_NOISE_FACTOR,
)
from sdp_vs_penalty.diagnosis.events import outliers
from sdp_vs_penalty.diagnosis.linear_fit import WhiteFit
from sdp_vs_penalty.diagnosis.refit import least_squares_refit
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.white_rows import WhiteData, folds_of
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask
from sdp_vs_penalty.signals.noise import REPETITION, Noise
from sdp_vs_penalty.signals.segments import SegmentedRuns
from sdp_vs_penalty.signals.standstill import STILL

#: Fewest periods of a tone in a run.
_PERIODS = 10.0


@dataclass(frozen=True)
class Remainder:
    """The torque that the findings leave unexplained."""

    #: (n,) variance of what is left over that of the noise, less one.
    in_sample_excess_variance: Array
    #: (n,) RMS of what is left beyond the noise while the joint slides [N m or N].
    beyond: Array
    #: Joints (from 0) whose error the unexplained torque raises by a tenth, so that a
    #: curve is looked for.
    joints_above_noise: tuple[int, ...]
    #: Those of these joints on which the noise is known well enough to call the torque
    #: unexplained.
    joints_unexplained: tuple[int, ...]


def unexplained_error(search: Search) -> Remainder:
    """Judge the torque that model and findings leave beyond the noise, while joints
    slide.

    A joint counts as unexplained if this torque raises its error by a tenth (to 1.2
    times the noise's variance), and if chance would show such a variance in less than 1
    of 1000 cases, given how few repetitions show the noise. Where no repetition shows
    it, what follows no motion is noise too, of whatever colour, but for a tone.
    """
    data = search.data
    fit = search.fit
    effects = [t.form.effect for t in search.terms]
    _, residual = least_squares_refit(data, effects)
    # (M, n) whitened residual; the fit divides each joint's rows by a level.
    white = (fit.residual * fit.level[:, None]).T
    return remainder(data, fit, residual, outliers(data, white, residual))


def remainder(
    data: WhiteData, fit: WhiteFit, residual: Array, outlier_rows: Mask
) -> Remainder:
    """Judge a residual against the noise, joint by joint, in rows in which it slides.

    Parameters
    ----------
    fit
        The fit of the model and the findings.
    residual
        (M, n) what is left [N m or N].
    outlier_rows
        (M, n) rows of events, left out.
    """
    rows = data.rows
    noise = data.noise
    # The fit divides each joint's rows by a level, which is undone here.
    white = (fit.residual * fit.level[:, None]).T  # (M, n)
    is_measured = rows.keep & (white != 0.0) & (noise.worth > 0.5)
    keep = is_measured & (rows.still <= STILL) & ~outlier_rows
    slides = keep & rows.slides
    # (M, n) share of a row's noise that the fit has absorbed.
    leverage = fit.leverage.T

    def mean(squares: Array, which: Mask) -> Array:
        """Average squares (M, n) over rows, without bias by the fitted parameters."""
        degrees = np.maximum((which * (1.0 - leverage)).sum(axis=0), 1.0)
        return (which * squares).sum(axis=0) / degrees

    variance = mean(white**2, slides)
    squares = mean(residual**2, slides)
    floor = noise.floor
    rise = (1.0 + MIN_ERROR_RISE) ** 2  # of squares, that matters
    raised = np.flatnonzero((squares > rise * floor**2) & data.noise_is_known)
    if raised.size:  # the torque of encoder steps counts as noise, too
        floor = np.sqrt(floor**2 + mean(rows.encoder_error**2, slides))
        raised = raised[squares[raised] > rise * floor[raised] ** 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        variance *= (noise.floor / floor) ** 2
    sure = raised[variance[raised] > _smallest_variance(noise, rise)[raised]]
    if noise.source != REPETITION and sure.size:
        shares = _shares_that_follow_motion(data, residual, slides, sure)
        sure = sure[shares > 1.0 - 1.0 / rise]
    return Remainder(
        in_sample_excess_variance=mean(white**2, keep) - 1.0,
        beyond=np.sqrt(np.maximum(squares - floor**2, 0.0)),
        joints_above_noise=tuple(raised.tolist()),
        joints_unexplained=tuple(sure.tolist()),
    )


def _shares_that_follow_motion(
    data: WhiteData, residual: Array, which: Mask, joints: Indices
) -> Array:
    """Return the largest share of the squares of what is left on each of some joints
    (from 0) that one cause, such as a position, or a tone explains on parts of the
    motion left out.

    Noise that wanders slowly exceeds a floor of fast noise, and follows no motion.

    Parameters
    ----------
    residual, which
        (M, n) what is left [N m or N], and flags of the rows that count.
    """
    states = States.from_rows(data.rows)
    fold = folds_of(data.rows, FOLDS)
    shares = []
    for j in joints.tolist():
        rows = which[:, j]
        error = JointError(j, residual[:, j], orders=())
        left = residual[rows, j]
        tone = _tone(data.rows, rows, left)
        of_causes = chain.from_iterable(columns_of_causes(states, error).values())
        sets = [tone, *(x[rows] for x in of_causes)]
        shares.append(max(held_out_share(x, left, fold[rows]) for x in sets))
    return np.array(shares)


def _tone(rows: SegmentedRuns, which: Mask, left: Array) -> Array:
    """Return cosine and sine (K, 2 runs) of each run's time, of the frequency that makes
    most of what is left (K,) in the rows that count (M,).

    It has at least ten periods in the shortest run: noise that wanders resembles fewer.
    """
    t, run = rows.t[which], rows.run[which]
    parts = [run == number for number in np.unique(run)]
    length = min(float(np.ptp(t[part])) for part in parts)
    if length * rows.cutoff <= _PERIODS:
        return np.zeros((len(t), 0))
    hertz = np.arange(_PERIODS / length, rows.cutoff, 0.125 / length)
    power = np.zeros(len(hertz))
    for part in parts:
        angular = 2.0 * np.pi * hertz
        power += scipy.signal.lombscargle(t[part], left[part], angular)
    phase = 2.0 * np.pi * hertz[np.argmax(power)] * t
    waves = np.column_stack([np.cos(phase), np.sin(phase)])
    return np.hstack([waves * part[:, None] for part in parts])


def _smallest_variance(noise: Noise, rise: float) -> Array:
    """Return the variances (n,), over the noise's, from which an excess cannot be
    chance.

    Where repetitions show the noise, ``rise`` is divided by the 0.1 % quantile of a
    chi-squared distribution over its degrees of freedom. Where only a spectrum shows
    it, the noise is known within a factor SPECTRUM_NOISE_FACTOR, whose square
    multiplies ``rise``.

    Parameters
    ----------
    noise
        The noise with its source and degrees of freedom (n,).
    rise
        Variance ratio that matters: 1.1^2.
    """
    if noise.source == REPETITION:  # as the mean of so many squares is itself known
        degrees = noise.degrees
        return rise * degrees / scipy.special.chdtri(degrees, 1.0 - CHANCE)
    return np.full(len(noise.floor), SPECTRUM_NOISE_FACTOR**2 * rise)
