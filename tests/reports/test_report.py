"""The report is one file that asks for nothing, says what it must, and draws in a real browser."""

import base64
import gzip
import json
import re
import tempfile
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run_cli
from page_sessions import numbers
from small_runs import small_run

from sdp_vs_penalty import Estimate, Measurements, Problem, compare, follow, report
from sdp_vs_penalty.data import save
from sdp_vs_penalty.diagnosis import Curve, Diagnosis
from sdp_vs_penalty.diagnosis.comparison import identify  # without the check
from sdp_vs_penalty.formatting import number
from sdp_vs_penalty.reports.markup import bars
from sdp_vs_penalty.reports.sections import ellipsoid
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.simulation import experiment

pytest.importorskip("plotly")

SECTIONS = (
    "verdict",
    "torques",
    "failures",
    "findings",
    "history",
    "forward",
    "parameters",
    "arm",
    "friction",
    "certificate",
    "data",
    "provenance",
)


def make_report(*given: Any, **options: Any) -> str:
    with tempfile.TemporaryDirectory() as folder:
        report(*given, Path(folder) / "report.html", **options)
        return (Path(folder) / "report.html").read_text()


@pytest.fixture(scope="module")
def made(two_link: Problem) -> tuple[dict[str, Estimate], Measurements, str]:
    run = experiment(two_link).training_run(0)
    models = {
        "bare": identify(two_link, run, "ols", effects="rigid_body"),
        "<script>alert(1)</script>": identify(two_link, run, "lmi-sdp"),
    }
    return models, run, make_report(models, run, commands=["sdp-vs-penalty report <b>x</b>"])


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


def figures_of(html: str) -> list[str]:
    """What the figures hold, unpacked."""
    found = re.findall(r'<script type="application/gzip">(.*?)</script>', html)
    return [gzip.decompress(base64.b64decode(text)).decode() for text in found]


def test_curves_of_figures_are_whole_and_bands_lie_about_them(made):
    bands = 0
    for drawn in figures_of(made[2]):
        flat = [trace for trace in json.loads(drawn)["data"] if trace["type"] == "scatter"]
        for before, trace in pairwise(flat):
            y = numbers(trace["y"])
            assert len(y) == len(numbers(trace["x"])) > 1
            if trace.get("fill") == "tonexty":
                bands += 1
                assert np.all(numbers(before["y"]) > y)
    assert bands == 2 + 2  # errors and friction of each joint


def test_torques_and_arm_are_drawn_as_they_are(made):
    """Measured, modelled and left torque of each joint; joints and centres of mass in the base."""
    models, run, html = made
    compared = compare(models, run)
    drawn = [json.loads(text) for text in figures_of(html) if text.startswith("{")]
    signals = {c.name: c.signals for c in compared}
    first = next(iter(signals.values()))
    t = first.t - first.t[0]
    for j, figure in enumerate(drawn[:2]):
        layout = figure["layout"]
        titles = [layout[axis]["title"]["text"] for axis in ("xaxis", "yaxis", "xaxis2")]
        assert titles == ["time [s]", f"joint {j + 1} [N m]", "time [s]"]
        flat = [trace for trace in figure["data"] if "name" in trace]
        torques = {name: s.modelled[:, j] for name, s in signals.items()}
        wanted = {"measured": first.measured[:, j], **torques}
        for trace in flat:
            values = wanted[trace["name"]]
            values = first.measured[:, j] - values if trace.get("xaxis") == "x2" else values
            x, y = numbers(trace["x"]), numbers(trace["y"])
            np.testing.assert_allclose(y, np.interp(x, t, values), atol=5e-3)
        assert len(flat) == 1 + 2 * len(models)
    (arm,) = (f for f in drawn if any(trace["type"] == "mesh3d" for trace in f["data"]))
    last = list(models.values())[-1]
    (poses,) = last.robot.poses(last.robot.tree_state(run.q.mean(axis=0))[0])
    balls = [trace for trace in arm["data"] if trace["type"] == "mesh3d"]
    for ball, pose, joint, link in zip(balls, poses, last.robot.tree, last.links, strict=True):
        frame, com = pose @ joint.link_frame, link[1:4] / link[0]
        points = np.array([numbers(ball[c]) for c in "xyz"]).T - frame[:3, 3]
        centred = points @ frame[:3, :3] - com  # on the surface x^T (5 spread)^-1 x = 1
        spread = inertia.pseudo_inertia(link)[:3, :3] / link[0] - np.outer(com, com)
        form = np.einsum("ka,ab,kb->k", centred, np.linalg.inv(5.0 * spread), centred)
        assert form == pytest.approx(np.ones(len(form)), abs=1e-2)
    lines = [trace for trace in arm["data"] if trace["type"] == "scatter3d"]
    for line, pose in zip(lines, poses, strict=True):
        assert [numbers(line[c])[1] for c in "xyz"] == pytest.approx(pose[:3, 3], abs=1e-5)
    unknown = [c.noise_floor is None for c in compared]
    assert ("the noise floor is unknown" in html) == all(unknown)


