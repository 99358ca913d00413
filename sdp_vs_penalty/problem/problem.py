"""A shared problem definition: robot, bounds, nominal inertia, published values.

A problem is a folder with a problem.toml (problems/ travels with the package), or a
URDF file; all estimators read the same :class:`Problem`. Tables and files name a link's
bounds m1, c1x, I1xx, as the paper prints them. model.json holds a problem whole, beside
its robot: what it does not narrow is written down too, so that other defaults of a
later version do not change the bounds of an old model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sdp_vs_penalty.effects import DEFAULT_EFFECTS, parse_effects, standard_effect
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError, require_known
from sdp_vs_penalty.files import read_table
from sdp_vs_penalty.formatting import finite
from sdp_vs_penalty.problem import constants as c
from sdp_vs_penalty.problem.bodies import link_bodies
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.results.record import Shown, Summary
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask, nonzero_or_one
from sdp_vs_penalty.robot.body import Body
from sdp_vs_penalty.robot.constraint import BarycentricBound, Constraint, ConstraintSet
from sdp_vs_penalty.robot.joint import ChannelNames
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.preprocessing import Preprocessing


@dataclass(frozen=True)
class CentreOfMassCone(JsonRecord):
    """|c perpendicular to axis| <= radius + slope (c along axis), in the link frame
    [m]."""

    #: Number of the link, from 1.
    link: int
    #: "x", "y" or "z", as in problem.toml and model.json.
    axis: str
    #: Radius of the cone at the link frame's origin [m].
    radius: float
    #: Growth of the radius along the axis.
    slope: float

    def __post_init__(self) -> None:
        """Raise InputError for another axis or numbers that are not finite."""
        require_known("centre_of_mass_cone axis", self.axis, ("x", "y", "z"))
        if not np.all(np.isfinite([self.radius, self.slope])):
            raise InputError(
                f"the centre_of_mass_cone of link {self.link}", "correct its numbers"
            )

    @property
    def along(self) -> Mask:
        """(3,) which axis of the link frame is the cone's axis."""
        return np.array([axis == self.axis for axis in "xyz"])

    def constraint(self, indices: Indices) -> Constraint:
        """Return the cone as a constraint on (m, m c) of a link.

        Parameters
        ----------
        indices : (10,) array of int
            Indices of the link's parameters in theta.
        """
        coefficients = np.zeros((4, 3))
        coefficients[0, 0] = self.radius
        coefficients[1:, 0] = np.where(self.along, self.slope, 0.0)
        coefficients[1:, 1:] = np.eye(3)[:, ~self.along]
        name = f"link {self.link}"
        return build.linear(
            "centre of mass cone",
            name,
            indices=indices[:4],
            coefficients=coefficients,
            constant=np.zeros(3),
            cone="soc",
        )


#: Where the torque is measured, as in problem.toml, and in words; a URDF does not say.
_TORQUE_SIDES = {
    "link": "measured on the link side",
    "motor": "measured on the motor side",
    "unknown": "measured on the link's or the motor's side",
}


