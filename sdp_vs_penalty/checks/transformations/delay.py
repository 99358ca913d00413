"""Torque later than the motion, or through a causal filter: one channel, or all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.transformations.transformation import (
    ODD_NUMBER,
    ODDS,
    Element,
    Number,
    Scene,
    Transformation,
    choices,
)

#: Delays and time constants that are tried [s].
_LATE, _SLOW = (-0.12, -0.06, -0.025, -0.01, 0.01, 0.025, 0.06, 0.12), (0.01, 0.04, 0.1, 0.2)
#: Drives and their drivers take as long [s].
_USUAL = 0.005


class Delay(Transformation):
    """``lead`` and ``lag`` of the torque channels."""

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        for name, steps in (("lead", _LATE), ("lag", _SLOW)):
            for x in steps:
                every: dict[str, Any] = {name: (x,) * scene.n}
                yield replace(now, **every)
                if len(scene.joints) > 1:
                    for j in scene.joints:
                        yield now.with_entry(name, j, x)

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        for name in ("lead", "lag"):
            values = getattr(repair, name)
            if not any(values):
                continue
            if len(set(values)) == 1:
                yield self._element(scene, repair, name, tuple(range(scene.n)))
            else:
                for j, x in enumerate(values):
                    if x:
                        yield self._element(scene, repair, name, (j,))

    def _element(self, scene: Scene, repair: Repair, name: str, joints: tuple[int, ...]) -> Element:
        every = len(joints) == scene.n and scene.n > 1

        def at(x: float) -> Repair:
            values = getattr(repair, name)
            changed: dict[str, Any] = {
                name: tuple(x if j in joints else v for j, v in enumerate(values))
            }
            return replace(repair, **changed)

        x = getattr(repair, name)[joints[0]]
        where = "all torque channels" if every else joints_text(joints)
        of = "the torques" if every else f"the torque of {where}"
        channel = "the torques" if every else f"tau{joints[0] + 1}"
        if name == "lead":
            kind = "delay" if every else "channel delay"
            beside = "the positions." if every else "the motion; the other torques do not."
            what = (
                f"{of} {'come' if every else 'comes'} {1e3 * abs(x):.0f} ms "
                f"{'later' if x > 0.0 else 'earlier'} than {beside}"
            )
            remedy = f"shift {channel} in time (and log all channels from one source)"
        else:
            kind = "torque filter" if every else "channel filter"
            what = (
                f"{of} {'have' if every else 'has'} passed a causal low-pass of "
                f"{1.0 / (2.0 * np.pi * max(x, 1e-6)):.2g} Hz ({1e3 * x:.0f} ms); "
                + ("the positions have not." if every else "the other torques have not.")
            )
            remedy = f"log {channel} unfiltered, or filter every channel alike and without lag"
        return Element(
            kind, "warning", joints, where, what, remedy, at(0.0),
            (ODDS if every else choices(scene.n)) + ODD_NUMBER + (1.0 if name == "lag" else 0.0),
            mends=name == "lead",
            number=Number(x, at, _USUAL, 0.06, lambda v: f"{1e3 * v:.0f} ms"),
            figures={"seconds": x, "joints": [j + 1 for j in joints]},
        )  # fmt: skip
