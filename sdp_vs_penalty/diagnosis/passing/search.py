"""The search for what acts for a part of the runs only.

Such a cause makes the torque

    x(t) Z(q, dq, ddq) theta,    x(t) = 1 in some spans of time, 0 elsewhere,

with columns Z and constant parameters theta. The laws are compared on the rows that the
diagnosis judges by, after the model and its effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from sdp_vs_penalty.diagnosis.constants import COARSENING_ROWS, EVIDENCE_TO_ADD
from sdp_vs_penalty.diagnosis.evidence import EvidenceScorer
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect, WhiteFit, with_ridge
from sdp_vs_penalty.diagnosis.passing.cause import PassingCause, PassingLaw, Span
from sdp_vs_penalty.diagnosis.passing.laws import (
    Law,
    PassingCandidate,
    force_laws,
    joint_laws,
    load_law,
    point_of_force,
)
from sdp_vs_penalty.diagnosis.passing.spans import (
    CellProducts,
    Cells,
    find_spans,
    regular,
)
from sdp_vs_penalty.diagnosis.passing.trial import (
    PassingTrial,
    best_of,
    explained_share,
    standing,
)
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.white_rows import (
    WhiteData,
    mask_unsettled_rows,
    whiten_with_noise,
)
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import REPETITION, RESIDUAL

#: Share of the largest fall of the deviance from which a law's edges are moved.
_WORTH_A_LOOK = 0.5
#: Cells into which a cell of the search is divided where an edge is moved: single rows
#: in short logs. A row on the wrong side of an edge shows a part of the torque only; two
#: of them falsify a mass by 12 %.
_FINER = 10
#: The most times that the joints' levels are estimated anew.
_MAX_ROUNDS = 4
#: Relative change of a joint's level that matters.
_SETTLED = 0.02


class PassingSearch:
    """A search for causes that act for a part of the runs.

    ``data`` are the white rows, as if no motion repeated.
    """

    def __init__(self, search: Search, terms: Sequence[ScoredEffect]) -> None:
        """Take a finished search, and the effects in it that are certain."""
        self.data, self.terms = _without_repetition(search, terms)
        robot = self.data.estimate.robot
        n_laws = 1 + 2 * robot.n + robot.links
        self.score = EvidenceScorer(self.data, n_laws, like=search.score)
        self.base = self.score.fit(self.terms)
        self.cells = Cells.from_labels(self.data.clusters[0], self.data.rows.run)

    def find_cause(self) -> tuple[PassingTrial, tuple[PassingTrial, ...]] | None:
        """Return the likeliest cause, and its rivals; None if no law stands out.

        A load, torques and frictions of each joint are tried, whether rows look wrong or
        not: noise that is measured from repetitions takes in what differs between them.
        Forces take most of the time, and are tried only if one of these stands out. What
        belongs to a whole run, such as a channel's gain, is left to the check.
        """
        quick_laws = [load_law(self.data), *joint_laws(self.data, "torque", "friction")]
        trials = self._trials(quick_laws)
        if not any(trial.stands_out for trial in trials):
            return None
        trials += self._trials(force_laws(self.data))
        # Edges are moved where this may matter: a fall of the deviance near the largest.
        largest_drop = max(trial.term.drop for trial in trials)
        candidates = [
            self.with_finer_edges(trial)
            for trial in trials
            if (trial.stands_out or trial.errs_apart)
            and trial.term.drop > _WORTH_A_LOOK * largest_drop
        ]
        return best_of(candidates) if candidates else None

    def _trials(self, laws: Sequence[Law]) -> list[PassingTrial]:
        """Try laws; return the trials of those with spans."""
        trials = [self.trial(law) for law in laws]
        return [t for t in trials if t is not None]

    def trial(self, law: Law) -> PassingTrial | None:
        """Search the spans of a law, made of cells, and judge it; None if it explains
        nothing."""
        level, cells = self.base.level, self.cells
        nowhere = np.zeros(len(cells.run))
        white = self._white(law)
        for _ in range(_MAX_ROUNDS):
            base = self.score.at_level(self.base, level)
            products = CellProducts.from_cells(base, white, cells)
            x = find_spans(products, cells, nowhere, self._price)
            if not x.any() or x.all():
                return None
            fit = self._fit(law, x, cells)
            if np.all(np.abs(fit.level - level) < _SETTLED * level):
                break
            level = fit.level
        return self._judged(law, cells, x)

    def with_finer_edges(self, trial: PassingTrial) -> PassingTrial:
        """Return a trial with its edges moved among cells that are finer; the same one
        if it acts in whole runs."""
        if not trial.cells.count_edges(trial.x):
            return trial
        cells = self.cells.divided(_FINER)
        x = np.zeros(len(cells.run))
        x[cells.label] = trial.x[self.cells.label]
        products = self._products(trial.law, cells, trial.fit.level)
        x = find_spans(products, cells, x, self._price, longest=_FINER)
        judged = self._judged(trial.law, cells, x)
        return trial if judged is None else self._with_errors_of_edges(judged)

    def _with_errors_of_edges(self, trial: PassingTrial) -> PassingTrial:
        """Return a trial whose covariance holds what unknown edges do to its size.

        An edge is known to a cell on either side. Its error is spread evenly over these
        two, so that a change d of the parameters by a cell counts as d d' / 3.
        """
        products = self._products(trial.fitted_law, trial.cells, trial.fit.level)
        covariance = trial.covariance.copy()
        for before, behind in trial.cells.with_moved_edges(trial.x):
            change = 0.5 * (products.parameters(behind) - products.parameters(before))
            covariance += np.outer(change, change) / 3.0
        return replace(trial, covariance=covariance)

    def _coarse(self, acts: Array) -> Array:
        """Return the share (C,) of each cell's rows (M,) in which a cause acts."""
        return np.array([acts[rows].mean() for rows in self.cells.rows])

    @cached_property
    def _price(self) -> float:
        """Fall of the squared error that an edge has to bring: log N, for rows that
        carry the evidence of one."""
        n_rows = float(self.base.degrees.mean())
        worth = 1.0 + n_rows / COARSENING_ROWS
        return max(worth * float(np.log(n_rows)), EVIDENCE_TO_ADD)

    def _products(
        self, law: Law, cells: Cells, level: Array, acts: Array | None = None
    ) -> CellProducts:
        """Return the products of cells for a law in the rows in which it acts (M,), by
        default all, beside the fit at a level (n,) of the noise."""
        base = self.score.at_level(self.base, level)
        return CellProducts.from_cells(base, self._white(law, acts), cells)

    def _white(self, law: Law, acts: Array | None = None) -> Array:
        """Return a law's white columns (n, M, k) in the rows in which it acts (M,), by
        default all."""
        acting = law.columns if acts is None else law.columns * acts[:, None]
        return np.stack(
            [self.data.white(columns, j) for j, columns in enumerate(acting)]
        )

    def _term(self, law: Law, acts: Array, n_numbers: int = 0) -> ScoredEffect:
        """Return a law that acts in some rows (M,) as a term of a fit; ``n_numbers``
        describe it and its spans."""
        white = self._white(law, acts)
        form = PassingCandidate.from_law(law, n_numbers)
        return ScoredEffect(form, dict(enumerate(white)))

    def _fit(self, law: Law, x: Array, cells: Cells) -> WhiteFit:
        """Fit the model, its effects, and a law in spans x (C,)."""
        return self.score.fit([*self.terms, self._term(law, x[cells.label])])

    def _judged(self, law: Law, cells: Cells, x: Array) -> PassingTrial | None:
        """Fit a law in spans x (C,) and compute its evidence; None if it has none.

        What acts all the time is no cause here.
        """
        if not x.any() or x.all():
            return None
        acts = x[cells.label]
        point, fitted_law = np.zeros(3), law
        covariance: Array | None = None
        if law.kind == "force":
            point, covariance = self._point_of_force(law, cells, x)
            fitted_law = law.at_point(point)
        n_numbers = law.freedom + cells.count_edges(x)
        term = self._term(fitted_law, acts, n_numbers)
        fit = self.score.fit([*self.terms, term])
        base = self.score.at_level(self.base, fit.level)
        term = self.score.evidence_of(base, term.form, term.columns)
        scaled = base.scaled(term.columns)
        left = base.residual_of(scaled)  # (n, M, k) of the law's columns
        residual = base.residual - left @ term.beta
        if covariance is None:
            own = np.asarray(sum(z.T @ z for z in scaled.values()))
            gram = np.einsum("jmk,jml->kl", left, left)
            inverse = np.linalg.inv(with_ridge(regular(gram, own)))
            covariance = np.asarray(inverse, float)
        beside = standing(base.residual, residual, self.cells, self._coarse(acts))
        return PassingTrial(
            law=law,
            cells=cells,
            x=x,
            fit=fit,
            term=term,
            covariance=covariance * term.rows_worth_one,
            share=explained_share(base.residual, residual, acts > 0.0),
            over_elsewhere=beside.over_elsewhere,
            chance=beside.chance,
            point=point,
        )

    def _point_of_force(self, law: Law, cells: Cells, x: Array) -> tuple[Array, Array]:
        """Return the point (3,) [m] of its link at which a force acts in spans x (C,), and
        the force's covariance (3, 3), for noise of variance 1."""
        level = self._fit(law, x, cells).level
        gram, right = self._products(law, cells, level, x[cells.label]).over(x)
        reach = float(np.sum(self.data.estimate.robot.link_reach()))
        return point_of_force(gram, right, reach)


