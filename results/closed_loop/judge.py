"""What a model is worth in a loop: feedforward, computed torque, a free run, contacts.

Every model gets the same arm, motions, gains and seeds. What needs no model (the runs on
which residuals and free runs are judged) is recorded once, under the PD controller alone.
"""

import contextlib
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np
from scipy.signal import butter, sosfiltfilt

from closed_loop.arm import (
    FINE,
    PLACEHOLDER,
    SETTLE,
    STEP,
    STRIBECK_VELOCITY,
    Arm,
    Array,
    Command,
    Log,
    N,
    Push,
    Reference,
    known,
    pd,
    smoothed,
    user_urdf,
)
from sdp_vs_penalty import Estimate, Measurements, add, diagnose, identify, load_problem
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.exporters import mjcf
from sdp_vs_penalty.exporters.content import Options
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.trajectory import (
    FourierTrajectory,
    PointTrajectory,
    random_trajectory,
    shortest_moves,
)

#: Of computed torque: every joint's error dies out as e'' + 2 w e' + w^2 e = 0 [rad/s].
BANDWIDTH = 20.0
#: A free run has left the recorded one beyond this [rad], and ends at the latest [s].
LEFT, LONGEST = 0.1, 3.0
#: How many instants of a run a free run starts from, and poses M(q) is judged in.
STARTS, POSES = 10, 50
#: Residuals of contacts pass a causal low-pass of first order [Hz].
RESIDUAL_CUTOFF = 10.0
#: A threshold over the peak of a run without contact.
MARGIN = 1.2
#: Forces of the pushes [N], each along x, y and z; length of one, and from one to the next
#: [s]. Alarms in the last third of that time, long after the push, are false.
FORCES = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 96.0)
PUSH, APART = 0.3, 1.2
#: Of the moves from point to point: limits of velocity over the joint's, acceleration
#: [rad/s^2] and jerk [rad/s^3].
SPEED, ACCELERATION, JERK = 0.6, 5.0, 100.0
#: Motions that logs are recorded along: share of the amplitude, seconds, and whether the
#: three runs are one motion.
MOTIONS = {"rich": (1.0, 14.0, False), "little": (0.3, 7.0, True)}
#: What the URDF's links are: drawn as the prior of results/default_method/prior.py is, or
#: made up.
URDFS = {
    "wrong": lambda: known().problem.nominal_links,
    "made up": lambda: np.tile(PLACEHOLDER, (N, 1)),
}
METHODS = ("ols", "penalty", "lmi-sdp-thickness")
DEFAULT, DIAGNOSED = "lmi-sdp (default)", "default + diagnose, add --helpful"
PD_ALONE, URDF_ALONE, TRUE = "PD alone", "the URDF's links", "the true model"
#: Which rows are made together: URDF, motion, models. The URDF decides nothing that
#: torque sees of the methods that have no prior.
PARTS: dict[str, tuple[str, str]] = {
    "without a log": ("", ""),
    **{f"{motion}, any URDF": ("", motion) for motion in MOTIONS},
    **{f"{motion}, {urdf}": (urdf, motion) for urdf in URDFS for motion in MOTIONS},
}


def fourier(seed: int, seconds: float, amplitude: float = 1.0) -> FourierTrajectory:
    """Return a random excitation within the arm's limits."""
    motion = random_trajectory(known().problem.robot, seed, seconds)
    return replace(motion, a=amplitude * motion.a, b=amplitude * motion.b)


def from_point_to_point(seed: int, count: int = 6) -> PointTrajectory:
    """Return moves between random points, with pauses."""
    robot = known().problem.robot
    lower, upper = (np.array([getattr(j, x) for j in robot.joints]) for x in ENDS)
    speed = SPEED * np.array([joint.velocity for joint in robot.joints])
    share = np.random.default_rng(seed).uniform(0.2, 0.8, (count, N))
    points = lower + share * (upper - lower)
    moves = shortest_moves(points, speed, np.full(N, ACCELERATION), np.full(N, JERK))
    return PointTrajectory(points, moves, np.full(count, 0.3))


ENDS = ("lower", "upper")


