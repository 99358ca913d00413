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
    before = _ends(allowed, g)
    middle = allowed.optimiser(allowed.first_rise).centre
    # Very much more motion, were the model in the middle the true one.
    ball = allowed.ball
    exact = replace(ball, a=ball.A @ middle, spread=lambda w: _PERFECT * ball.spread(w))
    # Twice the data, and exact gains.
    spread = spread_of(replace(posed, gain_errors=None), estimate.theta)
    twice = replace(ball, spread=lambda w: np.sqrt(0.5) * spread(w))
    after = {
        _ANY_MOTION: replace(allowed, ball=exact, fit=middle, interior=middle),
        "the same motion with a known load": replace(allowed, ball=twice),
    }
    for scale in functions_by_name(posed.problem, posed.task.model, ["masses"]):
        if scale.name != function and scale.g is not None:
            what = "the arm" if scale.name == TOTAL else f"link {scale.name[1:]}"
            after[f"weigh {what}"] = _after_weighing(
                allowed, estimate.theta, middle, scale.g
            )
    out = []
    for measurement, smaller in after.items():
        # What is known already stays known.
        low, high = _ends(smaller, g)
        low, high = max(low, before[0]), min(high, before[1])
        length = (high - low) / (before[1] - before[0])
        out.append(Worth(measurement, low, high, length))
    return tuple(sorted(out, key=lambda worth: worth.length))


def _ends(allowed: AllowedSet, g: Array) -> tuple[float, ...]:
    """Return the least and the greatest value of g^T theta; zero where rounding is all
    that differs."""
    ((low, high),) = EndSearch(allowed).both([g])
    smallest = 1e-9 * (high.value - low.value)
    return tuple(x.value if abs(x.value) > smallest else 0.0 for x in (low, high))


def _after_weighing(
    allowed: AllowedSet, model: Array, middle: Array, g: Array
) -> AllowedSet:
    """Return the set with g^T theta within SCALES of its value in a model (p,), or in the
    middle (p,) of the set where the model breaks a constraint or has no such mass."""
    if allowed.constraints.margin(model) < -ROUNDING or not g @ model > ROUNDING:
        model = middle
    value = float(g @ model)
    places = np.flatnonzero(g)
    rows = np.outer(g[places], [1.0, -1.0])
    ends = [-(1.0 - SCALES) * value, (1.0 + SCALES) * value]
    scales = build.linear("scales", "the measurement", places, rows, ends)
    # From the model towards the middle, half as far as the scales allow: strictly inside.
    away = abs(float(g @ middle) - value)
    share = min(1.0, 0.5 * SCALES * value / away) if away > 0.0 else 1.0
    inside = model + share * (middle - model)
    weighed = replace(
        allowed, constraints=allowed.constraints.plus([scales]), interior=inside
    )
    return replace(weighed, fit=weighed.best_fit(_ACCURACY))


def worth_sentence(found: Sequence[Worth]) -> str:
    """Return what would tell most of a function, and what motion cannot tell."""
    motion = next(x for x in found if x.measurement == _ANY_MOTION)
    best = next(x for x in found if x is not motion)
    return (
        f"Most would tell: {best.measurement} (leaves {100.0 * best.length:.0f} % of this"
        f" length); motion, however long, leaves {100.0 * motion.length:.0f} %."
    )


def worth_table(found: Sequence[Worth], function: str) -> Table:
    """Return one row a measurement: the range of a function after it."""
    rows = [(x.measurement, x.least, x.greatest, 100.0 * x.length) for x in found]
    headings = ("measurement", f"least {function}", "greatest", "length left [%]")
    return Table(headings, rows)
