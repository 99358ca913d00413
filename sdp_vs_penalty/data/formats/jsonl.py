"""JSON: one object a line, {"t": 0.005, "q": [0.1, 0.2], "tau": [3, 4]}; or a text with
a list of samples, or a list for each channel.

Of the latter are lists of objects, objects of lists, and what pandas writes by
``to_json``: columns of values by their row, or the names beside the rows ("split").
"""

import json
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.formats.text_file import iter_rows
from sdp_vs_penalty.data.log import Log, log_of_arrays, real_numbers
from sdp_vs_penalty.data.words.stamps import is_stamp, past_midnight, seconds_of
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES: tuple[str, ...] = (".jsonl", ".ndjson")
SAMPLE = "line"

#: Fields that say which joint an object in a list is of.
_LABELS = ("name", "joint", "id")


def read(path: Path) -> Log:
    """Read the columns of JSON lines."""
    numbers, samples = list[int](), list[dict[str, Any]]()
    for first, lines in iter_rows(path):
        for number, line in enumerate(lines, start=first):
            if line.strip():
                samples.append(_parse_line(path, number, line))
                numbers.append(number)
    return log_of_samples(path, samples, numbers, "line")


def read_text(path: Path, refused: InputError) -> Log:
    """Read the columns of a JSON text; raise the error ``refused`` of one that holds no
    samples."""
    try:
        content = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        try:
            return read(path)
        except InputError:
            raise refused from None
    try:
        log = _log_of_content(path, content)
    except (TypeError, ValueError, InputError) as error:  # rows of pandas that are none
        raise (error if isinstance(error, InputError) else refused) from None
    if log is None or not any(
        len(x) > 1 for x in log.read(_numeric(log)).columns.values()
    ):
        raise refused
    _refuse_columns_of_other_rows(path, content)
    return log


def _numeric(log: Log) -> list[str]:
    """List the columns that are no texts."""
    return [name for name, x in log.columns.items() if x.kind != "text"]


def _log_of_content(path: Path, content: Any) -> Log | None:
    """Return the channels of a JSON value; None where it can hold none."""
    if isinstance(content, list) and all(isinstance(x, Mapping) for x in content):
        samples = [dict(leaves(sample)) for sample in content]
        return log_of_samples(path, samples, range(1, len(samples) + 1), "object")
    if not isinstance(content, Mapping):
        return None
    if {*content} == {"columns", "index", "data"}:
        rows = zip(*content["data"], strict=True)
        content = dict(zip(content["columns"], rows, strict=True))
    columns, joints = dict[str, Array](), list[str]()
    for name, values in _lists(content):
        if _are(str, values) and all(map(is_stamp, values)):
            columns[name] = past_midnight(seconds_of(values))
            continue
        if _are(str, values):
            joints = (
                joints or list(values)
                if name.endswith(("names", "name", "joints"))
                else joints
            )
            continue
        try:
            columns[name] = real_numbers(path, name, np.array(values))
        except (InputError, ValueError):
            continue  # texts, or lists of different lengths: no channel
    facts = {
        x: {"joints": tuple(joints)}
        for x, block in columns.items()
        if joints and block.shape[1:] == (len(joints),)
    }
    return log_of_arrays(path, columns, facts=facts)


def _lists(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, list]]:
    """Iterate over the lists in nested objects, named like "log.q". An object whose keys
    are all numbers is a list in the order of these, as pandas writes a column; a list of
    objects is a list of each of their fields."""
    for key, value in content.items():
        name = f"{prefix}{key}"
        if _is_keyed_by_rows(value):
            yield name, [value[row] for row in sorted(value, key=int)]
        elif isinstance(value, Mapping):
            yield from _lists(value, f"{name}.")
        elif (
            isinstance(value, list | tuple) and len(value) > 1 and _are(Mapping, value)
        ):
            for field in value[0]:
                yield f"{name}.{field}", [item.get(field) for item in value]
        elif isinstance(value, list | tuple):
            yield name, list(value)


def _is_keyed_by_rows(value: Any) -> bool:
    """Return whether a JSON value is a column of pandas, {"0": 1.5, "1": 2.5}."""
    return (
        isinstance(value, Mapping)
        and bool(value)
        and all(key.isascii() and key.isdigit() for key in value)
    )


def _refuse_columns_of_other_rows(path: Path, content: Any) -> None:
    """Raise InputError where two columns of one object have as many rows, but not the
    same: side by side, their numbers would be of different samples."""
    if not isinstance(content, Mapping):
        return
    first_of_length = dict[int, str]()
    for name, column in content.items():
        if not _is_keyed_by_rows(column):
            _refuse_columns_of_other_rows(path, column)
            continue
        first = first_of_length.setdefault(len(column), name)
        if column.keys() != content[first].keys():
            what = f"columns {first} and {name} are of different rows, by their keys"
            raise InputError(what, "write the same rows in both", path)


