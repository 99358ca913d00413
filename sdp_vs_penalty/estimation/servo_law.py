"""Which law a servo follows, and how late its command acts: from each joint's error alone, in radians.

A joint's own equation, divided by its gain, e = q_cmd(t - T) - q = (load + damping + ...) / kp, holds no
scale: every coefficient of every joint is free, linear least squares give them, and what they leave is
in rad. So neither the law nor the delay T can depend on what is known of masses or gains. The terms of
all laws, and the command's derivatives (Taylor's series in T about the last T), are compressed together:
each law at each delay is a small problem in the same numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.servo import LATEST
from sdp_vs_penalty.estimation.constants import (
    DELAY_GRID,
    DELAY_REACH,
    FEWER_GAINS,
    SEEN_DELAY,
    SHAPE_FOLDS,
    TURNS,
)
from sdp_vs_penalty.regression.partial import visible
from sdp_vs_penalty.regression.regression import compress_cells
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.phases import phase_folds
from sdp_vs_penalty.signals.preprocessing import Preprocessing

#: The laws, those with fewer gains first, and their effects.
LAWS = {
    "PD": ("servo_position",),
    "PD with feed-forward": ("servo_position", "servo_feedforward"),
    "PID": ("servo_position", "servo_integral"),
    "PID with feed-forward": ("servo_position", "servo_integral", "servo_feedforward"),
    "cascade": ("servo_position", "servo_integral", "servo_velocity_loop"),
    "cascade with feed-forward": (
        "servo_position",
        "servo_integral",
        "servo_velocity_loop",
        "servo_feedforward",
    ),
}


@dataclass(frozen=True)
class Law:
    """name : of the law in LAWS; delay : of the command [s]; errors : held-out error of each law over
    that of the best."""

    name: str
    delay: float
    errors: dict[str, float]


class _Terms(Effect):
    """Of each joint what the laws are made of: the command, its two derivatives and its integral at
    t - T, and position, velocity and integral."""

    name, count = "servo_terms", 7
    equation = explanation = reference = ""

    def __init__(self, robot: Robot, T: float) -> None:
        super().__init__(robot)
        self.T = T

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"term{m}_{j}", "", self.name, j + 1)
            for j in self.joints
            for m in range(self.count)
        )

    def blocks(self, motion: Motion) -> list[Block]:
        c, t = motion.told, motion.t - self.T
        rate = c.velocity(t)
        terms = (c.position(t), rate, np.gradient(rate, motion.t, axis=0), c.integral(t))
        every = np.stack([*terms, motion.q, motion.dq, motion.integral], axis=2)
        own = np.arange(self.count)
        return [Block(j, own + self.count * j, every[:, j]) for j in self.joints]


def _law(name: str, d: float) -> Array:
    """(7, 1 + m) the error e, and the m terms that it is made of, in the columns of _Terms, of a command
    that is d [s] later than those."""
    h = 0.5 * d * d
    terms = [[1.0, -d, h, 0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]]
    own = {
        "servo_integral": [-d, h, 0.0, 1.0, 0.0, 0.0, -1.0],
        "servo_velocity_loop": [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
        "servo_feedforward": [0.0, 1.0, -d, 0.0, 0.0, 0.0, 0.0],
    }
    return np.array([*terms, *(own[e] for e in LAWS[name] if e in own)]).T


class _Joint(NamedTuple):
    """One joint's terms beside its load, compressed: (r, 7) of all rows, and of each fold what training
    says, those trained on and those tested."""

    whole: Array
    folds: list[tuple[Array, Array]]


def find_law(
    load: Sequence[Effect],
    data: Measurements,
    settings: Preprocessing,
    names: Sequence[str] = tuple(LAWS),
    delay: float | None = None,
) -> Law:
    """Of the laws among ``names`` whose held-out error is within one standard error of the least, by
    folds, or within what a law of friction gets wrong, the one with the fewest gains; friction may turn
    over several velocities meanwhile. delay : where it is known [s]; else it is as small as none unless
    without it much more is left of motion left out."""
    wide: list[Effect] = []
    for e in load:
        free = "v_s" in e.shapes and "v_s" not in e.given
        wide += [e.with_shape(v_s=v) for v in TURNS] if free else [e]
    if not any(e.name == "torque_offset" for e in load):
        wide.append(effect_types()["torque_offset"](load[0].robot))
    about = delay or 0.0
    first = joints = _joints(wide, data, settings, about)
    while True:
        late = {name: 0.0 if delay is not None else _later(joints, name, about) for name in names}
        scores = {name: _score(joints, name, late[name]) for name in names}
        best = min(scores, key=lambda name: float(scores[name].mean()))
        for name in names:
            more = scores[name] - scores[best]
            if more.mean() <= max(2.0 * np.log(FEWER_GAINS), more.std(ddof=1) / np.sqrt(len(more))):
                break
        found = about + late[name]
        if abs(late[name]) < DELAY_REACH - 0.5 * DELAY_GRID or found >= LATEST:
            without = float(np.mean(_score(first, name, 0.0) - scores[name]))
            found = found if delay is not None or without > 2.0 * np.log(SEEN_DELAY) else 0.0
            ratios = {k: float(np.exp(0.5 * np.mean(s - scores[best]))) for k, s in scores.items()}
            return Law(name, found, ratios)
        about = found
        joints = _joints(wide, data, settings, about)


def _joints(
    load: Sequence[Effect], data: Measurements, settings: Preprocessing, T: float
) -> list[_Joint]:
    """Of each joint, about a delay T."""
    robot = load[0].robot
    model = Model(robot, (*load, _Terms(robot, T)), changes=True)
    split = phase_folds(data, settings, SHAPE_FOLDS)
    cells = compress_cells(data, model, settings, split)
    out = []
    for joint in range(robot.n):
        every = {f.block: f.triangle[:, :-1] for f in cells.factors if f.joint == joint}
        folds = []
        for fold in range(SHAPE_FOLDS):
            train = [every[b] for b in split.training(fold) if b in every]
            test = [every[b] for b in split.tested(fold) if b in every]
            if train and test:
                folds.append(_beside(np.vstack(train), np.vstack(test)))
        rows = np.vstack(list(every.values()))
        out.append(_Joint(_beside(rows, rows)[0], folds))
    return out


def _beside(train: Array, test: Array) -> tuple[Array, Array]:
    """(r, 7), (s, 7) terms beside the load of rows (r, k + 7), (s, k + 7), by the first ones' fit."""
    U, V = visible(train[:, : -_Terms.count])
    made = U.T @ train[:, -_Terms.count :]
    rest = np.asarray(np.linalg.qr(train[:, -_Terms.count :] - U @ made, mode="r"))
    return rest, test[:, -_Terms.count :] - test[:, : -_Terms.count] @ (V @ made)


