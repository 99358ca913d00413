"""FIGAROH's fit with physical consistency on given rows, in an environment of its own.

    python figaroh_script.py ROWS.npz ARM.urdf OUT.npz

The regressor is FIGAROH's `RegressorBuilder` with its friction and offsets, the fit its
`solve_direct_effort_fit`: least squares with a positive semidefinite pseudo-inertia for
each link, by PICOS and CVXOPT. The prior of its regularisation is the URDF.
"""

import sys

import numpy as np
from figaroh.identification.physical_fit import build_problem, solve_direct_effort_fit
from figaroh.tools.load_robot import load_robot
from figaroh.tools.regressor import RegressorBuilder, RegressorConfig

INERTIAL = ["m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz"]


def main(rows_file: str, urdf: str, out: str) -> None:
    """Fit the training rows, and predict the torque of the judged ones."""
    rows = np.load(rows_file)
    robot = load_robot(urdf, package_dirs=".")
    joints = list(robot.model.names[1:])
    config = RegressorConfig(has_friction=True, has_joint_offset=True)
    builder = RegressorBuilder(robot, config)
    active = {"act_idxv": list(range(len(joints)))}

    def regressor(of: str) -> np.ndarray:
        states = (rows[f"{of}_{name}"] for name in ("q", "dq", "ddq"))
        return builder.build_basic_regressor(*states, active)

    names = [f"{name}_{joint}" for joint in joints for name in INERTIAL]
    names += [f"{name}_{joint}" for name in ("fv", "fs", "off") for joint in joints]
    prior = np.zeros(len(names))
    for k, body in enumerate(robot.model.inertias[1:]):
        prior[10 * k : 10 * k + 10] = body.toDynamicParameters()
    problem = build_problem(
        regressor("train"),
        rows["train_tau"].T.ravel(),  # joint after joint
        names,
        joints,
        prior=prior,
    )
    record = solve_direct_effort_fit(problem)
    if record.theta is None:
        raise SystemExit(f"{record.solver_status}: {record.exception}")
    predicted = regressor("judged") @ record.theta
    np.savez(out, predicted=predicted.reshape(len(joints), -1).T)


if __name__ == "__main__":
    main(*sys.argv[1:])
