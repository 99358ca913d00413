"""Runs are kept apart and in order; files, other programs' too, give back the numbers
to the last bit, and broken ones are refused in a sentence."""

import json
import re
import shlex
from dataclasses import replace

import numpy as np
import pytest
from commands import python, run_cli
from recorded import refusal
from scipy.io import savemat
from small_runs import small_run, write_bag, write_run
from written_logs import log
from written_logs import same as same_motion

from sdp_vs_penalty import (
    Measurements,
    add,
    convert,
    identify,
    load_estimate,
    load_measurements,
)
from sdp_vs_penalty.data import concatenate, read_run, recognise, save
from sdp_vs_penalty.data.files import run_files, training_runs
from sdp_vs_penalty.data.formats import suffixes
from sdp_vs_penalty.errors import Remark
from sdp_vs_penalty.exporters.sdp import write_posed

SUFFIXES = suffixes("write")


def some_run(n=3, samples=50, velocity=True, name="run", seed=0):
    rng = np.random.default_rng([n, seed])
    t = 1000.0 + np.cumsum(rng.uniform(0.5, 1.5, samples)) * 1e-3
    q, dq, tau = rng.normal(size=(3, samples, n)) * 10.0 ** rng.uniform(-8, 8, n)
    return Measurements(t, q, tau, dq if velocity else None, None, (name,))


def same(a, b):
    assert a.data_hash == b.data_hash
    assert a.groups.keys() == b.groups.keys()
    for name, block in {"t": a.t, **a.groups}.items():
        np.testing.assert_array_equal(block, b.t if name == "t" else b.groups[name])


def test_a_file_with_our_names_imports_its_own_format_alone(tmp_path):
    """Neither other formats nor the tables of words and loggers: start-up is short."""
    save(some_run(), tmp_path / "run.csv")
    code = (
        "import sys\nfrom sdp_vs_penalty.data import load_measurements\n"
        f"load_measurements({str(tmp_path / 'run.csv')!r})\n"
        "print(*(name for name in sys.modules if '.data.' in name))"
    )
    loaded = {name.split(".")[-1] for name in python("-c", code).stdout.split()}
    assert "csv" in loaded
    foreign = {"bag", "joined", "npy", "npz", "matlab", "parquet", "jsonl"}
    tables = {"headerless", "long_table", "loggers", "column_names", "column_sets"}
    assert not loaded & (foreign | tables)


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("n", [1, 3, 12])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_written_and_read_to_the_last_bit(suffix, n, velocity, tmp_path):
    """Temperatures and commands, too; suffixes may be large."""
    run = some_run(n, velocity=velocity)
    run = replace(
        run, temperature=30.0 + np.tanh(run.tau), commanded={"qcmd": run.q + 0.1}
    )
    path = tmp_path / f"RUN{suffix.upper() if velocity else suffix}"
    save(run, path)
    same(run, again := load_measurements(path, joints=n))
    np.testing.assert_array_equal(
        again.window(0.0, 0.02).temperature, run.window(0, 0.02).temperature
    )
    np.savez(tmp_path / "whole.npz", t=run.t, **run.groups)
    same(run, load_measurements(tmp_path / "whole.npz"))


def test_a_sample_is_named_as_its_file_counts(tmp_path):
    run = some_run()
    run.q[7, 1] = np.nan
    for suffix in SUFFIXES:
        path = tmp_path / f"run{suffix}"
        save(run, path)
        where = "row 9" if suffix == ".csv" else "sample 8"
        said = f"run{suffix}: {where}, column q2 is not a finite number"
        refusal(lambda path=path: load_measurements(path), said)


def test_what_is_called_otherwise_is_said_with_the_verb_that_helps(tmp_path, capsys):
    """By the verbs that have no --rename themselves too; the command works as it is
    written. MATLAB's variables lie along or across."""
    path = tmp_path / "axis.mat"
    out = tmp_path / "run.csv"
    run = some_run(1)
    savemat(
        path,
        {
            "t": run.t[None, :],
            "qm": run.q.T,
            "force": run.tau,
            "gain": 35.15,
            "note": "x",
        },
    )
    assert (
        run_cli("identify", "emps", "--data", path, "--out", tmp_path / "model.json")
        == 2
    )
    said = capsys.readouterr().err
    assert "no column q or tau (columns: force, qm, t)" in said
    (command,) = re.findall("`sdp-vs-penalty (.*)`", said)
    words = command.replace("q=NAME", "q=qm").replace("tau=NAME", "tau=force").split()
    words[-1] = str(tmp_path / words[-1])
    assert run_cli(*words) == 0
    same(replace(run, dq=None), load_measurements(out))
    for name, names in (
        ("a.csv", "q=nowhere,tau=force"),
        ("a.csv", "t"),
        ("a.xlsx", "q=qm,tau=force"),
    ):
        assert (
            run_cli("convert", path, "--out", tmp_path / name, "--rename", names) == 2
        )
    assert "choose one of .csv" in capsys.readouterr().err
    savemat(path, {"data": {"t": run.t, "q": run.q, "tau": run.tau}})
    assert load_measurements(path).data_hash == run.data_hash


