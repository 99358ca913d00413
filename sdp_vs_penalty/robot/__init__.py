"""The arm itself: kinematics, inertia (the parameter order), constraints, URDF files,
trajectories."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    body="around Body directions",
    constraint=(
        "cone_depths cone_margin Constraint ConstraintSet project projected_rows "
        "safe_depth smallest_eigenvalue"
    ),
    trajectory="FourierTrajectory random_trajectory",
    joint="Joint SIDES Transmission parse_transmission",
    robot="joint_limits Robot",
    urdf="load_urdf",
    geometry="Geometry link_geometry link_surfaces self_collision",
    isolated="parse_isolated ParserEndedError",
    mesh="read_mesh",
    mjcf="load_mjcf",
    robot_file="as_urdf load_robot RobotFile",
    plausible_units="LinkSizes odd_units",
    arrays="Array",
)
