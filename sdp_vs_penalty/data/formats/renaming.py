"""What ``convert --rename`` and ``--scale`` say: names and units of columns as words of
a command, and back."""

import fnmatch
import re
from collections.abc import Mapping, Sequence

import numpy as np

from sdp_vs_penalty.data.formats.units import UNITS, unit_of_factor
from sdp_vs_penalty.data.formats.wrapping import POSITIONS, unwrapped
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError, require_known

_DEGREES = ("deg", "degree", "degrees")


def group_of(our_name: str) -> str:
    """Return the channel group of a name of RUN.csv: "tau" for "tau3"."""
    return our_name.rstrip("0123456789")


def parts_of(their_name: str, names: Sequence[str]) -> tuple[str, ...]:
    """List the columns that a name of ``--rename`` stands for.

    Parameters
    ----------
    their_name : str
        Name of a column, or of the columns of a stamp: "sec+nanosec", or
        "hour+minute+second".
    names : Sequence[str]
        Names of the file's columns.
    """
    if their_name in names or "+" not in their_name:
        return (their_name,)
    return tuple(part.strip() for part in their_name.split("+"))


def rename_words(rename: Mapping[str, str], names: Sequence[str]) -> str:
    """Format a renaming of columns as the value of ``--rename``.

    A channel group is written as one pattern where that means the same. A column whose
    name holds commas or the like is written as its number, "#3".

    >>> rename_words({"t": "time", "q1": "p_0", "q2": "p_1"}, ["time", "p_0", "p_1"])
    't=time,q*=p_*'

    Parameters
    ----------
    rename : Mapping[str, str]
        The file's column names by ours (t, q1, tau1 ...).
    names : Sequence[str]
        Names of the file's columns.
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
    group: str, pairs: Mapping[str, str], names: Sequence[str]
) -> str | None:
    """Return the pattern, "p_*", that stands for all columns of a channel group; None
    where no pattern means exactly these columns in this order."""
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
    """Return a column's name, or "#3" (its number) where the option's own marks are in
    the name."""
    is_plain = bool(name) and name == name.strip() and not set(",=*+") & set(name)
    if is_plain or name not in names:
        return name
    return f"#{list(names).index(name) + 1}"


def scale_words(scale: Mapping[str, float], rename: Mapping[str, str]) -> str:
    """Format factors to SI as the value of ``--scale``, units by name where one has the
    factor.

    Parameters
    ----------
    scale : Mapping[str, float]
        Factors to SI by our names.
    rename : Mapping[str, str]
        The file's names by ours, all of them: a group is written as one where all of
        its columns have one factor.

    Returns
    -------
    str
        The option's value, such as "q=deg,tau1=0.5".
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
    """Return the name of the unit with this factor to SI, else the factor as a
    number."""
    return unit_of_factor(factor, group) or f"{factor:.12g}"


def expanded(rename: Mapping[str, str], names: Sequence[str]) -> dict[str, str]:
    """Replace patterns of ``--rename``, such as ``q*=actual_q_*``, by one pair for each
    joint.

    Parameters
    ----------
    rename : Mapping[str, str]
        The file's column names by ours (t, q1 ...), as the user writes them.
    names : Sequence[str]
        Names of the file's columns.

    Returns
    -------
    dict[str, str]
        The file's names by ours, without patterns.

    Raises
    ------
    InputError
        No column fits a pattern.
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
    """Return the name of the column that "#3" stands for; another name as it is."""
    match = re.fullmatch("#([1-9][0-9]*)", their_name)
    if match is None or their_name in names or int(match[1]) > len(names):
        return their_name
    return names[int(match[1]) - 1]


def _matching(pattern: str, names: Sequence[str]) -> list[str]:
    """List the names that fit a pattern whose star is a number, in the order of the
    numbers."""
    regex = re.compile(re.escape(pattern).replace(r"\*", "([0-9]+)"))
    matches = [(regex.fullmatch(name), name) for name in names]
    numbered = [(int(match[1]), name) for match, name in matches if match]
    return [name for _, name in sorted(numbered)]


def scaled(run: Measurements, factors: Mapping[str, str]) -> Measurements:
    """Convert a run to SI units.

    Angles in degrees that jump by a full turn are made continuous.

    Parameters
    ----------
    run : Measurements
        The run in the file's units.
    factors : mapping of str to str
        By our names (t, q, q1 ...): a unit, a number, or one number a joint separated
        by colons, as ``--scale q=deg,tau=10:10.7:8.5`` has them.

    Returns
    -------
    Measurements
        The run in SI units.

    Raises
    ------
    InputError
        A word that is no unit and no number, or a column that the run does not have.
    """
    groups = {"t": run.t[:, None], **run.groups}
    for our_name, word in factors.items():
        group = group_of(our_name)
        require_known("channel", group, groups, "scale")
        n_columns = groups[group].shape[1] if group in groups else 0
        groups[group] = groups[group] * _factors(our_name, word, n_columns)
    clock = groups.pop("t")[:, 0]
    in_si = Measurements.of(clock, groups, run.names)
    degrees = [name for name in POSITIONS if factors.get(name, "").lower() in _DEGREES]
    return unwrapped(in_si, run.names[0], degrees)


def _factors(our_name: str, word: str, n_columns: int) -> np.ndarray:
    """Return the factors of a group's columns that one entry of ``--scale`` means.

    ``word`` is a unit, a number, or one number a joint, "10:10.7:8.5". Returns (n,)
    factors, or (1,) where all joints have the same. For one joint's name, "tau2", the
    others get 1.
    """
    values = [UNITS.get(x.lower()) or _number(our_name, x) for x in word.split(":")]
    group = group_of(our_name)
    number = our_name.removeprefix(group)  # "2" of "tau2", "" of "tau"
    joint = int(number) if number else 1
    if not 1 <= joint <= n_columns:
        what = f"--scale {our_name}: the run has no such column"
        raise InputError(what, "name t, q, dq or tau")
    if number:
        is_joint = np.arange(n_columns) == joint - 1
        return np.where(is_joint, values[0], 1.0)
    if len(values) not in (1, n_columns):
        what = f"--scale {our_name}={word}: {len(values)} factors"
        raise InputError(what, f"give one, or {n_columns}")
    return np.array(values)


def _number(our_name: str, word: str) -> float:
    """Parse a factor; raise InputError for a word that is no number, for zero and
    infinity."""
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
