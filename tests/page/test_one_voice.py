"""One result, one number: terminal, JSON, page and report say the same of it.

Each story goes from the same files through the commands, through the page and into a
report; every fact that several of them show is compared as it is printed.
"""

import html
import json
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from commands import run_cli
from page_sessions import Here, Screen

pytest.importorskip("nicegui", reason="the page needs the extra [page]")
pytest.importorskip("plotly", reason="the report needs the extra [report]")

from sdp_vs_penalty import Problem, compare, load_estimate, load_measurements
from sdp_vs_penalty.data import save
from sdp_vs_penalty.diagnosis import load_diagnosis
from sdp_vs_penalty.estimation import changes
from sdp_vs_penalty.formatting import number
from sdp_vs_penalty.page import Sessions
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs

NAMES = ("a.csv", "b.csv", "test.csv")
#: Of each run: enough to be sure of what is hidden.
SECONDS = 12.0
#: What is hidden in each story.
STORIES = {
    "nothing": [],
    "a spring": [("joint_spring", [1])],
    "gears that bend": [("presliding_hysteresis", [0])],
}


def plain(text: str) -> str:
    """Words of a screen or file, without markup and line breaks."""
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", text)).split())


@pytest.fixture(scope="module", params=STORIES)
def story(
    request: pytest.FixtureRequest,
    two_link: Problem,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[SimpleNamespace]:
    """What each place says of the same runs."""
    folder = tmp_path_factory.mktemp("story")
    runs = hidden_runs(two_link, STORIES[request.param], "strong", 24, len(NAMES)).runs
    files = {name: folder / name for name in NAMES}
    for run, file in zip(runs, files.values(), strict=True):
        save(run.window(0.0, SECONDS), file)
    said = _by_commands(folder, files)
    session, screen = _by_page(files)
    yield SimpleNamespace(folder=folder, said=said, session=session, screen=screen)
    screen.loop.close()


def _by_commands(folder: Path, files: dict[str, Path]) -> dict[str, str]:
    """What each command prints."""
    import contextlib
    import io

    model = folder / "model.json"
    better = folder / "better.json"
    found = folder / "findings.json"
    test = files["test.csv"]
    data = ["--data", files["a.csv"], files["b.csv"]]
    commands: dict[str, list[Any]] = {
        "identify": ["identify", "two_link", *data, "--out", model],
        "diagnose": ["diagnose", model, *data, "--test", test, "--json", found],
        "compare": ["compare", model, "--data", test, "--json", folder / "one.json"],
    }
    added = ["add", model, "--from", found, "--confident", *data, "--test", test]
    said: dict[str, str] = {}

    def run(name: str, words: list[Any]) -> None:
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            assert run_cli(*words) == 0
        said[name] = " ".join(out.getvalue().split())

    for name, words in commands.items():
        run(name, words)
    models = [model]
    if load_diagnosis(found).sure:
        run("add", [*added, "--out", better])
        both = ["compare", model, better, "--data", test]
        run("both", [*both, "--json", folder / "both.json"])
        models.append(better)
    report = folder / "report.html"
    run(
        "report",
        ["report", *models, "--data", test, "--findings", found, "--out", report],
    )
    said["html"] = plain(
        re.sub(r"<(script|style).*?</\1>", "", report.read_text(), flags=re.DOTALL)
    )
    return said


def _by_page(files: dict[str, Path]) -> tuple[Any, Screen]:
    """The same on the page."""
    session = Sessions(Here()).new()
    screen = Screen(session)
    screen.click("robot-two_link")
    session.arrived |= files
    screen.do(session.read_arrived)
    screen.click("identify", "diagnose")
    return session, screen


def errors(floor: np.ndarray, rmse: np.ndarray) -> list[str]:
    """Errors over the noise as a verdict prints them."""
    return [number(x, 2) for x in rmse / floor]


def test_compare_and_page_have_one_noise_floor(story):
    (compared,) = json.loads((story.folder / "one.json").read_text())["models"]
    shown = story.session.history[0].comparison
    assert [number(x) for x in shown["noise_floor"]] == [
        number(x) for x in compared["noise_floor"]
    ]


def test_compare_and_page_have_one_error(story):
    (compared,) = json.loads((story.folder / "one.json").read_text())["models"]
    shown = story.session.history[0].comparison
    assert [number(x) for x in shown["rmse"]] == [number(x) for x in compared["rmse"]]


def test_the_findings_have_the_floor_of_the_comparison(story):
    (compared,) = json.loads((story.folder / "one.json").read_text())["models"]
    found = load_diagnosis(story.folder / "findings.json")
    np.testing.assert_allclose(found.noise_floor, compared["noise_floor"], rtol=1e-9)


def test_add_and_compare_print_the_same_before_and_after(story):
    if "add" not in story.said:
        pytest.skip("nothing was added in this story")
    models = [load_estimate(story.folder / f"{k}.json") for k in ("model", "better")]
    before, after = compare(models, load_measurements(story.folder / "test.csv"))
    told = changes(before.rmse, after.rmse, after.noise_floor)
    assert told in story.said["add"]
    assert told[1:] in story.said["html"]
    assert ", ".join(errors(after.noise_floor, after.rmse)) in story.said["both"]


def test_a_model_alone_has_the_errors_that_it_has_beside_another(story):
    """The floor does not depend on which model is named first."""
    if "add" not in story.said:
        pytest.skip("nothing was added in this story")
    test = load_measurements(story.folder / "test.csv")
    better = load_estimate(story.folder / "better.json")
    model = load_estimate(story.folder / "model.json")
    alone, (_, beside) = compare(better, test), compare([model, better], test)
    np.testing.assert_array_equal(alone[0].noise_floor, beside.noise_floor)


def test_terminal_page_and_report_say_the_same_of_what_is_left(story):
    found = load_diagnosis(story.folder / "findings.json")
    assert found.left_sentence in story.said["diagnose"]
    assert found.left_sentence in story.said["html"]
    assert story.session.findings.left_sentence in story.screen.text("findings")
    assert story.session.findings.left_sentence == found.left_sentence


def test_terminal_page_and_report_say_the_same_is_missing(story):
    found = load_diagnosis(story.folder / "findings.json")
    assert found.headline in story.said["diagnose"]
    assert found.headline in story.said["html"]
    assert found.headline in story.screen.text("diagnose")


def test_sizes_stand_with_the_same_interval_everywhere(story):
    found = load_diagnosis(story.folder / "findings.json")
    shown = story.session.findings
    for finding, there in zip(found.effects, shown.effects, strict=True):
        assert finding.size_text.endswith("(95 %)")
        assert finding.size_text in story.said["html"]
        assert there.size_text in story.screen.text("findings")
        assert there.size_text == finding.size_text


def test_ratings_are_the_same_everywhere(story):
    found = load_diagnosis(story.folder / "findings.json")
    told = json.loads((story.folder / "findings.json").read_text())["effects"]
    assert [f["rating"] for f in told] == [f.rating for f in found.effects]
    for finding in found.effects:
        assert finding.rating in story.screen.text("findings")


def test_identify_says_what_diagnose_has_found(story):
    """The verdict of a diagnosed model names what was found, and sends nobody on."""
    shown = story.session.current.comparison["verdict"]
    (line,) = (line for line in shown["lines"] if line["about"] == "missing")
    assert "names causes" not in line["text"]
