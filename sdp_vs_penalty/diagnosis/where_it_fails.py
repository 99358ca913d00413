"""Where a model fails: what its residual torque depends on, when it is large, with
which waves.

Nothing here names a physical effect (`diagnose` does); it shows what the error looks
like, joint by joint, beside the noise. Causes are what a person sees in a log: a
reversal, a standstill, high speed, a position, a wave per turn, time, another joint.
Shares are held out: a smooth function of the quantity is fitted to some stretches of
the motion and judged on others, so that a share above zero is no accident of the fit,
nor of a motion that comes back.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.constants import FOLDS, SPECTRUM_NOISE_FACTOR
from sdp_vs_penalty.diagnosis.white_rows import diagnosis_rows, folds_of
from sdp_vs_penalty.effects.effect import smooth_sign
from sdp_vs_penalty.estimation.constants import CHANGES
from sdp_vs_penalty.estimation.drive_torque import driven
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.estimation.verdict import noise_level
from sdp_vs_penalty.files import JsonRecord
from sdp_vs_penalty.formatting import plain_unit, words
from sdp_vs_penalty.results.fact import fact
from sdp_vs_penalty.results.record import Record, Summary
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.noise import REPETITION
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.segments import Segment, SegmentedRuns, window_subsample
from sdp_vs_penalty.signals.standstill import STILL

if TYPE_CHECKING:
    import pandas

REVERSAL = "reversal"
STANDSTILL = "standstill"
HIGH_SPEED = "high speed"
POSITION = "position"
VELOCITY = "velocity"
ACCELERATION = "acceleration"
LOAD = "load"
WAVES = "waves per turn"
TIME = "time"
OTHER_JOINTS = "other joints"
#: The rows of a heat map, in this order.
CAUSES = (
    REVERSAL,
    STANDSTILL,
    HIGH_SPEED,
    VELOCITY,
    POSITION,
    WAVES,
    ACCELERATION,
    LOAD,
    TIME,
    OTHER_JOINTS,
)
#: What a stretch is called whose cause none of these explains.
UNNAMED = "no cause seen"
#: Seconds around a velocity reversal that count as near it, and those over which an
#: error follows it.
NEAR = 0.15
FOLLOWS = 0.4
#: Share of the largest speed from which on a joint is fast.
_FAST = 0.75
#: Hat functions of a quantity; an odd number, so that one of them sits at the reversal
#: itself.
_HATS = 9


#: Of a wave in JSON: how often a revolution, its amplitude, that over its surroundings.
_ORDER = ("per_revolution", "amplitude", "over_surroundings")


class FailingStretch(NamedTuple):
    """Instants [s] of a run between which an error is large, and the cause that is seen
    there."""

    run: str
    start: float
    stop: float
    cause: str


@dataclass(frozen=True)
class JointFailure(JsonRecord):
    """How one joint's residual looks (joint from 1).

    rmse, noise_floor [N m or N]; explainable_share : 1 - floor^2 / rmse^2, of the
    residual's variance, which repeats; held_out_shares : by cause the held-out share of
    the residual's variance that a function of it explains; reversal_lift : RMS within
    0.15 s of velocity reversals over that elsewhere; orders : (waves per revolution,
    amplitude [N m], amplitude over its surroundings), most conspicuous first; stretches
    : where the error is large, with the cause seen there.
    """

    joint: int
    rmse: float
    noise_floor: float | None
    explainable_share: float | None
    held_out_shares: dict[str, float]
    reversal_lift: float
    orders: tuple[tuple[int, float, float], ...]
    stretches: tuple[FailingStretch, ...] = ()

    def numbers(self) -> dict[str, float | None]:
        """Every number by its name; shares in per cent of the error's variance."""
        shares = {"all that repeats": self.explainable_share, **self.held_out_shares}
        numbers = {
            "error [N m or N]": self.rmse,
            "noise floor [N m or N]": self.noise_floor,
            "near reversals over elsewhere": self.reversal_lift,
        }
        return numbers | {
            f"{name} [%]": None if share is None else 100.0 * share
            for name, share in shares.items()
        }

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON; the joint counts from 1."""
        return super().to_dict() | {
            "orders": [dict(zip(_ORDER, one, strict=True)) for one in self.orders],
            "stretches": [s._asdict() for s in self.stretches],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """What :meth:`to_dict` wrote."""
        lift = data["reversal_lift"]
        return cls(
            joint=int(data["joint"]),
            rmse=float(data["rmse"]),
            noise_floor=data["noise_floor"],
            explainable_share=data["explainable_share"],
            held_out_shares=dict(data["held_out_shares"]),
            reversal_lift=float("nan") if lift is None else float(lift),
            orders=tuple(
                (int(one[_ORDER[0]]), float(one[_ORDER[1]]), float(one[_ORDER[2]]))
                for one in data["orders"]
            ),
            stretches=tuple(FailingStretch(**one) for one in data["stretches"]),
        )


def dependences(failure: JointFailure, most_named: int = 3) -> list[tuple[str, float]]:
    """The quantities that the error depends on, the ``most_named`` important, with the share
    of each."""
    best = sorted(failure.held_out_shares.items(), key=lambda item: -item[1])[
        :most_named
    ]
    return [(name, share) for name, share in best if share >= CHANGES]


def sentences(failure: JointFailure, unit: str) -> list[str]:
    """Where one joint's error is large, in words; unit : of its torque."""
    strongest = dependences(failure)
    named = [f"{name} ({100.0 * share:.0f} %)" for name, share in strongest]
    if named:
        out = [f"The error depends most on {words(named)}."]
    else:
        out = [
            f"No function of one cause explains {100.0 * CHANGES:.0f} % of the error on"
            " data left out."
        ]
    near = any(s.cause == REVERSAL for s in failure.stretches)
    if (REVERSAL in dict(strongest) or near) and failure.reversal_lift > 1.0:
        out.append(
            f"Within {NEAR:g} s of the joint's reversals it is"
            f" {failure.reversal_lift:.2g} times as large as elsewhere."
        )
    if failure.orders:
        waves = ", ".join(
            f"{k} ({a:.2g} {plain_unit(unit)}, {r:.0f}x)" for k, a, r in failure.orders
        )
        out.append(
            f"Waves per revolution (amplitude, that over its surroundings): {waves}."
        )
    return out


