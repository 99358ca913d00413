"""Output error: the simulated motion is what is fitted, and the result is consistent."""

import numpy as np
import pytest
from unchecked import identify

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.robot import random_trajectory
from sdp_vs_penalty.simulation import Sensor
from sdp_vs_penalty.simulation.experiments import simulate

EFFECTS = "rigid_body,viscous_friction,coulomb_friction@v_s=0.001,torque_offset"


@pytest.mark.long
def test_what_bends_the_torque_for_moments_bends_the_simulated_motion_less():
    """Spikes at every reversal, which no effect of the model explains, under a known
    truth."""
    problem = load_problem("emps")
    model = problem.model(EFFECTS)
    sizes = {"viscous_friction": 200.0, "coulomb_friction": 20.0}
    theta = np.array([sizes.get(p.effect, 0.0) for p in model.parameters])
    theta[model.rigid_indices] = (
        95.0 / problem.nominal_links[0, 0] * problem.nominal_links.ravel()
    )
    trajectory = random_trajectory(problem.robot, 3, 2.5)
    late = Sensor(1000.0, np.zeros(1))
    clean = simulate(trajectory, lambda motion: model.torque(theta, motion), late)

    def spiky(m):
        return 15.0 * np.exp(-((m.dq / 0.01) ** 2)) * np.sin(400.0 * m.t)[:, None]

    run = simulate(
        trajectory, lambda motion: model.torque(theta, motion) + spiky(motion), late
    )
    start = identify(problem, run, effects=EFFECTS)
    made = identify(problem, run, "output-error", effects=EFFECTS)
    before, after = made.details["simulation_rms"]
    assert made.method == "output-error"
    assert made.certificate.worst == 0.0
    assert after <= before
    assert made.details["window_s"] > 2.4  # the whole run, without the filters' ends
    assert after < 1e-3 * np.ptp(clean.q)
    k = next(iter(model.rigid_indices))
    assert made.theta[k] == pytest.approx(95.0, rel=0.02)
    assert start.theta[k] == pytest.approx(95.0, rel=0.1)
