"""Which column of a foreign table is what, to be looked at and changed by a person: the
recogniser's answer, or what it lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sdp_vs_penalty.data.formats.csv import described
from sdp_vs_penalty.data.formats.recognition import recognise
from sdp_vs_penalty.data.formats.text_table import inspect_table
from sdp_vs_penalty.files import JsonRecord


@dataclass(frozen=True)
class ColumnMap(JsonRecord):
    """columns : of the file, in its order; ours : the names that a run needs (t, q1 ...,
    tau1 ...); chosen : the file's column for each of these, "" where none is known."""

    columns: tuple[str, ...]
    ours: tuple[str, ...]
    chosen: tuple[str, ...]


def column_map(path: Path, joints: Sequence[str]) -> ColumnMap | None:
    """What the recogniser makes of a table's columns for a robot with these joints;
    None for files that are no text table. Raises InputError for a broken one."""
    if path.suffix.lower() != ".csv":
        return None
    table = inspect_table(path)
    if not table.has_header:
        return None
    names = list(table.names)
    recognition = recognise(names, joints, described(table, names))
    rename = {} if recognition is None else recognition.rename
    numbers = range(1, len(joints) + 1)
    ours = ("t", *(f"{group}{j}" for group in ("q", "tau") for j in numbers))
    chosen = tuple(rename.get(name, name if name in names else "") for name in ours)
    known = [name if name in names else "" for name in chosen]
    return ColumnMap(columns=tuple(names), ours=ours, chosen=tuple(known))
