"""The sections of the report about the parameters: intervals, links, friction."""

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.uncertainty import Interval, counts
from sdp_vs_penalty.exporters.friction_table import friction_curves
from sdp_vs_penalty.exporters.links import LINK_HEADS, link_rows, seen
from sdp_vs_penalty.formatting import number
from sdp_vs_penalty.reports.markup import Material, figure, table, text
from sdp_vs_penalty.reports.plots import friction_figure


def parameters(material: Material) -> str:
    """Base and standard parameters with intervals and verdicts."""
    known = material.last.uncertainty
    base, standard = counts(known.base), counts(known.standard)
    runs = ", ".join(map(str, material.last.provenance.get("runs", []))) or "unknown runs"
    body = text(
        f"Values and 95 % intervals are those of {material.last_name}, from the runs that it was "
        f"identified from ({runs}). They hold the noise, the model's own errors as far as these runs "
        "show them and the errors of estimated shape constants; where the estimate satisfies "
        f"constraints, so do they. Of {len(known.base)} base "
        f"parameters (the combinations that torques determine) {base['identifiable']} are "
        f"identifiable, {base['weakly']} weakly, {base['not seen']} not; of {len(known.standard)} "
        f"standard parameters {standard['identifiable']}, {standard['weakly']} and "
        f"{standard['not seen']}. Parameters that are not from the data have values of the "
        "prior (the nominal robot) or of the bounds, not measured ones."
    )
    last = material.last
    base_said = {b["name"]: (b["source"], b["nominal"]) for b in last.details.get("base_parameters", [])}
    rows = [cells(i, *base_said.get(i.name, ())) for i in known.base]
    body += table(HEADS, rows, numbers_from=3)
    inner = table(HEADS, standard_rows(last), numbers_from=3)
    return f"{body}<details><summary>Standard parameters</summary>{inner}</details>"


#: What :func:`cells` says of a parameter.
HEADS = ("parameter", "verdict", "from", "value", "low", "high", "nominal", "unit")


def standard_rows(estimate: Estimate) -> list[tuple[str, ...]]:
    """Every parameter of a model as text, in the order of HEADS."""
    known = estimate.uncertainty.standard, estimate.sources, estimate.nominal
    return [cells(*of) for of in zip(*known, strict=True)]


def cells(i: Interval, source: str = "", nominal: float = np.nan) -> tuple[str, ...]:
    """A parameter, the ends of its 95 % interval, what determined it and its nominal value, as text."""
    figures = (number(seen(x), 4) for x in (i.value, i.lower, i.upper, nominal))
    return i.name, i.verdict, source, *figures, formatting.plain_unit(i.unit)


def caveats(estimate: Estimate) -> list[str]:
    """What to know before parameters are read, a sentence each; the verdict judges the links."""
    sources, said = estimate.sources, []
    if law := estimate.details.get("servo"):
        told = f"the servos' law ({law['law']}) stands for it. Scale: {law['scale']}."
        said.append(f"No torque was logged: {told}")
    if others := [source for source in sources if source != "data"]:
        told = f"{len(others)} of {len(sources)} standard parameters are from the {others[0]}"
        said.append(f"{told}, not from the data: do not read them one by one.")
    return said


def links(material: Material) -> str:
    """Mass, centre of mass and size of every link beside the nominal ones."""
    if not len(material.last.model.rigid_indices):
        return text("This model has no rigid_body effect.")
    return text(" ".join(caveats(material.last))) + table(LINK_HEADS, link_rows(material.last))


def friction(material: Material) -> str:
    """Friction by velocity with its band, a figure a joint."""
    body = text("Torque of all effects that follow the velocity alone; shaded: 95 % intervals.")
    if not (curves := friction_curves(material.last)):
        return text("The model has no friction that follows the velocity alone.")
    for c, unit in zip(curves, material.last.robot.torque_units, strict=True):
        plot = friction_figure(c.velocity, c.torque, NORMAL_95 * c.std, c.joint, unit)
        body += figure(plot, "", 250)
    return body
