"""Instrumental variables as an ordinary regression: the noise of the regressor leaves
the estimate.

With columns Z that share the signal of the columns X of tau = X theta + error and not
their noise, the estimate solves Z'(tau - X theta^) = 0 (Young 2011, ch. 7; Janot,
Vandanjon, Gautier, IEEE Trans. Control Systems Technology 2014). In

    tau^ = tau - X theta^ + Z theta^,     min |tau^ - Z theta|^2

it is the minimiser, the residual there is that of tau = X theta^, and the scores are
the instruments': the rows [Z, tau^] are a regression like any other. Constraints,
weights, intervals and cross-validation need not know; the problem stays convex. tau^ is
linear in the compressed rows [Z, X, tau].

A servo's error e = q_cmd - q has a second instrument. In kp e = L theta every residual
becomes smaller where kp and theta do: least squares shrink the joints that others
hardly feel to nothing, whatever is left is noise or the model's error. The instrument
of e is therefore the error that the model itself makes, e^ = L theta^ / kp^: in [e^, L]
the direction (kp^, theta^) is empty, and what remains are the normal equations of |e -
L theta / kp|^2, where a scale changes nothing.

With torque logged the command itself is the motion of the instruments: the controller
brings the noise of q into the motion, not into the command. How well a loop follows
decides only how much they tell.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.model import JointColumns, Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array, Indices
from sdp_vs_penalty.signals.filtered import FilteredRun, Rows


class _Instrumented(NamedTuple):
    """One joint's rows in one block, with their instruments."""

    #: The joint, from 0.
    joint: int
    #: (k,) the parameters of Z and X.
    indices: Indices
    #: (r, k + 1) instruments and the torque beside them, [Z, tau_Z].
    simulated: Array
    #: (r, k + 1) regressor and torque, [X, tau]; tau differs from tau_Z where
    #: parameters are known.
    measured: Array


def commanded_motion(measured: Measurements) -> Measurements:
    """Return a log whose command is the motion "qsim", on which instruments are
    computed.

    Returns
    -------
    Measurements
        With "qsim" among the commanded motions.

    Raises
    ------
    InputError
        For a log without commands.
    """
    if "qcmd" not in measured.commanded:
        raise InputError(
            "--instruments command: this log holds no commands",
            "log qcmd1..qcmdn, or leave the instruments out",
            measured.names[0],
        )
    commanded = {**measured.commanded, "qsim": measured.commanded["qcmd"]}
    return replace(measured, commanded=commanded)


def free_rows(run: FilteredRun, model: Model) -> Iterator[Rows]:
    """Yield the rows of a run for what is free of a model: without the torque of its
    known parameters, whose columns are zero."""
    for rows in run.rows(model):
        columns, torque = model.without_known(rows.columns, rows.torque)
        yield replace(rows, columns=columns, torque=torque)


def instrumented_rows(run: FilteredRun, model: Model) -> Iterator[Rows]:
    """Yield the rows of a run with the columns of its simulated motion before them.

    Each joint's columns are [Z, tau_Z, X]: Z and tau_Z on the simulated motion "qsim",
    X on the measured one. Indices of Z count behind those of the p parameters; tau_Z
    has the index 2 p.

    Parameters
    ----------
    run : FilteredRun
        Run with a simulated motion "qsim".
    """
    p = len(model.parameters)
    measured = free_rows(run, model)
    simulated = free_rows(run.simulated, model)
    for rows, simulated_rows in zip(measured, simulated, strict=True):
        columns_of_joints = []
        for j, x in enumerate(rows.columns):
            z = simulated_rows.columns[j]
            indices = np.concatenate([z.indices + p, [2 * p], x.indices])
            columns = np.column_stack(
                [z.columns, simulated_rows.torque[:, j], x.columns]
            )
            columns_of_joints.append(JointColumns(indices, columns))
        yield replace(rows, columns=columns_of_joints)


def instrumented(
    model: Model, factors: Sequence[tuple[int, Indices, Array]]
) -> list[tuple[Indices, Array]]:
    """Return rows [Z, tau^] whose least squares are the instrumental-variable estimate.

    X are the regressor's columns on the measured motion, Z those on a simulated motion
    without noise. With the estimate theta^, tau^ = tau - X theta^ + Z theta^.

    Parameters
    ----------
    factors : sequence of (joint, indices, rows)
        Joint, parameters of the columns, and rows of each factor.

    Returns
    -------
    list of ((k,), (r, k + 1)) arrays
        Parameters and rows of each factor.
    """
    p = len(model.parameters)
    parts = []
    for joint, indices, rows in factors:
        # Rows are [Z, tau_Z, X, tau], indices of Z beyond p; or [X, tau], where the
        # columns are their own instruments.
        k = len(indices)
        if np.any(indices >= p):
            k = k // 2
        simulated = rows[:, : k + 1]
        measured = rows[:, -k - 1 :]
        parts.append(_Instrumented(joint, indices[-k:], simulated, measured))
    instruments, theta = _estimate(model, parts)
    rows_by_factor = []
    for part, Z in zip(parts, instruments, strict=True):
        X, tau = part.measured[:, :-1], part.measured[:, -1]
        torque = tau + (Z - X) @ theta[part.indices]  # tau^ = tau - X theta^ + Z theta^
        rows_by_factor.append((part.indices, np.column_stack([Z, torque])))
    return rows_by_factor


