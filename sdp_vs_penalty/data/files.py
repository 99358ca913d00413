"""Reading and writing runs: the format comes from the suffix, what makes a run useless
is refused."""

import glob
import os
import re
import warnings
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.arguments import checked_arguments
from sdp_vs_penalty.data.columns import Choice
from sdp_vs_penalty.data.formats import FILE_SEPARATOR, format_of, open_log, suffixes
from sdp_vs_penalty.data.measurements import (
    LARGEST_VALUE,
    MOST_LOST,
    Measurements,
    concatenate,
    without_traces,
)
from sdp_vs_penalty.data.reading import run_of
from sdp_vs_penalty.data.recorder import Recorder
from sdp_vs_penalty.data.store import iter_chunks
from sdp_vs_penalty.data.stretches.gaps import is_set_back
from sdp_vs_penalty.data.together import read_by_recorder, require_runs
from sdp_vs_penalty.errors import (
    InputError,
    MissingJoints,
    Remark,
    RepairableError,
    other_robot,
    quote_value,
)
from sdp_vs_penalty.files import reading
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.joint import HeldJoint

#: "test" where a word of a run's name begins: "test", "run_test3", "armTest".
_TEST_WORD = re.compile(r"(?<![A-Za-z])(?i:test)|(?<=[a-z])Test")

#: One run as Measurements, a file's path, a mapping or table of columns; or a sequence
#: of runs.
Source: TypeAlias = Any

#: Where a folder has its runs: in it, or as a data set of LeRobot has them.
_PLACES_OF_RUNS = ("*", "chunk-*/*", "data/chunk-*/*")
#: Travel of a joint that a brake or a controller holds [rad, m], and its share of what
#: the joint that moves most does.
_STILL = 0.01
_SWAY = 0.05
#: Rows from which the travel of held joints is taken.
_ROWS_OF_TRAVEL = 100_000


@checked_arguments
def load_measurements(
    *paths: Source,
    joints: int | None = None,
    start: float = 0.0,
    stop: float = np.inf,
    names: Sequence[str] | None = None,
    as_written: bool = False,
) -> Measurements:
    """Read runs from files.

    Formats are .csv, .npz, .mat, .parquet, ROS bags, .mcap, and folders with a file a
    quantity or a joint.

    Parameters
    ----------
    *paths : path, or a table of columns
        One file a run, or folders and patterns of such files.
    joints : int, optional
        The number of joints expected.
    start : float
        Where the window of each run begins [s after its first sample].
    stop : float
        Where it ends [s after its first sample].
    names : sequence of str, optional
        The robot's joint names, for formats that name theirs (ROS).
    as_written : bool
        Whether names mean what they say, and ours mean SI, whatever values and arm tell.

    Returns
    -------
    Measurements
        All runs, kept apart.

    Raises
    ------
    InputError
        Naming file, row and column, for whatever cannot be used.
    """
    if not paths:
        raise InputError("No measurement file is given", "name at least one RUN.csv")
    runs = as_measurements(paths, joints, names, as_written=as_written)
    return windowed(runs, [(float(start), float(stop))])


