"""Notices: facts about the machine that the model's parameters have taken in.

One is a load that the robot's file does not know. It is no missing effect, since the
model explains its torque. It is estimated together with the findings, from the same white
rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.sizes import largest_sums_of_scores
from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.robot.arrays import Array, Indices, nonzero_or_one
from sdp_vs_penalty.robot.inertia import gyration_about_joint, inertia_matrix

#: Tolerance of a robot's file, as relative standard deviations: of a mass; of a centre
#: of mass, over the link's radius of gyration about its joint; of an inertia.
_FILE_MASS = 0.2
_FILE_CENTRE = 0.2
_FILE_INERTIA = 0.3
#: Mean square error of the other links, in units of that tolerance, up to which the
#: file describes them.
_FILE_DESCRIBES = 4.0
#: Prior standard deviations (10,) of a load's parameters, over the arm's mass: it is at
#: most as heavy as the arm, and within a metre of its joint.
_LOAD_REACH = np.array([1.0, *(0.5,) * 3, *(0.25,) * 6])
#: Chi-squared with four degrees of freedom from which a load is reported: a chance of
#: one in a million.
_LOAD_SURPRISE = 33.4
#: Standard deviations from zero from which a load's mass is stated.
_MASS_IS_KNOWN = 2.0
#: Share of a unit column's square that keeps the normal equations regular.
_RIDGE = 1e-9


@dataclass(frozen=True)
class Notice(JsonRecord):
    """A fact about the machine that the model's own parameters hold."""

    #: "load"; "offset" in older files.
    kind: str
    #: Number of the joint, from 1.
    joint: int
    #: Estimate of the load, in ``unit``.
    size: float
    #: Standard deviation of the size, in ``unit``.
    std: float
    #: Unit of the size.
    unit: str
    #: What the fact means for the user.
    sentence: str


@dataclass(frozen=True)
class FitWithPriors:
    """The model's parameters, estimated beside the findings and with priors."""

    #: (p,) parameters of the model.
    theta: Array
    #: (p, p) covariance of the parameters, from noise, model errors and priors.
    covariance: Array
    #: (p,) means of the priors.
    nominal: Array
    #: (p,) standard deviations of the priors, infinite without one.
    deviations: Array

    @property
    def std(self) -> Array:
        """(p,) standard deviations of the parameters."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))


def find_notices(search: Search, estimate: Estimate) -> tuple[Notice, ...]:
    """List what the model has taken in: a load beyond the robot's file.

    Parameters
    ----------
    search
        The findings beside the model.

    Returns
    -------
    tuple of Notice
        Empty for a model that is held fixed, since its parameters take nothing in.
    """
    if search.data.frozen or not len(estimate.model.rigid_indices):
        return ()
    load = load_beyond_file(ScaledRows.of_search(search), estimate)
    return () if load is None else (load,)


def load_beyond_file(rows: ScaledRows, estimate: Estimate) -> Notice | None:
    """Compare the last link with the robot's file; return a notice of a load, or None.

    The last link's parameters are estimated without its file, beside other links that
    are as right as files are (a fifth). Noise and the file's tolerance may explain the
    difference of mass and first moment: a chi-squared with four degrees of freedom
    tells. No load is reported where the other links do not fit their file either, or
    where no file states the masses.

    Parameters
    ----------
    rows
        The rows of the model and the findings.

    Returns
    -------
    Notice or None
        Its size is the mass [kg] beyond the file, by which the last link still has a
        mass above zero; where the data do not show a mass,
        the length of the first moment [kg m].
    """
    links = estimate.problem.nominal_links
    rigid = estimate.model.rigid_indices
    is_in_si = estimate.torque_units == estimate.robot.torque_units  # else no kg is one
    is_stated = (
        is_in_si
        and not estimate.problem.guessed_links.any()
        and np.all(links[:, 0] > 0.0)
    )
    if len(rigid) != links.size or not is_stated:
        return None
    tolerances = file_deviations(links)
    loose = links[:, 0].sum() * _LOAD_REACH
    deviations = np.full(len(estimate.theta), np.inf)
    deviations[rigid] = np.vstack([tolerances[:-1], loose]).ravel()
    nominal = np.zeros(len(estimate.theta))
    nominal[rigid] = links.ravel()
    fit = fit_with_priors(rows, nominal, deviations)
    if not _describes(fit, rigid[:-10]):
        return None
    place = rigid[-10:-6]  # mass and first moment of the last link
    excess = fit.theta[place] - links[-1, :4]
    covariance = fit.covariance[np.ix_(place, place)] + np.diag(tolerances[-1, :4] ** 2)
    surprise = float(excess @ np.linalg.solve(covariance, excess))
    if surprise < _LOAD_SURPRISE:
        return None
    mass = float(excess[0])
    std_of_mass = float(np.sqrt(covariance[0, 0]))
    if abs(mass) > _MASS_IS_KNOWN * std_of_mass:
        if fit.theta[place[0]] <= 0.0:
            # No arm carries less than nothing: torques in another unit, say.
            return None
        return _notice_of_mass(len(links), mass, std_of_mass)
    moment = float(np.linalg.norm(excess[1:]))
    direction = excess[1:] / max(moment, 1e-300)
    std = float(np.sqrt(direction @ covariance[1:, 1:] @ direction))
    return _notice_of_moment(len(links), moment, std)


def _notice_of_mass(joint: int, mass: float, std: float) -> Notice:
    """Say how much more (or less) mass [kg] the arm carries beyond a joint (from 1)."""
    amount = f"{abs(mass):.2g} ± {NORMAL_95 * std:.1g} kg"
    if mass > 0.0:
        text = (
            f"beyond joint {joint} the arm carries {amount} more than its file says: a"
            " payload, or a last link that the file has wrong by more than a fifth"
        )
    else:
        text = (
            f"beyond joint {joint} the arm carries {amount} less than its file says: a"
            " tool that is not there, or a last link that the file has wrong by more"
            " than a fifth"
        )
    return Notice("load", joint, mass, std, "kg", text)


def _notice_of_moment(joint: int, moment: float, std: float) -> Notice:
    """Say by how much the last link's first moment [kg m] differs from the file."""
    text = (
        f"the first moment (mass times centre) of what joint {joint} carries differs"
        f" from its file by {moment:.2g} ± {NORMAL_95 * std:.1g} kg m: a payload, or a"
        " last link that the file has wrong by more than a fifth; the data do not show"
        " its mass"
    )
    return Notice("load", joint, moment, std, "kg*m", text)


