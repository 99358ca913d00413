"""What all formats share: named columns become a run, and no file unpacks to fill the
memory."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from errno import EINVAL
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.formats.inferred_units import ROWS_JUDGED, decide_units
from sdp_vs_penalty.data.formats.recognition import (
    AmbiguousColumnsError,
    CellTable,
    Recognition,
    columns_of_joint_names,
    counted_from_zero,
    episode_of,
    find_clock,
    has_our_names,
    recognise,
)
from sdp_vs_penalty.data.formats.renaming import (
    expanded,
    group_of,
    parts_of,
    scale_words,
)
from sdp_vs_penalty.data.formats.stamps import past_midnight, units_of_parts
from sdp_vs_penalty.data.formats.units import UNITS
from sdp_vs_penalty.data.formats.wrapping import POSITIONS, unwrapped
from sdp_vs_penalty.data.measurements import COMMANDED, Measurements, gathered
from sdp_vs_penalty.errors import ColumnsRemark, InputError, Remark
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
#: Rows that are shown of columns that were guessed.
_ROWS_SHOWN = 5
#: No robot measures a larger number, and its square would overflow.
_LARGEST_SQUARABLE = 1e100


@dataclass(frozen=True)
class Choice:
    """What of a file to take."""

    #: Names of the robot's joints in order, for formats that name theirs.
    joints: Sequence[str] | None = None
    #: Topic of a bag that has several.
    topic: str | None = None
    #: The file's names of columns or variables by ours, for tables.
    rename: Mapping[str, str] | None = None
    #: Sampling rate [Hz] in place of the file's clock.
    rate: float | None = None
    #: Factors by our names of the `convert` command that is running, for the command
    #: that repeats it.
    scale: Mapping[str, str] | None = None
    #: Further words of that command.
    options: Sequence[str] = ()


@contextmanager
def understood(path: str | Path, kind: str, remedy: str) -> Iterator[None]:
    """Turn the failures of a library that reads a file into InputError.

    Parameters
    ----------
    kind : str
        How messages call such a file.
    remedy : str
        What to do about a broken file.

    Returns
    -------
    Iterator[None]
        A context to read the file in. Each library raises exceptions of its own, so all
        but memory and operating-system errors are turned.
    """
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as error:
        # EINVAL is a place that the file names and does not have.
        is_systems = isinstance(error, OSError) and error.errno not in (None, EINVAL)
        if is_systems:
            raise  # whoever opened the file says so
        lines = str(error).splitlines()
        what = lines[0][:200] if lines else type(error).__name__
        is_cut_bag = "end magic" in what or "Truncated" in what
        if is_cut_bag:
            remedy = "save what is left with `mcap recover`"
        raise InputError(f"not a readable {kind} ({what})", remedy, path) from error


@dataclass(frozen=True)
class Header:
    """Which columns of a file are which channels, and how they become SI units."""

    #: Path of the file.
    path: Path
    #: The file's columns by channel group (t, q, dq, tau ...): one a joint, or one
    #: block; several of t where a stamp is in parts; no entry of t without a clock.
    groups: Mapping[str, Sequence[str]]
    #: Factors to SI by the file's names, where they are not 1.
    factors: Mapping[str, float]
    #: How messages call the file.
    what: str
    #: Names of all columns of the file.
    names: Sequence[str] = ()
    #: Place in a block of each of the robot's joints, where the orders differ.
    order: Sequence[int] | None = None
    #: Sampling rate that replaces a clock [Hz].
    rate: float | None = None
    #: Name of the column that counts runs.
    episode: str | None = None
    #: Names of the joints, where the file says them.
    joints: tuple[str, ...] = ()
    #: The columns and units that were guessed; None where names are ours or were chosen.
    recognition: Recognition | None = None
    #: What the user asked for.
    choice: Choice = Choice()
    #: What to do about missing columns of data in memory; "" for a file.
    remedy: str = ""

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
        """Find the channels among a file's columns: by the names that the user chose,
        by the names of RUN.csv, or by recognising a foreign log.

        Parameters
        ----------
        choice : Choice
            The robot's joints, the columns chosen by ``--rename``, and the rate.
        what : str
            How messages call the file; its path by default.
        remedy : str
            What to do about missing columns of what is no file; by default the
            `convert` command that names them.
        table : CellTable, optional
            Kinds and first cells of the columns, for the recogniser.

        Returns
        -------
        Header
            The columns of each channel group.

        Raises
        ------
        InputError
            Positions, torques (and commands), or one of several joints is missing. A
            missing clock is raised by :meth:`run`, which knows the velocities that show
            the rate.
        """
        path = Path(path)
        what = what or str(path)
        recognition = None
        if not choice.rename:
            recognition = recognise_file(path, names, choice.joints, table, remedy)
        rename = expanded(choice.rename or {}, names)
        if recognition is not None:
            rename = recognition.rename
        elif not choice.rename and counted_from_zero(names):
            problem = "columns are counted from 0, and not alike"
            raise _lacking(path, names, problem, ["q", "tau"], what, remedy)
        _require_columns(rename, names, what)
        groups = _groups(rename, names, choice, recognition is not None, what)
        missing = _missing_groups(groups)
        if missing:
            problem = f"no column {' or '.join(missing)}"
            raise _lacking(path, names, problem, missing, what, remedy, choice.joints)
        unused = _unused_columns(groups, names, what)
        if unused and not rename:
            _say_unused(path, unused)
        # Loggers are read only where a column is left that may count runs.
        if recognition is not None:
            episode = recognition.episode
        else:
            episode = episode_of(unused) if unused else None
        return cls(
            path,
            groups,
            _factors(rename, recognition, groups.get("t", ())),
            what,
            names,
            order=_order_of(recognition, choice, table, names),
            rate=choice.rate,
            episode=episode,
            joints=recognition.joints if recognition else (),
            recognition=recognition,
            choice=choice,
            remedy=remedy,
        )

    @property
    def columns(self) -> list[str]:
        """Names of the file's columns that are read; the clock first, unless a rate
        replaces it."""
        read = list[str]()
        if self.rate is None:
            read += self.groups.get("t", ())
        for group, columns in self.groups.items():
            if group != "t":
                read += columns
        return read

    def run(self, columns: Mapping[str, Array]) -> Measurements:
        """Make measurements of the file's columns, or of a piece of their rows.

        Parameters
        ----------
        columns : mapping of str to array
            (N,) numbers or (N, n) blocks, by the file's names.

        Returns
        -------
        Measurements
            In SI units, the joints in the robot's order.

        Raises
        ------
        InputError
            Columns of different lengths, groups with different numbers of joints, or no
            clock.
        """
        columns_in_si = {
            group: [self._in_si(name, columns) for name in names]
            for group, names in self.groups.items()
            if group != "t"
        }
        t = self._clock(columns, columns_in_si)
        blocks = {
            group: self._block(group, parts, len(t))
            for group, parts in columns_in_si.items()
        }
        # A column "temp" of another shape is no temperature of the joints.
        for group in _WHOLE:
            if group in blocks and blocks[group].shape != blocks["q"].shape:
                del blocks[group]
        self._require_equal_widths(blocks)
        if self.order is not None and len(blocks["q"]):
            blocks = {group: block[:, self.order] for group, block in blocks.items()}
        return Measurements.of(t, blocks, (self.path.name,))

    def read(self, columns: Mapping[str, Array]) -> Measurements:
        """Make the run in SI units of complete columns by the file's names, (N,)
        numbers or (N, n) blocks.

        Raises InputError for columns of different lengths, groups with different
        numbers of joints, or no clock.
        """
        return self.gather([self.run(columns)])

    def gather(self, pieces: Iterable[Measurements]) -> Measurements:
        """Join consecutive pieces to one run, and finish it.

        Episodes (runs that begin their clock anew) are put one after the other, a
        second apart. Jumps by a full turn of angles in degrees are undone. Where
        columns were recognised, a remark says which, and shows the first rows.

        Parameters
        ----------
        pieces : Iterable[Measurements]
            Pieces of the run, in the order of the file.

        Returns
        -------
        Measurements
            The run in SI units.
        """
        recognised = self.recognition
        unit = "" if recognised is None else recognised.torque_unit
        run = replace(gathered(pieces), joint_names=self.joints, torque_unit=unit)
        if self.recognition is not None and self.recognition.inferred:
            run, recognition = self._with_units_of_all_rows(run, self.recognition)
            return replace(self, recognition=recognition)._finished(run)
        return self._finished(run)

    def _with_units_of_all_rows(
        self, run: Measurements, recognition: Recognition
    ) -> tuple[Measurements, Recognition]:
        """Decide by all rows the units that the first cells suggested; return the run
        and the recognition with these units."""
        inferred = {**recognition.inferred}
        if self.rate is not None:
            inferred.pop("t", None)
        rate = None
        if run.dq is not None and len(run.t) > 1:
            first = slice(ROWS_JUDGED)
            rate = rate_from_velocities(run.q[first], run.dq[first])
        run, units = decide_units(run, inferred, recognition.scale, rate)
        return run, recognition.with_units(units)

    def _finished(self, run: Measurements) -> Measurements:
        """Put episodes one after the other, undo jumps of degrees by a turn, and remark
        on recognised columns."""
        if self._has_time_of_day:
            run = replace(run, t=past_midnight(run.t))
        if self.episode is not None and len(run.t) > 1:
            run = self._episodes_in_a_row(run)
        degrees = self._groups_in_degrees()
        if degrees:
            run = unwrapped(run, self.path, degrees)
        if self.recognition is not None and not self.recognition.is_identity:
            sentence = self.recognition.sentence(
                self.path,
                self.names,
                self.rate,
                self.choice.scale,
                self.choice.options,
                has_file=not self.remedy,
            )
            rows = rows_shown(run, self.recognition)
            warnings.warn(ColumnsRemark(sentence, rows), stacklevel=2)
        return run

    def _groups_in_degrees(self) -> list[str]:
        """List the position groups (q, qcmd, qmot) that were recognised as angles in
        degrees."""
        scale = self.recognition.scale if self.recognition else {}
        groups = {
            group_of(our_name) for our_name, x in scale.items() if x == UNITS["deg"]
        }
        return [group for group in POSITIONS if group in groups]

    def _episodes_in_a_row(self, run: Measurements) -> Measurements:
        """Make the clock of several episodes ascend: each episode begins one second
        after the end of the one before."""
        steps = np.diff(run.t)
        is_start = steps <= 0.0
        if not is_start.any():
            return run
        gaps = np.where(is_start, 1.0 - steps, 0.0)
        shift = np.concatenate([[0.0], np.cumsum(gaps)])
        episodes = formatting.count(int(is_start.sum()) + 1, "episode")
        warning = f"{self.path}: {episodes} one after the other, a second apart"
        warnings.warn(warning, Remark, stacklevel=3)
        return replace(run, t=run.t + shift)

    def _in_si(self, name: str, columns: Mapping[str, Array]) -> Array:
        """Return a column of the file, (N,) or (N, n), in SI units."""
        return self.factors.get(name, 1.0) * np.asarray(columns[name], float)

    def _require_equal_widths(self, blocks: Mapping[str, Array]) -> None:
        """Raise InputError where the channel groups, (N, n) each, have different
        numbers of joints."""
        widths = {group: block.shape[1] for group, block in blocks.items()}
        if len(set(widths.values())) == 1:
            return
        shown = ", ".join(f"{group} {width}" for group, width in widths.items())
        what = f"the groups have different numbers of joints: {shown}"
        raise InputError(what, "give q, dq and tau a column a joint", self.what)

    def _clock(
        self, columns: Mapping[str, Array], groups_read: Mapping[str, Sequence[Array]]
    ) -> Array:
        """Return the time stamps (N,) [s] of the samples.

        They come from the rate where one is given, from one column, or from the sum of
        several columns (seconds and nanoseconds; hours, minutes and seconds). A file
        without rows needs no clock.
        """
        clock = self.groups.get("t", ())
        if clock and self.rate is None:
            if self._has_time_of_day:
                self._require_whole(clock[:2], columns)
            parts = [np.ravel(self._in_si(name, columns)) for name in clock]
            return np.sum(parts, axis=0) if len(parts) > 1 else parts[0]
        positions = groups_read["q"]
        first = positions[0]
        # A block can be (N, n) or (n, N): its longer side is that of the samples.
        n_samples = max(first.shape) if first.ndim == 2 else len(first)
        if self.rate is not None:
            return np.arange(n_samples) / self.rate
        has_values = any(part.size > 0 for part in positions)
        if n_samples and has_values:
            raise self._no_clock(groups_read)
        return np.zeros(n_samples)

    @property
    def _has_time_of_day(self) -> bool:
        """Whether the clock is in columns of hours, minutes and seconds."""
        return len(self.groups.get("t", ())) > 2 and self.rate is None

    def _require_whole(
        self, names: Sequence[str], columns: Mapping[str, Array]
    ) -> None:
        """Raise InputError where hours or minutes are no whole numbers: then each of
        these columns is a clock of its own."""
        for name in names:
            values = np.ravel(columns[name])
            if np.any(np.isfinite(values) & (values != np.round(values))):
                what = f"column {name} holds no whole numbers, as a time of day does"
                remedy = "name the clock with `convert --rename t=NAME`"
                raise InputError(what, remedy, self.what)

    def _no_clock(self, groups_read: Mapping[str, Sequence[Array]]) -> InputError:
        """Return the error of a file without a clock.

        It proposes the `convert` command with the rate at which dq is the derivative of
        q, where the velocities show one.
        """
        lacking = f"no column t (columns: {brief_names(self.names)})"
        if self.remedy:
            return InputError(lacking, self.remedy, self.what)
        rate = _rate_of(groups_read)
        why = "HZ being its samples a second"
        if rate is not None:
            why = "dq is the derivative of q at this rate"
        word = "HZ" if rate is None else f"{rate:g}"
        command = formatting.convert_command(self.path, "--rate", word)
        remedy = (
            f"give its rate with `{command}` ({why}), or name its clock with --rename"
            " t=NAME"
        )
        return InputError(lacking, remedy, self.what)

    def _block(self, group: str, parts: Sequence[Array], count: int) -> Array:
        """Return the channels (N, n) of one group, from n columns (N,) or from one
        block.

        A block (n, N) is turned, and axes of length 1 are left out, as Simulink logs
        (n, 1, N). ``count`` is N, the number of time stamps.
        """
        block = parts[0]
        if block.ndim > 2:
            has_one_joint = block.size == count
            block = block.reshape(count, 1) if has_one_joint else np.squeeze(block)
            parts = [block, *parts[1:]]
        if block.ndim > 2:
            what = f"{group} has {block.ndim} dimensions"
            raise InputError(what, "give it 2: samples and joints", self.what)
        if len(parts) == 1 and block.ndim == 2:
            is_upright = len(block) == count or block.shape[1] != count
            parts = list(block.T if is_upright else block)
        if not parts:
            what = f"{group} has no columns, so there are no joints"
            raise InputError(what, "give q, dq and tau a column a joint", self.what)
        for part in parts:
            if part.size != count:
                what = f"{group} has {part.size} rows, t has {count}"
                raise InputError(what, "give each as many rows as t", self.what)
        return np.column_stack([np.ravel(part) for part in parts])


def recognise_file(
    path: Path,
    names: Sequence[str],
    joints: Sequence[str] | None,
    table: CellTable | None,
    remedy: str = "",
) -> Recognition | None:
    """Recognise the columns of a file that does not have our names.

    Parameters
    ----------
    names : Sequence[str]
        Names of its columns, in order.
    joints : Sequence[str] | None
        Names of the robot's joints in order.
    table : CellTable | None
        Kinds and first cells of the columns.
    remedy : str
        What to do where there is no file to convert.

    Returns
    -------
    Recognition | None
        None where the columns have our names (t, q1, tau1 ...), or are not recognised.

    Raises
    ------
    InputError
        Two sets of columns are equally good as positions; it says how to choose one.
    """
    if has_our_names(names):
        return None
    try:
        return recognise(names, joints, table)
    except AmbiguousColumnsError as error:
        command = formatting.convert_command(path, "--rename", error.words)
        how = remedy or f"choose, such as with `{command}`"
        raise InputError(error.what, how, path) from None


def rows_shown(run: Measurements, recognition: Recognition) -> tuple[str, ...]:
    """Format the first five rows of a run as text, one line a channel.

    Parameters
    ----------
    run : Measurements
        The run in SI units.
    recognition : Recognition
        Which of the file's columns each channel is.

    Returns
    -------
    tuple[str, ...]
        Lines with our name of the channel, its values, and the file's name.
    """
    first_rows = run.rows(slice(0, _ROWS_SHOWN))
    lines = list[str]()
    for name, values in columns_of(first_rows).items():
        group = group_of(name)
        their_name = recognition.rename.get(name, recognition.rename.get(group, ""))
        numbers = " ".join(f"{x:>11.5g}" for x in values)
        lines.append(f"  {name:<6} {numbers}  {their_name}")
    return tuple(lines)


def _require_columns(
    rename: Mapping[str, str], names: Sequence[str], what: str
) -> None:
    """Raise InputError for a column that ``--rename`` names and the file does not
    have."""
    for our_name, their_name in rename.items():
        for name in parts_of(their_name, names):
            if name not in names:
                lacking = f"no column {name!r} to take as {our_name}"
                shown = f"(columns: {brief_names(names)})"
                remedy = "give --rename a name of the file"
                raise InputError(f"{lacking} {shown}", remedy, what)


def _groups(
    rename: Mapping[str, str],
    names: Sequence[str],
    choice: Choice,
    is_recognised: bool,
    what: str,
) -> dict[str, Sequence[str]]:
    """List the file's columns of each channel group: {"t": ["time"], "q": ["pos_1",
    ...], ...}, the clock first.

    ``rename`` has the file's names by ours, which the user chose or which were
    recognised. Columns that have our names count too, unless the columns were
    recognised (``is_recognised``): then all of them are in ``rename``. Messages call
    the file ``what``.
    """
    our_names = {} if is_recognised else dict(zip(names, names, strict=True))
    named = {**our_names, **rename}
    groups = dict[str, Sequence[str]]()
    clock = _clock_of(rename, names, choice)
    if clock is not None:
        groups["t"] = list(parts_of(clock, names))
    for group in GROUPS:
        columns = _columns(named, group, what)
        if columns:
            groups[group] = columns
    return groups


def _clock_of(
    rename: Mapping[str, str], names: Sequence[str], choice: Choice
) -> str | None:
    """Return the name of the clock's column: renamed, called "t", or, where the user
    renamed other columns, recognised by its name. None without a clock."""
    if "t" in rename:
        return rename["t"]
    if choice.rename and "t" not in names:
        return find_clock(names)
    return "t" if "t" in names else None


def _missing_groups(groups: Mapping[str, Sequence[str]]) -> list[str]:
    """List the channel groups that a run needs and the file does not have.

    A run needs q and tau, or q and commanded positions. The clock is listed beside
    others, so that one message asks for all; alone it is not missing, for a rate can
    replace it.
    """
    needed = ["q"] if "qcmd" in groups else ["q", "tau"]
    if all(group in groups for group in needed):
        return []
    return [group for group in ("t", *needed) if group not in groups]


def _lacking(
    path: Path,
    names: Sequence[str],
    problem: str,
    missing: Sequence[str],
    what: str,
    remedy: str,
    joints: Sequence[str] | None = None,
) -> InputError:
    """Return the error of a file that lacks columns, with the command that names
    them; ``joints`` are the robot's."""
    from sdp_vs_penalty.data.catalogue import fetch_remedy

    shown = f"{problem} (columns: {brief_names(names)})"
    n_joints = None if joints is None else len(joints)
    how = remedy or fetch_remedy(path)
    how = how or _rename_command(path, names, missing, n_joints)
    return InputError(shown, how, what)


