"""Semantic corruptions of a log: kind x joint x size. Plausible numbers, wrong meaning.

A generator that knows nothing of the data check: each corruption says what was done to the run, and
under which names the check may report it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements

Array = NDArray[np.float64]
Spoil = Callable[[Measurements], Measurements]


@dataclass(frozen=True)
class Corruption:
    """kind : what was done; joints : to which joints (from 0, empty: all); size : how much, in words.

    causes : issue kinds that name it. gravity : believed instead of the true one.
    """

    kind: str
    joints: tuple[int, ...]
    size: str
    causes: tuple[str, ...]
    spoil: Spoil = lambda run: run
    gravity: tuple[float, float, float] | None = None

    @property
    def name(self) -> str:
        joints = "+".join(str(j + 1) for j in self.joints)
        return " ".join(x for x in (self.kind, f"joint {joints}" if joints else "", self.size) if x)


def corruptions(n: int, joints: Sequence[int] | None = None) -> list[Corruption]:
    """All of them for an arm of n joints; ``joints`` (from 0) that one-joint corruptions fall on."""
    chosen = tuple(joints) if joints is not None else tuple(sorted({1 % n, n // 2, n - 1}))
    pairs = [(a, b) for a, b in zip(chosen, (*chosen[1:], chosen[0]), strict=True) if a != b]
    return [
        *_torque_channels(chosen),
        *_position_channels(chosen),
        *_events(chosen),
        *_orders(sorted({(min(p), max(p)) for p in pairs})),
        *_rows(),
        *_whole(),
    ]


def rows(run: Measurements, keep: Array) -> Measurements:
    dq = None if run.dq is None else run.dq[keep]
    return replace(run, t=run.t[keep], q=run.q[keep], tau=run.tau[keep], dq=dq)


def remade_clock(run: Measurements, like: Measurements) -> Measurements:
    """Time stamps counted anew at the log's rate, as a converter writes them."""
    return replace(run, t=like.t[0] + np.arange(len(run.q)) * float(np.median(np.diff(like.t))))


def on(name: str, j: int, change: Callable[[Array, Measurements], Array]) -> Spoil:
    """One channel of q or tau replaced by what ``change`` makes of it."""

    def spoil(run: Measurements) -> Measurements:
        values = getattr(run, name).copy()
        values[:, j] = change(values[:, j], run)
        return replace(run, **{name: values}, dq=None)

    return spoil


def _lagged(x: Array, t: Array, hertz: float) -> Array:
    """A causal first-order low-pass, sample by sample."""
    out, state = np.empty_like(x), x[0]
    shares = 1.0 - np.exp(-2.0 * np.pi * hertz * np.diff(t, prepend=t[0]))
    for k, (value, share) in enumerate(zip(x, shares, strict=True)):
        state = state + share * (value - state)
        out[k] = state
    return out


def _torque_channels(joints: Sequence[int]) -> Iterator[Corruption]:
    lagging = ("channel delay", "channel filter")
    for j in joints:
        where = (j,)
        yield Corruption("torque sign", where, "", ("torque sign",), on("tau", j, lambda x, r: -x))
        for gain in (0.7, 1.1, 1.3, 2.0):
            yield Corruption(
                "torque gain", where, f"x {gain:g}", ("torque gain",),
                on("tau", j, lambda x, r, g=gain: g * x),
            )  # fmt: skip
        for gain, unit in ((100.0, "N cm"), (1000.0, "mN m")):
            yield Corruption(
                "torque unit of one column", where, unit, ("torque gain", "torque unit"),
                on("tau", j, lambda x, r, g=gain: g * x),
            )  # fmt: skip
        for late in (0.02, 0.05, 0.1):
            yield Corruption(
                "one torque channel late", where, f"{1e3 * late:g} ms", lagging,
                on("tau", j, lambda x, r, s=late: np.interp(r.t - s, r.t, x)),
            )  # fmt: skip
        for hertz in (0.7, 2.0):
            yield Corruption(
                "causal filter of one torque", where, f"{hertz:g} Hz", lagging,
                on("tau", j, lambda x, r, f=hertz: _lagged(x, r.t, f)),
            )  # fmt: skip
        for share in (0.5, 1.0):
            yield Corruption(
                "torque drift", where, f"{share:g} std", ("torque drift",),
                on("tau", j, lambda x, r, s=share: x + s * x.std() * np.linspace(0, 1, len(x))),
            )  # fmt: skip
            yield Corruption(
                "torque step", where, f"{share:g} std", ("torque step",),
                on("tau", j, lambda x, r, s=share: x + s * x.std() * (np.arange(len(x)) > 0.6 * len(x))),
            )  # fmt: skip
        for limit in (0.4, 0.7):
            yield Corruption(
                "saturation", where, f"at {limit:g} of the peak", ("saturation",),
                on("tau", j, lambda x, r, c=limit: np.clip(x, *(np.abs(x).max() * np.array([-c, c])))),
            )  # fmt: skip


