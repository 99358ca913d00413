"""What names say: quantities, joints, units, stamps. The words stand in words.toml, the
loggers that are known by their names in loggers.toml."""

import tomllib
from functools import cache
from pathlib import Path
from typing import Any


@cache
def table(name: str = "words") -> dict[str, Any]:
    """Return the table of words, or of "loggers"."""
    return tomllib.loads(Path(__file__).with_name(f"{name}.toml").read_text("utf-8"))
