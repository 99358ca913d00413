"""Every solver on the same problems, judged by our own certificate; the rewritings and
file formats."""

import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from recorded import refusal
from scipy import sparse
from sdp_readers import read_cbf

from sdp_vs_penalty import solvers
from sdp_vs_penalty.estimators import LmiSdp, PosedSdp, make_estimator
from sdp_vs_penalty.exporters.sdp import export_sdp
from sdp_vs_penalty.robot import ConstraintSet
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.shootout import chain_task, shape_cones
from sdp_vs_penalty.solvers import (
    ThroughCvxpy,
    certainly_feasible,
    make_solver,
    rewrite,
)
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem
from sdp_vs_penalty.solvers.packages import Scs
from sdp_vs_penalty.solvers.programs import Program
from sdp_vs_penalty.solvers.rewrite import quadratic_factor, without_equalities
from sdp_vs_penalty.solvers.solver import tiny_problem
from sdp_vs_penalty.testing import ContractError
from sdp_vs_penalty.testing.methods import (
    SOLVER_CONTRACTS,
    LinkProblem,
    check_all_options_are_declared,
    check_declaration,
    check_optimum,
)


class WithoutLicence(ThroughCvxpy):
    """As MOSEK and COPT are called, by a solver that asks for no licence."""

    name = "clarabel"
    requires = ("package", "clarabel")
    licences = ("nobody@nowhere",)

    def options(self, accuracy, variant=""):
        return {"tol_gap_rel": accuracy}


SOLVERS = {name: kind() for name, kind in solvers.solver_types().items()} | {
    "CVXPY's": WithoutLicence()
}
NAMES = list(SOLVERS)


def usable(name):
    if SOLVERS[name].absent:
        pytest.skip(SOLVERS[name].absent)
    return SOLVERS[name]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("contract", SOLVER_CONTRACTS, ids=lambda c: c.__name__)
def test_every_solver_keeps_every_contract(contract, name):
    if contract in (check_declaration, check_all_options_are_declared):
        contract(SOLVERS[name])
    elif name == "dsdp" and contract is check_optimum:
        # Its primal (our dual) is only as good as its dual scaling leaves it.
        contract(usable(name), largest_gap=2e-2)
    else:
        contract(usable(name))


def test_an_option_inside_run_is_refused():
    """The shootout prints the declared ones alone."""

    class Indirect(Scs):
        def run(self, problem, options):
            return super().run(problem, {**options, "use_indirect": True})

    with pytest.raises(ContractError, match="run passes use_indirect"):
        check_all_options_are_declared(Indirect())


def test_data_without_any_scale_end_in_a_claim_not_in_a_panic():
    """Clarabel takes 1e20 for infinite, and panicked on columns of 1e70."""
    conic = LinkProblem.drawn().sdp.conic
    solution = SOLVERS["clarabel"].solve(replace(conic, b=1e30 * conic.b), 1e-7)
    assert solution.claims == "failed"
    assert solution.x.shape == conic.q.shape


@pytest.mark.parametrize(
    "step",
    [
        rewrite.linear_objective,
        lambda p: rewrite.linear_objective(p, 3),
        lambda p: rewrite.suited(p, {"nonnegative", "psd"}),
        rewrite.arrows,
        lambda p: rewrite.reorder(p, ("zero", "psd", "soc", "nonnegative")),
    ],
)
def test_rewriting_keeps_the_solution_and_its_multipliers(step):
    link = LinkProblem.drawn()
    conic = link.sdp.conic
    direct = make_solver("clarabel").solve(conic, 1e-9)
    rewritten = step(conic)
    other = make_solver("clarabel").solve(rewritten.problem, 1e-9)
    x, z = rewritten.back(other.x, other.z)
    assert_allclose(x, direct.x, atol=2e-5)
    # Stationarity P x + q + A^T z = 0 of the original problem, equalities' multipliers
    # included.
    full = sparse.triu(conic.P) + sparse.triu(conic.P, 1).T
    slope = full @ x + conic.q + conic.A.T @ z
    assert_allclose(slope, 0.0, atol=1e-5)


@pytest.mark.parametrize(
    "root", [np.diag([2.0, 0.0, 3.0]), np.array([[1.0, 2.0, 3.0], [0.0, 4.0, 5.0]])]
)
def test_a_quadratic_is_the_square_of_its_factor(root):
    """Of a diagonal and of a full matrix, both without full rank; only its upper
    triangle is told."""
    whole = root.T @ root
    x = np.array([0.3, -1.0, 2.0])
    nothing = sparse.csc_matrix((0, 3))
    told = solvers.ConicProblem(
        sparse.csc_matrix(np.triu(whole)), np.zeros(3), nothing, np.zeros(0), ()
    )
    factor = rewrite.quadratic_factor(told)
    assert factor.shape == (2, 3)
    assert_allclose((factor.T @ factor).toarray(), whole, atol=1e-12)
    bounded = rewrite.linear_objective(
        told
    ).problem  # t >= |G x|^2 / 2 is what it costs
    assert bounded.q @ np.append(x, 0.5 * x @ whole @ x) == pytest.approx(
        0.5 * x @ whole @ x
    )


