"""Whatever a user can get wrong is one sentence: file, row or field, what is wrong,
what to do.

Named cases first, then Hypothesis: no reader raises anything but InputError, whatever
the bytes.
"""

import bz2
import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import peak_memory
from recorded import refusal, refusals, same_refusal
from scipy.io import savemat
from small_runs import small_run, write_bag

import sdp_vs_penalty as sdp
from sdp_vs_penalty.data import as_measurements, check_plausible, read_run, save
from sdp_vs_penalty.errors import Remark
from sdp_vs_penalty.regression import load_answers

HEADER = "t,q1,q2,dq1,dq2,tau1,tau2"
ROWS = [f"{0.01 * k:.2f},0.{k},0.2,0,0,1,2" for k in range(9)]
GOOD = "\n".join([HEADER, *ROWS]) + "\n"


def test_a_file_without_columns_has_none_to_rename(tmp_path):
    path = tmp_path / "run.jsonl"
    path.write_text("{}\n{}\n")
    said = refusal(lambda: read_run(path), "columns: none", "write numbers")
    assert "--rename" not in said


@pytest.mark.parametrize("case", refusals("csv"))
def test_a_bad_csv_is_refused(case, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text(refusals("csv")[case][0])
    assert same_refusal("csv", case, refusal(lambda: sdp.load_measurements("run.csv")))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (bytes(range(256)) * 20, "not UTF-8 text"),
        (GOOD.encode() + b"\0" * 10, "a binary file"),
    ],
)
def test_a_binary_csv_is_refused(content, words, tmp_path):
    path = tmp_path / "run.csv"
    path.write_bytes(content)
    refusal(lambda: sdp.load_measurements(path), words)


def test_a_good_csv_with_spreadsheet_habits_is_read(tmp_path):
    """A byte order mark, CRLF, spaces in the header, blank lines at the end."""
    path = tmp_path / "run.csv"
    text = "\ufeff" + "\r\n".join([HEADER.replace(",", " , "), *ROWS, "", ""])
    path.write_bytes(text.encode())
    assert sdp.load_measurements(path, joints=2).q.shape == (9, 2)


@pytest.mark.parametrize(
    ("more", "said"),
    [("ddq1", ["ddq1", "computed from q"]), ("mode", ["not used: mode."])],
)
def test_other_columns_are_left_out_with_a_remark(more, said, tmp_path):
    """Logs hold accelerations, currents, states: the run is the same without them."""
    plain = tmp_path / "plain.csv"
    path = tmp_path / "run.csv"
    plain.write_text(GOOD)
    path.write_text(
        "\n".join(
            f"{line},{more if k == 0 else k}" for k, line in enumerate([HEADER, *ROWS])
        )
    )
    with pytest.warns(Remark) as heard:
        run = sdp.load_measurements(path, joints=2)
    assert all(word in str(heard[0].message) for word in said)
    assert run.data_hash == sdp.load_measurements(plain, joints=2).data_hash


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"q1": np.zeros(5), "tau1": np.zeros(5)}, ["no column t "]),
        (
            {"t": np.arange(5.0), "q1": np.zeros(4), "tau1": np.zeros(5)},
            ["q has 4 rows, t has 5"],
        ),
        (
            {"t": np.arange(5.0), "q": np.zeros((5, 2, 2)), "tau": np.zeros(5)},
            ["3 dimensions"],
        ),
        (
            {"t": np.arange(5.0), "q1": np.full(5, 1j), "tau1": np.zeros(5)},
            ["q1", "complex"],
        ),
        (
            {"t": np.arange(5.0), "q1": np.array(list("abcde")), "tau1": np.zeros(5)},
            ["q1", "never a number"],
        ),
        (
            {"t": np.arange(5.0)[::-1], "q1": np.zeros(5), "tau1": np.zeros(5)},
            ["sample 2", "backwards"],
        ),
        (
            {"t": np.arange(5.0), "q1": np.array([{}] * 5), "tau1": np.zeros(5)},
            ["q1", "never a number", "object"],
        ),
    ],
)
def test_bad_npz(arrays, words, tmp_path):
    path = tmp_path / "run.npz"
    np.savez(path, **arrays)
    refusal(lambda: sdp.load_measurements(path), "run.npz", *words)


