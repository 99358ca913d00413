"""What does each rule of the search buy? The same cases with and without it, paired.

McNemar's exact test asks whether the cases that a rule mends outnumber those that it
spoils: of b + c cases that differ, b or fewer on one side by a fair coin.
"""

import json
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from challenge.cases import (
    CLASSES,
    Case,
    all_hidden_energies,
    build_case,
    identify_case,
    rounded,
    truth_of,
)
from challenge.judge import (
    Record,
    all_named,
    claims,
    counted,
    extras,
    first_right,
    found_in_time,
    is_true,
    outcome,
    sizes,
)
from sdp_vs_penalty.data.measurements import concatenate
from sdp_vs_penalty.diagnosis.diagnose import DiagnosisRuns, diagnose_runs
from sdp_vs_penalty.diagnosis.doubts import REASONS
from sdp_vs_penalty.diagnosis.rules import ALL_RULES, Rules
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.files import folder_lock, write_text
from sdp_vs_penalty.parallel import spread
from sdp_vs_penalty.results.table import markdown_lines

#: With all rules.
WITH_ALL = "none"

#: By rule, or WITH_ALL, what the diagnosis says of a case.
Arms = dict[str, Record]


class WatchedRules(Rules):
    """All rules; they remember which of them a search has asked.

    A rule that no decision has asked changes nothing when it is left out.
    """

    def __init__(self) -> None:
        super().__init__()
        object.__setattr__(self, "asked", set[str]())

    def __getattribute__(self, name: str) -> Any:
        value = super().__getattribute__(name)
        if isinstance(value, bool):
            self.asked.add(name)
        return value


def run_without(store: Path, rules: Sequence[str], known: Arms, case: Case) -> None:
    """Diagnose a case with all rules and without each, and append a line to the store
    for each as soon as it is done.

    ``known`` has the records of earlier runs, which are not made again.
    """
    todo = [rule for rule in (WITH_ALL, *rules) if rule not in known]
    kind = CLASSES[case.kind]
    built = build_case(case)
    *learnt, test = built.logged
    runs = concatenate([x.run for x in learnt])
    base = truth_of(case, built)
    try:
        estimate = identify_case(case, built)
    except InputError as error:
        for rule in todo:
            refused = base | {"verdict": "refused", "error": str(error)}
            append_record(store, case, rule, refused)
        return
    base |= {"energy": all_hidden_energies(kind, estimate, built)}
    if not counted(base):
        for rule in todo:
            append_record(store, case, rule, base | {"verdict": "not shown"})
        return
    prepared = DiagnosisRuns(estimate, runs, test.run, frozen=kind.frozen)
    prepared.candidates  # noqa: B018 (all rules share them, none pays for them)
    with_all = known.get(WITH_ALL, {})
    for rule in todo:
        if rule == WITH_ALL:
            watched = WatchedRules()
            with_all = base | diagnosed(prepared, watched)
            with_all["asked"] = sorted(watched.asked)
            record = with_all
        elif rule not in with_all["asked"]:
            record = with_all
        else:
            without = replace(ALL_RULES, **{rule: False})
            record = base | diagnosed(prepared, without)
        append_record(store, case, rule, record)


def run_missing(store: Path, rules: Sequence[str], item: tuple[Case, Arms]) -> None:
    """Run a case as :func:`run_without`; the item has its records of earlier runs."""
    case, known = item
    run_without(store, rules, known, case)


def diagnosed(prepared: DiagnosisRuns, rules: Rules) -> Record:
    """What the diagnosis says under some rules, and its seconds of the processor."""
    begin = time.process_time()
    result = diagnose_runs(prepared, rules=rules).to_dict()
    return {
        "verdict": result["verdict"],
        "found": result["effects"],
        "retuned": result["retuned"],
        "events": result["events"],
        "held_out": result["held_out_rmse"],
        "seconds": time.process_time() - begin,
    }


def append_record(store: Path, case: Case, rule: str, record: Record) -> None:
    """Add a line of JSON to the store: case, rule and record."""
    line = {"case": case.key, "rule": rule, "record": rounded(record)}
    # Unbuffered: one write, so that lines of several processes do not mix.
    with store.open("ab", buffering=0) as stream:
        stream.write(json.dumps(line).encode() + b"\n")


def read_store(store: Path) -> dict[str, Arms]:
    """The records of a store, by case and rule; none where there is no such file."""
    known: dict[str, Arms] = {}
    if store.is_file():
        for line in store.read_text().splitlines():
            one = json.loads(line)
            known.setdefault(one["case"], {})[one["rule"]] = one["record"]
    return known


def run_ablation(
    todo: Sequence[Case], rules: Sequence[str], out: Path, jobs: int
) -> list[Path]:
    """Run what is missing; write rules.jsonl with all records, and from all of it
    rules.md and rules.csv."""
    store = out / "rules.jsonl"
    report = out / "rules.md"
    answers = out / "rules.csv"
    with folder_lock(out):
        known = read_store(store)
        items = [(case, known.get(case.key, {})) for case in todo]
        missing = [x for x in items if not {WITH_ALL, *rules} <= set(x[1])]
        for _ in spread(partial(run_missing, store, tuple(rules)), missing, jobs=jobs):
            pass  # the store has it
        known = read_store(store)
        write_text(report, ablation_text(known))
        write_text(answers, ablation_csv(known))
    return [store, report, answers]


