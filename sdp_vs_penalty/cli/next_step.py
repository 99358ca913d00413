"""The command to run next: built from what was given, of files that exist.

What a model.json says of its runs is used only where it is files that exist and a
window: the file may come from anybody.
"""

import os
from collections.abc import Sequence
from pathlib import Path

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.cli.runs import NamedRuns
from sdp_vs_penalty.data.files import run_files
from sdp_vs_penalty.data.formats import FILE_SEPARATOR
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.verdict import Verdict


def free_name(path: str | Path) -> Path:
    """Return a name for a new file: the path, or model2.json, model3.json ... where
    there is one."""
    path = Path(path)
    if not path.exists():
        return path
    stem = path.stem.rstrip("0123456789") or path.stem
    endings = [
        file.stem.removeprefix(stem) for file in path.parent.glob(f"*{path.suffix}")
    ]
    numbers = [int(ending) for ending in endings if ending.isdecimal()]
    return path.with_name(f"{stem}{max([1, *numbers]) + 1}{path.suffix}")


def say_what_follows(
    model: Path | str,
    estimate: Estimate,
    verdict: Verdict | None,
    data: NamedRuns,
    gravity: str | None = None,
    measurements: Measurements | None = None,
) -> None:
    """Print the command that diagnoses a model, or the one that reports it where its
    runs show nothing that is missing.

    The diagnosis searches in the runs that the model was identified from, where their
    files are still there, and judges on the first given run that is none of them.
    Runs of two mountings cannot be mixed.

    Parameters
    ----------
    verdict
        On the given runs, if they were judged.
    data, gravity
        As they were given; gravity where it is not the model's.
    measurements
        The given runs, a run a file, where they were read.
    """
    mounting = [] if gravity is None else ["--gravity", gravity]
    if verdict is not None and not verdict.is_something_missing:
        out = ["--out", free_name("report.html")]
        console.next_step(["report", model, "--data", *data.words, *mounting, *out])
        return
    train, test = data, None
    recorded = NamedRuns.recorded(estimate.provenance.get("data", ()))
    new = _runs_not_trained_on(estimate, data.files, measurements)
    if recorded is not None and gravity is None:
        train, test = recorded, new[0] if new else None
    judged_on = [] if test is None else ["--test", *NamedRuns([test]).words]
    if test is not None and data.window is not None:
        judged_on += ["--test-window", data.window]
    findings = ["--json", free_name("findings.json")]
    console.next_step(
        ["diagnose", model, "--data", *train.words, *judged_on, *mounting, *findings]
    )


def _runs_not_trained_on(
    estimate: Estimate, data: Sequence[Path], measurements: Measurements | None
) -> list[Path]:
    """Return the files of ``data`` that a model was not identified from.

    A run was, if the model records its file, or the hash of its content; ``measurements``
    are the runs' contents, None where they were not read.
    """
    recorded = NamedRuns.recorded(estimate.provenance.get("data", ()))
    trained_on = [] if recorded is None else _files(recorded.files)
    hashes = {estimate.provenance.get("data_hash")}
    hashes |= set(estimate.provenance.get("checks") or ())
    files = _files(data)
    runs = [] if measurements is None else list(measurements.runs())
    known = [run.data_hash in hashes for run in runs]
    if len(known) != len(files):  # a file of several stretches, or nothing was read
        known = [False] * len(files)
    return [
        file
        for file, is_known in zip(files, known, strict=True)
        if not is_known and not any(_are_the_same(file, other) for other in trained_on)
    ]


def _files(data: Sequence[Path]) -> list[Path]:
    """Return the files of runs; none where a pattern matches nothing any more."""
    try:
        return [file for path in data for file in run_files(path)]
    except InputError:
        return []


def _are_the_same(first: Path, second: Path) -> bool:
    """Return whether two runs are the same files, perhaps by other names."""
    names = [str(path).split(FILE_SEPARATOR) for path in (first, second)]
    try:
        return len(names[0]) == len(names[1]) and all(map(os.path.samefile, *names))
    except (OSError, ValueError):
        return False
