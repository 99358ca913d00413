"""Torque against motion in time: a delay between the two, and events that happen once (a knock)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sdp_vs_penalty.check.evidence import parts_of
from sdp_vs_penalty.check.hypothesis import NEARLY_ALL
from sdp_vs_penalty.check.issue import Issue, joints_text
from sdp_vs_penalty.check.physics import OVERSAMPLING, Physics, solve
from sdp_vs_penalty.data.measurements import Measurements

#: A delay is named where it makes at least a fifth of the squared error ...
_BETTER = 0.8
#: ... and is at least so many samples long, and so many standard deviations.
_SAMPLES = 2.0
_SIGNIFICANT = 5.0
#: Delays too long for the first order that are tried [s].
_TRIED = (-0.2, -0.1, -0.05, -0.02, 0.02, 0.05, 0.1, 0.2)
#: What a part of the run may differ by, in its standard deviations.
_SAME = 3.0
#: An event is a peak of the error this many times higher than every other one. Two peaks of one
#: cause (a reversal of friction) differ far less.
_ALONE = 3.0
#: ... and this many standard deviations of the error elsewhere.
_FAR = 12.0
#: A joint slides at this share of its usual speed.
_SLIDES = 0.3
#: Errors this close to a peak belong to it [s].
_WIDTH = 1.0


def delay(run: Measurements, physics: Physics) -> Iterator[Issue]:
    """Torques logged later (or earlier) than the positions.

    C(t) = tau(t - T) to first order adds the column -dC/dt with the parameter T, on all joints alike.
    """
    fit = _fit_delay(physics)
    share = fit.error_with / fit.error
    step = float(np.median(np.diff(run.t)))
    if share > _BETTER or abs(fit.seconds) < max(_SAMPLES * step, _SIGNIFICANT * fit.deviation):
        return
    # A channel is late by the same time throughout; what stiction and rests make of it comes and goes.
    parts = [_fit_delay(physics.part(rows)) for rows in parts_of(len(physics.motion.t))]
    if sum(p.agrees_with(fit) for p in parts) < NEARLY_ALL:
        return
    kind, where, what, remedy = delay_texts(fit.seconds)
    yield Issue(
        kind,
        "warning",
        where,
        what,
        f"likely: correcting it reduces the fit error by {100.0 * (1.0 - np.sqrt(share)):.0f} %; it "
        "is the same all over the run",
        remedy,
        lambda given: shifted(given, fit.seconds),
        {"seconds": fit.seconds, "std": fit.deviation, "error_share_left": share},
    )


def delay_texts(seconds: float) -> tuple[str, str, str, str]:
    """Kind, where, what and remedy."""
    late = "later" if seconds > 0.0 else "earlier"
    return (
        "delay",
        "all torque channels",
        f"the torques come {1e3 * abs(seconds):.1f} ms {late} than the positions.",
        "shift the torques in time (and log both from one source)",
    )


def long_delay(physics: Physics) -> float:
    """The delay [s] that fits best among those too long for the first order, refined; 0 for none."""
    base = _fit_delay(physics).error
    tried = {d: _fit_delay(physics.with_delay(d)) for d in _TRIED}
    coarse = min(tried, key=lambda d: tried[d].error_with)
    if tried[coarse].error_with > base:
        return 0.0
    return coarse + tried[coarse].seconds


@dataclass(frozen=True)
class _DelayFit:
    """A delay and its standard deviation [s]; the noise-weighted error share without and with it."""

    seconds: float
    deviation: float
    error: float
    error_with: float

    def agrees_with(self, whole: _DelayFit) -> bool:
        """Whether a part of a run says what the whole run does, as far as it can say anything."""
        apart = abs(self.seconds - whole.seconds)
        return bool(apart < max(0.5 * abs(whole.seconds), _SAME * self.deviation))


def _fit_delay(physics: Physics) -> _DelayFit:
    """The delay of all channels that fits best, to first order.

    Joints are weighted by their own noise, so that those with little but friction, whose own lag is
    no delay of the channel, count for little.
    """
    count = len(physics.channels)
    weights = 1.0 / (np.maximum(np.diagonal(physics.alone), 1e-6) * physics.energy * count)
    p = physics.columns[0].shape[1]
    gram, cross, total = np.zeros((p + 1, p + 1)), np.zeros(p + 1), 0.0
    for j, columns in enumerate(physics.columns):
        wide = np.column_stack([columns, -physics.rate[:, j]])
        gram += weights[j] * wide.T @ wide
        cross += weights[j] * wide.T @ physics.channels[:, j]
        total += weights[j] * float(physics.channels[:, j] @ physics.channels[:, j])
    without = total - float(cross[:p] @ solve(gram[:p, :p], cross[:p, None])[:, 0])
    theta = solve(gram, cross[:, None])[:, 0]
    left = max(total - float(cross @ theta), 1e-12 * total)
    last = np.zeros((p + 1, 1))
    last[-1] = 1.0
    variance = left / (count * physics.n) * OVERSAMPLING * float(solve(gram, last)[-1, 0])
    without = max(without, left)
    return _DelayFit(float(theta[-1]), float(np.sqrt(max(variance, 0.0))), without / total, left / total)


def shifted(run: Measurements, seconds: float) -> Measurements:
    """Torques moved ``seconds`` earlier; the rows at the end that lose theirs are left out."""
    t = run.t
    keep = (t + seconds >= t[0]) & (t + seconds <= t[-1])
    tau = np.column_stack([np.interp(t[keep] + seconds, t, x) for x in run.tau.T])
    return replace(run.rows(keep), tau=tau)


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
            "one-off event",
            "warning",
            f"t = {at:.3g} s, {joints_text(j for j, _ in joints)}",
            f"a one-off event at t = {at:.3g} s (a knock, a contact, a lost packet): the error there "
            f"is {sizes}, over {_ALONE:g} times that at any other moment.",
            "likely: an effect of the arm itself would recur",
            f"exclude {_WIDTH:g} s around it",
            without,
            {"t": at, "joints": [j + 1 for j, _ in joints]},
        )
