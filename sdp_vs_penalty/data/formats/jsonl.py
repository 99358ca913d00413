"""JSON: one object a line, {"t": 0.005, "q": [0.1, 0.2], "tau": [3, 4]}; or a text with
a list of samples, or a list for each channel.

Such a text is a list of objects or of lists of numbers, an object of lists, or what pandas
writes by ``to_json``: columns of values by their row, or names beside rows ("split").
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.formats.npz import columns_of_array
from sdp_vs_penalty.data.formats.text_file import iter_rows
from sdp_vs_penalty.data.log import Log, log_of_arrays
from sdp_vs_penalty.data.words.names import counts_runs
from sdp_vs_penalty.errors import InputError
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
    if isinstance(content, list) and all(isinstance(x, Mapping) for x in content):
        samples = [dict(leaves(sample)) for sample in content]
        return log_of_samples(path, samples, range(1, len(samples) + 1), "object")
    if isinstance(content, list) and len({*map(len, content)}) == 1:
        with suppress(TypeError, ValueError):
            return log_of_arrays(path, columns_of_array(path, np.array(content, float)))
        raise refused
    try:
        if isinstance(content, Mapping) and {*content} == {"columns", "index", "data"}:
            rows = zip(*content["data"], strict=True)
            content = dict(zip(content["columns"], rows, strict=True))
        lists = dict(_lists(content)) if isinstance(content, Mapping) else {}
    except (TypeError, ValueError):  # "data" holds no rows of equal length
        raise refused from None
    log = log_of_lists(path, lists)
    is_empty = all(len(x) < 2 for x in lists.values())
    if is_empty or all(x.kind == "text" for x in log.columns.values()):
        raise refused
    said = _units(content) if isinstance(content, Mapping) else {}
    in_units = [f"{name} in {unit}" for name, unit in said.items()]
    return replace(log, heading=[*log.heading, *in_units])


def _units(content: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the first object "units" in nested objects; empty without one."""
    units = content.get("units")
    if isinstance(units, Mapping):
        return units
    nested = (x for x in content.values() if isinstance(x, Mapping))
    return next(filter(None, map(_units, nested)), {})


def _lists(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, list]]:
    """Iterate over the lists in nested objects, named like "log.q". An object whose keys
    are all numbers is a list in the order of these, as pandas writes a column; a row that
    another column has is an empty cell. A list of
    objects becomes one list for each of their fields; a list of runs, the lists of each
    run."""
    keyed = filter(_is_keyed_by_rows, content.values())
    rows = sorted({row for column in keyed for row in column}, key=int)
    for key, value in content.items():
        name = f"{prefix}{key}"
        if _is_keyed_by_rows(value):
            yield name, [value.get(row) for row in rows]
        elif isinstance(value, Mapping):
            yield from _lists(value, f"{name}.")
        elif counts_runs(key) and _are(Mapping, value):
            for number, run in enumerate(value):
                yield from _lists(run, f"{name}[{number}].")
        elif isinstance(value, list | tuple) and len(value) > 1:
            if not _are(Mapping, value):
                yield name, list(value)
                continue
            samples = [dict(leaves(item)) for item in value]
            for field in samples[0]:
                yield f"{name}.{field}", [sample.get(field) for sample in samples]
        elif _is_number(value):  # a rate, beside the columns
            yield name, [value]


def _is_keyed_by_rows(value: Any) -> bool:
    """Return whether a JSON value is a column of pandas, {"0": 1.5, "1": 2.5}."""
    is_object = isinstance(value, Mapping) and bool(value)
    return is_object and all(key.isascii() and key.isdigit() for key in value)


def log_of_samples(
    path: Path, samples: Sequence[Mapping[str, Any]], numbers: Sequence[int], word: str
) -> Log:
    """Put the fields of N samples together to columns.

    Parameters
    ----------
    samples : sequence of mappings
        Numbers, and lists of numbers or texts, by the field's name (:func:`leaves`).
    numbers : sequence of int
        Number in the file, from 1, of each sample.
    word : str
        What messages call a sample.
    """
    names = list(samples[0]) if samples else []
    lists = {
        column: [sample.get(name) for sample in samples]
        for name, column in zip(names, _renumbered(names), strict=True)
    }
    return log_of_lists(path, lists, numbers, word)


