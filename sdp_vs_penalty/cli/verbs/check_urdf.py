from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sdp_vs_penalty.exporters.inertials import LinkCheck


def verb(urdf: Path, json_: Path | None = None, fix: Path | None = None) -> None:
    """Check the inertials of a URDF: which bodies are impossible, by how much, the nearest possible.

    Exit code 1 where one is impossible, or in another unit than m and kg.
    Example: sdp-vs-penalty check-urdf robot.urdf

    urdf robot.urdf: File to check.
    --fix fixed.urdf: Copy to write, with the nearest consistent inertials.
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.exporters import inertials

    checks = inertials.check_urdf(urdf)
    massless = inertials.massless_links(urdf)
    verdict, *remarks = inertials.sentences(checks, massless)
    units = inertials.unit_remarks(urdf, checks)
    if units:
        verdict = f"{verdict[:-1]}; units are not m, kg and rad."
    console.say(verdict, style="bold")
    for remark in units:
        console.paragraph(remark)
    _print_inertials(checks)
    for remark in remarks:
        console.paragraph(remark)
    content = {
        "urdf": str(urdf),
        "links": [check.to_dict() for check in checks],
        "moving_links_without_inertial": massless,
        "units": units,
    }
    console.save_json(json_, content)
    if fix is not None:
        inertials.write_nearest(urdf, checks, fix)
        console.written(fix)
    if units or not all(check.consistent for check in checks):
        raise SystemExit(1)


def _print_inertials(checks: Sequence[LinkCheck]) -> None:
    """Print a table of all links, and the nearest possible inertia of each
    impossible one.
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.exporters import inertials
    from sdp_vs_penalty.results.table import Table

    if checks:
        title = "Inertials: mass and margins (negative: violated)"
        heads = ("link", "verdict", "mass [kg]", "triangle [kg m^2]", "pseudo-inertia")
        console.table(Table(heads, inertials.table(checks), title=title, words=(0, 1)))
    for check in checks:
        if check.nearest is None:
            continue
        console.paragraph(
            f"{check.link}: nearest consistent inertia about the centre of mass, axes"
            f" of the link (Frobenius norm, {check.distance:.3g} kg m^2 away; mass and"
            " centre of mass kept):"
        )
        for key, value in check.nearest.urdf_attributes.items():
            console.say(f'  {key}="{value}"')
