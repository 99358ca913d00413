"""The shootout from names to runs.csv: proofs of the instances' intervals first, then
every run.

runs.csv has one row a run, written as runs end, read back to go on where a shootout
stopped. A task is all accuracies of one solver on one problem, from loose to tight:
what exceeds the time limit at one would exceed it at every tighter one. The worker
builds the instance, forks for each run, which ends by itself, the clock, its memory or
a signal, and judges the numbers that come back.
"""

import contextlib
import io
import json
import math
import os
import platform
import resource
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.files import (
    folder_lock,
    read_text,
    unique_fields,
    write_text,
)
from sdp_vs_penalty.parallel import end_with, spread
from sdp_vs_penalty.shootout.catalogue import (
    Entry,
    catalogue,
    instance,
    selected,
)
from sdp_vs_penalty.shootout.contestants import Contestant, chosen, contestants
from sdp_vs_penalty.shootout.instances import Instance
from sdp_vs_penalty.shootout.judge import (
    Answer,
    Judgement,
    Reference,
    judge,
    reference,
)

Row = dict[str, Any]
#: Every column, and what its cells are. Numbers have all their digits: what was proved
#: is written.
COLUMNS: dict[str, type] = (
    dict.fromkeys(("problem", "group", "hash", "solver", "settings"), str)
    | {"accuracy": float}
    | dict.fromkeys(("claimed", "status", "class"), str)
    | dict.fromkeys(
        ("objective_error", "violation", "own_gap", "lower", "upper"), float
    )
    | {"seconds": float, "attempts": int}
    | dict.fromkeys(("version", "machine", "remark"), str)
)
#: What makes a run the same run.
KEY = ["problem", "hash", "solver", "settings"]
_ORDER = {
    "by": ["group", "problem", "solver", "accuracy"],
    "ascending": [True, True, True, False],
}


class Results:
    """The runs of one output folder: runs.csv is written anew, whole or not at all,
    after each.

    Raises InputError where the folder holds other results.
    """

    def __init__(self, folder: Path) -> None:
        self.path, self.runs = folder / "runs.csv", _frame([])
        if self.path.exists():
            self.runs = _read(self.path)
        elif any(
            not p.name.startswith((".", "references.json")) for p in folder.glob("*")
        ):
            what = "holds other files and no runs.csv"
            raise InputError(what, "give --out an empty or a new folder", folder)

    def add(self, rows: list[Row]) -> None:
        """Add runs.

        Parameters
        ----------
        rows : list of dict
            Runs.

        Returns
        -------
        None
            They are on the disk then.
        """
        both = [self.runs, _frame(rows)] if len(self.runs) else [_frame(rows)]
        self._write(pandas.concat(both, ignore_index=True))

    def keep(self, current: dict[str, str]) -> int:
        """Drop runs of instances whose hash has changed.

        Parameters
        ----------
        current : dict of str to str
            Hash by problem name.

        Returns
        -------
        int
            How many runs were dropped.
        """
        before = len(self.runs)
        is_current = self.runs["problem"].map(current)
        self._write(self.runs[is_current.isna() | (is_current == self.runs["hash"])])
        return before - len(self.runs)

    def _write(self, runs: pandas.DataFrame) -> None:
        self.runs = runs.sort_values(**_ORDER, ignore_index=True)
        write_text(self.path, self.runs.to_csv(index=False, lineterminator="\n"))


def _frame(rows: list[Row]) -> pandas.DataFrame:
    return pandas.DataFrame(rows, columns=list(COLUMNS)).astype(COLUMNS)


def _read(path: Path) -> pandas.DataFrame:
    text = read_text(path, is_own=True)
    if (head := text.partition("\n")[0].strip()) != ",".join(COLUMNS):
        what = f"holds the results of something else (its columns are {head[:60]}...)"
        raise InputError(what, "give --out another folder", path)
    try:
        # As text first: an empty cell is no number, and "None" or "nan" are texts.
        return pandas.read_csv(
            io.StringIO(text),
            dtype=str,
            keep_default_na=False,
        ).astype(COLUMNS)
    except ValueError as error:
        remedy = "delete it, and its run is done again"
        raise InputError(f"a row is damaged ({error})", remedy, path) from None


@dataclass(frozen=True)
class Assignment:
    """Runs of one solver on one problem, or (solver "") the proof of the problem's
    interval.

    time_limit [s] and memory [GB] are for each run, or the proof."""

    problem: str
    hash: str
    time_limit: float
    memory: float
    solver: str = ""
    accuracies: tuple[float, ...] = ()
    reference: Reference | None = None


