"""Measurements of a robot's motion and torque: the type that every reader returns."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.recorder import Recorder
from sdp_vs_penalty.data.store import PART, concatenate_chunks, digest, iter_chunks
from sdp_vs_penalty.data.stretches import recorded_seconds, rows_behind_pauses
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.results.record import Shown, Summary
from sdp_vs_penalty.robot.arrays import Array, Arrays, Indices, Mask, wrong_shape


def _is_array_of_numbers(value: Any) -> bool:
    """Return whether a channel is an array of numbers already."""
    return isinstance(value, np.ndarray) and value.dtype.kind in "fiub"


def _as_numbers(name: str, value: Any) -> Array:
    """Return a channel that is a list or a pandas object as an array of floats.

    Parameters
    ----------
    name
        Of the channel, for the message.

    Raises
    ------
    InputError
        For dates, texts and rows of different lengths.
    """
    try:
        if np.asarray(value).dtype.kind in "fiub":
            return np.asarray(value, float)
        what = "dates or texts"
    except ValueError:
        what = "rows of different lengths"
    unit = "seconds since the first sample" if name == "t" else "a row a sample"
    raise InputError(f"{name} holds {what}, not numbers", f"give it as {unit}")


#: Unit of torques that are used as they are logged, where nobody has named their unit.
UNNAMED_UNIT = "raw units"
#: A log of which a larger share is no measurement is logged again: no repair stands for it.
MOST_LOST = 0.1
#: Fields of measurements that are a number or n numbers a sample.
_CHANNELS = ("t", "q", "tau", "dq", "temperature")
#: Those, and what counts a sample.
_PER_SAMPLE = (*_CHANNELS, "run", "file_rows", "episode")


@dataclass(frozen=True, repr=False, eq=False)
class Measurements(Shown):
    """One or more runs of one robot.

    Identification derives velocity and acceleration from the positions: it does not use
    the measured ``dq``.

    Parameters
    ----------
    t : (N,) array
        Instants [s].
    q : (N, n) array
        Positions [rad or m].
    tau : (N, n) array
        Torques [N m or N].
    dq : (N, n) array, optional
        Measured velocities [rad/s or m/s].
    run : (N,) array of int, optional
        Index of the run that each sample belongs to; default: all belong to the first.
    names : tuple of str
        A name for each run.
    temperature : (N, n) array, optional
        Temperature of each joint's gear or motor [degrees Celsius].
    commanded : mapping of str to (N, n) array
        What the drives were commanded or gave, by the names of :data:`COMMANDED`.
    torque_logged : bool
        False where no torque was measured: ``tau`` then holds the feed-forward torque,
        or zeros.
    joint_names : tuple of str
        What the file calls the joints, if it does and has just been read.
    torque_unit : str
        Unit of ``tau`` where the file says that it is no torque, such as "A", or
        UNNAMED_UNIT.
    reading : str
        What the columns of another program's log were taken for, one sentence; "" where
        names were ours.
    unit_command : str
        The `convert` command that says the unit of q, with UNIT for it, of a log whose
        names do not; "" where they do.
    recorders : tuple of Recorder
        What the arm's torques have told of the logs, of each once: unit of q, order of
        columns, sign bits.
    gains_by_size : str
        The gains, in words, by which ``tau`` is in N m where they fit the robot's masses,
        and nobody has stated them; else "".
    file_rows : (N,) array of int, optional
        Number in its file of each sample's row; default: sample k, from 0, is row k + 2.
    episode : (N,) array of int, optional
        Number of each sample's recording among those of its file that the reader put one
        after the other: where it changes, the step of t is no fact of the file.
    """

    t: Array
    q: Array
    tau: Array
    dq: Array | None = None
    run: NDArray[np.int64] | None = None
    names: tuple[str, ...] = ("run",)
    temperature: Array | None = None
    commanded: Arrays = field(default_factory=dict)
    torque_logged: bool = True
    joint_names: tuple[str, ...] = ()
    torque_unit: str = ""
    reading: str = ""
    unit_command: str = ""
    recorders: tuple[Recorder, ...] = ()
    gains_by_size: str = ""
    file_rows: NDArray[np.int64] | None = None
    episode: NDArray[np.int64] | None = None
    #: Recordings that these samples are windows of; none: they are a whole recording. A
    #: changed copy (``dataclasses.replace``) is a recording of its own.
    _cut_from: tuple[Measurements, ...] = field(
        default=(), init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        """Take lists and pandas objects as arrays; raise InputError for what is no
        number, and for channels of another shape."""
        for name in _CHANNELS:
            value = getattr(self, name)
            if value is not None and not _is_array_of_numbers(value):
                object.__setattr__(self, name, _as_numbers(name, value))
        if not all(map(_is_array_of_numbers, self.commanded.values())):
            blocks = {name: _as_numbers(name, x) for name, x in self.commanded.items()}
            object.__setattr__(self, "commanded", blocks)
        self._check_shapes()
        for name in ("file_rows", "episode"):
            of_samples = getattr(self, name)
            if of_samples is not None and len(of_samples) != len(self.t):
                object.__setattr__(self, name, None)  # of other samples
        self._leave_out_masked_rows()

    def _leave_out_masked_rows(self) -> None:
        """Leave out each sample that has a masked channel (``numpy.ma``): its owner
        says that it is no measurement."""
        channels = [*(getattr(self, name) for name in _CHANNELS)]
        masks = [
            np.ma.getmaskarray(x).reshape(len(self.t), -1).any(axis=1)
            for x in (*channels, *self.commanded.values())
            if isinstance(x, np.ma.MaskedArray)
        ]
        if not masks:
            return
        keep = ~np.any(masks, axis=0)
        if not keep.any():
            raise InputError("every row is masked", "leave some of them unmasked")
        kept = self._mapped(lambda values: np.ma.getdata(values)[keep])
        for name in (*_PER_SAMPLE, "commanded"):
            object.__setattr__(self, name, kept[name])

    def _mapped(self, change: Callable[[Any], Any]) -> dict[str, Any]:
        """Return every field that has a value a sample, changed alike; fields that are
        None stay so."""
        fields = {name: getattr(self, name) for name in _PER_SAMPLE}
        out = {name: None if x is None else change(x) for name, x in fields.items()}
        commanded = {name: change(x) for name, x in self.commanded.items()}
        return {**out, "commanded": commanded}

    def _check_shapes(self) -> None:
        """Raise InputError unless t is (N,) and every channel (N, n)."""
        if self.t.ndim != 1:
            raise wrong_shape("t", self.t.shape, (self.t.size,), "sample")
        count = len(self.t)
        q = self.q
        if q.ndim != 2 or len(q) != count:
            is_transposed = q.ndim == 2 and q.shape[1] == count
            joints = q.shape[0] if is_transposed else q.size // max(len(q), 1)
            raise wrong_shape("q", q.shape, (count, joints), "sample")
        blocks = {"tau": self.tau, "dq": self.dq, "temperature": self.temperature}
        for name, block in {**blocks, **self.commanded}.items():
            if block is not None and block.shape != q.shape:
                raise wrong_shape(name, block.shape, q.shape, "sample")

    @classmethod
    def from_channels(
        cls,
        t: Array,
        groups: Arrays,
        names: tuple[str, ...],
        run: NDArray[np.int64] | None = None,
        torque_unit: str = "",
    ) -> Measurements:
        """Make measurements of those channel groups (N, n) that a file has, by their names
        in RUN.csv: q, dq, tau, temp, qcmd .... Without tau, the feed-forward torque takes
        its place, or zeros."""
        fields = _fields_of(groups)
        return cls(t, run=run, names=names, torque_unit=torque_unit, **fields)

    @property
    def is_unit_stated(self) -> bool:
        """Whether somebody says the unit of ``tau``, which is no torque's."""
        return self.torque_unit not in ("", UNNAMED_UNIT)

    def with_channels(self, t: Array, groups: Arrays) -> Measurements:
        """Return the same samples with other channels (N, n), by their names in
        RUN.csv."""
        return replace(self, t=t, **_fields_of(groups))

    def rows_of_file(self, places: Any) -> NDArray[np.int64]:
        """Return the numbers in the file of the rows of some samples, from 0: below its
        header, from 2, unless rows were left out."""
        places = np.asarray(places, int)
        return places + 2 if self.file_rows is None else self.file_rows[places]

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @cached_property
    def recording(self) -> Measurements:
        """The recording that these samples are a window of, or themselves. Its
        repetitions show the noise, which a window may cut off."""
        return concatenate(self._cut_from) if self._cut_from else self

    def _as_window_of(self, recordings: Iterable[Measurements]) -> Measurements:
        """Return these samples as windows of recordings, each named once."""
        part = replace(self)
        once = {id(recording): recording for recording in recordings}
        object.__setattr__(part, "_cut_from", tuple(once.values()))
        return part

    @property
    def samples(self) -> int:
        """Number of samples in all runs."""
        return len(self.t)

    @property
    def usable_rows(self) -> Mask:
        """Flags (N,) of the rows that hold finite numbers alone, none larger than a robot
        measures."""
        channels = {"t": self.t[:, None], **self.groups}
        # A comparison with NaN is false.
        flags = [
            np.all(np.abs(x) <= LARGEST_VALUE[name], axis=1)
            for name, x in channels.items()
        ]
        return np.asarray(np.all(flags, axis=0))

    def _summary(self) -> Summary:
        """Return the title and the rows that are printed for the object: names and
        lengths [s] of the runs, sampling rate [Hz], and columns."""
        runs = self.runs()
        # Length of each run [s], and the sampling rate from the median step of all.
        with np.errstate(invalid="ignore"):  # stamps may be infinite
            lengths = [float(r.t[-1] - r.t[0]) if len(r.t) else 0.0 for r in runs]
            steps = np.concatenate([np.zeros(0), *(np.diff(r.t) for r in runs)])
        median_step = np.median(steps) if len(steps) else 0.0
        rate = f", {1.0 / median_step:.4g} Hz" if median_step > 0.0 else ""
        n_runs = formatting.count(len(runs), "run")
        n_joints = formatting.count(self.n, "joint")
        shown_lengths = ", ".join(f"{x:.4g}" for x in lengths)
        return f"Measurements: {n_runs}, {n_joints}", [
            ("runs", ", ".join(self.names)),
            ("length", f"{shown_lengths} s{rate}, {self.samples} samples"),
            ("columns", ", ".join(["t", *self.groups])),
        ]

    @property
    def groups(self) -> dict[str, Array]:
        """The channel groups (N, n) that are there, by their names in RUN.csv."""
        tau = self.tau if self.torque_logged else None
        blocks = {
            "q": self.q,
            "dq": self.dq,
            "tau": tau,
            "temp": self.temperature,
            **self.commanded,
        }
        return {name: block for name, block in blocks.items() if block is not None}

    def runs(self) -> list[Measurements]:
        """Return the single runs in order.

        They are cached: each call returns the same objects.
        """
        return [self] if self.run is None else list(self._runs)

    @cached_property
    def _runs(self) -> list[Measurements]:
        """The single runs of measurements with several. They are views if ``run`` (N,),
        the index of each sample's run, ascends; otherwise copies."""
        run = self.run
        assert run is not None
        if all(np.all(np.diff(part) >= 0) for _, part in iter_chunks(run, overlap=1)):
            # One after the other: views, no copies.
            edges = np.searchsorted(run, np.arange(len(self.names) + 1))
            slices = [slice(a, b) for a, b in pairwise(edges.tolist())]
            return [
                self.rows(s, name) for s, name in zip(slices, self.names, strict=True)
            ]
        return [self.rows(run == k, name) for k, name in enumerate(self.names)]

    @cached_property
    def cut_at_pauses(self) -> Measurements:
        """The same samples, each stretch between two pauses of the clock a run by
        itself ("run.csv, stretch 2 of 3"); the same object where no run has a pause."""
        pauses = [rows_behind_pauses(run.t) for run in self.runs()]
        if not any(map(len, pauses)):
            return self
        index = np.zeros(len(self.t), np.int64)
        names = list[str]()
        for k, (name, rows) in enumerate(zip(self.names, pauses, strict=True)):
            n_samples = self.runs()[k].samples
            number = np.searchsorted(rows, np.arange(n_samples), side="right")
            of_run = slice(None) if self.run is None else self.run == k
            index[of_run] = len(names) + number
            count = len(rows) + 1
            names += [f"{name}, stretch {j} of {count}" for j in range(1, count + 1)]
            if count == 1:
                names[-1] = name
        cut = replace(self, run=index, names=tuple(names))
        return cut._as_window_of(part.cut_at_pauses for part in self._cut_from)

    @property
    def seconds(self) -> float:
        """How long the runs last together [s], pauses of their clocks left out."""
        return sum(recorded_seconds(run.t) for run in self.runs() if run.samples)

    def renamed(self, name: str) -> Measurements:
        """Return the same samples, of one run, under another name."""
        return replace(self, names=(name,))._as_window_of(self._cut_from)

    def window(self, start: float, stop: float) -> Measurements:
        """Cut a window out of each run, from ``start`` up to ``stop``, excluded [s after
        the run's first sample]."""
        cut = []
        for run in self.runs():
            since = (part - run.t[0] for _, part in iter_chunks(run.t))
            inside = np.concatenate([(s >= start) & (s < stop) for s in since])
            first = int(inside.argmax())
            last = len(inside) - int(inside[::-1].argmax())
            # In a clock that advances they are one stretch: a view, no copy.
            cut.append(
                run.rows(slice(first, last) if inside[first:last].all() else inside)
            )
        return concatenate(cut)._as_window_of(self._cut_from or (self,))

    def rows(
        self, keep: Mask | Indices | slice, name: str | None = None
    ) -> Measurements:
        """Take some of the samples, by flags (N,), indices or a slice, as one run; a view
        where a slice is given. Its name is by default that of the first run."""
        fields = self._mapped(lambda values: values[keep])
        names = (name or self.names[0],)
        return replace(self, **{**fields, "run": None, "names": names})

    def copied(self) -> Measurements:
        """Return the same measurements in arrays of their own."""
        copy = replace(self, **self._mapped(np.array))
        return copy._as_window_of(part.copied() for part in self._cut_from)

    def without_joints(self, places: Sequence[int]) -> Measurements:
        """Leave out the channels of the joints at some places, from 0."""
        stays = [k for k in range(self.n) if k not in places]
        groups = {group: block[:, stays] for group, block in self.groups.items()}
        return self.with_channels(self.t, groups)._as_window_of(
            part.without_joints(places) for part in self._cut_from
        )

    def parts(self) -> Iterator[Measurements]:
        """Iterate over consecutive pieces of the samples, 32768 at a time, across
        runs."""
        for start in range(0, len(self.t), PART):
            yield self.rows(slice(start, start + PART))

    def require_torque(self, what: str) -> None:
        """Raise InputError where no torque was logged, which ``what`` needs."""
        if not self.torque_logged:
            remedy = (
                "identify from it (the servo's law stands for its torque), or log"
                " tau1..taun"
            )
            problem = f"{what} needs a torque, and this log holds commands alone"
            raise InputError(problem, remedy, self.names[0])

    @property
    def data_hash(self) -> str:
        """SHA-256 over the numbers, so that the same run has one hash in all file
        formats."""
        arrays = []
        for run in self.runs():
            commanded = [
                run.commanded[name] for name in COMMANDED if name in run.commanded
            ]
            arrays += [run.t, run.q, run.tau, *commanded]
        return digest(arrays)


