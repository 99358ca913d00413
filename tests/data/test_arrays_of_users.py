"""Measurements from what people hold in a notebook: lists, pandas, dates."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from recorded import refusal
from small_runs import small_run

from sdp_vs_penalty import InputError, Measurements, identify
from sdp_vs_penalty import load_measurements as load
from sdp_vs_penalty.data import columns_of
from sdp_vs_penalty.data.measurements import concatenate
from sdp_vs_penalty.errors import Remark, RepairableError


def test_lists_and_pandas_objects_are_arrays(two_link):
    run = small_run(two_link)
    lists = [x.tolist() for x in (run.t, run.q, run.tau)]
    frames = [pd.Series(run.t), pd.DataFrame(run.q), pd.DataFrame(run.tau)]
    for given in (lists, frames):
        read = Measurements(*given)
        for name in ("t", "q", "tau"):
            np.testing.assert_array_equal(getattr(read, name), getattr(run, name))
            assert type(getattr(read, name)) is np.ndarray


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"torque_unit": "A"}, "torques in different units: run in N m, run in A"),
        (
            {"q": np.zeros((9, 1)), "tau": np.zeros((9, 1))},
            "numbers of joints: run has 2",
        ),
        ({"torque_logged": False}, "no torque, but other runs have one"),
    ],
)
def test_runs_of_two_kinds_are_not_put_together(change, words):
    run = Measurements(np.arange(9.0), np.zeros((9, 2)), np.ones((9, 2)))
    refusal(lambda: concatenate([run, replace(run, **change)]), words)


def test_commands_as_lists_are_arrays():
    t = [0.0, 0.1]
    block = [[0.1], [0.2]]
    texts = [["a"], ["b"]]
    run = Measurements(t, block, block, commanded={"qref": block})
    assert run.commanded["qref"].shape == (2, 1)
    with pytest.raises(InputError, match="qref holds dates or texts"):
        Measurements(t, block, block, commanded={"qref": texts})


@pytest.mark.parametrize(
    ("t", "q", "words"),
    [
        (pd.date_range("2026-01-01", periods=3), np.zeros((3, 2)), "t holds dates"),
        (np.arange(3.0), [["a", "b"]] * 3, "q holds dates or texts"),
        (np.arange(3.0), [[0.0, 1.0], [0.0]], "q holds rows of different lengths"),
    ],
)
def test_what_is_no_number_is_refused(t, q, words):
    with pytest.raises(InputError, match=words):
        Measurements(t, q, np.zeros((3, 2)))


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"q": (2, 9), "tau": (2, 9)}, "q has shape (2, 9): it is transposed: give"),
        ({"tau": (2, 9)}, "tau has shape (2, 9): it is transposed: give it as (9, 2)"),
        ({"dq": (2, 9)}, "dq has shape (2, 9): it is transposed: give it as (9, 2)"),
        ({"t": (9, 1)}, "t has shape (9, 1): give it as (9,), a row a sample"),
        ({"tau": (8, 2)}, "tau has shape (8, 2): give it as (9, 2), a row a sample"),
        ({"q": (9,), "tau": (9,)}, "q has shape (9,): give it as (9, 1)"),
    ],
)
def test_arrays_of_another_shape_are_refused(arrays, words):
    shapes = {"t": (9,), "q": (9, 2), "tau": (9, 2)} | arrays
    with pytest.raises(InputError, match=re.escape(words)):
        Measurements(**{name: np.zeros(shape) for name, shape in shapes.items()})


def test_a_model_and_a_black_box_say_what_is_transposed(two_link, tmp_path):
    model = identify(two_link, small_run(two_link), "ols", check=False)
    states = [np.zeros((2, 5))] * 3
    words = "predict(q=...) has shape (2, 5): it is transposed: give it as (N, 2)"
    with pytest.raises(InputError, match=re.escape(words)):
        model.predict(*states)
    arrays = {
        "q": np.zeros((5, 2)),
        "gravity": np.zeros((5, 2)),
        "mass_matrix": np.zeros((5, 2, 2)),
    }
    for name, axes in {
        "q": (1, 0),
        "gravity": (1, 0),
        "mass_matrix": (1, 2, 0),
    }.items():
        path = tmp_path / f"{name}.npz"
        np.savez(path, **arrays | {name: arrays[name].transpose(axes)})
        with pytest.raises(InputError, match=rf"array {name} has .* it is transposed"):
            identify(two_link, path)
    everything = {name: x.T for name, x in arrays.items()}
    np.savez(tmp_path / "all.npz", **everything)
    with pytest.raises(InputError, match=r"array q has shape .* it is transposed"):
        identify(two_link, tmp_path / "all.npz")


def test_a_transposed_frame_is_called_so(frame, two_link):
    np.testing.assert_array_equal(load(frame).q, small_run(two_link).q)
    with pytest.raises(InputError, match=r"DataFrame is transposed.* give frame\.T"):
        load(frame.T)


@pytest.fixture(scope="module")
def frame(two_link):
    run = small_run(two_link)
    return pd.DataFrame(columns_of(Measurements(run.t, run.q, run.tau)))


def the_same(a, b):
    """The instants agree but for the resolution of seconds since 1970."""
    np.testing.assert_allclose(a.t - a.t[0], b.t - b.t[0], atol=1e-6)
    np.testing.assert_array_equal([a.q, a.tau], [b.q, b.tau])


def test_rows_with_blank_cells_are_left_out_as_those_of_a_file(frame, tmp_path):
    blank = frame.copy()
    blank.loc[3, "q1"] = blank.loc[[7, 8], "tau2"] = np.nan
    blank.to_csv(tmp_path / "blank.csv", index=False)
    with pytest.warns(Remark, match=r"3 rows .* \(row 5 is the first\) left out"):
        expected = load(tmp_path / "blank.csv")
    with pytest.warns(Remark, match=r"3 rows .* \(sample 4 is the first\) left out"):
        the_same(load(blank), expected)
    with pytest.warns(Remark, match="dq1 is never a number.* dq is left out"):
        the_same(load(frame.assign(dq1=np.nan, dq2=0.0)), load(frame))
    with pytest.raises(InputError, match="column q1 is never a number"):
        load(frame.assign(q1=np.nan))
    arrays = {name: blank[name].to_numpy() for name in blank}
    with pytest.raises(RepairableError, match="sample 4, column q1 is not a finite"):
        load(arrays)


START = pd.Timestamp("2026-01-01 23:59:59.9")


@pytest.mark.parametrize(
    "stamps",
    [
        lambda t: START + pd.to_timedelta(t, unit="s"),
        lambda t: (START + pd.to_timedelta(t, unit="s")).dt.tz_localize("Asia/Tokyo"),
        lambda t: (START + pd.to_timedelta(t, unit="s")).astype(str),
        lambda t: (START + pd.to_timedelta(t, unit="s")).dt.time,
        lambda t: (START + pd.to_timedelta(t, unit="s")).astype(object),
        lambda t: pd.to_timedelta(t, unit="s"),
    ],
    ids=["dates", "zone", "texts", "times of day", "objects", "durations"],
)
def test_dates_of_a_frame_are_its_clock(stamps, frame):
    dated = frame.assign(t=stamps(frame["t"]))
    the_same(load(dated), load(frame))
    the_same(load(dated.set_index("t")), load(frame))


def test_a_clock_of_other_texts_is_shown(frame):
    commas = [str(t).replace(".", ",") for t in frame["t"]]
    with pytest.raises(InputError, match="column t is never a number: '0,0'"):
        load(frame.assign(t=commas))


def test_an_index_with_a_name_or_fractions_is_a_column(frame):
    indexed = frame.set_index("t")
    the_same(load(indexed), load(frame))
    with pytest.warns(Remark, match="t = index"):
        the_same(load(indexed.rename_axis(None)), load(frame))
    late = frame[frame["t"] > 0.1]  # the index counts rows, from another number
    the_same(load(late), load(late.reset_index(drop=True)))


def test_no_command_is_proposed_for_a_frame(frame):
    """A command converts files."""
    foreign = frame.rename(columns={"q1": "position_1", "q2": "position_2"})
    with pytest.warns(Remark, match="columns recognised") as heard:
        load(foreign)
    assert not any("convert" in str(remark.message) for remark in heard)
    sides = {f"{side}_position_{k}": 0.0 for side in ("left", "right") for k in (1, 2)}
    two_arms = frame.drop(columns=["q1", "q2"]).assign(**sides)
    for table in (frame.drop(columns="t"), frame[["t", "q1", "q2"]], two_arms):
        with pytest.raises(InputError, match="give t, q, tau") as raised:
            load(table)
        assert "convert" not in str(raised.value)


def test_masked_rows_are_left_out():
    t = np.arange(6.0)
    q = np.ma.array(np.ones((6, 2)), mask=False)
    tau = np.ma.array(np.arange(12.0).reshape(6, 2), mask=False)
    q[1, 0] = tau[4, 1] = np.ma.masked
    run = Measurements(t, q, tau, commanded={"qcmd": np.ones((6, 2))})
    assert run.t.tolist() == [0.0, 2.0, 3.0, 5.0]
    assert run.tau[:, 0].tolist() == [0.0, 4.0, 6.0, 10.0]
    assert not isinstance(run.tau, np.ma.MaskedArray)
    assert run.commanded["qcmd"].shape == (4, 2)
    nothing = np.ma.array(np.ones((6, 2)), mask=True)
    refusal(lambda: Measurements(t, q, nothing), "every row is masked")


def test_masked_states_are_refused(two_link):
    estimate = identify(two_link, small_run(two_link), "ols", check=False)
    states = np.ma.array(np.ones((3, 2)), mask=[[0, 0], [1, 0], [0, 0]])
    plain = np.ones((3, 2))
    refusal(lambda: estimate.predict(plain, states, plain), "predict(dq=...)", "masked")


@pytest.mark.parametrize("shape", [(1, 1, -1), (1, -1, 1), (-1, 1, 1)])
def test_the_only_joint_may_have_axes_of_length_one(shape):
    """As Simulink logs (n, 1, N), with n = 1."""
    t = np.linspace(0.0, 1.0, 5)
    joint = np.array([0.0, 1.0, 4.0, 9.0, 16.0])
    run = load({"t": t, "q": joint.reshape(shape), "tau": joint.reshape(shape)})
    np.testing.assert_array_equal(run.q[:, 0], joint)
