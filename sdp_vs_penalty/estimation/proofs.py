"""Proofs of an optimum: written with a model, and ``verify``: what a proof proves, and
whether it is of this model and these data."""

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import (
    EstimationProblem,
    PoseOptions,
    build_problem,
)
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimators.estimator import Fit, Task
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.files import reading
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers import verify_proof
from sdp_vs_penalty.solvers.proof import Proof, difference, optimum_proof, stated
from sdp_vs_penalty.solvers.rigorous_bounds import TIGHT

#: What a proof that is wrong in any way raises: a form or claim that does not hold, an
#: index out of range, an operation of numbers, too deep a nesting, too large a content.
_FAILURES_OF_PROOFS = (
    ValueError,
    LookupError,
    ArithmeticError,
    RecursionError,
    MemoryError,
)


def proved(
    task: Task,
    fit: Fit,
    theta: Array,
    method: str,
    made_of: Mapping[str, str] | None = None,
) -> Proof:
    """Build the proof that theta's objective is within its interval of the optimum.

    Parameters
    ----------
    fit : Fit
        The method's solution with its multipliers.
    made_of : mapping of str to str, optional
        Hashes of model and data, which the proof names.

    Raises
    ------
    InputError
        For a method without a lower bound (not convex, or without constraints).
    """
    if fit.multipliers is None:
        what = f"method {method} has no lower bound to prove"
        raise InputError(
            what, "choose one that solves the SDP, such as lmi-sdp, or penalty"
        )
    names = [p.name for p in task.model.parameters]
    return optimum_proof(replace(fit, theta=theta), names, made_of)


def verify_proof_file(
    path: str | Path, model: Estimate | None = None, data: Source | None = None
) -> tuple[bool, str]:
    """Return whether the proof in a file holds and belongs to a model and its
    measurements, and what it proves or why it is refused.

    See :mod:`~sdp_vs_penalty.solvers.verify_proof`.

    Parameters
    ----------
    model : Estimate, optional
        Model to which it should belong.
    data : path, arrays, Measurements, optional
        Measurements from which the model was identified.

    Raises
    ------
    InputError
        For a file that cannot be read, and for measurements without a model.
    """
    if data is not None and model is None:
        raise InputError("verify(data=...) without a model", "give the model too")
    try:
        with reading(path, verify_proof.MAX_BYTES):
            proof = verify_proof.read(path)
        interval = verify_proof.check(proof)  # of the least objective; None: infeasible
    except InputError:
        raise
    except _FAILURES_OF_PROOFS as error:
        return False, f"refused: {path}: {error or type(error).__name__}"
    sentences = [f"accepted: {path}: {_what_is_proved(proof, interval)}"]
    if model is None:
        sentences.append("name --model and --data to see what the numbers are made of")
        fault = ""
    else:
        fault = _other_model(proof, model)
        sentences.append("it is of this model")
        if not fault and data is not None:
            runs = as_measurements(
                data, model.robot.n, model.robot.joint_names, "verify(data=...)"
            )
            fault, sentence = _other_data(proof, model, runs)
            sentences.append(sentence)
    if not fault and interval is not None:
        fault = verify_proof.weakness(proof)
        if not fault and model is not None:
            fault = _wider_than_certified(proof, model)
    if fault:
        return False, f"refused: {path}: {fault}"
    return True, "; ".join(sentences)


def _what_is_proved(
    proof: Mapping[str, Any], interval: tuple[Fraction, Fraction] | None
) -> str:
    """Return what a proof says of the numbers in its file, in a sentence.

    ``interval`` contains the smallest objective; None means that the proof shows that
    nothing satisfies the constraints.
    """
    if interval is None:
        claims = [c["name"] for c in proof["constraints"] if c["family"] == "claim"]
        with_claim = f" and have {claims[0]}" if claims else ""
        return f"no parameters satisfy all constraints{with_claim}, in exact arithmetic"
    low, high = map(float, interval)
    sentences = [
        f"the least objective lies in [{low!r}, {high!r}], in exact arithmetic"
    ]
    gap = verify_proof.relative_gap(proof)
    if gap is not None:
        sentences.append(f"its gap is {verify_proof.in_words(gap)} of the objective")
    sentences.append(
        "proved is this of the numbers in the file; that the model describes the robot"
        " is not"
    )
    return "; ".join(sentences)


def _wider_than_certified(proof: Mapping[str, Any], model: Estimate) -> str:
    """Return a sentence if the proof's interval of the optimum is wider than the model's
    certified one, else "".

    The two are computed in different arithmetic, so that a difference of TIGHT times the
    objective's size is allowed.
    """
    relative_gap = verify_proof.relative_gap(proof)
    upper, lower = model.certificate.upper, model.certificate.lower
    if upper is None or lower is None:
        return ""
    width = float(Fraction(proof["upper"]) - Fraction(proof["lower"]))
    allowed_width = upper - lower
    if relative_gap:
        objective_size = width / float(relative_gap)
        allowed_width += TIGHT * objective_size
    if width <= allowed_width:
        return ""
    return (
        f"its interval of {width:.1e} is wider than the {upper - lower:.1e} of the"
        " model's certificate"
    )


def _other_model(proof: Mapping[str, Any], model: Estimate) -> str:
    """Return a sentence on how a proof differs from a model, "" if it is of this model."""
    if proof["model"] != model.identity or "theta" not in proof:
        return "it is of another model"
    if proof["parameters"] != [p.name for p in model.model.parameters]:
        return "its parameters, or their order, are not the model's"
    theta = [Fraction(repr(x)) for x in model.theta.tolist()]
    if [Fraction(x) for x in proof["theta"]] != theta:
        return "its theta is not the model's"
    return ""


def _other_data(
    proof: dict[str, Any], model: Estimate, runs: Measurements
) -> tuple[str, str]:
    """Compare a proof with measurements.

    Returns two sentences: how the proof differs from the problem that these
    measurements make ("" if it does not), and what was compared ("" if it differs).
    """
    if proof["data"] != runs.data_hash:
        return "it is of other measurements (or of another --window)", ""
    reposed = _reposed(model, runs)
    how = "make its numbers, constraints and bounds (recomputed in floating point)"
    if reposed is None:
        how = (
            "are the ones it names (its numbers, constraints and bounds were not"
            " recomputed)"
        )
    elif other := difference(proof, reposed):
        return f"these measurements make another problem: {other}", ""
    return "", f"these measurements {how}"


def posed_again(model: Estimate, data: Measurements) -> EstimationProblem | None:
    """Pose the optimisation problem of a model again, from measurements.

    None for a log without torque whose recipe (how the servos' law and scale were
    found) the model does not keep.
    """
    if model.report.recipe is None and not data.torque_logged:
        return None
    return build_problem(model.problem, data, PoseOptions.of_model(model))


def _reposed(model: Estimate, data: Measurements) -> Proof | None:
    """State the optimisation problem of a model again, from its measurements.

    The result is compared with a proof. It is None for a method that solves no SDP, and
    for a log without torque whose recipe (how the servos' law and scale were found) the
    model does not keep.
    """
    estimator = model.estimator
    if not isinstance(estimator, LmiSdp):
        return None
    posed = posed_again(model, data)
    if posed is None:
        return None
    task = posed.task
    return stated(estimator.posed(task), [p.name for p in task.model.parameters])
