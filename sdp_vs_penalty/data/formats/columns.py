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
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.formats.recognition import (
    AmbiguousColumnsError,
    CellTable,
    Recognition,
    counted_from_zero,
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
from sdp_vs_penalty.data.formats.stamps import second_part_unit
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


@dataclass(frozen=True)
class Choice:
    """What of a file to take.

    Parameters
    ----------
    joints : names of the robot's joints in order, for formats that name theirs
    topic : of a bag with several
    rename : {our name: the file's name} of columns or variables, for tables
    rate : samples a second [Hz], in place of the file's clock
    """

    joints: Sequence[str] | None = None
    topic: str | None = None
    rename: Mapping[str, str] | None = None
    rate: float | None = None


@contextmanager
def understood(
    path: str | Path,
    kind: str,
    remedy: str,
) -> Iterator[None]:
    """While a library reads a file, turn its failures into InputError.

    Parameters
    ----------
    path : str | Path
        Path of the file.
    kind : str
        How messages call such a file.
    remedy : str
        What to do about a broken one.

    Returns
    -------
    Iterator[None]
        A context; every layer of a library fails in ways of its own.

    Raises
    ------
    InputError
        The library fails, but for memory and the system's own errors.
    """
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

    Parameters
    ----------
    path : of the file
    groups : the file's columns of each of ours (t, q, dq, tau, ...), one a joint or one
        block; of t two where a stamp is in two parts, none without a clock
    factors : by the file's names, where they are not 1
    what : how messages call the file
    names : of all its columns
    order : of the joints of a block, where the robot's is another one
    rate : samples a second [Hz] in place of a clock
    episode : the column that counts runs
    joints : their names, where the file says them
    recognition : what was guessed; None where names are ours or were chosen
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
    recognition: Recognition | None = None

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
        """The header of a file whose columns have these names: our own, those that are
        chosen, else those recognised.

        Parameters
        ----------
        path : of the file
        names : of its columns
        choice : what to take
        what : how messages call the file; its path by default
        remedy : what to do about missing columns; the `convert` command by default
        table : what the columns hold

        Raises
        ------
        InputError
            q or tau (and qcmd), or one of several joints is missing. Where t is,
            :meth:`run` raises it.
        """
        path = Path(path)
        what = what or str(path)
        recognition = None
        if not choice.rename:
            recognition = recognise_file(path, names, choice.joints, table)
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
            raise _lacking(path, names, problem, missing, what, remedy)
        unused = _unused_columns(groups, names, what)
        if unused and not rename:
            _say_unused(path, unused)
        return cls(
            path,
            groups,
            _factors(rename, recognition, groups.get("t", ())),
            what,
            names,
            order=_order_of(recognition, choice, table, names),
            rate=choice.rate,
            episode="episode_index" if "episode_index" in names else None,
            joints=recognition.joints if recognition else (),
            recognition=recognition,
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
        """The run, or a piece of it.

        Parameters
        ----------
        columns : (N,) numbers or (N, n) blocks by the file's names

        Returns
        -------
        Measurements
            In SI units, joints in the robot's order.

        Raises
        ------
        InputError
            Lengths or numbers of joints differ, or no clock is known.
        """
        channels = {group: n for group, n in self.groups.items() if group != "t"}
        groups_read = {
            group: [self._in_si(name, columns) for name in names]
            for group, names in channels.items()
        }
        t = self._clock(columns, groups_read)
        blocks = {
            group: self._block(group, parts, len(t))
            for group, parts in groups_read.items()
        }
        # What else a file calls temp is no temperature of its joints.
        for group in _WHOLE:
            if group in blocks and blocks[group].shape != blocks["q"].shape:
                del blocks[group]
        self._require_equal_widths(blocks)
        if self.order is not None and len(blocks["q"]):
            blocks = {group: block[:, self.order] for group, block in blocks.items()}
        return Measurements.of(t, blocks, (self.path.name,))

    def read(self, columns: Mapping[str, Array]) -> Measurements:
        """Make a run of whole columns.

        Parameters
        ----------
        columns : Mapping[str, Array]
            (N,) numbers or (N, n) blocks by the file's names.

        Returns
        -------
        Measurements
            The run in SI units, one row a sample.

        Raises
        ------
        InputError
            As of :meth:`run`.
        """
        return self.gather([self.run(columns)])

    def gather(self, pieces: Iterable[Measurements]) -> Measurements:
        """Make one run of consecutive pieces; one remark says what was guessed, and
        shows the first rows.

        Parameters
        ----------
        pieces : Iterable[Measurements]
            In the order of the file.

        Returns
        -------
        Measurements
            Episodes come one after the other, a second apart; degrees that were cut at
            a full turn go on.
        """
        run = replace(gathered(pieces), joint_names=self.joints)
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
            )
            rows = rows_shown(run, self.recognition)
            warnings.warn(ColumnsRemark(sentence, rows), stacklevel=2)
        return run

    def _groups_in_degrees(self) -> list[str]:
        """The groups of positions that were recognised as angles in degrees."""
        scale = self.recognition.scale if self.recognition else {}
        groups = {
            group_of(our_name) for our_name, x in scale.items() if x == UNITS["deg"]
        }
        return [group for group in POSITIONS if group in groups]

    def _episodes_in_a_row(self, run: Measurements) -> Measurements:
        """The run with a clock that goes on where an episode begins anew."""
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

    def _in_si(
        self,
        name: str,
        columns: Mapping[str, Array],
    ) -> Array:
        """A column of the file in SI units."""
        return self.factors.get(name, 1.0) * np.asarray(columns[name], float)

    def _require_equal_widths(self, blocks: Mapping[str, Array]) -> None:
        """InputError where groups have different numbers of joints."""
        widths = {group: block.shape[1] for group, block in blocks.items()}
        if len(set(widths.values())) == 1:
            return
        shown = ", ".join(f"{group} {width}" for group, width in widths.items())
        what = f"the groups have different numbers of joints: {shown}"
        raise InputError(what, "give q, dq and tau a column a joint", self.what)

    def _clock(
        self,
        columns: Mapping[str, Array],
        groups_read: Mapping[str, Sequence[Array]],
    ) -> Array:
        """(N,) s: of one column, the sum of a stamp's two parts, or of the rate."""
        clock = self.groups.get("t", ())
        if clock and self.rate is None:
            parts = [np.ravel(self._in_si(name, columns)) for name in clock]
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
        show it."""
        rate = _rate_of(groups_read)
        why = "HZ being its samples a second"
        if rate is not None:
            why = "dq is the derivative of q at this rate"
        word = "HZ" if rate is None else f"{rate:g}"
        command = formatting.convert_command(self.path, "--rate", word)
        lacking = f"no column t (columns: {brief_names(self.names)})"
        remedy = (
            f"give its rate with `{command}` ({why}), or name its clock with --rename"
            " t=NAME"
        )
        return InputError(lacking, remedy, self.what)

    def _block(
        self,
        group: str,
        parts: Sequence[Array],
        count: int,
    ) -> Array:
        """(N, n) the channels of a group, from columns or one block either way up."""
        block = parts[0]
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
) -> Recognition | None:
    """Recognise the columns of a file.

    Parameters
    ----------
    path : Path
        Path of the file.
    names : Sequence[str]
        Of its columns, in order.
    joints : Sequence[str] | None
        The robot's joint names.
    table : CellTable | None
        What the columns hold.

    Returns
    -------
    Recognition | None
        None where our own names are there, or nothing is recognised.

    Raises
    ------
    InputError
        Two sets of columns are as good.
    """
    if has_our_names(names):
        return None
    try:
        return recognise(names, joints, table)
    except AmbiguousColumnsError as error:
        command = formatting.convert_command(path, "--rename", error.words)
        remedy = f"choose, such as with `{command}`"
        raise InputError(error.what, remedy, path) from None


def rows_shown(run: Measurements, recognition: Recognition) -> tuple[str, ...]:
    """Format the first five rows of a run, a line a channel.

    Parameters
    ----------
    run : Measurements
        In SI units.
    recognition : Recognition
        Which column each channel is.

    Returns
    -------
    tuple[str, ...]
        Our name, the values, and the file's name in each line.
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
    rename: Mapping[str, str],
    names: Sequence[str],
    what: str,
) -> None:
    """InputError for a chosen name that the file does not have."""
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
    """The file's columns of each of our groups, the clock's first; those with our own
    names too, unless columns were recognised."""
    our_names = {} if is_recognised else dict(zip(names, names, strict=True))
    named = {**our_names, **rename}
    columns = {group: _columns(named, group, what) for group in GROUPS}
    groups = dict[str, Sequence[str]]()
    clock = _clock_of(rename, names, choice)
    if clock is not None:
        groups["t"] = list(parts_of(clock, names))
    return groups | {group: there for group, there in columns.items() if there}


