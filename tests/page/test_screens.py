"""What screens show is what the functions behind the verbs say; each control does what
it says."""

import ast
import asyncio
import json
import re
from dataclasses import replace
from itertools import starmap
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from page_sessions import Here, Screen, numbers, saved

pytest.importorskip("nicegui", reason="the page needs the extra [page]")

import sdp_vs_penalty
from sdp_vs_penalty import compare, find_ranges, load_estimate, load_measurements
from sdp_vs_penalty.checks.certainty import likely
from sdp_vs_penalty.checks.issue import Issue
from sdp_vs_penalty.diagnosis import Curve, Retune
from sdp_vs_penalty.diagnosis.diagnosis_data import ErrorWith
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.diagnosis.where_it_fails import UNNAMED
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.written import WrittenEffect
from sdp_vs_penalty.estimation import ShapeEstimate
from sdp_vs_penalty.estimation.verdict import grades_in_words
from sdp_vs_penalty.estimators import estimator_types
from sdp_vs_penalty.exporters import EXPORTS
from sdp_vs_penalty.files import problems_folder
from sdp_vs_penalty.formatting import number, sentence
from sdp_vs_penalty.page import Sessions, jobs, models
from sdp_vs_penalty.page.next_step import next_step
from sdp_vs_penalty.page.spoken import spoken
from sdp_vs_penalty.page.stages import measure
from sdp_vs_penalty.page.view import identified
from sdp_vs_penalty.render.words import BADGES, describe_finding
from sdp_vs_penalty.reports.demo import RUNS, SEED
from sdp_vs_penalty.results import Change

RECORDED = Path(__file__).parents[1] / "data"
NAMES = ("a.csv", "b.csv", "test.csv")
#: Of each run and of the test [s], along which the model is simulated: nothing needs more.
SECONDS = (8.0, 8.0, 4.0)
#: What a person sets to look at something else.
ANOTHER = {"cause": "time", "checked-run": "b.csv", "shown-run": "a.csv"}


def traces(chart):
    """The curves of a chart by name; those of its second panel with a dash."""
    named = ((f"{t.get('name')}{'-' * ('xaxis' in t)}", t) for t in chart["data"])
    return {name: (numbers(t["x"]), numbers(t["y"])) for name, t in named}


@pytest.fixture(scope="module")
def story(request, hidden, tmp_path_factory):
    """From files to a model with what it missed, each step once; what the page said on
    the way."""
    # Only the snapshot of figures looks at all that is drawn after each step.
    folder = tmp_path_factory.mktemp("runs")
    sessions = Sessions(Here())
    # As its file has it: a recording of its own.
    *train, test = (
        replace(hidden.runs[k].window(0.0, end))
        for k, end in zip((0, 1, 3), SECONDS, strict=True)
    )
    files = saved(folder, [*train, test], *NAMES)
    session = sessions.new()
    screen = Screen(session)
    said = {}

    def step(name, *keys):
        screen.click(*keys)
        assert session.notice is None
        stages = ("next", "measure", "check", "identify", "diagnose", "use")
        said[name] = {stage: screen.text(stage) for stage in stages} | {
            "keys": screen.keys
        }

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
    step("compared", "compare", "forward", "ranges")
    screen.hear(screen.at("parameters").parent_slot.parent, "toggle")
    for key, value in ANOTHER.items():
        screen.set(key, value)
    (bars, *_) = (e for e in screen.part("fit") if "bars" in getattr(e, "content", ""))
    screen.hear(bars, "click", ["2", None])
    (chart, _) = (e for e in screen.part("fit") if hasattr(e, "figure"))
    screen.hear(
        chart, "plotly_relayout", {"xaxis2.range[0]": 3, "xaxis2.range[1]": 5.0}
    )
    screen.hear(chart, "plotly_relayout", {"xaxis.autorange": True})
    screen.set("shown-run", "test.csv")
    models = [load_estimate(step.file) for step in session.history]
    runs = load_measurements(folder / "a.csv", folder / "b.csv")
    judged = compare(dict(zip("ab", models, strict=True)), test)
    known = {"runs": runs, "test": test, "models": models, "judged": judged}
    yield SimpleNamespace(screen=screen, session=session, said=said, **known)
    screen.loop.close()
    sessions.close()


def test_errors_are_drawn_under_diagnose_before_there_is_a_diagnosis(story):
    """They stand there while it works."""
    now = story.said["model"]["diagnose"]
    joint = story.judged[0].worst_joint
    assert "Error of each joint" in now
    assert f"Error of joint {joint} against" in now


