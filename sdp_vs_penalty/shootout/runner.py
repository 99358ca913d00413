"""The shootout from names to runs.csv: proofs of the instances' intervals first, then
every run.

runs.csv has one row a solver, problem and settings, written as runs end, read back to go
on where a shootout stopped. A task is all accuracies of one solver on one problem, from
loose to tight: what exceeds the time limit at one would exceed it at every tighter one.
The worker builds the instance, forks for each repetition of a run, which ends by itself,
the clock, its memory or a signal, and judges the numbers that come back.
"""

import bisect
import contextlib
import csv
import io
import json
import math
import os
import platform
import resource
import signal
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from itertools import product
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.files import folder_lock, read_text, unique_fields, write_text
from sdp_vs_penalty.parallel import end_with, spread
from sdp_vs_penalty.records import JsonRecord, from_json, to_json
from sdp_vs_penalty.shootout.catalogue import NO_MEASUREMENTS, Entry, instance, selected
from sdp_vs_penalty.shootout.contestants import Contestant, chosen, contestants
from sdp_vs_penalty.shootout.instances import Instance
from sdp_vs_penalty.shootout.judge import Answer, Judgement, Reference, judge, reference

Row = dict[str, Any]
#: Type of each column. Numbers are written with all their digits, so that a file holds
#: exactly the interval that was proved.
COLUMNS: dict[str, type] = (
    dict.fromkeys(("problem", "set", "robot", "hash", "solver", "version"), str)
    | {"settings": str, "time_limit": float, "accuracy": float}
    | dict.fromkeys(("claimed", "status", "outcome"), str)
    | dict.fromkeys(("error", "objective_error", "violation", "own_gap"), float)
    | {f"dimacs_{k}": float for k in range(1, 7)}
    | dict.fromkeys(("lower", "upper", "scale"), float)
    | dict.fromkeys(("seconds", "seconds_least", "seconds_most"), float)
    | {"form_seconds": float, "file_seconds": float, "repeats": int, "attempts": int}
    | dict.fromkeys(("machine", "remark"), str)
)
#: What makes a run the same run.
KEY = ["problem", "hash", "solver", "version", "settings", "time_limit"]


class Results:
    """The runs of one output folder: runs.csv is written anew, whole or not at all,
    after each.

    Raises InputError where the folder holds other results.
    """

    def __init__(self, folder: Path) -> None:
        """Open an output folder, and read the runs that it holds already.

        Raises InputError if the folder holds other files but no runs.csv.
        """
        self.path = folder / "runs.csv"
        self._runs: list[Row] = []
        if self.path.exists():
            self._runs = sorted(_read(self.path).to_dict("records"), key=_order)
            return
        harmless = (".", "references.json")
        if any(not path.name.startswith(harmless) for path in folder.glob("*")):
            what = "holds other files and no runs.csv"
            raise InputError(what, "give --out an empty or a new folder", folder)

    @property
    def runs(self) -> pandas.DataFrame:
        """All runs, with the columns of runs.csv."""
        return pandas.DataFrame(self._runs, columns=list(COLUMNS)).astype(COLUMNS)

    def add(self, rows: list[Row]) -> None:
        """Add runs, and write them to the disk at once."""
        for row in rows:
            cells = {name: kind(row[name]) for name, kind in COLUMNS.items()}
            bisect.insort(self._runs, cells, key=_order)
        self._write()

    def drop_outdated(self, is_current: Callable[[Row], bool]) -> int:
        """Drop the runs that would be other runs now; return how many."""
        before = len(self._runs)
        self._runs = [run for run in self._runs if is_current(run)]
        self._write()
        return before - len(self._runs)

    def _write(self) -> None:
        """Rewrite runs.csv atomically: a crash leaves the old file whole."""
        text = io.StringIO()
        lines = [COLUMNS, *(run.values() for run in self._runs)]
        csv.writer(text, lineterminator="\n").writerows(lines)
        write_text(self.path, text.getvalue())


def _order(run: Row) -> tuple[str, str, str, float]:
    """Return the set, problem, solver and negative accuracy of a run, by which runs are
    sorted."""
    return run["set"], run["problem"], run["solver"], -run["accuracy"]


