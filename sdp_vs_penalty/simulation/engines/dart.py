"""DART (Lee et al., J. Open Source Software 2018): generalised coordinates, Lie group formulation."""

from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.exporters.urdf import make_urdf
from sdp_vs_penalty.simulation.engines.engine import Array, Engine, Followed, module_version


class Dart(Engine):
    """Loaded from our URDF; joints are of the actuator type VELOCITY in its hybrid dynamics."""

    name = "DART"
    formulation = "generalised coordinates, semi-implicit Euler"

    @classmethod
    def version(cls) -> str | None:
        return module_version("dartpy")

    def load(self) -> None:
        import dartpy

        loader = dartpy.utils.DartLoader()
        options = loader.getOptions()
        options.mDefaultRootJointType = dartpy.utils.DartLoaderRootJointType.FIXED
        loader.setOptions(options)
        text = make_urdf(self.robot, self.content).decode()
        self.skeleton: Any = loader.parseSkeletonString(text, "")
        if self.skeleton is None:
            raise InputError(f"DART rejects the robot {self.robot.name}", "leave that engine out")
        self.world: Any = dartpy.simulation.World()
        self.world.addSkeleton(self.skeleton)
        self.world.setGravity(np.array(self.robot.gravity))
        for k in range(self.skeleton.getNumJoints()):
            self.skeleton.getJoint(k).setLimitEnforcement(False)

    def inverse_dynamics(self, q: Array, dq: Array, ddq: Array) -> Array:
        out = np.empty_like(q)
        for k in range(len(q)):
            self.skeleton.setPositions(q[k])
            self.skeleton.setVelocities(dq[k])
            self.skeleton.setAccelerations(ddq[k])
            self.skeleton.computeInverseDynamics(False, False, False)
            out[k] = self.skeleton.getForces()
        return out

    def follow(self, start: Array, velocities: Array, step: float) -> Followed:
        import dartpy

        skeleton, last = self.skeleton, self.skeleton.getBodyNode(f"link{self.robot.n}")
        for k in range(skeleton.getNumJoints()):
            if skeleton.getJoint(k).getNumDofs():
                skeleton.getJoint(k).setActuatorType(dartpy.dynamics.ActuatorType.VELOCITY)
        self.world.setTimeStep(step)
        skeleton.setPositions(start)
        skeleton.setVelocities(np.zeros(self.robot.n))
        torque = np.empty_like(velocities)
        pose = np.empty((len(velocities), 4, 4))
        for k, velocity in enumerate(velocities):
            skeleton.setCommands(velocity)
            self.world.step(False)
            torque[k] = skeleton.getForces()
            pose[k] = last.getWorldTransform().matrix()
        return Followed(step, torque, pose)
