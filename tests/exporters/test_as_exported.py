"""What is exported is what is judged: files hold what they can, the verdict is theirs."""

import inspect
import json
import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from commands import run_cli
from dynamics_files import FULL, READERS, by_c, estimate_of
from numpy.testing import assert_allclose
from random_robots import states
from small_runs import write_run

from sdp_vs_penalty import export, load_problem
from sdp_vs_penalty.api import exporting
from sdp_vs_penalty.data import save
from sdp_vs_penalty.effects import Motion, effect_types
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.exporters import EXPORTS
from sdp_vs_penalty.exporters.c_formulas import has_closed_form
from sdp_vs_penalty.exporters.export import as_exported, write_model
from sdp_vs_penalty.exporters.interface import ExportFormat
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs

#: What every model here has.
USUAL = f"{FULL},torque_offset"


def constants_of_a_search(kind, robot):
    """Of each shape constant with a grid a value that a search begins with, and that is
    not the default, which C that forgets the constant might hold all the same."""
    starts = kind.candidates(robot, None if kind.whole_robot else 0)
    found = {}
    for key, shape in kind.shapes.items():
        values = {*shape.grid, *(x.shape[key] for x in starts if key in x.shape)}
        others = sorted(values - {shape.default})
        if shape.grid and others and not shape.choices:
            found[key] = others[len(others) // 2]
    return found


def laws_of_one_instant():
    """Each law of each effect that needs no more than q, dq, ddq and the links' load, on
    both of two joints, beside those that every model here has; whether C holds it."""
    robot = load_problem("two_link").robot
    estimate = estimate_of(robot, USUAL, 1)
    for name, kind in effect_types().items():
        if name in USUAL.split(",") or kind.forward != "torque":
            continue
        choices = {k: s.choices for k, s in kind.shapes.items() if s.choices}
        constants = constants_of_a_search(kind, robot)
        for values in product(*choices.values()):
            chosen = dict(zip(choices, values, strict=True))
            own = kind(robot, **chosen).shapes  # a law may have constants of its own
            drawn = {key: x for key, x in constants.items() if key in own}
            effect = kind(robot, **drawn, **chosen)
            needs = (effect.has_memory, effect.follows_clock, effect.needs_torque)
            if not any(needs):
                yield effect.text, has_closed_form(effect, estimate)


LAWS = dict(laws_of_one_instant())


def torque(estimate, q, dq, ddq):
    return estimate.torque(Motion(np.zeros(len(q)), q, dq, ddq))


def test_few_laws_of_one_instant_are_not_in_c():
    names = {
        written.partition("@")[0] for written, is_in_c in LAWS.items() if not is_in_c
    }
    # Of the links' regressor, of a table, of a temperature; a payload is in the links.
    of_links = {"base_tilt", "external_wrench", "joint_zero_error", "kinematic_error"}
    others = {"measured_curve", "transmission_friction", "warming_friction", "payload"}
    assert names == of_links | others


def without_the_last(estimate):
    """The estimate with nothing of its last effect."""
    theta = estimate.theta.copy()
    theta[estimate.model.parts[-1][1]] = 0.0
    return replace(estimate, theta=theta)


@pytest.mark.parametrize("written", [x for x, is_in_c in LAWS.items() if is_in_c])
def test_the_header_makes_each_effects_torque(written, two_link, tmp_path):
    robot = two_link.robot
    estimate = estimate_of(robot, f"{USUAL},{written}", 4)
    assert export(estimate, tmp_path / "model.h") == ()
    q, dq, ddq = states(robot, 50, 2)
    dq[:10] *= 0.003  # about to turn round
    made = by_c(tmp_path / "model.h", robot, q, dq, ddq)
    expected = torque(estimate, q, dq, ddq)
    assert_allclose(made, expected, rtol=0.0, atol=1e-9)
    usual = torque(without_the_last(estimate), q, dq, ddq)
    assert np.all(np.abs(expected - usual).max(axis=0) > 1e-3)


def exportable(ending):
    return hasattr(EXPORTS.all()[ending], "HOLDS")


def everything(name):
    """An effect of the library beside the usual ones."""
    return f"{FULL},{name}" if name not in FULL.split(",") else FULL


#: Names of the effects of the library that act without a servo in the loop.
NAMES = sorted(name for name, kind in effect_types().items() if kind.forward != "drive")

#: Those that files write in ways of their own; all others are in one model further below.
ALONE = ("joint_spring", "payload", "rigid_body", "torque_ripple")


def with_payload_that_exists(estimate):
    """The estimate with a consistent payload, where it has one."""
    is_payload = [p.effect == "payload" for p in estimate.model.parameters]
    theta = estimate.theta.copy()
    if any(is_payload):
        moments = [4e-3, 0.0, 5e-3, 0.0, 0.0, 3e-3]
        load = [1.3, 0.01, 0.02, 0.1, *moments]
        theta[is_payload] = inertia.standard_from_barycentric(load)
    return replace(estimate, theta=theta)


def check_that_file_is_what_is_judged(estimate, out):
    """The torque of the reloaded file against that of the copy that gets the verdict;
    what the file leaves out is named."""
    left_out = export(estimate, out)
    judged = as_exported(estimate, out)
    lost = [e.brief for e in estimate.model.effects if e not in judged.model.effects]
    assert sorted(left_out) == sorted(lost)
    rows = states(estimate.robot, 20, 1)
    for read in READERS[ending_of(out)][0]:
        made = read(out, estimate.robot, *rows)
        assert_allclose(made, torque(judged, *rows), rtol=0.0, atol=1e-8)


def ending_of(out):
    """The longest ending of a format that fits a file's name."""
    return max((e for e in READERS if out.name.endswith(e)), key=len)


@pytest.mark.parametrize("ending", EXPORTS.all())
def test_a_format_offers_what_the_interface_describes(ending):
    home = EXPORTS.all()[ending]
    described = list(inspect.signature(ExportFormat.write).parameters)[1:]
    assert list(inspect.signature(home.write).parameters)[: len(described)] == described


def test_every_format_of_a_model_has_a_reader():
    holding = {ending for ending in EXPORTS.all() if exportable(ending)}
    assert holding == set(READERS)


@pytest.mark.parametrize("ending", READERS)
@pytest.mark.parametrize("name", ALONE)
def test_each_file_makes_the_torque_of_the_model_that_is_judged(
    name, ending, two_link, tmp_path
):
    """Whatever the effect: the file and the copy that gets the verdict are one model."""
    estimate = estimate_of(two_link.robot, everything(name), 5)
    estimate = with_payload_that_exists(estimate)
    check_that_file_is_what_is_judged(estimate, tmp_path / f"out{ending}")


def with_every_effect(choice=None):
    """A model of two joints with every effect that acts without a servo; of constants
    with few values the default, or that of a number (from 0, then from the first again).
    """
    texts = [FULL]
    for name in NAMES:
        shapes = {} if choice is None else effect_types()[name].shapes
        values = {k: s.choices for k, s in shapes.items() if s.choices}
        chosen = [f"@{k}={v[choice % len(v)]:g}" for k, v in values.items()]
        if name not in FULL.split(","):
            texts.append(name + "".join(chosen))
    return estimate_of(load_problem("two_link").robot, ",".join(texts), 5)


@pytest.mark.parametrize("choice", range(5))
@pytest.mark.parametrize("ending", READERS)
def test_a_model_with_every_effect_is_what_its_file_holds(ending, choice, tmp_path):
    estimate = with_payload_that_exists(with_every_effect(choice))
    check_that_file_is_what_is_judged(estimate, tmp_path / f"out{ending}")


def test_plain_json_holds_every_effect_with_its_values(tmp_path):
    """A model built anew from the JSON's words makes the same torque."""
    estimate = with_every_effect()
    assert export(estimate, tmp_path / "effects.json") == ()
    content = json.loads((tmp_path / "effects.json").read_text())
    values = [p["value"] for e in content["effects"] for p in e["parameters"]]
    assert_allclose(values, estimate.theta, rtol=0.0, atol=0.0)
    names = [e["effect"] for e in content["effects"]]
    assert names == [e.name for e in estimate.model.effects]
    model = estimate.model
    referred = model.reference[model.rigid_indices].reshape(-1, 10)
    masses = [link["mass_kg"] for link in content["reference_links"]]
    assert_allclose(masses, referred[:, 0], rtol=0.0, atol=0.0)


@pytest.fixture(scope="module")
def sprung(tmp_path_factory):
    """A folder with a model that has what its runs hide: a spring."""
    folder = tmp_path_factory.mktemp("sprung")
    problem = load_problem("two_link")
    runs = hidden_runs(problem, [("joint_spring", [1])], "strong", 24, 3).runs
    files = [folder / f"{name}.csv" for name in ("a", "b", "test")]
    for run, file in zip(runs, files, strict=True):
        save(run.rows(slice(None, None, 10)), file)
    data = ["--data", files[0], files[1]]
    model = folder / "model.json"
    better = folder / "better.json"
    assert run_cli("identify", "two_link", *data, "--out", model) == 0
    add = ["add", model, "joint_spring:2", *data, "--test", files[2]]
    assert run_cli(*add, "--out", better) == 0
    return folder


def head(path):
    """What a file says of itself."""
    return path.read_text()[:600]


def test_a_urdf_without_the_spring_is_judged_without_it(sprung, capsys):
    out = sprung / "robot.urdf"
    assert run_cli("export", sprung / "better.json", "--out", out) == 0
    said = " ".join(capsys.readouterr().out.split())
    verdict = re.search(
        r"As exported, without torque offset, joint spring.*?Verdict on test", head(out)
    )
    assert verdict, head(out)
    assert "As exported, without torque offset, joint spring" in said
    loss = r"Without what this file leaves out, joint 2 errs more: [\d.]+ -> [\d.]+ N m"
    assert re.search(loss, said)
    assert re.search(loss, out.read_text())


def test_a_mujoco_file_with_the_spring_keeps_the_models_verdict(sprung, capsys):
    out = sprung / "robot.xml"
    assert run_cli("export", sprung / "better.json", "--out", out) == 0
    assert "Verdict: Good" in capsys.readouterr().out
    assert "As exported" not in head(out)


def test_without_the_runs_a_file_says_that_it_is_not_judged(sprung, tmp_path, capsys):
    from sdp_vs_penalty import load_estimate

    estimate = load_estimate(sprung / "better.json")
    export(estimate, tmp_path / "robot.urdf")
    assert "Not judged as exported, without torque offset, joint spring" in head(
        tmp_path / "robot.urdf"
    )


def test_python_judges_on_the_runs_it_is_given(sprung, tmp_path):
    out = tmp_path / "robot.sdf"
    export(sprung / "better.json", out, measurements=sprung / "test.csv")
    assert "As exported, without torque offset, joint spring" in head(out)


def test_a_file_is_made_of_a_model_that_is_identified_again_for_it(sprung, capsys):
    """Links and friction take in what they can of the spring that a URDF has no place
    for; the file's verdict is that model's."""
    out = sprung / "again.urdf"
    words = ["export", sprung / "better.json", "--out", out, "--test"]
    assert run_cli(*words, sprung / "test.csv") == 0
    without = re.search(
        r"joint 2 errs more: [\d.]+ -> ([\d.]+)", capsys.readouterr().out
    )
    fitted = ["--refit", "--data", sprung / "a.csv", sprung / "b.csv"]
    assert run_cli(*words, sprung / "test.csv", *fitted) == 0
    again = re.search(r"joint 2 errs more: [\d.]+ -> ([\d.]+)", capsys.readouterr().out)
    assert float(again[1]) < float(without[1])
    (by_python,) = set(
        export(
            sprung / "better.json",
            sprung / "python.urdf",
            measurements=[sprung / "a.csv", sprung / "b.csv"],
            test=sprung / "test.csv",
            refit=True,
        )
    ) - {"torque_offset"}
    assert by_python.startswith("joint_spring")
    texts = [(sprung / name).read_text() for name in ("again.urdf", "python.urdf")]
    assert texts[0] == texts[1]
    assert "As exported, without torque offset, joint spring" in head(out)
    assert "Verdict on test" in head(out)


def test_a_header_lists_what_its_model_was_identified_without(tmp_path):
    """C has no place for hysteresis: a refit is a model without, and the file lacks it."""
    estimate = estimate_of(load_problem("two_link").robot, USUAL, 1)
    lost = ["presliding_hysteresis:2"]
    out = tmp_path / "model.h"
    assert write_model(estimate, out, identified_without=lost) == tuple(lost)
    assert "Not in this file: pre-sliding hysteresis on joint 2. */" in out.read_text()


def test_a_refit_that_errs_no_less_leaves_the_file_as_it_was(
    sprung, tmp_path, monkeypatch
):
    """Its head says what the file lacks, with the verdict on the model without it."""
    better, run = sprung / "better.json", sprung / "test.csv"
    export(better, tmp_path / "robot.urdf", measurements=run)
    without = (tmp_path / "robot.urdf").read_text()
    monkeypatch.setattr(exporting, "identify_with", lambda model, *_: model)
    export(better, tmp_path / "robot.urdf", measurements=run, refit=True)
    assert (tmp_path / "robot.urdf").read_text() == without


def test_a_file_is_identified_again_from_runs_alone(sprung, capsys):
    words = ["export", sprung / "better.json", "--out", sprung / "again.urdf"]
    assert run_cli(*words, "--refit") == 2
    assert "--data" in capsys.readouterr().err
    with pytest.raises(InputError, match="measurements"):
        export(sprung / "better.json", sprung / "again.urdf", refit=True)


def test_a_run_of_another_robot_is_refused(sprung, tmp_path, capsys):
    run = write_run(tmp_path / "panda.csv", load_problem("panda"))
    words = ["export", sprung / "better.json", "--out", tmp_path / "robot.urdf"]
    assert run_cli(*words, "--data", run) == 2
    assert capsys.readouterr().err.count("\n") == 1
