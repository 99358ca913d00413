"""The workbench without a browser: sessions, workers, uploads, who may ask."""

import asyncio
import json
import re
import shutil
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from arms import ELBOW, SHOULDER, THREE, TURN, write_urdf
from page_sessions import Here, Screen, do, finish, numbers, opened, saved
from recorded import refusal
from small_runs import small_run
from spoiled_logs import write_logs

from tests.cli.test_printed_commands import told

pytest.importorskip("nicegui", reason="the page needs the extra [page]")

from starlette.requests import ClientDisconnect

from sdp_vs_penalty import (
    InputError,
    compare,
    load_estimate,
    load_measurements,
    load_problem,
)
from sdp_vs_penalty.api.remedies import State, next_remedy
from sdp_vs_penalty.checks.certainty import likely, possible
from sdp_vs_penalty.checks.check import check_runs
from sdp_vs_penalty.checks.fixing import LeftOut
from sdp_vs_penalty.checks.issue import leave_out, make_explanation, make_issue
from sdp_vs_penalty.checks.report import list_remedies
from sdp_vs_penalty.checks.torque_size import with_one_unit
from sdp_vs_penalty.cli.main import main
from sdp_vs_penalty.data import save
from sdp_vs_penalty.diagnosis.diagnosis_data import ErrorWith, Invisible
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.files import opened as register_input
from sdp_vs_penalty.files import protecting
from sdp_vs_penalty.formatting import sentence
from sdp_vs_penalty.page import Sessions, WorkerPool, data_chart, guarded, jobs, worker
from sdp_vs_penalty.page import sessions as tabs
from sdp_vs_penalty.page.job_queue import Working
from sdp_vs_penalty.page.next_step import _to_add, next_step
from sdp_vs_penalty.page.project import TrialOutcome, TriedRemedy
from sdp_vs_penalty.page.unit_form import NAME_UNIT
from sdp_vs_penalty.page.view import changes_of_data_in_words, checked
from sdp_vs_penalty.render.diagnosis_words import gain_sentence
from sdp_vs_penalty.render.words import describe_diagnosis, describe_remedy, parts_of
from sdp_vs_penalty.results import Certainty, Change, Remedy
from sdp_vs_penalty.robot.robot import joint_limits
from sdp_vs_penalty.signals.runs import sample_rate

#: Headers, and whether they may ask (null: a page may, a socket may not).
REQUESTS = Path(__file__).parents[1] / "data" / "page_requests.json"
#: A job of seconds.
LONG = {
    "job": "simulate",
    "robot": {"source": "panda"},
    "folder": "nowhere",
    "seed": 0,
    "runs": [],
    "effect": "joint_spring",
    "joints": [1],
    "level": "strong",
}


@pytest.fixture(scope="module")
def hidden(hidden):
    """The first eight seconds of each run: nothing that is asked here needs more."""
    return replace(hidden, runs=tuple(run.window(0.0, 8.0) for run in hidden.runs))


@pytest.fixture
def here():
    """Sessions whose jobs are done in this process."""
    made = Sessions(Here())
    yield made
    made.close()


@pytest.fixture(scope="module")
def project(hidden, tmp_path_factory):
    """The folder of a project: two runs, and the model of the first."""
    folder = tmp_path_factory.mktemp("project")
    sessions = Sessions(Here())
    files = saved(folder, hidden.runs[:2], "a.csv", "test.csv")
    s = opened(sessions, "two_link", **files)
    do(s, s.identify)
    yield shutil.copytree(s.folder, folder / "kept")
    sessions.close()


@pytest.fixture
def identified(here, project, tmp_path):
    """A copy of that project, opened."""
    return here.open_folder(shutil.copytree(project, tmp_path / "project"))


@pytest.mark.long
def test_meaningless_runs_are_identified_only_when_asked_twice(here, hidden, tmp_path):
    """Most of a torque is spikes: refused with the reason, as on the command line; where
    no repair helps, a way on is left."""
    run = hidden.runs[0]
    tau = run.tau.copy()
    tau[[500, 900, 1300], 1] += 1e4
    files = saved(tmp_path, [replace(run, tau=tau)], "spikes.csv")
    s = opened(here, "two_link", **files)
    refusal(lambda: do(s, s.identify), "spikes.csv: ", "tau2", "Identify anyway")
    assert not s.history
    s.notice = None
    s.remedies = [replace(x, refused="it does not help") for x in s.remedies]
    screen = Screen(s)
    for label in ("See what Check found", "Identify anyway"):
        assert label in screen.text("next")
        screen.click("next")
    assert len(s.history) == 1
    command, _ = s.commands()
    assert "--no-check" in command
    assert command.endswith(" --out model1.json")


def test_a_run_is_repaired_where_it_is_certain(here, hidden, tmp_path):
    """What `check --fix` does: a new run in the old one's place, the changes said."""
    run = hidden.runs[0]
    tau = run.tau.copy()
    tau[[500, 900, 1300], 1] += 500.0
    s = opened(
        here, "two_link", **saved(tmp_path, [replace(run, tau=tau)], "spikes.csv")
    )
    (before,) = s.runs
    assert [f.kind for f in before["findings"] if f.remedies] == ["spikes"]
    drawn = data_chart(s.arrays(before["view"]), ["N m", "N m"], True)
    (crosses,) = (d for d in drawn["data"] if d["name"] == "joint 2, corrected")
    np.testing.assert_allclose(
        numbers(crosses["x"]), run.t[[500, 900, 1300]], rtol=1e-4
    )
    do(s, lambda: s.apply(s.remedies[0].change.to_dict()))
    (run,) = s.runs
    assert run["name"] == "spikes.csv"
    assert not s.kinds_of_issue
    assert "Error on motion left out" in s.repairs[0][1]["sentence"]
    s.undo()
    assert s.runs == [before]


@pytest.mark.long
def test_what_a_repair_does_is_known_before_the_click(
    here, hidden, tmp_path, monkeypatch
):
    """The sentence beside the button is that of the repair, which is not made again."""
    run = hidden.runs[0]
    wrong = replace(run, tau=run.tau * [1.0, -1.0])
    here.pool.tries_remedies = True
    s = opened(here, "two_link", **saved(tmp_path, [wrong], "sign.csv"))
    change = s.remedies[0].change
    asyncio.run(s._foresee())  # again, as after each job: what is known stays
    outcome = s.outcome_of(change)
    assert outcome.sentence.startswith("Error on motion left out")
    assert outcome.falls
    monkeypatch.setattr(jobs, "change", lambda job: pytest.fail("done twice"))
    do(s, lambda: s.apply(change.to_dict()))
    ((words, effect, made),) = s.repairs
    assert (words, made) == (change.words, change.to_dict())
    assert effect["sentence"] == outcome.sentence


def test_a_unit_that_is_named_replaces_the_one_before(here, hidden, tmp_path):
    """It does not multiply on top; each repair can be taken back where it stands, and
    those after it are made again."""
    s = opened(here, "two_link", **saved(tmp_path, hidden.runs[:1], "a.csv"))

    def tau():
        return load_measurements(s.folder / s.runs[0]["file"]).tau

    logged, gravity = tau(), s.robot["gravity"]
    in_milli, in_centi = (
        Change("read", f"read tau in {unit}", {"scale": {"tau": unit}}).to_dict()
        for unit in ("mNm", "Ncm")
    )
    do(
        s,
        lambda: s.apply(in_milli),
        lambda: s.mount("0,-9.81,0"),
        lambda: s.read_in_unit(in_centi),
    )
    np.testing.assert_allclose(tau(), 0.01 * logged)
    assert [words for words, *_ in s.repairs] == [
        "read the torque in N cm",
        "gravity 0,-9.81,0",
    ]
    screen = Screen(s)
    screen.click("take-back-0")
    np.testing.assert_allclose(tau(), logged)
    assert [*s.robot["gravity"]] == [0.0, -9.81, 0.0]
    screen.click("take-back-0")
    assert not s.repairs
    assert [*s.robot["gravity"]] == [*gravity]


def test_a_button_of_several_repairs_names_those_that_it_makes(here, hidden, tmp_path):
    """What is only possible is not among them."""
    s = opened(here, "two_link", **saved(tmp_path, hidden.runs[:1], "a.csv"))

    def issue(kind, word, certainty):
        made = make_issue(kind, "", remedy=kind, where="joint 1", apply=word)
        return replace(made, certainty=certainty, repair=lambda run: run)

    issues = [
        issue("torque sign", "sign:tau1", likely("")),
        issue("torque unit", "unit:tau", likely("")),
        issue("encoder offset", "zero:q1", possible("")),
    ]
    report = check_runs(load_problem("two_link"), hidden.runs[:1])[0]
    remedies = list_remedies([replace(report, issues=tuple(issues))])
    s.runs[0]["findings"] = issues
    s.remedies = [TriedRemedy(**vars(x)) for x in remedies]
    assert remedies[0].why == "each of them is at least likely"
    screen = Screen(s)
    repairs = "torque sign (joint 1) and torque unit (joint 1)"
    assert screen.at("next").text == "Repair torque sign and torque unit in a.csv"
    assert screen.text("next").startswith(f"Likely: {repairs} in a.csv.")


@pytest.mark.parametrize(
    ("now", "main"),
    [
        (0.519, "Identify the model"),
        (0.5121, "Identify the model"),  # as it is said: the same
        (0.4, "Delete 5 rows"),
    ],
)
def test_a_repair_that_does_not_lower_the_error_is_not_offered(
    here, hidden, tmp_path, now, main
):
    """Its own figure says so; the error is that on motion left out."""
    s = opened(here, "two_link", **saved(tmp_path, hidden.runs[:1], "a.csv"))
    rows = make_issue("rows at zero", "", remedy="delete them", where="row 1")
    s.runs[0]["findings"] = [rows]
    change = Change("transform", "delete 5 rows", {"apply": []})
    outcome = LeftOut(0.5124, now)
    effect = TrialOutcome(outcome.sentence, outcome.falls)
    words = "a.csv: rows at zero", "certain", ""
    s.remedies = [TriedRemedy(*words, change, effect=effect)]
    screen = Screen(s)
    assert screen.at("next").text == main
    assert outcome.sentence in screen.text("next").replace("\xa0", " ")
    assert "next-other" not in screen.keys


def test_no_repair_is_offered_before_its_trial_is_done(here, hidden, tmp_path):
    """No button changes under the hand: there is none until it is known what helps."""
    s = opened(here, "two_link", **saved(tmp_path, hidden.runs[:1], "a.csv"))
    change = Change("transform", "delete 5 rows", {"apply": []})
    s.remedies = [TriedRemedy("a.csv: rows at zero", "certain", "", change)]
    s.untried = [change.to_dict()]
    screen = Screen(s)
    assert "next" not in screen.keys
    assert "What would repair it is being tried." in screen.text("next")
    s.untried = []
    s.changed()
    assert screen.at("next").text == "Delete 5 rows"


def test_the_count_of_one_phase_is_no_time_of_the_whole_job():
    """A diagnosis has tried its effects long before it ends: it says no seconds left."""
    work = Working().hears("trying effects: 1 of 1282")
    work = work.hears("trying effects: 50 of 1282")
    assert work.status == "50 of 1282 effects tried"


