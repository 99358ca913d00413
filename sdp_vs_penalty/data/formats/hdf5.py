"""HDF5 files with data sets t, q, tau, or of other names, in groups or not (extra
[formats])."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.formats.columns import Choice, table_of_arrays, understood
from sdp_vs_penalty.data.formats.npy import run_of_columns
from sdp_vs_penalty.data.formats.recognition import CellTable
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError, missing_extra
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES = (".h5", ".hdf5")
#: Groups of MATLAB's and pandas' own.
_INTERNAL = ("#refs#", "#subsystem#", "_i_table")
#: Data sets of pandas: the names of a block's columns, and its values.
_ITEMS, _VALUES = "_items", "_values"
#: What stands between the name of a table and that of its column.
_WITHIN = "\n"


def read(path: Path, choice: Choice) -> Measurements:
    """Read the run of an HDF5 file; raise InputError without h5py. See
    :meth:`~sdp_vs_penalty.data.formats.interface.MeasurementFormat.read`."""
    return run_of_columns(path, read_columns(path), choice)


def inspect(path: Path) -> CellTable:
    """Describe the data sets by their kinds and first rows. See
    :meth:`~sdp_vs_penalty.data.formats.interface.TableFormat.inspect`."""
    return table_of_arrays(read_columns(path))


def read_columns(path: Path) -> dict[str, Array]:
    """Read the numeric data sets, by name: (N,) numbers or (N, n) blocks.

    Data sets in groups are called "robot/q", columns of a table by their own names, "q".
    A process of its own parses the file: one wrong byte can end it. See
    :meth:`~sdp_vs_penalty.data.formats.interface.TableFormat.read_columns`.
    """
    from sdp_vs_penalty.robot.isolated import parse_isolated

    try:
        import h5py  # noqa: F401
    except ImportError as error:
        raise missing_extra("HDF5 files need", "formats") from error
    remedy = "save its arrays with numpy.savez(path, t=..., q=..., tau=...)"
    with understood(path, "HDF5 file", remedy):
        parts = list(parse_isolated(numeric_data_sets, path, prepare=load_h5py))
    return _by_bare_names(path, [item for part in parts for item in part.items()])


def _by_bare_names(
    path: Path, columns: Sequence[tuple[str, Array]]
) -> dict[str, Array]:
    """Name the columns of tables by their own names, without the tables'.

    Raises InputError where two columns have the same name, such as those of a measured
    and a desired state, or of two runs: nothing says which one is meant.
    """
    arrays = dict[str, Array]()
    tables = dict[str, str]()
    for name, values in columns:
        table, _, column = name.rpartition(_WITHIN)
        if column in arrays:
            places = " and ".join(x or "the file" for x in (tables[column], table))
            what = f"two columns are called {column}, in {places}"
            raise InputError(
                what, "write the table of the run into a file of its own", path
            )
        arrays[column] = values
        tables[column] = table
    return arrays


def load_h5py() -> None:
    """Import h5py in the parent process, so that the forked child that parses a file
    has it at once."""
    import h5py  # noqa: F401


def numeric_data_sets(path: str) -> Iterator[dict[str, Array]]:
    """Parse the numeric data sets of a file, one at a time.

    To be run in a process of its own. Links to other files, and data that lie in them,
    are not followed. Data sets of more than two dimensions, such as pictures, are left
    out.

    Yields
    ------
    dict[str, Array]
        One name and its numbers (N,) or (N, n). The name of a column of a table has the
        table's before it, in a line of its own.
    """
    import h5py

    with h5py.File(path, "r") as file:
        names = list[str]()
        file.visit(names.append)
        for name in names:
            data_set = file[name]
            is_own = isinstance(data_set, h5py.Dataset) and not (
                data_set.external or data_set.is_virtual
            )
            if is_own and not any(part in name for part in _INTERNAL):
                for column, values in _columns_of(file, name, data_set):
                    yield {column: values}


def _columns_of(file: Any, name: str, data_set: Any) -> Iterator[tuple[str, Array]]:
    """Iterate over the columns of a data set: the fields of records, the named columns
    of a block of pandas, or the data set itself."""
    if data_set.ndim not in (1, 2):
        return
    if data_set.dtype.names:
        for field in data_set.dtype.names:
            if data_set.dtype[field].base.kind in "fiu":
                yield f"{name}{_WITHIN}{field}", np.asarray(data_set[field], float)
        return
    if data_set.dtype.kind not in "fiu":
        return
    items = name.removesuffix(_VALUES) + _ITEMS
    table = name.rpartition("/")[0]
    if name.endswith(_VALUES) and items in file:
        for place, item in enumerate(file[items][()]):
            label = item.decode() if isinstance(item, bytes) else str(item)
            yield f"{table}{_WITHIN}{label}", np.asarray(data_set[:, place], float)
        return
    yield name, np.asarray(data_set[()], float)
