from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.formatting import given_options

if TYPE_CHECKING:
    from sdp_vs_penalty.diagnosis.findings import Diagnosis

#: Said where the command to add takes some of the findings.
CURVES_LEFT_OUT = (
    "The next command adds what helps. The measured curves were measured beside the"
    " weak findings too, so it leaves both out; without --helpful it adds everything."
)


def verb(
    model: Path,
    data: list[Path],
    test: Path | None = None,
    frozen: bool = False,
    json_: Path | None = None,
    gravity: str | None = None,
    window: str | None = None,
    test_window: str | None = None,
    seed: int = 0,
    gain_uncertainty: float | None = None,
    no_check: bool = False,
    as_written: bool = False,
    verbose: bool = False,
) -> None:
    """Name the physical effects that a model is missing.

    The fast part of `check` runs first; its errors stop the diagnosis (exit code 2).
    Example: sdp-vs-penalty diagnose model.json --data run1.csv run2.csv --test test.csv

    --json out.json: JSON file for the findings.
    """
    from sdp_vs_penalty.api import diagnose as find_missing_effects
    from sdp_vs_penalty.api.remedies import Files, next_command
    from sdp_vs_penalty.checks.gate import consented
    from sdp_vs_penalty.cli import printing, runs
    from sdp_vs_penalty.cli.next_step import free_name
    from sdp_vs_penalty.data.files import training_runs
    from sdp_vs_penalty.problem.check_command import CheckCommand
    from sdp_vs_penalty.render.diagnosis_words import place_in_files
    from sdp_vs_penalty.render.words import describe_advice

    named = runs.NamedRuns(training_runs(data), window, as_written)
    tested = runs.named_test(test, test_window, as_written=as_written)
    estimate = runs.model_from_options(model, gravity, gain_uncertainty)
    with console.progress("reading the measurements") as progress:
        runs_given = runs.runs_for(estimate, named, tested)
        if consented(estimate, runs_given.train):
            console.warn(
                "data check skipped: the model comes from these runs with --no-check"
            )
        result = find_missing_effects(
            estimate,
            runs_given.train,
            runs_given.test,
            frozen=frozen,
            seed=seed,
            progress=progress,
            noise_from=runs_given.all_runs,
            judged_recordings=runs_given.judged_recordings,
            check=not no_check
            and runs.gate(CheckCommand.for_runs(estimate.problem, named.files)),
        )
    words = ["--data", *named.words, *["--frozen"] * frozen]
    words += given_options(
        {
            "--test": None if test is None else runs.NamedRuns([test]).words[0],
            "--test-window": test_window,
            "--gravity": gravity,
            "--gain-uncertainty": gain_uncertainty,
        }
    )
    files = Files(
        check=CheckCommand.for_runs(estimate.problem, named.files),
        model=model,
        findings=json_,
        data=words,
        new={"model": free_name(model), "trajectory": "trajectory.csv"},
    )
    what = next_command(result.remedies, files)
    units = estimate.torque_units
    printing.diagnosis(result, units, model, what is not None, verbose)
    _say_what_became_of_plugins(result, {e.name for e in estimate.model.effects})
    console.save_json(json_, result.to_dict())
    if what is not None:
        if advice := describe_advice(result):
            console.paragraph(advice)
        offered = result.offers.main.change.arguments if result.offers.main else {}
        if no_place := place_in_files(result, offered.get("effects", ())):
            console.paragraph(no_place)
        if json_ is not None and result.leaves_curves_out:
            console.paragraph(CURVES_LEFT_OUT)
        console.next_step(what)


def _say_what_became_of_plugins(result: Diagnosis, in_model: set[str]) -> None:
    """Say of the user's own effects, which the model does not hold and no finding names,
    that they were tried."""
    from sdp_vs_penalty.effects import EFFECTS, effect_in_words

    named = {x.effect for x in result.effects} | {x.effect for x in result.invisible}
    for finding in result.effects:
        named |= {rival.name for rival in finding.rivals}
    for name, kind in EFFECTS.all().items():
        if name in named | in_model or not EFFECTS.provider(name):
            continue
        became = (
            "was tried, and explains nothing here better than what is named above"
            if kind.sought
            else "was not tried: it declares sought = False"
        )
        console.paragraph(f"Your effect {effect_in_words(name)} {became}.")