def _position_channels(joints: Sequence[int]) -> Iterator[Corruption]:
    for j in joints:
        where = (j,)
        yield Corruption(
            "position sign", where, "", ("position sign", "joint sign"), on("q", j, lambda x, r: -x)
        )
        yield Corruption("joint sign", where, "q and tau", ("joint sign",), _both_signs(j))
        for degrees in (6.0, 30.0, 90.0, -90.0, 180.0):
            yield Corruption(
                "encoder offset", where, f"{degrees:g} deg", ("encoder offset",),
                on("q", j, lambda x, r, d=degrees: x + np.radians(d)),
            )  # fmt: skip
        yield Corruption(
            "position unit of one column", where, "degrees",
            ("positions in degrees", "position unit", "position range"),
            on("q", j, lambda x, r: np.degrees(x)),
        )  # fmt: skip
        yield Corruption("wrapped angle", where, "", ("wrapped angle",), on("q", j, _wrap))
        yield Corruption(
            "frozen position", where, "whole run",
            ("frozen position", "idle joints"), on("q", j, lambda x, r: np.full_like(x, x[0])),
        )  # fmt: skip
        for seconds in (1.0, 3.0):
            for name in ("q", "tau"):
                word = "position" if name == "q" else "torque"
                yield Corruption(
                    f"stale {word}", where, f"{seconds:g} s", (f"frozen {word}", "stale channel"),
                    on(name, j, lambda x, r, s=seconds: _stale(x, r, s)),
                )  # fmt: skip


def _both_signs(j: int) -> Spoil:
    def spoil(run: Measurements) -> Measurements:
        sign = np.ones(run.n)
        sign[j] = -1.0
        return replace(run, q=run.q * sign, tau=run.tau * sign, dq=None)

    return spoil


def _wrap(x: Array, run: Measurements) -> Array:
    """Wrapped at a quarter of its range, as a driver does whose zero lies there."""
    cut = x.min() + 0.75 * np.ptp(x)
    return (x - cut) % (2.0 * np.pi) + cut - 2.0 * np.pi


def _stale(x: Array, run: Measurements, seconds: float) -> Array:
    since = run.t - run.t[0]
    begin = 0.4 * since[-1]
    first = int(np.searchsorted(since, begin))
    return np.where((since >= begin) & (since < begin + seconds), x[first], x)


def _events(joints: Sequence[int]) -> Iterator[Corruption]:
    def spikes(size: float) -> Callable[[Array, Measurements], Array]:
        def change(x: Array, run: Measurements) -> Array:
            at = np.linspace(0.2, 0.8, 5) * len(x)
            x[at.astype(int)] += size * np.array([1, -1, 1, 1, -1])
            return x

        return change

    def zeros(x: Array, run: Measurements) -> Array:
        at = (np.linspace(0.25, 0.75, 4) * len(x)).astype(int)
        x[at] = 0.0
        return x

    def gone(seconds: float) -> Callable[[Array, Measurements], Array]:
        def change(x: Array, run: Measurements) -> Array:
            since = run.t - run.t[0] - 0.4 * (run.t[-1] - run.t[0])
            return np.where((since >= 0.0) & (since < seconds), 0.0, x)

        return change

    for j in joints:
        where = (j,)
        yield Corruption("spikes", where, "tau 500", ("spikes",), on("tau", j, spikes(500.0)))
        yield Corruption("spikes", where, "q 1 rad", ("spikes",), on("q", j, spikes(1.0)))
        for name in ("q", "tau"):
            yield Corruption("zeros", where, name, ("spikes", "zeros"), on(name, j, zeros))
            for seconds in (0.05, 0.5):
                yield Corruption(
                    "zeros", where, f"{name} {seconds:g} s", ("zeros",), on(name, j, gone(seconds))
                )


def _orders(pairs: Sequence[tuple[int, int]]) -> Iterator[Corruption]:
    def swapped(names: Sequence[str], a: int, b: int) -> Spoil:
        def spoil(run: Measurements) -> Measurements:
            order = np.arange(run.n)
            order[[a, b]] = [b, a]
            changed = {name: getattr(run, name)[:, order] for name in names}
            return replace(run, **changed, dq=None)

        return spoil

    for a, b in pairs:
        yield Corruption("torques swapped", (a, b), "", ("torque order",), swapped(["tau"], a, b))
        yield Corruption("positions swapped", (a, b), "", ("position order",), swapped(["q"], a, b))
        yield Corruption(
            "joints swapped", (a, b), "q and tau", ("joint order",), swapped(["q", "tau"], a, b)
        )


