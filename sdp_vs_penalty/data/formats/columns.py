"""What all formats share: named columns become a run, and no file unpacks to fill the
memory."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.formats.recognition import (
    CellTable,
    counted_from_zero,
    expanded,
    find_clock,
    parts_of,
    recognise_and_warn,
)
from sdp_vs_penalty.data.formats.stamps import second_part_unit
from sdp_vs_penalty.data.measurements import COMMANDED, Measurements, gathered
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
    for tables; rate : samples a second [Hz], in place of the file's clock.
    """

    joints: Sequence[str] | None = None
    topic: str | None = None
    rename: Mapping[str, str] | None = None
    rate: float | None = None


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
        block; of t two where a stamp is in two parts, none without a clock; factors : by
        the file's names, where they are not 1; what : how messages call the file; angles :
    XX : the column that counts runs; rate : in place of a clock
        [Hz].
    """

    path: Path
    groups: Mapping[str, Sequence[str]]
    factors: Mapping[str, float]
    what: str
    names: Sequence[str] = ()
    order: Sequence[int] | None = None
    rate: float | None = None
    episode: str | None = None
    joints: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        path: str | Path,
        names: Sequence[str],
        choice: Choice = Choice(),
        what: str = "",
        remedy: str = "",
        table: CellTable | None = None,
    ) -> Header:
        """Of a file's columns by their names: our own, those that are chosen, else
        those recognised.

        remedy : what to do about missing columns (default: the `convert` command for
        the file); table : what its columns hold. Others are left out with a warning:
        logs hold accelerations, currents, states. Raises InputError where q or tau (and
        qcmd), or one of several joints is missing; where t is, :meth:`run` does.
        """
        path, what = Path(path), what or str(path)
        recognition = (
            None if choice.rename else recognise_and_warn(path, names, choice, table)
        )
        if recognition is None and not choice.rename and counted_from_zero(names):
            shown = brief_names(names)
            lacking = f"columns are counted from 0, and not alike (columns: {shown})"
            command = _rename_command(path, ["q", "tau"])
            raise InputError(lacking, remedy or command, what)
        rename = (
            expanded(choice.rename or {}, names)
            if recognition is None
            else recognition.rename
        )
        for our_name, their_name in rename.items():
            for name in parts_of(their_name, names):
                if name not in names:
                    lacking = (
                        f"no column {name!r} to take as {our_name} (columns:"
                        f" {brief_names(names)})"
                    )
                    raise InputError(lacking, "give --rename a name of the file", what)
        named = {
            **({} if recognition else dict(zip(names, names, strict=True))),
            **rename,
        }
        groups = {
            g: columns_of_group
            for g in GROUPS
            if (columns_of_group := _columns(named, g, what))
        }
        if "t" in named:
            groups = {"t": list(parts_of(named["t"], names)), **groups}
        elif choice.rename and (clock := find_clock(names)):
            groups = {"t": list(parts_of(clock, names)), **groups}
        needed = ("q",) if "qcmd" in groups else ("q", "tau")
        missing = [group for group in needed if group not in groups]
        if missing:
            missing = [g for g in ("t", "q", "tau") if g in missing or g not in groups]
            if "qcmd" in groups:
                missing.remove("tau")
            lacking = (
                f"no column {' or '.join(missing)} (columns: {brief_names(names)})"
            )
            raise InputError(lacking, remedy or _rename_command(path, missing), what)
        count = Counter(names)
        for name in (name for columns in groups.values() for name in columns):
            if count.pop(name, 0) > 1:
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
        scale = recognition.scale if recognition else {}
        factors = {
            rename[our_name]: x for our_name, x in scale.items() if our_name != "t"
        }
        for k, name in enumerate(groups.get("t", ())):
            factors[name] = second_part_unit(name) if k else scale.get("t", 1.0)
        order = recognition.order if recognition else None
        episode = recognition.episode if recognition else None
        joints = recognition.joints if recognition else ()
        return cls(
            path, groups, factors, what, names, order, choice.rate, episode, joints
        )

    @property
    def columns(self) -> list[str]:
        """The file's columns that are read."""
        clock = () if self.rate is not None else self.groups.get("t", ())
        channels = [
            n for g, columns in self.groups.items() if g != "t" for n in columns
        ]
        return [*clock, *channels]

    def run(self, columns: Mapping[str, Array]) -> Measurements:
        """The run, or a piece of it, of columns (N,) or blocks (N, n) by the file's
        names.

        Raises InputError where lengths or numbers of joints differ, or no clock is
        known.
        """
        groups_read = {
            group: [
                self.factors.get(n, 1.0) * np.asarray(columns[n], float) for n in names
            ]
            for group, names in self.groups.items()
            if group != "t"
        }
        t = self._clock(columns, groups_read)
        blocks = {
            group: self._block(group, parts, len(t))
            for group, parts in groups_read.items()
        }
        for (
            group
        ) in _WHOLE:  # what else a file calls temp is no temperature of its joints
            if group in blocks and blocks[group].shape != blocks["q"].shape:
                del blocks[group]
        widths = {group: block.shape[1] for group, block in blocks.items()}
        if len(set(widths.values())) != 1:
            width_words = ", ".join(
                f"{group} {width}" for group, width in widths.items()
            )
            what = f"the groups have different numbers of joints: {width_words}"
            raise InputError(what, "give q, dq and tau a column a joint", self.what)
        if self.order is not None and len(blocks["q"]):
            blocks = {group: block[:, self.order] for group, block in blocks.items()}
        return Measurements.of(t, blocks, (self.path.name,))

    def gather(self, pieces: Iterable[Measurements]) -> Measurements:
        """The run of consecutive pieces; episodes come one after the other, a second
        apart."""
        run = replace(gathered(pieces), joint_names=self.joints)
        if self.episode is None or len(run.t) < 2:
            return run
        steps = np.diff(run.t)
        is_start = steps <= 0.0
        if is_start.any():
            shift = np.concatenate(
                [[0.0], np.cumsum(np.where(is_start, 1.0 - steps, 0.0))]
            )
            episodes = formatting.count(int(is_start.sum()) + 1, "episode")
            warning = f"{self.path}: {episodes} one after the other, a second apart"
            warnings.warn(warning, Remark, stacklevel=2)
            run = replace(run, t=run.t + shift)
        return run

    def _clock(
        self, columns: Mapping[str, Array], groups_read: Mapping[str, Sequence[Array]]
    ) -> Array:
        """(N,) s: of one column, the sum of a stamp's two parts, or of the rate."""
        clock = self.groups.get("t", ())
        if clock and self.rate is None:
            parts = [
                self.factors.get(n, 1.0) * np.ravel(np.asarray(columns[n], float))
                for n in clock
            ]
            return np.sum(parts, axis=0) if len(parts) > 1 else parts[0]
        first = groups_read["q"][0]
        count = max(first.shape) if first.ndim == 2 else len(first)
        if self.rate is not None:
            return np.arange(count) / self.rate
        if count and not all(part.size == 0 for part in groups_read["q"]):
            raise self._no_clock(groups_read)
        return np.zeros(count)

    def _no_clock(self, groups_read: Mapping[str, Sequence[Array]]) -> InputError:
        """The error of a file without a clock: the rate is proposed where velocities
        tell it."""
        rate = None
        why = "HZ being its samples a second"
        if "dq" in groups_read:
            q, dq = (
                np.column_stack(
                    [np.reshape(x, (len(x), -1)) for x in groups_read[group]]
                )
                for group in ("q", "dq")
            )
            rate = rate_from_velocities(q, dq) if q.shape == dq.shape else None
        if rate is not None:
            why = "dq is the derivative of q at this rate"
        command = formatting.convert_command(
            self.path, "--rate", "HZ" if rate is None else f"{rate:g}"
        )
        lacking = f"no column t (columns: {brief_names(self.names)})"
        remedy = (
            f"give its rate with `{command}` ({why}), or name its clock with --rename"
            " t=NAME"
        )
        return InputError(lacking, remedy, self.what)

    def _block(self, group: str, parts: Sequence[Array], count: int) -> Array:
        block = parts[0]
        if block.ndim > 2:
            what = f"{group} has {block.ndim} dimensions"
            raise InputError(what, "give it 2: samples and joints", self.what)
        if len(parts) == 1 and block.ndim == 2:
            across = len(block) == count or block.shape[1] != count
            parts = list(block.T if across else block)
        if not parts:
            what = f"{group} has no columns, so there are no joints"
            raise InputError(what, "give q, dq and tau a column a joint", self.what)
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
    matches = [re.fullmatch(rf"{group}([1-9][0-9]{{0,3}})", name) for name in named]
    numbers = sorted(int(m[1]) for m in matches if m)
    gap = next((k for k, number in enumerate(numbers, 1) if k != number), None)
    if gap is None:
        return [named[f"{group}{k}"] for k in numbers]
    if group in _WHOLE:  # temperatures of some joints are none of the others
        return []
    lacking = f"no column {group}{gap}, but {group}{numbers[-1]}"
    raise InputError(lacking, "give each joint a column", what)


