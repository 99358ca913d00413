"""What an answer is worth, whatever its author says of it.

right            claims success, and gap and violation are within 10 times what was asked;
                 or claims infeasibility of what is proved infeasible
inaccurate       admits reduced accuracy; or our own interval is too wide to decide
silently_wrong   claims success (or a verdict) that our proofs contradict
failed           says so
timeout, crash   ended by the clock, or by a signal
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.constraints.constraint import Constraint
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.reference import Reference
from sdp_vs_penalty.solvers import verified
from sdp_vs_penalty.solvers.certificate import lower_bound

Array = NDArray[np.float64]

CLASSES = ("right", "inaccurate", "silently_wrong", "failed", "timeout", "crash")

#: How far beyond what was asked an answer may be and still count as right.
SLACK = 10.0


@dataclass(frozen=True)
class Answer:
    """What a contestant returned. multipliers : of all convex constraints, or None without a dual."""

    theta: Array
    claims: str
    status: str
    iterations: int
    setup_seconds: float
    solve_seconds: float
    multipliers: Sequence[Array] | None = None
    entropy_slopes: Array | None = None


@dataclass(frozen=True)
class Verdict:
    """class of a run; gap : certified, relative, after feasible repair; violation : relative, before.

    lower, upper : the interval that contains the optimum after this run; own_lower : the bound that
    follows from the contestant's own multipliers.
    """

    kind: str
    gap: float
    violation: float
    lower: float
    upper: float
    own_lower: float
    remark: str = ""


def judge(instance: Instance, reference: Reference, answer: Answer, asked: float) -> Verdict:
    """Classify one answer; ``asked`` is the accuracy that was asked for."""
    gap, violation, upper = _primal(instance, reference, answer.theta)
    own = _dual(instance, answer)
    lower = max(reference.lower, own)
    if reference.verdict == "feasible":
        gap = (upper - lower) / reference.scale
    numbers = (gap, violation, lower, min(upper, reference.upper), own)
    if answer.claims == "failed":
        return Verdict("failed", *numbers)
    if answer.claims == "inaccurate":
        return Verdict("inaccurate", *numbers)
    if answer.claims in ("infeasible", "unbounded"):
        # A sum of squares over a set that is not empty is never unbounded.
        if reference.verdict == "infeasible" and answer.claims == "infeasible":
            return Verdict("right", *numbers)
        if reference.verdict == "unknown":
            return Verdict("inaccurate", *numbers, "whether anything is feasible is not proved")
        return Verdict("silently_wrong", *numbers, f"claims {answer.claims}, which is proved wrong")
    if reference.verdict == "infeasible":
        return Verdict("silently_wrong", *numbers, "claims a solution of what is proved infeasible")
    allowed = SLACK * asked
    if violation > allowed:
        return Verdict("silently_wrong", *numbers, "violates the constraints")
    if gap <= allowed:
        return Verdict("right", *numbers)
    if (upper - reference.upper) / reference.scale > allowed or not np.isfinite(upper):
        return Verdict("silently_wrong", *numbers, "a better feasible point is proved")
    return Verdict("inaccurate", *numbers, "our interval is wider than what was asked")


def _primal(instance: Instance, reference: Reference, theta: Array) -> tuple[float, float, float]:
    """Gap (infinite here), relative violation, and the upper bound after feasible repair."""
    if not np.all(np.isfinite(theta)):
        return np.inf, np.inf, np.inf
    interior = instance.interior
    inside = instance.task.nominal if interior is None else interior
    violation = relative_violation(instance.constraints.convex, theta, inside, instance.task.bound)
    if interior is None or reference.verdict != "feasible":
        return np.inf, violation, np.inf
    point = verified.feasible_point(instance.constraints.convex, theta, interior)
    if point is None:
        return np.inf, violation, np.inf
    return np.inf, violation, verified.upper_bound(instance.objective, point)


def _dual(instance: Instance, answer: Answer) -> float:
    if answer.multipliers is None or not np.all(np.isfinite(answer.theta)):
        return -np.inf
    if not all(np.all(np.isfinite(m)) for m in answer.multipliers):
        return -np.inf
    slopes = answer.entropy_slopes
    if slopes is not None and not np.all(np.isfinite(slopes)):
        slopes = None
    try:
        value = lower_bound(
            instance.objective,
            instance.constraints,
            answer.multipliers,
            answer.theta,
            instance.task.bound,
            slopes,
        )
    except np.linalg.LinAlgError:
        return -np.inf
    return value if np.isfinite(value) else -np.inf


def relative_violation(
    constraints: Sequence[Constraint], theta: Array, inside: Array, bound: Array
) -> float:
    """The worst violation in units of each cone's own size at an interior point: free of units.

    psd: the smallest eigenvalue of D F(theta) D with D F(inside) D of unit diagonal; rows: relative to
    the largest term that they can hold.
    """
    worst = 0.0
    for c in constraints:
        value = c.value(theta)
        if c.cone == "psd":
            diagonal = np.abs(np.diagonal(c.value(inside)))
            scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
            margin = float(np.linalg.eigvalsh(value * np.outer(scale, scale))[0])
        else:
            local = bound[c.indices].reshape(-1, 1)
            size = np.maximum(np.abs(c.coefficients * local).max(axis=0), np.abs(c.constant))
            size = np.where(size > 0.0, size, 1.0)
            if c.cone == "soc":
                margin = float(value[0] - np.linalg.norm(value[1:])) / float(size.max())
            else:
                margin = float(np.min(value / size))
        worst = max(worst, -margin)
    return worst
