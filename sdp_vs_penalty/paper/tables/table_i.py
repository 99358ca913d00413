"""Table I: the sigmoid friction of every joint, published and fitted.

    f(dq) = phi_1 / (1 + exp(-phi_2 (dq + phi_3))) - phi_1 / (1 + exp(-phi_2 phi_3))

(Gaz et al. 2019, eq. 12), phi_1 [N m], phi_2 [s/rad], phi_3 [rad/s]; zero at rest. The
base parameters pi of the links and all phi are fitted together to W pi + f = tau,
because a rigid part fitted without friction would have swallowed some of it. A coarse
grid of phi_2 starts the search over phi_2 and phi_3; all others solve a linear problem.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
import scipy

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.bristles import PreslidingHysteresis
from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.paper.tables.study import Data, Study
from sdp_vs_penalty.paper.tables.table import (
    Row,
    StudyTable,
    by_joint,
    notes,
    register_table,
)
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_parameters
from sdp_vs_penalty.regression.evidence import student_95
from sdp_vs_penalty.robot.arrays import Array, Mask
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.filtered import FilteredRun, Rows

#: The rows of a data set in the columns of any model: filtered, or exact where states
#: are known.
RowsOf = Callable[[Model], Rows]


class LinearisedSigmoid(Effect):
    """f / phi_1 and its derivatives by log phi_2 and phi_3 at given phi: three columns a
    joint.

    Not in the library of effects: its columns belong to one step of
    :func:`fit_sigmoid`; with the parameters (phi_1, 0, 0) it is the friction itself.
    """

    name = "linearised_sigmoid"
    equation = "s(dq) - s(0), s(v) = 1 / (1 + exp(-phi_2 (v + phi_3)))"
    explanation = "One step of the fit of Table I."
    reference = "Gaz et al., RA-L 2019, eq. 12"

    def __init__(self, robot: Robot, shapes: Array) -> None:
        """Set the point of one step of the fit.

        shapes : (n, 2) phi_2 [s/rad] and phi_3 [rad/s] of each joint.
        """
        super().__init__(robot)
        self.slopes_and_shifts = shapes

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """For each joint phi_1, and the steps of log phi_2 and phi_3."""
        return tuple(
            Parameter(f"sigmoid{k}_{j + 1}", "", self.name, j + 1)
            for j in range(self.robot.n)
            for k in range(3)
        )

    def blocks(self, motion: Motion) -> list[Block]:
        """Return three columns (N, 3) for each joint: with s(v) = 1 / (1 + exp(-phi_2 (v
        + phi_3))), f / phi_1 = s(dq) - s(0) and its derivatives by log phi_2 and phi_3.
        """
        blocks = []
        for j, (slope, shift) in enumerate(self.slopes_and_shifts):
            speed = np.append(motion.dq[:, j], 0.0) + shift  # the last at rest
            s = scipy.special.expit(slope * speed)
            by_shift = slope * s * (1.0 - s)
            values = np.column_stack([s, by_shift * speed, by_shift])
            blocks.append(Block(j, 3 * j + np.arange(3), values[:-1] - values[-1]))
        return blocks


@dataclass(frozen=True)
class SigmoidFit:
    """Sigmoid friction phi of n joints, fitted with b base parameters."""

    #: (b,) base parameters.
    pi: Array
    #: (n, 3) friction parameters.
    phi: Array
    #: (n, 3) lower ends of the 95 % intervals.
    lower: Array
    #: (n, 3) upper ends of the 95 % intervals.
    upper: Array
    #: (n,) whether phi_2 ran into the end of its range, a step, whose interval means
    #: nothing.
    at_bound: Mask


def exact_rows(motion: Motion, torque: Array) -> RowsOf:
    """Return a function from a model to its rows (torque = columns times parameters) at
    known states and torques (N, n), without filters."""
    return lambda model: Rows(motion, torque, model.columns(motion))


#: Range of phi_2 [s/rad]: steeper is a jump to any data, flatter a line.
FLATTEST = 0.1
STEEPEST = 500.0
#: Beyond this |phi_3| [rad/s] the sigmoid is a line.
LARGEST_SHIFT = 0.5
#: Slopes phi_2 from which the search starts [s/rad].
START_SLOPES = (4.0, 10.0, 25.0)


def fit_sigmoid(
    problem: Problem, rows_of: RowsOf, oversampling: float = 1.0
) -> SigmoidFit:
    """Fit base parameters pi and friction phi of all joints together.

    Joints are weighted by the residuals of a first pass. The search starts from several
    slopes phi_2.

    Parameters
    ----------
    rows_of : callable
        Returns the rows of a model.
    oversampling : float
        Rows for each independent sample, which the intervals take into account.
    """
    data = _Data(problem, rows_of)
    n = problem.robot.n
    weights = np.ones(n)
    # y: log phi_2 and phi_3 of the joints.
    starts = [np.repeat([np.log(slope), 0.0], n) for slope in START_SLOPES]
    y = min(starts, key=lambda y: float(np.sum(data.projected(y, weights)[0] ** 2)))
    high = np.repeat([np.log(STEEPEST), LARGEST_SHIFT], n)
    low = np.repeat([np.log(FLATTEST), -LARGEST_SHIFT], n)
    for _ in range(2):
        solution = scipy.optimize.least_squares(
            lambda y, w=weights: data.projected(y, w)[0],
            y,
            lambda y, w=weights: data.projected(y, w)[1],
            bounds=(low, high),
            x_scale="jac",
            **dict.fromkeys(("xtol", "ftol", "gtol"), 1e-14),
            max_nfev=100,
        )
        y = solution.x
        # Weights with mean logarithm zero; a residual of rounding counts as that much.
        rounding = 1e-12 * float(np.abs(data.torque).max())
        residual = data.projected(y, weights)[0].reshape(-1, n) / weights
        rms = np.sqrt(np.mean(residual**2, axis=0)) + rounding
        weights = np.exp(np.mean(np.log(rms))) / rms
    return _with_intervals(data, y, weights, oversampling)


def _with_intervals(
    data: "_Data", y: Array, weights: Array, oversampling: float
) -> SigmoidFit:
    """Return the fit at log phi_2 and phi_3 (2 n,) with 95 % intervals, from the
    Jacobian J of all its parameters with weights (n,) of the joints.

    Their covariance is sigma^2 (J^T J)^-1, with sigma^2 the squared residuals over the
    degrees of freedom.

    Parameters
    ----------
    oversampling : float
        Number of rows that repeat each other. J^T J counts each of them; the degrees of
        freedom count one.
    """
    n = len(weights)
    linear, shapes = data.columns(y, weights)
    residual, _, x = data.projected(y, weights)
    amplitude = x[-n:]
    jacobian = np.hstack([linear, shapes * np.tile(amplitude, 2)])
    norms = np.linalg.norm(jacobian, axis=0)
    degrees = max(data.torque.size / oversampling - len(norms), 1.0)
    scaled = jacobian / norms
    inverse = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
    variance = float(residual @ residual) / degrees
    std = (np.sqrt(variance * np.diagonal(inverse)) / norms)[-3 * n :].reshape(3, n).T
    slope, shift = np.exp(y[:n]), y[n:]
    phi = np.column_stack([amplitude, slope, shift])
    # Of phi_2, from its logarithm.
    half = student_95(degrees + 1.0) * std
    half[:, 1] *= slope
    return SigmoidFit(x[:-n], phi, phi - half, phi + half, slope > 0.99 * STEEPEST)


class _Data:
    """rigid (M, n, b), torque (M, n), and the way to the sigmoid's columns at other
    shapes."""

    def __init__(self, problem: Problem, rows_of: RowsOf) -> None:
        """Compute the rows of the rigid body in its base parameters.

        Parameters
        ----------
        rows_of : callable
            Returns the rows of a model at M instants.
        """
        model = problem.model("rigid_body")
        rows = rows_of(model)
        self.robot = problem.robot
        self.torque = rows.torque
        size = len(model.parameters)
        wide = np.stack([c.dense_columns(size) for c in rows.columns], axis=1)
        _, independent = base_parameters(model, problem.independent)
        self.rigid = wide[:, :, list(independent)]
        # Residual and Jacobian are asked at the same shapes.
        self.sigmoid = lru_cache(1)(partial(self._sigmoid, rows_of))

    def _sigmoid(self, rows_of: RowsOf, y: tuple[float, ...]) -> Array:
        """Return each joint's friction per phi_1, and its derivatives by log phi_2 and
        phi_3 per phi_1, (M, n, 3), at log phi_2 and phi_3 of the joints."""
        slope, shift = np.reshape(y, (2, -1))
        shapes = np.column_stack([np.exp(slope), shift])
        rows = rows_of(Model(self.robot, (LinearisedSigmoid(self.robot, shapes),)))
        return np.stack([c.columns for c in rows.columns], axis=1)

    def columns(self, y: Array, weights: Array) -> tuple[Array, Array]:
        """Return the weighted columns of the base parameters and phi_1 (M n, b + n), and
        those of log phi_2 and phi_3 (M n, 2 n) at phi_1 = 1."""
        n = self.robot.n
        # (M, n, 3, n): phi of a joint acts on it alone.
        own = self.sigmoid(tuple(y))[:, :, :, None] * np.eye(n)[:, None]
        linear = np.concatenate([self.rigid, own[:, :, 0]], axis=2)
        shapes = np.concatenate([own[:, :, 1], own[:, :, 2]], axis=2)
        size = (len(self.torque) * n, -1)
        weight = weights[:, None]
        return (linear * weight).reshape(size), (shapes * weight).reshape(size)

    def projected(self, y: Array, weights: Array) -> tuple[Array, Array, Array]:
        """Solve for base parameters and phi_1 at log phi_2 and phi_3 (variable
        projection: Golub, Pereyra 1973; Kaufman's derivative, BIT 1975).

        Returns
        -------
        tuple
            Weighted residual (M n,) [N m], its derivative by y (M n, 2 n), and the
            solution (b + n,).
        """
        linear, shapes = self.columns(y, weights)
        Q, R = np.linalg.qr(linear)
        torque = (self.torque * weights).ravel()
        x = np.linalg.lstsq(R, Q.T @ torque, rcond=None)[0]
        slopes = shapes * np.tile(x[-self.robot.n :], 2)
        return torque - linear @ x, Q @ (Q.T @ slopes) - slopes, x


def residual_rms(problem: Problem, parts: Sequence[RowsOf], fit: SigmoidFit) -> Array:
    """Return the RMS residual (n,) [N m] of a fit on other rows; ``parts`` are
    functions from a model to its rows, one for each run, which count together."""
    amplitude, slope, shift = fit.phi.T  # phi_1, phi_2, phi_3 of the n joints
    shapes = tuple(np.append(np.log(slope), shift))
    residuals = []  # (M, n) of each run
    for rows_of in parts:
        data = _Data(problem, rows_of)
        friction_at_one, *_derivatives = np.moveaxis(data.sigmoid(shapes), 2, 0)
        friction = amplitude * friction_at_one
        residuals.append(data.torque - data.rigid @ fit.pi - friction)
    return np.sqrt(np.mean(np.concatenate(residuals) ** 2, axis=0))


@register_table("I", "panda")
def sigmoid_friction(study: Study) -> StudyTable:
    """Table I: the sigmoid friction of every joint, published and fitted.

    Rows: phi_1..phi_3 published and fitted, each with its interval; then errors
    on other rows.
    """
    truth = study.experiment.friction
    assert truth is not None
    rows: list[Row] = [
        {**row, "what": "published", "covered_percent": None}
        for row in study.problem.published["table_I"]
    ]
    exact = _fit_without_noise(study)
    rows += _rows_of("simulated, without noise", exact, ends=False)
    # Runs that differ in their noise show how often the intervals hold the truth.
    fits = []
    count = study.effort.replicates
    for k in range(count):
        study.progress(f"sigmoid friction: simulated run {k + 1} of {count}")
        run = study.simulated.train
        if k > 0:
            run = study.experiment.training_run(study.seed + k)
        fits.append(_fit(study, study.simulated, run))
    holds = [(f.lower <= truth) & (truth <= f.upper) for f in fits]
    # Of the intervals of phi_1, phi_2, phi_3, over joints and fits.
    share = np.mean(holds, axis=(0, 1))
    rows += _rows_of("simulated", fits[0], 100.0 * share)
    n_intervals = len(fits) * study.problem.robot.n
    steps = {"simulated": _steps("simulated", fits[0]), "measured": ""}
    if study.measured is not None:
        study.progress("sigmoid friction of the real run")
        fit = _fit(study, study.measured, study.measured.train)
        rows += _rows_of("measured", fit)
        steps["measured"] = _steps("measured", fit)
    for data in study.judged:
        what = f"{data.label}, RMSE on {data.judged_on}"
        for name, errors in _on_other_rows(study, data):
            rows.append(_row(name, errors, "N*m", what))
    table_notes = notes(
        "I",
        count=len(fits),
        intervals=n_intervals,
        # Half width [%] of the 95 % range of a share counted from so many intervals.
        expected=196.0 * float(np.sqrt(0.95 * 0.05 / n_intervals)),
        **steps,
    )
    title = f"Table I: sigmoid friction of {study.problem.title}"
    return StudyTable(title, rows, table_notes, digits=5)


def _fit_without_noise(study: Study) -> SigmoidFit:
    """Fit the sigmoid to the exact torque along the exciting trajectory."""
    study.progress("sigmoid friction without noise")
    x = study.experiment
    t = np.arange(0.0, x.trajectory.duration, 0.05)
    motion = Motion(t, *x.trajectory.states(t))
    return fit_sigmoid(study.problem, exact_rows(motion, x.torque(motion)))


def _row(
    name: str, joints: Array, unit: str, what: str, covered: float | None = None
) -> Row:
    """Return a row of the table: one parameter of all joints.

    covered : share of intervals that hold the truth [%].
    """
    about = {"unit": unit, "what": what, "covered_percent": covered}
    return {"parameter": name, **by_joint(joints), **about}


def _rows_of(
    what: str, fit: SigmoidFit, covered: Array | None = None, ends: bool = True
) -> list[Row]:
    """Return the table's rows of phi_1, phi_2 and phi_3, each with the ends of its 95 %
    interval if ``ends``.

    - ``what``: data of the fit, such as "simulated".
    - ``covered``: (3,) share of intervals that hold the truth [%].
    """
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
    """Return a note on the joints whose friction jumps like a step; "" if there are
    none.
    """
    joints = ", ".join(map(str, np.flatnonzero(fit.at_bound) + 1))
    why = (
        "phi_2 ran to the end of its range: the data want a step, and the interval"
        " means nothing."
    )
    return f"{what}: on joint(s) {joints} {why}" if joints else ""


def _rows_in(data: Data, run: Measurements) -> RowsOf:
    """Return a function from a model to its rows (torque = columns times parameters) of
    a run behind a data set's filters."""
    return lambda model: FilteredRun(run, data.preprocessing).all_rows(model)


def _fit(study: Study, data: Data, run: Measurements) -> SigmoidFit:
    """Fit sigmoid friction and base parameters to one run behind a data set's
    filters.
    """
    repeats = FilteredRun(run, data.preprocessing).rows_per_sample
    return fit_sigmoid(study.problem, _rows_in(data, run), repeats)


def _on_other_rows(study: Study, data: Data) -> list[tuple[str, Array]]:
    """Return name and RMS error (n,) on the test rows of three friction models.

    They are linear friction, sigmoid friction, and presliding hysteresis with the
    travel d that fits the training rows best.
    """
    assert data.test is not None
    study.progress(f"friction models on {data.label} data, {data.judged_on}")
    usual = "rigid_body,viscous_friction,coulomb_friction,torque_offset"

    def with_effects(effects: str) -> Data:
        """Return the same rows in a model of these effects."""
        return replace(data, model=study.problem.model(effects))

    def ordinary(modelled: Data) -> tuple[float, Array]:
        """Return training loss and parameters of ordinary least squares."""
        train = modelled.regression.least_squares()
        theta = np.asarray(np.linalg.lstsq(train.R, train.rho, rcond=1e-10)[0], float)
        return train.loss(theta), theta

    def test_rmse(modelled: Data) -> Array:
        """Return the RMS error (n,) of ordinary least squares on the test rows."""
        return np.sqrt(modelled.errors(ordinary(modelled)[1])[0])

    fit = _fit(study, data, data.train)
    bristles = {
        d: with_effects(f"{usual},presliding_hysteresis@d={d}")
        for d in PreslidingHysteresis.shapes["d"].grid
    }
    best = min(bristles, key=lambda d: ordinary(bristles[d])[0])
    others = [_rows_in(data, run) for run in data.test.runs()]
    return [
        ("linear friction", test_rmse(with_effects(usual))),
        ("sigmoid friction", residual_rms(study.problem, others, fit)),
        (f"presliding hysteresis (d = {best:g} rad)", test_rmse(bristles[best])),
    ]