@pytest.mark.parametrize("mcap", [False, True])
@pytest.mark.parametrize("velocity", [True, False])
def test_ros_bags_by_joint_names(mcap, velocity, tmp_path):
    run = some_run(3, velocity=velocity)
    bag = tmp_path / "bag"
    write_bag(bag, run, mcap=mcap)
    sources = [bag, *bag.glob("*.mcap")]
    assert len(sources) == (2 if mcap else 1)
    for source in sources:
        got = load_measurements(source, joints=3, names=["a", "b", "c"])
        assert np.array_equal(got.q, run.q)
        assert np.array_equal(got.tau, run.tau)
        assert (got.dq is None) == (not velocity)
        assert (
            np.abs(np.diff(got.t) - np.diff(run.t)).max() < 2e-9
        )  # stamps are whole nanoseconds
        assert 0.0 <= got.t[0] < 86_400.0 + 2000.0
    out = tmp_path / "run.csv"
    assert run_cli("convert", bag, "--out", out, "--joints", "b,c") == 0
    assert np.array_equal(load_measurements(out).q, run.q[:, [1, 2]])
    assert run_cli("convert", bag, "--out", out, "--joints", "b,elbow") == 2


@pytest.mark.long
def test_verbs_take_the_joints_of_a_bag_by_the_names_of_the_model(two_link, tmp_path):
    """A driver's order is its own (alphabetic, often): taken as it is, torques change
    places."""
    run = small_run(two_link, seconds=12.0)
    names = two_link.robot.joint_names
    bag = tmp_path / "bag"
    file = tmp_path / "run.csv"
    model = tmp_path / "model.json"
    out = tmp_path / "out.json"
    write_bag(bag, run, names=names[::-1])
    save(run, file)
    assert (
        run_cli(
            "identify", "two_link", "--data", bag, "--method", "ols", "--out", model
        )
        == 0
    )
    errors = []
    for data in (bag, file):
        assert run_cli("compare", model, "--data", data, "--json", out) == 0
        errors.append(json.loads(out.read_text())["models"][0]["rmse"])
    np.testing.assert_allclose(errors[0], errors[1], rtol=1e-4)
    more = ("add", model, "joint_spring:1", "--data", bag, "--test", bag, "--out", out)
    assert run_cli(*more) == 0
    assert abs(load_estimate(out).theta[-1]) < 0.1  # nothing was missing
    posed = [
        write_posed("two_link", [data], tmp_path / "posed.cbf") for data in (bag, file)
    ]
    assert (
        posed[0]["rows"] == posed[1]["rows"]
    )  # stamps are rounded, and with them what is nearly zero
    np.testing.assert_allclose(posed[0]["scale"], posed[1]["scale"], rtol=1e-3)


def test_bags_that_cannot_be_used(tmp_path):
    run = some_run(3)
    cases = {
        "two": (  # by the verb that has the option
            {"topics": ["/left/joint_states", "/right/joint_states"]},
            "two --topic /left/joint_states --out run.csv`",
        ),
        "weightless": ({"no_effort": True}, "effort"),
    }
    for name, (change, words) in cases.items():
        write_bag(tmp_path / name, run, **change)
        refusal(
            lambda name=name: load_measurements(tmp_path / name, names=["a", "b", "c"]),
            words,
        )
    for number, side in enumerate(("left", "right")):
        got = read_run(
            tmp_path / "two", 3, ["a", "b", "c"], topic=f"/{side}/joint_states"
        )
        assert np.array_equal(got.q, run.q + number)
    write_bag(tmp_path / "unstamped", run, no_stamps=True)
    unstamped = load_measurements(tmp_path / "unstamped", names=["a", "b", "c"])
    assert np.abs(np.diff(unstamped.t) - np.diff(run.t)).max() < 2e-9
    metadata = tmp_path / "two" / "metadata.yaml"
    metadata.write_text(
        metadata.read_text().replace("two.db3", "../unstamped/unstamped.db3")
    )
    refusal(lambda: load_measurements(tmp_path / "two"), "not a file of this folder")
    assert run_cli("convert", tmp_path / "x.csv", "--out", tmp_path / "y.csv") == 2