def _without_repetition(
    search: Search, terms: Sequence[ScoredEffect]
) -> tuple[WhiteData, list[ScoredEffect]]:
    """Return white rows and effects as if no motion repeated.

    What acts for a part of the time makes repetitions differ: it masks rows, and counts
    as slow noise. So no row is masked for that, and the noise is white, with a level
    that follows from the residual. Where the noise is not from repetitions this holds
    anyway.
    """
    data = search.data
    noise = data.noise
    if noise.source != REPETITION:
        return data, list(terms)
    masked = mask_unsettled_rows(data.rows)
    rows = replace(data.rows, masked=masked if masked.any() else np.zeros((0, 0), bool))
    white_noise = replace(
        noise,
        ar=np.zeros_like(noise.ar),
        sigma=noise.floor,
        suspect=np.zeros_like(noise.suspect),
        source=RESIDUAL,
    )
    white = whiten_with_noise(rows, white_noise, data.estimate, data.frozen)
    anew = [replace(t, columns=white.columns(t.form.effect)) for t in terms]
    return white, anew


def passing_causes(
    search: Search, terms: Sequence[ScoredEffect]
) -> tuple[PassingCause, ...]:
    """Find what acts for a part of the runs only, one cause or none, beside the
    findings of a finished search.

    Parameters
    ----------
    terms
        Its effects whose torque is certain. Weak ones may stand in for what is looked
        for: they are left out unless they have more evidence than it.
    """
    passing = PassingSearch(search, terms)
    found = passing.find_cause()
    if found is None:
        return ()
    # What is likelier goes first, though its name or size is in doubt.
    evidence = found[0].term.evidence
    likelier = [t for t in search.terms if t in terms or t.evidence > evidence]
    if len(likelier) > len(terms):
        passing = PassingSearch(search, likelier)
        found = passing.find_cause()
        if found is None:
            return ()
    best, rivals = found
    # A law that explains as much is a rival, though its own size is in doubt.
    likely = [t for t in (best, *rivals) if t.is_proven]
    if not likely:
        return ()
    chosen = likely[0]
    others = [t for t in (best, *rivals) if t is not chosen]
    return (_described(passing.data, chosen, others),)


