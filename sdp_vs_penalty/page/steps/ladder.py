"""The error of every joint from model to model, and one step back."""

from __future__ import annotations

from functools import partial
from typing import Any

from sdp_vs_penalty.diagnosis.show import risen
from sdp_vs_penalty.page.charts import ladder_chart
from sdp_vs_penalty.page.controls import button, chart, details, note, table, tag
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.step import Verdict, after_model
from sdp_vs_penalty.page.view import View
from sdp_vs_penalty.page.wording import change, figure


def _draw(view: View) -> None:
    session = view.session
    ladder, units = session.ladder, session.arm["units"]
    with tag("ol", style="rungs"):
        for model in ladder:
            with tag("li"):
                tag("strong", model.label)
                relative = figure(model.comparison["relative_error_percent"])
                tag("span", f"{relative} % relative error, {model.parameters} parameters", "soft")
    _all_models(view)
    if len(ladder) == 1:
        note("Add what is missing and watch the error of each joint fall here.")
        return
    button("Undo the last step", session.undo, "undo")
    errors = [model.comparison["rmse"] for model in ladder]
    floor = ladder[-1].comparison["noise_floor"]
    names = [m.label for m in ladder]
    chart(ladder_chart(names, errors, units, floor), "Error of each joint over its noise")
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
    note(f"RMS error on {judged}.")


def _all_models(view: View) -> None:
    """Those that have left the ladder too, each to be gone on from."""
    session = view.session
    left = [m for m in session.models if m not in session.ladder]
    if not left:
        return
    with (
        details(f"Other models of this session ({len(left)})", "other-models"),
        tag("div", style="wide"),
        tag("table", style="numbers"),
    ):
        tag("caption", "Other models of this session", "unseen")
        with tag("thead"), tag("tr"):
            for heading in ("model", "method", "parameters", "error", "judged on", ""):
                tag("th", heading, scope="col")
        with tag("tbody"):
            for k, m in enumerate(left):
                with tag("tr"):
                    tag("th", m.label, scope="row")
                    error = f"{figure(m.comparison['relative_error_percent'])} %"
                    for cell in (m.method, str(m.parameters), error, ", ".join(m.judged_on)):
                        tag("td", cell)
                    with tag("td"):
                        button("Go on from it", partial(session.take_up, m), f"take-up-{k}")


def _verdict(session: Session) -> Verdict | None:
    if len(session.ladder) == 1:
        return None
    first, last = (
        session.ladder[k].comparison["relative_error_percent"] for k in (0, len(session.ladder) - 1)
    )
    level: Any = "good" if last < first else "usable"
    said = f"{figure(first)} % relative error became {figure(last)} % ({change(first, last)})"
    said += f" on {', '.join(session.ladder[-1].judged_on)}."
    before = session.ladder[-2].comparison["relative_error_percent"]
    if not last < before:
        said += " The last step did not pay on all joints together: undo it, or look at its joint."
    elif worse := risen(*(rung.comparison["rmse"] for rung in session.ladder[-2:])):
        said += f" {worse}"
    return Verdict(level, said)


LADDER = after_model(
    "ladder", "The falling error", _draw, _verdict, lambda s: [m.file for m in s.models]
)
