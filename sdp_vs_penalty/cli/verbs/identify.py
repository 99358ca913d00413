"""The verb identify: a model from measured runs."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from sdp_vs_penalty.cli import options
from sdp_vs_penalty.cli.runs import next_diagnosis, refuse_meaningless, words
from sdp_vs_penalty.data.texts import numbers, time_windows
from sdp_vs_penalty.errors import Infeasible


def verb(
    problem: options.Problem,
    data: options.Data,
    out: Annotated[Path, typer.Option(metavar="model.json", help="File to write the model to.")],
    method: options.Method = "lmi-sdp",
    effects: options.Effects = None,
    gravity: options.Gravity = None,
    filters: Annotated[
        str | None,
        typer.Option(metavar="5,8", help="Filters of states and torque [Hz]; default: chosen."),
    ] = None,
    bounds: Annotated[
        str | None,
        typer.Option(
            metavar="m2=1:5,c2x=-0.1:0.1",
            help="Bounds of links [kg, m, kg m^2], in place of the problem's; total=:20: of all.",
        ),
    ] = None,
    solver: Annotated[
        str | None,
        typer.Option(help="Solver of the SDP methods, of `sdp-vs-penalty list solvers`."),
    ] = None,
    seed: options.Seed = 0,
    window: options.Window = None,
    no_check: options.NoCheck = False,
    proof: Annotated[
        Path | None,
        typer.Option(metavar="proof.json", help="File for the proof of optimality; `verify` checks it."),
    ] = None,
    gain_uncertainty: options.GainUncertainty = None,
    known_load: Annotated[
        list[str] | None,
        typer.Option(
            "--known-load",
            metavar="LOAD.csv:KG",
            help="Run with a load of this mass on the last link; determines the torque channels' gains.",
        ),
    ] = None,
    jobs: options.Jobs = 1,
    scheduler: options.Scheduler = None,
) -> None:
    """Identify a robot's dynamic parameters from measured runs.

    The fast part of `check` runs first; its errors stop the identification (exit code 2).
    Example: sdp-vs-penalty identify panda --data run1.csv --window 0:14 --out model.json
    """
    from sdp_vs_penalty.cli import console, printing
    from sdp_vs_penalty.data.files import load_measurements, windowed
    from sdp_vs_penalty.data.measurements import Measurements
    from sdp_vs_penalty.diagnosis.comparison import compare as compare_models
    from sdp_vs_penalty.estimation.identify import identify as run_identification
    from sdp_vs_penalty.estimation.known_load import parsed_known_load
    from sdp_vs_penalty.estimators import with_solver
    from sdp_vs_penalty.parallel import Workers
    from sdp_vs_penalty.problem.load import load_problem, with_bounds, with_filters
    from sdp_vs_penalty.regression.black_box import load_answers

    estimator = with_solver(method, solver)
    mounted = load_problem(problem, numbers("--gravity", gravity, 3) if gravity is not None else None)
    robot = with_filters(with_bounds(mounted, bounds), filters)
    windows = time_windows(window)
    with console.progress("reading the measurements") as progress:
        answers = load_answers(data, joints=robot.robot.n)
        names = robot.robot.joint_names
        whole = answers or load_measurements(*data, joints=robot.robot.n, names=names)
        given = windowed(whole, windows) if isinstance(whole, Measurements) else whole
        if isinstance(given, Measurements) and not no_check:
            progress("checking the measurements")
            refuse_meaningless(robot, given, gains=bool(known_load))
        begin = time.perf_counter()
        try:
            estimate = run_identification(
                robot,
                given,
                estimator,
                effects=effects,
                seed=seed,
                progress=progress,
                proof=proof,
                gain_uncertainty=gain_uncertainty or 0.0,
                known_loads=[parsed_known_load(text) for text in known_load or []],
                workers=Workers(jobs, scheduler, progress),
            )
        except Infeasible as error:
            if proof is not None and error.proof:
                console.written(proof, "it proves that nothing satisfies all constraints")
            raise
        seconds = time.perf_counter() - begin
        estimate.provenance.update({"data": words(data, window), "checked": not no_check})
        # A black box's answers are no torque along a motion: the certificate's loss is all there is.
        fit = None
        if isinstance(given, Measurements):
            fit = compare_models({estimate.method: estimate}, given, noise_from=whole)[0]
            estimate.provenance["verdict"] = fit.verdict.to_dict()
        estimate.save(out)
    printing.estimate(estimate, fit, seconds)
    console.written(out)
    if fit is not None:
        next_diagnosis(out, estimate, data, window)
    if proof is not None:
        console.written(proof)
