"""HDF5 files with data sets t, q, tau, or of other names, in groups or not (extra
[formats])."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.data.formats.limits import joint_names_in, parse_apart, texts_apart
from sdp_vs_penalty.data.log import Log, log_of_arrays
from sdp_vs_penalty.errors import missing_extra
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES: tuple[str, ...] = (".h5", ".hdf5")

#: Groups of MATLAB's and pandas' own.
_INTERNAL = ("#refs#", "#subsystem#", "_i_table")
#: Data sets of pandas: the names of a block's columns, and its values.
_ITEMS, _VALUES = "_items", "_values"
#: Attributes that say a unit, and more letters than one has.
_UNITS, _LONGEST_UNIT = ("unit", "units", "Unit", "Units"), 12
#: What stands between the name of a table and that of its column.
_WITHIN = "\n"


def read(path: Path) -> Log:
    """Read the numeric data sets: (N,) numbers or (N, n) blocks.

    Data sets in groups are called "robot/q", columns of a table by their own names, "q";
    where two have the same, such as those of two runs, "demo_0/q". A process of its own
    parses the file: one wrong byte can end it. Raises InputError without h5py.
    """
    try:
        import h5py  # noqa: F401
    except ImportError as error:
        raise missing_extra("HDF5 files need", "formats") from error
    remedy = "save its arrays with numpy.savez(path, t=..., q=..., tau=...)"
    sent = parse_apart(numeric_data_sets, path, "h5py", "HDF5 file", remedy)
    parts, texts = texts_apart(sent)
    own = [name.rpartition(_WITHIN)[2] for name in parts]
    names = own if len({*own}) == len(own) else [x.replace(_WITHIN, "/") for x in parts]
    return log_of_arrays(path, dict(zip(names, parts.values(), strict=True)), texts)


def numeric_data_sets(path: str) -> Iterator[dict[str, Array]]:
    """Parse the numeric data sets of a file, one at a time: a name and its numbers (N,)
    or (N, n); the name of a column of a table has the table's before it, in a line of
    its own, and a unit that an attribute says stands behind a name, "q [deg]".

    To be run in a process of its own. Links to other files, and data that lie in them,
    are not followed. Data sets of more than two dimensions, such as pictures, are left
    out.
    """
    import h5py

    with h5py.File(path, "r") as file:
        names = list[str]()
        file.visit(names.append)
        for attribute, value in file.attrs.items():
            yield from joint_names_in(attribute, value)
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
    if data_set.ndim > 2:
        return
    for field in data_set.dtype.names or ():
        if data_set.dtype[field].base.kind in "fiu":
            values = np.atleast_1d(np.asarray(data_set[field], float))
            yield f"{name}{_WITHIN}{field}", values
    if data_set.dtype.kind == "O":
        for part in joint_names_in(name.rpartition("/")[2], data_set[()]):
            yield from part.items()
    if data_set.dtype.kind not in "fiu":
        return
    items = name.removesuffix(_VALUES) + _ITEMS
    if not (name.endswith(_VALUES) and items in file):
        stated = next((data_set.attrs[x] for x in _UNITS if x in data_set.attrs), "")
        unit = stated.decode(errors="replace") if isinstance(stated, bytes) else stated
        is_said = isinstance(unit, str) and 0 < len(unit) < _LONGEST_UNIT
        values = np.atleast_1d(np.asarray(data_set[()], float))  # a rate is one number
        yield f"{name} [{unit}]" if is_said else name, values
        return
    for place, item in enumerate(file[items][()]):
        label = item.decode() if isinstance(item, bytes) else str(item)
        table = name.rpartition("/")[0]
        yield f"{table}{_WITHIN}{label}", np.asarray(data_set[:, place], float)
