"""A fact: one method, one definition, one text."""

import numpy as np
import pytest

from sdp_vs_penalty.results import Record, fact, facts_of


class Measured(Record):
    """Two joints, and something that is not known."""

    @fact("N m", digits=2)
    def joint_error(self) -> np.ndarray:
        """Root mean square of what is left."""
        return np.array([0.1234, 12.0])

    @fact("%")
    def share(self) -> float | None:
        """A share that nobody measured."""
        return None


def test_a_fact_is_a_number_with_its_text_unit_and_definition():
    found = Measured().facts()["joint_error"]
    assert Measured().joint_error[1] == 12.0
    assert found.texts == found.to_dict()["texts"] == ["0.12", "12"]
    assert found.text == "0.12, 12 N m"
    assert found.definition == "Root mean square of what is left."
    assert found.to_dict()["value"] == pytest.approx([0.1234, 12.0])


def test_what_is_not_known_is_a_dash():
    assert facts_of(Measured())["share"].text == "- %"


def test_every_fact_of_the_results_is_defined():
    from sdp_vs_penalty import Estimate
    from sdp_vs_penalty.checks import Report
    from sdp_vs_penalty.diagnosis import Diagnosis
    from sdp_vs_penalty.diagnosis.comparison import Comparison
    from sdp_vs_penalty.diagnosis.where_it_fails import Failures
    from sdp_vs_penalty.results import FactMethod
    from sdp_vs_penalty.simulation.follow import Following

    for kind in (Comparison, Diagnosis, Estimate, Failures, Following, Report):
        members = [x for base in kind.__mro__ for x in vars(base).values()]
        methods = [x for x in members if isinstance(x, FactMethod)]
        assert methods, kind
        assert all(method.__doc__ for method in methods), kind
