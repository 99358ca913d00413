"""The arm itself: kinematics, inertia (the parameter order), URDF files, trajectories."""
