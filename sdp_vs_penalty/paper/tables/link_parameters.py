"""Tables VI to IX: the 2R's kinematics; links' parameters about their centres of mass,
row by row."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pandas

from sdp_vs_penalty.estimation.build_problem import EstimationProblem
from sdp_vs_penalty.estimators import DEFAULT_METHOD
from sdp_vs_penalty.paper.tables.study import Data, Study
from sdp_vs_penalty.paper.tables.table import (
    Row,
    StudyTable,
    TableSpec,
    notes,
    register_table,
)
from sdp_vs_penalty.problem.problem import entries
from sdp_vs_penalty.problem.published import box_tables, errata
from sdp_vs_penalty.ranges.allowed import allowed_set
from sdp_vs_penalty.ranges.table import ranges_of
from sdp_vs_penalty.results.table import cell_text
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array


@register_table("VI", "two_link")
def denavit_hartenberg(study: Study) -> StudyTable:
    """Table VI: the DH table of the 2R, as printed and as the problem's kinematics has
    it.

    Rows: joints. Our columns are read back from the joint placements, not from the same
    file.
    """
    rows: list[Row] = []
    for row, joint in zip(
        study.problem.published["table_VI"], study.problem.robot.joints, strict=True
    ):
        frame = joint.link_frame  # Tz(d) Tx(a) Rx(alpha)
        a = frame[0, 3]
        alpha = np.arctan2(frame[2, 1], frame[2, 2])
        d = frame[2, 3]
        our_values = {
            "a_m_ours": float(a),
            "alpha_rad_ours": float(alpha),
            "d_m_ours": float(d),
        }
        rows.append({**row, **our_values})
    return StudyTable(
        f"Table VI: Denavit-Hartenberg parameters of {study.problem.title}",
        rows,
        ("theta_i = q_i without offset.",),
        caption="Standard (distal) convention; nothing here is simulated or measured.",
    )


def _bounds_as_printed(study: Study) -> pandas.DataFrame:
    """Return bounds and published values of all entries, by name; "*" where the paper
    does not care. Bounds alone where nothing is published."""
    published = study.problem.published
    printed = [row for name in box_tables(study.problem) for row in published[name]]
    if printed:
        rows = pandas.DataFrame(printed, dtype=object).replace("", "*")
    else:
        box = study.problem.box
        bounds = {
            "parameter": list(entries(len(box))),
            "lower": box[..., 0].ravel(),
            "upper": box[..., 1].ravel(),
            "unit": ["kg", *["m"] * 3, *["kg*m^2"] * 6] * len(box),
        }
        rows = pandas.DataFrame(bounds, dtype=object)
    return rows.set_index("parameter", drop=False)


def link_table(
    study: Study, name: str, title: str, is_in_table: Callable[[str], bool]
) -> StudyTable:
    """Build a table of link parameters about the centres of mass.

    Columns: bounds and published values as printed ("*" where the paper does not care),
    and the estimates by SDP and penalty. ``everything`` has all methods, the nominal
    robot and the truth.

    Parameters
    ----------
    study : Study
        The robot's data sets and every method's estimate, computed on demand.
    name : str
        Name of the table, such as "VIII".
    is_in_table : callable
        Whether an entry, by its name, is in the table.
    """
    rows = _bounds_as_printed(study)
    columns = [*rows.columns, *study.compared_columns]
    rows = rows[rows.index.map(is_in_table).to_numpy(bool)].assign(
        nominal=by_name(study.problem.nominal_links)
    )
    rows["true_simulated"] = by_name(study.experiment.links)
    for data in study.whole:
        for method_name, method in study.methods.items():
            rows[f"{method_name}_{data.label}"] = by_name(study.links(method, data))
    data = study.whole[-1]
    for side, values in study.once(_ends, data, tuple(rows.index)).items():
        rows[f"{side}_{data.label}"] = values
    notes_text = notes("links", method=DEFAULT_METHOD, priors=study.about_priors)
    if rows.index.str.startswith("I").any():
        notes_text += _bounds_received(study)
    for erratum in errata(study.problem):
        if erratum.cell and erratum.cell["row"] in rows.index:
            notes_text.append(
                f"{erratum.where}: printed {erratum.printed}; the other tables need "
                f"{erratum.corrected}, which true_simulated has."
            )
    table = StudyTable(
        f"Table {name}: {title} of {study.problem.title}", rows, notes_text
    )
    columns += [f"{side}_{data.label}" for side in _SIDES]
    return table.shortened([*columns, "true_simulated"])


#: Columns of what the data allow.
_SIDES = ("least", "greatest")


def _ends(study: Study, data: Data, names: tuple[str, ...]) -> dict[str, pandas.Series]:
    """Return the least and the greatest value of the entries ``names`` over all
    consistent links that fit a data set, with all constraints of the problem."""
    posed = EstimationProblem(
        study.problem,
        measurements=data.train,
        runs=None,
        regression=data.regression,
        task=study.task(data),
        weighting="noise",
    )
    theta = study.theta(DEFAULT_METHOD, data)
    allowed = allowed_set(posed, theta)
    range_by_name = {r.name: r for r in ranges_of(posed, theta, allowed, names).ranges}
    ends = {
        side: [getattr(range_by_name[name], side) for name in names] for side in _SIDES
    }
    return {
        side: pandas.Series(
            ["open" if np.isinf(end.value) else end.value for end in of_side],
            list(names),
            object,
        )
        for side, of_side in ends.items()
    }


def _bounds_received(study: Study) -> list[str]:
    """Return notes on which methods get which bounds on inertias, and what the
    others violate.
    """
    if not study.task(study.simulated).constraints.nonconvex:
        return []
    worst = []
    for data in study.whole:
        for name, method in study.methods.items():
            worst_by_family = study.task(data).constraints.worst(
                study.estimated(method, data).theta
            )
            worst.append(
                f"{name}_{data.label} {cell_text(worst_by_family['barycentric inertia'], 2)}"
            )
    return notes("bounds", worst=", ".join(worst))


def by_name(links: Array) -> pandas.Series:
    """Return the barycentric parameters of links by name.

    Parameters
    ----------
    links : (n, 10) array
        Standard parameters [kg, kg m, kg m^2].

    Returns
    -------
    Series
        m1, c1x, I1xx, ... about the centres of mass [kg, m, kg m^2]; the centre of a
        massless link is NaN.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        barycentric = inertia.barycentric_from_standard(links)
    return pandas.Series(barycentric.ravel(), list(entries(len(links))))


def _table_spec(name: str, title: str, first_letters: str, *problems: str) -> TableSpec:
    """Return the specification of a table of those link parameters whose names begin with
    one of ``first_letters``, for some problems.

    "m" is a mass, "c" a centre of mass, "I" an inertia: "mc" makes the table of masses and
    centres.
    """
    build = partial(
        link_table,
        name=name,
        title=title,
        is_in_table=lambda parameter: parameter[0] in first_letters,
    )
    return TableSpec(
        name, f"Table {name}: {title}, published and ours.", build, problems
    )


VII = _table_spec("VII", "parameters", "mcI", "two_link")
VIII = _table_spec("VIII", "masses and centres of mass", "mc")
IX = _table_spec("IX", "inertias about the centres of mass", "I")
