"""Parquet tables."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.formats.limits import understood
from sdp_vs_penalty.data.log import ROWS_DESCRIBED, Column, Log, Values
from sdp_vs_penalty.data.measurements import Measurements, columns_of
from sdp_vs_penalty.data.store import PART, AppendableArray
from sdp_vs_penalty.data.words.stamps import is_stamp, seconds_of
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import memory_for, path_or_file, unpacks_to_too_much, writing
from sdp_vs_penalty.robot.arrays import Array, Mask

SUFFIXES: tuple[str, ...] = (".parquet", ".pq")

_REMEDY = "write it anew, or convert it to CSV"
#: A data set's description (LeRobot's), in a folder above its data/chunk-000/file.parquet.
_INFO = Path("meta", "info.json")
#: Number of folders above the file in which it is looked for.
_LEVELS = 4
#: A longer file is no description [bytes].
_LONGEST = 1 << 20
#: Endings of the motors' names in such a description.
_ENDINGS = (".pos", ".vel", ".torque", ".effort", ".current")


def read(path: Path) -> Log:
    """Describe the columns of a Parquet table; the log reads their values on demand."""
    with _opened(path) as file:
        first_rows = next(file.iter_batches(batch_size=ROWS_DESCRIBED), None)
        facts = stated_facts(path, file.schema_arrow)
        columns = {
            field.name: _described(field, first_rows, facts.get(field.name, {}))
            for field in file.schema_arrow
        }
    return Log(path, columns, partial(_read_columns, path), partial(_texts, path))


def _read_columns(path: Path, names: Sequence[str]) -> Values:
    """Read columns as numbers, part by part; a cell without a value is a gap."""
    numbers = {name: AppendableArray() for name in names}
    rows_without_value = {name: AppendableArray() for name in names}
    n_rows = 0
    with _opened(path) as file:
        # A file without rows has no batches, but its columns' types make empty arrays.
        if file.metadata.num_rows == 0:
            table = file.schema_arrow.empty_table()
            for name in names:
                numbers[name].append(numbers_of(path, name, table.column(name)))
        # Other columns are not read: a long text that the file stores once, for all
        # rows, would be unpacked for each of them.
        options = {"columns": list(names), "use_threads": False}
        for batch in file.iter_batches(batch_size=PART, **options):
            for name in names:
                column = batch.column(name)
                numbers[name].append(numbers_of(path, name, column))
                if column.null_count:
                    is_null = column.is_null().to_numpy(zero_copy_only=False)
                    rows_without_value[name].append(n_rows + np.flatnonzero(is_null))
            n_rows += len(batch)
    gaps = dict[str, Mask]()
    for name, rows in rows_without_value.items():
        if len(empty := rows.array()):
            gaps[name] = np.zeros(n_rows, bool)
            gaps[name][empty] = True
    values = {name: x.array() for name, x in numbers.items()}
    # A Parquet table has no header: its rows count from 1. Only gaps need the numbers.
    return Values(values, np.arange(1, n_rows + 1) if gaps else None, gaps)


def _texts(path: Path, names: Sequence[str]) -> list[list[str]]:
    """Read columns as texts, a list for each row."""
    with _opened(path) as file:
        table = file.read(columns=list(names), use_threads=False)
    cells = [table.column(name).to_pylist() for name in names]
    return [list(map(str, row)) for row in zip(*cells, strict=True)]


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a table that takes no more memory than its size allows: a value that comes
    in every row is stored once."""
    from pyarrow import parquet

    with (
        understood(path, "Parquet file", _REMEDY),
        # pre_buffer would hold a whole row group in memory.
        parquet.ParquetFile(path_or_file(path), pre_buffer=False) as file,
    ):
        metadata = file.metadata
        groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
        n_values = sum(
            x.column(k).num_values for x in groups for k in range(x.num_columns)
        )
        n_bytes = max(8 * n_values, sum(group.total_byte_size for group in groups))
        if n_bytes > memory_for(path.stat().st_size):
            raise unpacks_to_too_much(path)
        yield file


def _described(field: Any, first_rows: Any, facts: Mapping[str, Any]) -> Column:
    """Describe a column by its type and first values; texts that are all times are
    stamps."""
    values = [] if first_rows is None else first_rows.column(field.name).to_pylist()
    cells = [str(x)[:1000] for x in values]
    kind = kind_of(field.type)
    if kind == "text" and cells and all(map(is_stamp, cells)):
        kind = "stamp"
    return Column(kind, cells, **facts)


def kind_of(kind: Any) -> str:
    """Return what a column of an Arrow type holds: "number", "list" (of numbers),
    "stamp" or "text"."""
    from pyarrow import types

    kind = kind.value_type if types.is_dictionary(kind) else kind
    if types.is_integer(kind) or types.is_floating(kind):
        return "number"
    if (
        types.is_list(kind)
        or types.is_large_list(kind)
        or types.is_fixed_size_list(kind)
    ):
        return "list" if kind_of(kind.value_type) == "number" else "text"
    is_time = types.is_timestamp(kind) or types.is_duration(kind)
    return "stamp" if is_time else "text"


