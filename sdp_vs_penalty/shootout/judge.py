"""What an answer is worth, whatever its author says of it and whatever was asked: one
standard for every contestant.

``objective_error``: how far the objective as returned lies from the proved interval,
relative to the loss in the units that were handed out; ``violation`` of the constraints as
returned, relative to each one's size. Beside them stand the dual gap that the
contestant's own multipliers prove, and its DIMACS errors. An answer is right to an
accuracy if both errors are within SLACK times it.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import pandas
import scipy

from sdp_vs_penalty.errors import Infeasible, InputError
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp, PosedSdp
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.robot.constraint import Constraint, cone_margin
from sdp_vs_penalty.shootout.instances import Instance
from sdp_vs_penalty.solvers.conic import Cone, Solution, unsvec
from sdp_vs_penalty.solvers.fit import Fit
from sdp_vs_penalty.solvers.identification import unit_diagonal_factors
from sdp_vs_penalty.solvers.proof import Proof, infeasibility_proof, optimum_proof

#: Classes of a run at an accuracy. "inaccurate": it claims an optimum and its errors are
#: larger than the accuracy, or it says itself that it is inaccurate. Two are claimed
#: optima with an error or violation above FAR. "far": the DIMACS errors are within what
#: was asked for, so the solver's own rule is met. "far_unchecked": they are not, or there
#: are none; the solver says that its rule is met, in norms that we do not check.
#: "false_claim": it claims infeasible or unbounded where an optimum is proved, or an
#: optimum without numbers. "unproved": no interval is proved that could judge it, and it
#: counts for nobody.
CLASSES = (
    *("right", "inaccurate", "far", "far_unchecked", "false_claim"),
    *("failed", "timeout", "crash", "unproved"),
)
#: DIMACS errors that solvers' own rules bound: of both cones, of the slope, and the gap.
OF_THE_RULE = [f"dimacs_{k}" for k in (2, 3, 4, 5)]

#: How far beyond an accuracy an answer may be and still count as right: solvers stop by
#: errors scaled in their own ways, of which ten times is the usual spread.
SLACK = 10.0
#: Errors beyond which a claimed optimum is far: not even right to 1e-4.
FAR = 1e-3
#: A proved interval that is wider, relative to the loss, judges nobody.
JUDGED_TO = 1e-8


@dataclass(frozen=True)
class Reference(JsonRecord):
    """What is proved of an instance's optimum."""

    #: "feasible" (with an interval that judges), "infeasible" (proved) or "unknown".
    verdict: str
    #: Rigorous lower bound of the optimum.
    lower: float = -np.inf
    #: Rigorous upper bound of the optimum.
    upper: float = np.inf
    #: Size of the objective that errors are relative to.
    scale: float = 1.0


def proved(instance: Instance) -> tuple[str, Proof | None]:
    """Prove an instance's optimum, or that it is infeasible, in rational arithmetic.

    Returns
    -------
    tuple of (str, Proof or None)
        "optimum proved", "proved infeasible" or "not proved", and the proof.
    """
    names = [p.name for p in instance.task.model.parameters]
    with suppress(InputError, ValueError, np.linalg.LinAlgError):
        # Only what the rational checker accepts is called proved: it raises for the rest.
        try:
            posed = PosedSdp(instance.task, instance.problem, "clarabel")
            fit = posed.fit(LmiSdp.accuracy)
            return "optimum proved", optimum_proof(fit, names)
        except Infeasible as error:
            if error.proof is not None:
                return "proved infeasible", infeasibility_proof(*error.proof, names)
    return "not proved", None


def reference(instance: Instance) -> Reference:
    """Return the proved interval of an instance's optimum, which judges all answers.

    Returns
    -------
    Reference
        Verdict "feasible", "infeasible" or "unknown"; the interval is finite for the
        first one only.
    """
    status, proof = proved(instance)
    if proof is None:
        return Reference("unknown")
    if status == "proved infeasible":
        return Reference("infeasible")
    loss = instance.data.loss(np.array(proof["theta"], float))
    scale = max(loss, instance.least_loss, 1e-300)
    lower, upper = float(proof["lower"]), float(proof["upper"])
    verdict = "feasible" if upper - lower <= JUDGED_TO * scale else "unknown"
    return Reference(verdict, lower, upper, scale)


@dataclass(frozen=True)
class Answer:
    """What a contestant returned."""

    #: (p,) parameters in the instance's units; NaN without a solution.
    theta: Array
    #: "optimal", "inaccurate", "infeasible", "unbounded" or "failed".
    claims: str
    #: The contestant's status, in its words.
    status: str
    #: Multipliers of the constraints, as of a Fit; None without a dual.
    multipliers: Array | None = None
    #: Slopes of the entropic terms, as of a Fit; None where there are none.
    entropy_slopes: Array | None = None
    #: Number of runs that went into the answer, where the contestant starts several.
    attempts: int = 1
    #: Processor time of writing and reading files, which is no work of the solver [s].
    file_seconds: float = 0.0
    #: Solution of the conic form that was handed out; None where that was not.
    solution: Solution | None = None


