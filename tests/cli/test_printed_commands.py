"""Every command that a verb or the page prints is run as printed, on arms of every
kind."""

import importlib.util
import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import HEAVY, SCARA, write_folder, write_urdf
from commands import run_cli
from numpy.testing import assert_allclose, assert_array_equal
from page_sessions import do
from small_runs import small_run, write_run

from sdp_vs_penalty import load_estimate, load_measurements, load_problem
from sdp_vs_penalty.cli.next_step import free_name
from sdp_vs_penalty.data import save
from sdp_vs_penalty.diagnosis import Diagnosis, Finding, Invisible
from sdp_vs_penalty.diagnosis.diagnose import diagnose
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.estimation import separation
from sdp_vs_penalty.robot import ConstraintSet
from sdp_vs_penalty.simulation import hidden_runs

PROGRAM = "sdp-vs-penalty"
#: What `diagnose` calls to search for effects.
SEARCH = "sdp_vs_penalty.api.diagnosis.find_missing_effects"


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run a line, in an empty folder, then every command that it prints; what it
    printed itself."""
    monkeypatch.chdir(tmp_path)
    search = separation.separate  # that a motion is found, not how good a one
    monkeypatch.setattr(
        separation, "separate", lambda *a, **b: search(*a, **{**b, "iterations": 4})
    )
    monkeypatch.setattr(separation, "_DRAWN", 4)
    reported = set()

    def call(line):
        program, *words = shlex.split(line)
        assert program == PROGRAM
        code = run_cli(*words)
        out, err = capsys.readouterr()
        allowed = (
            (0, 1) if words[0] == "check" else (0,)
        )  # 1: a check that found errors
        assert code in allowed, f"{line}\n{out}{err}"
        assert not re.search(r"\bNone\b(?! of)|\bnan\b", out), f"{line}\n{out}"
        for command in printed(out + err):
            # The diagnosis that `identify` prints is run where `compare` prints it.
            if words[0] != "identify" and not again(command):
                call(command)
        return out

    def again(command):
        """Whether a report was made that differs in the name of its last model's file
        alone."""
        verb, *words = shlex.split(command)[1:]
        if verb != "report":
            return False
        if importlib.util.find_spec("plotly") is None:
            return True  # the report is an extra
        models = words[: words.index("--data")]
        form = (*models[:-1], *words[len(models) :])
        known = form in reported
        reported.add(form)
        assert all(Path(model).exists() for model in models)
        return known

    return call


def printed(text):
    """The commands of a text: at the start of a line or after a colon, up to the line's
    end."""
    return re.findall(rf"(?:^|: )({PROGRAM} [a-z-]+ .*)$", text, re.MULTILINE)


def robot(kind, folder):
    """What identifies a robot of a kind on the command line; its files are in the
    folder."""
    if kind == "URDF named two_link":
        return write_urdf(folder / "my arm.urdf", "two_link", HEAVY).name
    if kind == "folder":
        return write_folder(folder / "my folder").name
    return (
        write_urdf(folder / "scara.urdf", "scara", SCARA).name
        if kind == "SCARA"
        else kind
    )


#: Arms, and whether what they miss is searched for (in half a minute) or told.
KINDS = [
    pytest.param("folder", False, marks=pytest.mark.long),
    *(
        pytest.param(kind, True, marks=pytest.mark.slow)
        for kind in ("URDF named two_link", "panda", "folder", "SCARA")
    ),
]


@pytest.mark.parametrize(("kind", "searched"), KINDS)
def test_from_simulated_runs_to_a_model_with_what_was_missing(
    kind, searched, run, tmp_path, monkeypatch
):
    """simulate prints identify; diagnose prints add, as text and from its file, which
    do the same."""
    source = robot(kind, tmp_path)
    found = []
    if not searched:
        found.append(told(load_problem(source), ["joint_spring:2"]))
        # So long that motions repeat: beside its noise joint 1 errs by no more.
        monkeypatch.setattr(hidden_runs, "DURATION", 14.0)

    searched_in = {}

    def diagnosed(*given, **options):
        """The same runs are searched once at most."""
        if found:
            return found[0]
        runs = tuple(str(getattr(g, "data_hash", "")) for g in given)
        if runs not in searched_in:
            searched_in[runs] = diagnose(*given, **options)
        return searched_in[runs]

    monkeypatch.setattr(SEARCH, diagnosed)
    quoted = shlex.quote(source)
    out = run(
        f"{PROGRAM} simulate {quoted} --hide joint_spring:2 --seed 7 --out 'my runs'"
    )
    assert len(printed(out)) == 1
    run(f"{PROGRAM} check {quoted} --data 'my runs/run1.csv'")
    run(f"{PROGRAM} compare model.json --data 'my runs/test.csv'")
    data = "--data 'my runs/run1.csv' 'my runs/run2.csv' --test 'my runs/test.csv'"
    *tell, as_text = printed(out := run(f"{PROGRAM} diagnose model.json {data}"))
    assert re.search(r"\+ 1\b", out)  # the error with the first finding
    assert all(" excite " in command for command in tell)
    *_, from_file = printed(
        run(f"{PROGRAM} diagnose model.json {data} --json 'the findings.json'")
    )
    assert " joint_spring:2" in as_text
    assert "--from 'the findings.json'" in from_file
    written = [shlex.split(command)[-1] for command in (as_text, from_file)]
    before, text, file = (
        load_estimate(Path(name)) for name in ("model.json", *written)
    )
    assert_array_equal(text.theta, file.theta)
    assert len(text.theta) > len(before.theta)
    bounds = load_problem(source).constraints(text.model)
    assert ConstraintSet(bounds.convex).margin(text.theta) >= 0.0


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param("two_link", marks=pytest.mark.long),
        pytest.param("folder", marks=pytest.mark.slow),
    ],
)
def test_the_check_repairs_what_it_says(kind, run, tmp_path):
    """One run, and two, with a torque's sign flipped: the copies that it offers to
    write are clean."""
    source = robot(kind, tmp_path)
    problem = load_problem(source)
    for k in (1, 2):
        made = small_run(problem, 20.0, k)
        signs = np.where(np.arange(made.n) == 1, -1.0, 1.0)
        save(replace(made, tau=made.tau * signs), tmp_path / f"my run{k}.csv")
    check = f"{PROGRAM} check {shlex.quote(source)} --gravity 0,0,-9.81 --data"
    (one,) = printed(run(f"{check} 'my run1.csv'"))
    (both,) = printed(run(f"{check} 'my run1.csv' 'my run2.csv'"))
    assert " --gravity 0,0,-9.81 --fix " in one
    assert " --gravity 0,0,-9.81 --fix " in both
    for copies in ("'my run1_fixed.csv'", "'fixed/my run1.csv' 'fixed/my run2.csv'"):
        # The last of several is kept to judge.
        trained = copies.removesuffix(" 'fixed/my run2.csv'")
        new = free_name("model.json")  # earlier commands have written models beside it
        (then,) = printed(run(f"{check} {copies}"))
        assert (
            then
            == f"{PROGRAM} identify {shlex.quote(source)} --data {trained} "
            + f"--gravity 0,0,-9.81 --out {new}"
        )


#: Effects of both joints of the 2R, each found.
FOUR = [
    *(f"presliding_hysteresis:{j}@d=0.00312345" for j in (1, 2)),
    *(f"joint_spring:{j}" for j in (1, 2)),
]
#: Effects of the Panda's joints, each found.
TWELVE = [f"presliding_hysteresis:{j}@d=0.00312345" for j in range(1, 8)]
TWELVE += [f"joint_spring:{j}" for j in range(1, 6)]


def told(problem, texts, frozen=False):
    """A diagnosis that found these effects, each on one joint."""
    n = problem.robot.n

    def finding(text):
        name, _, rest = text.partition(":")
        return Finding(
            name,
            (int(rest[0]),),
            {},
            1.0,
            "N*m",
            0.1,
            {},
            (),
            int(rest[0]),
            f"{name} on a joint. As it is.",
            text,
            0.5,
        )

    found = tuple(map(finding, texts))
    return Diagnosis(
        "effect_missing",
        found,
        np.ones(n),
        (),
        "residual",
        np.zeros(n),
        8.0,
        (),
        np.ones(n),
        "folds",
        frozen,
    )


@pytest.fixture
def twelve_found(panda, tmp_path, monkeypatch):
    """What every diagnosis says; a model.json and a run.csv of the Panda beside it."""
    write_run(tmp_path / "run.csv", panda)
    found = told(panda, TWELVE)
    monkeypatch.setattr(SEARCH, lambda *_, **__: found)
    return found


@pytest.mark.long
def test_what_a_held_model_misses_is_added_to_it_held(twelve_found, run, panda):
    run(f"{PROGRAM} identify panda --data run.csv --method ols --out model.json")
    (Path("held.json")).write_text(
        json.dumps(told(panda, TWELVE, frozen=True).to_dict())
    )
    run(
        f"{PROGRAM} add model.json --from held.json --only 8,9 --data run.csv --out"
        " model2.json"
    )
    before = load_estimate(Path("model.json"))
    after = load_estimate(Path("model2.json"))
    assert_array_equal(after.theta[: len(before.theta)], before.theta)
    assert after.certificate.held == [e.text for e in before.model.effects]


@pytest.mark.long
def test_weak_findings_at_the_end_are_shown_to_who_asks(
    two_link, run, tmp_path, monkeypatch
):
    write_run(tmp_path / "run.csv", two_link)
    found = told(two_link, FOUR)
    monkeypatch.setattr(SEARCH, lambda *_, **__: found)
    run(f"{PROGRAM} identify two_link --data run.csv --method ols --out model.json")
    first, *rest = found.effects
    weak = (first, *(replace(f, doubts=(Doubt("small"),)) for f in rest))
    invisible = tuple(
        Invisible(name, (j,), 0.9) for name, j in (("payload", 1), ("payload", 2))
    )
    made = replace(found, effects=weak, invisible=invisible)
    monkeypatch.setattr("sdp_vs_penalty.api.diagnose", lambda *_, **__: made)
    few = run(f"{PROGRAM} diagnose model.json --data run.csv")
    every = run(f"{PROGRAM} diagnose model.json --data run.csv --verbose")
    assert [int(k) for k in re.findall(r"^\+ (\d+)\.", few, re.MULTILINE)] == [1, 2, 3]
    assert [int(k) for k in re.findall(r"^\+ (\d+)\.", every, re.MULTILINE)] == [
        1,
        2,
        3,
        4,
    ]
    assert "further weak candidates" in few
    assert "further weak candidates" not in every
    assert (
        f"add model.json {first.text} --data run.csv" in few
    )  # what helps, and no more
    assert len(re.findall(r"^\+ \d+\. weak", few, re.MULTILINE)) == 2
    assert "payload on joints 1 and 2" in " ".join(few.split())
    assert "not known" in few


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["one run, split", "simulated"])
def test_the_pages_commands_make_the_pages_models(kind, sessions, run, tmp_path):
    """A URDF that is called like a built-in robot; the same models to the last bit."""
    path = write_urdf(tmp_path / "my arm.urdf", "two_link", HEAVY)
    save(small_run(load_problem(path), seconds=20.0), tmp_path / "my run.csv")
    s = sessions.new()
    do(s, lambda: s.choose_robot(str(path), path.name))
    if kind == "simulated":
        do(s, lambda: s.simulate("joint_spring", [2], "strong", 7))
    else:
        s.arrived["my run.csv"] = tmp_path / "my run.csv"
        do(s, s.read_files)
        assert [r["use"] for r in s.runs] == ["split"]
    do(s, s.identify, lambda: s.add("joint_spring:2"), lambda: s.add("joint_spring:1"))
    commands = s.commands()
    made = ["identify", "add", "add", "compare"]
    assert [shlex.split(c)[1] for c in commands][-4:] == made
    for command in commands:
        run(command)
    for k, model in enumerate(s.history, start=1):
        theirs = load_estimate(model.file)
        ours = load_estimate(tmp_path / f"model{k}.json")
        assert_array_equal(ours.theta, theirs.theta)
        # But for how the path of the URDF is written.
        problems = [x.to_dict()["problem"] | {"source": ""} for x in (ours, theirs)]
        assert problems[0] == problems[1]


@pytest.mark.parametrize(("factor", "is_named"), [(1e3, True), (7.0, False)])
def test_torques_in_another_unit_are_mended_before_anything_is_identified(
    tmp_path, capsys, factor, is_named
):
    """A log in mN m was followed by `identify`, whose links weighed 1000 times as much."""
    urdf = write_urdf(tmp_path / "arm.urdf", "arm", HEAVY)
    problem = load_problem(urdf)
    true = replace(small_run(problem, seconds=8.0), dq=None)
    path = tmp_path / "run.csv"
    save(replace(true, tau=factor * true.tau), path)
    assert run_cli("check", str(urdf), "--data", str(path)) == 0
    out = capsys.readouterr().out
    assert "torque unit" in out
    assert "identify" not in out
    if not is_named:
        assert f"convert {path} --scale tau=UNIT --out" in " ".join(out.split())
        return
    (line,) = re.findall(f"^Next: {PROGRAM} (.*)$", out, re.MULTILINE)
    words = shlex.split(line)
    assert words[-2:] == ["--apply", "unit:tau"]
    assert run_cli(*words) == 0
    fixed = load_measurements(words[words.index("--fix") + 1])
    assert_allclose(fixed.tau, true.tau, rtol=1e-9, atol=1e-9)
