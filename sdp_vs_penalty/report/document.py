"""The page around the sections: one file, no request to anywhere."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

from sdp_vs_penalty.report.section import Section

#: How the page looks, and what draws a figure once it is about to be seen, one at a time.
_STYLE, _DRAW = (f"\n{(Path(__file__).parent / name).read_text()}" for name in ("look.css", "draw.js"))


def page(title: str, sections: Sequence[Section], script: str) -> str:
    """A whole HTML document; ``script`` is plotly's, embedded once."""
    links = "".join(f'<a href="#{s.anchor}">{escape(s.title)}</a>' for s in sections)
    bodies = "".join(
        f'<section id="{s.anchor}"><h2>{escape(s.title)}</h2>{s.body}</section>' for s in sections
    )
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        # Nothing is loaded from anywhere, whatever the data say.
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        "script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; img-src data: blob:\">"
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>"
        f"<body><main><h1>{escape(title)}</h1><nav>{links}</nav>{bodies}</main>"
        # Last, so that text and tables are there before four megabytes of script are read.
        f"<script>{_unwrapped(script)}</script><script>{_DRAW}</script></body></html>\n"
    )


def _unwrapped(script: str) -> str:
    """Plotly's script without the function around it, which a browser would read twice."""
    head, begins, rest = script.partition("() => {\n")
    body, ends, _ = rest.rpartition("return Plotly;")
    known = begins and ends and body.startswith('"use strict";var Plotly=')
    return f"{head[: head.find('*/') + 2]}\n{body}" if known else script
