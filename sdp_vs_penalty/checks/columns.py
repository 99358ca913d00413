"""The columns of an arm's torque: those that joints share, and those of each joint's own motion.

Own columns are what friction, a rotor and an offset may look like. Beside the model's they hold laws
that the model may lack (a rotor, sharper and rounder Coulomb friction, bristles that bend before they
slide, Dahl 1968): what they explain is the model's matter, and no fault of the log.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.bristles import dahl
from sdp_vs_penalty.effects.effect import JointEffect, Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.regression.base_parameters import random_motion, structure
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot

#: Velocities over which Coulomb friction may turn [rad/s, m/s]: from a sign to a smooth one.
_WIDTHS = (0.002, 0.03, 0.1)
#: Travels over which bristles bend before they slide [rad, m] (gears: 2e-4 to 2e-2).
_TRAVELS = (5e-4, 5e-3)
#: States that tell which parameters of the links are independent, for each joint.
_STATES = 12


def own_effects(model: Model) -> list[int]:
    """Which of the model's effects have one column on every joint, made by that joint's motion."""
    every = list(range(model.robot.n))
    return [
        k for k, e in enumerate(model.effects) if isinstance(e, JointEffect) and list(e.joints) == every
    ]


def shared_model(model: Model) -> Model | None:
    """The model without these: the links, couplings."""
    own = own_effects(model)
    rest = tuple(e for k, e in enumerate(model.effects) if k not in own)
    return Model(model.robot, rest) if rest else None


def own_columns(model: Model, motion: Motion) -> list[Array]:
    """(N, n) blocks: a rotor, an offset, then everything that resists the motion."""
    effects = [e for k in own_effects(model) if isinstance(e := model.effects[k], JointEffect)]
    friction = [e for e in effects if "friction" in e.name]
    laws = [np.column_stack([e.column(motion, j) for j in range(model.robot.n)]) for e in friction]
    laws += [np.tanh(motion.dq / w) for w in _WIDTHS]
    laws += [np.column_stack([dahl(q, d) for q in motion.q.T]) for d in _TRAVELS]
    return [motion.ddq, np.ones_like(motion.q), motion.dq, *laws]


def independent_columns(model: Model) -> NDArray[np.bool_]:
    """(p,) which parameters of :func:`shared_model` stand for all, wherever gravity points: 30 to 40 %
    of the links' follow from the others."""
    links = model.rigid_indices
    kept = np.ones(len(model.parameters), bool)
    if len(links):
        motion = random_motion(model.robot, 0, _STATES * model.robot.n)
        turned = [replace(model.robot, gravity=tuple(g)) for g in 9.81 * np.eye(3)]
        stack = np.vstack([r.regressor(motion.q, motion.dq, motion.ddq) for r in turned])
        _, independent = structure(stack.reshape(-1, len(links)))
        kept[links] = np.isin(np.arange(len(links)), independent)
    return kept


def under_gravity(model: Model, gravity: Sequence[float]) -> Model:
    """The same model under another vector of gravity."""
    x, y, z = (float(g) for g in gravity)
    if (x, y, z) == tuple(model.robot.gravity):
        return model
    robot: Robot = replace(model.robot, gravity=(x, y, z))
    return Model(robot, tuple(type(e)(robot, e.asked_joints, **e.shape) for e in model.effects))
