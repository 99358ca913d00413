"""One result, one number: terminal, JSON, page and report say the same of it.

Each story goes from the same files through the commands, through the page and
into a report; every fact that several of them show is compared as it is printed.
"""

import re

import numpy as np
import pytest
import stories

pytest.importorskip("nicegui", reason="the page needs the extra [page]")
pytest.importorskip("plotly", reason="the report needs the extra [report]")

from sdp_vs_penalty import compare, load_estimate, load_measurements
from sdp_vs_penalty.api.remedies import what_to_add
from sdp_vs_penalty.diagnosis.comparison import Comparison
from sdp_vs_penalty.estimation import changes
from sdp_vs_penalty.formatting import number
from sdp_vs_penalty.page.view import in_brief
from sdp_vs_penalty.render.diagnosis_words import errors_left, main_cause
from sdp_vs_penalty.results import Change, fact, facts

#: One effect is added.
STORIES = {"spring": stories.spring}
#: Nothing can be identified, something only passes, nothing lacks to a robot of the
#: user's own, no torque was logged.
LONGER = {
    "bad data": stories.bad_data,
    "hum": stories.hum,
    "own arm": stories.own_arm,
    "servo log": stories.servo_log,
}
#: What is found is of another kind, and is said in the same places.
LONGEST = {"curve": stories.curve, "payload": stories.payload}
REAL = {"UR10e": stories.ur10e}
CASES = [
    *(pytest.param(make, id=name) for name, make in STORIES.items()),
    *(
        pytest.param(make, id=name, marks=pytest.mark.long)
        for name, make in LONGER.items()
    ),
    *(
        pytest.param(make, id=name, marks=pytest.mark.slow)
        for name, make in LONGEST.items()
    ),
    *(
        pytest.param(make, id=name, marks=[pytest.mark.slow, pytest.mark.real_data])
        for name, make in REAL.items()
    ),
]


@fact("N m or N", digits=5, column="this test", per_joint=True)
def largest_error_of_this_test(comparison):
    """(n,) largest error of each joint's torque."""
    return np.abs(comparison.signals.residual).max(axis=0)


@pytest.fixture(scope="module", params=CASES)
def story(request, tmp_path_factory):
    """What each place says of the same runs; the comparison has one more fact."""
    Comparison.largest_error_of_this_test = largest_error_of_this_test
    facts._fact_methods.cache_clear()
    walked = stories.walk(request.param, tmp_path_factory.mktemp("story"))
    yield walked
    walked.screen.loop.close()
    del Comparison.largest_error_of_this_test
    facts._fact_methods.cache_clear()


@pytest.fixture
def modelled(story):
    """A story that came to a model."""
    if story.is_refused:
        pytest.skip("nothing can be identified in this story")
    return story


@pytest.fixture
def diagnosed(modelled):
    """A story that came to a diagnosis."""
    if not (modelled.folder / "findings.json").exists():
        pytest.skip("a log without torque is not diagnosed")
    return modelled


@pytest.fixture
def extended(diagnosed):
    """A story in which something was added."""
    if not (diagnosed.folder / "better.json").exists():
        pytest.skip("nothing was added in this story, or add refused the log")
    return diagnosed


def texts(facts):
    """Facts of a JSON file as they are printed."""
    return {name: fact["texts"] for name, fact in facts.items()}


def test_page_and_terminal_refuse_the_same_runs(story):
    assert bool(story.session.history) != story.is_refused


def test_page_and_terminal_name_the_same_issues(story):
    for checked, run in zip(
        story.json("check.json")["runs"], story.session.runs, strict=True
    ):
        named = [
            (issue["kind"], issue["where"])
            for issue in checked["findings"]
            if issue["severity"] == "error"
        ]
        shown = {(issue.kind, issue.where) for issue in run["findings"]}
        assert set(named) <= shown


def test_every_fact_of_a_comparison_is_the_same_on_the_page(modelled):
    shown = modelled.session.history[0].comparison["facts"]
    assert texts(shown) == texts(modelled.compared["facts"])


