"""The verb add: an effect joins the model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sdp_vs_penalty.cli.arguments import bounds_for
from sdp_vs_penalty.cli.options import Data, Debug, Frozen, Model, Seed, Test, TestWindow, Window
from sdp_vs_penalty.cli.runs import runs_for


def verb(
    model: Model,
    effect: Annotated[
        str,
        typer.Argument(metavar="EFFECT[:joints][@shape=value]", help="Effects, separated by commas."),
    ],
    data: Data,
    out: Annotated[Path, typer.Option(metavar="model2.json", help="File to write the model to.")],
    test: Test = None,
    frozen: Frozen = False,
    problem: Annotated[
        str | None,
        typer.Option(help="Problem that supplies the bounds; default: the model's own."),
    ] = None,
    window: Window = None,
    test_window: TestWindow = None,
    seed: Seed = 0,
    debug: Debug = False,
) -> None:
    """Add an effect to a model and identify it again, under all constraints.

    Example: sdp-vs-penalty add model.json joint_spring:4 --data run.csv --out model2.json
    """
    from sdp_vs_penalty.cli import console, printing
    from sdp_vs_penalty.diagnosis import add as run
    from sdp_vs_penalty.diagnosis.comparison import compare
    from sdp_vs_penalty.estimation.estimate import load_estimate

    estimate = load_estimate(model)
    bounds = bounds_for(estimate.robot, problem)
    with console.progress("reading the measurements") as progress:
        measurements, held_out = runs_for(estimate, data, window, test, test_window)
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
    what = "the training data" if test is None else str(test)
    printing.before_after(before, after, estimate.robot.torque_units, what)
    for e in bigger.model.effects[len(estimate.model.effects) :]:
        console.say(f"added: {e.text}")
    console.written(out)
