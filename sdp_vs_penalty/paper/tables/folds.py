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
    std_of_mean = float(np.std(values, ddof=1)) / math.sqrt(k)
    return _interval(float(np.mean(values)), std_of_mean, k)


def error_interval(
    result: CrossValidation, baseline: CrossValidation | None = None
) -> FoldInterval:
    """Return a method's relative error on all folds together [%], or its difference from a
    baseline's [percentage points], with the 95 % interval by the jackknife over the folds.

    Parameters
    ----------
    baseline : CrossValidation, optional
        Another method's on the same folds, whose error is subtracted.
    """
    error, errors_without = result.relative_error_percent, _errors_without(result)
    if baseline is not None:
        error -= baseline.relative_error_percent
        errors_without = errors_without - _errors_without(baseline)
    std = float(jackknifed(errors_without)[1])
    return _interval(error, std, len(errors_without))


def _errors_without(result: CrossValidation) -> Array:
    """Return the relative errors (k,) [%] of all but one of k folds, each left out in
    turn."""
    squared_error = [fold.losses.sum() for fold in result.folds]
    squared_torque = [fold.torque_squared.sum() for fold in result.folds]
    return relative_errors_without(np.array(squared_error), np.array(squared_torque))


def _interval(value: float, std: float, k: int) -> FoldInterval:
    """Return value +- t std with Student's t of k - 1 degrees of freedom, 95 %."""
    half = student_95(k) * std
    return FoldInterval(value, lower=value - half, upper=value + half)
