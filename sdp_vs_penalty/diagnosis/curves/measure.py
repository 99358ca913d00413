"""Curves of the joints on which something without a name is left: which variables,
instead of which findings, and the law that it may be. One score decides, the one of all
other forms."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.constants import (
    EVIDENCE_TO_ADD,
    EVIDENCE_TO_DISTINGUISH,
    LAW_TOLERANCE,
    MAX_CANDIDATES_REFINED,
    THIRDS,
)
from sdp_vs_penalty.diagnosis.curves.bases import (
    Basis,
    CurveColumns,
    SplineFit,
    Variables,
    band,
    pairs_of,
    smoothed,
)
from sdp_vs_penalty.diagnosis.curves.curve import Curve, table_effect
from sdp_vs_penalty.diagnosis.curves.laws import Law, LawFit, recognised, written
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.white_rows import folds_of
from sdp_vs_penalty.effects.effect import Effect, follows_alone
from sdp_vs_penalty.effects.measured_curve import MeasuredCurve, Variable
from sdp_vs_penalty.robot.arrays import Array

#: The score of a curve, the curve, and the law that it is.
_Rated = tuple[float, SplineFit, LawFit | None]


@dataclass(frozen=True)
class Measured:
    """A curve as an effect: table, and by fold the values that the other folds' rows
    make; replaced : the terms that it stands instead of; J : score; before : held-out
    error of its joint without it, errors (n,) : with it, where it is offered."""

    fitted: SplineFit
    law: LawFit | None
    table: MeasuredCurve
    by_fold: tuple[MeasuredCurve, ...]
    variables: Variables
    replaced: tuple[ScoredEffect, ...]
    J: float
    before: float = np.nan
    errors: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def joint(self) -> int:
        return self.fitted.joint

    def to_curve(self, seed: int, floor: float) -> Curve:
        """For a reader; floor : of its joint's noise, zero where that is not known."""
        f = self.fitted
        robot = self.table.robot
        before = self.before
        after = self.errors[self.joint]
        share = (before**2 - after**2) / max(before**2 - floor**2, 1e-300)
        points = self.variables.supported(f.basis)
        grid = f.basis.at(*points.T)
        torque = grid @ f.coefficients
        half = band(f, grid, seed)
        filled = points[:0]
        beyond = np.zeros(0)
        if self.law is not None:
            torque = self.law.at(points)
            filled = unmeasured(f.basis, points)
            beyond = self.law.at(filled)
        single = points.shape[1] == 1
        return Curve(
            f.joint + 1,
            f.basis.of,
            points[:, 0] if single else points,
            torque,
            torque - half,
            torque + half,
            float(np.clip(share, 0.0, 1.0)),
            None if self.law is None else written(self.law, f, robot.torque_units),
            before,
            float(after),
            filled[:, 0] if single else filled,
            beyond,
        )


def in_parts(search: Search) -> list[int]:
    """Joints (from 0) on which two terms or more follow nothing but its position:
    parts, perhaps, of one function of it."""
    parts = [
        next(iter(t.joints))
        for t in search.terms
        if len(t.joints) == 1 and follows_alone(t.form.effect, "q")
    ]
    return sorted({j for j in parts if parts.count(j) > 1})


