"""What is not convex, solved by convex pieces: envelopes, certified optima, catalogue parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sdp_vs_penalty.constraints.constraint import BarycentricBound
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.barycentric_envelopes import inner, outer
from sdp_vs_penalty.estimators.catalogue_part import CataloguePart
from sdp_vs_penalty.estimators.convex_pieces import solve_pieces, with_upper_moments
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.penalty import Penalty
from sdp_vs_penalty.estimators.task import make_task
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.simulation.experiment import experiment


@pytest.fixture(scope="module")
def real(two_link: Problem) -> np.ndarray:
    return experiment(two_link).links


@pytest.fixture(scope="module")
def task(two_link: Problem) -> Task:
    run = experiment(two_link).training_run()
    model = two_link.model("rigid_body")
    regression = compress(run, model, two_link.preprocessing.resolve(run))
    return make_task(two_link, model, regression)


def links() -> st.SearchStrategy[np.ndarray]:
    """Consistent links with a centre of mass in [-1, 1]^3 m."""
    numbers = st.floats(-1.0, 1.0)
    return st.tuples(
        st.floats(0.1, 5.0),
        st.lists(numbers, min_size=3, max_size=3),
        st.lists(numbers, min_size=9, max_size=9),
    ).map(_link)


def _link(parts: tuple[float, list[float], list[float]]) -> np.ndarray:
    mass, c, a = parts
    root = np.array(a).reshape(3, 3)
    second = mass * (root @ root.T * 0.1 + 1e-3 * np.eye(3))
    tensor = np.trace(second) * np.eye(3) - second
    return inertia.standard_from_barycentric([mass, *c, *inertia.inertia_entries(tensor)])


@settings(max_examples=200, deadline=None)
@given(
    link=links(),
    entry=st.integers(0, 5),
    low=st.floats(-1.0, 1.0),
    width=st.floats(0.01, 2.0),
    cell=st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)), min_size=3, max_size=3),
    near=st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
)
def test_envelopes_hold_the_bound_between_them(link, entry, low, width, cell, near) -> None:
    bound = BarycentricBound("link 1", 0, np.arange(10), entry, low, low + width)
    c = link[1:4] / link[0]
    cells = np.array([[x - a, x + b] for x, (a, b) in zip(c, cell, strict=True)])
    satisfied = bound.margin(link) >= 0.0
    if satisfied:
        assert min((k.margin(link) for k in outer(bound, cells)), default=0.0) > -1e-9
    # Moments are non-negative anyway: what is left of their lower bound is in both sets.
    inside = all(k.margin(link) >= 1e-9 for k in inner(bound, np.array(near)))
    if inside:
        assert bound.margin(link) > -1e-9 or (entry in (0, 2, 5) and low <= 0.0)
    # Tight where the cell is a point, and where the tangent touches.
    point = np.column_stack([c, c])
    exact = min((k.margin(link) for k in outer(bound, point)), default=np.inf)
    touching = min((k.margin(link) for k in inner(bound, c)), default=np.inf)
    if bound.margin(link) < -1e-6:
        assert exact < 0.0
        assert touching < 0.0
    if bound.margin(link) > 1e-6:
        assert exact > 0.0
        assert touching > 0.0


def test_published_bounds_close_and_agree_with_the_penalty_method(task: Task) -> None:
    best = solve_pieces(task)
    assert best.closed
    assert best.gap <= 1e-6
    assert max(task.constraints.worst(best.theta).values()) == 0.0
    penalty = Penalty(body=False, thickness=0.0).fit(task)
    assert task.data.loss(penalty.theta) == pytest.approx(best.upper, rel=1e-6)


@pytest.mark.parametrize("share", [0.5, 0.1])
def test_no_penalty_run_falls_below_the_certified_bound(
    task: Task, real: np.ndarray, share: float
) -> None:
    moments = inertia.barycentric_from_standard(real)[:, [4, 6, 9]]
    tight = with_upper_moments(task, share * np.maximum(moments, 0.02))
    best = solve_pieces(tight, max_pieces=60)
    assert max(tight.constraints.worst(best.theta).values()) == 0.0
    assert best.lower <= best.upper
    penalty = Penalty(body=False, thickness=0.0, starts=3).fit(tight)
    if max(tight.constraints.worst(penalty.theta).values()) < 1e-9:
        assert task.data.loss(penalty.theta) >= best.lower * (1.0 - 1e-9)
    # The convex problem without these bounds is a lower bound as well, and a weaker one.
    open_task = replace(task, constraints=replace(task.constraints, nonconvex=()))
    assert solve_pieces(open_task).lower <= best.lower * (1.0 + 1e-9)


def test_cutting_closes_a_gap_that_convex_constraints_leave(task: Task, real: np.ndarray) -> None:
    moments = inertia.barycentric_from_standard(real)[:, [4, 6, 9]]
    tight = with_upper_moments(task, moments * np.array([[30.0], [0.2]]))
    open_task = replace(task, constraints=replace(task.constraints, nonconvex=()))
    convex = solve_pieces(open_task)
    best = solve_pieces(tight, tolerance=1e-5)
    assert best.closed
    # What these bounds cost is a hundred times what is left open, so that the proof means something.
    assert best.lower - convex.upper > 100.0 * (best.upper - best.lower)
    penalty = Penalty(body=False, thickness=0.0, starts=5).fit(tight)
    assert task.data.loss(penalty.theta) == pytest.approx(best.upper, rel=1e-5)


def test_the_right_catalogue_part_is_certified(task: Task, real: np.ndarray) -> None:
    wrong = inertia.barycentric_from_standard(real[1])
    wrong[0] *= 1.1
    parts = [
        CataloguePart("heavy", 1, inertia.standard_from_barycentric(wrong)),
        CataloguePart("real", 1, real[1]),
    ]
    best = solve_pieces(task, parts)
    assert best.closed
    assert best.choice == "real"
    assert best.choice_lower["heavy"] > 2.0 * best.upper


def test_bounds_that_nothing_satisfies_are_refused(task: Task) -> None:
    impossible = CataloguePart("lead ball", 1, np.array([400.0, 0, 0, 0, 1, 0, 1, 0, 0, 1]))
    with pytest.raises(InputError, match="interior"):
        solve_pieces(task, [impossible])
