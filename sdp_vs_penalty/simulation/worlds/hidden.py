"""What can be hidden in a world: a change of its torque, what the library should call
it, and how large.

Names, symbols and signs are those that ``sdp-vs-penalty list effects`` prints; the
equations are stated here a second time, on the true motion and the true robot, as in
the sources that are named.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.random import Generator
from scipy.signal import lfilter

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.simulation.worlds.world import (
    Array,
    TrueMotion,
    World,
    bristles,
    misplaced,
)

Change = Callable[[World, TrueMotion, float], Array]
Maker = Callable[[World, int, np.random.Generator], "Hidden"]

#: Root mean square of the hidden torque over the raw noise of the joint that it moves
#: most.
LEVELS = {
    "strong": 2.0,
    "medium": 0.5,
    "weak": 0.125,
}


@dataclass(frozen=True)
class Hidden:
    """change : (N, n) torque that an effect of a size adds; joints : from 0, none for
    the whole robot; number : the library's parameter at size 1, None where it has no
    single one; shift : (N,) by how much the joint's link stands elsewhere than its
    encoder says, where that is how it acts; effect : the library's name of it, which
    the tables of makers say; channel : whether it acts on what all others make."""

    joints: tuple[int, ...]
    change: Change
    number: float | None = 1.0
    shape: Mapping[str, float] = field(default_factory=dict)
    size: float = 1.0
    shift: Change | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    effect: str = ""
    channel: bool = False

    def torque(self, world: World, m: TrueMotion) -> Array:
        """(N, n) what it adds at its size."""
        return self.change(world, m, self.size)

    def sized(
        self, world: World, motions: Sequence[TrueMotion], factor: float
    ) -> Hidden:
        """With a root mean square of ``factor`` times the raw noise on the joint that
        it moves most; three rounds, as some effects are not linear. As it is, where it
        moves nothing."""
        out = self
        for _ in range(3):
            added = np.concatenate([out.torque(world, m) for m in motions])
            ratio = float((np.sqrt(np.mean(added**2, axis=0)) / world.noise).max())
            if ratio < 1e-9:
                return self
            out = replace(out, size=out.size * factor / ratio)
        return out

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON; joints count from 1."""
        size = None if self.number is None else self.number * self.size
        about = {
            "effect": self.effect,
            "joints": [j + 1 for j in self.joints],
            "size": size,
        }
        return {
            **about,
            "shape": dict(self.shape),
            **self.details,
        }


def torques(world: World, m: TrueMotion, hidden: Sequence[Hidden]) -> list[Array]:
    """(N, n) what each adds; torque channels, one after the other, to what they carry."""
    torque_by_joint = dict[int, Array]()
    for k in sorted(range(len(hidden)), key=lambda k: hidden[k].channel):
        carried = replace(world, more=world.more + sum(torque_by_joint.values(), 0.0))
        torque_by_joint[k] = hidden[k].torque(
            carried if hidden[k].channel else world, m
        )
    return [torque_by_joint[k] for k in range(len(hidden))]


def at_joint(
    joint: int,
    law: Callable[[World, TrueMotion], Array],
    number: float | None = 1.0,
    /,
    **shape: float,
) -> Hidden:
    """A torque of one joint, law(world, motion) (N,) times the size."""

    def change(world: World, m: TrueMotion, size: float) -> Array:
        return np.outer(size * law(world, m), np.eye(world.arm.n)[joint])

    return Hidden((joint,), change, number, shape)


def plain(
    law: Callable[[World, int, TrueMotion], Array], signed: bool = False
) -> Maker:
    """The maker of a torque of one joint without constants, law(world, joint, motion)
    (N,) times the size; signed : either way round."""

    def make(w: World, j: int, rng: np.random.Generator) -> Hidden:
        side = float(rng.choice([-1.0, 1.0])) if signed else 1.0
        return at_joint(j, lambda w, m: side * law(w, j, m), side)

    return make


def shifted(
    joint: int, shift: Change, number: float, size: float, rates: bool = True
) -> Hidden:
    """The link of a joint stands at q + shift, where q is what motor and encoder do;
    rates : whether its velocity and acceleration differ too."""

    def change(world: World, m: TrueMotion, size: float) -> Array:
        moved = displaced(m, joint, shift(world, m, size))
        return world.rigid(moved if rates else replace(m, q=moved.q)) - world.rigid(m)

    return Hidden(
        (joint,),
        change,
        number,
        size=size,
        shift=shift,
    )


