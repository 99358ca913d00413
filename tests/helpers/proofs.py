"""Proofs with known truth, genuine, false and malformed, to put to the checker.

Small random problems (1 to 6 parameters, cones of 1 to 6 dimensions, entropies) whose
numbers are short binary fractions. A claim is called false only where this file, which
shares no code with the checker, finds a feasible point that contradicts it, or a field
that docs/proof.md forbids. The wrong multipliers are those for which the unguarded
inequalities would prove the false claim: singular, indefinite, asymmetric, of another
size.
"""

import copy
import hashlib
import json
import random
from fractions import Fraction

import numpy as np

from sdp_vs_penalty.solvers import verify_proof

#: A claim is false by at least this share of the objective's size: far above this
#: file's rounding.
_CLEARLY = 1e-6


def text(x):
    return str(Fraction(x))


def texts(array):
    made = np.asarray(array, float)
    return (
        [texts(row) for row in made]
        if made.ndim > 1
        else [text(x) for x in made.tolist()]
    )


def short(rng, *shape):
    """Multiples of 1/8 between -4 and 4."""
    return rng.integers(-32, 33, shape) / 8.0


def definite(rng, d):
    v = short(rng, d, d)
    return np.asarray(v @ v.T + np.eye(d) / 4.0)


def signed(body):
    rest = {k: v for k, v in body.items() if k != "sha256"}
    return {
        **rest,
        "sha256": hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest(),
    }


def number(text):
    """A text, or lists of them, in floating point."""
    return (
        np.array([number(t) for t in text])
        if isinstance(text, list)
        else float(Fraction(text))
    )


def content(c, x):
    """F(x) of a constraint, flat."""
    shapes = number(c["coefficients"]).reshape(len(c["indices"]), len(c["constant"]))
    return np.asarray(number(c["constant"]) + x[c["indices"]] @ shapes)


def value(p, x):
    """f(x) in floating point; infinite where x is clearly outside of a constraint, NaN
    on its edge."""
    r = number(p["R"]).reshape(-1, len(x)) @ x
    total = number(p["floor"]) ** 2 + float(np.sum((r - number(p["rho"])) ** 2))
    if np.any(np.abs(x) > number(p["bound"])):
        return float("inf")
    for c in p["constraints"]:
        F = content(c, x)
        square = (
            F.reshape([round(len(F) ** 0.5)] * 2) if c["cone"] == "psd" else np.eye(1)
        )
        least = float(np.linalg.eigvalsh(square)[0] if c["cone"] == "psd" else F.min())
        if c["cone"] == "soc":
            least = float(F[0] - np.linalg.norm(F[1:]))
        if least < 1e-9:
            return float("inf") if least < -1e-9 else float("nan")
        for e in c["entropy"]:
            gain = (
                number(e["inverse"]) @ F
                - np.linalg.slogdet(square)[1]
                + number(e["log_det"])
            )
            total += number(e["weight"]) * float(gain - len(square))
    return total


def constraint(name, cone, indices, constant, coefficients, dual, *entropy):
    """A constraint as docs/proof.md writes it, of arrays."""
    return {
        "family": "any",
        "name": str(name),
        "cone": cone,
        "indices": [*indices],
        "constant": texts(constant),
        "coefficients": texts(coefficients) if len(indices) else [],
        "dual": texts(dual),
        "entropy": [*entropy],
    }


def proof(R, rho, y, theta, constraints, floor=0.0, bound=8.0):
    """The claim of an optimum, without its interval."""
    return {
        "format": verify_proof.FORMAT,
        "kind": "optimum",
        "model": "",
        "data": "",
        "floor": text(floor),
        "parameters": [f"x{k}" for k in range(len(theta))],
        "R": texts(R) if len(R) else [],
        "rho": texts(rho),
        "bound": texts(np.full(len(theta), bound)),
        "y": texts(y),
        "theta": texts(theta),
        "constraints": constraints,
    }


