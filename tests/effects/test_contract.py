"""Contracts that every effect of the library keeps; a new file is asked the same
without a word here."""

import json
from dataclasses import replace
from itertools import pairwise

import effect_contract
import numpy as np
import pytest
from effect_contract import robots, steady_motion, to_and_fro, variants, wide_columns

from sdp_vs_penalty import InputError
from sdp_vs_penalty.effects import (
    CurrentModel,
    EffectEntry,
    JointCoverage,
    Model,
    Motion,
    effect_types,
    make_effect,
    parse_effects,
)
from sdp_vs_penalty.simulation import MAKERS

NAMES = list(effect_types())
#: An effect whose memory is long: its torque takes seconds to make.
DEAR = ("joint_resonance",)
EVERY_EFFECT = pytest.mark.parametrize("name", NAMES)
EVERY_ROBOT = pytest.mark.parametrize("which", robots())


@EVERY_EFFECT
def test_shape_constants_are_declared_whole(name):
    """Defaults, grids and bounds agree, a search starts from valid constants and can
    refine them."""
    kind = effect_types()[name]
    for shape in kind.shapes.values():
        low, high = shape.bounds or (-np.inf, np.inf)
        for value in (shape.default, *shape.grid, *shape.choices):
            assert shape.complaint(value) is None
            assert low <= value <= high
        if shape.choices:
            assert not shape.words or len(shape.words) == len(shape.choices)
            assert shape.complaint(max(shape.choices) + 1.0)
        if shape.bounds is not None:
            assert shape.grid
            assert shape.scale == "linear" or low > 0.0
        assert all(a < b for a, b in pairwise(shape.grid))
    for robot in robots().values():
        for effect in variants(name, robot):
            assert set(effect.searched) <= set(effect.shape) == set(effect.shapes)
            assert all(effect.shapes[key].role != "clock" for key in effect.searched)


@EVERY_EFFECT
@EVERY_ROBOT
def test_columns_fit_any_robot(name, which):
    robot = robots()[which]
    motion = steady_motion(robot)
    for effect in variants(name, robot):
        count = len(effect.parameters)
        assert len({p.name for p in effect.parameters}) == count
        assert all(p.unit and p.effect == name for p in effect.parameters)
        acting = effect.joints[:1] if effect.joins else effect.joints
        on = {0} if effect.whole_robot else {j + 1 for j in acting}
        assert {p.joint for p in effect.parameters} == on
        assert all(p.joint == 0 or str(p.joint) in p.name for p in effect.parameters)
        assert all(p.lower in (0.0, -np.inf) for p in effect.parameters)
        for block in effect.blocks(motion):
            assert 0 <= block.joint < robot.n
            assert block.columns.shape == (len(motion.t), len(block.parameters))
            assert np.all(np.isfinite(block.columns))
            assert np.all((block.parameters >= 0) & (block.parameters < count))


@EVERY_EFFECT
def test_every_parameter_makes_torque_in_a_motion_to_and_fro(name):
    """But what a search leaves out, since such a motion cannot show it: a stop that it
    does not reach."""
    robot = robots()["arm"]
    motion = replace(to_and_fro(robot), sign_width=0.01)  # finer than any form
    ends = zip(motion.q.min(axis=0), motion.q.max(axis=0), strict=True)
    covered = [
        JointCoverage(high - low, lowest=low, highest=high) for low, high in ends
    ]
    shown = [
        effect
        for effect in variants(name, robot)
        if effect.whole_robot
        or not all(effect.looks_like(0.0, covered[j]) for j in effect.joints)
    ]
    assert shown
    for effect in shown:
        torque_of_each = np.abs(wide_columns(effect, motion)).max(axis=(0, 1))
        # Of a link's parameters the first link's never show all.
        quiet = [
            p.name
            for p, x in zip(effect.parameters, torque_of_each, strict=True)
            if x == 0.0
        ]
        assert not [
            n for n in quiet if not (effect.name == "rigid_body" and n.endswith("1"))
        ]


@EVERY_EFFECT
@EVERY_ROBOT
def test_written_form_and_dictionary_restore_the_effect_to_the_last_bit(name, which):
    robot = robots()[which]
    motion = steady_motion(robot)
    for effect in variants(name, robot):
        stored = json.loads(json.dumps(effect.entry.to_dict(), allow_nan=False))
        (written,) = parse_effects(effect.text, robot)
        for again in (make_effect(EffectEntry.from_dict(stored), robot), written):
            assert again.entry.to_dict() == effect.entry.to_dict()
            assert again.parameters == effect.parameters
            np.testing.assert_array_equal(
                wide_columns(again, motion), wide_columns(effect, motion)
            )