def _rename_command(path: Path, missing: Sequence[str]) -> str:
    """What names the columns that are missing."""
    pairs = ",".join(f"{group}=NAME" for group in missing)
    command = formatting.convert_command(path, "--rename", pairs)
    return f"name them with `{command}` (columns of joints as '{missing[-1]}*=NAME_*')"


def brief_names(names: Sequence[str]) -> str:
    """The names of columns in order, those that differ by their numbers as one.

    >>> brief_names(["t", "q_0", "q_1", "q_2"])
    'q_0..2, t'
    """
    families: dict[tuple[str, str], list[int]] = {}
    for name in names:
        match = re.fullmatch(r"(.*?)([0-9]+)([^0-9]*)", name)
        stem = (match[1], match[3]) if match else (name, "")
        families.setdefault(stem, []).extend([int(match[2])] if match else [])
    shown = []
    for (head, tail), numbers in families.items():
        counts = sorted(set(numbers))
        if len(counts) > 2 and counts == list(range(counts[0], counts[-1] + 1)):
            shown.append(f"{head}{counts[0]}..{counts[-1]}{tail}")
        else:
            shown += [f"{head}{k}{tail}" for k in counts] or [head]
    return ", ".join(sorted(name[:40] for name in shown)) or "none"


def rate_from_velocities(q: Array, dq: Array) -> float | None:
    """Samples a second [Hz] at which velocities (N, n) are the derivative of positions
    (N, n), to three digits; None where they are not at any.

    Least squares of the steps of q on the mean velocity between them: step = dq / rate.
    """
    steps = np.diff(q, axis=0)
    mean = 0.5 * (dq[1:] + dq[:-1])
    usable = np.isfinite(steps).all(axis=1) & np.isfinite(mean).all(axis=1)
    steps = steps[usable]
    mean = mean[usable]
    energy = float(np.sum(mean**2))
    way = float(np.sum(steps**2))
    common = float(np.sum(steps * mean))
    if not energy * way > 0.0 or common**2 < 0.9 * energy * way or common <= 0.0:
        return None
    return float(f"{energy / common:.3g}")


def columns_of(measurements: Measurements) -> dict[str, Array]:
    """The columns of a run by the names of RUN.csv."""
    m = measurements
    out = {"t": m.t}
    for name, block in m.groups.items():
        out |= {f"{name}{j + 1}": block[:, j] for j in range(m.n)}
    return out
