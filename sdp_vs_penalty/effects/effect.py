"""The base classes of effects: one physical cause of joint torque each, linear in its
parameters.

tau_j(t) = sum over effects of Y_e,j(t) theta_e. The columns Y_e come from the motion.
Where an effect needs a torque (a gain, load friction), they come from the prediction of
the current model with what was found so far, never from the measured channel: that
would explain itself.

A subclass of :class:`Effect` with an equation, in a file of this folder, is thereby
registered.
"""

from __future__ import annotations

import re
from abc import ABC
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import ClassVar, Literal, NamedTuple, Self

import numpy as np

from sdp_vs_penalty.effects.motion import SIGN_WIDTH as SIGN_WIDTH
from sdp_vs_penalty.effects.motion import CurrentModel as CurrentModel
from sdp_vs_penalty.effects.motion import Motion as Motion
from sdp_vs_penalty.effects.motion import Sampling as Sampling
from sdp_vs_penalty.effects.motion import smooth_sign as smooth_sign
from sdp_vs_penalty.effects.shape import ShapeConstant
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask
from sdp_vs_penalty.robot.constraint import Constraint
from sdp_vs_penalty.robot.robot import Robot


@dataclass(frozen=True)
class Parameter:
    """One entry of theta."""

    #: Name, such as "f_v3".
    name: str
    #: Unit, such as "N*m*s/rad".
    unit: str
    #: Name of the parameter's effect.
    effect: str
    #: Number of the joint, from 1; 0 for the whole robot.
    joint: int
    #: Lower bound, 0 where physics fixes the sign.
    lower: float = -np.inf


@dataclass(frozen=True)
class Block:
    """Columns (N, k) of the regressor of one joint's torque."""

    #: Number of the joint, from 0.
    joint: int
    #: (k,) places of the columns' parameters among those of the effect.
    parameters: Indices
    #: (N, k) torque [N m, N] from one unit of each parameter.
    columns: Array


#: Largest |theta|, in SI units, of friction, offsets and other parameters that are no
#: link's, on a robot without a link longer than _USUAL_LINK [m].
PARAMETER_RANGE = 1e4
_USUAL_LINK = 1.5


#: Where simulators' files hold an effect: links, a payload, numbers of a joint, its
#: servo. "mjcf" is an attribute that MuJoCo alone has; "formulas" is C code that
#: computes the torque from one instant.
SimulatorField = Literal[
    "",
    "links",
    "payload",
    "damping",
    "friction",
    "armature",
    "stiffness",
    "offset",
    "servo",
    "mjcf",
    "formulas",
]
#: Those that hold one number a joint, the same for every simulator.
JOINT_FIELDS: tuple[SimulatorField, ...] = (
    "damping",
    "friction",
    "armature",
    "stiffness",
    "offset",
)


class SimulatorTerm(NamedTuple):
    """A number that an effect adds to simulators' files."""

    #: One of ``JOINT_FIELDS``; "mjcf" for an attribute that MuJoCo alone has.
    field: SimulatorField
    #: Number of the joint, from 0; -1 for the whole robot.
    joint: int
    #: The number, in SI units; those of all effects for one field, or one attribute of an
    #: "mjcf" term, add up.
    value: float
    #: Element and attribute of an "mjcf" term, such as "option" and "viscosity"; the
    #: element is the joint, its actuator, or the option. It replaces what a field writes
    #: there ("damping"), and is replaced by a channel's gain (a motor's "gear").
    attribute: tuple[Literal["joint", "actuator", "option"], str] = ("joint", "")


#: From this share of rows at standstill on, the friction that holds a joint shows.
STANDS = 0.02


@dataclass(frozen=True)
class JointCoverage:
    """What runs show of a joint."""

    #: Distance between the joint's lowest and highest position [rad, m].
    travel: float = np.inf
    #: Smallest step of the joint's positions [rad, m].
    resolution: float = 0.0
    #: Share of the samples in which the joint stands still, 0 to 1.
    stands: float = 0.0
    #: Lowest position of the joint [rad, m].
    lowest: float = -np.inf
    #: Highest position of the joint [rad, m].
    highest: float = np.inf
    #: Time from sample to sample [s].
    step: float = 0.0


