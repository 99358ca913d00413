"""What is refused where a file enters, before anything is computed from it."""

import json
import warnings

import numpy as np
import pytest
from commands import run_cli
from small_runs import small_run

import sdp_vs_penalty as sdp
from sdp_vs_penalty.data import save

ARM = """<robot name="arm"><link name="base"/><link name="l"><inertial>
<mass value="{mass}"/><inertia ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0"
ixz="0" iyz="0"/></inertial></link><joint name="j" type="continuous"><parent
link="base"/><child link="l"/><axis xyz="0 1 0"/></joint></robot>"""


@pytest.fixture(scope="module")
def model(two_link):
    return json.loads(json.dumps(sdp.identify(two_link, small_run(two_link)).to_dict()))


def refusal(content, folder):
    path = folder / "model.json"
    text = content if isinstance(content, str) else json.dumps(content)
    path.write_text(text)
    with pytest.raises(sdp.InputError) as error:
        sdp.load_estimate(path)
    return str(error.value)


def test_a_field_that_comes_twice_is_refused(model, tmp_path):
    text = json.dumps(model)
    twice = text.replace("{", '{"format": 1, ', 1)
    assert "the field 'format' comes twice" in refusal(twice, tmp_path)


@pytest.mark.parametrize("method", [[1e308], 7, None, {"a": 1}, True])
def test_a_method_that_is_no_text_is_refused(method, model, tmp_path):
    assert "field method: expected a text" in refusal(
        {**model, "method": method}, tmp_path
    )


@pytest.mark.parametrize(
    "frame",
    [
        np.diag([1.0, 1.0, -1.0, 1.0]),
        np.diag([2.0, 1.0, 1.0, 1.0]),
        np.diag([1.0, 1.0, 1.0, 2.0]),
        np.eye(4) + 1e-3,
        np.zeros((4, 4)),
    ],
    ids=["left-handed", "stretched", "scaled", "sheared", "zero"],
)
@pytest.mark.parametrize("name", ["placement", "link_frame"])
def test_a_frame_that_is_no_rotation_is_refused(name, frame, model, tmp_path):
    changed = json.loads(json.dumps(model))
    changed["robot"]["joints"][1][name] = frame.tolist()
    assert "is no rotation with a shift" in refusal(changed, tmp_path)


def test_a_frame_a_light_year_away_is_refused(model, tmp_path):
    changed = json.loads(json.dumps(model))
    changed["robot"]["joints"][1]["placement"][0][3] = 1e200
    assert "holds numbers beyond 1e+09" in refusal(changed, tmp_path)


@pytest.mark.parametrize("mass", ["1e-200", "-1e-300", "5e-324"])
def test_a_mass_that_squares_lose_is_refused(mass, tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM.format(mass=mass, moment=1))
    with pytest.raises(sdp.InputError, match="kg is no link's"):
        sdp.load_problem(tmp_path / "arm.urdf")


def test_a_moment_that_squares_lose_is_zero(tmp_path):
    (tmp_path / "arm.urdf").write_text(ARM.format(mass=1, moment="1e-200"))
    problem = sdp.load_problem(tmp_path / "arm.urdf")
    assert problem.robot.n == 1


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".parquet"])
def test_names_without_rows_are_called_so(suffix, two_link, tmp_path):
    run = small_run(two_link)
    path = tmp_path / f"run{suffix}"
    save(run.rows(slice(0, 0)), path)
    with pytest.raises(sdp.InputError, match="there are no rows"):
        sdp.load_measurements(path)


@pytest.mark.parametrize("kind", ["q", "tau"])
def test_blocks_without_columns_are_called_so(kind, two_link, tmp_path):
    run = small_run(two_link)
    blocks = {"q": run.q, "tau": run.tau, kind: np.zeros((len(run.t), 0))}
    np.savez(tmp_path / "run.npz", t=run.t, **blocks)
    with pytest.raises(sdp.InputError, match="has no columns"):
        sdp.load_measurements(tmp_path / "run.npz")


