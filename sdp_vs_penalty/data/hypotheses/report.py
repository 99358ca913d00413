"""What a file's columns are taken for, as a table that a user can read and correct."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.formats import open_log
from sdp_vs_penalty.data.hypotheses.channels import has_our_names
from sdp_vs_penalty.data.hypotheses.recognition import find_clock
from sdp_vs_penalty.data.hypotheses.renaming import expanded
from sdp_vs_penalty.data.hypotheses.weighing import CLOCK, unit_of_angles, unit_of_clock
from sdp_vs_penalty.data.reading import (
    GROUPS,
    reading_sentence,
    recognised_in,
    repeating_command,
)
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
            if row.meaning:
                before = f"{pairs[row.meaning]}+" if row.meaning in pairs else ""
                pairs[row.meaning] = before + row.name
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
    log = open_log(Path(path))
    if log.is_of_messages:
        return None
    problem, found = "", None
    if not rename and not has_our_names(log.names):
        try:
            found = recognised_in(log, joints)
        except InputError as error:
            problem = str(error)
    pairs = {} if found is None else found.rename
    for group, kind in (found.inferred if found else {}).items():
        columns = [x for ours, x in pairs.items() if group_of(ours) == group]
        head = np.concatenate(
            [log.columns[x].head for x in columns if x in log.columns]
        )
        is_clock = kind == CLOCK
        shown = unit_of_clock(head) if is_clock else unit_of_angles(head, kind)
        found = found.with_unit(group, shown) if found else None
    if found is None:
        ours = {x: x for x in log.names if group_of(x) in ("t", *GROUPS)}
        pairs = {**ours, **expanded(rename or {}, log.names)}
        clock = None if "t" in pairs else find_clock(log.names)
        pairs = {"t": clock, **pairs} if clock and pairs else pairs
    meanings = {
        x: ours for ours, name in pairs.items() for x in parts_of(name, log.names)
    }
    scale = {} if found is None else found.scale
    rows = list[ColumnRow]()
    for name, column in log.columns.items():
        meaning = meanings.get(name, "")
        factor = scale.get(meaning, 1.0)
        unit = unit_of_factor(factor, group_of(meaning)) or f"{factor:.6g}"
        cells = tuple(column.cells[:_N_CELLS])
        rows.append(
            ColumnRow(
                name, meaning, column.kind, factor, unit if factor != 1.0 else "", cells
            )
        )
    groups = {*map(group_of, pairs)}
    needed = ("t", "q") if "qcmd" in groups else ("t", "q", "tau")
    missing = tuple(group for group in needed if group not in groups)
    report = ColumnReport(log.path, tuple(rows), missing=missing, problem=problem)
    if found is None or found.is_identity:
        return report if found is None else replace(report, joints=found.joints)
    command = repeating_command(log, found)
    return replace(
        report,
        joints=found.joints,
        logger=found.logger,
        sentence=f"{log.path}: {reading_sentence(log, found)}; the same by `{command}`",
        command=command,
    )
