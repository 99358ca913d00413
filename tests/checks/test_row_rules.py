"""Copies, freezes and skips: told where they were made, and not where a coarse sensor looks like one."""

from dataclasses import replace

import numpy as np
import pytest

from sdp_vs_penalty import Measurements, load_problem
from sdp_vs_penalty.checks import Issue, mended
from sdp_vs_penalty.checks.rules import MOTION, Glance

ROBOT, RATE, PERIOD, STANDSTILL = load_problem("two_link").robot, 250, 8.0, 0.02


def stepped(x: np.ndarray, step: float) -> np.ndarray:
    return np.asarray(step * np.round(x / step)) if step else x


def motion(
    periods: int = 3, encoder: float = 0.0, torque: float = 0.0, noise: float = 0.02
) -> Measurements:
    """Two joints whose motion repeats exactly, with dry friction; sensors in steps of so much."""
    t = np.arange(0.0, periods * PERIOD, 1.0 / RATE)
    w = 2.0 * np.pi * np.array([[2.0], [5.0]]) / PERIOD
    q, dq = (np.array([[0.9], [0.5]]) * f for f in (np.sin(w * t), w * np.cos(w * t)))
    rng = np.random.default_rng(7)
    tau = 6.0 * np.cos(q) + dq + 2.4 * np.sign(dq) + noise * rng.normal(size=q.shape)
    measured = dq + 0.01 * rng.normal(size=q.shape)
    q = q if encoder else q + 1e-6 * rng.normal(size=q.shape)
    return Measurements(t, stepped(q, encoder).T, stepped(tau, torque).T, measured.T)


def found(kind: str, run: Measurements) -> Issue | None:
    """What the rules, each by itself, say of that kind of a run."""
    said = (issue for rule in MOTION for issue in rule(Glance(run, ROBOT, STANDSTILL)))
    return next((issue for issue in said if issue.kind == kind), None)


def told(run: Measurements) -> tuple[list[Issue], Measurements]:
    issues, _, fixed = mended(run, ROBOT, STANDSTILL)
    return issues, fixed


@pytest.mark.parametrize("velocity", [True, False])
def test_a_motion_that_repeats_under_a_coarse_encoder_is_no_copy(velocity):
    """Many rows are equal one period later by chance; a part that is in the file twice still is told."""
    clean = motion(encoder=2.0 * np.pi / 4096, torque=0.1, noise=0.1)
    clean = clean if velocity else replace(clean, dq=None)
    lag = int(PERIOD * RATE)
    same = np.all(clean.q[lag:] == clean.q[:-lag], axis=1) & np.all(
        clean.tau[lag:] == clean.tau[:-lag], axis=1
    )
    assert same.sum() > 200
    assert found("repeated run", clean) is None
    rows = np.r_[0:3000, 1500:2500, 3000 : len(clean.t)]
    copied = Measurements(
        np.arange(len(rows)) / RATE, clean.q[rows], clean.tau[rows], clean.dq[rows] if velocity else None
    )
    issue = found("repeated run", copied)
    assert (issue.figures["rows"], issue.figures["lag"]) == (1000, 1500)
    # The same positions and torques with other velocities are no copies.
    other = replace(copied, dq=motion(4).dq[: len(rows)])
    assert found("repeated run", other) is None


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("step", [0.8, 1.2])
def test_a_coarse_torque_keeps_its_value_until_dry_friction_turns(seed, step):
    """A slow load and Coulomb's friction, in steps of so much: at one level for long, then a jump."""
    clean, rng = motion(2), np.random.default_rng(seed)
    assert clean.dq is not None
    load = 1.5 * np.sin(2.6 * np.pi * clean.t / clean.t[-1] + seed)[:, None]
    tau = 2.4 * np.sign(clean.dq) + 0.2 * clean.dq + load + 0.02 * rng.normal(size=clean.q.shape)
    assert found("frozen torque", replace(clean, tau=stepped(tau, step))) is None


def test_a_torque_in_steps_that_froze_is_told():
    fine = motion(torque=0.1)
    tau = fine.tau.copy()
    tau[2050:2320, 1] = tau[2050, 1]
    issue = found("frozen torque", replace(fine, tau=tau))
    assert issue.figures["joints"] == [2]


@pytest.mark.parametrize("length", [4, 25, 60])
def test_packets_that_froze_are_no_rows_lost(length):
    """Positions stand still bit by bit, then jump, while the stamps go on evenly: the clock is right."""
    clean = motion()
    rows = np.arange(len(clean.t))
    for k in range(200, 5800, 500):
        rows[k : k + length] = k
    issues, fixed = told(replace(clean, q=clean.q[rows], tau=clean.tau[rows], dq=clean.dq[rows]))
    kinds = ["frozen packets"] if length >= 10 else []
    assert [f.kind for f in issues if "gap" not in f.kind] == kinds
    np.testing.assert_array_equal(fixed.t, clean.t[np.isin(clean.t, fixed.t)])
    assert fixed.samples == clean.samples - (12 * (length - 1) if kinds else 0)


@pytest.mark.parametrize("follows", [False, True])
def test_a_joint_that_is_told_to_go_beyond_its_range_lies_against_its_end_stop(follows):
    """A sine of .9 rad through a range of .7: the position stays there, or the range is a wrong one."""
    run, range_ = motion(), 0.7
    narrow = replace(
        ROBOT, joints=(replace(ROBOT.joints[0], lower=-range_, upper=range_), ROBOT.joints[1])
    )
    told, q = run.q.copy(), run.q.copy()
    q[:, 0] = q[:, 0] if follows else np.clip(q[:, 0], -range_ - 0.01, range_ + 0.01)
    run = replace(run, q=q, commanded={"qcmd": told})
    issues, _, fixed = mended(run, narrow, STANDSTILL)
    issue = next((x for x in issues if x.kind == "end stop"), None)
    assert (issue is None) is follows
    if issue is not None:
        against = np.abs(told[:, 0]) > range_ + 0.03  # the position is .01 beyond: a third of that
        assert issue.figures["joints"] == [1]
        assert np.count_nonzero(against) <= issue.figures["rows"] < 1.2 * np.count_nonzero(against)
        assert len(fixed.t) == len(run.t) - issue.figures["rows"]
