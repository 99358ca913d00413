"""Stories: runs of one kind each, from files through commands, page and report."""

import contextlib
import html
import io
import json
import re
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from commands import run_cli
from page_sessions import Here, Screen

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.data import save
from sdp_vs_penalty.diagnosis import load_diagnosis
from sdp_vs_penalty.page import Sessions
from sdp_vs_penalty.problem import measured_runs
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs

NAMES = ("a.csv", "b.csv", "test.csv")
DOCS = Path(__file__).parents[2] / "docs"
#: Of runs of 20 s at 1 kHz every so many samples are kept: stories are to be cheap.
THINNED = 20


@dataclass
class Story:
    """What each place says of the same runs.

    folder : of the files; said : by command what it prints, and "html" of the report;
    screen : the page after the same steps.
    """

    folder: Path
    problem: str
    names: tuple[str, ...]
    said: dict[str, str] = field(default_factory=dict)
    screen: Any = None

    @property
    def session(self):
        """Of the page."""
        return self.screen.session

    @property
    def test(self):
        """The run that models are judged on."""
        return self.names[-1]

    @property
    def is_refused(self):
        """Whether nothing can be identified from the runs."""
        return not (self.folder / "model.json").exists()

    def json(self, name):
        """A JSON file of the folder."""
        return json.loads((self.folder / name).read_text())

    @property
    def compared(self):
        """The comparison of the first model, as `compare --json` writes it."""
        return dict(self.json("one.json")["models"][0])

    @property
    def diagnosis(self):
        """As `diagnose --json` writes it."""
        return load_diagnosis(self.folder / "findings.json")


def plain(text):
    """Words of a screen or file, without markup and line breaks."""
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", text)).split())


def _simulated(problem, effects):
    """Runs with effects hidden; joints from 0."""
    if not effects:
        return list(_without_effects(problem))
    return _thinned_runs(problem, effects)


@cache
def _without_effects(problem):
    """Runs that several stories begin with."""
    return _thinned_runs(problem, [])


def _thinned_runs(problem, effects):
    """Simulated runs at a fifth of the samples."""
    runs = hidden_runs(load_problem(problem), effects, "strong", 24, len(NAMES)).runs
    return [run.rows(slice(None, None, THINNED)) for run in runs]


def _with_torque(runs, extra):
    """Runs with a torque (N,) more on joint 1."""
    changed = []
    for run in runs:
        tau = run.tau.copy()
        tau[:, 0] += extra(run)
        changed.append(replace(run, tau=tau))
    return changed


def spring():
    return "two_link", _simulated("two_link", [("joint_spring", [1])])


def own_arm():
    """A URDF of the docs, with nothing hidden in it."""
    urdf = str(DOCS / "my_arm.urdf")
    return urdf, _simulated(urdf, [])


def curve():
    """A torque over position that no effect of the library makes."""
    runs = _simulated("two_link", [])
    bump = lambda run: 0.4 * np.exp(-(((run.q[:, 0] - 0.3) / 0.25) ** 2))  # noqa: E731
    return "two_link", _with_torque(runs, bump)


def hum():
    """7 Hz on joint 1 for three seconds of every training run."""
    runs = _simulated("two_link", [])

    def wave(run):
        since = run.t - run.t[0]
        return 0.3 * np.sin(2.0 * np.pi * 7.0 * since) * ((since > 8) & (since < 11))

    return "two_link", [*_with_torque(runs[:-1], wave), runs[-1]]


def payload():
    """The last run carries something that the others do not."""
    free = _simulated("two_link", [])
    loaded = _simulated("two_link", [("payload", [])])
    return "two_link", [*free[:-1], loaded[-1]]


def bad_data():
    """Spikes in the torque: nothing can be identified."""
    runs = _simulated("two_link", [])

    def spikes(run):
        return np.where(np.arange(len(run.t)) % 900 == 500, 1e4, 0.0)

    return "two_link", _with_torque(runs, spikes)


def servo_log():
    """Commands and positions of a slide, without a torque."""
    import servo_log as slide

    runs = [slide.log(noise=1e-5, seed=seed).window(0.0, 10.0) for seed in range(3)]
    return slide.URDF, runs


def ur10e():
    """Three real runs of motor currents."""
    runs = measured_runs("ur10e")
    names = ("14harm50sec", "15harm50sec", "12-50sec_12harm")
    chosen = [next(r for k, r in runs.items() if k.endswith(name)) for name in names]
    return "ur10e", [run.rows(slice(None, None, 4)) for run in chosen]


def by_commands(story):
    """What each command prints, until one refuses."""
    folder = story.folder
    model = folder / "model.json"
    better = folder / "better.json"
    found = folder / "findings.json"
    report = folder / "report.html"
    files = [folder / name for name in story.names]
    data = ["--data", *files[:-1]]
    test = files[-1]

    def run(name, *words):
        out = io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
            code = run_cli(*words)
        story.said[name] = " ".join(out.getvalue().split())
        return code == 0

    checked = ["--data", *files, "--json", folder / "check.json"]
    run("check", "check", story.problem, *checked)
    if not run("identify", "identify", story.problem, *data, "--out", model):
        return
    run("diagnose", "diagnose", model, *data, "--test", test, "--json", found)
    compared = ["--data", test, "--json"]
    run("compare", "compare", model, *compared, folder / "one.json")
    models = [model]
    if found.exists() and load_diagnosis(found).helpful:
        added = ["--from", found, "--helpful", *data, "--test", test]
        if run("add", "add", model, *added, "--out", better):
            run("both", "compare", model, better, *compared, folder / "both.json")
            models.append(better)
    findings = ["--findings", found] if found.exists() else []
    run("report", "report", *models, "--data", test, *findings, "--out", report)
    assert report.exists(), story.said["report"]
    text = re.sub(r"<(script|style).*?</\1>", "", report.read_text(), flags=re.DOTALL)
    story.said["html"] = plain(text)


def by_page(story):
    """The same on the page."""
    session = Sessions(Here()).new()
    story.screen = Screen(session)
    name = Path(story.problem).name if ".urdf" in story.problem else None
    story.screen.do(session.start, session.choose_robot, story.problem, name)
    session.arrived |= {name: story.folder / name for name in story.names}
    story.screen.do(session.read_arrived)
    if session.meaningless:
        return
    story.screen.click("identify", "diagnose")


def walk(make, folder):
    """A story from its runs to what every place says of them."""
    problem, runs = make()
    if problem.startswith("<robot"):
        (folder / "robot.urdf").write_text(problem)
        problem = str(folder / "robot.urdf")
    for run, name in zip(runs, NAMES, strict=True):
        save(run, folder / name)
    story = Story(folder=folder, problem=problem, names=NAMES)
    by_commands(story)
    by_page(story)
    return story
