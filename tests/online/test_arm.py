"""The arm at one instant is the arm of the model; the filters have the stated delay."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sdp_vs_penalty import InputError, identify, load_problem
from sdp_vs_penalty.effects import Model, Motion, parse_effects
from sdp_vs_penalty.effects.effect import JointEffect
from sdp_vs_penalty.online import ArmModel, SmoothingFilter

EFFECTS = (
    "rigid_body,viscous_friction,coulomb_friction,stribeck_friction,torque_offset,"
    "rotor_inertia,joint_spring"
)


def arm(name, effects, gains=None):
    robot = load_problem(name).robot
    model = Model(robot, parse_effects(effects, robot), gains=gains)
    theta = np.random.default_rng(0).normal(size=len(model.parameters))
    return ArmModel(model, theta)


@pytest.mark.parametrize("name", ["panda", "ur10e", "two_link", "dvrk_psm"])
def test_the_torque_is_the_models(name):
    one = arm(name, EFFECTS)
    rng = np.random.default_rng(1)
    for scale in (1e-4, 1e-2, 1.0):
        q, dq, ddq = rng.normal(size=(3, one.n)) * [[1.0], [scale], [1.0]]
        one.update(q, dq, ddq)
        motion = Motion(np.zeros(1), q[None], dq[None], ddq[None])
        torque = one.model.torque(one.theta, motion)[0]
        assert_allclose(one.torque, torque, atol=1e-4, rtol=1e-4)


def test_a_models_controller_makes_its_torque(hidden):
    estimate = identify(hidden.problem, hidden.train, check=False)
    state = np.random.default_rng(2).normal(size=(3, 2))
    loop = estimate.controller()
    loop.update(*state)
    assert_allclose(loop.torque, estimate.predict(*state)[0], atol=1e-4)


class GearDrag(JointEffect):
    """Viscous friction that grows with the load, as a user may write it."""

    equation = "g |tau_l| dq"
    symbol = "g"
    needs_links = True

    def column(self, motion, joint):
        return np.abs(motion.link_torque[:, joint]) * motion.dq[:, joint]


@pytest.mark.parametrize("name", ["panda", "two_link", "dvrk_psm"])
@pytest.mark.parametrize("own", [False, True])
def test_friction_by_load_refers_to_the_links_of_its_identification(name, own):
    """As the model's columns do: to those of ``reference``, not of theta."""
    robot = load_problem(name).robot
    plain = Model(robot, parse_effects("rigid_body,coulomb_friction", robot))
    by_load = (GearDrag(robot),)
    if not own:
        by_load = parse_effects("load_dependent_friction", robot)
    model = Model(robot, (*plain.effects, *by_load))
    theta, reference = np.random.default_rng(0).normal(size=(2, len(model.parameters)))
    model = replace(model, reference=reference)
    one = ArmModel(model, theta)
    q, dq, ddq = np.random.default_rng(1).normal(size=(3, one.n))
    one.update(q, dq, ddq)
    motion = Motion(np.zeros(1), q[None], dq[None], ddq[None])
    expected = model.torque(theta, motion)[0]
    assert_allclose(one.torque, expected, rtol=1e-4, atol=1e-4)
    without_load = ArmModel(plain, theta[: len(plain.parameters)]).dry_friction
    assert np.any(one.dry_friction != without_load)


@pytest.mark.parametrize("name", ["panda", "ur10e", "dvrk_psm"])
def test_the_columns_are_the_payloads_effect(name):
    one = arm(name, EFFECTS)
    q, dq, ddq = np.random.default_rng(1).normal(size=(3, one.n))
    one.update(q, dq, ddq)
    (payload,) = parse_effects("payload", one.model.robot)
    columns = payload.torques(Motion(np.zeros(1), q[None], dq[None], ddq[None]))[0]
    assert_allclose(one.columns, columns, atol=1e-9)


def test_gains_scale_torque_and_columns():
    plain = arm("two_link", EFFECTS)
    scaled = arm("two_link", EFFECTS, (0.9, 1.2))
    q, dq, ddq = np.random.default_rng(1).normal(size=(3, 2))
    plain.update(q, dq, ddq)
    scaled.update(q, dq, ddq)
    assert_allclose(scaled.torque, [0.9, 1.2] * plain.torque)
    assert_allclose(scaled.columns, [[0.9], [1.2]] * plain.columns)


@pytest.mark.parametrize(
    "effect",
    ["presliding_hysteresis", "joint_elasticity", "torque_gain", "torque_ripple"],
)
def test_an_effect_that_needs_more_is_refused_by_name(effect):
    with pytest.raises(InputError, match=f"{effect}.*add --only"):
        arm("two_link", f"rigid_body,{effect}")


@pytest.mark.parametrize("rate", [100.0, 1000.0])
def test_a_cubic_comes_out_exactly_and_late_by_the_delay(rate):
    one = SmoothingFilter(1, 1.0 / rate, 0.05)
    out = np.zeros((3, 1))
    for t in np.arange(0.0, 0.5, 1.0 / rate):
        is_full = one.push(np.array([1.0 + t - t**2 + t**3]), out)
    then = t - one.delay
    assert is_full
    expected = [1.0 + then - then**2 + then**3, 1 - 2 * then + 3 * then**2]
    assert_allclose(out[:2, 0], expected)
    assert_allclose(out[2, 0], -2.0 + 6.0 * then, atol=1e-6)


def test_a_delay_beyond_fifty_milliseconds_is_refused():
    with pytest.raises(InputError, match=r"delay of 0\.06 s"):
        SmoothingFilter(1, 1e-3, 0.06)
