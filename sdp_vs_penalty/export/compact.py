"""The function of a plain model, without loops: one expression a number, for a robot's own constants.

Recursive Newton-Euler (Luh, Walker, Paul 1980) in the joints' frames. Every constant is written in, and
what is multiplied by zero is not written at all, so that a call costs microseconds in plain Python; of
NumPy arrays the same text makes arrays.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence

import numpy as np

from sdp_vs_penalty.effects.effect import Array
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.export.content import about, number
from sdp_vs_penalty.robot import inertia

#: Effects that the expressions hold.
PLAIN = frozenset(
    {"rigid_body", "viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia"}
)
#: A number, or the text of one.
Scalar = float | str
Vector = list[Scalar]

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
    code, robot = _Code(), estimate.robot
    sums = _friction(estimate)
    none: Vector = [0.0, 0.0, 0.0]
    up: Vector = [-float(g) for g in robot.gravity]
    w, dw, a, turn, place, force, moment = ([none] * robot.n for _ in range(7))
    for i, joint in enumerate(robot.joints):
        k: Vector = [float(x) for x in joint.axis]
        slides = joint.kind == "prismatic"
        own = inertia.transform(joint.link_frame) @ estimate.links[i]
        turn[i], place[i] = _placed(code, i, joint.placement, np.asarray(joint.axis, float), slides)
        at = (
            (w[joint.parent], dw[joint.parent], a[joint.parent])
            if joint.parent >= 0
            else (none, none, up)
        )
        inner = _cross(at[0], place[i])
        t = [_sum(*x) for x in zip(at[2], _cross(at[1], place[i]), _cross(at[0], inner), strict=True)]
        back = [[turn[i][3 * y + x] for y in range(3)] for x in range(3)]
        before, turned = _apply(back, at[0]), _apply(back, at[1])
        speed, push = ([_times(x, f"{name}{i + 1}") for x in k] for name in "va")
        accel = _apply(back, t)
        if slides:
            w[i], dw[i] = code.put(f"w{i}", before), code.put(f"u{i}", turned)
            coriolis = [_times(2.0, x) for x in _cross(w[i], speed)]
            accel = [_sum(*x) for x in zip(accel, coriolis, push, strict=True)]
        else:
            w[i] = code.put(f"w{i}", [_sum(*x) for x in zip(before, speed, strict=True)])
            swing = _cross(w[i], speed)
            dw[i] = code.put(f"u{i}", [_sum(*x) for x in zip(turned, swing, push, strict=True)])
        a[i] = code.put(f"b{i}", accel)
        m, h, tensor = _link(own)
        spun = code.put(f"h{i}", _cross(w[i], h))
        parts = ([_times(m, x) for x in a[i]], _cross(dw[i], h), _cross(w[i], spun))
        force[i] = code.put(f"f{i}", [_sum(*x) for x in zip(*parts, strict=True)])
        spin = code.put(f"s{i}", _apply(tensor, w[i]))
        parts = (_apply(tensor, dw[i]), _cross(w[i], spin), _cross(h, a[i]))
        moment[i] = code.put(f"n{i}", [_sum(*x) for x in zip(*parts, strict=True)])
    for i in reversed(range(robot.n)):
        joint = robot.joints[i]
        half = force[i] if joint.kind == "prismatic" else moment[i]
        own_part = [_times(float(x), y) for x, y in zip(joint.axis, half, strict=True)]
        code.lines.append(f"tau{i + 1} = {_text(_sum(*own_part, *sums[i]))}")
        if joint.parent >= 0:
            rows = [turn[i][3 * x : 3 * x + 3] for x in range(3)]
            handed = code.put(f"g{i}", _apply(rows, force[i]))
            bent = [
                _sum(*x) for x in zip(_apply(rows, moment[i]), _cross(place[i], handed), strict=True)
            ]
            p = joint.parent
            force[p] = code.put(f"f{p}", [_sum(*x) for x in zip(force[p], handed, strict=True)])
            moment[p] = code.put(f"n{p}", [_sum(*x) for x in zip(moment[p], bent, strict=True)])
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


def _friction(estimate: Estimate) -> list[list[Scalar]]:
    """Terms of the joints' own effects."""
    terms: list[list[Scalar]] = [[] for _ in range(estimate.robot.n)]
    widths = estimate.model.sign_width
    for parameter, value in zip(estimate.model.parameters, estimate.theta, strict=True):
        j, x = parameter.joint, float(value)
        of = {
            "viscous_friction": f"v{j}",
            "coulomb_friction": f"tanh(v{j} * {number(1.0 / widths[j - 1])})",
            "rotor_inertia": f"a{j}",
        }
        if parameter.effect == "torque_offset":
            terms[j - 1].append(x)
        elif parameter.effect in of:
            terms[j - 1].append(_times(x, of[parameter.effect]))
    return terms


