"""Contracts that every effect in the registry keeps, on any robot: units, locality, sign, identity."""

from __future__ import annotations

import ast
import json
from dataclasses import replace

import numpy as np
import pytest
from random_robots import link_parameters, sines, tree, uicker_torques

from sdp_vs_penalty.effects import effect_from_dict, effect_types, parse_effects
from sdp_vs_penalty.effects.effect import CurrentModel, Effect, Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.robot import Joint, Robot

NAMES = list(effect_types())
EVERY_EFFECT = pytest.mark.parametrize("name", NAMES)


def robots() -> dict[str, Robot]:
    """A tree with both kinds of joints, a chain, and a single joint."""
    one = tree(np.random.default_rng(5), 1)
    one = replace(one, joints=(replace(one.joints[0], kind="revolute"),))
    return {
        "tree": tree(np.random.default_rng(5), 5),
        "chain": tree(np.random.default_rng(1), 3, branched=False, link_frames=True),
        "single": one,
        "slide": replace(one, joints=(replace(one.joints[0], kind="prismatic"),)),
    }


ROBOTS = robots()


def steady_motion(robot: Robot, rows: int = 60, seed: int = 0) -> tuple[Motion, np.ndarray]:
    """A motion without reversals and far from standstill, with a current model; its links (n, 10).

    dq stays beyond 0.3 rad/s, where every smoothed sign is one, so that nothing but the declared
    shape constants has the unit of a velocity.
    """
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 0.01 * (rows - 1), rows)
    v = rng.uniform(0.8, 1.2, robot.n) * rng.choice([-1.0, 1.0], robot.n)
    a, phase = rng.uniform(-0.3, 0.3, robot.n), rng.uniform(0, 6, robot.n)
    wave = 3.0 * t[:, None] + phase
    q = rng.normal(size=robot.n) + np.outer(t, v) + a * np.sin(wave) / 3.0
    dq, ddq = v + a * np.cos(wave), -3.0 * a * np.sin(wave)
    links = np.array([link_parameters(rng, 0.4) for _ in robot.joints])
    torque = robot.inverse_dynamics(links, q, dq, ddq) + 0.5 * np.sign(dq)
    return Motion(t, q, dq, ddq, torque, CurrentModel(robot, links)), links


def wide_columns(effect: Effect, motion: Motion) -> np.ndarray:
    """(n, N, p) all columns, zero where a joint has none."""
    out = np.zeros((effect.robot.n, len(motion.t), len(effect.parameters)))
    for block in effect.blocks(motion):
        out[block.joint][:, block.parameters] += block.columns
    return out


@EVERY_EFFECT
def test_the_file_is_the_registration(name: str) -> None:
    kind = effect_types()[name]
    assert kind.__module__ == f"sdp_vs_penalty.effects.{name}"
    assert kind.explanation.rstrip(")").endswith(".")
    assert kind.__module__.rsplit(".", 1)[1] == name
    assert set(kind.shape_grid) <= set(kind.shape_defaults)
    assert set(kind.shape_bounds) <= set(kind.shape_defaults)
    for key, (low, high) in kind.shape_bounds.items():
        assert low <= kind.shape_defaults[key] <= high
        assert all(low <= value <= high for value in kind.shape_grid.get(key, ()))


def test_the_rigid_body_comes_first_and_names_are_unique() -> None:
    assert NAMES[0] == "rigid_body"
    assert sorted(NAMES[1:]) == NAMES[1:]


@EVERY_EFFECT
@pytest.mark.parametrize("which", ROBOTS)
def test_columns_fit_any_robot(name: str, which: str) -> None:
    robot = ROBOTS[which]
    motion, _ = steady_motion(robot)
    effect = effect_types()[name](robot)
    count = len(effect.parameters)
    assert len({p.name for p in effect.parameters}) == count
    assert all(p.effect == name and 0 <= p.joint <= robot.n for p in effect.parameters)
    assert all(p.lower in (0.0, -np.inf) for p in effect.parameters)
    for block in effect.blocks(motion):
        assert 0 <= block.joint < robot.n
        assert block.columns.shape == (len(motion.t), len(block.parameters))
        assert np.all(np.isfinite(block.columns))
        assert np.all((block.parameters >= 0) & (block.parameters < count))


