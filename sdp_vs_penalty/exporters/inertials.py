"""Check which inertials of a URDF are physically possible, by what margin, and what
repairs the others."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.exporters.content import Content, Inertial
from sdp_vs_penalty.exporters.own_file import Document
from sdp_vs_penalty.exporters.urdf import inertial_tags, make_urdf
from sdp_vs_penalty.files import read_bytes, write_bytes
from sdp_vs_penalty.problem.bodies import link_bodies
from sdp_vs_penalty.records import NOT_STORED, WritesJson, stored_as
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.geometry import link_geometry
from sdp_vs_penalty.robot.inertial_repair import (
    CENTRE,
    MOMENTS,
    PRODUCTS,
    Repair,
    WrittenInertial,
    find_exchanges,
    find_repairs,
    find_shared,
)
from sdp_vs_penalty.robot.model_files import format_of
from sdp_vs_penalty.robot.plausible_units import (
    LONGEST,
    LinkSizes,
    odd_limits,
    odd_units,
)
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.robot.robot_file import as_urdf, load_robot
from sdp_vs_penalty.robot.sdf import defaults_left_in
from sdp_vs_penalty.robot.urdf import (
    axes_left_out,
    couplings_left_out,
    errors_located_in,
    load_urdf,
    numbers_of,
    parse_urdf,
    placed_links,
    pose_of,
    read_inertial,
)

#: Most typing mistakes that are named, where several explain a link equally well.
_MOST_NAMED = 4
#: Reach of a link that no joint moves, such as the base [m].
_REACH_OF_BASE = 3.0


@dataclass(frozen=True)
class LinkCheck(WritesJson):
    """One link's inertial as the file writes it, and what is wrong with it."""

    derived = ("mass", "consistent", "plausible", "nearest_inertia", "distance")

    #: Name of the link.
    link: str
    #: Mass, centre of mass and inertia that the file writes.
    inertial_given: Inertial = field(metadata=NOT_STORED)
    #: Smallest of D1 + D2 - D3 over the principal moments about the centre of mass
    #: [kg m^2], >= 0 for a possible body; NaN without a positive mass.
    triangle_margin: float
    #: Smallest eigenvalue of the 4x4 pseudo-inertia about the link's origin (kg, kg m,
    #: kg m^2 mixed: its sign is what counts).
    pseudo_inertia_margin: float
    #: "consistent", or why no body has these numbers.
    verdict: str
    #: How far its body reaches [m], from geometry or the joints around it; _REACH_OF_BASE
    #: where no joint moves it.
    reach: float
    #: Radius sqrt(tr I / (2 m)) about the centre of mass of a consistent link [m].
    gyration: float = field(metadata=stored_as("radius_of_gyration"))
    #: Why a consistent link does not fit its shapes or its place; "" where it does.
    misfit: str
    #: Numbers that the file writes twice, and differently, such as iyx against ixy.
    contradictions: tuple[str, ...]
    #: Typing mistakes that explain it and are not told apart, the likeliest first.
    repairs: tuple[Repair, ...]
    #: Repair of an impossible link that ``--fix`` writes: the one that explains it, or the
    #: likeliest if the nearest inertia is too large for the link's body. None: ``--fix``
    #: writes the nearest inertia.
    repair: Repair | None = field(metadata=NOT_STORED)
    #: Nearest possible inertial (Frobenius norm) of an inconsistent link with mass;
    #: None of other links.
    nearest: Inertial | None = field(metadata=NOT_STORED)
    #: Whether the nearest inertia differs by no more than the written digits.
    is_rounding: bool
    #: The mistake that was made in all links of the file; "" where none was.
    of_all: str = ""

    @classmethod
    def from_link(cls, link: Any, written: WrittenInertial) -> "LinkCheck":
        """Check the inertial of one link, as it is written."""
        theta = read_inertial(link)
        inertial = Inertial.from_parameters(theta)
        moments = np.asarray(np.linalg.eigvalsh(inertial.about_com), float)
        triangle = float(moments[0] + moments[1] - moments[2])
        if theta.any() and inertial.mass <= 0.0:
            triangle = np.nan
        impossible = inertia.why_impossible(theta)
        contradictions = _contradictions(link)
        nearest = None
        nearest_fits_body = True
        misfit = ""
        is_rounding = False
        repairs: list[Repair] = []
        is_clear = False
        if not impossible:
            misfit, repairs = _misfit_of_possible(written)
        elif inertial.mass > 0.0:
            about_com = inertia.nearest_inertia(inertial.about_com, inertial.mass)
            nearest = replace(inertial, about_com=about_com)
            squared_gyration = np.trace(about_com) / (2.0 * inertial.mass)
            nearest_fits_body = bool(squared_gyration < written.reach**2)
            change = float(np.linalg.norm(about_com - inertial.about_com))
            is_rounding = change <= written.resolution
            if not is_rounding:
                size = max(float(np.linalg.norm(inertial.about_com)), 1e-300)
                # A moment that is not positive is never a small error.
                is_gross = np.diagonal(inertial.about_com).min() <= 0.0
                move = 1.0 if is_gross else change / size
                repairs, is_clear = find_repairs(written, move)
        else:
            repairs, is_clear = find_repairs(written, move=1.0)
        return cls(
            link=str(link.get("name")),
            inertial_given=inertial,
            triangle_margin=triangle,
            pseudo_inertia_margin=float(inertia.consistency_margin(theta)),
            verdict=impossible or "; ".join(contradictions) or "consistent",
            reach=written.reach,
            gyration=0.0 if impossible else float(inertia.gyration(theta)),
            misfit=misfit,
            contradictions=contradictions,
            repairs=tuple(repairs),
            # If even the nearest inertia is too large for the body, the likeliest mistake
            # is repaired instead.
            repair=(
                repairs[0] if repairs and (is_clear or not nearest_fits_body) else None
            ),
            nearest=nearest,
            is_rounding=is_rounding,
        )

    @property
    def distance(self) -> float:
        """Distance of the inertia from the nearest consistent one, Frobenius norm
        [kg m^2].
        """
        nearest = self.nearest or self.inertial_given
        return float(np.linalg.norm(self.inertial_given.about_com - nearest.about_com))

    @property
    def consistent(self) -> bool:
        """Whether a body with this mass and inertia can exist, and the file agrees with
        itself."""
        return self.verdict == "consistent"

    @property
    def unlikely(self) -> bool:
        """Whether the body can exist, but does not fit its shapes or its place, or all links
        have one mistake."""
        return bool(self.misfit or self.of_all)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is wrong with a link, what explains it, and what ``--fix`` writes."""
        texts = () if self.of_all else self._texts()
        return tuple(f"{self.link}: {text}." for text in texts)

    def _texts(self) -> Iterator[str]:
        """Yield the sentences without the link's name and the full stop."""
        if self.misfit:
            yield f"possible, but {self.misfit}"
        for text in self.contradictions:
            yield f"{text}: readers of URDF take the latter; correct the wrong one"
        if self.repair is not None and len(self.repairs) == 1:
            yield f"{self.repair.sentence} (--fix writes this)"
        elif self.repairs:
            first = enumerate(self.repairs[:_MOST_NAMED], start=1)
            each = "; ".join(f"({k}) {x.sentence}" for k, x in first)
            more = len(self.repairs) - _MOST_NAMED
            further = f"; and {more} more" if more > 0 else ""
            chosen = (
                "none is chosen" if self.repair is None else "--fix writes the first"
            )
            how = f"{len(self.repairs)} mistakes explain it equally, {chosen}"
            if self.misfit:
                how = (
                    "one typing mistake would explain it, which --fix leaves, for a body"
                    " can have these numbers"
                )
            elif len(self.repairs) == 1:
                how = "one typing mistake explains it hardly better than another error"
            yield f"{how}: {each}{further}"
        if self.nearest is not None and self.repair is None:
            why = (
                "within the written digits"
                if self.is_rounding
                else "mass and centre kept"
            )
            attributes = self.nearest.urdf_attributes.items()
            numbers = " ".join(f'{name}="{value}"' for name, value in attributes)
            yield (
                f"the nearest consistent inertia ({why}; Frobenius norm of the change"
                f" {self.distance:.2g} kg m^2; about the centre of mass, axes of the"
                f" link; --fix writes this): {numbers}"
            )

    @property
    def mass(self) -> float:
        """Mass that the file writes [kg]."""
        return self.inertial_given.mass

    @property
    def plausible(self) -> bool:
        """Whether the body can exist, and fits its shapes and its place."""
        return self.consistent and not self.unlikely

    @property
    def nearest_inertia(self) -> dict[str, float] | None:
        """The nearest inertia as a URDF writes it, for an inconsistent link."""
        if self.nearest is None:
            return None
        return {k: float(v) for k, v in self.nearest.urdf_attributes.items()}


