"""Models run forward: against MuJoCo, against exact solutions, and against their own
inverse."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.effects import Model, effect_types, parse_effects
from sdp_vs_penalty.effects.forward import (
    Plant,
    PlantState,
    _solve_friction_impulses,
    advance,
)
from sdp_vs_penalty.exporters.content import Content
from sdp_vs_penalty.exporters.mjcf import make_mjcf
from sdp_vs_penalty.robot import inertia

SIZES = {
    "viscous_friction": 0.3,
    "coulomb_friction": 0.4,
    "torque_offset": 0.1,
    "rotor_inertia": 0.1,
}


def plant(name, effects, **sizes):
    """The nominal robot with these effects, every parameter of one the same."""
    problem = load_problem(name)
    model = Model(problem.robot, parse_effects(effects, problem.robot))
    values = SIZES | sizes
    theta = np.array([values.get(p.effect, 0.0) for p in model.parameters])
    theta[model.rigid_indices] = problem.nominal_links.ravel()
    return Plant(model, theta)


def at_rest(p, q=0.3):
    n = p.robot.n
    zero = np.zeros((1, n))
    return PlantState(
        np.zeros(1), np.full((1, n), q), zero, zero, np.zeros((1, p.states)), zero, zero
    )


def run(p, state, torque, h):
    for row in torque:
        state = advance(p, state, row[None], h)
    return state


def test_simulations_side_by_side_weigh_what_each_does_alone():
    light = plant("two_link", "rigid_body,rotor_inertia")
    heavy = plant("two_link", "rigid_body,rotor_inertia", rotor_inertia=0.7)
    both = Plant(light.model, np.concatenate([light.theta, heavy.theta]))
    q = light.robot.random_configurations(2, 5)
    alone = [one.mass(row[None])[0] for one, row in zip((light, heavy), q, strict=True)]
    assert_allclose(both.mass(q), alone, rtol=1e-12)
    assert_allclose(heavy.mass(q) - light.mass(q), np.tile(0.6 * np.eye(2), (2, 1, 1)))


@pytest.mark.parametrize("name", ["two_link", "panda", "ur10e"])
def test_as_mujoco_with_armature_and_damping(name):
    mujoco = pytest.importorskip("mujoco")
    p = plant(name, "rigid_body,viscous_friction,rotor_inertia")
    n = p.robot.n
    h = 1e-3
    steps = 300
    own = p.theta[0, p.model.rigid_indices].reshape(-1, 10)
    frames = [joint.link_frame for joint in p.robot.joints]
    links = np.stack(
        [inertia.transform(f) @ row for f, row in zip(frames, own, strict=True)]
    )
    content = Content.of_links(
        p.robot,
        links,
        damping=np.full(n, SIZES["viscous_friction"]),
        armature=np.full(n, SIZES["rotor_inertia"]),
    )
    model = mujoco.MjModel.from_xml_string(make_mjcf(p.robot, content).decode())
    model.opt.timestep = h
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model.jnt_limited[:] = 0
    data = mujoco.MjData(model)
    data.qpos[:] = 0.3
    t = h * (np.arange(steps) + 0.5)
    torque = np.column_stack([8.0 * np.sin((3.0 + j) * t + j) for j in range(n)])
    for row in torque:
        data.qfrc_applied[:] = row
        mujoco.mj_step(model, data)
    ours = run(p, at_rest(p), torque, h)
    travel = np.abs(data.qpos - 0.3).max()
    assert_allclose(ours.q[0], data.qpos, atol=1e-4 * travel)


@pytest.mark.parametrize("h", [pytest.param(1e-3, marks=pytest.mark.long), 1e-2])
def test_a_block_that_is_pushed_below_its_friction_stays_and_slides_above_it(h):
    p = plant("emps", "rigid_body,coulomb_friction@v_s=0.00002", coulomb_friction=20.0)
    mass = float(p.mass(np.zeros((1, 1)))[0, 0, 0])
    steps = round(1.0 / h)
    held = run(p, at_rest(p), np.full((steps, 1), 19.0), h)
    assert abs(held.q[0, 0] - 0.3) < 1e-3  # creeps below the width of the sign
    slid = run(p, at_rest(p), np.full((steps, 1), 30.0), h)
    assert slid.q[0, 0] - 0.3 == pytest.approx(0.5 * 10.0 / mass, rel=0.02)
    # Braked, it comes to rest and does not go back.
    still = run(p, slid, np.zeros((steps, 1)), h)
    assert abs(still.dq[0, 0]) < 2e-5
    assert still.q[0, 0] - slid.q[0, 0] == pytest.approx(
        0.5 * mass * slid.dq[0, 0] ** 2 / 20.0, rel=0.03
    )


def test_a_motor_that_two_joints_share_holds_both_until_it_is_overcome():
    p = plant(
        "two_link",
        "rigid_body,transmission_friction:1+2@c1=1@c2=-1",
        transmission_friction=4.0,
    )
    rest = at_rest(p)
    weight = p.robot.inverse_dynamics(
        p.theta[0, p.model.rigid_indices], rest.q, rest.dq, rest.ddq
    )
    for share, holds in (
        (0.8, True),
        (1.2, False),
    ):  # it creeps below the width of its sign
        moved = run(
            p,
            rest,
            np.tile(weight + 4.0 * share * np.array([1.0, -1.0]), (200, 1)),
            1e-3,
        )
        assert (np.abs(moved.q - rest.q).max() < 3e-3) == holds


def test_friction_that_follows_the_load_follows_that_of_the_links_alone():
    """u = m a + f v + 0.3 |m a| sign(v), v > 0 and a > 0 throughout: 1.3 m a = u - f v."""
    sizes = {"viscous_friction": 500.0, "load_dependent_friction": 0.3}
    p = plant("emps", "rigid_body,viscous_friction,load_dependent_friction", **sizes)
    theta = np.where(
        [x.effect == "load_dependent_friction" for x in p.model.parameters],
        0.3,
        p.theta[0],
    )
    p = Plant(replace(p.model, reference=theta), theta)
    mass = float(p.mass(np.zeros((1, 1)))[0, 0, 0])
    h = 1e-3
    t = h * (np.arange(80) + 0.5)
    u = 100.0 + 50.0 * np.sin(6.0 * t)
    start = at_rest(p)._replace(dq=np.full((1, 1), 0.1))
    ours = run(p, start, u[:, None], h)

    def f(t, x):
        return [((100.0 + 50.0 * np.sin(6.0 * t)) - 500.0 * x[0]) / (1.3 * mass)]

    exact = solve_ivp(f, (0.0, 0.08), [0.1], rtol=1e-9, atol=1e-12).y[0, -1]
    assert ours.dq[0, 0] == pytest.approx(exact, rel=2e-3)


def test_channels_are_undone_and_others_left_out():
    p = plant("two_link", "rigid_body,torque_gain:2,backlash:1", torque_gain=0.1)
    torque = np.ones((5, 2))
    assert_allclose(p.true_torque(np.arange(5.0), torque)[:, 1], 1.0 / 1.1)
    assert p.left_out == ("backlash:1@law=rests@band=4",)
    declared = {kind.forward for kind in effect_types().values()}
    assert declared == {"torque", "channel", "drive", "left out"}


@pytest.mark.parametrize("width", [1e-4, 0.1])
def test_impulses_of_dry_friction_solve_their_law(width):
    """f = p tanh(y / w), y = y0 - G f, of joints that move each other strongly."""
    rng = np.random.default_rng(0)
    count = 300
    m = 5
    A = rng.normal(size=(count, m, m))
    G = np.einsum("kij,klj->kil", A, A) + 0.05 * np.eye(m)
    y0 = 3.0 * rng.normal(size=(count, m))
    p = rng.uniform(0.1, 2.0, (count, m))
    f = _solve_friction_impulses(y0, G, p, np.zeros((count, m)), np.full(m, width))
    y = y0 - np.einsum("kij,kj->ki", G, f)
    left = f - p * np.tanh(y / width)
    stuck = np.abs(y) < 3.0 * width  # there the law is steep, and y is what is found
    assert np.abs(np.where(stuck, 0.0, left)).max() < 1e-6
    assert np.abs(np.where(stuck, width * left, 0.0)).max() < 1e-6 * width + 1e-7
    assert 0.1 < stuck.mean() < 0.9
