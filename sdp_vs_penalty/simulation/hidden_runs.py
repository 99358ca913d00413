"""The verb ``simulate``: runs in which effects are hidden, for finding them again.

20 s of a motion that repeats after two thirds, noise as on the real arm: the problem's
own arm as a world, with what worlds can hide.
"""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.files import save
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects import effect_types, parse_effects
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import WRITERS_PATIENCE, folder_lock, write_text
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.results.record import Shown, Summary
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.trajectory import FourierTrajectory, random_trajectory
from sdp_vs_penalty.simulation.experiments import Experiment, experiment
from sdp_vs_penalty.simulation.experiments import simulate as measured
from sdp_vs_penalty.simulation.worlds import hidden as makers
from sdp_vs_penalty.simulation.worlds.hidden import LEVELS, Hidden, Maker, torques
from sdp_vs_penalty.simulation.worlds.world import (
    PAUSE,
    Arm,
    DryFriction,
    TrueMotion,
    World,
)

DURATION = 20.0  # s of each run
#: The blends into and out of the motion, which the log leaves out.
_BLEND = 0.7
_EVERY = {
    **makers.FRICTION,
    **makers.MACHINE,
    **makers.FROZEN,
    **makers.NUISANCE,
}
#: Whatever can be hidden, by the name of the library's effect.
MAKERS: Mapping[str, Maker] = dict(sorted(_EVERY.items()))
#: The files of a folder of simulated runs; the last run is meant as the test run.
RUN_FILES = ("run1.csv", "run2.csv", "run3.csv", "test.csv")


@dataclass(
    frozen=True,
    repr=False,
)
class HiddenRuns(Shown):
    """runs : as logged; truth : what is hidden, for a scorer; hidden : the effects,
    sized."""

    problem: Problem
    world: World
    runs: tuple[Measurements, ...]
    hidden: tuple[Hidden, ...]
    truth: dict[str, Any]

    @property
    def train(self) -> tuple[Measurements, ...]:
        """The runs to identify from."""
        return self.runs[:-1]

    @property
    def test(self) -> Measurements:
        """The run to judge on."""
        return self.runs[-1]

    def save(self, folder: str | Path) -> None:
        """Write truth.json, run1..3.csv and test.csv.

        Parameters
        ----------
        folder : path
            Where.

        Returns
        -------
        None
            Nothing.

        Raises
        ------
        InputError
            Where the folder holds runs that were not written here.
        """
        folder = Path(folder)
        truth = json.dumps(self.truth, indent=1)
        refuse_foreign(folder)
        with folder_lock(folder, patience=WRITERS_PATIENCE):
            # First: it marks the folder as ours, also where this is interrupted.
            write_text(folder / "truth.json", f"{truth}\n")
            for name, run in zip(RUN_FILES, self.runs, strict=True):
                save(run, folder / name)

    def _summary(self) -> Summary:
        length = self.test.t[-1] - self.test.t[0]
        return f"Simulated runs: {self.truth['problem']}, seed {self.truth['seed']}", [
            ("train", f"{formatting.count(len(self.train), 'run')} of {length:.3g} s"),
            ("test", f"1 run of {length:.3g} s"),
            ("model's effects", ", ".join(self.truth["model_effects"])),
        ]


def refuse_foreign(folder: Path) -> None:
    """Refuse a folder that holds runs which :meth:`HiddenRuns.save` did not write.

    Parameters
    ----------
    folder : Path
        Where runs are to be written.

    Returns
    -------
    None
        Nothing.

    Raises
    ------
    InputError
        Where there are such runs.
    """
    there = [name for name in RUN_FILES if (folder / name).exists()]
    if (
        there and not (folder / "truth.json").exists()
    ):  # else the folder is one that was written here
        raise InputError(f"{there[0]} exists already", "name another folder", folder)


def simulate(
    problem: str | Path | Problem,
    hide: str | Sequence[str] = (),
    level: str | float = "strong",
    seed: int = 0,
) -> HiddenRuns:
    """Simulate runs of a robot, with effects hidden in them.

    Parameters
    ----------
    problem : str, Path or Problem
        A built-in name, a folder with a problem.toml, a URDF file, or a Problem.
    hide : str or sequence of str
        ``effect[:joints]``, several separated by commas or in a sequence, or none.
    level : {"strong", "medium", "weak"} or float
        The hidden torque's RMS over that of the raw noise, or a name for it.
    seed : int
        Of everything random.

    Returns
    -------
    HiddenRuns
        Three runs to identify from and one to test on.

    Raises
    ------
    InputError
        For an effect that does not exist or makes no torque there, or another level.
    """
    robot = as_problem(problem, "simulate(problem=...)")
    size = level
    with suppress(ValueError):
        size = float(level)
    if size not in LEVELS and (isinstance(size, str) or not 0.0 < size < 1e6):
        remedy = f"write {', '.join(LEVELS)} or a positive number"
        raise InputError(f"level {level!r} is unknown", remedy)
    effects = [
        (e.name, list(e.asked_joints or ())) for e in parse_effects(hide, robot.robot)
    ]
    return hidden_runs(
        robot,
        effects,
        size,
        seed,
    )


