"""Check a proof of an identification optimum: `python verify_proof.py proof.json` (exit
code 0 or 1).

Standard library, rational numbers, no rounding; docs/proof.md is the format. The claim, for all x with
|x_k| <= bound_k and each F_i(x) = constant_i + sum_k x[indices_ik] coefficients_ik in its cone:

    lower <= min f <= f(theta) <= upper,    f(x) = |R x - rho|^2 + floor^2
              + sum_i weight_i [-log det F_i(x) + <inverse_i, F_i(x)> + log_det_i - d_i]  (entropies);

or, of kind "infeasible", that there is no such x. Any y, S_i and T_i in the cones bound f from below:
|r|^2 >= 2 <y, r> - <y, y>, <S, F> >= 0, -log det F >= log det T + d - <T, F> for F, T > 0.

What holds may still say nothing: a proof is vacuous from a gap (upper - lower) / loss(theta) of 1 on,
and above a thousandth it shows no optimum.
"""

import hashlib
import json
import math
import re
import sys
from decimal import Context, Decimal
from fractions import Fraction

FORMAT = "sdp-vs-penalty proof 2"
MAX_BYTES = 2**25
MAX_DIGITS = 4000
MAX_ROWS = 100
LARGEST = 10**308
NUMBER = re.compile(r"-?[0-9]+(\.[0-9]+)?([eE][-+]?[0-9]{1,3})?|-?[0-9]+/[1-9][0-9]*")
# What is where: one of some types, a number, or [n, what], a list; a letter stands for
# one length.
VECTOR = ["s", NUMBER]
TEXT = (str,)
CONES = ("psd", "soc", "nonnegative")
ENTROPY: dict = {
    "weight": NUMBER,
    "dual": VECTOR,
    "inverse": VECTOR,
    "log_det": NUMBER,
}
CONSTRAINT: dict = {
    "family": TEXT,
    "name": TEXT,
    "cone": TEXT,
    "constant": VECTOR,
    "dual": VECTOR,
}
CONSTRAINT |= {
    "indices": ["k", (int,)],
    "coefficients": ["k", VECTOR],
    "entropy": ["e", ENTROPY],
}
PROOF: dict = {
    "format": TEXT,
    "kind": TEXT,
    "sha256": TEXT,
    "model": TEXT,
    "data": TEXT,
}
PROOF |= {
    "bound": ["n", NUMBER],
    "rho": ["m", NUMBER],
    "y": ["m", NUMBER],
    "floor": NUMBER,
}
PROOF |= {
    "R": ["m", ["n", NUMBER]],
    "parameters": ["n", TEXT],
    "constraints": ["c", CONSTRAINT],
}
OPTIMUM = PROOF | {
    "theta": ["n", NUMBER],
    "lower": NUMBER,
    "upper": NUMBER,
}


def need(condition, what):
    if not condition:
        raise ValueError(what)


def read(path):
    """The JSON of a file, in which no field comes twice."""
    with open(path, "rb") as file:
        need(
            len(text := file.read(MAX_BYTES + 1)) <= MAX_BYTES, "the file is too large"
        )
    pairs = {
        "object_pairs_hook": lambda x: need(len(dict(x)) == len(x), "twice") or dict(x)
    }
    return json.loads(
        text.decode(), **pairs
    )  # as text, of which a byte-order mark is no JSON


def typed(value, kind, sizes):
    """The value with rational numbers; ValueError where a field, type or length is not
    the kind's."""
    if isinstance(kind, dict):
        need(
            type(value) is dict and value.keys() == kind.keys(),
            "fields are missing, or too many",
        )
        sizes = dict(sizes)
        return {name: typed(value[name], kind[name], sizes) for name in kind}
    if isinstance(kind, list):
        fits = type(value) is list and len(value) == sizes.setdefault(
            kind[0], len(value)
        )
        need(fits, "a list is missing, or has a wrong length")
        return [typed(v, kind[1], sizes) for v in value]
    if isinstance(kind, tuple):
        need(type(value) in kind, "a text or an index is missing")
        return value
    need(
        type(value) is str and len(value) <= MAX_DIGITS and NUMBER.fullmatch(value),
        "no number",
    )
    x = Fraction(value)
    power = int(value.partition("/")[2] or 1)
    need(
        abs(x) <= LARGEST and not power & (power - 1),
        "a number is too large, or no binary fraction",
    )
    return x


