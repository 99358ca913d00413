"""What an answer is worth, whatever its author says of it: one standard for every
contestant.

``objective_error``: how far the objective as returned lies from the proved interval,
relative to the loss; ``violation`` of the constraints as returned, relative to each
one's size; beside them the dual gap from the contestant's own multipliers. The classes
are those of the table in summary.md.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.errors import Infeasible, InputError
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp, PosedSdp
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.robot.constraint import Constraint, cone_margin
from sdp_vs_penalty.shootout.instances import Instance
from sdp_vs_penalty.solvers.fit import Fit
from sdp_vs_penalty.solvers.identification import unit_diagonal_factors
from sdp_vs_penalty.solvers.proof import Proof, infeasibility_proof, optimum_proof

CLASSES = ("right", "inaccurate", "silently_wrong", "failed", "timeout", "crash")

#: How far beyond what was asked an answer may be and still count as right: solvers stop
#: by errors scaled in their own ways, of which ten times is the usual spread.
SLACK = 10.0


@dataclass(frozen=True)
class Reference:
    """lower <= optimum <= upper, both rigorous; scale : what gaps are relative to.

    verdict : "feasible" (a strictly feasible point is proved), "infeasible" (proved) or
    "unknown".
    """

    verdict: str
    lower: float
    upper: float
    scale: float

    @property
    def gap(self) -> float:
        """Width of the proved interval, relative to ``scale``."""
        return (self.upper - self.lower) / self.scale


def proved(instance: Instance) -> tuple[str, Proof | None]:
    """Prove an instance's optimum, or that it is infeasible, in rational arithmetic.

    Parameters
    ----------
    instance : Instance
        The problem.

    Returns
    -------
    tuple of (str, Proof or None)
        "optimum proved", "proved infeasible" or "not proved", and the proof.
    """
    task = instance.task
    constraints = instance.constraints
    names = [p.name for p in task.model.parameters]
    with suppress(InputError, ValueError, np.linalg.LinAlgError):
        # Nothing in between: what the rational checker does not accept is not called
        # proved.
        try:
            posed = PosedSdp(task, instance.objective, constraints, "clarabel")
            fit = posed.fit(instance.objective, LmiSdp.accuracy)
            return "optimum proved", optimum_proof(fit, names)
        except Infeasible as error:
            if error.proof is not None:
                return "proved infeasible", infeasibility_proof(
                    *error.proof, task.bound, names
                )
    return "not proved", None


def reference(instance: Instance) -> Reference:
    """Return the proved interval of an instance's optimum, which judges all answers.

    Parameters
    ----------
    instance : Instance
        The problem.

    Returns
    -------
    Reference
        Verdict "feasible", "infeasible" or "unknown"; the interval is finite for the
        first one only.
    """
    status, proof = proved(instance)
    if proof is None:
        return Reference("unknown", lower=0.0, upper=np.inf, scale=1.0)
    if status == "proved infeasible":
        return Reference("infeasible", lower=0.0, upper=np.inf, scale=1.0)
    scale = instance.data.loss_scale(np.array(proof["theta"], float))
    return Reference(
        "feasible", float(proof["lower"]), float(proof["upper"]), max(scale, 1e-300)
    )


@dataclass(frozen=True)
class Answer:
    """What a contestant returned. multipliers : of a Fit, or None without a dual;
    attempts : runs that went into it, as far as the contestant starts several."""

    theta: Array
    claims: str
    status: str
    multipliers: Array | None = None
    entropy_slopes: Array | None = None
    attempts: int = 1


@dataclass(frozen=True)
class Judgement:
    """class of a run; objective_error, violation : of the answer as returned, relative;
    own_gap : from the proved upper bound to what the contestant's own multipliers
    prove, relative."""

    kind: str
    objective_error: float = np.inf
    violation: float = np.inf
    own_gap: float = np.inf
    remark: str = ""


def no_answer(instance: Instance, error: InputError | str) -> Answer:
    """Return the answer of a contestant that found no solution.

    Parameters
    ----------
    instance : Instance
        The problem.
    error : InputError or str
        The contestant's message.

    Returns
    -------
    Answer
        theta is NaN. It claims "infeasible" if the error comes with a proof, else
        "failed".
    """
    nothing = np.full(len(instance.task.bound), np.nan)
    claims = "infeasible" if isinstance(error, Infeasible) and error.proof else "failed"
    return Answer(nothing, claims, str(error))


def judge(
    instance: Instance, reference: Reference, answer: Answer, accuracy: float
) -> Judgement:
    """Classify an answer by the proved interval, whatever the contestant says of it.

    Parameters
    ----------
    instance : Instance
        The problem.
    reference : Reference
        Its proved interval.
    answer : Answer
        What the contestant returned.
    accuracy : float
        Relative accuracy that was asked for.

    Returns
    -------
    Judgement
        Class, error of the objective, violation of the constraints, and dual gap.
    """
    error, violation = _primal(instance, reference, answer.theta)
    dual_gap = (reference.upper - _dual(instance, answer)) / reference.scale
    kind = answer.claims
    remark = ""
    if answer.claims not in ("failed", "inaccurate"):
        kind, remark = classified(reference, answer.claims, error, violation, accuracy)
    return Judgement(kind, error, violation, dual_gap, remark)


def classified(
    reference: Reference, claims: str, error: float, violation: float, accuracy: float
) -> tuple[str, str]:
    """Classify an answer that claims an optimum, infeasibility or unboundedness.

    An answer is right within SLACK times the accuracy, and inaccurate while at least
    half of the digits are right (the square root of the accuracy). Beyond that it is
    silently wrong, because it claims success.

    Parameters
    ----------
    reference : Reference
        The proved interval.
    claims : str
        "optimal", "infeasible" or "unbounded".
    error : float
        Relative distance of the objective from the interval.
    violation : float
        Relative violation of the constraints.
    accuracy : float
        Relative accuracy that was asked for.

    Returns
    -------
    tuple of (str, str)
        The class, and the reason if the answer is not right.
    """
    allowed = SLACK * accuracy
    half_of_digits = max(allowed, accuracy**0.5)
    if claims in ("infeasible", "unbounded"):
        if reference.verdict == claims:
            return "right", ""
        if reference.verdict == "unknown":
            return "inaccurate", "whether anything is feasible is not proved"
        return "silently_wrong", f"claims {claims}, which is proved wrong"
    if reference.verdict == "infeasible":
        return "silently_wrong", "solves what is proved infeasible"
    if violation <= allowed and error <= allowed:  # False for NaN
        if reference.gap > allowed and reference.verdict == "feasible":
            return "inaccurate", "our interval is wider than what was asked"
        return "right", ""
    what = "the objective lies outside of the proved interval"
    if violation > allowed:
        what = "violates the constraints"
    if violation <= half_of_digits and error <= half_of_digits:
        return "inaccurate", f"{what}, with at least half of the digits asked for"
    return "silently_wrong", what


def _primal(
    instance: Instance, reference: Reference, theta: Array
) -> tuple[float, float]:
    """Compute the error and the violation of an answer's theta.

    Parameters
    ----------
    instance : Instance
        The problem.
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
    interior = instance.interior
    inside = instance.task.nominal if interior is None else interior
    violation = relative_violation(
        instance.constraints.convex, theta, inside, instance.task.bound
    )
    if reference.verdict != "feasible":
        return np.inf, violation
    value = instance.objective.value(theta)
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
    fit = Fit(
        answer.theta,
        instance.objective,
        instance.constraints,
        multipliers,
        slopes,
        bound=instance.task.bound,
    )
    with suppress(np.linalg.LinAlgError):
        return float(np.nan_to_num(fit.lower, nan=-np.inf))
    return -np.inf


