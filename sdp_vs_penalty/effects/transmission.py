"""Effects by which joints act on each other through their gears."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations, product

import numpy as np

from sdp_vs_penalty.effects.bristles import (
    Bristles,
    PreslidingHysteresis,
    StatefulEffect,
    dahl,
)
from sdp_vs_penalty.effects.effect import Array, Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.partner import WithPartner
from sdp_vs_penalty.effects.shape import ShapeConstant, choice
from sdp_vs_penalty.effects.velocity_friction import StribeckFriction
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.robot import Robot


class JointCoupling(WithPartner):
    equation = (
        "f_c times dq_i | sign(dq_i) | sign(dq_j + dq_i) | sign(dq_j - dq_i), for form"
        " = 1 | 2 | 3 | 4"
    )
    explanation = (
        "The motion of joint i causes a torque on joint j, like friction in wrists"
        " whose motors sit one link further back and drive through each other's gears."
        " i counts from 1; 0 means the previous joint (the next one for joint 1)."
    )
    on_the_arm = (
        "{joint} is dragged along when {other} moves ({size}), as where one motor "
        "drives through the other's gear"
    )
    reference = (
        "Janot, Vandanjon, Gautier, IEEE TCST 2014 (Staubli TX40: joints 5 and 6)"
    )
    symbol = "f_c"
    several = True
    shapes = {"i": ShapeConstant(0.0, signed=True), "form": choice(count=4)}

    @property
    def is_dry_friction(self) -> bool:
        """Whether its form is one of dry friction."""
        return self.shape["form"] != 1.0

    def parameter_name(self, joint: int) -> str:
        """Name the parameter after joint, partner and form: "f_c5_6_2"."""
        return f"{super().parameter_name(joint)}_{self.shape['form']:g}"

    def unit_on(self, joint: int) -> str:
        """Return the unit: of a torque, or, for the viscous form 1, of a torque over
        the partner's velocity."""
        torque = super().unit_on(joint)
        if self.shape["form"] != 1.0:
            return torque
        return f"{torque}*s/{self.robot.position_units[self.partner(joint)]}"

    def column(self, motion: Motion, joint: int) -> Array:
        """Return the column (N,): the partner's velocity or its sign, or the sign of
        the sum or difference of both velocities."""
        partner = self.partner(joint)
        form = int(self.shape["form"])
        if form == 1:  # viscous
            return motion.dq[:, partner]
        if form == 2:  # dry, along the partner's motion
            return motion.sign(partner)
        # Dry, along the sum (form 3) or the difference (form 4) of both motions.
        ratios = np.zeros(self.robot.n)
        ratios[joint] = 1.0
        ratios[partner] = 1.0 if form == 3 else -1.0
        return motion.sign_along(ratios, motion.width(joint))


