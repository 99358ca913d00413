"""Every corruption on every arm: is it named, and how much harm does it do where it is
not refused?

    python results/corruptions --data DATA [--arms panda,sim5,drawn7] [--every 4] [--out FOLDER]

DATA holds the measurements as `sdp-vs-penalty fetch` leaves them. Arms: panda, ur10e, tx40, ur10, emps,
sim5, drawn and any number (four to seven joints), small and any number (two or three).
Outcome of a case:
  named    an error or a warning names the cause that was put in, and the joint, or a set
           of explanations that the data do not tell apart, with the cause among them
  refused  an error without that cause: nothing is identified, but the user has to search
  warned   warnings only, none of which names the cause, and none names another
  wrong    warnings that name another cause only
  silent   nothing
The data tell a corruption where the log before it is likelier by the check's odds against a fault, each
with the arm that fits it best: what they do not tell no check of the log alone can name.
Harm is the held-out error on clean data of what is identified all the same, over that of the model from
the clean run. It is measured where nothing is said. Clean runs, and both halves of each, have to stay
silent ("poor excitation" is true of a stretch whose model is harmed), and no two issues of one output
may state the same number of the same joint. Writes corruptions.csv, corruptions.md, and
corruptions_claims.csv for reliability.py; thresholds are judged on arms that nobody looked at.
"""

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from itertools import combinations, product
from pathlib import Path

import numpy as np
import pandas
from challenge.judge import share
from reliability.reliability import (
    OF_THE_MOTION,
    Claim,
    claim,
    read_claims,
    write_claims,
)

from corruptions.arms import Arm, arm
from corruptions.kinds import Corruption
from sdp_vs_penalty import identify
from sdp_vs_penalty.checks import Report, check
from sdp_vs_penalty.checks.check import judge_facts
from sdp_vs_penalty.checks.dynamics import LoggerJudge
from sdp_vs_penalty.checks.issue import Issue
from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.race import Race
from sdp_vs_penalty.race.constants import LOG_ODDS_AGAINST_FAULT
from sdp_vs_penalty.race.evidence import Evidence
from sdp_vs_penalty.race.records import LogView
from sdp_vs_penalty.results.table import markdown_lines

#: A model this many times worse on clean data is harmed.
HARMFUL = 1.3
#: Issues that say that something is wrong, and not what.
_GENERAL = {
    "torque not explained",
    "unexplained torque",
    "position range",
    "poor excitation",
    "quantisation",
    "low sample rate",
}
#: Which numbers of a joint, or of the log, an issue states.
_NUMBERS = {
    "torque's size": {
        "torque gain",
        "torque unit",
        "torque channel kind",
        "dead channel",
    },
    "torque's sign": {"torque sign", "joint sign", "torque magnitude"},
    "position's sign": {"position sign", "joint sign"},
    "position's zero": {"encoder offset"},
    "position's unit": {"positions in degrees", "position unit", "position range"},
    "gravity": {"gravity direction", "gravity of the problem", "gravity removed"},
    "time's rate": {"clock rate", "time unit"},
    "torque's delay": {"delay", "channel delay", "torque filter", "channel filter"},
    "torque's change": {"torque drift", "dead channel"},
    "order": {"torque order", "position order", "joint order"},
}
_WORDS = ("named", "refused", "warned", "wrong", "silent")


@dataclass(frozen=True)
class Case:
    """One log: what was done to which arm, and what came of it.

    harm : held-out error over the clean model's, NaN where it is not measured. told :
    by how much (natural logarithm of odds) the log before the corruption is likelier
    than the corrupted one, of those whose cause is not named; NaN of the others.
    """

    arm: str
    kind: str
    joints: str
    size: str
    outcome: str
    harm: float
    said: str
    contradicts: bool
    told: float = np.nan
    claims: tuple[Claim, ...] = ()


