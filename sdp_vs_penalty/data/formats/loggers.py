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
    """Find the columns of a known logger in a file.

    Parameters
    ----------
    logger : Mapping[str, Any]
        The logger's entry of loggers.toml: patterns of column names by channel group.
    names : Sequence[str]
        Names of the file's columns.

    Returns
    -------
    dict[str, dict[Hashable, str]]
        By channel group (q, dq, tau, ...) and joint the file's column. Groups that do
        not have the joints of q are left out. Empty where positions, or both torques
        and commands, are missing: then the file is not of this logger.
    """
    groups = {
        group: columns_of_pattern(logger.get(group), names)
        for group in GROUPS_OF_LOGGERS
    }
    joints = list(groups["q"])
    with_all_joints = {
        group: columns
        for group, columns in groups.items()
        if columns and list(columns) == joints
    }
    has_torques = bool({"tau", "qcmd"} & set(with_all_joints))
    return with_all_joints if has_torques else {}


def columns_of_pattern(patterns: Any, names: Sequence[str]) -> dict[Hashable, str]:
    """Find the columns that fit the first matching pattern of a list.

    In a pattern, ``{k}`` stands for a joint's number (written ``q_0``, ``q[0]`` or
    ``q.0``, counted from 0 or 1 without a gap) and ``{joint}`` for a joint's name.

    Parameters
    ----------
    patterns : Any
        One pattern, several, or None.
    names : Sequence[str]
        Names of the file's columns.

    Returns
    -------
    dict[Hashable, str]
        The file's column by the joint's number or name. One column that holds all
        joints has the key "". Empty where no pattern fits.
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
        has_no_gap = numbers == list(range(first, first + len(numbers)))
        if first <= 1 and has_no_gap:
            return dict(numbered)
    return {}


def _regex(pattern: str) -> re.Pattern[str]:
    """Compile a pattern of loggers.toml: ``{k}`` matches a number with the marks around
    it, ``{joint}`` a name without a slash."""
    number_in_marks = r"[ _.\[(/-]*([0-9]+)[\])]*"
    text = re.escape(pattern).replace(r"\{k\}", number_in_marks)
    return re.compile(text.replace(r"\{joint\}", "([^/]+)"))


def as_list(value: Any) -> list[Any]:
    """Return the patterns of an entry of loggers.toml as a list.

    Parameters
    ----------
    value : Any
        None, one text, or several.

    Returns
    -------
    list[Any]
        No, one or several texts.
    """
    if value is None:
        return []
    return [value] if isinstance(value, str) else list(value)
