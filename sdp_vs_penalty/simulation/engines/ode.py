"""Open Dynamics Engine (Smith): maximal coordinates, the one formulation here that is
really different.

Every link is a free body with six degrees of freedom; joints are constraints whose
forces a linear complementarity solver finds. Nothing keeps the joints together but
these forces, so that they drift apart and are pulled back (error reduction parameter).
Debian's package libode8 is called through its C interface; it has no loader of URDF, so
that bodies and joints are made here.
"""

import ctypes
import ctypes.util
from collections.abc import Callable
from contextlib import suppress
from ctypes import (
    POINTER,
    Structure,
    byref,
    c_char_p,
    c_double,
    c_int,
    c_uint,
    c_void_p,
)
from functools import cache, partial
from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.simulation.engines.engine import Array, Engine


class _Mass(Structure):
    """dMass: mass, centre (dVector3), inertia (dMatrix3)."""

    _fields_ = [("mass", c_double), ("c", c_double * 4), ("I", c_double * 12)]


class _Feedback(Structure):
    """dJointFeedback: force and torque of a joint on its first and second body."""

    _fields_ = [(name, c_double * 4) for name in ("f1", "t1", "f2", "t2")]


#: The C types of the letters in :data:`_SIGNATURES`.
_TYPES: dict[str, Any] = {"-": None, "p": c_void_p, "i": c_int, "d": c_double}
_TYPES |= {"D": POINTER(c_double), "M": POINTER(_Mass), "F": POINTER(_Feedback)}
#: dParamFMax and dParamVel of ode/common.h: largest force and velocity of a motor.
_MAX_FORCE = 5
_VELOCITY = 2
#: The C functions that are used, by signature: the letter of the returned type, then
#: those of the arguments.
_SIGNATURES = {
    "p": "dWorldCreate",
    "pp": "dBodyCreate",
    "ppp": "dJointCreateHinge dJointCreateSlider",
    "-p": "dWorldDestroy",
    "-pddd": "dWorldSetGravity dBodySetPosition dJointSetHingeAxis dJointSetSliderAxis "
    "dJointSetHingeAnchor",
    "-pid": "dJointSetHingeParam dJointSetSliderParam",
    "ipd": "dWorldStep",
    "Dp": "dBodyGetPosition dBodyGetRotation",
    "-pD": "dBodySetRotation",
    "-pM": "dBodySetMass",
    "-Mdddddddddd": "dMassSetParameters",
    "iM": "dMassCheck",
    "-ppp": "dJointAttach",
    "-pF": "dJointSetFeedback",
}


@cache
def _library() -> Any | None:
    """Return the C library libode with the signatures of its functions set.

    None if it is not installed, or computes in single precision.
    """
    library_found = None
    for name in filter(None, (ctypes.util.find_library("ode"), "libode.so.8")):
        with suppress(OSError):
            library_found = ctypes.CDLL(name)
    if library_found is None:
        return None
    library_found.dInitODE2.argtypes = [c_uint]
    library_found.dCheckConfiguration.argtypes = [c_char_p]
    library_found.dGetConfiguration.restype = c_char_p
    library_found.dInitODE2(0)
    if not library_found.dCheckConfiguration(b"ODE_double_precision"):
        return None
    for letters, names in _SIGNATURES.items():
        types = [_TYPES[x] for x in letters]
        result = types[0]
        arguments = types[1:]
        for function in (getattr(library_found, name) for name in names.split()):
            function.restype = result
            function.argtypes = arguments
    return library_found


