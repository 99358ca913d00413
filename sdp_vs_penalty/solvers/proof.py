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
from sdp_vs_penalty.solvers.convex_problem import ConvexProblem
from sdp_vs_penalty.solvers.fit import Fit, dual_evidence
from sdp_vs_penalty.solvers.rigorous_bounds import (
    CORRECTIONS,
    TIGHT,
    DualEvidence,
    factor,
)

Proof = dict[str, Any]


def optimum_proof(
    fit: Fit, parameters: Sequence[str] = (), made_of: Mapping[str, str] | None = None
) -> Proof:
    """Build the proof that the optimum lies between a lower bound and the fit's
    objective.

    Parameters
    ----------
    fit : Fit
        Fit with multipliers and bound. Its theta, as its decimal text says, must be
        feasible exactly (:func:`rigorous_bounds.certainly_feasible`).
    made_of : mapping of str
        SHA-256 of the "model" and the "data".

    Raises
    ------
    ValueError
        If theta is not feasible, or the multipliers prove nothing.
    """
    evidence = dual_evidence(fit)
    proof: Proof = {
        **_proof("optimum", fit.problem, evidence, parameters),
        "theta": [repr(float(x)) for x in fit.theta],
        "y": _texts(evidence.y),
        "lower": "0",
        "upper": "0",
        **(made_of or {}),
    }
    exact = verify_proof.typed(_signed(proof), verify_proof.OPTIMUM, {})
    proof["y"] = [_text(x) for x in _polished(exact, evidence, fit.problem.bound)]
    proof["lower"], proof["upper"] = _interval(exact)
    return _checked(proof)


def infeasibility_proof(
    nothing: ConvexProblem, multipliers: Array, parameters: Sequence[str] = ()
) -> Proof:
    """Build the proof (Farkas) that no |theta_k| <= bound_k satisfies all convex
    constraints of a problem without data, whose constraints contradict each other.

    Parameters
    ----------
    multipliers : (e,)
        Multipliers of the constraints' e entries.
    """
    evidence = dual_evidence(Fit(np.zeros(len(nothing.bound)), nothing, multipliers))
    proof = _proof("infeasible", nothing, evidence, parameters)
    return _checked({**proof, "y": []})


def write_proof(proof: Proof, path: str | Path) -> None:
    """Write proof.json atomically.

    Returns
    -------
    None
        The file is written completely, or not at all.
    """
    write_text(path, json.dumps(proof, indent=0, sort_keys=True) + "\n")


def stated(problem: ConvexProblem, parameters: Sequence[str] = ()) -> Proof:
    """Return the optimisation problem, with |theta_k| <= bound_k, in the form in which
    a proof states it.

    Parameters
    ----------
    parameters : sequence of str
        Names of the parameters; default: x0, x1, ...

    Returns
    -------
    Proof
        All fields but multipliers, interval and hashes. Numbers are texts of fractions.
    """
    data = problem.least_squares
    entropy = problem.entropy
    bound = problem.bound
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
            for c in problem.constraints.convex
        ],
    }


def difference(proof: Proof, recomputed: Proof) -> str:
    """Return the first difference between the problem of a proof and a recomputed
    problem.

    Names, their order, cones and indices are compared exactly. Numbers are compared up
    to TIGHT times their own size or their columns' norms: far above two machines'
    rounding and far below any option's change. R, rho and the residual norm are
    compared by the Gram matrix of [R rho], since different triangles R have the same
    one.

    Parameters
    ----------
    proof : Proof
        Proof as read from its file.

    Returns
    -------
    str
        A sentence; "" if the problems are the same.
    """
    titles = [
        [f"{_title(c)}, {c['cone']} in {c['indices']}" for c in p["constraints"]]
        for p in (proof, recomputed)
    ]
    names = proof["parameters"], recomputed["parameters"]
    for kind, (first, second) in (("parameter", names), ("constraint", titles)):
        pairs = zip_longest(first, second, fillvalue="none")
        for k, (a, b) in enumerate(pairs, start=1):
            if a != b:
                return f"{kind} {k} is {a} in the proof, {b} of the model"
    facts = zip(_facts(proof), _facts(recomputed), strict=True)
    for (name, in_proof, _), (_, in_model, size) in facts:
        is_same_shape = in_proof.shape == in_model.shape
        if not is_same_shape or np.any(np.abs(in_proof - in_model) > TIGHT * size):
            return f"the proof has another {name}"
    return ""


