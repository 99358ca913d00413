"""A small challenge: a handful of cases end to end, the report, and the real Panda run."""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis import diagnose
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.identify import identify
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.simulation.challenge.cases import CLASSES
from sdp_vs_penalty.simulation.challenge.challenge import VERSION, run_case, run_challenge
from sdp_vs_penalty.simulation.challenge.report import (
    abstained,
    counted,
    false_claim,
    first_right,
    in_set,
    write_report,
)


def test_a_small_challenge_is_won() -> None:
    """Library effects at strong and medium, of which one may be missed; clean and unknown: none."""
    records = [
        run_case("panda", f"{name}/{seed}") for name, seed in (("strong", 9003), ("medium", 9016))
    ]
    records += [
        run_case("two_link", f"{name}/{seed}") for name in ("strong", "medium") for seed in (1, 2)
    ]
    shown = [r for r in records if counted(r)]
    assert len(shown) >= 3
    assert sum(first_right(r) for r in shown) >= len(shown) - 1
    assert sum(in_set(r) for r in shown) >= len(shown) - 1
    assert not any(false_claim(run_case("two_link", f"clean/{seed}")) for seed in (1, 2))
    assert abstained(run_case("panda", "unknown_strong/9001"))


def test_a_challenge_goes_on_where_it_stopped(tmp_path: Path) -> None:
    written = run_challenge("two_link", 1, 5, tmp_path, jobs=1, classes=["clean", "weak"])
    assert [p.name for p in written] == ["challenge.json", "challenge.csv", "challenge.md"]
    first = json.loads(written[0].read_text())
    first["cases"] = {k: {**v, "seconds": 123.0} for k, v in first["cases"].items()}
    written[0].write_text(json.dumps(first))
    run_challenge("two_link", 1, 5, tmp_path, jobs=1, classes=["clean", "weak"])
    assert json.loads(written[0].read_text()) == first
    assert "worst 123.00" in written[2].read_text()
    assert "Wilson" in written[2].read_text()


def test_an_unknown_class_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="class 'magic' is unknown"):
        run_challenge("two_link", 1, 0, tmp_path, classes=["magic"])


RESULTS = Path(__file__).parents[2] / "results"


def committed_cases() -> dict[str, dict[str, Any]]:
    kept = json.loads((RESULTS / "challenge.json").read_text())
    assert kept["version"] == VERSION
    return kept["cases"]


def test_the_committed_report_is_made_from_the_committed_cases(tmp_path: Path) -> None:
    records = committed_cases()
    text = (RESULTS / "challenge.md").read_text()
    cases, seed = map(int, re.findall(r"--cases (\d+) --seed (\d+)", text)[0])
    per_class = Counter(r["class"] for r in records.values())
    assert set(per_class) == set(CLASSES)
    assert set(per_class.values()) == {cases}
    for written in write_report(records, tmp_path, "panda", cases, seed):
        assert written.read_text() == (RESULTS / written.name).read_text()


@pytest.mark.reproduce
@pytest.mark.parametrize("name", CLASSES)
def test_cases_of_the_challenge_come_out_as_committed(name: str) -> None:
    """One case a class again, to the digits that are kept of it."""
    key, record = next((k, r) for k, r in committed_cases().items() if r["class"] == name)
    again = run_case("panda", key)
    for field in ("truth", "verdict", "events", "found", "energy", "floor", "after"):
        assert again[field] == approximately(record[field]), field


def approximately(value: Any) -> Any:
    """pytest.approx through lists and dictionaries, for processors that round otherwise."""
    if isinstance(value, float):
        return pytest.approx(value, rel=1e-3, abs=1e-12)
    if isinstance(value, dict):
        return {k: approximately(v) for k, v in value.items()}
    return [approximately(v) for v in value] if isinstance(value, list) else value


@pytest.mark.real_data
def test_the_real_panda_misses_presliding_hysteresis(panda: Problem, panda_run: Measurements) -> None:
    train, test = panda_run.window(0.0, 14.0), panda_run.window(14.2, 100.0)
    effects = "rigid_body,viscous_friction,coulomb_friction,torque_offset"
    estimate = identify(panda, train, "ols", effects=effects)
    result = diagnose(estimate, train, test)
    first = result.effects[0]
    assert (first.effect, first.joints) == ("presliding_hysteresis", (7,))
    assert first.shape["d"] == pytest.approx(0.003, abs=0.001)
    assert first.held_out_rmse_after[6] < 0.55 * first.held_out_rmse_before[6]
    early = {f.joints[0] for f in result.effects[:4] if f.effect == "presliding_hysteresis"}
    assert early == {4, 5, 6, 7}
    assert (result.held_out_rmse / first.held_out_rmse_before).mean() < 0.82