class Effect(ABC):
    """One effect on the joints it is given (from 0), with its shape constants fixed.

    Subclasses set the class attributes, which the command line and the README show.
    They define :meth:`parameter_names_and_units` and :meth:`torques`, or
    :attr:`parameters` and :meth:`blocks`. Everything that anyone asks of an effect is
    declared here: nothing outside this folder knows an effect or a shape constant by
    its name.

    Attributes
    ----------
    equation, explanation, reference : str
        The law, what it is on the arm in a sentence or two, and where it is from.
    symbol, units : str, (str, str)
        Prefix of the parameters' names, which no other effect has, and their unit on a
        revolute and on a prismatic joint.
    lower, range : float
        Least value of a parameter (0 where physics fixes the sign), and largest size, in
        ``units``.
    usual : (float, float), optional
        Size on machines as they are built, on a revolute and a prismatic joint, in
        ``units``: a standard deviation about zero.
    shapes : mapping of str to ShapeConstant
        Constants on which the columns depend non-linearly.
    needs_links, needs_torque, needs_temperature, needs_command, needs_motors : bool
        Which fields of :class:`Motion` the columns read beside t, q, dq and ddq.
    has_memory, follows_clock : bool
        Whether a column depends on earlier motion, or on the time of day.
    whole_robot, joins, several : bool
        One parameter for the robot; one for the effect's joints together; several of it
        on one joint, with other shape constants.
    sought, frozen_only : bool
        Whether a diagnosis tries it; only beside links that are held fixed.
    refines, generalises, resembles : tuple of str
        Effects of which it is a finer form; that it holds as special cases; that no log
        tells from it.
    forward : {"torque", "channel", "drive", "left out"}
        What it is when the model runs forward; ``at_rest`` what it does as dry friction.
    signless, smooth : bool
        Whether no column turns with a velocity's sign; whether columns are products of
        states and sines, as the links' are.
    """

    #: That of the class, in snake case.
    name: ClassVar[str]
    equation: ClassVar[str]
    explanation: ClassVar[str]
    reference: ClassVar[str]
    #: Its name within a sentence; that of the class in words.
    in_words: ClassVar[str]
    #: What it is on the arm, for a mechanical engineer; ``plain_words`` says which
    #: fields it may have.
    on_the_arm: ClassVar[str] = ""
    #: The same where torques are in a unit of the drives, such as A; "": no other.
    on_the_arm_unscaled: ClassVar[str] = ""
    #: The cause against which a person sees its torque in a log: "velocity", "position",
    #: "load", "time", "reversal"; "" where no single one shows it.
    seen_against: ClassVar[str] = ""
    #: What a simulator's file calls its parameters; "" where it has no place for them,
    #: or several (:meth:`simulator_terms`).
    simulator_field: ClassVar[SimulatorField] = ""
    #: A second statement of the law, for simulated worlds: the torque (N,) at size 1 of
    #: (motion, joint from 0, sign of its velocity (N,), shape constants by name). It
    #: uses NumPy and its arguments alone, so that worlds share nothing with columns; of
    #: the motion t, q, dq and ddq, which is all that a world has.
    hidden_torque: ClassVar[Callable[..., Array] | None] = None
    #: Non-linear shape constants by name; an object's own may be more or fewer than its
    #: class's.
    shapes: Mapping[str, ShapeConstant] = {}

    #: True where a column depends on earlier motion: it is then computed over whole
    #: runs.
    has_memory: bool = False
    #: True where the columns follow the time of day rather than the motion: what
    #: repeats is no proof.
    follows_clock: bool = False
    #: True where the columns need Motion.torque.
    needs_torque: bool = False
    #: True where the columns need Motion.current, the links of the current model.
    needs_links: ClassVar[bool] = False
    #: True where the columns need Motion.temperature.
    needs_temperature: bool = False
    #: True where the columns need Motion.command.
    needs_command: ClassVar[bool] = False
    #: True where the columns need Motion.motors.
    needs_motors: ClassVar[bool] = False

    #: When the model runs forward: a torque, the measuring channel's (:meth:`invert_channel`),
    #: what drives the joints, or nothing.
    forward: ClassVar[Literal["torque", "channel", "drive", "left out"]] = "torque"

    #: True where one parameter acts on the whole robot: no joints to choose from.
    whole_robot: ClassVar[bool] = False
    #: True where the links absorb the effect, so that it shows only against a model
    #: held fixed.
    frozen_only: ClassVar[bool] = False
    #: False where a search never tries it.
    sought: ClassVar[bool] = True
    #: True where only those few of its starts are tried whose torque on their own joint
    #: stands out of what the model leaves (:meth:`own_columns`).
    starts_stand_out: ClassVar[bool] = False
    #: True where a joint can have it several times, with other shape constants.
    several: ClassVar[bool] = False
    #: True where its joints belong together: one parameter acts on all of them.
    joins: ClassVar[bool] = False
    #: What dry friction does at rest by this law: "holds" (tried where joints stand) or
    #: "turns" round.
    at_rest: ClassVar[Literal["", "holds", "turns"]] = ""
    #: Effects of which this one is a finer form: it is looked for only where one of
    #: them is known.
    refines: tuple[str, ...] = ()

    #: Effects that are this one with some parameters at zero (or a combination of
    #: them): where one of these fits as well, this one adds nothing.
    generalises: tuple[str, ...] = ()

    #: Whether its law stands in for another one, so that other motion need not follow
    #: it.
    is_stand_in: bool = False

    #: True where the torque has a constant part (a spring's rest position): it may stand
    #: for an offset of the torque.
    has_constant_part: ClassVar[bool] = False

    #: Effects whose torque is nearly this one's on any motion: no log tells them apart.
    resembles: tuple[str, ...] = ()

    #: Effects that have the same law over another travel, each with the name that this
    #: travel has among the shape constants of both.
    same_law_as: ClassVar[Mapping[str, str]] = {}

    #: The effect whose shape constants it has as well, without any of its own.
    shape_of: ClassVar[str] = ""

    #: |theta| stays below this, in SI units.
    range: ClassVar[float] = PARAMETER_RANGE
    #: Standard deviation about zero of each parameter on machines as they are built, on
    #: a revolute and a prismatic joint; None: nothing is known but that it makes no
    #: more torque than its joint has.
    usual: ClassVar[tuple[float, float] | None] = None
    #: Which parameters say how large the effect is: their norm, or the value of a
    #: single one.
    sized_by: ClassVar[slice] = slice(None)
    #: True where these parameters act side by side, so that their sum is the size.
    sizes_add_up: ClassVar[bool] = False
    #: The shape constant that is as large as the effect itself, and follows it (a
    #: delay's).
    sized_shape: ClassVar[str] = ""
    #: The shape constant over which it turns round as the model's dry friction does.
    width_shape: ClassVar[str] = ""
    #: Kinds of fault of a log, in the words of `check`, that make the same torque.
    faults: ClassVar[tuple[str, ...]] = ()
    #: True where no column holds the sign of a velocity: nothing of it is particular to
    #: reversals, and what looks like it there alone is dry friction's own error.
    signless: ClassVar[bool] = False
    #: True where columns are at most products of states with sines of positions, as the
    #: links' are.
    smooth: ClassVar[bool] = False

    def __init__(
        self, robot: Robot, joints: Sequence[int] | None = None, **shape: float
    ) -> None:
        """Check the joints and shape constants, and fill in the defaults of those not
        given.

        Parameters
        ----------
        joints : sequence of int, optional
            Joints from 0 on which the effect acts; None for all.
        **shape : float
            Values of shape constants (numbers on which the columns depend
            non-linearly), by name.

        Raises
        ------
        InputError
            A joint or shape constant that does not exist, or a value out of its range.
        """
        self.robot = robot
        if self.whole_robot and joints is not None:
            raise InputError(
                f"effect {self.name} acts on the whole robot", "write it without joints"
            )
        self.joints = (
            tuple(range(robot.n)) if joints is None else tuple(sorted(set(joints)))
        )
        #: The shape constants that were given, which nothing estimates anew.
        self.given = frozenset(shape)
        #: Which joints were asked for; None means all, and is how the effect is written
        #: down.
        self.asked_joints = None if joints is None else self.joints
        for j in self.joints:
            if not 0 <= j < robot.n:
                raise InputError(
                    f"effect {self.name}: joint {j + 1} does not exist, the robot has"
                    f" {robot.n}",
                    f"choose from 1 to {robot.n}",
                )
        for key, value in shape.items():
            if key not in self.shapes:
                known = ", ".join(self.shapes) or "none"
                raise InputError(
                    f"effect {self.name}: no shape constant {key!r} (it has: {known})",
                    "leave it out, or correct its name",
                )
            complaint = self.shapes[key].complaint(value)
            if complaint is not None:
                raise InputError(
                    f"effect {self.name}: shape constant {key} {complaint}",
                    "correct it, or leave it out",
                )
        self.shape: dict[str, float] = {
            k: s.default for k, s in self.shapes.items()
        } | shape
        self.settle()

    def settle(self) -> None:  # noqa: B027 (nothing to work out, for most)
        """Work out what follows from joints and shape constants, which are checked."""

    def with_shape(
        self, joints: Sequence[int] | None = None, /, **shape: float
    ) -> Effect:
        """Return a copy of the effect with other shape constants, or on some of the
        joints.

        Parameters
        ----------
        joints
            Joints from 0; None keeps those of this effect.
        shape
            New values of shape constants, by name. The others stay.

        Returns
        -------
        Effect
            A new effect of the same class.
        """
        joints_of_result = self.asked_joints if joints is None else joints
        return type(self)(self.robot, joints_of_result, **{**self.shape, **shape})

    def __init_subclass__(cls) -> None:
        """Name each effect after its class: ViscousFriction is "viscous_friction", in
        words "viscous friction"."""
        if "equation" in vars(cls) and "name" not in vars(cls):
            cls.name = re.sub("(?<!^)(?=[A-Z])", "_", cls.__name__).lower()
        if "equation" in vars(cls) and "in_words" not in vars(cls):
            cls.in_words = cls.name.replace("_", " ")

    #: Lower bound of the parameters: 0 where physics fixes the sign.
    lower: ClassVar[float] = -np.inf
    #: Prefix of the parameters' names: symbol "f_v" gives f_v1 ... f_vn.
    symbol: ClassVar[str]
    #: The parameters' unit for a revolute and for a prismatic joint.
    units: ClassVar[tuple[str, str]] = ("N*m", "N")

    def parameter_names_and_units(self, joint: int) -> Iterable[tuple[str, str]]:
        """Name the parameters of one joint.

        Parameters
        ----------
        joint
            The joint from 0; -1 stands for the whole robot.

        Returns
        -------
        Iterable of (str, str)
            Name and unit of each parameter.
        """
        return [(self.parameter_name(joint), self.unit_on(joint))]

    def parameter_name(self, joint: int) -> str:
        """Return the name of the parameter on one joint.

        Parameters
        ----------
        joint
            The joint from 0; -1 stands for the whole robot.

        Returns
        -------
        str
            The symbol of the effect, with the joint's number from 1.
        """
        return f"{self.symbol}{joint + 1}" if joint >= 0 else self.symbol

    def unit_on(self, joint: int) -> str:
        """Return the parameter's unit on one joint, with these shape constants.

        Parameters
        ----------
        joint
            Number of the joint, counted from 0.

        Returns
        -------
        str
            The unit, such as "N*m s/rad".
        """
        return self.units[self.robot.joints[joint].kind == "prismatic"]

    @property
    def is_dry_friction(self) -> bool:
        """Whether it is a law of dry friction, which holds any torque while a joint
        stands: by default a finer one of the joint's own."""
        return "coulomb_friction" in self.refines

    @property
    def law_constants(self) -> dict[str, float]:
        """The shape constants, by name, that only take a few given values: which of its
        laws the effect has."""
        constants = self.shapes
        return {name: x for name, x in self.shape.items() if constants[name].choices}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The effect's parameters, its part of theta: joint by joint, or once for the
        whole robot."""
        return self._parameters

    @cached_property
    def _parameters(self) -> tuple[Parameter, ...]:
        """What ``parameters`` returns, made once."""
        joints = (-1,) if self.whole_robot else self.joints
        return tuple(
            Parameter(name, unit, self.name, j + 1, self.lower)
            for j in joints
            for name, unit in self.parameter_names_and_units(j)
        )

    def torques(self, motion: Motion) -> Array:
        """Compute the torque on every joint from one unit of each parameter.

        Parameters
        ----------
        motion
            The motion at N instants.

        Returns
        -------
        Array
            (N, n, k) torque [N m, N] on n joints for k parameters.
        """
        raise NotImplementedError

    def blocks(self, motion: Motion) -> list[Block]:
        """Compute the columns of the regressor, joint by joint.

        Parameters
        ----------
        motion
            The motion at N instants.

        Returns
        -------
        list of Block
            Joints without torque from this effect may be left out.
        """
        indices = np.arange(len(self.parameters))
        torques = self.torques(motion)
        return [Block(j, indices, torques[:, j]) for j in range(self.robot.n)]

    def same_columns(self, other: Effect) -> bool:
        """Tell whether two effects certainly have the same columns on every motion.

        That holds for the same object, and for effects of one class with the same
        robot, joints and shape constants. An effect that holds further data, such as a
        measured table, equals itself only.

        Parameters
        ----------
        other
            The effect to compare with.

        Returns
        -------
        bool
            True if the columns are certainly the same.
        """
        if self is other:
            return True
        is_same_class = type(self) is type(other) and self.robot is other.robot
        has_no_more_data = type(self).__init__ is Effect.__init__
        if not is_same_class or not has_no_more_data:
            return False
        return self.joints == other.joints and self.shape == other.shape

    def torque(self, theta: Array, motion: Motion) -> Array:
        """Compute the torque that this effect makes: Y(motion) theta.

        Parameters
        ----------
        theta
            (k,) parameters of this effect.
        motion
            The motion at N instants.

        Returns
        -------
        Array
            (N, n) torque [N m, N].
        """
        out = np.zeros_like(motion.q)
        for block in self.blocks(motion):
            out[:, block.joint] += block.columns @ theta[block.parameters]
        return out

    @classmethod
    def own_columns(cls, forms: Sequence[Self], motion: Motion) -> Array:
        """Compute the columns (N, k K) that K forms of this effect have in the torque of
        their first joint, form by form, for a search that looks at that joint alone.

        A class may override it where these columns are quicker to make than those of
        all joints.

        Parameters
        ----------
        forms
            The effect on the same joints with several values of its shape constants.
        motion
            The motion at N instants.
        """
        return np.hstack(
            [
                block.columns
                for form in forms
                for block in form.blocks(motion)
                if block.joint == form.joints[0]
            ]
        )

    # What is known of the parameters before anything is measured.

    def constraints(
        self, indices: Indices, parameters: Sequence[Parameter] = ()
    ) -> list[Constraint]:
        """State what is demanded of the parameters: the sign and the range of each.

        Parameters
        ----------
        indices
            (k,) places of this effect's parameters in theta.
        parameters
            All of theta, for an effect that is tied to others.

        Returns
        -------
        list of Constraint
            Linear or semidefinite constraints F(theta) >= 0.
        """
        out = []
        for index, parameter in zip(indices, self.parameters, strict=True):
            name = f"{self.name} {parameter.name}"
            if np.isfinite(parameter.lower):
                out.append(
                    build.linear("sign", name, [index], [[1.0]], [-parameter.lower])
                )
            # Two rows: theta + largest >= 0 and largest - theta >= 0.
            largest = self.largest_parameter
            out.append(
                build.linear("range", name, [index], [[1.0, -1.0]], [largest, largest])
            )
        return out

    @property
    def largest_parameter(self) -> float:
        """Upper bound of |theta| in SI units.

        It is the class's range, times (longest link / 1.5 m)^4 for robots with a link
        that is longer: torques grow with the fourth power of the length. A long chain
        of short links keeps the range. Bounds that are too wide make its lower bound of
        the optimum loose.
        """
        longest = float(np.max(self.robot.link_reach()))
        return self.range * max(1.0, longest / _USUAL_LINK) ** 4

    @property
    def nominal(self) -> Array:
        """(k,) plausible parameters to start a solver from.

        They lie strictly inside the constraints other than bounds, such as a body's
        positive definite inertia. Here zeros: this effect has no such constraints.
        """
        return np.zeros(len(self.parameters))

    @property
    def plausible(self) -> Array | None:
        """(k,) prior standard deviations of the parameters about zero, in SI units;
        None where nothing is known.

        They enter every fit as k further observations (theta = 0). A prismatic joint
        has another value than a revolute one.
        """
        if self.usual is None:
            return None
        on_revolute, on_prismatic = self.usual
        kinds = [self.robot.joints[p.joint - 1].kind for p in self.parameters]
        is_prismatic = [kind == "prismatic" for kind in kinds]
        return np.where(is_prismatic, on_prismatic, on_revolute)

    def as_sized(self, size: float) -> float:
        """Return the shape constant ``sized_shape`` that follows from the size of the
        effect; here the size itself, such as a delay that is found as the parameter
        T_d.

        Parameters
        ----------
        size
            The size that was found, as ``sized_by`` measures it.

        Returns
        -------
        float
            The value of the constant.
        """
        return size

    def invert_channel(self, theta: Array, t: Array, torque: Array) -> Array:
        """Recover the true torque from what the torque channels read.

        Parameters
        ----------
        theta
            (k,) parameters of this effect.
        t
            (N,) instants of the torque's rows [s].
        torque
            (N, n) what the channels read [N m, N].

        Returns
        -------
        Array
            (N, n) torque on the joints [N m, N].
        """
        return torque

    def simulator_terms(self, theta: Array) -> Iterable[SimulatorTerm]:
        """List the numbers by which simulators' files hold the effect's whole torque;
        nothing where they cannot. Their fields are the same for all parameters: those at
        zeros decide which files hold the effect.

        Parameters
        ----------
        theta
            (k,) parameters of this effect.

        Returns
        -------
        Iterable of SimulatorTerm
            By default each parameter in the joint's ``simulator_field``.
        """
        if self.simulator_field not in JOINT_FIELDS:
            return []
        return [
            SimulatorTerm(self.simulator_field, parameter.joint - 1, value)
            for parameter, value in zip(self.parameters, theta.tolist(), strict=True)
        ]

    @property
    def contact(self) -> Array | None:
        """(n,) ratios c of the joints if the effect is dry friction along a combination
        c q of joints, so that a simulation lets it stick; None for all other effects,
        as here."""
        return None

    # What a search asks.

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        """List the shape constants with which a search begins on one joint.

        Parameters
        ----------
        robot
            The robot that the search is for.
        joint
            Number of the joint, counted from 0.

        Returns
        -------
        Iterable of dict
            Values by name; empty where the effect cannot act.
        """
        if not cls.sought:
            return []
        kind = robot.joints[joint].kind
        grids = {
            key: shape.on(kind).grid for key, shape in cls.shapes.items() if shape.grid
        }
        return [
            dict(zip(grids, values, strict=True)) for values in product(*grids.values())
        ]

    @classmethod
    def candidates(
        cls, robot: Robot, joint: int | None, start: float = 0.0, **constants: float
    ) -> list[Effect]:
        """List the forms of the effect that a search tries.

        Parameters
        ----------
        robot
            The robot that the search is for.
        joint
            The joint from 0; None stands for the whole robot.
        start
            First instant of the measurements [s].
        constants
            Shape constants that stay as they are given.

        Returns
        -------
        list of Effect
            One effect for each set of shape constants of :meth:`starts`.
        """
        clock = {
            key: start for key, shape in cls.shapes.items() if shape.role == "clock"
        }
        joints = None if joint is None else [joint]
        return [
            cls(robot, joints, **{**clock, **shape, **constants})
            for shape in cls.starts(robot, joint or 0)
        ]

    @property
    def searched(self) -> tuple[str, ...]:
        """Names of the shape constants that measurements can determine.

        The clock's reading at which time begins is taken from the file instead.
        """
        return tuple(key for key, shape in self.shapes.items() if shape.role != "clock")

    @property
    def estimated(self) -> tuple[str, ...]:
        """Names of the shape constants that `identify` estimates from the data (role
        "estimated"); `diagnose` searches all others too."""
        return tuple(
            key for key, shape in self.shapes.items() if shape.role == "estimated"
        )

    def with_free_shapes(self, keys: Iterable[str]) -> Effect:
        """Return a copy of the effect in which some shape constants are estimated
        again.

        Parameters
        ----------
        keys
            Names of the constants that are no longer given.

        Returns
        -------
        Effect
            A copy of this effect.
        """
        out = copy(self)
        out.given = self.given - frozenset(keys)
        return out

    # What a reader sees.

    def outside(self, motion: Motion) -> Mask:
        """Tell where a motion leaves the range in which the effect is known.

        Parameters
        ----------
        motion
            The motion at N instants.

        Returns
        -------
        NDArray
            (N,) flags; all False, for only measured tables have such a range.
        """
        return np.zeros(len(motion.t), bool)

    @property
    def constants(self) -> str:
        """The shape constants that measurements can determine, as text for sentences:
        "vs = 0.1 rad/s, delta = 4 (an end of its range)". Units are those of the
        effect's first joint."""
        kind = self.robot.joints[self.joints[0]].kind
        texts = []
        for key in self.searched:
            value, constant = self.shape[key], self.shapes[key]
            ends = " (an end of its range)" * constant.is_at_end(value, kind)
            texts.append(f"{key} = {constant.format_with_unit(value, kind)}{ends}")
        return ", ".join(texts)

    def remark(self, size: float) -> str:
        """Say what is worth knowing about an effect of this size.

        Parameters
        ----------
        size
            The size that was found.

        Returns
        -------
        str
            A sentence for users; empty for none.
        """
        return ""

    def contradicts_itself(self, theta: Array, mean_inertia: float) -> bool:
        """Return whether no machine has such an effect, because its parameters and its
        shape constants do not belong together.

        Parameters
        ----------
        theta
            (p,) parameters of the effect that was found, in SI units.
        mean_inertia
            Of its joint in the current model [kg m^2, kg]; NaN where that is unknown.
        """
        return False

    def resembles_over(self, coverage: JointCoverage) -> tuple[str, ...]:
        """Return the names of effects with nearly this one's torque over what a joint
        covered; by default those on any motion (:attr:`resembles`).

        Parameters
        ----------
        coverage
            Travel, resolution and standstills of its joint in the runs.
        """
        return self.resembles

    def looks_like(self, size: float, coverage: JointCoverage) -> str:
        """Give a reason to doubt the effect: what else would look like it in these
        measurements.

        Parameters
        ----------
        size
            Size of the effect that was found; 0 where it is asked before a fit.
        coverage
            Travel, resolution and standstills of its joint in the runs.

        Returns
        -------
        str
            The reason, empty where there is none.
        """
        return ""

    @property
    def text(self) -> str:
        """The effect as the command line takes it, with joints from 1 and shape
        constants: "viscous_friction:2+3", "stribeck_friction@vs=0.1"."""
        text = self.name
        if self.asked_joints is not None:
            text += ":" + "+".join(str(j + 1) for j in self.joints)
        for key, value in self.shape.items():
            text += f"@{key}={self.shapes[key].written(value)}"
        return text

    @property
    def brief(self) -> str:
        """The effect as reports show it: its text on the command line; a measured table
        is shortened."""
        return self.text

    @property
    def entry(self) -> EffectEntry:
        """What files hold of the effect."""
        joints = None
        if self.asked_joints is not None:
            joints = tuple(int(j) + 1 for j in self.asked_joints)
        return EffectEntry(self.name, joints, dict(self.shape))


