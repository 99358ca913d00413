"""Streams in which a payload is picked up and put down."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from sdp_vs_penalty import Estimate, Measurements, identify, load_problem
from sdp_vs_penalty.online import PayloadChange, PayloadEstimator
from sdp_vs_penalty.simulation import LEVELS
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs


def thinned(run: Measurements, rate: float) -> Measurements:
    """A run at a lower rate, its clock from zero."""
    step = round(1.0 / (rate * float(np.median(np.diff(run.t)))))
    return Measurements(
        run.t[::step] - run.t[0], run.q[::step], run.tau[::step], names=run.names
    )


@dataclass
class SimulatedPicks:
    """An estimate of a simulated arm, the runs that it is from, a run for the noise, and
    one motion without and with a payload of ``mass`` [kg]."""

    estimate: Estimate
    training: list[Measurements]
    calibration: Measurements
    bare: Measurements
    loaded: Measurements
    mass: float
    com: np.ndarray

    def stream(self, *changes: float) -> Measurements:
        """The motion, its load changed at these instants [s], bare at first."""
        t = self.bare.t
        is_loaded = np.searchsorted(changes, t, side="right") % 2 == 1
        tau = np.where(is_loaded[:, None], self.loaded.tau, self.bare.tau)
        return replace(self.bare, tau=tau)


def simulated_picks(
    name: str, mass: float, seed: int, rate: float = 200.0
) -> SimulatedPicks:
    """Of a built-in arm, at a rate [1/s], with friction and noise of the simulator's
    own."""
    made = _at_a_thousand_hertz(name, mass, seed)
    return replace(
        made,
        training=[thinned(run, rate) for run in made.training],
        calibration=thinned(made.calibration, rate),
        bare=thinned(made.bare, rate),
        loaded=thinned(made.loaded, rate),
    )


@cache
def _at_a_thousand_hertz(name: str, mass: float, seed: int) -> SimulatedPicks:
    """As it is simulated."""
    problem = load_problem(name)
    clean = hidden_runs(problem, [], seed=seed)
    load = [("payload", [])]
    small = hidden_runs(problem, load, "strong", seed, 1, clean.world)
    level = LEVELS["strong"] * mass / small.truth["effects"][0]["size"]
    heavy = hidden_runs(problem, load, level, seed, world=clean.world)
    (truth,) = heavy.truth["effects"]
    frame = problem.robot.tree[-1].link_frame  # the truth is in the joint's frame
    com = np.linalg.solve(frame, [*truth["details"]["com"], 1.0])[:3]
    *training, calibration, bare = clean.runs
    return SimulatedPicks(
        identify(problem, training, check=False),
        training,
        calibration,
        bare,
        heavy.runs[3],
        truth["size"],
        com,
    )


def play(estimator: PayloadEstimator, run: Measurements) -> list[PayloadChange]:
    """All changes that a run brings to light."""
    changes = [
        estimator.update(t, q, tau)
        for t, q, tau in zip(run.t, run.q, run.tau, strict=True)
    ]
    return [change for change in changes if change is not None]
