"""What a notebook shows: estimates, comparisons and tables as pandas frames."""

from small_runs import small_run

from sdp_vs_penalty import compare, identify
from sdp_vs_penalty.paper.tables.table import Column, Table


def test_frames_hold_the_same_numbers(two_link):
    run = small_run(two_link)
    estimate = identify(two_link, run)
    frame = estimate.to_frame()
    assert list(frame.index) == [p.name for p in estimate.model.parameters]
    assert frame.loc["m2", "value"] == estimate.theta[10]
    assert frame.loc["m2", "unit"] == "kg"
    comparisons = compare({"a": estimate, "b": estimate}, run)
    table = comparisons.to_frame()
    assert table.loc[("b", 2), "rmse"] == comparisons[1].rmse[1]


def test_table_frame_keeps_printed_digits():
    table = Table("X", "title", "caption", (Column("a"), Column("b")), (("1.50", 2.0), (None, 3.0)))
    frame = table.to_frame()
    assert frame["a"][0] == "1.50"
    assert frame["b"].sum() == 5.0
