"""What a further measurement would tell of a range, before it is done.

Scales bound a link's mass, or the sum of masses where they weigh the arm: the range under
that bound, about the model's value, is what the scales would leave. With very much
more motion c is nearly zero: consistency and bounds alone decide what remains. A known load at the
flange adds known torque: it says nothing of a link by itself, but the same motion again with it
halves the noise's variance and fixes the gains of the torque channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdp_vs_penalty.data.files import Source
from sdp_vs_penalty.estimation.build_problem import EstimationProblem
from sdp_vs_penalty.estimation.constants import LEVEL, ROUNDING
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.ranges.allowed import AllowedSet, allowed_set, spread_of
from sdp_vs_penalty.ranges.ends import EndSearch
from sdp_vs_penalty.ranges.functions import TOTAL, coefficients, functions_by_name
from sdp_vs_penalty.ranges.table import training_of
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot.arrays import Array

#: Relative accuracy of the scales [-].
SCALES = 0.01
#: Share of each interval that very much more motion would leave [-].
_PERFECT = 1e-2
#: Relative accuracy of the loss of the best fit under the scales.
_ACCURACY = 1e-9
_ANY_MOTION = "any motion, as long as you like"


@dataclass(frozen=True)
class Worth(JsonRecord):
    """The range that a measurement would leave of a function."""

    #: What would be measured.
    measurement: str
    #: Least value after it.
    least: float
    #: Greatest value after it.
    greatest: float
    #: Length of the range after it, over that before.
    length: float


def what_to_measure(
    model: Estimate | str,
    function: str,
    data: Source | None = None,
    *,
    level: float = LEVEL,
) -> tuple[Worth, ...]:
    """Return what measurements would leave of a linear function's range, the best
    first.

    Each assumes that the scales show what the model says, to a hundredth.

    Parameters
    ----------
    function : str
        Name of a linear function, such as "m4".
    """
    estimate = as_estimate(model, "what_to_measure(model=...)")
    posed, floor = training_of(estimate, data)
    allowed = allowed_set(posed, estimate.theta, floor, level)
    g = coefficients(posed.problem, posed.task.model, function)
    least_before, greatest_before = _least_and_greatest(allowed, g)
    middle = allowed.optimiser(allowed.first_rise).centre
    sets = _after_more_motion(allowed, posed, estimate.theta, middle)
    for mass in functions_by_name(posed.problem, posed.task.model, ["masses"]):
        if mass.name != function and mass.g is not None:
            what = "the arm" if mass.name == TOTAL else f"link {mass.name[1:]}"
            sets[f"weigh {what}"] = _after_weighing(
                allowed, estimate.theta, middle, mass.g
            )
    worths = []
    for measurement, smaller in sets.items():
        least, greatest = _least_and_greatest(smaller, g)
        # What is known already stays known.
        least, greatest = max(least, least_before), min(greatest, greatest_before)
        share_left = (greatest - least) / (greatest_before - least_before)
        worths.append(Worth(measurement, least, greatest, share_left))
    return tuple(sorted(worths, key=lambda worth: worth.length))


def _after_more_motion(
    allowed: AllowedSet, posed: EstimationProblem, theta: Array, middle: Array
) -> dict[str, AllowedSet]:
    """Return the sets that more data would leave, by what is measured: very much motion,
    if the model in the middle (p,) of the set were the true one; and the motion so far
    once more with a known load: twice the data, and exact gains of the torque channels.

    ``theta`` (p,) is the model at which the intervals of shape constants are taken.
    """
    ball = allowed.ball
    spread = spread_of(replace(posed, gain_errors=None), theta)
    exact = replace(ball, a=ball.A @ middle, spread=lambda w: _PERFECT * ball.spread(w))
    twice = replace(ball, spread=lambda w: np.sqrt(0.5) * spread(w))
    return {
        _ANY_MOTION: replace(allowed, ball=exact, fit=middle, interior=middle),
        "the same motion with a known load": replace(allowed, ball=twice),
    }


def _least_and_greatest(allowed: AllowedSet, g: Array) -> tuple[float, float]:
    """Return the least and the greatest value of g^T theta over a set; rounding of zero
    (below 1e-9 of the range's length) as zero."""
    ((least, greatest),) = EndSearch(allowed).least_and_greatest([g])
    rounding = 1e-9 * (greatest.value - least.value)

    def without_rounding(value: float) -> float:
        return value if abs(value) > rounding else 0.0

    return without_rounding(least.value), without_rounding(greatest.value)


def _after_weighing(
    allowed: AllowedSet, model: Array, middle: Array, mass: Array
) -> AllowedSet:
    """Return the models that scales would leave which show a mass of the model.

    The scales err by the share SCALES at most: |mass^T theta - value| <= SCALES value.

    Parameters
    ----------
    model, middle : (p,) arrays
        The identified model, whose mass the scales show, and the middle of the set,
        whose mass they show if the model breaks a constraint or has no such mass.
    mass : (p,) array
        Coefficients of the mass that is weighed, of one link or of all.
    """
    if allowed.constraints.margin(model) < -ROUNDING or not mass @ model > ROUNDING:
        model = middle
    value = float(mass @ model)
    places = np.flatnonzero(mass)
    rows = np.outer(mass[places], [1.0, -1.0])
    limits = [-(1.0 - SCALES) * value, (1.0 + SCALES) * value]
    scales = build.linear("scales", "the measurement", places, rows, limits)
    # From the model towards the middle, half as far as the scales allow: strictly inside.
    distance = abs(float(mass @ middle) - value)
    share = 1.0
    if distance > 0.0:
        share = min(1.0, 0.5 * SCALES * value / distance)
    inside = model + share * (middle - model)
    weighed = replace(
        allowed, constraints=allowed.constraints.plus([scales]), interior=inside
    )
    return replace(weighed, fit=weighed.best_fit(_ACCURACY))


def worth_sentence(worths: Sequence[Worth]) -> str:
    """Return what would tell most of a function, and what motion cannot tell; ``worths``
    are those of :func:`what_to_measure`, the best first."""
    motion = next(x for x in worths if x.measurement == _ANY_MOTION)
    best = next(x for x in worths if x is not motion)
    return (
        f"Most would tell: {best.measurement} (leaves {100.0 * best.length:.0f} % of this"
        f" length); motion, however long, leaves {100.0 * motion.length:.0f} %."
    )


def worth_table(worths: Sequence[Worth], function: str) -> Table:
    """Return one row a measurement: the range of a function after it."""
    rows = [(x.measurement, x.least, x.greatest, 100.0 * x.length) for x in worths]
    headings = ("measurement", f"least {function}", "greatest", "length left [%]")
    return Table(headings, rows)
