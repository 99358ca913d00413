"""What an estimator is given and what it must return.

A file in this folder that defines subclasses of :class:`Estimator` is their
registration. An estimator sees compressed data and constraints as arrays; it knows
neither files nor robots.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError, require_known
from sdp_vs_penalty.problem.constants import FAR_MASS
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import BaseParameters, base_rows
from sdp_vs_penalty.regression.linalg import min_norm_lstsq, span
from sdp_vs_penalty.regression.regression import LeastSquares, Regression
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask
from sdp_vs_penalty.robot.body import Body
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet
from sdp_vs_penalty.solvers.convex_problem import ConvexProblem
from sdp_vs_penalty.solvers.fit import Fit as Fit

#: Called with a short text of where a long computation stands.
Progress = Callable[[str], None]


def no_progress(_: str) -> None:
    """Report nothing: the default of progress callbacks.

    Parameters
    ----------
    _ : str
        A line about the progress.
    """


@dataclass(frozen=True)
class Task:
    """One identification problem, ready for any estimator.

    A known parameter (:attr:`Model.known`) is an equality: its value stands in the data
    and in the constraints, which are of the others, and one observation of its own
    holds it.
    """

    #: Model of the torque, with p parameters.
    model: Model
    #: The (weighted) least-squares problem in all parameters theta (p,).
    data: LeastSquares
    #: What the problem demands.
    constraints: ConstraintSet
    #: (p,) implied bounds on |theta|.
    bound: Array
    #: (p,) a strictly consistent theta that the problem knows beforehand.
    nominal: Array
    #: (n, 10, 2) barycentric bounds of each link.
    box: Array
    #: Names of the base parameters to use; None: a QR factorisation chooses them.
    independent: tuple[str, ...] | None = None
    #: Seed of random methods.
    seed: int = 0
    #: Receives a line of text at each stage.
    progress: Progress = no_progress
    #: (p,) the value of a joint's own parameter (friction, offset, ...) that alone
    #: would make the torque of that joint in these data; infinite for the links'
    #: parameters.
    joint_scale: Array | None = None
    #: Body of each link, in which its mass lies.
    link_bodies: tuple[Body, ...] = ()
    #: (n, 10) the nominal links, those of a guessed mass at the scale that the torque
    #: proves; None: as in nominal.
    prior: Array | None = None
    #: Mass of the nominal links [kg] where a file or bounds state it, else None.
    total: float | None = None
    #: (n,) weights of the joints' rows in data, for intervals.
    weights: Array = field(default_factory=lambda: np.ones(0))

    @property
    def problem(self) -> ConvexProblem:
        """The loss over the constraints, without a prior."""
        return ConvexProblem(self.data, self.constraints, self.bound)

    @property
    def prior_links(self) -> Array:
        """(n, 10) standard parameters of the links about which the prior is centred."""
        return self.nominal[self.links] if self.prior is None else self.prior

    @cached_property
    def links(self) -> Indices:
        """(n, 10) indices of each link's parameters in theta; (0, 10) without rigid
        links.
        """
        return self.model.rigid_indices.reshape(-1, 10)

    @cached_property
    def bodies(self) -> tuple[Constraint, ...]:
        """One constraint a link: its mass lies inside of its body's ellipsoid."""
        pairs = zip(self.links, self.link_bodies, strict=False)
        bodies = tuple(
            build.density_in_ellipsoid(
                "body", name=f"link {k}", indices=indices, quadric=body.quadric
            )
            for k, (indices, body) in enumerate(pairs, start=1)
        )
        return ConstraintSet(bodies).with_known(self.model.known_values).convex

    @property
    def pseudo_inertias(self) -> tuple[Constraint, ...]:
        """Pseudo-inertia constraints of the robot's links, whose log det the prior
        contains.

        The pseudo-inertia of a body that an effect adds (a payload) is left out.
        """
        bodies = (c for c in self.constraints.convex if c.family == "pseudo-inertia")
        return tuple(c for c in bodies if c.indices[0] in self.links[:, 0])

    @property
    def prior_inertias(self) -> Array:
        """(links, 4, 4) nominal pseudo-inertias of the links of ``pseudo_inertias``."""
        number = {int(first): k for k, first in enumerate(self.links[:, 0])}
        links = [number[int(c.indices[0])] for c in self.pseudo_inertias]
        return inertia.pseudo_inertia(self.prior_links[links])

    @cached_property
    def base(self) -> BaseParameters:
        """The combinations of theta that make torque: the links' base parameters first,
        then all other parameters one by one."""
        return base_rows(self.model, self.independent)

    @cached_property
    def ols(self) -> Array:
        """(p,) unconstrained least-squares theta that is nearest to the nominal one."""
        return self.model.with_known(self.data.nearest(self.nominal))

    @cached_property
    def base_distance(self) -> LeastSquares:
        """Least-squares problem |pi(theta) - pi_hat|^2, with pi_hat the OLS base
        parameters.

        Units are those of the base parameters. The two-step methods minimise it: the
        paper's retrieval, and Sousa and Cortesao's beta'.
        """
        target = self.base.rows @ self.ols
        return LeastSquares(
            self.base.rows,
            rho=target,
            residual_norm=0.0,
            tau_squared=float(target @ target),
            rows=len(target),
        )

    def minimum_thickness(self, radius: float) -> list[Constraint]:
        """Return constraints that keep the links from becoming rods or plates of zero
        thickness.

        They are Sigma_c >= m r^2 1, with the second moments Sigma_c (3, 3) about the
        centre of mass [kg m^2] and the mass m of each link.

        Parameters
        ----------
        radius : float
            Smallest radius of gyration r [m]; 0: no constraints.
        """
        if not radius > 0.0:
            return []
        thick = tuple(
            build.pseudo_inertia(f"link {k}", indices, radius)
            for k, indices in enumerate(self.links, start=1)
        )
        return list(ConstraintSet(thick).with_known(self.model.known_values).convex)