def test_where_one_reader_of_numbers_stops_the_other_goes_on(tmp_path):
    """Arrow takes no plus sign: from its piece on rows are read, and counted, by the
    careful reader."""
    path = tmp_path / "run.csv"
    rows = np.random.default_rng(0).normal(size=(30_000, 3))
    rows[:, 0] = np.arange(len(rows))
    lines = ["t,q1,tau1", *(",".join(map(repr, row)) for row in rows.tolist())]
    rows[20_000, 1:] = 0.5
    lines[20_001] = "20000,+0.5,5e-1"
    path.write_text("\n".join(lines))
    run = load_measurements(path)
    np.testing.assert_array_equal(np.column_stack([run.t, run.q, run.tau]), rows)
    lines[25_000] = "24999,1.2.3,1"
    path.write_text("\n".join(lines))
    refusal(lambda: load_measurements(path), "row 25001, column 2 holds '1.2.3'")


def test_hdf5_and_other_matlab_surprises(tmp_path):
    path = tmp_path / "new.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64" + bytes(500))
    refusal(lambda: load_measurements(path), "-v7")
    savemat(
        path, {"t": np.arange(4.0), "q": np.zeros((4, 2)) * 1j, "tau": np.zeros((4, 2))}
    )
    refusal(lambda: load_measurements(path), "no column q ")


def test_texts_of_a_parquet_file_are_not_read(tmp_path):
    """One that is stored once can come in every row."""
    import pyarrow as arrow
    from pyarrow import parquet

    path = tmp_path / "run.parquet"
    run = some_run(1, samples=5000)
    note = arrow.DictionaryArray.from_arrays(np.zeros(5000, np.int8), ["x" * 100_000])
    columns = {"t": run.t, "q1": run.q[:, 0], "tau1": run.tau[:, 0], "note": note}
    parquet.write_table(arrow.table(columns), path, store_schema=False)
    before = arrow.default_memory_pool().max_memory()
    got = load_measurements(path)
    assert np.array_equal(got.q, run.q)
    assert (
        arrow.default_memory_pool().max_memory() - before < 10**8
    )  # of 5 * 10**8 bytes of text


@pytest.mark.parametrize("share", [0.0001, 0.3, 0.99])
@pytest.mark.parametrize("mcap", [False, True])
def test_a_bag_that_was_cut_off_is_refused(mcap, share, tmp_path):
    folder = tmp_path / "bag"
    write_bag(folder, some_run(3, 2000), mcap=mcap)
    (file,) = (p for p in folder.iterdir() if p.name != "metadata.yaml")
    whole = file.read_bytes()
    file.write_bytes(whole[: int(share * len(whole))])
    for path in (folder, file):
        refusal(lambda path=path: read_run(path), "not a readable ROS bag")


def test_what_is_no_log_is_not_recognised():
    assert recognise(["a", "b", "c"]) is None
    assert recognise(["time", "price", "volume"]) is None
    assert (
        recognise(["time", *(f"q_{k}" for k in range(3, 9))]) is None
    )  # three joints are missing


def test_columns_are_chosen_by_patterns_and_converted(tmp_path):
    path = log(tmp_path / "run.csv", "ms=a; deg=b_{}; tau/2=c_{}")
    rename = {"t": "a", "q*": "b_*", "tau*": "c_*"}
    scale = {"t": "ms", "q": "deg", "tau": "2:2:2"}
    same_motion(convert(path, rename=rename, scale=scale))


def test_runs_stay_apart_and_in_order(tmp_path):
    first = some_run(name="a.csv")
    second = some_run(samples=25, name="b.csv", seed=1)
    save(first, tmp_path / "a.csv")
    save(second, tmp_path / "b.csv")
    both = load_measurements(tmp_path / "a.csv", tmp_path / "b.csv")
    assert both.names == ("a.csv", "b.csv")
    for run, original in zip(both.runs(), (first, second), strict=True):
        same(run, original)
    same(concatenate([both]), concatenate([first, second]))
    assert concatenate([both, first]).names == ("a.csv", "b.csv", "a.csv")
    # Measured velocities are kept only where every run has them.
    assert concatenate([first, some_run(velocity=False)]).dq is None


