"""The part of a model that simulators' files can hold: links, damping, dry friction,
armature."""

import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any, Self

import numpy as np
from lxml import etree

from sdp_vs_penalty.effects import standard_effect
from sdp_vs_penalty.effects.effect import (
    JOINT_FIELDS,
    Effect,
    SimulatorField,
    SimulatorTerm,
)
from sdp_vs_penalty.errors import InputError, printable
from sdp_vs_penalty.estimation.carried import payload_parameters
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.verdict import NOT_JUDGED
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.joint import Joint
from sdp_vs_penalty.robot.robot import Robot

#: Fields that may be negative: together they are a spring with its rest position.
_SPRING_FIELDS = ("stiffness", "offset")
#: Fields that every simulator's file has.
FIELDS: frozenset[SimulatorField] = frozenset(
    {"links", "payload", "damping", "friction"}
)


@dataclass(frozen=True)
class Options:
    """How a user wants a file: the arguments of :func:`export`."""

    #: The user's own URDF or MJCF, whose numbers are replaced; None: a new document.
    own_file: str | Path | None = None
    #: Whether links outside of their bodies are accepted.
    force: bool = False
    #: Place of the flange in the last link's frame [m].
    flange: tuple[float, float, float] = (0.0, 0.0, 0.0)
    #: Effects that the model was identified again without, since the file has no place
    #: for them.
    identified_without: tuple[str, ...] = ()


@dataclass(frozen=True)
class Content:
    """What a simulator's file can hold of a model; zeros where the model has none."""

    #: (links, 10) standard parameters about each *joint* frame; a payload is part of
    #: the last link.
    links: Array
    #: (n,) viscous damping [N m s/rad, N s/m].
    damping: Array
    #: (n,) dry friction [N m, N].
    friction: Array
    #: (n,) inertia of the rotors at the joints [kg m^2, kg].
    armature: Array
    #: (n,) k of the springs' torque k q + c [N m/rad, N/m].
    stiffness: Array
    #: (n,) c of the springs' torque k q + c [N m, N].
    offset: Array
    #: (n,) gains of the torque channels, measured over true; () where the model has
    #: none.
    gains: tuple[float, ...] = ()
    #: (2, n) kp and kd of the servos' position loops (:func:`servo_gains`); None where
    #: the model knows none.
    servo: Array | None = None
    #: Further terms for MuJoCo's files, as the effects declare them.
    mjcf: tuple[SimulatorTerm, ...] = ()

    @classmethod
    def of_links(cls, robot: Robot, links: Array, **fields: Array) -> Self:
        """Return the content with links about the joints' frames (links, 10); fields of
        joints that are not given are zeros."""
        values: dict[str, Any] = {x: np.zeros(robot.n) for x in JOINT_FIELDS}
        return cls(links, **(values | fields))

    def mjcf_attributes(self, element: str, joint: int = -1) -> dict[str, float]:
        """Return the sums of the effects' ``mjcf`` terms by attribute, of an element of
        a joint (from 0), or of the whole robot (-1)."""
        sums = defaultdict[str, float](float)
        for term in self.mjcf:
            if (term.attribute[0], term.joint) == (element, joint):
                sums[term.attribute[1]] += term.value
        return dict(sums)

    @classmethod
    def plausible(cls, estimate: Estimate, options: Options) -> Self:
        """Return the content of a simulator's file, with every link inside of its body.

        Parameters
        ----------
        options : Options
            How the user wants the file; ``force`` accepts links outside of their
            bodies.

        Raises
        ------
        InputError
            As :meth:`from_estimate`; for a link whose mass lies farther out than its body reaches,
            unless forced.
        """
        content = cls.from_estimate(estimate)
        if options.force:
            return content
        gyration = inertia.gyration(estimate.links)
        for k, body in enumerate(estimate.problem.link_bodies[: len(gyration)]):
            if gyration[k] > body.reach:
                raise InputError(
                    f"implausible: radius of gyration {gyration[k]:.3g} m for"
                    f" {estimate.links[k, 0]:.3g} kg, and its body reaches"
                    f" {body.reach:.3g} m (from its {body.source})",
                    "identify with the default method, which keeps every link in its"
                    " body, or accept it as it is",
                    f"link {k + 1}",
                    "--force",
                )
        return content

    @classmethod
    def from_estimate(cls, estimate: Estimate) -> Self:
        """Return what a simulator's file can hold of a model.

        Returns
        -------
        Content
            Links about the joints' frames, friction, armature, springs.

        Raises
        ------
        InputError
            For an inconsistent link, negative friction or a model without links.
        """
        model = estimate.model
        robot = estimate.robot
        if not len(model.rigid_indices):
            raise InputError(
                f"model {estimate.problem.name}: the model has no"
                f" {standard_effect('links').name} effect, so there are no inertias to"
                " export",
                "write .json instead",
            )
        links = np.array(estimate.links)
        load = payload_parameters(estimate)
        if load is not None:  # as part of the last link
            links[-1] += load[1]
        values: dict[str, Array] = {x: np.zeros(estimate.robot.n) for x in JOINT_FIELDS}
        for effect, (field, joint, value, _) in _terms(estimate):
            if field not in values:
                continue
            if value < 0.0 and field not in _SPRING_FIELDS:
                raise InputError(
                    f"joint {joint + 1}: {effect.name} is {value:.4g}"
                    f" {effect.unit_on(joint)}, and a negative {field} would feed energy"
                    " into a simulation",
                    "identify with a method that keeps signs (lmi-sdp, penalty)",
                )
            values[field][joint] += value
        return cls(
            about_joints(robot, links),
            gains=model.gains or (),
            servo=servo_gains(estimate)[0],
            **values,
            mjcf=tuple(term for _, term in _terms(estimate) if term.field == "mjcf"),
        )


