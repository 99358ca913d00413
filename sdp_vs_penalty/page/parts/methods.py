"""The same effects by other methods."""

from __future__ import annotations

from functools import partial

from sdp_vs_penalty.page.controls import button, check, note, table, tag
from sdp_vs_penalty.page.part import after_model
from sdp_vs_penalty.page.view import View
from sdp_vs_penalty.page.wording import figure, held


def _draw(view: View) -> None:
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
    heads = ["method", "error", "constraints", "thinnest link", "widest link", "certified gap", "time"]
    folded = any(row.get("unseen") is not None for row in found["rows"])
    if folded:
        heads.append("error on unseen motion")
    rows = []
    for row in found["rows"]:
        if "failed" in row:
            rows.append([row["method"], row["failed"], *[""] * (len(heads) - 2)])
            continue
        thick, share = row["thickness"], row["body_share"]
        rows.append(
            [
                row["method"],
                f"{row['relative']:.4g} %",
                held(row["violation"]),
                "-" if thick is None else f"{1e3 * thick:.3g} mm",
                "-" if share is None else f"{share:.2g}",
                figure(row["gap"], 2),
                f"{row['seconds']:.2g} s",
                *([f"{row['unseen']:.4g} %"] if folded else []),
            ]
        )
    table(heads, rows, "Methods compared", "numbers methods")
    note(
        "Relative torque error on the same runs; upper bounds on inertias about the centre of mass "
        "are not convex; zero thickness is unphysical, and so is a radius of gyration above 1 of what a "
        "link's body reaches (widest link); a gap is shown only where a lower bound is certified."
    )


METHODS = after_model("methods", "Compare methods", _draw, lambda s: s.answer("methods"))
