"""Intervals of errors over folds, and of the differences of two methods on the same
folds.

A method's error is that of all folds together, E = 100 |tau - tau_hat| / |tau|. Its
standard error is the jackknife's over the k folds,

    s^2 = (k - 1) / k sum_j (E_-j - mean E_-j)^2,      E_-j of all folds but j,

and its interval E +- t s, t of Student with k - 1 degrees of freedom (Efron, Tibshirani,
An Introduction to the Bootstrap, 1993): error and interval are of one quantity.
"""

import math
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.estimation.resampling import CrossValidation
from sdp_vs_penalty.regression.evidence import (
    jackknifed,
    relative_errors_without,
    student_95,
)
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class FoldInterval:
    """A figure with its 95 % interval of Student's t."""

    #: The figure itself, in the unit of the values.
    value: float
    #: Lower end of its interval.
    lower: float
    #: Upper end.
    upper: float

    @property
    def in_words(self) -> str:
        """The interval as text, with three digits."""
        return f"{self.lower:.3g} to {self.upper:.3g}"


def fold_errors(result: CrossValidation) -> Array:
    """Return a method's relative torque error (k,) on each of k folds [%]."""
    return np.array([fold.relative_error_percent for fold in result.folds])


def interval_of(values: Array) -> FoldInterval:
    """Return the mean of independent values (k,) with its interval."""
    k = len(values)
    spread = float(np.std(values, ddof=1)) / math.sqrt(k)
    return _interval(float(np.mean(values)), spread, k)


def error_interval(
    result: CrossValidation, less: CrossValidation | None = None
) -> FoldInterval:
    """Return the error of all folds together with its interval by the jackknife.

    Parameters
    ----------
    less : CrossValidation, optional
        That of another method on the same folds, whose error is subtracted.

    Returns
    -------
    FoldInterval
        [%], of a difference [percentage points].
    """
    whole, without = result.relative_error_percent, _errors_without(result)
    if less is not None:
        whole -= less.relative_error_percent
        without = without - _errors_without(less)
    return _interval(whole, float(jackknifed(without)[1]), len(without))


def _errors_without(result: CrossValidation) -> Array:
    """Return the error of all folds but each (k,) [%]."""
    lost = [fold.losses.sum() for fold in result.folds]
    torque = [fold.torque_squared.sum() for fold in result.folds]
    return relative_errors_without(np.array(lost), np.array(torque))


def _interval(value: float, spread: float, k: int) -> FoldInterval:
    """Return value +- t spread with Student's t of k - 1 degrees of freedom, 95 %."""
    half = student_95(k) * spread
    return FoldInterval(value, lower=value - half, upper=value + half)
