"""MuJoCo (Todorov, Erez, Tassa, IROS 2012): generalised coordinates."""

from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.exporters.mjcf import make_mjcf
from sdp_vs_penalty.simulation.engines.engine import Array, Engine


class MuJoCo(Engine):
    """Loaded from our MJCF. It has no kinematic motor: in each step its own inverse
    dynamics (in discrete time) gives the torque that reaches the commanded velocity,
    and its forward dynamics moves the robot with that torque."""

    name = "MuJoCo"
    package = "mujoco"
    formulation = "generalised coordinates, semi-implicit Euler"

    def load(self) -> None:
        """Load the robot into MuJoCo from MJCF text, without contacts and joint
        damping.

        Its inverse dynamics is set to discrete time, so that it reaches a velocity
        exactly.
        """
        import mujoco

        text = make_mjcf(self.robot, self.content).decode()
        try:
            self.model: Any = mujoco.MjModel.from_xml_string(text)
        except ValueError as error:
            what = f"MuJoCo rejects the robot {self.robot.name}: {error}"
            raise InputError(what, "leave that engine out") from error
        flags = mujoco.mjtDisableBit
        self.model.opt.disableflags |= flags.mjDSBL_CONSTRAINT | flags.mjDSBL_EULERDAMP
        self.model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
        self.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_INVDISCRETE
        self.data: Any = mujoco.MjData(self.model)

    def torque(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the torque (n,) [N m, N] that MuJoCo's inverse dynamics gives for one
        state (n,) of positions, velocities and accelerations."""
        import mujoco

        self.data.qpos = q
        self.data.qvel = dq
        self.data.qacc = ddq
        mujoco.mj_inverse(self.model, self.data)
        return np.array(self.data.qfrc_inverse)

    def begin(self, start: Array, step: float) -> None:
        """Put the joints at rest at ``start`` (n,) [rad, m]; later steps last
        ``step`` [s].
        """
        import mujoco

        self.model.opt.timestep = step
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos = start

    def stepped(self, velocity: Array) -> tuple[Array, Array, Array]:
        """Simulate one step with the torque that reaches ``velocity`` (n,) [rad/s,
        m/s].

        Returns that torque (n,) [N m, N], and rotation (3, 3) and position (3,) [m] of
        the last link's joint frame.
        """
        import mujoco

        model = self.model
        data = self.data
        acceleration = (velocity - data.qvel) / model.opt.timestep
        data.qfrc_applied = torque = self.torque(data.qpos, data.qvel, acceleration)
        mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        return torque, data.xmat[-1].reshape(3, 3), data.xpos[-1]
