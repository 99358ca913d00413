"""A moving joint with its link, joints that follow others (mimic joints, closed
chains), transmissions.

Motor positions are a linear function of joint positions, q_m = A q + b. Power is the
same on both sides, so that torques go the other way, tau = A^T tau_m. A row of A with
several entries is a motor that drives through the gears of other joints: a coupled
wrist, a differential, a parallelogram.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.robot.arrays import Array, check_finite


@dataclass(frozen=True)
class Joint(JsonRecord):
    """One moving joint and the link that it carries."""

    skips_null = True

    #: Name of the joint.
    name: str
    #: "revolute" or "prismatic".
    kind: str
    #: Index of the joint that carries it; -1 for the base.
    parent: int
    #: (4, 4) pose of the joint frame in the parent's joint frame at q = 0.
    placement: Array
    #: (3,) unit vector of motion in the joint frame.
    axis: Array
    #: (4, 4) pose of the link frame in the joint frame; the link's inertial parameters
    #: are about the link frame (identity for URDF and modified DH, Tz(d) Tx(a)
    #: Rx(alpha) for standard DH, whose frames sit at the far end of a link).
    link_frame: Array
    #: Lower end of the range [rad or m].
    lower: float = -np.inf
    #: Upper end of the range [rad or m].
    upper: float = np.inf
    #: Limit of the velocity [rad/s or m/s].
    velocity: float = np.inf
    #: Limit of the torque or force [N m or N].
    effort: float = np.inf

    def __post_init__(self) -> None:
        """Raise InputError for frames that are no poses, an axis that is no unit
        vector, an unknown kind, or a lower limit above the upper one."""
        if not (isinstance(self.name, str) and self.name):
            raise InputError(f"a joint's name is {self.name!r}", "give it as text")
        place = f"joint {self.name}"
        for name, shape in (
            ("placement", (4, 4)),
            ("axis", (3,)),
            ("link_frame", (4, 4)),
        ):
            check_finite(f"{place}: {name}", getattr(self, name), shape)
        for name in ("placement", "link_frame"):
            check_pose(f"{place}: {name}", getattr(self, name))
        # 1e-9 allows for rounding.
        if abs(np.linalg.norm(self.axis) - 1.0) > 1e-9:
            raise InputError(
                f"{place}: the axis is no unit vector", "divide it by its length"
            )
        if self.kind not in ("revolute", "prismatic"):
            raise InputError(
                f"{place}: kind {self.kind!r} is unknown", "write revolute or prismatic"
            )
        # "not <=" also refuses nan.
        if not self.lower <= self.upper:
            what = f"the lower limit {self.lower:g} is above the upper {self.upper:g}"
            raise InputError(f"{place}: {what}", "swap them")


def check_pose(where: str, pose: Array) -> None:
    """Raise InputError for a matrix that is no pose, or lies beyond a robot's size.

    Parameters
    ----------
    where : str
        Where the matrix stands, for the error's sentence.
    pose : (4, 4) array
        Homogeneous matrix, translation in metres.
    """
    rotation = pose[:3, :3]
    tolerance = 1e-6
    largest = 1e9
    if np.any(np.abs(pose[:3]) > largest):
        raise InputError(
            f"{where} holds numbers beyond {largest:g}", "write it in metres"
        )
    is_rotation = (
        np.allclose(rotation @ rotation.T, np.eye(3), atol=tolerance)
        and np.linalg.det(rotation) > 0.0
        and np.allclose(pose[3], [0.0, 0.0, 0.0, 1.0], atol=tolerance)
    )
    if not is_rotation:
        raise InputError(
            f"{where} is no rotation with a shift",
            "make its columns a right-hand frame",
        )


@dataclass(frozen=True)
class Mechanism(JsonRecord):
    """Joints that follow others: q_tree = matrix q + offset, so that tau = matrix^T
    tau_tree.

    Mimic joints follow, and those of closed chains whose loop is cut (a parallelogram's
    bars turn as its driven joints do).
    """

    #: Every moving joint (L), depth first.
    tree: tuple[Joint, ...]
    #: (L, n) motion of each joint of the tree per motion of each driven joint.
    matrix: Array
    #: (L,) position of each joint of the tree [rad or m] at q = 0.
    offset: Array
    #: Places in the tree of links that are declared to have no mass, and get no
    #: parameters.
    massless: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Raise InputError for a matrix that is not (L, n), an offset that is not (L,),
        or if every one of the L links is declared massless."""
        L = len(self.tree)
        n = np.shape(self.matrix)[-1]
        check_finite(f"the matrix of a mechanism of {L} joints", self.matrix, (L, n))
        check_finite(f"the offset of a mechanism of {L} joints", self.offset, (L,))
        if not set(self.massless) < set(range(L)):
            remedy = "leave those with a mass out of massless"
            raise InputError("every link is declared massless", remedy)


