"""Whatever a user has measurements in, as :class:`Measurements`: the one place where that is decided."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.files import check_usable, load_measurements, read_run, refuse_twice, run_files
from sdp_vs_penalty.data.formats.columns import from_columns
from sdp_vs_penalty.data.measurements import Measurements, concatenate, without_traces
from sdp_vs_penalty.errors import InputError, given, other_robot

#: One run as Measurements, a file's path, a mapping or table of columns; or a sequence of runs.
Source: TypeAlias = Any

_REMEDY = "give t, q, tau and, if measured, dq: (N,) and (N, n) arrays, or the columns of RUN.csv"


def as_measurements(
    source: Source,
    joints: int | None = None,
    names: Sequence[str] | None = None,
    what: str = "measurements",
    *,
    usable: bool = True,
) -> Measurements:
    """Measurements from a path, arrays, a table, Measurements, or a sequence of these (one a run).

    source : a path (see :func:`load_measurements`); a mapping with t (N,) s, q, tau and optionally dq
        (N, n) in rad, N m, rad/s (m, N, m/s); a DataFrame or mapping with RUN.csv's columns.
    joints : the number of joints expected; names : the robot's joint names, for files that name theirs.
    what : how messages call it, such as "compare(measurements=...)".
    usable : refuse a run with a broken clock or numbers that are not finite (the data check does not).
    Raises InputError naming what was given where it is no measurement, or cannot be used.
    """
    several = source if isinstance(source, list | tuple) else [source]
    paths = str, Path
    parts = [x for part in several for x in (run_files(part) if isinstance(part, paths) else [part])]
    if not parts:
        raise InputError("no run is given", "pass at least one", what)
    runs = [_one(part, joints, names, what, k, usable) for k, part in enumerate(parts, start=1)]
    if usable:
        both = zip(parts, runs, strict=True)
        refuse_twice([x if isinstance(x, paths) else r.names[0] for x, r in both], runs)
    return runs[0] if len(runs) == 1 else concatenate(runs)


def _one(
    part: Any, joints: int | None, names: Sequence[str] | None, what: str, number: int, usable: bool
) -> Measurements:
    if isinstance(part, Measurements):
        part = without_traces(part)
        for run in part.runs() if usable else ():
            check_usable(run.names[0], run)
        return part
    if isinstance(part, str | Path):
        if usable:
            return load_measurements(part, joints=joints, names=names)
        return read_run(part, joints, names)
    columns = _columns(part)
    if columns is None:
        raise InputError(
            "no measurements",
            "give a path, a mapping of arrays, a DataFrame, Measurements, or a list of these",
            what.replace("...", given(part)),
        )
    run = without_traces(from_columns(f"run{number}", columns, None, remedy=_REMEDY, what=what))
    if joints is not None and run.n != joints:
        raise other_robot(run.n, joints, what)
    if usable:
        check_usable(run.names[0], run)
    return run


def _columns(part: Any) -> dict[str, NDArray[np.float64]] | None:
    """Numeric columns by name of a mapping or a DataFrame; None for anything else."""
    if isinstance(part, Mapping):
        named = {str(key): value for key, value in part.items()}
    elif hasattr(part, "columns") and hasattr(part, "__getitem__"):
        named = {str(key): part[key] for key in part.columns}
    else:
        return None
    out = {}
    for key, value in named.items():
        try:
            out[key] = np.asarray(value, float)
        except (TypeError, ValueError):
            continue  # a column of texts or time stamps: from_columns says what is missing
    return out