@pytest.mark.parametrize(
    ("hidden_effect", "added", "outcome"),
    [
        ("joint_spring:1", (), ": found."),
        ("stiction:2", (), ": found, as pre-sliding hysteresis."),
        (
            "stiction:1",
            ("presliding_hysteresis:1@d=0.0008",),
            ": found, as pre-sliding hysteresis, and in the model.",
        ),
        ("joint_spring:2", (), "absorb it"),
        ("backlash:2", (), "not found by this name"),
        ("backlash:2", ("backlash:2@band=4",), ": found, and in the model."),
        ("", (), ""),
    ],
)
def test_what_was_hidden_is_compared_with_what_was_found(
    here, two_link, hidden_effect, added, outcome
):
    invisible = Invisible("joint_spring", (2,), 1.0)
    effects = ["joint_spring:1", "presliding_hysteresis:2"]
    diagnosis = replace(told(two_link, effects), invisible=(invisible,))
    s = here.new()
    s.history = [SimpleNamespace(findings=diagnosis, added=added)]
    s.hidden = hidden_effect
    assert outcome in s.hidden_and_found
    assert bool(outcome) == bool(s.hidden_and_found)


def test_the_run_that_chose_what_is_added_is_no_judge_of_it(here, hidden, tmp_path):
    """Until a diagnosis has a test run, nothing of it is chosen; afterwards its run is
    said to have chosen, and a new one is not."""
    files = saved(tmp_path, hidden.runs[:2], "a.csv", "test.csv")
    s = opened(here, "two_link", **files)
    do(s, s.identify)
    assert "helped to choose" not in s.current.scope
    do(s, s.diagnose)
    do(s, lambda: s.add("presliding_hysteresis:1"))
    assert s.current.scope.endswith(
        ", which helped to choose what was added (test.csv)"
    )
    s.history = [*s.history[:-1], replace(s.current, judged_on=["new.csv"])]
    assert "helped to choose" not in s.current.scope


def test_a_card_promises_what_its_own_button_adds_and_the_next_step_all_of_it(two_link):
    """Judged on the test run as the model is; a card that does not help alone says beside
    what it does."""
    found = told(two_link, ["joint_spring:1", "backlash:1", "joint_spring:2"])
    doubt = {"doubts": (Doubt("small"),)}
    *sure, weak = found.effects
    searched = zip(found.effects, ([2.0, 2.0], [1.0, 2.0], [2.0, 1.0]), strict=True)
    found = replace(
        found,
        effects=(*sure, replace(weak, **doubt)),
        held_out_rmse_before=np.array([2.0, 2.0]),
        errors_with=tuple(ErrorWith((f.text,), np.array(x)) for f, x in searched),
    )
    judged = found.with_judged_errors(np.array([4.2, 3.1]), np.array([0.7, 1.6]))
    said = [gain_sentence(f, judged) for f in judged.effects]
    assert said[0].endswith(
        "left out: 4.2 N m or N; it helps beside backlash on joint 1, not by itself: with"
        " both joint 2's error is 1.6 N m or N, and 3.1 N m or N without it."
    )
    assert said[1].startswith(
        "Adding it cuts joint 1's error on data left out from 4.2 to 2.1 N"
    )
    assert "joint 2's error on data left out from 3.1 to 1.55 N" in said[2]
    advised, other = judged.remedies[0], judged.offers.offer_of(judged.effects[2])
    assert describe_remedy(advised, judged.offers.outcome_of(advised)).endswith(
        "joint 1's error: 4.2 → 0.7 N m or N (-83 %); no joint errs more, on data left out."
    )
    assert "joint 2's error: 3.1 → 1.55 N m or N (-50 %)" in describe_remedy(
        other, judged.offers.outcome_of(other)
    )


def test_a_doubt_that_several_findings_share_is_said_once(two_link):
    found = told(two_link, ["joint_spring:1", "backlash:1", "backlash:2"])
    shared = Doubt("small"), Doubt("not_held_out")
    effects = [replace(f, doubts=shared) for f in found.effects]
    effects[2] = replace(effects[2], doubts=(*shared, Doubt("at_end")))
    words = describe_diagnosis(replace(found, effects=tuple(effects)), ("N*m", "N*m"))
    assert words.shared_doubt.startswith(
        "Findings 1, 2 and 3, each: its gain is small; "
    )
    assert [f.doubt for f in words.findings] == ["", "", f"{_sentence('at_end')}."]


def _sentence(reason):
    """A reason for doubt, as a sentence begins."""
    return sentence(Doubt(reason).sentence)


@pytest.mark.long
def test_another_set_of_torques_is_taken_by_a_button(here, hidden, tmp_path):
    """And the commands do the same: `convert` with these columns."""
    run = hidden.runs[0]
    blocks = {"Position": run.q, "TorqueSm": run.tau, "TorqueCur": 2.0 * run.tau + 1.0}
    heads = ["Time", *(f"{name}{j}" for name in blocks for j in (1, 2))]
    table = np.column_stack([run.t, *blocks.values()])
    np.savetxt(
        tmp_path / "a.csv", table, "%.9g", ",", header=",".join(heads), comments=""
    )
    s = opened(here, "two_link", **{"a.csv": tmp_path / "a.csv"})
    for name, number in (("TorqueCur", 6), ("TorqueSm", 4)):
        (file,) = s.guessed
        if other := [x for x in file["torques"] if x.startswith(name)]:
            do(s, partial(s.read_mapped, file["columns"], *other))
            (kept,) = s.runs
            read = s.arrays(kept["file"])["tau1"]
            np.testing.assert_allclose(read, blocks[name][:, 0], rtol=1e-6)
            assert f"--rename 'tau1=#{number},tau2=" in s.commands()[0]
    assert s.prepared


def test_a_span_is_left_out_of_a_run_and_undone(here, hidden, tmp_path):
    s = opened(here, "two_link", **saved(tmp_path, hidden.runs[:2], "a.csv", "b.csv"))
    cut = Change("cut", "leave it out", {"run": "a.csv", "spans": [[3.0, 4.0]]})
    do(s, lambda: s.apply(cut.to_dict()))
    assert [run["in_commands"] for run in s.runs] == ["a_cut.csv", "b.csv"]
    assert s.runs[0]["samples"] < s.runs[1]["samples"]
    assert "convert a.csv --cut 3:4 --out a_cut.csv" in s.commands()[0]
    s.undo()
    assert [run["name"] for run in s.runs] == ["a.csv", "b.csv"]


def test_measured_data_are_loaded_or_it_is_said_why_not(
    here, hidden, tmp_path, monkeypatch
):
    assert opened(here, "panda").robot["data"]["name"] == "panda"
    s = opened(here, "two_link")
    assert s.robot["data"] is None

    def offline(name):
        raise InputError("cannot be downloaded", "check the network", "github.com")

    monkeypatch.setattr(jobs, "fetch_dataset", offline)
    s.robot["data"] = {"name": "panda"}
    refusal(lambda: do(s, s.fetch_measured), "cannot be downloaded", "the network")
    (path,) = saved(tmp_path, hidden.runs, "exciting.csv").values()
    monkeypatch.setattr(jobs, "fetch_dataset", lambda name: [path])
    do(s, s.fetch_measured)
    assert [run["name"] for run in s.runs] == ["exciting.csv"]


def ended(work, seconds):
    """Whether a worker ends within so many seconds; whoever killed it waits for it as
    well."""
    until = time.monotonic() + seconds
    while work.process.is_alive() and time.monotonic() < until:
        time.sleep(0.01)
    return not work.process.is_alive()


async def put(session, name, content=b"x"):
    """What the server answers to a dropped file."""
    from starlette.requests import Request

    from sdp_vs_penalty.page.server import keep

    async def receive():
        return {"type": "http.request", "body": content, "more_body": False}

    request = Request({"type": "http", "method": "PUT", "headers": []}, receive)
    return await keep(session, request, name)


def test_bad_robots_are_refused_and_names_are_no_paths(here):
    s = here.new()

    async def drop(name, content):
        assert await put(s, name, content.encode()) == 200
        s.read_arrived()
        await asyncio.wait([s.task])
        return " ".join(s.notice.texts) if s.notice else ""

    entity = (
        '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/hostname">]><robot'
        ' name="r">&x;</robot>'
    )
    for name, content in (
        ("entity.urdf", entity),
        ("../../<img src=x>.urdf", "<robot"),
    ):
        said = asyncio.run(drop(name, content))
        assert ".urdf: " in said
        assert "/" not in said.split(":")[0]
    link = '<link name="{0}"/>'
    joint = '<joint name="j" type="continuous"><parent link="a"/>'
    arm = (
        f'<robot name="r">{link.format("a")}{link.format("b")}{joint}<child'
        ' link="b"/></joint></robot>'
    )
    assert not asyncio.run(drop("../my arm.urdf", arm))
    assert (s.robot["file"], s.robot["title"]) == ("my arm.urdf", "1 joint, from URDF")
    for name in ("C:\\Windows\\run.csv", "/etc/passwd.csv", "a\0b.csv", "ä ö.csv"):
        assert asyncio.run(put(s, name, b"t,q1,tau1\n")) == 200
    # Whatever the names said, files are in the session's own folder under names of
    # ours.
    kept = [p for p in here.root.rglob("file-*") if p.is_file()]
    assert len([p for p in kept if p.suffix == ".csv"]) == 4
    for path in kept:
        assert path.parent == s.folder
        assert re.fullmatch(r"file-[0-9a-f]{16}\.(urdf|csv)", path.name)
        assert path.stat().st_mode & 0o077 == 0
        assert path.suffix == ".urdf" or path.read_bytes() == b"t,q1,tau1\n"


def test_what_is_dropped_in_a_job_is_opened_after_it(sessions):
    s = opened(sessions, "two_link")

    async def story():
        s.start(s.simulate, "joint_spring", [1], "strong", 0)
        assert await put(s, "arm.urdf", b"<robot") == 200
        s.cancel()
        while s.task is not None:
            await asyncio.wait([s.task])

    asyncio.run(story())
    assert s.notice.texts[0].startswith("arm.urdf: ")
    assert s.robot["name"] == "two_link"


def test_runs_of_one_name_are_dropped_in_a_row(kept, hidden, tmp_path):
    """Each has a name of its own, also after the server's end, and where an older version
    has written one name twice; the same samples are no second run."""
    names = ["run1.csv", "run2.csv"]
    s = kept.new()

    async def drop(k):
        """The k-th day's files: those of the last day are those of the first."""
        for name, run in zip(names, hidden.runs[:2], strict=True):
            day = tmp_path / name
            save(run.window(0.0, 8.0 - k % 2), day)
            assert await put(s, name, day.read_bytes()) == 200
        s.read_arrived()

    async def story():
        await s.choose_robot("two_link")
        for k in range(3):
            await drop(k)
        while s.task is not None:
            await asyncio.wait([s.task])
            await asyncio.sleep(0.0)

    asyncio.run(story())
    every = [*names, "run1 (2).csv", "run2 (2).csv"]
    assert [run["name"] for run in s.runs] == every
    assert any("holds the same samples as run1.csv" in x for x in s.notice.texts)
    s.runs = [{**run, "name": run["name"].replace(" (2)", "")} for run in s.runs]
    s.save()
    later = Sessions(Here(), kept.projects)
    again = later.get(s.token)
    assert [run["name"] for run in again.runs] == every
    screen = Screen(again)
    for name in every:
        screen.set("checked-run", name)


