"""A log before anyone knows what its columns are: what every adapter makes of a file."""

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.robot.arrays import Array, Arrays, Indices, Mask

#: Rows by which a column is described.
ROWS_DESCRIBED = 50
#: Rows from which the units and the rate of a long file are judged.
ROWS_JUDGED = 100_000


@dataclass(frozen=True)
class Column:
    """One column of a log."""

    #: What its cells hold: "number", "list" (a block), "stamp", "text" or "empty".
    kind: str = "number"
    #: Its first cells that are not empty, as texts.
    cells: Sequence[str] = ()
    #: Unit that the file's metadata say; "" where they say none.
    unit: str = ""
    #: Quantity ("q", "dq", "tau") that they say, or "".
    quantity: str = ""
    #: Joint, or joints of a block, that they name.
    joints: tuple[str, ...] = ()
    #: Name among the log's clocks of its own stamps; "" where it has a value in every
    #: row.
    clock: str = ""
    #: What of the file it comes from: a topic of messages; "" where that says nothing.
    source: str = ""

    @property
    def head(self) -> Array:
        """(K,) numbers in the first cells; those of lists in one row."""
        number = r"[-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?"
        return np.array(re.findall(number, " ".join(self.cells)), float)

    @property
    def width(self) -> int:
        """Numbers in a row: those of a block, 1 of another column."""
        return len(self.head) // max(len(self.cells), 1) if self.kind == "list" else 1


@dataclass(frozen=True)
class Values:
    """Values of some columns of a log."""

    #: (N,) numbers or (N, n) blocks, by name; seconds of stamps.
    columns: dict[str, Array]
    #: (N,) number in the file of each row; None where row k is number k + 2.
    rows: Indices | None = None
    #: (N,) whether the cell is empty, of columns with empty cells.
    gaps: Mapping[str, Mask] = field(default_factory=dict)


@dataclass(frozen=True)
class Log:
    """The named columns of a file, and how to read them."""

    #: Path of the file, for messages and commands.
    path: Path
    #: Columns by name, in the file's order; "#1", "#2" ... where it has no names.
    columns: Mapping[str, Column]
    #: Reads the values of some columns.
    read: Callable[[Sequence[str]], Values]
    #: Reads the texts of some columns: a list of cells a row.
    texts: Callable[[Sequence[str]], Sequence[Sequence[str]]] | None = None
    #: (M,) stamps by the name of a clock, in the unit of the log's own [s].
    clocks: Arrays = field(default_factory=dict)
    #: Sampling rate that the file's header says [Hz]; None where it says none.
    rate: float | None = None
    #: Lines above a table's names: comments and titles.
    heading: Sequence[str] = ()
    #: What messages call a sample.
    word: str = "sample"
    #: What to do about missing columns of what is no file; "" for a file.
    remedy: str = ""
    #: Name of the run; "" for that of the file.
    run_name: str = ""
    #: Whether each column says its quantity, joint and clock, as those of messages do.
    is_of_messages: bool = False
    #: Names that two columns or more have.
    twice: frozenset[str] = frozenset()

    @property
    def names(self) -> list[str]:
        """Names of the columns in order."""
        return list(self.columns)

    def remark(self, text: str) -> None:
        """Remark on the file, behind its path: a warning that the command line prints."""
        warnings.warn(f"{self.path}: {text}", Remark, stacklevel=3)

    def with_columns_of(self, block: str) -> "Log":
        """Return the log with a column for each of a block's, "NAME_1", in its place."""
        described = self.columns[block]
        cells = np.reshape(described.head, (-1, described.width)).T
        parts = {
            f"{block}_{k}": replace(described, kind="number", cells=cells_of_rows(x))
            for k, x in enumerate(cells, 1)
        }
        columns = dict[str, Column]()
        for name, column in self.columns.items():
            columns |= parts if name == block else {name: column}

        def read(names: Sequence[str]) -> Values:
            whole = [block] if {*names} & {*parts} else []
            found = self.read([x for x in names if x not in parts] + whole)
            values, gaps = {**found.columns}, {**found.gaps}
            if whole:
                array, gap = values.pop(block), gaps.pop(block, None)
                upright = array if array.shape[0] >= array.shape[1] else array.T
                of_parts = dict(zip(parts, upright.T, strict=True))
                values |= {x: y for x, y in of_parts.items() if x in names}
                gaps |= {} if gap is None else {x: gap for x in of_parts if x in names}
            return replace(found, columns=values, gaps=gaps)

        return replace(self, columns=columns, read=read)


