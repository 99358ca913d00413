import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.data.parsing import numbers


def verb(
    solvers: str | None = None,
    problems: str | None = None,
    accuracy: str | None = None,
    time_limit: float | None = None,
    memory: float = 4.0,
    quick: bool = False,
    out: Path = Path("results/shootout"),
    scheduler: str | None = None,
    jobs: int = 0,
    export: Path | None = None,
    list_: bool = False,
) -> None:
    """Run SDP solvers on identification problems and judge each answer by a proved interval.

    With --export, write the instances as files that any solver reads, each with a proof.
    Example: sdp-vs-penalty shootout --quick --out shootout

    --solvers a,b,...: Solvers; default: all that are installed.
    --problems a,b,...: Groups or names of instances, see --list; default: all.
    --accuracy 1e-4,1e-8: Accuracies to ask for; default: 1e-4,1e-6,1e-8.
    --time-limit SECONDS: Processor time of each run; default: 60, quick 0.5.
    --memory GB: Memory of each run.
    --quick: A few instances, one accuracy, every solver by itself.
    --out: Folder; runs that it holds are not repeated.
    --jobs >=0: Parallel runs on this computer; 0: one per core.
    --export DIR: Folder for the instances as files with proofs; nothing runs.
    --list: List of instances and solvers.
    """
    from sdp_vs_penalty.shootout import runner, summary

    if list_:
        _list()
        return
    if export is not None:
        _export(export, _words(problems))
        return
    accuracies = runner.Shootout.accuracies
    if accuracy:
        accuracies = tuple(numbers("--accuracy", accuracy))
    elif quick:
        accuracies = runner.QUICK_ACCURACIES
    limit = time_limit
    if limit is None:
        limit = runner.QUICK_TIME_LIMIT if quick else runner.Shootout.time_limit
    setup = runner.Shootout(
        out,
        _words(solvers),
        _words(problems),
        accuracies,
        limit,
        memory,
        quick,
        scheduler,
        jobs,
    )
    absent = dict[str, str]()
    left_out = list[tuple[str, str, str]]()
    is_stopped = False
    with console.progress("proving intervals") as say, _terminated_as_interrupted():
        try:
            outcome = runner.run(setup, say)
            absent = outcome.absent
            left_out = outcome.not_applicable
            for note in outcome.notes:
                console.warn(note)
        except KeyboardInterrupt:
            is_stopped = True
    results = runner.Results(out)
    runs = results.runs
    if is_stopped and not len(runs):
        raise KeyboardInterrupt
    written = summary.write_summary(out, runs, limit, absent, left_out)
    if is_stopped:
        console.warn(
            f"stopped after {len(runs)} runs, which the summary is of; the same command"
            " goes on"
        )
    for sentence in summary.sentences(runs):
        console.say(sentence)
    for path in (results.path, *written):
        console.written(path)
    if is_stopped:
        raise SystemExit(130)


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """Make SIGTERM raise KeyboardInterrupt, as Ctrl-C does, while this runs."""
    process = os.getpid()

    def interrupt(number: int, frame: Any) -> None:
        if os.getpid() != process:  # a worker, forked meanwhile: its parent ends it
            os._exit(1)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _export(folder: Path, groups: list[str] | None) -> None:
    """Write the library of instances as files, of these groups only, if any are
    named.
    """
    from sdp_vs_penalty.shootout import catalogue, library

    entries, _ = catalogue.selected(groups, catalogue.library())
    with console.progress("writing instances") as say:
        rows = library.write_library(folder, entries, say)
    proved = sum(row["status"] != "not proved" for row in rows)
    console.say(f"{len(rows)} instances, {proved} with a proof")
    console.next_step(["verify", folder])
    console.written(folder / "index.csv")


def _list() -> None:
    """Print the shootout's instances, and its solvers."""
    from sdp_vs_penalty.results.table import Table
    from sdp_vs_penalty.shootout.catalogue import catalogue
    from sdp_vs_penalty.shootout.contestants import contestants

    rows = [(e.name, e.group, "quick" if e.quick else "") for e in catalogue().values()]
    console.table(Table(("instance", "group", ""), rows, words=(0, 1, 2)))
    people = [
        (c.name, c.absent or "here", c.description) for c in contestants().values()
    ]
    heads = ("solver", "here", "what it is")
    console.table(Table(heads, people, words=(0, 1, 2)))


def _words(text: str | None) -> list[str] | None:
    """Split a comma-separated option into words; None if it was not given."""
    if text is None:
        return None
    return [word.strip() for word in text.split(",") if word.strip()]