def perform(task: Assignment) -> list[Row]:
    """Do an assignment here; what a worker of any kind calls.

    Parameters
    ----------
    task : Assignment
        What is to be done.

    Returns
    -------
    list of dict
        One row for each run.

    Raises
    ------
    InputError
        Where its instance is another one.
    """
    problem_instance = instance(task.problem)
    if problem_instance.hash != task.hash:
        what = (
            f"it is {problem_instance.hash} on one machine and {task.hash} on another"
        )
        remedy = "use the same version and data on all machines"
        raise InputError(what, remedy, f"instance {task.problem!r}")
    # Work that belongs to no contestant: done before the fork, so that children have
    # it.
    _ = (
        problem_instance.interior,
        problem_instance.constraints.groups,
        problem_instance.task.ols,
    )
    if not task.solver:
        kind, reference_found, _ = in_child(
            lambda: reference(problem_instance),
            task.time_limit,
            task.memory,
        )
        remark = "" if kind == "ended" else f"{kind} {reference_found}".strip()
        reference_found = (
            Reference("unknown", -np.inf, np.inf, 1.0) if remark else reference_found
        )
        return [
            {
                "hash": problem_instance.hash,
                "reference": asdict(reference_found),
                "remark": remark,
            }
        ]
    _ = problem_instance.sdp
    contestant = contestants()[task.solver]
    stopped = ""
    rows = list[Row]()
    contestant.warm_up()  # what a first use pays for
    for accuracy in task.accuracies:
        rows.append(run_one(task, contestant, problem_instance, accuracy, stopped))
        stopped = stopped or (
            rows[-1]["settings"] if rows[-1]["class"] == "timeout" else ""
        )
    return rows


def run_one(
    task: Assignment,
    contestant: Contestant,
    problem_instance: Instance,
    accuracy: float,
    stopped: str = "",
) -> Row:
    """Run a contestant once and judge its answer.

    Seconds are processor time, programs that it ran included (machines are shared).

    Parameters
    ----------
    task : Assignment
        With the proved interval.
    contestant : Contestant
        Who runs.
    problem_instance : Instance
        Which problem.
    accuracy : float
        Asked for.
    stopped : str
        A looser setting that exceeded the limit; empty: none.

    Returns
    -------
    dict
        A row of runs.csv.
    """
    assert task.reference is not None

    def timed() -> tuple[Answer, float]:
        used = _processor()
        answer = contestant.solve(problem_instance, accuracy)
        return answer, _processor() - used

    remark = f"not run: {stopped} exceeded the time limit" if stopped else ""
    ended: tuple[str, Any, float] = "timeout", "", task.time_limit
    kind, outcome, seconds = (
        ended if stopped else in_child(timed, task.time_limit, task.memory)
    )
    if kind == "ended" and (seconds := outcome[1]) > task.time_limit:
        kind = "timeout"
        outcome = f"took {seconds:.2g} s of processor time"
    if kind == "ended":
        answer = outcome[0]
        verdict = judge(problem_instance, task.reference, outcome[0], accuracy)
    else:
        answer = Answer(np.empty(0), "", outcome, attempts=0)
        verdict = Judgement(kind, remark=remark)
    row = {
        "settings": contestant.settings(accuracy),
        "accuracy": accuracy,
        "class": verdict.kind,
    }
    row |= {
        "claimed": answer.claims,
        "status": " ".join(answer.status.split()),
        "seconds": seconds,
    }
    return {**asdict(verdict), **row, "attempts": answer.attempts}


def _processor() -> float:
    """Processor time of this process and of the programs that it ran [s]."""
    programs = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + programs.ru_utime + programs.ru_stime


#: Of a quick shootout: the accuracies asked for, and processor time of each run [s].
QUICK_ACCURACIES = (1e-6,)
QUICK_TIME_LIMIT = 1.0


@dataclass(frozen=True)
class Shootout:
    """What to run and how. solvers, problems : names, None: all; time_limit [s] and
    memory [GB] are for each run, proof_limit [s] for each proof of an interval, which
    no run's limit is to end.

    Raises InputError for settings that make no sense, and on Windows.
    """

    out: Path
    solvers: list[str] | None = None
    problems: list[str] | None = None
    accuracies: tuple[float, ...] = (1e-4, 1e-6, 1e-8)
    time_limit: float = 60.0
    memory: float = 4.0
    quick: bool = False
    scheduler: str | None = None
    jobs: int = 0
    proof_limit: float = 900.0

    def __post_init__(self) -> None:
        if not self.accuracies or any(not 1e-14 < a < 1.0 for a in self.accuracies):
            what = "--accuracy takes numbers between 1e-14 and 1"
            raise InputError(what, "separate them by commas: 1e-4,1e-8")
        if not self.time_limit > 0.0 or not self.memory > 0.0:
            raise InputError("--time-limit or --memory is not above 0", "correct it")
        if not hasattr(os, "fork"):
            raise InputError(
                "The shootout forks a process for each run", "use Linux or macOS"
            )


