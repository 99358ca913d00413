"""One run from several files: positions in one, torques in another, joined by their
stamps or row by row."""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.formats import FILE_SEPARATOR, format_of, open_log
from sdp_vs_penalty.data.hypotheses.orders import rises
from sdp_vs_penalty.data.hypotheses.recognition import find_clock, recognise
from sdp_vs_penalty.data.log import Column, Log, Values
from sdp_vs_penalty.data.words.joints import match_joints
from sdp_vs_penalty.data.words.names import is_word_for_joint, quantity_of, read_name
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
    #: Its columns but the clock, and (N,) numbers or (N, n) blocks of each.
    columns: dict[str, tuple[Column, Array]]
    #: Those of its clock: two where a stamp is split; none without a clock.
    clock: dict[str, tuple[Column, Array]]

    @property
    def n_rows(self) -> int:
        """Number of samples of this file."""
        return max(len(x) for _, x in (self.columns | self.clock).values())

    @property
    def stamps(self) -> Array | None:
        """(N,) time stamps in the file's own unit; None where it has no clock."""
        pairs = zip(units_of_parts(list(self.clock)), self.clock.values(), strict=True)
        parts = [unit * np.ravel(values) for unit, (_, values) in pairs]
        return np.sum(parts, axis=0) if parts else None

    def of_file(self) -> dict[str, tuple[Column, Array]]:
        """Return the columns by names with the file's before them, "dataQ/1": equal
        names of two files stay apart."""
        stem, columns = self.path.stem, self.columns
        if not next(iter(columns), "").startswith("#"):
            return {f"{stem}/{name}": x for name, x in columns.items()}
        is_alone = len(columns) == 1
        numbered = enumerate(columns.values(), start=1)
        return {stem if is_alone else f"{stem}/{k}": x for k, x in numbered}


def files_of_run(path: Path, joints: Sequence[str] = ()) -> list[Path]:
    """List the files that one argument joins to one run: "positions.csv+torques.csv", or
    a folder with one file for each quantity, whose names say the quantity ("dataQ.txt",
    "dataCur.txt"), or with one for each joint ("joint1.csv", "joint2.csv"), perhaps called
    by the robot's ``joints``. Empty where the argument is an ordinary file or folder."""
    if path.is_dir():
        if format_of(path):
            return []
        tables = [p for p in sorted(path.iterdir()) if p.suffix.lower() in _TABLES]
        of_joints = files_called_by(joints, tables) or _files_of_joints(tables)
        return of_joints or _files_of_quantities(tables)
    names = str(path).split(FILE_SEPARATOR)
    if len(names) < 2 or path.exists() or not all(names):
        return []
    # "log/q.csv+tau.csv" means log/tau.csv where tau.csv does not exist.
    in_folder = [Path(names[0]).parent / name for name in names]
    return [
        other if not Path(name).exists() and other.exists() else Path(name)
        for name, other in zip(names, in_folder, strict=True)
    ]


def _positions_of_run(file: Path) -> list[Column] | None:
    """Return the columns of positions of a file that is a run by itself; None where it is
    none, or cannot be read."""
    with suppress(InputError):
        columns = open_log(file).columns
        if found := recognise(columns):
            pairs = found.rename.items()
            return [columns[y] for x, y in pairs if group_of(x) == "q"]
    return None


def _files_of_quantities(tables: Sequence[Path]) -> list[Path]:
    """List the files whose names say a quantity, those with the same other words where
    these are enough; empty where they do not say positions and torques (or commands), or
    where the file of positions is a run by itself."""
    said = {x: read_name(x.stem) for x in tables if x.suffix.lower() in _SUFFIXES}
    meanings = {file: meaning for file, meaning in said.items() if meaning}
    for words in (*dict.fromkeys(x.other_words for x in meanings.values()), None):
        quantities = {
            file: meaning.quantity
            for file, meaning in meanings.items()
            if words in (None, meaning.other_words)
        }
        if "q" in quantities.values() and {"tau", "qcmd"} & {*quantities.values()}:
            positions = next(file for file, x in quantities.items() if x == "q")
            return [] if _positions_of_run(positions) is not None else [*quantities]
    return []


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
    return _of_one_joint([of_number[number] for number in numbers])


