"""The challenge's figures: shares with Wilson's intervals, by class, by nuisance, by effect."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from challenge import judge
from challenge.judge import Item, Record, counted, wilson
from challenge.worlds.conditions import NUISANCES
from sdp_vs_penalty.formatting import markdown_table

SINGLE = ("strong", "medium", "weak")
HEADINGS = ("class", "counted", "cases", "share", "interval", "to reach")

#: What is counted in which class: (class, what is counted, how, figure to reach).
MEASURES: Sequence[tuple[str, str, Callable[[Record], bool], str]] = (
    ("clean", "false claims, all nuisances", judge.false_claim, "<= 1 %"),
    ("clean", "false events", lambda record: bool(record["events"]), ""),
    ("clean", "false curves", judge.has_curves, "<= 1 %"),
    ("strong", "first named effect right", judge.first_right, ">= 99 %"),
    ("medium", "first named effect right", judge.first_right, ">= 99 %"),
    ("weak", "first named effect right", judge.first_right, ">= 95 %"),
    *((name, "truth in the equivalence set", judge.in_set, ">= 99 %") for name in SINGLE),
    *((name, "nothing named besides", lambda r: not judge.extras(r), "") for name in SINGLE),
    *((name, "nothing confident besides", judge.nothing_else_confident, ">= 98 %") for name in SINGLE),
    *((name, "no curve", lambda r: not judge.has_curves(r), ">= 98 %") for name in SINGLE),
    ("one_run", "first named effect right", judge.first_right, ">= 95 %"),
    ("pairs", "both named", judge.all_named, ">= 95 %"),
    ("triples", "all three named", judge.all_named, ">= 90 %"),
    ("unknown_strong", "abstained", judge.abstained, ">= 97 %"),
    ("unknown_medium", "abstained", judge.abstained, ">= 97 %"),
    ("disturbance", "flagged as event or unknown", judge.flagged, ""),
    ("disturbance", "an event at the right time", judge.found_in_time, ">= 90 %"),
    ("payload", "payload named first", judge.first_right, ""),
    ("unknown", "right variables", judge.right_variables, ">= 90 %"),
    ("unknown", ">= 80 % of the missing energy removed", judge.mostly_removed, ""),
)


def _label(item: Item) -> str:
    joints = "+".join(str(j) for j in item["joints"])
    return f"{item['effect']}:{joints}" if joints else str(item["effect"])


def share(hits: int, count: int) -> list[str]:
    """Cases, share and Wilson's interval."""
    low, high = wilson(hits, count)
    return [str(count), f"{100 * hits / count:.1f} %", f"{100 * low:.1f} to {100 * high:.1f} %"]


def shares(records: Sequence[Record]) -> list[list[str]]:
    """Rows under HEADINGS; of hidden effects only those that these data show."""
    rows = []
    for name, what, test, goal in MEASURES:
        mine = [r for r in records if r["class"] == name and counted(r)]
        if mine:
            rows.append([name, what, *share(sum(map(test, mine)), len(mine)), goal])
        if mine and test is judge.false_claim:
            met = [x for x in NUISANCES if any(r["nuisance"] == x for r in mine)]
            by = {x: [test(r) for r in mine if r["nuisance"] == x] for x in met}
            worst = max(by, key=lambda x: float(np.mean(by[x])))
            for word, x, most in (f"worst nuisance ({worst})", worst, "3"), ("plain", "plain", "0.3"):
                if x in by:
                    cells = share(sum(by[x]), len(by[x]))
                    rows.append(["clean", f"false claims, {word}", *cells, f"<= {most} %"])
    return rows


def report_text(records: Mapping[str, Record], seed: int) -> str:
    """The committed report."""
    every = list(records.values())
    lines = [
        "# Challenge: does diagnose name what is hidden, and nothing else?",
        "",
        f"`benchmarks/challenge --seed {seed}`, cases as counted below. Robots, friction, channels "
        "and hidden effects are simulated by code that shares nothing with the library "
        "(`sdp_vs_penalty/simulation/worlds`). Thresholds were set on other seeds. Intervals are "
        "Wilson's, 95 %. What a nuisance makes fair to name is stated in "
        "`challenge/worlds/conditions.py` and is neither right nor false. "
        "Hidden effects count where these data show them: energy above 30, white and with the model "
        "partialled out, and no link moved by more than 0.3 rad.",
        "",
        *markdown_table(HEADINGS, shares(every)),
        "",
        *_clean(every),
        *_numbers(every),
        *effect_lines(every),
        *_false_claims(records),
    ]
    return "\n".join(lines) + "\n"


