"""The certificate judges: known optima are enclosed, wrong answers stand out, conflicts are named."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_robots import link_parameters, task_of, tree

from sdp_vs_penalty import InputError, Problem
from sdp_vs_penalty.estimation import Certificate
from sdp_vs_penalty.estimation.identify import certify, consistent, on_bounds, positive_mass_matrices
from sdp_vs_penalty.estimators import Fit, LmiSdp, Task, interior_point
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdpThickness
from sdp_vs_penalty.regression import LeastSquares
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.solvers import ConicProblem, Objective, Solution, solver

seeds = st.integers(0, 2**32 - 1)
quick = settings(max_examples=15, deadline=None, derandomize=True)

THICKNESS = 0.02


def bounded_problem(rng: np.random.Generator, links: int) -> Problem:
    """A random robot with mass bounds and default balls, and a nominal well inside of everything."""
    robot = tree(rng, links)
    box = np.full((links, 10, 2), (-np.inf, np.inf))
    box[:, 0] = 0.2, 20.0
    nominal = np.array([link_parameters(rng, 0.5, thickness=0.06) for _ in range(links)])
    return Problem("known", "known", robot, box, nominal)


def thin_link(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A link exactly THICKNESS thin in one direction, and the null vector (4,) of its constraint.

    [[Sigma - m r^2 1, h], [h^T, m]] of second moment Sigma_c with smallest eigenvalue m r^2 is
    singular along (u, -u.c), u being the thin direction.
    """
    mass, centre = rng.uniform(1.0, 4.0), rng.uniform(-0.15, 0.15, 3)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    gyration = np.array([THICKNESS, *rng.uniform(0.05, 0.15, 2)])
    pseudo = np.empty((4, 4))
    pseudo[:3, :3] = mass * ((axes * gyration**2) @ axes.T + np.outer(centre, centre))
    pseudo[:3, 3] = pseudo[3, :3] = mass * centre
    pseudo[3, 3] = mass
    u = axes[:, 0]
    return inertia.from_pseudo_inertia(pseudo), np.append(u, -u @ centre)


class Known:
    """An identification problem built backwards from its optimum.

    Some links are as thin as allowed, one sits on its upper mass; multipliers S complementary to
    that and a full-rank R are drawn; rho follows from 2 R^T (R theta - rho) = sum F*(S), which with
    feasibility and complementarity is optimality.
    """

    def __init__(self, seed: int, links: int = 2) -> None:
        rng = np.random.default_rng(seed)
        problem = bounded_problem(rng, links)
        model = problem.model(["rigid_body"])
        thin = [thin_link(rng) for _ in range(links)]
        self.theta = np.concatenate([parameters for parameters, _ in thin])
        problem.box[-1, 0, 1] = self.theta[10 * (links - 1)]
        problem.nominal_links[-1] *= 0.7 * self.theta[-10] / problem.nominal_links[-1, 0]
        demands = problem.constraints(model)
        p = 10 * links
        plain = Task(
            model,
            LeastSquares(np.eye(p), np.zeros(p), 0.0, 1.0, p),
            demands,
            problem.parameter_bound(model),
            problem.nominal(model),
            problem.box,
        )
        self.constraints = demands.plus(plain.minimum_thickness(THICKNESS))
        assert self.constraints.margin(self.theta) > -1e-12
        slope = np.zeros(p)
        for c in self.constraints.convex:
            s = np.zeros_like(c.constant)
            link = int(c.indices[0]) // 10
            if c.family == "minimum thickness":
                null = thin[link][1]
                s = rng.uniform(0.1, 3.0) * np.outer(null, null)
            elif c.family == "mass" and link == links - 1:
                s[-1] = rng.uniform(0.1, 3.0)
            slope[c.indices] += c.coefficients.reshape(len(c.indices), -1) @ s.ravel()
        r = rng.normal(size=(p + 5, p)) / np.maximum(np.abs(self.theta), 1e-2)
        y = np.linalg.lstsq(r.T, slope / 2.0, rcond=None)[0]
        rho, floor = r @ self.theta - y, float(rng.uniform(0.0, 1.0))
        data = LeastSquares(r, rho, floor, float(rho @ rho) + floor**2, 200)
        self.optimum = float(y @ y) + floor**2
        self.task = replace(plain, data=data)
        self.objective = Objective(data)


@quick
@given(seeds, st.integers(1, 3))
def test_the_interval_of_the_estimator_holds_the_known_optimum(seed, links):
    known = Known(seed, links)
    fit = LmiSdpThickness(thickness=THICKNESS).fit(known.task)
    theta, certificate = certify(known.task, fit)
    rounding = 1e-12 * known.task.data.tau_squared
    assert certificate.lower <= known.optimum + rounding
    assert known.optimum <= certificate.upper + rounding
    assert certificate.gap < 1e-7
    assert certificate.worst == 0.0
    assert on_bounds(known.constraints, known.theta) == [f"mass of link {links}"]
    width = certificate.upper - certificate.lower
    assert certificate.gap == pytest.approx(width / certificate.loss, rel=1e-12)
    # R has full rank: the optimum is one point.
    scale = np.maximum(np.abs(known.theta), 1e-2)
    np.testing.assert_allclose(theta / scale, known.theta / scale, atol=2e-3)
    thin = inertia.thickness(theta.reshape(-1, 10))
    np.testing.assert_allclose(thin, THICKNESS, rtol=1e-3)


