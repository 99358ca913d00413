"""Logs as people have them: names, units, clocks, headers and numbers in other forms than
RUN.csv's; the same three joints come out of all of them."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from sdp_vs_penalty.data import Measurements, read_run
from sdp_vs_penalty.errors import Remark

JOINTS = ("turn", "shoulder", "elbow")
T = np.arange(60) * 0.01
Q = np.round(np.sin(np.outer(T, [3.0, 5.0, 7.0]) + [0.1, 0.2, 0.3]), 6)
TAU = np.round(30.0 * np.cos(np.outer(T, [4.0, 2.0, 6.0])), 6)
DEGREES = np.degrees(Q)
#: Joints in the order in which loggers sort them.
SORTED = [2, 1, 0]


def table(
    path: Path,
    heads: Sequence[str],
    *columns: np.ndarray,
    mark: str = ",",
    encoding: str = "utf-8",
) -> Path:
    """A text table of numbers or texts; ``heads`` are the lines above it."""
    cells = np.column_stack([np.asarray(c).astype("U40") for c in columns])
    lines = [*heads, *(mark.join(row) for row in cells)]
    path.write_text("\n".join(lines) + "\n", encoding=encoding)
    return path


def names_of(*patterns: str, joints: Sequence[object] = (1, 2, 3)) -> str:
    """Names of columns, a pattern after the other."""
    return ",".join(p.format(joint) for p in patterns for joint in joints)


def read(path: Path | str, joints: Sequence[str] | None = JOINTS) -> tuple[Measurements, str]:
    """A file's run, and what is said of it."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always", Remark)
        run = read_run(path, None, joints)
    return run, " ".join(str(w.message) for w in heard)


def require_the_run(run: Measurements, atol: float = 1e-7) -> None:
    np.testing.assert_allclose(run.q, Q, atol=atol)
    np.testing.assert_allclose(run.tau, TAU, atol=100.0 * atol)
    np.testing.assert_allclose(run.t - run.t[0], T, atol=2e-6)


@pytest.mark.parametrize(
    ("robot", "log"),
    [
        ("{}", "{}_joint"),
        ("{}_joint", "{}"),
        ("arm_{}_joint", "{}"),
        ("l_{}", "left_{}"),
        ("ur_{}_joint", "robot1_{}_motor"),
        ("{}", "{}"),
        ("{}", "LEFT-{}"),
    ],
)
@pytest.mark.parametrize("pattern", ["/joint_states/{}/{}", "{}_{}", "{}.{}"])
def test_joints_with_other_words_around_their_names_are_matched(
    pattern, robot, log, tmp_path
):
    joints = [log.format(JOINTS[k].capitalize()) for k in SORTED]
    heads = [pattern.format(j, x) for x in ("position", "effort") for j in joints]
    columns = (T, Q[:, SORTED], TAU[:, SORTED])
    path = table(tmp_path / "run.csv", [",".join(["__time", *heads])], *columns)
    require_the_run(read(path, [robot.format(j) for j in JOINTS])[0])


def test_joints_with_numbers_are_matched_by_these(tmp_path):
    heads = [f"/joint_states/a{k}/{x}" for x in ("position", "effort") for k in (3, 1, 2)]
    columns = (T, Q[:, [2, 0, 1]], TAU[:, [2, 0, 1]])
    path = table(tmp_path / "run.csv", [",".join(["__time", *heads])], *columns)
    require_the_run(read(path, ["joint_1", "joint_2", "joint_3"])[0])


def test_joints_of_other_names_stay_in_the_file_s_order_and_this_is_said(tmp_path):
    heads = "time," + names_of("{}_position", "{}_effort", joints=("hip", "knee", "toe"))
    path = table(tmp_path / "run.csv", [heads], T, Q, TAU)
    run, said = read(path)
    require_the_run(run)
    assert "joints hip, knee, toe in the file's order" in said