def measure_curves(
    search: Search,
    left: Sequence[int],
    fold: NDArray[np.intp] | None = None,
) -> list[Measured]:
    """Curves of the joints (from 0) on which something is ``left``, and of those whose
    terms may be parts of one function of the joint's position.

    A curve stands beside all terms, or instead of those of its joint alone. fold (M,) :
    for the values without each fold; thirds by phase by default.
    """
    parts = in_parts(search)
    if not left and not parts:
        return []
    variables = Variables(search.data.rows, search.data.estimate.robot)
    if fold is None:
        fold = folds_of(search.data.rows, THIRDS)
    out: list[Measured] = []
    for joint in dict.fromkeys([*left, *parts]):
        of_joint = [t for t in search.terms if t.joints == {joint}]
        others = [t for t in search.terms if t not in of_joint]
        beside = None
        if joint in left:
            beside = _best(search, search.terms, joint, variables)
        alone = None
        if of_joint and (beside is not None or joint in parts):
            alone = _best(search, others, joint, variables)
        worth = sum(t.evidence for t in search.score_jointly(of_joint, others))
        if alone is not None and _instead(worth, of_joint, alone, beside):
            _, fit, law = alone
            out.append(
                _measured(
                    search,
                    fit,
                    law,
                    variables,
                    fold,
                    tuple(of_joint),
                )
            )
        elif beside is not None:
            _, fit, law = beside
            out.append(
                _measured(
                    search,
                    fit,
                    law,
                    variables,
                    fold,
                    (),
                )
            )
    return out


def _instead(
    worth: float,
    own_terms: Sequence[ScoredEffect],
    curve_alone: _Rated,
    beside_terms: _Rated | None,
) -> bool:
    """Whether a curve alone stands in the place of a joint's terms, worth so much:
    where these need a curve besides, or have more constants than its law, it only has
    to be as good."""
    J, _, law = curve_alone
    named = max(worth, 0.0) + (0.0 if beside_terms is None else beside_terms[0])
    threshold = EVIDENCE_TO_DISTINGUISH + LAW_TOLERANCE * named
    simpler = law is not None and law.size < sum(
        t.form.n_coefficients + t.form.constants for t in own_terms
    )
    return (
        named + (-threshold if beside_terms is not None or simpler else threshold) < J
    )


def _best(
    search: Search,
    terms: Sequence[ScoredEffect],
    joint: int,
    variables: Variables,
) -> _Rated | None:
    """The curve of a joint that scores most beside some terms, with its law."""
    measuring = _Measuring(search, terms, joint, variables)
    best = measuring.best_spline()
    if best is None:
        return None
    J, law = measuring.recognise(best)
    if law is not None and not search.rules.curve_laws:
        return best.J, best, None
    return max(best.J, J), best, law