@dataclass(frozen=True)
class Draw:
    """One draw: an arm, its motions and its logs, all by its number."""

    #: Its number, from which every seed comes.
    number: int
    #: Share of all lengths, for tests.
    scale: float = 1.0

    @cached_property
    def arm(self) -> Arm:
        """The true arm."""
        return Arm.drawn(self.number)

    def _along(self, kind: int, motion: Any, pushes: tuple[Push, ...] = ()) -> Log:
        reference = Reference.along(motion)
        return self.arm.run(reference, pd(reference), (self.number, kind), pushes)

    def seed(self, kind: int) -> int:
        """Return the seed of a motion of this draw."""
        return 1000 * (self.number + 1) + kind

    def runs(self, motion: str) -> list[Measurements]:
        """Return three logs under PD alone: two to fit, one that judges findings."""
        amplitude, seconds, is_one = MOTIONS[motion]
        logs = []
        for k in range(3):
            path = fourier(self.seed(0 if is_one else k), seconds, amplitude)
            logs.append(self._along(10 + k, path).measurements(f"run{k + 1}"))
        return logs

    @cached_property
    def tests(self) -> dict[str, Reference]:
        """Unseen motion to follow."""
        points = from_point_to_point(self.seed(4), max(2, round(6 * self.scale)))
        excitation = fourier(self.seed(3), 8.0 * self.scale)
        return {
            "excitation": Reference.along(excitation),
            "points": Reference.along(points),
        }

    @cached_property
    def held_out(self) -> Log:
        """A run of the unseen excitation, whose torque drives the free runs."""
        reference = self.tests["excitation"]
        return self.arm.run(reference, pd(reference), (self.number, 20))

    @cached_property
    def without_contact(self) -> Log:
        """The run that sets thresholds."""
        return self._along(21, fourier(self.seed(5), 12.0 * self.scale))

    @cached_property
    def pushes(self) -> tuple[Push, ...]:
        """Each force along x, y and z once, in random order."""
        rng = np.random.default_rng([self.number, 2])
        forces = [f * axis for f in FORCES for axis in np.eye(3)]
        order = rng.permutation(len(forces))[: max(3, round(len(forces) * self.scale))]
        starts = SETTLE + 1.0 + APART * np.arange(len(order))
        return tuple(
            Push(t, PUSH, forces[k]) for t, k in zip(starts, order, strict=True)
        )

    @cached_property
    def with_pushes(self) -> Log:
        """The run in which pushes are to be found."""
        seconds = 1.0 + APART * len(self.pushes)
        return self._along(22, fourier(self.seed(6), seconds), self.pushes)


@contextlib.contextmanager
def problem_of(urdf: str) -> Iterator[Problem]:
    """Yield the problem of a user's URDF."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_bytes(user_urdf(URDFS[urdf]()))
        yield load_problem(path)


def true_model(draw: Draw, problem: Problem, run: Measurements) -> Estimate:
    """Return the arm's own numbers as a model; the run only makes the model's form."""
    joint = {
        name: 1 + int(np.argmax(getattr(draw.arm, name)))
        for name in ("stiffness", "stribeck")
    }
    dip = f"@vs={STRIBECK_VELOCITY:g}@delta=2@law=1"
    friction = {"coulomb_friction": "coulomb_friction@v_s=0.01"}
    effects = [friction.get(name, name) for name in problem.default_effects]
    effects += [f"joint_spring:{joint['stiffness']}"]
    effects += [f"stribeck_friction:{joint['stribeck']}{dip}"]
    form = identify(problem, run, effects=effects, check=False)
    values = {
        "viscous_friction": draw.arm.damping,
        "coulomb_friction": draw.arm.friction,
        "rotor_inertia": draw.arm.armature,
        "joint_spring": draw.arm.stiffness,
        "stribeck_friction": draw.arm.stribeck,
    }
    theta = np.zeros(len(form.theta))
    for k, parameter in enumerate(form.model.parameters):
        if parameter.effect in values and parameter.joint is not None:
            theta[k] = values[parameter.effect][parameter.joint - 1]
    theta[form.model.rigid_indices] = known().links.ravel()
    return form.with_theta(theta)


def urdf_model(problem: Problem, run: Measurements) -> Estimate:
    """Return the URDF's links as a model, without friction."""
    form = identify(problem, run, check=False)
    theta = np.zeros(len(form.theta))
    theta[form.model.rigid_indices] = problem.nominal_links.ravel()
    return form.with_theta(theta)


