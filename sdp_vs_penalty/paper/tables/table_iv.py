"""Table IV: torque error of each joint on motion that no estimate was made from."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimators.estimator import Estimator
from sdp_vs_penalty.paper.tables.folds import error_interval, interval_of
from sdp_vs_penalty.paper.tables.study import (
    CUT,
    FOLDS,
    Data,
    FoldSettings,
    Frozen,
    Study,
    torque_errors,
)
from sdp_vs_penalty.paper.tables.table import (
    Cell,
    Row,
    StudyTable,
    by_joint,
    notes,
    register_table,
)
from sdp_vs_penalty.paper.tables.table_i import LinearisedSigmoid
from sdp_vs_penalty.robot.arrays import Array

#: Rows whose sensitivity to the filter is told.
_SHOWN = ("p_hat", "delta", "ols")


@register_table("IV")
def unseen_torque(study: Study) -> StudyTable:
    """Table IV: torque error of each joint on unseen and on repeated motion."""
    study.estimate(study.methods.values(), study.judged)
    joints = [f"joint_{j + 1}" for j in range(study.problem.robot.n)]
    rows = [
        _row(row["estimate"], [row[joint] for joint in joints], "published")
        for row in study.problem.published.get("table_IV", [])
    ]
    for data in study.judged:
        if data is study.repeated:
            rows += _unseen_rows(study)
        rows += _judged_rows(study, data)
    units = {unit.replace("*", " ") for unit in study.problem.robot.torque_units}
    squared = " and ".join(sorted(f"({unit})^2" for unit in units))
    table = StudyTable(
        f"Table IV: torque MSE [{squared}] per joint of {study.problem.title} on other"
        " motion",
        rows,
        _notes(study, rows),
        caption=f"{study.sentence} {_judgement(study)}",
    )
    columns = [name for name in table.frame if name != "worst_fold_percent"]
    shown = ("p_hat", "p_real", "delta", "ols", "penalty", "lmi_sdp")
    # Without the ending that names the data set.
    as_printed = [
        re.sub("_(simulated|measured|repeatability)$", "", row["estimate"]) in shown
        for row in rows
    ]
    return table.shortened(columns, as_printed)


def _unseen_rows(study: Study) -> list[Row]:
    """Return a row for each estimate: its error on held-out folds of the real run."""
    rows = []
    for name, (method, effects) in _estimates(study).items():
        result = study.unseen(method, FoldSettings(effects))
        rows.append(
            _row(
                f"{name}_measured",
                (result.rmse**2).tolist(),
                "measured, unseen",
                result.relative_error_percent,
                error_interval(result).in_words,
                result.folds[result.worst_fold - 1].relative_error_percent,
            )
        )
    return rows


def _judged_rows(study: Study, data: Data) -> list[Row]:
    """Return a row for each estimate: its error on the test rows of a data set.

    For the repeated real run, the rows are named "repeatability" and have no interval.
    """
    is_repeated = data is study.repeated
    ending = "repeatability" if is_repeated else data.label
    label = "measured, repeated" if is_repeated else data.label
    rows = []
    for name, (method, effects) in _estimates(study).items():
        judged = data
        if effects is not None:
            judged = replace(data, model=Model(study.problem.robot, effects))
        theta = study.theta(method, judged)
        mse, relative = judged.errors(theta)
        interval = None if is_repeated else _over_runs(judged, theta)
        rows.append(_row(f"{name}_{ending}", mse.tolist(), label, relative, interval))
    return rows


def _over_runs(data: Data, theta: Array) -> str | None:
    """Return the 95 % interval of the relative error over the test runs, in words.

    None if there is a single run.
    """
    rows = data.test_regression
    if len(rows.blocks) < 2:
        return None
    errors = [
        torque_errors(rows.select([k]), theta)[1] for k in range(len(rows.blocks))
    ]
    return interval_of(np.array(errors)).in_words


def _row(
    name: str,
    joints: Iterable[Cell],
    data: str,
    relative: Cell = None,
    interval: Cell = None,
    worst: Cell = None,
) -> Row:
    """Return a row of the table.

    Parameters
    ----------
    joints : iterable
        Mean squared error of each joint.
    data : str
        Data that it was judged on.
    relative : float, optional
        Relative error over all joints [%].
    interval : str, optional
        Its 95 % interval in words.
    worst : float, optional
        Relative error on the worst fold [%].
    """
    more = {
        "relative_error_percent": relative,
        "interval_percent": interval,
        "worst_fold_percent": worst,
        "data": data,
    }
    return {"estimate": name, **by_joint(joints), **more}


def _estimates(
    study: Study,
) -> dict[str, tuple[str | Estimator, tuple[Effect, ...] | None]]:
    """Return the estimates of the table by name: published links, then every method.

    Each comes with the effects of its model, or None for the problem's own.
    """
    robot = study.problem.robot
    friction = study.experiment.friction
    published = study.published_links
    out: dict[str, tuple[str | Estimator, tuple[Effect, ...] | None]] = {
        column: (Frozen(links), None) for column, links in published.items()
    }
    if friction is not None and "p_hat" in out:
        amplitude = friction[:, :1]
        shapes = friction[:, 1:]
        effects = (
            *study.problem.model("rigid_body").effects,
            LinearisedSigmoid(robot, shapes),
        )
        # The effect's parameters of each joint: phi_1, and corrections of phi_2 and
        # phi_3, which are zero for the published friction.
        others = (amplitude * [1.0, 0.0, 0.0]).ravel()
        out["p_hat_table_I"] = Frozen(published["p_hat"], others), effects
    return out | {name: (method, None) for name, method in study.methods.items()}


def _judgement(study: Study) -> str:
    """Return the sentences of the caption that say on which motion the rows are judged."""
    count, duration = study.experiment.validation
    sentence = (
        f"Simulated rows: estimated from that trajectory, judged on {count} other"
        f" random trajectories of {duration:g} s."
    )
    if study.repeated is None:
        return sentence
    return (
        f"{sentence} Measured rows: unseen motion of the real run, {FOLDS} folds by phase,"
        " each estimated without a stretch of the motion and all its repetitions. Rows"
        f" named repeatability: estimated from the first {CUT[0]:g} s of the run,"
        f" judged from {CUT[1]:g} s on, where it repeats its beginning."
    )


def _notes(study: Study, rows: Sequence[Row]) -> list[str]:
    """Return the notes below the table; ``rows`` are those of the table, from which a
    note on the filter takes the errors."""
    printed = "table_IV" in study.problem.published
    sigmoid = ""
    published = ""
    sensitivity = ""
    if study.experiment.friction is not None:
        sigmoid = (
            "p_hat_table_I keeps the published sigmoid friction as well; in the"
            " simulation that is the truth, and its MSE the noise that is left behind"
            " the filters."
        )
    if printed:
        where = "whose data are not public"
        published = (
            "The published rows are of the paper's own trajectories and filters,"
            f" {where}."
        )
    if printed and study.run is not None:
        sensitivity = _sensitivity(study, rows)
    more = {"sigmoid": sigmoid, "published": published, "sensitivity": sensitivity}
    cutoff = study.simulated.preprocessing.torque_cutoff
    return notes("IV", cutoff=cutoff, priors=study.about_priors, **more)


def _sensitivity(study: Study, rows: Sequence[Row]) -> str:
    """Say how a filter of twice the cut-off changes the errors on unseen motion.

    rows : those of the table, which has the errors behind its own filter.
    """
    assert study.run is not None
    settings = study.problem.preprocessing.resolve(study.run)
    assert settings.torque_cutoff is not None
    wide = replace(settings, torque_cutoff=2.0 * settings.torque_cutoff)
    other = study.sibling(replace(study.problem, preprocessing=wide))
    narrow = {row["estimate"]: row["relative_error_percent"] for row in rows}
    errors = []
    for name in _SHOWN:
        method, effects = _estimates(other)[name]
        wider = other.unseen(method, FoldSettings(effects)).relative_error_percent
        errors.append(f"{name} {narrow[f'{name}_measured']:.3g} and {wider:.3g} %")
    return (
        f"The filter matters: behind {settings.torque_cutoff:g} and"
        f" {wide.torque_cutoff:g} Hz the errors on unseen motion are"
        f" {', '.join(errors)}."
    )
