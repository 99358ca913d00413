"""The shootout from names to runs.csv: proofs of the instances' intervals first, then every run."""

import json
import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import alone, read_text, write_text
from sdp_vs_penalty.parallel import spread
from sdp_vs_penalty.shootout.contestants import Contestant, chosen
from sdp_vs_penalty.shootout.instances import GROUPS, Entry, catalogue, instance, selected
from sdp_vs_penalty.shootout.judge import Reference
from sdp_vs_penalty.shootout.results import Results
from sdp_vs_penalty.shootout.work import Assignment, perform

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Shootout:
    """What to run and how. time_limit [s] and memory [GB] are for each run.

    Raises InputError for settings that make no sense, and on Windows.
    """

    out: Path
    solvers: list[str] | None = None
    problems: list[str] = field(default_factory=lambda: list(GROUPS))
    accuracies: tuple[float, ...] = (1e-4, 1e-6, 1e-8)
    time_limit: float = 60.0
    memory: float = 4.0
    quick: bool = False
    scheduler: str | None = None
    jobs: int = 0

    def __post_init__(self) -> None:
        if not self.accuracies or any(not 1e-14 < a < 1.0 for a in self.accuracies):
            raise InputError(
                "--accuracy takes numbers between 1e-14 and 1", "separate them by commas: 1e-4,1e-8"
            )
        if not self.time_limit > 0.0 or not self.memory > 0.0:
            raise InputError("--time-limit or --memory is not above 0", "correct it")
        if not hasattr(os, "fork"):
            raise InputError("The shootout forks a process for each run", "use Linux or macOS")


@dataclass(frozen=True)
class Outcome:
    """The folder's runs after a shootout, and what was left out: why, by name."""

    results: Results
    absent: dict[str, str]
    not_applicable: list[tuple[str, str, str]]  # problem, solver, reason
    notes: list[str]


def run(setup: Shootout, progress: Progress | None = None) -> Outcome:
    """Do every run that the folder does not hold yet.

    Raises InputError for names that do not exist, and where another shootout writes into the folder.
    """
    with alone(setup.out):
        return _run(setup, progress or (lambda what, done, total: None))


def _run(setup: Shootout, say: Progress) -> Outcome:
    contestants, missing = chosen(setup.solvers)
    entries, unmeasured = selected(setup.problems, catalogue().values(), setup.quick)
    results = Results(setup.out)
    notes = []
    absent = {c.name: str(c.absent) for c in missing}
    absent |= {e.name: "its measurements are absent (SDP_VS_PENALTY_DATA)" for e in unmeasured}
    jobs = setup.jobs or os.cpu_count() or 1
    references = _references(setup, entries, say, jobs)
    if dropped := results.keep({name: found["hash"] for name, found in references.items()}):
        notes.append(f"{dropped} runs of instances that have changed since were dropped")
    tasks, not_applicable = _pending(setup, entries, contestants, references, results)
    done, total = 0, sum(len(task.accuracies) for task in tasks)
    groups, versions = {e.name: e.group for e in entries}, {c.name: c.version() for c in contestants}
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    say("runs", done, total)
    for task, rows in spread(perform, tasks, setup.scheduler, jobs):
        assert task.reference is not None
        about = {name: getattr(task, name) for name in ("problem", "hash", "solver")}
        about |= {"group": groups[task.problem], "version": versions[task.solver], "machine": machine}
        about |= {"lower": task.reference.lower, "upper": task.reference.upper}
        for row in rows:
            if "error" in row:
                notes.append(f"{task.problem}, {task.solver}: {row['error']}")
                continue
            results.add(row | about)
            done += 1
        say(f"{task.solver} on {task.problem}", done, total)
    return Outcome(results, absent, not_applicable, notes)


def _references(
    setup: Shootout, entries: Sequence[Entry], say: Progress, jobs: int
) -> dict[str, dict[str, Any]]:
    """Each instance's hash and proved interval; kept in references.json beside the runs."""
    path = setup.out / "references.json"
    known: dict[str, dict[str, Any]] = {}
    if path.exists():
        try:
            known = json.loads(read_text(path, own=True))
        except ValueError:
            raise InputError("not JSON", "delete it, and the intervals are proved again", path) from None
    current = {e.name: instance(e.name).hash for e in entries}
    todo = {n: h for n, h in current.items() if known.get(n, {}).get("hash") != h}
    tasks = [Assignment(n, h, setup.time_limit, setup.memory) for n, h in todo.items()]
    say("proving intervals", 0, len(tasks))
    for done, (task, (reply,)) in enumerate(spread(perform, tasks, setup.scheduler, jobs), start=1):
        if "error" in reply:
            raise InputError(
                f"instance {task.problem!r} cannot be used: {reply['error']}",
                "leave it out of --problems",
            )
        known[task.problem] = reply
        write_text(path, json.dumps(known, indent=1, sort_keys=True) + "\n")
        say(f"proving intervals: {task.problem}", done, len(tasks))
    return {name: known[name] for name in current}


def _pending(
    setup: Shootout,
    entries: Sequence[Entry],
    contestants: Sequence[Contestant],
    references: dict[str, dict[str, Any]],
    results: Results,
) -> tuple[list[Assignment], list[tuple[str, str, str]]]:
    done, tasks, left_out = results.keys, [], []
    for entry in entries:
        made = instance(entry.name)
        known = Reference(**references[entry.name]["reference"])
        for contestant in contestants:
            if reason := contestant.refuses(made):
                left_out.append((entry.name, contestant.name, reason))
                continue
            # From loose to tight; one for a contestant that cannot be asked.
            asked = sorted(set(setup.accuracies), reverse=True)
            asked = asked if contestant.tunable else [contestant.promise]
            what = entry.name, made.hash, contestant.name
            new = tuple(a for a in asked if (*what, contestant.settings(a)) not in done)
            if new:
                limits = setup.time_limit, setup.memory
                tasks.append(Assignment(*what[:2], *limits, contestant.name, new, known))
    return tasks, left_out
