"""The paper's tables against each other: what follows from what, and where they contradict."""

import numpy as np
import pytest

from sdp_vs_penalty import InputError, Problem
from sdp_vs_penalty.problem import published_links
from sdp_vs_penalty.problem.published import published_cell, published_values
from sdp_vs_penalty.regression.base_parameters import base_parameters
from sdp_vs_penalty.robot import inertia

#: Rows of Table III whose pi(p_hat) the paper leaves empty (erratum 8).
EMPTY = {8, 24}


def pi_p_hat(problem: Problem, corrected: bool) -> np.ndarray:
    base, _ = base_parameters(problem.model(), problem.independent)
    return base @ published_links(problem, "p_hat", corrected).ravel()


def rows_that_differ(problem: Problem, pi: np.ndarray, corrected: bool) -> set[int]:
    """Rows of Table III that do not come out as printed, at the four digits printed."""
    out = set()
    for row, value in zip(problem.published["table_III"], pi, strict=False):
        text = published_cell(problem, "table_III", row, "pi_p_hat", corrected)
        if text and f"{value:.4f}".replace("-0.0000", "0.0000") != f"{float(text):.4f}":
            out.add(int(row["row"]))
    return out


def test_with_the_corrections_every_printed_digit_follows(panda):
    assert rows_that_differ(panda, pi_p_hat(panda, True), corrected=True) == set()


def test_as_printed_the_known_rows_and_no_others_differ(panda):
    assert rows_that_differ(panda, pi_p_hat(panda, False), corrected=False) == {17, 21, 25, 39}
    assert rows_that_differ(panda, pi_p_hat(panda, True), corrected=False) == {17}
    empty = {int(r["row"]) for r in panda.published["table_III"][:43] if not r["pi_p_hat"]}
    assert empty == EMPTY


def test_delta_is_not_consistent_at_its_printed_digits(panda):
    links = published_links(panda, "delta")
    moments = np.linalg.eigvalsh(inertia.inertia_matrix(inertia.barycentric_from_standard(links[1])[4:]))
    assert moments[0] == pytest.approx(-2.2e-5, abs=1e-6)
    # Half of D1 + D2 - D3 is the smallest eigenvalue of the second moment about the centre of mass.
    assert inertia.triangle_margin(links[1]) / 2.0 == pytest.approx(-1.9e-5, abs=5e-7)
    margins = inertia.consistency_margin(links)
    assert margins[1] < 0.0
    assert np.all(np.delete(margins, 1) > 0.0)
    assert published_values(panda, "delta")["c7z"] < panda.box[6, 3, 0]


def test_an_unknown_column_is_refused(panda):
    with pytest.raises(InputError, match="no published parameters 'p_star'"):
        published_links(panda, "p_star")