def test_a_project_that_cannot_be_drawn_offers_undo_and_the_others(
    here, hidden, tmp_path
):
    s = opened(here, "two_link", **saved(tmp_path, hidden.runs[:1], "a.csv"))
    whole = s.runs
    s._step_from_here("a step that fails")
    s.runs = [{"name": "a.csv"}]
    screen = Screen(s, is_broken=True)
    assert "This project cannot be shown. Internal error" in screen.text("next")
    screen.is_broken = False
    screen.click("undo")
    assert s.runs == whole


def test_a_job_that_fails_amid_its_changes_changes_nothing(
    here, hidden, tmp_path, monkeypatch
):
    s = opened(here, "two_link", **saved(tmp_path, hidden.runs[:1], "a.csv"))
    before, steps = s.runs, [label for label, _ in s.past]
    s.arrived = saved(tmp_path, hidden.runs[1:2], "b.csv")
    monkeypatch.setattr(s, "_choose_uses", lambda new: 1 / 0)
    asyncio.run(begin(s, s.read_files))
    assert "ZeroDivisionError" in s.notice.texts[0]
    assert s.runs == before
    assert [label for label, _ in s.past] == steps


def test_a_pause_is_said_and_keeps_nobody_from_identifying(here, hidden, tmp_path):
    whole = hidden.runs[0]
    paused = whole.rows((whole.t < 3.0) | (whole.t > 5.5))
    s = opened(here, "two_link", **saved(tmp_path, [paused], "run1.csv"))
    assert s.runs[0]["rate"] == pytest.approx(sample_rate(whole))
    step = next_step(SimpleNamespace(session=s))
    assert step.text == (
        "run1.csv: 1 gap of up to 2.51 s (the usual step is 0.004 s), 2.51 s in all."
    )
    assert "the run is split there" in step.more
    assert step.label == "Identify the model"


def test_a_press_waits_for_its_turn_and_is_not_lost(here, hidden, tmp_path):
    """While a job runs, and where the button was drawn anew on its way."""
    s = opened(here, "two_link", **saved(tmp_path, hidden.runs[:2], "a.csv", "b.csv"))
    screen = Screen(s)
    identify = screen.at("next")

    listeners = screen.client.layout._event_listeners.values()
    (heard,) = (x.handler for x in listeners if x.type == "press")
    press = partial(heard, SimpleNamespace(args=identify.id))

    def press_all():
        press()
        s.start(s.use, s.runs[0]["file"], "")
        press()  # again: done once
        assert "waits for its turn" in s.notice.texts[0]

    screen.do(press_all)
    assert screen.at("next").id != identify.id
    assert [run["name"] for run in s.runs] == ["b.csv"]
    assert not s.history  # of a run that is gone
    screen.do(press)
    assert s.history


def test_a_robot_and_logs_are_dropped_together(here, tmp_path):
    """In any order; logs alone wait for their robot, which replaces none like it."""
    urdf, runs = write_logs("hold", tmp_path)
    s = here.new()
    s.arrived = {runs[0].name: runs[0]}
    s.read_arrived()
    assert s.notice.texts == ("run1.csv: read once the robot is chosen.",)
    s.arrived |= {urdf.name: urdf, runs[1].name: runs[1]}
    do(s, s.open_arrived)
    assert s.robot["file"] == urdf.name
    assert [run["name"] for run in s.runs] == ["run1.csv", "run2.csv"]
    s.arrived = {urdf.name: urdf}
    do(s, s.open_arrived)
    assert len(s.runs) == 2


def test_a_full_disk_is_said(here, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tabs.os, "open", full)
    s = here.new()
    assert asyncio.run(put(s, "run.csv")) == 507
    said = "run.csv: cannot be stored (No space left on device): free disk space."
    assert s.notice.texts == (said,)
    assert s.arrived == {}


def test_of_a_dropped_run_only_its_samples_are_kept(here, hidden, tmp_path):
    """The file's copy goes when it was read, or refused; a file of the person's own
    stays."""
    files = saved(tmp_path, hidden.runs, "own.csv", "dropped.csv")
    s = opened(here, "two_link")
    for name in ("dropped.csv", "broken.csv"):
        content = files[name].read_bytes() if name in files else b"no table"
        assert asyncio.run(put(s, name, content)) == 200
    s.arrived["own.csv"] = files["own.csv"]
    refusal(lambda: do(s, s.read_files), "broken.csv")
    assert [run["name"] for run in s.runs] == ["dropped.csv", "own.csv"]
    kept = [run[what] for run in s.runs for what in ("file", "view")]
    kept.append(s.robot["sweep"])
    assert sorted(p.name for p in s.folder.iterdir()) == sorted([*kept, "project.json"])
    assert (tmp_path / "own.csv").is_file()


def test_a_worker_that_the_system_ends_is_a_sentence(pool):
    async def story():
        work = pool.worker()
        doing = asyncio.ensure_future(work.do(LONG, lambda _: None))
        work.process.kill()
        await doing

    refusal(lambda: asyncio.run(story()), "killed, probably for lack of memory")


def test_every_error_of_a_job_is_a_sentence(capfd):
    def fails(error):
        def job(asked):
            raise error

        return worker.do(job, {})

    assert fails(InputError("run.csv: row 3 is empty: delete it."))["error"].startswith(
        "run.csv"
    )
    assert (
        fails(MemoryError())["error"] == "Not enough memory: use fewer or shorter runs."
    )
    assert not capfd.readouterr().err  # these are no defects
    said = fails(ZeroDivisionError("float\ndivision"))["error"]
    assert "ZeroDivisionError: float\\ndivision)" in said
    assert "\n" not in said
    traceback = capfd.readouterr().err
    assert "Traceback" in traceback
    assert "in job" in traceback


def test_a_worker_ends_with_its_server(pool):
    """The server's end of the pipe closes, and the worker ends; tests/test_kills.py
    kills the server."""
    work = pool.worker()
    work.pipe.send(LONG)
    assert work.pipe.recv_bytes()  # it works
    work.pipe.close()
    assert ended(work, 60.0)  # at once where nothing else runs


def receive(folder, name, *chunks):
    async def pieces():
        for chunk in chunks:
            yield chunk

    return asyncio.run(tabs.receive(folder, name, pieces()))


def test_too_much_is_refused_and_not_kept(tmp_path, monkeypatch):
    """However many arrive at once: never more than there is room for."""
    monkeypatch.setattr(tabs, "LARGEST", 2**20)
    receive(tmp_path, "run.csv", b"0" * 2**19, b"0" * 2**19)
    refusal(
        lambda: receive(tmp_path, "run.csv", b"0"),
        "run.csv: a page takes 1 MB of files",
    )
    refusal(lambda: receive(tmp_path, "run.exe", b"MZ"), "run.exe: files of this kind")
    (path,) = tmp_path.iterdir()
    path.unlink()

    async def slowly():
        for _ in range(4):
            await asyncio.sleep(0.001)
            yield b"0" * 2**16

    async def all_at_once():
        sent = (tabs.receive(tmp_path, f"{k}.csv", slowly()) for k in range(8))
        return await asyncio.gather(*sent, return_exceptions=True)

    kept = [path for path in asyncio.run(all_at_once()) if isinstance(path, Path)]
    assert sorted(tmp_path.iterdir()) == sorted(kept)
    assert sum(path.stat().st_size for path in kept) <= 2**20


def test_silence_and_lost_connections_leave_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(tabs, "SILENCE", 0.05)

    async def silent():
        yield b"t,q1"
        await asyncio.sleep(10.0)

    async def lost():
        yield b"t,q1"
        raise ClientDisconnect

    for chunks, error in ((silent(), InputError), (lost(), ClientDisconnect)):
        with pytest.raises(error):
            asyncio.run(tabs.receive(tmp_path, "run.csv", chunks))
        assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize(
    "shown", [False, True], ids=["not connected yet", "all lost at once"]
)
def test_tabs_without_a_connection_are_kept_a_while(shown, sessions, monkeypatch):
    """None of twenty that are opened at once, or lose their connections at once, is
    lost."""
    monkeypatch.setattr(sessions, "_all", {})
    made = [sessions.new() for _ in range(tabs.MOST)]
    for session in made if shown else ():
        session.watchers.append(tab := Tab())
        session.left(tab)
    refusal(lambda: sessions.new(), "tabs are open")
    assert all(sessions.get(session.token) is session for session in made)
    monkeypatch.setattr(tabs, "SILENCE", 0.0)  # a while later none has come
    monkeypatch.setattr(tabs, "MOST", 4)
    sessions.new()
    assert sum(sessions.get(session.token) is not None for session in made) == 4


def answer(headers, error=None, **scope):
    """Whether a request with these headers reaches the page, and what is answered."""
    reached = []
    sent = []
    kind = scope.pop("kind", "http")

    async def app(asked, receive, send):
        reached.append(asked)
        if error is not None:
            raise error
        if kind == "http":
            await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message):
        sent.append(message)

    scope = {"type": kind, "method": "GET", "path": "/", "query_string": b"", **scope}
    scope["headers"] = [(k.encode(), v.encode()) for k, v in headers.items()]
    asyncio.run(guarded(app, 99, "secret")(scope, None, send))
    return bool(reached), sent


OWN = {"cookie": "sdp-vs-penalty-key-99=secret", "host": "127.0.0.1:99"}


def test_a_tab_that_has_gone_prints_nothing(capsys):
    """What Starlette raises where nobody waits for an answer any more."""
    reached, _ = answer(OWN, RuntimeError("No response returned."))
    assert reached
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("headers", "allowed"), json.loads(REQUESTS.read_text()))
@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_only_this_page_may_ask(headers, allowed, kind):
    if kind == "websocket":
        headers = {"origin": "http://127.0.0.1:99", **headers}
    headers = {"cookie": "other=1; sdp-vs-penalty-key-99=secret", **headers}
    reached, sent = answer(headers, kind=kind)
    allowed = (
        kind == "http" if allowed is None else allowed
    )  # a socket names where it comes from
    assert reached == allowed
    if not allowed:
        assert sent[0].get("code") == 1008 or sent[0]["status"] in (400, 403)
    elif kind == "http":
        assert b"content-security-policy" in dict(sent[0]["headers"])


def test_an_error_of_a_request_is_one_line(capsys):
    silent = KeyError(
        "Session is disconnected"
    )  # what engine.io does to a tab that was silent
    answer(
        {"host": "127.0.0.1", "cookie": "sdp-vs-penalty-key-99=secret"}, error=silent
    )
    said = capsys.readouterr().err
    assert said == "sdp-vs-penalty: page: KeyError: 'Session is disconnected'\n"


