"""runs.csv: one row a run, written as runs end, read back to go on where a shootout stopped."""

from __future__ import annotations

import csv
import io
import math
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from pathlib import Path
from typing import Any

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import as_csv, read_text, write_text

Row = dict[str, Any]

_NUMBERS = (
    "objective_error", "violation", "gap", "own_gap", "dimacs", "lower", "upper", "seconds",
    "setup_seconds", "solve_seconds",
)  # fmt: skip
_COUNTS = "iterations", "attempts"
COLUMNS = (
    "problem", "group", "hash", "solver", "settings", "accuracy", "claimed", "status", "class",
    *_NUMBERS, *_COUNTS, "version", "machine", "seed", "remark",
)  # fmt: skip
#: Bounds of an interval lose digits outward only: what was proved stays true of what is written.
_OUTWARD = dict.fromkeys(("upper", "gap", "violation"), ROUND_CEILING) | {"lower": ROUND_FLOOR}


def key(row: Row) -> tuple[str, str, str, str]:
    """What makes a run the same run: problem (and its hash), solver, settings."""
    return row["problem"], row["hash"], row["solver"], row["settings"]


class Results:
    """The runs of one output folder: runs.csv is written anew, whole or not at all, after each.

    Raises InputError where the folder holds other results.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / "runs.csv"
        self.rows: list[Row] = []
        if self.path.exists():
            self._read()
        elif folder.is_dir() and any(
            not p.name.startswith((".", "references.json")) for p in folder.iterdir()
        ):
            raise InputError(
                "holds other files and no runs.csv", "give --out an empty or a new folder", folder
            )
        else:
            self._write()

    def _read(self) -> None:
        head, *lines = [*csv.reader(io.StringIO(read_text(self.path, own=True)))] or [[]]
        if head != list(COLUMNS):
            raise InputError(
                f"holds the results of something else (its columns are {','.join(head)[:60]}...)",
                "give --out another folder",
                self.path,
            )
        for number, cells in enumerate(lines, start=2):
            if len(cells) != len(COLUMNS):
                raise InputError(
                    f"row {number} has {len(cells)} cells instead of {len(COLUMNS)}",
                    "delete that row, and the run is done again",
                    self.path,
                )
            self.rows.append(parsed(dict(zip(COLUMNS, cells, strict=True))))

    def add(self, row: Row) -> None:
        """One more run; it is on the disk when this returns."""
        self.rows.append(parsed(row))
        self._write()

    def keep(self, current: dict[str, str]) -> int:
        """Drop runs of instances whose hash (by problem name) has changed; returns how many."""
        before = len(self.rows)
        self.rows = [r for r in self.rows if current.get(r["problem"], r["hash"]) == r["hash"]]
        self._write()
        return before - len(self.rows)

    def _write(self) -> None:
        order = sorted(self.rows, key=lambda r: (r["group"], r["problem"], r["solver"], -r["accuracy"]))
        write_text(self.path, table_text(COLUMNS, order))

    @property
    def keys(self) -> set[tuple[str, str, str, str]]:
        return {key(row) for row in self.rows}


def table_text(columns: tuple[str, ...], rows: list[Row]) -> str:
    """Rows as CSV text."""
    return as_csv(columns, ([cell(r.get(c, ""), _OUTWARD.get(c)) for c in columns] for r in rows))


def cell(value: Any, rounding: str | None = None) -> str:
    """Numbers to six digits, above 1e-3 to ten; line breaks have no place in a row.

    rounding : one of decimal's, for a number that may err to one side only: to ten digits.
    """
    if not isinstance(value, float):
        return " ".join(str(value).split())
    if rounding is not None and math.isfinite(value) and value != 0.0:
        return format(Context(prec=10, rounding=rounding).create_decimal(repr(value)).normalize(), "g")
    return f"{value:.10g}" if 1e-3 <= abs(value) < 1e6 else f"{value:.6g}"


def parsed(row: Row) -> Row:
    """The row with its numbers as numbers; an empty cell is infinite."""
    out = {c: row.get(c, "") for c in COLUMNS}
    out |= {c: float("inf" if out[c] in ("", None) else out[c]) for c in ("accuracy", *_NUMBERS)}
    return out | {c: int(out[c] or 0) for c in _COUNTS}
