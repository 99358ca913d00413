"""A measured curve as a finding: what it runs over, its values with their band, and its
JSON."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sdp_vs_penalty.effects.measured_curve import WORDS, MeasuredCurve, Variable
from sdp_vs_penalty.files import JsonRecord
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot

#: What a finding cannot be told apart from where a curve stands instead of it.
CURVE = MeasuredCurve.name


@dataclass(frozen=True)
class Curve(JsonRecord):
    """The missing torque of a joint (from 1) as a function of what ``of`` names.

    x (P,) or (P, 2) : values of the variables, where measurements lie; torque, lower,
    upper (P,) : the curve and its simultaneous 95 % band [N m or N]: its law, or where
    that is not all what the model's own columns cannot make; explained_share : of the
    joint's squared error beyond the noise's, what the curve takes on data left out, its
    values and the model fitted to the others; formula : the simplest law within the
    band, or None; held_out_rmse_before, _after : of the joint. filled_x, filled_torque
    : between the ends of x, where nothing was measured, what the law says.
    """

    joint: int
    of: tuple[str, ...]
    x: Array
    torque: Array
    lower: Array
    upper: Array
    explained_share: float
    formula: str | None
    held_out_rmse_before: float
    held_out_rmse_after: float
    filled_x: Array = field(default_factory=lambda: np.zeros(0))
    filled_torque: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Raises ValueError where shapes do not fit each other, or a variable has no
        such name."""
        for name in self.of:
            Variable.parse(name)
        pair = (len(self.of),) * (len(self.of) > 1)
        shape_of_values = self.torque.shape
        if (
            self.x.shape != shape_of_values + pair
            or not shape_of_values == self.lower.shape == self.upper.shape
        ):
            raise ValueError("a curve has a value and a band for each x")
        if (
            len(self.filled_x)
            and self.filled_x.shape != self.filled_torque.shape + pair
        ):
            raise ValueError("what a law fills has a value for each x")

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON; without what a law fills where nothing is."""
        gone = () if len(self.filled_torque) else ("filled_x", "filled_torque")
        return {k: v for k, v in super().to_dict().items() if k not in gone}

    @property
    def points(self) -> Array:
        """(P, variables)."""
        return self.x.reshape(len(self.torque), -1)

    def effect(self, robot: Robot) -> MeasuredCurve:
        """The curve as an effect that can be added to a model."""
        filled = self.filled_x.reshape(len(self.filled_torque), len(self.of))
        constants = np.vstack([self.points, filled])
        values = np.append(self.torque, self.filled_torque)
        return table_effect(
            robot,
            self.joint - 1,
            self.of,
            constants,
            values,
            len(self.torque),
        )

    def sentence(self, torque_units: Sequence[str]) -> str:
        """What was measured, in one or two sentences; torque_units : of all joints."""
        unit = plain_unit(torque_units[self.joint - 1])
        units = [Variable.parse(v).unit(torque_units) for v in self.of]
        low = self.points.min(axis=0)
        high = self.points.max(axis=0)
        ranges = " and ".join(
            f"{v} from {a:.3g} to {b:.3g}{'' if u == '-' else ' ' + u}"
            for v, a, b, u in zip(self.of, low, high, units, strict=True)
        )
        words = (
            f" Within the band: {self.formula}."
            if self.formula
            else " No simple law fits its band."
        )
        return (
            f"joint {self.joint} misses a torque over {ranges}:"
            f" {np.ptp(self.torque):.3g} {unit} from peak to peak,"
            f" {100.0 * self.explained_share:.0f} % of the held-out energy beyond"
            f" noise; held-out error {self.held_out_rmse_before:.3g} to"
            f" {self.held_out_rmse_after:.3g} {unit}.{words}"
        )


def table_effect(
    robot: Robot,
    joint: int,
    of: Sequence[str],
    points: Array,
    values: Array,
    measured: int,
) -> MeasuredCurve:
    """The table of values (P,) at points (P, variables) of an equally spaced grid, of
    which some may be missing. joint : from 0; measured : so many of the first were, a
    law says the others."""
    shape: dict[str, float] = {}
    places = []
    counts = []
    for axis, name, x in zip("xy", of, points.T, strict=False):
        over = Variable.parse(name)
        steps = np.diff(np.unique(x))
        low = float(x.min())
        high = float(x.max())
        count = round((high - low) / float(steps.min(initial=high - low))) + 1
        shape[axis], shape[f"{axis}j"] = WORDS.index(over.word) + 1.0, over.joint + 1.0
        if over.other >= 0:
            shape |= {f"{axis}i": over.other + 1.0, f"{axis}c": over.ratio}
        shape[f"{axis}low"], shape[f"{axis}high"] = (
            float(f"{low:.6g}"),
            float(f"{high:.6g}"),
        )
        shape[f"{axis}n"] = float(count)
        places.append(np.rint((x - low) / (high - low) * (count - 1)))
        counts.append(count)
    known = np.ravel_multi_index(tuple(np.array(places, int)), tuple(counts))
    written = [float(f"{v:.6g}") for v in values]
    keys = [f"{'v' if m < measured else 'w'}{k + 1}" for m, k in enumerate(known)]
    shape |= dict(
        sorted(zip(keys, written, strict=True), key=lambda kv: int(kv[0][1:]))
    )
    return MeasuredCurve(robot, [joint], **shape)
