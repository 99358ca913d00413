"""Advanced: other methods, certificate and proof, the problem for other solvers."""

from functools import partial

from sdp_vs_penalty.page import controls as draw
from sdp_vs_penalty.page.view import Stage, View, after_model, method_names
from sdp_vs_penalty.reports.sections import CERTIFICATE


@after_model("methods", "Compare methods", lambda s: s.answer("methods"))
def methods(view: View) -> None:
    """Other methods beside the current model's, on the same runs."""
    session, chosen = view.session, view.methods
    names = method_names()
    with draw.tag("fieldset"):
        draw.tag("legend", "With the effects of the current model")
        with draw.tag("div", style="checks"):
            for name, said in names.items():
                on, put = chosen.get(name, False), partial(chosen.__setitem__, name)
                draw.check(name, on, put, f"method-{name}", said)

    def compare() -> None:
        asked = [name for name in names if chosen.get(name)]
        session.ask("methods", "Comparing methods", methods=asked, folds=view.folds)

    said = "On unseen motion too: five folds, takes five times as long"
    hint = "Each fold leaves out a stretch of the motion and all its repetitions"
    draw.check(said, view.folds, partial(setattr, view, "folds"), "folds", hint)
    draw.button("Compare methods", compare, "compare")
    if (found := session.answer("methods")) is None:
        return
    draw.table(found["heads"], found["rows"], "Methods compared", "numbers methods")
    draw.note(
        "On the runs that the model is judged on. Possible: every link can exist, within its bounds; "
        "thinnest: a link's thickness, zero or less where it cannot; gap: of the certified optimum."
    )


@after_model("proof", "Certificate and proof", lambda s: (s.answer("prove"), s.answers.get("verify")))
def proof(view: View) -> None:
    """The certificate, and a proof of the optimum to make or to check."""
    session, model = view.session, view.session.current
    draw.note(CERTIFICATE)
    draw.table(["figure", model.label], model.about["certificate"], "Certificate", "numbers wraps")
    proved, told = session.answer("prove"), session.answers.get("verify")
    draw.tag("h4", "Proof")
    draw.note(
        "The model is identified again with a proof of its optimum, which a checker in pure Python "
        "then verifies in rational arithmetic, as the command verify does."
    )
    prove = partial(session.ask, "prove", "Proving the optimum", view.download)
    draw.button("Prove the optimum", prove, "prove", "primary" if proved is None else "")
    for found in (proved, told):
        if found is not None:
            kind = "good" if found["holds"] else "bad"
            said = session.without_paths(found["said"])
            draw.tag("p", f"{said[0].upper()}{said[1:]}.", f"verdict {kind}")
    draw.drop("Or check a proof.json", "proof")


#: The optimisation problem, for other solvers; beside each a .json with what it means.
POSED_FILES = {"problem.cbf": "conic benchmark format", "problem.dat-s": "sparse SDPA"}


@after_model("posed", "The identification problem, for other solvers")
def posed(view: View) -> None:
    """The optimisation problem as files."""
    with draw.tiles("Problem files to download"):
        for name, use in POSED_FILES.items():
            ask = partial(view.session.ask, "pose", f"Making {name}", view.download, name=name)
            draw.tile(name, use, ask, f"take-{name}")


ADVANCED = Stage("advanced", "Advanced", "Identify a model first.", (methods, proof, posed))