@pytest.mark.parametrize("entropic", [False, True])
def test_exported_files_read_back_to_the_same_problem(tmp_path, entropic):
    """CBF here; programs read SDPA files in tests/estimation/test_pose.py."""
    sdp = LinkProblem.drawn(entropic).sdp
    kinds = ("zero", "nonnegative", "soc", "exp", "psd")
    export_sdp(sdp, tmp_path / "problem.cbf", None)
    sent = rewrite.reorder(rewrite.linear_objective(sdp.conic).problem, kinds).problem
    found = rewrite.reorder(read_cbf(tmp_path / "problem.cbf"), kinds).problem
    assert found.cones == sent.cones
    assert_array_equal(found.q, sent.q)
    assert_allclose(found.b, sent.b, rtol=1e-15)
    assert abs(found.A - sent.A).max() <= 1e-15 * abs(sent.A).max()
    if entropic:
        refusal(
            lambda: export_sdp(sdp, tmp_path / "problem.dat-s", None),
            "exponential cone",
            ".cbf",
        )


@pytest.mark.parametrize("name", NAMES)
def test_what_a_solver_itself_calls_inaccurate_is_no_claim(name):
    """An almost proved infeasibility as well as an almost found optimum."""
    meaning = SOLVERS[name].status_meaning
    admits = [s for s in meaning if s.startswith(("Almost", "near_"))]
    admits += [s for s in meaning if s.endswith("_inaccurate")]
    assert {meaning[status] for status in admits} <= {"inaccurate"}
    assert len(admits) == 3 or name not in ("clarabel", "qics", "CVXPY's")


@pytest.mark.parametrize(
    ("misses", "claims"), [("6.64e-04", "inaccurate"), ("6.31e-10", "optimal")]
)
def test_dsdp_is_inaccurate_where_it_says_that_it_misses_what_was_asked(
    misses, claims, monkeypatch
):
    """It may converge to the optimum of a problem with bounds of its own."""
    text = f"DSDP Converged. \nP Infeasible: 1.30e-09 \nD Infeasible: {misses} \n"

    def run(self, problem, options):
        said, status, n = self.ended(text, 0)
        x, z = np.zeros(len(problem.q)), np.zeros(len(problem.b))
        return solvers.Solution(x, z, said, status, n)

    monkeypatch.setattr(Program, "run", run)
    answer = SOLVERS["dsdp"].solve(tiny_problem(exponential=False), 1e-6)
    assert answer.claims == claims
    said, status, _ = SOLVERS["dsdp"].ended("DSDP Terminated Due to Small Steps\n", 0)
    assert (said, status) == ("failed", "DSDP Terminated Due to Small Steps")


def test_scs_is_inaccurate_where_it_says_so(monkeypatch):
    """Of an infeasible problem, too."""
    scs = pytest.importorskip("scs")
    problem = tiny_problem(exponential=False)
    numbers = {"x": np.zeros(2), "y": np.zeros(len(problem.b))}
    info = {"status": "infeasible (inaccurate - reached max_iters)", "iter": 9}

    class Stopped:
        def __init__(self, *_, **__):
            pass

        def solve(self):
            return {**numbers, "info": info}

    monkeypatch.setattr(scs, "SCS", Stopped)
    assert SOLVERS["scs"].solve(problem, 1e-6).claims == "inaccurate"
    info["status"] = "infeasible"
    assert SOLVERS["scs"].solve(problem, 1e-6).claims == "infeasible"


@pytest.mark.parametrize("name", ["sdpa", "sdpa-program"])
@pytest.mark.parametrize(
    ("slope", "least", "claims"), [(1.0, 1.0, "infeasible"), (-1.0, -1.0, "unbounded")]
)
def test_one_sided_phases_of_sdpa_are_of_our_problem(name, slope, least, claims):
    """Minimise slope x so that x >= least and, for a positive slope, -x >= 0."""
    A = sparse.csc_matrix([[-1.0], [slope]])
    conic = ConicProblem(
        P=sparse.csc_matrix((1, 1)),
        q=np.array([slope]),
        A=A,
        b=np.array([-least, 0.0]),
        cones=(Cone("nonnegative", 2),),
    )
    assert usable(name).solve(conic, 1e-6).claims == claims


@pytest.mark.parametrize("name", ["csdp", "dsdp", "sdpa-program"])
def test_the_time_of_files_is_of_files_alone(name, monkeypatch):
    """Rewriting the problem is work of the solver's form, for everybody."""
    conic = LinkProblem.drawn().sdp.conic
    one = usable(name)
    rewriting = type(one).solve.__globals__["suited"]

    def slow(*args):
        end = time.process_time() + 0.3
        while time.process_time() < end:
            pass
        return rewriting(*args)

    monkeypatch.setitem(type(one).solve.__globals__, "suited", slow)
    assert 0.0 < one.solve(conic, 1e-6).file_seconds < 0.2