class ElasticCoupling(Effect):
    equation = "tau = K q, K symmetric, on the joints that a spring couples"
    explanation = (
        "A spring that joints share: a belt, a cable or a balance spring that runs over"
        " both. A spring stores energy, so one stiffness couples two joints in both"
        " directions; the others are what it holds each joint with. Its rest position"
        " appears as part of the offsets. Without joints, the last two."
    )
    on_the_arm = (
        "{joint} pull each other as by a spring of {size}: a belt, a cable or a "
        "balance spring that runs over both"
    )
    seen_against = "position"
    has_constant_part = True
    reference = "Hogan, ASME J. Dynamic Systems, Measurement, and Control 1985, part I"
    joins = True
    signless = True
    generalises = ("joint_spring",)

    def settle(self) -> None:
        """Choose the joints (from 0) that the spring couples; default: the last two."""
        if self.asked_joints is None:
            self.joints = self.joints[-2:]

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """The joints (i, j) of each stiffness: those between two joints first, then
        those of each joint by itself."""
        return [*combinations(self.joints, 2), *((j, j) for j in self.joints)]

    @property
    def sized_by(self) -> slice:  # type: ignore[override]
        """Slice of the stiffnesses between two joints; all of them for one joint."""
        n_between = len(self.pairs) - len(self.joints)
        return slice(0, n_between or None)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The stiffnesses, such as "k_c2_3(2+3)" [N m/rad] between joints 2 and 3."""
        coupled = "+".join(str(j + 1) for j in self.joints)
        first = self.joints[0] + 1
        units = [
            f"{self.robot.torque_units[i]}/{self.robot.position_units[j]}"
            for i, j in self.pairs
        ]
        return tuple(
            Parameter(f"k_c{i + 1}_{j + 1}({coupled})", unit, self.name, joint=first)
            for (i, j), unit in zip(self.pairs, units, strict=True)
        )

    def blocks(self, motion: Motion) -> list[Block]:
        """Return for each joint the positions (N, k) by which each stiffness pulls it;
        zero for stiffnesses of other joints."""
        blocks = []
        for joint in self.joints:
            # Stacked, not written into an array: the export to C passes formulas.
            columns = []
            for first, second in self.pairs:
                other = {first: second, second: first}.get(joint)
                zeros = np.zeros(len(motion.t))
                columns.append(zeros if other is None else motion.q[:, other])
            parameters = np.arange(len(self.pairs))
            blocks.append(Block(joint, parameters, np.column_stack(columns)))
        return blocks

    @classmethod
    def candidates(
        cls, robot: Robot, joint: int | None, start: float = 0.0, **constants: float
    ) -> list[Effect]:
        """List the forms that a search tries: a joint (from 0) with the next one.

        Parameters
        ----------
        joint
            The first joint, from 0.
        start, constants
            Not used: there are no shape constants.
        """
        first = joint or 0
        return [cls(robot, [first, first + 1])] if first + 1 < robot.n else []


#: Laws of the torque on an axis: friction by four laws, and inertia. Saved models hold
#: their numbers, in this order from 1.
LAWS = ("viscous", "coulomb", "hysteresis", "stribeck", "inertia")
#: The laws that are linear in the motion.
_LINEAR = ("viscous", "inertia")
#: Ratios of the second joint to the first, and of the second and third to the first.
_PAIRS = (1.0, -1.0, 2.0, -2.0, 0.5, -0.5)
_TRIPLES = tuple(
    (a, b) for size in (1.0, 0.5) for a, b in product((size, -size), repeat=2)
)


class TransmissionFriction(StatefulEffect):
    equation = (
        "c^T f(s), s = c q, f = f_t times ds | sign(ds) | z | sign(ds) exp(-(ds /"
        " vs)^2) | dds, for law = viscous | coulomb | hysteresis | stribeck | inertia;"
        " dz/ds = (1 - z sign(ds)) / d"
    )
    explanation = (
        "A motor that drives through the gears of others (wrists, differentials,"
        " parallelograms) turns with a combination s = c q of joints. Its friction and"
        " its rotor's inertia act on s, and return to the joints by the same ratios"
        " (c^T f, so that power is kept): friction never feeds energy. c5, c6 are the"
        " ratios of joints 5 and 6; without joints, the last two. Viscous friction and"
        " inertia do not show the ratio beside those of the joints: give the known one,"
        " or 1."
    )
    on_the_arm = "the motor that turns {joint} together adds {size} of its own"
    reference = (
        "Janot, Vandanjon, Gautier, IEEE TCST 2014 (TX40); Wang et al., RA-L 2019"
        " (dVRK)"
    )
    symbol = "f_t"
    several = True
    joins = True
    shapes = {
        "law": ShapeConstant(2.0, choices=tuple(range(1, 1 + len(LAWS))), words=LAWS),
        "d": PreslidingHysteresis.shapes["d"],
        "vs": StribeckFriction.shapes["vs"],
    }
    #: The constant that a law alone has (a travel, a velocity), and its values from which
    #: a search starts.
    _OWN = {"hysteresis": ("d", (0.002, 0.01)), "stribeck": ("vs", (0.06, 0.25))}

    def __init__(
        self, robot: Robot, joints: Sequence[int] | None = None, **shape: float
    ) -> None:
        """Declare the shape constants of the chosen law and joints, and check them.

        The effect acts along s = c q. Each joint has a ratio, c5 for joint 5, in units
        of the first joint's position over its own. Only the hysteresis law has a travel
        d, only Stribeck's a velocity vs. Without ``joints`` the effect acts on the last
        two.
        """
        # The last two joints, such as a wrist's, are the default.
        last_two = list(range(max(0, robot.n - 2), robot.n))
        acting_joints = last_two if joints is None else sorted(set(joints))
        # The law, and the constant that it alone has.
        law = self.shapes["law"]
        number_of_law = shape.get("law", law.default)
        constants = {"law": law}
        is_law = law.complaint(number_of_law) is None  # the base class refuses others
        if is_law and (own := self._OWN.get(law.written(number_of_law))):
            key, _ = own
            constants[key] = self.shapes[key]
        # Ratios turn each joint's position into the first one's unit.
        units = [robot.position_units[j] for j in acting_joints if j < robot.n]
        ratios = dict[str, ShapeConstant]()
        for j, unit in zip(acting_joints, units, strict=False):
            unit_of_ratio = "-" if unit == units[0] else f"{units[0]}/{unit}"
            ratios[f"c{j + 1}"] = ShapeConstant(1.0, unit_of_ratio, signed=True)
        # This effect's own constants, before the base class checks the values.
        self.shapes = ratios | constants
        super().__init__(robot, joints, **shape)
        self.joints = tuple(acting_joints)
        self.has_memory = self.law == "hysteresis"
        for j in self.joints:
            if self.shape[f"c{j + 1}"] == 0.0:
                raise InputError(
                    f"effect {self.name}: c{j + 1} is 0", f"leave joint {j + 1} out"
                )

    @property
    def law(self) -> str:
        """Name of the friction law (or "inertia"), by the number that saved models
        hold."""
        return LAWS[int(self.shape["law"]) - 1]

    @property
    def is_dry_friction(self) -> bool:
        """Whether its law is one of dry friction."""
        return self.law not in ("viscous", "inertia")

    @property
    def ratios(self) -> Array:
        """(n,) ratios c of the combination s = c q; zero for joints that take no
        part."""
        ratios = np.zeros(self.robot.n)
        ratios[list(self.joints)] = [self.shape[f"c{j + 1}"] for j in self.joints]
        return ratios

    @property
    def contact(self) -> Array | None:
        """(n,) ratios of the joints along which it is dry friction; None for smooth
        laws and for the hysteresis, which has a state."""
        return self.ratios if self.law in ("coulomb", "stribeck") else None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The effect's one parameter: its size, at least zero, such as
        "f_t_coulomb(q5+q6)" [N m] for law coulomb along q5 + q6."""
        first = self.joints[0]
        position = self.robot.position_units[first]
        torque = self.robot.torque_units[first]
        per_rate = {"viscous": f"*s/{position}", "inertia": f"*s^2/{position}"}
        unit = torque + per_rate.get(self.law, "")
        name = f"{self.symbol}_{self.law}({self.combination})"
        return (Parameter(name, unit, self.name, joint=first + 1, lower=0.0),)

    @property
    def combination(self) -> str:
        """The combination s of the joints as a formula: "q5+q6", "q5-0.5q6"."""
        terms = [
            f"{c:+.4g}q{j + 1}".replace("+1q", "+q").replace("-1q", "-q")
            for j, c in enumerate(self.ratios)
            if c
        ]
        return "".join(terms).removeprefix("+")

    @property
    def bristles(self) -> Bristles:
        """One state of Dahl's law along s = c q for law = hysteresis; no state for
        other laws."""
        rows = (
            self.ratios[None]
            if self.law == "hysteresis"
            else np.zeros((0, self.robot.n))
        )
        return Bristles(rows, np.full(len(rows), self.shape.get("d", 1.0)), dahl)

    def blocks_at(self, motion: Motion, z: Array) -> list[Block]:
        """Return the column c_j f(s) (N, 1) of each joint j, with the force f along
        s = c q that the joints' ratios c_j share out.

        ``z`` (N, 1) is the friction state of the law "hysteresis"; (N, 0) for others.
        """
        force = self._force(motion, z)
        return [
            Block(joint, np.array([0]), (self.ratios[joint] * force)[:, None])
            for joint in self.joints
        ]

    def _force(self, motion: Motion, z: Array) -> Array:
        """Compute f(s) (N,), the force along the combination s = c q per unit of the
        parameter.

        By law: hysteresis z, inertia dds, viscous ds, coulomb sign(ds), stribeck
        sign(ds) exp(-(ds / vs)^2); z (N, 1) is the friction state, used by the
        hysteresis only.
        """
        if self.law == "hysteresis":
            return z[:, 0]
        if self.law == "inertia":
            return motion.ddq @ self.ratios
        ds = motion.dq @ self.ratios
        if self.law == "viscous":
            return ds
        sign = motion.sign_along(self.ratios)
        if self.law == "stribeck":
            return sign * np.exp(-((ds / self.shape["vs"]) ** 2))
        return sign

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        """List the shape constants with which a search begins: every law, with two
        values of its travel or velocity where it has one."""
        for number, law in enumerate(LAWS, start=1):
            if law not in cls._OWN:
                yield {"law": float(number)}
                continue
            key, grid = cls._OWN[law]
            for value in grid:
                yield {"law": float(number), key: value}

    @classmethod
    def candidates(
        cls, robot: Robot, joint: int | None, start: float = 0.0, **constants: float
    ) -> list[Effect]:
        """List the forms that a search tries: every law along every combination of
        joints.

        Parameters
        ----------
        joint
            Joint from 0 with which the combinations begin.
        start
            Not used: no law depends on time.
        constants
            Shape constants that stay as given. Ratios among them (c5, c6) leave one
            combination.

        Returns
        -------
        list of Effect
            One effect for each law and combination that is worth trying.
        """
        given_ratios = {
            int(key[1:]) - 1: ratio
            for key, ratio in constants.items()
            if key.startswith("c")
        }
        ratio_sets = (
            [given_ratios]
            if given_ratios
            else list_joint_combinations(robot, joint or 0)
        )
        shapes = list[dict[str, float]]()
        for start_shape in cls.starts(robot, joint or 0):
            shape = {**start_shape, **constants}
            # A given law leaves out the others; a given d makes its two starts equal.
            if shape["law"] == start_shape["law"] and shape not in shapes:
                shapes.append(shape)
        # Combinations that the user or the robot states; all others are guesses.
        certain = [given_ratios, *map(_nonzero_ratios, robot.couplings)]
        effects = list[Effect]()
        for ratios, shape in product(ratio_sets, shapes):
            if ratios in certain or _worth_a_guess(ratios, shape, constants, certain):
                ratio_constants = {f"c{j + 1}": ratio for j, ratio in ratios.items()}
                effects.append(cls(robot, list(ratios), **{**ratio_constants, **shape}))
        return effects