class Failures(Record, list[JointFailure]):
    """Where a model fails on a run, joint by joint; units : of the joints' torques."""

    def __init__(
        self, failures: Iterable[JointFailure] = (), units: Sequence[str] = ()
    ) -> None:
        super().__init__(failures)
        self.units = tuple(units)

    @fact("times", name="error near reversals over elsewhere")
    def reversal_lift(self) -> Array:
        """(n,) RMS error within 0.15 s of a joint's reversals over that elsewhere."""
        return np.array([f.reversal_lift for f in self])

    @fact("")
    def strongest_cause(self) -> str:
        """Of the joint whose error is the most times its noise: the cause that explains
        most of it on data left out."""
        worst = self.worst_first[0]
        strongest = dependences(worst, 1)
        return strongest[0][0] if strongest else UNNAMED

    @property
    def worst_first(self) -> list[JointFailure]:
        """By error over noise, or by the error where the noise is not known."""
        above = [f.rmse / f.noise_floor if f.noise_floor else f.rmse for f in self]
        return [self[int(k)] for k in np.argsort(above)[::-1]]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        return {
            "units": list(self.units),
            "joints": [failure.to_dict() for failure in self],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """What :meth:`to_dict` wrote."""
        return cls(map(JointFailure.from_dict, data["joints"]), data["units"])

    def to_frame(self) -> pandas.DataFrame:
        """One row a joint (from 1): rmse, noise_floor, what the error depends on most."""
        import pandas

        rows = [
            {"rmse": f.rmse, "noise_floor": f.noise_floor, **f.held_out_shares}
            for f in self
        ]
        return pandas.DataFrame(rows, [f.joint for f in self], dtype=float).rename_axis(
            "joint"
        )

    def _summary(self) -> Summary:
        return "Where the model fails, the worst joints first", [
            (f"joint {f.joint}", " ".join(sentences(f, self.units[f.joint - 1])))
            for f in self.worst_first
        ]


def where_it_fails(
    estimate: Estimate | str | Path,
    measurements: Source,
    preprocessing: Preprocessing | None = None,
    *,
    noise: tuple[Array | None, str] | None = None,
) -> Failures:
    """What each joint's residual depends on, and when it is large.

    Of a long recording windows are judged (:mod:`~sdp_vs_penalty.signals.segments`).

    Parameters
    ----------
    estimate : Estimate, str or Path
        The model, or its model.json.
    measurements : path, arrays, DataFrame, Measurements, list of these
        The runs to judge on.
    preprocessing : Preprocessing, optional
        Filter settings; default: the model's.
    noise : tuple of (n,) array or None, and str, optional
        Noise floor of each joint [N m or N], and where it comes from, as a comparison
        with these measurements has them. Default: it is measured.

    Returns
    -------
    Failures
        One JointFailure a joint.

    Raises
    ------
    InputError
        Where the measurements are not of this robot.
    """
    estimate = as_estimate(estimate, "where_it_fails(estimate=...)")
    measurements = as_measurements(
        measurements,
        names=estimate.robot.joint_names,
        what="where_it_fails(measurements=...)",
    )
    estimate.require_joints(measurements)
    estimate, measurements = driven(estimate, measurements)
    settings = (preprocessing or estimate.preprocessing).resolve(measurements)
    searched = window_subsample(measurements, settings)
    rows = diagnosis_rows(searched, estimate, settings)
    residual = rows.residual
    folds = folds_of(rows, FOLDS)
    floors, source = noise or noise_level(
        estimate.problem, FilteredRuns.of(measurements, settings)
    )
    known = states(rows)
    runs = searched.runs()
    smooth = {
        name: [hats(x) for x in known[name].T]
        for name in (VELOCITY, POSITION, ACCELERATION, TIME)
    }
    keep = np.asarray(rows.keep.all(axis=1), bool)
    out = Failures(units=estimate.robot.torque_units)
    for j in range(rows.n):
        error = residual[:, j] - residual[keep, j].mean()
        rmse = float(np.sqrt(np.mean(residual[keep, j] ** 2)))
        floor = None if floors is None else float(floors[j])
        repeats = floor is not None and source == REPETITION and rmse > 0.0
        explainable = (
            max(0.0, 1.0 - (floor / rmse) ** 2)
            if floor is not None and repeats
            else None
        )
        full = [_full_rate(runs[s.run], s, j) for s in rows.segments]
        orders = _orders(full) if estimate.robot.joints[j].kind == "revolute" else ()
        velocity = known["velocity"][:, j]
        columns = cause_columns(known, smooth, rows, j, [k for k, _, _ in orders])
        shares = {
            c: held_out_share(columns[c][keep], error[keep], folds[keep])
            for c in CAUSES
        }
        lift = _reversal_lift(velocity, error, rows, keep)
        stretches = failing_stretches(
            error, floor, velocity, rows.still[:, j], rows, shares
        )
        out.append(
            JointFailure(
                j + 1, rmse, floor, explainable, shares, lift, orders, stretches
            )
        )
    return out


def _reversal_lift(
    velocity: Array, error: Array, rows: SegmentedRuns, keep: NDArray[np.bool_]
) -> float:
    """RMS near velocity reversals over elsewhere; NaN where one of them does not occur."""
    near = np.abs(from_reversal(velocity, rows)[0]) <= NEAR
    if not (keep & near).any() or not np.any(error[keep & ~near]):
        return float("nan")
    return float(
        np.sqrt(np.mean(error[keep & near] ** 2) / np.mean(error[keep & ~near] ** 2))
    )


def _full_rate(
    run: Measurements, segment: Segment, j: int
) -> tuple[Array, Array, float]:
    """Angle (N,), residual (N,) at the log's rate, and that rate."""
    motion = segment.motion
    inside = (run.t >= motion.t[0]) & (run.t <= motion.t[-1])
    t = run.t[inside]
    modelled = np.interp(t, motion.t, motion.modelled[:, j])
    return (
        run.q[inside, j],
        run.tau[inside, j] - modelled,
        1.0 / float(np.median(np.diff(run.t))),
    )


def _orders(
    full: list[tuple[Array, Array, float]], bins: int = 4096
) -> tuple[tuple[int, float, float], ...]:
    """The orders whose amplitude 2 |mean of r exp(-i k q)| stands out most of their
    surroundings; bins : of one revolution, of which eight show a wave."""
    from scipy.ndimage import (
        maximum_filter,
        median_filter,
    )  # scipy.signal takes 0.3 s to import

    spectrum = np.zeros(bins, complex)
    count = 0
    for q, error, _ in full:
        # A window of 101 samples, or of a short segment all.
        width = min(101, len(error))
        smooth = np.convolve(error, np.ones(width) / width, mode="same")
        turned = (
            np.floor((q % (2.0 * np.pi)) / (2.0 * np.pi) * bins).astype(np.intp) % bins
        )
        spectrum += np.fft.fft(np.bincount(turned, error - smooth, bins))
        count += len(q)
    amplitude = 2.0 * np.abs(spectrum[: bins // 8 + 1]) / max(count, 1)
    amplitude[0] = 0.0
    ratio = amplitude / np.maximum(median_filter(amplitude, 31), 1e-300)
    peak = (amplitude == maximum_filter(amplitude, 3)) & (ratio > 4.0)
    peaks = [k for k in np.flatnonzero(peak).tolist() if k > 1]
    peaks.sort(key=lambda k: -amplitude[k])
    return tuple((k, float(amplitude[k]), float(ratio[k])) for k in peaks[:5])


# What an error can depend on, as columns, and the stretches in which it is large.


def states(rows: SegmentedRuns) -> dict[str, Array]:
    """Filtered position, velocity, acceleration, torque and time of every row, each (M,
    n)."""

    names = {POSITION: "q", VELOCITY: "dq", ACCELERATION: "ddq", "torque": "torque"}
    state_by_name = {
        word: np.concatenate(
            [s.low_pass @ getattr(s.motion, name) for s in rows.segments]
        )
        for word, name in names.items()
    }
    return state_by_name | {TIME: np.repeat(rows.t[:, None], rows.n, axis=1)}


def cause_columns(
    known: dict[str, Array],
    smooth: dict[str, list[Array]],
    rows: SegmentedRuns,
    j: int,
    orders: Sequence[int],
) -> dict[str, Array]:
    """By cause the columns (M, k) of which a joint's error (from 0) may be a
    combination; smooth : those of smooth functions of each joint's states; orders : the
    waves per turn that its spectrum shows."""
    x = {name: values[:, j] for name, values in known.items()}
    direction = smooth_sign(x[VELOCITY])
    fast = np.maximum(np.abs(x[VELOCITY]) - _FAST * np.abs(x[VELOCITY]).max(), 0.0)
    still = np.asarray(rows.still[:, j] > STILL, float)
    others = [
        smooth[name][i]
        for i in range(rows.n)
        if i != j
        for name in (VELOCITY, POSITION)
    ]
    return {name: columns_by_joint[j] for name, columns_by_joint in smooth.items()} | {
        REVERSAL: _after_reversals(x[VELOCITY], rows),
        STANDSTILL: np.column_stack([still, still * direction]),
        HIGH_SPEED: np.column_stack([fast, fast * direction]),
        WAVES: _waves(rows, j, orders),
        LOAD: np.hstack([hats(x["torque"]), hats(np.abs(x["torque"]) * direction)]),
        OTHER_JOINTS: np.hstack(others) if others else np.zeros((len(rows.t), 0)),
    }


def hats(x: Array, knots: Array | None = None) -> Array:
    """(N, count) piecewise linear functions that add up to one; knots : by default at
    quantiles."""
    if knots is None:
        knots = np.unique(np.quantile(x, np.linspace(0.0, 1.0, _HATS)))
    if len(knots) < 2:
        return np.ones((len(x), 1))
    return np.column_stack([np.interp(x, knots, unit) for unit in np.eye(len(knots))])


def from_reversal(velocity: Array, rows: SegmentedRuns) -> tuple[Array, Array]:
    """(M,) seconds from the nearest reversal, below zero before it, infinite where
    there is none; and the direction after it."""
    row_numbers = np.arange(len(velocity))
    segment = rows.segment
    turns = np.sign(velocity[1:]) != np.sign(velocity[:-1])
    at = np.flatnonzero(turns & (segment[1:] == segment[:-1]))
    if not len(at):
        return np.full(len(velocity), np.inf), np.zeros(len(velocity))
    middle = 0.5 * (rows.t[at] + rows.t[at + 1])
    sides = np.clip(
        np.searchsorted(at, row_numbers) + np.array([[-1], [0]]), 0, len(at) - 1
    )
    seconds = np.where(segment[at[sides]] == segment, rows.t - middle[sides], np.inf)
    best = np.argmin(np.abs(seconds), axis=0)
    return seconds[best, row_numbers], np.sign(
        velocity[at[sides[best, row_numbers]] + 1]
    )


def _after_reversals(velocity: Array, rows: SegmentedRuns) -> Array:
    """Any function of the time from a reversal, and that times the direction after it."""
    rows_since, direction = from_reversal(velocity, rows)
    near = np.abs(rows_since) < FOLLOWS
    shape = near[:, None] * hats(rows_since, np.linspace(-FOLLOWS, FOLLOWS, _HATS))
    return np.hstack([shape, shape * direction[:, None]])


def _waves(rows: SegmentedRuns, j: int, orders: Sequence[int]) -> Array:
    """Filtered sine and cosine of each order of a joint's angle."""
    parts = []
    for s in rows.segments:
        q = s.motion.q[:, j]
        waves = [s.low_pass @ wave(k * q) for k in orders for wave in (np.cos, np.sin)]
        parts.append(np.column_stack(waves) if waves else np.zeros((len(s.t), 0)))
    return np.concatenate(parts)


def held_out_share(features: Array, error: Array, fold: NDArray[np.intp]) -> float:
    """1 - squared error of the prediction / squared error of none, over held-out folds;
    >= 0."""
    left = total = 0.0
    for f in np.unique(fold):
        out = fold == f
        if out.all() or not features.shape[1]:
            return 0.0
        A = features[~out]
        b = error[~out]
        ridge = 1e-3 * np.trace(A.T @ A) / A.shape[1]
        if ridge == 0.0:  # the cause does not occur
            return 0.0
        theta = np.linalg.solve(A.T @ A + ridge * np.eye(A.shape[1]), A.T @ b)
        left += float(np.sum((error[out] - features[out] @ theta) ** 2))
        total += float(np.sum(error[out] ** 2))
    return max(0.0, 1.0 - left / total) if total > 0.0 else 0.0


def failing_stretches(
    error: Array,
    floor: float | None,
    velocity: Array,
    still: Array,
    rows: SegmentedRuns,
    shares: dict[str, float],
) -> tuple[FailingStretch, ...]:
    """Where a joint's error (M,) is large, with the cause that is seen there: its RMS
    over 2 NEAR beyond the factor within which a floor may be known, or of its own RMS
    without one; for NEAR at least."""
    width = max(1, round(2.0 * NEAR * rows.rate))
    size = np.sqrt(np.convolve(error**2, np.ones(width) / width, mode="same"))
    limit = SPECTRUM_NOISE_FACTOR * (floor or float(np.sqrt(np.mean(error**2))))
    state_at = {
        name: x
        for name, x in shares.items()
        if name not in (REVERSAL, STANDSTILL, HIGH_SPEED)
    }
    best = max(state_at, key=lambda name: state_at[name], default=UNNAMED)
    names = np.array(
        [best if state_at.get(best, 0.0) >= CHANGES else UNNAMED], dtype=object
    ).repeat(len(error))
    names[np.abs(velocity) > _FAST * np.abs(velocity).max()] = HIGH_SPEED
    names[np.abs(from_reversal(velocity, rows)[0]) <= NEAR] = REVERSAL
    names[still > STILL] = STANDSTILL
    names[size <= limit] = ""
    ends = (
        np.flatnonzero(
            (names[1:] != names[:-1]) | (rows.segment[1:] != rows.segment[:-1])
        )
        + 1
    )
    edges = [0, *ends.tolist(), len(names)]
    stretches_found = [
        FailingStretch(
            rows.names[rows.run[a]],
            float(rows.t[a]),
            float(rows.t[b - 1]),
            str(names[a]),
        )
        for a, b in pairwise(edges)
        if names[a]
    ]
    return tuple(s for s in stretches_found if s.stop - s.start >= NEAR)
