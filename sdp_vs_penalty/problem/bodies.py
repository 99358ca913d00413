"""Where each link's mass can be: from its geometry, stated bounds, its inertial, or the
kinematics.

Generous on purpose, because a body that is too small makes the truth infeasible. The
margins: 20 % and 3 cm around geometry (a shell leaves cables and screws out), twice the
ellipsoid of uniform density that has a link's inertial, and balls around the joints
that it bears and the corners of its bounds, of at least 10 cm, or 1 m where nothing but
the joints is known. Nominal links are a plausible arm, known before anything is
measured: never published estimates.
"""

from collections.abc import Sequence

import numpy as np

from sdp_vs_penalty.problem import constants as c
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.body import Body, around, balls
from sdp_vs_penalty.robot.geometry import Geometry
from sdp_vs_penalty.robot.joint import Joint
from sdp_vs_penalty.robot.robot import Robot


def link_bodies(
    robot: Robot,
    centres: Array,
    nominal: Array,
    geometry: Sequence[Geometry | None] | None = None,
) -> tuple[Body, ...]:
    """Return the ellipsoid in which each link's mass lies, from the best that is known.

    In this order: its geometry, bounds of its centre of mass, its inertial, the joints.

    Parameters
    ----------
    centres : (n, 3, 2) array
        Bounds of the centres of mass [m], infinite where open.
    nominal : (n, 10) array
        Standard parameters from the robot's file, zeros where it has none.
    geometry : sequence, optional
        Points and volume of each link's geometry, None for a link without any.

    Returns
    -------
    tuple of Body
        (n,) in the links' frames.
    """
    reach = robot.link_reach()
    largest = c.FAR_MASS * max(float(reach.sum()), 1.0)
    bodies = []
    for k in range(robot.links):
        shape = None if geometry is None else geometry[k]
        ellipsoid = _uniform_ellipsoid(nominal[k], largest)
        corners = np.array(np.meshgrid(*centres[k])).reshape(3, -1).T
        if shape is not None and _is_usable(shape, largest):
            body = _body_of_geometry(shape, ellipsoid)
        elif np.all(np.isfinite(corners)):
            places = np.concatenate([corners, joint_places(robot, k)])
            radius = max(c.RADIUS_SHARE * reach[k], c.LEAST_RADIUS)
            body = around(balls(places, radius), "bounds")
        elif ellipsoid is not None:
            body = _body_of_inertial(ellipsoid, joint_places(robot, k))
        else:
            radius = max(reach[k], c.DEFAULT_RADIUS)
            body = around(balls(joint_places(robot, k), radius), "kinematics")
        bodies.append(body)
    return tuple(bodies)


def _is_usable(shape: Geometry, largest: float) -> bool:
    """Return whether a link's geometry can hold its mass: what lies farther off than
    ``largest`` [m] is in other units, what is flat is a mere marker."""
    extent = np.ptp(shape.points, axis=0).max()
    distance = np.linalg.norm(shape.points, axis=1).max()
    return bool(extent > c.LAYER and distance < largest)


def _body_of_geometry(shape: Geometry, ellipsoid: Array | None) -> Body:
    """Return the body around a link's geometry, and around the points (m, 3) [m] of the
    ellipsoid that its nominal inertial has, if there is one."""
    points = shape.points
    if ellipsoid is not None:
        points = np.concatenate([points, ellipsoid])
    volume = shape.volume if shape.volume > 0.0 else None
    return around(points, "geometry", c.GEOMETRY_MARGIN, c.LAYER, volume)


def _body_of_inertial(ellipsoid: Array, joints: Array) -> Body:
    """Return the body around the enlarged ellipsoid of a link's nominal inertial, points
    (m, 3) [m], and around balls at its joints (k, 3) and at the ellipsoid's ends, since a
    body is nowhere thinner than these."""
    centre = ellipsoid.mean(axis=0)
    enlarged = centre + c.INERTIAL_MARGIN * (ellipsoid - centre)
    near_points = balls(np.concatenate([joints, ellipsoid]), c.LEAST_RADIUS)
    return around(np.concatenate([enlarged, near_points]), "inertial")


def joint_places(robot: Robot, link: int) -> Array:
    """Return points of the joints that a link connects, over their strokes.

    A frame may be anywhere on its joint's axis, so that the foot of the parent's origin
    on the link's own axis counts as well: there the axis leaves the parent's body.

    Returns
    -------
    (k, 3) array
        Points in the link frame [m].
    """
    carrier = robot.link_joints[link]
    own_joint = robot.tree[carrier]
    into_link = np.linalg.inv(own_joint.link_frame)
    # Along the axis, from the foot of the parent's origin to the frame [m].
    placement = own_joint.placement
    from_parent = float(own_joint.axis @ placement[:3, :3].T @ placement[:3, 3])
    places: list[Array] = [
        -s * own_joint.axis for s in (from_parent, *_ends_of_stroke(own_joint))
    ]
    for child in robot.tree:
        if child.parent == carrier:
            axis = child.placement[:3, :3] @ child.axis
            places += [
                child.placement[:3, 3] + s * axis for s in _ends_of_stroke(child)
            ]
    in_link_frame = np.array(places) @ into_link[:3, :3].T + into_link[:3, 3]
    origin = np.zeros((1, 3))
    return np.concatenate([origin, in_link_frame])


