"""What is left beyond the noise after the best explanation: nothing, or something
without a name.

The error of each joint in N m, on rows that are evidence, against the noise floor. Rows
of standstill are none: dry friction holds any torque up to its own there. Nor are those
of a slow joint: where friction turns round any law of it is only nearly right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.constants import (
    CHANCE,
    MIN_ERROR_RISE,
    SPECTRUM_NOISE_FACTOR,
)
from sdp_vs_penalty.diagnosis.events import outliers
from sdp_vs_penalty.diagnosis.linear_fit import WhiteFit
from sdp_vs_penalty.diagnosis.refit import least_squares_refit
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import REPETITION, Noise
from sdp_vs_penalty.signals.standstill import SLOW, STILL


@dataclass(frozen=True)
class Remainder:
    """What is left of the torque.

    in_sample_excess_variance (n,) : variance of what is left over that of the noise, less
    one; beyond (n,) [N m or N] : its RMS beyond the noise while the joint slides;
    joints_above_noise : the joints (from 0) whose error that raises, so that a curve is
    looked for; joints_unexplained : those on which the noise is known well enough to say
    so without one; residual (M, n) [N m or N]; outlier_rows (M, n) : rows that are
    outliers of it.
    """

    in_sample_excess_variance: Array
    beyond: Array
    joints_above_noise: tuple[int, ...]
    joints_unexplained: tuple[int, ...]
    residual: Array
    outlier_rows: NDArray[np.bool_]


def unexplained_error(
    search: Search, outlier_rows: NDArray[np.bool_] | None = None
) -> Remainder:
    """What is left beyond the noise beside all terms of a search, in rows in which the
    joint slides.

    It is *something without a name* where its variance is 1.2 times the noise's, or more
    where few repetitions show the noise (chance 1 in 1000), and raises the error by a
    tenth. outlier_rows (M, n) : rows that are no evidence, if they are known.
    """
    data = search.data
    fit = search.fit
    residual = least_squares_refit(data, [t.form.effect for t in search.terms])[1]
    if outlier_rows is None:
        outlier_rows = outliers(
            data,
            (fit.residual * fit.level[:, None]).T,
            residual,
        )
    return remainder(data, fit, residual, outlier_rows)


def remainder(
    data: WhiteData,
    fit: WhiteFit,
    residual: Array,
    outlier_rows: NDArray[np.bool_],
) -> Remainder:
    """Of a residual (M, n) [N m or N] that is white in ``fit``; outlier_rows (M, n) :
    rows of events, left out."""
    rows = data.rows
    noise = data.noise
    white = (fit.residual * fit.level[:, None]).T
    is_measured = rows.keep & (white != 0.0) & (noise.worth > 0.5)
    keep = is_measured & (rows.still <= STILL) & ~outlier_rows
    slides = keep & (rows.slow <= SLOW)
    leverage = np.sum(fit.basis**2, axis=2).T

    def mean(squares: Array, which: NDArray[np.bool_]) -> Array:
        degrees = np.maximum((which * (1.0 - leverage)).sum(axis=0), 1.0)
        return np.asarray((which * squares).sum(axis=0) / degrees)

    variance = mean(white**2, slides)
    squares = mean(residual**2, slides)
    floor = noise.floor
    rise = (1.0 + MIN_ERROR_RISE) ** 2
    raised = np.flatnonzero((squares > rise * floor**2) & data.known)
    if raised.size:  # not all encoders are fine
        floor = np.sqrt(floor**2 + mean(rows.steps**2, slides))
        raised = raised[squares[raised] > rise * floor[raised] ** 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        variance *= (noise.floor / floor) ** 2
    is_sure = variance[raised] > _smallest_variance(noise, rise)[raised]
    return Remainder(
        in_sample_excess_variance=mean(white**2, keep) - 1.0,
        beyond=np.sqrt(np.maximum(squares - floor**2, 0.0)),
        joints_above_noise=tuple(raised.tolist()),
        joints_unexplained=tuple(raised[is_sure].tolist()),
        residual=residual,
        outlier_rows=outlier_rows,
    )


def _smallest_variance(noise: Noise, rise: float) -> Array:
    """(n,) from which the variance of what is left, over the noise's, is no accident of
    how the noise is known."""
    if noise.source == REPETITION:  # as the mean of so many squares is itself known
        degrees = noise.degrees
        return np.asarray(rise * degrees / scipy.special.chdtri(degrees, 1.0 - CHANCE))
    return np.full(len(noise.floor), SPECTRUM_NOISE_FACTOR**2 * rise)
