"""Logs that name the joints in every row: where their order changes, each number goes
back to its joint."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.formats.columns import numbered_families
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

Places = NDArray[np.intp]


def places_of_joints(
    path: Path,
    joints_of_rows: Sequence[Sequence[str]],
    row_numbers: Sequence[int],
    row_word: str = "row",
) -> Places | None:
    """Find where each row has the joints of the first row.

    Parameters
    ----------
    path : Path
        Path of the file, for messages.
    joints_of_rows : Sequence[Sequence[str]]
        The joints that each of N rows names, in its order.
    row_numbers : Sequence[int]
        (N,) numbers of the rows in the file.
    row_word : str
        What messages call a row.

    Returns
    -------
    Places or None
        (N, n): the place, from 0, in each row of each joint of the first row. None
        where all rows have the order of the first.

    Raises
    ------
    InputError
        A row names other joints than the first.
    """
    rows = [tuple(joints) for joints in joints_of_rows]
    orders = set(rows)
    if len(orders) < 2:
        return None
    first = rows[0]
    places = dict[tuple[str, ...], list[int]]()
    for joints in orders:
        if sorted(joints) == sorted(first) and len(set(first)) == len(first):
            places[joints] = [joints.index(name) for name in first]
    for number, joints in zip(row_numbers, rows, strict=True):
        if joints not in places:
            what = f"{row_word} {number} names other joints than the first"
            remedy = "write the same joints in all of them, each once"
            raise InputError(what, remedy, path)
    return np.array([places[joints] for joints in rows])


def in_first_order(columns: Mapping[str, Array], places: Places) -> dict[str, Array]:
    """Put the numbers of each row in the first row's order of joints.

    Parameters
    ----------
    columns : Mapping[str, Array]
        (N,) numbers or (N, n) blocks, by name.
    places : Places
        (N, n) place in each row of each joint of the first row.

    Returns
    -------
    dict of str to array
        The same columns. Blocks of n joints are in the new order, and so are n columns
        that differ by their number alone ("position[0]", "position[1]" ...).
    """
    ordered = dict(columns)
    for name, block in columns.items():
        if block.shape == places.shape:
            ordered[name] = np.take_along_axis(block, places, axis=1)
    n_joints = places.shape[1]
    for family in numbered_families(list(columns)).values():
        in_number_order = sorted(family, key=_last_number)
        is_one_a_joint = len(family) == n_joints
        if not is_one_a_joint or any(columns[name].ndim > 1 for name in family):
            continue
        block = np.column_stack([columns[name] for name in in_number_order])
        block = np.take_along_axis(block, places, axis=1)
        ordered |= dict(zip(in_number_order, block.T, strict=True))
    return ordered


def _last_number(name: str) -> int:
    """Return the last number in a column's name."""
    return int(re.findall(r"[0-9]+", name)[-1])
