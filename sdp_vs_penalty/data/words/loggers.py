"""Loggers that are known by the names of their columns: the entries of loggers.toml."""

import re
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

from sdp_vs_penalty.data.words import table
from sdp_vs_penalty.data.words.names import Meaning
from sdp_vs_penalty.data.words.tokens import parts_of

#: One entry a logger.
LOGGERS: list[dict[str, Any]] = table("loggers")["logger"]
#: The groups that an entry can name.
_GROUPS = ("q", "dq", "tau", "temp", "qcmd")
#: A joint's number with the marks around it, and a joint's name.
_NUMBER, _JOINT = r"[ _.\[(/-]*([0-9]+)[\])]*", "([^/]+)"


def find_logger(names: Sequence[str]) -> tuple[dict[str, Any], dict[str, Meaning]]:
    """Find the known logger that wrote a file with these columns, and what their names
    say; both empty where none did.

    The file has the logger's clock, its positions, and its torques or commands. Groups
    that do not have the joints of q are left out. A logger with torques goes before one
    with commands alone: two loggers may differ only in the name of the torques.
    """
    with_commands = dict[str, Any](), dict[str, Meaning]()
    for logger in LOGGERS:
        groups = dict[str, dict[Hashable, str]]()
        for x in reversed(_GROUPS):  # "action.elbow.pos" is no "{joint}.pos"
            taken = {y for columns in groups.values() for y in columns.values()}
            left = [y for y in names if y not in taken]
            groups[x] = columns_of_pattern(logger.get(x), left)
        said = {
            name: Meaning(
                group,
                rank=0,
                number=key if isinstance(key, int) else None,
                other_words=(key,) if key and isinstance(key, str) else (),
            )
            for group, columns in groups.items()
            if list(columns) == list(groups["q"])
            for key, name in columns.items()
        }
        quantities = {x.quantity for x in said.values()}
        is_timed = "t" not in logger or clock_of(logger, names)
        has_others = columns_of_pattern(logger.get("beside"), names)
        if "beside" in logger and not has_others:
            continue
        if not is_timed or not {"q"} < quantities or not quantities & {"tau", "qcmd"}:
            continue
        if "tau" in quantities:
            return logger, said
        if not with_commands[0]:
            with_commands = logger, said
    return with_commands


def clock_of(logger: Mapping[str, Any], names: Sequence[str]) -> str | None:
    """Return the clock of a logger in a file, one column or parts; None without it."""
    clocks = as_list(logger.get("t"))
    return next((x for x in clocks if {*parts_of(x, names)} <= {*names}), None)


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
    if value is None:
        return []
    return [value] if isinstance(value, str) else list(value)
