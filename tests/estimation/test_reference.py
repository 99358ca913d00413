"""The current model, from whose links and torque some effects' columns follow."""

import numpy as np
from small_runs import small_run

from sdp_vs_penalty import identify, load_problem
from sdp_vs_penalty.effects import DEFAULT_EFFECTS
from sdp_vs_penalty.robot.inertia import link_sizes


def test_links_of_the_current_model_stay_near_those_of_the_file():
    """In two seconds rows hardly tell them: by least squares alone a link of 3 kg has
    tens of kilograms, and a gear's deflection shakes them."""
    arm = load_problem("ur10e")
    effects = [*DEFAULT_EFFECTS, "rotor_inertia", "joint_elasticity:2"]
    model = identify(arm, small_run(arm, seconds=2.0), effects=effects, check=False)
    links = model.model.reference[model.model.rigid_indices].reshape(-1, 10)
    change = (links - arm.nominal_links) / link_sizes(arm.nominal_links)
    assert np.abs(change).max() < 2.0
