"""Figures 1 to 7, of the Panda: its motions, torques and their errors, and physics
engines."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.comparison import predicted
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.research.figures import style
from sdp_vs_penalty.research.figures.style import (
    draw_torques,
    label_joints,
    legend_below,
    new_figure,
)
from sdp_vs_penalty.research.tables import table_v
from sdp_vs_penalty.research.tables.study import Data, Study
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.filtered import FilteredRun

PROBLEM = "panda"


def _torques(
    axes: Any,
    study: Study,
    data: Data,
    run: Measurements,
    methods: Iterable[str],
    name: str,
) -> dict[str, float]:
    """Draws measured and estimated torques, all behind the same filters; each method's
    100 |tau - tau_hat| / |tau| over all joints [%]."""
    rows = FilteredRun(run, data.preprocessing).all_rows(data.model)
    torque_by_method, size = (
        {m: predicted(rows, study.theta(m, data)) for m in methods},
        np.linalg.norm(rows.torque),
    )
    draw_torques(axes, rows.motion.t - run.t[0], rows.torque, name, torque_by_method)
    return {
        m: 100.0 * float(np.linalg.norm(rows.torque - x) / size)
        for m, x in torque_by_method.items()
    }


def figure_1(study: Study) -> Any:
    """Measured and estimated torques along the exciting trajectory, with errors."""
    data = study.measured or study.simulated
    n = study.problem.robot.n
    figure, axes = new_figure(n, 2, 1.25 * n + 0.6, sharex=True, width_ratios=(3, 2))
    curves = _torques(axes, study, data, data.train, ("ols", "lmi-sdp"), data.label)
    label_joints(axes, study.problem.robot.torque_units, "torque")
    axes[0, 0].set_title("torque")
    axes[0, 1].set_title("error: estimated less " + data.label)
    legend_below(figure, axes[0, 0])
    errors = ", ".join(f"{method} {error:.2f} %" for method, error in curves.items())
    figure.suptitle(
        f"Exciting trajectory, {data.label}: relative error {errors} (the paper: 1.41"
        f" %, CLS), below {data.preprocessing.torque_cutoff:g} Hz"
    )
    return figure


def figure_2(study: Study) -> Any:
    """The validation trajectories."""
    n, judged = study.problem.robot.n, study.judged
    figure, axes = new_figure(
        n, len(judged), 1.15 * n + 0.6, sharex="col", sharey="row"
    )
    for k, data in enumerate(judged):
        assert data.test is not None
        run, *others = data.test.runs()
        for j, joint in enumerate(study.problem.robot.joints):
            look: dict[str, Any] = {
                "color": style.BLUE,
                "linewidth": 1.0,
                "label": "position",
            }
            axes[j, k].plot(run.t - run.t[0], run.q[:, j], **look)
            look = {
                "color": style.ORANGE,
                "linestyle": "--",
                "linewidth": 0.8,
                "label": "joint limit",
            }
            for limit in (joint.lower, joint.upper):
                axes[j, k].axhline(limit, **look)
        first = f"first of {1 + len(others)}" if others else "held out of the real run"
        axes[0, k].set_title(f"{data.label} ({first})")
    label_joints(axes, study.problem.robot.position_units, "position")
    legend_below(figure, axes[0, 0])
    figure.suptitle("Validation trajectories (the paper's own are not public)")
    return figure


def figure_3(study: Study) -> Any:
    """Torques along the validation trajectories."""
    n, judged = study.problem.robot.n, study.judged
    figure, axes = new_figure(n, 2 * len(judged), 1.25 * n + 0.6, sharex="col")
    notes = []
    for k, data in enumerate(judged):
        assert data.test is not None
        axes_of_data, run = axes[:, 2 * k : 2 * k + 2], data.test.runs()[0]
        curves = _torques(
            axes_of_data, study, data, run, ("lmi-sdp", "penalty"), "recorded"
        )
        axes_of_data[0, 0].set_title(f"{data.label}: torque")
        axes_of_data[0, 1].set_title(f"{data.label}: error")
        notes.append(f"{data.label} {curves['lmi-sdp']:.2f} %")
    label_joints(axes, study.problem.robot.torque_units, "torque")
    legend_below(figure, axes[0, 0])
    figure.suptitle("Held-out torques; relative error of lmi-sdp: " + ", ".join(notes))
    return figure


def _present(results: table_v.Played) -> list[table_v.EngineRun]:
    """The runs of the engines at hand, the noisiest first so that it is drawn below the
    others."""
    runs = [run for run in results.values() if not isinstance(run, str)]
    return sorted(runs, key=lambda run: run.engine != "Bullet")


def _engines_title(figure: Any, text: str, results: table_v.Played) -> None:
    """The title, with the engines that are not there."""
    absent = [kind.name for kind, run in results.items() if isinstance(run, str)]
    figure.suptitle(text + (f"\n(absent here: {', '.join(absent)})" if absent else ""))


def _engines(
    study: Study,
    values: Callable[[table_v.EngineRun], Array],
    what: str,
    text: str,
    model: bool = False,
) -> tuple[Any, Any]:
    """On sinusoidal velocities one panel a joint, one line an engine, beside the model
    if asked for; the legend is in the panel that seven joints leave free in four rows
    of two."""
    robot, results = study.problem.robot, study.once(table_v.sinusoidal_runs)
    runs = _present(results)
    figure, axes = new_figure((robot.n + 1) // 2, 2, 7.0, sharex=True)
    for j, unit in enumerate(robot.torque_units):
        axis = axes.flat[j]
        for run in runs[:1] if model else ():
            axis.plot(
                run.t, run.model[:, j], label="identified model", **style.LOOKS["model"]
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
    """Torques of physics engines along sinusoidal velocities, and of the identified
    model."""
    text = "Torques of physics engines on sinusoidal velocities"
    return _engines(study, lambda run: run.torque, "torque", text, model=True)[0]


def figure_6(study: Study) -> Any:
    """Torque errors of physics engines against the identified model."""
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
    """Where the end effector goes in physics engines: position and orientation errors."""
    groups = {"sinusoids (simulated)": study.once(table_v.sinusoidal_runs)}
    if study.measured is not None:
        groups["motion of the real run"] = study.once(table_v.measured_runs)
    figure, axes = new_figure(2, len(groups), 4.6, sharex="col", sharey="row")
    for k, (name, results) in enumerate(groups.items()):
        for run in _present(results):
            for axis, values in zip(axes[:, k], (run.position, run.angle), strict=True):
                # Errors of position and angle below 1e-16 are rounding and are drawn
                # there [m, rad].
                t, shown = run.t + run.t[0], 1e3 * (values + 1e-16)
                axis.semilogy(t, shown, label=run.engine, **style.LOOKS[run.engine])
        axes[0, k].set_title(name)
        axes[1, k].set_xlabel("time [s]")
    axes[0, 0].set_ylabel("position error [mm]")
    axes[1, 0].set_ylabel("orientation error [mrad]")
    legend_below(figure, axes[0, 0])
    _engines_title(
        figure, "Last joint's frame from where the commands put it", groups.popitem()[1]
    )
    return figure
