"""What a scorer knows and the diagnosis does not: how visible an effect is, how large
the noise is.

And whether a measured curve is right: its variables, and what adding it buys on a new
motion.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from challenge.worlds.runs import Logged
from sdp_vs_penalty.data.measurements import concatenate
from sdp_vs_penalty.diagnosis.adding import add
from sdp_vs_penalty.diagnosis.candidates import list_candidates
from sdp_vs_penalty.diagnosis.comparison import compare
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.white_rows import (
    diagnosis_rows,
    model_columns,
    white_rows,
    whiten_with_noise,
)
from sdp_vs_penalty.effects.measured_curve import Variable
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.regression.linalg import span
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import Noise, noise_in
from sdp_vs_penalty.signals.segments import SegmentedRuns
from sdp_vs_penalty.simulation.worlds.hidden import Hidden


def energies(logged: Sequence[Logged], estimate: Estimate, frozen: bool) -> list[float]:
    """Energy of each hidden effect's torque, white, the model's columns partialled out."""
    every = (_white(logged, estimate, frozen, k) for k in range(len(logged[0].shares)))
    return [float(np.sum(left**2)) for *_, left in every]


def beyond_one_name(logged: Sequence[Logged], estimate: Estimate, joint: int) -> float:
    """Energy of the first hidden torque beside the model and that effect of the library
    on its joint (from 0), as a search begins with it, which makes most of it: what
    shows that it has no name."""
    rows, noise, Q, left = _white(logged, estimate, False, 0)
    mine = slice(joint * len(rows.t), (joint + 1) * len(rows.t))
    best = 0.0
    for batch in list_candidates(
        whiten_with_noise(rows, noise, estimate, False)
    ).batches:
        for f in range(len(batch.forms)) if batch.joints == (joint,) else ():
            Z = batch.columns(f)[joint]
            overlap = Q[mine].T @ Z
            gram = Z.T @ Z - overlap.T @ overlap
            pull = Z.T @ left[mine]
            best = max(best, float(pull @ np.linalg.lstsq(gram, pull, rcond=1e-9)[0]))
    return float(np.sum(left**2)) - best


def _white(
    logged: Sequence[Logged], estimate: Estimate, frozen: bool, k: int
) -> tuple[SegmentedRuns, Noise, Array, Array]:
    """Rows and noise of the log; (n M, r) the model's white columns, orthonormal; (n
    M,) what they leave of the hidden torque k.

    White as the true noise is, which is the log less what perfect torque channels would
    have shown.
    """
    silent = _filtered([x.ideal.tau for x in logged], logged, estimate)
    rows = _filtered([x.run.tau for x in logged], logged, estimate)
    noise = noise_in(rows, rows.residual - silent.residual)
    without = _filtered([x.ideal.tau - x.shares[k] for x in logged], logged, estimate)
    columns = model_columns(rows, estimate, frozen)
    white = white_rows(rows, noise, columns)
    apart = silent.residual - without.residual
    change = white_rows(rows, noise, apart.T).ravel()
    Q = span(white.reshape(len(change), -1))
    return rows, noise, Q, change - Q @ (Q.T @ change)


def _filtered(
    taus: Sequence[Array], logged: Sequence[Logged], estimate: Estimate
) -> SegmentedRuns:
    """Rows of the logged positions with other torques."""
    data = concatenate(
        [replace(x.run, tau=tau) for x, tau in zip(logged, taus, strict=True)]
    )
    return diagnosis_rows(data, estimate, estimate.preprocessing.resolve(data))


def true_floor(test: Logged, estimate: Estimate) -> Array:
    """(n,) standard deviation of what noise, and the encoders' steps, leave of the
    filtered torque."""
    settings = estimate.preprocessing.resolve(test.run)
    runs = test.run, test.ideal, replace(test.run, tau=test.ideal.tau)
    rows = (diagnosis_rows(run, estimate, settings) for run in runs)
    real, ideal, stepped = (x.residual[x.keep[:, 0]] for x in rows)
    # The encoders' steps may change what counts as standstill.
    return np.asarray(
        (real - (ideal if real.shape == ideal.shape else stepped)).std(axis=0)
    )


def judged_curve(
    result: Diagnosis, hidden: Hidden, logged: Sequence[Logged], estimate: Estimate
) -> dict[str, Any]:
    """beyond : energy that no one effect of the library makes; variables : whether the
    first curve of the right joint has the right ones (|x| and sign(x) count as x);
    removed : share of the missing energy that adding what was found takes away on the
    test run; after : the error then over the floor.
    """
    (joint,) = hidden.joints
    own = [c for c in result.curves if c.joint == joint + 1]
    wanted = {_plain(v) for v in hidden.details["of"]}
    *learnt, test = logged
    settings = estimate.preprocessing.resolve(test.run)
    floor = float(true_floor(test, estimate)[joint])
    before = after = float(compare(estimate, test.run, settings)[0].rmse[joint])
    if result.curves or result.effects:
        bigger = add(estimate, result, concatenate([x.run for x in learnt]))
        after = float(compare(bigger, test.run, settings)[0].rmse[joint])
    excess = before**2 - floor**2
    return {
        "beyond": beyond_one_name(learnt, estimate, joint),
        "variables": bool(own) and {_plain(v) for v in own[0].of} == wanted,
        "removed": (
            1.0 - max(after**2 - floor**2, 0.0) / excess if excess > 0.0 else 1.0
        ),
        "after": after / floor,
    }


def _plain(name: str) -> str:
    v = Variable.parse(name)
    return replace(
        v, word={"sign(dq)": "dq", "abs(ddq)": "ddq"}.get(v.word, v.word)
    ).name
