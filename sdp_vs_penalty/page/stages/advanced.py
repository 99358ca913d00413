"""Advanced: other methods, certificate and proof, the problem for other solvers."""

from __future__ import annotations

from functools import partial

from sdp_vs_penalty.page.controls import button, check, drop, note, table, tag, tile
from sdp_vs_penalty.page.uploads import SUFFIXES
from sdp_vs_penalty.page.view import Stage, View, after_model
from sdp_vs_penalty.reports.sections import CERTIFICATE


def _draw_methods(view: View) -> None:
    session, chosen = view.session, view.methods

    with tag("fieldset"):
        tag("legend", "With the effects of the current model")
        with tag("div", style="checks"):
            for method in view.catalogue["methods"]:
                name = method["name"]
                check(
                    name,
                    name in chosen,
                    lambda on, name=name: (chosen.add if on else chosen.discard)(name),  # type: ignore[misc]
                    f"method-{name}",
                    method["description"],
                )

    def compare() -> None:
        names = [m["name"] for m in view.catalogue["methods"] if m["name"] in chosen]
        session.ask("methods", "Comparing methods", methods=names, folds=view.folds)

    check(
        "On unseen motion too: five folds, takes five times as long",
        view.folds,
        partial(setattr, view, "folds"),
        "folds",
        "Each fold leaves out a stretch of the motion and all its repetitions",
    )
    button("Compare methods", compare, "compare")
    if (found := session.answer("methods")) is None:
        return
    table(found["heads"], found["rows"], "Methods compared", "numbers methods")
    note(
        "Relative torque error on the same runs; upper bounds on inertias about the centre of mass "
        "are not convex; zero thickness is unphysical, and so is a radius of gyration above 1 of what a "
        "link's body reaches (widest link); a gap is shown only where a lower bound is certified."
    )


METHODS = after_model("methods", "Compare methods", _draw_methods, lambda s: s.answer("methods"))


def _draw_proof(view: View) -> None:
    session, model = view.session, view.session.current
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
    _draw_proof,
    lambda s: (s.answer("prove"), s.answers.get("verify")),
)


#: The optimisation problem, for other solvers; beside each a .json with what it means.
POSED_FILES = {"problem.cbf": "conic benchmark format", "problem.dat-s": "sparse SDPA"}


def _draw_posed(view: View) -> None:
    with tag("div", style="tiles", role="group", aria_label="Problem files to download"):
        for name, use in POSED_FILES.items():
            ask = partial(view.session.ask, "pose", f"Making {name}", view.download, name=name)
            tile(name, use, ask, f"take-{name}")


POSED = after_model("posed", "The identification problem, for other solvers", _draw_posed)


ADVANCED = Stage("advanced", "Advanced", "Identify a model first.", (METHODS, PROOF, POSED))
