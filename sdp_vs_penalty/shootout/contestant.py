"""A participant of the shootout, and what our loop makes of one: an answer that proves itself."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.errors import Infeasible, InputError
from sdp_vs_penalty.estimators.estimator import Fit
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.judge import Answer
from sdp_vs_penalty.solvers.certificate import lower_bound, repair

#: What our default path promises.
DEFAULT_ACCURACY = 1e-8
Solve = Callable[[Instance, float], Answer]
#: Why an instance cannot be posed to a contestant, or None.
Applies = Callable[[Instance], str | None]


@dataclass(frozen=True)
class Contestant:
    """absent : why it is not here, or None; tunable : whether an accuracy can be asked for."""

    name: str
    description: str
    solve: Solve
    applies: Applies
    version: Callable[[], str]
    absent: str | None = None
    tunable: bool = True
    promise: float = DEFAULT_ACCURACY  # what is promised where no accuracy can be asked for
    #: What a first call pays for once (imports, compilation); it must not start a thread, because a
    #: forked child would wait for it for ever.
    warm_up: Callable[[], None] = lambda: None

    def settings(self, accuracy: float) -> str:
        """How a run is set up, in one word: the key in runs.csv."""
        return f"{accuracy:.0e}" if self.tunable else "default"


def with_proof(
    instance: Instance,
    accuracy: float,
    fits: Callable[[Instance], Sequence[Fit]],
    words: Callable[[Fit], tuple[list[str], int]],
) -> Answer:
    """The fit of least certified gap, which claims what its own proof says.

    words : what each attempt ended with, and all steps.
    """
    start = time.perf_counter()
    try:
        gap, fit = min(
            ((certified_gap(instance, fit), fit) for fit in fits(instance)), key=lambda pair: pair[0]
        )
    except InputError as error:
        return no_answer(instance, error, time.perf_counter() - start)
    seconds = time.perf_counter() - start
    said, steps = words(fit)
    claims = "optimal" if gap <= accuracy else "inaccurate"
    status = f"certified gap {gap:.1e}; " + ", ".join(said)
    return Answer(
        fit.theta,
        claims,
        status,
        steps,
        0.0,
        seconds,
        fit.multipliers,
        fit.entropy_slopes,
        attempts=len(said),
    )


def certified_gap(instance: Instance, fit: Fit) -> float:
    """Certified, relative to the loss."""
    assert fit.multipliers is not None
    assert fit.interior is not None
    bound = instance.task.bound
    lower = lower_bound(
        fit.objective, fit.constraints, fit.multipliers, fit.theta, bound, fit.entropy_slopes
    )
    upper = fit.objective.value(repair(fit.constraints, fit.theta, fit.interior))
    scale = max(instance.data.loss_scale(fit.theta), 1e-300)
    return (upper - lower) / scale


def no_answer(instance: Instance, error: InputError | str, seconds: float) -> Answer:
    """Nothing, or a claim of infeasibility where the error proves it."""
    nothing = np.full(len(instance.task.bound), np.nan)
    claims = "infeasible" if isinstance(error, Infeasible) and error.proof else "failed"
    return Answer(nothing, claims, str(error), 0, 0.0, seconds)
