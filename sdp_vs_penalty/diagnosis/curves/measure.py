"""Measured curves: the torque that no effect explains, as a function of one or two
variables. They are looked for on joints with unexplained torque, judged by the same
evidence J as effects, and may replace effects.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from sdp_vs_penalty.diagnosis.constants import (
    EVIDENCE_TO_ADD,
    MAX_CANDIDATES_REFINED,
    MAX_JOINT_HARM,
    SURE_HELP,
    THIRDS,
)
from sdp_vs_penalty.diagnosis.curves.bases import (
    Basis,
    CurveColumns,
    SplineFit,
    Variables,
    confidence_band,
    fit_spline,
    list_variables,
)
from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.diagnosis.curves.laws import (
    CurveLaw,
    LawFit,
    law_in_words,
    recognise_law,
)
from sdp_vs_penalty.diagnosis.held_out import HeldOutData, error_ratios, rows_by_stretch
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect, margin
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.white_rows import folds_of
from sdp_vs_penalty.effects.effect import Effect, JointEffect, follows_alone
from sdp_vs_penalty.effects.measured_curve import (
    Variable,
    table_effect,
    table_variables,
)
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask
from sdp_vs_penalty.signals.segments import SegmentedRuns


class _RatedCurve(NamedTuple):
    """The best curve of a joint."""

    #: Evidence of the law, or of the spline where that is larger.
    evidence: float
    #: The curve.
    spline: SplineFit
    #: The simple formula that it follows, or None.
    law: LawFit | None


@dataclass(frozen=True)
class Measured:
    """A curve that was measured on one joint, as an effect that can be judged and
    added."""

    #: The spline curve.
    fitted: SplineFit
    #: The law that the curve follows, or None.
    law: LawFit | None
    #: The curve as an effect.
    table: JointEffect
    #: For each fold the curve with values from the other folds' rows.
    by_fold: tuple[JointEffect, ...]
    #: Values of the variables on the rows.
    variables: Variables
    #: The findings that the curve replaces.
    replaced: tuple[ScoredEffect, ...]
    #: RMS error of the joint on data left out, without the curve [N m or N].
    before: float = np.nan
    #: (n,) RMS errors of all joints on data left out, with the curve [N m or N]; empty
    #: before it is accepted.
    errors: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def joint(self) -> int:
        """The joint (from 0) on which the curve was measured."""
        return self.fitted.joint

    def to_curve(self, seed: int, floor: float) -> Curve:
        """Return the accepted curve for the report: points, torque, confidence band and
        gain.

        The explained share is (before^2 - after^2) / (before^2 - floor^2), with the
        joint's RMS errors on data left out before and after the curve.

        Parameters
        ----------
        seed
            Seed of the random draws for the band.
        floor
            Noise floor of the joint [N m or N]; 0 if it is not known.
        """
        f = self.fitted
        robot = self.table.robot
        before = self.before
        after = float(self.errors[self.joint])
        energy_beyond_noise = max(before**2 - floor**2, 1e-300)
        share = (before**2 - after**2) / energy_beyond_noise
        points = self.variables.points_near_motion(f.basis)
        grid = f.basis.evaluate(*points.T)
        half_width = confidence_band(f, grid, seed)
        torque = grid @ f.coefficients
        formula = None
        # Points where nothing was measured: only a law has values there.
        filled = points[:0]
        filled_torque = np.zeros(0)
        if self.law is not None:
            torque = self.law.torque_at(points)
            formula = law_in_words(self.law, f, robot.torque_units)
            filled = unmeasured(f.basis, points)
            filled_torque = self.law.torque_at(filled)
        is_single = points.shape[1] == 1
        return Curve(
            joint=f.joint + 1,
            of=f.basis.variable_names,
            x=points[:, 0] if is_single else points,
            torque=torque,
            lower=torque - half_width,
            upper=torque + half_width,
            explained_share=float(np.clip(share, 0.0, 1.0)),
            formula=formula,
            held_out_rmse_before=before,
            held_out_rmse_after=after,
            filled_x=filled[:, 0] if is_single else filled,
            filled_torque=filled_torque,
        )


def in_parts(search: Search) -> list[int]:
    """Return the joints (from 0) with two or more findings that depend on position
    alone.

    Such findings (a spring and a ripple) may together be one function of the position,
    which a measured curve then replaces.
    """
    joints = list[int]()
    for term in search.terms:
        if len(term.joints) == 1 and follows_alone(term.form.effect, "q"):
            joints += term.joints
    return sorted({j for j in joints if joints.count(j) > 1})


def measure_curves(
    search: Search, left: Sequence[int], fold: Indices | None = None
) -> list[Measured]:
    """Measure curves on joints with unexplained torque, or with a function found in
    parts.

    Of each joint two curves are tried: one beside all findings, and one instead of the
    findings that act on this joint alone (a spring and a ripple may be parts of one
    function of position). The preferred one is returned.

    Parameters
    ----------
    search
        The findings beside the model.
    left
        Joints (from 0) with unexplained torque.
    fold
        (M,) fold of each row, for values of the curve that are judged on data left out;
        default: thirds by the phase of the motion.

    Returns
    -------
    list of Measured
        At most one curve for each joint.
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
        beside_all = None
        if joint in left:
            beside_all = _best_curve(search, search.terms, joint, variables)
        curve_alone = None
        if of_joint and (beside_all is not None or joint in parts):
            curve_alone = _best_curve(search, others, joint, variables)
        rescored = search.score_jointly(of_joint, others)
        J_of_findings = sum(t.evidence for t in rescored)
        chosen = beside_all
        replaced: tuple[ScoredEffect, ...] = ()
        if curve_alone is not None and is_curve_preferred(
            J_of_findings, of_joint, curve_alone, beside_all
        ):
            chosen = curve_alone
            replaced = tuple(of_joint)
        if chosen is not None:
            out.append(_tabulate(search, chosen, variables, fold, replaced))
    return out


