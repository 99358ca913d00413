"""What screens show is what the functions behind the verbs say; each control does what it says."""

import asyncio
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from page_sessions import Here, Screen, numbers, saved

pytest.importorskip("nicegui", reason="the page needs the extra [page]")

from sdp_vs_penalty import compare, diagnose, follow, identify, load_estimate, load_measurements
from sdp_vs_penalty.data import concatenate
from sdp_vs_penalty.diagnosis import Curve
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.estimators import estimator_types
from sdp_vs_penalty.exporters.export import formats
from sdp_vs_penalty.files import problems_folder
from sdp_vs_penalty.formatting import number
from sdp_vs_penalty.page.sessions import Sessions
from sdp_vs_penalty.reports.sections import judged_row, standard_rows

NAMES = ("a.csv", "b.csv", "test.csv")


def traces(chart: dict[str, Any]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The curves of a chart by name; those of its second panel with a dash."""
    named = ((f"{t.get('name')}{'-' * ('xaxis' in t)}", t) for t in chart["data"])
    return {name: (numbers(t["x"]), numbers(t["y"])) for name, t in named}


@pytest.fixture(scope="module")
def story(hidden, tmp_path_factory) -> Iterator[SimpleNamespace]:
    """From files to a model with what it missed, each step once; what the page said on the way."""
    folder, sessions = tmp_path_factory.mktemp("runs"), Sessions(Here())
    files = saved(folder, [hidden.runs[k] for k in (0, 1, 3)], *NAMES)
    session = sessions.new()
    screen, said = Screen(session), dict[str, Any]()

    def step(name: str, *keys: str) -> None:
        screen.click(*keys)
        assert session.notice is None
        stages = ("measure", "check", "identify", "diagnose", "use")
        said[name] = {stage: screen.text(stage) for stage in stages} | {"keys": screen.keys}

    step("empty")
    step("robot", "robot-two_link")
    session.arrived |= files
    screen.do(session.read_arrived)
    step("runs")
    step("model", "identify")
    step("found", "diagnose")
    step("added", "add-0")
    step("undone", "undo")
    step("redone", "redo")
    step("compared", "compare", "forward")
    models = [load_estimate(step.file) for step in session.history]
    runs, test = load_measurements(folder / "a.csv", folder / "b.csv"), hidden.runs[3]
    whole = concatenate([runs, test])
    judged = compare(dict(zip("ab", models, strict=True)), test, noise_from=whole)
    known = {"runs": runs, "test": test, "whole": whole, "models": models, "judged": judged}
    yield SimpleNamespace(screen=screen, session=session, said=said, **known)
    screen.loop.close()
    sessions.close()


def test_a_screen_is_there_when_what_it_needs_is(story):
    """Before, it says what comes first; what is done is one way on."""
    said, parts = story.said, ("measure", "check", "identify", "diagnose", "use")
    first = ["", *["Add measurements first."] * 2, *["Identify a model first."] * 2]
    waits = {"empty": 5, "robot": 5, "runs": 2, "model": 0}
    for step, count in waits.items():
        for k, (stage, words) in enumerate(zip(parts, first, strict=True)):
            waiting = words in said[step][stage] and bool(words)
            assert waiting == (k >= 5 - count and k > 0), (step, stage)
    ways = {
        step: [key.removeprefix("next-") for key in now["keys"] if key.startswith("next-")]
        for step, now in said.items()
    }
    assert ways["empty"] == ways["robot"] == []
    assert ways["runs"] == ["measure", "check"]
    assert ways["model"] == ["measure", "check", "identify", "diagnose"]
    assert "robot-two_link" in said["empty"]["keys"]
    assert "drop-runs" in said["robot"]["keys"]
    assert "drop-runs" not in said["empty"]["keys"]
    for one, other in (("added", "redone"), ("found", "undone")):
        assert said[one]["identify"] == said[other]["identify"]
    keys = {step: set(now["keys"]) & {"undo", "redo", "add-0"} for step, now in said.items()}
    assert keys["found"] == {"add-0"}
    assert keys["added"] == keys["redone"] == {"undo"}
    assert keys["undone"] == {"redo", "add-0"}
    assert story.session.history[-1].added == (story.session.findings.effects[0].text,)
    shown = [code for code in story.screen.scripts if code.startswith("workbench.show")]
    assert [re.findall(r'"(\w+)"', code) for code in shown] == [
        ["identify", "fit"], ["diagnose", "findings"], ["diagnose", "history"],
    ]  # fmt: skip


def test_one_grade_everywhere_and_no_stale_sentence(story):
    """After each change every stage says the same, in words and colour, of the model that is shown."""
    names = {"good": "Good", "usable": "Usable", "do not use": "Do not use"}
    grades = [names[judged.verdict.grade] for judged in story.judged]
    for step, now in story.said.items():
        current = grades[step in ("added", "redone", "compared")]
        for stage in ("measure", "check", "identify", "diagnose", "use"):
            said = re.findall(r"(?:^|[.!] ?| )(Good|Usable|Do not use) ?\. ", now[stage])
            assert set(said) <= {current}, (step, stage)
            assert "`" not in now[stage]
            if stage in ("identify", "use") and step not in ("empty", "robot", "runs"):
                assert said, (step, stage)
        assert ("Missing:" in now["diagnose"]) == (step in ("found", "undone"))
    level = {"Good": "good", "Usable": "usable"}.get(grades[1], "bad")
    for stage in ("identify", "use"):
        marks = {c for e in story.screen.under() if e.props.get("data-to") == stage for c in e.classes}
        assert marks & {"good", "usable", "bad"} == {level}, (stage, marks)


def test_what_is_measured_is_told_and_drawn(story):
    measure, check = story.said["runs"]["measure"], story.said["runs"]["check"]
    assert "two_link has 2 joints; 3 runs, part kept for testing." in measure
    assert "joint1 [N m], joint2 [N m]" in measure
    for name, run in zip(NAMES, [*story.runs.runs(), story.test], strict=True):
        rate = f"{run.samples} at {(run.samples - 1) / (run.t[-1] - run.t[0]):.4g} Hz"
        assert f"{name} {run.t[-1] - run.t[0]:.3g} s {rate} Use of {name}" in measure
        assert f"✓ {name}" in check
    uses = [story.screen.at(f"use-{k}") for k in range(3)]
    chosen = [[o.props["value"] for o in story.screen.under(u) if o.props.get("selected")] for u in uses]
    assert chosen == [["train"], ["train"], ["test"]]
    assert "Nothing wrong in 3 runs." in check
    story.screen.set("checked-run", "b.csv")
    (chart,) = story.screen.charts("check")
    own, run = chart["data"], story.runs.runs()[1]
    for k, values in enumerate((run.q, np.gradient(run.q, run.t, axis=0), run.tau)):
        for j in range(2):
            drawn = own[2 * k + j]
            assert drawn["name"] == f"joint {j + 1}"
            assert drawn["showlegend"] == (k == 0)
            x, y = numbers(drawn["x"]), numbers(drawn["y"])
            exact = run.dq if k == 1 and run.dq is not None else values
            np.testing.assert_allclose(y, np.interp(x, run.t - run.t[0], exact[:, j]), atol=2e-3)
            assert (x[0], x[-1]) == pytest.approx((0.0, run.t[-1] - run.t[0]))
    layout = chart["layout"]
    titles = [layout[f"yaxis{k}"]["title"]["text"] for k in ("", "2", "3")]
    assert titles == ["q [rad]", "dq [rad/s]", "tau [N m]"] or titles[2] == "tau [N*m]"
    assert layout["xaxis3"]["title"]["text"] == "time [s]"


def test_fit_is_that_of_the_models_and_follows_what_is_clicked(story):
    screen, session = story.screen, story.session
    before, after = story.judged
    text = story.said["compared"]["identify"]
    for j in range(2):
        ratio = [c.rmse[j] / c.noise_floor[j] for c in (before, after)]
        assert f"joint {j + 1} {ratio[0]:.3g} → {ratio[1]:.3g}" in text
    worst = int(np.argmax(after.rmse / after.noise_floor))
    first = int(np.argmax(before.rmse / before.noise_floor))
    assert f"Joint {first + 1}: the error is" in story.said["model"]["identify"]
    for j in (worst, 1 - worst):
        (bars, *_) = (e for e in screen.part("fit") if hasattr(e, "content") and "bars" in e.content)
        screen.hear(bars, "click", [str(j + 1), "q"])
        assert f"Joint {j + 1}: the error is {number(after.rmse[j])} N m" in screen.text("fit")
        torque, error = screen.charts("fit")
        assert screen.view.signal == "q"
        assert torque["layout"]["yaxis"]["title"]["text"] == f"joint {j + 1} [N m]"
        assert error["layout"]["xaxis"]["title"]["text"] == "position [rad]"
        assert error["layout"]["yaxis"]["title"]["text"].startswith(f"error of joint {j + 1} [N")
        signals, (band,) = after.signals, error["layout"]["shapes"]
        assert band["y1"] == -band["y0"] == pytest.approx(1.96 * after.noise_floor[j])
        drawn, t = traces(torque), signals.t - signals.t[0]
        labels = [step.label for step in session.history]
        modelled = dict(zip(labels, (before.signals.modelled, signals.modelled), strict=True))
        curves = {"measured": signals.measured, **modelled}
        curves |= {f"{k}-": signals.measured - x for k, x in modelled.items()}
        assert set(drawn) == set(curves)
        for name, (x, y) in drawn.items():
            np.testing.assert_allclose(y, np.interp(x, t, curves[name][:, j]), atol=3e-3)
        points = traces(error)
        for name, x in (("error of the first model", before.signals), ("error", signals)):
            keep = np.unique(np.linspace(0, len(t) - 1, 800).astype(int))
            np.testing.assert_allclose(points[name][0], x.q[keep, j], atol=1e-5)
            np.testing.assert_allclose(points[name][1], x.residual[keep, j], atol=1e-4)
        turns = np.sign(signals.dq[1:, j]) != np.sign(signals.dq[:-1, j])
        assert len(points["reversals"][0]) == turns.sum()
    (chart, _) = (e for e in screen.part("fit") if hasattr(e, "figure"))
    screen.hear(chart, "plotly_relayout", {"xaxis2.range[0]": 3, "xaxis2.range[1]": 5.0})
    assert screen.view.span == (3.0, 5.0)
    for figure, low, high in zip(screen.charts("fit"), (2.4, None), (5.6, None), strict=True):
        x = next(iter(traces(figure).values()))[0]
        assert low is None or (low < x.min() < 2.6 and 5.4 < x.max() < high)
    inside = (t >= 3.0) & (t < 5.0)
    assert len(traces(screen.charts("fit")[1])["error"][0]) <= min(800, inside.sum())
    screen.hear(chart, "plotly_relayout", {"xaxis.autorange": True})
    assert screen.view.span is None
    screen.set("signal", "t")
    x = traces(screen.charts("fit")[1])["error"][0]
    assert (x[0], x[-1]) == pytest.approx((0.0, t[-1]), rel=1e-5)
    screen.set("shown-run", "a.csv")
    x = traces(screen.charts("fit")[0])["measured"][0]
    run = story.runs.runs()[0]
    assert x[-1] == pytest.approx(run.t[-1] - run.t[0], abs=0.5)
    screen.set("shown-run", "test.csv")


def test_what_was_answered_is_of_the_model_that_was_asked(story):
    screen, session = story.screen, story.session
    made: list[str] = []
    screen.do(session.start, session.take, "run-3.csv", made.append)
    assert made == ["run-3.csv"]
    assert load_measurements(session.folder / "run-3.csv").data_hash == story.test.data_hash
    assert session.answer("methods")
    screen.click("undo")
    assert session.answer("methods") is session.answer("forward") is None
    screen.click("redo")
    assert session.answer("forward")


def test_show_me_is_the_whole_job_on_the_demos_arm(story, monkeypatch):
    """Each step in turn; what was found for sure is added."""
    (one,) = story.session.history[0].findings.effects
    found = replace(
        story.session.history[0].findings, effects=(one, replace(one, confidence="weak", text="x"))
    )
    session = Sessions(Here()).new()
    called: list[tuple[Any, ...]] = []
    for name in ("choose_robot", "simulate", "identify", "diagnose", "add"):

        async def act(*given: Any, name: str = name) -> None:
            called.append((name, *given))

        monkeypatch.setattr(session, name, act)
    session.robot = {"n": 7}
    session.history = [replace(story.session.history[0], findings=found)]
    asyncio.run(session.show_me())
    assert called == [
        ("choose_robot", "panda"), ("simulate", "presliding_hysteresis", [7], "strong", 7),
        ("identify",), ("diagnose",), ("add", [one.text]),
    ]  # fmt: skip


def scenes(screen: Screen, part: str) -> list[Any]:
    return [e for e in screen.part(part) if hasattr(e, "camera")]


@pytest.mark.parametrize(("part", "arms"), [("check", 1), ("fit", 1), ("forward", 2)])
def test_the_arm_fills_its_picture_and_moves_as_measured(story, part, arms):
    screen = story.screen
    (scene,) = scenes(screen, part)
    loads = [code for code in screen.scripts if code.startswith(f"(arms[{scene.id}]")]
    moves = json.loads(re.search(r"\.load\((.*)\)$", loads[-1])[1])
    poses, robot = np.array(moves["poses"]), story.models[-1].robot
    assert poses.shape[1:] == (arms * robot.n, 7)
    assert len(moves["groups"]) == arms * robot.n
    assert len(moves["t"]) == len(poses) == len(moves["errors"])
    camera = scene.camera
    eye, to = (np.array([getattr(camera, f"{at}{c}") for c in "xyz"]) for at in ("", "look_at_"))
    away = poses[:, : robot.n, :3].reshape(-1, 3) - eye
    depth = away @ (to - eye) / np.linalg.norm(to - eye)
    angle = np.degrees(np.arccos(depth / np.linalg.norm(away, axis=1)))
    assert 2.0 < angle.max() <= 7.0  # of the half of 14 degrees
    if part != "forward":
        run = story.test if part == "fit" else story.runs.runs()[1]
        when = np.array(moves["t"]) + run.t[0]
        q = np.column_stack([np.interp(when, run.t, x) for x in run.q.T])
        want = robot.poses(robot.tree_state(q)[0])
        np.testing.assert_allclose(poses[..., :3], want[..., :3, 3], atol=0.02)
    errors = np.array(moves["errors"])
    assert (errors.max() > 0.0) == (part == "fit")
    assert errors.max() <= 1.0
    joints = SimpleNamespace(hits=[SimpleNamespace(object_name=x) for x in ("ground", "link-1")])
    screen.view.look(joint=0)
    for handler in scene._click_handlers:
        screen.do(handler, joints)
    assert screen.view.joint == 1


def test_parameters_are_those_of_the_model(story):
    screen, model = story.screen, story.models[-1]
    assert screen.charts("parameters") == []  # a chart that nobody sees costs as much
    box = screen.at("parameters").parent_slot.parent
    for _ in range(2):
        screen.hear(box, "toggle")
    text = screen.text("parameters")
    for row in standard_rows(model):
        assert " ".join(filter(None, row[:4])) in text
    (chart,) = screen.charts("parameters")
    screen.view.look(joint=1)
    (chart,) = screen.charts("parameters")
    assert chart["layout"]["yaxis"]["title"]["text"] == "joint 2 [N m]"
    value = dict(zip((p.name for p in model.model.parameters), model.theta, strict=True))
    v, torque = traces(chart)["None"]
    friction = value["f_v2"] * v + value["f_c2"] * np.tanh(v / 0.01)
    np.testing.assert_allclose(torque - friction, (torque - friction).mean(), atol=2e-3)


def test_the_diagnosis_is_the_verbs(story):
    found = diagnose(story.models[0], story.runs, story.test, noise_from=story.whole).effects[0]
    text = story.said["found"]["diagnose"]
    assert f"Size {found.size:.4g} ± {found.std:.1g} N m; {found.constants}" in text
    assert found.explanation.partition(". ")[2] in text
    assert text.count(found.explanation.partition(". ")[2]) == 1
    before, after = found.held_out_rmse_before[0], found.held_out_rmse_after[0]
    assert f"{100.0 * (after / before - 1.0):+.0f} %" in text
    assert "Added to the model." in story.said["added"]["diagnose"]
    assert "Added to the model." not in text
    assert f"{found.effect.replace('_', ' ').capitalize()} · joint 1 confident" in text
    text = story.said["added"]["diagnose"]
    fall = [f"{c.rmse[0] / c.noise_floor[0]:.3g}" for c in story.judged]
    assert re.search(rf"Joint 1: {fall[0]} -> {fall[1]}\d* \(-\d\d %\) times the noise", text)
    assert "Diagnose again to see what is missing now." in text
    for k, (_, *cells) in enumerate(map(judged_row, story.judged), start=1):
        assert " ".join([f"{k}", story.session.history[k - 1].label, *cells]) in text
    for j, (old, new) in enumerate(zip(*(c.rmse for c in story.judged), strict=True), start=1):
        assert f"{j} [N m] {number(old)} {number(new)}" in text


def test_methods_and_the_free_run_are_the_verbs(story):
    text = story.said["compared"]["identify"]
    for method in ("lmi-sdp", "ols"):
        own = identify("two_link", story.runs, method, effects=story.models[-1].model.effects)
        (judged,) = compare({method: own}, story.test, noise_from=story.whole)
        assert " ".join(judged_row(judged)[:-1]) in text
    ahead = follow(story.models[-1], story.test)
    text = story.said["compared"]["use"]
    assert ahead.verdict in text
    for row in ahead.table()[1]:
        assert " ".join(row) in text
    story.screen.set("forward-joint", "1")
    drawn = traces(story.screen.charts("forward")[0])
    free = ahead.free[0]
    for name, q in (("measured", free.measured), ("simulated", free.simulated.q)):
        x, y = drawn[name]
        t = free.simulated.t - free.simulated.t[0]
        np.testing.assert_allclose(y, np.interp(x, t, q[:, 1]), atol=2e-3)


def recorded(screen: Screen, monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """What the session of a screen is told to start, and does not."""
    called: list[tuple[Any, ...]] = []
    told = lambda do, *given, **on: called.append((do.__name__, *given, on))  # noqa: E731
    monkeypatch.setattr(screen.session, "start", told)
    (bench,) = screen.session.watchers
    bench._drawn.clear()
    screen.do(bench.redraw)
    return called


def test_everything_is_offered_and_every_control_does_what_it_says(story, monkeypatch):
    screen, session, view = story.screen, story.session, story.screen.view
    keys = set(story.said["compared"]["keys"])
    searched = {name for name, kind in effect_types().items() if not kind.frozen_only}
    offered = {key.removeprefix("effect-") for key in keys if key.startswith("effect-")}
    assert offered == searched
    methods = {name for name, kind in estimator_types().items() if not kind.needs_black_box}
    assert {key[7:] for key in keys if key.startswith("method-")} == methods
    takes = {key.removeprefix("take-") for key in keys if key.startswith("take-")}
    files = {home.FILE for home in formats().values() if not home.ABOUT.startswith("payload")}
    files |= {"model.json", "report.html", "findings.json", *(f"run-{k}.csv" for k in (1, 2, 3))}
    assert takes == files
    assert " ".join(session.commands()) in story.said["compared"]["use"]
    called = recorded(screen, monkeypatch)
    fields = {
        "hide-effect": "joint_spring", "hide-joint": "2", "hide-level": "weak", "hide-seed": "9",
        "folds": True, "method-ols": False, "drive": "pd", "add-text": "payload",
    }  # fmt: skip
    for key, value in fields.items():
        screen.set(key, value)
    screen.click("simulate", "identify", "compare", "diagnose", "add-by-hand", "forward")
    screen.click("take-robot.xml")
    asked = {"methods": ["lmi-sdp", "penalty"], "folds": True}
    assert called == [
        ("simulate", "joint_spring", [2], "weak", 9, {}),
        ("identify", {}),
        ("ask", "Comparing methods", "methods", asked),
        ("diagnose", {}),
        ("add", ["payload"], {}),
        ("ask", "Running the model forward", "forward", {"drive": "pd"}),
        ("take", "robot.xml", view.download, {"flange": ""}, {}),
    ]
    called.clear()
    screen.set("hide-effect", "global_delay")
    screen.click("simulate")
    screen.set("gravity", "0,0,9.81")
    assert called == [("simulate", "global_delay", [], "weak", 9, {}), ("mount", "0,0,9.81", {})]
    for key, value, name, kept in (
        ("frozen", True, "frozen", True), ("frozen", False, "frozen", False),
        ("method", "penalty", "method", "penalty"), ("seed", "-3", "seed", 0), ("seed", "x", "seed", 0),
        ("option-window", " 0:8 ", "options", {"window": "0:8"}), ("option-window", " ", "options", {}),
        ("option-motor_side", True, "reading", {"motor_side": "yes"}),
        ("option-motor_side", False, "reading", {}),
        ("effects-text", "rigid_body, viscous_friction:2,", "effects", [*"rv"]),
        ("effect-rotor_inertia", True, "effects", [*"rrv"]),
        ("effect-coulomb_friction", True, "effects", [*"rcrv"]),
        ("effect-viscous_friction", False, "effects", [*"rcr"]),
    ):  # fmt: skip
        screen.set(key, value)
        now = getattr(session, name)
        assert ([text[0] for text in now] if name == "effects" else now) == kept, key
    boxes = [e.props for e in screen.under() if e.props.get("data-key", "").startswith("effect-")]
    assert {b["data-key"][7:] for b in boxes if b.get("checked")} == set(session.effects)


def test_findings_of_every_kind_are_told(story, monkeypatch):
    """Rivals and the run that would tell, weak ones, curves, what the check finds; a payload's files."""
    screen, session = story.screen, story.session
    steps, runs = list(session.history), list(session.runs)
    found = steps[0].findings
    (one,) = found.effects
    weak = {"indistinguishable_from": ("torque_ripple",), "confidence": "weak", "remarks": ("small",)}
    rival = replace(one, text="presliding_hysteresis:1@d=0.1", **weak)
    sure = replace(one, effect="joint_spring", text="joint_spring:2", joints=(2,))
    x = np.linspace(-1.0, 1.0, 9)
    curve = Curve(2, ("q2",), x, x**2, x**2 - 0.1, x**2 + 0.1, 0.9, None, 0.2, 0.1)
    every = replace(found, effects=(sure, one, rival), curves=(curve,), noise_source="residual")
    session.history[:] = [replace(steps[0], findings=every, curve_texts=["measured_curve:2"])]
    problem = {"kind": "gravity", "what": "it is turned", "remedy": "turn it", "severity": "warning",
               "can_fix": True, "gravity": [0.0, 0.0, 9.81]}  # fmt: skip
    session.runs = [{**runs[0], "findings": [problem]}, *runs[1:]]
    screen.do(session.changed)
    text = screen.text("diagnose")
    assert "Indistinguishable in these data from: torque_ripple." in text
    assert rival.telling_run("model.json", 3) in text
    assert "Weak: small." in text
    assert curve.sentence(["N*m", "N*m"]) in text
    assert "joint by joint: not known" in text
    assert text.count("Add ") >= 1
    check = screen.text("check")
    assert "a.csv: gravity. It is turned What to do: turn it." in check
    assert "It found gravity." in check
    assert "✓ a.csv" not in check
    assert "Crosses:" in check
    called, first = recorded(screen, monkeypatch), session.runs[0]["file"]
    styles = [screen.at(key).classes for key in ("add-0", "add-1")]
    assert ["primary" in style for style in styles] == [True, False]
    screen.click("add-2", "add-curve-0", "add-all", f"apply-{first}", f"mend-{first}")
    screen.set("use-1", "test")
    assert called == [
        ("add", [rival.text], {}), ("add", ["measured_curve:2"], {}),
        ("add", ["joint_spring:2", one.text], {}), ("mount", "0,0,9.81", {}), ("mend", first, {}),
    ]  # fmt: skip
    assert session.runs[1]["use"] == "test"
    assert session.history == []


def test_the_folder_is_offered_and_kept_as_it_is(tmp_path: Path):
    """Its runs, robots and problems, and nothing from outside it."""
    folder = tmp_path / "mine"
    for name in ("arm.urdf", "run.csv", "notes.txt", "problem/problem.toml"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "problem.toml").write_text("")
    (folder / "other").symlink_to(tmp_path / "elsewhere")
    (folder / "elsewhere.csv").symlink_to("/etc/hosts")
    before = {p: p.lstat().st_mtime_ns for p in folder.iterdir()}
    sessions = Sessions(Here())
    screen = Screen(sessions.new(), folder)
    robots = {key.removeprefix("robot-") for key in screen.keys if key.startswith("robot-")}
    built_in = {path.parent.name for path in problems_folder().glob("*/problem.toml")}
    assert robots == {*built_in, "arm.urdf", "problem"}
    assert [p.name for p in Screen(sessions.new(), folder / "problem").view.folder_problems()] == [
        "problem"
    ]
    screen.click("robot-two_link")
    assert [key for key in screen.keys if key.startswith("folder-")] == ["folder-0"]
    screen.set("folder-0", True)
    screen.click("read-folder")
    assert screen.session.notice.error
    assert "run.csv" in " ".join(screen.session.notice.texts)
    screen.click("close-notice")
    assert screen.session.notice is None
    assert before == {p: p.lstat().st_mtime_ns for p in folder.iterdir()}
    sessions.close()
