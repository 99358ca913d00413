"""Parquet tables with the columns of RUN.csv."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.formats.columns import Choice, Header, columns_of, understood
from sdp_vs_penalty.data.formats.dataset_info import stated_units
from sdp_vs_penalty.data.formats.joint_order import (
    Places,
    in_first_order,
    places_of_joints,
)
from sdp_vs_penalty.data.formats.recognition import CellTable, columns_of_joint_names
from sdp_vs_penalty.data.formats.stamps import is_stamp, seconds_of
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.store import PART
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import memory_for, path_or_file, unpacks_to_too_much, writing
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES = (".parquet", ".pq")


def read(path: Path, choice: Choice) -> Measurements:
    """Read the run of a Parquet table; texts are left out. See
    :meth:`~sdp_vs_penalty.data.formats.interface.MeasurementFormat.read`."""
    with _opened(path) as file:
        header = _header(path, choice, file)
        places = _places_of_joints(path, file)
        if places is not None:
            return header.read(in_first_order(read_columns(path), places))
        return header.gather(_pieces(path, header, file))


def inspect(path: Path) -> CellTable:
    """Describe the columns of a Parquet table.

    Returns
    -------
    CellTable
        Kinds and first cells, by name.
    """
    with _opened(path) as file:
        return replace(_cell_table(file), units=stated_units(path, file.schema_arrow))


def read_columns(path: Path) -> dict[str, Array]:
    """Read the columns of a Parquet table that are no texts.

    Returns
    -------
    dict[str, Array]
        (N,) numbers or (N, n) blocks, by name.

    Raises
    ------
    InputError
        A file that cannot be read, or a channel that is missing.
    """
    with _opened(path) as file:
        kinds = _cell_table(file).kinds
        names = [name for name, kind in kinds.items() if kind != "text"]
        table = file.read(columns=names, use_threads=False)
    return {name: numbers_of(path, name, table.column(name)) for name in names}


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a table that takes no more memory than its size allows: a value that comes
    in every row is stored once."""
    from pyarrow import parquet

    with (
        understood(path, "Parquet file", "write it anew, or convert it to CSV"),
        # Buffered ahead, all of a row group would be in memory.
        parquet.ParquetFile(path_or_file(path), pre_buffer=False) as file,
    ):
        metadata = file.metadata
        groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
        n_values = sum(
            group.column(k).num_values
            for group in groups
            for k in range(group.num_columns)
        )
        n_bytes = max(8 * n_values, sum(group.total_byte_size for group in groups))
        if n_bytes > memory_for(path.stat().st_size):
            raise unpacks_to_too_much(path)
        yield file


def _header(path: Path, choice: Choice, file: Any) -> Header:
    """Find the columns of the file that are channels."""
    table = replace(_cell_table(file), units=stated_units(path, file.schema_arrow))
    return Header.of(path, list(table.kinds), choice, table=table)


def _cell_table(file: Any) -> CellTable:
    """Describe the columns by their types and first 50 values; of texts only lists of
    joints' names."""
    schema = file.schema_arrow
    names_of_joints = _columns_of_joints(file)
    kinds = {field.name: kind_of(field.type) for field in schema}
    kinds |= dict.fromkeys(_columns_of_stamps(file), "stamp")
    kinds = {
        name: kind
        for name, kind in kinds.items()
        if kind != "text" or name in names_of_joints
    }
    first = next(file.iter_batches(batch_size=50, columns=list(kinds)), None)
    return CellTable(kinds, {name: _texts(first, name) for name in kinds})


def _columns_of_stamps(file: Any) -> list[str]:
    """List the columns of texts whose first values are all times."""
    from pyarrow import types

    schema = file.schema_arrow
    texts = [
        x.name
        for x in schema
        if types.is_string(x.type) or types.is_large_string(x.type)
    ]
    first = (
        next(file.iter_batches(batch_size=50, columns=texts), None) if texts else None
    )
    values = {name: _texts(first, name) for name in texts}
    return [name for name, x in values.items() if x and all(map(is_stamp, x))]


def _columns_of_joints(file: Any) -> list[str]:
    """List the columns that hold a list of the joints' names in each row."""
    from pyarrow import types

    lists = [
        field.name
        for field in file.schema_arrow
        if (types.is_list(field.type) or types.is_large_list(field.type))
        and (
            types.is_string(field.type.value_type)
            or types.is_large_string(field.type.value_type)
        )
    ]
    return columns_of_joint_names(lists)


def _places_of_joints(path: Path, file: Any) -> Places | None:
    """Find where each row has the joints of the first row; None where the order never
    changes, or no column names the joints."""
    columns = _columns_of_joints(file)
    if not columns or file.metadata.num_rows == 0:
        return None
    texts = file.read(columns=columns[:1], use_threads=False).column(0).to_pylist()
    joints_of_rows = [[str(name) for name in row or ()] for row in texts]
    return places_of_joints(path, joints_of_rows, range(1, len(texts) + 1))


def _pieces(path: Path, header: Header, file: Any) -> Iterator[Measurements]:
    """Read the chosen columns in consecutive pieces of the run; at least one, perhaps
    empty.

    Other columns are not read: a text that the file stores once can come in every row.
    """
    import pyarrow as arrow

    chosen = header.columns
    empty = (
        [file.schema_arrow.empty_table().select(chosen)]
        if file.metadata.num_rows == 0
        else []
    )
    batches = file.iter_batches(batch_size=PART, columns=chosen, use_threads=False)
    for table in empty or (arrow.Table.from_batches([batch]) for batch in batches):
        columns = {name: numbers_of(path, name, table.column(name)) for name in chosen}
        yield header.run(columns)


def kind_of(kind: Any) -> str:
    """Return what a column of an Arrow type holds.

    Returns
    -------
    str
        "number", "list" (of numbers), "stamp" or "text".
    """
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


def _texts(batch: Any, name: str) -> list[str]:
    """Format the first values of a column as texts."""
    return [] if batch is None else [str(x) for x in batch.column(name).to_pylist()]


def numbers_of(path: Path, name: str, column: Any) -> Array:
    """Convert a column of Arrow's to numbers.

    Parameters
    ----------
    path : Path
        How messages call the file.
    column : Any
        Arrow's column of N cells.

    Returns
    -------
    Array
        (N,) numbers; (N, n) where cells hold lists; seconds since 1970 [s] for time
        stamps, also in words; seconds [s] for durations.

    Raises
    ------
    InputError
        Lists of different lengths, or texts that are no time stamps.
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
        nanoseconds = column.cast(kind_in_ns, safe=False).cast("int64")
        return 1e-9 * np.asarray(nanoseconds.to_numpy(), float)
    if kind == "list":
        rows = column.to_pylist()
        lengths = {len(row or ()) for row in rows}
        if len(lengths) > 1:
            what = f"column {name} holds lists of different lengths"
            raise InputError(what, "give each row as many values", path)
        return np.array(rows, float).reshape(len(rows), *lengths or (0,))
    return np.asarray(column.to_numpy(), float)


def write(measurements: Measurements, path: Path) -> None:
    """Write one run as a Parquet table with the columns of RUN.csv.

    The file appears when it is complete: an interruption leaves no half-written file.

    Parameters
    ----------
    path : Path
        Path of the file to write.
    """
    import pyarrow as arrow
    from pyarrow import parquet

    tables = (arrow.table(columns_of(part)) for part in measurements.parts())
    first = next(tables, None) or arrow.table(columns_of(measurements))
    with writing(path) as file, parquet.ParquetWriter(file, first.schema) as writer:
        for table in chain([first], tables):
            writer.write_table(table)