def files_called_by(joints: Sequence[str], files: Sequence[Path]) -> list[Path]:
    """List the files that are called by a robot's joints, in their order; empty where not
    each of two or more joints has one, or where they hold several joints."""
    by_stem = {file.stem: file for file in files}
    found = match_joints(joints, list(by_stem))
    is_whole = 1 < len(joints) == len(found)
    return _of_one_joint([by_stem[found[x]] for x in joints]) if is_whole else []


def _of_one_joint(files: list[Path]) -> list[Path]:
    """Return files called by joints; empty where the first is no run of one joint."""
    positions = _positions_of_run(files[0])
    is_of_joint = positions is not None and len(positions) < 2
    is_of_joint &= all(x.kind != "list" for x in positions or ())
    return files if is_of_joint else []


def joined_log(path: Path, files: Sequence[Path]) -> Log:
    """Make a log of the columns of several files.

    Columns keep their names where these tell the channels apart. Otherwise the file's
    name is put before them: two files may both have a column "joint1". A file with a
    clock, and a torque where one has it, gives the rows; channels of files with other
    stamps have stamps of their own. Raises InputError for a bag, and for files of
    different lengths without clocks.
    """
    parts = [_part(file) for file in files]
    n_uses = Counter(name for part in parts for name in part.columns)
    named = [part.columns for part in parts]
    is_clear = max(n_uses.values(), default=0) < 2 and "#1" not in n_uses
    if is_clear:
        together = {
            x: y for part in parts for x, y in (part.clock | part.columns).items()
        }
        with suppress(InputError):
            # Only the names of the files may say what their columns are.
            is_clear = recognise({x: y for x, (y, _) in together.items()}) is not None
    if not is_clear:
        named = [part.of_file() for part in parts]

    def preference(k: int) -> tuple[bool, bool]:
        """Return the sort key; the first of the largest wins."""
        has_torque = "tau" in map(quantity_of, (*named[k], parts[k].path.stem))
        return bool(parts[k].clock), bool(parts[k].clock) and has_torque

    base = parts[max(range(len(parts)), key=preference)]
    columns = {"t" if x == "#1" else x: y for x, y in base.clock.items()}
    clocks = dict[str, Array]()
    base_stamps = base.stamps
    for part, channels in zip(parts, named, strict=True):
        stamps, own = part.stamps, ""
        n_joints, rest = divmod(part.n_rows, base.n_rows)
        if stamps is None and len(channels) == 1 and not rest and n_joints > 1:
            # One number a line: those of all joints of a sample, then of the next one.
            channels = {
                name: (replace(column, kind="list"), values.reshape(-1, n_joints))
                for name, (column, values) in channels.items()
            }
        elif (
            stamps is None or base_stamps is None or np.array_equal(stamps, base_stamps)
        ):
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
        for name, (column, values) in channels.items():
            columns[name] = replace(column, clock=own), values

    def read(names: Sequence[str]) -> Values:
        return Values({name: columns[name][1] for name in names})

    place = path if path.is_dir() else files[0]
    described = {name: column for name, (column, _) in columns.items()}
    return Log(path, described, read, clocks=clocks, run_name=place.name)


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
    clock = find_clock(columns) or ""
    if names[0] == "#1":
        # Without a header the first column is the clock where its values rise, or where
        # it is the only column of a file called like "time.txt".
        is_alone = len(names) == 1
        is_clock = quantity_of(path.stem) == "t" if is_alone else rises(values["#1"])
        clock = "#1" if is_clock else ""
    of_clock = parts_of(clock, names) if clock else ()
    pairs = {name: (columns[name], values[name]) for name in names}
    return _Part(
        path,
        {x: y for x, y in pairs.items() if x not in of_clock},
        {x: pairs[x] for x in of_clock},
    )