def _facts(p: Proof) -> Iterator[tuple[str, Array, Array]]:
    """Yield the numbers of a stated problem, to compare two statements of it.

    Each item is (name for messages, values, sizes): arrays of equal shape. A difference
    of two values counts relative to ``sizes``. The dictionary ``p`` holds numbers as
    texts of fractions.
    """

    def squares(gram: Array) -> Array:
        """Return (k, k) products of the square roots of a Gram matrix's diagonal."""
        size = np.sqrt(np.diagonal(gram))
        return np.outer(size, size)

    def magnitude(x: Array) -> Array:
        """Return |x|, raised so that the rounding of the largest entry does not count."""
        rounding = safe_depth(1) * np.abs(x).max(initial=0.0)
        return np.abs(x) + rounding / TIGHT

    # The data: [R, rho]^T [R, rho], with the loss floor^2 that no theta can avoid.
    rows = np.column_stack(
        [_array(p["R"]).reshape(-1, len(p["bound"])), _array(p["rho"])]
    )
    gram = rows.T @ rows
    gram[-1, -1] += float(Fraction(p["floor"])) ** 2
    yield "R, rho or floor", gram, squares(gram)
    for name, bound in zip(p["parameters"], _array(p["bound"]), strict=True):
        yield f"bound of {name}", bound, magnitude(bound)
    for constraint in p["constraints"]:
        title = _title(constraint)
        for field in ("constant", "coefficients"):
            entries = _array(constraint[field])
            yield f"{field} of {title}", entries, magnitude(entries)
        # The entropic prior of the constraint's link: none or one entry.
        values = [np.zeros(0)]
        sizes = [np.zeros(0)]
        for prior in constraint["entropy"]:
            weight = _array([prior["weight"]])
            log_det = _array([prior["log_det"]])
            inverse = _array(prior["inverse"])
            values += [weight, log_det, inverse]
            # An error of a logarithm is a relative error of the determinant: size one.
            size_of_log_det = np.ones(1)
            size_of_inverse = squares(inverse.reshape(4, 4)).ravel()
            sizes += [magnitude(weight), size_of_log_det, size_of_inverse]
        yield (f"entropy of {title}", np.concatenate(values), np.concatenate(sizes))


def _title(constraint: Proof) -> str:
    """Return a constraint's name in messages: "mass of link 3"."""
    return f"{constraint['family']} of {constraint['name']}"


def _array(texts: Any) -> Array:
    """Return texts of fractions, in one or two dimensions, as an array of doubles."""
    rows = [
        [Fraction(x) for x in row] if isinstance(row, list) else Fraction(row)
        for row in texts
    ]
    return np.array(rows, float)


def _proof(
    kind: str, problem: ConvexProblem, evidence: DualEvidence, parameters: Sequence[str]
) -> Proof:
    """Return a problem as stated, together with the multipliers that prove its claim.

    ``kind`` says what is proved: "optimum" (a lower bound) or "infeasible". Each
    constraint gets its multiplier ("dual"). With an entropic prior, each link's prior
    also gets the matrix that bounds its log det from above ("dual"), written as a sum
    of squares so that it is positive semidefinite by construction.
    """
    statement = stated(problem, parameters)
    constraints = problem.constraints
    entropy = problem.entropy
    slopes = list[tuple[Constraint, Array]]()
    if entropy is not None:
        slopes = [*zip(entropy.links, evidence.entropy_slopes, strict=True)]
    proved = []
    duals = _duals(constraints, evidence)
    for constraint, entry, dual in zip(
        constraints.convex, statement["constraints"], duals, strict=True
    ):
        # The prior of this constraint's link, if it has one.
        roots = [
            np.linalg.cholesky(0.5 * (slope + slope.T))
            for link, slope in slopes
            if link is constraint
        ]
        priors = [
            {**prior, "dual": _gram(root)}
            for prior, root in zip(entry["entropy"], roots, strict=True)
        ]
        proved.append({**entry, "dual": dual, "entropy": priors})
    header = {"format": verify_proof.FORMAT, "kind": kind, "model": "", "data": ""}
    return {**header, **statement, "constraints": proved}