@EVERY_EFFECT
def test_only_what_has_a_memory_looks_at_other_rows_and_only_back(name):
    """Chunked filtering computes columns piece by piece."""
    robot = robots()["tree"]
    motion = steady_motion(robot)

    def rows(index: np.ndarray) -> Motion:
        parts = (motion.t, motion.q, motion.dq, motion.ddq, motion.torque)
        warm = motion.joint_temperature[index]
        more = {
            "temperature": warm,
            "command": motion.command,
            "position_integral": motion.integral[index],
        }
        more["motors"] = motion.motor_acceleration[index]
        return Motion(*(x[index] for x in parts), motion.current, **more)

    shuffled = np.random.default_rng(1).permutation(len(motion.t))
    half = np.arange(len(motion.t) // 2)
    for effect in variants(name, robot):
        columns = wide_columns(effect, motion)
        if not effect.has_memory:
            np.testing.assert_allclose(
                wide_columns(effect, rows(shuffled)), columns[:, shuffled], atol=1e-12
            )
        # Smoothed both ways, over whole runs.
        if effect.shape.get("phase") == 2.0 or "band" in effect.shape:
            assert effect.has_memory
            continue
        # Central differences look two samples ahead.
        first = wide_columns(effect, rows(half))[:, :-2]
        np.testing.assert_allclose(first, columns[:, half[:-2]], rtol=1e-9, atol=1e-12)


@EVERY_EFFECT
def test_what_an_effect_needs_is_what_it_declares(name):
    """A torque, links, a clock: the columns change with what is declared and with
    nothing else."""
    robot = robots()["arm"]
    motion = steady_motion(robot)
    bare = Motion(motion.t, motion.q, motion.dq, motion.ddq)
    another_torque = replace(motion, torque=2.0 * motion.torque + 1.0)
    another_arm = replace(
        motion, current=CurrentModel(robot, 1.5 * motion.model_links**2)
    )
    late = replace(motion.logged_command, t=motion.t + 7.0)
    later = replace(motion, t=motion.t + 7.0, command=late)
    farther = replace(
        motion,
        command=replace(
            motion.logged_command, q=motion.q, dq=motion.dq, position_integral=motion.q
        ),
    )
    warmer = replace(motion, temperature=motion.joint_temperature + 5.0)
    for effect in variants(name, robot):
        columns = wide_columns(effect, motion)
        other = effect.needs_temperature or effect.needs_command or effect.needs_motors
        if effect.needs_torque or effect.needs_links or other:
            missing = (
                r"needs Motion\.(torque|current)|no (temperatures|commands|positions)"
            )
            with pytest.raises(ValueError, match=missing):
                effect.blocks(bare)
        else:
            effect.blocks(bare)
        for other, word in (
            (another_torque, "needs_torque"),
            (another_arm, "needs_links"),
            (later, "follows_clock"),
            (warmer, "needs_temperature"),
            (farther, "needs_command"),
            (replace(motion, motors=motion.q), "needs_motors"),
        ):
            declared = getattr(effect, word)
            changed = not np.allclose(
                wide_columns(effect, other), columns, rtol=1e-9, atol=1e-12
            )
            assert changed == declared, (
                f"{name}: declare {word} = {changed}, as its columns do"
            )
        if effect.follows_clock:
            joint = effect.joints[0]
            for a, b in zip(
                effect.candidates(robot, joint),
                effect.candidates(robot, joint, 7.0),
                strict=True,
            ):
                moved = wide_columns(b, later) - wide_columns(a, motion)
                np.testing.assert_allclose(moved, 0.0, atol=1e-12)


@EVERY_EFFECT
def test_units_are_those_of_the_columns(name):
    effect_contract.check_units_are_those_of_the_columns(name)


@EVERY_EFFECT
def test_a_joint_has_it_once_or_declares_that_it_can_have_several(name):
    robot = robots()["arm"]
    kind = effect_types()[name]
    first, *others = kind.candidates(robot, None if kind.whole_robot else 1) or [
        kind(robot)
    ]
    if name == "measured_curve":
        others = [
            kind(robot, x=2.0)
        ]  # nothing to search: another variable is another one
    for other in others or [first]:
        if kind.several:
            assert len(Model(robot, (first, other)).parameters) == 2 * len(
                first.parameters
            )
        else:
            with pytest.raises(InputError, match="appears twice"):
                Model(robot, (first, other))


@EVERY_EFFECT
def test_only_what_the_links_absorb_needs_a_frozen_model(name):
    robot = robots()["tree"]
    motion = to_and_fro(robot)
    rigid = wide_columns(effect_types()["rigid_body"](robot), motion).reshape(
        -1, 10 * robot.n
    )
    for effect in variants(name, robot)[:1]:
        columns = wide_columns(effect, motion).reshape(-1, len(effect.parameters))
        left = columns - rigid @ np.linalg.lstsq(rigid, columns)[0]
        absorbed = np.linalg.norm(left) < 1e-9 * np.linalg.norm(columns)
        assert absorbed == (effect.frozen_only or name == "rigid_body")


@EVERY_EFFECT
def test_constraints_hold_at_the_nominal_parameters_and_keep_sign_and_range(name):
    robot = robots()["tree"]
    effect = effect_types()[name](robot)
    constraints = effect.constraints(np.arange(len(effect.parameters)))
    if name == "rigid_body":
        assert not constraints  # the problem's
        return
    nominal = effect.nominal
    assert all(c.margin(nominal) >= 0.0 for c in constraints)
    assert all(c.margin(nominal) > 0.0 for c in constraints if c.cone == "psd")
    a_body = any(c.family == "pseudo-inertia" for c in constraints)
    for k, parameter in enumerate(effect.parameters):
        step = np.eye(len(nominal))[k]
        for value, kept in (
            (0.99, True),
            (-0.99, parameter.lower < 0.0),
            (1.01, False),
            (-1.01, False),
        ):
            theta = nominal + value * effect.largest_parameter * step
            plain = [c for c in constraints if c.family != "pseudo-inertia"]
            assert all(c.margin(theta) >= 0.0 for c in plain) == kept
    assert a_body == (name == "payload")


@pytest.mark.parametrize(
    "name",
    [pytest.param(x, marks=pytest.mark.long if x in DEAR else ()) for x in MAKERS],
)
def test_columns_are_the_hidden_torque(name):
    effect_contract.check_columns_are_the_hidden_torque(name)
