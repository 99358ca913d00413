"""The function of a plain model, without loops: one expression a number, for a robot's own constants.

Recursive Newton-Euler (Luh, Walker, Paul 1980) in the joints' frames. Every constant is written in, and
what is multiplied by zero is not written at all, so that a call costs microseconds in plain Python; of
NumPy arrays the same text makes arrays.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.export.content import about, number
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.joint import Joint

#: Effects that the expressions hold.
PLAIN = frozenset(
    {"rigid_body", "viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia"}
)
#: A number, or the code of one.
Scalar: TypeAlias = "float | _Sum"
Vector = NDArray[Any]

_PLAIN = '''\
"""Joint torques of {robot}, identified by {method}; written by sdp-vs-penalty {version}.

    tau = torque(q, dq, ddq)        # (n,) or (N, n): rad or m, /s, /s^2 -> N m or N

Joints in order: {joints}.
Effects: {effects}.
Needs NumPy; nothing of sdp-vs-penalty. One sample takes microseconds: it is computed without arrays.
"""

import math

import numpy as np

#: Parameter values, in the order of NAMES; the function below has them written in.
THETA = np.array({theta})
NAMES = {names}
NEEDS_TIME = []


def torque(q, dq, ddq, t=None, temperature=None):
    """Modelled joint torques, of the shape of q."""
    if np.ndim(q) == 1:
        states = (x.tolist() if hasattr(x, "tolist") else x for x in (q, dq, ddq))
        return np.array(_torque(*states, math.sin, math.cos, math.tanh))
    states = (np.asarray(x, float).T for x in (q, dq, ddq))
    made = _torque(*states, np.sin, np.cos, np.tanh)
    return np.stack([np.broadcast_to(x, len(q)) for x in made], axis=-1)


def _torque(q, dq, ddq, sin, cos, tanh):
{lines}
    return [{taus}]
'''


def is_plain(estimate: Estimate) -> bool:
    """Whether the expressions hold all of a model."""
    model, robot = estimate.model, estimate.robot
    whole = len(model.rigid_indices) > 0 and robot.mechanism is None and model.gains is None
    return whole and all(effect.name in PLAIN for effect in model.effects)


def plain_function(estimate: Estimate) -> bytes:
    """Source of a module with ``torque(q, dq, ddq)``, of a plain model."""
    robot, lines = estimate.robot, torque_lines(estimate)
    for name, states in (("q", "q"), ("v", "dq"), ("a", "ddq")):
        lines.insert(0, f"{', '.join(f'{name}{i + 1}' for i in range(robot.n))}, = {states}")
    text = _PLAIN.format(
        **about(estimate),
        taus=", ".join(f"tau{i + 1}" for i in range(robot.n)),
        lines=textwrap.indent("\n".join(lines), "    "),
    )
    return text.encode()


def torque_lines(estimate: Estimate) -> list[str]:
    """Statements that make tau1 ... taun from q1 ..., v1 ... (velocities) and a1 ... (accelerations),
    with sin, cos and tanh: Python's and C's alike. Effects that are not PLAIN are left out."""
    code, robot, friction = _Code(), estimate.robot, _friction(estimate)
    none: Vector = np.array([0.0] * 3, object)
    base = none, none, -np.array(robot.gravity, float).astype(object)
    states: list[tuple[Vector, Vector, Vector]] = []
    poses, force, moment = [], [], []
    for i, joint in enumerate(robot.joints):
        link = inertia.transform(joint.link_frame) @ estimate.links[i]
        m, h = float(link[0]), link[1:4].astype(object)
        tensor = inertia.inertia_matrix(link[4:]).astype(object)
        speed, push = (joint.axis.astype(object) * _Sum([f"{x}{i + 1}"]) for x in "va")
        turn, place = _placed(code, i, joint)
        w, dw, a = states[joint.parent] if joint.parent >= 0 else base
        a = a + np.cross(dw, place) + np.cross(w, np.cross(w, place))
        w, dw, a = (turn.T @ x for x in (w, dw, a))
        if joint.kind == "prismatic":
            w, dw = code.put(f"w{i}", w), code.put(f"u{i}", dw)
            a = a + 2.0 * np.cross(w, speed) + push
        else:
            w = code.put(f"w{i}", w + speed)
            dw = code.put(f"u{i}", dw + np.cross(w, speed) + push)
        a = code.put(f"b{i}", a)
        spun = code.put(f"h{i}", np.cross(w, h))
        force.append(code.put(f"f{i}", m * a + np.cross(dw, h) + np.cross(w, spun)))
        spin = code.put(f"s{i}", tensor @ w)
        moment.append(code.put(f"n{i}", tensor @ dw + np.cross(w, spin) + np.cross(h, a)))
        states.append((w, dw, a))
        poses.append((turn, place))
    for i, joint in reversed(list(enumerate(robot.joints))):
        (turn, place), p = poses[i], joint.parent
        half = force[i] if joint.kind == "prismatic" else moment[i]
        torque: Any = joint.axis.astype(object) @ half + friction[i]
        code.lines.append(f"tau{i + 1} = {number(torque) if isinstance(torque, float) else torque}")
        if p >= 0:
            handed = code.put(f"g{i}", turn @ force[i])
            bent = turn @ moment[i] + np.cross(place, handed)
            force[p] = code.put(f"f{p}", force[p] + handed)
            moment[p] = code.put(f"n{p}", moment[p] + bent)
    return _needed(code.lines)


def _needed(lines: Sequence[str]) -> list[str]:
    """Without the statements whose result nothing uses."""
    used: set[str] = set()
    out = []
    for line in reversed(lines):
        kept = []
        for statement in line.split("; "):
            name, value = statement.split(" = ")
            if name.startswith("tau") or name in used:
                kept.append(statement)
                used |= set(re.findall(r"\w+", value))
        if kept:
            out.append("; ".join(kept))
    return out[::-1]


def _friction(estimate: Estimate) -> list[Scalar]:
    """What the joints' own effects make."""
    sums: list[Scalar] = [0.0] * estimate.robot.n
    widths = estimate.model.sign_width
    for parameter, value in zip(estimate.model.parameters, estimate.theta, strict=True):
        j, x = parameter.joint, float(value)
        of = {
            "viscous_friction": f"v{j}",
            "coulomb_friction": f"tanh(v{j} * {number(1.0 / widths[j - 1])})",
            "rotor_inertia": f"a{j}",
        }
        if parameter.effect == "torque_offset":
            sums[j - 1] += x
        elif parameter.effect in of:
            sums[j - 1] += x * _Sum([of[parameter.effect]])
    return sums


