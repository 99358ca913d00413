"""Every effect of the library: its columns against direct simulation, its sign, its units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from sdp_vs_penalty.effects import effect_types, parse_effects
from sdp_vs_penalty.effects.effect import CurrentModel, Effect, Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.presliding_hysteresis import dahl
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.robot import Robot

Array = NDArray[np.float64]

NAMES = sorted(set(effect_types()))

ISSUE_TABLE = {
    "viscous_friction": (set(), True),
    "coulomb_friction": ({"v_s"}, True),
    "torque_offset": (set(), False),
    "asymmetric_viscous_friction": (set(), False),
    "stribeck_friction": ({"vs", "delta"}, True),
    "sigmoid_friction": ({"v0"}, True),
    "power_law_friction": ({"alpha"}, False),
    "load_dependent_friction": (set(), True),
    "presliding_hysteresis": ({"d"}, True),
    "rotor_inertia": (set(), True),
    "joint_spring": (set(), False),
    "torque_gain": (set(), False),
    "torque_delay": (set(), False),
    "torque_ripple": ({"k"}, False),
    "joint_elasticity": (set(), True),
    "backlash": (set(), True),
    "joint_zero_error": (set(), False),
    "joint_coupling": ({"i", "form"}, False),
    "drift_offset": ({"form", "T", "t0"}, False),
    "drift_friction": ({"form", "T", "t0"}, False),
    "base_tilt": (set(), False),
    "external_wrench": (set(), False),
    "global_delay": (set(), False),
    "payload": (set(), False),
}


def harmonic(robot: Robot, t: Array) -> tuple[Array, Array, Array]:
    """A smooth motion whose derivatives are exact."""
    n = robot.n
    w = 0.7 + 0.31 * np.arange(n)
    phase = np.arange(n)
    q = 0.6 * np.sin(np.outer(t, w) + phase) + 0.2
    return (
        q,
        0.6 * w * np.cos(np.outer(t, w) + phase),
        -0.6 * w**2 * np.sin(np.outer(t, w) + phase),
    )


@pytest.fixture(scope="module")
def robots(panda: Problem) -> dict[str, Problem]:
    return {"panda": panda, "two_link": load_problem("two_link")}


def current_motion(problem: Problem, rate: float = 200.0, duration: float = 4.0) -> Motion:
    t = np.arange(0.0, duration, 1.0 / rate)
    q, dq, ddq = harmonic(problem.robot, t)
    links = problem.nominal_links
    torque = problem.robot.inverse_dynamics(links.ravel(), q, dq, ddq) + 0.3 * dq
    return Motion(t, q, dq, ddq, torque, CurrentModel(problem.robot, links))


def torque_of(effect: Effect, motion: Motion, theta: Array) -> Array:
    out = np.zeros_like(motion.q)
    for block in effect.blocks(motion):
        out[:, block.joint] += block.columns @ theta[block.parameters]
    return out


def test_the_library_is_the_table_of_the_interface() -> None:
    assert set(NAMES) == {"rigid_body", *ISSUE_TABLE}
    for name, (shape, signed) in ISSUE_TABLE.items():
        kind = effect_types()[name]
        assert set(kind.shape_defaults) == shape, name
        robot = load_problem("panda").robot
        lowers = {p.lower for p in kind(robot).parameters}
        assert lowers == ({0.0} if signed else {-np.inf}), name


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("which", ["panda", "two_link"])
def test_every_effect_documents_itself_and_fits_its_shapes(
    name: str, which: str, robots: dict[str, Problem]
) -> None:
    problem = robots[which]
    effect = effect_types()[name](problem.robot)
    assert effect.equation
    assert len(effect.explanation) > 40
    assert len(effect.reference) > 8
    parameters = effect.parameters
    assert all(p.unit and p.effect == name for p in parameters)
    assert len({p.name for p in parameters}) == len(parameters)
    motion = current_motion(problem)
    seen = set()
    for block in effect.blocks(motion):
        assert block.columns.shape == (len(motion.t), len(block.parameters))
        assert np.all(np.isfinite(block.columns))
        seen.update(block.parameters.tolist())
    assert seen <= set(range(len(parameters)))
    (again,) = parse_effects(effect.text, problem.robot)
    assert again.to_dict() == effect.to_dict()


@pytest.mark.parametrize("name", NAMES)
def test_columns_do_not_look_at_later_rows_or_at_other_joints_names(
    name: str, robots: dict[str, Problem]
) -> None:
    """The first half of a motion gives the first half of the columns (memory looks back only)."""
    problem = robots["panda"]
    effect = effect_types()[name](problem.robot)
    motion = current_motion(problem)
    half = len(motion.t) // 2
    first = Motion(
        *(x[:half] for x in (motion.t, motion.q, motion.dq, motion.ddq)),
        motion.model_torque[:half],
        motion.current,
    )
    whole = effect.blocks(motion)
    for a, b in zip(whole, effect.blocks(first), strict=True):
        # Central differences of the torque look two samples ahead.
        np.testing.assert_allclose(a.columns[: half - 2], b.columns[:-2], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_search_shapes_are_valid(name: str, robots: dict[str, Problem]) -> None:
    for problem in robots.values():
        kind = effect_types()[name]
        for joint in range(problem.robot.n):
            for shape in kind.shapes(problem.robot, joint):
                effect = kind(problem.robot, None if kind.whole_robot else [joint], **shape)
                assert set(shape) <= set(kind.shape_defaults)
                for key, (low, high) in kind.shape_bounds.items():
                    if key in shape:
                        assert low <= shape[key] <= high
                assert effect.parameters


@pytest.mark.parametrize("which", ["panda", "two_link"])
@pytest.mark.parametrize("name", ["joint_zero_error", "backlash", "joint_elasticity"])
def test_link_deviations_against_inverse_dynamics_at_the_deviated_state(
    name: str, which: str, robots: dict[str, Problem]
) -> None:
    problem = robots[which]
    robot = problem.robot
    t = np.arange(0.0, 2.0, 1e-3)
    q, dq, ddq = harmonic(robot, t)
    links = problem.nominal_links
    tau = robot.inverse_dynamics(links.ravel(), q, dq, ddq)
    motion = Motion(t, q, dq, ddq, tau, CurrentModel(robot, links))
    for joint in range(robot.n):
        size = 1e-5
        deviation = {
            "joint_zero_error": np.ones(len(t)),
            "backlash": -np.sign(tau[:, joint]),
            "joint_elasticity": -tau[:, joint],
        }[name]
        rates = [deviation, np.zeros(len(t)), np.zeros(len(t))]
        if name == "joint_elasticity":
            rates[1] = np.gradient(deviation, t)
            rates[2] = np.gradient(rates[1], t)
        moved = [x.copy() for x in (q, dq, ddq)]
        for x, change in zip(moved, rates, strict=True):
            x[:, joint] += size * change
        expected = (robot.inverse_dynamics(links.ravel(), *moved) - tau) / size
        got = torque_of(effect_types()[name](robot, [joint]), motion, np.ones(1))
        inside = slice(5, -5)
        scale = max(np.abs(expected[inside]).max(), 1e-3)
        np.testing.assert_allclose(got[inside], expected[inside], atol=2e-3 * scale)


def test_base_tilt_is_newton_euler_under_tilted_gravity(robots: dict[str, Problem]) -> None:
    problem = robots["panda"]
    motion = current_motion(problem)
    tilt = np.array([0.21, -0.4])
    gravity = (tilt[0], tilt[1], problem.robot.gravity[2])
    theta = problem.nominal_links.ravel()
    states = (motion.q, motion.dq, motion.ddq)
    tilted = replace(problem.robot, gravity=gravity).inverse_dynamics(theta, *states)
    level = problem.robot.inverse_dynamics(theta, *states)
    got = torque_of(effect_types()["base_tilt"](problem.robot), motion, tilt)
    np.testing.assert_allclose(got, tilted - level, atol=1e-10)


def test_external_wrench_does_the_work_of_its_force(robots: dict[str, Problem]) -> None:
    """Power of the joint torques balances F . v of the last joint's origin, from finite differences."""
    problem = robots["panda"]
    robot = problem.robot
    motion = current_motion(problem)
    force = np.array([3.0, -2.0, 5.0])
    got = torque_of(
        effect_types()["external_wrench"](robot), motion, np.concatenate([force, np.zeros(3)])
    )

    def origin(q: Array) -> Array:
        pose = np.eye(4)
        for joint, angle in zip(robot.joints, q, strict=True):
            turn = np.eye(4)
            turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
            pose = pose @ joint.placement @ turn
        return pose[:3, 3]

    for k in range(0, len(motion.t), 97):
        h = 1e-6
        velocity = (origin(motion.q[k] + h * motion.dq[k]) - origin(motion.q[k] - h * motion.dq[k])) / (
            2 * h
        )
        assert got[k] @ motion.dq[k] == pytest.approx(-force @ velocity, rel=1e-6, abs=1e-7)