@pytest.mark.parametrize(
    ("path", "query", "to"),
    [
        ("/", b"key=secret", b"/"),
        ("/s/abc", b"a=1&key=secret", b"/s/abc?a=1"),
        ("//evil.example", b"key=secret", b"/evil.example"),
        ("/", b"key=guess", None),
        ("/", b"", None),
    ],
)
def test_the_printed_address_lets_in_once(path, query, to):
    """The key leaves the address bar, and stays in a cookie that scripts and other
    sites do not get."""
    reached, sent = answer({"host": "127.0.0.1:99"}, path=path, query_string=query)
    assert not reached  # without the cookie
    headers = dict(sent[0]["headers"])
    if to is None:
        assert sent[0]["status"] == 403
        assert b"set-cookie" not in headers
        return
    assert (sent[0]["status"], headers[b"location"]) == (303, to)
    for word in (b"sdp-vs-penalty-key-99=secret", b"HttpOnly", b"SameSite=Strict"):
        assert word in headers[b"set-cookie"]


def test_jobs_of_all_tabs_wait_for_each_other():
    """Until one is cancelled, whose worker ends at once; nothing is changed."""
    pool = WorkerPool(1)
    sessions = Sessions(pool)

    async def story():
        first = sessions.new()
        second = sessions.new()
        for s in (first, second):
            await finish(s, partial(s.choose_robot, "panda"))
        first.start(first.simulate, "joint_spring", [3], "strong", 0)
        while "simulating" not in first.working.status:
            await asyncio.sleep(0.01)
        second.start(second.simulate, "joint_spring", [3], "strong", 0)
        await asyncio.sleep(0.3)
        assert second.working.status == "waiting for the jobs of other tabs"
        (work,), begin = pool._busy, time.perf_counter()
        second.watchers.append(tab := Tab())
        second.left(tab)  # a tab that is closed leaves its job
        assert second.task is not None
        for s in (second, first):
            s.cancel()
            await asyncio.wait([s.task])
            assert s.runs == []
            assert s.notice.texts == ("Cancelled: nothing was changed.",)
        assert time.perf_counter() - begin < 1.0
        assert ended(work, 2.0)
        await finish(
            second, lambda: second.choose_robot("two_link")
        )  # the place is free again
        assert second.robot["name"] == "two_link"

    asyncio.run(story())
    pool.close()
    sessions.close()


class Tab:
    present = True

    def redraw(self):
        pass


def test_sessions_are_private_and_end_with_the_server(pool, monkeypatch):
    monkeypatch.setattr(tabs, "SILENCE", 0.0)  # no tab is about to come back
    sessions = Sessions(pool)
    first = sessions.new()
    second = sessions.new()
    assert first.token != second.token
    assert len(first.token) >= 32
    assert first.folder.stat().st_mode & 0o077 == 0
    assert sessions.root.stat().st_mode & 0o077 == 0
    assert sessions.unwatched(first.token) is first
    tab = Tab()
    first.watchers.append(tab)
    assert sessions.unwatched(first.token) is None
    tab.present = False  # just closed: not yet forgotten, but to be found again
    assert sessions.unwatched(first.token) is first
    assert sessions.unwatched("other") is sessions.unwatched(None) is None
    for _ in range(2 * tabs.MOST):  # the tab of each was closed
        sessions.new()
    assert sessions.get(first.token) is first  # a tab shows it
    assert sessions.get(second.token) is None
    assert not second.folder.exists()
    sessions.close()
    assert not sessions.root.exists()


@pytest.fixture
def strange(hidden, tmp_path):
    """A run whose torques are called as nobody calls them."""
    file = saved(tmp_path, hidden.runs[:1], "run.csv")["run.csv"]
    lines = file.read_text().splitlines()
    lines[0] = lines[0].replace("tau1", "alpha").replace("tau2", "beta")
    path = tmp_path / "strange.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize(
    ("names", "chosen"),
    [
        # Torques that nobody calls so, by their order.
        ({"tau1": "alpha", "tau2": "beta"}, "t q1 q2 alpha beta"),
        # Other programs' names; that of the clock says nothing.
        (
            {"t,": "nobody,"}
            | {f"q{j}": f"j{j}_pos" for j in (1, 2)}
            | {f"dj{j}_pos": f"j{j}_vel" for j in (1, 2)}
            | {f"tau{j}": f"j{j}_eff" for j in (1, 2)},
            "nobody j1_pos j2_pos j1_eff j2_eff",
        ),
    ],
)
def test_the_choice_of_columns_begins_with_what_is_recognised(
    here, hidden, tmp_path, names, chosen
):
    (path,) = saved(tmp_path, hidden.runs[:1], "run.csv").values()
    head, *rows = path.read_text().splitlines()
    for ours, theirs in names.items():
        head = head.replace(ours, theirs, 1 if ours == "t," else -1)
    path.write_text("\n".join([head, *rows]) + "\n")
    s = opened(here, "two_link")
    s.arrived["run.csv"] = path
    do(s, s.read_files)
    (mapping,) = s.mappings
    ours = ["t", "q1", "q2", "tau1", "tau2"]
    known = dict(zip(ours, chosen.split(), strict=True))
    assert mapping["chosen"] == {"rate": "", **known, "dq1": "", "dq2": ""}


def test_a_file_is_read_by_the_columns_that_were_chosen(here, strange, hidden):
    s = opened(here, "two_link", **{"strange.csv": strange})
    columns = s.mappings[0]["columns"]
    s.choose_column(columns, "tau1", "beta")
    s.choose_column(columns, "t", "alpha")
    s.choose_column(columns, "tau2", "alpha")
    refusal(lambda: do(s, lambda: s.read_mapped(columns)), "alpha", "more than once")
    (wrong,) = s.mappings  # nothing of the choice is lost
    assert (wrong["chosen"]["t"], wrong["chosen"]["tau1"]) == ("alpha", "beta")
    for ours, theirs in {"t": "t", "tau1": "alpha", "tau2": "beta"}.items():
        s.choose_column(columns, ours, theirs)
    do(s, lambda: s.read_mapped(columns))
    assert [run["in_commands"] for run in s.runs] == ["strange_read.csv"]
    assert not s.mappings
    (command,) = s.commands()
    assert "convert strange.csv --rename 't=#1,q1=#2" in command


def test_columns_that_were_chosen_hold_until_undo_and_for_one_robot(
    here, strange, tmp_path
):
    """A later file with these columns is read as chosen, but not after the choice was
    taken back, nor for another robot."""
    s = opened(here, "two_link", **{"strange.csv": strange})
    columns = s.mappings[0]["columns"]
    for ours, theirs in {"t": "t", "tau1": "alpha", "tau2": "beta"}.items():
        s.choose_column(columns, ours, theirs)
    do(s, lambda: s.read_mapped(columns))
    chosen = s.assigned
    assert [*chosen] == [json.dumps(columns)]
    s.undo()
    assert not s.assigned
    s.redo()
    assert s.assigned == chosen
    assert Sessions(Here()).open_folder(s.folder).assigned == chosen
    do(s, lambda: s.choose_robot("two_link"))
    assert not s.assigned
    later = tmp_path / "later.csv"
    head, *rows = strange.read_text().splitlines()
    later.write_text("\n".join([head, *rows[:-100]]) + "\n")
    s.arrived["later.csv"] = later
    do(s, s.read_files)
    assert not s.runs
    assert s.mappings[-1]["columns"] == columns


def test_what_a_reader_assumes_is_said_once(here, hidden, tmp_path, recwarn):
    (path,) = saved(tmp_path, hidden.runs[:1], "run.csv").values()
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *rows[:500], head, *rows[500:]]) + "\n")
    s = opened(here, "two_link", **{"run.csv": path})
    (said,) = s.notice.texts
    assert said.endswith("run.csv: 1 repeated header left out.")
    assert not recwarn


def test_the_clearest_of_dropped_logs_tells_the_unit_of_all(here, tmp_path):
    """One that is dropped later too; and a name is the one that the person knows."""
    arm = write_urdf(tmp_path / "arm.urdf", "arm", (TURN, SHOULDER, ELBOW))
    run = small_run(load_problem(arm), seconds=8.0)
    noise = np.random.default_rng(1).normal(0.0, 0.35, (2, *run.tau.shape))
    torques = [run.tau, *(run.tau + noise * np.std(run.tau, axis=0))]
    header = "time,pos1,pos2,pos3,trq1,trq2,trq3"
    paths = {}
    for name, tau in zip(("c.csv", "b.csv", "a.csv"), torques, strict=True):
        table = np.column_stack([run.t, np.degrees(run.q), tau])
        paths[name] = tmp_path / name
        np.savetxt(paths[name], table, "%.9g", ",", header=header, comments="")
    later = paths.pop("a.csv")
    s = opened(here, str(arm), **{name: paths[name] for name in ("b.csv", "c.csv")})
    s.arrived["a.csv"] = later
    do(s, s.read_files)
    assert len(s.runs) == 3
    for stored in s.runs:
        got = load_measurements(s.folder / stored["file"])
        np.testing.assert_allclose(got.q, run.q, atol=1e-6)
    texts = " ".join(s.notice.texts)
    assert "a.csv: columns" in texts
    assert "as the arm tells of c.csv" in texts


def wide_table(run):
    """A clock and five columns a joint (N, 11), as some loggers write them."""
    run = run.rows(slice(None, None, 4))
    dq = np.gradient(run.q, run.t, axis=0)
    return np.column_stack([run.t, run.q, dq, run.tau, 0.5 * run.tau, run.q])


def with_tables(here, **tables):
    """The screen of uploaded tables without a header, by their names without ending."""
    screen = Screen(here.new())
    s = screen.session
    screen.do(s.start, s.choose_robot, "two_link")
    for name, table in tables.items():
        path = s.folder / f"file-{name}.csv"
        np.savetxt(path, table, fmt="%.9g", delimiter=",")
        s.arrived[f"{name}.csv"] = path
    screen.do(s.read_arrived)
    return screen


def blocks_of(screen):
    return [key for key in screen.keys if key.startswith("block-")]


@pytest.fixture
def wide(here, hidden):
    """The screen of two tables without a header, of a clock and five columns a joint."""
    a, b = map(wide_table, hidden.runs[:2])
    return with_tables(here, a=a, b=b)


def test_a_wide_table_is_read_by_the_order_that_the_command_line_proposes(wide, hidden):
    """What may be wrong about the guess stands beside the button."""
    assert "a clock and 5 columns of each of 2 joints" in wide.text("runs")
    assert wide.session.new == ("measure", "runs")  # the guess is shown
    wide.click("next")  # no block is taken before one is chosen
    assert not wide.session.runs
    wide.click(next(key for key in wide.keys if key.startswith("block-")))
    assert [run["in_commands"] for run in wide.session.runs] == [
        "a_read.csv",
        "b_read.csv",
    ]
    assert "tau1=#6,tau2=#7" in wide.session.commands()[0]
    assert "Read with these columns" not in wide.text("next")


def test_another_block_is_read_after_a_step_back(wide):
    """The uploaded files are there as long as undo brings their question back."""
    s = wide.session
    first, second, *_ = blocks_of(wide)
    wide.click(first)
    read = s.arrays(s.runs[0]["file"])["tau1"]
    s.undo()
    assert not s.runs
    assert len(s.refused) == 2
    wide.click(second)
    assert [run["name"] for run in s.runs] == ["a.csv", "b.csv"]
    np.testing.assert_allclose(s.arrays(s.runs[0]["file"])["tau1"], 0.5 * read, 1e-6)


