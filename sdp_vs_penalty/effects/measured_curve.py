"""A torque that is known as a table: what was measured and has no name yet.

A table can run over a joint's signal, or two joints' in a ratio.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from sdp_vs_penalty.effects.effect import Array, Effect, JointEffect, Motion
from sdp_vs_penalty.effects.shape import ShapeConstant, six_digits
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Indices, Mask
from sdp_vs_penalty.robot.robot import Robot

#: What a curve can run over, in the order of the numbers that saved models have for it;
#: "none" as the second of a pair is no second variable.
WORDS = ("q", "dq", "ddq", "tau", "t", "sign(dq)", "abs(ddq)", "temp", "none")
_IN_WORDS = {
    "q": "position",
    "dq": "velocity",
    "ddq": "acceleration",
    "tau": "modelled torque",
    "t": "time",
    "sign(dq)": "direction",
    "abs(ddq)": "size of the acceleration",
    "temp": "temperature",
}


#: A combination of two joints, "q4+0.5q5", and a variable of one joint, "sign(dq4)".
_OF_TWO_JOINTS = re.compile(
    r"(?P<word>d?q)(?P<joint>[1-9]\d*)(?P<sign>[+-])(?P<ratio>[\d.]*)(?P=word)"
    r"(?P<other>[1-9]\d*)"
)
_OF_A_JOINT = re.compile(r"(?P<begin>[a-z(]+)(?P<joint>[1-9]\d*)(?P<end>\)?)")


@dataclass(frozen=True)
class Variable:
    """A variable over which a table of torques runs."""

    #: Quantity, one of WORDS; "tau" is the torque of the current model.
    word: str
    #: Number of the joint, from 0.
    joint: int = 0
    #: Number of the joint, from 0, that is added to a position or velocity; -1 for
    #: none.
    other: int = -1
    #: Factor of the added joint.
    ratio: float = 1.0

    def along(self, motion: Motion) -> Array:
        """Compute the variable (N,) along a motion of N instants."""
        j = self.joint
        if self.word == "t":
            return motion.t
        if self.word == "temp":
            return motion.joint_temperature[:, j]
        if self.word == "tau":
            return motion.model_torque[:, j]
        if self.word == "sign(dq)":
            return motion.sign(j)
        if self.word == "abs(ddq)":
            return np.abs(motion.ddq[:, j])
        # A joint's q, dq or ddq, or a combination x_j + ratio x_other (other = -1:
        # none).
        x = {"q": motion.q, "dq": motion.dq, "ddq": motion.ddq}[self.word]
        return x[:, j] if self.other < 0 else x[:, j] + self.ratio * x[:, self.other]

    @property
    def name(self) -> str:
        """Name of the variable in findings.json.

        >>> [Variable("sign(dq)", 3).name, Variable("t").name, Variable("q", 4, 5, -2.0).name]
        ['sign(dq4)', 't', 'q5-2q6']
        """
        name_on_joint = f"{self.word}{self.joint + 1}"
        if self.word == "t":
            return "t"
        if self.word.endswith(")"):
            return f"{self.word[:-1]}{self.joint + 1})"
        if self.other < 0:
            return name_on_joint
        sign = "-" if self.ratio < 0.0 else "+"
        size = f"{abs(self.ratio):.6g}"
        factor = "" if size == "1" else size
        return f"{name_on_joint}{sign}{factor}{self.word}{self.other + 1}"

    def __str__(self) -> str:
        """Return what the variable is, for people.

        >>> [str(Variable("sign(dq)", 3)), str(Variable("t")), str(Variable("q", 4, 5))]
        ['direction of joint 4', 'time', 'position of joints (q5+q6)']
        """
        quantity = _IN_WORDS[self.word]
        if self.word == "t":
            return quantity
        if self.other >= 0:
            return f"{quantity} of joints ({self.name})"
        return f"{quantity} of joint {self.joint + 1}"

    @classmethod
    def parse(cls, text: str) -> Variable:
        """Read a variable from its :attr:`name`.

        Parameters
        ----------
        text
            Text such as "q4", "sign(dq4)" or "t".

        Raises
        ------
        ValueError
            The text names no variable.
        """
        if text == "t":
            return cls("t")
        if both := _OF_TWO_JOINTS.fullmatch(text):
            ratio = float(both["sign"] + (both["ratio"] or "1"))
            joint, other = int(both["joint"]) - 1, int(both["other"]) - 1
            return cls(both["word"], joint, other, ratio)
        # The joint's number stands at the end or before a bracket: "q4", "sign(dq4)".
        one = _OF_A_JOINT.fullmatch(text)
        word = one["begin"] + one["end"] if one else ""
        if not one or word not in WORDS or word in ("t", "none"):
            raise ValueError(f"{text!r} is no variable of a curve")
        return cls(word, int(one["joint"]) - 1)

    def unit(self, torque_units: Sequence[str]) -> str:
        """Return the variable's unit.

        Parameters
        ----------
        torque_units
            Unit of each joint's torque, which tells revolute from prismatic joints. For
            a combination of joints that of the first counts.

        Returns
        -------
        str
            The unit, "-" for a sign.
        """
        torque = torque_units[self.joint]
        position = "m" if torque == "N" else "rad"
        units = {
            "q": position,
            "dq": f"{position}/s",
            "ddq": f"{position}/s^2",
            "abs(ddq)": f"{position}/s^2",
            "tau": torque,
            "t": "s",
            "temp": "K",
        }
        return units.get(self.word, "-")


#: Most values of a table along one variable.
_MOST = 200


def _is_value(key: str) -> bool:
    """Tell whether a shape constant is a value of the table.

    v1, v2, ... were measured; w1, w2, ... lie between and come from a friction law.
    """
    return key[0] in "vw" and key[1:].isdigit()


def _axis_constants(
    axis: str, count: float, default: float, words: tuple[str, ...]
) -> dict[str, ShapeConstant]:
    """Declare the shape constants of one axis ("x" or "y") of a table over a joint's
    variable.

    Files hold an effect as named numbers, so words and joints are numbers here as well.
    Those of the axis x, with joints from 1:

    - x: the variable, by its number in WORDS (one of ``words``); ``default`` where none
      is given.
    - xj: its joint; 0 is the effect's own.
    - xi, xc: a second joint that is added, and its ratio; xi = 0 is none.
    - xlow, xhigh: ends of the table.
    - xn: number of values, ``count`` by default.
    """
    numbers = tuple(WORDS.index(w) + 1.0 for w in words)
    return {
        axis: ShapeConstant(default, choices=numbers, words=words),
        f"{axis}j": ShapeConstant(0.0, signed=True),
        f"{axis}i": ShapeConstant(0.0, signed=True),
        f"{axis}c": ShapeConstant(1.0, signed=True),
        f"{axis}low": ShapeConstant(-1.0, signed=True),
        f"{axis}high": ShapeConstant(1.0, signed=True),
        f"{axis}n": ShapeConstant(count),
    }


def _variable(constants: Mapping[str, float], axis: str, joint: int) -> Variable | None:
    """Read the variable of one axis of a joint's table; None where the table has no
    such axis.

    ``joint`` counts from 0: the joint of the effect, to which 0 in the constants
    refers.
    """
    word = WORDS[int(constants[axis]) - 1]
    if word == "none":
        return None
    first = int(constants[f"{axis}j"])  # from 1; 0 is the effect's own joint
    other = int(constants.get(f"{axis}i", 0))  # from 1; 0 is none
    return Variable(
        word,
        joint=first - 1 if first else joint,
        other=other - 1,
        ratio=constants.get(f"{axis}c", 1.0),
    )


def _filled_table(
    size: tuple[int, int], known_places: Indices, known_values: Sequence[float]
) -> Array:
    """Build a table of this size from some of its values; each unknown one is that of
    the nearest known.

    ``known_places`` count from 0, row by row.
    """
    cells = np.array(list(np.ndindex(size)))  # row and column of each place
    table = np.full(len(cells), np.nan)
    table[known_places] = known_values
    open_places = np.flatnonzero(np.isnan(table))
    differences = cells[open_places, None] - cells[known_places]
    nearest = np.argmin(np.sum(differences**2, axis=2), axis=1)
    table[open_places] = table[known_places][nearest]
    return table.reshape(size)


class MeasuredCurve(JointEffect):
    name = "measured_curve"
    equation = (
        "s f(x) or s f(x, y), f interpolated linearly between the values v1, v2, ... of"
        " a table"
    )
    explanation = (
        "A torque that repeats and that no other effect explains, as diagnose measures"
        " it: a table over one variable or a pair of them. Its size s is 1 where the"
        " table was measured. Between its ends, what was not measured is as its law"
        " says, where it has one (values w1, w2, ...). Held constant outside of the"
        " table, where nothing is known of it."
    )
    on_the_arm = "{joint} has a torque that repeats and has no name"
    reference = "Eilers, Marx, Statistical Science 1996 (penalised splines)"
    symbol = "curve"
    units = ("-", "-")
    several = True
    # a table is measured (diagnosis/curves)
    sought = False
    searched = ()
    shapes = {
        **_axis_constants("x", 2.0, 1.0, tuple(w for w in WORDS if w != "none")),
        **_axis_constants("y", 1.0, WORDS.index("none") + 1.0, WORDS),
        "v1": ShapeConstant(-1.0, signed=True),
        "v2": ShapeConstant(1.0, signed=True),
    }

    def __init__(
        self, robot: Robot, joints: Sequence[int] | None = None, **shape: float
    ) -> None:
        """Check a table, and build it from the shape constants v1, v2, ... and w1, w2,
        ....

        Values that are missing are filled with the nearest known one.
        """
        constants = self._with_defaults(shape)
        # The values' keys by their place in the table, which counts from 1 row by row:
        # {1: "v1", 2: "w2", ...}.
        key_of_place = {int(key[1:]): key for key in constants if _is_value(key)}
        places = sorted(key_of_place)
        value_keys = [key_of_place[place] for place in places]
        self._require_table(robot, constants, places)
        first_joint = 0 if joints is None else min(joints, default=0)
        # This effect's own constants, with the units of its variables, before the base
        # class checks them.
        self.shapes = self._declared_shapes(robot, first_joint, constants, value_keys)
        super().__init__(robot, joints, **shape)
        self.shape = {key: self.shape[key] for key in self.shapes}
        # What the columns need to be computed.
        words = {variable.word for variable in self.variables(first_joint)}
        self.needs_torque = "tau" in words
        self.follows_clock = "t" in words
        self.needs_temperature = "temp" in words
        size = (int(constants["xn"]), int(constants["yn"]))
        values = [self.shape[key] for key in value_keys]
        self._table = _filled_table(size, np.array(places) - 1, values)
        # (xn, yn): 1 where nothing was measured, 0 where v1, v2 ... are.
        measured = [k - 1 for k in places if key_of_place[k].startswith("v")]
        self._missing = np.ones(size)
        self._missing.flat[measured] = 0.0

    @classmethod
    def _with_defaults(cls, shape: Mapping[str, float]) -> dict[str, float]:
        """Return the given constants, and the class's defaults for all others. Given
        values of the table replace all of its default values."""
        has_values = any(_is_value(key) for key in shape)
        defaults = {
            key: constant.default
            for key, constant in cls.shapes.items()
            if not (has_values and _is_value(key))
        }
        return {**defaults, **shape}

    def _require_table(
        self, robot: Robot, constants: Mapping[str, float], places: Sequence[int]
    ) -> None:
        """Raise InputError for constants that make no table: sizes xn and yn that are
        no whole numbers, values outside of xn yn places, or ends in the wrong order.

        ``places`` are those of the given values, sorted; they count from 1 row by row.
        """
        who = f"effect {self.name}:"
        for key in ("xn", "yn"):
            size = constants[key]
            if size != int(size) or not 1 <= size <= _MOST:
                raise InputError(
                    f"{who} {key} = {size:g}", f"give a whole number from 1 to {_MOST}"
                )
        count = int(constants["xn"] * constants["yn"])
        if not places or not 1 <= places[0] <= places[-1] <= count:
            remedy = f"name those that are known among v1 to v{count}"
            raise InputError(f"{who} the values do not fit a table of {count}", remedy)
        for axis in "xy":
            if not constants[f"{axis}low"] < constants[f"{axis}high"]:
                what = f"{who} a table's low end is not below its high end"
                raise InputError(what, "swap the ends")
        self._require_joints(robot, constants)

    def _require_joints(self, robot: Robot, constants: Mapping[str, float]) -> None:
        """Raise InputError for a joint of the table's variables that does not exist, or
        one that is added to what is no position or velocity."""
        who = f"effect {self.name}:"
        position_or_velocity = (1.0, 2.0)  # numbers of "q" and "dq" in WORDS
        for key in ("xj", "yj", "xi", "yi"):
            axis = key[0]
            is_added = key[1] == "i"
            joint = constants[key]
            if joint != int(joint) or not 0 <= joint <= robot.n:
                zero_means = "none" if is_added else "its own"
                remedy = f"give one from 1 to {robot.n}, or 0 for {zero_means}"
                raise InputError(f"{who} {key} = {joint:g} is no joint", remedy)
            if is_added and joint and constants[axis] not in position_or_velocity:
                what = f"{who} {key} adds a joint to what is no position or velocity"
                raise InputError(what, f"leave it out, or write {axis}=q or {axis}=dq")

    @classmethod
    def _declared_shapes(
        cls,
        robot: Robot,
        joint: int,
        constants: Mapping[str, float],
        value_keys: Sequence[str],
    ) -> dict[str, ShapeConstant]:
        """Declare the shape constants of this table, with their units.

        Ends of its axes have the units of its variables, the values that of torque.
        The constants of an added joint (xi, xc, yi, yc) are left out where no joint is
        added.

        Parameters
        ----------
        joint
            The effect's joint, from 0.
        constants
            Values by key, such as "xlow" and "v1".
        value_keys
            Keys of the table's values, "v1", "w2", ...
        """
        shapes = {k: s for k, s in cls.shapes.items() if not k.startswith("v")}
        for axis in "xy":
            is_known = constants[axis] in cls.shapes[axis].choices
            # The base class refuses another number.
            variable = _variable(constants, axis, joint) if is_known else None
            unit = "-" if variable is None else variable.unit(robot.torque_units)
            for end in ("low", "high"):
                shapes[axis + end] = replace(cls.shapes[axis + end], unit=unit)
            if not constants[f"{axis}i"]:
                del shapes[f"{axis}i"], shapes[f"{axis}c"]
        torque_unit = robot.torque_units[joint]
        return shapes | {
            key: ShapeConstant(constants[key], torque_unit, signed=True)
            for key in value_keys
        }

    def variables(self, joint: int) -> tuple[Variable, ...]:
        """Return the one or two variables over which the table of a joint (from 0)
        runs."""
        parsed = (_variable(self.shape, axis, joint) for axis in "xy")
        return tuple(v for v in parsed if v is not None)

    @property
    def constants(self) -> str:
        """Size and variables of the table, as text."""
        count = int(np.sum(self._missing == 0.0))
        return f"a table of {count} values over {', '.join(self.variable_names(self.joints[0]))}"

    @property
    def brief(self) -> str:
        """The effect as reports show it: name, joints, size and variables, without the
        values."""
        return f"{self.text.partition('@')[0]} ({self.constants})"

    def variable_names(self, joint: int) -> tuple[str, ...]:
        """Return the names of the one or two variables of the table of a joint (from
        0), such as "q4" or "sign(dq4)"."""
        return tuple(v.name for v in self.variables(joint))

    def parameter_name(self, joint: int) -> str:
        """Name the size of a joint's table after its variables: "curve4_q4"."""
        return f"{self.symbol}{joint + 1}_{'_'.join(self.variable_names(joint))}"

    def column(self, motion: Motion, joint: int) -> Array:
        """Interpolate the table along a motion: (N,) torque [N m, N] of one joint."""
        return self._interpolated(self._table, motion, joint)

    def _interpolated(self, table: Array, motion: Motion, joint: int) -> Array:
        """Interpolate a table (xn, yn) linearly along a motion of N instants, to values
        (N,).

        Values of the variables from ``low`` to ``high`` are mapped to places 0 to n - 1
        of the table; beyond the ends the value at the end counts. A table over one
        variable has yn = 1.
        """
        places = np.zeros((2, len(motion.t)))
        for row, (axis, variable) in enumerate(
            zip("xy", self.variables(joint), strict=False)
        ):
            low = self.shape[axis + "low"]
            high = self.shape[axis + "high"]
            count = self.shape[axis + "n"]
            share = (variable.along(motion) - low) / (high - low)
            places[row] = share * (count - 1)
        return scipy.ndimage.map_coordinates(table, places, order=1, mode="nearest")

    def outside(self, motion: Motion) -> Mask:
        """Tell where a motion leaves the table of any joint, or the measured part of
        it: (N,) flags.

        The measured part is found by interpolating ``_missing``, which is 1 where the
        table was not measured and 0 elsewhere.
        """
        is_outside = np.zeros(len(motion.t), bool)
        for joint in self.joints:
            is_outside |= self._interpolated(self._missing, motion, joint) > 0.5
            for axis, variable in zip("xy", self.variables(joint), strict=False):
                x = variable.along(motion)
                is_outside |= x < self.shape[f"{axis}low"]
                is_outside |= x > self.shape[f"{axis}high"]
        return is_outside


