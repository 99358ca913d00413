"""What every effect keeps: columns that fit any robot, in the declared units, of what
the effect declares that it needs, and a written form that restores it.

Robots have joints of one kind only where shape constants are at work: one constant for
rad and m at once has no unit.
"""

from __future__ import annotations

import ast
import inspect
import json
import operator
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import get_args

import numpy as np

from sdp_vs_penalty.effects import make_effect, parse_effects
from sdp_vs_penalty.effects.effect import (
    Effect,
    EffectEntry,
    JointCoverage,
    SimulatorField,
)
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.motion import Command, CurrentModel, Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.joint import Joint
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.simulation.worlds.world import TrueMotion
from sdp_vs_penalty.testing.demand import ContractError, demand
from sdp_vs_penalty.testing.robots import link_parameters, sines, tree

#: Returns the forms of an effect that are tried on a robot.
Forms = Callable[[Robot], list[Effect]]
#: Of a form that is searched on a joint in more sizes than these, so many are tried.
_SIZES_TRIED = 6
#: Share of a sum of products that rounding may change.
_ROUNDING = 1e-9


@cache
def robots() -> dict[str, Robot]:
    """Return a tree with both kinds of joints, an arm and a gantry with one kind, and
    single joints."""

    def all_of(kind: str, robot: Robot) -> Robot:
        joints = tuple(replace(joint, kind=kind) for joint in robot.joints)
        return replace(robot, joints=joints)

    chain = tree(np.random.default_rng(1), 3, branched=False, link_frames=True)
    one = tree(np.random.default_rng(5), 1)
    return {
        "tree": tree(np.random.default_rng(5), 5),
        "arm": all_of("revolute", chain),
        "gantry": all_of("prismatic", chain),
        "single": all_of("revolute", one),
        "slide": all_of("prismatic", one),
    }


def steady_motion(robot: Robot) -> Motion:
    """Return a motion without reversals and far from standstill, with a current model.

    |dq| stays beyond 0.3 rad/s, where every smoothed sign is one, so that nothing but
    the declared shape constants has the unit of a velocity.
    """
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 0.59, 60)
    v = (0.8 + 0.7 * np.arange(robot.n)) * rng.choice([-1.0, 1.0], robot.n)
    a = rng.uniform(-0.2, 0.2, robot.n)
    wave = 3.0 * t[:, None] + rng.uniform(0, 6, robot.n)
    q = rng.normal(size=robot.n) + np.outer(t, v) + a * np.sin(wave) / 3.0
    dq, ddq = v + a * np.cos(wave), -3.0 * a * np.sin(wave)
    links = np.array([link_parameters(rng, 0.4) for _ in robot.joints])
    torque = robot.inverse_dynamics(links, q, dq, ddq) + 0.5 * np.sign(dq) + 0.1 * dq
    warm = 20.0 + 300.0 * np.outer(t, 1.0 + np.arange(robot.n))
    current = CurrentModel(robot, links)
    motion = Motion(t, q, dq, ddq, torque, current)
    return _with_command(replace(motion, temperature=warm, motors=1.2 * ddq))


def to_and_fro(robot: Robot) -> Motion:
    """Return six seconds of sines with reversals, and a current model."""
    motion = sines(np.random.default_rng(3), robot.n, np.arange(0.0, 6.0, 0.01), 0.1, 5)
    links = steady_motion(robot).model_links
    torque = robot.inverse_dynamics(links, motion.q, motion.dq, motion.ddq)
    seen = replace(
        motion,
        torque=torque + 0.3 * motion.dq,
        current=CurrentModel(robot, links),
        temperature=25.0 + 3.0 * motion.q,
        motors=1.1 * motion.ddq,
        sign_width=0.02,
    )
    return _with_command(seen)


def _with_command(motion: Motion) -> Motion:
    """Return a motion with a command: positions and integrals of about its own size."""
    q, dq, ddq = (1.3 * x for x in (motion.q, motion.dq, motion.ddq))
    sums = np.cumsum(motion.q, axis=0) * (motion.t[1] - motion.t[0])
    command = Command(motion.t, q, dq, ddq, 1.7 * sums)
    return replace(motion, command=command, position_integral=sums)


