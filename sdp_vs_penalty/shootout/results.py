"""runs.csv: one row a run, written as runs end, read back to go on where a shootout stopped."""

import io
from pathlib import Path
from typing import Any

import pandas

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import read_text, write_text

Row = dict[str, Any]
#: Every column, and what its cells are. Numbers have all their digits: what was proved is written.
COLUMNS: dict[str, type] = (
    dict.fromkeys(("problem", "group", "hash", "solver", "settings"), str)
    | {"accuracy": float}
    | dict.fromkeys(("claimed", "status", "class"), str)
    | dict.fromkeys(("objective_error", "violation", "own_gap", "dimacs", "lower", "upper"), float)
    | {"seconds": float, "iterations": int, "attempts": int}
    | dict.fromkeys(("version", "machine", "remark"), str)
)
#: What makes a run the same run.
KEY = ["problem", "hash", "solver", "settings"]
_ORDER = {"by": ["group", "problem", "solver", "accuracy"], "ascending": [True, True, True, False]}


class Results:
    """The runs of one output folder: runs.csv is written anew, whole or not at all, after each.

    Raises InputError where the folder holds other results.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / "runs.csv"
        if self.path.exists():
            self.runs = _read(self.path)
        elif folder.is_dir() and any(
            not p.name.startswith((".", "references.json")) for p in folder.iterdir()
        ):
            raise InputError(
                "holds other files and no runs.csv", "give --out an empty or a new folder", folder
            )
        else:
            self._write(pandas.DataFrame(columns=list(COLUMNS)).astype(COLUMNS))

    def add(self, row: Row) -> None:
        """One more run; it is on the disk when this returns."""
        new = pandas.DataFrame([{name: row[name] for name in COLUMNS}]).astype(COLUMNS)
        self._write(pandas.concat([self.runs, new], ignore_index=True) if len(self.runs) else new)

    def keep(self, current: dict[str, str]) -> int:
        """Drop runs of instances whose hash (by problem name) has changed; returns how many."""
        before, wanted = len(self.runs), self.runs["problem"].map(current)
        self._write(self.runs[wanted.isna() | (wanted == self.runs["hash"])])
        return before - len(self.runs)

    def _write(self, runs: pandas.DataFrame) -> None:
        self.runs = runs.sort_values(**_ORDER, ignore_index=True)
        write_text(self.path, self.runs.to_csv(index=False, lineterminator="\n"))

    @property
    def keys(self) -> set[tuple[str, ...]]:
        return set(self.runs[KEY].itertuples(index=False, name=None))


def _read(path: Path) -> pandas.DataFrame:
    text = read_text(path, own=True)
    if (head := text.partition("\n")[0].strip()) != ",".join(COLUMNS):
        raise InputError(
            f"holds the results of something else (its columns are {head[:60]}...)",
            "give --out another folder",
            path,
        )
    try:
        # As text first: an empty cell is no number, and "None" or "nan" are texts.
        return pandas.read_csv(io.StringIO(text), dtype=str, keep_default_na=False).astype(COLUMNS)
    except ValueError as error:
        raise InputError(
            f"a row is damaged ({error})", "delete it, and its run is done again", path
        ) from None
