"""A demonstration: a simulated arm with a hidden effect, from its log to a better model.

The verb ``demo`` and the page's button "Show me" take the same steps as anybody with a
real arm.
"""

from dataclasses import dataclass, replace
from pathlib import Path

from sdp_vs_penalty.data.files import save
from sdp_vs_penalty.data.measurements import concatenate
from sdp_vs_penalty.diagnosis.adding import add
from sdp_vs_penalty.diagnosis.comparison import (
    Comparison,
    Comparisons,
    compare_filtered,
    keep_noise_floor,
    noise_floor,
)
from sdp_vs_penalty.diagnosis.diagnose import diagnose
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.where_it_fails import Failures, where_it_fails
from sdp_vs_penalty.effects import effect_in_words
from sdp_vs_penalty.estimation.build_problem import (
    PoseOptions,
    pose_filtered,
    read_and_filter,
)
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.identify import estimate_posed
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.reports import plotly_script, report
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs

#: The arm, the effect that is hidden on its last joint, and how strongly.
ARM = "panda"
HIDDEN = "presliding_hysteresis"
LEVEL = "strong"
#: Seed of the simulated arm.
SEED = 7
#: Methods that are compared; effects are added to the model of the last.
METHODS = ("ols", "penalty", "lmi-sdp")
#: Names of the runs: to identify from, and to judge on.
RUNS = ("run1.csv", "run2.csv", "test.csv")


@dataclass(frozen=True)
class Demo:
    """What the demonstration computes."""

    #: Each method's model, judged on motion that it has not seen.
    compared: list[Comparison]
    #: Error analysis of the last method's model.
    failures: Failures
    #: What that model misses.
    diagnosis: Diagnosis
    #: The model with what was found added.
    model: Estimate
    #: That model, judged on the same motion.
    after: Comparison
    #: What was hidden, in words.
    truth: str


def demo(
    folder: str | Path, seed: int = SEED, progress: Progress = no_progress
) -> Demo:
    """Run the full workflow on a simulated arm with a hidden effect.

    The steps are: simulate three runs, identify by three methods, locate the error,
    diagnose what is missing, add it, write a report. No step knows what was hidden.

    Parameters
    ----------
    folder : str or Path
        Folder for run1.csv, run2.csv, test.csv, model.json, better.json and
        report.html.
    seed : int
        Seed of the simulated arm and of all random starts.
    progress : callable
        Called with a short text at each step.

    Raises
    ------
    InputError
        If the folder cannot be written, or plotly is not installed.
    """
    folder = Path(folder)
    plotly_script()  # raises at once if the report cannot be written
    problem = load_problem(ARM)
    progress("simulating three runs")
    hidden_result = hidden_runs(
        problem, [(HIDDEN, [problem.robot.n - 1])], LEVEL, seed, count=len(RUNS)
    )
    for name, run in zip(RUNS, hidden_result.runs, strict=True):
        save(run, folder / name)
    train = concatenate(list(hidden_result.train))
    test = hidden_result.test
    models = {}
    filtered = read_and_filter(problem, train)
    estimation = pose_filtered(problem, filtered, PoseOptions(seed=seed))
    for method in METHODS:
        progress(f"identifying by {method}")
        models[method] = estimate_posed(estimation, method)
    model = models[METHODS[-1]]
    # One noise floor for all models: they have the same runs behind the same filters.
    keep_noise_floor(model, train)
    for other in models.values():
        other.provenance["noise"] = model.provenance["noise"]
    progress("comparing on motion that no model has seen")
    noise = noise_floor(model, test)
    failures = where_it_fails(model, test, noise=noise)
    progress("looking for what is missing")
    diagnosis = diagnose(model, train, test, seed=seed)
    progress("adding it")
    better = model
    if diagnosis.helpful:
        helpful = diagnosis.selected(helpful=True)
        better = add(model, helpful, train, seed=seed)
    judged_runs = FilteredRuns.filtering(test, model.preprocessing)
    *compared, after = compare_filtered(
        {**models, "with what was found": better}, judged_runs, noise=noise
    )
    for name, estimate, judged in (
        ("model", model, compared[-1]),
        ("better", better, after),
    ):
        estimate.provenance["verdict"] = judged.verdict.to_dict()
        files = [str(folder / name) for name in RUNS]
        estimate.provenance.update(
            data=files[:-1], judged_data=files[-1:], checked=True
        )
        estimate.save(folder / f"{name}.json")
    progress("writing the report")
    shown = Comparisons(
        [replace(compared[-1], name="before"), replace(after, name="after")]
    )
    report(
        {"before": model, "after": better},
        test,
        folder / "report.html",
        commands=["sdp-vs-penalty demo"],
        findings=diagnosis,
        comparisons=shown,
        failures={"before": failures},
    )
    return Demo(
        compared,
        failures,
        diagnosis,
        better,
        after,
        effect_in_words(f"{HIDDEN}:{problem.robot.n}"),
    )