def log_of_samples(
    path: Path, samples: Sequence[Mapping[str, Any]], numbers: Sequence[int], word: str
) -> Log:
    """Put the fields of N samples together to columns.

    Fields that hold a number, or a list of equal length, in every sample become columns.
    Objects in a list that are named by numbers are in the order of these. A list whose
    objects change is left out.

    Parameters
    ----------
    samples : sequence of mappings
        Numbers, and lists of numbers or texts, by the field's name (:func:`leaves`).
    numbers : sequence of int
        Number in the file, from 1, of each sample.
    word : str
        What messages call a sample.
    """
    columns, texts = dict[str, Array](), dict[str, list[Sequence[str]]]()
    items = dict[str, list[str]]()
    for name, first in samples[0].items() if samples else ():
        values = [sample.get(name) for sample in samples]
        if isinstance(first, str):
            cells = [x for x in values if isinstance(x, str) and is_stamp(x)]
            if len(cells) == len(values):
                columns[name] = past_midnight(seconds_of(cells))
            continue
        if not _are(str, first):
            if not any(x is None or _are(str, x) for x in values):
                columns[name] = _block(path, name, values)
            continue
        named = [list(map(str, x)) if isinstance(x, list) else [] for x in values]
        of_list = name.removesuffix(".name")
        if not any(other.startswith(f"{of_list}[") for other in samples[0]):
            texts[name] = [*named]
            continue
        pairs = zip(numbers, named, strict=True)
        number = next((n for n, x in pairs if {*x} != {*named[0]}), None)
        if number is not None:  # perhaps contacts that come and go
            said = f"{word} {number} names other joints than the first"
            said = f"{path}: {said}: the list {of_list} is left out"
            warnings.warn(said, Remark, stacklevel=2)
        items[of_list] = named[0] if number is None else []
    facts = dict[str, dict[str, Any]]()
    # An inner list stands behind the outer one, and is renamed first.
    for of_list, names in reversed(items.items()):
        is_counted = all(x.isascii() and x.isdigit() for x in names)
        in_order = sorted(names, key=int) if is_counted else names
        renamed = dict[str, Array]()
        for name, column in columns.items():
            label, _, rest = name.removeprefix(f"{of_list}[").partition("]")
            if not name.startswith(f"{of_list}["):
                renamed[name] = column
            elif label in in_order:
                new = f"{of_list}[{in_order.index(label)}]{rest}"
                renamed[new] = column
                facts[new] = {} if is_counted else {"joints": (label,)}
        by_place = sorted(renamed.items(), key=lambda item: _place(of_list, item[0]))
        columns = dict(by_place)
    rows = np.array(numbers, int)
    return log_of_arrays(path, columns, texts, facts, word=word, rows=rows)


def _place(of_list: str, name: str) -> int:
    """Return the place of a list's item in a column's name; -1 for other columns."""
    label = name.removeprefix(f"{of_list}[").partition("]")[0]
    return int(label) if name.startswith(f"{of_list}[") and label.isdigit() else -1


def _parse_line(path: Path, number: int, line: str) -> dict[str, Any]:
    """Parse the numbers, and lists of numbers or texts, of one line, by their names;
    raise InputError where it is no JSON object."""
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
    """Iterate over the numbers, and lists of numbers or texts, of nested objects, by
    names like "header.stamp.sec" or "actuators[0].position".

    Where the objects of a list have names, these stand in place of the number, and are a
    list of texts of their own: "joints[elbow].position", "joints.name". Empty lists are
    left out.
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
            or (isinstance(value, str) and is_stamp(value))
            or _are(str, value)
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


def _are(kind: type, value: Any) -> bool:
    """Return whether a JSON value is a list of this kind, such as texts, at least one."""
    is_list = isinstance(value, list | tuple) and len(value) > 0
    return is_list and all(isinstance(x, kind) for x in value)


def _is_number(value: Any) -> bool:
    """Return whether a JSON value is a number; true and false, which Python counts as
    integers, are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _block(path: Path, name: str, values: list[Any]) -> Array:
    """Convert the values of one field to (N,) numbers, or (N, n) where they are lists;
    raise InputError where these have different lengths, or a number is too large."""
    if len({len(x) if isinstance(x, list) else -1 for x in values}) > 1:
        what = f"field {name} holds lists of different lengths"
        raise InputError(what, "give each line as many values", path)
    try:
        return np.array(values, float)
    except OverflowError as error:
        what = f"field {name} holds a number that is too large"
        raise InputError(what, "write floating-point numbers", path) from error
