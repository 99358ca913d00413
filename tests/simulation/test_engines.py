"""Physics engines against Pinocchio; an engine that is absent is skipped with the
reason."""

from types import SimpleNamespace

import numpy as np
import pytest
from recorded import refusal

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.paper.tables import table_v
from sdp_vs_penalty.paper.tables.table_v import (
    Commanded,
    inverse_dynamics_error,
    play,
    sinusoids,
)
from sdp_vs_penalty.problem import published_links
from sdp_vs_penalty.robot import Joint, Robot, inertia, joint_limits
from sdp_vs_penalty.simulation import engine_types

#: Torque error over a motion relative to the largest torque: what a first-order step of
#: 1 ms and, in Bullet, 50 rounds of sequential impulses leave.
TOLERANCE = {"MuJoCo": 1e-3, "DART": 1e-3, "ODE": 1e-3, "Bullet": 2e-2}


def present(name):
    kind = engine_types()[name]
    if kind.version() is None:
        pytest.skip(f"{name} is absent: {kind.install}")
    return kind


def true_links(problem):
    return (
        problem.nominal_links
        if problem.name == "panda"
        else published_links(problem, "p_real")
    )


def prismatic_arm():
    """A slide on a hinge, with axes and frames that are not the usual ones."""
    tilt = np.array(
        [[0, 0, 1, 0.1], [1, 0, 0, 0.2], [0, 1, 0, 0.3], [0, 0, 0, 1]], float
    )
    axis = np.array([0.6, 0.0, 0.8])
    joints = (
        Joint("turn", "revolute", -1, tilt, axis, np.eye(4)),
        Joint("slide", "prismatic", 0, tilt, np.array([0.0, 1.0, 0.0]), np.eye(4)),
    )
    link = inertia.standard_from_barycentric(
        [2.0, 0.1, -0.2, 0.05, 0.03, 0.004, 0.04, -0.002, 0.001, 0.05]
    )
    return Robot("turn and slide", joints, (1.0, -2.0, -9.0)), np.stack(
        [link, 0.5 * link]
    )


@pytest.mark.parametrize("name", engine_types())
@pytest.mark.parametrize("which", ["panda", "two_link", "slide"])
def test_torques_and_poses_are_pinocchios(name, which, capfd):
    loaded = load_problem("two_link" if which == "slide" else which)
    robot, links = (
        prismatic_arm() if which == "slide" else (loaded.robot, true_links(loaded))
    )
    kind = present(name)
    error = inverse_dynamics_error(kind, robot, links)
    assert error is None if name == "ODE" else error < 1e-9
    run = play(kind, Commanded(robot, links, sinusoids(robot), 1.0))
    # The first steps hold the jump of the acceleration from rest.
    assert np.abs(run.error[20:]).max() < TOLERANCE[name] * np.abs(run.model).max()
    assert run.position.max() < 2e-3
    assert run.angle.max() < 2e-3
    assert capfd.readouterr() == ("", "")  # whatever the engine would have to say


@pytest.mark.parametrize("name", engine_types())
def test_a_rejected_link_is_named(name, two_link):
    links = true_links(two_link).copy()
    links[1, 4] = -1.0
    refusal(lambda: present(name)(two_link.robot, links), "link 2")
    links = true_links(two_link).copy()
    if name in ("MuJoCo", "ODE"):  # they take no rod
        links[0] = inertia.standard_from_barycentric(
            [1.0, 0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.0]
        )
        refusal(lambda: present(name)(two_link.robot, links), "link 1")
    links[0] = 0.0
    refusal(lambda: present(name)(two_link.robot, links), "link 1 ", "has no mass")


def test_sinusoids_stay_within_the_limits(panda):
    lower, upper, velocity = joint_limits(panda.robot)
    q, dq, _ = sinusoids(panda.robot)(np.linspace(0.0, 60.0, 20000))
    assert np.all((lower <= q) & (q <= upper) & (np.abs(dq) <= velocity))
    assert np.all(np.ptp(q, axis=0) > 0.85 * (upper - lower))


def test_an_absent_engine_is_listed_as_absent(two_link, monkeypatch):
    kind = engine_types()["DART"]
    monkeypatch.setattr(kind, "version", classmethod(lambda cls: None))
    study = SimpleNamespace(problem=two_link, progress=lambda _: None)
    study.links = lambda *_: true_links(two_link)
    study.simulated, study.effort = (
        SimpleNamespace(label="simulated"),
        SimpleNamespace(duration=0.1),
    )
    status = table_v.sinusoidal_runs(study)[kind]
    assert isinstance(status, str)
    assert status.startswith("absent")
    assert "sdp-vs-penalty[engines]" in status
