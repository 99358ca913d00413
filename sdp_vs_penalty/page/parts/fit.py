"""Measured against modelled, joint by joint, and where the model fails."""

from __future__ import annotations

from typing import Any

from nicegui import ui

from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.show import new_motion
from sdp_vs_penalty.page.arm import draw_arm, torque_errors
from sdp_vs_penalty.page.charts import (
    asked_span,
    merged,
    residual_chart,
    torque_chart,
    with_shades,
)
from sdp_vs_penalty.page.controls import button, chart, choice, figures, framed, note, tag
from sdp_vs_penalty.page.part import after_model
from sdp_vs_penalty.page.summary import ModelStep
from sdp_vs_penalty.page.view import View
from sdp_vs_penalty.page.wording import figure, held, spoken, with_unit
from sdp_vs_penalty.reports.pictures import SHADES, bars, found_shares, heat_map, heat_rows, legend
from sdp_vs_penalty.reports.plots import SIGNALS


def _draw(view: View) -> None:
    session, model, robot = view.session, view.session.current, view.session.arm
    comparison, units = model.comparison, robot["units"]
    if view.joint is None:  # whose error is the most times its noise; without noise, the largest
        both = zip(comparison["rmse"], comparison["noise_floor"], strict=True)
        scaled = [e / f if f else e for e, f in both]
        view.joint = scaled.index(max(scaled))
    view.joint = min(view.joint, robot["n"] - 1)
    if view.run not in model.runs:
        view.run, view.span = model.runs[-1], None
    first = session.history[0].comparison
    floor = None if None in comparison["noise_floor"] else comparison["noise_floor"]
    after = comparison["rmse"] if len(session.history) > 1 else None
    ui.html(bars(first["rmse"], after, floor, units), sanitize=False)
    _figures(model)
    chips = _chips(view, model, units)
    parts: dict[str, Any] = {}
    with tag("div", style="pick"):
        choice(
            "Run",
            [(name, name) for name in model.runs],
            view.run,
            lambda name: view.look(run=name),
            "shown-run",
        )

    def options() -> dict[str, Any]:
        curves = session.curves(model, view.run)
        if len(session.history) > 1:
            curves = merged(session.curves(session.history[0], view.run), curves)
        shown = torque_chart(curves, view.joint or 0, units, view.span)
        return with_shades(shown, _stretches(view, model))

    def reads() -> list[Any]:
        steps = [session.history[0], model][-len(session.history) :]
        return [session.recording(step, view.run) for step in steps]

    def against() -> dict[str, Any]:
        j = view.joint or 0
        floor = comparison["noise_floor"][j]
        return residual_chart(reads(), j, view.signal, units[j], floor, view.span)

    def zoom(event: Any) -> None:
        span = asked_span(event.args)
        if not isinstance(span, bool):
            view.look(span=span)

    def follow() -> None:
        j = view.joint or 0
        for k in {seen.get("chip", j), j}:
            chips[k].classes(add="on" if k == j else "", remove="" if k == j else "on")
            chips[k].props["aria-pressed"] = "true" if k == j else "false"
        at = j, view.run, view.span
        if seen.get("chart") != at:
            parts["chart"].update_figure(options())
        causes = {cause for *_, cause in _stretches(view, model)}
        parts["legend"].content = legend([cause for cause in SHADES if cause in causes])
        if seen.get("run") != view.run and "arm" in parts:
            read = session.recording(model, view.run)
            parts["arm"](read, torque_errors(model, read))
        seen.update(chip=j, chart=at, run=view.run)
        parts["words"].text = _words(model, j, units[j])

    def follow_behind() -> None:
        at = view.joint or 0, view.run, view.signal, view.span
        if seen["against"] != at:
            parts["against"].update_figure(against())
        seen["against"] = at

    with tag("div", style="pair"):
        parts["chart"] = chart(options(), "Measured and modelled torque, and the residual")
        parts["chart"].on("plotly_relayout", zoom).classes("timed")
        if model.about["bodies"]:
            parts["arm"] = draw_arm(view, model.about, "redder: larger torque error")
    parts["legend"] = ui.html("", sanitize=False)
    parts["words"] = tag("p", "", "words")
    if model.failures:
        found = session.findings if session.found_for == len(session.history) else None
        _heat(view, model.failures, found)
    with tag("div", style="pick"):
        signals = list(SIGNALS.items())
        choice("Error against", signals, view.signal, lambda name: view.look(signal=name), "signal")
    parts["against"] = chart(against(), "Error of the joint against a signal")
    seen: dict[str, Any] = {"chart": (view.joint, view.run, view.span)}
    seen["against"] = view.joint, view.run, view.signal, view.span
    view.followers["fit"], view.behind["fit"] = follow, follow_behind
    follow()
    if model.on_bounds:
        note(
            f"On their bounds (set by the bound, not by the data): {', '.join(model.on_bounds)}. "
            "More options above change bounds."
        )


