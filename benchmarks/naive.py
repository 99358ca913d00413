"""The straightforward way from a log to a consistent estimate, as scripts in this field are written.

One regressor a sample from Pinocchio in a loop, one QR of all rows, CVXPY; of the filtered samples every
25th is kept, as whoever writes such a script does (25 ms at a cut-off of 8 Hz), or each. Same filters'
cut-offs, same constraints, same estimate as the program's within what different filters change.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cvxpy as cp
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import signal

Array = NDArray[np.float64]


def read(folder: Path, joints: int) -> tuple[Array, Array, Array]:
    """t (N,), q (N, n), tau (N, n) from the authors' text files, resampled to 1 kHz."""
    t, q, tau = (
        np.loadtxt(folder / f"exciting_traj_{name}.txt") for name in ("time", "positions", "torques")
    )
    q, tau = q.reshape(-1, joints), tau.reshape(-1, joints)
    grid = np.arange(t[0], t[-1], 0.001)
    return (
        grid,
        np.column_stack([np.interp(grid, t, x) for x in q.T]),
        np.column_stack([np.interp(grid, t, x) for x in tau.T]),
    )


def kept_rows(model: Any, q: Array, tau: Array, sign_width: float, every: int = 25) -> Array:
    """[Y tau] (N n / every, 10 n + 3 n + 1): rigid body, viscous, Coulomb, offset.

    States pass one low-pass, torque another. Where each sample is kept the columns pass that of the
    torque too, or the estimate is a little biased; on every 25th there is nothing to filter along.
    """
    b, a = signal.butter(4, 5.0 / 500.0)
    q = signal.filtfilt(b, a, q, axis=0)
    dq = np.gradient(q, 0.001, axis=0)
    ddq = np.gradient(dq, 0.001, axis=0)
    data, n = model.createData(), q.shape[1]
    samples = []
    smooth = signal.filtfilt(*signal.butter(4, 8.0 / 500.0), tau, axis=0) if every > 1 else tau
    for k in range(0, len(q), every):
        rigid = pin.computeJointTorqueRegressor(model, data, q[k], dq[k], ddq[k]).copy()
        friction = [np.diag(dq[k]), np.diag(np.tanh(dq[k] / sign_width)), np.eye(n)]
        samples.append(np.hstack([rigid, *friction, smooth[k][:, None]]))
    made = np.array(samples)
    if every == 1:
        made = signal.filtfilt(*signal.butter(4, 8.0 / 500.0), made, axis=0)
    return made.reshape(-1, made.shape[2])


def triangle(rows: Array) -> Array:
    return np.linalg.qr(rows, mode="r")


def solve(r: Array, rho: Array, scale: Array, unit: float, constraints: Sequence[Any]) -> Array:
    """theta from CVXPY and Clarabel: |R theta - rho|^2 in the cones F_0 + sum theta_i F_i.

    scale : of each parameter, unit : of the residual; without them Clarabel's answer is wrong. Each
    constraint is one array expression, which CVXPY takes in half the time of one written out.
    """
    x = cp.Variable(len(scale))
    demands = []
    for c in constraints:
        matrix = (c.coefficients.reshape(len(c.indices), -1) * scale[c.indices, None]).T
        value = matrix @ x[c.indices] + c.constant.ravel()
        if c.cone == "psd":
            demands.append(cp.reshape(value, c.constant.shape, order="C") >> 0)
        elif c.cone == "soc":
            demands.append(cp.SOC(value[0], value[1:]))
        else:
            demands.append(value >= 0)
    loss = cp.sum_squares((r * scale / unit) @ x - rho / unit)
    cp.Problem(cp.Minimize(loss), demands).solve(solver=cp.CLARABEL)
    return scale * x.value
