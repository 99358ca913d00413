"""Gravity along another direction of the base, or taken out of the torques."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.checks.constants import LEVEL, MISMOUNTED, ODD_NUMBER, ODDS
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import Element, Number, Scene, Transformation, choices
from sdp_vs_penalty.robot.arrays import Array

#: On Earth [m/s^2]; a problem whose gravity is of another size is corrected.
_EARTH, _ABOUT = 9.81, 0.25
#: Shares of the weight that are tried to be left in a channel.
_LEFT = (0.0, 0.15)
#: Share of a channel that a plausible arm's weight makes (RMS), for the channel alone to be without it:
#: the weight that the last link of a wrist holds is within the error of its friction's law.
_CARRIES = 0.5


class Mounting(Transformation):
    """The six axes of the base come first, then directions around the assumed one."""

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        given = np.array(now.gravity)
        size = float(np.linalg.norm(given))
        known = abs(size - _EARTH) < _ABOUT
        if any(w != 1.0 for w in now.weight) or 0.0 < size < 1.0:
            return
        for axis in (*np.eye(3), *-np.eye(3)):
            if not known or axis @ given < 0.99 * size:
                yield replace(now, gravity=_vector((size if known else _EARTH) * axis))
        if not known:
            return
        turned = given
        for across in np.linalg.svd(given[None, :])[2][1:]:
            at = _turned(now, given, given + size * across)
            turned = turned + size * np.clip(scene.newton(at, 0.0, 0.02, score), -0.5, 0.5) * across
            yield from (at(angle) for angle in (-0.3, 0.3))
        if np.linalg.norm(turned) > size * (1.0 + 1e-6):
            yield replace(now, gravity=_vector(size * turned / np.linalg.norm(turned)))

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        assumed, g = np.array(scene.problem.robot.gravity), np.array(repair.gravity)
        if np.array_equal(assumed, g):
            return
        given = float(np.linalg.norm(assumed))
        cosine = assumed @ g / max(given * float(np.linalg.norm(g)), 1e-300)
        angle = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
        straight, earthly = np.count_nonzero(np.abs(g) > 1e-9) == 1, abs(given - _EARTH) < _ABOUT
        x, y, z = (float(round(v, 2)) + 0.0 for v in g)
        kind, remedy = "gravity direction", f"identify with --gravity {x:g},{y:g},{z:g}"
        what = (
            f"gravity is {np.degrees(angle):.0f} degrees away from the assumed {_text(assumed)}, along "
            f"{_text(g)} m/s^2: {_words(angle)}."
        )
        if not earthly:
            kind, remedy = "gravity of the problem", f"{remedy}, or correct the problem's gravity"
            what = (
                f"the problem assumes gravity {_text(assumed)} m/s^2, but the weight in the torques "
                f"points along {_text(g)} m/s^2."
            )
        yield Element(
            kind, "warning" if earthly and angle < MISMOUNTED else "error", (), what, remedy,
            replace(repair, gravity=_vector(assumed)), ODDS + (1.0 if straight else ODD_NUMBER),
            None if straight or not earthly else Number(
                angle, _turned(repair, assumed, g), LEVEL, 0.5, lambda v: f"{np.degrees(v):.3g} degrees"
            ),
            mends=False, place="the base",
            figures={"angle_degrees": float(np.degrees(angle)), "vector": [x, y, z]},
        )  # fmt: skip


def _turned(repair: Repair, assumed: Array, g: Array) -> Callable[[float], Repair]:
    """The repair with gravity turned by an angle from the assumed vector towards g."""
    size = float(np.linalg.norm(assumed))
    a = assumed / max(size, 1e-300)
    across = g - (g @ a) * a
    across = across / max(float(np.linalg.norm(across)), 1e-300)
    return lambda v: replace(repair, gravity=_vector(size * (np.cos(v) * a + np.sin(v) * across)))


class Weight(Transformation):
    """The arm's weight taken out of one channel, or of all, by the controller."""

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        if not any(now.gravity):
            return
        held = np.sqrt(np.mean(scene.tried.nominal_weight(now) ** 2, axis=0))
        logged = np.sqrt(np.mean(scene.tried.data.torque**2, axis=(0, 1)))
        for share in _LEFT:
            yield replace(now, weight=(share,) * scene.n)
            for j in np.flatnonzero(held > _CARRIES * logged).tolist():
                yield now.with_entries("weight", (j,), share)

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        every = tuple(range(scene.n))
        changed = [(j,) for j in every if repair.weight[j] != 1.0]
        common = len(set(repair.weight)) == 1
        for joints in [every] if changed and common else changed:
            at = lambda x, some=joints: repair.with_entries("weight", some, 1.0 + x)  # noqa: E731
            left = repair.weight[joints[0]]
            gx, gy, gz = (float(round(left * v, 3)) + 0.0 for v in repair.gravity)
            of = "the torques" if common else f"the torque of {joints_text(joints)}"
            how = f", or identify with --gravity {gx:g},{gy:g},{gz:g}" if common else ""
            yield Element(
                "gravity removed", "error", joints,
                f"{100.0 * (1.0 - left):.0f} % of the weight is missing from {of}.",
                f"log the torques before gravity compensation{how}", at(0.0),
                (ODDS if common else choices(scene.n)) + (0.0 if left == 0.0 else ODD_NUMBER),
                Number(left - 1.0, at, 0.2, 0.4, lambda v: f"{-100.0 * v:.0f} %", (-1.0,)),
                mends=False, figures={"share_left": left},
            )  # fmt: skip


def _vector(g: Array) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in g)
    return x, y, z


def _text(g: Array) -> str:
    return "(" + ", ".join(f"{float(f'{v:.3f}') + 0.0:g}" for v in g) + ")"


def _words(angle: float) -> str:
    if angle > np.radians(160.0):
        return "the base hangs from the ceiling"
    if np.radians(70.0) < angle < np.radians(110.0):
        return "the base is mounted sideways, on a wall"
    return "the base is tilted"