class Estimator(ABC):
    """One way from a Task to parameters. Subclasses are frozen dataclasses of their
    settings."""

    name: ClassVar[str]
    description: ClassVar[str]
    #: True where the method is defined on a black box's answers only.
    needs_black_box: ClassVar[bool] = False
    #: True where the method minimises a loss whose optimum its fit bounds: identify
    #: refuses a fit of which nothing is proved.
    proves_optimum: ClassVar[bool] = False
    #: Place among the columns of Tables III, VII, VIII, IX and the rows of IV; None:
    #: not one of them. Every method has its rows in the table of methods.
    table_place: ClassVar[int | None] = None

    @property
    def undetermined_by(self) -> str:
        """What decides parameters that the data do not: the "prior", or else the
        "bounds".
        """
        return "bounds"

    @abstractmethod
    def fit(self, task: Task) -> Fit:
        """Estimate the parameters of a task.

        Parameters
        ----------
        task : Task
            Data, model, constraints and priors.

        Returns
        -------
        Fit
            The estimate with its certificate.

        Raises
        ------
        InputError
            Where the constraints admit no parameters.
        """

    def fit_each(self, tasks: Sequence[Task]) -> list[Fit]:
        """Estimate the parameters of tasks that differ in their data alone."""
        return [self.fit(task) for task in tasks]


def fitted(estimator: Estimator, task: Task) -> Fit:
    """Estimate the parameters of a task by a method, which anyone may have written.

    Raises
    ------
    InputError
        If the method returns no Fit, or no p finite parameters.
    """
    fit = estimator.fit(task)
    who, p = f"method {estimator.name}", len(task.bound)
    if not isinstance(fit, Fit):
        what = f"{who} returned {type(fit).__name__}, no Fit"
        raise InputError(what, "return Fit(theta, task.problem)")
    if np.shape(fit.theta) != (p,):
        what = f"{who} returned theta of the shape {np.shape(fit.theta)}"
        raise InputError(what, f"return ({p},), one number a parameter of task.model")
    if not np.isfinite(fit.theta).all():
        k = int(np.argmin(np.isfinite(fit.theta)))
        what = f"{who} returned {fit.theta[k]} for {task.model.parameters[k].name}"
        raise InputError(what, "return finite numbers; task.ols and task.nominal are")
    return fit


def require_proof(estimator: Estimator, fit: Fit) -> None:
    """Raise InputError if a method that bounds its optimum has proved nothing of a fit.

    The loss is not negative, so that a gap of one says nothing.
    """
    if estimator.proves_optimum and not fit.gap < 1.0:
        raise unsolved(
            f"the optimum was not found: loss {fit.upper:.2g}, proved is nothing"
        )


def unsolved(what: str) -> InputError:
    """Return the error of a problem that has a solution, which was not found."""
    return InputError(
        what,
        "check the units of the robot, of lengths in mm first (`sdp-vs-penalty"
        " check-urdf URDF --fix`), and those of the measurements; if they are right,"
        " choose another method or solver",
    )


