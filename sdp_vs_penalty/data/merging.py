"""Channels with stamps of their own come together by the nearest stamp: columns of a
sparse table, messages of a bag."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.robot.arrays import Array


def nearest_rows(
    clock: Array, other: Array, within: float
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """For each instant of ``clock`` (N,) the nearest of ``other`` (M,), both ascending,
    and whether it is no farther than ``within`` [s]."""
    if len(other) == 0:
        return np.zeros(len(clock), np.intp), np.zeros(len(clock), bool)
    after = np.clip(np.searchsorted(other, clock), 0, len(other) - 1)
    before = np.maximum(after - 1, 0)
    is_before = np.abs(other[before] - clock) <= np.abs(other[after] - clock)
    nearest = np.where(is_before, before, after)
    return nearest, np.abs(other[nearest] - clock) <= within


def half_period(clock: Array) -> float:
    """Half of the usual step of a clock [s]; 0 without steps. A hair more, for stamps
    that are rounded."""
    steps = np.diff(clock)
    steps = steps[steps > 0.0]
    return 0.5001 * float(np.median(steps)) if len(steps) else 0.0


def merge_columns(
    clock: Array, columns: Mapping[str, Array], leading: Sequence[str]
) -> tuple[NDArray[np.intp], dict[str, Array]]:
    """The rows that are kept, and the columns there.

    clock : (N,) s of all rows; columns : (N,) or (N, n), NaN where a row has none;
    leading : columns whose rows are kept, the first one's. A column that has no value
    in a row takes its nearest within half a period of the leading rows; rows of which
    a column has none are left out.
    """
    filled = {
        name: ~np.isnan(x if x.ndim == 1 else x[:, 0]) for name, x in columns.items()
    }
    base = np.flatnonzero(filled[leading[0]] & np.isfinite(clock))
    order = np.argsort(clock[base], kind="stable")
    base = base[order] if np.any(np.diff(order) < 0) else base
    within = half_period(clock[base])
    is_kept = np.ones(len(base), bool)
    places = dict[str, NDArray[np.intp]]()
    for name in columns:
        rows = np.flatnonzero(filled[name] & np.isfinite(clock))
        rows = rows[np.argsort(clock[rows], kind="stable")]
        if len(rows) == len(base) and np.array_equal(rows, base):
            places[name] = base
            continue
        if len(rows) == 0:
            places[name] = base  # never a number: whoever reads it says so
            continue
        nearest, near = nearest_rows(clock[base], clock[rows], within)
        places[name] = rows[nearest]
        is_kept &= near
    return base[is_kept], {
        name: x[places[name][is_kept]] for name, x in columns.items()
    }