@dataclass(frozen=True)
class EffectEntry(JsonRecord):
    """What files hold of an effect; :func:`~sdp_vs_penalty.effects.make_effect` makes it
    again."""

    #: Name of the effect, as `list effects` has it.
    effect: str
    #: Numbers of the joints, from 1; None for all joints.
    joints: tuple[int, ...] | None
    #: Shape constants of the effect by name.
    shape: Mapping[str, float]


def follows_alone(effect: Effect, signal: Literal["q", "dq"]) -> bool:
    """Tell whether an effect's torque depends on the positions alone, or on the
    velocities alone.

    The columns are computed at random states of this signal, with two values of time and
    of all other signals: they have to be equal.

    Parameters
    ----------
    signal
        "q" for positions, "dq" for velocities.

    Returns
    -------
    bool
        True as well where the torque is constant.
    """
    needs_model = effect.needs_torque or effect.needs_links
    needs_channel = (
        effect.needs_temperature or effect.needs_command or effect.needs_motors
    )
    if needs_model or needs_channel or effect.has_memory:
        return False
    values = np.random.default_rng(0).normal(size=(3, effect.robot.n))

    def blocks_at(value_of_others: float) -> list[Block]:
        """Compute the columns at three random values of the signal."""
        others = np.full_like(values, value_of_others)
        return effect.blocks(
            Motion(
                t=others[:, 0],
                q=values if signal == "q" else others,
                dq=values if signal == "dq" else others,
                ddq=others,
            )
        )

    pairs = zip(blocks_at(0.0), blocks_at(0.7), strict=True)
    return all(np.array_equal(a.columns, b.columns) for a, b in pairs)


