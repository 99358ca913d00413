"""Table I: the sigmoid friction of every joint, published and fitted.

    f(dq) = phi_1 / (1 + exp(-phi_2 (dq + phi_3))) - phi_1 / (1 + exp(-phi_2 phi_3))

(Gaz et al. 2019, eq. 12), phi_1 [N m], phi_2 [s/rad], phi_3 [rad/s]; zero at rest. The
base parameters pi of the links and all phi are fitted together to W pi + f = tau,
because a rigid part fitted without friction would have swallowed some of it. A coarse
grid of phi_2 starts the search.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats
from scipy.special import expit

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.bristles import PreslidingHysteresis
from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_parameters
from sdp_vs_penalty.research.tables.study import Data, Study
from sdp_vs_penalty.research.tables.table import (
    Row,
    Table,
    by_joint,
    notes,
    register_table,
)
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.filtered import FilteredRun, Rows

#: The rows of a data set in the columns of any model: filtered, or exact where states
#: are known.
RowsOf = Callable[[Model], Rows]


class SigmoidFriction(Effect):
    """f / phi_1 and its derivatives by phi_2 and phi_3 at given phi: three columns a
    joint.

    Not in the library of effects: its columns belong to one step of
    :func:`fit_sigmoid`; with the parameters (phi_1, 0, 0) it is the friction itself.
    """

    name = "sigmoid_friction"
    equation = "s(dq) - s(0), s(v) = 1 / (1 + exp(-phi_2 (v + phi_3)))"
    explanation = "One step of the fit of Table I."
    reference = "Gaz et al., RA-L 2019, eq. 12"

    def __init__(self, robot: Robot, shapes: Array) -> None:
        """shapes (n, 2): phi_2, phi_3 of each joint."""
        super().__init__(robot)
        self.slopes_and_shifts = shapes

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"sigmoid{k}_{j + 1}", "", self.name, j + 1)
            for j in range(self.robot.n)
            for k in range(3)
        )

    def blocks(self, motion: Motion) -> list[Block]:
        out = []
        for j, (slope, shift) in enumerate(self.slopes_and_shifts):
            moving = expit(slope * (motion.dq[:, j] + shift))
            other_columns = expit(slope * shift)
            d_moving = moving * (1.0 - moving)
            d_rest = other_columns * (1.0 - other_columns)
            by_slope = d_moving * (motion.dq[:, j] + shift) - d_rest * shift
            by_shift = slope * (d_moving - d_rest)
            columns = np.column_stack([moving - other_columns, by_slope, by_shift])
            out.append(Block(j, 3 * j + np.arange(3), columns))
        return out


@dataclass(frozen=True)
class SigmoidFit:
    """phi (n, 3) with standard deviations (n, 3); x (b + 3 n,) : pi (b,) base
    parameters fitted with them, phi_1, log phi_2, phi_3.

    lower, upper (n, 3) : 95 % intervals; at_bound (n,) : whether phi_2 ran into the end
    of its range, a step, whose interval means nothing.
    """

    x: Array
    phi: Array
    std: Array
    lower: Array
    upper: Array
    at_bound: NDArray[np.bool_]


def exact_rows(motion: Motion, torque: Array) -> RowsOf:
    """Rows of known states (simulation), not filtered."""
    return lambda model: Rows(motion, torque, model.columns(motion))


def fit_sigmoid(
    problem: Problem, rows_of: RowsOf, oversampling: float = 1.0
) -> SigmoidFit:
    """Fit pi and phi together; joints are weighted by the residuals of a first pass.

    oversampling : rows per independent sample, for the intervals.
    """
    data = _Data(problem, rows_of)
    n = problem.robot.n
    b = data.rigid.shape[2]
    size = float(np.abs(data.torque).max())
    weights = np.ones(n)
    empty = np.zeros(b + n)
    free = np.full(b + n, np.inf)
    # phi_2 [s/rad]: a jump to any data; below .1, and beyond |phi_3| = .5, a line
    steepest = 500.0
    low = np.concatenate([-free, np.full(n, np.log(0.1)), np.full(n, -0.5)])
    high = np.concatenate([free, np.full(n, np.log(steepest)), np.full(n, 0.5)])
    starts = (
        np.concatenate([empty, np.full(n, np.log(x)), np.zeros(n)])
        for x in (4.0, 10.0, 25.0)
    )
    solved = [data.solved(x, weights) for x in starts]
    x = min(solved, key=lambda x: float(np.sum(data.residual(x) ** 2)))
    for _ in range(2):
        x = optimize.least_squares(
            lambda x, w: (data.residual(x) * w).ravel(),
            x,
            lambda x, w: -(data.columns(x) * w[:, None]).reshape(-1, len(x)),
            bounds=(low, high),
            x_scale="jac",
            **dict.fromkeys(("xtol", "ftol", "gtol"), 1e-14),
            max_nfev=100,
            args=(weights,),
        ).x
        # With what rounding leaves, so that data without noise are not weighted by
        # rounding.
        rms = np.sqrt(np.mean(data.residual(x) ** 2, axis=0)) + 1e-12 * size
        weights = float(np.exp(np.mean(np.log(rms)))) / rms
    x = data.solved(x, weights)
    phi = x[b:].reshape(3, n).T.copy()
    phi[:, 1] = np.exp(phi[:, 1])
    jacobian = (data.columns(x) * weights[:, None]).reshape(-1, len(x))
    norms = np.linalg.norm(jacobian, axis=0)
    count = data.torque.size / oversampling
    # Rows that repeat each other count that often in J^T J, which the division here
    # takes back.
    dof = max(count - len(x), 1.0)
    variance = float(np.sum((data.residual(x) * weights) ** 2)) / dof
    inverse = np.linalg.pinv((jacobian / norms).T @ (jacobian / norms), hermitian=True)
    std = (np.sqrt(variance * np.diagonal(inverse)) / norms)[b:].reshape(3, n).T.copy()
    std[:, 1] *= phi[:, 1]  # of phi_2, from that of its logarithm
    half = stats.t.ppf(0.975, dof) * std
    return SigmoidFit(x, phi, std, phi - half, phi + half, phi[:, 1] > 0.99 * steepest)


class _Data:
    """rigid (M, n, b), torque (M, n), and the way to the sigmoid's columns at other
    shapes."""

    def __init__(self, problem: Problem, rows_of: RowsOf) -> None:
        model = problem.model("rigid_body")
        rows = rows_of(model)
        self.robot = problem.robot
        self.rows_of = rows_of
        self.torque = rows.torque
        wide = np.stack(
            [c.dense_columns(len(model.parameters)) for c in rows.columns], axis=1
        )
        self.rigid = wide[:, :, list(base_parameters(model, problem.independent)[1])]

    def columns(self, x: Array) -> Array:
        """(M, n, b + 3 n) derivative of the torque in x."""
        amplitude, slope, shift = x[self.rigid.shape[2] :].reshape(3, -1)
        slope = np.exp(slope)
        sigmoid = SigmoidFriction(self.robot, np.column_stack([slope, shift]))
        sigmoid_columns = [
            c.columns for c in self.rows_of(Model(self.robot, (sigmoid,))).columns
        ]
        scale = np.stack([np.ones(len(slope)), amplitude * slope, amplitude], axis=1)
        probes = np.stack(sigmoid_columns, axis=1) * scale
        wide = [probes[:, :, k, None] * np.eye(len(slope)) for k in range(3)]
        return np.concatenate([self.rigid, *wide], axis=2)

    def residual(self, x: Array) -> Array:
        """(M, n) of the torque; phi_2 and phi_3 act through the columns."""
        linear = x.shape[0] - 2 * self.robot.n
        return np.asarray(self.torque - self.columns(x)[:, :, :linear] @ x[:linear])

    def solved(self, x: Array, weights: Array) -> Array:
        """x with pi and phi_1 of least weighted residual at its phi_2 and phi_3."""
        columns = self.columns(x)[:, :, : -2 * self.robot.n] * weights[:, None]
        out = x.copy()
        flat = columns.reshape(self.torque.size, -1)
        target = (self.torque * weights).ravel()
        out[: flat.shape[1]] = np.linalg.lstsq(flat, target, rcond=None)[0]
        return out


def residual_rms(problem: Problem, parts: Sequence[RowsOf], fit: SigmoidFit) -> Array:
    """RMSE (n,) [N m] of a fit on other rows."""
    residuals = [_Data(problem, rows_of).residual(fit.x) for rows_of in parts]
    return np.asarray(np.sqrt(np.mean(np.concatenate(residuals) ** 2, axis=0)))


@register_table("I", "panda")
def sigmoid_friction(study: Study) -> Table:
    """Table I: the sigmoid friction of every joint, published and fitted.

    Rows: phi_1..phi_3 published and fitted, each with its interval; then errors
    on other rows.
    """
    published = study.problem.published["table_I"]
    rows: list[Row] = [
        {**row, "what": "published", "covered_percent": None} for row in published
    ]
    study.progress("sigmoid friction without noise")
    x = study.experiment
    truth = study.experiment.friction
    assert truth is not None
    t = np.arange(0.0, x.trajectory.duration, 0.02)
    motion = Motion(t, *x.trajectory.states(t))
    exact = fit_sigmoid(study.problem, exact_rows(motion, x.torque(motion)))
    rows += _rows_of("simulated, without noise", exact, ends=False)
    fits = []
    count = study.effort.replicates
    for k in range(
        count
    ):  # with different noise: the coverage of the intervals is counted from them
        study.progress(f"sigmoid friction: simulated run {k + 1} of {count}")
        run = study.simulated.train if k == 0 else x.training_run(study.seed + k)
        fits.append(_fit(study, study.simulated, run))
    # Share of the intervals of phi_1, phi_2, phi_3, over joints and fits, that hold the
    # truth.
    share = np.mean(
        [(f.lower <= truth) & (truth <= f.upper) for f in fits], axis=(0, 1)
    )
    rows += _rows_of("simulated", fits[0], 100.0 * share)
    intervals = count * study.problem.robot.n
    # Half width [%] of the 95 % range of a share counted from so many intervals.
    expected = 196.0 * float(np.sqrt(0.95 * 0.05 / intervals))
    steps = {"simulated": _steps("simulated", fits[0]), "measured": ""}
    if study.measured is not None:
        study.progress("sigmoid friction of the real run")
        fit = _fit(study, study.measured, study.measured.train)
        rows += _rows_of("measured", fit)
        steps["measured"] = _steps("measured", fit)
    for data in study.judged:
        for name, errors in _on_other_rows(study, data):
            what = f"{data.label}, RMSE on {data.judged_on}"
            rows.append(_row(name, errors, "N*m", what))
    return Table(
        f"Table I: sigmoid friction of {study.problem.title}",
        rows,
        notes("I", count=count, intervals=intervals, expected=expected, **steps),
        digits=5,
    )


def _row(
    name: str, joints: Array, unit: str, what: str, covered: float | None = None
) -> Row:
    about = {"unit": unit, "what": what, "covered_percent": covered}
    return {"parameter": name, **by_joint(joints), **about}


def _rows_of(
    what: str, fit: SigmoidFit, covered: Array | None = None, ends: bool = True
) -> list[Row]:
    """phi_1, phi_2, phi_3, each with the ends of its interval where they are asked for."""
    rows = []
    for k, unit in enumerate(("N*m", "s/rad", "rad/s")):
        share = None if covered is None else float(covered[k])
        rows.append(_row(f"phi_{k + 1}", fit.phi[:, k], unit, what, share))
        for word in ("lower", "upper") if ends else ():
            rows.append(
                _row(f"phi_{k + 1}", getattr(fit, word)[:, k], unit, f"{what}, {word}")
            )
    return rows


def _steps(what: str, fit: SigmoidFit) -> str:
    """A note on the joints whose data want a step."""
    joints = ", ".join(map(str, np.flatnonzero(fit.at_bound) + 1))
    sentences = (
        "phi_2 ran to the end of its range: the data want a step, and the interval"
        " means nothing."
    )
    return f"{what}: on joint(s) {joints} {sentences}" if joints else ""


def _rows_in(data: Data, run: Measurements) -> RowsOf:
    return lambda model: FilteredRun(run, data.preprocessing).all_rows(model)


def _fit(study: Study, data: Data, run: Measurements) -> SigmoidFit:
    """The sigmoid and the base parameters from one run behind the filters of a data
    set."""
    repeats = FilteredRun(run, data.preprocessing).rows_per_sample
    return fit_sigmoid(study.problem, _rows_in(data, run), repeats)


def _on_other_rows(study: Study, data: Data) -> list[tuple[str, Array]]:
    """RMSE (n,) of three friction models on the test rows."""
    assert data.test is not None
    study.progress(f"friction models on {data.label} data, {data.judged_on}")
    usual = "rigid_body,viscous_friction,coulomb_friction,torque_offset"

    def ordinary(effects: str) -> tuple[float, Array]:
        """Training loss and test RMSE (n,) of ordinary least squares with these
        effects."""
        own = replace(data, model=study.problem.model(effects))
        train = own.regression.least_squares()
        theta = np.asarray(np.linalg.lstsq(train.R, train.rho, rcond=1e-10)[0], float)
        return train.loss(theta), np.sqrt(own.errors(theta)[0])

    fit = _fit(study, data, data.train)
    linear = ordinary(usual)[1]
    tried = {
        d: ordinary(f"{usual},presliding_hysteresis@d={d}")
        for d in PreslidingHysteresis.shapes["d"].grid
    }
    best = min(tried, key=lambda d: tried[d][0])
    others = [_rows_in(data, run) for run in data.test.runs()]
    return [
        ("linear friction", linear),
        ("sigmoid friction", residual_rms(study.problem, others, fit)),
        (f"presliding hysteresis (d = {best:g} rad)", tried[best][1]),
    ]
