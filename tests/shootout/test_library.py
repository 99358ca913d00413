"""The library of instances: what is written is the problem, and its proofs are
accepted."""

import csv
import hashlib
from pathlib import Path

import numpy as np
import pytest
from commands import run_cli
from sdp_readers import read_cbf

from sdp_vs_penalty.solvers import reorder, verify_proof

#: One of each kind: formulations, cones, units, an optimum of zero, none at all.
NAMES = (
    "two_link simulated one-step plain",
    "two_link simulated two-step regulariser",
    "two_link simulated one-step cones",
    "chain of 2 links gyration 1",
    "two_link gram t km",
    "two_link noise-free",
    "two_link unidentifiable links",
    "two_link nearly infeasible 1e-6",
    "two_link infeasible 1e-6",
)


@pytest.fixture(scope="module")
def written(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Path, dict[str, dict[str, str]]]:
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
            np.testing.assert_array_equal(np.sort(made["c"]), np.sort(sent.q))
            np.testing.assert_allclose(
                np.sort(made["A_value"]), np.sort(sent.A.data), rtol=1e-15
            )
