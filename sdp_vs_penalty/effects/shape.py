"""Shape constants: the numbers on which an effect's columns depend non-linearly."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

#: Units of what depends on the kind of joint: revolute, prismatic.
POSITION = ("rad", "m")
VELOCITY = ("rad/s", "m/s")
#: Share of a range's length: nearer to an end than this, a shape constant is at it.
AT_END = 0.02


@dataclass(frozen=True)
class ShapeConstant:
    """A shape constant: a number on which an effect's columns depend non-linearly."""

    #: Value where none is given.
    default: float
    #: Unit, "-" for a number; a pair for a revolute and a prismatic joint.
    unit: str | tuple[str, str] = "-"
    #: Values from which a search starts.
    grid: tuple[float, ...] = ()
    #: Range in which a search refines the values; None: they stay on the grid.
    bounds: tuple[float, float] | None = None
    #: Spacing of neighbours: widths, exponents and times by a ratio ("log"), wave
    #: numbers by a difference ("linear").
    scale: Literal["log", "linear"] = "log"
    #: The only allowed values, where these are few.
    choices: tuple[float, ...] = ()
    #: Length on a prismatic joint that stands for one radian of grid and bounds [m].
    metres: float = 1.0
    #: Names of the choices in written effects.
    words: tuple[str, ...] = ()
    #: Whether the value may be zero or negative.
    signed: bool = False
    #: "searched" by `diagnose` and `add` where it is not given; "estimated" by
    #: `identify` as well; "clock", the instant from which time counts, taken from the
    #: measurements.
    role: Literal["searched", "estimated", "clock"] = "searched"

    def on(self, kind: str) -> ShapeConstant:
        """Return the constant with grid and bounds for one kind of joint, "revolute" or
        "prismatic".

        Both are written for a revolute joint, in rad. For a prismatic one they are
        multiplied by ``metres``, the length that stands for one radian.

        Returns
        -------
        ShapeConstant
            The same constant on such a joint; its ``metres`` are 1, because they are
            used already.
        """
        if kind != "prismatic" or self.metres == 1.0:
            return self
        grid = tuple(six_digits(self.metres * x) for x in self.grid)
        ends = None
        if self.bounds is not None:
            low, high = self.bounds
            ends = six_digits(self.metres * low), six_digits(self.metres * high)
        return replace(self, grid=grid, bounds=ends, metres=1.0)

    def complaint(self, value: float) -> str | None:
        """Say what is wrong with a value.

        Returns
        -------
        str or None
            The end of a sentence that begins with the constant's name; None where
            nothing is wrong.
        """
        if not np.isfinite(value):
            return "must be finite"
        if self.choices and value not in self.choices:
            if self.words:
                return f"must be one of {', '.join(self.words)}"
            first = f"{self.choices[0]:g}"
            last = f"{self.choices[-1]:g}"
            return f"must be a whole number from {first} to {last}, not {value:g}"
        if not self.signed and not value > 0.0:
            return f"must be above 0, not {value:g}"
        return None

    def is_at_end(self, value: float, kind: str) -> bool:
        """Return whether a value lies at an end of the bounds on one kind of joint, as
        widths, exponents and times do that data bound on one side only."""
        bounds = self.on(kind).bounds
        if bounds is None or self.scale != "log":
            return False
        low, high = np.log(bounds)
        return at_end(float(np.log(value)), float(low), float(high))

    def parsed(self, text: str) -> float:
        """Parse the written value of the constant: a number, or one of its words
        ("viscous"), which stand for whole numbers; ValueError if the text is neither.
        """
        word = text.strip()
        return (
            self.choices[self.words.index(word)] if word in self.words else float(word)
        )

    def written(self, value: float) -> str:
        """Format a value as :meth:`parsed` reads it.

        Returns
        -------
        str
            A word, or a number with six digits. An instant that six digits would move by
            more than a millisecond (seconds since 1970) has all its digits.
        """
        if self.words:
            return self.words[self.choices.index(value)]
        text = f"{value:.6g}"
        if self.role == "clock" and abs(float(text) - value) > 1e-3:
            return repr(float(value))
        return text

    def unit_on(self, kind: str) -> str:
        """Return the unit on one kind of joint, "revolute" or "prismatic"."""
        return (
            self.unit if isinstance(self.unit, str) else self.unit[kind == "prismatic"]
        )

    def format_with_unit(self, value: float, kind: str) -> str:
        """Write a value with its unit on one kind of joint ("revolute" or "prismatic"),
        as a sentence says it.

        Returns
        -------
        str
            Text such as "7 per turn".

        Examples
        --------
        >>> ShapeConstant(2.0, ("1/turn", "rad/m")).format_with_unit(7.0, "revolute")
        '7 per turn'
        """
        if self.words:
            return self.written(value)
        unit = self.unit_on(kind)
        words = "" if unit == "-" else unit.replace("1/", "per ")
        return f"{value:.4g} {words}".strip()


def six_digits(value: float) -> float:
    """Round a number to the six digits with which effects are written
    (:meth:`ShapeConstant.written`), so that it is the same when it is read again."""
    return float(f"{value:.6g}")


def at_end(u: float, low: float, high: float) -> bool:
    """Return whether a shape constant lies at an end of the range that was searched.

    Parameters
    ----------
    u : float
        The constant, on the scale of its range (for example ln u).
    low : float
        Lower end of the range, on the same scale.
    high : float
        Upper end of the range, on the same scale.

    Returns
    -------
    bool
        True within the share AT_END of the range's length from either end.
    """
    margin = AT_END * (high - low)
    is_inside = low + margin < u < high - margin
    return not is_inside


def choice(*words: str, count: int = 0) -> ShapeConstant:
    """Return a constant that chooses one of some words, or of ``count`` numbers; the first
    is the default, and a search tries all."""
    numbers = tuple(k + 1.0 for k in range(count or len(words)))
    return ShapeConstant(1.0, grid=numbers, choices=numbers, words=words)
