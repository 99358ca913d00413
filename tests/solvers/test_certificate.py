"""The certificate judges: wrong answers stand out, conflicts are named (known optima:
test_verified)."""

from dataclasses import replace

import numpy as np
import pytest
from random_robots import posed_task, repeating_run, task_of, with_box
from recorded import refusal

from sdp_vs_penalty.estimation import (
    Certificate,
    certify,
    consistent,
    on_bounds,
    positive_definite_share,
)
from sdp_vs_penalty.estimators import Fit, LmiSdp, LmiSdpThickness, interior_point
from sdp_vs_penalty.robot import ConstraintSet, inertia
from sdp_vs_penalty.solvers import make_solver


@pytest.fixture(scope="module")
def task(two_link):
    """Noise, so that constraints bind: the last link's mass among them."""
    run = repeating_run(two_link, 0, 5.0)
    free = LmiSdpThickness().fit(posed_task(two_link, run)).theta
    tight = posed_task(with_box(two_link, 1, 0, 0.5, 0.9 * free[10]), run)
    return replace(tight, constraints=ConstraintSet(tight.constraints.convex))


def test_a_wrong_answer_shows_as_a_gap_and_one_outside_is_repaired_or_reported(task):
    fit = LmiSdpThickness().fit(task)
    interior = interior_point(task, fit.problem.constraints)
    dual = fit.multipliers
    theta, right = certify(task, fit)
    assert right.gap == pytest.approx(
        (right.upper - right.lower) / right.loss, rel=1e-12
    )
    assert (right.gap < 1e-7, right.worst) == (True, 0.0)
    assert "mass of link 2" in on_bounds(fit.problem.constraints, theta)
    assert inertia.thickness(theta[task.links]).min() == pytest.approx(
        LmiSdpThickness.thickness, 1e-3
    )
    wrong = [replace(fit, theta=fit.theta + 0.05 * (interior - fit.theta))]
    noise = np.random.default_rng(0).normal(size=len(dual)) * np.abs(dual).max()
    wrong += [
        replace(fit, multipliers=x) for x in (2.0 * dual, 0.0 * dual, dual + noise)
    ]
    for one in wrong:
        assert certify(task, one)[1].gap > 1e3 * max(right.gap, 1e-9)
    outside = fit.theta + 0.2 * (fit.theta - interior)
    assert fit.problem.constraints.margin(outside) < 0.0
    theta, repaired = certify(task, replace(fit, theta=outside))
    assert repaired.worst == 0.0
    assert fit.problem.constraints.margin(theta) >= -1e-15
    # Without multipliers it is left as the method gave it, and its violations are said.
    theta, reported = certify(task, Fit(outside, fit.problem))
    np.testing.assert_array_equal(theta, outside)
    assert reported.gap is None
    assert reported.worst == pytest.approx(
        max(fit.problem.constraints.worst(outside).values())
    )
    assert reported.worst > 0.0


def test_the_share_of_positive_definite_mass_matrices_is_of_m_of_q(panda):
    links = panda.nominal_links
    assert consistent(links)
    assert positive_definite_share(panda.robot, links, 500) == 1.0
    broken = links.copy()
    broken[6, 9] = -0.5  # joint 7 turns about z: M_77 = Izz7 < 0 wherever it points
    assert not consistent(broken)
    assert positive_definite_share(panda.robot, broken, 500) == 0.0
    tilted = links.copy()
    tilted[5, 0] = -4.0
    share = positive_definite_share(panda.robot, tilted, 2000)
    q = panda.robot.random_configurations(2000, 0)
    alone = [
        np.linalg.eigvalsh(panda.robot.mass_matrices(tilted, x))[0, 0] > 0.0
        for x in q[:300]
    ]
    assert 0.0 <= share < 1.0
    assert share == pytest.approx(np.mean(alone), abs=0.1)


