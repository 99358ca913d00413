"""Files of measurements: one module a format, found by itself.

A module has ``SUFFIXES`` that choose it, ``read(path, choice) -> Measurements`` and,
where runs can be written, ``write(measurements, path)``; ``FOLDER``, a pattern of the
files by which a folder is such a run, and ``SAMPLE`` where its samples are called
otherwise. Readers return a run as it is in the file: clock and numbers are checked
afterwards, or mended by the data check.
"""

from functools import cache
from pathlib import Path
from types import ModuleType

from sdp_vs_penalty.plugins import modules


@cache
def formats() -> tuple[ModuleType, ...]:
    """Every module of this folder that reads measurements."""
    return tuple(modules(__name__, __path__, "SUFFIXES"))


def suffixes(ability: str = "read") -> tuple[str, ...]:
    """List the suffixes of all formats.

    Parameters
    ----------
    ability : str
        What the format can do: "read" or "write".

    Returns
    -------
    tuple[str, ...]
        Suffixes with their point.
    """
    return tuple(
        s for home in formats() if hasattr(home, ability) for s in home.SUFFIXES
    )


def format_of(path: Path) -> ModuleType | None:
    """Find the format of a file by its suffix, or of a folder by its files.

    Parameters
    ----------
    path : Path
        Of the file or folder.

    Returns
    -------
    ModuleType | None
        The module that reads it; None where nothing claims it.
    """
    suffix = path.suffix.lower()
    folder = path.is_dir()
    for home in formats():
        holds = getattr(home, "FOLDER", None)
        if (holds and any(path.glob(holds))) if folder else suffix in home.SUFFIXES:
            return home
    return None
