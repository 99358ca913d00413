"""Bullet (Coumans) through PyBullet: generalised coordinates, impulses at velocity
level."""

import ctypes
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.exporters.urdf import make_urdf
from sdp_vs_penalty.simulation.engines.engine import Array, Engine


class Bullet(Engine):
    """Loaded from our URDF with URDF_USE_INERTIA_FROM_FILE, without which it makes up
    inertias from collision shapes; velocity motors."""

    name = "Bullet"
    package = "pybullet"
    formulation = "generalised coordinates (Featherstone), sequential impulses"
    install = "pip install pybullet (wheels exist for Python before 3.12)"

    def load(self) -> None:
        """Load the robot into Bullet through a URDF file, without damping and joint
        limits.
        """
        with _silence():
            import pybullet
            from pybullet_utils.bullet_client import BulletClient

            self.bullet: Any = BulletClient(pybullet.DIRECT)  # disconnects when it goes
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder, "robot.urdf")
                path.write_bytes(make_urdf(self.robot, self.content))
                self.body = self.bullet.loadURDF(
                    str(path),
                    useFixedBase=True,
                    flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
                )
        # Bullet damps every body and joint by default.
        free = dict.fromkeys(("linearDamping", "angularDamping", "jointDamping"), 0.0)
        free |= {
            "jointLowerLimit": 1.0,  # above the upper limit: no limits
            "jointUpperLimit": -1.0,
            "maxJointVelocity": 1e6,
        }
        for k in range(-1, self.robot.n):  # -1 is the base
            self.bullet.changeDynamics(self.body, k, **free)
        self.bullet.setGravity(*self.robot.gravity)

    def torque(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the torque (n,) [N m, N] that Bullet's inverse dynamics gives for one
        state (n,) of positions, velocities and accelerations."""
        states = (x.tolist() for x in (q, dq, ddq))
        return np.array(self.bullet.calculateInverseDynamics(self.body, *states))

    def begin(self, start: Array, step: float) -> None:
        """Put the joints at rest at ``start`` (n,) [rad, m]; later steps last
        ``step`` [s].
        """
        self.bullet.setTimeStep(step)
        for j in range(self.robot.n):
            self.bullet.resetJointState(self.body, j, start[j], 0.0)

    def stepped(self, velocity: Array) -> tuple[Array, Array, Array]:
        """Simulate one step with velocity motors at ``velocity`` (n,) [rad/s, m/s].

        Returns the motors' torque (n,) [N m, N], and rotation (3, 3) and position (3,)
        [m] of the last link's joint frame.
        """
        bullet = self.bullet
        joints = list(range(self.robot.n))
        motor_options = {
            "targetVelocities": velocity.tolist(),
            "forces": [np.inf] * len(joints),
        }
        bullet.setJointMotorControlArray(
            self.body, joints, bullet.VELOCITY_CONTROL, **motor_options
        )
        bullet.stepSimulation()
        # Bullet returns tuples: entry 3 of a joint's state is its motor torque, entries
        # 4 and 5 of a link's state are position and quaternion of its joint frame.
        torque = np.array(
            [state[3] for state in bullet.getJointStates(self.body, joints)]
        )
        link = bullet.getLinkState(self.body, joints[-1], computeForwardKinematics=1)
        return (
            torque,
            np.reshape(bullet.getMatrixFromQuaternion(link[5]), (3, 3)),
            link[4],
        )


@contextmanager
def _silence() -> Iterator[None]:
    """Discard what Bullet's C code prints, which bypasses Python's sys.stdout.

    The file descriptors 1 and 2 are redirected, and restored at the end.
    """
    saved = [os.dup(1), os.dup(2)]
    try:
        with open(os.devnull, "w") as sink:
            os.dup2(sink.fileno(), 1)
            os.dup2(sink.fileno(), 2)
            yield
    finally:
        ctypes.CDLL(None).fflush(None)
        for number, original in zip((1, 2), saved, strict=True):
            os.dup2(original, number)
            os.close(original)
