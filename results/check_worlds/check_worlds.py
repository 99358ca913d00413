"""What the check says of logs that nothing is wrong with: the worlds of the challenge.

    python results/check_worlds/check_worlds.py --cases 5 --seed 1000 --out FOLDER

Each world is a simulated arm with friction laws, sensors and servo that the library does
not share, some with an effect that `diagnose` would name. Nothing was done to their logs,
so that every error is false, and so is every explanation that names a fault of the log,
unless the world has that very thing (a delay, a gain, a tilt of the base). What is left
unexplained, an event, or a motion that shows little are statements about the arm: they
are counted apart. Worlds come in a drawn order, so that a run that is stopped has judged
a fair sample. Writes check_worlds.csv, check_worlds.md, and worlds_claims.csv for
reliability.py. What is in check_worlds.csv already is not run again.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields
from pathlib import Path

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
if __name__ == "__main__":  # for this process and its workers
    sys.path[0] = str(Path(__file__).parents[1])

import numpy as np
import pandas
from challenge.cases import CLASSES, BuiltCase, Case, build_case, wanted
from challenge.judge import share
from challenge.worlds.conditions import NUISANCES, Channel
from challenge.worlds.runs import urdf_of
from reliability.reliability import (
    OF_THE_MOTION,
    Claim,
    claim,
    read_claims,
    write_claims,
)

from sdp_vs_penalty.checks import Issue, check_runs
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.results.table import markdown_lines

#: Statements about the arm or the motion, no fault of the log.
ABOUT_THE_ARM = {
    "unexplained torque",
    "torque not explained",
    "one-off event",
    "poor excitation",
    "lockstep motion",
    "idle joints",
}
#: Faults of the log that a hidden effect, or a nuisance, of these words is.
TRUE_OF = {
    "delay": ("delay", "filter", "causal"),
    "torque filter": ("delay", "filter", "causal"),
    "channel delay": ("delay", "filter", "causal"),
    "channel filter": ("delay", "filter", "causal"),
    "torque gain": ("torque_gain",),
    "gravity direction": ("tilt", "base"),
    "encoder offset": ("zero_error", "geometry", "tilt"),
    "link length": ("geometry",),
    "torque drift": ("drift", "warming", "temperature", "disturbance"),
    "torque step": ("disturbance", "step"),
    "saturation": ("saturation", "disturbance"),
    "change within the run": ("disturbance", "payload"),
    "quantisation": ("encoder", "coarse", "quantis"),
    "low sample rate": ("rate",),
}


@dataclass(frozen=True)
class Row:
    """One world: what it has, and what is said of it."""

    case: str
    effects: str
    refused: bool
    errors: str
    false_explanations: str
    true_explanations: str
    other_facts: str
    about_the_arm: str
    seconds: float


def run_case(case: Case) -> tuple[Row, list[Claim]]:
    """Check all runs of a world together, as a user would."""
    built = build_case(case)
    problem = load_problem(urdf_of(built.conditions.arm))
    runs = [logged.run for logged in built.logged[:-1]]
    begin = time.process_time()
    try:
        reports = check_runs(problem, runs, False)
    except InputError as error:
        return Row(case.key, "", True, str(error), "", "", "", "", 0.0), []
    seconds = time.process_time() - begin
    truth = truth_of(case, built)
    issues = {
        (issue.kind, issue.where): issue
        for report in reports
        for issue in report.errors_and_warnings
    }
    texts: dict[str, list[str]] = {place: [] for place in PLACES}
    claims = []
    for issue in issues.values():
        place = place_of(issue, truth)
        words = f"{issue.kind} ({issue.where})"
        if place == "false_explanations":
            words = f"{words}: {issue.what}"
        texts[place].append(words)
        if issue.kind not in OF_THE_MOTION:
            is_right = place == "true_explanations" or is_seen_in(issue, truth)
            claims.append(claim("worlds", case.key, issue, is_right))
    columns = {place: "; ".join(words) for place, words in texts.items()}
    is_refused = bool(texts["errors"])
    row = Row(
        case=case.key, effects=truth, refused=is_refused, seconds=seconds, **columns
    )
    return row, claims


def truth_of(case: Case, built: BuiltCase) -> str:
    """What a world has, in words: its hidden effects, and what a mixture of nuisances
    holds."""
    conditions = built.conditions
    channel = conditions.channel
    nuisances = {
        "causal": channel.lag > 0.0,
        "delay": channel.delay > 0.0,
        "warming": conditions.warming > 0.0,
        "encoder": channel.step > Channel().step,
    }
    words = [h.effect for h in built.hidden] + [case.kind, case.nuisance]
    words += [word for word, is_there in nuisances.items() if is_there]
    return " ".join(words)


#: Where a row has what was said.
PLACES = (
    "errors",
    "false_explanations",
    "true_explanations",
    "other_facts",
    "about_the_arm",
)


def place_of(issue: Issue, truth: str) -> str:
    """In which column an issue stands, of a world that has what these words say."""
    if issue.severity == "error":
        return "errors"
    if issue.kind in ABOUT_THE_ARM:
        return "about_the_arm"
    if any(word in truth for word in TRUE_OF.get(issue.kind, ())):
        return "true_explanations"
    return "other_facts" if issue.nature == "fact" else "false_explanations"


def is_seen_in(issue: Issue, truth: str) -> bool:
    """Whether unexplained torque, or an event, has a hidden cause in such a world."""
    is_clean = truth.startswith("clean")
    return issue.kind in ABOUT_THE_ARM and not is_clean


def markdown(rows: Sequence[Row], command: str) -> str:
    """The table by class, and every false explanation in its words."""
    heads = ["class", "worlds", "refused", "with a false explanation", "share", "95 %"]
    groups = {
        kind: [r for r in rows if r.case.startswith(kind + "/")] for kind in CLASSES
    }
    table = []
    for kind, some in [*groups.items(), ("all", list(rows))]:
        if some:
            n_false = sum(bool(r.false_explanations) for r in some)
            n_refused = sum(r.refused for r in some)
            cells = [
                kind,
                len(some),
                n_refused,
                n_false,
                *share(n_false, len(some))[1:],
            ]
            table.append([str(x) for x in cells])
    text = ["# What the check says of logs that nothing is wrong with", ""]
    text += [f"Made by `{command}`.", ""]
    text += markdown_lines(heads, table)
    seconds = sum(r.seconds for r in rows) / max(len(rows), 1)
    text += ["", f"Mean time of the processor: {seconds:.2f} s a world.", ""]
    text += ["## False explanations", ""]
    text += [
        f"- {r.case}: {r.false_explanations}" for r in rows if r.false_explanations
    ] or ["none"]
    text += ["", "## Errors", ""]
    text += [f"- {r.case}: {r.errors}" for r in rows if r.refused] or ["none"]
    return "\n".join([*text, ""])


def read_rows(path: Path) -> list[Row]:
    """The rows of a table that has been begun."""
    if not path.exists():
        return []
    table = pandas.read_csv(path, keep_default_na=False)
    names = [field.name for field in fields(Row)]
    return [Row(*values) for values in table[names].itertuples(index=False)]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=20, help="of each class")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", type=int, default=1, help="one case in so many")
    parser.add_argument(
        "--part", type=int, default=0, help="which of these samples, from 0"
    )
    parser.add_argument(
        "--worlds-of", type=Path, help="the worlds of this challenge.json"
    )
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=1e9, help="stop after so long")
    parser.add_argument("--out", type=Path, default=Path("results", "check_worlds"))
    options = parser.parse_args()
    if options.worlds_of:
        cases = cases_of(options.worlds_of)
        which = f"--worlds-of {options.worlds_of}"
    else:
        cases = wanted(options.cases, options.seed, [*CLASSES], [*NUISANCES])
        which = f"--cases {options.cases} --seed {options.seed}"
    order = np.random.default_rng(options.seed).permutation(len(cases))
    cases = [cases[k] for k in order]
    command = (
        f"python results/check_worlds/check_worlds.py {which} --every {options.every}"
    )
    rows = read_rows(options.out / "check_worlds.csv")
    claims = read_claims(options.out / "worlds_claims.csv") if rows else []
    known = {row.case for row in rows}
    sample = cases[options.part :: options.every]
    todo = [case for case in sample if case.key not in known]
    begin = time.monotonic()
    with ProcessPoolExecutor(options.workers) as pool:
        while todo and time.monotonic() - begin < options.seconds:
            for row, made in pool.map(run_case, todo[:10]):
                rows.append(row)
                claims += made
                print(row.case, row.errors, row.false_explanations, flush=True)
            todo = todo[10:]
            write_all(options.out, rows, claims, command)


def cases_of(challenge: Path) -> list[Case]:
    """The cases that a challenge has judged, from its challenge.json."""
    keys = json.loads(challenge.read_text())["cases"]
    cases = []
    for key in keys:
        kind, nuisance, seed, index = key.split("/")
        cases.append(Case(kind, nuisance, int(seed), int(index)))
    return cases


def write_all(
    folder: Path, rows: Sequence[Row], claims: Sequence[Claim], command: str
) -> None:
    """The table of worlds, its summary, and the claims."""
    table = pandas.DataFrame([asdict(row) for row in rows])
    text = table.to_csv(index=False, lineterminator="\n", float_format="%.3g")
    write_text(folder / "check_worlds.csv", text)
    write_text(folder / "check_worlds.md", markdown(rows, command))
    write_claims(claims, folder / "worlds_claims.csv")


if __name__ == "__main__":
    main()