@dataclass(frozen=True)
class Judgement:
    """The figures of an answer, which say at each accuracy what it is."""

    #: "claim" (of an optimum, or that there is none), or its class at every accuracy.
    outcome: str
    #: The larger of ``objective_error`` and ``violation``, of a point of an infeasible
    #: problem ``violation``; 0 for a claim that is proved right, inf for one that is
    #: proved wrong.
    error: float = np.inf
    #: Distance of the objective from the proved interval, relative.
    objective_error: float = np.inf
    #: Violation of the constraints, relative (:func:`relative_violation`).
    violation: float = np.inf
    #: Distance from the proved upper bound to what the contestant's own multipliers
    #: prove, relative.
    own_gap: float = np.inf
    #: What is wrong with the answer, in words; "" for nothing.
    remark: str = ""
    #: DIMACS errors 1 to 6 (Mittelmann, Math. Program. 2003); NaN where they are not
    #: defined.
    dimacs: tuple[float, ...] = (np.nan,) * 6


def classes(runs: pandas.DataFrame, accuracy: float) -> pandas.Series:
    """Return the class of each run at an accuracy, from its "outcome", its "error", its
    DIMACS errors and the "accuracy" that was asked for."""
    error = runs["error"]
    # NaN where a run has no DIMACS error.
    beyond = runs[OF_THE_RULE].abs().max(axis=1) / runs["accuracy"]
    is_class = {
        "right": error <= SLACK * accuracy,
        "inaccurate": error <= FAR,
        "false_claim": ~np.isfinite(error),
        "far": beyond <= SLACK,
    }
    of_claims = np.select(list(is_class.values()), list(is_class), "far_unchecked")
    return runs["outcome"].where(runs["outcome"] != "claim", of_claims)


def no_answer(instance: Instance, error: InputError | str) -> Answer:
    """Return the answer of a contestant that found no solution.

    Returns
    -------
    Answer
        theta is NaN. It claims "infeasible" if the error comes with a proof, else
        "failed".
    """
    nothing = np.full(len(instance.task.bound), np.nan)
    claims = "infeasible" if isinstance(error, Infeasible) and error.proof else "failed"
    return Answer(nothing, claims, str(error))


def judge(instance: Instance, reference: Reference, answer: Answer) -> Judgement:
    """Judge an answer by the proved interval, whatever the contestant says of it."""
    errors = _primal(instance, reference, answer.theta)
    claims = answer.claims
    error = float(np.max(errors))
    remark = ""
    outcome = "claim"
    if claims in ("failed", "inaccurate"):
        outcome = claims
    elif reference.verdict == "unknown":
        outcome = "unproved"
    elif claims in ("infeasible", "unbounded"):
        is_proved = reference.verdict == claims
        error = 0.0 if is_proved else np.inf
        remark = "" if is_proved else f"claims {claims}, which is proved wrong"
    elif reference.verdict == "infeasible":
        # At an accuracy looser than the violation the point is not wrong.
        error, remark = errors[1], "solves what is proved infeasible"
    return Judgement(
        outcome,
        error,
        *errors,
        own_gap=(reference.upper - _dual(instance, answer)) / reference.scale,
        remark=remark,
        dimacs=dimacs_errors(instance, answer.solution),
    )


def dimacs_errors(instance: Instance, solution: Solution | None) -> tuple[float, ...]:
    """Return the six DIMACS errors of a solution of the conic form that was handed out.

    For: minimise x^T P x / 2 + q^T x with s = b - A x in K, and z in K*. Error 1 is 0,
    since s is not the solver's; 2 and 4 are the violations of K by s and of K* by z, 3
    is |P x + q + A^T z|, 5 the gap of the objectives, 6 is s^T z. 1 and 2 are relative to
    1 + |b|, 3 and 4 to 1 + |q|, 5 and 6 to the objectives. NaN without such a solution,
    or with exponential cones.
    """
    undefined = (np.nan,) * 6
    problem = instance.sdp.conic
    if solution is None or any(c.kind == "exp" for c in problem.cones):
        return undefined
    x, z = solution.x, solution.z
    s = problem.b - problem.A @ x
    if not (np.all(np.isfinite(s)) and np.all(np.isfinite(z))):
        return undefined
    P = problem.P + scipy.sparse.triu(problem.P, 1).T
    square = float(x @ (P @ x))
    primal = 0.5 * square + float(problem.q @ x)
    dual = -0.5 * square - float(problem.b @ z)
    slope = float(np.linalg.norm(P @ x + problem.q + problem.A.T @ z))
    of_b = 1.0 + float(np.linalg.norm(problem.b))
    of_q = 1.0 + float(np.linalg.norm(problem.q))
    of_both = 1.0 + abs(primal) + abs(dual)
    return (
        0.0,
        _violation(problem.cones, s) / of_b,
        slope / of_q,
        _violation(problem.cones, z, is_dual=True) / of_q,
        (primal - dual) / of_both,
        float(s @ z) / of_both,
    )


