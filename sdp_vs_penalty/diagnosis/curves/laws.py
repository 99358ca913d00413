"""The dictionary of laws in which curves are recognised."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sdp_vs_penalty.diagnosis.curves.bases import Axis
from sdp_vs_penalty.robot.arrays import Array

#: Steps of a scan over a constant; a quarter as many over each of two.
_SCAN = 56


@dataclass(frozen=True)
class Law:
    """terms(variables, constants) -> its m columns, by broadcasting; starts : constants that a fit
    begins with, and within whose ends it stays; text(amplitudes, constants) -> how it reads."""

    terms: Callable[[Sequence[Array] | Array, Array], Sequence[Array]]
    text: Callable[[Array, Array], str]
    starts: Sequence[tuple[float, ...]] = ((),)

    @cached_property
    def ends(self) -> tuple[Array, Array]:
        """(c,) least and largest of each constant."""
        starts = np.array(self.starts, float)
        return starts.min(axis=0), starts.max(axis=0)

    def columns(self, points: Array, constants: Array) -> Array:
        """(P, m) at points (P, v) with constants (c,); (P, S, m) with S sets of them (c, S)."""
        return self._stacked(points.T if constants.ndim == 1 else points.T[:, :, None], constants)

    def on_grid(self, grid: Sequence[Array], constants: Array) -> Array:
        """(P_1, ..., S, m) at the points of a grid, with S sets of constants (c, S)."""
        return self._stacked([x[..., None] for x in np.ix_(*grid)], constants)

    def _stacked(self, x: Sequence[Array] | Array, constants: Array) -> Array:
        with np.errstate(over="ignore", invalid="ignore"):
            terms = self.terms(x, constants)
        shape = np.broadcast_shapes(*(v.shape for v in x), constants.shape[1:])
        return np.stack([np.broadcast_to(g, shape) for g in terms], axis=-1)


def dictionary(axes: Sequence[Axis]) -> list[Law]:
    """Over one variable, or a pair."""
    return _of_one(axes[0]) if len(axes) == 1 else _of_two(axes[0], axes[1])


def _name(axis: Axis) -> str:
    name = axis.variable.name
    return name if axis.variable.other < 0 else f"({name})"


def _number(x: float) -> str:
    return f"{x:.4g}"


def _terms(amplitudes: Array, names: Sequence[str]) -> str:
    parts = [f"{_number(abs(a))} {name}" for a, name in zip(amplitudes, names, strict=True)]
    signs = ["-" if a < 0.0 else "+" for a in amplitudes]
    text = " ".join(f"{s} {p}" for s, p in zip(signs, parts, strict=True))
    return text[2:] if text.startswith("+") else f"-{text[2:]}"


def _sum(functions: Sequence[Callable[[Array], Array]], names: Sequence[str]) -> Law:
    return Law(lambda p, _: [g(p[0]) for g in functions], lambda a, _: _terms(a, names))


def _fastest(axis: Axis) -> float:
    """Waves [rad per unit] that the splines still hold."""
    return 0.7 * np.pi * (axis.count - 3) / (axis.high - axis.low)


def _waves(axis: Axis, count: int) -> Array:
    """Waves that a scan begins with: from a tenth of one over the range."""
    slowest = 2.0 * np.pi / (axis.high - axis.low)
    return np.append([0.1 * slowest, 0.25 * slowest], np.linspace(0.5 * slowest, _fastest(axis), count))


def _wave(a: Array, phase: str, rest: str = "") -> str:
    """a_0 sin + a_1 cos of one phase as one sine."""
    size, shift = float(np.hypot(*a)), float(np.arctan2(a[1], a[0]))
    sign = "-" if shift < 0.0 else "+"
    return f"{_number(size)} sin({phase} {sign} {_number(abs(shift))}){rest}"


def _of_one(axis: Axis) -> list[Law]:
    x = _name(axis)
    if axis.is_sign:
        return [_sum([lambda v: v], [x])]
    span, largest = axis.high - axis.low, max(abs(axis.low), abs(axis.high))
    widths = [(float(w),) for w in np.geomspace(0.01, 3.0, 20) * largest]
    names = [x, f"{x}^2", f"{x}^3"]
    functions: list[Callable[[Array], Array]] = [lambda v: v, np.square, lambda v: v**3]
    plain: list[tuple[Callable[[Array], Array], str]] = [
        *zip(functions, names, strict=True),
        (np.abs, f"|{x}|"),
        (np.sign, f"sign({x})"),
        (lambda v: v * np.abs(v), f"{x} |{x}|"),
        (lambda v: np.sqrt(np.abs(v)) * np.sign(v), f"sign({x}) sqrt(|{x}|)"),
    ]
    out = [_sum([g], [name]) for g, name in plain]
    out += [_sum(functions[:2], names[:2]), _sum(functions, names)]

    def scaled(g: Callable[[Array], Array], text: Callable[[str], str]) -> Law:
        return Law(
            lambda p, b: [g(p[0] / b[0])],
            lambda a, b: f"{_number(a[0])} {text(f'{x} / {_number(b[0])}')}",
            widths,
        )

    out += [
        scaled(np.tanh, lambda v: f"tanh({v})"),
        scaled(lambda v: np.clip(v, -1.0, 1.0), lambda v: f"sat({v})"),
        scaled(lambda v: np.exp(-np.abs(v)), lambda v: f"exp(-|{v}|)"),
        scaled(lambda v: np.sign(v) * np.exp(-np.abs(v)), lambda v: f"sign({x}) exp(-|{v}|)"),
        Law(
            lambda p, b: [np.exp(p[0] / b[0])],
            lambda a, b: f"{_number(a[0])} exp({x} / {_number(b[0])})",
            [(s * w,) for (w,) in widths if w > 0.05 * largest for s in (1.0, -1.0)],
        ),
        Law(
            lambda p, b: [np.sin(b[0] * p[0]), np.cos(b[0] * p[0])],
            lambda a, b: _wave(a, f"{_number(b[0])} {x}"),
            [(float(k),) for k in _waves(axis, _SCAN)],
        ),
        Law(
            lambda p, b: [np.exp(-(((p[0] - b[0]) / b[1]) ** 2))],
            lambda a, b: f"{_number(a[0])} exp(-(({x} - {_number(b[0])}) / {_number(abs(b[1]))})^2)",
            [
                (float(c), float(w))
                for c in np.linspace(axis.low, axis.high, _SCAN // 2)
                for w in np.geomspace(0.03, 0.5, 8) * span
            ],
        ),
    ]
    return out


def _of_two(first: Axis, second: Axis) -> list[Law]:
    x, y = _name(first), _name(second)

    def simple(name: str, sign: bool) -> list[tuple[Callable[[Array], Array], str]]:
        if sign:
            return [(lambda v: v, name)]
        return [
            (lambda v: v, name),
            (np.abs, f"|{name}|"),
            (np.sign, f"sign({name})"),
            (np.square, f"{name}^2"),
        ]

    out = [
        Law(
            lambda p, _, g=g, h=h: [g(p[0]) * h(p[1])],  # type: ignore[misc]
            lambda a, _, u=u, v=v: f"{_number(a[0])} {u} {v}",  # type: ignore[misc]
        )
        for g, u in simple(x, first.is_sign)
        for h, v in simple(y, second.is_sign)
    ]
    for k, (axis, name, other, rest) in enumerate(((first, x, second, y), (second, y, first, x))):
        if axis.is_sign:
            continue
        starts = [(float(w),) for w in _waves(axis, _SCAN // 2)]
        out += [
            Law(
                lambda p, b, k=k, h=h: [  # type: ignore[misc]
                    g(b[0] * p[k]) * h(p[1 - k]) for g in (np.sin, np.cos)
                ],
                lambda a, b, n=name, v=v: _wave(a, f"{_number(b[0])} {n}", f" {v}"),  # type: ignore[misc]
                starts,
            )
            for h, v in simple(rest, other.is_sign)
        ]
    if not (first.is_sign or second.is_sign):
        out.append(_travelling(first, second, x, y))
    return out


def _travelling(first: Axis, second: Axis, x: str, y: str) -> Law:
    """A wave of both positions."""

    def terms(p: Sequence[Array] | Array, b: Array) -> list[Array]:
        one, two = p[0] * b[0], p[1] * b[1]  # on a grid each is of one variable
        a, c, u, v = np.sin(one), np.cos(one), np.sin(two), np.cos(two)
        return [a * v + c * u, c * v - a * u]

    def text(a: Array, b: Array) -> str:
        sign = "-" if b[1] < 0.0 else "+"
        return _wave(a, f"{_number(b[0])} {x} {sign} {_number(abs(b[1]))} {y}")

    one, two = (_fastest(axis) for axis in (first, second))
    starts = [
        (float(k), float(w))
        for k in np.linspace(0.0, one, _SCAN // 4)[1:]
        for w in np.linspace(-two, two, _SCAN // 2)
    ]
    return Law(terms, text, starts)