def relative_violation(
    constraints: Sequence[Constraint], theta: Array, inside: Array, bound: Array
) -> float:
    """Return the worst violation of the constraints, independent of units.

    Each cone is scaled by its size at an interior point. For a matrix F(theta) the
    violation is the negative smallest eigenvalue of D F(theta) D, where D F(inside) D
    has a unit diagonal; for rows it is relative to the largest term that they can hold.

    Parameters
    ----------
    constraints : sequence of Constraint
        Convex constraints.
    theta : (p,) array
        The judged parameters.
    inside : (p,) array
        A strictly feasible point.
    bound : (p,) array
        Largest absolute value of each parameter.

    Returns
    -------
    float
        0 if theta is feasible.
    """
    worst = 0.0
    for c in constraints:
        value = c.value(theta)
        if c.cone == "psd":
            (scale,) = unit_diagonal_factors(c.value(inside)[None])
            margin = float(np.linalg.eigvalsh(value * scale)[0])
        else:
            terms = np.abs(c.coefficients * bound[c.indices, None]).max(axis=0)
            size = nonzero_or_one(np.maximum(terms, np.abs(c.constant)))
            # The rows of a second-order cone belong together and have one scale.
            size = size.max() if c.cone == "soc" else size
            margin = float(cone_margin(c.cone, value / size))
        worst = max(worst, -margin)
    return worst
