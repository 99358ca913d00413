from pathlib import Path
from typing import Any

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.data.parsing import numbers
from sdp_vs_penalty.errors import InputError, Terminated


def verb(
    words: list[str] | None = None,
    solvers: str | None = None,
    problems: str | None = None,
    accuracy: str | None = None,
    time_limit: float | None = None,
    repeats: int | None = None,
    quick: bool = False,
    out: Path = Path("results/shootout"),
    scheduler: str | None = None,
    jobs: int = 0,
    export: Path | None = None,
    list_: bool = False,
) -> None:
    """Run SDP solvers on identification problems and judge each answer by a proved interval.

    With --export, write the instances as files that any solver reads, each with a proof;
    `shootout judge ANSWERS.json` judges answers to these that were made elsewhere.
    Example: sdp-vs-penalty shootout --quick --out shootout

    words judge ANSWERS.json ...: Answers made elsewhere: {"answers": [...]}, each {"problem", "solver",
        "claimed", "x" (variables of problem.cbf) or "theta" [SI], "seconds"}; they enter --out.
    --solvers a,b,...: Solvers; default: all that are installed, by themselves.
    --problems a,b,...: Names or tags of instances, see --list; tags joined by + must all hold, such as
        tx40+measured; default: the declared sets.
    --accuracy 1e-4,1e-8: Accuracies to ask for; default: 1e-4,1e-6,1e-8.
    --time-limit SECONDS: Processor time of each run; default: 5, quick 0.5.
    --repeats >=1: Repetitions of each run, fewer once they took a second; default: 5, quick 1.
    --quick: A few instances, one accuracy.
    --out: Folder; runs that it holds are not repeated.
    --jobs >=0: Parallel runs on this computer; 0: one per core.
    --export DIR: Folder for the instances as files with proofs; nothing runs.
    --list: List of instances and solvers.
    """
    from sdp_vs_penalty.shootout import answers, runner

    if list_:
        _list()
        return
    if export is not None:
        _export(export, _words(problems))
        return
    if words:
        if words[0] != "judge" or len(words) < 2:
            what = f"`shootout {' '.join(words)}` is no command"
            raise InputError(what, "write `shootout judge ANSWERS.json`, or options")
        with console.progress("judging answers") as say:
            results = answers.judge_answers([Path(x) for x in words[1:]], out, say)
        _write(out, results, {}, [])
        return
    default = runner.Shootout
    accuracies = runner.QUICK_ACCURACIES if quick else default.accuracies
    if accuracy:
        accuracies = tuple(numbers("--accuracy", accuracy))
    if time_limit is None:
        time_limit = runner.QUICK_TIME_LIMIT if quick else default.time_limit
    setup = runner.Shootout(
        out,
        _words(solvers),
        _words(problems),
        accuracies,
        time_limit,
        quick=quick,
        scheduler=scheduler,
        jobs=jobs,
        repeats=repeats or (1 if quick else default.repeats),
    )
    absent = dict[str, str]()
    left_out = list[tuple[str, str, str]]()
    stopped: KeyboardInterrupt | None = None  # by Ctrl-C, or by SIGTERM
    with console.progress("proving intervals") as say:
        try:
            outcome = runner.run(setup, say)
            absent = outcome.absent
            left_out = outcome.not_applicable
            for note in outcome.notes:
                console.warn(note)
        except KeyboardInterrupt as ending:
            stopped = ending
    results = runner.Results(out)
    n_runs = len(results.runs)
    if stopped is not None and not n_runs:
        raise stopped
    if absent:
        console.warn(f"left out (summary.md says why): {', '.join(absent)}")
    _write(out, results, absent, left_out)
    if stopped is not None:
        console.warn(
            f"stopped after {n_runs} runs, which the summary is of; the same command"
            " goes on"
        )
        raise SystemExit(143 if isinstance(stopped, Terminated) else 130)


def _write(
    out: Path,
    results: Any,
    absent: dict[str, str],
    left_out: list[tuple[str, str, str]],
) -> None:
    """Write the summary of a folder's runs, and print its sentences."""
    from sdp_vs_penalty.shootout import summary

    if not len(results.runs):
        reasons = "; ".join(sorted({reason for _, _, reason in left_out}))
        console.warn(f"no run: {reasons}")
        return
    written = summary.write_summary(out, results.runs, absent, left_out)
    for sentence in summary.sentences(results.runs):
        console.say(sentence)
    for path in (results.path, *written):
        console.written(path)


def _export(folder: Path, words: list[str] | None) -> None:
    """Write instances as files: those that have these tags or names, by default all."""
    from sdp_vs_penalty.shootout import catalogue, library

    entries, absent = catalogue.selected(words or ["simulated", "measured"])
    with console.progress("writing instances") as say:
        rows = library.write_library(folder, entries, say)
    proved = sum(row["status"] != "not proved" for row in rows)
    console.say(f"{len(rows)} instances, {proved} with a proof")
    for entry in absent:
        console.warn(f"left out: {entry.name}: {catalogue.NO_MEASUREMENTS}")
    console.next_step(["verify", folder])
    console.written(folder / "index.csv")


def _list() -> None:
    """Print all instances with their tags, and the solvers."""
    from sdp_vs_penalty.results.table import Table
    from sdp_vs_penalty.shootout.catalogue import everything
    from sdp_vs_penalty.shootout.contestants import contestants

    rows = [
        (e.name, e.set, ", ".join(sorted(e.tags - {e.name, e.set, e.robot})))
        for e in everything()
    ]
    console.table(Table(("instance", "set", "more tags"), rows, words=(0, 1, 2)))
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
