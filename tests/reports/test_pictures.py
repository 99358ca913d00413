"""Bars cut at the noise floor, a finding's joint lit, causes that explain nothing hidden."""

import re
from types import SimpleNamespace

import pytest

from sdp_vs_penalty.reports.pictures import bars, found_shares, heat_map, heat_rows, legend, shades

UNITS = ["N*m", "N*m"]


def test_bars_are_errors_over_noise_cut_at_the_floor():
    drawn = bars([0.1, 1.25], [0.11, 0.46], [0.1, 0.1], UNITS)
    assert re.findall(r"<td class=\"number\">(.*?)</td>", drawn) == ["1 → 1.1", "12.5 → 4.6"]
    assert re.findall(r'class="change (\w+)">(.*?)<', drawn) == [("worse", "+10 %"), ("better", "-63 %")]
    (floor,) = {float(x) for x in re.findall(r'class="noise" style="--wide:([\d.]+)', drawn)}
    widest = max(float(x) for x in re.findall(r'class="before"[^>]*--wide:([\d.]+)', drawn))
    assert floor / widest == pytest.approx(1.0 / 12.5, rel=0.01)
    alone = bars([0.1, 1.25], None, None, UNITS)
    assert "noise floor unknown" in alone
    assert 'class="noise"' not in alone
    assert "1.25 N m" in alone


def test_a_confident_finding_is_lit_by_construction():
    found = SimpleNamespace(effect="presliding_hysteresis", joints=(2,), confidence="confident")
    found.held_out_rmse_before, found.held_out_rmse_after = [1.0, 2.0], [0.9, 1.0]
    weak = SimpleNamespace(**{**vars(found), "effect": "spring", "confidence": "weak"})
    shares = found_shares(SimpleNamespace(effects=[found, weak]), 2)
    assert shares == {"found: presliding_hysteresis": [0.0, pytest.approx(0.75)]}
    failures = [{"held_out_shares": {"reversal": 0.5, "time": 0.004}} for _ in range(2)]
    rows = heat_rows(failures, shares)
    assert [name for name, _ in rows] == ["found: presliding_hysteresis", "reversal"]
    assert ">75<" in heat_map("model", rows, 2)
    assert "No cause explains" in heat_map("model", [], 2)


def test_stretches_are_shaded_on_each_axis():
    drawn = shades([(1.0, 2.0, "reversal")], ("x", "x2"))
    assert [(s["xref"], s["yref"], s["x0"], s["x1"]) for s in drawn] == [
        ("x", "y domain", 1.0, 2.0),
        ("x2", "y2 domain", 1.0, 2.0),
    ]
    assert "reversal" in legend(["reversal"])
    assert legend([]) == ""
