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
from sdp_vs_penalty.page.view import Stage, Verdict, View, requires_model
from sdp_vs_penalty.reports.markup import bars


@requires_model("history", "The model so far", lambda s: len(s.undone))
def models(view: View) -> None:
    """Each joint's error from model to model, with undo and redo."""
    session = view.session
    history, units = session.history, session.robot["units"]
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
    made = formatting.error_table(names, errors, floor, units)
    draw.table(*made, "RMS error of each joint, model by model", "numbers history")
    draw.note(f"RMS error on {', '.join(history[-1].judged_on)}.")


@requires_model(
    "findings",
    "What is missing",
    lambda s: (s.frozen, s.findings and s.findings.to_dict()),
)
def findings(view: View) -> None:
    """What the last diagnosis found, each to be added."""
    session, found = view.session, view.session.findings
    with draw.tag("div", style="row"):
        again = "Diagnose" if found is None else "Diagnose again"
        diagnose = partial(session.start, session.diagnose)
        draw.button(again, diagnose, "diagnose", "primary" if found is None else "")
        said = "Keep the model fixed (the only way to see a payload)"
        draw.check(said, session.frozen, partial(setattr, session, "frozen"), "frozen")
    _by_hand(view)
    if found is None:
        draw.note(
            "Every effect of the library is tried on the error, and named only if it"
            " holds on data that did not select it."
        )
        return
    sure = [f for f in found.sure if f.text not in session.added]
    with draw.tag("ol", style="findings"):
        for k in range(len(found.effects)):
            _card(view, found, k)
    _constants(session, found)
    _curves(view, found)
    if len(sure) > 1:
        add = partial(session.start, session.add, [f.text for f in sure])
        draw.button(f"Add all but the weak: {rating_counts(sure)}", add, "add-all")
    _rest(found)


def _card(view: View, found: Diagnosis, k: int) -> None:
    session, finding = view.session, found.effects[k]
    units, done = (
        session.robot["units"],
        " done" if finding.text in session.added else "",
    )
    with draw.tag("li", style=f"card finding-card{done}"):
        with draw.tag("div", style="head"):
            draw.tag(
                "h4", f"{draw.plain_name(finding.effect)} · {_where(finding.joints)}"
            )
            draw.tag("span", finding.rating, f"badge {finding.rating}")
        size = "; ".join(filter(None, (finding.size_text, finding.constants)))
        draw.tag("p", f"Size {size}", "size")
        again = finding.effect in [f.effect for f in found.effects[:k]]
        with draw.details("What it is", f"physics-{k}") if again else nullcontext():
            physics = finding.explanation.partition(". ")[2]
            draw.tag("p", physics.partition(" Indistinguishable in these data from")[0])
        if rivals := finding.indistinguishable_from:
            draw.tag(
                "p",
                f"Indistinguishable in these data from: {', '.join(rivals)}.",
                "rivals",
            )
        if told := finding.telling_run("model.json", k + 1):
            with draw.details("Which run would tell", f"tell-{k}"):
                draw.note("With the model's file, which is under Use:")
                draw.tag("pre", told, tabindex="0")
        if finding.remarks:
            why = "; ".join(finding.remarks)
            draw.note(f"{finding.rating.capitalize()}: {why}.")
        before, after = finding.held_out_rmse_before, finding.held_out_rmse_after
        own = [j - 1 for j in finding.joints[:1]] or range(len(before))
        joint = min(own, key=lambda j: after[j] / before[j] if before[j] else 1.0)
        floor = [found.noise_floor[joint]] if found.noise_known else None
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


def _constants(session: Session, found: Diagnosis) -> None:
    """Other constants of the model's own effects."""
    for k, constant in enumerate(found.retuned):
        with draw.tag("div", style="card finding-card"):
            draw.tag(
                "h4", f"{draw.plain_name(constant.effect)} · joint {constant.joint}"
            )
            draw.tag("p", constant.explanation)
            if constant.remarks:
                why = "; ".join(constant.remarks)
                draw.note(f"{constant.rating.capitalize()}: {why}.")
            _adding(session, constant.text, f"add-constant-{k}")


def _curves(view: View, found: Diagnosis) -> None:
    """What was measured without a name: curve, band, and a button to add it as a table."""
    session, units = view.session, view.session.robot["units"]
    texts = session.history[session.found_for - 1].curve_texts
    for k, (curve, text) in enumerate(zip(found.curves, texts, strict=True)):
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
        said = "name[:joints][@shape=value], such as payload with the model kept fixed"
        written = [""]
        draw.text_field(
            said,
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


def _rest(found: Diagnosis) -> None:
    """Events, what is left, what can never be seen, and remarks."""
    gist, every = event_lines(found.events), event_lines(found.events, every=True)
    for line in gist:
        draw.tag("p", f"{line.capitalize()}.", "finding")
    if len(every) > len(gist):
        with draw.details("Every event", "events"), draw.tag("ul"):
            for line in every:
                draw.tag("li", f"{line.capitalize()}.")
    for remark in found.remarks:
        draw.note(remark)
    draw.note(found.left_sentence)
    if found.invisible:
        with draw.details("Not identifiable from these runs", "invisible"):
            draw.note("The model's existing parameters absorb the torque of:")
            with draw.tag("ul"):
                for item in found.invisible:
                    draw.tag(
                        "li", f"{draw.plain_name(item.effect)}, {_where(item.joints)}"
                    )


def _diagnosed(session: Session) -> Verdict | None:
    """What became of each joint's error, and what the last diagnosis says, where it is
    of this model."""
    found, added = session.findings, session.added
    said = ""
    if found is not None:
        every = [*(f.text for f in found.effects), *(c.text for c in found.retuned)]
        left = sum(text not in added for text in every)
        said = f"{left} more can be added." if left else ""
        said = (
            (said or "Diagnose again to see what is missing now.")
            if added
            else found.headline
        )
    if len(session.history) > 1:
        first, last = (session.history[k].comparison for k in (0, -1))
        floor = None if None in last["noise_floor"] else np.array(last["noise_floor"])
        told = changes(np.array(first["rmse"]), np.array(last["rmse"]), floor)
        told = told or "no joint changed its error by more than 5 %."
        said = f"{told[0].upper()}{told[1:]} {said}".strip()
    return Verdict("", said) if said else None


DIAGNOSE = Stage(
    "diagnose", "Diagnose", "Identify a model first.", (models, findings), _diagnosed
)
