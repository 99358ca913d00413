"""Where a function of one variable is highest, with few looks at it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

#: Sections of the range, before the parabola through the best three.
_SECTIONS = 5


def highest(value_at: Callable[[float], float], low: float, high: float) -> None:
    """Look where a function of one hump is highest: by golden section (Kiefer 1953), whose points are
    the same whenever the same range is searched, then at the vertex of the parabola through the best.

    ``value_at`` remembers what it has seen.
    """
    ratio = 0.5 * (np.sqrt(5.0) - 1.0)
    seen: list[tuple[float, float]] = []

    def at(x: float) -> float:
        seen.append((x, value_at(x)))
        return seen[-1][1]

    inner = [high - ratio * (high - low), low + ratio * (high - low)]
    values = [at(x) for x in inner]
    for _ in range(_SECTIONS):
        if values[0] > values[1]:
            high = inner[1]
            inner, values = [high - ratio * (high - low), inner[0]], [0.0, values[0]]
            values[0] = at(inner[0])
        else:
            low = inner[0]
            inner, values = [inner[1], low + ratio * (high - low)], [values[1], 0.0]
            values[1] = at(inner[1])
    x, y = np.array(sorted(seen)).T
    top = int(np.clip(np.argmax(y), 1, len(x) - 2))
    bend, slope, _ = np.polyfit(x[top - 1 : top + 2] - x[top], y[top - 1 : top + 2], 2)
    if bend < 0.0:
        at(x[top] + float(np.clip(-0.5 * slope / bend, x[top - 1] - x[top], x[top + 1] - x[top])))
