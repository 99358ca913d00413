"""Wrong signs, orders, units, gravity, delays and knocks: what the arm's own dynamics gives away."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check import events
from sdp_vs_penalty.check.finding import Array, Finding, Repair, joints_text
from sdp_vs_penalty.check.physics import FreeGravity, Physics
from sdp_vs_penalty.check.signals import angle_scale
from sdp_vs_penalty.measurements import Measurements

Order = NDArray[np.intp]

#: A hypothesis has to leave less than this share of what is unexplained without it, over the whole
#: run, and to help in each half of it: an effect that a model misses explains far less.
_BETTER = 0.5
_HELPS = 0.75
#: Of hypotheses that explain about the same, the simpler one is believed.
_ABOUT_SAME = 1.5
#: Gravity is said to point elsewhere from this angle on; smaller ones are the effect base_tilt.
_SMALLEST_ANGLE = 5.0
#: Within this angle of an axis of the base gravity is said to point along it [degrees].
_STRAIGHT = 3.0
#: Standard deviations by which a friction power must be negative to call it a flipped sign.
_SIGNIFICANT = 5.0
#: Correlation of the torque with a plausible arm's weight below minus this: weight acts upwards.
_OPPOSED = 0.5
#: From this share unexplained on something is badly wrong, though nothing says what.
_BAD = 0.1
#: An arm whose torques are explained up to this share of their energy has nothing gross wrong.
_ENOUGH = 0.01
#: Above this share of the energy, half of the torque, the arm's dynamics do not make these torques.
_UNRELATED = 0.25
#: At most so many things wrong at once are looked for.
_ROUNDS = 4
#: Rows for hypotheses about the motion, which need new columns each.
_FEW_ROWS = 250


@dataclass(frozen=True)
class Hypothesis:
    """Something that may be wrong with the file; ``apply`` turns the test's data into what is right."""

    finding: Finding
    apply: Callable[[Physics], Physics]
    simplicity: int


def find(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Finding]:
    """Findings in the order in which to mend them, if together they explain the torque.

    Where nothing does, the one finding is that: a cause that leaves most in the dark is no cause.
    """
    first = physics.unexplained_of(moving)
    recorded, found = physics, []
    for _ in range(_ROUNDS):
        hypothesis = best_hypothesis(physics, moving)
        if hypothesis is None:
            break
        found.append(hypothesis.finding)
        physics = hypothesis.apply(physics)
    if len(found) > 1:
        # One position turned may look like two other mistakes: a mirrored arm is an arm too.
        for hypothesis in _motion(recorded, moving):
            mended = hypothesis.apply(recorded)
            enough = _ABOUT_SAME * physics.unexplained
            if mended.unexplained < enough and best_hypothesis(mended, moving) is None:
                found, physics = [hypothesis.finding], mended
    left = physics.unexplained_of(moving)
    if left < _BAD:
        yield from found
        return
    unrelated = left > _UNRELATED
    yield Finding(
        "torque not explained" if unrelated else "torque badly explained",
        "error" if unrelated else "warning",
        "all torque channels",
        f"{100.0 * first:.0f} % of the energy of the moving joints' torques has nothing to do with how "
        "this arm should move under them, whatever its inertias and friction.",
        "certain: no sign, order, unit or direction of gravity that was tried helps",
        "check that this is the right robot, that the columns are joint torques, and that positions "
        "and torques come from the same recording",
        None,
        {"unexplained_percent": 100.0 * first, "at_best_percent": 100.0 * left},
    )


def best_hypothesis(physics: Physics, moving: NDArray[np.bool_]) -> Hypothesis | None:
    """The simplest of the hypotheses that explain the torque best, or None where none does."""
    base = physics.unexplained
    found: list[tuple[float, Hypothesis]] = []
    # Where next to nothing is unexplained, only what acts on it weakly can be wrong.
    every = (_degrees, _delay, _signs, _order, _gravity, _motion)
    for make in every if base > _ENOUGH else (_signs, _gravity):
        for hypothesis in make(physics, moving):
            after = hypothesis.apply(physics).unexplained
            if after < _BETTER * base:
                found.append((after, hypothesis))
        # An explanation that leaves next to nothing makes the dearer ones unnecessary.
        if found and min(found, key=lambda f: f[0])[0] < _ENOUGH:
            break
    best = min((after for after, _ in found), default=np.inf)
    near = [f for f in found if f[0] <= _ABOUT_SAME * best]
    for _, hypothesis in sorted(near, key=lambda f: f[1].simplicity):
        if _holds_in_both_halves(physics, hypothesis):
            return hypothesis
    return _weak_signs(physics) or _hanging(physics)


