"""Torque later than the motion, or through a causal filter: one channel, or all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from sdp_vs_penalty.checks.constants import ODD_NUMBER, ODDS, USUAL_DELAY
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformations.transformation import (
    Element,
    Number,
    Scene,
    Transformation,
    choices,
)  # fmt: skip

#: Delays (``lead`` of a repair) and time constants (``lag``) that are tried [s].
_TRIED = {
    "lead": (-0.12, -0.06, -0.025, -0.01, 0.01, 0.025, 0.06, 0.12),
    "lag": (0.01, 0.04, 0.1, 0.2),
}


class Delay(Transformation):
    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        for name, x in ((name, x) for name, tried in _TRIED.items() for x in tried):
            yield _with(now, name, tuple(range(scene.n)), x)
            for j in scene.joints if len(scene.joints) > 1 else ():
                yield now.with_entry(name, j, x)

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        for name in _TRIED:
            values = getattr(repair, name)
            if any(values) and len(set(values)) == 1:
                yield self._element(scene, repair, name, tuple(range(scene.n)))
            else:
                for j in np.flatnonzero(values).tolist():
                    yield self._element(scene, repair, name, (j,))

    def _element(self, scene: Scene, repair: Repair, name: str, joints: tuple[int, ...]) -> Element:
        every, x = len(joints) == scene.n, getattr(repair, name)[joints[0]]
        where = "all torque channels" if every and scene.n > 1 else joints_text(joints)
        channel = "the torques" if every else f"tau{joints[0] + 1}"
        beside = "the positions have not" if every else "the other torques have not"
        if name == "lead":
            kind, later = "delay", "later" if x > 0.0 else "earlier"
            what = f"{1e3 * abs(x):.0f} ms {later} than the motion: {channel}; {beside} moved."
            remedy = f"shift {channel} in time (and log all channels from one source)"
        else:
            kind, hertz = "filter", 1.0 / (2.0 * np.pi * max(x, 1e-6))
            what = f"a causal low-pass of {hertz:.2g} Hz ({1e3 * x:.0f} ms) on {channel}; {beside} one."
            remedy = f"log {channel} unfiltered, or filter every channel alike and without lag"
        prefix = "channel " if not every else "torque " if kind == "filter" else ""
        return Element(
            f"{prefix}{kind}", "warning", joints, what, remedy, _with(repair, name, joints, 0.0),
            (ODDS if every else choices(scene.n)) + ODD_NUMBER + (name == "lag"),
            Number(
                x, lambda v: _with(repair, name, joints, v), USUAL_DELAY, 0.06,
                lambda v: f"{1e3 * v:.0f} ms",
            ), mends=name == "lead", place=where, figures={"seconds": x},
        )  # fmt: skip


def _with(repair: Repair, name: str, joints: tuple[int, ...], x: float) -> Repair:
    values = (x if j in joints else v for j, v in enumerate(getattr(repair, name)))
    changed: dict[str, Any] = {name: tuple(values)}
    return replace(repair, **changed)
