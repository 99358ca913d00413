"""Bullet (Coumans) through PyBullet: generalised coordinates, impulses at velocity level."""

from __future__ import annotations

import ctypes
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from sdp_vs_penalty.exporters.urdf import make_urdf
from sdp_vs_penalty.simulation.engines.engine import STRONG, Array, Engine, Followed


class Bullet(Engine):
    """Loaded from our URDF with URDF_USE_INERTIA_FROM_FILE, without which it makes up inertias from
    collision shapes; velocity motors."""

    name = "Bullet"
    formulation = "generalised coordinates (Featherstone), sequential impulses"
    install = "pip install pybullet (wheels exist for Python before 3.12)"

    @classmethod
    def version(cls) -> str | None:
        try:
            with _silence():
                import pybullet
        except ImportError:
            return None
        from importlib.metadata import PackageNotFoundError, version

        try:
            return version("pybullet")
        except PackageNotFoundError:
            return str(pybullet.getAPIVersion())

    def load(self) -> None:
        with _silence():
            import pybullet

            self.bullet: Any = pybullet
            self.client = pybullet.connect(pybullet.DIRECT)
            with tempfile.TemporaryDirectory() as folder:
                path = os.path.join(folder, "robot.urdf")
                with open(path, "wb") as file:
                    file.write(make_urdf(self.robot, self.content))
                self.body = pybullet.loadURDF(
                    path,
                    useFixedBase=True,
                    flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
                    physicsClientId=self.client,
                )
        for k in range(-1, self.robot.n):
            # Bullet damps every body and joint by default.
            pybullet.changeDynamics(
                self.body,
                k,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                jointLowerLimit=1.0,
                jointUpperLimit=-1.0,
                maxJointVelocity=1e6,
                physicsClientId=self.client,
            )
        pybullet.setGravity(*self.robot.gravity, physicsClientId=self.client)

    def inverse_dynamics(self, q: Array, dq: Array, ddq: Array) -> Array:
        return np.array(
            [
                self.bullet.calculateInverseDynamics(
                    self.body, *(row.tolist() for row in rows), physicsClientId=self.client
                )
                for rows in zip(q, dq, ddq, strict=True)
            ]
        )

    def follow(self, start: Array, velocities: Array, step: float) -> Followed:
        bullet, client = self.bullet, self.client
        joints = list(range(self.robot.n))
        bullet.setTimeStep(step, physicsClientId=client)
        for j in joints:
            bullet.resetJointState(self.body, j, start[j], 0.0, physicsClientId=client)
        torque = np.empty_like(velocities)
        pose = np.tile(np.eye(4), (len(velocities), 1, 1))
        for k, velocity in enumerate(velocities):
            bullet.setJointMotorControlArray(
                self.body,
                joints,
                bullet.VELOCITY_CONTROL,
                targetVelocities=velocity.tolist(),
                forces=[STRONG] * len(joints),
                physicsClientId=client,
            )
            bullet.stepSimulation(physicsClientId=client)
            states = bullet.getJointStates(self.body, joints, physicsClientId=client)
            torque[k] = [state[3] for state in states]
            link = bullet.getLinkState(
                self.body, joints[-1], computeForwardKinematics=1, physicsClientId=client
            )
            pose[k, :3, 3] = link[4]
            pose[k, :3, :3] = np.reshape(bullet.getMatrixFromQuaternion(link[5]), (3, 3))
        return Followed(step, torque, pose)

    def __del__(self) -> None:
        if hasattr(self, "client"):
            self.bullet.disconnect(physicsClientId=self.client)


@contextmanager
def _silence() -> Iterator[None]:
    """Bullet's C code prints its build time and remarks on the console, past Python's sys.stdout."""
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
