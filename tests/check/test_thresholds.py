"""Two standard deviations are luck, eight are not: what the check calls wrong with a file."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sdp_vs_penalty.check import events
from sdp_vs_penalty.check.signs import time_reversed
from sdp_vs_penalty.data.measurements import Measurements

N = 3


def physics(z: float, inertia: float = 100.0, weight: float = 1.0) -> Any:
    """An arm whose friction seems to drive it, by ``z`` standard deviations."""
    return SimpleNamespace(
        dissipation=(np.full(N, -z), np.ones(N)),
        inertia=np.full(N, inertia / N),
        agreement_with_weight=lambda: weight,
        motion=SimpleNamespace(t=np.arange(100.0)),
        part=lambda _: physics(z, inertia, weight),
    )


@pytest.mark.parametrize(("z", "believed"), [(2.0, False), (8.0, True)])
def test_time_runs_backwards_only_where_noise_cannot_say_so(z: float, believed: bool) -> None:
    moving = np.ones(N, bool)
    assert (time_reversed(physics(z), moving) is not None) == believed
    assert time_reversed(physics(8.0, inertia=2.0, weight=0.1), moving) is None
    assert time_reversed(physics(8.0, inertia=-8.0), moving) is None


@pytest.mark.parametrize(("sigmas", "believed"), [(2.0, False), (8.0, True)])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_delay_is_one_only_beyond_its_uncertainty(
    sigmas: float, believed: bool, sign: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit = events._DelayFit(sign * sigmas * 0.1, 0.1, 1.0, 1e-3)
    monkeypatch.setattr(events, "_fit_delay", lambda _: fit)
    t = np.arange(0.0, 100.0, 1e-3)
    zero = np.zeros((len(t), N))
    found = list(events.delay(Measurements(t, zero, zero), physics(0.0)))
    assert bool(found) == believed
    if found:
        assert ("later" if sign > 0.0 else "earlier") in found[0].what
        ramp = Measurements(t, zero, np.tile(t[:, None], (1, N)))
        assert found[0].repair is not None
        mended = found[0].repair(ramp)  # torques of a later row belong to this one's positions
        np.testing.assert_allclose(mended.tau[:, 0] - mended.t, fit.seconds, atol=1e-9)
