"""Under which conditions a robot is measured, and the nuisances: conditions that are no
finding.

What lies between a torque and its log, an angle and its log: filters, delay, noise,
steps. What a nuisance makes fair to name is stated here, before any case is run.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.random import Generator
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from sdp_vs_penalty.simulation.worlds.hidden import first_order, log_uniform
from sdp_vs_penalty.simulation.worlds.world import (
    Arm,
    Array,
    DryFriction,
    TrueMotion,
    World,
    bristles,
)

ARMS = ("panda", "elbow", "desk", "scara")
RATES = (100.0, 125.0, 200.0, 250.0, 500.0, 1000.0)


@dataclass(frozen=True)
class Channel:
    """smooth : length of a moving average that looks both ways; lag : time constant of
    a causal low-pass; delay : of the torque log behind the positions [s]; rate : of the
    log [Hz]; step : of the encoder [rad]; speed_noise : of a logged velocity [rad/s],
    None: no velocity in the log."""

    rate: float = 500.0
    smooth: float = 0.0
    lag: float = 0.0
    delay: float = 0.0
    step: float = 1e-5
    speed_noise: float | None = None

    def torque(self, t: Array, tau: Array) -> Array:
        """(N, n) what the channel carries, on the same fine and even grid."""
        step = float(t[1] - t[0])
        if self.lag:
            tau = first_order(tau, step, self.lag)
        if self.smooth:
            half = round(self.smooth / step) // 2
            tau = uniform_filter1d(tau, 2 * half + 1, axis=0, mode="nearest")
        if self.delay:
            tau = np.column_stack(
                [np.interp(t - self.delay, t, column) for column in tau.T]
            )
        return tau

    def position(self, q: Array, unit: Array) -> Array:
        """(N, n) as the encoder counts; unit (n,) : metres of a prismatic joint for a
        radian."""
        step = self.step * unit
        return np.asarray(np.round(q / step) * step)


@dataclass(frozen=True)
class SensorNoise:
    """level : over the arm's own; colour : of a first-order autoregression; tails :
    degrees of freedom of Student's distribution, None: normal."""

    level: float = 1.0
    colour: float = 0.3
    tails: float | None = None

    def draw(self, samples: int, std: Array, rng: np.random.Generator) -> Array:
        """(samples, n) of standard deviation ``std`` (n,)."""
        size = (samples + 200, len(std))
        if self.tails is None:
            fresh = rng.normal(size=size)
        else:
            fresh = rng.standard_t(self.tails, size) * np.sqrt(
                (self.tails - 2.0) / self.tails
            )
        coloured = lfilter(
            [np.sqrt(1.0 - self.colour**2)], [1.0, -self.colour], fresh, axis=0
        )
        return np.asarray(std * coloured[200:])


@dataclass(frozen=True)
class Conditions:
    """width : (smallest, largest) of tanh [rad/s or m/s], drawn joint by joint, by
    default what the library's Coulomb friction has unless told otherwise; asymmetry :
    of Coulomb and viscous friction, as a share; warming : share of the viscous friction
    that goes as grease warms up; thermometer : whether the gears' temperatures are
    logged; misplacement : (m, degrees) of the true joints beside the URDF; runs,
    duration : of what is diagnosed, a test run apart; motion : as of motion.plan; servo
    : whether a servo drives it, and friction holds what stands; rotor : inertia of
    geared rotors over that of the links that they move, none of which the URDF tells.
    """

    arm: str = "panda"
    law: str = "tanh"
    width: tuple[float, float] = (0.01, 0.01)
    asymmetry: float = 0.0
    warming: float = 0.0
    thermometer: bool = False
    misplacement: tuple[float, float] = (0.0, 0.0)
    channel: Channel = field(default_factory=Channel)
    noise: SensorNoise = field(default_factory=SensorNoise)
    motion: str = "periodic"
    runs: int = 3
    duration: float = 20.0
    servo: bool = False
    rotor: float = 0.0


