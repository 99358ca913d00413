"""The runs of a model as words: a model.json names them, and says no more of them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sdp_vs_penalty.data.formats import FILE_SEPARATOR
from sdp_vs_penalty.data.parsing import time_windows
from sdp_vs_penalty.errors import InputError


def run_words(data: Sequence[Path], window: str | None) -> list[str]:
    """Return the runs as words of a command, as they stand after --data; a name that
    begins with a dash is no option."""
    names = [f"./{name}" if name.startswith("-") else name for name in map(str, data)]
    return [*names, *([] if window is None else ["--window", window])]


def recorded_runs(recorded: Sequence[str]) -> tuple[list[Path], str | None] | None:
    """Return the runs, and their window, that a model.json names; the inverse of
    :func:`run_words`.

    None unless these are files that exist and a window, whatever the file says.
    """
    names, window = list(recorded), None
    if names[-2:-1] == ["--window"]:
        *names, _, window = names
    try:
        time_windows(window)
    except InputError:
        return None
    parts = [part for name in names for part in name.split(FILE_SEPARATOR)]
    are_files = all(
        part.isprintable() and not part.startswith("-") and Path(part).exists()
        for part in parts
    )
    return ([*map(Path, names)], window) if parts and are_files else None


def words_of_source(source: Any) -> list[str]:
    """Return the words of runs that were given to a function as files; none where any of
    them was given otherwise, as arrays."""
    parts = source if isinstance(source, list | tuple) else [source]
    are_files = all(isinstance(part, str | Path) for part in parts)
    return run_words([Path(part) for part in parts], None) if are_files else []
