"""The published penalised objective with its box on barycentric inertias: a lower bound,
the best point found, and spatial branch and bound between them.

The box bounds I = J - m (c.c 1 - c c^T), which is not convex in theta. With Q = m c c^T
it is linear, I = J - (tr(Q) 1 - Q), and Q is relaxed over a cell l <= c <= u:

    [[Q, m c], [(m c)^T, m]] >= 0                                 (Shor 1987)
    Q_ab >= l_a h_b + l_b h_a - l_a l_b m,  Q_ab >= u_a h_b + u_b h_a - u_a u_b m
    Q_ab <= u_a h_b + l_b h_a - u_a l_b m,  Q_ab <= l_a h_b + u_b h_a - l_a u_b m
    Sigma' - Q >= 0

with h = m c (McCormick 1976, times m >= 0). The last line is the slack's matrix
inequality of :mod:`penalised_optimum` about the centre of mass, Sigma' of theta'. What
is left shrinks with the square of the cell: cells of the largest Q_aa - h_a^2 / m are cut
in two (Androulakis, Maranas, Floudas, J. Global Optim. 1995). With c fixed the problem is
convex and exact: that is the upper bound.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.paper.penalised_optimum import (
    PenalisedOptimum,
    PenalisedProblem,
    solve_once,
)
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, Indices
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet, linear
from sdp_vs_penalty.solvers.convex_problem import ConvexProblem

#: (6, 3, 3) the symmetric matrices with ones at an entry.
_UNITS = inertia.inertia_matrix(np.eye(6))

#: (10, 4, 4) Shor's relaxation of Q = m c c^T, [[Q, h], [h^T, m]] >= 0 with h = m c: the
#: matrix of each of m, h and the entries of Q.
_LIFTED = np.concatenate([inertia.PSEUDO_INERTIA_BASIS[:4], np.zeros((6, 4, 4))])
_LIFTED[4:, :3, :3] = _UNITS


@dataclass(frozen=True)
class SolvedCell:
    """A cell low <= c <= high of centres of mass, and its relaxation."""

    #: (n, 3) smallest coordinates of the centres of mass [m].
    low: Array
    #: (n, 3) largest coordinates of the centres of mass [m].
    high: Array
    #: The relaxation's optimum, whose theta may lie outside of the box.
    relaxation: PenalisedOptimum
    #: (n, 3) by how much its Q_aa exceeds h_a^2 / m [kg m^2].
    excess: Array


class BoxedProblem:
    """The published problem with its box on barycentric inertias."""

    #: Where a table leaves a coordinate of a centre of mass open [m].
    farthest = 10.0
    #: A cell is cut no nearer to its end than this share of it.
    nearest_cut = 0.2
    #: The share of the box at its ends in which no start lies.
    margin = 0.01

    def __init__(self, problem: PenalisedProblem) -> None:
        """Read the box on centres of mass [m] and inertias [kg m^2] from the task.

        A coordinate without bounds gets +-farthest. A cell is a box of centres of mass,
        on which the non-convex problem is relaxed to a convex one. Variables of the
        relaxation: theta' and the slacks of ``problem``, then six entries of Q = m c
        c^T for each link.
        """
        self.problem = problem
        self.task = problem.task
        self.links = problem.task.links
        box = problem.task.box[: len(self.links)]
        low = box[:, 1:4, 0]
        high = box[:, 1:4, 1]
        self.c_low = np.where(np.isfinite(low), low, -self.farthest)
        self.c_high = np.where(np.isfinite(high), high, self.farthest)
        self.inertia_box = box[:, 4:]
        skipped = ("centre of mass", "moments")
        self.hard = [c for c in problem.hard if c.family not in skipped]
        self.first_q = problem.p + len(problem.prices)

    def solve_cell(self, weight: float, low: Array, high: Array) -> SolvedCell:
        """Solve the relaxation over a cell low <= c <= high (n, 3) of centres of mass
        [m].

        Raises InputError if the cell has no strictly feasible point.
        """
        problem = self.problem
        n = len(self.links)
        limit = problem.slack_limits(weight)
        start = self._start(low, high, limit)
        constraints = [*self._always(limit), *problem.consistency]
        for k, link in enumerate(self.links):
            q, name = self._q(k), f"link {k + 1}"
            rows = _cell_rows(low[k], high[k])
            indices = np.concatenate([link, q])
            constraints.append(
                linear("cell", name, indices, rows.T, np.zeros(len(rows)))
            )
            indices = np.concatenate([link[:4], q])
            constraints.append(
                linear("lifted", name, indices, _LIFTED, np.zeros((4, 4)), "psd")
            )
        farthest = np.maximum(np.abs(low), np.abs(high)).max(axis=1)
        largest_q = self.task.bound[self.links[:, 0]] * farthest**2
        bound = np.concatenate([self._bound(limit), np.repeat(largest_q, 6)])
        widened, cost = self._loss(weight)
        demands = ConstraintSet(tuple(constraints))
        fit = solve_once(ConvexProblem(widened, demands, bound, linear=cost), start)
        if fit is None:
            raise InputError(
                "a cell of centres of mass has no point inside of it",
                "check the bounds of the problem",
            )
        theta = problem.theta(fit.theta)
        # How far Q is from m c c^T on its diagonal: zero if the relaxation is exact.
        mass = theta[self.links[:, 0]]
        h = theta[self.links[:, 1:4]]
        products = fit.theta[self.first_q :].reshape(n, 6)
        diagonal = products[:, [0, 2, 5]]  # Q_xx, Q_yy, Q_zz
        excess = diagonal - h**2 / mass[:, None]
        optimum = problem.optimum(theta, weight, max(fit.lower, 0.0))
        return SolvedCell(low, high, optimum, excess)

    def _q(self, k: int) -> Indices:
        """Return the places (6,) of the entries of Q of link k among all variables."""
        return self.first_q + 6 * k + np.arange(6)

    def _loss(self, weight: float) -> tuple[LeastSquares, Array]:
        """Return the loss and the linear cost in all variables: theta', slacks, Q."""
        data = self.problem.in_slacks
        without_q = np.zeros((len(data.R), 6 * len(self.links)))
        cost = np.zeros(self.first_q + without_q.shape[1])
        cost[self.problem.p : self.first_q] = weight * self.problem.prices
        return replace(data, R=np.hstack([data.R, without_q])), cost

    def _always(self, limit: Array) -> list[Constraint]:
        """Return what holds in every cell: the demands, the box about the centres of
        mass, and physical consistency about them, Sigma' - Q >= 0.

        Sigma' (3, 3) are the second moments about the link's frame, Q = m c c^T, so
        that the difference is about the centre of mass [kg m^2].
        """
        moments = inertia.PSEUDO_INERTIA_BASIS[4:, :3, :3]
        about_centre = np.concatenate([moments, -_UNITS])
        out = [*self.hard, *self.problem.soft, *self.problem.between(limit)]
        for k, link in enumerate(self.links):
            indices = np.concatenate([link[4:], self._q(k)])
            zeros = np.zeros((3, 3))
            out.append(
                linear("about centre", f"{k}", indices, about_centre, zeros, "psd")
            )
            out += self._box_rows(k)
        return out

    def _bound(self, limit: Array) -> Array:
        """Return the bounds (p + s,) of theta' = theta + 2 s j and of the slacks:
        slacks up to ``limit`` (s,) raise theta' above the bounds of theta."""
        raised = self.problem.links_slack @ limit[: len(self.links)]
        return np.concatenate([self.task.bound + raised, limit])

    def _start(self, low: Array, high: Array, limit: Array) -> Array:
        """Return a strictly feasible point of a cell's relaxation.

        Centres of mass lie in the middle of the cell, masses are those of the interior
        point, inertias lie inside the box, and slacks are large enough to make them
        consistent.

        Parameters
        ----------
        low, high : (n, 3) array
            Ends of the cell [m].

        Returns
        -------
        (p + s + 6 n,) array
            theta', slacks, and the entries of Q.
        """
        problem = self.problem
        n = len(self.links)
        mass = problem.interior[self.links[:, 0]]
        middle = 0.5 * (low + high)
        widths = (high - low)[:, None]
        # Q lies strictly between m c c^T and McCormick's upper limits.
        dyads = middle[:, :, None] * middle[:, None, :]
        q = mass[:, None, None] * (dyads + np.eye(3) * widths**2 / 8.0)
        about = self._inside_box(problem.interior[self.links])
        # Twice the slacks that make the inertias consistent, but below their limits.
        moments = np.linalg.eigvalsh(inertia.inertia_matrix(about))
        needed = np.maximum(moments[:, 2] - 0.5 * moments.sum(axis=1), 0.0)
        slack = problem.slack_start * np.minimum(limit, 1.0)
        slack[:n] = np.maximum(slack[:n], 2.0 * needed)
        slack[:n] = np.minimum(slack[:n], 0.9 * limit[:n])
        # Steiner's term of entry e: <Q_e, Q> of link n.
        about_frame = about + np.einsum("eij,nij->ne", inertia.STEINER_FORMS, q)
        theta = problem.interior.copy()
        theta[self.links] = np.column_stack([mass, mass[:, None] * middle, about_frame])
        theta = theta + problem.links_slack @ slack[:n]
        return np.concatenate([theta, slack, inertia.inertia_entries(q).ravel()])

    def _inside_box(self, links: Array) -> Array:
        """Return inertias about the centres of mass of links (n, 10), moved strictly
        inside the box.

        Returns
        -------
        (n, 6) array
            Inertias [kg m^2]. Where the box is open, the bounds of theta limit them.
        """
        reach = self.task.bound[self.links[:, 4:]]
        low = self.inertia_box[..., 0]
        high = self.inertia_box[..., 1]
        lower = np.where(np.isfinite(low), low, -reach)
        upper = np.where(np.isfinite(high), high, reach)
        clear = self.margin * (upper - lower)
        about = inertia.barycentric_from_standard(links)[:, 4:]
        return np.clip(about, lower + clear, upper - clear)

    def _box_rows(self, k: int) -> list[Constraint]:
        """Return the rows that keep the inertia of link k about its centre of mass in
        the box.

        lower <= J'_e - 2 s [e on the diagonal] - <Q_e, Q> <= upper, for each of the six
        entries e: J' is the inertia about the frame raised by the slack s, Q = m c c^T,
        and <Q_e, Q> Steiner's term. Ends that are infinite are left out.
        """
        slack = self.problem.p + k
        indices = np.concatenate([self.links[k, 4:], [slack], self._q(k)])
        rows = list[Constraint]()
        for e, ends in enumerate(self.inertia_box[k]):
            form = inertia.STEINER_FORMS[e]
            # Entries off the diagonal occur twice in <Q_e, Q>.
            steiner = inertia.inertia_entries(form) * [1, 2, 1, 2, 2, 1]
            of_slack = -2.0 * (np.trace(form) > 0.0)
            values = np.concatenate([np.eye(6)[e], [of_slack], -steiner])
            used = np.flatnonzero(values)
            for end, sign in zip(ends, (1.0, -1.0), strict=True):
                if np.isfinite(end):
                    name = f"link {k + 1}, {e}, {sign:+g}"
                    rows.append(
                        linear(
                            "barycentric inertia",
                            name,
                            indices[used],
                            sign * values[used, None],
                            [-sign * end],
                        )
                    )
        return rows

    def solve_at(self, weight: float, c: Array) -> PenalisedOptimum | None:
        """Return the optimum inside the box for fixed centres of mass c (n, 3) [m]:
        convex and exact.

        Returns
        -------
        PenalisedOptimum or None
            None if no point of the box has these centres.
        """
        limit = self.problem.slack_limits(weight)
        data, cost = self._loss(weight)
        # With fixed c, first moments h = m c and Q = m c c^T are no variables: the
        # columns of the masses hold them.
        fold = np.eye(len(cost))
        products = inertia.inertia_entries(c[:, :, None] * c[:, None, :])
        for k, link in enumerate(self.links):
            for places, share in ((link[1:4], c[k]), (self._q(k), products[k])):
                fold[places, places] = 0.0
                fold[places, link[0]] = share
        columns = np.flatnonzero(fold.any(axis=0))  # of the remaining variables
        fold = fold[:, columns]
        constraints = ConstraintSet(tuple(_fold(x, fold) for x in self._always(limit)))
        folded = replace(data, R=data.R @ fold)
        start = self._start(c, c, limit)[columns]
        bound = self._bound(limit)[columns]
        problem = ConvexProblem(folded, constraints, bound, linear=cost[columns])
        fit = solve_once(problem, start)
        if fit is None:
            return None
        theta = self.problem.theta(fold @ fit.theta)
        return self.problem.optimum(theta, weight, max(fit.lower, 0.0))

    def centres(self, theta: Array) -> Array:
        """Return the centres of mass of an estimate, clipped to their bounds.

        Returns
        -------
        (n, 3) array
            [m]; the middle of the bounds for a massless link.
        """
        c = inertia.barycentric_from_standard(theta[self.links])[:, 1:4]
        middle = 0.5 * (self.c_low + self.c_high)
        return np.clip(np.where(np.isfinite(c), c, middle), self.c_low, self.c_high)

    def branch_and_bound(
        self, weight: float, gap: float, most_cells: int
    ) -> PenalisedOptimum:
        """Minimise the penalised objective inside the box by branch and bound over the
        centres of mass.

        A cell is a box of centres of mass. Its relaxation gives a lower bound, and the
        optimum at fixed centres in it a point. The cell with the lowest bound is split
        in two, until that bound is close to the best point.

        Parameters
        ----------
        gap : float
            Relative gap at which the search ends.
        most_cells : int
            Largest number of relaxations that are solved.

        Returns
        -------
        PenalisedOptimum
            Best point inside the box, and certified bound.

        Raises
        ------
        InputError
            If no cell has a point.
        """
        # A heap by lower bounds; the number of a cell decides between equal ones.
        number = count()
        cell = self.solve_cell(weight, self.c_low, self.c_high)
        cells = [(cell.relaxation.lower, next(number), cell)]
        best: PenalisedOptimum | None = None
        n_cells = 1
        while True:
            lower, _, cell = cells[0]
            # A point: the optimum at the relaxation's own centres of mass.
            centres = np.clip(self.centres(cell.relaxation.theta), cell.low, cell.high)
            candidate = self.solve_at(weight, centres)
            if candidate is not None and (best is None or candidate.value < best.value):
                best = candidate
            is_last = n_cells + 2 > most_cells
            if best is not None:
                bounded = replace(best, lower=lower, n_cells=n_cells)
                if bounded.gap <= gap or is_last:
                    return bounded
            elif is_last:
                what = f"no point of the box was found in {n_cells} cells"
                raise InputError(what, "check the bounds of the problem")
            heapq.heappop(cells)
            # A half cannot have a lower bound than its cell.
            for low, high in self._halves(cell):
                half = self.solve_cell(weight, low, high)
                n_cells += 1
                entry = (max(half.relaxation.lower, lower), next(number), half)
                heapq.heappush(cells, entry)

    def _halves(self, cell: SolvedCell) -> list[tuple[Array, Array]]:
        """Cut a cell in two along the coordinate with the largest relaxation error.

        The cut lies at the relaxation's centre of mass, but not too close to an end.
        """
        # Link k, axis a.
        k, a = np.unravel_index(np.argmax(cell.excess), cell.excess.shape)
        low = cell.low[k, a]
        high = cell.high[k, a]
        clear = self.nearest_cut * (high - low)
        centre = self.centres(cell.relaxation.theta)[k, a]
        cut = np.clip(centre, low + clear, high - clear)
        high_of_lower_half = cell.high.copy()
        high_of_lower_half[k, a] = cut
        low_of_upper_half = cell.low.copy()
        low_of_upper_half[k, a] = cut
        return [(cell.low, high_of_lower_half), (low_of_upper_half, cell.high)]