def runs_in_loop(model: Estimate) -> bool:
    """Whether all of a model's effects run in a loop at one state."""
    try:
        model.controller()
    except InputError:
        return False
    return True


def models_of(
    draw: Draw, part: str
) -> Iterator[tuple[str, Estimate | None, Estimate | None, str]]:
    """Yield the models of a part: URDF and name, the model, the one that runs in a loop at
    measured states, and what was added."""
    urdf, motion = PARTS[part]
    if not motion:
        yield PD_ALONE, None, None, ""
        run = draw.runs("little")[0]
        for name in URDFS:
            with problem_of(name) as problem:
                model = urdf_model(problem, run)
                yield f"{URDF_ALONE}, {name}", model, model, ""
        with problem_of("wrong") as problem:
            model = true_model(draw, problem, run)
            yield TRUE, model, model, ""
        return
    *train, test = draw.runs(motion)
    with problem_of(urdf or "wrong") as problem:
        if not urdf:
            for method in METHODS:
                model = identify(problem, train, method, check=False)
                yield method, model, model, ""
            return
        model = identify(problem, train, check=False)
        yield DEFAULT, model, model, ""
        found = diagnose(model, train, test, check=False).helpful
        better = add(model, found, train) if found else model
        in_loop = better
        if not runs_in_loop(better):
            alone = [f for f in found if runs_in_loop(add(model, [f], train))]
            in_loop = add(model, alone, train) if alone else model
        yield DIAGNOSED, better, in_loop, " ".join(f.text for f in found)


def rows_of(draw: Draw, part: str) -> list[dict[str, Any]]:
    """Return a row for each model of a part."""
    urdf, motion = PARTS[part]
    rows = []
    begin = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what an MJCF leaves out, constants at an end
        for name, model, in_loop, added in models_of(draw, part):
            row: dict[str, Any] = {
                "draw": draw.number, "part": part, "urdf": urdf, "motion": motion,
                "model": name, "added": added,
            }  # fmt: skip
            row |= followed(draw, model)
            if model is not None and in_loop is not None:
                row |= computed(draw, in_loop) | free_run(draw, model)
                row |= contacts(draw, model)
            now = time.process_time()
            rows.append(row | {"seconds": now - begin})
            begin = now
    return rows


def errors_of(log: Log, what: str) -> dict[str, float]:
    """Return RMS and peak of all joints' errors [mrad]; nothing of a run that diverged."""
    if log.diverged:
        return {f"{what}_rms": np.nan, f"{what}_peak": np.nan}
    error = 1e3 * log.error
    return {
        f"{what}_rms": float(np.sqrt(np.mean(error**2))),
        f"{what}_peak": float(np.abs(error).max()),
    }


def torque_along(model: Estimate, reference: Reference) -> Array:
    """Return a model's torque (N, n) at the reference."""
    states = reference.q, reference.dq, reference.ddq
    return np.asarray(model.predict(*states, reference.t))


def followed(draw: Draw, model: Estimate | None) -> dict[str, Any]:
    """Return errors under PD with the model's torque at the reference."""
    row: dict[str, Any] = {"feedforward_diverged": 0}
    for k, (name, reference) in enumerate(draw.tests.items()):
        torque = None if model is None else torque_along(model, reference)
        log = draw.arm.run(reference, pd(reference, torque), (draw.number, 30 + k))
        row |= errors_of(log, f"feedforward_{name}")
        row["feedforward_diverged"] += int(log.diverged)
    return row


def computed_torque(model: Estimate, reference: Reference) -> Command:
    """Return computed torque: links and rotors at the measured state, friction at the
    velocity of the reference."""
    arm = model.controller()

    def command(k: int, q: Array, dq: Array) -> Array:
        wanted, speed = reference.ddq[k], reference.dq[k]
        arm.update(q, speed, wanted)
        friction = arm.friction.copy()
        wanted = wanted + BANDWIDTH**2 * (reference.q[k] - q)
        arm.update(q, dq, wanted + 2.0 * BANDWIDTH * (speed - dq))
        return np.asarray(arm.torque - arm.friction + friction)

    return command


def mass_matrix(model: Estimate, q: Array) -> Array:
    """Return M(q), column by column."""
    arm, rest = model.controller(), np.zeros(N)

    def torque(ddq: Array) -> Array:
        arm.update(q, rest, ddq)
        return np.array(arm.torque)

    at_rest = torque(rest)
    return np.column_stack([torque(unit) - at_rest for unit in np.eye(N)])


