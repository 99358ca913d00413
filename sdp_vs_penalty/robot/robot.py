"""Kinematics of a robot and its rigid-body dynamics, from URDF or DH tables, through Pinocchio.

A :class:`Robot` is pure data (joints and gravity), so that a saved model can embed it; the
Pinocchio model is built from it on first use. Inertial parameters never live in the robot: they
are an argument, because they are what is being identified.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.robot.transmission import Transmission

Array = NDArray[np.float64]

STANDARD_GRAVITY = (0.0, 0.0, -9.81)


@dataclass(frozen=True)
class Joint:
    """One moving joint and the link that it carries.

    placement : (4, 4) pose of the joint frame in the parent's joint frame (the base: -1) at q = 0.
    axis : (3,) unit vector of motion in the joint frame.
    link_frame : (4, 4) pose of the link frame in the joint frame; the link's inertial parameters
        are about the link frame (identity for URDF and modified DH, Tz(d) Tx(a) Rx(alpha) for
        standard DH, whose frames sit at the far end of a link).
    lower, upper : range [rad or m]; velocity : limit [rad/s or m/s]; effort : limit [N m or N].
    """

    name: str
    kind: str  # "revolute" | "prismatic"
    parent: int
    placement: Array
    axis: Array
    link_frame: Array
    lower: float = -np.inf
    upper: float = np.inf
    velocity: float = np.inf
    effort: float = np.inf

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and self.name):
            raise InputError(f"a joint's name must be text, not {self.name!r}.")
        for name, shape in (("placement", (4, 4)), ("axis", (3,)), ("link_frame", (4, 4))):
            value = getattr(self, name)
            if value.shape != shape or not np.all(np.isfinite(value)):
                raise InputError(f"joint {self.name}: {name} must hold {shape} finite numbers.")
        if abs(np.linalg.norm(self.axis) - 1.0) > 1e-9:
            raise InputError(f"joint {self.name}: the axis must be a unit vector.")
        if self.kind not in ("revolute", "prismatic"):
            raise InputError(f"joint {self.name}: kind {self.kind!r} is not revolute or prismatic.")
        if not self.lower <= self.upper:
            raise InputError(
                f"joint {self.name}: the lower limit {self.lower:g} is above the upper {self.upper:g}."
            )


@dataclass(frozen=True)
class Robot:
    """Joints (n), depth first, and the gravity vector [m/s^2] in the base frame.

    Depth first: what a joint carries follows it without a gap. Pinocchio's composite rigid body
    algorithm takes subtrees as index ranges and is silently wrong on any other order.
    transmission : how the motors turn with the joints, where that is known.
    Raises InputError for joints in another order.
    """

    name: str
    joints: tuple[Joint, ...]
    gravity: tuple[float, float, float] = STANDARD_GRAVITY
    transmission: Transmission | None = None

    def __post_init__(self) -> None:
        if self.transmission is not None and self.transmission.n != self.n:
            raise InputError(
                f"robot {self.name} has {self.n} joints, its transmission {self.transmission.n} motors."
            )
        names = [joint.name for joint in self.joints]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"robot {self.name}: joint {name} appears {names.count(name)} times.")
        open_branch: list[int] = []  # from the base to the last joint
        for i, joint in enumerate(self.joints):
            while open_branch and open_branch[-1] != joint.parent:
                open_branch.pop()
            if not open_branch and joint.parent != -1:
                raise InputError(
                    f"robot {self.name}: joint {joint.name} must come after its parent and before "
                    "any other branch (depth first)."
                )
            open_branch.append(i)

    @property
    def n(self) -> int:
        return len(self.joints)

    @property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(joint.name for joint in self.joints)

    @property
    def position_units(self) -> tuple[str, ...]:
        return tuple("m" if j.kind == "prismatic" else "rad" for j in self.joints)

    @property
    def torque_units(self) -> tuple[str, ...]:
        return tuple("N" if j.kind == "prismatic" else "N*m" for j in self.joints)

    @cached_property
    def subtree(self) -> tuple[tuple[int, ...], ...]:
        """For each joint the links that it carries: only their parameters make torque on it."""
        carried: list[list[int]] = [[i] for i in range(self.n)]
        for i in reversed(range(self.n)):
            if self.joints[i].parent >= 0:
                carried[self.joints[i].parent] += carried[i]
        return tuple(tuple(sorted(c)) for c in carried)

    @cached_property
    def _model(self) -> Any:
        model = pin.Model()
        model.gravity = pin.Motion(np.array(self.gravity, float), np.zeros(3))
        for joint in self.joints:
            unaligned = {
                "revolute": pin.JointModelRevoluteUnaligned,
                "prismatic": pin.JointModelPrismaticUnaligned,
            }[joint.kind]
            placement = pin.SE3(joint.placement[:3, :3].copy(), joint.placement[:3, 3].copy())
            model.addJoint(joint.parent + 1, unaligned(joint.axis), placement, joint.name)
        return model

    @cached_property
    def _link_maps(self) -> Array | None:
        """(n, 10, 10) maps from link-frame to joint-frame parameters; None where all are identity."""
        if all(np.array_equal(j.link_frame, np.eye(4)) for j in self.joints):
            return None
        return np.stack([inertia.transform(j.link_frame) for j in self.joints])

    def regressor(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Y with tau = Y theta, shape (N, n, 10 n), for states of shape (N, n).

        Atkeson, An, Hollerbach (IJRR 1986); computed by Pinocchio's joint torque regressor.
        """
        q, dq, ddq = (np.ascontiguousarray(np.atleast_2d(x), float) for x in (q, dq, ddq))
        model, data = self._model, self._model.createData()
        out = np.empty((len(q), self.n, 10 * self.n))
        compute = pin.computeJointTorqueRegressor
        for k in range(len(q)):
            out[k] = compute(model, data, q[k], dq[k], ddq[k])
        if self._link_maps is not None:
            blocks = out.reshape(len(q), self.n, self.n, 10)
            out = np.einsum("kjla,lab->kjlb", blocks, self._link_maps).reshape(out.shape)
        return out

    def _with_inertias(self, theta: ArrayLike) -> Any:
        model = self._model.copy()
        links = np.asarray(theta, float).reshape(self.n, 10)
        if self._link_maps is not None:
            links = np.einsum("lab,lb->la", self._link_maps, links)
        for i, row in enumerate(links):
            # FromDynamicParameters divides by the mass: a massless link keeps its inertia this way.
            mass = row[0]
            if mass == 0.0:
                rotational = inertia.inertia_matrix(row[4:])
                model.inertias[i + 1] = pin.Inertia(0.0, np.zeros(3), rotational)
            else:
                model.inertias[i + 1] = pin.Inertia.FromDynamicParameters(row)
        return model

    def inverse_dynamics(self, theta: ArrayLike, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Joint torques (N, n) of rigid links by recursive Newton-Euler; theta has 10 n entries."""
        model = self._with_inertias(theta)
        data = model.createData()
        q, dq, ddq = (np.ascontiguousarray(np.atleast_2d(x), float) for x in (q, dq, ddq))
        return np.stack([pin.rnea(model, data, *row) for row in zip(q, dq, ddq, strict=True)])

    def inverse_dynamics_derivatives(
        self, theta: ArrayLike, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike
    ) -> tuple[Array, Array, Array]:
        """Partial derivatives of the joint torques, each (N, n, n): [k, i, j] = d tau_i / d x_j.

        With respect to q, dq and ddq, of rigid links; theta has 10 n entries (Carpentier, Mansard,
        RSS 2018).
        """
        model = self._with_inertias(theta)
        data = model.createData()
        q, dq, ddq = (np.ascontiguousarray(np.atleast_2d(x), float) for x in (q, dq, ddq))
        by_q, by_dq, by_ddq = np.empty((3, len(q), self.n, self.n))
        for k in range(len(q)):
            pin.computeRNEADerivatives(model, data, q[k], dq[k], ddq[k])
            by_q[k], by_dq[k], by_ddq[k] = data.dtau_dq, data.dtau_dv, data.M
        upper = np.triu(by_ddq)  # Pinocchio fills one triangle of M
        return by_q, by_dq, upper + np.swapaxes(np.triu(by_ddq, 1), 1, 2)

    def jacobians(self, q: ArrayLike, link: int) -> Array:
        """(N, 6, n) of a link's joint frame: linear, then angular velocity, in world axes."""
        model, data = self._model, self._model.createData()
        q = np.ascontiguousarray(np.atleast_2d(q), float)
        out = np.empty((len(q), 6, self.n))
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        for k in range(len(q)):
            pin.computeJointJacobians(model, data, q[k])
            # one column comes back flat
            out[k] = np.reshape(pin.getJointJacobian(model, data, link + 1, frame), (6, self.n))
        return out

    def mass_matrices(self, theta: ArrayLike, q: ArrayLike) -> Array:
        """Joint-space inertia matrices M(q), shape (N, n, n)."""
        model = self._with_inertias(theta)
        data = model.createData()
        out = np.stack([pin.crba(model, data, row) for row in np.atleast_2d(np.asarray(q, float))])
        return np.triu(out) + np.swapaxes(np.triu(out, 1), 1, 2)

    def random_configurations(self, count: int, seed: int) -> Array:
        """(count, n) positions, uniform inside the joint range (or +-pi rad, +-1 m where open)."""
        span = [np.pi if j.kind == "revolute" else 1.0 for j in self.joints]
        low = [j.lower if np.isfinite(j.lower) else -s for j, s in zip(self.joints, span, strict=True)]
        high = [j.upper if np.isfinite(j.upper) else s for j, s in zip(self.joints, span, strict=True)]
        return np.random.default_rng(seed).uniform(low, high, (count, self.n))

    def joint_origins(self) -> Array:
        """(n, 3) origin of each link frame in the base frame at q = 0."""
        poses: list[Array] = []
        for joint in self.joints:
            parent = np.eye(4) if joint.parent < 0 else poses[joint.parent]
            poses.append(parent @ joint.placement)
        return np.array([(p @ j.link_frame)[:3, 3] for p, j in zip(poses, self.joints, strict=True)])

    def link_reach(self) -> Array:
        """(n,) distance [m] from each link frame's origin to the farthest joint that the link bears.

        A length scale for links of which nothing else is known; the last link gets that of its
        parent.
        """
        reach = np.zeros(self.n)
        for joint in self.joints:
            if joint.parent >= 0:
                frame = self.joints[joint.parent].link_frame
                offset = np.linalg.inv(frame) @ joint.placement
                reach[joint.parent] = max(reach[joint.parent], np.linalg.norm(offset[:3, 3]))
        for i, joint in enumerate(self.joints):
            own = float(np.linalg.norm(joint.link_frame[:3, 3]))
            reach[i] = max(reach[i], own)
            if reach[i] == 0.0 and joint.parent >= 0:
                reach[i] = reach[joint.parent]
        return np.maximum(reach, 0.1)

    def to_dict(self) -> dict[str, Any]:
        """Plain lists and numbers; :meth:`from_dict` restores the same robot to the last bit."""
        joints = [
            {
                key: value.tolist() if isinstance(value, np.ndarray) else value
                for key, value in vars(j).items()
                if not (isinstance(value, float) and np.isinf(value))
            }
            for j in self.joints
        ]
        out: dict[str, Any] = {"name": self.name, "gravity": list(self.gravity), "joints": joints}
        if self.transmission is not None:
            out["transmission"] = self.transmission.to_dict()
        return out

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Robot:
        arrays = ("placement", "axis", "link_frame")

        def joint(given: Mapping[str, Any]) -> Joint:
            fields: dict[str, Any] = {**given, **{k: np.array(given[k], float) for k in arrays}}
            return Joint(**fields)

        joints = tuple(map(joint, data["joints"]))
        given = data.get("transmission")
        transmission = None if given is None else Transmission.from_dict(given)
        return cls(data["name"], joints, _vector3(data["gravity"]), transmission)

    @classmethod
    def from_dh(
        cls,
        name: str,
        a: Sequence[float],
        alpha: Sequence[float],
        d: Sequence[float],
        convention: str,
        gravity: Sequence[float] = STANDARD_GRAVITY,
        limits: Sequence[Mapping[str, float]] = (),
    ) -> Robot:
        """A chain of revolute joints from a DH table without joint offsets.

        convention "modified" (Craig): Rx(alpha) Tx(a) Rz(q) Tz(d), the link frame on its own joint
        axis; "standard": Rz(q) Tz(d) Tx(a) Rx(alpha), the link frame at the link's far end.
        """
        joints: list[Joint] = []
        for i, row in enumerate(zip(a, alpha, d, strict=True)):
            a_i, alpha_i, d_i = row
            if convention == "modified":
                placement = _rotation_x(alpha_i) @ _translation(a_i, 0.0, d_i)
                # Rz and Tz commute: the offset along the axis can come first.
                frame = np.eye(4)
            elif convention == "standard":
                placement = np.eye(4) if i == 0 else joints[-1].link_frame
                frame = _translation(a_i, 0.0, d_i) @ _rotation_x(alpha_i)
            else:
                raise InputError(
                    f"DH convention {convention!r} is unknown", "use 'modified' or 'standard'"
                )
            extra = dict(limits[i]) if limits else {}
            joints.append(
                Joint(f"joint{i + 1}", "revolute", i - 1, placement, np.eye(3)[2], frame, **extra)
            )
        return cls(name, tuple(joints), _vector3(gravity))


def _vector3(values: Sequence[float]) -> tuple[float, float, float]:
    if len(values) != 3 or not np.all(np.isfinite(values)):
        raise InputError(f"gravity {values!r}: three finite numbers in m/s^2 are needed.")
    x, y, z = (float(v) for v in values)
    return x, y, z


def _rotation_x(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    # Exact quarter turns: cos(pi/2) = 6e-17 would leak into the structural zeros of the regressor.
    c, s = (np.round(v) if abs(v - np.round(v)) < 1e-15 else v for v in (c, s))
    out = np.eye(4)
    out[1:3, 1:3] = [[c, -s], [s, c]]
    return out


def _translation(x: float, y: float, z: float) -> Array:
    out = np.eye(4)
    out[:3, 3] = x, y, z
    return out
