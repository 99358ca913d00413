"""A figure as plain data for plotly's script, by the names that plotly.py has for its parts.

plotly.py checks every property against the whole of its schema: a tenth of a second a figure.
``title`` may be a text.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


def trace(kind: str, **properties: Any) -> dict[str, Any]:
    """A trace of a kind, such as "scatter"; None leaves a property out."""
    return _merged({"type": kind}, {k: v for k, v in properties.items() if v is not None})


class Figure:
    """data : traces; layout : everything else. With ``columns`` (widths, shares of all) or ``rows``
    panels beside or below each other, ``gap`` apart; rows share one time axis."""

    def __init__(
        self,
        data: Sequence[dict[str, Any]] = (),
        columns: Sequence[float] = (1.0,),
        rows: int = 1,
        gap: float = 0.08,
    ) -> None:
        self.data, self.layout = list(data), dict[str, Any]({"xaxis": {}, "yaxis": {}})
        self._several = rows * len(columns) > 1
        shares = [1.0 / rows] * rows if rows > 1 else [c / sum(columns) for c in columns]
        begin, room = 0.0, 1.0 - gap * (len(shares) - 1)
        for k, share in enumerate(shares if self._several else ()):
            end, n = min(begin + room * share, 1.0), _number(k)
            along = [begin, end] if rows == 1 else [0.0, 1.0]
            up = [0.0, 1.0] if rows == 1 else [1.0 - end, 1.0 - begin]
            self.layout[f"xaxis{n}"] = {"anchor": f"y{n}", "domain": along}
            self.layout[f"yaxis{n}"] = {"anchor": f"x{n}", "domain": up}
            if k < rows - 1:
                self.layout[f"xaxis{n}"] |= {"matches": f"x{_number(rows - 1)}", "showticklabels": False}
            begin = end + gap

    def add(self, made: dict[str, Any], panel: int = 0) -> Figure:
        """Another trace, in a panel (from 0)."""
        axes = {"xaxis": f"x{_number(panel)}", "yaxis": f"y{_number(panel)}"} if self._several else {}
        self.data.append({**made, **axes})
        return self

    def update_layout(self, **changes: Any) -> Figure:
        """Change the layout; what is nested is merged."""
        self.layout = _merged(self.layout, changes)
        return self

    def update_axes(self, letter: str, panel: int | None = None, **changes: Any) -> Figure:
        """Change all axes "x" or "y", or that of one panel."""
        wanted = f"{letter}axis" if panel is None else f"{letter}axis{_number(panel)}"
        for name in self.layout:
            if name.startswith(wanted) if panel is None else name == wanted:
                self.layout[name] = _merged(self.layout[name], changes)
        return self

    def to_json(self) -> str:
        """For plotly's script; numbers of arrays in single precision, which is finer than any screen."""
        every = {"data": self.data, "layout": self.layout}
        return json.dumps(every, default=_packed, separators=(",", ":"))


def _number(panel: int) -> str:
    return "" if panel == 0 else str(panel + 1)


def _merged(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    out = dict(old)
    for name, value in new.items():
        if name == "title" and isinstance(value, str):
            value = {"text": value}
        if isinstance(value, Mapping):
            value = _merged(out.get(name) or {}, value)
        out[name] = value
    return out


def _packed(array: Any) -> Any:
    """An array as plotly's script reads it."""
    values = np.asarray(array)
    if values.dtype.kind not in "fiu" or values.ndim != 1:
        return values.tolist()
    raw = np.ascontiguousarray(values, "<f4").tobytes()
    return {"dtype": "f4", "bdata": base64.b64encode(raw).decode()}