def make_task(
    problem: Problem,
    model: Model,
    regression: Regression,
    weighting: str = "noise",
    seed: int = 0,
    progress: Progress = no_progress,
) -> Task:
    """Build the input of an estimator from a problem and compressed measurements.

    Parameters
    ----------
    problem : Problem
        Robot, bounds and nominal links.
    regression : Regression
        Compressed rows in the model's columns.
    weighting : str
        "noise": weight joints by the residuals of a first least-squares fit; "none".
    progress : callable
        Receives a line of text at each stage.

    Returns
    -------
    Task
        Data, constraints and prior as arrays.
    """
    links = model.rigid_indices.reshape(-1, 10)
    nominal = problem.nominal(model)
    nominal[links] = _prior_links(problem, model)
    nominal = model.with_known(nominal)
    bound = problem.parameter_bound(model)
    for k, value in model.known_values.items():
        bound[k] = max(bound[k], abs(value)) or 1.0
    require_known("weighting", weighting, ("noise", "none"))

    data, weights, first = weighted_by_residuals(regression, model, nominal, weighting)
    data = _with_known(data, model, bound)
    guessed = problem.guessed_links
    return Task(
        model=model,
        data=data,
        constraints=problem.constraints(model).with_known(model.known_values),
        bound=bound,
        nominal=nominal,
        box=problem.box,
        independent=problem.independent,
        seed=seed,
        progress=progress,
        joint_scale=joint_scale(regression, model, first),
        link_bodies=problem.link_bodies,
        prior=_scaled_prior(data, _prior_links(problem, model), links, guessed),
        total=None if np.any(guessed) else float(nominal[links[:, 0]].sum()),
        weights=weights,
    )


def _prior_links(problem: Problem, model: Model) -> Array:
    """Return (n, 10) nominal links within their bounds of mass, those whose mass is
    known scaled to it; none without links.

    Other known values leave them: the entropic pull is then that on what is free.
    """
    places = model.rigid_indices.reshape(-1, 10)
    links = problem.prior_links[: len(places)].copy()
    for link, k in zip(links, places[:, 0].tolist(), strict=True):
        if k in model.known_values:
            link *= model.known_values[k] / link[0]
    return links


def _with_known(data: LeastSquares, model: Model, bound: Array) -> LeastSquares:
    """Return data whose optimum has the known parameters at their values.

    In ``data`` the torque of the known ones is subtracted already, and their columns are
    zero. So the terms |tau|^2 ((theta_k - value_k) / bound_k)^2 that are added here
    alone decide these theta_k, and are zero at the optimum. ``bound`` (p,) is their
    scale.
    """
    if not model.known_values:
        return data
    places = list(model.known_values)
    rows = np.zeros((len(places), len(bound)))
    rows[np.arange(len(places)), places] = 1.0 / bound[places]
    values = np.array(list(model.known_values.values())) / bound[places]
    return data.with_observations(rows, values, weight=data.tau_squared or 1.0)


def weighted_by_residuals(
    regression: Regression,
    model: Model,
    near: Array | float = 0.0,
    weighting: str = "noise",
) -> tuple[LeastSquares, Array, Array]:
    """Return the data with each joint weighted by its residual in a first fit.

    Parameters
    ----------
    near : (p,) array
        Where parameters that the data do not determine stay in that fit [SI].
    weighting : str
        "noise", or "none": all joints weigh the same.

    Returns
    -------
    LeastSquares
        In the columns of the model. Those of known parameters are zero, and their
        torque is subtracted; what is plausible of others is observed.
    Array
        (n,) factors of the joints' rows.
    Array
        (p,) parameters of the first fit, by least squares with equal weights [SI].
    """

    def observed(weights: Array) -> LeastSquares:
        """Return the data with these weights of the joints, and what is known."""
        data = regression.least_squares(weights)
        if model.known_values:
            data = data.given(model.known_values)
        # What effects know of their parameters weighs as much as an independent row
        # each.
        if not np.isfinite(model.plausible).any():
            return data
        variance = data.residual_norm**2 / max(data.rows - data.R.shape[1], 1)
        return data.with_prior(model.plausible, regression.oversampling * variance)

    weights = np.ones(regression.joints)
    data = observed(weights)
    first = model.with_known(data.nearest(near))
    if weighting == "noise":
        weights = joint_weights(regression, first)
        data = observed(weights)
    return data, weights, first


