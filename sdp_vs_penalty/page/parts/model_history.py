"""The error of every joint from model to model, and one step back."""

from __future__ import annotations

from functools import partial

import numpy as np

from sdp_vs_penalty.estimation.verdict import changes
from sdp_vs_penalty.page.charts import history_chart
from sdp_vs_penalty.page.controls import button, chart, details, note, table, tag
from sdp_vs_penalty.page.part import Verdict, after_model
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.view import View
from sdp_vs_penalty.page.wording import change, figure


def _draw(view: View) -> None:
    session = view.session
    history, units = session.history, session.arm["units"]
    with tag("ol", style="history"):
        for model in history:
            with tag("li"):
                tag("strong", model.label)
                relative = figure(model.comparison["relative_error_percent"])
                tag("span", f"{relative} % relative error, {model.parameters} parameters", "soft")
    _all_models(view)
    with tag("div", style="row"):
        if len(history) > 1:
            button("Undo the last step", session.undo, "undo")
        if session.undone:
            button(f"Redo {session.undone[-1].label}", session.redo, "redo")
    if len(history) == 1:
        note("Add what is missing and watch the error of each joint fall here.")
        return
    errors = [model.comparison["rmse"] for model in history]
    floor = history[-1].comparison["noise_floor"]
    names = [m.label for m in history]
    chart(history_chart(names, errors, units, floor), "Error of each joint over its noise")
    rows = [
        [
            f"{j + 1} [{unit}]",
            *(figure(e[j]) for e in errors),
            change(errors[0][j], errors[-1][j]),
            figure(floor[j]),
        ]
        for j, unit in enumerate(units)
    ]
    heads = ["joint", *(str(k) for k in range(1, len(history) + 1)), "change", "noise"]
    table(heads, rows, "RMS error of each joint, model by model", "numbers history")
    judged = ", ".join(history[-1].judged_on)
    note(f"RMS error on {judged}.")


def _all_models(view: View) -> None:
    """Those that have left the history too, each to be gone on from."""
    session = view.session
    left = [m for m in session.models if m not in session.history]
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
    """What became of each joint's error."""
    if len(session.history) == 1:
        return None
    first, last = (session.history[k].comparison for k in (0, -1))
    floor = None if None in last["noise_floor"] else np.array(last["noise_floor"], float)
    said = changes(np.array(first["rmse"]), np.array(last["rmse"]), floor)
    whole = [figure(c["relative_error_percent"]) for c in (first, last)]
    said = said or "No joint's error changed by more than 5 %."
    return Verdict("", f"{said} All joints together: {whole[0]} % became {whole[1]} %.")


HISTORY = after_model(
    "history",
    "The falling error",
    _draw,
    _verdict,
    lambda s: ([m.file for m in s.models], len(s.undone)),
)
