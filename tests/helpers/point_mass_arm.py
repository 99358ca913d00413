"""A yaw-pitch-pitch arm of point masses, written for the tests of the diagnosis.

It shares nothing with the library: d'Alembert's principle on masses whose
accelerations are central differences of their places. Torque [N m], angles [rad].
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from sdp_vs_penalty import Measurements, load_problem

Array = np.ndarray

#: Height of the shoulder and length of the upper arm [m].
SHOULDER = 0.3
UPPER_ARM = 0.4
#: Point masses [kg]: link (from 0), and place in the link's frame [m].
MASSES = (
    (0, (0.1, 0.0, 0.1), 4.0),
    (1, (0.2, 0.02, 0.0), 5.0),
    (1, (0.3, 0.0, 0.05), 1.0),
    (2, (0.2, 0.0, 0.02), 3.0),
    (2, (0.1, 0.03, 0.0), 1.0),
)
VISCOUS = np.array([2.0, 1.5, 0.8])
COULOMB = np.array([1.5, 1.2, 0.7])
#: Seconds over which a motion repeats.
PERIOD = 10.0
RATE = 200.0


def write_urdf(path):
    """The arm's kinematics, with links of rough inertia."""
    frames = (
        ("0 0 0", "0 0 1"),
        (f"0 0 {SHOULDER}", "0 1 0"),
        (f"{UPPER_ARM} 0 0", "0 1 0"),
    )
    parts = ['<robot name="point_masses">', '<link name="link0"/>']
    for k, (origin, axis) in enumerate(frames, start=1):
        parts.append(
            f'<link name="link{k}"><inertial><origin xyz="0.15 0 0.02"/>'
            '<mass value="4"/><inertia ixx="0.05" ixy="0" ixz="0" iyy="0.1" iyz="0"'
            ' izz="0.1"/></inertial></link>'
            f'<joint name="joint{k}" type="revolute"><parent link="link{k - 1}"/>'
            f'<child link="link{k}"/><origin xyz="{origin}"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" velocity="5" effort="150"/></joint>'
        )
    path.write_text("\n".join([*parts, "</robot>"]))
    return path


def rotations(angle, axis):
    """(N, 3, 3) rotations about z (2) or y (1)."""
    c = np.cos(angle)
    s = np.sin(angle)
    out = np.zeros((len(angle), 3, 3))
    out[:, axis, axis] = 1.0
    first, second = (0, 1) if axis == 2 else (2, 0)
    out[:, first, first] = out[:, second, second] = c
    out[:, second, first] = s
    out[:, first, second] = -s
    return out


@dataclass(frozen=True)
class Kinematics:
    """rotation, origin, axis : by joint, each (N, 3, 3) or (N, 3)."""

    rotation: list[Array]
    origin: list[Array]
    axis: list[Array]

    @classmethod
    def of(cls, q):
        first = rotations(q[:, 0], 2)
        second = first @ rotations(q[:, 1], 1)
        third = second @ rotations(q[:, 2], 1)
        shoulder = np.tile([0.0, 0.0, SHOULDER], (len(q), 1))
        elbow = shoulder + second @ [UPPER_ARM, 0.0, 0.0]
        return cls(
            [first, second, third],
            [0.0 * shoulder, shoulder, elbow],
            [first[:, :, 2], second[:, :, 1], third[:, :, 1]],
        )

    def place(self, link, offset):
        """(N, 3) where a point of a link is."""
        return self.origin[link] + self.rotation[link] @ np.array(offset)


@dataclass(frozen=True)
class Trajectory:
    """Sums of sines that repeat after PERIOD; amplitude, phase (harmonics, 3)."""

    harmonics: Array
    amplitude: Array
    phase: Array

    @classmethod
    def draw(cls, seed):
        rng = np.random.default_rng(seed)
        harmonics = np.array([1, 2, 3, 5])
        amplitude = rng.uniform(0.3, 1.0, (4, 3)) / harmonics[:, None]
        amplitude *= np.array([1.0, 0.6, 0.9]) / amplitude.sum(axis=0)
        return cls(harmonics, amplitude, rng.uniform(0.0, 2.0 * np.pi, (4, 3)))

    def at(self, t):
        """(N, 3) positions."""
        turned = 2.0 * np.pi / PERIOD * t[:, None, None] * self.harmonics[:, None]
        return np.sum(self.amplitude * np.sin(turned + self.phase), axis=1)


