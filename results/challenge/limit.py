"""Does the true model score better than what was named? Of each single effect that was
not named first.

The evidence J is that of the search: twice the logarithm of the odds. The true effect
takes the place of one finding, or joins them, whichever serves it best. Its advantage
is its J beside the other findings, less that of the finding whose place it takes (or
less what an addition needs). Within 6 (odds of 20 to 1) these rows do not tell the two
apart, and no method that reads them can.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from challenge.cases import BuiltCase, Case, build_case, identify_case, kept_records
from challenge.judge import SINGLE, Record, counted, first_right, in_set
from sdp_vs_penalty.data.measurements import concatenate
from sdp_vs_penalty.diagnosis.constants import (
    EVIDENCE_TO_ADD,
    EVIDENCE_TO_DISTINGUISH,
    LAW_TOLERANCE,
)
from sdp_vs_penalty.diagnosis.diagnose import DiagnosisRuns
from sdp_vs_penalty.diagnosis.late_torque import refer_columns_to_current_model
from sdp_vs_penalty.diagnosis.library import Candidate
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect
from sdp_vs_penalty.diagnosis.search import Search, search
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.parallel import spread
from sdp_vs_penalty.results.table import markdown_lines

#: What a missed effect can be, by whether these rows show more than was said.
NO_BETTER = "the true model scores no better"
SIMPLER = "better by less than laws are trusted to: the simpler law is named"
FOUND = "found by the search; given up on data left out, or named later"
BETTER = "the true model scores better"
OUTCOMES = (NO_BETTER, SIMPLER, FOUND, BETTER)
#: The laws of the true effect whose constants are refined, the best of the grid first.
_REFINED = 3


@dataclass(frozen=True)
class Limit:
    """A missed effect. hidden, named : with their joints; advantage : of the true model
    in J, None where the search found it; in_set : whether it is among what the first
    finding is not told apart from; outcome : of OUTCOMES."""

    key: str
    hidden: str
    named: str
    advantage: float | None
    in_set: bool
    outcome: str


def missed(records: Mapping[str, Record]) -> list[Case]:
    """List the cases whose single effect these data show and was not named first."""
    cases = []
    for key, record in records.items():
        kind, nuisance, seed, index = key.split("/")
        is_single = kind in SINGLE and len(record["truth"]) == 1
        if is_single and counted(record) and not first_right(record):
            cases.append(Case(kind, nuisance, int(seed), int(index)))
    return cases


def finished_search(case: Case, built: BuiltCase) -> Search:
    """Search the runs of a case for missing effects, as a diagnosis does."""
    *runs, test = built.logged
    data = concatenate([x.run for x in runs])
    found = DiagnosisRuns(identify_case(case, built), data, test.run)
    done = search(found.white_data, found.candidates)
    return refer_columns_to_current_model(done)


def true_forms(found: Search, effect: str, joints: Sequence[int]) -> list[Candidate]:
    """List the candidates of an effect on its joints (from 1; none: the robot)."""
    return [
        form
        for batch in found.library.batches
        for form in batch.forms
        if form.effect.name == effect and _is_on(form, joints)
    ]


def _is_on(form: Candidate, joints: Sequence[int]) -> bool:
    if form.effect.whole_robot or not joints:
        return True
    return form.effect.joints[0] + 1 in joints


def advantage(found: Search, forms: Sequence[Candidate]) -> tuple[float, float]:
    """Return by how much evidence J the true effect beats what it replaces best, or
    what an addition needs; and how much of that a simpler law is allowed to lack."""
    every = list(found.terms)
    gains = [
        (true.evidence - EVIDENCE_TO_ADD, 0.0) for true in _beside(found, every, forms)
    ]
    for term in every:
        others = [t for t in every if t is not term]
        replaced = found.beside(term, others)
        tolerated = EVIDENCE_TO_ADD + LAW_TOLERANCE * replaced.evidence
        for true in _beside(found, others, forms):
            gain = true.evidence_with_worth_of(replaced) - replaced.evidence
            gains.append((gain, tolerated))
    return max(gains)


def _beside(
    found: Search, others: Sequence[ScoredEffect], forms: Sequence[Candidate]
) -> list[ScoredEffect]:
    """Score the laws of the true effect beside other findings and the small errors of
    their laws, with constants refined."""
    fit = found.score.fit(found.nuisances.with_law_misfits(others))
    scored = [found.evidence_of(fit, form) for form in forms]
    scored.sort(key=lambda term: -term.drop)
    return [found.refined(fit, term) for term in scored[:_REFINED]]


def limit_of(missed_case: tuple[Case, Record]) -> Limit:
    """Judge one missed effect, by its case and what the challenge recorded of it."""
    case, record = missed_case
    truth = record["truth"][0]
    effect, joints = truth["effect"], truth["joints"]
    found = finished_search(case, build_case(case))
    forms = true_forms(found, effect, joints)
    true_keys = {form.key for form in forms}
    named = ", ".join(t.text for t in found.terms if t.key not in true_keys)
    by = None
    if any(t.key in true_keys for t in found.terms):
        outcome = FOUND
    else:
        by, tolerated = advantage(found, forms)
        outcome = BETTER
        if by <= EVIDENCE_TO_DISTINGUISH:
            outcome = NO_BETTER
        elif by <= tolerated:
            outcome = SIMPLER
    return Limit(
        key=case.key,
        hidden=":".join([effect, *map(str, joints[:1])]),
        named=named or "nothing",
        advantage=by,
        in_set=in_set(record),
        outcome=outcome,
    )


def run_limits(out: Path, jobs: int) -> list[Path]:
    """Judge what the cases in challenge.json missed; write limits.md beside it."""
    records = kept_records(out / "challenge.json")
    todo = [(case, records[case.key]) for case in missed(records)]
    limits: list[Limit] = []
    for done, (_, limit) in enumerate(spread(limit_of, todo, jobs=jobs), start=1):
        limits.append(limit)
        print(f"case {done} of {len(todo)}", end="\r")
    report = out / "limits.md"
    write_text(report, limits_text(sorted(limits, key=lambda x: x.key)))
    return [report]


def limits_text(limits: Sequence[Limit]) -> str:
    """The report: how many of each outcome, by class, and every case."""
    classes = [name for name in SINGLE if any(x.key.startswith(name) for x in limits)]
    counts = Counter((x.outcome, x.key.split("/")[0]) for x in limits)
    summary = [
        [outcome, *(str(counts[outcome, name]) for name in classes)]
        for outcome in OUTCOMES
    ]
    rows = [
        [
            x.key,
            x.hidden,
            x.named,
            "" if x.advantage is None else f"{x.advantage:.0f}",
            "yes" if x.in_set else "no",
            x.outcome,
        ]
        for x in limits
    ]
    heading = ["case", "hidden", "found besides", "advantage", "in the set", "outcome"]
    lines = [
        "# Effects that were not named first: does the true model score better?",
        "",
        "`results/challenge --limits`. Evidence J as in the search; within"
        f" {EVIDENCE_TO_DISTINGUISH:g} these rows do not tell two models apart.",
        "",
        *markdown_lines(["outcome", *classes], summary),
        "",
        *markdown_lines(heading, rows),
        "",
    ]
    return "\n".join(lines)
