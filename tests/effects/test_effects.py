"""Single effects beyond the contracts, what a model makes of several, and what is
refused."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from random_robots import sines
from recorded import refusal, refusals, same_refusal
from scipy import interpolate

from sdp_vs_penalty.effects import (
    JointCoverage,
    Model,
    Motion,
    effect_types,
    parse_effects,
)
from sdp_vs_penalty.effects.measured_curve import Variable
from sdp_vs_penalty.problem import load_problem
from sdp_vs_penalty.testing.effect_contract import robots, steady_motion, wide_columns


def test_a_model_computes_its_current_torque_from_its_own_reference():
    robot = robots()["arm"]
    motion = steady_motion(robot)
    effects = "rigid_body,torque_gain,viscous_friction"
    model = Model(robot, parse_effects(effects, robot))
    bare = replace(motion, torque=None, current=None)
    refusal(lambda: model.columns(bare), "identify the robot without it first")
    links = motion.model_links
    theta = np.concatenate([links.ravel(), np.full(3, 0.05), np.full(3, 0.3)])
    torque = (
        robot.inverse_dynamics(links, motion.q, motion.dq, motion.ddq) + 0.3 * motion.dq
    )
    found = replace(model, reference=theta).torque(theta, bare)
    assert_allclose(found, 1.05 * torque, atol=1e-9)


def test_without_links_what_depends_on_them_makes_no_torque():
    robot = robots()["arm"]
    motion = steady_motion(robot)
    effects = parse_effects("viscous_friction,joint_zero_error,torque_gain:1", robot)
    model = Model(robot, effects, reference=np.full(7, 0.4))
    columns = model.columns(Motion(motion.t, motion.q, motion.dq, motion.ddq))
    assert [c.indices.tolist() for c in columns] == [
        [0, 3, 4, 5, 6],
        [1, 3, 4, 5],
        [2, 3, 4, 5],
    ]
    for joint in range(robot.n):
        assert_array_equal(columns[joint].columns[:, 1:4], 0.0)
    assert_allclose(columns[0].columns[:, 4], 0.4 * motion.dq[:, 0])


def test_a_model_knows_the_gain_of_each_joints_position_error():
    robot = robots()["tree"]
    model = Model(
        robot,
        parse_effects("servo_integral:2,servo_position:2+3+5,torque_offset", robot),
    )
    named = [model.parameters[k].name if k >= 0 else "" for k in model.error_gains]
    assert named == ["", "kp2", "kp3", "", "kp5"]


def test_a_curve_reads_a_combination_of_joints():
    robot = robots()["arm"]
    motion = steady_motion(robots()["arm"])
    ends = "@xlow=-9@xhigh=9@v1=-9@v2=9"
    both, fast = parse_effects(
        [
            f"measured_curve:2@x=q@xj=2@xi=3@xc=-2{ends}",
            f"measured_curve:2@x=dq@xj=1@xi=2{ends}",
        ],
        robot,
    )
    assert [e.variable_names(1) for e in (both, fast)] == [("q2-2q3",), ("dq1+dq2",)]
    q = motion.q
    dq = motion.dq
    for effect, x in ((both, q[:, 1] - 2.0 * q[:, 2]), (fast, dq[:, 0] + dq[:, 1])):
        assert_allclose(wide_columns(effect, motion)[1, :, 0], np.clip(x, -9.0, 9.0))
        assert_array_equal(effect.outside(motion), np.abs(x) > 9.0)


def test_a_curve_is_its_values_between_its_ends_and_constant_beyond():
    """Against SciPy's interpolation, over one variable and over two; and tables that
    cannot be."""
    robot = robots()["arm"]
    motion = steady_motion(robots()["arm"])
    kind = effect_types()["measured_curve"]
    values = np.random.default_rng(3).normal(size=12)
    q = motion.q[:, 1]
    dq = motion.dq[:, 1]
    low, high = np.quantile(q, (0.1, 0.8)).tolist()  # beyond both it is held
    table = {f"v{k}": float(v) for k, v in enumerate(values, start=1)} | {
        "xlow": low,
        "xhigh": high,
    }
    one = kind(robot, [1], xn=12.0, **table)
    along = np.interp(q, np.linspace(low, high, 12), values)
    assert_allclose(wide_columns(one, motion)[1, :, 0], along, atol=1e-12)
    assert_array_equal(one.outside(motion), (q < low) | (q > high))
    two = kind(
        robot, [1], xn=3.0, y=2.0, yn=4.0, ylow=dq.min(), yhigh=dq.max(), **table
    )
    knots = np.linspace(low, high, 3), np.linspace(dq.min(), dq.max(), 4)
    both = interpolate.RegularGridInterpolator(knots, values.reshape(3, 4))
    expected = both(np.column_stack([np.clip(q, low, high), dq]))
    assert_allclose(wide_columns(two, motion)[1, :, 0], expected, atol=1e-12)
    for key, value, said in (
        ("xn", 12.5, "whole number"),
        ("xn", 0.0, "whole number"),
        ("xn", 11.0, "table of 11"),
        ("xlow", high, "low end"),
        ("xj", 4.0, "no joint"),
        ("xi", -1.0, "no joint"),
    ):
        refusal(
            lambda k=key, x=value: kind(robot, [1], **{"xn": 12.0, **table, k: x}), said
        )


@pytest.mark.parametrize(
    "name",
    ["q4", "sign(dq1)", "abs(ddq2)", "t", "temp12", "tau3", "q5+q6", "dq5-0.5dq6"],
)
def test_a_variable_reads_back_as_it_is_written(name):
    assert Variable.parse(name).name == name


@pytest.mark.parametrize(
    ("start", "written"),
    [(0.0, "0"), (12.34567, "12.3457"), (1732650123.25, "1732650123.25")],
)
def test_the_instant_from_which_time_counts_reads_back_to_the_millisecond(
    start, written
):
    robot = robots()["arm"]
    effect = effect_types()["drift_friction"](robot, [0], t0=start)
    assert effect.text.endswith(f"@t0={written}")
    (again,) = parse_effects(effect.text, robot)
    assert again.shape["t0"] == pytest.approx(start, abs=1e-3, rel=0.0)


@pytest.mark.parametrize(
    "text", ["q", "q0", "speed2", "t3", "q5+dq6", "phase(q4)", "sign(q4)", "none1"]
)
def test_what_is_no_variable_is_refused(text):
    with pytest.raises(ValueError, match="no variable"):
        Variable.parse(text)


@pytest.mark.parametrize("text", refusals("effects"))
def test_an_effect_that_does_not_exist_is_refused(text):
    assert same_refusal(
        "effects", text, refusal(lambda: parse_effects(text, robots()["tree"]))
    )


@pytest.mark.parametrize(
    ("effect", "finest"),
    [("torque_ripple", 2.0 * np.pi / 0.005), ("position_dependent_friction", 300.0)],
)
def test_waves_that_are_sought_along_a_slide_are_told_apart_over_its_travel(
    effect, finest
):
    """Neighbours half a wave apart from one whole wave on, the finest with a pitch of 5
    mm."""
    robot = robots()["slide"]
    for travel in (0.2, 0.7):
        slide = replace(
            robot, joints=(replace(robot.joints[0], lower=-0.1, upper=travel - 0.1),)
        )
        every = [e.shape for e in effect_types()[effect].candidates(slide, 0)]
        waves = np.array(
            [shape["k"] for shape in every if shape.get("waves", 1.0) == 1.0]
        )
        assert_allclose(np.diff(waves), np.pi / travel, rtol=2e-3)
        assert waves[0] == pytest.approx(2.0 * np.pi / travel, rel=1e-4)
        assert waves[-1] <= 1.0001 * finest
        assert len(waves) == 200 or waves[-1] > 0.999 * finest - np.pi / travel


@pytest.mark.parametrize(
    ("waves", "is_tried", "is_named"),
    [(0.9, False, False), (1.9, True, False), (2.1, True, True)],
)
def test_a_ripple_is_named_where_it_was_seen_to_repeat(waves, is_tried, is_named):
    """A wave is tried from one period on; two show that it repeats: a part of one looks
    like a spring."""
    ripple = effect_types()["torque_ripple"](robots()["arm"], [0], k=3.0)
    coverage = JointCoverage(travel=waves * 2.0 * np.pi / 3.0)
    assert (ripple.looks_like(0.0, coverage) == "") == is_tried
    assert (ripple.looks_like(0.2, coverage) == "") == is_named
    assert ("joint_spring" not in ripple.resembles_over(coverage)) == is_named


@pytest.mark.parametrize("name", ["torque_delay", "global_delay", "torque_filter"])
def test_a_delay_is_longer_than_instants_are_known(name):
    delay = effect_types()[name](robots()["arm"])
    coverage = JointCoverage(step=0.004)
    doubts = [delay.looks_like(size, coverage) != "" for size in (0.0, 3e-4, -3e-4)]
    assert doubts == [False, True, True]
    assert delay.looks_like(5e-4, coverage) == ""


@pytest.mark.parametrize("side", [1.0, 2.0])
@pytest.mark.parametrize(
    ("q0", "is_tried"), [(-0.5, False), (-0.3, True), (0.7, True), (0.9, False)]
)
def test_a_stop_is_tried_where_the_joint_was_before_it_and_beyond_it(
    q0, is_tried, side
):
    stop = effect_types()["end_stop"](robots()["arm"], [0], q0=q0, side=side)
    coverage = JointCoverage(travel=1.2, lowest=-0.4, highest=0.8)
    assert (stop.looks_like(0.0, coverage) == "") == is_tried


def test_torque_is_that_of_the_columns_over_the_models_own_width():
    """Stribeck friction turns over the width of the Coulomb friction beside it."""
    robot = robots()["arm"]
    motion = sines(np.random.default_rng(2), robot.n, np.arange(0.0, 4.0, 0.01))
    model = Model(
        robot, parse_effects("coulomb_friction@v_s=0.3,stribeck_friction", robot)
    )
    theta = np.linspace(0.5, 1.5, len(model.parameters))
    torque = np.column_stack(
        [c.columns @ theta[c.indices] for c in model.columns(motion)]
    )
    sign = np.tanh(motion.dq / 0.3)
    dip = np.exp(-((motion.dq / 0.1) ** 2))
    assert_allclose(torque, sign * (theta[:3] + theta[3:] * dip), atol=1e-12)
    assert_allclose(model.torque(theta, motion), torque, atol=1e-12)


def test_what_is_smoothed_is_the_motion_without_what_is_faster():
    """To its ends, where Butterworth's filter there and back lies twice as far beside
    it."""
    t = np.arange(1501) / 1000.0
    slow = np.sin(5.0 * t + 0.3)
    fast = 0.1 * np.sin(2.0 * np.pi * 80.0 * t)
    left = Motion(t, *[slow[:, None]] * 3).smoothed(slow + fast, 20.0) - slow
    assert np.abs(left).max() < 5e-4


def test_a_model_takes_names_and_effects_beside_each_other():
    problem = load_problem("two_link")
    (spring,) = parse_effects("joint_spring:2", problem.robot)
    model = problem.model(["rigid_body", spring, "viscous_friction"])
    assert [effect.text for effect in model.effects] == [
        "rigid_body",
        "joint_spring:2",
        "viscous_friction",
    ]


@pytest.mark.parametrize("item", [3, None, b"viscous_friction"])
def test_what_is_neither_a_name_nor_an_effect_is_refused(item):
    problem = load_problem("two_link")
    refusal(lambda: problem.model(["rigid_body", item]), "neither a name nor an Effect")


def test_no_link_swings_on_an_inertia_that_is_not_positive(two_link):
    """Least squares may give a link such an inertia at some instants."""
    effect = effect_types()["joint_resonance"](two_link.robot, [0])
    n_instants = 50
    square = np.ones((n_instants, 2))
    motion = SimpleNamespace(
        q=0.0 * square,
        mean_inertias=np.ones(2),
        derivatives=lambda joint: (square, square, -square),
    )
    assert not effect.torque_per_deviation(motion, 0).any()


@pytest.mark.parametrize("count", [801, 802, 808, 815])
def test_kinematic_errors_between_some_instants_are_cubic_splines(count):
    """Torque and columns come from the same instants, of a motion with another torque
    as well, and for any number of samples behind the last even one."""
    robot = robots()["arm"]
    t = np.arange(count) / 400.0
    q = np.outer(np.sin(2.0 * t), [0.5, 0.8, -0.6])
    dq = np.outer(2.0 * np.cos(2.0 * t), [0.5, 0.8, -0.6])
    links = steady_motion(robot).current
    motion = Motion(t, q, dq, -4.0 * q, current=links)
    effect = effect_types()["kinematic_error"](robot)
    instants = np.unique(np.append(np.arange(0, count, 16), count - 1))
    sparse = effect.torques(motion.part(instants))
    columns = effect.torques(motion.with_torque(q))
    assert_array_equal(effect.torques(motion), columns)
    expected = interpolate.CubicSpline(t[instants], sparse)(t)
    assert_allclose(columns, expected, rtol=1e-9, atol=1e-9)
    theta = np.random.default_rng(0).normal(size=columns.shape[2])
    assert_allclose(effect.torque(theta, motion), columns @ theta, rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize(
    ("over_expected", "contradicts"),
    [(0.2, True), (0.5, False), (1.0, False), (1.9, False), (2.1, True)],
)
def test_a_gear_is_as_soft_as_its_frequency_and_its_links_say(
    two_link, over_expected, contradicts
):
    """The compliance of an inertia of 0.3 kg m^2 that swings at 2.5 Hz is
    1 / ((2 pi 2.5)^2 0.3) rad/(N m)."""
    effect = effect_types()["joint_resonance"](two_link.robot, [0], f=2.5)
    compliance = np.array([over_expected / ((2.0 * np.pi * 2.5) ** 2 * 0.3)])
    assert effect.contradicts_itself(compliance, 0.3) == contradicts
    assert not effect.contradicts_itself(compliance, np.nan)


def test_a_force_along_parallel_axes_makes_no_torque(scara_arm):
    """But for the last digits of the angles in the robot's file."""
    kind = effect_types()["external_wrench"]
    robot = scara_arm.robot
    torque = kind(robot).torques(steady_motion(robot))
    largest = np.abs(torque).max(axis=(0, 1))
    assert np.all((largest == 0.0) | (largest > 1e-3))
    assert np.any(largest > 1e-3)