#: The number of an object in a list, "[33]".
_NUMBER = re.compile(r"\[([0-9]+)\]")


def _renumbered(names: Sequence[str]) -> list[str]:
    """Number the objects of each list from 0, in the order of their numbers.

    "joints[33].position" becomes "joints[1].position" where the list "joints" has the
    objects 4, 33 and 105. A list is called by what stands before the bracket.
    """
    numbers_by_list = dict[str, set[int]]()
    for name in names:
        for number in _NUMBER.finditer(name):
            of_list = numbers_by_list.setdefault(name[: number.start()], set())
            of_list.add(int(number[1]))

    def place(number: re.Match[str]) -> str:
        """Return the place of a number in its list, "[1]" for "[33]"."""
        of_list = sorted(numbers_by_list[number.string[: number.start()]])
        return f"[{of_list.index(int(number[1]))}]"

    return [_NUMBER.sub(place, name) for name in names]


def log_of_lists(
    path: Path,
    lists: Mapping[str, Sequence[Any]],
    numbers: Sequence[int] | None = None,
    word: str = "sample",
) -> Log:
    """Make a log of JSON lists, one a column: a number or text, or a list of these, for
    each sample; or the joints' names once. What a sample lacks is an empty cell."""
    columns, texts = dict[str, Array](), dict[str, list[Sequence[str]]]()
    joints = tuple[str, ...]()
    for name, values in lists.items():
        if isinstance(values[0], str):
            texts[name] = [[str(x)] for x in values]
            if name.endswith(("names", "name", "joints")):
                joints = joints or tuple(map(str, values))
        elif _are(str, values[0]):
            texts[name] = [
                list(map(str, x)) if isinstance(x, list) else [] for x in values
            ]
        elif not isinstance(values[0], bool) and not _are(
            str, next((x for x in values if isinstance(x, list)), None)
        ):
            try:
                columns[name] = np.array(values, float)
            except (TypeError, ValueError, OverflowError) as error:
                # The error is the column's text: it is shown if the column is chosen.
                texts[name] = [[str(error)]] * len(values)
    facts = {
        name: {"joints": joints}
        for name, block in columns.items()
        if joints and block.shape[1:] == (len(joints),)
    }
    rows = None if numbers is None else np.array(numbers, int)
    return log_of_arrays(path, columns, texts, facts, rows, has_gaps=True, word=word)


def _parse_line(path: Path, number: int, line: str) -> dict[str, Any]:
    """Parse the numbers, and lists of numbers or texts, of one line, by their names;
    raise InputError where it is no JSON object."""
    what = f"line {number} is no JSON object"
    try:
        content = json.loads(line)
    except (ValueError, RecursionError) as error:
        content, what = None, f"line {number} is no JSON ({str(error)[:80]})"
    if not isinstance(content, dict):
        raise InputError(what, "write one JSON object a line", path)
    return dict(leaves(content))


def leaves(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Iterate over the numbers, and lists of numbers or texts, of nested objects, by
    names like "header.stamp.sec" or "actuators[0].position".

    Where the objects of a list have names, these stand in place of the number:
    "joints[elbow].position". Empty lists are left out.
    """
    for key, value in content.items():
        if isinstance(value, Mapping):
            yield from leaves(value, f"{prefix}{key}.")
        elif isinstance(value, list) and any(isinstance(x, Mapping) for x in value):
            names = _names_of_items(value)
            for label, item in zip(names or range(len(value)), value, strict=True):
                if isinstance(item, Mapping):
                    fields = {x: y for x, y in item.items() if x not in _LABELS}
                    yield from leaves(fields, f"{prefix}{key}[{label}].")
        elif (
            value is None
            or isinstance(value, str)
            or _is_number(value)
            or _are(str, value)
            or (
                isinstance(value, list)
                and value
                and all(x is None or _is_number(x) for x in value)
            )
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
