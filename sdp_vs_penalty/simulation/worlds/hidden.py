"""Effects that can be hidden in a world: the torque that each adds, the library's name
of it, and its size.

Names, symbols and signs are those that ``sdp-vs-penalty list effects`` prints. The
equations are written here a second time, for the true motion and the true robot, from
the sources that are named.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any

import numpy as np
import scipy
from numpy.random import Generator

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.simulation.worlds.world import (
    Array,
    TrueMotion,
    World,
    bristles,
    misplaced,
)

#: Maps a world, its motion and a size to the added torque (N, n), or to a shift (N,).
SizedLaw = Callable[[World, TrueMotion, float], Array]
#: Makes an effect for a world (``drawing_world``) and a joint (from 0), with random constants;
#: some makers need only a part of this. The ``world`` in which the effect acts later may
#: also hold the torque of other effects.
Maker = Callable[[World, int, np.random.Generator], "Hidden"]

#: Root mean square of the hidden torque over the raw noise of the joint that it moves
#: most.
LEVELS = {"strong": 2.0, "medium": 0.5, "weak": 0.125}


@dataclass(frozen=True)
class Hidden:
    """An effect that is hidden in a simulated robot."""

    #: Indices of the joints, from 0; none for the whole robot.
    joints: tuple[int, ...]
    #: Returns the torque (N, n) [N m, N] that the effect adds at a size.
    added_torque: SizedLaw
    #: The library's parameter at size 1; None where it has no single one.
    library_value: float | None = 1.0
    #: Constants of the law's shape by name.
    shape: Mapping[str, float] = field(default_factory=dict)
    #: Factor on the effect.
    size: float = 1.0
    #: Returns by how much (N,) [rad, m] the joint's link stands elsewhere than its
    #: encoder says; None where the effect does not act that way.
    shift: SizedLaw | None = None
    #: Further facts for truth.json.
    details: Mapping[str, Any] = field(default_factory=dict)
    #: The library's name of the effect, from the tables of makers.
    effect: str = ""
    #: Whether it acts on the sum of what all others add.
    acts_on_channels: bool = False
    #: World, joint (from 0) and random numbers of its maker, from which a pickle makes
    #: the effect again; None for an effect that no table names.
    maker_arguments: tuple[World, int, Generator] | None = field(
        default=None, repr=False
    )

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the function and arguments by which pickle restores the effect: its maker
        and the maker's arguments, since local functions cannot be pickled."""
        if self.maker_arguments is None:
            values = [getattr(self, entry.name) for entry in fields(self)]
            return type(self), tuple(values)
        return _remake, (self.effect, self.maker_arguments, self.size)

    def torque(self, world: World, motion: TrueMotion) -> Array:
        """Return the torque (N, n) [N m, N] that the effect adds at its size.

        Parameters
        ----------
        motion : TrueMotion
            N samples of the joints' motion.
        """
        return self.added_torque(world, motion, self.size)

    def sized(
        self, world: World, motions: Sequence[TrueMotion], factor: float
    ) -> Hidden:
        """Return the effect scaled to a given strength.

        On the joint that it moves most, the RMS of its torque becomes ``factor`` times
        the raw noise. Three rounds of scaling suffice for effects that are not linear
        in their size.

        Parameters
        ----------
        motions : sequence of TrueMotion
            Motions over which the RMS is taken.
        factor : float
            Strength in multiples of the noise.

        Returns
        -------
        Hidden
            The effect itself, unscaled, if it makes no torque here.
        """
        out = self
        for _ in range(3):
            added = np.concatenate([out.torque(world, motion) for motion in motions])
            rms = np.sqrt(np.mean(added**2, axis=0))
            ratio = float((rms / world.noise).max())
            if ratio < 1e-9:  # nothing but rounding
                return self
            out = replace(out, size=out.size * factor / ratio)
        return out

    @property
    def truth(self) -> dict[str, Any]:
        """Entry of truth.json: the library's name, joints from 1 (none for the whole
        robot), the size in the unit of the library's parameter (None if it has several),
        constants of the shape, and details such as a load's centre of mass (3,) [m]."""
        return {
            "effect": self.effect,
            "joints": [joint + 1 for joint in self.joints],
            "size": None
            if self.library_value is None
            else self.library_value * self.size,
            "shape": dict(self.shape),
            "details": dict(self.details),
        }


def make_hidden(name: str, world: World, joint: int, rng: Generator) -> Hidden:
    """Make an effect by its name.

    Parameters
    ----------
    joint : int
        Index of the joint, from 0.
    rng : numpy.random.Generator
        Random numbers, which the maker draws its constants from.

    Returns
    -------
    Hidden
        The effect, which can be pickled.
    """
    maker_arguments = world, joint, deepcopy(rng)  # before the maker draws from it
    return replace(
        MAKERS[name](world, joint, rng), effect=name, maker_arguments=maker_arguments
    )


def _remake(
    name: str, maker_arguments: tuple[World, int, Generator], size: float
) -> Hidden:
    """Make an effect again by its name and a copy of its maker's arguments (world, joint
    from 0, random numbers), at a size."""
    return replace(make_hidden(name, *deepcopy(maker_arguments)), size=size)


