"""Measurements of a robot's motion and torque: the type that every reader returns."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import show
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.show import Shown, Summary

Array = NDArray[np.float64]


@dataclass(frozen=True, repr=False)
class Measurements(Shown):
    """One or more runs of one robot.

    t : (N,) s; q, tau : (N, n) rad or m, N m or N; dq : (N, n) measured velocity or None;
    run : (N,) index of the run that a sample belongs to; names : one name a run; temperature : (N, n)
    of each joint's gear or motor [degrees Celsius], or None. whole : the runs that
    these are windows of, all that was recorded, where :meth:`window` made them: what repeats, and with
    it the noise, shows there. ``dataclasses.replace`` drops it: changed samples are no window.
    Velocity and acceleration for identification are not these dq: see preprocessing.
    """

    t: Array
    q: Array
    tau: Array
    dq: Array | None = None
    run: NDArray[np.int64] | None = None
    names: tuple[str, ...] = ("run",)
    temperature: Array | None = None
    whole: Measurements | None = field(default=None, init=False, compare=False)

    @property
    def n(self) -> int:
        return int(self.q.shape[1])

    @property
    def samples(self) -> int:
        return len(self.t)

    def _summary(self) -> Summary:
        runs = self.runs()
        lengths = [float(r.t[-1] - r.t[0]) if len(r.t) else 0.0 for r in runs]
        steps = np.concatenate([np.zeros(0), *(np.diff(r.t) for r in runs)])
        rate = f", {1.0 / np.median(steps):.4g} Hz" if len(steps) and np.median(steps) > 0.0 else ""
        title = f"Measurements: {show.count(len(runs), 'run')}, {show.count(self.n, 'joint')}"
        return title, [
            ("runs", ", ".join(self.names)),
            ("length", ", ".join(f"{x:.4g}" for x in lengths) + f" s{rate}, {self.samples} samples"),
            ("columns", ", ".join(["t", *self.groups])),
        ]

    @property
    def groups(self) -> dict[str, Array]:
        """The blocks (N, n) that are there, by the names of their columns in a file."""
        blocks = {"q": self.q, "dq": self.dq, "tau": self.tau, "temp": self.temperature}
        return {name: block for name, block in blocks.items() if block is not None}

    def runs(self) -> list[Measurements]:
        """The single runs, in order."""
        if self.run is None:
            return [self]
        if np.all(np.diff(self.run) >= 0):  # one after the other: views, no copies
            edges = np.searchsorted(self.run, np.arange(len(self.names) + 1))
            slices = [slice(a, b) for a, b in pairwise(edges.tolist())]
            return [self.rows(s, name) for s, name in zip(slices, self.names, strict=True)]
        return [self.rows(self.run == k, name) for k, name in enumerate(self.names)]

    def window(self, start: float, stop: float) -> Measurements:
        """The samples with start <= t < stop, t in seconds from the start of each run."""
        parts = [r.rows((r.t - r.t[0] >= start) & (r.t - r.t[0] < stop)) for r in self.runs()]
        return concatenate(parts).window_of(self)

    def window_of(self, runs: Measurements) -> Measurements:
        """The same, known as windows of these runs."""
        out = replace(self)
        object.__setattr__(out, "whole", runs.whole or runs)
        return out

    def rows(
        self, keep: NDArray[np.bool_] | NDArray[np.intp] | slice, name: str | None = None
    ) -> Measurements:
        """Some of the samples, as one run; name : of the run, the first one's by default."""
        dq, warm = (None if x is None else x[keep] for x in (self.dq, self.temperature))
        names = (name or self.names[0],)
        return Measurements(self.t[keep], self.q[keep], self.tau[keep], dq, None, names, warm)

    @property
    def data_hash(self) -> str:
        """SHA-256 over the numbers (not the file), so that the format does not matter."""
        digest = hashlib.sha256()
        for run in self.runs():
            for a in (run.t, run.q, run.tau):
                digest.update(repr(a.shape).encode())
                digest.update(np.ascontiguousarray(a, dtype="<f8").tobytes())
        return digest.hexdigest()


@dataclass(frozen=True)
class Runs:
    """train : to identify from, test : to judge on, windows of what was measured; None without a test.

    whole : all of that, each run once, in which the noise is measured."""

    train: Measurements
    test: Measurements | None
    whole: Measurements

    @property
    def judge(self) -> Measurements:
        """What errors are shown of."""
        return self.train if self.test is None else self.test


#: Numbers above which a column holds no measurement, whatever its unit: t [ns since 1970], q and dq
#: [encoder counts], tau [mN m], temp [degrees].
LARGEST_VALUE = {"t": 1e20, "q": 1e9, "dq": 1e9, "tau": 1e12, "temp": 1e4}


def concatenate(parts: Sequence[Measurements]) -> Measurements:
    """Several measurements of one robot as one, their runs kept apart."""
    runs = [run for part in parts for run in part.runs()]
    if len({run.n for run in runs}) > 1:
        raise InputError(
            "the runs have different numbers of joints: "
            + ", ".join(f"{r.names[0]} has {r.n}" for r in runs),
            "name runs of one robot",
        )
    everywhere = [g for g in ("dq", "temp") if all(g in r.groups for r in runs)]
    more = {g: np.concatenate([r.groups[g] for r in runs]) for g in everywhere}
    together = Measurements(
        np.concatenate([r.t for r in runs]),
        np.concatenate([r.q for r in runs]),
        np.concatenate([r.tau for r in runs]),
        more.get("dq"),
        np.repeat(np.arange(len(runs)), [len(r.t) for r in runs]),
        tuple(r.names[0] for r in runs),
        more.get("temp"),
    )
    if all(part.whole is None for part in parts):
        return together
    wholes = {id(whole): whole for whole in (part.whole or part for part in parts)}
    first, *others = wholes.values()
    return together.window_of(concatenate([first, *others]) if others else first)
