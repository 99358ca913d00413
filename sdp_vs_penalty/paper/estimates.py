"""Estimates of a study: each is computed once, whichever table or run asks for it
first."""

import time
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import scipy

from sdp_vs_penalty.estimation.certificate import Certificate
from sdp_vs_penalty.estimation.identify import certify
from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Task
from sdp_vs_penalty.estimators.penalty_paper import (
    PenalisedLoss,
    PenaltyPaper,
    Stopping,
    anneal_and_search,
    search_locally,
)
from sdp_vs_penalty.paper.memo import remembered, source_version, task_content
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.objective import Objective

#: To be raised where annealing, local search or the penalised loss change their numbers:
#: runs of hours are kept beyond changes of other sources.
ANNEALING_VERSION = 1
#: Every fit is timed so many times after a first one; the median counts.
REPEATS = 3


@dataclass(frozen=True)
class Result:
    """One method on one data set."""

    #: (p,) parameters as certified.
    theta: Array
    #: Its certificate.
    certificate: Certificate
    #: What the method says of its runs.
    details: dict[str, Any]


@dataclass(frozen=True)
class Remembered(Estimator):
    """An estimator whose fits are kept on the disk: theta alone, without multipliers."""

    name = "remembered"
    description = "an estimate that is read where it was computed before"
    estimator: Estimator

    def fit(self, task: Task) -> Fit:
        """Read the estimate from the disk, or compute it."""
        theta = np.array(_estimate(self.estimator, task)["fit_theta"])
        return Fit(theta, Objective(task.data), task.constraints)


def estimate_once(estimator: Estimator, task: Task) -> Result:
    """Return an estimator's certified estimate, read from the disk if it is there.

    Parameters
    ----------
    estimator : Estimator
        Its settings are part of the cached file's key.
    """
    plain = _estimate(estimator, task)
    return Result(
        np.array(plain["theta"]), Certificate(**plain["certificate"]), plain["details"]
    )


def _estimate(estimator: Estimator, task: Task) -> dict[str, Any]:
    """Return the estimate as JSON; the key holds the sources, the settings and the
    task.
    """
    content = (source_version(), estimator.name, estimator, *task_content(task))
    return remembered("estimate", content, partial(_estimated, estimator, task))


def _estimated(estimator: Estimator, task: Task) -> dict[str, Any]:
    """Compute and certify an estimate; return it as JSON."""
    fresh = replace(task)  # without what an earlier method has left in its cache
    if isinstance(estimator, PenaltyPaper):
        fit = estimator.fit_with(fresh, anneal_once)
    else:
        fit = estimator.fit(fresh)
    theta, certificate = certify(task, fit)
    return {
        "theta": theta.tolist(),
        "certificate": asdict(certificate),
        "details": fit.details,
        "fit_theta": fit.theta.tolist(),
    }


def fit_seconds(estimator: Estimator, task: Task) -> float:
    """Return the processor time of a fit [s], by one rule for every method: the median of
    REPEATS runs after a first one that does not count, nothing read from the disk."""
    times = [timed(estimator, task)[1] for _ in range(1 + REPEATS)]
    return float(np.median(times[1:]))


def timed(estimator: Estimator, task: Task) -> tuple[Fit, float]:
    """Return one fit and its processor time [s], nothing read from the disk."""
    fresh = replace(task)  # without what an earlier fit has left in its cache
    begin = time.process_time()
    fit = estimator.fit(fresh)
    return fit, time.process_time() - begin


def anneal_once(
    loss: PenalisedLoss, weight: float, u: Array, budget: int, rng: np.random.Generator
) -> tuple[Array, int]:
    """Run one step of annealing and local search from u (d,) in [0, 1]^d, or read its
    result from the disk.

    Parameters
    ----------
    budget : int
        Largest number of loss evaluations.

    Returns
    -------
    tuple of ((d,) array, int)
        The best point, and the number of evaluations.
    """
    content = (
        ANNEALING_VERSION,
        scipy.__version__,
        *loss_content(loss),
        weight,
        u,
        budget,
        rng.bit_generator.state,
    )
    plain = remembered(
        "annealing", content, partial(_annealed, loss, weight, u, budget, rng)
    )
    return np.array(plain["u"]), int(plain["evaluations"])


def search_locally_once(
    loss: PenalisedLoss, weight: float, u: Array, budget: int, stopping: Stopping
) -> tuple[Array, int]:
    """Run :func:`search_locally` from u (d,) in [0, 1]^d, or read its result from the
    disk: the best point and the number of evaluations.

    Parameters
    ----------
    budget : int
        Largest number of loss evaluations.
    """
    content = (
        ANNEALING_VERSION,
        scipy.__version__,
        *loss_content(loss),
        weight,
        u,
        budget,
        stopping,
    )
    compute = partial(_searched_locally, loss, weight, u, budget, stopping)
    plain = remembered("local-search", content, compute)
    return np.array(plain["u"]), int(plain["evaluations"])


def _searched_locally(
    loss: PenalisedLoss, weight: float, u: Array, budget: int, stopping: Stopping
) -> dict[str, Any]:
    """Search locally from u (d,); return the best point and its evaluations as JSON."""
    best, n_evaluations = search_locally(loss, weight, u, budget, stopping)
    return {"u": best.tolist(), "evaluations": n_evaluations}


def _annealed(
    loss: PenalisedLoss, weight: float, u: Array, budget: int, rng: np.random.Generator
) -> dict[str, Any]:
    """Anneal and search locally from u (d,); return point, evaluations and seconds
    as JSON.
    """
    best, n_evaluations = anneal_and_search(loss, weight, u, budget, rng)
    return {"u": best.tolist(), "evaluations": n_evaluations}


def loss_content(loss: PenalisedLoss) -> tuple[object, ...]:
    """Return everything that the value of a penalised loss depends on."""
    return (
        loss.data,
        loss.box.lower,
        loss.box.upper,
        loss.box.links,
        loss.fixed,
        loss.free,
        [vars(demand) for demand in loss.demands],
    )