def numbers_of(path: Path, name: str, column: Any) -> Array:
    """Convert a column of Arrow's to (N,) numbers; (N, n) where cells hold lists; seconds
    [s] for durations and for time stamps, since 1970, also in words.

    Raises InputError for lists of different lengths, or texts that are no time stamps.
    """
    kind = kind_of(column.type)
    if kind == "text":
        try:
            return seconds_of([str(x) for x in column.to_pylist()])
        except InputError as error:
            raise error.within(f"{path}: column {name}") from error
    if kind == "stamp":
        is_duration = str(column.type).startswith("duration")
        kind_in_ns = "duration[ns]" if is_duration else "timestamp[ns]"
        column = column.cast(kind_in_ns, safe=False).cast("int64")
    if kind == "list":
        rows = column.to_pylist()
        lengths = {len(row or ()) for row in rows}
        if len(lengths) > 1:
            what = f"column {name} holds lists of different lengths"
            raise InputError(what, "give each row as many values", path)
        return np.array(rows, float).reshape(len(rows), *lengths or (0,))
    numbers = np.asarray(column.to_numpy(zero_copy_only=False), float)
    return 1e-9 * numbers if kind == "stamp" else numbers


def table_of(columns: Mapping[str, Any]) -> Any:
    """Return columns (N,) of pandas, polars or Python as a table of Arrow's; columns that
    Arrow does not take become texts."""
    import pyarrow as arrow

    arrays = list[Any]()
    for values in columns.values():
        try:
            is_polars = hasattr(values, "to_arrow")
            array = (
                values.to_arrow()
                if is_polars
                else arrow.array(values, from_pandas=True)
            )
        except (arrow.ArrowException, TypeError, ValueError):
            array = arrow.array(list(map(str, values)))
        arrays.append(array)
    return arrow.table(arrays, names=list(columns))


def columns_of_table(
    path: Path, table: Any
) -> tuple[dict[str, Array], dict[str, list[list[str]]], dict[str, dict[str, Any]]]:
    """Return the columns of a table in memory: numbers, the texts of each row, "" where a
    cell is empty, and what is known of stamps."""
    numbers, texts = dict[str, Array](), dict[str, list[list[str]]]()
    facts = dict[str, dict[str, Any]]()
    for field in table.schema:
        column, kind = table.column(field.name), kind_of(field.type)
        if kind == "text":
            cells = column.to_pylist()
            texts[field.name] = [["" if x is None else str(x)] for x in cells]
            continue
        numbers[field.name] = numbers_of(path, field.name, column)
        if kind == "stamp":
            cells = [str(x) for x in column[:ROWS_DESCRIBED].to_pylist()]
            facts[field.name] = {"kind": kind, "cells": cells}
    return numbers, texts, facts


def stated_facts(path: Path, schema: Any) -> dict[str, dict[str, Any]]:
    """Return what metadata say of columns, their own before those of the data set that
    the file belongs to (LeRobot's meta/info.json): units, and names of the joints."""
    features = _features(path)
    out = dict[str, dict[str, Any]]()
    for field in schema:
        own = {
            k.decode(errors="replace"): v.decode(errors="replace")
            for k, v in (field.metadata or {}).items()
        }
        facts = out.setdefault(field.name, {})
        for said in (features.get(field.name), own):
            said = said if isinstance(said, Mapping) else {}
            unit = said.get("unit", said.get("units"))
            names = said.get("names")
            names = (
                next(iter(names.values()), None)
                if isinstance(names, Mapping)
                else names
            )
            if isinstance(unit, str):
                facts["unit"] = unit
            if (
                isinstance(names, list)
                and names
                and all(isinstance(x, str) for x in names)
            ):
                facts["joints"] = tuple(_without_ending(x) for x in names)
    return out


def _without_ending(name: str) -> str:
    """Return a motor's name without the quantity behind it, "elbow" for "elbow.pos"."""
    return next((name.removesuffix(x) for x in _ENDINGS if name.endswith(x)), name)


def _features(path: Path) -> Mapping[str, Any]:
    """Return the descriptions of the columns in the data set's info.json, by name;
    empty where there is none that can be read."""
    folders = list(path.absolute().parents)[:_LEVELS]
    file = next((x / _INFO for x in folders if (x / _INFO).is_file()), None)
    try:
        if file is None or file.stat().st_size > _LONGEST:
            return {}
        features = json.loads(file.read_bytes())["features"]
    except (ValueError, OSError, RecursionError, TypeError, KeyError):
        return {}
    return features if isinstance(features, Mapping) else {}


def write(measurements: Measurements, path: Path) -> None:
    """Write one run as a Parquet table with the columns of RUN.csv."""
    import pyarrow as arrow
    from pyarrow import parquet

    tables = (arrow.table(columns_of(part)) for part in measurements.parts())
    first = next(tables, None) or arrow.table(columns_of(measurements))
    with writing(path) as file, parquet.ParquetWriter(file, first.schema) as writer:
        for table in chain([first], tables):
            writer.write_table(table)
