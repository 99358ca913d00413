"""Channels with stamps of their own come together by the nearest stamp: columns of a
sparse table, messages of a bag."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.robot.arrays import Array


def nearest_rows(
    clock: Array, other: Array, within: float
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Find for each stamp of a clock the nearest stamp of another clock.

    Parameters
    ----------
    clock : Array
        (N,) stamps, ascending [s].
    other : Array
        (M,) stamps, ascending [s].
    within : float
        Largest distance of a match [s].

    Returns
    -------
    tuple[NDArray[np.intp], NDArray[np.bool_]]
        (N,) the nearest row of ``other``, and (N,) whether it is within that distance.
    """
    if len(other) == 0:
        return np.zeros(len(clock), np.intp), np.zeros(len(clock), bool)
    after = np.clip(np.searchsorted(other, clock), 0, len(other) - 1)
    before = np.maximum(after - 1, 0)
    is_before = np.abs(other[before] - clock) <= np.abs(other[after] - clock)
    nearest = np.where(is_before, before, after)
    return nearest, np.abs(other[nearest] - clock) <= within


def half_period(clock: Array) -> float:
    """Return half of a clock's median step, and a little more so that rounded stamps
    match.

    Parameters
    ----------
    clock : Array
        (N,) stamps [s].

    Returns
    -------
    float
        Half of the median step [s]; 0 without steps.
    """
    steps = np.diff(clock)
    steps = steps[steps > 0.0]
    return 0.5001 * float(np.median(steps)) if len(steps) else 0.0


def merge_columns(
    clock: Array, columns: Mapping[str, Array], leading: Sequence[str]
) -> tuple[NDArray[np.intp], dict[str, Array]]:
    """Merge columns that have values in different rows, by the nearest stamp.

    The first leading column gives the rows. Every other column takes its value that is
    nearest in time; rows without one within half a period are left out.

    Parameters
    ----------
    clock : array
        (N,) stamps of all rows [s].
    columns : mapping of str to array
        (N,) or (N, n) values by name, NaN where a row has none.
    leading : sequence of str
        Columns of which the first gives the rows.

    Returns
    -------
    rows : array
        (K,) rows that are kept, in the order of time.
    columns : dict of str to array
        (K,) or (K, n) values by name.
    """
    base = _rows_with_value(clock, columns[leading[0]])
    within = half_period(clock[base])
    is_kept = np.ones(len(base), bool)
    places = dict[str, NDArray[np.intp]]()
    for name, values in columns.items():
        rows = _rows_with_value(clock, values)
        # A column that is never a number: whoever reads it says so.
        if len(rows) == 0 or np.array_equal(rows, base):
            places[name] = base
            continue
        nearest, is_near = nearest_rows(clock[base], clock[rows], within)
        places[name] = rows[nearest]
        is_kept &= is_near
    merged = {name: x[places[name][is_kept]] for name, x in columns.items()}
    return base[is_kept], merged


def _rows_with_value(clock: Array, values: Array) -> NDArray[np.intp]:
    """Return the rows (M,) in which a column (N,) or (N, n) has a value, in the order
    of time."""
    first_values = values if values.ndim == 1 else values[:, 0]
    rows = np.flatnonzero(~np.isnan(first_values) & np.isfinite(clock))
    return rows[np.argsort(clock[rows], kind="stable")]