def _unused_columns(
    groups: Mapping[str, Sequence[str]], names: Sequence[str], what: str
) -> list[str]:
    """List the columns that are not read; raise InputError where a column that is read
    comes twice."""
    count = Counter(names)
    for columns in groups.values():
        for name in columns:
            if count.pop(name, 0) > 1:
                problem = f"column {name} comes twice"
                raise InputError(problem, "rename one of them", what)
    return list(count)


def _say_unused(path: Path, names: Sequence[str]) -> None:
    """Warn of columns that are not read; of accelerations it says why."""
    # Accelerations are the one kind of column that people expect to be read.
    is_acceleration = re.compile(r"(ddq|qdd|acc)_?[0-9]*")
    why = ""
    if any(is_acceleration.fullmatch(name.lower()) for name in names):
        why = ". Accelerations are computed from q, with the same filter as the torque"
    shown = ", ".join(name[:40] or "a column without a name" for name in names[:6])
    more = f" and {len(names) - 6} more" if len(names) > 6 else ""
    warnings.warn(f"{path}: not used: {shown}{more}{why}.", Remark, stacklevel=3)


def _factors(
    rename: Mapping[str, str], recognition: Recognition | None, clock: Sequence[str]
) -> dict[str, float]:
    """Return the factors to SI by the file's names.

    The second column of a stamp has the unit that its name says, such as nanoseconds.
    """
    scale = recognition.scale if recognition else {}
    factors = {rename[our_name]: x for our_name, x in scale.items() if our_name != "t"}
    factors |= dict(zip(clock, units_of_parts(clock), strict=True))
    if len(clock) == 1 or "t" in scale:
        factors |= {name: scale.get("t", 1.0) for name in clock[:1]}
    return factors


