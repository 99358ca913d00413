"""Recognition: the simplest law of a small dictionary that a curve is, by the score of all other forms.

A law a g(x; b) is put into the curve's own splines, c_g, and scored through their products:
a = c_g's / c_g'D c_g. The best of these are fitted once more on the rows themselves. Of those that score
about as much as the curve does, the simplest that explains about as much as any is named.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from sdp_vs_penalty.diagnosis.constants import CLOSELY, EQUIVALENT, FORM
from sdp_vs_penalty.diagnosis.curves.bases import Basis
from sdp_vs_penalty.diagnosis.curves.laws import Law, dictionary
from sdp_vs_penalty.diagnosis.curves.spline_fit import Columns, SplineFit
from sdp_vs_penalty.diagnosis.score import Score
from sdp_vs_penalty.effects.curve_variable import Variable
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.robot.arrays import Array

#: White energy of a law's column, per unit of its amplitude, below which rows do not see it.
_UNSEEN = 1e-9
#: Trials of constants on the way to the best.
_STEPS = 80

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
    scan = _scan(f.basis)

    def in_splines(law: Law, constants: Array) -> tuple[Array, Array]:
        return _normal(scan.coefficients(law, constants), f.columns)

    def rated(fit: LawFit) -> float:
        return f.columns.score(fit.chi2, fit.size, looked)

    rough = sorted(scan.fitted(f.columns), key=rated, reverse=True)[:CLOSELY]
    found = []
    for law in (_refined(r, in_splines) for r in rough):
        raw = on_rows(law.law, law.constants)
        own = Columns.of(score, f.columns.fit, score.data.white(raw, f.joint), f.joint, robust=False)
        a, chi2 = _amplitudes(own.D[None], own.s[None])
        exact = LawFit(law.law, a[0], law.constants, float(chi2[0]))
        found.append((rated(exact), exact))
    return sorted(found, key=lambda r: -r[0])


def law_of(laws: Sequence[tuple[float, LawFit]], f: SplineFit) -> LawFit | None:
    """The simplest law that scores about what the best does, and the curve; None where none does."""
    top = max([f.J, *(J for J, _ in laws)])
    alike = [(J, law) for J, law in laws if top - EQUIVALENT - FORM * top < J]
    if not alike:
        return None
    return min(alike, key=lambda r: (r[1].size, -r[0]))[1]


@dataclass(frozen=True)
class _Scan:
    """The dictionary at all of its starts, in the splines of a basis: inverses make coefficients of
    values on its grid, axis by axis; of each law coefficients (S, m, k), one set for each start."""

    grid: Sequence[Array]
    inverses: Sequence[Any]
    laws: list[tuple[Law, Array]] = field(default_factory=list)

    def coefficients(self, law: Law, constants: Array) -> Array:
        """(S, m, k) with S sets of constants (c, S)."""
        values = law.on_grid(self.grid, constants)
        for inverse in self.inverses:  # each axis goes behind the sets and the terms
            values = np.tensordot(values, inverse, axes=(0, 1))
        return values.reshape(*values.shape[:2], -1)

    def fitted(self, factors: Columns) -> list[LawFit]:
        """Each law at the start that explains most."""
        out = []
        for law, c in self.laws:
            a, chi2 = _amplitudes(*_normal(c, factors))
            best = int(np.argmax(chi2))
            out.append(LawFit(law, a[best], np.array(law.starts[best], float), float(chi2[best])))
        return out


@lru_cache(maxsize=64)
def _scan(basis: Basis) -> _Scan:
    # Of a pair every second point is enough: splines along each are few.
    grid = [x[:: 1 if len(basis.axes) == 1 or len(x) == 2 else 2] for x in basis.grid]
    pairs = zip(basis.axes, grid, strict=True)
    out = _Scan(grid, [np.linalg.pinv(axis.columns(x), rcond=1e-10) for axis, x in pairs])
    for law in dictionary(basis.axes):
        starts = np.array(law.starts, float)
        c = out.coefficients(law, starts.T)
        held = np.isfinite(c).all(axis=(1, 2))
        if held.any():
            out.laws.append((replace(law, starts=[tuple(s) for s in starts[held]]), c[held]))
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
    visible = np.einsum("smm->sm", gram) > _UNSEEN
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
    options = {"initial_simplex": corners, "maxfev": _STEPS, "xatol": 1e-6, "fatol": 1e-6 * start.chi2}
    bounds = list(zip(low, high, strict=True))
    found = minimize(left, start.constants, method="Nelder-Mead", bounds=bounds, options=options).x
    a, chi2 = _amplitudes(*normal(law, found[:, None]))
    return LawFit(law, a[0], found, float(chi2[0])) if chi2[0] > start.chi2 else start