def _figures(model: ModelStep) -> None:
    """How well the model does, in a line."""
    comparison = model.comparison
    figures(
        {
            "relative error": f"{figure(comparison['relative_error_percent'])} %",
            "judged on": _names(model.judged_on),
            "new motion": new_motion(comparison["new_motion_share"]),
            "below": f"{figure(comparison['band_hz'])} Hz",
            "constraints": held(model.violation),
            "certified gap" + (" of what was added" if model.frozen else ""): figure(model.gap, 2),
            "time": f"{model.seconds:.2g} s",
        }
    )
    for line in comparison["verdict"]["lines"][1:]:  # the first one stands above
        tag("p", f"{line['about'].capitalize()} ({line['grade']}): {spoken(line['text'])}", "line")


def _chips(view: View, model: ModelStep, units: list[str]) -> list[Any]:
    """A button a joint with its error and noise, by which it is chosen."""
    comparison = model.comparison
    chips: list[Any] = []
    with tag("div", style="chips", role="group", aria_label="Joint to show"):
        for j, error in enumerate(comparison["rmse"]):
            chip = button(
                "", lambda j=j: view.look(joint=j), f"joint-{j + 1}", "chip", aria_pressed="false"
            )  # type: ignore[misc]
            with chip:
                tag("strong", f"Joint {j + 1}")
                tag("span", with_unit(error, units[j]), "rmse")
                floor = comparison["noise_floor"][j]
                tag("span", "noise unknown" if floor is None else f"noise {figure(floor)}", "soft")
            chips.append(chip)
    return chips


def _names(names: list[str]) -> str:
    return ", ".join(names) if len(names) <= 3 else f"{len(names)} runs"


def _words(model: ModelStep, j: int, unit: str) -> str:
    """What can be said of a joint's error in a sentence or two."""
    error, floor = model.comparison["rmse"][j], model.comparison["noise_floor"][j]
    text = f"Joint {j + 1}: the error is {with_unit(error, unit)}"
    if floor:
        text += f", {figure(error / floor, 2)} times the noise floor of {with_unit(floor, unit)}"
    text += "."
    if not model.failures:
        return text
    return " ".join([text, *model.failures[j]["sentences"]])


#: The signal that shows what a cause of the table explains.
_SHOWN_BY = {
    "position": "q", "velocity": "dq", "acceleration": "ddq", "load": "torque", "time": "t",
    "high speed": "dq", "reversal": "dq", "standstill": "dq", "waves per turn": "q",
}  # fmt: skip


def _stretches(view: View, model: ModelStep) -> list[tuple[float, float, str]]:
    """Where the chosen joint fails on the run that is shown, in its seconds."""
    if not model.failures or view.joint is None:
        return []
    start = float(view.session.recording(model, view.run)["t"][0])
    return [
        (s["start"] - start, s["stop"] - start, s["cause"])
        for s in model.failures[view.joint]["stretches"]
        if s["run"].startswith(view.run.partition(", ")[0])
    ]


def _heat(view: View, failures: list[dict[str, Any]], found: Diagnosis | None) -> None:
    """Which cause explains how much of each joint's error: darker is more; findings first."""
    tag("h4", "Where it fails, and why")
    note(
        "Share of each joint's error that a function of a cause explains on held-out data, in per "
        "cent; causes that explain nothing are left out. Click a cell to see the joint."
    )
    rows = heat_rows(failures, found_shares(found, len(failures)))
    title = "Share of the error explained by each cause, by joint"

    def show(event: Any) -> None:
        joint, signal = event.args
        at = {"joint": min(max(int(joint), 1), len(failures)) - 1}
        view.look(**at, **({"signal": signal} if signal in SIGNALS else {}))

    drawn = heat_map(title, rows, len(failures), _SHOWN_BY)
    framed(title, drawn).on("click", show, js_handler=_CELL)


#: What a click on a cell sends.
_CELL = """(e) => { const cell = e.target.closest("[data-joint]");
  if (cell) emit([cell.dataset.joint, cell.dataset.signal]); }"""


FIT = after_model("fit", "Measured against modelled", _draw, lambda s: (s.found_for, s.found_in))