def _order_of(
    recognition: Recognition | None,
    choice: Choice,
    table: CellTable | None,
    names: Sequence[str],
) -> tuple[int, ...] | None:
    """Return the place in a block's lists of each of the robot's joints; None for the
    file's order.

    Where the columns have our names, or the user chose them by ``--rename``, the order
    is still recognised from the joints' names in the file.
    """
    if recognition is not None:
        return recognition.order
    if not choice.joints or table is None or not columns_of_joint_names(names):
        return None
    try:
        guess = recognise(names, choice.joints, table)
    except AmbiguousColumnsError:
        return None
    return None if guess is None else guess.order


def _rate_of(groups_read: Mapping[str, Sequence[Array]]) -> float | None:
    """Estimate the sampling rate [Hz] at which dq is the derivative of q; None where
    there are no velocities, or none fits."""
    if "dq" not in groups_read:
        return None
    lengths = {len(x) for group in ("q", "dq") for x in groups_read[group]}
    if len(lengths) != 1:  # whoever reads the channels refuses them
        return None
    blocks = dict[str, Array]()  # (N, n) each
    for group in ("q", "dq"):
        columns = [np.reshape(x, (len(x), -1)) for x in groups_read[group]]
        blocks[group] = np.column_stack(columns)
    if blocks["q"].shape != blocks["dq"].shape:
        return None
    return rate_from_velocities(blocks["q"], blocks["dq"])


