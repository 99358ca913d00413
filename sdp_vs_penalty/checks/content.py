"""What a run's channels mean: the net repair that makes them one arm's, in words, and what is left."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sdp_vs_penalty.checks import channel_rules as rules
from sdp_vs_penalty.checks import excitation, residual
from sdp_vs_penalty.checks.constants import JUDGED, LOUDEST, TRIED, UNRELATED
from sdp_vs_penalty.checks.glance import Glance
from sdp_vs_penalty.checks.issue import Issue
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.regression_data import RegressionData
from sdp_vs_penalty.checks.repair import Repair
from sdp_vs_penalty.checks.search import Search
from sdp_vs_penalty.checks.transformation import Scene
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.signals.preprocessing import Preprocessing

#: Independent samples for each parameter, below which a good fit says nothing.
_SPARE = 1.5


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


def content(problem: Problem, run: Measurements, settings: Preprocessing, thorough: bool) -> Content:
    """Raises InputError for a run that is too short for any question."""
    if len(run.t) < 10:
        raise InputError("fewer than 10 usable rows", "record longer", run.names[0])
    glance = Glance(run, problem.robot, settings.standstill)
    none = Repair.none(run.n, problem.robot.gravity)
    if still := list(rules.no_motion(glance)):
        return Content(still, None, none, none, None, False)
    settings = settings.resolve(run)
    glance = replace(glance, settings=settings)
    coarse = list(rules.sample_rate(glance))
    told = [*rules.idle(glance), *rules.quantised(glance), *coarse]
    if not run.torque_logged:  # rows, clock and positions are all there is
        return Content([*told, *rules.beside(glance)], None, none, none, None, False)
    first = [*rules.dead(glance), *rules.magnitude(glance)]
    if any(i.kind == "torque magnitude" for i in first):  # nothing else can be asked of such torques
        return Content(first, None, none, none, None, False)
    data = RegressionData.of(problem, run, settings, JUDGED)
    scene = Scene(problem, Likelihood(data.few(TRIED)), Likelihood(data), bool(coarse))
    search = Search(scene)
    net = search.run()
    score, (stated, certain) = scene.judged.score(net), _stated(search, net)
    dark = float(np.mean(score.shares[scene.moving])) > UNRELATED
    issues = [*first, *(() if dark else stated), *told]  # no cause that leaves most dark
    sizes = list(residual.size(scene, net))
    if any(i.kind == "torque channel kind" for i in sizes):
        issues = [replace(i, severity="note") if i.kind == "torque gain" else i for i in issues]
    seconds = float(np.ptp(data.motion.t))
    parameters = int(data.independent.sum()) + scene.n * data.own.shape[2]
    assert settings.torque_cutoff is not None
    settled = 2.0 * settings.torque_cutoff * seconds * len(scene.joints) > _SPARE * parameters
    issues += [*sizes, *residual.find(scene, net, score, settled)]
    bent = {i.figures["joints"][0] for i in stated if i.kind == "saturation"}
    issues += [i for i in rules.clipped(glance) if i.figures["joint"] not in bent]
    if not any(i.kind in ("encoder offset", "positions in degrees") for i in stated):
        issues += rules.beside(glance)
    if thorough:
        for issue in sizes:
            run = issue.repair(run) if issue.repair is not None else run
        run = run if net.leaves_log else net.apply(run)
        issues += excitation.find(problem.with_gravity(net.gravity), run, settings)
        issues += excitation.hidden_errors(scene, net)
    unexplained = float(score.left[scene.moving].sum() / score.whole[scene.moving].sum())
    # A report holds the rows, not what was worked out of them.
    scene = replace(scene, tried=Likelihood(scene.tried.data), judged=Likelihood(data))
    return Content(issues, scene, net, certain, unexplained, settled)


def _stated(search: Search, net: Repair) -> tuple[list[Issue], Repair]:
    """An issue for each element of the net repair, with its interval and what it explains; the repair
    without what is only likely."""
    scene, certain, out = search.scene, net, []
    after = scene.judged.score(net).shares
    for e in search.elements(net):
        before = scene.judged.score(e.without).shares
        gain, change = search.posterior(net) - search.posterior(e.without), np.log(before / after)
        j = int(np.argmax(change))
        sure = gain > LOUDEST
        word = "certain" if sure else "likely"
        text = (
            f"{word}: what the arm's dynamics leave unexplained of joint {j + 1}'s torque falls from "
            f"{100.0 * np.sqrt(before[j]):.3g} % to {100.0 * np.sqrt(after[j]):.3g} %"
        )
        if change[j] < 0.05:  # the fit is the same: physics alone tells
            text = f"{word}: as recorded, friction would drive the motion, or inertia be negative"
        figures = {"joints": [j + 1 for j in e.joints], **e.figures, "net": True, "log_odds": gain}
        what = e.what
        if e.number is not None:
            reach = 2.0 * search.deviation(e.number)
            low, high = e.number.value - reach, e.number.value + reach
            figures["interval"] = [low, high]
            what = f"{what.rstrip('.')} (95 %: {e.number.text(low)} to {e.number.text(high)})."
        mend, gravity = net.apply if e.mends else None, None
        if e.kind.startswith("gravity"):
            share = net.weight[0] if len(set(net.weight)) == 1 else 1.0
            gravity = tuple(float(round(share * g, 3)) + 0.0 for g in net.gravity)
        out.append(Issue(e.kind, e.severity, e.where, what, text, e.remedy, mend, figures, gravity))
        if not out[-1].mends:
            certain = next((x.without for x in search.elements(certain) if x.name == e.name), certain)
    return out, certain
