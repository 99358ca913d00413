"""Tables in which cells are empty: channels that were logged in rows of their own, or
rows in which a channel was lost."""

import warnings
from collections.abc import Mapping, Sequence

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.formats.columns import Header
from sdp_vs_penalty.data.merging import merge_columns
from sdp_vs_penalty.errors import Remark
from sdp_vs_penalty.robot.arrays import Array


def merged_rows(
    header: Header, values: Mapping[str, Array], first: str
) -> dict[str, Array]:
    """Merge the columns of a table in which cells are empty.

    Where channels were logged at different times, each in rows of its own, every row
    leaves the other channels' cells empty. The channels are merged at the rows of the
    torque, to whose stamps the others are interpolated. A row in which a channel was
    lost is left out. A remark says both.

    Parameters
    ----------
    header : Header
        Which of the columns are channels.
    values : Mapping[str, Array]
        (N,) or (N, n) numbers by the column's name, NaN where a cell is empty.
    first : str
        How the remark calls the first row with an empty cell, "row 43".

    Returns
    -------
    dict[str, Array]
        (K,) or (K, n) values by the column's name, in the K merged rows.
    """
    clock = header.groups.get("t", ()) if header.rate is None else ()
    stamps = _row_stamps(header, clock, values)
    channels = {name: x for name, x in values.items() if name not in clock}
    leading = header.groups.get("tau") or header.groups["q"]
    merged = merge_columns(
        stamps, channels, next(x for x in leading if x in channels), [header.episode]
    )
    n_left_out = len(stamps) - len(merged.rows)
    if n_left_out:
        warning = (
            f"{header.path}: {formatting.count(n_left_out, 'row')} without all channels"
            f" ({first} is the first) left out or joined to others"
        )
        warning += f"; {merged.remark}" if merged.remark else ""
        warnings.warn(warning, Remark, stacklevel=3)
    return {name: values[name][merged.rows] for name in clock} | merged.columns


def _row_stamps(
    header: Header, clock: Sequence[str], values: Mapping[str, Array]
) -> Array:
    """Return the time stamp (N,) of each row: seconds and nanoseconds added up; without
    a clock, the row's number."""
    if not clock:
        n_rows = len(next(iter(values.values())))
        return np.arange(n_rows, dtype=float)
    parts = [header.factors.get(name, 1.0) * values[name] for name in clock]
    return np.asarray(np.sum(parts, axis=0))
