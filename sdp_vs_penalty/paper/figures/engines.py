"""Figures 5 to 7: physics engines against the identified model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.paper.figures.style import LOOKS, legend_below, new_figure, title
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table_v import EngineResult, measured_runs, sinusoidal_runs
from sdp_vs_penalty.robot.arrays import Array
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


def finished(figure: Any, axes: Any, text: str, results: Sequence[EngineResult]) -> Any:
    """With a title, and the legend in the panel that seven joints leave free in four rows of two."""
    handles, labels = axes.flat[0].get_legend_handles_labels()
    last = axes.flat[-1]
    last.axis("off")
    last.legend(handles, labels, loc="center", frameon=False, handlelength=5)
    title(figure, engines_title(text, results))
    return figure


def engine_torques(study: Study) -> Any:
    """Figure 5: torques of physics engines along sinusoidal velocities, and of the identified model."""
    n, results = study.problem.robot.n, sinusoidal_runs(study)
    figure, axes = new_figure((n + 1) // 2, 2, 7.0, sharex=True)
    for run in present(results)[:1]:
        for j in range(n):
            axes.flat[j].plot(run.t, run.model[:, j], label="identified model", **LOOKS["model"])
    draw_engines(axes, study, results, lambda run, j: run.followed.torque[:, j], "torque")
    return finished(figure, axes, "Torques of physics engines on sinusoidal velocities", results)


def engine_torque_errors(study: Study) -> Any:
    """Figure 6: torque errors of physics engines against the identified model."""
    n, results = study.problem.robot.n, sinusoidal_runs(study)
    figure, axes = new_figure((n + 1) // 2, 2, 7.0, sharex=True)
    draw_engines(axes, study, results, lambda run, j: run.error[:, j], "torque error")
    for j in range(n):
        runs = present(results)
        # Left out of the torque errors at the start [s], where the acceleration jumps from rest.
        largest = max((float(np.abs(run.error[run.t > 0.05, j]).max()) for run in runs), default=1.0)
        # Linear around zero, logarithmic beyond: one engine's errors are far above the others'.
        axes.flat[j].set_yscale(
            "symlog", linthresh=max(1e-3 * 10 ** np.floor(np.log10(largest / 1e-2)), 1e-5)
        )
        axes.flat[j].set_ylim(-1.5 * largest, 1.5 * largest)
    return finished(figure, axes, "Torque of the engine less that of the identified model", results)


def engine_poses(study: Study) -> Any:
    """Figure 7: where the end effector goes in physics engines: position and orientation errors."""
    groups = {"sinusoids (simulated)": sinusoidal_runs(study)}
    if study.measured is not None:
        groups["motion of the real run"] = measured_runs(study)
    figure, axes = new_figure(2, len(groups), 4.6, sharex="col", sharey="row")
    for k, (name, results) in enumerate(groups.items()):
        for run in present(results):
            for axis, values, unit in ((axes[0, k], run.position, 1e3), (axes[1, k], run.angle, 1e3)):
                # Errors of position and angle below this are rounding and are drawn here [m, rad].
                axis.semilogy(
                    run.t + 0.5 * run.followed.step,
                    unit * (values + 1e-16),
                    label=run.engine,
                    **LOOKS[run.engine],
                )
        axes[0, k].set_title(name)
        axes[1, k].set_xlabel("time [s]")
        axes[0, k].margins(x=0)
    axes[0, 0].set_ylabel("position error [mm]")
    axes[1, 0].set_ylabel("orientation error [mrad]")
    legend_below(figure, axes[0, 0])
    title(
        figure, engines_title("Last joint's frame from where the commands put it", groups.popitem()[1])
    )
    return figure