@dataclass(frozen=True)
class HeldJoint(JsonRecord):
    """A joint that does not move, and is none of the robot's any more: what it carried
    belongs to its parent."""

    #: Name of the joint in the robot's file.
    name: str
    #: Position at which it stands [rad or m].
    value: float
    #: Its column in a log of all driven joints, from 0.
    place: int


class ChannelNames(tuple[str, ...]):
    """Names of the driven joints in order; ``held`` are joints that a log may hold
    besides. ``robot`` is the :class:`Robot` that tells what a channel is, ``links`` its
    nominal links (n, 10), None where these are not known."""

    held: tuple[HeldJoint, ...] = ()
    robot: Any = None
    links: Any = None

    @classmethod
    def with_held(
        cls,
        names: Sequence[str],
        held: Sequence[HeldJoint],
        robot: Any = None,
        links: Any = None,
    ) -> "ChannelNames":
        """Return a list of the driven joints' names that also holds, as its attribute
        ``held``, the joints that stand still: readers of logs leave out their channels.
        """
        out = cls(names)
        out.held, out.robot, out.links = tuple(held), robot, links
        return out


#: A joint that follows: the joint that it follows, by name, multiplier and offset.
Follower = tuple[str, float, float]


def resolve_mimic_joints(
    tree: Sequence[Joint], followers: dict[str, Follower], massless: Sequence[int]
) -> tuple[tuple[Joint, ...], Mechanism | None]:
    """Return the independent joints of a tree with mimic joints, and how the tree
    follows them.

    A mimic joint has the position q = ratio * q_leader + offset; its leader may be a
    mimic joint too.

    Parameters
    ----------
    tree : sequence of Joint
        All moving joints, depth first.
    followers : dict
        (leader, ratio, offset) of each mimic joint, by its name.
    massless : sequence of int
        Links without mass, by number in the tree from 0.

    Returns
    -------
    tuple
        Independent joints, and the mechanism; None if no joint follows another.

    Raises
    ------
    InputError
        If a joint follows itself, directly or through others, or an unknown joint.
    """
    if not followers and not massless:
        return tuple(tree), None
    driven = [joint for joint in tree if joint.name not in followers]
    column_of = {joint.name: k for k, joint in enumerate(driven)}
    matrix = np.zeros((len(tree), len(driven)))
    offset = np.zeros(len(tree))
    for k, joint in enumerate(tree):
        # q_k = ratio q_name + shift, with ``name`` from leader to leader.
        name, ratio, shift = joint.name, 1.0, 0.0
        passed = set[str]()
        while name in followers:
            if name in passed:
                what = f"joint {joint.name!r} mimics itself through others"
                raise InputError(what, "correct its <mimic>")
            passed.add(name)
            leader, its_ratio, its_offset = followers[name]
            if leader not in followers and leader not in column_of:
                what = (
                    f"joint {name!r} mimics {leader!r}, which is no moving joint of the"
                    " robot"
                )
                raise InputError(what, "correct its <mimic>")
            shift += ratio * its_offset
            ratio *= its_ratio
            name = leader
        matrix[k, column_of[name]] = ratio
        offset[k] = shift
    mechanism = Mechanism(tuple(tree), matrix, offset, massless=tuple(massless))
    return tuple(driven), mechanism


def hold_followers(
    held: Mapping[str, float], followers: Mapping[str, Follower]
) -> dict[str, float]:
    """Return the positions of held joints and of all mimic joints that follow them.

    A mimic joint stands at ratio * (position of its leader) + offset.

    Parameters
    ----------
    held : mapping
        Positions [rad, m] of held joints, by name.
    followers : mapping
        Leader, ratio and offset [rad, m] of each mimic joint, by name.

    Returns
    -------
    dict
        Positions [rad, m] by name.
    """
    positions = dict(held)
    for _ in followers:  # a follower may follow a follower
        for name, (leader, ratio, offset) in followers.items():
            if leader in positions:
                positions[name] = ratio * positions[leader] + offset
    return positions


def parse_held(text: str | Sequence[str]) -> dict[str, float]:
    """Parse the joints that are held still, such as "finger_joint=0,wheel=0.1".

    Parameters
    ----------
    text : str or sequence of str
        NAME=POSITION [rad, m] of each joint, separated by commas or in a sequence.

    Returns
    -------
    dict
        Positions [rad, m] by name.

    Raises
    ------
    InputError
        A part of the text is not NAME=NUMBER.

    Examples
    --------
    >>> parse_held("finger_joint=0")
    {'finger_joint': 0.0}
    """
    words = text.split(",") if isinstance(text, str) else text
    held = {}
    for word in words:
        name, equals, value = word.strip().rpartition("=")
        try:
            held[name] = float(value)
        except ValueError:
            equals = ""
        if not (equals and name and np.isfinite(held[name])):
            remedy = "write a joint's name and where it stands, like finger_joint=0"
            raise InputError(f"--hold {word.strip()[:60]!r}", remedy)
    return held


