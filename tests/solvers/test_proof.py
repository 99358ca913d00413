"""Proofs that travel: true ones pass, changed ones never, false claims are refused by
arithmetic."""

import copy
import json
import os
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from commands import run_cli
from proofs import FALSE, cases, inflated, signed, widened, without_loss
from random_robots import posed_task
from unchecked import identify

from sdp_vs_penalty import Estimate, Measurements, load_problem
from sdp_vs_penalty.data import save
from sdp_vs_penalty.errors import Infeasible, InputError
from sdp_vs_penalty.estimation import certify, verify_proof_file
from sdp_vs_penalty.estimators import make_estimator
from sdp_vs_penalty.regression import LeastSquares
from sdp_vs_penalty.robot import ConstraintSet
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.simulation import experiment
from sdp_vs_penalty.solvers import ConvexProblem, proof, verify_proof

METHODS = ("lmi-sdp", "lmi-sdp-plain", "lmi-sdp-entropic", "penalty")


def run_of(problem, seed):
    """A run of the problem's arm at a quarter of the experiment's samples."""
    return experiment(problem).training_run(seed).rows(slice(None, None, 4))


@pytest.fixture(scope="module")
def proofs(two_link):
    """One of each formulation: matrices, cones and bounds, with and without the
    entropy."""
    task = posed_task(two_link, experiment(two_link).training_run(seed=1))
    made = {}
    for method in METHODS:
        fit = make_estimator(method).fit(task)
        theta, certificate = certify(task, fit)
        made[method] = proof.optimum_proof(replace(fit, theta=theta))
        # The two bounds are found in different arithmetic from the same multipliers.
        assert float(made[method]["lower"]) == pytest.approx(
            certificate.lower, rel=1e-7
        )
        assert float(made[method]["upper"]) == pytest.approx(
            certificate.upper, rel=1e-12
        )
    return made


@pytest.mark.parametrize("method", METHODS)
def test_a_true_proof_holds_and_its_interval_is_tight(proofs, method):
    lower, upper = verify_proof.check(proofs[method])
    assert 0 < lower <= upper
    assert float((upper - lower) / upper) < 1e-6


def test_the_checker_stands_alone(proofs, tmp_path):
    """The standard library alone, in another process: exit code 0 or 1."""
    source = Path(verify_proof.__file__)
    alone = tmp_path / "verify_proof.py"
    alone.write_text(source.read_text())
    interval = verify_proof.check(proofs["lmi-sdp"])
    for name, edit, code in (("good", {}, 0), ("bad", {"lower": "1e9"}, 1)):
        path = tmp_path / f"{name}.json"
        proof.write_proof({**proofs["lmi-sdp"], **edit}, path)
        done = subprocess.run(
            [sys.executable, "-I", "-S", alone, path], capture_output=True, text=True
        )
        assert done.returncode == code, done.stderr
        share = verify_proof.in_words(verify_proof.relative_gap(proofs["lmi-sdp"]))
        claim = (
            f"optimum in {[float(x) for x in interval]}, gap {share} of the objective\n"
        )
        assert done.stdout == (claim if code == 0 else "")
    (tmp_path / "text.json").write_text(json.dumps({"format": 1}))
    done = subprocess.run(
        [sys.executable, "-I", alone, tmp_path / "text.json"], capture_output=True
    )
    assert done.returncode == 1


def test_identify_writes_a_proof_and_verify_accepts_it(tmp_path, capsys):
    problem = load_problem("two_link")
    path = tmp_path / "proof.json"
    run = run_of(problem, 2)
    estimate = identify(problem, run, proof=path)
    assert [
        float(x) for x in json.loads(path.read_text())["theta"]
    ] == estimate.theta.tolist()
    model = tmp_path / "model.json"
    data = tmp_path / "run.csv"
    other = tmp_path / "other.csv"
    estimate.save(model)
    save(run, data)
    save(run_of(problem, 3), other)
    assert run_cli("verify", path) == 0
    assert "the model describes the robot is not" in capsys.readouterr().out
    # A file of decimals is the same numbers: the run is read back to the last bit.
    assert run_cli("verify", path, "--model", model, "--data", data) == 0
    assert "make its numbers" in capsys.readouterr().out
    assert run_cli("verify", path, "--model", model, "--data", other) == 1
    assert "other measurements" in capsys.readouterr().out
    identify(problem, run, "lmi-sdp-plain").save(model)
    assert run_cli("verify", path, "--model", model) == 1
    assert run_cli("verify", path, "--data", data) == 2
    assert run_cli("verify", tmp_path / "absent.json") == 2
    path.write_text(path.read_text().replace('"floor": "', '"floor": "1'))
    assert run_cli("verify", path) == 1
    with pytest.raises(InputError, match="no lower bound"):
        identify(problem, run, "ols", proof=path)


