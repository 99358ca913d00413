"""Robots and motions to try effects on, and the check of their units.

Robots have joints of one kind only where shape constants are at work: one constant for rad and m at
once has no unit.
"""

from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from random_robots import link_parameters, tree

from sdp_vs_penalty.effects import CurrentModel, Effect, Motion, effect_types, parse_effects
from sdp_vs_penalty.effects.motion import Command
from sdp_vs_penalty.robot import Joint, Robot

Array = NDArray[np.float64]


@cache
def robots() -> dict[str, Robot]:
    """A tree with both kinds of joints; an arm and a gantry with one kind; single joints."""

    def all_of(kind: str, robot: Robot) -> Robot:
        return replace(robot, joints=tuple(replace(j, kind=kind) for j in robot.joints))

    chain = tree(np.random.default_rng(1), 3, branched=False, link_frames=True)
    one = tree(np.random.default_rng(5), 1)
    return {
        "tree": tree(np.random.default_rng(5), 5),
        "arm": all_of("revolute", chain),
        "gantry": all_of("prismatic", chain),
        "single": all_of("revolute", one),
        "slide": all_of("prismatic", one),
    }


def steady_motion(robot: Robot, rows: int = 60, seed: int = 0) -> Motion:
    """A motion without reversals and far from standstill, with a current model.

    |dq| stays beyond 0.3 rad/s, where every smoothed sign is one, so that nothing but the declared
    shape constants has the unit of a velocity.
    """
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 0.01 * (rows - 1), rows)
    v = (0.8 + 0.7 * np.arange(robot.n)) * rng.choice([-1.0, 1.0], robot.n)
    a, phase = rng.uniform(-0.2, 0.2, robot.n), rng.uniform(0, 6, robot.n)
    wave = 3.0 * t[:, None] + phase
    q = rng.normal(size=robot.n) + np.outer(t, v) + a * np.sin(wave) / 3.0
    dq, ddq = v + a * np.cos(wave), -3.0 * a * np.sin(wave)
    links = np.array([link_parameters(rng, 0.4) for _ in robot.joints])
    torque = robot.inverse_dynamics(links, q, dq, ddq) + 0.5 * np.sign(dq) + 0.1 * dq
    warm = 20.0 + 300.0 * np.outer(t, 1.0 + np.arange(robot.n))
    moved = Motion(t, q, dq, ddq, torque, CurrentModel(robot, links), temperature=warm)
    return told(moved)


def told(motion: Motion) -> Motion:
    """With a command: positions and integrals of about the motion's own size."""
    q, dq, ddq = (1.3 * x for x in (motion.q, motion.dq, motion.ddq))
    sums = np.cumsum(motion.q, axis=0) * (motion.t[1] - motion.t[0])
    return replace(motion, command=Command(motion.t, q, dq, ddq, 1.7 * sums), sum=sums)


def wide_columns(effect: Effect, motion: Motion) -> Array:
    """(n, N, p) all columns, zero where a joint has none."""
    out = np.zeros((effect.robot.n, len(motion.t), len(effect.parameters)))
    for block in effect.blocks(motion):
        out[block.joint][:, block.parameters] += block.columns
    return out


def variants(name: str, robot: Robot) -> list[Effect]:
    """The effect on all joints as it is by default, and on each with whatever a search begins with."""
    kind = effect_types()[name]
    searched = [
        effect
        for joint in ([None] if kind.whole_robot else range(robot.n))
        for effect in kind.candidates(robot, joint)
    ]
    if name == "measured_curve":  # measured, not searched: over what is more than a joint's own signal
        kinds = [j.kind for j in robot.joints]
        other = 2 + kinds[1:].index(kinds[0]) if kinds[0] in kinds[1:] else 0
        over = [f"x={w}@xj=1@xi={other}@xc=-2" for w in ("q", "dq") if other]
        ends = "@xlow=-0.4@xhigh=0.9@v1=-1@v2=2"
        texts = [f"{name}:1@{x}{ends}" for x in over]
        searched = list(parse_effects(texts, robot))
    return [kind(robot), *searched]


