"""How one run serves for both: its beginning for identification, its end for testing."""

from __future__ import annotations

#: Share of the run that is identified from.
_FIRST = 0.7
#: Seconds left out between the two parts, so that no filter sees both.
PAUSE = 0.5


def cut(seconds: float) -> float:
    """Where the first part of a run of so many seconds ends [s]."""
    return _FIRST * seconds