def given(arm: Arm, corruption: Corruption) -> tuple[Problem, Measurements]:
    """What is checked: an arm's log that was corrupted, and the problem that is
    believed."""
    run = corruption.spoil(arm.train)
    problem = corruption.problem(arm.problem)
    if corruption.beside:  # half of the run is clean: another run of the same arm
        middle = 0.5 * (run.t[0] + run.t[-1])
        run = concatenate(
            [arm.train.rows(run.t < middle, "a"), run.rows(run.t > middle, "b")]
        )
    return problem, run


def run_case(arm: Arm, corruption: Corruption) -> Case:
    problem, run = given(arm, corruption)
    reports = check(problem, run)
    issues = [f for report in reports for f in report.errors_and_warnings]
    outcome = _outcome(corruption, issues)
    harm = np.nan
    if outcome == "silent":
        try:
            harm = arm.harm(identify(problem, run))
        except InputError:
            outcome = "refused"
    told = np.nan
    if outcome != "named":
        told = _log_odds_of_truth(arm, corruption)
    joints = "+".join(str(j + 1) for j in corruption.joints)
    what = (arm.problem.name, corruption.kind, joints, corruption.size)
    right = [_is_right(corruption, issue) for issue in issues]
    return replace(_case(what, outcome, harm, reports, right), told=told)


def _log_odds_of_truth(arm: Arm, corruption: Corruption) -> float:
    """By how much (natural logarithm) the log as it was before the corruption is
    likelier than the corrupted one, each with the arm that fits it best.

    Where this is less than the odds against a fault, no fit to the log alone tells what
    was done to it. Infinite where another set of joints moves, or no arm can be fitted.
    """
    spoiled = _evidence(*given(arm, corruption))
    nothing = replace(
        corruption, spoil=lambda run: run, problem=lambda problem: problem
    )
    clean = _evidence(*given(arm, nothing))
    if spoiled is None or clean is None:
        return np.inf
    if np.any(spoiled.log.moving != clean.log.moving):
        return np.inf
    fits = [x.fit(LogView(x.log.as_logged), 1.0) for x in (spoiled, clean)]
    v = min(
        x.estimate_rows_worth_one(fit)
        for x, fit in zip((spoiled, clean), fits, strict=True)
    )
    values = [
        x.fitted([fit], v)[0].log_evidence
        for x, fit in zip((spoiled, clean), fits, strict=True)
    ]
    return values[1] - values[0]


def _evidence(problem: Problem, run: Measurements) -> Evidence | None:
    """The evidence of all runs of a log; None where no arm can be fitted."""
    reports = [judge_facts(problem, part) for part in run.runs()]
    judge = LoggerJudge(problem, reports)
    return Race([*judge.logs.values()]).all_rows if judge.logs else None


def _case(
    what: tuple[str, str, str, str],
    outcome: str,
    harm: float,
    reports: Sequence[Report],
    right: Sequence[bool],
) -> Case:
    """what : arm, kind, joints and size of a corruption; right : whether each error or
    warning is."""
    issues = [f for report in reports for f in report.errors_and_warnings]
    arm, kind, joints, size = what
    source = "clean runs" if kind == "(clean)" else "corruptions"
    name = f"{arm}: {kind} {joints} {size}"
    claims = tuple(
        claim(source, name, issue, is_right)
        for issue, is_right in zip(issues, right, strict=True)
        if issue.kind not in OF_THE_MOTION
    )
    return Case(
        arm=arm,
        kind=kind,
        joints=joints,
        size=size,
        outcome=outcome,
        harm=harm,
        said="; ".join(f"{f.kind} ({f.where})" for f in issues),
        contradicts=any(map(contradicts, reports)),
        claims=claims,
    )


def contradicts(report: Report) -> bool:
    """Whether two issues are about the same number of the same joint."""
    every = product(_NUMBERS.items(), report.errors_and_warnings)
    asked = [
        (number, _joints(f) or {0}) for (number, kinds), f in every if f.kind in kinds
    ]
    return any(
        a == b and (j & k or {0} in (j, k)) for (a, j), (b, k) in combinations(asked, 2)
    )


