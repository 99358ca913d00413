"""Which inertials of a URDF are physically possible, by how much, and the nearest ones
that are."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.exporters.content import Inertial
from sdp_vs_penalty.exporters.urdf import Document, inertial_tags
from sdp_vs_penalty.files import write_bytes
from sdp_vs_penalty.problem.bodies import link_bodies
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.geometry import link_geometry
from sdp_vs_penalty.robot.plausible_units import LinkSizes, limits_in_degrees, odd_units
from sdp_vs_penalty.robot.urdf import (
    errors_located_in,
    load_urdf,
    placed_links,
    read_inertial,
)

#: How far a link reaches that no joint moves, such as the base [m].
_REACH_OF_BASE = 3.0


@dataclass(frozen=True)
class LinkCheck:
    """One link's inertial as the file writes it.

    triangle_margin : smallest of D1 + D2 - D3 over the principal moments about the centre of mass
        [kg m^2], >= 0 for a possible body; pseudo_inertia_margin : smallest eigenvalue of the 4x4
        pseudo-inertia about the link's origin (kg, kg m, kg m^2 mixed: its sign is what counts);
    reach : of its body [m], from geometry or the joints around it (3: nothing moves it); gyration : of a
        consistent link, sqrt(tr I / (2 m)) about the centre of mass [m]; nearest : the nearest possible
        Inertial of an inconsistent link with mass.
    """

    link: str
    inertial_given: Inertial
    triangle_margin: float
    pseudo_inertia_margin: float
    verdict: str
    reach: float
    gyration: float
    nearest: Inertial | None

    @classmethod
    def of(cls, link: str, theta: Array, reach: float) -> "LinkCheck":
        """Check the inertial of one link.

        Parameters
        ----------
        link : str
            Name of the link.
        theta : (10,)
            Standard parameters [kg, kg m, kg m^2].
        reach : float
            How far the link's body reaches [m].

        Returns
        -------
        LinkCheck
            Its margins, verdict, and the nearest consistent inertial if it is
            inconsistent.
        """
        inertial = Inertial.of(theta)
        moments = np.asarray(np.linalg.eigvalsh(inertial.about_com), float)
        triangle = float(moments[0] + moments[1] - moments[2])
        if theta.any() and inertial.mass <= 0.0:
            triangle = np.nan
        verdict = inertia.why_impossible(theta) or "consistent"
        nearest = None
        gyration = 0.0
        if verdict == "consistent":
            gyration = float(inertia.gyration(theta))
        elif inertial.mass > 0.0:
            about_com = inertia.nearest_inertia(inertial.about_com, inertial.mass)
            nearest = replace(inertial, about_com=about_com)
        return cls(
            link,
            inertial_given=inertial,
            triangle_margin=triangle,
            pseudo_inertia_margin=float(inertia.consistency_margin(theta)),
            verdict=verdict,
            reach=reach,
            gyration=gyration,
            nearest=nearest,
        )

    @property
    def distance(self) -> float:
        """Distance of the inertia from the nearest consistent one, Frobenius norm
        [kg m^2].
        """
        nearest = self.nearest or self.inertial_given
        return float(np.linalg.norm(self.inertial_given.about_com - nearest.about_com))

    @property
    def has_wrong_signs(self) -> bool:
        """Whether the inertia would be consistent with positive moments on its
        diagonal.
        """
        diagonal = np.diagonal(self.inertial_given.about_com)
        if np.all(diagonal >= 0.0) or self.inertial_given.mass <= 0.0:
            return False
        changed = self.inertial_given.about_com + np.diag(np.abs(diagonal) - diagonal)
        moments = np.linalg.eigvalsh(changed)
        return bool(moments[0] > 0.0 and moments[0] + moments[1] >= moments[2])

    @property
    def consistent(self) -> bool:
        """Whether a body with this mass and inertia can exist."""
        return self.verdict == "consistent"

    @property
    def unlikely(self) -> bool:
        """Whether the body can exist, but its mass lies farther out than its link
        reaches.
        """
        return self.gyration > self.reach

    def to_dict(self) -> dict[str, Any]:
        """Return the check as JSON: mass, margins, verdict and radius of gyration; for
        an inconsistent link also the nearest inertia and the distance to it. A margin
        that is not known is null."""
        names = ("link", "pseudo_inertia_margin", "consistent", "verdict")
        out = {name: getattr(self, name) for name in names} | {
            "radius_of_gyration": self.gyration
        }
        out |= {
            "mass": self.inertial_given.mass,
            "triangle_margin": formatting.finite(self.triangle_margin),
        }
        out["plausible"] = self.consistent and not self.unlikely
        if self.nearest is not None:
            values = {k: float(v) for k, v in self.nearest.urdf_attributes.items()}
            out |= {"nearest_inertia": values, "distance": self.distance}
        return out


def check_urdf(path: str | Path) -> list[LinkCheck]:
    """Check every inertial of a URDF file.

    Parameters
    ----------
    path : path
        The file.

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
    without_bounds = np.tile([-np.inf, np.inf], (robot.links, 3, 1))
    bodies = link_bodies(
        robot, without_bounds, np.zeros_like(nominal), link_geometry(path)
    )
    # Links fixed to a moving link are part of its body.
    reach_by_link = {
        link.get("name"): body.reach
        for fixed_together, body in zip(placed_links(path), bodies, strict=True)
        for link, _ in fixed_together
    }
    checks = []
    with errors_located_in(path):
        for link in Document.read(path).root.findall("link"):
            if link.find("inertial") is None:
                continue
            name = str(link.get("name"))
            reach = reach_by_link.get(name, _REACH_OF_BASE)
            checks.append(LinkCheck.of(name, read_inertial(link), reach))
    return checks


