"""One run from several files: positions in one, torques in another, joined by their
stamps or row by row."""

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.formats import FILE_SEPARATOR, csv, format_of
from sdp_vs_penalty.data.formats.column_names import read_name
from sdp_vs_penalty.data.formats.columns import Choice, Header
from sdp_vs_penalty.data.formats.recognition import CellTable, find_clock, recognise
from sdp_vs_penalty.data.formats.renaming import expanded, parts_of
from sdp_vs_penalty.data.formats.stamps import second_part_unit
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.merging import half_period, nearest_rows
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.files import reading
from sdp_vs_penalty.robot.arrays import Array

#: Suffixes of the files of a folder that holds one run, a file a quantity.
_SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".npy")


@dataclass(frozen=True)
class FilePart:
    """The columns of one file of a run.

    Parameters
    ----------
    path : of the file
    table : what its columns hold
    columns : (N,) or (N, n) by name
    """

    path: Path
    table: CellTable
    columns: Mapping[str, Array]

    @property
    def n_rows(self) -> int:
        """How many samples it has."""
        return max(len(block) for block in self.columns.values())

    @property
    def clock_columns(self) -> tuple[str, ...]:
        """The columns of its clock, two of a stamp in two parts; none without."""
        names = list(self.columns)
        if names[0] == "#1":
            is_only = len(names) == 1
            is_clock = (
                _quantity_of(self.path) == "t"
                if is_only
                else _goes_on_evenly(self.columns["#1"])
            )
            return ("#1",) if is_clock else ()
        clock = find_clock(names)
        return () if clock is None else parts_of(clock, names)

    @property
    def clock(self) -> Array | None:
        """(N,) its stamps in the file's own unit; None without."""
        parts = self.clock_columns
        if not parts:
            return None
        first = np.ravel(self.columns[parts[0]])
        return first + sum(
            second_part_unit(name) * np.ravel(self.columns[name]) for name in parts[1:]
        )

    def channels(self, is_prefixed: bool) -> dict[str, str]:
        """Name the channels of this file in the joined run.

        Parameters
        ----------
        is_prefixed : bool
            With the file's name before the columns'.

        Returns
        -------
        dict[str, str]
            Names in the run by names in the file, without the clock.
        """
        others = [name for name in self.columns if name not in self.clock_columns]
        if not is_prefixed:
            return {name: name for name in others}
        stem = self.path.stem
        if not others or not others[0].startswith("#"):
            return {name: f"{stem}/{name}" for name in others}
        if len(others) == 1:
            return {others[0]: stem}
        return {name: f"{stem}/{k}" for k, name in enumerate(others, start=1)}


def _goes_on_evenly(values: Array) -> bool:
    """Whether numbers (N,) are those of a clock: each step is above 0, none ten times as
    long as usual."""
    steps = np.diff(values)
    return (
        len(steps) > 0 and steps.min() > 0.0 and steps.max() < 10.0 * np.median(steps)
    )


def files_of_run(path: Path) -> list[Path]:
    """The files that one argument joins to a run.

    Parameters
    ----------
    path : Path
        "positions.csv+torques.csv"; or a folder with a file a quantity, whose names say
        which ("dataQ.txt", "dataCur.txt").

    Returns
    -------
    list of Path
        At least two files; none where the argument is another one.
    """
    if path.is_dir():
        return [] if format_of(path) else _files_of_folder(path)
    names = str(path).split(FILE_SEPARATOR)
    if len(names) < 2 or path.exists() or not all(names):
        return []
    folder = Path(names[0]).parent
    return [_beside(Path(name), folder) for name in names]


def _beside(path: Path, folder: Path) -> Path:
    """A file by its path, or by its name in the folder of the first one."""
    is_there = path.exists() or path.is_absolute()
    return path if is_there or not (folder / path).exists() else folder / path


def _files_of_folder(folder: Path) -> list[Path]:
    """The files of a folder whose names say one quantity each, where positions and
    torques are among them and none is a run itself."""
    files = [p for p in sorted(folder.iterdir()) if p.suffix.lower() in _SUFFIXES]
    quantities = {file: _quantity_of(file) for file in files}
    found = set(quantities.values())
    if "q" not in found or not {"tau", "qcmd"} & found:
        return []
    positions = next(file for file in files if quantities[file] == "q")
    home = format_of(positions) or csv
    try:
        with reading(positions):
            table = home.inspect(positions)
        is_run = recognise(list(table.kinds), None, table) is not None
    except InputError:
        return []
    return [] if is_run else [file for file in files if quantities[file]]


def _quantity_of(path: Path) -> str | None:
    """The quantity that a file's name says: "q" of dataQ.txt; None without."""
    reading_of_name = read_name(path.stem)
    return None if reading_of_name is None else reading_of_name.quantity


