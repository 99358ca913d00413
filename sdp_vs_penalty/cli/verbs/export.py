from pathlib import Path
from typing import Any


def verb(
    model: Path,
    out: Path,
    urdf: Path | None = None,
    data: list[Path] | None = None,
    window: str | None = None,
    flange: str | None = None,
    force: bool = False,
) -> None:
    """Export a model to a simulator or a controller; an impossible or implausible inertial is refused.

    Example: sdp-vs-penalty export model.json --out robot.urdf

    --out out.urdf|.xml|.sdf|.json|.h|.csv|.script: File to write; its name chooses the format: see `list
        exports`.
    --data RUN.csv ...: Runs to judge what the file holds of the model; default: those that the
        model was judged on.
    --urdf robot.urdf: Your own URDF, of which only inertials, damping and friction are replaced.
    --flange x,y,z: Flange in the last joint's frame [m], for a payload; default: 0,0,0.
    --force: Links whose mass lies outside of their bodies, too.
    """
    from sdp_vs_penalty.api.exporting import judge_as_exported
    from sdp_vs_penalty.cli import console
    from sdp_vs_penalty.cli.runs import judging_runs
    from sdp_vs_penalty.data.parsing import numbers
    from sdp_vs_penalty.estimation.estimate import load_estimate
    from sdp_vs_penalty.estimation.verdict import NOT_JUDGED
    from sdp_vs_penalty.exporters.export import (
        as_exported,
        exported_verdict,
        write_model,
    )

    estimate = load_estimate(model)
    x, y, z = numbers("--flange", flange, 3) if flange is not None else (0.0, 0.0, 0.0)
    held = as_exported(estimate, out)
    loses = held is not None and len(held.theta) < len(estimate.theta)
    judged = None
    if loses and (runs := judging_runs(estimate, data, window)) is not None:
        judged = judge_as_exported(estimate, out, runs.judge, runs.judged_recordings)
    verdict = None if judged is None else judged[0]
    options: dict[str, Any] = {"force": force, "flange": (x, y, z), "judged": verdict}
    left_out = write_model(estimate, out, urdf, **options)
    stored_verdict = estimate.verdict
    if not loses:
        console.say(
            NOT_JUDGED
            if stored_verdict is None
            else f"Verdict: {stored_verdict.headline}"
        )
    else:
        console.say(exported_verdict(left_out, verdict))
        if judged is not None and judged[1]:
            console.say(f"Without what it cannot hold: {judged[1]}")
    console.written(out)
    if urdf is None and out.suffix.lower() in (".urdf", ".xml", ".sdf"):
        urdf_hint = (
            "; --urdf robot.urdf edits your own URDF and keeps its names and meshes"
        )
        console.warn(
            "Moving links are named link1, link2 ...: a model.json holds only the"
            f" joints' names{urdf_hint if out.suffix.lower() == '.urdf' else ''}."
        )
    if left_out:
        console.warn(
            f"{out.suffix} files cannot hold {', '.join(left_out)}; .json files can."
        )
