"""The law that a measured curve follows: the simplest one of a small dictionary that
fits as well, judged by the evidence J as all effects are.

A law a g(x; b), with amplitudes a and constants b, is first put into the curve's own
splines (coefficients c_g), where its amplitude is a = c_g's / c_g'D c_g. The best laws
are then fitted on the rows themselves. Of those with about as much evidence as the
curve, the one with fewest numbers is named.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product

import numpy as np
import scipy

from sdp_vs_penalty.diagnosis.constants import MAX_CANDIDATES_REFINED
from sdp_vs_penalty.diagnosis.curves.bases import Axis, Basis, CurveColumns, SplineFit
from sdp_vs_penalty.diagnosis.linear_fit import DEPENDENT, margin
from sdp_vs_penalty.effects.measured_curve import Variable
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.robot.arrays import Array

#: Steps of a scan over a constant; a quarter as many over each of two.
_SCAN_STEPS = 56

Function = Callable[[Array], Array]
#: Functions of a variable, of one in units of a constant, and of each of a pair, as
#: they read.
_FUNCTIONS: Mapping[str, Function] = {
    "{x}": lambda v: v,
    "{x}^2": np.square,
    "{x}^3": lambda v: v**3,
    "|{x}|": np.abs,
    "sign({x})": np.sign,
    "{x} |{x}|": lambda v: v * np.abs(v),
    "sign({x}) sqrt(|{x}|)": lambda v: np.sqrt(np.abs(v)) * np.sign(v),
}
_SCALED_FUNCTIONS: Mapping[str, Function] = {
    "tanh({x} / {b})": np.tanh,
    "sat({x} / {b})": lambda v: np.clip(v, -1.0, 1.0),
    "exp(-|{x} / {b}|)": lambda v: np.exp(-np.abs(v)),
    "sign({x}) exp(-|{x} / {b}|)": lambda v: np.sign(v) * np.exp(-np.abs(v)),
}
_OF_A_PAIR = "{x}", "|{x}|", "sign({x})", "{x}^2"


@dataclass(frozen=True)
class CurveLaw:
    """A law of the dictionary: a sum of terms with free amplitudes and non-linear
    constants."""

    #: Maps values of the variables and the constants to the law's m columns.
    terms: Callable[[Array, Array], Sequence[Array]]
    #: Text of each term behind its amplitude, with {x}, {y} for the variables and {b},
    #: {c} for the constants; a wave's sine and cosine read as one term with {phase}.
    reads: tuple[str, ...]
    #: Constants that a fit begins with; the fit stays within their range.
    starts: Sequence[tuple[float, ...]] = ((),)

    @cached_property
    def ends(self) -> tuple[Array, Array]:
        """(c,) smallest and (c,) largest value of each constant among the starts."""
        starts = np.array(self.starts, float)
        return starts.min(axis=0), starts.max(axis=0)

    def columns(self, points: Array, constants: Array) -> Array:
        """Return the law's m terms (P, m) or (P, S, m) [no unit], each with amplitude
        1, at P points.

        Overflow gives infinity without a warning: such constants are left out later.

        Parameters
        ----------
        points
            (P, number of variables) values of the variables.
        constants
            (c,) non-linear constants, or (c, S) for S sets of them at once.
        """
        # (v, P), or (v, P, 1) against (c, S): broadcast to P points times S sets.
        x = points.T if constants.ndim == 1 else points.T[:, :, None]
        with np.errstate(over="ignore", invalid="ignore"):
            terms = self.terms(x, constants)
        shape = (len(points), *constants.shape[1:])
        return np.stack([np.broadcast_to(g, shape) for g in terms], axis=-1)

    def text(self, names: Sequence[str], amplitudes: Array, constants: Array) -> str:
        """Write the law with constants (c,) as a formula with its numbers, such as "1.2
        sin(3 q1 + 0.4)".

        Parameters
        ----------
        names
            Names of the one or two variables.
        amplitudes
            (m,) amplitudes of the terms. Those of sine and cosine, a and b, are written
            as one sine with amplitude sqrt(a^2 + b^2) and phase atan2(b, a).
        """
        # Texts of terms, such as "tanh({x} / {b})", have these places to fill.
        words = dict(zip("xy", names, strict=False))
        words |= dict(zip("bc", map(_number, constants), strict=False))
        if len(self.reads) < len(amplitudes):  # a wave: a sin + b cos
            sine, cosine = amplitudes
            words["phase"] = _number(np.arctan2(cosine, sine))
            amplitudes = np.hypot(sine, cosine)[None]
        terms = [
            f"{_number(amplitude)} {reads.format(**words)}"
            for amplitude, reads in zip(amplitudes, self.reads, strict=True)
        ]
        return " + ".join(terms).replace("+ -", "- ")


def _number(x: float) -> str:
    """Write a number with four significant digits."""
    return f"{x:.4g}"


def dictionary(axes: Sequence[Axis]) -> list[CurveLaw]:
    """List the laws (formulas with free amplitudes) that a curve over one or two
    variables may follow; an axis is a variable with its range.
    """
    return _laws_of_one(*axes) if len(axes) == 1 else _laws_of_two(*axes)


def _laws_of_one(axis: Axis) -> list[CurveLaw]:
    """List the candidate laws of a curve over one variable x.

    They are each function of _FUNCTIONS (powers, sign, root), x + x^2, x + x^2 + x^3,
    saturations and exponentials of x / b, waves sin(b x + phase), and bumps exp(-((x -
    b) / c)^2). Widths b begin at 1 % to three times the largest |x|; places b over the
    range, and widths c of 3 to 50 % of it.
    """
    if axis.is_sign:
        return [_sum_law("{x}")]
    # A law's function takes the values p of the variables and its constants b.
    largest = max(abs(axis.low), abs(axis.high))
    widths = np.geomspace(0.01, 3.0, 20) * largest
    laws = [_sum_law(reads) for reads in _FUNCTIONS]
    laws += [_sum_law("{x}", "{x}^2"), _sum_law("{x}", "{x}^2", "{x}^3")]
    laws += [_scaled_law(g, reads, widths) for reads, g in _SCALED_FUNCTIONS.items()]
    # exp(x / b) overflows for narrow widths b; it may rise or fall.
    wide = widths[widths > 0.05 * largest]
    laws.append(_scaled_law(np.exp, "exp({x} / {b})", np.concatenate([wide, -wide])))
    frequencies = [(float(b),) for b in _waves(axis, _SCAN_STEPS)]
    laws.append(_wave(lambda p, b: b[0] * p[0], "{b} {x}", frequencies))
    places = np.linspace(axis.low, axis.high, _SCAN_STEPS // 2)
    bump_widths = np.geomspace(0.03, 0.5, 8) * (axis.high - axis.low)
    bump = CurveLaw(
        lambda p, b: [np.exp(-(((p[0] - b[0]) / b[1]) ** 2))],
        ("exp(-(({x} - {b}) / {c})^2)",),
        [(float(b), float(c)) for b, c in product(places, bump_widths)],
    )
    return [*laws, bump]


def _sum_law(*reads: str) -> CurveLaw:
    """Make the law a1 g1(x) + a2 g2(x) + ..., without other constants than its
    amplitudes; ``reads`` are the functions g as keys of _FUNCTIONS.
    """
    return CurveLaw(lambda p, _: [_FUNCTIONS[g](p[0]) for g in reads], reads)


def _scaled_law(g: Function, reads: str, widths: Array) -> CurveLaw:
    """Make the law a g(x / b), such as a tanh(x / b), which reads as ``reads``, with
    the widths b with which fits begin, in the variable's unit."""
    starts = [(float(b),) for b in widths]
    return CurveLaw(lambda p, b: [g(p[0] / b[0])], (reads,), starts)