def _violation(cones: Sequence[Cone], value: Array, is_dual: bool = False) -> float:
    """Return how far the worst part of a vector lies outside of its cone, or of the dual
    cone: all cones here are their own duals but "zero", whose dual is everything."""
    worst = 0.0
    parts = np.split(value, np.cumsum([cone.rows for cone in cones])[:-1])
    for cone, part in zip(cones, parts, strict=True):
        if cone.kind != "zero":
            member = unsvec(part, cone.size) if cone.kind == "psd" else part
            worst = max(worst, -_margin(cone.kind, member))
        elif not is_dual:
            worst = max(worst, float(np.abs(part).max(initial=0.0)))
    return worst


def _margin(kind: str, value: Array) -> float:
    """Return how deep a vector or symmetric matrix lies in its cone, negative outside."""
    if kind == "psd":
        return float(np.linalg.eigvalsh(value)[0])
    return float(cone_margin(kind, value))


def _primal(
    instance: Instance, reference: Reference, theta: Array
) -> tuple[float, float]:
    """Compute the error and the violation of an answer's theta.

    Parameters
    ----------
    reference : Reference
        The proved interval of its optimum.
    theta : (p,) array
        The answer; NaN if there is none.

    Returns
    -------
    tuple of (float, float)
        Distance of the objective from the interval, relative to the loss (inf unless a
        feasible point is proved), and relative violation of the constraints.
    """
    if not np.all(np.isfinite(theta)):
        return np.inf, np.inf
    violation = relative_violation(
        instance.constraints.convex,
        theta,
        instance.inside,
        instance.task.bound,
        instance.least_size,
    )
    if reference.verdict != "feasible":
        return np.inf, violation
    value = instance.problem.value(theta)
    if not np.isfinite(value):  # the entropy is not defined there
        value = instance.data.loss(theta)
    distance = max(value - reference.upper, reference.lower - value, 0.0)
    return distance / reference.scale, violation


def _dual(instance: Instance, answer: Answer) -> float:
    """Return the rigorous lower bound of the optimum that the contestant's multipliers
    prove.

    -inf if it returned no multipliers, or numbers that are not finite.
    """
    multipliers = answer.multipliers
    slopes = answer.entropy_slopes
    if multipliers is None:
        return -np.inf
    arrays = [x for x in (answer.theta, multipliers, slopes) if x is not None]
    if not all(np.all(np.isfinite(values)) for values in arrays):
        return -np.inf
    fit = Fit(answer.theta, instance.problem, multipliers, slopes)
    with suppress(np.linalg.LinAlgError):
        return float(np.nan_to_num(fit.lower, nan=-np.inf))
    return -np.inf


def relative_violation(
    constraints: Sequence[Constraint],
    theta: Array,
    inside: Array,
    bound: Array,
    least_size: float = 0.0,
) -> float:
    """Return the worst violation of the constraints, independent of units.

    Each cone is scaled by its size at an interior point. For a matrix F(theta) the
    violation is the negative smallest eigenvalue of D F(theta) D, where D F(inside) D
    has a unit diagonal; for rows it is relative to the largest term that they can hold.

    Parameters
    ----------
    theta : (p,) array
        The parameters that are judged.
    inside : (p,) array
        A point that is strictly feasible.
    bound : (p,) array
        Largest absolute value of each parameter.
    least_size : float
        No cone's size counts as less.

    Returns
    -------
    float
        0 if theta is feasible.
    """
    worst = 0.0
    for c in constraints:
        value = c.value(theta)
        if c.cone == "psd":
            (factors,) = unit_diagonal_factors(c.value(inside)[None])
            sides = np.sqrt(np.maximum(1.0 / np.diagonal(factors), least_size))
            size = np.outer(sides, sides)
        else:
            terms = np.abs(c.coefficients * bound[c.indices, None]).max(axis=0)
            size = nonzero_or_one(np.maximum(terms, np.abs(c.constant)))
            # The rows of a second-order cone form one cone and have one scale.
            size = np.maximum(size.max() if c.cone == "soc" else size, least_size)
        worst = max(worst, -_margin(c.cone, value / size))
    return worst
