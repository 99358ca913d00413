"""A chain of revolute joints from a DH table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.joint import Joint


def dh_joints(
    a: Sequence[float],
    alpha: Sequence[float],
    d: Sequence[float],
    convention: str,
    limits: Sequence[Mapping[str, float]] = (),
) -> tuple[Joint, ...]:
    """The joints of :meth:`Robot.from_dh`; raises InputError for another convention."""
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
            raise InputError(f"DH convention {convention!r} is unknown", "use 'modified' or 'standard'")
        extra = dict(limits[i]) if limits else {}
        joints.append(Joint(f"joint{i + 1}", "revolute", i - 1, placement, np.eye(3)[2], frame, **extra))
    return tuple(joints)


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
