"""The arm itself: kinematics, inertia (the parameter order), URDF files, trajectories."""

from __future__ import annotations

from sdp_vs_penalty.plugins import surface

__getattr__ = surface(
    __name__,
    {
        "Body": "body",
        "FourierTrajectory": "trajectory",
        "Joint": "joint",
        "Robot": "robot",
        "joint_limits": "trajectory",
        "load_urdf": "urdf",
        "parse_transmission": "transmission",
        "random_trajectory": "trajectory",
    },
)
