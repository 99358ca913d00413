"""The array types of this package (doubles; docstrings state the shapes), and checks of
arrays."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sdp_vs_penalty.errors import InputError

Array = NDArray[np.float64]
#: Arrays by their names.
Arrays = Mapping[str, Array]
#: Numbers of rows, columns, parameters or joints, from 0.
Indices = NDArray[np.intp]
#: Flags of rows, columns, parameters or joints.
Mask = NDArray[np.bool_]


def nonzero_or_one(size: ArrayLike) -> Any:
    """Return scales to divide by, with zeros replaced by one: where a scale is zero,
    the quantity is zero too."""
    return np.where(np.asarray(size) > 0.0, size, 1.0)[()]


def at_least_tiny(x: ArrayLike) -> Any:
    """Raise values to the smallest normal number, to take a logarithm or to divide."""
    return np.maximum(x, np.finfo(float).tiny)


def as_slice(indices: Indices) -> Indices | slice:
    """Return consecutive indices (k,) as a slice, which is copied several times as
    fast; others, and none, as they are."""
    if not len(indices) or np.any(np.diff(indices) != 1):
        return indices
    return slice(int(indices[0]), int(indices[-1]) + 1)


def as_plain_array(what: str, value: ArrayLike) -> Array:
    """Return numbers that a user gives as an array of doubles.

    Raises InputError for what is no number, a number beyond the doubles, and an array
    of which entries are masked: its mask would be lost.
    """
    if np.ma.is_masked(value):
        raise InputError(f"{what} has masked entries", "leave those rows out")
    try:
        return np.asarray(value, float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{what}: {error}", "give an array of numbers") from error


def read_only(values: Array) -> Array:
    """Return a view of an array that cannot be written through."""
    view = values.view()
    view.setflags(write=False)
    return view


def check_finite(what: str, value: Array, shape: tuple[int, ...]) -> None:
    """Raise InputError for an array ``what`` of another shape, or with entries that are
    not finite."""
    if np.shape(value) != shape or not np.all(np.isfinite(value)):
        raise InputError(f"{what} does not fit", f"give {shape} finite numbers")


def wrong_shape(
    what: str, shape: tuple[int, ...], expected: tuple[int | str, ...], row: str
) -> InputError:
    """Return the error for an array of another shape, which says where it is
    transposed.

    Parameters
    ----------
    what : str
        Name of the array, for the error's sentence.
    shape : tuple of int
        The shape that it has.
    expected : tuple of int or str
        The shape that it must have; a letter stands for any number of rows.
    row : str
        What a row of it is, such as "sample".
    """
    count, *others = expected
    problem = f"{what} has shape {shape}"
    # Transposed: the rows come last, the other axes in their order or turned round.
    rows_are_last = isinstance(count, str) or shape[-1:] == (count,)
    axes_before = list(shape[:-1])
    if len(shape) > 1 and rows_are_last and axes_before in (others, others[::-1]):
        problem = f"{problem}: it is transposed"
    in_words = ", ".join(map(str, expected)) + "," * (not others)
    return InputError(problem, f"give it as ({in_words}), a row a {row}")
