"""Feather files: Apache Arrow's tables on the disk, as pandas and polars write them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sdp_vs_penalty.data.formats.columns import Choice, table_of_arrays, understood
from sdp_vs_penalty.data.formats.npy import run_of_columns
from sdp_vs_penalty.data.formats.parquet import kind_of, numbers_of
from sdp_vs_penalty.data.formats.recognition import CellTable
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.files import path_or_file
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES = (".feather", ".arrow")


def read(path: Path, choice: Choice) -> Measurements:
    """Read the run of a Feather file. See
    :meth:`~sdp_vs_penalty.data.formats.interface.MeasurementFormat.read`."""
    return run_of_columns(path, read_columns(path), choice)


def inspect(path: Path) -> CellTable:
    """Describe the columns of a Feather file by their kinds and first rows. See
    :meth:`~sdp_vs_penalty.data.formats.interface.TableFormat.inspect`."""
    return table_of_arrays(read_columns(path))


def read_columns(path: Path) -> dict[str, Array]:
    """Read the columns that are no texts: (N,) numbers or (N, n) blocks, by name. See
    :meth:`~sdp_vs_penalty.data.formats.interface.TableFormat.read_columns`."""
    from sdp_vs_penalty.robot.isolated import parse_isolated

    columns = dict[str, Array]()
    with understood(path, "Feather file", "write it anew, or convert it to CSV"):
        for part in parse_isolated(numeric_columns, path, prepare=load_feather):
            columns |= part
    return columns


def load_feather() -> None:
    """Import pyarrow in the parent process, so that the forked child that parses a file
    has it at once."""
    from pyarrow import feather  # noqa: F401


def numeric_columns(path: str) -> Iterator[dict[str, Array]]:
    """Parse the columns that are no texts, one at a time; to be run in a process of its
    own, whose memory is limited."""
    from pyarrow import feather

    table: Any = feather.read_table(path_or_file(Path(path)), use_threads=False)
    for field in table.schema:
        if kind_of(field.type) != "text":
            yield {
                field.name: numbers_of(Path(path), field.name, table.column(field.name))
            }