def test_files_and_folders_that_are_not_there(tmp_path):
    refusal(
        lambda: sdp.load_measurements(tmp_path / "nowhere.csv"),
        "nowhere.csv",
        "No such file",
    )
    (tmp_path / "folder.csv").mkdir()
    for folder in (tmp_path / "folder.csv", tmp_path):
        refusal(
            lambda folder=folder: sdp.load_measurements(folder),
            "no runs in this folder",
        )
    refusal(sdp.load_measurements, "name at least one RUN.csv")


def test_a_panda_log_of_unequal_files(tmp_path):
    for name, count in (
        ("time", 5),
        ("positions", 35),
        ("velocity", 35),
        ("torques", 34),
    ):
        lines = [str(0.001 * k) for k in range(count)]
        (tmp_path / f"exciting_traj_{name}.txt").write_text("\n".join(lines))
    refusal(
        lambda: sdp.load_measurements(tmp_path),
        "exciting_traj_torques.txt has 34 rows",
        "exciting_traj_time.txt has 5",
    )
    (tmp_path / "exciting_traj_torques.txt").write_text("1\nthree\n3\n")
    refusal(
        lambda: sdp.load_measurements(tmp_path),
        "exciting_traj_torques.txt: row 2",
        "'three'",
    )


def test_degrees_are_refused_by_the_joints_ranges_and_one_turn_outside_is_not(panda):
    centre = 0.5 * (np.array([j.lower + j.upper for j in panda.robot.joints]))
    run = replace(small_run(panda), names=("run.csv",), dq=None)
    run = replace(run, q=run.q + centre)
    check_plausible(panda.robot, replace(run, q=run.q + 2.0 * np.pi))
    estimate = sdp.identify(
        panda, run, "ols", check=False
    )  # its torques are those of other positions
    wrong = replace(run, q=np.degrees(run.q))
    words = (
        "run.csv: row ",
        "column q",
        "far outside the range of joint",
        "degrees to radians",
    )
    for call in (
        lambda: sdp.identify(panda, wrong),
        lambda: sdp.compare(estimate, wrong),
    ):
        refusal(call, *words)


@pytest.mark.parametrize(("factor", "is_named"), [(1e3, True), (1e5, False)])
def test_millimetres_of_a_straight_axis_are_named(factor, is_named):
    """A thousandth of the positions lies inside the range; of others it does not."""
    robot = sdp.load_problem("emps").robot
    (joint,) = robot.joints
    q = factor * np.linspace(joint.lower, joint.upper, 100)[:, None]
    run = sdp.Measurements(np.arange(100.0), q, np.ones((100, 1)))
    words = ("far outside the range of joint 1", "millimetres to metres")
    refusal(lambda: check_plausible(robot, run), *words)
    with pytest.raises(sdp.InputError) as error:
        check_plausible(robot, run)
    assert ("inside it as millimetres" in str(error.value)) == is_named


def test_degrees_are_refused_by_the_derivative_and_a_turning_shaft_is_not(two_link):
    run = small_run(two_link)
    wrong = replace(run, q=np.degrees(run.q))
    said = "q1 and dq1 differ by a factor of 57", "convert q "
    refusal(lambda: sdp.identify(two_link, wrong), *said)
    check_plausible(two_link.robot, replace(run, dq=np.degrees(run.dq)))
    check_plausible(
        two_link.robot,
        sdp.Measurements(run.t, run.q + 20.0 * run.t[:, None], run.tau, None),
    )


def test_wrong_number_of_joints(two_link, panda, tmp_path):
    run = small_run(two_link)
    refusal(lambda: sdp.identify(panda, run), "2 joints", "panda", "7")
    refusal(lambda: sdp.check(panda, run), "2 joints, the robot has 7")
    raw = tmp_path / "ur-20_02_12-50sec_12harm.csv"
    raw.write_text("0.1,2\n")
    refusal(
        lambda: sdp.load_measurements(raw), "raw file", "sdp-vs-penalty fetch ur10e"
    )
    refusal(
        lambda: sdp.compare(sdp.identify(two_link, run, "ols"), small_run(panda)),
        "the robot has 2",
        "7 joints",
    )


TOML = Path(__file__).with_name("two_joints.toml").read_text()
BOUNDS = "parameter,lower,upper\nm1,0.1,20\nc1x,-0.5,0.5\nI2xx,0,1\n"