def test_windows_count_from_the_start_of_each_run(tmp_path):
    t = np.arange(0.0, 10.0, 0.1)
    late = Measurements(t + 100.0, t[:, None], t[:, None], None, None, ("late",))
    early = Measurements(t, t[:, None], t[:, None], None, None, ("early",))
    both = concatenate([late, early]).window(2.0, 5.0)
    for run, start in zip(both.runs(), (100.0, 0.0), strict=True):
        np.testing.assert_allclose(run.t[[0, -1]], [start + 2.0, start + 4.9])
        np.testing.assert_allclose(run.q[:, 0], run.t - start)
    left = early.window(0.0, 5.0)
    right = early.window(5.0, np.inf)
    joined = concatenate([left, right])
    same(early, Measurements(joined.t, joined.q, joined.tau))
    save(early, tmp_path / "early.csv")
    assert load_measurements(tmp_path / "early.csv", stop=0.15).samples == 2
    refusal(
        lambda: load_measurements(tmp_path / "early.csv", stop=0.05),
        "no samples between 0 s and 0.05 s",
    )


def test_the_hash_is_of_the_numbers_and_of_nothing_else():
    run = some_run()
    same = Measurements(
        run.t.copy(), np.asfortranarray(run.q), run.tau, None, None, ("other",)
    )
    assert same.data_hash == run.data_hash
    for name in ("t", "q", "tau"):
        values = {key: getattr(run, key).copy() for key in ("t", "q", "tau")}
        values[name].flat[3] = np.nextafter(values[name].flat[3], np.inf)
        assert Measurements(**values).data_hash != run.data_hash
    one = concatenate([run, run])
    assert one.data_hash != run.data_hash


def test_robots_of_different_size_do_not_mix():
    refusal(
        lambda: concatenate([some_run(3, name="a"), some_run(2, name="b")]),
        "a has 3, b has 2",
    )


def test_torque_may_be_missing(tmp_path):
    with_torque = some_run(name="run.csv")
    groups = {
        "q": with_torque.q,
        "qcmd": with_torque.q + 0.1,
        "current": with_torque.tau,
    }
    run = Measurements.from_channels(with_torque.t, groups, with_torque.names)
    save(run, tmp_path / "run.csv")
    same(back := load_measurements(tmp_path / "run.csv"), run)
    assert not back.torque_logged
    assert (
        len({m.data_hash for m in (back, with_torque, replace(back, commanded={}))})
        == 3
    )
    assert np.all(back.tau == 0.0)
    same(
        replace(
            concatenate([back.window(0.0, 0.02), back.window(0.02, np.inf)]), run=None
        ),
        run,
    )
    refusal(
        lambda: concatenate([with_torque, back]), "no torque, but other runs have one"
    )
    refusal(lambda: back.require_torque("a test"), "holds commands alone")


@pytest.mark.parametrize(
    ("names", "train", "left"),
    [
        (("run1.csv", "run2.csv", "test.csv"), ("run1.csv", "run2.csv"), "test.csv"),
        (("armTest.csv", "latest.csv"), ("latest.csv",), "armTest.csv"),
        (("a_test1.csv", "test2.csv"), ("a_test1.csv", "test2.csv"), ""),
        (("run1.csv",), ("run1.csv",), ""),
    ],
)
def test_a_folder_trains_on_no_run_for_testing_and_says_so(
    names, train, left, two_link, tmp_path
):
    for seed, name in enumerate(names):
        write_run(tmp_path / name, two_link, seconds=1.0, seed=seed)
    with pytest.warns(Remark) as said:
        files = training_runs([tmp_path])
    assert [file.name for file in files] == list(train)
    text = str(said[0].message)
    assert f"trained on {' and '.join(train)}" in text
    assert (f"{left} left out for testing" in text) == bool(left)
    assert [file.name for file in run_files(tmp_path)] == sorted(names)  # to judge on


def test_named_files_are_all_trained_on(two_link, tmp_path):
    files = [
        write_run(tmp_path / name, two_link, seconds=1.0)
        for name in ("a.csv", "test.csv")
    ]
    assert training_runs(files) == files
    assert training_runs(str(tmp_path / "*.csv")) == str(tmp_path / "*.csv")


