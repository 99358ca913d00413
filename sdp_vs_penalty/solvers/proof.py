"""A proof that travels: one JSON file from which anyone can check an optimum in
rational arithmetic.

The file holds the problem (R, rho, floor, constraint arrays, bounds) as the rational
numbers that the doubles are, the estimate as it is written in model.json, multipliers
that lie in the cones exactly, and the interval. :mod:`verify_proof` checks it with the
standard library alone; docs/proof.md is the format in full. How these numbers came from
the measured samples is outside of the proof: the file names the model and the data by
their hashes; ``verify --model --data`` poses the problem again and compares it with all
that the file states (:func:`difference`).

Weak duality as in :mod:`fit`; Jansson, Chaykin, Keil, SIAM J. Numer. Anal.
2007, for bounds from approximate multipliers.
"""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Constraint, ConstraintSet, safe_depth
from sdp_vs_penalty.solvers import verify_proof
from sdp_vs_penalty.solvers.fit import Fit, dual_evidence
from sdp_vs_penalty.solvers.objective import Entropy, Objective
from sdp_vs_penalty.solvers.rigorous_bounds import (
    CORRECTIONS,
    TIGHT,
    DualEvidence,
    factor,
)

Proof = dict[str, Any]


def optimum_proof(
    fit: Fit,
    parameters: Sequence[str] = (),
    made_of: Mapping[str, str] | None = None,
) -> Proof:
    """The proof that the least objective lies between a lower bound and that of the
    fit's theta.

    Parameters
    ----------
    fit : Fit
        With its multipliers and bound, theta feasible exactly, as its decimal
        text says (:func:`rigorous_bounds.certainly_feasible`).
    parameters : sequence of str
        Names.
    made_of : mapping of str
        Hashes of the "model" and the "data".

    Returns
    -------
    Proof
        The content of a proof.json.

    Raises
    ------
    ValueError
        Where theta is not feasible, or the multipliers prove nothing.
    """
    assert fit.bound is not None
    evidence = dual_evidence(fit)
    problem = stated(
        fit.objective,
        fit.constraints.convex,
        fit.bound,
        parameters,
    )
    proof: Proof = {
        **_proof(
            "optimum",
            problem,
            fit.constraints,
            evidence,
            fit.objective.entropy,
        ),
        "theta": [repr(float(x)) for x in fit.theta],
        "y": _texts(evidence.y),
        "lower": "0",
        "upper": "0",
        **(made_of or {}),
    }
    exact = verify_proof.typed(_signed(proof), verify_proof.OPTIMUM, {})
    proof["y"] = [_text(x) for x in _polished(exact, evidence, fit.bound)]
    proof["lower"], proof["upper"] = _interval(exact)
    return _checked(proof)


def infeasibility_proof(
    constraints: ConstraintSet,
    multipliers: Array,
    bound: Array,
    parameters: Sequence[str] = (),
) -> Proof:
    """The proof (Farkas) that no |theta_k| <= bound_k satisfies all convex
    constraints.

    Parameters
    ----------
    constraints : ConstraintSet
        Which contradict each other.
    multipliers : (e,)
        Of the entries of the constraints.
    bound : (p,)
        The largest plausible |theta_k|.
    parameters : sequence of str
        Names.

    Returns
    -------
    Proof
        The content of a proof.json.
    """
    nothing = Objective.without_data(len(bound))
    evidence = dual_evidence(
        Fit(
            np.zeros(len(bound)),
            nothing,
            constraints,
            multipliers,
            bound=bound,
        )
    )
    problem = stated(
        nothing,
        constraints.convex,
        bound,
        parameters,
    )
    return _checked(
        {
            **_proof(
                "infeasible",
                problem,
                constraints,
                evidence,
            ),
            "y": [],
        }
    )


def write_proof(proof: Proof, path: str | Path) -> None:
    """Write proof.json, whole or not at all.

    Parameters
    ----------
    proof : Proof
        Its content.
    path : path
        The file.

    Returns
    -------
    None
        Nothing.
    """
    write_text(
        path,
        json.dumps(
            proof,
            indent=0,
            sort_keys=True,
        )
        + "\n",
    )