def _names(corruption: Corruption, issue: Issue) -> bool:
    """Whether an issue names what was done, and to which joint."""
    joints = {j + 1 for j in corruption.joints}
    named = [(issue.kind, _joints(issue))]
    for other in issue.figures.get("as_likely", ()):
        named.append((other["kind"], set(other["joints"])))
    return any(
        kind in corruption.causes and (not joints or of_issue == joints)
        for kind, of_issue in named
    )


def _is_right(corruption: Corruption, issue: Issue) -> bool:
    """Whether an issue is true of a corrupted log: it names the cause, or no cause."""
    return _names(corruption, issue) or issue.kind in _GENERAL


def _outcome(corruption: Corruption, issues: Sequence[Issue]) -> str:
    if any(_names(corruption, issue) for issue in issues):
        return "named"
    if not issues:
        return "silent"
    if not all(issue.kind in _GENERAL for issue in issues):
        return "wrong"
    is_error = any(issue.severity == "error" for issue in issues)
    return "refused" if is_error else "warned"


def _joints(issue: Issue) -> set[int]:
    """Joints (from 1) that an issue is about; empty: all."""
    return set(issue.figures.get("joints", ()))


def clean(arm: Arm) -> list[Case]:
    """Its clean runs, whole and in halves."""
    cases = []
    for run in (arm.train, *arm.others):
        span = run.t[-1] - run.t[0]
        for a, b in ((0.0, span), (0.0, 0.5 * span), (0.5 * span, span)):
            cases.append(_clean_part(arm, run.window(a, b), f"{a:.3g}-{b:.3g} s"))
    return cases


def _clean_part(arm: Arm, part: Measurements, span: str) -> Case:
    """A part of a clean run: every claim about it is wrong."""
    reports = check(arm.problem, part)
    issues = reports[0].errors_and_warnings
    harm = np.nan
    outcome = "false warning" if issues else "silent"
    if reports[0].meaningless:
        outcome = "false error"
    if {f.kind for f in issues} == {"poor excitation"}:
        harm = arm.harm(identify(arm.problem, part))
        outcome = "true warning" if harm > HARMFUL else outcome
    what = (arm.problem.name, "(clean)", part.names[0], span)
    return _case(what, outcome, harm, reports, [False] * len(issues))


def bench(name: str, data: Path, kinds: str, every: int, part: int) -> list[Case]:
    """Of one arm: another sample of corruptions for each, the same in every run."""
    one = arm(name, data)
    chosen = [c for c in one.corruptions() if kinds in c.name]
    return clean(one) + [
        run_case(one, c) for c in chosen[(sum(name.encode()) + part) % every :: every]
    ]


def summary(title: str, cases: Sequence[Case]) -> list[str]:
    """One row of the Markdown table: shares of what was spoiled; clean logs apart."""
    spoiled = [c for c in cases if c.kind != "(clean)"]
    count = {word: sum(c.outcome == word for c in spoiled) for word in _WORDS}
    bad = [c for c in spoiled if c.outcome == "silent" and c.harm > HARMFUL]
    seen = [c for c in spoiled if c.outcome != "silent" or c.harm > 1.1]
    alarms = [c.outcome for c in cases if c.outcome.startswith("false")]
    named = [c for c in spoiled if c.outcome == "named"]
    shown = [c for c in spoiled if c.told > LOG_ODDS_AGAINST_FAULT]
    shares = (
        (len(bad), len(spoiled)),
        (sum(c.told > LOG_ODDS_AGAINST_FAULT for c in bad), len(spoiled)),
        (len(named), len(spoiled)),
        (len(named), len(seen)),
        (len(named), len(named) + len(shown)),
    )
    cells = [title, str(len(spoiled)), *(str(count[w]) for w in _WORDS)]
    alarm = (
        f"{len(alarms)} ({alarms.count('false error')} errors) of"
        f" {len(cases) - len(spoiled)}"
    )
    told = ["{1} ({2})".format(*share(*x)) if x[1] else "" for x in shares]
    return [*cells, *told, alarm, str(sum(c.contradicts for c in cases))]


