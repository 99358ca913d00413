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
from sdp_vs_penalty.robot.robot import Robot


def link_bodies(
    robot: Robot,
    centres: Array,
    nominal: Array,
    geometry: Sequence[Geometry | None] | None = None,
) -> tuple[Body, ...]:
    """The body of each link, from the best that is known of it.

    Parameters
    ----------
    robot : whose joints a link bears
    centres : (n, 3, 2) bounds on the centre of mass [m], infinite where there is none
    nominal : (n, 10) standard parameters that came with the robot, zeros where none did
    geometry : the links' shapes

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
        if shape is not None and _is_a_links_shape(shape, largest):
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


def _is_a_links_shape(shape: Geometry, largest: float) -> bool:
    """Whether a shape is in metres, and no marker of a place; largest : distance of its
    points from the frame [m]."""
    farthest = float(np.linalg.norm(shape.points, axis=1).max())
    extent = float(np.ptp(shape.points, axis=0).max())
    return extent > c.LAYER and farthest < largest


def _body_of_geometry(shape: Geometry, ellipsoid: Array | None) -> Body:
    """The body around a link's shape and the ellipsoid of its inertial."""
    cloud = shape.points
    if ellipsoid is not None:
        cloud = np.concatenate([shape.points, ellipsoid])
    volume = shape.volume if shape.volume > 0.0 else None
    return around(cloud, "geometry", c.GEOMETRY_MARGIN, c.LAYER, volume)


def _body_of_inertial(ellipsoid: Array, joints: Array) -> Body:
    """The body around a wider ellipsoid than the inertial's, and around the joints."""
    centre = ellipsoid.mean(axis=0)
    wide = centre + c.INERTIAL_MARGIN * (ellipsoid - centre)
    places = balls(np.concatenate([joints, ellipsoid]), c.LEAST_RADIUS)
    return around(np.concatenate([wide, places]), "inertial")


def joint_places(robot: Robot, link: int) -> Array:
    """Joint positions that a link's body connects, its own joint's included, over their strokes.

    A frame may sit anywhere on its joint's axis: the link begins where the axis leaves the
    parent's body.

    Parameters
    ----------
    robot : Robot
        The robot.
    link : int
        Index of the link.

    Returns
    -------
    (k, 3) array
        Points in the link frame [m].
    """
    carrier = robot.link_joints[link]
    joint_of_carrier = robot.tree[carrier]
    into = np.linalg.inv(joint_of_carrier.link_frame)
    before = float(
        joint_of_carrier.axis
        @ joint_of_carrier.placement[:3, :3].T
        @ joint_of_carrier.placement[:3, 3]
    )
    strokes = [
        [
            0.0,
            *(
                x
                for x in (j.lower, j.upper)
                if j.kind == "prismatic" and np.isfinite(x)
            ),
        ]
        for j in robot.tree
    ]
    places: list[Array] = [
        -s * joint_of_carrier.axis for s in (before, *strokes[carrier])
    ]
    for k, child in enumerate(robot.tree):
        if child.parent == carrier:
            along = child.placement[:3, :3] @ child.axis
            places += [child.placement[:3, 3] + s * along for s in strokes[k]]
    return np.concatenate(
        [
            np.zeros((1, 3)),
            np.array(places) @ into[:3, :3].T + into[:3, 3],
        ]
    )


def _uniform_ellipsoid(link: Array, largest: float) -> Array | None:
    """(6, 3) points whose least ellipsoid is that of uniform density with these
    parameters (10,): what its symmetric root makes of the unit vectors. Axes of a
    cylinder are the processor's choice."""
    if not link[0] > 0.0:
        return None
    pseudo = inertia.pseudo_inertia(link)
    centre = pseudo[:3, 3] / link[0]
    size, axes = np.linalg.eigh(pseudo[:3, :3] / link[0] - np.outer(centre, centre))
    ends = np.sqrt(5.0 * np.maximum(size, 0.0)) * axes @ axes.T
    if size[0] < -1e-6 * abs(size[-1]) or np.abs(centre).max() + ends.max() > largest:
        return None  # no body has these
    return np.concatenate([centre + ends, centre - ends])


