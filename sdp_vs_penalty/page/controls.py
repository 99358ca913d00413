"""Plain HTML controls for NiceGUI: what a browser makes accessible by itself.

Options of the command line are fields made from its verbs, not listed again.
"""

from argparse import Action
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

from nicegui import ui
from nicegui.elements.mixins.text_element import TextElement

from sdp_vs_penalty.page.model_step import ModelStep
from sdp_vs_penalty.page.runs import ENDINGS
from sdp_vs_penalty.page.spoken import spoken
from sdp_vs_penalty.render.pieces import framed
from sdp_vs_penalty.render.tables import model_table
from sdp_vs_penalty.results.table import Table

Handler = Callable[..., Any]


def tag(name: str, text: str = "", style: str = "", **attributes: Any) -> Any:
    """Draw an HTML element with escaped text, and return it.

    ``style`` are its CSS classes. Further attributes are written with underscores
    (``aria_label``, ``for_``); one that is False is left out.
    """
    element = TextElement(tag=name, text=text).classes(style)
    props = {}
    for key, value in attributes.items():
        if value is not False:
            props[key.rstrip("_").replace("_", "-")] = value
    element.props.update(props)
    return element


def note(text: str) -> None:
    """Draw a paragraph in a softer colour, for remarks."""
    tag("p", text, "soft")


def button(
    text: str, do: Handler | None, key: str, style: str = "", **attributes: Any
) -> Any:
    """Draw a button that calls ``do`` when it is clicked; one without ``do`` leads to a
    stage (``data_to``), and is free to be pressed while a job runs.

    By ``key`` the browser finds the focused element again after a redraw. A press that
    was on its way while the button was drawn anew counts (:func:`take_presses`).
    """
    if do is None:
        do, style = (lambda: None), f"{style} free"
    element_made = tag(
        "button", text, f"action {style}", type="button", data_key=key, **attributes
    )
    client = ui.context.client
    presses = _PRESSES.setdefault(client, {})
    presses[element_made.id] = do
    gone = [k for k in presses if k not in client.elements]
    for k in gone[:-_MOST_GONE]:
        del presses[k]
    send = f"() => emitEvent('press', {element_made.id})"
    return element_made.on("click", lambda _: do(), args=[], js_handler=send)


#: What the buttons of each tab do, by their elements' ids; buttons that were drawn anew
#: are kept, so many.
_PRESSES = WeakKeyDictionary[Any, dict[int, Handler]]()
_MOST_GONE = 200


def take_presses() -> None:
    """Let this tab's buttons do what they are pressed for."""
    presses = _PRESSES.setdefault(ui.context.client, {})
    ui.on("press", lambda e: presses.get(int(e.args), lambda: None)())


def tile(
    name: str, caption: str, do: Handler, key: str, style: str = "", **attributes: Any
) -> None:
    """Draw a large button with a name and an explanation of it."""
    with button("", do, key, f"tile {style}", **attributes):
        tag("strong", name)
        tag("span", caption)


def tiles(label: str) -> Any:
    """Draw a group for tiles; use it in a ``with`` statement."""
    return tag("div", style="tiles", role="group", aria_label=label)


def changing(field: Any, do: Callable[[str], Any]) -> Any:
    """Call ``do`` with the text of a field whenever that is changed; return the field."""
    emit = "(e) => emit(e.target.value)"
    return field.on("change", lambda e: do(str(e.args)), js_handler=emit)


def choice(
    label: str,
    options: Iterable[tuple[str, str] | str],
    value: str,
    do: Callable[[str], Any],
    key: str,
    hidden_label: bool = False,
) -> Any:
    """Draw a labelled <select> that calls ``do`` with the value that is chosen, and
    return it.

    options : pairs (value, text), or texts that are their own values; value : the one
    chosen now; key : by which focus finds the element again after a redraw.
    """
    with tag("label", style="field"):
        tag("span", label, "unseen" if hidden_label else "")
        with tag("select", data_key=key, aria_label=label) as select:
            for option in options:
                name, text = (option, option) if isinstance(option, str) else option
                tag("option", text, value=name, selected=name == value)
        return changing(select, do)


