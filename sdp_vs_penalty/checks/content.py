"""What a run's channels mean: the net repair that makes them one arm's, in words, and what is left."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sdp_vs_penalty.checks import channel_rules as rules
from sdp_vs_penalty.checks import excitation, residual, size
from sdp_vs_penalty.checks.constants import JUDGED, TRIED, UNRELATED
from sdp_vs_penalty.checks.glance import Glance
from sdp_vs_penalty.checks.issue import Issue
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.regression_data import RegressionData
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.search import Found, Search
from sdp_vs_penalty.checks.transformation import Element, Scene
from sdp_vs_penalty.checks.transformations import TRANSFORMATIONS
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.signals.preprocessing import Preprocessing

#: Independent samples for each parameter, below which a good fit says nothing.
_SPARE = 1.5
#: What is this much likelier than without it (natural logarithm) is certain, where it explains nine
#: tenths of what a joint's torque leaves over, or half as much again (a factor of ten in odds for each
#: doubling).
_CERTAIN, _TENFOLD = 30.0, 10.0
#: A joint whose position never changes leaves less than this share of its torque unexplained.
_HELD = 0.15


@dataclass(frozen=True)
class Content:
    """issues; scene and net ``repair``; ``certain`` the part of it without doubt; unexplained : share
    of the torques' energy that is left; settled : whether there were samples to spare for the
    parameters."""

    issues: list[Issue]
    scene: Scene | None
    repair: Repair
    certain: Repair
    unexplained: float | None
    settled: bool

    def mend(self, run: Measurements, certain: bool) -> Measurements:
        """A run with the net repair, or its certain part, and what other issues mend."""
        repair = self.certain if certain else self.repair
        if not repair.leaves_log:
            run = repair.apply(run)
        for issue in self.issues:
            if issue.repair is not None and "net" not in issue.figures and (issue.mends or not certain):
                run = issue.repair(run)
        return run


def content(
    problem: Problem, run: Measurements, settings: Preprocessing, thorough: bool
) -> Content | None:
    """None where there is nothing that any question can be asked of."""
    if len(run.t) < 10:
        raise InputError("fewer than 10 usable rows", "record longer", run.names[0])
    glance = Glance(run, problem.robot, settings.standstill)
    none = Repair.none(run.n, problem.robot.gravity)
    if not glance.moving.any():
        return _stopped(none, rules.NO_MOTION(glance))
    settings = settings.resolve(run)
    glance = replace(glance, settings=settings)
    if not run.torque_logged:  # rows, clock and positions are all there is
        told = (rules.IDLE, rules.STAND_STILL, rules.QUANTISATION, rules.RATE, rules.implausible)
        return _stopped(none, (issue for rule in told for issue in rule(glance)))
    data = RegressionData.of(problem, run, settings, JUDGED)
    scene = Scene(problem, Likelihood(data.few(TRIED)), Likelihood(data), any(rules.RATE(glance)))
    first = [*_frozen(scene, glance), *rules.DEAD(glance), *rules.MAGNITUDE(glance)]
    if any(i.kind in ("frozen position", "torque magnitude") for i in first):
        return _stopped(none, first)  # nothing else can be asked of such a motion
    found = Search(scene).run()
    score = found.after
    settled = _settled(scene, settings)
    stated = _stated(scene, found)
    dark = float(np.mean(score.shares[scene.moving])) > UNRELATED
    issues = first if dark else [*first, *stated]  # no cause that leaves most dark
    sizes = list(size.find(scene, found.repair))
    issues += sizes
    if any(i.kind == "torque channel kind" for i in issues):
        issues = [replace(i, severity="note") if i.kind == "torque gain" else i for i in issues]
    velocity = list(rules.VELOCITY(glance))
    issues += [
        *residual.find(scene, found.repair, score, settled), *rules.IDLE(glance),
        *rules.STAND_STILL(glance), *velocity, *rules.QUANTISATION(glance), *rules.RATE(glance),
    ]  # fmt: skip
    bent = {e.joints[0] + 1 for e in found.elements if e.kind == "saturation"}
    issues += [i for i in rules.SATURATION(glance) if i.figures["joint"] not in bent]
    moved = ("encoder offset", "positions in degrees", "position unit")
    if not any(e.kind in moved for e in found.elements):
        for issue in velocity:
            run = issue.repair(run) if issue.repair is not None else run
        issues += rules.implausible(replace(glance, run=run))
    if thorough:
        for issue in sizes:
            run = issue.repair(run) if issue.repair is not None else run
        run = run if found.repair.leaves_log else found.repair.apply(run)
        issues += excitation.find(problem.with_gravity(found.repair.gravity), run, settings)
        issues += excitation.hidden_errors(scene, found.repair)
    unexplained = float(score.left[scene.moving].sum() / score.whole[scene.moving].sum())
    certain = _certain(scene, found, stated)
    # A report holds the rows, not what was worked out of them.
    scene = replace(scene, tried=Likelihood(scene.tried.data), judged=Likelihood(data))
    return Content(issues, scene, found.repair, certain, unexplained, settled)


def _certain(scene: Scene, found: Found, stated: Sequence[Issue]) -> Repair:
    """The net repair without what is only likely."""
    certain = found.repair
    for issue, doubtful in zip(stated, found.elements, strict=True):
        elements = (e for t in TRANSFORMATIONS for e in t.elements(scene, certain))
        without = next((e.without for e in elements if e.name == doubtful.name), certain)
        certain = certain if issue.mends else without
    return certain


def _stopped(none: Repair, issues: Iterable[Issue]) -> Content:
    return Content(list(issues), None, none, none, None, False)


def _settled(scene: Scene, settings: Preprocessing) -> bool:
    assert settings.torque_cutoff is not None
    data = scene.judged.data
    seconds = float(np.ptp(data.motion.t))
    parameters = int(data.independent.sum()) + scene.n * data.own.shape[2]
    return bool(2.0 * settings.torque_cutoff * seconds * len(scene.joints) > _SPARE * parameters)


def _frozen(scene: Scene, glance: Glance) -> Iterator[Issue]:
    """Positions that are the same number in every row, of joints whose torque says that they move."""
    run = glance.run
    if np.mean(glance.moving) < 0.5:
        return  # joints are moved one by one, the others held
    score = scene.judged.score(scene.none)
    for j in np.flatnonzero(np.ptp(run.q, axis=0) == 0.0).tolist():
        y = scene.judged.data.torque[len(scene.judged.data.torque) // 2][:, j]
        columns = np.column_stack([score.rows.raw[j], np.ones(len(y))])
        rest = y - columns @ np.linalg.lstsq(columns, y)[0]
        left = float(np.linalg.norm(rest) / max(float(np.linalg.norm(y)), 1e-300))
        if left > _HELD:
            yield Issue(
                "frozen position", "error", f"q{j + 1}",
                f"q{j + 1} is {run.q[0, j]:g} in every row, yet {100.0 * left:.0f} % of that "
                f"joint's torque is not that of a joint at rest: the position channel is frozen.",
                "likely: the torque of a joint that is held follows from the motion of the others",
                "record again with that channel; leave the run out until then", None,
                {"joints": [j + 1], "unexplained": left},
            )  # fmt: skip


def _stated(scene: Scene, found: Found) -> list[Issue]:
    """An issue for each element of the net repair, with its interval and what it explains."""
    out = []
    parts = zip(found.elements, found.deviations, found.gains, found.without, strict=True)
    for e, deviation, gain, without in parts:
        change = np.log(without.shares / found.after.shares)
        j = int(np.argmax(change))
        sure = gain > _CERTAIN and (change[j] > np.log(_TENFOLD) or gain > 5.0 * _CERTAIN)
        word = "certain" if sure else "likely"
        text = (
            f"{word}: what the arm's dynamics leave unexplained of joint {j + 1}'s torque falls from "
            f"{100.0 * np.sqrt(without.shares[j]):.3g} % to "
            f"{100.0 * np.sqrt(found.after.shares[j]):.3g} %"
        )
        if change[j] < 0.05:  # the fit is the same: physics alone tells
            text = f"{word}: as recorded, friction would drive the motion, or inertia be negative"
        figures = {"joints": [j + 1 for j in e.joints], **e.figures, "net": True, "log_odds": gain}
        what = e.what
        if e.number is not None:
            low, high = (e.number.value + s * 2.0 * deviation for s in (-1.0, 1.0))
            figures["interval"] = [low, high]
            what = f"{what.rstrip('.')} (95 %: {e.number.text(low)} to {e.number.text(high)})."
        mend = found.repair.apply if e.mends else None
        out.append(
            Issue(e.kind, e.severity, e.where, what, text, e.remedy, mend, figures, _gravity(e, found))
        )
    return out


def _gravity(e: Element, found: Found) -> tuple[float, float, float] | None:
    if e.kind.startswith("gravity"):
        share = found.repair.weight[0] if len(set(found.repair.weight)) == 1 else 1.0
        x, y, z = (float(round(share * g, 3)) + 0.0 for g in found.repair.gravity)
        return x, y, z
    return None