@dataclass(frozen=True, repr=False)
class Problem(Shown):
    """What is known of a robot before anything is measured.

    Parameters
    ----------
    name : str
        By which verbs and files call it.
    title : str
        For people.
    robot : Robot
        Its kinematics.
    box : (n, 10, 2) array
        Lower and upper bounds of (m, cx, cy, cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) about
        the centre of mass [kg, m, kg m^2], infinite where there is none.
    nominal_links : (n, 10) array
        Standard parameters of a plausible, strictly consistent robot.
    total_mass : (float, float)
        Bounds of the moving links' mass together [kg].
    cones : tuple of CentreOfMassCone
        Further constraints on centres of mass.
    torque_side : {"link", "motor", "unknown"}
        Which side of the gear the torque is measured on.
    preprocessing : Preprocessing
        Filter settings that hold where a verb has none.
    independent : tuple of str, optional
        Names of the base parameters.
    folder : Path, optional
        Where it was read from.
    effects : tuple of str, optional
        Texts of the effects that a model has by default.
    defaults : (n, 2) array, optional
        What bounds a link where box and cones do not: its largest mass [kg], and the
        radius [m] of the ball about its frame in which its mass lies. Default:
        :attr:`link_defaults`.
    bodies : tuple of Body, optional
        Where each link's mass can be; default: from the bounds and the kinematics.
    nominal_from : tuple of str, optional
        Where each nominal link comes from: "inertial", "bounds", "geometry" or
        "kinematics". A mass of the last two is a guess, whose scale the data may
        choose.
    gains : (n,) tuple of float, optional
        What each torque channel reads over the true torque, where known loads have
        shown it.
    nominal_values : mapping of str to float
        Parameters that are no link's, by name (I_a1, f_v1), where the robot's file has
        them.
    source : str or Path, optional
        What a user names to load it: a built-in name, a folder or a file.

    Raises
    ------
    InputError
        Where bounds contradict themselves, or do not belong to the robot.
    """

    #: Name by which verbs and files call it.
    name: str
    #: What it is, for people.
    title: str
    #: Kinematics of the robot; it has n links.
    robot: Robot
    #: (n, 10, 2) lower and upper bounds of (m, cx, cy, cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz)
    #: about the centre of mass [kg, m, kg m^2], infinite where there is none.
    box: Array
    #: (n, 10) standard parameters of a plausible, strictly consistent robot.
    nominal_links: Array
    #: Least and largest mass of the moving links together [kg].
    total_mass: tuple[float, float] = (0.0, np.inf)
    #: Further constraints on centres of mass.
    cones: tuple[CentreOfMassCone, ...] = ()
    #: Side of the gear on which the torque is measured: "link", "motor" or "unknown".
    torque_side: str = "unknown"
    #: Filter settings that hold where a verb has none.
    preprocessing: Preprocessing = field(default_factory=Preprocessing)
    #: Names of the base parameters; None: those of a decomposition.
    independent: tuple[str, ...] | None = None
    #: Folder that it was read from.
    folder: Path | None = None
    #: Texts of the effects that a model has by default.
    effects: tuple[str, ...] | None = None
    #: (n, 2) what bounds a link where box and cones do not: its largest mass [kg], and
    #: the radius [m] of the ball about its frame in which its mass lies. None:
    #: :attr:`link_defaults`.
    defaults: Array | None = None
    #: Where each link's mass can be; None: from the bounds and the kinematics.
    bodies: tuple[Body, ...] | None = None
    #: Origin of each nominal link: "inertial", "bounds", "geometry" or "kinematics". A
    #: mass of the last two is a guess, whose scale the data may choose.
    nominal_from: tuple[str, ...] | None = None
    #: (n,) reading of each torque channel over the true torque, where known loads have
    #: shown it.
    gains: tuple[float, ...] | None = None
    #: Parameters that are no link's, by name (I_a1, f_v1), where the robot's file has
    #: them.
    nominal_values: Mapping[str, float] = field(default_factory=dict)
    #: What a user names to load it: a built-in name, a folder or a file; None for the
    #: problem of a model.json.
    source: str | Path | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        """Check the bounds; raise InputError if they are contradictory or of another
        robot."""
        n = self.robot.links
        low, high = self.total_mass
        # Each array must have the shape (n links, *shape of one link's entry).
        shapes: dict[str, tuple[Any, ...]] = {
            "bounds": (self.box, 10, 2),
            "nominal links": (self.nominal_links, 10),
            "default bounds": (self.defaults, 2),
            "bodies": (self.bodies,),
            "nominal_from": (self.nominal_from,),
            "gains": (self.gains,),
        }
        for name, (value, *shape_of_entry) in shapes.items():
            if value is not None and np.shape(value) != (n, *shape_of_entry):
                what = (
                    f"the {name} are of another robot than {self.robot.name} ({n}"
                    " links)"
                )
                raise InputError(what, "give one a link")
        if not np.all(self.box[..., 0] <= self.box[..., 1]):
            raise InputError("a bound has its lower end above its upper", "swap them")
        if not low <= high:
            what = f"total_mass has its lower bound {low:g} above its upper {high:g}"
            raise InputError(what, "swap them")
        for cone in self.cones:
            if not 1 <= cone.link <= n:
                what = f"centre_of_mass_cone names link {cone.link}, there are {n}"
                raise InputError(what, "correct the link")
        require_known("torque_side", self.torque_side, tuple(_TORQUE_SIDES))

    @cached_property
    def link_defaults(self) -> Array:
        """(n, 2) largest mass [kg] and radius [m] of each link where no narrower bound
        is known.

        The mass lies in a ball of this radius about the link frame. It covers the
        distance to the next joints, a sliding joint's stroke, and twice the extent of
        the nominal inertial.
        """
        if self.defaults is not None:
            return self.defaults
        mass = self.nominal_links[:, 0]
        # Distance to the next joints or to the bounds of the centre of mass.
        bounded_centres = np.where(np.isfinite(self._centres), self._centres, 0.0)
        reach = np.maximum(self.robot.link_reach(), bounded_centres.max(axis=1))
        joints = [self.robot.tree[k] for k in self.robot.link_joints]
        stroke = np.array(
            [j.upper - j.lower if j.kind == "prismatic" else 0.0 for j in joints]
        )
        # Extent of the nominal inertials: the root mean square distance of the mass
        # from the frame.
        second_moments = np.trace(
            inertia.pseudo_inertia(self.nominal_links)[:, :3, :3], axis1=1, axis2=2
        )
        with_mass = np.where(mass > 0.0, second_moments, 0.0)
        extent = np.sqrt(np.maximum(with_mass / nonzero_or_one(mass), 0.0))
        candidates = [
            (1.0 + c.RADIUS_SHARE) * reach,
            np.full(len(mass), c.DEFAULT_RADIUS),
            np.where(np.isfinite(stroke), stroke, 0.0),
            2.0 * extent,
        ]
        radius = np.max(candidates, axis=0)
        largest_mass = np.maximum(c.DEFAULT_LINK_MASS[1], c.FAR_MASS * mass)
        return np.column_stack([largest_mass, radius])

    @cached_property
    def assumed_masses(self) -> Mask:
        """(n, 2) whether the least and the greatest mass of each link are limits that
        nobody stated: those that keep the set of all links finite."""
        least, greatest = self.box[:, 0].T
        is_assumed = (
            least <= c.DEFAULT_LINK_MASS[0],
            greatest >= self.link_defaults[:, 0],
        )
        return np.column_stack(is_assumed)

    @cached_property
    def link_bodies(self) -> tuple[Body, ...]:
        """Ellipsoid of each link, in its frame, in which its mass lies."""
        if self.bodies is not None:
            return self.bodies
        return link_bodies(
            self.robot, self.centre_boxes, np.zeros((self.robot.links, 10))
        )

    @property
    def centre_boxes(self) -> Array:
        """(n, 3, 2) bounds of each centre of mass [m]: the box, or else what the cones
        imply.
        """
        box = self.box[:, 1:4]
        known = self._centres
        return np.where(np.isfinite(box), box, np.stack([-known, known], axis=2))

    @cached_property
    def prior_links(self) -> Array:
        """(n, 10) nominal links, scaled where their bounds exclude their mass.

        It becomes the bounds' geometric mean where they are positive, else the nearer
        bound.
        """
        masses = self.nominal_links[:, 0]
        low, high = self.box[:, 0].T
        new_masses = np.clip(masses, low, high)
        is_outside = new_masses != masses
        has_mean = is_outside & (low > 0.0) & np.isfinite(high)
        new_masses[has_mean] = np.sqrt(low[has_mean] * high[has_mean])
        # All ten parameters are proportional to the mass (where it is not zero).
        factors = new_masses / nonzero_or_one(masses)
        return self.nominal_links * factors[:, None]

    @cached_property
    def channel_names(self) -> ChannelNames:
        """(n,) names of the driven joints, with what tells which channels of a log are
        theirs and in which unit: held joints, the robot, and its links where a file says
        their masses."""
        robot, is_guessed = self.robot, self.guessed_links.any()
        links = None if is_guessed else self.nominal_links
        return ChannelNames.with_held(robot.joint_names, robot.held, robot, links)

    @cached_property
    def known(self) -> Mapping[str, float]:
        """Standard parameters that equal bounds state, by name.

        These are masses m [kg], and first moments m c [kg m] along axes on which c is
        stated: where m is known, or c is zero.
        """
        values: dict[str, float] = {}
        low, high = self.box[:, :4, 0], self.box[:, :4, 1]
        for link, is_stated in enumerate(low == high):
            mass_name, *moment_names = inertia.parameter_names(link + 1)[:4]
            mass, *centre = low[link].tolist()
            is_mass_stated, *are_coordinates_stated = is_stated.tolist()
            if is_mass_stated:
                values[mass_name] = mass
            for name, coordinate, is_coordinate_stated in zip(
                moment_names, centre, are_coordinates_stated, strict=True
            ):
                if is_coordinate_stated and coordinate == 0.0:
                    values[name] = 0.0
                elif is_coordinate_stated and is_mass_stated:
                    values[name] = mass * coordinate
        return values

    @property
    def guessed_links(self) -> Mask:
        """(n,) links whose nominal mass is a guess: neither a file's nor a bound's."""
        sources = self.nominal_from or ("inertial",) * self.robot.links
        return np.array([source in ("geometry", "kinematics") for source in sources])

    @property
    def default_effects(self) -> tuple[str, ...]:
        """Names of the effects that the problem states, or else the usual four.

        Rotor inertia is added unless the torque is known to be measured on the link
        side. Without it links would have to be heavy enough to make its torque: a
        UR10e's come out at 60 kg instead of 28. On the Panda, link side, it comes out
        as 0. A single joint's rotor, on an unknown side, cannot be told from its link
        and is left out.
        """
        if self.effects is not None:
            return self.effects
        has_rotors = self.torque_side == "motor" or (
            self.torque_side == "unknown" and self.robot.n > 1
        )
        if not has_rotors:
            return DEFAULT_EFFECTS
        return (*DEFAULT_EFFECTS, standard_effect("armature").name)

    def _summary(self) -> Summary:
        """Return the title and the (label, text) lines of the printed summary."""
        joints = [f"{j.name} ({j.kind})" for j in self.robot.joints]
        gravity = ", ".join(f"{x:.4g}" for x in self.robot.gravity)
        return f"Problem: {self.name}, {self.title}", [
            ("joints", f"{len(joints)}: {', '.join(joints)}"),
            ("torque", f"{_TORQUE_SIDES[self.torque_side]}; gravity ({gravity}) m/s^2"),
            ("default effects", ", ".join(self.default_effects)),
        ]

    def model(self, effects: str | Sequence[str | Effect] | None = None) -> Model:
        """Return a model of this robot with some effects.

        Parameters
        ----------
        effects : str or sequence of str and Effect, optional
            Names separated by commas, or names and effects; default: those of the
            problem.

        Returns
        -------
        Model
            In SI units if the problem knows the gains of the torque channels.

        Raises
        ------
        InputError
            For an unknown name, or a parameter that comes twice.
        """
        chosen = self.default_effects if effects is None else effects
        effects = parse_effects(chosen, self.robot)
        has_links = any(e.simulator_field == "links" for e in effects)
        known = self.known if has_links else {}
        return Model(self.robot, effects, gains=self.gains, known=known)

    def with_gravity(self, gravity: Sequence[float]) -> Problem:
        """Return the problem with another gravity (3,) in the base frame [m/s^2].

        Named base parameters are dropped if gravity's direction changes, as others may
        lead then.
        """
        robot = replace(self.robot, gravity=tuple(map(float, gravity)))
        is_turned = not np.allclose(np.cross(robot.gravity, self.robot.gravity), 0.0)
        independent = None if is_turned else self.independent
        return replace(self, robot=robot, independent=independent)

    def constraints(self, model: Model) -> ConstraintSet:
        """Return all constraints on the parameters of a model of this robot: physical
        consistency, the problem's bounds, and those of the effects.
        """
        convex: list[Constraint] = []
        nonconvex: list[BarycentricBound] = []
        for link, indices in enumerate(model.rigid_indices.reshape(-1, 10)):
            convex += self._link_constraints(link, indices)
            nonconvex += [
                BarycentricBound(f"link {link + 1}", indices, entry, lower, upper)
                for entry, (lower, upper) in enumerate(self.box[link, 4:].tolist())
                if np.isfinite(lower) or np.isfinite(upper)
            ]
        # A link has ten parameters; the first one is its mass.
        mass_indices = model.rigid_indices[::10]
        lowest, highest = self.total_mass
        is_bounded = lowest > 0.0 or np.isfinite(highest)
        if len(mass_indices) and is_bounded:
            signs, ends = _interval(lowest, highest)
            rows = np.tile(signs, (len(mass_indices), 1))
            convex.append(
                build.linear(
                    "total mass",
                    name="robot",
                    indices=mass_indices,
                    coefficients=rows,
                    constant=ends,
                )
            )
        for effect, indices in model.parts:
            convex += effect.constraints(indices, model.parameters)
        return ConstraintSet(tuple(convex), tuple(nonconvex))

    def parameter_bound(self, model: Model) -> Array:
        """Return B (p,) with |theta_k| <= B_k for every feasible theta of a model, in the
        unit of each parameter.

        B follows from the convex constraints. The certificate's lower bound needs it in
        directions that the data do not determine.
        """
        bound = np.concatenate(
            [np.full(len(e.parameters), e.largest_parameter) for e in model.effects]
        )
        links = model.rigid_indices.reshape(-1, 10)
        if len(links):
            mass, com, moment = self.link_sizes
            bound[links[:, 0]] = mass
            bound[links[:, 1:4]] = mass[:, None] * com
            # The largest moment bounds products of inertia too (positive definiteness).
            bound[links[:, 4:]] = moment.max(axis=1, keepdims=True)
        return bound

    def nominal(self, model: Model) -> Array:
        """Return the nominal parameters (p,) of a model: the links', others from the
        robot's file, or else the effect's nominal values.
        """
        theta = np.concatenate([effect.nominal for effect in model.effects])
        for k, parameter in enumerate(model.parameters):
            theta[k] = self.nominal_values.get(parameter.name, theta[k])
        if len(model.rigid_indices):
            theta[model.rigid_indices] = self.nominal_links.ravel()
        return theta

    @cached_property
    def published(self) -> Mapping[str, list[dict[str, str]]]:
        """Tables of the paper for this problem, by name ("table_III"), rows as text by
        column.
        """
        if self.folder is None:
            return {}
        return {
            p.stem: read_table(p)
            for p in sorted((self.folder / "published").glob("*.csv"))
        }

    @cached_property
    def _centres(self) -> Array:
        """(n, 3) bounds of |c| along each axis [m], from box and cones; infinite
        without one.
        """
        # box (n, 10, 2): lower and upper ends; entries 1 to 3 are the centre of mass.
        com = np.abs(self.box[:, 1:4]).max(axis=2)
        for cone in self.cones:
            link = cone.link - 1
            is_across = ~cone.along
            (ends_along,) = self.box[link, 1:4][cone.along]
            if np.all(np.isfinite(ends_along)) or cone.slope == 0.0:
                # Widest radius + slope x between the box's ends x along the axis.
                widest = cone.radius + max(
                    cone.slope * x for x in np.nan_to_num(ends_along)
                )
                com[link, is_across] = np.minimum(com[link, is_across], widest)
        return np.asarray(com)

    @cached_property
    def _boxed(self) -> Mask:
        """(n,) whether the bounds of a link limit its inertia about the link frame.

        They do if the moments Ixx, Iyy, Izz about the centre of mass have upper bounds
        and the centre of mass is bounded (Steiner's theorem).
        """
        known = np.column_stack([self.box[:, [4, 6, 9], 1], self._centres])
        return np.asarray(np.isfinite(known).all(axis=1))

    @cached_property
    def link_sizes(self) -> tuple[Array, Array, Array]:
        """Bounds for every feasible link: mass (n,) [kg], |c| (n, 3) [m], moments (n,
        3).

        The moments [kg m^2] Jxx, Jyy, Jzz are about the link frame. Where the bounds do
        not limit them, the mass lies within the link's default radius.
        """
        # Columns (n, 1) of mass [kg] and radius [m], for links without bounds.
        default_mass, radius = self.link_defaults.T[..., None]
        largest_mass = self.box[:, :1, 1]
        mass = np.where(np.isfinite(largest_mass), largest_mass, default_mass)
        mass = np.minimum(mass, self.total_mass[1])
        # Steiner: J_aa = I_aa + m (c_b^2 + c_c^2); entries 4, 6, 9 are Ixx, Iyy, Izz.
        is_boxed = self._boxed[:, None]
        squared_com = np.where(is_boxed, self._centres, 0.0) ** 2
        squared_distance = squared_com.sum(axis=1, keepdims=True) - squared_com
        moments = self.box[:, [4, 6, 9], 1] + mass * squared_distance
        com = np.where(is_boxed, self._centres, np.minimum(self._centres, radius))
        # Without bounds all of the mass may lie at the radius.
        return mass[:, 0], com, np.where(is_boxed, moments, mass * radius**2)

    def _link_constraints(self, link: int, indices: Indices) -> list[Constraint]:
        """Return the convex constraints on one link (from 0), each linear in its
        parameters.

        ``indices`` (10,) are those of m, m c (3), J (6) in theta. The constraints are:
        pseudo-inertia positive semidefinite, mass, box and cones of the centre of mass,
        and either upper bounds of the moments or a ball that holds the mass.
        """
        name = f"link {link + 1}"
        box = self.box[link]
        masses, coms, _ = self.link_sizes
        mass = masses[link]
        com = coms[link]
        out = [build.pseudo_inertia(name, indices)]
        # m >= 0 is part of the pseudo-inertia: only a positive lower end is a row.
        smallest_mass = box[0, 0] if box[0, 0] > 0.0 else -np.inf
        # Linear constraints: constant + coefficients^T parameters >= 0, one a column.
        rows, constant = _interval(smallest_mass, mass)
        out.append(
            build.linear(
                "mass",
                name,
                indices=indices[:1],
                coefficients=rows[None, :],
                constant=constant,
            )
        )
        # sign (m c_axis - m end) >= 0 for each finite end of the centre of mass's box.
        axes, ends = np.nonzero(np.isfinite(box[1:4]))
        n_ends = len(axes)
        if n_ends:
            signs = np.array([1.0, -1.0])[ends]  # lower end, upper end
            coefficients = np.zeros((4, n_ends))
            coefficients[0] = -signs * box[1 + axes, ends]
            coefficients[1 + axes, np.arange(n_ends)] = signs
            out.append(
                build.linear(
                    "centre of mass",
                    name,
                    indices=indices[:4],
                    coefficients=coefficients,
                    constant=np.zeros(n_ends),
                )
            )
        out += [
            cone.constraint(indices) for cone in self.cones if cone.link == link + 1
        ]
        if self._boxed[link]:
            # J_aa <= upper + m max(c_b^2 + c_c^2): the convex consequence of I_aa <=
            # upper. Entries 4, 6, 9 of a link are Ixx, Iyy, Izz.
            squared_com = com**2
            coefficients = np.zeros((4, 3))
            coefficients[0] = squared_com.sum() - squared_com
            coefficients[1:] = -np.eye(3)
            upper = box[[4, 6, 9], 1]
            out.append(
                build.linear(
                    "trace",
                    name,
                    indices=indices[[0, 4, 6, 9]],
                    coefficients=coefficients,
                    constant=upper,
                )
            )
        else:
            # 1 - |x|^2 / radius^2 as the quadric of a ball about the frame.
            radius = self.link_defaults[link, 1]
            ball = np.diag([*np.full(3, -1.0 / radius**2), 1.0])
            out.append(
                build.density_in_ellipsoid(
                    "bounding ellipsoid", name, indices, quadric=ball
                )
            )
        return out