def _clean(records: Sequence[Record]) -> list[str]:
    mine = [r for r in records if r["class"] == "clean"]
    if not mine:
        return []
    rows = []
    for name in [x for x in NUISANCES if any(r["nuisance"] == x for r in mine)]:
        group = [r for r in mine if r["nuisance"] == name]
        count = Counter(map(judge.outcome, group))
        cpu = np.mean([r.get("seconds", 0.0) for r in group])
        rest = [str(count[kind]) for kind in judge.OUTCOMES[1:]]
        rows.append([name, *share(count["false"], len(group)), *rest, f"{cpu:.1f}"])
    headings = ["nuisance", "cases", "false", "interval", "named", "abstained", "silent", "CPU s"]
    note = (
        "Nothing is hidden. False: an effect that is not fair to name, or an abstention where "
        "something has a name; named: only what is fair, or a changed shape constant; abstained: where "
        "that is fair."
    )
    return ["## Clean robots, by nuisance", "", note, "", *markdown_table(headings, rows), ""]


def _numbers(records: Sequence[Record]) -> list[str]:
    lines = ["## Errors and times", ""]
    for name in ("clean", *SINGLE):
        mine = [r for r in records if r["class"] == name and counted(r) and r["after"]]
        worst = [max(r["after"]) for r in mine if name == "clean" or judge.all_named(r)]
        if worst:
            lines.append(
                f"- held-out error with what was found over the true floor, {name} ({len(worst)} "
                f"cases): worst joint {np.median(worst):.3f} in the median (to reach: 1.05), "
                f"{np.quantile(worst, 0.9):.3f} at 90 %"
            )
    cpu = [r["seconds"] for r in records if "seconds" in r]
    if cpu:
        figures = f"median {np.median(cpu):.2f}, mean {np.mean(cpu):.2f}, worst {np.max(cpu):.1f}"
        lines.append(f"- CPU seconds a diagnosis: {figures}")
    return [*lines, ""]


def effect_lines(records: Sequence[Record]) -> list[str]:
    """By effect: cases, who was taken for whom, and how honest its size is."""
    mine = [r for r in records if r["class"] in SINGLE]
    rows = []
    for effect in sorted({t["effect"] for r in mine for t in r["truth"]}):
        group = [r for r in mine if r["truth"][0]["effect"] == effect]
        shown = [r for r in group if counted(r)]
        wrong = Counter(_instead(r) for r in shown if not judge.first_right(r))
        named = [s for r in shown for s in judge.sizes(r)]
        covered = sum(s[2] <= 1.96 for s in named)
        counts = len(group) - len(shown), len(shown), sum(map(judge.first_right, shown))
        cells = [effect, *map(str, counts), ", ".join(f"{k} {v}" for k, v in wrong.items())]
        error = f"{100 * np.median([s[1] for s in named]):.1f} %" if named else ""
        rows.append([*cells, error, f"{covered} of {len(named)}" if named else ""])
    everything = [s for r in records if counted(r) for s in judge.sizes(r)]
    if not everything:
        return []
    within = sum(s[2] <= 1.96 for s in everything)
    count, part, interval = share(within, len(everything))
    note = (
        "Left out: not shown by these data. Sizes, of those named: the median relative error, and how "
        f"often the 95 % interval holds the truth. Over all classes: {part} of {count} ({interval}); "
        "to reach: 90 to 98 % for every effect."
    )
    headings = ["hidden", "left out", "cases", "right", "named instead", "size error", "interval holds"]
    title = "## By effect: all classes that hide one"
    return [title, "", note, "", *markdown_table(headings, rows), ""]


def _instead(record: Record) -> str:
    named = judge.first(record)
    if named is None:
        return "nothing" if record["verdict"] == "nothing_missing" else str(record["verdict"])
    if any(named["effect"] == t["effect"] for t in record["truth"]):
        return "another joint"
    return str(named["effect"])


def _false_claims(records: Mapping[str, Record]) -> list[str]:
    lines = ["## False claims about clean robots", ""]
    for key, r in records.items():
        if r["class"] == "clean" and judge.outcome(r) == "false":
            what = ", ".join(f"{_label(f)} ({f['confidence']})" for f in judge.extras(r))
            said = what or r.get("error", "")
            lines.append(f"- {key} on {r['conditions']['arm']}: {r['verdict']}; {said}")
    return lines if len(lines) > 2 else []
