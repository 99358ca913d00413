"""A log to a physically consistent estimate, as an ordinary script in this field:
decimate, then CVXPY.

    python cvxpy_script.py RUN.csv ARM.urdf

Positions and torques pass zero-phase Butterworth filters, every 28th sample is kept,
Pinocchio gives its regressor, CVXPY minimises the squared residual subject to positive
semidefinite pseudo-inertias and signs. No bounds, no weights, no certificate, no
intervals, and columns do not pass the filter of the torque.
"""

import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import signal

Array = NDArray[np.float64]

#: Rate to which the text files are resampled [Hz].
RATE_HZ = 1000.0
#: Samples a row: about as many rows as the program keeps of the Panda's log.
DECIMATION = 28
#: Samples that are dropped at either end.
MARGIN = 500
#: Cut-off frequencies of positions and torques [Hz], and the filters' order.
POSITION_CUTOFF_HZ, TORQUE_CUTOFF_HZ, ORDER = 5.0, 8.0, 4
#: Velocity over which the sign of Coulomb friction turns [rad/s].
SIGN_WIDTH = 0.01


class Rows(NamedTuple):
    """Filtered, decimated rows: t (M,) [s], states (M, n) and torque (M, n) [N m]."""

    t: Array
    states: tuple[Array, Array, Array]
    tau: Array


def read_rows(folder: Path, joints: int) -> Rows:
    """Read the authors' text files, filter and decimate."""
    names = ("time", "positions", "torques")
    t, *channels = (np.loadtxt(folder / f"exciting_traj_{name}.txt") for name in names)
    return filtered_rows(t, *(channel.reshape(-1, joints) for channel in channels))


def filtered_rows(
    t: Array,
    q: Array,
    tau: Array,
    decimation: int = DECIMATION,
    cutoffs: tuple[float, float] = (POSITION_CUTOFF_HZ, TORQUE_CUTOFF_HZ),
) -> Rows:
    """Resample positions and torques (N, n), filter at cutoffs [Hz] and decimate."""
    grid = np.arange(t[0], t[-1], 1.0 / RATE_HZ)
    q, tau = (
        np.column_stack([np.interp(grid, t, x) for x in channel.T])
        for channel in (q, tau)
    )
    q = low_pass(q, cutoffs[0])
    dq = np.gradient(q, 1.0 / RATE_HZ, axis=0)
    ddq = np.gradient(dq, 1.0 / RATE_HZ, axis=0)
    keep = slice(MARGIN, len(grid) - MARGIN, decimation)
    tau = low_pass(tau, cutoffs[1])
    return Rows(grid[keep], (q[keep], dq[keep], ddq[keep]), tau[keep])


def low_pass(x: Array, cutoff_hz: float) -> Array:
    """Filter columns forwards and backwards."""
    b, a = signal.butter(ORDER, cutoff_hz / (RATE_HZ / 2.0))
    return signal.filtfilt(b, a, x, axis=0)


def columns(
    model: Any, q: Array, dq: Array, ddq: Array, *, with_rotors: bool = False
) -> Array:
    """Y (M, n, 13 n): rigid body, viscous, Coulomb, offset; n more for rotors."""
    data = model.createData()
    n = q.shape[1]
    stack = []
    for x, dx, ddx in zip(q, dq, ddq, strict=True):
        rigid = pin.computeJointTorqueRegressor(model, data, x, dx, ddx).copy()
        friction = [np.diag(dx), np.diag(np.tanh(dx / SIGN_WIDTH)), np.eye(n)]
        rotors = [np.diag(ddx)] if with_rotors else []
        stack.append(np.hstack([rigid, *friction, *rotors]))
    return np.array(stack)


def solve(
    y: Array,
    tau: Array,
    basis: Array,
    triangle: bool = True,
    nominal: Array | None = None,
    weight: float = 0.0,
) -> Array:
    """theta (p,) of least squares with positive semidefinite pseudo-inertias, friction
    and rotors >= 0.

    y (M, n, p) as of `columns`, tau (M, n); basis (10, 4, 4) : of the pseudo-inertia. Columns are
    scaled to unit length: without that Clarabel's answer is wrong. triangle : CVXPY gets
    the rows' R factor, else the rows themselves. nominal (links, 10) : links to which each
    is pulled by weight times the divergence tr(P0^-1 P) - log det P.
    """
    import cvxpy as cp

    links = y.shape[1]
    rows = np.column_stack([y.reshape(-1, y.shape[2]), tau.ravel()])
    if triangle:
        rows = np.linalg.qr(rows, mode="r")
    norms = np.linalg.norm(rows[:, :-1], axis=0)
    scale = 1.0 / np.maximum(norms, 1e-6 * norms.max())
    x = cp.Variable(y.shape[2])
    friction, rotors = slice(10 * links, 12 * links), slice(13 * links, None)
    demands: list[Any] = [x[friction] >= 0, x[rotors] >= 0]
    loss = cp.sum_squares((rows[:, :-1] * scale) @ x - rows[:, -1])
    for k in range(links):
        link = slice(10 * k, 10 * k + 10)
        root = np.eye(4)
        if nominal is not None:  # in units of the nominal link: P0 = 1
            root = np.linalg.inv(
                np.linalg.cholesky(np.tensordot(nominal[k], basis, axes=1))
            )
        moved = root @ basis @ root.T
        matrix = (moved.reshape(10, 16) * scale[link, None]).T
        pseudo_inertia = cp.reshape(matrix @ x[link], (4, 4), order="C")
        demands.append(pseudo_inertia >> 0)
        if nominal is not None:
            loss += weight * (cp.trace(pseudo_inertia) - cp.log_det(pseudo_inertia))
    cp.Problem(cp.Minimize(loss), demands).solve(solver=cp.CLARABEL)
    return np.asarray(scale * x.value)


def pseudo_inertia_basis() -> Array:
    """Return (10, 4, 4): the pseudo-inertia of a unit of each parameter of a link, in
    Pinocchio's order."""
    basis = np.zeros((10, 4, 4))
    basis[0, 3, 3] = 1.0
    basis[1 + np.arange(3), np.arange(3), 3] = 1.0
    basis[1 + np.arange(3), 3, np.arange(3)] = 1.0
    for k, (i, j) in enumerate([(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)], 4):
        inertia = np.zeros((3, 3))
        inertia[i, j] = inertia[j, i] = 1.0
        basis[k, :3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    return basis


def main(log: str, urdf: str) -> None:
    """Estimate an arm from a log with columns t, q1 .. and tau1 .. ."""
    import pandas

    arm = pin.buildModelFromUrdf(urdf)
    table = pandas.read_csv(log)
    q, tau = (
        table[[f"{name}{j + 1}" for j in range(arm.nv)]].to_numpy()
        for name in ("q", "tau")
    )
    rows = filtered_rows(table["t"].to_numpy(), q, tau)
    print(solve(columns(arm, *rows.states), rows.tau, pseudo_inertia_basis()))


if __name__ == "__main__":
    main(*sys.argv[1:])
