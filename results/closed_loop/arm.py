"""An arm in MuJoCo under a controller at 1 kHz: what moves, and what its log shows.

The arm is the Panda with the links p_hat; rotors, friction and a spring are MuJoCo's own
(armature, frictionloss, damping, stiffness). Stribeck friction of one joint is applied
beside. Nothing of the package computes its motion.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from sdp_vs_penalty import Measurements, load_problem
from sdp_vs_penalty.exporters.content import Content
from sdp_vs_penalty.exporters.mjcf import make_mjcf
from sdp_vs_penalty.exporters.urdf import make_urdf
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.simulation.experiments import Experiment, experiment

Array = NDArray[np.float64]
#: Torque (n,) of the number of the instant, measured position and velocity.
Command = Callable[[int, Array, Array], Array]
N = 7
#: Of the controller, and of the simulation [s].
STEP, FINE = 1e-3, 5e-4
#: Gains of libfranka's example joint_impedance_control [N m/rad, N m s/rad]: its maker
#: chose them, before any model of this comparison.
KP = np.array([600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0])
KD = np.array([50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0])
#: The Panda's torque limits [N m].
LIMITS = np.array([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0])
#: One step of an encoder of 18 bits [rad].
ENCODER = 2.0 * np.pi / 2**18
#: Cut-off of the velocity, which is a difference of encoder positions [Hz].
VELOCITY_CUTOFF = 50.0
#: Time for which the arm is held at the first pose before a motion begins [s].
SETTLE = 1.0
#: The flange in the last link's frame [m].
FLANGE = np.array([0.0, 0.0, 0.107])
#: Velocity at which the Stribeck friction has fallen to 1/e [rad/s].
STRIBECK_VELOCITY = 0.1
#: What a file's placeholders say of every link: a sphere of 1 kg and 5 cm at its joint.
PLACEHOLDER = np.array([1.0, 0, 0, 0, 1e-3, 0, 1e-3, 0, 0, 1e-3])


class Trajectory(Protocol):
    """A motion that begins and ends at rest."""

    @property
    def duration(self) -> float:
        """Length [s]."""

    def states(self, t: Array) -> tuple[Array, Array, Array]:
        """Return q, dq and ddq (N, n) at instants t (N,)."""


@cache
def known() -> Experiment:
    """The Panda's simulated experiment: links p_hat, the sensors' noise."""
    return experiment(load_problem("panda"))


def smoothed(values: Array, cutoff: float) -> Array:
    """Return (N, n) samples of the controller behind a causal low-pass of first order,
    from zero."""
    share = 1.0 - np.exp(-2.0 * np.pi * cutoff * STEP)
    return np.asarray(lfilter([share], [1.0, share - 1.0], values, axis=0))


def user_urdf(links: Array) -> bytes:
    """Return a URDF with these links (n, 10) and nothing of friction."""
    return make_urdf(known().problem.robot, _content(links))


def _content(links: Array, **parts: Array) -> Content:
    robot = known().problem.robot
    about_joints = [
        inertia.transform(joint.link_frame) @ link
        for joint, link in zip(robot.joints, links, strict=True)
    ]
    return Content.of_links(robot, np.stack(about_joints), **parts)


@dataclass(frozen=True)
class Reference:
    """What a controller is to follow at each of its instants, after SETTLE at rest."""

    #: (N,) instants [s].
    t: Array
    #: (N, n) positions [rad].
    q: Array
    #: (N, n) velocities [rad/s].
    dq: Array
    #: (N, n) accelerations [rad/s^2].
    ddq: Array

    @classmethod
    def along(cls, motion: Trajectory) -> "Reference":
        """Return a motion's states at the controller's instants."""
        t = np.arange(round((SETTLE + motion.duration) / STEP)) * STEP
        return cls(t, *motion.states(np.maximum(t - SETTLE, 0.0)))

    @property
    def moving(self) -> slice:
        """The samples after SETTLE."""
        return slice(round(SETTLE / STEP), None)


@dataclass(frozen=True)
class Push:
    """A force on the flange from an instant on."""

    #: Begin [s].
    start: float
    #: Length [s].
    seconds: float
    #: (3,) force in the base's frame [N].
    force: Array


@dataclass(frozen=True)
class Log:
    """What the controller saw and did, and the truth, at 1 kHz."""

    #: What was to be followed.
    reference: Reference
    #: (N, n) positions of the encoders [rad].
    q: Array
    #: (N, n) velocities, as the controller has them [rad/s].
    dq: Array
    #: (N, n) measured torques [N m].
    tau: Array
    #: (N, n) true positions [rad].
    true_q: Array
    #: Whether a joint was 0.5 rad off, where the run was stopped.
    diverged: bool

    @property
    def error(self) -> Array:
        """Reference less true position (K, n) while the arm moves [rad]."""
        return (self.reference.q - self.true_q)[self.reference.moving]

    def measurements(self, name: str, every: int = 4) -> Measurements:
        """Return the log as a user has it: every fourth sample, 250 Hz."""
        rows = slice(round(SETTLE / STEP), None, every)
        return Measurements(
            self.reference.t[rows] - SETTLE, self.q[rows], self.tau[rows], names=(name,)
        )


@dataclass(frozen=True)
class Arm:
    """The true arm of a draw."""

    #: (n,) viscous friction [N m s/rad].
    damping: Array
    #: (n,) dry friction [N m].
    friction: Array
    #: (n,) inertia of the rotors [kg m^2].
    armature: Array
    #: (n,) stiffness of springs about zero [N m/rad]; of one joint.
    stiffness: Array
    #: (n,) Stribeck friction [N m]; of one joint.
    stribeck: Array

    @classmethod
    def drawn(cls, number: int) -> "Arm":
        """Return the arm of a draw: spring and Stribeck friction are on two of the first
        four joints."""
        rng = np.random.default_rng([number, 1])
        of_motor = np.array([1.0, 1.0, 1.0, 1.0, 0.4, 0.4, 0.4])
        spring, stribeck = rng.permutation(4)[:2]
        one = np.eye(N)
        return cls(
            damping=rng.uniform(0.3, 1.0, N) * of_motor,
            friction=rng.uniform(0.5, 1.5, N) * of_motor,
            armature=rng.uniform(0.05, 0.2, N) * of_motor,
            stiffness=rng.uniform(3.0, 6.0) * one[spring],
            stribeck=rng.uniform(0.5, 1.5) * one[stribeck],
        )

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The arm in MuJoCo, which runs into no end stop."""
        parts = ("damping", "friction", "armature", "stiffness")
        content = _content(
            known().links, **{name: getattr(self, name) for name in parts}
        )
        text = make_mjcf(known().problem.robot, content).decode()
        model = mujoco.MjModel.from_xml_string(text)
        model.opt.timestep = FINE
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        model.jnt_limited[:] = False
        return model

    def run(
        self,
        reference: Reference,
        command: Command,
        seed: tuple[int, ...],
        pushes: tuple[Push, ...] = (),
    ) -> Log:
        """Run a controller. It sees encoder steps; the log has the real Panda's torque
        noise."""
        model, data = self.model, mujoco.MjData(self.model)
        data.qpos[:] = reference.q[0]
        count = len(reference.t)
        q, dq, tau, true = (np.zeros((count, N)) for _ in range(4))
        share = 1.0 - np.exp(-2.0 * np.pi * VELOCITY_CUTOFF * STEP)
        j = int(np.argmax(self.stribeck))
        before, speed = np.round(reference.q[0] / ENCODER) * ENCODER, np.zeros(N)
        waiting, diverged = list(pushes), False
        on_joints = np.zeros(N)
        for k in range(count):
            true[k] = data.qpos
            q[k] = np.round(data.qpos / ENCODER) * ENCODER
            speed = speed + share * ((q[k] - before) / STEP - speed)
            before, dq[k] = q[k], speed
            if not np.abs(reference.q[k] - true[k]).max() < 0.5:
                diverged = True
                break
            torque = command(k, q[k], speed)
            torque = np.minimum(np.maximum(torque, -LIMITS), LIMITS)
            tau[k] = torque
            if waiting and reference.t[k] >= waiting[0].start:
                push = waiting[0]
                on_joints[:] = 0.0
                if reference.t[k] < push.start + push.seconds:
                    body = model.nbody - 1
                    point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ FLANGE
                    none = np.zeros(3)
                    mujoco.mj_applyFT(
                        model, data, push.force, none, point, body, on_joints
                    )
                else:
                    waiting.pop(0)
                torque = torque + on_joints
            for _ in range(round(STEP / FINE)):
                v = data.qvel[j]
                rub = np.exp(-((v / STRIBECK_VELOCITY) ** 2)) * np.tanh(v / 0.01)
                data.qfrc_applied[:] = torque
                data.qfrc_applied[j] -= self.stribeck[j] * rub
                mujoco.mj_step(model, data)
        noise = known().sensor.noise(count, np.random.default_rng(seed))
        return Log(reference, q, dq, tau + noise, true, diverged)


def pd(reference: Reference, feedforward: Array | None = None) -> Command:
    """Return a PD controller, with torque (N, n) added that was computed before."""
    added = np.zeros_like(reference.q) if feedforward is None else feedforward

    def command(k: int, q: Array, dq: Array) -> Array:
        feedback = KP * (reference.q[k] - q) + KD * (reference.dq[k] - dq)
        return np.asarray(added[k] + feedback)

    return command
