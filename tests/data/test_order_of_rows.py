"""Rows in any order, channels of a rail beside those of angles, a lone number beside
columns: what is read of such files."""

import numpy as np
import pytest
from scipy.io import savemat

from sdp_vs_penalty.data.files import read_run
from sdp_vs_penalty.errors import Remark

TIME = 0.01 * np.arange(300)
POSITIONS = np.sin(TIME[:, None] + np.arange(3))
TORQUES = 5.0 * np.cos(TIME[:, None] - np.arange(3))


def written(path, names, order):
    """Write t, positions and torques with a header, the rows in an order."""
    table = np.column_stack([TIME, POSITIONS, TORQUES])[order]
    np.savetxt(path, table, "%.17g", ",", header=",".join(names), comments="")
    return path


def test_rows_in_random_order_are_put_in_that_of_their_stamps(tmp_path):
    names = ["t", *(f"{x}{k}" for x in ("q", "tau") for k in (1, 2, 3))]
    order = np.random.default_rng(5).permutation(len(TIME))
    path = written(tmp_path / "run.csv", names, order)
    with pytest.warns(Remark, match="in no order of time"):
        run = read_run(path, 3)
    np.testing.assert_array_equal(run.t, TIME)
    np.testing.assert_array_equal(run.tau, TORQUES)
    assert order[run.rows_of_file(np.arange(5)) - 2].tolist() == [*range(5)]


@pytest.mark.filterwarnings("ignore")
def test_a_single_number_beside_columns_is_none_of_them(tmp_path):
    """The period Ts beside the clock of a struct of n x N."""
    fields = {"time": TIME[None], "q": POSITIONS.T, "tau": TORQUES.T}
    savemat(tmp_path / "run.mat", {"log": fields, "Ts": 0.01})
    run = read_run(tmp_path / "run.mat", 3)
    np.testing.assert_array_equal(run.q, POSITIONS)
    np.testing.assert_array_equal(run.t, TIME)