def genuine(rng):
    """A random problem with a strictly feasible theta, multipliers in the cones, and
    what they prove.

    lower and upper are computed here in floating point and moved outward by
    ``_CLEARLY``.
    """
    n = int(rng.integers(1, 7))
    m = int(rng.integers(0, 7))
    theta = short(rng, n)
    unit = float(rng.choice([1.0, 1.0, 1.0, 2.0**-300, 2.0**300]))
    R = unit * short(rng, m, n)
    y = unit * short(rng, m) / 4.0
    floor = unit * float(rng.integers(0, 9)) / 4.0
    rho = R @ theta + unit * short(rng, m) / 8.0
    value_at_zero = floor**2 - 2 * y @ rho - y @ y
    slope = 2 * y @ R
    constraints = []
    for k in range(int(rng.integers(1, 5))):
        cone = str(rng.choice(["psd", "soc", "nonnegative"]))
        d = int(rng.integers(1, 7))
        size = d * d if cone == "psd" else d
        indices = rng.permutation(n)[: int(rng.integers(0, n + 1))]
        shapes = [short(rng, size) for _ in indices]
        inside = np.abs(short(rng, size)) + 0.125
        dual = np.abs(short(rng, size)) / 16.0
        if cone == "psd":
            shapes = [(s.reshape(d, d) + s.reshape(d, d).T).ravel() for s in shapes]
            v = short(rng, d, int(rng.integers(1, d + 1))) / 8.0
            inside = definite(rng, d).ravel()
            dual = (v @ v.T).ravel()
        elif cone == "soc":
            inside[0], dual[0] = (np.ceil(np.sum(x)) + 0.5 for x in (inside, dual))
        coefficients = np.array(shapes).reshape(len(indices), size)
        F0 = inside - theta[indices] @ coefficients
        S = dual
        entropy = []
        if cone == "psd" and rng.random() < 0.5:
            weight = float(rng.integers(0, 5)) / 2
            T = definite(rng, d)
            inverse = definite(rng, d)
            log_det = float(rng.integers(-8, 9)) / 4
            entropy = [entropy_of(weight, T, inverse, log_det)]
            value_at_zero += weight * (np.linalg.slogdet(T)[1] + log_det)
            S = S + weight * (T - inverse).ravel()
        value_at_zero -= F0 @ S
        np.subtract.at(slope, indices, coefficients @ S)
        constraints.append(
            constraint(k, cone, indices.tolist(), F0, coefficients, dual, *entropy)
        )
    p = proof(R, rho, y, theta, constraints, floor)
    lower = float(value_at_zero - 8.0 * np.sum(np.abs(slope)))
    upper = value(p, theta)
    return p | {
        "lower": repr(lower - _CLEARLY * (1.0 + abs(lower))),
        "upper": repr(upper + _CLEARLY * (1.0 + abs(upper))),
    }


def entropy_of(weight, dual, inverse, log_det):
    """The divergence of a constraint's matrix, weighted, with its own multiplier."""
    return {
        "weight": text(weight),
        "dual": texts(dual.ravel()),
        "inverse": texts(inverse.ravel()),
        "log_det": text(log_det),
    }