@contextmanager
def checkable(path: Path) -> Iterator[Path]:
    """Turn a robot's file into a URDF for the length of a block, as `as_urdf` does. An
    MJCF becomes a URDF too; each joint's link has the name of its body."""
    if format_of(read_bytes(path)) != "mjcf":
        with as_urdf(path) as file:
            yield file
        return
    from sdp_vs_penalty.robot.mjcf import load_bodies

    stated = load_robot(path)
    content = Content.of_links(stated.robot, stated.links)
    text = make_urdf(stated.robot, content).decode()
    for body in reversed(load_bodies(path)[1]):
        if body.joints and body.name:
            ours = f'"link{body.carrier + 1}"'
            text = text.replace(ours, quoteattr(body.name))
    with TemporaryDirectory() as folder:
        out = Path(folder) / f"{path.stem}.urdf"
        out.write_text(text)
        yield out


def check_urdf(path: str | Path) -> list[LinkCheck]:
    """Check every inertial of a URDF file.

    Returns
    -------
    list of LinkCheck
        In the order of the file.

    Raises
    ------
    InputError
        For a file that is not a URDF of a tree of joints.
    """
    # Refuses the file in one sentence for whatever else is wrong with it.
    robot, nominal = load_urdf(path)
    room = _room_of_links(path, robot, nominal)
    with errors_located_in(path):
        elements = Document.read(path).root.findall("link")
        links = [link for link in elements if link.find("inertial") is not None]
        written = [
            _written(link, *room.get(link.get("name"), (_REACH_OF_BASE, None)))
            for link in links
        ]
        checks = list(map(LinkCheck.from_link, links, written))
    moving = [
        k
        for k, (link, inertial) in enumerate(zip(links, written, strict=True))
        if link.get("name") in room and inertial.number("mass")
    ]
    # If lengths are in another unit, no link is judged by its size.
    if _longest(robot) >= LONGEST:
        return checks
    shared = find_shared([written[k] for k in moving])
    if shared is None:
        return checks
    mistake, repairs = shared
    repair_of_each: Sequence[Repair | None] = repairs or [None] * len(moving)
    for k, repair in zip(moving, repair_of_each, strict=True):
        checks[k] = replace(
            checks[k],
            of_all=mistake,
            repairs=() if repair is None else (repair,),
            repair=repair,
            misfit="",
        )
    return checks


