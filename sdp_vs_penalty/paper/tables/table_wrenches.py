"""How far internal wrenches differ between parameters that make the same torques."""

import numpy as np

from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.table import Maker, Row, Table
from sdp_vs_penalty.paper.wrenches import COMPONENTS, wrench_study
from sdp_vs_penalty.robot.arrays import Array


def build(study: Study) -> Table:
    """Rows: joint and component; largest true value, then largest deviations from it."""
    w = study.once(wrench_study)
    low, high = w.intervals.lower, w.intervals.upper
    columns: dict[str, Array] = {
        "true": np.abs(w.true).max(axis=0),
        "interval_mean_width": (high - low).mean(axis=0),
        "interval_max_width": (high - low).max(axis=0),
        # How far feasible parameters of equal torque can be from the true wrench.
        "interval_deviation": np.maximum(high - w.true, w.true - low).max(axis=0),
    }
    columns |= {name: np.abs(value - w.true).max(axis=0) for name, value in w.feasible.items()}
    columns["spread_of_penalty_runs"] = np.ptp(w.penalty_runs, axis=0).max(axis=0)
    columns["spread_of_estimates"] = np.ptp(list(w.feasible.values()), axis=0).max(axis=0)
    for name, found in (("unfeasible_in_box", w.boxed), ("unfeasible_unbounded", w.unbounded)):
        if found:
            errors = [np.abs(x - w.true).max(axis=0) for x in found]
            columns[f"{name}_median"] = np.median(errors, axis=0)
            columns[f"{name}_max"] = np.max(errors, axis=0)
    rows: list[Row] = [
        {"joint": j + 1, "component": component, "unit": unit}
        | {name: float(values[j, k]) for name, values in columns.items()}
        for j in range(study.problem.robot.n)
        for k, (component, unit) in enumerate(COMPONENTS.items())
    ]
    return Table.of(
        "wrenches",
        f"Internal joint wrenches of {study.problem.title}",
        study.sentence,
        rows,
        (
            "Force and moment about the joint's origin, in the joint frame, that a joint bears "
            "(recursive Newton-Euler), its own torque being the component nz: the largest over "
            f"{len(w.t)} instants of the exciting trajectory.",
            "interval: the smallest and largest value over all feasible parameters that make exactly "
            "the true torques in every motion, by two SDPs a component and instant; attained ends and "
            f"ends certified from the dual differ by {w.intervals.slack:.1e} of the widest. "
            "interval_deviation: the farthest such parameters are from the truth.",
            "The interval is over the convex constraints: of the upper bounds on inertias about the "
            "centres of mass it has the convex consequence, so that it contains what the originals "
            "allow.",
            f"spread_of_penalty_runs: largest difference among {len(w.penalty_runs)} runs of the exact "
            "penalty from random feasible starts; spread_of_estimates: among the estimates of all "
            "methods.",
            "Columns named after methods: deviation of an estimate from the truth; these saw a noisy "
            "run, so that their torques differ a little too.",
            f"unfeasible: {len(w.boxed)} and {len(w.unbounded)} relaxed retrievals (no triangle "
            "inequality, no shape) from random starts that reproduce pi_2R to 1e-8 and are physically "
            "inconsistent, within the box bounds and without any. Without bounds the error is whatever "
            "the search happens to end at: wrenches are linear along the directions that torque does "
            "not see.",
        ),
        digits=3,
    )


TABLE = Maker("wrenches", __doc__, build, ("two_link",))
