"""The command line. Heavy imports happen inside the verbs, so that --help answers at once."""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sdp_vs_penalty.cli import diagnosis as cli_diagnosis
from sdp_vs_penalty.cli import files as cli_files
from sdp_vs_penalty.cli import page as cli_page
from sdp_vs_penalty.cli import paper as cli_paper
from sdp_vs_penalty.cli import shootout as cli_shootout
from sdp_vs_penalty.cli.arguments import expand_many, numbers, time_window
from sdp_vs_penalty.cli.errors import explain
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import protect
from sdp_vs_penalty.version import __version__

if TYPE_CHECKING:
    from sdp_vs_penalty.estimators.estimator import Estimator

app = typer.Typer(
    name="sdp-vs-penalty",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)

Data = Annotated[
    list[Path],
    typer.Option(
        "--data", metavar="RUN.csv ...", help="Runs: .csv, .npz, or a folder of the authors' log."
    ),
]
Window = Annotated[
    str | None,
    typer.Option(metavar="START:STOP", help="Part of each run to use, in seconds from its start."),
]
_TABLES_HELP = "Default: these four; also VII (--problem two_link), errata, methods, data."
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]


def _show_version(asked: bool) -> None:
    if asked:
        print(f"sdp-vs-penalty {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
    debug: Debug = False,
) -> None:
    """Identify a robot's dynamics: the LMI-SDP and penalty-based retrieval, each with a certificate."""
    if context.invoked_subcommand is None:
        print(context.get_help())


class Budget(StrEnum):
    """How long the penalty runs of the tables may take."""

    quick = "quick"
    paper = "paper"


@app.command()
def tables(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[III IV VIII IX ...]", help=_TABLES_HELP)
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="I to IX and what goes with them.")] = False,
    problem: Annotated[str | None, typer.Option(help="two_link or panda.")] = None,
    budget: Annotated[Budget, typer.Option(help="quick, or as many runs as the paper.")] = Budget.quick,
    out: Annotated[Path, typer.Option(help="Folder to write into.")] = Path("results"),
    debug: Debug = False,
) -> None:
    """Regenerate the paper's comparison tables.

    Example: [cyan]sdp-vs-penalty tables III --out results[/cyan]
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.paper.tables import all_tables, make_tables

    if every:
        if names or problem:
            raise InputError(
                "--all makes every table with its own problem: leave names and --problem out."
            )
        names = list(all_tables())
    with console.progress("tables") as progress:
        written = make_tables(
            names or None, problem=problem, budget=budget.value, out=out, progress=progress
        )
    for path in written:
        print(path)


@app.command()
def identify(
    problem: Annotated[
        str, typer.Argument(help="A built-in name, a folder with a problem.toml, or a URDF file.")
    ],
    data: Data,
    out: Annotated[Path, typer.Option(metavar="model.json", help="File to write the model to.")],
    method: Annotated[str, typer.Option(help="See `sdp-vs-penalty list methods`.")] = "lmi-sdp",
    effects: Annotated[
        str | None,
        typer.Option(metavar="a,b,c", help="See `sdp-vs-penalty list effects`; default: the problem's."),
    ] = None,
    gravity: Annotated[
        str | None, typer.Option(metavar="x,y,z", help="Gravity in the base frame, m/s^2.")
    ] = None,
    solver: Annotated[
        str | None, typer.Option(help="Of the SDP methods: see `sdp-vs-penalty list solvers`.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of everything random.")] = 0,
    window: Window = None,
    no_check: Annotated[
        bool,
        typer.Option("--no-check", help="Identify even where the check says it is meaningless."),
    ] = False,
    debug: Debug = False,
) -> None:
    """Identify a robot's dynamic parameters from measured runs.

    The cheap part of `check` runs first: its errors stop the identification (exit code 2).
    Example: [cyan]sdp-vs-penalty identify panda --data run1.csv --window 0:14 --out model.json[/cyan]
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.data.files import load_measurements
    from sdp_vs_penalty.data.measurements import Measurements
    from sdp_vs_penalty.diagnosis.comparison import compare as compare_models
    from sdp_vs_penalty.estimation.identify import identify as run_identification
    from sdp_vs_penalty.problem.load import load_problem
    from sdp_vs_penalty.regression.black_box import load_answers

    estimator = _estimator(method, solver)
    robot = load_problem(problem, numbers("--gravity", gravity, 3) if gravity is not None else None)
    start, stop = time_window(window)
    with console.progress("reading the measurements") as progress:
        answers = load_answers(data, joints=robot.robot.n)
        names = [joint.name for joint in robot.robot.joints]
        given = answers or load_measurements(
            *data, joints=robot.robot.n, start=start, stop=stop, names=names
        )
        if isinstance(given, Measurements) and not no_check:
            progress("checking the measurements")
            cli_files.refuse_meaningless(robot, given)
        begin = time.perf_counter()
        estimate = run_identification(
            robot, given, estimator, effects=effects, seed=seed, progress=progress
        )
        seconds = time.perf_counter() - begin
        estimate.save(out)
        # A black box's answers are no torque along a motion: the certificate's loss is all there is.
        fit = None
        if isinstance(given, Measurements):
            fit = compare_models({estimate.method: estimate}, given)[0]
    console.estimate_summary(estimate, fit, seconds)
    console.out.print(f"written: {out}", markup=False, soft_wrap=True)