def _room_of_links(
    path: str | Path, robot: Robot, nominal: Array
) -> dict[str, tuple[float, Array | None]]:
    """Return for each moving link of a URDF, by its name, how far mass may lie from its
    origin [m], and the points of its shapes (K, 3) in its frame; None for a link without
    a shape, whose mass may lie anywhere in that reach."""
    without_bounds = np.tile([-np.inf, np.inf], (robot.links, 3, 1))
    geometry = link_geometry(path)
    bodies = link_bodies(robot, without_bounds, np.zeros_like(nominal), geometry)
    room = {}
    for fixed_together, body, shape in zip(
        placed_links(path), bodies, geometry, strict=True
    ):
        # Links fixed to a moving link are part of its body.
        for link, at in fixed_together:
            drawings = (link.find("collision"), link.find("visual"))
            points = None
            if shape is not None and any(x is not None for x in drawings):
                points = (shape.points - at[:3, 3]) @ at[:3, :3]
            room[link.get("name")] = body.reach, points
    return room


def _longest(robot: Robot) -> float:
    """Return the largest distance between two joints [m]."""
    return max(float(np.linalg.norm(j.placement[:3, 3])) for j in robot.tree)


def _written(
    link: Any, reach: float = np.inf, shape: Array | None = None
) -> WrittenInertial:
    """Return the numbers of a link's <inertial> as text; "0" for those that are
    missing."""
    element = link.find("inertial")
    mass, tensor = element.find("mass"), element.find("inertia")
    origin = element.find("origin")
    pose = pose_of(element)  # refuses an origin of other than three numbers
    centre = "0 0 0" if origin is None else origin.get("xyz", "0 0 0")
    texts = {"mass": "0" if mass is None else mass.get("value", "0")}
    texts |= dict(zip(CENTRE, centre.split(), strict=True))
    texts |= {k: "0" if tensor is None else tensor.get(k, "0") for k in MOMENTS}
    texts = {name: text.strip() for name, text in texts.items()}
    return WrittenInertial(texts, pose[:3, :3], reach, shape)