def _read(path: Path) -> pandas.DataFrame:
    """Read runs.csv. Raises InputError for other columns, or a damaged row."""
    text = read_text(path, is_own=True)
    head = text.partition("\n")[0].strip()
    if head != ",".join(COLUMNS):
        what = f"holds the results of something else (its columns are {head[:60]}...)"
        raise InputError(what, "give --out another folder", path)
    try:
        # As text first: an empty cell is no number, and "None" or "nan" are texts.
        return pandas.read_csv(
            io.StringIO(text), dtype=str, keep_default_na=False
        ).astype(COLUMNS)
    except ValueError as error:
        remedy = "delete it, and its run is done again"
        raise InputError(f"a row is damaged ({error})", remedy, path) from None


@dataclass(frozen=True)
class Assignment:
    """Runs of one solver on one problem, or the proof of the problem's interval."""

    #: Name of the problem.
    problem: str
    #: Hash of the problem.
    hash: str
    #: Processor time of each repetition, or of the proof [s].
    time_limit: float
    #: Memory of each repetition, or of the proof [GB].
    memory: float
    #: Name of the solver; "": the proof.
    solver: str = ""
    #: Relative accuracies to ask for, from loose to tight.
    accuracies: tuple[float, ...] = ()
    #: Proved interval of the optimum; None for the proof.
    reference: Reference | None = None
    #: Number of repetitions of each run.
    repeats: int = 1


def perform(task: Assignment) -> list[Any]:
    """Do an assignment in this process; workers of any kind call this.

    Parameters
    ----------
    task : Assignment
        Runs of one solver on one problem at several accuracies, from loose to tight;
        or, without a solver, the proof of the problem's interval.

    Returns
    -------
    list
        A row of runs.csv for each accuracy, or what was Proved.

    Raises
    ------
    InputError
        If the instance built here differs from the one that was assigned.
    """
    problem_instance = instance(task.problem)
    if problem_instance.hash != task.hash:
        what = (
            f"it is {problem_instance.hash} on one machine and {task.hash} on another"
        )
        remedy = "use the same version and data on all machines"
        raise InputError(what, remedy, f"instance {task.problem!r}")
    # Cached properties are computed before the fork, so that every child has them: they
    # are no work of a contestant, and not part of its time.
    _ = (
        problem_instance.interior,
        problem_instance.constraints.groups,
        problem_instance.task.ols,
    )
    if not task.solver:
        kind, outcome, _ = in_child(
            lambda: reference(problem_instance), task.time_limit, task.memory
        )
        if kind == "ended":
            return [Proved(task.hash, outcome)]
        return [Proved(task.hash, Reference("unknown"), f"{kind} {outcome}".strip())]
    _ = problem_instance.sdp
    # One thread: runs share the machine, and a forked child does not have the threads
    # that a first call has started.
    os.environ["RAYON_NUM_THREADS"] = "1"
    contestant = _warm(task.solver)
    form_seconds = 0.0
    if contestant.takes_conic_form:
        used = time.process_time()
        # A copy has no cached properties: it finds an interior point and the form.
        _ = replace(problem_instance).sdp
        form_seconds = time.process_time() - used
    stopped = ""
    rows = list[Row]()
    for accuracy in task.accuracies:
        row = run_one(task, contestant, problem_instance, accuracy, stopped)
        rows.append(row | {"form_seconds": form_seconds})
        if row["outcome"] == "timeout" and not stopped:
            stopped = row["settings"]
    return rows


@cache
def _warm(name: str) -> Contestant:
    """Return a contestant once this process has paid for what only a first call costs."""
    contestant = contestants()[name]
    with warnings.catch_warnings(action="ignore"):
        contestant.warm_up()
    return contestant


@dataclass(frozen=True)
class Proved(JsonRecord):
    """What is known of an instance before any run, as references.json holds it."""

    #: Hash of the instance.
    hash: str
    #: Proved interval of the optimum.
    reference: Reference
    #: Why the proof failed; "" where it did not.
    remark: str = ""


