"""Pieces of HTML that report and page share: tables in frames, bars, heat maps, legends,
figures. Each function makes a context; templates in html/ lay it out."""

from __future__ import annotations

import base64
import gzip
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.where_it_fails import CAUSES
from sdp_vs_penalty.estimation.constants import CHANGES
from sdp_vs_penalty.files import read_text
from sdp_vs_penalty.formatting import change_of, number, plain_unit
from sdp_vs_penalty.render.charts import Figure, styled
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.results.templates import render
from sdp_vs_penalty.robot.arrays import Array

HERE = Path(__file__).parent / "html"
#: How bars, heat maps and legends look.
LOOK = read_text(HERE / "pictures.css")
_COLOURS = (
    "#D55E00 #56B4E9 #E69F00 #CC79A7 #009E73 #0072B2 #8A6FDF #7A5C2E #5B8C5A #A0522D"
    " #B5651D #7F9F2F #4B6F9E #C25B8A #888888"
)
#: Of each cause the colour of its stretches; the last is for those without one.
SHADES = dict(zip((*CAUSES, "no cause seen"), _COLOURS.split(), strict=True))
#: Errors that differ more than so many times from joint to joint stand on a logarithmic
#: scale.
_DWARFED = 8.0


def piece(template: str, **context: Any) -> Markup:
    """A template of html/, filled."""
    return Markup(render(template, HERE, **context))


def framed(table: Table, caption: str = "") -> Markup:
    """A table in a frame that scrolls; caption : what it is, for those who do not see
    it."""
    inner = Markup(table.html())
    return piece("framed.html", inner=inner, caption=caption or table.title)


@dataclass(frozen=True)
class _Scale:
    """Where an error stands between the left (0) and the right end (1) of a bar."""

    largest: float
    smallest: float
    is_logarithmic: bool

    @classmethod
    def of(cls, errors: Array, is_over_noise: bool) -> _Scale:
        """For errors (k,), over the noise or in their units."""
        positive = errors[errors > 0.0]
        largest = max(float(errors.max()), 1.5 if is_over_noise else 1e-300)
        smallest = float(positive.min()) if len(positive) else largest
        if is_over_noise:
            smallest = min(smallest, 1.0)
        is_logarithmic = bool(largest > _DWARFED * np.median(errors)) and smallest > 0.0
        return cls(largest, 0.5 * smallest, is_logarithmic)

    def place(self, error: float) -> str:
        """As a CSS number."""
        if not self.is_logarithmic:
            return f"{error / self.largest:.4f}"
        above = np.log(max(error, self.smallest) / self.smallest)
        return f"{above / np.log(self.largest / self.smallest):.4f}"


def bars(
    before: Sequence[float] | Array,
    after: Sequence[float] | Array | None,
    floor: Sequence[float | None] | Array | None,
    units: Sequence[str],
    joints: Sequence[int] = (),
    what: str = "Error",
    chosen: int | None = None,
) -> Markup:
    """A bar a joint, cut at the noise floor: the error over it, before in orange
    and after in blue.

    before, after, floor (n,) [N m or N] : RMS errors, after None where there is one
    model alone; floor, or one of it, None where it is not known: errors stand in their
    units then, against the largest; joints : their numbers, by default 1, 2, ...; what
    : the error's name; chosen : the joint (from 0) that is shown where each is a
    button.
    """
    is_known = floor is not None and all(floor)
    noise = np.array(floor if is_known else [1.0] * len(before), float)
    old_errors = np.array(before, float) / noise
    new_errors = np.array(before if after is None else after, float) / noise
    scale = _Scale.of(np.concatenate([old_errors, new_errors]), is_known)
    numbers = joints or range(1, len(old_errors) + 1)
    rows = []
    for j, number_of_joint in enumerate(numbers):
        row = _bar(old_errors[j], new_errors[j], scale, after is not None, is_known)
        row |= {"name": f"joint {number_of_joint}", "number": j + 1}
        row |= {"is_chosen": j == chosen}
        if not is_known:
            row["value"] += f" {plain_unit(units[j])}"
        rows.append(row)
    return piece(
        "bars.html",
        caption=_caption_of_bars(what, scale, is_known, after is not None),
        rows=rows,
        has_buttons=chosen is not None,
        has_change=after is not None,
    )