def _columns(named: Mapping[str, str], group: str, what: str) -> list[str]:
    """List the file's columns of one channel group in the joints' order.

    ``named`` gives the file's names by ours: one column called as the group is a block
    with all joints; q1, q2 ... are one a joint. Raises InputError for a gap in the
    numbers.
    """
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


def _rename_command(
    path: Path, names: Sequence[str], missing: Sequence[str], n_joints: int | None
) -> str:
    """Format the remedy for missing columns: a `convert` command that names them, by
    the file's names where some fit.

    ``n_joints`` is the robot's number of joints, where it is known. A file without
    columns has none to name.
    """
    if not names:
        return "write numbers, a column or an array a channel (t, q, tau)"
    pairs = _columns_in_order(names, missing, n_joints)
    pairs = pairs or propose_columns(names, missing)
    words = ["--rename", ",".join(f"{group}={name}" for group, name in pairs.items())]
    scale = _scale_of_proposal(pairs, names)
    if scale:
        words += ["--scale", scale_words(scale, dict.fromkeys(scale, ""))]
    command = formatting.convert_command(path, *words)
    how = f"name them with `{command}`"
    if "NAME" in pairs.values():
        how += f" (columns of joints as '{missing[-1]}*=NAME_*')"
    elif set(pairs) - {"t"}:
        how += ", if they are that"
    if "tau" in missing and "q" not in missing:
        joined = formatting.convert_command(f"{path}+TORQUES.csv")
        how += f"; or join the file that holds torques with `{joined}`"
    return how