def open_box(links: int, mass: float | Array = 0.0) -> Array:
    """Return bounds (links, 10, 2) of the links' parameters that bound the masses from
    below only: smallest masses (links,) [kg], or one of all."""
    box = np.full((links, 10, 2), (-np.inf, np.inf))
    box[:, 0, 0] = mass
    return box


def _interval(lower: float, upper: float) -> tuple[Array, Array]:
    """Return coefficients and constants of x - lower >= 0 and upper - x >= 0.

    An infinite end has no row.
    """
    signs = np.array([1.0, -1.0])
    constants = np.array([-lower, upper])
    is_finite = np.isfinite(constants)
    return signs[is_finite], constants[is_finite]


#: A link's ten barycentric parameters, in our order.
_BARYCENTRIC = (
    "m{}",
    "c{}x",
    "c{}y",
    "c{}z",
    "I{}xx",
    "I{}xy",
    "I{}yy",
    "I{}xz",
    "I{}yz",
    "I{}zz",
)


def barycentric_names(link: int) -> tuple[str, ...]:
    """Return the names of a link's (from 1) ten barycentric parameters in the order of
    the box, such as m1, c1x, I1xx."""
    return tuple(name.format(link) for name in _BARYCENTRIC)


def entries(links: int) -> dict[str, tuple[int, int]]:
    """Return the place in a problem's box of each named parameter.

    Returns
    -------
    dict
        Link and entry, both from 0, by name (m1, c1x, I1xx, ...).
    """
    names = (barycentric_names(link + 1) for link in range(links))
    return {
        name: (link, k)
        for link, names_of_link in enumerate(names)
        for k, name in enumerate(names_of_link)
    }