def as_measurements(
    source: Source,
    joints: int | None = None,
    names: Sequence[str] | None = None,
    what: str = "measurements",
    *,
    usable: bool = True,
    as_written: bool = False,
    recorders: Sequence[Recorder] = (),
) -> Measurements:
    """Make measurements of what a caller passes: paths, arrays, tables, or a list of
    these.

    Parameters
    ----------
    source : Source
        A path (see :func:`load_measurements`); a mapping with t (N,) [s], q, tau and
        optionally dq (N, n) [rad, N m, rad/s; m, N, m/s]; a DataFrame or mapping with
        RUN.csv's columns; Measurements; or a sequence of these, one a run. A DataFrame
        is read as its file is: rows with empty cells are left out, t can hold dates.
    names : Sequence[str] | None
        Names of the robot's joints in order, for files that name theirs.
    what : str
        How messages call the source, such as "compare(measurements=...)".
    usable : bool
        Refuse a run with a clock that does not ascend or numbers that are not finite.
        The data check, which reports such faults itself, sets False.
    as_written : bool
        Whether names of files mean what they say, whatever values and arm tell.
    recorders : Sequence[Recorder]
        What the arm has told of other runs: their ``recorders``.

    Raises
    ------
    InputError
        A source that is no measurement, or cannot be used; the same run twice.
    """
    several = source if isinstance(source, list | tuple) else [source]
    sources = list[Any]()
    for part in several:
        is_path = isinstance(part, str | Path)
        sources += run_files(part, names or ()) if is_path else [part]
    if not sources:
        raise InputError("no run is given", "pass at least one", what)

    def read(place: int, told: Sequence[Recorder]) -> Measurements:
        part, number = sources[place], place + 1
        return _one(part, joints, names, what, number, usable, as_written, told)

    runs = require_runs(read_by_recorder(read, len(sources), recorders))
    if usable and len(runs) > 1:
        _refuse_repeated_runs(sources, runs)
    return concatenate(runs)


def _refuse_repeated_runs(sources: Sequence[Any], runs: Sequence[Measurements]) -> None:
    """Raise InputError where two runs hold the same samples: they would count as a
    repetition without noise."""
    name_of_hash = dict[str, str | Path]()
    for part, run in zip(sources, runs, strict=True):
        name = part if isinstance(part, str | Path) else run.names[0]
        data_hash = run.data_hash
        if data_hash in name_of_hash:
            same = f"holds the same samples as {name_of_hash[data_hash]}"
            raise InputError(same, "name each run once", name)
        name_of_hash[data_hash] = name


def _one(
    part: Any,
    joints: int | None,
    names: Sequence[str] | None,
    what: str,
    number: int,
    usable: bool,
    as_written: bool,
    recorders: Sequence[Recorder],
) -> Measurements:
    """Make the measurements of one source: a path, Measurements, or a mapping or
    DataFrame of columns.

    ``joints`` is the expected number of joints, ``names`` are the robot's joint names
    in order. Messages call the argument ``what``, and the source has its ``number``
    (from 1) among those that a caller passes for a name. ``usable`` refuses a run with
    a clock that does not ascend, or numbers that are not finite. ``recorders``
    is what the arm has told of other runs.
    """
    if isinstance(part, Measurements):
        run_read = without_traces(without_held(part, names))
    elif isinstance(part, str | Path):
        run_read = read_run(
            part, joints, names, as_written=as_written, recorders=recorders
        )
    else:
        from sdp_vs_penalty.data.formats.memory import log_in_memory

        log = log_in_memory(part, number)
        if log is None:
            remedy = (
                "give a path, a mapping of arrays, a DataFrame, Measurements, or a list"
                " of these"
            )
            raise InputError(
                "no measurements", remedy, what.replace("...", quote_value(part))
            )
        _refuse_transposed(part, log.names, what)
        choice = Choice(as_written=as_written, recorders=recorders)
        run_read = _of_robot(run_of(log, choice), joints, names or (), what)
    # Each run is checked, unless the caller reports faults by itself.
    for run in run_read.runs() if usable else ():
        label = part if isinstance(part, str | Path) else run.names[0]
        check_usable(label, run, _word_of(part))
    return run_read


def _word_of(part: Any) -> str:
    """Return what messages call a sample of a source: "row" or "line" of a text."""
    if not isinstance(part, str | Path):
        return "sample"
    file_format = format_of(Path(part))
    return "row" if file_format is None else getattr(file_format, "SAMPLE", "sample")


def _refuse_transposed(part: Any, columns: Sequence[str], what: str) -> None:
    """Raise InputError for a DataFrame whose rows have the names of channels, where its
    columns should have them."""
    rows = [str(label) for label in getattr(part, "index", ())[:2]]
    if "t" in rows and "t" not in columns:
        raise InputError(
            "a DataFrame is transposed: its rows have the channels' names",
            "give frame.T, a column a channel",
            what,
        )


