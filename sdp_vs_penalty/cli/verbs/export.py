from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.errors import InputError

if TYPE_CHECKING:
    from sdp_vs_penalty.api.exporting import AsExported
    from sdp_vs_penalty.data.measurements import Runs
    from sdp_vs_penalty.estimation.estimate import Estimate


def verb(
    model: Path,
    out: Path,
    urdf: Path | None = None,
    mjcf: Path | None = None,
    data: list[Path] | None = None,
    test: Path | None = None,
    window: str | None = None,
    test_window: str | None = None,
    flange: str | None = None,
    force: bool = False,
    refit: bool = False,
    samples: int | None = None,
    prior: str = "flat",
    longer: int = 1,
    seed: int = 0,
) -> None:
    """Export a model to a simulator or a controller; an impossible or implausible inertial is refused.

    Example: sdp-vs-penalty export model.json --out robot.urdf

    --out out.urdf|.xml|.sdf|.json|.h|.csv|.script: File to write; its name chooses the format: see `list
        exports`.
    --data RUN.csv ...: Runs to judge what the file holds of the model, and with --refit to identify
        from; default: those that the model was judged on.
    --test TEST.csv: Run that judges in place of --data.
    --urdf robot.urdf: Your own URDF, of which only inertials, damping and friction are replaced.
    --mjcf robot.xml: Your own MJCF, of which only inertials, armature, damping, friction and springs
        are replaced.
    --flange x,y,z: Flange in the last link's frame [m], for a payload; default: 0,0,0.
    --refit: Identify the model again, from --data, without what the file cannot hold.
    --force: Links whose mass lies outside of their bodies, too.
    --samples N: N consistent models that fit the runs, each a file: out.001.urdf, out.002.urdf, ...
    --prior: With --samples: flat (in the standard parameters, within all constraints) or entropic.
    --longer >=1: With --samples: chains that run so many times as long, where they are not stationary.
    """
    from sdp_vs_penalty.cli.runs import judging_runs, named_test
    from sdp_vs_penalty.data.parsing import numbers
    from sdp_vs_penalty.effects import effect_in_words
    from sdp_vs_penalty.estimation.estimate import load_estimate
    from sdp_vs_penalty.estimation.verdict import NOT_JUDGED
    from sdp_vs_penalty.exporters.export import (
        effects_left_out,
        exported_verdict,
        friction_at_rest,
        write_model,
    )

    estimate = load_estimate(model)
    x, y, z = numbers("--flange", flange or "0,0,0", 3)
    if samples is not None:
        options = {"urdf": urdf, "mjcf": mjcf, "force": force, "flange": (x, y, z)}
        drawing = {"prior": prior, "seed": seed, "longer": longer}
        return _samples(estimate, out, samples, drawing, data, window, **options)
    if refit and data is None:
        raise InputError("--refit", "name the runs to identify from with --data")
    lost = effects_left_out(estimate, out)
    held = None
    tested = named_test(test, test_window, as_written=False)
    if lost:
        runs = judging_runs(estimate, data, window, tested)
        held = _judged_as_exported(estimate, out, runs, refit)
    verdict = None if held is None else held.verdict
    is_refitted = held is not None and held.is_refitted
    if held is not None and is_refitted:
        estimate = held.model
    left_out = write_model(
        estimate,
        out,
        urdf,
        mjcf=mjcf,
        force=force,
        flange=(x, y, z),
        judged=verdict,
        identified_without=lost if is_refitted else (),
    )
    if lost:
        console.say(exported_verdict(lost, verdict))
    else:
        stored = estimate.verdict
        console.say(NOT_JUDGED if stored is None else f"Verdict: {stored.headline}")
    if at_rest := friction_at_rest(estimate, out):
        console.paragraph(at_rest)
    console.written(out)
    if urdf is None and mjcf is None:
        _warn_of_names(out)
    if lost:
        again = "" if refit else " --refit identifies the model again without."
        console.warn(f".json files hold all of the model.{again}")
    elif left_out:
        names = ", ".join(map(effect_in_words, left_out))
        console.warn(f"{out.suffix} files cannot hold {names}; .json files can.")


def _samples(
    estimate: Estimate,
    out: Path,
    n: int,
    drawing: dict[str, Any],
    data: list[Path] | None,
    window: str | None,
    **how: Any,
) -> None:
    """Write n consistent models that fit, each to a numbered file; ``drawing`` is passed
    to who draws them, ``how`` to the writer."""
    from sdp_vs_penalty.cli.runs import judging_runs
    from sdp_vs_penalty.exporters.export import write_model
    from sdp_vs_penalty.ranges.samples import find_samples

    runs = judging_runs(estimate, data, window)
    measured = None if runs is None else runs.train
    with console.progress("sampling"):
        samples = find_samples(estimate, n, measured, **drawing)
    for k, theta in enumerate(samples.theta, start=1):
        path = out.with_name(f"{out.stem}.{k:03d}{out.suffix}")
        write_model(estimate.with_theta(theta), path, **how)
    console.say(samples.sentence)
    console.written(out.with_name(f"{out.stem}.001{out.suffix}"), f"and {n - 1} more")


def _judged_as_exported(
    estimate: Estimate, out: Path, runs: Runs | None, refit: bool
) -> AsExported | None:
    """Judge the part of a model that an exported file can hold, identified again from the
    training runs if ``refit``.

    Returns
    -------
    AsExported or None
        The judged part; None without runs.
    """
    from sdp_vs_penalty.api.exporting import judge_as_exported
    from sdp_vs_penalty.diagnosis.comparison import compare
    from sdp_vs_penalty.signals.filtered import FilteredRuns

    if runs is None:
        return None
    filters = estimate.preprocessing
    judging = FilteredRuns.filtering(runs.judge, filters.resolve(runs.judge))
    (whole,) = compare(estimate, judging, noise_from=runs.judged_recordings)
    training = None
    if refit:
        training = FilteredRuns.filtering(runs.train, filters.resolve(runs.train))
    with console.progress("judging what the file can hold"):
        return judge_as_exported(estimate, out, judging, whole, training=training)


def _warn_of_names(out: Path) -> None:
    """Warn that the exported file has its own names of links.

    A model.json holds names of joints only.
    """

    hints = {
        ".urdf": "; --urdf robot.urdf edits your own URDF and keeps its names and meshes",
        ".xml": "; --mjcf robot.xml edits your own MJCF and keeps its names, meshes and"
        " actuators",
        ".sdf": "",  # no SDF is edited
    }
    hint = hints.get(out.suffix.lower())
    if hint is None:
        return
    console.warn(
        "Moving links are named link1, link2 ...: a model.json holds only the joints'"
        f" names{hint}."
    )
