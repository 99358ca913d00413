"""DART (Lee et al., J. Open Source Software 2018): generalised coordinates, Lie group
formulation."""

from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.exporters.urdf import make_urdf
from sdp_vs_penalty.simulation.engines.engine import Array, Engine


class Dart(Engine):
    """Loaded from our URDF; joints are of the actuator type VELOCITY in its hybrid
    dynamics."""

    name = "DART"
    package = "dartpy"
    formulation = "generalised coordinates, semi-implicit Euler"

    def load(self) -> None:
        """Load the robot into DART from URDF text, fixed to the world and without joint
        limits; InputError if DART rejects it."""
        import dartpy

        loader = dartpy.utils.DartLoader()
        options = loader.getOptions()
        options.mDefaultRootJointType = dartpy.utils.DartLoaderRootJointType.FIXED
        loader.setOptions(options)
        text = make_urdf(self.robot, self.content).decode()
        self.skeleton: Any = loader.parseSkeletonString(text, "")
        if self.skeleton is None:
            raise InputError(
                f"DART rejects the robot {self.robot.name}", "leave that engine out"
            )
        self.world: Any = dartpy.simulation.World()
        self.world.addSkeleton(self.skeleton)
        self.world.setGravity(np.array(self.robot.gravity))
        for k in range(self.skeleton.getNumJoints()):
            self.skeleton.getJoint(k).setLimitEnforcement(False)

    def torque(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the torque (n,) [N m, N] that DART's inverse dynamics gives for one
        state (n,) of positions, velocities and accelerations."""
        self.skeleton.setPositions(q)
        self.skeleton.setVelocities(dq)
        self.skeleton.setAccelerations(ddq)
        self.skeleton.computeInverseDynamics(False, False, False)
        return np.array(self.skeleton.getForces())

    def begin(self, start: Array, step: float) -> None:
        """Put the joints at rest at ``start`` (n,) [rad, m]; later steps last ``step``
        [s].

        Every joint follows commanded velocities (DART's actuator type VELOCITY).
        """
        import dartpy

        for k in range(self.skeleton.getNumJoints()):
            if self.skeleton.getJoint(k).getNumDofs():
                self.skeleton.getJoint(k).setActuatorType(
                    dartpy.dynamics.ActuatorType.VELOCITY
                )
        self.world.setTimeStep(step)
        self.skeleton.setPositions(start)
        self.skeleton.setVelocities(np.zeros(self.robot.n))

    def stepped(self, velocity: Array) -> tuple[Array, Array, Array]:
        """Simulate one step at the commanded ``velocity`` (n,) [rad/s, m/s].

        Returns the motors' torque (n,) [N m, N], and rotation (3, 3) and position (3,)
        [m] of the last link's joint frame.
        """
        self.skeleton.setCommands(velocity)
        self.world.step(False)
        pose = (
            self.skeleton.getBodyNode(f"link{self.robot.n}")
            .getWorldTransform()
            .matrix()
        )
        return np.array(self.skeleton.getForces()), pose[:3, :3], pose[:3, 3]
