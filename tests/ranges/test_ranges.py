"""Ranges: certified ends of what data and consistency allow."""

import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from commands import run_cli

from sdp_vs_penalty import InputError, find_ranges, identify, load_estimate, simulate
from sdp_vs_penalty.data import save
from sdp_vs_penalty.estimation.proofs import verify_proof_file
from sdp_vs_penalty.ranges import EndSearch, Ranges, allowed_set, find_end
from sdp_vs_penalty.ranges.allowed import KINDS
from sdp_vs_penalty.ranges.ends import RangeEnd
from sdp_vs_penalty.ranges.functions import functions_by_name
from sdp_vs_penalty.ranges.rays import is_ray
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.simulation.experiments import experiment
from sdp_vs_penalty.solvers.proof import write_proof


@pytest.fixture(scope="module")
def hidden():
    return simulate("two_link", seed=1)


@pytest.fixture(scope="module")
def model(hidden):
    return identify("two_link", hidden.train, check=False)


@pytest.fixture(scope="module")
def allowed(model):
    return allowed_set(model.training.posed, model.theta)


@pytest.fixture(scope="module")
def ends(allowed):
    unit = np.eye(len(allowed.bound))
    return EndSearch(allowed).least_and_greatest(list(unit))


def test_witnesses_are_consistent_fit_and_attain_the_ends(allowed, ends):
    for pair in ends:
        for end in pair:
            residual = allowed.ball.A @ end.witness - allowed.ball.a
            assert residual @ residual < allowed.limit(end.rise)
            assert allowed.constraints.margin(end.witness) > 0.0
            assert end.sign * end.value <= end.sign * end.attained
            assert end.gap <= 1e-6 * max(abs(pair[1].value - pair[0].value), end.size)


@pytest.mark.parametrize("share", [1e-6, 1e-3, 1.0, 1e3, 1e6])
def test_the_search_starts_inside_of_a_ball_of_any_size(allowed, share):
    """However coarse the best fit may be where much error is allowed."""
    c = share * allowed.first_rise
    centre = allowed.optimiser(c).centre
    residual = allowed.ball.A @ centre - allowed.ball.a
    assert residual @ residual < allowed.limit(c)
    assert allowed.constraints.margin(centre) > 0.0


def test_ends_are_those_of_an_outside_solver(allowed, ends):
    """CVXPY and Clarabel, from the same set written down again."""
    cp = pytest.importorskip("cvxpy")
    theta = cp.Variable(len(allowed.bound))
    constraints = []
    for c in allowed.constraints.convex:
        terms = sum(
            theta[int(k)] * F for k, F in zip(c.indices, c.coefficients, strict=True)
        )
        value = c.constant + terms
        constraints.append(value >> 0 if c.cone == "psd" else value >= 0)
    unit = allowed.bound
    ball = allowed.ball
    for end in (ends[0][0], ends[0][1], ends[11][0], ends[14][1]):
        in_ball = cp.norm(ball.A @ theta - ball.a) <= np.sqrt(allowed.limit(end.rise))
        g = end.g / unit[np.argmax(np.abs(end.g))]
        problem = cp.Problem(cp.Minimize(g @ theta), [*constraints, in_ball])
        problem.solve(solver=cp.CLARABEL)
        scale = unit[np.argmax(np.abs(end.g))]
        assert end.lowest == pytest.approx(problem.value * scale, rel=1e-5, abs=1e-6)


def test_no_limit_of_the_programs_own_decides_an_end():
    """Of a URDF that states no masses' bounds; and more constraints never widen a
    range."""
    arm = Path(__file__).parents[2] / "docs" / "my_arm.urdf"
    model = identify(arm, simulate(arm, seed=1).train, check=False)
    found = find_ranges(model, functions=["masses", "mx2", "c2x"], kinds=KINDS)
    for r in found.ranges:
        ends = [r.under[kind] for kind in KINDS]
        assert ends[-1] == (r.least.value, r.greatest.value)
        for wide, narrow in pairwise(ends):
            assert wide[0] <= narrow[0], r.name
            assert narrow[1] <= wide[1], r.name
        for end in (r.least, r.greatest):
            assert not any("mass of" in bound for bound in end.limited_by), r.name


def test_a_function_that_the_data_determine_has_its_interval(model, allowed):
    """Without a constraint that acts, the range is the interval, up to c's grid."""
    (friction,) = functions_by_name(model.problem, model.model, ["f_v1"])
    ((least, greatest),) = EndSearch(allowed).least_and_greatest([friction.g])
    interval = {x.name: x for x in model.uncertainty.standard}["f_v1"]
    length = interval.upper - interval.lower
    assert greatest.value - least.value == pytest.approx(length, rel=0.08)
    assert least.decided_by == "data"


def test_the_true_masses_lie_in_their_ranges(hidden, model):
    found = find_ranges(model, functions=["masses", "c2x", "I2zz"])
    links = experiment(hidden.problem).links
    true = dict(zip(("m1", "m2"), links[:, 0], strict=True))
    for name, mass in true.items():
        assert found[name].least.value <= mass <= found[name].greatest.value
    assert found["I2zz"].least.is_outer
    assert Ranges.from_dict(json.loads(json.dumps(found.to_dict()))) == found


