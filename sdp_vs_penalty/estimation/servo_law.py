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

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model
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
#: Folds of the motion; the longest delay, and how far Taylor's series reaches [s]; delays tried on the
#: way; and the change at which the series is made anew about another delay [s].
_FOLDS, _LATEST, _REACH, _TRIED, _NEAR = 5, 0.1, 0.02, 41, 2e-3
#: What a wrong law of friction lets a gain too many lower the held-out error by: at most 1.12 on 25
#: simulated logs, where a gain that is missing raises it 1.7 times or more.
_LESS = 1.25
#: Directions of the load, of unit columns, shorter than this are noise.
_RANK = 1e-5


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

    name = "servo_terms"
    equation = explanation = reference = ""

    def __init__(self, robot: Robot, T: float) -> None:
        super().__init__(robot)
        self.T = T

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"term{m}_{j}", "", self.name, j + 1)
            for j in self.joints
            for m in range(_law("PD", 0.0).shape[0])
        )

    def blocks(self, motion: Motion) -> list[Block]:
        c, t = motion.told, motion.t - self.T
        rate = c.velocity(t)
        terms = (c.position(t), rate, np.gradient(rate, motion.t, axis=0), c.integral(t))
        every = np.stack([*terms, motion.q, motion.dq, motion.integral], axis=2)
        count = every.shape[2]
        return [Block(j, np.arange(count) + count * j, every[:, j]) for j in self.joints]


def _law(name: str, d: float) -> Array:
    """(7, 1 + m) the error e, and the m terms that it is made of, in the columns of _Terms, of a command
    that is d [s] later than those."""
    error = [1.0, -d, 0.5 * d * d, 0.0, -1.0, 0.0, 0.0]
    damping = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    integral = [-d, 0.5 * d * d, 0.0, 1.0, 0.0, 0.0, -1.0]
    position = [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]
    forward = [0.0, 1.0, -d, 0.0, 0.0, 0.0, 0.0]
    own = {"servo_integral": integral, "servo_velocity_loop": position, "servo_feedforward": forward}
    return np.array([error, damping, *(own[e] for e in LAWS[name] if e in own)]).T


@dataclass(frozen=True)
class _Joint:
    """A joint's terms (., 7) beside its load: of all rows, and fold by fold of those for training, with
    the tested ones' errors as products (7, 7)."""

    whole: Array
    folds: tuple[tuple[Array, Array], ...]

    def left(self, law: Array) -> float:
        """Squares of the errors [rad^2] that a law leaves."""
        return float(np.sum((self.whole @ _fitted(self.whole, law)) ** 2))

    def held_out(self, law: Array) -> Array:
        """(folds,) of the errors on motion left out."""
        found = [(_fitted(own, law), products) for own, products in self.folds]
        return np.array([u @ products @ u for u, products in found])


def _fitted(own: Array, law: Array) -> Array:
    """(7,) what remains of the error in the columns of the terms."""
    rows = own @ law
    return np.asarray(law[:, 0] - law[:, 1:] @ np.linalg.lstsq(rows[:, 1:], rows[:, 0], rcond=None)[0])


def _beside(rows: Array, k: int) -> tuple[Array, Array]:
    """The terms beside the load, which has the first k columns, and its coefficients (k, 7) of them."""
    load = rows[:, :k]
    size = np.linalg.norm(load, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    coefficients = np.linalg.pinv(load / size, rcond=_RANK) @ rows[:, k:] / size[:, None]
    return np.linalg.qr(rows[:, k:] - load @ coefficients, mode="r"), coefficients


def find_law(
    load: Sequence[Effect],
    data: Measurements,
    settings: Preprocessing,
    names: Sequence[str] = tuple(LAWS),
    delay: float | None = None,
) -> Law:
    """Of the laws among ``names`` whose held-out error is within one standard error of the least, by
    folds, or within what a law of friction gets wrong, the one with the fewest gains. delay : where it
    is known [s]."""
    about, span = (0.0, (0.0, _REACH)) if delay is None else (delay, (0.0, 0.0))
    while True:
        joints = _joints(load, data, settings, about)
        late = {name: _latest(joints, name, span) for name in names}
        scores = {name: _score(joints, name, late[name]) for name in names}
        best = min(scores, key=lambda name: float(scores[name].mean()))
        for name in names:
            more = scores[name] - scores[best]
            if more.mean() <= max(2.0 * np.log(_LESS), more.std(ddof=1) / np.sqrt(len(more))):
                break
        found = about + late[name]
        if delay is not None or abs(late[name]) <= _NEAR or found >= _LATEST:
            ratios = {k: float(np.exp(0.5 * np.mean(s - scores[best]))) for k, s in scores.items()}
            return Law(name, found, ratios)
        about = found
        span = (-min(_REACH, about), _REACH)


def _joints(
    load: Sequence[Effect], data: Measurements, settings: Preprocessing, T: float
) -> list[_Joint]:
    """Of each joint that moves, about a delay T."""
    robot = load[0].robot
    model = Model(robot, (*load, _Terms(robot, T)), changes=True)
    split = phase_folds(data, settings, _FOLDS)
    cells = compress_cells(data, model, settings, split)
    terms = len(_law("PD", 0.0))
    out = []
    for joint in range(robot.n):
        rows = {f.block: f.triangle[:, :-1] for f in cells.factors if f.joint == joint}
        k = next(iter(rows.values())).shape[1] - terms
        whole, _ = _beside(np.vstack(list(rows.values())), k)
        folds = []
        for fold in range(_FOLDS):
            train = [rows[b] for b in split.training(fold) if b in rows]
            test = [rows[b] for b in split.tested(fold) if b in rows]
            if train and test:
                own, coefficients = _beside(np.vstack(train), k)
                there = np.vstack(test)
                left = there[:, k:] - there[:, :k] @ coefficients
                folds.append((own, left.T @ left))
        out.append(_Joint(whole, tuple(folds)))
    return out


def _latest(joints: Sequence[_Joint], name: str, span: tuple[float, float]) -> float:
    """The delay [s], beyond that of the terms, with which a law leaves least of all joints' errors."""
    tried = np.linspace(*span, _TRIED) if span[1] > span[0] else np.array([0.0])
    for _ in range(2 if len(tried) > 1 else 1):
        left = [sum(np.log(max(j.left(_law(name, d)), 1e-300)) for j in joints) for d in tried]
        best = float(tried[int(np.argmin(left))])
        step = tried[1] - tried[0] if len(tried) > 1 else 0.0
        tried = np.clip(best + step * np.linspace(-1.0, 1.0, 11), *span)
    return best


def _score(joints: Sequence[_Joint], name: str, delay: float) -> Array:
    """(folds,) mean over the joints of ln of the squared held-out error."""
    law = _law(name, delay)
    return np.asarray(np.mean([np.log(np.maximum(j.held_out(law), 1e-300)) for j in joints], axis=0))