def _ends_of_stroke(joint: Joint) -> list[float]:
    """Return zero, and the finite limits of a sliding joint [m]."""
    if joint.kind != "prismatic":
        return [0.0]
    return [0.0, *(x for x in (joint.lower, joint.upper) if np.isfinite(x))]


def _uniform_ellipsoid(link: Array, largest: float) -> Array | None:
    """Return six points (6, 3) of the uniform ellipsoid with a link's parameters (10,).

    Its half axes squared are five times the second moments over the mass. The points
    are the columns of the symmetric root, since axes of equal length are arbitrary.
    None for a link without mass, without positive moments, or larger than ``largest``
    [m].
    """
    if not link[0] > 0.0:
        return None
    pseudo = inertia.pseudo_inertia(link)
    centre = pseudo[:3, 3] / link[0]
    # Second moments about the centre of mass over the mass, ascending [m^2].
    size, axes = np.linalg.eigh(pseudo[:3, :3] / link[0] - np.outer(centre, centre))
    ends = np.sqrt(5.0 * np.maximum(size, 0.0)) * axes @ axes.T
    is_impossible = size[0] < -1e-6 * abs(size[-1])  # beyond rounding in files
    is_too_large = np.abs(centre).max() + ends.max() > largest
    if is_impossible or is_too_large:
        return None
    return np.concatenate([centre + ends, centre - ends])


def plausible_links(
    robot: Robot, nominal: Array, bodies: Sequence[Body] | None = None
) -> tuple[Array, tuple[str, ...]]:
    """Return strictly consistent nominal links, drawn where the file has none.

    Parameters
    ----------
    nominal : (n, 10) array
        Standard parameters of the file, zeros where it has none.
    bodies : sequence of Body, optional
        Where each link's mass lies.

    Returns
    -------
    links : (n, 10) array
        Given links where they are possible. Where the moments are not, as in many
        files, a link keeps its mass and centre of mass
        (:func:`_with_possible_moments`).
    sources : tuple of str
        "inertial" (given), "geometry" (shape filled with DEFAULT_DENSITY) or
        "kinematics" (a tube with half of each actuator at its ends). The last two are
        guesses.
    """
    links = np.array(nominal, float)
    sources = []
    actuators = _actuators(robot)
    for i, reach in enumerate(robot.link_reach()):
        mass = links[i, 0]
        if _is_possible(links[i], reach):
            sources.append("inertial")
            continue
        body = None if bodies is None else bodies[i]
        if body is not None and body.source == "geometry":
            source = "geometry"
            drawn = _filled_geometry(body)
        else:
            source = "kinematics"
            drawn = _tube(robot, i, reach, actuators)
        if 0.0 < mass < np.inf:
            source = "inertial"
            drawn = _with_possible_moments(links[i], drawn, reach)
        sources.append(source)
        links[i] = inertia.from_pseudo_inertia(drawn)
    return links, tuple(sources)


def _with_possible_moments(link: Array, drawn: Array, reach: float) -> Array:
    """Return the pseudo-inertia (4, 4) of a file's link whose moments no body has.

    Its mass and centre of mass stay. Its inertia becomes the nearest possible one
    (:func:`~sdp_vs_penalty.robot.inertia.nearest_inertia`), no thinner than THINNEST
    times the link's length. Where the file has no positive moment it states no shape:
    that of the drawn link is taken, and its centre too where the file's is zero.

    Parameters
    ----------
    link : (10,) array
        Parameters of the file, with a positive mass.
    drawn : (4, 4) array
        Pseudo-inertia of the link as it is drawn without a file.
    reach : float
        Length of the link [m].
    """
    mass = link[0]
    centre = link[1:4] / mass
    about_centre = inertia.inertia_matrix(inertia.barycentric_from_standard(link)[4:])
    if np.linalg.eigvalsh(about_centre)[-1] > 0.0:
        thinnest = c.THINNEST * reach / np.sqrt(5.0)
        possible = inertia.nearest_inertia(about_centre, mass, thinnest)
        barycentric = np.hstack([mass, centre, inertia.inertia_entries(possible)])
        return inertia.pseudo_inertia(inertia.standard_from_barycentric(barycentric))
    if not centre.any():
        centre = drawn[:3, 3] / drawn[3, 3]
    shape = inertia.second_moment(inertia.from_pseudo_inertia(drawn))
    return _lump(mass, centre, shape)


