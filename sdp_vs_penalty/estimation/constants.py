"""Decisions of this folder that are numbers, each with its unit, its meaning and where it is from."""

from __future__ import annotations

#: Folds of the motion by which a shape constant is confirmed [-].
SHAPE_FOLDS = 10
#: Least that another value of a shape constant takes from the squared error, in variances of the noise:
#: Akaike's price of one parameter.
SHAPE_GAIN = 2.0
#: Relative standard deviation of a shape constant below which interpolation in the grid, good to a
#: per cent, is not enough.
TOLD_FINELY = 0.01
#: Share of a range's logarithm: nearer to an end than this, a shape constant is at it.
AT_END = 0.02
