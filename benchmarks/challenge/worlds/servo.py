"""An arm that a servo drives: what it does where friction holds it, which no planned motion shows.

The time stepping is implicit in dry friction, so that a joint that sticks has velocity zero and its
friction is whatever holds it: Moreau, Computer Methods in Applied Mechanics and Engineering 1999; Dahl's
law in the same form: its travel of 1e-7 is the set-valued sign.
"""

from math import sqrt, tanh
from operator import mul
from typing import Any

import numpy as np

from challenge.worlds.arms import Site
from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.simulation.worlds.arm import Array, inverse_dynamics
from sdp_vs_penalty.simulation.worlds.world import TrueMotion, World

#: Travel of a friction that has none [rad or m].
NONE = 1e-7
#: Velocity to which a step is solved [rad/s or m/s], and in how many rounds at most.
TOLERANCE, ROUNDS = 1e-8, 30


def driven(
    world: Site,
    plan: TrueMotion,
    bandwidth: float = 4.0,
    yields: float = 0.01,
    known: float = 0.7,
    turns: float = 0.05,
) -> TrueMotion:
    """What the arm does under PID control with feed-forward, at the rate of the plan (1 kHz), from rest.

    A good industrial controller: bandwidth of its position loop [Hz], or by how much it yields to dry
    friction at most [rad]; known : the share of friction that its feed-forward knows, which turns
    round over ``turns`` [rad/s].

    Solves M (v' - v) / h + b(q, v) + f (v + v') / 2 + F(v') = tau for the next velocity v', F dry
    friction. Each row is of the middle of a step, which (v + v') / 2 goes through: with v' alone all
    torques would be half a step late. ``share`` is what friction did then.
    """
    arm, n = world.arm, world.arm.n
    h = float(plan.t[1] - plan.t[0])
    coulomb = np.where(world.coulomb > 0.0, world.coulomb, arm.coulomb)
    forward = inverse_dynamics(arm.model, plan.q, plan.dq, plan.ddq) + world.viscous * plan.dq
    forward += world.rotor * plan.ddq + world.offset
    forward += known * coulomb * np.tanh(plan.dq / (turns * arm.unit_speed))
    data = world.built.createData()
    q, v, z, wound = plan.q[0].copy(), np.zeros(n), np.zeros(n), np.zeros(n)
    alone = _mass_matrix(arm.model, arm.model.createData(), q) + np.diag(world.rotor)
    inertia = 1.0 / np.diag(np.linalg.inv(alone))  # of a joint whose neighbours are free
    gain = np.maximum((2.0 * np.pi * bandwidth) ** 2 * inertia, coulomb / (yields * arm.unit_speed))
    damp, wind = 2.0 * np.sqrt(gain * inertia), 2.0 * gain
    rows = []
    for k in range(len(plan.t)):
        seen = world.conditions.channel.position(q, arm.unit_speed)
        wound += h * (plan.q[k] - seen)
        tau = forward[k] + gain * (plan.q[k] - seen) + damp * (plan.dq[k] - v) + wind * wound
        bias = pin.nonLinearEffects(world.built, data, q, v)
        A = _mass_matrix(world.built, data, q) + np.diag(world.rotor + 0.5 * h * world.viscous)
        push = A @ v + h * (tau - bias - world.offset - world.viscous * v)
        after, share = _next(A, push, h * coulomb, z, h, world)
        mean = 0.5 * (v + after)
        rows.append((q + 0.5 * h * mean, mean, (after - v) / h, share))
        q, v, z = q + h * mean, after, share
    return TrueMotion(plan.t, *(np.array(x) for x in zip(*rows, strict=True)))


def _mass_matrix(model: Any, data: Any, q: Array) -> Array:
    """(n, n) whole: Pinocchio fills the upper triangle only."""
    M = pin.crba(model, data, q)
    return np.asarray(np.triu(M) + np.triu(M, 1).T)


def _next(A: Array, push: Array, dry: Array, z: Array, h: float, world: World) -> tuple[Array, Array]:
    """(n,) velocity and share of dry friction that solve A v + dry share(v) = push, joint by joint in
    turn (Gauss and Seidel), from where nothing changes its share."""
    out, share = np.linalg.solve(A, push - dry * z).tolist(), z.tolist()
    matrix, target, loads, old = A.tolist(), push.tolist(), dry.tolist(), z.tolist()
    sharp, travel = world.dry.width.tolist(), world.dry.travel.tolist()
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
    k, rest = m * rate, side * (r - c * z)
    b = k + c - side * r
    root = sqrt(b * b + 4.0 * k * rest)
    a = 2.0 * rest / (b + root) if b > 0.0 else 0.5 * (root - b) / k
    return side * a * rate, (z + side * a) / (1.0 + a)


def _smooth(m: float, c: float, r: float, w: float, v: float) -> tuple[float, float]:
    """v and tanh(v / w) of m v + c tanh(v / w) = r: Newton inside the bracket (r -+ c) / m."""
    low, high = (r - c) / m, (r + c) / m
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