@EVERY_EFFECT
def test_every_parameter_makes_torque_in_a_motion_to_and_fro(name: str) -> None:
    robot = ROBOTS["chain"]
    motion = sines(np.random.default_rng(0), robot.n, np.arange(0.0, 10.0, 0.01))
    links = np.array([link_parameters(np.random.default_rng(k), 0.4) for k in range(robot.n)])
    torque = robot.inverse_dynamics(links, motion.q, motion.dq, motion.ddq)
    motion = replace(motion, torque=torque, current=CurrentModel(robot, links))
    effect = effect_types()[name](robot)
    torque_of_each = np.abs(wide_columns(effect, motion)).max(axis=(0, 1))
    # Of a link's parameters the first link's never show all.
    quiet = [p.name for p, x in zip(effect.parameters, torque_of_each, strict=True) if x == 0.0]
    assert not [n for n in quiet if name != "rigid_body" or not n.endswith("1")]


@EVERY_EFFECT
@pytest.mark.parametrize("which", ROBOTS)
def test_written_form_and_dictionary_restore_the_effect_to_the_last_bit(name: str, which: str) -> None:
    robot = ROBOTS[which]
    motion, _ = steady_motion(robot)
    kind = effect_types()[name]
    joints = None if kind.whole_robot or kind(robot).asked_joints is not None else [robot.n - 1]
    variants = [kind(robot)]
    if joints is not None and name not in ("rigid_body", "joint_coupling"):
        shapes = list(kind.shapes(robot, robot.n - 1))[-1:] or [{}]
        variants.append(kind(robot, joints, **shapes[0]))
    for effect in variants:
        stored = json.loads(json.dumps(effect.to_dict(), allow_nan=False))
        (written,) = parse_effects(effect.text, robot)
        for again in (effect_from_dict(stored, robot), written):
            assert again.parameters == effect.parameters
            np.testing.assert_array_equal(wide_columns(again, motion), wide_columns(effect, motion))


@EVERY_EFFECT
def test_rows_without_memory_stand_alone(name: str) -> None:
    """Chunked filtering computes columns piece by piece: only has_memory may look at other rows."""
    robot = ROBOTS["tree"]
    motion, _ = steady_motion(robot)
    effect = effect_types()[name](robot)
    shuffled = np.random.default_rng(1).permutation(len(motion.t))
    assert motion.torque is not None
    other = Motion(
        motion.t[shuffled],
        motion.q[shuffled],
        motion.dq[shuffled],
        motion.ddq[shuffled],
        motion.torque[shuffled],
        motion.current,
    )
    if not effect.has_memory:
        np.testing.assert_allclose(
            wide_columns(effect, other), wide_columns(effect, motion)[:, shuffled], atol=1e-12
        )


@EVERY_EFFECT
def test_what_an_effect_needs_is_what_it_declares(name: str) -> None:
    robot = ROBOTS["tree"]
    motion, links = steady_motion(robot)
    effect = effect_types()[name](robot)
    columns = wide_columns(effect, motion)
    if effect.needs_torque or effect.needs_links:
        bare = Motion(motion.t, motion.q, motion.dq, motion.ddq)
        with pytest.raises(ValueError, match=r"needs Motion\.(torque|current)"):
            effect.blocks(bare)
    assert motion.torque is not None
    another_torque = replace(motion, torque=2.0 * motion.torque + 1.0)
    another_arm = replace(motion, current=CurrentModel(robot, 2.0 * links))
    follows = not np.allclose(wide_columns(effect, another_torque), columns)
    assert follows == (effect.needs_torque and name != "backlash") or name == "backlash"
    assert (not np.allclose(wide_columns(effect, another_arm), columns)) == effect.needs_links


