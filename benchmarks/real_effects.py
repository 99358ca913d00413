"""What each effect buys on the real Panda's unseen motion: python benchmarks/real_effects.py PANDA

PANDA : the folder of the authors' log (`sdp-vs-penalty fetch panda`). Writes results/unseen_effects.md.

Two questions, both by stretches of the motion's clock that the model has not seen:
- each effect beside the others, judged by `cross-validate` (five folds). Which of these rows is best
  is known only after judging: none of them is a choice.
- a choice that has not seen its judge: for each of the five folds effects are added one by one, the
  best by inner folds within the training stretches, and only then judged.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import cross_validate
from sdp_vs_penalty.data.files import load_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.estimation.identify import with_reference
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.task import make_task
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import Regression, compress_cells
from sdp_vs_penalty.signals.phases import phase_folds

OUT = Path(__file__).parents[1] / "results" / "unseen_effects.md"
HYSTERESIS, GAIN = "presliding_hysteresis", "torque_gain:6"
#: Beside the usual effects, in the order of the table.
ROWS = (
    "",
    HYSTERESIS,
    GAIN,
    f"{HYSTERESIS} {GAIN}",
    f"maxwell_slip {GAIN}",
    f"load_dependent_hysteresis {GAIN}",
    *(
        f"{HYSTERESIS} {GAIN} {more}"
        for more in (
            *("load_dependent_hysteresis", "load_dependent_friction", "stribeck_friction@vs=0.3"),
            *("power_law_friction@alpha=2", "position_dependent_friction@k=1"),
            *("torque_ripple:1+2+3+4@k=240", "torque_ripple:1+2+3+4@k=242"),
            "torque_ripple:1+2+3+4@k=240 torque_ripple:1+2+3+4@k=242",
            *("torque_ripple:5+6+7@k=1", "torque_ripple:5+6+7@k=2", "joint_spring:5+6+7"),
            *("torque_gain:3", "torque_gain:1+2+3+4+5+7", "base_tilt", "joint_zero_error:2+3+4+5+6"),
            *("joint_elasticity", "torque_gain:3 joint_spring:5+6+7 joint_elasticity"),
        )
    ),
)
#: What the inner folds may add to hysteresis, and how often.
CHOICES = (GAIN, "torque_gain:3", "base_tilt", "joint_spring:5+6+7", "joint_elasticity")
STEPS = 2
#: The clock is cut into so many cells: four are a judged fold, three an inner one. Training keeps off
#: by two cells, which is more than the filters' reach; the inner folds by one.
CELLS, FOLD, INNER = 20, 4, 3

Loss = NDArray[np.float64]


def judged(problem: Problem, run: Measurements, added: str) -> list[float]:
    """All folds, the worst, each joint's RMSE."""
    effects = [*problem.default_effects, *added.split()]
    result = cross_validate(problem, run, effects=effects)
    worst = max(f.relative_error_percent for f in result.folds)
    return [result.relative_error_percent, worst, *result.rmse.tolist()]


class Choice:
    """Effects for one judged fold, chosen on its training cells."""

    def __init__(self, problem: Problem, run: Measurements, fold: int) -> None:
        self.problem, self.run = problem, run
        self.settings = problem.preprocessing.resolve(run)
        self.cells = replace(phase_folds(run, self.settings, CELLS), guard=0.0)
        self.test = list(range(fold * FOLD, (fold + 1) * FOLD))
        self.train = away(range(CELLS), self.test, CELLS // 10)

    def compressed(self, added: Sequence[str]) -> tuple[object, Regression]:
        model = self.problem.model([*self.problem.default_effects, *added])
        if model.needs_reference:

            def training(part):  # type: ignore[no-untyped-def]
                return compress_cells(self.run, part, self.settings, self.cells).select(self.train)

            model = with_reference(self.problem, model, training)
        return model, compress_cells(self.run, model, self.settings, self.cells)

    def losses(self, added: Sequence[str]) -> tuple[float, Loss, float]:
        """The sum of squares over the inner folds; each joint's on the judged fold, and its torque's."""
        model, rows = self.compressed(added)

        def loss(train: list[int], test: list[int]) -> Loss:
            task = make_task(self.problem, model, rows.select(train))  # type: ignore[arg-type]
            return rows.select(test).joint_losses(make_estimator(DEFAULT_METHOD).fit(task).theta)

        inner = 0.0
        around = [c % CELLS for c in range(self.test[-1] + 1, self.test[0] + CELLS)]
        ring = [c for c in around if c in self.train]
        for first in range(0, len(ring), INNER):
            block = ring[first : first + INNER]
            inner += float(loss(away(ring, block, 1), block).sum())
        torque = sum(np.sum(f.triangle[:, -1] ** 2) for f in rows.select(self.test).factors)
        return inner, loss(self.train, self.test), float(torque)

    def made(self) -> tuple[list[str], Loss, float]:
        """The chosen effects, and the losses on the judged fold."""
        chosen = [HYSTERESIS]
        best = self.losses(chosen)
        for _ in range(STEPS):
            others = [c for c in CHOICES if c not in chosen]
            tried = {c: self.losses([*chosen, c]) for c in others}
            name = min(tried, key=lambda c: tried[c][0])
            if tried[name][0] >= best[0]:
                break
            chosen, best = [*chosen, name], tried[name]
        return chosen, best[1], best[2]


def away(cells: Sequence[int], block: Sequence[int], guard: int) -> list[int]:
    """The cells that are farther than ``guard`` cells from a block, around the clock."""
    near = {(c + k) % CELLS for c in block for k in range(-guard, guard + 1)}
    return [c for c in cells if c not in near]


def percent(loss: Loss, torque: float) -> float:
    return float(100.0 * np.sqrt(np.sum(loss) / torque))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("panda")
    run, problem = load_measurements(parser.parse_args().panda), load_problem("panda")
    joints = " | ".join(f"joint {j + 1}" for j in range(run.n))
    lines = [
        "# What each effect buys on the Panda's unseen motion",
        "",
        "Measured: the authors' real run, by `python benchmarks/real_effects.py PANDA`. Relative error "
        f"[%] over five folds by phase and of the worst of them, {DEFAULT_METHOD}, below "
        f"{problem.preprocessing.torque_cutoff:g} Hz; RMSE of each joint [N m]. Effects have the shape "
        "constants that are written, or their defaults, on all joints where none is named.",
        "",
        f"| beside the usual effects | all | worst | {joints} |",
        "| --- " + "| ---: " * (2 + run.n) + "|",
    ]
    for added in ROWS:
        cells = " | ".join(f"{x:.3g}" for x in judged(problem, run, added))
        lines.append(f"| {added or 'none'} | {cells} |")
        print(lines[-1], flush=True)
    lines += ["", "Chosen by inner folds, judged on the fold that the choice has not seen:", ""]
    lines += ["| fold | chosen | error [%] |", "| --- | --- | ---: |"]
    losses, torques = [], []
    for fold in range(CELLS // FOLD):
        chosen, loss, torque = Choice(problem, run, fold).made()
        lines.append(f"| {fold + 1} | {' '.join(chosen)} | {percent(loss, torque):.3g} |")
        print(lines[-1], flush=True)
        losses.append(loss)
        torques.append(torque)
    lines.append(f"| all | | {percent(np.sum(losses, axis=0), sum(torques)):.3g} |")
    print(lines[-1])
    write_text(OUT, "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