@quick
@given(seeds)
def test_a_wrong_answer_shows_as_a_gap_and_one_outside_is_repaired_or_reported(seed):
    known = Known(seed)
    fit = LmiSdpThickness(thickness=THICKNESS).fit(known.task)
    interior, dual = interior_point(known.task, fit.constraints), fit.multipliers
    _, right = certify(known.task, fit)
    wrong = [replace(fit, theta=fit.theta + 0.05 * (interior - fit.theta))]
    noise = np.random.default_rng(seed).normal(size=len(dual))
    wrong += [replace(fit, multipliers=x) for x in (2.0 * dual, 0.0 * dual, dual + noise)]
    for one in wrong:
        assert certify(known.task, one)[1].gap > 1e3 * max(right.gap, 1e-9)
    outside = fit.theta + 0.2 * (fit.theta - interior)
    assert fit.constraints.margin(outside) < 0.0
    theta, repaired = certify(known.task, replace(fit, theta=outside))
    assert repaired.worst == 0.0
    assert fit.constraints.margin(theta) >= -1e-15
    # Without multipliers it is left as the method gave it, and its violations are said.
    theta, reported = certify(known.task, Fit(outside, fit.objective, fit.constraints))
    np.testing.assert_array_equal(theta, outside)
    assert reported.gap is None
    assert reported.worst == pytest.approx(max(fit.constraints.worst(outside).values()))
    assert reported.worst > 0.0


def test_the_share_of_positive_definite_mass_matrices_is_of_m_of_q(panda):
    links = panda.nominal_links
    assert consistent(links)
    assert positive_mass_matrices(panda.robot, links, 500) == 1.0
    broken = links.copy()
    broken[6, 9] = -0.5  # joint 7 turns about z: M_77 = Izz7 < 0 wherever it points
    assert not consistent(broken)
    assert positive_mass_matrices(panda.robot, broken, 500) == 0.0
    tilted = links.copy()
    tilted[5, 0] = -4.0
    share = positive_mass_matrices(panda.robot, tilted, 2000)
    q = panda.robot.random_configurations(2000, 0)
    alone = [np.linalg.eigvalsh(panda.robot.mass_matrices(tilted, x))[0, 0] > 0.0 for x in q[:300]]
    assert 0.0 <= share < 1.0
    assert share == pytest.approx(np.mean(alone), abs=0.1)


def with_box(problem: Problem, link: int, entry: int, low: float, high: float) -> Problem:
    box = problem.box.copy()
    box[link, entry] = low, high
    return replace(problem, box=box)


def conflicts(panda: Problem) -> dict[str, tuple[Problem, float, tuple[str, ...]]]:
    """Panda problems without a feasible point: minimum thickness, and what the message must name."""
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
        "too heavy": (heavy, 0.0, ("total mass (robot)", "mass (links 1, 2, 3, 4, 5, 6, 7)")),
        # The other links weigh nothing less than nothing: that much of the pseudo-inertias is needed.
        "too light": (
            light,
            0.0,
            ("total mass (robot)", "mass (links 1, 4)", "pseudo-inertia (links 2, 3, 5, 6, 7)"),
        ),
        "too thick": (panda, 2.0, ("minimum thickness (link", "trace (link")),
        "one flat link": (
            flat, 0.5, ("minimum thickness (link 4)", "trace (link 4)", "mass (link 4)")
        ),
    }  # fmt: skip


@pytest.mark.parametrize("case", ["too heavy", "too light", "too thick", "one flat link"])
def test_demands_that_exclude_each_other_are_named(case, panda):
    problem, thickness, families = conflicts(panda)[case]
    with pytest.raises(InputError, match="exclude each other") as refusal:
        LmiSdpThickness(thickness=thickness).fit(task_of(problem))
    message = str(refusal.value)
    for family in families:
        assert family in message
    for innocent in {"sign", "range", "centre of mass", "pseudo-inertia"}:
        assert innocent not in message or innocent in " ".join(families)
    assert "\n" not in message


def test_bounds_that_leave_no_room_are_not_called_a_contradiction(panda):
    known = with_box(panda, 2, 0, 3.0, 3.0)
    with pytest.raises(InputError, match=r"no room.*mass \(link 3\).*equal bounds.*widen"):
        LmiSdp().fit(task_of(known))


@pytest.mark.parametrize("finds", [True, False])
def test_the_certificate_decides_whether_a_solver_gave_up(finds, monkeypatch):
    """An answer that its solver calls failed counts where its gap is proved, and only there."""

    class Doubtful:
        """Clarabel, or the interior point and no multipliers; never sure of itself."""

        @staticmethod
        def solve(problem: ConicProblem, accuracy: float) -> Solution:
            found = replace(
                solver("clarabel").solve(problem, accuracy), claims="failed", status="stalled"
            )
            return found if finds else replace(found, x=0.0 * found.x, z=0.0 * found.z)

    monkeypatch.setattr("sdp_vs_penalty.estimators.sdp_fit.solver", lambda _: Doubtful)
    known, method = Known(0), LmiSdpThickness(thickness=THICKNESS, solver="clarabel")
    if finds:
        _, certificate = certify(known.task, method.fit(known.task))
        assert certificate.gap < 1e-7
    else:
        with pytest.raises(InputError, match=r"gave up.*stalled"):
            method.fit(known.task)


def test_a_certificate_tells_what_holds_from_what_was_not_imposed():
    """Of a convex method, a broken bound that is not convex is no surprise; of another, or beside a
    convex one, it is a violation like any other."""
    for broken, gap, spared in (
        (["barycentric inertia"], 0.0, True),
        (["barycentric inertia"], None, False),
        (["barycentric inertia", "mass"], 0.0, False),
        (["mass"], 0.0, False),
    ):
        shown = str(Certificate(dict.fromkeys(broken, 0.1), 1.0, gap=gap))
        assert ("every other constraint holds" in shown) == spared
    for share, said in (
        (1.0, "(at most 1 of a link's body)"),
        (1.1, "(beyond what any mass inside can"),
    ):
        assert said in str(Certificate({}, 1.0, body_share=share, largest_gyration=0.2))
