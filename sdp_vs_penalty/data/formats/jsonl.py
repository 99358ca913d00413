"""JSON lines: one object a sample, such as {"t": 0.005, "q": [0.1, 0.2], "tau": [3, 4]}."""

import json
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.formats.columns import Choice, Header, table_of_arrays
from sdp_vs_penalty.data.formats.joint_order import (
    Places,
    in_first_order,
    places_of_joints,
)
from sdp_vs_penalty.data.formats.recognition import (
    AmbiguousColumnsError,
    CellTable,
    columns_of_joint_names,
    recognise,
)
from sdp_vs_penalty.data.formats.text_table import iter_rows
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES = (".jsonl", ".ndjson")
#: What messages call a sample.
SAMPLE = "line"
#: Fields that say which joint an object in a list is of.
_LABELS = ("name", "joint", "id")


def read(path: Path, choice: Choice) -> Measurements:
    """Read the run of JSON lines.

    Parameters
    ----------
    choice : Choice
        What of the file to take: joints, columns, rate.

    Returns
    -------
    Measurements
        The run in SI units, one row a sample.

    Raises
    ------
    InputError
        A file that cannot be read, or a channel that is missing.
    """
    columns, joints = _columns_and_joints(path)
    table = cell_table(columns, joints)
    return Header.of(path, list(table.kinds), choice, table=table).read(columns)


def inspect(path: Path) -> CellTable:
    """Describe the fields of JSON lines by their kinds and first values. See
    :meth:`~sdp_vs_penalty.data.formats.interface.TableFormat.inspect`."""
    return cell_table(*_columns_and_joints(path))


def cell_table(
    columns: Mapping[str, Array], joints: Mapping[str, Sequence[str]]
) -> CellTable:
    """Describe fields by their kinds and first values.

    Parameters
    ----------
    columns : Mapping[str, Array]
        (N,) numbers or (N, n) blocks by the field's name.
    joints : Mapping[str, Sequence[str]]
        The joints' names by the field that holds them.

    Returns
    -------
    CellTable
        For the recogniser of columns.
    """
    numbers = table_of_arrays(columns)
    kinds = dict.fromkeys(joints, "text")
    cells = {name: [str(list(texts))] for name, texts in joints.items()}
    return CellTable({**numbers.kinds, **kinds}, {**numbers.cells, **cells})


def read_columns(path: Path) -> dict[str, Array]:
    """Read the fields that hold a number, or a list of numbers, in every line of a text
    with one JSON object a line.

    They are (N,) numbers, or (N, n) of lists, by the field's name; "header.stamp.sec"
    for fields of objects within objects. Raises InputError for a line that is no JSON
    object, and for lists of different lengths.
    """
    return _columns_and_joints(path)[0]


def _columns_and_joints(
    path: Path,
) -> tuple[dict[str, Array], dict[str, Sequence[str]]]:
    """Read the fields of numbers, and the joints' names by the field that holds them."""
    samples = list[dict[str, Any]]()
    line_numbers = list[int]()
    for first, lines in iter_rows(path):
        for number, line in enumerate(lines, start=first):
            if line.strip():
                samples.append(_parse_line(path, number, line))
                line_numbers.append(number)
    return columns_and_joints_of(path, samples, line_numbers, SAMPLE)


def columns_and_joints_of(
    path: Path,
    samples: Sequence[Mapping[str, Any]],
    line_numbers: Sequence[int],
    word: str,
) -> tuple[dict[str, Array], dict[str, Sequence[str]]]:
    """Put the fields of N samples together to columns.

    Where samples name the same joints in different orders, each number goes back to its
    joint: all lists are in the first sample's order. Objects in a list that are named by
    numbers are in the order of these. A list whose objects change is left out.

    Parameters
    ----------
    path : Path
        How messages call the file.
    samples : Sequence[Mapping[str, Any]]
        Numbers, and lists of numbers or texts, by the field's name.
    line_numbers : Sequence[int]
        Number in the file, from 1, of each sample.
    word : str
        What messages call a sample.

    Returns
    -------
    columns : dict of str to array
        (N,) numbers or (N, n) of lists, of fields that hold numbers in every sample.
    joints : dict of str to sequence of str
        The joints' names by the field that holds them.

    Raises
    ------
    InputError
        Lists of different lengths, or joints that change.
    """
    columns = dict[str, Array]()
    joints = dict[str, Sequence[str]]()
    places = list[Places]()
    items = dict[str, list[Sequence[str]]]()
    for name in samples[0] if samples else ():
        values = [sample.get(name) for sample in samples]
        if _is_list_of_texts(values[0]):
            if name not in columns_of_joint_names([name]):
                continue
            rows = [_texts_of(value) for value in values]
            of_list = name.removesuffix(".name")
            if any(other.startswith(f"{of_list}[") for other in samples[0]):
                items[of_list] = rows
                continue
            joints[name] = rows[0]
            found = places_of_joints(path, rows, line_numbers, word)
            places += [] if found is None else [found]
        elif not any(value is None or _is_list_of_texts(value) for value in values):
            columns[name] = _block(path, name, values)
    for order in places:
        columns = in_first_order(columns, order)
    # An inner list stands behind the outer one, and is renamed first.
    for of_list, rows in reversed(items.items()):
        try:
            places_of_joints(path, rows, line_numbers, word)
        except InputError as error:  # perhaps no joints, but contacts that come and go
            said = f"{path}: {error.what}: the list {of_list} is left out"
            warnings.warn(said, Remark, stacklevel=2)
            columns = _without_items(columns, of_list)
            continue
        names = _in_order(rows[0])
        columns = _numbered_by_place(columns, of_list, names)
        if _holds_positions(columns, of_list):
            joints[f"{of_list}.name"] = names
    return columns, joints