@dataclass(frozen=True)
class Runs:
    """Runs of an identification, split into training and test."""

    #: Windows to identify from.
    train: Measurements
    #: Windows to judge on; None without a test.
    test: Measurements | None
    #: Training and test windows, each run once; a search measures the noise in them.
    all_runs: Measurements
    #: Whole recordings, without windows, whose errors are shown.
    judged_recordings: Measurements

    @property
    def judge(self) -> Measurements:
        """Measurements on which errors are computed: the test, or without one the
        training."""
        return self.train if self.test is None else self.test


#: What drives were told or gave: commanded position [rad, m] and velocity, feed-forward
#: torque [N m, N], motor current [A] and voltage [V]; and where the motor is, on its
#: joint's side of the gear, where q is the link's [rad, m].
COMMANDED = ("qcmd", "dqcmd", "tauff", "current", "voltage", "qmot")
#: The positions that a model makes of the command, and their integral over time; that
#: of q in its place.
SIMULATED = ("qsim", "isim", "isum")
#: Numbers above which a column holds no measurement, whatever its unit: t [ns since
#: 1970], q and dq [encoder counts], tau [mN m], temp [degrees].
LARGEST_VALUE = dict.fromkeys(
    ("q", "dq", "qcmd", "dqcmd", "current", "voltage", "qmot"), 1e9
)
LARGEST_VALUE |= dict.fromkeys(("tau", "tauff", *SIMULATED), 1e12) | {
    "t": 1e20,
    "temp": 1e4,
}
#: Numbers that are smaller are no measurement, whatever their unit.
_SMALLEST_VALUE = 1e-30


