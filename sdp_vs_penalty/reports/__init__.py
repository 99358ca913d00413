"""One self-contained HTML file about one or several models: :func:`report` is the verb."""

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from markupsafe import Markup

from sdp_vs_penalty.arguments import checked_arguments
from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.diagnosis.comparison import Comparisons, compare
from sdp_vs_penalty.diagnosis.findings import Diagnosis, load_diagnosis
from sdp_vs_penalty.diagnosis.where_it_fails import Failures, where_it_fails
from sdp_vs_penalty.errors import InputError, missing_extra
from sdp_vs_penalty.estimation.drive_torque import driven
from sdp_vs_penalty.estimation.estimate import Estimate, Models, as_estimates
from sdp_vs_penalty.estimation.verdict import Verdict
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.files import read_text, write_text
from sdp_vs_penalty.memory import give_back_memory
from sdp_vs_penalty.render.pieces import LOOK, packed
from sdp_vs_penalty.reports.sections import SECTIONS, JudgedRun, ReportData
from sdp_vs_penalty.results.issue import IssueInWords
from sdp_vs_penalty.results.templates import render
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.simulation.follow import Drive, Following, follow

#: Templates, style and script of the report.
HERE = Path(__file__).parent / "html"


def plotly_script() -> Path:
    """Return the path of plotly's script for browsers, which the installed package
    holds.

    Raises InputError if plotly is not installed.
    """
    if (plotly := find_spec("plotly")) is None:
        raise missing_extra("The report needs", "report")
    return Path(str(plotly.origin)).parent / "package_data" / "plotly.min.js"


@checked_arguments
def report(
    models: Models,
    measurements: Source,
    out: str | Path,
    *,
    commands: Sequence[str] = (),
    noise_from: Source = None,
    findings: Diagnosis | str | Path | None = None,
    forward: bool = False,
    comparisons: Comparisons | None = None,
    failures: Mapping[str, Failures] | None = None,
    progress: Progress = no_progress,
) -> Verdict:
    """Write a report, one HTML file that needs nothing else.

    Parameters
    ----------
    models : Estimate, path, sequence of these, or mapping of names to these
        In the order in which effects were added; a path is that of a model.json.
    measurements : path, arrays, DataFrame, Measurements, list of these
        The runs to judge the models on.
    out : str or Path
        The .html file to write.
    commands : sequence of str
        Commands that made the report, for its last section.
    noise_from : the same as measurements, optional
        As in :func:`compare`.
    findings : Diagnosis, str or Path, optional
        A diagnosis, or its findings.json, whose findings and curves are shown.
    forward : bool
        Run the model forward over whole runs, however long that takes; otherwise for
        a few seconds of processor time.
    comparisons : Comparisons, optional
        The models on these measurements, by the same names and in the same order, if
        they are compared already.
    failures : mapping of str to Failures, optional
        Where models fail on these measurements, by name, if that is computed already.
    progress : callable
        Called with a short text at each step.

    Returns
    -------
    Verdict
        On the last model.

    Raises
    ------
    InputError
        Where models and measurements do not belong together, or plotly is missing.
    """
    check_name(Path(out))
    script = plotly_script()
    named = as_estimates(models, "report(models=...)")
    first = next(iter(named.values()))
    last = list(named.values())[-1]
    names = first.robot.joint_names
    runs = as_measurements(measurements, names=names, what="report(measurements=...)")
    all_runs = None
    if noise_from is not None:
        all_runs = as_measurements(
            noise_from, names=names, what="report(noise_from=...)"
        )
    diagnosis = (
        load_diagnosis(findings) if isinstance(findings, str | Path) else findings
    )
    filtered = FilteredRuns.filtering(driven(first, runs)[1], first.preprocessing)
    if comparisons is None:
        progress("comparing")
        comparisons = compare(named, filtered, noise_from=all_runs)
    judged = {
        c.name: [JudgedRun.from_run(run, c.estimate) for run in filtered.runs]
        for c in comparisons
    }
    drive: Drive = "torque" if runs.torque_logged else "servo"
    # Of all free runs together: 100 steps take a fifth of a second.
    steps = None if forward else 100
    try:
        forward_result: Following | str = follow(
            last, runs, drive=drive, steps=steps, progress=progress
        )
    except InputError as error:
        forward_result = str(error)
    progress("looking where it fails")
    failures_shown = _failures_shown(
        named, runs, filtered.settings, comparisons, failures or {}
    )
    checks = _checks(named, runs)
    give_back_memory(runs.samples)
    material = ReportData(
        named,
        runs,
        comparisons,
        judged,
        failures_shown,
        checks,
        forward_result,
        commands,
        diagnosis,
    )
    progress("drawing")
    write_text(out, document(material, script.read_text("utf-8")))
    return material.verdict


def _failures_shown(
    models: Mapping[str, Estimate],
    runs: Measurements,
    settings: Preprocessing,
    comparisons: Comparisons,
    known: Mapping[str, Failures],
) -> dict[str, Failures]:
    """Return where the first and the last model fail, by name; ``known`` holds what is
    computed already.
    """
    names = dict.fromkeys((comparisons[0].name, comparisons[-1].name))
    return {
        name: known.get(name)
        or where_it_fails(models[name], runs, settings, noise=comparisons[0].noise)
        for name in names
    }


def document(material: ReportData, script: str) -> str:
    """Fill the report's templates with what the sections show and plotly's script,
    embedded once, and return the HTML document."""
    shown = [
        {
            "title": section.title,
            "anchor": section.anchor,
            "body": Markup(
                render(f"{section.anchor}.html", HERE, **section.context(material))
            ),
        }
        for section in SECTIONS
    ]
    style = f"{read_text(HERE / 'look.css')}\n{LOOK}"
    return render(
        "layout.html",
        HERE,
        title=f"{material.last.robot.name}: identified dynamics",
        style=Markup(style),
        sections=shown,
        plotly=packed(_unwrapped(script)),
        draw=Markup(read_text(HERE / "draw.js")),
    )


def _unwrapped(script: str) -> str:
    """Remove the function that wraps plotly's script.

    A browser parses a wrapped function twice: 2.1 s instead of 1.3 s. A script of
    unknown form is returned as it is.
    """
    head, begins, tail = script.partition("() => {\n")
    body, ends, _ = tail.rpartition("return Plotly;")
    is_known = begins and ends and body.startswith('"use strict";var Plotly=')
    return f"{head[: head.find('*/') + 2]}\n{body}" if is_known else script


def _checks(
    models: Mapping[str, Estimate], runs: Measurements
) -> dict[str, Sequence[IssueInWords]]:
    """Return the data check's issues for each run.

    A model stores the issues of the runs it was identified from, by the hash of their
    data; other runs are checked now.
    """
    issues_by_run = dict[str, Sequence[IssueInWords]]()
    for model in models.values():
        issues_by_run |= model.issues_by_run
    fresh = [run for run in runs.runs() if run.data_hash not in issues_by_run]
    problem = list(models.values())[-1].problem
    reports_needed = []
    if fresh:
        from sdp_vs_penalty.checks import check  # takes longer to import than to draw

        reports_needed = check(problem, concatenate(fresh), thorough=False)
    issues_found = {
        run.names[0]: issues_by_run[run.data_hash]
        for run in runs.runs()
        if run.data_hash in issues_by_run
    }
    return issues_found | {one.run: one.issues for one in reports_needed}


def check_name(out: Path) -> None:
    """Raise InputError if the report's file name does not end in .html or .htm."""
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(
            "the report is an HTML file", "choose a name that ends in .html", out
        )
