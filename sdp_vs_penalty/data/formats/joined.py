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
from sdp_vs_penalty.data.formats.column_names import (
    is_word_for_joint,
    read_name,
    split_tokens,
)
from sdp_vs_penalty.data.formats.columns import Choice, Header
from sdp_vs_penalty.data.formats.recognition import CellTable, find_clock, recognise
from sdp_vs_penalty.data.formats.renaming import expanded, group_of, parts_of
from sdp_vs_penalty.data.formats.stamps import units_of_parts
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.merging import Interpolation, half_period, interpolation_remark
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.files import reading
from sdp_vs_penalty.robot.arrays import Array

#: Suffixes of the files of a folder that holds one run, a file a quantity.
_SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".npy")


#: Those of a folder with a file a joint.
_TABLES = (*_SUFFIXES, ".npz", ".parquet", ".mat")


@dataclass(frozen=True)
class FilePart:
    """The columns of one file of a run."""

    #: Path of the file.
    path: Path
    #: Kinds and first cells of its columns.
    table: CellTable
    #: (N,) numbers or (N, n) blocks of each column, by name.
    columns: Mapping[str, Array]

    @property
    def n_rows(self) -> int:
        """Number of samples of this file."""
        return max(len(block) for block in self.columns.values())

    @property
    def clock_columns(self) -> tuple[str, ...]:
        """Names of the columns that hold this file's time stamps.

        Two columns where a stamp is split into seconds and nanoseconds; empty where the
        file has no clock. In a file without a header, "#1" names the first column: it
        is the clock where its values rise evenly, or where it is the only column of a
        file called like "time.txt".
        """
        names = list(self.columns)
        if names[0] == "#1":
            if len(names) == 1:
                is_clock = _quantity_of(self.path) == "t"
            else:
                is_clock = _rises_evenly(self.columns["#1"])
            return ("#1",) if is_clock else ()
        clock = find_clock(names)
        return () if clock is None else parts_of(clock, names)

    @property
    def clock(self) -> Array | None:
        """(N,) time stamps in the file's own unit; None where the file has no clock."""
        parts = self.clock_columns
        if not parts:
            return None
        stamps = np.zeros(self.n_rows)
        for name, unit in zip(parts, units_of_parts(parts), strict=True):
            stamps = stamps + unit * np.ravel(self.columns[name])
        return stamps

    def channels(self, is_prefixed: bool) -> dict[str, str]:
        """Name this file's channels (all columns but the clock) in the joined run.

        Parameters
        ----------
        is_prefixed : bool
            Put the file's name before the column's, "dataQ/1", so that equal column
            names of two files stay apart.

        Returns
        -------
        dict[str, str]
            Name in the joined run, by the name in this file.
        """
        channels = [name for name in self.columns if name not in self.clock_columns]
        if not is_prefixed:
            return {name: name for name in channels}
        stem = self.path.stem
        has_header = not channels or not channels[0].startswith("#")
        if has_header:
            return {name: f"{stem}/{name}" for name in channels}
        if len(channels) == 1:
            return {channels[0]: stem}
        return {name: f"{stem}/{k}" for k, name in enumerate(channels, start=1)}


def _rises_evenly(values: Array) -> bool:
    """Return whether values (N,) rise like a clock's: every step is positive, and none
    is ten times the median step."""
    steps = np.diff(values)
    if len(steps) == 0 or steps.min() <= 0.0:
        return False
    return bool(steps.max() < 10.0 * np.median(steps))


def files_of_run(path: Path) -> list[Path]:
    """List the files that one argument joins to one run.

    Parameters
    ----------
    path : Path
        Either "positions.csv+torques.csv", or a folder with one file for each quantity,
        whose names say the quantity ("dataQ.txt", "dataCur.txt"), or with one file for
        each joint ("joint1.csv", "joint2.csv").

    Returns
    -------
    list of Path
        Two files or more; empty where the argument is an ordinary file or folder.
    """
    if path.is_dir():
        return [] if format_of(path) else _files_of_folder(path)
    names = str(path).split(FILE_SEPARATOR)
    if len(names) < 2 or path.exists() or not all(names):
        return []
    folder = Path(names[0]).parent
    return [_in_first_folder(Path(name), folder) for name in names]


def _in_first_folder(path: Path, folder: Path) -> Path:
    """Return the path of a later file: as it stands, or, where it does not exist, in
    the folder of the first file ("log/q.csv+tau.csv" means log/tau.csv)."""
    if path.exists() or path.is_absolute():
        return path
    in_folder = folder / path
    return in_folder if in_folder.exists() else path


