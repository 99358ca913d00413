"""Whether what a command has written is whole, by a parser of each format."""

import json
import os
import tomllib
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path

Check = Callable[[Path], object]


def broken_outputs(paths: Iterable[Path]) -> list[str]:
    """Names of files that are partial, or that a hostile name has made."""
    broken = []
    for path in paths:
        if path.is_dir() and not path.is_symlink():
            broken += broken_outputs(path.iterdir())
            continue
        is_forbidden = path.name.endswith(".part") or path.name == "PWNED"
        if is_forbidden or (path.is_file() and not is_whole(path)):
            broken.append(path.name)
    return broken


def is_whole(path: Path) -> bool:
    """Whether a file can be read as its name says."""
    check = _CHECKS.get(path.suffix.lower())
    if check is None or not os.access(path, os.R_OK):
        return True
    try:
        check(path)
    except (ValueError, ET.ParseError, zipfile.BadZipFile):
        return False
    return True


def _end(*ends: str) -> Check:
    """A check that a text ends as it should."""

    def check(path: Path) -> None:
        if not path.read_text("utf-8").endswith(ends):
            raise ValueError("no end")

    return check


def _table(path: Path) -> None:
    """Every line of a table has as many separators as the first one."""
    lines = path.read_text("utf-8").split("\n")
    if (
        lines[-1]
        or len({line.count(",") for line in lines[:-1] if '"' not in line}) > 1
    ):
        raise ValueError("a row is cut")


_CHECKS: dict[str, Check] = {
    ".json": lambda path: json.loads(path.read_text("utf-8")),
    ".toml": lambda path: tomllib.loads(path.read_text("utf-8")),
    ".xml": ET.parse,
    ".urdf": ET.parse,
    ".sdf": ET.parse,
    ".npz": zipfile.ZipFile,
    ".csv": _table,
    ".html": _end("</html>\n", "</html>"),
    ".cbf": _end("\n"),
    ".dat-s": _end("\n"),
    ".h": _end("\n"),
    ".tex": _end("\n"),
    ".md": _end("\n"),
}
