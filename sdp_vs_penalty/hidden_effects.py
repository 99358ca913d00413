"""Hidden effects: measurements in which a physical effect is at work that the model does not know.

Each effect is simulated by another route than the library's columns where there is one: tilted
gravity and loads in Newton-Euler, a channel that truly reads the past, a friction state integrated
in time, a link beside where the encoder says, an encoder whose zero is off. What is hidden is kept
in a truth that only a scorer reads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import inertia
from sdp_vs_penalty._pinocchio import pin
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot import Robot

Array = NDArray[np.float64]

#: Root mean square of the hidden torque over the raw noise of the joint that it moves most.
LEVELS = {"strong": 2.0, "medium": 0.5, "weak": 0.125}


@dataclass(frozen=True)
class World:
    """The robot as it truly is: links (n, 10), friction f_v, f_c, f_o (n,) each; hidden : what acts
    besides, each a function from (world, motion) to torque (N, n) on top, or to a change of it."""

    robot: Robot
    links: Array
    viscous: Array
    coulomb: Array
    offset: Array
    #: Velocity [rad/s, m/s] over which dry friction turns round.
    dry_width: float = 0.01

    def dry(self, velocity: Array) -> Array:
        """Dry friction over its Coulomb torque."""
        return np.tanh(velocity / self.dry_width)

    def rigid(self, motion: Motion) -> Array:
        return self.robot.inverse_dynamics(self.links.ravel(), motion.q, motion.dq, motion.ddq)

    def friction(self, motion: Motion) -> Array:
        return self.viscous * motion.dq + self.coulomb * self.dry(motion.dq) + self.offset

    def torque(self, motion: Motion) -> Array:
        return self.rigid(motion) + self.friction(motion)


#: (world, motion, size) -> torque (N, n) to add.
TorqueChange = Callable[[World, Motion, float], Array]
#: (world, motion, size) -> what the encoder shows beyond the truth (N, n).
EncoderChange = Callable[[World, Motion, float], Array]


@dataclass(frozen=True)
class Hidden:
    """One hidden effect on joints (from 0; empty: the whole robot), with what a scorer wants to know.

    torque : the torque that it adds; encoder : what it does to the measured positions; late : seconds
    by which torque channels lag per unit of size (n,). ``size`` multiplies all of them; unit : what a
    size of 1 is in the library's unit of this effect.
    """

    effect: str
    joints: tuple[int, ...]
    torque: TorqueChange | None = None
    encoder: EncoderChange | None = None
    late: Array | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    #: Removed from the simulated base friction: the effect is one of the usual ones.
    replaces: str | None = None
    size: float = 1.0
    unit: float = 1.0

    @property
    def amplitude(self) -> float:
        """The size in the library's unit."""
        return self.size * self.unit

    def to_dict(self) -> dict[str, Any]:
        """What a scorer reads."""
        joints = [j + 1 for j in self.joints]
        return {"effect": self.effect, "joints": joints, "size": self.amplitude, **self.details}

    def sized(self, factor: float) -> Hidden:
        return replace(self, size=self.size * factor)


def on_joint(joint: int, n: int, values: Array) -> Array:
    out = np.zeros((len(values), n))
    out[:, joint] = values
    return out


def make_hidden(effect: str, joint: int, world: World, rng: np.random.Generator) -> Hidden:
    """A hidden effect of the library with random shape constants, of size 1 (to be scaled).

    joint : from 0; ignored by effects of the whole robot. Raises InputError for an effect that has
    no simulation, or that cannot act on this joint.
    """
    makers: dict[str, Callable[[int, World, np.random.Generator], Hidden]] = {
        **_FRICTION,
        **_CHANNELS,
        **_GEOMETRY,
    }
    if effect not in makers:
        known = ", ".join(sorted(makers))
        raise InputError(f"effect {effect!r} cannot be hidden; there are: {known}.")
    return makers[effect](joint, world, rng)


def hideable() -> tuple[str, ...]:
    """Names of the effects that can be hidden."""
    return tuple(sorted({**_FRICTION, **_CHANNELS, **_GEOMETRY}))


