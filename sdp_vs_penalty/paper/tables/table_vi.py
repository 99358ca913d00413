"""Table VI: the DH table of the 2R, as printed and as the problem's kinematics has it."""

import numpy as np

from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table import Maker, Row, Table


def build(study: Study) -> Table:
    """Rows: joints. Our columns are read back from the joint placements, not from the same file."""
    rows: list[Row] = []
    for row, joint in zip(study.problem.published["table_VI"], study.problem.robot.joints, strict=True):
        frame = joint.link_frame  # Tz(d) Tx(a) Rx(alpha)
        a, alpha, d = frame[0, 3], np.arctan2(frame[2, 1], frame[2, 2]), frame[2, 3]
        ours = {"a_m_ours": float(a), "alpha_rad_ours": float(alpha), "d_m_ours": float(d)}
        rows.append({**row, **ours})
    return Table.of(
        "VI",
        f"Table VI: Denavit-Hartenberg parameters of {study.problem.title}",
        "Standard (distal) convention; nothing here is simulated or measured.",
        rows,
        ("theta_i = q_i without offset.",),
    )


TABLE = Maker("VI", __doc__, build, ("two_link",))
