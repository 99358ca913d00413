"""Worlds for rules that act only where the classes of the challenge have nothing.

contradicted : an effect is hidden in the runs and in the first recording of the test
run, and absent from the second. False is a finding that is said to be sure: with it one
recording's error rises.
"""

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from challenge.ablation import WITH_ALL, Discordance
from challenge.cases import Case, build_case, identify_case
from challenge.worlds.runs import Logged, draw_motion, log_run
from sdp_vs_penalty.data.measurements import concatenate
from sdp_vs_penalty.diagnosis.diagnose import DiagnosisRuns, diagnose_runs
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.rules import ALL_RULES
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.results.table import markdown_lines

#: Runs to search in, then the test run; and how many claims of a diagnosis are false.
Target = tuple[Case, list[Logged], Callable[[Diagnosis], int]]


def contradicted(seed: int) -> Target:
    """A hidden effect that the second recording of the test run lacks."""
    case = Case("strong", "plain", seed, seed)
    built = build_case(case)
    *learnt, test = built.logged
    world = built.world
    motion = draw_motion(world, len(built.logged), built.rng)
    without = log_run(world, motion, built.rng)
    both = concatenate([test.run, without.run])

    def n_false(found: Diagnosis) -> int:
        """Count findings that are sure."""
        return sum(f.torque_is_certain for f in found.effects)

    return case, [*learnt, replace(test, run=both)], n_false


#: By the rule that such worlds judge: the worlds.
TARGETS: Mapping[str, Callable[[int], Target]] = {"second_veto": contradicted}


def run_target(rule: str, seed: int) -> dict[str, Any]:
    """False claims with all rules and without one, and the seconds that each takes."""
    case, logged, n_false = TARGETS[rule](seed)
    *learnt, test = logged
    training = concatenate([x.run for x in learnt])
    built = build_case(case)
    estimate = identify_case(case, replace(built, logged=logged))
    prepared = DiagnosisRuns(estimate, training, test.run)
    prepared.candidates  # noqa: B018 (both share them)
    out: dict[str, Any] = {"rule": rule, "seed": seed}
    for name, rules in (
        (WITH_ALL, ALL_RULES),
        ("without", replace(ALL_RULES, **{rule: False})),
    ):
        begin = time.process_time()
        found = diagnose_runs(prepared, rules=rules)
        out[name] = n_false(found)
        out[f"seconds {name}"] = time.process_time() - begin
        out[f"texts {name}"] = [f"{f.text} {f.rating}" for f in found.effects]
    return out


def run_targets(n_worlds: int, seed: int, out: Path) -> list[Path]:
    """Run what is missing, a JSON line a world; write targets.md from all of it."""
    store = out / "targets.jsonl"
    report = out / "targets.md"
    lines = store.read_text().splitlines() if store.is_file() else []
    known = [json.loads(line) for line in lines]
    done = {(x["rule"], x["seed"]) for x in known}
    for rule in TARGETS:
        for k in range(n_worlds):
            if (rule, seed + k) in done:
                continue
            known.append(run_target(rule, seed + k))
            with store.open("a") as stream:
                stream.write(json.dumps(known[-1]) + "\n")
    write_text(report, targets_text(known))
    return [store, report]


def targets_text(known: list[dict[str, Any]]) -> str:
    """The committed report."""
    rows = []
    for rule, world in TARGETS.items():
        of_rule = [x for x in known if x["rule"] == rule]
        counts = Discordance(
            n_mended=sum(x[WITH_ALL] < x["without"] for x in of_rule),
            n_spoilt=sum(x[WITH_ALL] > x["without"] for x in of_rule),
            n_cases=len(of_rule),
        )
        n_false = [sum(x[arm] > 0 for x in of_rule) for arm in (WITH_ALL, "without")]
        rows.append(
            [rule, world.__name__, str(len(of_rule)), *map(str, n_false), counts.text]
        )
    heads = ["rule", "worlds", "n", "false with", "false without", "mended, spoilt"]
    return "\n".join(
        [
            "# Worlds made for a rule",
            "",
            " ".join((__doc__ or "").split("\n\n", 1)[1].split()),
            "",
            *markdown_lines(heads, rows),
            "",
        ]
    )