def computed(draw: Draw, model: Estimate) -> dict[str, Any]:
    """Return errors under computed torque, and in how many poses M(q) is positive."""
    row: dict[str, Any] = {"computed_diverged": 0}
    for k, (name, reference) in enumerate(draw.tests.items()):
        command = computed_torque(model, reference)
        log = draw.arm.run(reference, command, (draw.number, 40 + k))
        row |= errors_of(log, f"computed_{name}")
        row["computed_diverged"] += int(log.diverged)
    path = np.concatenate([reference.q for reference in draw.tests.values()])
    poses = path[np.linspace(0, len(path) - 1, POSES).astype(int)]
    masses = np.array([mass_matrix(model, q) for q in poses])
    least = np.linalg.eigvalsh(0.5 * (masses + np.swapaxes(masses, 1, 2)))[:, 0]
    return row | {"positive_percent": 100.0 * float(np.mean(least > 0.0))}


def free_run(draw: Draw, model: Estimate) -> dict[str, Any]:
    """Return for how long the model in MuJoCo stays with the run whose torque drives it
    [s]: the median over some instants that it starts from."""
    try:
        # As `export --force` does: MuJoCo alone decides what it loads.
        content, _ = mjcf.write(model, Options(force=True))
        compiled = mujoco.MjModel.from_xml_string(content.decode())
    except (InputError, ValueError) as error:
        return {"free_seconds": np.nan, "mjcf_refused": str(error).splitlines()[0]}
    compiled.opt.timestep = FINE
    compiled.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    compiled.jnt_limited[:] = False
    log = draw.held_out
    low_pass = butter(4, 20.0, fs=1.0 / STEP, output="sos")
    q = sosfiltfilt(low_pass, log.q, axis=0)
    dq = np.gradient(q, STEP, axis=0)
    first, last = round(SETTLE / STEP), len(q) - round(0.5 / STEP)
    lasted = []
    for start in np.linspace(first, last, STARTS, endpoint=False).astype(int):
        data = mujoco.MjData(compiled)
        data.qpos[:], data.qvel[:] = q[start], dq[start]
        k = start
        end = min(len(q), start + round(LONGEST / STEP))
        while k < end and np.abs(data.qpos - q[k]).max() <= LEFT:
            data.qfrc_applied[:] = log.tau[k]
            mujoco.mj_step(compiled, data, round(STEP / FINE))
            k += 1
        lasted.append((k - start) * STEP)
    return {"free_seconds": float(np.median(lasted)), "mjcf_refused": ""}


def residual(model: Estimate, log: Log) -> Array:
    """Return measured less modelled torque (N, n) behind the low-pass; the acceleration
    is the reference's."""
    modelled = model.predict(log.q, log.dq, log.reference.ddq, log.reference.t)
    return smoothed(log.tau - np.asarray(modelled), RESIDUAL_CUTOFF)


def contacts(draw: Draw, model: Estimate) -> dict[str, Any]:
    """Return the residual without contact [N m], the least force from which on every push
    is found [N] (nan: none), and the share of quiet time with a false alarm [%]."""
    quiet = residual(model, draw.without_contact)[draw.without_contact.reference.moving]
    threshold = MARGIN * np.abs(quiet).max(axis=0)
    log = draw.with_pushes
    alarm = (np.abs(residual(model, log)) > threshold).any(axis=1)
    t = log.reference.t
    found, is_quiet = dict[float, bool](), np.zeros(len(t), bool)
    for push in draw.pushes:
        force = float(np.linalg.norm(push.force))
        during = (t >= push.start) & (t < push.start + push.seconds)
        found[force] = found.get(force, True) and bool(alarm[during].any())
        end = push.start + APART
        is_quiet |= (t >= end - APART / 3.0) & (t < end)
    missed = max(
        (force for force, is_found in found.items() if not is_found), default=0
    )
    return {
        "residual_rms": float(np.sqrt(np.mean(quiet**2))),
        "residual_peak": float(np.abs(quiet).max()),
        "push": min((force for force in found if force > missed), default=np.nan),
        "false_alarm_percent": 100.0 * float(np.mean(alarm[is_quiet])),
    }