def _columns_in_order(
    names: Sequence[str], missing: Sequence[str], n_joints: int | None
) -> dict[str, str]:
    """Propose columns by their order alone: t, q, dq and tau, or t, q and tau.

    For tables in which no name says more than a number, as MATLAB writes them: "Var1"
    and the blocks "Var2_1", "Var2_2" ..., or "Var1", "Var2" ... of all channels.

    Parameters
    ----------
    names : sequence of str
        Names of the file's columns.
    missing : sequence of str
        Missing groups among t, q and tau.
    n_joints : int or None
        The robot's number of joints.

    Returns
    -------
    dict of str to str
        The file's name by ours; empty where names say a quantity, or the columns are
        not as many as these groups have.
    """
    quantities = {_quantity_of(name) for name in names}
    if not {"q", "tau"} <= set(missing) or not quantities <= {None, "t"}:
        return {}
    families = numbered_families(names)
    blocks = {pattern: x for pattern, x in families.items() if len(x) > 1}
    in_blocks = {name for columns in blocks.values() for name in columns}
    single = [name for name in names if name not in in_blocks]
    if len(single) > 1 or not blocks:
        return {}
    if len(blocks) == 1:
        (columns,) = blocks.values()
        return _channels_in_order([*single, *columns], n_joints)
    sizes = {len(columns) for columns in blocks.values()}
    groups = {3: ("q*", "dq*", "tau*"), 2: ("q*", "tau*")}.get(len(blocks), ())
    if not groups or not single or len(sizes) > 1:
        return {}
    return {"t": single[0], **dict(zip(groups, blocks, strict=True))}


