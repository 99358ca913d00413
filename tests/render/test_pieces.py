"""Pieces of HTML that report and page share."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sdp_vs_penalty.render import bars, heat_map
from sdp_vs_penalty.render.charts import mean_curve, spread_rows
from sdp_vs_penalty.signals.reversals import since_reversal

UNITS = ["N*m"] * 4


@pytest.mark.parametrize("largest", [2.0, 40.0])
@pytest.mark.parametrize("floor", [[1.0] * 4, None])
def test_all_bars_have_one_kind_of_scale(largest, floor):
    assert "logarithmic" in bars([1.0, 1.2, 1.1, largest], None, floor, UNITS)


def test_bars_say_multiples_and_newton_metres():
    drawn = bars([0.065, 0.3, 0.3, 0.3], None, [0.0042, 0.3, 0.3, 0.3], UNITS)
    assert "15.5<small>0.065 N m</small>" in drawn


def test_a_heat_map_escapes_its_names():
    drawn = heat_map("<script>", [("<b>", [0.5])], 1)
    assert "<b>" not in drawn
    assert "<script>" not in drawn


def test_time_is_counted_from_the_nearest_reversal():
    t = np.arange(0.0, 2.0, 0.1)
    velocity = np.where(t < 0.95, -1.0, 1.0)
    seconds, direction = since_reversal(t, velocity)
    assert_allclose(seconds, t - 0.95)
    assert np.all(direction == 1.0)


def test_a_motion_without_reversal_is_far_from_one():
    seconds, _ = since_reversal(np.arange(3.0), np.ones(3))
    assert np.all(np.isinf(seconds))


def test_a_mean_curve_runs_through_a_line():
    x = np.linspace(0.0, 1.0, 480)
    centres, means = mean_curve(x, 2.0 * x)
    assert_allclose(means, 2.0 * centres)


def test_rows_are_spread_from_the_first_to_the_last():
    rows = spread_rows(10_000, 100)
    assert (rows[0], rows[-1], len(rows)) == (0, 9_999, 100)


def test_a_drawn_arm_has_the_axes_of_its_joints(two_link):
    from sdp_vs_penalty.render.arms import drawn_arm

    drawn = drawn_arm(two_link.robot, two_link.nominal_links)
    axes = [joint["axis"] for joint in drawn["joints"]]
    assert np.array_equal(axes, [joint.axis for joint in two_link.robot.tree])


def test_no_change_is_told_below_the_noise():
    """An error below its noise shows that this is an upper bound."""
    drawn = bars([0.8, 4.0], [0.2, 2.0], [1.0, 1.0], ["N m", "N m"])
    assert drawn.count("at most that") == 1
    assert "-75 %" not in drawn
    assert "-50 %" in drawn
    known = bars([1.8, 4.0], [1.2, 2.0], [1.0, 1.0], ["N m", "N m"])
    assert "at most that" not in known


def test_each_figure_of_two_choices_stands_under_the_colours_of_its_bars():
    """Amounts are those of the first choice: the other one has a column for itself."""
    now, first, second = [4.0, 3.0], [2.0, 3.0], [3.0, 1.5]
    drawn = bars(now, first, [1.0, 1.0], ["N m", "N m"], other=second)
    head, _, rows = drawn.partition("<tbody>")
    columns = re.findall(r"<th.*?</th>", head)
    colours = [re.findall(r'chip (\w+)"', column) for column in columns]
    assert colours == [["before", "after"], ["after"], ["other"]]
    assert re.findall(r"<td class=.change.*?>(.*?)</td>", rows) == [
        *("-50 %", "-25 %"),
        *("0 %", "-50 %"),
    ]


def test_bars_mark_what_is_good_also_where_all_of_it_is():
    drawn = bars([1.5, 1.2], None, [1.0, 1.0], ["N m", "N m"])
    places = {
        kind: float(place)
        for kind, place in re.findall(r'class="(\w+)" style="--wide:([\d.]+)', drawn)
    }
    assert places["noise"] < places["alone"] < places["limit"] < 1.0
    assert "dashed: good up to 2" in drawn
