"""Files of measurements: one module a format, found by itself.

A module that offers the names of :class:`~interface.MeasurementFormat` is a format; there
too stands what else it can offer. Readers return a run as it is in the file: clock and
numbers are checked afterwards, or mended by the data check.
"""

from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType

from sdp_vs_penalty.plugins import Registry

#: What stands between the files of one run: "positions.csv+torques.csv".
FILE_SEPARATOR = "+"


FORMATS = Registry[ModuleType]("format of measurements", __name__, "SUFFIXES")


def formats() -> tuple[ModuleType, ...]:
    """Import all modules that read measurements; they have ``SUFFIXES``."""
    return tuple(FORMATS.all().values())


def suffixes(ability: str = "read") -> tuple[str, ...]:
    """List the suffixes of all formats.

    Parameters
    ----------
    ability : str
        What the format can do: "read" or "write".
    """
    able = [module for module in formats() if hasattr(module, ability)]
    return tuple(suffix for module in able for suffix in module.SUFFIXES)


def format_of(path: Path) -> ModuleType | None:
    """Find the format of a file by its suffix, or of a folder by the files in it.

    Parameters
    ----------
    path : Path
        Path of the file or folder.

    Returns
    -------
    ModuleType | None
        The module that reads it; None where no format claims it.
    """
    if path.is_dir():
        readers_of_folders = [x for x in formats() if hasattr(x, "FOLDER")]
        return next((x for x in readers_of_folders if any(path.glob(x.FOLDER))), None)
    suffix = path.suffix.lower()
    same_name = _format_called(suffix.removeprefix("."))
    if same_name is not None and suffix in same_name.SUFFIXES:
        return same_name  # csv.py reads .csv: no other format is imported for it
    return next((x for x in formats() if suffix in x.SUFFIXES), None)


@cache
def _format_called(name: str) -> ModuleType | None:
    """Import the format whose module has this name, "csv"; None where none has."""
    if all(module.name != name for module in iter_modules(__path__)):
        return None
    module = import_module(f"{__name__}.{name}")
    return module if hasattr(module, "SUFFIXES") else None