@dataclass(frozen=True)
class PointMassArm:
    """tilt [rad] : of the base about x; masses : as MASSES; spring : on each joint
    [N m/rad]; bristle_travel : by joint over which Coulomb friction turns round [rad],
    0 where it does so at once; channel : what the torque channels make of the torque
    (N, 3) at instants (N,); extra : torque (N, 3) of instants, positions and velocities."""

    tilt: float = 0.0
    masses: tuple[tuple[int, tuple[float, float, float], float], ...] = MASSES
    spring: Array = field(default_factory=lambda: np.zeros(3))
    bristle_travel: Array = field(default_factory=lambda: np.zeros(3))
    channel: Callable[[Array, Array], Array] = lambda t, torque: torque
    extra: Callable[[Array, Array, Array], Array] = lambda t, q, dq: 0.0 * q

    def run(self, seed, periods=3, noise=(0.05, 0.05, 0.03)):
        """A log of one motion of its seed."""
        trajectory = Trajectory.draw(seed)
        t = np.arange(round(periods * PERIOD * RATE)) / RATE
        torque = self.torque(trajectory, t)
        torque = self.channel(t, torque)
        rng = np.random.default_rng(seed + 1000)
        torque = torque + rng.normal(size=torque.shape) * noise
        q = trajectory.at(t) + 1e-6 * rng.normal(size=torque.shape)
        return Measurements(t, q, torque)

    def torque(self, trajectory, t):
        """(N, 3) of links, friction and springs."""
        h = 1e-3
        before = Kinematics.of(trajectory.at(t - h))
        now = Kinematics.of(q := trajectory.at(t))
        after = Kinematics.of(trajectory.at(t + h))
        gravity = 9.81 * np.array([0.0, np.sin(self.tilt), -np.cos(self.tilt)])
        torque = q * self.spring
        for link, offset, mass in self.masses:
            place = now.place(link, offset)
            twice = before.place(link, offset) + after.place(link, offset)
            force = mass * ((twice - 2.0 * place) / h**2 - gravity)
            for j in range(link + 1):
                arm = np.cross(now.axis[j], place - now.origin[j])
                torque[:, j] += np.sum(arm * force, axis=1)
        dq = (trajectory.at(t + h) - trajectory.at(t - h)) / (2.0 * h)
        friction = VISCOUS * dq + COULOMB * self.direction(q, dq)
        return torque + friction + self.extra(t, q, dq)

    def direction(self, q, dq):
        """(N, 3) of dry friction: Dahl's bristles where a joint has them."""
        out = np.tanh(dq / 0.01)
        for j in np.flatnonzero(self.bristle_travel):
            state = 0.0
            for k, step in enumerate(np.diff(q[:, j], prepend=q[0, j])):
                target = np.sign(step)
                decay = np.exp(-abs(step) / self.bristle_travel[j])
                state = target + (state - target) * decay
                out[k, j] = state
        return out


def delayed(seconds):
    """A channel that logs torque later, by joint."""
    by_joint = np.broadcast_to(seconds, 3)

    def channel(t, torque):
        columns = [
            np.interp(t - late, t, x)
            for late, x in zip(by_joint, torque.T, strict=True)
        ]
        return np.column_stack(columns)

    return channel


def causal_filter(hertz):
    """A channel with one causal pole."""

    def channel(t, torque):
        decay = np.exp(-2.0 * np.pi * hertz * (t[1] - t[0]))
        out = torque.copy()
        for k in range(1, len(t)):
            out[k] = decay * out[k - 1] + (1.0 - decay) * torque[k]
        return out

    return channel


def scaled(gains):
    """Channels that read so many times the torque."""
    return lambda t, torque: torque * np.array(gains)


def arm_problem(folder):
    """The arm as its users describe it."""
    return load_problem(write_urdf(folder / "point_masses.urdf"))
