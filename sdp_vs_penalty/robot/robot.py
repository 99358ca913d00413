"""Kinematics of a robot and its rigid-body dynamics, from URDF or DH tables, through
Pinocchio.

A :class:`Robot` is pure data (joints and gravity), so that a saved model can embed it;
the Pinocchio model is built from it on first use. Inertial parameters never live in the
robot: they are an argument, because they are what is being identified.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.errors import InputError, require_known
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, check_finite
from sdp_vs_penalty.robot.joint import (
    ChannelNames,
    HeldJoint,
    Joint,
    Mechanism,
    Transmission,
)
from sdp_vs_penalty.robot.rotation import joint_motions

STANDARD_GRAVITY = (0.0, 0.0, -9.81)


#: Robots' files write right angles with four decimals or more, so that they are off by
#: less than this [rad]. Axes that are meant parallel are tilted by as much, and entries
#: that would be zero on exact axes are as small, relative to the largest ones.
ROUNDED_ANGLE = 1e-5


@dataclass(frozen=True)
class Robot(JsonRecord):
    """Joints (n), depth first, and the gravity vector [m/s^2] in the base frame.

    Depth first: what a joint carries follows it without a gap. Pinocchio's composite
    rigid body algorithm takes subtrees as index ranges and is silently wrong on any
    other order. Where joints follow others, ``joints`` are those that move by
    themselves, a joint's parent counts in ``tree``, and there are more links than
    joints: ``links`` of them.
    """

    skips_null = True

    #: Name of the robot.
    name: str
    #: Joints (n) that move by themselves.
    joints: tuple[Joint, ...]
    #: (3,) gravity in the base frame [m/s^2].
    gravity: tuple[float, ...] = STANDARD_GRAVITY
    #: How the motors turn with the joints; None where that is not known.
    transmission: Transmission | None = None
    #: How further joints follow ``joints``; None where none do.
    mechanism: Mechanism | None = None
    #: Joints that stand still and count no more.
    held: tuple[HeldJoint, ...] = ()

    def __post_init__(self) -> None:
        """Raise InputError for a gravity that is not (3,) finite numbers, a
        transmission or mechanism with another number of joints, equal names, or joints
        that are not depth first."""
        check_finite("the gravity x,y,z [m/s^2]", np.array(self.gravity), (3,))
        if self.transmission is not None and self.transmission.n != self.n:
            what = f"{self.n} joints, its transmission {self.transmission.n} motors"
            raise InputError(f"robot {self.name} has {what}", "give one motor a joint")
        # Names tell joints apart.
        for name, count in Counter(self.joint_names).items():
            if count > 1:
                raise InputError(
                    f"robot {self.name}: joint {name} appears {count} times",
                    "rename one",
                )
        if self.mechanism is not None and self.mechanism.matrix.shape[1] != self.n:
            what = f"robot {self.name} has {self.n} joints, its mechanism others"
            raise InputError(what, "give it the same joints")
        # Depth first: a joint's parent lies on the way from the base to the joint
        # before it.
        branch = [-1]  # from the base to the last joint
        for i, joint in enumerate(self.tree):
            if joint.parent not in branch:
                what = f"joint {joint.name} comes before its parent, or splits a branch"
                raise InputError(
                    f"robot {self.name}: {what}", "order the joints depth first"
                )
            branch = [*branch[: branch.index(joint.parent) + 1], i]

    @property
    def n(self) -> int:
        """Number of joints that move and are driven."""
        return len(self.joints)

    @property
    def tree(self) -> tuple[Joint, ...]:
        """(L,) every moving joint, followers included."""
        return self.joints if self.mechanism is None else self.mechanism.tree

    @cached_property
    def link_joints(self) -> tuple[int, ...]:
        """For each link with mass the index in the tree of the joint that carries it."""
        massless = () if self.mechanism is None else self.mechanism.massless
        return tuple(k for k in range(len(self.tree)) if k not in massless)

    @property
    def links(self) -> int:
        """Number of links with parameters: one a joint of the tree, without massless
        ones.
        """
        return len(self.link_joints)

    @property
    def couplings(self) -> tuple[Array, ...]:
        """Rows (n,) of motors and followers that turn with several joints, scaled to a
        first entry of 1.
        """
        couplings = []
        for part in (self.transmission, self.mechanism):
            for row in () if part is None else part.matrix:
                factors = row[row != 0.0]
                if len(factors) > 1:
                    couplings.append(row / factors[0])
        return tuple(couplings)

    def with_constant_joints(self, held: Mapping[str, float]) -> "Robot":
        """Return the robot with some driven joints standing still.

        Their links stay links of their own, so that bounds keep their numbers. Where a URDF is
        read, held links are merged into their parents instead.

        Parameters
        ----------
        held : mapping
            Positions [rad, m] by joint.

        Returns
        -------
        Robot
            The robot with fewer driven joints.

        Raises
        ------
        InputError
            A name is no joint, or every joint is held.
        """
        if not held:
            return self
        places = check_held(self.joint_names, held)
        moving_places = [k for k in range(self.n) if k not in places]
        value = np.zeros(self.n)
        value[list(places)] = [held[self.joint_names[k]] for k in places]
        # Positions of the tree's joints are matrix q + offset; columns of held joints
        # go into the offset.
        m = self.mechanism or Mechanism(
            self.tree, matrix=np.eye(self.n), offset=np.zeros(self.n), massless=()
        )
        mechanism = Mechanism(
            m.tree,
            matrix=m.matrix[:, moving_places],
            offset=m.offset + m.matrix @ value,
            massless=m.massless,
        )
        held_joints = [
            HeldJoint(self.joint_names[k], float(value[k]), k) for k in places
        ]
        return replace(
            self,
            joints=tuple(self.joints[k] for k in moving_places),
            transmission=None,
            mechanism=mechanism,
            held=tuple(held_joints),
        )

    def leader(self, place: int) -> tuple[str, float, float]:
        """Return the joint that a joint of the tree follows: q = multiplier q_leader +
        offset.

        Parameters
        ----------
        place : int
            Index of the following joint in the tree, from 0.

        Returns
        -------
        tuple of (str, float, float)
            Name of the leading joint, multiplier, and offset [rad, m].

        Raises
        ------
        InputError
            The joint follows several joints.
        """
        assert self.mechanism is not None
        row = self.mechanism.matrix[place]
        leaders = np.flatnonzero(row)
        if len(leaders) > 1:
            what = f"joint {self.tree[place].name!r} follows several joints"
            raise InputError(
                f"{what}, for which robot files have no word", "write .json instead"
            )
        k = int(leaders[0]) if len(leaders) else 0
        return self.joint_names[k], float(row[k]), float(self.mechanism.offset[place])

    def tree_state(self, *states: ArrayLike) -> list[Array]:
        """Return states of the n driven joints as states (N, L) of all joints of the
        tree.

        ``states`` are q, or q, dq and ddq, each (N, n). Only positions have the
        mechanism's offset.
        """
        rows = [np.ascontiguousarray(np.atleast_2d(x), float) for x in states]
        m = self.mechanism
        if m is None:
            return rows
        return [
            x @ m.matrix.T + (m.offset if k == 0 else 0.0) for k, x in enumerate(rows)
        ]

    def poses(self, state: Array) -> Array:
        """Return the poses of all joint frames in the base frame.

        Parameters
        ----------
        state : (N, L) array
            Positions of the tree's joints, as :meth:`tree_state` makes them.

        Returns
        -------
        (N, L, 4, 4) array
            Homogeneous matrices of the frames, moved by their joints.
        """
        out = np.empty((*state.shape, 4, 4))
        for i, joint in enumerate(self.tree):
            parent = np.eye(4) if joint.parent < 0 else out[:, joint.parent]
            out[:, i] = parent @ joint.placement @ joint_motions(joint, state[:, i])
        return out

    @cached_property
    def joint_names(self) -> ChannelNames:
        """(n,) names of the driven joints; the joints that are held are attached."""
        names = [joint.name for joint in self.joints]
        return ChannelNames.with_held(names, self.held, self)

    @cached_property
    def position_units(self) -> tuple[str, ...]:
        """(n,) "rad" or "m" of each joint."""
        return tuple("m" if j.kind == "prismatic" else "rad" for j in self.joints)

    @cached_property
    def torque_units(self) -> tuple[str, ...]:
        """(n,) "N*m" or "N" of each joint."""
        return tuple("N" if j.kind == "prismatic" else "N*m" for j in self.joints)

    @cached_property
    def subtree(self) -> tuple[tuple[int, ...], ...]:
        """For each driven joint the indices of the links that it moves, such as ((0, 1,
        2), (1, 2), (2,)) for a chain: only their parameters make torque on it."""
        # Joints of the tree that each joint carries, itself included; children come
        # after their parents.
        carried: list[list[int]] = [[i] for i in range(len(self.tree))]
        for i in reversed(range(len(self.tree))):
            parent = self.tree[i].parent
            if parent >= 0:
                carried[parent] += carried[i]
        matrix = np.eye(self.n) if self.mechanism is None else self.mechanism.matrix
        link_by_joint = {joint: link for link, joint in enumerate(self.link_joints)}
        links_by_driven_joint = []
        for column in matrix.T:
            joints = set[int]()
            for moved in np.flatnonzero(column):
                joints.update(carried[moved])
            links = [link_by_joint[k] for k in joints if k in link_by_joint]
            links_by_driven_joint.append(tuple(sorted(links)))
        return tuple(links_by_driven_joint)

    def random_configurations(self, count: int, seed: int) -> Array:
        """Return random configurations (count, n) [rad, m], uniform in the range of
        :func:`joint_limits`.

        Parameters
        ----------
        seed : int
            Seed of the random numbers.
        """
        low, high, _ = joint_limits(self)
        return np.random.default_rng(seed).uniform(low, high, (count, self.n))

    @cached_property
    def random_states(self) -> tuple[Array, Array, Array]:
        """q, dq, ddq (K, n) at random states, enough to find which parameters are
        independent.
        """
        count = 20 * self.n + 100
        dq, ddq = np.random.default_rng(0).normal(size=(2, count, self.n))
        return self.random_configurations(count, 0), dq, ddq

    @cached_property
    def random_columns(self) -> Array:
        """(r, 10 links) upper triangle R of a QR decomposition of the regressor Y at
        :attr:`random_states`: R^T R = Y^T Y, so R shows which parameters are
        independent."""
        rows = self.regressor(*self.random_states)
        return np.asarray(np.linalg.qr(rows.reshape(-1, rows.shape[2]), mode="r"))

    def link_reach(self) -> Array:
        """Return the distance (links,) [m] from each link frame's origin to the
        farthest joint that the link bears. It is the length scale of a link that is
        otherwise unknown.

        The last link gets that of its parent.
        """
        return self._link_reach.copy()

    @cached_property
    def _link_reach(self) -> Array:
        """(links,) distance [m] from each link frame's origin to the farthest joint
        that the link bears, or to its own joint.

        A link for which that is zero, such as the last one, gets the distance of its
        parent; none is below 0.1 m.
        """
        distances = np.array(
            [np.linalg.norm(joint.link_frame[:3, 3]) for joint in self.tree]
        )
        for joint in self.tree:
            if joint.parent >= 0:
                parent_frame = self.tree[joint.parent].link_frame
                offset = np.linalg.inv(parent_frame) @ joint.placement
                distance = np.linalg.norm(offset[:3, 3])
                distances[joint.parent] = max(distances[joint.parent], distance)
        for i, joint in enumerate(self.tree):
            if distances[i] == 0.0 and joint.parent >= 0:
                distances[i] = distances[joint.parent]
        return np.maximum(distances, 0.1)[list(self.link_joints)]

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
    ) -> Self:
        """Build a chain of revolute joints from a Denavit-Hartenberg table without
        offsets.

        Parameters
        ----------
        a, alpha, d : sequence of float
            Lengths [m], twists [rad] and offsets [m], one a joint.
        convention : str
            "modified" (Craig): Rx(alpha) Tx(a) Rz(q) Tz(d), the link frame on its own joint
            axis. "standard": Rz(q) Tz(d) Tx(a) Rx(alpha), the link frame at the far end.
            InputError for any other.
        gravity : (3,) sequence
            Gravity in the base frame [m/s^2].
        limits : sequence of mappings
            Further fields of each :class:`Joint`.
        """
        if convention not in ("modified", "standard"):
            raise InputError(
                f"DH convention {convention!r} is unknown",
                "use 'modified' or 'standard'",
            )
        joints: list[Joint] = []
        for i, (a_i, alpha_i, d_i) in enumerate(zip(a, alpha, d, strict=True)):
            move = np.eye(4)
            turn = np.eye(4)
            frame = np.eye(4)
            move[:3, 3] = a_i, 0.0, d_i
            c = np.cos(alpha_i)
            s = np.sin(alpha_i)
            # Exact quarter turns: cos(pi/2) = 6e-17 would leak into the regressor's
            # structural zeros.
            c = np.round(c) if abs(c - np.round(c)) < 1e-15 else c
            s = np.round(s) if abs(s - np.round(s)) < 1e-15 else s
            turn[1:3, 1:3] = [[c, -s], [s, c]]
            # Modified: Rz and Tz commute, so that Tz(d) can come before the joint.
            placement = turn @ move
            if convention == "standard":
                placement = joints[-1].link_frame if joints else np.eye(4)
                frame = move @ turn
            joint = Joint(
                name=f"joint{i + 1}",
                kind="revolute",
                parent=i - 1,
                placement=placement,
                axis=np.eye(3)[2],
                link_frame=frame,
                **(limits[i] if limits else {}),
            )
            joints.append(joint)
        return cls(name, tuple(joints), tuple(map(float, gravity)))

    def _projected(self, torque: Array, columns: bool = False) -> Array:
        """Return torques of the driven joints (N, n, ...) from those of the tree (N, L,
        ...).

        Equal power gives tau = B^T tau_tree, with the mechanism's matrix B. With
        ``columns`` a matrix D (N, L, L) between joints becomes B^T D B.
        """
        if self.mechanism is None:
            return torque
        out = np.einsum("ln,kl...->kn...", self.mechanism.matrix, torque)
        return out @ self.mechanism.matrix if columns else out

    @property
    def _pin(self) -> Any:
        """The module Pinocchio, imported on first use."""
        from sdp_vs_penalty.robot._pinocchio import pin

        return pin

    @cached_property
    def _model(self) -> Any:
        """Pinocchio's model of the tree: joints with their placements and axes, and
        gravity; its links have no mass yet."""
        pin = self._pin
        model = pin.Model()
        model.gravity = pin.Motion(np.array(self.gravity, float), np.zeros(3))
        # Pinocchio counts joints from 1; 0 is the base.
        for joint in self.tree:
            unaligned = getattr(pin, f"JointModel{joint.kind.capitalize()}Unaligned")
            placement = pin.SE3(
                joint.placement[:3, :3].copy(), joint.placement[:3, 3].copy()
            )
            model.addJoint(
                joint.parent + 1, unaligned(joint.axis), placement, joint.name
            )
        return model

    @cached_property
    def _link_maps(self) -> Array | None:
        """(links, 10, 10) maps from link-frame to joint-frame parameters; None if all
        are identity.
        """
        frames = [self.tree[k].link_frame for k in self.link_joints]
        if all(np.array_equal(frame, np.eye(4)) for frame in frames):
            return None
        return np.stack([inertia.transform(frame) for frame in frames])

    def regressor(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Return the regressor Y of rigid-body dynamics, tau = Y theta.

        Parameters
        ----------
        q, dq, ddq : (N, n) array
            Joint positions, velocities and accelerations.

        Returns
        -------
        (N, n, 10 links) array
            Columns of the standard parameters, link by link.

        References
        ----------
        Atkeson, An, Hollerbach, IJRR 1986; computed by Pinocchio's joint torque regressor.
        """
        states = self.tree_state(q, dq, ddq)
        out = np.empty((len(states[0]), len(self.tree), 10 * len(self.tree)))
        rows = self._pin.computeJointTorqueRegressor
        model = self._model
        data = self._model.createData()
        for k, row in enumerate(zip(*states, strict=True)):
            out[k] = rows(model, data, *row)
        # (N, n, joints of the tree, 10): parameters by link, about the joints' frames.
        blocks = self._projected(out).reshape(len(out), self.n, -1, 10)
        if self.mechanism is not None:
            blocks = blocks[:, :, list(self.link_joints)]
        # From the joints' frames to the links' frames.
        if self._link_maps is not None:
            # A product a link: einsum takes six times as long, without BLAS.
            by_link = np.moveaxis(blocks, 2, 0).reshape(len(self._link_maps), -1, 10)
            mapped = (by_link @ self._link_maps).reshape(-1, len(out), self.n, 10)
            blocks = np.moveaxis(mapped, 0, 2)
        return blocks.reshape(len(out), self.n, -1)

    def pinocchio_model(self, theta: ArrayLike) -> Any:
        """Return Pinocchio's model of the tree with the links' standard parameters.

        theta (10 links,) is about the links' frames; Pinocchio takes it about the
        joints' frames, so each link is transformed (``_link_maps`` (links, 10, 10),
        None if the frames coincide).
        """
        pin = self._pin
        model = self._model.copy()
        links = np.asarray(theta, float).reshape(self.links, 10)
        if self._link_maps is not None:
            links = np.einsum("lab,lb->la", self._link_maps, links)
        for i, row in zip(self.link_joints, links, strict=True):
            has_mass = row[0] != 0.0  # FromDynamicParameters divides by it
            if has_mass:
                model.inertias[i + 1] = pin.Inertia.FromDynamicParameters(row)
            else:
                model.inertias[i + 1] = pin.Inertia(
                    0.0, np.zeros(3), inertia.inertia_matrix(row[4:])
                )
        return model

    def inverse_dynamics(
        self, theta: ArrayLike, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike
    ) -> Array:
        """Return the joint torques (N, n) [N m, N] of rigid links with the standard
        parameters theta (10 links,), by recursive Newton-Euler.

        Parameters
        ----------
        q, dq, ddq : (N, n) array
            Joint positions, velocities and accelerations.
        """
        model = self.pinocchio_model(theta)
        rnea = self._pin.rnea
        data = model.createData()
        rows = zip(*self.tree_state(q, dq, ddq), strict=True)
        return self._projected(np.stack([rnea(model, data, *row) for row in rows]))

    def inverse_dynamics_derivatives(
        self, theta: ArrayLike, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike
    ) -> tuple[Array, Array, Array]:
        """Return derivatives of the joint torques of links with the standard parameters
        theta (10 links,) by position, velocity and acceleration.

        Parameters
        ----------
        q, dq, ddq : (N, n) array
            Joint positions, velocities and accelerations.

        Returns
        -------
        tuple of (N, n, n) arrays
            d tau_i / d x_j at [k, i, j], for x = q, dq and ddq.

        References
        ----------
        Carpentier, Mansard, RSS 2018.
        """
        states = self.tree_state(q, dq, ddq)
        derive = self._pin.computeRNEADerivatives
        out = np.zeros((3, len(states[0]), len(self.tree), len(self.tree)))
        for sign, model in self._signed(theta):
            data = model.createData()
            # Views of Pinocchio's results, which each call overwrites.
            results = data.dtau_dq, data.dtau_dv, data.M
            of_model = np.empty_like(out)
            by_q, by_dq, by_ddq = of_model
            for k, row in enumerate(zip(*states, strict=True)):
                derive(model, data, *row)
                by_q[k], by_dq[k], by_ddq[k] = results
            out += sign * of_model
        by_q, by_dq, by_ddq = out
        return (
            self._projected(by_q, True),
            self._projected(by_dq, True),
            self._projected(by_ddq, True),
        )

    def placement_derivatives(
        self, theta: ArrayLike, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike
    ) -> Array:
        """Return derivatives of the joint torques of links with the standard parameters
        theta (10 links,) by the placement of each joint.

        Six virtual joints at rest (three prismatic, three revolute) stand before each
        joint; Pinocchio's derivatives by their positions are the result.

        Parameters
        ----------
        q, dq, ddq : (N, n) array
            Joint positions, velocities and accelerations.

        Returns
        -------
        (N, n, joints of the tree, 6) array
            By displacement [m] along, and rotation [rad] about, the axes of each joint's
            frame.

        References
        ----------
        Carpentier, Mansard, RSS 2018.
        """
        pin = self._pin
        state = np.array(self.tree_state(q, dq, ddq))
        # In the longer tree each joint stands behind its six virtual ones.
        rows = 7 * np.arange(len(self.tree)) + 6
        virtual = (rows[:, None] - 6 + np.arange(6)).ravel()
        states = np.zeros((3, state.shape[1], 7 * len(rows)))
        states[:, :, rows] = state
        out = np.zeros((state.shape[1], len(rows), len(virtual)))
        derivatives = np.ix_(rows, virtual)
        for sign, inertias in self._signed(theta):
            model = pin.Model()
            model.gravity = self._model.gravity
            for i, joint in enumerate(self.tree):
                # Pinocchio counts joints from 1; 0 is the base.
                parent = 0 if joint.parent == -1 else int(rows[joint.parent]) + 1
                pose = inertias.jointPlacements[i + 1]
                # Three prismatic, then three revolute joints along x, y and z.
                for k in range(6):
                    kind = (
                        pin.JointModelPrismaticUnaligned
                        if k < 3
                        else pin.JointModelRevoluteUnaligned
                    )
                    parent = model.addJoint(
                        parent, kind(np.eye(3)[k % 3]), pose, f"{joint.name} {k}"
                    )
                    pose = pin.SE3.Identity()
                place = model.addJoint(parent, inertias.joints[i + 1], pose, joint.name)
                model.inertias[place] = inertias.inertias[i + 1]
            data = model.createData()
            by_q = data.dtau_dq  # a view, which each call overwrites
            for k, row in enumerate(np.swapaxes(states, 0, 1)):
                pin.computeRNEADerivatives(model, data, *row)
                out[k] += sign * by_q[derivatives]
        return self._projected(out).reshape(len(out), self.n, len(rows), 6)

    def jacobians(self, q: ArrayLike, link: int) -> Array:
        """Return the Jacobians of a joint frame at joint positions (N, n), in world
        axes.

        Parameters
        ----------
        link : int
            Index of the joint in the tree.

        Returns
        -------
        (N, 6, n) array
            Linear, then angular velocity by joint velocity.
        """
        pin = self._pin
        model = self._model
        data = self._model.createData()
        (q,) = self.tree_state(q)
        out = np.empty((len(q), 6, len(self.tree)))
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        for k, row in enumerate(q):
            pin.computeJointJacobians(model, data, row)
            # one column comes back flat
            out[k] = np.reshape(
                pin.getJointJacobian(model, data, link + 1, frame), out[k].shape
            )
        return out if self.mechanism is None else out @ self.mechanism.matrix

    def mass_matrices(self, theta: ArrayLike, q: ArrayLike) -> Array:
        """Return the joint-space inertia matrices M(q) (N, n, n) at joint positions
        (N, n), of the standard parameters (10 links,)."""
        q = np.atleast_2d(np.asarray(q, float))
        return self.mass_and_bias(theta)(q, np.zeros_like(q))[0]

    def mass_and_bias(
        self, theta: ArrayLike
    ) -> Callable[[Array, Array], tuple[Array, Array]]:
        """Return a function that evaluates M(q) and C(q, dq) dq + g(q) of links with
        the standard parameters theta (10 links,).

        Computed by the composite rigid body and the recursive Newton-Euler algorithm.

        Returns
        -------
        callable
            Of q and dq (N, n); returns M(q) (N, n, n) and C(q, dq) dq + g(q) (N, n).

        References
        ----------
        Featherstone, "Rigid body dynamics algorithms", 2008, chapters 5 and 6.
        """
        pin = self._pin
        models = [(x, m, m.createData()) for x, m in self._signed(theta)]

        def terms(q: Array, dq: Array) -> tuple[Array, Array]:
            """Return M(q) (N, n, n) and C(q, dq) dq + g(q) (N, n)."""
            q, dq = self.tree_state(q, dq)
            mass = np.zeros((*q.shape, q.shape[1]))
            bias = np.zeros(q.shape)
            for sign, model, data in models:
                for k in range(len(q)):
                    mass[k] += sign * pin.crba(model, data, q[k])
                    bias[k] += sign * pin.nonLinearEffects(model, data, q[k], dq[k])
            return self._projected(mass, True), self._projected(bias)

        return terms

    def _signed(self, theta: ArrayLike) -> list[tuple[float, Any]]:
        """Return (sign, Pinocchio model) pairs whose signed sum has the links theta (10
        links,).

        Pinocchio divides by the mass that a joint carries, and masses of least squares
        may be negative. Results that are linear in theta are right as the difference of
        heavier links and their additional mass.
        """
        links = np.array(theta, float).reshape(-1, 10)
        if np.all(links[:, 0] > 0.0):
            return [(1.0, self.pinocchio_model(links))]
        heavy = np.zeros_like(links)
        heavy[:, 0] = 1.0 + 2.0 * np.abs(links[:, 0]).sum()
        return [
            (1.0, self.pinocchio_model(links + heavy)),
            (-1.0, self.pinocchio_model(heavy)),
        ]