def test_one_grade_everywhere_and_no_stale_sentence(story):
    """After each change every stage says the same, in words and colour, of the model
    that is shown."""
    names = {"good": "Good", "usable": "Usable", "do not use": "Do not use"}
    grades = [names[judged.verdict.grade] for judged in story.judged]
    for step, now in story.said.items():
        current = grades[step in ("added", "redone", "compared")]
        for stage in ("measure", "check", "identify", "diagnose", "use"):
            in_view = f"{now['next']} {now[stage]}"
            said = re.findall(r"(?:^|[.!] ?| )(Good|Usable|Do not use) ?\. ", in_view)
            assert set(said) <= {current}, (step, stage)
            assert "`" not in now[stage]
            if stage in ("identify", "use") and step not in ("empty", "robot", "runs"):
                assert said, (step, stage)
        assert "Missing:" not in now["diagnose"]  # the cause stands in view
    assert story.session.current.verdict.grade == "good"
    # A URDF does not hold what was added: it says so itself, and the mark is the model's.
    assert "What it cannot hold" in story.said["added"]["use"]
    assert "none of it." in story.said["found"]["diagnose"]
    for stage, level in {"identify": "good", "use": "good"}.items():
        marks = {
            c
            for e in story.screen.under()
            if e.props.get("data-to") == stage
            for c in e.classes
        }
        assert marks & {"good", "usable", "bad"} == {level}, (stage, marks)


def test_one_next_step_after_each_change(story):
    """A model that was not diagnosed is diagnosed next; then it is extended or used."""
    begin = "Diagnose: what is missing?"
    add, again = " Add ", "Diagnose again"
    use = "Download the report"
    after = use if "Good." in story.said["added"]["next"] else again
    steps = {"model": begin, "found": add, "added": after, "undone": add}
    steps |= {"redone": after, "compared": after}
    labels = {begin, add, again, use}
    for step, label in steps.items():
        shown = story.said[step]["next"]
        assert {x for x in labels if x in shown} == {label}, step
        assert story.said[step]["diagnose"].count(again) <= 1  # the button


@pytest.mark.parametrize(
    ("grade", "is_diagnosed", "servo", "label"),
    [
        ("good", False, False, "Diagnose: what is missing?"),
        ("usable", False, False, "Diagnose: what is missing?"),
        ("good", True, False, "Download the report"),
        ("good", False, True, "Download the report"),
    ],
)
def test_a_model_is_diagnosed_before_it_is_used(
    story, monkeypatch, grade, is_diagnosed, servo, label
):
    """Also a good one; one of a log without torque cannot be."""
    first = story.session.history[0]
    nothing = replace(first.findings, effects=(), retuned=(), curves=())
    verdict = json.loads(json.dumps(first.comparison["verdict"]))
    verdict["lines"][0]["grade"] = grade
    comparison = {**first.comparison, "verdict": verdict}
    findings = nothing if is_diagnosed else None
    step = replace(first, findings=findings, comparison=comparison, servo=servo)
    monkeypatch.setattr(story.session, "history", [step])
    shown = next_step(story.screen.view)
    assert shown.label == label
    assert shown.text.startswith(f"{grade.capitalize()}. ")


@pytest.mark.parametrize(
    ("reached", "is_diagnosed", "label"),
    [
        ([2.0, 0.1], False, "Find a load, or what else has changed, in test.csv"),
        ([0.1, 0.1], False, "Diagnose: what is missing?"),
        (None, False, "Diagnose: what is missing?"),
        ([2.0, 0.1], True, "Add "),
    ],
)
def test_a_changed_arm_errs_in_known_motion_and_the_newest_diagnosis_decides(
    story, monkeypatch, reached, is_diagnosed, label
):
    """Where a test reaches what no training run does, a missing effect may show."""
    first = story.session.history[0]
    errors = {"a.csv": [0.1, 0.1], "test.csv": [2.0, 0.1]}
    in_reach = {} if reached is None else {"test.csv": reached}
    known = {"errors_of_runs": errors, "errors_in_reach": in_reach}
    step = replace(first, findings=first.findings if is_diagnosed else None, **known)
    assert step.differing_tests == {"test.csv": 0}
    monkeypatch.setattr(story.session, "history", [step])
    assert next_step(story.screen.view).label.startswith(label)


def test_a_test_is_compared_with_training_in_the_motion_of_both():
    """The second joint turns further in the test, and errs there."""
    q = np.linspace([-1.0, -1.0], [1.0, 1.0], 100)
    training = {"q": q, "dq": np.zeros((100, 2))}
    test = {"t": np.arange(100.0), "q": q * [1.0, 4.0], "dq": np.zeros((100, 2))}
    error = np.where(abs(test["q"]) > 1.0, 5.0, 0.5)
    test |= {"torque": error, "modelled": np.zeros((100, 2))}
    within = jobs._errors_in_reach(test, [training, training])
    np.testing.assert_allclose(within, [0.5, 0.5])
    far = test | {"q": np.add(q, [0.0, 3.0])}
    assert jobs._errors_in_reach(far, [training]) is None


