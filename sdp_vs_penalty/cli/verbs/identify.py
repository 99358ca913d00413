import time
from pathlib import Path

from sdp_vs_penalty import formatting
from sdp_vs_penalty.cli import console
from sdp_vs_penalty.errors import Infeasible


def verb(
    problem: str,
    data: list[Path],
    out: Path,
    method: str = "lmi-sdp",
    effects: str | None = None,
    gravity: str | None = None,
    filters: str | None = None,
    bounds: str | None = None,
    hold: str | None = None,
    solver: str | None = None,
    seed: int = 0,
    window: str | None = None,
    no_check: bool = False,
    as_written: bool = False,
    proof: Path | None = None,
    gain_uncertainty: float | None = None,
    known_load: list[str] | None = None,
    known: str | None = None,
    instruments: str | None = None,
    ranges: bool = False,
    jobs: int = 1,
    scheduler: str | None = None,
) -> None:
    """Identify a robot's dynamic parameters from measured runs.

    The fast part of `check` runs first; its errors stop the identification (exit code 2).
    Example: sdp-vs-penalty identify panda --data run1.csv --window 0:14 --out model.json

    --out model.json: File to write the model to.
    --solver: Solver of the SDP methods, of `sdp-vs-penalty list solvers`.
    --proof proof.json: File for the proof of optimality; `verify` checks it.
    --ranges: Between which values the masses can lie at all, too, whatever the prior.
    """
    from sdp_vs_penalty.api import identify_and_judge
    from sdp_vs_penalty.cli import printing, runs
    from sdp_vs_penalty.cli.next_step import say_what_follows
    from sdp_vs_penalty.data.files import training_runs
    from sdp_vs_penalty.data.measurements import Measurements
    from sdp_vs_penalty.estimation import PoseOptions
    from sdp_vs_penalty.estimators import with_solver
    from sdp_vs_penalty.parallel import Workers
    from sdp_vs_penalty.problem.check_command import CheckCommand

    named = runs.NamedRuns(training_runs(data), window, as_written)
    estimator = with_solver(method, solver)
    with console.progress("reading the measurements") as progress:
        robot, (runs_given, fitted_runs), hold = runs.read_and_hold(
            lambda held: runs.problem_from_options(
                problem, gravity, bounds, filters, held
            ),
            hold,
            lambda robot: runs.runs_from_options(robot, named),
        )
        check_command = CheckCommand(
            problem=problem, runs=named.files, hold=hold, gravity=gravity
        )
        begin = time.perf_counter()
        try:
            estimate, fit = identify_and_judge(
                robot,
                fitted_runs,
                estimator,
                PoseOptions.from_texts(
                    effects=effects,
                    seed=seed,
                    gain_uncertainty=gain_uncertainty,
                    known_loads=known_load,
                    known=known,
                    instruments=instruments,
                    workers=Workers(jobs, scheduler, progress),
                    progress=progress,
                ),
                proof=proof,
                noise_from=runs_given if isinstance(runs_given, Measurements) else None,
                check=not no_check and runs.gate(check_command),
            )
        except Infeasible as error:
            if proof is not None and error.proof:
                console.written(
                    proof, "it proves that nothing satisfies all constraints"
                )
            raise
        seconds = time.perf_counter() - begin
        given_words = named.words
        estimate.provenance.update(data=given_words, judged_data=given_words)
        estimate.save(out)
    found = None
    if ranges:
        from sdp_vs_penalty.ranges.table import find_ranges

        with console.progress("ranges") as progress:
            found = find_ranges(estimate, progress=progress)
    printing.estimate(estimate, fit, seconds, found)
    if found is not None and found.widest is not None:
        name = found.widest.name
        more = ["ranges", str(out), "--data", *given_words, "--next", name]
        line = formatting.command(*more)
        console.say(f"What would shorten the range of {name}: {line}")
    for path in filter(None, (out, proof)):
        console.written(path)
    if fit is not None:
        say_what_follows(out, estimate, fit.verdict, named)
