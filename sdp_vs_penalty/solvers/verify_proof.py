"""Check a proof of an identification optimum: `python verify_proof.py proof.json` (exit
code 0 or 1).

Standard library, rational numbers, no rounding; docs/proof.md is the format. The claim, for all x with
|x_k| <= bound_k and each F_i(x) = constant_i + sum_k x[indices_ik] coefficients_ik in its cone:

    lower <= min f <= f(theta) <= upper,    f(x) = |R x - rho|^2 + floor^2
              + sum_i weight_i [-log det F_i(x) + <inverse_i, F_i(x)> + log_det_i - d_i]  (entropies);

or, of kind "infeasible", that there is no such x. Any y, S_i and T_i in the cones bound f from below:
|r|^2 >= 2 <y, r> - <y, y>, <S, F> >= 0, -log det F >= log det T + d - <T, F> for F, T > 0.

What holds may still say nothing: a proof is vacuous from a gap (upper - lower) /
size(theta) of 1 on, and above a thousandth it shows no optimum. The size is that of f
above zero: the loss and the entropies' divergences, whatever constants they state.
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
ENTROPY: dict = {"weight": NUMBER, "dual": VECTOR, "inverse": VECTOR, "log_det": NUMBER}
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
OPTIMUM = PROOF | {"theta": ["n", NUMBER], "lower": NUMBER, "upper": NUMBER}


def need(condition, what):
    """Raise ValueError with the reason ``what`` unless the condition holds."""
    if not condition:
        raise ValueError(what)


def read(path):
    """Read a proof's JSON; ValueError for a file that is too large or repeats a field."""
    with open(path, "rb") as file:
        text = file.read(MAX_BYTES + 1)
    need(len(text) <= MAX_BYTES, "the file is too large")

    def without_repeated_fields(pairs):
        need(len(dict(pairs)) == len(pairs), "twice")
        return dict(pairs)

    # Decoded first: json would accept the byte-order mark of bytes, which is no JSON.
    return json.loads(text.decode(), object_pairs_hook=without_repeated_fields)


def typed(value, kind, sizes):
    """Return the value with numbers as Fractions, checked against the form ``kind``.

    ``kind`` is a dict of fields, a list [letter, kind of each item], a tuple of Python
    types, or NUMBER. Lists with the same letter must have the same length, which
    ``sizes`` records. Raises ValueError for a missing or further field, another type,
    length or number.
    """
    if isinstance(kind, dict):
        need(
            type(value) is dict and value.keys() == kind.keys(),
            "fields are missing, or too many",
        )
        sizes = dict(sizes)
        return {name: typed(value[name], kind[name], sizes) for name in kind}
    if isinstance(kind, list):
        letter, kind_of_item = kind
        is_list = type(value) is list
        fits = is_list and len(value) == sizes.setdefault(letter, len(value))
        need(fits, "a list is missing, or has a wrong length")
        return [typed(item, kind_of_item, sizes) for item in value]
    if isinstance(kind, tuple):
        need(type(value) in kind, "a text or an index is missing")
        return value
    need(
        type(value) is str and len(value) <= MAX_DIGITS and NUMBER.fullmatch(value),
        "no number",
    )
    x = Fraction(value)
    denominator = int(value.partition("/")[2] or 1)
    is_power_of_two = not denominator & (denominator - 1)
    need(
        abs(x) <= LARGEST and is_power_of_two,
        "a number is too large, or no binary fraction",
    )
    return x


def dot(a, b):
    """Return the exact inner product of two sequences of Fractions."""
    return sum((x * y for x, y in zip(a, b, strict=True) if x and y), Fraction(0))


def symmetric(flat):
    """Return d^2 entries as d rows; ValueError unless the matrix is square and
    symmetric.
    """
    d = math.isqrt(len(flat))
    rows = [flat[i : i + d] for i in range(0, d * d, d)]
    need(
        d * d == len(flat) and rows == [list(x) for x in zip(*rows, strict=True)],
        "asymmetric",
    )
    return rows


