"""Effects as lines of C: torque that has a closed form in q, dq, ddq and the links' load.

Each line adds to ``tau`` what one effect makes on one joint. Numbers are written so that
they read back to the same double.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.velocity_friction import WIDER_THAN_SIGN
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import number
from sdp_vs_penalty.robot.arrays import Array


def _sign(estimate: Estimate, joint: int) -> str:
    """Return C code for the smooth sign of a joint's velocity, tanh(dq / width)."""
    width = number(estimate.model.sign_width[joint])
    return f"tanh(dq[{joint}] / {width})"


def _asymmetric_viscous(e: Effect, j: int, theta: Array, m: Estimate) -> str:
    """Return C code for tau_j = f |dq_j|: a torque of joint j (from 0) proportional to
    its speed.

    e : the effect; theta : (1,) f, its parameter on this joint; m : the model.
    """
    return f"{number(theta[0])} * fabs(dq[{j}])"


def _asymmetric_coulomb(e: Effect, j: int, theta: Array, m: Estimate) -> str:
    """Return C code for tau_j = f |tanh(dq_j / width)|: a torque of joint j (from 0)
    that is constant while it moves.

    e : the effect; theta : (1,) f, its parameter on this joint; m : the model.
    """
    return f"{number(theta[0])} * fabs({_sign(m, j)})"


def _power_law(e: Effect, j: int, theta: Array, m: Estimate) -> str:
    """Return C code for tau_j = f tanh(dq_j / width) |dq_j|^alpha: friction of joint j
    (from 0).

    e : the effect, with its shape constant alpha; theta : (1,) f; m : the model.
    """
    alpha = number(e.shape["alpha"])
    return f"{number(theta[0])} * {_sign(m, j)} * pow(fabs(dq[{j}]), {alpha})"


def _sigmoid(e: Effect, j: int, theta: Array, m: Estimate) -> str:
    """Return C code for tau_j = f (s(dq_j / v0) - tanh(dq_j / width)): friction of
    joint j (from 0) that rises slowly, less Coulomb's jump.

    s is tanh, atan or an algebraic function. The code is "0.0" if s rises as fast as
    the smooth sign, as in the effect's own columns. e : the effect; theta : (1,) f; m :
    the model.
    """
    if e.shape["v0"] < WIDER_THAN_SIGN * m.model.sign_width[j]:
        return "0.0"
    x = f"dq[{j}] / {number(e.shape['v0'])}"
    rise = {
        "tanh": f"tanh({x})",
        "atan": f"2.0 / 3.14159265358979323846 * atan({x})",
        "algebraic": f"({x}) / hypot(1.0, {x})",
    }[e.shapes["law"].written(e.shape["law"])]
    return f"{number(theta[0])} * ({rise} - {_sign(m, j)})"


def _stribeck(e: Effect, j: int, theta: Array, m: Estimate) -> str:
    """Return C code for friction of joint j (from 0) that falls with speed (Stribeck).

    tau_j = f tanh(dq_j / width) g(x) with x = (|dq_j| / vs)^delta; g is exp(-x) for law
    1 (dip), 1 / (1 + x) for law 2 (tail). e : the effect; theta : (1,) f; m : the
    model.
    """
    vs = number(e.shape["vs"])
    delta = number(e.shape["delta"])
    x = f"pow(fabs(dq[{j}]) / {vs}, {delta})"
    falls = f"exp(-{x})" if e.shape["law"] == 1.0 else f"1.0 / (1.0 + {x})"
    return f"{number(theta[0])} * {_sign(m, j)} * ({falls})"


def _load_dependent(e: Effect, j: int, theta: Array, m: Estimate) -> str:
    """Return C code for tau_j = f |load_j| tanh(dq_j / width): dry friction of joint j
    (from 0) proportional to the torque of the links.

    e : the effect; theta : (1,) f, its parameter on this joint; m : the model.
    """
    return f"{number(theta[0])} * fabs(load[{j}]) * {_sign(m, j)}"


def _spring(e: Effect, j: int, theta: Array, m: Estimate) -> str:
    """Return C code for tau_j = k q_j: a spring at joint j (from 0).

    e : the effect; theta : (1,) k, its stiffness; m : the model.
    """
    return f"{number(theta[0])} * q[{j}]"


def _waves(e: Effect, j: int, theta: Array) -> str:
    """Return C code for sum_i a_i cos(i k q_j) + b_i sin(i k q_j), waves over the
    position of joint j (from 0).

    e : the effect, with the wave number k; theta : a_1, b_1, a_2, b_2, ...
    """
    k = e.shape["k"]
    terms = []
    for i, (a, b) in enumerate(theta.reshape(-1, 2), start=1):
        phase = f"{number(i)} * {number(k)} * q[{j}]"
        terms.append(f"{number(a)} * cos({phase}) + {number(b)} * sin({phase})")
    return " + ".join(terms)


