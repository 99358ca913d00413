"""Parquet tables with the columns of RUN.csv (extra [formats])."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from sdp_vs_penalty.errors import InputError, missing_extra
from sdp_vs_penalty.files import write_bytes
from sdp_vs_penalty.formats import Choice, check_size, columns_of, from_columns
from sdp_vs_penalty.measurements import Measurements


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
        check_size(path, 8 * file.metadata.num_rows * file.metadata.num_columns, path.stat().st_size)
        table = file.read()
    except InputError:
        raise
    except Exception as error:  # every layer of the library has exceptions of its own
        what = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path}: not a readable Parquet file ({what}).") from error
    columns = {}
    for name in dict.fromkeys(table.column_names):
        if table.column_names.count(name) > 1:
            raise InputError(f"{path}: column {name} comes twice.")
        values = table.column(name).to_numpy()
        if values.dtype.kind in "fiu":
            columns[name] = np.asarray(values, float)
    return from_columns(path, columns, choice.rename)


def write(measurements: Measurements, path: Path) -> None:
    arrow, parquet = _module()
    buffer = io.BytesIO()
    parquet.write_table(arrow.table(columns_of(measurements)), buffer)  # type: ignore[attr-defined]
    write_bytes(path, buffer.getvalue())
