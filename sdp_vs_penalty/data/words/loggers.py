"""Loggers that are known by the names of their columns: the entries of loggers.toml."""

import re
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

from sdp_vs_penalty.data.words import table

#: One entry a logger.
LOGGERS: list[dict[str, Any]] = table("loggers")["logger"]
#: The groups that an entry can name.
_GROUPS = ("q", "dq", "tau", "temp", "qcmd")
#: A joint's number with the marks around it, and a joint's name.
_NUMBER, _JOINT = r"[ _.\[(/-]*([0-9]+)[\])]*", "([^/]+)"


def columns_of_logger(
    logger: Mapping[str, Any], names: Sequence[str]
) -> dict[str, dict[Hashable, str]]:
    """Return a known logger's columns in a file, by channel group and joint.

    Groups that do not have the joints of q are left out. Empty where positions, or both
    torques and commands, are missing: then the file is not of this logger.
    """
    groups = {group: columns_of_pattern(logger.get(group), names) for group in _GROUPS}
    found = {
        group: columns
        for group, columns in groups.items()
        if columns and list(columns) == list(groups["q"])
    }
    return found if found.keys() & {"tau", "qcmd"} else {}


def columns_of_pattern(patterns: Any, names: Sequence[str]) -> dict[Hashable, str]:
    """Return the columns that fit the first matching pattern, by the joint's number or
    name, or "" where one column holds all joints; empty where none fits.

    In a pattern, ``{k}`` stands for a joint's number (written ``q_0``, ``q[0]`` or
    ``q.0``, counted from 0 or 1 without a gap) and ``{joint}`` for a joint's name.
    """
    for pattern in as_list(patterns):
        text = (
            re.escape(pattern).replace(r"\{k\}", _NUMBER).replace(r"\{joint\}", _JOINT)
        )
        found = [(m, name) for name in names if (m := re.fullmatch(text, name))]
        if found and "{joint}" in pattern:
            return {match[1]: name for match, name in found}
        if found and "{k}" not in pattern:
            return {"": found[0][1]}
        numbered = sorted((int(match[1]), name) for match, name in found)
        numbers = [number for number, _ in numbered]
        if (
            numbers
            and numbers[0] <= 1
            and numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        ):
            return dict(numbered)
    return {}


def as_list(value: Any) -> list[Any]:
    """Return what an entry of loggers.toml lists: nothing, one text, or several."""
    return [] if value is None else [value] if isinstance(value, str) else list(value)


def episode_of(names: Sequence[str]) -> str | None:
    """Return the first column that counts runs by the name that a known logger gives it;
    None where there is none."""
    known = [x for logger in LOGGERS for x in as_list(logger.get("episode"))]
    return next((name for name in known if name in names), None)
