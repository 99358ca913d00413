"""Tables without header and clock, as research code writes them: q1..qn, dq1..dqn, tau1..taun."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import reading


def read_headerless(path: str | Path, rate: float) -> Measurements:
    """A run of 3 n comma-separated columns (positions, velocities, torques), ``rate`` rows a second.

    Raises InputError where the rate is none, or the file no such table.
    """
    path = Path(path)
    if not 0.0 < rate < np.inf:
        raise InputError(
            f"rate {rate!r} is not a frequency above 0 Hz", "give the samples a second, like --rate 1000"
        )
    try:
        with reading(path), path.open(encoding="utf-8") as file:
            rows = np.loadtxt(file, delimiter=",", ndmin=2)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(
            f"not rows of as many numbers each ({error})",
            "give each row a number for every column",
            path,
        ) from error
    n, rest = divmod(rows.shape[1], 3)
    if rest or not n:
        raise InputError(
            f"{rows.shape[1]} columns are not three a joint",
            "keep q, dq and tau of each joint",
            path,
        )
    q, dq, tau = (np.ascontiguousarray(rows[:, k * n : (k + 1) * n]) for k in range(3))
    return Measurements(np.arange(len(rows)) / rate, q, tau, dq, None, (path.name,))
