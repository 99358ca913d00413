"""Measurements of a robot's motion and torque: the type that every reader returns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

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
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.results.record import Shown, Summary
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True, repr=False)
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

    @classmethod
    def of(
        cls,
        t: Array,
        groups: Mapping[str, Array],
        names: tuple[str, ...],
        run: NDArray[np.int64] | None = None,
    ) -> Measurements:
        """Make measurements of the blocks that there are.

        Parameters
        ----------
        t : Array
            (N,) instants [s].
        groups : Mapping[str, Array]
            (N, n) blocks by the names of their columns in a file.
        names : tuple[str, ...]
            One a run.
        run : NDArray[np.int64] | None
            (N,) index of the run that each sample belongs to.

        Returns
        -------
        Measurements
            Without tau the feed-forward torque stands in its place, or zeros.
        """
        q, tau = groups["q"], groups.get("tau")
        commanded = {
            name: groups[name] for name in (*COMMANDED, *SIMULATED) if name in groups
        }
        if tau is None:
            tau = commanded.get("tauff", np.broadcast_to(0.0, q.shape))
        dq = groups.get("dq")
        warm = groups.get("temp")
        return cls(
            t,
            q,
            tau,
            dq,
            run,
            names,
            warm,
            commanded,
            "tau" in groups,
        )

    @property
    def n(self) -> int:
        """How many joints, or channels."""
        return int(self.q.shape[1])

    @property
    def samples(self) -> int:
        """How many samples in all runs."""
        return len(self.t)

    def _summary(self) -> Summary:
        runs = self.runs()
        lengths = [float(r.t[-1] - r.t[0]) if len(r.t) else 0.0 for r in runs]
        with np.errstate(invalid="ignore"):
            steps = np.concatenate(
                [
                    np.zeros(0),
                    *(np.diff(r.t) for r in runs),
                ]
            )
        rate = (
            f", {1.0 / np.median(steps):.4g} Hz"
            if len(steps) and np.median(steps) > 0.0
            else ""
        )
        both = formatting.count(len(runs), "run"), formatting.count(self.n, "joint")
        title = f"Measurements: {', '.join(both)}"
        return title, [
            ("runs", ", ".join(self.names)),
            (
                "length",
                ", ".join(f"{x:.4g}" for x in lengths)
                + f" s{rate}, {self.samples} samples",
            ),
            ("columns", ", ".join(["t", *self.groups])),
        ]

    @property
    def groups(self) -> dict[str, Array]:
        """The blocks (N, n) that are there, by the names of their columns in a file."""
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
        """The single runs, in order; the same ones each time."""
        return [self] if self.run is None else list(self._runs)

    @cached_property
    def _runs(self) -> list[Measurements]:
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

    def window(self, start: float, stop: float) -> Measurements:
        """Cut a window out of each run.

        Parameters
        ----------
        start : float
            Where it begins [s after the run's first sample].
        stop : float
            Where it ends [s], itself outside.

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
        return concatenate(cut)

    def rows(
        self,
        keep: NDArray[np.bool_] | NDArray[np.intp] | slice,
        name: str | None = None,
    ) -> Measurements:
        """Take some of the samples as one run.

        Parameters
        ----------
        keep : NDArray[np.bool_] | NDArray[np.intp] | slice
            (N,) which, indices, or a slice.
        name : str | None
            Of the run; the first one's by default.

        Returns
        -------
        Measurements
            A view where a slice is given.
        """
        groups = {group: block[keep] for group, block in self.groups.items()}
        return Measurements.of(
            self.t[keep],
            groups,
            (name or self.names[0],),
        )

    def without_joints(self, places: Sequence[int]) -> Measurements:
        """Leave out the channels of some joints.

        Parameters
        ----------
        places : Sequence[int]
            Of the joints, from 0.

        Returns
        -------
        Measurements
            The other channels.
        """
        stays = [k for k in range(self.n) if k not in places]
        groups = {group: block[:, stays] for group, block in self.groups.items()}
        return Measurements.of(self.t, groups, self.names, self.run)

    def parts(self) -> Iterator[Measurements]:
        """Consecutive samples, few at a time, whichever run they are of."""
        for start in range(0, len(self.t), PART):
            yield self.rows(slice(start, start + PART))

    def require_torque(self, what: str) -> None:
        """Refuse what needs a torque where none was logged.

        Parameters
        ----------
        what : str
            What needs it, for the message.

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
        """SHA-256 over the numbers (not the file), so that the format does not matter."""
        arrays = []
        for run in self.runs():
            commanded = [
                run.commanded[name] for name in COMMANDED if name in run.commanded
            ]
            arrays += [run.t, run.q, run.tau, *commanded]
        return digest(arrays)


@dataclass(frozen=True)
class Runs:
    """train : to identify from, test : to judge on, windows of what was measured; None
    without a test.

    all_runs : all of that, each run once, in which a search measures the noise;
    judged_recordings : of what errors are shown of, without windows.
    """

    train: Measurements
    test: Measurements | None
    all_runs: Measurements
    judged_recordings: Measurements

    @property
    def judge(self) -> Measurements:
        """What errors are shown of."""
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


def without_traces(measured: Measurements) -> Measurements:
    """Replace numbers that exist in the computer's arithmetic only (5e-324) by zeros:
    with :data:`LARGEST_VALUE` the one place that keeps squares and quotients of
    samples within range. Whatever the unit, no sensor resolves 1e-30, and filters
    that fade out leave less.

    Parameters
    ----------
    measured : Measurements
        One or more runs.

    Returns
    -------
    Measurements
        The same object where there are none.
    """
    groups = {"t": measured.t, **measured.groups}
    smallest = 1e-30
    tiny = {
        name: concatenate_chunks(
            np.where(
                np.abs(x) < smallest,
                0.0,
                x,
            )
            for _, x in iter_chunks(block)
        )
        for name, block in groups.items()
        if any(
            np.any((np.abs(x) < smallest) & (x != 0.0)) for _, x in iter_chunks(block)
        )
    }
    groups |= tiny
    return (
        Measurements.of(groups.pop("t"), groups, measured.names, measured.run)
        if tiny
        else measured
    )


def gathered(pieces: Iterable[Measurements]) -> Measurements:
    """Make one run of consecutive pieces, on the disk where there are many.

    Parameters
    ----------
    pieces : Iterable[Measurements]
        At least one, in order.

    Returns
    -------
    Measurements
        One run under the first piece's name.
    """
    arrays: dict[str, AppendableArray] = {}
    for piece in pieces:
        first = piece
        for name, block in {"t": piece.t, **piece.groups}.items():
            arrays.setdefault(name, AppendableArray()).append(block)
    columns = {name: block.array() for name, block in arrays.items()}
    return Measurements.of(columns["t"], columns, first.names)


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
    everywhere = [g for g in runs[0].groups if all(g in r.groups for r in runs)]
    return Measurements.of(
        concatenate_chunks(r.t for r in runs),
        {g: concatenate_chunks(r.groups[g] for r in runs) for g in everywhere},
        tuple(r.names[0] for r in runs),
        concatenate_chunks(np.broadcast_to(k, len(r.t)) for k, r in enumerate(runs)),
    )


def _require_one_kind(runs: Sequence[Measurements]) -> None:
    """InputError for runs of different robots, or with and without torque."""
    if len({run.n for run in runs}) > 1:
        widths = ", ".join(f"{r.names[0]} has {r.n}" for r in runs)
        what = f"the runs have different numbers of joints: {widths}"
        raise InputError(what, "name runs of one robot")
    silent = next((r for r in runs if not r.torque_logged), None)
    if silent is not None and any(r.torque_logged for r in runs):
        what = "no torque, but other runs have one"
        raise InputError(what, "name runs of one kind", silent.names[0])