def parse_mechanism(
    tree: Sequence[Joint], formulas: Sequence[str], massless: Sequence[int] = ()
) -> tuple[tuple[Joint, ...], Mechanism]:
    """Parse each tree joint's position as a formula of the independent joints q1, q2,
    ....

    Parameters
    ----------
    tree : sequence of Joint
        All joints of the tree, also those that follow others.
    formulas : sequence of str
        One formula for each joint of the tree, such as "q1" or "-q2 + 0.1". For each
        independent joint one formula is that joint itself.
    massless : sequence of int
        Links without mass, by number in the tree, from 1.

    Returns
    -------
    tuple
        The independent joints, and the mechanism.

    Raises
    ------
    InputError
        A formula is not a sum of joints, an independent joint is missing, or a number of
        formulas or links does not fit the tree.
    """
    if len(formulas) != len(tree):
        what = f"mechanism: {len(formulas)} formulas, the tree has {len(tree)} joints"
        raise InputError(what, "write one a joint")
    # A row of (factors of q1, q2, ..., constant) for each joint of the tree.
    rows = np.array([parse_formula(text, len(tree)) for text in formulas])
    # Independent joints: up to the highest number that a formula names.
    n = int(np.flatnonzero(rows[:, :-1].any(axis=0)).max(initial=-1)) + 1
    # same[i, k]: joint i of the tree is the independent joint k itself.
    same = (rows[:, None] == np.eye(len(rows) + 1)[:n]).all(axis=2)
    for k in np.flatnonzero(~same.any(axis=0)):
        raise InputError(
            f"mechanism: no joint is q{k + 1} itself", f'write "q{k + 1}" for one'
        )
    first_same = same.argmax(axis=0).tolist()
    if not all(1 <= k <= len(tree) for k in massless):
        what = "mechanism: massless names a link that is not there"
        raise InputError(what, f"choose from 1 to {len(tree)}")
    places = tuple(sorted({k - 1 for k in massless}))
    return tuple(tree[k] for k in first_same), Mechanism(
        tuple(tree), matrix=rows[:, :n], offset=rows[:, -1], massless=places
    )


#: The sides on which a channel can be logged.
SIDES = ("motor", "joint")
_TERM = re.compile(
    r"\s*([+-])?\s*(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+)?\s*\*?\s*(?:q([1-9]\d{0,2}))?"
)


class ChannelMatrices(NamedTuple):
    """Matrices of a transmission, with joint positions q and motor torques tau_m."""

    #: (n, n) S in position channels = S q + offset.
    from_joint_positions: Array
    #: (n, n) T in torque channels = T tau_m.
    from_motor_torques: Array


