"""What the check says of real logs that nothing is wrong with: whole, in halves, together.

    python results/reliability/check_real.py --data DATA --out FOLDER [--arms panda,emps]

DATA holds the measurements as `sdp-vs-penalty fetch` leaves them. Every error is false,
and so is every claim about the dynamics but those of KNOWN. Facts are read from the file
and count as right. Writes real_logs.csv, with what `identify` would refuse, and
real_claims.csv for reliability.py. Arms that are in real_logs.csv are not judged again.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

if __name__ == "__main__":  # for this process and its workers
    sys.path[0] = str(Path(__file__).parents[1])

import pandas
from reliability.reliability import (
    OF_THE_MOTION,
    Claim,
    claim,
    read_claims,
    write_claims,
)

from sdp_vs_penalty import load_measurements, load_problem
from sdp_vs_penalty.checks import check_runs
from sdp_vs_penalty.data.datasets import converted
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem.problem import Problem

ARMS = "panda,ur10e,ur10,tx40,emps"
#: True claims, by a run's name and the kind: at 3062.75 s of the first run joint 2's torque
#: falls from 101 to 52 N m while it moves smoothly. That the two loaded runs have
#: different loads no paper says; one arm for both leaves the wrists' torques with twenty
#: times the error. The check names the run with the heavier load.
KNOWN = {
    ("ur-20_02_19_15harm50secLoad", "one-off event"),
    ("ur-20_02_19_14harm50secLoad", "another load"),
}


def logs_of(runs: Sequence[Measurements]) -> Iterator[list[Measurements]]:
    """Each run, its halves, and all runs with and without a load together."""
    for run in runs:
        span = float(run.t[-1] - run.t[0])
        yield [run]
        yield [run.window(0.0, 0.5 * span)]
        yield [run.window(0.5 * span, span)]
    loaded = [run for run in runs if "Load" in run.names[0]]
    empty = [run for run in runs if "Load" not in run.names[0]]
    for group in (loaded, empty):
        if len(group) > 1:
            yield group


@dataclass(frozen=True)
class JudgedLog:
    """log : names of its runs and how long they are; is_refused : by `identify`."""

    arm: str
    log: str
    is_refused: bool
    n_claims: int
    n_false: int


def problem_and_runs(name: str, data: Path) -> tuple[Problem, list[Measurements]]:
    """The problem of a real arm, and its runs."""
    if name != "ur10":
        return load_problem(name), [*converted(name, data / name).values()]
    problem = load_problem(data / "ur10_salerno" / "robot.urdf")
    path = data / "ur10_salerno" / "train.csv"
    names = problem.robot.joint_names
    return problem, [load_measurements(path, joints=problem.robot.n, names=names)]


def judged(
    name: str, problem: Problem, log: list[Measurements]
) -> tuple[JudgedLog, list[Claim]]:
    """What is said of some runs of an arm."""
    claims = []
    reports = check_runs(problem, log, thorough=False)
    for report in reports:
        for issue in report.errors_and_warnings:
            if issue.kind in OF_THE_MOTION:
                continue
            is_fact = issue.nature == "fact" and issue.severity != "error"
            is_right = is_fact or (report.run, issue.kind) in KNOWN
            claims.append(claim("real arms", f"{name}: {report.run}", issue, is_right))
    seconds = sum(float(run.t[-1] - run.t[0]) for run in log)
    row = JudgedLog(
        arm=name,
        log=f"{', '.join(run.names[0] for run in log)} ({seconds:.3g} s)",
        is_refused=any(report.meaningless for report in reports),
        n_claims=len(claims),
        n_false=sum(not x.is_right for x in claims),
    )
    return row, claims


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=Path("."))
    parser.add_argument("--out", type=Path, default=Path("results", "reliability"))
    parser.add_argument("--arms", default=ARMS)
    options = parser.parse_args()
    path = options.out / "real_logs.csv"
    table = pandas.read_csv(path) if path.exists() else pandas.DataFrame()
    claims = read_claims(options.out / "real_claims.csv") if len(table) else []
    known = set(table["arm"]) if len(table) else set()
    for name in options.arms.split(","):
        if name in known:
            continue
        problem, runs = problem_and_runs(name, options.data)
        rows = []
        for log in logs_of(runs):
            row, said = judged(name, problem, log)
            rows.append(asdict(row))
            claims += said
        table = pandas.concat([table, pandas.DataFrame(rows)])
        write_text(path, table.to_csv(index=False, lineterminator="\n"))
        write_claims(claims, options.out / "real_claims.csv")
    n_refused = int(table["is_refused"].sum())
    print(f"{len(table)} logs, {n_refused} refused, {len(claims)} claims,", end=" ")
    print(f"{int(table['n_false'].sum())} of them wrong")


if __name__ == "__main__":
    main()