def without_loss(rng):
    """A true proof whose loss is zero beside entropies, tight to rounding.

    f = sum w (<Q, F> - log det F + log_det - d) with log_det = -log det Q is least
    where <Q - F^-1, F_k> = 0 for each k: Q is F(theta)^-1 and what is orthogonal to
    all F_k, nothing at all in one case of four. Some have rows that theta fits exactly.
    """
    n = int(rng.integers(1, 5))
    theta = short(rng, n)
    m = int(rng.integers(0, 3))
    R = short(rng, m, n)
    constraints = []
    for k in range(int(rng.integers(1, 4))):
        d = int(rng.integers(1, 5))
        shapes = [short(rng, d, d) for _ in range(n)]
        shapes = [a + a.T for a in shapes]
        inside = definite(rng, d)
        constant = inside - sum(x * a for x, a in zip(theta, shapes, strict=True))
        dual = np.linalg.inv(inside)
        beside = short(rng, d, d)
        beside = beside + beside.T
        basis = np.linalg.qr(np.array([a.ravel() for a in shapes]).T)[0]
        for _ in range(2):  # twice, for rounding
            flat = beside.ravel() - basis @ (basis.T @ beside.ravel())
            beside = 0.5 * (flat.reshape(d, d) + flat.reshape(d, d).T)
        size = 0.0 if rng.random() < 0.25 else float(rng.uniform(0.1, 0.9))
        least = np.linalg.eigvalsh(dual)[0] / (1e-300 + np.linalg.norm(beside, 2))
        inverse = dual + size * min(least, 1.0) * beside
        dual, inverse = 0.5 * (dual + dual.T), 0.5 * (inverse + inverse.T)
        log_det = -float(np.linalg.slogdet(inverse)[1])
        e = entropy_of(float(rng.integers(1, 5)) / 2, dual, inverse, log_det)
        coefficients = np.array(shapes).reshape(n, -1)
        flat = constant.ravel()
        c = constraint(k, "psd", range(n), flat, coefficients, 0.0 * flat, e)
        constraints.append(c)
    return with_interval(proof(R, R @ theta, np.zeros(m), theta, constraints))


def with_interval(p):
    """The proof with the ends that its multipliers prove, as doubles outward."""
    exact = verify_proof.typed(
        signed(p | {"lower": "0", "upper": "0"}), verify_proof.OPTIMUM, {}
    )
    constant, slope = verify_proof.dual_bound(exact)
    bound = exact["bound"]
    lower = constant - sum(abs(e) * b for e, b in zip(slope, bound, strict=True))
    upper = verify_proof.objective(exact)
    ends = [np.nextafter(float(lower), -np.inf), np.nextafter(float(upper), np.inf)]
    return p | {"lower": repr(float(ends[0])), "upper": repr(float(ends[1]))}


def inflated(p, rng):
    """A constant in the objective that makes it look large beside a wide interval: it
    holds, and says nothing of what is above zero."""
    p = copy.deepcopy(p)
    entropies = [e for c in p["constraints"] for e in c["entropy"]]
    weights = [number(e["weight"]) for e in entropies]
    if not any(weights):
        return None
    e = entropies[int(np.argmax(weights))]
    more = float(rng.choice([1e3, 1e6, 1e12]))
    e["log_det"] = text(float(Fraction(e["log_det"])) + more)
    p = with_interval(p)
    # As wide as what the objective is above its constant.
    size = size_above_constants(p)
    if size < 1e-6:
        return None
    width = size * float(rng.choice([0.01, 1.0, 30.0]))
    return p | {"lower": repr(float(p["lower"]) - width)}


def size_above_constants(p):
    """The loss and the divergences at theta, in floating point."""
    x = number(p["theta"])
    rows = number(p["R"]).reshape(-1, len(x)) @ x - number(p["rho"])
    total = number(p["floor"]) ** 2 + float(rows @ rows)
    for c in p["constraints"]:
        for e in c["entropy"]:
            F = content(c, x)
            d = round(len(F) ** 0.5)
            ratio = number(e["inverse"]).reshape(d, d) @ F.reshape(d, d)
            log_det = float(np.linalg.slogdet(ratio)[1])
            total += number(e["weight"]) * (float(np.trace(ratio)) - log_det - d)
    return float(total)


def widened(p, rng):
    """An end moved away by a hundredth of the objective's size, or far more."""
    width = (size_above_constants(p) + 1e-6) * float(rng.choice([0.01, 1.0, 1e6]))
    if rng.random() < 0.5:
        return p | {"lower": repr(float(p["lower"]) - width)}
    return p | {"upper": repr(float(p["upper"]) + width)}


