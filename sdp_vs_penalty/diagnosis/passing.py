"""What acts for a part of the runs only: a load that is carried, a force, a torque.

Such a cause makes the torque

    x(t) Z(q, dq, ddq) theta,    x(t) = 1 in some spans of time, 0 elsewhere,

with columns Z and constant parameters theta. Three laws are compared on the rows that
the diagnosis judges by, after the model and its effects:

- a load on the last link: its mass m and first moments m c;
- a force F that is constant in the world, at a point p of a link. It is the weight of a
  mass of 1 kg at p in a field of gravity F, so its columns are those of the weight;
- a constant torque on one joint.

The spans are unions of cells of time. The search for them begins with none, and inverts
x between two edges of cells, as long as this explains more than its edges cost.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.constants import (
    COARSENING_ROWS,
    EVIDENCE_TO_ADD,
    EVIDENCE_TO_DISTINGUISH,
    LAW_TOLERANCE,
    SIGNIFICANT,
)
from sdp_vs_penalty.diagnosis.evidence import EvidenceScorer
from sdp_vs_penalty.diagnosis.library import Candidate
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect, WhiteFit, with_ridge
from sdp_vs_penalty.diagnosis.passing_cause import PassingCause, Span
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.white_rows import (
    WhiteData,
    mask_unsettled_rows,
    spread_columns,
    whiten_with_noise,
)
from sdp_vs_penalty.effects.channel import TorqueOffset
from sdp_vs_penalty.effects.effect import Effect, Motion
from sdp_vs_penalty.effects.links import Payload
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.noise import REPETITION, RESIDUAL

#: Share of the error in its spans that a cause has to explain: more than it leaves.
_MOST = 0.5
#: Times the largest error of the model elsewhere that the error in its spans has to be.
_LARGER = 1.0
#: Share of the largest fall of the deviance from which a law's edges are moved.
_WORTH_A_LOOK = 0.5
#: Cells into which a cell of the search is divided where an edge is moved.
_FINER = 5
#: The most inversions of spans, and the most times that the joints' levels are
#: estimated anew.
_MAX_INVERSIONS = 12
_MAX_ROUNDS = 4
#: Spans whose products are held in memory at a time.
_AT_A_TIME = 500
#: Relative change of a joint's level that matters.
_SETTLED = 0.02


class LinkWeight(Effect):
    """The weight of a mass on one link, in fields of gravity along x, y and z.

    Column 4 b is the torque that holds 1 kg at the link's origin in gravity of 1 m/s^2
    along axis b of the world, which pulls with 1 N. Columns 4 b + 1 to 4 b + 3 are those
    of 1 kg m along the link's axes.
    """

    name = "link_weight"
    equation = "sum_b F_b dg(q)/dg_b (1, p)"
    whole_robot = True
    sought = False

    def __init__(self, robot: Robot, link: int) -> None:
        """Choose the link, from 0."""
        super().__init__(robot)
        self.link = link

    @property
    def text(self) -> str:
        """The name with the link, from 1."""
        return f"{self.name}:{self.link + 1}"

    def parameter_names_and_units(self, joint: int) -> Iterable[tuple[str, str]]:
        """Name the components of the force [N], and their products with the point
        [N m]."""
        return [
            (f"F_{axis}{at}", "N*m" if at else "N")
            for axis in "xyz"
            for at in ("", "_x", "_y", "_z")
        ]

    def torques(self, motion: Motion) -> Array:
        """Compute the torque (N, n, 12) per unit of each parameter."""
        at_rest = np.zeros_like(motion.q)
        first = 10 * self.link
        columns = []
        for axis in np.eye(3):
            robot = replace(self.robot, gravity=(axis[0], axis[1], axis[2]))
            regressor = robot.regressor(motion.q, at_rest, at_rest)
            columns.append(regressor[:, :, first : first + 4])
        return np.concatenate(columns, axis=2)


@dataclass(frozen=True, eq=False)
class Law:
    """What a cause may be: its filtered columns, and how many numbers describe it.

    kind : "load", "force" or "torque"; place : link or joint from 1; effect : whose
    columns they are; columns (n, M, k) : torque per unit of the parameters [N m or N];
    freedom : number of free numbers, at most k.
    """

    kind: str
    place: int
    effect: Effect
    columns: Array
    freedom: int

    @property
    def text(self) -> str:
        """A name of the law, such as "force:3"."""
        return f"{self.kind}:{self.place}"

    def at_point(self, point: Array) -> Law:
        """Return the law of a force at a point (3,) [m] of its link, with three
        columns."""
        by_axis = self.columns.reshape(*self.columns.shape[:2], 3, 4)
        return replace(self, columns=by_axis @ np.array([1.0, *point]))


class PassingCandidate(Candidate):
    """A law as a candidate of a fit, which may hold the same effect for all the time."""

    @cached_property
    def text(self) -> str:
        """A name that no effect has."""
        return f"passing {self.key[0]}"


def load_law(data: WhiteData) -> Law:
    """Return the law of a load: mass and first moments on the last link."""
    robot = data.estimate.robot
    effect = Payload(robot)
    columns = spread_columns(data.rows, effect)[:, :, :4]
    return Law("load", robot.links, effect, columns, 4)


def torque_laws(data: WhiteData) -> list[Law]:
    """Return the laws of a constant torque, one for each joint."""
    out = []
    for j in range(data.n):
        effect = TorqueOffset(data.estimate.robot, [j])
        columns = spread_columns(data.rows, effect)
        out.append(Law("torque", j + 1, effect, columns, 1))
    return out


def force_laws(data: WhiteData) -> list[Law]:
    """Return the laws of a force, one for each link, the last link first."""
    robot = data.estimate.robot
    out = []
    for link in reversed(range(robot.links)):
        effect = LinkWeight(robot, link)
        columns = spread_columns(data.rows, effect)
        out.append(Law("force", link + 1, effect, columns, 6))
    return out


@dataclass(frozen=True, eq=False)
class CellProducts:
    """Products of a law's weighted columns Z with a fit, summed over each cell of time.

    grams (C, k, k) : Z'Z; along_fit (C, r, k) : Q'Z, with the fit's r orthonormal
    columns; with_residual (C, k) : Z'r. C is the number of cells.

    For the spans x (C,) of 0 and 1 the columns x Z have the Gram matrix G = sum_c x_c
    Z_c'Z_c. The fit leaves G - S'S of it, with S = sum_c x_c Q_c'Z_c. With b = sum_c
    x_c Z_c'r the squared error falls by b'(G - S'S)^-1 b.
    """

    grams: Array
    along_fit: Array
    with_residual: Array

    @classmethod
    def of(
        cls,
        fit: WhiteFit,
        white: Array,
        cells: Cells,
    ) -> CellProducts:
        """Multiply white columns (n, M, k) with a fit, cell by cell."""
        Z = white / fit.level[:, None, None]
        Q = fit.basis
        r = fit.residual
        grams = []
        along_fit = []
        with_residual = []
        for rows in cells.rows:
            size = len(Z) * len(rows)
            of_cell = Z[:, rows].reshape(size, Z.shape[2])
            grams.append(of_cell.T @ of_cell)
            along_fit.append(Q[:, rows].reshape(size, Q.shape[2]).T @ of_cell)
            with_residual.append(of_cell.T @ r[:, rows].ravel())
        return cls(np.array(grams), np.array(along_fit), np.array(with_residual))

    def over(self, x: Array) -> tuple[Array, Array]:
        """Return G - S'S (k, k) and b (k,) of the spans x (C,)."""
        S = np.tensordot(x, self.along_fit, 1)
        gram = np.tensordot(x, self.grams, 1) - S.T @ S
        return gram, x @ self.with_residual

    def parameters(self, x: Array) -> Array:
        """Return the parameters (k,) of least squares with the spans x (C,)."""
        gram, right = self.over(x)
        own = np.tensordot(x, self.grams, 1)
        return np.asarray(np.linalg.solve(_regular(gram, own), right))

    def falls(self, x: Array, pairs: NDArray[np.intp]) -> Array:
        """Return by how much the squared error falls (P,) with x inverted in a span.

        Parameters
        ----------
        x
            (C,) the spans before.
        pairs
            (P, 2) first cell of each inverted span, and the first one behind it.
        """
        change = 1.0 - 2.0 * x  # of x where it is inverted

        def sums(products: Array) -> tuple[Array, Array]:
            """Return the sum with x, and the running sums of the changes."""
            signed = change.reshape(-1, *[1] * (products.ndim - 1)) * products
            running = np.concatenate([np.zeros_like(signed[:1]), signed.cumsum(axis=0)])
            return np.tensordot(x, products, 1), running

        G, G_sums = sums(self.grams)
        S, S_sums = sums(self.along_fit)
        b, b_sums = sums(self.with_residual)
        out = []
        for start in range(0, len(pairs), _AT_A_TIME):
            first, last = pairs[start : start + _AT_A_TIME].T
            gram = G + G_sums[last] - G_sums[first]
            along = S + S_sums[last] - S_sums[first]
            right = b + b_sums[last] - b_sums[first]
            left = gram - along.transpose(0, 2, 1) @ along
            beta = np.linalg.solve(_regular(left, gram), right[:, :, None])[:, :, 0]
            out.append(np.sum(beta * right, axis=1))
        return np.concatenate(out)


def _regular(left: Array, gram: Array) -> Array:
    """Add a millionth of the columns' own squares to what a fit leaves of them.

    A column that the fit absorbs then has no coefficient. left, gram (..., k, k).
    """
    own = np.diagonal(gram, axis1=-2, axis2=-1) + 1e-12
    return np.asarray(left + 1e-6 * own[..., None] * np.eye(gram.shape[-1]))


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells of time, in order: which of the M rows belong to each, and to which run.

    label (M,) : the cell of each row; run (C,) : the run of each cell.
    """

    label: NDArray[np.intp]
    run: NDArray[np.intp]

    @classmethod
    def of(cls, label: NDArray[np.intp], run_of_rows: NDArray[np.intp]) -> Cells:
        """Make cells of labels from 0 without gaps."""
        _, first = np.unique(label, return_index=True)
        return cls(label, run_of_rows[first])

    @cached_property
    def rows(self) -> list[NDArray[np.intp]]:
        """The numbers of each cell's rows."""
        order = np.argsort(self.label, kind="stable")
        ends = np.searchsorted(self.label[order], np.arange(len(self.run) + 1))
        return [order[a:b] for a, b in pairwise(ends)]

    def divided(self, parts: int) -> Cells:
        """Divide each cell into some parts with equally many rows."""
        fine = np.empty_like(self.label)
        count = 0
        for rows in self.rows:
            part = np.arange(len(rows)) * parts // len(rows)
            part = np.unique(part, return_inverse=True)[1]
            fine[rows] = count + part
            count += int(part[-1]) + 1
        run = np.zeros(count, np.intp)
        run[fine] = self.run[self.label]
        return Cells(fine, run)

    def count_edges(self, x: Array) -> int:
        """Count the instants at which x (C,) changes within a run."""
        return int(np.sum(self._steps(x)))

    def _steps(self, x: Array) -> NDArray[np.bool_]:
        """Flag the C - 1 borders of cells at which x (C,) changes within a run."""
        return (np.diff(x) != 0.0) & (np.diff(self.run) == 0)

    def with_moved_edges(self, x: Array) -> Iterator[tuple[Array, Array]]:
        """Yield for each edge of x (C,) the spans with it a cell earlier, and later."""
        for edge in np.flatnonzero(self._steps(x)):
            earlier = x.copy()
            earlier[edge] = x[edge + 1]
            later = x.copy()
            later[edge + 1] = x[edge]
            yield earlier, later

    def edges_added(self, x: Array, pairs: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return how many edges (P,) an inversion of x (C,) between two borders adds.

        A border at the begin or end of a run costs nothing; one at an edge moves it.
        """
        added = np.zeros(len(x) + 1, np.intp)
        in_run = np.diff(self.run) == 0
        added[1:-1] = np.where(in_run, np.where(self._steps(x), -1, 1), 0)
        return np.asarray(added[pairs[:, 0]] + added[pairs[:, 1]])


def find_spans(
    products: CellProducts,
    cells: Cells,
    start: Array,
    price: float,
    longest: int | None = None,
) -> Array:
    """Find the spans in which a law explains most, less a price for each edge.

    Parameters
    ----------
    products
        Of the law's columns.
    cells
        The C cells.
    start
        (C,) the spans at first, of 0 and 1.
    price
        Fall of the squared error that an edge has to bring.
    longest
        The most cells that are inverted at once; default: all.

    Returns
    -------
    (C,) array
        1 in the spans, 0 elsewhere.
    """
    C = len(start)
    pairs = np.stack(np.triu_indices(C + 1, 1), axis=1)
    if longest is not None:
        pairs = pairs[pairs[:, 1] - pairs[:, 0] <= longest]
    x = start.copy()
    nothing = np.zeros((1, 2), np.intp)
    best = float(products.falls(x, nothing)[0]) - price * cells.count_edges(x)
    for _ in range(_MAX_INVERSIONS):
        n_edges = cells.count_edges(x) + cells.edges_added(x, pairs)
        value = products.falls(x, pairs) - price * n_edges
        k = int(np.argmax(value))
        if not value[k] > best:
            break
        best = float(value[k])
        first, last = pairs[k]
        x[first:last] = 1.0 - x[first:last]
    return x


@dataclass(frozen=True, eq=False)
class Trial:
    """A law with its spans, fitted beside the model and its effects.

    law; cells and x (C,) : where it acts; fit : the fit with it; beta (k,) : its
    parameters [SI]; covariance (k, k); drop, worth, price : of the evidence, as
    :class:`ScoredEffect` has them; share : of the error in its spans that it explains;
    point (3,) [m] : at which a force acts.
    """

    law: Law
    cells: Cells
    x: Array
    fit: WhiteFit
    beta: Array
    covariance: Array
    drop: float
    worth: float
    price: float
    share: float
    over_elsewhere: float
    point: Array = field(default_factory=lambda: np.zeros(3))

    @property
    def evidence(self) -> float:
        """The evidence J: twice the logarithm of the odds that the cause acts."""
        return self.drop / self.worth - self.price

    @property
    def size(self) -> float:
        """The mass [kg], the force [N], or the torque [N m or N]."""
        if self.law.kind == "force":
            return float(np.linalg.norm(self.beta))
        return float(self.beta[0])

    @property
    def std(self) -> float:
        """The standard deviation of the size."""
        along = np.zeros(len(self.beta))
        along[0] = 1.0
        if self.law.kind == "force":
            along = self.beta / max(self.size, 1e-12)
        return float(np.sqrt(along @ self.covariance @ along))

    @property
    def is_far_off(self) -> bool:
        """Whether a load's centre of mass lies farther away than the arm is long."""
        if self.law.kind != "load":
            return False
        reach = float(np.sum(self.law.effect.robot.link_reach()))
        return bool(np.linalg.norm(self.beta[1:]) > reach * abs(self.size))

    @property
    def stands_out(self) -> bool:
        """Whether it has evidence, and the error in its spans is larger than any that
        the model makes elsewhere."""
        return self.evidence > EVIDENCE_TO_ADD and self.over_elsewhere > _LARGER

    @property
    def is_proven(self) -> bool:
        """Whether it stands out, explains more than it leaves, and has a size that is
        told from zero."""
        return (
            self.stands_out
            and self.share > _MOST
            and self.std < SIGNIFICANT * abs(self.size)
            and not self.is_far_off
        )

    def evidence_with_worth_of(self, other: Trial) -> float:
        """Return J with the number of rows worth one of another trial."""
        return self.drop / other.worth - self.price


def best_of(trials: Sequence[Trial]) -> tuple[Trial, tuple[Trial, ...]] | None:
    """Return the likeliest of some trials, and those that the data do not tell from it.

    All are compared with the rows worth one of the trial that explains most. Trials tie
    within J = 6 plus 4 % of the best one's; of these the one with fewest numbers is
    taken. None if there are no trials.
    """
    if not trials:
        return None
    closest = max(trials, key=lambda t: t.drop)
    J = {t: t.evidence_with_worth_of(closest) for t in trials}
    best = max(J.values())
    margin = EVIDENCE_TO_DISTINGUISH + LAW_TOLERANCE * best
    tied = [t for t in trials if best - J[t] < margin]
    chosen = min(tied, key=lambda t: (t.law.freedom, -J[t]))
    return chosen, tuple(t for t in tied if t is not chosen)


class PassingSearch:
    """A search for causes that act for a part of the runs.

    ``data`` are the white rows, as if no motion repeated.
    """

    def __init__(self, search: Search, terms: Sequence[ScoredEffect]) -> None:
        """Take a finished search, and the effects in it that are certain."""
        self.data, self.score, self.terms = _without_repetition(search, terms)
        self.base = self.score.fit(self.terms)
        self.cells = Cells.of(self.data.clusters[0], self.data.rows.run)

    def best(self, is_suspected: bool) -> tuple[Trial, tuple[Trial, ...]] | None:
        """Return the cause that explains most, and its rivals; None if there is none.

        A load is tried first, since it is carried for long, and then changes the fit of
        everything: nothing else may show it. Constant torques follow if something is
        suspected or the load stands out. Forces take most of the time, and are tried
        only if one of these stands out.
        """
        robot = self.data.estimate.robot
        n_laws = 1 + robot.n + robot.links
        trials = self._trials([load_law(self.data)], n_laws)
        if not is_suspected and not any(t.stands_out for t in trials):
            return None
        trials += self._trials(torque_laws(self.data), n_laws)
        if not any(t.stands_out for t in trials):
            return None
        trials += self._trials(force_laws(self.data), n_laws)
        most = max(t.drop for t in trials)
        finer = [
            self.with_finer_edges(t, n_laws)
            for t in trials
            if t.stands_out and t.drop > _WORTH_A_LOOK * most
        ]
        return best_of([t for t in finer if t.is_proven])

    def _trials(self, laws: Sequence[Law], n_laws: int) -> list[Trial]:
        """Try laws, of ``n_laws`` in all; return the trials of those with spans."""
        trials = [self.trial(law, n_laws) for law in laws]
        return [t for t in trials if t is not None]

    def trial(self, law: Law, n_laws: int) -> Trial | None:
        """Search the spans of a law, and judge it; None if it explains nothing."""
        level = self.base.level
        x = np.zeros(len(self.cells.run))
        white = self._white(law, np.ones(len(self.data.y[0])))
        fit = self.base
        for _ in range(_MAX_ROUNDS):
            products = CellProducts.of(
                self.score.at_level(self.base, level), white, self.cells
            )
            x = find_spans(products, self.cells, np.zeros(len(x)), self._price)
            if not x.any() or x.all():
                return None
            fit = self._fit(law, x, self.cells)
            if np.all(np.abs(fit.level - level) < _SETTLED * level):
                break
            level = fit.level
        return self._judged(law, self.cells, x, n_laws)

    def with_finer_edges(self, trial: Trial, n_laws: int) -> Trial:
        """Return a trial with its edges moved among cells that are finer."""
        cells = self.cells.divided(_FINER)
        x = np.zeros(len(cells.run))
        x[cells.label] = trial.x[self.cells.label]
        white = self._white(trial.law, np.ones(len(self.data.y[0])))
        base = self.score.at_level(self.base, trial.fit.level)
        products = CellProducts.of(base, white, cells)
        x = find_spans(products, cells, x, self._price, longest=_FINER)
        judged = self._judged(trial.law, cells, x, n_laws)
        return trial if judged is None else self._with_errors_of_edges(judged)

    def _with_errors_of_edges(self, trial: Trial) -> Trial:
        """Return a trial whose covariance holds what unknown edges do to its size.

        An edge is known to a cell on either side. Its error is spread evenly over these
        two, so that a change d of the parameters by a cell counts as d d' / 3.
        """
        law = trial.law
        fitted_law = law.at_point(trial.point) if law.kind == "force" else law
        white = self._white(fitted_law, np.ones(len(self.data.y[0])))
        base = self.score.at_level(self.base, trial.fit.level)
        products = CellProducts.of(base, white, trial.cells)
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

    def _white(self, law: Law, acts: Array) -> Array:
        """Return a law's white columns (n, M, k) in the rows in which it acts (M,)."""
        return np.stack(
            [
                self.data.white(law.columns[j] * acts[:, None], j)
                for j in range(self.data.n)
            ]
        )

    def _term(self, law: Law, acts: Array) -> ScoredEffect:
        """Return a law that acts in some rows (M,) as a term of a fit."""
        white = self._white(law, acts)
        form = PassingCandidate((law.text, None), law.effect)
        return ScoredEffect(form, dict(enumerate(white)))

    def _fit(self, law: Law, x: Array, cells: Cells) -> WhiteFit:
        """Fit the model, its effects, and a law in spans x (C,)."""
        return self.score.fit([*self.terms, self._term(law, x[cells.label])])

    def _judged(self, law: Law, cells: Cells, x: Array, n_laws: int) -> Trial | None:
        """Fit a law in spans x (C,) and compute its evidence; None if it has none."""
        if not x.any() or x.all():
            return None
        point = np.zeros(3)
        covariance = None
        fitted_law = law
        acts = x[cells.label]
        if law.kind == "force":
            level = self._fit(law, x, cells).level
            base = self.score.at_level(self.base, level)
            white = self._white(law, acts)
            gram, right = CellProducts.of(base, white, cells).over(x)
            reach = float(np.sum(self.data.estimate.robot.link_reach()))
            point, covariance = point_of_force(gram, right, reach)
            fitted_law = law.at_point(point)
        term = self._term(fitted_law, acts)
        fit = self.score.fit([*self.terms, term])
        base = self.score.at_level(self.base, fit.level)
        T = base.residual_of(base.scaled(term.columns))
        gram = np.einsum("jmk,jml->kl", T, T)
        scaled = np.stack([*base.scaled(term.columns).values()])
        information = _regular(gram, np.einsum("jmk,jml->kl", scaled, scaled))
        beta = np.linalg.solve(information, np.einsum("jmk,jm->k", T, base.residual))
        residual = base.residual - T @ beta
        inverse = np.asarray(np.linalg.inv(with_ridge(information)))
        rows_per_joint = float(self.base.degrees.mean())
        worth = self.score.rows_worth_one(T, residual, inverse, T.shape[2])
        worth += rows_per_joint / COARSENING_ROWS
        n_independent = max(rows_per_joint * self.data.n / worth, 3.0)
        n_numbers = law.freedom + cells.count_edges(x)
        price = self.score.parameter_price(n_numbers, n_independent)
        drop = self.base.own_deviance - float(self.base.deviance(fit.rss))
        return Trial(
            law=law,
            cells=cells,
            x=x,
            fit=fit,
            beta=beta,
            covariance=(inverse if covariance is None else covariance) * worth,
            drop=drop,
            worth=worth,
            price=price + 2.0 * float(np.log(n_laws)),
            share=explained_share(base.residual, residual, acts > 0.0),
            over_elsewhere=error_over_elsewhere(
                base.residual, residual, self.cells, self._coarse(acts)
            ),
            point=point,
        )


def explained_share(before: Array, after: Array, acts: NDArray[np.bool_]) -> float:
    """Return the share, below 1, of the squared error in some rows that a cause
    explains.

    Parameters
    ----------
    before, after
        (n, M) weighted residual without and with the cause.
    acts
        (M,) flags: the rows in which it acts.
    """
    squares_before = float(np.sum(before[:, acts] ** 2))
    squares_after = float(np.sum(after[:, acts] ** 2))
    return 1.0 - squares_after / max(squares_before, 1e-12)


def error_over_elsewhere(before: Array, after: Array, cells: Cells, x: Array) -> float:
    """Return how much larger the squared error without a cause is in its spans than the
    largest one that the model makes elsewhere, in any cell of time.

    Cells beside an edge are left out: an edge is known to a part of a cell.

    Parameters
    ----------
    before, after
        (n, M) weighted residual without and with the cause.
    cells
        C cells of time.
    x
        (C,) the share of each cell in which the cause acts.
    """
    is_beside = np.convolve(x, np.ones(3), mode="same") > 0.0
    elsewhere = [
        float(np.mean(after[:, rows] ** 2))
        for rows, beside in zip(cells.rows, is_beside, strict=True)
        if not beside
    ]
    acts = x[cells.label] > 0.5
    if not acts.any() or not elsewhere:
        return 0.0
    return float(np.mean(before[:, acts] ** 2)) / max(max(elsewhere), 1e-12)


def point_of_force(gram: Array, right: Array, reach: float) -> tuple[Array, Array]:
    """Return the point at which a force on a link acts, and the force's covariance.

    The parameters of the link's weight are theta = (F_x, F_x p, F_y, F_y p, F_z, F_z
    p), with the force F and the point p. theta'G theta - 2 b'theta + |p|^2 / reach^2 is
    least.

    Parameters
    ----------
    gram, right
        G (12, 12) and b (12,).
    reach
        Standard deviation of the point about the link's origin [m].

    Returns
    -------
    (3,) array
        The point [m], in the link's frame.
    (3, 3) array
        Covariance of the force [N^2] with the point free, for noise of variance 1.
    """
    # With G = R'R: |R theta - R'^-1 b|^2.
    R = np.linalg.cholesky(_regular(gram, gram)).T
    target = np.linalg.solve(R.T, right)

    def errors(both: Array) -> Array:
        """Return the errors (15,) of a force and a point, whose squares are summed."""
        theta = np.kron(both[:3], [1.0, *both[3:]])
        return np.concatenate([R @ theta - target, both[3:] / reach])

    def slopes(both: Array) -> Array:
        """Return the derivatives (15, 6) of the errors by force and point."""
        by_force = np.kron(np.eye(3), np.array([1.0, *both[3:]])[:, None])
        by_point = np.kron(both[:3, None], np.eye(4)[:, 1:])
        of_point = np.hstack([np.zeros((3, 3)), np.eye(3) / reach])
        return np.vstack([R @ np.hstack([by_force, by_point]), of_point])

    at_origin = np.zeros(6)
    J = slopes(at_origin)[:, :3]
    at_origin[:3] = np.linalg.lstsq(J, -errors(at_origin))[0]
    solution = scipy.optimize.least_squares(errors, at_origin, slopes, x_scale="jac")
    J = solution.jac
    covariance = np.linalg.inv(with_ridge(J.T @ J))
    return np.asarray(solution.x[3:], float), np.asarray(covariance[:3, :3], float)


def _without_repetition(
    search: Search,
    terms: Sequence[ScoredEffect],
) -> tuple[WhiteData, EvidenceScorer, list[ScoredEffect]]:
    """Return white rows, scorer and effects as if no motion repeated.

    What acts for a part of the time makes repetitions differ: it masks rows, and counts
    as slow noise. So no row is masked for that, and the noise is white, with a level
    that follows from the residual. Where the noise is not from repetitions this holds
    anyway.
    """
    data = search.data
    noise = data.noise
    if noise.source != REPETITION:
        return data, search.score, list(terms)
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
    score = EvidenceScorer(white, 1)
    anew = [replace(t, columns=white.columns(t.form.effect)) for t in terms]
    return white, score, anew


def passing_causes(
    search: Search,
    terms: Sequence[ScoredEffect],
    is_suspected: bool = True,
) -> tuple[PassingCause, ...]:
    """Find what acts for a part of the runs only, beside the findings of a search.

    Parameters
    ----------
    search
        The finished search.
    terms
        Its effects whose torque is certain. Weak ones may stand in for what is looked
        for: they are left out unless they have more evidence than it.
    is_suspected
        Whether events, unexplained torque or an unknown noise let something be
        suspected. False: only a load is looked for at first.

    Returns
    -------
    tuple of PassingCause
        None or one.
    """
    passing = PassingSearch(search, terms)
    found = passing.best(is_suspected)
    if found is None:
        return ()
    # What is likelier goes first, though its name or size is in doubt.
    evidence = found[0].evidence
    likelier = [t for t in search.terms if t in terms or t.evidence > evidence]
    if len(likelier) > len(terms):
        passing = PassingSearch(search, likelier)
        found = passing.best(is_suspected)
        if found is None:
            return ()
    trial, rivals = found
    return (_described(passing.data, trial, rivals),)


def _described(data: WhiteData, trial: Trial, rivals: Sequence[Trial]) -> PassingCause:
    """Make the record of a cause, with the size of its law and its spans."""
    x = trial.x
    beta = trial.beta
    if not data.frozen:
        x, beta = _simpler_of_both(trial)
    # Of the other spans a load or a torque has the opposite sign.
    size = trial.size if trial.law.kind == "force" else float(beta[0])
    unit = {"load": "kg", "force": "N"}.get(trial.law.kind)
    if unit is None:
        unit = data.estimate.robot.torque_units[trial.law.place - 1]
    return PassingCause(
        kind=trial.law.kind,
        place=trial.law.place,
        size=size,
        std=trial.std,
        unit=unit,
        parameters=tuple(float(b) for b in beta),
        point=tuple(float(p) for p in trial.point),
        spans=_spans(data, trial.cells, x),
        share=trial.share,
        evidence=trial.evidence,
        rivals=tuple(t.law.text for t in rivals),
    )


def _simpler_of_both(trial: Trial) -> tuple[Array, Array]:
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

    return min([(trial.x, trial.beta), (1.0 - trial.x, -trial.beta)], key=order)


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