def _misfit_of_possible(written: WrittenInertial) -> tuple[str, list[Repair]]:
    """Return how an inertial that can exist does not fit its link, "" where it does, and
    the mistakes that explain it."""
    misfit = written.misfit(written.barycentric())
    if misfit:
        return misfit, find_repairs(written)[0]
    exchanges = find_exchanges(written)
    if exchanges:
        misfit = "turned: its moments fit its shapes far better about other axes"
    return misfit, exchanges


def _contradictions(link: Any) -> tuple[str, ...]:
    """Return what a tensor says twice and differently: iyx against ixy, and so on."""
    tensor = link.find("inertial/inertia")
    contradictions = []
    for name in PRODUCTS:
        mirrored = f"i{name[2]}{name[1]}"
        if tensor is None or tensor.get(mirrored) is None:
            continue
        text, mirrored_text = tensor.get(name) or "0", tensor.get(mirrored)
        if numbers_of(text, 1)[0] != numbers_of(mirrored_text or "0", 1)[0]:
            contradictions.append(
                f'{mirrored}="{mirrored_text}" contradicts {name}="{text}"'
            )
    return tuple(contradictions)


def table(checks: Sequence[LinkCheck]) -> list[tuple[str, ...]]:
    """Return one row for each link: name, verdict, mass [kg] and both margins.

    Returns
    -------
    list of tuple
        Text; margins are negative if they are violated.
    """
    return [
        (
            check.link,
            "implausible" if check.consistent and check.unlikely else check.verdict,
            f"{check.inertial_given.mass:.3g}",
            f"{check.triangle_margin:.3g}",
            f"{check.pseudo_inertia_margin:.3g}",
        )
        for check in checks
    ]


def sentences(
    checks: Sequence[LinkCheck], massless: Sequence[str], units: Sequence[str] = ()
) -> list[str]:
    """Say what is impossible, implausible or missing in a URDF.

    Parameters
    ----------
    checks : sequence of LinkCheck
        Checks of all inertials of the file.
    massless : sequence of str
        Names of moving links without inertial.
    units : sequence of str
        Remarks of :func:`unit_remarks`. If units are wrong, no link is judged by its
        size.

    Returns
    -------
    list of str
        The verdict; then what is wrong with each link, what explains it and what
        ``--fix`` writes; then links without inertial.
    """
    if not checks:
        return ["The file has no inertials."]
    if any(x.startswith("Units") for x in units):
        checks = [replace(c, misfit="", repairs=()) if c.misfit else c for c in checks]
    verdict = _verdict(checks)
    lines = [f"{formatting.count(len(checks), 'inertial')} checked: {verdict}"]
    for text in dict.fromkeys(check.of_all for check in checks if check.of_all):
        is_repaired = any(check.repair for check in checks)
        lines.append(f"All links: {text}{' (--fix writes this)' * is_repaired}.")
    lines += [text for check in checks for text in check.sentences]
    if massless:
        lines.append(
            f"Moving links without an inertial: {', '.join(massless)}. Simulators"
            " refuse or drop such links. `identify` does not need inertials, and"
            " `export --urdf` adds them."
        )
    return lines


def _verdict(checks: Sequence[LinkCheck]) -> str:
    """Return the result of all checks in words: which links are impossible, contradictory
    or implausible."""
    kinds = {
        "physically impossible": [
            c.link for c in checks if not c.consistent and not c.contradictions
        ],
        "contradictory": [c.link for c in checks if c.contradictions],
        "possible but implausible": [
            c.link for c in checks if c.consistent and c.unlikely
        ],
    }
    found = [f"{', '.join(links)} {kind}" for kind, links in kinds.items() if links]
    return f"{'; '.join(found)}." if found else "all are consistent."


