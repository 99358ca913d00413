"""False claims about robots in which nothing is hidden, nuisance by nuisance."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.parallel import spread
from sdp_vs_penalty.simulation.challenge.case import Case, Record, run_case
from sdp_vs_penalty.simulation.challenge.report import wilson
from sdp_vs_penalty.simulation.worlds.conditions import NUISANCES

#: Of the record's format: cases of another version are simulated anew.
VERSION = 1
#: What a diagnosis of a clean robot can come to; the first is a false claim.
OUTCOMES = ("false", "named", "abstained", "silent")


def run_clean(
    cases: int,
    seed: int,
    out: Path,
    nuisances: Sequence[str] | None = None,
    jobs: int = 2,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Path]:
    """Run what is missing of ``cases`` clean cases a nuisance; write worlds.json and worlds.md.

    Raises InputError for a nuisance that does not exist.
    """
    names = list(NUISANCES) if nuisances is None else list(nuisances)
    for name in names:
        if name not in NUISANCES:
            raise InputError(f"nuisance {name!r} is unknown; there are: {', '.join(NUISANCES)}.")
    store = out / "worlds.json"
    records: dict[str, Record] = {}
    if store.is_file():
        kept = json.loads(store.read_text())
        records = kept["cases"] if kept.get("version") == VERSION else {}
    wanted = [Case("clean", name, seed, k) for k in range(cases) for name in names]
    todo = [case for case in wanted if case.key not in records]
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    for done, (key, record) in enumerate(spread(run_case, todo, jobs=jobs), start=1):
        records[key] = record
        progress(f"case {done} of {len(todo)}")
        if done % 8 == 0 or done == len(todo):
            write_text(store, json.dumps({"version": VERSION, "cases": records}) + "\n")
    report = out / "worlds.md"
    write_text(report, clean_report({c.key: records[c.key] for c in wanted}, cases, seed))
    return [store, report]


def outcome(record: Record) -> str:
    """Of OUTCOMES: a false claim is an effect that is not fair to name, at whatever confidence; an
    abstention where it is not fair; or a refusal of measurements that a real arm might have made."""
    unfair = [f for f in record["found"] if f["effect"] not in record["fair"]]
    unknown = record["verdict"] == "unknown_effect"
    if unfair or record["verdict"] == "refused" or (unknown and not record["abstains"]):
        return "false"
    if record["found"] or record["retuned"]:
        return "named"
    return "abstained" if unknown else "silent"


def clean_report(records: Mapping[str, Record], cases: int, seed: int) -> str:
    """Shares by nuisance with Wilson's intervals; then every false claim."""
    lines = [
        "# Clean robots: what the diagnosis claims to be missing",
        "",
        f"`sdp-vs-penalty challenge --nuisance all --cases {cases} --seed {seed}`. Nothing is hidden; "
        "named: only what the nuisance makes fair, or a changed shape constant.",
        "",
        "| nuisance | cases | false claims | interval | named | abstained | silent | seconds |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    names = list(dict.fromkeys(r["nuisance"] for r in records.values()))
    for name in [*names, "all"]:
        mine = [r for r in records.values() if name in (r["nuisance"], "all")]
        count = Counter(outcome(r) for r in mine)
        low, high = wilson(count["false"], len(mine))
        seconds = sum(r.get("seconds", 0.0) for r in mine) / len(mine)
        cells = [name, str(len(mine)), str(count["false"]), f"{100 * low:.0f} to {100 * high:.0f} %"]
        cells += [str(count[kind]) for kind in OUTCOMES[1:]]
        lines.append("| " + " | ".join([*cells, f"{seconds:.1f}"]) + " |")
    lines += ["", "## False claims", ""]
    for key, r in records.items():
        if outcome(r) == "false":
            lines.append(f"- {key} on {r['conditions']['arm']}: {r['verdict']}; {claims(r)}")
    return "\n".join(lines) + "\n"


def claims(record: Record) -> str:
    """What was named; in brackets where it is fair."""
    words = []
    for f in record["found"]:
        joints = ":" + "+".join(map(str, f["joints"])) if f["joints"] else ""
        shape = "".join(f"@{name}={value:.4g}" for name, value in f["shape"].items())
        text = f"{f['effect']}{joints}{shape} {f['confidence']}"
        words.append(f"[{text}]" if f["effect"] in record["fair"] else text)
    return ", ".join(words) or record.get("error", "nothing named")
