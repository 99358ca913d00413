"""MuJoCo (Todorov, Erez, Tassa, IROS 2012): generalised coordinates."""

import re
from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError, install_command
from sdp_vs_penalty.exporters.mjcf import make_mjcf
from sdp_vs_penalty.simulation.engines.engine import Array, Engine, Followed, module_version


class MuJoCo(Engine):
    """Loaded from our MJCF. It has no kinematic motor: over each step acts the torque with which its
    own inverse dynamics (in discrete time) reaches the commanded velocity, and its forward dynamics
    moves the robot."""

    name = "MuJoCo"
    install = f"{install_command('engines')}; 3.14 or newer: older ones ignore inertial rpy"
    formulation = "generalised coordinates, semi-implicit Euler"

    @classmethod
    def version(cls) -> str | None:
        found = module_version("mujoco")
        # Before 3.14 the orientation of a URDF's inertial is ignored.
        new = found is not None and [int(word) for word in re.findall(r"\d+", found)[:2]] >= [3, 14]
        return found if new else None

    def load(self) -> None:
        import mujoco

        text = make_mjcf(self.robot, self.content).decode()
        try:
            self.model: Any = mujoco.MjModel.from_xml_string(text)
        except ValueError as error:
            raise InputError(
                f"MuJoCo rejects the robot {self.robot.name}: {error}", "leave that engine out"
            ) from error
        flags = mujoco.mjtDisableBit
        self.model.opt.disableflags |= flags.mjDSBL_CONSTRAINT | flags.mjDSBL_EULERDAMP
        self.model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
        self.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_INVDISCRETE
        self.data: Any = mujoco.MjData(self.model)

    def inverse_dynamics(self, q: Array, dq: Array, ddq: Array) -> Array:
        import mujoco

        out = np.empty_like(q)
        for k in range(len(q)):
            self.data.qpos, self.data.qvel, self.data.qacc = q[k], dq[k], ddq[k]
            mujoco.mj_inverse(self.model, self.data)
            out[k] = self.data.qfrc_inverse
        return out

    def follow(self, start: Array, velocities: Array, step: float) -> Followed:
        import mujoco

        model, data = self.model, self.data
        model.opt.timestep = step
        mujoco.mj_resetData(model, data)
        data.qpos = start
        torque = np.empty_like(velocities)
        pose = np.tile(np.eye(4), (len(velocities), 1, 1))
        for k, velocity in enumerate(velocities):
            data.qacc = (velocity - data.qvel) / step
            mujoco.mj_inverse(model, data)
            torque[k] = data.qfrc_applied = data.qfrc_inverse
            mujoco.mj_step(model, data)
            mujoco.mj_kinematics(model, data)
            pose[k, :3, :3] = data.xmat[-1].reshape(3, 3)
            pose[k, :3, 3] = data.xpos[-1]
        return Followed(step, torque, pose)
