"""Which effects of a model a file holds and which it leaves out. Only this module decides
that, from the fields that a format declares (``HOLDS``)."""

from collections.abc import Collection

import numpy as np

from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.c_formulas import has_closed_form
from sdp_vs_penalty.exporters.content import servo_gains


def is_held(effect: Effect, estimate: Estimate, fields: Collection[str]) -> bool:
    """Return whether a file with these fields holds an effect: in fields of its own, or
    as a formula. A servo's loop is no part of the arm: no file counts as lacking it."""
    if effect.forward == "drive":
        return True
    terms = effect.simulator_terms(np.zeros(len(effect.parameters)))
    # An effect without terms needs its own field; "" is a field that no file has.
    needed = {term.field for term in terms} or {effect.simulator_field}
    if needed <= set(fields):
        return True
    return "formulas" in fields and has_closed_form(effect, estimate)


def left_out(estimate: Estimate, fields: Collection[str]) -> tuple[str, ...]:
    """Return the effects that make a torque and that a file with these fields does not
    hold, as they are written, and a delay of the servos' command."""
    lost = [
        effect.brief
        for effect, indices in estimate.model.parts
        if estimate.theta[indices].any() and not is_held(effect, estimate, fields)
    ]
    delay = servo_gains(estimate)[1]
    if delay:
        lost.append(f"the command's delay of {1e3 * delay:.2g} ms (kv is kd + kp T)")
    return tuple(lost)
