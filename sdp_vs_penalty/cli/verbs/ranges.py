import shlex
from pathlib import Path

from sdp_vs_penalty.cli import console


def verb(
    model: Path,
    data: list[Path] | None = None,
    functions: str = "masses",
    level: float = 0.95,
    json_: Path | None = None,
    window: str | None = None,
    proof: Path | None = None,
    save: str | None = None,
    out: Path | None = None,
    band: Path | None = None,
    next_: str | None = None,
) -> None:
    """Show between which values masses and other parameters can lie at all, whatever the prior.

    Each end is certified; the table names what decides it, and what each kind of constraints shortens.
    Example: sdp-vs-penalty ranges model.json --data run1.csv --functions masses,c4x

    --data RUN.csv ...: Measurements; default: those of the model.
    --functions NAME,NAME: m4, c4x, I4xx, mx4, Ixx4, "total mass", a parameter's name, or masses,
        centres, inertias, moments, parameters, base.
    --level: Probability with which each range by itself is to hold the truth.
    --proof proof.json: File for the exact proof of the end that --save names; `verify` checks it.
    --save NAME:least|greatest: With --out or --proof: an end, such as m4:least.
    --out model.json: File for the consistent model that fits and has that value.
    --band RUN.csv: Between which values the torque of another run can lie, joint by joint.
    --next NAME: What a weighed link, or more motion, would leave of this range.
    """
    from sdp_vs_penalty.cli import printing
    from sdp_vs_penalty.cli.runs import judging_runs
    from sdp_vs_penalty.errors import InputError
    from sdp_vs_penalty.estimation.estimate import load_estimate
    from sdp_vs_penalty.ranges.allowed import KINDS
    from sdp_vs_penalty.ranges.band import torque_band
    from sdp_vs_penalty.ranges.table import find_end, find_ranges
    from sdp_vs_penalty.ranges.worth import what_to_measure, worth_sentence, worth_table
    from sdp_vs_penalty.solvers.proof import write_proof

    if (save is None) != (out is None and proof is None):
        remedy = "name an end, and a file for it: --save m4:least --out model.json"
        raise InputError("--save, --out and --proof belong together", remedy)
    estimate = load_estimate(model)
    runs = judging_runs(estimate, data, window)
    measurements = None if runs is None else runs.train
    names = [word.strip() for word in functions.split(",")]
    if next_ is not None:
        names.append(next_)
    with console.progress("ranges") as progress:
        ranges = find_ranges(
            estimate,
            measurements,
            names,
            level=level,
            kinds=KINDS[:-1],
            progress=progress,
        )
        end = None
        if save is not None:
            saved, _, side = save.rpartition(":")
            end = find_end(estimate, saved, side, measurements, level=level)
    worth = None
    if next_ is not None:
        worth = what_to_measure(estimate, next_, measurements, level=level)
        console.paragraph(ranges[next_].sentence)
        console.paragraph(worth_sentence(worth))
    printing.allowed(ranges)
    if worth is None and ranges.widest is not None:
        name = ranges.widest.name
        option = shlex.join(["--next", name])
        console.paragraph(f"What would shorten the range of {name}: add {option}.")
    console.save_json(json_, ranges.to_dict())
    if band is not None:
        console.table(torque_band(estimate, band, measurements).table())
    if worth is not None:
        console.table(worth_table(worth, next_ or ""))
    if end is None:
        return
    if out is not None:
        estimate.with_theta(end.witness).save(out)
        console.written(out)
    if proof is not None:
        write_proof(end.proof(saved), proof)
        console.written(proof)
