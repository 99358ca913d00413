"""A model's parameters as labelled frames: links, base parameters, covariances.

Columns name their unit in brackets.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.robot import inertia

if TYPE_CHECKING:
    import pandas

_INERTIA_SYMBOLS = ("Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")


def links_frame(estimate: Estimate) -> pandas.DataFrame:
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


def base_frame(estimate: Estimate) -> pandas.DataFrame:
    """Return a table with one row a base parameter, indexed by the standard parameter
    that leads it: the sum written out, value, standard deviation, 95 % interval, verdict,
    source, nominal value and unit."""
    import pandas

    base = base_rows(estimate.model, estimate.problem.independent)
    frame = pandas.DataFrame(map(vars, estimate.base_entries))
    frame = frame.rename(columns={"source": "from"}).assign(expression=base.sums)
    frame.index = pandas.Index([base.parameters[k] for k in base.leading])
    columns = [
        "expression",
        "value",
        "std",
        "lower",
        "upper",
        "verdict",
        "from",
        "nominal",
        "unit",
    ]
    return frame[columns].rename_axis("parameter")


def covariance_frame(estimate: Estimate, base: bool) -> pandas.DataFrame:
    """Return the covariance of the parameters (p, p), or of the base parameters (b, b),
    labelled by name on both sides; NaN for parameters that the data do not determine."""
    import pandas

    combinations = base_rows(estimate.model, estimate.problem.independent)
    names = combinations.parameters
    matrix = estimate.uncertainty.covariance
    if base:
        names = [names[k] for k in combinations.leading]
        factor = combinations.rows @ np.nan_to_num(estimate.uncertainty.factor)
        matrix = factor @ factor.T
    index = pandas.Index(names, name="parameter")
    return pandas.DataFrame(matrix, index, index)
