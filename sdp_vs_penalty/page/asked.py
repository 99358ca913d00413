"""What a job is asked: plain JSON, and the problem, runs and model that its words stand for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from sdp_vs_penalty.data.cli_parsing import time_windows
from sdp_vs_penalty.data.files import load_measurements, windowed
from sdp_vs_penalty.data.measurements import Measurements, Runs, concatenate
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate, load_estimate
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.problem import Problem

Answer = dict[str, Any]


class Asked(dict[str, Any]):
    """A request, by its words; progress : hears what is being done."""

    def __init__(self, words: Mapping[str, Any], progress: Progress = no_progress) -> None:
        super().__init__(words)
        self.progress = progress

    @property
    def folder(self) -> Path:
        """The session's own."""
        return Path(self["folder"])

    @property
    def seed(self) -> int:
        return int(self["seed"])

    @property
    def problem(self) -> Problem:
        return load_problem(self["robot"]["source"], self["robot"].get("gravity"))

    @property
    def model(self) -> Estimate:
        return load_estimate(self["model"])

    def number(self, name: str, default: float) -> float:
        """A number that was written among the options. Raises InputError for another text."""
        try:
            return float(self["options"].get(name, default))
        except ValueError:
            text = self["options"][name]
            raise InputError(f"{name.replace('_', ' ')} {text!r}", "write a number") from None

    def windowed(self, run: Measurements) -> Measurements:
        """What the option ``window`` leaves of a run."""
        return windowed(run, time_windows(self["options"].get("window")))

    @property
    def runs(self) -> Runs:
        """The runs for what each is used for, under their shown names.

        A run of use "split" gives part of its motion to the first, the rest to the others.
        """
        chosen = self["runs"]
        if not chosen:
            raise InputError("No run to identify from", "add measurements first")
        loaded = load_measurements(*(self.folder / run["file"] for run in chosen))
        train, test = [], []
        for run, part in zip(chosen, loaded.runs(), strict=True):
            named = replace(part, names=(run["name"],))
            if run["use"] == "split":
                if run["split"] is None:
                    raise InputError(
                        "the motion repeats too fast to be split into one part to identify from and "
                        "one to test on",
                        "use the run for identification only, or record another one",
                        run["name"],
                    )
                train.append(windowed(named, [(a, b) for a, b in run["split"]["train"]]))
                test.append(windowed(named, [(a, b) for a, b in run["split"]["test"]]))
            elif run["use"] != "load":
                (test if run["use"] == "test" else train).append(named)
        if not train:
            raise InputError("No run to identify from", "use at least one for it")
        return Runs(concatenate(train), concatenate(test) if test else None, loaded)