def _cell_rows(low: Array, high: Array) -> Array:
    """Return the rows (k, 16) in (m, h, J', Q) that are >= 0 in a cell low <= c <= high
    (3,).

    They are the bounds of c times m, and McCormick's inequalities for Q = m c c^T.
    """
    unit = np.eye(16)
    m, h, Q = unit[0], unit[1:4], unit[10:]
    rows = list[Array]()
    for a in range(3):
        rows += [h[a] - low[a] * m, high[a] * m - h[a]]

    def corner(k: int, x: float, y: float) -> Array:
        """Return the row of (c_a - x) (c_b - y) m, for entry k of Q, Q_ab."""
        a, b = inertia._ENTRIES[k]
        return Q[k] - x * h[b] - y * h[a] + x * y * m

    for k, (a, b) in enumerate(inertia._ENTRIES):
        rows.append(-corner(k, low[a], high[b]))
        if a != b:
            rows += [corner(k, low[a], low[b]), corner(k, high[a], high[b])]
            rows.append(-corner(k, high[a], low[b]))
    return np.array(rows)


def _fold(c: Constraint, fold: Array) -> Constraint:
    """Rewrite a constraint in the fewer variables x (j,) from which fold @ x, fold (k,
    j), makes all k."""
    rows = fold[c.indices]  # of the variables in this constraint
    used = np.flatnonzero(rows.any(axis=0))
    # sum_i fold[i, j] coefficients[i, ...] for each remaining variable j
    coefficients = np.tensordot(rows[:, used].T, c.coefficients, axes=(1, 0))
    return replace(c, indices=used, coefficients=coefficients)