def stated(
    objective: Objective,
    constraints: Sequence[Constraint],
    bound: Array,
    parameters: Sequence[str] = (),
) -> Proof:
    """The problem as a proof states it.

    Parameters
    ----------
    objective : Objective
        A sum of squares with a prior.
    constraints : sequence of Constraint
        What theta has to satisfy.
    bound : (p,)
        The largest plausible |theta_k|.
    parameters : sequence of str
        Names.

    Returns
    -------
    Proof
        Every field but multipliers, interval and hashes.
    """
    data = objective.least_squares
    entropy = objective.entropy
    weight = 0.0
    held = list[tuple[Constraint, Array, float]]()
    if entropy is not None:
        weight = entropy.weight
        held = [*zip(entropy.links, *entropy.nominal_terms, strict=True)]
    return {
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
                "entropy": [
                    {
                        "weight": _text(weight),
                        "inverse": _texts(P.ravel()),
                        "log_det": _text(x),
                    }
                    for link, P, x in held
                    if link is c
                ],
            }
            for c in constraints
        ],
    }


def difference(proof: Proof, recomputed: Proof) -> str:
    """The first thing in which a proof states another problem.

    Names, their order, cones and indices are compared exactly, numbers to the promised
    gap (TIGHT) of themselves or of their columns' norms, far above two machines'
    rounding and far below any option's change; R, rho and floor by the loss that they
    make, since another triangle R may make the same one.

    Parameters
    ----------
    proof : Proof
        What was written.
    recomputed : Proof
        The problem as it is (:func:`stated`).

    Returns
    -------
    str
        In words; "" where they are the same.
    """
    titles = [
        [f"{_title(c)}, {c['cone']} in {c['indices']}" for c in p["constraints"]]
        for p in (proof, recomputed)
    ]
    names = proof["parameters"], recomputed["parameters"]
    for kind, pair in (("parameter", names), ("constraint", titles)):
        for k, (a, b) in enumerate(zip_longest(*pair, fillvalue="none"), start=1):
            if a != b:
                return f"{kind} {k} is {a} in the proof, {b} of the model"
    for (what, x, _), (_, y, size) in zip(
        _facts(proof),
        _facts(recomputed),
        strict=True,
    ):
        if x.shape != y.shape or np.any(np.abs(x - y) > TIGHT * size):
            return f"the proof has another {what}"
    return ""


def _facts(p: Proof) -> Iterator[tuple[str, Array, Array]]:
    """What a problem states in numbers, by name, and how large each counts."""

    def squares(gram: Array) -> Array:
        size = np.sqrt(np.diagonal(gram))
        return np.outer(size, size)

    def itself(
        x: Array,
    ) -> Array:  # what is rounding of the largest entry does not count
        return np.abs(x) + safe_depth(1) / TIGHT * np.abs(x).max(initial=0.0)

    rows = np.column_stack(
        [
            _array(p["R"]).reshape(-1, len(p["bound"])),
            _array(p["rho"]),
        ]
    )
    gram = rows.T @ rows
    gram[-1, -1] += float(Fraction(p["floor"])) ** 2
    yield "R, rho or floor", gram, squares(gram)
    for name, bound in zip(p["parameters"], _array(p["bound"]), strict=True):
        yield f"bound of {name}", bound, itself(bound)
    for c in p["constraints"]:
        for field in ("constant", "coefficients"):
            yield f"{field} of {_title(c)}", (x := _array(c[field])), itself(x)
        parts = [(np.zeros(0), np.zeros(0))]
        for e in c["entropy"]:
            weight = _array([e["weight"]])
            log_det = _array([e["log_det"]])
            inverse = _array(e["inverse"])
            # Of a logarithm the error is a relative one of the determinant.
            parts += [
                (weight, itself(weight)),
                (log_det, np.ones(1)),
            ]
            parts += [(inverse, squares(inverse.reshape(4, 4)).ravel())]
        numbers, size = map(np.concatenate, zip(*parts, strict=True))
        yield f"entropy of {_title(c)}", numbers, size


def _title(constraint: Proof) -> str:
    return f"{constraint['family']} of {constraint['name']}"


def _array(texts: Any) -> Array:
    rows = [
        [Fraction(x) for x in row] if isinstance(row, list) else Fraction(row)
        for row in texts
    ]
    return np.array(rows, float)


