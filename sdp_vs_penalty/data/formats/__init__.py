"""Files of measurements: each adapter turns bytes into named columns and knows nothing of
robots; what the columns are is decided behind them, alike for all.

A module of this folder with ``SUFFIXES`` (".csv", ...; none for a format of folders) and
``read(path)``, which returns a :class:`~sdp_vs_penalty.data.log.Log`, is an adapter, and
so is what another package names as an entry point or registers. A broken file is an
InputError. Optional are ``write(run, path)``; ``FOLDER``, a pattern of files: a folder
that holds one is such a run; ``SAMPLE``, what messages call a sample, "row" or "line" of
a text; and ``HAS_TOPICS = True`` of files that hold several topics.
"""

from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType

from sdp_vs_penalty.data.log import Log
from sdp_vs_penalty.files import reading
from sdp_vs_penalty.plugins import Registry

#: What stands between the files of one run: "positions.csv+torques.csv".
FILE_SEPARATOR = "+"

FORMATS = Registry[ModuleType]("format of measurements", __name__, "SUFFIXES")


def formats() -> tuple[ModuleType, ...]:
    """Import all modules that read measurements; they have ``SUFFIXES``."""
    return tuple(FORMATS.all().values())


def suffixes(ability: str = "read") -> tuple[str, ...]:
    """List the suffixes of the formats that can "read", or "write"."""
    return tuple(x for f in formats() if hasattr(f, ability) for x in f.SUFFIXES)


def format_of(path: Path) -> ModuleType | None:
    """Find the format of a file by its suffix, or of a folder by the files in it; None
    where no format claims it."""
    if path.is_dir():
        of_folders = (x for x in formats() if hasattr(x, "FOLDER"))
        return next((x for x in of_folders if any(path.glob(x.FOLDER))), None)
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


def open_log(path: Path) -> Log:
    """Read the named columns of a file or folder; of a text table where no format claims
    the file."""
    with reading(path) as place:
        found = format_of(place) or _format_called("csv")
        assert found is not None
        log: Log = found.read(place)
        return log
