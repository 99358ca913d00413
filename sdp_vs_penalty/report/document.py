"""The page around the sections: one file, no request to anywhere."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from sdp_vs_penalty.report.section import Section

_STYLE = """
:root { color-scheme: light dark; --ink: #1b1b1b; --paper: #ffffff; --line: #d5d5d5; --soft: #f4f4f4; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e8e8e8; --paper: #16181b; --line: #3a3d42; --soft: #22252a; }
}
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 72rem; padding: 1rem 1.2rem 4rem; font: 16px/1.5 system-ui, sans-serif;
  color: var(--ink); background: var(--paper); }
h1 { font-size: 1.6rem; margin: 0.6rem 0; } h2 { font-size: 1.25rem; margin: 2.2rem 0 0.6rem; }
h3 { font-size: 1rem; margin: 1rem 0 0.4rem; }
nav { display: flex; flex-wrap: wrap; gap: 0.3rem 1rem; border-block: 1px solid var(--line);
  padding: 0.5rem 0; }
a { color: inherit; } a:focus-visible, summary:focus-visible { outline: 3px solid #0072b2; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: 0.88rem; margin: 0.6rem 0; }
th, td { padding: 0.25rem 0.7rem 0.25rem 0; text-align: left; border-bottom: 1px solid var(--line);
  vertical-align: top; } .number { text-align: right; font-variant-numeric: tabular-nums; }
figure { margin: 1rem 0; } figure + figure { margin-top: 0; }
figcaption { font-size: 0.88rem; opacity: 0.8; }
pre { background: var(--soft); padding: 0.8rem; overflow-x: auto; font-size: 0.85rem; }
.finding { border-left: 4px solid var(--line); padding: 0.3rem 0.8rem; margin: 0.5rem 0;
  background: var(--soft); }
.finding.error { border-color: #d55e00; } .finding.warning { border-color: #e69f00; }
.finding span { display: block; font-size: 0.88rem; opacity: 0.85; }
@media print {
  :root { color-scheme: light; --ink: #000000; --paper: #ffffff; --line: #bbbbbb; --soft: #f4f4f4; }
  body { max-width: none; padding: 0; font-size: 11pt; }
  nav { display: none; }
  h2, h3, summary { break-after: avoid; }
  figure, tr, pre, .finding { break-inside: avoid; }
  figure { zoom: var(--on-paper); }
  .wide, pre { overflow: visible; } pre { white-space: pre-wrap; }
  details::details-content { content-visibility: visible; display: block; }
}
"""

#: Draws a figure once it is about to be seen, and one at a time: the text can be read meanwhile.
_DRAW = """
(() => {
  const waiting = new Set(document.querySelectorAll(".plot")), near = [], groups = {};
  const draw = place => {
    if (!waiting.delete(place)) return;
    const given = JSON.parse(place.nextElementSibling.textContent);
    Plotly.newPlot(place, given.data, given.layout, {displayModeBar: false, responsive: true});
    const {linked, group} = given.layout.meta || {};
    if (linked) link(place, linked);
    if (group) join(place, groups[group] ||= {places: [], span: {}, hidden: []});
  };
  // Figures of a group show the same stretch of time and hide the same names.
  const join = (place, group) => {
    if (Object.keys(group.span).length) Plotly.relayout(place, group.span);
    for (const [change, traces] of group.hidden) Plotly.restyle(place, change, traces);
    group.places.push(place);
    const tell = async (what, ...change) => {
      if (group.telling) return;
      group.telling = true;
      for (const other of group.places) if (other !== place) await Plotly[what](other, ...change);
      group.telling = false;
    };
    place.on("plotly_relayout", change => {
      const span = Object.fromEntries(Object.entries(change).filter(([name]) => name[0] === "x"));
      if (!Object.keys(span).length || group.telling) return;
      group.span = span;
      tell("relayout", span);
    });
    place.on("plotly_restyle", ([change, traces]) => {
      if (!group.telling) group.hidden.push([change, traces]);
      tell("restyle", change, traces);
    });
  };
  // Of every so many traces the first and the last show the same rows, selected together.
  const link = (place, every) => {
    const mark = event => {
      const rows = {};
      for (const p of (event && event.points) || []) {
        const k = p.curveNumber;
        if (k % every !== 1) (rows[Math.floor(k / every)] ||= new Set()).add(p.pointNumber);
      }
      const none = Object.keys(rows).length === 0;
      const marked = place.data.map((_, k) => none ? null : [...(rows[Math.floor(k / every)] || [])]);
      const shown = marked.map((own, k) => k % every === 1 ? null : own);
      Plotly.restyle(place, {selectedpoints: shown});
    };
    place.on("plotly_selected", mark);
    place.on("plotly_deselect", () => mark());
  };
  const next = () => {
    draw(near.shift());
    if (near.length) setTimeout(next, 30);
  };
  const seen = new IntersectionObserver(entries => {
    const come = entries.filter(entry => entry.isIntersecting).map(entry => entry.target);
    come.forEach(place => seen.unobserve(place));
    if (near.push(...come) === come.length && come.length) setTimeout(next);
  }, {rootMargin: "100%"});
  addEventListener("beforeprint", () => {
    document.querySelectorAll("details").forEach(part => { part.open = true; });
    [...waiting].forEach(draw);
  });
  waiting.forEach(place => seen.observe(place));
})();
"""


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
