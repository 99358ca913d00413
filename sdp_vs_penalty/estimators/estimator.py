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
from numpy.typing import NDArray

from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import require_known
from sdp_vs_penalty.problem.constants import FAR_MASS
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_parameters
from sdp_vs_penalty.regression.linalg import min_norm_lstsq, span
from sdp_vs_penalty.regression.regression import LeastSquares, Regression
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet
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

    data : the (weighted) least-squares problem in all parameters theta (p,).
    constraints : what the problem demands; bound : (p,) implied bounds on |theta|.
    nominal : (p,) a strictly consistent theta that the problem knows beforehand.
    box : (n, 10, 2) barycentric bounds of each link; weights : (n,) of the joints' rows in data, for
        intervals.
    independent : names of the base parameters to use, or None.
    bodies : one constraint a link, that its mass lies inside of its body; prior : (n, 10) the nominal
        links, those of a guessed mass at the scale that the torque proves (None: as in nominal);
        total : mass of the nominal links [kg] where a file or bounds state it, else None.
    joint_scale : (p,) the value of a joint's own parameter (friction, offset, ...) that alone would
        make the torque of that joint in these data; infinite for the links' parameters.
    """

    model: Model
    data: LeastSquares
    constraints: ConstraintSet
    bound: Array
    nominal: Array
    box: Array
    independent: tuple[str, ...] | None = None
    seed: int = 0
    progress: Progress = no_progress
    joint_scale: Array | None = None
    bodies: tuple[Constraint, ...] = ()
    prior: Array | None = None
    total: float | None = None
    weights: Array = field(default_factory=lambda: np.ones(0))

    @property
    def prior_links(self) -> Array:
        """(n, 10) standard parameters of the links about which the prior is centred."""
        return self.nominal[self.links] if self.prior is None else self.prior

    @cached_property
    def links(self) -> NDArray[np.intp]:
        """(n, 10) indices of each link's parameters in theta; (0, 10) without rigid
        links.
        """
        return self.model.rigid_indices.reshape(-1, 10)

    @property
    def pseudo_inertias(self) -> tuple[Constraint, ...]:
        """Pseudo-inertia constraints of the robot's links, whose log det the prior
        contains.

        The pseudo-inertia of a body that an effect adds (a payload) is left out.
        """
        bodies = (c for c in self.constraints.convex if c.family == "pseudo-inertia")
        return tuple(c for c in bodies if c.indices[0] in self.links[:, 0])

    @cached_property
    def base(self) -> Array:
        """(b, p) map from theta to base parameters, the combinations that make torque.

        The links' base parameters come first, then all other parameters one by one.
        """
        rigid = self.model.rigid_indices
        unit = np.eye(len(self.bound))
        if not len(rigid):
            return unit
        matrix, _ = base_parameters(self.model, self.independent)
        return np.vstack([matrix @ unit[rigid], np.delete(unit, rigid, axis=0)])

    @cached_property
    def ols(self) -> Array:
        """(p,) unconstrained least-squares theta that is nearest to the nominal one."""
        return self.data.nearest(self.nominal)

    @cached_property
    def base_distance(self) -> LeastSquares:
        """Least-squares problem |pi(theta) - pi_hat|^2, with pi_hat the OLS base
        parameters.

        Units are those of the base parameters. The two-step methods minimise it: the
        paper's retrieval, and Sousa and Cortesao's beta'.
        """
        target = self.base @ self.ols
        return LeastSquares(
            self.base,
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

        Returns
        -------
        list of Constraint
            One a link.
        """
        links = enumerate(self.links if radius > 0.0 else (), start=1)
        return [
            build.pseudo_inertia(f"link {k}", indices, radius) for k, indices in links
        ]