def wide_columns(effect: Effect, motion: Motion) -> Array:
    """Return all columns (n, N, p) of an effect, zero where a joint has none."""
    out = np.zeros((effect.robot.n, len(motion.t), len(effect.parameters)))
    for block in effect.blocks(motion):
        out[block.joint][:, block.parameters] += block.columns
    return out


def variants(kind: type[Effect], robot: Robot) -> list[Effect]:
    """Return the effect on all joints as it is by default, and on each with what a
    search begins with: of each form its smallest and largest shape constants and some
    between them."""
    # Effects have one form if they act on one joint and make the same choices.
    forms: dict[tuple[object, ...], list[Effect]] = {}
    for joint in [None] if kind.whole_robot else range(robot.n):
        for effect in kind.candidates(robot, joint):
            form = effect.joints, *effect.law_constants.values()
            forms.setdefault(form, []).append(effect)
    out = [kind(robot)]
    for sizes in forms.values():
        count = min(len(sizes), _SIZES_TRIED)
        out += [sizes[k] for k in np.linspace(0, len(sizes) - 1, count).astype(int)]
    return out


def check_shape_constants(kind: type[Effect], forms: Forms) -> None:
    """Defaults, grids and bounds agree, a search starts from valid constants and can
    refine them."""
    for key, shape in kind.shapes.items():
        low, high = shape.bounds or (-np.inf, np.inf)
        for value in (shape.default, *shape.grid, *shape.choices):
            complaint = shape.complaint(value)
            demand(complaint is None, f"shape constant {key} {complaint}")
            demand(low <= value <= high, f"{key} = {value:g} is outside of its bounds")
        if shape.choices:
            words = not shape.words or len(shape.words) == len(shape.choices)
            demand(words, f"{key} has not as many words as choices")
        if shape.bounds is not None:
            demand(shape.grid, f"{key} has bounds but no grid from which to refine")
            demand(shape.scale == "linear" or low > 0.0, f"{key} has no logarithm")
        increasing = all(a < b for a, b in pairwise(shape.grid))
        demand(increasing, f"the grid of {key} does not increase")
    for robot in robots().values():
        for effect in forms(robot):
            same = set(effect.searched) <= set(effect.shape) == set(effect.shapes)
            demand(same, f"{effect.text} has other shape constants than it declares")


def check_columns_fit_any_robot(kind: type[Effect], forms: Forms) -> None:
    """Columns are finite, of the declared parameters, and on joints that exist."""
    for robot in robots().values():
        motion = steady_motion(robot)
        for effect in forms(robot):
            count = len(effect.parameters)
            names = {p.name for p in effect.parameters}
            demand(len(names) == count, f"{effect.text} has a parameter twice")
            acting = effect.joints[:1] if effect.joins else effect.joints
            numbers = {0} if effect.whole_robot else {j + 1 for j in acting}
            for p in effect.parameters:
                demand(p.unit and p.effect == kind.name, f"{p.name}: unit or effect")
                demand(p.lower in (0.0, -np.inf), f"{p.name}: lower is 0 or nothing")
                numbered = p.joint == 0 or str(p.joint) in p.name
                demand(numbered, f"{p.name} does not hold the number of its joint")
            found = {p.joint for p in effect.parameters}
            demand(found == numbers, f"{effect.text} has parameters on other joints")
            for block in effect.blocks(motion):
                shape = len(motion.t), len(block.parameters)
                demand(0 <= block.joint < robot.n, "a block is on no joint")
                demand(block.columns.shape == shape, "columns have another shape")
                demand(np.isfinite(block.columns).all(), "columns are not finite")
                inside = (block.parameters >= 0) & (block.parameters < count)
                demand(inside.all(), "a column belongs to no parameter")