def test_a_table_that_begins_inside_a_packet_is_recognised_and_mended(here, hidden):
    """Whatever stands in its first rows; the rows of another clock are to be deleted."""
    table = wide_table(hidden.runs[0])
    table[:, 0] += 3048.0
    torn = np.full((3, table.shape[1]), 253.0)
    torn[:, 0] = -0.1231, 0.7932, 0.0
    torn[1, 1:] = 1e280
    screen = with_tables(here, a=np.vstack([table[:1], torn, table[1:]]))
    (mapping,) = screen.session.refused
    assert mapping["chosen"]["t"] == "#1"
    screen.click(blocks_of(screen)[0])
    (run,) = screen.session.runs
    kinds = [issue.kind for issue in run["findings"]]
    assert "stray rows" in kinds
    assert "gap in time" not in kinds
    assert "elete these rows" in screen.text("check")


def test_a_long_question_ends_as_one(wide):
    for mapping in wide.session.mappings:
        mapping["name"] = mapping["name"].rjust(60, "a")
    step = next_step(wide.view)
    assert step.text.endswith("is the torque?")


def test_no_run_is_checked_while_the_columns_of_all_files_are_asked_for(wide):
    """ "Checking 0 runs" stood there."""
    texts = []
    job = jobs.JobRequest(wide.session._request("read"), texts.append)
    jobs._judged(job, State(job.problem, ()), [])
    assert not texts


def test_what_a_good_model_leaves_is_said_in_sentences(identified):
    """ "Still to be won: cause uncertain: pre-sliding hysteresis" was read twice."""
    s = identified
    do(s, s.diagnose)
    diagnosis = s.findings_of_current
    step = _to_add(Screen(s).view, diagnosis, next_remedy(diagnosis.remedies), "good")
    assert re.match(r"Good already[.] Some error is left[.] [A-Z][^.]*[.]", step.text)


def with_errors_of_findings(session, factor):
    """What was found, as if each selection of it changed each error by a factor."""
    found = session.findings_of_current
    errors = {x.effects: factor * found.held_out_rmse_before for x in found.errors_with}
    session.history[-1] = replace(session.current, findings=found.with_errors(errors))


def test_what_is_offered_is_listed_and_what_raises_all_errors_is_no_button(identified):
    """The primary button advised what raised four errors."""
    s = identified
    do(s, s.diagnose)
    screen = Screen(s)
    offer = s.findings_of_current.offers.main
    assert offer is not None
    parts = parts_of(offer, s.findings_of_current)
    assert ("parts-0" in screen.keys) == (len(parts) > 1)
    for part in parts:
        assert part.title in screen.text("findings")
        assert part.gain in screen.text("findings")
    with_errors_of_findings(s, 3.0)
    screen = Screen(s)
    assert s.findings_of_current.offers.main is None
    assert "Nothing found is advised to be added" in screen.text("next")
    assert "+200 %" in screen.text("next")
    labels = [choice.label for choice in next_step(screen.view).choices]
    assert not any(re.match("(Or a|A)dd (?!the measured curve)", x) for x in labels)


@pytest.mark.parametrize(
    ("names", "uses"),
    [
        ("a b c", ["train", "train", "test"]),
        ("a test new", ["train", "test", "test"]),
        ("test a b", ["test", "train", "test"]),
        ("test a", ["test", "train"]),
    ],
)
def test_of_several_runs_the_last_is_kept_for_testing(
    names, uses, here, hidden, tmp_path
):
    """So that the errors that are shown are of motion that no model has seen."""
    files = saved(tmp_path, hidden.runs[:3], *(f"{x}.csv" for x in names.split()))
    s = opened(here, "two_link", **files)
    in_order = {run["name"]: run["use"] for run in s.runs}
    assert [in_order[f"{x}.csv"] for x in names.split()] == uses


@pytest.mark.parametrize("button", ["next", "read-mapped-0"])
def test_columns_that_cannot_be_read_say_why_beside_the_button(wide, button):
    """Nothing is chosen, then the same twice: a sentence in words of the page, once for
    all files."""
    (columns,) = {tuple(m["columns"]) for m in wide.session.mappings}
    for ours in wide.session.mappings[0]["chosen"]:
        wide.session.choose_column([*columns], ours, "")
    wide.click(button)
    assert not wide.session.runs
    (said,) = wide.session.notice.texts
    assert said == "No column is chosen: choose one for each of t to tau2."
    assert said in wide.text("runs")
    wide.session.choose_column([*columns], "t", columns[0])
    wide.click(button)
    assert wide.session.notice.error
    assert "--" not in wide.session.notice.texts[0]
    (said,) = wide.session.notice.texts
    assert said.partition(": ")[2] in wide.text("runs")


def test_a_motion_goes_where_the_runs_have_been_and_no_faster(here, hidden, tmp_path):
    s = opened(here, "two_link", **saved(tmp_path, hidden.runs[:1], "a.csv"))
    robot = load_problem("two_link").robot
    allowed = joint_limits(robot)[2]
    run = hidden.runs[0]
    logged = np.abs(np.gradient(run.q, run.t, axis=0)).max()
    limits = jobs._limits_of_motion(jobs.JobRequest(s._request("motion")))
    assert (limits.velocity <= np.minimum(allowed, logged)).all()
    assert (limits.lower >= run.q.min(axis=0)).all()
    assert (limits.upper <= run.q.max(axis=0)).all()
    s.runs = []
    job = jobs.JobRequest(s._request("motion"))
    assert np.array_equal(jobs._limits_of_motion(job).velocity, allowed)


def test_a_job_that_the_server_has_ended_is_offered_again(kept, hidden, tmp_path):
    s = opened(kept, "two_link", **saved(tmp_path, hidden.runs[:2], "a.csv", "b.csv"))
    run = s.pool.run

    async def ends(request, *given, **how):
        raise asyncio.CancelledError

    s.pool.run = ends
    asyncio.run(begin(s, s.identify))
    s.pool.run = run
    assert not s.history
    later = Sessions(Here(), kept.projects)
    again = later.get(s.token)
    assert "Identifying the model: the program ended" in again.notice.texts[0]
    Screen(again).click("start-again")
    assert again.history
    assert not again.unfinished


async def begin(session, act, *given):
    """Start a job, and wait until it has ended, however."""
    session.start(act, *given)
    await asyncio.wait([session.task])


@pytest.fixture
def kept(tmp_path):
    """Sessions whose projects stay."""
    return Sessions(Here(), tmp_path / "projects")


def test_a_project_is_there_after_the_server_has_ended(kept, hidden, tmp_path, strange):
    """Robot, runs, the choice of columns, a step back: from the folder, moved or not."""
    files = saved(tmp_path, hidden.runs[:2], "a.csv", "b.csv")
    s = opened(kept, "two_link", **files, **{"strange.csv": strange})
    s.choose_column(s.mappings[0]["columns"], "tau1", "beta")
    do(s, lambda: s.use(s.runs[1]["file"], ""))
    assert [run["name"] for run in s.runs] == ["a.csv"]
    s.seen_issues = ["spikes"]
    kept.close()
    assert s.folder.is_dir()
    later = Sessions(Here(), kept.projects)
    (project,) = later.saved()
    assert project.name.startswith("Spatial 2R toy robot, ")
    assert project.token == s.token
    again = later.get(s.token)
    assert again is not s
    assert again.runs == s.runs
    assert again.seen_issues == ["spikes"]
    assert again.mappings[0]["chosen"]["tau1"] == "beta"
    again.undo()
    assert [run["name"] for run in again.runs] == ["a.csv", "b.csv"]
    moved = s.folder.rename(tmp_path / "elsewhere")
    named = Sessions(Here(), None).open_folder(moved)
    do(named, named.identify)
    assert Path(named.current.file).parent == moved


#: Of an issue, beside how sure it is.
WORDS = "kind", "severity", "where", "what", "remedy"


def test_a_project_of_an_older_version_is_brought_to_todays(kept, hidden, tmp_path):
    """It has what a repair did, and how sure an issue is, in words."""
    s = opened(kept, "two_link", **saved(tmp_path, hidden.runs[:1], "a.csv"))
    words = "Error on motion left out: 0.512 % as logged, {} % repaired."
    remedy = Remedy("spikes", "likely", "", Change("transform", "delete them"))
    s.remedies = [{**remedy.to_dict(), "effect": words.format(0.519)}]
    s.repairs = [["flip it", words.format(0.3)]]
    s.runs[0]["findings"] = [
        {"certainty": "likely: spikes", **dict.fromkeys(WORDS, "")}
    ]
    s.save()
    again = Sessions(Here(), kept.projects).get(s.token)
    assert not again.remedies[0].effect.falls
    assert again.repairs[0][1] == {"sentence": words.format(0.3), "falls": True}
    assert again.repairs[0][2]["verb"] == ""
    (issue,) = again.runs[0]["findings"]
    assert issue.certainty == Certainty("likely", "spikes")


def test_a_project_has_a_name_runs_and_verdict_and_is_deleted(kept, hidden, tmp_path):
    s = opened(kept, "two_link", **saved(tmp_path, hidden.runs[:1], "a.csv"))
    s.rename(" arm on the bench ")
    written = (s.folder / "project.json").stat().st_mtime_ns
    s.save()
    assert (s.folder / "project.json").stat().st_mtime_ns == written  # no new work
    (project,) = kept.saved()
    assert project.name == "arm on the bench"
    assert project.about.startswith("no model yet: a.csv; ")
    other = opened(kept, "two_link", **saved(tmp_path, hidden.runs[:1], "b.csv"))
    other.repairs = [["flip tau1 (and check the wiring)", {}, {}]]
    other.rename("arm on the bench")
    later, first = sorted(kept.saved(), key=lambda x: x.folder == s.folder)
    assert {later.name, first.name} == {project.name, f"{project.name} (2)"}
    assert later.about.startswith("no model yet: b.csv (flip joint 1's torque); ")
    kept.delete(later)
    s.watchers.append(SimpleNamespace(present=True))
    refusal(lambda: kept.delete(project), project.name, "is open in a tab")
    s.watchers[0].present = False  # a tab that was closed
    kept.delete(project)
    assert kept.saved() == []
    assert not s.folder.exists()


@pytest.mark.parametrize("place", ["projects/mine", "mine", "link"])
def test_a_named_folder_is_listed_once_and_never_deleted(kept, tmp_path, place):
    """It may hold what its owner has put there, and lie among the other projects."""
    (tmp_path / "projects" / "mine").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "projects" / "mine")
    s = kept.open_folder(tmp_path / place)
    do(s, lambda: s.choose_robot("two_link"))
    notes = s.folder / "notes.txt"
    notes.write_text("of the owner")
    (project,) = kept.saved()
    refusal(lambda: kept.delete(project), "that you have named", str(project.folder))
    assert notes.read_text() == "of the owner"
    assert kept.get(s.token) is s
    assert kept.saved() == [project]


