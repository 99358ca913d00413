"""What all formats share: named columns become a run, and no file unpacks to fill the
memory."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.formats.recognition import expanded, taken
from sdp_vs_penalty.data.measurements import COMMANDED, Measurements
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.robot.arrays import Array

#: The header of RUN.csv, in words.
HEADER = (
    "t,q1..qn,dq1..dqn,tau1..taun (dq optional; temp1..tempn, degrees Celsius, too, and"
    " qmot1..qmotn, motors' positions where q are the links'; without tau:"
    " qcmd1..qcmdn, the commanded positions)"
)

#: The groups of columns, in the order in which they are written.
GROUPS = ("q", "dq", "tau", "temp", *COMMANDED)
#: Groups that are taken where they are whole: other logs call other things so.
_WHOLE = ("temp", "current", "voltage")


@dataclass(frozen=True)
class Choice:
    """What of a file to take.

    joints : names of the robot's joints in order, for formats that name theirs; topic :
    of a bag with several; rename : {our name: the file's name} of columns or variables,
    for tables.
    """

    joints: Sequence[str] | None = None
    topic: str | None = None
    rename: Mapping[str, str] | None = None


@contextmanager
def understood(path: str | Path, kind: str, remedy: str) -> Iterator[None]:
    """While a library reads a file, whose every layer fails in ways of its own:
    InputError."""
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise  # the system's: whoever opened the file says so
        what = (str(error).splitlines() or [type(error).__name__])[0][:200]
        if "end magic" in what or "Truncated" in what:
            remedy = "save what is left with `mcap recover`"
        raise InputError(f"not a readable {kind} ({what})", remedy, path) from error


@dataclass(frozen=True)
class Header:
    """Which columns of a file are which channels.

    groups : the file's columns of each of ours (t, q, dq, tau, ...), one a joint or one
    block; factors : by the file's names, where they are not 1; what : how messages call
    the file.
    """

    path: Path
    groups: Mapping[str, Sequence[str]]
    factors: Mapping[str, float]
    what: str

    @classmethod
    def of(
        cls,
        path: str | Path,
        names: Sequence[str],
        choice: Choice = Choice(),
        what: str = "",
        remedy: str = "",
    ) -> Header:
        """Of a file's columns by their names: our own, those that are chosen, else
        those recognised.

        remedy : what to do about missing columns (default: the `convert` command for
        the file). Others are left out with a warning: logs hold accelerations,
        currents, states. Raises InputError where t, q or tau (and qcmd), or one of
        several joints is missing.
        """
        path, what, known = (
            Path(path),
            what or str(path),
            ", ".join(sorted(names)) or "none",
        )
        found = None if choice.rename else taken(path, names, choice.joints)
        rename, scale = (
            (expanded(choice.rename or {}, names), {}) if found is None else found
        )
        for ours, theirs in rename.items():
            if theirs not in names:
                lacking = f"no column {theirs!r} to take as {ours} (columns: {known})"
                raise InputError(lacking, "give --rename a name of the file", what)
        named = {**({} if found else dict(zip(names, names, strict=True))), **rename}
        groups = {g: own for g in ("t", *GROUPS) if (own := _columns(named, g, what))}
        needed = ("t", "q") if "qcmd" in groups else ("t", "q", "tau")
        missing = [group for group in needed if group not in groups]
        if missing:
            pairs = ",".join(f"{group}=NAME" for group in missing)
            command = (
                f"name them with `sdp-vs-penalty convert {path} --rename {pairs} --out"
                " run.csv`"
            )
            lacking = f"no column {' or '.join(missing)} (columns: {known})"
            raise InputError(lacking, remedy or command, what)
        count = Counter(names)
        for name in (name for columns in groups.values() for name in columns):
            if count.pop(name) > 1:
                raise InputError(
                    f"column {name} comes twice", "rename one of them", what
                )
        if count and not rename:
            # Accelerations are the one kind of column that people expect to be read.
            known_too = any(
                re.fullmatch(r"(ddq|qdd|acc)_?[0-9]*", name.lower()) for name in count
            )
            why = (
                ". Accelerations are computed from q, with the same filter as the"
                " torque" * known_too
            )
            shown = ", ".join(
                name[:40] or "a column without a name" for name in list(count)[:6]
            )
            more = f" and {len(count) - 6} more" if len(count) > 6 else ""
            warnings.warn(
                f"{path}: not used: {shown}{more}{why}.", Remark, stacklevel=2
            )
        return cls(path, groups, {rename[ours]: x for ours, x in scale.items()}, what)

    def run(self, columns: Mapping[str, Array]) -> Measurements:
        """The run, or a piece of it, of columns (N,) or blocks (N, n) by the file's
        names.

        Raises InputError where lengths or numbers of joints differ.
        """
        own = {
            group: [
                self.factors.get(n, 1.0) * np.asarray(columns[n], float) for n in names
            ]
            for group, names in self.groups.items()
        }
        t = np.ravel(own.pop("t")[0])
        blocks = {
            group: self._block(group, parts, len(t)) for group, parts in own.items()
        }
        for (
            group
        ) in _WHOLE:  # what else a file calls temp is no temperature of its joints
            if group in blocks and blocks[group].shape != blocks["q"].shape:
                del blocks[group]
        widths = {group: block.shape[1] for group, block in blocks.items()}
        if len(set(widths.values())) != 1:
            found = ", ".join(f"{group} {width}" for group, width in widths.items())
            what = f"the groups have different numbers of joints: {found}"
            raise InputError(what, "give q, dq and tau a column a joint", self.what)
        return Measurements.of(t, blocks, (self.path.name,))

    def _block(self, group: str, parts: Sequence[Array], count: int) -> Array:
        block = parts[0]
        if block.ndim > 2:
            what = f"{group} has {block.ndim} dimensions"
            raise InputError(what, "give it 2: samples and joints", self.what)
        if len(parts) == 1 and block.ndim == 2:
            parts = list(
                block.T if len(block) == count or block.shape[1] != count else block
            )
        for part in parts:
            if part.size != count:
                what = f"{group} has {part.size} rows, t has {count}"
                raise InputError(what, "give each as many rows as t", self.what)
        return np.column_stack([np.ravel(part) for part in parts])


def _columns(named: Mapping[str, str], group: str, what: str) -> list[str]:
    """The file's columns of a group: one that is called so, or q1, q2, ..., one a
    joint."""
    if group in named:
        return [named[group]]
    found = [re.fullmatch(rf"{group}([1-9][0-9]{{0,3}})", name) for name in named]
    numbers = sorted(int(m[1]) for m in found if m)
    gap = next((k for k, number in enumerate(numbers, 1) if k != number), None)
    if gap is None:
        return [named[f"{group}{k}"] for k in numbers]
    if group in _WHOLE:  # temperatures of some joints are none of the others
        return []
    lacking = f"no column {group}{gap}, but {group}{numbers[-1]}"
    raise InputError(lacking, "give each joint a column", what)


def columns_of(measurements: Measurements) -> dict[str, Array]:
    """The columns of a run by the names of RUN.csv."""
    m = measurements
    out = {"t": m.t}
    for name, block in m.groups.items():
        out |= {f"{name}{j + 1}": block[:, j] for j in range(m.n)}
    return out
