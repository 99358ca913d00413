"""What an answer is worth, whatever its author says of it.

Three figures, each relative, none mixed with another: ``objective_error``, how far its objective as
it was returned lies from the proved interval; ``violation`` of the constraints, as returned; the dual
gap that follows from the contestant's own multipliers. Beside them ``dimacs``, the largest of the
DIMACS errors of the conic problem that the solver saw. Its own promise is measured on that problem too,
relative to all terms, as solvers' criteria are.

right            claims success, and error and violation are within 10 times what was asked;
                 or claims infeasibility of what is proved infeasible
inaccurate       admits reduced accuracy; or kept its promise, in its own scaling, and is off all the
                 same (of infeasibility: its proof has errors no larger); or our own interval is too wide
                 to decide
silently_wrong   claims success, or that there is no optimum where one is proved, and misses its own
                 promise too, its own errors 10 times or more above what was asked
failed           says so
timeout, crash   ended by the clock, or by a signal
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from sdp_vs_penalty.constraints.cones import cone_margin, project
from sdp_vs_penalty.constraints.constraint import Constraint
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.reference import Reference
from sdp_vs_penalty.solvers import verified
from sdp_vs_penalty.solvers.conic import ConicProblem, svec, unsvec

CLASSES = ("right", "inaccurate", "silently_wrong", "failed", "timeout", "crash")

#: How far beyond what was asked an answer may be and still count as right; how far beyond it a solver's
#: own errors may be and its claim of success still count as kept.
SLACK = 10.0


@dataclass(frozen=True)
class Answer:
    """What a contestant returned. multipliers : of all convex constraints, or None without a dual.

    dimacs : the largest DIMACS error of the conic problem that the solver saw, rewritten for it;
        own_error : the same relative to all terms of each sum, as solvers' own criteria are. None where
        no conic problem was sent.
    attempts : runs that went into it, as far as the contestant starts several.
    """

    theta: Array
    claims: str
    status: str
    iterations: int
    setup_seconds: float
    solve_seconds: float
    multipliers: Sequence[Array] | None = None
    entropy_slopes: Array | None = None
    dimacs: float | None = None
    own_error: float | None = None
    attempts: int = 1


@dataclass(frozen=True)
class Judgement:
    """class of a run; objective_error, violation : of the answer as returned, relative; gap : certified,
    after repair towards a point near the optimum.

    lower, upper : the interval that contains the optimum after this run; own_lower : the bound that
    follows from the contestant's own multipliers.
    """

    kind: str
    objective_error: float
    violation: float
    gap: float
    lower: float
    upper: float
    own_lower: float
    dimacs: float | None = None
    remark: str = ""


def judge(instance: Instance, reference: Reference, answer: Answer, asked: float) -> Judgement:
    """Classify one answer; ``asked`` is the accuracy that was asked for."""
    error, violation, upper = _primal(instance, reference, answer.theta)
    own = _dual(instance, answer)
    lower = max(reference.lower, own)
    feasible = reference.verdict == "feasible"
    gap = (upper - lower) / reference.scale if feasible else np.inf
    numbers = (error, violation, gap, lower, min(upper, reference.upper), own, answer.dimacs)
    if answer.claims in ("failed", "inaccurate"):
        return Judgement(answer.claims, *numbers)
    allowed = SLACK * asked
    kept = answer.own_error is not None and answer.own_error <= allowed
    if answer.claims in ("infeasible", "unbounded"):
        wrong = f"claims {answer.claims}, which is proved wrong"
        if reference.verdict == "infeasible" and answer.claims == "infeasible":
            return Judgement("right", *numbers)
        if reference.verdict == "unknown":
            return Judgement("inaccurate", *numbers, "whether anything is feasible is not proved")
    elif reference.verdict == "infeasible":
        wrong = "solves what is proved infeasible"
    elif violation > allowed:
        wrong = "violates the constraints"
    elif not error <= allowed:
        wrong = "the objective lies outside of the proved interval"
    elif reference.gap > allowed and feasible:
        return Judgement("inaccurate", *numbers, "our interval is wider than what was asked")
    else:
        return Judgement("right", *numbers)
    if kept:
        return Judgement("inaccurate", *numbers, f"{wrong}, within the solver's own tolerance")
    return Judgement("silently_wrong", *numbers, wrong)


def _primal(instance: Instance, reference: Reference, theta: Array) -> tuple[float, float, float]:
    """Relative distance of the objective from the interval, relative violation, repaired upper bound."""
    if not np.all(np.isfinite(theta)):
        return np.inf, np.inf, np.inf
    interior = instance.interior
    inside = instance.task.nominal if interior is None else interior
    violation = relative_violation(instance.constraints.convex, theta, inside, instance.task.bound)
    if interior is None or reference.verdict != "feasible":
        return np.inf, violation, np.inf
    value = _value(instance, theta)
    error = max(value - reference.upper, reference.lower - value, 0.0) / reference.scale
    point = verified.feasible_point(instance.constraints.convex, theta, instance.near)
    upper = np.inf if point is None else verified.upper_bound(instance.objective, point)
    return error, violation, upper


def _value(instance: Instance, theta: Array) -> float:
    """The objective as returned; where the entropy is not defined, that of the least squares alone."""
    value = instance.objective.value(theta)
    return value if np.isfinite(value) else instance.data.loss(theta)


def conic_errors(
    problem: ConicProblem, x: Array, z: Array, claims: str = "optimal"
) -> tuple[float, float]:
    """The largest DIMACS error of a conic solution, and the largest error relative to all terms; of a
    claim that there is no optimum, that of its proof.

    With s = b - A x: the distances of s and z from their cones, stationarity P x + q + A^T z, and the
    gap. DIMACS (Mittelmann, 2003): relative to 1 + the largest entries of b and q, and to 1 + both
    objectives. Solvers' own criteria (Clarabel, SCS): relative to the largest of all terms that are
    summed up, and 1; the gap is the smaller of that of the objectives and s^T z with s in its cone, of
    which CSDP judges itself by the second: how far s is outside is an error apart. Infinite for numbers
    that are none.
    """
    if claims in ("infeasible", "unbounded"):
        error = _error_of_proof(problem, z) if claims == "infeasible" else _error_of_ray(problem, x)
        return error, error
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(z))):
        return np.inf, np.inf
    s = problem.b - problem.A @ x
    force, pull = (problem.P + sparse.triu(problem.P, 1).T) @ x, problem.A.T @ z
    half = 0.5 * float(x @ force)
    primal, dual = half + float(problem.q @ x), -half - float(problem.b @ z)
    outside, outside_dual = _outside(problem, s), _outside(problem, z, dual=True)
    left = force + problem.q + pull
    complement = float(_into_cones(problem, s) @ z)
    b, q, largest = _largest(problem.b), _largest(problem.q), _largest(force, pull)
    dimacs = (
        outside / (1.0 + b),
        max(outside_dual, float(np.linalg.norm(left))) / (1.0 + q),
        abs(primal - dual) / (1.0 + abs(primal) + abs(dual)),
    )
    own = (
        outside / max(1.0, b, _largest(s)),
        max(outside_dual, _largest(left)) / max(1.0, q, largest, _largest(z)),
        min(abs(primal - dual), abs(complement)) / max(1.0, min(abs(primal), abs(dual))),
    )
    return max(dimacs), max(own)


def _error_of_proof(problem: ConicProblem, z: Array) -> float:
    """How far z is from a proof that nothing is feasible: z in K*, A^T z = 0, b^T z = -1.

    A z of error e leaves room for x beyond about 1 / e: a solver whose criterion this is keeps its
    promise where it calls a problem infeasible whose points all lie that far out. Infinite for no proof.
    """
    size = -float(problem.b @ z)
    if not (np.all(np.isfinite(z)) and size > 0.0):
        return np.inf
    pull = float(np.linalg.norm(problem.A.T @ z)) / max(1.0, float(np.linalg.norm(problem.q)))
    return max(pull, _outside(problem, z, dual=True)) / size


def _error_of_ray(problem: ConicProblem, x: Array) -> float:
    """How far x is from a direction of unbounded descent: -A x in K, P x = 0, q^T x = -1."""
    size = -float(problem.q @ x)
    if not (np.all(np.isfinite(x)) and size > 0.0):
        return np.inf
    bend = float(np.linalg.norm((problem.P + sparse.triu(problem.P, 1).T) @ x))
    return max(bend, _outside(problem, -(problem.A @ x))) / max(1.0, _largest(problem.b)) / size


def _largest(*vectors: Array) -> float:
    return max(float(np.abs(v).max(initial=0.0)) for v in vectors)


def _outside(problem: ConicProblem, values: Array, dual: bool = False) -> float:
    """How far rows lie outside of their cones (or of the dual ones), in the rows' own unit."""
    worst, start = 0.0, 0
    for cone in problem.cones:
        part = values[start : start + cone.rows]
        start += cone.rows
        if cone.kind == "zero":
            worst = max(worst, 0.0 if dual else float(np.abs(part).max(initial=0.0)))
        elif cone.kind == "exp":
            worst = max(worst, _outside_exponential(part, dual))
        elif len(part):
            shaped = unsvec(part, cone.size) if cone.kind == "psd" else part
            worst = max(worst, -float(cone_margin(cone.kind, shaped)))
    return worst