def _placed(code: _Code, i: int, joint: Joint) -> tuple[Vector, Vector]:
    """Rotation (3, 3) and origin (3,) of joint i in its parent."""
    fixed, origin, k = joint.placement[:3, :3], joint.placement[:3, 3], joint.axis
    if joint.kind == "prismatic":
        moved = origin.astype(object) + (fixed @ k).astype(object) * _Sum([f"q{i + 1}"])
        return fixed.astype(object), code.put(f"p{i}", moved)
    code.lines.append(f"c{i} = cos(q{i + 1}); s{i} = sin(q{i + 1})")
    skew = np.array([[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]])
    still = np.outer(k, k)
    o, c, s = (_flat(fixed @ part).ravel() for part in (still, np.eye(3) - still, skew))
    turn = o + c * _Sum([f"c{i}"]) + s * _Sum([f"s{i}"])
    return code.put(f"r{i}", turn).reshape(3, 3), _flat(origin)


class _Code:
    """Statements; what is worth a name is put into one."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._taken: set[str] = set()

    def put(self, name: str, values: Vector) -> Vector:
        """The values, each that is no plain number or name under a name of its own; one line."""
        out, made = [], []
        for k, value in enumerate(values):
            if isinstance(value, float) or re.fullmatch(r"-?\w+", str(value)):
                out.append(value)
                continue
            while f"{name}_{k}" in self._taken:
                name += "x"
            made.append(f"{name}_{k} = {value}")
            out.append(_Sum([f"{name}_{k}"]))
        self._taken |= {str(x) for x in out}
        if made:
            self.lines.append("; ".join(made))
        return np.array(out, object)


def _flat(values: Array) -> Vector:
    """Zero and one where rounding alone keeps a rotation from them."""
    near = np.round(values)
    return np.where(np.abs(values - near) < 1e-15, near, values).astype(object)


class _Sum:
    """A sum of words and a constant, as code: a float that is not known yet.

    Zeros vanish and ones are not written: what arrays of these and floats make is all that is computed.
    """

    def __init__(self, words: Sequence[str], constant: float = 0.0) -> None:
        self.words, self.constant = list(words), constant

    def __str__(self) -> str:
        words = self.words + ([number(self.constant)] if self.constant else [])
        return " + ".join(words).replace("+ -", "- ")

    def __add__(self, other: Scalar) -> _Sum:
        more = other if isinstance(other, _Sum) else _Sum([], other)
        return _Sum(self.words + more.words, self.constant + more.constant)

    def __radd__(self, other: float) -> _Sum:
        return self + other

    def __sub__(self, other: Scalar) -> _Sum:
        return self + -1.0 * other

    def __rsub__(self, other: float) -> Scalar:
        return -1.0 * self + other

    def __mul__(self, other: Scalar) -> Scalar:
        if isinstance(other, _Sum):
            return _Sum([f"{self._factor()} * {other._factor()}"])
        return other * self

    def __rmul__(self, other: float) -> Scalar:
        if other in (0.0, 1.0):
            return self if other else 0.0
        factor = self._factor()
        if other == -1.0:
            return _Sum([factor[1:] if factor.startswith("-") else f"-{factor}"])
        return _Sum([f"{number(other)} * {factor}"])

    def _factor(self) -> str:
        text = str(self)
        return f"({text})" if " + " in text or " - " in text else text
