"""Parquet tables with the columns of RUN.csv."""

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.formats.columns import Choice, Header, columns_of, understood
from sdp_vs_penalty.data.measurements import Measurements, gathered
from sdp_vs_penalty.data.store import PART
from sdp_vs_penalty.files import writing

SUFFIXES = (".parquet", ".pq")


def read(path: Path, choice: Choice) -> Measurements:
    """Numeric columns of the table; others (time stamps, texts) are ignored."""
    from pyarrow import parquet

    # Buffered ahead, all of a row group would be in memory.
    with (
        understood(path, "Parquet file", "write it anew, or convert it to CSV"),
        parquet.ParquetFile(path, pre_buffer=False) as file,
    ):
        return gathered(_pieces(path, choice, file))


def _pieces(path: Path, choice: Choice, file: Any) -> Iterator[Measurements]:
    """The rows in consecutive pieces, at least one.

    Texts are not read at all: one that is stored once can come in every row.
    """
    import pyarrow as arrow
    from pyarrow import types

    names = []
    for one in file.schema_arrow:
        kind = one.type.value_type if types.is_dictionary(one.type) else one.type
        names += [one.name] * bool(types.is_integer(kind) or types.is_floating(kind))
    header = Header.of(path, names, choice)
    empty = (
        [file.schema_arrow.empty_table().select(names)]
        if file.metadata.num_rows == 0
        else []
    )
    batches = file.iter_batches(batch_size=PART, columns=names, use_threads=False)
    for table in empty or (arrow.Table.from_batches([batch]) for batch in batches):
        columns = {
            name: np.asarray(table.column(name).to_numpy(), float)
            for name in table.column_names
        }
        yield header.run(columns)


def write(measurements: Measurements, path: Path) -> None:
    import pyarrow as arrow
    from pyarrow import parquet

    tables = (arrow.table(columns_of(part)) for part in measurements.parts())
    first = next(tables, None) or arrow.table(columns_of(measurements))
    with writing(path) as file, parquet.ParquetWriter(file, first.schema) as writer:
        for table in chain([first], tables):
            writer.write_table(table)
