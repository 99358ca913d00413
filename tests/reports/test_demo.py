"""The demo: what is hidden is found without being told, and the error of its joint falls."""

import re
import time
from pathlib import Path

import pytest
from commands import run_cli
from printed_pages import check_printed

from sdp_vs_penalty.reports.demo import HIDDEN

pytest.importorskip("plotly")


@pytest.mark.long
def test_the_demo_tells_the_whole_story(tmp_path, capsys):
    begin = time.process_time()
    code = run_cli("demo", "--out", tmp_path / "demo")
    shown = capsys.readouterr()
    assert code == 0, shown.err
    assert time.process_time() - begin < 20.0  # 13 s where nothing else runs
    text = " ".join(shown.out.split())
    assert f"Missing: {HIDDEN} on joint 7" in text
    fall = text.partition("neither has seen: joint 7: ")[2].partition(" %)")[0]
    assert int(fall.rpartition("(")[2]) <= -60
    readme = re.sub("<!--.*?-->", "", (Path(__file__).parents[2] / "README.md").read_text())
    for figure in re.findall(r"-?[\d.]+", fall.replace("->", "")):
        assert f"{figure} times" in readme or f"({figure} %)" in readme
    for method in ("ols", "penalty", "lmi-sdp"):
        assert f"{method} " in text
    assert "ols do not use" in text
    assert "Good. Error over noise" in text
    check_printed("demo.md", shown.out)
    html = (tmp_path / "demo" / "report.html").read_text()
    assert '<p class="verdict good">' in html
    assert {p.name for p in (tmp_path / "demo").iterdir()} == {
        "run1.csv", "run2.csv", "test.csv", "model.json", "better.json", "report.html",
    }  # fmt: skip