def _clock_of(
    rename: Mapping[str, str],
    names: Sequence[str],
    choice: Choice,
) -> str | None:
    """The file's clock; None without."""
    if "t" in rename:
        return rename["t"]
    if choice.rename and "t" not in names:
        return find_clock(names)
    return "t" if "t" in names else None


def _missing_groups(groups: Mapping[str, Sequence[str]]) -> list[str]:
    """The groups that a run needs and the file has not; the clock too where another one
    is missing."""
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
) -> InputError:
    """The error of a file without columns, with the command that names them."""
    from sdp_vs_penalty.data.catalogue import fetch_remedy

    shown = f"{problem} (columns: {brief_names(names)})"
    how = remedy or fetch_remedy(path) or _rename_command(path, names, missing)
    return InputError(shown, how, what)


def _unused_columns(
    groups: Mapping[str, Sequence[str]],
    names: Sequence[str],
    what: str,
) -> list[str]:
    """The columns that are not read; InputError for one that is and comes twice."""
    count = Counter(names)
    for columns in groups.values():
        for name in columns:
            if count.pop(name, 0) > 1:
                problem = f"column {name} comes twice"
                raise InputError(problem, "rename one of them", what)
    return list(count)


def _say_unused(path: Path, names: Sequence[str]) -> None:
    """A remark about columns that are not read."""
    # Accelerations are the one kind of column that people expect to be read.
    is_acceleration = re.compile(r"(ddq|qdd|acc)_?[0-9]*")
    why = ""
    if any(is_acceleration.fullmatch(name.lower()) for name in names):
        why = ". Accelerations are computed from q, with the same filter as the torque"
    shown = ", ".join(name[:40] or "a column without a name" for name in names[:6])
    more = f" and {len(names) - 6} more" if len(names) > 6 else ""
    warnings.warn(f"{path}: not used: {shown}{more}{why}.", Remark, stacklevel=3)