def text_field(
    label: str,
    value: str,
    do: Callable[[str], Any],
    key: str,
    example: str = "",
    enter: Callable[[], Any] | None = None,
    **how: Any,
) -> None:
    """Draw a labelled text field; ``do`` gets the new text.

    enter : what the Enter key does, after ``do``; how : attributes of the <input>, and
    ``style``, the CSS classes of the label.
    """
    with tag("label", style=how.pop("style", "field")):
        tag("span", label)
        field = tag(
            "input",
            data_key=key,
            value=value,
            placeholder=example,
            **{"type": "text", **how},
        )
        changing(field, do)
        if enter is not None:
            pressed = "(e) => { if (e.key === 'Enter') emit(e.target.value) }"
            field.on(
                "keydown", lambda e: (do(str(e.args)), enter()), js_handler=pressed
            )


def sketch(drawn: Mapping[str, Any]) -> None:
    """Draw a small curve through points (x, y); nothing without any."""
    if drawn:
        points = " ".join(f"{x},{y}" for x, y in drawn["points"])
        ui.html(
            '<svg viewBox="-1 -1 42 16" aria-hidden="true">'
            f'<polyline points="{points}"/></svg>',
            sanitize=False,
        )


def check(
    label: str, on: bool, do: Callable[[bool], Any], key: str, hint: str = ""
) -> None:
    """Draw a labelled checkbox; ``do`` gets True or False when it is clicked."""
    with tag("label", style="check", title=hint):
        box = tag("input", type="checkbox", data_key=key, checked=on)
        box.on(
            "change",
            lambda e: do(bool(e.args)),
            js_handler="(e) => emit(e.target.checked)",
        )
        tag("span", label)


def draw_form(options: Sequence[Action], values: dict[str, str]) -> None:
    """Draw a field for each option of a command, and keep ``values`` up to date.

    values : the text of each option by name, without the empty ones; it is changed in
    place. An option without an argument is a checkbox, its text "yes".
    """

    def put(name: str, text: str) -> None:
        if text.strip():
            values[name] = text.strip()
        else:
            values.pop(name, None)

    def put_flag(name: str, is_set: bool) -> None:
        put(name, "yes" if is_set else "")

    for option in options:
        name = option.dest
        key = f"option-{name}"
        value = values.get(name, "")
        label = option_help(option)
        if option.nargs == 0:
            check(label, bool(value), partial(put_flag, name), key)
        else:
            example = str(option.metavar)
            text_field(label, value, partial(put, name), key, example)


def option_help(option: Action) -> str:
    """Return the help text of a command's option, without commands."""
    return spoken(option.help or "")


def drop(text: str, *kinds: str) -> None:
    """Draw a zone to drop files on, which opens a file chooser when it is clicked.

    kinds : what the chooser offers, keys of ENDINGS; its first one names the zone. The
    script workbench.js sends files to the server, from wherever they are dropped.
    """
    with tag("label", style="drop"):
        endings = [ending for kind in kinds for ending in ENDINGS[kind]]
        files = {"type": "file", "accept": ",".join(endings), "data_send": ""}
        tag(
            "input",
            data_key=f"drop-{kinds[0]}",
            aria_label=text,
            multiple=True,
            **files,
        )
        tag("strong", text)
        shown = f"files: {', '.join(sorted(endings))}"
        tag("span", f"or choose {shown if len(kinds) == 1 else 'all of them at once'}")


def details(title: str, key: str, on: bool = False) -> Any:
    """Draw a section that unfolds on a click; fill it in a ``with`` statement.

    on : whether it is unfolded at first.
    """
    with tag("details", open=on) as element_made:
        tag("summary", title, data_key=key)
    return element_made


def table(shown: Table, caption: str = "") -> None:
    """Draw a table as one HTML element.

    Separate elements for its cells would slow every redraw, since the browser compares
    all elements.
    """
    ui.html(framed(shown, caption), sanitize=False)


def judged(models: Sequence[ModelStep]) -> None:
    """Draw a table of how good models are, a row for each."""
    numbered = enumerate(models, start=1)
    names = [f"{k}. {m.label}" if len(models) > 1 else m.label for k, m in numbered]
    rows = [
        (name, model.comparison["verdict"]["grade"], model.facts)
        for name, model in zip(names, models, strict=True)
    ]
    table(model_table(rows), "Models judged")


def chart(options: Mapping[str, Any], label: str) -> Any:
    """Draw a plotly chart; ``label`` is its text for screen readers."""
    plot = ui.plotly(dict(options)).classes("chart")
    plot.props.update({"role": "img", "aria-label": label})
    return plot
