"""What a robot is made of: joints, gravity, and which link hangs on which joint; plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.dh import dh_joints
from sdp_vs_penalty.robot.joint import Joint, Mechanism
from sdp_vs_penalty.robot.transmission import Transmission

STANDARD_GRAVITY = (0.0, 0.0, -9.81)


@dataclass(frozen=True)
class Structure:
    """Joints (n), depth first, and the gravity vector [m/s^2] in the base frame.

    Depth first: what a joint carries follows it without a gap. Pinocchio's composite rigid body
    algorithm takes subtrees as index ranges and is silently wrong on any other order.
    mechanism : where joints follow others, ``joints`` are those that move by themselves, a joint's
    parent counts in ``tree``, and there are more links than joints: ``links`` of them.
    transmission : how the motors turn with the joints, where that is known.
    Raises InputError for joints in another order.
    """

    name: str
    joints: tuple[Joint, ...]
    gravity: tuple[float, float, float] = STANDARD_GRAVITY
    transmission: Transmission | None = None
    mechanism: Mechanism | None = None

    def __post_init__(self) -> None:
        if self.transmission is not None and self.transmission.n != self.n:
            raise InputError(
                f"robot {self.name} has {self.n} joints, its transmission {self.transmission.n} motors",
                "give one motor a joint",
            )
        names = [joint.name for joint in self.joints]
        for name in names:
            if names.count(name) > 1:
                raise InputError(
                    f"robot {self.name}: joint {name} appears {names.count(name)} times", "rename one"
                )
        if self.mechanism is not None and self.mechanism.matrix.shape[1] != self.n:
            raise InputError(
                f"robot {self.name} has {self.n} joints, its mechanism others", "give it the same joints"
            )
        open_branch: list[int] = []  # from the base to the last joint
        for i, joint in enumerate(self.tree):
            while open_branch and open_branch[-1] != joint.parent:
                open_branch.pop()
            if not open_branch and joint.parent != -1:
                raise InputError(
                    f"robot {self.name}: joint {joint.name} comes before its parent, or splits a branch",
                    "order the joints depth first",
                )
            open_branch.append(i)

    @property
    def n(self) -> int:
        """How many joints move and are driven."""
        return len(self.joints)

    @property
    def tree(self) -> tuple[Joint, ...]:
        """Every moving joint, those that follow others included (L)."""
        return self.joints if self.mechanism is None else self.mechanism.tree

    @cached_property
    def link_joints(self) -> tuple[int, ...]:
        """For each link with mass the joint of the tree that carries it."""
        massless = () if self.mechanism is None else self.mechanism.massless
        return tuple(k for k in range(len(self.tree)) if k not in massless)

    @property
    def links(self) -> int:
        """How many links have parameters: one a joint of the tree, but those declared massless."""
        return len(self.link_joints)

    @property
    def couplings(self) -> tuple[Array, ...]:
        """(n,) each axis known to turn with several joints, its first entry 1: motors and followers."""
        rows = [] if self.transmission is None else list(self.transmission.matrix)
        rows += [] if self.mechanism is None else list(self.mechanism.matrix)
        several = [row for row in rows if np.count_nonzero(row) > 1]
        return tuple(row / row[np.flatnonzero(row)[0]] for row in several)

    def leader(self, place: int) -> tuple[str, float, float]:
        """Whom a joint of the tree follows, by what multiplier and offset. InputError for several."""
        assert self.mechanism is not None
        row = self.mechanism.matrix[place]
        leaders = np.flatnonzero(row)
        if len(leaders) > 1:
            raise InputError(
                f"joint {self.tree[place].name!r} follows several joints, for which robot files have "
                "no word",
                "write .json instead",
            )
        k = int(leaders[0]) if len(leaders) else 0
        return self.joint_names[k], float(row[k]), float(self.mechanism.offset[place])

    def tree_state(self, *states: ArrayLike) -> list[Array]:
        """q, or q, dq, ddq (N, n) as those of every joint of the tree (N, L)."""
        rows = [np.ascontiguousarray(np.atleast_2d(x), float) for x in states]
        m = self.mechanism
        if m is None:
            return rows
        return [x @ m.matrix.T + (m.offset if k == 0 else 0.0) for k, x in enumerate(rows)]

    def poses(self, state: Array) -> Array:
        """(N, L, 4, 4) poses in the base of all joint frames of the tree, moved by their joints.

        state : (N, L) as :meth:`tree_state` makes it.
        """
        out = np.empty((*state.shape, 4, 4))
        for i, joint in enumerate(self.tree):
            move, value = np.tile(np.eye(4), (len(state), 1, 1)), state[:, i, None]
            if joint.kind == "prismatic":
                move[:, :3, 3] = value * joint.axis
            else:
                k, value = np.cross(np.eye(3), joint.axis), value[:, None]  # k v = axis x v
                move[:, :3, :3] += np.sin(value) * k + (1.0 - np.cos(value)) * (k @ k)
            parent = np.eye(4) if joint.parent < 0 else out[:, joint.parent]
            out[:, i] = parent @ joint.placement @ move
        return out

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """(n,) the names of the driven joints."""
        return tuple(joint.name for joint in self.joints)

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
        """For each joint the links that it moves: only their parameters make torque on it."""
        carried: list[list[int]] = [[i] for i in range(len(self.tree))]
        for i in reversed(range(len(self.tree))):
            if self.tree[i].parent >= 0:
                carried[self.tree[i].parent] += carried[i]
        moves = np.eye(self.n) if self.mechanism is None else self.mechanism.matrix
        moved = [{k for i in np.flatnonzero(column) for k in carried[i]} for column in moves.T]
        link = {joint: place for place, joint in enumerate(self.link_joints)}
        return tuple(tuple(sorted(link[k] for k in m if k in link)) for m in moved)

    def random_configurations(self, count: int, seed: int) -> Array:
        """(count, n) positions, uniform inside the joint range (or +-pi rad, +-1 m where open)."""
        span = [np.pi if j.kind == "revolute" else 1.0 for j in self.joints]
        low = [j.lower if np.isfinite(j.lower) else -s for j, s in zip(self.joints, span, strict=True)]
        high = [j.upper if np.isfinite(j.upper) else s for j, s in zip(self.joints, span, strict=True)]
        return np.random.default_rng(seed).uniform(low, high, (count, self.n))

    def link_reach(self) -> Array:
        """(links,) distance [m] from each link frame's origin to the farthest joint that the link bears.

        A length scale for links of which nothing else is known; the last link gets that of its
        parent.
        """
        reach = np.zeros(len(self.tree))
        for joint in self.tree:
            if joint.parent >= 0:
                frame = self.tree[joint.parent].link_frame
                offset = np.linalg.inv(frame) @ joint.placement
                reach[joint.parent] = max(reach[joint.parent], np.linalg.norm(offset[:3, 3]))
        for i, joint in enumerate(self.tree):
            own = float(np.linalg.norm(joint.link_frame[:3, 3]))
            reach[i] = max(reach[i], own)
            if reach[i] == 0.0 and joint.parent >= 0:
                reach[i] = reach[joint.parent]
        return np.maximum(reach, 0.1)[list(self.link_joints)]

    def to_dict(self) -> dict[str, Any]:
        """Plain lists and numbers; :meth:`from_dict` restores the same robot to the last bit."""
        out: dict[str, Any] = {
            "name": self.name,
            "gravity": list(self.gravity),
            "joints": [joint.to_dict() for joint in self.joints],
        }
        if self.transmission is not None:
            out["transmission"] = self.transmission.to_dict()
        if self.mechanism is not None:
            out["mechanism"] = {
                "tree": [joint.to_dict() for joint in self.mechanism.tree],
                "matrix": self.mechanism.matrix.tolist(),
                "offset": self.mechanism.offset.tolist(),
                "massless": list(self.mechanism.massless),
            }
        return out

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """What :meth:`to_dict` wrote; KeyError, TypeError or InputError for anything else."""
        joints = tuple(map(Joint.from_dict, data["joints"]))
        given, moved = data.get("transmission"), data.get("mechanism")
        transmission = None if given is None else Transmission.from_dict(given)
        mechanism = None
        if moved is not None:
            mechanism = Mechanism(
                tuple(map(Joint.from_dict, moved["tree"])),
                np.array(moved["matrix"], float),
                np.array(moved["offset"], float),
                tuple(int(k) for k in moved["massless"]),
            )
        return cls(data["name"], joints, _vector3(data["gravity"]), transmission, mechanism)

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
        """A chain of revolute joints from a DH table without joint offsets.

        convention "modified" (Craig): Rx(alpha) Tx(a) Rz(q) Tz(d), the link frame on its own joint
        axis; "standard": Rz(q) Tz(d) Tx(a) Rx(alpha), the link frame at the link's far end.
        """
        joints = dh_joints(a, alpha, d, convention, limits)
        return cls(name, joints, _vector3(gravity))


def _vector3(values: Sequence[float]) -> tuple[float, float, float]:
    if len(values) != 3 or not np.all(np.isfinite(values)):
        raise InputError(f"gravity {values!r} is not three finite numbers", "write x,y,z in m/s^2")
    x, y, z = (float(v) for v in values)
    return x, y, z
