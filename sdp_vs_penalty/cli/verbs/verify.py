from pathlib import Path

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.errors import InputError


def verb(
    proofs: list[Path],
    model: Path | None = None,
    data: list[Path] | None = None,
    window: str | None = None,
) -> None:
    """Check proofs of optimality in exact arithmetic, independently of every solver.

    Exit code 1 if one is refused. The checker is one file on Python's standard library alone.
    Example: sdp-vs-penalty verify proof.json --model model.json --data run1.csv

    proofs proof.json ...: Proofs, or folders that are searched for them.
    --model model.json: Model that the proof must be of.
    --data RUN.csv ...: Measurements that it must be made of.
    """
    from sdp_vs_penalty.cli.runs import NamedRuns, runs_from_options
    from sdp_vs_penalty.estimation.estimate import load_estimate
    from sdp_vs_penalty.estimation.proofs import verify_proof_file
    from sdp_vs_penalty.solvers import verify_proof

    files = list[Path]()
    for path in proofs:
        files += sorted(path.rglob("*proof.json")) if path.is_dir() else [path]
    if not files:
        raise InputError(
            "no file named *proof.json in this folder", "name the proofs", proofs[0]
        )
    if data and model is None:
        raise InputError("--data without a model", "name the model with --model")
    estimate = None if model is None else load_estimate(model)
    runs = None
    if data and estimate is not None:
        _, runs = runs_from_options(estimate.problem, NamedRuns(data, window))
    refused = 0
    for path in files:
        holds, text = verify_proof_file(path, estimate, runs)
        refused += not holds
        console.say(text)
    console.hint(f"checker: {verify_proof.__file__}")
    if refused:
        raise SystemExit(1)
