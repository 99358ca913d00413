"""Measurements of a robot's motion and torque: the type that every reader returns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.store import (
    PART,
    AppendableArray,
    concatenate_chunks,
    digest,
    iter_chunks,
)
from sdp_vs_penalty.data.stretches import recorded_seconds, rows_behind_pauses
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.results.record import Shown, Summary
from sdp_vs_penalty.robot.arrays import Array, wrong_shape


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


#: Fields of measurements that are a number or n numbers a sample.
_CHANNELS = ("t", "q", "tau", "dq", "temperature")


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
        Unit of ``tau`` where the file says that it is no torque, such as "A".
    """

    t: Array
    q: Array
    tau: Array
    dq: Array | None = None
    run: NDArray[np.int64] | None = None
    names: tuple[str, ...] = ("run",)
    temperature: Array | None = None
    commanded: Mapping[str, Array] = field(default_factory=dict)
    torque_logged: bool = True
    joint_names: tuple[str, ...] = ()
    torque_unit: str = ""
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
        self._leave_out_masked_rows()

    def _leave_out_masked_rows(self) -> None:
        """Leave out every sample of which a channel is masked (``numpy.ma``): its owner
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

        def of_kept_rows(values: Any) -> Any:
            return None if values is None else np.ma.getdata(values)[keep]

        for name in (*_CHANNELS, "run"):
            object.__setattr__(self, name, of_kept_rows(getattr(self, name)))
        commanded = {name: of_kept_rows(x) for name, x in self.commanded.items()}
        object.__setattr__(self, "commanded", commanded)

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
    def of(
        cls,
        t: Array,
        groups: Mapping[str, Array],
        names: tuple[str, ...],
        run: NDArray[np.int64] | None = None,
        torque_unit: str = "",
    ) -> Measurements:
        """Make measurements of those channel groups that a file has.

        Parameters
        ----------
        t : Array
            (N,) instants [s].
        groups : Mapping[str, Array]
            (N, n) blocks by their names in RUN.csv: q, dq, tau, temp, qcmd ....
        names : tuple[str, ...]
            One name a run.
        run : NDArray[np.int64] | None
            (N,) index of the run that each sample belongs to.
        torque_unit : str
            Unit of tau where it is no torque, such as "A".

        Returns
        -------
        Measurements
            Without tau, the feed-forward torque takes its place, or zeros.
        """
        q, tau = groups["q"], groups.get("tau")
        commanded = {
            name: groups[name] for name in (*COMMANDED, *SIMULATED) if name in groups
        }
        if tau is None:
            tau = commanded.get("tauff", np.broadcast_to(0.0, q.shape))
        return cls(
            t,
            q,
            tau,
            dq=groups.get("dq"),
            run=run,
            names=names,
            temperature=groups.get("temp"),
            commanded=commanded,
            torque_logged="tau" in groups,
            torque_unit=torque_unit,
        )

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
        """Cut a window of time out of each run.

        Parameters
        ----------
        start : float
            Beginning of the window [s after the run's first sample].
        stop : float
            End of the window [s], excluded.

        Returns
        -------
        Measurements
            The samples inside.
        """
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
        self,
        keep: NDArray[np.bool_] | NDArray[np.intp] | slice,
        name: str | None = None,
    ) -> Measurements:
        """Take some of the samples as one run.

        Parameters
        ----------
        keep : NDArray[np.bool_] | NDArray[np.intp] | slice
            (N,) flags, indices, or a slice.
        name : str | None
            Name of the run; by default that of the first run.

        Returns
        -------
        Measurements
            The samples; a view where a slice is given.
        """
        groups = {group: block[keep] for group, block in self.groups.items()}
        names = (name or self.names[0],)
        return Measurements.of(self.t[keep], groups, names, None, self.torque_unit)

    def copied(self) -> Measurements:
        """Return the same measurements in arrays of their own."""
        commanded = {name: np.array(block) for name, block in self.commanded.items()}
        copy = replace(
            self,
            t=np.array(self.t),
            q=np.array(self.q),
            tau=np.array(self.tau),
            dq=None if self.dq is None else np.array(self.dq),
            run=None if self.run is None else np.array(self.run),
            temperature=(
                None if self.temperature is None else np.array(self.temperature)
            ),
            commanded=commanded,
        )
        return copy._as_window_of(part.copied() for part in self._cut_from)

    def without_joints(self, places: Sequence[int]) -> Measurements:
        """Leave out the channels of some joints.

        Parameters
        ----------
        places : Sequence[int]
            Places of the joints, from 0.

        Returns
        -------
        Measurements
            The channels of the other joints.
        """
        stays = [k for k in range(self.n) if k not in places]
        groups = {group: block[:, stays] for group, block in self.groups.items()}
        others = Measurements.of(self.t, groups, self.names, self.run, self.torque_unit)
        return others._as_window_of(
            part.without_joints(places) for part in self._cut_from
        )

    def parts(self) -> Iterator[Measurements]:
        """Iterate over consecutive pieces of the samples, 32768 at a time, across
        runs."""
        for start in range(0, len(self.t), PART):
            yield self.rows(slice(start, start + PART))

    def require_torque(self, what: str) -> None:
        """Raise InputError where no torque was logged.

        Parameters
        ----------
        what : str
            What needs the torque, for the message.

        Raises
        ------
        InputError
            No torque was logged.
        """
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


def without_traces(measured: Measurements) -> Measurements:
    """Replace numbers below 1e-30, such as 5e-324, by zeros.

    No sensor resolves them in any unit; filters that fade out leave them. With
    :data:`LARGEST_VALUE` this keeps squares and quotients of samples within range.

    Returns
    -------
    Measurements
        The same object where there are no such numbers.
    """
    groups = {"t": measured.t, **measured.groups}
    with_traces = [name for name, block in groups.items() if _has_traces(block)]
    if not with_traces:
        return measured
    for name in with_traces:
        groups[name] = concatenate_chunks(
            np.where(np.abs(part) < _SMALLEST_VALUE, 0.0, part)
            for _, part in iter_chunks(groups[name])
        )
    return Measurements.of(
        groups.pop("t"), groups, measured.names, measured.run, measured.torque_unit
    )


def _has_traces(block: Array) -> bool:
    """Tell whether an array (N, ...) holds numbers other than zero below 1e-30."""
    return any(
        np.any((np.abs(part) < _SMALLEST_VALUE) & (part != 0.0))
        for _, part in iter_chunks(block)
    )


def gathered(pieces: Iterable[Measurements]) -> Measurements:
    """Join consecutive pieces to one run; large arrays go to the disk.

    Parameters
    ----------
    pieces : Iterable[Measurements]
        At least one piece, in order.

    Returns
    -------
    Measurements
        One run with the last piece's name.
    """
    arrays: dict[str, AppendableArray] = {}
    for piece in pieces:
        names = piece.names
        for name, block in {"t": piece.t, **piece.groups}.items():
            arrays.setdefault(name, AppendableArray()).append(block)
    columns = {name: block.array() for name, block in arrays.items()}
    return Measurements.of(columns["t"], columns, names)


def concatenate(several: Sequence[Measurements]) -> Measurements:
    """Put several measurements of one robot together, their runs kept apart.

    Parameters
    ----------
    several : Sequence[Measurements]
        At least one; one alone is returned as it is.

    Returns
    -------
    Measurements
        All runs, with the groups that every run has.

    Raises
    ------
    InputError
        Runs of different numbers of joints, or with and without torque.
    """
    if len(several) == 1:
        return several[0]
    runs = [run for part in several for run in part.runs()]
    _require_one_kind(runs)
    common_groups = [g for g in runs[0].groups if all(g in r.groups for r in runs)]
    groups = dict[str, Array]()
    for group in common_groups:
        groups[group] = concatenate_chunks(run.groups[group] for run in runs)
    indices = (np.broadcast_to(k, len(run.t)) for k, run in enumerate(runs))
    together = Measurements.of(
        concatenate_chunks(run.t for run in runs),
        groups,
        names=tuple(run.names[0] for run in runs),
        run=concatenate_chunks(indices),
        torque_unit=next(iter({run.torque_unit for run in runs})),
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
        raise InputError(what, "bring them to one unit with convert --scale tau=...")
    if len({run.n for run in runs}) > 1:
        widths = ", ".join(f"{r.names[0]} has {r.n}" for r in runs)
        what = f"the runs have different numbers of joints: {widths}"
        raise InputError(what, "name runs of one robot")
    silent = next((r for r in runs if not r.torque_logged), None)
    if silent is not None and any(r.torque_logged for r in runs):
        what = "no torque, but other runs have one"
        raise InputError(what, "name runs of one kind", silent.names[0])