def _channels_in_order(names: Sequence[str], n_joints: int | None) -> dict[str, str]:
    """Propose t, q1 ..., dq1 ..., tau1 ... for columns in this order, or without dq;
    empty where the columns are not as many as a clock and these groups have."""
    clock, *channels = names
    for groups in (("q", "dq", "tau"), ("q", "tau")):
        n, n_left = divmod(len(channels), len(groups))
        if n_left or n == 0 or n_joints not in (None, n):
            continue
        our_names = [f"{group}{k}" for group in groups for k in range(1, n + 1)]
        return {"t": clock, **dict(zip(our_names, channels, strict=True))}
    return {}


def propose_columns(names: Sequence[str], missing: Sequence[str]) -> dict[str, str]:
    """Propose columns for channel groups that the recogniser does not find, for a
    message.

    A family of numbered columns is proposed for a group by the words in its names.
    Families without such words are proposed only where exactly as many are left as
    groups: the first for positions, the next for torques, as most files have them.

    Parameters
    ----------
    names : sequence of str
        Names of the file's columns.
    missing : sequence of str
        Missing groups among t, q and tau.

    Returns
    -------
    dict of str to str
        The file's name by the group, "NAME" where no column fits. "q*" has a pattern
        with a star for the number.
    """
    families = {
        pattern: columns
        for pattern, columns in numbered_families(names).items()
        if len(columns) > 1
    }
    quantities = {pattern: _quantity_of(x[0]) for pattern, x in families.items()}
    unknown = _unknown_families(quantities)
    # Families without a known word are proposed where nothing else is possible.
    open_groups = set(missing) - {"t"} - set(quantities.values())
    have_equal_sizes = len({len(columns) for columns in families.values()}) == 1
    is_one_to_one = len(unknown) == len(open_groups) and len(families) > 1
    pairs = dict[str, str]()
    for group in missing:
        patterns = [p for p, quantity in quantities.items() if quantity == group]
        if group == "t":
            pairs["t"] = find_clock(names) or "NAME"
        elif patterns:
            pairs[f"{group}*"] = patterns[0]
        elif have_equal_sizes and is_one_to_one:
            pairs[f"{group}*"] = unknown.pop(0)
        elif len(blocks := _blocks_of(group, names)) == 1:
            pairs[group] = blocks[0]
        else:
            pairs[group] = "NAME"
    return pairs


