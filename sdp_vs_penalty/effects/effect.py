"""What an effect is: one physical cause of joint torque, linear in its parameters.

tau_j(t) = sum over effects of Y_e,j(t) theta_e. The columns Y_e come from the motion and, where an
effect needs a torque (a gain, load friction), from the current model's prediction, never from the
measured channel: that would explain itself.

A file in this folder that defines a subclass of :class:`Effect` is its registration.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot import Robot

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
class Motion:
    """A motion sampled uniformly: t (N,) s; q, dq, ddq (N, n); torque (N, n) of the current model."""

    t: Array
    q: Array
    dq: Array
    ddq: Array
    torque: Array | None = None


@dataclass(frozen=True)
class Block:
    """Columns (N, k) of the torque on one joint, and which k of the effect's parameters they meet."""

    joint: int
    parameters: NDArray[np.intp]
    columns: Array


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

    def __init__(self, robot: Robot, joints: Sequence[int] | None = None, **shape: float) -> None:
        self.robot = robot
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
        self.shape: dict[str, float] = {**self.shape_defaults, **shape}

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """The effect's own part of theta."""

    @abstractmethod
    def blocks(self, motion: Motion) -> list[Block]:
        """The columns, joint by joint; joints without torque from this effect may be left out."""

    def to_dict(self) -> dict[str, object]:
        joints = None if self.asked_joints is None else [j + 1 for j in self.asked_joints]
        return {"effect": self.name, "joints": joints, "shape": dict(self.shape)}


class JointEffect(Effect):
    """An effect with one column a joint, on that joint's own torque."""

    #: Prefix of the parameter's name: symbol "f_v" gives f_v1 ... f_vn.
    symbol: ClassVar[str]
    #: "torque per ...": the unit for a revolute and for a prismatic joint.
    units: ClassVar[tuple[str, str]]
    #: Lower bound of the parameter: 0 where physics fixes the sign.
    lower: ClassVar[float] = -np.inf

    @abstractmethod
    def column(self, motion: Motion, joint: int) -> Array:
        """The (N,) column of the torque on ``joint`` (from 0)."""

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

    def blocks(self, motion: Motion) -> list[Block]:
        return [
            Block(j, np.array([k]), self.column(motion, j)[:, None]) for k, j in enumerate(self.joints)
        ]


def smooth_sign(velocity: Array, width: float) -> Array:
    """tanh(dq / width): the sign of a velocity whose value near zero is noise [-]."""
    return np.tanh(velocity / width)
