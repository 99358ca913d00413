"""Step 6: the error of every joint from model to model, and one step back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sdp_vs_penalty.page.charts import ladder_chart
from sdp_vs_penalty.page.controls import button, chart, table, tag
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.step import Step, Verdict
from sdp_vs_penalty.page.wording import change, figure

if TYPE_CHECKING:
    from sdp_vs_penalty.page.view import View


def _depends(session: Session) -> Any:
    return [model.file for model in session.ladder]


def _draw(view: View) -> None:
    session, robot = view.session, view.session.robot
    assert robot is not None
    ladder, units = session.ladder, robot["units"]
    with tag("ol", style="rungs"):
        for model in ladder:
            with tag("li"):
                tag("strong", model.label)
                relative = figure(model.comparison["relative_error_percent"])
                tag("span", f"{relative} % relative error, {model.parameters} parameters", "soft")
    if len(ladder) == 1:
        tag("p", "Add a finding above and watch the error of each joint fall here.", "soft")
        return
    button("Undo the last step", session.undo, "undo")
    errors = [model.comparison["rmse"] for model in ladder]
    chart(ladder_chart([m.label for m in ladder], errors, units), "Error of each joint")
    floor = ladder[-1].comparison["noise_floor"]
    rows = [
        [
            f"{j + 1} [{unit}]",
            *(figure(e[j]) for e in errors),
            change(errors[0][j], errors[-1][j]),
            figure(floor[j]),
        ]
        for j, unit in enumerate(units)
    ]
    heads = ["joint", *(str(k) for k in range(1, len(ladder) + 1)), "change", "noise"]
    table(heads, rows, "RMS error of each joint, model by model", "numbers ladder")
    judged = ", ".join(ladder[-1].judged_on)
    tag("p", f"RMS error on {judged}.", "soft")


def _verdict(session: Session) -> Verdict | None:
    if len(session.ladder) == 1:
        return None
    first, last = (
        session.ladder[k].comparison["relative_error_percent"] for k in (0, len(session.ladder) - 1)
    )
    level: Any = "good" if last < first else "usable"
    said = f"{figure(first)} % relative error became {figure(last)} % ({change(first, last)})"
    return Verdict(level, f"{said} on {', '.join(session.ladder[-1].judged_on)}.")


LADDER = Step(
    "ladder",
    "The falling error",
    "Identify a model first.",
    lambda session: session.model is not None,
    _depends,
    _draw,
    _verdict,
)
