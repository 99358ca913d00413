"""What all numbers of this package come in: arrays of doubles, whose shapes the
docstrings say."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sdp_vs_penalty.errors import InputError

Array = NDArray[np.float64]


def nonzero_or_one(size: ArrayLike) -> Any:
    """A size by which to divide: one where it is zero, as what it is the size of then
    is."""
    return np.where(np.asarray(size) > 0.0, size, 1.0)[()]


def at_least_tiny(x: ArrayLike) -> Any:
    """Something to take the logarithm of, or to divide by: at least the least normal
    number."""
    return np.maximum(x, np.finfo(float).tiny)


def check_finite(what: str, value: Array, shape: tuple[int, ...]) -> None:
    """InputError where an array has another shape, or an entry that is not finite."""
    if np.shape(value) != shape or not np.all(np.isfinite(value)):
        raise InputError(f"{what} does not fit", f"give {shape} finite numbers")
