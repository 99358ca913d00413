"""What may act for a part of the runs, each with its columns.

- a load on the last link: its mass m and first moments m c;
- a force F that is constant in the world, at a point p of a link. It is the weight of a
  mass of 1 kg at p in a field of gravity F, so its columns are those of the weight;
- a constant torque on one joint;
- a change of one joint's dry friction, as of a brake that drags.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from sdp_vs_penalty.diagnosis.library import Candidate
from sdp_vs_penalty.diagnosis.linear_fit import with_ridge
from sdp_vs_penalty.diagnosis.passing.spans import regular
from sdp_vs_penalty.diagnosis.white_rows import WhiteData, spread_columns
from sdp_vs_penalty.effects import standard_effect
from sdp_vs_penalty.effects.effect import Effect, JointEffect, Motion
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot


class LinkWeight(Effect):
    """The weight of a mass on one link, in fields of gravity along x, y and z.

    Column 4 b is the torque that holds 1 kg at the link's origin in gravity of 1 m/s^2
    along axis b of the world, which pulls with 1 N. Columns 4 b + 1 to 4 b + 3 are those
    of 1 kg m along the link's axes.
    """

    name = "link_weight"
    equation = "sum_b F_b dg(q)/dg_b (1, p)"
    whole_robot = True
    sought = False

    def __init__(self, robot: Robot, link: int) -> None:
        """Choose the link, from 0."""
        super().__init__(robot)
        self.link = link

    def parameter_names_and_units(self, joint: int) -> Iterable[tuple[str, str]]:
        """Name the components of the force [N], and their products with the point
        [N m]."""
        return [
            (f"F_{axis}{at}", "N*m" if at else "N")
            for axis in "xyz"
            for at in ("", "_x", "_y", "_z")
        ]

    def torques(self, motion: Motion) -> Array:
        """Compute the torque (N, n, 12) per unit of each parameter."""
        at_rest = np.zeros_like(motion.q)
        first = 10 * self.link
        columns = []
        for axis in np.eye(3):
            robot = replace(self.robot, gravity=(axis[0], axis[1], axis[2]))
            regressor = robot.regressor(motion.q, at_rest, at_rest)
            columns.append(regressor[:, :, first : first + 4])
        return np.concatenate(columns, axis=2)


class ChangedFriction(JointEffect):
    """A change of dry friction, with the sign of the velocity that the model has."""

    name = "dry_friction"
    equation = "f sign(dq)"
    symbol = "f"
    sought = False

    def column(self, motion: Motion, joint: int) -> Array:
        """Return the smooth sign (N,) of the velocity."""
        return motion.sign(joint)


@dataclass(frozen=True, eq=False)
class Law:
    """What a cause may be: its filtered columns, and how many numbers describe it."""

    #: "load", "force", "torque" or "friction".
    kind: str
    #: Number of the link or joint, from 1.
    place: int
    #: The effect whose columns these are.
    effect: Effect
    #: (n, M, k) torque per unit of the parameters [N m or N].
    columns: Array
    #: Number of free parameters, at most k.
    freedom: int

    @property
    def text(self) -> str:
        """A name of the law, such as "force:3"."""
        return f"{self.kind}:{self.place}"

    def at_point(self, point: Array) -> Law:
        """Return the law of a force at a point (3,) [m] of its link, with three
        columns."""
        by_axis = self.columns.reshape(*self.columns.shape[:2], 3, 4)
        return replace(self, columns=by_axis @ np.array([1.0, *point]))


@dataclass(frozen=True)
class PassingCandidate(Candidate):
    """A law as a candidate of a fit, which may hold the same effect for all the time.

    Its parameters have either sign: what acts may be a lack.
    """

    #: Number of its columns.
    n_coefficients: int = 0
    #: Numbers that describe it and its spans, beyond its columns.
    n_constants: int = 0

    @classmethod
    def from_law(cls, law: Law, n_numbers: int) -> PassingCandidate:
        """Return the candidate of a law that so many numbers describe."""
        k = law.columns.shape[2]
        return cls(
            key=(law.text, None),
            effect=law.effect,
            n_coefficients=k,
            n_constants=n_numbers - k,
        )

    @cached_property
    def text(self) -> str:
        """A name that no effect has."""
        return f"passing {self.key[0]}"

    @cached_property
    def nonnegative(self) -> list[bool]:
        """(k,) flags: no parameter has a sign of its own."""
        return [False] * self.n_coefficients

    @cached_property
    def plausible(self) -> Array:
        """(k,) NaN: nothing is known of its size."""
        return np.full(self.n_coefficients, np.nan)


def load_law(data: WhiteData) -> Law:
    """Return the law of a load: mass and first moments on the last link."""
    robot = data.estimate.robot
    effect = standard_effect("payload")(robot)
    columns = spread_columns(data.rows, effect)[:, :, :4]
    return Law("load", robot.links, effect, columns, 4)


#: Laws of one joint, by kind.
_OF_JOINTS: dict[str, type[Effect]] = {
    "torque": standard_effect("offset"),
    "friction": ChangedFriction,
}


def joint_laws(data: WhiteData, *kinds: str) -> list[Law]:
    """Return the laws of some kinds, one for each joint: a constant "torque", a change
    of dry "friction"."""
    laws = []
    for kind in kinds:
        for j in range(data.n):
            effect = _OF_JOINTS[kind](data.estimate.robot, [j])
            laws.append(Law(kind, j + 1, effect, spread_columns(data.rows, effect), 1))
    return laws


def force_laws(data: WhiteData) -> list[Law]:
    """Return the laws of a force, one for each link, the last link first."""
    robot = data.estimate.robot
    out = []
    for link in reversed(range(robot.links)):
        effect = LinkWeight(robot, link)
        columns = spread_columns(data.rows, effect)
        out.append(Law("force", link + 1, effect, columns, 6))
    return out


def point_of_force(gram: Array, right: Array, reach: float) -> tuple[Array, Array]:
    """Return the point at which a force on a link acts, and the force's covariance.

    The parameters of the link's weight are theta = (F_x, F_x p, F_y, F_y p, F_z, F_z
    p), with the force F and the point p. theta'G theta - 2 b'theta + |p|^2 / reach^2 is
    least.

    Parameters
    ----------
    gram, right
        G (12, 12) and b (12,).
    reach
        Standard deviation of the point about the link's origin [m].

    Returns
    -------
    (3,) array
        The point [m], in the link's frame.
    (3, 3) array
        Covariance of the force [N^2] with the point free, for noise of variance 1.
    """
    # With G = R'R: |R theta - R'^-1 b|^2.
    R = np.linalg.cholesky(regular(gram, gram)).T
    target = np.linalg.solve(R.T, right)

    def errors(both: Array) -> Array:
        """Return the errors (15,) of a force and a point, whose squares are summed."""
        theta = np.kron(both[:3], [1.0, *both[3:]])
        return np.concatenate([R @ theta - target, both[3:] / reach])

    def slopes(both: Array) -> Array:
        """Return the derivatives (15, 6) of the errors by force and point."""
        by_force = np.kron(np.eye(3), np.array([1.0, *both[3:]])[:, None])
        by_point = np.kron(both[:3, None], np.eye(4)[:, 1:])
        of_point = np.hstack([np.zeros((3, 3)), np.eye(3) / reach])
        return np.vstack([R @ np.hstack([by_force, by_point]), of_point])

    # The search begins at the origin, with the force that is best there.
    start = np.zeros(6)
    by_force = slopes(start)[:, :3]
    start[:3] = np.linalg.lstsq(by_force, -errors(start))[0]
    solution = scipy.optimize.least_squares(errors, start, slopes, x_scale="jac")
    covariance = np.linalg.inv(with_ridge(solution.jac.T @ solution.jac))
    return np.asarray(solution.x[3:], float), np.asarray(covariance[:3, :3], float)
