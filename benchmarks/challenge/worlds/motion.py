"""Motions inside an arm's limits: periodic, aperiodic, and from point to point with pauses."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from sdp_vs_penalty.simulation.worlds.arm import Arm, Array
from sdp_vs_penalty.simulation.worlds.world import TrueMotion

States = tuple[Array, Array, Array]

KINDS = ("periodic", "aperiodic", "points")


def plan(
    arm: Arm,
    kind: str,
    duration: float,
    rng: np.random.Generator,
    reach: float = 0.75,
    speed: float = 0.5,
    swing: float = 1.6,
) -> Callable[[Array], States]:
    """A random motion as a function of time [s] from its beginning.

    kind : of KINDS; reach, speed : shares of the position and velocity limits that it uses; swing : the
    farthest from its centre [rad].
    """
    half = np.minimum(0.5 * reach * (arm.upper - arm.lower), swing)
    slack = 0.5 * reach * (arm.upper - arm.lower) - half
    room = 0.5 * (arm.lower + arm.upper), slack, half
    if kind == "points":
        return _points(room, speed * arm.speed, duration, rng)
    if kind == "periodic":
        period = min(float(rng.uniform(8.0, 13.3)), duration / 1.5)
        frequencies = np.tile(np.arange(1, 6)[:, None] / period, (1, arm.n))
    else:
        frequencies = rng.uniform(0.05, 0.5, (8, arm.n))
    return _waves(room, speed * arm.speed, frequencies, duration, rng)


def _placed(room: States, rng: np.random.Generator) -> tuple[Array, Array]:
    """(n,), (n,) centre and half range of a motion somewhere in its room: middle, slack, half range."""
    middle, slack, half = room
    return middle + slack * rng.uniform(-1.0, 1.0, len(half)), half


def _waves(
    room: States, fastest: Array, frequencies: Array, duration: float, rng: np.random.Generator
) -> Callable[[Array], States]:
    """q = c + sum_k a_k sin(w_k t + phi_k), as large as position and velocity limits let it be."""
    w = 2.0 * np.pi * frequencies
    phase = rng.uniform(0.0, 2.0 * np.pi, w.shape)
    size = rng.uniform(0.3, 1.0, w.shape) / np.sqrt(w)
    centre, half = _placed(room, rng)

    def at(t: Array) -> States:
        angle = w * t[:, None, None] + phase
        q = (size * np.sin(angle)).sum(axis=1)
        dq = (size * w * np.cos(angle)).sum(axis=1)
        return q, dq, -(size * w**2 * np.sin(angle)).sum(axis=1)

    q, dq, _ = at(np.arange(0.0, duration, 0.02))
    middle = 0.5 * (q.max(axis=0) + q.min(axis=0))
    fit = np.minimum(half / np.abs(q - middle).max(axis=0), fastest / np.abs(dq).max(axis=0))
    size = fit * size
    centre = centre - fit * middle

    def states(t: Array) -> States:
        q, dq, ddq = at(t)
        return centre + q, dq, ddq

    return states


def _points(
    room: States, fastest: Array, duration: float, rng: np.random.Generator
) -> Callable[[Array], States]:
    """Stop at random points; in half of the cases the same ones again. Between them the smooth step
    35 s^4 - 84 s^5 + 70 s^6 - 20 s^7, whose first three derivatives vanish at both ends."""
    centre, half = _placed(room, rng)
    again = int(rng.integers(4, 7)) if rng.random() < 0.5 else 10_000
    targets: list[Array] = [centre]
    times = [0.0]  # of the ends of the pauses
    arrivals: list[float] = []
    while times[-1] < duration:
        k = len(targets)
        known = k > again
        target = targets[k - again] if known else centre + half * rng.uniform(-1.0, 1.0, len(half))
        move = float(np.max(2.2 * np.abs(target - targets[-1]) / fastest)) + 0.2
        pause = times[k - again] - arrivals[k - again - 1] if known else rng.uniform(0.3, 1.2)
        arrivals.append(times[-1] + move)
        times.append(arrivals[-1] + pause)
        targets.append(target)

    def states(t: Array) -> States:
        q = np.tile(targets[0], (len(t), 1))
        dq, ddq = np.zeros_like(q), np.zeros_like(q)
        for (start, end), (a, b) in zip(
            zip(times[:-1], arrivals, strict=True), pairwise(targets), strict=True
        ):
            s = np.clip((t - start) / (end - start), 0.0, 1.0)[:, None]
            q += (b - a) * (35 * s**4 - 84 * s**5 + 70 * s**6 - 20 * s**7)
            dq += (b - a) * 140 * s**3 * (1 - s) ** 3 / (end - start)
            ddq += (b - a) * 420 * s**2 * (1 - s) ** 2 * (1 - 2 * s) / (end - start) ** 2
        return q, dq, ddq

    return states


def thinned(m: TrueMotion, every: int) -> TrueMotion:
    """One in so many rows of a motion."""
    share = None if m.share is None else m.share[::every]
    return TrueMotion(m.t[::every], m.q[::every], m.dq[::every], m.ddq[::every], share)
