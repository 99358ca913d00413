"""What a file's columns are taken for, as a table that a user can read and correct."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sdp_vs_penalty.data.formats import csv, format_of
from sdp_vs_penalty.data.formats.columns import recognise_file
from sdp_vs_penalty.data.formats.recognition import CellTable, Recognition, find_clock
from sdp_vs_penalty.data.formats.renaming import expanded, group_of, parts_of
from sdp_vs_penalty.data.formats.units import unit_of_factor
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import reading

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
    #: Factor to SI.
    factor: float
    #: Unit that has this factor, such as "deg"; "" where it is 1.
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
    #: What writes such files, in words; "" where names are ours or unknown.
    logger: str = ""
    #: What was taken for what, in which unit and why; "" where nothing was guessed.
    sentence: str = ""
    #: The `convert` command that reads the file alike; "" where nothing was guessed.
    command: str = ""
    #: Names of the joints, where the file says them.
    joints: tuple[str, ...] = ()
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
            if row.meaning and row.meaning in pairs:
                pairs[row.meaning] += f"+{row.name}"
            elif row.meaning:
                pairs[row.meaning] = row.name
        return pairs


def describe_columns(
    path: str | Path,
    joints: Sequence[str] | None = None,
    rename: Mapping[str, str] | None = None,
) -> ColumnReport | None:
    """Describe what each column of a file is taken for: the recogniser's guess, or the
    user's choice.

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
    with reading(path) as place:
        file_format = format_of(place) or csv
        if not hasattr(file_format, "inspect"):
            return None
        table: CellTable = file_format.inspect(place)
    names = list(table.kinds)
    problem = ""
    recognition = None
    if not rename:
        try:
            recognition = recognise_file(place, names, joints, table)
        except InputError as error:
            problem = str(error)
    pairs = _pairs(names, rename, recognition)
    scale = recognition.scale if recognition else {}
    meanings = {
        their_name: our_name
        for our_name, name in pairs.items()
        for their_name in parts_of(name, names)
    }
    rows = [_row(name, meanings.get(name, ""), table, scale) for name in names]
    report = ColumnReport(place, tuple(rows), missing=_missing(pairs), problem=problem)
    if recognition is None:
        return report
    if recognition.is_identity:
        return replace(report, joints=recognition.joints)
    return replace(
        report,
        joints=recognition.joints,
        logger=recognition.logger,
        sentence=recognition.sentence(place, names),
        command=recognition.command(place, names),
    )


def _pairs(
    names: Sequence[str],
    rename: Mapping[str, str] | None,
    recognition: Recognition | None,
) -> dict[str, str]:
    """Return the file's names by ours: recognised, chosen by the user, or equal to
    ours."""
    if recognition is not None:
        return recognition.rename
    groups = ("t", "q", "dq", "tau", "temp", "qcmd")
    our_names = {name: name for name in names if group_of(name) in groups}
    pairs = {**our_names, **expanded(rename or {}, names)}
    clock = None if "t" in pairs else find_clock(names)
    return pairs if clock is None or not pairs else {"t": clock, **pairs}


def _row(
    name: str, meaning: str, table: CellTable, scale: Mapping[str, float]
) -> ColumnRow:
    """Make the table row of one column; ``meaning`` is our name for it, "" where it is
    not used."""
    factor = scale.get(meaning, 1.0) if meaning else 1.0
    unit = ""
    if factor != 1.0:
        unit = unit_of_factor(factor, group_of(meaning)) or f"{factor:.6g}"
    cells = tuple(table.cells.get(name, ())[:_N_CELLS])
    return ColumnRow(name, meaning, table.kinds[name], factor, unit, cells)


def _missing(pairs: Mapping[str, str]) -> tuple[str, ...]:
    """List the channel groups (t, q, tau) that a run needs and the columns do not have.

    Commanded positions (qcmd) stand in for torques.
    """
    groups = {group_of(name) for name in pairs}
    needed = ("t", "q") if "qcmd" in groups else ("t", "q", "tau")
    return tuple(group for group in needed if group not in groups)
