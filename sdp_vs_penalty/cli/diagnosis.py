"""The verbs around missing effects: diagnose, add, simulate, challenge."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sdp_vs_penalty.errors import InputError

if TYPE_CHECKING:
    from sdp_vs_penalty.data.measurements import Measurements
    from sdp_vs_penalty.estimation.estimate import Estimate

Data = Annotated[
    list[Path],
    typer.Option(
        "--data", metavar="RUN.csv ...", help="Runs: .csv, .npz, or a folder of the authors' log."
    ),
]
Test = Annotated[
    Path | None, typer.Option("--test", metavar="TEST.csv", help="A run for the held-out error only.")
]
Window = Annotated[
    str | None,
    typer.Option(metavar="START:STOP", help="Part of each data run to use, in seconds from its start."),
]
TestWindow = Annotated[
    str | None, typer.Option(metavar="START:STOP", help="Part of the test run to use, likewise.")
]
Frozen = Annotated[
    bool, typer.Option("--frozen", help="Keep the model's parameters: the only way to see a payload.")
]
Seed = Annotated[int, typer.Option(min=0, help="Of everything random.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]


def register(app: typer.Typer) -> None:
    """Put the four verbs on the command line."""
    for verb in (diagnose, add, simulate, challenge):
        app.command()(verb)


def diagnose(
    model: Annotated[Path, typer.Argument(metavar="model.json", help="Written by identify.")],
    data: Data,
    test: Test = None,
    frozen: Frozen = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="findings.json", help="Write the findings there.")
    ] = None,
    window: Window = None,
    test_window: TestWindow = None,
    seed: Seed = 0,
    debug: Debug = False,
) -> None:
    """Name the physical effects that a model misses.

    Example: [cyan]sdp-vs-penalty diagnose model.json --data run1.csv run2.csv --test test.csv[/cyan]
    """
    from sdp_vs_penalty.cli import console, printing
    from sdp_vs_penalty.diagnosis import diagnose as run
    from sdp_vs_penalty.estimation.estimate import load_estimate
    from sdp_vs_penalty.files import write_text

    estimate = load_estimate(model)
    with console.progress("reading the measurements") as progress:
        measurements, held_out = _runs(estimate, data, window, test, test_window)
        result = run(estimate, measurements, held_out, frozen=frozen, seed=seed, progress=progress)
    options = ["--data", *map(str, data)]
    options += [] if window is None else ["--window", window]
    options += [] if test is None else ["--test", str(test)]
    options += [] if test_window is None else ["--test-window", test_window]
    options += ["--frozen"] if frozen else []

    def add_command(effects: str) -> str:
        words = ["sdp-vs-penalty", "add", str(model), effects, *options]
        return shlex.join([*words, "--out", str(_next_to(model))])

    printing.diagnosis(result, estimate.robot.torque_units, add_command)
    if json_file is not None:
        write_text(json_file, json.dumps(result.to_dict(), indent=1) + "\n")
        console.out.print(f"written: {json_file}", markup=False, soft_wrap=True)


def _runs(
    estimate: Estimate, data: list[Path], window: str | None, test: Path | None, test_window: str | None
) -> tuple[Measurements, Measurements | None]:
    """The runs to fit and the run to test on, both possible for the model's robot."""
    from sdp_vs_penalty.cli.arguments import time_window
    from sdp_vs_penalty.data.files import load_measurements
    from sdp_vs_penalty.data.plausibility import check_plausible

    robot = estimate.robot
    names = [joint.name for joint in robot.joints]
    start, stop = time_window(window)
    first, last = time_window(test_window, "--test-window")
    if test is None and test_window is not None:
        raise InputError(f"--test-window {test_window!r}: say with --test which run it is a part of.")
    runs = load_measurements(*data, start=start, stop=stop, names=names)
    held_out = None if test is None else load_measurements(test, start=first, stop=last, names=names)
    for given in (runs, held_out):
        if given is not None and given.n != robot.n:
            raise InputError(
                f"{given.names[0]}: the file has {given.n} joint(s), the model {robot.n}: choose the "
                "model that belongs to it."
            )
        if given is not None:
            check_plausible(robot, given)
    return runs, held_out


def _next_to(model: Path) -> Path:
    """The file beside the model with the next number that is free: model.json, model2.json, ..."""
    stem = model.stem.rstrip("0123456789") or model.stem
    taken = {int(n) for p in model.parent.glob(f"{stem}*.json") if (n := p.stem[len(stem) :]).isdigit()}
    return model.with_name(f"{stem}{max(taken, default=1) + 1}.json")


