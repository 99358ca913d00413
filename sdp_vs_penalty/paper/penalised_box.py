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
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations, count

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.paper.penalised_optimum import (
    PenalisedOptimum,
    PenalisedProblem,
    solve_once,
)
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint, linear


def _index_of_entry(a: int, b: int) -> int:
    """Return the index of entry (a, b) of a symmetric 3x3 matrix.

    The order is that of an inertia: xx, xy, yy, xz, yz, zz.
    """
    low, high = sorted((a, b))
    return high * (high + 1) // 2 + low


@dataclass(frozen=True)
class BoxedOptimum:
    """The optimum inside the box on barycentric inertias, enclosed."""

    #: The best point found; None where no cell had one.
    best: PenalisedOptimum | None
    #: Certified bound on the optimum inside the box.
    lower: float
    #: Bound of the relaxation without branching.
    root_lower: float
    #: Number of relaxations solved.
    n_cells: int

    @property
    def gap(self) -> float:
        """Relative distance of the best point from the certified bound; inf without
        a point.
        """
        if self.best is None:
            return np.inf
        return max(self.best.value - self.lower, 0.0) / self.best.scale


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

    def solve_cell(
        self, weight: float, low: Array, high: Array
    ) -> tuple[float, PenalisedOptimum, Array]:
        """Solve the relaxation over a cell low <= c <= high (n, 3) of centres of mass
        [m].

        Returns
        -------
        tuple of (float, PenalisedOptimum, (n, 3) array)
            Certified lower bound over the cell; the relaxation's optimum, whose theta
            may lie outside of the box; and the relaxation error Q_aa - h_a^2 / m [kg
            m^2].

        Raises
        ------
        InputError
            If the cell has no strictly feasible point.
        """
        problem = self.problem
        n = len(self.links)
        limit = problem.slack_limits(weight)
        start = self._start(low, high, limit)
        constraints = [*self.hard, *problem.consistency, *problem.soft]
        constraints += problem.between(limit)
        for k in range(n):
            constraints += self._cell(k, low[k], high[k])
        # The loss, the cost and the bounds in all variables: theta', slacks, Q.
        data = problem.in_slacks
        without_q = np.zeros((len(data.R), 6 * n))
        widened = replace(data, R=np.hstack([data.R, without_q]))
        cost = np.zeros(len(start))
        cost[problem.p : self.first_q] = weight * problem.prices
        farthest = np.maximum(np.abs(low), np.abs(high)).max(axis=1)
        largest_q = self.task.bound[self.links[:, 0]] * farthest**2
        bound = np.concatenate([self._bound(limit), np.repeat(largest_q, 6)])
        fit = solve_once(widened, cost, constraints, start, bound)
        if fit is None:
            raise InputError(
                "a cell of centres of mass has no point inside of it",
                "check the bounds of the problem",
            )
        theta = problem.theta(fit.theta)
        lower = max(fit.lower, 0.0)
        # How far Q is from m c c^T on its diagonal: zero if the relaxation is exact.
        mass = theta[self.links[:, 0]]
        h = theta[self.links[:, 1:4]]
        q = fit.theta[self.first_q :].reshape(n, 6)
        diagonal = q[:, [0, 2, 5]]  # Q_xx, Q_yy, Q_zz
        excess = diagonal - h**2 / mass[:, None]
        return lower, problem.optimum(theta, weight, lower), excess

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
        steiner = np.einsum("eij,nij->ne", inertia.STEINER_FORMS, q)
        first_moments = mass[:, None] * middle
        theta = problem.interior.copy()
        theta[self.links] = np.column_stack([mass, first_moments, about + steiner])
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

    def _cell(self, k: int, low: Array, high: Array) -> list[Constraint]:
        """Return all constraints of link k in a cell, on (m, h, J'), its slack, and Q.

        low, high : (3,) ends of the cell [m].
        """
        link = self.links[k]
        q = self.first_q + 6 * k + np.arange(6)
        name = f"link {k + 1}"
        rows = _cell_rows(low, high)
        indices = np.concatenate([link, q])
        cell = linear("cell", name, indices, np.array(rows).T, np.zeros(len(rows)))
        # The link's own slack follows the p parameters.
        with_slack = np.append(link, self.problem.p + k)
        return [
            _lifted(name, link, q),
            _consistent_about_centre(name, link, q),
            cell,
            *self._box_rows(k, with_slack, q),
        ]

    def _box_rows(
        self,
        k: int,
        link: NDArray[np.intp],
        q: NDArray[np.intp] | None = None,
        c: Array | None = None,
    ) -> list[Constraint]:
        """Return the rows that keep the inertia of link k about its centre of mass in
        the box.

        lower <= J'_e - 2 s [e on the diagonal] - <Q_e, Q> <= upper, for each of the six
        entries e: J' is the inertia about the frame raised by the slack s, Q = m c c^T,
        and <Q_e, Q> Steiner's term. Ends that are infinite are left out.

        Parameters
        ----------
        k : int
            Index of the link, from 0.
        link : (11,) array
            Indices of the link's parameters and of its slack.
        q : (6,) array, optional
            Indices of the entries of Q.
        c : (3,) array, optional
            Fixed centre of mass [m], with which Q is m c c^T instead.
        """
        rows = list[Constraint]()
        for e, (lower, upper) in enumerate(self.inertia_box[k]):
            form = inertia.STEINER_FORMS[e]
            row = {4 + e: 1.0}  # J' begins at parameter 4
            is_diagonal = np.trace(form) > 0.0
            if is_diagonal:
                row[10] = -2.0  # the slack
            values = _row(row, 11)
            indices = link
            if q is not None:
                # Entries off the diagonal occur twice in <Q_e, Q>.
                doubled = inertia.inertia_entries(form) * [1, 2, 1, 2, 2, 1]
                values = np.concatenate([values, -doubled])
                indices = np.concatenate([link, q])
            if c is not None:
                values[0] -= c @ form @ c
            used = np.flatnonzero(values)
            for end, sign in ((lower, 1.0), (upper, -1.0)):
                if not np.isfinite(end):
                    continue
                rows.append(
                    linear(
                        "barycentric inertia",
                        f"link {k + 1}, {e}, {sign:+g}",
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
        problem = self.problem
        limit = problem.slack_limits(weight)
        # First moments are no variables: h = m c with fixed c.
        fold = self._fold_centres(c, problem.p + len(limit))
        columns = np.flatnonzero(fold.any(axis=0))  # of the remaining variables
        number = np.full(len(fold), -1)
        number[columns] = np.arange(len(columns))
        constraints = [*self.hard, *problem.soft, *problem.between(limit)]
        for k, link in enumerate(self.links):
            constraints.append(
                _consistent_about_fixed_centre(f"link {k + 1}", link, c[k])
            )
            with_slack = np.append(link, problem.p + k)
            constraints += self._box_rows(k, with_slack, c=c[k])
        data = problem.in_slacks
        folded_data = replace(data, R=(data.R @ fold)[:, columns])
        folded = [_fold(x, fold, number) for x in constraints]
        # Cost, start and bounds of the remaining variables.
        cost = np.append(np.zeros(problem.p), weight * problem.prices)[columns]
        start = self._start(c, c, limit)[: len(fold)][columns]
        bound = self._bound(limit)[columns]
        fit = solve_once(folded_data, cost, folded, start, bound)
        if fit is None:
            return None
        theta = problem.theta(fold[:, columns] @ fit.theta)
        return problem.optimum(theta, weight, max(fit.lower, 0.0))

    def _fold_centres(self, c: Array, size: int) -> Array:
        """Return the matrix (size, size) that replaces first moments h by m c with
        fixed c.

        The columns of h become zero; those of m hold c (n, 3) in the rows of h.
        """
        fold = np.eye(size)
        for link, centre in zip(self.links, c, strict=True):
            fold[link[1:4], link[1:4]] = 0.0
            fold[link[1:4], link[0]] = centre
        return fold

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

    def branch_all(
        self, weights: Iterable[float], gap: float, most_cells: int
    ) -> list[BoxedOptimum]:
        """Run branch and bound at increasing weights.

        The objective increases with the weight. So the bound of a smaller weight still
        holds, and a point without violations stays the optimum.

        Parameters
        ----------
        gap : float
            Relative gap at which a search ends.
        most_cells : int
            Largest number of relaxations of one search.
        """
        optima = list[BoxedOptimum]()
        for weight in weights:
            before = optima[-1] if optima else None
            if before is not None and before.best is not None:
                same = BoxedOptimum(
                    best=self.problem.optimum(before.best.theta, weight, before.lower),
                    lower=before.lower,
                    root_lower=before.root_lower,
                    n_cells=0,
                )
                if same.gap <= self.problem.held_gap:
                    optima.append(same)
                    continue
            found = self.branch_and_bound(weight, gap, most_cells)
            if before is not None:
                found = replace(found, lower=max(found.lower, before.lower))
            optima.append(found)
        return optima

    def branch_and_bound(
        self, weight: float, gap: float, most_cells: int
    ) -> BoxedOptimum:
        """Minimise the penalised objective inside the box by branch and bound over the
        centres of mass.

        A cell is a box of centres of mass. Its relaxation gives a lower bound, and the
        optimum at fixed centres in it a point. The cell with the lowest bound is split
        in two, until that bound is close to the best point.

        Parameters
        ----------
        gap : float
            Relative gap at which the search ends.

        Returns
        -------
        BoxedOptimum
            Best point and certified bound.
        """
        # A heap by lower bounds; the number of a cell decides between equal ones.
        number = count()
        cell = self._solved_cell(weight, self.c_low, self.c_high)
        cells = [(cell.lower, next(number), cell)]
        root = cell.lower
        n_cells = 1
        best: PenalisedOptimum | None = None
        while True:
            lower, _, cell = cells[0]
            # A point: the optimum at the relaxation's own centres of mass.
            centres = np.clip(self.centres(cell.relaxation.theta), cell.low, cell.high)
            candidate = self.solve_at(weight, centres)
            if candidate is not None and (best is None or candidate.value < best.value):
                best = candidate
            result = BoxedOptimum(best, lower, root, n_cells)
            if result.gap <= gap or n_cells + 2 > most_cells:
                return result
            heapq.heappop(cells)
            # A half cannot have a lower bound than its cell.
            for low, high in self._halves(cell):
                half = self._solved_cell(weight, low, high)
                n_cells += 1
                entry = (max(half.lower, lower), next(number), half)
                heapq.heappush(cells, entry)

    def _solved_cell(self, weight: float, low: Array, high: Array) -> SolvedCell:
        """Solve the relaxation over the cell low <= c <= high (n, 3), and bundle the
        result.
        """
        return SolvedCell(low, high, *self.solve_cell(weight, low, high))

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


@dataclass(frozen=True)
class SolvedCell:
    """A cell low <= c <= high of centres of mass, and its relaxation."""

    #: (n, 3) smallest coordinates of the centres of mass [m].
    low: Array
    #: (n, 3) largest coordinates of the centres of mass [m].
    high: Array
    #: Certified lower bound over the cell.
    lower: float
    #: The relaxation's optimum.
    relaxation: PenalisedOptimum
    #: (n, 3) by how much its Q_aa exceeds h_a^2 / m [kg m^2].
    excess: Array


def _cell_rows(low: Array, high: Array) -> list[Array]:
    """Return the rows (16,) in (m, h, J', Q) that are >= 0 in a cell low <= c <= high
    (3,).

    They are the bounds of c times m, and McCormick's inequalities for Q = m c c^T.
    """
    rows = list[Array]()
    # Indices of a row: m is 0, h is 1 to 3, J' is 4 to 9, Q is 10 to 15.
    for a in range(3):  # low m <= h <= high m
        rows.append(_row({1 + a: 1.0, 0: -low[a]}))
        rows.append(_row({1 + a: -1.0, 0: high[a]}))
    for a in range(3):  # Q_aa <= (low + high) h_a - low high m
        total = low[a] + high[a]
        product = low[a] * high[a]
        rows.append(_row({10 + _index_of_entry(a, a): -1.0, 1 + a: total, 0: -product}))
    for a, b in combinations(range(3), 2):  # Q_ab from below, then from above
        corners = (
            (low[a], low[b], 1.0),
            (high[a], high[b], 1.0),
            (high[a], low[b], -1.0),
            (low[a], high[b], -1.0),
        )
        for x, y, sign in corners:
            row = _row(
                {10 + _index_of_entry(a, b): 1.0, 1 + b: -x, 1 + a: -y, 0: x * y}
            )
            rows.append(sign * row)
    return rows


def _row(values: dict[int, float], size: int = 16) -> Array:
    """Return a row (size,) that has these values at their indices, and zeros elsewhere."""
    row = np.zeros(size)
    for index, value in values.items():
        row[index] = value
    return row


def _lifted(name: str, link: NDArray[np.intp], q: NDArray[np.intp]) -> Constraint:
    """Return Shor's relaxation of Q = m c c^T: [[Q, h], [h^T, m]] >= 0 with h = m c.

    link : (10,) indices of m, h and second moments of a link; q : (6,) indices of Q.
    """
    coefficients = np.zeros((10, 4, 4))
    coefficients[:4] = inertia.PSEUDO_INERTIA_BASIS[:4]
    for a, b in np.ndindex(3, 3):
        coefficients[4 + _index_of_entry(a, b), a, b] = 1.0
    indices = np.concatenate([link[:4], q])
    return linear("lifted", name, indices, coefficients, np.zeros((4, 4)), "psd")


def _consistent_about_centre(
    name: str, link: NDArray[np.intp], q: NDArray[np.intp]
) -> Constraint:
    """Return the constraint Sigma' - Q >= 0 of physical consistency.

    Sigma' (3, 3) are the second moments about the link's frame, Q = m c c^T, so that
    the difference is about the centre of mass [kg m^2]. link : (10,) indices of the
    link's parameters; q : (6,) indices of Q.
    """
    coefficients = np.zeros((12, 3, 3))
    coefficients[:6] = inertia.PSEUDO_INERTIA_BASIS[4:, :3, :3]
    for a, b in np.ndindex(3, 3):
        coefficients[6 + _index_of_entry(a, b), a, b] = -1.0
    indices = np.concatenate([link[4:], q])
    return linear("about centre", name, indices, coefficients, np.zeros((3, 3)), "psd")


def _consistent_about_fixed_centre(
    name: str, link: NDArray[np.intp], c: Array
) -> Constraint:
    """Return the constraint Sigma' - m c c^T >= 0 for a fixed centre of mass c (3,)
    [m].

    link : (10,) indices of the link's parameters.
    """
    coefficients = np.zeros((7, 3, 3))
    coefficients[0] = -np.outer(c, c)
    coefficients[1:] = inertia.PSEUDO_INERTIA_BASIS[4:, :3, :3]
    indices = np.append(link[:1], link[4:])
    return linear("about centre", name, indices, coefficients, np.zeros((3, 3)), "psd")


def _fold(c: Constraint, fold: Array, number: NDArray[np.intp]) -> Constraint:
    """Rewrite a constraint in fewer variables.

    fold : (k, k) matrix from the remaining variables to all of them; number : (k,)
    index of each remaining variable among those.
    """
    rows = fold[c.indices]  # of the variables in this constraint
    used = np.flatnonzero(rows.any(axis=0))
    # sum_i fold[i, j] coefficients[i, ...] for each remaining variable j
    coefficients = np.tensordot(rows[:, used].T, c.coefficients, axes=(1, 0))
    return replace(c, indices=number[used], coefficients=coefficients)