def _is_possible(link: Array, reach: float) -> bool:
    """Return whether a body can have a link's parameters (10,), beyond rounding in
    files.

    ``reach`` is a length of the link [m], by which moments are compared with the mass.
    """
    scale = np.array([reach, reach, reach, 1.0])
    scaled = inertia.pseudo_inertia(link) / np.outer(scale, scale)
    mass = link[0]
    smallest = np.linalg.eigvalsh(scaled)[0]
    return bool(mass > 0.0 and smallest > np.finfo(np.float32).eps * mass)


def _filled_geometry(body: Body) -> Array:
    """Return the pseudo-inertia (4, 4) of a link's shape filled with DEFAULT_DENSITY.

    Second moments are those of something between a solid ellipsoid and a box.
    """
    # Half axes of the ellipsoid around the shape itself, without the margins.
    half_axes = (body.half_axes - c.LAYER) / c.GEOMETRY_MARGIN
    # A half axis squared over its second moment: 5 for an ellipsoid, 9 for a box in it.
    ratio = 7.0
    second = (body.axes * half_axes**2 / ratio) @ body.axes.T
    volume = body.volume
    if volume is None:  # the surface is open: half of the ellipsoid
        volume = 0.5 * (4.0 / 3.0 * np.pi * float(np.prod(half_axes)))
    return _lump(c.DEFAULT_DENSITY * volume, body.centre, second)


def _lump(mass: float, centre: Array, second: Array) -> Array:
    """Return the pseudo-inertia (4, 4) of a mass [kg] at a centre (3,) [m].

    ``second`` (3, 3) are its second moments about the centre over the mass [m^2].
    """
    lifted = np.append(centre, 1.0)
    return mass * (np.pad(second, (0, 1)) + np.outer(lifted, lifted))


def _actuators(robot: Robot) -> Array:
    """Return the mass (L,) of each joint's actuator [kg], from its torque limit.

    mass = factor torque^power (ACTUATOR). If limits are missing or all the same (a
    placeholder), the torque is the one that holds the arm beyond the joint, HOLDING
    length^2. A sliding joint has no actuator.
    """
    # Length of the arm beyond each joint [m]; a joint's children come after it.
    length_beyond = np.zeros(len(robot.tree))
    reach = dict(zip(robot.link_joints, robot.link_reach(), strict=True))
    for k in reversed(range(len(robot.tree))):  # children before their parent
        lengths_of_children = [
            length_beyond[i] for i, joint in enumerate(robot.tree) if joint.parent == k
        ]
        longest = max(lengths_of_children, default=0.0)
        length_beyond[k] = reach.get(k, 0.0) + longest
    torque = c.HOLDING * length_beyond**2
    limits = np.array([joint.effort for joint in robot.tree])
    is_turning = np.array([joint.kind != "prismatic" for joint in robot.tree])
    turning_limits = limits[is_turning]
    are_different = len(set(turning_limits.tolist())) > 1
    if np.all(np.isfinite(turning_limits)) and are_different:
        torque = limits
    factor, power = c.ACTUATOR  # mass [kg] = factor torque^power
    return np.where(is_turning, factor * np.minimum(torque, c.LARGEST) ** power, 0.0)


def _tube(robot: Robot, link: int, reach: float, actuators: Array) -> Array:
    """Return the pseudo-inertia (4, 4) of a tube between a link's joints.

    It is a guess for a link without inertial: a tube of TUBE kg/m in the middle of the
    joints, and half of each joint's actuator at its ends. ``reach`` is the link's
    length [m], ``actuators`` (L,) are masses [kg].
    """
    carrier = robot.link_joints[link]
    children = [k for k, joint in enumerate(robot.tree) if joint.parent == carrier]
    places = [np.zeros(3)]
    for child in children:
        places.append(robot.tree[child].placement[:3, 3])
    into_link = np.linalg.inv(robot.tree[carrier].link_frame)
    ends = np.array(places) @ into_link[:3, :3].T + into_link[:3, 3]
    # Origins of the joints in the link frame [m]: the link's joint, then its children.
    middle = ends[0]
    if children:
        middle = 0.5 * (ends[0] + ends[1:].mean(axis=0))
    # Every lump is a solid ball of a quarter of the length: r^2 / 5 an axis.
    second = 0.2 * (0.25 * reach) ** 2 * np.eye(3)
    lumps = [_lump(c.TUBE * reach, middle, second)]
    for joint, end in zip([carrier, *children], ends, strict=True):
        lumps.append(_lump(0.5 * actuators[joint], end, second))
    return np.sum(lumps, axis=0)