@dataclass(frozen=True)
class FrictionLaw(DryFriction):
    """law : sign, tanh, dahl or lugre; travel (n,) : of the bristles [rad or m]; rise,
    speed (n,) : by how much LuGre's friction is larger at rest, and up to which speed.
    """

    law: str
    travel: Array
    rise: Array
    speed: Array

    @property
    def jumps(self) -> bool:
        return self.law in ("sign", "tanh")

    def share(self, t: Array, dq: Array) -> Array:
        """(N, n) the dry friction over the Coulomb torque; t (N,) s, evenly spaced at
        >= 1 kHz."""
        if self.law == "sign":
            return np.sign(dq)
        if self.law == "tanh":
            return super().share(t, dq)
        if self.law == "dahl":
            return bristles(t, dq, self.travel, np.ones_like)

        def level(v: Array) -> Array:
            return 1.0 + self.rise * np.exp(-((v / self.speed) ** 2))

        z = bristles(t, dq, self.travel, level)
        side = np.sign(dq)
        return z + 0.02 * side * (
            1.0 - side * z / level(dq)
        )  # and what bends the bristles is damped

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        own = {
            "tanh": ("width",),
            "dahl": ("travel",),
            "lugre": ("travel", "rise", "speed"),
        }
        return {"law": self.law} | {
            x: getattr(self, x).tolist() for x in own.get(self.law, ())
        }


@dataclass(frozen=True)
class RatedArm(Arm):
    """lower, upper, speed (n,) : limits of the joints [rad or m, and per s]; coulomb,
    viscous, noise (n,) : nominal sizes [N m or N]."""

    lower: Array
    upper: Array
    speed: Array
    coulomb: Array
    viscous: Array
    noise: Array


@dataclass(frozen=True)
class Driven(TrueMotion):
    """share (N, n): dry friction over the Coulomb torque, as a servo met it."""

    share: Array


@dataclass(frozen=True, kw_only=True)
class Site(World):
    """A world, and the conditions under which it is measured. sides (2, n) : the shares
    of Coulomb and of viscous friction that have the same sign in both directions; rotor
    (n,) : inertia [kg m^2 or kg] that a motor turns besides its link."""

    arm: RatedArm
    dry: FrictionLaw
    sides: Array
    rotor: Array
    conditions: Conditions

    def torque(self, m: TrueMotion) -> Array:
        """(N, n) of the motors, or of sensors that friction also loads."""
        return self.rigid(m) + self.rotor * m.ddq + self.friction(m) + self.more

    def share(self, m: TrueMotion) -> Array:
        """(N, n) dry friction over the Coulomb torque: as the servo met it, or by its
        law."""
        return m.share if isinstance(m, Driven) else super().share(m)

    def friction(self, m: TrueMotion) -> Array:
        """(N, n) dry, viscous, and what stays the same in both directions."""
        share, (dry_side, wet_side) = self.share(m), self.sides
        cold = 1.0 - self.conditions.warming * (1.0 - np.exp(-m.t / self.warm_up))
        viscous = self.viscous * m.dq + wet_side * self.viscous * np.abs(m.dq)
        dry = self.coulomb * share + dry_side * self.coulomb * np.abs(share)
        return np.asarray(dry + cold[:, None] * viscous + self.offset)


def _channel(c: Conditions, **changes: float | None) -> Conditions:
    return replace(c, channel=replace(c.channel, **changes))  # type: ignore[arg-type]


def _encoder(c: Conditions, rng: Generator) -> Conditions:
    step = 2.0 * np.pi / 2.0 ** int(rng.integers(13, 21))
    speed = log_uniform(rng, 1e-4, 3e-3) if rng.random() < 0.5 else None
    return _channel(c, step=step, speed_noise=speed)


def _noise(c: Conditions, rng: Generator) -> Conditions:
    tails = float(rng.uniform(3.0, 8.0)) if rng.random() < 0.5 else None
    return replace(
        c,
        noise=SensorNoise(
            log_uniform(rng, 0.3, 3.0), float(rng.uniform(0.0, 0.9)), tails
        ),
    )


def _servo(c: Conditions, rng: Generator) -> Conditions:
    """Driven in closed loop, mostly from point to point; friction that sticks, or turns
    fast."""
    law = str(rng.choice(["sign", "sign", "tanh", "dahl"]))
    motion = str(rng.choice(["points", "points", "periodic", "aperiodic"]))
    return replace(c, servo=True, law=law, width=(0.003, 0.03), motion=motion)


def _mixed(c: Conditions, rng: Generator) -> Conditions:
    """Several at once: each kind of nuisance in half of the cases."""
    kinds = ("sign", "tanh_0.002", "widths", "dahl", "lugre")
    drawn = [
        str(rng.choice(kinds)),
        *("asymmetric", "warming", "geometry", "encoder", "rate", "noise"),
    ]
    drawn += [
        str(rng.choice(["smoothed", "causal", "delay"])),
        str(rng.choice(["points", "servo"])),
    ]
    drawn += ["aperiodic", "rotor"]
    for name in drawn:
        if rng.random() < 0.5:
            c = NUISANCES[name](c, rng)
    return c


