"""The error of every joint from model to model, and one step back."""

from __future__ import annotations

from functools import partial

from nicegui import ui

from sdp_vs_penalty.page.controls import button, details, note, table, tag
from sdp_vs_penalty.page.part import after_model
from sdp_vs_penalty.page.view import View
from sdp_vs_penalty.page.wording import figure
from sdp_vs_penalty.reports.pictures import bars, change_of


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
        return
    errors = [model.comparison["rmse"] for model in history]
    floor = history[-1].comparison["noise_floor"]
    known = None if None in floor else floor
    ui.html(bars(errors[0], errors[-1], known, units), sanitize=False)
    rows = [
        [
            f"{j + 1} [{unit}]",
            *(figure(e[j]) for e in errors),
            change_of(errors[0][j], errors[-1][j]),
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
    with details(f"Other models of this session ({len(left)})", "other-models"):
        for k, m in enumerate(left):
            with tag("div", style="row"):
                error = f"{figure(m.comparison['relative_error_percent'])} % on {', '.join(m.judged_on)}"
                note(f"{m.label}, {m.method}, {m.parameters} parameters: {error}")
                button("Go on from it", partial(session.take_up, m), f"take-up-{k}")


HISTORY = after_model(
    "history",
    "The model so far",
    _draw,
    lambda s: ([m.file for m in s.models], len(s.undone)),
)