def _proof(
    kind: str,
    problem: Proof,
    constraints: ConstraintSet,
    evidence: DualEvidence,
    entropy: Entropy | None = None,
) -> Proof:
    """A stated problem with its multipliers."""
    slopes = (
        []
        if entropy is None
        else list(zip(entropy.links, evidence.entropy_slopes, strict=True))
    )
    proved = []
    duals = _duals(constraints, evidence)
    for c, name, dual in zip(
        constraints.convex,
        problem["constraints"],
        duals,
        strict=True,
    ):
        roots = [np.linalg.cholesky(0.5 * (s + s.T)) for link, s in slopes if link is c]
        pulls = [
            {
                **e,
                "dual": _gram(root),
            }
            for e, root in zip(name["entropy"], roots, strict=True)
        ]
        proved.append(
            {
                **name,
                "dual": dual,
                "entropy": pulls,
            }
        )
    about = {
        "format": verify_proof.FORMAT,
        "kind": kind,
        "model": "",
        "data": "",
    }
    return {
        **about,
        **problem,
        "constraints": proved,
    }


def _duals(constraints: ConstraintSet, evidence: DualEvidence) -> list[Any]:
    """Of the constraints as they are, each inside its cone exactly: V V^T for a matrix."""
    out = []
    multipliers = constraints.entries.each(evidence.multipliers)
    for c, multiplier in zip(constraints.convex, multipliers, strict=True):
        if c.cone == "psd":
            out.append(_gram(factor(0.5 * (multiplier + multiplier.T)[None])[0]))
        elif c.cone == "soc":
            across = [Fraction(float(x)) for x in multiplier[1:]]
            axis = Fraction(float(multiplier[0]))
            square = sum((x * x for x in across), Fraction(0))
            while axis < 0 or axis * axis < square:
                axis = Fraction(
                    math.nextafter(max(float(axis), math.sqrt(float(square))), math.inf)
                )
            out.append([_text(x) for x in (axis, *across)])
        else:
            out.append(_texts(np.maximum(multiplier, 0.0)))
    return out


def _gram(factor: NDArray[np.floating]) -> list[str]:
    """V V^T without rounding, row by row."""
    rows = [[Fraction(x) for x in row] for row in factor.tolist()]
    return [_text(verify_proof.dot(a, b)) for a in rows for b in rows]


def _polished(
    exact: dict[str, Any],
    evidence: DualEvidence,
    bound: Array,
) -> list[Fraction]:
    """y, shifted until nothing is left of the slope wherever the data determine theta."""
    for _ in range(CORRECTIONS):
        _, slope = verify_proof.dual_bound(exact)
        shift = evidence.push(bound * np.array([float(x) for x in slope]))
        exact["y"] = [
            a - Fraction(float(b)) for a, b in zip(exact["y"], shift, strict=True)
        ]
    return list(exact["y"])


def _interval(exact: dict[str, Any]) -> tuple[str, str]:
    """Lower and upper bound, rounded outward to decimal numbers of 17 digits."""
    lower, slope = verify_proof.dual_bound(exact)
    lower -= sum(
        (abs(e) * b for e, b in zip(slope, exact["bound"], strict=True)), Fraction(0)
    )
    return _outward(lower, -math.inf), _outward(verify_proof.objective(exact), math.inf)


def _outward(x: Fraction, towards: float) -> str:
    double = float(x)
    while (Fraction(repr(double)) - x) * (1 if towards > 0 else -1) < 0:
        double = math.nextafter(double, towards)
    return repr(double)


def _signed(proof: Proof) -> Proof:
    body = {name: value for name, value in proof.items() if name != "sha256"}
    text = json.dumps(body, sort_keys=True)
    return {
        **body,
        "sha256": hashlib.sha256(text.encode()).hexdigest(),
    }


def _checked(proof: Proof) -> Proof:
    signed_proof = _signed(proof)
    verify_proof.check(signed_proof)
    return signed_proof


def _text(x: float | Fraction) -> str:
    return str(Fraction(x))


def _texts(values: ArrayLike) -> Any:
    array = np.asarray(values, float)
    return (
        [_texts(row) for row in array]
        if array.ndim > 1
        else [_text(x) for x in array.tolist()]
    )
