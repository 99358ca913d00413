"""Table IV: torque error of each joint on motion that no estimate was made from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.paper.tables.study import (
    FOLDS,
    TEST_START,
    TRAIN_STOP,
    Data,
    Study,
    sentence,
)
from sdp_vs_penalty.paper.tables.table import Cell, Column, Table
from sdp_vs_penalty.problem.published import box_tables, published_links
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.simulation.simulate import sigmoid_friction

NAME = "IV"
#: Rows whose sensitivity to the filter is told.
_SHOWN = ("p_hat", "delta", "ols")


class KnownFriction(JointEffect):
    """Published sigmoid friction as columns with parameters 1."""

    name = "known_friction"
    equation = "phi_1 / (1 + exp(-phi_2 (dq + phi_3))) - phi_1 / (1 + exp(-phi_2 phi_3))"
    explanation = "Friction of Table I, all of it known."
    reference = "Gaz et al., RA-L 2019, eq. 12"
    symbol = "known"
    units = ("1", "1")

    def __init__(self, robot: Robot, phi: Array) -> None:
        super().__init__(robot)
        self.friction = sigmoid_friction(phi)

    def column(self, motion: Motion, joint: int) -> Array:
        return self.friction(motion)[:, joint]


def build(study: Study) -> Table:
    joints = study.problem.robot.n
    rows: list[tuple[Cell, ...]] = [
        (row["estimate"], *(row[f"joint_{j + 1}"] for j in range(joints)), None, None, "published")
        for row in study.problem.published.get("table_IV", [])
    ]
    study.estimate(study.methods.values(), [*study.judged, *study.folds])
    estimates = _estimates(study)
    for data in study.judged:
        repeated = data is study.repeated
        ending, label = ("repeatability", "measured, repeated") if repeated else (data.label, data.label)
        if repeated:
            for name, estimate in estimates.items():
                found = study.unseen(estimate.of, estimate.model)
                cells = (*map(float, found.mse), found.relative, max(found.folds))
                rows.append((f"{name}_measured", *cells, "measured, unseen"))
        for name, estimate in estimates.items():
            there = None if estimate.model is None else data.test_with(estimate.model)
            mse, relative = data.errors(estimate.of(data), there)
            rows.append((f"{name}_{ending}", *map(float, mse), relative, None, label))
    columns = [Column("estimate"), *(Column(f"joint_{j + 1}") for j in range(joints))]
    columns += [Column("relative_error_percent"), Column("worst_fold_percent"), Column("data")]
    units = " and ".join(
        sorted({f"({unit.replace('*', ' ')})^2" for unit in study.problem.robot.torque_units})
    )
    return Table(
        NAME,
        f"Table IV: torque MSE [{units}] per joint of {study.problem.title} on other motion",
        f"{sentence(study)} {_judgement(study)}",
        tuple(columns),
        tuple(rows),
        _notes(study, rows),
        _gist(study, rows),
    )


def _gist(study: Study, rows: Sequence[tuple[Cell, ...]]) -> str:
    """Our methods' relative errors on unseen motion."""
    where = "simulated" if study.repeated is None else "measured"
    errors = {str(row[0]): row[-3] for row in rows}
    said = [f"{name} {errors[f'{name}_{where}']:.3g} %" for name in study.methods]
    return f"On unseen motion ({where}): {', '.join(said)}."


@dataclass(frozen=True)
class _Estimate:
    """How a row's parameters come about from training rows, and the model that has them, if another."""

    of: Callable[[Data], Array]
    model: Model | None = None


def _estimates(study: Study) -> dict[str, _Estimate]:
    """Published links first, then every method."""
    out: dict[str, _Estimate] = {}
    links: dict[str, Array] = {}
    for table in box_tables(study.problem)[:1]:
        header = study.problem.published[table][0]
        columns = [c for c in ("p_real", "p_hat", "delta") if c in header]
        links = {c: published_links(study.problem, c) for c in columns}
    for column, values in links.items():
        out[column] = _Estimate(partial(study.frozen_links, values))
    friction = study.experiment.friction
    if friction is not None and "p_hat" in links:
        theta = np.concatenate([links["p_hat"].ravel(), np.ones(study.problem.robot.n)])
        robot, rigid = study.problem.robot, study.problem.model("rigid_body").effects
        known = Model(robot, (*rigid, KnownFriction(robot, friction)))
        out["p_hat_table_I"] = _Estimate(lambda _: theta, known)
    for name, method in study.methods.items():
        out[name] = _Estimate(partial(study.fitted, method))
    return out


def _judgement(study: Study) -> str:
    count, duration = study.experiment.validation
    said = (
        f"Simulated rows: estimated from that trajectory, judged on {count} other random trajectories "
        f"of {duration:g} s."
    )
    if study.repeated is None:
        return said
    return (
        f"{said} Measured rows: unseen motion of the real run, {FOLDS} folds by phase, each estimated "
        "without a stretch of the motion and all its repetitions. Rows named repeatability: estimated "
        f"from the first {TRAIN_STOP:g} s of the run, judged from {TEST_START:g} s on, where it repeats "
        "its beginning."
    )


def _notes(study: Study, rows: Sequence[tuple[Cell, ...]]) -> tuple[str, ...]:
    cutoff = study.simulated.preprocessing.torque_cutoff
    notes = [
        f"Both torques behind the same filters (below {cutoff:g} Hz); relative_error_percent is 100 "
        "|tau - tau_hat| / |tau| over all joints.",
        "Published links (p_real, p_hat with its errata corrected, delta as printed) are frozen; "
        "friction and offsets linear in their parameters are refitted by least squares on the "
        "training part.",
        *study.about_priors,
    ]
    if study.experiment.friction is not None:
        notes.append(
            "p_hat_table_I keeps the published sigmoid friction as well; in the simulation that is the "
            "truth, and its MSE the noise that is left behind the filters."
        )
    if "table_IV" in study.problem.published:
        notes.append(
            "The published rows are of the paper's own trajectories and filters, whose data "
            "are not public."
        )
    if study.run is not None and "table_IV" in study.problem.published:
        notes.append(_sensitivity(study, rows))
    return tuple(notes)


def _sensitivity(study: Study, rows: Sequence[tuple[Cell, ...]]) -> str:
    """The measured errors behind a wider filter, beside the table's own."""
    assert study.run is not None
    settings = study.problem.preprocessing.resolve(study.run)
    assert settings.torque_cutoff is not None
    wide = replace(settings, torque_cutoff=2.0 * settings.torque_cutoff)
    behind = replace(study.problem, preprocessing=wide)
    other = Study(behind, study.budget, study.seed, study.progress, study.workers)
    other.estimate([study.methods[name] for name in _SHOWN if name in study.methods], other.folds)
    own, estimates = {str(row[0]): row[-3] for row in rows}, _estimates(other)
    errors = [
        f"{name} {own[f'{name}_measured']:.3g} and {other.unseen(estimates[name].of).relative:.3g} %"
        for name in _SHOWN
    ]
    return (
        f"The filter matters: behind {settings.torque_cutoff:g} and {wide.torque_cutoff:g} Hz the "
        f"errors on unseen motion are {', '.join(errors)}."
    )