def test_the_figures_are_those_of_the_models(made):
    models, run, html = made
    for comparison in compare(models, run):
        assert f">{comparison.relative_error_percent:.3g}<" in html
        assert f">{comparison.rmse[1]:.3g}<" in html
        assert f">{number(1e3 * comparison.estimate.certificate.smallest_thickness)}<" in html
    text = re.sub(r"<[^>]+>", " ", html)
    assert "coulomb_friction" in text
    visible = re.sub(r"<script.*?</script>|<style.*?</style>|<[^>]+>", " ", html, flags=re.DOTALL)
    assert not re.search(r"(?<!=)\bNone\b(?! of)|\bnan\b", visible)
    ahead = follow(list(models.values())[-1], run, steps=100)  # as many as the report takes
    assert ahead.verdict in text
    cut = [f.seconds for f in ahead.free if not f.left]
    assert all(seconds <= 483 * 2e-3 for seconds in cut)
    assert ("report --forward" in text) == bool(cut)
    assert f"identified from ( {run.names[0]} )" in text or f"identified from ({run.names[0]})" in text
    last = list(models.values())[-1]
    for mass, gyration in zip(last.links[:, 0], inertia.gyration(last.links), strict=True):
        assert f">{number(mass, 4)}<" in html
        assert f">{number(gyration)}<" in html
    assert last.provenance["data_hash"] in text
    assert f"numpy {np.__version__}" in text


def test_what_is_no_body_has_no_ellipsoid():
    assert ellipsoid(np.zeros(10)) is None
    assert ellipsoid(np.array([1.0, 0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.0])) is None  # a rod


def test_the_verb_and_short_runs(two_link, tmp_path):
    run = experiment(two_link).training_run(0)
    keep = (run.t > run.t[0] + 2.0) & (run.t < run.t[0] + 3.8)
    short = replace(run, t=run.t[keep], q=run.q[keep], tau=run.tau[keep], dq=None)
    save(short, tmp_path / "short.csv")
    identify(two_link, run, "ols").save(tmp_path / "model.json")
    out = tmp_path / "short.html"
    assert (
        run_cli("report", tmp_path / "model.json", "--data", tmp_path / "short.csv", "--out", out) == 0
    )
    assert "from the runs that it was identified" in out.read_text()