def test_no_motion_is_made_for_a_joint_that_does_not_err_most(story, monkeypatch):
    """A motion of the other joint decides nothing of the verdict."""
    first = story.session.history[0]
    finding, *_ = first.findings.effects
    poor = {"doubts": (Doubt("small"),), "helps": False}
    worst = first.worst_joint
    for joint in (worst, 3 - worst):
        text = f"power_friction:{joint}"
        weak = replace(finding, joints=(joint,), text=text, **poor)
        found = replace(first.findings, effects=(weak,), retuned=(), curves=())
        monkeypatch.setattr(story.session, "history", [replace(first, findings=found)])
        label = next_step(story.screen.view).label
        assert label.startswith("Make a motion")
        assert ("shows whether it is" in label) == (joint == worst)


@pytest.mark.parametrize("n_runs", [1, 2])
def test_a_model_of_which_nothing_is_found_keeps_its_reason(story, monkeypatch, n_runs):
    """Where the noise is unknown, the diagnosis names no error."""
    session = story.session
    first = session.history[0]
    nothing = replace(first.findings, effects=(), retuned=(), curves=())
    nothing = replace(nothing, noise_source="residual", unexplained=np.zeros(2))
    verdict = json.loads(json.dumps(first.comparison["verdict"]))
    verdict["lines"][0]["grade"] = "do not use"
    comparison = {**first.comparison, "verdict": verdict}
    step = replace(first, findings=nothing, comparison=comparison)
    monkeypatch.setattr(session, "history", [step])
    monkeypatch.setattr(session, "runs", session.runs[:n_runs])
    step = next_step(story.screen.view)
    assert "no effect of the library explains it" in step.text
    assert "Nothing was found" in step.more
    error, *noise = identified(session).text.rstrip(".").split("; the noise")
    assert error in step.number
    assert all(text in step.more for text in noise)


@pytest.mark.parametrize(
    ("doubt", "badge", "open_part"),
    [
        ("rivals", "near-tie", "; something else would explain it as well."),
        ("uncertain", "size uncertain", "; how much is open."),
        ("", "confident", " has turned round."),
    ],
)
def test_the_next_step_is_as_sure_of_a_finding_as_its_card(
    story, monkeypatch, doubt, badge, open_part
):
    """In plain words. Also where what fits as well is a law of the same effect."""
    first = story.session.history[0]
    finding, *_ = first.findings.effects
    doubts = {"doubts": (Doubt(doubt),)} if doubt else {}
    finding = replace(finding, **doubts)
    found = replace(first.findings, effects=(finding,), retuned=())
    monkeypatch.setattr(story.session, "history", [replace(first, findings=found)])
    assert describe_finding(finding, found).badge == badge
    assert next_step(story.screen.view).text.endswith(open_part)


def test_without_a_noise_a_chip_names_its_measure(story):
    """That of the verdict: the joint that errs most."""
    judged = replace(story.judged[0], noise_floor=None)
    error = f"{number(judged.error_beyond_noise.max())} % of its torque"
    assert jobs._error_of(judged)["error"] == error


def test_what_is_open_of_the_model_is_said_once(story, monkeypatch):
    """Also where several diagnoses found it, each with other constants."""
    screen, session = story.screen, story.session
    first, last = session.history[0], session.history[-1]
    finding, *_ = first.findings.effects
    weak = replace(finding, doubts=(Doubt("uncertain"),))
    found = replace(first.findings, effects=(weak,))
    again = replace(found, effects=(replace(weak, size=2.0 * weak.size),))
    empty = replace(found, effects=())
    history = [replace(first, findings=x) for x in (found, again)]
    history.append(replace(last, findings=empty))
    monkeypatch.setattr(session, "history", history)
    screen.do(session.changed)
    said = screen.text("diagnose")
    tells = [key for key in screen.keys if key.startswith("tell-before-")]
    monkeypatch.undo()
    screen.do(session.changed)
    assert "In the model, and not decided: 1 effect" in said
    assert len(tells) == 1


def test_the_cause_that_is_chosen_is_the_one_that_is_drawn(story, monkeypatch):
    """Also where the error of a joint depends on none: it is drawn over time."""
    screen, session = story.screen, story.session
    monkeypatch.setattr(models, "shown_cause", lambda *_: UNNAMED)
    for cause, axis in ((session.cause_of(2), "time [s]"), ("load", "load: size of")):
        screen.view.select_joint(2, cause)
        (*_, against) = screen.charts("fit")
        shown = screen.at("cause")
        options = [e.props["value"] for e in screen.under(shown)[1:]]
        assert shown.props["value"] == cause
        assert cause in options
        assert axis in against["layout"]["xaxis"]["title"]["text"]