def _rows() -> Iterator[Corruption]:
    def doubled(run: Measurements) -> Measurements:
        at = np.sort(np.concatenate([np.arange(len(run.t)), np.arange(100, len(run.t), 10)]))
        return remade_clock(rows(run, at), run)

    def lost(block: int) -> Spoil:
        def spoil(run: Measurements) -> Measurements:
            keep = np.ones(len(run.t), bool)
            for start in np.linspace(0.15, 0.85, 8) * len(keep):
                keep[int(start) : int(start) + block] = False
            return remade_clock(rows(run, np.flatnonzero(keep)), run)

        return spoil

    def interpolated(run: Measurements) -> Measurements:
        since = run.t - run.t[0]
        keep = ~((since > 0.45 * since[-1]) & (since < 0.45 * since[-1] + 1.5))
        q, tau = (
            np.column_stack([np.interp(run.t, run.t[keep], x[keep]) for x in values.T])
            for values in (run.q, run.tau)
        )
        return replace(run, q=q, tau=tau, dq=None)

    def again(run: Measurements) -> Measurements:
        return remade_clock(rows(run, np.tile(np.arange(len(run.t)), 2)), run)

    def backwards(run: Measurements) -> Measurements:
        return replace(run, q=run.q[::-1].copy(), tau=run.tau[::-1].copy(), dq=None)

    def bursts(run: Measurements) -> Measurements:
        step = 10.0 * float(np.median(np.diff(run.t)))
        k = np.arange(len(run.t))
        return replace(run, t=run.t[0] + (k // 10) * step + (k % 10) * 1e-6)

    def clock(change: Callable[[Array], Array]) -> Spoil:
        return lambda run: replace(run, t=run.t[0] + change(run.t - run.t[0]))

    gap = ("lost rows", "one-off event")
    yield Corruption("doubled rows, clock re-made", (), "every tenth", ("doubled rows",), doubled)
    yield Corruption("lost rows, clock re-made", (), "8 x 10 rows", gap, lost(10))
    yield Corruption("lost rows, clock re-made", (), "8 x 50 rows", gap, lost(50))
    yield Corruption("rows interpolated", (), "1.5 s", ("interpolated rows",), interpolated)
    yield Corruption("run repeated", (), "", ("repeated run",), again)
    yield Corruption("time reversed", (), "", ("time reversed",), backwards)
    yield Corruption(
        "burst stamps", (), "10 rows in 9 us", ("burst stamps", "jittered time stamps"), bursts
    )
    for factor in (0.5, 0.8, 1.25, 2.0):
        yield Corruption(
            "clock rate", (), f"x {factor:g}", ("clock rate",), clock(lambda t, f=factor: f * t)
        )
    yield Corruption("time unit", (), "ms", ("time unit",), clock(lambda t: 1e3 * t))
    ahead = clock(lambda t: t + 1.5 * (t > 0.5 * t[-1]))
    yield Corruption("clock set", (), "+1.5 s", ("clock step",), ahead)
    back = clock(lambda t: t - 1.5 * (t > 0.5 * t[-1]))
    yield Corruption("clock set", (), "-1.5 s", ("time runs backwards",), back)


def _whole() -> Iterator[Corruption]:
    def delayed(seconds: float) -> Spoil:
        def spoil(run: Measurements) -> Measurements:
            late = [np.interp(run.t - seconds, run.t, x) for x in run.tau.T]
            return replace(run, tau=np.column_stack(late))

        return spoil

    def filtered(run: Measurements) -> Measurements:
        return replace(run, tau=np.column_stack([_lagged(x, run.t, 1.5) for x in run.tau.T]))

    for seconds in (0.02, 0.06, -0.06):
        yield Corruption("all torques late", (), f"{1e3 * seconds:g} ms", ("delay",), delayed(seconds))
    yield Corruption("causal filter of all torques", (), "1.5 Hz", ("torque filter", "delay"), filtered)
    yield Corruption(
        "positions in degrees", (), "", ("positions in degrees", "position range"),
        lambda r: replace(r, q=np.degrees(r.q), dq=None),
    )  # fmt: skip
    yield Corruption("all torque signs", (), "", ("torque sign",), lambda r: replace(r, tau=-r.tau))
    size = ("torque unit", "torque channel kind")
    yield Corruption("torque scale", (), "mN m", size, lambda r: replace(r, tau=1e3 * r.tau))
    yield Corruption("torque scale", (), "current", size, lambda r: replace(r, tau=0.04 * r.tau))
    for gravity, word in (
        ((0.0, 0.0, 9.81), "ceiling"),
        ((9.81, 0.0, 0.0), "wall"),
        ((0.0, -4.905, -8.4957), "30 deg"),
    ):
        yield Corruption("gravity assumed", (), word, ("gravity direction",), gravity=gravity)