def run_one(
    task: Assignment,
    contestant: Contestant,
    problem_instance: Instance,
    accuracy: float,
    stopped: str = "",
) -> Row:
    """Run a contestant in child processes, and judge its answers.

    The time that counts is processor time, with that of programs that the contestant
    runs and without its files, because other runs share the machine. There are as many
    repetitions as the task says, or fewer once they took REPEAT_SECONDS together: the
    row has the median, the least and the largest time, and the worst answer.

    Parameters
    ----------
    task : Assignment
        The assignment, with the proved interval of the optimum.
    accuracy : float
        Relative accuracy that is asked for.
    stopped : str
        A looser setting that exceeded the time limit, or "". With one the run is not
        done, because it would exceed the limit, too.
    """
    proved = task.reference
    assert proved is not None

    def timed() -> tuple[Answer, float]:
        """Solve, and return the answer with the processor time that it took [s]."""
        used = _processor()
        answer = contestant.solve(problem_instance, accuracy)
        return answer, _processor() - used

    def repetition() -> tuple[Judgement, Answer, float]:
        """Run once in a child; return verdict, answer and the seconds that count."""
        kind, seconds = "timeout", task.time_limit
        outcome: Any = f"not run: {stopped} exceeded the time limit"
        if not stopped:
            kind, outcome, seconds = in_child(timed, task.time_limit, task.memory)
        if kind == "ended":
            answer, used = outcome
            seconds = used - answer.file_seconds
            if seconds <= task.time_limit:
                return judge(problem_instance, proved, answer), answer, seconds
            # A program's limit is whole seconds: it may end later than at ours.
            kind, outcome = "timeout", f"took {seconds:.2g} s of processor time"
        if kind == "timeout":  # what the clock showed is no processor time
            seconds = task.time_limit
        return Judgement(kind), Answer(np.empty(0), "", outcome, attempts=0), seconds

    row: Row = {"settings": contestant.settings(accuracy), "accuracy": accuracy}
    times = list[float]()
    worst: tuple[Judgement, Answer] | None = None
    while (
        len(times) < task.repeats
        and np.median(times or 0.0) * len(times) < REPEAT_SECONDS
    ):
        verdict, answer, seconds = repetition()
        times.append(seconds)
        if worst is None or not verdict.error <= worst[0].error:
            worst = verdict, answer
        if verdict.outcome != "claim":
            break  # what failed, or says that it did, fails again
    assert worst is not None
    return row | figures(*worst, times)


def figures(verdict: Judgement, answer: Answer, times: Sequence[float]) -> Row:
    """Return the cells of runs.csv about an answer and its repetitions' times [s]."""
    cells = asdict(verdict)
    dimacs = enumerate(cells.pop("dimacs"), start=1)
    return {
        **cells,
        **{f"dimacs_{k}": error for k, error in dimacs},
        "claimed": answer.claims,
        "status": " ".join(answer.status.split()),
        "seconds": float(np.median(times)),
        "seconds_least": min(times),
        "seconds_most": max(times),
        "form_seconds": 0.0,
        "file_seconds": answer.file_seconds,
        "repeats": len(times),
        "attempts": answer.attempts,
    }


def _processor() -> float:
    """Return the processor time [s] used so far by this process and by the programs
    that it has run and that have ended.
    """
    # Not time.process_time: while a timer of processor time runs, Linux updates that
    # clock at its ticks only, milliseconds apart.
    whose = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    usages = map(resource.getrusage, whose)
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


#: A run is not repeated once its repetitions took so long together [s].
REPEAT_SECONDS = 1.0
#: Of a quick shootout: the accuracies asked for, and processor time of each run [s].
#: Solvers that get its small problems right need less than .4 s there, or seconds.
QUICK_ACCURACIES = (1e-6,)
QUICK_TIME_LIMIT = 0.5
#: Longest time on the clock of a run, over its processor time: machines are shared.
#: Short runs may wait so many seconds.
CLOCK_FACTOR = 4.0
CLOCK_AT_LEAST = 3.0


