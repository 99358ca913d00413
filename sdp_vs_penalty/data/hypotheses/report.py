"""What a file's columns are taken for, as a table that a user can read and correct."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from sdp_vs_penalty.data.columns import Choice, channels_of, our_columns
from sdp_vs_penalty.data.formats import open_log
from sdp_vs_penalty.data.hypotheses.channels import has_our_names
from sdp_vs_penalty.data.hypotheses.recognition import find_clock
from sdp_vs_penalty.data.hypotheses.renaming import expanded
from sdp_vs_penalty.data.reading import run_and_reading, sentence_and_command
from sdp_vs_penalty.data.words.tokens import group_of, parts_of
from sdp_vs_penalty.data.words.units import unit_of_factor
from sdp_vs_penalty.errors import InputError

_N_CELLS = 5


@dataclass(frozen=True)
class ColumnRow:
    """One column of a file, and what it is taken for."""

    #: The column's name in the file.
    name: str
    #: Our name (t, q1, tau ...), "" where the column is not used.
    meaning: str
    #: "number", "list" (one value a joint), "stamp", "text" or "empty".
    kind: str
    #: Unit, such as "deg", or factor to SI; "" where it is 1.
    unit: str
    #: The column's first five cells as the file writes them.
    first_cells: tuple[str, ...]


@dataclass(frozen=True)
class ColumnReport:
    """What the columns of one file are taken for."""

    #: Path of the file.
    path: Path
    #: One report a column, in the file's order.
    rows: tuple[ColumnRow, ...]
    #: What was taken for what, in which unit and why, and the command that reads the file
    #: alike; "" where nothing was guessed.
    sentence: str = ""
    #: Those of t, q and tau for which the file has no column.
    missing: tuple[str, ...] = ()
    #: Why no columns could be chosen; "" where they were.
    problem: str = ""

    @property
    def rename(self) -> dict[str, str]:
        """The file's names by ours, as ``convert --rename`` takes them; "sec+nanosec"
        for a stamp in two columns."""
        pairs = dict[str, str]()
        for row in self.rows:
            if row.meaning:
                before = f"{pairs[row.meaning]}+" if row.meaning in pairs else ""
                pairs[row.meaning] = before + row.name
        return pairs


def describe_columns(
    path: str | Path,
    joints: Sequence[str] | None = None,
    rename: Mapping[str, str] | None = None,
) -> ColumnReport | None:
    """Describe what each column of a file is taken for when it is read, or, where it is
    refused, as far as names tell.

    Parameters
    ----------
    path : str or Path
        Path of a text table, .npz, .mat or .parquet file.
    joints : sequence of str, optional
        Names of the robot's joints in order.
    rename : mapping of str to str, optional
        The file's names by ours, in place of a guess.

    Returns
    -------
    ColumnReport or None
        None for a bag, whose messages name their joints and fields.

    Raises
    ------
    InputError
        A file that cannot be read, or a name in ``rename`` that it does not have.
    """
    log = open_log(Path(path))
    if log.is_of_messages:
        return None
    problem, sentence, found = "", "", None
    choice = Choice(joints, rename=rename)
    try:
        with warnings.catch_warnings(action="ignore"):
            log, _, found = run_and_reading(log, choice)
    except InputError:
        try:
            is_open = not rename and not has_our_names(log.names)
            log, found = channels_of(log, choice) if is_open else (log, None)
        except InputError as error:
            problem = str(error)
    if found is not None:
        pairs, scale = found.rename, found.scale
        problem = str(found.unless_confirmed or "")
        sentence = "" if problem else sentence_and_command(log, found, choice)[1]
    else:
        pairs, scale = our_columns(log.names) | expanded(rename or {}, log.names), {}
        clock = None if "t" in pairs else find_clock(log.names)
        pairs = {"t": clock, **pairs} if clock and pairs else pairs
    meanings = {
        x: ours for ours, name in pairs.items() for x in parts_of(name, log.names)
    }
    rows = list[ColumnRow]()
    for name, column in log.columns.items():
        meaning = meanings.get(name, "")
        factor = scale.get(meaning, 1.0)
        group = group_of(meaning)
        said = found.units[group].answer if found and group in found.units else ""
        unit = unit_of_factor(factor, group, said) or f"{factor:.6g}"
        unit = unit if factor != 1.0 else ""
        cells = tuple(column.cells[:_N_CELLS])
        rows.append(ColumnRow(name, meaning, column.kind, unit, cells))
    groups = {*map(group_of, pairs)}
    needed = ("t", "q") if "qcmd" in groups else ("t", "q", "tau")
    missing = tuple(group for group in needed if group not in groups)
    return ColumnReport(log.path, tuple(rows), sentence, missing, problem)