class Estimator(ABC):
    """One way from a Task to parameters. Subclasses are frozen dataclasses of their
    settings."""

    name: ClassVar[str]
    description: ClassVar[str]
    #: True where the method is defined on a black box's answers only.
    needs_black_box: ClassVar[bool] = False
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
        """Estimate the parameters of several tasks that share all but their data.

        Parameters
        ----------
        tasks : sequence of Task
            The tasks, whose data are similar.

        Returns
        -------
        list of Fit
            The results of :meth:`fit`, within its accuracy.
        """
        return [self.fit(task) for task in tasks]


def make_task(
    problem: Problem,
    model: Model,
    regression: Regression,
    weighting: str = "noise",
    seed: int = 0,
    progress: Progress = no_progress,
    like: Task | None = None,
) -> Task:
    """Build the input of an estimator from a problem and compressed measurements.

    Parameters
    ----------
    problem : Problem
        Robot, bounds and nominal links.
    model : Model
        Effects that make torque.
    regression : Regression
        Compressed rows in the model's columns.
    weighting : str
        "noise": weight joints by the residuals of a first least-squares fit; "none".
    seed : int
        Seed of random methods.
    progress : callable
        Receives a line of text at each stage.
    like : Task, optional
        Task of the same problem and model on other data; what does not depend on the
        data is taken from it.

    Returns
    -------
    Task
        Data, constraints and prior as arrays.
    """
    links = model.rigid_indices.reshape(-1, 10)
    if like is None:
        nominal = problem.nominal(model)
        bound = problem.parameter_bound(model)
        # A link whose mass is known is scaled to it.
        masses = model.with_known(nominal)[links[:, :1]]
        nominal[links] *= masses / nominal[links[:, :1]]
        nominal = model.with_known(nominal)
        constraints = problem.constraints(model)
        bodies = _bodies(problem, links)
    else:
        nominal = like.nominal
        bound = like.bound
        constraints = like.constraints
        bodies = like.bodies
    require_known("weighting", weighting, ("noise", "none"))
    data = with_plausible(regression.least_squares(), model, regression.oversampling)
    first = data.nearest(nominal)
    weights = np.ones(regression.joints)
    if weighting == "noise":
        weights = joint_weights(regression, first)
        data = with_plausible(
            regression.least_squares(weights), model, regression.oversampling
        )
    guessed = problem.guessed_links
    return Task(
        model=model,
        data=data,
        constraints=constraints,
        bound=bound,
        nominal=nominal,
        box=problem.box,
        independent=problem.independent,
        seed=seed,
        progress=progress,
        joint_scale=joint_scale(regression, model, first),
        bodies=bodies,
        prior=_scaled_prior(data, nominal, links, guessed),
        total=None if np.any(guessed) else float(nominal[links[:, 0]].sum()),
        weights=weights,
    )


def _bodies(problem: Problem, links: NDArray[np.intp]) -> tuple[Constraint, ...]:
    """Return one constraint a link: its mass lies inside of its body's ellipsoid.

    ``links`` (n, 10) are the indices of the links' parameters in theta.
    """
    pairs = zip(links, problem.link_bodies, strict=False)
    return tuple(
        build.density_in_ellipsoid(
            "body", name=f"link {k}", indices=indices, quadric=body.quadric
        )
        for k, (indices, body) in enumerate(pairs, start=1)
    )


def with_plausible(
    data: LeastSquares, model: Model, oversampling: float
) -> LeastSquares:
    """Return data with the effects' prior knowledge of parameters as further
    observations.

    Each observation weighs as much as an independent row whose noise is the residual of
    least squares.

    Parameters
    ----------
    data : LeastSquares
        The measured data.
    model : Model
        The torque model, whose effects know plausible values.
    oversampling : float
        Rows for each independent row.

    Returns
    -------
    LeastSquares
        The data with the observations.
    """
    if not np.isfinite(model.plausible).any():
        return data
    variance = data.residual_norm**2 / max(data.rows - data.R.shape[1], 1)
    return data.with_prior(model.plausible, oversampling * variance)


