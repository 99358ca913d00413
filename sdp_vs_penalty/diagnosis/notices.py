"""Notices: facts about the machine that the model's parameters have taken in.

One is a load that the robot's file does not know. It is no missing effect, since the
model explains its torque. It is estimated together with the findings, from the same white
rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.sizes import largest_sums
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.robot.inertia import link_sizes

#: Tolerance of a robot's file, over the size of a link's parameters: a mass and a centre
#: are right to a fifth each, and an inertia to three tenths beside that centre.
_FILE = np.array([0.2, *(0.28,) * 3, *(0.5,) * 6])
#: Mean square error of the other links, in units of that tolerance, up to which the
#: file describes them.
_FILE_DESCRIBES = 4.0
#: Prior standard deviations (10,) of a load's parameters, over the arm's mass: it is at
#: most as heavy as the arm, and within a metre of its joint.
_LOAD_REACH = np.array([1.0, *(0.5,) * 3, *(0.25,) * 6])
#: Chi-squared with four degrees of freedom from which a load is reported: a chance of
#: one in a million.
_LOAD_SURPRISE = 33.4
#: Standard deviations from zero from which a load's mass or moment is stated.
_IS_KNOWN = 2.0
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
    load = load_beyond_file(search, estimate)
    return () if load is None else (load,)


def load_beyond_file(search: Search, estimate: Estimate) -> Notice | None:
    """Compare the last link with the robot's file; return a notice of a load, or None.

    The last link's parameters are estimated without its file, beside other links that
    are as right as files are (a fifth). Noise and the file's tolerance may explain the
    difference of mass and first moment: a chi-squared with four degrees of freedom
    tells. No load is reported where the other links do not fit their file either, or
    where no file states the masses.

    Parameters
    ----------
    search
        The findings beside the model.

    Returns
    -------
    Notice or None
        Its size is the mass [kg] beyond the file; if the data do not show a mass, the
        length of the first moment [kg m] beyond the file. None as well if the last link
        would have no mass above zero.
    """
    links = estimate.problem.nominal_links
    rigid = estimate.model.rigid_indices
    # Of torques in another unit, such as currents, no mass is in kg.
    is_in_si = estimate.torque_units == estimate.robot.torque_units
    is_stated = (
        is_in_si
        and not estimate.problem.guessed_links.any()
        and np.all(links[:, 0] > 0.0)
    )
    if len(rigid) != links.size or not is_stated:
        return None
    tolerances = _FILE * link_sizes(links)
    loose = links[:, 0].sum() * _LOAD_REACH
    deviations = np.full(len(estimate.theta), np.inf)
    deviations[rigid] = np.vstack([tolerances[:-1], loose]).ravel()
    nominal = np.zeros(len(estimate.theta))
    nominal[rigid] = links.ravel()
    theta, covariance = fit_with_priors(search, nominal, deviations)
    others = rigid[:-10]
    away = (theta[others] - nominal[others]) / deviations[others]
    unknown = np.diagonal(covariance)[others] / deviations[others] ** 2
    n_from_data = float(np.sum(1.0 - np.minimum(unknown, 1.0)))
    if away @ away >= _FILE_DESCRIBES * max(n_from_data, 1.0):
        return None
    place = rigid[-10:-6]  # mass and first moment of the last link
    excess = theta[place] - links[-1, :4]
    covariance = covariance[np.ix_(place, place)] + np.diag(tolerances[-1, :4] ** 2)
    surprise = float(excess @ np.linalg.solve(covariance, excess))
    if surprise < _LOAD_SURPRISE:
        return None
    mass = float(excess[0])
    std_of_mass = float(np.sqrt(covariance[0, 0]))
    if abs(mass) > _IS_KNOWN * std_of_mass:
        if theta[place[0]] <= 0.0:
            # No link has a mass below zero: the torques may be in another unit.
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
    of_file = "from its file"
    unseen = "its mass"
    if moment > _IS_KNOWN * std:
        of_file += f" by {moment:.2g} ± {NORMAL_95 * std:.1g} kg m"
    else:
        unseen = "how far, nor its mass"
    text = (
        f"the first moment (mass times centre) of what joint {joint} carries differs"
        f" {of_file}: a payload, or a last link that the file has wrong by more than a"
        f" fifth; the data do not show {unseen}"
    )
    return Notice("load", joint, moment, std, "kg*m", text)


def fit_with_priors(
    search: Search, nominal: Array, deviations: Array
) -> tuple[Array, Array]:
    """Estimate the model's parameters beside a search's findings, with priors.

    The estimate is (A + P)^-1 (Z'y + P t0), for columns Z; A = Z'Z, prior precision P
    and prior mean t0. Its covariance is (A + P)^-1 (S + P) (A + P)^-1: S sums the
    scores Z'r over clusters of rows that err together. Each joint's rows are divided
    by what the search leaves there.

    Parameters
    ----------
    search
        The findings beside the model.
    nominal
        (p,) prior means of the model's parameters.
    deviations
        (p,) prior standard deviations; infinite: no prior.

    Returns
    -------
    theta : (p,) array
        The model's parameters.
    covariance : (p, p) array
        From noise, model errors and priors.
    """
    data = search.data
    level = search.score.fit(search.terms, search.fit).level
    p = len(nominal)
    n_findings = sum(t.form.n_coefficients for t in search.terms)
    Z = np.pad(data.X, ((0, 0), (0, 0), (0, n_findings)))
    first = p
    for term in search.terms:
        end = first + term.form.n_coefficients
        for joint, columns in term.columns.items():
            Z[joint, :, first:end] = columns
        first = end
    Z = Z / level[:, None, None]
    # Parameters of all units are compared by the torque that they make.
    lengths = nonzero_or_one(np.linalg.norm(Z, axis=(0, 1)))
    Z = Z / lengths
    y = data.y / level[:, None]
    # The ridge is a prior as well: what the rows do not show has its wide deviation.
    precision = np.full(len(lengths), _RIDGE)
    precision[:p] += (deviations * lengths[:p]) ** -2.0
    of_prior = np.zeros(len(lengths))
    of_prior[:p] = precision[:p] * nominal * lengths[:p]
    inverse = np.linalg.inv(np.tensordot(Z, Z, ((0, 1), (0, 1))) + np.diag(precision))
    theta = inverse @ (np.tensordot(Z, y, ((0, 1), (0, 1))) + of_prior)
    factor = largest_sums(data, Z, y - Z @ theta)
    middle = factor @ factor.T + np.diag(precision)
    covariance = (inverse @ middle @ inverse)[:p, :p]
    return theta[:p] / lengths[:p], covariance / np.outer(lengths[:p], lengths[:p])
