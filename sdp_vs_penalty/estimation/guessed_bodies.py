"""Guessed bodies that the data reject.

Where neither a shape nor bounds show where a link's mass lies, its body is a guess
(:mod:`~sdp_vs_penalty.problem.bodies`). One that is too small makes the truth
infeasible, and the error that is left looks like a missing effect. So a guess that
costs more than CHANGES of the error grows until it does not.
"""

from __future__ import annotations

from dataclasses import replace

from sdp_vs_penalty.estimation.constants import CHANGES
from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Task, fitted

#: Factor by which a guess that costs too much grows at once [-].
_GROWTH = 2.0


def fit_in_bodies(task: Task, estimator: Estimator) -> tuple[Task, Fit]:
    """Estimate a task's parameters, in guessed bodies as large as the data ask for.

    A body bounds where a link's mass may lie. A guessed one on whose surface the
    estimate lies may be too small: it grows by the factor _GROWTH, again and again,
    until the loss J is at most (1 + CHANGES)^2 J_0, with J_0 the loss without bodies.

    Returns
    -------
    Task
        With the bodies that were taken; the given one unless a guess has grown.
    Fit
        The estimate within them.
    """
    fit = fitted(estimator, task)
    tight = _tight_guesses(task, fit)
    if not tight:
        return task, fit
    free = fitted(estimator, replace(task, link_bodies=()))
    tolerated = (1.0 + CHANGES) ** 2 * task.data.loss(free.theta)
    while tight and task.data.loss(fit.theta) > tolerated:
        bodies = list(task.link_bodies)
        for k in tight:
            bodies[k] = bodies[k].larger(_GROWTH)
        task = replace(task, link_bodies=tuple(bodies))
        fit = fitted(estimator, task)
        tight = _tight_guesses(task, fit)
    return task, fit


def _tight_guesses(task: Task, fit: Fit) -> list[int]:
    """Return the links (from 0) whose guessed bodies an estimate lies on."""
    on_body = {
        c.name
        for c in fit.problem.constraints.convex
        if c.family == "body" and c.is_reached(fit.theta)
    }
    return [
        k
        for k, body in enumerate(task.link_bodies)
        if body.is_guess and f"link {k + 1}" in on_body
    ]
