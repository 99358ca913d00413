"""Plug-ins of another package: registered, judged, listed, used, saved and loaded."""

import importlib
import subprocess
import sys
import venv
import warnings
import zipfile
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from recorded import refusal
from small_runs import thinned
from unchecked import identify

import sdp_vs_penalty as sdp
from sdp_vs_penalty import InputError, plugins, register
from sdp_vs_penalty.api.registration import REGISTRIES
from sdp_vs_penalty.data.formats import FORMATS
from sdp_vs_penalty.data.log import log_of_arrays
from sdp_vs_penalty.effects import parse_effects
from sdp_vs_penalty.estimators import LmiSdp
from sdp_vs_penalty.estimators.estimator import Fit
from sdp_vs_penalty.simulation.worlds.world import TrueMotion
from sdp_vs_penalty.testing import ContractError, contracts
from sdp_vs_penalty.testing.effect_contract import check_needs_are_declared, variants
from sdp_vs_penalty.testing.files import FORMAT_CONTRACTS, small_run

THEIRS = Path(__file__).parent / "theirs"
#: Of the package in that folder: each plug-in by its module.
PLUGINS = {
    "rubber": "RubberSpring",
    "loaded": "LoadStribeck",
    "ridge": "Ridge",
    "half_hearted": "HalfHearted",
    "semicolons": "",
    "masses": "",
}


@pytest.fixture(scope="module")
def theirs():
    """Their plug-ins by module, imported and not yet registered."""
    sys.path.insert(0, str(THEIRS))
    homes = {name: importlib.import_module(f"theirs.{name}") for name in PLUGINS}
    yield {
        name: getattr(homes[name], kind) if kind else homes[name]
        for name, kind in PLUGINS.items()
    }
    sys.path.remove(str(THEIRS))


@pytest.fixture
def registered(theirs, monkeypatch):
    """Their plug-ins, registered for one test."""
    for registry in REGISTRIES:
        monkeypatch.setattr(registry, "_registered", [])
        vars(registry).pop("_all", None)
    for plugin in theirs.values():
        assert register(plugin) is plugin
    yield theirs
    monkeypatch.undo()
    for registry in REGISTRIES:
        vars(registry).pop("_all", None)


@pytest.mark.parametrize("name", PLUGINS)
def test_a_registered_plugin_keeps_the_contracts(name, registered):
    asked = contracts(registered[name])
    assert len(asked) >= 2
    for contract in asked.values():
        contract()


@pytest.mark.parametrize("name", FORMATS.all())
def test_every_format_keeps_every_contract(name):
    for contract in FORMAT_CONTRACTS:
        contract(FORMATS.all()[name])


def test_a_need_is_what_columns_read_however_small_they_are(registered):
    careless = type("LoadStribeck", (registered["loaded"],), {"needs_links": False})
    judge = contracts(registered["loaded"])["check_needs_are_declared"]
    judge()
    with pytest.raises(ContractError, match="declare needs_links = True"):
        check_needs_are_declared(careless, lambda robot: variants(careless, robot))


@pytest.mark.parametrize(("given", "v_ls"), [("", 0.2), ("@v_ls=0.4", 0.4)])
def test_an_effect_of_the_links_torque_hides_in_the_true_links(given, v_ls, registered):
    """In those of the world, which differ from the file's; with the constant given."""
    runs = sdp.simulate("two_link", f"load_stribeck:2{given}", link_error=0.3)
    (hidden,) = runs.hidden
    t = np.linspace(0.0, 1.0, 50)
    q = np.sin(3.0 * t[:, None] + [0.0, 1.0])
    motion = TrueMotion(t, q, 3.0 * np.cos(3.0 * t[:, None] + [0.0, 1.0]), -9.0 * q)
    load = np.abs(runs.world.rigid(motion)[:, 1])
    dq = motion.dq[:, 1]
    expected = hidden.size * load * np.tanh(dq / 0.01) * np.exp(-np.abs(dq) / v_ls)
    torque = hidden.torque(runs.world, motion)
    np.testing.assert_allclose(torque[:, 1], expected, rtol=1e-6)
    assert not torque[:, 0].any()