def _blocks_of(group: str, names: Sequence[str]) -> list[str]:
    """List the columns without a number whose names say a quantity: each can hold all
    joints."""
    from sdp_vs_penalty.data.formats.column_names import read_name

    readings = {name: read_name(name) for name in names}
    return [
        name
        for name, reading in readings.items()
        if reading is not None and reading.quantity == group and reading.number is None
    ]


def _unknown_families(quantities: Mapping[str, str | None]) -> list[str]:
    """List the patterns of numbered columns whose names say no quantity; ``quantities``
    are by pattern. Targets, limits and the like are left out."""
    from sdp_vs_penalty.data.formats.column_names import is_no_measurement

    return [
        pattern
        for pattern, quantity in quantities.items()
        if quantity in (None, "t") and not is_no_measurement(pattern)
    ]


def _scale_of_proposal(
    pairs: Mapping[str, str], names: Sequence[str]
) -> dict[str, float]:
    """Return the factors to SI that the names of proposed columns say, by the channel
    group."""
    from sdp_vs_penalty.data.formats.column_names import read_name

    scale = dict[str, float]()
    families = numbered_families(names)
    for our_name, pattern in pairs.items():
        columns = families.get(pattern, [pattern])
        is_one_column = pattern != "NAME" and len(parts_of(pattern, names)) == 1
        reading = read_name(columns[0]) if is_one_column else None
        if reading is not None and reading.factor != 1.0:
            scale[our_name.rstrip("*")] = reading.factor
    return scale


def _quantity_of(name: str) -> str | None:
    """Return the quantity that a column's name says (t, q, tau ...); None where it says
    none."""
    from sdp_vs_penalty.data.formats.column_names import read_name

    reading = read_name(name)
    return None if reading is None else reading.quantity


def numbered_families(names: Sequence[str]) -> dict[str, list[str]]:
    """Collect columns that differ by their last number alone.

    Returns
    -------
    dict of str to list of str
        The columns by their pattern: "pos_*" for pos_0 and pos_1.
    """
    families = dict[str, list[str]]()
    for name in names:
        pattern = re.sub(r"[0-9]+([^0-9]*)$", r"*\1", name)
        if pattern.count("*") == 1 and not set(",=#+") & set(pattern):
            families.setdefault(pattern, []).append(name)
    return families


