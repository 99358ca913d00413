"""What is certified of the model, and its proof in exact arithmetic."""

from __future__ import annotations

from sdp_vs_penalty.page.controls import button, drop, note, table, tag
from sdp_vs_penalty.page.part import after_model
from sdp_vs_penalty.page.uploads import SUFFIXES
from sdp_vs_penalty.page.view import View
from sdp_vs_penalty.page.wording import figure, held
from sdp_vs_penalty.reports.evidence import CERTIFICATE


def _draw(view: View) -> None:
    session, model = view.session, view.session.current
    said = f"Constraints: {held(model.violation)}; "
    if model.gap is None:
        said += "this method has no certified lower bound."
    else:
        said += f"nothing under them is better by more than {figure(model.gap, 2)} of the loss."
    tag("p", said, "words")
    note(CERTIFICATE)
    table(["figure", model.label], model.about["certificate"], "Certificate", "numbers wraps")
    proved, told = session.answer("prove"), session.answers.get("verify")
    tag("h4", "Proof")
    note(
        "The model is identified again with a proof of its optimum, which a checker in pure Python "
        "then verifies in rational arithmetic, as the command verify does."
    )
    button(
        "Prove the optimum",
        lambda: session.ask("prove", "Proving the optimum", view.download),
        "prove",
        "primary" if proved is None else "",
    )
    for found in (proved, told):
        if found is not None:
            kind = "good" if found["holds"] else "bad"
            said = session.without_paths(found["said"])
            tag("p", f"{said[0].upper()}{said[1:]}.", f"verdict {kind}")
    drop("Or check a proof.json", "drop a file here, or choose one", "proof", SUFFIXES["proof"], False)


PROOF = after_model(
    "proof",
    "Certificate and proof",
    _draw,
    lambda s: (s.answer("prove"), s.answers.get("verify")),
)
