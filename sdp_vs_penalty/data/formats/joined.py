"""One run from several files: positions in one, torques in another, joined by their
stamps or row by row."""

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.formats import FILE_SEPARATOR, format_of, open_log
from sdp_vs_penalty.data.hypotheses.recognition import find_clock, recognise
from sdp_vs_penalty.data.log import Column, Log, Values
from sdp_vs_penalty.data.words.names import is_word_for_joint, quantity_of
from sdp_vs_penalty.data.words.stamps import units_of_parts
from sdp_vs_penalty.data.words.tokens import group_of, parts_of, split_tokens
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

#: Suffixes of the files of a folder that holds one run, a file a quantity; and those of
#: a folder with a file a joint.
_SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".npy")
_TABLES = (*_SUFFIXES, ".npz", ".parquet", ".mat")


@dataclass(frozen=True)
class _Part:
    """The columns of numbers of one file of a run."""

    #: Path of the file.
    path: Path
    #: Its columns.
    columns: Mapping[str, Column]
    #: (N,) numbers or (N, n) blocks of each column.
    values: Mapping[str, Array]
    #: Names of the columns that hold its stamps: two where a stamp is split into seconds
    #: and nanoseconds; none without a clock.
    clock: tuple[str, ...]

    @property
    def n_rows(self) -> int:
        """Number of samples of this file."""
        return max(len(block) for block in self.values.values())

    @property
    def stamps(self) -> Array | None:
        """(N,) time stamps in the file's own unit; None where it has no clock."""
        pairs = zip(units_of_parts(self.clock), self.clock, strict=True)
        parts = [unit * np.ravel(self.values[name]) for unit, name in pairs]
        return np.sum(parts, axis=0) if parts else None

    def channels(self, is_prefixed: bool) -> dict[str, str]:
        """Name this file's channels (all columns but the clock) in the joined run, by
        their names in the file; prefixed by the file's name, "dataQ/1", equal column
        names of two files stay apart."""
        names = [name for name in self.columns if name not in self.clock]
        if not is_prefixed:
            return {name: name for name in names}
        stem = self.path.stem
        if names and names[0].startswith("#"):
            numbers = (
                [stem]
                if len(names) == 1
                else [f"{stem}/{k}" for k in range(1, len(names) + 1)]
            )
            return dict(zip(names, numbers, strict=True))
        return {name: f"{stem}/{name}" for name in names}


def files_of_run(path: Path) -> list[Path]:
    """List the files that one argument joins to one run: "positions.csv+torques.csv", or
    a folder with one file for each quantity, whose names say the quantity ("dataQ.txt",
    "dataCur.txt"), or with one for each joint ("joint1.csv", "joint2.csv"). Empty where
    the argument is an ordinary file or folder."""
    if path.is_dir():
        if format_of(path):
            return []
        tables = [p for p in sorted(path.iterdir()) if p.suffix.lower() in _TABLES]
        return _files_of_joints(tables) or _files_of_quantities(tables)
    names = str(path).split(FILE_SEPARATOR)
    if len(names) < 2 or path.exists() or not all(names):
        return []
    # "log/q.csv+tau.csv" means log/tau.csv where tau.csv does not exist.
    in_folder = [Path(names[0]).parent / name for name in names]
    return [
        other if not Path(name).exists() and other.exists() else Path(name)
        for name, other in zip(names, in_folder, strict=True)
    ]


def _files_of_quantities(tables: Sequence[Path]) -> list[Path]:
    """List the files whose names say a quantity; empty where they do not say positions
    and torques (or commands), or where the file of positions is a run by itself."""
    said = {x: quantity_of(x.stem) for x in tables if x.suffix.lower() in _SUFFIXES}
    if "q" not in said.values() or not {"tau", "qcmd"} & {*said.values()}:
        return []
    positions = next(file for file, quantity in said.items() if quantity == "q")
    try:
        is_run = recognise(open_log(positions).columns) is not None
    except InputError:
        is_run = True
    return [] if is_run else [file for file, quantity in said.items() if quantity]


