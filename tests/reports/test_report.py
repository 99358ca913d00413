"""The report is one file that asks for nothing and says what it must; tests/page/test_page.py
draws it in a real browser."""

import re
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import run_cli
from numpy.testing import assert_allclose, assert_array_equal
from small_runs import small_run
from unchecked import identify

from sdp_vs_penalty import compare, formatting, report
from sdp_vs_penalty.data import save
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.diagnosis.where_it_fails import Failures, where_it_fails
from sdp_vs_penalty.render import bars
from sdp_vs_penalty.render.arms import half_axes
from sdp_vs_penalty.reports import JudgedRun
from sdp_vs_penalty.signals import FilteredRuns
from sdp_vs_penalty.simulation import experiment
from tests.cli.test_printed_commands import told

pytest.importorskip("plotly")

SECTIONS = (
    "verdict",
    "torques",
    "failures",
    "findings",
    "history",
    "forward",
    "parameters",
    "ranges",
    "arm",
    "friction",
    "certificate",
    "data",
    "provenance",
)


def make_report(*given, **options):
    with tempfile.TemporaryDirectory() as folder:
        report(*given, Path(folder) / "report.html", **options)
        return (Path(folder) / "report.html").read_text()


@pytest.fixture(scope="module")
def made(two_link):
    run = experiment(two_link).training_run(0).rows(slice(None, None, 4))
    models = {
        "bare": identify(two_link, run, "ols", effects="rigid_body"),
        "<script>alert(1)</script>": identify(two_link, run, "lmi-sdp"),
    }
    return (
        models,
        run,
        make_report(models, run, commands=["sdp-vs-penalty report <b>x</b>"]),
    )


def test_one_file_with_every_section_and_no_request(made):
    html = made[2]
    assert tuple(re.findall(r'<section[^>]* id="(.*?)"', html)) == SECTIONS
    text = re.sub(r"<script.*?</script>", "", html, flags=re.DOTALL)
    assert re.findall(r'<a[^>]* href="#(.*?)"', text) == list(SECTIONS)
    assert not re.search(r"<link|\b(src|srcset|data|action)=", text)
    assert "default-src 'none'" in html
    # Text and tables come before the script, which is read for longer than all of them.
    assert html.index('id="provenance"') < html.index("Plotly.newPlot(place")
    assert html.index('id="provenance"') < html.index('id="plotly"')
    assert html.index('class="verdict') < html.index('id="torques"')
    assert len(html) < 2.5e6
    assert 'aria-label=""' not in html
    # Nothing of the user becomes markup.
    assert "<script>alert(1)" not in html
    assert "&lt;script&gt;alert(1)" in html
    assert "<b>x</b>" not in html


def test_the_error_of_a_joint_is_one_number_in_the_whole_report(made):
    """The table of causes shows the errors of the comparison, by which joints are
    judged, and not those of the rows in which causes were searched."""
    models, run, _ = made
    compared = compare(models, run)
    failures = {
        c.name: Failures(
            [replace(f, rmse=2.0 * f.rmse) for f in where_it_fails(c.estimate, run)],
            c.estimate.robot.torque_units,
        )
        for c in compared
    }
    html = make_report(models, run, failures=failures)
    causes = re.findall(r'<section[^>]* id="failures".*?</section>', html, re.DOTALL)[0]
    numbers = re.findall(r'<td class="number">(.*?)</td>', causes)
    shown = numbers[::2]  # an error and a noise floor for each joint
    assert shown == [formatting.number(float(error)) for error in compared[-1].rmse]


@pytest.mark.parametrize(
    ("effect", "title"),
    [
        ("viscous_friction", "1 weak finding, added"),
        pytest.param(
            "joint_spring",
            "Not worth adding yet: 1 weak finding",
            marks=pytest.mark.long,
        ),
    ],
)
def test_a_weak_finding_is_either_added_or_not_worth_it(effect, title, made, two_link):
    models, run, _ = made
    found = told(two_link, [f"{effect}:1"])
    doubt = {"doubts": (Doubt("small"),)}
    weak = replace(found, effects=(replace(found.effects[0], **doubt),))
    html = make_report(models, run, findings=weak)
    assert title in html
    assert ("Not worth adding" in html) != ("are in the model" in html)


def test_nothing_unknown_is_printed_as_python_prints_it(made):
    _, _, html = made
    text = re.sub(r"<(script|style).*?</\1>", " ", html, flags=re.DOTALL)
    assert not re.search(r"(?<!=)\bNone\b(?! of)|\bnan\b", text)


def test_what_is_no_body_has_no_ellipsoid():
    assert half_axes(np.zeros(10)) is None
    assert half_axes(np.array([1.0, 0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.0])) is None  # a rod


def test_the_verb_and_short_runs(made, tmp_path):
    models, run, _ = made
    _, whole = models.values()
    save(run.window(2.0, 3.8), tmp_path / "short.csv")
    whole.save(tmp_path / "model.json")
    model = tmp_path / "model.json"
    data = tmp_path / "short.csv"
    out = tmp_path / "short.html"
    assert run_cli("report", model, "--data", data, "--out", out) == 0
    assert "from the runs that it was identified" in out.read_text()


UNITS = ["N*m", "N*m"]


def test_bars_are_errors_over_noise_cut_at_the_floor():
    drawn = bars([0.1, 1.25], [0.11, 0.46], [0.1, 0.1], UNITS)
    assert re.findall(r"<td class=\"number\">(.*?)</td>", drawn) == [
        "1 → 1.1<small>0.1 → 0.11 N m</small>",
        "12.5 → 4.6<small>1.25 → 0.46 N m</small>",
    ]
    assert re.findall(r'class="change (\w+)">(.*?)<', drawn) == [
        ("worse", "+10 %"),
        ("better", "-63 %"),
    ]
    (floor,) = {
        float(x) for x in re.findall(r'class="noise" style="--wide:([\d.]+)', drawn)
    }
    widest = max(
        float(x) for x in re.findall(r'class="before"[^>]*--wide:([\d.]+)', drawn)
    )
    # Logarithmic, from half of the noise to the largest error.
    assert floor / widest == pytest.approx(np.log(2.0) / np.log(25.0), rel=0.01)
    alone = bars([0.1, 1.25], None, None, UNITS)
    assert "noise unknown" in alone
    assert 'class="noise"' not in alone
    assert "1.25 N m" in alone
    of_torque = bars([0.1, 1.25], None, None, UNITS, torque=np.array([0.5, 25.0]))
    assert "20 %<small>0.1 N m" in of_torque
    assert "% of its torque" in of_torque


def test_a_judged_run_keeps_columns_where_its_band_is_drawn(two_link):
    run = small_run(two_link)
    estimate = identify(two_link, run)
    (filtered,) = FilteredRuns.filtering(run, estimate.preprocessing).runs
    whole = filtered.all_rows(estimate.model)
    judged = JudgedRun.from_run(filtered, estimate)
    assert_array_equal(judged.torque, whole.torque)
    assert_array_equal(judged.motion.t, whole.motion.t)
    for few, every in zip(judged.columns, whole.columns, strict=True):
        assert_array_equal(few.columns, every.columns[judged.shown])
    modelled = [c.columns @ estimate.theta[c.indices] for c in whole.columns]
    assert_allclose(judged.modelled.T, modelled, atol=1e-12)