def displaced(m: TrueMotion, joint: int, shift: Array) -> TrueMotion:
    """The motion of the links, rates by central differences on the fine grid."""
    rate = np.gradient(shift, m.t)
    unit = np.eye(m.q.shape[1])[joint]
    moved = (shift, rate, np.gradient(rate, m.t))
    states = zip((m.q, m.dq, m.ddq), moved, strict=True)
    return TrueMotion(m.t, *(x + np.outer(d, unit) for x, d in states))


def sign(world: World, joint: int, m: TrueMotion) -> Array:
    """(N,) the direction in which a joint rubs, as sharp as its own dry friction is."""
    return world.share(m)[:, joint]


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def first_order(x: Array, step: float, lag: float) -> Array:
    """y + lag dy/dt = x, from rest at the first sample."""
    decay = float(np.exp(-step / lag))
    half = 0.5 * (1.0 - decay)
    y, _ = lfilter(
        [half, half],
        [1.0, -decay],
        x,
        axis=0,
        zi=(1.0 - half) * x[:1],
    )
    return np.asarray(y)


def _unit(world: World, joint: int) -> float:
    return float(world.arm.unit_speed[joint])


def _stribeck(w: World, j: int, rng: Generator) -> Hidden:
    """Armstrong-Helouvry et al., Automatica 1994, eq. 7."""
    vs = _unit(w, j) * log_uniform(rng, 0.04, 0.3)
    law = lambda w, m: sign(w, j, m) * np.exp(-((m.dq[:, j] / vs) ** 2))  # noqa: E731
    return at_joint(
        j,
        law,
        vs=vs,
        delta=2.0,
    )


def _presliding(
    w: World, j: int, rng: Generator, low: float = 0.001, high: float = 0.01
) -> Hidden:
    """Dahl 1968: friction follows the travel since the reversal instead of jumping, if
    it does so."""
    d = _unit(w, j) * log_uniform(rng, low, high)
    law = lambda w, m: _behind(m.t, m.dq[:, j], d) - w.dry.jumps * sign(w, j, m)  # noqa: E731
    return at_joint(j, law, d=d)


def _behind(t: Array, speed: Array, d: float) -> Array:
    """(N,) Dahl's state along a motion of this speed."""
    return bristles(
        t,
        speed[:, None],
        np.array([d]),
        np.ones_like,
    )[:, 0]


def _sigmoid(w: World, j: int, rng: Generator) -> Hidden:
    """Gaz et al., RA-L 2019, eq. 9: part of the Coulomb friction rises slowly."""
    v0 = _unit(w, j) * log_uniform(rng, 0.05, 0.3)
    return at_joint(j, lambda w, m: np.tanh(m.dq[:, j] / v0) - sign(w, j, m), v0=v0)


def _power(w: World, j: int, rng: Generator) -> Hidden:
    alpha = float(
        rng.uniform(0.3, 0.7) if rng.random() < 0.5 else rng.uniform(1.5, 2.5)
    )
    return at_joint(
        j, lambda w, m: np.sign(m.dq[:, j]) * np.abs(m.dq[:, j]) ** alpha, alpha=alpha
    )


def _coupling(w: World, j: int, rng: Generator) -> Hidden:
    """Janot et al., IEEE TCST 2014; between turning joints, as wrists are."""
    if w.arm.n < 2:
        raise InputError(
            "effect joint_coupling needs a robot with two joints or more",
            "leave it out",
        )
    i = j - 1 if j > 0 else 1
    form = int(rng.integers(1, 5))
    side = float(rng.choice([-1.0, 1.0]))
    width = float(np.median(w.dry.width))

    def law(w: World, m: TrueMotion) -> Array:
        own_velocity = m.dq[:, j]
        other = m.dq[:, i]
        speed = {
            3: own_velocity + other,
            4: own_velocity - other,
        }.get(form, other)
        return np.asarray(side * (speed if form == 1 else np.tanh(speed / width)))

    return at_joint(
        j,
        law,
        side,
        i=float(i + 1),
        form=float(form),
    )


