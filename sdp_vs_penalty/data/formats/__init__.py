"""Files of measurements: one module a format, found by itself.

A module has ``SUFFIXES`` that choose it, ``read(path, choice) -> Measurements`` and,
where runs can be written, ``write(measurements, path)``; ``FOLDER``, a pattern of the
files by which a folder is such a run, and ``SAMPLE`` where its samples are called
otherwise. Readers return a run as it is in the file: clock and numbers are checked
afterwards, or mended by the data check.
"""

from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType

from sdp_vs_penalty.plugins import modules

#: What stands between the files of one run: "positions.csv+torques.csv".
FILE_SEPARATOR = "+"


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
    if path.is_dir():
        of_folders = [home for home in formats() if hasattr(home, "FOLDER")]
        return next((home for home in of_folders if any(path.glob(home.FOLDER))), None)
    suffix = path.suffix.lower()
    called_so = _format_called(suffix.removeprefix("."))
    if called_so is not None and suffix in called_so.SUFFIXES:
        return called_so  # csv.py reads .csv: no other format is imported for it
    return next((home for home in formats() if suffix in home.SUFFIXES), None)


@cache
def _format_called(name: str) -> ModuleType | None:
    """Import the format whose module has this name, "csv"; None where none has."""
    if all(module.name != name for module in iter_modules(__path__)):
        return None
    module = import_module(f"{__name__}.{name}")
    return module if hasattr(module, "SUFFIXES") else None
