"""What makes torque to begin with, and by which method."""

from __future__ import annotations

from functools import partial
from typing import Any

from sdp_vs_penalty.page.controls import (
    button,
    check,
    choice,
    details,
    draw_form,
    drop,
    note,
    number,
    table,
    tag,
    text_field,
)
from sdp_vs_penalty.page.part import Part
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.uploads import SUFFIXES
from sdp_vs_penalty.page.view import View
from sdp_vs_penalty.page.wording import plain_name

_USUAL = ("rigid_body", "viscous_friction", "coulomb_friction", "torque_offset", "rotor_inertia")


def _depends(session: Session) -> Any:
    chosen = session.method, session.seed, session.effects, session.anyway
    bounds = session.options.get("bounds")
    has_model = session.model is not None
    return (session.robot or {}).get("source"), *chosen, session.meaningless, bounds, has_model


def _draw(view: View) -> None:
    if view.session.model is None:
        _form(view)
    else:
        with details("Effects, method, options: identify again", "model-form"):
            _form(view)


def _form(view: View) -> None:
    session = view.session
    session.asked = view.forms.get("identify", ())
    effects = {e["name"]: e for e in view.catalogue["effects"] if not e["frozen_only"]}

    def tick(name: str, on: bool) -> None:
        chosen = [e for e in session.effects if _name(e) != name] + [name] * on
        order = list(effects)
        session.effects = sorted(
            chosen, key=lambda e: order.index(_name(e)) if _name(e) in order else 99
        )
        session.changed()

    def box(name: str) -> None:
        check(
            plain_name(name),
            name in map(_name, session.effects),
            lambda on: tick(name, on),
            f"effect-{name}",
            effects[name]["explanation"],
        )

    with tag("fieldset"):
        tag("legend", "Effects of the first model")
        with tag("div", style="checks"):
            for name in _USUAL:
                box(name)
        rest = [name for name in effects if name not in _USUAL]
        chosen = sum(name in map(_name, session.effects) for name in rest)
        with details(f"More effects ({chosen} of {len(rest)} chosen)", "more-effects") as more:
            if chosen:
                more.props["open"] = True
            note("The stage Diagnose tells which are needed.")
            with tag("div", style="checks"):
                for name in rest:
                    box(name)

    with tag("div", style="fields"):
        options = [(m["name"], f"{m['name']}: {m['description']}") for m in view.catalogue["methods"]]
        choice("Method", options, session.method, partial(setattr, session, "method"), "method")
        number("Seed", session.seed, partial(setattr, session, "seed"), "seed")
    _bounds(view)
    _options(view)
    if session.meaningless:
        check(
            "Identify anyway (data check failed)",
            session.anyway,
            partial(setattr, session, "anyway"),
            "anyway",
        )
    button("Identify", session.identify, "identify", "primary")
    with details("Or continue from a model.json", "open-model"):
        note(
            "A model identified earlier, possibly from other runs: kept fixed, it shows what has "
            "changed since, such as a payload."
        )
        drop("Your model.json", "drop a file here, or choose one", "model", SUFFIXES["model"], False)


def _bounds(view: View) -> None:
    """What is known of the links before anything is measured: a row a link, a column a parameter; what
    is changed has a star."""
    words = view.session.options.get("bounds", "").split(",")
    own = {name.strip(): ends for name, equals, ends in (w.partition("=") for w in words) if equals}
    known = view.session.arm["bounds"]

    def cell(name: str, low: str, high: str) -> str:
        if name in own:
            low, _, high = own[name].partition(":")
        span = f"{low} to {high}" if low and high else f"from {low}" if low else f"to {high}"
        return (span if low or high else "-") + " *" * (name in own)

    with details(
        f"Bounds of links ({len(own)} changed)" if own else "Bounds of links", "bounds"
    ) as shown:
        if own:
            shown.props["open"] = True
        note("c is the centre of mass, I the inertia about it; * is yours, by the field below.")
        links = [known[k : k + 10] for k in range(0, len(known), 10)]
        rows = [(f"{k}", *(cell(*x[:3]) for x in link)) for k, link in enumerate(links, start=1)]
        heads = [f"{name.replace('1', '')} [{unit}]" for name, _, _, unit in links[0]]
        table(("link", *heads), rows, "Bounds of the links")
        if "total" in own:
            note(f"Total mass: {cell('total', '', '')} kg")
        (field,) = [f for f in view.session.asked if f.name == "bounds"]

        def put(text: str) -> None:
            view.session.options.pop("bounds", None)
            view.session.options |= {"bounds": text.strip()} if text.strip() else {}
            view.session.changed()

        text_field(
            field.help, ",".join(f"{k}={v}" for k, v in own.items()), put, "bounds-text", field.example
        )


def _options(view: View) -> None:
    """Effects as they are written on the command line, and its options."""
    session = view.session

    def write(text: str) -> None:
        session.effects = [word.strip() for word in text.split(",") if word.strip()]
        session.changed()

    chosen = len(session.options.keys() - {"bounds"})
    with details(f"More options ({chosen} set)" if chosen else "More options", "more-options"):
        said = "Effects as text: name[:joints][@shape=value], such as coulomb_friction@v_s=0.01"
        text_field(said, ",".join(session.effects), write, "effects-text", wide=True)
        with tag("div", style="fields"):
            draw_form([f for f in session.asked if f.name != "bounds"], session.options)


def _name(effect: str) -> str:
    """coulomb_friction of coulomb_friction:7@v_s=0.01."""
    return effect.partition("@")[0].partition(":")[0]


MODEL = Part(
    "model",
    "",
    lambda session: any(run["use"] != "test" for run in session.runs),
    _depends,
    _draw,
)
