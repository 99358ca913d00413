"""A torque channel that drifts with time, or that steps once: a contact, a load, a zero set anew."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Event, Repair
from sdp_vs_penalty.checks.transformations.transformation import (
    Element,
    Scene,
    Transformation,
    choices,
)
from sdp_vs_penalty.robot.arrays import Array

#: Instants, as shares of the log, at which a step is tried.
_STEPS = np.linspace(0.12, 0.88, 39)
#: Friction that warms up and slow noise look like a drift or a step (natural logarithm of the odds).
_SLOW = 15.0
#: Share of the time on either side of a step that the joint has to move each way: else it is friction's.
_WAYS = 0.15


class Change(Transformation):
    """By a score test: of each shape the part that the arm leaves, against the residual."""

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        motion = scene.tried.data.motion
        t = motion.t
        u = (t - t[0]) / max(float(t[-1] - t[0]), 1e-300)
        shapes = np.column_stack([u, *((u > s).astype(float) for s in _STEPS)])
        best: dict[bool, tuple[float, Event]] = {}
        for j in scene.joints:
            heard = scene.tried.data.heard[:, now.order[j], None]
            joint = score.joints[j]
            x = heard * shapes
            x = x - joint.basis @ (joint.basis.T @ x)
            found = np.log1p(
                (score.residual[:, j] @ x) ** 2
                / np.maximum(np.sum(x**2, axis=0) * score.left[j], 1e-280)
            )
            found[1:] *= _both_ways(motion.dq[:, now.order[j]], u)
            for drift, k in ((True, 0), (False, 1 + int(np.argmax(found[1:])))):
                at = None if drift else float(t[0] + _STEPS[k - 1] * (t[-1] - t[0]))
                known = best.get(drift, (0.0, Event(0)))
                best[drift] = max(known, (float(found[k]), Event(j, at)), key=lambda b: b[0])
        for _, event in best.values():
            if event not in now.events:
                yield replace(now, events=(*now.events, event))

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        for event in repair.events:
            others = tuple(e for e in repair.events if e != event)
            name, j = joints_text([event.joint]), event.joint
            drift = event.at is None
            size, unit = _size(scene, repair, event), scene.problem.robot.torque_units[j]
            t = "" if drift else f"{event.at:.4g}"
            what = (
                f"the torque of {name} drifts by {size:+.3g} {unit} from the first row to the last."
                if drift
                else f"the torque of {name} steps by {size:+.3g} {unit} at t = {t} s and stays there."
            )
            yield Element(
                "torque drift" if drift else "torque step", "warning", (j,),
                name if drift else f"{name}, t = {t} s", what,
                "let the sensor warm up and set its zero before the run, or identify from parts of it"
                if drift else "cut the run there, or find out what touched the arm",
                replace(repair, events=others), choices(scene.n * (1 if drift else len(_STEPS))) +
                _SLOW, mends=False,
                figures={"joints": [j + 1], "size": size} | ({} if drift else {"t": event.at}),
            )  # fmt: skip


def _size(scene: Scene, repair: Repair, event: Event) -> float:
    """How far the torque drifts or steps [N m, N]: by how much the fit of its joint needs it."""
    lacking = replace(repair, events=tuple(e for e in repair.events if e != event))
    score = scene.judged.scores([repair])[0]
    t, j = scene.judged.data.motion.t, event.joint
    shape = (t - t[0]) / max(t[-1] - t[0], 1e-300) if event.at is None else (t > event.at) * 1.0
    x = scene.judged.data.heard[:, repair.order[j]] * shape
    joint = scene.judged.joints(lacking)[j]
    x = x - joint.basis @ (joint.basis.T @ x)
    rest = score.channels[:, j] - joint.raw @ score.theta
    return float(x @ rest / max(x @ x, 1e-300))


def _both_ways(dq: Array, u: Array) -> NDArray[np.bool_]:
    """Per instant whether the joint moves both ways on either side."""
    rows = np.searchsorted(u, _STEPS, "right")
    before = np.append(0, np.cumsum(dq > 0.0))[rows]
    after = np.sum(dq > 0.0) - before
    forth = np.array([before / np.maximum(rows, 1), after / np.maximum(len(u) - rows, 1)])
    return np.asarray(np.min(np.minimum(forth, 1.0 - forth), axis=0) > _WAYS)
