"""The markup that the report's sections and the page are made of: tables, error over
noise as bars, causes as a heat map."""

import base64
import gzip
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.diagnosis.where_it_fails import CAUSES
from sdp_vs_penalty.estimation.constants import CHANGES
from sdp_vs_penalty.formatting import change_of, plain_unit
from sdp_vs_penalty.reports.plots import Figure, styled
from sdp_vs_penalty.robot.arrays import Array

#: How bars and legends look.
LOOK = (Path(__file__).parent / "pictures.css").read_text()
_COLOURS = (
    "#D55E00 #56B4E9 #E69F00 #CC79A7 #009E73 #0072B2 #8A6FDF #7A5C2E #5B8C5A #A0522D"
    " #B5651D #7F9F2F #4B6F9E #C25B8A #888888"
)
#: Of each cause the colour of its stretches; the last is for those without one.
SHADES = dict(zip((*CAUSES, "no cause seen"), _COLOURS.split(), strict=True))


def bars(
    before: Sequence[float] | Array,
    after: Sequence[float] | Array | None,
    floor: Sequence[float | None] | Array | None,
    units: Sequence[str],
    joints: Sequence[int] = (),
    what: str = "Error",
    chosen: int | None = None,
) -> str:
    """A bar a joint, cut at the noise floor: the error over it, before in grey and
    after in colour.

    before, after, floor (n,) [N m or N] : RMS errors, after None where there is one
    model alone; floor, or one of it, None where it is not known: errors stand in their
    units then, against the largest; joints : their numbers, by default 1, 2, ...; what
    : the error's name; chosen : the joint (from 0) that is shown where each is a
    button.
    """
    known = floor is not None and all(floor)
    scale = np.array(floor if known else [1.0] * len(before), float)
    olds = np.array(before, float) / scale
    news = np.array(before if after is None else after, float) / scale
    largest = max(*olds, *news, 1.5 if known else 0.0, 1e-300)
    rows = []
    for j, (old, new) in enumerate(zip(olds, news, strict=True)):
        unit = "" if known else f" {plain_unit(units[j])}"
        value_words = (
            f"{new:.3g}{unit}" if after is None else f"{old:.3g} → {new:.3g}{unit}"
        )
        change = new / old - 1.0 if old > 0.0 else 0.0
        kind = (
            "better" if change < -CHANGES else "worse" if change > CHANGES else "same"
        )
        note = (
            ""
            if after is None
            else f'<td class="change {kind}">{change_of(old, new)}</td>'
        )
        sizes = {"alone": new} if after is None else {"before": old, "after": new}
        sizes |= {"noise": 1.0} if known else {}
        shapes = "".join(
            f'<i class="{k}" style="--wide:{x / largest:.4f}"></i>'
            for k, x in sizes.items()
        )
        name = f"joint {joints[j] if joints else j + 1}"
        if chosen is not None:
            on = str(j == chosen).lower()
            at = f'data-key="joint-{j + 1}" data-joint="{j + 1}" aria-pressed="{on}"'
            name = f'<button type="button" class="action cell" {at}>{name}</button>'
        rows.append(
            f'<tr><th scope="row">{name}</th><td class="drawn">{shapes}</td>'
            f'<td class="number">{value_words}</td>{note}</tr>'
        )
    caption = "over the noise floor of each joint; grey: noise" if known else ""
    caption = f"{what} {caption or '(RMS) of each joint; noise floor unknown'}"
    caption += "" if after is None else "; upper bar before, lower after"
    return (
        "<table"
        f' class="bars"><caption>{caption}</caption><tbody>{"".join(rows)}</tbody></table>'
    )


def found_shares(diagnosis: Any, n: int) -> dict[str, list[float]]:
    """By sure finding the share of each joint's held-out error variance that it takes
    away."""
    out: dict[str, list[float]] = {}
    for f in () if diagnosis is None else diagnosis.effects:
        row = (
            out.setdefault(f"found: {f.effect}", [0.0] * n)
            if f.torque_is_certain
            else []
        )
        for j in [j - 1 for j in f.joints] or range(n) if row else ():
            a = f.held_out_rmse_before[j]
            b = f.held_out_rmse_after[j]
            row[j] = max(row[j], 1.0 - (b / a) ** 2 if a > 0.0 else 0.0)
    return out


