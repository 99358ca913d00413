"""What an effect is: one physical cause of joint torque, linear in its parameters.

tau_j(t) = sum over effects of Y_e,j(t) theta_e. The columns Y_e come from the motion and, where an
effect needs a torque (a gain, load friction), from the current model's prediction, never from the
measured channel: that would explain itself.

A file in this folder that defines a subclass of :class:`Effect` is its registration.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """One entry of theta. ``joint`` counts from 1 (0: the whole robot); ``lower`` is its sign bound."""

    name: str
    unit: str
    effect: str
    joint: int
    lower: float = -np.inf


@dataclass(frozen=True)
class CurrentModel:
    """What torque-dependent effects refer to: the robot and its links' standard parameters (n, 10)."""

    robot: Robot
    links: Array


@dataclass(frozen=True)
class Motion:
    """A motion sampled uniformly: t (N,) s; q, dq, ddq (N, n); torque (N, n) of the current model.

    Effects that need a torque read ``torque``, those that need inverse dynamics ``current``: both
    come from the model as it stands, never from the measured torque.
    """

    t: Array
    q: Array
    dq: Array
    ddq: Array
    torque: Array | None = None
    current: CurrentModel | None = None
    #: Velocity [rad/s, m/s] over which the sign of a velocity is smoothed: the model's own for Coulomb.
    sign_width: float = 0.01

    def sign(self, joint: int) -> Array:
        """(N,) smooth sign of a joint's velocity."""
        return smooth_sign(self.dq[:, joint], self.sign_width)

    @cached_property
    def model_torque(self) -> Array:
        """``torque``; ValueError where this motion carries none."""
        if self.torque is None:
            raise ValueError("this effect needs Motion.torque, the current model's prediction")
        return self.torque

    @cached_property
    def link_torque(self) -> Array:
        """(N, n) what the gears transmit: the current model's rigid-body torque, without friction."""
        links = self.model_links
        assert self.current is not None
        return self.current.robot.inverse_dynamics(links, self.q, self.dq, self.ddq)

    @cached_property
    def torque_rate(self) -> Array:
        """d torque / dt (N, n) by central differences."""
        return _time_derivative(self.model_torque, self.t)

    @cached_property
    def link_torque_rates(self) -> tuple[Array, Array]:
        """First and second time derivative of :attr:`link_torque`."""
        rate = _time_derivative(self.link_torque, self.t)
        return rate, _time_derivative(rate, self.t)

    @property
    def model_links(self) -> Array:
        """(n, 10) standard parameters of the current model's links; ValueError without one."""
        if self.current is None:
            raise ValueError("this effect needs Motion.current, the current model's links")
        return self.current.links

    @cached_property
    def derivatives(self) -> tuple[Array, Array, Array]:
        """dID/dq, dID/d dq, dID/d ddq of the current model's links, each (N, n, n)."""
        links = self.model_links
        assert self.current is not None
        return self.current.robot.inverse_dynamics_derivatives(links, self.q, self.dq, self.ddq)


def _time_derivative(values: Array, t: Array) -> Array:
    return np.gradient(values, t, axis=0) if len(t) > 1 else np.zeros_like(values)


@dataclass(frozen=True)
class Block:
    """Columns (N, k) of the torque on one joint, and which k of the effect's parameters they meet."""

    joint: int
    parameters: NDArray[np.intp]
    columns: Array


#: Shape constants that are no width, exponent or period: they may be zero or negative.
_SIGNED_SHAPES = ("form", "i", "t0")