def test_every_fact_of_a_diagnosis_is_the_same_on_the_page(diagnosed):
    shown = diagnosed.session.findings
    written = diagnosed.json("findings.json")
    facts = {name: fact.texts for name, fact in shown.facts().items()}
    assert facts == texts(written["facts"])
    ratings = [finding.rating for finding in shown.effects]
    assert ratings == [finding["rating"] for finding in written["effects"]]


def test_a_new_fact_is_one_method_and_stands_everywhere(modelled):
    """Terminal, JSON, report, page and data frame: nothing else knows of it."""
    new = modelled.compared["facts"]["largest_error_of_this_test"]
    last = new
    if (modelled.folder / "both.json").exists():  # the report looks at the last model
        last = modelled.json("both.json")["models"][-1]["facts"][
            "largest_error_of_this_test"
        ]
    for place, shown in (
        (modelled.said["compare"], new),
        (modelled.screen.text("identify"), new),
        (modelled.said["html"], last),
    ):
        assert "this test" in place
        assert all(text in place for text in shown["texts"])
    model = load_estimate(modelled.folder / "model.json")
    (compared,) = compare(
        model, load_measurements(modelled.folder / modelled.names[-1])
    )
    column = compared.to_frame()["largest error of this test [N m or N]"]
    assert [number(x, 5) for x in column] == new["texts"]


#: Facts of the row of a model.
ROW = ("relative_error", "largest_error_over_noise", "thinnest_link")


@pytest.mark.parametrize(
    ("place", "names"), [("compare", ["joint_error"]), ("html", ROW), ("page", ROW)]
)
def test_every_place_prints_the_facts_of_the_first_model(modelled, place, names):
    said = modelled.said | {"page": modelled.screen.text("identify")}
    facts = modelled.compared["facts"]
    for text in (text for name in names for text in facts[name]["texts"]):
        assert text in said[place]


def test_the_grade_is_the_same_everywhere(modelled):
    """Also where a diagnosis has found more: a fit that is good stays good."""
    grade = modelled.compared["verdict"]["grade"]
    assert re.search(rf"\b{grade}\b", modelled.said["compare"], re.IGNORECASE)
    assert modelled.session.history[0].comparison["verdict"]["grade"] == grade
    assert re.search(rf"\b{grade}\b", modelled.said["html"], re.IGNORECASE)


def test_the_table_and_the_verdict_say_the_same_of_the_links(modelled):
    can_exist = modelled.compared["facts"]["links_can_exist"]["value"]
    assert can_exist == modelled.compared["verdict"]["links_are_possible"]


def test_every_stage_of_the_page_has_one_grade(diagnosed):
    grade = diagnosed.session.current.comparison["verdict"]["grade"].capitalize()
    for stage in ("identify", "use"):
        shown = f"{diagnosed.screen.text('next')} {diagnosed.screen.text(stage)}"
        assert re.search(rf"\b{grade}(, not in every file)? ?\. ", shown), stage


def test_the_findings_have_the_floor_of_the_comparison(diagnosed):
    floor = diagnosed.compared["noise_floor"]
    if floor is None:
        pytest.skip("the noise is not known in this story")
    np.testing.assert_allclose(diagnosed.diagnosis.noise_floor, floor, rtol=1e-9)


def test_add_and_compare_print_the_same_before_and_after(extended):
    models = [load_estimate(extended.folder / f"{k}.json") for k in ("model", "better")]
    before, after = compare(models, load_measurements(extended.folder / extended.test))
    units = after.estimate.robot.torque_units
    sentence = changes(before.rmse, after.rmse, after.noise_floor, units)
    assert sentence in extended.said["add"]
    assert sentence[1:] in extended.said["html"]


def test_terminal_report_and_page_say_what_is_missing_and_left(diagnosed):
    """The page has in its bars what is left."""
    found, said = diagnosed.diagnosis, diagnosed.said
    for sentence in (errors_left(found), found.headline):
        assert sentence in said["diagnose"]
        assert sentence in said["html"].replace("`", "")
    next_on_page = diagnosed.screen.text("next")
    if (offer := found.offers.main) is None:
        assert in_brief(main_cause(found)).rstrip(".") in next_on_page
        return
    outcome = found.offers.outcome_of(offer)
    for place in (said["diagnose"], said["html"], next_on_page):
        assert outcome.change_of(outcome.shown(outcome.errs_most)) in place