def _fitted(terms: Array, law: Array) -> Array:
    """(7,) the error and what least squares make of it, in the columns of the terms (r, 7)."""
    return np.asarray(law[:, 0] - law[:, 1:] @ np.linalg.lstsq(terms @ law[:, 1:], terms @ law[:, 0])[0])


def _later(joints: Sequence[_Joint], name: str, about: float) -> float:
    """The delay [s] of a law beyond that of the terms with which least remains of all joints."""
    grid = np.arange(-DELAY_REACH, DELAY_REACH + DELAY_GRID, DELAY_GRID)
    grid = grid[(about + grid >= -1e-9) & (about + grid <= LATEST)]
    laws = [_law(name, d) for d in grid]
    left = [[np.sum((j.whole @ _fitted(j.whole, law)) ** 2) for j in joints] for law in laws]
    return float(grid[np.argmin(np.log(np.maximum(left, 1e-300)).sum(axis=1))])


def _score(joints: Sequence[_Joint], name: str, delay: float) -> Array:
    """(folds,) mean over the joints of ln of the squared held-out error."""
    law = _law(name, delay)
    left = [[np.sum((test @ _fitted(train, law)) ** 2) for train, test in j.folds] for j in joints]
    return np.asarray(np.mean(np.log(np.maximum(left, 1e-300)), axis=0))