def test_unknown_and_absent_solvers_are_named(monkeypatch):
    monkeypatch.setattr(
        solvers.solver_types()["cvxopt"], "requires", ("package", "no_such_package")
    )
    refusal(
        lambda: make_solver("cvxopt"),
        "no_such_package is not installed ",
        "the extra [solvers]",
    )
    monkeypatch.setattr(
        solvers.solver_types()["mosek"], "requires", ("package", "numpy")
    )
    monkeypatch.delenv("MOSEKLM_LICENSE_FILE", raising=False)
    monkeypatch.setenv("HOME", "/nonexistent")
    refusal(lambda: make_solver("mosek"), "no licence")


METHODS = ["lmi-sdp", "lmi-sdp-thickness", "lmi-sdp-plain"]


def both(task, method):
    """The default fit, and Clarabel's."""
    posed = make_estimator(method).posed(task)
    return PosedSdp(task, posed).fit(), PosedSdp(task, posed, "clarabel").fit()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("links", [2, 3, 7])
def test_a_fit_is_proved_from_its_own_multipliers(method, links):
    """Matrices, cones of a centre of mass that bind, signs and ranges; with a log det
    and without."""
    task = chain_task(links)
    cones = shape_cones(task)
    task = replace(task, constraints=task.constraints.plus(cones))
    fit, reference = both(task, method)
    assert fit.details["solver"] == "primal-dual"
    assert -1e-12 <= fit.gap <= 1e-8
    assert min(cone.margin(fit.theta) for cone in cones) < 1e-6
    assert certainly_feasible(fit.problem.constraints.convex, fit.theta)
    for one, other in ((fit, reference), (reference, fit)):
        upper = other.problem.value(other.theta)
        assert one.lower <= upper + 1e-12 * abs(upper)


def test_a_long_chain_needs_no_second_solver():
    """A range of friction that grew with the sum of the links' lengths made the lower
    bound loose, and every fit of a long chain sixty times slower."""
    fit = LmiSdp().fit(chain_task(60))
    assert fit.details["solver"] == "primal-dual"
    assert fit.gap <= 1e-9


@pytest.mark.parametrize("method", METHODS)
def test_similar_data_take_fewer_steps_from_the_last_fit(method):
    task = chain_task(7)
    posed = PosedSdp(task, make_estimator(method).posed(task))
    first = posed.fit()
    data = posed.problem.least_squares
    noise = 0.1 * np.linalg.norm(data.rho) / np.sqrt(len(data.rho) * data.rows)
    moved = replace(
        data, rho=data.rho + noise * np.random.default_rng(1).normal(size=len(data.rho))
    )
    again = replace(posed.problem, least_squares=moved)
    cold = posed.with_problem(again).fit()
    warm = posed.with_problem(again).fit(near=first)

    def steps(fit):
        return int(fit.details["solver_said"][0].rpartition("(")[2].rstrip(")"))

    assert cold.gap <= 1e-8
    assert warm.gap <= 1e-8
    assert again.value(warm.theta) == pytest.approx(again.value(cold.theta), rel=2e-8)
    assert steps(warm) < steps(cold)


def test_cones_of_a_higher_order_are_clarabels():
    task = chain_task(2)
    link = task.links[0]
    size = 5  # |(m, c, a constant)| within a bound
    columns = np.zeros((4, size))
    columns[np.arange(4), np.arange(1, size)] = 1.0
    ball = build.linear(
        "ball", "link 1", link[:4], columns, [100.0, 0.0, 0.0, 0.0, 0.0], "soc"
    )
    task = replace(task, constraints=ConstraintSet((*task.constraints.convex, ball)))
    fit, reference = both(task, "lmi-sdp")
    assert fit.details["solver"] == "clarabel"
    assert fit.gap <= 1e-8
    assert_array_equal(fit.theta, reference.theta)


def test_a_quadratic_form_keeps_what_small_units_make_small():
    """Curvatures of 1 and 1e-18 are both in the factor: their columns have other units."""
    rng = np.random.default_rng(0)
    unit = np.array([1.0, 1e-9, 1e6])
    R = rng.normal(size=(5, 3)) * unit
    P = sparse.csc_matrix(np.triu(2.0 * R.T @ R))
    empty = sparse.csc_matrix((0, 3))
    G = quadratic_factor(solvers.ConicProblem(P, np.zeros(3), empty, np.zeros(0), ()))
    rebuilt = (G.T @ G).toarray() / np.outer(unit, unit)
    assert_allclose(rebuilt, 2.0 * R.T @ R / np.outer(unit, unit), rtol=1e-12)


def test_substituted_equalities_leave_the_parameters_where_they_are():
    """The last variable of each equality goes, whatever its coefficient."""
    A = sparse.csc_matrix([[5.0, 0.0, -1.0], [1.0, 1.0, 0.0]])
    cones = (solvers.Cone("zero", 1), solvers.Cone("nonnegative", 1))
    no_curvature = sparse.csc_matrix((3, 3))
    q = np.array([0.0, 0.0, 1.0])
    form = without_equalities(
        solvers.ConicProblem(no_curvature, q, A, np.array([2.0, 3.0]), cones)
    )
    assert_allclose(form.problem.q, [5.0, 0.0])
    x, _ = form.back(np.array([1.0, 2.0]), np.zeros(1))
    assert_allclose(x, [1.0, 2.0, 3.0])
