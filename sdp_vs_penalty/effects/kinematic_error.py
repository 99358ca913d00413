"""A joint that stands beside where the kinematics put it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.hidden import Hidden, World
from sdp_vs_penalty.robot.robot import Robot

#: Of the acceleration's root mean square: what is lost where columns are computed at fewer instants.
_THINNED = 1e-3
_FEWEST = 200


class KinematicError(Effect):
    name = "kinematic_error"
    equation = "sum_k e_k dID/d(placement of joint j)_k"
    explanation = (
        "Joint j is mounted beside where the model's kinematics say, by a displacement and a small "
        "rotation in its own frame: a calibration would tell. Gravity and inertia of all that it "
        "carries act elsewhere. (Along the joint's own axis it is a joint_zero_error, of the first "
        "joint a base_tilt.)"
    )
    reference = "Mooring, Roth, Driels, Fundamentals of Manipulator Calibration, 1991, ch. 3"
    needs_links = True
    sized_by = slice(-2, None)  # the rotation, which moves gravity's torque most
    one_number = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{symbol}_{j + 1}", unit, self.name, j + 1)
            for j in self.joints
            for symbol, unit in self._symbols(j)
        )

    def _symbols(self, joint: int) -> list[tuple[str, str]]:
        turns, moves = self.robot.placement_axes(joint)
        return [(f"d{k + 1}", "m") for k in range(len(moves))] + [
            (f"r{k + 1}", "rad") for k in range(len(turns))
        ]

    @classmethod
    def starts(cls, robot: Robot, joint: int) -> Iterable[dict[str, float]]:
        return [] if robot.joints[joint].parent == -1 else [{}]

    def blocks(self, motion: Motion) -> list[Block]:
        few = _thinned(motion)
        q, dq, ddq = (x[few] for x in (motion.q, motion.dq, motion.ddq))
        parts = []
        for j in self.joints:
            turns, moves = self.robot.placement_axes(j)
            by = self.robot.placement_derivatives(motion.model_links, q, dq, ddq, j)
            parts.append(np.concatenate([by[:, :, :3] @ moves.T, by[:, :, 3:] @ turns.T], axis=2))
        columns = np.concatenate(parts, axis=2)
        if len(few) < len(motion.t):
            from scipy.interpolate import CubicSpline

            columns = CubicSpline(motion.t[few], columns)(motion.t)
        every = np.arange(columns.shape[2])
        return [Block(i, every, columns[:, i]) for i in range(self.robot.n)]


def _thinned(motion: Motion) -> np.ndarray:
    """Instants from which splines give back the acceleration, the roughest part of a motion."""
    from scipy.interpolate import CubicSpline

    every = np.arange(len(motion.t))
    if len(every) < _FEWEST:
        return every
    for stride in (16, 8, 4, 2):
        few = np.unique(np.append(every[::stride], every[-1]))
        error = CubicSpline(motion.t[few], motion.ddq[few])(motion.t) - motion.ddq
        if np.all(error.std(axis=0) <= _THINNED * motion.ddq.std(axis=0)):
            return few
    return every


def hidden(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    robot = world.robot
    turns, moves = robot.placement_axes(joint)
    slip, turn = 1e-4 * rng.normal(size=len(moves)), 2e-4 * rng.normal(size=len(turns))

    def torque(w: World, m: Motion, a: float) -> Array:
        pose, angle = np.eye(4), a * turn @ turns
        size = float(np.linalg.norm(angle))
        k = np.cross(np.eye(3), angle / size)  # Rodrigues
        pose[:3, :3] += np.sin(size) * k + (1.0 - np.cos(size)) * k @ k
        pose[:3, 3] = a * slip @ moves
        joints = list(w.robot.joints)
        joints[joint] = replace(joints[joint], placement=joints[joint].placement @ pose)
        beside = replace(w, robot=replace(w.robot, joints=tuple(joints)))
        return beside.rigid(m) - w.rigid(m)

    return Hidden("kinematic_error", (joint,), torque, theta=(*slip.tolist(), *turn.tolist()))
