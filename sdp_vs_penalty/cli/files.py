"""Verbs about files: what a user brings, and what a user takes away. Registered by cli.py."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sdp_vs_penalty.cli.arguments import bounds_for, numbers, pairs, time_window

if TYPE_CHECKING:
    from sdp_vs_penalty.check import Report
    from sdp_vs_penalty.check.urdf import LinkCheck
    from sdp_vs_penalty.data.measurements import Measurements
    from sdp_vs_penalty.problem.problem import Problem

Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]


def register(app: typer.Typer) -> None:
    """Add this file's verbs to the command line."""
    app.command("check")(check_runs)
    app.command("convert")(convert_run)
    app.command("export")(export_model)
    app.command("check-urdf")(check_urdf_file)
    app.command("report")(write_report)


def check_runs(
    data: Annotated[list[Path], typer.Argument(metavar="RUN.csv ...", help="The runs to check.")],
    problem: Annotated[
        str, typer.Option(help="A built-in name, a folder with a problem.toml, or a URDF file.")
    ],
    gravity: Annotated[
        str | None, typer.Option(metavar="x,y,z", help="Gravity in the base frame, m/s^2.")
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="out.json", help="Write the findings to this file.")
    ] = None,
    fix: Annotated[
        Path | None,
        typer.Option(
            metavar="fixed.csv",
            help="Write a mended copy (a folder for several runs); data stay as they are.",
        ),
    ] = None,
    debug: Debug = False,
) -> None:
    """Check measurements before identification: units, signs, order, gravity, clock, noise, excitation.

    Exit code 1 where to identify would be meaningless.
    Example: [cyan]sdp-vs-penalty check run.csv --problem panda --fix mended.csv[/cyan]
    """
    from sdp_vs_penalty.check import check
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.data.files import read_run, save
    from sdp_vs_penalty.errors import InputError
    from sdp_vs_penalty.files import write_text
    from sdp_vs_penalty.problem.load import load_problem

    robot = load_problem(problem, None if gravity is None else numbers("--gravity", gravity, 3))
    if fix is not None and len(data) > 1 and fix.suffix:
        raise InputError(f"--fix {fix}: {len(data)} runs are given: name a folder for their copies.")
    if fix is not None and any(path.resolve() == fix.resolve() for path in data):
        raise InputError(f"--fix {fix}: this is the file that is checked: choose another name.")
    reports = []
    with console.progress("checking") as progress:
        for path in data:
            progress(path.name)
            run = read_run(path, robot.robot.n, [j.name for j in robot.robot.joints])
            reports += check(robot, run)
    if json_file is not None:
        content = {"problem": robot.name, "runs": [r.to_dict() for r in reports]}
        write_text(json_file, json.dumps(content, indent=1) + "\n")
    for path, report in zip(data, reports, strict=True):
        _show(report)
        if fix is not None:
            target = fix if len(data) == 1 else fix / f"{path.stem}.csv"
            save(report.mended, target)
            console.out.print(f"written: {target}", markup=False, soft_wrap=True)
    if any(report.meaningless for report in reports):
        raise typer.Exit(1)


def refuse_meaningless(problem: Problem, measurements: Measurements) -> None:
    """The cheap part of the check, before an identification: warnings go to stderr, a line each.

    Raises InputError where to identify would be meaningless.
    """
    from sdp_vs_penalty.check import check
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.errors import InputError

    reports = check(problem, measurements, thorough=False)
    errors = [(r.run, f) for r in reports for f in r.findings if f.severity == "error"]
    if errors:
        run, f = errors[0]
        more = f"; {len(errors) - 1} more error(s)" if len(errors) > 1 else ""
        fixed = ", its --fix mends it" if f.repair is not None else ""
        raise InputError(
            f"{run}: {f.what.rstrip('.')}: {f.remedy}{more} (`sdp-vs-penalty check` says more{fixed}), "
            "or identify all the same with --no-check."
        )
    for report in reports:
        for f in report.problems:
            text = f"{f.severity}: {report.run}: {f.what} (`sdp-vs-penalty check` says more)"
            console.err.print(text, markup=False, soft_wrap=True)