def unit_remarks(path: str | Path, checks: Sequence[LinkCheck]) -> list[str]:
    """Say which numbers of a URDF seem to be in other units than m and kg.

    Returns
    -------
    list of str
        A sentence for each, with what to do.

    Raises
    ------
    InputError
        For a file that is not a URDF of a tree of joints.
    """
    robot, _ = load_urdf(path)
    sizes = [
        LinkSizes(
            c.link,
            c.inertial_given.mass,
            float(np.linalg.norm(c.inertial_given.com)),
            float(np.linalg.eigvalsh(c.inertial_given.about_com)[-1]),
        )
        for c in checks
        if np.isfinite(c.inertial_given.about_com).all()
    ]
    odd = odd_units(sizes, _longest(robot))
    remarks = [f"Units: {x.what} {formatting.sentence(x.remedy)}." for x in odd]
    if odd_limit := odd_limits(robot.joints):
        remarks.append(f"Units: {odd_limit}.")
    if without := axes_left_out(parse_urdf(path)):
        remarks.append(
            f"Axes: {formatting.words(without)} without <axis>, where the others have theirs:"
            ' it is xyz="1 0 0" then; write the one that is meant.'
        )
    return remarks


def format_remarks(path: Path) -> list[str]:
    """Say that gravity of an MJCF points upwards, and which numbers an SDF's <inertial>s
    leave out, for which the format has defaults."""
    kind = format_of(read_bytes(path))
    if kind == "sdf":
        links = parse_urdf(path).iter("link")
        defaults_by_link = {x.get("name"): defaults_left_in(x) for x in links}
        return [
            f"Left out: {formatting.words(names)} of {link}: SDF's default is 1 kg and"
            " 1 kg m^2 then; write the link's own."
            for link, names in defaults_by_link.items()
            if names
        ]
    gravity = load_robot(path).robot.gravity if kind == "mjcf" else np.zeros(3)
    upwards = (
        f'Gravity: it points upwards, gravity="{" ".join(f"{x:g}" for x in gravity)}":'
    )
    return [f"{upwards} z is up in MJCF."] if gravity[2] > 0.0 else []


def coupling_remarks(path: str | Path, *, has_lines: bool) -> list[str]:
    """Name in one sentence, or none, what couples links of a URDF in addition to its
    tree of joints; with lines where the file is the user's."""
    left_out = couplings_left_out(parse_urdf(path), has_lines=has_lines)
    return [f"{left_out}."] if left_out else []


def massless_links(path: str | Path) -> list[str]:
    """Return the names of moving links without an inertial.

    A link that is fixed to them may have one instead.

    Raises
    ------
    InputError
        For a file that is not a URDF of a tree of joints.
    """
    moving = zip(placed_links(path), load_urdf(path)[1], strict=True)
    return [str(parts[0][0].get("name")) for parts, theta in moving if not theta.any()]


def write_repaired(path: str | Path, checks: list[LinkCheck], out: str | Path) -> None:
    """Write a copy of a URDF with the numbers of the one typing mistake that explains a
    link, or else the nearest consistent inertia.

    Every other byte stays, and a link that can exist keeps its numbers.

    Raises
    ------
    InputError
        If a link has no positive mass, and no mistake explains it: no inertia is nearest
        then.
    """
    document = Document.read(path)
    links = {link.get("name"): link for link in document.root.findall("link")}
    for check in checks:
        link = links[check.link]
        if check.repair is not None:
            for tag, attributes in _tags(check.repair, link).items():
                document.put(link.find("inertial"), tag, attributes)
        elif check.nearest is not None:
            document.put(link, "inertial", {}, inertial_tags(check.nearest))
        elif not check.consistent and not check.contradictions:
            what = (
                f"link {check.link!r} has a mass of {check.inertial_given.mass:g} kg"
                f" ({check.verdict})"
            )
            remedy = "correct it in the file, because no inertia is nearest to it"
            raise InputError(what, remedy, path)
    write_bytes(out, document.edited())


def _tags(repair: Repair, link: Any) -> dict[str, dict[str, str]]:
    """Return the attributes that a repair changes, by the tags of an <inertial>."""
    texts = dict(repair.texts)
    tags = dict[str, dict[str, str]]()
    if "mass" in texts:
        tags["mass"] = {"value": texts["mass"]}
    if texts.keys() & set(CENTRE):
        centre = _written(link).texts
        tags["origin"] = {"xyz": " ".join({**centre, **texts}[k] for k in CENTRE)}
    if moments := {k: texts[k] for k in MOMENTS if k in texts}:
        tags["inertia"] = moments
    return tags
