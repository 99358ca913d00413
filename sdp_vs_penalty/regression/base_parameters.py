"""Base parameters by name: the standard parameter each one leads with, and its whole
symbol."""

from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np
import scipy

from sdp_vs_penalty.effects import standard_effect
from sdp_vs_penalty.effects.effect import Motion, SimulatorField
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.formatting import number
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import triangular
from sdp_vs_penalty.robot.arrays import Array, Indices
from sdp_vs_penalty.robot.robot import ROUNDED_ANGLE

#: A coefficient below this share of the largest is rounding.
ROUNDING = 1e-9


def base_parameters(
    model: Model, independent: Sequence[str] | None = None
) -> tuple[Array, tuple[int, ...]]:
    """Return the structural base parameters of rigid links, pi = B theta.

    The regressor of pi is the independent columns of theta's: with Y_d = Y_b K for the
    dependent columns, pi = theta_b + K theta_d.

    Parameters
    ----------
    independent : sequence of str or None
        Names of the parameters theta_b to keep; None: the pivoting of a QR factorisation at
        random states chooses.

    Returns
    -------
    tuple
        B (b, 10 n), and the indices of theta_b.

    Raises
    ------
    InputError
        Where the named parameters are not independent.

    References
    ----------
    Gautier, Journal of Robotic Systems 1991.
    """
    robot = model.robot
    stacked = robot.random_columns
    if independent is None:
        return structure(stacked)
    rigid = [model.parameters[k].name for k in model.rigid_indices]
    for name in independent:
        if name not in rigid:
            raise InputError(
                f"base_parameters: {name!r} is no parameter of a link",
                "write names like Izz1",
            )
    return structure(stacked, tuple(rigid.index(name) for name in independent))


@dataclass(frozen=True)
class BaseParameters:
    """What makes torque of a whole model: base parameters of the links first, then
    every other parameter."""

    #: (b, p) combinations of theta (p,).
    rows: Array
    #: Names of the p parameters.
    parameters: list[str]
    #: Indices of the parameters that lead the b combinations.
    leading: list[int]

    @property
    def names(self) -> list[str]:
        """Names of the combinations: "Izz1 + ..." of a sum, "f_v3" of one parameter."""
        return [
            self.parameters[k] + (" + ..." if np.count_nonzero(row) > 1 else "")
            for row, k in zip(self.rows, self.leading, strict=True)
        ]

    @property
    def sums(self) -> list[str]:
        """The combinations written out, the leading parameter first: "Izz1 + 0.0998 m3 -
        Iyy2"; what is a share of ROUNDING of the largest coefficient is left out."""
        return [
            self._written_out(row, k)
            for row, k in zip(self.rows, self.leading, strict=True)
        ]

    def _written_out(self, row: Array, leading: int) -> str:
        """Return one combination (p,), whose leading coefficient is 1, as a sum."""
        text = self.parameters[leading]
        size = np.abs(row)
        for k in np.flatnonzero(size > ROUNDING * size.max()):
            if k != leading:
                is_one = abs(size[k] - 1.0) < ROUNDING
                term = "" if is_one else f"{number(size[k], 4)} "
                text += f" {'-' if row[k] < 0.0 else '+'} {term}{self.parameters[k]}"
        return text


def base_rows(model: Model, independent: Sequence[str] | None) -> BaseParameters:
    """Return the base parameters of a model: combinations of theta that make torque.

    Those of the links come first, with the names that the problem gives them, then
    every other parameter by itself.

    Parameters
    ----------
    independent : sequence of str or None
        Names of the links' base parameters, as for :func:`base_parameters`.

    Returns
    -------
    BaseParameters
        Coefficients (b, p), names, and the leading standard parameters.
    """
    # Combinations of the links' parameters (``link_indices`` in theta), then the rest.
    matrix, link_indices, lead = _rigid_base(model, independent)
    p = len(model.parameters)
    others = np.setdiff1d(np.arange(p), link_indices)
    unit = np.eye(p)
    rows = np.vstack([matrix @ unit[link_indices], unit[others]])
    leading = [*(int(link_indices[k]) for k in lead), *others.tolist()]
    return BaseParameters(rows, [q.name for q in model.parameters], leading)


