"""What joints have with each other through their gears."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import product

import numpy as np

from sdp_vs_penalty.effects.bristles import (
    Bristles,
    PreslidingHysteresis,
    StatefulEffect,
    dahl,
)
from sdp_vs_penalty.effects.effect import (
    Array,
    Block,
    Effect,
    JointEffect,
    Motion,
    Parameter,
    smooth_sign,
)
from sdp_vs_penalty.effects.shape import ShapeConstant
from sdp_vs_penalty.effects.velocity_friction import StribeckFriction
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.robot import Robot


class JointCoupling(JointEffect):
    equation = (
        "f_c times dq_i | sign(dq_i) | sign(dq_j + dq_i) | sign(dq_j - dq_i), for form"
        " = 1 | 2 | 3 | 4"
    )
    explanation = (
        "The motion of joint i causes a torque on joint j, like friction in wrists"
        " whose motors sit one link further back and drive through each other's gears."
        " i counts from 1; 0 means the previous joint (the next one for joint 1)."
    )
    reference = (
        "Janot, Vandanjon, Gautier, IEEE TCST 2014 (Staubli TX40: joints 5 and 6)"
    )
    symbol = "f_c"
    several = True
    shapes = {
        "i": ShapeConstant(0.0, signed=True),
        "form": ShapeConstant(1.0, choices=(1.0, 2.0, 3.0, 4.0)),
    }

    def __init__(
        self, robot: Robot, joints: Sequence[int] | None = None, **shape: float
    ) -> None:
        super().__init__(robot, joints, **shape)
        i = self.shape["i"]
        if i != int(i) or not 0 <= i <= robot.n:
            raise InputError(
                f"effect {self.name}: i is a joint from 1 to {robot.n}, not {i:g}",
                "name another joint",
            )
        if joints is None:
            self.joints = tuple(j for j in self.joints if j + 1 != i and robot.n > 1)
        elif any(j + 1 == i for j in self.joints) or robot.n < 2:
            raise InputError(
                f"effect {self.name}: a joint cannot be coupled to itself",
                "name another joint as i",
            )

    def partner(self, joint: int) -> int:
        """Return the joint whose motion acts on another joint.

        Parameters
        ----------
        joint
            The joint from 0 that is acted on.

        Returns
        -------
        int
            The partner from 0.
        """
        if self.shape["i"] > 0.0:
            return int(self.shape["i"]) - 1
        return joint - 1 if joint > 0 else 1

    @classmethod
    def starts(
        cls,
        robot: Robot,
        joint: int,
    ) -> Iterable[dict[str, float]]:
        neighbours = [i for i in (joint - 1, joint + 1) if 0 <= i < robot.n]
        forms = cls.shapes["form"].choices
        return [
            {
                "i": float(i + 1),
                "form": form,
            }
            for i in neighbours
            for form in forms
        ]

    def parameter_name(self, joint: int) -> str:
        return (
            f"{self.symbol}{joint + 1}_{self.partner(joint) + 1}_{self.shape['form']:g}"
        )

    def unit_on(self, joint: int) -> str:
        torque = super().unit_on(joint)
        if self.shape["form"] != 1.0:
            return torque
        return f"{torque}*s/{self.robot.position_units[self.partner(joint)]}"

    def column(self, motion: Motion, joint: int) -> Array:
        partner = self.partner(joint)
        form = int(self.shape["form"])
        if form == 1:
            return np.array(motion.dq[:, partner])
        if form == 2:
            return motion.sign(partner)
        other = 1.0 if form == 3 else -1.0
        velocity = motion.dq[:, joint] + other * motion.dq[:, partner]
        rate = motion.ddq[:, joint] + other * motion.ddq[:, partner]
        return smooth_sign(velocity, motion.width(joint), rate, motion.within)


#: What turns with an axis: friction by four laws, and inertia. Their numbers are those
#: of saved models.
LAWS = ("viscous", "coulomb", "hysteresis", "stribeck", "inertia")
#: Of these the ones without a threshold.
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
        " inertia tell no ratio beside the joints' own: it is written as known, or"
        " as 1."
    )
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
    #: A law's own constant: travel, velocity; and where a search over combinations
    #: begins to refine it.
    _OWN = {
        "hysteresis": ("d", (0.002, 0.01)),
        "stribeck": ("vs", (0.06, 0.25)),
    }

    def __init__(
        self, robot: Robot, joints: Sequence[int] | None = None, **shape: float
    ) -> None:
        acting = (
            range(max(0, robot.n - 2), robot.n)
            if joints is None
            else sorted(set(joints))
        )
        law = self.shapes["law"]
        chosen = shape.get("law", law.default)
        law_constants = (
            self._OWN.get(law.written(chosen), ())[:1]
            if law.complaint(chosen) is None
            else ()
        )
        known = {
            "law": law,
            **{key: self.shapes[key] for key in law_constants},
        }
        # Ratios turn each joint's position into the first one's unit.
        units = [robot.position_units[j] for j in acting if j < robot.n]
        per = ["-" if u == units[0] else f"{units[0]}/{u}" for u in units]
        ratios = {
            f"c{j + 1}": ShapeConstant(1.0, u, signed=True)
            for j, u in zip(acting, per, strict=False)
        }
        self.shapes = ratios | known
        super().__init__(robot, joints, **shape)
        self.joints = tuple(acting)
        self.has_memory = self.law == "hysteresis"
        for j in self.joints:
            if self.shape[f"c{j + 1}"] == 0.0:
                raise InputError(
                    f"effect {self.name}: c{j + 1} is 0", f"leave joint {j + 1} out"
                )

    @property
    def law(self) -> str:
        return LAWS[int(self.shape["law"]) - 1]

    @property
    def ratios(self) -> Array:
        """(n,) c."""
        out = np.zeros(self.robot.n)
        out[list(self.joints)] = [self.shape[f"c{j + 1}"] for j in self.joints]
        return out

    @property
    def contact(self) -> Array | None:
        return self.ratios if self.law in ("coulomb", "stribeck") else None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        first = self.joints[0]
        position = self.robot.position_units[first]
        torque = self.robot.torque_units[first]
        per = {"viscous": f"*s/{position}", "inertia": f"*s^2/{position}"}.get(
            self.law, ""
        )
        name = f"{self.symbol}_{self.law}({self.combination})"
        return (Parameter(name, torque + per, self.name, first + 1, 0.0),)

    @property
    def combination(self) -> str:
        """s as a formula: "q5+q6", "q5-1/2q6"."""
        terms = [
            f"{c:+.4g}q{j + 1}".replace("+1q", "+q").replace("-1q", "-q")
            for j, c in enumerate(self.ratios)
            if c
        ]
        return "".join(terms).removeprefix("+")

    @property
    def bristles(self) -> Bristles:
        rows = (
            self.ratios[None]
            if self.law == "hysteresis"
            else np.zeros((0, self.robot.n))
        )
        return Bristles(
            rows,
            np.full(len(rows), self.shape.get("d", 1.0)),
            dahl,
        )

    def blocks_at(self, motion: Motion, z: Array) -> list[Block]:
        force = self._force(motion, z)
        return [
            Block(
                j,
                np.array([0]),
                (self.ratios[j] * force)[:, None],
            )
            for j in self.joints
        ]

    def _force(self, motion: Motion, z: Array) -> Array:
        """f(s) (N,) over its parameter."""
        if self.law == "hysteresis":
            return z[:, 0]
        if self.law == "inertia":
            return np.asarray(motion.ddq @ self.ratios)
        ds = motion.dq @ self.ratios
        if self.law == "viscous":
            return np.asarray(ds)
        sign = motion.sign_along(self.ratios)
        if self.law == "stribeck":
            return np.asarray(sign * np.exp(-((ds / self.shape["vs"]) ** 2)))
        return sign

    @classmethod
    def starts(
        cls,
        robot: Robot,
        joint: int,
    ) -> Iterable[dict[str, float]]:
        for number, law in enumerate(LAWS, start=1):
            key, grid = cls._OWN.get(law, ("", (0.0,)))
            for value in grid:
                yield {"law": float(number)} | ({key: value} if key else {})

    @classmethod
    def candidates(
        cls, robot: Robot, joint: int | None, start: float = 0.0, **constants: float
    ) -> list[Effect]:
        """Every law on every combination that begins with this joint, or on the
        ``constants`` one."""
        ratios = {key: value for key, value in constants.items() if key[:1] == "c"}
        ratio_sets = [ratios] if ratios else combinations(robot, joint or 0)
        laws = [
            law
            for law in cls.starts(robot, joint or 0)
            if constants.get("law", law["law"]) == law["law"]
        ]
        shapes = [{**law, **constants} for law in laws]
        shapes = [shape for k, shape in enumerate(shapes) if shape not in shapes[:k]]
        sure = [ratios, *map(_ratios, robot.couplings)]
        return [
            cls(
                robot,
                [int(key[1:]) - 1 for key in c],
                **{**c, **s},
            )
            for c in ratio_sets
            for s in shapes
            if c in sure or _worth_a_guess(c, s, constants, sure)
        ]


def _worth_a_guess(
    ratios: Mapping[str, float],
    shape: Mapping[str, float],
    constants: Mapping[str, float],
    sure: Sequence[Mapping[str, float]],
) -> bool:
    """Whether a law is tried on a combination that nobody knows of.

    On three joints plain laws only: finer ones fit by chance among so many. Of what is
    linear in velocity or acceleration (f c c^T) the joints' own friction and rotors
    absorb all but the cross terms, whose signs tell no ratio: it is tried with ratios
    of one, or the known ones.
    """
    if len(ratios) > 2 and not set(shape) <= {"law", *constants}:
        return False
    if LAWS[int(shape["law"]) - 1] not in _LINEAR:
        return True
    known = any(set(ratios) == set(c) for c in sure)
    return not known and all(abs(x) == 1.0 for x in ratios.values())


def combinations(robot: Robot, first: int) -> list[dict[str, float]]:
    """List the combinations of joints along which a transmission may rub.

    Parameters
    ----------
    robot
        The robot.
    first
        The joint from 0 with which a combination begins.

    Returns
    -------
    list of dict
        Ratios of neighbours of one kind, and the couplings known of the robot.
    """
    kinds = [j.kind for j in robot.joints]
    out = [_ratios(row) for row in robot.couplings if np.flatnonzero(row)[0] == first]
    for more in (*((a,) for a in _PAIRS), *_TRIPLES):
        joints = range(first, first + 1 + len(more))
        if joints.stop <= robot.n and len({kinds[j] for j in joints}) == 1:
            out.append(
                {f"c{j + 1}": c for j, c in zip(joints, (1.0, *more), strict=True)}
            )
    return [ratios for k, ratios in enumerate(out) if ratios not in out[:k]]


def _ratios(row: Array) -> dict[str, float]:
    return {f"c{j + 1}": float(row[j]) for j in np.flatnonzero(row)}
