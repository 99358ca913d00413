"""Libraries that read files, in a process of their own where one wrong byte can end them,
and their failures as one sentence."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from errno import EINVAL
from pathlib import Path
from typing import Any

from sdp_vs_penalty.errors import InputError


@contextmanager
def understood(path: str | Path, kind: str, remedy: str) -> Iterator[None]:
    """Turn the failures of a library that reads a file into InputError.

    Each library raises exceptions of its own, so all but memory and operating-system
    errors are turned.

    Parameters
    ----------
    kind : str
        How messages call such a file.
    remedy : str
        What to do about a broken file.
    """
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as error:
        # EINVAL is a place that the file names and does not have.
        if isinstance(error, OSError) and error.errno not in (None, EINVAL):
            raise  # whoever opened the file says so
        lines = str(error).splitlines()
        what = lines[0][:200] if lines else type(error).__name__
        if "end magic" in what or "Truncated" in what:
            remedy = "save what is left with `mcap recover`"
        raise InputError(f"not a readable {kind} ({what})", remedy, path) from error


def parse_apart(
    parse: Callable[[str], Iterator[dict[str, Any]]],
    path: Path,
    library: str,
    kind: str,
    remedy: str,
) -> dict[str, Any]:
    """Parse a file by a library in a process of its own, and put the parts together; a
    broken file is an InputError (:func:`understood`)."""
    from sdp_vs_penalty.robot.isolated import parse_isolated

    with understood(path, kind, remedy):
        parts = parse_isolated(parse, path, library=library)
        return {name: x for part in parts for name, x in part.items()}