@dataclass(frozen=True)
class Shootout:
    """What to run and how."""

    #: Folder of runs.csv; runs that it holds are not repeated.
    out: Path
    #: Names of the solvers; None: all that are installed.
    solvers: list[str] | None = None
    #: Names or tags of the problems; None: the declared ones.
    problems: list[str] | None = None
    #: Relative accuracies to ask for.
    accuracies: tuple[float, ...] = (1e-4, 1e-6, 1e-8)
    #: Processor time of each repetition of a run [s].
    time_limit: float = 5.0
    #: Memory of each repetition of a run, and of each proof [GB].
    memory: float = 4.0
    #: Whether only a few instances run.
    quick: bool = False
    #: Address of a scheduler that spreads the runs over computers; None: this one.
    scheduler: str | None = None
    #: Number of parallel runs on this computer; 0: one per core.
    jobs: int = 0
    #: Number of repetitions of each run.
    repeats: int = 5
    #: Processor time of each proof of an interval [s], which no run's limit is to end.
    proof_limit: float = 900.0

    def __post_init__(self) -> None:
        """Raise InputError for settings that make no sense, or a system without
        fork.
        """
        if not self.accuracies or any(not 1e-14 < a < 1.0 for a in self.accuracies):
            what = "--accuracy takes numbers between 1e-14 and 1"
            raise InputError(what, "separate them by commas: 1e-4,1e-8")
        if not self.time_limit > 0.0:
            raise InputError("--time-limit is not above 0", "correct it")
        if self.repeats < 1:
            raise InputError("--repeats is below 1", "correct it")
        if not hasattr(os, "fork"):
            raise InputError(
                "The shootout forks a process for each run", "use Linux or macOS"
            )


@dataclass(frozen=True)
class Outcome:
    """The folder's runs after a shootout, and what was left out: why, by name."""

    #: Every run of the folder.
    results: Results
    #: Why a solver or problem was left out, by its name.
    absent: dict[str, str]
    #: Problem, solver, and why the one cannot be posed to the other.
    not_applicable: list[tuple[str, str, str]]
    #: Sentences on runs that were dropped.
    notes: list[str]


def run(setup: Shootout, say: Progress = no_progress) -> Outcome:
    """Do every run of the shootout that the output folder does not hold yet.

    Parameters
    ----------
    setup : Shootout
        Which solvers, problems and accuracies, and their limits.
    say : callable
        Called with the progress, a short text each time.

    Returns
    -------
    Outcome
        All runs of the folder, and what was left out.

    Raises
    ------
    InputError
        For an unknown name, or if another shootout writes into the folder.
    """
    competing, missing = chosen(setup.solvers)
    entries, unmeasured = selected(setup.problems, setup.quick)
    absent = {c.name: str(c.absent) for c in missing}
    absent |= {e.name: NO_MEASUREMENTS for e in unmeasured}
    workers = setup.jobs or os.cpu_count() or 1
    work = partial(spread, perform, scheduler=setup.scheduler, jobs=workers)
    with folder_lock(setup.out):
        results = Results(setup.out)
        notes = []
        references = proved_intervals(setup, entries, say, work)
        facts = Facts(
            entry_by_name={e.name: e for e in entries},
            version_by_solver={c.name: c.version() for c in competing},
        )
        if n_dropped := results.drop_outdated(
            partial(_is_current, setup, competing, references, facts)
        ):
            notes.append(
                f"{n_dropped} runs were dropped: the instance, the solver's version, its"
                " settings or the time limit are other ones now"
            )
        tasks, not_applicable = _pending(setup, entries, competing, references, results)
        n_done = 0
        total = sum(len(task.accuracies) for task in tasks)
        say(f"{n_done} of {total}: runs")
        begin = time.monotonic()
        for place, rows in work(tasks):
            task = tasks[place]
            cells = facts.find_row(task)
            results.add([row | cells for row in rows])
            n_done += len(rows)
            seconds_left = (
                (time.monotonic() - begin) * (total - n_done) / max(n_done, 1)
            )
            about_left = (
                f", about {seconds_left:.0f} s left" if seconds_left >= 1.0 else ""
            )
            say(f"{n_done} of {total}: {task.solver} on {task.problem}{about_left}")
    return Outcome(results, absent, not_applicable, notes)


