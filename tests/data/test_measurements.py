"""Measurements: runs kept apart and in order, files that give back the numbers to the last bit."""

import numpy as np
import pytest

from sdp_vs_penalty import InputError
from sdp_vs_penalty.data import concatenate, save
from sdp_vs_penalty.data.files import load_measurements
from sdp_vs_penalty.data.measurements import Measurements


def random_run(seed: int, n: int = 3, rows: int = 40, name: str = "run") -> Measurements:
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(1e-4, 0.1, rows)) + 10.0 ** rng.uniform(-3, 9)
    q, dq, tau = rng.normal(size=(3, rows, n)) * 10.0 ** rng.uniform(-8, 8, n)
    return Measurements(t, q, tau, dq if seed % 2 else None, None, (name,))


def assert_same(a: Measurements, b: Measurements) -> None:
    for name in ("t", "q", "tau", "dq"):
        x, y = getattr(a, name), getattr(b, name)
        assert (x is None) == (y is None)
        if x is not None:
            np.testing.assert_array_equal(x, y)
            assert y.dtype == np.float64


def test_runs_stay_apart_and_in_order(tmp_path):
    first, second = random_run(1, name="a.csv"), random_run(3, rows=25, name="b.csv")
    save(first, tmp_path / "a.csv")
    save(second, tmp_path / "b.csv")
    both = load_measurements(tmp_path / "a.csv", tmp_path / "b.csv")
    assert both.names == ("a.csv", "b.csv")
    for run, original in zip(both.runs(), (first, second), strict=True):
        assert_same(run, original)
    assert_same(concatenate([both]), concatenate([first, second]))
    assert [run.names for run in concatenate([both, first]).runs()] == [
        ("a.csv",),
        ("b.csv",),
        ("a.csv",),
    ]
    # Measured velocities are kept only where every run has them.
    assert concatenate([first, random_run(2)]).dq is None


def test_windows_count_from_the_start_of_each_run():
    t = np.arange(0.0, 10.0, 0.1)
    late = Measurements(t + 100.0, t[:, None], t[:, None], None, None, ("late",))
    early = Measurements(t, t[:, None], t[:, None], None, None, ("early",))
    both = concatenate([late, early]).window(2.0, 5.0)
    for run, start in zip(both.runs(), (100.0, 0.0), strict=True):
        np.testing.assert_allclose(run.t[[0, -1]], [start + 2.0, start + 4.9])
        np.testing.assert_allclose(run.q[:, 0], run.t - start)
    left, right = early.window(0.0, 5.0), early.window(5.0, np.inf)
    joined = concatenate([left, right])
    assert_same(early, Measurements(joined.t, joined.q, joined.tau))


def test_the_hash_is_of_the_numbers_and_of_nothing_else():
    run = random_run(5)
    same = Measurements(run.t.copy(), np.asfortranarray(run.q), run.tau, None, None, ("other",))
    assert same.data_hash == run.data_hash
    for name in ("t", "q", "tau"):
        values = {key: getattr(run, key).copy() for key in ("t", "q", "tau")}
        values[name].flat[3] = np.nextafter(values[name].flat[3], np.inf)
        assert Measurements(**values).data_hash != run.data_hash
    one = concatenate([run, run])
    assert one.data_hash != run.data_hash


def test_robots_of_different_size_do_not_mix():
    with pytest.raises(InputError, match=r"a has 3, b has 2"):
        concatenate([random_run(0, 3, name="a"), random_run(0, 2, name="b")])


def test_windows_without_samples_are_refused(tmp_path):
    save(random_run(0), tmp_path / "run.csv")
    with pytest.raises(
        InputError, match=r"run\.csv: no samples between 1e\+06 s and its end: the run lasts"
    ):
        load_measurements(tmp_path / "run.csv", start=1e6)


@pytest.mark.parametrize("suffix", ["csv", "npz", "mat", "parquet"])
def test_commands_are_kept_and_torque_may_be_missing(tmp_path, suffix):
    with_torque = random_run(1, name=f"run.{suffix}")
    groups = {name: block for name, block in with_torque.groups.items() if name != "tau"}
    told = {"qcmd": with_torque.q + 0.1, "current": 2.0 * with_torque.tau}
    run = Measurements.of(with_torque.t, groups | told, with_torque.names)
    save(run, tmp_path / f"run.{suffix}")
    back = load_measurements(tmp_path / f"run.{suffix}")
    assert not back.torque_logged
    assert set(back.groups) == {"q", "dq", "qcmd", "current"}
    for name, block in run.groups.items():
        np.testing.assert_array_equal(back.groups[name], block)
    assert back.data_hash == run.data_hash != with_torque.data_hash
    assert np.all(back.tau == 0.0)
    both = concatenate([back.window(0.0, 1.0), back.window(1.0, np.inf)])
    np.testing.assert_array_equal(both.commanded["qcmd"], run.commanded["qcmd"])
    with pytest.raises(InputError, match="no torque, but other runs have one"):
        concatenate([with_torque, back])
    with pytest.raises(InputError, match="holds commands alone"):
        back.require_torque("a test")
