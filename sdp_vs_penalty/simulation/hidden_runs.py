"""Runs with hidden effects: 20 s of a motion that repeats after two thirds, noise as on the real arm.

``simulate --hide`` is made from these; the challenge has worlds of its own.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline, interp1d

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.hidden import HiddenEffect, Maker, TrueRobot
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.trajectory import FourierTrajectory, random_trajectory
from sdp_vs_penalty.simulation.experiment import Experiment, experiment
from sdp_vs_penalty.simulation.worlds.hidden import LEVELS

DURATION = 20.0  # s of each run
PERIOD = 2.0 / 0.15  # s: 1.5 periods in a run
PAUSE = 30.0  # s between runs
#: The blends into and out of the motion, which the log leaves out.
_BLEND = 0.7
#: Rate [Hz] at which effects are sized.
_SIZING = 200.0


def makers() -> dict[str, Maker]:
    """By the effect's name the function ``hidden`` beside its class, for those that have one."""
    homes = {name: vars(sys.modules[kind.__module__]) for name, kind in effect_types().items()}
    return {name: home["hidden"] for name, home in sorted(homes.items()) if "hidden" in home}


def make_hidden(effect: str, joint: int, robot: TrueRobot, rng: np.random.Generator) -> HiddenEffect:
    """A hidden effect of the library with random shape constants, of size 1 (to be scaled).

    joint : from 0; ignored by effects of the whole robot. Raises InputError for an effect that has
    no simulation, or that cannot act on this joint.
    """
    known = makers()
    if effect not in known:
        raise InputError(f"effect {effect!r} cannot be hidden", f"choose from {', '.join(known)}")
    return known[effect](joint, robot, rng)


@dataclass(frozen=True)
class HiddenRuns:
    """runs : as logged; ideal : what perfect sensors and a perfect clock would have logged at the same
    instants; plain : the same of a robot without the hidden effects; truth : what a scorer may read;
    hidden : the effects, sized."""

    problem: Problem
    true: TrueRobot
    runs: tuple[Measurements, ...]
    ideal: tuple[Measurements, ...]
    plain: tuple[Measurements, ...]
    hidden: tuple[HiddenEffect, ...]
    truth: dict[str, Any]


def true_robot(problem: Problem, setup: Experiment, seed: int, without: Sequence[str] = ()) -> TrueRobot:
    """The true robot: the experiment's links, random viscous and Coulomb friction and offsets of the
    size of friction there; effects named in ``without`` are not among them."""
    rng = np.random.default_rng([seed, 1])
    n = problem.robot.n
    size = 0.02 * np.ones(n) if setup.friction is None else np.abs(setup.friction[:, 0])
    coulomb, viscous, offset = (
        size * rng.uniform(0.5, 1.5, n),
        size * rng.uniform(0.2, 0.8, n),
        0.2 * size * rng.uniform(-1.0, 1.0, n),
    )
    width = min(problem.model().sign_width)
    return TrueRobot(problem.robot, setup.links, viscous, coulomb, offset, width).without(without)


def hidden_runs(
    problem: Problem,
    effects: Sequence[tuple[str, Sequence[int]]],
    level: str | float = "medium",
    seed: int = 0,
    count: int = 4,
    made: Sequence[HiddenEffect] = (),
    true: TrueRobot | None = None,
    must_show: bool = False,
) -> HiddenRuns:
    """Simulate ``count`` runs (the last meant as the test run) with effects hidden in them.

    effects : names and joints (from 0; empty: one effect on every joint that it can act on, or of
    the whole robot); made : hidden effects of another kind, sized alike. level : of LEVELS, or the
    root mean square of the hidden torque over the raw noise of the joint that it moves most.
    true : the true robot (default: that of the seed). must_show : raise InputError for an effect that
    makes no torque at all on its joint (backlash about a vertical axis) instead of hiding nothing.
    """
    factor = LEVELS[level] if isinstance(level, str) else float(level)
    setup = experiment(problem)
    rng = np.random.default_rng([seed, 2])
    without = [name for name, _ in effects]
    usual = true_robot(problem, setup, seed) if true is None else true
    true = true_robot(problem, setup, seed, without) if true is None else true
    trajectories = [
        random_trajectory(
            problem.robot,
            10 * seed + k,
            DURATION + 2.0 * _BLEND,
            frequency=2.0 * np.pi / PERIOD,
        )
        for k in range(count)
    ]
    hidden = []
    for name, joints in effects:
        for joint in joints or _all_joints(problem, name):
            one = make_hidden(name, joint, usual, rng)
            sized = _sized(one, true, trajectories, setup, factor)
            if sized is not one or not must_show:
                hidden.append(sized)
            elif joints or not one.joints:
                where = f"on joint {joint + 1}" if one.joints else "on this robot"
                raise InputError(f"{name} makes no torque {where}", "hide it elsewhere, or hide another")
    hidden += [_sized(one, true, trajectories, setup, factor) for one in made]
    measured = [_measure(x, true, hidden, setup, seed, k) for k, x in enumerate(trajectories)]
    logged, ideal, plain = zip(*measured, strict=True)
    truth = {
        "problem": problem.name,
        "seed": seed,
        "level": level,
        "effects": [h.to_dict() for h in hidden],
        "model_effects": [e for e in setup.problem.default_effects if e not in without],
    }
    return HiddenRuns(problem, true, logged, ideal, plain, tuple(hidden), truth)


