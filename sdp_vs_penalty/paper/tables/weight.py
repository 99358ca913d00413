"""Weight table: where the paper's penalty weight xi makes its penalties exact."""

from itertools import product
from typing import Any

from sdp_vs_penalty.estimators.penalty_paper import PenaltyPaper
from sdp_vs_penalty.paper.tables.methods import certified_optimum
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table import Maker, Table

#: Final weights [(N m)^2 per kg m^2, kg or m]; the authors' is 40. Runs of each.
WEIGHTS, _RUNS = (40.0, 126.0, 400.0, 1260.0, 4000.0), 2


def build(study: Study) -> Table:
    rows: list[dict[str, Any]] = []
    for data in study.judged:
        optimum = certified_optimum(study, data)
        for weight, more in product(WEIGHTS, (1, 10)):
            budget = more * PenaltyPaper.evaluations  # loss evaluations of a run
            study.progress(f"weight {weight:g}, {budget} evaluations, {data.label}")
            steps = tuple(weight * share for share in (0.0, 0.25, 0.5, 0.75, 1.0))
            method = PenaltyPaper(runs=_RUNS, evaluations=budget, weights=steps)
            runs = method.fit(study.task(data)).details["runs"]
            best = min(runs, key=lambda run: run["penalised"])
            rows.append(
                {
                    "data": data.label,
                    "weight_xi": weight,
                    "evaluations": budget,
                    # Violations below this are rounding of the search.
                    "feasible_runs": sum(run["violation"] < 1e-6 for run in runs),
                    "violation": float(best["violation"]),
                    "excess_loss_percent": 100.0 * (float(best["loss"]) / optimum - 1.0),
                }
            )
    return Table.of(
        "weight",
        f"The penalty method's weight on {study.problem.title}",
        study.sentence,
        rows,
        (
            f"penalty-paper with the weights 0, xi/4, xi/2, 3 xi/4, xi, {_RUNS} runs each, of which the "
            "one of least penalised loss is shown; the authors' xi is 40. violation: the worst of the "
            "demands that the method punishes; excess_loss_percent: over the certified lower bound of "
            "the constrained optimum (that of lmi-sdp-plain), negative only for what is not feasible.",
            "A linear penalty is exact above the loss's own multiplier, which grows with the data: "
            "below it no budget makes the answer feasible.",
        ),
        _gist(rows),
        digits=3,
    )


def _gist(rows: list[dict[str, Any]]) -> str:
    """The authors' weight and the smallest feasible one, on the last data and budget."""
    last = [r for r in rows if all(r[k] == rows[-1][k] for k in ("data", "evaluations"))]
    said = f"at xi = {last[0]['weight_xi']:g} the violation is {last[0]['violation']:.2g}"
    for row in last:
        if row["feasible_runs"] == _RUNS:
            found = f"from xi = {row['weight_xi']:g} on all runs are feasible"
            return f"{said}; {found}, {row['excess_loss_percent']:.2g} % over the optimum."
    return f"{said}; no weight makes all runs feasible."


TABLE = Maker("weight", __doc__, build, slow=True)
