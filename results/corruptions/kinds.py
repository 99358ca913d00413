"""Semantic corruptions of a log: kind x joint x size. Plausible numbers, wrong meaning.

A generator that knows nothing of the data check: each corruption says what was done to
the run, and under which names the check may report it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import accumulate, combinations, product
from typing import Any

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.runs import interpolated

Spoil = Callable[[Measurements], Measurements]
#: One channel (N,) of a run replaced.
Change = Callable[[Array, Measurements], Array]


@dataclass(frozen=True)
class Corruption:
    """kind : what was done; joints : to which joints (from 0, empty: all); size : how
    much, in words.

    causes : issue kinds that name it. problem : believed instead of the true one;
    beside : a second run of the arm, which is clean, is checked with it.
    """

    kind: str
    joints: tuple[int, ...]
    size: str
    causes: tuple[str, ...]
    spoil: Spoil = lambda run: run
    problem: Callable[[Problem], Problem] = lambda problem: problem
    beside: bool = False

    @property
    def name(self) -> str:
        joints = "+".join(str(j + 1) for j in self.joints)
        return " ".join(
            x for x in (self.kind, f"joint {joints}" if joints else "", self.size) if x
        )


def corruptions(n: int) -> list[Corruption]:
    """All of them for an arm of n joints: those of one channel on the second, a middle
    and the last."""
    chosen = sorted({1 % n, n // 2, n - 1})
    made: list[Corruption] = []

    def add(
        kind: str,
        joints: tuple[int, ...],
        size: str,
        causes: str,
        *how: Any,
        **more: Any,
    ) -> None:
        made.append(
            Corruption(kind, joints, size, tuple(causes.split("|")), *how, **more)
        )

    for (kind, size, causes, name, change), j in product(_channels(n == 1), chosen):
        add(kind, (j,), size, causes, partial(_on, name, j, change))
    for j in chosen:
        signs = np.where(np.arange(n) == j, -1.0, 1.0)
        mirrored = lambda r, s=signs: replace(r, q=r.q * s, tau=r.tau * s, dq=None)  # noqa: E731
        add("joint sign", (j,), "q and tau", "joint sign", mirrored)
    for (kind, size, cause, names), pair in product(_ORDERS, combinations(chosen, 2)):
        add(kind, pair, size, cause, partial(_swapped, names, *pair))
    for kind, size, causes, spoil in _runs():
        add(kind, (), size, causes, spoil)
    for g, word in (
        ((0.0, 0.0, 9.81), "ceiling"),
        ((9.81, 0.0, 0.0), "wall"),
        (_TILTED, "30 deg"),
    ):
        mounted = partial(Problem.with_gravity, gravity=g)
        add("gravity assumed", (), word, "gravity direction", problem=mounted)
    for longer in (0.1, 0.3):
        long = partial(_longer, longer, n // 2)
        causes = "link length|unexplained torque|torque not explained"
        add("link too long", (), f"{longer:g} m", causes, problem=long)
    moved: Sequence[tuple[str, str, str, Change]] = (
        ("torque gain", "x 1.15", "tau", lambda x, r: 1.15 * x),
        ("encoder offset", "3 deg", "q", lambda x, r: x + np.radians(3.0)),
    )
    for j, (kind, size, name, change) in product(chosen[:2], moved):
        word = f"{kind} in one of two runs"
        spoil = partial(_on, name, j, change)
        add(word, (j,), size, kind, spoil, beside=True)
    return made


def _longer(metres: float, j: int, problem: Problem) -> Problem:
    """The kinematics with joint j so much farther from the one before, along the line
    to it."""
    joints = list(problem.robot.joints)
    placement = joints[j].placement.copy()
    away = placement[:3, 3]
    size = float(np.linalg.norm(away))
    placement[:3, 3] = away + metres * (away / size if size > 1e-6 else np.eye(3)[2])
    joints[j] = replace(joints[j], placement=placement)
    return replace(problem, robot=replace(problem.robot, joints=tuple(joints)))


_TILTED = (0.0, -4.905, -8.4957)
_ORDERS: Sequence[tuple[str, str, str, tuple[str, ...]]] = (
    ("torques swapped", "", "torque order", ("tau",)),
    ("positions swapped", "", "position order", ("q",)),
    ("joints swapped", "q and tau", "joint order", ("q", "tau")),
)


def _channels(alone: bool) -> Iterator[tuple[str, str, str, str, Change]]:
    """kind, size, causes, q or tau, and what is made of one joint's channel. Where it
    is alone, that is what is made of all, and q with the wrong sign is tau with the
    wrong sign, seen from behind."""
    lagging = "delay|torque filter" if alone else "channel delay|channel filter"
    yield "torque sign", "", "torque sign", "tau", lambda x, r: -x
    for gain in (0.7, 1.1, 1.3, 2.0):
        yield (
            "torque gain",
            f"x {gain:g}",
            "torque gain",
            "tau",
            lambda x, r, g=gain: g * x,
        )
    for gain, unit in ((100.0, "N cm"), (1000.0, "mN m")):
        word = "torque unit of one column"
        yield word, unit, "torque gain|torque unit", "tau", lambda x, r, g=gain: g * x
    for late in (0.02, 0.05, 0.1):
        word = "one torque channel late"
        size = f"{1e3 * late:g} ms"
        yield (
            word,
            size,
            lagging,
            "tau",
            lambda x, r, s=late: np.interp(r.t - s, r.t, x),
        )
    for f in (0.7, 2.0):
        yield (
            "causal filter of one torque",
            f"{f:g} Hz",
            lagging,
            "tau",
            partial(_lagged, f),
        )
    for share in (0.5, 1.0):
        ramp = partial(_drift, share)
        yield (
            "torque drift",
            f"{share:g} std",
            "torque drift",
            "tau",
            partial(ramp, np.arange),
        )
        late_step = partial(ramp, lambda n: (n - 1.0) * (np.arange(n) > 0.6 * n))
        yield "torque step", f"{share:g} std", "torque step", "tau", late_step
    for limit in (0.4, 0.7):
        clip = lambda x, r, s=limit: np.clip(  # noqa: E731
            x, *(s * np.abs(x).max() * np.array([-1.0, 1.0]))
        )
        yield "saturation", f"at {limit:g} of the peak", "saturation", "tau", clip
        soft = lambda x, r, s=limit: (  # noqa: E731
            s * np.abs(x).max() * np.tanh(x / (s * np.abs(x).max()))
        )
        causes = "saturation|unexplained torque|torque gain"
        yield "soft saturation", f"at {limit:g} of the peak", causes, "tau", soft
    yield "torque magnitude", "one", "torque magnitude", "tau", lambda x, r: np.abs(x)
    causes = "position sign|joint sign" + "|torque sign" * alone
    yield "position sign", "", causes, "q", lambda x, r: -x
    for degrees in (6.0, 30.0, 90.0, -90.0, 180.0):
        turned = np.radians(degrees)
        yield (
            "encoder offset",
            f"{degrees:g} deg",
            "encoder offset",
            "q",
            lambda x, r, d=turned: x + d,
        )
    causes = "positions in degrees|position unit|position range"
    yield (
        "position unit of one column",
        "degrees",
        causes,
        "q",
        lambda x, r: np.degrees(x),
    )
    yield "wrapped angle", "", "wrapped angle", "q", _wrapped
    causes = "frozen position|idle joints" + "|no motion" * alone
    yield (
        "frozen position",
        "whole run",
        causes,
        "q",
        lambda x, r: np.full_like(x, x[0]),
    )
    for (word, name), seconds in product(
        (("position", "q"), ("torque", "tau")), (1.0, 3.0)
    ):
        stale = partial(_held, seconds, False)
        yield (
            f"stale {word}",
            f"{seconds:g} s",
            f"frozen {word}|stale channel",
            name,
            stale,
        )
    for name, height, size in (("tau", 500.0, "tau 500"), ("q", 1.0, "q 1 rad")):
        yield "spikes", size, "spikes", name, partial(_spiked, height)
    for name in ("q", "tau"):
        yield "zeros", name, "spikes|zeros", name, _few_zeros
        for seconds in (0.05, 0.5):
            yield (
                "zeros",
                f"{name} {seconds:g} s",
                # A channel that holds zero for long is frozen at it.
                "zeros|frozen position|frozen torque",
                name,
                partial(_held, seconds, True),
            )


def _runs() -> Iterator[tuple[str, str, str, Spoil]]:
    """kind, size, causes, and what is made of a whole run."""
    doubled = lambda r: _remade(r, np.sort(np.r_[: len(r.t), 100 : len(r.t) : 10]))  # noqa: E731
    yield "doubled rows, clock re-made", "every tenth", "doubled rows", doubled
    for block in (10, 50):
        lose = partial(_lost, block)
        yield (
            "lost rows, clock re-made",
            f"8 x {block} rows",
            "lost rows|one-off event",
            lose,
        )
    yield "rows interpolated", "1.5 s", "interpolated rows", _interpolated
    yield (
        "run repeated",
        "",
        "repeated run",
        lambda r: _remade(r, np.tile(np.arange(len(r.t)), 2)),
    )
    back = lambda r: replace(r, q=r.q[::-1].copy(), tau=r.tau[::-1].copy(), dq=None)  # noqa: E731
    yield "time reversed", "", "time reversed", back
    yield (
        "burst stamps",
        "10 rows in 9 us",
        "burst stamps|jittered time stamps",
        _bursts,
    )
    for factor in (0.5, 0.8, 1.25, 2.0):
        yield (
            "clock rate",
            f"x {factor:g}",
            "clock rate|clock against velocity",
            partial(_clock, lambda t, f=factor: f * t),
        )
    yield "time unit", "ms", "time unit", partial(_clock, lambda t: 1e3 * t)
    for jump, cause in ((1.5, "clock step"), (-1.5, "time runs backwards")):
        set_ = partial(_clock, lambda t, s=jump: t + s * (t > 0.5 * t[-1]))
        yield "clock set", f"{jump:+g} s", cause, set_
    for late in (0.02, 0.06, -0.06):
        shifted = lambda x, r, s=late: np.interp(r.t - s, r.t, x)  # noqa: E731
        yield (
            "all torques late",
            f"{1e3 * late:g} ms",
            "delay",
            partial(_each_torque, shifted),
        )
    slow = partial(_each_torque, partial(_lagged, 1.5))
    yield "causal filter of all torques", "1.5 Hz", "torque filter|delay", slow
    degrees = lambda r: replace(r, q=np.degrees(r.q), dq=None)  # noqa: E731
    yield "positions in degrees", "", "positions in degrees|position range", degrees
    yield (
        "torque magnitude",
        "all",
        "torque magnitude",
        partial(_each_torque, lambda x, r: np.abs(x)),
    )
    for share in (0.03, 0.1):
        causes = "repeated packets|doubled rows|frozen packets"
        yield "packets repeated", f"{100 * share:g} %", causes, partial(_again, share)
    for seconds in (0.1, 0.5):
        yield (
            "packets held",
            f"3 x {seconds:g} s",
            "frozen packets",
            partial(_packets, seconds),
        )
    yield "all torque signs", "", "torque sign", partial(_each_torque, lambda x, r: -x)
    for gain, size in ((1e3, "mN m"), (0.04, "current")):
        scaled = partial(_each_torque, lambda x, r, g=gain: g * x)
        yield "torque scale", size, "torque unit|torque channel kind", scaled


def _lagged(hertz: float, x: Array, run: Measurements) -> Array:
    """A causal first-order low-pass, sample by sample."""
    shares = 1.0 - np.exp(-2.0 * np.pi * hertz * np.diff(run.t, prepend=run.t[0]))
    steps = zip(x, shares, strict=True)
    return np.array(
        list(accumulate(steps, lambda y, new: y + new[1] * (new[0] - y), initial=x[0]))[
            1:
        ]
    )


def _on(name: str, j: int, change: Change, run: Measurements) -> Measurements:
    values = getattr(run, name).copy()
    values[:, j] = change(values[:, j], run)
    return replace(run, **{name: values}, dq=None)


def _each_torque(change: Change, run: Measurements) -> Measurements:
    return replace(run, tau=np.column_stack([change(x, run) for x in run.tau.T]))


def _swapped(names: Sequence[str], a: int, b: int, run: Measurements) -> Measurements:
    order = np.arange(run.n)
    order[[a, b]] = [b, a]
    return replace(
        run, **{name: getattr(run, name)[:, order] for name in names}, dq=None
    )


def _drift(
    share: float, shape: Callable[[int], Array], x: Array, run: Measurements
) -> Array:
    return x + share * x.std() * shape(len(x)) / (len(x) - 1.0)


def _wrapped(x: Array, run: Measurements) -> Array:
    """Wrapped at a quarter of its range, as a driver does whose zero lies there."""
    cut = x.min() + 0.75 * np.ptp(x)
    return (x - cut) % (2.0 * np.pi) + cut - 2.0 * np.pi


def _held(seconds: float, zero: bool, x: Array, run: Measurements) -> Array:
    """Its value, or zero, for so long from two fifths of the run."""
    since = run.t - run.t[0] - 0.4 * (run.t[-1] - run.t[0])
    gone = (since >= 0.0) & (since < seconds)
    return np.where(gone, 0.0 if zero else x[int(np.argmax(gone))], x)


def _spiked(height: float, x: Array, run: Measurements) -> Array:
    x[(np.linspace(0.2, 0.8, 5) * len(x)).astype(int)] += height * np.array(
        [1, -1, 1, 1, -1]
    )
    return x


def _few_zeros(x: Array, run: Measurements) -> Array:
    x[(np.linspace(0.25, 0.75, 4) * len(x)).astype(int)] = 0.0
    return x


def _remade(run: Measurements, keep: Array) -> Measurements:
    """These rows, with time stamps counted anew at the log's rate, as a converter
    writes them."""
    step = float(np.median(np.diff(run.t)))
    return replace(run.rows(keep), t=run.t[0] + np.arange(len(keep)) * step)


def _lost(block: int, run: Measurements) -> Measurements:
    keep = np.ones(len(run.t), bool)
    for start in np.linspace(0.15, 0.85, 8) * len(keep):
        keep[int(start) : int(start) + block] = False
    return _remade(run, np.flatnonzero(keep))


def _again(share: float, run: Measurements) -> Measurements:
    """Rows that a logger wrote again because no new packet had come."""
    lost = np.random.default_rng(5).random(len(run.t)) < share
    source = np.maximum.accumulate(np.where(lost, 0, np.arange(len(run.t))))
    return replace(run.rows(source), t=run.t)


def _packets(seconds: float, run: Measurements) -> Measurements:
    """Every channel keeps its value so long, three times."""
    source = np.arange(len(run.t))
    for share in (0.2, 0.5, 0.8):
        a = int(share * len(run.t))
        source[a : a + int(seconds / float(np.median(np.diff(run.t))))] = a
    return replace(run.rows(source), t=run.t)


def _interpolated(run: Measurements) -> Measurements:
    since = run.t - run.t[0] - 0.45 * (run.t[-1] - run.t[0])
    keep = ~((since > 0.0) & (since < 1.5))
    q, tau = (interpolated(run.t, run.t[keep], x[keep]) for x in (run.q, run.tau))
    return replace(run, q=q, tau=tau, dq=None)


def _bursts(run: Measurements) -> Measurements:
    step = 10.0 * float(np.median(np.diff(run.t)))
    k = np.arange(len(run.t))
    return replace(run, t=run.t[0] + (k // 10) * step + (k % 10) * 1e-6)


def _clock(change: Callable[[Array], Array], run: Measurements) -> Measurements:
    return replace(run, t=run.t[0] + change(run.t - run.t[0]))
