"""Table IV: torque error of each joint on motion that no estimate was made from."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.effect import Array, JointEffect, Motion
from sdp_vs_penalty.paper.tables.study import (
    METHODS,
    TEST_START,
    TRAIN_STOP,
    Data,
    Study,
    sentence,
    torque_errors,
)
from sdp_vs_penalty.paper.tables.table import Cell, Column, Table
from sdp_vs_penalty.problem.published import box_tables
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.simulation.simulate import sigmoid_friction

NAME = "IV"


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
        (row["estimate"], *(row[f"joint_{j + 1}"] for j in range(joints)), None, "published")
        for row in study.problem.published.get("table_IV", [])
    ]
    for data in study.judged:
        for name, mse, relative in _judged(study, data):
            rows.append((f"{name}_{data.label}", *map(float, mse), relative, data.label))
    columns = [Column("estimate"), *(Column(f"joint_{j + 1}") for j in range(joints))]
    columns += [Column("relative_error_percent"), Column("data")]
    units = " and ".join(
        sorted({f"({unit.replace('*', ' ')})^2" for unit in study.problem.robot.torque_units})
    )
    return Table(
        NAME,
        f"Table IV: held-out torque MSE [{units}] per joint of {study.problem.title}",
        f"{sentence(study)} {_judgement(study)}",
        tuple(columns),
        tuple(rows),
        _notes(study),
    )


def _judged(study: Study, data: Data) -> list[tuple[str, Array, float]]:
    """Published links first, then every method: MSE of each joint and relative error."""
    out: list[tuple[str, Array, float]] = []
    links: dict[str, Array] = {}
    for table in box_tables(study.problem)[:1]:
        header = study.problem.published[table][0]
        links = {c: study.published_links(c) for c in ("p_real", "p_hat", "delta") if c in header}
    for column, values in links.items():
        out.append((column, *data.errors(study.frozen_links(values, data))))
    friction = study.experiment.friction
    if friction is not None and "p_hat" in links:
        model = study.model_with(KnownFriction(study.problem.robot, friction))
        theta = np.concatenate([links["p_hat"].ravel(), np.ones(study.problem.robot.n)])
        out.append(("p_hat_table_I", *torque_errors(data.test_with(model), theta)))
    for name, method in METHODS.items():
        out.append((name, *data.errors(study.result(method, data).theta)))
    return out


def _judgement(study: Study) -> str:
    count, duration = study.experiment.validation
    said = (
        f"Simulated rows: estimated from that trajectory, judged on {count} other random trajectories "
        f"of {duration:g} s."
    )
    if study.held_out is None:
        return said
    return (
        f"{said} Measured rows: estimated from the first {TRAIN_STOP:g} s of the run, judged on its "
        f"rest from {TEST_START:g} s on."
    )


def _notes(study: Study) -> tuple[str, ...]:
    cutoff = study.simulated.preprocessing.torque_cutoff
    notes = [
        f"Both torques behind the same filters (below {cutoff:g} Hz); relative_error_percent is 100 "
        "|tau - tau_hat| / |tau| over all joints.",
        "Published links (p_real, p_hat with its errata corrected, delta as printed) are frozen; "
        "friction and offsets linear in their parameters are refitted by least squares on the "
        "training part.",
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
    return tuple(notes)
