"""Figures 1 to 3, of the Panda: its motions, torques and their errors."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from sdp_vs_penalty.diagnosis.comparison import predicted
from sdp_vs_penalty.estimators.estimator import Estimator
from sdp_vs_penalty.paper.figures import style
from sdp_vs_penalty.paper.figures.style import (
    PAGE_WIDTH,
    draw_torques,
    label_joints,
    legend_below,
    new_figure,
)
from sdp_vs_penalty.paper.tables.routes import routes_of
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.robot.arrays import Array
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


class _UnseenMotion(NamedTuple):
    """A stretch of unseen motion of M instants."""

    #: (M,) instants; over simulated runs, which follow one another, they go on [s].
    t: Array
    #: (M, n) measured or simulated torque [N m, N].
    torque: Array
    #: The same as each method's model, which has not seen it, predicts it.
    predictions: dict[str, Array]


def _folds(
    study: Study, methods: Mapping[str, str | Estimator]
) -> Iterator[_UnseenMotion]:
    """Yield the folds of the real run, each with the torque predicted by models that were
    estimated without it."""
    data = study.measured
    assert data is not None
    rows = FilteredRun(data.train, data.preprocessing).all_rows(data.model)
    t = rows.motion.t - data.train.t[0]
    folds_of_methods = [study.unseen(method).folds for method in methods.values()]
    for folds in zip(*folds_of_methods, strict=True):
        inside = (t >= folds[0].start) & (t < folds[0].stop)
        predictions = {
            name: predicted(rows, fold.theta)[inside]
            for name, fold in zip(methods, folds, strict=True)
        }
        yield _UnseenMotion(t[inside], rows.torque[inside], predictions)


def _stretches(
    study: Study, methods: Mapping[str, str | Estimator], is_measured: bool
) -> Iterator[_UnseenMotion]:
    """Yield stretches of motion with the torques that models predict without having seen
    them: folds of the real run, or the simulated validation runs."""
    if is_measured:
        yield from _folds(study, methods)
        return
    data = study.simulated
    assert data.test is not None
    # Once: a fit of the penalty takes much longer than the rows of a run.
    thetas = {name: study.theta(method, data) for name, method in methods.items()}
    begin = 0.0
    for run in data.test.runs():
        rows = FilteredRun(run, data.preprocessing).all_rows(data.model)
        predictions = {name: predicted(rows, theta) for name, theta in thetas.items()}
        yield _UnseenMotion(begin + rows.motion.t - run.t[0], rows.torque, predictions)
        begin += float(run.t[-1] - run.t[0])


def _draw_unseen(
    axes: Any, study: Study, methods: Mapping[str, str | Estimator], source: str
) -> dict[str, float]:
    """Draw torques and errors on unseen motion; a grey line where a fold or run begins.

    Parameters
    ----------
    axes : (n, 2) array of Axes
        Torque on the left, error on the right.
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
    stretches = list(_stretches(study, methods, is_measured))
    t = np.concatenate([x.t for x in stretches])
    torque = np.concatenate([x.torque for x in stretches])
    predictions = {
        name: np.concatenate([x.predictions[name] for x in stretches])
        for name in methods
    }
    draw_torques(axes, t, torque, source, predictions)
    for axis in axes.flat:
        for stretch in stretches[1:]:
            axis.axvline(stretch.t[0], color=style.GREY, linewidth=0.5)
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
    figure, axes = new_figure(n, 2, 1.35 * n + 0.8, sharex=True, width_ratios=(3, 2))
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
    figure, axes = new_figure(n, columns, 1.15 * n + 0.6, sharex="col", sharey="row")
    for column, (source, runs) in zip(axes.T, runs_by_source.items(), strict=True):
        width = 1.0 if len(runs) == 1 else 0.6
        for j, (axis, joint) in enumerate(
            zip(column, study.problem.robot.joints, strict=True)
        ):
            for number, run in enumerate(runs):
                label = "position" if number == 0 else "_"
                axis.plot(
                    run.t - run.t[0],
                    run.q[:, j],
                    color=style.BLUE,
                    linewidth=width,
                    label=label,
                )
            for limit in (joint.lower, joint.upper):
                axis.axhline(
                    limit,
                    color=style.ORANGE,
                    linestyle="--",
                    linewidth=0.8,
                    label="joint limit",
                )
        about = f"all {len(runs)} runs" if source == "simulated" else "one motion"
        column[0].set_title(f"{source}, unseen: {about}")
    for fold in folds[1:]:
        for axis in axes[:, -1]:
            axis.axvline(
                fold.start,
                color=style.GREY,
                linewidth=0.6,
                label="next fold, estimated without it",
            )
    label_joints(axes, study.problem.robot.position_units, "position")
    legend_below(figure, axes[0, -1])
    figure.suptitle("Validation motions (the paper's own are not public)")
    return figure


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
