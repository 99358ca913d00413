"""What ``convert --rename`` and ``--scale`` say: names and units of columns as words of
a command, and back."""

import fnmatch
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from types import MappingProxyType
from typing import Any

import numpy as np

from sdp_vs_penalty.data.hypotheses.channels import Recognition
from sdp_vs_penalty.data.hypotheses.weighing import in_one_unit, is_in_one_unit
from sdp_vs_penalty.data.hypotheses.wrapping import POSITIONS, unwrapped
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.words.tokens import group_of, starred
from sdp_vs_penalty.data.words.units import UNITS, unit_of_factor
from sdp_vs_penalty.errors import InputError, Remark, require_known


def by_group(pairs: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Collect pairs by the channel group of our name."""
    groups = dict[str, dict[str, Any]]()
    for our_name, value in pairs.items():
        groups.setdefault(group_of(our_name), {})[our_name] = value
    return groups


def rename_words(rename: Mapping[str, str], names: Sequence[str]) -> str:
    """Format the file's column names by ours as the value of ``--rename``.

    A channel group is written as one pattern where that means the same. A column whose
    name holds commas or the like is written as its number, "#3".

    >>> rename_words({"t": "time", "q1": "p_0", "q2": "p_1"}, ["time", "p_0", "p_1"])
    't=time,q*=p_*'
    """
    words = list[str]()
    for group, pairs in by_group(rename).items():
        pattern = starred(next(iter(pairs.values())))
        if _stands_for(pattern, group, pairs, names):
            words.append(f"{group}*={pattern}")
        else:
            words += [f"{ours}={_writable(x, names)}" for ours, x in pairs.items()]
    return ",".join(words)


def _stands_for(
    pattern: str, group: str, pairs: Mapping[str, str], names: Sequence[str]
) -> bool:
    """Return whether a pattern, "p_*", means exactly the columns of a channel group in
    their order."""
    if len(pairs) < 2 or pattern.count("*") != 1 or set(",=#+") & set(pattern):
        return False
    try:
        return expanded({f"{group}*": pattern}, names) == dict(pairs)
    except InputError:
        return False


def _writable(name: str, names: Sequence[str]) -> str:
    """Return a column's name, or "#3" (its number) where the option's own marks are in
    the name."""
    is_plain = bool(name) and name == name.strip() and not set(",=*+") & set(name)
    is_plain = is_plain or name not in names
    return name if is_plain else f"#{list(names).index(name) + 1}"


def scale_words(
    scale: Mapping[str, float],
    rename: Mapping[str, str],
    units: Mapping[str, str],
    zeros: Sequence[float] = (),
) -> str:
    """Format factors to SI, by our names, as the value of ``--scale``:
    "q=deg,tau1=0.5", or "q=0.00153@2048" with readings at zero.

    A group is written once if all of its columns have the same factor.

    Parameters
    ----------
    scale : mapping of str to float
        Factor of each column, "q1", or of a whole group, "q".
    rename : mapping of str to str
        The file's columns by our names, which tell how many columns a group has.
    units : mapping of str to str
        The units of a group in words, "deg and mm": a factor is written as one of them.
    zeros : sequence of float
        What each position reads where its joint is at zero; none where all read 0.
    """
    words = list[str]()
    n_columns = {group: len(pairs) for group, pairs in by_group(rename).items()}
    for group, factors in by_group(scale).items():
        texts = {
            ours: unit_of_factor(factor, group, units.get(group, ""))
            or f"{factor:.12g}"
            for ours, factor in factors.items()
        }
        factor_texts = [*texts.values()]
        is_whole_group = n_columns.get(group, 0) == len(texts)
        if group == "q" and zeros and len(texts) in (1, len(zeros)):
            # The only factor, if there is one, belongs to all joints.
            pairs = zip(cycle(factor_texts), zeros)
            texts = {"q": one_or_each([f"{text}@{zero:g}" for text, zero in pairs])}
        elif is_whole_group and len({*factor_texts}) == 1:
            texts = {group: factor_texts[0]}
        words += [f"{ours}={text}" for ours, text in texts.items()]
    return ",".join(words)


def one_or_each(texts: Sequence[str]) -> str:
    """Join one text a joint by colons; write it once where all joints have the same."""
    return texts[0] if len({*texts}) == 1 else ":".join(texts)


def convert_options(
    recognition: Recognition,
    column_names: Sequence[str],
    rate: str = "",
    chosen_scale: Mapping[str, str] = MappingProxyType({}),
) -> list[str]:
    """Format the options of ``convert`` that state a recognition, as words of a command:
    --rename, --scale, --joints and --rate, without those that have nothing to state.

    Parameters
    ----------
    column_names : sequence of str
        Names of all columns of the file, in its order.
    rate : str
        Sampling rate [Hz], "HZ" where the user has to know it, "" where a clock tells it.
    chosen_scale : mapping of str to str
        Values of --scale that the user has chosen, by our names: they go before factors of
        the recognition.
    """
    units = {group: unit.answer for group, unit in recognition.units.items()}
    scale = {x: y for x, y in recognition.scale.items() if x not in chosen_scale}
    scales = [f"{name}={factor}" for name, factor in chosen_scale.items()]
    if scale:
        rename, zeros = recognition.rename, recognition.zeros
        scales.insert(0, scale_words(scale, rename, units, zeros))
    options = {
        "--rename": rename_words(recognition.rename, column_names),
        "--scale": ",".join(scales),
        "--joints": ",".join(recognition.joints) if recognition.order else "",
        "--rate": rate,
    }
    words = list[str]()
    for option, value in options.items():
        if value:
            words += [option, value]
    return words


def expanded(rename: Mapping[str, str], names: Sequence[str]) -> dict[str, str]:
    """Replace patterns of ``--rename``, such as ``q*=actual_q_*``, by one pair for each
    joint, and "#3" by the name of the column with this number; raise InputError where no
    column fits a pattern."""
    out = dict[str, str]()
    for our_name, their_name in rename.items():
        number = re.fullmatch("#([1-9][0-9]*)", their_name)
        if number and their_name not in names and int(number[1]) <= len(names):
            their_name = names[int(number[1]) - 1]
        if "*" not in their_name or their_name in names:
            out[our_name] = their_name
            continue
        text = re.escape(their_name).replace(r"\*", "([0-9]+)")
        matches = [(m, name) for name in names if (m := re.fullmatch(text, name))]
        columns = sorted((int(match[1]), name) for match, name in matches)
        if not columns:
            near = fnmatch.filter(names, their_name)[:4]
            shown = ", ".join(near) or "none that is numbered"
            what = f"no column {their_name!r} ({shown})"
            remedy = "give a pattern of the file's names"
            raise InputError(what, remedy, command="--rename")
        for k, (_, name) in enumerate(columns, start=1):
            out[f"{our_name.rstrip('*')}{k}"] = name
    return out


def scaled(run: Measurements, factors: Mapping[str, str]) -> Measurements:
    """Convert a run to SI units; angles in degrees that jump by a full turn go on.
    Commands and velocities of which no factor is given follow their positions.

    Parameters
    ----------
    factors : mapping of str to str
        By our names (t, q, q1 ...): a unit, a number, or one number a joint separated
        by colons, as ``--scale q=deg,tau=10:10.7:8.5`` has them; behind @ the reading at
        zero, ``q=0.0879@2048``. InputError names a word that is neither, and a column that
        the run does not have.
    """
    groups = {"t": run.t[:, None], **run.groups}
    given = {*map(group_of, factors)}
    has_commands = "q" in given and "qcmd" in {*groups} - given
    if has_commands and is_in_one_unit(groups["q"], groups["qcmd"]):
        of_q = {x: y for x, y in factors.items() if group_of(x) == "q"}
        factors = {**factors, **{f"qcmd{x[1:]}": y for x, y in of_q.items()}}
    to_si = dict[str, np.ndarray]()
    for our_name in sorted(factors):  # a group's factors, then those of single joints
        group = group_of(our_name)
        require_known("channel", group, groups, "scale")
        n_columns = groups[group].shape[1]
        of_joints = factors_and_zeros(our_name, factors[our_name], n_columns)
        number = our_name.removeprefix(group)
        joints = slice(int(number) - 1, int(number)) if number else slice(None)
        of_group = to_si.setdefault(group, np.repeat([[1.0], [0.0]], n_columns, axis=1))
        of_group[:, joints] = of_joints
    for group, (of_joints, zeros) in to_si.items():
        groups[group] = (groups[group] - zeros) * of_joints
    own = to_si["q"][0] if "q" in to_si else np.ones(run.n)
    clock = groups.pop("t")[:, 0]
    if not given & {"dq", "dqcmd"}:
        groups, said = in_one_unit(clock, groups, own.tolist())
        for text in said:
            warnings.warn(f"{run.names[0]}: {text}", Remark, stacklevel=2)
    in_si = run.with_channels(clock, groups)
    if "tau" in factors:
        in_si = replace(in_si, torque_unit="")
    degrees = [x for x in POSITIONS if x in to_si and UNITS["deg"] in to_si[x][0]]
    return unwrapped(in_si, run.names[0], degrees)


def factors_and_zeros(our_name: str, word: str, n_columns: int) -> np.ndarray:
    """Return the factors and zeros (2, n) of a group's columns that one entry of
    ``--scale`` means, or (2, 1) where all joints have the same, or of one joint,
    "tau2"."""
    values = list[tuple[float, float]]()
    for text in word.split(":"):
        unit, _, zero = text.partition("@")
        factor = UNITS.get(unit.lower()) or _number(our_name, unit)
        values.append((factor, _number(our_name, zero) if zero else 0.0))
    number = our_name.removeprefix(group_of(our_name))  # "2" of "tau2", "" of "tau"
    joint = int(number or 1)
    if not 1 <= joint <= n_columns:
        what = f"--scale {our_name}: the run has no such column"
        raise InputError(what, "name t, q, dq or tau")
    n_named = 1 if number else n_columns
    if len(values) not in (1, n_named):
        what = f"--scale {our_name}={word}: {len(values)} factors"
        raise InputError(
            what, f"give one, or {n_columns}" if n_named > 1 else "give one"
        )
    return np.transpose(values)


def _number(our_name: str, word: str) -> float:
    """Parse a factor; raise InputError for a word that is no number, for zero and
    infinity."""
    try:
        value = float(word)
    except ValueError:
        value = 0.0
    if not value or not np.isfinite(value):
        known = ", ".join(sorted(UNITS))
        remedy = f"give a number other than 0, or a unit: {known}"
        raise InputError(f"--scale {our_name}={word}", remedy)
    return value
