"""Parquet tables with the columns of RUN.csv (extra [formats])."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.formats.columns import Choice, check_size, columns_of, from_columns
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError, missing_extra
from sdp_vs_penalty.files import write_bytes

SUFFIXES = (".parquet", ".pq")


def _module() -> tuple[object, object]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise missing_extra("Parquet files need", "formats") from error
    return pyarrow, pyarrow.parquet


def read(path: Path, choice: Choice) -> Measurements:
    """Numeric columns of the table; others (time stamps, texts) are ignored."""
    _, parquet = _module()
    try:
        file = parquet.ParquetFile(path)  # type: ignore[attr-defined]
        table = file.read(columns=_numeric_columns(path, file))
    except InputError:
        raise
    except Exception as error:  # every layer of the library has exceptions of its own
        what = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(
            f"not a readable Parquet file ({what})", "write it anew, or convert it to CSV", path
        ) from error
    columns = {}
    for name in table.column_names:
        values = table.column(name).to_numpy()
        if values.dtype.kind in "fiu":
            columns[name] = np.asarray(values, float)
    return from_columns(path, columns, choice.rename)


def _numeric_columns(path: Path, file: Any) -> list[str]:
    """The columns worth reading; InputError for names that come twice and for files that would burst.

    Texts are not read at all: one that is stored once can come in every row.
    """
    names = file.schema_arrow.names
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"column {name} comes twice", "rename one of them", path)
    metadata = file.metadata
    stored = sum(metadata.row_group(k).total_byte_size for k in range(metadata.num_row_groups))
    numbers = 8 * metadata.num_rows * metadata.num_columns
    check_size(path, max(numbers, stored), path.stat().st_size)
    return [field.name for field in file.schema_arrow if _is_number(field.type)]


def _is_number(kind: Any) -> bool:
    from pyarrow import types

    if types.is_dictionary(kind):
        kind = kind.value_type
    return bool(types.is_integer(kind) or types.is_floating(kind))


def write(measurements: Measurements, path: Path) -> None:
    arrow, parquet = _module()
    buffer = io.BytesIO()
    parquet.write_table(arrow.table(columns_of(measurements)), buffer)  # type: ignore[attr-defined]
    write_bytes(path, buffer.getvalue())
