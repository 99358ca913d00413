"""The verb ``simulate``: runs in which effects are hidden, for finding them again.

A run is 20 s of a motion that repeats after two thirds of it, with the sensor noise of
the problem's experiment. The world is the problem's own arm.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.arguments import checked_arguments
from sdp_vs_penalty.data.files import save
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects import effect_types, parse_effects, standard_effect
from sdp_vs_penalty.effects.effect import CurrentModel, Effect, JointEffect, Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import WRITERS_PATIENCE, folder_lock, write_text
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.results.record import Shown, Summary
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.inertia import deformed, parameter_names
from sdp_vs_penalty.robot.trajectory import FourierTrajectory, random_trajectory
from sdp_vs_penalty.simulation.experiments import Experiment, experiment
from sdp_vs_penalty.simulation.experiments import simulate as measured
from sdp_vs_penalty.simulation.worlds.hidden import (
    LEVELS,
    MAKERS,
    Hidden,
    make_hidden,
    torques,
)
from sdp_vs_penalty.simulation.worlds.world import (
    PAUSE,
    Arm,
    DryFriction,
    TrueMotion,
    World,
)

#: Length of a run [s].
DURATION = 20.0
#: The blends into and out of the motion, which the log leaves out.
_BLEND = 0.7
#: The files of a folder of simulated runs; the last run is meant as the test run.
RUN_FILES = ("run1.csv", "run2.csv", "run3.csv", "test.csv")


@dataclass(frozen=True, repr=False)
class HiddenRuns(Shown):
    """Simulated runs of a robot with hidden effects."""

    #: The robot as it is known.
    problem: Problem
    #: The true robot.
    world: World
    #: Runs as they are logged.
    runs: tuple[Measurements, ...]
    #: Hidden effects with their sizes.
    hidden: tuple[Hidden, ...]
    #: Content of truth.json: what is hidden, for a scorer.
    truth: dict[str, Any]

    @property
    def train(self) -> tuple[Measurements, ...]:
        """The runs to identify from: all but the last."""
        return self.runs[:-1]

    @property
    def test(self) -> Measurements:
        """The run to judge models on: the last."""
        return self.runs[-1]

    def save(self, folder: str | Path) -> None:
        """Write the runs as CSV files, and what is hidden in them as truth.json.

        Parameters
        ----------
        folder : path
            Folder for truth.json, run1.csv to run3.csv and test.csv.

        Raises
        ------
        InputError
            If the folder holds runs of another simulation or program.
        """
        folder = Path(folder)
        truth = json.dumps(self.truth, indent=1)
        with folder_lock(folder, patience=WRITERS_PATIENCE):
            # Behind the lock: another simulation may have written there until now.
            refuse_foreign(folder, self.truth)
            # First: it marks the folder as ours, also where this is interrupted.
            write_text(folder / "truth.json", f"{truth}\n")
            for name, run in zip(RUN_FILES, self.runs, strict=True):
                save(run, folder / name)

    def _summary(self) -> Summary:
        """Return title and lines of the repr: lengths of the runs, effects for a
        first model.
        """
        length = self.test.t[-1] - self.test.t[0]
        return f"Simulated runs: {self.truth['problem']}, seed {self.truth['seed']}", [
            ("train", f"{formatting.count(len(self.train), 'run')} of {length:.3g} s"),
            ("test", f"1 run of {length:.3g} s"),
            ("model's effects", ", ".join(self.truth["model_effects"])),
        ]


def refuse_foreign(folder: Path, truth: Mapping[str, Any]) -> None:
    """Raise InputError if a folder holds runs that another simulation, or another
    program, wrote.

    The same simulation may write its folder again, which does not change it. It is
    recognised by truth.json.

    Parameters
    ----------
    folder : Path
        Folder that runs are to be written into.
    """
    existing = [name for name in RUN_FILES if (folder / name).exists()]
    file = folder / "truth.json"
    if not existing:
        return
    if not file.exists():
        raise InputError(f"{existing[0]} exists already", "name another folder", folder)
    # Not by `read_json`: the file would count as an input, which no output replaces.
    content: dict[str, Any] = {}
    with suppress(ValueError, OSError):
        content = dict(json.loads(file.read_text("utf-8")))
    # As JSON, since its texts and numbers are those of the file.
    expected = json.loads(json.dumps(dict(truth)))
    if {key: content.get(key) for key in expected} == expected:
        return
    identifying = [f"{key} {content.get(key)}" for key in ("problem", "seed", "level")]
    differ = [key for key in expected if content.get(key) != expected[key]]
    differences = formatting.words([key.replace("_", " ") for key in differ])
    raise InputError(
        f"holds the runs of another simulation ({', '.join(identifying)}; it differs by"
        f" {differences})",
        "name another folder, or remove this one",
        folder,
    )


#: Content of truth.json, and a function that simulates the runs, which takes most of
#: the time.
Plan = tuple[dict[str, Any], Callable[[], HiddenRuns]]


@checked_arguments
def simulate(
    problem: str | Path | Problem,
    hide: str | Sequence[str] = (),
    level: str | float = "strong",
    seed: int = 0,
    link_error: float = 0.0,
) -> HiddenRuns:
    """Simulate runs of a robot, with effects hidden in them.

    A problem with a simulation.toml states its sensors' noise. Of any other robot it is a
    thousandth of each joint's own torque (RMS): a wrist that carries next to nothing has
    next to no noise, and a small error of its model is many times that.

    Parameters
    ----------
    problem : str, Path or Problem
        A built-in name, a folder with a problem.toml, a URDF file, or a Problem.
    hide : str or sequence of str
        ``effect[:joints][@shape=value]``, several separated by commas or in a sequence,
        or none. Constants that are not given are drawn; a plug-in's are its defaults.
    level : {"strong", "medium", "weak"} or float
        The hidden torque's RMS over that of the raw noise, or a name for it.
    seed : int
        Seed of the motions, the sensors' noise and what is hidden.
    link_error : float
        How far true links differ from those of the robot's file: 0.2 for about a fifth
        in size, mass and centre (:func:`~sdp_vs_penalty.robot.inertia.deformed`).

    Returns
    -------
    HiddenRuns
        Three runs to identify from and one to test on. ``truth["links"]`` has each
        link's true parameters, by their names in model.json (m1, mx1, Ixx1; SI).

    Raises
    ------
    InputError
        For an effect that does not exist or makes no torque there, another level, or a
        link error outside of 0 to 1.
    """
    _, simulated = planned(problem, hide, level, seed, link_error)
    return simulated()


def planned(
    problem: str | Path | Problem,
    hide: str | Sequence[str] = (),
    level: str | float = "strong",
    seed: int = 0,
    link_error: float = 0.0,
) -> Plan:
    """Return the plan of what :func:`simulate` simulates; arguments and errors are the
    same."""
    robot = as_problem(problem, "simulate(problem=...)")
    strength = level  # a name of LEVELS, or a number
    with suppress(ValueError):
        strength = float(level)
    is_number = not isinstance(strength, str) and 0.0 < strength < 1e6
    if strength not in LEVELS and not is_number:
        remedy = f"write {', '.join(LEVELS)} or a positive number"
        raise InputError(f"level {level!r} is unknown", remedy)
    if not 0.0 <= link_error <= 1.0:
        raise InputError(f"link error {link_error!r}", "give a number from 0 to 1")
    effects = [
        (e.name, list(e.asked_joints or ()), {key: e.shape[key] for key in e.given})
        for e in parse_effects(hide, robot.robot)
    ]
    return _plan(robot, effects, strength, seed, link_error=link_error)


#: Friction of an arm whose experiment states none [N m, N].
_SMALL_FRICTION = 0.02


def true_world(
    problem: Problem, setup: Experiment, seed: int, without: Sequence[str] = ()
) -> World:
    """Make the true robot of a simulation.

    Its links are those of the experiment. With the size of the experiment's friction as
    one, Coulomb friction is drawn between .5 and 1.5, viscous friction [per rad/s, m/s]
    between .2 and .8, and torque offsets up to .2 either way.

    Parameters
    ----------
    problem : Problem
        The robot, its kinematics exact.
    setup : Experiment
        Its true links, friction and sensor noise.
    seed : int
        Seed of the random friction.
    without : sequence of str
        Effects that the robot does not have, because they are hidden later.
    """
    robot = problem.robot
    rng = np.random.default_rng([seed, 1])  # motions and noise have other numbers
    zeros = np.zeros(robot.n)
    size = np.full(robot.n, _SMALL_FRICTION)
    if setup.friction is not None:
        size = np.abs(setup.friction[:, 0])
    # All are drawn, whether they act or not, so that each keeps its random numbers.
    drawn = {
        standard_effect("friction").name: size * rng.uniform(0.5, 1.5, robot.n),
        standard_effect("damping").name: size * rng.uniform(0.2, 0.8, robot.n),
        standard_effect("offset").name: 0.2 * size * rng.uniform(-1.0, 1.0, robot.n),
    }
    coulomb, viscous, offset = (
        zeros if name in without else torque for name, torque in drawn.items()
    )
    model = robot.pinocchio_model(setup.links)
    chain = robot.mechanism
    rotary = np.array([joint.kind == "revolute" for joint in robot.joints])
    arm = Arm(
        model,
        rotary,
        last=robot.link_joints[-1] + 1,
        follows=np.eye(robot.n) if chain is None else chain.matrix,
        shift=zeros if chain is None else chain.offset,
    )
    # Real friction turns round at one velocity, the smallest that the model allows.
    dry = DryFriction(np.full(robot.n, min(problem.model().sign_width)))
    return World(
        arm,
        built=model,
        dry=dry,
        coulomb=coulomb,
        viscous=viscous,
        offset=offset,
        noise=setup.sensor.torque_std,
    )


def hidden_runs(
    problem: Problem,
    effects: Sequence[tuple[str, Sequence[int]]],
    level: str | float = "medium",
    seed: int = 0,
    count: int = 4,
    world: World | None = None,
) -> HiddenRuns:
    """Simulate runs with hidden effects; the last run is meant for testing.

    Parameters
    ----------
    effects : sequence of (str, sequence of int)
        Name and joints (from 0) of each effect. Without joints it acts on every joint
        that it can act on, or on the whole robot.
    level : str or float
        Name in LEVELS, or the RMS of the hidden torque over the raw noise, on the joint
        that the effect moves most.
    world : World, optional
        The true robot; by default that of the seed. Passing one measures the same robot
        with and without a load.

    Returns
    -------
    HiddenRuns
        The runs, and what is hidden.

    Raises
    ------
    InputError
        For an effect that cannot be simulated, or that makes no torque on a named joint
        (such as backlash about a vertical axis).
    """
    nothing_given: Mapping[str, float] = {}
    drawn = [(name, joints, nothing_given) for name, joints in effects]
    _, simulated = _plan(problem, drawn, level, seed, count, world)
    return simulated()


def _plan(
    problem: Problem,
    effects: Sequence[tuple[str, Sequence[int], Mapping[str, float]]],
    level: str | float,
    seed: int,
    count: int = len(RUN_FILES),
    world: World | None = None,
    link_error: float = 0.0,
) -> Plan:
    """Draw the motions and size the effects of :func:`hidden_runs`, which has the same
    arguments; each effect has the shape constants that are chosen, by name.
    """
    factor = LEVELS[level] if isinstance(level, str) else float(level)
    setup = experiment(problem)
    rng = np.random.default_rng([seed, 2])
    if link_error:
        links = deformed(setup.links, link_error, np.random.default_rng([seed, 3]))
        setup = replace(setup, links=links)
    without = [name for name, *_ in effects]
    if world is None:
        world = true_world(problem, setup, seed, without)
    length = DURATION + 2.0 * _BLEND
    # One and a half periods in a run, so that a part of it repeats.
    frequency = 3.0 * np.pi / DURATION
    trajectories = [
        random_trajectory(problem.robot, 10 * seed + k, length, frequency=frequency)
        for k in range(count)
    ]
    # Effects are sized on a coarse grid of 200 Hz, which is fast.
    coarse_times = np.arange(_BLEND, _BLEND + DURATION, 1.0 / 200.0)
    coarse_motions = [
        _motion(trajectory, coarse_times, k)
        for k, trajectory in enumerate(trajectories)
    ]
    hidden = []
    for name, joints, shape_constants in effects:
        hidden += _sized_effects(
            name,
            joints,
            shape_constants,
            problem=problem,
            links=setup.links,
            world=world,
            motions=coarse_motions,
            factor=factor,
            rng=rng,
        )
    truth = {
        "problem": problem.name,
        "robot": _hash_of_robot(problem, setup),
        "seed": seed,
        "level": level,
        "effects": [
            h.truth | {"size": (h.library_value or 1.0) * h.size} for h in hidden
        ],
        "model_effects": [e for e in setup.problem.default_effects if e not in without],
        "links": {
            name: float(value)
            for i, link in enumerate(setup.links, start=1)
            for name, value in zip(parameter_names(i), link, strict=True)
        },
    }

    def simulated() -> HiddenRuns:
        """Simulate the runs."""
        runs = tuple(
            _measure(trajectory, world, hidden, setup, seed, k)
            for k, trajectory in enumerate(trajectories)
        )
        return HiddenRuns(problem, world, runs, tuple(hidden), truth)

    return truth, simulated


def _hash_of_robot(problem: Problem, setup: Experiment) -> str:
    """Return a SHA-256 (hex) of the robot's geometry and true links.

    Two robots may have one name: an edited URDF, or one with joints that are held.
    """
    body = {"robot": problem.robot.to_dict(), "links": np.asarray(setup.links).tolist()}
    return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


def _sized_effects(
    name: str,
    joints: Sequence[int],
    shape_constants: Mapping[str, float],
    *,
    problem: Problem,
    links: Array,
    world: World,
    motions: Sequence[TrueMotion],
    factor: float,
    rng: np.random.Generator,
) -> list[Hidden]:
    """Make one effect on each of its joints, scaled so that its torque has ``factor``
    times the RMS of the sensor noise.

    ``joints`` count from 0; ``shape_constants`` are those that are not drawn. If no joint is
    named, the effect is made on every joint on which it can act, and left out where it makes no
    torque. Raises InputError for an effect that cannot be simulated, or that makes no
    torque on a joint that was named.
    """
    kind = effect_types()[name]
    if name not in MAKERS and not issubclass(kind, JointEffect):
        raise InputError(
            f"effect {name!r} cannot be hidden", f"choose from {', '.join(MAKERS)}"
        )
    all_joints = [0] if kind.whole_robot else kind(problem.robot).joints
    sized_effects = []
    for joint in joints or all_joints:
        if name in MAKERS:
            unsized = make_hidden(name, world, joint, rng)
            if shape_constants:
                unsized = _with_constants(unsized, shape_constants, problem, links)
        else:
            unsized = _hidden_by_its_class(
                kind(problem.robot, [joint], **shape_constants), links
            )
        sized = unsized.sized(world, motions, factor)
        if sized is not unsized:
            sized_effects.append(sized)
        elif joints or not unsized.joints:
            where = f"on joint {joint + 1}" if unsized.joints else "on this robot"
            raise InputError(
                f"{name} makes no torque {where}", "hide it elsewhere, or hide another"
            )
    return sized_effects


def _with_constants(
    drawn: Hidden, shape_constants: Mapping[str, float], problem: Problem, links: Array
) -> Hidden:
    """Return an effect with some shape constants chosen, and the others as they
    were drawn; its torque comes from the library's class. Raises InputError for a
    constant that is not drawn, or that depends on a law that is drawn."""
    kind = effect_types()[drawn.effect]
    known = () if kind.joins else tuple(drawn.shape)
    if unknown := sorted(shape_constants.keys() - known):
        raise InputError(
            f"{drawn.effect}: {', '.join(unknown)} cannot be chosen in a simulation",
            f"choose {formatting.words(known)}" if known else "leave it out",
        )
    effect = kind(problem.robot, drawn.joints, **{**drawn.shape, **shape_constants})
    return replace(
        _hidden_by_its_class(effect, links), acts_on_channels=drawn.acts_on_channels
    )


def _hidden_by_its_class(effect: Effect, links: Array) -> Hidden:
    """Hide an effect whose torque comes from the library's class (:func:`_torque_of`),
    because no maker has these constants; ``links`` (n, 10) are the true ones."""
    number = 1.0 if len(effect.parameters) == 1 else None
    change = partial(_torque_of, effect, CurrentModel(effect.robot, links))
    return Hidden(effect.joints, change, number, shape=effect.shape, effect=effect.name)


def _torque_of(
    effect: Effect, true: CurrentModel, world: World, motion: TrueMotion, size: float
) -> Array:
    """Return the torque (N, n) of an effect whose parameters all equal ``size``.

    It comes from the class's ``hidden_torque``, a second statement of the law; without
    one, from the effect's columns on the true robot (its links, its torque without the
    effect, its temperature).
    """
    law = type(effect).hidden_torque
    if law is None:
        true_motion = Motion(
            motion.t,
            motion.q,
            motion.dq,
            motion.ddq,
            torque=world.torque(motion) if effect.needs_torque else None,
            current=true,
            temperature=world.temperature(motion.t),
        )
        return effect.torque(np.full(len(effect.parameters), size), true_motion)
    torque = np.zeros_like(motion.q)
    for joint in effect.joints:
        sign = world.share(motion)[:, joint]
        torque[:, joint] = size * law(motion, joint, sign, **effect.shape)
    return torque


def _motion(trajectory: FourierTrajectory, local: Array, k: int) -> TrueMotion:
    """Return the motion of run k (from 0) at the times ``local`` (N,) since its start
    [s].

    The time stamps of the result count from the start of run 0, since the gears warm up
    from run to run.
    """
    return TrueMotion(local + _start(k), *trajectory.states(local))


def _start(k: int) -> float:
    """Return when run k starts [s], counted from the start of run 0; PAUSE lies
    between.
    """
    return k * (DURATION + 2.0 * _BLEND + PAUSE)


def _measure(
    trajectory: FourierTrajectory,
    world: World,
    hidden: Sequence[Hidden],
    setup: Experiment,
    seed: int,
    k: int,
) -> Measurements:
    """Simulate run k (from 0) as the sensor logs it, with the hidden effects.

    The first and last _BLEND seconds, in which the trajectory blends into and out of
    the motion, are cut off. Temperatures are logged only if an effect depends on them.
    """

    def torque(motion_now: Motion) -> Array:
        """Return the true torque (N, n) with hidden effects, at the instants of a
        motion."""
        motion = _motion(trajectory, motion_now.t, k)
        return world.torque(motion) + sum(torques(world, motion, hidden))

    full_run = measured(
        trajectory, torque, setup.sensor, [seed, 3, k], name=f"run{k + 1}"
    )
    run = full_run.window(_BLEND, _BLEND + DURATION)
    clock = run.t + _start(k)
    temperature = None
    if any(effect_types()[h.effect].needs_temperature for h in hidden):
        temperature = world.temperature(clock)
    return replace(run, t=clock, temperature=temperature)