def real_numbers(path: str | Path, name: str, array: Any) -> Array:
    """Convert an array of a file to floating-point numbers.

    Parameters
    ----------
    name : str
        Name of the array, for messages.
    array : Any
        NumPy array of any type and shape.

    Returns
    -------
    Array
        Numbers of the same shape, at least (1,).

    Raises
    ------
    InputError
        The array holds anything but real numbers.
    """
    if array.dtype.kind not in "fiu":
        what = f"array {name} holds {array.dtype}, not real numbers"
        raise InputError(what, "save it as floating-point numbers", path)
    with np.errstate(over="ignore"):  # a longer number becomes infinite: refused later
        return np.atleast_1d(np.asarray(array, float))


def table_of_arrays(arrays: Mapping[str, Array]) -> CellTable:
    """Describe arrays as the recogniser of columns needs it: kinds and first cells.

    Parameters
    ----------
    arrays : Mapping[str, Array]
        (N,) columns, or (N, n) and (n, N) blocks, by name.

    Returns
    -------
    CellTable
        "number" for a column and "list" for a block, with the first five rows as texts.
    """
    kinds = dict[str, str]()
    cells = dict[str, list[str]]()
    for name, array in arrays.items():
        kinds[name] = "list" if min(array.shape, default=1) > 1 else "number"
        is_upright = array.ndim < 2 or array.shape[0] >= array.shape[1]
        rows = array if is_upright else array.T
        cells[name] = [_cell(row) for row in rows[:_ROWS_SHOWN]]
    return CellTable(kinds, cells)


def _cell(row: Array) -> str:
    """Format a number, or the numbers of a row, as the text of one cell."""
    return " ".join(f"{x:.15g}" for x in np.ravel(row))


def brief_names(names: Sequence[str]) -> str:
    """Format names of columns in order, those that differ by their numbers as one.

    >>> brief_names(["t", "q_0", "q_1", "q_2"])
    'q_0..2, t'
    """
    families = dict[tuple[str, str], list[int]]()
    for name in names:
        match = re.fullmatch(r"(.*?)([0-9]+)([^0-9]*)", name)
        if match is None:
            families.setdefault((name, ""), [])
        else:
            families.setdefault((match[1], match[3]), []).append(int(match[2]))
    shown = list[str]()
    for (head, tail), numbers in families.items():
        shown += _brief_family(head, tail, sorted(set(numbers)))
    return ", ".join(sorted(name[:40] for name in shown)) or "none"


def _brief_family(head: str, tail: str, numbers: Sequence[int]) -> list[str]:
    """Format names that differ by their numbers as one, "q_0..6"; each alone where
    there are fewer than three, or a gap."""
    if not numbers:
        return [f"{head}{tail}"]
    is_range = list(numbers) == list(range(numbers[0], numbers[-1] + 1))
    if len(numbers) > 2 and is_range:
        return [f"{head}{numbers[0]}..{numbers[-1]}{tail}"]
    return [f"{head}{number}{tail}" for number in numbers]


def rate_from_velocities(q: Array, dq: Array) -> float | None:
    """Estimate the sampling rate at which the velocities are the derivative of the
    positions.

    Least squares of the steps of q on the mean velocity between two samples: step = dq
    / rate.

    Parameters
    ----------
    q : Array
        (N, n) positions [rad, m].
    dq : Array
        (N, n) velocities [rad/s, m/s].

    Returns
    -------
    float | None
        Sampling rate to three digits [Hz]; None where steps and velocities have a
        squared correlation below 0.9.
    """
    steps = np.diff(q, axis=0)
    mean_velocities = 0.5 * (dq[1:] + dq[:-1])
    is_finite = np.isfinite(steps) & np.isfinite(mean_velocities)
    usable = is_finite.all(axis=1)
    steps = steps[usable]
    velocities = mean_velocities[usable]
    largest = max(np.abs(steps).max(initial=0.0), np.abs(velocities).max(initial=0.0))
    if largest > _LARGEST_SQUARABLE:
        return None
    # Sums of squares and products: rate = vv / sv, squared correlation = sv^2 / (ss vv).
    vv = float(np.sum(velocities**2))
    ss = float(np.sum(steps**2))
    sv = float(np.sum(steps * velocities))
    if not vv * ss > 0.0 or sv <= 0.0 or sv**2 < 0.9 * vv * ss:
        return None
    return float(f"{vv / sv:.3g}")


def columns_of(measurements: Measurements) -> dict[str, Array]:
    """List the columns of a run by their names in RUN.csv.

    Returns
    -------
    dict[str, Array]
        (N,) numbers in SI units: t, q1 ..., dq1 ..., tau1 ....
    """
    m = measurements
    out = {"t": m.t}
    for name, block in m.groups.items():
        out |= {f"{name}{j + 1}": block[:, j] for j in range(m.n)}
    return out