def _ripple(e: Effect, j: int, theta: Array, m: Estimate) -> str:
    """Return C code for the torque ripple of joint j.

    e : the effect; theta : its parameters on this joint; m : the model.
    """
    return _waves(e, j, theta)


def _position_dependent(e: Effect, j: int, theta: Array, m: Estimate) -> str:
    """Return C code for dry friction of joint j that varies with its position.

    e : the effect; theta : its parameters on this joint; m : the model.
    """
    return f"{_sign(m, j)} * ({_waves(e, j, theta)})"


def _coupling(e: Any, j: int, theta: Array, m: Estimate) -> str:
    """Return C code for friction of joint j (from 0) that depends on the velocity of
    its partner joint i.

    Form 1 is viscous, f dq_i; forms 2 to 4 are dry, f tanh(v / width) with v = dq_i,
    dq_j + dq_i, or dq_j - dq_i. e : the effect; theta : (1,) f; m : the model.
    """
    i = e.partner(j)
    form = int(e.shape["form"])
    width = number(m.model.sign_width[j])
    motion = {
        1: f"dq[{i}]",
        2: _sign(m, i),
        3: f"tanh((dq[{j}] + dq[{i}]) / {width})",
        4: f"tanh((dq[{j}] - dq[{i}]) / {width})",
    }[form]
    return f"{number(theta[0])} * {motion}"


def _stiffening(e: Effect, j: int, theta: Array, m: Estimate) -> str:
    """Return C code for a spring of joint j (from 0) with a cubic law.

    e : the effect; theta : (3,) factors of q, q^2 and q^3; m : the model.
    """
    first, second, third = (number(x) for x in theta)
    q = f"q[{j}]"
    return f"{q} * ({first} + {q} * ({second} + {q} * {third}))"


def _end_stop(e: Any, j: int, theta: Array, m: Estimate) -> str:
    """Return C code for a spring that joint j (from 0) touches on one side of q0.

    e : the effect, with its shape constants q0 and side; theta : (1,) stiffness; m : the
    model.
    """
    side = "fmax" if e.is_above else "fmin"
    return f"{number(theta[0])} * {side}(q[{j}] - {number(e.shape['q0'])}, 0.0)"


def _elastic_coupling(e: Any, j: int, theta: Array, m: Estimate) -> str:
    """Return C code for the pull on joint j (from 0) of a spring over several joints.

    e : the effect; theta : all its stiffnesses, in the order of e.pairs; m : the model.
    """
    pulls = [
        f"{number(stiffness)} * q[{second if j == first else first}]"
        for stiffness, (first, second) in zip(theta, e.pairs, strict=True)
        if j in (first, second)
    ]
    return " + ".join(pulls)


Formula = Callable[[Any, int, Array, Estimate], str]
#: By the name of an effect what it makes on a joint (from 0), given its parameters there.
FORMULAS: Mapping[str, Formula] = {
    "asymmetric_viscous_friction": _asymmetric_viscous,
    "asymmetric_coulomb_friction": _asymmetric_coulomb,
    "power_law_friction": _power_law,
    "sigmoid_friction": _sigmoid,
    "stribeck_friction": _stribeck,
    "load_dependent_friction": _load_dependent,
    "joint_spring": _spring,
    "stiffening_spring": _stiffening,
    "end_stop": _end_stop,
    "torque_ripple": _ripple,
    "position_dependent_friction": _position_dependent,
    "joint_coupling": _coupling,
    "elastic_coupling": _elastic_coupling,
}


def formulas(estimate: Estimate) -> Iterator[str]:
    """Yield a line of C for each effect of the model and each joint that it acts on.

    Effects without a formula are left out.

    Parameters
    ----------
    estimate : Estimate
        The model.

    Returns
    -------
    iterator of str
        In the model's order.
    """
    for effect, indices in estimate.model.parts:
        formula = FORMULAS.get(effect.name)
        if formula is None:
            continue
        theta_of_effect = estimate.theta[indices]
        n_joints = len(effect.joints)
        # One parameter acts on all joints, or each joint has as many of them.
        theta_by_joint = (
            np.tile(theta_of_effect, (n_joints, 1))
            if effect.joins
            else theta_of_effect.reshape(n_joints, -1)
        )
        for joint, theta in zip(effect.joints, theta_by_joint, strict=True):
            term = formula(effect, joint, theta, estimate)
            yield f"tau[{joint}] += {term}; /* {effect.name} */"