def infeasible(rng):
    """s x >= 1 + a and -s x >= 1 - a in any of the parameters, beside constraints that
    always hold."""
    p = genuine(rng)
    n = len(p["bound"])
    a = float(short(rng, 1)[0])
    s = float(rng.integers(1, 9)) / 4
    k = int(rng.integers(0, n))
    for c in p["constraints"]:
        c.update(entropy=[], dual=["0"] * len(c["constant"]))
    for sign in (1.0, -1.0):
        c = constraint(
            "one", "nonnegative", [k], [-1.0 - sign * a], [[sign * s]], [1.0]
        )
        p["constraints"].append(c)
    return without_optimum(p)


def without_optimum(p):
    """The same multipliers as a claim that nothing is feasible."""
    rest = {key: v for key, v in p.items() if key not in ("theta", "lower", "upper")}
    return rest | {"kind": "infeasible", "R": [], "rho": [], "y": [], "floor": "0"}


# False claims: each takes a genuine proof and returns one that is known to be false, or
# None.


def swapped(p, rng):
    """lower above the objective of a feasible point, upper below it."""
    f = value(p, number(p["theta"]))
    off = (1.0 + abs(f)) * float(rng.choice([2 * _CLEARLY, 1e-3, 1.0, 1e6]))
    return p | (
        {"lower": repr(f + off)} if rng.random() < 0.5 else {"upper": repr(f - off)}
    )


def outside(p, rng):
    """A theta that violates a constraint or a bound, with an upper bound that it would
    have."""
    x = number(p["theta"]) + float(rng.choice([1.0, 8.0])) * short(rng, len(p["theta"]))
    return (
        p | {"theta": texts(x), "upper": repr(1e9)}
        if value(p, x) == float("inf")
        else None
    )


def wrong_dual(p, rng):
    """A multiplier outside its cone, as long as it takes to prove a lower bound above
    f(theta)."""
    p, k = copy.deepcopy(p), int(rng.integers(0, len(p["constraints"])))
    c = p["constraints"][k]
    x = number(p["theta"])
    F = content(c, x)
    direction = -F / np.linalg.norm(F)
    if c["cone"] == "psd":
        matrix = F.reshape([round(len(F) ** 0.5)] * 2)
        ways = (
            -np.eye(len(matrix)),
            np.diag(np.diag(matrix)) - matrix,
            -np.tril(matrix, -1),
        )
        direction = ways[int(rng.integers(0, 3))].ravel()
        if float(direction @ F) >= 0.0:
            return None
    scale = float(rng.choice([1.0, 2.0**10, 2.0**40]))
    c["dual"] = texts(np.round(scale * direction * 64) / 64)
    return p | {"lower": repr(value(p, x) + 1.0 + abs(value(p, x)))}


def singular(p, rng):
    """An entropy at a singular matrix: f(theta) is infinite, whatever upper says. Or a
    singular or indefinite dual of the entropy of a large constant matrix, whose -log
    det is below whatever the logarithm of such a dual is taken to be."""
    d = int(rng.integers(1, 7))
    v = short(rng, d, max(d - 1, 1)) * (d > 1)
    if rng.random() < 0.5:
        return with_entropy(p, v @ v.T, definite(rng, d)) | {"upper": repr(1e300)}
    v = v * float(rng.choice([0.0, 1.0]))
    dual = v @ v.T * float(rng.choice([1.0, -1.0])) * 2.0**-40
    p = with_entropy(p, 2.0 ** float(rng.integers(8, 40)) * np.eye(d), dual)
    best = value(p, number(p["theta"]))
    size = 1.0 + abs(best)
    return p | {"lower": repr(best + _CLEARLY * 2 * size), "upper": repr(best + size)}


def with_entropy(p, F, dual):
    """The same with one more constraint, of a constant matrix that has an entropy."""
    e = entropy_of(1.0, dual, np.eye(len(F)), 0.0)
    c = constraint("constant", "psd", [], F.ravel(), [], np.zeros(F.size), e)
    return p | {"constraints": [*p["constraints"], c]}


