"""Bars cut at the noise floor, a finding's joint lit, causes that explain nothing hidden."""

import re

import pytest

from sdp_vs_penalty.reports.pictures import bars

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
