"""Units that metadata say: those of a Parquet file's columns, and those of the data set
that it belongs to (LeRobot's meta/info.json)."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

#: Keys that hold the unit of a column.
_KEYS = ("unit", "units")
#: A data set's description, in one of the folders above its data/chunk-000/file.parquet.
_INFO = Path("meta", "info.json")
_LEVELS = 4
#: A longer description is none [bytes].
_LONGEST = 1 << 20


def stated_units(path: Path, schema: Any) -> dict[str, str]:
    """Return the units of columns that metadata say, by the column's name.

    Parameters
    ----------
    path : Path
        Path of the Parquet file.
    schema : pyarrow.Schema
        Its columns; their own metadata go before those of the data set.

    Returns
    -------
    dict of str to str
        Units as they are written; columns without one are left out.
    """
    features = _features(path)
    out = dict[str, str]()
    for field in schema:
        own = {
            key.decode(errors="replace"): value.decode(errors="replace")
            for key, value in (field.metadata or {}).items()
        }
        for described in (features.get(field.name), own):
            unit = _unit_of(described)
            if unit:
                out[field.name] = unit
    return out


def _unit_of(description: object) -> str:
    """Return the unit in the description of a column; "" where it says none, or
    several."""
    if not isinstance(description, Mapping):
        return ""
    units = (description.get(key) for key in _KEYS)
    return next((unit for unit in units if isinstance(unit, str)), "")


def _features(path: Path) -> Mapping[str, Any]:
    """Return the descriptions of the columns in the data set's info.json, by name;
    empty where there is none that can be read."""
    folders = list(path.absolute().parents)[:_LEVELS]
    file = next((x / _INFO for x in folders if (x / _INFO).is_file()), None)
    if file is None or file.stat().st_size > _LONGEST:
        return {}
    try:
        content = json.loads(file.read_bytes())
    except (ValueError, OSError, RecursionError):
        return {}
    features = content.get("features") if isinstance(content, dict) else None
    return features if isinstance(features, dict) else {}
