"""What a section of the report is, and the few shapes of markup that sections are made of."""

import base64
import gzip
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.comparison import Comparison, still_missing
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.where_it_fails import JointFailure
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.verdict import Verdict
from sdp_vs_penalty.reports.figure import Figure
from sdp_vs_penalty.reports.pictures import LOOK as PICTURES
from sdp_vs_penalty.reports.plots import styled
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.preprocessing import Rows
from sdp_vs_penalty.simulation.follow import Following


@dataclass(frozen=True)
class Material:
    """Everything that the sections show, computed once.

    models : by name, in the order in which effects were added; the last one is looked at closely;
    plant : that one without its drives, whose torque a log without torque is given; judged : of each
    model the filtered rows of each run, and their modelled torque (M, n); failures : of the first model
    and of the last; checks : of each run, what Issue.to_dict() says; commands : that made this report;
    forward : the last model run forward, or the sentence why it cannot; diagnosis : of one of the
    models, where there is one.
    """

    models: Mapping[str, Estimate]
    plant: Estimate
    measurements: Measurements
    comparisons: Sequence[Comparison]
    judged: Mapping[str, Sequence[tuple[Rows, Array]]]
    failures: Mapping[str, Sequence[JointFailure]]
    checks: Mapping[str, Sequence[Mapping[str, Any]]]
    commands: Sequence[str]
    forward: Following | str
    diagnosis: Diagnosis | None = None

    @property
    def last(self) -> Estimate:
        return list(self.models.values())[-1]

    @property
    def verdict(self) -> Verdict:
        """That of the last model."""
        ahead = "" if isinstance(self.forward, str) else self.forward.verdict
        missing = "" if self.diagnosis is None else still_missing(self.diagnosis, self.last)
        return self.comparisons[-1].verdict_with(missing, ahead)

    @property
    def first_name(self) -> str:
        return next(iter(self.models))

    @property
    def last_name(self) -> str:
        return list(self.models)[-1]


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

    numbers_from : columns from there on are numbers and stand right; caption : what it is, for those who
    do not see it; style : its CSS classes; mark : a column of words, each the class of its row.
    """

    def cells(row: Sequence[object], head: bool) -> str:
        tags = ("th scope=col" if head else "td" if k else "th scope=row" for k in range(len(row)))
        sides = (" class=number" if k >= numbers_from else "" for k in range(len(row)))
        both = zip(tags, sides, row, strict=True)
        return "".join(f"<{tag}{side}>{marked(cell)}</{tag[:2]}>" for tag, side, cell in both)

    looks = ("" if mark is None else f" class={escape(str(row[mark]))}" for row in rows)
    body = "".join(f"<tr{look}>{cells(row, False)}</tr>" for look, row in zip(looks, rows, strict=True))
    head = f"<thead><tr>{cells(headings, True)}</tr></thead>"
    return framed(caption, f'<table class="{style}">{head}<tbody>{body}</tbody></table>')


def framed(caption: str, inner: str) -> str:
    """A table in a frame that scrolls."""
    named = f' role="region" aria-label="{escape(caption)}"' if caption else ""
    return f'<div class="wide" tabindex="0"{named}>{inner}</div>'


def figure(plot: Figure, caption: str = "", height: int = 215, group: str = "") -> str:
    """A figure as data, which the page's script draws when it is about to be seen; those of a
    group are zoomed in time together, and a name that is hidden in one is hidden in all."""
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


#: How the page looks, and what draws a figure once it is about to be seen, one at a time.
_STYLE, _DRAW = (f"\n{(Path(__file__).parent / name).read_text()}" for name in ("look.css", "draw.js"))
_STYLE = f"{_STYLE}\n{PICTURES}"


def page(title: str, sections: Sequence[tuple[str, str, str]], script: str) -> str:
    """A whole HTML document; sections : anchor, title and body, in which everything is escaped;
    ``script`` is plotly's, embedded once."""
    links = "".join(f'<a href="#{at}">{escape(name)}</a>' for at, name, _ in sections)
    bodies = "".join(
        f'<section id="{at}"><h2>{escape(name)}</h2>{body}</section>' for at, name, body in sections
    )
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        # Nothing is loaded from anywhere, whatever the data say.
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        "script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; img-src data: blob:\">"
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>"
        f"<body><main><h1>{escape(title)}</h1><nav>{links}</nav>{bodies}</main>"
        # Last, so that text and tables are there before the script is unpacked and read.
        f'<script type="application/gzip" id="plotly">{packed(_unwrapped(script))}</script>'
        f"<script>{_DRAW}</script></body></html>\n"
    )


def _unwrapped(script: str) -> str:
    """Plotly's script without the function around it, which a browser reads twice: 2.1 s, not 1.3."""
    head, begins, rest = script.partition("() => {\n")
    body, ends, _ = rest.rpartition("return Plotly;")
    known = begins and ends and body.startswith('"use strict";var Plotly=')
    return f"{head[: head.find('*/') + 2]}\n{body}" if known else script
