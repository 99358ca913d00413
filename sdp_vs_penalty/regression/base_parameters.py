"""Base parameters by name: the standard parameter each one leads with, and its whole
symbol."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import triangular
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.inertia import parameter_names


def base_parameters(
    model: Model, independent: Sequence[str] | None = None
) -> tuple[Array, tuple[int, ...]]:
    """Structural base parameters of a robot with rigid links: pi = B theta.

    The regressor of pi is the independent columns of theta's: with Y_d = Y_b K for the
    dependent columns, pi = theta_b + K theta_d.

    Parameters
    ----------
    model : Model
        The torque model.
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
    """What makes torque of a whole model: rows (b, p) of combinations of theta (p,),
    base parameters of the links first, then every other parameter; their names, and the
    parameters that lead them."""

    rows: Array
    names: list[str]
    leading: list[int]


def base_rows(problem: Problem, model: Model) -> BaseParameters:
    """The base parameters of a model, those of the links with the names that the
    problem gives them.

    Parameters
    ----------
    problem : Problem
        Gives the links' base parameters their names.
    model : Model
        With its effects.

    Returns
    -------
    BaseParameters
        Rows, names and leading parameters.
    """
    matrix, places, lead = _rigid_base(problem, model)
    p = len(model.parameters)
    others = np.setdiff1d(np.arange(p), places)
    unit = np.eye(p)
    rows = np.vstack(
        [
            matrix @ unit[places],
            unit[others],
        ]
    )
    leading = [
        *(int(places[k]) for k in lead),
        *others.tolist(),
    ]
    names = []
    for row, k in zip(rows, leading, strict=True):
        is_sum = np.count_nonzero(row) > 1
        names.append(model.parameters[k].name + (" + ..." if is_sum else ""))
    return BaseParameters(rows, names, leading)


def _rigid_base(
    problem: Problem, model: Model
) -> tuple[Array, NDArray[np.intp], Sequence[int]]:
    """B (b, k) of the links' parameters and of those that act like them; where these k
    stand in theta; which of them lead."""
    rigid = model.rigid_indices
    if not len(rigid):
        return np.zeros((0, 0)), rigid, ()
    present = {e.name for e in model.effects}
    # A rotor acts like inertia of the first links, an offset like the weight of a link
    # that slides upright: their common combinations are what counts.
    merged = {"rotor_inertia"}
    if "m" in model.robot.position_units:
        merged.add("torque_offset")
    if present & merged:
        return _merged_base(model, ("rigid_body", *merged))
    try:
        matrix, lead = base_parameters(model, problem.independent)
    except InputError:  # the list was made for another direction of gravity
        matrix, lead = base_parameters(model)
    return matrix, rigid, lead


def _merged_base(
    model: Model, effects: Sequence[str]
) -> tuple[Array, NDArray[np.intp], Sequence[int]]:
    """:func:`_rigid_base` of all parameters of some effects together."""
    part = Model(model.robot, tuple(e for e in model.effects if e.name in effects))
    names = [p.name for p in model.parameters]
    places = np.array([names.index(q.name) for q in part.parameters])
    states = part.robot.random_states
    motion = Motion(np.zeros(len(states[0])), *states)
    columns = part.dense_columns(motion)
    stacked = np.swapaxes(columns, 0, 1).reshape(-1, len(places))
    # Of columns that stand for each other the first leads, whatever rounding says:
    # links first.
    preference = np.linspace(1.0, 1.0 - 1e-4, len(places))
    matrix, lead = structure(stacked, preference=preference)
    return matrix, places, lead


def structure(
    stacked: Array,
    leading: tuple[int, ...] | None = None,
    preference: Array | float = 1.0,
) -> tuple[Array, tuple[int, ...]]:
    """B and the independent columns of stacked ones.

    Parameters
    ----------
    stacked : (N, k) array
        Columns, in as many rows as there are.
    leading : tuple of int, optional
        The independent columns; default: what a pivoted QR chooses.
    preference : float or (k,) array
        Norms of the columns in that choice.

    Returns
    -------
    (b, k) array
        B, with which the columns are those of ``leading`` times B.
    tuple of int
        The independent columns.

    Raises
    ------
    InputError
        For columns named that are not independent.
    """
    # The same columns' lengths and angles, in as many rows as columns.
    stacked = triangular([stacked])
    norms = np.linalg.norm(stacked, axis=0)
    unseen = norms <= 1e-10 * norms.max()
    unit = stacked / np.where(unseen, 1.0, norms)
    scaled = np.where(unseen, 0.0, unit) * preference
    _, r, pivots = scipy.linalg.qr(
        scaled,
        mode="economic",
        pivoting=True,
    )
    rank = int(np.sum(np.abs(np.diagonal(r)) > 1e-9 * abs(r[0, 0])))
    if leading is None:
        leading = tuple(sorted(int(k) for k in pivots[:rank]))
    elif (
        len(leading) != rank
        or np.linalg.matrix_rank(scaled[:, leading], tol=1e-9) != rank
    ):
        raise InputError(
            f"base_parameters: the {len(leading)} named are not the robot's {rank}"
            " independent ones",
            "leave the list out to let the program choose",
        )
    dependence = np.asarray(
        np.linalg.lstsq(stacked[:, leading], stacked, rcond=None)[0], float
    )
    dependence[np.abs(dependence) < 1e-10] = 0.0
    return dependence, leading


def base_parameter_symbols(problem: Problem) -> dict[str, str]:
    """Each base parameter written out in standard parameters, "Izz2 - 0.64 m2", by the
    independent one (Izz1, mx2, ...) that leads it.

    Parameters
    ----------
    problem : Problem
        Of the robot.

    Returns
    -------
    dict of str to str
        A sum in words, by the parameter that leads it.
    """
    base, independent = base_parameters(
        problem.model("rigid_body"), problem.independent
    )
    rigid = [
        name
        for link in range(1, problem.robot.links + 1)
        for name in parameter_names(link)
    ]
    return {
        rigid[lead]: _written_out(row, rigid, lead)
        for row, lead in zip(base, independent, strict=True)
    }


def _written_out(
    row: Array,
    names: Sequence[str],
    lead: int,
) -> str:
    """A linear function (k,) of named parameters, the leading one first."""
    description = names[lead]
    for k, (value, name) in enumerate(zip(row, names, strict=True)):
        if k == lead or not value:
            continue
        sign = " + " if value > 0.0 else " - "
        size = "" if abs(abs(value) - 1.0) < 1e-9 else f"{abs(value):.4g} "
        description += f"{sign}{size}{name}"
    return description