def plausible_links(
    robot: Robot,
    nominal: Array,
    bodies: Sequence[Body] | None = None,
) -> tuple[Array, tuple[str, ...]]:
    """Strictly consistent nominal links.

    Parameters
    ----------
    robot : whose links they are
    nominal : (n, 10) standard parameters as a file has them, zeros where it has none
    bodies : (n,) where each link's mass can be

    Returns
    -------
    links : (n, 10) those given where they are possible; a given mass whose moments are
        not keeps its weight
    sources : (n,) "inertial"; "geometry", filled with :data:`DEFAULT_DENSITY`; or
        "kinematics", a tube with half of each actuator at its ends. The last two are
        drawn, not measured.
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
            drawn = drawn * (mass / drawn[3, 3])
        sources.append(source)
        links[i] = inertia.from_pseudo_inertia(drawn)
    return links, tuple(sources)


def _is_possible(link: Array, reach: float) -> bool:
    """Whether a body can have these parameters (10,), by more than files' seven digits
    leave open; reach : a length of the link [m]."""
    scale = np.array([reach, reach, reach, 1.0])
    scaled = inertia.pseudo_inertia(link) / np.outer(scale, scale)
    mass = link[0]
    smallest = np.linalg.eigvalsh(scaled)[0]
    return bool(mass > 0.0 and smallest > np.finfo(np.float32).eps * mass)


def _filled_geometry(body: Body) -> Array:
    """(4, 4) pseudo-inertia of a link's shape, filled."""
    # Half axes of what the body is drawn around.
    bare = (body.half_axes - c.LAYER) / c.GEOMETRY_MARGIN
    # 5 for a ball, 9 for a box.
    second = (body.axes * bare**2 / 7.0) @ body.axes.T
    volume = body.volume
    if volume is None:  # the surface is open
        volume = 0.5 * (4.0 / 3.0 * np.pi * float(np.prod(bare)))
    return _lump(c.DEFAULT_DENSITY * volume, body.centre, second)


def _lump(mass: float, centre: Array, second: Array) -> Array:
    """(4, 4) pseudo-inertia of a mass [kg] about its centre [m] with second moments per
    mass [m^2]."""
    lifted = np.append(centre, 1.0)
    return mass * (np.pad(second, (0, 1)) + np.outer(lifted, lifted))


def _actuators(robot: Robot) -> Array:
    """Mass of each joint's actuator [kg], from its torque limit, or from the arm that
    it has to hold where limits are missing or all the same (a placeholder); none for a
    sliding joint."""
    beyond = np.zeros(len(robot.tree))
    reach = dict(
        zip(
            robot.link_joints,
            robot.link_reach(),
            strict=True,
        )
    )
    for k in reversed(
        range(len(robot.tree))
    ):  # a joint's children come after it: theirs are known
        next_links = [
            beyond[i] for i, joint in enumerate(robot.tree) if joint.parent == k
        ]
        beyond[k] = reach.get(k, 0.0) + max(next_links, default=0.0)
    torque = c.HOLDING * beyond**2
    limits = np.array([joint.effort for joint in robot.tree])
    turning = np.array([joint.kind != "prismatic" for joint in robot.tree])
    if np.all(np.isfinite(limits[turning])) and len(set(limits[turning].tolist())) > 1:
        torque = limits
    factor, power = c.ACTUATOR
    return np.where(
        turning,
        factor * np.minimum(torque, c.LARGEST) ** power,
        0.0,
    )


def _tube(
    robot: Robot,
    link: int,
    reach: float,
    actuators: Array,
) -> Array:
    """(4, 4) pseudo-inertia of a tube between a link's joints with half of their
    actuators."""
    carrier = robot.link_joints[link]
    children = [k for k, joint in enumerate(robot.tree) if joint.parent == carrier]
    places = [np.zeros(3)]
    for child in children:
        places.append(robot.tree[child].placement[:3, 3])
    into_link = np.linalg.inv(robot.tree[carrier].link_frame)
    ends = np.array(places) @ into_link[:3, :3].T + into_link[:3, 3]
    middle = ends[0]
    if children:
        middle = 0.5 * (ends[0] + ends[1:].mean(axis=0))
    second = 0.2 * (0.25 * reach) ** 2 * np.eye(3)
    lumps = [_lump(c.TUBE * reach, middle, second)]
    for joint, end in zip([carrier, *children], ends, strict=True):
        lumps.append(_lump(0.5 * actuators[joint], end, second))
    return np.sum(lumps, axis=0)
