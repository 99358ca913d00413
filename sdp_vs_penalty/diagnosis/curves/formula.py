"""Recognition: the simplest law of a small dictionary that a curve is.

A law a g(x; b) is put into the curve's own splines, c_g, and fitted through their compressed factors:
a = c_g's / c_g'D c_g, with what the model's own columns can make left open. The best of these, which
splines may only hold roughly (a sign, a wave that is short), are fitted once more on the rows
themselves. Of those that gain on data left out what the curve gains and stay within its band, unless
they gain more than the curve, which is then too coarse for them, the simplest is named that explains
about as much as any.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import optimize

from sdp_vs_penalty.diagnosis.curves.bases import Basis
from sdp_vs_penalty.diagnosis.curves.fitted import Fitted, Look
from sdp_vs_penalty.diagnosis.curves.laws import Law, dictionary
from sdp_vs_penalty.diagnosis.curves.smooth import Factors, held_out_gain, identifiable
from sdp_vs_penalty.effects.curve_variable import Variable
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.show import plain_unit

#: How many laws are fitted on the rows themselves, and their constants where a law explains there such a
#: share of what the best does.
_EXACT, _LIKELY = 8, 0.8
#: Share of the points of a curve at which a law lies in its band: where few measurements lie, the
#: smoothing shows. The band is at least so wide, as a share of the curve from peak to peak: a strong
#: torque shows also that its model is not perfect. So much of the curve's gain a law may lose, and of
#: what another law explains.
_INSIDE, _NEAR, _LOST, _ALIKE = 0.95, 0.05, 0.1, 0.02


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

    def cost(self, count: float) -> float:
        """-chi2 + (constants) log M (Schwarz 1978)."""
        return -self.chi2 + self.size * np.log(max(count, 2.0))


@dataclass(frozen=True)
class Recognised:
    """A law as it fits the rows, its gain on data left out, and its coefficients (k,) in the splines."""

    fit: LawFit
    gain: float
    coefficients: Array


def recognised(f: Fitted, look: Look, most: int = _EXACT, exact: bool = True) -> list[Recognised]:
    """Of the ``most`` likely laws those that gain about what a curve gains; exact : with constants that
    were fitted on the rows too."""
    every, count = f.basis.points, f.factors.count
    scan = _scan(f.basis)

    def in_splines(law: Law, constants: Array) -> tuple[Array, Array]:
        c = scan.inverse @ law.columns(every, constants)
        return c.T @ f.factors.D @ c, c.T @ f.factors.s

    def on_rows(law: Law, constants: Array) -> tuple[Array, Array]:
        factors, _ = Factors.of(look.fit, look.law(law.columns, constants, f), f.joint)
        return factors.D, factors.s

    rough = sorted(scan.fitted(f.factors), key=lambda r: r.cost(count))[:most]
    rough = [_refined(r, in_splines) for r in rough]
    on_row = [_solved(r.law, on_rows, r.constants) for r in rough]
    enough = _LIKELY * max((r.chi2 for r in on_row), default=0.0)
    found = []
    for fit in (r for r in on_row if r.chi2 >= enough):
        fit = _refined(fit, on_rows) if exact else fit
        if (gain := _gains(fit, f, look)) >= (1.0 - _LOST) * max(f.gain, 0.0):
            coefficients = scan.inverse @ fit.law.columns(every, fit.constants) @ fit.amplitudes
            found.append(Recognised(fit, gain, coefficients))
    return found


@dataclass(frozen=True)
class _Scan:
    """The dictionary at all of its starts, in the splines of a basis: inverse (k, P) makes coefficients
    of values on its grid; of each law coefficients (S, k, m), one set for each start."""

    inverse: Array
    laws: tuple[tuple[Law, Array], ...]

    def fitted(self, factors: Factors) -> list[LawFit]:
        """Each law at the start that explains most."""
        out = []
        for law, c in self.laws:
            gram = c.transpose(0, 2, 1) @ (factors.D @ c)
            pull = factors.s @ c
            scale = np.sqrt(np.maximum(np.einsum("smm->sm", gram), 1e-300))
            gram = gram / (scale[:, :, None] * scale[:, None, :])
            a = (np.linalg.pinv(gram, rcond=1e-9, hermitian=True) @ (pull / scale)[:, :, None])[:, :, 0]
            chi2 = np.sum(a / scale * pull, axis=1)
            best = int(np.argmax(chi2))
            constants = np.array(law.starts[best], float)
            out.append(LawFit(law, a[best] / scale[best], constants, float(chi2[best])))
        return out


@lru_cache(maxsize=64)
def _scan(basis: Basis) -> _Scan:
    points, laws = basis.points, []
    inverse = np.ones((1, 1))
    for axis, values in zip(basis.axes, basis.grid, strict=True):  # of a product, the products
        inverse = np.kron(inverse, np.linalg.pinv(axis.columns(values), rcond=1e-10))
    for law in dictionary(basis.axes):
        starts = np.array(law.starts, float)
        with np.errstate(over="ignore", invalid="ignore"):
            columns = law.columns(points, starts.T)
            c = np.moveaxis(np.tensordot(inverse, columns, axes=1), 1, 0)
        held = np.isfinite(c).all(axis=(1, 2))
        if held.any():
            kept = replace(law, starts=[tuple(s) for s in starts[held]])
            laws.append((kept, c[held]))
    return _Scan(inverse, tuple(laws))


def law_of(laws: Sequence[Recognised], f: Fitted, points: Array, half: Array) -> LawFit | None:
    """The simplest law, or None where none of the dictionary lies within the band.

    points (P, v), half (P,) : where the band is and how wide.
    """
    at = f.basis.at(*points.T) @ identifiable(f.factors, f.smooth.P)
    torque = at @ f.smooth.c
    wide = np.maximum(half, _NEAR * np.ptp(torque))
    passed = [
        r.fit
        for r in laws
        if r.gain > f.gain or np.mean(np.abs(at @ r.coefficients - torque) <= wide) >= _INSIDE
    ]
    if not passed:
        return None
    most = max(fit.chi2 for fit in passed)
    alike = [fit for fit in passed if fit.chi2 >= (1.0 - _ALIKE) * most]
    return min(alike, key=lambda fit: (fit.size, -fit.chi2))


def of_amplitudes(law: LawFit, f: Fitted, look: Look) -> tuple[Array, Array, Factors, Array]:
    """White columns Z of a law's amplitudes, C = Q'Z, their factors and their prior."""
    Z = look.law(law.law.columns, law.constants, f)
    factors, C = Factors.of(look.fit, Z, f.joint)
    (P,) = factors.priors((), np.zeros((1, 0)))
    return Z, C, factors, P


def _gains(law: LawFit, f: Fitted, look: Look) -> float:
    """What a law with its constants gains on data left out, its amplitudes from the others."""
    return held_out_gain(look.fit, *of_amplitudes(law, f, look), f.joint)


def written(law: LawFit, f: Fitted, torque_units: Sequence[str]) -> str:
    """The law as text with units."""
    unit = plain_unit(torque_units[f.joint])
    units = {v: Variable.parse(v).unit(torque_units) for v in f.basis.of}
    said = ", ".join(f"{v} in {u}" for v, u in units.items() if u != "-")
    text = law.law.text(law.amplitudes, law.constants)
    return f"{text} {unit}" + (f" ({said})" if said else "")


Normal = Callable[[Law, Array], tuple[Array, Array]]


def _solved(law: Law, normal: Normal, constants: Array) -> LawFit:
    """The amplitudes that explain most with these constants, none beyond the ends of the law's own
    starts; normal : matrix and right side of the normal equations of its amplitudes."""
    low, high = law.ends
    nothing = LawFit(law, np.zeros(0), constants, 0.0)
    if np.any(constants < low) or np.any(constants > high):
        return nothing
    with np.errstate(over="ignore", invalid="ignore"):
        gram, pull = normal(law, constants)
    if not np.all(np.isfinite(gram)):
        return nothing
    if len(pull) == 1:  # what a dictionary is mostly made of
        a = pull / gram[0] if gram[0, 0] > 1e-300 else 0.0 * pull
    else:
        scale = np.sqrt(np.maximum(np.diagonal(gram), 1e-300))
        a = np.linalg.lstsq(gram / np.outer(scale, scale), pull / scale, rcond=1e-9)[0] / scale
    return LawFit(law, a, constants, float(a @ pull))


def _refined(start: LawFit, normal: Normal) -> LawFit:
    """The constants near these that explain most."""
    law, constants = start.law, start.constants
    if not len(constants):
        return start
    low, high = law.ends
    step = np.minimum(0.1 * np.abs(constants) + 1e-3, 0.3 * (high - low))
    step *= np.where(constants + step > high, -1.0, 1.0)
    found = optimize.minimize(
        lambda s: -_solved(law, normal, s).chi2,
        constants,
        method="Nelder-Mead",
        options={
            "initial_simplex": np.vstack([constants, constants + np.diag(step)]),
            "maxiter": 60 * len(step),
            "fatol": 1e-4 * max(start.chi2, 1e-300),
            "xatol": 1e-4 * float(np.max(np.abs(constants))),
        },
    )
    return max((start, _solved(law, normal, found.x)), key=lambda r: r.chi2)