def _into_cones(problem: ConicProblem, values: Array) -> Array:
    """The nearest rows in their cones; exponential ones as they are."""
    out, start = values.copy(), 0
    for cone in problem.cones:
        own = slice(start, start + cone.rows)
        start += cone.rows
        if cone.kind == "zero":
            out[own] = 0.0
        elif cone.kind == "psd":
            out[own] = svec(project("psd", unsvec(values[own], cone.size)))
        elif cone.kind != "exp" and cone.rows:
            out[own] = project(cone.kind, values[own])
    return out


def _outside_exponential(v: Array, dual: bool) -> float:
    """y exp(x / y) <= z with y > 0; dual: -u exp(v / u) <= e w with u < 0; of either as z is missed."""
    x, y, z = v
    if dual:
        if x >= 0.0:
            return max(float(x), -float(y), -float(z), 0.0)
        return max(float(-x * np.exp(min(y / x - 1.0, 700.0)) - z), 0.0)
    if y <= 0.0:
        return max(float(x), -float(y), -float(z), 0.0)
    return max(float(y * np.exp(min(x / y, 700.0)) - z), 0.0)


def _dual(instance: Instance, answer: Answer) -> float:
    if answer.multipliers is None or not np.all(np.isfinite(answer.theta)):
        return -np.inf
    if not all(np.all(np.isfinite(m)) for m in answer.multipliers):
        return -np.inf
    slopes = answer.entropy_slopes
    if slopes is not None and not np.all(np.isfinite(slopes)):
        slopes = None
    try:
        value = instance.lower_bound(answer.theta, answer.multipliers, slopes)
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