def _terms(estimate: Estimate) -> Iterator[tuple[Effect, SimulatorTerm]]:
    """Yield what each effect of a model adds to simulators' files."""
    for effect, indices in estimate.model.parts:
        for term in effect.simulator_terms(estimate.theta[indices]):
            yield effect, term


def servo_gains(estimate: Estimate) -> tuple[Array | None, float]:
    """Return the gains (2, n) kp and kd of the servos, and their commands' delay T [s].

    No format has a place for the delay. Where the joint follows the command,
    kp (q_cmd(t - T) - q) = kp (q_cmd - q) - kp T dq, so kp T is added to kd. Without the
    gains of every joint they are None, and the delay is 0.
    """
    model = estimate.model
    value_by_name = {
        p.name: value for p, value in zip(model.parameters, estimate.theta, strict=True)
    }
    joints = range(1, estimate.robot.n + 1)
    gains = np.array(
        [
            [value_by_name.get(f"{gain}{joint}", np.nan) for joint in joints]
            for gain in ("kp", "kd")
        ]
    )
    if np.isnan(gains).any():
        return None, 0.0
    drives = [effect for effect in model.effects if effect.forward == "drive"]
    delay = max(effect.shape["T"] for effect in drives)
    gains[1] += delay * gains[0]
    return gains, delay


def verdict_line(estimate: Estimate) -> str:
    """Return the model's verdict, and the gains of its servos, as one line."""
    line = NOT_JUDGED if estimate.verdict is None else estimate.verdict.brief()
    parameters = zip(
        estimate.model.parameters, estimate.theta, estimate.model.drives, strict=True
    )
    gains = [
        f"{p.name} = {value:.6g} {p.unit}"
        for p, value, is_gain in parameters
        if is_gain
    ]
    if gains:
        line = f"{line} Servo gains (kd holds viscous friction): {', '.join(gains)}"
    return line


def about_joints(robot: Robot, links: Array) -> Array:
    """Return standard parameters about the joints' frames instead of the links' frames.

    Parameters
    ----------
    robot : Robot
        The kinematics: joints and their frames.
    links : (links, 10)
        About the links' frames [kg, kg m, kg m^2].

    Returns
    -------
    (links, 10)
        About the joints' frames, as Pinocchio and simulators take them.

    Raises
    ------
    InputError
        A link is not physically consistent.
    """
    moved = moved_to_joints(robot, links)
    for k, (carrier, link) in enumerate(zip(robot.link_joints, moved, strict=True)):
        name = robot.tree[carrier].name
        require_consistent(link, f"link {k + 1} (on joint {name!r})")
    return moved


def moved_to_joints(robot: Robot, links: Array) -> Array:
    """Return standard parameters about the joints' frames, whether or not the links can
    exist.

    Parameters
    ----------
    robot : Robot
        The kinematics: joints and their frames.
    links : (links, 10)
        About the links' frames [kg, kg m, kg m^2].
    """
    frames = [robot.tree[carrier].link_frame for carrier in robot.link_joints]
    return np.stack(
        [
            inertia.transform(frame) @ link
            for frame, link in zip(frames, links, strict=True)
        ]
    )


def require_consistent(link: Array, name: str) -> None:
    """Raise InputError for a link that no mass distribution has.

    Its pseudo-inertia has a negative eigenvalue then.

    Parameters
    ----------
    link : (10,)
        Standard parameters [kg, kg m, kg m^2].
    name : str
        Name of the link in the error message.
    """
    pseudo = inertia.pseudo_inertia(link)
    smallest = float(np.linalg.eigvalsh(pseudo)[0])
    tolerance = inertia.ROUNDING * max(float(np.trace(pseudo)), 0.0)
    if not np.all(np.isfinite(link)) or smallest < -tolerance:
        raise InputError(
            "the inertial is not physically consistent (smallest eigenvalue of its"
            f" pseudo-inertia {smallest:.3g}), and simulators reject such a body or"
            " diverge",
            "identify with a method that imposes consistency (lmi-sdp, penalty)",
            name,
        )