def _files_of_joints(files: Sequence[Path]) -> list[Path]:
    """List the files of a folder that hold a joint each, in the joints' order.

    Their names are a word for a joint and its number, "joint3.csv", counted from 0 or 1
    without a gap. Empty where the folder has no such files, or where they hold several
    joints and so are runs in which one joint moves.
    """
    of_number, words_of_files = dict[int, Path](), set[tuple[str, ...]]()
    for file in files:
        tokens = split_tokens(file.stem)
        words = tuple(token for token in tokens if not token.isdigit())
        if is_word_for_joint(words) and len(tokens) == len(words) + 1:
            of_number[int(next(x for x in tokens if x.isdigit()))] = file
            words_of_files.add((*words, file.suffix.lower()))
    numbers = sorted(of_number)
    first = numbers[0] if numbers else 2
    is_whole = first < 2 and numbers == list(range(first, first + len(numbers)))
    if not is_whole or len(words_of_files) > 1 or len(numbers) < 2:
        return []
    in_order = [of_number[number] for number in numbers]
    try:
        log = open_log(in_order[0])
        found = recognise(log.columns)
    except InputError:
        return []
    pairs = {} if found is None else found.rename
    positions = [theirs for ours, theirs in pairs.items() if group_of(ours) == "q"]
    is_block = any(log.columns[x].kind == "list" for x in positions)
    return in_order if len(positions) < 2 and not is_block else []


def joined_log(path: Path, files: Sequence[Path]) -> Log:
    """Make a log of the columns of several files.

    Columns keep their names where these tell the channels apart. Otherwise the file's
    name is put before them: two files may both have a column "joint1". A file with a
    clock, and a torque where one has it, gives the rows; channels of files with other
    stamps have stamps of their own. Raises InputError for a bag, and for files of
    different lengths without clocks.
    """
    parts = [_part(file) for file in files]
    n_uses = Counter(n for part in parts for n in part.channels(is_prefixed=False))
    is_prefixed = max(n_uses.values(), default=0) > 1 or "#1" in n_uses
    if not is_prefixed:
        columns = {name: x for part in parts for name, x in part.columns.items()}
        with suppress(InputError):
            # Only the names of the files may say what their columns are.
            is_prefixed = recognise(columns) is None

    def preference(part: _Part) -> tuple[bool, bool]:
        """Sort key; the first of the largest wins."""
        names = (*part.channels(is_prefixed).values(), part.path.stem)
        return bool(part.clock), bool(part.clock) and "tau" in map(quantity_of, names)

    base = max(parts, key=preference)
    clock = {name: "t" if name == "#1" else name for name in base.clock}
    columns = {ours: base.columns[name] for name, ours in clock.items()}
    values = {ours: base.values[name] for name, ours in clock.items()}
    clocks = dict[str, Array]()
    base_stamps = base.stamps
    for part in parts:
        stamps, own = part.stamps, ""
        if stamps is None or base_stamps is None or np.array_equal(stamps, base_stamps):
            if part.n_rows != base.n_rows:
                what = (
                    f"{part.path.name} has {part.n_rows} rows, {base.path.name} has"
                    f" {base.n_rows}, and no clock says which belong together"
                )
                remedy = "give each file a column t, or as many rows"
                raise InputError(what, remedy, part.path)
        else:
            if stamps.max() < base_stamps.min() or base_stamps.max() < stamps.min():
                what = "the stamps of these files have no instant in common"
                raise InputError(what, "name files of one recording", base.path)
            own = str(part.path)
            clocks[own] = stamps
        for name, joined in part.channels(is_prefixed).items():
            columns[joined] = replace(part.columns[name], clock=own)
            values[joined] = part.values[name]

    def read(names: Sequence[str]) -> Values:
        return Values({name: values[name] for name in names})

    place = path if path.is_dir() else files[0]
    return Log(path, columns, read, clocks=clocks, run_name=place.name)


def _part(path: Path) -> _Part:
    """Read the numeric columns of one file of a run."""
    log = open_log(path)
    if log.is_of_messages:
        what = "a bag cannot be joined with another file"
        raise InputError(what, "convert it first, or name it alone", path)
    columns = {
        k: x for k, x in log.columns.items() if x.kind in ("number", "list", "stamp")
    }
    if not columns:
        raise InputError("no column of numbers", "name another file", path)
    values = log.read(list(columns)).columns
    names = list(columns)
    clock = parts_of(find_clock(columns) or "", names) if names[0] != "#1" else ()
    if names[0] == "#1":
        # Without a header the first column is the clock where its values rise evenly, or
        # where it is the only column of a file called like "time.txt".
        steps = np.diff(values["#1"])
        is_even = (
            len(steps) > 0
            and steps.min() > 0.0
            and steps.max() < 10.0 * np.median(steps)
        )
        is_clock = quantity_of(path.stem) == "t" if len(names) == 1 else bool(is_even)
        clock = ("#1",) if is_clock else ()
    return _Part(path, columns, values, () if clock == ("",) else clock)