def _all_joints(problem: Problem, name: str) -> Sequence[int]:
    kind = effect_types().get(name)
    if kind is None or kind.whole_robot:
        return [0]
    return list(kind(problem.robot).joints)


def _motion(trajectory: FourierTrajectory, local: Array, start: float) -> Motion:
    return Motion(local + start, *trajectory.states(local))


def starts(k: int) -> float:
    """When run k begins on the sitting's clock [s]."""
    return k * (DURATION + 2.0 * _BLEND + PAUSE)


def true_torque(
    true: TrueRobot,
    hidden: Sequence[HiddenEffect],
    trajectory: FourierTrajectory,
    local: Array,
    start: float,
) -> tuple[Array, Array]:
    """(N, n) what the torque channels carry, noise aside: with the hidden effects, and without."""

    def at(moment: Array, base: Array | None = None) -> Array:
        motion = _motion(trajectory, moment, start)
        if base is not None and not any(h.encoder for h in hidden):
            out = base.copy()
        else:
            # Friction rubs at the motor, whose motion the encoder shows.
            error = encoder_error(true, hidden, motion)
            rate = np.gradient(error, moment, axis=0) if np.any(error) else 0.0
            out = true.rigid(motion) + true.friction(replace(motion, dq=motion.dq + rate))
        for h in hidden:
            if h.torque is not None:
                out += h.torque(true, motion, h.size)
        return out

    plain = true.torque(_motion(trajectory, local, start))
    torque = at(local, plain)
    for h in hidden:
        if h.late is not None:
            for late in np.unique(h.late[h.late > 0.0]):
                channels = h.late == late
                torque[:, channels] = at(local - h.size * late)[:, channels]
    return torque, plain


def encoder_error(true: TrueRobot, hidden: Sequence[HiddenEffect], motion: Motion) -> Array:
    """(N, n) what the encoders show beyond the links' true positions."""
    out = np.zeros_like(motion.q)
    for h in hidden:
        if h.encoder is not None:
            out = out + h.encoder(true, motion, h.size)
    return out


def hidden_torque(
    true: TrueRobot,
    hidden: HiddenEffect,
    trajectory: FourierTrajectory,
    start: float,
    rate: float = _SIZING,
) -> tuple[Motion, Array]:
    """The motion as the encoders show it, and (N, n) the torque that a model without the effect gets
    wrong on it, sampled at ``rate`` [Hz]."""
    local = np.arange(_BLEND, _BLEND + DURATION, 1.0 / rate)
    if hidden.encoder is None:
        torque, plain = true_torque(true, [hidden], trajectory, local, start)
        motion = _motion(trajectory, local, start)
        return replace(motion, temperature=true.temperature(motion.t)), torque - plain
    motion = _motion(trajectory, local, start)
    error = encoder_error(true, [hidden], motion)
    speed = np.gradient(error, local, axis=0)
    shown = Motion(
        motion.t,
        motion.q + error,
        motion.dq + speed,
        motion.ddq + np.gradient(speed, local, axis=0),
    )
    return shown, true.rigid(motion) - true.rigid(shown)


def _sized(
    hidden: HiddenEffect,
    true: TrueRobot,
    trajectories: Sequence[FourierTrajectory],
    setup: Experiment,
    factor: float,
) -> HiddenEffect:
    """The effect scaled until its torque has the wanted size (twice, as some are not linear); as it is,
    if it makes none."""
    for _ in range(2):
        change = np.concatenate(
            [hidden_torque(true, hidden, x, starts(k))[1] for k, x in enumerate(trajectories)]
        )
        ratio = float((np.sqrt(np.mean(change**2, axis=0)) / setup.sensor.torque_std).max())
        if ratio < 1e-9:
            return hidden
        hidden = hidden.sized(factor / ratio)
    return hidden


def _measure(
    trajectory: FourierTrajectory,
    true: TrueRobot,
    hidden: Sequence[HiddenEffect],
    setup: Experiment,
    seed: int,
    k: int,
) -> tuple[Measurements, Measurements, Measurements]:
    """One run as the sensor logs it, as a perfect one would, and without the hidden effects.

    The controller renews its values at its own rate; the log's clock reads whatever was last.
    """
    rng = np.random.default_rng([seed, 3, k])
    local = setup.sensor.instants(trajectory.duration)
    motion = _motion(trajectory, local, starts(k))
    torque, plain = true_torque(true, hidden, trajectory, local, starts(k))
    position = motion.q + encoder_error(true, hidden, motion)
    log, *shown = setup.sensor.log(trajectory.duration, position, torque, rng)
    inside = (log >= _BLEND) & (log < _BLEND + DURATION)
    log, name = log[inside], f"run{k + 1}"
    clock = log + starts(k)
    found = [tuple(x[inside] for x in shown)]
    for where, load in ((position, torque), (motion.q, plain)):
        found.append((CubicSpline(local, where)(log), interp1d(local, load, axis=0)(log)))
    warm = true.temperature(clock) if any(h.warm for h in hidden) else None
    logged, ideal, without = (
        Measurements(clock, x, tau, names=(name,), temperature=warm) for x, tau in found
    )
    return logged, ideal, without