def test_fit_is_that_of_the_models(story):
    """Of the joint that was clicked: torques, errors against what was asked, the
    noise's band."""
    screen, (before, after) = story.screen, story.judged
    screen.view.select(cause="position")
    torque, error = screen.charts("fit")
    assert f"(test.csv): {number(after.rmse[1])} N m" in screen.text("fit")
    signals, (band,) = after.signals, error["layout"]["shapes"]
    assert (
        band["y1"]
        == -band["y0"]
        == pytest.approx(1.96 * after.noise_floor[1], rel=1e-4)
    )
    t = signals.t - story.test.t[0]  # pictures begin where the run does
    labels = [step.label for step in story.session.history]
    modelled = dict(
        zip(labels, (before.signals.modelled, signals.modelled), strict=True)
    )
    curves = {"measured": signals.measured, **modelled}
    curves |= {f"{k}-": signals.measured - x for k, x in modelled.items()}
    drawn = traces(torque)
    dots = [x for x in error["data"] if x["mode"] == "markers"]
    assert set(drawn) == set(curves)
    for name, (x, y) in drawn.items():
        np.testing.assert_allclose(y, np.interp(x, t, curves[name][:, 1]), atol=3e-3)
    for shown, x in zip(dots, (before.signals, signals), strict=True):
        keep = np.unique(np.linspace(0, len(t) - 1, 400).astype(int))
        np.testing.assert_allclose(numbers(shown["x"]), x.q[keep, 1], atol=1e-5)
        np.testing.assert_allclose(numbers(shown["y"]), x.residual[keep, 1], atol=1e-4)


def test_between_which_values_the_masses_lie(story):
    """As `ranges` says of the training runs."""
    model = story.models[-1]
    found = find_ranges(model, story.runs)
    answer = story.session.answer("ranges")
    assert answer["table"] == found.table().to_dict()
    shown = story.said["compared"]["identify"]
    assert all(note in shown for note in found.notes())
    assert found["m1"].greatest.reason in shown


def test_what_was_answered_is_of_the_model_that_was_asked(story):
    screen = story.screen
    session = story.session
    made = []
    screen.do(session.download, "run-3.csv", made.append)
    assert made == ["run-3.csv"]
    assert (
        load_measurements(session.folder / "run-3.csv").data_hash
        == story.test.data_hash
    )
    assert session.answer("methods")
    screen.click("undo")
    assert session.answer("methods") is session.answer("forward") is None
    screen.click("redo")
    assert session.answer("forward")


def test_show_me_is_the_whole_job_on_the_demos_arm(story, monkeypatch):
    """Each step in turn; what was found for sure is added."""
    (one,) = story.session.history[0].findings.effects
    doubt = (Doubt("small"),)
    weak = replace(one, text="x", doubts=doubt, helps=False)
    found = replace(story.session.history[0].findings, effects=(one, weak))
    session = Sessions(Here()).new()
    called = []
    for name in ("choose_robot", "simulate", "identify", "diagnose", "apply"):

        async def act(*given, name=name):
            called.append((name, *given))

        monkeypatch.setattr(session, name, act)
    session.robot = {"n": 7}
    session.history = [replace(story.session.history[0], findings=found)]
    asyncio.run(session.show_me())
    assert called == [
        ("choose_robot", "panda"),
        ("simulate", "presliding_hysteresis", [7], "strong", 7, RUNS),
        ("identify",),
        ("diagnose",),
        ("apply", found.remedies[0].change.to_dict()),
    ]
    assert called[-1][1]["arguments"]["effects"] == [one.text]


@pytest.mark.parametrize("part", ["check", "fit"])
def test_the_arm_fills_its_picture_and_moves_as_measured(story, part):
    screen = story.screen
    (scene,) = (e for e in screen.part(part) if hasattr(e, "camera"))
    loads = [code for code in screen.scripts if code.startswith(f"(arms[{scene.id}]")]
    moves = json.loads(re.search(r"\.load\((.*)\)$", loads[-1])[1])
    poses = np.array(moves["poses"])
    robot = story.models[-1].robot
    camera = scene.camera
    eye = np.array([getattr(camera, f"{''}{c}") for c in "xyz"])
    to = np.array([getattr(camera, f"{'look_at_'}{c}") for c in "xyz"])
    away = poses[:, : robot.n, :3].reshape(-1, 3) - eye
    depth = away @ (to - eye) / np.linalg.norm(to - eye)
    angle = np.degrees(np.arccos(depth / np.linalg.norm(away, axis=1)))
    assert 2.0 < angle.max() <= 7.0  # of the half of 14 degrees
    run = story.test if part == "fit" else story.runs.runs()[1]
    when = np.array(moves["t"]) + run.t[0]
    q = np.column_stack([np.interp(when, run.t, x) for x in run.q.T])
    want = robot.poses(robot.tree_state(q)[0])
    np.testing.assert_allclose(poses[..., :3], want[..., :3, 3], atol=0.02)
    joints = SimpleNamespace(
        hits=[SimpleNamespace(object_name=x) for x in ("ground", "link-1")]
    )
    screen.view.select(joint=0)
    for handler in scene._click_handlers:
        screen.do(handler, joints)
    assert screen.view.joint == 1


