"""JSON texts that hold a whole run: a list of samples, or a list for each channel.

Read are lists of objects, one a sample; objects of lists, as ``json.dump`` writes them;
and what pandas writes by ``to_json``: columns of values by their row ("columns"), or the
names beside the rows ("split"). A file with one object a line is read as JSON lines.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.formats import jsonl
from sdp_vs_penalty.data.formats.columns import Choice, Header, real_numbers
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

#: What messages call a sample.
_SAMPLE = "object"


def read(path: Path, choice: Choice, refused: InputError) -> Measurements:
    """Read the run of a JSON text.

    Parameters
    ----------
    choice : Choice
        The robot's joints, the fields chosen by ``--rename``, and the rate.
    refused : InputError
        The error of a text that holds no samples.

    Returns
    -------
    Measurements
        The run in SI units, one row a sample.

    Raises
    ------
    InputError
        A text that holds no samples, or a channel that is missing.
    """
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return _read_lines(path, choice, refused)
    try:
        columns, joints = _columns_and_joints(path, content)
    except (TypeError, ValueError):  # rows of pandas that are none
        raise refused from None
    if not any(len(column) > 1 for column in columns.values()):
        raise refused
    _refuse_columns_of_other_rows(path, content)
    table = jsonl.cell_table(columns, joints)
    return Header.of(path, list(table.kinds), choice, table=table).read(columns)


def _read_lines(path: Path, choice: Choice, refused: InputError) -> Measurements:
    """Read the run of JSON lines; raise the error of other texts where it is none."""
    try:
        return jsonl.read(path, choice)
    except InputError:
        raise refused from None


def _columns_and_joints(
    path: Path, content: Any
) -> tuple[dict[str, Array], dict[str, Sequence[str]]]:
    """Return the channels (N,) or (N, n) of a JSON value, and the joints' names, by the
    fields' names; empty where it holds none."""
    if isinstance(content, list) and all(isinstance(x, Mapping) for x in content):
        samples = [dict(jsonl.leaves(sample)) for sample in content]
        numbers = range(1, len(samples) + 1)
        return jsonl.columns_and_joints_of(path, samples, numbers, _SAMPLE)
    if not isinstance(content, Mapping):
        return {}, {}
    if set(content) == {"columns", "index", "data"}:
        names, rows = content["columns"], content["data"]
        content = dict(zip(names, zip(*rows, strict=True), strict=True))
    columns = dict[str, Array]()
    joints = dict[str, Sequence[str]]()
    for name, values in _lists(content):
        if values and all(isinstance(value, str) for value in values):
            joints[name] = values
            continue
        try:
            columns[name] = real_numbers(path, name, np.array(values))
        except (InputError, ValueError):
            continue  # texts, or lists of different lengths: no channel
    return columns, joints


def _lists(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, list]]:
    """Iterate over the lists in nested objects, named like "log.q". An object whose keys
    are all numbers is a list in the order of these, as pandas writes a column."""
    for key, value in content.items():
        name = f"{prefix}{key}"
        if _is_keyed_by_rows(value):
            yield name, [value[row] for row in sorted(value, key=int)]
        elif isinstance(value, Mapping):
            yield from _lists(value, f"{name}.")
        elif isinstance(value, list | tuple):
            yield name, list(value)


def _is_keyed_by_rows(value: Any) -> bool:
    """Return whether a JSON value is a column of pandas, {"0": 1.5, "1": 2.5}: an
    object whose keys are the numbers of rows."""
    return isinstance(value, Mapping) and bool(value) and all(map(_is_row, value))


def _is_row(key: str) -> bool:
    """Return whether a key is a whole number."""
    return key.isascii() and key.isdigit()


def _refuse_columns_of_other_rows(path: Path, content: Any) -> None:
    """Raise InputError where two columns of one object have as many rows, but not the
    same: side by side, their numbers would be of different samples."""
    if not isinstance(content, Mapping):
        return
    columns = {key: x for key, x in content.items() if _is_keyed_by_rows(x)}
    first_of_length = dict[int, str]()
    for name, column in columns.items():
        first = first_of_length.setdefault(len(column), name)
        if column.keys() != columns[first].keys():
            what = f"columns {first} and {name} are of different rows, by their keys"
            raise InputError(what, "write the same rows in both", path)
    for value in content.values():
        _refuse_columns_of_other_rows(path, value)
