"""The verb ``verify``: what a proof proves, and whether it is of this model and these data."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.sources import Source, as_measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.pose import PoseOptions, pose
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.files import reading
from sdp_vs_penalty.solvers import verify_proof
from sdp_vs_penalty.solvers.proof import Proof

#: Largest difference between the proof's numbers and the recomputed ones, relative to their columns'
#: norms: far above the rounding of two machines (1e-12), far below what any option changes.
_SAME = 1e-8


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
    if found is None:
        return True, f"accepted: {path}: no parameters satisfy all constraints, in exact arithmetic"
    low, high = (float(x) for x in found)
    said = [
        f"accepted: {path}: the least objective lies in [{low!r}, {high!r}], in exact arithmetic",
        "proved is this of the numbers in the file; that the model describes the robot is not",
    ]
    if model is None:
        return True, "; ".join([*said, "name --model and --data to see what the numbers are made of"])
    if proof["model"] != model.identity:
        return False, f"refused: {path}: it is of another model"
    said.append("it is of this model")
    if data is not None:
        runs = as_measurements(data, model.robot.n, model.robot.joint_names, "verify(data=...)")
        if proof["data"] != runs.data_hash:
            return False, f"refused: {path}: it is of other measurements (or of another --window)"
        problem = _reposed(proof, model, runs)
        if problem is False:
            return False, f"refused: {path}: these measurements make another optimisation problem"
        how = "make its numbers (recomputed in floating point)"
        said.append(f"these measurements {how if problem else 'are the ones it names'}")
    return True, "; ".join(said)


def _reposed(proof: Proof, model: Estimate, data: Source) -> bool | None:
    """Whether the data, posed again, are the proof's R, rho and floor; None for another method."""
    estimator = model.estimator
    if not isinstance(estimator, LmiSdp):
        return None
    options = PoseOptions(model.model.effects, model.preprocessing, model.weighting)
    objective, _ = estimator.posed(pose(model.problem, data, options).task)
    made = objective.least_squares
    rows = [[*row, r] for row, r in zip(proof["R"], proof["rho"], strict=True)]
    stated = np.array([[float(verify_proof.Fraction(x)) for x in row] for row in rows])
    floor = float(verify_proof.Fraction(proof["floor"]))
    own = np.column_stack([made.R, made.rho])
    if stated.shape[1] != own.shape[1]:
        return False
    grams = [part.T @ part for part in (stated, own)]
    for gram, rest in zip(grams, (floor, made.residual_norm), strict=True):
        gram[-1, -1] += rest**2
    size = np.sqrt(np.diagonal(grams[0]))
    return bool(np.all(np.abs(grams[0] - grams[1]) <= _SAME * np.outer(size, size)))