def problem_folder(folder, toml=TOML, bounds=BOUNDS):
    folder.mkdir(exist_ok=True)
    (folder / "problem.toml").write_text(toml)
    (folder / "bounds.csv").write_text(bounds)
    return folder


@pytest.mark.parametrize("case", refusals("problem"))
def test_a_bad_problem_is_refused(case, tmp_path, monkeypatch):
    old, new, _ = refusals("problem")[case]
    assert old in TOML
    monkeypatch.chdir(tmp_path)
    folder = problem_folder(Path("arm"), TOML.replace(old, new, 1))
    assert same_refusal("problem", case, refusal(lambda: sdp.load_problem(folder)))


def test_brackets_without_end_are_refused(tmp_path):
    nested = TOML.replace('title = "t"', f"title = {'[' * 5000}{']' * 5000}", 1)
    refusal(
        lambda: sdp.load_problem(problem_folder(tmp_path / "arm", nested)),
        "nested too deeply",
    )


#: Values of every kind, and of which fields (in order, joined) each is a good one.
KINDS = {
    "3": "state_cutoff radius slope",
    '"x"': "title axis",
    "true": "",
    "[]": "tables",
    "[3.0]": "",
    "nan": "",
    "[nan]": "",
    '[["x"]]': "",
    "{ a = 1 }": "",
}
FIELDS = [line for line in TOML.splitlines() if " = " in line]


@pytest.mark.parametrize("line", FIELDS)
def test_a_field_of_another_kind_or_name_is_named(line, tmp_path):
    key = line.split(" = ")[0]
    for value, good in KINDS.items():
        if key not in good.split():
            folder = problem_folder(
                tmp_path / "arm", TOML.replace(line, f"{key} = {value}", 1)
            )
            about = (
                "centre_of_mass_cone"
                if value == "nan" and key in ("radius", "slope")
                else key
            )
            refusal(
                lambda folder=folder: sdp.load_problem(folder), "problem.toml", about
            )
    folder = problem_folder(tmp_path / "arm", TOML.replace(line, f"my_{line}", 1))
    refusal(lambda: sdp.load_problem(folder), f"my_{key}' is unknown")
    folder = problem_folder(tmp_path / "arm", TOML.replace(f"{line}\n", "", 1))
    if key in ("gravity", "lower", "upper", "tables", "total_mass", "state_cutoff"):
        sdp.load_problem(folder)
    else:
        refusal(lambda: sdp.load_problem(folder), f"'{key}' is missing")


@pytest.mark.parametrize("case", refusals("bounds"))
def test_a_bad_table_of_bounds_is_refused(case, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = problem_folder(Path("arm"), bounds=refusals("bounds")[case][0])
    assert same_refusal("bounds", case, refusal(lambda: sdp.load_problem(folder)))


@pytest.fixture(scope="module")
def model(two_link, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "model.json"
    sdp.identify(two_link, small_run(two_link)).save(path)
    return path


def changed(model, path, change):
    data = json.loads(model.read_text())
    change(data)
    path.write_text(json.dumps(data))
    return path


def setter(*keys, value):
    def change(data):
        for key in keys[:-1]:
            data = data[key]
        data[keys[-1]] = value

    return change


@pytest.mark.parametrize("case", refusals("model"))
def test_a_bad_model_is_refused(case, model, tmp_path, monkeypatch):
    keys, value, _ = refusals("model")[case]
    monkeypatch.chdir(tmp_path)
    path = changed(model, Path("bad.json"), setter(*keys, value=value))
    assert same_refusal("model", case, refusal(lambda: sdp.load_estimate(path)))


def places(data, *keys):
    """The keys to each part of a tree of dicts, and of the first two entries of lists."""
    data = dict(enumerate(data[:2])) if isinstance(data, list) else data
    for key in data if isinstance(data, dict) else ():
        yield from ((*keys, key), *places(data[key], *keys, key))


@pytest.mark.parametrize(
    "value",
    [
        "x",
        *(pytest.param(x, marks=pytest.mark.long) for x in ([1.0], float("nan"), {})),
    ],
    ids=repr,
)
def test_a_part_of_a_model_of_another_kind_is_refused_or_does_not_matter(
    value, model, tmp_path
):
    path = tmp_path / "bad.json"
    said = {}
    for keys in places(json.loads(model.read_text())):
        try:
            sdp.load_estimate(changed(model, path, setter(*keys, value=value)))
        except sdp.InputError as error:
            said[".".join(map(str, keys))] = str(error)
    assert all(message.startswith(f"{path}: ") for message in said.values())
    joint = {f"robot.joints.0.{name}" for name in ("kind", "axis", "placement")}
    assert joint | {
        "problem",
        "parameters.0.value",
        "effects.1.effect",
        "robot.gravity",
    } <= {*said}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        *(
            (content, [])
            for content in (
                b"",
                b"{",
                b"{}",
                b"[]",
                b"3",
                b"\xff\xfe",
                b'{"format": "x"}',
            )
        ),
        (b"[" * 100_000, ["nested too deeply"]),
    ],
)
def test_files_that_are_no_models(content, words, tmp_path):
    path = tmp_path / "model.json"
    path.write_bytes(content)
    refusal(lambda: sdp.load_estimate(path), str(path), *words)


