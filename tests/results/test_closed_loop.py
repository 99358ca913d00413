"""The loop of results/closed_loop, at a third of its length; docs/controller.md has its
lines."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def judge():
    """The program's functions."""
    pytest.importorskip("mujoco")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", [*sys.path, str(ROOT / "results")])
        from closed_loop import judge

        yield judge


@pytest.fixture(scope="module")
def draw(judge):
    """A short draw."""
    return judge.Draw(0, scale=0.3)


def test_the_true_model_tracks_and_the_urdf_alone_diverges(judge, draw):
    rows = {row["model"]: row for row in judge.rows_of(draw, "without a log")}
    true, urdf = rows[judge.TRUE], rows[f"{judge.URDF_ALONE}, wrong"]
    assert true["computed_diverged"] == 0 < urdf["computed_diverged"]
    errors = [
        row["feedforward_points_rms"] for row in (true, urdf, rows[judge.PD_ALONE])
    ]  # mrad
    assert errors == sorted(errors)
    assert true["residual_rms"] < 0.2 * urdf["residual_rms"]


def test_the_page_on_controllers_has_the_lines_that_were_used(judge, draw):
    log = draw.without_contact
    with judge.problem_of("wrong") as problem:
        model = judge.true_model(draw, problem, draw.runs("little")[0])
    page = (ROOT / "docs" / "controller.md").read_text(encoding="utf-8")
    lines = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    rest = np.zeros_like(log.q[0])
    names = {"np": np, "arm": model.controller(), "q": rest, "dq": rest, "ddq": rest}
    for text in ("def touched", "def computed_torque"):
        exec(next(x for x in lines if text in x), names)  # our own page
    names["residual"][:] = 0.0
    command, reference = judge.computed_torque(model, log.reference), log.reference
    used = judge.residual(model, log)
    for k in range(1500):
        state, wanted = (log.q[k], log.dq[k]), reference.ddq[k]
        torque = names["computed_torque"](
            *state, reference.q[k], reference.dq[k], wanted
        )
        np.testing.assert_allclose(torque, command(k, *state), atol=1e-9)
        names["touched"](*state, wanted, log.tau[k], threshold=np.inf)
        np.testing.assert_allclose(names["residual"], used[k], atol=0.01)  # N m
    assert np.abs(used[:1500]).max() > 1.0
