"""Events that happen once: a knock, a contact, a lost packet."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.check.issue import Issue, joints_text
from sdp_vs_penalty.check.physics import Physics, solve
from sdp_vs_penalty.data.measurements import Measurements

#: An event is a peak of the error this many times higher than every other one. Two peaks of one
#: cause (a reversal of friction) differ far less.
_ALONE = 3.0
#: ... and this many standard deviations of the error elsewhere.
_FAR = 12.0
#: A joint slides at this share of its usual speed.
_SLIDES = 0.3
#: Errors this close to a peak belong to it [s].
_WIDTH = 1.0


def knock(physics: Physics) -> Iterator[Issue]:
    """A moment at which the error is far larger than at any other: contact, a push, a lost packet."""
    t = physics.motion.t
    found: dict[int, list[tuple[int, float]]] = {}
    # Where a joint turns round or rests, friction errs as it likes.
    slides = np.abs(physics.motion.dq) > _SLIDES * np.sqrt(np.mean(physics.motion.dq**2, axis=0))
    for j, columns in enumerate(physics.columns):
        y = physics.channels[:, j]
        error = np.abs(y - columns @ solve(columns.T @ columns, (columns.T @ y)[:, None])[:, 0])
        k = int(np.argmax(np.where(slides[:, j], error, 0.0)))
        if min(t[k] - t[0], t[-1] - t[k]) < 0.5 * _WIDTH:
            continue  # the arm starts or comes to rest there: stiction
        elsewhere = error[np.abs(t - t[k]) > _WIDTH]
        if len(elsewhere) and error[k] > max(_ALONE * elsewhere.max(), _FAR * np.std(elsewhere)):
            near = next((at for at in found if abs(t[at] - t[k]) < _WIDTH), k)
            found.setdefault(near, []).append((j, float(error[k])))
    for k, joints in found.items():
        sizes = ", ".join(
            f"{size:.3g} {physics.model.robot.torque_units[j]} in joint {j + 1}" for j, size in joints
        )
        at, begin = float(t[k]), float(t[k]) - 0.5 * _WIDTH

        def without(run: Measurements, begin: float = begin) -> Measurements:
            keep = (run.t < begin) | (run.t > begin + _WIDTH)
            return run.rows(keep)

        yield Issue(
            "one-off event", "warning", f"t = {at:.3g} s, {joints_text(j for j, _ in joints)}",
            f"a one-off event at t = {at:.3g} s (a knock, a contact, a lost packet): the error there "
            f"is {sizes}, over {_ALONE:g} times that at any other moment.",
            "likely: an effect of the arm itself would recur", f"exclude {_WIDTH:g} s around it",
            without, {"t": at, "joints": [j + 1 for j, _ in joints]},
        )  # fmt: skip