def dot(a, b):
    return sum((x * y for x, y in zip(a, b, strict=True) if x and y), Fraction(0))


def symmetric(flat):
    d = math.isqrt(len(flat))
    rows = [flat[i : i + d] for i in range(0, d * d, d)]
    need(
        d * d == len(flat) and rows == [list(x) for x in zip(*rows, strict=True)],
        "asymmetric",
    )
    return rows


def determinant(flat):
    """Of a positive semidefinite matrix, by Bareiss' elimination in integers; None if
    it is not one."""
    scale = math.lcm(*(x.denominator for x in flat))
    last = 1
    sign = 1
    rows = [[int(x * scale) for x in row] for row in symmetric(flat)]
    for k, row in enumerate(rows):
        if row[k] < 0 or (row[k] == 0 and any(row[k:])):
            return None
        sign = min(sign, row[k])
        for i in range(k + 1, len(rows) if row[k] else 0):
            rows[i] = [
                (row[k] * a - rows[i][k] * b) // last
                for a, b in zip(rows[i], row, strict=True)
            ]
        last = row[k] or last
    return Fraction(last if sign else 0, scale ** len(rows))


def inside(cone, value):
    if cone == "soc":
        return value[0] >= 0 and value[0] ** 2 >= dot(value[1:], value[1:])
    return (
        determinant(value) is not None if cone == "psd" else all(x >= 0 for x in value)
    )


def log_below(x):
    """ln x less at most 1e-49: a Decimal's logarithm is correctly rounded."""
    need(x, "a singular matrix has no finite entropy, and proves nothing")
    top = Decimal(x.numerator).ln(Context(prec=80))
    bottom = Decimal(x.denominator).ln(Context(prec=80))
    return Fraction(top) - Fraction(bottom) - Fraction(1, 10**50)


def dual_bound(p):
    """Constant and slope of an affine function below f wherever all constraints hold."""
    constant = p["floor"] ** 2 - 2 * dot(p["y"], p["rho"]) - dot(p["y"], p["y"])
    slope = [2 * dot(p["y"], column) for column in zip(*p["R"], strict=True)] or [
        0
    ] * len(p["bound"])
    for c in p["constraints"]:
        need(
            c["cone"] in CONES and 0 < len(c["constant"]) <= MAX_ROWS,
            "a cone is unknown or too large",
        )
        need(
            len({*c["indices"]} & {*range(len(slope))}) == len(c["indices"]),
            "an index is wrong",
        )
        need(inside(c["cone"], S := c["dual"]), "a multiplier lies outside its cone")
        for e in c["entropy"]:
            need(
                e["weight"] >= 0 and c["cone"] == "psd",
                "the entropy is not convex, or of no matrix",
            )
            constant += e["weight"] * (log_below(determinant(e["dual"])) + e["log_det"])
            S = [
                s + e["weight"] * (t - q)
                for s, t, q in zip(
                    S,
                    e["dual"],
                    e["inverse"],
                    strict=True,
                )
            ]
        for F in (S, c["constant"], *c["coefficients"]) if c["cone"] == "psd" else ():
            symmetric(F)
        constant -= dot(c["constant"], S)
        for k, F in zip(c["indices"], c["coefficients"], strict=True):
            slope[k] -= dot(F, S)
    return constant, slope


def loss(p):
    """|R theta - rho|^2 + floor^2."""
    rows = zip(p["R"], p["rho"], strict=True)
    return p["floor"] ** 2 + sum((dot(a, p["theta"]) - r) ** 2 for a, r in rows)