def _factors(
    rename: Mapping[str, str],
    recognition: Recognition | None,
    clock: Sequence[str],
) -> dict[str, float]:
    """What columns are multiplied by, by the file's names."""
    scale = recognition.scale if recognition else {}
    factors = {rename[our_name]: x for our_name, x in scale.items() if our_name != "t"}
    for k, name in enumerate(clock):
        factors[name] = second_part_unit(name) if k else scale.get("t", 1.0)
    return factors


def _order_of(
    recognition: Recognition | None,
    choice: Choice,
    table: CellTable | None,
    names: Sequence[str],
) -> tuple[int, ...] | None:
    """The order of the joints within blocks, where the file says it; also where columns
    were chosen and the joints were named."""
    if recognition is not None:
        return recognition.order
    if not choice.rename or not choice.joints or table is None:
        return None
    try:
        guess = recognise(names, choice.joints, table)
    except AmbiguousColumnsError:
        return None
    return None if guess is None else guess.order


def _rate_of(groups_read: Mapping[str, Sequence[Array]]) -> float | None:
    """The rate that velocities show [Hz]; None without."""
    if "dq" not in groups_read:
        return None
    lengths = {len(x) for group in ("q", "dq") for x in groups_read[group]}
    if len(lengths) != 1:  # whoever reads the channels refuses them
        return None
    blocks = [
        np.column_stack([np.reshape(x, (len(x), -1)) for x in groups_read[group]])
        for group in ("q", "dq")
    ]
    positions, velocities = blocks
    if positions.shape != velocities.shape:
        return None
    return rate_from_velocities(positions, velocities)


def _columns(
    named: Mapping[str, str],
    group: str,
    what: str,
) -> list[str]:
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


def _rename_command(
    path: Path,
    names: Sequence[str],
    missing: Sequence[str],
) -> str:
    """What names the columns that are missing, by the file's names where they fit."""
    pairs = propose_columns(names, missing)
    words = [
        "--rename",
        ",".join(f"{group}={name}" for group, name in pairs.items()),
    ]
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


def propose_columns(names: Sequence[str], missing: Sequence[str]) -> dict[str, str]:
    """Propose columns for the groups that nobody recognises.

    Parameters
    ----------
    names : sequence of str
        Of the file's columns.
    missing : sequence of str
        Groups among t, q and tau.

    Returns
    -------
    dict of str to str
        By group the file's name, "NAME" where none fits; by "q*" a pattern of numbered
        columns. Positions stand before torques in most files.
    """
    from sdp_vs_penalty.data.formats.column_names import is_no_measurement

    clock = find_clock(names)
    families = [
        (pattern, columns)
        for pattern, columns in _numbered_families(names).items()
        if len(columns) > 1
    ]
    quantities = {pattern: _quantity_of(columns[0]) for pattern, columns in families}
    unknown = [
        pattern
        for pattern, quantity in quantities.items()
        if quantity in (None, "t") and not is_no_measurement(pattern)
    ]
    is_sure = len({len(columns) for _, columns in families}) == 1
    open_groups = set(missing) - {"t"} - set(quantities.values())
    is_sure = is_sure and len(unknown) == len(open_groups) and len(families) > 1
    pairs = dict[str, str]()
    for group in missing:
        of_group = [p for p, quantity in quantities.items() if quantity == group]
        if group == "t":
            pairs["t"] = clock or "NAME"
        elif of_group:
            pairs[f"{group}*"] = of_group[0]
        elif is_sure:
            pairs[f"{group}*"] = unknown.pop(0)
        else:
            pairs[group] = "NAME"
    return pairs


