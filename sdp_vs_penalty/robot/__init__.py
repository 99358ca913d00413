"""The arm itself: kinematics, inertia (the parameter order), constraints, URDF files, trajectories."""

from sdp_vs_penalty.plugins import surface

__getattr__ = surface(
    __name__,
    {
        "Body": "body",
        "Constraint": "constraint",
        "ConstraintSet": "constraint",
        "FourierTrajectory": "trajectory",
        "Joint": "joint",
        "Robot": "robot",
        "cone_margin": "constraint",
        "joint_limits": "robot",
        "load_urdf": "urdf",
        "parse_transmission": "joint",
        "project": "constraint",
        "random_trajectory": "trajectory",
    },
)
