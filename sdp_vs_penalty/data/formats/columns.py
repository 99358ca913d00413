"""What all formats share: named columns become a run, and no file unpacks to fill the memory."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.formats.recognition import expanded, taken
from sdp_vs_penalty.data.measurements import COMMANDED, Measurements
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.robot.arrays import Array

#: The header of RUN.csv, in words.
HEADER = (
    "t,q1..qn,dq1..dqn,tau1..taun (dq optional; temp1..tempn, degrees Celsius, too; without tau: "
    "qcmd1..qcmdn, the commanded positions)"
)

#: The groups of columns, in the order in which they are written.
GROUPS = ("q", "dq", "tau", "temp", *COMMANDED)
#: Groups that are taken where they are whole: other logs call other things so.
_WHOLE = ("temp", "current", "voltage")

#: Numbers of one file above which it is refused: 4 GiB of doubles.
LARGEST = 2**29


#: A bomb is a file that unpacks to more bytes than this, and to so many times its size: zeros reach
#: 1000, measured channels 3 to 20.
_WORTH_A_LOOK, _TIGHTEST = 2**27, 200


@dataclass(frozen=True)
class Choice:
    """What of a file to take.

    joints : names of the robot's joints in order, for formats that name theirs; topic : of a bag with
    several; rename : {our name: the file's name} of columns or variables, for tables.
    """

    joints: Sequence[str] | None = None
    topic: str | None = None
    rename: Mapping[str, str] | None = None


def check_size(path: Path, unpacked: int, packed: int) -> None:
    """InputError for a compressed file that would fill the memory; sizes in bytes."""
    if unpacked > 8 * LARGEST:
        raise InputError(
            f"unpacks to {unpacked / 2**30:.0f} GiB", "split it into files below 4 GiB", path
        )
    if unpacked > _WORTH_A_LOOK and unpacked > _TIGHTEST * packed:
        raise InputError(
            (f"unpacks from {packed / 2**20:.1f} to {unpacked / 2**20:.0f} MiB, unlike measurements"),
            "name a file of measurements",
            path,
        )


def from_columns(
    path: str | Path,
    columns: Mapping[str, Array],
    rename: Mapping[str, str] | None,
    *,
    remedy: str | None = None,
    what: str | None = None,
) -> Measurements:
    """A run from named columns (N,) or blocks (N, n): t, q or q1..qn, dq, tau, ...; no others.

    path : names the run; what : how messages call it (default: the path); remedy : what to do about
    missing columns (default: the `convert` command for the file).
    Raises InputError where t, q or tau (and qcmd) is missing, or lengths differ.
    """
    what = what or str(path)
    found = None if rename else taken(Path(path), list(columns), None)
    if found is not None:
        scaled = ((n, o, found.scale.get(o, 1.0)) for o, n in found.rename.items())
        columns = {n: columns[n] if x == 1.0 else columns[n] * x for n, o, x in scaled}
        rename = found.rename
    names = expanded(rename or {}, list(columns))
    for ours, theirs in names.items():
        if theirs not in columns:
            known = ", ".join(sorted(columns)) or "none"
            raise InputError(
                f"no column {theirs!r} to take as {ours} (columns: {known})",
                "give --rename a name of the file",
                what,
            )
    named = {**columns, **{ours: columns[theirs] for ours, theirs in names.items()}}

    given = {"t": named.get("t"), **{group: _block(named, group, what) for group in GROUPS}}
    wanted = {"t", "q", "tau"} - ({"tau"} if given["qcmd"] is not None else set())
    missing = [g for g, block in given.items() if block is None and g in wanted]
    if missing:
        known = ", ".join(sorted(columns)) or "none"
        pairs = ",".join(f"{group}=NAME" for group in missing)
        command = f"name them with `sdp-vs-penalty convert {path} --rename {pairs} --out run.csv`"
        raise InputError(f"no column {' or '.join(missing)} (columns: {known})", remedy or command, what)
    t = np.ravel(named["t"])
    for group in _WHOLE:  # what else a file calls temp is no temperature of its joints
        block = given[group]
        if block is not None and given["q"] is not None and block.shape != given["q"].shape:
            given[group] = None
    blocks = {}
    for group in GROUPS:
        block = given[group]
        if block is None:
            continue
        if block.shape[0] != len(t) and block.ndim == 2 and block.shape[1] == len(t):
            block = block.T
        if block.shape[0] != len(t):
            raise InputError(
                f"{group} has {block.shape[0]} rows, t has {len(t)}", "give each as many rows as t", what
            )
        blocks[group] = np.ascontiguousarray(block)
    widths = {group: block.shape[1] for group, block in blocks.items()}
    if len(set(widths.values())) != 1:
        raise InputError(
            "the groups have different numbers of joints: "
            + ", ".join(f"{group} {width}" for group, width in widths.items()),
            "give q, dq and tau a column a joint",
            what,
        )
    return run_of(path, t, blocks)


def run_of(path: str | Path, t: Array, blocks: Mapping[str, Array]) -> Measurements:
    """A run of the file's name from its blocks (N, n) by name."""
    return Measurements.of(t, blocks, (Path(path).name,))


def _block(named: Mapping[str, Array], group: str, what: str) -> Array | None:
    if group in named:
        block = np.asarray(named[group], float)
        return block[:, None] if block.ndim == 1 else block
    numbers = sorted(
        int(m[1]) for name in named if (m := re.fullmatch(rf"{group}([1-9][0-9]{{0,3}})", name))
    )
    gap = next((k for k, number in enumerate(numbers, 1) if k != number), None)
    if gap is not None and group not in _WHOLE:  # temperatures of some joints are none of the others
        raise InputError(
            f"no column {group}{gap}, but {group}{numbers[-1]}", "give each joint a column", what
        )
    if not numbers or gap is not None:
        return None
    columns = [np.ravel(named[f"{group}{k}"]) for k in numbers]
    if len({len(c) for c in columns}) != 1:
        return None
    return np.column_stack(columns)


def columns_of(measurements: Measurements) -> dict[str, Array]:
    """The columns of a run by the names of RUN.csv."""
    m = measurements
    out = {"t": m.t}
    for name, block in m.groups.items():
        out |= {f"{name}{j + 1}": block[:, j] for j in range(m.n)}
    return out


def groups_of(path: Path, names: Sequence[str]) -> tuple[int, list[str]]:
    """Number of joints and the groups there are, from a header; InputError where it is incomplete.

    Columns of other names are left out with a warning: logs hold accelerations, currents, states.
    """
    found = {int(m[1]) for name in names if (m := re.fullmatch(r"q([1-9][0-9]{0,3})", name))}
    if not found:
        raise InputError("row 1 names no column q1", f"write the header {HEADER}", path)
    n = max(found)
    there = {g for g in GROUPS if any(re.fullmatch(rf"{g}[0-9]+", name) for name in names)}
    for group in ("current", "voltage"):  # currents of some joints are none of the others
        if not {f"{group}{j + 1}" for j in range(n)} <= set(names):
            there.discard(group)
    needed = {"q", "tau"} if "qcmd" not in there else {"q"}
    groups = [g for g in GROUPS if g in there | needed]
    wanted = ["t", *(f"{group}{j + 1}" for group in groups for j in range(n))]
    for name in wanted:
        if names.count(name) != 1:
            problem = "is missing" if names.count(name) == 0 else "comes twice"
            raise InputError(
                f"column {name} {problem} (header: {','.join(names)[:120]})",
                f"write the header {HEADER}",
                path,
            )
    others = [name for name in names if name not in wanted]
    beyond = next((x for x in others if re.fullmatch(rf"({'|'.join(GROUPS)})[0-9]+", x)), None)
    if beyond is not None:
        raise InputError(f"column {beyond} has no q beside it", "give each joint a column q", path)
    if others:
        # Accelerations are the one kind of column that people expect to be read.
        known = any(re.fullmatch(r"(ddq|qdd|acc)_?[0-9]*", name.lower()) for name in others)
        why = (
            ". Accelerations are computed from q, with the same filter as the torque." if known else "."
        )
        warnings.warn(f"{path}: not used: {_listed(others)}{why}", Remark, stacklevel=2)
    return n, groups


def _listed(names: Sequence[str]) -> str:
    """At most six columns by name."""
    shown = ", ".join(name[:40] or "a column without a name" for name in names[:6])
    return f"{shown} and {len(names) - 6} more" if len(names) > 6 else shown