def _described(
    data: WhiteData, trial: PassingTrial, rivals: Sequence[PassingTrial]
) -> PassingCause:
    """Make the record of a cause, with the size of its law and its spans."""
    x = trial.x
    beta = trial.term.beta
    if not data.frozen:
        x, beta = _simpler_of_both(trial)
    # Of the other spans a load or a torque has the opposite sign.
    size = trial.size if trial.law.kind == "force" else float(beta[0])
    return PassingCause(
        kind=trial.law.kind,
        place=trial.law.place,
        size=size,
        std=trial.std,
        unit=trial.law.effect.parameters[0].unit,
        parameters=tuple(float(b) for b in beta),
        point=tuple(float(p) for p in trial.point),
        spans=_spans(data, trial.cells, x),
        share=trial.share,
        evidence=trial.term.evidence,
        rivals=tuple(PassingLaw(t.law.kind, t.law.place) for t in rivals),
    )


def _simpler_of_both(trial: PassingTrial) -> tuple[Array, Array]:
    """Return spans and parameters, or the other spans with the opposite parameters.

    A model that is estimated takes in what acts all the time. So a load in some spans
    and its lack in the others are one thing: fewer spans, then a positive mass, then
    the shorter time is said.
    """

    def order(both: tuple[Array, Array]) -> tuple[int, bool, float]:
        """Return what two descriptions are sorted by."""
        x, beta = both
        n_spans = int(np.sum(np.diff(x, prepend=0.0) > 0.0))
        is_lack = trial.law.kind == "load" and beta[0] < 0.0
        return n_spans, is_lack, float(x[trial.cells.label].sum())

    return min(
        [(trial.x, trial.term.beta), (1.0 - trial.x, -trial.term.beta)], key=order
    )


def _spans(data: WhiteData, cells: Cells, x: Array) -> tuple[Span, ...]:
    """Return the spans of time in which x (C,) is 1, run by run."""
    rows = data.rows
    acts = x[cells.label] > 0.0
    runs = np.unique(rows.run)
    out = []
    for run in runs:
        name = rows.names[run] if len(runs) > 1 else ""
        in_run = np.flatnonzero(rows.run == run)
        t = rows.t[in_run]
        changes = np.diff(acts[in_run].astype(int), prepend=0, append=0)
        begins = np.flatnonzero(changes == 1)
        ends = np.flatnonzero(changes == -1) - 1
        for a, b in zip(begins, ends, strict=True):
            out.append(Span(name, float(t[a]), float(t[b])))
    return tuple(out)