def test_an_archive_of_a_later_version_is_refused(tmp_path):
    box = np.ones((3, 2))
    path = tmp_path / "box.npz"
    np.savez(path, q=box, gravity=box, mass_matrix=np.ones((3, 2, 2)))
    content = path.read_bytes()
    at = content.index(b"PK\x01\x02") + 6  # "version needed" of the central directory
    path.write_bytes(content[:at] + b"\x40" + content[at + 1 :])
    assert load_answers([path]) is None
    refusal(lambda: sdp.load_measurements(path), "box.npz")


def test_numbers_that_no_sensor_resolves_are_zeros(two_link, tmp_path):
    run = small_run(two_link)
    tau = run.tau.copy()
    tau[3:9] = 5e-324
    save(replace(run, tau=tau), tmp_path / "run.csv")
    zeros = np.where(np.abs(tau) < 1e-30, 0.0, tau)
    for source in (tmp_path / "run.csv", replace(run, tau=tau)):
        assert np.array_equal(as_measurements(source).tau, zeros)
    assert as_measurements(run) is run


def ros1_chunk(compression, packed, claimed):
    fields = [
        b"op=\x05",
        b"compression=" + compression,
        b"size=" + struct.pack("<I", claimed),
    ]
    header = b"".join(struct.pack("<I", len(f)) + f for f in fields)
    return (
        struct.pack("<I", len(header))
        + header
        + struct.pack("<I", len(packed))
        + packed
    )


@pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="no limit of memory on this system"
)
@pytest.mark.parametrize("kind", ["npz", "mat", "parquet", "bz2", "lz4"])
def test_no_bomb_takes_more_than_its_size_allows(kind, tmp_path, monkeypatch):
    """64 MB of zeros, where reading may take 16: whatever sizes its headers claim."""
    monkeypatch.setattr(sdp.files, "_ROOM", 16 * 2**20)
    path = tmp_path / f"bomb.{kind}"
    zeros = np.zeros(2**23)
    if kind == "npz":
        np.savez_compressed(path, t=zeros)
    elif kind == "mat":
        savemat(path, {"t": zeros}, do_compression=True)
    elif kind == "parquet":
        import pyarrow
        from pyarrow import parquet

        parquet.write_table(
            pyarrow.table({"t": zeros, "q1": zeros, "tau1": zeros}), path
        )
    else:
        lz4 = pytest.importorskip("lz4.frame")
        packed = (
            bz2.compress(zeros.tobytes())
            if kind == "bz2"
            else lz4.compress(zeros.tobytes())
        )
        path = tmp_path / "bomb.bag"
        chunk = ros1_chunk(kind.encode(), packed, zeros.nbytes)
        path.write_bytes(b"#ROSBAG V2.0\n" + chunk)
    del zeros
    with peak_memory() as peak, pytest.raises(sdp.InputError):
        read_run(path)
    assert peak[0] < 36 * 2**20


def test_joints_behind_one_prefix_are_the_robots(two_link, tmp_path):
    run = replace(small_run(two_link, seconds=1.0), dq=None)
    write_bag(tmp_path / "bag", run, names=["panda_joint2", "panda_joint1"])
    read = read_run(tmp_path / "bag", 2, ["joint1", "joint2"])
    assert np.allclose(read.q, run.q)
    refusal(
        lambda: read_run(tmp_path / "bag", 2, ["axis1", "axis2"]),
        "there are: ",
        "panda_joint1",
    )
