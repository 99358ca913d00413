"""Diagnose: the error from model to model; which effects are missing, each to be added
with a click."""

from collections.abc import Sequence
from contextlib import nullcontext
from functools import partial

import numpy as np
from nicegui import ui

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.findings import Diagnosis, event_lines, rating_counts
from sdp_vs_penalty.estimation.verdict import changes
from sdp_vs_penalty.page import controls as draw
from sdp_vs_penalty.page.charts import missing_chart
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.view import Stage, StageVerdict, View, requires_model
from sdp_vs_penalty.reports.markup import bars


@requires_model("history", "The model so far", lambda s: len(s.undone))
def models(view: View) -> None:
    """Each joint's error from model to model, with undo and redo."""
    session = view.session
    history = session.history
    units = session.robot["units"]
    draw.judged(history)
    with draw.tag("div", style="row"):
        if len(history) > 1:
            draw.button("Undo the last step", session.undo, "undo")
        if session.undone:
            draw.button(f"Redo {session.undone[-1].label}", session.redo, "redo")
    if len(history) == 1:
        return
    errors = [model.comparison["rmse"] for model in history]
    floor = history[-1].comparison["noise_floor"]
    ui.html(bars(errors[0], errors[-1], floor, units), sanitize=False)
    names = [str(k) for k in range(1, len(errors) + 1)]
    error_rows = formatting.error_table(names, errors, floor, units)
    draw.table(
        *error_rows, "RMS error of each joint, model by model", "numbers history"
    )
    draw.note(f"RMS error on {', '.join(history[-1].judged_on)}.")


@requires_model(
    "findings",
    "What is missing",
    lambda s: (s.frozen, s.findings and s.findings.to_dict()),
)
def findings(view: View) -> None:
    """What the last diagnosis found, each to be added."""
    session = view.session
    diagnosis = view.session.findings
    with draw.tag("div", style="row"):
        again = "Diagnose" if diagnosis is None else "Diagnose again"
        diagnose = partial(session.start, session.diagnose)
        draw.button(again, diagnose, "diagnose", "primary" if diagnosis is None else "")
        label = "Keep the model fixed (the only way to see a payload)"
        draw.check(label, session.frozen, partial(setattr, session, "frozen"), "frozen")
    _by_hand(view)
    if diagnosis is None:
        draw.note(
            "Every effect of the library is tried on the error, and named only if it"
            " holds on data that did not select it."
        )
        return
    sure = [f for f in diagnosis.sure if f.text not in session.added]
    with draw.tag("ol", style="findings"):
        for k in range(len(diagnosis.effects)):
            _card(view, diagnosis, k)
    _constants(session, diagnosis)
    _curves(view, diagnosis)
    if len(sure) > 1:
        add = partial(session.start, session.add, [f.text for f in sure])
        draw.button(f"Add all but the weak: {rating_counts(sure)}", add, "add-all")
    _rest(diagnosis)


def _card(view: View, diagnosis: Diagnosis, k: int) -> None:
    session = view.session
    finding = diagnosis.effects[k]
    units = session.robot["units"]
    done = " done" if finding.text in session.added else ""
    with draw.tag("li", style=f"card finding-card{done}"):
        with draw.tag("div", style="head"):
            draw.tag(
                "h4", f"{draw.plain_name(finding.effect)} · {_where(finding.joints)}"
            )
            draw.tag("span", finding.rating, f"badge {finding.rating}")
        size = "; ".join(filter(None, (finding.size_text, finding.constants)))
        draw.tag("p", f"Size {size}", "size")
        again = finding.effect in [f.effect for f in diagnosis.effects[:k]]
        with draw.details("What it is", f"physics-{k}") if again else nullcontext():
            physics = finding.explanation.partition(". ")[2]
            draw.tag("p", physics.partition(" Indistinguishable in these data from")[0])
        if rivals := finding.indistinguishable_from:
            draw.tag(
                "p",
                f"Indistinguishable in these data from: {', '.join(rivals)}.",
                "rivals",
            )
        if command := finding.telling_run("model.json", k + 1):
            with draw.details("Which run would tell", f"tell-{k}"):
                draw.note("With the model's file, which is under Use:")
                draw.tag("pre", command, tabindex="0")
        if finding.remarks:
            why = "; ".join(finding.remarks)
            draw.note(f"{finding.rating.capitalize()}: {why}.")
        before = finding.held_out_rmse_before
        after = finding.held_out_rmse_after
        joints_shown = [j - 1 for j in finding.joints[:1]] or range(len(before))
        joint = min(
            joints_shown, key=lambda j: after[j] / before[j] if before[j] else 1.0
        )
        floor = [diagnosis.noise_floor[joint]] if diagnosis.noise_known else None
        what = "Held-out error, refitted at each step,"
        fall = bars(
            [before[joint]], [after[joint]], floor, [units[joint]], [joint + 1], what
        )
        ui.html(fall, sanitize=False)
        name = f"Add {draw.plain_name(finding.effect)} on {_where(finding.joints)}"
        _adding(
            session,
            finding.text,
            f"add-{k}",
            "primary" if k == 0 else "",
            aria_label=name,
        )


