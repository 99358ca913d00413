"""The runs that a model is fitted to and tested on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from sdp_vs_penalty import show
from sdp_vs_penalty.cli.arguments import time_window
from sdp_vs_penalty.errors import InputError

if TYPE_CHECKING:
    from sdp_vs_penalty.data.measurements import Measurements
    from sdp_vs_penalty.estimation.estimate import Estimate


def runs_for(
    estimate: Estimate, data: list[Path], window: str | None, test: Path | None, test_window: str | None
) -> tuple[Measurements, Measurements | None]:
    """The runs to fit and the run to test on, both possible for the model's robot."""
    from sdp_vs_penalty.data.files import load_measurements
    from sdp_vs_penalty.data.plausibility import check_plausible

    robot = estimate.robot
    names = robot.joint_names
    start, stop = time_window(window)
    first, last = time_window(test_window, "--test-window")
    if test is None and test_window is not None:
        raise InputError(
            f"--test-window {test_window!r}", "name the run that it is a part of with --test"
        )
    runs = load_measurements(*data, start=start, stop=stop, names=names)
    held_out = None if test is None else load_measurements(test, start=first, stop=last, names=names)
    for given in (runs, held_out):
        if given is not None and given.n != robot.n:
            raise InputError(
                f"the file has {show.count(given.n, 'joint')}, the model {robot.n}",
                "choose the model that belongs to it",
                given.names[0],
            )
        if given is not None:
            check_plausible(robot, given)
    return runs, held_out