def file_deviations(links: Array) -> Array:
    """Return standard deviations (links, 10) of parameters as a robot's file states
    them.

    A mass is right to a fifth. A centre of mass is right to a fifth of the link's
    radius of gyration about its joint. An inertia is right to three tenths, and errs
    with the centre as well.

    Parameters
    ----------
    links
        (links, 10) nominal parameters: m [kg], m c [kg m], inertia about the joint [kg
        m^2].
    """
    out = np.empty_like(links)
    for k, link in enumerate(links):
        moments = np.linalg.eigvalsh(inertia_matrix(link[4:]))
        radius = float(gyration_about_joint(link))
        error_of_moment = link[0] * _FILE_CENTRE * radius
        out[k, 0] = _FILE_MASS * link[0]
        out[k, 1:4] = np.hypot(_FILE_MASS * link[1:4], error_of_moment)
        out[k, 4:] = np.hypot(
            _FILE_INERTIA * moments.max(), 2.0 * radius * error_of_moment
        )
    return np.maximum(out, 1e-9)


def _describes(fit: FitWithPriors, places: Indices) -> bool:
    """Return whether a file describes links as well as its tolerance says.

    The squares of their deviations, in units of the tolerance, are compared with those
    expected: one for each parameter that the data determine.

    Parameters
    ----------
    fit
        The estimate beside the file.
    places
        Indices of the links' parameters in theta.
    """
    if not len(places):
        return True
    deviations = fit.deviations[places]
    squares = ((fit.theta[places] - fit.nominal[places]) / deviations) ** 2
    from_data = 1.0 - np.minimum((fit.std[places] / deviations) ** 2, 1.0)
    return bool(squares.sum() < _FILE_DESCRIBES * max(float(from_data.sum()), 1.0))


