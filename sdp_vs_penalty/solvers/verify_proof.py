"""Check a proof of an identification optimum: `python verify_proof.py proof.json` (exit code 0 or 1).

Standard library only, and no rounding: every number is rational. The claim, for all x with |x_k| <=
bound_k and F_i(x) = constant_i + sum_k x[indices_ik] coefficients_ik in the cone K_i (matrices by rows):

    lower <= min f <= f(theta) <= upper,   f(x) = |R x - rho|^2 + floor^2
             + weight sum_l [-log det P_l(x) + <inverse_l, P_l(x)> + log_det_l - 4]   (with "entropy")

where P_l = F_i of a matrix constraint i; or, of kind "infeasible", that there is no such x. Any y and
any S_i in the (self-dual) cones, V V^T for matrices, bound f from below: |r|^2 >= 2 <y, r> - <y, y>,
<S_i, F_i> >= 0, -log det P >= log det S + 4 - <S, P>. How R and rho came from samples is not proved.
"""

import hashlib
import json
import math
import sys
from fractions import Fraction

FORMAT = "sdp-vs-penalty proof 1"
NO_NUMBERS = {"format", "kind", "parameters", "family", "name", "cone", "indices", "constraint"}


def digest(body):
    return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


def exact(x, key=""):
    """The same with rational numbers for texts like "-7/4" or "0.125" and for integers."""
    if key in NO_NUMBERS or x is None:
        return x
    if isinstance(x, dict):
        return {k: exact(v, k) for k, v in x.items()}
    return [exact(v) for v in x] if isinstance(x, list) else Fraction(x)


def dot(a, b):
    return sum((x * y for x, y in zip(a, b, strict=True) if x and y), Fraction(0))


def determinant(matrix):
    """Of a positive semidefinite matrix, row by row, by an exact L D L^T; None where it is not one."""
    d, product = math.isqrt(len(matrix)), Fraction(1)
    rows = [matrix[i : i + d] for i in range(0, d * d, d)]
    if len(matrix) != d * d or rows != [list(column) for column in zip(*rows, strict=True)]:
        return None
    for k in range(d):
        pivot, below = rows[k][k], [i for i in range(k + 1, d) if rows[i][k]]
        if pivot < 0 or (pivot == 0 and below):
            return None
        product *= pivot
        for i in below:
            ratio = rows[i][k] / pivot
            rows[i] = [a - ratio * b for a, b in zip(rows[i], rows[k], strict=True)]
    return product


def inside(cone, value):
    if cone == "psd":
        return determinant(value) is not None
    if cone == "soc":
        return value[0] >= 0 and value[0] ** 2 >= dot(value[1:], value[1:])
    return cone == "nonnegative" and all(x >= 0 for x in value)


def log_below(x):
    """A rational lower bound of the natural logarithm of x > 0, within 1e-18 times its binary digits."""
    shift = x.numerator.bit_length() - x.denominator.bit_length()
    total = Fraction(-1 - abs(shift), 2**70)  # |z| <= 1/3: tail below 3^-160, roundings below 2^-150
    for part, times in ((x / Fraction(2) ** shift, 1), (Fraction(2), shift)):
        z = Fraction(int((part - 1) / (part + 1) * 2**160), 2**160)
        term = series = z
        for k in range(3, 161, 2):
            term = Fraction(int(term * z * z * 2**200), 2**200)
            series += term / k
        total += times * 2 * series
    return total


def value_of(c, x):
    made = list(c["constant"])
    for k, coefficient in zip(c["indices"], c["coefficients"], strict=True):
        made = [a + x[k] * b for a, b in zip(made, coefficient, strict=True)]
    return made


def dual_bound(p):
    """Constant and slope of an affine function below the objective wherever all constraints hold."""
    constraints, y = p["constraints"], p["y"]
    constant = p["floor"] ** 2 - 2 * dot(y, p["rho"]) - dot(y, y)
    slope = [2 * dot(y, column) for column in zip(*p["R"], strict=True)] or [0] * len(p["bound"])
    taken = []
    for c, dual in zip(constraints, p["multipliers"], strict=True):
        if c["cone"] != "psd" and not inside(c["cone"], dual):
            raise ValueError("a multiplier lies outside its cone")
        taken.append((c, [dot(a, b) for a in dual for b in dual] if c["cone"] == "psd" else dual))
    for link in p["entropy"]["links"] if p["entropy"] else ():
        weight = p["entropy"]["weight"]
        dual = [dot(a, b) for a in link["factor"] for b in link["factor"]]
        constant += weight * (log_below(determinant(dual)) + link["log_det"])
        if weight < 0:
            raise ValueError("a negative weight of the entropy is not convex")
        left = [weight * (s - q) for s, q in zip(dual, link["inverse"], strict=True)]
        taken.append((constraints[link["constraint"]], left))
    for c, dual in taken:
        constant -= dot(c["constant"], dual)
        for k, coefficient in zip(c["indices"], c["coefficients"], strict=True):
            slope[k] -= dot(coefficient, dual)
    return constant, slope


def objective(p, x):
    """An upper bound of f(x), exact without entropy; None where x lies outside of a cone or a bound."""
    within = all(abs(a) <= b for a, b in zip(x, p["bound"], strict=True))
    if not within or not all(inside(c["cone"], value_of(c, x)) for c in p["constraints"]):
        return None
    residual = [dot(row, x) - r for row, r in zip(p["R"], p["rho"], strict=True)]
    value = p["floor"] ** 2 + dot(residual, residual)
    for link in p["entropy"]["links"] if p["entropy"] else ():
        matrix = value_of(p["constraints"][link["constraint"]], x)
        divergence = dot(matrix, link["inverse"]) - log_below(determinant(matrix)) + link["log_det"] - 4
        value += p["entropy"]["weight"] * divergence
    return value


def check(proof):
    """The proved interval (lower, upper), or None for a proof of infeasibility; ValueError otherwise."""
    body = {k: v for k, v in proof.items() if k != "sha256"}
    if proof["format"] != FORMAT or digest(body) != proof["sha256"]:
        raise ValueError("not a proof of this format, or changed after it was written")
    p = exact(body)
    constant, slope = dual_bound(p)
    proved = constant - sum(abs(e) * b for e, b in zip(slope, p["bound"], strict=True))
    zero = not (p["R"] or p["rho"] or p["floor"] or p["entropy"])
    if p["kind"] == "infeasible" and zero and proved > 0:
        return None
    value = objective(p, p["theta"]) if p["kind"] == "optimum" else None
    if value is None or not p["lower"] <= proved or not value <= p["upper"]:
        raise ValueError("the claim is not proved")
    return p["lower"], p["upper"]


if __name__ == "__main__":
    try:
        with open(sys.argv[1], encoding="utf-8") as file:
            found = check(json.load(file))
    except Exception as error:
        sys.exit(f"refused: {type(error).__name__}: {error}")
    print("infeasible" if found is None else f"optimum in {[float(x) for x in found]}")