def recorded(screen, monkeypatch):
    """What the session of a screen is told to start, and does not."""
    called = []
    told = lambda do, *given, **on: called.append((do.__name__, *given, on))  # noqa: E731
    monkeypatch.setattr(screen.session, "start", told)
    (bench,) = screen.session.watchers
    bench._drawn_states.clear()
    screen.do(bench.redraw)
    return called


def test_everything_is_offered_and_every_control_does_what_it_says(story, monkeypatch):
    screen = story.screen
    session = story.session
    view = story.screen.view
    keys = set(story.said["compared"]["keys"])
    searched = {name for name, kind in effect_types().items() if not kind.frozen_only}
    offered = {key.removeprefix("effect-") for key in keys if key.startswith("effect-")}
    assert offered == searched
    methods = {
        name for name, kind in estimator_types().items() if not kind.needs_black_box
    }
    assert {key[7:] for key in keys if key.startswith("method-")} == methods
    takes = {key.removeprefix("take-") for key in keys if key.startswith("take-")}
    files = {
        home.FILE
        for home in EXPORTS.all().values()
        if not home.ABOUT.startswith("payload")
    }
    files |= {
        "model.json",
        "report.html",
        "findings.json",
        *(f"run-{k}.csv" for k in (1, 2, 3)),
    }
    assert takes == files
    assert "simulate" not in keys
    assert " ".join(session.commands()) in story.said["compared"]["use"]
    monkeypatch.setattr(session, "hidden", "none")  # a log is not replaced so
    screen.do(session.changed)
    called = recorded(screen, monkeypatch)
    fields = {
        "hide-effect": "joint_spring",
        "hide-joint": "2",
        "hide-level": "weak",
        "method-ols": False,
        "add-effect": "joint_spring",
        "add-joint": "2",
    }
    for key, value in fields.items():
        screen.set(key, value)
    screen.click(
        "simulate",
        "identify",
        "identify-all",
        "compare",
        "diagnose",
        "diagnose-frozen",
        "add-by-hand",
        "forward",
    )
    screen.click("take-robot.xml")
    taken, request, ready, _ = called.pop()
    assert (taken, request["name"], ready) == ("_take_file", "robot.xml", view.download)
    assert request["flange"] == ""
    asked = {"methods": ["lmi-sdp", "penalty"]}
    assert called == [
        ("simulate", "joint_spring", [2], "weak", SEED, {}),
        ("identify", {}),
        ("identify_from", [run["name"] for run in session.runs], {}),
        ("ask", "Comparing methods", "methods", asked),
        ("diagnose", {}),
        ("find_change", {}),
        ("add", "joint_spring:2", {}),
        ("ask", "Running the model forward", "forward", {"drive": "torque"}),
    ]
    called.clear()
    screen.set("hide-effect", "global_delay")
    screen.click("simulate")
    screen.set("gravity", "0,0,9.81")
    assert called == [
        ("simulate", "global_delay", [], "weak", SEED, {}),
        ("mount", "0,0,9.81", {}),
    ]
    for key, value, name, kept in (
        ("method", "penalty", "method", "penalty"),
        ("option-window", " 0:8 ", "options", {"window": "0:8"}),
        ("option-window", " ", "options", {}),
        ("option-motor_side", True, "reading", {"motor_side": "yes"}),
        ("option-motor_side", False, "reading", {}),
        ("effect-rotor_inertia", True, "effects", [*"rcrtv"]),
        ("effect-viscous_friction", False, "effects", [*"rcrt"]),
    ):
        screen.set(key, value)
        now = getattr(session, name)
        assert ([text[0] for text in now] if name == "effects" else now) == kept, key
    boxes = [
        e.props
        for e in screen.under()
        if e.props.get("data-key", "").startswith("effect-")
    ]
    assert {b["data-key"][7:] for b in boxes if b.get("checked")} == set(
        session.effects
    )