@dataclass(frozen=True)
class Facts:
    """What rows of runs.csv say beside what a worker returns."""

    #: Entry of the catalogue of each problem, by its name.
    entry_by_name: Mapping[str, Entry]
    #: Version of each solver, by its name.
    version_by_solver: Mapping[str, str]

    def find_row(self, task: Assignment) -> Row:
        """Return the cells of runs.csv that all runs of an assignment share."""
        assert task.reference is not None
        return {
            "problem": task.problem,
            "hash": task.hash,
            "solver": task.solver,
            "set": self.entry_by_name[task.problem].set,
            "robot": self.entry_by_name[task.problem].robot,
            "time_limit": task.time_limit,
            "version": self.version_by_solver[task.solver],
            "lower": task.reference.lower,
            "upper": task.reference.upper,
            "scale": task.reference.scale,
            "machine": (
                f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
            ),
        }


def _is_current(
    setup: Shootout,
    competing: Sequence[Contestant],
    references: Mapping[str, Proved],
    facts: Facts,
    row: Row,
) -> bool:
    """Return whether a row of runs.csv is what this shootout would write.

    Solvers and problems that do not take part are not compared.
    """
    proved = references.get(row["problem"])
    if proved is not None and proved.hash != row["hash"]:
        return False
    contestant = next((c for c in competing if c.name == row["solver"]), None)
    if contestant is None:
        return True
    current = (
        facts.version_by_solver[contestant.name],
        contestant.settings(row["accuracy"]),
        setup.time_limit,
    )
    has_all_repetitions = (
        row["repeats"] >= setup.repeats
        or row["seconds"] * row["repeats"] >= REPEAT_SECONDS
        or row["outcome"] != "claim"
    )
    is_same = current == (row["version"], row["settings"], row["time_limit"])
    return is_same and has_all_repetitions


def proved_intervals(
    setup: Shootout, entries: Sequence[Entry], say: Progress, work: Callable[..., Any]
) -> dict[str, Proved]:
    """Return hash and proved interval of each instance, and prove those that are
    missing.

    Proofs are stored in references.json of the output folder, after each.

    Parameters
    ----------
    setup : Shootout
        Output folder, and limits of each proof.
    say : callable
        Called with the number of proofs done.
    work : callable
        Spreads assignments over workers; yields the index and the rows of each that is
        done.
    """
    path = setup.out / "references.json"
    known = _known_references(path)
    current = {e.name: instance(e.name).hash for e in entries}
    assignments = [
        Assignment(name, key, setup.proof_limit, setup.memory)
        for name, key in current.items()
        if name not in known or known[name].hash != key
    ]
    total = len(assignments)
    say(f"0 of {total}: proving intervals")
    for done, (place, (row,)) in enumerate(work(assignments), start=1):
        name = assignments[place].problem
        known[name] = row
        write_text(path, json.dumps(to_json(known), indent=1, sort_keys=True) + "\n")
        say(f"{done} of {total}: proving intervals: {name}")
    return {name: known[name] for name in current}


def _known_references(path: Path) -> dict[str, Proved]:
    """Read references.json, by instance; empty if there is no file.

    Raises InputError if its content is not what a shootout writes.
    """
    if not path.exists():
        return {}
    try:
        text = read_text(path, is_own=True)
        document = json.loads(text, object_pairs_hook=unique_fields)
        return from_json(dict[str, Proved], document)
    except (InputError, RecursionError, ValueError) as error:
        raise InputError(
            f"holds no intervals of a shootout ({error})",
            "delete it, and the intervals are proved again",
            path,
        ) from None