def _duals(constraints: ConstraintSet, evidence: DualEvidence) -> list[Any]:
    """Return each constraint's multiplier as exact fractions inside its cone.

    A matrix is V V^T with a V of doubles. The axis of a second-order cone is raised to
    the next doubles until the exact inequality holds. Others are clipped at zero.
    """
    duals = []
    multipliers = constraints.entries.each(evidence.multipliers)
    for c, multiplier in zip(constraints.convex, multipliers, strict=True):
        if c.cone == "psd":
            symmetric = 0.5 * (multiplier + multiplier.T)
            duals.append(_gram(factor(symmetric[None])[0]))
        elif c.cone == "soc":
            across = [Fraction(float(x)) for x in multiplier[1:]]
            axis = Fraction(float(multiplier[0]))
            square = sum((x * x for x in across), Fraction(0))
            while axis < 0 or axis * axis < square:
                nearest = max(float(axis), math.sqrt(float(square)))
                axis = Fraction(math.nextafter(nearest, math.inf))
            duals.append([_text(x) for x in (axis, *across)])
        else:
            duals.append(_texts(np.maximum(multiplier, 0.0)))
    return duals


def _gram(V: NDArray[np.floating]) -> list[str]:
    """Return the entries of V V^T (d^2 texts), without rounding, row by row."""
    rows = [[Fraction(x) for x in row] for row in V.tolist()]
    return [_text(verify_proof.dot(a, b)) for a in rows for b in rows]


def _polished(
    exact: dict[str, Any], evidence: DualEvidence, bound: Array
) -> list[Fraction]:
    """Return y (r,) of a typed proof after exact corrections of the dual slope.

    y is shifted until no slope is left in directions of theta that the data determine.
    The lower bound is then tight, since a slope that is left costs |slope| times bound.
    ``exact`` is the proof with Fractions for numbers; its "y" is replaced as well.
    """
    for _ in range(CORRECTIONS):
        _, slope = verify_proof.dual_bound(exact)
        scaled_slope = bound * np.array([float(x) for x in slope])
        shift = evidence.push(scaled_slope)
        exact["y"] = [
            entry - Fraction(float(change))
            for entry, change in zip(exact["y"], shift, strict=True)
        ]
    return list(exact["y"])


def _interval(exact: dict[str, Any]) -> tuple[str, str]:
    """Return lower and upper bound of the optimum as decimal texts of doubles, rounded
    outward.
    """
    constant, slope = verify_proof.dual_bound(exact)
    costs = (abs(e) * b for e, b in zip(slope, exact["bound"], strict=True))
    lower = constant - sum(costs, Fraction(0))
    upper = verify_proof.objective(exact)
    return _outward(lower, -math.inf), _outward(upper, math.inf)


def _outward(x: Fraction, towards: float) -> str:
    """Return the text of the double nearest to x that is not on its inner side.

    ``towards`` is -inf for a lower bound and inf for an upper one.
    """
    sign = 1 if towards > 0 else -1
    double = float(x)
    while sign * (Fraction(repr(double)) - x) < 0:
        double = math.nextafter(double, towards)
    return repr(double)


def _signed(proof: Proof) -> Proof:
    """Return the proof with the SHA-256 of its sorted JSON text."""
    body = {name: value for name, value in proof.items() if name != "sha256"}
    text = json.dumps(body, sort_keys=True)
    return {**body, "sha256": hashlib.sha256(text.encode()).hexdigest()}


def _checked(proof: Proof) -> Proof:
    """Return the signed proof after checking it by the stand-alone verify_proof.

    verify_proof raises ValueError for a proof that does not hold.
    """
    signed_proof = _signed(proof)
    verify_proof.check(signed_proof)
    return signed_proof


def _text(x: float | Fraction) -> str:
    """Return a number as the text of an exact fraction."""
    return str(Fraction(x))


def _texts(values: ArrayLike) -> Any:
    """Return an array as nested lists of texts of exact fractions."""
    array = np.asarray(values, float)
    return (
        [_texts(row) for row in array]
        if array.ndim > 1
        else [_text(x) for x in array.tolist()]
    )
