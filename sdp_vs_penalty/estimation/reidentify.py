"""Identification that goes on while the robot moves: samples in, certified parameters out.

Filtered rows of each new block are merged into one triangle, whose size does not grow; the convex
problem is solved from that triangle alone.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.sources import Source, as_measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimators.lmi_sdp import (
    LmiSdp,
    essential,
    interior_point,
    sample_variance,
    solve_sdp,
)
from sdp_vs_penalty.estimators.task import joint_weights, make_task
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import LeastSquares, compress
from sdp_vs_penalty.robot import compiled
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.preprocessing import filtered_rows
from sdp_vs_penalty.solvers.objective import Objective
from sdp_vs_penalty.solvers.structured import Structured

#: Certified gap, relative to the loss, up to which a compiled answer counts; else Clarabel solves again.
_TIGHT = 1e-6


@dataclass(frozen=True)
class Parameters:
    """theta (p,) in the model's order, feasible, and whose answer it is.

    gap : of its objective to a certified lower bound, relative to the loss.
    """

    theta: Array
    gap: float
    solver: str


class Reidentifier:
    """Parameters of a robot, renewed as samples come: for a loop at the rate of its controller.

        minimise sum_k w_k |Y_k theta - tau_k|^2 + prior   subject to the problem's constraints

    :meth:`take` is told each sample (or a few) and costs microseconds, but where a block is complete:
    then its rows are filtered and merged (milliseconds; between two cycles, or in another thread).
    :meth:`solve` may be called in any cycle. Weights of the joints, prior and filters are those of the
    runs that it starts with; filters reach 2 / state_cutoff + 2 / torque_cutoff seconds to either side,
    so much later a sample counts.

    start : an Estimate, whose problem and model are kept, or a problem as for ``identify``; runs : as
    for ``identify``, at least one exciting motion; method : an LmiSdp with its own settings; block :
    seconds of samples that are filtered at a time; half_life : seconds of motion after which old rows
    weigh half (None: never). Raises InputError for input that cannot be used.
    """

    def __init__(
        self,
        start: Estimate | str | Problem,
        runs: Source,
        method: LmiSdp | None = None,
        *,
        block: float = 0.5,
        half_life: float | None = None,
    ) -> None:
        if not block > 0.0 or not (half_life is None or half_life > 0.0):
            raise InputError(f"block {block!r}, half_life {half_life!r}", "give seconds above 0")
        known = isinstance(start, Estimate)
        if isinstance(start, Estimate):
            self.problem, self.model = start.problem, start.model
        else:
            self.problem = as_problem(start, "Reidentifier(start=...)")
            self.model = self.problem.model()
        if any(e.has_memory for e in self.model.effects):
            raise InputError("effects with a memory need a run from its start", "leave them out")
        if self.model.needs_reference and not known:
            raise InputError("effects that refer to a current model", "start from an Estimate")
        robot = self.problem.robot
        first = as_measurements(runs, robot.n, robot.joint_names, "Reidentifier(runs=...)")
        self._settings = self.problem.preprocessing.resolve(first)
        regression = compress(first, self.model, self._settings)
        plain = make_task(self.problem, self.model, regression, "none")
        self._weights = joint_weights(regression, plain.ols)
        self._task = make_task(self.problem, self.model, regression)
        self._estimator = method or LmiSdp()
        self._objective, self._constraints = self._estimator.posed(self._task)
        self._prior = self._estimator.joint_prior * sample_variance(self._task)
        self._rows, self._data = self._task.data, self._objective.least_squares
        self._interior = interior_point(self._task, self._constraints)
        self._quick = self._structured()
        self._last: Array | None = None
        self._answer: Parameters | None = None
        self._block, self._half_life = block, half_life
        self._buffer: list[tuple[Array, Array, Array]] = []
        self._pending, self._counted = 0.0, -np.inf

    def _structured(self) -> Structured | None:
        if compiled.core() is None:
            return None
        sent = essential(self._constraints, self._objective)
        entropy, bound = self._objective.entropy, self._task.bound
        return Structured.of(entropy, self._constraints, sent, bound, self._interior)

    @property
    def reach(self) -> float:
        """Seconds of samples that a row is filtered from, to either side."""
        assert self._settings.state_cutoff is not None
        assert self._settings.torque_cutoff is not None
        return 2.0 / self._settings.state_cutoff + 2.0 / self._settings.torque_cutoff

    def take(self, t: ArrayLike, q: ArrayLike, tau: ArrayLike) -> bool:
        """Take samples: times t (k,) or one [s], positions q and torques tau (k, n) or (n,).

        Returns whether a block was completed, so that :meth:`solve` has something new. Raises InputError
        for samples of another robot, that are not finite, or earlier than those before.
        """
        clock = np.atleast_1d(np.asarray(t, float))
        states = [np.atleast_2d(np.asarray(x, float)) for x in (q, tau)]
        shape = (len(clock), self.problem.robot.n)
        if any(x.shape != shape or not np.all(np.isfinite(x)) for x in states):
            raise InputError("samples that are no finite (k, n) positions and torques", "give those")
        before = self._buffer[-1][0][-1] if self._buffer else clock[0] - 1.0
        if not np.all(np.diff(clock, prepend=before) > 0.0):
            raise InputError("samples whose clock does not go on", "give each later than the last")
        self._pending += float(clock[-1] - (before if self._buffer else clock[0]))
        self._buffer.append((clock, states[0], states[1]))
        if self._pending < self._block:
            return False
        self._pending = 0.0
        return self._merge()

    def _merge(self) -> bool:
        """Rows of the buffered samples that are not counted yet, into the triangle."""
        t, q, tau = (np.concatenate(parts) for parts in zip(*self._buffer, strict=True))
        keep = t > self._counted - 1.5 * self.reach  # what the filters of later rows reach back to
        t, q, tau = t[keep], q[keep], tau[keep]
        self._buffer = [(t, q, tau)]
        if t[-1] - t[0] < 2.5 * self.reach:
            return False
        run = Measurements(t, q, tau)
        p, squared, count, last = len(self._interior), 0.0, 0, self._counted
        parts: list[Array] = []
        with suppress(InputError):  # no rows: it stands still
            for rows in filtered_rows(run, self.model, self._settings):
                new = rows.motion.t > self._counted
                for joint, columns in enumerate(rows.columns):
                    wide = np.zeros((int(new.sum()), p + 1))
                    wide[:, columns.indices] = columns.columns[new]
                    wide[:, -1] = rows.torque[new, joint]
                    parts.append(self._weights[joint] * wide)
                    squared += float(np.sum(parts[-1][:, -1] ** 2))
                    count += len(wide)
                last = float(rows.motion.t[-1])
        fresh = last - max(self._counted, float(t[0]))  # seconds of motion, standing still aside
        # Earlier instants without rows stood still; those that later samples decide on lie within reach.
        self._counted = max(last, float(t[-1]) - self.reach)
        if not count:
            return False
        fade = 1.0 if self._half_life is None else 0.5 ** (fresh / self._half_life)
        self._rows = _faded(self._rows, fade, parts, squared, count)
        self._data, scale = self._rows, self._task.joint_scale
        if self._prior > 0.0 and scale is not None:
            self._data = self._rows.with_prior(scale, self._prior)
        self._answer = None
        return True

    def solve(self) -> Parameters:
        """The optimum for all samples so far, certified; the last one where there is nothing new.

        Raises InputError where no solver finds one.
        """
        if self._answer is None:
            self._answer = self._solved()
        return self._answer

    def _solved(self) -> Parameters:
        data = self._data
        if self._quick is not None:
            found = self._quick.solve(data, 0.1 * _TIGHT, self._last)
            if found.feasible and found.gap <= _TIGHT:
                self._last = found.theta
                return Parameters(found.theta, found.gap, "native")
        objective = Objective(data, self._objective.entropy)
        task = replace(self._task, data=data)
        fit = solve_sdp(task, objective, self._constraints, "clarabel", self._estimator.accuracy)
        return Parameters(fit.theta, fit.gap, "clarabel")


def _faded(
    data: LeastSquares, fade: float, parts: list[Array], squared: float, count: int
) -> LeastSquares:
    """Old data times ``fade`` and new rows (k, p + 1), as one problem."""
    p = data.R.shape[1]
    root = np.sqrt(fade)
    old = root * np.column_stack([data.R, data.rho])
    end = np.append(np.zeros(p), root * data.residual_norm)[None]
    return LeastSquares.stacked(
        [old, end, *parts], int(fade * data.rows) + count, fade * data.tau_squared + squared
    )