def check_held(names: Sequence[str], held: Mapping[str, float]) -> tuple[int, ...]:
    """Return the indices of held joints among the driven joints.

    Parameters
    ----------
    names : sequence of str
        Names of the driven joints.
    held : mapping
        Positions [rad, m] by joint.

    Raises
    ------
    InputError
        A name is no driven joint, or every joint is held.
    """
    for name in held:
        require_known("joint", name, names, "--hold")
    if len(held) == len(names):
        remedy = "leave those that move out of --hold"
        raise InputError("every joint is held, so nothing moves", remedy)
    return tuple(k for k, name in enumerate(names) if name in held)


def joint_limits(robot: Robot) -> tuple[Array, Array, Array]:
    """Return the limits of position and velocity of each joint.

    Where a robot states none: half a turn or half a metre to each side, and 2 rad/s or
    0.5 m/s.

    Returns
    -------
    tuple of (n,) arrays
        Lower and upper position [rad, m], and velocity [rad/s, m/s].
    """
    is_revolute = np.array([j.kind == "revolute" for j in robot.joints])
    # To each side of zero [rad, m], and largest velocity [rad/s, m/s].
    default_span = np.where(is_revolute, np.pi, 0.5)
    default_velocity = np.where(is_revolute, 2.0, 0.5)
    lower = np.array([j.lower for j in robot.joints])
    upper = np.array([j.upper for j in robot.joints])
    velocity = np.array([j.velocity for j in robot.joints])
    # An end that is open is at least a whole range away from one that is given.
    lower = np.where(
        np.isfinite(lower), lower, np.minimum(-default_span, upper - 2.0 * default_span)
    )
    upper = np.where(
        np.isfinite(upper), upper, np.maximum(default_span, lower + 2.0 * default_span)
    )
    is_stated = np.isfinite(velocity) & (velocity > 0.0)
    return lower, upper, np.where(is_stated, velocity, default_velocity)