def check_every_parameter_makes_torque(kind: type[Effect], forms: Forms) -> None:
    """In a motion to and fro, but for what such a motion cannot show (a stop that it
    does not reach)."""
    robot = robots()["arm"]
    motion = replace(to_and_fro(robot), sign_width=0.01)  # finer than any form
    ends = list(zip(motion.q.min(axis=0), motion.q.max(axis=0), strict=True))
    covered = [JointCoverage(b - a, lowest=a, highest=b) for a, b in ends]
    shown = [
        effect
        for effect in forms(robot)
        if effect.whole_robot
        or not all(effect.looks_like(0.0, covered[j]) for j in effect.joints)
    ]
    demand(shown, "no form of it shows in a motion to and fro")
    for effect in shown:
        sizes = np.abs(wide_columns(effect, motion)).max(axis=(0, 1))
        for parameter, size in zip(effect.parameters, sizes, strict=True):
            # Of a link's parameters the first link's never show all.
            is_first_link = (
                kind.simulator_field == "links" and parameter.name[-1] == "1"
            )
            demand(
                size > 0.0 or is_first_link,
                f"{parameter.name} makes no torque in a motion of the joints"
                f" {', '.join(f'from {a:.2g} to {b:.2g}' for a, b in ends)} rad: choose"
                " constants that it reaches (default and grid), or say in"
                " Effect.looks_like that it does not show there",
            )


def check_written_form(kind: type[Effect], forms: Forms) -> None:
    """Text and JSON restore the effect to the last bit."""
    for robot in robots().values():
        motion = steady_motion(robot)
        for effect in forms(robot):
            columns = wide_columns(effect, motion)
            stored = json.loads(json.dumps(effect.entry.to_dict(), allow_nan=False))
            (written,) = parse_effects(effect.text, robot)
            for again in (make_effect(EffectEntry.from_dict(stored), robot), written):
                same = again.entry.to_dict() == effect.entry.to_dict()
                demand(same, f"{effect.text} is read as {again.text}")
                same = np.array_equal(wide_columns(again, motion), columns)
                demand(same, f"{effect.text} is read otherwise")


