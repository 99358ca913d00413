"""Demands on parameters as arrays: cones, and the families of constraints that use them."""

from __future__ import annotations

from sdp_vs_penalty.plugins import surface

__getattr__ = surface(
    __name__,
    {
        "Constraint": "constraint",
        "ConstraintSet": "constraint",
        "cone_margin": "cones",
        "project": "cones",
    },
)