class Effect(ABC):
    """One effect on the joints it is given (from 0), with its shape constants fixed.

    Subclasses set the class attributes, which the command line and the README show, and define
    :attr:`parameters` and :meth:`blocks`.
    """

    name: ClassVar[str]
    equation: ClassVar[str]
    explanation: ClassVar[str]
    reference: ClassVar[str]
    #: Non-linear shape constants and their defaults, in SI units.
    shape_defaults: ClassVar[Mapping[str, float]] = {}
    #: True where a column depends on earlier motion: it is then computed over whole runs.
    has_memory: ClassVar[bool] = False
    #: True where the columns need Motion.torque.
    needs_torque: ClassVar[bool] = False
    #: True where the columns need Motion.current, the links of the current model.
    needs_links: ClassVar[bool] = False
    #: True where one parameter acts on the whole robot: there is nothing to choose joints from.
    whole_robot: ClassVar[bool] = False
    #: True where the links absorb the effect, so that it shows only against a model held fixed.
    frozen_only: ClassVar[bool] = False
    #: Effects of which this one is a finer form: it is looked for only where one of them is known.
    refines: ClassVar[tuple[str, ...]] = ()
    #: Values of each shape constant that a search starts from, and the range that it may refine in
    #: (constants without a range stay on their values).
    shape_grid: ClassVar[Mapping[str, Sequence[float]]] = {}
    shape_bounds: ClassVar[Mapping[str, tuple[float, float]]] = {}

    def __init__(self, robot: Robot, joints: Sequence[int] | None = None, **shape: float) -> None:
        self.robot = robot
        if self.whole_robot and joints is not None:
            raise InputError(f"effect {self.name} acts on the whole robot: write it without joints.")
        self.joints = tuple(range(robot.n)) if joints is None else tuple(sorted(set(joints)))
        #: Which joints were asked for; None means all, and is how the effect is written down.
        self.asked_joints = None if joints is None else self.joints
        for j in self.joints:
            if not 0 <= j < robot.n:
                raise InputError(
                    f"effect {self.name}: joint {j + 1} does not exist, the robot has {robot.n}."
                )
        for key, value in shape.items():
            if key not in self.shape_defaults:
                known = ", ".join(self.shape_defaults) or "none"
                raise InputError(f"effect {self.name}: no shape constant {key!r} (it has: {known}).")
            if not np.isfinite(value):
                raise InputError(f"effect {self.name}: shape constant {key} must be finite.")
            if key not in _SIGNED_SHAPES and not value > 0.0:
                raise InputError(
                    f"effect {self.name}: shape constant {key} must be above 0, not {value:g}."
                )
        self.shape: dict[str, float] = {**self.shape_defaults, **shape}

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """The effect's own part of theta."""

    @abstractmethod
    def blocks(self, motion: Motion) -> list[Block]:
        """The columns, joint by joint; joints without torque from this effect may be left out."""

    @classmethod
    def shapes(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        """The shape constants with which a search begins on one joint; none where it cannot act."""
        names = list(cls.shape_grid)
        return [dict(zip(names, v, strict=True)) for v in product(*(cls.shape_grid[k] for k in names))]

    def shape_unit(self, key: str, joint: int) -> str:
        """Unit of a shape constant on a joint; "-" for a number."""
        return "-"

    @property
    def text(self) -> str:
        """How the effect is written on the command line."""
        joints = "" if self.asked_joints is None else ":" + "+".join(str(j + 1) for j in self.joints)
        shape = "".join(f"@{k}={v:.6g}" for k, v in self.shape.items())
        return f"{self.name}{joints}{shape}"

    def to_dict(self) -> dict[str, object]:
        joints = None if self.asked_joints is None else [j + 1 for j in self.asked_joints]
        return {"effect": self.name, "joints": joints, "shape": dict(self.shape)}


class OneAJoint(Effect):
    """An effect with one parameter a joint, wherever its torque acts."""

    #: Prefix of the parameter's name: symbol "f_v" gives f_v1 ... f_vn.
    symbol: ClassVar[str]
    #: "torque per ...": the unit for a revolute and for a prismatic joint.
    units: ClassVar[tuple[str, str]]
    #: Lower bound of the parameter: 0 where physics fixes the sign.
    lower: ClassVar[float] = -np.inf

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(
                f"{self.symbol}{j + 1}",
                self.units[self.robot.joints[j].kind == "prismatic"],
                self.name,
                j + 1,
                self.lower,
            )
            for j in self.joints
        )


class JointEffect(OneAJoint):
    """An effect with one column a joint, on that joint's own torque."""

    @abstractmethod
    def column(self, motion: Motion, joint: int) -> Array:
        """The (N,) column of the torque on ``joint`` (from 0)."""

    def blocks(self, motion: Motion) -> list[Block]:
        return [
            Block(j, np.array([k]), self.column(motion, j)[:, None]) for k, j in enumerate(self.joints)
        ]


#: Velocity [rad/s, m/s] over which the sign of a velocity is smoothed.
SIGN_WIDTH = 0.01


def smooth_sign(velocity: Array, width: float = SIGN_WIDTH) -> Array:
    """tanh(dq / width): the sign of a velocity whose value near zero is noise [-]."""
    return np.tanh(velocity / width)


def velocity_unit(robot: Robot, joint: int) -> str:
    return f"{robot.position_units[joint]}/s"


def position_unit(robot: Robot, joint: int) -> str:
    return robot.position_units[joint]