def _parse_line(path: Path, number: int, line: str) -> dict[str, Any]:
    """Parse the numbers, and lists of numbers or texts, of one line, by their names.

    Raises InputError where the line is no JSON object.
    """
    remedy = "write one JSON object a line"
    try:
        content = json.loads(line)
    except (ValueError, RecursionError) as error:
        what = f"line {number} is no JSON ({str(error)[:80]})"
        raise InputError(what, remedy, path) from error
    if not isinstance(content, dict):
        raise InputError(f"line {number} is no JSON object", remedy, path)
    return dict(leaves(content))


def leaves(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Iterate over the numbers, and lists of numbers or texts, of nested objects.

    Parameters
    ----------
    content : Mapping[str, Any]
        The objects, as JSON or YAML has them.
    prefix : str
        What the names begin with.

    Yields
    ------
    tuple of str and Any
        A name like "header.stamp.sec" or "actuators[0].position", and its value. Where
        the objects of a list have names, these stand in place of the number, and are a
        list of texts of their own: "joints[elbow].position", "joints.name". Empty lists
        are left out.
    """
    for key, value in content.items():
        if isinstance(value, Mapping):
            yield from leaves(value, f"{prefix}{key}.")
        elif isinstance(value, list) and any(isinstance(x, Mapping) for x in value):
            names = _names_of_items(value)
            if names:
                yield f"{prefix}{key}.name", names
            for label, item in zip(names or range(len(value)), value, strict=True):
                if isinstance(item, Mapping):
                    yield from leaves(item, f"{prefix}{key}[{label}].")
        elif (
            _is_number(value)
            or _is_list_of_texts(value)
            or (isinstance(value, list) and value and all(map(_is_number, value)))
        ):
            yield f"{prefix}{key}", value


def _names_of_items(items: Sequence[Any]) -> list[str]:
    """Return the name that each item of a list has as its field "name", "joint" or "id",
    a text or a whole number; no names where an item has none, or two have the same."""
    for key in _LABELS:
        names = [item.get(key) for item in items if isinstance(item, Mapping)]
        are_texts = all(isinstance(x, str) and x for x in names)
        are_numbers = all(isinstance(x, int) and _is_number(x) for x in names)
        if (are_texts or are_numbers) and len(set(names)) == len(items):
            return list(map(str, names))
    return []


def _in_order(names: Sequence[str]) -> Sequence[str]:
    """Return names that are numbers by their size, and others as they are."""
    are_numbers = all(name.isascii() and name.isdigit() for name in names)
    return sorted(names, key=int) if are_numbers else names


def _holds_positions(columns: Mapping[str, Array], of_list: str) -> bool:
    """Return whether the joints' positions are recognised among the fields of a list's
    items. The names of other lists, such as sensors, are no joints'."""
    try:
        recognition = recognise(list(columns))
    except AmbiguousColumnsError:
        return False
    first = "" if recognition is None else recognition.rename.get("q1", "")
    return re.fullmatch(rf"{re.escape(of_list)}\[[0-9]+\]\.[^\[]*", first) is not None


def _without_items(columns: Mapping[str, Array], of_list: str) -> dict[str, Array]:
    """Return the columns without those of a list's items."""
    own = f"{of_list}["
    return {name: x for name, x in columns.items() if not name.startswith(own)}


def _numbered_by_place(
    columns: Mapping[str, Array], of_list: str, names: Sequence[str]
) -> dict[str, Array]:
    """Return the columns with places, from 0, in place of the names of a list's items:
    "joints[1].position" for "joints[elbow].position"."""
    prefixes = {
        f"{of_list}[{name}].": f"{of_list}[{k}]." for k, name in enumerate(names)
    }
    numbered = dict[str, Array]()
    for column, values in columns.items():
        prefix = next(filter(column.startswith, prefixes), "")
        new = prefixes[prefix] if prefix else ""
        numbered[new + column.removeprefix(prefix)] = values
    return numbered


def _texts_of(value: Any) -> Sequence[str]:
    """Return a list of texts as it is, and no texts for any other JSON value."""
    return list(value) if _is_list_of_texts(value) else []


def _is_list_of_texts(value: Any) -> bool:
    """Return whether a JSON value is a list of texts, at least one."""
    return (
        isinstance(value, list)
        and len(value) > 0
        and all(isinstance(text, str) for text in value)
    )


def _is_number(value: Any) -> bool:
    """Return whether a JSON value is a number; true and false, which Python counts as
    integers, are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _block(path: Path, name: str, values: list[Any]) -> Array:
    """Convert the values of one field to (N,) numbers, or (N, n) where they are lists.

    Raises InputError where lists have different lengths, or a number is too large.
    """
    lengths = {len(value) if isinstance(value, list) else -1 for value in values}
    if len(lengths) > 1:
        what = f"field {name} holds lists of different lengths"
        raise InputError(what, "give each line as many values", path)
    try:
        return np.array(values, float)
    except OverflowError as error:
        what = f"field {name} holds a number that is too large"
        raise InputError(what, "write floating-point numbers", path) from error
