import sys
from pathlib import Path

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.errors import command_line


def verb(
    models: list[Path],
    data: list[Path],
    out: Path,
    window: str | None = None,
    gravity: str | None = None,
    findings: Path | None = None,
    forward: bool = False,
    as_written: bool = False,
) -> None:
    """Write one self-contained HTML file: torques, errors, simulation, parameters, certificate, check.

    Example: sdp-vs-penalty report model.json model2.json --data test.csv --out report.html

    models model.json ...: Models, in the order of adding effects.
    --data RUN.csv ...: Measured runs to judge the models on.
    --out report.html: File to write.
    --findings findings.json: Diagnosis whose findings are shown.
    --forward: Forward simulation of whole runs, however long it takes.
    """
    from sdp_vs_penalty.cli import printing
    from sdp_vs_penalty.cli.next_step import free_name
    from sdp_vs_penalty.cli.runs import NamedRuns, model_from_options, runs_for
    from sdp_vs_penalty.reports import check_name, report

    check_name(out)  # before the minutes that a report may take
    are_file_names_unique = len({path.name for path in models}) == len(models)
    estimates = {
        path.name if are_file_names_unique else str(path): model_from_options(
            path, gravity
        )
        for path in models
    }
    with console.progress("reading the measurements") as progress:
        named = NamedRuns(data, window, as_written)
        runs_given = runs_for(next(iter(estimates.values())), named)
        summary = report(
            estimates,
            runs_given.train,
            out,
            noise_from=runs_given.judged_recordings,
            findings=findings,
            forward=forward,
            commands=[command_line(["sdp-vs-penalty", *sys.argv[1:]])],
            progress=progress,
        )
    printing.verdict(summary, list(estimates)[-1])
    console.written(out, "open it in a browser")
    if summary.grade != "do not use":
        console.next_step(["export", models[-1], "--out", free_name("identified.urdf")])
