"""Whether Table III's printed standard deviations are those of a design."""

import numpy as np
import pytest

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.paper.tables import table_iii
from sdp_vs_penalty.paper.tables.study import Study

#: sqrt(diag((W^T W)^-1)) of five parameters, and the residual's standard deviation.
DESIGN = np.array([0.5, 1.2, 0.07, 3.0, 0.9])
RESIDUAL = 2e-3


def printed(values=(0.0292, -3.1026, -0.0002, 0.5324, 0.0771)):
    """Rows of a table that rounds as the paper's does."""
    percent = 100.0 * RESIDUAL * DESIGN / np.abs(values)
    return [
        {"pi_RE": f"{value:.4f}", "sigma_pct_RE": f"{share:.4f}"}
        for value, share in zip(values, percent, strict=True)
    ]


def test_rounded_figures_agree_in_every_row():
    checked = table_iii.printed_deviations(printed(), DESIGN)
    assert checked.n_agreeing == checked.n_rows == len(DESIGN)


def test_the_factor_is_the_residual():
    checked = table_iii.printed_deviations(printed(), DESIGN)
    assert checked.factor == pytest.approx(RESIDUAL, rel=1e-3)


@pytest.mark.parametrize("row", range(len(DESIGN)))
@pytest.mark.parametrize("column", ["pi_RE", "sigma_pct_RE"])
def test_a_shifted_decimal_point_shows(row, column):
    rows = printed()
    rows[row][column] = str(10.0 * float(rows[row][column]))
    assert table_iii.printed_deviations(rows, DESIGN).n_agreeing == len(DESIGN) - 1


@pytest.mark.real_data
def test_the_paper_s_figures_agree_in_every_row():
    problem = load_problem("panda")
    text = table_iii._published_checks(Study(problem), problem.published["table_III"])
    assert "43 of 43 rows" in text
