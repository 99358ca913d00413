"""The page that shows the tables with the links drawn."""

import re

import numpy as np
import pytest

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.paper.links_page import links_page, outline, view
from sdp_vs_penalty.paper.tables import Study, build_tables, study
from sdp_vs_penalty.problem import published_links
from sdp_vs_penalty.robot import inertia


@pytest.fixture(scope="module")
def page():
    """Of the 2R's Table VII."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "METHODS", {"ols": "ols", "lmi_sdp": "lmi-sdp"})
        small = Study(load_problem("two_link"))
        yield links_page(build_tables(["VII"], small), small)


def test_every_cell_of_a_table_is_there(page):
    assert page.count("<tr>") == 1 + 20
    assert ">c1y</th>" in page


def test_links_that_cannot_exist_are_said_to(page):
    pictures = re.findall(r"<figcaption>.*?</figcaption>", page)
    by_title = {re.search(r"<b>(.*?)</b>", text).group(1): text for text in pictures}
    assert "every link can exist" in by_title["SDP, simulated run"]
    assert "cannot exist" in by_title["least squares, simulated run"]


def test_nothing_is_loaded_from_elsewhere(page):
    assert not re.search(r"(src|href)=\"(?!#)", page)
    assert "default-src 'none'" in page


def test_the_projection_keeps_lengths():
    np.testing.assert_allclose(view() @ view().T, np.eye(2), atol=1e-12)


def test_a_ball_is_a_circle_of_its_radius():
    """A uniform ball has the moment 2/5 m r^2."""
    radius = 0.3
    mass = 2.0
    moment = 0.4 * mass * radius**2
    barycentric = [mass, 0.1, 0.0, 0.0, moment, 0.0, moment, 0.0, 0.0, moment]
    ball = inertia.standard_from_barycentric(barycentric)
    centre, axes, exists = outline(ball, view())
    assert exists
    np.testing.assert_allclose(np.linalg.norm(axes, axis=0), radius, rtol=1e-9)
    np.testing.assert_allclose(centre, view() @ [0.1, 0.0, 0.0], atol=1e-12)


def test_an_impossible_link_is_drawn_and_marked(two_link):
    link = published_links(two_link, "p_real")[1].copy()
    link[4] = 10.0
    _, axes, exists = outline(link, view())
    assert not exists
    assert np.all(np.isfinite(axes))
