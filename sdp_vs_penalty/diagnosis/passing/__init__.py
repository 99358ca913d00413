"""What acts for a part of the runs only: a load that is carried, a force, a torque."""
