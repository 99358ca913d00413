"""A torque channel that drifts with time, or that steps once: a contact, a load, a zero set anew."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.checks.constants import SLOW_ODDS
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Score
from sdp_vs_penalty.checks.repair import Event, Repair
from sdp_vs_penalty.checks.transformation import Element, Scene, Transformation, choices
from sdp_vs_penalty.robot.arrays import Array

#: Instants, as shares of the log, at which a step is tried.
_STEPS = np.linspace(0.12, 0.88, 39)
#: Share of the time on either side of a step that the joint has to move each way: else it is friction's.
_WAYS = 0.15


class Change(Transformation):
    """By a score test: of each shape the part that the arm leaves, against the residual."""

    def proposals(self, scene: Scene, now: Repair, score: Score) -> Iterator[Repair]:
        motion = scene.tried.data.motion
        t, span = motion.t, float(np.ptp(motion.t))
        events = [None, *(float(t[0] + s * span) for s in _STEPS)]
        shapes = np.column_stack([Event(0, at).shape(t) for at in events])
        heard = scene.tried.data.heard.T[list(now.order)]
        x = score.rows.rest(heard[:, :, None] * shapes)
        pull = np.einsum("jm,jmk->jk", score.residual, x) ** 2
        found = np.log1p(pull / np.maximum(np.sum(x**2, axis=1) * score.left[:, None], 1e-280))
        found[~scene.moving] = 0.0
        for j in scene.joints:
            found[j, 1:] *= _both_ways(motion.dq[:, now.order[j]], (t - t[0]) / max(span, 1e-300))
        for drift in (True, False):
            some = found[:, :1] if drift else found * (np.arange(len(events)) > 0)
            j, k = divmod(int(np.argmax(some)), some.shape[1])
            event = Event(j, events[k])
            if event not in now.events and found[j, k] > 0.0:
                yield replace(now, events=(*now.events, event))

    def elements(self, scene: Scene, repair: Repair) -> Iterator[Element]:
        for event in repair.events:
            j, drift, t = event.joint, event.at is None, event.at
            name, unit = joints_text([j]), scene.problem.robot.torque_units[j]
            without = replace(repair, events=tuple(e for e in repair.events if e != event))
            size = _size(scene, repair, without, event)
            how = f"drifts by {size:+.3g} {unit} from the first row to the last"
            remedy = (
                "let the sensor warm up and set its zero before the run, or identify from parts of it"
            )
            if not drift:
                how = f"steps by {size:+.3g} {unit} at t = {t:.4g} s and stays there"
                remedy = "cut the run there, or find out what touched the arm"
            yield Element(
                "torque drift" if drift else "torque step", "warning", (j,),
                f"the torque of {name} {how}.", remedy, without,
                choices(scene.n * (1 if drift else len(_STEPS))) + SLOW_ODDS, mends=False,
                place=name if drift else f"{name}, t = {t:.4g} s",
                figures={"size": size} | ({} if drift else {"t": t}),
            )  # fmt: skip


def _size(scene: Scene, repair: Repair, without: Repair, event: Event) -> float:
    """How far the torque drifts or steps [N m, N]: by how much the fit of its joint needs it."""
    score, j = scene.judged.score(repair), event.joint
    lacking, shape = scene.judged.rows(without), event.shape(scene.judged.data.motion.t)
    heard = scene.judged.data.heard[:, repair.order[j]]
    x = lacking.rest(np.repeat((heard * shape)[None, :, None], scene.n, axis=0))[j, :, 0]
    away = score.channels[j] - lacking.raw[j] @ score.theta
    return float(x @ away / max(x @ x, 1e-300))


def _both_ways(dq: Array, u: Array) -> NDArray[np.bool_]:
    """Per instant whether the joint moves both ways on either side."""
    rows = np.searchsorted(u, _STEPS, "right")
    before = np.append(0, np.cumsum(dq > 0.0))[rows]
    after = np.sum(dq > 0.0) - before
    forth = np.array([before / np.maximum(rows, 1), after / np.maximum(len(u) - rows, 1)])
    return np.asarray(np.min(np.minimum(forth, 1.0 - forth), axis=0) > _WAYS)
