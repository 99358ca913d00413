"""What the check says of logs that nothing is wrong with: the worlds of the challenge.

    python benchmarks/check_worlds.py --cases 5 --seed 1000 --out results

Each world is a simulated arm with friction laws, sensors and servo that the library does
not share, some with an effect that `diagnose` would name. Nothing was done to their logs,
so that every error is false, and so is every explanation that names a fault of the log,
unless the world has that very thing (a delay, a gain, a tilt of the base). What is left
unexplained, an event, or a motion that shows little are statements about the arm: they
are counted apart. Writes check_worlds.csv and check_worlds.md.
"""

import argparse
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
sys.path[0] = str(Path(__file__).parent)  # for this process and its workers

import pandas  # noqa: E402
from challenge.cases import CLASSES, Case, build_case, wanted  # noqa: E402
from challenge.judge import share  # noqa: E402
from challenge.worlds.conditions import NUISANCES  # noqa: E402
from challenge.worlds.runs import urdf_of  # noqa: E402

from sdp_vs_penalty.checks import check_runs  # noqa: E402
from sdp_vs_penalty.errors import InputError  # noqa: E402
from sdp_vs_penalty.files import write_text  # noqa: E402
from sdp_vs_penalty.problem.load import load_problem  # noqa: E402
from sdp_vs_penalty.results.table import markdown_lines  # noqa: E402

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
    "two arms": ("disturbance", "payload"),
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


def run_case(case: Case) -> Row:
    """Check all runs of a world together, as a user would."""
    built = build_case(case)
    problem = load_problem(urdf_of(built.conditions.arm))
    runs = [x.run for x in built.logged[:-1]]
    begin = time.process_time()
    try:
        reports = check_runs(problem, runs, problem.preprocessing, False)
    except InputError as error:
        return Row(case.key, "", True, str(error), "", "", "", "", 0.0)
    spent = time.process_time() - begin
    truth = " ".join([*(h.effect for h in built.hidden), case.kind, case.nuisance])
    said = {
        (f.kind, f.where): f for r in reports for f in r.errors_and_warnings
    }.values()
    false = []
    true = []
    arm = []
    errors = []
    facts = []
    for f in said:
        text = f"{f.kind} ({f.where})"
        if f.severity == "error":
            errors.append(text)
        elif f.kind in ABOUT_THE_ARM:
            arm.append(text)
        elif any(word in truth for word in TRUE_OF.get(f.kind, ())):
            true.append(text)
        elif f.nature == "fact":
            facts.append(text)
        else:
            false.append(f"{text}: {f.what}")
    words = ["; ".join(x) for x in (errors, false, true, facts, arm)]
    return Row(case.key, truth, bool(errors), *words, spent)


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


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=20, help="of each class")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", type=int, default=1, help="one case in so many")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("results"))
    given = parser.parse_args()
    todo = wanted(given.cases, given.seed, [*CLASSES], [*NUISANCES])[:: given.every]
    command = (
        f"python benchmarks/check_worlds.py --cases {given.cases} --seed {given.seed}"
        f" --every {given.every}"
    )
    rows: list[Row] = []
    with ProcessPoolExecutor(given.workers) as pool:
        for row in pool.map(run_case, todo):
            rows.append(row)
            print(row.case, row.errors, row.false_explanations, flush=True)
            table = pandas.DataFrame(map(asdict, rows)).to_csv(
                index=False, lineterminator="\n", float_format="%.3g"
            )
            write_text(given.out / "check_worlds.csv", table)
            write_text(given.out / "check_worlds.md", markdown(rows, command))


if __name__ == "__main__":
    main()