def determinant(flat):
    """Return the determinant of a matrix (d^2 Fractions), None unless it is positive
    semidefinite.

    Bareiss' fraction-free elimination in integers: entries are scaled by their common
    denominator. A negative pivot, or a zero pivot with a nonzero row, shows that the
    matrix is indefinite.
    """
    scale = math.lcm(*(x.denominator for x in flat))
    rows = [[int(x * scale) for x in row] for row in symmetric(flat)]
    last_pivot = 1
    is_singular = False
    for k, row in enumerate(rows):
        pivot = row[k]
        if pivot < 0 or (pivot == 0 and any(row[k:])):
            return None
        if pivot == 0:
            is_singular = True
            continue
        for i in range(k + 1, len(rows)):
            rows[i] = [
                (pivot * a - rows[i][k] * b) // last_pivot
                for a, b in zip(rows[i], row, strict=True)
            ]
        last_pivot = pivot
    # Bareiss: the last pivot is the determinant of the integer matrix.
    return Fraction(0 if is_singular else last_pivot, scale ** len(rows))


def inside(cone, value):
    """Return whether a value lies in its cone: "psd" (d^2 entries), "soc" (axis first),
    or >= 0.
    """
    if cone == "soc":
        return value[0] >= 0 and value[0] ** 2 >= dot(value[1:], value[1:])
    return (
        determinant(value) is not None if cone == "psd" else all(x >= 0 for x in value)
    )


def log_below(x):
    """Return a Fraction below ln x, by at most 1e-49.

    A Decimal's logarithm is correctly rounded to 80 digits; 1e-50 covers the two
    roundings.
    """
    need(x, "a singular matrix has no finite entropy, and proves nothing")
    top = Decimal(x.numerator).ln(Context(prec=80))
    bottom = Decimal(x.denominator).ln(Context(prec=80))
    return Fraction(top) - Fraction(bottom) - Fraction(1, 10**50)


def dual_bound(p):
    """Return an affine lower bound constant + slope' theta of the objective, slope
    (n,).

    The bound holds wherever all constraints hold. For any y and multipliers S_i in
    their cones ("dual"): f(theta) >= floor^2 + 2 y'(R theta - rho) - y'y - sum <S_i,
    F_i(theta)>. A prior adds w (log det T + log det P0 + <P0^-1 - T, P>), a tangent of
    its log det with matrix T ("dual"). Raises ValueError for a multiplier outside its
    cone.
    """
    constant = p["floor"] ** 2 - 2 * dot(p["y"], p["rho"]) - dot(p["y"], p["y"])
    slope = [2 * dot(p["y"], column) for column in zip(*p["R"], strict=True)]
    if not p["R"]:  # without data
        slope = [0] * len(p["bound"])
    for c in p["constraints"]:
        need(
            c["cone"] in CONES and 0 < len(c["constant"]) <= MAX_ROWS,
            "a cone is unknown or too large",
        )
        known_indices = {*c["indices"]} & {*range(len(slope))}
        need(len(known_indices) == len(c["indices"]), "an index is wrong")
        S = c["dual"]
        need(inside(c["cone"], S), "a multiplier lies outside its cone")
        for e in c["entropy"]:
            need(
                e["weight"] >= 0 and c["cone"] == "psd",
                "the entropy is not convex, or of no matrix",
            )
            constant += e["weight"] * (log_below(determinant(e["dual"])) + e["log_det"])
            # The prior's tangent is linear in the constraint's matrix, as is <S, F>.
            S = [
                s + e["weight"] * (t - q)
                for s, t, q in zip(S, e["dual"], e["inverse"], strict=True)
            ]
        if c["cone"] == "psd":
            for matrix in (S, c["constant"], *c["coefficients"]):
                symmetric(matrix)
        constant -= dot(c["constant"], S)
        for k, F in zip(c["indices"], c["coefficients"], strict=True):
            slope[k] -= dot(F, S)
    return constant, slope


def loss(p):
    """Return |R theta - rho|^2 + floor^2 of a typed proof, exactly."""
    rows = zip(p["R"], p["rho"], strict=True)
    return p["floor"] ** 2 + sum((dot(a, p["theta"]) - r) ** 2 for a, r in rows)


def content(c, x):
    """Return the entries of a constraint's F(x), exactly."""
    terms = [
        [x[k] * a for a in F]
        for k, F in zip(c["indices"], c["coefficients"], strict=True)
    ]
    return [sum(column) for column in zip(c["constant"], *terms, strict=True)]