def _worth_a_guess(
    ratios: Mapping[int, float],
    shape: Mapping[str, float],
    given: Mapping[str, float],
    certain: Sequence[Mapping[int, float]],
) -> bool:
    """Tell whether a law is tried along a combination that is not known of the robot.

    ``ratios`` (by joint from 0) are those of the guess, ``shape`` are its law and
    constants, ``given`` those that the user gave, and ``certain`` the known ratios.

    - On three joints a law with a constant to estimate is not tried: among so many
      combinations one would fit by chance.
    - A linear law (viscous, inertia) adds f c c^T to the damping or mass matrix. The
      joints' own friction and rotors absorb its diagonal, and the other entries do not
      tell the ratios. So only 1 and -1 are tried, and only on joints whose ratios are
      not known.
    """
    has_constant_to_estimate = not set(shape) <= {"law", *given}
    if len(ratios) > 2 and has_constant_to_estimate:
        return False
    if LAWS[int(shape["law"]) - 1] not in _LINEAR:
        return True
    has_known_ratios = any(ratios.keys() == known.keys() for known in certain)
    return not has_known_ratios and all(abs(x) == 1.0 for x in ratios.values())


def list_joint_combinations(robot: Robot, first: int) -> list[dict[int, float]]:
    """List the combinations s = c q of joints along which a gear may have friction.

    First come the couplings that are known of the robot. Then come two or three
    neighbours that are all revolute or all prismatic, with usual ratios c.

    Parameters
    ----------
    first
        The joint from 0 with which a combination begins.

    Returns
    -------
    list of dict
        Ratios by joint from 0, such as [{4: 1.0, 5: -1.0}, ...]; each combination once.
    """
    kinds = [joint.kind for joint in robot.joints]
    candidates = [
        _nonzero_ratios(row)
        for row in robot.couplings
        if np.flatnonzero(row)[0] == first
    ]
    # The first joint has ratio 1; its neighbours have each of the usual ratios.
    pairs = [(1.0, second) for second in _PAIRS]
    triples = [(1.0, second, third) for second, third in _TRIPLES]
    for ratios in (*pairs, *triples):
        end = first + len(ratios)
        are_of_one_kind = len(set(kinds[first:end])) == 1
        if end <= robot.n and are_of_one_kind:
            candidates.append(dict(enumerate(ratios, start=first)))
    without_repetitions = list[dict[int, float]]()
    for candidate in candidates:
        if candidate not in without_repetitions:
            without_repetitions.append(candidate)
    return without_repetitions


def _nonzero_ratios(row: Array) -> dict[int, float]:
    """Return the ratios of a combination (n,) by joint from 0: {4: 1.0, 5: -1.0}."""
    return {int(j): float(row[j]) for j in np.flatnonzero(row)}