def _scale_of_proposal(
    pairs: Mapping[str, str], names: Sequence[str]
) -> dict[str, float]:
    """The factors that the names of proposed columns say, by our names."""
    from sdp_vs_penalty.data.formats.column_names import read_name

    scale = dict[str, float]()
    for our_name, pattern in pairs.items():
        columns = _numbered_families(names).get(pattern, [pattern])
        reading = read_name(columns[0]) if pattern != "NAME" else None
        if reading is not None and reading.factor != 1.0:
            scale[our_name.rstrip("*")] = reading.factor
    return scale


def _quantity_of(name: str) -> str | None:
    """The quantity that a name says; None where it says none."""
    from sdp_vs_penalty.data.formats.column_names import read_name

    reading = read_name(name)
    return None if reading is None else reading.quantity


def _numbered_families(names: Sequence[str]) -> dict[str, list[str]]:
    """Columns that differ by their last number, by the pattern with a star for it."""
    families = dict[str, list[str]]()
    for name in names:
        pattern = re.sub(r"[0-9]+([^0-9]*)$", r"*\1", name)
        if pattern.count("*") == 1 and not set(",=#+") & set(pattern):
            families.setdefault(pattern, []).append(name)
    return families


def real_numbers(
    path: str | Path,
    name: str,
    array: Any,
) -> Array:
    """Convert an array to floating-point numbers.

    Parameters
    ----------
    path : str | Path
        Path of the file.
    name : str
        Of the array, for messages.
    array : Any
        Of any type and shape.

    Returns
    -------
    Array
        The same shape, at least (1,).

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
    """Describe arrays as the recogniser needs it.

    Parameters
    ----------
    arrays : Mapping[str, Array]
        (N,) one a column, or (N, n) and (n, N) blocks, by name.

    Returns
    -------
    CellTable
        Kinds and first cells.
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
    """A number, or several, as text."""
    return " ".join(f"{x:.6g}" for x in np.ravel(row))


def brief_names(names: Sequence[str]) -> str:
    """Format names of columns in order, those that differ by their numbers as one.

    >>> brief_names(["t", "q_0", "q_1", "q_2"])
    'q_0..2, t'

    Parameters
    ----------
    names : Sequence[str]
        Of columns.

    Returns
    -------
    str
        Names separated by commas.
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


def _brief_family(
    head: str,
    tail: str,
    numbers: Sequence[int],
) -> list[str]:
    """Names that differ by their numbers, as one where these have no gap."""
    if not numbers:
        return [f"{head}{tail}"]
    is_range = list(numbers) == list(range(numbers[0], numbers[-1] + 1))
    if len(numbers) > 2 and is_range:
        return [f"{head}{numbers[0]}..{numbers[-1]}{tail}"]
    return [f"{head}{number}{tail}" for number in numbers]


def rate_from_velocities(q: Array, dq: Array) -> float | None:
    """Estimate the sampling rate at which velocities are the derivative of positions,
    by least squares of the steps of q on the mean velocity between them: step = dq /
    rate.

    Parameters
    ----------
    q : Array
        (N, n) positions [rad, m].
    dq : Array
        (N, n) velocities [rad/s, m/s].

    Returns
    -------
    float | None
        Samples a second to three digits [Hz]; None where they are the derivative at no
        rate.
    """
    steps = np.diff(q, axis=0)
    mean = 0.5 * (dq[1:] + dq[:-1])
    usable = np.isfinite(steps).all(axis=1) & np.isfinite(mean).all(axis=1)
    steps = steps[usable]
    mean = mean[usable]
    if max(np.abs(steps).max(initial=0.0), np.abs(mean).max(initial=0.0)) > 1e100:
        return None  # no robot measures that, and its square is no number
    energy = float(np.sum(mean**2))
    way = float(np.sum(steps**2))
    common = float(np.sum(steps * mean))
    if not energy * way > 0.0 or common**2 < 0.9 * energy * way or common <= 0.0:
        return None
    return float(f"{energy / common:.3g}")


def columns_of(measurements: Measurements) -> dict[str, Array]:
    """List the columns of a run by the names of RUN.csv.

    Parameters
    ----------
    measurements : Measurements
        One run.

    Returns
    -------
    dict[str, Array]
        (N,) each: t, q1 ..., in SI units.
    """
    m = measurements
    out = {"t": m.t}
    for name, block in m.groups.items():
        out |= {f"{name}{j + 1}": block[:, j] for j in range(m.n)}
    return out