def _show(report: Report) -> None:
    from rich.markup import escape

    from sdp_vs_penalty.cli.console import out

    colours = {"error": "red", "warning": "yellow", "note": "dim"}
    if report.unexplained is None:
        verdict = "nothing to identify from"
    else:
        verdict = (
            f"the arm's dynamics leave {100.0 * report.unexplained**0.5:.2g} % of the torque unexplained"
        )
    out.print(
        f"[bold]{escape(report.run)}[/bold]: {len(report.problems)} problem(s); {verdict}",
        soft_wrap=True,
    )
    for f in report.findings:
        word = f"[{colours[f.severity]}]{f.severity}[/]"
        out.print(f"  {word} {escape(f.kind)} ({escape(f.where)})")
        fixed = " (--fix does it)" if f.repair is not None else ""
        for text in (f.what, f"How sure: {f.certainty}.", f"What to do: {f.remedy}{fixed}."):
            out.print(f"    {escape(text)}", soft_wrap=True)


def convert_run(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="IN", help=".csv .npz .parquet .mat .mcap .bag, or a ROS 2 bag's folder."
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            metavar="out.csv|.npz|.parquet|.mat", help="File to write; its suffix is the format."
        ),
    ],
    problem: Annotated[
        str | None, typer.Option(help="The robot whose joint names choose the joints of a ROS bag.")
    ] = None,
    joints: Annotated[
        str | None, typer.Option(metavar="a,b,c", help="Joint names of a ROS bag, in the order wanted.")
    ] = None,
    topic: Annotated[
        str | None, typer.Option(help="Of a ROS bag with several JointState topics.")
    ] = None,
    rename: Annotated[
        str | None,
        typer.Option(
            metavar="t=time,q=qm", help="Which column or variable is t, q, dq, tau (or q1, q2 ...)."
        ),
    ] = None,
    debug: Debug = False,
) -> None:
    """Convert measurements of another program: MATLAB, Parquet, ROS 2 bags and MCAP (JointState).

    Example: [cyan]sdp-vs-penalty convert rosbag2_folder --problem robot.urdf --out run.csv[/cyan]
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.data.files import read_run, save
    from sdp_vs_penalty.problem.load import load_problem

    names = joints.split(",") if joints else None
    if problem is not None and names is None:
        names = [joint.name for joint in load_problem(problem).robot.joints]
    run = read_run(source, None, names, topic, pairs("--rename", rename))
    save(run, out)
    velocity = "" if run.dq is None else ", velocities"
    text = f"written: {out} ({len(run.t)} samples of {run.n} joint(s){velocity})"
    console.out.print(text, markup=False, soft_wrap=True)


def export_model(
    model: Annotated[Path, typer.Argument(metavar="model.json", help="Written by identify.")],
    out: Annotated[
        Path,
        typer.Option(
            metavar="out.urdf|.xml|.json|.py",
            help="File to write; the suffix chooses URDF, MJCF (MuJoCo), JSON or a NumPy function.",
        ),
    ],
    urdf: Annotated[
        Path | None,
        typer.Option(
            metavar="robot.urdf",
            help="Your own URDF: only its inertials, damping and friction are replaced.",
        ),
    ] = None,
    debug: Debug = False,
) -> None:
    """Take a model to a simulator or a controller; refuses an inertial that is physically impossible.

    Example: [cyan]sdp-vs-penalty export model.json --out robot.urdf[/cyan]
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.estimation.estimate import load_estimate
    from sdp_vs_penalty.export import export

    left_out = export(load_estimate(model), out, urdf)
    console.out.print(f"written: {out}", markup=False, soft_wrap=True)
    if urdf is None and out.suffix.lower() in (".urdf", ".xml"):
        own = "; --urdf robot.urdf edits your own URDF and keeps its names and meshes"
        console.err.print(
            "moving links are named link1, link2 ...: a model.json knows only the joints' names"
            f"{own if out.suffix.lower() == '.urdf' else ''}.",
            markup=False,
            soft_wrap=True,
        )
    if left_out:
        console.err.print(
            f"{out.suffix} has no place for: {', '.join(left_out)}; export to .json or .py has them.",
            markup=False,
            soft_wrap=True,
        )


