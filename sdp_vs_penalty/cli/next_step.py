"""The command to run next: built from what was given, of files that exist.

What a model.json says of its runs is used only where it is files that exist and a
window: the file may come from anybody.
"""

from pathlib import Path

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.cli.runs import NamedRuns
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
) -> None:
    """Print the next command: `report` if a verdict says that nothing is missing in the
    model, else `diagnose`.

    `diagnose` searches in the runs that the model was identified from, so that ``data``
    stay unseen. If those files are gone, or ``data`` have another mounting, it searches in
    ``data``, and a sentence says that they are unseen no longer.

    Parameters
    ----------
    verdict
        The model's, on ``data``; None if they were not judged.
    data, gravity
        Runs that judged the model; their gravity [m/s^2] as text, if not the model's.
    """
    mounting = [] if gravity is None else ["--gravity", gravity]
    if verdict is not None and not verdict.is_something_missing:
        out = ["--out", free_name("report.html")]
        console.next_step(["report", model, "--data", *data.words, *mounting, *out])
        return
    recorded = NamedRuns.recorded(estimate.provenance.get("data", ()))
    if recorded is not None and gravity is None:
        data = recorded
    else:
        console.say(
            "The next command searches in these runs: they are unseen no longer, report"
            " errors on others."
        )
    findings = ["--json", free_name("findings.json")]
    console.next_step(["diagnose", model, "--data", *data.words, *mounting, *findings])
