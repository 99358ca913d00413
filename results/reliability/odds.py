"""How large must the odds of a claim be, for it to be right? On arms of strangers.py.

    python results/reliability/odds.py --arms 0:90 --logs 6 --out results/reliability

Each log is checked with a threshold of log-odds of LEAST; a claim of the race is kept
with its log-odds, and is right if it, or one of what is as likely, names what was done on
its joint. What is said below a higher threshold is what precedes the first claim under it:
claims are taken in turn. Facts of the file are kept as well. Arms of even numbers set the
threshold (half "sets"), those of odd ones judge it. Writes odds.csv and odds.md; arms that
are in odds.csv are not judged again.
"""

import argparse
import gc
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from pathlib import Path

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).parents[1])

import numpy as np
import pandas
from challenge.judge import share
from reliability.strangers import KNOWN, Arm, Log, logs_of

from sdp_vs_penalty.checks import check_runs
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.race import Claim, Race, RaceOutcome, constants
from sdp_vs_penalty.results.table import markdown_lines

#: Log-odds from which on claims are kept.
LEAST = 6.0
#: Ends of the bins of log-odds.
BINS = (6.0, 10.0, 14.0, 20.0, 30.0, 45.0, 70.0, 110.0, 200.0, 400.0, np.inf)
#: Lower end of the 95 % interval of "right" that a word needs, and of how many claims.
LIKELY, CERTAIN, ENOUGH = 0.88, 0.97, 150
#: Facts of a motion, and what names no cause.
NO_CLAIM = {
    "poor excitation",
    "idle joints",
    "lockstep motion",
    "unexplained torque",
    "torque not explained",
    "quantisation",
    "low sample rate",
}


@dataclass(frozen=True)
class Row:
    """One claim about a log."""

    arm: str
    half: str
    change: str
    size: str
    by: str
    #: Place among the claims about this log.
    place: int
    log_odds: float
    kind: str
    joints: str
    #: As it is said: "certain" or "likely" of facts; of claims "sure" if it may be.
    word: str
    is_right: bool
    seconds: float


def judged(name: str, number: int, count: int) -> Iterator[Row]:
    """Check the logs of one arm."""
    half = "sets" if number % 2 == 0 else "judges"
    verdicts: list[RaceOutcome] = []
    run = Race.run

    def kept(race: Race) -> RaceOutcome:
        verdicts.append(run(race))
        return verdicts[-1]

    Race.run = kept  # type: ignore[method-assign]
    constants.LOG_ODDS_OF_A_CLAIM = constants.LIKELY = LEAST
    try:
        with tempfile.TemporaryDirectory() as folder:
            for arm, log in logs_of(name, number, count):
                path = Path(folder) / "arm.urdf"
                path.write_text(arm.urdf)
                verdicts.clear()
                yield from _of_log(arm, log, path, half, verdicts)
        gc.collect()  # rows and columns of all logs
    finally:
        Race.run = run  # type: ignore[method-assign]


def _of_log(
    arm: Arm, log: Log, path: Path, half: str, verdicts: list[RaceOutcome]
) -> Iterator[Row]:
    problem = load_problem(path)
    runs = [
        Measurements(x.t, x.q, x.tau, None, None, (f"run{k}",))
        for k, x in enumerate(log.runs)
    ]
    begin = time.process_time()
    try:
        reports = check_runs(problem, runs, False)
    except InputError as error:
        reports = []
        print(arm.name, arm.seed, log.change, error)
    seconds = time.process_time() - begin
    about = (f"{arm.name}-{arm.seed}", half, log.change, log.size)
    yield Row(*about, "log", 0, np.nan, "", "", "", True, seconds)
    claims = [c for verdict in verdicts for c in verdict.claims]
    for place, c in enumerate(claims):
        h = c.hypothesis
        if c.is_usual or (h.effect and not h.by_controller):
            word = "usual" if c.is_usual else "effect"
        else:
            word = "sure" if verdicts[0].is_sure_of(c) else "possible"
        joints = "+".join(str(j + 1) for j in h.joints)
        right = _is_right(log, c)
        yield Row(*about, "race", place, c.log_odds, h.kind, joints, word, right, 0.0)
    said = {
        (i.kind, i.where): i for report in reports for i in report.errors_and_warnings
    }
    for i in said.values():
        if i.kind in NO_CLAIM or "log_odds" in i.figures:
            continue
        at = set(i.figures.get("joints", ()))
        right = names(log, i.kind, at)
        joints = "+".join(str(j) for j in sorted(at))
        word = i.certainty.grade
        yield Row(*about, i.nature, 0, np.nan, i.kind, joints, word, right, 0.0)