def show_every_kind(story):
    """Show rivals and the run that would tell, a weak finding, a curve, a constant, and
    what the check finds."""
    screen = story.screen
    session = story.session
    steps = list(session.history)
    runs = list(session.runs)
    found = steps[0].findings
    (one,) = found.effects
    weak = {
        "rivals": (WrittenEffect("torque_ripple"),),
        "doubts": (Doubt("small"),),
        "helps": False,
    }
    rival = replace(one, text="presliding_hysteresis:1@d=0.1", **weak)
    sure = replace(one, effect="joint_spring", text="joint_spring:2", joints=(2,))
    x = np.linspace(-1.0, 1.0, 9)
    curve = Curve(2, ("q2",), x, x**2, x**2 - 0.1, x**2 + 0.1, 0.9, None, 0.2, 0.1)
    other = ShapeEstimate("coulomb_friction", 1, "v_s", 0.01, 0.03)
    errors = {"rmse_before": 0.2, "rmse_after": 0.1}
    width = Retune(**vars(other), **errors, explanation="another width")
    own = {"retuned": (width,)}
    own |= {"curves": (curve,), "noise_source": "residual"}
    texts = (width.text, sure.text, one.text)
    _, alone = found.errors_of(one)
    errors_with = {texts: 0.5 * found.held_out_rmse_before}
    errors_with |= {(sure.text,): alone, (one.text,): alone, (rival.text,): alone}
    own |= {"errors_with": tuple(starmap(ErrorWith, errors_with.items()))}
    every = replace(found, effects=(sure, one, rival), **own)
    session.history[:] = [
        replace(steps[0], findings=every, curve_texts=["measured_curve:2"])
    ]
    issue = Issue(
        kind="gravity",
        severity="warning",
        where="the base",
        what="it is turned",
        certainty=likely("by the torques"),
        remedy="identify with --motors q1,q1+q2, or turn it",
        gravity=(0.0, 0.0, 9.81),
        apply="sign:tau2",
        nature="explanation",
        changes=(
            Change("read", "read tau by its gains", {"scale": {"tau": None}}),
            Change("record", "record more"),
        ),
    )
    session.runs = [{**runs[0], "findings": [issue]}, *runs[1:]]
    screen.do(session.changed)
    return SimpleNamespace(
        rival=rival, first=one, curve=curve, width=width, found=every, issue=issue
    )


def needs_a_terminal(text):
    """Words of a text that only a terminal takes."""
    words = r"`[^`]*`|sdp-vs-penalty [a-z]\S*|(?<![\w-])--[a-z]\S*"
    verbs = r"\b(?:run|with|pass) (?:compare|convert|excite|export|check-urdf)\b"
    return re.findall(f"{words}|{verbs}", text)


def test_no_text_outside_the_panel_needs_a_terminal(story):
    """Of every stage after every step, and of every kind of issue and finding."""
    session = story.session
    history, runs = list(session.history), list(session.runs)
    for step, said in story.said.items():
        for stage, text in said.items():
            if stage == "use":
                text = text.partition("The same on the command line")[0]
            if stage != "keys":
                assert not needs_a_terminal(text), (step, stage)
    assert needs_a_terminal(story.said["compared"]["use"])  # of the panel
    show_every_kind(story)
    for stage in ("next", "measure", "check", "identify", "diagnose"):
        assert not needs_a_terminal(story.screen.text(stage)), stage
    session.history[:], session.runs = history, runs
    story.screen.do(session.changed)


def sentences_of(folder):
    """What a user is told to do: of every refusal and issue that a folder's code makes,
    with X in the places of values."""
    for file in sorted(Path(sdp_vs_penalty.__path__[0], folder).rglob("*.py")):
        tree = ast.parse(file.read_text("utf-8"))
        for call in ast.walk(tree):
            if not isinstance(call, ast.Call):
                continue
            name = getattr(call.func, "id", getattr(call.func, "attr", ""))
            told = [x.value for x in call.keywords if x.arg in ("what", "remedy")]
            for text in [*told, *(call.args if name.endswith("Error") else ())]:
                parts = getattr(text, "values", [text])
                yield "".join(str(getattr(x, "value", "X")) for x in parts)


@pytest.mark.parametrize("folder", ["data", "checks", "race", "robot"])
def test_no_refusal_or_remedy_needs_a_terminal(folder):
    """Of every one that the code has, also of those that no test comes to."""
    told = [*sentences_of(folder)]
    assert len(told) > 10
    shown = [spoken(f"file.csv: {text}.") for text in told]
    assert not [text for text in shown if needs_a_terminal(text)]


