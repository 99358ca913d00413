"""Rotations in the ways that robots' files write them, and the motion of a joint."""

from collections.abc import Sequence

import numpy as np

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.joint import Joint


def rotation_of_rpy(angles: Sequence[float] | Array) -> Array:
    """Return R = Rz(yaw) Ry(pitch) Rx(roll).

    Parameters
    ----------
    angles : (3,) sequence
        Roll, pitch and yaw [rad].
    """
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles), np.sin(angles)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rpy_of(rotation: Array) -> Array:
    """Return roll, pitch and yaw (3,) [rad] of R = Rz(yaw) Ry(pitch) Rx(roll), (3, 3).

    They reproduce R up to rounding, also at a pitch of 90 degrees, where roll and yaw
    turn about the same axis: the roll is computed after yaw and pitch are undone, so
    that it makes up for the rounding of the yaw.
    """
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    y_after_yaw = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    roll = np.arctan2(-y_after_yaw @ rotation[:, 2], y_after_yaw @ rotation[:, 1])
    return np.array([roll, pitch, yaw])


def rotation_of_quaternion(vector: Array, scalar: float) -> Array:
    """Return R = 1 + 2 w k + 2 k k (3, 3) of a quaternion of any length: w its scalar, k
    the cross product by its vector (3,), both over that length.
    """
    quaternion = np.append(vector, scalar)
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * k + 2.0 * k @ k


def joint_motions(joint: Joint, values: Array) -> Array:
    """Return the poses (N, 4, 4) of a link in its joint frame at positions (N,) [rad, m]
    of the joint, by Rodrigues' formula with k v = axis x v.
    """
    out = np.tile(np.eye(4), (len(values), 1, 1))
    if joint.kind == "prismatic":
        out[:, :3, 3] = values[:, None] * joint.axis
    else:
        k = np.cross(np.eye(3), joint.axis)
        angle = values[:, None, None]
        out[:, :3, :3] += np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k)
    return out


def joint_motion(joint: Joint, value: float) -> Array:
    """Return the pose (4, 4) of a link in its joint frame at one position [rad, m]."""
    return joint_motions(joint, np.array([value]))[0]