@app.command()
def compare(
    models: Annotated[list[Path], typer.Argument(metavar="model.json ...", help="Written by identify.")],
    data: Data,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="out.json", help="Write the figures to this file.")
    ] = None,
    window: Window = None,
    debug: Debug = False,
) -> None:
    """Compare models with runs: each joint's error beside the noise, where the last model fails.

    Example: [cyan]sdp-vs-penalty compare model.json --data test.csv --json out.json[/cyan]
    """
    from sdp_vs_penalty.cli import console, printing
    from sdp_vs_penalty.data.files import load_measurements
    from sdp_vs_penalty.diagnosis.comparison import compare as compare_models
    from sdp_vs_penalty.diagnosis.where_it_fails import where_it_fails
    from sdp_vs_penalty.estimation.estimate import load_estimate
    from sdp_vs_penalty.files import write_text

    estimates = {str(path): load_estimate(path) for path in models}
    start, stop = time_window(window)
    newest, estimate = list(estimates.items())[-1]
    names = [joint.name for joint in estimate.robot.joints]
    measurements = load_measurements(*data, start=start, stop=stop, names=names)
    results = compare_models(estimates, measurements)
    failures = where_it_fails(estimate, measurements)
    if json_file is not None:
        content = {
            "models": [result.to_dict() for result in results],
            "where_it_fails": [failure.to_dict() for failure in failures],
            "where_it_fails_of": newest,
        }
        write_text(json_file, json.dumps(content, indent=1) + "\n")
    console.comparison_tables(results, estimate.robot.torque_units)
    printing.where_it_fails(failures, estimate.robot.torque_units, newest)
    if json_file is not None:
        console.out.print(f"written: {json_file}", markup=False, soft_wrap=True)


class Kind(StrEnum):
    """What can be listed."""

    problems = "problems"
    effects = "effects"
    methods = "methods"
    solvers = "solvers"
    datasets = "datasets"
    engines = "engines"


@app.command("list")
def list_names(
    what: Annotated[Kind, typer.Argument(help="Which names to list.")],
    name: Annotated[str | None, typer.Argument(help="Everything about this one.")] = None,
    debug: Debug = False,
) -> None:
    """List the names that the other verbs take, or say all about one of them.

    Example: [cyan]sdp-vs-penalty list effects presliding_hysteresis[/cyan]
    """
    from sdp_vs_penalty.cli import console, registry

    if name is not None:
        console.details(*registry.details(what.value, name))
        return
    headings, rows = registry.short_listing(what.value)
    console.listing(what.value, headings, rows)
    if len(headings) < len(registry.listing(what.value)[0]):
        console.out.print(
            f"More about one of them: sdp-vs-penalty list {what.value} NAME", soft_wrap=True
        )


@app.command()
def fetch(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[panda|ur10e|emps] ...", help="Default: all.")
    ] = None,
    folder: Annotated[
        Path | None, typer.Option(help="Where to keep the files; default: the user's cache.")
    ] = None,
    debug: Debug = False,
) -> None:
    """Download public measurements and write them as RUN.csv files; prints their paths.

    Example: [cyan]sdp-vs-penalty fetch emps[/cyan]
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.data.datasets import DATASETS, cache_folder, dataset
    from sdp_vs_penalty.data.datasets import fetch as fetch_dataset

    for name in [dataset(name).name for name in names or DATASETS]:
        with console.progress(f"fetching {name}"):
            remarks: list[str] = []
            paths = fetch_dataset(name, folder, say=remarks.append)
        for remark in remarks:
            print(f"sdp-vs-penalty: {remark}", file=sys.stderr)
        for path in paths:
            print(path)
    kept = folder or cache_folder()
    print(f"sdp-vs-penalty: tables find them with SDP_VS_PENALTY_DATA={kept}", file=sys.stderr)


cli_files.register(app)
cli_paper.register(app)
cli_shootout.register(app)
cli_diagnosis.register(app)
cli_page.register(app)


def _estimator(method: str, solver_name: str | None) -> Estimator:
    """The estimator of a name, with its solver exchanged where one is asked for."""
    from dataclasses import replace

    from sdp_vs_penalty.estimators import make_estimator
    from sdp_vs_penalty.solvers import solver

    estimator: Any = make_estimator(method)
    if solver_name is None:
        return estimator
    if not hasattr(estimator, "solver"):
        raise InputError(f"--solver {solver_name}: method {method} solves no SDP; leave --solver out.")
    solver(solver_name)
    return replace(estimator, solver=solver_name)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line: exit code 0, 2 for what the user can mend, 130 after Ctrl-C."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    # Matrices here have a hundred columns: threads of the linear algebra cost more than they bring,
    # and where cores are busy they wait for each other (a check of 0.5 s took 20 s).
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        protect(_inputs(given))
        code = app(expand_many(given), prog_name="sdp-vs-penalty", standalone_mode=False)
        if code == 130:  # what typer makes of Ctrl-C
            raise KeyboardInterrupt
    except BrokenPipeError:
        # Whoever read our output has closed it; the interpreter would complain at exit otherwise.
        sys.stdout = None  # type: ignore[assignment]
        code = 1
    except (Exception, KeyboardInterrupt) as error:
        if "--debug" in given:
            traceback.print_exc()
        message, code = explain(error)
        print(f"sdp-vs-penalty: {message}", file=sys.stderr)
    finally:
        protect([])
    sys.exit(code if isinstance(code, int) else 0)


def _inputs(given: Sequence[str]) -> list[str]:
    """The files among the arguments that are not named as outputs."""
    outputs = {"--out", "--json", "--fix"}
    return [
        word
        for before, word in zip(["", *given], given, strict=False)
        if before not in outputs and not word.startswith("-")
    ]