def torques(world: World, motion: TrueMotion, hidden: Sequence[Hidden]) -> list[Array]:
    """Return the torque that each effect adds.

    Torque channels (gain, delay, filter) act on the sum of all others, so they are
    computed last, one after the other.

    Parameters
    ----------
    motion : TrueMotion
        N samples of the joints' motion.

    Returns
    -------
    list of (N, n)
        In the order of ``hidden`` [N m, N].
    """
    torque_by_effect = dict[int, Array]()
    channels_last = sorted(range(len(hidden)), key=lambda k: hidden[k].acts_on_channels)
    for k in channels_last:
        acts_on = world
        if hidden[k].acts_on_channels:
            others = sum(torque_by_effect.values(), 0.0)
            acts_on = replace(world, more=world.more + others)
        torque_by_effect[k] = hidden[k].torque(acts_on, motion)
    return [torque_by_effect[k] for k in range(len(hidden))]


def at_joint(
    joint: int,
    law: Callable[[World, TrueMotion], Array],
    library_value: float | None = 1.0,
    /,
    **shape: float,
) -> Hidden:
    """Make an effect that is a torque on one joint, proportional to its size.

    Parameters
    ----------
    joint : int
        Index of the joint, from 0.
    law : callable
        Maps world and motion to the torque (N,) at size 1.
    library_value : float or None
        The library's parameter at size 1; None if it has several.
    shape : float
        Constants of the effect, by the library's names.

    Returns
    -------
    Hidden
        The effect, of size 1.
    """

    def added_torque(world: World, motion: TrueMotion, size: float) -> Array:
        """Return the torque (N, n), zero on other joints."""
        return np.outer(size * law(world, motion), np.eye(world.arm.n)[joint])

    return Hidden((joint,), added_torque, library_value, shape)


def plain(
    law: Callable[[World, int, TrueMotion], Array], signed: bool = False
) -> Maker:
    """Return the maker of an effect without constants: a torque on one joint.

    Parameters
    ----------
    law : callable
        Maps world, joint (from 0) and motion to the torque (N,) at size 1.
    signed : bool
        Whether the sign of the torque is drawn at random.
    """

    def make(world: World, joint: int, rng: np.random.Generator) -> Hidden:
        """Make the effect on one joint (from 0), with its sign drawn if the torque is
        signed."""
        direction = float(rng.choice([-1.0, 1.0])) if signed else 1.0
        return at_joint(
            joint,
            lambda world, motion: direction * law(world, joint, motion),
            direction,
        )

    return make


def shifted(
    joint: int, shift: SizedLaw, library_value: float, size: float, rates: bool = True
) -> Hidden:
    """Make an effect by which a link stands at q + shift, while its encoder shows q.

    The added torque is the rigid-body torque of the shifted motion minus that of the
    encoder's.

    Parameters
    ----------
    joint : int
        Index of the joint, from 0.
    shift : SizedLaw
        Maps world, motion and size to the shift (N,) [rad, m].
    library_value : float
        The library's parameter at size 1.
    rates : bool
        Whether velocity and acceleration of the link follow the shift.
    """

    def added_torque(world: World, motion: TrueMotion, size: float) -> Array:
        """Return the rigid-body torque (N, n) of the shifted links minus that of the
        encoders' motion."""
        moved = displaced(motion, joint, shift(world, motion, size))
        if not rates:
            moved = replace(motion, q=moved.q)
        return world.rigid(moved) - world.rigid(motion)

    return Hidden((joint,), added_torque, library_value, size=size, shift=shift)


def displaced(motion: TrueMotion, joint: int, shift: Array) -> TrueMotion:
    """Return the motion of the links when one of them is shifted against its encoder.

    Rates of the shift are central differences.

    Parameters
    ----------
    motion : TrueMotion
        N samples of the encoders' motion on a fine grid.
    joint : int
        Index of the joint, from 0.
    shift : (N,)
        Shift of the joint's link [rad, m].
    """
    rate = np.gradient(shift, motion.t)
    return with_shift(motion, joint, shift, rate, np.gradient(rate, motion.t))


def with_shift(
    motion: TrueMotion, joint: int, shift: Array, rate: Array, acceleration: Array
) -> TrueMotion:
    """Return the motion of the links when one of them is shifted against its encoder.

    Parameters
    ----------
    motion : TrueMotion
        N samples of the encoders' motion.
    joint : int
        Index of the joint, from 0.
    shift, rate, acceleration : (N,)
        Shift of the joint's link [rad, m], and its first and second rate.
    """
    unit = np.eye(motion.q.shape[1])[joint]
    return TrueMotion(
        motion.t,
        motion.q + np.outer(shift, unit),
        motion.dq + np.outer(rate, unit),
        motion.ddq + np.outer(acceleration, unit),
    )


