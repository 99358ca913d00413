"""What the arm tells of one log holds for all with the same columns: unit of positions,
order of columns, sign bits; in Python, in a terminal and on the page."""

import os
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from arms import ELBOW, SHOULDER, TURN, write_urdf
from commands import run_cli
from small_runs import small_run

from sdp_vs_penalty.data.files import as_measurements
from sdp_vs_penalty.data.recorder import Recorder
from sdp_vs_penalty.data.together import read_by_recorder
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem import load_problem


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """Three joints with ranges and masses."""
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    return load_problem(write_urdf(path, "arm", (TURN, SHOULDER, ELBOW)))


@pytest.fixture(scope="module")
def motion(arm):
    return small_run(arm, seconds=8.0)


def write(path, t, q, tau, header="time,pos1,pos2,pos3,trq1,trq2,trq3"):
    """A log whose names say no unit."""
    table = np.column_stack([t, q, tau])
    np.savetxt(path, table, "%.9g", ",", header=header, comments="")
    return path


def together(files, problem):
    """Runs of files that are given together, and all remarks."""
    with warnings.catch_warnings(record=True) as remarks:
        warnings.simplefilter("always")
        got = as_measurements(files, names=problem.channel_names)
    return got.runs(), " ".join(str(x.message) for x in remarks)


def noisy(tau):
    """Torques with so much noise that they tell no unit for certain."""
    noise = np.random.default_rng(1).normal(0.0, 0.35, tau.shape)
    return tau + noise * np.std(tau, axis=0)


@pytest.fixture
def logs(tmp_path, motion):
    """Logs of one recorder, in degrees: of the first the arm tells it, of noise, of little
    motion, of an arm that stands still and of constant numbers it does not."""
    t, q, tau = motion.t, np.degrees(motion.q), motion.tau
    rng = np.random.default_rng(3)
    still = q[400] + 0.01 * rng.normal(size=q.shape)
    holding = tau[400] + 0.1 * rng.normal(size=tau.shape)
    return {
        "clear": write(tmp_path / "clear.csv", t, q, tau),
        "noisy": write(tmp_path / "noisy.csv", t, q, noisy(tau)),
        "little": write(tmp_path / "little.csv", t, 5e-3 * q, tau),
        "still": write(tmp_path / "still.csv", t, still, holding),
        "constant": write(
            tmp_path / "constant.csv", t, 0 * q + q[400], 0 * tau + tau[400]
        ),
    }


@pytest.mark.parametrize("other", ["noisy", "little", "still", "constant"])
def test_the_clearest_log_tells_the_unit_of_all(other, logs, arm):
    alone, _ = together([logs[other]], arm)
    for files in ([logs["clear"], logs[other]], [logs[other], logs["clear"]]):
        runs, said = together(files, arm)
        of_name = {run.names[0]: run for run in runs}
        got = of_name[f"{other}.csv"].q
        np.testing.assert_allclose(got, np.radians(alone[0].q), atol=1e-9)
        assert "as the arm tells of clear.csv, with the same columns" in said
        assert "q may be" not in said  # what the first reading supposed
        assert "other values" not in said


def test_other_columns_are_of_another_recorder(logs, arm, motion, tmp_path):
    header = "time,pos1,pos2,pos3,torque1,torque2,torque3"
    tau = noisy(motion.tau)
    other = write(tmp_path / "b.csv", motion.t, np.degrees(motion.q), tau, header)
    (_, got), _ = together([logs["clear"], other], arm)
    np.testing.assert_allclose(got.q, np.degrees(motion.q), rtol=1e-6)


def test_a_log_whose_values_contradict_the_others_is_named(logs, arm, motion, tmp_path):
    in_radians = write(tmp_path / "rad.csv", motion.t, motion.q, motion.tau)
    (first, second), said = together([logs["clear"], in_radians], arm)
    for run in (first, second):
        np.testing.assert_allclose(run.q, motion.q, rtol=1e-6)
    assert "rad.csv: q is taken as written, that of clear.csv in deg" in said


def test_an_order_that_one_log_shows_is_that_of_the_recorder(arm, motion, tmp_path):
    """Without a header the arm has to confirm the order; one joint that moves confirms it
    of no log."""
    table = np.column_stack([motion.t, motion.q, motion.dq, motion.tau])
    rng = np.random.default_rng(2)
    first, second = tmp_path / "a.csv", tmp_path / "b.csv"
    np.savetxt(first, table)
    table[:, 7:] += rng.normal(size=motion.tau.shape) * np.std(motion.tau, axis=0)
    np.savetxt(second, table)
    with pytest.raises(InputError):
        together([second], arm)
    (got, _), _ = together([second, first], arm)
    np.testing.assert_allclose(got.q, motion.q)


@pytest.mark.parametrize("units", [("deg", "mrad", ""), ("", "", "")])
def test_units_that_contradict_each_other_are_no_recorder_s(units):
    """Nor is one told of others where the arm tells none."""
    heard = []

    def read(place, recorders):
        heard.append(recorders)
        told = (Recorder(("t",), units[place], run=f"{place}.csv"),)
        return SimpleNamespace(recorders=told, names=(f"{place}.csv",))

    read_by_recorder(read, len(units))
    assert heard == [()] * len(units)


def test_an_error_of_one_file_stands_for_it_alone(motion):
    def read(place, recorders):
        if place:
            raise InputError("no", "yes")
        return motion

    got, error = read_by_recorder(read, 2)
    assert got is motion
    assert isinstance(error, InputError)


def test_a_terminal_reads_them_alike(logs, arm, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    urdf = write_urdf(tmp_path / "arm.urdf", "arm", (TURN, SHOULDER, ELBOW))
    run_cli("check", str(urdf), "--data", str(logs["noisy"]), str(logs["clear"]))
    printed = capsys.readouterr()
    assert "q in deg, as the arm tells of clear.csv" in printed.err
    assert "positions in degrees" not in printed.out + printed.err


@pytest.mark.real_data
def test_spoiled_logs_of_one_robot_are_in_one_unit(tmp_path):
    """UR10e in degrees, the torque of joint 3 with the wrong sign: alone one of the three
    logs tells no unit."""
    folder = Path(os.environ["SDP_VS_PENALTY_DATA"]) / "ur10e"
    problem = load_problem(folder / "ur10e.urdf")
    gains = np.array([10.0, 10.70, 8.46, 9.00, 9.48, 10.12])
    names = ["t", *(f"{x}{k}" for x in ("q", "dq", "tau") for k in range(1, 7))]
    files = []
    for name in ("02_12-50sec_12harm", "02_19_14harm50sec", "02_19_15harm50sec"):
        log = np.genfromtxt(folder / f"ur-20_{name}.csv", delimiter=",")[:, :19]
        log[:, 1:13] = np.degrees(log[:, 1:13])
        log[:, 13:] *= gains
        log[:, 15] *= -1.0
        files.append(tmp_path / f"{name}.csv")
        header = ",".join(names)
        np.savetxt(files[-1], log, "%.9g", ",", header=header, comments="")
    alone, _ = together(files[:1], problem)
    assert np.abs(alone[0].q).max() > 100.0
    for run in together(files, problem)[0]:
        assert np.abs(run.q).max() < 2.0 * np.pi