def heat_rows(
    failures: Sequence[Mapping[str, Any]], shares_found: Mapping[str, Sequence[float]]
) -> list[tuple[str, list[float]]]:
    """Causes and findings with each joint's share, those that explain nothing anywhere
    left out.

    failures : of each joint `held_out_shares`, as JointFailure.to_dict() has it."""
    names = failures[0]["held_out_shares"] if failures else {}
    cells_by_row = {
        **shares_found,
        **{name: [f["held_out_shares"][name] for f in failures] for name in names},
    }
    return [
        (name, list(shares))
        for name, shares in cells_by_row.items()
        if _per_cent(max(shares))
    ]


def _per_cent(share: float) -> str:
    """Nothing for what rounds to zero."""
    per_cent = round(100.0 * share)
    return str(per_cent) if per_cent > 0 else ""


def heat_map(
    title: str,
    rows: Sequence[tuple[str, Sequence[float]]],
    n: int,
    shown_by: Mapping[str, str] | None = None,
) -> str:
    """A table whose rows are causes, whose columns joints; darker explains more of the
    joint's error.

    shown_by : the signal that shows a cause: cells are buttons then (data-joint,
    data-signal)."""

    def cell(name: str, j: int, share: float) -> str:
        share_words = _per_cent(share)
        if shown_by is None:
            return share_words
        label = f"joint {j}, {escape(name)}: {100.0 * share:.0f} %"
        look = (
            f'data-key="heat-{escape(name)}-{j}" data-signal="{shown_by.get(name, "")}"'
        )
        kind = f'type="button" class="action cell" aria-label="{label}"'
        return f'<button {kind} data-joint="{j}" {look}>{share_words}</button>'

    heads = "".join(f'<th scope="col">{j + 1}</th>' for j in range(n))
    body = ""
    for name, shares in rows:
        cells = "".join(
            f'<td style="--share:{s:.2f}">{cell(name, j, s)}</td>'
            for j, s in enumerate(shares, 1)
        )
        body += f'<tr><th scope="row">{escape(name)}</th>{cells}</tr>'
    if not rows:
        body = (
            f'<tr><td colspan="{n + 1}">No cause explains 1 % of any joint\'s'
            " error.</td></tr>"
        )
    head = f'<thead><tr><th scope="col">cause \\ joint</th>{heads}</tr></thead>'
    unseen = "" if shown_by is None else ' class="unseen"'
    caption = f"<caption{unseen}>{escape(title)}</caption>"
    return f'<table class="heat">{caption}{head}<tbody>{body}</tbody></table>'


def legend(causes: Sequence[str]) -> str:
    """The colours of the causes that are shown."""
    chips = "".join(
        "<span><i"
        f' style="background:{SHADES.get(c, SHADES["no cause seen"])}"></i>{escape(c)}</span>'
        for c in causes
    )
    return (
        f'<p class="legend">Shaded where the error is large: {chips}</p>'
        if causes
        else ""
    )


def shades(stretches: Sequence[tuple[float, float, str]]) -> list[dict[str, Any]]:
    """Plotly shapes behind the curves of both panels of a torque's figure; stretches :
    first and last instant on the figure, and the cause."""
    return [
        {
            "type": "rect",
            "layer": "below",
            "line": {"width": 0},
            "opacity": 0.18,
            "xref": f"x{panel}",
            "yref": f"y{panel} domain",
            "x0": a,
            "x1": b,
            "y0": 0,
            "y1": 1,
            "fillcolor": SHADES.get(cause, SHADES["no cause seen"]),
        }
        for panel in ("", "2")
        for a, b, cause in stretches
    ]


def text(sentence: str) -> str:
    return f"<p>{marked(sentence)}</p>"


def marked(sentence: object) -> str:
    """Escaped; what stands between backticks as code."""
    return re.sub(r"`([^`]*)`", r"<code>\1</code>", escape(str(sentence)))