@pytest.mark.parametrize("is_another_arm", [False, True])
@pytest.mark.parametrize("severity", ["error", "warning"])
@pytest.mark.parametrize("n_runs", [1, 2])
def test_every_issue_without_a_remedy_has_a_button(
    story, monkeypatch, is_another_arm, severity, n_runs
):
    """It leaves its run out, sets it aside, or brings other runs."""
    session = story.session
    words = {"kind": "k", "where": "", "what": "bad", "remedy": "log it"}
    issue = Issue(severity=severity, is_another_arm=is_another_arm, **words)
    runs = [
        {**run, "findings": [issue] if k < n_runs else [], "use": "train"}
        for k, run in enumerate(session.runs[:2])
    ]
    monkeypatch.setattr(session, "runs", runs)
    (bench,) = session.watchers
    story.screen.do(bench.redraw)
    buttons = re.compile(r"(out|more|aside|find)-0")
    assert any(map(buttons.match, story.screen.keys))
    assert "log it" in story.screen.text("check").lower()


REFUSED = json.loads((RECORDED / "refusals.json").read_text("utf-8"))["csv"]
_ROWS = [f"0.0{k}," + ("nan,0" if k % 2 else "0,nan") + ",1,2" for k in range(9)]
REFUSED["no whole row"] = ["\n".join(["t,q1,q2,tau1,tau2", *_ROWS]) + "\n"]


@pytest.mark.parametrize("name", REFUSED)
def test_every_refused_file_has_a_button(name, tmp_path, two_link_page):
    """It is read by other columns, mended, or left out; no text needs a terminal."""
    path = tmp_path / "run.csv"
    path.write_text(REFUSED[name][0], "utf-8")
    screen = two_link_page
    screen.session.arrived["run.csv"] = path
    screen.do(screen.session.read_arrived)
    buttons = re.compile(r"(remedy|out|leave-out|other-runs|more)\b")
    assert any(map(buttons.match, screen.keys))
    notice = screen.session.notice
    texts = [screen.text(x) for x in ("next", "measure", "check")]
    texts += [] if notice is None else notice.texts
    assert not [text for text in texts if needs_a_terminal(text)]


def test_grades_and_badges_have_one_definition(story):
    """The first screen and Use gave "Good" other limits, and named no doubt."""
    sessions = Sessions(Here())
    first = Screen(sessions.new())
    said = first.text("measure")
    assert grades_in_words() in said
    assert all(meaning in said for meaning in BADGES.values())
    limits = story.session.current.facts["grades"].text
    assert limits in {grades_in_words(), grades_in_words(0.1)}
    assert limits in story.screen.text("use")
    first.loop.close()
    sessions.close()


@pytest.fixture
def two_link_page():
    """A screen on which a robot was chosen."""
    sessions = Sessions(Here())
    screen = Screen(sessions.new())
    screen.do(screen.session.start, screen.session.choose_robot, "two_link")
    yield screen
    screen.loop.close()
    sessions.close()


def test_what_helps_only_together_is_one_card_with_one_button(story, monkeypatch):
    """Each of two cards was "confident" and raised its joint's error by itself."""
    screen, session = story.screen, story.session
    history, runs = list(session.history), list(session.runs)
    shown = show_every_kind(story)
    before = shown.found.held_out_rmse_before
    pair = [shown.found.effects[0].text, shown.width.text]
    errors = {tuple(pair): 0.5 * before} | {(text,): 1.01 * before for text in pair}
    found = shown.found.with_errors(errors)
    session.history[0] = replace(session.history[0], findings=found)
    screen.do(session.changed)
    assert "Joint spring on joint 2; Coulomb friction on joint 1" in screen.text(
        "diagnose"
    )
    assert "with both, joint" in screen.text("diagnose")
    assert "-50 %" in screen.text("diagnose")
    assert "add-constant-0" not in screen.keys
    called = recorded(screen, monkeypatch)
    screen.click("add-0")
    ((_, change, *_),) = called
    assert change["arguments"] == {"effects": pair}
    session.history[:], session.runs = history, runs
    screen.do(session.changed)


def test_findings_of_every_kind_are_told(story, monkeypatch):
    screen = story.screen
    session = story.session
    shown = show_every_kind(story)
    rival = shown.rival
    one = shown.first
    curve = shown.curve
    width = shown.width
    said_of_curve = sentence(curve.sentence(["N*m", "N*m"]))
    assert said_of_curve in screen.text("diagnose")
    assert "✓ a.csv" not in screen.text("check")
    called = recorded(screen, monkeypatch)
    blue = [e.props["data-key"] for e in screen.under() if "primary" in e.classes]
    assert blue == ["next"]
    screen.click("next", "next-other", "add-2", "add-curve-0", "add-constant-0")
    screen.click(*(f"remedy-0-{k}" for k in (0, 1)))
    screen.set("remedy-0-2-unit", "mNm")
    screen.click("remedy-0-2", "remedy-0-3")
    screen.set("use-1", "test")
    assert called.pop() == ("use", session.runs[1]["file"], "test", {})
    done = [
        (name, *(x for x in given if isinstance(x, dict))) for name, *given in called
    ]
    changes = [change for _, change, *_ in done]
    sure = [width.text, "joint_spring:2", one.text]
    assert [x["arguments"] for x in changes] == [
        {"effects": sure, "findings": "helpful"},
        {"effects": ["joint_spring:2"], "findings": [1]},
        {"effects": [rival.text], "findings": [3]},
        {"effects": ["measured_curve:2"]},
        {"effects": [width.text]},
        {"gravity": [0.0, 0.0, 9.81]},
        {"apply": ["sign:tau2"]},
        {"scale": {"tau": "mNm"}},
        {},
    ]
    assert {name for name, *_ in done} == {"apply", "read_in_unit", "make_motion"}


