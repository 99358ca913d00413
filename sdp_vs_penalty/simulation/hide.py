"""The verb ``simulate``: runs in which effects are hidden, for finding them again."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sdp_vs_penalty import show
from sdp_vs_penalty.data.files import save
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects import parse_effects
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem.load import as_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs
from sdp_vs_penalty.simulation.worlds.hidden import LEVELS

#: The files of a folder of simulated runs; the last run is meant as the test run.
RUN_FILES = ("run1.csv", "run2.csv", "run3.csv", "test.csv")


@dataclass(frozen=True, repr=False)
class SimulatedRuns(show.Shown):
    """train : the runs to identify from; test : the run to judge on; truth : what is hidden."""

    train: tuple[Measurements, ...]
    test: Measurements
    truth: dict[str, Any]

    def save(self, folder: str | Path) -> None:
        """Write run1..3.csv, test.csv and truth.json.

        Raises InputError where the folder holds runs that were not written here.
        """
        folder = Path(folder)
        refuse_foreign(folder)
        for name, run in zip(RUN_FILES, (*self.train, self.test), strict=True):
            save(run, folder / name)
        write_text(folder / "truth.json", json.dumps(self.truth, indent=1) + "\n")

    def _summary(self) -> show.Summary:
        length = self.test.t[-1] - self.test.t[0]
        return f"Simulated runs: {self.truth['problem']}, seed {self.truth['seed']}", [
            ("train", f"{show.count(len(self.train), 'run')} of {length:.3g} s"),
            ("test", f"1 run of {length:.3g} s"),
            ("model's effects", ", ".join(self.truth["model_effects"])),
        ]


def refuse_foreign(folder: Path) -> None:
    """InputError where a folder holds runs that :meth:`SimulatedRuns.save` did not write."""
    if not (folder / "truth.json").exists():  # else the folder is one that was written here
        for name in RUN_FILES:
            if (folder / name).exists():
                raise InputError(f"{name} exists already", "name another folder", folder)


def simulate(
    problem: str | Path | Problem,
    hide: str | Sequence[str] = (),
    level: str | float = "strong",
    seed: int = 0,
) -> SimulatedRuns:
    """Simulate three runs to identify from and one to test on, with effects hidden in them.

    problem : a built-in name, a folder with a problem.toml, a URDF file, or a Problem.
    hide : ``effect[:joints]``, several separated by commas or in a sequence, or none. level :
        strong, medium, weak, or the hidden torque's RMS over the raw noise; seed : of everything random.
    Raises InputError for an effect that does not exist or makes no torque there, or another level.
    """
    robot = as_problem(problem, "simulate(problem=...)")
    size = level
    if level not in LEVELS:
        try:
            size = float(level)
        except ValueError:
            size = -1.0
        if not 0.0 < size < 1e6:
            raise InputError(
                f"level {level!r} is unknown", f"write {', '.join(LEVELS)} or a positive number"
            )
    effects = [(e.name, list(e.asked_joints or ())) for e in parse_effects(hide, robot.robot)]
    made = hidden_runs(robot, effects, size, seed, must_show=True)
    return SimulatedRuns(made.runs[:-1], made.runs[-1], made.truth)
