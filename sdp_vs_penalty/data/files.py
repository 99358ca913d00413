"""Reading and writing runs: the format comes from the suffix, what makes a run useless is refused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sdp_vs_penalty import show
from sdp_vs_penalty.data.formats import bag, csv, format_of, suffixes
from sdp_vs_penalty.data.formats.columns import Choice
from sdp_vs_penalty.data.formats.pipes import spooled
from sdp_vs_penalty.data.measurements import LARGEST_VALUE, Measurements, concatenate
from sdp_vs_penalty.errors import InputError, other_robot
from sdp_vs_penalty.files import opened


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
        raise InputError("No measurement file is given", "name at least one RUN.csv")
    parts = []
    for path in map(Path, paths):
        part = read_run(path, joints, names)
        word, first = getattr(format_of(path) or csv, "SAMPLE", ("sample", 1))
        check_usable(path, part, word, first)
        parts.append(part)
    refuse_twice(paths, parts)
    return windowed(parts[0] if len(parts) == 1 else concatenate(parts), [(start, stop)])


def windowed(whole: Measurements, windows: Sequence[tuple[float, float]]) -> Measurements:
    """Of each run its windows (start, stop) [s after its beginning], each a run of its own.

    Raises InputError naming the run of which a window leaves nothing.
    """
    if list(windows) == [(0.0, np.inf)]:
        return whole
    parts = []
    for run in whole.runs():
        since = run.t - run.t[0]
        for start, stop in windows:
            end = "its end" if np.isinf(stop) else f"{stop:g} s"
            if np.count_nonzero((since >= start) & (since < stop)) < 2:
                raise InputError(
                    f"no samples between {start:g} s and {end}: the run lasts {since[-1]:.4g} s",
                    "choose a window inside it",
                    run.names[0],
                )
            part = run.window(start, stop)
            name = f"{run.names[0]}, {start:.4g} s to {end}"
            parts.append(part if len(windows) == 1 else replace(part, names=(name,)))
    made = parts[0] if len(parts) == 1 else concatenate(parts)
    return made.window_of(whole)


def read_run(
    path: str | Path,
    joints: int | None = None,
    names: Sequence[str] | None = None,
    topic: str | None = None,
    rename: Mapping[str, str] | None = None,
) -> Measurements:
    """One file as it is: columns and shapes are checked, clock and numbers are not.

    names, topic, rename : see :class:`sdp_vs_penalty.data.formats.columns.Choice`.
    """
    path = Path(path)
    if not path.exists():
        raise InputError("no such file", "check its name", path)
    opened(path)
    home = format_of(path) or csv
    if topic is not None and home is not bag:
        raise InputError("only ROS bags and MCAP files have topics", "leave --topic out", path)
    with spooled(path) as file:
        part: Measurements = home.read(file, Choice(names, topic, rename))
    part = replace(part, names=(path.name,)) if file is not path else part
    if joints is not None and part.n != joints:
        raise other_robot(part.n, joints, path)
    return part


def refuse_twice(paths: Sequence[str | Path], parts: Sequence[Measurements]) -> None:
    """The same samples again would count as a repetition without noise."""
    if len(parts) < 2:  # nothing to compare with: no need to hash the samples
        return
    first: dict[str, int] = {}
    for k, (path, part) in enumerate(zip(paths, parts, strict=True)):
        other = first.setdefault(part.data_hash, k)
        if other != k:
            raise InputError(f"holds the same samples as {paths[other]}", "name each run once", path)


def check_usable(path: str | Path, m: Measurements, word: str = "sample", first: int = 1) -> None:
    """InputError for what makes a run useless: too short, not finite, a clock that does not advance.

    path : what messages call the run; word, first : how they count its samples.
    """
    if len(m.t) < 2:
        raise InputError(f"the run has {show.count(len(m.t), 'sample')}", "record longer", path)
    for name, values in {"t": m.t[:, None], **m.groups}.items():
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            row, joint = bad[0]
            column = name if name == "t" else f"{name}{joint + 1}"
            raise InputError(
                f"{word} {row + first}, column {column} is not a finite number",
                f"delete the {word} or fill it in",
                path,
            )
    steps = np.diff(m.t)
    if np.any(steps <= 0):
        row = int(np.argmax(steps <= 0))
        how = "repeats" if steps[row] == 0 else "runs backwards"
        raise InputError(
            (
                f"{word} {row + 1 + first}, column t: time {how} ({m.t[row]:.6g} s to "
                f"{m.t[row + 1]:.6g} s; {show.count(int(np.sum(steps <= 0)), f'such {word}')})"
            ),
            "delete them, or cut the file there",
            path,
        )
    for name, values in {"t": m.t[:, None], **m.groups}.items():
        if values.size and np.abs(values).max() > LARGEST_VALUE[name]:
            row, joint = np.unravel_index(int(np.argmax(np.abs(values))), values.shape)
            column = name if name == "t" else f"{name}{joint + 1}"
            raise InputError(
                f"{word} {row + first}, column {column}: no robot measures {values[row, joint]:.3g}",
                f"correct the {word} or delete it",
                path,
            )


def save(measurements: Measurements, path: str | Path) -> None:
    """Write one run in the format of the suffix: .csv, .npz, .parquet or .mat, whole or not at all."""
    path = Path(path)
    home = format_of(path)
    if not hasattr(home, "write"):
        known = ", ".join(sorted(suffixes("write")))
        raise InputError("cannot be written: its suffix names no format", f"choose one of {known}", path)
    home.write(measurements, path)  # type: ignore[union-attr]