def unit_scale(unit: str, base: dict[str, float], constants: dict[str, float]) -> float:
    """By what a number in this unit is multiplied if the base units are."""
    if unit == "-":
        return 1.0
    newton = base["kg"] * base["m"] / base["s"] ** 2
    known = {**base, "N": newton, "rad": 1.0, "turn": 1.0, **constants}

    def value(node: ast.AST) -> float:
        match node:
            case ast.Expression(body=body):
                return value(body)
            case ast.Constant(value=number):
                return float(str(number))
            case ast.Name(id=word):
                return known[word]
            case ast.UnaryOp(op=ast.USub(), operand=x):
                return -value(x)
            case ast.BinOp(left=x, op=ast.Mult(), right=y):
                return value(x) * value(y)
            case ast.BinOp(left=x, op=ast.Div(), right=y):
                return value(x) / value(y)
            case ast.BinOp(left=x, op=ast.Pow(), right=y):
                return float(value(x) ** value(y))
        raise AssertionError(f"unit {unit!r} cannot be read")

    return value(ast.parse(unit.replace("^", "**"), mode="eval"))


def in_other_units(robot: Robot, base: dict[str, float]) -> Robot:
    """The same robot where a length of 1 m reads base["m"], and so on."""

    def moved(pose: np.ndarray) -> np.ndarray:
        out = np.array(pose)
        out[:3, 3] *= base["m"]
        return out

    def joint(j: Joint) -> Joint:
        return replace(j, placement=moved(j.placement), link_frame=moved(j.link_frame))

    x, y, z = np.array(robot.gravity) * base["m"] / base["s"] ** 2
    return Robot(robot.name, tuple(joint(j) for j in robot.joints), (x, y, z))


@EVERY_EFFECT
@pytest.mark.parametrize("which", ["tree", "slide"])
@pytest.mark.parametrize("base", [{"kg": 1.0, "m": 1.0, "s": 0.7}, {"kg": 1.9, "m": 1.6, "s": 1.3}])
def test_units_are_those_of_the_columns(name: str, which: str, base: dict[str, float]) -> None:
    """Rewrite the whole problem in other units of mass, length and time: a column in the new units
    must be the old one times torque / parameter, with shape constants converted by their own unit."""
    robot = ROBOTS[which]
    motion, links = steady_motion(robot)
    kind = effect_types()[name]
    effect = kind(robot)
    if not effect.parameters:
        pytest.skip("no neighbour to couple with")
    position = np.array([unit_scale(u, base, {}) for u in robot.position_units])
    torque = np.array([unit_scale(u, base, {}) for u in robot.torque_units])
    s, m, kg = base["s"], base["m"], base["kg"]
    other = in_other_units(robot, base)
    assert motion.torque is not None
    new = Motion(
        motion.t * s,
        motion.q * position,
        motion.dq * position / s,
        motion.ddq * position / s**2,
        motion.torque * torque,
        CurrentModel(other, links * kg * np.array([1, m, m, m, *[m * m] * 6])),
    )
    first = effect.joints[0]
    shape = {
        key: value * unit_scale(effect.shape_unit(key, first), base, {})
        for key, value in effect.shape.items()
    }
    kinds = {robot.position_units[j] for j in effect.joints}
    if kind.shape_defaults and len(kinds) > 1:
        # One constant for rad and m has no unit: compare joints of one kind at a time.
        joints = [j for j in effect.joints if robot.position_units[j] == robot.position_units[first]]
        effect, rewritten = kind(robot, joints), kind(other, joints, **shape)
    else:
        rewritten = kind(other, None, **shape)
    constants = {k: v for k, v in effect.shape.items() if k != "T"}
    scale = np.array([unit_scale(p.unit, base, constants) for p in effect.parameters])
    expected = wide_columns(effect, motion) * torque[:, None, None] / scale
    found = wide_columns(rewritten, new)
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max())


def test_the_width_of_a_smoothed_sign_is_a_velocity() -> None:
    robot = ROBOTS["tree"]
    effect = effect_types()["coulomb_friction"](robot)
    for j, unit in enumerate(robot.position_units):
        assert effect.shape_unit("v_s", j) == f"{unit}/s"


DISSIPATIVE = ("viscous_friction", "coulomb_friction", "stribeck_friction", "load_dependent_friction")


