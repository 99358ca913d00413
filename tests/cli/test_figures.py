"""What commands print and write, of small runs: sessions from the first check to the export."""

import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import THREE, write_urdf
from commands import run_cli
from recorded import changed, said
from servo_log import EFFECTS, log, write_slide
from small_runs import small_run

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.cli import console
from sdp_vs_penalty.data import save
from sdp_vs_penalty.simulation import hidden_runs

#: Each command goes on from the files of those before.
SESSIONS = {
    "of two links": """
        check run1.csv run2.csv --problem two_link --json checked.json
        check flipped.csv run2.csv --problem two_link --gravity 0,0,-9.81 --fix fixed
        identify two_link --data run1.csv run2.csv --bounds m2=1:5,total=:40 --out model.json
        add model.json joint_spring:2 --data run1.csv run2.csv --test test.csv --out model2.json
        compare model.json model2.json --data test.csv --verbose --json compared.json
        compare model.json --data test.csv --window 0.5:3,4:7.5
        cross-validate two_link --data run1.csv run2.csv --method ols --folds 3 --json folds.json
        simulate model2.json --follow test.csv --json ahead.json
        convert run1.csv --out columns.csv --rename tau1=tau2,tau2=tau1 --scale q=deg
        export model2.json --out arm.xml
        export model2.json --out effects.json
        report model.json model2.json --data test.csv --out report.html
    """,
    "of a search": """
        identify two_link --data run1.csv run2.csv --method ols --filters 15,20 --out ols.json
        diagnose ols.json --data run1.csv run2.csv --test test.csv --json findings.json
        add ols.json --from findings.json --data run1.csv --test test.csv --frozen --out two.json
        diagnose ols.json --data run1.csv --frozen --verbose
    """,
    "of lists and motions": """
        excite two_link --iterations 2 --seed 1 --duration 5 --out motion.csv
        excite two_link --iterations 2 --objective condition --harmonics 3 --out motion2.csv
        simulate two_link --hide joint_spring:1 --seed 3 --level weak --out made
        list problems
        list methods
        list solvers
        list datasets
        list exports
        list tables
        list effects stribeck_friction
    """,
    "of a load": """
        check-urdf arm.urdf --json links.json
        check run.csv heavy.csv --problem arm.urdf
        identify arm.urdf --data run.csv --known-load heavy.csv:1.5 --no-check --out model.json
        identify arm.urdf --data run.csv --gain-uncertainty 0.05 --out gains.json
        compare model.json gains.json --data heavy.csv
        add gains.json payload --data heavy.csv --out loaded.json
        excite loaded.json --payload --joints 2+3 --iterations 1 --out weigh.csv
        export loaded.json --out load.script
        export gains.json --out new.urdf --urdf arm.urdf
    """,
    "of a servo": f"""
        identify slide.urdf --data servo.csv --effects {EFFECTS} --out model.json
        identify slide.urdf --data silent.csv --effects {EFFECTS} --known m1=3.0 --out silent.json
        compare silent.json --data silent.csv --window 0:5
        export silent.json --out slide.xml
        export silent.json --out slide.h
        report silent.json --data silent.csv --out report.html
    """,
}  # fmt: skip
#: Of JSON files, what changes from day to day.
PASSING = {"provenance", "data_hash", "seconds", "versions", "solver_said"}


def write_files(folder: Path) -> None:
    """The robots and runs of all sessions."""
    springy = [("joint_spring", [1])]
    hidden = hidden_runs.hidden_runs(load_problem("two_link"), springy, "strong", seed=5)
    runs = dict(zip(("run1.csv", "run2.csv", "test.csv"), hidden.runs, strict=False))
    runs["flipped.csv"] = replace(hidden.runs[0], tau=hidden.runs[0].tau * [1.0, -1.0])
    problem, links = load_problem(write_urdf(folder / "arm.urdf", "arm", THREE)), np.zeros((3, 10))
    links[-1] = 1.5 * np.array([1.0, 0.05, -0.02, 0.1, 0.013, 0, 0.013, 0, 0, 0.005])
    runs["run.csv"], heavy = (replace(small_run(problem, 16.0, k), dq=None) for k in (0, 1))
    rates = np.gradient(heavy.q, heavy.t, axis=0)
    more = problem.robot.inverse_dynamics(links, heavy.q, rates, np.gradient(rates, heavy.t, axis=0))
    runs["heavy.csv"] = replace(heavy, tau=heavy.tau + more)
    runs["servo.csv"] = log(1e-4, ki=700.0, delay=0.02, torque=True)
    runs["silent.csv"] = log(1e-4, kh=50.0, ki=500.0, delay=0.02)
    for name, run in runs.items():
        save(run, folder / name)
    write_slide(folder)


def kept(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: kept(x) for k, x in value.items() if k not in PASSING}
    return [*map(kept, value)] if isinstance(value, list) else value


@pytest.mark.parametrize("session", SESSIONS)
def test_figures_are_what_they_were(session, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("time.perf_counter", lambda: 0.0)
    monkeypatch.setattr(hidden_runs, "DURATION", 12.0)
    monkeypatch.setattr(console.out, "_width", 100)
    write_files(tmp_path)
    found: dict[str, Any] = {}
    for line in SESSIONS[session].strip().splitlines():
        before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
        code = run_cli(*shlex.split(line))
        out, err = capsys.readouterr()
        assert code < 2, err
        new = [p for p in sorted(tmp_path.iterdir()) if before.get(p) != p.stat().st_mtime_ns]
        found[line.strip()] = {"code": code, "printed": said(out), "heard": said(err)} | {
            p.name: kept(json.loads(p.read_text())) if p.suffix == ".json" else said(p.read_text())
            for p in new
            if p.is_file() and p.suffix != ".html"
        }
    assert not changed(f"commands {session}".replace(" ", "_"), found)
