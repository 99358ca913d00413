"""What repeats and has no name: the missing torque as a measured function of one
variable or two."""
