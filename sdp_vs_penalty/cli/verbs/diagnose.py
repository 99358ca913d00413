from pathlib import Path


def verb(
    model: Path,
    data: list[Path],
    test: Path | None = None,
    frozen: bool = False,
    json_: Path | None = None,
    window: str | None = None,
    test_window: str | None = None,
    seed: int = 0,
    gain_uncertainty: float | None = None,
    no_check: bool = False,
    verbose: bool = False,
) -> None:
    """Name the physical effects that a model is missing.

    The fast part of `check` runs first; its errors stop the diagnosis (exit code 2).
    Example: sdp-vs-penalty diagnose model.json --data run1.csv run2.csv --test test.csv

    --json out.json: JSON file for the findings.
    """
    from sdp_vs_penalty.api import diagnose as find_missing_effects
    from sdp_vs_penalty.checks.gate import consented
    from sdp_vs_penalty.cli import console, printing, runs
    from sdp_vs_penalty.estimation.estimate import load_estimate

    estimate = load_estimate(model)
    with console.progress("reading the measurements") as progress:
        runs_given = runs.runs_for(estimate, data, window, test, test_window)
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
            gain_uncertainty=gain_uncertainty,
            check=not no_check,
            warn=console.warn,
            without_check=runs.NO_CHECK,
        )
    words = ["--data", *runs.words(data, window), *["--frozen"] * frozen]
    settings = {
        "--test": test,
        "--test-window": test_window,
        "--gain-uncertainty": gain_uncertainty,
    }
    words += [
        str(word) for pair in settings.items() if pair[1] is not None for word in pair
    ]
    what = [",".join(f.text for f in result.sure)] if result.sure else []
    if json_ is not None and (
        result.sure or result.curves
    ):  # curves were measured beside all findings
        what = ["--from", str(json_), *["--confident"] * (not result.curves)]
    units = estimate.robot.torque_units
    printing.diagnosis(result, units, model, bool(what), verbose)
    console.save_json(json_, result.to_dict())
    if what:
        stem = (
            model.stem.rstrip("0123456789") or model.stem
        )  # model.json, model2.json, ...
        numbers = (
            path.stem.removeprefix(stem) for path in model.parent.glob(f"{stem}*.json")
        )
        free = max((int(n) for n in numbers if n.isdigit()), default=1) + 1
        free_model = model.with_name(f"{stem}{free}.json")
        console.next_step(["add", model, *what, *words, "--out", free_model])