@dataclass(frozen=True)
class Proved:
    """A run, its model, and the text of the proof that `identify` wrote."""

    run: Measurements
    estimate: Estimate
    text: str


@pytest.fixture(scope="module")
def proved(two_link, tmp_path_factory):
    path = tmp_path_factory.mktemp("proved") / "proof.json"
    run = run_of(two_link, 2)
    estimate = identify(two_link, run, proof=path)
    return Proved(run, estimate, path.read_text())


def with_first(proof, family, **fields):
    """The proof with other fields of the first constraint of a family."""
    out = copy.deepcopy(proof)
    next(c for c in out["constraints"] if c["family"] == family).update(fields)
    return out


def test_a_proof_of_another_problem_is_refused_by_the_name_of_what_differs(
    proved, two_link, tmp_path
):
    """Each of these holds in exact arithmetic, and bears the hashes of the model and
    the run; so do theta and rows of other measurements."""
    path = tmp_path / "proof.json"
    true = json.loads(proved.text)
    identify(two_link, run_of(two_link, 3), proof=tmp_path / "foreign.json")
    foreign = json.loads((tmp_path / "foreign.json").read_text())
    foreign |= {"model": true["model"], "data": true["data"]}
    names = true["parameters"]
    mass = next(c for c in true["constraints"] if c["family"] == "mass")
    prior = next(c for c in true["constraints"] if c["entropy"])
    pull = {
        **prior["entropy"][0],
        "log_det": str(Fraction(prior["entropy"][0]["log_det"]) - 1),
    }
    looser = [str(Fraction(x) + Fraction(1, 2**20)) for x in mass["constant"]]
    lies = {
        "theta is not the model's": foreign,
        "another R, rho or floor": foreign | {"theta": true["theta"]},
        "order": {**true, "parameters": [names[1], names[0], *names[2:]]},
        "bound of": {**true, "bound": [str(Fraction(x) * 2) for x in true["bound"]]},
        "of the model": {
            **true,
            "constraints": [c for c in true["constraints"] if c is not mass],
        },
        "none of the model": {**true, "constraints": [*true["constraints"], mass]},
        "constraint 1 is": {**true, "constraints": true["constraints"][::-1]},
        "another constant": with_first(true, "mass", constant=looser),
        "another entropy": with_first(true, prior["family"], entropy=[pull]),
    }
    for words, lie in lies.items():
        weaker = {
            **lie,
            "lower": "-1e12",
            "upper": "1e12",
        }  # the multipliers are of another problem
        path.write_text(json.dumps(signed(weaker)))
        holds, said = verify_proof_file(path, proved.estimate, proved.run)
        assert not holds, words
        assert words in said


#: Intervals that hold the optimum and say nothing of it, and one that says too little.
WEAK = {
    "vacuous": [("-1e308", "1e308"), ("-1e12", "1e12"), ("0", None), (None, "1e308")],
    "loose": [("0.9", None), (None, "1.5")],
}


@pytest.mark.parametrize(("lower", "upper"), WEAK["vacuous"])
def test_a_vacuous_proof_is_not_accepted(proofs, tmp_path, lower, upper):
    true = proofs["lmi-sdp-plain"]
    ends = {"lower": lower or true["lower"], "upper": upper or true["upper"]}
    path = tmp_path / "proof.json"
    path.write_text(json.dumps(signed({**true, **ends})))
    holds, said = verify_proof_file(path)
    assert not holds
    assert "vacuous" in said


@pytest.mark.parametrize(("low", "high"), WEAK["loose"])
def test_a_loose_proof_shows_no_optimum(proofs, tmp_path, low, high):
    true = proofs["lmi-sdp-plain"]
    lower = repr(float(true["lower"]) * float(low or 1.0))
    upper = repr(float(true["upper"]) * float(high or 1.0))
    path = tmp_path / "proof.json"
    edited = {**true, **({"lower": lower} if low else {"upper": upper})}
    path.write_text(json.dumps(signed(edited)))
    holds, said = verify_proof_file(path)
    assert not holds
    assert "loose" in said


def test_the_gap_is_printed(proofs, tmp_path):
    path = tmp_path / "proof.json"
    proof.write_proof(proofs["lmi-sdp"], path)
    share = verify_proof.in_words(verify_proof.relative_gap(proofs["lmi-sdp"]))
    assert f"its gap is {share} of the objective" in verify_proof_file(path)[1]


def test_a_proof_wider_than_the_models_certificate_is_refused(proved, tmp_path):
    path = tmp_path / "proof.json"
    path.write_text(proved.text)
    assert verify_proof_file(path, proved.estimate)[0]
    true = json.loads(proved.text)
    wider = repr(float(true["upper"]) * (1.0 + 1e-6))
    path.write_text(json.dumps(signed({**true, "upper": wider})))
    assert verify_proof_file(path)[0]
    holds, said = verify_proof_file(path, proved.estimate)
    assert not holds
    assert "wider than" in said
    assert "certificate" in said


