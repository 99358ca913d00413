"""What a change of the model does, in words."""

import numpy as np

from sdp_vs_penalty.estimation.outcome import OfferOutcome


def outcome(before, after):
    """An outcome in N m above a noise of 0.01."""
    n = len(before)
    floor, units = np.full(n, 0.01), ["N*m"] * n
    return OfferOutcome(np.array(before), np.array(after), floor, units)


def test_a_rise_of_the_joint_that_errs_most_is_said():
    assert outcome([1.0, 0.5], [1.1, 0.5]).in_words(1) == (
        "joint 1 errs more: 1 → 1.1 N*m (+10 %)"
    )
    beside = outcome([1.0, 0.5], [1.1, 0.25]).in_words(1)
    assert beside.startswith("joint 2's error: 0.5 → 0.25 N*m (-50 %)")
    assert "joint 1 errs more: 1 → 1.1 N*m (+10 %)" in beside
    assert "does not gain" not in beside


def test_a_joint_that_stays_does_not_gain():
    assert "joint 1, which errs most, does not gain" in (
        outcome([1.0, 0.5], [1.0, 0.25]).in_words(1)
    )


def test_no_rise_is_denied_beside_one():
    """Up to 5 %, or below the noise, a rise is none that counts: the limit is said."""
    assert outcome([1.0, 0.5], [0.5, 0.5]).in_words(1).endswith("; no joint errs more")
    small = outcome([1.0, 0.5], [0.5, 0.51]).in_words(1)
    assert small.endswith("; no joint errs more by more than 5 %")
    below = outcome([1.0, 0.005], [0.5, 0.008]).in_words(1)
    assert below.endswith("; no joint errs more beyond its noise")