#: The conditions of one case, from usual ones.
NUISANCES: Mapping[str, Callable[[Conditions, Generator], Conditions]] = {
    "plain": lambda *_: Conditions(channel=Channel(rate=1000.0)),
    "sign": lambda c, _: replace(c, law="sign"),
    "tanh_0.002": lambda c, _: replace(c, law="tanh", width=(0.002, 0.002)),
    "widths": lambda c, _: replace(c, law="tanh", width=(0.002, 0.1)),
    "asymmetric": lambda c, rng: replace(c, asymmetry=float(rng.uniform(0.05, 0.3))),
    "warming": lambda c, rng: replace(
        c, warming=float(rng.uniform(0.1, 0.4)), thermometer=True
    ),
    "dahl": lambda c, _: replace(c, law="dahl"),
    "lugre": lambda c, _: replace(c, law="lugre"),
    "smoothed": lambda c, _: _channel(c, smooth=0.04),
    "causal": lambda c, rng: _channel(c, lag=log_uniform(rng, 0.003, 0.02)),
    "delay": lambda c, rng: _channel(c, delay=log_uniform(rng, 0.002, 0.02)),
    "geometry": lambda c, _: replace(c, misplacement=(1e-3, 0.1)),
    "encoder": _encoder,
    "rate": lambda c, rng: _channel(c, rate=float(rng.choice(RATES))),
    "noise": _noise,
    "points": lambda c, _: replace(c, motion="points"),
    "servo": _servo,
    "rotor": lambda c, rng: replace(c, rotor=float(rng.uniform(0.05, 0.6))),
    "aperiodic": lambda c, _: replace(c, motion="aperiodic"),
    "one_run": lambda c, rng: replace(
        c, runs=1, duration=float(rng.uniform(15.0, 60.0))
    ),
    "short": lambda c, rng: replace(c, runs=2, duration=float(rng.uniform(8.0, 12.0))),
    "mixed": _mixed,
}

_PRESLIDING = ("presliding_hysteresis", "maxwell_slip")
_LATE = ("global_delay", "torque_delay", "torque_filter")
_UNEVEN = (
    "asymmetric_viscous_friction",
    "asymmetric_coulomb_friction",
    "torque_offset",
)
_GEOMETRY = ("kinematic_error", "base_tilt", "joint_zero_error")

#: Under which conditions which effects are a right answer (a changed shape constant,
#: kind "retune", always is), and whether "unknown effect" is one as well.
FAIR: Sequence[tuple[Callable[[Conditions], bool], tuple[str, ...], bool]] = (
    (
        lambda c: c.law == "tanh" and max(c.width) > max(Conditions().width),
        ("sigmoid_friction",),
        False,
    ),
    (lambda c: c.asymmetry > 0.0, _UNEVEN, False),
    (lambda c: c.warming > 0.0, ("drift_friction", "warming_friction"), False),
    (lambda c: c.law == "dahl", _PRESLIDING, False),
    (lambda c: c.law == "lugre", (*_PRESLIDING, "stribeck_friction"), True),
    (lambda c: c.channel.smooth > 0.0, ("torque_filter",), True),
    # A delay is only the first order of a low-pass: what it leaves has no exact name.
    (lambda c: c.channel.lag > 0.0, _LATE, True),
    (lambda c: c.channel.delay > 0.0, _LATE, False),
    (lambda c: c.misplacement != (0.0, 0.0), _GEOMETRY, True),
    # A sign of the velocity lets go at rest, where set-valued friction holds.
    (lambda c: c.servo and c.law == "sign", ("stiction",), False),
    (lambda c: c.rotor > 0.0, ("rotor_inertia",), False),
)


def draw_conditions(nuisance: str, rng: Generator) -> Conditions:
    """Conditions of one case of a class of nuisance, on any of the arms (plain: on the
    Panda)."""
    arm = str(rng.choice(ARMS))
    usual = Conditions(
        arm, runs=int(rng.integers(2, 5)), duration=float(rng.uniform(10.0, 25.0))
    )
    return NUISANCES[nuisance](usual, rng)


def fair(c: Conditions) -> tuple[set[str], bool]:
    """The effects that are a right answer to these conditions, and whether abstaining
    is one."""
    present = [(effects, abstains) for at_work, effects, abstains in FAIR if at_work(c)]
    return {x for effects, _ in present for x in effects}, any(
        abstains for _, abstains in present
    )