def _fields_of(groups: Arrays) -> dict[str, Any]:
    """Return the fields of measurements that hold channel groups (N, n); the feed-forward
    torque stands in for tau, or zeros."""
    q, known = groups["q"], (*COMMANDED, *SIMULATED)
    tau = groups.get("tau", groups.get("tauff", np.broadcast_to(0.0, q.shape)))
    return {
        "q": q,
        "tau": tau,
        "dq": groups.get("dq"),
        "temperature": groups.get("temp"),
        "commanded": {name: groups[name] for name in known if name in groups},
        "torque_logged": "tau" in groups,
    }


def without_traces(measured: Measurements) -> Measurements:
    """Replace numbers below 1e-30, such as 5e-324, by zeros; the same object where there
    are none.

    No sensor resolves them in any unit; filters that fade out leave them. With
    :data:`LARGEST_VALUE` this keeps squares and quotients of samples within range.
    """

    def has_traces(block: Array) -> bool:
        return any(
            np.any((np.abs(part) < _SMALLEST_VALUE) & (part != 0.0))
            for _, part in iter_chunks(block)
        )

    groups = {"t": measured.t, **measured.groups}
    changed = {name: x for name, x in groups.items() if has_traces(x)}
    for name, block in changed.items():
        groups[name] = concatenate_chunks(
            np.where(np.abs(part) < _SMALLEST_VALUE, 0.0, part)
            for _, part in iter_chunks(block)
        )
    return measured.with_channels(groups.pop("t"), groups) if changed else measured


