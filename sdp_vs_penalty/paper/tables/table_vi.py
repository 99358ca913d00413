"""Table VI: the DH table of the 2R, as printed and as the problem's kinematics has it."""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table import Cell, Column, Table
from sdp_vs_penalty.robot.robot import Robot

NAME = "VI"
PROBLEMS = ("two_link",)


def build(study: Study) -> Table:
    """Rows: joints. Our columns are read back from the joint placements, not from the same file."""
    published = study.problem.published["table_VI"]
    columns = [Column(name) for name in published[0]]
    columns += [Column(name) for name in ("a_m_ours", "alpha_rad_ours", "d_m_ours")]
    rows: list[tuple[Cell, ...]] = [
        (*row.values(), *map(float, values))
        for row, values in zip(published, dh_rows(study.problem.robot), strict=True)
    ]
    return Table(
        NAME,
        f"Table VI: Denavit-Hartenberg parameters of {study.problem.title}",
        "Standard (distal) convention; nothing here is simulated or measured.",
        tuple(columns),
        tuple(rows),
        ("theta_i = q_i without offset.",),
    )


def dh_rows(robot: Robot) -> list[tuple[float, float, float]]:
    """a, alpha, d of each joint from its link frame Tz(d) Tx(a) Rx(alpha)."""
    out = []
    for joint in robot.joints:
        frame = joint.link_frame
        out.append((frame[0, 3], float(np.arctan2(frame[2, 1], frame[2, 2])), frame[2, 3]))
    return out