#: Name of a curve, as findings have it among what the data cannot tell apart from them.
CURVE = MeasuredCurve.name


def table_variables(effect: Effect, joint: int) -> tuple[str, ...] | None:
    """Return the names of the variables of a table on a joint (from 0); None for effects
    that are no table there."""
    if not isinstance(effect, MeasuredCurve) or joint not in effect.joints:
        return None
    return effect.variable_names(joint)


def table_effect(
    robot: Robot,
    joint: int,
    of: Sequence[str],
    points: Array,
    values: Array,
    measured: int,
) -> MeasuredCurve:
    """Make the effect whose torque is a table over a grid of one or two variables.

    An effect keeps all numbers as named constants, with which it is written to a file.
    For the first variable x (y for the second) they are its word's number, joint "xj",
    second joint "xi" and ratio "xc" of a sum of two joints, range "xlow" to "xhigh",
    and number of points "xn". The values are "v1", "v2" ... (measured) and "w1" ...
    (from a formula).

    ``joint`` counts from 0.

    Parameters
    ----------
    of
        Names of the variables, such as "q1".
    points
        (P, number of variables) points of an equally spaced grid; some may be missing.
    values
        (P,) torque there [N m or N].
    measured
        Number of the first points that were measured; a formula gave the others.

    Returns
    -------
    MeasuredCurve
        The effect. Files hold six digits, so its values are rounded to these here.
    """
    shape: dict[str, float] = {}
    places = []
    counts = []
    for axis, name, x in zip("xy", of, points.T, strict=False):
        variable = Variable.parse(name)
        # Points may be missing: the smallest distance is the step of the grid.
        steps = np.diff(np.unique(x))
        low = float(x.min())
        high = float(x.max())
        step = float(steps.min(initial=high - low))
        count = round((high - low) / step) + 1
        shape[axis] = WORDS.index(variable.word) + 1.0
        shape[f"{axis}j"] = variable.joint + 1.0
        if variable.other >= 0:
            shape[f"{axis}i"] = variable.other + 1.0
            shape[f"{axis}c"] = variable.ratio
        shape[f"{axis}low"] = six_digits(low)
        shape[f"{axis}high"] = six_digits(high)
        shape[f"{axis}n"] = float(count)
        places.append(np.rint((x - low) / (high - low) * (count - 1)))
        counts.append(count)
    # Cells are numbered row by row; "v7" is a measured value of cell 7, "w7" a law's.
    cells = np.ravel_multi_index(tuple(np.array(places, int)), tuple(counts))
    for k in np.argsort(cells, kind="stable"):
        letter = "v" if k < measured else "w"
        shape[f"{letter}{cells[k] + 1}"] = six_digits(values[k])
    return MeasuredCurve(robot, [joint], **shape)