def _placed(code: _Code, i: int, placement: Array, k: Array, slides: bool) -> tuple[Vector, Vector]:
    """Rotation (9, by rows) and origin (3) of joint i in its parent."""
    fixed, origin = placement[:3, :3], placement[:3, 3]
    if slides:
        along = fixed @ k
        moved = [
            _sum(float(o), _times(float(x), f"q{i + 1}")) for o, x in zip(origin, along, strict=True)
        ]
        return [float(x) for x in fixed.ravel()], code.put(f"p{i}", moved)
    code.lines.append(f"c{i} = cos(q{i + 1}); s{i} = sin(q{i + 1})")
    skew = np.array([[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]])
    still = np.outer(k, k)
    parts = (fixed @ still, fixed @ (np.eye(3) - still), fixed @ skew)
    rows = [
        _sum(_flat(o), _times(_flat(c), f"c{i}"), _times(_flat(s), f"s{i}"))
        for o, c, s in zip(*(part.ravel() for part in parts), strict=True)
    ]
    return code.put(f"r{i}", rows), [_flat(x) for x in origin]


def _link(own: Array) -> tuple[float, Vector, list[Vector]]:
    """Mass, first moment and inertia of a link about its joint's frame."""
    xx, xy, yy, xz, yz, zz = (float(x) for x in own[4:])
    return float(own[0]), [float(x) for x in own[1:4]], [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]


class _Code:
    """Statements; what is worth a name is put into one."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def put(self, name: str, values: Sequence[Scalar]) -> Vector:
        """The values, each that is no plain number or name under a name of its own; one line."""
        out: Vector = []
        made: list[str] = []
        for k, value in enumerate(values):
            if isinstance(value, float) or re.fullmatch(r"-?\w+", value):
                out.append(value)
                continue
            while f"{name}_{k}" in self._taken:
                name += "x"
            made.append(f"{name}_{k} = {value}")
            out.append(f"{name}_{k}")
        self._taken |= {str(x) for x in out}
        if made:
            self.lines.append("; ".join(made))
        return out

    _taken: frozenset[str] = frozenset()


def _flat(value: float) -> float:
    """Zero and one where rounding alone keeps a rotation from them."""
    near = round(float(value))
    return float(near) if abs(value - near) < 1e-15 else float(value)


def _text(value: Scalar) -> str:
    return number(value) if isinstance(value, float) else value


def _times(a: Scalar, b: Scalar) -> Scalar:
    if isinstance(b, float) and not isinstance(a, float):
        a, b = b, a
    if isinstance(a, float):
        if isinstance(b, float):
            return a * b
        if a == 0.0:
            return 0.0
        if a in (1.0, -1.0):
            return b if a == 1.0 else _negative(b)
    return f"{_factor(a)} * {_factor(b)}"


def _factor(a: Scalar) -> str:
    text = _text(a)
    return f"({text})" if " + " in text or " - " in text else text


def _negative(text: str) -> str:
    factor = _factor(text)
    return factor[1:] if factor.startswith("-") else f"-{factor}"


def _sum(*terms: Scalar) -> Scalar:
    constant = sum(t for t in terms if isinstance(t, float))
    words = [t for t in terms if isinstance(t, str)]
    if constant != 0.0 or not words:
        words.append(number(float(constant)))
    if words == [number(float(constant))]:
        return float(constant)
    return " + ".join(words).replace("+ -", "- ")


def _cross(a: Sequence[Scalar], b: Sequence[Scalar]) -> Vector:
    def less(x: Scalar, y: Scalar) -> Scalar:
        return _sum(x, _times(-1.0, y))

    pairs = ((1, 2), (2, 0), (0, 1))
    return [less(_times(a[i], b[j]), _times(a[j], b[i])) for i, j in pairs]


def _apply(rows: Sequence[Sequence[Scalar]], v: Sequence[Scalar]) -> Vector:
    return [_sum(*(_times(x, y) for x, y in zip(row, v, strict=True))) for row in rows]
