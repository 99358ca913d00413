"""Kinematics of a robot and its rigid-body dynamics, from URDF or DH tables, through Pinocchio.

A :class:`Robot` is pure data (joints and gravity), so that a saved model can embed it; the
Pinocchio model is built from it on first use. Inertial parameters never live in the robot: they
are an argument, because they are what is being identified.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.structure import Structure


@dataclass(frozen=True)
class Robot(Structure):
    """A robot as its structure says, with the rigid-body dynamics of any links on it."""

    def _projected(self, torque: Array) -> Array:
        """(N, n, ...) from (N, L, ...): power is the same, tau = matrix^T tau_tree."""
        if self.mechanism is None:
            return torque
        return np.einsum("ln,kl...->kn...", self.mechanism.matrix, torque)

    @cached_property
    def _model(self) -> Any:
        from sdp_vs_penalty.robot._pinocchio import pin

        model = pin.Model()
        model.gravity = pin.Motion(np.array(self.gravity, float), np.zeros(3))
        for joint in self.tree:
            unaligned = {
                "revolute": pin.JointModelRevoluteUnaligned,
                "prismatic": pin.JointModelPrismaticUnaligned,
            }[joint.kind]
            placement = pin.SE3(joint.placement[:3, :3].copy(), joint.placement[:3, 3].copy())
            model.addJoint(joint.parent + 1, unaligned(joint.axis), placement, joint.name)
        return model

    @cached_property
    def _link_maps(self) -> Array | None:
        """(links, 10, 10) from link-frame to joint-frame parameters; None where all are identity."""
        frames = [self.tree[k].link_frame for k in self.link_joints]
        if all(np.array_equal(frame, np.eye(4)) for frame in frames):
            return None
        return np.stack([inertia.transform(frame) for frame in frames])

    def regressor(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Y with tau = Y theta, shape (N, n, 10 links), for states of shape (N, n).

        Atkeson, An, Hollerbach (IJRR 1986), by Pinocchio's joint torque regressor.
        """
        from sdp_vs_penalty.robot._pinocchio import pin

        q, dq, ddq = self.tree_state(q, dq, ddq)
        out = np.empty((len(q), len(self.tree), 10 * len(self.tree)))
        model, data = self._model, self._model.createData()
        for k in range(len(q)):
            out[k] = pin.computeJointTorqueRegressor(model, data, q[k], dq[k], ddq[k])
        if self.mechanism is not None:
            out = self._projected(out)
            blocks = out.reshape(len(q), self.n, -1, 10)[:, :, list(self.link_joints)]
            out = blocks.reshape(len(q), self.n, -1)
        if self._link_maps is not None:
            blocks = out.reshape(len(q), self.n, self.links, 10)
            out = np.einsum("kjla,lab->kjlb", blocks, self._link_maps).reshape(out.shape)
        return out

    def _with_inertias(self, theta: ArrayLike) -> Any:
        from sdp_vs_penalty.robot._pinocchio import pin

        model = self._model.copy()
        links = np.asarray(theta, float).reshape(self.links, 10)
        if self._link_maps is not None:
            links = np.einsum("lab,lb->la", self._link_maps, links)
        for i, row in zip(self.link_joints, links, strict=True):
            # FromDynamicParameters divides by the mass: a massless link keeps its inertia this way.
            mass = row[0]
            if mass == 0.0:
                rotational = inertia.inertia_matrix(row[4:])
                model.inertias[i + 1] = pin.Inertia(0.0, np.zeros(3), rotational)
            else:
                model.inertias[i + 1] = pin.Inertia.FromDynamicParameters(row)
        return model

    def inverse_dynamics(self, theta: ArrayLike, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Joint torques (N, n) of rigid links by recursive Newton-Euler; theta has 10 a link."""
        from sdp_vs_penalty.robot._pinocchio import pin

        model = self._with_inertias(theta)
        data = model.createData()
        rows = zip(*self.tree_state(q, dq, ddq), strict=True)
        return self._projected(np.stack([pin.rnea(model, data, *row) for row in rows]))

    def inverse_dynamics_derivatives(
        self, theta: ArrayLike, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike
    ) -> tuple[Array, Array, Array]:
        """Partial derivatives of the joint torques, each (N, n, n): [k, i, j] = d tau_i / d x_j.

        With respect to q, dq and ddq, of rigid links; theta has 10 a link (Carpentier, Mansard,
        RSS 2018).
        """
        from sdp_vs_penalty.robot._pinocchio import pin

        if (parts := _of_positive_masses(theta)) is not None:
            both = (self.inverse_dynamics_derivatives(x, q, dq, ddq) for x in parts)
            by_q, by_dq, by_ddq = (np.subtract(a, b) for a, b in zip(*both, strict=True))
            return by_q, by_dq, by_ddq
        model = self._with_inertias(theta)
        data = model.createData()
        q, dq, ddq = self.tree_state(q, dq, ddq)
        by_q, by_dq, by_ddq = np.empty((3, len(q), len(self.tree), len(self.tree)))
        for k in range(len(q)):
            pin.computeRNEADerivatives(model, data, q[k], dq[k], ddq[k])
            by_q[k], by_dq[k], by_ddq[k] = data.dtau_dq, data.dtau_dv, data.M
        upper = np.triu(by_ddq)  # Pinocchio fills one triangle of M
        by_ddq = upper + np.swapaxes(np.triu(by_ddq, 1), 1, 2)
        return self._reduced(by_q), self._reduced(by_dq), self._reduced(by_ddq)

    def placement_derivatives(
        self, theta: ArrayLike, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike
    ) -> Array:
        """(N, n, joints of the tree, 6) derivatives of the joint torques by where each joint is placed:
        its displacement [m] and its rotation [rad], along and about the axes of its own frame.

        Six virtual joints that rest stand before each, and it is by their positions that Pinocchio
        derives (Carpentier, Mansard, RSS 2018).
        """
        from sdp_vs_penalty.robot._pinocchio import pin

        if (parts := _of_positive_masses(theta)) is not None:
            both = (self.placement_derivatives(x, q, dq, ddq) for x in parts)
            return np.asarray(np.subtract(*both))
        inertias, model = self._with_inertias(theta), pin.Model()
        model.gravity = self._model.gravity
        places: list[int] = []  # of the tree's joints in the longer one
        for i, one in enumerate(self.tree):
            parent = 0 if one.parent == -1 else places[one.parent]
            pose = inertias.jointPlacements[i + 1]
            for k in range(6):
                kind = pin.JointModelPrismaticUnaligned if k < 3 else pin.JointModelRevoluteUnaligned
                parent = model.addJoint(parent, kind(np.eye(3)[k % 3]), pose, f"{one.name} {k}")
                pose = pin.SE3.Identity()
            places.append(model.addJoint(parent, inertias.joints[i + 1], pose, one.name))
            model.inertias[places[-1]] = inertias.inertias[i + 1]
        own, data = np.array(places) - 1, model.createData()
        virtual = (own[:, None] - 6 + np.arange(6)).ravel()
        states = np.zeros((3, len(np.atleast_2d(q)), model.nv))
        states[:, :, own] = np.array(self.tree_state(q, dq, ddq))
        out, wanted = np.empty((states.shape[1], len(own), len(virtual))), np.ix_(own, virtual)
        for k, row in enumerate(np.swapaxes(states, 0, 1)):
            pin.computeRNEADerivatives(model, data, *row)
            out[k] = data.dtau_dq[wanted]
        if self.mechanism is not None:
            out = np.einsum("ln,klc->knc", self.mechanism.matrix, out)
        return out.reshape(len(out), self.n, len(own), 6)

    def _reduced(self, by_tree: Array) -> Array:
        """(N, n, n) B^T D B of a matrix (N, L, L) between joints of the tree."""
        if self.mechanism is None:
            return by_tree
        return np.asarray(self.mechanism.matrix.T @ by_tree @ self.mechanism.matrix)

    def jacobians(self, q: ArrayLike, link: int) -> Array:
        """(N, 6, n) of a tree joint's frame: linear, then angular velocity, in world axes."""
        from sdp_vs_penalty.robot._pinocchio import pin

        model, data = self._model, self._model.createData()
        (q,) = self.tree_state(q)
        out = np.empty((len(q), 6, len(self.tree)))
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        for k in range(len(q)):
            pin.computeJointJacobians(model, data, q[k])
            # one column comes back flat
            out[k] = np.reshape(pin.getJointJacobian(model, data, link + 1, frame), (6, len(self.tree)))
        return out if self.mechanism is None else out @ self.mechanism.matrix

    def mass_matrices(self, theta: ArrayLike, q: ArrayLike) -> Array:
        """Joint-space inertia matrices M(q), shape (N, n, n)."""
        q = np.atleast_2d(np.asarray(q, float))
        return self.mass_and_bias(theta)(q, np.zeros_like(q))[0]

    def mass_and_bias(self, theta: ArrayLike) -> Callable[[Array, Array], tuple[Array, Array]]:
        """The function from q, dq (N, n) to M(q) (N, n, n) and C(q, dq) dq + g(q) (N, n) of these links.

        By the composite rigid body and recursive Newton-Euler algorithms (Featherstone 2008, ch. 5-6).
        """
        from sdp_vs_penalty.robot._pinocchio import pin

        if (parts := _of_positive_masses(theta)) is not None:
            whole, taken = (self.mass_and_bias(x) for x in parts)
            return lambda q, dq: tuple(map(np.subtract, whole(q, dq), taken(q, dq)))  # type: ignore[return-value]
        model = self._with_inertias(theta)
        data = model.createData()

        def terms(q: Array, dq: Array) -> tuple[Array, Array]:
            q, dq = self.tree_state(q, dq)
            mass, bias = np.empty((len(q), model.nv, model.nv)), np.empty((len(q), model.nv))
            for k in range(len(q)):
                mass[k] = pin.crba(model, data, q[k])
                bias[k] = pin.nonLinearEffects(model, data, q[k], dq[k])
            full = np.triu(mass) + np.swapaxes(np.triu(mass, 1), 1, 2)
            return self._reduced(full), self._projected(bias)

        return terms


def _of_positive_masses(theta: ArrayLike) -> tuple[Array, Array] | None:
    """Links (L, 10) twice, whose difference these are; None where every mass is positive as it is.

    Pinocchio divides by the mass that a joint carries, wherever it sums links, and masses of least
    squares may be negative: what is linear in theta is right as a difference.
    """
    links = np.array(theta, float).reshape(-1, 10)
    if np.all(links[:, 0] > 0.0):
        return None
    heavy = np.zeros_like(links)
    heavy[:, 0] = 1.0 + 2.0 * np.abs(links[:, 0]).sum()
    return links + heavy, heavy