def _scaled_prior(
    data: LeastSquares,
    nominal: Array,
    places: NDArray[np.intp],
    guessed: NDArray[np.bool_],
) -> Array:
    """Return (n, 10) nominal links, with guessed masses scaled to the measured torque.

    One common factor is found by least squares, with the joints' own parameters free
    and the other links as stated. A factor above 1 is used: the torque proves more
    mass. A smaller one proves nothing, since mass may lie nearer to the axes, so that
    it is used only below 1 / FAR_MASS.

    ``places`` (n, 10) are the links' indices in nominal (p,), ``guessed`` (n,) marks
    links whose mass no file states.
    """
    links = nominal[places]
    if not len(links) or not np.any(guessed):
        return links
    R = data.R
    other_columns = np.setdiff1d(np.arange(len(nominal)), places)
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
    model : Model
        Model of these columns.
    theta : (p,) array
        First least-squares fit. The torque of servos counts if it is larger than the
        measured one (which is zero in a log without torque).

    Returns
    -------
    (p,) array
        Scales; infinite for parameters of links and of servos, and without a column.
    """
    scale = np.full(regression.p, np.inf)
    gains = np.where(model.drives, theta, 0.0)
    for factor in regression.per_joint:
        columns = factor.triangle[:, :-1]
        norms = np.linalg.norm(columns, axis=0)
        measured = np.linalg.norm(factor.triangle[:, -1])
        of_servos = np.linalg.norm(columns @ gains[factor.indices])
        torque = float(max(measured, of_servos))
        counts = (norms > 0.0) & ~np.isin(factor.indices, model.rigid_indices)
        # Servos' terms cancel: each is many times as large as their sum.
        counts &= ~model.drives[factor.indices]
        if torque > 0.0:
            counted = factor.indices[counts]
            scale[counted] = np.minimum(scale[counted], torque / norms[counts])
    return scale


def joint_weights(regression: Regression, theta: np.ndarray) -> np.ndarray:
    """Return weights sigma / sigma_j that give all joints the same noise.

    Parameters
    ----------
    regression : Regression
        Compressed rows.
    theta : (p,) array
        First least-squares fit [SI].

    Returns
    -------
    (n,) array
        Factor of each joint's rows; sigma is the root mean square of all sigma_j.

    Notes
    -----
    A residual below 1e-6 of a joint's torque counts as that much, so that noise-free
    data are not weighted by rounding.
    """
    rows = np.maximum(regression.joint_rows(), 1)
    torque = np.array(
        [float(np.sum(f.triangle[:, -1] ** 2)) for f in regression.per_joint]
    )
    variance = np.maximum(regression.joint_losses(theta), 1e-12 * torque) / rows
    if not np.any(variance > 0.0):
        return np.ones(len(rows))
    variance = np.maximum(variance, 1e-12 * variance.max())
    return np.sqrt(variance.mean() / variance)


def with_joint_prior(task: Task, weight: float) -> Task:
    """Return the task with a prior that pulls the joints' own parameters to zero.

    Parameters
    ----------
    task : Task
        Task without the prior.
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

    Parameters
    ----------
    task : Task
        Task with its data.

    Returns
    -------
    float
        Variance [(N m)^2], with the joints' weights of the task.
    """
    return task.data.loss(task.ols) / max(task.data.rows, 1)


def white_variance(data: LeastSquares, oversampling: float) -> float:
    """Return the variance of an independent row if the least-squares residual is white.

    Parameters
    ----------
    data : LeastSquares
        Compressed rows.
    oversampling : float
        Rows per independent sample.

    Returns
    -------
    float
        Variance [(N m)^2].
    """
    U = span(data.R)
    residual = data.rho - U @ (U.T @ data.rho)
    degrees = max(data.rows - oversampling * U.shape[1], 1.0)
    squared_error = float(residual @ residual) + data.residual_norm**2
    return squared_error / degrees * oversampling