def _bar(
    old: float, new: float, scale: _Scale, has_change: bool, is_known: bool
) -> dict[str, Any]:
    """The shapes of one joint's bar and the numbers beside it."""
    sizes = {"before": old, "after": new} if has_change else {"alone": new}
    if is_known:
        sizes["noise"] = 1.0
    shapes = {kind: scale.place(size) for kind, size in sizes.items()}
    if not has_change:
        return {"shapes": shapes, "value": number(new), "change": "", "kind": ""}
    return {
        "shapes": shapes,
        "value": f"{number(old)} → {number(new)}",
        "change": change_of(old, new),
        "kind": _kind_of_change(old, new),
    }


def _caption_of_bars(what: str, scale: _Scale, is_known: bool, has_change: bool) -> str:
    caption = f"{what} of each joint, RMS; noise floor unknown"
    if is_known:
        caption = f"{what} of each joint, in multiples of its noise (grey band)"
    if scale.is_logarithmic:
        caption += "; logarithmic scale"
    if has_change:
        caption += "; before (orange), after (blue)"
    return caption


def _kind_of_change(before: float, after: float) -> str:
    change = after / before - 1.0 if before > 0.0 else 0.0
    if change < -CHANGES:
        return "better"
    return "worse" if change > CHANGES else "same"


def found_shares(diagnosis: Diagnosis | None, n: int) -> dict[str, list[float]]:
    """By sure finding the share of each joint's error variance on data left out that it
    takes away."""
    shares: dict[str, list[float]] = {}
    for finding in () if diagnosis is None else diagnosis.effects:
        if not finding.torque_is_certain:
            continue
        row = shares.setdefault(f"found: {finding.effect}", [0.0] * n)
        for j in [j - 1 for j in finding.joints] or range(n):
            row[j] = max(row[j], finding.explained_share(j))
    return shares


def heat_rows(
    failures: Sequence[Mapping[str, Any]], shares_found: Mapping[str, Sequence[float]]
) -> list[tuple[str, list[float]]]:
    """Causes and findings with each joint's share, those that explain nothing anywhere
    left out.

    failures : of each joint `held_out_shares`, as JointFailure.to_dict() has it."""
    names = failures[0]["held_out_shares"] if failures else {}
    shares_by_row = {
        **shares_found,
        **{name: [f["held_out_shares"][name] for f in failures] for name in names},
    }
    return [
        (name, list(shares))
        for name, shares in shares_by_row.items()
        if _per_cent(max(shares))
    ]


def _per_cent(share: float) -> str:
    """Nothing for what rounds to zero."""
    rounded = round(100.0 * share)
    return str(rounded) if rounded > 0 else ""


def heat_map(
    title: str,
    rows: Sequence[tuple[str, Sequence[float]]],
    n: int,
    shown_by: Mapping[str, str] | None = None,
) -> Markup:
    """A table whose rows are causes, whose columns joints; darker explains more of the
    joint's error.

    shown_by : the signal that shows a cause: cells are buttons then (data-joint,
    data-signal)."""
    cells = [
        {
            "name": name,
            "signal": "" if shown_by is None else shown_by.get(name, ""),
            "shares": [
                {"text": _per_cent(x), "share": f"{x:.2f}", "percent": f"{100 * x:.0f}"}
                for x in shares
            ],
        }
        for name, shares in rows
    ]
    return piece(
        "heat.html",
        title=title,
        rows=cells,
        joints=list(range(1, n + 1)),
        has_buttons=shown_by is not None,
    )


def legend(causes: Sequence[str]) -> Markup:
    """The colours of the causes that are shown."""
    chips = [(c, SHADES.get(c, SHADES["no cause seen"])) for c in causes]
    return piece("legend.html", chips=chips)


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
            "x0": start,
            "x1": stop,
            "y0": 0,
            "y1": 1,
            "fillcolor": SHADES.get(cause, SHADES["no cause seen"]),
        }
        for panel in ("", "2")
        for start, stop, cause in stretches
    ]


def figure(
    plot: Figure, caption: str = "", height: int = 215, group: str = ""
) -> Markup:
    """A figure as data, which the report's script draws when it is about to be seen;
    those of a group are zoomed in time together, and a name that is hidden in one is
    hidden in all."""
    if group:
        plot.update_layout(meta={"group": group})
    data = packed(styled(plot, height).to_json())
    return piece("figure.html", data=data, caption=caption, height=height)


def packed(text: str) -> str:
    """Compressed, as text that cannot end a script element; draw.js unpacks it."""
    return base64.b64encode(gzip.compress(text.encode(), 4, mtime=0)).decode()