def test_each_finding_has_one_title_size_and_gain_everywhere(diagnosed):
    from sdp_vs_penalty.render import describe_diagnosis

    diagnosis = diagnosed.diagnosis
    units = load_estimate(diagnosed.folder / "model.json").robot.torque_units
    words = describe_diagnosis(diagnosis, units)
    for finding in words.findings[:1]:
        for text in (finding.title, finding.size_and_constants, finding.gain):
            assert text in diagnosed.said["diagnose"]
        for text, _ in finding.evidence:
            assert text in diagnosed.said["html"]
            assert text in diagnosed.screen.text("findings")
        # The page folds the constants away.
        for text in (finding.title, finding.size, finding.constants, finding.gain):
            assert text in diagnosed.screen.text("findings")


def test_a_finding_has_the_size_and_interval_of_the_model_after_add(extended):
    model = load_estimate(extended.folder / "better.json")
    frame = model.to_frame()
    for finding in extended.json("findings.json")["effects"]:
        if finding["rating"] == "weak" or len(finding["parameters"]) != 1:
            continue
        (name,) = finding["parameters"]
        size = number(finding["parameters"][name], 4)
        assert size == number(frame.loc[name, "value"], 4)
        half = finding["half_width_95"]
        if half is not None:
            own = 1.959964 * frame.loc[name, "std"]
            assert number(half, 2) == number(own, 2)


def test_add_prints_the_size_and_interval_of_the_diagnosis(extended):
    for finding in extended.diagnosis.effects:
        assert finding.size_text.endswith("(95 %)")
        assert (
            finding.rating != "confident" or finding.size_text in extended.said["add"]
        )


def test_the_page_adds_a_finding_with_what_the_search_says_of_it(extended):
    diagnosis = extended.diagnosis
    finding = diagnosis.effects[0]
    texts = [finding.text, "rotor_inertia:1"]
    change = Change("add", "add them", {"effects": texts, "findings": [1]})
    chosen, named = what_to_add(change, diagnosis)
    assert chosen.size_in_search == finding.size_in_search
    assert named == "rotor_inertia:1"


def test_a_model_has_one_interval_of_a_parameter(extended):
    """A base parameter that is one parameter alone has that parameter's interval."""
    model = load_estimate(extended.folder / "better.json")
    base = model.base_frame()
    added = {
        name
        for finding in extended.json("findings.json")["effects"]
        for name in finding["parameters"]
    }
    names = sorted(added & {*base.index})
    standard = model.to_frame().loc[names, "std"]
    np.testing.assert_allclose(base.loc[names, "std"], standard, rtol=1e-9)


def test_identify_says_what_diagnose_has_found(diagnosed):
    """The verdict of a diagnosed model names what was found, and sends nobody on."""
    verdict = diagnosed.session.current.comparison["verdict"]
    (line,) = (line for line in verdict["lines"] if line["about"] == "missing")
    assert "names causes" not in line["text"]


def test_an_extended_model_is_the_same_on_the_page(extended):
    """Adding on the page what the terminal added gives its facts."""
    sure = [f.text for f in extended.session.findings.helpful]
    if len(sure) != 1:
        pytest.skip("the page adds several findings one by one")
    extended.screen.do(extended.session.start, extended.session.add, *sure)
    written = extended.json("both.json")["models"][1]["facts"]
    shown = extended.session.current.comparison["facts"]
    assert texts(shown) == texts(written)
    extended.session.undo()


def test_diagnose_and_compare_print_one_error_of_the_model(diagnosed):
    """What a diagnosis says of the model before anything is added is what `compare`
    says of it."""
    found = diagnosed.diagnosis
    if found.effects or found.retuned or found.curves:
        pytest.skip("something was found in this story")
    facts = found.facts()
    compared = diagnosed.compared["facts"]
    assert facts["left_error"].texts == compared["joint_error"]["texts"]
    assert facts["left_over_noise"].texts == compared["error_over_noise"]["texts"]