def _scaled_prior(
    data: LeastSquares, links: Array, places: Indices, guessed: Mask
) -> Array:
    """Return (n, 10) nominal ``links``, with guessed masses scaled to the measured
    torque.

    One common factor is found by least squares, with the joints' own parameters free
    and the other links as stated. A factor above 1 is used: the torque proves more
    mass. A smaller one proves nothing, since mass may lie nearer to the axes, so that
    it is used only below 1 / FAR_MASS.

    ``places`` (n, 10) are the links' indices in theta, ``guessed`` (n,) marks links
    whose mass no file states.
    """
    if not len(links) or not np.any(guessed):
        return links
    R = data.R
    other_columns = np.setdiff1d(np.arange(R.shape[1]), places)
    stated = R[:, places[~guessed].ravel()] @ links[~guessed].ravel()
    guess = R[:, places[guessed].ravel()] @ links[guessed].ravel()
    columns = np.column_stack([guess, R[:, other_columns]])
    factor = min_norm_lstsq(columns, data.rho - stated)[0]
    out = links.copy()
    is_far_too_heavy = 0.0 < factor < 1.0 / FAR_MASS
    if factor > 1.0 or is_far_too_heavy:
        out[guessed] *= factor
    return out


def joint_scale(regression: Regression, model: Model, theta: np.ndarray) -> np.ndarray:
    """Return the scale |tau_j| / |Y_jk| of each joint parameter k.

    It is the value with which the parameter alone would make the torque of its joint.

    Parameters
    ----------
    regression : Regression
        Compressed columns Y and torque tau.
    theta : (p,) array
        First least-squares fit. The torque of servos counts if it is larger than the
        measured one (which is zero in a log without torque).

    Returns
    -------
    (p,) array
        Scales; infinite for parameters of links and of servos, and without a column.
    """
    norms = regression.column_norms()
    of_servos = regression.torque_norms(np.where(model.drives, theta, 0.0))
    torque = np.maximum(norms[:, -1], of_servos)[:, None]  # (n, 1)
    counts = (norms[:, :-1] > 0.0) & (torque > 0.0)
    counts[:, model.rigid_indices] = False
    # Servos' terms cancel: each is many times as large as their sum.
    counts[:, model.drives] = False
    scale = np.full(counts.shape, np.inf)
    np.divide(torque, norms[:, :-1], out=scale, where=counts)
    return np.asarray(scale.min(axis=0))


def joint_weights(regression: Regression, theta: np.ndarray) -> np.ndarray:
    """Return weights sigma / sigma_j that give all joints the same noise, by a first
    least-squares fit theta (p,) [SI].

    Returns
    -------
    (n,) array
        Factor of each joint's rows; sigma is the root mean square of all sigma_j.
    """
    variance = residual_variances(regression, theta)
    if not np.any(variance > 0.0):
        return np.ones(len(variance))
    variance = np.maximum(variance, 1e-12 * variance.max())
    return np.sqrt(variance.mean() / variance)


def residual_variances(regression: Regression, theta: Array) -> Array:
    """Return the mean squares (n,) of the joints' residuals with theta (p,) [SI].

    A residual below 1e-6 of a joint's torque counts as that much, so that noise-free data
    are not judged by rounding.
    """
    rows = np.maximum(regression.joint_rows(), 1)
    torque = regression.column_norms()[:, -1]
    return np.maximum(regression.joint_losses(theta), 1e-12 * torque**2) / rows


def with_joint_prior(task: Task, weight: float) -> Task:
    """Return the task with a prior that pulls the joints' own parameters to zero.

    Parameters
    ----------
    weight : float
        Cost, in residual variances of one row, of a parameter that alone makes its
        joint's torque (:attr:`Task.joint_scale`); 0: no prior.

    Returns
    -------
    Task
        With the prior as further rows of its data.
    """
    if task.joint_scale is None or weight == 0.0:
        return task
    return replace(
        task,
        data=task.data.with_prior(task.joint_scale, weight * sample_variance(task)),
    )


def sample_variance(task: Task) -> float:
    """Return the residual variance of one filtered row in unconstrained least squares.

    Returns
    -------
    float
        Variance [(N m)^2], with the joints' weights of the task.
    """
    return task.data.loss(task.ols) / max(task.data.rows, 1)


def white_variance(data: LeastSquares, oversampling: float) -> float:
    """Return the variance sigma^2 [(N m)^2] by which sigma^2 (R'R)^-1 is the covariance
    of least squares, if the noise is white before the filter.

    Behind the filter, ``oversampling`` = s neighbouring rows say what one independent
    row says, and R'R counts each of them: sigma^2 is s times the variance of a row.
    M rows are M / s independent ones, of which p parameters take p: the sum of squares
    has M - s p degrees of freedom.
    """
    U = span(data.R)  # (r, p) orthonormal
    # What no theta explains: a part of rho, and what compression has put apart.
    unexplained = data.rho - U @ (U.T @ data.rho)
    squared_error = float(unexplained @ unexplained) + data.residual_norm**2
    degrees_of_freedom = max(data.rows - oversampling * U.shape[1], 1.0)
    variance_of_row = squared_error / degrees_of_freedom
    return oversampling * variance_of_row
