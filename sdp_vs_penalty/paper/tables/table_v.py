"""Table V, and the runs that Figures 5 to 7 share: physics engines against the
identified model.

Joints follow velocities; an engine says which torque that took and where the arm went,
the identified model which torque it should have taken. Published engines stand beside
those at hand.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import scipy

from sdp_vs_penalty.diagnosis.comparison import predicted
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.paper.memo import load_or_compute, program_version
from sdp_vs_penalty.paper.tables.study import Data, Study
from sdp_vs_penalty.paper.tables.table import (
    Row,
    StudyTable,
    by_joint,
    notes,
    register_table,
)
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot, joint_limits
from sdp_vs_penalty.signals.filtered import FilteredRun
from sdp_vs_penalty.signals.runs import interpolated
from sdp_vs_penalty.simulation.engines import engine_types
from sdp_vs_penalty.simulation.engines.engine import Engine

#: q, dq, ddq (M, n) at the instants (M,) [s].
Course = Callable[[Any], tuple[Array, Array, Array]]
#: Time step along the real run [s].
MEASURED_STEP = 2e-3
#: The method whose links the engines get.
METHOD = "lmi-sdp"


@dataclass(frozen=True)
class EngineRun:
    """One engine along one motion, beside the model of the same links."""

    #: Name of the engine.
    engine: str
    #: (N,) middle of each step [s], of which its torque is the mean.
    t: Array
    #: (N, n) torque of the engine [N m, N].
    torque: Array
    #: (N, n) torque of recursive Newton-Euler [N m, N].
    model: Array
    #: (N, n) torque less the model's, or less what was measured and is not friction [N
    #: m, N].
    error: Array
    #: (N,) distance of the last link's joint frame from where the commanded motion puts
    #: it, at the end of each step [m].
    position: Array
    #: (N,) rotation of that frame from where the commanded motion puts it [rad].
    angle: Array


#: Of every engine its run along one motion, or why there is none: absent, or it rejects
#: a link.
Played = dict[type[Engine], EngineRun | str]


def sinusoids(robot: Robot) -> Course:
    """Return sinusoidal velocities that start from rest, q_j(t) = middle_j - a_j
    cos(w_j t).

    They cover 90 % of every joint's range, with half of its velocity limit.

    Parameters
    ----------
    robot : Robot
        With limits of position and velocity.

    Returns
    -------
    callable
        Maps instants (M,) [s] to q, dq, ddq (M, n).
    """
    lower, upper, velocity = joint_limits(robot)
    a = 0.5 * 0.9 * (upper - lower)
    middle = 0.5 * (lower + upper)
    w = 0.5 * velocity / a

    def states(t: Array) -> tuple[Array, Array, Array]:
        """Return q, dq, ddq (M, n) at the instants t (M,) [s]."""
        angle = np.outer(t, w)
        return (
            middle - a * np.cos(angle),
            a * w * np.sin(angle),
            a * w**2 * np.cos(angle),
        )

    return states


@dataclass(frozen=True)
class Commanded:
    """What every engine is to follow, worked out once for all of them."""

    #: The robot of n joints.
    robot: Robot
    #: (n, 10) standard parameters of the links [kg, kg m, kg m^2].
    links: Array
    #: Function of instants (M,) [s] that returns q, dq, ddq (M, n).
    motion: Course
    #: Length of the motion [s].
    duration: float
    #: Length of a step [s].
    step: float = 1e-3

    @cached_property
    def q(self) -> Array:
        """(N + 1, n) positions at the ends of the steps [rad, m]."""
        ends = np.arange(round(self.duration / self.step) + 1)
        return self.motion(ends * self.step)[0]

    @cached_property
    def t(self) -> Array:
        """(N,) middle of each step [s]."""
        return np.asarray((np.arange(len(self.q) - 1) + 0.5) * self.step, float)

    @cached_property
    def torque(self) -> Array:
        """(N, n) torque of the model in the middle of each step [N m, N]."""
        theta = np.asarray(self.links).ravel()
        return self.robot.inverse_dynamics(theta, *self.motion(self.t))

    @cached_property
    def poses(self) -> Array:
        """(N, 4, 4) of the last joint's frame at the end of each step."""
        return self.robot.poses(self.q[1:])[:, self.robot.n - 1]