def is_curve_preferred(
    J_of_findings: float,
    findings: Sequence[ScoredEffect],
    curve_alone: _RatedCurve,
    curve_beside: _RatedCurve | None,
) -> bool:
    """Return whether a curve alone replaces the findings of its joint.

    J is the evidence of the curve alone. B is the evidence of what it replaces: of the
    findings, and of the curve that was measured beside them, if any. margin = 6 (odds of
    20 to 1) + 4 % of B.

    The curve alone is simpler if its law has fewer numbers than the findings, or if the
    findings need a curve beside them. A simpler one may lose a margin: J > B - margin.
    Any other has to win by one: J > B + margin.

    Parameters
    ----------
    J_of_findings
        Joint evidence of the findings; a negative one counts as zero.
    findings
        The findings of the joint.
    """
    to_replace = max(J_of_findings, 0.0)
    if curve_beside is not None:
        to_replace += curve_beside.evidence
    n_numbers = sum(t.form.n_coefficients + t.form.n_constants for t in findings)
    law = curve_alone.law
    has_shorter_law = law is not None and law.size < n_numbers
    if curve_beside is not None or has_shorter_law:
        return to_replace - margin(to_replace) < curve_alone.evidence
    return to_replace + margin(to_replace) < curve_alone.evidence


def _best_curve(
    search: Search, terms: Sequence[ScoredEffect], joint: int, variables: Variables
) -> _RatedCurve | None:
    """Measure the best curve of a joint beside some findings.

    ``joint`` counts from 0.

    Parameters
    ----------
    search
        The search with its rows and scorer.
    terms
        The findings that stay in the model.
    variables
        Values of the variables on the rows.

    Returns
    -------
    _RatedCurve or None
        None if no curve has enough evidence.
    """
    measuring = _Measuring(search, terms, joint, variables)
    best = measuring.best_spline()
    if best is None:
        return None
    evidence, law = measuring.recognise(best)
    return _RatedCurve(max(best.evidence, evidence), best, law)