def test_payload_is_a_heavier_last_link(robots: dict[str, Problem]) -> None:
    problem = robots["panda"]
    motion = current_motion(problem)
    theta = problem.nominal_links.copy()
    load = np.array([1.5, 0.1, -0.05, 0.2, 0.02, 0.001, 0.03, 0.0, 0.002, 0.01])
    states = (motion.q, motion.dq, motion.ddq)
    before = problem.robot.inverse_dynamics(theta.ravel(), *states)
    theta[-1] += load
    after = problem.robot.inverse_dynamics(theta.ravel(), *states)
    got = torque_of(effect_types()["payload"](problem.robot), motion, load)
    np.testing.assert_allclose(got, after - before, atol=1e-9)


@pytest.mark.parametrize("name", ["torque_delay", "global_delay"])
def test_delay_is_a_late_channel(name: str, robots: dict[str, Problem]) -> None:
    problem = robots["panda"]
    motion = current_motion(problem, rate=1000.0)
    late = 2e-3
    effect = effect_types()[name](problem.robot)
    got = torque_of(effect, motion, np.full(len(effect.parameters), late))
    tau = motion.model_torque
    delayed = np.column_stack([np.interp(motion.t - late, motion.t, c) for c in tau.T])
    inside = slice(10, -10)
    expected = (delayed - tau)[inside]
    np.testing.assert_allclose(got[inside], expected, atol=0.01 * np.abs(expected).max())


