"""What of a model a simulator's file can hold: links, damping, dry friction, armature."""

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any, Self

import numpy as np
from lxml import etree

from sdp_vs_penalty.errors import InputError, printable
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.verdict import NOT_JUDGED
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.joint import Joint
from sdp_vs_penalty.robot.robot import Robot

#: Effects with a place in some simulator's file, and what they are there.
_PLACES = {
    "viscous_friction": "damping",
    "coulomb_friction": "friction",
    "rotor_inertia": "armature",
    "joint_spring": "stiffness",
    "torque_offset": "offset",
}
#: Of these the ones that may be negative.
_SIGNLESS = ("stiffness", "offset")
#: What every simulator's file holds.
HELD = frozenset({"rigid_body", "payload", "viscous_friction", "coulomb_friction"})

#: Smallest eigenvalue of a pseudo-inertia, relative to its trace, that still counts as
#: consistent: what rounding leaves of an exact zero (a rod, a point mass) after a
#: change of frames.
ROUNDING = 1e-12


@dataclass(frozen=True)
class Options:
    """How a user wants a file: the arguments of :func:`export`."""

    urdf: str | Path | None = None
    force: bool = False
    flange: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Content:
    """links : (links, 10) standard parameters about each *joint* frame; damping [N m
    s/rad, N s/m], friction [N m, N], armature [kg m^2, kg], stiffness [N m/rad, N/m]
    and offset [N m, N] of the torque k q + c: (n,), zero where the model has none; a
    payload is part of the last link. others : names of the effects that have no place in
    any such file, springs : of those that some have a place for.
    """

    links: Array
    damping: Array
    friction: Array
    armature: Array
    stiffness: Array
    offset: Array
    springs: tuple[str, ...]
    others: tuple[str, ...]
    #: Of the torque channels, measured over true; () where the model has none.
    gains: tuple[float, ...] = ()
    #: (2, n) kp and kd of the servos' position loops, the latter with what a command's
    #: delay damps less; None where the model knows none.
    servo: Array | None = None

    @classmethod
    def plausible(cls, estimate: Estimate, options: Options) -> Self:
        """As :meth:`of`, with every link inside of its body.

        Parameters
        ----------
        estimate : Estimate
            The model.
        options : Options
            How the user wants the file.

        Returns
        -------
        Content
            What a simulator's file can hold of the model.

        Raises
        ------
        InputError
            As :meth:`of`; for a link that lies outside of its body, unless forced.
        """
        content = cls.of(estimate)
        gyration = inertia.gyration(estimate.links)
        for k, body in enumerate(
            [] if options.force else estimate.problem.link_bodies[: len(gyration)]
        ):
            if gyration[k] > body.reach:
                raise InputError(
                    f"implausible: radius of gyration {gyration[k]:.3g} m for"
                    f" {estimate.links[k, 0]:.3g} kg, and its body reaches"
                    f" {body.reach:.3g} m (from its {body.source})",
                    "identify with the default method, which keeps every link in its"
                    " body, or pass --force",
                    f"link {k + 1}",
                )
        return content

    @classmethod
    def of(cls, estimate: Estimate) -> Self:
        """What a simulator's file can hold of a model.

        Parameters
        ----------
        estimate : Estimate
            The model.

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
                f"model {estimate.problem.name}: the model has no rigid_body effect, so"
                " there are no inertias to export",
                "write .json instead",
            )
        links = about_joints(robot, _with_payload(estimate))
        values = {name: np.zeros(robot.n) for name in _PLACES.values()}
        for p, value in zip(model.parameters, estimate.theta, strict=True):
            if (place := _PLACES.get(p.effect)) is None:
                continue
            if value < 0.0 and place not in _SIGNLESS:
                raise InputError(
                    f"joint {p.joint}: {p.effect} is {value:.4g} {p.unit}, and a"
                    f" negative {place} would feed energy into a simulation",
                    "identify with a method that keeps signs (lmi-sdp, penalty)",
                )
            values[place][p.joint - 1] += value
        held = (*_PLACES, *HELD, "servo_position")
        of_springs = ("joint_spring", "torque_offset")
        springs = tuple(e.brief for e in model.effects if e.name in of_springs)
        others = tuple(e.brief for e in model.effects if e.name not in held)
        model_given = {
            p.name: x for p, x in zip(model.parameters, estimate.theta, strict=True)
        }
        loops = [
            [model_given.get(f"{x}{j + 1}", np.nan) for j in range(robot.n)]
            for x in ("kp", "kd")
        ]
        servo = None if np.isnan(loops).any() else np.array(loops)
        drives = [e for e in model.effects if e.forward == "drive"]
        if servo is not None and (delay := max(e.shape["T"] for e in drives)):
            # kp (q_cmd(t - T) - q) is kp (q_cmd - q) - kp T dq where the joint follows.
            servo[1] += delay * servo[0]
            others += (
                f"the command's delay of {1e3 * delay:.2g} ms (kv is kd + kp T)",
            )
        gains = model.gains or ()
        return cls(
            links,
            others=others,
            springs=springs,
            gains=gains,
            servo=servo,
            **values,
        )

    def left_out(
        self,
        *,
        armature: bool,
        springs: bool = False,
    ) -> tuple[str, ...]:
        """Effects that are lost in a file.

        Parameters
        ----------
        armature : bool
            Whether it has a place for armature.
        springs : bool
            Whether it has one for springs and offsets.

        Returns
        -------
        tuple of str
            As they are written.
        """
        lost = (
            ("rotor_inertia",) if not armature and np.any(self.armature > 0.0) else ()
        )
        return (*lost, *(() if springs else self.springs), *self.others)


def _with_payload(estimate: Estimate) -> Array:
    """(links, 10) standard parameters, a payload as part of the last link."""
    links = np.array(estimate.links)
    load = np.array([p.effect == "payload" for p in estimate.model.parameters])
    if load.any():
        links[-1] += estimate.theta[load].reshape(-1, links.shape[1]).sum(axis=0)
    return links


def with_effects(estimate: Estimate, held: Collection[str]) -> Estimate:
    """A copy of a model without the effects that are not held, and without a verdict.

    Parameters
    ----------
    estimate : Estimate
        The model.
    held : collection of str
        Names of effects.

    Returns
    -------
    Estimate
        Nothing is identified again: this is the model that a file holds which
        has a place for these effects only. The servo loops of a model without
        torques stay.
    """
    model = estimate.model
    known = estimate.uncertainty
    keep = [e.name in held or e.forward == "drive" for e in model.effects]
    kept = [
        indices for stays, (_, indices) in zip(keep, model.parts, strict=True) if stays
    ]
    index = np.sort(np.concatenate(kept))
    reference = None if model.reference is None else model.reference[index]
    effects = tuple(e for stays, e in zip(keep, model.effects, strict=True) if stays)
    known = replace(
        known,
        standard=tuple(known.standard[k] for k in index),
        base=(),
        spread=known.spread[index],
        gain_response=known.gain_response[index],
    )
    return replace(
        estimate,
        model=replace(
            model,
            effects=effects,
            reference=reference,
        ),
        theta=estimate.theta[index],
        uncertainty=known,
        provenance={k: x for k, x in estimate.provenance.items() if k != "verdict"},
    )


def verdict_line(estimate: Estimate) -> str:
    """The verdict that a model came with, and its servos' gains.

    Parameters
    ----------
    estimate : Estimate
        The model.

    Returns
    -------
    str
        One line of printable ASCII.
    """
    line = NOT_JUDGED if estimate.verdict is None else estimate.verdict.brief()
    both = zip(
        estimate.model.parameters,
        estimate.theta,
        estimate.model.drives,
        strict=True,
    )
    if gains := ", ".join(
        f"{p.name} = {x:.6g} {p.unit}" for p, x, drive in both if drive
    ):
        line = f"{line} Servo gains (kd holds viscous friction): {gains}"
    return re.sub(r"[^\x20-\x7e]", "?", line)


def about_joints(robot: Robot, links: Array) -> Array:
    """Standard parameters about the joints' frames.

    Parameters
    ----------
    robot : Robot
        Its kinematics.
    links : (links, 10)
        About the links' frames.

    Returns
    -------
    (links, 10)
        In Pinocchio's order.

    Raises
    ------
    InputError
        For an inconsistent link.
    """
    carriers = [robot.tree[carrier] for carrier in robot.link_joints]
    out = [
        inertia.transform(j.link_frame) @ links_of_joint
        for j, links_of_joint in zip(carriers, links, strict=True)
    ]
    for k, (joint, link) in enumerate(zip(carriers, out, strict=True), start=1):
        require_consistent(link, f"link {k} (on joint {joint.name!r})")
    return np.stack(out)


def require_consistent(link: Array, name: str) -> None:
    """Refuse a link that no mass distribution has.

    Parameters
    ----------
    link : (10,)
        Standard parameters.
    name : str
        What to call the link.

    Returns
    -------
    None
        Nothing.

    Raises
    ------
    InputError
        Where its pseudo-inertia has a negative eigenvalue.
    """
    pseudo = inertia.pseudo_inertia(link)
    smallest = float(np.linalg.eigvalsh(pseudo)[0])
    if not np.all(np.isfinite(link)) or smallest < -ROUNDING * max(
        float(np.trace(pseudo)), 0.0
    ):
        raise InputError(
            "the inertial is not physically consistent (smallest eigenvalue of its"
            f" pseudo-inertia {smallest:.3g}), and simulators reject such a body or"
            " diverge",
            "identify with a method that imposes consistency (lmi-sdp, penalty)",
            name,
        )


@dataclass(frozen=True)
class Inertial:
    """As URDF and MJCF write it: mass [kg], com (3,) [m], about_com (3, 3) [kg m^2]."""

    mass: float
    com: Array
    about_com: Array

    @classmethod
    def of(cls, link: Array) -> Self:
        """The inertial of a link.

        Parameters
        ----------
        link : (10,)
            Standard parameters.

        Returns
        -------
        Inertial
            Mass, centre of mass, and inertia about it.
        """
        if link[0] == 0.0:  # consistent and massless: nothing at all
            return cls(
                0.0,
                np.zeros(3),
                np.zeros((3, 3)),
            )
        parts = inertia.barycentric_from_standard(link)
        return cls(
            float(parts[0]),
            parts[1:4],
            inertia.inertia_matrix(parts[4:]),
        )

    @property
    def urdf_attributes(self) -> dict[str, str]:
        """ixx ... izz as text of full precision."""
        pairs = combinations_with_replacement(range(3), 2)
        return {
            f"i{'xyz'[i]}{'xyz'[j]}": number(self.about_com[i, j]) for i, j in pairs
        }


def number(value: float) -> str:
    """The shortest text that reads back to the same double.

    Parameters
    ----------
    value : float
        Finite.

    Returns
    -------
    str
        No negative zero.
    """
    return repr(float(value) + 0.0)  # + 0.0: no negative zero


#: What an XML document cannot hold, however it is written.
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def xml_name(text: str) -> str:
    """A name whose characters an XML document can hold.

    Parameters
    ----------
    text : str
        Any name.

    Returns
    -------
    str
        What XML cannot hold is written as Python writes it.
    """
    return _NOT_XML.sub(lambda found: printable(found[0]), text)


def element(
    parent: Any,
    tag: str,
    text: Any = None,
    **attributes: Any,
) -> Any:
    """Append a child with text and attributes.

    Parameters
    ----------
    parent : element
        To which it is appended.
    tag : str
        Its name.
    text : str, number or array, optional
        What stands in it.
    attributes : str, number or array
        Numbers and arrays of them are written by :func:`number`.

    Returns
    -------
    element
        The child.
    """

    def written(x: Any) -> str:
        if isinstance(x, str):
            return xml_name(x)
        return " ".join(map(number, np.atleast_1d(x)))

    child = etree.SubElement(
        parent,
        tag,
        {name: written(x) for name, x in attributes.items()},
    )
    child.text = None if text is None else written(text)
    return child


def xml_text(root: Any, declaration: bool = True) -> bytes:
    """The indented document.

    Parameters
    ----------
    root : element
        Of the document.
    declaration : bool
        Whether it begins with one.

    Returns
    -------
    bytes
        UTF-8.
    """
    etree.indent(root)
    return (
        bytes(
            etree.tostring(
                root,
                xml_declaration=declaration,
                encoding="utf-8",
            )
        )
        + b"\n"
    )


@dataclass(frozen=True)
class LinkPart:
    """A joint of the tree by its index, its link and inertial; place : among the joints
    that move by themselves, None for one that follows."""

    index: int
    joint: Joint
    name: str
    parent: str
    inertial: Inertial
    place: int | None


def parts(robot: Robot, links: Array) -> Iterator[LinkPart]:
    """Every joint in the tree's order, with its link and inertial.

    Parameters
    ----------
    robot : Robot
        Its kinematics.
    links : (links, 10)
        About the joints' frames.

    Returns
    -------
    iterator of LinkPart
        From the base on.
    """
    link_of = dict(zip(robot.link_joints, links, strict=True))
    places = {name: k for k, name in enumerate(robot.joint_names)}
    for i, joint in enumerate(robot.tree):
        parent = "base_link" if joint.parent < 0 else f"link{joint.parent + 1}"
        body = Inertial.of(
            link_of.get(i, np.zeros(10))
        )  # nothing where it is declared massless
        yield LinkPart(
            i,
            joint,
            f"link{i + 1}",
            parent,
            body,
            places.get(joint.name),
        )


def payload(estimate: Estimate) -> Inertial:
    """The model's payload in the last link's frame.

    Parameters
    ----------
    estimate : Estimate
        The model.

    Returns
    -------
    Inertial
        Mass, centre of mass, and inertia about it.

    Raises
    ------
    InputError
        Where it has none.
    """
    is_payload = [p.effect == "payload" for p in estimate.model.parameters]
    if not any(is_payload):
        raise InputError(
            "the model has no payload",
            "add one: `sdp-vs-penalty add model.json payload --frozen`",
        )
    load = estimate.theta[np.array(is_payload)]
    require_consistent(load, "payload")
    if load[0] <= 0.0:
        raise InputError("the payload has no mass", "measure with the load on")
    return Inertial.of(load)
