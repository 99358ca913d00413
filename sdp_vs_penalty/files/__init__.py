"""Inputs are bounded; outputs are written whole or not at all, never over what the command has read."""

from pathlib import Path

from sdp_vs_penalty.files.inputs import (
    LARGEST_MESH,
    LARGEST_RUN,
    LARGEST_TEXT,
    protecting,
    read_bytes,
    read_json,
    read_table,
    read_text,
    read_toml,
    reading,
)
from sdp_vs_penalty.files.outputs import alone, as_csv, write_bytes, write_text, writing

__all__ = [
    "LARGEST_MESH",
    "LARGEST_RUN",
    "LARGEST_TEXT",
    "alone",
    "as_csv",
    "problems_folder",
    "protecting",
    "read_bytes",
    "read_json",
    "read_table",
    "read_text",
    "read_toml",
    "reading",
    "write_bytes",
    "write_text",
    "writing",
]


def problems_folder() -> Path:
    """Where the built-in problems are: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).parents[1]
    inside = package / "problems"
    return inside if inside.is_dir() else package.parent / "problems"