def _files_of_folder(folder: Path) -> list[Path]:
    """List the files of a folder that together are one run, one quantity or one joint
    in each.

    Empty where the names of the files do not say positions and torques (or commands),
    or where the file of positions holds torques as well and so is a run by itself.
    """
    tables = [p for p in sorted(folder.iterdir()) if p.suffix.lower() in _TABLES]
    if files_of_joints := _files_of_joints(tables):
        return files_of_joints
    files = [p for p in tables if p.suffix.lower() in _SUFFIXES]
    quantity_of_file = {file: _quantity_of(file) for file in files}
    quantities = set(quantity_of_file.values())
    if "q" not in quantities or not {"tau", "qcmd"} & quantities:
        return []
    positions = next(file for file in files if quantity_of_file[file] == "q")
    file_format = format_of(positions) or csv
    try:
        with reading(positions):
            table = file_format.inspect(positions)
        is_run_by_itself = recognise(list(table.kinds), None, table) is not None
    except InputError:
        return []
    if is_run_by_itself:
        return []
    return [file for file in files if quantity_of_file[file] is not None]


def _files_of_joints(files: Sequence[Path]) -> list[Path]:
    """List the files of a folder that hold a joint each, in the joints' order.

    Their names are a word for a joint and its number, "joint3.csv", counted from 0 or 1
    without a gap. Empty where the folder has no such files, or where they hold several
    joints and so are runs in which one joint moves.
    """
    file_of_number = dict[int, Path]()
    words_of_files = set[tuple[str, ...]]()
    for file in files:
        tokens = split_tokens(file.stem)
        words = tuple(token for token in tokens if not token.isdigit())
        if is_word_for_joint(words) and len(tokens) == len(words) + 1:
            number = next(int(token) for token in tokens if token.isdigit())
            file_of_number[number] = file
            words_of_files.add((*words, file.suffix.lower()))
    numbers = sorted(file_of_number)
    is_one_family = len(words_of_files) == 1 and len(numbers) > 1
    first = numbers[0] if numbers else 0
    if (
        not is_one_family
        or numbers != list(range(first, first + len(numbers)))
        or first > 1
    ):
        return []
    in_order = [file_of_number[number] for number in numbers]
    return in_order if _holds_one_joint(in_order[0]) else []


def _holds_one_joint(path: Path) -> bool:
    """Return whether a table's positions, as far as they are recognised, are of one
    joint."""
    try:
        with reading(path):
            table = (format_of(path) or csv).inspect(path)
            recognition = recognise(list(table.kinds), None, table)
    except InputError:
        return False
    rename = {} if recognition is None else recognition.rename
    positions = [their for ours, their in rename.items() if group_of(ours) == "q"]
    return len(positions) < 2 and "list" not in map(table.kinds.get, positions)


def _quantity_of(path: Path) -> str | None:
    """Return the quantity that a file's name says, "q" for dataQ.txt; None where it
    says none."""
    reading_of_name = read_name(path.stem)
    return None if reading_of_name is None else reading_of_name.quantity


def read_joined(path: Path, files: Sequence[Path], choice: Choice) -> Measurements:
    """Read one run whose channels are spread over several files.

    Columns keep their names where these tell the channels apart. Otherwise the file's
    name is put before them: two files may both have a column "joint1".

    Parameters
    ----------
    path : Path
        What messages call the files together.
    files : sequence of Path
        Text tables, .npy, .npz, .mat or .parquet files; each with a clock, or with as
        many rows as the first one.
    choice : Choice
        Which columns to take, the robot's joints, and the rate.

    Returns
    -------
    Measurements
        The samples of the file with the torque, to whose stamps the channels of the
        other files are interpolated. In SI units.

    Raises
    ------
    InputError
        A file that cannot be read, files of different lengths without clocks, or no
        positions and torques among their columns.
    """
    parts = [_read_part(file) for file in files]
    n_uses = Counter(n for part in parts for n in part.channels(is_prefixed=False))
    has_repeated_names = any(n > 1 for n in n_uses.values())
    has_unnamed_columns = "#1" in n_uses
    table, columns = _join(parts, has_repeated_names or has_unnamed_columns)
    if not has_repeated_names and not _has_channels(table, choice):
        # Only the names of the files say what their columns are.
        table, columns = _join(parts, is_prefixed=True)
    header = Header.of(path, list(columns), choice, table=table)
    name_of_run = path.name if path.is_dir() else files[0].name
    return replace(header.read(columns), names=(name_of_run,))


def _has_channels(table: CellTable, choice: Choice) -> bool:
    """Return whether the joined table has the columns that the user chose; without a
    choice, whether its positions and torques are recognised."""
    names = list(table.kinds)
    if not choice.rename:
        return recognise(names, choice.joints, table) is not None
    try:
        chosen = expanded(choice.rename, names)
    except InputError:
        return False
    return all(set(parts_of(name, names)) <= set(names) for name in chosen.values())


def _read_part(path: Path) -> FilePart:
    """Read the numeric columns of one file of a run."""
    with reading(path):
        file_format = format_of(path) or csv
        if not hasattr(file_format, "read_columns"):
            what = "a bag cannot be joined with another file"
            raise InputError(what, "convert it first, or name it alone", path)
        table = file_format.inspect(path)
        columns = file_format.read_columns(path)
    if not columns:
        raise InputError("no column of numbers", "name another file", path)
    return FilePart(path, table, columns)


