"""Torque later than the motion, or through a causal filter: one channel, or all."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.checks.constants import ODD_NUMBER, ODDS, USUAL_DELAY
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformation import Element, Number, Scene, Transformation, choices

#: Delays (``lead`` of a repair) and time constants (``lag``) that are tried [s].
_TRIED = {"lead": (-0.12, -0.06, -0.025, -0.01, 0.01, 0.025, 0.06, 0.12), "lag": (0.01, 0.04, 0.1, 0.2)}


class Delay(Transformation):
    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        each = [(j,) for j in scene.joints] if len(scene.joints) > 1 else []
        for name, tried in _TRIED.items():
            for joints in (range(scene.n), *each):
                yield from (now.with_entries(name, joints, x) for x in tried)

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        for name in _TRIED:
            values = getattr(repair, name)
            every = any(values) and len(set(values)) == 1
            parts = [tuple(range(scene.n))] if every else [(j,) for j in np.flatnonzero(values).tolist()]
            yield from (self._element(scene, repair, name, joints) for joints in parts)

    def _element(self, scene: Scene, repair: Repair, name: str, joints: tuple[int, ...]) -> Element:
        every, x = len(joints) == scene.n, getattr(repair, name)[joints[0]]
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
        at = lambda v: repair.with_entries(name, joints, v)  # noqa: E731
        return Element(
            f"{'channel ' if not every else 'torque ' * (name == 'lag')}{kind}", "warning", joints,
            what, remedy, at(0.0), (ODDS if every else choices(scene.n)) + ODD_NUMBER + (name == "lag"),
            Number(x, at, USUAL_DELAY, 0.06, lambda v: f"{1e3 * v:.0f} ms"), mends=name == "lead",
            place="all torque channels" if every and scene.n > 1 else joints_text(joints),
            figures={"seconds": x},
        )  # fmt: skip
