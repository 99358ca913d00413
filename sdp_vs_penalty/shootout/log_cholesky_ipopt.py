"""Log-Cholesky variables and IPOPT (Waechter, Biegler 2006), with CasADi's exact derivatives.

Links are consistent by construction (:mod:`log_cholesky`); IPOPT imposes what remains.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from sdp_vs_penalty.constraints.constraint import Constraint
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.shootout.contestant import no_answer
from sdp_vs_penalty.shootout.instance import Instance
from sdp_vs_penalty.shootout.judge import Answer
from sdp_vs_penalty.shootout.log_cholesky import COLUMNS, DIAGONAL, ROWS, LogCholesky, owners

PACKAGE = "casadi"
#: Logarithms of a factor's diagonal stay within these bounds, in units of an interior point.
_LOGARITHM = 25.0


def options(accuracy: float) -> dict[str, Any]:
    """What IPOPT is told: bounds not relaxed, and no early end at an acceptable point."""
    return {
        "tol": 1e-3 * accuracy,
        "max_iter": 3000,
        "bound_relax_factor": 0.0,
        "acceptable_iter": 0,
        "print_level": 0,
        "sb": "yes",
    }


def solve(instance: Instance, accuracy: float) -> Answer:
    """Minimise from the interior point. Multipliers are IPOPT's; links' are left to the bound."""
    import casadi as ca

    start = time.perf_counter()
    interior = instance.interior
    if interior is None:
        return no_answer(instance, "no interior point to start from", 0.0)
    data = instance.data
    size = max(data.loss(instance.task.ols), 1e-9 * data.tau_squared, 1e-300)
    frame = LogCholesky.at(owners(instance.sent), interior)
    taken = {id(c) for c in frame.links}
    rows = [c for c in instance.sent if id(c) not in taken and c.cone != "psd"]
    begin = frame.variables(interior)
    x = ca.SX.sym("x", len(begin))
    theta = _theta(ca, frame, x)
    demands = [_demand(ca, c, theta, interior) for c in rows]
    problem = {"x": x, "f": _objective(ca, instance, theta) / size}
    if demands:
        problem["g"] = ca.vertcat(*demands)
    settings = {f"ipopt.{key}": value for key, value in options(accuracy).items()}
    program = ca.nlpsol("program", "ipopt", problem, {"print_time": 0, **settings})
    limit = np.full(len(begin), np.inf)
    limit[: 10 * len(frame.links)][np.tile(DIAGONAL, len(frame.links))] = _LOGARITHM
    ready = time.perf_counter()
    found = program(x0=begin, lbx=-limit, ubx=limit, **({"lbg": 0.0} if demands else {}))
    end = time.perf_counter()
    said = program.stats()
    best = frame.theta(np.array(found["x"]).ravel())
    return Answer(
        best,
        "optimal" if said["success"] else "failed",
        said["return_status"],
        int(said["iter_count"]),
        ready - start,
        end - ready,
        _multipliers(instance, rows, -size * np.array(found["lam_g"]).ravel(), best, interior),
    )


def _theta(ca: Any, frame: LogCholesky, x: Any) -> Any:
    theta = [ca.SX(0.0)] * frame.size
    for k, (c, back, corner) in enumerate(zip(frame.links, frame.maps, frame.corners, strict=True)):
        factor = ca.SX.zeros(4, 4)
        for e, (i, j) in enumerate(zip(ROWS.tolist(), COLUMNS.tolist(), strict=True)):
            factor[i, j] = ca.exp(x[10 * k + e]) if i == j else x[10 * k + e]
        matrix = ca.mtimes(factor, factor.T) * ca.DM(np.outer(corner, corner)) - ca.DM(c.constant)
        part = ca.mtimes(ca.DM(back.T), ca.reshape(matrix.T, 16, 1))
        for row, index in enumerate(c.indices):
            theta[int(index)] = part[row]
    for row, index in enumerate(frame.others):
        theta[int(index)] = x[10 * len(frame.links) + row] * float(frame.scale[row])
    return ca.vertcat(*theta)


def _objective(ca: Any, instance: Instance, theta: Any) -> Any:
    data, entropy = instance.data, instance.objective.entropy
    value = ca.sumsqr(ca.mtimes(ca.DM(data.R), theta) - ca.DM(data.rho)) + data.residual_norm**2
    if entropy is not None:
        for link, p0 in zip(entropy.links, entropy.nominal, strict=True):
            matrix = ca.DM(link.constant)
            for coefficient, index in zip(link.coefficients, link.indices, strict=True):
                matrix = matrix + ca.DM(coefficient) * theta[int(index)]
            trace = ca.trace(ca.mtimes(ca.DM(np.linalg.inv(p0)), matrix))
            value = value + entropy.weight * (trace - ca.log(ca.det(matrix)))
    return value


def _unit(constraint: Constraint, inside: Array) -> Array:
    """What each row of a demand is divided by: its size at the interior point."""
    size = np.abs(constraint.value(inside))
    return np.maximum(size[:1] if constraint.cone == "soc" else size, 1e-6)


def _demand(ca: Any, constraint: Constraint, theta: Any, inside: Array) -> Any:
    """At least zero."""
    part = theta[[int(i) for i in constraint.indices]]
    value = ca.DM(constraint.constant) + ca.mtimes(ca.DM(constraint.coefficients.T), part)
    if constraint.cone == "soc":
        value = value[0] - ca.sqrt(ca.sumsqr(value[1:]) + 1e-24)
    return value / ca.DM(_unit(constraint, inside))


def _multipliers(
    instance: Instance, rows: list[Constraint], slopes: Array, theta: Array, inside: Array
) -> list[Array]:
    """Of every constraint: IPOPT's for the rows, zero for the links, whose share the bound works out."""
    found, at = [], 0
    for c in rows:
        unit = _unit(c, inside)
        part = slopes[at : at + len(unit)] / unit
        at += len(unit)
        if c.cone == "soc":
            v = c.value(theta)
            part = part[0] * np.append(1.0, -v[1:] / max(float(np.linalg.norm(v[1:])), 1e-12))
        found.append((c, part))
    return instance.all_multipliers(found)
