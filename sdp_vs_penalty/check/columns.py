"""The columns of an arm, and what of them can be had without asking the arm again.

Columns are linear in the vector of gravity; what is no weight goes with the square of the speed; and
with the zero of one joint they change as a trigonometric polynomial of second degree (a revolute joint)
or a quadratic one (a prismatic joint), since poses enter the kinetic energy twice and weight once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check.own import Own, own_effects
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import JointColumns, Model
from sdp_vs_penalty.regression.base_parameters import random_motion, structure
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot

#: States that tell which parameters of the links are independent, for each joint.
_STATES = 12


class Data(Protocol):
    """As much of :class:`~sdp_vs_penalty.check.physics.Physics` as its columns follow from."""

    @property
    def model(self) -> Model: ...
    @property
    def motion(self) -> Motion: ...
    @property
    def own(self) -> Own | None: ...
    @property
    def independent(self) -> NDArray[np.bool_] | None: ...


def independent_of(model: Model, nominal: Array) -> tuple[NDArray[np.bool_], Array]:
    """(p,) which parameters stand for all, wherever gravity points, and nominal ones (p,) in these.

    A link's mass and what lies along its axis act like another link's: 30 to 40 % of the columns follow
    from the others, and with these the normal equations are solved several times as fast.
    """
    links, nominal = model.rigid_indices, nominal.copy()
    kept = np.ones(len(model.parameters), bool)
    if len(links):
        motion = random_motion(model.robot, 0, _STATES * model.robot.n)
        turned = [replace(model.robot, gravity=tuple(g)) for g in 9.81 * np.eye(3)]
        stack = np.vstack([r.regressor(motion.q, motion.dq, motion.ddq) for r in turned])
        base, independent = structure(stack.reshape(-1, len(links)))
        kept[links] = np.isin(np.arange(len(links)), independent)
        lumped = base @ nominal[links]
        nominal[links] = 0.0
        nominal[links[list(independent)]] = lumped
    return kept, nominal


def columns_of(physics: Data, model: Model) -> list[JointColumns]:
    """Per joint the columns of this model at the data's motion."""
    own = physics.own
    effects = [] if own is None else own_effects(model)
    rest = [k for k in range(len(model.effects)) if k not in effects]
    where = np.concatenate([np.arange(0), *(model.indices[k] for k in rest)]).astype(np.intp)
    made = [
        JointColumns(np.zeros(0, np.intp), np.zeros((len(physics.motion.t), 0)))
    ] * physics.model.robot.n
    if rest:
        made = Model(model.robot, tuple(model.effects[k] for k in rest)).columns(physics.motion)
    made = [JointColumns(where[c.indices], c.columns) for c in made]
    if physics.independent is not None:
        seen = [physics.independent[c.indices] for c in made]
        made = [JointColumns(c.indices[k], c.columns[:, k]) for c, k in zip(made, seen, strict=True)]
    if own is None:
        return made
    return [
        JointColumns(np.append(c.indices, i), np.hstack([c.columns, x]))
        for c, i, x in zip(made, own.indices, own.columns, strict=True)
    ]


def added(parts: Iterable[tuple[float | Array, list[JointColumns]]]) -> list[JointColumns]:
    """Columns of the same parameters, each times a factor (or one a joint), added."""
    factors, columns = zip(*parts, strict=True)
    n = len(columns[0])
    each = np.array([np.broadcast_to(f, n) for f in factors])
    return [
        JointColumns(same[0].indices, np.tensordot(k, [c.columns for c in same], 1))
        for k, same in zip(each.T, zip(*columns, strict=True), strict=True)
    ]


def slowed(
    still: list[JointColumns], weight: list[JointColumns], factor: float, links: int
) -> list[JointColumns]:
    """Columns of the links where time is ``factor`` times as long: what is no weight goes with dq^2."""
    return [
        replace(s, columns=np.where(s.indices < links, factor**-2, 1.0) * s.columns + g.columns)
        for s, g in zip(still, weight, strict=True)
    ]


def only_links(physics: Data) -> bool:
    """Whether columns are those of links and of each joint's own motion, the joints moved one by one."""
    model = physics.model
    own = own_effects(model) if physics.own is not None else []
    rest = [e.name for k, e in enumerate(model.effects) if k not in own]
    at_start = bool(len(model.rigid_indices)) and model.rigid_indices[0] == 0
    return rest == ["rigid_body"] and at_start and model.robot.mechanism is None


def interpolation(kind: str) -> tuple[list[float], Callable[[float], Array]]:
    """Zeros of a joint at which columns have to be made, and the share of each in those at any zero."""
    if kind == "revolute":
        places = (2.0 * np.pi / 5.0 * np.arange(5.0)).tolist()
        basis = _waves
    else:
        places, basis = [0.0, -1.0, 1.0], _powers
    inverse = np.asarray(np.linalg.inv([basis(x) for x in places]), float)
    return places, partial(_shares, basis, inverse)


def _shares(basis: Callable[[float], Sequence[float]], inverse: Array, x: float) -> Array:
    return np.asarray(np.array(basis(x)) @ inverse)


def _waves(x: float) -> Sequence[float]:
    return [1.0, np.cos(x), np.sin(x), np.cos(2.0 * x), np.sin(2.0 * x)]


def _powers(x: float) -> Sequence[float]:
    return [1.0, x, x * x]


def turned_gravity(model: Model, gravity: Sequence[float]) -> Model:
    """The same model under another vector of gravity."""
    x, y, z = (float(g) for g in gravity)
    robot: Robot = replace(model.robot, gravity=(x, y, z))
    return Model(robot, tuple(type(e)(robot, e.asked_joints, **e.shape) for e in model.effects))


def hermite(at: Array, t: Array, x: Array, slope: Array) -> Array:
    """Cubic interpolation of x (M,) with known slopes; constant beyond the ends."""
    at = np.clip(at, t[0], t[-1])
    k = np.clip(np.searchsorted(t, at, "right") - 1, 0, len(t) - 2)
    h = np.maximum(t[k + 1] - t[k], np.finfo(float).tiny)  # a clock that stands still for a sample
    u = (at - t[k]) / h
    value = (1.0 + 2.0 * u) * (1.0 - u) ** 2 * x[k] + u**2 * (3.0 - 2.0 * u) * x[k + 1]
    return np.asarray(value + h * (u * (1.0 - u) ** 2 * slope[k] - u**2 * (1.0 - u) * slope[k + 1]))


def wide_columns(model: Model, motion: Motion) -> list[Array]:
    """Per joint (M, p) the columns of all parameters."""
    return [block.wide(len(model.parameters)) for block in model.columns(motion)]
