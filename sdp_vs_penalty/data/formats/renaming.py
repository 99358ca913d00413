"""What ``convert --rename`` and ``--scale`` say: names and units of columns as words of
a command, and back."""

import fnmatch
import re
from collections.abc import Mapping, Sequence

import numpy as np

from sdp_vs_penalty.data.formats.units import UNITS, unit_of_factor
from sdp_vs_penalty.data.formats.wrapping import POSITIONS, unwrapped
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError

_DEGREES = ("deg", "degree", "degrees")


def group_of(our_name: str) -> str:
    """Find the group of one of our names.

    Parameters
    ----------
    our_name : str
        Such as "tau3".

    Returns
    -------
    str
        The name without its number: "tau".
    """
    return our_name.rstrip("0123456789")


def parts_of(their_name: str, names: Sequence[str]) -> tuple[str, ...]:
    """List the columns that a name of ``--rename`` stands for.

    Parameters
    ----------
    their_name : str
        A column, or two of a stamp: "sec+nanosec".
    names : Sequence[str]
        Of the file's columns.

    Returns
    -------
    tuple[str, ...]
        One or two names.
    """
    if their_name in names or "+" not in their_name:
        return (their_name,)
    return tuple(part.strip() for part in their_name.split("+"))


def rename_words(rename: Mapping[str, str], names: Sequence[str]) -> str:
    """Format the pairs of ``--rename``: one pattern for a group where it means the
    same, and columns by their number where their names cannot be written.

    >>> rename_words({"t": "time", "q1": "p_0", "q2": "p_1"}, ["time", "p_0", "p_1"])
    't=time,q*=p_*'

    Parameters
    ----------
    rename : Mapping[str, str]
        Our names to the file's.
    names : Sequence[str]
        Of the file's columns.

    Returns
    -------
    str
        The option's value.
    """
    groups = dict[str, dict[str, str]]()
    for our_name, their_name in rename.items():
        groups.setdefault(group_of(our_name), {})[our_name] = their_name
    words = list[str]()
    for group, pairs in groups.items():
        pattern = _pattern_of(group, pairs, names)
        if pattern is not None:
            words.append(f"{group}*={pattern}")
            continue
        for our_name, their_name in pairs.items():
            words.append(f"{our_name}={_writable(their_name, names)}")
    return ",".join(words)


def _pattern_of(
    group: str,
    pairs: Mapping[str, str],
    names: Sequence[str],
) -> str | None:
    """The pattern that stands for all pairs of a group; None without one."""
    first = next(iter(pairs.values()))
    pattern = re.sub(r"[0-9]+([^0-9]*)$", r"*\1", first)
    has_one_star = pattern.count("*") == 1
    if len(pairs) < 2 or not has_one_star or set(",=#+") & set(pattern):
        return None
    try:
        is_same = expanded({f"{group}*": pattern}, names) == dict(pairs)
    except InputError:
        return None
    return pattern if is_same else None


def _writable(name: str, names: Sequence[str]) -> str:
    """A column's name, or its number where commas or the like are in it."""
    is_plain = bool(name) and name == name.strip() and not set(",=*+") & set(name)
    if is_plain or name not in names:
        return name
    return f"#{list(names).index(name) + 1}"


def scale_words(scale: Mapping[str, float], rename: Mapping[str, str]) -> str:
    """Format the pairs of ``--scale``: a unit's word for a group where it says the
    same.

    Parameters
    ----------
    scale : Mapping[str, float]
        Factors to SI by our names.
    rename : Mapping[str, str]
        Our names to the file's, all of them.

    Returns
    -------
    str
        The option's value.
    """
    groups = dict[str, dict[str, float]]()
    for our_name, factor in scale.items():
        groups.setdefault(group_of(our_name), {})[our_name] = factor
    words = list[str]()
    for group, factors in groups.items():
        n_columns = sum(group_of(our_name) == group for our_name in rename)
        values = set(factors.values())
        if len(values) == 1 and n_columns == len(factors):
            words.append(f"{group}={_factor_word(values.pop(), group)}")
            continue
        for our_name, factor in factors.items():
            words.append(f"{our_name}={_factor_word(factor, group)}")
    return ",".join(words)


