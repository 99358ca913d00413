"""Figures 1 to 7, of the Panda: its motions, torques and their errors, and physics
engines."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.comparison import predicted
from sdp_vs_penalty.estimators.estimator import Estimator
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.paper.figures import style
from sdp_vs_penalty.paper.figures.style import (
    PAGE_WIDTH,
    draw_torques,
    label_joints,
    legend_below,
    new_figure,
)
from sdp_vs_penalty.paper.tables import table_v
from sdp_vs_penalty.paper.tables.routes import routes_of
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.joint import Joint
from sdp_vs_penalty.signals.filtered import FilteredRun

PROBLEM = "panda"

#: The rows of ``table_routes`` that Fig. 1 draws, the uppermost line last.
_COMPARED = (
    "p_hat (published links)",
    "delta (published links)",
    "penalty, two-step",
    "SDP",
    "penalty, one-step",
)


def _on_unseen_folds(
    study: Study, methods: Mapping[str, str | Estimator]
) -> tuple[Array, Array, dict[str, Array], list[float]]:
    """Predict the torque of the real run by models that have not seen it.

    Each fold's stretch is predicted by the model that was estimated without it.

    Returns
    -------
    tuple
        Time (M,) [s], measured torque (M, n), predicted torque (M, n) by method, and
        the time at which each fold begins [s].
    """
    data = study.measured
    assert data is not None
    run = data.train
    rows = FilteredRun(run, data.preprocessing).all_rows(data.model)
    t = rows.motion.t - run.t[0]
    study.judge_unseen((method, None) for method in methods.values())
    predictions = dict[str, Array]()
    starts = list[float]()
    shown = np.zeros(len(t), bool)
    for name, method in methods.items():
        torque = np.full_like(rows.torque, np.nan)
        folds = study.unseen(method).folds
        for fold in folds:
            stretch = (t >= fold.start) & (t < fold.stop)
            torque[stretch] = predicted(rows, fold.theta)[stretch]
            shown |= stretch
        predictions[name], starts = torque, [fold.start for fold in folds]
    return (
        t[shown],
        rows.torque[shown],
        {name: torque[shown] for name, torque in predictions.items()},
        starts,
    )


def _on_all_runs(
    study: Study, methods: Mapping[str, str | Estimator]
) -> tuple[Array, Array, dict[str, Array], list[float]]:
    """Predict the torques of the simulated validation runs, joined one after another.

    Returns
    -------
    tuple
        Time (M,) [s], recorded torque (M, n), predicted torque (M, n) by method, and
        the time at which each run begins [s].
    """
    data = study.simulated
    assert data.test is not None
    # Once: a fit of the penalty takes much longer than the rows of a run.
    thetas = {name: study.theta(method, data) for name, method in methods.items()}
    times = list[Array]()
    torques = list[Array]()
    predictions = dict[str, list[Array]]()
    starts = list[float]()
    begin = 0.0
    for run in data.test.runs():
        rows = FilteredRun(run, data.preprocessing).all_rows(data.model)
        times.append(begin + rows.motion.t - run.t[0])
        torques.append(rows.torque)
        for name, theta in thetas.items():
            predictions.setdefault(name, []).append(predicted(rows, theta))
        starts.append(begin)
        begin += float(run.t[-1] - run.t[0])
    joined = {name: np.concatenate(parts) for name, parts in predictions.items()}
    return np.concatenate(times), np.concatenate(torques), joined, starts


def _draw_unseen(
    axes: Any,
    study: Study,
    methods: Mapping[str, str | Estimator],
    source: str,
) -> dict[str, float]:
    """Draw torques and errors on unseen motion; a grey line where a fold or run begins.

    Parameters
    ----------
    axes : (n, 2) array of Axes
        Torque on the left, error on the right.
    study : Study
        Data and estimates.
    methods : mapping
        What is drawn, by the names of the lines.
    source : str
        "measured" for the folds of the real run, "simulated" for the validation runs.

    Returns
    -------
    dict
        Relative error over all joints [%] by method, as in ``table_routes``.
    """
    is_measured = source == "measured"
    torques_of = _on_unseen_folds if is_measured else _on_all_runs
    t, torque, predictions, starts = torques_of(study, methods)
    draw_torques(
        axes,
        t,
        torque,
        "measured" if is_measured else "recorded",
        predictions,
    )
    for axis in axes.flat:
        for start in starts[1:]:
            axis.axvline(start, color=style.GREY, linewidth=0.5)
    if is_measured:
        return {
            name: study.unseen(method).relative_error_percent
            for name, method in methods.items()
        }
    return {
        name: study.simulated.errors(study.theta(method, study.simulated))[1]
        for name, method in methods.items()
    }


def figure_1(study: Study) -> Any:
    """Draw measured torques of unseen motion, and those of p_hat, delta, SDP and
    penalty.

    Parameters
    ----------
    study : Study
        The Panda's data sets and estimates.

    Returns
    -------
    matplotlib.figure.Figure
        For each joint the torque, and its error.
    """
    source = "simulated" if study.run is None else "measured"
    routes = routes_of(study)
    n = study.problem.robot.n
    figure, axes = new_figure(
        n,
        2,
        1.35 * n + 0.8,
        sharex=True,
        width_ratios=(3, 2),
    )
    methods = {name: routes[name] for name in _COMPARED if name in routes}
    errors = _draw_unseen(axes, study, methods, source)
    label_joints(axes, study.problem.robot.torque_units, "torque")
    axes[0, 0].set_title(f"torque ({source}, unseen motion)")
    axes[0, 1].set_title(f"error: estimated less {source}")
    legend_below(figure, axes[0, 0], n_columns=3)
    in_words = ", ".join(
        f"{name.removesuffix(' (published links)')} {error:.2f} %"
        for name, error in errors.items()
    )
    figure.suptitle(f"Relative error on unseen motion:\n{in_words}")
    return figure


def figure_2(study: Study) -> Any:
    """Draw the motions that estimates are judged on: simulated ones, and the real
    run's.

    Parameters
    ----------
    study : Study
        The Panda's data sets and estimates.

    Returns
    -------
    matplotlib.figure.Figure
        For each joint its position and its limits.
    """
    assert study.simulated.test is not None
    runs_by_source = {"simulated": list(study.simulated.test.runs())}
    folds = [] if study.run is None else study.unseen("lmi-sdp").folds
    if study.run is not None:
        runs_by_source["measured"] = [study.run.window(0.0, folds[-1].stop)]
    n = study.problem.robot.n
    columns = len(runs_by_source)
    figure, axes = new_figure(
        n,
        columns,
        1.15 * n + 0.6,
        sharex="col",
        sharey="row",
    )
    for column, (source, runs) in zip(axes.T, runs_by_source.items(), strict=True):
        _draw_positions(column, runs)
        _draw_limits(column, study.problem.robot.joints)
        about = f"all {len(runs)} runs" if source == "simulated" else "one motion"
        column[0].set_title(f"{source}, unseen: {about}")
    _mark_folds(axes[:, -1], [fold.start for fold in folds])
    label_joints(axes, study.problem.robot.position_units, "position")
    legend_below(figure, axes[0, -1])
    figure.suptitle("Validation motions (the paper's own are not public)")
    return figure


def _draw_positions(axes: Any, runs: Sequence[Measurements]) -> None:
    """Draw each joint's position over time, all runs on the same axes (n,)."""
    width = 1.0 if len(runs) == 1 else 0.6
    for number, run in enumerate(runs):
        label = "position" if number == 0 else "_"
        for axis, position in zip(axes, run.q.T, strict=True):
            axis.plot(
                run.t - run.t[0],
                position,
                color=style.BLUE,
                linewidth=width,
                label=label,
            )


