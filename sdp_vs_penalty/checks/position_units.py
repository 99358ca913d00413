"""The unit of positions, as the check reports it: a fact where ranges or torques tell it, a
question where neither does and no name says it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sdp_vs_penalty.checks.certainty import likely, possible, stated, told_by
from sdp_vs_penalty.checks.facts.channels import IN_RANGE_AS_DEGREES
from sdp_vs_penalty.checks.issue import EXPLANATION, FACT, Issue, make_issue
from sdp_vs_penalty.data.plausibility import far_outside
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.kinds.position_unit import as_likely_as_radians
from sdp_vs_penalty.results.remedy import Change


def degrees_or_motors(issues: Sequence[Issue]) -> list[Issue]:
    """Return the issues of a run whose torques were judged, in which degrees that the
    ranges tell are certain; where the torques show a factor beside them, they may be the
    angles of motors behind gears, and their ratios are asked for instead."""
    of_gears = "position scale", "gear ratio"
    ranges = "outside the joints' ranges, inside them as degrees"
    sure = told_by(ranges, "the torques confirm it")
    settled: dict[str, Any] = {"certainty": sure, "apply": ""}
    kept = [*issues]
    if any(f.kind in of_gears for f in issues):
        settled = {
            "kind": "position unit not said",
            "what": "the positions are in degrees, or the motors' behind gears: read in"
            " degrees, they leave the torques a factor that gears have.",
            "certainty": possible("inside the joints' ranges by any such factor"),
            "remedy": "give each joint's gear ratio, or the unit of its positions",
            "repair": None,
            "apply": "",
            "changes": (Change("read", "read q in its unit", {"scale": {"q": ""}}),),
        }
        kept = [f for f in issues if f.kind not in of_gears]
    is_open = [f.certainty is IN_RANGE_AS_DEGREES for f in kept]
    if not any(is_open):
        return [*issues]
    return [
        replace(f, **settled) if x else f for f, x in zip(kept, is_open, strict=True)
    ]


def unit_as_fact(
    issue: Issue, is_impossible: bool, percent: Mapping[int, tuple[float, float]] | None
) -> Issue:
    """Return the issue in which unit positions are as an error: the joints' ranges
    confirm what the torques suggest, or the torques alone tell it.

    is_impossible : whether the positions are as logged; percent : radians per cent of each
    joint's range and its middle, where they may be that; then degrees are not certain,
    and both commands are named.
    """
    if not is_impossible:
        is_sure = issue.certainty.grade != "possible"
        nature, severity = (FACT, "error") if is_sure else (EXPLANATION, "warning")
        return replace(issue, nature=nature, severity=severity)
    fact = replace(issue, nature=FACT, severity="error")
    is_percent = issue.kind == "positions in per cent"
    if not is_percent and issue.kind not in ("positions in degrees", "position unit"):
        return fact
    unit, other = "degrees", "per cent of each joint's range"
    if is_percent:
        unit, other = "per cent", "degrees"
    why = f"outside what the joints can reach, and inside it as {unit}"
    if percent is None:
        return replace(fact, certainty=told_by(why, "the torques confirm it"))
    factors = ":".join(f"{scale:.6g}" for scale, _ in percent.values())
    reading = {"scale": {"q": "deg" if is_percent else factors}}
    told = likely(f"{why}; as {other} the torques are explained worse")
    if issue.equivalents:
        told = possible(f"{why}; as {other} the torques are explained as well")
    change = Change("read", f"read q in {other}", reading)
    return replace(fact, certainty=told, changes=(*issue.changes, change))


def unit_asked_for(evidence: Evidence, fit: ViewFit) -> list[Issue]:
    """Return an error that asks for the unit of positions where an arm explains the torques
    as well in another one as in radians; none where it tells them.
    """
    log = evidence.log
    units = as_likely_as_radians(evidence, fit)
    if not units or far_outside(log.problem.robot, log.data.motion.q):
        return []  # positions that no joint reaches are refused with a unit of their own
    largest = float(np.abs(evidence.log.data.motion.q).max())
    others = " or ".join(unit.words for unit in units)
    names = [unit.name for unit in units if unit.name]
    return [
        make_issue(
            kind="position unit not said",
            severity="error",
            what=f"nothing says in which unit q is, which reaches {largest:.3g}: radians,"
            f" or {others}; the arm explains the torques as well either way.",
            certainty=stated("no name says it, and the torques do not tell it"),
            remedy="say it as the printed command does",
            where="columns q",
            changes=[
                Change("read", f"read q in {x}", {"scale": {"q": x}})
                for x in ("rad", *names)
            ],
        )
    ]
