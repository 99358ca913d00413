"""A robot's dynamics in plain NumPy: what an exported .py file carries in place of Pinocchio.

Its classes and functions are copied into every exported file; they may use nothing but NumPy and the
standard library. It is the recursive Newton-Euler method (Luh,
Walker, Paul, ASME J. Dynamic Systems 1980) with the torque written linearly in the links'
parameters, vectorised over samples. All functions take complex numbers, so that derivatives are
exact to rounding by the complex step.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True)
class Robot:
    """Joints (parents before children), each with kind, parent, placement, axis and link_frame.

    placement (4, 4): pose in the parent's joint frame (the base: -1) at q = 0; axis (3,) in the
    joint frame; link_frame (4, 4): where the frame of the link's parameters sits in it.
    """

    joints: tuple[SimpleNamespace, ...]
    gravity: tuple[float, float, float]

    @property
    def n(self) -> int:
        return len(self.joints)

    @property
    def links(self) -> int:
        return self.n

    @property
    def link_joints(self) -> tuple[int, ...]:
        return tuple(range(self.n))

    @property
    def tree(self) -> tuple[SimpleNamespace, ...]:
        return self.joints

    @property
    def subtree(self) -> tuple[tuple[int, ...], ...]:
        """For each joint the links that it carries."""
        carried = [[i] for i in range(self.n)]
        for i in reversed(range(self.n)):
            if self.joints[i].parent >= 0:
                carried[self.joints[i].parent] += carried[i]
        return tuple(tuple(sorted(c)) for c in carried)

    def poses(self, q: Array) -> list[tuple[Array, Array]]:
        """Of each joint frame in its parent's: rotations (N, 3, 3) and origins (N, 3)."""
        out = []
        for i, joint in enumerate(self.joints):
            turn, shift = joint.placement[:3, :3], joint.placement[:3, 3]
            if joint.kind == "prismatic":
                rotation = np.broadcast_to(turn, (len(q), 3, 3))
                out.append((rotation, shift + q[:, i, None] * (turn @ joint.axis)))
            else:
                k = skew(joint.axis)
                s, c = np.sin(q[:, i])[:, None, None], np.cos(q[:, i])[:, None, None]
                out.append((turn @ (np.eye(3) + s * k + (1.0 - c) * (k @ k)), shift + 0.0 * q[:, :1]))
        return out

    def wrenches(self, q: Array, dq: Array, ddq: Array) -> list[Array]:
        """Per link the map (N, 6, 10) from its parameters to the force and moment on its joint."""
        states: list[tuple[Array, Array, Array]] = []
        out = []
        for i, (r, p) in enumerate(self.poses(q)):
            joint = self.joints[i]
            rest = np.zeros((len(q), 3))
            base = (rest, rest, rest - np.array(self.gravity))
            w, dw, a = base if joint.parent < 0 else states[joint.parent]
            a = a + np.cross(dw, p) + np.cross(w, np.cross(w, p))
            w, dw, a = (np.einsum("kba,kb->ka", r, x) for x in (w, dw, a))
            if joint.kind == "prismatic":
                a = a + 2.0 * np.cross(w, joint.axis) * dq[:, i, None] + joint.axis * ddq[:, i, None]
            else:
                dw = dw + np.cross(w, joint.axis) * dq[:, i, None] + joint.axis * ddq[:, i, None]
                w = w + joint.axis * dq[:, i, None]
            states.append((w, dw, a))
            turn, shift = joint.link_frame[:3, :3], joint.link_frame[:3, 3]
            a = a + np.cross(dw, shift) + np.cross(w, np.cross(w, shift))
            own = body_wrench(w @ turn, dw @ turn, a @ turn)
            out.append(carry(turn, shift + 0.0 * w, own))
        return out

    def placement_derivatives(self, theta: Array, q: Array, dq: Array, ddq: Array) -> Array:
        """(N, n, n, 6) derivatives of the torques by where each joint is placed, by complex steps."""
        out, step = np.empty((len(q), self.n, self.n, 6)), 1e-20
        for j, joint in enumerate(self.joints):
            for k in range(6):
                pose = np.eye(4, dtype=complex)
                pose[:3, 3] += 1j * step * np.eye(6)[k, :3]
                pose[:3, :3] += 1j * step * skew(np.eye(6)[k, 3:])
                moved = SimpleNamespace(**{**vars(joint), "placement": joint.placement @ pose})
                beside = Robot((*self.joints[:j], moved, *self.joints[j + 1 :]), self.gravity)
                torque = beside.regressor(q + 0j, dq + 0j, ddq + 0j) @ np.ravel(theta)
                out[:, :, j, k] = torque.imag / step
        return out

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Y (N, n, 10 n) with tau = Y theta; q, dq, ddq (N, n)."""
        out = np.zeros((len(q), self.n, 10 * self.n), np.result_type(q, dq, ddq, float))
        poses = self.poses(q)
        for link, wrench in enumerate(self.wrenches(q, dq, ddq)):
            i = link
            while True:
                joint = self.joints[i]
                half = wrench[:, :3] if joint.kind == "prismatic" else wrench[:, 3:]
                out[:, i, 10 * link : 10 * link + 10] = np.einsum("a,kac->kc", joint.axis, half)
                if joint.parent < 0:
                    break
                wrench = carry(*poses[i], wrench)
                i = joint.parent
        return out

    def inverse_dynamics(self, theta: Array, q: Array, dq: Array, ddq: Array) -> Array:
        """Torques (N, n) of rigid links with parameters theta (10 n entries)."""
        links = np.reshape(theta, (self.n, 10))
        force = [
            np.einsum("kac,c->ka", wrench, link)[:, :, None]
            for wrench, link in zip(self.wrenches(q, dq, ddq), links, strict=True)
        ]
        torque: list[Array] = [np.zeros(0)] * self.n
        for i, pose in reversed(list(enumerate(self.poses(q)))):
            joint = self.joints[i]
            half = force[i][:, :3, 0] if joint.kind == "prismatic" else force[i][:, 3:, 0]
            torque[i] = half @ joint.axis
            if joint.parent >= 0:
                force[joint.parent] = force[joint.parent] + carry(pose[0], pose[1], force[i])
        return np.column_stack(torque)

    def inverse_dynamics_derivatives(
        self, theta: Array, q: Array, dq: Array, ddq: Array
    ) -> tuple[Array, ...]:
        """d tau_i / d x_j (N, n, n) with respect to q, dq and ddq, by the complex step."""
        tiny, out = 1e-30, []
        for which in range(3):
            columns = []
            for j in range(self.n):
                state = [np.array(x, complex) for x in (q, dq, ddq)]
                state[which][:, j] += 1j * tiny
                columns.append(self.inverse_dynamics(theta, *state).imag / tiny)
            out.append(np.stack(columns, axis=2))
        return tuple(out)

    def jacobians(self, q: Array, link: int) -> Array:
        """(N, 6, n) of a link's joint frame: linear, then angular velocity, in world axes."""
        frames: list[tuple[Array, Array]] = []
        for joint, (r, p) in zip(self.joints, self.poses(q), strict=True):
            if joint.parent >= 0:
                r0, p0 = frames[joint.parent]
                r, p = r0 @ r, p0 + np.einsum("kab,kb->ka", r0, p)
            frames.append((r, p))
        out = np.zeros((len(q), 6, self.n))
        i = link
        while i >= 0:
            joint, (r, p) = self.joints[i], frames[i]
            axis = r @ joint.axis
            if joint.kind == "prismatic":
                out[:, :3, i] = axis
            else:
                out[:, :3, i], out[:, 3:, i] = np.cross(axis, frames[link][1] - p), axis
            i = joint.parent
        return out