def _draw_limits(axes: Any, joints: Sequence[Joint]) -> None:
    """Draw both ends of each joint's range as dashed lines."""
    for axis, joint in zip(axes, joints, strict=True):
        for limit in (joint.lower, joint.upper):
            axis.axhline(
                limit,
                color=style.ORANGE,
                linestyle="--",
                linewidth=0.8,
                label="joint limit",
            )


def _mark_folds(axes: Any, starts: Sequence[float]) -> None:
    """Draw a line where each fold but the first begins [s]."""
    for start in starts[1:]:
        for axis in axes:
            axis.axvline(
                start,
                color=style.GREY,
                linewidth=0.6,
                label="next fold, estimated without it",
            )


def figure_3(study: Study) -> Any:
    """Draw torques along all validation motions, none of which an estimate has seen.

    Parameters
    ----------
    study : Study
        The Panda's data sets and estimates.

    Returns
    -------
    matplotlib.figure.Figure
        For each joint torque and error, on simulated and on measured motion.
    """
    sources = ["simulated"] if study.run is None else ["simulated", "measured"]
    n = study.problem.robot.n
    # The ten simulated runs last 100 s, the real motion 13 s.
    ratios = (5, 4, 3, 2)[: 2 * len(sources)]
    figure, axes = new_figure(
        n,
        len(ratios),
        1.25 * n + 0.6,
        width=1.7 * PAGE_WIDTH,
        sharex="col",
        width_ratios=ratios,
    )
    methods: dict[str, str | Estimator] = {"lmi-sdp": "lmi-sdp", "penalty": "penalty"}
    errors = []
    for k, source in enumerate(sources):
        axes_of_data = axes[:, 2 * k : 2 * k + 2]
        error_by_method = _draw_unseen(axes_of_data, study, methods, source)
        about = "10 runs" if source == "simulated" else "five folds"
        axes_of_data[0, 0].set_title(f"{source}, unseen, {about}: torque")
        axes_of_data[0, 1].set_title(f"{source}, unseen: error")
        errors.append(f"{source} {error_by_method['lmi-sdp']:.2f} %")
    label_joints(axes, study.problem.robot.torque_units, "torque")
    legend_below(figure, axes[0, 0])
    figure.suptitle(
        "Torques of unseen motion, every validation run; relative error of lmi-sdp: "
        + ", ".join(errors)
    )
    return figure