def concave(p, rng):
    """A negative weight of an entropy: no convex problem, and none of docs/proof.md."""
    p = copy.deepcopy(p)
    entropies = [e for c in p["constraints"] for e in c["entropy"]]
    for e in entropies:
        e["weight"] = "-1/2"
    return p if entropies else None


#: What a number must not look like; {} is a true one, so that nothing else is wrong.
_NUMBERS = (
    "1e99999999| {}|{}"
    " |{}_0|+{}|0x10|1/0|nan|inf||.5|--1|1e400|1e9999|\uff11|-|{}/1/2|{} /1|1/-2|1/3"
)
_NUMBERS += "|{}" + 5000 * "0" + "|1/" + 5000 * "2"
_OTHERS = [1, 0.5, None, True, [], {}, ["1"], "one", -1, 10**30]


def malformed(p, rng):
    """One field lost, added, of another type or range, an index that is none, a list
    too long."""
    p = copy.deepcopy(p)
    pick = random.Random(int(rng.integers(0, 2**31)))
    parent = pick.choice([p, p, *p["constraints"]])
    key = pick.choice([k for k in parent if k != "format"])
    indices = pick.choice([c["indices"] for c in p["constraints"]])
    place = pick.choice(["floor", *(f for f in ("bound", "y", "rho") if p[f])])
    numbers = [p["floor"]] if place == "floor" else p[place]
    odd = pick.choice(_NUMBERS.split("|")).replace("{}", numbers[0])
    other = pick.choice(_OTHERS)
    what = pick.randrange(5)
    if what == 0:
        del parent[key]
    elif what == 1:
        parent["more"] = "1"
    elif what == 2 and indices:
        indices[0] = pick.choice([-1, len(p["bound"]), *indices[1:], True, "0"])
    elif what == 3:
        longer = [*numbers, "1"] if pick.random() < 0.5 else [odd, *numbers[1:]]
        p[place] = odd if place == "floor" else longer
    elif what == 4 and type(other) is not type(parent[key]):
        parent[key] = other
    else:
        return None
    return p


FALSE = {
    f.__name__: f for f in (swapped, outside, wrong_dual, singular, concave, malformed)
}
#: Infeasibility of what has a feasible point, with the multipliers of the optimum.
FALSE["impossible"] = lambda p, rng: without_optimum(p)


def unreadable(whole, rng):
    """A file that is not the JSON of a proof: broken, a field twice, changed after it
    was signed."""
    ways = (
        lambda: whole[: int(rng.integers(0, len(whole)))],
        lambda: whole.replace('"floor"', '"floor": "1", "floor"', 1),
        lambda: whole.replace('"kind"', '"kind": NaN, "also"', 1),
        lambda: "\ufeff" + whole,
        lambda: "[" * int(rng.integers(1, 200_000)),
        lambda: whole.replace('"name": "', '"name": "-', 1),
        lambda: whole.replace(verify_proof.FORMAT, "sdp-vs-penalty proof 1", 1),
    )
    return ways[int(rng.integers(0, len(ways)))]()


def cases(count, seed=0):
    """(kind, text of the file, whether it must be accepted): one genuine in four."""
    rng = np.random.default_rng(seed)
    names = [*FALSE, "unreadable"]
    made = 0
    while made < count:
        true = infeasible(rng) if rng.random() < 0.2 else genuine(rng)
        whole = json.dumps(signed(true))
        if made % 4 == 0:
            made += 1
            yield f"genuine {true['kind']}", whole, True
            continue
        name = names[int(rng.integers(0, len(names)))]
        if name == "unreadable":
            made += 1
            yield name, unreadable(whole, rng), False
        elif true["kind"] == "optimum" or name == "malformed":
            false = FALSE[name](true, rng)
            if false is not None:
                made += 1
                yield name, json.dumps(signed(false)), False