def objective(p):
    """An upper bound of f(theta), exact without entropy; ValueError where theta is not
    feasible."""
    x = p["theta"]
    need(
        all(abs(a) <= b for a, b in zip(x, p["bound"], strict=True)),
        "theta lies outside its bound",
    )
    total = loss(p)
    for c in p["constraints"]:
        terms = [
            [x[k] * a for a in F]
            for k, F in zip(c["indices"], c["coefficients"], strict=True)
        ]
        F = [sum(column) for column in zip(c["constant"], *terms, strict=True)]
        need(inside(c["cone"], F), "theta violates a constraint")
        for e in c["entropy"]:
            divergence = dot(F, e["inverse"]) - log_below(determinant(F)) + e["log_det"]
            total += e["weight"] * (divergence - math.isqrt(len(F)))
    return total


def check(proof):
    """The proved interval (lower, upper), or None for a proof of infeasibility;
    ValueError otherwise."""
    need(type(proof) is dict, "it is no JSON object")
    form = proof.get("format")
    need(form == FORMAT, f"its format is {repr(form)[:60]}, not {FORMAT!r}")
    p = typed(
        proof,
        OPTIMUM if proof.get("kind") == "optimum" else PROOF,
        {},
    )
    text = json.dumps(
        {name: proof[name] for name in proof if name != "sha256"}, sort_keys=True
    )
    need(
        hashlib.sha256(text.encode()).hexdigest() == p["sha256"],
        "its sha256 is of another content",
    )
    constant, slope = dual_bound(p)
    proved = constant - sum(abs(e) * b for e, b in zip(slope, p["bound"], strict=True))
    if p["kind"] == "optimum":
        need(
            p["lower"] <= proved and objective(p) <= p["upper"],
            "lower or upper is not proved",
        )
        return p["lower"], p["upper"]
    zero = not (p["rho"] or p["floor"] or any(c["entropy"] for c in p["constraints"]))
    need(
        p["kind"] == "infeasible" and zero and proved > 0, "infeasibility is not proved"
    )


def relative_gap(proof):
    """(upper - lower) / loss(theta) of a proof of an optimum that :func:`check` accepts;
    of exact data the loss counts as at least 1e-12 (|rho|^2 + floor^2). None where that
    is zero and the interval is not."""
    p = typed(proof, OPTIMUM, {})
    torque = dot(p["rho"], p["rho"]) + p["floor"] ** 2
    scale = max(loss(p), torque / 10**12)
    width = p["upper"] - p["lower"]
    return width / scale if scale else Fraction(0) if not width else None


def in_words(x):
    """A rational number, however large, to two digits."""
    return f"{Decimal(x.numerator) / Decimal(x.denominator):.1e}"


def weakness(proof, loosest=Fraction(1, 1000)):
    """Why a proof that holds shows no optimum; "" where it does. loosest: the largest gap
    of one that does."""
    gap = relative_gap(proof)
    if gap is None or gap >= 1:
        share = "" if gap is None else f", {in_words(gap)} times the loss wide,"
        ends = (in_words(Fraction(proof[name])) for name in ("lower", "upper"))
        return f"vacuous: [{', '.join(ends)}]{share} says nothing of the optimum"
    if gap > loosest:
        most = in_words(loosest)
        return f"loose: its gap is {in_words(gap)} of the loss, more than {most}"
    return ""


def main(path):
    """What a proof shows, as one line; ValueError where it does not."""
    proof = read(path)
    found = check(proof)
    if found is None:
        return "infeasible"
    need(not weakness(proof), weakness(proof))
    share = in_words(relative_gap(proof))
    return f"optimum in {[float(x) for x in found]}, gap {share} of the loss"


if __name__ == "__main__":
    try:
        print(main(sys.argv[1]))
    except Exception as error:
        sys.exit(f"refused: {type(error).__name__}: {error}")
