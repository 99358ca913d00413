from pathlib import Path

from sdp_vs_penalty.cli import console


def verb(
    models: list[Path],
    data: list[Path],
    json_: Path | None = None,
    window: str | None = None,
    gravity: str | None = None,
    as_written: bool = False,
    verbose: bool = False,
) -> None:
    """Compare models with runs: each joint's error beside the noise, and where the last model fails.

    Example: sdp-vs-penalty compare model.json --data test.csv --json out.json

    models model.json ...: Models written by `identify` or `add`; a robot's file (my_arm.urdf) is
        judged by the links, damping and friction that it states.
    """
    from sdp_vs_penalty.cli import printing
    from sdp_vs_penalty.cli.next_step import say_what_follows
    from sdp_vs_penalty.cli.runs import NamedRuns, model_from_options, runs_for
    from sdp_vs_penalty.diagnosis.comparison import compare, first_identified
    from sdp_vs_penalty.diagnosis.where_it_fails import where_it_fails
    from sdp_vs_penalty.estimation.nominal import NOMINAL, load_model
    from sdp_vs_penalty.simulation.follow import follow

    estimates = {
        str(path): model_from_options(path, gravity, load=load_model) for path in models
    }
    named = NamedRuns(data, window, as_written)
    newest, estimate = list(estimates.items())[-1]
    runs_given = runs_for(estimate, named)
    runs = runs_given.train
    results = compare(estimates, runs, noise_from=runs_given.judged_recordings)
    settings = first_identified(estimates).preprocessing.resolve(runs)
    failures = where_it_fails(estimate, runs, settings, noise=results[0].noise)
    printing.verdicts(results)
    units = estimate.torque_units
    printing.comparison(results, units)
    printing.where_it_fails(failures, results[-1], is_last=len(results) > 1)
    if verbose:
        printing.all_figures(failures, results[-1])
    # Runs without torque measured the motion only: under the loop of each model's servos.
    servos = {name: e for name, e in estimates.items() if e.model.drives.any()}
    loops = {
        name: follow(servo, runs, drive="servo", steps=5_000)
        for name, servo in servos.items()
        if not runs.torque_logged
    }
    for name, loop in loops.items():
        console.say(f"{name}: {loop.verdict}")
    console.save_json(
        json_,
        {
            "models": [result.to_dict() for result in results],
            "where_it_fails": [failure.to_dict() for failure in failures],
            "where_it_fails_of": newest,
            "loops": {name: loop.to_dict() for name, loop in loops.items()},
        },
    )
    verdict = results[-1].verdict
    if estimate.method == NOMINAL:
        return
    say_what_follows(newest, estimate, verdict, named, gravity)