def _squared_residuals(
    model: Model, parts: Sequence[_Instrumented], theta: Array
) -> Array:
    """Return (n,) the squared residual |X theta - tau|^2 of each joint's torque."""
    squares = np.zeros(model.robot.n)
    for part in parts:
        modelled = part.measured[:, :-1] @ theta[part.indices]
        squares[part.joint] += np.sum((modelled - part.measured[:, -1]) ** 2)
    return squares


def _instruments_of(part: _Instrumented, model: Model, theta: Array | None) -> Array:
    """Return the instruments Z (r, k) of a part: columns without the sensors' noise.

    They are the columns on the simulated motion, with one exception: a servo's control
    error e is measured with noise. Its instrument is the error that a model theta (p,)
    without noise would have, e^ = (tau - L theta) / kp, with L all other columns.
    Without ``theta`` the columns stay as they are.
    """
    Z = part.simulated[:, :-1]
    gain = model.error_gains[part.joint]  # index of kp in theta
    places = np.flatnonzero(part.indices == gain)
    if theta is None or not len(places):  # no servo on this joint
        return Z
    k = places[0]
    if not np.any(Z[:, k]) or theta[gain] <= 0.0:  # no error, or no usable gain
        return Z
    coefficients = theta[part.indices]
    coefficients[k] = 0.0
    torque_of_error = part.simulated[:, -1] - Z @ coefficients
    Z = Z.copy()
    Z[:, k] = torque_of_error / theta[gain]
    return Z


def _estimate(
    model: Model, parts: Sequence[_Instrumented]
) -> tuple[list[Array], Array]:
    """Return the instruments Z of each part, and the estimate theta^ (p,) with them.

    Joint weights are inverse squared residuals, and the instrument of a servo's control
    error depends on theta^: four rounds settle both. Known parameters count zero, since
    their torque is no part of the rows.
    """
    theta = model.reference if model.drives.any() else None
    squares = np.ones(model.robot.n)
    if theta is not None:
        squares = _squared_residuals(model, parts, theta)
    for _ in range(4):
        instruments = [_instruments_of(part, model, theta) for part in parts]
        largest = float(squares.max()) or 1.0
        weights = 1.0 / np.maximum(squares, 1e-12 * largest)
        solution = _solution(len(model.parameters), parts, instruments, weights)
        theta = model.with_known(solution)
        squares = _squared_residuals(model, parts, theta)
    solution[list(model.known_values)] = 0.0
    return instruments, solution


def _solution(
    p: int, parts: Sequence[_Instrumented], instruments: Sequence[Array], weights: Array
) -> Array:
    """Solve the instrumental-variable equations Z^T W (tau - X theta) = 0 for theta
    (p,).

    W holds ``weights`` (n,) of the joints, their inverse squared residuals. Directions
    of theta in which the instruments Z are zero up to rounding stay zero.
    """
    # Sums over all rows; X holds the torque as last column.
    ZtZ = np.zeros((p, p))
    ZtX = np.zeros((p, p))
    Zt_tau = np.zeros(p)
    for part, Z in zip(parts, instruments, strict=True):
        weighted = weights[part.joint] * Z.T
        place = np.ix_(part.indices, part.indices)
        ZtZ[place] += weighted @ Z
        ZtX[place] += weighted @ part.measured[:, :-1]
        Zt_tau[part.indices] += weighted @ part.measured[:, -1]
    # Directions V that the instruments determine, from Z^T Z with unit columns.
    norms = np.sqrt(np.diag(ZtZ))
    used = np.flatnonzero(norms > 1e-10 * norms.max(initial=0.0))
    of_used = np.ix_(used, used)
    at_unit_norm = ZtZ[of_used] / np.outer(norms[used], norms[used])
    eigenvalues, vectors = np.linalg.eigh(at_unit_norm)
    # Where combinations of the instruments' columns are shorter than 1e-6, noise of X
    # alone would decide.
    is_determined = eigenvalues > 1e-6**2 * eigenvalues.max(initial=0.0)
    V = vectors[:, is_determined] / norms[used, None]
    # theta = V x with V^T Z^T X V x = V^T Z^T tau.
    projected = V.T @ ZtX[of_used] @ V
    x = np.linalg.lstsq(projected, V.T @ Zt_tau[used], rcond=None)[0]
    solution = np.zeros(p)
    solution[used] = V @ x
    return solution
