"""A measured curve as a finding: what it runs over, its values with their band, and its
JSON."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sdp_vs_penalty.effects.effect import JointEffect
from sdp_vs_penalty.effects.measured_curve import CURVE as CURVE
from sdp_vs_penalty.effects.measured_curve import Variable, table_effect
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot


@dataclass(frozen=True)
class Curve(JsonRecord):
    """The missing torque of a joint as a measured function of one or two variables.

    The curve is the law that it follows; without one it is the part of the spline that
    the model's own columns cannot make.
    """

    #: Number of the joint, from 1.
    joint: int
    #: Names of the variables.
    of: tuple[str, ...]
    #: (P,) or (P, 2) values of the variables where measurements lie.
    x: Array
    #: (P,) torque of the curve [N m or N].
    torque: Array
    #: (P,) lower end of the simultaneous 95 % band [N m or N].
    lower: Array
    #: (P,) upper end of the simultaneous 95 % band [N m or N].
    upper: Array
    #: Share of the joint's squared error beyond the noise that the curve removes on
    #: data left out.
    explained_share: float
    #: The simplest law within the band, in words, or None.
    formula: str | None
    #: RMS error of the joint on data left out, without the curve [N m or N].
    held_out_rmse_before: float
    #: RMS error of the joint on data left out, with the curve [N m or N].
    held_out_rmse_after: float
    #: Values of the variables between the ends of ``x`` where nothing was measured.
    filled_x: Array = field(default_factory=lambda: np.zeros(0))
    #: Torque of the law at ``filled_x`` [N m or N].
    filled_torque: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Check that torque and band have one entry for each x, and that the variables
        are known.

        Raises
        ------
        ValueError
            The shapes differ, or a name is no variable.
        """
        for name in self.of:
            Variable.parse(name)
        # Over two variables x has a second dimension.
        second_dimension = (len(self.of),) if len(self.of) > 1 else ()
        shape = self.torque.shape
        has_values = self.x.shape == shape + second_dimension
        has_band = self.lower.shape == self.upper.shape == shape
        if not (has_values and has_band):
            raise ValueError("a curve has a value and a band for each x")
        shape_filled = self.filled_torque.shape + second_dimension
        if len(self.filled_x) and self.filled_x.shape != shape_filled:
            raise ValueError("what a law fills has a value for each x")

    @property
    def points(self) -> Array:
        """(P, number of variables) the points at which the curve was measured."""
        return self.x.reshape(len(self.torque), -1)

    def effect(self, robot: Robot) -> JointEffect:
        """Return the curve as a table effect, which can be added to a model of the
        robot.
        """
        # Measured points come first, then those where only the formula has values.
        filled = self.filled_x.reshape(len(self.filled_torque), len(self.of))
        return table_effect(
            robot,
            joint=self.joint - 1,
            of=self.of,
            points=np.vstack([self.points, filled]),
            values=np.append(self.torque, self.filled_torque),
            measured=len(self.torque),
        )

    def sentence(self, torque_units: Sequence[str]) -> str:
        """Describe the curve in one or two sentences: range, size, gain, and its
        formula, if any.

        Parameters
        ----------
        torque_units
            Unit of the torque of each joint, such as "N m".
        """
        unit = plain_unit(torque_units[self.joint - 1])
        variables = list(map(Variable.parse, self.of))
        units = [v.unit(torque_units) for v in variables]
        low = self.points.min(axis=0)
        high = self.points.max(axis=0)
        ranges = " and ".join(
            f"{v} from {a:.3g} to {b:.3g}{'' if u == '-' else ' ' + u}"
            for v, a, b, u in zip(variables, low, high, units, strict=True)
        )
        words = (
            f" Within the band: {self.formula}."
            if self.formula
            else " No simple law fits its band."
        )
        before, after = self.held_out_rmse_before, self.held_out_rmse_after
        change = "falls" if after < before else "rises"
        return (
            f"joint {self.joint} misses a torque over {ranges}:"
            f" {np.ptp(self.torque):.3g} {unit} from peak to peak,"
            f" {100.0 * self.explained_share:.0f} % of the error's energy beyond noise on"
            f" data left out; the error there {change} from {before:.3g} to {after:.3g}"
            f" {unit}.{words}"
        )
