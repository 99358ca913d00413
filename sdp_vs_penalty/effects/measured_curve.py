"""A torque that is known as a table: what was measured and has no name yet."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.shape import Shape
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.robot import Robot

#: What a curve can run over; "none" as the second of a pair is no second variable.
VARIABLES = ("q", "dq", "ddq", "tau", "t", "sign(dq)", "abs(ddq)", "temp")
#: Most values of a table along one variable.
_MOST = 200


def variable(motion: Motion, word: str, joint: int) -> Array:
    """(N,) one of VARIABLES along a motion, of a joint from 0; tau is the current model's torque."""
    if word == "t":
        return motion.t
    if word == "temp":
        return motion.joint_temperature[:, joint]
    if word == "tau":
        return motion.model_torque[:, joint]
    if word == "sign(dq)":
        return motion.sign(joint)
    if word == "abs(ddq)":
        return np.abs(motion.ddq[:, joint])
    return np.asarray({"q": motion.q, "dq": motion.dq, "ddq": motion.ddq}[word][:, joint])


def variable_unit(torque_units: Sequence[str], word: str, joint: int) -> str:
    """Unit of one of VARIABLES of a joint, from the units of the joints' torques."""
    position = "m" if torque_units[joint] == "N" else "rad"
    rates = {"q": position, "dq": f"{position}/s", "ddq": f"{position}/s^2"}
    return {
        **rates,
        "abs(ddq)": f"{position}/s^2",
        "t": "s",
        "tau": torque_units[joint],
        "temp": "K",
    }.get(word, "-")


def _is_value(key: str) -> bool:
    """Whether a shape constant is a value of the table: v1, v2, ..."""
    return key[0] == "v" and key[1:].isdigit()


def corners(x: Array, low: float, high: float, count: int) -> tuple[Array, NDArray[np.intp]]:
    """(N, 2) weights of linear interpolation between ``count`` equally spaced knots, constant outside
    [low, high], and the (N, 2) knots that they belong to. One knot: itself, twice."""
    place = np.clip((x - low) / (high - low), 0.0, 1.0) * (count - 1)
    below = np.minimum(place.astype(np.intp), max(count - 2, 0))
    share = place - below
    above = np.minimum(below + 1, count - 1)
    return np.column_stack([1.0 - share, share]), np.column_stack([below, above])


@lru_cache(maxsize=8)
def _nearest(rows: int, columns: int, known: tuple[int, ...]) -> NDArray[np.intp]:
    """(rows columns,) of the known values (from 1) the nearest one's place among them: what is missing of
    a table (no measurement lay there) is as that."""
    every = np.array(list(np.ndindex(rows, columns)), float)
    there = every[np.array(known) - 1]
    return np.argmin(np.sum((every[:, None, :] - there) ** 2, axis=2), axis=1)