@dataclass(frozen=True)
class LinkDefault:
    """What bounds a link where nothing else does."""

    #: Largest mass [kg].
    mass: float
    #: Largest distance of its centre of mass [m].
    radius: float

    def __post_init__(self) -> None:
        """Raise InputError unless both are finite and above 0."""
        if not (0.0 < self.mass < np.inf and 0.0 < self.radius < np.inf):
            remedy = "correct it, or write the file anew"
            raise InputError("a mass or a radius is not above 0", remedy)


@dataclass(frozen=True)
class ProblemFields(JsonRecord):
    """What a model.json holds of its problem; the robot stands beside it."""

    #: Name by which verbs and files call it.
    name: str
    #: Title for people.
    title: str
    #: Side of the gear on which the torque is measured.
    torque_side: Literal["link", "motor", "unknown"]
    #: Texts of the effects that a model has by default.
    effects: tuple[str, ...]
    #: Lower and upper end by the names of a bounds.csv (m1 [kg], c1x [m], I1xx
    #: [kg m^2]), null where open.
    bounds: Mapping[str, tuple[float | None, float | None]]
    #: Bounds of the moving links' mass together [kg].
    total_mass: tuple[float | None, float | None]
    #: Further constraints on centres of mass.
    centre_of_mass_cones: tuple[CentreOfMassCone, ...]
    #: Largest mass of each link, and largest distance of its centre of mass.
    link_defaults: tuple[LinkDefault, ...]
    #: Where each link's mass can be.
    bodies: tuple[Body, ...]
    #: (links, 10) standard parameters.
    nominal_links: Array
    #: Where each nominal link is from.
    nominal_from: tuple[str, ...] | None
    #: Filters that hold where a verb has none.
    preprocessing: Preprocessing
    #: Names of the base parameters.
    base_parameters: tuple[str, ...] | None
    #: Known gains of the torque channels.
    gains: tuple[float, ...] | None = None
    #: Nominal values of parameters that belong to no link, by name.
    nominal_values: Mapping[str, float] = field(default_factory=dict)
    #: What the user named to load it, from the folder that he was in.
    source: str | None = None

    @classmethod
    def from_problem(cls, problem: Problem) -> ProblemFields:
        """Return what a file holds of a problem; bounds that are open on both sides are
        left out."""
        places = entries(problem.robot.links).items()
        bounds = {name: _open_ends(problem.box[place]) for name, place in places}
        return cls(
            name=problem.name,
            title=problem.title,
            torque_side=problem.torque_side,  # type: ignore[arg-type]
            effects=tuple(problem.default_effects),
            bounds={k: pair for k, pair in bounds.items() if pair != (None, None)},
            total_mass=_open_ends(problem.total_mass),
            centre_of_mass_cones=problem.cones,
            link_defaults=tuple(
                LinkDefault(m, r) for m, r in problem.link_defaults.tolist()
            ),
            bodies=tuple(problem.link_bodies),
            nominal_links=problem.nominal_links,
            nominal_from=problem.nominal_from,
            preprocessing=problem.preprocessing,
            base_parameters=problem.independent,
            gains=problem.gains,
            nominal_values=dict(problem.nominal_values),
            source=None if problem.source is None else str(problem.source),
        )

    def problem(self, robot: Robot) -> Problem:
        """Return the problem of a robot, without a folder, with bitwise equal
        constraints.

        Raises
        ------
        InputError
            If bounds contradict each other or the robot.
        """
        remedy = "write the file anew"
        # Name of a parameter, such as c1x, to its place (link, entry) in the box.
        place_by_name = entries(robot.links)
        box = open_box(robot.links)
        for name, pair in self.bounds.items():
            if name not in place_by_name:
                what = f"bounds: {name!r} is no parameter of a link of this robot"
                raise InputError(what, remedy)
            box[place_by_name[name]] = _ends(pair)
        for name, values in (
            ("nominal_links", self.nominal_links),
            ("gains", self.gains or ()),
            ("nominal_values", list(self.nominal_values.values())),
        ):
            if not np.all(np.isfinite(values)):
                raise InputError("a number is not finite", remedy, name)
        parse_effects(self.effects, robot)  # raises InputError for an unknown effect
        return Problem(
            name=self.name,
            title=self.title,
            robot=robot,
            box=box,
            nominal_links=self.nominal_links,
            total_mass=_ends(self.total_mass),
            cones=self.centre_of_mass_cones,
            torque_side=self.torque_side,
            preprocessing=self.preprocessing,
            independent=self.base_parameters,
            effects=self.effects,
            defaults=np.array([[x.mass, x.radius] for x in self.link_defaults]),
            bodies=self.bodies,
            nominal_from=self.nominal_from,
            gains=self.gains or None,
            nominal_values=dict(self.nominal_values),
            source=self.source,
        )


def _open_ends(pair: Sequence[float]) -> tuple[float | None, float | None]:
    """Return lower and upper end of a bound for JSON, where None is an open end."""
    low, high = pair
    return finite(low), finite(high)


def _ends(pair: tuple[float | None, float | None]) -> tuple[float, float]:
    """Return lower and upper end of a bound in JSON, where null is an open end."""
    low, high = pair
    lower = -np.inf if low is None else float(low)
    upper = np.inf if high is None else float(high)
    return lower, upper