def _laws_of_two(first: Axis, second: Axis) -> list[CurveLaw]:
    """List the candidate laws of two variables x and y.

    They are products f(x) g(y), a wave of one variable times a function of the other,
    and a wave whose phase is b x + c y, with b > 0: (-b, -c) with another phase is the
    same wave. A sign of a velocity has no wave.
    """
    axes = first, second
    # A sign of a velocity has itself only: its powers are the same two values.
    factors = [_OF_A_PAIR[:1] if axis.is_sign else _OF_A_PAIR for axis in axes]
    laws = [_product_law(f, g) for f, g in product(*factors)]
    for k, axis in enumerate(axes):
        if not axis.is_sign:
            laws += [_wave_times(k, axis, g) for g in factors[1 - k]]
    if not (first.is_sign or second.is_sign):
        fastest = _fastest(second)
        of_first = np.linspace(0.0, _fastest(first), _SCAN_STEPS // 4)[1:]
        of_second = np.linspace(-fastest, fastest, _SCAN_STEPS // 2)
        wave = _wave(
            lambda p, b: b[0] * p[0] + b[1] * p[1],
            "{b} {x} + {c} {y}",
            [(float(b), float(c)) for b, c in product(of_first, of_second)],
        )
        laws.append(wave)
    return laws


def _product_law(f: str, g: str) -> CurveLaw:
    """Make the law a f(x) g(y) of two functions, keys of _FUNCTIONS."""

    def terms(p: Array, _: Array) -> list[Array]:
        """Return the product at the points."""
        return [_FUNCTIONS[f](p[0]) * _FUNCTIONS[g](p[1])]

    return CurveLaw(terms, (f"{f} {_of_second(g)}",))


def _wave_times(k: int, axis: Axis, g: str) -> CurveLaw:
    """Make the law of a wave of variable k (from 0) of two, whose range is ``axis``,
    times a function g of the other one, a key of _FUNCTIONS."""
    return _wave(
        lambda p, b: b[0] * p[k],
        "{b} {y}" if k else "{b} {x}",
        [(float(b),) for b in _waves(axis, _SCAN_STEPS // 2)],
        lambda p: _FUNCTIONS[g](p[1 - k]),
        f" {g if k else _of_second(g)}",
    )


def _of_second(reads: str) -> str:
    """Replace the variable {x} in the text of a factor by the second variable {y}."""
    return reads.replace("{x}", "{y}")


def _wave(
    phase: Callable[[Array, Array], Array],
    reads: str,
    starts: Sequence[tuple[float, ...]],
    factor: Function = lambda p: np.ones_like(p[0]),
    other_factor: str = "",
) -> CurveLaw:
    """Make the law of a wave: sine and cosine of a phase, times a factor.

    Parameters
    ----------
    phase
        Maps variables (v, P) and constants (c,) to the phase [rad].
    reads
        Text of the phase, such as "{b} {x}".
    factor
        Function of the variables that multiplies the wave; default: 1.
    """
    return CurveLaw(
        lambda p, b: [g(phase(p, b)) * factor(p) for g in (np.sin, np.cos)],
        (f"sin({reads} + {{phase}}){other_factor}",),
        starts,
    )


def _fastest(axis: Axis) -> float:
    """Return the angular frequency of the fastest wave that the splines of a variable
    can follow [rad per unit of the variable].

    It is 70 % of the highest one, at which a wave has two knots: pi / (distance of
    knots).
    """
    return 0.7 * np.pi * (axis.count - 3) / (axis.high - axis.low)


def _waves(axis: Axis, count: int) -> Array:
    """Return angular frequencies (count + 2,) [rad per unit of the variable] with which
    fits of a wave begin.

    ``count`` of them are equally spaced, from half a wave over the range of the
    variable to the fastest wave that the splines can follow. Two slower ones, 0.1 and
    0.25 of a wave, come first.
    """
    slowest = 2.0 * np.pi / (axis.high - axis.low)
    return np.append(
        [0.1 * slowest, 0.25 * slowest],
        np.linspace(0.5 * slowest, _fastest(axis), count),
    )


# Which of them a curve is.


@dataclass(frozen=True)
class LawFit:
    """A law fitted to a curve."""

    #: The law.
    law: CurveLaw
    #: (m,) amplitudes of the law's terms.
    amplitudes: Array
    #: (c,) non-linear constants.
    constants: Array
    #: Drop of the weighted squared error.
    chi2: float
    #: The law's columns on the rows, None if it was not fitted there.
    columns: CurveColumns | None = None

    @property
    def size(self) -> int:
        """The number of amplitudes and constants."""
        return len(self.amplitudes) + len(self.constants)

    def torque_at(self, points: Array) -> Array:
        """Return the torque (P,) [N m or N] of the law at points (P, number of
        variables).
        """
        return self.law.columns(points, self.constants) @ self.amplitudes


def recognise_law(
    curve: SplineFit, on_rows: Callable[[CurveLaw, Array], CurveColumns], looked: int
) -> tuple[float, LawFit | None]:
    """Find the simplest law with about as much evidence as the best law and as the
    curve.

    "About as much" is within EVIDENCE_TO_DISTINGUISH (6, odds of 20 to 1) plus 4 %. A
    law is a formula with amplitudes and non-linear constants, such as a tanh(x / b).

    Parameters
    ----------
    on_rows
        Maps a law and its constants (c,) to its columns on the rows of the log.
    looked
        Number of bases among which the curve was chosen.

    Returns
    -------
    float
        The evidence J of the law, or of the curve if no law is returned.
    LawFit or None
        The law; None if none has enough evidence.
    """

    def in_splines(law: CurveLaw, constants: Array) -> tuple[Array, Array]:
        """Return the normal equations of a law approximated by the splines."""
        coefficients = _coefficients_in_splines(curve.basis, law, constants)
        return _normal_equations(coefficients, curve.columns)

    def evidence_of(fit: LawFit) -> float:
        """Return the evidence J of a law by its drop of the squared error."""
        n_numbers = np.array(fit.size)
        return float(curve.columns.score(np.array(fit.chi2), n_numbers, looked))

    # Fast: every law at the best of its starts, approximated by the curve's splines.
    fits = []
    for law, coefficients in _laws_with_starts(curve.basis):
        gram, pull = _normal_equations(coefficients, curve.columns)
        amplitudes, chi2 = _solve_amplitudes(gram, pull)
        best = int(np.argmax(chi2))
        constants = np.array(law.starts[best], float)
        fits.append(LawFit(law, amplitudes[best], constants, float(chi2[best])))
    fits.sort(key=evidence_of, reverse=True)
    # Exact: the best few with refined constants, fitted on the rows of the log.
    scored = []
    for start in fits[:MAX_CANDIDATES_REFINED]:
        refined = _refine_law(start, in_splines)
        columns = on_rows(refined.law, refined.constants)
        amplitudes, chi2 = _solve_amplitudes(
            columns.gram_left[None], columns.with_residual[None]
        )
        exact = replace(
            refined, amplitudes=amplitudes[0], chi2=float(chi2[0]), columns=columns
        )
        scored.append((evidence_of(exact), exact))
    top = max([curve.evidence, *(evidence for evidence, _ in scored)])
    equivalent = [pair for pair in scored if top - margin(top) < pair[0]]
    # The fewest numbers first, then the highest evidence.
    return min(
        equivalent,
        key=lambda pair: (pair[1].size, -pair[0]),
        default=(curve.evidence, None),
    )


@lru_cache(maxsize=64)
def _points_and_inverse(basis: Basis) -> tuple[Array, Array]:
    """Return P grid points of a basis (P, v) over its v variables, and the
    pseudo-inverse (k, P) of the splines there, which maps values to spline
    coefficients.

    For a pair of variables every second point along each is used, for speed.
    """
    is_pair = len(basis.axes) > 1
    along_axes = []
    for axis in basis.axes:
        stride = 2 if is_pair and not axis.is_sign else 1
        along_axes.append(axis.points[::stride])
    points = np.array(list(product(*along_axes)))
    inverse = np.linalg.pinv(basis.evaluate(*points.T), rcond=1e-10)
    return points, np.asarray(inverse, float)


def _coefficients_in_splines(basis: Basis, law: CurveLaw, constants: Array) -> Array:
    """Approximate a law's m terms by the k splines of a basis, for S sets of constants
    at once.

    Parameters
    ----------
    law
        The law, such as a tanh(x / b).
    constants
        (c, S) its non-linear constants.

    Returns
    -------
    (S, m, k) array
        Spline coefficients of each term.
    """
    points, inverse = _points_and_inverse(basis)
    with np.errstate(over="ignore", invalid="ignore"):  # a refined law may overflow
        return np.tensordot(law.columns(points, constants), inverse, axes=(0, 1))


@lru_cache(maxsize=64)
def _laws_with_starts(basis: Basis) -> list[tuple[CurveLaw, Array]]:
    """List the candidate laws of a basis with the spline coefficients of their starts.

    Starts (constants that a fit begins with) whose values are not finite are left out,
    and so are laws without any finite start.

    Returns
    -------
    list of (CurveLaw, (S, m, k) array)
        The law with its S starts, and the k spline coefficients of its m terms at each.
    """
    out = []
    for law in dictionary(basis.axes):
        starts = np.array(law.starts, float)
        coefficients = _coefficients_in_splines(basis, law, starts.T)
        is_finite = np.isfinite(coefficients).all(axis=(1, 2))
        if is_finite.any():
            finite_starts = [tuple(s) for s in starts[is_finite]]
            law = replace(law, starts=finite_starts)
            out.append((law, coefficients[is_finite]))
    return out


def _normal_equations(
    coefficients: Array, splines: CurveColumns
) -> tuple[Array, Array]:
    """Return the normal equations of a law's amplitudes, C D C' (S, m, m) and C s (S,
    m), for S sets of constants with coefficients C (S, m, k) of the m terms in the k
    splines.

    D (k, k) are the products of the splines with each other, s (k,) those with the
    residual. Where a law overflows the equations are not finite, and
    :func:`_solve_amplitudes` ignores the set.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        flat = coefficients.reshape(-1, coefficients.shape[2])
        weighed = (flat @ splines.gram_left).reshape(coefficients.shape)
        gram = weighed @ coefficients.transpose(0, 2, 1)
        return gram, coefficients @ splines.with_residual


def law_in_words(law: LawFit, curve: SplineFit, torque_units: Sequence[str]) -> str:
    """Write a law as a formula with the unit of its torque, and of its variables in
    brackets.

    Parameters
    ----------
    curve
        The curve that follows it, which knows joint and variables.
    torque_units
        Unit of the torque of each joint, such as "N m".
    """
    names, units = [], []
    for axis in curve.basis.axes:
        name = axis.variable.name
        is_sum = axis.variable.other >= 0  # of two joints' positions or velocities
        names.append(f"({name})" if is_sum else name)
        unit = Variable.parse(name).unit(torque_units)
        if unit != "-":
            units.append(f"{name} in {unit}")
    text = law.law.text(names, law.amplitudes, law.constants)
    in_brackets = f" ({', '.join(units)})" if units else ""
    return f"{text} {plain_unit(torque_units[curve.joint])}{in_brackets}"


def _solve_amplitudes(gram: Array, pull: Array) -> tuple[Array, Array]:
    """Solve the normal equations of S sets of constants for the m amplitudes.

    Parameters
    ----------
    gram
        (S, m, m) products of the columns.
    pull
        (S, m) products with the residual.

    Returns
    -------
    (S, m) array
        Amplitudes; 0 where a column is not visible in the rows, such as a bump where
        the motion never was.
    (S,) array
        The drop of the squared error.
    """
    # "smm->sm" takes the diagonal of each matrix.
    is_visible = np.einsum("smm->sm", gram) > DEPENDENT**2
    is_finite = np.isfinite(gram).all(axis=(1, 2))
    known = is_finite & is_visible.all(axis=1)
    gram = np.where(known[:, None, None], gram, 0.0)
    pull = np.where(known[:, None], pull, 0.0)
    # Solved with columns of unit length, scaled back afterwards.
    scale = np.sqrt(np.maximum(np.einsum("smm->sm", gram), 1e-300))
    gram = gram / (scale[:, :, None] * scale[:, None, :])
    pull = pull / scale
    inverse = np.linalg.pinv(gram, rcond=1e-9, hermitian=True)
    amplitudes = (inverse @ pull[:, :, None])[:, :, 0]
    return amplitudes / scale, np.sum(amplitudes * pull, axis=1)


def _refine_law(
    start: LawFit, normal: Callable[[CurveLaw, Array], tuple[Array, Array]]
) -> LawFit:
    """Refine a law's non-linear constants by Nelder-Mead, within the range of its
    starts.

    Parameters
    ----------
    start
        The law at the constants (c,) to begin with. It is returned unchanged if it has
        no constants, or if nothing is gained.
    normal
        Maps a law and constants (c, S) to the normal equations of its amplitudes.
    """
    if not len(start.constants):
        return start
    law = start.law
    low, high = law.ends

    def amplitudes_and_chi2(constants: Array) -> tuple[Array, float]:
        """Return amplitudes (m,) and the drop of the squared error."""
        gram, pull = normal(law, constants[:, None])  # one set of constants: S = 1
        amplitudes, chi2 = _solve_amplitudes(gram, pull)
        return amplitudes[0], float(chi2[0])

    solution = scipy.optimize.minimize(
        lambda constants: -amplitudes_and_chi2(constants)[1],
        start.constants,
        method="Nelder-Mead",
        bounds=list(zip(low, high, strict=True)),
        options={"xatol": 1e-4, "fatol": 1e-4 * start.chi2},
    ).x
    amplitudes, chi2 = amplitudes_and_chi2(solution)
    return LawFit(law, amplitudes, solution, chi2) if chi2 > start.chi2 else start
