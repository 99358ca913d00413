"""Our names for the columns of a table that names none."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.catalogue import fetch_remedy
from sdp_vs_penalty.data.formats.columns import HEADER, Choice, rate_from_velocities
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

#: What research code writes of each joint, the commonest first.
_GROUPS: tuple[tuple[str, ...], ...] = (("q", "dq", "tau"), ("q", "tau"))


def names_without_header(
    path: Path,
    width: int,
    choice: Choice,
    read_columns: Callable[[], Mapping[str, Array]],
) -> list[str]:
    """Name the columns of a table without a header: q1..qn, dq1..dqn, tau1..taun, as
    research code writes them, with t in front where one column more is there.

    Parameters
    ----------
    path : Path
        How messages call the file.
    choice : Choice
        The rate that replaces a clock, and the robot's joints.
    read_columns : callable
        Returns the columns (N,) in their order. Called for the error message alone,
        which proposes a rate.

    Raises
    ------
    InputError
        No rate is given (a rate shows that the user knows what the columns are), or the
        number of columns is not a multiple of the channel groups, or each of the
        robot's joints has more columns than three.
    """
    n_joints = None if choice.joints is None else len(choice.joints)
    layout = _layout(width, n_joints)
    known_rate = None if choice.rate is None else f"{choice.rate:g}"
    if n_joints is not None and _has_more_groups(width, n_joints):
        raise _ambiguous(path, width, n_joints, known_rate, read_columns)
    if choice.rate is None:
        raise _no_header(path, layout, read_columns)
    if layout is None:
        remedy = "keep q, dq and tau of each joint, or name columns by --rename q1=#2"
        raise InputError(f"{width} columns are not three a joint", remedy, path)
    return layout


def _no_header(
    path: Path,
    layout: list[str] | None,
    read_columns: Callable[[], Mapping[str, Array]],
) -> InputError:
    """Return the error of a table without a header, with the command that names its
    columns.

    ``layout`` holds the proposed names, one a column; None where the number of columns
    fits no layout. A raw file of a public data set is recognised by its name: then the
    error says how to fetch the converted one.
    """
    problem = "row 1 holds numbers instead of a header"
    how_to_fetch = fetch_remedy(path)
    if how_to_fetch is not None:
        return InputError(problem, how_to_fetch, path)
    remedy = f"put {HEADER} above them, or "
    if layout is None:
        remedy += "name columns by their numbers with `convert --rename t=#1,q1=#2`"
        return InputError(problem, remedy, path)
    words = _convert_words(layout, None, read_columns)
    has_clock = layout[0] == "t"
    groups = [name for name in ("t", "q", "dq", "tau") if f"{name}1" in layout]
    groups = ["t", *groups] if has_clock else groups
    shown = f"{', '.join(groups[:-1])} and {groups[-1]}"
    command = formatting.convert_command(path, *words)
    return InputError(
        problem, f"{remedy}where its columns are {shown}, `{command}`", path
    )


def _has_more_groups(width: int, n_joints: int) -> bool:
    """Whether a table has more columns than q, dq and tau of a robot of several joints,
    as many of each joint, with or without a clock."""
    n_groups, n_left = divmod(width, n_joints)
    return n_joints > 1 and n_left <= 1 and n_groups > len(_GROUPS[0])


def _ambiguous(
    path: Path,
    width: int,
    n_joints: int,
    known_rate: str | None,
    read_columns: Callable[[], Mapping[str, Array]],
) -> InputError:
    """Return the error of a table without a header that has more columns of each of the
    robot's joints than q, dq and tau: which is which, their number does not tell.

    ``known_rate`` [Hz]: as the user gave it.
    """
    n_groups, n_clocks = divmod(width, n_joints)
    clock = ["t"] * n_clocks
    layout = clock + _names(n_joints, _GROUPS[0])
    a_clock = "a clock and " if n_clocks else ""
    command = formatting.convert_command(
        path, *_convert_words(layout, known_rate, read_columns)
    )
    return InputError(
        f"row 1 holds numbers instead of a header, and {width} columns may be {a_clock}"
        f"{n_groups} columns of each of {n_joints} joints",
        "say which of them are q, dq and tau: where they come first, in this order,"
        f" `{command}`",
        path,
    )


def _convert_words(
    layout: Sequence[str],
    known_rate: str | None,
    read_columns: Callable[[], Mapping[str, Array]],
) -> list[str]:
    """Return the options of `convert` that name columns as a layout does; without a
    clock also the rate [Hz], estimated where it is not known."""
    pairs = ",".join(f"{name}=#{k}" for k, name in enumerate(layout, 1))
    words = ["--rename", pairs]
    if layout[0] != "t":
        columns = list(read_columns().values())
        words += ["--rate", known_rate or _rate_word(layout, columns)]
    return words


def _names(n_joints: int, groups: Sequence[str]) -> list[str]:
    """Return the names of channel groups of n joints: q1 ... qn, dq1 ..."""
    return [f"{group}{k}" for group in groups for k in range(1, n_joints + 1)]


def _rate_word(layout: Sequence[str], columns: Sequence[Array]) -> str:
    """Return the sampling rate [Hz] at which dq is the derivative of q, as a word of a
    command; the placeholder "HZ" where no rate fits."""
    columns_of_group: dict[str, list[Array]] = {"q": [], "dq": []}
    for name, column in zip(layout, columns, strict=False):
        group = name.rstrip("0123456789")  # "dq" of "dq3"
        if group in columns_of_group:
            columns_of_group[group].append(column)
    if not all(columns_of_group.values()):
        return "HZ"
    q = np.stack(columns_of_group["q"], axis=1)
    dq = np.stack(columns_of_group["dq"], axis=1)
    rate = rate_from_velocities(q, dq)
    return "HZ" if rate is None else f"{rate:g}"


def _layout(width: int, n_joints: int | None) -> list[str] | None:
    """Return names for the columns of a table without a header; None where no layout
    fits.

    A layout has q, dq and tau, or q and tau, of n joints, with or without a clock in
    front. The layout with the robot's number of joints is taken, else the first with q,
    dq and tau.
    """
    # Number of clocks, number of joints, and channel groups of each layout that fits.
    layouts = list[tuple[int, int, tuple[str, ...]]]()
    for n_clocks in (0, 1):
        for groups in _GROUPS:
            n, n_left = divmod(width - n_clocks, len(groups))
            if n > 0 and n_left == 0:
                layouts.append((n_clocks, n, groups))
    of_robot = [layout for layout in layouts if layout[1] == n_joints]
    with_velocities = [layout for layout in layouts if layout[2] == _GROUPS[0]]
    candidates = of_robot or with_velocities
    if not candidates:
        return None
    n_clocks, n, groups = candidates[0]
    return ["t"] * n_clocks + _names(n, groups)