def test_effects_that_the_model_holds_are_told_apart_beside_the_model_before(
    story, monkeypatch
):
    session = story.session
    before = SimpleNamespace(file="before.json", effects=("coulomb",))
    after = SimpleNamespace(file="after.json", effects=("coulomb", "joint_spring:2"))
    monkeypatch.setattr(session, "history", [before, after])
    asked = []

    async def job(title, name, **request):
        asked.append(request.get("model"))
        return {"file": "trajectory.csv", "words": "It is made."}

    monkeypatch.setattr(session, "_job", job)
    monkeypatch.setattr(session, "say", lambda text, error: None)
    change = {"arguments": {"separate": ["joint_spring:2", "backlash:2"]}}
    made = session.make_motion(change, lambda file: None)
    story.screen.loop.run_until_complete(made)
    assert asked == ["before.json"]


def test_the_folder_is_offered_and_kept_as_it_is(tmp_path):
    """Its runs, robots and problems, and nothing from outside it."""
    folder = tmp_path / "mine"
    for name in ("mine/arm.urdf", "mine/run.csv", "mine/notes.md", "else/problem.toml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("")
    (folder / "other").symlink_to(tmp_path / "else")
    (folder / "elsewhere.csv").symlink_to("/etc/hosts")
    before = {p: p.lstat().st_mtime_ns for p in folder.iterdir()}
    sessions = Sessions(Here())
    screen = Screen(sessions.new(), folder)
    robots = {key[6:] for key in screen.keys if key.startswith("robot-")}
    built_in = {path.parent.name for path in problems_folder().glob("*/problem.toml")}
    assert robots == {*built_in, "arm.urdf"}
    (problem,) = Screen(sessions.new(), tmp_path / "else").view.folder_problems()
    assert problem.name == "else"
    screen.click("robot-two_link")
    assert [key for key in screen.keys if key.startswith("folder-")] == ["folder-0"]
    screen.set("folder-0", True)
    screen.click("read-folder")
    assert "run.csv" in " ".join(screen.session.notice.texts)
    screen.click("close-notice")
    assert screen.session.notice is None
    assert before == {p: p.lstat().st_mtime_ns for p in folder.iterdir()}
    sessions.close()


def test_the_first_screen_shows_the_answer_of_the_demo():
    assert measure.EXAMPLE in (Path(__file__).parents[2] / "README.md").read_text()


def test_no_sentence_stands_twice_in_what_stays_in_view(story, monkeypatch):
    """Headline, line under it and More, after each change and of every kind of finding."""
    screen, session = story.screen, story.session
    history, runs = list(session.history), list(session.runs)
    steps = [next_step(screen.view)]
    for k in range(len(history), 0, -1):
        monkeypatch.setattr(session, "history", history[:k])
        steps.append(next_step(screen.view))
        bare = replace(history[k - 1], findings=None)
        monkeypatch.setattr(session, "history", [*history[: k - 1], bare])
        steps.append(next_step(screen.view))
    first = history[0]
    finding, *_ = first.findings.effects
    nothing = replace(first.findings, effects=(), retuned=(), curves=())
    weak = replace(finding, doubts=(Doubt("small"),), helps=False)
    for found in (nothing, replace(nothing, effects=(weak,))):
        for grade in ("good", "usable", "do not use"):
            verdict = json.loads(json.dumps(first.comparison["verdict"]))
            verdict["lines"][0]["grade"] = grade
            comparison = {**first.comparison, "verdict": verdict}
            step = replace(first, findings=found, comparison=comparison, curve_texts=())
            monkeypatch.setattr(session, "history", [step])
            steps.append(next_step(screen.view))
    monkeypatch.setattr(session, "history", [])
    steps.append(next_step(screen.view))
    monkeypatch.undo()
    session.history[:], session.runs = history, runs
    for step in steps:
        assert step.label
        assert step.do or step.opens or step.stage
        parts = f"{step.text} {step.number} {step.more}"
        said = [x.rstrip(".?") for x in re.split(r"(?<=[.?!]) |: |; ", parts) if x]
        assert len(said) == len({*said}), parts
        assert step.number.count(". ") <= 1, step.number
