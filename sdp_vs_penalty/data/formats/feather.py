"""Feather files: Apache Arrow's tables on the disk, as pandas and polars write them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sdp_vs_penalty.data.formats.limits import understood
from sdp_vs_penalty.data.formats.parquet import kind_of, numbers_of
from sdp_vs_penalty.data.log import Log, log_of_arrays
from sdp_vs_penalty.files import path_or_file
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES: tuple[str, ...] = (".feather", ".arrow")


def read(path: Path) -> Log:
    """Read the columns of a Feather file that are no texts."""
    from sdp_vs_penalty.robot.isolated import parse_isolated

    columns = dict[str, Array]()
    with understood(path, "Feather file", "write it anew, or convert it to CSV"):
        for part in parse_isolated(numeric_columns, path, prepare=load_feather):
            columns |= part
    return log_of_arrays(path, columns)


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
            column = table.column(field.name)
            yield {field.name: numbers_of(Path(path), field.name, column)}