def is_right(record: Record) -> bool:
    """What is to be said of the case is said: nothing false of a clean robot, what is
    hidden first, or all of it."""
    kind = CLASSES[record["class"]]
    if kind.what == "none":
        return outcome(record) != "false"
    if kind.what == "effects" and kind.count > 1:
        return all_named(record)
    if kind.what in ("effects", "payload"):
        return first_right(record)
    if kind.what == "disturbance":
        return found_in_time(record)
    return bool(record["verdict"] == "unknown_effect")


#: What a rule may buy, and how it shows in a record.
ASKED: Mapping[str, Callable[[Record], bool]] = {
    "right": is_right,
    "nothing false": lambda r: not extras(r),
    "nothing confident and false": lambda r: not extras(r, sure=True),
    "intervals hold": lambda r: all(s[2] <= 1.96 for s in sizes(r)),
}


def paired(known: Mapping[str, Arms], rule: str) -> list[tuple[Record, Record]]:
    """Records with all rules and without one, of the cases that count and that were
    not refused."""
    pairs = [(a[WITH_ALL], a[rule]) for a in known.values() if rule in a]
    return [(a, b) for a, b in pairs if counted(a) and a["verdict"] != "refused"]


@dataclass(frozen=True)
class Discordance:
    """How many of ``n_cases`` a rule mends and spoils."""

    n_mended: int
    n_spoilt: int
    n_cases: int

    @property
    def chance(self) -> float:
        """Of a split at least as uneven where the rule does nothing (McNemar, exact)."""
        from scipy.stats import binomtest  # takes half a second to import

        n_different = self.n_mended + self.n_spoilt
        if not n_different:
            return 1.0
        return float(binomtest(self.n_mended, n_different).pvalue)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the share of cases mended less that spoilt (Agresti, Min,
        Statistics in Medicine 2005): half a case is added to each of the four counts."""
        n = self.n_cases + 2.0
        mended = (self.n_mended + 0.5) / n
        spoilt = (self.n_spoilt + 0.5) / n
        net = mended - spoilt
        half = NORMAL_95 * np.sqrt((mended + spoilt - net**2) / n)
        return float(max(net - half, -1.0)), float(min(net + half, 1.0))

    @property
    def text(self) -> str:
        """For a cell."""
        low, high = (100.0 * x for x in self.interval)
        return (
            f"+{self.n_mended} -{self.n_spoilt} (p = {self.chance:.2g},"
            f" {low:.1f} to {high:.1f} %)"
        )


def discordance(
    pairs: Sequence[tuple[Record, Record]], is_met: Callable[[Record], bool]
) -> Discordance:
    """Of records with and without a rule: where what is asked is met by one alone."""
    met = [(is_met(a), is_met(b)) for a, b in pairs]
    return Discordance(
        n_mended=sum(a and not b for a, b in met),
        n_spoilt=sum(b and not a for a, b in met),
        n_cases=len(met),
    )


def judgement(by_question: Mapping[str, Discordance], n_changed: int) -> str:
    """What these cases say of a rule: a sign of worth or harm, no effect, or nothing."""
    n_cases = next(iter(by_question.values())).n_cases
    if not n_changed:
        # Exact upper limit of a share of which none was seen.
        limit = 100.0 * (1.0 - 0.05 ** (1.0 / max(n_cases, 1)))
        return f"changes no case: under {limit:.1f} % of cases (95 %)"
    certain = [d for d in by_question.values() if d.chance < 0.05]
    if any(d.n_mended > d.n_spoilt for d in certain):
        return "earns its place"
    if certain:
        return "does harm"
    mends = sum(d.n_mended for d in by_question.values())
    spoils = sum(d.n_spoilt for d in by_question.values())
    return f"not judged at this n ({mends} answers mended, {spoils} spoilt)"


def ablation_text(known: Mapping[str, Arms]) -> str:
    """The committed report."""
    rules = dict.fromkeys(rule for arms in known.values() for rule in arms)
    rows = []
    for rule in (r for r in rules if r != WITH_ALL):
        pairs = paired(known, rule)
        if not pairs:
            continue
        by_question = {q: discordance(pairs, is_met) for q, is_met in ASKED.items()}
        n_changed = sum(_names(a) != _names(b) for a, b in pairs)
        spent = [sum(r["seconds"] for r in arm) for arm in zip(*pairs, strict=True)]
        row = [
            rule,
            str(len(pairs)),
            *(d.text for d in by_question.values()),
            str(n_changed),
            f"{100.0 * _mean_rise(pairs):+.2f} %",
            f"{100.0 * (1.0 - spent[1] / spent[0]):.0f} %",
            by_class_text(pairs),
            judgement(by_question, n_changed),
        ]
        rows.append(row)
    heads = [
        "rule",
        "cases",
        *ASKED,
        "other findings",
        "error without",
        "CPU saved",
        "answers by class",
        "judgement",
    ]
    n_by_class = Counter(
        a[WITH_ALL]["class"] for a in known.values() if counted(a[WITH_ALL])
    )
    classes = ", ".join(f"{name} {n}" for name, n in sorted(n_by_class.items()))
    return "\n".join(
        [
            "# What each rule of the search buys",
            "",
            (
                "`results/challenge --without RULE`: the same cases with all rules and"
                " without one. + cases that the rule mends, - cases that it spoils; in"
                " brackets the chance of a split at least as uneven (McNemar, exact) and"
                " the 95 % interval of the share of cases that it mends less that it"
                " spoils (Agresti, Min 2005). Other findings: cases in which anything"
                " else is named, or with another confidence. Error without: mean change"
                " of the sum of the joints' log errors on the test run, above zero where"
                " the rule helps. CPU saved: share of the seconds that is saved without it,"
                " columns of candidates not counted. Answers by class: mended and spoilt,"
                " of all four questions, in classes with either. A rule that no decision of a case"
                " has asked is not run again: it changes nothing there."
                f" Cases that count, by class: {classes}."
            ),
            "",
            *markdown_lines(heads, rows),
            "",
            *doubt_lines([arms[WITH_ALL] for arms in known.values()]),
            "",
        ]
    )


def by_class_text(pairs: Sequence[tuple[Record, Record]]) -> str:
    """Answers that a rule mends and spoils, by class, for a cell."""
    n_mended = Counter[str]()
    n_spoilt = Counter[str]()
    for with_rule, without in pairs:
        for is_met in ASKED.values():
            before, after = is_met(with_rule), is_met(without)
            n_mended[with_rule["class"]] += before and not after
            n_spoilt[with_rule["class"]] += after and not before
    n_cases = Counter(with_rule["class"] for with_rule, _ in pairs)
    return ", ".join(
        f"{name} +{n_mended[name]} -{n_spoilt[name]} of {n}"
        for name, n in sorted(n_cases.items())
        if n_mended[name] or n_spoilt[name]
    )


def doubt_lines(records: Sequence[Record]) -> list[str]:
    """What each reason for doubt costs and buys: how many findings that are hidden, and
    how many that are not, it makes weak, by itself or with others."""
    judged = [
        (finding, is_true(finding, record))
        for record in records
        if counted(record)
        for finding in claims(record)
    ]
    doubted = Counter[tuple[str, bool]]()
    doubted_alone = Counter[tuple[str, bool]]()
    for finding, is_hidden in judged:
        reasons = [doubt["reason"] for doubt in finding.get("doubts", [])]
        doubted.update((reason, is_hidden) for reason in reasons)
        if len(reasons) == 1:
            doubted_alone[reasons[0], is_hidden] += 1
    rows = [
        [
            REASONS[reason],
            *(str(doubted[reason, is_hidden]) for is_hidden in (True, False)),
            *(str(doubted_alone[reason, is_hidden]) for is_hidden in (True, False)),
        ]
        for reason in sorted({reason for reason, _ in doubted})
    ]
    n_by_kind = Counter(
        (is_hidden, finding["confidence"] == "confident")
        for finding, is_hidden in judged
    )
    heads = ["reason", "hidden", "not hidden", "hidden, alone", "not hidden, alone"]
    return [
        "## What each reason for doubt costs and buys",
        "",
        (
            "Findings with all rules that a reason makes weak: what is hidden (a cost) and"
            " what is not (a gain); alone: no other reason speaks against it. Confident"
            f" without any: {n_by_kind[True, True]} hidden, {n_by_kind[False, True]} not;"
            f" weak: {n_by_kind[True, False]} hidden, {n_by_kind[False, False]} not. What"
            " is not hidden holds surrogates of torque without a name and of payloads."
        ),
        "",
        *markdown_lines(heads, rows),
    ]


def ablation_csv(known: Mapping[str, Arms]) -> str:
    """A row a case and rule: whether what is asked is met with and without it, and
    whether anything else is named."""
    questions = [q.replace(" ", "_") for q in ASKED]
    heads = ["case", "rule"]
    heads += [f"{q}_{arm}" for q in questions for arm in ("with", "without")]
    lines = [",".join([*heads, "other_findings"])]
    for key, arms in known.items():
        with_all = arms[WITH_ALL]
        if not counted(with_all):
            continue
        for rule in (r for r in arms if r != WITH_ALL):
            answers = [
                int(is_met(record))
                for is_met in ASKED.values()
                for record in (with_all, arms[rule])
            ]
            is_changed = int(_names(with_all) != _names(arms[rule]))
            lines.append(",".join(map(str, [key, rule, *answers, is_changed])))
    return "\n".join(lines) + "\n"


def _mean_rise(pairs: Sequence[tuple[Record, Record]]) -> float:
    """Mean change without the rule of the sum of the joints' log errors."""
    rises = [np.log(np.divide(b["held_out"], a["held_out"])) for a, b in pairs]
    return float(np.mean([np.sum(rise) for rise in rises]))


def _names(record: Record) -> list[tuple[str, str]]:
    """What is named, and how surely."""
    return sorted((f["text"], f["confidence"]) for f in record["found"])
