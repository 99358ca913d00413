"""Decisions of this folder that are numbers: defaults that keep the feasible set of a robot without
published bounds (a URDF) bounded, each with its unit, its meaning and where it is from."""

from __future__ import annotations

#: Mass of one link [kg]: a link of no mass is not one; a file's own inertials allow three times theirs.
DEFAULT_LINK_MASS = (0.01, 100.0)
#: A link's mass lies in a ball around its frame: this times the link's reach [-], at least the radius
#: [m], since what a last link bears beyond its frame the kinematics do not say.
DEFAULT_REACH_FACTOR, DEFAULT_RADIUS = 1.5, 1.0
#: Nominal mass per length of a link about which nothing is known [kg/m].
DEFAULT_LINEAR_DENSITY = 10.0
#: Nominal density of a link of which only the geometry is known [kg/m^3]: aluminium shells and motors.
DEFAULT_DENSITY = 1500.0
#: Half axes of the body over those of the ellipsoid of uniform density that has the link's inertial [-].
INERTIAL_MARGIN = 2.0
#: Radius of the body of a link of which nothing but the joints is known, at least [m].
LEAST_UNKNOWN = 1.0
