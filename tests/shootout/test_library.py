"""The library of instances: what is written is the problem, and its proofs are
accepted."""

import csv
import hashlib
import json
import shutil
import subprocess

import numpy as np
import pytest
from commands import run_cli
from numpy.testing import assert_allclose, assert_array_equal
from recorded import refusal
from scipy.sparse import csc_matrix
from sdp_readers import read_cbf

from sdp_vs_penalty.shootout import catalogue, instance
from sdp_vs_penalty.shootout.answers import judge_answers
from sdp_vs_penalty.shootout.judge import classes
from sdp_vs_penalty.shootout.runner import Results
from sdp_vs_penalty.solvers import (
    Cone,
    ConicProblem,
    make_solver,
    reorder,
    verify_proof,
)
from sdp_vs_penalty.solvers.rewrite import linear_objective

#: One of each kind: formulations, cones, units, an optimum of zero, none at all.
NAMES = (
    "two_link simulated one-step plain",
    "two_link simulated two-step regulariser",
    "two_link simulated one-step cones",
    "chain of 2 links gyration 1",
    "two_link gram lb in",
    "two_link noise-free",
    "two_link unidentifiable links",
    "two_link nearly infeasible 1e-6",
    "two_link infeasible 1e-6",
)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("library")
    assert run_cli("shootout", "--export", folder, "--problems", ",".join(NAMES)) == 0
    with (folder / "index.csv").open() as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    assert set(rows) == set(NAMES)
    return folder, rows


def test_every_file_is_its_sum_and_every_proof_is_accepted(written):
    folder, rows = written
    for row in rows.values():
        place = folder / row["folder"]
        for name in ("problem.cbf", "problem.dat-s", "problem.npz"):
            there = place / name
            wanted = row[f"sha256 {name}"]
            assert there.is_file() == bool(wanted)
            if wanted:
                assert hashlib.sha256(there.read_bytes()).hexdigest() == wanted
        found = verify_proof.check(verify_proof.read(place / "proof.json"))
        if row["status"] == "proved infeasible":
            assert found is None
            assert row["difficulty"] == "proved infeasible"
        else:
            assert found is not None
            assert [float(x) for x in found] == [
                float(row["lower"]),
                float(row["upper"]),
            ]
    assert rows["two_link infeasible 1e-6"]["status"] == "proved infeasible"
    assert not rows["two_link simulated two-step regulariser"]["sha256 problem.dat-s"]


def test_arrays_are_the_problem_of_the_text(written):
    folder, rows = written
    kinds = ("zero", "nonnegative", "soc", "exp", "psd")
    for row in rows.values():
        place = folder / row["folder"]
        sent = reorder(read_cbf(place / "problem.cbf"), kinds).problem
        with np.load(place / "problem.npz") as made:
            P = csc_matrix(
                (made["P_value"], (made["P_row"], made["P_column"])), made["P_shape"]
            )
            cones = zip(made["cone_kinds"], made["cone_sizes"], strict=True)
            posed = ConicProblem(
                P,
                made["c"],
                csc_matrix(
                    (made["A_value"], (made["A_row"], made["A_column"])),
                    made["A_shape"],
                ),
                made["b"],
                tuple(Cone(str(kind), int(size)) for kind, size in cones),
            )
        linear = linear_objective(posed).problem
        assert_array_equal(np.sort(linear.q), np.sort(sent.q))
        assert_allclose(np.sort(linear.A.data), np.sort(sent.A.data), rtol=1e-15)


def test_what_judges_an_answer_stands_beside_the_file(written):
    """Hash, centre, scales, an interior point, and what errors are relative to."""
    folder, rows = written
    for name, row in rows.items():
        text = (folder / row["folder"] / "problem.cbf.json").read_text()
        about = json.loads(text)
        made = instance(name)
        assert about["hash"] == row["hash"] == made.hash
        assert_array_equal(about["centre"], made.sdp.centre)
        assert_array_equal(about["theta_scale"], made.sdp.theta_scale)
        if row["status"] == "proved infeasible":
            assert about["interior"] is None
            continue
        inside = np.array(about["interior"])
        assert min(c.margin(inside) for c in made.constraints.convex) > 0.0
        loss = max(about["upper"], made.least_loss)
        assert about["relative_to"] == pytest.approx(loss, rel=1e-6) or row[
            "name"
        ].endswith("regulariser")


