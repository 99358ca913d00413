"""Intervals of errors over folds, and of the differences of two methods on the same
folds."""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from sdp_vs_penalty.estimation.resampling import CrossValidation
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class FoldInterval:
    """Mean over folds with its 95 % interval of Student's t; t : mean over its standard
    error."""

    mean: float
    lower: float
    upper: float
    t: float

    @property
    def is_significant(self) -> bool:
        """Whether zero lies outside of the 95 % interval."""
        return self.lower > 0.0 or self.upper < 0.0

    @property
    def in_words(self) -> str:
        """The interval as text, with three digits."""
        return f"{self.lower:.3g} to {self.upper:.3g}"


def fold_errors(result: CrossValidation) -> Array:
    """Return a method's relative torque error on each of k folds.

    Parameters
    ----------
    result : CrossValidation
        Cross-validation of the method.

    Returns
    -------
    (k,) array
        Errors [%].
    """
    return np.array([fold.relative_error_percent for fold in result.folds])


def interval_of(values: Array, coverage: float = 0.95) -> FoldInterval:
    """Return the confidence interval of a mean by Student's t.

    Parameters
    ----------
    values : (k,) array
        Values that are taken as independent.
    coverage : float
        Probability that the interval holds the mean.

    Returns
    -------
    FoldInterval
        In the unit of the values.
    """
    k = len(values)
    mean = float(np.mean(values))
    standard_error = float(np.std(values, ddof=1)) / math.sqrt(k)
    # Student's t; scipy.stats would take half a second to import.
    quantile = float(scipy.special.stdtrit(k - 1, 0.5 + 0.5 * coverage))
    half = quantile * standard_error
    return FoldInterval(
        mean,
        lower=mean - half,
        upper=mean + half,
        t=mean / standard_error if standard_error else 0.0,
    )


def difference(one: CrossValidation, other: CrossValidation) -> FoldInterval:
    """Return the difference of two methods' errors on the same folds, with its
    interval.

    Parameters
    ----------
    one : CrossValidation
        The method whose errors are taken.
    other : CrossValidation
        The method whose errors are subtracted.

    Returns
    -------
    FoldInterval
        [percentage points].
    """
    return interval_of(fold_errors(one) - fold_errors(other))