def table(
    headings: Sequence[str],
    rows: Sequence[Sequence[object]],
    *,
    numbers_from: int = 1,
    caption: str = "",
    style: str = "",
    mark: int | None = None,
) -> str:
    """A table that scrolls inside its frame; its first column names the rows.

    numbers_from : columns from there on are numbers and stand right; caption : what it
    is, for those who do not see it; style : its CSS classes; mark : a column of words,
    each the class of its row.
    """

    def cells(row: Sequence[object], head: bool) -> str:
        tags = (
            "th scope=col" if head else "td" if k else "th scope=row"
            for k in range(len(row))
        )
        sides = (" class=number" if k >= numbers_from else "" for k in range(len(row)))
        both = zip(tags, sides, row, strict=True)
        return "".join(
            f"<{tag}{side}>{marked(cell)}</{tag[:2]}>" for tag, side, cell in both
        )

    looks = ("" if mark is None else f" class={escape(str(row[mark]))}" for row in rows)
    body = "".join(
        f"<tr{look}>{cells(row, False)}</tr>"
        for look, row in zip(looks, rows, strict=True)
    )
    head = f"<thead><tr>{cells(headings, True)}</tr></thead>"
    return framed(
        caption, f'<table class="{style}">{head}<tbody>{body}</tbody></table>'
    )


def framed(caption: str, inner: str) -> str:
    """A table in a frame that scrolls."""
    named = f' role="region" aria-label="{escape(caption)}"' if caption else ""
    return f'<div class="wide" tabindex="0"{named}>{inner}</div>'


def figure(plot: Figure, caption: str = "", height: int = 215, group: str = "") -> str:
    """A figure as data, which the page's script draws when it is about to be seen;
    those of a group are zoomed in time together, and a name that is hidden in one is
    hidden in all."""
    if group:
        plot.update_layout(meta={"group": group})
    data = packed(styled(plot, height).to_json())
    return (
        f'<figure><div class="plot" style="height:{height}px"></div>'
        f'<script type="application/gzip">{data}</script>'
        + (f"<figcaption>{escape(caption)}</figcaption>" if caption else "")
        + "</figure>"
    )


def packed(text: str) -> str:
    """Compressed, as text that cannot end a script element; draw.js unpacks it."""
    return base64.b64encode(gzip.compress(text.encode(), 4, mtime=0)).decode()


#: How the page looks, and what draws a figure once it is about to be seen, one at a
#: time.
_STYLE = f"\n{(Path(__file__).parent / 'look.css').read_text()}"
_DRAW = f"\n{(Path(__file__).parent / 'draw.js').read_text()}"
_STYLE = f"{_STYLE}\n{LOOK}"


def page(title: str, sections: Sequence[tuple[str, str, str]], script: str) -> str:
    """A whole HTML document; sections : anchor, title and body, in which everything is
    escaped; ``script`` is plotly's, embedded once."""
    links = ""
    bodies = ""
    for at, name, body in sections:
        links += f'<a href="#{at}">{escape(name)}</a>'
        bodies += f'<section id="{at}"><h2>{escape(name)}</h2>{body}</section>'
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        # Nothing is loaded from anywhere, whatever the data say.
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        "script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; img-src"
        ' data: blob:">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>"
        f"<body><main><h1>{escape(title)}</h1><nav>{links}</nav>{bodies}</main>"
        # Last, so that text and tables are there before the script is unpacked and
        # read.
        '<script type="application/gzip"'
        f' id="plotly">{packed(_unwrapped(script))}</script>'
        f"<script>{_DRAW}</script></body></html>\n"
    )


def _unwrapped(script: str) -> str:
    """Plotly's script without the function around it, which a browser reads twice: 2.1
    s, not 1.3."""
    head, begins, tail = script.partition("() => {\n")
    body, ends, _ = tail.rpartition("return Plotly;")
    known = begins and ends and body.startswith('"use strict";var Plotly=')
    return f"{head[: head.find('*/') + 2]}\n{body}" if known else script
