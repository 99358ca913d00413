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
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.bristles import PreslidingHysteresis
from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.paper.tables.study import Data, Study
from sdp_vs_penalty.paper.tables.table import (
    Row,
    Table,
    by_joint,
    notes,
    register_table,
)
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_parameters
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
        """Set the point of one step of the fit.

        shapes : (n, 2) phi_2 [s/rad] and phi_3 [rad/s] of each joint.
        """
        super().__init__(robot)
        self.slopes_and_shifts = shapes

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """For each joint phi_1, and the steps of phi_2 and phi_3."""
        return tuple(
            Parameter(f"sigmoid{k}_{j + 1}", "", self.name, j + 1)
            for j in range(self.robot.n)
            for k in range(3)
        )

    def blocks(self, motion: Motion) -> list[Block]:
        """Return the columns of the friction torque and of its derivatives.

        With s(v) = 1 / (1 + exp(-phi_2 (v + phi_3))) they are f / phi_1 = s(dq) - s(0),
        and its derivatives by phi_2 and phi_3.

        Returns
        -------
        list of Block
            Three columns (N, 3) for each joint.
        """
        blocks = []
        for j, (slope, shift) in enumerate(self.slopes_and_shifts):
            moving = scipy.special.expit(slope * (motion.dq[:, j] + shift))  # s(dq)
            at_rest = scipy.special.expit(slope * shift)  # s(0)
            d_moving = moving * (1.0 - moving)
            d_rest = at_rest * (1.0 - at_rest)
            by_slope = d_moving * (motion.dq[:, j] + shift) - d_rest * shift
            by_shift = slope * (d_moving - d_rest)
            columns = np.column_stack([moving - at_rest, by_slope, by_shift])
            blocks.append(Block(j, 3 * j + np.arange(3), columns))
        return blocks


@dataclass(frozen=True)
class SigmoidFit:
    """Sigmoid friction phi of n joints, fitted with b base parameters."""

    #: (b + 3 n,) base parameters pi (b,), then phi_1, log phi_2 and phi_3 of the
    #: joints.
    x: Array
    #: (n, 3) friction parameters.
    phi: Array
    #: (n, 3) standard deviations of phi.
    std: Array
    #: (n, 3) lower ends of the 95 % intervals.
    lower: Array
    #: (n, 3) upper ends of the 95 % intervals.
    upper: Array
    #: (n,) whether phi_2 ran into the end of its range, a step, whose interval means
    #: nothing.
    at_bound: NDArray[np.bool_]


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
    weights = np.ones(problem.robot.n)
    solved = [data.solved(data.start(slope), weights) for slope in START_SLOPES]
    x = min(solved, key=lambda x: float(np.sum(data.residual(x) ** 2)))
    for _ in range(2):
        x = _least_squares(data, x, weights)
        weights = data.weights(x)
    return _with_intervals(data, data.solved(x, weights), weights, oversampling)


def _least_squares(data: "_Data", x: Array, weights: Array) -> Array:
    """Return the x (b + 3 n,) with the smallest weighted residual within the ranges of
    phi.

    x holds base parameters, phi_1, log phi_2 and phi_3; the search starts at x.
    """
    solution = scipy.optimize.least_squares(
        lambda x: (data.residual(x) * weights).ravel(),
        x,
        lambda x: -data.weighted_columns(x, weights),
        bounds=data.bounds,
        x_scale="jac",
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
        max_nfev=100,
    )
    return np.asarray(solution.x)


