"""A torque that stays at one value: frozen, not measured, clipped, or what the drive made."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from pendulum import URDF, swing
from small_runs import small_run

from sdp_vs_penalty import check, load_problem
from sdp_vs_penalty.checks.check import judge_facts

LIMIT = 2.0


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    path = tmp_path_factory.mktemp("pendulum") / "pendulum.urdf"
    path.write_text(URDF.format(effort=LIMIT))
    return load_problem(path)


def servo(t, q, dq, seed=0):
    """A servo's command, which follows two sines about the lower pose."""
    goal = 1.6 + 0.7 * np.sin((1.7 + 0.2 * seed) * t) + 0.3 * np.sin(4.1 * t + seed)
    return 30.0 * (goal - q) - 3.0 * dq


def noisy(run, seed=0):
    """With noise of 0.01 N m wherever the torque is not zero."""
    noise = 0.01 * np.random.default_rng(seed).normal(size=run.tau.shape)
    return replace(run, tau=run.tau + noise * (run.tau != 0.0))


def without_drive(begin, end, seed):
    """The servo is off for a time."""
    return noisy(
        swing(
            lambda t, q, dq: 0.0 if begin <= t < end else servo(t, q, dq, seed),
            rate=(200, 100)[seed % 2],
        )
    )


@cache
def at_limit(seed):
    """A drive that makes no more than LIMIT: its torque, and its command."""
    run = swing(
        lambda t, q, dq: np.clip(servo(t, q, dq, seed), -LIMIT, LIMIT), seed=seed
    )
    dq = np.gradient(run.q[:, 0], run.t)
    command = [servo(*x, seed) for x in zip(run.t, run.q[:, 0], dq, strict=True)]
    is_free = np.abs(run.tau) < LIMIT
    return run, replace(run, tau=np.where(is_free, run.tau, np.array(command)[:, None]))


def held(run, seconds, value=None):
    """With the torque of one instant, or a value, for so long."""
    rows = (run.t >= 5.0) & (run.t < 5.0 + seconds)
    tau = run.tau.copy()
    tau[rows] = tau[np.argmax(rows)] if value is None else value
    return replace(run, tau=tau)


def clipped(run, share):
    """A channel that ends at a share of the largest torque, the start left out."""
    largest = share * float(np.abs(run.tau[run.t > 1.0]).max())
    return replace(run, tau=np.clip(run.tau, -largest, largest))


def coarse(run, step):
    """A channel that counts in steps [N m]."""
    return replace(run, tau=np.round(run.tau / step) * step)


@cache
def free():
    """The servo makes whatever torque it commands."""
    return noisy(swing(servo))


#: A log, and the kind and severity of each fact about its torque.
LOGS = {
    "nothing": (free, []),
    "off at the end": (lambda: without_drive(7.0, 12.0, 0), [("drive off", "note")]),
    "off for two seconds": (
        lambda: without_drive(5.0, 7.0, 1),
        [("drive off", "note")],
    ),
    "off for half of it": (lambda: without_drive(3.0, 9.0, 2), [("drive off", "note")]),
    "zeros for two seconds": (lambda: held(free(), 2.0, 0.0), [("zeros", "error")]),
    "zeros for half a second": (lambda: held(free(), 0.5, 0.0), [("zeros", "warning")]),
    "zeros until the end": (lambda: held(free(), 60.0, 0.0), [("zeros", "error")]),
    "coarse, and often zero": (lambda: coarse(free(), 2.5), []),
    "frozen for two seconds": (lambda: held(free(), 2.0), [("frozen torque", "error")]),
    "frozen for a second": (lambda: held(free(), 1.0), [("frozen torque", "warning")]),
    "drive at its limit": (lambda: at_limit(0)[0], [("saturation", "note")]),
    "another drive at its limit": (lambda: at_limit(3)[0], [("saturation", "note")]),
    "clipped at half": (lambda: clipped(free(), 0.5), [("saturation", "warning")]),
    "clipped at 70 %": (lambda: clipped(free(), 0.7), [("saturation", "warning")]),
    "a command": (lambda: at_limit(0)[1], []),
}
KINDS = {kind for _, facts in LOGS.values() for kind, _ in facts}


def facts_of(problem, run):
    """The facts about the torque of a run."""
    report = judge_facts(problem, run)
    return [issue for issue in report.issues if issue.kind in KINDS]


@pytest.mark.parametrize("name", LOGS)
def test_what_a_torque_that_does_not_change_is(name, pendulum):
    log, facts = LOGS[name]
    found = facts_of(pendulum, log())
    assert [(issue.kind, issue.severity) for issue in found] == facts


@pytest.mark.parametrize("times", [1.0, 2.0])
def test_a_limit_in_place_of_a_command_is_the_torque_of_the_drive(pendulum, times):
    measured, command = at_limit(0)
    is_beyond = np.abs(command.tau) > LIMIT
    command = replace(command, tau=np.where(is_beyond, times, 1.0) * command.tau)
    ((issue,),) = (r.errors_and_warnings for r in check(pendulum, command))
    assert (issue.kind, issue.apply) == ("command beyond the limit", "limit:tau1")
    np.testing.assert_allclose(issue.repair(command).tau, measured.tau, atol=0.01)
    assert f"at a limit of {LIMIT:g}" in issue.what


@pytest.mark.long
def test_torques_of_another_joint_are_no_command_beyond_the_limit():
    """The last three joints' limits are a seventh of the others'."""
    panda = load_problem("panda")
    run = replace(small_run(panda, seconds=8.0), dq=None)
    order = [0, 5, 2, 3, 4, 1, 6]
    (report,) = check(panda, replace(run, tau=run.tau[:, order]), thorough=False)
    kinds = [x.kind for x in report.errors_and_warnings]
    assert "torque order" in kinds
    assert "command beyond the limit" not in kinds


def test_a_clipped_channel_is_called_so_and_a_drive_at_its_limit_is_not(pendulum):
    (drive,) = facts_of(pendulum, at_limit(0)[0])
    (channel,) = facts_of(pendulum, clipped(free(), 0.5))
    assert "the drive is at its limit" in drive.what
    assert "the channel is at its limit" in channel.what
    assert "delete" not in drive.remedy