def check_memory(kind: type[Effect], forms: Forms) -> None:
    """Only what has a memory looks at other rows, and only back: columns are computed
    piece by piece."""
    robot = robots()["tree"]
    motion = steady_motion(robot)
    shuffled = np.random.default_rng(1).permutation(len(motion.t))
    half = np.arange(len(motion.t) // 2)
    for effect in forms(robot):
        columns = wide_columns(effect, motion)
        if not effect.has_memory:
            found = wide_columns(effect, motion.part(shuffled))
            same = np.allclose(found, columns[:, shuffled], atol=1e-12)
            demand(same, f"{effect.text} looks at other rows: declare has_memory")
        # Central differences look two samples ahead.
        first = wide_columns(effect, motion.part(half))[:, :-2]
        same = np.allclose(first, columns[:, half[:-2]], rtol=_ROUNDING, atol=1e-12)
        demand(same, f"{effect.text} looks at later rows")


def _has_columns_of(effect: Effect, motion: Motion) -> bool:
    """Return whether an effect makes columns of a motion, or refuses since it lacks a
    field."""
    try:
        effect.blocks(motion)
    except ValueError:
        return False
    return True


def check_needs_are_declared(kind: type[Effect], forms: Forms) -> None:
    """Columns refuse a motion without a field that is declared, and do not change with
    one that is not: what they read, not how much of it shows in this motion."""
    robot = robots()["arm"]
    motion = steady_motion(robot)
    command = motion.logged_command
    # Other shares of the links, of which a law that saturates may see nothing, and
    # turned ones, of which a law of shares sees nothing.
    other_links = [1.5 * motion.model_links**2, -1.5 * motion.model_links]
    late = replace(command, t=motion.t + 7.0)
    farther = replace(command, q=motion.q, dq=motion.dq, position_integral=motion.q)
    later = replace(motion, t=motion.t + 7.0, command=late)
    # Without its fields, and with others.
    without_and_others = {
        "needs_torque": (
            replace(motion, torque=None),
            [replace(motion, torque=2.0 * motion.model_torque + 1.0)],
        ),
        "needs_links": (
            replace(motion, current=None),
            [replace(motion, current=CurrentModel(robot, x)) for x in other_links],
        ),
        "needs_temperature": (
            replace(motion, temperature=None),
            [replace(motion, temperature=motion.joint_temperature + 5.0)],
        ),
        "needs_command": (
            replace(motion, command=None, position_integral=None),
            [replace(motion, command=farther)],
        ),
        "needs_motors": (
            replace(motion, motors=None),
            [replace(motion, motors=motion.q)],
        ),
    }
    for effect in forms(robot):
        columns = wide_columns(effect, motion)
        for word, (without, others) in without_and_others.items():
            reads = not _has_columns_of(effect, without)
            if getattr(effect, word):
                sentence = f"declares {word}, but has columns without it"
                demand(reads, f"{effect.text} {sentence}")
            else:
                reads = reads or any(_differs(effect, x, columns) for x in others)
                sentence = f"the columns of {effect.text} read it"
                demand(not reads, f"declare {word} = True: {sentence}")
        changes = _differs(effect, later, columns)
        if not effect.follows_clock:
            sentence = f"the columns of {effect.text} change with it"
            demand(not changes, f"declare follows_clock = True: {sentence}")
            continue
        sentence = "declares follows_clock, but nothing changes with it here"
        demand(changes, f"{effect.text} {sentence}")
        # The effect of a log that begins 7 s later is as much later.
        pairs = (kind.candidates(robot, effect.joints[0], t) for t in (0.0, 7.0))
        for early, moved in zip(*pairs, strict=True):
            change = wide_columns(moved, later) - wide_columns(early, motion)
            demand(np.allclose(change, 0.0, atol=1e-12), "its clock does not begin")


def _differs(effect: Effect, other: Motion, columns: Array) -> bool:
    """Tell whether an effect has other columns in another motion, beyond rounding."""
    found = wide_columns(effect, other)
    return not np.allclose(found, columns, _ROUNDING, atol=1e-12)


def check_units(kind: type[Effect], forms: Forms) -> None:
    """In other units of mass, length and time, a column is the old one times torque /
    parameter, with shape constants converted by their own unit."""
    base = {"kg": 1.9, "m": 1.6, "s": 1.3}
    for which, robot in robots().items():
        motion = steady_motion(robot)
        torque = np.array([_unit_scale(u, base) for u in robot.torque_units])
        new = _in_other_units(motion, robot, base, torque)
        for effect in forms(robot):
            if effect.parameters and not (which == "tree" and effect.shapes):
                _check_units_of(effect, motion, new, base, torque)


def _check_units_of(
    effect: Effect,
    motion: Motion,
    new: Motion,
    base: Mapping[str, float],
    torque: Array,
) -> None:
    """Compare the columns along a motion with those along the same one in other
    units; ``torque`` (n,) is by how much its unit makes the joints' torques larger."""
    joint_kind = effect.robot.joints[effect.joints[0]].kind
    units = {key: effect.shapes[key].unit_on(joint_kind) for key in effect.shape}
    shape = {k: x * _unit_scale(units[k], base) for k, x in effect.shape.items()}
    assert new.current is not None
    rewritten = type(effect)(new.current.robot, effect.asked_joints, **shape)
    # A unit may hold an exponent, which is a number by itself.
    numbers = {k: x for k, x in effect.shape.items() if units[k] == "-"}
    scales = [_unit_scale(p.unit, {**base, **numbers}) for p in effect.parameters]
    expected = wide_columns(effect, motion) * torque[:, None, None] / scales
    found = wide_columns(rewritten, new)
    atol = _ROUNDING * np.abs(expected).max()
    for parameter, a, b in zip(effect.parameters, expected.T, found.T, strict=True):
        sentence = (
            f"{effect.text}: torque over column is not in {parameter.unit}, the unit of"
            f" {parameter.name}, or the unit of a shape constant is wrong"
        )
        demand(np.allclose(b, a, 1e-7, atol), sentence)


def _unit_scale(unit: str, base: Mapping[str, float]) -> float:
    """Return by what a number in a unit is multiplied if the base units are."""
    if unit == "-":
        return 1.0
    newton = base["kg"] * base["m"] / base["s"] ** 2
    known = {"N": newton, "rad": 1.0, "turn": 1.0, "K": 1.0, "Hz": 1.0 / base["s"]}
    known |= base
    operations = {
        ast.Mult: operator.mul,
        ast.Div: operator.truediv,
        ast.Pow: operator.pow,
    }

    def value(node: ast.expr) -> float:
        if isinstance(node, ast.BinOp):
            return float(operations[type(node.op)](value(node.left), value(node.right)))  # type: ignore[index]
        if isinstance(node, ast.Name):
            return known[node.id]
        demand(isinstance(node, ast.Constant), f"{unit!r} is no product of units")
        return float(node.value)  # type: ignore[attr-defined]

    return value(ast.parse(unit.replace("^", "**"), mode="eval").body)


def _in_other_units(
    motion: Motion, robot: Robot, base: Mapping[str, float], torque: Array
) -> Motion:
    """Return a motion, with its robot and links, where a length of 1 m reads base["m"],
    and so on."""
    s, m, kg = base["s"], base["m"], base["kg"]
    position = np.array([_unit_scale(u, base) for u in robot.position_units])

    def pose(old: Array) -> Array:
        out = np.array(old)
        out[:3, 3] *= m
        return out

    def joint(j: Joint) -> Joint:
        return replace(j, placement=pose(j.placement), link_frame=pose(j.link_frame))

    x, y, z = np.array(robot.gravity) * m / s**2
    other = Robot(robot.name, tuple(map(joint, robot.joints)), (x, y, z))
    links = motion.model_links * kg * np.array([1, m, m, m, *[m * m] * 6])

    def states(x: Motion | Command) -> tuple[Array, Array, Array, Array]:
        return x.t * s, x.q * position, x.dq * position / s, x.ddq * position / s**2

    command = motion.logged_command
    return Motion(
        *states(motion),
        motion.model_torque * torque,
        CurrentModel(other, links),
        sign_width=np.asarray(motion.sign_width) * position[0] / s,
        temperature=motion.temperature,
        command=Command(
            *states(command), np.asarray(command.position_integral) * position * s
        ),
        position_integral=motion.integral * position * s,
        motors=motion.motor_acceleration * position / s**2,
    )


def check_once_or_several(kind: type[Effect], forms: Forms) -> None:
    """A joint has it once, or it declares that a joint can have several."""
    robot = robots()["arm"]
    joint = None if kind.whole_robot else 1
    first, *others = kind.candidates(robot, joint) or forms(robot)
    for other in others[:_SIZES_TRIED] or [first]:
        try:
            model = Model(robot, (first, other))
        except InputError:
            demand(not kind.several, f"{first.text} and {other.text} share a parameter")
        else:
            count = len(first.parameters) + len(other.parameters)
            once = kind.several or set(first.joints).isdisjoint(other.joints)
            demand(once and len(model.parameters) == count, "declare several = True")


def check_frozen_only(kind: type[Effect], forms: Forms) -> None:
    """Only what the links absorb needs a model that is held fixed."""
    robot = robots()["tree"]
    motion = to_and_fro(robot)
    rigid = robot.regressor(motion.q, motion.dq, motion.ddq)
    links = np.swapaxes(rigid, 0, 1).reshape(-1, rigid.shape[2])
    effect = kind(robot)
    columns = wide_columns(effect, motion).reshape(-1, len(effect.parameters))
    left = columns - links @ np.linalg.lstsq(links, columns)[0]
    absorbed = np.linalg.norm(left) < _ROUNDING * np.linalg.norm(columns)
    expected = kind.frozen_only or kind.simulator_field == "links"
    demand(absorbed == expected, f"declare frozen_only = {absorbed}")


def check_constraints(kind: type[Effect], forms: Forms) -> None:
    """They hold at the nominal parameters, and keep sign and range of each."""
    effect = kind(robots()["tree"])
    constraints = effect.constraints(np.arange(len(effect.parameters)))
    if kind.simulator_field == "links":
        demand(not constraints, "those of the links are the problem's")
        return
    nominal = effect.nominal
    for c in constraints:
        inside = c.margin(nominal) > (0.0 if c.cone == "psd" else -1e-300)
        demand(inside, f"{c.name} does not hold at the nominal parameters")
    plain = [c for c in constraints if c.family != "pseudo-inertia"]
    for k, parameter in enumerate(effect.parameters):
        step = np.eye(len(nominal))[k] * effect.largest_parameter
        kept = {0.99: True, -0.99: parameter.lower < 0.0, 1.01: False, -1.01: False}
        for value, expected in kept.items():
            holds = all(c.margin(nominal + value * step) >= 0.0 for c in plain)
            sentence = f"{parameter.name}: {value:g} times its range is {expected}"
            demand(holds == expected, sentence)


def check_hidden_torque(kind: type[Effect], forms: Forms) -> None:
    """Columns are the torque of the second statement of the law, where there is one, and
    it shares nothing with them: it uses NumPy and its arguments alone."""
    law = kind.hidden_torque
    if law is None:
        return
    names = inspect.getclosurevars(law)
    others = {*names.globals, *names.nonlocals} - {"np"}
    demand(not others, f"hidden_torque uses {', '.join(sorted(others))}")
    robot = robots()["arm"]
    motion = to_and_fro(robot)
    in_a_world = TrueMotion(motion.t, motion.q, motion.dq, motion.ddq)
    for effect in forms(robot):
        columns_of_joints = wide_columns(effect, motion)
        for joint in effect.joints:
            columns = columns_of_joints[joint]  # (N, p)
            try:
                torque = law(in_a_world, joint, motion.sign(joint), **effect.shape)
            except AttributeError as error:
                sentence = "hidden_torque gets t, q, dq and ddq of a motion, no more"
                raise ContractError(f"{sentence}: {error}") from error
            # Of several parameters a joint, the statement may be any sum.
            sizes = np.linalg.lstsq(columns, torque)[0]
            if len(effect.parameters) == len(effect.joints):
                sizes = np.ones(len(effect.parameters))
            left = np.linalg.norm(torque - columns @ sizes)
            same = left <= _ROUNDING * np.linalg.norm(torque)
            acts_alike = columns.any() == torque.any()
            demand(
                same and acts_alike, f"hidden_torque is not the torque of {effect.text}"
            )


def check_simulator_fields(kind: type[Effect], forms: Forms) -> None:
    """Its terms in simulators' files have the same fields for all parameters, zeros
    included: by these it is decided which files hold the effect."""
    effect = kind(robots()["tree"])
    count = len(effect.parameters)
    at_zeros, at_ones = (
        {term.field for term in effect.simulator_terms(theta)}
        for theta in (np.zeros(count), np.ones(count))
    )
    demand(at_zeros == at_ones, "simulator_terms has other fields for parameters of 0")
    unknown = ", ".join(sorted({*at_ones} - {*get_args(SimulatorField)}))
    demand(not unknown, f"simulator_terms has fields that no file has: {unknown}")


#: Each is asked of an effect's class and of the forms that are tried.
CONTRACTS: tuple[Callable[..., None], ...] = (
    check_shape_constants,
    check_columns_fit_any_robot,
    check_every_parameter_makes_torque,
    check_written_form,
    check_memory,
    check_needs_are_declared,
    check_units,
    check_once_or_several,
    check_frozen_only,
    check_constraints,
    check_hidden_torque,
    check_simulator_fields,
)
