"""What a scorer knows and the diagnosis does not: how visible an effect is, how large the noise is.

And whether a measured curve is right: its variables, band, formula, and what adding it buys on a new
motion.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.diagnosis.adding import add
from sdp_vs_penalty.diagnosis.comparison import compare
from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.library import library
from sdp_vs_penalty.diagnosis.score import orthonormal
from sdp_vs_penalty.diagnosis.whitening import (
    diagnosis_rows,
    model_columns,
    spread_columns,
    white_rows,
    whitened,
)
from sdp_vs_penalty.effects import parse_effects
from sdp_vs_penalty.effects.curve_variable import Variable
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import Noise, noise_in
from sdp_vs_penalty.signals.segments import SegmentedRuns
from sdp_vs_penalty.simulation.worlds.hidden import Hidden
from sdp_vs_penalty.simulation.worlds.runs import Logged


def energies(logged: Sequence[Logged], estimate: Estimate, frozen: bool) -> list[float]:
    """Energy of each hidden effect's torque, white, the model's columns partialled out."""
    return [_white(logged, estimate, frozen, k).energy for k in range(len(logged[0].shares))]


def beyond_one_name(logged: Sequence[Logged], estimate: Estimate, joint: int) -> float:
    """Energy of the first hidden torque beside the model and that effect of the library on its joint
    (from 0), as a search begins with it, which makes most of it: what shows that it has no name."""
    hidden = _white(logged, estimate, False, 0)
    rows, Q, M = hidden.rows, hidden.Q, len(hidden.rows.t)
    mine = slice(joint * M, (joint + 1) * M)
    best = 0.0
    for batch in library(whitened(rows, hidden.noise, estimate, False)).batches:
        for f in range(len(batch.forms)) if batch.joints == (joint,) else ():
            Z = batch.columns(f)[joint]
            overlap = Q[mine].T @ Z
            gram, pull = Z.T @ Z - overlap.T @ overlap, Z.T @ hidden.left[mine]
            best = max(best, float(pull @ np.linalg.lstsq(gram, pull, rcond=1e-9)[0]))
    return hidden.energy - best


@dataclass(frozen=True)
class _White:
    """rows, noise : of the log; Q (n M, r) : the model's white columns, orthonormal; left (n M,) : what
    they leave of a hidden torque.

    White as the true noise is, which is the log less what perfect torque channels would have shown.
    """

    rows: SegmentedRuns
    noise: Noise
    Q: Array
    left: Array

    @property
    def energy(self) -> float:
        return float(np.sum(self.left**2))


def _white(logged: Sequence[Logged], estimate: Estimate, frozen: bool, k: int) -> _White:
    silent = _filtered([x.ideal.tau for x in logged], logged, estimate)
    rows = _filtered([x.run.tau for x in logged], logged, estimate)
    noise = noise_in(rows, rows.residual - silent.residual)
    without = _filtered([x.ideal.tau - x.shares[k] for x in logged], logged, estimate)
    columns = model_columns(rows, estimate, frozen)
    white, apart = white_rows(rows, noise, columns, silent.residual - without.residual)
    change = apart.ravel()
    Q = orthonormal(white.reshape(len(change), -1))
    return _White(rows, noise, Q, change - Q @ (Q.T @ change))


def _filtered(taus: Sequence[Array], logged: Sequence[Logged], estimate: Estimate) -> SegmentedRuns:
    """Rows of the logged positions with other torques."""
    runs = [replace(x.run, tau=tau) for x, tau in zip(logged, taus, strict=True)]
    data = concatenate(runs)
    return diagnosis_rows(data, estimate, estimate.preprocessing.resolve(data))


def true_floor(test: Logged, estimate: Estimate) -> Array:
    """(n,) standard deviation of what noise, and the encoders' steps, leave of the filtered torque."""

    def residual(run: Measurements) -> Array:
        rows = diagnosis_rows(run, estimate, estimate.preprocessing)
        return rows.residual[rows.keep[:, 0]]

    real, ideal = residual(test.run), residual(test.ideal)
    if real.shape != ideal.shape:  # the encoders' steps change what counts as standstill
        ideal = residual(replace(test.run, tau=test.ideal.tau))
    return np.asarray((real - ideal).std(axis=0))


#: Relative error of a formula's constants.
CLOSE = 0.05


