"""A proof that travels: one JSON file from which anyone can check an optimum in rational arithmetic.

The file holds the problem (R, rho, floor, constraint arrays, bounds) as the rational numbers that the
doubles are, the estimate as it is written in model.json, multipliers that lie in the cones exactly, and
the interval. :mod:`verify_proof` checks it with the standard library alone; docs/proof.md is the format
in full. How R and rho came from the measured samples is outside of the proof: the file names the model
and the data by their hashes, which ``verify --model --data`` compares.

Weak duality as in :mod:`certificate`; Jansson, Chaykin, Keil, SIAM J. Numer. Anal. 2007, for bounds from
approximate multipliers.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sdp_vs_penalty.constraints.constraint import Constraint, ConstraintSet
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers import verify_proof
from sdp_vs_penalty.solvers.certificate import DualEvidence, dual_evidence
from sdp_vs_penalty.solvers.objective import Entropy, Objective

Proof = dict[str, Any]

#: How often y is shifted by what is left of the slope; each time the rest shrinks to rounding.
_POLISH = 3


def optimum_proof(
    objective: Objective,
    constraints: ConstraintSet,
    multipliers: Sequence[Array],
    theta: Array,
    bound: Array,
    entropy_slopes: Array | None = None,
    parameters: Sequence[str] = (),
    made_of: Mapping[str, str] | None = None,
) -> Proof:
    """The proof that min objective lies between a lower bound and the objective of ``theta``.

    theta (p,) : feasible exactly, as its decimal text says (:func:`verified.feasible_as_written`);
        made_of : hashes of the "model" and the "data".
    Raises ValueError where it is not, or the multipliers prove nothing.
    """
    evidence = dual_evidence(objective, constraints, multipliers, theta, bound, entropy_slopes)
    data = objective.least_squares
    proof: Proof = {
        **_problem("optimum", data, constraints.convex, bound, parameters, _duals(evidence)),
        "theta": [repr(float(x)) for x in theta],
        "y": _texts(evidence.y),
        "lower": "0",
        "upper": "0",
        **(made_of or {}),
    }
    if objective.entropy is not None:
        _add_entropy(proof, objective.entropy, constraints.convex, evidence.entropy_slopes)
    exact = verify_proof.typed(_signed(proof), verify_proof.OPTIMUM, {})
    proof["y"] = [_text(x) for x in _polished(exact, evidence, bound)]
    proof["lower"], proof["upper"] = _interval(exact)
    return _checked(proof)


def infeasibility_proof(
    constraints: Sequence[Constraint],
    multipliers: Sequence[Array],
    bound: Array,
    parameters: Sequence[str] = (),
) -> Proof:
    """The proof (Farkas) that no |theta_k| <= bound_k satisfies all constraints."""
    nothing = LeastSquares(np.zeros((0, len(bound))), np.zeros(0), 0.0, 0.0, 0)
    evidence = dual_evidence(
        Objective(nothing), ConstraintSet(tuple(constraints)), multipliers, np.zeros(len(bound)), bound
    )
    return _checked(
        {**_problem("infeasible", nothing, constraints, bound, parameters, _duals(evidence)), "y": []}
    )


def write_proof(proof: Proof, path: str | Path) -> None:
    """Write proof.json, whole or not at all."""
    write_text(path, json.dumps(proof, indent=0, sort_keys=True) + "\n")


def _problem(
    kind: str,
    data: LeastSquares,
    constraints: Sequence[Constraint],
    bound: Array,
    parameters: Sequence[str],
    duals: Sequence[Any],
) -> Proof:
    return {
        "format": verify_proof.FORMAT,
        "kind": kind,
        "model": "",
        "data": "",
        "parameters": list(parameters) or [f"x{k}" for k in range(len(bound))],
        "R": _texts(data.R),
        "rho": _texts(data.rho),
        "floor": _text(data.residual_norm),
        "bound": _texts(bound),
        "constraints": [
            {
                "family": c.family,
                "name": c.name,
                "cone": c.cone,
                "indices": c.indices.tolist(),
                "constant": _texts(c.constant.ravel()),
                "coefficients": _texts(c.coefficients.reshape(len(c.indices), -1)),
                "dual": dual,
                "entropy": [],
            }
            for c, dual in zip(constraints, duals, strict=True)
        ],
    }


def _duals(evidence: DualEvidence) -> list[Any]:
    """Of the constraints as they are, each inside its cone exactly: V V^T for a matrix."""
    out = []
    for c, multiplier, t in zip(
        evidence.constraints, evidence.multipliers, evidence.scales, strict=True
    ):
        if t is not None:  # the balanced S is T^-1 S T^-1
            out.append(_gram(t[:, None] * _factor(multiplier)))
        elif c.cone == "soc":
            across = [Fraction(float(x)) for x in multiplier[1:]]
            axis, square = Fraction(float(multiplier[0])), sum((x * x for x in across), Fraction(0))
            while axis < 0 or axis * axis < square:
                axis = Fraction(math.nextafter(max(float(axis), math.sqrt(float(square))), math.inf))
            out.append([_text(x) for x in (axis, *across)])
        else:
            out.append(_texts(np.maximum(multiplier, 0.0)))
    return out


def _factor(multiplier: Array) -> Array:
    """V with V V^T near a symmetric matrix, its negative eigenvalues left out."""
    values, vectors = np.linalg.eigh(0.5 * (multiplier + multiplier.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _gram(factor: NDArray[np.floating]) -> list[str]:
    """V V^T without rounding, row by row."""
    rows = [[Fraction(x) for x in row] for row in factor.tolist()]
    return [_text(verify_proof.dot(a, b)) for a in rows for b in rows]


def _add_entropy(
    proof: Proof, entropy: Entropy, constraints: Sequence[Constraint], slopes: Sequence[Array]
) -> None:
    """State the entropy, and its multipliers, with the constraints of which it is one."""
    for link, p0, slope in zip(entropy.links, entropy.nominal, slopes, strict=True):
        inverse = np.linalg.inv(p0)
        stated = {
            "weight": _text(entropy.weight),
            "dual": _gram(np.linalg.cholesky(0.5 * (slope + slope.T))),
            "inverse": _texts((0.5 * (inverse + inverse.T)).ravel()),
            "log_det": _text(float(np.linalg.slogdet(p0)[1])),
        }
        (place,) = (k for k, c in enumerate(constraints) if c is link)
        proof["constraints"][place]["entropy"].append(stated)


def _polished(exact: dict[str, Any], evidence: DualEvidence, bound: Array) -> list[Fraction]:
    """y, shifted until nothing is left of the slope wherever the data determine theta."""
    for _ in range(_POLISH):
        _, slope = verify_proof.dual_bound(exact)
        shift = evidence.push(bound * np.array([float(x) for x in slope]))
        exact["y"] = [a - Fraction(float(b)) for a, b in zip(exact["y"], shift, strict=True)]
    return list(exact["y"])


def _interval(exact: dict[str, Any]) -> tuple[str, str]:
    """Lower and upper bound, rounded outward to decimal numbers of 17 digits."""
    lower, slope = verify_proof.dual_bound(exact)
    lower -= sum((abs(e) * b for e, b in zip(slope, exact["bound"], strict=True)), Fraction(0))
    return _outward(lower, -math.inf), _outward(verify_proof.objective(exact), math.inf)


def _outward(x: Fraction, towards: float) -> str:
    double = float(x)
    while (Fraction(repr(double)) - x) * (1 if towards > 0 else -1) < 0:
        double = math.nextafter(double, towards)
    return repr(double)


def _signed(proof: Proof) -> Proof:
    body = {name: value for name, value in proof.items() if name != "sha256"}
    text = json.dumps(body, sort_keys=True)
    return {**body, "sha256": hashlib.sha256(text.encode()).hexdigest()}


def _checked(proof: Proof) -> Proof:
    whole = _signed(proof)
    verify_proof.check(whole)
    return whole


def _text(x: float | Fraction) -> str:
    return str(Fraction(x))


def _texts(values: ArrayLike) -> Any:
    array = np.asarray(values, float)
    return [_texts(row) for row in array] if array.ndim > 1 else [_text(x) for x in array.tolist()]
