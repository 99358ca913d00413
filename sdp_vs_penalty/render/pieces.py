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
from sdp_vs_penalty.diagnosis.where_it_fails import CAUSES, Failures
from sdp_vs_penalty.effects import effect_name
from sdp_vs_penalty.estimation.constants import CHANGES
from sdp_vs_penalty.estimation.verdict import ABOVE_NOISE, over_noise
from sdp_vs_penalty.files import read_text
from sdp_vs_penalty.formatting import amounts, change_of, number, plain_unit
from sdp_vs_penalty.render.charts import Figure, styled
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.results.templates import render
from sdp_vs_penalty.robot.arrays import Array

HERE = Path(__file__).parent / "html"
#: How bars, heat maps and legends look.
LOOK = read_text(HERE / "pictures.css")
_COLOURS = (
    "#D55E00 #56B4E9 #E69F00 #CC79A7 #009E73 #0072B2 #8A6FDF #7A5C2E #5B8C5A #A0522D"
    " #B5651D #7F9F2F #C25B8A #3C7A89 #9C6B98 #6E6A3E #888888"
)
#: Colour of the stretches of each cause; the last is for stretches without one.
SHADES = dict(zip((*CAUSES, "no cause seen"), _COLOURS.split(), strict=True))


#: Errors in multiples of the noise stand on a scale that ends here at least.
_LAST_MULTIPLE = 1.25 * ABOVE_NOISE


def piece(template: str, **context: Any) -> Markup:
    """Fill a template of html/, by its file name; every variable is escaped."""
    return Markup(render(template, HERE, **context))


def framed(table: Table, caption: str = "") -> Markup:
    """Put a table into a frame that scrolls.

    Parameters
    ----------
    caption : str
        What the table shows, for screen readers; default: its title.
    """
    inner = Markup(table.html())
    return piece("framed.html", inner=inner, caption=caption or table.title)


@dataclass(frozen=True)
class _Scale:
    """Where an error stands between the left (0) and the right end (1) of a bar, on a
    logarithmic scale: all bars of a screen have one kind of scale."""

    #: Error at the right end.
    largest: float
    #: Error at the left end.
    smallest: float

    @classmethod
    def for_errors(cls, errors: Array, is_over_noise: bool) -> _Scale:
        """Choose a scale for these errors (k,), which shows the noise and the limit of
        what is good as well where they are multiples of the noise."""
        positive = errors[errors > 0.0]
        largest = max(float(errors.max()), _LAST_MULTIPLE if is_over_noise else 1e-300)
        smallest = float(positive.min()) if len(positive) else largest
        if is_over_noise:
            smallest = min(smallest, 1.0)
        return cls(largest, 0.5 * smallest)

    def place(self, error: float) -> str:
        """Return where an error stands on the bar, 0 to 1 from left to right, as a
        CSS number.
        """
        above = np.log(max(error, self.smallest) / self.smallest)
        return f"{above / np.log(self.largest / self.smallest):.4f}"