def play(kind: type[Engine], commanded: Commanded) -> EngineRun:
    """Let a physics engine follow a motion, and compare its torque with the model's.

    The velocity commanded for a step is the motion's mean velocity over it, so that an
    engine that obeys ends each step exactly where the motion does.

    Parameters
    ----------
    commanded : Commanded
        The robot, its links, and the motion.

    Raises
    ------
    InputError
        If the engine rejects a link.
    """
    robot, links = commanded.robot, commanded.links
    engine = (program_version(), kind.name, kind.version())
    followed = load_or_compute(
        "engine",
        (*engine, robot.to_dict(), links, commanded.q, commanded.step),
        partial(_follow, kind, commanded),
    )
    torque = np.array(followed["torque"])
    return EngineRun(
        engine=kind.name,
        t=commanded.t,
        torque=torque,
        model=commanded.torque,
        error=torque - commanded.torque,
        position=np.array(followed["position"]),
        angle=np.array(followed["angle"]),
    )


def _follow(kind: type[Engine], commanded: Commanded) -> dict[str, Array]:
    """Simulate an engine that follows the commanded positions.

    Returns
    -------
    dict
        "torque" (N, n) [N m, N]; "position" [m] and "angle" [rad], (N,): how far the
        last joint's frame is from where the commands put it.
    """
    q, step = commanded.q, commanded.step
    torque, pose = kind(commanded.robot, commanded.links).follow(
        q[0], np.diff(q, axis=0) / step, step
    )
    commanded_poses = commanded.poses
    distance = np.linalg.norm(pose[:, :3, 3] - commanded_poses[:, :3, 3], axis=1)
    relative = np.swapaxes(commanded_poses[:, :3, :3], 1, 2) @ pose[:, :3, :3]
    turned = scipy.spatial.transform.Rotation.from_matrix(relative)
    return {"torque": torque, "position": distance, "angle": turned.magnitude()}


def inverse_dynamics_error(
    kind: type[Engine], robot: Robot, links: Array
) -> float | None:
    """Return the largest difference of torques between an engine and Pinocchio.

    It is taken over 100 random states: positions over the joint range; velocities and
    accelerations normal with standard deviations of 1 rad/s and 1 rad/s^2.

    Parameters
    ----------
    robot : Robot
        The kinematics: joints and their frames.
    links : (n, 10) array
        Standard parameters [kg, kg m, kg m^2].

    Returns
    -------
    float or None
        [N m]; None if the engine has no inverse dynamics.
    """
    q = robot.random_configurations(100, seed=0)
    dq, ddq = np.random.default_rng(0).normal(size=(2, 100, robot.n))
    torque = kind(robot, links).inverse_dynamics(q, dq, ddq)
    if torque is None:
        return None
    expected = robot.inverse_dynamics(np.asarray(links).ravel(), q, dq, ddq)
    return float(np.abs(torque - expected).max())


def sinusoidal_runs(study: Study) -> Played:
    """Let every engine follow sinusoidal velocities, with links from the simulated run.

    Parameters
    ----------
    study : Study
        The robot's data sets and every method's estimate, computed on demand.

    Returns
    -------
    Played
        A run for each engine, or why there is none.
    """
    motion = sinusoids(study.problem.robot)
    return _played(study, study.simulated, motion, study.effort.duration, 1e-3)


def measured_runs(study: Study) -> Played:
    """Let every engine follow the real run, with links identified from it.

    The error is the engine's torque plus identified friction minus measured torque,
    below the cut-off of the torque filter. The first 0.1 s, in which the engine
    accelerates from rest, are left out.

    Parameters
    ----------
    study : Study
        The robot's data sets and every method's estimate, computed on demand.

    Returns
    -------
    Played
        A run for each engine, or why there is none.
    """
    data = study.measured
    assert data is not None
    # Decimated: dense enough for splines through the positions.
    rows = FilteredRun(data.train, data.preprocessing).all_rows(data.model)
    friction_only = study.theta(METHOD, data).copy()
    friction_only[data.model.rigid_indices] = 0.0
    reference = rows.torque - predicted(rows, friction_only)
    t = rows.motion.t - rows.motion.t[0]
    spline = scipy.interpolate.CubicSpline(t, rows.motion.q)
    motion = lambda at: (spline(at), spline(at, 1), spline(at, 2))  # noqa: E731
    played = _played(study, data, motion, float(t[-1]), MEASURED_STEP)
    for kind, x in played.items():
        if not isinstance(x, str):
            # From rest to the run's velocity, within the first 0.1 s, is no motion of
            # the robot's.
            error = x.torque - interpolated(x.t, t, reference)
            played[kind] = replace(x, error=error[x.t > 0.1])
    return played


