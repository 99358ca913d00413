"""Runs as a command names them, and how it reads them: a model.json keeps its words, and
says no more of its runs."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from sdp_vs_penalty.data.formats import FILE_SEPARATOR
from sdp_vs_penalty.data.parsing import time_windows
from sdp_vs_penalty.errors import InputError


@dataclass(frozen=True)
class NamedRuns:
    """Runs behind --data or --test, with the options that belong to them."""

    #: Files, folders and patterns.
    files: Sequence[Path]
    #: Part of each run to use, as --window has it; None: all of it.
    window: str | None = None
    #: Whether names of columns mean what they say (--as-written).
    as_written: bool = False

    @property
    def words(self) -> list[str]:
        """The runs as words of a command, as they stand after --data; a name that begins
        with a dash is no option."""
        names = [f"./{x}" if x.startswith("-") else x for x in map(str, self.files)]
        names += ["--as-written"] * self.as_written
        return [*names, *([] if self.window is None else ["--window", self.window])]

    @classmethod
    def recorded(cls, words: Sequence[str]) -> Self | None:
        """Return the runs that a model.json names; None unless these are files that exist,
        and options, whatever the file says."""
        names, window = list(words), None
        if names[-2:-1] == ["--window"]:
            *names, _, window = names
        as_written = names[-1:] == ["--as-written"]
        names = names[: len(names) - as_written]
        try:
            time_windows(window)
        except InputError:
            return None
        parts = [part for name in names for part in name.split(FILE_SEPARATOR)]
        are_files = all(
            part.isprintable() and not part.startswith("-") and Path(part).exists()
            for part in parts
        )
        found = cls([*map(Path, names)], window, as_written)
        return found if parts and are_files else None


def words_of_source(source: Any) -> list[str]:
    """Return the words of runs that were given to a function as files; none where any of
    them was given otherwise, as arrays."""
    parts = source if isinstance(source, list | tuple) else [source]
    are_files = all(isinstance(part, str | Path) for part in parts)
    return NamedRuns([Path(part) for part in parts]).words if are_files else []
