"""A known value is an equality of the problem: certified, exact, everywhere the same."""

import numpy as np
import pytest
from recorded import refusal
from small_runs import small_run

import sdp_vs_penalty as sdp
from sdp_vs_penalty.diagnosis.diagnose import DiagnosisRuns
from sdp_vs_penalty.diagnosis.held_out import HeldOutData, least_squares_parameters
from sdp_vs_penalty.estimation import verify_proof_file
from sdp_vs_penalty.problem.load import with_bounds


@pytest.fixture(scope="module")
def run(two_link):
    return small_run(two_link)


@pytest.fixture(scope="module")
def free(two_link, run):
    return sdp.identify(two_link, run, check=False)


def value(estimate, name):
    names = [p.name for p in estimate.model.parameters]
    return float(estimate.theta[names.index(name)])


def half_as_much_again(two_link):
    """A mass that the robot's file does not have."""
    return {"m2": 1.5 * float(two_link.nominal_links[1, 0])}


@pytest.mark.parametrize(
    "method", ["lmi-sdp", "lmi-sdp-plain", "lmi-sdp-thickness", "penalty", "ols"]
)
def test_every_method_holds_a_known_mass_to_the_last_bit(two_link, run, free, method):
    known = half_as_much_again(two_link)
    found = sdp.identify(two_link, run, method, known=known, check=False)
    assert value(found, "m2") == known["m2"]
    assert (
        dict(zip(found.to_frame().index, found.sources, strict=True))["m2"] == "given"
    )
    assert method == "ols" or not any(
        found.certificate.violations[family] for family in ("pseudo-inertia", "mass")
    )
    assert found.certificate.gap is None or found.certificate.gap < 1e-7
    # Masses are seen in sums with others only: the torque leaves it free.
    assert found.certificate.loss < 1.05 * free.certificate.loss


@pytest.mark.parametrize("mx2", [-0.8, -1.5])
def test_the_prior_pulls_what_is_free_where_the_file_excludes_a_known_value(
    two_link, run, mx2
):
    """Beside the file's mass and moments there is no link with it: mx^2 > m Sigma_xx."""
    m, mx, *_, Ixx, _, Iyy, _, _, Izz = two_link.nominal_links[1].tolist()
    assert mx2**2 > m * 0.5 * (Iyy + Izz - Ixx) > mx**2
    found = sdp.identify(two_link, run, known={"mx2": mx2}, check=False)
    assert value(found, "mx2") == mx2
    assert found.certificate.worst == 0.0
    assert found.certificate.gap < 1e-6


def test_a_known_value_goes_with_the_model(two_link, run, free, tmp_path):
    """Saved, added to, proved, left out in turn: the value is the same."""
    known = half_as_much_again(two_link)
    path = tmp_path / "model.json"
    proof = tmp_path / "proof.json"
    sdp.identify(two_link, run, known=known, check=False, proof=proof).save(path)
    found = sdp.load_estimate(path)
    assert found.model.known == known
    holds, words = verify_proof_file(proof, found, run)
    assert holds, words
    assert "these measurements make its numbers" in words
    (interval,) = (x for x in found.uncertainty.standard if x.name == "m2")
    assert (interval.std, interval.lower, interval.upper) == (
        0.0,
        known["m2"],
        known["m2"],
    )
    n_free = sum(not np.isnan(x.std) for x in free.uncertainty.base)
    assert sum(not np.isnan(x.std) for x in found.uncertainty.base) == n_free
    added = sdp.add(found, "joint_spring:1", run)
    assert value(added, "m2") == known["m2"]
    assert added.certificate.worst == 0.0
    (shown,) = sdp.compare(found, run)
    (of_free,) = sdp.compare(free, run)
    share = shown.relative_error_percent / of_free.relative_error_percent
    assert share == pytest.approx(1.0, abs=0.05)  # of all torque, what is known in it
    folds = sdp.cross_validate(two_link, run, known=known, folds=2)
    place = [p.name for p in found.model.parameters].index("m2")
    assert {float(fold.theta[place]) for fold in folds.folds} == set(known.values())


def test_errors_on_a_test_run_are_of_fits_that_hold_a_known_value(two_link, run):
    """A viscous friction that is not the arm's 0.5: no fit may mend it."""
    known = sdp.identify(two_link, run, known={"f_v1": 0.8}, check=False)
    runs = DiagnosisRuns(known, run, test=small_run(two_link, seed=1))
    rows = runs.test_rows
    own = np.sqrt(np.mean(rows.residual[rows.keep[:, 0], 0] ** 2))  # .16, noise .05
    judge = HeldOutData(known, rows, frozen=False)
    fitted = judge.held_out_errors(runs.rows, (), known)
    assert fitted.errors(())[0] == pytest.approx(own, rel=0.1)
    # Without bounds and prior, it errs somewhat more.
    fits = least_squares_parameters, None
    free, bound = (fitted._squares((), False, fit)[..., 0].sum() for fit in fits)
    assert np.sqrt(free / bound) == pytest.approx(1.0, rel=0.25)


def test_equal_bounds_are_a_known_value(two_link, run):
    problem = with_bounds(two_link, "m2=2.5:2.5")
    found = sdp.identify(problem, run, check=False)
    same = sdp.identify(two_link, run, known={"m2": 2.5}, check=False)
    assert value(found, "m2") == 2.5
    np.testing.assert_allclose(found.theta, same.theta, rtol=1e-6, atol=1e-9)
    assert found.certificate.worst == 0.0
    # What the file states is shown, not the middle of the bounds.
    assert found.to_frame().nominal["m2"] == two_link.nominal_links[1, 0]


@pytest.mark.parametrize(
    ("known", "words"),
    [
        ({"nonsense": 2.5}, ["nonsense", "unknown"]),
        ({"m2": float("nan")}, ["m2", "give a number"]),
        ({"m2": 50.0}, ["mass (link 2)", "m2 = 50"]),
        ({"f_v1": -1.0}, ["sign", "f_v1 = -1"]),
    ],
)
def test_a_value_that_cannot_be_is_refused(two_link, run, known, words):
    refusal(lambda: sdp.identify(two_link, run, known=known, check=False), *words)