def test_a_second_statement_may_be_a_plain_function(registered, monkeypatch):
    kind = registered["rubber"]
    monkeypatch.setattr(
        kind, "hidden_torque", lambda m, j, sign, q_0: q_0 * np.sinh(m.q[:, j] / q_0)
    )
    contracts(kind)["check_hidden_torque"]()
    runs = sdp.simulate("two_link", "rubber_spring:2@q_0=0.7")
    (hidden,) = runs.hidden
    q = np.linspace(-1.0, 1.0, 50)[:, None] + [0.0, 0.2]
    motion = TrueMotion(np.arange(50.0), q, 0.0 * q, 0.0 * q)
    torque = hidden.torque(runs.world, motion)
    np.testing.assert_allclose(torque[:, 1], hidden.size * 0.7 * np.sinh(q[:, 1] / 0.7))
    assert not torque[:, 0].any()


def test_a_constant_at_an_end_of_its_range_is_said(registered):
    """Friction of the load that does not fall with speed: v_ls has no upper end."""
    runs = thinned(sdp.simulate("two_link", "load_dependent_friction:2"))
    bare = sdp.identify("two_link", runs.train, check=False)
    assert not bare.constants_at_ends
    said = "rad/s of load stribeck on joint 2: at an end of the range"
    with pytest.warns(UserWarning, match=said):
        grown = sdp.add(bare, "load_stribeck:2", runs.train)
    assert said in grown.constants_at_ends
    assert said in " ".join(str(grown).split())
    assert said in dict(grown.held_by_bounds)["constants"]
    assert said in sdp.add(grown, "joint_spring:1", runs.train).constants_at_ends
    (effect,) = parse_effects("load_stribeck:2@v_ls=2", bare.robot)
    assert effect.constants == "v_ls = 2 rad/s (an end of its range)"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        given = sdp.add(bare, "load_stribeck:2@v_ls=2", runs.train)
        inside = sdp.add(grown, "load_stribeck:2@v_ls=0.3", runs.train)
    assert not given.constants_at_ends
    assert not inside.constants_at_ends


@pytest.mark.parametrize(
    ("returned", "words"),
    [
        (lambda task: task.ols, "ridge returned ndarray, no Fit"),
        (lambda task: Fit(task.ols[1:], task.problem), r"theta of the shape \(25,\)"),
        (lambda task: Fit(np.nan * task.ols, task.problem), "returned nan for m1"),
    ],
)
def test_an_answer_that_is_none_is_one_sentence(theirs, returned, words):
    kind = type("Ridge", (theirs["ridge"],), {"fit": lambda self, task: returned(task)})
    with pytest.raises(InputError, match=words):
        identify("two_link", small_run(), kind())


def test_what_is_no_plugin_is_refused(theirs):
    refusal(lambda: register(ModuleType("x")), "no plug-in", "SUFFIXES")
    refusal(lambda: contracts(theirs["ridge"]), "method ridge is not registered")
    taken = type("Ridge", (theirs["ridge"],), {"name": "ols"})
    refusal(lambda: register(taken), "the same name, 'ols'")


def test_a_format_that_reads_noise_breaks_its_contract(registered):
    home = ModuleType("theirs.careless")
    home.SUFFIXES = (".careless",)
    run = small_run()
    home.read = lambda path: log_of_arrays(
        path, {"t": run.t, "q": run.q, "tau": run.tau}
    )
    register(home)
    with pytest.raises(ContractError, match="bytes of noise"):
        contracts(home)["check_format_refuses_what_is_none"]()


def test_a_model_with_their_effect_is_saved_where_it_can_be_loaded(theirs, tmp_path):
    """And names their package where it is not installed."""
    effects = ["rigid_body", theirs["rubber"](sdp.load_problem("two_link").robot, [1])]
    estimate = identify("two_link", small_run(), effects=effects)
    path = tmp_path / "model.json"
    said = "effect rubber_spring is not registered", "register(RubberSpring)"
    refusal(lambda: estimate.save(path), *said)
    assert not path.exists()


def test_their_plugins_make_a_model_that_is_loaded(registered, tmp_path, monkeypatch):
    estimator = registered["ridge"](weight=1e-4)
    estimate = identify(
        "two_link", small_run(), estimator, effects="rigid_body,rubber_spring:2"
    )
    path = tmp_path / "model.json"
    estimate.save(path)
    again = sdp.load_estimate(path)
    assert again.estimator == estimator
    np.testing.assert_array_equal(again.theta, estimate.theta)
    extended = sdp.add(again, "viscous_friction", small_run())
    assert extended.method == "ridge"
    assert sdp.export(again, tmp_path / "robot.masses") == ("rubber_spring:2@q_0=0.5",)
    solved = identify("two_link", small_run(), LmiSdp(solver="half-hearted"))
    assert solved.certificate.gap < 1e-6
    for registry in REGISTRIES:
        monkeypatch.setattr(registry, "_registered", [])
        vars(registry).pop("_all", None)
    said = "effect rubber_spring is a plug-in of theirs", "not installed"
    refusal(lambda: sdp.load_estimate(path), *said)


