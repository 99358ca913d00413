"""The arm itself: kinematics, inertia (the parameter order), constraints, URDF files,
trajectories."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    body="Body",
    constraint="Constraint ConstraintSet cone_margin project",
    trajectory="FourierTrajectory random_trajectory",
    joint="Joint parse_transmission",
    robot="Robot joint_limits",
    urdf="load_urdf",
)
