"""Recognition: the simplest law of a small dictionary that a curve is, by the score of
all other forms.

A law a g(x; b) is put into the curve's own splines, c_g, and scored through their
products: a = c_g's / c_g'D c_g. The best of these are fitted once more on the rows
themselves. Of those that score about as much as the curve does, the simplest that
explains about as much as any is named.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product

import numpy as np
import scipy

from sdp_vs_penalty.diagnosis.constants import (
    EVIDENCE_TO_DISTINGUISH,
    LAW_TOLERANCE,
    MAX_CANDIDATES_REFINED,
)
from sdp_vs_penalty.diagnosis.curves.bases import Axis, Basis, CurveColumns, SplineFit
from sdp_vs_penalty.diagnosis.linear_fit import DEPENDENT
from sdp_vs_penalty.effects.measured_curve import Variable
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.robot.arrays import Array

#: Steps of a scan over a constant; a quarter as many over each of two.
_SCAN = 56

Function = Callable[[Array], Array]
#: Functions of a variable, of one in units of a constant, and of each of a pair, as
#: they read.
_PLAIN: Mapping[str, Function] = {
    "{x}": lambda v: v,
    "{x}^2": np.square,
    "{x}^3": lambda v: v**3,
    "|{x}|": np.abs,
    "sign({x})": np.sign,
    "{x} |{x}|": lambda v: v * np.abs(v),
    "sign({x}) sqrt(|{x}|)": lambda v: np.sqrt(np.abs(v)) * np.sign(v),
}
_SCALED: Mapping[str, Function] = {
    "tanh({x} / {b})": np.tanh,
    "sat({x} / {b})": lambda v: np.clip(v, -1.0, 1.0),
    "exp(-|{x} / {b}|)": lambda v: np.exp(-np.abs(v)),
    "sign({x}) exp(-|{x} / {b}|)": lambda v: np.sign(v) * np.exp(-np.abs(v)),
}
_OF_A_PAIR = "{x}", "|{x}|", "sign({x})", "{x}^2"


@dataclass(frozen=True)
class Law:
    """terms(variables, constants) -> its m columns, by broadcasting; reads : what
    follows each amplitude, with {x}, {y} for the variables and {b}, {c} for the
    constants, and once for the sine and cosine of a wave, with {phase}; starts :
    constants that a fit begins with, its bounds their ends."""

    terms: Callable[[Array, Array], Sequence[Array]]
    reads: tuple[str, ...]
    starts: Sequence[tuple[float, ...]] = ((),)

    @cached_property
    def ends(self) -> tuple[Array, Array]:
        """(c,) least and largest of each constant."""
        starts = np.array(self.starts, float)
        return starts.min(axis=0), starts.max(axis=0)

    def columns(self, points: Array, constants: Array) -> Array:
        """(P, m) at points (P, v) with constants (c,); (P, S, m) with S sets of them
        (c, S)."""
        x = points.T if constants.ndim == 1 else points.T[:, :, None]
        with np.errstate(over="ignore", invalid="ignore"):
            terms = self.terms(x, constants)
        shape = (len(points), *constants.shape[1:])
        return np.stack([np.broadcast_to(g, shape) for g in terms], axis=-1)

    def text(
        self,
        names: Sequence[str],
        amplitudes: Array,
        constants: Array,
    ) -> str:
        """How it reads with these numbers; names : of the variables."""
        known = dict(zip("xy", names, strict=False)) | dict(
            zip("bc", map(_number, constants), strict=False)
        )
        if len(self.reads) < len(amplitudes):
            known["phase"] = _number(np.arctan2(amplitudes[1], amplitudes[0]))
            amplitudes = np.hypot(*amplitudes)[None]
        parts = zip(amplitudes, self.reads, strict=True)
        return " + ".join(
            f"{_number(a)} {r.format(**known)}" for a, r in parts
        ).replace("+ -", "- ")


def _number(x: float) -> str:
    return f"{x:.4g}"


def dictionary(axes: Sequence[Axis]) -> list[Law]:
    """Over one variable, or a pair."""
    return _of_one(axes[0]) if len(axes) == 1 else _of_two(*axes)


def _of_one(axis: Axis) -> list[Law]:
    def plain(*reads: str) -> Law:
        return Law(lambda p, _: [_PLAIN[r](p[0]) for r in reads], reads)

    def scaled(g: Function, reads: str, starts: Array) -> Law:
        return Law(
            lambda p, b: [g(p[0] / b[0])],
            (reads,),
            [(float(w),) for w in starts],
        )

    if axis.is_sign:
        return [plain("{x}")]
    largest = max(abs(axis.low), abs(axis.high))
    span = axis.high - axis.low
    widths = np.geomspace(0.01, 3.0, 20) * largest
    wide = widths[widths > 0.05 * largest]
    places = product(
        np.linspace(axis.low, axis.high, _SCAN // 2), np.geomspace(0.03, 0.5, 8) * span
    )
    return [
        *map(plain, _PLAIN),
        plain("{x}", "{x}^2"),
        plain("{x}", "{x}^2", "{x}^3"),
        *(
            scaled(
                g,
                reads,
                widths,
            )
            for reads, g in _SCALED.items()
        ),
        scaled(np.exp, "exp({x} / {b})", np.concatenate([wide, -wide])),
        _wave(
            lambda p, b: b[0] * p[0],
            "{b} {x}",
            [(float(k),) for k in _waves(axis, _SCAN)],
        ),
        Law(
            lambda p, b: [np.exp(-(((p[0] - b[0]) / b[1]) ** 2))],
            ("exp(-(({x} - {b}) / {c})^2)",),
            [(float(c), float(w)) for c, w in places],
        ),
    ]


def _of_two(first: Axis, second: Axis) -> list[Law]:
    def factors(axis: Axis) -> Sequence[str]:
        return _OF_A_PAIR[:1] if axis.is_sign else _OF_A_PAIR

    def both(u: str, v: str) -> Law:
        return Law(
            lambda p, _: [_PLAIN[u](p[0]) * _PLAIN[v](p[1])], (f"{u} {_other(v)}",)
        )

    def waving(k: int, v: str) -> Law:
        starts = [(float(w),) for w in _waves((first, second)[k], _SCAN // 2)]
        phase, other_factor = ("{b} {x}", _other(v)) if k == 0 else ("{b} {y}", v)
        return _wave(
            lambda p, b: b[0] * p[k],
            phase,
            starts,
            lambda p: _PLAIN[v](p[1 - k]),
            f" {other_factor}",
        )

    out = [both(u, v) for u in factors(first) for v in factors(second)]
    for k, (axis, other) in enumerate(((first, second), (second, first))):
        out += [waving(k, v) for v in factors(other) if not axis.is_sign]
    if not (first.is_sign or second.is_sign):
        one = _fastest(first)
        two = _fastest(second)
        starts = product(
            np.linspace(0.0, one, _SCAN // 4)[1:], np.linspace(-two, two, _SCAN // 2)
        )
        pairs = [(float(k), float(w)) for k, w in starts]
        out.append(
            _wave(
                lambda p, b: b[0] * p[0] + b[1] * p[1],
                "{b} {x} + {c} {y}",
                pairs,
            )
        )
    return out


def _other(reads: str) -> str:
    return reads.replace("{x}", "{y}")


def _wave(
    phase: Callable[[Array, Array], Array],
    reads: str,
    starts: Sequence[tuple[float, ...]],
    factor: Function = lambda p: np.ones_like(p[0]),
    other_factor: str = "",
) -> Law:
    """Sine and cosine of a phase, times a function of the variables."""

    def terms(p: Array, b: Array) -> list[Array]:
        return [g(phase(p, b)) * factor(p) for g in (np.sin, np.cos)]

    return Law(terms, (f"sin({reads} + {{phase}}){other_factor}",), starts)


def _fastest(axis: Axis) -> float:
    """Waves [rad per unit] that the splines still hold."""
    return 0.7 * np.pi * (axis.count - 3) / (axis.high - axis.low)


def _waves(axis: Axis, count: int) -> Array:
    """Waves that a scan begins with: from a tenth of one over the range."""
    slowest = 2.0 * np.pi / (axis.high - axis.low)
    return np.append(
        [0.1 * slowest, 0.25 * slowest],
        np.linspace(0.5 * slowest, _fastest(axis), count),
    )


# Which of them a curve is.


@dataclass(frozen=True)
class LawFit:
    """A law with its amplitudes and constants; chi2 : what it explains; columns : its
    own, if it was fitted to the rows."""

    law: Law
    amplitudes: Array
    constants: Array
    chi2: float
    columns: CurveColumns | None = None

    @property
    def size(self) -> int:
        return len(self.amplitudes) + len(self.constants)

    def at(self, points: Array) -> Array:
        """(P,) torque at points (P, v)."""
        return np.asarray(self.law.columns(points, self.constants) @ self.amplitudes)


def recognised(
    f: SplineFit,
    on_rows: Callable[[Law, Array], CurveColumns],
    looked: int,
) -> tuple[float, LawFit | None]:
    """The simplest law that scores about what the best does, and the curve, with its
    score; the curve's alone where none does. on_rows(law, constants) : the columns that
    a law makes there."""

    def in_splines(law: Law, constants: Array) -> tuple[Array, Array]:
        return _normal(_in_splines(f.basis, law, constants), f.columns)

    def rated(fit: LawFit) -> float:
        return float(
            f.columns.score(
                np.array(fit.chi2),
                np.array(fit.size),
                looked,
            )
        )

    fits = []
    for law, c in _scanned(f.basis):
        a, chi2 = _amplitudes(*_normal(c, f.columns))
        best = int(np.argmax(chi2))
        fits.append(
            LawFit(
                law,
                a[best],
                np.array(law.starts[best], float),
                float(chi2[best]),
            )
        )
    rough = sorted(fits, key=rated, reverse=True)[:MAX_CANDIDATES_REFINED]
    scored = []
    for start in rough:
        near = _refined(start, in_splines)
        columns = on_rows(near.law, near.constants)
        a, chi2 = _amplitudes(columns.D[None], columns.s[None])
        exact = LawFit(
            near.law,
            a[0],
            near.constants,
            float(chi2[0]),
            columns,
        )
        scored.append((rated(exact), exact))
    top = max(
        [
            f.J,
            *(J for J, _ in scored),
        ]
    )
    equivalent = [
        (J, law)
        for J, law in scored
        if top - EVIDENCE_TO_DISTINGUISH - LAW_TOLERANCE * top < J
    ]
    return min(
        equivalent,
        key=lambda r: (r[1].size, -r[0]),
        default=(f.J, None),
    )


@lru_cache(maxsize=64)
def _onto(basis: Basis) -> tuple[Array, Array]:
    """Points of a basis (P, v), of a pair every second one along each, and what makes
    coefficients of values there (k, P)."""
    pair = len(basis.axes) > 1
    x = np.array(
        list(
            product(
                *(a.points[:: 2 if pair and not a.is_sign else 1] for a in basis.axes)
            )
        )
    )
    return x, np.asarray(np.linalg.pinv(basis.at(*x.T), rcond=1e-10), float)


def _in_splines(basis: Basis, law: Law, constants: Array) -> Array:
    """(S, m, k) a law with S sets of constants (c, S) in the splines of a basis."""
    points, inverse = _onto(basis)
    return np.tensordot(
        law.columns(points, constants),
        inverse,
        axes=(0, 1),
    )


@lru_cache(maxsize=64)
def _scanned(basis: Basis) -> list[tuple[Law, Array]]:
    """Each law of the dictionary at those of its starts that the splines hold, (S, m,
    k) in these."""
    out = []
    for law in dictionary(basis.axes):
        starts = np.array(law.starts, float)
        c = _in_splines(basis, law, starts.T)
        held = np.isfinite(c).all(axis=(1, 2))
        if held.any():
            out.append((replace(law, starts=[tuple(s) for s in starts[held]]), c[held]))
    return out


def _normal(c: Array, f: CurveColumns) -> tuple[Array, Array]:
    """Matrices (S, m, m) and right sides (S, m) of the normal equations of amplitudes
    of coefficients (S, m, k); not finite where a law overflows, which
    :func:`_amplitudes` leaves out."""
    with np.errstate(over="ignore", invalid="ignore"):
        weighed = (c.reshape(-1, c.shape[2]) @ f.D).reshape(c.shape)
        return weighed @ c.transpose(0, 2, 1), c @ f.s


def written(
    law: LawFit,
    f: SplineFit,
    torque_units: Sequence[str],
) -> str:
    """The law as text with units."""
    unit = plain_unit(torque_units[f.joint])
    units = {v: Variable.parse(v).unit(torque_units) for v in f.basis.of}
    units_in_words = ", ".join(f"{v} in {u}" for v, u in units.items() if u != "-")
    names = [
        v.name if v.other < 0 else f"({v.name})"
        for v in (a.variable for a in f.basis.axes)
    ]
    text = law.law.text(names, law.amplitudes, law.constants)
    return f"{text} {unit}" + (f" ({units_in_words})" if units_in_words else "")


def _amplitudes(gram: Array, pull: Array) -> tuple[Array, Array]:
    """(S, m) those that explain most, and (S,) how much, of normal equations (S, m, m)
    and (S, m); nothing of columns that the rows do not see (a bump where nobody was).
    """
    visible = np.einsum("smm->sm", gram) > DEPENDENT**2
    known = np.asarray(np.isfinite(gram).all(axis=(1, 2)) & visible.all(axis=1))
    gram = np.where(known[:, None, None], gram, 0.0)
    pull = np.where(known[:, None], pull, 0.0)
    scale = np.sqrt(np.maximum(np.einsum("smm->sm", gram), 1e-300))
    gram = gram / (scale[:, :, None] * scale[:, None, :])
    pull = pull / scale
    a = (np.linalg.pinv(gram, rcond=1e-9, hermitian=True) @ pull[:, :, None])[:, :, 0]
    return a / scale, np.sum(a * pull, axis=1)


def _refined(
    start: LawFit, normal: Callable[[Law, Array], tuple[Array, Array]]
) -> LawFit:
    """The constants near these that explain most, none beyond the ends of the law's own
    starts. normal : equations of the amplitudes at sets of constants (c, S)."""

    law, (low, high) = start.law, start.law.ends
    if not len(start.constants):
        return start

    def left(constants: Array) -> float:
        return -float(_amplitudes(*normal(law, constants[:, None]))[1][0])

    options = {"xatol": 1e-4, "fatol": 1e-4 * start.chi2}
    bounds = list(zip(low, high, strict=True))
    solution = scipy.optimize.minimize(
        left,
        start.constants,
        method="Nelder-Mead",
        bounds=bounds,
        options=options,
    ).x
    a, chi2 = _amplitudes(*normal(law, solution[:, None]))
    return (
        LawFit(law, a[0], solution, float(chi2[0])) if chi2[0] > start.chi2 else start
    )