def bars(
    before: Sequence[float] | Array,
    after: Sequence[float] | Array | None,
    floor: Sequence[float | None] | Array | None,
    units: Sequence[str],
    scope: str = "",
    chosen: int | None = None,
    torque: Sequence[float] | Array = (),
    colours: str = "before (grey), after (blue)",
    other: Sequence[float] | Array | None = None,
) -> Markup:
    """Draw one bar for each joint with its error before (grey) and after a change (blue).

    Bars are in multiples of the joint's noise, or as a share of its torque where no noise
    is known; the text beside them is in N m or N.

    Parameters
    ----------
    before, after : (n,) sequence
        RMS errors [N m or N]; ``after`` is None for one model alone.
    floor : (n,) sequence or None
        RMS noise of each joint. Where one is unknown, errors stand over the torque, or
        without that in their own units.
    units : sequence of str
        Torque unit of each joint.
    scope : str
        What the errors are of, such as "on unseen motion".
    chosen : int or None
        Index of the joint that is shown, where each bar is a button; None: no buttons.
    torque : (n,) sequence
        RMS torque of each joint [N m or N]; empty: not known.
    colours : str
        What the colours are, where there is an ``after``.
    other : (n,) sequence or None
        RMS errors [N m or N] after another choice than that of ``after`` (light blue).
    """
    errors_of_both = np.array([before, before if after is None else after], float)
    errors_of_all = np.array([*errors_of_both, before if other is None else other])
    ratios = over_noise(errors_of_all, floor)
    is_known = ratios is not None
    unit = ""
    if ratios is None and len(torque) > 0 and all(torque):
        ratios, unit = 100.0 * errors_of_all / np.array(torque), " %"
    printed_errors = errors_of_all if ratios is None else ratios
    scale = _Scale.for_errors(printed_errors.ravel(), is_known)
    old_errors, new_errors, other_errors = printed_errors
    rows = []
    for j in range(len(old_errors)):
        row = _bar(
            old_errors[j],
            new_errors[j],
            scale,
            has_change=after is not None,
            is_known=is_known,
        )
        if other is not None:
            drawn = _bar(old_errors[j], other_errors[j], scale, True, is_known)
            row["shapes"]["other"] = drawn["shapes"]["after"]
            row |= {"other_change": drawn["change"], "other_kind": drawn["kind"]}
        of_models = (old_errors, new_errors) if after is not None else (new_errors,)
        sizes = [
            "below 1" if is_known and x[j] < 1.0 else number(x[j]) for x in of_models
        ]
        times = f"{' → '.join(dict.fromkeys(sizes))}{unit}"
        row["times"] = "" if ratios is None else times
        row |= {"name": f"joint {j + 1}", "number": j + 1}
        row |= {"is_chosen": j == chosen}
        errors = [before[j]] if after is None else [before[j], after[j]]
        row["amount"] = amounts(errors, plain_unit(units[j]))
        rows.append(row)
    return piece(
        "bars.html",
        caption=_caption_of_bars(
            scope,
            new_errors if is_known else None,
            bool(unit),
            "" if after is None else colours,
        ),
        rows=rows,
        has_buttons=chosen is not None,
        has_change=after is not None,
        has_other=other is not None,
    )


def _bar(
    old: float, new: float, scale: _Scale, has_change: bool, is_known: bool
) -> dict[str, Any]:
    """Return one joint's bar for the template: shapes, text and kind of change.

    Parameters
    ----------
    old, new : float
        Error of the first and the last model.
    scale : _Scale
        Where an error stands on the bar.
    has_change : bool
        Whether there are two models; else ``new`` is drawn alone.
    is_known : bool
        Whether the errors are multiples of a known noise floor, which is drawn as
        well, with the limit of what is good.
    """
    sizes = {"before": old, "after": new} if has_change else {"alone": new}
    if is_known:
        sizes |= {"noise": 1.0, "limit": ABOVE_NOISE}
    shapes = {kind: scale.place(size) for kind, size in sizes.items()}
    is_below_noise = is_known and max(old, new) < 1.0  # a change there says nothing
    if not has_change or is_below_noise:
        return {"shapes": shapes, "change": "", "kind": ""}
    return {
        "shapes": shapes,
        "change": change_of(old, new),
        "kind": _kind_of_change(old, new),
    }


def _caption_of_bars(
    scope: str, over_noise: Array | None, is_share: bool, colours: str
) -> str:
    """Return the caption of bars: what the errors are of, their scale, and the
    ``colours``. Errors are multiples of the noise (``over_noise``, None
    where that is not known), or shares of the torque."""
    what = f"Error of each joint {scope}".rstrip()
    unit = "% of its torque (RMS)" if is_share else "RMS"
    caption = f"{what}, {unit} (noise unknown; logarithmic)"
    if over_noise is not None:
        is_bound = float(over_noise.min()) < 1.0
        noise = "the noise, at most that" if is_bound else "the noise"
        marks = f"shaded: {noise}; dashed: good up to {ABOVE_NOISE:g}"
        caption = f"{what}, in multiples of its noise (logarithmic; {marks})"
    return "; ".join(filter(None, (caption, colours)))