def for_testing(name: str | Path) -> bool:
    """Tell whether a run is kept for testing: a word of its name or path begins with
    "test" in any spelling, as in "Test2" or "arm_testing", not in "latest"."""
    return bool(_TEST_WORD.search(Path(name).stem))


def training_runs(source: Source) -> Source:
    """Replace folders among the sources of runs by the runs to train on.

    A run that is kept for testing (:func:`for_testing`) is left out of a folder, unless
    all of its runs are; a Remark says which runs are used. A file or a pattern names its
    runs itself, and stays as it is.

    Returns
    -------
    Source
        The same, with files in the place of folders.
    """
    if isinstance(source, list | tuple):
        parts = [training_runs(part) for part in source]
        return [x for part in parts for x in (part if type(part) is list else [part])]
    if not isinstance(source, str | Path) or not os.path.isdir(source):
        return source
    files = run_files(source)
    if files == [Path(source)]:  # one run, with a file for each quantity
        return source
    train = [file for file in files if not for_testing(file)] or files
    said = f"{source}: trained on {formatting.words([file.name for file in train])}"
    if left := [file.name for file in files if file not in train]:
        pronoun = "it" if len(left) == 1 else "them"
        said += (
            f"; {formatting.words(left)} left out for testing, name {pronoun} to train on"
            f" {pronoun}"
        )
    warnings.warn(Remark(said), stacklevel=2)
    return train


def run_files(path: str | Path, joints: Sequence[str] = ()) -> list[Path]:
    """List the files of runs for which a path stands.

    Parameters
    ----------
    path : str | Path
        A file; a pattern like runs/*.csv; a folder of runs; or files of one run joined
        by plus signs, or a folder with a file for each quantity.
    joints : Sequence[str]
        Names of the robot's joints: the files of a folder may be called by them.

    Returns
    -------
    list[Path]
        The files of a pattern or folder in the order of their names; the path itself
        for one run.

    Raises
    ------
    InputError
        A pattern that matches no file.
    """
    path = Path(path)
    if _is_joined(path, joints):
        return [path]
    if os.path.isdir(path) and format_of(path) is None:
        for place in _PLACES_OF_RUNS:
            runs = [x for x in path.glob(place) if x.suffix.lower() in suffixes()]
            if runs:
                return sorted(runs)
        return [path]
    pattern = any(c in str(path) for c in "*?[") and "\0" not in str(path)
    if pattern and not os.path.exists(path):
        paths = sorted(map(Path, glob.glob(str(path))))
        if not paths:
            raise InputError("no file matches this pattern", "check its name", path)
        return paths
    return [path]


def _is_joined(path: Path, joints: Sequence[str] = ()) -> bool:
    """Tell whether a path stands for one run in several files: "a.csv+b.csv", or a
    folder with a file for each quantity or joint."""
    if not path.is_dir() and FILE_SEPARATOR not in str(path):
        return False
    from sdp_vs_penalty.data.joined import files_of_run

    return bool(files_of_run(path, joints))


def windowed(
    full_run: Measurements, windows: Sequence[tuple[float, float]]
) -> Measurements:
    """Cut windows of time out of each run.

    Parameters
    ----------
    windows : Sequence[tuple[float, float]]
        Start and stop of each window [s after the run's first sample].

    Returns
    -------
    Measurements
        One run for each window of each run.

    Raises
    ------
    InputError
        Naming a run of which a window leaves fewer than two samples.
    """
    if list(windows) == [(0.0, np.inf)]:
        return full_run
    windows_cut = []
    for run, (start, stop) in product(full_run.runs(), windows):
        end = "its end" if np.isinf(stop) else f"{stop:g} s"
        part = run.window(start, stop)
        if part.samples < 2:
            lasts = f"the run lasts {run.t[-1] - run.t[0]:.4g} s"
            what = f"no samples between {start:g} s and {end}: {lasts}"
            raise InputError(what, "choose a window inside it", run.names[0])
        name = f"{run.names[0]}, {start:.4g} s to {end}"
        windows_cut.append(part if len(windows) == 1 else part.renamed(name))
    return concatenate(windows_cut)


