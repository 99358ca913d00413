"""Motions inside an arm's limits: periodic, aperiodic, from point to point; and as a
servo drives them.

The time stepping is implicit in dry friction, so that a joint that sticks has velocity
zero and its friction is whatever holds it: Moreau, Computer Methods in Applied
Mechanics and Engineering 1999; Dahl's law in the same form: its travel of 1e-7 is the
set-valued sign.
"""

from collections.abc import Callable
from itertools import pairwise
from math import sqrt, tanh
from operator import mul

import numpy as np

from challenge.worlds.conditions import Driven, RatedArm, Site
from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.simulation.worlds.world import Array, TrueMotion, inverse_dynamics

States = tuple[Array, Array, Array]

#: Shares of the position and velocity limits that a motion uses; the farthest from its
#: centre [rad].
REACH = 0.75
SPEED = 0.5
SWING = 1.6


def plan(
    arm: RatedArm, kind: str, duration: float, rng: np.random.Generator
) -> Callable[[Array], States]:
    """A random motion, periodic, aperiodic or from point to point ("points"), as a
    function of time [s] from its beginning."""
    reach = 0.5 * REACH * (arm.upper - arm.lower)
    half = np.minimum(reach, SWING)
    fastest = SPEED * arm.speed

    def centre() -> Array:
        """Somewhere in the room that the half range leaves, drawn."""
        return 0.5 * (arm.lower + arm.upper) + (reach - half) * rng.uniform(
            -1.0, 1.0, arm.n
        )

    if kind == "points":
        return _points(centre(), half, fastest, duration, rng)
    if kind == "periodic":
        period = min(float(rng.uniform(8.0, 13.3)), duration / 1.5)
        frequencies = np.tile(np.arange(1, 6)[:, None] / period, (1, arm.n))
    else:
        frequencies = rng.uniform(0.05, 0.5, (8, arm.n))
    w = 2.0 * np.pi * frequencies
    phase = rng.uniform(0.0, 2.0 * np.pi, w.shape)
    size = rng.uniform(0.3, 1.0, w.shape) / np.sqrt(w)
    about = centre()
    q, dq, _ = waves(size, w, phase)(np.arange(0.0, duration, 0.02))
    middle = 0.5 * (q.max(axis=0) + q.min(axis=0))
    # As large as position and velocity limits let them be.
    fit = np.minimum(
        half / np.abs(q - middle).max(axis=0), fastest / np.abs(dq).max(axis=0)
    )
    return waves(fit * size, w, phase, about - fit * middle)


def waves(
    size: Array, w: Array, phase: Array, centre: Array | float = 0.0
) -> Callable[[Array], States]:
    """q = centre + sum_k size_k sin(w_k t + phase_k) of k waves, each (k, n) or (k, 1)
    [rad or m, rad/s, rad]; centre (n,)."""

    def states(t: Array) -> States:
        angle = w * t[:, None, None] + phase
        q = centre + (size * np.sin(angle)).sum(axis=1)
        dq = (size * w * np.cos(angle)).sum(axis=1)
        return q, dq, -(size * w**2 * np.sin(angle)).sum(axis=1)

    return states


def _points(
    centre: Array,
    half: Array,
    fastest: Array,
    duration: float,
    rng: np.random.Generator,
) -> Callable[[Array], States]:
    """Stop at random points; in half of the cases the same ones again. Between them the
    smooth step 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7, whose first three derivatives vanish
    at both ends."""
    again = int(rng.integers(4, 7)) if rng.random() < 0.5 else 10_000
    # where it pauses, and until when
    targets = [centre]
    times = [0.0]
    arrivals: list[float] = []
    while times[-1] < duration:
        k = len(targets)
        known = k > again
        target = (
            targets[k - again]
            if known
            else centre + half * rng.uniform(-1.0, 1.0, len(half))
        )
        move = float(np.max(2.2 * np.abs(target - targets[-1]) / fastest)) + 0.2
        pause = (
            times[k - again] - arrivals[k - again - 1]
            if known
            else rng.uniform(0.3, 1.2)
        )
        arrivals.append(times[-1] + move)
        times.append(arrivals[-1] + pause)
        targets.append(target)

    def states(t: Array) -> States:
        q = np.tile(targets[0], (len(t), 1))
        dq, ddq = np.zeros_like(q), np.zeros_like(q)
        for start, end, (a, b) in zip(
            times[:-1], arrivals, pairwise(targets), strict=True
        ):
            s = np.clip((t - start) / (end - start), 0.0, 1.0)[:, None]
            q += (b - a) * (35 * s**4 - 84 * s**5 + 70 * s**6 - 20 * s**7)
            dq += (b - a) * 140 * s**3 * (1 - s) ** 3 / (end - start)
            ddq += (
                (b - a) * 420 * s**2 * (1 - s) ** 2 * (1 - 2 * s) / (end - start) ** 2
            )
        return q, dq, ddq

    return states


#: Travel of a friction that has none [rad or m].
NONE = 1e-7
#: Velocity to which a step is solved [rad/s or m/s], and in how many rounds at most.
TOLERANCE = 1e-8
ROUNDS = 30
#: A good industrial controller: bandwidth of its position loop [Hz], or by how much it
#: yields to dry friction at most [rad].
BANDWIDTH = 4.0
YIELDS = 0.01
#: The share of dry friction that its feed-forward knows, and over which velocity that
#: turns [rad/s].
KNOWN = 0.7
TURNS = 0.05