def sign(world: World, joint: int, motion: TrueMotion) -> Array:
    """Return the direction (N,) of a joint's (from 0) dry friction along a motion, -1
    to 1, smoothed as the world smooths it."""
    return world.share(motion)[:, joint]


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number between two limits whose logarithm is uniformly distributed."""
    logarithm = rng.uniform(np.log(low), np.log(high))
    return float(np.exp(logarithm))


def first_order(x: Array, step: float, lag: float) -> Array:
    """Filter samples x (N, ...), ``step`` [s] apart, by a first-order low-pass, y + lag
    dy/dt = x with ``lag`` [s].

    It starts at rest at the first sample; x is taken as linear between samples.
    """
    decay = float(np.exp(-step / lag))
    half = 0.5 * (1.0 - decay)
    # y_i = decay y_(i-1) + half (x_i + x_(i-1)), from y_0 = x_0.
    inputs = np.concatenate([x[:1], half * (x[1:] + x[:-1])])
    # A system with ones on its diagonal, and -decay below it.
    diagonals = np.repeat([[1.0], [-decay]], len(x), axis=1)
    return scipy.linalg.solve_banded((1, 0), diagonals, inputs)


def _unit(world: World, joint: int) -> float:
    """Return a joint's typical speed: 1 rad/s, or 0.5 m/s for a prismatic one.

    Constants of friction are drawn in units of it.
    """
    return float(world.arm.unit_speed[joint])


def _require_two_joints(world: World, effect: str) -> None:
    """Raise InputError for a robot of a single joint, which has no neighbour."""
    if world.arm.n < 2:
        raise InputError(
            f"effect {effect} needs a robot with two joints or more", "leave it out"
        )


def _stribeck(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make a Stribeck effect on a joint (from 0): dry friction that falls with speed.

    tau = size sign(dq) exp(-(dq / vs)^2), with the velocity vs drawn at random.
    Armstrong-Helouvry et al., Automatica 1994, eq. 7.
    """
    vs = _unit(drawing_world, joint) * log_uniform(rng, 0.04, 0.3)

    return at_joint(
        joint,
        lambda world, motion: (
            sign(world, joint, motion) * np.exp(-((motion.dq[:, joint] / vs) ** 2))
        ),
        vs=vs,
        delta=2.0,
    )


def _presliding(
    drawing_world: World,
    joint: int,
    rng: Generator,
    low: float = 0.001,
    high: float = 0.01,
) -> Hidden:
    """Make presliding hysteresis on a joint (from 0): after a reversal, friction builds
    up over a travel d.

    tau = size (z - sign(dq)), with the state z of Dahl's model (1968): it replaces the
    jump sign(dq) of the world's dry friction. A world without that jump keeps tau =
    size z. The travel d [rad, m] is drawn between ``low`` and ``high`` times the
    joint's typical speed in one second.
    """
    d = _unit(drawing_world, joint) * log_uniform(rng, low, high)

    return at_joint(
        joint,
        lambda world, motion: (
            _dahl_state(motion.t, motion.dq[:, joint], d)
            - world.dry.jumps * sign(world, joint, motion)
        ),
        d=d,
    )


def _dahl_state(t: Array, speed: Array, d: float) -> Array:
    """Return the state z (N,) of Dahl's friction, from -1 to 1, which follows the sign
    of a velocity ``speed`` (N,) over a travel d [rad, m]: dz/dt = dq / d - |dq| z / d.
    """
    states = bristles(t, speed[:, None], np.array([d]), np.ones_like)
    return states[:, 0]