def judged_curve(
    result: Diagnosis,
    hidden: Hidden,
    logged: Sequence[Logged],
    estimate: Estimate,
    data: Measurements,
) -> dict[str, Any]:
    """found : a curve on the right joint; variables : the right ones (|x| and sign(x) count as x);
    covered : share of the rows at which the band holds the truth, both without what the columns of
    the model and of the findings beside it make; removed : share of the missing energy that adding the
    curves takes away on the test run; after : the joint's error then over the true floor; formula : None
    where the truth is not in the dictionary; beyond : energy that no one effect of the library makes."""
    (joint,) = hidden.joints
    own = [c for c in result.curves if c.joint == joint + 1]
    wanted = {_plain(v) for v in hidden.details["of"]}
    out: dict[str, Any] = {"found": bool(own), "elsewhere": len(result.curves) - len(own)}
    out["beyond"] = beyond_one_name(logged[:-1], estimate, joint)
    out["variables"] = bool(own) and {_plain(v) for v in own[0].of} == wanted
    words = hidden.details["words"]
    out["formula"] = None if words == "none" else bool(own) and same_formula(own[0], hidden)
    test = logged[-1]
    settled = replace(estimate, preprocessing=estimate.preprocessing.resolve(test.run))
    floor = float(true_floor(test, settled)[joint])
    before = float(compare(estimate, test.run, settled.preprocessing)[0].rmse[joint])
    after = before
    if result.curves or result.effects:
        bigger = add(estimate, result, data)
        judged = compare(bigger, test.run, settled.preprocessing)[0]
        after = float(judged.rmse[joint])
        out["outside"] = max(judged.outside.values(), default=0.0)
    out["after"] = after / floor
    excess = before**2 - floor**2
    out["removed"] = float(1.0 - max(after**2 - floor**2, 0.0) / excess) if excess > 0.0 else 1.0
    beside = parse_effects([f.text for f in result.beside_curves], estimate.robot)
    out["covered"] = _covered(own[0], beside, logged[:-1], estimate, data) if out["variables"] else None
    return out


def _plain(name: str) -> str:
    v = Variable.parse(name)
    word = {"sign(dq)": "dq", "abs(ddq)": "ddq", "phase": "q"}.get(v.word, v.word)
    return replace(v, word=word, order=1.0).name


def same_formula(curve: Curve, hidden: Hidden) -> bool:
    """Whether the formula has the truth's functions and constants, up to CLOSE; the truth's first
    constant is multiplied by the size."""
    if curve.formula is None:
        return False
    text = curve.formula.partition(" (")[0] if " in " in curve.formula else curve.formula
    law = re.sub(r"(sign\(dq\d+\)|abs\(ddq\d+\))", lambda m: m[0].split("(")[0] + " ", curve.formula)
    law = law.rpartition(" (")[0] or text
    functions = {w for w in ("sin", "tanh", "exp", "sat", "sqrt") if w in law}
    wanted = {w for w in hidden.details["words"].split() if w in ("sin", "tanh", "exp")}
    numbers = [abs(float(x)) for x in re.findall(r"(?<![\w.^])-?\d+\.?\d*(?:e[+-]?\d+)?", law)]
    first, *rest = hidden.details["numbers"]
    constants = [abs(first * hidden.size), *map(abs, rest)]
    near = (any(abs(x - c) <= CLOSE * c for x in numbers) for c in constants)
    return functions == wanted and all(near)


def _covered(
    curve: Curve,
    beside: Sequence[Effect],
    logged: Sequence[Logged],
    estimate: Estimate,
    data: Measurements,
) -> float:
    """Share of the kept rows of the joint; beside : what was named."""
    settings = estimate.preprocessing.resolve(data)
    rows = diagnosis_rows(data, estimate, settings)
    shares = [replace(x.run, tau=x.run.tau - x.shares[0]) for x in logged]
    without = diagnosis_rows(concatenate(shares), estimate, settings)
    if len(without.t) != len(rows.t):
        return float("nan")
    truth = rows.torque - without.torque
    table = spread_columns(rows, curve.effect(estimate.robot))[:, :, 0]
    named = (spread_columns(rows, e) for e in beside)
    columns = np.concatenate([model_columns(rows, estimate), *named], axis=2)
    keep = rows.keep.all(axis=1)
    apart = (truth.T - table)[:, keep].ravel()
    Q = orthonormal(columns[:, keep].reshape(len(apart), -1))
    left = (apart - Q @ (Q.T @ apart)).reshape(rows.n, -1)[curve.joint - 1]
    over = [Variable.parse(v) for v in curve.of]
    values = [np.concatenate([s.low_pass @ v.along(s.motion) for s in rows.segments]) for v in over]
    scale = np.maximum(np.ptp(curve.points, axis=0), 1e-12)
    _, nearest = cKDTree(curve.points / scale).query(np.column_stack(values)[keep] / scale)
    half = 0.5 * (curve.upper - curve.lower)[nearest]
    return float(np.mean(np.abs(left) <= half))