class JointEffect(Effect):
    """An effect with one column a joint, or several, on that joint's own torque."""

    def column(self, motion: Motion, joint: int) -> Array:
        """Compute the column of the torque on one joint.

        Parameters
        ----------
        motion
            The motion at N instants.
        joint
            Number of the joint, counted from 0.

        Returns
        -------
        Array
            (N,) or, for k parameters a joint, (N, k).
        """
        raise NotImplementedError

    def blocks(self, motion: Motion) -> list[Block]:
        """Compute the columns of the regressor: one block (N, k) for each of the
        effect's joints."""
        return self.blocks_per_joint([self.column(motion, j) for j in self.joints])

    def blocks_per_joint(self, columns: Sequence[Array]) -> list[Block]:
        """Turn the columns of each joint into blocks, and number their parameters
        consecutively.

        Parameters
        ----------
        columns
            (N,) or (N, k) columns of each of the effect's joints.

        Returns
        -------
        list of Block
            One block for each joint of the effect.
        """
        blocks = list[Block]()
        first_parameter = 0
        for joint, values in zip(self.joints, columns, strict=True):
            joint_columns = values.reshape(len(values), -1)  # (N, k)
            end = first_parameter + joint_columns.shape[1]
            blocks.append(Block(joint, np.arange(first_parameter, end), joint_columns))
            first_parameter = end
        return blocks