@dataclass(frozen=True)
class Outcome:
    """The folder's runs after a shootout, and what was left out: why, by name."""

    results: Results
    absent: dict[str, str]
    not_applicable: list[tuple[str, str, str]]  # problem, solver, reason
    notes: list[str]


def run(setup: Shootout, say: Progress = no_progress) -> Outcome:
    """Do every run that the folder does not hold yet.

    Parameters
    ----------
    setup : Shootout
        What to run and how.
    say : callable
        Hears what is done, of how much.

    Returns
    -------
    Outcome
        The folder's runs, and what was left out.

    Raises
    ------
    InputError
        For names that do not exist, and where another shootout writes into the
        folder.
    """
    competing, missing = chosen(setup.solvers)
    if setup.quick and setup.solvers is None:
        competing = [c for c in competing if not c.is_certified]
    entries, unmeasured = selected(
        setup.problems,
        catalogue().values(),
        setup.quick,
    )
    absent = {c.name: str(c.absent) for c in missing}
    absent |= {
        e.name: "its measurements are absent (SDP_VS_PENALTY_DATA)" for e in unmeasured
    }
    workers = setup.jobs or os.cpu_count() or 1
    work = partial(spread, perform, scheduler=setup.scheduler, jobs=workers)
    with folder_lock(setup.out):
        results = Results(setup.out)
        notes = []
        references = _references(setup, entries, say, work)
        hashes = {name: proved["hash"] for name, proved in references.items()}
        if n_dropped := results.keep(hashes):
            notes.append(
                f"{n_dropped} runs of instances that have changed since were dropped"
            )
        tasks, not_applicable = _pending(setup, entries, competing, references, results)
        facts = _Facts(
            group_by_problem={e.name: e.group for e in entries},
            version_by_solver={c.name: c.version() for c in competing},
        )
        _perform_all(tasks, work, results, facts, say)
    return Outcome(results, absent, not_applicable, notes)


@dataclass(frozen=True)
class _Facts:
    """What rows of runs.csv say beside what a worker returns."""

    group_by_problem: Mapping[str, str]
    version_by_solver: Mapping[str, str]

    def of(self, task: Assignment) -> Row:
        """Cells of a run of an assignment."""
        assert task.reference is not None
        return {
            "problem": task.problem,
            "hash": task.hash,
            "solver": task.solver,
            "group": self.group_by_problem[task.problem],
            "version": self.version_by_solver[task.solver],
            "lower": task.reference.lower,
            "upper": task.reference.upper,
            "machine": (
                f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
            ),
        }


def _perform_all(
    tasks: Sequence[Assignment],
    work: Callable[..., Any],
    results: Results,
    facts: _Facts,
    say: Progress,
) -> None:
    """Do the assignments and keep each row as soon as it is there; say : hears how many
    of the runs are done, and about how long the others take."""
    n_done = 0
    total = sum(len(task.accuracies) for task in tasks)
    say(f"{n_done} of {total}: runs")
    begin = time.monotonic()
    for place, rows in work(tasks):
        task = tasks[place]
        cells = facts.of(task)
        results.add([row | cells for row in rows])
        n_done += len(rows)
        left = (time.monotonic() - begin) * (total - n_done) / max(n_done, 1)
        about_left = f", about {left:.0f} s left" if left >= 1.0 else ""
        say(f"{n_done} of {total}: {task.solver} on {task.problem}{about_left}")


def _references(
    setup: Shootout,
    entries: Sequence[Entry],
    say: Progress,
    work: Callable[..., Any],
) -> dict[str, dict[str, Any]]:
    """Each instance's hash and proved interval; kept in references.json beside the
    runs."""
    path = setup.out / "references.json"
    known = _known_references(path)
    current = {e.name: instance(e.name).hash for e in entries}
    assignments = [
        Assignment(name, key, setup.proof_limit, setup.memory)
        for name, key in current.items()
        if known.get(name, {}).get("hash") != key
    ]
    total = len(assignments)
    say(f"0 of {total}: proving intervals")
    for done, (place, (row,)) in enumerate(work(assignments), start=1):
        name = assignments[place].problem
        known[name] = row
        write_text(path, json.dumps(known, indent=1, sort_keys=True) + "\n")
        say(f"{done} of {total}: proving intervals: {name}")
    return {name: known[name] for name in current}


def _known_references(path: Path) -> dict[str, dict[str, Any]]:
    """What references.json holds; nothing where there is none. Raises InputError for
    what no shootout has written."""
    if not path.exists():
        return {}
    try:
        document = json.loads(
            read_text(path, is_own=True), object_pairs_hook=unique_fields
        )
        return {name: _require_reference(entry) for name, entry in document.items()}
    except (
        AttributeError,
        LookupError,
        RecursionError,
        TypeError,
        ValueError,
    ) as error:
        raise InputError(
            f"holds no intervals of a shootout ({error})",
            "delete it, and the intervals are proved again",
            path,
        ) from None