def _kind_of_change(before: float, after: float) -> str:
    """Say whether an error became "better", "worse", or stayed the "same" (within 5
    %).
    """
    change = after / before - 1.0 if before > 0.0 else 0.0
    if change < -CHANGES:
        return "better"
    return "worse" if change > CHANGES else "same"


def found_shares(diagnosis: Diagnosis | None, n: int) -> dict[str, list[float]]:
    """Return the share of error variance on data left out that each certain finding
    removes, for each joint (:meth:`Diagnosis.errors_of`).

    Returns
    -------
    dict of str to list of float
        For each finding a share from 0 to 1 of each joint.
    """
    shares: dict[str, list[float]] = {}
    if diagnosis is None:
        return shares
    for finding in diagnosis.effects:
        if not finding.torque_is_certain:
            continue
        row = shares.setdefault(f"found: {effect_name(finding.effect)}", [0.0] * n)
        before, after = diagnosis.errors_of(finding)
        # An effect without joints acts on all of them.
        joint_indices = [joint - 1 for joint in finding.joints] or range(n)
        for j in joint_indices:
            if before[j] > 0.0:
                row[j] = max(row[j], 1.0 - float(after[j] / before[j]) ** 2)
    return shares


def heat_rows(
    failures: Failures, shares_found: Mapping[str, Sequence[float]]
) -> list[tuple[str, list[float]]]:
    """Return the rows of the heat map: how much of each joint's error a cause explains.

    Causes and findings that explain nothing on any joint are left out.

    Parameters
    ----------
    failures : Failures
        Error analysis of each joint.

    Returns
    -------
    list of tuples
        Name and shares (n,) of each row.
    """
    shares_by_row = dict(shares_found)
    for cause in failures[0].shares if failures else ():
        shares_by_row[cause] = [failure.shares[cause] for failure in failures]
    return [
        (name, list(shares))
        for name, shares in shares_by_row.items()
        if _per_cent(max(shares))
    ]


def _per_cent(share: float) -> str:
    """Write a share (0 to 1) as a whole number of per cent; "" if that rounds to
    zero.
    """
    rounded = round(100.0 * share)
    return str(rounded) if rounded > 0 else ""


def heat_map(
    title: str,
    rows: Sequence[tuple[str, Sequence[float]]],
    n: int,
    has_buttons: bool = False,
) -> Markup:
    """Draw a table of causes by joints; a darker cell explains more of the joint's
    error.

    Parameters
    ----------
    has_buttons : bool
        Whether cells are buttons, with the attributes data-joint and data-cause.
    """
    cells = [
        {
            "name": name,
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
        has_buttons=has_buttons,
    )


def legend(causes: Sequence[str]) -> Markup:
    """Draw the legend of the colours of causes."""
    colour_without_cause = SHADES["no cause seen"]
    chips = [(cause, SHADES.get(cause, colour_without_cause)) for cause in causes]
    return piece("legend.html", chips=chips)


def shades(stretches: Sequence[tuple[float, float, str]]) -> list[dict[str, Any]]:
    """Return shapes that shade stretches of time in both panels of a torque figure.

    Parameters
    ----------
    stretches : sequence of tuples
        First and last instant on the figure's time axis [s], and the cause.

    Returns
    -------
    list of dict
        Plotly shapes in the colours of the causes.
    """
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
    """Embed a figure as data, which the page's script draws when it comes into view.

    Parameters
    ----------
    plot : Figure
        The figure, which gets colours, margins and a height [px].
    group : str
        Figures of one group share their time axis and which models are hidden.
    """
    if group:
        plot.update_layout(meta={"group": group})
    data = packed(styled(plot, height).to_json())
    return piece("figure.html", data=data, caption=caption, height=height)


def packed(text: str) -> str:
    """Compress a text to base64, which cannot end a script element; draw.js unpacks it.

    Returns
    -------
    str
        Base64 of the gzip stream, equal for equal texts.
    """
    return base64.b64encode(gzip.compress(text.encode(), 4, mtime=0)).decode()