def _played(
    study: Study, data: Data, motion: Course, duration: float, step: float
) -> Played:
    """Let every engine follow a motion with the links identified from a data set.

    An engine that is not installed, or rejects a link, gets a sentence instead of a
    run.
    """
    links = study.links(METHOD, data)
    commanded = Commanded(study.problem.robot, links, motion, duration, step)
    out = Played()
    for name, kind in engine_types().items():
        if kind.version() is None:
            out[kind] = f"absent ({kind.install})"
            continue
        study.progress(f"engine {name}, {data.label} motion")
        try:
            out[kind] = play(kind, commanded)
        except InputError as error:
            out[kind] = f"rejected: {error}"
    return out


@register_table("V", "panda")
def engines(study: Study) -> StudyTable:
    """Table V: physics engines with the identified model, published ones and those at
    hand.

    Rows: the paper's engines inside V-REP, then each of ours on simulated and real
    motion.
    """
    n = study.problem.robot.n
    rows = []
    # The paper's table; it has no standard deviations.
    no_errors = by_joint([None] * n)
    no_deviations = by_joint([None] * n, "std_joint")
    for row in study.problem.published["table_V"]:
        about = {"motion": "published (V-REP)", **_NO_RUN, "status": "published"}
        rows.append({**row, **no_deviations, **about})
    # Pose errors that stand in the paper's text.
    for engine, pose in _PUBLISHED_POSE.items():
        figures = dict(zip(_NO_RUN, (*pose, None), strict=True))
        about = {"motion": "published (text)", **figures, "status": "published"}
        rows.append({"engine": engine, **no_errors, **no_deviations, **about})
    # Our runs: on sinusoids (simulated), and on the real run's motion if it is at hand.
    for data, runs in zip(study.whole, (sinusoidal_runs, measured_runs), strict=False):
        rows += [_row(study, data, kind, run) for kind, run in study.once(runs).items()]
    formulations = "; ".join(
        f"{name}: {kind.formulation}" for name, kind in engine_types().items()
    )
    table = StudyTable(
        f"Table V: physics engines with the identified {study.problem.title}",
        rows,
        notes("V", method=METHOD, step=1e3 * MEASURED_STEP, formulations=formulations),
        digits=3,
    )
    columns = ["engine", *no_errors, "motion", *_POSE_FIGURES]
    if any(row["status"] not in ("run", "published") for row in rows):
        columns.append("status")
    return table.shortened(columns)


#: Distance and rotation of the last joint's frame, mean and largest.
_POSE_FIGURES = (
    "position_mean_mm",
    "position_worst_mm",
    "angle_mean_deg",
    "angle_worst_deg",
)
_NO_RUN: Row = dict.fromkeys((*_POSE_FIGURES, "inverse_dynamics_error"))
#: Figures of the pose that stand in the paper's text, of all its engines and of ODE.
_PUBLISHED_POSE = {
    "all four": ("< 15", "91.3", "< 3", "180 (3.14 rad)"),
    "ODE": ("5", "", "1.2", ""),
}


def _row(study: Study, data: Data, kind: type[Engine], run: EngineRun | str) -> Row:
    """Return an engine's row: mean and standard deviation of its torque error for each
    joint [N m], errors of the last frame's position [mm] and orientation [degrees], and
    its status.

    ``run`` is the engine's run, or a sentence that says why there is none.
    """
    robot = study.problem.robot
    figures = _NO_RUN
    status = run
    means: Any = [None] * robot.n
    deviations = means
    if isinstance(run, EngineRun):
        inverse = inverse_dynamics_error(kind, robot, study.links(METHOD, data))
        far = 1e3 * run.position
        turned = np.rad2deg(run.angle)
        # In the order of _NO_RUN.
        pose = far.mean(), far.max(), turned.mean(), turned.max()
        both = (*map(float, pose), inverse)
        figures = dict(zip(_NO_RUN, both, strict=True))
        status = "run"
        means = list(map(np.mean, run.error.T))
        deviations = list(map(np.std, run.error.T))
    about = {"motion": data.label, **figures, "status": status}
    name = f"{kind.name} {kind.version() or ''}".rstrip()
    return {
        "engine": name,
        **by_joint(means),
        **by_joint(deviations, "std_joint"),
        **about,
    }
