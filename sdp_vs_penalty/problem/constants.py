"""Decisions of this folder that are numbers: defaults that keep the feasible set of a
robot without published bounds (a URDF) bounded, each with its unit, its meaning and
where it is from."""

#: Mass of one link [kg]: a link of no mass is not one; a file's own inertials allow
#: three times theirs.
DEFAULT_LINK_MASS = (0.01, 100.0)
#: Radius of a link where nothing tells it: this share of its reach [-], at least so
#: much [m].
RADIUS_SHARE = 0.5
LEAST_RADIUS = 0.1
#: A link's mass lies in a ball around its frame: its reach and its radius, at least so
#: much [m], since what a last link bears beyond its frame the kinematics do not say.
DEFAULT_RADIUS = 1.0
#: A link of which nothing but the joints is known: a tube [kg/m], and actuators of 1.6 kg at 54 N m and
#: 6.2 kg at 330 N m, mass = 0.08 kg (torque / N m)^(3/4): joints of UR and xArm arms, makers' figures.
TUBE = 4.0
ACTUATOR = (0.08, 0.75)
#: Torque of a joint of unknown limit: three times what holds 10 kg/m from there to the
#: tip [N m/m^2]; beyond so much [N m] the rule for actuators is not known.
HOLDING = 3.0 * 0.5 * 10.0 * 9.81
LARGEST = 1000.0
#: Nominal density of a link of which only the geometry is known [kg/m^3]: aluminium
#: shells and motors.
DEFAULT_DENSITY = 1500.0
#: Half thickness of the thinnest link, over its length: of a link whose file has moments
#: that no body has.
THINNEST = 0.05
#: A mass so many times its nominal value, or less than one part in so many of it, is
#: far from it [-]; so is a length of so many robots, which is not in metres.
FAR_MASS = 3.0
#: Half axes of the body over those of the ellipsoid of uniform density that has the
#: link's inertial [-].
INERTIAL_MARGIN = 2.0
#: The same over those of the ellipsoid around the link's geometry [-], and a layer on
#: it [m].
GEOMETRY_MARGIN = 1.2
LAYER = 0.03
