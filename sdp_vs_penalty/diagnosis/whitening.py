"""The noise of each joint from repetition, and the filter that makes it white.

Where a motion repeats, r(t) - r(t + T) holds no error of the model, only noise (twice), events, and
what depends on time instead of motion: drift. Drift is taken out by regression on the drift columns
of the library, events by their local energy; what is left gives the noise floor and an AR(4)
whitener per joint. Without repeats the model's own residual has to serve, and any claim about what
remains unexplained is weaker: ``source`` says which.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.interpolate import CubicSpline
from scipy.sparse import csgraph

from sdp_vs_penalty.diagnosis.autoregression import ORDER, autoregression, beside, filtered
from sdp_vs_penalty.diagnosis.events import local_excess, noise_profile, robust_scale
from sdp_vs_penalty.diagnosis.rows import DiagnosisRows, Segment
from sdp_vs_penalty.effects.effect import smooth_sign
from sdp_vs_penalty.signals.noise import repeat_period

Array = NDArray[np.float64]

#: Positions that differ by less than this share of a joint's travel count as the same.
_ALIKE = 0.01
#: Fewest differences from which a floor is believed.
_FEWEST = 60
#: Independent values that a median of squares is worth, a value: its efficiency.
_MEDIAN_WORTH = 0.37
#: Events are rare: what fills more than this share of the differences is noise of another kind.
_MOST_EVENTS = 0.15


@dataclass(frozen=True)
class Repeat:
    """Rows ``rows`` (indices into all rows) repeat at the instants ``later`` of another segment."""

    rows: NDArray[np.intp]
    segment: int
    other: int
    later: Array


@dataclass(frozen=True)
class Noise:
    """floor (n,) [N m or N]: standard deviation of the filtered noise; ar (n, ORDER); sigma (n,) of
    the whitened noise; degrees (n,) of freedom behind it; source : "repetition" or "residual";
    suspect (M, n): rows where the repetition shows an event; profile (M, n): how the motion swells
    the noise, around 1; repeats : what repeats what.
    """

    floor: Array
    ar: Array
    sigma: Array
    degrees: Array
    source: str
    suspect: NDArray[np.bool_]
    profile: Array
    repeats: tuple[Repeat, ...] = ()

    def whiten(self, values: Array, joint: int, pieces: Sequence[NDArray[np.intp]]) -> Array:
        """(M, k) columns or (M,) a series, filtered to white noise of unit variance.

        The first ORDER rows of each piece have no past and become zero.
        """
        if not values.any():
            return np.zeros_like(values)
        white = filtered(values, self.ar[joint], pieces)
        scale = self.sigma[joint] * self.profile[:, joint]
        return white / (scale if values.ndim == 1 else scale[:, None])


def pieces_of(rows: DiagnosisRows, joint: int) -> list[NDArray[np.intp]]:
    """Index arrays of consecutive rows that count for a joint."""
    segment, keep = rows.segment, rows.keep[:, joint]
    index = np.arange(len(segment))
    same = (segment[1:] == segment[:-1]) & (keep[1:] == keep[:-1])
    return [p for p in np.split(index, np.flatnonzero(~same) + 1) if keep[p[0]]]


def find_repeats(rows: DiagnosisRows) -> tuple[Repeat, ...]:
    """Every pair of stretches with the same motion, inside runs and between them."""
    out = []
    starts = np.cumsum([0, *(len(s.t) for s in rows.segments)])
    for k, segment in enumerate(rows.segments):
        period = repeat_period(segment.t_dense, segment.q_dense)
        if period is not None:
            out += _pair(segment, segment, period, k, k, starts[k])
        for m in range(k + 1, len(rows.segments)):
            other = rows.segments[m]
            lag = _lag(segment, other)
            if lag is not None:
                out += _pair(segment, other, lag, k, m, starts[k])
    return tuple(out)


def _pair(a: Segment, b: Segment, shift: float, k: int, m: int, start: int) -> list[Repeat]:
    """The rows of a whose motion b repeats ``shift`` seconds later."""
    later = a.t + shift
    inside = a.keep & (later >= b.t_dense[0]) & (later <= b.t_dense[-1])
    if inside.sum() < 2 * ORDER:
        return []
    q_a = CubicSpline(a.t_dense, a.q_dense)(a.t[inside])
    q_b = CubicSpline(b.t_dense, b.q_dense)(later[inside])
    travel = np.maximum(a.q_dense.std(axis=0), 1e-9)
    alike = np.all(np.abs(q_a - q_b) < _ALIKE * np.maximum(travel, 0.05 * travel.max()), axis=1)
    index = start + np.flatnonzero(inside)[alike]
    if len(index) < 2 * ORDER:
        return []
    return [Repeat(index, k, m, later[inside][alike])]


def _lag(a: Segment, b: Segment) -> float | None:
    """Clock difference after which b repeats a from its beginning on, or None; at most 5 s of slip."""
    step = float(a.t_dense[1] - a.t_dense[0])
    q_b = CubicSpline(b.t_dense - b.t_dense[0], b.q_dense)
    clock = a.t_dense - a.t_dense[0]
    span = b.t_dense[-1] - b.t_dense[0]
    travel = np.sqrt(np.mean((a.q_dense - a.q_dense.mean(axis=0)) ** 2))

    def error(slip: float) -> float:
        at = clock + slip
        inside = (at >= 0.0) & (at <= span)
        if inside.sum() * step < 2.0:
            return np.inf
        some = np.flatnonzero(inside)[:: max(1, int(0.1 / step))]
        return float(np.sqrt(np.mean((a.q_dense[some] - q_b(at[some])) ** 2)))

    slips = np.arange(-5.0, 5.0, 0.1)
    errors = np.array([error(s) for s in slips])
    best = float(slips[int(np.argmin(errors))])
    if errors.min() > 0.3 * travel:
        return None
    from scipy.optimize import minimize_scalar

    fine = minimize_scalar(error, bounds=(best - 0.1, best + 0.1), method="bounded").x
    if error(float(fine)) > 0.5 * _ALIKE * travel:
        return None
    return float(fine + b.t_dense[0] - a.t_dense[0])


def noise_of(rows: DiagnosisRows, residual_dense: Sequence[Array], residual: Array) -> Noise:
    """The noise from repetition; from the residual itself where too little repeats.

    residual_dense : per segment (D, n) on the dense grid, none where nothing repeats; residual
    (M, n) on the rows.
    """
    repeats = find_repeats(rows) if len(residual_dense) else ()
    n = rows.n
    suspect = np.zeros((len(rows.t), n), bool)
    if sum(len(r.rows) for r in repeats) < _FEWEST:
        parts = [autoregression(residual[:, j], pieces_of(rows, j)) for j in range(n)]
        ar, sigma = np.array([p[0] for p in parts]), np.array([p[1] for p in parts])
        degrees = np.array([p[2] for p in parts])
        keep = rows.keep
        floor = np.array([residual[keep[:, j], j].std() for j in range(n)])
        return Noise(floor, ar, sigma, degrees, "residual", suspect, np.ones_like(rows.dq))
    splines = [CubicSpline(s.t_dense, r) for s, r in zip(rows.segments, residual_dense, strict=True)]
    index = np.concatenate([r.rows for r in repeats])
    difference = np.concatenate(
        [(residual[r.rows] - splines[r.other](r.later)) / np.sqrt(2.0) for r in repeats]
    )
    gap = np.concatenate([r.later - rows.t[r.rows] for r in repeats])
    pieces = _consecutive(repeats)
    share = min(1.0, _independent(rows, repeats) / len(index))
    t, speed, rates = rows.t[index], rows.dq[index], rate_features(rows)
    profile = np.ones_like(rows.dq)
    floor, ar, sigma, degrees = np.zeros(n), np.zeros((n, ORDER)), np.zeros(n), np.zeros(n)
    for j in range(n):
        x = difference[:, j]
        drift = _drift_columns(t, gap, speed[:, j])
        good = np.ones(len(x), bool)
        for _ in range(3):
            rest = x - drift @ np.linalg.lstsq(drift[good], x[good], rcond=1e-10)[0]
            runs = [p[good[p]] for p in pieces]
            ar[j], sigma[j], degrees[j] = autoregression(rest, runs)
            white = filtered(rest, ar[j], pieces)
            white /= noise_profile(white, rates[j][index], rates[j][index])
            white /= max(robust_scale(white[white != 0.0]), 1e-12)
            good = ~local_excess(white, pieces, n, _MEDIAN_WORTH * len(x))
            if good.mean() < 1.0 - _MOST_EVENTS:
                good[:] = True  # noise that is not stationary, rather than an event
        runs = [p[good[p]] for p in pieces]
        floor[j], ar[j], sigma[j], rank = beside(rest, runs, drift * good[:, None])
        degrees[j] = max(share * degrees[j] - rank, 1.0)
        # Known on the rows that repeat, wanted on all.
        profile[:, j] = noise_profile(filtered(rest, ar[j], runs), rates[j][index], rates[j])
        floor[j] *= np.sqrt(np.mean(profile[rows.keep[:, j], j] ** 2))
        suspect[index[~good], j] = True
        _mark_later(rows, repeats, good, j, suspect)
    return Noise(floor, ar, sigma, degrees, "repetition", suspect, profile, repeats)


def _independent(rows: DiagnosisRows, repeats: Sequence[Repeat]) -> int:
    """How many of the differences are independent: of K instants with the same motion, K - 1.

    Six equal runs make fifteen pairs and not more than five differences an instant.
    """
    first = np.concatenate([r.rows for r in repeats])
    second = np.concatenate([later_rows(rows, r) for r in repeats])
    count = len(rows.t)
    graph = sparse.coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    return count - int(csgraph.connected_components(graph, directed=False)[0])


def later_rows(rows: DiagnosisRows, repeat: Repeat) -> NDArray[np.intp]:
    """Among all rows the first at or after each instant at which the repeat comes back."""
    start = sum(len(s.t) for s in rows.segments[: repeat.other])
    times = rows.segments[repeat.other].t
    return start + np.clip(np.searchsorted(times, repeat.later), 0, len(times) - 1)


def _mark_later(
    rows: DiagnosisRows, repeats: Sequence[Repeat], good: NDArray[np.bool_], joint: int, suspect: Array
) -> None:
    """An event of a difference may have happened at either instant: mark the later one too."""
    first = 0
    for r in repeats:
        bad = ~good[first : first + len(r.rows)]
        first += len(r.rows)
        suspect[later_rows(rows, r)[bad], joint] = True


def rate_features(rows: DiagnosisRows) -> Array:
    """(n, M, 2): for each joint the squares of its modelled torque's rate and of its velocity."""
    parts = []
    for s in rows.segments:
        rate = np.gradient(s.motion.model_torque, s.motion.t, axis=0)
        parts.append(np.stack([s.low_pass @ rate, s.low_pass @ s.motion.dq], axis=2) ** 2)
    return np.swapaxes(np.concatenate(parts), 0, 1)


def _consecutive(repeats: Sequence[Repeat]) -> list[NDArray[np.intp]]:
    pieces, first = [], 0
    for r in repeats:
        index = first + np.arange(len(r.rows))
        pieces += np.split(index, np.flatnonzero(np.diff(r.rows) != 1) + 1)
        first += len(r.rows)
    return pieces


def _drift_columns(t: Array, gap: Array, dq: Array) -> Array:
    """What drifting offsets and frictions leave in a difference of two instants."""
    s = smooth_sign(dq)
    start = t.min()
    columns = [gap * x for x in (np.ones_like(t), s, dq)]
    for T in (15.0, 60.0):
        decay = np.exp(-(t - start) / T) * -np.expm1(-gap / T)
        columns += [decay, decay * s, decay * dq]
    matrix = np.column_stack(columns)
    return matrix / np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
