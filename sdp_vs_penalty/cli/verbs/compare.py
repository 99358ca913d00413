"""The verb compare: models against runs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sdp_vs_penalty.cli.arguments import time_window
from sdp_vs_penalty.cli.options import Data, Debug, Window

if TYPE_CHECKING:
    pass


def verb(
    models: Annotated[list[Path], typer.Argument(metavar="model.json ...", help="Written by identify.")],
    data: Data,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="out.json", help="Write the figures to this file.")
    ] = None,
    window: Window = None,
    debug: Debug = False,
) -> None:
    """Compare models with runs: each joint's error beside the noise, where the last model fails.

    Example: sdp-vs-penalty compare model.json --data test.csv --json out.json
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
