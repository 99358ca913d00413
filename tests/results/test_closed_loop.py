"""The loop of results/closed_loop, at a tenth of its length."""

import sys
from pathlib import Path

import pytest

RESULTS = Path(__file__).parents[2] / "results"


@pytest.mark.long
def test_the_true_model_tracks_and_the_urdf_alone_diverges(monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.setattr(sys, "path", [*sys.path, str(RESULTS)])
    from closed_loop.judge import PD_ALONE, TRUE, URDF_ALONE, Draw, rows_of

    rows = {row["model"]: row for row in rows_of(Draw(0, scale=0.3), "without a log")}
    true, urdf = rows[TRUE], rows[f"{URDF_ALONE}, wrong"]
    assert true["computed_diverged"] == 0 < urdf["computed_diverged"]
    errors = [
        row["feedforward_points_rms"] for row in (true, urdf, rows[PD_ALONE])
    ]  # mrad
    assert errors == sorted(errors)
    assert true["residual_rms"] < 0.2 * urdf["residual_rms"]