@dataclass(frozen=True)
class Transmission(JsonRecord):
    """q_m = matrix q + offset, tau = matrix^T tau_m."""

    #: (n, n) motor units per joint unit, a row a motor.
    matrix: Array
    #: (n,) positions of the motors at q = 0 [rad, m].
    offset: Array
    #: n words, "motor" or "joint": the side on which logs have each position.
    positions: tuple[str, ...]
    #: n words, "motor" or "joint": the side on which logs have each torque.
    torques: tuple[str, ...]

    def __post_init__(self) -> None:
        """Raise InputError for a matrix that is not (n, n), an offset that is not (n,),
        sides that are not n words "motor" or "joint", or motors that do not determine
        the joints."""
        n = len(self.matrix)
        check_finite(f"the matrix of a transmission of {n} motors", self.matrix, (n, n))
        check_finite(f"the offset of a transmission of {n} motors", self.offset, (n,))
        for name, sides in (("positions", self.positions), ("torques", self.torques)):
            if len(sides) != n or not set(sides) <= set(SIDES):
                what = f"transmission: {name} does not fit {n} motors"
                raise InputError(what, "write motor or joint for each")
        rows = np.linalg.norm(self.matrix, axis=1)
        # Condition number from which the joints do not follow from the motors.
        matrices = self._channel_matrices
        if not np.all(rows > 0.0) or any(np.linalg.cond(m) > 1e9 for m in matrices):
            what = "transmission: the joints do not follow from the motors"
            raise InputError(what, "give independent motors")

    def at_motors(self, *, joint_torque: bool) -> "Transmission":
        """Return it for logs of motors, where it does not say which channels are theirs;
        with ``joint_torque`` the torques are the joints' already, whatever it says."""
        out = self
        if "motor" not in {*self.positions, *self.torques}:
            motors = ("motor",) * self.n
            out = replace(self, positions=motors, torques=motors)
        return replace(out, torques=("joint",) * self.n) if joint_torque else out

    @property
    def n(self) -> int:
        """Number of joints, motors and channels."""
        return len(self.matrix)

    @property
    def _channel_matrices(self) -> ChannelMatrices:
        """Matrices from the joints' positions, and from the motors' torques, to what
        the channels log.

        A channel on the joint's side has a row of the unit matrix for positions, and of
        matrix^T for torques (tau = matrix^T tau_m).
        """
        at_motor = np.array([self.positions]).T == "motor"  # (n, 1), one flag a row
        torque_at_motor = np.array([self.torques]).T == "motor"
        unit = np.eye(self.n)
        return ChannelMatrices(
            from_joint_positions=np.where(at_motor, self.matrix, unit),
            from_motor_torques=np.where(torque_at_motor, unit, self.matrix.T),
        )

    def joint_positions(self, channels: ArrayLike, rates: bool = False) -> Array:
        """Return joint positions from logged motor or joint channels (N, n).

        Parameters
        ----------
        rates : bool
            Whether the channels are velocities; offsets are left out then.

        Returns
        -------
        (N, n) array
            Joint positions [rad, m] or velocities.
        """
        at_motor = np.array(self.positions) == "motor"
        offset = np.where(at_motor & (not rates), self.offset, 0.0)
        S = self._channel_matrices.from_joint_positions
        return np.linalg.solve(S, (np.asarray(channels) - offset).T).T

    def joint_torques(self, channels: ArrayLike) -> Array:
        """Return joint torques from logged motor or joint torques.

        At each instant the channels are T tau_m, with tau_m the motors' torques. A row
        of T is of the unit matrix where a channel logs its motor, else of matrix^T.
        The joint torques are tau = matrix^T tau_m = matrix^T T^-1 channels.

        Parameters
        ----------
        channels : (N, n) array
            Logged torques, each of a motor or of a joint, as ``torques`` says.

        Returns
        -------
        (N, n) array
            Joint torques [N m, N].
        """
        T = self._channel_matrices.from_motor_torques
        motor_torques = np.linalg.solve(T, np.asarray(channels, float).T)  # (n, N)
        return (self.matrix.T @ motor_torques).T


def parse_transmission(
    motors: Sequence[str],
    positions: Sequence[str] = ("motor",),
    torques: Sequence[str] = ("motor",),
) -> Transmission:
    """Parse a transmission from each motor's position as a formula of the joints'
    positions.

    Parameters
    ----------
    motors : sequence of str
        One formula for each motor, such as "32 q5 + 32 q6 - 0.1".
    positions, torques : sequence of str
        The side on which each position and torque channel is logged, "motor" or "joint";
        one word stands for all channels.

    Returns
    -------
    Transmission
        Its matrix, offsets and sides.

    Raises
    ------
    InputError
        A formula is not a sum of joints, or the joints do not follow from the motors.

    Examples
    --------
    >>> parse_transmission(["50q1", "q1 - 2*q2 + 0.5"]).matrix
    array([[50.,  0.],
           [ 1., -2.]])
    """
    n = len(motors)
    rows = [parse_formula(text, n) for text in motors]
    # One word stands for all channels.
    sides = [tuple(s) * n if len(s) == 1 else tuple(s) for s in (positions, torques)]
    matrix = np.array([row[:n] for row in rows]).reshape(n, n)
    return Transmission(matrix, np.array([row[n] for row in rows]), *sides)


def parse_formula(text: str, n: int) -> Array:
    """Parse a linear formula of joint positions, such as "32 q5 + 32 q6 - 0.1".

    Returns
    -------
    (n + 1,) array
        The factors of q1 ... qn, then the constant.

    Raises
    ------
    InputError
        The text is not such a sum, or names a joint above n.
    """
    out = np.zeros(n + 1)
    place = 0
    while place < len(text.rstrip()):
        match = _TERM.match(text, place)
        sign, number, joint = match.groups() if match else (None, None, None)
        if (
            match is None
            or (number is None and joint is None)
            or (place > 0 and sign is None)
        ):
            raise InputError(
                f"{text[:60]!r} is no sum of joints",
                "write one like 32 q5 + 32 q6 - 0.1",
            )
        if joint is not None and int(joint) > n:
            what = f"{text[:60]!r} names joint {joint}, there are {n}"
            raise InputError(what, f"choose from q1 to q{n}")
        value = float(number or 1.0) * (-1.0 if sign == "-" else 1.0)
        # The last place is the constant's.
        out[n if joint is None else int(joint) - 1] += value
        place = match.end()
    return out