def true_world(
    problem: Problem,
    setup: Experiment,
    seed: int,
    without: Sequence[str] = (),
) -> World:
    """The true robot: the experiment's links, random viscous and Coulomb friction and
    offsets of the size of friction there.

    Parameters
    ----------
    problem : Problem
        Of the robot.
    setup : Experiment
        Its links and friction.
    seed : int
        Of the friction.
    without : sequence of str
        Effects that are not among them.

    Returns
    -------
    World
        As it is simulated.
    """
    robot = problem.robot
    rng = np.random.default_rng([seed, 1])
    none = np.zeros(problem.robot.n)
    size = 0.02 + none if setup.friction is None else np.abs(setup.friction[:, 0])
    coulomb = (
        size * rng.uniform(0.5, 1.5, robot.n) * ("coulomb_friction" not in without)
    )
    viscous = (
        size * rng.uniform(0.2, 0.8, robot.n) * ("viscous_friction" not in without)
    )
    offset = (
        0.2 * size * rng.uniform(-1.0, 1.0, robot.n) * ("torque_offset" not in without)
    )
    model = robot._with_inertias(setup.links)
    chain = robot.mechanism
    rotary = np.array([joint.kind == "revolute" for joint in robot.joints])
    follows = (np.eye(robot.n), none) if chain is None else (chain.matrix, chain.offset)
    arm = Arm(
        model,
        rotary,
        robot.link_joints[-1] + 1,
        *follows,
    )
    dry = DryFriction(np.full(robot.n, min(problem.model().sign_width)))
    return World(
        arm,
        model,
        dry,
        coulomb,
        viscous,
        offset,
        setup.sensor.torque_std,
    )


def hidden_runs(
    problem: Problem,
    effects: Sequence[tuple[str, Sequence[int]]],
    level: str | float = "medium",
    seed: int = 0,
    count: int = 4,
    world: World | None = None,
) -> HiddenRuns:
    """Simulate runs, the last meant as the test run, with effects hidden in them.

    Parameters
    ----------
    problem : Problem
        Of the robot.
    effects : sequence of (str, sequence of int)
        Names and joints (from 0; empty: one effect on every joint that it can
        act on, or of the whole robot).
    level : str or float
        Of LEVELS, or the root mean square of the hidden torque over the raw
        noise of the joint that it moves most.
    seed : int
        Of everything random.
    count : int
        Of the runs.
    world : World, optional
        The true robot (default: that of the seed), so that the same one is
        measured with and without a load.

    Returns
    -------
    HiddenRuns
        The runs, and what is hidden.

    Raises
    ------
    InputError
        For an effect that has no simulation, or makes no torque on a joint that
        is named (backlash about a vertical axis).
    """
    factor = LEVELS[level] if isinstance(level, str) else float(level)
    setup = experiment(problem)
    rng = np.random.default_rng([seed, 2])
    without = [name for name, _ in effects]
    world = (
        true_world(
            problem,
            setup,
            seed,
            without,
        )
        if world is None
        else world
    )
    # One and a half periods in a run.
    length = DURATION + 2.0 * _BLEND
    frequency = 3.0 * np.pi / DURATION
    drawn = (10 * seed + k for k in range(count))
    trajectories = [
        random_trajectory(
            problem.robot,
            x,
            length,
            frequency=frequency,
        )
        for x in drawn
    ]
    inside = np.arange(
        _BLEND,
        _BLEND + DURATION,
        1.0 / 200.0,
    )  # coarse enough to be sized quickly
    coarse = [
        _motion(
            x,
            inside,
            k,
        )
        for k, x in enumerate(trajectories)
    ]
    hidden = []
    for name, joints in effects:
        if name not in MAKERS:
            raise InputError(
                f"effect {name!r} cannot be hidden", f"choose from {', '.join(MAKERS)}"
            )
        kind = effect_types()[name]
        for joint in joints or (
            [0] if kind.whole_robot else kind(problem.robot).joints
        ):
            one = replace(MAKERS[name](world, joint, rng), effect=name)
            sized = one.sized(world, coarse, factor)
            if sized is not one:
                hidden.append(sized)
            elif joints or not one.joints:
                where = f"on joint {joint + 1}" if one.joints else "on this robot"
                raise InputError(
                    f"{name} makes no torque {where}",
                    "hide it elsewhere, or hide another",
                )
    runs = tuple(
        _measure(
            x,
            world,
            hidden,
            setup,
            seed,
            k,
        )
        for k, x in enumerate(trajectories)
    )
    truth = {
        "problem": problem.name,
        "seed": seed,
        "level": level,
        "effects": [
            {
                **h.to_dict(),
                "size": (h.number or 1.0) * h.size,
            }
            for h in hidden
        ],
        "model_effects": [e for e in setup.problem.default_effects if e not in without],
    }
    return HiddenRuns(
        problem,
        world,
        runs,
        tuple(hidden),
        truth,
    )


def _motion(trajectory: FourierTrajectory, local: Array, k: int) -> TrueMotion:
    """Of run k, on the sitting's clock."""
    return TrueMotion(local + _start(k), *trajectory.states(local))


def _start(k: int) -> float:
    """Of run k, on the sitting's clock [s]."""
    return k * (DURATION + 2.0 * _BLEND + PAUSE)


def _measure(
    trajectory: FourierTrajectory,
    world: World,
    hidden: Sequence[Hidden],
    setup: Experiment,
    seed: int,
    k: int,
) -> Measurements:
    """One run as the sensor logs it, on the sitting's clock."""

    def torque(motion_now: Motion) -> Array:
        motion = _motion(trajectory, motion_now.t, k)
        return world.torque(motion) + sum(torques(world, motion, hidden))

    full_run = measured(
        trajectory,
        torque,
        setup.sensor,
        [seed, 3, k],
        name=f"run{k + 1}",
    )
    run = full_run.window(_BLEND, _BLEND + DURATION)
    clock = run.t + _start(k)
    warm = any(h.effect == "warming_friction" for h in hidden)
    return replace(
        run,
        t=clock,
        temperature=world.temperature(clock) if warm else None,
    )
