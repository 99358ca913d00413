"""Feather files: Apache Arrow's tables on the disk, as pandas and polars write them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sdp_vs_penalty.data.formats.limits import parse_apart
from sdp_vs_penalty.data.formats.parquet import columns_of_table
from sdp_vs_penalty.data.log import Log, log_of_arrays, seconds_of_rows
from sdp_vs_penalty.files import path_or_file

SUFFIXES: tuple[str, ...] = (".feather", ".arrow")


def read(path: Path) -> Log:
    """Read the columns of a Feather file that are no texts, but for stamps."""
    what = "Feather file", "write it anew, or convert it to CSV"
    columns = parse_apart(numeric_columns, path, "pyarrow.feather", *what)
    return log_of_arrays(path, columns, has_gaps=True)


def numeric_columns(path: str) -> Iterator[dict[str, Any]]:
    """Parse the columns of numbers and stamps, one at a time; to be run in a process of its
    own, whose memory is limited."""
    from pyarrow import feather

    table: Any = feather.read_table(path_or_file(Path(path)), use_threads=False)
    for name in table.column_names:
        numbers, texts, _ = columns_of_table(Path(path), table.select([name]))
        stamps = seconds_of_rows(texts.get(name, []))
        yield numbers if stamps is None else {name: stamps}