def _join(
    parts: Sequence[FilePart], is_prefixed: bool
) -> tuple[CellTable, dict[str, Array]]:
    """Join the columns of all files in the rows of one of them.

    A file with a clock and a torque gives the rows. A row without a partner in some
    other file is left out, and a remark counts them.
    With ``is_prefixed`` the columns are called "file/column".

    Returns the kinds and first cells of the joined columns (for the recogniser), and
    the columns (N,) or (N, n) by name.
    """
    base = _part_of_rows(parts, is_prefixed)
    interpolations, is_matched = _interpolations(base, parts)
    kept = np.flatnonzero(is_matched)
    columns = dict[str, Array]()
    kinds = dict[str, str]()
    cells = dict[str, Sequence[str]]()
    # The clock of the base file becomes the clock of the run.
    for name in base.clock_columns:
        is_unnamed = name == "#1"
        joined_name = "t" if is_unnamed else name
        columns[joined_name] = base.columns[name][is_matched]
        kinds[joined_name] = "number" if is_unnamed else base.table.kinds[name]
        cells[joined_name] = () if is_unnamed else base.table.cells.get(name, ())
    # Then come the channels of all files, in the rows that every file has.
    for part, found in zip(parts, interpolations, strict=True):
        for name, joined_name in part.channels(is_prefixed).items():
            values = part.columns[name]
            columns[joined_name] = (
                values[kept] if found is None else found.values(values, kept)
            )
            kinds[joined_name] = part.table.kinds[name]
            cells[joined_name] = part.table.cells.get(name, ())
    n_lost = [int(np.sum(~is_matched))]
    n_lost += [
        int(np.sum(~Interpolation(x.other, x.clock, x.within).is_known))
        for x in interpolations
        if x is not None
    ]
    _warn_of_joining(base.path, max(n_lost), kept, interpolations)
    return CellTable(kinds, cells), columns


def _part_of_rows(parts: Sequence[FilePart], is_prefixed: bool) -> FilePart:
    """Return the file whose rows the run has: one with a clock, and with a torque where
    names say so."""

    def preference(part: FilePart) -> tuple[bool, bool]:
        """Sort key; the first of the largest wins."""
        names = part.channels(is_prefixed).values()
        readings = [reading for name in names if (reading := read_name(name))]
        has_torque = any(reading.quantity == "tau" for reading in readings)
        has_clock = bool(part.clock_columns)
        return has_clock, has_clock and (has_torque or _quantity_of(part.path) == "tau")

    return max(parts, key=preference)


def _warn_of_joining(
    path: Path,
    n_lost: int,
    kept: NDArray[np.intp],
    interpolations: Sequence[Interpolation | None],
) -> None:
    """Warn of ``n_lost`` rows of a file that have no partner in another one, and of
    channels that were interpolated to the ``kept`` rows."""
    reasons = []
    if n_lost:
        lost = formatting.count(n_lost, "row")
        reasons.append(f"{lost} without a partner in the other files left out")
    distances = [x.distances[kept] for x in interpolations if x is not None]
    reasons.append(interpolation_remark(distances))
    text = "; ".join(filter(None, reasons))
    if text:
        warnings.warn(f"{path}: {text}", Remark, stacklevel=5)


def _interpolations(
    base: FilePart, parts: Sequence[FilePart]
) -> tuple[list[Interpolation | None], NDArray[np.bool_]]:
    """Find how every file's channels come to the N rows of the base file.

    Files with equal clocks, or without one, are matched row by row. Others are
    interpolated to the base file's stamps.

    Returns
    -------
    interpolations : list of Interpolation or None, one a file
        None where rows belong together one by one.
    is_matched : (N,) bool
        Whether every file has samples around the row's stamp.
    """
    base_clock = base.clock
    is_matched = np.ones(base.n_rows, bool)
    out = list[Interpolation | None]()
    for part in parts:
        clock = part.clock
        if clock is None or base_clock is None or np.array_equal(clock, base_clock):
            _require_equal_rows(part, base)
            out.append(None)
            continue
        found = Interpolation(base_clock, clock, half_period(base_clock))
        out.append(found)
        is_matched &= found.is_known
    if not is_matched.any():
        what = "the stamps of these files have no instant in common"
        raise InputError(what, "name files of one recording", base.path)
    return out, is_matched


def _require_equal_rows(part: FilePart, base: FilePart) -> None:
    """Raise InputError where files without a common clock have different numbers of
    rows."""
    if part.n_rows == base.n_rows:
        return
    what = (
        f"{part.path.name} has {part.n_rows} rows, {base.path.name} has {base.n_rows},"
        " and no clock says which belong together"
    )
    remedy = "give each file a column t, or as many rows"
    raise InputError(what, remedy, part.path)
