from pathlib import Path

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
    --time-limit SECONDS: Processor time of each run; default: 60, quick 10.
    --memory GB: Memory of each run.
    --quick: A few instances, one accuracy.
    --out: Folder; runs that it holds are not repeated.
    --jobs >=0: Parallel runs on this computer; 0: one per core.
    --export DIR: Folder for the instances as files with proofs; nothing runs.
    --list: List of instances and solvers.
    """
    from sdp_vs_penalty.research.shootout import runner, summary

    if list_:
        _list()
        return
    if export is not None:
        _export(export, _words(problems))
        return
    usual = runner.Shootout.accuracies
    settings = (
        tuple(numbers("--accuracy", accuracy))
        if accuracy
        else usual[1:2]
        if quick
        else usual
    )
    limit = time_limit if time_limit is not None else 10.0 if quick else 60.0
    chosen = _words(solvers), _words(problems)
    setup = runner.Shootout(
        out, *chosen, settings, limit, memory, quick, scheduler, jobs
    )
    with console.progress("proving intervals") as say:
        outcome = runner.run(setup, say)
    for note in outcome.notes:
        console.warn(note)
    runs, left_out = outcome.results.runs, outcome.not_applicable
    written = summary.write_summary(out, runs, limit, outcome.absent, left_out)
    for sentence in summary.sentences(runs):
        console.say(sentence)
    for path in (outcome.results.path, *written):
        console.written(path)


def _export(folder: Path, groups: list[str] | None) -> None:
    from sdp_vs_penalty.research.shootout import catalogue, library

    entries, _ = catalogue.selected(groups, catalogue.library())
    with console.progress("writing instances") as say:
        rows = library.write_library(folder, entries, say)
    proved = sum(row["status"] != "not proved" for row in rows)
    console.say(f"{len(rows)} instances, {proved} with a proof")
    console.next_step(["verify", folder])
    console.written(folder / "index.csv")


def _list() -> None:
    from sdp_vs_penalty.research.shootout.catalogue import catalogue
    from sdp_vs_penalty.research.shootout.contestants import contestants

    rows = [(e.name, e.group, "quick" if e.quick else "") for e in catalogue().values()]
    console.table("", ("instance", "group", ""), rows, words=3)
    people = [
        (c.name, c.absent or "here", c.description) for c in contestants().values()
    ]
    console.table("", ("solver", "here", "what it is"), people, words=3)


def _words(text: str | None) -> list[str] | None:
    return (
        None
        if text is None
        else [word.strip() for word in text.split(",") if word.strip()]
    )
