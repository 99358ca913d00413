"""Figures 5 to 7: the Panda's motion in physics engines."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.paper.figures import style
from sdp_vs_penalty.paper.figures.style import legend_below, new_figure
from sdp_vs_penalty.paper.tables import table_v
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.robot.arrays import Array

PROBLEM = "panda"


def _present(results: table_v.Played) -> list[table_v.EngineRun]:
    """Return the runs of the installed engines.

    Bullet, whose torque is the noisiest, comes first, so that it is drawn below the
    others.
    """
    runs = [run for run in results.values() if not isinstance(run, str)]
    return sorted(runs, key=lambda run: run.engine != "Bullet")


def _engines_title(figure: Any, text: str, results: table_v.Played) -> None:
    """Write the figure's title, with the engines that are not installed."""
    absent = [kind.name for kind, run in results.items() if isinstance(run, str)]
    figure.suptitle(text + (f"\n(absent here: {', '.join(absent)})" if absent else ""))


def _engines(
    study: Study,
    values: Callable[[table_v.EngineRun], Array],
    what: str,
    text: str,
    model: bool = False,
    results: table_v.Played | None = None,
) -> tuple[Any, Any]:
    """Draw a quantity of all physics engines: one panel for each joint, one line an
    engine.

    The legend takes the panel that seven joints leave free in four rows of two.

    Parameters
    ----------
    values : callable
        Returns the quantity (N, n) of an engine's run.
    model : bool
        Whether to draw the identified model's torque as well.
    results : mapping, optional
        Runs of the engines; by default those on sinusoidal velocities.

    Returns
    -------
    figure, (rows, 2) array of Axes
    """
    robot = study.problem.robot
    if results is None:
        results = study.once(table_v.sinusoidal_runs)
    runs = _present(results)
    figure, axes = new_figure((robot.n + 1) // 2, 2, 7.0, sharex=True)
    for j, unit in enumerate(robot.torque_units):
        axis = axes.flat[j]
        if model and runs:  # the same beside every engine
            axis.plot(
                runs[0].t,
                runs[0].model[:, j],
                label="identified model",
                **style.LOOKS["model"],
            )
        for run in runs:
            axis.plot(
                run.t, values(run)[:, j], label=run.engine, **style.LOOKS[run.engine]
            )
        axis.set_ylabel(f"joint {j + 1}\n{what} [{plain_unit(unit)}]")
    for axis in axes.flat[max(robot.n - axes.shape[1], 0) : robot.n]:
        axis.set_xlabel("time [s]")
        axis.tick_params(labelbottom=True)
    last = axes.flat[-1]
    last.axis("off")
    last.legend(*axes.flat[0].get_legend_handles_labels(), loc="center", handlelength=5)
    _engines_title(figure, text, results)
    return figure, axes


def figure_5(study: Study) -> Any:
    """Draw torques of physics engines, of the identified model, and measured ones.

    The motion is the real run's; without it, sinusoidal velocities.

    Parameters
    ----------
    study : Study
        The Panda's data sets and estimates.

    Returns
    -------
    matplotlib.figure.Figure
        One panel for each joint.
    """
    if study.measured is None:
        text = "Torques of physics engines on sinusoidal velocities (nothing measured)"
        return _engines(study, lambda run: run.torque, "torque", text, model=True)[0]
    results = study.once(table_v.measured_runs)
    text = "Torques of physics engines on the real run's motion (which the links were"
    text += " estimated from)"
    figure, axes = _engines(
        study, lambda run: run.torque, "torque", text, model=True, results=results
    )
    if runs := _present(results):
        # The measured torque is the same beside every engine: of any run.
        _draw_measured(axes, runs[0])
    return figure


def _draw_measured(axes: Any, run: table_v.EngineRun) -> None:
    """Draw the measured torque that an engine's run was compared with, to its scale."""
    # What comes before is no motion of the robot's: from rest to its velocity.
    moving = np.arange(len(run.t)) >= len(run.t) - len(run.error)
    torque = run.torque[moving]
    measured = torque - run.error
    for j, axis in enumerate(axes.flat[: torque.shape[1]]):
        axis.plot(
            run.t[moving],
            measured[:, j],
            color=style.BLACK,
            linewidth=0.7,
            label="measured less friction",
            zorder=3.0,
        )
        both = np.concatenate([measured[:, j], torque[:, j]])
        spread = 0.08 * float(np.ptp(both))
        axis.set_ylim(both.min() - spread, both.max() + spread)
    handles = axes.flat[0].get_legend_handles_labels()
    axes.flat[-1].legend(*handles, loc="center", handlelength=5)


def figure_6(study: Study) -> Any:
    """Draw the torque of physics engines minus that of the identified model.

    Parameters
    ----------
    study : Study
        The Panda's data sets and estimates.

    Returns
    -------
    matplotlib.figure.Figure
        One panel for each joint, on sinusoidal velocities.
    """
    text = "Torque of the engine less that of the identified model"
    figure, axes = _engines(study, lambda run: run.error, "torque error", text)
    runs = _present(study.once(table_v.sinusoidal_runs))
    for j in range(study.problem.robot.n):
        # Left out of the torque errors at the start [s], where the acceleration jumps
        # from rest.
        largest = max(
            (float(np.abs(run.error[run.t > 0.05, j]).max()) for run in runs),
            default=1.0,
        )
        # Linear around zero, logarithmic beyond: one engine's errors are far above the
        # others'.
        linear = max(1e-3 * 10 ** np.floor(np.log10(largest / 1e-2)), 1e-5)
        axes.flat[j].set_yscale("symlog", linthresh=linear)
        axes.flat[j].set_ylim(-1.5 * largest, 1.5 * largest)
    return figure


def figure_7(study: Study) -> Any:
    """Draw how far physics engines put the end effector from where it is commanded.

    Parameters
    ----------
    study : Study
        The Panda's data sets and estimates.

    Returns
    -------
    matplotlib.figure.Figure
        Errors of position and orientation over time.
    """
    groups = {"sinusoids (simulated)": study.once(table_v.sinusoidal_runs)}
    if study.measured is not None:
        groups["motion of the real run"] = study.once(table_v.measured_runs)
    figure, axes = new_figure(2, len(groups), 4.6, sharex="col", sharey="row")
    for column, (name, results) in zip(axes.T, groups.items(), strict=True):
        for run in _present(results):
            for axis, values in zip(column, (run.position, run.angle), strict=True):
                # Errors of position and angle below 1e-16 are rounding and are drawn
                # there [m, rad].
                t = run.t + run.t[0]
                thousandths = 1e3 * (values + 1e-16)
                axis.semilogy(
                    t, thousandths, label=run.engine, **style.LOOKS[run.engine]
                )
        column[0].set_title(name)
        column[1].set_xlabel("time [s]")
    axes[0, 0].set_ylabel("position error [mm]")
    axes[1, 0].set_ylabel("orientation error [mrad]")
    legend_below(figure, axes[0, 0], handle_length=5)
    text = "Last joint's frame from where the commands put it"
    _engines_title(figure, text, results)
    return figure