def cells_of_rows(rows: Array) -> list[str]:
    """Format rows (K, ...) of numbers as the cells of a :class:`Column`."""
    return [" ".join(f"{x:.15g}" for x in np.ravel(row)) for row in rows]


def log_of_arrays(
    path: Path,
    arrays: Arrays,
    texts: Mapping[str, Sequence[Sequence[str]]] | None = None,
    facts: Mapping[str, Mapping[str, Any]] | None = None,
    rows: Indices | None = None,
    *,
    has_gaps: bool = False,
    **more: Any,
) -> Log:
    """Make a log of arrays in memory.

    Parameters
    ----------
    arrays : mapping of str to array
        (N,) columns, or (N, n) and (n, N) blocks, by name.
    texts : mapping of str to sequence
        Texts of each row by the name of a column of texts. Times become seconds.
    facts : mapping of str to mapping
        Fields of :class:`Column` that the file says, by the column's name.
    rows : (N,) array of int, optional
        Number in the file of each row.
    has_gaps : bool
        Whether NaN stands for an empty cell.
    more : dict
        Further fields of the log.
    """
    from sdp_vs_penalty.data.words.names import rate_of_heading

    texts, columns = texts or {}, dict[str, Column]()
    arrays = _one_after_the_other(arrays)
    arrays, clock_of, clocks = _clocks_apart(arrays)
    # Few numbers beside columns, such as a period Ts or gears' ratios, say what lines
    # above a table do.
    count = max((len(x) for x in arrays.values()), default=0)
    heading = [
        f"{re.split('[/.]', name)[-1]}: {' '.join(f'{y:.12g}' for y in np.ravel(x))}"
        for name, x in arrays.items()
        if x.size < min(ROWS_DESCRIBED, count)
    ]
    has_columns = bool(texts) or any(x.size > 1 for x in arrays.values())
    arrays = {x: y for x, y in arrays.items() if y.size != 1 or not has_columns}
    for name, cells in texts.items():
        first = [str(row if len(row) > 1 else row[0]) for row in cells[:1] if row]
        columns[name] = Column("text", first)
        stamps = seconds_of_rows(cells)
        if stamps is not None:
            arrays[name] = stamps
    for name, array in arrays.items():
        is_block = array.ndim > 1 and min(array.shape) > 1
        # A block (n, N) lies on its side: a run has more rows than channels.
        is_upright = array.ndim < 2 or array.shape[0] >= array.shape[1]
        head = (array if is_upright else array.T)[:ROWS_DESCRIBED]
        kind = "stamp" if name in texts else "list" if is_block else "number"
        columns[name] = Column(kind, cells_of_rows(head))
    columns |= {x: replace(columns[x], clock=y) for x, y in clock_of.items()}
    for name, stated in (facts or {}).items():
        if name in columns:
            columns[name] = Column(**{**vars(columns[name]), **stated})

    def rows_of_texts(names: Sequence[str]) -> list[list[str]]:
        cells = [
            texts[n] if n in texts else [[f"{x:.12g}"] for x in np.ravel(arrays[n])]
            for n in names
        ]
        # A cell may hold several texts; a row has those of all its cells.
        return [
            [text for cell in row for text in cell] for row in zip(*cells, strict=True)
        ]

    def read(names: Sequence[str]) -> Values:
        chosen = {name: arrays[name] for name in names}
        missing = {
            name: np.asarray(np.isnan(x).any(axis=tuple(range(1, x.ndim))))
            for name, x in (chosen.items() if has_gaps else ())
            if x.ndim < 2 or x.shape[0] >= x.shape[1]
        }
        return Values(chosen, rows, {x: gap for x, gap in missing.items() if gap.any()})

    more = {"heading": heading, "rate": rate_of_heading(heading), **more}
    more |= {"clocks": clocks} if clocks else {}
    return Log(path, columns, read, rows_of_texts, **more)


#: A word and the number behind it in a path, "demo_0/", "episodes/3/" and "runs[1].".
_NUMBERED = re.compile(r"([^\W\d_]+)[ _/\[(-]*([0-9]+)[\])]*(?=[/._-])")


