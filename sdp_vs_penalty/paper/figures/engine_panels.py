"""What Figures 5 to 7 share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from sdp_vs_penalty.paper.figures.style import LOOKS
from sdp_vs_penalty.paper.tables.engine_runs import EngineResult
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.show import plain_unit
from sdp_vs_penalty.simulation.engines.comparison import EngineRun


def present(results: Sequence[EngineResult]) -> list[EngineRun]:
    """The runs of the engines at hand, the noisiest first so that it is drawn below the others."""
    runs = [r.run for r in results if r.run is not None]
    return sorted(runs, key=lambda run: run.engine != "Bullet")


def engines_title(text: str, results: Sequence[EngineResult]) -> str:
    """The title, with the engines that are not there."""
    absent = [r.engine for r in results if r.run is None]
    return text + (f"\n(absent here: {', '.join(absent)})" if absent else "")


def draw_engines(
    axes: Any,
    study: Study,
    results: Sequence[EngineResult],
    values: Callable[[EngineRun, int], Array],
    what: str,
) -> None:
    """One panel a joint, one line an engine."""
    robot = study.problem.robot
    for j, unit in enumerate(robot.torque_units):
        axis = axes.flat[j]
        for run in present(results):
            axis.plot(run.t, values(run, j), label=run.engine, **LOOKS[run.engine])
        axis.set_ylabel(f"joint {j + 1}\n{what} [{plain_unit(unit)}]")
        axis.margins(x=0)
    for axis in axes.flat[max(robot.n - axes.shape[1], 0) : robot.n]:
        axis.set_xlabel("time [s]")
        axis.tick_params(labelbottom=True)


def legend_in_last(axes: Any) -> None:
    """The legend in the panel that seven joints leave free in four rows of two."""
    handles, labels = axes.flat[0].get_legend_handles_labels()
    last = axes.flat[-1]
    last.axis("off")
    last.legend(handles, labels, loc="center", frameon=False, handlelength=5)
