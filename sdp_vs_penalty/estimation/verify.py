"""The verb ``verify``: what a proof proves, and whether it is of this model and these data."""

from fractions import Fraction
from pathlib import Path
from typing import Any

from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.pose import PoseOptions, pose
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.files import reading
from sdp_vs_penalty.solvers import verify_proof
from sdp_vs_penalty.solvers.proof import Proof, difference, stated


def verify_proof_file(
    path: str | Path, model: Estimate | None = None, data: Source | None = None
) -> tuple[bool, str]:
    """Whether the proof in a file holds (:mod:`~sdp_vs_penalty.solvers.verify_proof`) and is about the
    model and the measurements, where they are given; and the sentences that say what is proved.

    Raises InputError for a file that cannot be read, and measurements without a model.
    """
    if data is not None and model is None:
        raise InputError("verify(data=...) without a model", "give the model too")
    try:
        with reading(path, verify_proof.MAX_BYTES):
            proof = verify_proof.read(path)
        found = verify_proof.check(proof)
    except InputError:
        raise
    except Exception as error:
        return False, f"refused: {path}: {error or type(error).__name__}"
    said = [f"accepted: {path}: no parameters satisfy all constraints, in exact arithmetic"]
    if found is not None:
        low, high = (float(x) for x in found)
        said = [
            f"accepted: {path}: the least objective lies in [{low!r}, {high!r}], in exact arithmetic"
        ]
        said += ["proved is this of the numbers in the file; that the model describes the robot is not"]
    if model is None:
        return True, "; ".join([*said, "name --model and --data to see what the numbers are made of"])
    fault = ""
    if proof["model"] != model.identity or "theta" not in proof:
        fault = "it is of another model"
    elif proof["parameters"] != [p.name for p in model.model.parameters]:
        fault = "its parameters, or their order, are not the model's"
    elif [Fraction(x) for x in proof["theta"]] != [Fraction(repr(x)) for x in model.theta.tolist()]:
        fault = "its theta is not the model's"
    if fault:
        return False, f"refused: {path}: {fault}"
    said.append("it is of this model")
    if data is not None:
        runs = as_measurements(data, model.robot.n, model.robot.joint_names, "verify(data=...)")
        if proof["data"] != runs.data_hash:
            return False, f"refused: {path}: it is of other measurements (or of another --window)"
        own = _reposed(model, runs)
        if own is not None and (fault := difference(proof, own)):
            return False, f"refused: {path}: these measurements make another problem: {fault}"
        how = "make its numbers, constraints and bounds (recomputed in floating point)"
        if own is None:
            how = "are the ones it names (its numbers, constraints and bounds were not recomputed)"
        said.append(f"these measurements {how}")
    return True, "; ".join(said)


def _reposed(model: Estimate, data: Measurements) -> Proof | None:
    """The problem that the data make, posed as the model says.

    None for a method that poses none. The scale that known loads gave a log without torque is the
    model's: their runs are not given here.
    """
    estimator, recipe = model.estimator, model.details.get("recipe")
    if not isinstance(estimator, LmiSdp) or (recipe is None and not data.torque_logged):
        return None
    settings: dict[str, Any] = {"preprocessing": model.preprocessing, "weighting": model.weighting}
    options = PoseOptions(model.model.effects, **settings)
    if recipe is not None:
        options = PoseOptions.following(recipe, model.robot, **settings)
    task = pose(model.problem, data, options).task
    objective, constraints = estimator.posed(task)
    return stated(objective, constraints.convex, task.bound, [p.name for p in task.model.parameters])