def test_dahl_is_the_solution_of_its_differential_equation() -> None:
    from scipy.integrate import solve_ivp

    t = np.linspace(0.0, 6.0, 6001)
    q, d = 0.02 * np.sin(2.0 * t) + 0.01 * np.sin(5.0 * t), 0.004
    speed = 0.04 * np.cos(2.0 * t) + 0.05 * np.cos(5.0 * t)

    def rate(now: float, z: Array) -> Array:
        v = 0.04 * np.cos(2.0 * now) + 0.05 * np.cos(5.0 * now)
        return (v - z * abs(v)) / d

    exact = solve_ivp(rate, (0.0, 6.0), [0.0], t_eval=t, rtol=1e-9, atol=1e-10, max_step=0.01).y[0]
    # Turning points lie between samples: there the path is short by what one sample misses.
    np.testing.assert_allclose(dahl(q, d), exact, atol=2e-3)
    assert np.ptp(dahl(q, 1e-9)[10:]) == 2.0  # no travel at all: Coulomb
    assert np.all(
        np.sign(dahl(q, 1e-9)[np.abs(speed) > 1e-3][1:]) == np.sign(speed[np.abs(speed) > 1e-3][1:])
    )


def test_dahl_at_rest_and_through_repeated_samples() -> None:
    assert np.array_equal(dahl(np.full(5, 0.3), 0.01, 0.4), np.full(5, 0.4))
    moved = dahl(np.array([0.0, 0.01, 0.01, 0.02]), 0.01)
    assert moved[1] == moved[2] == pytest.approx(1 - np.exp(-1.0))
    assert moved[3] == pytest.approx(1 - np.exp(-2.0))


def test_dahl_is_fast_on_a_long_record() -> None:
    import time

    t = np.arange(20544) * 1e-3
    q = 0.5 * np.sin(np.outer(t, 0.5 + 0.3 * np.arange(7)))
    begin = time.perf_counter()
    for d in (0.001, 0.002, 0.004, 0.008, 0.016):
        for j in range(7):
            dahl(q[:, j], d)
    assert time.perf_counter() - begin < 1.0


def test_effects_never_read_a_measured_torque(robots: dict[str, Problem]) -> None:
    """Without a current model, effects that need one refuse instead of taking anything else."""
    problem = robots["panda"]
    motion = current_motion(problem)
    bare = Motion(motion.t, motion.q, motion.dq, motion.ddq)
    for name in NAMES:
        effect = effect_types()[name](problem.robot)
        if effect.needs_torque or effect.needs_links:
            with pytest.raises(ValueError, match="current model"):
                effect.blocks(bare)
        else:
            effect.blocks(bare)


def test_a_model_computes_its_current_torque_from_its_own_reference(
    robots: dict[str, Problem],
) -> None:
    problem = robots["panda"]
    model = problem.model("rigid_body,torque_gain,viscous_friction")
    motion = current_motion(problem)
    bare = Motion(motion.t, motion.q, motion.dq, motion.ddq)
    with pytest.raises(InputError, match="identify the robot without it first"):
        model.columns(bare)
    theta = np.concatenate([problem.nominal_links.ravel(), np.full(7, 0.05), np.full(7, 0.3)])
    model = Model(model.robot, model.effects, reference=theta)
    np.testing.assert_allclose(model.torque(theta, bare), 1.05 * motion.model_torque, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("base_tilt:2", "whole robot"),
        ("joint_coupling:3@i=3", "coupled to itself"),
        ("joint_coupling:3@form=7", "form is 1, 2, 3 or 4"),
        ("drift_offset@T=-1", "above 0"),
        ("drift_offset@form=3", "form is a whole number"),
        ("torque_ripple@d=3", "no shape constant"),
    ],
)
def test_wrong_effects_are_refused_in_one_sentence(text: str, message: str, panda: Problem) -> None:
    with pytest.raises(InputError, match=message) as caught:
        parse_effects(text, panda.robot)
    assert "\n" not in str(caught.value)