def _is_right(log: Log, claim: Claim) -> bool:
    """Whether a claim, or what is as likely, names what was done."""
    about = [x.hypothesis for x in (claim, *claim.rivals)]
    return any(names(log, h.kind, {j + 1 for j in h.joints}) for h in about)


def names(log: Log, kind: str, joints: set[int]) -> bool:
    """Whether a kind of issue on some joints names what was done."""
    on_joints = not joints or not log.joints or joints == set(log.joints)
    return kind in log.kinds and on_joints


def said_above(rows: pandas.DataFrame, least: float) -> pandas.DataFrame:
    """Return the claims that are said with a threshold of log-odds: those that precede
    the first one below it."""
    race = rows[rows["by"] == "race"]
    logs = race.groupby(["arm", "change"])["log_odds"]
    race = race[logs.cummin() >= least]
    return race[race["word"] == "sure"]


def thresholds(rows: pandas.DataFrame) -> tuple[float, float]:
    """Return the log-odds from which on a claim is likely, and certain: the least bin
    from which on the interval of "right" lies high enough; infinite where none does."""
    words = []
    for lower, enough in ((LIKELY, 1), (CERTAIN, ENOUGH)):
        least = np.inf
        for begin in BINS[:-1][::-1]:
            right = said_above(rows, begin)["is_right"]
            if len(right) >= enough and _lower(right) > lower:
                least = begin
        words.append(least)
    return words[0], words[1]


def _lower(right: pandas.Series) -> float:
    """Lower end of Wilson's 95 % interval."""
    n, p, z = len(right), right.mean(), 1.96
    middle = p + z * z / (2 * n)
    return float(
        (middle - z * np.sqrt(p * (1 - p) / n + (z / (2 * n)) ** 2)) / (1 + z * z / n)
    )


def _cell(right: pandas.Series) -> str:
    if not len(right):
        return ""
    percent, interval = share(int(right.sum()), len(right))[1:]
    return f"{int(right.sum())} of {len(right)}, {percent} ({interval})"


