"""One motion of three joints, and tables of it as other programs and people write them."""

import datetime
import re
import warnings

import numpy as np

from sdp_vs_penalty.data import read_run

JOINTS = ("turn", "shoulder", "elbow")
#: The joints as loggers sort them.
SORTED = [2, 1, 0]
RATE = 100.0
T = np.arange(150) / RATE
_ANGLE = 2.0 * T[:, None] + [0.0, 1.0, 2.0]
#: dq is the derivative of q.
Q, DQ = np.sin(_ANGLE), 2.0 * np.cos(_ANGLE)
TAU = np.round(np.random.default_rng(8).normal(size=(150, 3)), 6)
#: Seconds from a second before a midnight on, and in whole hours, minutes and seconds.
_SECONDS = 86_399.0 + T
_CLOCK = np.floor(_SECONDS % 86_400.0 / np.array([[3600.0], [60.0], [1.0]]) + 1e-9)
_HOUR, _MINUTE, _WHOLE = _CLOCK % np.array([[24.0], [60.0], [60.0]])
_FRACTION = _SECONDS - np.floor(_SECONDS + 1e-9)
_BEGIN = datetime.datetime(2026, 4, 30, 23, 59, 59)
_START = 1_740_000_000
_DATED = [_BEGIN + datetime.timedelta(microseconds=round(1e6 * t)) for t in T]
#: What columns can hold.
HELD = {
    **{"t": T, "q": Q, "dq": DQ, "tau": TAU, "deg": np.degrees(Q), "mNm": 1e3 * TAU},
    **{
        "foot-pounds": TAU / (4.4482216152605 * 0.3048),
        "deg/s": np.degrees(DQ),
        "ounces": TAU / (0.02834952 * 9.80665 * 0.0254),
    },
    **{
        "50q": 50.0 * Q,
        "q+1": Q + 1.0,
        "tau/2": 0.5 * TAU,
        "0": 0.0 * T,
        "k": 100.0 * T,
    },
    **{
        "ms": 1e3 * T,
        "us": 1e6 * T,
        "min": T / 60.0,
        "h": T / 3600.0,
        "far": 45_413.5 + T,
    },
    **{"days": 45_413.5 + T / 86_400.0, "datenum": 739_373.5 + T / 86_400.0},
    **{"julian": 2_460_432.0 + T / 86_400.0, "filetime": 133_590_384e9 + 1e7 * T},
    **{"ticks": 638_500e12 + 1e7 * T, "unix": 1_714_560_000_000.0 + 1e3 * T},
    **{"hour": _HOUR, "minute": _MINUTE, "whole": _WHOLE, "second": _WHOLE + _FRACTION},
    **{
        "year": 2026.0 + 0.0 * T,
        "month": 4.0 + 0.0 * T,
        "day": 30.0 + (_SECONDS >= 86_400),
    },
    **{"ms of s": np.round(1e3 * _FRACTION), "us of s": np.round(1e6 * _FRACTION)},
    **{"ns of s": np.round(1e9 * _FRACTION), "epoch": _START + np.floor(T + 1e-9)},
    **{
        "ns": np.round(1e9 * (T - np.floor(T + 1e-9))),
        "text": np.array(["ok"] * len(T)),
    },
    **{"nan": np.nan * Q, "texts": np.full(Q.shape, "off")},
    "day's second": np.array([f"12:00:{58 + int(t + 1e-9)}" for t in T]),
}
HELD |= {"us of ns": HELD["ns"] / 1e3, "ms of ns": HELD["ns"] / 1e6}


def stamps(layout):
    """Stamps in words: by the marks of strftime, or with {} for seconds and milliseconds."""
    if "{}" in layout:
        return np.array(
            [layout.format(f"{58 + t:06.3f}"[:6]) for t in np.minimum(T, 1.999)]
        )
    return np.array([stamp.strftime(layout) for stamp in _DATED])


def names_and_columns(row, held=HELD):
    """Names and columns of a table by a text, "ms=t [ms]; q=pos_{}": what they hold, and
    names, with {} for a joint's number, {z} for that from 0, {j} for its name, {s} for its
    name in another order."""
    names, columns = [], []
    for part in row.split("; "):
        kind, _, pattern = part.partition("=")
        block = stamps(kind[1:]) if kind[0] == "@" else held[kind]
        if "{" not in pattern:
            names.append(pattern)
            columns.append(block)
            continue
        for k in SORTED if "{s}" in pattern else range(block.shape[1]):
            names.append(pattern.format(k + 1, z=k, j=JOINTS[k], s=JOINTS[k]))
            columns.append(block[:, k])
    return names, columns


def cells_of(columns, decimal=".", cell="{:.12g}".format):
    """Rows of texts."""
    texts = [
        x if x.dtype.kind == "U" else [cell(y).replace(".", decimal) for y in x]
        for x in map(np.asarray, columns)
    ]
    return list(zip(*texts, strict=True))


def write(path, lines, encoding="utf-8", ends="\n"):
    """A text of some lines; its folder is made."""
    path.parent.mkdir(exist_ok=True, parents=True)
    path.write_bytes((ends.join(lines) + ends).encode(encoding))
    return path


def log(
    path,
    row,
    above=(),
    mark=",",
    head=None,
    encoding="utf-8",
    ends="\n",
    held=HELD,
    **how,
):
    """A table; ``head`` are its first rows in place of the names."""
    names, columns = names_and_columns(row, held)
    heads = [mark.join(names)] if head is None else head
    lines = [mark.join(cells) for cells in cells_of(columns, **how)]
    return write(path, [*above, *heads, *lines], encoding, ends)


def read(path, joints=JOINTS, **options):
    """A file's run, and all that is said of it."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        run = read_run(path, None, joints, **options)
    return run, " ".join(str(w.message) for w in heard)


def same(run, row="", atol=1e-7):
    """Require the motion; velocities where the text of the columns has them."""
    np.testing.assert_allclose(run.t - run.t[0], T, atol=2e-6)
    np.testing.assert_allclose([run.q, run.tau], [Q, TAU], rtol=1e-6, atol=atol)
    if re.search(r"(^|; )(dq|deg/s)=", row):
        assert run.dq is not None
        np.testing.assert_allclose(run.dq, DQ, atol=atol)
