"""Plain HTML controls for NiceGUI: what a browser makes accessible by itself.

Options of the command line are fields made from its verbs, not listed again.
"""

from argparse import Action
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from nicegui import ui
from nicegui.elements.mixins.text_element import TextElement

from sdp_vs_penalty.page.model_step import ModelStep
from sdp_vs_penalty.page.sessions import SUFFIXES
from sdp_vs_penalty.render.pieces import framed
from sdp_vs_penalty.render.tables import judged_table
from sdp_vs_penalty.results.table import Table

Handler = Callable[..., Any]


def tag(
    name: str,
    text: str = "",
    style: str = "",
    **attributes: Any,
) -> Any:
    """An element with escaped text; ``style`` are its CSS classes, ``for_`` and
    ``aria_label`` work; an attribute that is False is left out."""
    element_made = TextElement(tag=name, text=text).classes(style)
    attributes_given = {
        key.rstrip("_").replace("_", "-"): value for key, value in attributes.items()
    }
    element_made.props.update(
        {key: value for key, value in attributes_given.items() if value is not False}
    )
    return element_made


def note(text: str) -> None:
    """A paragraph beside the matter."""
    tag("p", text, "soft")


def button(
    text: str,
    do: Handler,
    key: str,
    style: str = "",
    **attributes: Any,
) -> Any:
    """A button; key : by which focus finds it again after a redraw."""
    element_made = tag(
        "button",
        text,
        f"action {style}",
        type="button",
        data_key=key,
        **attributes,
    )
    return element_made.on("click", lambda _: do(), args=[])


def tile(
    name: str, caption: str, do: Handler, key: str, style: str = "", **attributes: Any
) -> None:
    """A large button with a name and what it stands for."""
    with button("", do, key, f"tile {style}", **attributes):
        tag("strong", name)
        tag("span", caption)


def tiles(label: str) -> Any:
    """A group of tiles, to be filled by ``with``."""
    return tag("div", style="tiles", role="group", aria_label=label)


def choice(
    label: str,
    options: Iterable[tuple[str, str] | str],
    value: str,
    do: Callable[[str], Any],
    key: str,
    hidden_label: bool = False,
) -> None:
    """A labelled <select>; options are (value, text), or texts that are their own
    values."""
    with tag("label", style="field"):
        tag("span", label, "unseen" if hidden_label else "")
        with tag("select", data_key=key, aria_label=label) as select:
            for option in options:
                name, text = (option, option) if isinstance(option, str) else option
                tag("option", text, value=name, selected=name == value)
        select.on(
            "change",
            lambda e: do(str(e.args)),
            js_handler="(e) => emit(e.target.value)",
        )


def number(
    label: str,
    value: int,
    do: Callable[[int], Any],
    key: str,
) -> None:
    """A labelled field for a whole number from 0."""

    def take(text: str) -> None:
        with suppress(ValueError):  # the browser shows that it is no number
            do(max(0, int(text)))

    text_field(
        label,
        str(value),
        take,
        key,
        style="field short",
        type="number",
        min="0",
        step="1",
    )


def text_field(
    label: str,
    value: str,
    do: Callable[[str], Any],
    key: str,
    example: str = "",
    **how: Any,
) -> None:
    """A labelled line of text; how : attributes of the <input>, and ``style`` of both."""
    with tag("label", style=how.pop("style", "field")):
        tag("span", label)
        field = tag(
            "input",
            data_key=key,
            value=value,
            placeholder=example,
            **{"type": "text", **how},
        )
        field.on(
            "change",
            lambda e: do(str(e.args)),
            js_handler="(e) => emit(e.target.value)",
        )


def slider(
    label: str,
    value: str,
    do: Callable[[int], Any],
    key: str,
    least: str,
    most: str,
) -> None:
    """A handle to drag between two whole numbers; heard when it is let go."""
    with tag("label", style="field"):
        tag("span", label)
        handle = tag(
            "input",
            type="range",
            data_key=key,
            aria_label=label,
            value=value,
            min=least,
            max=most,
            step="1",
        )
        handle.on(
            "change",
            lambda e: do(int(e.args)),
            js_handler="(e) => emit(e.target.value)",
        )


def check(
    label: str,
    on: bool,
    do: Callable[[bool], Any],
    key: str,
    hint: str = "",
) -> None:
    """A labelled checkbox."""
    with tag("label", style="check", title=hint):
        box = tag("input", type="checkbox", data_key=key, checked=on)
        box.on(
            "change",
            lambda e: do(bool(e.args)),
            js_handler="(e) => emit(e.target.checked)",
        )
        tag("span", label)


def draw_form(options: Sequence[Action], values: dict[str, str]) -> None:
    """A field for each of a verb's options (cli/options.py), with what is written in
    it; ``values`` follows, without the empty ones."""

    def put(name: str, text: str) -> None:
        if text.strip():
            values[name] = text.strip()
        else:
            values.pop(name, None)

    for o in options:
        key = f"option-{o.dest}"
        now = values.get(o.dest, "")
        write = partial(put, o.dest)
        if o.nargs == 0:
            check(
                option_help(o),
                bool(now),
                lambda on, write=write: write("yes" * on),  # type: ignore[misc]
                key,
            )
        else:
            text_field(
                option_help(o),
                now,
                write,
                key,
                str(o.metavar),
            )


def option_help(option: Action) -> str:
    """What an option is, without the marks of code."""
    return (option.help or "").replace("`", "")


def drop(text: str, kind: str) -> None:
    """A zone to drop files of a kind of SUFFIXES on, which is also a file chooser;
    workbench.js sends them. Several runs at once, else one file."""
    accept = SUFFIXES[kind]
    several = kind == "runs"
    files = f"choose files: {', '.join(sorted(accept))}"
    hint = f"or {files}" if several else "drop a file here, or choose one"
    with tag("label", style="drop", data_drop=kind):
        files_of = {
            "type": "file",
            "accept": ",".join(accept),
            "data_send": kind,
        }
        tag(
            "input",
            data_key=f"drop-{kind}",
            aria_label=text,
            multiple=several,
            **files_of,
        )
        tag("strong", text)
        tag("span", hint)


def details(
    title: str,
    key: str,
    on: bool = False,
) -> Any:
    """Something that opens on demand, to be filled by ``with``; on : it is open."""
    with tag("details", open=on) as element_made:
        tag("summary", title, data_key=key)
    return element_made


def table(shown: Table, caption: str = "") -> None:
    """A table, as one element however many cells: a browser looks at every element when
    any one changes."""
    ui.html(framed(shown, caption), sanitize=False)


def judged(models: Sequence[ModelStep]) -> None:
    """How good models are, a row each."""
    numbered = enumerate(models, start=1)
    names = [f"{k} {m.label}" if len(models) > 1 else m.label for k, m in numbered]
    rows = [
        [
            name,
            *model.judged[1:],
        ]
        for name, model in zip(names, models, strict=True)
    ]
    table(judged_table(rows), "Models judged")


def figures(pairs: Sequence[tuple[str, str]]) -> None:
    """Numbers beside each other, each under its name."""
    with tag("dl", style="figures"):
        for name, value in pairs:
            with tag("div"):
                tag("dt", name)
                tag("dd", value)


def chart(options: Mapping[str, Any], label: str) -> Any:
    """A plotly chart with a text alternative."""
    plot = ui.plotly(dict(options)).classes("chart")
    plot.props.update({"role": "img", "aria-label": label})
    return plot