def check_urdf_file(
    urdf: Annotated[Path, typer.Argument(metavar="robot.urdf", help="The file to check.")],
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="out.json", help="Write the figures to this file.")
    ] = None,
    fix: Annotated[
        Path | None,
        typer.Option(metavar="fixed.urdf", help="Write a copy with the nearest consistent inertials."),
    ] = None,
    debug: Debug = False,
) -> None:
    """Check the inertials of a URDF: which bodies cannot exist, by how much, and the nearest that can.

    Exit code 1 where one cannot. Example: [cyan]sdp-vs-penalty check-urdf robot.urdf[/cyan]
    """
    from sdp_vs_penalty.check.urdf import check_urdf, massless_links, write_nearest
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.files import write_text

    checks, massless = check_urdf(urdf), massless_links(urdf)
    if json_file is not None:
        content = {
            "urdf": str(urdf),
            "links": [c.to_dict() for c in checks],
            "moving_links_without_inertial": massless,
        }
        write_text(json_file, json.dumps(content, indent=1).replace("NaN", "null") + "\n")
    _urdf_table(checks)
    for c in checks:
        if c.unlikely:
            console.out.print(
                f"{c.link}: can exist, but {c.mass:.3g} kg with this inertia lie {c.gyration:.3g} m "
                "from their centre. Torques of a link that hardly moves do not tell its mass from its "
                "inertia; `identify --method lmi-sdp-entropic` keeps both in proportion.",
                markup=False,
            )
    if massless:
        console.out.print(
            f"No inertial, though a joint moves them: {', '.join(massless)}. Simulators refuse or drop "
            "such links; `identify` needs none to begin with, and `export --urdf` adds them.",
            markup=False,
        )
    if fix is not None:
        write_nearest(urdf, checks, fix)
        console.out.print(f"written: {fix}", markup=False, soft_wrap=True)
    if not all(check.consistent for check in checks):
        raise typer.Exit(1)


def _urdf_table(checks: Sequence[LinkCheck]) -> None:
    """One row a link: margins, verdict, and the nearest consistent inertia where one is needed."""
    from rich.markup import escape

    from sdp_vs_penalty.cli.console import out, titled_table

    table = titled_table("Inertials")
    for heading in ("link", "mass [kg]", "triangle margin [kg m^2]", "pseudo-inertia margin", "verdict"):
        table.add_column(heading, justify="left" if heading in ("link", "verdict") else "right")
    for c in checks:
        numbers = [f"{c.mass:.4g}", f"{c.triangle_margin:.3g}", f"{c.pseudo_inertia_margin:.3g}"]
        table.add_row(escape(c.link), *numbers, c.verdict)
    out.print(table)
    if not checks:
        out.print("The file has no inertial at all.")
    for c in checks:
        if c.nearest is not None:
            out.print(
                f"{c.link}: nearest consistent inertia about the centre of mass, axes of the link "
                f"(Frobenius norm, {c.distance:.3g} kg m^2 away; mass and centre of mass kept):",
                markup=False,
            )
            for key, value in c.nearest.urdf_attributes.items():
                out.print(f'  {key}="{value}"', markup=False, soft_wrap=True)


def write_report(
    models: Annotated[
        list[Path],
        typer.Argument(metavar="model.json ...", help="In the order in which effects were added."),
    ],
    data: Annotated[
        list[Path], typer.Option("--data", metavar="RUN.csv ...", help="Runs to judge the models on.")
    ],
    out: Annotated[Path, typer.Option(metavar="report.html", help="File to write.")],
    problem: Annotated[
        str | None, typer.Option(help="Whose bounds hold; default: the model's own problem.")
    ] = None,
    window: Annotated[
        str | None,
        typer.Option(metavar="START:STOP", help="Part of each run, in seconds from its start."),
    ] = None,
    debug: Debug = False,
) -> None:
    """Write one self-contained HTML file: torques, errors, parameters, certificate, data check.

    Example: [cyan]sdp-vs-penalty report model.json model2.json --data test.csv --out report.html[/cyan]
    """
    import shlex
    import sys

    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.data.files import load_measurements
    from sdp_vs_penalty.errors import InputError
    from sdp_vs_penalty.estimation.estimate import load_estimate
    from sdp_vs_penalty.files import write_text
    from sdp_vs_penalty.report import make_report

    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{out}: the report is an HTML file: let --out end in .html.")
    estimates = {str(path): load_estimate(path) for path in models}
    start, stop = time_window(window)
    robot = next(iter(estimates.values())).robot
    bounds = bounds_for(robot, problem)
    names = [joint.name for joint in robot.joints]
    with console.progress("reading the measurements") as progress:
        measurements = load_measurements(*data, start=start, stop=stop, names=names)
        command = shlex.join(["sdp-vs-penalty", *sys.argv[1:]])
        made = make_report(
            estimates, measurements, problem=bounds, commands=[command], progress=progress
        )
    write_text(out, made)
    console.out.print(f"written: {out}", markup=False, soft_wrap=True)