def test_a_class_that_is_defined_again_takes_its_own_place(registered):
    newer = type("Ridge", (registered["ridge"],), {"name": "ridge"})
    newer.__module__ = registered["ridge"].__module__
    register(newer)
    assert not plugins_named("ridge") - {newer}


def plugins_named(name):
    """All plug-ins of a name."""
    return {r.all()[name] for r in REGISTRIES if name in r.all()}


#: What a user does with the installed package, in one process.
STORY = """
import sys
import sdp_vs_penalty as sdp
from sdp_vs_penalty.cli.main import main
from sdp_vs_penalty.testing import contracts
from sdp_vs_penalty.testing.files import small_run
from sdp_vs_penalty.api.registration import REGISTRIES
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs
names = ["rubber_spring", "ridge", "half-hearted", "semicolons", ".masses"]
for registry, name in zip(REGISTRIES, names, strict=True):
    for contract in contracts(registry.all()[name]).values():
        contract()
    assert registry.provider(name) == "theirs 1.2", registry.provider(name)
hidden = hidden_runs(sdp.load_problem("two_link"), [("rubber_spring", [1])], "strong", seed=1)
bare = sdp.identify("two_link", hidden.runs[0], check=False)
assert "Rubber spring, joint 2" in str(sdp.diagnose(bare, hidden.runs[:2], check=False))
run = small_run()
rows = zip(run.t, run.q, run.tau, strict=True)
with open("run.semicolons", "w") as file:
    for t, q, tau in rows:
        print(";".join(f"{x!r}" for x in (float(t), *map(float, (*q, *tau)))), file=file)
identify = ["identify", "two_link", "--data", "run.semicolons", "--no-check"]
effects = ["--effects", "rigid_body,coulomb_friction,rubber_spring:2"]
lines = [
    [*identify, *effects, "--method", "ridge", "--out", "model.json"],
    ["add", "model.json", "viscous_friction", "--data", "run.semicolons", "--out", "more.json"],
    [*identify, *effects, "--method", "lmi-sdp", "--solver", "half-hearted", "--out", "sdp.json"],
    ["compare", "more.json", "--data", "run.semicolons"],
    ["export", "more.json", "--out", "robot.masses"],
    ["export", "sdp.json", "--out", "model.h"],
    ["list", "effects", "rubber_spring"],
    ["list", "methods", "ridge"],
    ["list", "solvers", "half-hearted"],
    ["list", "formats", "semicolons"],
    ["list", "exports", ".masses"],
    ["shootout", "--quick", "--solvers", "half-hearted,clarabel", "--problems",
     "two_link simulated one-step plain", "--out", "shootout"],
]
for line in lines:
    try:
        main(line)
    except SystemExit as end:
        assert not end.code, line
"""


@pytest.mark.long
def test_a_package_of_its_own_in_a_venv(tmp_path):
    """Built, installed beside ours, found by its entry points; without it the model says
    what it lacks."""
    pytest.importorskip("hatchling", reason="install the extra [test]")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path]
    subprocess.run(build, cwd=THEIRS, check=True, capture_output=True)
    venv.create(tmp_path / "venv", with_pip=False)
    (site,) = (tmp_path / "venv").glob("lib/python*/site-packages")
    ours = [p for p in sys.path if p.endswith("site-packages")]
    ours.append(str(Path(sdp.__file__).parents[1]))
    lines = "".join(f"import site; site.addsitedir({p!r})\n" for p in ours)
    (site / "ours.pth").write_text(lines)
    with zipfile.ZipFile(*tmp_path.glob("*.whl")) as wheel:
        wheel.extractall(site)
    python = tmp_path / "venv" / "bin" / "python"
    done = subprocess.run(
        [python, "-c", STORY], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "rubber_spring" in (tmp_path / "model.h").read_text("utf-8")
    assert plugins.installed_entry_points() is not None
    with pytest.raises(InputError, match=r"rubber_spring is a plug-in of theirs 1\.2"):
        sdp.load_estimate(tmp_path / "model.json")
