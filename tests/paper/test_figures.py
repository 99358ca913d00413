"""What the figures draw."""

import numpy as np

from sdp_vs_penalty.paper.figures.two_link import _ellipse
from sdp_vs_penalty.problem import published_links
from sdp_vs_penalty.robot import inertia


def test_a_ball_is_a_circle_of_its_radius():
    """A uniform ball has the moment 2/5 m r^2."""
    moment = 0.4 * 2.0 * 0.3**2
    centred = [2.0, 0.1, 0.0, 0.0, moment, 0.0, moment, 0.0, 0.0, moment]
    edge = _ellipse(inertia.standard_from_barycentric(centred), (0, 2))
    np.testing.assert_allclose(np.linalg.norm(edge.T - [0.1, 0.0], axis=1), 0.3)


def test_an_impossible_link_is_drawn(two_link):
    link = published_links(two_link, "p_real")[1].copy()
    link[4] = 10.0
    assert np.isfinite(_ellipse(link, (0, 1))).all()