def _warming(w: World, j: int, rng: Generator) -> Hidden:
    """Simoni et al., IROS 2015: friction that falls with time."""
    T = float(rng.uniform(40.0, 150.0))
    form = int(rng.choice([2, 4]))

    def law(w: World, m: TrueMotion) -> Array:
        return np.exp(-m.t / T) * (sign(w, j, m) if form == 2 else m.dq[:, j])

    return at_joint(
        j,
        law,
        None,
        form=float(form),
        T=T,
    )


def _by_temperature(w: World, j: int, rng: Generator) -> Hidden:
    """Carlson, Robertsson, Johansson, 2015: grease thins exponentially with its
    temperature."""
    warm = float(rng.uniform(8.0, 40.0))
    viscous = bool(rng.random() < 0.5)

    def law(w: World, m: TrueMotion) -> Array:
        thick = np.exp((20.0 - w.temperature(m.t)[:, j]) / warm)
        return np.asarray(thick * (m.dq[:, j] if viscous else sign(w, j, m)))

    return at_joint(
        j,
        law,
        law=1.0 + viscous,
        by=1.0,
        warm=warm,
    )


def _transmission(w: World, j: int, rng: Generator) -> Hidden:
    """A motor of a differential wrist turns with a combination of two neighbours (Wang
    et al. 2019).

    Dry friction only: of the viscous kind the joints' own friction absorbs all but a
    cross term, from which no ratio can be told."""
    pairs = [i for i in range(w.arm.n - 1) if w.arm.rotary[i : i + 2].all()]
    if not pairs:
        raise InputError(
            "effect transmission_friction needs neighbours that turn", "leave it out"
        )
    first = min(pairs, key=lambda i: abs(i - j))
    law = int(rng.choice([2, 3, 4]))
    ratio = float(rng.choice([-2.0, -1.0, -0.5, 0.5, 1.0, 2.0]))
    d = log_uniform(rng, 0.002, 0.01)
    vs = log_uniform(rng, 0.05, 0.25)
    width = float(np.median(w.dry.width))
    c = np.zeros(w.arm.n)
    c[first], c[first + 1] = 1.0, ratio

    def change(w: World, m: TrueMotion, size: float) -> Array:
        v = m.dq @ c
        rubs = np.tanh(v / width) * (np.exp(-((v / vs) ** 2)) if law == 4 else 1.0)
        return np.outer(size * (_behind(m.t, v, d) if law == 3 else rubs), c)

    law_constants = {
        3: {"d": d},
        4: {"vs": vs},
    }.get(law, {})
    shape = {
        f"c{first + 1}": 1.0,
        f"c{first + 2}": ratio,
        "law": float(law),
        **law_constants,
    }
    return Hidden(
        (first, first + 1),
        change,
        1.0,
        shape,
    )


def _load_hysteresis(w: World, j: int, rng: Generator) -> Hidden:
    """Friction of loaded teeth with Dahl's memory."""
    d = _unit(w, j) * log_uniform(rng, 0.002, 0.01)
    return at_joint(
        j, lambda w, m: np.abs(w.rigid(m)[:, j]) * _behind(m.t, m.dq[:, j], d), d=d
    )


def _slip(w: World, j: int, rng: Generator) -> Hidden:
    """Al-Bender et al., IEEE TAC 2005: springs in parallel, each with a slider of its
    own travel."""
    d = _unit(w, j) * log_uniform(rng, 0.001, 0.004)
    travel = d * np.array([1.0, 4.0, 16.0])
    weight = rng.dirichlet(np.ones(3))

    def law(w: World, m: TrueMotion) -> Array:
        out = np.zeros(len(m.t))
        z = np.zeros(3)
        for k, step in enumerate(np.diff(m.q[:, j]), start=1):
            z = np.clip(z + step / travel, -1.0, 1.0)
            out[k] = weight @ z
        return out

    return at_joint(j, law, None, d=d)


def _position(w: World, j: int, rng: Generator) -> Hidden:
    """Popovic, Goldenberg 1998: dry friction that varies along the range."""
    phase = float(rng.uniform(0.0, 2.0 * np.pi))
    k = (
        float(rng.integers(1, 4))
        if w.arm.rotary[j]
        else 2.0 * np.pi / float(rng.uniform(0.05, 0.15))
    )
    return at_joint(
        j, lambda w, m: np.cos(k * m.q[:, j] + phase) * sign(w, j, m), None, k=k
    )


