"""Measurements of a robot's motion and torque: the type, and the readers and writers of files.

RUN.csv has the header t,q1..qn,dq1..dqn,tau1..taun (dq optional) in s, rad (m), rad/s (m/s),
N m (N); .npz holds arrays of the same names. One file is one run; t is one clock that all runs of a
sitting share. A folder with the four text files of the authors' Panda logger is read as well.
"""

from __future__ import annotations

import hashlib
import re
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import csv_text
from sdp_vs_penalty.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Measurements:
    """One or more runs of one robot.

    t : (N,) s; q, tau : (N, n) rad or m, N m or N; dq : (N, n) measured velocity or None;
    run : (N,) index of the run that a sample belongs to; names : one name a run.
    Velocity and acceleration for identification are not these dq: see preprocessing.
    """

    t: Array
    q: Array
    tau: Array
    dq: Array | None = None
    run: NDArray[np.int64] | None = None
    names: tuple[str, ...] = ("run",)

    @property
    def n(self) -> int:
        return int(self.q.shape[1])

    @property
    def samples(self) -> int:
        return len(self.t)

    def runs(self) -> list[Measurements]:
        """The single runs, in order."""
        if self.run is None:
            return [self]
        if np.all(np.diff(self.run) >= 0):  # one after the other: views, no copies
            edges = np.searchsorted(self.run, np.arange(len(self.names) + 1))
            slices = [slice(a, b) for a, b in pairwise(edges.tolist())]
            return [self._rows(s, (name,)) for s, name in zip(slices, self.names, strict=True)]
        return [self._rows(self.run == k, (name,)) for k, name in enumerate(self.names)]

    def window(self, start: float, stop: float) -> Measurements:
        """The samples with start <= t < stop, t in seconds from the start of each run."""
        parts = [r._rows((r.t - r.t[0] >= start) & (r.t - r.t[0] < stop), r.names) for r in self.runs()]
        return concatenate(parts)

    def _rows(self, keep: NDArray[np.bool_] | slice, names: tuple[str, ...]) -> Measurements:
        dq = None if self.dq is None else self.dq[keep]
        return Measurements(self.t[keep], self.q[keep], self.tau[keep], dq, None, names)

    @property
    def data_hash(self) -> str:
        """SHA-256 over the numbers (not the file), so that the format does not matter."""
        digest = hashlib.sha256()
        for run in self.runs():
            for a in (run.t, run.q, run.tau):
                digest.update(repr(a.shape).encode())
                digest.update(np.ascontiguousarray(a, dtype="<f8").tobytes())
        return digest.hexdigest()


def concatenate(parts: Sequence[Measurements]) -> Measurements:
    """Several measurements of one robot as one, their runs kept apart."""
    runs = [run for part in parts for run in part.runs()]
    if len({run.n for run in runs}) > 1:
        raise InputError(
            "The runs have different numbers of joints: "
            + ", ".join(f"{r.names[0]} has {r.n}" for r in runs)
            + "."
        )
    dq = None
    if all(r.dq is not None for r in runs):
        dq = np.concatenate([r.dq for r in runs if r.dq is not None])
    return Measurements(
        np.concatenate([r.t for r in runs]),
        np.concatenate([r.q for r in runs]),
        np.concatenate([r.tau for r in runs]),
        dq,
        np.repeat(np.arange(len(runs)), [len(r.t) for r in runs]),
        tuple(r.names[0] for r in runs),
    )


def load_measurements(
    *paths: str | Path,
    joints: int | None = None,
    start: float = 0.0,
    stop: float = np.inf,
    names: Sequence[str] | None = None,
) -> Measurements:
    """Read runs: .csv, .npz, .mat, .parquet, ROS bags, .mcap, or folders in the authors' Panda format.

    paths : one file a run; joints : the number of joints expected; start, stop : the window of each run
    to keep [s]; names : of the robot's joints, for formats that name theirs (ROS).
    Raises InputError naming file, row and column for whatever cannot be used.
    """
    if not paths:
        raise InputError("No measurement file is given: name at least one RUN.csv.")
    parts = []
    for path in map(Path, paths):
        part = read_run(path, joints, names)
        _check(path, part)
        parts.append(part)
    _refuse_twice(paths, parts)
    whole = parts[0] if len(parts) == 1 else concatenate(parts)
    if start > 0.0 or np.isfinite(stop):
        for run in whole.runs():
            since = run.t - run.t[0]
            if np.count_nonzero((since >= start) & (since < stop)) < 2:
                end = "its end" if np.isinf(stop) else f"{stop:g} s"
                raise InputError(
                    f"{run.names[0]}: no samples between {start:g} s and {end}: the run lasts "
                    f"{since[-1]:.4g} s."
                )
        whole = whole.window(start, stop)
    return whole