def _velocity_law(
    effect: str, law: Callable[[Array], Array], joint: int, world: World, **details: float
) -> Hidden:
    n = world.robot.n
    return Hidden(
        effect,
        (joint,),
        lambda w, m, a: a * on_joint(joint, n, law(m.dq[:, joint])),
        details={"shape": details},
    )


def _stribeck(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    vs, delta = float(np.exp(rng.uniform(np.log(0.03), np.log(0.25)))), float(rng.choice([1.0, 2.0]))

    def law(v: Array) -> Array:  # the classical curve: F_c + (F_s - F_c) exp(..), less its F_c
        return np.sign(v) * np.exp(-((np.abs(v) / vs) ** delta))

    return _velocity_law("stribeck_friction", law, joint, world, vs=vs, delta=delta)


def _sigmoid(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    v0 = float(np.exp(rng.uniform(np.log(0.03), np.log(0.25))))

    def law(v: Array) -> Array:  # the paper's logistic form, 2 / (1 + exp(-phi_2 v)) - 1
        return 2.0 / (1.0 + np.exp(np.clip(-2.0 * v / v0, -500, 500))) - 1.0 - world.dry(v)

    return _velocity_law("sigmoid_friction", law, joint, world, v0=v0)


def _power(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    alpha = float(rng.uniform(0.3, 0.7) if rng.random() < 0.5 else rng.uniform(1.5, 3.0))
    sign = float(rng.choice([-1.0, 1.0]))

    def law(v: Array) -> Array:
        return sign * np.sign(v) * np.abs(v) ** alpha

    return _velocity_law("power_law_friction", law, joint, world, alpha=alpha)


def _asymmetric(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    forwards = float(rng.choice([-1.0, 1.0]))

    def law(v: Array) -> Array:  # two slopes, one a direction, less their mean
        return np.where(v > 0.0, forwards * v, -forwards * v)

    return _velocity_law("asymmetric_viscous_friction", law, joint, world)


def _hysteresis(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    d = float(np.exp(rng.uniform(np.log(0.001), np.log(0.02))))
    n = world.robot.n

    def torque(w: World, m: Motion, a: float) -> Array:
        z = bristle(m.t, m.dq[:, joint], d, stribeck=0.0, vs=1.0)
        return a * on_joint(joint, n, z - w.dry(m.dq[:, joint]))

    return Hidden("presliding_hysteresis", (joint,), torque, details={"shape": {"d": d}})


def lugre(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    """LuGre friction (Canudas de Wit et al. 1995) in place of Coulomb: another form of hysteresis."""
    d = float(np.exp(rng.uniform(np.log(0.001), np.log(0.01))))
    stribeck, vs = float(rng.uniform(0.0, 0.3)), float(rng.uniform(0.02, 0.1))
    n = world.robot.n

    def torque(w: World, m: Motion, a: float) -> Array:
        v = m.dq[:, joint]
        z = bristle(m.t, v, d, stribeck, vs)
        return a * on_joint(joint, n, z - w.dry(v))

    shape = {"d": d, "stribeck": stribeck, "vs": vs}
    return Hidden("presliding_hysteresis", (joint,), torque, details={"shape": shape, "form": "LuGre"})


def bristle(t: Array, v: Array, d: float, stribeck: float, vs: float) -> Array:
    """Mean bristle torque (N,) over Coulomb's: d z' = v - |v| z / g(v), g = 1 + stribeck exp(-(v/vs)^2).

    Integrated sample by sample with v held between samples (exponential Euler). The start is the
    sliding state, as if the run had begun before the record.
    """
    dt = np.diff(t)
    g = 1.0 + stribeck * np.exp(-((v / vs) ** 2))
    decay = np.exp(-np.abs(v[:-1]) * dt / (d * g[:-1])).tolist()
    target = (np.sign(v[:-1]) * g[:-1]).tolist()
    z = float(np.sign(v[0]) * g[0])
    out = [z]
    for a, goal in zip(decay, target, strict=True):
        z = goal + (z - goal) * a
        out.append(z)
    return np.array(out)


def _plain(effect: str, column: Callable[[Motion, int], Array], replaces: bool = False) -> Any:
    def make(joint: int, world: World, rng: np.random.Generator) -> Hidden:
        n = world.robot.n
        free = effect in ("joint_spring", "torque_offset")
        sign = float(rng.choice([-1.0, 1.0])) if free else 1.0
        return Hidden(
            effect,
            (joint,),
            lambda w, m, a: sign * a * on_joint(joint, n, column(m, joint)),
            replaces=effect if replaces else None,
        )

    return make


def _load_friction(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    n = world.robot.n

    def torque(w: World, m: Motion, a: float) -> Array:
        v = m.dq[:, joint]
        return a * on_joint(joint, n, np.abs(w.torque(m)[:, joint]) * np.sign(v))

    return Hidden("load_dependent_friction", (joint,), torque)


def _coupling(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    n = world.robot.n
    neighbours = [i for i in (joint - 1, joint + 1) if 0 <= i < n]
    if not neighbours:
        raise InputError("effect joint_coupling needs a robot with two joints or more.")
    i, form = int(rng.choice(neighbours)), int(rng.integers(1, 5))
    sign = float(rng.choice([-1.0, 1.0]))

    def torque(w: World, m: Motion, a: float) -> Array:
        own, other = m.dq[:, joint], m.dq[:, i]
        x = other if form == 1 else np.sign({2: other, 3: own + other, 4: own - other}[form])
        return sign * a * on_joint(joint, n, x)

    return Hidden("joint_coupling", (joint,), torque, details={"shape": {"i": i + 1, "form": form}})


def _ripple(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    k, phase = float(rng.integers(2, 31)), float(rng.uniform(0.0, 2.0 * np.pi))
    n = world.robot.n
    return Hidden(
        "torque_ripple",
        (joint,),
        lambda w, m, a: a * on_joint(joint, n, np.sin(k * m.q[:, joint] + phase)),
        details={"shape": {"k": k}},
    )


def _drift(effect: str) -> Any:
    def make(joint: int, world: World, rng: np.random.Generator) -> Hidden:
        n = world.robot.n
        settles, viscous = bool(rng.random() < 0.5), bool(rng.random() < 0.5)
        T = float(np.exp(rng.uniform(np.log(20.0), np.log(120.0))))
        sign = float(rng.choice([-1.0, 1.0]))

        def torque(w: World, m: Motion, a: float) -> Array:
            course = np.expm1(-m.t / T) if settles else m.t / 100.0
            v = m.dq[:, joint]
            with_motion = v if viscous else np.sign(v)
            return sign * a * on_joint(joint, n, course * (with_motion if "friction" in effect else 1.0))

        form = 1 + settles + (2 * viscous if "friction" in effect else 0)
        return Hidden(effect, (joint,), torque, details={"shape": {"form": form, "T": T}})

    return make


def _gain(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    n = world.robot.n
    sign = float(rng.choice([-1.0, 1.0]))
    return Hidden(
        "torque_gain", (joint,), lambda w, m, a: sign * a * on_joint(joint, n, w.torque(m)[:, joint])
    )


def _delay(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    late = np.zeros(world.robot.n)
    late[joint] = 1e-3
    return Hidden("torque_delay", (joint,), late=late, unit=1e-3)


def _global_delay(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    return Hidden("global_delay", (), late=np.full(world.robot.n, 1e-3), unit=1e-3)


def _elasticity(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    n = world.robot.n
    return Hidden(
        "joint_elasticity",
        (joint,),
        encoder=lambda w, m, a: 1e-4 * a * on_joint(joint, n, w.rigid(m)[:, joint]),
        unit=1e-4,
    )


def _backlash(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    def torque(w: World, m: Motion, a: float) -> Array:
        tau = w.rigid(m)
        link = m.q.copy()
        link[:, joint] -= 1e-3 * a * np.sign(tau[:, joint])
        return w.rigid(replace(m, q=link)) - w.rigid(m)

    return Hidden("backlash", (joint,), torque, unit=1e-3)


def _zero_error(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    n = world.robot.n
    sign = float(rng.choice([-1.0, 1.0]))
    return Hidden(
        "joint_zero_error",
        (joint,),
        encoder=lambda w, m, a: -1e-3 * sign * a * on_joint(joint, n, np.ones(len(m.t))),
        unit=1e-3,
    )


def _tilt(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    g = world.robot.gravity
    along = int(np.argmax(np.abs(g)))
    across = [axis for axis in range(3) if axis != along]

    def torque(w: World, m: Motion, a: float) -> Array:
        tilted = np.array(g)
        tilted[across] += 0.01 * a * np.array([np.cos(angle), np.sin(angle)])
        robot = replace(w.robot, gravity=(tilted[0], tilted[1], tilted[2]))
        return replace(w, robot=robot).rigid(m) - w.rigid(m)

    return Hidden("base_tilt", (), torque, unit=0.01)


def _wrench(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    force, moment = rng.normal(size=3), 0.2 * rng.normal(size=3)
    return Hidden("external_wrench", (), lambda w, m, a: a * wrench_torque(w, m, force, moment))


def wrench_torque(world: World, motion: Motion, force: Array, moment: Array) -> Array:
    """Joint torque (N, n) against a wrench on the last link, by recursive Newton-Euler."""
    robot = world.robot
    model = robot._with_inertias(world.links.ravel())
    data = model.createData()
    external = pin.StdVec_Force([pin.Force.Zero() for _ in range(robot.n + 1)])
    out = np.empty_like(motion.q)
    for k, (q, dq, ddq) in enumerate(zip(motion.q, motion.dq, motion.ddq, strict=True)):
        plain = pin.rnea(model, data, q, dq, ddq).copy()
        pin.forwardKinematics(model, data, q)
        turn = data.oMi[robot.n].rotation
        external[robot.n] = pin.Force(turn.T @ force, turn.T @ moment)
        out[k] = pin.rnea(model, data, q, dq, ddq, external) - plain
    return out


def _payload(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    com = rng.uniform(-0.05, 0.05, 3) + np.array([0.0, 0.0, 0.05])
    gyration = rng.uniform(0.02, 0.06, 3) ** 2
    moments = gyration.sum() - gyration
    load = inertia.standard_from_barycentric([1.0, *com, moments[0], 0, moments[1], 0, 0, moments[2]])

    def torque(w: World, m: Motion, a: float) -> Array:
        links = w.links.copy()
        links[-1] += a * load
        return replace(w, links=links).rigid(m) - w.rigid(m)

    return Hidden("payload", (), torque, details={"com": com.tolist()})


_FRICTION: dict[str, Any] = {
    "viscous_friction": _plain("viscous_friction", lambda m, j: m.dq[:, j], replaces=True),
    "coulomb_friction": _plain("coulomb_friction", lambda m, j: np.sign(m.dq[:, j]), replaces=True),
    "asymmetric_viscous_friction": _asymmetric,
    "stribeck_friction": _stribeck,
    "sigmoid_friction": _sigmoid,
    "power_law_friction": _power,
    "load_dependent_friction": _load_friction,
    "presliding_hysteresis": _hysteresis,
    "joint_coupling": _coupling,
    "drift_friction": _drift("drift_friction"),
}
_CHANNELS: dict[str, Any] = {
    "torque_offset": _plain("torque_offset", lambda m, j: np.ones(len(m.t)), replaces=True),
    "torque_gain": _gain,
    "torque_delay": _delay,
    "global_delay": _global_delay,
    "torque_ripple": _ripple,
    "drift_offset": _drift("drift_offset"),
}
_GEOMETRY: dict[str, Any] = {
    "rotor_inertia": _plain("rotor_inertia", lambda m, j: m.ddq[:, j]),
    "joint_spring": _plain("joint_spring", lambda m, j: m.q[:, j]),
    "joint_elasticity": _elasticity,
    "backlash": _backlash,
    "joint_zero_error": _zero_error,
    "base_tilt": _tilt,
    "external_wrench": _wrench,
    "payload": _payload,
}