def table(checks: Sequence[LinkCheck]) -> list[tuple[str, ...]]:
    """Return one row for each link: name, verdict, mass [kg] and both margins.

    Parameters
    ----------
    checks : sequence of LinkCheck
        Checks of all links.

    Returns
    -------
    list of tuple
        Text; margins are negative if they are violated.
    """
    return [
        (
            check.link,
            check.verdict,
            f"{check.inertial_given.mass:.3g}",
            f"{check.triangle_margin:.3g}",
            f"{check.pseudo_inertia_margin:.3g}",
        )
        for check in checks
    ]


def sentences(checks: Sequence[LinkCheck], massless: Sequence[str]) -> list[str]:
    """Say what is impossible, implausible or missing in a URDF.

    Parameters
    ----------
    checks : sequence of LinkCheck
        Checks of all inertials of the file.
    massless : sequence of str
        Names of moving links without inertial.

    Returns
    -------
    list of str
        The verdict; then a sentence for each link that is consistent but whose mass
        lies
        outside of its body, for each link with wrong signs, and on links without
        inertial.
    """
    if not checks:
        return ["The file has no inertials."]
    broken = [c.link for c in checks if not c.consistent]
    how = (
        f"{', '.join(broken)} physically impossible."
        if broken
        else "all are consistent."
    )
    lines = [f"{formatting.count(len(checks), 'inertial')} checked: {how}"]
    lines += [
        f"{c.link}: consistent but implausible: radius of gyration {c.gyration:.3g} m"
        f" for {c.inertial_given.mass:.3g} kg, and its body reaches {c.reach:.3g} m. The torques"
        " of a link that hardly moves do not determine its mass and inertia"
        " separately; the default method of `identify` keeps every link in its body."
        for c in checks
        if c.unlikely
    ]
    lines += [
        f"{c.link}: possible with positive moments on the diagonal: their signs may be"
        " wrong."
        for c in checks
        if c.has_wrong_signs
    ]
    if massless:
        lines.append(
            f"Moving links without an inertial: {', '.join(massless)}. Simulators"
            " refuse or drop such links. `identify` does not need inertials, and"
            " `export --urdf` adds them."
        )
    return lines


def unit_remarks(path: str | Path, checks: Sequence[LinkCheck]) -> list[str]:
    """Say which numbers of a URDF seem to be in other units than m and kg.

    Parameters
    ----------
    path : path
        The file.
    checks : sequence of LinkCheck
        Checks of all links.

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
    longest = max(float(np.linalg.norm(j.placement[:3, 3])) for j in robot.tree)
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
    odd = odd_units(sizes, longest)
    remarks = [f"Units: {x.what} {x.remedy[0].upper()}{x.remedy[1:]}." for x in odd]
    in_degrees = limits_in_degrees(robot.joints)
    return [*remarks, f"Units: {in_degrees}."] if in_degrees else remarks


def massless_links(path: str | Path) -> list[str]:
    """Return the names of moving links without an inertial.

    A link that is fixed to them may have one instead.

    Parameters
    ----------
    path : path
        The URDF file.

    Returns
    -------
    list of str

    Raises
    ------
    InputError
        For a file that is not a URDF of a tree of joints.
    """
    moving = zip(placed_links(path), load_urdf(path)[1], strict=True)
    return [str(parts[0][0].get("name")) for parts, theta in moving if not theta.any()]


def write_nearest(path: str | Path, checks: list[LinkCheck], out: str | Path) -> None:
    """Write a copy of a URDF in which inconsistent inertials are replaced by the
    nearest.

    Every other byte stays.

    Parameters
    ----------
    path : path
        The file.
    checks : list of LinkCheck
        Checks of all links.
    out : path
        The file to write.

    Raises
    ------
    InputError
        If a link has no positive mass: no inertia is nearest then.
    """
    document = Document.read(path)
    links = {link.get("name"): link for link in document.root.findall("link")}
    for check in checks:
        if check.nearest is not None:
            document.put(
                links[check.link], "inertial", {}, inertial_tags(check.nearest)
            )
        elif not check.consistent:
            what = (
                f"link {check.link!r} has a mass of {check.inertial_given.mass:g} kg"
                f" ({check.verdict})"
            )
            raise InputError(
                what,
                "correct it in the file, because no inertia is nearest to it",
                path,
            )
    write_bytes(out, document.edited())