def test_longer_numbers_make_no_warning(two_link, tmp_path):
    run = small_run(two_link)
    q = run.q.astype(np.longdouble)
    q[3, 1] = np.longdouble("1e400")
    np.savez(tmp_path / "run.npz", t=run.t, q=q, tau=run.tau)
    warnings.simplefilter("error", RuntimeWarning)  # pytest resets it
    with pytest.raises(sdp.InputError):
        sdp.load_measurements(tmp_path / "run.npz")


def test_torques_of_no_arm_are_refused(two_link, tmp_path):
    run = small_run(two_link)
    small = 1e-9 * run.tau / np.abs(run.tau).max()
    arrays = {"t": run.t, "q": run.q, "tau": small}
    with pytest.raises(sdp.InputError, match="less than any arm needs"):
        sdp.identify(two_link, arrays)


@pytest.mark.parametrize(
    "outputs",
    [
        "--out x.json --proof x.json",
        "--out x.json --proof ./x.json",
        "--out x.json --proof link.json",
        "--out a/../x.json --proof x.json",
        "--out before.json --proof hard.json",
    ],
)
def test_two_outputs_are_two_files(outputs, two_link, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link.json").symlink_to("x.json")
    (tmp_path / "before.json").write_text("before")
    (tmp_path / "hard.json").hardlink_to("before.json")
    save(small_run(two_link), tmp_path / "run.csv")
    words = f"identify two_link --data run.csv {outputs}".split()
    assert run_cli(*words) == 2
    assert "name the same file" in capsys.readouterr().err
    assert not (tmp_path / "x.json").exists()
    assert (tmp_path / "before.json").read_text() == "before"


def test_a_short_run_can_be_compared(two_link):
    run = small_run(two_link, seconds=1.0)
    estimate = sdp.identify(two_link, run, "ols")
    assert sdp.compare(estimate, run)


@pytest.fixture(scope="module")
def findings(two_link):
    run = small_run(two_link)
    return json.loads(
        json.dumps(sdp.diagnose(sdp.identify(two_link, run), run).to_dict())
    )


def load_findings(content, folder):
    from sdp_vs_penalty.diagnosis import load_diagnosis

    (folder / "findings.json").write_text(json.dumps(content))
    return load_diagnosis(folder / "findings.json")


def test_findings_name_their_format(findings, tmp_path):
    assert findings["format"] == 4
    assert load_findings(findings, tmp_path).to_dict() == findings


@pytest.mark.parametrize(
    ("number", "words"),
    [(5, "a newer version"), (1, "an earlier version"), ("1", "'1'"), (True, "True")],
)
def test_findings_of_another_format_are_refused(number, words, findings, tmp_path):
    with pytest.raises(sdp.InputError, match=words):
        load_findings({**findings, "format": number}, tmp_path)


@pytest.mark.parametrize("number", [0, 3, 1.5, "2", None, True, [2], 10**30])
def test_a_model_of_another_format_is_refused(number, model, tmp_path):
    assert "format" in refusal({**model, "format": number}, tmp_path)


@pytest.mark.parametrize("number", [1, 3])
def test_a_proof_of_another_format_is_refused_by_its_name(number, two_link, tmp_path):
    from sdp_vs_penalty.estimation import verify_proof_file

    sdp.identify(two_link, small_run(two_link), proof=tmp_path / "proof.json")
    text = (tmp_path / "proof.json").read_text()
    changed = text.replace("sdp-vs-penalty proof 2", f"sdp-vs-penalty proof {number}")
    (tmp_path / "proof.json").write_text(changed)
    holds, sentence = verify_proof_file(tmp_path / "proof.json")
    assert not holds
    assert f"its format is 'sdp-vs-penalty proof {number}'" in sentence


@pytest.mark.parametrize(
    "content",
    [
        "[]",
        "3",
        "{",
        '{"a": 1}',
        '{"a": {"hash": 3}}',
        '{"a": {}, "a": {}}',
        "[" * 9999,
    ],
)
def test_intervals_that_no_shootout_has_written_are_refused(content, tmp_path, capsys):
    (tmp_path / "references.json").write_text(content)
    problem = "two_link simulated one-step gyration"
    assert run_cli("shootout", "--problems", problem, "--out", tmp_path) == 2
    assert "holds no intervals of a shootout" in capsys.readouterr().err