def _adding(
    session: Session, text: str, key: str, style: str = "", **more: str
) -> None:
    """The button that adds something, or that it has been added."""
    if text in session.added:
        draw.tag("p", "Added to the model.", "chosen")
    else:
        draw.button(
            "Add", partial(session.start, session.add, [text]), key, style, **more
        )


def _where(joints: Sequence[int]) -> str:
    return formatting.joints(joints) if joints else "whole robot"


def _constants(session: Session, diagnosis: Diagnosis) -> None:
    """Other constants of the model's own effects."""
    for k, constant in enumerate(diagnosis.retuned):
        with draw.tag("div", style="card finding-card"):
            draw.tag(
                "h4", f"{draw.plain_name(constant.effect)} · joint {constant.joint}"
            )
            draw.tag("p", constant.explanation)
            if constant.remarks:
                why = "; ".join(constant.remarks)
                draw.note(f"{constant.rating.capitalize()}: {why}.")
            _adding(session, constant.text, f"add-constant-{k}")


def _curves(view: View, diagnosis: Diagnosis) -> None:
    """What was measured without a name: curve, band, and a button to add it as a table."""
    session = view.session
    units = view.session.robot["units"]
    texts = session.history[session.found_for - 1].curve_texts
    for k, (curve, text) in enumerate(zip(diagnosis.curves, texts, strict=True)):
        with draw.tag("div", style="card finding-card"):
            draw.tag("h4", f"Missing torque without a name · joint {curve.joint}")
            draw.tag("p", curve.sentence(units))
            drawn = missing_chart(
                curve, units, session.recording(session.current, view.run)
            )
            draw.chart(drawn, f"Missing torque of joint {curve.joint}, with its band")
            _adding(session, text, f"add-curve-{k}")


def _by_hand(view: View) -> None:
    """Any effect by its name: a payload beside a fixed model, or one that the diagnosis
    did not name."""
    with draw.details("Add an effect by its name", "by-hand"):
        hint = "name[:joints][@shape=value], such as payload with the model kept fixed"
        written = [""]
        draw.text_field(
            hint,
            "",
            partial(written.__setitem__, 0),
            "add-text",
            "payload",
            style="field wide-field",
        )
        draw.button(
            "Add it",
            partial(view.session.start, view.session.add, written),
            "add-by-hand",
        )


def _rest(diagnosis: Diagnosis) -> None:
    """Events, what is left, what can never be seen, and remarks."""
    lines_in_short = event_lines(diagnosis.events)
    all_lines = event_lines(diagnosis.events, show_all=True)
    for line in lines_in_short:
        draw.tag("p", f"{line.capitalize()}.", "finding")
    if len(all_lines) > len(lines_in_short):
        with draw.details("Every event", "events"), draw.tag("ul"):
            for line in all_lines:
                draw.tag("li", f"{line.capitalize()}.")
    for remark in diagnosis.remarks:
        draw.note(remark)
    draw.note(diagnosis.left_sentence)
    if diagnosis.invisible:
        with draw.details("Not identifiable from these runs", "invisible"):
            draw.note("The model's existing parameters absorb the torque of:")
            with draw.tag("ul"):
                for item in diagnosis.invisible:
                    draw.tag(
                        "li", f"{draw.plain_name(item.effect)}, {_where(item.joints)}"
                    )


def _diagnosed(session: Session) -> StageVerdict | None:
    """What became of each joint's error, and what the last diagnosis says, where it is
    of this model."""
    diagnosis = session.findings
    added = session.added
    sentence = ""
    if diagnosis is not None:
        texts = [
            *(f.text for f in diagnosis.effects),
            *(c.text for c in diagnosis.retuned),
        ]
        left = sum(text not in added for text in texts)
        sentence = f"{left} more can be added." if left else ""
        sentence = (
            (sentence or "Diagnose again to see what is missing now.")
            if added
            else diagnosis.headline
        )
    if len(session.history) > 1:
        first = session.history[0].comparison
        last = session.history[-1].comparison
        floor = None if None in last["noise_floor"] else np.array(last["noise_floor"])
        change_words = changes(np.array(first["rmse"]), np.array(last["rmse"]), floor)
        change_words = change_words or "no joint changed its error by more than 5 %."
        sentence = f"{change_words[0].upper()}{change_words[1:]} {sentence}".strip()
    return StageVerdict("", sentence) if sentence else None


DIAGNOSE = Stage(
    "diagnose", "Diagnose", "Identify a model first.", (models, findings), _diagnosed
)