class MeasuredCurve(JointEffect):
    name = "measured_curve"
    equation = "s f(x) or s f(x, y), f interpolated linearly between the values v1, v2, ... of a table"
    explanation = (
        "A torque that repeats and that no other effect explains, as diagnose measures it: a table over "
        "one variable or a pair of them. Its size s is 1 where the table was measured. Held constant "
        "outside of the table, where nothing is known of it."
    )
    reference = "Eilers, Marx, Statistical Science 1996 (penalised splines)"
    symbol = "curve"
    units = ("-", "-")
    several = True
    shapes = {
        "x": Shape(1.0, choices=tuple(map(float, range(1, len(VARIABLES) + 1))), words=VARIABLES),
        "xj": Shape(0.0, signed=True),
        "xlow": Shape(-1.0, signed=True),
        "xhigh": Shape(1.0, signed=True),
        "xn": Shape(2.0),
        "y": Shape(
            len(VARIABLES) + 1.0,
            choices=tuple(map(float, range(1, len(VARIABLES) + 2))),
            words=(*VARIABLES, "none"),
        ),
        "yj": Shape(0.0, signed=True),
        "ylow": Shape(-1.0, signed=True),
        "yhigh": Shape(1.0, signed=True),
        "yn": Shape(1.0),
        "v1": Shape(-1.0, signed=True),
        "v2": Shape(1.0, signed=True),
    }

    def __init__(self, robot: Robot, joints: Sequence[int] | None = None, **shape: float) -> None:
        own: dict[str, float] = {k: s.default for k, s in type(self).shapes.items()} | shape
        if any(_is_value(key) for key in shape):
            own = {k: v for k, v in own.items() if k in shape or not _is_value(k)}
        known = sorted(int(key[1:]) for key in own if _is_value(key))
        self._refuse(robot, own, known)
        at = 0 if joints is None else min(joints, default=0)
        self.shapes = self._own_shapes(robot, at, own, [f"v{k}" for k in known])
        super().__init__(robot, joints, **shape)
        self.shape = {key: self.shape[key] for key in self.shapes}
        self.needs_torque = "tau" in (self._word("x"), self._word("y"))
        self.follows_clock = "t" in (self._word("x"), self._word("y"))
        self.needs_temperature = "temp" in (self._word("x"), self._word("y"))
        self._known, self._nearest = known, _nearest(int(own["xn"]), int(own["yn"]), tuple(known))
        self._table = np.array([self.shape[f"v{k}"] for k in known])[self._nearest]
        self._missing = np.ones(len(self._nearest))
        self._missing[np.array(known) - 1] = 0.0

    def _refuse(self, robot: Robot, own: Mapping[str, float], known: Sequence[int]) -> None:
        """InputError for a table that cannot be one; known : the places of its values."""
        for key in ("xn", "yn"):
            if own[key] != int(own[key]) or not 1 <= own[key] <= _MOST:
                raise InputError(
                    f"effect {self.name}: {key} = {own[key]:g}", f"give a whole number from 1 to {_MOST}"
                )
        count = int(own["xn"] * own["yn"])
        if not known or not 1 <= known[0] <= known[-1] <= count:
            raise InputError(
                f"effect {self.name}: the values do not fit a table of {count}",
                f"name those that are known among v1 to v{count}",
            )
        if not (own["xlow"] < own["xhigh"] and own["ylow"] < own["yhigh"]):
            raise InputError(
                f"effect {self.name}: a table's low end is not below its high end", "swap the ends"
            )
        for key in ("xj", "yj"):
            if own[key] != int(own[key]) or not 0 <= own[key] <= robot.n:
                raise InputError(
                    f"effect {self.name}: {key} = {own[key]:g} is no joint",
                    f"give one from 1 to {robot.n}, or 0 for its own",
                )

    @classmethod
    def _own_shapes(
        cls, robot: Robot, joint: int, own: Mapping[str, float], values: Sequence[str]
    ) -> dict[str, Shape]:
        """The class's, with the units of this table's variables and of its torque."""
        out = {k: s for k, s in cls.shapes.items() if not k.startswith("v")}
        for axis in "xy":
            known = own[axis] in cls.shapes[axis].choices
            word = cls.shapes[axis].written(own[axis]) if known else ""
            partner = int(own[f"{axis}j"]) - 1 if 0 < own[f"{axis}j"] <= robot.n else joint
            unit = variable_unit(robot.torque_units, word, partner)
            for end in ("low", "high"):
                shape = cls.shapes[axis + end]
                out[axis + end] = Shape(shape.default, unit, signed=True)
        return out | {v: Shape(own[v], robot.torque_units[joint], signed=True) for v in values}

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        """None: a table is measured, not searched (diagnosis/curves)."""
        return ()

    @property
    def searched(self) -> tuple[str, ...]:
        return ()

    def _word(self, axis: str) -> str:
        return self.shapes[axis].written(self.shape[axis])

    def variables(self, joint: int) -> tuple[tuple[str, int], ...]:
        """What the curve runs over: words of VARIABLES with their joints (from 0)."""
        found = [(self._word(axis), int(self.shape[f"{axis}j"]) - 1) for axis in "xy"]
        return tuple((word, joint if j < 0 else j) for word, j in found if word != "none")

    @property
    def constants(self) -> str:
        count = int(np.sum(self._missing == 0.0))
        return f"a table of {count} values over {', '.join(self.of(self.joints[0]))}"

    @property
    def brief(self) -> str:
        return f"{self.text.partition('@')[0]} ({self.constants})"

    def of(self, joint: int) -> tuple[str, ...]:
        """The variables as they are written: q4, sign(dq4), t."""
        return tuple(variable_name(word, j) for word, j in self.variables(joint))

    def parameter_name(self, joint: int) -> str:
        return f"{self.symbol}{joint + 1}_{'_'.join(self.of(joint))}"

    def valued(self, values: Array) -> MeasuredCurve:
        """The same table with other values (P,) where it is known, as they are written."""
        out, own = copy(self), [float(f"{v:.6g}") for v in values]
        out.shape = self.shape | dict(zip((f"v{k}" for k in self._known), own, strict=True))
        out._table = np.array(own)[self._nearest]
        return out

    def column(self, motion: Motion, joint: int) -> Array:
        return self._interpolated(self._table, motion, joint)

    def _interpolated(self, table: Array, motion: Motion, joint: int) -> Array:
        """(N,) linear interpolation of values (xn yn,) at the corners of the cell of each instant."""
        weights, index = np.ones((len(motion.t), 1)), np.zeros((len(motion.t), 1), int)
        for axis, (word, partner) in zip("xy", self.variables(joint), strict=False):
            low, high, count = (self.shape[axis + key] for key in ("low", "high", "n"))
            own, at = corners(variable(motion, word, partner), low, high, int(count))
            weights = (weights[:, :, None] * own[:, None, :]).reshape(len(motion.t), -1)
            index = (int(count) * index[:, :, None] + at[:, None, :]).reshape(len(motion.t), -1)
        return np.asarray(np.sum(weights * table[index], axis=1))

    def outside(self, motion: Motion) -> NDArray[np.bool_]:
        """(N,) where a variable lies outside of the table, or in a part of it of which nothing is known,
        on any of the joints."""
        out = np.zeros(len(motion.t), bool)
        for joint in self.joints:
            out |= self._interpolated(self._missing, motion, joint) > 0.5
            for axis, (word, partner) in zip("xy", self.variables(joint), strict=False):
                x = variable(motion, word, partner)
                out |= (x < self.shape[f"{axis}low"]) | (x > self.shape[f"{axis}high"])
        return out


def variable_name(word: str, joint: int) -> str:
    """As findings.json writes a variable of a joint (from 0).

    >>> variable_name("sign(dq)", 3), variable_name("t", 3)
    ('sign(dq4)', 't')
    """
    if word == "t":
        return "t"
    return f"{word[:-1]}{joint + 1})" if word.endswith(")") else f"{word}{joint + 1}"


def parse_variable(text: str) -> tuple[str, int]:
    """Word and joint (from 0) of a variable as it is written; ValueError where it is none."""
    digits = "".join(c for c in text if c.isdigit())
    word = text.replace(digits, "") if digits else text
    if word not in VARIABLES or (word == "t") == bool(digits):
        raise ValueError(f"{text!r} is no variable of a curve")
    return word, int(digits or 1) - 1