class Ode(Engine):
    """Joint motors at commanded velocity; torque from the constraint forces
    (dJointFeedback)."""

    name = "ODE"
    formulation = "maximal coordinates, constraint forces, semi-implicit Euler"
    install = "apt install libode8 (Debian)"

    @classmethod
    def version(cls) -> str | None:
        """Return the version of libode, which only its file name tells; None if it is
        not installed."""
        return None if _library() is None else "0.16 (libode8)"

    def load(self) -> None:
        """Compute each link's mass and inertia as ODE takes them, about its centre of
        mass, and the vectors by which a joint's wrench gives its motor's torque.

        ``by_wrench`` (n, 3, 2) holds for each joint, in the link's frame, the factors
        of force and moment. Raises InputError for a link whose inertia ODE refuses.
        """
        ode = _library()
        assert ode is not None
        self.ode: Any = ode
        self.masses = []
        self.centres = np.zeros((self.robot.n, 3))
        for k, link in enumerate(self.links):
            # Mass, centre of mass (3), inertia about it (6).
            p = inertia.barycentric_from_standard(link)
            xx, xy, yy, xz, yz, zz = p[4:]
            mass = _Mass()
            # Centre of mass at the body's origin (zeros), then I11, I22, I33, I12, I13,
            # I23.
            ode.dMassSetParameters(
                byref(mass), p[0], 0.0, 0.0, 0.0, xx, yy, zz, xy, xz, yz
            )
            if not ode.dMassCheck(byref(mass)):
                where = f"link {k + 1} (on joint {self.robot.joints[k].name!r})"
                what = "ODE refuses its inertia, which is not positive definite"
                raise InputError(
                    what, "identify with a minimum thickness (lmi-sdp-thickness)", where
                )
            self.masses.append(mass)
            self.centres[k] = p[1:4]
        # A motor's torque is axis . (moment + centre x force), its force axis . force,
        # as products with vectors that are fixed in the link.
        axes = np.array([joint.axis for joint in self.robot.joints])
        revolute = np.array([joint.kind == "revolute" for joint in self.robot.joints])
        by_moment = np.where(revolute[:, None], axes, 0.0)
        by_force = np.where(revolute[:, None], np.cross(axes, self.centres), axes)
        self.by_wrench = np.stack([by_force, by_moment], axis=2)

    def follow(
        self, start: Array, velocities: Array, step: float
    ) -> tuple[Array, Array]:
        """Simulate the robot along commanded velocities (N, n), starting from rest.

        As :meth:`Engine.follow`; ODE's world is destroyed at the end, whatever happens.
        """
        try:
            return super().follow(start, velocities, step)
        finally:
            self.ode.dWorldDestroy(self.world)

    def begin(self, start: Array, step: float) -> None:
        """Build bodies, joints and motors at rest at ``start`` (n,) [rad, m]; later
        steps last ``step`` [s].

        ODE has no loader of URDF, so each link becomes a free body that a hinge or
        slider ties to its parent. ``motors`` are functions that set a joint's velocity;
        ``rotations``, ``last_position``, ``forces`` and ``moments`` are views of ODE's
        memory, which each step changes.
        """
        ode = self.ode
        self.step = step
        self.world = c_void_p(ode.dWorldCreate())
        ode.dWorldSetGravity(self.world, *self.robot.gravity)
        self.bodies: list[c_void_p] = []
        self.motors = []
        self.feedback = (_Feedback * self.robot.n)()
        (frames,) = self.robot.poses(start[None])
        for k, frame in enumerate(frames):
            self.bodies.append(self._new_body(k, frame))
            self.motors.append(self._new_joint(k, frame))
        as_array = np.ctypeslib.as_array
        # Views of ODE's own memory, which stays where it is while the world lives.
        self.rotations = [
            as_array(ode.dBodyGetRotation(body), (12,)).reshape(3, 4)[:, :3]
            for body in self.bodies
        ]
        last = self.bodies[-1]
        self.last_position = as_array(ode.dBodyGetPosition(last), (3,))
        # Constraint forces f1 and moments t1 of all joints, one row for each joint.
        n_numbers = ctypes.sizeof(_Feedback) // ctypes.sizeof(c_double)
        numbers = np.frombuffer(memoryview(self.feedback)).reshape(
            self.robot.n, n_numbers
        )
        self.forces = numbers[:, 0:3]  # f1
        self.moments = numbers[:, 4:7]  # t1

    def _new_body(self, k: int, frame: Array) -> c_void_p:
        """Make link k (from 0) a free body at the pose of its frame (4, 4)."""
        ode = self.ode
        body = c_void_p(ode.dBodyCreate(self.world))
        # ODE's origin of a body is its centre of mass; its matrices are (3, 4).
        rotation = np.pad(frame[:3, :3], ((0, 0), (0, 1)))
        ode.dBodySetRotation(body, (c_double * 12)(*rotation.ravel()))
        centre = frame[:3, :3] @ self.centres[k] + frame[:3, 3]
        ode.dBodySetPosition(body, *centre)
        ode.dBodySetMass(body, byref(self.masses[k]))
        return body

    def _new_joint(self, k: int, frame: Array) -> Callable[[float], Any]:
        """Tie body k to its parent's, or to the world; return the function that sets the
        joint's velocity."""
        ode = self.ode
        joint = self.robot.joints[k]
        kind = "Hinge" if joint.kind == "revolute" else "Slider"
        tie = c_void_p(getattr(ode, f"dJointCreate{kind}")(self.world, None))
        parent = None if joint.parent < 0 else self.bodies[joint.parent]
        ode.dJointAttach(tie, self.bodies[k], parent)
        if kind == "Hinge":
            ode.dJointSetHingeAnchor(tie, *frame[:3, 3])
        set_axis = getattr(ode, f"dJointSet{kind}Axis")
        set_axis(tie, *(frame[:3, :3] @ joint.axis))
        # A velocity motor without a limit of its torque.
        set_parameter = getattr(ode, f"dJointSet{kind}Param")
        set_parameter(tie, _MAX_FORCE, np.inf)
        ode.dJointSetFeedback(tie, byref(self.feedback[k]))
        return partial(set_parameter, tie, _VELOCITY)

    def stepped(self, velocity: Array) -> tuple[Array, Array, Array]:
        """Simulate one step with motors at ``velocity`` (n,) [rad/s, m/s].

        Returns the motors' torque (n,) [N m, N], projected from the joints' constraint
        forces, and rotation (3, 3) and position (3,) [m] of the last link's joint
        frame. The projection uses the rotations before the step, at which ODE forms the
        constraints.
        """
        before = np.array(self.rotations)
        for motor, speed in zip(self.motors, velocity, strict=True):
            motor(speed)
        self.ode.dWorldStep(self.world, self.step)
        # Factors (n, 3, 2) of force and moment, turned into world axes.
        by_wrench = before @ self.by_wrench
        torque = (by_wrench[:, :, 0] * self.forces).sum(axis=1)
        torque += (by_wrench[:, :, 1] * self.moments).sum(axis=1)
        rotation = self.rotations[-1].copy()
        return torque, rotation, self.last_position - rotation @ self.centres[-1]