def unit_scale(unit: str, base: dict[str, float], constants: dict[str, float]) -> float:
    """By what a number in this unit is multiplied if the base units are."""
    if unit == "-":
        return 1.0
    newton = base["kg"] * base["m"] / base["s"] ** 2
    known = {**base, "N": newton, "rad": 1.0, "turn": 1.0, "K": 1.0, "Hz": 1.0 / base["s"], **constants}
    return float(eval(unit.replace("^", "**"), {"__builtins__": {}}, known))  # units are our own words


def in_other_units(robot: Robot, base: dict[str, float]) -> Robot:
    """The same robot where a length of 1 m reads base["m"], and so on."""

    def moved(pose: Array) -> Array:
        out = np.array(pose)
        out[:3, 3] *= base["m"]
        return out

    def joint(j: Joint) -> Joint:
        return replace(j, placement=moved(j.placement), link_frame=moved(j.link_frame))

    x, y, z = np.array(robot.gravity) * base["m"] / base["s"] ** 2
    return Robot(robot.name, tuple(joint(j) for j in robot.joints), (x, y, z))


def check_units_are_those_of_the_columns(name: str) -> None:
    """Rewrite the whole problem in other units of mass, length and time: a column in the new units
    must be the old one times torque / parameter, with shape constants converted by their own unit."""
    for base in ({"kg": 1.0, "m": 1.0, "s": 0.7}, {"kg": 1.9, "m": 1.6, "s": 1.3}):
        for which, robot in robots().items():
            position, torque = (
                np.array([unit_scale(u, base, {}) for u in units])
                for units in (robot.position_units, robot.torque_units)
            )
            motion = steady_motion(robot)
            new = _rewritten(motion, in_other_units(robot, base), base, position, torque)
            assert new.current is not None
            for effect in variants(name, robot):
                if not effect.parameters or (which == "tree" and effect.shapes):
                    continue
                kind = effect.robot.joints[effect.joints[0]].kind
                shape = {
                    key: value * unit_scale(effect.shapes[key].unit_on(kind), base, {})
                    for key, value in effect.shape.items()
                }
                joints = None if effect.asked_joints is None else list(effect.asked_joints)
                rewritten = type(effect)(new.current.robot, joints, **shape)
                # A unit may hold an exponent, which is a number by itself.
                numbers = {k: v for k, v in effect.shape.items() if effect.shapes[k].unit == "-"}
                scale = np.array([unit_scale(p.unit, base, numbers) for p in effect.parameters])
                expected = wide_columns(effect, motion) * torque[:, None, None] / scale
                found = wide_columns(rewritten, new)
                atol = 1e-9 * np.abs(expected).max()
                wrong = [
                    f"{p.name} [{p.unit}]"
                    for p, a, b in zip(effect.parameters, expected.T, found.T, strict=True)
                    if not np.allclose(b, a, 1e-7, atol)
                ]
                assert not wrong, (
                    f"{effect.text} on {which}: torque over column is not in the unit declared of "
                    f"{', '.join(wrong)} (or a shape constant's unit is wrong)"
                )


def _rewritten(
    motion: Motion, robot: Robot, base: dict[str, float], position: Array, torque: Array
) -> Motion:
    s, m, kg = base["s"], base["m"], base["kg"]
    links = motion.model_links * kg * np.array([1, m, m, m, *[m * m] * 6])

    def moved(x: Motion | Command) -> tuple[Array, Array, Array, Array]:
        return x.t * s, x.q * position, x.dq * position / s, x.ddq * position / s**2

    return Motion(
        *moved(motion),
        motion.model_torque * torque,
        CurrentModel(robot, links),
        sign_width=motion.sign_width * position[0] / s,
        temperature=motion.temperature,
        command=Command(*moved(motion.told), motion.told.sum * position * s),
        sum=motion.integral * position * s,
    )