def _require_reference(entry: Any) -> dict[str, Any]:
    """An entry of references.json; LookupError or TypeError where it is none."""
    known = Reference(**entry["reference"])
    texts = (entry["hash"], entry["remark"], known.verdict)
    numbers = (known.lower, known.upper, known.scale)
    if not all(isinstance(text, str) for text in texts):
        raise TypeError("a text is missing")
    if not all(isinstance(number, float) for number in numbers):
        raise TypeError("a number is missing")
    return dict(entry)


def _pending(
    setup: Shootout,
    entries: Sequence[Entry],
    competing: Sequence[Contestant],
    references: dict[str, dict[str, Any]],
    results: Results,
) -> tuple[list[Assignment], list[tuple[str, str, str]]]:
    done = set(results.runs[KEY].itertuples(index=False, name=None))
    tasks = list[Assignment]()
    left_out = list[tuple[str, str, str]]()
    for entry, contestant in product(entries, competing):
        if reason := contestant.refuses(instance(entry.name)):
            left_out.append((entry.name, contestant.name, reason))
            continue
        row = references[entry.name]
        what = (entry.name, row["hash"], contestant.name)
        new = [
            accuracy
            for accuracy in contestant.asked(setup.accuracies)
            if (*what, contestant.settings(accuracy)) not in done
        ]
        if new:
            tasks.append(
                Assignment(
                    problem=entry.name,
                    hash=row["hash"],
                    time_limit=setup.time_limit,
                    memory=setup.memory,
                    solver=contestant.name,
                    accuracies=tuple(new),
                    reference=Reference(**row["reference"]),
                )
            )
    return tasks, left_out


def in_child(
    work: Callable[[], Any],
    limit: float,
    memory: float,
) -> tuple[str, Any, float]:
    """Fork and work.

    Parameters
    ----------
    work : callable
        What is done.
    limit : float
        Seconds of processor time, and four times as many by the clock, because
        machines are shared.
    memory : float
        GB beyond what the parent already has.

    Returns
    -------
    tuple of (str, Any, float)
        "ended", the result and seconds; or "failed", "timeout" or "crash",
        words and seconds.
    """
    reader, writer = Pipe(duplex=False)
    start = time.monotonic()
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        _child(work, writer, limit, memory, parent)
    writer.close()
    ended = 0
    status = 0
    answer = None
    # Not by the pipe's end alone: a child of another thread may hold that open.
    while (
        not ended and not reader.poll(0.05) and time.monotonic() - start < 4.0 * limit
    ):
        ended, status = os.waitpid(child, os.WNOHANG)
    seconds = time.monotonic() - start
    if reader.poll():
        with contextlib.suppress(EOFError):  # it has died
            answer = reader.recv()
    elif not ended:
        answer = "timeout", f"stopped after {seconds:.0f} s"
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
    if not ended:
        _, status = os.waitpid(child, 0)
    reader.close()
    if answer is None:
        number = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
        answer = "crash", f"ended by signal {number}" if number else ""
        if number == signal.SIGXCPU:
            answer = "timeout", f"stopped after {limit:g} s of processor time"
    return *answer, seconds


def _child(
    work: Callable[[], Any],
    writer: Connection,
    limit: float,
    memory: float,
    parent: int,
) -> None:
    """In the forked process, which ends here."""
    try:
        os.setsid()  # a group of its own, so that programs it starts are killed with it
        end_with(parent)
        os.environ["RAYON_NUM_THREADS"] = "1"  # runs share the machine
        silence = os.open(os.devnull, os.O_WRONLY)  # solvers print
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        used = resource.getrusage(resource.RUSAGE_SELF)
        whole_seconds = math.ceil(
            used.ru_utime + used.ru_stime + limit
        )  # whole seconds: the kernel's grain
        resource.setrlimit(resource.RLIMIT_CPU, (whole_seconds, whole_seconds + 2))
        try:  # the address space in use, where the system says it
            pages = int(Path("/proc/self/statm").read_text("utf-8").split()[0])
            size = pages * resource.getpagesize() + int(memory * 1e9)
        except OSError:
            size = int(8e9 + memory * 1e9)
        resource.setrlimit(resource.RLIMIT_AS, (size, size))
        writer.send(("ended", work()))
    except MemoryError:
        writer.send(("crash", f"asked for more than {memory:g} GB"))
    except TimeoutError as error:  # a solver's program used up the processor time
        writer.send(("timeout", str(error)))
    except ChildProcessError as error:  # a solver's program died by a signal
        writer.send(("crash", str(error)))
    except BaseException as error:  # a Rust panic is not an Exception
        writer.send(("failed", f"{type(error).__name__}: {error}"[:2000]))
    finally:
        os._exit(0)
