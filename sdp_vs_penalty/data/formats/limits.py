"""Libraries that read files, in a process of their own where one wrong byte can end them,
and their failures as one sentence."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from errno import EINVAL
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

#: What the joints' names are called beside arrays.
_JOINT_NAMES = re.compile(r"(?i)(?:.*[^a-z])?(?:joint_?names?|joints?|names?)")
#: What stands before each text of an array of texts, on the way from a process.
_TEXT = "\x1f"


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
        command = ""
        what = lines[0][:200] if lines else type(error).__name__
        if "end magic" in what or "Truncated" in what:
            remedy, command = "save what is left", "`mcap recover`"
        what = f"not a readable {kind} ({what})"
        raise InputError(what, remedy, path, command) from error


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


def joint_names_in(name: str, value: Any) -> Iterator[dict[str, Array]]:
    """Iterate over what a process of its own sends of an array of texts that is called so
    as the joints' names are: its texts behind its name. Nothing of any other value."""
    if not _JOINT_NAMES.fullmatch(name):
        return
    cells = np.ravel(np.asarray(value, object)).tolist()
    texts = [x.decode(errors="replace") if isinstance(x, bytes) else x for x in cells]
    if len(texts) > 1 and all(isinstance(x, str) for x in texts):
        yield {_TEXT.join([name, *map(str.strip, texts)]): np.zeros(0)}


def texts_apart(
    parts: dict[str, Array],
) -> tuple[dict[str, Array], dict[str, list[list[str]]]]:
    """Return the arrays of numbers that a process has sent, and the row of each array of
    texts (:func:`joint_names_in`)."""
    texts = {
        x: [y.split(_TEXT)] for x, _, y in (k.partition(_TEXT) for k in parts) if y
    }
    return {x: y for x, y in parts.items() if _TEXT not in x}, texts