def test_every_verb_that_trains_leaves_a_folders_test_run_out(
    two_link, tmp_path, capsys
):
    runs = tmp_path / "runs"
    for seed, name in enumerate(("run1.csv", "test.csv")):
        write_run(runs / name, two_link, seed=seed)
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    data = ("--data", runs)
    assert (
        run_cli("identify", "two_link", "--method", "ols", *data, "--out", first) == 0
    )
    assert run_cli("add", first, "joint_spring:1", *data, "--out", second) == 0
    for file in (first, second):
        assert load_estimate(file).provenance["data"] == [str(runs / "run1.csv")]
    capsys.readouterr()
    assert run_cli("compare", first, *data) == 0
    assert "runs: judged on run1.csv and test.csv" in capsys.readouterr().err
    with pytest.warns(Remark, match="left out for testing"):
        model = identify(two_link, runs, "ols")
    assert model.provenance["runs"] == ["run1.csv"]
    with pytest.warns(Remark, match="left out for testing"):
        assert add(model, "joint_spring:1", runs).provenance["runs"] == ["run1.csv"]


#: Names of a column of three joints, with the unit of each; the numbers are the same.
IN_UNITS = {
    "turning": ("j{} pos [{}]", ("deg", "deg", "deg"), np.radians([1, 1, 1])),
    "of a motor": ("j{}_pos_{}", ("mrad", "mrad", "mrad"), [1e-3] * 3),
    "rails": ("j{}_pos_{}", ("mm", "mm", "mm"), [1e-3] * 3),
    "a rail": ("j{} pos [{}]", ("deg", "mm", "deg"), [np.pi / 180, 1e-3, np.pi / 180]),
    "a long rail": ("pos_{} ({})", ("rad", "cm", "mdeg"), [1, 1e-2, np.pi / 180e3]),
    "a rail in SI": ("j{}_pos_{}", ("m", "deg", "deg"), [1, *np.radians([1, 1])]),
}


def in_units(path, form, moves=60.0):
    """A table with units in its names, with commands, in which degrees are cut at a full
    turn; its positions in SI."""
    pattern, units, factors = IN_UNITS[form]
    t = np.arange(300)[:, None] / 100.0
    phase = 2.0 * t + [0.0, 1.0, 2.0]
    size = [1e-3 * moves if x == "m" else moves for x in units]
    q, dq = size * np.sin(phase), 2.0 * np.multiply(size, np.cos(phase))
    is_cut = [x == "deg" for x in units]
    cut = np.where(is_cut, (q + 180.0) % 360.0 - 180.0, q)
    places = [*enumerate(units, 1)]
    names = ["time [ms]", *(pattern.format(*x) for x in places)]
    names += [pattern.replace("pos", "vel").format(k, f"{x}/s") for k, x in places]
    names += [pattern.replace("pos", "cmd_pos").format(*x) for x in places]
    names += [f"j{k}_torque_mNm" for k in (1, 2, 3)]
    rows = np.hstack([t * 1e3, cut, dq, cut, np.sin(1.5 * phase)])
    text = "\n".join(",".join(f"{x:.12g}" for x in row) for row in rows)
    path.write_text(",".join(names) + f"\n{text}\n")
    return q * factors


@pytest.mark.parametrize("moves", [60.0, 400.0])
@pytest.mark.parametrize("form", IN_UNITS)
def test_the_printed_command_of_a_log_with_units_makes_the_same_arrays(
    form, moves, tmp_path, monkeypatch, capsys
):
    """Its units of single columns were applied on top of the header's, and a rail's mm were
    called mrad. Also of angles that are cut."""
    monkeypatch.chdir(tmp_path)
    q = in_units(tmp_path / "log.csv", form, moves)
    assert run_cli("convert", "log.csv", "--out", "first.csv") == 0
    command = re.findall(r"the same by `(.*?)`", capsys.readouterr().err)[0]
    assert ("mrad" in command) == ("mrad" in IN_UNITS[form][1])
    assert run_cli(*shlex.split(command)[1:]) == 0
    first, again = map(read_run, ("first.csv", "run.csv"))
    turns = np.round((first.q - q)[0] / (2.0 * np.pi))
    np.testing.assert_allclose(first.q - 2.0 * np.pi * turns, q, rtol=1e-6, atol=1e-9)
    for group, block in {"t": first.t[:, None], **first.groups}.items():
        same_block = again.t[:, None] if group == "t" else again.groups[group]
        np.testing.assert_allclose(same_block, block, rtol=1e-9)