@pytest.mark.parametrize(
    "content", ["", "{}", '{"now": {"runs": [{"file": "../a", "view": "b"}]}}']
)
def test_a_folder_of_somebody_else_is_no_project(here, tmp_path, content):
    (tmp_path / "project.json").write_text(content)
    refusal(lambda: here.open_folder(tmp_path), str(tmp_path), "no project of the page")


def test_a_named_project_is_saved_again_and_listed(tmp_path, monkeypatch):
    """Its files are no inputs of the command that names it."""
    folder = tmp_path / "mine"

    def served(_, project, *others):
        sessions = Sessions(Here())
        s = sessions.open_folder(project)
        do(s, lambda: s.choose_robot("two_link"))
        assert [x.token for x in sessions.saved()] == [s.token]
        s.rename(f"{s.name}!")
        assert s.notice is None
        sessions.close()

    monkeypatch.setattr("sdp_vs_penalty.page.server.serve", served)
    for _ in range(2):
        with pytest.raises(SystemExit, match=r"^0$"):
            main(["page", "--project", str(folder), "--no-browser"])
    assert json.loads((folder / "project.json").read_text())["name"] == "mine!!"


def test_what_cannot_be_saved_is_said_and_hangs_nothing(here, tmp_path):
    s = opened(here, "two_link")
    with protecting():
        register_input(s.folder)
        s.rename("new name")
    assert s.notice.texts[0].startswith("The project is not saved. ")


def test_a_new_run_tests_the_model_that_is_there(identified, hidden, tmp_path):
    """The model stays, whatever run is judged; it goes with what it was identified from."""
    s = identified
    first = s.current
    s.arrived |= saved(tmp_path, hidden.runs[2:], "new.csv")
    do(s, s.read_files)
    assert "new.csv" in s.notice.texts[-1]
    assert [run["use"] for run in s.runs] == ["train", "test", "test"]
    made = [load_estimate(step.file) for step in (first, s.current)]
    np.testing.assert_array_equal(made[0].theta, made[1].theta)
    assert s.current.judged_on == ["test.csv", "new.csv"]
    alone = [compare(made[0], hidden.runs[k])[0].rmse for k in (1, 2)]
    assert [*s.current.errors_of_runs] == ["a.csv", "test.csv", "new.csv"]
    assert s.current.comparison["rmse"] != first.comparison["rmse"]
    (both,) = compare(made[0], list(hidden.runs[1:3]))
    np.testing.assert_allclose(s.current.comparison["rmse"], both.rmse, rtol=1e-6)
    s.undo()
    assert s.current == first
    s.redo()
    do(s, lambda: s.use(s.runs[1]["file"], ""))
    np.testing.assert_allclose(s.current.comparison["rmse"], alone[1], rtol=1e-6)
    do(s, lambda: s.use(s.runs[1]["file"], "train"))
    assert not s.history
    assert "dropped" in s.notice.texts[0]
    s.undo()
    assert s.history


@pytest.mark.long
def test_what_has_changed_of_a_model_is_identified_again(here, tmp_path):
    """The dry friction of one joint rose: the model has that effect, and none is added
    twice. What was added to the model stays."""
    urdf = write_urdf(tmp_path / "arm.urdf", "arm", THREE)
    problem = load_problem(urdf)
    runs = [small_run(problem, 20.0, seed, 200.0) for seed in range(3)]
    more = np.array([0.0, 0.8, 0.0]) * np.tanh(runs[2].dq / 0.02)
    runs[2] = replace(runs[2], tau=runs[2].tau + more)
    files = saved(tmp_path, runs, "run1.csv", "run2.csv", "worn.csv")
    worn = files.pop("worn.csv")
    screen = Screen(here.new())
    s = screen.session
    s.arrived = {urdf.name: urdf, **files}
    screen.do(s.read_arrived)
    do(s, s.identify)
    do(s, lambda: s.add("joint_spring:1"))
    s.arrived = {"worn.csv": worn}
    screen.do(s.read_arrived)
    assert "joint 2 errs most" in s.notice.texts[-1]
    do(s, s.find_change)
    assert "Undo brings the other runs back" in s.notice.texts[-1]
    assert s.findings.effects[0].text.startswith("coulomb_friction:2")
    assert screen.text("diagnose").count("The model has it, of another size") == 1
    assert "Identify again from worn.csv" in screen.text("next")
    screen.click("next")
    assert screen.text("next").startswith("Good. ")
    assert "joint_spring:1" in s.current.effects


@pytest.mark.long
def test_a_load_is_weighed_by_the_next_step(here, tmp_path):
    """The run with it tests the model, which errs in it alone; what a diagnosis said of
    the runs before is dropped. A terminal does the same."""
    load = 1.5
    *axes, last = THREE
    axes.append(replace(last, mass=last.mass + load))
    urdf = write_urdf(tmp_path / "arm.urdf", "arm", THREE)
    arms = [urdf, urdf, write_urdf(tmp_path / "loaded.urdf", "arm", axes)]
    runs = [small_run(load_problem(arm), 20.0, k, 200.0) for k, arm in enumerate(arms)]
    files = saved(tmp_path, runs, "run1.csv", "run2.csv", "loaded.csv")
    loaded = files.pop("loaded.csv")
    screen = Screen(here.new())
    s = screen.session
    s.arrived = {urdf.name: urdf, **files}
    screen.do(s.read_arrived)
    while "Download" not in screen.text("next"):
        screen.click("next")
    arm = s.current.file
    assert "run2.csv" not in s.current.changed_runs
    s.arrived = {"loaded.csv": loaded}
    s.taken = {"trajectory.csv"}  # whatever was asked for before
    screen.do(s.read_arrived)
    assert s.findings is None
    assert "in loaded.csv (blue)" in screen.text("fit")
    assert "in loaded.csv, and by" in screen.text("next")
    screen.click("next")
    (found,) = s.findings.effects
    assert found.effect == "payload"
    assert found.size == pytest.approx(load, rel=0.02)
    screen.click("next")
    assert screen.text("next").startswith("Good. ")
    assert "of the arm as in loaded.csv" in screen.text("next")
    assert "of the arm as in loaded.csv" in screen.text("use")
    *_, add, _ = s.commands()
    assert "add model1.json --from findings1.json" in add
    s.undo()
    s.undo()
    assert [run["name"] for run in s.runs] == ["run1.csv", "run2.csv", "loaded.csv"]
    do(s, lambda: s.identify_from([run["name"] for run in s.runs]))
    assert {run["use"] for run in s.runs} == {"train"}
    assert s.current.file != arm
    s.undo()
    do(s, lambda: s.use(s.runs[2]["file"], "train"))
    assert s.differing_runs == [s.runs[2]]
    assert "Identify without loaded.csv, and test on it" in screen.text("check")
    screen.click("next")
    assert [run["use"] for run in s.runs] == ["train", "test", "test"]
    assert s.current.file != arm  # one press identifies
    do(s, lambda: s.use(s.runs[2]["file"], ""))
    assert not s.warnings


@pytest.mark.long
def test_an_issue_of_two_runs_is_said_once_and_repaired_together(
    here, tmp_path, hidden
):
    runs = []
    for run in hidden.runs[:2]:
        tau = run.tau.copy()
        tau[500, 0] = 1e4
        runs.append(replace(run, tau=tau))
    s = opened(here, "two_link", **saved(tmp_path, runs, "a.csv", "b.csv"))
    screen = Screen(s)
    assert screen.text("check").count("a.csv and b.csv: spikes.") == 1
    screen.click("next")
    assert [run["in_commands"] for run in s.runs] == ["fixed/a.csv", "fixed/b.csv"]
    assert not s.meaningless


@pytest.mark.parametrize(
    ("tables", "runs"),
    [
        ({"a_encoder": "t,q1", "a_drive": "time,tau1"}, ["a_encoder+a_drive"]),
        ({"a_q": "t,joint1", "a_tau": "t,joint1"}, ["a_q+a_tau"]),
        ({"q_a": "t,q1", "v_a": "t,dq1", "tau_a": "t,tau1"}, ["q_a+v_a+tau_a"]),
        ({"a1": "t,q1", "a2": "t,tau1"}, ["a1", "a2"]),  # two runs
        ({"a_x": "t,q1", "b_y": "t,tau1"}, ["a_x", "b_y"]),
        ({"a_x": "t,q1,tau1", "a_y": "t,tau1"}, ["a_x", "a_y"]),  # a run by itself
        ({"a_x": "t,q1", "a_y": "t,q1"}, ["a_x", "a_y"]),
        ({"a_x": "t,q1", "a_y": "t,q1", "a_z": "t,tau1"}, ["a_x", "a_y", "a_z"]),
        ({"a_x": "t,q1", "a_late": "t,tau1"}, ["a_x", "a_late"]),  # stamps apart
    ],
)
def test_files_of_one_run_are_known_by_what_they_hold(tmp_path, tables, runs):
    files = []
    for stem, header in tables.items():
        path = tmp_path / f"{stem}.csv"
        begin = 100.0 if stem == "a_late" else 0.0
        rows = [[begin + 0.1 * k] + [k**2] * header.count(",") for k in range(9)]
        lines = [",".join(map(str, row)) for row in rows]
        path.write_text("\n".join([header, *lines]), "utf-8")
        files.append({"path": str(path), "name": path.name})
    joined = [file["name"].replace(".csv", "") for file in jobs._joined(files)]
    assert joined == runs


@pytest.mark.long
@pytest.mark.parametrize("kind", ["headerless", "hold", "two files"])
def test_the_next_step_leads_to_a_good_model(here, tmp_path, kind):
    """Twelve kinds of log go the same way in a browser: test_spoiled_logs.py."""
    urdf, runs = write_logs(kind, tmp_path)
    screen = Screen(here.new())
    screen.do(screen.session.start, screen.session.choose_robot, str(urdf), urdf.name)
    screen.session.arrived |= {path.name: path for path in runs}
    screen.do(screen.session.read_arrived)
    for _ in range(9):
        if "Download the report" in screen.text("next"):
            break
        screen.click("next")
    assert screen.text("next").startswith("Good.")


def test_a_repair_of_a_test_run_keeps_the_model(here, hidden, tmp_path):
    """It is judged on the repaired run; a repair of a run that it is from drops it, and
    says so."""
    run, tested = hidden.runs[:2]
    tau = tested.tau.copy()
    tau[[500, 900, 1300], 1] += 500.0
    spoiled = replace(tested, tau=tau)
    s = opened(here, "two_link", **saved(tmp_path, [run, spoiled], "a.csv", "test.csv"))
    do(s, s.identify)
    before = s.current
    do(s, lambda: s.apply(s.remedies[0].change.to_dict()))
    made = [load_estimate(step.file) for step in (before, s.current)]
    np.testing.assert_array_equal(made[0].theta, made[1].theta)
    assert max(s.current.comparison["rmse"]) < max(before.comparison["rmse"])
    screen = Screen(s)
    words, *_ = s.repairs[0]
    for part in ("next", "take-away"):  # it stays said beside every verdict
        assert "Judged with the data changed" in screen.text(part)
        assert f"hanged: {words}." in screen.text(part)
    do(s, lambda: s.mount("0,9.81,0"))
    assert not s.history
    assert "dropped" in s.notice.texts[0]
    shift = "shift tau1 12 ms earlier (and log all channels from one source)"
    s.repairs = [[shift, {}, {}], ["set gravity to (0, 0, 9) m/s^2", {}, {}]]
    assert changes_of_data_in_words(s) == (
        "Judged with the data changed: shift joint 1's torque 12 ms earlier; set gravity"
        " to (0, 0, 9) m/s^2."
    )