@dataclass(frozen=True)
class Inertial:
    """The inertial of a link as URDF and MJCF write it."""

    #: Mass [kg].
    mass: float
    #: (3,) centre of mass [m].
    com: Array
    #: (3, 3) inertia about the centre of mass [kg m^2].
    about_com: Array

    @classmethod
    def from_parameters(cls, link: Array) -> Self:
        """Return mass, centre of mass and inertia about it of a link.

        Parameters
        ----------
        link : (10,)
            Standard parameters [kg, kg m, kg m^2].
        """
        if link[0] == 0.0:  # consistent and massless: nothing at all
            return cls(0.0, np.zeros(3), np.zeros((3, 3)))
        parts = inertia.barycentric_from_standard(link)
        return cls(float(parts[0]), parts[1:4], inertia.inertia_matrix(parts[4:]))

    @property
    def urdf_attributes(self) -> dict[str, str]:
        """The inertia as URDF attributes: ixx, ixy, ..., izz as text of full
        precision.
        """
        pairs = combinations_with_replacement(range(3), 2)
        return {
            f"i{'xyz'[i]}{'xyz'[j]}": number(self.about_com[i, j]) for i, j in pairs
        }


def number(value: float) -> str:
    """Return the shortest text that reads back to the same double, never "-0.0"."""
    return repr(float(value) + 0.0)  # + 0.0: no negative zero


#: Characters that an XML document cannot hold, not even as entities.
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def xml_name(text: str) -> str:
    """Return a name that an XML document can hold.

    Returns
    -------
    str
        Characters that XML cannot hold are written as Python escapes.
    """
    return _NOT_XML.sub(lambda found: printable(found[0]), text)


def element(parent: Any, tag: str, text: Any = None, **attributes: Any) -> Any:
    """Append a child with text and attributes to an XML element.

    Parameters
    ----------
    parent : element
        The element to append to.
    attributes : str, number or array
        Its attributes. Numbers are written by :func:`number`, arrays separated by
        spaces.
    """

    def written(x: Any) -> str:
        """Return a text, number or array as text: numbers in full precision, arrays
        separated by blanks."""
        if isinstance(x, str):
            return xml_name(x)
        return " ".join(map(number, np.atleast_1d(x)))

    child = etree.SubElement(
        parent, tag, {name: written(x) for name, x in attributes.items()}
    )
    child.text = None if text is None else written(text)
    return child


def xml_text(root: Any, declaration: bool = True) -> bytes:
    """Return an XML document as bytes; the elements of ``root`` are indented in place.

    Parameters
    ----------
    declaration : bool
        Whether it begins with an XML declaration.
    """
    etree.indent(root)
    text = etree.tostring(root, xml_declaration=declaration, encoding="utf-8")
    return bytes(text) + b"\n"


@dataclass(frozen=True)
class LinkPart:
    """A joint of a robot's tree, with the link that it carries."""

    #: Index of the joint in the tree, from 0.
    index: int
    #: The joint.
    joint: Joint
    #: Name of the link in the document.
    name: str
    #: Name of the link that carries the joint.
    parent: str
    #: Inertial of the link; zeros where it is declared massless.
    inertial: Inertial
    #: Place among the joints that move by themselves; None for one that follows.
    place: int | None


def link_parts(robot: Robot, links: Array) -> Iterator[LinkPart]:
    """Yield every joint of a robot's tree, from the base on, with the link that it
    carries.

    Parameters
    ----------
    robot : Robot
        The kinematics: joints and their frames.
    links : (links, 10)
        Standard parameters about the joints' frames.

    Returns
    -------
    iterator of LinkPart
        A link that is declared massless has a zero inertial.
    """
    link_of = dict(zip(robot.link_joints, links, strict=True))
    places = {name: k for k, name in enumerate(robot.joint_names)}
    for i, joint in enumerate(robot.tree):
        parent = "base_link" if joint.parent < 0 else f"link{joint.parent + 1}"
        # A link without parameters is declared massless.
        body = Inertial.from_parameters(link_of.get(i, np.zeros(10)))
        yield LinkPart(i, joint, f"link{i + 1}", parent, body, places.get(joint.name))


def payload(estimate: Estimate) -> Inertial:
    """Return the model's payload: mass, centre of mass and inertia, in the last link's
    frame.

    Raises
    ------
    InputError
        If it has no payload, or one without mass.
    """
    parameters = payload_parameters(estimate)
    if parameters is None:
        raise InputError(
            "the model has no payload",
            "add one",
            command="`sdp-vs-penalty add model.json payload --frozen`",
        )
    _, load = parameters
    require_consistent(load, "payload")
    if load[0] <= 0.0:
        raise InputError("the payload has no mass", "measure with the load on")
    return Inertial.from_parameters(load)