class _Measuring:
    """Curves of one joint beside some terms of a search."""

    def __init__(
        self,
        search: Search,
        terms: Sequence[ScoredEffect],
        joint: int,
        variables: Variables,
    ) -> None:
        data = search.data
        self.data = data
        self.score = search.score
        self.joint = joint
        self.variables = variables
        self.fit = search.score.fit(
            search.nuisances.with_law_misfits(terms), search.fit
        )
        self.gain = 1.0 if data.rows.gains is None else data.rows.gains[joint]
        effects = [
            *data.estimate.model.effects,
            *(t.form.effect for t in terms),
        ]
        bases = [variables.basis(v) for v in self._new_variables(effects)]
        self.bases = [b for b in bases if b is not None]
        if not search.rules.curves_of_two:
            self.bases = [b for b in self.bases if len(b.axes) == 1]

    def _new_variables(self, effects: Sequence[Effect]) -> list[tuple[Variable, ...]]:
        """All but those of which some effect is a curve already."""
        curves = [
            e
            for e in effects
            if isinstance(e, MeasuredCurve) and self.joint in e.joints
        ]
        taken = {tuple(v.name for v in e.variables(self.joint)) for e in curves}
        return [
            v
            for v in pairs_of(self.joint, self.variables.robot, self.variables.warm)
            if tuple(x.name for x in v) not in taken
        ]

    def _columns(self, raw: Array, robust: bool) -> CurveColumns:
        """Of what a curve's functions (M, k) make of the joint's torque."""
        white = self.data.white(raw, self.joint)
        return CurveColumns.of(
            self.score,
            self.fit,
            white,
            self.joint,
            robust,
        )

    def _smoothed(
        self,
        basis: Basis,
        raw: Array,
        robust: bool,
    ) -> SplineFit:
        raw = self.gain * raw
        columns = self._columns(raw, robust)
        return smoothed(basis, raw, columns, len(self.bases))

    def best_spline(self) -> SplineFit | None:
        """Of those that score about as much as the best one, that of the fewest
        variables; None where none has enough evidence."""
        close = self._most_promising()
        exact = [
            self._smoothed(
                b,
                self.variables.exact(b),
                True,
            )
            for b in close
        ]
        nearly = (1.0 - LAW_TOLERANCE) * max((f.J for f in exact), default=0.0)
        threshold = max(nearly - EVIDENCE_TO_DISTINGUISH, EVIDENCE_TO_ADD)
        equivalent = [f for f in exact if threshold < f.J]
        return min(
            equivalent,
            key=lambda f: (len(f.basis.axes), -f.J),
            default=None,
        )

    def _most_promising(self) -> list[Basis]:
        """The best few of one variable and of two, by rough columns."""
        rough = []
        for basis in self.bases:
            columns = self.variables.coarse(basis.roughly)
            rough.append((self._smoothed(basis.roughly, columns, False).J, basis))
        rough = [(J, b) for J, b in rough if J > EVIDENCE_TO_ADD]
        rough.sort(key=lambda pair: -pair[0])
        out = list[Basis]()
        for n_variables in (1, 2):
            same = [b for _, b in rough if len(b.axes) == n_variables]
            out += same[: MAX_CANDIDATES_REFINED // 2]
        return out

    def recognise(self, best: SplineFit) -> tuple[float, LawFit | None]:
        """The law of the dictionary that a spline is, with its score."""

        def on_rows(law: Law, constants: Array) -> CurveColumns:
            raw = self.variables.of_law(best.basis, lambda x: law.columns(x, constants))
            return self._columns(self.gain * raw, robust=False)

        return recognised(best, on_rows, len(self.bases))


def _measured(
    search: Search,
    f: SplineFit,
    law: LawFit | None,
    variables: Variables,
    fold: NDArray[np.intp],
    replaced: tuple[ScoredEffect, ...],
) -> Measured:
    robot = search.data.estimate.robot
    points = variables.supported(f.basis)
    measured = len(points)
    if law is None or law.columns is None:
        values = f.basis.at(*points.T) @ f.coefficients
        grid = f.basis.at(*points.T) @ f.projector
        columns = f.columns
        P = f.P
    else:
        points = np.vstack([points, unmeasured(f.basis, points)])
        values = law.at(points)
        grid = law.law.columns(points, law.constants)
        columns = law.columns
        P = 1e-9 * np.trace(columns.raw) * np.eye(len(columns.s))
    table = table_effect(
        robot,
        f.joint,
        f.basis.of,
        points,
        values,
        measured,
    )
    known = variables.met(f.basis, variables.keep)
    by_fold = []
    for k, c in enumerate(columns.without_fold(fold, P)):
        there = np.ones(len(points), bool)
        if law is None:  # a table knows nothing of where only the fold has been
            there = variables.met(f.basis, variables.keep & (fold != k))[known]
        if (
            not np.diff(points[there], axis=0).any(axis=0).all()
        ):  # nothing at all of a single value
            there[:], c = True, np.zeros_like(c)
        n_measured = min(measured, int(there.sum()))
        fold_values = (grid @ c)[there]
        by_fold.append(
            table_effect(
                robot,
                f.joint,
                f.basis.of,
                points[there],
                fold_values,
                n_measured,
            )
        )
    return Measured(
        f,
        law,
        table,
        tuple(by_fold),
        variables,
        replaced,
        f.J,
    )


def unmeasured(basis: Basis, points: Array) -> Array:
    """(P', v) the points of a basis's grid that are not among ``points`` (P, v)."""
    have = {tuple(p) for p in points.tolist()}
    left = [p for p in basis.points.tolist() if tuple(p) not in have]
    return np.reshape(left, (-1, points.shape[1]))