#: Time on either side of a span that is left out with it: an edge is known to so much
#: [s].
SPAN_MARGIN = 0.25


def without_spans(
    run: Measurements, spans: Sequence[tuple[float, float]]
) -> Measurements:
    """Leave spans of a single run out, and SPAN_MARGIN on either side; the run itself
    where they hold no sample.

    spans : begin and end of each [s], by the run's clock.
    """
    inside = np.zeros(run.samples, bool)
    for begin, end in spans:
        inside |= (run.t >= begin - SPAN_MARGIN) & (run.t <= end + SPAN_MARGIN)
    return run.rows(~inside) if inside.any() else run


def read_run(
    path: str | Path,
    joints: int | None = None,
    names: Sequence[str] | None = None,
    **chosen: Any,
) -> Measurements:
    """Read one run as it is in its file.

    Columns and shapes are checked here; clock and numbers are checked later
    (:func:`check_usable`). Numbers below 1e-30 become zeros.

    Parameters
    ----------
    path : str | Path
        Path of the file or folder, or of several files joined by plus signs.
    names : Sequence[str] | None
        Names of the robot's joints in order, for files that name theirs.
    chosen
        What else is chosen of the file: topic, rename, rate and other fields of
        :class:`~sdp_vs_penalty.data.columns.Choice`.

    Returns
    -------
    Measurements
        The run in SI units. Optional groups, such as dq, are left out where they hold
        no number for some joint.

    Raises
    ------
    InputError
        A file that cannot be read, or positions or torques without any number.
    """
    choice = Choice(names, **chosen)
    if choice.rate is not None and not 0.0 < choice.rate < np.inf:
        what = f"rate {choice.rate!r} is not a frequency above 0 Hz"
        raise InputError(what, "give the samples a second", command="--rate 1000")
    path = Path(path)
    if _is_joined(path, names or ()):
        from sdp_vs_penalty.data.joined import files_of_run, joined_log

        run = run_of(joined_log(path, files_of_run(path, names or ())), choice)
    else:
        with reading(path) as path:
            run = _run_of_file(path, choice)
    if len(run.t) == 0:
        what = "there are no rows, only names"
        raise InputError(what, "record the run, or name another file", path)
    return _of_robot(run, joints, names or (), path)


def _of_robot(
    run: Measurements, joints: int | None, names: Sequence[str], path: str | Path
) -> Measurements:
    """Return the run of a robot's joints, without those that are held, channels without a
    number, and traces; raise InputError for another number of joints."""
    run = without_held(run, names)
    n_missing = len(names) - len(run.joint_names)
    if run.joint_names and 0 < n_missing == len(names) - run.n:
        raise MissingJoints(_joints_missing(names, run.joint_names), path)
    run = _without_silent_channels(path, run)
    if joints is not None and run.n != joints:
        one = _of_one_joint(path, names) if isinstance(path, Path) else None
        raise one or other_robot(run.n, joints, path, names=names)
    return without_traces(run)


def _of_one_joint(path: Path, joints: Sequence[str] | None) -> InputError | None:
    """Return the error of a file that holds one joint of the robot, with the command that
    joins it to those of the others beside it; None where they are not all there."""
    from sdp_vs_penalty.data.joined import files_called_by

    there = path.parent.iterdir() if path.parent.is_dir() else ()
    files = files_called_by(joints or (), [x for x in there if x.suffix == path.suffix])
    if path not in files:
        return None
    command = formatting.convert_command(FILE_SEPARATOR.join(map(str, files)))
    what = "the file holds one joint, as those beside it do"
    return InputError(what, "join them", path, f"`{command}`")


def _run_of_file(path: Path, choice: Choice) -> Measurements:
    """Read the run of a file or folder."""
    file_format = format_of(path)
    if file_format is None and path.is_dir():
        raise InputError("no runs in this folder", "name the file of the run", path)
    if choice.topic is not None and not hasattr(file_format, "HAS_TOPICS"):
        what = "only ROS bags and MCAP files have topics"
        raise InputError(what, "leave the topic out", path, "--topic")
    return run_of(open_log(path), choice)