def read_run(
    path: str | Path,
    joints: int | None = None,
    names: Sequence[str] | None = None,
    topic: str | None = None,
    rename: Mapping[str, str] | None = None,
) -> Measurements:
    """One file as it is: columns and shapes are checked, clock and numbers are not.

    names, topic, rename : see :class:`sdp_vs_penalty.formats.Choice`.
    """
    from sdp_vs_penalty import formats

    path = Path(path)
    foreign = formats.reader_of(path) if path.exists() else None
    if foreign is not None:
        part = foreign(path, formats.Choice(names, topic, rename))
    elif not path.exists():
        raise InputError(f"{path}: no such file.")
    elif topic is not None:
        raise InputError(f"{path}: only ROS bags and MCAP files have topics.")
    elif path.is_dir():
        part = _read_panda_folder(path)
    elif rename:
        arrays = numeric_arrays(path) if path.suffix.lower() == ".npz" else _csv_columns(path)
        part = formats.from_columns(path, arrays, rename)
    elif path.suffix.lower() == ".npz":
        part = _read_npz(path)
    else:
        part = _read_csv(path)
    if joints is not None and part.n != joints:
        raise InputError(
            f"{path}: the file has {part.n} joint(s), the robot has {joints}: "
            "choose the problem that belongs to this file."
        )
    return part


def _refuse_twice(paths: Sequence[str | Path], parts: Sequence[Measurements]) -> None:
    """The same samples again would count as a repetition without noise."""
    if len(parts) < 2:  # nothing to compare with: no need to hash the samples
        return
    first: dict[str, int] = {}
    for k, (path, part) in enumerate(zip(paths, parts, strict=True)):
        other = first.setdefault(part.data_hash, k)
        if other != k:
            raise InputError(f"{path}: holds the same samples as {paths[other]}: name each run once.")


def _csv_columns(path: Path) -> dict[str, Array]:
    """All columns of a CSV file with a header of any names."""
    header = csv_text.header(path)
    if len(set(header)) != len(header):
        raise InputError(f"{path}: row 1 names a column twice.")
    rows = csv_text.numbers(path, len(header))
    return {name: rows[:, k] for k, name in enumerate(header)}


def save_csv(measurements: Measurements, path: str | Path) -> None:
    """Write one run as RUN.csv, whole or not at all."""
    from sdp_vs_penalty.files import write_text

    m = measurements
    groups = [("q", m.q), *([] if m.dq is None else [("dq", m.dq)]), ("tau", m.tau)]
    header = ["t", *(f"{name}{j + 1}" for name, _ in groups for j in range(m.n))]
    rows = np.column_stack([m.t, *(a for _, a in groups)])
    lines = [",".join(header), *(",".join(map(repr, row)) for row in rows.tolist())]
    write_text(path, "\n".join(lines) + "\n")


def _read_csv(path: Path) -> Measurements:
    header = csv_text.header(path)
    n, has_dq = _joints_of(path, header)
    rows = csv_text.numbers(path, len(header))
    column = {name: k for k, name in enumerate(header)}

    def group(prefix: str) -> Array:
        return np.ascontiguousarray(rows[:, [column[f"{prefix}{j + 1}"] for j in range(n)]])

    dq = group("dq") if has_dq else None
    return Measurements(rows[:, column["t"]].copy(), group("q"), group("tau"), dq, None, (path.name,))


def _joints_of(path: Path, names: Sequence[str]) -> tuple[int, bool]:
    """Number of joints and whether dq is there, from a header; InputError where it is incomplete."""
    found = {int(m[1]) for name in names if (m := re.fullmatch(r"q([1-9][0-9]{0,3})", name))}
    if not found:
        raise InputError(f"{path}: row 1 names no column q1; the header must read {csv_text.HEADER}.")
    n = max(found)
    has_dq = any(re.fullmatch(r"dq[0-9]+", name) for name in names)
    wanted = [
        "t",
        *(f"{p}{j + 1}" for p in ("q", *(("dq",) if has_dq else ()), "tau") for j in range(n)),
    ]
    for name in wanted:
        if names.count(name) != 1:
            problem = "is missing" if names.count(name) == 0 else "comes twice"
            raise InputError(f"{path}: column {name} {problem} (header: {','.join(names)[:120]}).")
    for name in names:
        if name not in wanted:
            raise InputError(f"{path}: column {name!r} is unknown; expected t, q, dq, tau with numbers.")
    return n, has_dq


