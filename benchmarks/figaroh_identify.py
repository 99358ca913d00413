"""FIGAROH on the same log, as its documentation says; runs in an environment of its own.

    python figaroh_identify.py RUN.csv ROBOT.urdf RATE OUT.json

Its workflow class, subclassed once a robot: the pipeline's own Butterworth filters at 8 Hz and
differentiation, decimation by ten (its default), friction and offsets, and its direct fit constrained
to physically consistent inertias (``physical_fit``, cvxopt).
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from figaroh.identification.base_identification import BaseIdentification
from figaroh.tools.load_robot import load_robot

CONFIG = """
robot:
  name: "arm"
  properties:
    joints:
      active_joints: [{joints}]
    mechanics:
      reduction_ratios: [{ones}]
      friction_coefficients: {{viscous: [{zeros}], static: [{zeros}]}}
      actuator_inertias: [{zeros}]
      joint_offsets: [{zeros}]
tasks:
  identification:
    enabled: true
    select_stage: physical_fit
    physical_fit: {{enabled: true, solver: cvxopt}}
    problem:
      include_external_forces: false
      use_joint_torques: true
      model_components:
        friction: true
        joint_offset: true
        actuator_inertia: false
    signal_processing:
      sampling_frequency: {rate}
      cutoff_frequency: 8.0
      filter_type: "butterworth"
      filter_order: 4
"""


class Identification(BaseIdentification):
    """One robot's subclass: which joints move, where the data are, what the torques pass."""

    run: Path

    def __init__(self, robot: Any, config: str) -> None:
        super().__init__(robot, config)
        joints = [self.model.joints[k] for k in range(1, self.model.njoints)]
        self.identif_config["act_idxq"] = [joint.idx_q for joint in joints]
        self.identif_config["act_idxv"] = [joint.idx_v for joint in joints]

    def load_trajectory_data(self, data_source: str | None = None) -> dict[str, np.ndarray]:
        frame = pd.read_csv(self.run)
        n = self.model.nv
        columns = {
            "positions": [f"q{j + 1}" for j in range(n)],
            "torques": [f"tau{j + 1}" for j in range(n)],
        }
        out = {key: frame[names].to_numpy() for key, names in columns.items()}
        return {
            "timestamps": frame["t"].to_numpy(),
            "velocities": None,
            "accelerations": None,
            **out,
        }

    def process_torque_data(self, **_: object) -> np.ndarray:
        filters = self.identif_config["filter_config"]["filter_params"]
        return self._apply_filters(self.raw_data["torques"], **filters)


def main(run: Path, urdf: Path, rate: float, out: Path) -> None:
    robot = load_robot(str(urdf))
    n = robot.model.nv
    text = CONFIG.format(
        joints=", ".join(f'"{name}"' for name in robot.model.names[1:]),
        ones=", ".join(["1.0"] * n),
        zeros=", ".join(["0"] * n),
        rate=rate,
    )
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "arm.yaml"
        config.write_text(text)
        Identification.run = run
        identification = Identification(robot, str(config))
        identification.initialize()
        identification.solve(decimate=True, decimation_factor=10, plotting=False)
    selected = identification.selected
    result = {
        "accepted": bool(selected is not None and selected.accepted),
        "reason": "" if selected is None else str(selected.reason),
        "rmse": float(identification.rms_error),
    }
    out.write_text(json.dumps(result))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]), Path(sys.argv[4]))
