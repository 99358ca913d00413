"""What commands print and write, of small runs: sessions from the first check to the
export."""

import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import THREE, write_urdf
from commands import run_cli
from recorded import HOME, changed, said
from servo_log import log, write_slide
from small_runs import small_run

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.cli import console
from sdp_vs_penalty.data import save
from sdp_vs_penalty.simulation import hidden_runs
from sdp_vs_penalty.solvers import solver_types

#: Snapshots: the golden cases ask the same of the default run.
pytestmark = pytest.mark.nightly

#: Commands in order, each going on from the files of those before: the names of what is
#: kept of them.
SESSIONS = {
    path.stem: [*json.loads(path.read_text())]
    for path in sorted(HOME.glob("commands_*.json"))
}
#: Solvers that were installed where the list of solvers was recorded.
RECORDED_WITH = (
    "clarabel",
    "csdp",
    "cvxopt",
    "dsdp",
    "qics",
    "scs",
    "sdpa",
    "sdpa-program",
)
#: Of JSON files, what changes from day to day.
PASSING = {"provenance", "data_hash", "seconds", "versions", "solver_said"}


def write_files(folder: Path) -> None:
    """The robots and runs of all sessions."""
    springy = [("joint_spring", [1])]
    hidden = hidden_runs.hidden_runs(
        load_problem("two_link"), springy, "strong", seed=5
    )
    runs = dict(zip(("run1.csv", "run2.csv", "test.csv"), hidden.runs, strict=False))
    runs["flipped.csv"] = replace(hidden.runs[0], tau=hidden.runs[0].tau * [1.0, -1.0])
    problem = load_problem(write_urdf(folder / "arm.urdf", "arm", THREE))
    links = np.zeros((3, 10))
    links[-1] = 1.5 * np.array([1.0, 0.05, -0.02, 0.1, 0.013, 0, 0.013, 0, 0, 0.005])
    runs["run.csv"], heavy = (
        replace(small_run(problem, 16.0, k), dq=None) for k in (0, 1)
    )
    rates = np.gradient(heavy.q, heavy.t, axis=0)
    more = problem.robot.inverse_dynamics(
        links, heavy.q, rates, np.gradient(rates, heavy.t, axis=0)
    )
    runs["heavy.csv"] = replace(heavy, tau=heavy.tau + more)
    runs["servo.csv"] = log(1e-4, ki=700.0, delay=0.02, torque=True)
    runs["silent.csv"] = log(1e-4, kh=50.0, ki=500.0, delay=0.02)
    for name, run in runs.items():
        save(run, folder / name)
    write_slide(folder)
    tree = (Path(__file__).parents[1] / "exporters" / "tree.urdf").read_bytes()
    spoiled = {
        "bad": ("0.02", "0.05"),
        "wide": ("90", "160"),
        "light": ("-0.01", "0.01"),
    }
    for name, (across, along) in spoiled.items():
        words = (
            (b"ixx", b"0.02", across),
            (b"iyy", b"0.02", across),
            (b"izz", b"0.01", along),
        )
        text = tree
        for key, old, new in words:
            text = text.replace(key + b'="' + old, key + b'="' + new.encode(), 1)
        (folder / f"{name}.urdf").write_bytes(text)


def kept(value: Any) -> Any:
    """Of the factor of a covariance this: the signs of its columns are the processor's
    choice."""
    if isinstance(value, dict):
        value = {
            k: np.array(x) @ np.array(x).T if k == "spread" else x
            for k, x in value.items()
        }
        return {k: kept(x) for k, x in value.items() if k not in PASSING}
    return [*map(kept, value)] if isinstance(value, list) else value


def skip_without_solvers() -> None:
    """The list of solvers says which are installed."""
    for name in RECORDED_WITH:
        absent = solver_types()[name]().absent
        if absent:
            pytest.skip(f"solver {name} is absent: {absent}")


@pytest.mark.parametrize("session", SESSIONS)
def test_figures_are_what_they_were(session, tmp_path, monkeypatch, capsys):
    if any(line.startswith("list solvers") for line in SESSIONS[session]):
        skip_without_solvers()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("time.perf_counter", lambda: 0.0)
    monkeypatch.setattr(hidden_runs, "DURATION", 12.0)
    monkeypatch.setattr(console.out, "_width", 100)
    write_files(tmp_path)
    found: dict[str, Any] = {}
    for line in SESSIONS[session]:
        before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
        code = run_cli(*shlex.split(line))
        out, err = capsys.readouterr()
        assert code < 2, err
        new = [
            p
            for p in sorted(tmp_path.iterdir())
            if before.get(p) != p.stat().st_mtime_ns
        ]
        found[line] = {"code": code, "printed": said(out), "heard": said(err)} | {
            p.name: kept(json.loads(p.read_text()))
            if p.suffix == ".json"
            else said(p.read_text())
            for p in new
            if p.is_file() and p.suffix not in (".html", ".mat")
        }
    assert not changed(session, found)