def test_it_draws_in_chromium(made, tmp_path):
    """Joints are zoomed together, far figures wait, and no script was refused."""
    from page_driver import browsing  # which skips without Chromium

    path = tmp_path / "report.html"
    path.write_text(made[2])
    script = re.findall(r'id="plotly">(.*?)</script>', made[2])[0]
    read = gzip.decompress(base64.b64decode(script))
    assert b"root.moduleName = factory" not in read  # the function that a browser would read twice
    faults: list[str] = []
    with browsing() as browser:
        page = browser.new_page(viewport={"width": 1000, "height": 1200})
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("console", lambda said: faults.append(said.text) if said.type == "error" else None)
        page.goto(path.as_uri())
        page.wait_for_function("document.querySelectorAll('#torques .js-line').length >= 8")
        assert page.locator("#provenance").count() == 1
        assert page.locator("#friction .js-plotly-plot").count() == 0
        first, second = (f"document.querySelectorAll('#torques .plot')[{k}]" for k in (0, 1))
        page.evaluate(f"Plotly.relayout({first}, {{'xaxis.range[0]': 3, 'xaxis.range[1]': 5}})")
        page.wait_for_function(f"{second}.layout.xaxis.range?.[1] === 5")
        page.locator("#torques .legendtoggle").nth(1).click()
        page.wait_for_function(f"{second}.data[1].visible === 'legendonly'")
        page.evaluate("document.querySelector('#friction').scrollIntoView()")
        page.wait_for_selector("#friction .js-plotly-plot")
        page.wait_for_function("document.querySelectorAll('#friction .js-line').length >= 2 * 2")
    assert faults == []


def test_measured_curves_are_drawn_with_band_and_data(made):
    models, data, _ = made
    x = np.linspace(-1.0, 1.0, 9)
    one = Curve(1, ("q1",), x, x**2, x**2 - 0.1, x**2 + 0.1, 0.9, "1 q1^2 N m", 0.2, 0.1)
    pairs = np.column_stack([np.repeat(x[:3], 3), np.tile(x[:3], 3)])
    two = replace(one, of=("q1", "dq1"), x=pairs, formula=None)
    floor = dict.fromkeys(
        ("noise_floor", "unexplained", "held_out_rmse", "held_out_rmse_before"), [0.1] * 2
    )
    empty: dict[str, list[str]] = {name: [] for name in ("effects", "invisible", "events")}
    rest = {"verdict": "unknown_effect", "noise_source": "repetition", "held_out_source": "folds"}
    more = {"band_hz": 9.0, "frozen": False, "remarks": ["Look here first."]}
    curves = [one.to_dict(), two.to_dict()]
    found = Diagnosis.from_dict({**floor, **empty, **rest, **more, "curves": curves})
    html = make_report(models, data, findings=found)
    assert "Joint 1 misses a torque over q1 from -1 to 1 rad" in html
    assert "No simple law fits its band" in html
    assert "Look here first." in html
    assert found.headline in html


@pytest.mark.parametrize(
    ("effects", "said"),
    [
        (
            "viscous_friction",
            ("This model has no rigid_body effect.", "cannot be simulated: the model has no"),
        ),
        ("rigid_body", ("no friction that follows the velocity alone", "position of the free run")),
    ],
)
def test_what_a_model_lacks_is_said(effects, said, two_link):
    """Beside the sections that it can fill; `forward` shows the positions to the run's end."""
    run = small_run(two_link)
    html = make_report(identify(two_link, run, effects=effects), run, forward=True)
    for words in said:
        assert words in html


UNITS = ["N*m", "N*m"]


def test_bars_are_errors_over_noise_cut_at_the_floor():
    drawn = bars([0.1, 1.25], [0.11, 0.46], [0.1, 0.1], UNITS)
    assert re.findall(r"<td class=\"number\">(.*?)</td>", drawn) == ["1 → 1.1", "12.5 → 4.6"]
    assert re.findall(r'class="change (\w+)">(.*?)<', drawn) == [("worse", "+10 %"), ("better", "-63 %")]
    (floor,) = {float(x) for x in re.findall(r'class="noise" style="--wide:([\d.]+)', drawn)}
    widest = max(float(x) for x in re.findall(r'class="before"[^>]*--wide:([\d.]+)', drawn))
    assert floor / widest == pytest.approx(1.0 / 12.5, rel=0.01)
    alone = bars([0.1, 1.25], None, None, UNITS)
    assert "noise floor unknown" in alone
    assert 'class="noise"' not in alone
    assert "1.25 N m" in alone
