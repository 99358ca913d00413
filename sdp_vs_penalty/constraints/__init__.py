"""Demands on parameters as arrays: cones, and the families of constraints that use them."""