def _holds_in_both_halves(physics: Physics, hypothesis: Hypothesis) -> bool:
    half = len(physics.motion.t) // 2
    for rows in (slice(0, half), slice(half, None)):
        part = physics.part(rows)
        if hypothesis.apply(part).unexplained > _HELPS * part.unexplained:
            return False
    return True


def _certainty(before: float, after: float) -> str:
    word = "certain" if after < 0.1 * before else "likely"
    return (
        f"{word}: the torque that the arm's dynamics leave unexplained falls from "
        f"{100.0 * np.sqrt(before):.3g} % to {100.0 * np.sqrt(after):.3g} %"
    )


def _made(
    physics: Physics,
    apply: Callable[[Physics], Physics],
    simplicity: int,
    texts: tuple[str, str, str, str],
    repair: Repair | None,
    gravity: tuple[float, float, float] | None = None,
    **figures: object,
) -> Hypothesis:
    kind, where, what, remedy = texts
    before, after = physics.unexplained, apply(physics).unexplained
    figures |= {"unexplained_before": before, "unexplained_after": after}
    sure = _certainty(before, after)
    finding = Finding(kind, "error", where, what, sure, remedy, repair, figures, gravity)
    return Hypothesis(finding, apply, simplicity)


def _degrees(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    robot = physics.model.robot
    scale = angle_scale(robot)
    if np.all(scale == 1.0):
        return
    same = np.arange(robot.n)
    largest = float(np.abs(physics.motion.q[:, scale != 1.0]).max(initial=0.0))
    if largest < np.pi:
        return

    def repair(run: Measurements) -> Measurements:
        dq = None if run.dq is None else run.dq * scale
        return replace(run, q=run.q * scale, dq=dq)

    yield _made(
        physics,
        lambda p: p.with_motion(scale, same),
        0,
        (
            "positions in degrees",
            "q1" if robot.n == 1 else f"q1 to q{robot.n}",
            f"the positions are in degrees, not in radians (they reach {largest:.4g}).",
            "multiply q (and dq) of revolute joints by pi / 180",
        ),
        repair,
        largest=largest,
    )


def _delay(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """A delay so long that it spoils the test of everything else."""
    seconds = events.long_delay(physics)
    if seconds == 0.0:
        return
    made = _made(
        physics,
        lambda p: p.with_delay(seconds),
        1,
        events.delay_texts(seconds),
        lambda run: events.shifted(run, seconds),
        seconds=seconds,
    )
    yield replace(made, finding=replace(made.finding, severity="warning"))


def _flip(physics: Physics, joints: list[int], certainty: str | None = None) -> Hypothesis:
    signs = np.ones(physics.n)
    signs[joints] = -1.0
    same = np.arange(physics.n)
    every = len(joints) == physics.n
    made = _made(
        physics,
        lambda p: p.with_channels(signs, same),
        len(joints),
        (
            "torque sign",
            joints_text(joints),
            f"the torque of {'every joint' if every else joints_text(joints)} has the wrong sign.",
            "turn the sign of " + ", ".join(f"tau{j + 1}" for j in joints),
        ),
        lambda run: replace(run, tau=run.tau * signs),
        joints=[j + 1 for j in joints],
    )
    if certainty is None:
        return made
    return replace(made, finding=replace(made.finding, certainty=certainty))


def _signs(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """The signs that the coupling between the joints prefers; friction decides where that is silent."""
    signs = _choose_signs(physics)
    flipped = np.flatnonzero(signs < 0.0)
    if len(flipped):
        yield _flip(physics, flipped.tolist())


def _choose_signs(physics: Physics) -> Array:
    """Signs among those that explain the torque about as well as the best ones.

    Of a set of signs and its opposite, and of signs of joints that nothing couples, physics knows the
    right ones: friction takes power, and inertia is positive. Where both are silent, as few signs are
    turned as possible.
    """
    n = physics.n
    best, loss = physics.best_signs()
    power, deviation = physics.dissipation
    z = power / deviation
    knows = np.where(np.abs(z) > _SIGNIFICANT, np.clip(z, -20.0, 20.0), 0.0)
    if n <= 12:
        candidates = np.array(list(product((1.0, -1.0), repeat=n)))
    else:
        candidates = np.vstack([np.ones(n), -np.ones(n), best, -best])
    losses = np.einsum("ka,ab,kb->k", candidates, physics.form, candidates)
    near = candidates[losses <= _ABOUT_SAME * loss]
    inertia = near @ physics.inertia
    inertia = np.where(np.abs(inertia) > _SIGNIFICANT, np.clip(inertia, -20.0, 20.0), 0.0)
    score = near @ knows + inertia - 1e-3 * np.sum(near < 0.0, axis=1)
    return np.asarray(near[int(np.argmax(score))], float)


def _weak_signs(physics: Physics) -> Hypothesis | None:
    """Joints whose friction would drive the motion, although the coupling does not tell."""
    # The coupling ties some signs to each other: with those that physics turns, others turn.
    signs = _choose_signs(physics)
    joints = [int(j) for j in np.flatnonzero(signs < 0.0)]
    if not joints:
        return None
    half = len(physics.motion.t) // 2
    parts = [physics.part(slice(0, half)), physics.part(slice(half, None))]
    power, deviation = physics.dissipation
    drives = power < -_SIGNIFICANT * deviation
    backwards = float(physics.inertia.sum()) < -_SIGNIFICANT
    for part in parts:
        drives &= part.dissipation[0] < 0.0
        backwards &= float(part.inertia.sum()) < 0.0
    driven = ", ".join(f"{-power[j]:.3g} W in joint {j + 1}" for j in joints if drives[j])
    if driven:
        return _flip(physics, joints, f"likely: as recorded, friction would drive the motion ({driven})")
    if backwards:
        return _flip(physics, joints, "likely: as recorded, the arm's inertia would be negative")
    return None


def _hanging(physics: Physics) -> Hypothesis | None:
    """Gravity upside down: with all weights negative it explains the torque about as well.

    Only that masses are positive tells the two apart: the weight of any plausible arm has the
    measured torque's sign.
    """
    robot = physics.model.robot
    if not any(robot.gravity):
        return None
    x, y, z = (-g + 0.0 for g in robot.gravity)

    def apply(p: Physics) -> Physics:
        return p.with_gravity((x, y, z))

    before, after = physics.unexplained, apply(physics).unexplained
    agreement = physics.agreement_with_weight()
    negative = float(apply(physics).inertia.sum()) < -_SIGNIFICANT
    if after > _ABOUT_SAME * before or agreement > -_OPPOSED or negative:
        return None
    half = len(physics.motion.t) // 2
    if any(physics.part(k).agreement_with_weight() > 0.0 for k in (slice(0, half), slice(half, None))):
        return None
    texts = (
        "gravity direction",
        "the base",
        f"gravity points the other way, along {_vector((x, y, z))} m/s^2: {_mounting(180.0)}.",
        f"identify with --gravity {x:g},{y:g},{z:g}",
    )
    made = _made(physics, apply, 1, texts, None, (x, y, z), angle_degrees=180.0, vector=[x, y, z])
    sure = f"likely: as recorded, links would weigh less than nothing (correlation {agreement:.2f})"
    return replace(made, finding=replace(made.finding, certainty=sure))


def _order(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """Torque channels in another order: each pair exchanged, and the order that fits joint by joint."""
    n = physics.n
    orders = []
    for a, b in combinations(np.flatnonzero(moving), 2):
        order: Order = np.arange(n, dtype=np.intp)
        order[[a, b]] = order[[b, a]]
        # Only where both channels suit the other joint at least as well, each joint by itself.
        own = physics.alone[a, a] * physics.alone[b, b]
        if physics.alone[a, b] * physics.alone[b, a] < own:
            orders.append(order)
    orders.append(physics.best_order())
    for order in orders:
        changed = np.flatnonzero(order != np.arange(n))
        if not len(changed) or not np.all(moving[changed]):
            continue
        swapped = physics.with_channels(np.ones(n), order)
        signs = _choose_signs(swapped)
        turned = np.flatnonzero(signs < 0.0)
        swap = len(changed) == 2
        named = ", ".join(f"tau{order[j] + 1} is that of joint {j + 1}" for j in changed)
        what = (
            f"the torques of {joints_text(changed)} are exchanged."
            if swap
            else f"the torque channels are in another order: {named}."
        )
        also = (
            f", and turn the sign of joint(s) {', '.join(str(j + 1) for j in turned)}"
            if len(turned)
            else ""
        )

        def apply(p: Physics, order: Order = order, signs: Array = signs) -> Physics:
            return p.with_channels(signs, order)

        def repair(run: Measurements, order: Order = order, signs: Array = signs) -> Measurements:
            return replace(run, tau=run.tau[:, order] * signs)

        yield _made(
            physics,
            apply,
            len(changed) + len(turned),
            ("torque order", joints_text(changed), what, f"rename the torque columns{also}"),
            repair,
            order=(order + 1).tolist(),
            signs=signs.tolist(),
        )


def _gravity(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    robot = physics.model.robot
    size = float(np.linalg.norm(robot.gravity))
    if size == 0.0:
        return
    direction, _ = FreeGravity(physics.part(_few(physics))).best()
    assumed = np.array(robot.gravity) / size
    angle = float(np.degrees(np.arccos(np.clip(direction @ assumed, -1.0, 1.0))))
    if angle < _SMALLEST_ANGLE:
        return
    nearest = np.eye(3)[int(np.argmax(np.abs(direction)))] * np.sign(
        direction[np.argmax(np.abs(direction))]
    )
    if direction @ nearest > np.cos(np.radians(_STRAIGHT)):
        direction = nearest  # a base mounted straight, seen through the error of the fit
    x, y, z = (float(round(g, 2)) + 0.0 for g in size * direction)

    def apply(p: Physics) -> Physics:
        return p.with_gravity((x, y, z))

    yield _made(
        physics,
        apply,
        2,
        (
            "gravity direction",
            "the base",
            f"gravity does not point along {_vector(robot.gravity)} of the base but {angle:.0f} degrees "
            f"beside it, along {_vector((x, y, z))} m/s^2: {_mounting(angle)}.",
            f"identify with --gravity {x:g},{y:g},{z:g}",
        ),
        None,
        (x, y, z),
        angle_degrees=angle,
        vector=[x, y, z],
    )


def _vector(values: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{v:g}" for v in values) + ")"


def _mounting(angle: float) -> str:
    if angle > 160.0:
        return "the base hangs from the ceiling"
    if 70.0 < angle < 110.0:
        return "the base is mounted sideways, on a wall"
    return "the base is tilted"


def _motion(physics: Physics, moving: NDArray[np.bool_]) -> Iterator[Hypothesis]:
    """A position channel with the wrong sign, or two exchanged: tried on few rows first."""
    n = physics.n
    few = physics.part(_few(physics))
    base = few.unexplained
    movers = np.flatnonzero(moving)
    tried: list[tuple[float, Array, NDArray[np.intp], tuple[str, str, str, str], dict[str, object]]] = []
    for j in movers:
        scale = np.ones(n)
        scale[j] = -1.0
        name = joints_text([j])
        texts = (
            "position sign",
            name,
            f"the position of {name} has the wrong sign.",
            f"turn the sign of q{j + 1} (and dq{j + 1})",
        )
        same = np.arange(n)
        left = few.with_motion(scale, same).unexplained
        tried.append((left, scale, same, texts, {"joints": [int(j) + 1]}))
    for a, b in combinations(movers, 2):
        order: Order = np.arange(n, dtype=np.intp)
        order[[a, b]] = order[[b, a]]
        name = joints_text([a, b])
        texts = (
            "position order",
            name,
            f"the positions of {name} are exchanged.",
            f"exchange q{a + 1} and q{b + 1} (and dq)",
        )
        left = few.with_motion(np.ones(n), order).unexplained
        tried.append((left, np.ones(n), order, texts, {"joints": [int(a) + 1, int(b) + 1]}))
    if not tried:
        return
    left, scale, order, texts, figures = min(tried, key=lambda item: item[0])
    if left > _BETTER * base:
        return

    def repair(run: Measurements) -> Measurements:
        dq = None if run.dq is None else scale * run.dq[:, order]
        return replace(run, q=scale * run.q[:, order], dq=dq)

    yield _made(physics, lambda p: p.with_motion(scale, order), 3, texts, repair, None, **figures)


def _few(physics: Physics) -> NDArray[np.intp]:
    count = len(physics.motion.t)
    return np.unique(np.linspace(0, count - 1, min(count, _FEW_ROWS)).astype(np.intp))
