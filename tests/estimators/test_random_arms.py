"""Arms of revolute and prismatic joints, effects left out at random, three systems of units: where an
interior exists no method gives up, and every answer is certified."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_arms import random_arm, random_run, scara
from random_robots import posed_task

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.estimation.identify import certify
from sdp_vs_penalty.estimators import make_estimator, solve_sdp
from sdp_vs_penalty.robot import ConstraintSet
from sdp_vs_penalty.shootout.instance import Instance, in_units

METHODS = ("lmi-sdp", "lmi-sdp-thickness", "lmi-sdp-plain", "lmi-sdp-entropic")
#: Mass in kg and length in metres of one unit: SI, grams and millimetres, tons and kilometres.
UNITS = ((1.0, 1.0), (1e-3, 1e-3), (1e3, 1e3))
COMMON = ("viscous_friction", "coulomb_friction", "torque_offset")
RARE = ("asymmetric_viscous_friction", "rotor_inertia", "joint_spring", "torque_ripple")


def effects(rng: np.random.Generator, n: int) -> str:
    """The links, and effects on joints drawn at random: some of the usual ones are missing."""
    words = ["rigid_body"]
    for name in (*COMMON, *RARE):
        joints = [str(j + 1) for j in range(n) if rng.random() < 0.8]
        if joints and rng.random() < (0.9 if name in COMMON else 0.2):
            words.append(f"{name}:{'+'.join(joints)}")
    return ",".join(words)


def check(path: Path, chosen: str, seed: int, method: str, units: tuple[float, float]) -> None:
    problem = load_problem(str(path))
    task = posed_task(problem, random_run(problem, seed), chosen)
    objective, constraints = make_estimator(method).posed(task)
    convex = ConstraintSet(constraints.convex)
    made = in_units(Instance("x", replace(task, constraints=convex), objective), *units)
    fit = solve_sdp(made.task, made.objective, made.task.constraints, "clarabel", 1e-10)
    _, certificate = certify(made.task, fit)
    assert certificate.worst == 0.0
    assert certificate.gap < 1e-6


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", range(8))
def test_no_method_gives_up_on_a_random_arm(seed, method, tmp_path):
    rng = np.random.default_rng(seed)
    path = random_arm(tmp_path, seed)
    chosen = effects(rng, load_problem(str(path)).robot.n)
    check(path, chosen, seed, method, UNITS[seed % len(UNITS)])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "chosen",
    [
        "rigid_body,viscous_friction,coulomb_friction,torque_offset:1+2+3",
        "rigid_body,viscous_friction,coulomb_friction,torque_offset,joint_coupling:4@i=3",
    ],
)
def test_a_scara_leaves_room(chosen, method, tmp_path):
    """An offset left out on one joint, a coupling added to the light wrist."""
    check(scara(tmp_path), chosen, 0, method, UNITS[0])
