"""Ten models, one grade each: command line, Python, page, report, JSON and exports."""

import json
from pathlib import Path

import pytest
from commands import run_cli
from random_robots import repeating_run as run_of

from sdp_vs_penalty import Problem, compare, export, identify, load_estimate, report
from sdp_vs_penalty.data import save
from sdp_vs_penalty.data.files import load_measurements
from sdp_vs_penalty.data.measurements import Runs
from sdp_vs_penalty.estimation.verdict import Verdict
from sdp_vs_penalty.page.jobs import summary
from sdp_vs_penalty.page.run_jobs import Asked

pytestmark = pytest.mark.long

#: Method, effects, and the run it is judged on; the usual effects where there are none.
MODELS = [
    ("lmi-sdp", "", "same"),
    ("lmi-sdp", "", "other"),
    ("lmi-sdp", "rigid_body", "same"),
    ("lmi-sdp", "rigid_body", "other"),
    ("lmi-sdp", "rigid_body,viscous_friction", "once"),
    ("ols", "", "same"),
    ("ols", "rigid_body", "other"),
    ("penalty", "", "once"),
    ("lmi-sdp", "viscous_friction", "same"),
    ("lmi-sdp-plain", "rigid_body", "loud"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, two_link: Problem) -> Path:
    """The run to identify from, the same motion again, another one, a part without repetition, noise."""
    out = tmp_path_factory.mktemp("runs")
    save(run_of(two_link, 0), out / "train.csv")
    save(run_of(two_link, 1), out / "same.csv")
    save(run_of(two_link, 2, motion_seed=11), out / "other.csv")
    save(run_of(two_link, 3).window(0.0, 9.0), out / "once.csv")
    save(run_of(two_link, 4, noise=40.0), out / "loud.csv")
    return out


@pytest.mark.parametrize(("method", "effects", "judged"), MODELS)
def test_one_grade_everywhere(folder, method, effects, judged, tmp_path, capsys):
    model, figures = tmp_path / "model.json", tmp_path / "figures.json"
    how = ["--method", method, *(["--effects", effects] if effects else [])]
    for words in (
        ["identify", "two_link", "--data", str(folder / "train.csv"), *how, "--out", str(model)],
        ["compare", str(model), "--data", str(folder / f"{judged}.csv"), "--json", str(figures)],
    ):
        capsys.readouterr()
        code = run_cli(*words)
        shown = capsys.readouterr()
        assert code == 0, shown.err
    run, estimate = load_measurements(folder / f"{judged}.csv"), load_estimate(model)
    mine = identify("two_link", folder / "train.csv", method, effects=effects or None)
    recorded = (Verdict.from_dict(one.provenance["verdict"]) for one in (mine, estimate))
    assert len(set(recorded)) == 1
    found = compare({"model": estimate}, run)[0].verdict
    assert found.headline.split(".")[0] in shown.out
    said = json.loads(figures.read_text())["models"][0]["verdict"]
    assert said["grade"] == found.grade
    # Several models side by side: the noise is the run's, not theirs.
    beside = compare({"model": estimate, "first": load_estimate(model)}, run)
    assert [c.verdict for c in beside] == [found, found]
    given = type("Given", (Asked,), {"runs": Runs(run, None, run)})
    page = summary(given({"out": tmp_path / "page.json"}), estimate, 0.0)
    assert page["comparison"]["verdict"]["headline"] == found.headline
    report({"model": estimate}, run, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    assert f'<p class="verdict {found.grade.replace(" ", "-")}">' in text
    export(tmp_path / "page.json", tmp_path / "effects.json")
    exported = json.loads((tmp_path / "effects.json").read_text())["verdict"]
    assert f": {found.grade}. " in exported