def read_joined(
    path: Path,
    files: Sequence[Path],
    choice: Choice,
) -> Measurements:
    """Read one run from several files.

    Parameters
    ----------
    path : Path
        How messages call them together.
    files : sequence of Path
        Text tables, .npy, .npz, .mat or .parquet files; each with a clock, or as many
        rows as the first one.
    choice : Choice
        What of them to take.

    Returns
    -------
    Measurements
        The samples of the first file with those of the others that are nearest in time,
        within half a period. In SI units.

    Raises
    ------
    InputError
        A file that cannot be read, files of different lengths without clocks, or no
        positions and torques among their columns.
    """
    parts = [_read_part(file) for file in files]
    names = Counter(name for part in parts for name in part.channels(False))
    has_repeated_names = any(n > 1 for n in names.values())
    run_table = _join(parts, has_repeated_names or "#1" in names)
    if not has_repeated_names and not _has_channels(run_table[0], choice):
        run_table = _join(parts, is_prefixed=True)
    table, columns = run_table
    header = Header.of(path, list(columns), choice, table=table)
    name = path.name if path.is_dir() else files[0].name
    return replace(header.read(columns), names=(name,))


def _has_channels(table: CellTable, choice: Choice) -> bool:
    """Whether the columns that are chosen, or those of a run, are there."""
    names = list(table.kinds)
    if not choice.rename:
        return recognise(names, choice.joints, table) is not None
    try:
        chosen = expanded(choice.rename, names)
    except InputError:
        return False
    return all(set(parts_of(name, names)) <= set(names) for name in chosen.values())


def _read_part(path: Path) -> FilePart:
    """The columns of a file that are numbers."""
    with reading(path):
        home = format_of(path) or csv
        read_columns = getattr(home, "read_columns", None)
        if read_columns is None:
            what = "a bag cannot be joined with another file"
            raise InputError(what, "convert it first, or name it alone", path)
        table, columns = home.inspect(path), read_columns(path)
    if not columns:
        raise InputError("no column of numbers", "name another file", path)
    return FilePart(path, table, columns)


def _join(
    parts: Sequence[FilePart], is_prefixed: bool
) -> tuple[CellTable, dict[str, Array]]:
    """The columns of all files in the rows of the first one with a clock, and what they
    hold; is_prefixed : names begin with their file's."""
    clocks = [part for part in parts if part.clock_columns]
    base = clocks[0] if clocks else parts[0]
    rows, is_near = _rows_of_parts(base, parts)
    columns = {name: base.columns[name][is_near] for name in base.clock_columns}
    kinds = {name: base.table.kinds[name] for name in base.clock_columns}
    cells = {name: base.table.cells.get(name, ()) for name in base.clock_columns}
    if list(columns) == ["#1"]:
        columns, kinds, cells = {"t": columns["#1"]}, {"t": "number"}, {}
    for part, places in zip(parts, rows, strict=True):
        for name, joined_name in part.channels(is_prefixed).items():
            columns[joined_name] = part.columns[name][places[is_near]]
            kinds[joined_name] = part.table.kinds[name]
            cells[joined_name] = part.table.cells.get(name, ())
    n_lost = base.n_rows - int(is_near.sum())
    if n_lost:
        lost = formatting.count(n_lost, "row")
        warning = f"{base.path}: {lost} without a partner in the other files left out"
        warnings.warn(warning, Remark, stacklevel=4)
    return CellTable(kinds, cells), columns


def _rows_of_parts(
    base: FilePart, parts: Sequence[FilePart]
) -> tuple[list[NDArray[np.intp]], NDArray[np.bool_]]:
    """For each file the row that belongs to each row of ``base`` (N,), and whether all
    files have one (N,)."""
    n_rows = base.n_rows
    clock = base.clock
    is_near = np.ones(n_rows, bool)
    rows = list[NDArray[np.intp]]()
    for part in parts:
        other = part.clock
        is_by_row = other is None or clock is None or np.array_equal(other, clock)
        if is_by_row and part.n_rows != n_rows:
            what = (
                f"{part.path.name} has {part.n_rows} rows, {base.path.name} has {n_rows},"
                " and no clock says which belong together"
            )
            remedy = "give each file a column t, or as many rows"
            raise InputError(what, remedy, part.path)
        if other is None or clock is None or is_by_row:
            rows.append(np.arange(n_rows))
            continue
        order = np.argsort(other, kind="stable")
        nearest, near = nearest_rows(clock, other[order], half_period(clock))
        rows.append(order[nearest])
        is_near &= near
    if not is_near.any():
        what = "the stamps of these files have no instant in common"
        raise InputError(what, "name files of one recording", base.path)
    return rows, is_near
