"""What the findings of a diagnosis buy on motion of real arms that nothing has seen.

    python results/real_arms/real_arms.py [--data DATA] [--out FOLDER] [ARM ...]

DATA holds the measurements as `sdp-vs-penalty fetch` leaves them. From each split's
training part a model is identified and diagnosed. Its error on the unseen part is
measured three times: bare, with the helpful findings added, and with all findings.
Beside them stands the error by the robot's file alone, where the data hold one.
Writes real_arms.csv and real_arms.md; naming arms makes their rows alone.
"""

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ |= dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)

import numpy as np
import pandas
from numpy.typing import NDArray

from sdp_vs_penalty import Estimate, Measurements, add, compare, diagnose, identify
from sdp_vs_penalty.data.measurements import concatenate
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem import measured_runs
from sdp_vs_penalty.results.table import markdown_lines

HERE = Path(__file__).parent
#: The variable that names the folder of the measurements.
DATA = "SDP_VS_PENALTY_DATA"
#: s: the Panda's motion repeats after so long; it stands still at first.
PERIOD = 13.334
STANDSTILL = 1.1
FOLDS = 5
#: s: shorter stretches are left out, since a filter needs more.
SHORTEST = 2.0
#: The UR10e's runs without a load: identified from one, judged on the others.
UR10E_RUNS = ("20_02_12-50sec_12harm", "20_02_19_14harm50sec", "20_02_19_15harm50sec")


@dataclass(frozen=True)
class Split:
    """What a model is identified and diagnosed from, and the unseen motion."""

    name: str
    problem: str
    train: Measurements
    unseen: Measurements
    #: The maker's file among the measurements, as it states links and friction.
    file: str = ""


def stretches(run: Measurements, chosen: NDArray[np.bool_]) -> Measurements:
    """Return the uninterrupted stretches of the chosen samples, each as a run."""
    samples = np.flatnonzero(chosen)
    parts = np.split(samples, np.flatnonzero(np.diff(samples) > 1) + 1)
    long = [p for p in parts if run.t[p[-1]] - run.t[p[0]] > SHORTEST]
    return concatenate(
        [
            Measurements(
                run.t[p], run.q[p], run.tau[p], names=(f"from {run.t[p[0]]:.1f} s",)
            )
            for p in long
        ]
    )


def panda_splits() -> Iterator[Split]:
    """Yield five folds by the motion's phase: no repetition of what is unseen is
    trained on."""
    (run,) = measured_runs("panda").values()
    since = run.t - run.t[0] - STANDSTILL
    phase = (since % PERIOD) // (PERIOD / FOLDS)
    for fold in range(FOLDS):
        train = stretches(run, (since >= 0.0) & (phase != fold))
        unseen = stretches(run, (since >= 0.0) & (phase == fold))
        yield Split(f"Panda, fold {fold + 1} of {FOLDS}", "panda", train, unseen)


def ur10e_splits() -> Iterator[Split]:
    """Yield one run to learn from, each of the others as unseen motion."""
    runs = measured_runs("ur10e")
    train, *others = [runs[f"ur-{name}"] for name in UR10E_RUNS]
    for name, unseen in zip(UR10E_RUNS[1:], others, strict=True):
        split = f"UR10e, judged on {name}"
        yield Split(split, "ur10e", train, unseen, "ur10e/ur10e.urdf")


def tx40_splits() -> Iterator[Split]:
    """Yield six seconds to learn from, and the last three."""
    (run,) = measured_runs("tx40").values()
    yield Split("TX40, 6 to 9 s", "tx40", run.window(0.0, 6.0), run.window(6.0, 9.0))


def emps_splits() -> Iterator[Split]:
    """Yield the tracking run to learn from, and the pulses."""
    runs = measured_runs("emps")
    yield Split("EMPS, pulses", "emps", runs["tracking"], runs["pulses"])


ARMS: dict[str, Callable[[], Iterator[Split]]] = {
    "panda": panda_splits,
    "ur10e": ur10e_splits,
    "tx40": tx40_splits,
    "emps": emps_splits,
}


def joint_errors(
    model: Estimate | Path, runs: Measurements, filtered_as: Estimate
) -> NDArray[np.float64]:
    """Return each joint's RMS error (n,) [N m or N] over all runs, by their length, behind
    the filters of a model."""
    compared = compare(model, runs, filtered_as.preprocessing)
    squares = np.array([np.square(c.rmse) for c in compared])
    seconds = np.array([c.judged_seconds for c in compared])
    return np.asarray(np.sqrt(seconds @ squares / seconds.sum()))