@dataclass(frozen=True)
class ScaledRows:
    """White rows of the model and the findings, over each joint's residual."""

    #: (M, K) columns of each of the n joints, the model's p first. Each has length 1
    #: over all joints, so that parameters of all units are compared by the torque that
    #: they make.
    columns: Sequence[Array]
    #: (n, M) white torque over each joint's residual.
    torque: Array
    #: (K,) lengths of the columns before they were scaled.
    lengths: Array
    #: Number p of the model's parameters.
    n_parameters: int
    #: Ways to group the rows that err together: labels (M,) of the rows.
    clusters: Sequence[Indices]

    @classmethod
    def of_search(cls, search: Search) -> ScaledRows:
        """Stack the columns of the model and of a search's findings, each joint's rows
        divided by the standard deviation of what the search leaves there."""
        data = search.data
        residual = search.score.fit(search.terms, search.fit).level  # (n,)
        columns = [
            _columns_of_joint(data, search.terms, joint) / residual[joint]
            for joint in range(data.n)
        ]
        squares = np.sum([np.sum(z**2, axis=0) for z in columns], axis=0)
        lengths = nonzero_or_one(np.sqrt(squares))
        return cls(
            columns=[z / lengths for z in columns],
            torque=data.y / residual[:, None],
            lengths=lengths,
            n_parameters=data.X.shape[2],
            clusters=data.clusters,
        )

    @cached_property
    def gram(self) -> Array:
        """(K, K) products Z'Z of the columns."""
        return np.asarray(sum(z.T @ z for z in self.columns))

    @cached_property
    def with_torque(self) -> Array:
        """(K,) products Z'y of the columns and the torque."""
        pairs = zip(self.columns, self.torque, strict=True)
        return np.asarray(sum(z.T @ y for z, y in pairs))

    def scatter(self, theta: Array) -> Array:
        """Return S (K, K): the products of the scores Z'r, summed over clusters.

        r is the residual of parameters theta (K,). The clusters are those of a
        finding's interval (:func:`~sdp_vs_penalty.diagnosis.sizes.largest_sums`).
        """
        scores = np.zeros((self.torque.shape[1], len(theta)))
        for z, y in zip(self.columns, self.torque, strict=True):
            residual = y - z @ theta
            scores += z * residual[:, None]
        factor = largest_sums_of_scores(self.clusters, scores)
        return factor @ factor.T

    def padded(self, of_model: Array) -> Array:
        """Return values of the model's parameters (p,), with zeros of the findings'
        behind them, (K,)."""
        out = np.zeros(len(self.lengths))
        out[: self.n_parameters] = of_model
        return out


def fit_with_priors(
    rows: ScaledRows, nominal: Array, deviations: Array
) -> FitWithPriors:
    """Estimate all parameters of the model beside the findings, with priors.

    The estimate is (A + P)^-1 (Z'y + P t0), for columns Z; A = Z'Z, prior precision P
    and prior mean t0. Its covariance is (A + P)^-1 (S + P) (A + P)^-1: S sums the
    scores Z'r over clusters of rows that err together.

    Parameters
    ----------
    rows
        The rows of the model and the findings.
    nominal
        (p,) prior means of the model's parameters.
    deviations
        (p,) prior standard deviations; infinite: no prior.

    Returns
    -------
    FitWithPriors
        Estimate and covariance of the model's p parameters.
    """
    p = rows.n_parameters
    lengths = rows.lengths[:p]
    # The ridge is a prior as well: what the rows do not show has its wide deviation.
    precision = rows.padded((deviations * lengths) ** -2.0) + _RIDGE
    mean = rows.padded(nominal * lengths)
    inverse = np.linalg.inv(rows.gram + np.diag(precision))
    theta = inverse @ (rows.with_torque + precision * mean)
    middle = rows.scatter(theta) + np.diag(precision)
    covariance = (inverse @ middle @ inverse)[:p, :p]
    return FitWithPriors(
        theta=theta[:p] / lengths,
        covariance=covariance / np.outer(lengths, lengths),
        nominal=nominal,
        deviations=deviations,
    )


def _columns_of_joint(
    data: WhiteData, terms: Sequence[ScoredEffect], joint: int
) -> Array:
    """Return the white columns (M, p + k) of the model and all findings on a joint."""
    M = data.X.shape[1]
    findings = [
        t.columns.get(joint, np.zeros((M, t.form.n_coefficients))) for t in terms
    ]
    return np.hstack([data.X[joint], *findings])