def _one_after_the_other(arrays: Arrays) -> Arrays:
    """Return the arrays of several runs, "demo_0/q" and "demo_1/q", one after the other,
    with a column that counts the runs; arrays of one run as they are."""
    from sdp_vs_penalty.data.words.names import counts_runs

    runs = dict[str, dict[int, dict[str, Array]]]()
    for name, array in arrays.items():
        for match in _NUMBERED.finditer(name):
            if counts_runs(match[1]):
                of_number = runs.setdefault(name[: match.start(2)], {})
                inner = name[match.end() + 1 :]
                of_number.setdefault(int(match[2]), {})[inner] = array
    several = max(runs.values(), key=len, default={})
    if len(several) < 2:
        return arrays
    parts = [several[number] for number in sorted(several)]
    together = dict[str, list[Array]]()
    counts = [max(max(x.shape) for x in part.values()) for part in parts]
    for name in set.intersection(*map(set, parts)):
        blocks = [
            x if len(x) == count else x.T
            for x, count in zip((part[name] for part in parts), counts, strict=True)
        ]
        lengths = [*map(len, blocks)]
        if lengths == counts and len({x.shape[1:] for x in blocks}) == 1:
            together[name] = blocks
    out = {x: np.concatenate(together[x]) for x in parts[0] if x in together}
    return {**out, "episode_index": np.repeat(np.arange(float(len(parts))), counts)}


def _clocks_apart(arrays: Arrays) -> tuple[Arrays, dict[str, str], dict[str, Array]]:
    """Take the clocks of groups that differ, "position/time" and "torque/time", from among
    the arrays. Returns the others, with a torque's clock under its own name, "time"; the
    clock, called by its group, of each array; and the clocks."""
    from sdp_vs_penalty.data.words.names import quantity_of

    group_of = {x: re.split(r"[/.](?=[^/.]*$)", x)[0] for x in arrays}
    of_groups = dict[str, str]()
    for name, group in group_of.items():
        leaf = name[len(group) + 1 :]
        if leaf and arrays[name].ndim < 2 and quantity_of(leaf) == "t":
            of_groups.setdefault(group, name)
    clocks = {group: np.ravel(arrays[x]) for group, x in of_groups.items()}
    several = [*clocks.values()]
    clock_of = {
        name: group
        for name, group in group_of.items()
        if group in clocks and name not in of_groups.values()
    }
    is_whole = all(
        max(arrays[name].shape) == len(clocks[clock_of[name]])
        if name in clock_of
        else name in of_groups.values() or len(arrays[name]) < ROWS_DESCRIBED
        for name in arrays
    )
    if not is_whole or all(np.array_equal(x, several[0]) for x in several):
        return arrays, {}, {}
    of_torque = (y for x, y in clock_of.items() if quantity_of(x) == "tau")
    leading = next(of_torque, next(iter(clocks)))
    leaf = of_groups[leading][len(leading) + 1 :]
    others = {x: y for x, y in arrays.items() if x not in of_groups.values()}
    return {leaf: clocks[leading], **others}, clock_of, clocks


#: How an empty cell of a column of texts is written.
_EMPTY = {"", "nan", "NaN", "NaT", "None", "<NA>"}


def seconds_of_rows(rows: Sequence[Sequence[str]]) -> Array | None:
    """Convert one text a row to seconds (N,) [s], NaN where a cell is empty; None where one
    is no time."""
    from sdp_vs_penalty.data.words.stamps import is_stamp, past_midnight, seconds_of

    cells = [row[0] for row in rows if len(row) == 1]
    filled = np.array([x not in _EMPTY for x in cells], bool)
    stamps = [x for x in cells if x not in _EMPTY]
    if not stamps or len(cells) < len(rows) or not all(map(is_stamp, stamps)):
        return None
    seconds = np.full(len(cells), np.nan)
    seconds[filled] = past_midnight(seconds_of(stamps))
    return seconds


def real_numbers(path: Path, name: str, array: Any) -> Array:
    """Convert an array of a file, of any type and shape, to floating-point numbers, at
    least (1,); raise InputError where it holds anything but real numbers."""
    if array.dtype.kind not in "fiu":
        what = f"array {name} holds {array.dtype}, not real numbers"
        raise InputError(what, "save it as floating-point numbers", path)
    with np.errstate(over="ignore"):  # a longer number becomes infinite: refused later
        return np.atleast_1d(np.asarray(array, float))
