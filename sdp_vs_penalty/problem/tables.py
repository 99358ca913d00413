"""CSV tables of a problem's folder, as text cells."""

from __future__ import annotations

import csv
from pathlib import Path

from sdp_vs_penalty.errors import InputError, unreadable
from sdp_vs_penalty.files import opened


def read_table(path: Path) -> list[dict[str, str]]:
    opened(path)
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return [dict(row) for row in csv.DictReader(file)]
    except OSError as error:
        raise unreadable(error, path) from error
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"not a CSV table ({error})", "write it anew as UTF-8 text", path) from error