def answers(path, *items):
    path.write_text(json.dumps({"answers": list(items)}))
    return path


@pytest.mark.long
def test_answers_made_elsewhere_are_judged_from_the_files_of_the_library(
    written, tmp_path
):
    """By Clarabel from the text of the CBF file, by csdp from that of the SDPA file."""
    folder, rows = written
    name = "chain of 2 links gyration 1"
    place = folder / rows[name]["folder"]
    x = make_solver("clarabel").solve(read_cbf(place / "problem.cbf"), 1e-9).x
    item = {"problem": name, "claimed": "optimal", "hash": rows[name]["hash"]}
    items = [
        item | {"solver": "outsider", "x": x.tolist(), "seconds": 0.5},
        item | {"solver": "wrong", "x": (1.01 * x).tolist()},
        item | {"solver": "modest", "claimed": "failed"},
    ]
    if shutil.which("csdp"):
        there = str(place / "problem.dat-s")
        subprocess.run(["csdp", there, "answer"], cwd=tmp_path, capture_output=True)
        first = (tmp_path / "answer").read_text().splitlines()[0]
        numbers = [float(word) for word in first.split()]
        items.append(item | {"solver": "by file", "x": numbers})
    file = answers(tmp_path / "answers.json", *items)
    out = tmp_path / "out"
    assert run_cli("shootout", "judge", file, "--out", out) == 0
    runs = Results(out).runs
    said = dict(zip(runs["solver"], classes(runs, 1e-6), strict=True))
    expected = {"outsider": "right", "wrong": "far_unchecked", "modest": "failed"}
    if shutil.which("csdp"):
        expected["by file"] = "right"
    assert said == expected


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"hash": "0" * 16}, "in the answers"),
        ({"solver": "clarabel"}, "is a contestant"),
        ({"claimed": "solved"}, "claim"),
        ({"problem": "drawn"}, "problem"),
        ({"seconds": "long"}, "seconds"),
        ({"x": [1.0, 2.0]}, "2 numbers"),
        ({"x": {"a": 1}}, "x"),
        ({"problem": 3}, "problem"),
    ],
    ids=lambda x: "-".join(x) if isinstance(x, dict) else "",
)
def test_answers_to_something_else_are_refused(written, tmp_path, change, said):
    """Nothing is judged, and nothing is written."""
    item = {
        "problem": "two_link simulated one-step gyration",
        "solver": "outsider",
        "claimed": "optimal",
        "theta": [0.0] * 20,
    }
    if "x" in change:
        item.pop("theta")
    file = answers(tmp_path / "answers.json", item | change)
    refusal(lambda: judge_answers([file], tmp_path / "o", lambda text: None), said)
    assert not (tmp_path / "o" / "runs.csv").exists()


def test_an_export_says_what_it_leaves_out(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(catalogue, "real_data_folder", lambda: None)
    monkeypatch.setattr(
        "sdp_vs_penalty.shootout.library.write_instance",
        lambda folder, item, made: {"name": item.name, "status": "not proved"},
    )
    measured = "emps measured one-step plain"
    words = ("shootout", "--export", tmp_path / "a", "--problems")
    assert run_cli(*words, measured) == 2
    assert "are absent" in capsys.readouterr().err
    assert run_cli(*words, "emps+plain") == 0
    assert f"left out: {measured}" in " ".join(capsys.readouterr().err.split())


def test_the_benchmark_of_benchopt_is_a_program(written):
    """Its three files; that benchopt runs them was tried by hand (1.10)."""
    folder, _ = written
    names = ("objective.py", "datasets/library.py", "solvers/clarabel.py")
    for name in names:
        compile((folder / "benchopt" / name).read_text(), name, "exec")
