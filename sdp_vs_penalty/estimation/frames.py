"""A model's parameters as labelled frames: links, base parameters, covariances.

Columns name their unit in brackets.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.uncertainty import Uncertainty
from sdp_vs_penalty.formatting import number
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot

if TYPE_CHECKING:
    import pandas


class Parameters(Protocol):
    """What a frame needs of an estimate (estimation/estimate.py)."""

    @property
    def problem(self) -> Problem:
        """Problem with the robot and its bounds."""
        ...

    @property
    def model(self) -> Model:
        """Torque model with p parameters."""
        ...

    @property
    def robot(self) -> Robot:
        """Robot of the model."""
        ...

    @property
    def links(self) -> Array:
        """(links, 10) identified standard parameters m, m c, I [SI]."""
        ...

    @property
    def nominal(self) -> Array:
        """(p,) nominal parameters; NaN for those that are no link's."""
        ...

    @property
    def sources(self) -> tuple[str, ...]:
        """(p,) what determines each parameter: data, prior, bounds or given."""
        ...

    @property
    def uncertainty(self) -> Uncertainty:
        """Intervals and covariance of the parameters."""
        ...

    @property
    def details(self) -> dict[str, Any]:
        """Further results of the method, as in model.json."""
        ...


#: A coefficient below this share of its row's largest is rounding.
_ROUNDING = 1e-9
_INERTIA_SYMBOLS = ("Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


def links_frame(estimate: Parameters) -> pandas.DataFrame:
    """Return a table of the links: mass, centre of mass, inertia, thickness.

    Parameters
    ----------
    estimate : Estimate
        Model with rigid links (ten parameters a link: m, m c (3), I (6)).

    Returns
    -------
    DataFrame
        One row a link, indexed from 1. Units stand in the columns' names. The inertia
        is about the centre of mass; "mass is from" says what determined the mass (data
        or bounds). A link without mass has NaN for centre of mass and inertia.
    """
    import pandas

    link_indices = estimate.model.rigid_indices
    mass_indices = link_indices[::10]  # a link's first parameter is its mass
    links = estimate.links  # (n links, 10)
    nominal = estimate.nominal[link_indices].reshape(-1, 10)
    # (n links, 10): mass, centre of mass (3), inertia about it (6).
    centred = np.full_like(links, np.nan)
    has_mass = links[:, 0] > 0.0
    centred[has_mass] = inertia.barycentric_from_standard(links[has_mass])
    columns = {
        "joint": [estimate.robot.tree[k].name for k in estimate.robot.link_joints],
        "mass [kg]": links[:, 0],
        "nominal mass [kg]": nominal[:, 0],
        "mass is from": [estimate.sources[k] for k in mass_indices],
    }
    for k, axis in enumerate("xyz", start=1):
        columns[f"centre of mass {axis} [m]"] = centred[:, k]
    for k, symbol in enumerate(_INERTIA_SYMBOLS, start=4):
        columns[f"{symbol} about the centre [kg m^2]"] = centred[:, k]
    mm_per_m = 1e3
    columns["thickness [mm]"] = mm_per_m * inertia.thickness(links)
    numbers = range(1, len(links) + 1)
    return pandas.DataFrame(columns, pandas.Index(numbers, name="link"))


def base_frame(estimate: Parameters) -> pandas.DataFrame:
    """Return a table with one row a base parameter.

    Base parameters are the linear combinations of standard parameters that the torque
    depends on, for example Izz1 + Iyy2 + 0.0998 m3.

    Returns
    -------
    DataFrame
        Indexed by the leading standard parameter of each combination. Columns:
        expression, value, standard deviation, ends of the 95 % interval, verdict,
        source, nominal value and unit.
    """
    import pandas

    base = base_rows(estimate.problem, estimate.model)
    names = [p.name for p in estimate.model.parameters]
    listed = estimate.details.get("base_parameters", [])
    entry_by_name = {entry["name"]: entry for entry in listed}
    rows = []
    for interval, row, leading in zip(
        estimate.uncertainty.base, base.rows, base.leading, strict=True
    ):
        entry = entry_by_name.get(interval.name, {})
        rows.append(
            {
                "parameter": names[leading],
                "expression": expression(row, names, leading),
                "value": interval.value,
                "std": interval.std,
                "lower": interval.lower,
                "upper": interval.upper,
                "verdict": interval.verdict,
                "from": entry.get("source", ""),
                "nominal": entry.get("nominal"),
                "unit": interval.unit,
            }
        )
    return pandas.DataFrame(rows).set_index("parameter")


def base_expressions(estimate: Parameters) -> list[str]:
    """Return each base parameter as a sum of standard parameters.

    Returns
    -------
    list of str
        Sums such as "Izz1 + Iyy2", in the order of the estimate's base intervals.
    """
    base = base_rows(estimate.problem, estimate.model)
    names = [p.name for p in estimate.model.parameters]
    return [
        expression(row, names, leading)
        for row, leading in zip(base.rows, base.leading, strict=True)
    ]


def expression(row: Array, names: Sequence[str], leading: int) -> str:
    """Return a linear combination of parameters as a sum, the leading parameter first.

    row : (p,) coefficients; names : (p,) names; leading : index of the leading
    parameter.

    >>> expression(np.array([0.0998, 0.0, 1.0, -1.0]), ["m3", "m4", "Izz1", "Iyy2"], 2)
    'Izz1 + 0.0998 m3 - Iyy2'
    """
    limit = _ROUNDING * float(np.abs(row).max())
    nonzero = np.flatnonzero(np.abs(row) > limit)
    others = [int(k) for k in nonzero if k != leading]
    text = ""
    for k in [leading, *others]:
        size = abs(float(row[k]))
        term = (
            names[k] if abs(size - 1.0) < _ROUNDING else f"{number(size, 4)} {names[k]}"
        )
        sign = "-" if row[k] < 0.0 else "+"
        if text:
            text += f" {sign} {term}"
        else:
            text = term if sign == "+" else f"-{term}"
    return text


def covariance_frame(estimate: Parameters) -> pandas.DataFrame:
    """Return the covariance of the parameters, labelled by name on both sides.

    Returns
    -------
    (p, p) DataFrame
        Units are products of the parameters' units; NaN for parameters that the data do
        not determine.
    """
    names = [p.name for p in estimate.model.parameters]
    return _labelled(estimate.uncertainty.covariance, names)


def base_covariance_frame(estimate: Parameters) -> pandas.DataFrame:
    """Return the covariance of the base parameters, labelled on both sides.

    Returns
    -------
    (b, b) DataFrame
        Units are products of the parameters' units.
    """
    base = base_rows(estimate.problem, estimate.model)
    names = [p.name for p in estimate.model.parameters]
    factor = base.rows @ np.nan_to_num(estimate.uncertainty.factor)
    return _labelled(factor @ factor.T, [names[k] for k in base.leading])


def _labelled(matrix: Array, names: Sequence[str]) -> pandas.DataFrame:
    """Return a square matrix as a DataFrame with the same names for rows and columns."""
    import pandas

    index = pandas.Index(list(names), name="parameter")
    return pandas.DataFrame(matrix, index, index)