def _factor_word(factor: float, group: str) -> str:
    """A unit's name, or the number."""
    return unit_of_factor(factor, group) or f"{factor:.12g}"


def expanded(rename: Mapping[str, str], names: Sequence[str]) -> dict[str, str]:
    """Replace patterns of ``--rename``, such as ``q*=actual_q_*``, by one pair for each
    joint.

    Parameters
    ----------
    rename : Mapping[str, str]
        As the user writes it.
    names : Sequence[str]
        Of the file's columns.

    Returns
    -------
    dict[str, str]
        Our names to the file's, without patterns.

    Raises
    ------
    InputError
        No column has such a name.
    """
    out = dict[str, str]()
    for our_name, their_name in rename.items():
        their_name = _by_number(their_name, names)
        if "*" not in their_name or their_name in names:
            out[our_name] = their_name
            continue
        columns = _matching(their_name, names)
        if not columns:
            near = fnmatch.filter(names, their_name)[:4]
            shown = ", ".join(near) or "none that is numbered"
            remedy = "give --rename a pattern of the file's names"
            raise InputError(f"no column {their_name!r} ({shown})", remedy)
        for k, name in enumerate(columns, start=1):
            out[f"{our_name.rstrip('*')}{k}"] = name
    return out


def _by_number(their_name: str, names: Sequence[str]) -> str:
    """The name of column "#3", or the name itself."""
    match = re.fullmatch("#([1-9][0-9]*)", their_name)
    if match is None or their_name in names or int(match[1]) > len(names):
        return their_name
    return names[int(match[1]) - 1]


def _matching(pattern: str, names: Sequence[str]) -> list[str]:
    """The names that fit a pattern whose star is a number, in the numbers' order."""
    regex = re.compile(re.escape(pattern).replace(r"\*", "([0-9]+)"))
    matches = [(regex.fullmatch(name), name) for name in names]
    numbered = [(int(match[1]), name) for match, name in matches if match]
    return [name for _, name in sorted(numbered)]


def scaled(run: Measurements, factors: Mapping[str, str]) -> Measurements:
    """The run in other units.

    Parameters
    ----------
    run : in the file's units
    factors : by our names q, q1 ..., t: a unit, a number, or one number a joint
        separated by colons, as ``--scale q=deg,tau=10:10.7:8.5``

    Returns
    -------
    Measurements
        The run in SI units; angles in degrees go on where they were cut at a full turn.

    Raises
    ------
    InputError
        Words that are none of these, and columns that are not there.
    """
    groups = {"t": run.t[:, None], **run.groups}
    for our_name, word in factors.items():
        group = group_of(our_name)
        n_columns = groups[group].shape[1] if group in groups else 0
        groups[group] = groups[group] * _factors(our_name, word, n_columns)
    clock = groups.pop("t")[:, 0]
    in_si = Measurements.of(clock, groups, run.names)
    degrees = [name for name in POSITIONS if factors.get(name, "").lower() in _DEGREES]
    return unwrapped(in_si, run.names[0], degrees)


def _factors(
    our_name: str,
    word: str,
    n_columns: int,
) -> np.ndarray:
    """(n,) or (1,) what the columns of a group are multiplied by."""
    values = [UNITS.get(w.lower()) or _number(our_name, w) for w in word.split(":")]
    group = group_of(our_name)
    joint = int(our_name[len(group) :] or 1)
    if not 1 <= joint <= n_columns:
        what = f"--scale {our_name}: the run has no such column"
        raise InputError(what, "name t, q, dq or tau")
    if our_name != group:
        return np.where(
            np.arange(n_columns) == joint - 1,
            values[0],
            1.0,
        )
    if len(values) not in (1, n_columns):
        what = f"--scale {our_name}={word}: {len(values)} factors"
        raise InputError(what, f"give one, or {n_columns}")
    return np.array(values)


def _number(our_name: str, word: str) -> float:
    """A number other than zero; InputError for another word."""
    try:
        value = float(word)
    except ValueError:
        value = 0.0
    if not value or not np.isfinite(value):
        known = ", ".join(sorted(UNITS))
        raise InputError(
            f"--scale {our_name}={word}",
            f"give a number other than 0, or a unit: {known}",
        )
    return value
