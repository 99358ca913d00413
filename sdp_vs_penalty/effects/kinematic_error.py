"""Joints that stand beside where the kinematics put them."""

from collections.abc import Iterable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Array, Effect, Motion
from sdp_vs_penalty.robot.robot import Robot

#: What may be expected of an arm that nobody has calibrated: displacements [m] and turns [rad].
_SLIP, _TURN = 2e-3, 4e-3
#: Of the acceleration's root mean square: what is lost where columns are computed at fewer instants.
_THINNED = 0.02
_FEWEST = 200


class KinematicError(Effect):
    name = "kinematic_error"
    equation = "sum_jk e_jk dID/d(placement of joint j)_k"
    explanation = (
        "The joints are mounted beside where the model's kinematics say, by small displacements and "
        "rotations in their own frames: a calibration would tell. Gravity and inertia act elsewhere. "
        "Single parameters are known no better than their intervals say; the torque is that of all."
    )
    reference = "Mooring, Roth, Driels, Fundamentals of Manipulator Calibration, 1991, ch. 3"
    needs_links = True
    whole_robot = True
    signless = True

    def named(self, joint: int) -> Iterable[tuple[str, str]]:
        kinds = [("slip", "m") if k < 3 else ("turn", "rad") for _, k in self._places]
        places = zip(kinds, self._places, strict=True)
        return [(f"{word}_{'xyz'[k % 3]}{j + 1}", unit) for (word, unit), (j, k) in places]

    @cached_property
    def _places(self) -> list[tuple[int, int]]:
        """Joint of the tree and axis (three displacements, then three rotations), displacements first:
        those that can make torque. A joint on the base feels no more than where gravity points."""
        gravity, out = np.array(self.robot.gravity), list[tuple[int, int]]()
        for j, joint in enumerate(self.robot.tree):
            down = joint.placement[:3, :3].T @ gravity
            across = [k for k in range(3, 6) if np.hypot(*np.delete(down, k - 3)) > 1e-6]
            out += [(j, k) for k in (across if joint.parent == -1 else range(6))]
        return sorted(out, key=lambda place: place[1] >= 3)

    @property
    def plausible(self) -> Array:
        return np.array([_SLIP if k < 3 else _TURN for _, k in self._places])

    @property
    def sized_by(self) -> slice:  # type: ignore[override]
        """The rotations, which move gravity's torque most."""
        return slice(sum(k < 3 for _, k in self._places), None)

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        return [{}] if cls(robot).parameters else []

    def torques(self, motion: Motion) -> Array:
        from scipy.interpolate import CubicSpline

        few = _thinned(motion)
        q, dq, ddq = (x[few] for x in (motion.q, motion.dq, motion.ddq))
        by = self.robot.placement_derivatives(motion.model_links, q, dq, ddq)
        columns = np.stack([by[:, :, j, k] for j, k in self._places], axis=2)
        return columns if len(few) == len(motion.t) else CubicSpline(motion.t[few], columns)(motion.t)


def _thinned(motion: Motion) -> NDArray[np.intp]:
    """Instants from which splines give back the acceleration, the roughest part of a motion; all of
    them where they are no series, such as a simulation's states."""
    from scipy.interpolate import CubicSpline

    every = np.arange(len(motion.t))
    if len(every) < _FEWEST or np.any(np.diff(motion.t) <= 0.0):
        return every
    for stride in (16, 8, 4, 2):
        few = np.unique(np.append(every[::stride], every[-1]))
        error = CubicSpline(motion.t[few], motion.ddq[few])(motion.t) - motion.ddq
        if np.all(error.std(axis=0) <= _THINNED * motion.ddq.std(axis=0)):
            return few
    return every