def conflicts(panda):
    """Panda problems without a feasible point: minimum thickness, and what the message
    must name."""
    heavy = replace(panda, total_mass=(71.0, 80.0))  # seven links of at most 10 kg
    heavy_links = panda
    for link in (0, 3):
        heavy_links = with_box(heavy_links, link, 0, 9.0, 10.0)
    light = replace(heavy_links, total_mass=(1.0, 17.0))
    flat = panda
    for entry in (4, 6, 9):
        flat = with_box(flat, 3, entry, 0.0, 1e-6)
    flat = with_box(flat, 3, 0, 2.0, 3.0)
    return {
        "too heavy": (
            heavy,
            0.0,
            ("total mass (robot)", "mass (links 1, 2, 3, 4, 5, 6, 7)"),
        ),
        # The other links weigh nothing less than nothing: that much of the
        # pseudo-inertias is needed.
        "too light": (
            light,
            0.0,
            (
                "total mass (robot)",
                "mass (links 1, 4)",
                "pseudo-inertia (links 2, 3, 5, 6, 7)",
            ),
        ),
        "too thick": (panda, 2.0, ("minimum thickness (link", "trace (link")),
        "one flat link": (
            flat,
            0.5,
            ("minimum thickness (link 4)", "trace (link 4)", "mass (link 4)"),
        ),
    }


@pytest.mark.parametrize(
    "case", ["too heavy", "too light", "too thick", "one flat link"]
)
def test_demands_that_exclude_each_other_are_named(case, panda):
    problem, thickness, families = conflicts(panda)[case]
    method = LmiSdpThickness(thickness=thickness)
    message = refusal(
        lambda: method.fit(task_of(problem)), "exclude each other", *families
    )
    for innocent in {"sign", "range", "centre of mass", "pseudo-inertia"}:
        assert innocent not in message or innocent in " ".join(families)


def test_bounds_that_leave_no_room_are_not_called_a_contradiction(panda):
    known = with_box(panda, 2, 0, 3.0, 3.0)
    refusal(
        lambda: LmiSdp().fit(task_of(known)),
        "no room",
        "mass (link 3)",
        "equal bounds",
        "widen",
    )


@pytest.mark.parametrize("finds", [True, False])
def test_the_certificate_decides_whether_a_solver_gave_up(finds, task, monkeypatch):
    """An answer that its solver calls failed counts where its gap is proved, and only
    there."""

    class Doubtful:
        """Clarabel, or the interior point and no multipliers; never sure of itself."""

        @staticmethod
        def solve_for_user(problem, accuracy):
            found = replace(
                make_solver("clarabel").solve(problem, accuracy),
                claims="failed",
                status="stalled",
            )
            return found if finds else replace(found, x=0.0 * found.x, z=0.0 * found.z)

    monkeypatch.setattr(
        "sdp_vs_penalty.estimators.lmi_sdp.make_solver", lambda _: Doubtful
    )
    method = LmiSdpThickness(solver="clarabel")
    if finds:
        _, certificate = certify(task, method.fit(task))
        assert certificate.gap < 1e-7
    else:
        refusal(lambda: method.fit(task), "gave up", "stalled")


def test_a_certificate_tells_what_holds_from_what_was_not_imposed():
    """Of a convex method, a broken bound that is not convex is no surprise; of another,
    or beside a convex one, it is a violation like any other."""
    for broken, gap, spared in (
        (["barycentric inertia"], 0.0, True),
        (["barycentric inertia"], None, False),
        (["barycentric inertia", "mass"], 0.0, False),
        (["mass"], 0.0, False),
    ):
        shown = str(Certificate(dict.fromkeys(broken, 0.1), 1.0, gap=gap))
        assert ("every other constraint holds" in shown) == spared
    nonconvex = "barycentric inertia"
    for gap, violations, is_found, is_undecided in (
        (None, {}, True, False),
        (1e-9, {}, True, False),
        (0.3, {}, False, False),
        (1e-9, {nonconvex: 0.0}, True, False),
        (0.3, {nonconvex: 0.0}, True, True),
        (0.3, {nonconvex: 0.1}, False, False),
        (1.5, {nonconvex: 0.0}, False, False),
    ):
        certificate = Certificate(violations, 1.0, gap=gap)
        said = certificate.not_found
        assert said.startswith("The optimum was not found") != is_found
        left_out = "without the limits that are not convex" in str(certificate)
        assert left_out == is_undecided
    for share, said in (
        (1.0, "(at most 1 of a link's body)"),
        (1.1, "(beyond what any mass inside can"),
    ):
        assert said in str(Certificate({}, 1.0, body_share=share, largest_gyration=0.2))