def _present(results: table_v.Played) -> list[table_v.EngineRun]:
    """Return the runs of the installed engines.

    Bullet, whose torque is the noisiest, comes first, so that it is drawn below the
    others.
    """
    runs = [run for run in results.values() if not isinstance(run, str)]
    return sorted(runs, key=lambda run: run.engine != "Bullet")


def _engines_title(
    figure: Any,
    text: str,
    results: table_v.Played,
) -> None:
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
    study : Study
        Data and estimates.
    values : callable
        Returns the quantity (N, n) of an engine's run.
    what : str
        Name of the quantity.
    text : str
        Title of the figure.
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
    figure, axes = new_figure(
        (robot.n + 1) // 2,
        2,
        7.0,
        sharex=True,
    )
    for j, unit in enumerate(robot.torque_units):
        axis = axes.flat[j]
        for run in runs[:1] if model else ():
            axis.plot(
                run.t,
                run.model[:, j],
                label="identified model",
                **style.LOOKS["model"],
            )
        for run in runs:
            axis.plot(
                run.t,
                values(run)[:, j],
                label=run.engine,
                **style.LOOKS[run.engine],
            )
        axis.set_ylabel(f"joint {j + 1}\n{what} [{plain_unit(unit)}]")
    for axis in axes.flat[max(robot.n - axes.shape[1], 0) : robot.n]:
        axis.set_xlabel("time [s]")
        axis.tick_params(labelbottom=True)
    last = axes.flat[-1]
    last.axis("off")
    last.legend(
        *axes.flat[0].get_legend_handles_labels(),
        loc="center",
        handlelength=5,
    )
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
        study,
        lambda run: run.torque,
        "torque",
        text,
        model=True,
        results=results,
    )
    # The measured torque is the same beside every engine: the first one's run gives it.
    for run in _present(results)[:1]:
        # What comes before is no motion of the robot's: from rest to its velocity.
        moving = np.arange(len(run.t)) >= len(run.t) - len(run.error)
        known = run.torque[moving] - run.error
        for j in range(study.problem.robot.n):
            axis = axes.flat[j]
            values = known[:, j]
            axis.plot(
                run.t[moving],
                values,
                color=style.BLACK,
                linewidth=0.7,
                label="measured less friction",
                zorder=3.0,
            )
            both = np.concatenate([values, run.torque[moving, j]])
            spread = 0.08 * float(np.ptp(both))
            axis.set_ylim(both.min() - spread, both.max() + spread)
        handles = axes.flat[0].get_legend_handles_labels()
        axes.flat[-1].legend(
            *handles,
            loc="center",
            handlelength=5,
        )
    return figure


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
    figure, axes = new_figure(
        2,
        len(groups),
        4.6,
        sharex="col",
        sharey="row",
    )
    for k, (name, results) in enumerate(groups.items()):
        for run in _present(results):
            for axis, values in zip(axes[:, k], (run.position, run.angle), strict=True):
                # Errors of position and angle below 1e-16 are rounding and are drawn
                # there [m, rad].
                t = run.t + run.t[0]
                shown = 1e3 * (values + 1e-16)
                axis.semilogy(
                    t,
                    shown,
                    label=run.engine,
                    **style.LOOKS[run.engine],
                )
        axes[0, k].set_title(name)
        axes[1, k].set_xlabel("time [s]")
    axes[0, 0].set_ylabel("position error [mm]")
    axes[1, 0].set_ylabel("orientation error [mrad]")
    legend_below(figure, axes[0, 0], handle_length=5)
    _engines_title(
        figure,
        "Last joint's frame from where the commands put it",
        groups.popitem()[1],
    )
    return figure