def numeric_arrays(path: str | Path) -> dict[str, Array]:
    """The arrays of an .npz file as floats; InputError for anything but real numbers."""
    from sdp_vs_penalty.formats import check_size

    arrays: dict[str, Array] = {}
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(info.file_size for info in archive.infolist())
            packed = sum(info.compress_size for info in archive.infolist())
            check_size(Path(path), size, packed)
        with np.load(path, allow_pickle=False) as file:
            for name in file.files:
                array = file[name]
                if array.dtype.kind not in "fiu":
                    raise InputError(f"{path}: array {name} holds {array.dtype}, not real numbers.")
                arrays[name] = np.atleast_1d(np.asarray(array, float))
    except InputError:
        raise
    except Exception as error:  # zip, zlib and array headers each fail in ways of their own
        what = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path}: not a readable .npz file of numbers ({what}).") from error
    return arrays


def _read_npz(path: Path) -> Measurements:
    arrays = numeric_arrays(path)
    if "q" in arrays:  # whole arrays q (N, n), tau (N, n) instead of one a joint
        for name in ("q", "dq", "tau"):
            block = arrays.pop(name, None)
            if block is not None:
                if block.ndim == 1:
                    block = block[:, None]
                if block.ndim != 2:
                    raise InputError(f"{path}: array {name} has {block.ndim} dimensions, 2 are needed.")
                arrays |= {f"{name}{j + 1}": block[:, j] for j in range(block.shape[1])}
    n, has_dq = _joints_of(path, list(arrays))
    lengths = {name: a.shape for name, a in arrays.items()}
    if len(set(lengths.values())) != 1 or arrays["t"].ndim != 1:
        raise InputError(
            f"{path}: the arrays differ in length ({lengths}); all need one entry a sample."
        )

    def group(prefix: str) -> Array:
        return np.column_stack([arrays[f"{prefix}{j + 1}"] for j in range(n)])

    dq = group("dq") if has_dq else None
    return Measurements(arrays["t"], group("q"), group("tau"), dq, None, (path.name,))


def _read_panda_folder(folder: Path) -> Measurements:
    """The authors' four text files: one number a line, sample-major."""
    columns = {}
    for key, name in (("t", "time"), ("q", "positions"), ("dq", "velocity"), ("tau", "torques")):
        path = folder / f"exciting_traj_{name}.txt"
        if not path.exists():
            raise InputError(
                f"{folder}: a folder is read as the authors' Panda log, and {path.name} is missing."
            )
        columns[key] = _one_column(path)
    t = columns.pop("t")
    if len(t) == 0:
        raise InputError(f"{folder}: the log is empty.")
    for key, values in columns.items():
        if len(values) % len(t) or len(values) != len(columns["q"]):
            raise InputError(f"{folder}: {len(values)} numbers of {key} do not fit {len(t)} instants.")
    q, dq, tau = (columns[key].reshape(len(t), -1) for key in ("q", "dq", "tau"))
    return Measurements(t, q, tau, dq, None, (folder.name,))


def _one_column(path: Path) -> Array:
    """One number a line; what the fast reader cannot read, the careful one names or reads."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            values = np.loadtxt(path, comments=None, ndmin=2)
        if values.shape[1] == 1:
            return values[:, 0]
    except (ValueError, UserWarning, OSError):
        pass
    return csv_text.numbers(path, 1, first=1)[:, 0]


def _check(path: Path, m: Measurements) -> None:
    """InputError for what makes a run useless: too short, not finite, a clock that does not run."""
    if len(m.t) < 2:
        raise InputError(f"{path}: the run has {len(m.t)} sample(s): record longer.")
    # Where a sample is in its file: below the header of a CSV file, otherwise counted from 1.
    from sdp_vs_penalty.formats import reader_of

    text = path.is_file() and path.suffix.lower() != ".npz" and reader_of(path) is None
    word, first = ("row", 2) if text else ("sample", 1)
    for name, values in (("t", m.t[:, None]), ("q", m.q), ("dq", m.dq), ("tau", m.tau)):
        if values is None:
            continue
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            row, joint = bad[0]
            column = name if name == "t" else f"{name}{joint + 1}"
            raise InputError(
                f"{path}: {word} {row + first}, column {column} is not a finite number: "
                f"delete the {word} or fill it in."
            )
    steps = np.diff(m.t)
    if np.any(steps <= 0):
        row = int(np.argmax(steps <= 0))
        how = "repeats" if steps[row] == 0 else "runs backwards"
        raise InputError(
            f"{path}: {word} {row + 1 + first}, column t: time {how} ({m.t[row]:.6g} s to "
            f"{m.t[row + 1]:.6g} s; {int(np.sum(steps <= 0))} such {word}(s)): delete them, or cut the "
            "file there."
        )