def markdown(rows: pandas.DataFrame, command: str) -> str:
    """The tables: claims by bin of odds and from a threshold on, facts, wrong claims."""
    halves = {x: rows[rows["half"] == x] for x in ("sets", "judges")}
    halves["both"] = rows
    text = ["# How large must the odds of a claim be?", "", f"Made by `{command}`.", ""]
    n_arms = rows["arm"].nunique()
    logs = rows[rows["by"] == "log"]
    n_clean = int((logs["change"] == "clean").sum())
    text += [
        f"{n_arms} arms, {len(logs)} logs, {n_clean} of them clean;"
        f" {logs['seconds'].mean():.2f} s of processor time a log.",
        "",
        "## Claims by log-odds",
        "",
    ]
    table = []
    for begin, end in pairwise(BINS):
        cells = [f"{begin:g} to {end:g}"]
        for part in halves.values():
            said = said_above(part, begin)
            cells.append(_cell(said[said["log_odds"] < end]["is_right"]))
        table.append(cells)
    text += markdown_lines(["log-odds", *(f"right, {x}" for x in halves)], table)
    text += ["", "## All that is said with a threshold", ""]
    table = []
    for begin in BINS[:-1]:
        cells = [f"{begin:g}"]
        for part in halves.values():
            cells.append(_cell(said_above(part, begin)["is_right"]))
        clean = said_above(rows[rows["change"] == "clean"], begin)
        named = said_above(rows, begin).query("is_right")
        cells += [str(clean.drop_duplicates("arm").shape[0])]
        cells += [str(named.drop_duplicates(["arm", "change"]).shape[0])]
        table.append(cells)
    heads = [*(f"right, {x}" for x in halves), "clean arms with a claim", "logs named"]
    text += markdown_lines(["threshold", *heads], table)
    likely, certain = thresholds(halves["sets"])
    text += [
        "",
        f"The half that sets gives: likely from {likely:g}, certain from {certain:g}"
        f" (lower end above {LIKELY:.0%} and {CERTAIN:.0%}, {ENOUGH} claims).",
        "",
        "## What is said without odds",
        "",
    ]
    table = []
    for by in ("fact", "explanation"):
        for word in ("certain", "likely", "possible"):
            of = [p[(p["by"] == by) & (p["word"] == word)] for p in halves.values()]
            if len(of[-1]):
                table.append([f"{by}, {word}", *(_cell(x["is_right"]) for x in of)])
    text += markdown_lines(["word", *(f"right, {x}" for x in halves)], table)
    missed = logs[logs["change"] != "clean"]
    right = rows[rows["is_right"] & (rows["by"] != "log") & (rows["word"] != "usual")]
    named = {(x.arm, x.change) for x in right.itertuples()}
    text += ["", "## By change", ""]
    text += [
        "Force and coupling are effects of the arm, which `check` does not name.",
        "",
    ]
    table = [
        [str(change), str(len(of)), str(sum((x, change) in named for x in of["arm"]))]
        for change, of in missed.groupby("change")
    ]
    text += markdown_lines(["change", "logs", "named by any word"], table)
    text += ["", f"## Wrong, from {constants.LOG_ODDS_OF_A_CLAIM:g}", ""]
    wrong = said_above(rows, constants.LOG_ODDS_OF_A_CLAIM)
    other = rows[
        rows["by"].isin(["fact", "explanation"]) & (rows["word"] != "possible")
    ]
    wrong = pandas.concat([wrong, other])
    text += [
        f"- {x.arm}, {x.change} {x.size}: {x.kind} {x.joints}, {x.log_odds:.1f}"
        for x in wrong[~wrong["is_right"]].itertuples()
    ]
    return "\n".join([*text, ""])


def read(path: Path) -> list[Row]:
    """The rows of a table that has been begun."""
    if not path.exists():
        return []
    table = pandas.read_csv(path, keep_default_na=False)
    table["log_odds"] = pandas.to_numeric(table["log_odds"], errors="coerce")
    names = [field.name for field in fields(Row)]
    return [Row(*values) for values in table[names].itertuples(index=False)]


def main(arguments: Sequence[str] | None = None) -> None:
    """Judge the arms that are not in the table, and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--arms", default="0:90", help="first:behind the last, ...")
    parser.add_argument("--logs", type=int, default=6, help="changed ones of each arm")
    parser.add_argument("--out", type=Path, default=Path("results", "reliability"))
    options = parser.parse_args(arguments)
    threshold = constants.LOG_ODDS_OF_A_CLAIM, constants.LIKELY
    ranges = [tuple(map(int, x.split(":"))) for x in options.arms.split(",")]
    path = options.out / "odds.csv"
    rows = read(path)
    known = {row.arm for row in rows}
    names = ["drawn", *KNOWN, "drawn"]
    for number in [x for ends in ranges for x in range(*ends)]:
        name = names[number // 2 % len(names)]
        if f"{name}-{number}" in known:
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            rows += judged(name, number, options.logs)
        table = pandas.DataFrame([asdict(row) for row in rows])
        text = table.to_csv(index=False, lineterminator="\n", float_format="%.4g")
        write_text(path, text)
    constants.LOG_ODDS_OF_A_CLAIM, constants.LIKELY = threshold
    table = pandas.DataFrame([asdict(row) for row in rows])
    command = f"python results/reliability/odds.py --arms {options.arms} --logs {options.logs}"
    write_text(options.out / "odds.md", markdown(table, command))


if __name__ == "__main__":
    main()