def test_a_model_that_was_brought_stays_where_training_runs_change(
    here, hidden, tmp_path
):
    """It is from other runs; what was added to it is from these, and goes."""
    names = ("a.csv", "b.csv", "test.csv")
    s = opened(here, "two_link", **saved(tmp_path, hidden.runs[:3], *names))
    do(s, s.identify)
    brought = s.current.file
    do(s, lambda: s.open_model(brought, "mine.json"))
    alone = s.current.comparison["rmse"]
    do(s, lambda: s.add("joint_spring:1"))
    do(s, lambda: s.use(s.runs[1]["file"], "test"))
    assert [step.opened for step in s.history] == ["mine.json"]
    assert "What was added to mine.json is dropped" in s.notice.texts[0]
    assert s.current.comparison["rmse"] != alone
    theta = [load_estimate(file).theta for file in (brought, s.current.file)]
    np.testing.assert_array_equal(*theta)


def test_what_was_stated_of_runs_holds_for_a_new_one(here, hidden, tmp_path):
    """Drive gains, for files with the same columns; it is said."""
    gains = np.array([9.0, 7.0])
    runs = [replace(run, tau=run.tau / gains) for run in hidden.runs[:3]]
    names = ("a.csv", "test.csv", "new.csv")
    files = saved(tmp_path, runs, *names)
    new = {"new.csv": files.pop("new.csv")}
    s = opened(here, "two_link", **files)
    read = {"verb": "read", "words": "", "arguments": {"scale": {"tau": "9:7"}}}
    do(s, lambda: s.apply(read))
    assert s.repairs[-1][0] == "multiply the torque by 9, 7"
    do(s, s.identify)
    s.arrived |= new
    do(s, s.read_files)
    assert "new.csv: read in the units of runs like it." in s.notice.texts
    assert [run["use"] for run in s.runs] == ["train", "test", "test"]
    for run, path in zip(s.runs, hidden.runs, strict=False):
        tau = np.load(s.folder / run["file"])["tau1"]
        np.testing.assert_allclose(tau, path.tau[:, 0], rtol=1e-6)
    assert [words[:4] for words in s.prepared] == [
        ["convert", name, "--scale", "tau=9:7"] for name in names
    ]


def test_a_fault_of_the_log_leads_where_a_new_run_errs(here, hidden, tmp_path):
    """Not a load: what the check says of that run stands in the headline."""
    run, tested = hidden.runs[:2]
    tau = tested.tau.copy()
    tau[[500, 900, 1300], 1] += 1e4
    files = saved(tmp_path, [run, replace(tested, tau=tau)], "a.csv", "test.csv")
    screen = Screen(opened(here, "two_link", **files))
    s = screen.session
    do(s, s.identify)
    assert "test.csv" in s.current.differing_tests
    assert "test.csv: " in screen.text("next")
    assert "tau2 is far from the samples" in screen.text("next")
    assert "See what Check found" in screen.text("next")
    assert "Find a load" not in screen.text("next")


def test_rows_that_no_robot_measures_are_left_out_by_a_button(
    identified, hidden, tmp_path
):
    """A file with them becomes a run that waits, and no model is tested on it before."""
    files = saved(tmp_path, hidden.runs[2:], "torn.csv")
    head, *rows = files["torn.csv"].read_text().splitlines()
    cells = rows[5].split(",")
    rows[5] = ",".join([cells[0], "-2.68e154", *cells[2:]])
    files["torn.csv"].write_text("\n".join([head, *rows]) + "\n")
    s = identified
    s.arrived |= files
    do(s, s.read_files)
    assert s.runs[-1]["use"] == "wait"
    assert s.current.judged_on == ["test.csv"]
    screen = Screen(s)
    assert "torn.csv: 1 row with values that are not finite" in screen.text("next")
    assert "Delete these rows" in screen.text("next")
    screen.click("next")
    assert s.runs[-1]["use"] == "test"
    assert s.runs[-1]["samples"] == hidden.runs[2].samples - 1
    assert s.current.judged_on[-1] == s.runs[-1]["name"]
    assert "torn.csv" in screen.text(
        "measure"
    )  # as it was dropped, and not as its copy
    assert "fixed" not in screen.text("measure")


def test_what_is_left_is_identified_from(here, hidden, tmp_path):
    """Where the run for it was left out."""
    names = ("a.csv", "test1.csv", "test2.csv")
    s = opened(here, "two_link", **saved(tmp_path, hidden.runs[:3], *names))
    change = leave_out("a.csv").to_dict()
    do(s, lambda: s.apply(change))
    assert [(run["name"], run["use"]) for run in s.runs] == [
        ("test1.csv", "train"),
        ("test2.csv", "test"),
    ]


def test_a_file_that_its_columns_do_not_save_is_left_out(here, strange):
    """After it was read as chosen, the reason leads, and the button that leaves it out."""
    text = strange.read_text().splitlines()
    silent = [re.sub(r"(,[^,]+){2}$", ",0,0", row) for row in text[1:]]
    strange.write_text("\n".join([text[0], *silent]) + "\n")
    screen = Screen(opened(here, "two_link", **{"strange.csv": strange}))
    s = screen.session
    columns = s.mappings[0]["columns"]
    assert "say which column is what" in screen.text("next")
    for ours, theirs in {"t": "t", "tau1": "alpha", "tau2": "beta"}.items():
        s.choose_column(columns, ours, theirs)
    screen.do(s.start, s.read_mapped, columns)
    assert "every torque is zero" in screen.text("next")
    assert "Leave strange.csv out" in screen.text("next")
    s.choose_column(columns, "tau2", "q2")
    assert "Read with these columns" in screen.text("next")
    s.choose_column(columns, "tau2", "beta")
    screen.click("next")
    assert not s.mappings
    s.undo()
    assert s.mappings


def test_the_unit_of_one_run_is_asked_for_that_run(here, hidden, tmp_path):
    """In one question, and the others stay as they are."""
    s = opened(here, "two_link", **saved(tmp_path, hidden.runs[:2], "a.csv", "b.csv"))
    gains = [
        make_explanation(
            *("torque gain", ""),
            remedy="",
            joints=[j],
            is_gain=True,
            run="b.csv",
            size=size,
        )
        for j, size in enumerate((-0.5, -0.75))
    ]
    (issue,) = with_one_unit("b.csv", gains, 2)
    assert "joints 1 and 2 are 2 to 4 times too small" in issue.what
    assert with_one_unit("b.csv", gains[:1], 4) == tuple(gains[:1])
    s.runs = [s.runs[0], {**s.runs[1], "findings": [issue]}]
    screen = Screen(s)
    assert "Say the unit" in screen.text("next")
    (key,) = (x for x in screen.keys if x.endswith("-gains"))
    screen.set(key, "2, 4")
    screen.click(key.removesuffix("-gains"))
    taus = [load_measurements(s.folder / run["file"]).tau for run in s.runs]
    np.testing.assert_array_equal(taus[0], hidden.runs[0].tau)
    np.testing.assert_allclose(taus[1], hidden.runs[1].tau * [2.0, 4.0])
    assert [words[1] for words in s.prepared] == ["b.csv"]


def test_a_file_says_what_it_is_worth_and_a_model_is_made_for_it(identified):
    """The verdict on the card is the one in the file; a URDF that errs more is made of a
    model that was identified without what it cannot hold, as its card says."""
    s = identified
    do(s, lambda: s.add("joint_spring:1"))
    model, record = s.current, s.current.exported["robot.urdf"]
    assert "joint spring" in record["lost"]
    assert not record["model"]  # it errs no more than the model
    do(s, lambda: s.add("presliding_hysteresis:1"))
    poor, record = s.current, s.current.exported["robot.urdf"]
    assert record["model"]
    made_of = load_estimate(poor.model_of("robot.urdf"))
    lost = {"joint_spring", "presliding_hysteresis"}
    assert lost.isdisjoint(effect.name for effect in made_of.model.effects)
    screen = Screen(s)
    screen.view.download = lambda name: None
    text = screen.text("take-away")
    assert sentence(poor.verdict_on("robot.urdf").grade) in text
    assert poor.facts["grades"].text in text
    assert "Fitted without" in text
    assert not any(line.startswith("sdp-vs-penalty export") for line in s.commands())
    screen.click("take-robot.urdf")
    assert any("--out robot.urdf --refit --data" in line for line in s.commands())
    verdict = poor.verdict_on("robot.urdf").brief()
    assert verdict in (s.folder / "robot.urdf").read_text()
    # A diagnosis of the model is no sentence about a file that lacks some of it.
    do(s, s.diagnose)
    diagnosed, record = s.current, s.current.exported["robot.urdf"]
    of_file = diagnosed.verdict_on("robot.urdf").brief()
    assert diagnosed.findings.headline not in of_file
    assert record["loss"].replace("→", "->") in of_file
    assert record["losses"] in diagnosed.lesser_files(["robot.urdf"])
    assert f"errs more: {record['losses']}." in Screen(s).text("take-away")
    good = {"size": 0.0, "error": "within noise"}
    poor = replace(model, factory=good, errors={**model.errors, "size": 1.0})
    s.history = [*s.history[:-1], poor]
    text = Screen(s).text("take-away")
    for name in ("model.h", "robot.urdf"):  # a badge has the grade that the file says
        grade = sentence(poor.verdict_on(name).grade)
        error = (poor.exported.get(name) or poor.errors)["error"]
        card = text.partition(f"{name} ")[2]
        assert card.startswith(f"{grade}, {error}")
        assert "Worse than the robot's own file as it came (within noise)." in card


def test_a_file_is_made_beside_a_job_and_once(here, identified, monkeypatch):
    s = identified
    asked, given = [], []
    run = here.pool.run

    async def count(request, *rest, **how):
        asked.append(request["job"])
        return await run(request, *rest, **how)

    monkeypatch.setattr(here.pool, "run", count)

    async def download_twice():
        s.start(s.ask, "Finding the ranges", "ranges")
        s.download("model.h", given.append)
        await asyncio.wait([s.task, *s.making])
        s.download("model.h", given.append)

    asyncio.run(download_twice())
    assert given == ["model.h", "model.h"]
    assert sorted(asked) == ["ranges", "take"]