def _pending(
    setup: Shootout,
    entries: Sequence[Entry],
    competing: Sequence[Contestant],
    references: Mapping[str, Proved],
    results: Results,
) -> tuple[list[Assignment], list[tuple[str, str, str]]]:
    """List the assignments whose runs the output folder does not hold yet.

    Parameters
    ----------
    results : Results
        The runs that the folder holds.

    Returns
    -------
    list of Assignment
        One for each problem and solver with missing runs.
    list of (str, str, str)
        Problem, solver, and the reason why the problem cannot be posed to the solver.
    """
    # Whatever the folder still holds of these is current.
    same = ["problem", "solver", "settings"]
    done = set(results.runs[same].itertuples(index=False, name=None))
    tasks = list[Assignment]()
    left_out = list[tuple[str, str, str]]()
    for entry, contestant in product(entries, competing):
        if reason := contestant.refuses(instance(entry.name)):
            left_out.append((entry.name, contestant.name, reason))
            continue
        proved = references[entry.name]
        key = (entry.name, contestant.name)
        new = [
            accuracy
            for accuracy in contestant.asked(setup.accuracies)
            if (*key, contestant.settings(accuracy)) not in done
        ]
        if new:
            tasks.append(
                Assignment(
                    problem=entry.name,
                    hash=proved.hash,
                    time_limit=setup.time_limit,
                    memory=setup.memory,
                    solver=contestant.name,
                    accuracies=tuple(new),
                    reference=proved.reference,
                    repeats=setup.repeats,
                )
            )
    return tasks, left_out


def in_child(
    work: Callable[[], Any], limit: float, memory: float
) -> tuple[str, Any, float]:
    """Do some work in a forked child process with limits on time and memory.

    Parameters
    ----------
    work : callable
        The work; its result must be picklable.
    limit : float
        Processor time [s]; the clock may show more (CLOCK_FACTOR), because machines are
        shared.
    memory : float
        Memory [GB] beyond what the parent process already uses.

    Returns
    -------
    tuple of (str, Any, float)
        "ended", the result and the seconds taken; or "failed", "timeout" or "crash", a
        message and the seconds.
    """
    reader, writer = Pipe(duplex=False)
    start = time.monotonic()
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        _child(work, writer, limit, memory, parent)  # never returns
    writer.close()
    ended = 0  # number of the child's process once it has ended
    status = 0  # of the ended process, as waitpid returns it
    answer = None
    # The pipe's end alone does not tell that the child has ended: a child of another
    # thread may hold it open.
    latest_end = start + max(CLOCK_FACTOR * limit, CLOCK_AT_LEAST)
    while not ended and not reader.poll(0.05) and time.monotonic() < latest_end:
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
        if number in (signal.SIGXCPU, signal.SIGPROF):
            answer = "timeout", f"stopped after {limit:g} s of processor time"
    return *answer, seconds


def _child(
    work: Callable[[], Any],
    writer: Connection,
    limit: float,
    memory: float,
    parent: int,
) -> None:
    """Run in the forked child process: set the limits, work, send the result, exit.

    The pipe gets ("ended", result), or a message with "crash", "timeout" or "failed".

    Parameters
    ----------
    work : callable
        The work; its result must be picklable.
    writer : Connection
        The pipe to the parent.
    limit : float
        Processor time [s] beyond what the process used before the fork.
    memory : float
        Memory [GB] beyond what the process already uses.
    parent : int
        Process number of the parent: the child ends with it.
    """
    try:
        os.setsid()  # a group of its own, so that programs it starts are killed with it
        end_with(parent)
        os.environ["RAYON_NUM_THREADS"] = "1"
        silence = os.open(os.devnull, os.O_WRONLY)  # solvers print
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        # The timer ends this process at its limit. Programs that it runs have no timer,
        # but a limit of whole seconds: the kernel warns by SIGXCPU, and kills two later.
        signal.signal(signal.SIGPROF, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_PROF, limit)
        used = resource.getrusage(resource.RUSAGE_SELF)
        whole_seconds = math.ceil(used.ru_utime + used.ru_stime + limit)
        resource.setrlimit(resource.RLIMIT_CPU, (whole_seconds, whole_seconds + 2))
        try:  # Linux tells how much address space is in use
            pages = int(Path("/proc/self/statm").read_text("utf-8").split()[0])
            size = pages * resource.getpagesize() + int(memory * 1e9)
        except OSError:  # elsewhere 8 GB are assumed
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
