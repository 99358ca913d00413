"""A model as an object of Pinocchio or MuJoCo makes the model's own torque."""

import numpy as np
import pytest
from dynamics_files import FULL, estimate_of
from numpy.testing import assert_allclose
from random_robots import states
from small_runs import small_model

from sdp_vs_penalty import InputError, export, load_problem
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.errors import Remark
from sdp_vs_penalty.exporters.export import friction_at_rest

ARMS = ("two_link", "panda")


def torque_of_links_and_rotors(estimate, q, dq, ddq):
    """Without friction, which Pinocchio's inverse dynamics leave out."""
    held = ("rigid_body", "rotor_inertia")
    theta = np.array(
        [
            value if parameter.effect in held else 0.0
            for parameter, value in zip(
                estimate.model.parameters, estimate.theta, strict=True
            )
        ]
    )
    return estimate.model.torque(theta, Motion(np.zeros(len(q)), q, dq, ddq))


@pytest.mark.parametrize("name", ARMS)
def test_pinocchio_makes_the_torque_of_links_and_rotors(name):
    pin = pytest.importorskip("pinocchio")
    robot = load_problem(name).robot
    estimate = estimate_of(robot, FULL, 3)
    model = estimate.to_pinocchio()
    data = model.createData()
    q, dq, ddq = states(robot, 30, 1)
    made = [pin.rnea(model, data, *row) for row in zip(q, dq, ddq, strict=True)]
    expected = torque_of_links_and_rotors(estimate, q, dq, ddq)
    assert_allclose(np.array(made), expected, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("name", ARMS)
def test_pinocchio_has_the_friction_in_its_fields(name):
    pytest.importorskip("pinocchio")
    robot = load_problem(name).robot
    estimate = estimate_of(robot, FULL, 3)
    model = estimate.to_pinocchio()
    values = {
        p.name: x
        for p, x in zip(estimate.model.parameters, estimate.theta, strict=True)
    }
    viscous = [values[f"f_v{j}"] for j in range(1, robot.n + 1)]
    assert_allclose(model.damping, viscous)


@pytest.mark.parametrize(
    ("effects", "lost"),
    [
        (f"{FULL},torque_offset", ""),
        (f"{FULL},load_dependent_friction:2", "load dependent friction on joint 2"),
        (f"{FULL},torque_gain", "torque gain"),
    ],
)
@pytest.mark.filterwarnings("always::sdp_vs_penalty.errors.Remark")
def test_what_mujoco_cannot_hold_is_named(effects, lost, recwarn):
    pytest.importorskip("mujoco")
    estimate_of(load_problem("two_link").robot, effects, 3).to_mjspec()
    said = [str(w.message) for w in recwarn if issubclass(w.category, Remark)]
    assert said == ([f"MuJoCo cannot hold {lost}"] if lost else [])


def test_a_model_without_links_is_no_pinocchio_model():
    robot = load_problem("two_link").robot
    with pytest.raises(InputError, match="no rigid_body"):
        estimate_of(robot, "viscous_friction", 3).to_pinocchio()


@pytest.fixture
def identified():
    return small_model("ols")


def test_a_frame_of_links_names_its_units(identified):
    frame = identified.links_frame()
    assert list(frame.index) == [1, 2]
    assert {"mass [kg]", "centre of mass x [m]", "thickness [mm]"} <= set(frame)


def test_base_parameters_have_full_expressions(identified):
    texts = " ; ".join(identified.base_frame()["expression"])
    assert "..." not in texts
    assert " + " in texts


def test_a_base_parameter_is_the_sum_that_its_expression_says(identified):
    parameters = zip(identified.model.parameters, identified.theta, strict=True)
    values = {p.name: float(x) for p, x in parameters}
    for _, row in identified.base_frame().iterrows():
        total = 0.0
        for term in row["expression"].replace("- ", "+ -").split(" + "):
            sign = -1.0 if term.startswith("-") else 1.0
            factor, _, name = term.lstrip("-").rpartition(" ")
            total += sign * float(factor or 1.0) * values[name]
        assert total == pytest.approx(row["value"], rel=5e-3, abs=1e-3)


@pytest.mark.parametrize("is_base", [False, True])
def test_a_covariance_is_labelled_on_both_sides(identified, is_base):
    frame = identified.covariance_frame(base=is_base)
    assert list(frame.index) == list(frame.columns)
    names = {p.name for p in identified.model.parameters}
    assert set(frame.index) <= names


def test_mujoco_holds_a_joint_at_rest_where_the_model_creeps(tmp_path):
    """Half the dry friction drives joint 1, without gravity; a file and a command say
    that both differ."""
    mujoco = pytest.importorskip("mujoco")
    robot = load_problem("two_link").robot
    estimate = estimate_of(robot, FULL, 3)
    names = [p.name for p in estimate.model.parameters]
    friction = estimate.theta[names.index("f_c1")]
    model = estimate.to_mjspec().compile()
    model.opt.gravity[:] = 0.0
    model.jnt_stiffness[:] = 0.0
    data = mujoco.MjData(model)
    data.ctrl[0] = 0.5 * friction
    while data.time < 1.0:
        mujoco.mj_step(model, data)
    width = estimate.model.sign_width[0]
    creep = width * np.arctanh(0.5)  # [rad/s], where F tanh(dq / v_s) = F / 2
    assert abs(data.qvel[0]) < 0.05 * creep
    words = f"turns round within about {width:.2g} rad/s"
    for name in ("a.xml", "a.urdf", "a.sdf", "a.drake.urdf"):
        assert words in friction_at_rest(estimate, name)
        export(estimate, tmp_path / name, force=True)
        assert words in (tmp_path / name).read_text()
    assert friction_at_rest(estimate, "a.h") == ""  # its formula is the model's own
    without = estimate_of(robot, "rigid_body,viscous_friction", 3)
    assert friction_at_rest(without, "a.xml") == ""