#: By the library's name of each.
FRICTION: Mapping[str, Maker] = {
    "viscous_friction": plain(lambda w, j, m: m.dq[:, j]),
    "coulomb_friction": plain(sign),
    # A size for each direction: Armstrong-Helouvry et al., Automatica 1994, sec. 2.
    "asymmetric_viscous_friction": plain(
        lambda w, j, m: np.abs(m.dq[:, j]), signed=True
    ),
    "asymmetric_coulomb_friction": plain(
        lambda w, j, m: np.abs(sign(w, j, m)), signed=True
    ),
    "stribeck_friction": _stribeck,
    "presliding_hysteresis": _presliding,
    "sigmoid_friction": _sigmoid,
    "power_law_friction": _power,
    # In proportion to the torque that the gear transmits: Hamon, Gautier, Garrec, IROS
    # 2010.
    "load_dependent_friction": plain(
        lambda w, j, m: np.abs(w.rigid(m)[:, j]) * sign(w, j, m)
    ),
    "joint_coupling": _coupling,
    "drift_friction": _warming,
    "warming_friction": _by_temperature,
    "transmission_friction": _transmission,
    "load_dependent_hysteresis": _load_hysteresis,
    "maxwell_slip": _slip,
    "position_dependent_friction": _position,
}


def _drift(w: World, j: int, rng: Generator) -> Hidden:
    """A sensor's zero that creeps as it warms."""
    T = float(rng.uniform(40.0, 150.0))
    return at_joint(
        j,
        lambda _, m: np.exp(-m.t / T),
        None,
        form=2.0,
        T=T,
    )


def _ripple(w: World, j: int, rng: Generator) -> Hidden:
    """Teeth and poles: 2 to 40 waves a turn; a prismatic joint's screw has a lead of 8
    to 70 mm."""
    phase = float(rng.uniform(0.0, 2.0 * np.pi))
    turns = float(rng.integers(2, 41))
    k = turns if w.arm.rotary[j] else 2.0 * np.pi / float(rng.uniform(0.008, 0.07))
    return at_joint(j, lambda _, m: np.cos(k * m.q[:, j] + phase), k=k)


def _gain(w: World, j: int, rng: Generator) -> Hidden:
    law = plain(lambda w, j, m: w.torque(m)[:, j], signed=True)
    return replace(law(w, j, rng), channel=True)


def _late(channels: list[int], joints: tuple[int, ...]) -> Hidden:
    """Torques logged late."""

    def change(w: World, m: TrueMotion, size: float) -> Array:
        delayed = (tau := w.torque(m)).copy()
        for j in channels:
            delayed[:, j] = np.interp(m.t - size, m.t, tau[:, j])
        return delayed - tau

    return Hidden(
        joints,
        change,
        size=1e-3,
        channel=True,
    )


def _filter(w: World, j: int, rng: Generator) -> Hidden:
    """All channels behind one low-pass, 1 / (1 + T s): the size is T."""

    def change(w: World, m: TrueMotion, T: float) -> Array:
        # Effects are sized on a coarse grid, where a filter is read from a finer one.
        t = np.arange(m.t[0], m.t[-1], min(float(m.t[1] - m.t[0]), 0.25e-3))
        tau = w.torque(m)
        fine = np.column_stack([np.interp(t, m.t, x) for x in tau.T])
        passed = first_order(fine, float(t[1] - t[0]), T)
        return np.column_stack([np.interp(m.t, t, x) for x in passed.T]) - tau

    return Hidden(
        (),
        change,
        size=1e-3,
        channel=True,
    )


def _zero_error(w: World, j: int, rng: Generator) -> Hidden:
    side = float(rng.choice([-1.0, 1.0]))
    return shifted(
        j,
        lambda _, m, a: np.full(len(m.t), a * side),
        side,
        1e-3,
    )


def _elasticity(w: World, j: int, rng: Generator) -> Hidden:
    """Spong 1987, the link at rest on its spring: it lags by c times the torque that it
    needs."""

    def shift(w: World, m: TrueMotion, c: float) -> Array:
        lag = np.zeros(len(m.t))
        for _ in range(2):
            lag = -c * w.rigid(displaced(m, j, lag))[:, j]
        return lag

    return shifted(j, shift, 1.0, 1e-5)


