"""Which law a servo follows, and how late its command acts: from each joint's error alone, in radians.

A joint's own equation, divided by its gain, e = q_cmd(t - T) - q = (load + damping + ...) / kp, holds no
scale: every coefficient of every joint is free, linear least squares give them, and what they leave is
in rad. So neither the law nor the delay T can depend on what is known of masses or gains. The terms of
all laws, and the command's derivatives (Taylor's series in T about the last T), are compressed together:
each law at each delay is a small problem in the same numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.regression.instruments import paired
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
#: Folds of the motion; the longest delay, how far Taylor's series reaches, and the step at which a delay
#: is found [s]; steps at most, of each series.
_FOLDS, _LATEST, _REACH, _NEAR, _STEPS = 5, 0.1, 0.02, 2e-4, 12
#: What a wrong law of friction lets a gain too many lower the held-out error by: at most 1.19 on 25
#: simulated logs, where a gain that is missing raises it 1.24 times or more.
_LESS = 1.2
#: Terms of all laws; directions of the load's products, of unit columns, below this are noise.
_TERMS, _RANK = 7, 1e-10


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
            Parameter(f"term{m}_{j}", "", self.name, j + 1) for j in self.joints for m in range(_TERMS)
        )

    def blocks(self, motion: Motion) -> list[Block]:
        c, t = motion.told, motion.t - self.T
        rate = c.velocity(t)
        terms = (c.position(t), rate, np.gradient(rate, motion.t, axis=0), c.integral(t))
        every = np.stack([*terms, motion.q, motion.dq, motion.integral], axis=2)
        count = every.shape[2]
        return [Block(j, np.arange(count) + count * j, every[:, j]) for j in self.joints]


def _law(name: str, d: float) -> tuple[Array, Array]:
    """(7, 1 + m) the error e, and the m terms that it is made of, in the columns of _Terms, of a command
    that is d [s] later than those; and their slopes over d."""
    error = [[1.0, -d, 0.5 * d * d, 0.0, -1.0, 0.0, 0.0], [0.0, -1.0, d, 0.0, 0.0, 0.0, 0.0]]
    damping = [[0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0], [0.0] * 7]
    integral = [[-d, 0.5 * d * d, 0.0, 1.0, 0.0, 0.0, -1.0], [-1.0, d, 0.0, 0.0, 0.0, 0.0, 0.0]]
    position = [[0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0], [0.0] * 7]
    forward = [[0.0, 1.0, -d, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0]]
    own = {"servo_integral": integral, "servo_velocity_loop": position, "servo_feedforward": forward}
    terms = [error, damping, *(own[e] for e in LAWS[name] if e in own)]
    return np.array([t[0] for t in terms]).T, np.array([t[1] for t in terms]).T


@dataclass(frozen=True)
class _Beside:
    """A joint's terms beside its load, of some rows: products (7, 7) of the instruments' with the terms,
    and coefficients (k, 7) of the load in them."""

    products: Array
    load: Array

    @classmethod
    def of(cls, rows: _Rows) -> _Beside:
        Z, X, k = rows.Z, rows.X, rows.Z.shape[1] - _TERMS
        size = np.linalg.norm(Z[:, :k], axis=0)
        size = np.where(size > 0.0, size, 1.0)
        own = Z[:, :k] / size
        load = (
            np.linalg.pinv(own.T @ (X[:, :k] / size), rcond=_RANK) @ (own.T @ X[:, k:]) / size[:, None]
        )
        return cls(Z[:, k:].T @ (X[:, k:] - X[:, :k] @ load), load)

    def fitted(self, law: Array) -> Array:
        """(7,) what remains of the error, in the columns of the terms."""
        C = law[:, 1:].T @ self.products
        return np.asarray(law[:, 0] - law[:, 1:] @ np.linalg.lstsq(C @ law[:, 1:], C @ law[:, 0])[0])


class _Rows(NamedTuple):
    """Compressed rows of a joint: load, then terms, of the instruments and as measured."""

    Z: Array
    X: Array

    def left(self, fit: _Beside, error: Array) -> float:
        """Squares [rad^2] of what remains."""
        k = len(fit.load)
        return float(np.sum(((self.X[:, k:] - self.X[:, :k] @ fit.load) @ error) ** 2))


@dataclass(frozen=True)
class _Joint:
    """One joint: all rows, and fold by fold what training says of the tested ones."""

    rows: _Rows
    whole: _Beside
    folds: tuple[tuple[_Beside, _Rows], ...]


def find_law(
    load: Sequence[Effect],
    data: Measurements,
    settings: Preprocessing,
    names: Sequence[str] = tuple(LAWS),
    delay: float | None = None,
    about: float = 0.0,
) -> Law:
    """Of the laws among ``names`` whose held-out error is within one standard error of the least, by
    folds, or within what a law of friction gets wrong, the one with the fewest gains. delay : where it
    is known [s]; about : where it is sought."""
    while True:
        about = delay if delay is not None else about
        joints = _joints(load, data, settings, about)
        late = {name: 0.0 if delay is not None else _lateness(joints, name, about) for name in names}
        scores = {name: _score(joints, name, late[name]) for name in names}
        best = min(scores, key=lambda name: float(scores[name].mean()))
        for name in names:
            more = scores[name] - scores[best]
            if more.mean() <= max(2.0 * np.log(_LESS), more.std(ddof=1) / np.sqrt(len(more))):
                break
        found = about + late[name]
        if abs(late[name]) < 0.5 * _REACH or found >= _LATEST:
            ratios = {k: float(np.exp(0.5 * np.mean(s - scores[best]))) for k, s in scores.items()}
            return Law(name, found, ratios)
        about = found


def _joints(
    load: Sequence[Effect], data: Measurements, settings: Preprocessing, T: float
) -> list[_Joint]:
    """Of each joint, about a delay T."""
    robot = load[0].robot
    model = Model(robot, (*load, _Terms(robot, T)), changes=True)
    split = phase_folds(data, settings, _FOLDS)
    cells = compress_cells(data, model, settings, split, paired=True)
    out = []
    for joint in range(robot.n):
        parts = {
            f.block: paired(f.indices, f.triangle, cells.p) for f in cells.factors if f.joint == joint
        }
        every = {b: _Rows(Z[:, :-1], X[:, :-1]) for b, (_, Z, X) in parts.items()}
        whole, folds = _stacked(every.values()), []
        for fold in range(_FOLDS):
            train = [every[b] for b in split.training(fold) if b in every]
            test = [every[b] for b in split.tested(fold) if b in every]
            if train and test:
                folds.append((_Beside.of(_stacked(train)), _stacked(test)))
        out.append(_Joint(whole, _Beside.of(whole), tuple(folds)))
    return out


def _stacked(parts: Iterable[_Rows]) -> _Rows:
    return _Rows(*(np.vstack(x) for x in zip(*parts, strict=True)))


def _lateness(joints: Sequence[_Joint], name: str, about: float) -> float:
    """The delay [s] of a law beyond that of the terms, by Gauss-Newton steps that all joints share."""
    low, high, d = max(-_REACH, -about), min(_REACH, _LATEST - about), 0.0
    for _ in range(_STEPS):
        law, slopes = _law(name, d)
        moment = slope = 0.0
        for joint in joints:
            C = joint.whole.products
            S = law[:, 1:]
            x = np.linalg.lstsq(S.T @ C @ S, S.T @ C @ law[:, 0])[0]
            error, late = law[:, 0] - S @ x, slopes[:, 0] - slopes[:, 1:] @ x
            # Beside the law's own terms, as the error is.
            beside = late - S @ np.linalg.lstsq(S.T @ C @ S, S.T @ C @ late)[0]
            across = late - S @ np.linalg.lstsq(S.T @ C.T @ S, S.T @ C.T @ late)[0]
            weight = 1.0 / max(joint.rows.left(joint.whole, error), 1e-300)
            moment += weight * float(across @ C @ error)
            slope += weight * float(across @ C @ beside)
        before, d = d, float(np.clip(d - moment / slope, low, high)) if slope > 0.0 else d
        if abs(d - before) < _NEAR:
            break
    return d


def _score(joints: Sequence[_Joint], name: str, delay: float) -> Array:
    """(folds,) mean over the joints of ln of the squared held-out error."""
    law, _ = _law(name, delay)
    left = [[test.left(fit, fit.fitted(law)) for fit, test in joint.folds] for joint in joints]
    return np.asarray(np.mean(np.log(np.maximum(left, 1e-300)), axis=0))
