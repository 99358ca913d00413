"""What does each rule of the search buy? The same cases with and without it, paired.

McNemar's exact test asks whether the cases that a rule mends outnumber those that it
spoils: of b + c cases that differ, b or fewer on one side by a fair coin.
"""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

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
    counted,
    extras,
    first_right,
    found_in_time,
    outcome,
    sizes,
)
from sdp_vs_penalty.data.measurements import concatenate
from sdp_vs_penalty.diagnosis.diagnose import DiagnosisRuns, diagnose_runs
from sdp_vs_penalty.diagnosis.rules import ALL_RULES, Rules
from sdp_vs_penalty.errors import InputError
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


def run_without(rules: Sequence[str], case: Case) -> tuple[str, Arms]:
    """The case's key, and its records with all rules and without each."""
    kind = CLASSES[case.kind]
    built = build_case(case)
    *learnt, test = built.logged
    runs = concatenate([x.run for x in learnt])
    base = truth_of(case, built)
    try:
        estimate = identify_case(case, built)
    except InputError as error:
        refused = base | {"verdict": "refused", "error": str(error)}
        return case.key, dict.fromkeys((WITH_ALL, *rules), rounded(refused))
    base |= {"energy": all_hidden_energies(kind, estimate, built)}
    if not counted(base):
        hidden = base | {"verdict": "not shown"}
        return case.key, dict.fromkeys((WITH_ALL, *rules), rounded(hidden))
    prepared = DiagnosisRuns(estimate, runs, test.run, frozen=kind.frozen)
    prepared.candidates  # noqa: B018 (all rules share them, none pays for them)
    out: Arms = {}
    watched = WatchedRules()
    for rule in (WITH_ALL, *rules):
        if rule != WITH_ALL and rule not in watched.asked:
            out[rule] = out[WITH_ALL]
            continue
        applied = watched if rule == WITH_ALL else replace(ALL_RULES, **{rule: False})
        begin = time.process_time()
        found = diagnose_runs(prepared, rules=applied)
        result = found.to_dict()
        out[rule] = rounded(
            base
            | {
                "verdict": result["verdict"],
                "found": result["effects"],
                "retuned": result["retuned"],
                "events": result["events"],
                "held_out": result["held_out_rmse"],
                "seconds": time.process_time() - begin,
            }
        )
    return case.key, out


def run_ablation(
    todo: Sequence[Case], rules: Sequence[str], out: Path, jobs: int
) -> list[Path]:
    """Run what is missing; write rules.json, and from all of it rules.md."""
    store = out / "rules.json"
    report = out / "rules.md"
    with folder_lock(out):
        known: dict[str, Arms] = {}
        if store.is_file():
            known = json.loads(store.read_text())
        missing = [
            c for c in todo if not {WITH_ALL, *rules} <= set(known.get(c.key, ()))
        ]
        work = partial(run_without, tuple(rules))
        for _, (key, arms) in spread(work, missing, jobs=jobs):
            known[key] = known.get(key, {}) | arms
            write_text(store, json.dumps(known) + "\n")
        write_text(report, ablation_text(known))
    return [store, report]


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
    """Records with all rules and without one, of the cases that count."""
    pairs = [(a[WITH_ALL], a[rule]) for a in known.values() if rule in a]
    return [(a, b) for a, b in pairs if counted(a)]


def ablation_text(known: Mapping[str, Arms]) -> str:
    """The committed report."""
    rules = dict.fromkeys(rule for arms in known.values() for rule in arms)
    rows = []
    for rule in (r for r in rules if r != WITH_ALL):
        pairs = paired(known, rule)
        cells = [rule, str(len(pairs))]
        for test in ASKED.values():
            mended = sum(test(a) and not test(b) for a, b in pairs)
            spoilt = sum(test(b) and not test(a) for a, b in pairs)
            chance = 1.0
            if mended + spoilt:
                chance = binomtest(mended, mended + spoilt).pvalue
            cells.append(f"+{mended} -{spoilt} ({chance:.2g})")
        changed = sum(_names(a) != _names(b) for a, b in pairs)
        gains = [np.log(np.divide(b["held_out"], a["held_out"])) for a, b in pairs]
        error = 100.0 * float(np.mean([np.sum(g) for g in gains])) if gains else 0.0
        spent = [sum(r["seconds"] for r in arm) for arm in zip(*pairs, strict=True)]
        faster = f"{spent[0] / spent[1]:.2f}" if pairs else ""
        rows.append([*cells, str(changed), f"{error:+.2f} %", faster])
    heads = ["rule", "cases", *ASKED, "other findings", "error without", "CPU with"]
    classes = sorted({a[WITH_ALL]["class"] for a in known.values()})
    return "\n".join(
        [
            "# What each rule of the search buys",
            "",
            (
                "`benchmarks/challenge --without RULE`: the same cases with all rules and"
                " without one. + cases that the rule mends, - cases that it spoils, in"
                " brackets the chance of a split at least as uneven (McNemar, exact)."
                " Other findings: cases in which anything else is named. Error without:"
                " mean change of the sum of the joints' log errors on the test run, above"
                " zero where the rule helps. CPU with: seconds with the rule over those"
                f" without. {len(known)} cases of the classes {', '.join(classes)}."
            ),
            "",
            *markdown_lines(heads, rows),
            "",
        ]
    )


def _names(record: Record) -> list[tuple[str, str]]:
    """What is named, and how surely."""
    return sorted((f["text"], f["confidence"]) for f in record["found"])
