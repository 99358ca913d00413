"""Is a measured curve right? Its variables, band, formula, and what adding it buys on a new motion."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.diagnosis.adding import add
from sdp_vs_penalty.diagnosis.comparison import compare
from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.fit import orthonormal
from sdp_vs_penalty.diagnosis.library import spread_columns
from sdp_vs_penalty.diagnosis.rows import diagnosis_rows
from sdp_vs_penalty.diagnosis.stage import model_columns
from sdp_vs_penalty.effects import parse_effects
from sdp_vs_penalty.effects.curve_variable import Variable
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.simulation.challenge.truth import beyond_one_name, true_floor
from sdp_vs_penalty.simulation.worlds.hidden import Hidden
from sdp_vs_penalty.simulation.worlds.runs import Logged

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