def _sigmoid(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make sigmoid friction on a joint (from 0): a part of the Coulomb friction rises
    slowly with the velocity, over v0, instead of jumping.

    tau = size (tanh(dq / v0) - sign(dq)): the second term takes this part out of the
    world's Coulomb friction. v0 is drawn at random. Gaz et al., RA-L 2019, eq. 9.
    """
    v0 = _unit(drawing_world, joint) * log_uniform(rng, 0.05, 0.3)

    return at_joint(
        joint,
        lambda world, motion: (
            np.tanh(motion.dq[:, joint] / v0) - sign(world, joint, motion)
        ),
        v0=v0,
    )


def _power(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make friction on a joint (from 0) that grows with a power of the speed: tau =
    size sign(dq) |dq|^alpha, with alpha drawn below or above 1."""
    is_degressive = rng.random() < 0.5
    low, high = (0.3, 0.7) if is_degressive else (1.5, 2.5)
    alpha = float(rng.uniform(low, high))

    def law(world: World, motion: TrueMotion) -> Array:
        """Return the torque (N,) [N m, N] at size 1."""
        speed = motion.dq[:, joint]
        return np.sign(speed) * np.abs(speed) ** alpha

    return at_joint(joint, law, alpha=alpha)


def _coupling(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make friction of a joint (from 0) that depends on the velocity dq_i of a
    neighbour i.

    The form is drawn among viscous, tau = +-size dq_i (form 1), and dry, tau = +-size
    tanh(v / width) with v = dq_i (2), dq + dq_i (3) or dq - dq_i (4). Janot et al.,
    IEEE TCST 2014.
    """
    _require_two_joints(drawing_world, "joint_coupling")
    i = joint - 1 if joint > 0 else 1
    form = int(rng.integers(1, 5))
    side = float(rng.choice([-1.0, 1.0]))
    width = float(np.median(drawing_world.dry.width))

    def law(world: World, motion: TrueMotion) -> Array:
        """Return the torque (N,) [N m, N] at size 1."""
        velocity = motion.dq[:, joint]
        of_neighbour = motion.dq[:, i]
        by_form = {3: velocity + of_neighbour, 4: velocity - of_neighbour}
        speed = by_form.get(form, of_neighbour)
        if form == 1:
            return side * speed
        return side * np.tanh(speed / width)

    return at_joint(joint, law, side, i=float(i + 1), form=float(form))


def _belt(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make a belt between a joint (from 0) and the next one, or the last two.

    It stores size (q_j - r q_i)^2 / 2 with a ratio r that is drawn.
    """
    _require_two_joints(drawing_world, "elastic_coupling")
    first = min(joint, drawing_world.arm.n - 2)
    ratio = float(rng.uniform(0.5, 1.5))
    pull = np.zeros(drawing_world.arm.n)
    pull[first : first + 2] = -ratio, 1.0

    def added_torque(world: World, motion: TrueMotion, size: float) -> Array:
        """Return the added torque (N, n) [N m, N] at this size."""
        return np.outer(size * (motion.q @ pull), pull)

    return Hidden((first, first + 1), added_torque, -ratio)


def _warming(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make friction of a joint (from 0) that fades as the gears warm up, with time
    constant T.

    tau = size exp(-t / T) times sign(dq) (form 2, dry) or dq (form 4, viscous); form
    and T are drawn at random. Simoni et al., IROS 2015.
    """
    T = float(rng.uniform(40.0, 150.0))
    form = int(rng.choice([2, 4]))

    def law(world: World, motion: TrueMotion) -> Array:
        """Return the torque (N,) [N m, N] at size 1."""
        dry_or_viscous = sign(world, joint, motion)
        if form == 4:
            dry_or_viscous = motion.dq[:, joint]
        return np.exp(-motion.t / T) * dry_or_viscous

    return at_joint(joint, law, None, form=float(form), T=T)


def _by_temperature(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make friction of a joint (from 0) that falls with the measured temperature C of
    its gear.

    tau = size exp((20 - C) / warm) times dq or sign(dq): grease becomes thinner.
    ``warm`` [K] and the kind, viscous or dry, are drawn at random. Carlson, Robertsson,
    Johansson, 2015.
    """
    warm = float(rng.uniform(8.0, 40.0))
    viscous = bool(rng.random() < 0.5)

    def law(world: World, motion: TrueMotion) -> Array:
        """Return the torque (N,) [N m, N] at size 1."""
        # Relative to 20 degrees Celsius; falls to 1/e over ``warm`` degrees.
        thickness = np.exp((20.0 - world.temperature(motion.t)[:, joint]) / warm)
        if viscous:
            return thickness * motion.dq[:, joint]
        return thickness * sign(world, joint, motion)

    return at_joint(joint, law, law=1.0 + viscous, by=1.0, warm=warm)


def _transmission(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make friction of a motor that turns with a combination v = c^T dq of two
    neighbours.

    tau = size c g, with g = tanh(v / width) (dry, law 2), Dahl's state z along v
    (presliding over d, law 3), or tanh(v / width) exp(-(v / vs)^2) (Stribeck, law 4).
    Law, ratio, d and vs are drawn at random. Differential wrists have such motors (Wang
    et al. 2019). Viscous friction is left out: the joints' own viscous friction would
    absorb all of it but a cross term, which does not determine the ratio.
    """
    # First joints of two revolute neighbours; the pair nearest to ``joint`` is taken.
    pairs = [
        i
        for i in range(drawing_world.arm.n - 1)
        if drawing_world.arm.rotary[i : i + 2].all()
    ]
    if not pairs:
        raise InputError(
            "effect transmission_friction needs neighbours that turn", "leave it out"
        )
    first = min(pairs, key=lambda i: abs(i - joint))
    law = int(rng.choice([2, 3, 4]))
    ratio = float(rng.choice([-2.0, -1.0, -0.5, 0.5, 1.0, 2.0]))
    d = log_uniform(rng, 0.002, 0.01)
    vs = log_uniform(rng, 0.05, 0.25)
    width = float(np.median(drawing_world.dry.width))
    c = np.zeros(drawing_world.arm.n)
    c[first], c[first + 1] = 1.0, ratio

    def added_torque(world: World, motion: TrueMotion, size: float) -> Array:
        """Return the added torque (N, n) [N m, N] at this size."""
        v = motion.dq @ c
        if law == 3:
            friction = _dahl_state(motion.t, v, d)
        else:
            friction = np.tanh(v / width)
        if law == 4:
            friction = friction * np.exp(-((v / vs) ** 2))
        return np.outer(size * friction, c)

    law_constants = {3: {"d": d}, 4: {"vs": vs}}.get(law, {})
    shape = {
        f"c{first + 1}": 1.0,
        f"c{first + 2}": ratio,
        "law": float(law),
        **law_constants,
    }
    return Hidden((first, first + 1), added_torque, 1.0, shape)


def _load_hysteresis(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make friction of a joint (from 0) that is proportional to its load and builds up
    over a travel d: tau = size |tau_rigid| z, with the state z of Dahl's model.

    d is drawn once, in units of ``drawing_world``; a world adds the torque to its own.
    """
    d = _unit(drawing_world, joint) * log_uniform(rng, 0.002, 0.01)

    def torque_of_size_one(world: World, motion: TrueMotion) -> Array:
        """Return |tau_rigid| z (N,) along a motion."""
        load = np.abs(world.rigid(motion)[:, joint])
        return load * _dahl_state(motion.t, motion.dq[:, joint], d)

    return at_joint(joint, torque_of_size_one, d=d)


def _slip(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make Maxwell slip on a joint (from 0): three springs in parallel, each with a
    slider.

    tau = size sum_i w_i z_i. The stretch z_i follows the position over the travel d, 4
    d or 16 d and slips at -1 and 1; the weights w_i sum to 1. Al-Bender et al., IEEE
    TAC 2005.
    """
    d = _unit(drawing_world, joint) * log_uniform(rng, 0.001, 0.004)
    travel = d * np.array([1.0, 4.0, 16.0])
    weight = rng.dirichlet(np.ones(3))

    def law(world: World, motion: TrueMotion) -> Array:
        """Return the torque (N,) [N m, N] at size 1."""
        torque = np.zeros(len(motion.t))
        stretch = np.zeros(3)  # of each spring, 1 where its slider slips
        for k, step in enumerate(np.diff(motion.q[:, joint]), start=1):
            stretch = np.clip(stretch + step / travel, -1.0, 1.0)
            torque[k] = weight @ stretch
        return torque

    return at_joint(joint, law, None, d=d)


def _position(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make dry friction of a joint (from 0) whose size varies with the position: tau =
    size cos(k q + phase) sign(dq).

    k is the number of waves per turn, or 2 pi over a wavelength of 0.05 to 0.15 m on a
    prismatic joint. Popovic, Goldenberg 1998.
    """
    phase = float(rng.uniform(0.0, 2.0 * np.pi))
    if drawing_world.arm.rotary[joint]:
        k = float(rng.integers(1, 4))
    else:
        k = 2.0 * np.pi / float(rng.uniform(0.05, 0.15))

    return at_joint(
        joint,
        lambda world, motion: (
            np.cos(k * motion.q[:, joint] + phase) * sign(world, joint, motion)
        ),
        None,
        k=k,
    )


#: Laws of friction, by the library's name of the effect.
FRICTION: Mapping[str, Maker] = {
    "viscous_friction": plain(lambda world, joint, motion: motion.dq[:, joint]),
    "coulomb_friction": plain(sign),
    # A size for each direction: Armstrong-Helouvry et al., Automatica 1994, sec. 2.
    "asymmetric_viscous_friction": plain(
        lambda world, joint, motion: np.abs(motion.dq[:, joint]), signed=True
    ),
    "asymmetric_coulomb_friction": plain(
        lambda world, joint, motion: np.abs(sign(world, joint, motion)), signed=True
    ),
    "stribeck_friction": _stribeck,
    "presliding_hysteresis": _presliding,
    "sigmoid_friction": _sigmoid,
    "power_law_friction": _power,
    # In proportion to the torque that the gear transmits: Hamon, Gautier, Garrec, IROS
    # 2010.
    "load_dependent_friction": plain(
        lambda world, joint, motion: (
            np.abs(world.rigid(motion)[:, joint]) * sign(world, joint, motion)
        )
    ),
    "joint_coupling": _coupling,
    "drift_friction": _warming,
    "warming_friction": _by_temperature,
    "transmission_friction": _transmission,
    "load_dependent_hysteresis": _load_hysteresis,
    "maxwell_slip": _slip,
    "position_dependent_friction": _position,
}


def _drift(world: World, joint: int, rng: Generator) -> Hidden:
    """Make a torque offset of a joint (from 0) that decays as a sensor warms up: tau =
    size exp(-t / T), with T [s] drawn at random."""
    T = float(rng.uniform(40.0, 150.0))
    return at_joint(joint, lambda _, motion: np.exp(-motion.t / T), None, form=2.0, T=T)


def _waves(world: World, joint: int, rng: Generator, most: int) -> tuple[float, float]:
    """Draw a phase [rad], and how many waves in 2 pi of its position a joint (from 0)
    has: 2 to ``most``, or those of a prismatic joint's screw."""
    phase = float(rng.uniform(0.0, 2.0 * np.pi))
    k = float(rng.integers(2, most + 1))
    if not world.arm.rotary[joint]:
        k = 2.0 * np.pi / float(rng.uniform(0.008, 0.07))
    return phase, k


def _ripple(world: World, joint: int, rng: Generator) -> Hidden:
    """Make torque ripple of gear teeth or motor poles on a joint (from 0): tau = size
    cos(k q + phase).

    k is 2 to 40 waves per turn; a prismatic joint's screw has a lead of 8 to 70 mm.
    """
    phase, k = _waves(world, joint, rng, most=40)

    return at_joint(
        joint, lambda _, motion: np.cos(k * motion.q[:, joint] + phase), k=k
    )


def _end_stop(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make a spring that a joint (from 0) touches at one end of its range only.

    It begins at the middle of the range, or up to half of the way from there to the
    end. Joints without limits have a range of half a turn, or half a metre, to each
    side.
    """
    at = drawing_world.built.idx_qs[joint + 1]
    span = np.pi if drawing_world.arm.rotary[joint] else 0.5
    low = max(float(drawing_world.built.lowerPositionLimit[at]), -span)
    high = min(float(drawing_world.built.upperPositionLimit[at]), span)
    is_above = bool(rng.integers(2))
    offset = 0.25 * (high - low) * float(rng.uniform(0.0, 1.0))
    q0 = float(f"{0.5 * (low + high) + (offset if is_above else -offset):.6g}")

    def law(world: World, motion: TrueMotion) -> Array:
        """Return the torque (N,) [N m, N] at size 1."""
        q = motion.q[:, joint]
        touches = q > q0 if is_above else q < q0
        return np.where(touches, q - q0, 0.0)

    return at_joint(joint, law, q0=q0, side=1.0 if is_above else 2.0)


def _gain(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make a wrong gain of the torque channel of a joint (from 0): it adds +-size times
    the torque."""
    make = plain(
        lambda world, joint, motion: world.torque(motion)[:, joint], signed=True
    )
    return replace(make(drawing_world, joint, rng), acts_on_channels=True)


def _crosstalk(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make a torque channel of a joint (from 0) that holds +-size times the torque of
    a neighbour of the joint."""
    _require_two_joints(drawing_world, "torque_crosstalk")
    neighbours = [i for i in (joint - 1, joint + 1) if 0 <= i < drawing_world.arm.n]
    partner = int(rng.choice(neighbours))

    side = float(rng.choice([-1.0, 1.0]))

    crosstalk = at_joint(
        joint,
        lambda world, motion: side * world.torque(motion)[:, partner],
        side,
        i=float(partner + 1),
    )
    return replace(crosstalk, acts_on_channels=True, size=0.05)


def _late(channels: list[int], joints: tuple[int, ...]) -> Hidden:
    """Make a delay of torque channels against the positions: the added torque is tau(t
    - size) - tau(t), and the size is the delay [s].

    The torque of the joints ``channels`` (from 0) is late; the truth names ``joints``,
    () for the whole robot.
    """

    def added_torque(world: World, motion: TrueMotion, size: float) -> Array:
        """Return the added torque (N, n) [N m, N] at this size."""
        tau = world.torque(motion)
        delayed = tau.copy()
        t = motion.t
        for joint in channels:
            delayed[:, joint] = np.interp(t - size, t, tau[:, joint])
        return delayed - tau

    return Hidden(joints, added_torque, size=1e-3, acts_on_channels=True)


def _filter(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make a low-pass filter 1 / (1 + T s) of all torque channels: the added torque is
    the filtered torque minus the torque, and the size is T [s]."""

    def added_torque(world: World, motion: TrueMotion, T: float) -> Array:
        """Return the added torque (N, n) [N m, N] at this size."""
        # The motion's grid may be too coarse for a filter of some milliseconds: effects
        # are sized at 200 Hz. So the filter runs on a grid of 0.25 ms or finer.
        step = min(float(motion.t[1] - motion.t[0]), 0.25e-3)
        t = np.arange(motion.t[0], motion.t[-1], step)
        tau = world.torque(motion)
        fine = _resample(t, motion.t, tau)
        passed = first_order(fine, float(t[1] - t[0]), T)
        return _resample(motion.t, t, passed) - tau

    return Hidden((), added_torque, size=1e-3, acts_on_channels=True)


def _resample(t: Array, t_known: Array, values: Array) -> Array:
    """Interpolate values (M, n), known at t_known (M,), at the times t (N,): (N, n)."""
    columns = [np.interp(t, t_known, column) for column in values.T]
    return np.column_stack(columns)


def _zero_error(world: World, joint: int, rng: Generator) -> Hidden:
    """Make a constant error of the zero position of a joint (from 0): its link stands
    at q +- size [rad, m]."""
    side = float(rng.choice([-1.0, 1.0]))
    return shifted(
        joint, lambda _, motion, a: np.full(len(motion.t), a * side), side, 1e-3
    )


def _elasticity(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make an elastic joint (from 0): its link lags behind the encoder by the
    compliance times the torque that the link needs.

    shift = -c tau(q + shift), solved by two steps of iteration; the link does not
    oscillate on its spring. The size is c [rad/(N m), m/N]. Spong 1987.
    """

    def shift(world: World, motion: TrueMotion, c: float) -> Array:
        """Return the displacement (N,) [rad, m] of the joint's link at this size."""
        lag = np.zeros(len(motion.t))
        for _ in range(2):
            lag = -c * world.rigid(displaced(motion, joint, lag))[:, joint]
        return lag

    return shifted(joint, shift, 1.0, 1e-5)


def _gear_at_frequency(
    world: World, joint: int, f: float, zeta: float
) -> tuple[float, float]:
    """Return stiffness k [N m/rad, N/m] and damping d [N m s/rad, N s/m] of a gear on which
    a joint's (from 0) mean inertia M swings at f [Hz] with the damping ratio zeta.

    k = (2 pi f)^2 M, d = 2 zeta sqrt(k M), M the mean over 16 random positions.
    """
    n = world.arm.n
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (16, n))
    at_rest = TrueMotion(np.arange(16.0), q, 0.0 * q, 0.0 * q)
    # Inertia is the torque that a unit of acceleration adds.
    accelerated = replace(at_rest, ddq=at_rest.ddq + np.eye(n)[joint])
    torques_of_unit = world.rigid(accelerated) - world.rigid(at_rest)
    stiffness = (2.0 * np.pi * f) ** 2 * torques_of_unit[:, joint].mean()
    return stiffness, zeta * stiffness / (np.pi * f)


def _resonance(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make an elastic joint (from 0), whose link swings on its gear.

    The link's shift s [rad, m] obeys M s'' + (D + d) s' + (K + k) s = -tau, with M, D and
    K the derivatives of the link's torque by acceleration, velocity and position. The
    gear's stiffness k and damping d follow from a drawn frequency f [Hz] and damping
    ratio zeta. Sizes multiply the torque. Spong 1987.
    """
    f = log_uniform(rng, 2.0, 5.0)
    zeta = log_uniform(rng, 0.02, 0.1)

    def added_torque(world: World, motion: TrueMotion, size: float) -> Array:
        """Return the torque (N, n) [N m, N] that the elastic joint adds at this size.

        The link's swing is solved by Newmark's method; it moves the rigid arm.
        """
        of_joint = np.eye(motion.q.shape[1])[joint]
        step = 1e-5  # [rad, m] and their rates: small beside the motion

        def slope(state: str) -> Array:
            """Return the derivative (N,) of the joint's torque by its q, dq or ddq."""
            value = getattr(motion, state)
            below = world.rigid(replace(motion, **{state: value - step * of_joint}))
            above = world.rigid(replace(motion, **{state: value + step * of_joint}))
            return (above - below)[:, joint] / (2.0 * step)

        stiffness, damping = _gear_at_frequency(world, joint, f, zeta)
        shift = newmark(
            motion.t,
            mass=slope("ddq"),
            damping=slope("dq") + damping,
            stiffness=slope("q") + stiffness,
            force=-world.rigid(motion)[:, joint],
        )
        # The library's torque is linear in the shift, so that of a hundredth is scaled up.
        moved = displaced(motion, joint, 0.01 * shift)
        return 100.0 * size * (world.rigid(moved) - world.rigid(motion))

    return Hidden((joint,), added_torque, None, {"f": f, "zeta": zeta})


def _gear_error(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make a gear of a joint (from 0) that turns unevenly: its link stands at q + x, x =
    size cos(k q + phase).

    k is 2 to 100 waves per turn; a prismatic joint's screw has a lead of 8 to 70 mm. No
    power is lost: the motor carries (1 + dx/dq) times its link's torque.
    """
    phase, k = _waves(drawing_world, joint, rng, most=100)

    def added_torque(world: World, motion: TrueMotion, size: float) -> Array:
        """Return the added torque (N, n) [N m, N] at this size [rad, m]."""
        dq, ddq = motion.dq[:, joint], motion.ddq[:, joint]
        angle = k * motion.q[:, joint] + phase
        x = size * np.cos(angle)
        slope = -size * k * np.sin(angle)  # dx/dq
        bend = -(k**2) * x  # d^2 x/dq^2
        moved = with_shift(motion, joint, x, slope * dq, slope * ddq + bend * dq**2)
        torque = world.rigid(moved)
        torque[:, joint] *= 1.0 + slope
        return torque - world.rigid(motion)

    return Hidden((joint,), added_torque, 1.0, {"k": k}, size=1e-4)


def newmark(
    t: Array, mass: Array, damping: Array, stiffness: Array, force: Array
) -> Array:
    """Solve m x'' + d x' + k x = force at equidistant instants t (N,) [s] by Newmark's
    method of average acceleration.

    Parameters
    ----------
    mass, damping, stiffness, force : (N,)
        The coefficients at these instants, in SI units.

    Returns
    -------
    (N,)
        The position x, from rest under the first force.
    """
    h = t[1] - t[0]
    x = np.empty_like(t)
    x[0] = force[0] / stiffness[0]
    rate = acceleration = 0.0
    for k in range(1, len(t)):
        # Position and velocity without the new acceleration.
        coasting = x[k - 1] + h * rate + 0.25 * h**2 * acceleration
        rate_before = rate + 0.5 * h * acceleration
        remaining_force = force[k] - damping[k] * rate_before - stiffness[k] * coasting
        inertia = mass[k] + 0.5 * h * damping[k] + 0.25 * h**2 * stiffness[k]
        acceleration = remaining_force / inertia
        rate = rate_before + 0.5 * h * acceleration
        x[k] = coasting + 0.25 * h**2 * acceleration
    return x


def _backlash(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make backlash of a joint (from 0): its link rests on the flank that its torque
    presses it to.

    shift = -b tanh(50 tau / max |tau|): the link changes flanks within a fiftieth of
    the largest torque, without impacts. The size b is half the play [rad, m]. Nordin,
    Gutman 2002.
    """

    def shift(world: World, motion: TrueMotion, b: float) -> Array:
        """Return the displacement (N,) [rad, m] of the joint's link at this size."""
        tau = world.rigid(motion)[:, joint]
        return -b * np.tanh(50.0 * tau / max(np.abs(tau).max(), 1e-9))

    return shifted(joint, shift, 1.0, 1e-4, rates=False)


def _tilt(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make a tilted base: gravity has a horizontal part in a random direction. The size
    is that part [m/s^2]; the joint is not used."""
    angle = float(rng.uniform(0.0, 2.0 * np.pi))

    def added_torque(world: World, motion: TrueMotion, size: float) -> Array:
        """Return the added torque (N, n) [N m, N] at this size."""
        tilted = pin.Model(world.built)
        horizontal = size * np.array([np.cos(angle), np.sin(angle), 0.0])
        tilted.gravity.linear = world.built.gravity.linear + horizontal
        return world.rigid(motion, tilted) - world.rigid(motion)

    return Hidden((), added_torque, 1.0, size=0.1)


def _wrench(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make a constant force F and moment M on the last link, in world axes and of
    random direction.

    The motors carry -size J^T (F, M), with the Jacobian J of the last joint. F is of
    the order of 1 N and M of 0.1 N m at size 1; the joint is not used.
    """
    force = np.concatenate([rng.normal(size=3), 0.1 * rng.normal(size=3)])

    def added_torque(world: World, motion: TrueMotion, size: float) -> Array:
        """Return the added torque (N, n) [N m, N] at this size."""
        data = world.built.createData()
        torques_of_rows = []
        for q in motion.q:
            jacobian = world.arm.last_jacobian(world.built, data, q)
            torques_of_rows.append(-size * (jacobian.T @ force))
        return np.array(torques_of_rows)

    return Hidden((), added_torque, None)


def _payload(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make a payload: a ball of 5 cm radius at a random place on the last link. The
    size is its mass [kg]; the joint is not used."""
    last_link = drawing_world.arm.model.jointPlacements[-1].translation
    farthest = float(np.linalg.norm(last_link)) + 0.05
    centre = rng.uniform(-0.5, 0.5, 3) * farthest

    def added_torque(world: World, motion: TrueMotion, mass: float) -> Array:
        """Return the added torque (N, n) [N m, N] at this size."""
        loaded = pin.Model(world.built)
        ball = pin.Inertia(mass, centre, pin.Inertia.FromSphere(mass, 0.05).inertia)
        loaded.inertias[world.arm.last] = world.built.inertias[world.arm.last] + ball
        return world.rigid(motion, loaded) - world.rigid(motion)

    return Hidden((), added_torque, 1.0, size=0.1, details={"com": centre.tolist()})


def _misplaced(drawing_world: World, joint: int, rng: Generator) -> Hidden:
    """Make joints that are misplaced against the kinematic model.

    At size 1 the standard deviations are 0.1 mm and 0.2 mrad about each axis.
    """
    seed = int(rng.integers(2**32))

    def added_torque(world: World, motion: TrueMotion, size: float) -> Array:
        """Return the added torque (N, n) [N m, N] at this size."""
        slip = 1e-4 * size
        turn = np.rad2deg(2e-4 * size)
        displaced_world = misplaced(
            world.built, slip, turn, np.random.default_rng(seed)
        )
        return world.rigid(motion, displaced_world) - world.rigid(motion)

    return Hidden((), added_torque, None)


#: Dahl's friction over a travel that hardly shows.
_stiction = partial(_presliding, low=0.0005, high=0.001)
#: Effects that show only against a model that is kept fixed: fitted links absorb them.
FROZEN: Mapping[str, Maker] = {"payload": _payload}
#: Springs, of joints and of gears, and mixed channels, that no class of the challenge
#: draws.
SPRINGS: Mapping[str, Maker] = {
    "stiffening_spring": plain(lambda world, joint, motion: motion.q[:, joint] ** 3),
    "end_stop": _end_stop,
    "elastic_coupling": _belt,
    "joint_resonance": _resonance,
    "gear_error": _gear_error,
    "torque_crosstalk": _crosstalk,
}
#: Effects that a diagnosis treats as nuisances.
NUISANCE: Mapping[str, Maker] = {"kinematic_error": _misplaced, "stiction": _stiction}
#: Effects of joints, torque channels and the base that are no friction.
MACHINE: Mapping[str, Maker] = {
    "joint_spring": plain(lambda world, joint, motion: motion.q[:, joint]),
    "torque_offset": plain(
        lambda world, joint, motion: np.ones(len(motion.t)), signed=True
    ),
    "drift_offset": _drift,
    "torque_ripple": _ripple,
    "rotor_inertia": plain(lambda world, joint, motion: motion.ddq[:, joint]),
    "torque_gain": _gain,
    "torque_delay": lambda world, joint, rng: _late([joint], (joint,)),
    "global_delay": lambda world, joint, rng: _late(list(range(world.arm.n)), ()),
    "torque_filter": _filter,
    "joint_zero_error": _zero_error,
    "joint_elasticity": _elasticity,
    "backlash": _backlash,
    "base_tilt": _tilt,
    "external_wrench": _wrench,
}
#: All effects that can be hidden, by the library's name.
MAKERS: Mapping[str, Maker] = dict(
    sorted({**FRICTION, **MACHINE, **FROZEN, **SPRINGS, **NUISANCE}.items())
)
