"""A robot as its file states it, as a model: the baseline of what was identified."""

import os
from pathlib import Path

import numpy as np

from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate, load_estimate
from sdp_vs_penalty.estimation.link_figures import certificate_without_data
from sdp_vs_penalty.estimation.model_file import Details
from sdp_vs_penalty.estimation.uncertainty import Interval, Uncertainty
from sdp_vs_penalty.problem.load import load_problem, problem_names
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.model_files import ROBOT_FILE_ENDINGS
from sdp_vs_penalty.version import __version__

#: The method of such a model: nothing was estimated.
NOMINAL = "nominal"


def nominal_model(problem: Problem) -> Estimate:
    """Return the model that a robot's file states: its links, damping and friction.

    What the file does not state is zero: offsets, most often friction and the rotors'
    inertia.

    Parameters
    ----------
    problem : Problem
        The robot, as :func:`sdp_vs_penalty.load_problem` reads it.

    Returns
    -------
    Estimate
        Without data: the source of each parameter is "given", nothing has an interval.
    """
    model = problem.model(problem.default_effects)
    theta = problem.nominal(model)
    p, n = len(theta), problem.robot.n
    intervals = tuple(
        Interval(parameter.name, parameter.unit, value)
        for parameter, value in zip(model.parameters, theta.tolist(), strict=True)
    )
    nothing = np.zeros((p, 0)), np.zeros((p, n)), np.zeros(n), np.zeros((n, 0))
    return Estimate(
        problem=problem,
        model=model,
        theta=theta,
        uncertainty=Uncertainty((), *nothing, standard=intervals),
        method=NOMINAL,
        certificate=certificate_without_data(problem, model, theta),
        preprocessing=problem.preprocessing,
        settings={},
        report=Details(undetermined={q.name: "given" for q in model.parameters}),
        provenance={
            "data_hash": "",
            "runs": [],
            "samples": 0,
            "versions": {"sdp_vs_penalty": __version__},
        },
    )


def load_model(source: str | Path) -> Estimate:
    """Read a model.json, or take a robot's file, or a built-in name, as it states it.

    Raises
    ------
    InputError
        Where it is neither, or cannot be used.
    """
    path = Path(source)
    is_robot = (
        path.suffix.lower() in ROBOT_FILE_ENDINGS
        or (path / "problem.toml").is_file()
        or (str(source) in problem_names() and not os.path.isfile(path))
    )
    return nominal_model(load_problem(source)) if is_robot else load_estimate(path)


def as_model(source: Estimate | Problem | str | Path, what: str) -> Estimate:
    """Return a model that is judged: an Estimate as it is, a file's or a problem's.

    Parameters
    ----------
    what : str
        Name of the argument in messages.
    """
    if isinstance(source, Problem):
        return nominal_model(source)
    if isinstance(source, str | Path):
        return load_model(source)
    return as_estimate(source, what)