def _backlash(w: World, j: int, rng: Generator) -> Hidden:
    """Nordin, Gutman 2002: between impacts the link rests on the flank that its torque
    presses it to.

    Flanks that yield a little let it change over within a fiftieth of the largest
    torque; what the impact itself does is left out."""

    def shift(w: World, m: TrueMotion, b: float) -> Array:
        tau = w.rigid(m)[:, j]
        return np.asarray(-b * np.tanh(50.0 * tau / max(np.abs(tau).max(), 1e-9)))

    return shifted(
        j,
        shift,
        1.0,
        1e-4,
        rates=False,
    )


def _tilt(w: World, j: int, rng: Generator) -> Hidden:
    angle = float(rng.uniform(0.0, 2.0 * np.pi))

    def change(w: World, m: TrueMotion, size: float) -> Array:
        tilted = pin.Model(w.built)
        across = size * np.array([np.cos(angle), np.sin(angle), 0.0])
        tilted.gravity.linear = w.built.gravity.linear + across
        return w.rigid(m, tilted) - w.rigid(m)

    return Hidden((), change, 1.0, size=0.1)


def _wrench(w: World, j: int, rng: Generator) -> Hidden:
    """A constant force and moment on the last link, at its joint: motors carry -J^T (F,
    M)."""
    force = np.concatenate([rng.normal(size=3), 0.1 * rng.normal(size=3)])

    def change(w: World, m: TrueMotion, size: float) -> Array:
        data = w.built.createData()
        return np.array(
            [-size * (w.arm.last_jacobian(w.built, data, q).T @ force) for q in m.q]
        )

    return Hidden((), change, None)


def _payload(w: World, j: int, rng: Generator) -> Hidden:
    """A ball that the last link carries: its size is its mass [kg]."""
    reach = float(np.linalg.norm(w.arm.model.jointPlacements[-1].translation)) + 0.05
    centre = rng.uniform(-0.5, 0.5, 3) * reach

    def change(w: World, m: TrueMotion, mass: float) -> Array:
        loaded = pin.Model(w.built)
        ball = pin.Inertia(mass, centre, pin.Inertia.FromSphere(mass, 0.05).inertia)
        loaded.inertias[w.arm.last] = w.built.inertias[w.arm.last] + ball
        return w.rigid(m, loaded) - w.rigid(m)

    return Hidden(
        (),
        change,
        1.0,
        size=0.1,
        details={"com": centre.tolist()},
    )


def _misplaced(w: World, j: int, rng: Generator) -> Hidden:
    """Joints beside where the kinematics have them, by some .1 mm and .2 mrad an axis
    at size 1."""
    seed = int(rng.integers(2**32))

    def change(w: World, m: TrueMotion, size: float) -> Array:
        slip = 1e-4 * size
        turn = np.rad2deg(2e-4 * size)
        displaced_world = misplaced(
            w.built,
            slip,
            turn,
            np.random.default_rng(seed),
        )
        return w.rigid(m, displaced_world) - w.rigid(m)

    return Hidden((), change, None)


#: Dahl's friction over a travel that hardly shows.
_stiction = partial(_presliding, low=0.0005, high=0.001)
#: What shows only against a model that is kept as it is.
FROZEN: Mapping[str, Maker] = {"payload": _payload}
#: What a diagnosis meets as a nuisance.
NUISANCE: Mapping[str, Maker] = {
    "kinematic_error": _misplaced,
    "stiction": _stiction,
}
MACHINE: Mapping[str, Maker] = {
    "joint_spring": plain(lambda w, j, m: m.q[:, j]),
    "torque_offset": plain(lambda w, j, m: np.ones(len(m.t)), signed=True),
    "drift_offset": _drift,
    "torque_ripple": _ripple,
    "rotor_inertia": plain(lambda w, j, m: m.ddq[:, j]),
    "torque_gain": _gain,
    "torque_delay": lambda w, j, rng: _late([j], (j,)),
    "global_delay": lambda w, j, rng: _late(list(range(w.arm.n)), ()),
    "torque_filter": _filter,
    "joint_zero_error": _zero_error,
    "joint_elasticity": _elasticity,
    "backlash": _backlash,
    "base_tilt": _tilt,
    "external_wrench": _wrench,
}