def markdown(cases: Sequence[Case], command: str) -> str:
    groups = {
        name: [c for c in cases if c.arm == name]
        for name in dict.fromkeys(c.arm for c in cases)
    }
    head = ["log", "cases", *_WORDS, "silent and harmful"]
    head += [
        "of these the data tell",
        "cause named",
        "cause named, of those that do harm or are mentioned",
        "cause named, of those that the data tell",
        "false alarms",
        "contradictions",
    ]
    kinds = {
        kind: [c for c in cases if c.kind == kind]
        for kind in dict.fromkeys(c.kind for c in cases)
    }
    silent = [c for c in cases if c.outcome == "silent" and c.harm > HARMFUL]
    text = ["# Corrupted logs: what the data check says", ""]
    text += [
        f"Made by `{command}`. Harm: error on clean held-out data over that of the"
        " model from the"
    ]
    text += [
        "clean run. The data tell a corruption where the log before it is likelier, by"
        f" log-odds of {LOG_ODDS_AGAINST_FAULT:g}, each with its best arm.",
        "In brackets Wilson's 95 % interval.",
        "",
    ]
    text += markdown_lines(
        head, [summary(*g) for g in (*groups.items(), ("all", cases))]
    )
    text += ["", "## By kind", ""]
    counts = [[k, *summary(k, v)[1 : 2 + len(_WORDS)]] for k, v in kinds.items()]
    text += markdown_lines(["kind", "cases", *_WORDS], counts)
    text += ["", f"## Silent, and more than {HARMFUL:g} times worse on clean data", ""]
    told = [
        f"- {c.arm}: {c.kind} {c.joints} {c.size}: {c.harm:.3g} times; the data tell it"
        f" with log-odds of {c.told:.3g}"
        for c in silent
    ]
    return "\n".join([*text, *(told or ["none"]), ""])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=Path("."))
    parser.add_argument("--out", type=Path, default=Path("results", "corruptions"))
    parser.add_argument("--arms", default="panda,ur10e,tx40,ur10,emps,sim5")
    parser.add_argument("--kinds", default="", help="those with this in their name")
    parser.add_argument(
        "--every", type=int, default=1, help="one corruption in so many"
    )
    parser.add_argument(
        "--part", type=int, default=0, help="which of these samples, from 0"
    )
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    command = (
        f"python results/corruptions --data DATA --arms {given.arms} --every"
        f" {given.every}"
    )
    work = partial(
        bench, data=given.data, kinds=given.kinds, every=given.every, part=given.part
    )
    cases = read_cases(given.out)
    known = {case.arm for case in cases}
    todo = [name for name in given.arms.split(",") if name not in known]
    with ProcessPoolExecutor(given.workers) as pool:
        for found in pool.map(work, todo):  # kept after each arm
            cases += found
            write_all(given.out, cases, f"{command} --part {given.part}")
            print(" | ".join(summary(found[0].arm, found)), flush=True)


def read_cases(folder: Path) -> list[Case]:
    """The cases of a bench that has been begun."""
    path = folder / "corruptions.csv"
    if not path.exists():
        return []
    table = pandas.read_csv(path, keep_default_na=False)
    for name in ("harm", "told"):
        table[name] = pandas.to_numeric(table[name], errors="coerce")
    names = [field.name for field in fields(Case) if field.name != "claims"]
    cases = [Case(*values) for values in table[names].itertuples(index=False)]
    claims = read_claims(folder / "corruptions_claims.csv")
    return [replace(cases[0], claims=tuple(claims)), *cases[1:]] if cases else []


def write_all(folder: Path, cases: Sequence[Case], command: str) -> None:
    """The table of cases, its summary, and the claims."""
    rows = [{**asdict(replace(case, claims=()))} for case in cases]
    table = pandas.DataFrame(rows).drop(columns="claims")
    text = table.to_csv(index=False, lineterminator="\n", float_format="%.3g")
    write_text(folder / "corruptions.csv", text)
    write_text(folder / "corruptions.md", markdown(cases, command))
    claims = [claim for case in cases for claim in case.claims]
    write_claims(claims, folder / "corruptions_claims.csv")
