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
    """Name the columns of a table without a header: q, dq and tau of each joint, as
    research code writes them.

    Parameters
    ----------
    path : Path
        How messages call the file.
    width : int
        How many columns it has.
    choice : Choice
        With the rate that stands in for a clock, and the robot's joints.
    read_columns : callable
        Returns the columns (N,) in their order, of which a message proposes a rate.

    Returns
    -------
    list of str
        One name a column.

    Raises
    ------
    InputError
        No rate is given, which would show that somebody knows what the columns are; or
        the columns are not three a joint.
    """
    layout = _layout(width, None if choice.joints is None else len(choice.joints))
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
    """The error of a table whose first row holds numbers, with the command that names
    its columns."""
    problem = "row 1 holds numbers instead of a header"
    public = fetch_remedy(path)
    if public is not None:
        return InputError(problem, public, path)
    remedy = f"put {HEADER} above them, or "
    if layout is None:
        remedy += "name columns by their numbers with `convert --rename t=#1,q1=#2`"
        return InputError(problem, remedy, path)
    words = [
        "--rename",
        ",".join(f"{name}=#{k}" for k, name in enumerate(layout, 1)),
    ]
    has_clock = layout[0] == "t"
    if not has_clock:
        words += [
            "--rate",
            _rate_word(layout, list(read_columns().values())),
        ]
    groups = [name for name in ("t", "q", "dq", "tau") if f"{name}1" in layout]
    groups = ["t", *groups] if has_clock else groups
    shown = f"{', '.join(groups[:-1])} and {groups[-1]}"
    command = formatting.convert_command(path, *words)
    return InputError(
        problem,
        f"{remedy}where its columns are {shown}, `{command}`",
        path,
    )


def _rate_word(layout: Sequence[str], columns: Sequence[Array]) -> str:
    """The rate at which velocities are the derivative of positions, "HZ" without."""
    blocks = [
        [
            x
            for name, x in zip(layout, columns, strict=False)
            if name.rstrip("0123456789") == group
        ]
        for group in ("q", "dq")
    ]
    if not all(blocks):
        return "HZ"
    positions, velocities = blocks
    rate = rate_from_velocities(
        np.stack(positions, axis=1), np.stack(velocities, axis=1)
    )
    return "HZ" if rate is None else f"{rate:g}"


def _layout(width: int, n_joints: int | None) -> list[str] | None:
    """Our names of so many columns: those of the robot's number of joints, else of
    three groups; None where neither fits."""
    layouts = list[tuple[int, int, tuple[str, ...]]]()
    for n_clocks in (0, 1):
        for groups in _GROUPS:
            n, n_left = divmod(width - n_clocks, len(groups))
            if n > 0 and n_left == 0:
                layouts.append((n_clocks, n, groups))
    of_robot = [layout for layout in layouts if layout[1] == n_joints]
    of_three = [layout for layout in layouts if layout[2] == _GROUPS[0]]
    usual = of_robot or of_three
    if not usual:
        return None
    n_clocks, n, groups = usual[0]
    clock = ["t"] * n_clocks
    return clock + [f"{group}{k}" for group in groups for k in range(1, n + 1)]