def columns_of(measurements: Measurements) -> dict[str, Array]:
    """List the columns (N,) of a run in SI units by their names in RUN.csv: t, q1 ...,
    dq1 ..., tau1 ...."""
    m = measurements
    out = {"t": m.t}
    for name, block in m.groups.items():
        out |= {f"{name}{j + 1}": block[:, j] for j in range(m.n)}
    return out


def concatenate(several: Sequence[Measurements]) -> Measurements:
    """Put several measurements of one robot together, their runs kept apart, with the
    groups that every run has; one alone is returned as it is. Raises InputError for runs
    of different numbers of joints, or with and without torque."""
    if len(several) == 1:
        return several[0]
    runs = [run for part in several for run in part.runs()]
    _require_one_kind(runs)
    common_groups = [g for g in runs[0].groups if all(g in r.groups for r in runs)]
    groups = dict[str, Array]()
    for group in common_groups:
        groups[group] = concatenate_chunks(run.groups[group] for run in runs)
    indices = (np.broadcast_to(k, len(run.t)) for k, run in enumerate(runs))
    rows = None
    if any(run.file_rows is not None for run in runs):
        rows = concatenate_chunks(
            run.rows_of_file(np.arange(len(run.t))) for run in runs
        )
    episode = None
    if any(run.episode is not None for run in runs):
        episode = concatenate_chunks(
            np.zeros(len(run.t), np.int64) if run.episode is None else run.episode
            for run in runs
        )
    together = Measurements.from_channels(
        concatenate_chunks(run.t for run in runs),
        groups,
        names=tuple(run.names[0] for run in runs),
        run=concatenate_chunks(indices),
        torque_unit=runs[0].torque_unit,
    )
    sentences = dict.fromkeys(run.reading for run in runs if run.reading)
    asked = next((run.unit_command for run in runs if run.unit_command), "")
    together = replace(
        together,
        file_rows=rows,
        episode=episode,
        reading=" ".join(sentences),
        unit_command=asked,
        recorders=tuple(dict.fromkeys(x for run in several for x in run.recorders)),
        gains_by_size=next(filter(None, (x.gains_by_size for x in runs)), ""),
    )
    if not any(part._cut_from for part in several):
        return together
    recordings = [whole for part in several for whole in part._cut_from or (part,)]
    return together._as_window_of(recordings)


def _require_one_kind(runs: Sequence[Measurements]) -> None:
    """Raise InputError for runs with different numbers of joints, or some with and some
    without torque."""
    units = {run.torque_unit for run in runs}
    if len(units) > 1:
        named = ", ".join(f"{r.names[0]} in {r.torque_unit or 'N m'}" for r in runs)
        what = f"the runs have torques in different units: {named}"
        command = "`convert --scale tau=...`"
        raise InputError(what, "bring them to one unit", command=command)
    if len({run.n for run in runs}) > 1:
        widths = ", ".join(f"{r.names[0]} has {r.n}" for r in runs)
        what = f"the runs have different numbers of joints: {widths}"
        raise InputError(what, "name runs of one robot")
    silent = next((r for r in runs if not r.torque_logged), None)
    if silent is not None and any(r.torque_logged for r in runs):
        what = "no torque, but other runs have one"
        raise InputError(what, "name runs of one kind", silent.names[0])