@pytest.mark.parametrize("name", [*DISSIPATIVE, "power_law_friction"])
def test_friction_of_positive_coefficient_takes_energy(name: str) -> None:
    robot = ROBOTS["tree"]
    rng = np.random.default_rng(0)
    q, dq, ddq, torque = rng.normal(size=(4, 200, robot.n))
    dq[:50] *= 1e-3  # through zero as well
    columns = wide_columns(effect_types()[name](robot), Motion(np.arange(200.0), q, dq, ddq, torque))
    power = np.einsum("jnp,nj->np", columns, dq)
    assert np.all(power >= 0.0)
    assert np.any(power > 0.0)


def test_signs_that_physics_fixes_are_bounded_and_no_others() -> None:
    robot = ROBOTS["tree"]
    bounded = {n for n, kind in effect_types().items() if kind(robot).parameters[0].lower == 0.0}
    assert set(DISSIPATIVE) | {"rotor_inertia", "joint_elasticity"} <= bounded
    assert not bounded & {
        "torque_offset",
        "torque_gain",
        "base_tilt",
        "torque_delay",
        "joint_zero_error",
    }


def test_rotor_inertia_is_what_a_spinning_link_on_the_axis_makes() -> None:
    """A rotor turns with its own joint only: not the same as Izz of the link, which turns with all."""
    robot = Robot.from_dh("r", [0.0, 0.3], [0.0, 0.0], [0.2, 0.0], "modified")
    state = np.random.default_rng(0).normal(size=(3, 4, 2))
    motion = Motion(np.arange(4.0), *state)
    rotor = wide_columns(effect_types()["rotor_inertia"](robot), motion)
    turning = np.zeros((2, 10))
    turning[0, 9] = 1.0
    by_link = [uicker_torques(robot, turning.ravel(), *s) for s in zip(*state, strict=True)]
    np.testing.assert_allclose(rotor[0, :, 0], np.array(by_link)[:, 0], atol=1e-12)
    np.testing.assert_array_equal(rotor[1, :, 0], 0.0)
    np.testing.assert_array_equal(rotor[1, :, 1], state[2][:, 1])


def test_a_model_concatenates_its_effects() -> None:
    robot = ROBOTS["tree"]
    model = Model(robot, parse_effects("viscous_friction:2,rigid_body,torque_offset:1+3", robot))
    names = [p.name for p in model.parameters]
    assert names[0] == "f_v2"
    assert names[-2:] == ["f_o1", "f_o3"]
    assert [names[k] for k in model.rigid_indices[:2]] == ["m1", "mx1"]
    motion, _ = steady_motion(robot)
    theta = np.random.default_rng(3).normal(size=len(names))
    links = inertia.PSEUDO_INERTIA_BASIS.shape[0] * robot.n
    expected = robot.regressor(motion.q, motion.dq, motion.ddq) @ theta[1 : 1 + links]
    expected[:, 1] += theta[0] * motion.dq[:, 1]
    expected[:, [0, 2]] += theta[-2:]
    np.testing.assert_allclose(model.torque(theta, motion), expected, atol=1e-9)
    for joint, indices in enumerate(model.joint_indices):
        columns = next(c for k, c in enumerate(model.columns(motion)) if k == joint)
        np.testing.assert_array_equal(columns.indices, indices)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("friction", "unknown; there are: rigid_body"),
        ("viscous_friction:9", "joint 9 does not exist"),
        ("viscous_friction:0", "joint 0 does not exist"),
        ("viscous_friction:a", "joints are whole numbers"),
        ("coulomb_friction@v_s", "write a shape constant"),
        ("coulomb_friction@w=3", "no shape constant 'w'"),
        ("coulomb_friction@v_s=inf", "must be finite"),
    ],
)
def test_effects_that_do_not_exist_are_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_effects(text, ROBOTS["tree"])


def test_models_without_effects_or_with_one_twice_are_refused() -> None:
    robot = ROBOTS["single"]
    with pytest.raises(InputError, match="no effect"):
        Model(robot, ())
    with pytest.raises(InputError, match="f_v1 comes twice"):
        Model(robot, parse_effects("viscous_friction,viscous_friction:1", robot))