def add(
    model: Annotated[Path, typer.Argument(metavar="model.json", help="Written by identify or add.")],
    effect: Annotated[
        str,
        typer.Argument(metavar="EFFECT[:joints][@shape=value]", help="Several: separated by commas."),
    ],
    data: Data,
    out: Annotated[Path, typer.Option(metavar="model2.json", help="File to write the model to.")],
    test: Test = None,
    frozen: Frozen = False,
    problem: Annotated[
        str | None, typer.Option(help="Whose bounds hold; default: the model's own problem.")
    ] = None,
    window: Window = None,
    test_window: TestWindow = None,
    seed: Seed = 0,
    debug: Debug = False,
) -> None:
    """Add an effect to a model and identify it again, under all constraints.

    Example: [cyan]sdp-vs-penalty add model.json joint_spring:4 --data run.csv --out model2.json[/cyan]
    """
    from sdp_vs_penalty.cli import console, printing
    from sdp_vs_penalty.cli.arguments import bounds_for
    from sdp_vs_penalty.diagnosis import add as run
    from sdp_vs_penalty.diagnosis.comparison import compare
    from sdp_vs_penalty.estimation.estimate import load_estimate

    estimate = load_estimate(model)
    bounds = bounds_for(estimate.robot, problem)
    with console.progress("reading the measurements") as progress:
        measurements, held_out = _runs(estimate, data, window, test, test_window)
        bigger = run(
            estimate,
            effect,
            measurements,
            problem=bounds,
            frozen=frozen,
            seed=seed,
            progress=progress,
        )
        judge = measurements if held_out is None else held_out
        before, after = compare({"before": estimate, "after": bigger}, judge)
        bigger.save(out)
    for e in bigger.model.effects[len(estimate.model.effects) :]:
        console.out.print(f"added: {e.text}", markup=False)
    what = "the training data" if test is None else str(test)
    printing.before_after(before.rmse, after.rmse, after.noise_floor, estimate.robot.torque_units, what)
    console.out.print(f"written: {out}", markup=False, soft_wrap=True)


def simulate(
    problem: Annotated[str, typer.Argument(help="A built-in name, a folder, or a URDF file.")],
    hide: Annotated[
        list[str],
        typer.Option("--hide", metavar="EFFECT[:joints]", help="The effect to hide; repeatable."),
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for run1..3.csv, test.csv, truth.json.")
    ],
    level: Annotated[
        str, typer.Option(help="strong, medium, weak, or the RMS over the raw noise.")
    ] = "strong",
    seed: Seed = 0,
    debug: Debug = False,
) -> None:
    """Simulate runs in which an effect is hidden; truth.json says which.

    Example: [cyan]sdp-vs-penalty simulate panda --hide stribeck_friction:3 --seed 7 --out DIR[/cyan]
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.data.files import save
    from sdp_vs_penalty.effects import parse_effects
    from sdp_vs_penalty.files import write_text
    from sdp_vs_penalty.problem.load import load_problem
    from sdp_vs_penalty.simulation.hidden_effects import LEVELS
    from sdp_vs_penalty.simulation.hidden_runs import hidden_runs

    robot = load_problem(problem)
    size: str | float = level
    if level not in LEVELS:
        try:
            size = float(level)
        except ValueError:
            size = -1.0
        if not 0.0 < float(size) < 1e6:
            raise InputError(f"--level {level!r}: strong, medium, weak or a positive number is needed.")
    names = ("run1.csv", "run2.csv", "run3.csv", "test.csv")
    if not (out / "truth.json").exists():  # else the folder is one that this verb wrote
        for name in names:
            if (out / name).exists():
                raise InputError(f"--out {out}: {name} is there already: name another folder.")
    effects = []
    for effect in parse_effects(hide, robot.robot):
        effects.append((effect.name, list(effect.asked_joints or ())))
    made = hidden_runs(robot, effects, size, seed, must_show=True)
    for name, run in zip(names, made.runs, strict=True):
        save(run, out / name)
    write_text(out / "truth.json", json.dumps(made.truth, indent=1) + "\n")
    console.out.print(f"written: {out}/run1.csv run2.csv run3.csv test.csv truth.json", markup=False)
    words = ["sdp-vs-penalty", "identify", problem, "--data", *(str(out / name) for name in names[:3])]
    words += ["--effects", ",".join(made.truth["model_effects"]), "--out", "model.json"]
    console.out.print(f"next: {shlex.join(words)}", markup=False, soft_wrap=True)


def challenge(
    cases: Annotated[int, typer.Option(min=1, help="Cases of each class.")] = 20,
    seed: Seed = 0,
    problem: Annotated[str, typer.Option(help="The robot to simulate.")] = "panda",
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for challenge.*.")] = Path("results"),
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    only: Annotated[str | None, typer.Option(metavar="a,b", help="Only these classes.")] = None,
    debug: Debug = False,
) -> None:
    """Score diagnose on simulated measurements with hidden effects.

    Example: [cyan]sdp-vs-penalty challenge --cases 20 --seed 0[/cyan]
    """
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.simulation.challenge.challenge import run_challenge

    classes = None if only is None else only.split(",")
    with console.progress("challenge") as progress:
        written = run_challenge(problem, cases, seed, out, jobs, classes, progress)
    for path in written:
        print(path)
