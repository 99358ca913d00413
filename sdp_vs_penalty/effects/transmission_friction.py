"""Friction and inertia on an axis that turns with several joints."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import product

import numpy as np

from sdp_vs_penalty.effects.bristles import Bristles, Remembering, dahl
from sdp_vs_penalty.effects.effect import Array, Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.presliding_hysteresis import PreslidingHysteresis
from sdp_vs_penalty.effects.shape import Shape
from sdp_vs_penalty.effects.stribeck_friction import StribeckFriction
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.robot import Robot

#: What turns with an axis: friction by four laws, and inertia. Their numbers are those of saved models.
LAWS = ("viscous", "coulomb", "hysteresis", "stribeck", "inertia")
#: Of these the ones without a threshold.
_LINEAR = ("viscous", "inertia")
#: Ratios of the second joint to the first, and of the second and third to the first.
_PAIRS = (1.0, -1.0, 2.0, -2.0, 0.5, -0.5)
_TRIPLES = tuple((a, b) for size in (1.0, 0.5) for a, b in product((size, -size), repeat=2))
#: Travel and velocity at which a search over combinations begins; both are refined.
_TRAVELS, _VELOCITIES = (0.002, 0.01), (0.06, 0.25)


class TransmissionFriction(Remembering):
    name = "transmission_friction"
    equation = (
        "c^T f(s), s = c q, f = f_t times ds | sign(ds) | z | sign(ds) exp(-(ds / vs)^2) | dds, for "
        "law = viscous | coulomb | hysteresis | stribeck | inertia; dz/ds = (1 - z sign(ds)) / d"
    )
    explanation = (
        "A motor that drives through the gears of others (wrists, differentials, parallelograms) turns "
        "with a combination s = c q of joints. Its friction and its rotor's inertia act on s, and "
        "return to the joints by the same ratios (c^T f, so that power is kept): friction never feeds "
        "energy. c5, c6 are the ratios of joints 5 and 6; without joints, the last two. Viscous "
        "friction and inertia tell no ratio beside the joints' own: it is written as known, or as 1."
    )
    reference = "Janot, Vandanjon, Gautier, IEEE TCST 2014 (TX40); Wang et al., RA-L 2019 (dVRK)"
    symbol = "f_t"
    several = True
    joins = True
    shapes = {
        "law": Shape(2.0, choices=tuple(range(1, 1 + len(LAWS))), words=LAWS),
        "d": PreslidingHysteresis.shapes["d"],
        "vs": StribeckFriction.shapes["vs"],
    }
    _OWN = {"hysteresis": "d", "stribeck": "vs"}

    def __init__(self, robot: Robot, joints: Sequence[int] | None = None, **shape: float) -> None:
        acting = range(max(0, robot.n - 2), robot.n) if joints is None else sorted(set(joints))
        law = self.shapes["law"]
        chosen = shape.get("law", law.default)
        own = self._OWN.get(law.written(chosen)) if law.complaint(chosen) is None else None
        known = {"law": law, **({own: self.shapes[own]} if own else {})}
        self.shapes = {f"c{j + 1}": Shape(1.0, signed=True) for j in acting} | known
        super().__init__(robot, joints, **shape)
        self.joints = tuple(acting)
        self.has_memory = self.law == "hysteresis"
        for j in self.joints:
            if self.shape[f"c{j + 1}"] == 0.0:
                raise InputError(f"effect {self.name}: c{j + 1} is 0", f"leave joint {j + 1} out")

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
        position, torque = self.robot.position_units[first], self.robot.torque_units[first]
        per = {"viscous": f"*s/{position}", "inertia": f"*s^2/{position}"}.get(self.law, "")
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

    def shape_unit(self, key: str, joint: int) -> str:
        """Ratios turn each joint's position into the first one's unit."""
        if key in self._OWN.values() or key == "law":
            return super().shape_unit(key, self.joints[0])
        units = self.robot.position_units
        own, first = units[int(key[1:]) - 1], units[self.joints[0]]
        return "-" if own == first else f"{first}/{own}"

    @property
    def bristles(self) -> Bristles:
        rows = self.ratios[None] if self.law == "hysteresis" else np.zeros((0, self.robot.n))
        return Bristles(rows, np.full(len(rows), self.shape.get("d", 1.0)), dahl)

    def blocks_at(self, motion: Motion, z: Array) -> list[Block]:
        force = self._force(motion, z)
        return [Block(j, np.array([0]), (self.ratios[j] * force)[:, None]) for j in self.joints]

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
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        own = {"hysteresis": ("d", _TRAVELS), "stribeck": ("vs", _VELOCITIES)}
        for number, law in enumerate(LAWS, start=1):
            key, grid = own.get(law, (None, (0.0,)))
            for value in grid:
                yield {"law": float(number)} | ({key: value} if key else {})

    @classmethod
    def candidates(
        cls, robot: Robot, joint: int | None, start: float = 0.0, **given: float
    ) -> list[Effect]:
        """Every law on every combination that begins with this joint, or on the ``given`` one."""
        ratios = {key: value for key, value in given.items() if key[:1] == "c"}
        found = [ratios] if ratios else combinations(robot, joint or 0)
        laws = [
            law for law in cls.starts(robot, joint or 0) if given.get("law", law["law"]) == law["law"]
        ]
        shapes = [{**law, **given} for law in laws]
        shapes = [shape for k, shape in enumerate(shapes) if shape not in shapes[:k]]
        sure = [ratios, *map(_ratios, robot.couplings)]
        return [
            cls(robot, [int(key[1:]) - 1 for key in c], **{**c, **s})
            for c in found
            for s in shapes
            if c in sure or _worth_a_guess(c, s, given, sure)
        ]


def _worth_a_guess(
    ratios: Mapping[str, float],
    shape: Mapping[str, float],
    given: Mapping[str, float],
    sure: Sequence[Mapping[str, float]],
) -> bool:
    """Whether a law is tried on a combination that nobody knows of.

    On three joints plain laws only: finer ones fit by chance among so many. Of what is linear in
    velocity or acceleration (f c c^T) the joints' own friction and rotors absorb all but the cross
    terms, whose signs tell no ratio: it is tried with ratios of one, or the known ones.
    """
    if len(ratios) > 2 and not set(shape) <= {"law", *given}:
        return False
    if LAWS[int(shape["law"]) - 1] not in _LINEAR:
        return True
    known = any(set(ratios) == set(c) for c in sure)
    return not known and all(abs(x) == 1.0 for x in ratios.values())


def combinations(robot: Robot, first: int) -> list[dict[str, float]]:
    """Ratios of neighbours of one kind, and the couplings that are known of the robot."""
    kinds = [j.kind for j in robot.joints]
    out = [_ratios(row) for row in robot.couplings if np.flatnonzero(row)[0] == first]
    for more in (*((a,) for a in _PAIRS), *_TRIPLES):
        joints = range(first, first + 1 + len(more))
        if joints.stop <= robot.n and len({kinds[j] for j in joints}) == 1:
            out.append({f"c{j + 1}": c for j, c in zip(joints, (1.0, *more), strict=True)})
    return [ratios for k, ratios in enumerate(out) if ratios not in out[:k]]


def _ratios(row: Array) -> dict[str, float]:
    return {f"c{j + 1}": float(row[j]) for j in np.flatnonzero(row)}