def without_held(run: Measurements, names: Sequence[str] | None) -> Measurements:
    """Leave out the (N, n) channels of joints that the robot holds still.

    Parameters
    ----------
    names : Sequence[str] | None
        Names of the robot's joints; their attribute ``held`` lists the joints that are
        held.

    Returns
    -------
    Measurements
        The run itself where it does not have the channels of held joints.

    Raises
    ------
    InputError
        A joint that is held moves in the run.
    """
    held = getattr(names, "held", ())
    if not held or names is None or run.n != len(names) + len(held):
        return run
    _require_still(run, held)
    return run.without_joints([joint.place for joint in held])


def _require_still(run: Measurements, held: Sequence[HeldJoint]) -> None:
    """Raise InputError where a held joint moves: farther than _STILL, and than the
    share _SWAY of what the joint that moves most of the others does.

    The share allows for positions in degrees. Of a long run every k-th row is taken,
    and the outer hundredths of the positions are left out.
    """
    q = run.q[:: 1 + len(run.q) // _ROWS_OF_TRAVEL]
    finite = q[np.isfinite(q).all(axis=1)]
    if not len(finite):
        return
    low, high = np.quantile(finite, [0.01, 0.99], axis=0)
    travels = high - low  # (n,) [rad, m]
    others = np.delete(travels, [joint.place for joint in held])
    largest = float(np.max(others, initial=0.0))
    for joint in held:
        travel = float(travels[joint.place])
        if travel > max(_STILL, _SWAY * largest):
            raise InputError(
                f"{joint.name} is held at {joint.value:.6g}, but"
                f" q{joint.place + 1} of the log moves by {travel:.3g} (rad, m)",
                "hold joints that stand still only",
                run.names[0],
            )


def _joints_missing(names: Sequence[str], there: Sequence[str]) -> list[str]:
    """List the robot's joints that are not among the file's."""
    from sdp_vs_penalty.data.words.joints import match_joints

    found = match_joints(names, there)
    return [name for name in names if name not in found]


def _without_silent_channels(path: str | Path, run: Measurements) -> Measurements:
    """Leave out optional groups, such as dq, that hold no number for some joint.

    Positions and torques are needed: for them InputError names the joint.
    """
    groups = dict(run.groups)
    needed = {"q", "tau"}
    for name, block in run.groups.items():
        has_numbers = np.zeros(block.shape[1], bool)  # (n,) of each joint
        for _, part in iter_chunks(block):
            has_numbers |= np.isfinite(part).any(axis=0)
        if has_numbers.all() or len(block) == 0:
            continue
        joint = int(np.flatnonzero(~has_numbers)[0]) + 1
        what = f"column {name}{joint} is never a number, in none of {len(block)} rows"
        if name in needed:
            remedy = "log it anew with this channel; there is nothing to repair"
            raise InputError(what, remedy, path)
        warnings.warn(f"{path}: {what}: {name} is left out", Remark, stacklevel=3)
        del groups[name]
    if len(groups) == len(run.groups):
        return run
    return run.with_channels(run.t, groups)


def check_usable(path: str | Path, m: Measurements, word: str = "sample") -> None:
    """Refuse a run that is too short, has numbers that are not finite or not plausible,
    or a clock that does not ascend.

    Messages call the run path and a sample word; "row" counts from the header: the first
    sample is row 2. The InputError is a RepairableError for faults with a repair.
    """
    if len(m.t) < 2:
        many = formatting.count(len(m.t), "sample")
        raise InputError(f"the run has {many}", "record longer", path)
    for name, values in {"t": m.t[:, None], **m.groups}.items():
        for start, part in iter_chunks(values):
            is_bad = ~(np.abs(part) <= LARGEST_VALUE[name])  # of no number it is false
            if is_bad.any():
                row, joint = np.argwhere(is_bad)[0].tolist()
                column = name if name == "t" else f"{name}{joint + 1}"
                where = f"{word} {_number(m, start + row, word)}, column {column}"
                value = float(part[row, joint])
                if not np.isfinite(value) and np.mean(m.usable_rows) < 1.0 - MOST_LOST:
                    lost = formatting.percent(1.0 - float(np.mean(m.usable_rows)), 2)
                    what = f"{where} is not a finite number: {lost} of the rows are so"
                    raise InputError(what, "correct them, or log it again", path)
                raise _no_measurement(where, value, word, path)
    _require_advancing_clock(path, m, word)


def _number(m: Measurements, place: int, word: str) -> int:
    """Return the number of a sample, from 0, in messages: of its row in the file, or, of
    a sample, from 1."""
    return place + 1 if word == "sample" else int(m.rows_of_file(place))


def _no_measurement(
    where: str, value: float, word: str, path: str | Path
) -> InputError:
    """Return the error of a number that no sensor measures, or that is not finite."""
    remedy = f"correct the {word} or delete it"
    if np.isfinite(value):
        return InputError(f"{where}: no robot measures {value:.3g}", remedy, path)
    return RepairableError(f"{where} is not a finite number", remedy, path)


#: Share of the steps that go backwards in time from which the last row comes first.
_REVERSED = 0.9


def is_last_row_first(steps: Array) -> bool:
    """Return whether the rows of a run are in the reverse order of time.

    They are where more than nine in ten of the steps that are not zero go backwards. A
    stamp that repeats says nothing about the order.

    Parameters
    ----------
    steps : Array
        (N - 1,) differences of the time stamps from row to row [s].

    Returns
    -------
    bool
        False for a run in which no step is other than zero.
    """
    n_backwards = int(np.sum(steps < 0.0))
    n_forwards = int(np.sum(steps > 0.0))
    return n_backwards > _REVERSED * (n_backwards + n_forwards)


def _require_advancing_clock(path: str | Path, m: Measurements, word: str) -> None:
    """Raise RepairableError where time repeats, or rows lie before earlier ones; a
    clock that was set back begins another run. ``word`` is how messages call a sample."""
    stays = np.concatenate(
        [a + np.flatnonzero(np.diff(x) <= 0) for a, x in iter_chunks(m.t, overlap=1)]
    )
    repeats = any(np.any(np.diff(x) == 0) for _, x in iter_chunks(m.t, overlap=1))
    if len(stays) == 0 or (is_set_back(m.t) and not repeats):
        return
    row = int(stays[0])
    how = "repeats" if m.t[row] == m.t[row + 1] else "runs backwards"
    many = formatting.count(len(stays), f"such {word}")
    steps = f"{m.t[row]:.6g} s to {m.t[row + 1]:.6g} s; {many}"
    what = f"{word} {_number(m, row + 1, word)}, column t: time {how} ({steps})"
    remedy = "delete them, or cut the file there"
    if repeats:
        remedy = "spread coarse stamps, delete copies, or cut the file there"
    if is_last_row_first(np.diff(m.t)):
        remedy = "turn the order of the rows round"
    if np.ptp(m.t) == 0.0:
        raise InputError(
            f"column t is {m.t[0]:.6g} s throughout", "log the clock", path
        )
    raise RepairableError(what, remedy, path)


def save(measurements: Measurements, path: str | Path) -> None:
    """Write one run in the format of the file's suffix.

    The file appears when it is complete: an interruption leaves no half-written file.

    Parameters
    ----------
    path : str | Path
        Path with the suffix .csv, .npz, .parquet or .mat.

    Raises
    ------
    InputError
        A suffix of no format that can be written.
    """
    path = Path(path)
    file_format = format_of(path)
    if file_format is None or not hasattr(file_format, "write"):
        known = ", ".join(sorted(suffixes("write")))
        what = "cannot be written: its suffix names no format"
        raise InputError(what, f"choose one of {known}", path)
    file_format.write(measurements, path)
