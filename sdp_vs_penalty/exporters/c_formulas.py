"""Effects as lines of C: torque that has a closed form in q, dq, ddq and the links' load.

Each line adds to ``tau`` what one effect makes on one joint. Numbers are written so that
they read back to the same double.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.velocity_friction import WIDER_THAN_SIGN
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import number
from sdp_vs_penalty.robot.arrays import Array


def _sign(estimate: Estimate, joint: int) -> str:
    """Return C code for the smooth sign of a joint's velocity, tanh(dq / width)."""
    width = number(estimate.model.sign_width[joint])
    return f"tanh(dq[{joint}] / {width})"


def _asymmetric_viscous(
    e: Effect,
    j: int,
    theta: Array,
    m: Estimate,
) -> str:
    """Return C code for a torque of joint j proportional to its speed |dq|.

    e : the effect; theta : its parameters on this joint; m : the model.
    """
    return f"{number(theta[0])} * fabs(dq[{j}])"


def _asymmetric_coulomb(
    e: Effect,
    j: int,
    theta: Array,
    m: Estimate,
) -> str:
    """Return C code for a torque of joint j that is constant while it moves.

    e : the effect; theta : its parameters on this joint; m : the model.
    """
    return f"{number(theta[0])} * fabs({_sign(m, j)})"


def _power_law(
    e: Effect,
    j: int,
    theta: Array,
    m: Estimate,
) -> str:
    """Return C code for friction of joint j that grows with a power of the speed.

    e : the effect; theta : its parameters on this joint; m : the model.
    """
    alpha = number(e.shape["alpha"])
    return f"{number(theta[0])} * {_sign(m, j)} * pow(fabs(dq[{j}]), {alpha})"


def _sigmoid(
    e: Effect,
    j: int,
    theta: Array,
    m: Estimate,
) -> str:
    """Return C code for the slowly rising part of the friction of joint j.

    It is zero if it rises as fast as the smooth sign, which is subtracted. e : the
    effect; theta : its parameters on this joint; m : the model.
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


def _stribeck(
    e: Effect,
    j: int,
    theta: Array,
    m: Estimate,
) -> str:
    """Return C code for the friction of joint j that falls with speed (Stribeck).

    It falls exponentially (law 1) or as 1 / (1 + x). e : the effect; theta : its
    parameters on this joint; m : the model.
    """
    vs = number(e.shape["vs"])
    delta = number(e.shape["delta"])
    x = f"pow(fabs(dq[{j}]) / {vs}, {delta})"
    falls = f"exp(-{x})" if e.shape["law"] == 1.0 else f"1.0 / (1.0 + {x})"
    return f"{number(theta[0])} * {_sign(m, j)} * ({falls})"


def _load_dependent(
    e: Effect,
    j: int,
    theta: Array,
    m: Estimate,
) -> str:
    """Return C code for dry friction of joint j proportional to its load.

    e : the effect; theta : its parameters on this joint; m : the model.
    """
    return f"{number(theta[0])} * fabs(load[{j}]) * {_sign(m, j)}"


def _spring(
    e: Effect,
    j: int,
    theta: Array,
    m: Estimate,
) -> str:
    """Return C code for a spring at joint j.

    e : the effect; theta : its parameters on this joint; m : the model.
    """
    return f"{number(theta[0])} * q[{j}]"


def _waves(e: Effect, j: int, theta: Array) -> str:
    """Return C code for a sum of waves of joint j's position.

    theta : amplitudes of cosine and sine of each harmonic in turn.
    """
    k = e.shape["k"]
    terms = []
    for i, (a, b) in enumerate(theta.reshape(-1, 2), start=1):
        phase = f"{number(i)} * {number(k)} * q[{j}]"
        terms.append(f"{number(a)} * cos({phase}) + {number(b)} * sin({phase})")
    return " + ".join(terms)


def _ripple(
    e: Effect,
    j: int,
    theta: Array,
    m: Estimate,
) -> str:
    """Return C code for the torque ripple of joint j.

    e : the effect; theta : its parameters on this joint; m : the model.
    """
    return _waves(e, j, theta)


def _position_dependent(
    e: Effect,
    j: int,
    theta: Array,
    m: Estimate,
) -> str:
    """Return C code for dry friction of joint j that varies with its position.

    e : the effect; theta : its parameters on this joint; m : the model.
    """
    return f"{_sign(m, j)} * ({_waves(e, j, theta)})"


def _coupling(
    e: Any,
    j: int,
    theta: Array,
    m: Estimate,
) -> str:
    """Return C code for friction of joint j that depends on its partner joint's
    velocity.

    The form is one of four: the velocity itself, its sign, or the sign of sum or
    difference. e : the effect; theta : its parameters on this joint; m : the model.
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
    "torque_ripple": _ripple,
    "position_dependent_friction": _position_dependent,
    "joint_coupling": _coupling,
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
        # As many parameters for each joint.
        theta_of_joints = estimate.theta[indices].reshape(len(effect.joints), -1)
        for joint, theta in zip(effect.joints, theta_of_joints, strict=True):
            term = formula(effect, joint, theta, estimate)
            yield f"tau[{joint}] += {term}; /* {effect.name} */"
