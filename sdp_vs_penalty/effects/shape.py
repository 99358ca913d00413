"""Shape constants: the numbers on which an effect's columns depend non-linearly."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

#: Units of what depends on the kind of joint: revolute, prismatic.
POSITION = ("rad", "m")
VELOCITY = ("rad/s", "m/s")


@dataclass(frozen=True)
class ShapeConstant:
    """A shape constant: a number on which an effect's columns depend non-linearly.

    Parameters
    ----------
    default : value where none is given
    unit : "-" for a number; a pair for a revolute and a prismatic joint
    grid : values from which a search starts
    bounds : range in which a search refines them; None: it stays on the grid
    scale : spacing of neighbours: widths, exponents and times by a ratio ("log"), wave
        numbers by a difference ("linear")
    choices : the only allowed values, where these are few
    metres : length [m] on a prismatic joint that stands for one radian of grid and
        bounds
    words : names of the choices in written effects
    signed : whether the value may be zero or negative
    role : "searched" by `diagnose` and `add` where it is not given; "estimated" by
        `identify` as well; "clock", the instant from which time counts, taken from the
        measurements
    """

    default: float
    unit: str | tuple[str, str] = "-"
    grid: tuple[float, ...] = ()
    bounds: tuple[float, float] | None = None
    scale: Literal["log", "linear"] = "log"
    choices: tuple[float, ...] = ()
    metres: float = 1.0
    words: tuple[str, ...] = ()
    signed: bool = False
    role: Literal["searched", "estimated", "clock"] = "searched"

    def on(self, kind: str) -> ShapeConstant:
        """Return the constant with grid and bounds for one kind of joint.

        For a prismatic joint, both are multiplied by ``metres``: grids are written in
        rad.

        Parameters
        ----------
        kind
            "revolute" or "prismatic".

        Returns
        -------
        ShapeConstant
            The same constant on such a joint.
        """
        if kind != "prismatic" or self.metres == 1.0:
            return self
        # As many digits as a written effect has.
        grid = tuple(float(f"{self.metres * x:.6g}") for x in self.grid)
        bounds = tuple(float(f"{self.metres * x:.6g}") for x in self.bounds or ())
        ends = (bounds[0], bounds[1]) if bounds else None
        return replace(self, grid=grid, bounds=ends, metres=1.0)

    def complaint(self, value: float) -> str | None:
        """Say what is wrong with a value.

        Parameters
        ----------
        value
            The value.

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

    def parsed(self, text: str) -> float:
        """Parse the written value of the constant.

        Parameters
        ----------
        text
            A number, or one of the constant's words ("viscous").

        Returns
        -------
        float
            The value; words stand for whole numbers.

        Raises
        ------
        ValueError
            The text is neither.
        """
        word = text.strip()
        return (
            self.choices[self.words.index(word)] if word in self.words else float(word)
        )

    def written(self, value: float) -> str:
        """Format a value as :meth:`parsed` reads it.

        Parameters
        ----------
        value
            The value.

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
        """Return the unit on one kind of joint.

        Parameters
        ----------
        kind
            "revolute" or "prismatic".

        Returns
        -------
        str
            The unit.
        """
        return (
            self.unit if isinstance(self.unit, str) else self.unit[kind == "prismatic"]
        )

    def format_with_unit(self, value: float, kind: str) -> str:
        """Write a value with its unit, as a sentence says it.

        Parameters
        ----------
        value
            The value.
        kind
            "revolute" or "prismatic".

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
