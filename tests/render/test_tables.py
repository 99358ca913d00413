"""Tables are lists of facts: a column each, a row for each joint or each model."""

from dataclasses import dataclass

from sdp_vs_penalty.render.tables import joint_table, model_table
from sdp_vs_penalty.results import Record, fact


@dataclass
class Judged(Record):
    """Two joints of one model."""

    errors: list[float]
    noise: list[float] | None

    @fact("N m or N", column="error", per_joint=True)
    def error(self):
        """Root mean square."""
        return self.errors

    @fact("N m or N", name="noise floor", column="noise floor", per_joint=True)
    def floor(self):
        """Standard deviation of the noise."""
        return self.noise

    @fact(column="links can exist")
    def links(self):
        """Whether they can."""
        return True

    @fact("%", column="error [%]")
    def relative(self):
        """Of all joints."""
        return 12.345

    @fact("s")
    def seconds(self):
        """A fact that is no column."""
        return 3.0


BEFORE = Judged([1.0, 2.0], [0.1, 0.2])
AFTER = Judged([0.5, 2.0], None)


def test_one_model_has_its_facts_joint_by_joint():
    table = joint_table({"": BEFORE.facts()}, ["rad", "N*m"])
    assert list(table.headings) == ["joint", "error", "noise floor"]
    assert table.rows == [["1 [rad]", "1", "0.1"], ["2 [N m]", "2", "0.2"]]


def test_errors_of_two_models_stand_side_by_side_and_what_is_unknown_is_a_dash():
    table = joint_table({"a": BEFORE.facts(), "b": AFTER.facts()}, ["N", "N"])
    heads = ["joint", "error a", "error b", "change", "noise floor a", "noise floor b"]
    assert list(table.headings) == heads
    assert table.rows[0] == ["1 [N]", "1", "0.5", "-50 %", "0.1", "-"]


def test_the_change_of_several_models_says_which_two():
    facts = {"a": BEFORE.facts(), "b": BEFORE.facts(), "c": AFTER.facts()}
    assert joint_table(facts, ["N", "N"]).headings[4] == "change a to c"


def test_what_is_the_same_of_two_models_stands_once():
    table = joint_table({"a": BEFORE.facts(), "b": BEFORE.facts()}, ["N", "N"])
    assert list(table.headings)[-1] == "noise floor"


def test_models_are_rows_and_one_that_was_not_judged_says_why():
    table = model_table([("a", "good", BEFORE.facts()), ("b", "refused", {})])
    assert list(table.headings) == ["model", "verdict", "links can exist", "error [%]"]
    assert table.rows == [("a", "good", "yes", "12.3"), ("b", "refused", "", "")]
    assert table.numeric() == [False, False, False, True]


def test_a_data_frame_holds_the_facts_of_the_joints():
    frame = AFTER.to_frame()
    assert list(frame) == ["error [N m or N]", "noise floor [N m or N]"]
    assert frame["error [N m or N]"][1] == 0.5
    assert frame["noise floor [N m or N]"].isna().all()


def test_a_fact_has_the_unit_of_its_method():
    assert BEFORE.facts()["seconds"].text == "3 s"
