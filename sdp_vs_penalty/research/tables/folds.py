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
        """Whether zero lies outside."""
        return self.lower > 0.0 or self.upper < 0.0

    @property
    def in_words(self) -> str:
        """Lower to upper end, to three digits."""
        return f"{self.lower:.3g} to {self.upper:.3g}"


def fold_errors(result: CrossValidation) -> Array:
    """(folds,) relative error on each [%]."""
    return np.array([fold.relative_error_percent for fold in result.folds])


def interval_of(values: Array, coverage: float = 0.95) -> FoldInterval:
    """The interval of the mean of values (k,), taken as independent."""

    k = len(values)
    mean = float(np.mean(values))
    error = float(np.std(values, ddof=1)) / math.sqrt(k)
    half = float(scipy.stats.t.ppf(0.5 + 0.5 * coverage, k - 1)) * error
    return FoldInterval(mean, mean - half, mean + half, mean / error if error else 0.0)


def difference(one: CrossValidation, other: CrossValidation) -> FoldInterval:
    """Of the errors of one method less another's, fold by fold [percentage points]."""
    return interval_of(fold_errors(one) - fold_errors(other))