@pytest.mark.parametrize("is_answered", [True, False])
def test_a_new_run_in_another_unit_waits_for_its_unit(
    identified, hidden, tmp_path, monkeypatch, is_answered
):
    """The model is tested on it once the unit is said, or it is left as it is."""
    s = identified
    gains = [
        make_explanation(
            *("torque gain", ""),
            remedy="",
            joints=[j],
            is_gain=True,
            run="new.csv",
            size=-0.9,
        )
        for j in (0, 1)
    ]
    found = with_one_unit("new.csv", gains, 2)
    by_cause = property(lambda report: found if report.run == "new.csv" else ())
    monkeypatch.setattr("sdp_vs_penalty.checks.report.Report.by_cause", by_cause)
    s.arrived |= saved(tmp_path, hidden.runs[2:], "new.csv")
    do(s, s.read_files)
    assert s.runs[-1]["use"] == "wait"
    screen = Screen(s)
    assert "new.csv only: the torques of joints 1 and 2" in screen.text("next")
    (key,) = (x for x in screen.keys if x.endswith("-as-is"))
    if is_answered:
        screen.set(key.replace("as-is", "unit"), "mNm")
        key = key.removesuffix("-as-is")
    screen.click(key)
    assert s.runs[-1]["use"] == "test"
    assert s.current.judged_on == ["test.csv", s.runs[-1]["name"]]


def test_a_computed_torque_beside_a_measured_one_is_known(tmp_path):
    """By its smoothness, where columns have no names; the measured one is taken as it
    is."""
    t = np.linspace(0.0, 10.0, 1000)
    smooth = np.sin(np.outer(t, [1.0, 2.0]))
    rough = smooth + 0.1 * np.random.default_rng(0).standard_normal(smooth.shape)
    table = np.column_stack([t, smooth, smooth, rough])
    np.savetxt(file := tmp_path / "log.csv", table, delimiter=",")
    names = [f"#{k}" for k in range(1, 8)]
    begin = "t=#1,q1=#2,q2=#3,"
    said = jobs._rougher_block(file, f"{begin}tau1=#4,tau2=#5", names)
    assert said == "columns #6 to #7"
    assert jobs._rougher_block(file, f"{begin}tau1=#6,tau2=#7", names) == ""
    assert jobs._rougher_block(file, "", names) == ""


def test_a_press_reads_the_measured_torque_in_place_of_a_computed_one(here, hidden):
    """It leads before all other issues, which are those of a torque that goes."""
    run = hidden.runs[0].rows(slice(None, None, 4))
    spread = np.std(run.tau, axis=0)
    noise = 0.05 * spread * np.random.default_rng(0).standard_normal(run.tau.shape)
    window = np.hanning(41) / np.sum(np.hanning(41))
    smooth = np.apply_along_axis(np.convolve, 0, run.tau, window, "same")
    dq = np.gradient(run.q, run.t, axis=0)
    table = np.column_stack([run.t, run.q, dq, smooth, run.tau + noise, 2.0 * smooth])
    screen = with_tables(here, a=table)
    s = screen.session
    screen.click(next(key for key in blocks_of(screen) if "#6 to #7" in key))
    assert "computed by a controller" in screen.text("next")
    assert screen.at("next").text == "Read columns 8 to 9 instead"
    assert "Read columns 8 to 9 instead" in screen.text("check")
    screen.click("next")
    (stored,) = s.runs
    read = s.arrays(stored["file"])["tau1"]
    np.testing.assert_allclose(read, table[:, 7], rtol=1e-6)
    assert "computed by a controller" not in screen.text("next")


@pytest.fixture
def in_amperes(here, tmp_path):
    """Runs in which currents of unequal drives stand for torques, and their gains."""
    urdf = write_urdf(tmp_path / "arm.urdf", "arm", THREE)
    arm = load_problem(urdf).with_gravity((0.0, 0.0, -9.81))
    gains = np.array([9.0, 9.0, 7.0])
    made = [small_run(arm, 20.0, seed, 200.0) for seed in (1, 2)]
    runs = [replace(run, tau=run.tau / gains) for run in made]
    files = saved(tmp_path, runs, "a.csv", "test.csv")
    return opened(here, str(urdf), **files), gains


def test_currents_become_torques_by_one_click(in_amperes):
    """By gains that fit the robot's masses, which the terminal and Check offer too; what a
    person knows of the drives comes first."""
    session, gains = in_amperes
    screen = Screen(session)
    assert "Say the unit, or the drive gains" in screen.text("next")
    (offered,) = (
        remedy.change.arguments
        for remedy in session.remedies
        if remedy.change.arguments.get("by_size")
    )
    factors = offered["scale"]["tau"].split(":")
    numbers = f"{factors[0]}, {factors[1]} and {factors[2]} N m per A"
    guess = f"multiply the torque by {numbers} (estimated from the robot's masses)"
    assert f"I do not know them: {guess}" in screen.text("next")
    assert "9 N m per A, one for all joints but joint 3 (7," in screen.text("check")
    gains_field = next(k for k in screen.keys if k.endswith("-gains"))
    example = f"e.g. {', '.join(factors)}"
    assert screen.at(gains_field).props["placeholder"] == example
    screen.click("next-other")
    (change,) = (change for _, _, change in session.repairs)
    taken = [float(x) for x in change["arguments"]["scale"]["tau"].split(":")]
    np.testing.assert_allclose(taken, gains, rtol=0.05)
    assert not session.is_unit_open
    for part in ("check", "next"):
        assert numbers in screen.text(part)
    gains_field = next(k for k in screen.keys if k.endswith("-gains"))
    assert screen.at(gains_field).props["placeholder"] == example
    assert next_step(screen.view).label == "Identify the model"
    do(session, session.identify)
    for part in ("next", "take-away"):
        assert guess in screen.text(part)
    # What was done stands in all that is taken away.
    screen.view.download = lambda name: None
    for name in ("model.json", "model.h", "robot.urdf", "report.html"):
        screen.click(f"take-{name}")
        assert numbers in (session.folder / name).read_text(), name


def test_a_wrong_list_of_gains_stays_and_says_what_is_wrong_before_a_job(in_amperes):
    """It was thrown away, and a job answered in the words of the terminal; Enter did
    nothing. Bar and button say the same, and the form has one button that stands out."""
    session, _ = in_amperes
    screen = Screen(session)
    field = next(k for k in screen.keys if k.endswith("-gains"))
    button = field.removesuffix("-gains")
    assert screen.at(button).text == NAME_UNIT == next_step(screen.view).label
    assert "quiet" in screen.at(f"{button}-as-is").classes

    def type_and_enter(typed):
        screen.hear(screen.at(field), "keydown", typed)

    for typed, wrong in (
        ("", "Type the gains, or choose a unit."),
        ("9, 9", "2 of 3 gains: joint 3 is missing."),
        ("9, 9, x7", "Gain 3 is “x7”: type a number but zero."),
    ):
        type_and_enter(typed)
        assert wrong in screen.text("check")
        assert not session.repairs
        assert session.notice is None
        session.changed()
        assert session.unit_forms[session.robot_word, "tau"].gains == typed
    type_and_enter("9 9 7")
    (change,) = (change for _, _, change in session.repairs)
    assert change["arguments"]["scale"] == {"tau": "9:9:7"}


def test_published_gains_are_offered_to_a_namesake_with_their_owner(in_amperes):
    """Not filled in: another arm of that name has drives of its own."""
    session, _ = in_amperes
    assert session.gains_of_namesake == ("", [])
    session.robot |= {"name": "ur10e_robot", "n": 6}
    owner, gains = session.gains_of_namesake
    assert (owner, gains[:3]) == ("Universal Robots UR10e", ["10", "10.7", "8.46"])
    assert session.published_gains == []
    session.robot |= {"n": 7}
    assert session.gains_of_namesake == ("", [])


@pytest.mark.long
def test_a_model_within_its_noise_by_gains_of_the_masses_is_used(in_amperes):
    """No motion settles the unit: the line said that no effect explains an error of 1.08
    times the noise, and asked for a motion to record without end; then for the unit, which
    the person had answered."""
    session, _ = in_amperes
    screen = Screen(session)
    screen.click("next-other")
    do(session, session.identify)
    do(session, session.diagnose)
    while session.current.verdict.is_something_missing:
        change = next_remedy(session.findings.remedies).change
        do(session, lambda change=change: session.apply(change.to_dict()))
        do(session, session.diagnose)
    assert session.current.verdict.is_lowered_by_log_alone
    step = next_step(screen.view)
    assert step.label == "Download the report"
    assert step.other.label == "Or say the unit, or the drive gains"
    assert "masses of the robot file" in f"{step.text} {step.number}"
    assert "explain" not in step.text


def test_gains_by_size_are_doubted_until_they_are_typed(in_amperes):
    """Check was green with them: nothing wrong in 2 runs."""
    session, gains = in_amperes
    screen = Screen(session)
    doubt = "N m are no surer than the masses of the robot file (multiplied by "
    assert doubt not in screen.text("check")
    screen.click("next-other")
    assert (checked(session).level, next_step(screen.view).level) == (
        "usable",
        "usable",
    )
    assert checked(session).text.startswith(f"a.csv and test.csv: {doubt}")
    assert doubt in screen.text("check")
    assert doubt in screen.text("next")
    do(session, session.identify)
    in_brief = doubt.partition(" (")[0].replace(" are", ",")
    for add in (None, "joint_spring:1"):  # what is added makes nothing surer
        if add:
            do(session, lambda text=add: session.add(text))
        assert in_brief in screen.text("next")
        assert next_step(screen.view).level != "good"
        model = load_estimate(session.current.file)
        assert in_brief in str(model.provenance["verdict"])
    typed = {"scale": {"tau": ":".join(map(str, gains))}}
    change = {"verb": "read", "words": "read tau by its gains", "arguments": typed}
    do(session, lambda: session.read_in_unit(change))
    assert len(session.repairs) == 1
    assert doubt not in screen.text("check")
    assert doubt not in screen.text("next")
    assert in_brief not in screen.text("next")
    assert checked(session).level == "good"


def test_torques_without_units_are_nowhere_in_newton_metres(in_amperes):
    """And the doubt stays in the line, with the way to settle it."""
    session, _ = in_amperes
    do(session, session.identify_without_units)
    screen = Screen(session)
    assert load_estimate(session.current.file).torque_units == ("raw units",) * 3
    assert "raw units" in screen.text("fit")
    assert "N m" not in screen.text("fit")
    assert "N m" not in screen.text("next")
    assert "the torques' unit" in screen.text("next").lower()
    assert "Or say the unit, or the drive gains" in screen.text("next")
    do(session, session.diagnose)
    assert "joint 3 has another drive gain" in screen.text("findings").lower()
    assert "N m" not in screen.text("findings")
    assert "N m" not in screen.text("next")
    assert "the torques' unit" in screen.text("next").lower()


def test_a_removed_run_leaves_the_page_where_it_is(here, hidden, tmp_path):
    """The notice has the button that brings it back, and the chart shows a run that the
    bars are of."""
    names = ("a.csv", "b.csv", "test.csv")
    s = opened(here, "two_link", **saved(tmp_path, hidden.runs[:3], *names))
    do(s, s.identify)
    screen = Screen(s)
    screen.view.run = "a.csv"
    s.new = before = ("measure", "runs")
    do(s, lambda: s.use(s.runs[2]["file"], ""))
    assert s.new is before
    assert len(s.runs) == 2
    screen.click("undo-notice")
    assert len(s.runs) == 3
    screen.view.look_at_worst_joint()
    assert screen.view.run in s.current.judged_on
