"""A log to a physically consistent estimate, as an ordinary script in this field:
decimate, then CVXPY.

Positions and torques pass zero-phase Butterworth filters, every 28th sample is kept,
Pinocchio gives its regressor, CVXPY minimises the squared residual subject to positive
definite pseudo-inertias and signs. No bounds, no weights, no certificate, no intervals,
and columns do not pass the filter of the torque.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import signal

Array = NDArray[np.float64]

#: Samples a row: about as many rows as the program keeps of the Panda's log.
DECIMATION = 28
#: Velocity over which the sign of Coulomb friction turns [rad/s].
SIGN_WIDTH = 0.01


def read(folder: Path, joints: int) -> tuple[Array, Array, Array]:
    """t (N,), q (N, n), tau (N, n) from the authors' text files, resampled to 1 kHz."""
    files = (
        folder / f"exciting_traj_{name}.txt"
        for name in ("time", "positions", "torques")
    )
    t, *channels = map(np.loadtxt, files)
    grid = np.arange(t[0], t[-1], 0.001)
    columns = (x.reshape(-1, joints).T for x in channels)
    q, tau = (
        np.column_stack(
            [
                np.interp(
                    grid,
                    t,
                    x,
                )
                for x in channel
            ]
        )
        for channel in columns
    )
    return grid, q, tau


def kept(samples: int) -> slice:
    """The samples that are kept, half a second off either end."""
    return slice(500, samples - 500, DECIMATION)


def columns(
    model: Any,
    q: Array,
    dq: Array,
    ddq: Array,
) -> Array:
    """Y (M, n, 13 n): rigid body, viscous, Coulomb, offset."""
    data = model.createData()
    n = q.shape[1]
    stack = []
    for x, dx, ddx in zip(q, dq, ddq, strict=True):
        rigid = pin.computeJointTorqueRegressor(model, data, x, dx, ddx).copy()
        friction = [
            np.diag(dx),
            np.diag(np.tanh(dx / SIGN_WIDTH)),
            np.eye(n),
        ]
        stack.append(np.hstack([rigid, *friction]))
    return np.array(stack)


def rows(
    model: Any,
    q: Array,
    tau: Array,
) -> tuple[Array, Array]:
    """Y (M, n, 13 n) and tau (M, n) of every kept sample."""
    pairs = (q, 5.0), (tau, 8.0)  # Hz
    q, tau = (
        signal.filtfilt(
            *signal.butter(4, f / 500.0),
            x,
            axis=0,
        )
        for x, f in pairs
    )
    dq = np.gradient(q, 0.001, axis=0)
    states = q, dq, np.gradient(dq, 0.001, axis=0)
    few = kept(len(q))
    return columns(model, *(x[few] for x in states)), tau[few]


def solve(
    y: Array,
    tau: Array,
    basis: Array,
    triangle: bool = True,
) -> Array:
    """theta (13 n,) of least squares with positive semidefinite pseudo-inertias and
    friction >= 0.

    y (M, n, 13 n), tau (M, n); basis (10, 4, 4) : of the pseudo-inertia. Columns are
    scaled to unit length: without that Clarabel's answer is wrong. triangle : CVXPY is
    given the rows' R factor, else the rows themselves.
    """
    import cvxpy as cp

    links = y.shape[1]
    R = np.column_stack(
        [
            y.reshape(-1, y.shape[2]),
            tau.ravel(),
        ]
    )
    R = np.linalg.qr(R, mode="r") if triangle else R
    norms = np.linalg.norm(R[:, :-1], axis=0)
    scale = 1.0 / np.maximum(norms, 1e-6 * norms.max())
    x = cp.Variable(y.shape[2])
    demands: list[Any] = [x[10 * links : 12 * links] >= 0]
    for k in range(links):
        own = slice(10 * k, 10 * k + 10)
        matrix = (basis.reshape(10, 16) * scale[own, None]).T
        demands.append(cp.reshape(matrix @ x[own], (4, 4), order="C") >> 0)
    loss = cp.sum_squares((R[:, :-1] * scale) @ x - R[:, -1])
    cp.Problem(cp.Minimize(loss), demands).solve(solver=cp.CLARABEL)
    return np.asarray(scale * x.value)


def identify(
    folder: Path,
    model: Any,
    basis: Array,
    triangle: bool = True,
) -> Array:
    """Text files to theta."""
    _, q, tau = read(folder, model.nv)
    return solve(*rows(model, q, tau), basis, triangle)