def rows_of(split: Split) -> Iterator[dict[str, object]]:
    """Yield a row for each joint: errors bare, with helpful and with all findings."""
    bare = identify(split.problem, split.train, check=False)
    diagnosis = diagnose(bare, split.train, check=False)
    errors = {"bare": joint_errors(bare, split.unseen, bare)}
    models = {"helpful": bare, "all": bare}
    if diagnosis.helpful:  # as `add --helpful` does
        helpful = diagnosis.selected(helpful=True)
        models["helpful"] = add(bare, helpful, split.train)
    if diagnosis.effects:
        models["all"] = add(bare, list(diagnosis.effects), split.train)
    for name, model in models.items():
        errors[name] = joint_errors(model, split.unseen, bare)
    errors |= file_errors(split, bare)
    for joint in range(bare.robot.n):
        yield {
            "split": split.name,
            "joint": joint + 1,
            **{name: float(rmse[joint]) for name, rmse in errors.items()},
            "n_helpful": len(diagnosis.helpful),
            "n_all": len(diagnosis.effects),
        }


def file_errors(split: Split, bare: Estimate) -> dict[str, NDArray[np.float64]]:
    """Return the errors by the robot's file, behind the filters of the bare model."""
    if not split.file:
        return {}
    path = Path(os.environ[DATA]) / split.file
    return {"file": joint_errors(path, split.unseen, bare)}


def mean_ratio(rows: pandas.DataFrame, column: str) -> float:
    """Return the geometric mean over joints of an error over the bare one."""
    return float(np.exp(np.log(rows[column] / rows["bare"]).mean()))


def largest_ratio(rows: pandas.DataFrame, column: str) -> tuple[float, int]:
    """Return the largest error over the bare one, and its joint."""
    ratios = rows[column] / rows["bare"]
    return float(ratios.max()), int(rows["joint"][ratios.idxmax()])


def report(rows: pandas.DataFrame) -> str:
    """Write the tables: a row a split, and the Panda's joints over its folds."""
    header = ["split", "findings", "helpful", "mean, helpful", "mean, all"]
    header += ["worst joint, helpful", "worst joint, all"]
    cells = []
    for name, of_split in rows.groupby("split", sort=False):
        counts = of_split.iloc[0]
        worst = [largest_ratio(of_split, c) for c in ("helpful", "all")]
        cells.append(
            [
                str(name),
                str(counts["n_all"]),
                str(counts["n_helpful"]),
                *(f"{mean_ratio(of_split, c):.2f}" for c in ("helpful", "all")),
                *(f"{ratio:.2f} (joint {joint})" for ratio, joint in worst),
            ]
        )
    panda = rows[rows["split"].str.startswith("Panda")]
    by_joint = [
        [str(joint), *(f"{mean_ratio(of_joint, c):.2f}" for c in ("helpful", "all"))]
        for joint, of_joint in panda.groupby("joint")
    ]
    with_file = rows["split"][rows["file"].notna()].unique()
    text = [
        "# Findings on motion of real arms that nothing has seen",
        "",
        "Error with findings over the bare model's: below 1 they help. The mean is"
        " geometric, over joints. By `python results/real_arms/real_arms.py`.",
        "",
        *markdown_lines(header, cells),
        "",
        "## The Panda's joints, over its folds",
        "",
        *markdown_lines(["joint", "helpful", "all"], by_joint),
        *(line for split in with_file for line in errors_by_joint(split, rows)),
    ]
    return "\n".join(text) + "\n"


def errors_by_joint(split: str, rows: pandas.DataFrame) -> list[str]:
    """Return the table of a split's errors: by the maker's file, and by ours."""
    columns = ("file", "bare", "helpful", "all")
    cells = [
        [str(row["joint"]), *(f"{row[c]:.3g}" for c in columns)]
        for _, row in rows[rows["split"] == split].iterrows()
    ]
    header = ["joint", "maker's file", "identified", "with helpful", "with all"]
    return ["", f"## Errors, {split} [N m]", "", *markdown_lines(header, cells)]


def with_kept(rows: pandas.DataFrame, path: Path) -> pandas.DataFrame:
    """Return new rows, beside those of a former table that are not made anew."""
    if not path.exists():
        return rows
    kept = pandas.read_csv(path)
    return pandas.concat([kept[~kept["split"].isin(rows["split"])], rows])


def read_options(
    parser: argparse.ArgumentParser, arguments: Sequence[str] | None
) -> argparse.Namespace:
    """Return the options of a program of this folder; DATA is where runs are read."""
    parser.add_argument("--data", type=Path, default=os.environ.get(DATA))
    parser.add_argument("--out", type=Path, default=HERE)
    options = parser.parse_args(arguments)
    os.environ[DATA] = str(options.data)
    return options


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure the chosen arms, and write both files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("arms", nargs="*", default=list(ARMS))
    chosen = read_options(parser, arguments)
    splits = (split for arm in chosen.arms for split in ARMS[arm]())
    made = [row for split in splits for row in rows_of(split)]
    path = chosen.out / "real_arms.csv"
    rows = with_kept(pandas.DataFrame(made), path).reset_index(drop=True)
    rows.to_csv(path, index=False, float_format="%.6g")
    write_text(chosen.out / "real_arms.md", report(rows))


if __name__ == "__main__":
    main()