def test_a_sentence_names_both_ranges_where_the_model_errs(model):
    known = model.range("m2")
    assert "model's error" not in replace(known, with_model_error=None).sentence
    erring = replace(known, with_model_error=(0.0, 13.1))
    assert erring.sentence.endswith("With the model's error: 0 to 13.1 kg.")


def test_the_estimate_says_one_range(model):
    assert model.range("m2").name == "m2"


def test_an_end_has_a_proof_that_verify_accepts(model, tmp_path):
    end = find_end(model, "m2", "least")
    write_proof(end.proof("m2"), tmp_path / "proof.json")
    accepted, sentence = verify_proof_file(tmp_path / "proof.json")
    assert accepted
    assert "m2 <=" in sentence


def test_the_proof_of_a_saved_end_names_its_function(hidden, model, tmp_path):
    save(hidden.train[0], tmp_path / "run.csv")
    model.save(tmp_path / "model.json")
    words = (tmp_path / "model.json", "--data", tmp_path / "run.csv")
    for name in ("m1", "m2"):  # the widest range is of one of them
        proof = tmp_path / f"{name}.proof.json"
        assert (
            run_cli("ranges", *words, "--save", f"{name}:least", "--proof", proof) == 0
        )
        assert f"{name} <=" in verify_proof_file(proof)[1]


@pytest.mark.parametrize(
    ("name", "words"), [("m9", "'m9' is no parameter of this model"), ("c2x", None)]
)
def test_names(model, name, words):
    if words is None:
        assert find_ranges(model, functions=[name])[name].unit == "m"
        return
    with pytest.raises(InputError, match=words):
        find_ranges(model, functions=[name])


def test_a_model_from_a_file_needs_data(model, hidden, tmp_path):
    model.save(tmp_path / "model.json")
    saved = load_estimate(tmp_path / "model.json")
    with pytest.raises(InputError, match="names no files of them"):
        saved.range("m2")
    again = saved.range("m2", data=hidden.train)
    assert again.least.value == pytest.approx(
        model.range("m2").least.value, rel=1e-3, abs=1e-6
    )


def test_identify_shows_ranges_after_its_verdict(hidden, tmp_path, capsys):
    save(hidden.train[0], tmp_path / "run.csv")
    words = ("--data", tmp_path / "run.csv", "--no-check", "--out", tmp_path / "m.json")
    assert run_cli("identify", "two_link", *words, "--ranges") == 0
    printed = capsys.readouterr().out
    verdict, after = printed.split("Least and greatest value", 1)
    assert "missing (" in verdict
    assert "optimality gap" not in verdict
    name = re.search(r"ranges \S+ --data \S+ --next (m\d)", after)[1]
    assert f"What would shorten the range of {name}" in after
    links = after.split("Links, identified and nominal")[1]
    assert "can be" in links
    ends = re.search(rf"^{name} +kg +\S+ +\S+ +(\S+) +(\S+)", after, re.M)
    assert f"{ends[1]} to {ends[2]}" in links


@pytest.fixture(scope="module", params=["m1", "m2"])
def open_end(request, model, allowed):
    """The greatest mass: link 1 turns about a fixed axis, and link 2's axis meets it."""
    (mass,) = functions_by_name(model.problem, model.model, [request.param])
    return EndSearch(allowed.with_kinds(["consistency"])).least_and_greatest([mass.g])[
        0
    ][1]


def test_an_open_end_has_a_ray_that_no_torque_shows(open_end):
    assert RangeEnd.from_end(open_end).reason == "open"
    assert open_end.g @ open_end.ray == pytest.approx(-1.0)
    assert np.allclose(open_end.allowed.ball.A @ open_end.ray, 0.0, atol=1e-9)
    far = open_end.allowed.fit + 1e4 * open_end.ray
    assert inertia.consistency_margin(far[:20].reshape(2, 10)).min() > 0.0


@pytest.mark.parametrize(
    "change", [{0: -1.0, 10: -1.0}, {1: 1.0}, {14: 1.0}, {"known": 1.0}], ids=str
)
def test_a_direction_that_data_or_constraints_refuse_is_no_ray(open_end, change):
    """Masses that fall, a centre off the axis, inertia that torque shows, a known
    mass."""
    allowed = open_end.allowed
    d = open_end.ray.copy()
    for place, value in change.items():
        if place == "known":
            model = SimpleNamespace(known_values={0: 1.0, 10: 1.0})
            allowed = replace(allowed, task=SimpleNamespace(model=model))
        else:
            d[place] += value
    assert is_ray(open_end.allowed, open_end.g, open_end.ray, open_end.rise)
    assert not is_ray(allowed, open_end.g, d, open_end.rise)


def test_bounds_close_a_ray(allowed, model):
    (mass,) = functions_by_name(model.problem, model.model, ["m1"])
    ((_, end),) = EndSearch(allowed).least_and_greatest([mass.g])
    assert end.decided_by != "open"
    assert end.ray is None