@pytest.mark.parametrize(
    ("word", "factor"), [("deg", np.pi / 180), ("mm", 1e-3), ("-0.5", -0.5)]
)
def test_the_unit_of_one_column_stands_in_place_of_the_header_s(word, factor, tmp_path):
    q = in_units(tmp_path / "log.csv", "turning")
    said = "of the numbers as written, not of deg" if word == "-0.5" else "the same by"
    with pytest.warns(Remark, match=said):
        run = convert(tmp_path / "log.csv", scale={"q2": word})
    q[:, 1] *= 180.0 / np.pi * factor
    np.testing.assert_allclose(run.q, q, rtol=1e-6, atol=1e-9)
    # In a file with our names a column's unit goes before its group's.
    save(Measurements(run.t, np.ones((300, 3)), run.tau), tmp_path / "ours.csv")
    run = convert(tmp_path / "ours.csv", scale={"q2": word, "q": "rev"})
    np.testing.assert_allclose(
        run.q[0], 2.0 * np.pi * np.array([1.0, factor / (2.0 * np.pi), 1.0])
    )


@pytest.mark.parametrize(
    "options",
    [
        ("--problem", "two_link"),
        ("--scale", "tau=mNm"),
        ("--motors", "50 q1,30 q2", "--scale", "tau=0.5"),
        ("--motors", "50 q1,30 q2", "--joint-torque"),
    ],
)
def test_the_command_that_repeats_a_conversion_makes_the_same_file(
    options, two_link, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    write_run(tmp_path / "ours.csv", two_link)
    head, rows = (tmp_path / "ours.csv").read_text().split("\n", 1)
    theirs = re.sub(r"\btau", "torque_", re.sub(r"\bq", "pos_", head))
    (tmp_path / "log.csv").write_text(f"{theirs}\n{rows}")
    assert run_cli("convert", "log.csv", *options, "--out", "first.csv") == 0
    command = re.findall(r"the same by `(.*?)`", capsys.readouterr().err)[0]
    assert run_cli(*shlex.split(command)[1:]) == 0
    assert (tmp_path / "run.csv").read_bytes() == (tmp_path / "first.csv").read_bytes()
    for option in options[::2]:
        assert command.count(option) == 1


def test_torques_of_joints_stay_beside_positions_of_motors(two_link, tmp_path):
    run = small_run(two_link)
    save(run, tmp_path / "run.csv")
    got = convert(tmp_path / "run.csv", motors="50 q1,30 q2", joint_torque=True)
    np.testing.assert_allclose(got.q, run.q / [50.0, 30.0])
    np.testing.assert_allclose(got.tau, run.tau)


def test_a_stated_factor_stands_in_the_place_of_a_recognised_one(two_link, tmp_path):
    """It was applied on top of it."""
    run = small_run(two_link)
    save(replace(run, q=np.degrees(run.q)), tmp_path / "ours.csv")
    head, rows = (tmp_path / "ours.csv").read_text().split("\n", 1)
    theirs = re.sub(r"\btau", "torque_", re.sub(r"\bq(\d)", r"pos_deg_\1", head))
    (tmp_path / "log.csv").write_text(f"{theirs}\n{rows}")
    with pytest.warns(Remark, match="the same by"):
        convert(tmp_path / "log.csv")
    with pytest.warns(Remark, match="--scale q=0.5"):
        half = convert(tmp_path / "log.csv", scale={"q": "0.5"})
    np.testing.assert_allclose(half.q, 0.5 * np.degrees(run.q), rtol=1e-6)


def test_a_joint_s_force_stands_beside_torques():
    """A rail's force was left out, and the moving rail held still."""
    joints = ["rail_joint", "turn_joint"]
    names = ["t", "rail_joint_pos", "turn_joint_pos"]
    names += ["rail_joint_force [N]", "turn_joint_torque [Nm]"]
    rename = recognise(names, joints).rename
    assert (rename["tau1"], rename["tau2"]) == (names[3], names[4])


def test_letters_with_units_are_a_rail_s_too():
    names = ["t", "th1[m]", "th2[°]", "u1[N]", "u2[N m]"]
    found = recognise(names)
    assert [*found.rename.values()] == names
    assert found.scale == {"q2": pytest.approx(np.pi / 180.0)}


def test_the_first_axis_is_no_ampere():
    """KUKA's and ABB's axes are A1, A2 ..."""
    found = recognise(["t", *(f"{x}.A{k}" for x in ("Pos", "Trq") for k in (1, 2))])
    assert found.torque_unit == ""
