from pathlib import Path

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.errors import InputError


def verb(
    source: str,
    out: Path | None = None,
    hide: list[str] | None = None,
    level: str = "strong",
    follow: list[Path] | None = None,
    drive: str = "torque",
    json_: Path | None = None,
    seed: int = 0,
    hold: str | None = None,
    link_error: float = 0.0,
) -> None:
    """Simulate runs in which an effect is hidden, or run a model forward along measured runs.

    With --follow a model is started from measured states and driven by the measured torque: one step,
    0.1 s, and as long as it stays with the measured motion. Otherwise truth.json says what is hidden.
    Example: sdp-vs-penalty simulate panda --hide stribeck_friction:3 --seed 7 --out DIR

    source PROBLEM|model.json: Built-in name, folder with a problem.toml, or URDF file. With --follow: a
        model.
    --out DIR|OUT.csv: Folder for run1..3.csv, test.csv, truth.json; runs of another simulation are never
        replaced. With --follow the file of a free run.
    --hide EFFECT[:joints][@shape=value]: Effect to hide; repeatable. Default: none. Constants that are
        not given are drawn; a plug-in's are its defaults.
    --level: Size: strong, medium, weak, or the hidden torque's RMS over the raw noise.
    --follow RUN.csv ...: Runs along which the model is run forward.
    --drive: Drive: torque (as measured), pd (and a loop on the motion), or servo (the command).
    --link-error: How far true links differ from the file's: 0.2 for about a fifth. Default: not.
    --json out.json: JSON file for what is hidden, as truth.json; with --follow for the errors.
    """
    if follow:
        _follow(source, follow, drive, seed, out, json_)
        return
    from sdp_vs_penalty.cli.next_step import free_name
    from sdp_vs_penalty.cli.runs import problem_from_options
    from sdp_vs_penalty.simulation.hidden_runs import RUN_FILES, planned, refuse_foreign

    if out is None:
        raise InputError(
            "simulate: no folder to write to", "pass --out DIR, or --follow RUN.csv"
        )
    robot = problem_from_options(source, hold=hold) if hold else source
    truth, simulated = planned(robot, hide or (), level, seed, link_error)
    # Before the minutes that the runs may take.
    refuse_foreign(out, truth)
    hidden = simulated()
    hidden.save(out)
    effects = ",".join(hidden.truth["model_effects"])
    runs = [out / name for name in RUN_FILES[:-1]]
    console.written(f"{out}/{' '.join(RUN_FILES)} truth.json")
    console.save_json(json_, hidden.truth)
    held = ["--hold", hold] if hold else []
    words = ["identify", source, "--data", *runs, "--effects", effects, *held]
    console.next_step([*words, "--out", free_name("model.json")])


def _follow(
    model: str,
    runs: list[Path],
    drive: str,
    seed: int,
    out: Path | None,
    json_file: Path | None,
) -> None:
    """Simulate a model along measured runs, and print the errors of its motion.

    - ``drive``: "torque", "pd" or "servo".
    - ``out``: file for the motion of the first free run.
    """
    from sdp_vs_penalty.cli.next_step import say_what_follows
    from sdp_vs_penalty.cli.runs import NamedRuns
    from sdp_vs_penalty.data.formats.csv import write as write_csv
    from sdp_vs_penalty.estimation.estimate import load_estimate
    from sdp_vs_penalty.simulation.follow import follow

    with console.progress("reading the measurements") as progress:
        estimate = load_estimate(model)
        following = follow(
            estimate,
            runs,
            drive=drive,  # type: ignore[arg-type]
            seed=seed,
            progress=progress,
        )
    console.say(following.verdict, style="bold")
    console.say("Forward simulation against the measured motion (RMS)", style="italic")
    console.table(following.table())
    console.paragraph(following.explained)
    if following.free[0].spread is None:
        why = "the intervals hold inertias with which the arm cannot move"
        console.warn(f"No band for the free run: {why}.")
    if following.left_out:
        console.warn(
            f"left out, no meaning in a forward simulation: {', '.join(following.left_out)}"
        )
    console.save_json(json_file, following.to_dict())
    if out is not None:
        write_csv(following.free[0].simulated, out)
        console.written(out)
    say_what_follows(model, estimate, estimate.verdict, NamedRuns(runs))