def driven(
    world: Site,
    plan: TrueMotion,
    pull: Array | float = 0.0,
    jitter: Array | float = 0.0,
) -> TrueMotion:
    """What the arm does under PID control with feed-forward, at the rate of the plan (1
    kHz), from rest.

    pull (N, n) : a torque against it that nobody plans; jitter (N, n) : noise of the
    encoders.

    Solves M (v' - v) / h + b(q, v) + f (v + v') / 2 + F(v') = tau for the next velocity
    v', F dry friction. Each row is of the middle of a step, which (v + v') / 2 goes
    through: with v' alone all torques would be half a step late. ``share`` is what
    friction did then.
    """
    arm = world.arm
    n = world.arm.n
    h = float(plan.t[1] - plan.t[0])
    pull = np.broadcast_to(pull, plan.q.shape)
    jitter = np.broadcast_to(jitter, plan.q.shape)
    coulomb = np.where(world.coulomb > 0.0, world.coulomb, arm.coulomb)
    forward = (
        inverse_dynamics(arm.model, plan.q, plan.dq, plan.ddq) + world.viscous * plan.dq
    )
    forward += world.rotor * plan.ddq + world.offset
    forward += KNOWN * coulomb * np.tanh(plan.dq / (TURNS * arm.unit_speed))
    data = world.built.createData()
    q = plan.q[0].copy()
    v = np.zeros(n)
    z = np.zeros(n)
    wound = np.zeros(n)
    alone = pin.crba(arm.model, arm.model.createData(), q) + np.diag(world.rotor)
    inertia = 1.0 / np.diag(
        np.linalg.inv(alone)
    )  # of a joint whose neighbours are free
    gain = np.maximum(
        (2.0 * np.pi * BANDWIDTH) ** 2 * inertia, coulomb / (YIELDS * arm.unit_speed)
    )
    damp = 2.0 * np.sqrt(gain * inertia)
    wind = 2.0 * gain
    rows = []
    for k in range(len(plan.t)):
        seen = world.conditions.channel.position(q + jitter[k], arm.unit_speed)
        wound += h * (plan.q[k] - seen)
        tau = (
            forward[k]
            + gain * (plan.q[k] - seen)
            + damp * (plan.dq[k] - v)
            + wind * wound
        )
        bias = pin.nonLinearEffects(world.built, data, q, v)
        A = pin.crba(world.built, data, q) + np.diag(
            world.rotor + 0.5 * h * world.viscous
        )
        push = A @ v + h * (tau - bias - world.offset - pull[k] - world.viscous * v)
        after, share = _next(A, push, h * coulomb, z, h, world)
        mean = 0.5 * (v + after)
        rows.append((q + 0.5 * h * mean, mean, (after - v) / h, share))
        q = q + h * mean
        v = after
        z = share
    return Driven(plan.t, *(np.array(x) for x in zip(*rows, strict=True)))


def _next(
    A: Array, push: Array, dry: Array, z: Array, h: float, world: Site
) -> tuple[Array, Array]:
    """(n,) velocity and share of dry friction that solve A v + dry share(v) = push,
    joint by joint in turn (Gauss and Seidel), from where nothing changes its share."""
    out = np.linalg.solve(A, push - dry * z).tolist()
    share = z.tolist()
    matrix = A.tolist()
    target = push.tolist()
    loads = dry.tolist()
    old = z.tolist()
    sharp = world.dry.width.tolist()
    travel = world.dry.travel.tolist()
    smooth = world.dry.law == "tanh"
    for _ in range(ROUNDS):
        change = 0.0
        for j, row in enumerate(matrix):
            r = target[j] - sum(map(mul, row, out)) + row[j] * out[j]
            if smooth:
                new, share[j] = _smooth(row[j], loads[j], r, sharp[j], out[j])
            else:
                d = travel[j] if world.dry.law == "dahl" else NONE
                new, share[j] = _held(row[j], loads[j], r, old[j], d / h)
            change = max(change, abs(new - out[j]))
            out[j] = new
        if change < TOLERANCE:
            break
    return np.array(out), np.array(share)


def _held(m: float, c: float, r: float, z: float, rate: float) -> tuple[float, float]:
    """v and z' of m v + c z' = r with Dahl's z' = (z + a) / (1 + |a|), a = v / rate."""
    side = 1.0 if r >= c * z else -1.0
    k = m * rate
    rest = side * (r - c * z)
    b = k + c - side * r
    root = sqrt(b * b + 4.0 * k * rest)
    a = 2.0 * rest / (b + root) if b > 0.0 else 0.5 * (root - b) / k
    return side * a * rate, (z + side * a) / (1.0 + a)


def _smooth(m: float, c: float, r: float, w: float, v: float) -> tuple[float, float]:
    """v and tanh(v / w) of m v + c tanh(v / w) = r: Newton inside the bracket (r -+ c)
    / m."""
    low = (r - c) / m
    high = (r + c) / m
    v = min(max(v, low), high)
    for _ in range(60):
        t = tanh(v / w)
        error = m * v + c * t - r
        low, high = (low, v) if error > 0.0 else (v, high)
        new = v - error / (m + c * (1.0 - t * t) / w)
        new = new if low <= new <= high else 0.5 * (low + high)
        if abs(new - v) < 1e-12:
            break
        v = new
    return v, tanh(v / w)