def _rigid_base(
    model: Model, independent: Sequence[str] | None
) -> tuple[Array, Indices, Sequence[int]]:
    """Return the base parameters of the links and of effects that act like links.

    A rotor acts like inertia of the first links, so their common combinations count.
    Returns B (b, k): combinations of k parameters that the torque depends on; the
    indices (k,) of these parameters in theta; and which of the k lead the combinations.
    """
    rigid = model.rigid_indices
    if not len(rigid):
        return np.zeros((0, 0)), rigid, ()
    present = {e.simulator_field for e in model.effects}
    # A rotor acts like inertia of the first links, an offset like the weight of a link
    # that slides upright: their common combinations are what counts.
    merged: set[SimulatorField] = {"armature"}
    if "m" in model.robot.position_units:
        merged.add("offset")
    if present & merged:
        return _merged_base(model, {"links", *merged})
    try:
        matrix, lead = base_parameters(model, independent)
    except InputError:  # the list was made for another direction of gravity
        matrix, lead = base_parameters(model)
    return matrix, rigid, lead


def _merged_base(
    model: Model, fields: Set[SimulatorField]
) -> tuple[Array, Indices, Sequence[int]]:
    """Return the base parameters of all effects with one of the fields together.

    The result is as that of :func:`_rigid_base`, with the k parameters of these effects.
    Columns that are dependent at random states are dependent.
    """
    effects = tuple(e for e in model.effects if e.simulator_field in fields)
    merged = Model(model.robot, effects)
    names = [p.name for p in model.parameters]
    indices = np.array([names.index(p.name) for p in merged.parameters])
    q, dq, ddq = merged.robot.random_states
    # None of these effects depends on the time.
    motion = Motion(np.zeros(len(q)), q, dq, ddq)
    columns = merged.dense_columns(motion)
    # The rows of a state, one a joint, behind each other.
    stacked = np.swapaxes(columns, 0, 1).reshape(-1, len(indices))
    # Norms fall by less than columns differ, but by more than rounding: among equal
    # columns the first one leads, so that links lead before rotors and offsets.
    preference = np.linspace(1.0, 1.0 - 1e-4, len(indices))
    matrix, lead = structure(stacked, preference=preference)
    return matrix, indices, lead


def structure(
    stacked: Array,
    leading: tuple[int, ...] | None = None,
    preference: Array | float = 1.0,
) -> tuple[Array, tuple[int, ...]]:
    """Return B with Y = Y_lead B, and the independent columns Y_lead of Y.

    Angles that are rounded in a robot's file (1.5708) tilt axes that are parallel. Columns
    that are zero or dependent but for that count as zero or dependent: no torque shows
    them.

    Parameters
    ----------
    stacked : (N, k) array
        Columns Y of parameters, at many states.
    leading : tuple of int, optional
        Independent columns to use; default: those that a pivoted QR chooses.
    preference : float or (k,) array
        Norms of the columns in that choice: among dependent columns the larger one
        leads.

    Returns
    -------
    (b, k) array
        B, small entries set to zero.
    tuple of int
        Indices of the independent columns.

    Raises
    ------
    InputError
        If the named columns are not independent, or not as many as the rank.
    """
    # A triangle: the same inner products, in as many rows as columns.
    stacked = triangular([stacked])
    norms = np.linalg.norm(stacked, axis=0)
    is_zero = norms <= ROUNDED_ANGLE * norms.max()
    unit = stacked / np.where(is_zero, 1.0, norms)
    scaled = np.where(is_zero, 0.0, unit) * preference
    # The first ``rank`` pivots are independent columns; the diagonal falls.
    _, r, pivots = scipy.linalg.qr(scaled, mode="economic", pivoting=True)
    rank = int(np.sum(np.abs(np.diagonal(r)) > ROUNDED_ANGLE * abs(r[0, 0])))
    if leading is None:
        leading = tuple(sorted(int(k) for k in pivots[:rank]))
    elif (
        len(leading) != rank
        or np.linalg.matrix_rank(scaled[:, leading], tol=ROUNDED_ANGLE) != rank
    ):
        raise InputError(
            f"base_parameters: the {len(leading)} named are not the robot's {rank}"
            " independent ones",
            "leave the list out to let the program choose",
        )
    # Y = Y_lead B by least squares.
    fitted = np.linalg.lstsq(stacked[:, leading], stacked, rcond=None)[0]
    dependence = np.asarray(fitted, float)
    dependence[np.abs(dependence) < 1e-10] = 0.0
    return dependence, leading


def base_parameter_symbols(problem: Problem) -> dict[str, str]:
    """Return each base parameter of the links as a sum of standard ones, such as "Izz2 -
    0.64 m2", by the name of the leading one."""
    links = problem.model(standard_effect("links").name)
    base = base_rows(links, problem.independent)
    return dict(zip([base.parameters[k] for k in base.leading], base.sums, strict=True))
