"""Recognition: the simplest law of a small dictionary that a curve is, by the score of all other forms.

A law a g(x; b) is put into the curve's own splines, c_g, and scored through their products:
a = c_g's / c_g'D c_g. The best of these are fitted once more on the rows themselves. Of those that score
about as much as the curve does, the simplest that explains about as much as any is named.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product

import numpy as np

from sdp_vs_penalty.diagnosis.constants import CLOSELY, EQUIVALENT, FORM
from sdp_vs_penalty.diagnosis.curves.bases import Axis, Basis, Columns, SplineFit
from sdp_vs_penalty.diagnosis.score import DEPENDENT, Score
from sdp_vs_penalty.effects.curve_variable import Variable
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.robot.arrays import Array

#: Steps of a scan over a constant; a quarter as many over each of two.
_SCAN = 56


@dataclass(frozen=True)
class Law:
    """terms(variables, constants) -> its m columns, by broadcasting; starts : constants that a fit
    begins with, and within whose ends it stays; text(amplitudes, constants) -> how it reads."""

    terms: Callable[[Array, Array], Sequence[Array]]
    text: Callable[[Array, Array], str]
    starts: Sequence[tuple[float, ...]] = ((),)

    @cached_property
    def ends(self) -> tuple[Array, Array]:
        """(c,) least and largest of each constant."""
        starts = np.array(self.starts, float)
        return starts.min(axis=0), starts.max(axis=0)

    def columns(self, points: Array, constants: Array) -> Array:
        """(P, m) at points (P, v) with constants (c,); (P, S, m) with S sets of them (c, S)."""
        x = points.T if constants.ndim == 1 else points.T[:, :, None]
        with np.errstate(over="ignore", invalid="ignore"):
            terms = self.terms(x, constants)
        shape = (len(points), *constants.shape[1:])
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

    def text(a: Array, b: Array) -> str:
        sign = "-" if b[1] < 0.0 else "+"
        return _wave(a, f"{_number(b[0])} {x} {sign} {_number(abs(b[1]))} {y}")

    one, two = (_fastest(axis) for axis in (first, second))
    starts = [
        (float(k), float(w))
        for k in np.linspace(0.0, one, _SCAN // 4)[1:]
        for w in np.linspace(-two, two, _SCAN // 2)
    ]
    return Law(lambda p, b: [g(p[0] * b[0] + p[1] * b[1]) for g in (np.sin, np.cos)], text, starts)


# Which of them a curve is.

#: Columns (M, ...) of a law with constants on the rows.
OnRows = Callable[[Law, Array], Array]


@dataclass(frozen=True)
class LawFit:
    """A law with its amplitudes and constants; chi2 : what it explains."""

    law: Law
    amplitudes: Array
    constants: Array
    chi2: float

    @property
    def size(self) -> int:
        return len(self.amplitudes) + len(self.constants)

    def at(self, points: Array) -> Array:
        """(P,) torque at points (P, v)."""
        return np.asarray(self.law.columns(points, self.constants) @ self.amplitudes)


def recognised(f: SplineFit, on_rows: OnRows, score: Score, looked: int) -> list[tuple[float, LawFit]]:
    """The likely laws, each with its score, fitted on the rows; on_rows(law, constants) : their columns
    (M, ...) there, not white."""

    def in_splines(law: Law, constants: Array) -> tuple[Array, Array]:
        return _normal(_in_splines(f.basis, law, constants), f.columns)

    def rated(fit: LawFit) -> float:
        return float(f.columns.score(np.array(fit.chi2), np.array(fit.size), looked))

    every = []
    for law, c in _scanned(f.basis):
        a, chi2 = _amplitudes(*_normal(c, f.columns))
        best = int(np.argmax(chi2))
        every.append(LawFit(law, a[best], np.array(law.starts[best], float), float(chi2[best])))
    rough = sorted(every, key=rated, reverse=True)[:CLOSELY]
    found = []
    for start in rough:
        near = _refined(start, in_splines)
        raw = on_rows(near.law, near.constants)
        own = Columns.of(score, f.columns.fit, score.data.white(raw, f.joint), f.joint, robust=False)
        a, chi2 = _amplitudes(own.D[None], own.s[None])
        exact = LawFit(near.law, a[0], near.constants, float(chi2[0]))
        found.append((rated(exact), exact))
    return sorted(found, key=lambda r: -r[0])


def law_of(laws: Sequence[tuple[float, LawFit]], f: SplineFit) -> LawFit | None:
    """The simplest law that scores about what the best does, and the curve; None where none does."""
    top = max([f.J, *(J for J, _ in laws)])
    alike = [(J, law) for J, law in laws if top - EQUIVALENT - FORM * top < J]
    if not alike:
        return None
    return min(alike, key=lambda r: (r[1].size, -r[0]))[1]


@lru_cache(maxsize=64)
def _onto(basis: Basis) -> tuple[Array, Array]:
    """Points of a basis (P, v), of a pair every second one along each, and what makes coefficients of
    values there (k, P)."""
    pair = len(basis.axes) > 1
    x = np.array(list(product(*(a.points[:: 2 if pair and not a.is_sign else 1] for a in basis.axes))))
    return x, np.asarray(np.linalg.pinv(basis.at(*x.T), rcond=1e-10), float)


def _in_splines(basis: Basis, law: Law, constants: Array) -> Array:
    """(S, m, k) a law with S sets of constants (c, S) in the splines of a basis."""
    points, inverse = _onto(basis)
    return np.tensordot(law.columns(points, constants), inverse, axes=(0, 1))


@lru_cache(maxsize=64)
def _scanned(basis: Basis) -> list[tuple[Law, Array]]:
    """Each law of the dictionary at those of its starts that the splines hold, (S, m, k) in these."""
    out = []
    for law in dictionary(basis.axes):
        starts = np.array(law.starts, float)
        c = _in_splines(basis, law, starts.T)
        held = np.isfinite(c).all(axis=(1, 2))
        if held.any():
            out.append((replace(law, starts=[tuple(s) for s in starts[held]]), c[held]))
    return out


def _normal(c: Array, f: Columns) -> tuple[Array, Array]:
    """Matrices (S, m, m) and right sides (S, m) of the normal equations of amplitudes of coefficients
    (S, m, k)."""
    weighed = (c.reshape(-1, c.shape[2]) @ f.D).reshape(c.shape)
    return weighed @ c.transpose(0, 2, 1), c @ f.s


def written(law: LawFit, f: SplineFit, torque_units: Sequence[str]) -> str:
    """The law as text with units."""
    unit = plain_unit(torque_units[f.joint])
    units = {v: Variable.parse(v).unit(torque_units) for v in f.basis.of}
    said = ", ".join(f"{v} in {u}" for v, u in units.items() if u != "-")
    text = law.law.text(law.amplitudes, law.constants)
    return f"{text} {unit}" + (f" ({said})" if said else "")


def _amplitudes(gram: Array, pull: Array) -> tuple[Array, Array]:
    """(S, m) those that explain most, and (S,) how much, of normal equations (S, m, m) and (S, m);
    nothing of columns that the rows do not see (a bump where nobody was)."""
    visible = np.einsum("smm->sm", gram) > DEPENDENT**2
    known = np.asarray(np.isfinite(gram).all(axis=(1, 2)) & visible.all(axis=1))
    gram, pull = np.where(known[:, None, None], gram, 0.0), np.where(known[:, None], pull, 0.0)
    scale = np.sqrt(np.maximum(np.einsum("smm->sm", gram), 1e-300))
    gram, pull = gram / (scale[:, :, None] * scale[:, None, :]), pull / scale
    a = (np.linalg.pinv(gram, rcond=1e-9, hermitian=True) @ pull[:, :, None])[:, :, 0]
    return a / scale, np.sum(a * pull, axis=1)


def _refined(start: LawFit, normal: Callable[[Law, Array], tuple[Array, Array]]) -> LawFit:
    """The constants near these that explain most, none beyond the ends of the law's own starts. normal :
    equations of the amplitudes at sets of constants (c, S)."""
    from scipy.optimize import minimize  # its import takes longer than a report

    law, (low, high) = start.law, start.law.ends
    if not len(start.constants):
        return start

    def left(constants: Array) -> float:
        return -float(_amplitudes(*normal(law, constants[:, None]))[1][0])

    step = np.minimum(0.1 * np.abs(start.constants) + 1e-3, 0.3 * (high - low))
    corners = np.clip(start.constants + np.vstack([0.0 * step, np.diag(step)]), low, high)
    options = {"initial_simplex": corners, "xatol": 1e-4, "fatol": 1e-4 * start.chi2}
    bounds = list(zip(low, high, strict=True))
    found = minimize(left, start.constants, method="Nelder-Mead", bounds=bounds, options=options).x
    a, chi2 = _amplitudes(*normal(law, found[:, None]))
    return LawFit(law, a[0], found, float(chi2[0])) if chi2[0] > start.chi2 else start