def skew(v: Array) -> Array:
    """The matrices (..., 3, 3) of the cross product with v (..., 3)."""
    zero = 0.0 * v[..., 0]
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    rows = [np.stack(row, axis=-1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))]
    return np.stack(rows, axis=-2)


def body_wrench(w: Array, dw: Array, a: Array) -> Array:
    """Force and moment (N, 6, 10) per parameter (m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz).

    At a body's frame with angular velocity w, angular acceleration dw, acceleration a of its origin
    less gravity: f = m a + (dw x + w x w x) m c, n = I dw + w x I w + m c x a.
    """
    out = np.zeros((len(w), 6, 10), np.result_type(w, dw, a))
    out[:, :3, 0] = a
    out[:, :3, 1:4] = skew(dw) + skew(w) @ skew(w)
    out[:, 3:, 1:4] = -skew(a)
    out[:, 3:, 4:] = times_inertia(dw) + skew(w) @ times_inertia(w)
    return out


def times_inertia(v: Array) -> Array:
    """L (N, 3, 6) with I v = L (Ixx, Ixy, Iyy, Ixz, Iyz, Izz)."""
    out = np.zeros((len(v), 3, 6), v.dtype)
    x, y, z = v[:, 0], v[:, 1], v[:, 2]
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 3] = x, y, z
    out[:, 1, 1], out[:, 1, 2], out[:, 1, 4] = x, y, z
    out[:, 2, 3], out[:, 2, 4], out[:, 2, 5] = x, y, z
    return out


def carry(rotation: Array, origin: Array, wrench: Array) -> Array:
    """Wrenches (N, 6, k) given in a frame, in the frame in which it has this rotation and origin."""
    force = rotation @ wrench[:, :3]
    moment = rotation @ wrench[:, 3:] + skew(origin) @ force
    return np.concatenate([force, moment], axis=1)
