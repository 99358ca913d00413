"""Loggers that are known by the names of their columns: the entries of loggers.toml."""

import re
import tomllib
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any

#: One entry a logger.
LOGGERS: list[dict[str, Any]] = tomllib.loads(
    Path(__file__).with_name("loggers.toml").read_text("utf-8")
)["logger"]
#: The groups that an entry can name.
GROUPS_OF_LOGGERS = ("q", "dq", "tau", "temp", "qcmd")


def columns_of_logger(
    logger: Mapping[str, Any], names: Sequence[str]
) -> dict[str, dict[Hashable, str]]:
    """Find the columns of a known logger.

    Parameters
    ----------
    logger : Mapping[str, Any]
        Its entry of loggers.toml.
    names : Sequence[str]
        Of the file's columns.

    Returns
    -------
    dict[str, dict[Hashable, str]]
        The file's names by group and joint; empty where positions, or torques and
        commands, are not among them.
    """
    groups = {
        group: columns_of_pattern(logger.get(group), names)
        for group in GROUPS_OF_LOGGERS
    }
    joints = list(groups["q"])
    complete = {
        group: columns
        for group, columns in groups.items()
        if columns and list(columns) == joints
    }
    return complete if {"tau", "qcmd"} & set(complete) else {}


def columns_of_pattern(patterns: Any, names: Sequence[str]) -> dict[Hashable, str]:
    """Find the columns of the first pattern that fits. Numbers stand behind any mark,
    ``q_0``, ``q[0]``, ``q.0``, and count from 0 or from 1 without a gap.

    Parameters
    ----------
    patterns : Any
        One pattern, several, or None.
    names : Sequence[str]
        Of the file's columns.

    Returns
    -------
    dict[Hashable, str]
        The file's names by the joint's number or name; empty where none fits.
    """
    for pattern in as_list(patterns):
        regex = _regex(pattern)
        matches = [(regex.fullmatch(name), name) for name in names]
        columns = [(match, name) for match, name in matches if match]
        if not columns:
            continue
        if "{joint}" in pattern:
            return {match[1]: name for match, name in columns}
        if "{k}" not in pattern:
            return {"": columns[0][1]}
        numbered = sorted((int(match[1]), name) for match, name in columns)
        numbers = [number for number, _ in numbered]
        first = numbers[0]
        if first <= 1 and numbers == list(range(first, first + len(numbers))):
            return dict(numbered)
    return {}


def _regex(pattern: str) -> re.Pattern[str]:
    text = re.escape(pattern)
    text = text.replace(r"\{k\}", r"[ _.\[(/-]*([0-9]+)[\])]*")
    return re.compile(text.replace(r"\{joint\}", "([^/]+)"))


def as_list(value: Any) -> list[Any]:
    """Make a list of a value of loggers.toml.

    Parameters
    ----------
    value : Any
        None, one text, or several.

    Returns
    -------
    list[Any]
        No, one or several values.
    """
    if value is None:
        return []
    return [value] if isinstance(value, str) else list(value)