def test_another_triangle_of_the_same_loss_and_rounding_are_the_same_problem():
    """R is unique up to an orthogonal factor; a matrix's rounding is no other matrix."""
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    data = LeastSquares(rng.normal(size=(3, 2)), rng.normal(size=3), 0.5, 1.0, 9)
    turned = LeastSquares(turn @ data.R, turn @ data.rho, 0.5, 1.0, 9)
    near = build.linear("mass", "a", [0], [[-1.0, 1e-17]], [0.3, 1.0])
    same = build.linear("mass", "a", [0], [[-1.0, 0.0]], [0.3 * (1 + 1e-12), 1.0])
    other = build.linear("mass", "a", [1], [[-1.0, 0.0]], [0.3, 1.0])
    bound = np.array([10.0, 20.0])

    def stated(data, convex):
        return proof.stated(ConvexProblem(data, ConstraintSet((convex,)), bound))

    own = stated(data, near)
    assert proof.difference(stated(turned, same), own) == ""
    assert "mass of a, nonnegative in [1]" in proof.difference(stated(data, other), own)


def test_no_false_proof_is_accepted_and_no_genuine_one_refused(tmp_path):
    """SDP_VS_PENALTY_PROOFS=NUMBER:SEED puts others, and more of them, to the checker."""
    asked = os.environ.get("SDP_VS_PENALTY_PROOFS", "150:7")
    count, seed = map(int, asked.split(":"))
    file = tmp_path / "proof.json"
    judged = set()
    for kind, content, true in cases(count, seed):
        file.write_text(content)
        begin = time.process_time()
        accepted = False
        with suppress(Exception):
            verify_proof.check(verify_proof.read(file))
            accepted = True
        assert accepted == true, f"{kind}: {content}"
        assert time.process_time() - begin < 2.0
        judged.add(kind)
    assert judged == {*FALSE, "unreadable", "genuine optimum", "genuine infeasible"}


def test_a_proof_without_loss_is_measured_by_its_objective(tmp_path):
    """True ones pass; ten kinds of false ones never, nor a constant that makes the
    objective look large."""
    file = tmp_path / "proof.json"
    rng = np.random.default_rng(1)
    ways = {**FALSE, "inflated": inflated, "widened": widened}
    judged = set()
    for _ in range(12):
        true = without_loss(rng)
        file.write_text(json.dumps(signed(true)))
        assert verify_proof.main(file).startswith("optimum in")
        for name, make in ways.items():
            forged = make(true, rng)
            if forged is None:
                continue
            file.write_text(json.dumps(signed(forged)))
            with pytest.raises((ValueError, LookupError, ArithmeticError)):
                verify_proof.main(file)
            judged.add(name)
    assert judged == {*ways}


def test_huge_numbers_and_deep_files_are_refused_at_once(tmp_path):
    begin = time.process_time()
    for text in (
        "[" * 10**6,
        '{"a": ' * 10**5,
        json.dumps({"format": verify_proof.FORMAT, "kind": []}),
    ):
        (tmp_path / "a.json").write_text(text)
        assert not verify_proof_file(tmp_path / "a.json")[0]
    # Matrices of 6 x 6 whose entries have 4000 digits each, as dense as can be.
    d = 6
    big = str(3**8000)[:2000]
    psd = {"family": "", "name": "", "cone": "psd", "indices": [0], "entropy": []}
    full = [f"{big}e-2000" if i % (d + 1) else "9" for i in range(d * d)]
    psd |= {"constant": full, "coefficients": [full], "dual": full}
    body = {
        "format": verify_proof.FORMAT,
        "kind": "optimum",
        "model": "",
        "data": "",
        "floor": "0",
    }
    body |= {
        "parameters": ["x"],
        "R": [],
        "rho": [],
        "y": [],
        "bound": ["9"],
        "theta": [f"{big}e-2000"],
    }
    body |= {"constraints": [psd] * 3, "lower": "1", "upper": "0"}
    with pytest.raises(ValueError, match=r"."):
        verify_proof.check(signed(body))
    assert time.process_time() - begin < 2.0


def test_constraints_that_exclude_each_other_leave_a_proof_of_it(tmp_path):
    problem = load_problem("two_link")
    path = tmp_path / "proof.json"
    heavy = replace(problem, total_mass=(1000.0, 2000.0))
    with pytest.raises(Infeasible, match="admit no parameters"):
        identify(heavy, run_of(problem, 2), proof=path)
    assert verify_proof.check(json.loads(path.read_text())) is None