class _Measuring:
    """Fits curves of one joint beside some findings."""

    def __init__(
        self,
        search: Search,
        terms: Sequence[ScoredEffect],
        joint: int,
        variables: Variables,
    ) -> None:
        """Fit the model with the findings, and list the bases over which a curve may
        run.

        Parameters
        ----------
        search
            The search, for its rows, scorer and nuisances.
        terms
            The findings beside which a curve is measured.
        joint
            The joint (from 0) whose unexplained torque is measured.
        variables
            Values of the variables on the rows.
        """
        data = search.data
        self.data = data
        self.score = search.score
        self.joint = joint
        self.variables = variables
        self.fit = search.score.fit(
            search.nuisances.with_law_misfits(terms), search.fit
        )
        # Gain of the joint's torque channel, through which a curve's torque is logged.
        self.gain = 1.0 if data.rows.gains is None else data.rows.gains[joint]
        effects = [*data.estimate.model.effects, *(t.form.effect for t in terms)]
        self.bases = list[Basis]()
        for chosen in self._new_variables(effects):
            basis = variables.basis(chosen)  # None: a variable does not change
            if basis is not None:
                self.bases.append(basis)

    def _new_variables(self, effects: Sequence[Effect]) -> list[tuple[Variable, ...]]:
        """List the variables, and pairs of them, over which the joint has no measured
        curve yet.

        ``effects`` are those of the model and the findings; some may be measured
        curves.
        """
        joint = self.joint
        taken = {table_variables(effect, joint) for effect in effects}
        possible = list_variables(
            joint, self.variables.robot, self.variables.has_temperature
        )
        return [
            variables
            for variables in possible
            if tuple(variable.name for variable in variables) not in taken
        ]

    def _columns(self, raw: Array, robust: bool) -> CurveColumns:
        """Whiten the columns of a curve's functions, and multiply them with those of
        the fit.

        Parameters
        ----------
        raw
            (M, k) filtered functions, times the gain of the joint's torque channel.
        robust
            Whether the scorer accounts for correlated rows.
        """
        white = self.data.white(raw, self.joint)
        return CurveColumns.from_columns(
            self.score, self.fit, white, self.joint, robust
        )

    def _fit_spline(self, basis: Basis, raw: Array, robust: bool) -> SplineFit:
        """Fit a spline curve over one basis to the joint's unexplained torque.

        Parameters
        ----------
        raw
            (M, k) filtered splines, without the gain of the torque channel.
        robust
            Whether the scorer accounts for correlated rows.
        """
        columns = self._columns(self.gain * raw, robust)
        return fit_spline(basis, columns, looked=len(self.bases))

    def best_spline(self) -> SplineFit | None:
        """Return the spline curve with the highest evidence; None if none has enough.

        Among curves within 6 (odds of 20 to 1) plus 4 % of the highest evidence, one
        over a single variable is preferred to one over two.
        """
        exact = []
        for basis in self._most_promising():
            splines = self.variables.filtered_splines(basis)
            curve = self._fit_spline(basis, splines, robust=True)
            if not is_an_event(self._explained(curve), self.data.rows):
                exact.append(curve)
        highest = max((fit.evidence for fit in exact), default=0.0)
        threshold = max(highest - margin(highest), EVIDENCE_TO_ADD)
        return min(
            (fit for fit in exact if threshold < fit.evidence),
            key=lambda fit: (len(fit.basis.axes), -fit.evidence),
            default=None,
        )

    def _explained(self, curve: SplineFit) -> Array:
        """Return the weighted squares (M,) that a curve explains in each row."""
        left = self.fit.residual_of({self.joint: curve.columns.scaled})
        before = self.fit.residual
        after = before - left @ curve.solution
        return np.asarray(np.sum(before**2 - after**2, axis=0))

    def _most_promising(self) -> list[Basis]:
        """List the bases whose curves have most evidence, by a fast approximate fit.

        There are up to half of MAX_CANDIDATES_REFINED over one variable, then as many
        over two, all with more evidence than EVIDENCE_TO_ADD.
        """
        rated = []
        for basis in self.bases:
            splines = self.variables.approximate_splines(basis.coarser)
            rough_curve = self._fit_spline(basis.coarser, splines, robust=False)
            if rough_curve.evidence > EVIDENCE_TO_ADD:
                rated.append((rough_curve.evidence, basis))
        rated.sort(key=lambda pair: -pair[0])
        out = list[Basis]()
        for n_variables in (1, 2):
            best_first = [b for _, b in rated if len(b.axes) == n_variables]
            out += best_first[: MAX_CANDIDATES_REFINED // 2]
        return out

    def recognise(self, best: SplineFit) -> tuple[float, LawFit | None]:
        """Find the law (simple formula) that a spline follows, or None.

        Returns the evidence of the law, or of the spline if it follows none, and the
        law.
        """

        def on_rows(law: CurveLaw, constants: Array) -> CurveColumns:
            """Return the white columns of a law on the rows of the log."""
            raw = self.variables.filtered_law(
                best.basis, lambda x: law.columns(x, constants)
            )
            return self._columns(self.gain * raw, robust=False)

        return recognise_law(best, on_rows, len(self.bases))


def is_an_event(explained: Array, rows: SegmentedRuns) -> bool:
    """Return whether most of what is explained (M,) lies in one stretch of time (of PARTS
    or more): a contact, say, at a place where the motion comes once."""
    stretches, _ = rows_by_stretch(rows)
    by_stretch = [explained[x.any(axis=1)].sum() for x in stretches]
    return bool(max(by_stretch) > 0.5 * sum(by_stretch))


def _tabulate(
    search: Search,
    chosen: _RatedCurve,
    variables: Variables,
    fold: Indices,
    replaced: tuple[ScoredEffect, ...],
) -> Measured:
    """Tabulate a curve as an effect, once from all rows and once without each fold.

    A spline is tabulated where the motion has been. A law is tabulated over the whole
    grid, since it says what lies between.

    Parameters
    ----------
    search
        The findings beside the model.
    chosen
        The curve, with the law that it follows.
    variables
        Values of the variables on the rows.
    fold
        (M,) the fold of each row.
    replaced
        The findings that the curve replaces.

    Returns
    -------
    Measured
        The curve with its table, and a table for each fold from the other folds' rows.
    """
    spline, law = chosen.spline, chosen.law
    basis = spline.basis
    points = variables.points_near_motion(basis)
    n_measured = len(points)
    # Columns times coefficients are the values at the points.
    if law is None or law.columns is None:
        splines = basis.evaluate(*points.T)
        values = splines @ spline.coefficients
        at_points = splines @ spline.projector
        columns, penalty = spline.columns, spline.penalty
    else:
        points = np.vstack([points, unmeasured(basis, points)])
        values = law.torque_at(points)
        at_points = law.law.columns(points, law.constants)
        columns = law.columns
        penalty = 1e-9 * np.trace(columns.gram) * np.eye(len(columns.gram))

    def table(values: Array, is_known: Mask, n_measured: int) -> JointEffect:
        """Return the table of values (P,) at those points that are known."""
        return table_effect(
            search.data.estimate.robot,
            joint=spline.joint,
            of=basis.variable_names,
            points=points[is_known],
            values=values[is_known],
            measured=n_measured,
        )

    every = np.ones(len(points), bool)
    by_fold = []
    for number, coefficients in enumerate(columns.without_fold(fold, penalty)):
        values_of_fold = at_points @ coefficients
        is_known = every
        if law is None:
            is_known = _is_known_without_fold(variables, basis, fold == number)
        varies = np.diff(points[is_known], axis=0).any(axis=0)
        if not varies.all():  # a single value of a variable is no table: no torque
            is_known = every
            values_of_fold = np.zeros(len(points))
        n_known = int(is_known.sum())
        by_fold.append(table(values_of_fold, is_known, min(n_measured, n_known)))
    return Measured(
        fitted=spline,
        law=law,
        table=table(values, every, n_measured),
        by_fold=tuple(by_fold),
        variables=variables,
        replaced=replaced,
    )


def _is_known_without_fold(
    variables: Variables, basis: Basis, is_left_out: Mask
) -> Mask:
    """Return which measured points of a grid stay measured without the rows of a fold.

    The others are points that the motion has come near in that fold only.

    Parameters
    ----------
    variables
        Values of the variables on the rows.
    basis
        The basis with its grid.
    is_left_out
        (M,) flags the rows of the fold.

    Returns
    -------
    (P,) bool array
        For the P points that the motion has come near in any row.
    """
    is_measured = variables.is_near_motion(basis, variables.keep)
    by_others = variables.is_near_motion(basis, variables.keep & ~is_left_out)
    return by_others[is_measured]


def unmeasured(basis: Basis, points: Array) -> Array:
    """Return the grid points (P', v) of a basis at which nothing was measured.

    They are all points of the grid except ``points`` (P, v), for v variables.
    """
    have = {tuple(p) for p in points.tolist()}
    missing = [p for p in basis.points.tolist() if tuple(p) not in have]
    return np.reshape(missing, (-1, points.shape[1]))


def accept_curves(
    search: Search, curves: Sequence[Measured], judge: HeldOutData
) -> tuple[Measured, ...]:
    """Accept the measured curves that data left out confirm, one after the other.

    A curve is a torque in doubt, and has to help where it acts: it lowers its joint's
    error on data left out, in the rows in which that slides, by 5 % (SURE_HELP) and
    beyond the spread of a test run. What other joints gain beside it is no sign of it.
    It acts in all rows, and raises no joint's error over all of them by 5 %
    (MAX_JOINT_HARM). Each curve is judged together with those accepted before it.

    Parameters
    ----------
    search
        The findings beside the model.
    judge
        The data left out: a test run, or folds. On a fold, a curve has the values that
        the other folds' rows give.

    Returns
    -------
    tuple of Measured
        The accepted curves, with the errors before and after each.
    """
    if not curves:
        return ()
    # Effects are chosen by number: the findings first, then the curves.
    terms = search.terms
    effects = [t.form.effect for t in terms]
    effects += [c.table for c in curves]
    curve_by_number = dict(enumerate(curves, start=len(terms)))
    held_out = judge.held_out_errors(
        search.data.rows,
        effects,
        search.data.estimate,
        by_fold={k: c.by_fold for k, c in curve_by_number.items()},
    )
    chosen = [*range(len(terms))]
    accepted = dict[int, Measured]()
    for number, curve in curve_by_number.items():
        replaced = set(curve.replaced)
        for other in accepted.values():
            replaced.update(other.replaced)
        findings = [i for i, t in enumerate(terms) if t not in replaced]
        with_curve = [*findings, *accepted, number]
        change = held_out.change(chosen, with_curve, number, joints=[curve.joint])
        if change.rise > -max(SURE_HELP, change.spread):
            continue
        before, errors = map(held_out.errors, (chosen, with_curve))
        if error_ratios(before, errors).max() > 1.0 + MAX_JOINT_HARM:
            continue
        accepted[number] = replace(
            curve, before=float(before[curve.joint]), errors=errors
        )
        chosen = with_curve
    return tuple(accepted.values())