def _with_intervals(
    data: "_Data", x: Array, weights: Array, oversampling: float
) -> SigmoidFit:
    """Return phi with standard deviations and 95 % intervals, from the Jacobian J of
    the fit with weights (n,) of the joints.

    The covariance of x is sigma^2 (J^T J)^-1, with sigma^2 the squared residuals over
    the degrees of freedom.

    Parameters
    ----------
    x : (b + 3 n,) array
        The fit: base parameters, phi_1, log phi_2, phi_3.
    oversampling : float
        Number of rows that repeat each other. J^T J counts each of them; the degrees of
        freedom count one.
    """
    n = len(weights)
    jacobian = data.weighted_columns(x, weights)
    norms = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / norms
    squares = float(np.sum((data.residual(x) * weights) ** 2))
    degrees = max(data.torque.size / oversampling - len(x), 1.0)
    inverse = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
    deviations = np.sqrt(squares / degrees * np.diagonal(inverse)) / norms
    phi = x[-3 * n :].reshape(3, n).T.copy()
    phi[:, 1] = np.exp(phi[:, 1])
    std = deviations[-3 * n :].reshape(3, n).T.copy()
    # Of phi_2, from that of its logarithm.
    std[:, 1] *= phi[:, 1]
    # Student's t; scipy.stats would take half a second to import.
    half = scipy.special.stdtrit(degrees, 0.975) * std
    at_bound = phi[:, 1] > 0.99 * STEEPEST
    return SigmoidFit(x, phi, std, phi - half, phi + half, at_bound)


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
        self.rows_of = rows_of
        self.torque = rows.torque
        size = len(model.parameters)
        wide = np.stack([c.dense_columns(size) for c in rows.columns], axis=1)
        _, independent = base_parameters(model, problem.independent)
        self.rigid = wide[:, :, list(independent)]
        # Of the last slopes and shifts: residual and Jacobian are asked at the same x.
        self._last_shape = np.empty(0)
        self._last_columns = np.empty(0)

    def start(self, slope: float) -> Array:
        """Return the point from which a search starts: zeros but for the slopes.

        Parameters
        ----------
        slope : float
            phi_2 of every joint [s/rad].

        Returns
        -------
        (b + 3 n,) array
            Base parameters, phi_1, log phi_2 and phi_3.
        """
        n = self.robot.n
        linear = np.zeros(self.rigid.shape[2] + n)
        return np.concatenate([linear, np.full(n, np.log(slope)), np.zeros(n)])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds (b + 3 n,) of x = (base parameters, phi_1, log phi_2,
        phi_3).

        Base parameters and phi_1 are free; slopes phi_2 lie between FLATTEST and
        STEEPEST [s/rad], shifts phi_3 within +-LARGEST_SHIFT [rad/s].
        """
        n = self.robot.n
        free = np.full(self.rigid.shape[2] + n, np.inf)
        shift = np.full(n, LARGEST_SHIFT)
        low = np.concatenate([-free, np.full(n, np.log(FLATTEST)), -shift])
        high = np.concatenate([free, np.full(n, np.log(STEEPEST)), shift])
        return low, high

    def weights(self, x: Array) -> Array:
        """Return the weight of each joint: the inverse of its residual, with mean
        logarithm zero.

        A residual below rounding (1e-12 of the largest torque) is raised to it.

        Parameters
        ----------
        x : (b + 3 n,) array
            Base parameters, phi_1, log phi_2 and phi_3.

        Returns
        -------
        (n,) array
        """
        rounding = 1e-12 * float(np.abs(self.torque).max())
        rms = np.sqrt(np.mean(self.residual(x) ** 2, axis=0)) + rounding
        return np.asarray(np.exp(np.mean(np.log(rms))) / rms)

    def weighted_columns(self, x: Array, weights: Array) -> Array:
        """Return the derivative of the weighted torque of all rows by x, with weights
        (n,) of the joints.

        Parameters
        ----------
        x : (b + 3 n,) array
            Base parameters, phi_1, log phi_2 and phi_3.

        Returns
        -------
        (M n, b + 3 n) array
        """
        weighted = self.columns(x) * weights[:, None]  # (M, n, b + 3 n)
        return weighted.reshape(-1, len(x))

    def columns(self, x: Array) -> Array:
        """Return the derivative of the torque of all rows by x.

        Parameters
        ----------
        x : (b + 3 n,) array
            Base parameters, phi_1, log phi_2 and phi_3.

        Returns
        -------
        (M, n, b + 3 n) array
        """
        n_base = self.rigid.shape[2]
        amplitude, log_slope, _ = x[n_base:].reshape(3, -1)
        slope = np.exp(log_slope)
        # Derivatives of phi_1 (f / phi_1), by the chain rule for log phi_2.
        ones = np.ones_like(slope)
        scale = np.stack([ones, amplitude * slope, amplitude], axis=1)
        of_joints = self.sigmoid_columns(x) * scale
        # (M, n, 3) becomes three blocks (M, n, n): phi of a joint acts on it alone.
        same_joint = np.eye(len(slope))
        blocks = [of_joints[:, :, k, None] * same_joint for k in range(3)]
        return np.concatenate([self.rigid, *blocks], axis=2)

    def sigmoid_columns(self, x: Array) -> Array:
        """Return each joint's friction per phi_1, and its derivatives by phi_2 and
        phi_3 per phi_1.

        Parameters
        ----------
        x : (b + 3 n,) array
            Base parameters, phi_1, log phi_2 and phi_3.

        Returns
        -------
        (M, n, 3) array
        """
        n = self.robot.n
        if not np.array_equal(x[-2 * n :], self._last_shape):
            slope, shift = np.exp(x[-2 * n : -n]), x[-n:]
            sigmoid = SigmoidFriction(self.robot, np.column_stack([slope, shift]))
            rows = self.rows_of(Model(self.robot, (sigmoid,)))
            self._last_columns = np.stack([c.columns for c in rows.columns], axis=1)
            self._last_shape = x[-2 * n :].copy()
        return self._last_columns

    def residual(self, x: Array) -> Array:
        """Return the measured minus the modelled torque (M, n) [N m].

        The model is linear in the base parameters and phi_1; phi_2 and phi_3 enter
        through their columns.

        Parameters
        ----------
        x : (b + 3 n,) array
            Base parameters, phi_1, log phi_2 and phi_3.
        """
        n_base = self.rigid.shape[2]
        amplitude = x[n_base : n_base + self.robot.n]
        friction = self.sigmoid_columns(x)[:, :, 0] * amplitude
        return np.asarray(self.torque - self.rigid @ x[:n_base] - friction)

    def solved(self, x: Array, weights: Array) -> Array:
        """Return x with the best base parameters and phi_1 for its phi_2 and phi_3,
        with weights (n,) of the joints.

        They solve a linear least-squares problem.

        Parameters
        ----------
        x : (b + 3 n,) array
            Base parameters, phi_1, log phi_2 and phi_3.

        Returns
        -------
        (b + 3 n,) array
        """
        linear = len(x) - 2 * self.robot.n
        columns = self.weighted_columns(x, weights)[:, :linear]
        target = (self.torque * weights).ravel()
        out = x.copy()
        out[:linear] = np.linalg.lstsq(columns, target, rcond=None)[0]
        return out


def residual_rms(problem: Problem, parts: Sequence[RowsOf], fit: SigmoidFit) -> Array:
    """Return the RMS residual (n,) [N m] of a fit on other rows; ``parts`` are
    functions from a model to its rows, one for each run, which count together."""
    residuals = [_Data(problem, rows_of).residual(fit.x) for rows_of in parts]
    return np.asarray(np.sqrt(np.mean(np.concatenate(residuals) ** 2, axis=0)))


@register_table("I", "panda")
def sigmoid_friction(study: Study) -> Table:
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
    fits = _fits_with_noise(study)
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
    return Table(title, rows, table_notes, digits=5)


def _fit_without_noise(study: Study) -> SigmoidFit:
    """Fit the sigmoid to the exact torque along the exciting trajectory."""
    study.progress("sigmoid friction without noise")
    x = study.experiment
    t = np.arange(0.0, x.trajectory.duration, 0.05)
    motion = Motion(t, *x.trajectory.states(t))
    return fit_sigmoid(study.problem, exact_rows(motion, x.torque(motion)))


def _fits_with_noise(study: Study) -> list[SigmoidFit]:
    """Fit the sigmoid to simulated runs that differ in their noise.

    They show how often the intervals hold the truth.
    """
    fits = []
    count = study.effort.replicates
    for k in range(count):
        study.progress(f"sigmoid friction: simulated run {k + 1} of {count}")
        run = study.simulated.train
        if k > 0:
            run = study.experiment.training_run(study.seed + k)
        fits.append(_fit(study, study.simulated, run))
    return fits


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

    what : data of the fit, such as "simulated". covered : (3,) share of intervals that
    hold the truth [%].
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
    sentences = (
        "phi_2 ran to the end of its range: the data want a step, and the interval"
        " means nothing."
    )
    return f"{what}: on joint(s) {joints} {sentences}" if joints else ""


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
        """The same rows in a model of these effects."""
        return replace(data, model=study.problem.model(effects))

    def ordinary(modelled: Data) -> tuple[float, Array]:
        """Training loss and parameters of ordinary least squares."""
        train = modelled.regression.least_squares()
        theta = np.asarray(np.linalg.lstsq(train.R, train.rho, rcond=1e-10)[0], float)
        return train.loss(theta), theta

    def test_rmse(modelled: Data) -> Array:
        """RMS error (n,) of ordinary least squares on the test rows."""
        return np.asarray(np.sqrt(modelled.errors(ordinary(modelled)[1])[0]))

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
