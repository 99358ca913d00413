from pathlib import Path

from sdp_vs_penalty.cli import console


def verb(urdf: Path, json_: Path | None = None, fix: Path | None = None) -> None:
    """Check the inertials of a robot's file: which are impossible, which typing mistake explains each.

    Reads URDF, xacro, SDF and MJCF. A mistake is a decimal point, an exponent, a sign, exchanged
    numbers, a unit; without one, the nearest possible inertia is shown.
    Exit code 1 where one is impossible or contradicts itself, in another unit than m and kg, or all
    have one mistake.
    Example: sdp-vs-penalty check-urdf robot.urdf

    urdf robot.urdf: File to check.
    --fix fixed.urdf: Copy to write, with the mistakes corrected, else the nearest inertials.
    """
    from sdp_vs_penalty.exporters import inertials
    from sdp_vs_penalty.results.table import Table

    with inertials.checkable(urdf) as file:
        checks = inertials.check_urdf(file)
        massless = inertials.massless_links(file)
        units = inertials.unit_remarks(file, checks) + inertials.format_remarks(urdf)
        verdict, *remarks = inertials.sentences(checks, massless, units)
        couplings = inertials.coupling_remarks(file, has_lines=file == urdf)
        if any(x.startswith("Units") for x in units):
            verdict = f"{verdict[:-1]}; units are not m, kg and rad."
        console.say(verdict, style="bold")
        for remark in units:
            console.paragraph(remark)
        if checks:
            title = "Inertials: mass and margins (negative: violated)"
            margins = ("triangle [kg m^2]", "pseudo-inertia")
            heads = ("link", "verdict", "mass [kg]", *margins)
            rows = inertials.table(checks)
            console.table(Table(heads, rows, title=title, words=(0, 1)))
        for remark in (*remarks, *couplings):
            console.paragraph(remark)
        content = {
            "urdf": str(urdf),
            "links": [check.to_dict() for check in checks],
            "moving_links_without_inertial": massless,
            "units": units,
            "couplings": couplings,
        }
        console.save_json(json_, content)
        if fix is not None:
            inertials.write_repaired(file, checks, fix)
            console.written(fix)
    if units or any(check.of_all or not check.consistent for check in checks):
        raise SystemExit(1)