def objective(p):
    """Return an upper bound of the objective at theta, exact without a prior.

    Raises ValueError if theta violates a bound or a constraint.
    """
    x = p["theta"]
    need(
        all(abs(a) <= b for a, b in zip(x, p["bound"], strict=True)),
        "theta lies outside its bound",
    )
    total = loss(p)
    for c in p["constraints"]:
        F = content(c, x)
        need(inside(c["cone"], F), "theta violates a constraint")
        for e in c["entropy"]:
            divergence = dot(F, e["inverse"]) - log_below(determinant(F)) + e["log_det"]
            total += e["weight"] * (divergence - math.isqrt(len(F)))
    return total


def check(proof):
    """Verify a proof in exact arithmetic.

    Steps: the form of the file, its checksum, then the claim. "optimum" claims lower <=
    smallest objective <= upper: lower by the dual bound over |theta_k| <= bound_k,
    upper by a feasible theta. "infeasible" claims that no theta satisfies the
    constraints: the dual bound of the zero objective is positive (Farkas).

    Returns (lower, upper) as Fractions, or None for a proof of infeasibility. Raises
    ValueError for a proof that does not hold.
    """
    need(type(proof) is dict, "it is no JSON object")
    form = proof.get("format")
    need(form == FORMAT, f"its format is {repr(form)[:60]}, not {FORMAT!r}")
    p = typed(proof, OPTIMUM if proof.get("kind") == "optimum" else PROOF, {})
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
    has_entropy = any(c["entropy"] for c in p["constraints"])
    is_zero_objective = not (p["rho"] or p["floor"] or has_entropy)
    need(
        p["kind"] == "infeasible" and is_zero_objective and proved > 0,
        "infeasibility is not proved",
    )
    return None


def size(p):
    """Return the size of the objective at theta of a typed proof: the loss, and each
    entropy's divergence weight (<Q, F> - log det(Q F) - d) >= 0, Q = inverse.

    It holds no constant that a proof may state (log_det). Where both are zero, as with
    exact data, it counts as at least 1e-12 (|rho|^2 + floor^2 + sum of weight d).
    """
    total = loss(p)
    scale = dot(p["rho"], p["rho"]) + p["floor"] ** 2
    for c in p["constraints"]:
        F = content(c, p["theta"])
        for e in c["entropy"]:
            Q = determinant(e["inverse"])
            if not Q:  # no divergence: without a least value
                continue
            d = math.isqrt(len(F))
            logs = log_below(determinant(F)) + log_below(Q)
            total += e["weight"] * max(dot(e["inverse"], F) - logs - d, 0)
            scale += e["weight"] * d
    return max(total, scale / 10**12)


def relative_gap(proof):
    """Return (upper - lower) / size(theta) of a proof of an optimum that :func:`check`
    accepts.

    None if the size is zero and the interval is not.
    """
    p = typed(proof, OPTIMUM, {})
    scale = size(p)
    width = p["upper"] - p["lower"]
    if scale:
        return width / scale
    return None if width else Fraction(0)


def in_words(x):
    """Return a rational number, however large, as text with two digits."""
    return f"{Decimal(x.numerator) / Decimal(x.denominator):.1e}"


#: The largest gap, relative to the objective, that says enough.
LOOSEST = Fraction(1, 1000)


def weakness(proof):
    """Return why a valid proof says too little of the optimum, "" if it says enough."""
    gap = relative_gap(proof)
    if gap is None or gap >= 1:
        share = "" if gap is None else f", {in_words(gap)} times the objective wide,"
        ends = (in_words(Fraction(proof[name])) for name in ("lower", "upper"))
        return f"vacuous: [{', '.join(ends)}]{share} says nothing of the optimum"
    if gap > LOOSEST:
        most = in_words(LOOSEST)
        return f"loose: its gap is {in_words(gap)} of the objective, more than {most}"
    return ""


def main(path):
    """Return in one line what the proof in a file shows; ValueError if it does not
    hold.
    """
    proof = read(path)
    found = check(proof)
    if found is None:
        return "infeasible"
    need(not weakness(proof), weakness(proof))
    share = in_words(relative_gap(proof))
    return f"optimum in {[float(x) for x in found]}, gap {share} of the objective"


if __name__ == "__main__":
    try:
        print(main(sys.argv[1]))
    except Exception as error:
        sys.exit(f"refused: {type(error).__name__}: {error}")
