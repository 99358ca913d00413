"""What was identified: links, parameters with intervals, friction."""

from __future__ import annotations

from typing import Any

from sdp_vs_penalty.page.charts import friction_chart
from sdp_vs_penalty.page.controls import button, chart, details, note, table, tag
from sdp_vs_penalty.page.part import after_model
from sdp_vs_penalty.page.summary import ModelStep
from sdp_vs_penalty.page.view import View
from sdp_vs_penalty.page.wording import held
from sdp_vs_penalty.reports.parameters import HEADS, LINK_HEADS, cells


def _draw(view: View) -> None:
    about = view.session.current.about
    tag("p", _determined(view.session.current), "words")
    for said in about["words"]:
        tag("p", said, "words")
    with details("Links, friction and every parameter", "parameters"):
        _tables(view)


def _tables(view: View) -> None:
    about, robot = view.session.current.about, view.session.arm
    if about["links"]:
        table(LINK_HEADS, about["links"], "Links, identified and nominal", "numbers links")
    if about["friction"]:
        tag("h4", "Friction by velocity")
        view.joint = min(view.joint or 0, robot["n"] - 1)

        def options() -> dict[str, Any]:
            j = view.joint or 0
            return friction_chart(about["friction"][j], j, robot["units"][j])

        drawn = chart(options(), "Friction torque over velocity with its 95 % band")
        note("Of the joint that is chosen above; shaded: 95 %.")
        view.behind["parameters"] = lambda: drawn.update_figure(options())
    tag("h4", "Every parameter")
    note(
        "Values with 95 % intervals beside the nominal ones. Those marked prior or bounds are not "
        "measured: the data leave them open."
    )
    rows = [cells(row) for row in about["rows"]]
    with tag("div", style="tall"):
        table(HEADS, rows, "Parameters with intervals", "numbers parameters", mark=2)
    button("Copy the table", lambda: None, "copy", data_copy="table.parameters")


def _determined(model: ModelStep) -> str:
    """What decides the parameters."""
    rows = model.about["rows"]
    seen = sum(row["source"] == "data" for row in rows)
    said = f"Constraints: {held(model.violation)}; the data determine {seen} of {len(rows)} parameters"
    if model.on_bounds:
        return f"{said}; {len(model.on_bounds)} lie on their bounds."
    return f"{said}, the prior the others; torques need no more."


PARAMETERS = after_model("parameters", "Parameters", _draw)
