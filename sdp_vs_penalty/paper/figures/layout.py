"""Room for the texts of a figure, from the length of each text and its font's size.

matplotlib's own layout engines ask every text for its box, twice, which takes a quarter of
the time that a figure takes to be written. All figures here are one grid of axes.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from sdp_vs_penalty.paper.figures.style import DPI

#: Widest character of a tick label, over its font size: a digit of DejaVu Sans.
_DIGIT = 0.64
#: From one line of text to the next, over the font size.
_LINE = 1.3
#: Between an axis and its tick labels, and between these and the axis label [points].
_TICK, _LABEL = 5.0, 4.0
#: Between texts and the figure's edge, and between neighbouring axes [points].
_EDGE, _BETWEEN = 4.0, 5.0
#: What surrounds the characters of a number in mathematical script.
_SCRIPT = re.compile(r"\\mathdefault|[$\\{}^]")


@dataclass(frozen=True)
class _Room:
    """What the texts of an axes need [points]."""

    #: Room to the left of the axes.
    left: float
    #: Room to the right of the axes.
    right: float
    #: Room below the axes.
    below: float
    #: Room above the axes.
    above: float
    #: Room of the tick labels alone on the left, where the axis label begins.
    ticks_left: float
    #: Room of the tick labels alone below, where the axis label begins.
    ticks_below: float


def lay_out(figure: Any) -> None:
    """Place the axes of a figure so that no text is cut off or overlaps another one.

    Axis labels of a column are put on one line, and those of a row.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        One grid of axes, with a title and a legend outside or without.
    """
    rooms = {axis: _room(axis) for axis in figure.axes if axis.name != "3d"}
    width, height = 72.0 * figure.get_size_inches()
    grid = figure.axes[0].get_subplotspec().get_gridspec()
    rows: list[list[_Room]] = [[] for _ in range(grid.nrows)]
    columns: list[list[_Room]] = [[] for _ in range(grid.ncols)]
    for axis, room in rooms.items():
        place = axis.get_subplotspec()
        rows[place.rowspan.start].append(room)
        columns[place.colspan.start].append(room)
    for axis in rooms:
        place = axis.get_subplotspec()
        left = max(r.ticks_left for r in columns[place.colspan.start])
        below = max(r.ticks_below for r in rows[place.rowspan.start])
        _put_labels(axis, left, below)
    left, across, right = _gaps(
        [(_most(c, "left"), _most(c, "right")) for c in columns]
    )
    above, between, below = _gaps(
        [(_most(r, "above"), _most(r, "below")) for r in rows]
    )
    above += _title(figure, height)
    for legend in figure.legends:
        below += 72.0 / DPI * legend.get_window_extent().height + _LABEL
    inner = width - left - right
    upright = height - above - below
    figure.subplots_adjust(
        left=left / width,
        right=1.0 - right / width,
        bottom=below / height,
        top=1.0 - above / height,
        # matplotlib wants the gaps over the mean size of the axes.
        wspace=grid.ncols * across / (inner - (grid.ncols - 1) * across),
        hspace=grid.nrows * between / (upright - (grid.nrows - 1) * between),
    )


def _most(rooms: Sequence[_Room], side: str) -> float:
    """Return the largest room on one side [points]; 0 without axes."""
    return max((getattr(room, side) for room in rooms), default=0.0)


def _gaps(rooms: Sequence[tuple[float, float]]) -> tuple[float, float, float]:
    """Return the room before the first, between all and after the last [points].

    rooms : what each row or column needs before and after it [points].
    """
    between = [after + before for (_, after), (before, _) in pairwise(rooms)]
    first, last = rooms[0][0], rooms[-1][1]
    return first + _EDGE, max(between, default=0.0) + _BETWEEN, last + _EDGE


def _room(axis: Any) -> _Room:
    """Return the room that the texts around an axes need; none where it is off."""
    if not axis.axison:
        return _Room(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    ticks_left = _TICK + max(map(_width, _shown(axis.get_yticklabels())), default=0.0)
    labels = _shown(axis.get_xticklabels())
    ticks_below = _TICK + max(map(_height, labels), default=0.0)
    # Half of the last label stands out on the right.
    right = 0.5 * max(map(_width, labels), default=0.0)
    above = max(map(_height, _shown([axis.title])), default=0.0)
    if axis.yaxis.get_major_formatter().get_offset():  # the ticks' power of ten
        above = max(above, _LINE * axis.yaxis.offsetText.get_fontsize())
    return _Room(
        left=ticks_left + _label(axis.yaxis.label),
        right=right,
        below=ticks_below + _label(axis.xaxis.label),
        above=above + _TICK if above else 0.0,
        ticks_left=ticks_left,
        ticks_below=ticks_below,
    )


def _shown(texts: Sequence[Any]) -> list[Any]:
    """Return the texts that are visible and not empty."""
    return [text for text in texts if text.get_visible() and text.get_text()]


def _width(text: Any) -> float:
    """Return the largest width of a number [points]."""
    return _DIGIT * float(text.get_fontsize()) * len(_SCRIPT.sub("", text.get_text()))


def _height(text: Any) -> float:
    """Return the height of a text's lines [points]."""
    return _LINE * float(text.get_fontsize()) * len(text.get_text().splitlines())


def _label(text: Any) -> float:
    """Return the room of an axis label and of the gap before it [points]."""
    return _LABEL + _height(text) if text.get_text() else 0.0


def _put_labels(axis: Any, left: float, below: float) -> None:
    """Put an axes' labels beside its ticks, and its title on top.

    left, below : room of the tick labels of its column and row [points].

    Axes without labels get a place for them as well: matplotlib then does not look for one
    at each drawing.
    """
    from matplotlib.transforms import ScaledTranslation

    inch = axis.figure.dpi_scale_trans
    move = ScaledTranslation(-(left + _LABEL) / 72.0, 0.0, inch)
    axis.yaxis.set_label_coords(0.0, 0.5, transform=axis.transAxes + move)
    move = ScaledTranslation(0.0, -(below + _LABEL) / 72.0, inch)
    axis.xaxis.set_label_coords(0.5, 0.0, transform=axis.transAxes + move)
    axis.set_title(axis.get_title(), y=1.0)


def _title(figure: Any, height: float) -> float:
    """Put the figure's title at its upper edge, and return its room [points].

    height : of the figure [points].
    """
    title = figure.get_suptitle()
    if not title:
        return 0.0
    text = figure.suptitle(title, y=1.0 - _EDGE / height)
    return _height(text) + _EDGE
