"""The unit of positions, as the check reports it: a fact where ranges or torques tell it, a
question where neither does and no name says it."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.checks.certainty import likely, possible, stated, told_by
from sdp_vs_penalty.checks.issue import EXPLANATION, FACT, Issue, make_issue
from sdp_vs_penalty.data.plausibility import far_outside
from sdp_vs_penalty.race.constants import LOG_ODDS_OF_A_CLAIM, MAX_PHYSICS_LOG_ODDS
from sdp_vs_penalty.race.evidence import Evidence, ViewFit
from sdp_vs_penalty.race.kinds.position_unit import as_likely_as_radians
from sdp_vs_penalty.results.remedy import Change

#: What confirms that positions which no joint reaches are in a unit.
_INSIDE_AS = {
    "degrees": "degrees",
    "": "degrees",
    "per cent": "per cent",
    "mm": "millimetres",
}


def units_as_facts(
    issues: Sequence[Issue],
    is_impossible: bool,
    percent: Mapping[int, tuple[float, float]] | None,
    rails: Collection[int] = (),
) -> list[Issue]:
    """Return the issues of a run in which units of positions are errors: the joints' ranges
    confirm what the torques suggest, or the torques alone tell it.

    Where the torques show a factor of gears beside a unit, impossible positions may be the
    angles of motors: their ratios are asked for instead.

    is_impossible : whether the positions are as logged; percent : radians per cent of each
    joint's range and its middle, where they may be that; then degrees are not certain,
    and both commands are named; rails : the joints (from 1) whose positions are lengths.
    """
    has_gears = is_impossible and any(f.of_positions == "factor" for f in issues)
    # Steps are those of the unit, and factors those of the gears that are asked for.
    left_out = ("steps", "factor") if has_gears else ("steps",)
    new_issues = list[Issue]()
    for issue in issues:
        if issue.position_unit is None:
            if issue.of_positions not in left_out:
                new_issues.append(issue)
        elif has_gears:
            new_issues.append(_of_motors(issue))
        else:
            is_of_rails = bool(issue.joints) and {*issue.joints} <= {*rails}
            new_issues.append(_as_fact(issue, is_impossible, percent, is_of_rails))
    return new_issues


def _of_motors(issue: Issue) -> Issue:
    """Return that positions beyond the joints' ranges may be those of motors."""
    return replace(
        issue,
        nature=FACT,
        severity="error",
        kind="position unit not said",
        position_unit=None,
        what="the positions are in degrees, or the motors' behind gears: read in"
        " degrees, they leave the torques a factor that gears have.",
        certainty=possible("inside the joints' ranges by any such factor"),
        remedy="give each joint's gear ratio, or the unit of its positions",
        repair=None,
        apply="",
        changes=(Change("read", "read q in its unit", {"scale": {"q": ""}}),),
    )


def _as_fact(
    issue: Issue,
    is_impossible: bool,
    percent: Mapping[int, tuple[float, float]] | None,
    is_of_rails: bool,
) -> Issue:
    """Return one issue about a unit as an error; see :func:`units_as_facts`."""
    if not is_impossible:
        is_sure = issue.certainty.grade != "possible"
        nature, severity = (FACT, "error") if is_sure else (EXPLANATION, "warning")
        return replace(issue, nature=nature, severity=severity)
    fact = replace(issue, nature=FACT, severity="error")
    unit = _INSIDE_AS.get(issue.position_unit or "")
    if unit is None:
        return fact
    why = f"outside what the joints can reach, and inside it as {unit}"
    if is_of_rails:
        own = "a rail's own columns explain its torque in any unit"
        return replace(fact, certainty=likely(f"{why}; {own}"))
    if percent is None and issue.equivalents:
        return replace(fact, certainty=possible(f"{why}; other units explain as much"))
    if percent is None:
        # What the ranges tell of its odds is one witness, and the torques the other.
        of_torques = (issue.log_odds or 0.0) - MAX_PHYSICS_LOG_ODDS
        is_clear = of_torques > LOG_ODDS_OF_A_CLAIM
        second = "the torques confirm it" if is_clear else ""
        return replace(fact, certainty=told_by(why, second))
    factors = ":".join(f"{scale:.6g}" for scale, _ in percent.values())
    is_percent = unit == "per cent"
    other = "degrees" if is_percent else "per cent of each joint's range"
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
            is_of_columns=True,
            changes=tuple(
                Change("read", f"read q in {x}", {"scale": {"q": x}})
                for x in ("rad", *names)
            ),
        )
    ]
