"""The documentation works: its commands run in order, its notebook runs, its links lead somewhere."""

import os
import re
import shlex
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run_cli
from printed_pages import check_printed
from small_runs import small_run, write_run

import sdp_vs_penalty
from sdp_vs_penalty import load_problem
from sdp_vs_penalty.cli.main import VERBS, named
from sdp_vs_penalty.cli.options import Parser
from sdp_vs_penalty.data import DATASETS, save
from sdp_vs_penalty.simulation import experiment

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))


def commands(page: str) -> list[str]:
    """The lines of a page's console blocks."""
    text = (DOCS / page).read_text(encoding="utf-8")
    blocks = re.findall(r"^```console\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [line for block in blocks for line in block.splitlines()]


#: Verbs of docs/commands.md that take long or need the network or another program's file.
TESTED_ELSEWHERE = {
    "demo", "tables", "figures", "excite", "shootout", "fetch", "convert", "page", "verify",
}  # fmt: skip


def test_every_verb_is_shown():
    verbs = {verb for some in VERBS.values() for verb in some}
    left = verbs - {shlex.split(line)[1] for line in commands("commands.md")}
    assert not left, f"no command of docs/commands.md shows {left}"


def test_every_command_runs_in_order(tmp_path, two_link, monkeypatch, capsys):
    """On two joints, of which the third is the second: what a command says is not of the arm's size."""
    for seed, name in enumerate(("run1.csv", "run2.csv", "test.csv")):
        write_run(tmp_path / name, two_link, seed=seed)
    shutil.copy(DOCS / "my_arm.urdf", tmp_path)
    save(small_run(load_problem(tmp_path / "my_arm.urdf")), tmp_path / "my_run.csv")
    monkeypatch.chdir(tmp_path)
    lines = [x for x in commands("commands.md") if shlex.split(x)[1] not in TESTED_ELSEWHERE]
    run_all([x.replace("panda", "two_link").replace("friction:3", "friction:2") for x in lines], capsys)
    assert (tmp_path / "comparison.json").exists()


def run_all(lines: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, str]:
    """Every command in order, each with exit code 0; what they said, by verb (the last of each), and
    all of it under "".
    """
    said = {"": ""}
    for line in lines:
        program, *words = shlex.split(line)
        assert program == "sdp-vs-penalty"
        code = run_cli(*words)
        shown = capsys.readouterr()
        assert code == 0, f"{line}\n{shown.err}"
        assert not re.search(r"\bNone\b(?! of)|\bnan\b", shown.out), f"{line}\n{shown.out}"
        said[words[0]] = shown.out
        said[""] += shown.out
    return said


def cached_panda(data_folder: Path, folder: Path) -> None:
    """The Panda's files where `fetch` looks for them before it downloads anything."""
    folder.mkdir(parents=True)
    for file in DATASETS["panda"].files:
        shutil.copy(data_folder / "panda" / file.name, folder / file.name)


@pytest.mark.parametrize("page", [path.name for path in PAGES])
def test_every_command_parses_and_every_link_leads_somewhere(page):
    for line in commands(page):
        _, verb, *words = shlex.split(line)
        Parser(verb, named(verb)).given(words)
    text = (DOCS / page).read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert (DOCS / target).resolve().is_file(), f"{page}: {target}"
    assert max(map(len, re.sub(r"```.*?```|<!--.*?-->", "", text, flags=re.DOTALL).splitlines())) <= 125


def test_every_page_is_in_the_index_and_the_index_in_the_readme():
    index = (DOCS / "README.md").read_text(encoding="utf-8")
    for path in [*PAGES, *DOCS.glob("*.ipynb")]:
        assert path.name == "README.md" or f"({path.name})" in index
    assert "(docs/README.md)" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_every_public_name_is_in_the_reference():
    reference = (DOCS / "api.md").read_text(encoding="utf-8")
    public = {name: getattr(sdp_vs_penalty, name) for name in sdp_vs_penalty.__all__}
    lines = [f"::: {x.__module__}.{name}" for name, x in public.items() if callable(x)]
    left = set(lines) - set(reference.splitlines())
    assert not left, f"docs/api.md has no line {left}"


@pytest.mark.long
def test_how_to(tmp_path, monkeypatch, capsys):
    """Every command of the page, in order, after those of the rehearsal that it starts from."""
    shutil.copy(DOCS / "my_arm.urdf", tmp_path)
    monkeypatch.chdir(tmp_path)
    simulate, *_ = commands("your-robot.md")
    runs = "runs/run1.csv runs/run2.csv runs/run3.csv"
    run_all([simulate, f"sdp-vs-penalty identify my_arm.urdf --data {runs} --out model.json"], capsys)
    rows = (Path("runs") / "run1.csv").read_text().splitlines()
    names = {"t": "time", "q1": "pos_a", "q2": "pos_b", "tau1": "effort_a", "tau2": "effort_b"}
    head = ",".join(names.get(word, word) for word in rows[0].split(","))
    Path("theirs.csv").write_text("\n".join([head, *rows[1:]]) + "\n")
    said = run_all(commands("how-to.md"), capsys)
    check_printed("how-to.md", said[""])
    assert "accepted" in said["verify"]
    assert "mass" in Path("endeffector-config.json").read_text()


@pytest.mark.parametrize(
    ("page", "data"),
    [
        pytest.param("tutorial.md", "panda", marks=[pytest.mark.long, pytest.mark.real_data]),
        pytest.param("coupled-wrist.md", "tx40", marks=[pytest.mark.slow, pytest.mark.real_data]),
        pytest.param("your-robot.md", None, marks=pytest.mark.slow),
    ],
)
def test_all_commands_of_a_page_print_what_it_shows(page, data, request, tmp_path, monkeypatch, capsys):
    """The first finding, its joint and the fall of its error among it."""
    if data is not None:
        shutil.copytree(request.getfixturevalue("data_folder") / data, tmp_path / "data" / data)
    shutil.copy(DOCS / "my_arm.urdf", tmp_path)
    monkeypatch.chdir(tmp_path)
    check_printed(page, run_all(commands(page), capsys)[""])


@pytest.mark.long
def test_the_hobby_arm(tmp_path, monkeypatch, capsys):
    """The identified MJCF follows an unseen command better than the given one, on every joint."""
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    text = (DOCS / "hobby-arm.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    names: dict[str, Any] = {}
    exec(blocks[0], names)  # our own page
    said = run_all(commands("hobby-arm.md"), capsys)[""]
    exec(blocks[1], names)
    followed = capsys.readouterr().out
    check_printed("hobby-arm.md", said + followed)
    given, identified = ([float(x) for x in line.split()[1:-1]] for line in followed.splitlines())
    assert all(2.0 * better < worse for better, worse in zip(identified, given, strict=True))


@pytest.mark.slow
@pytest.mark.real_data
def test_the_notebook_runs(tmp_path, data_folder, monkeypatch):
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    cached_panda(data_folder, tmp_path / "cache" / "sdp-vs-penalty" / "panda")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), *sys.path]))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    book = nbformat.read(DOCS / "panda_hysteresis.ipynb", as_version=4)
    nbclient.NotebookClient(
        book, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    outputs = [output for cell in book.cells for output in cell.get("outputs", [])]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 3
    text = "\n".join(output.get("text", "") for output in outputs)
    assert re.search(r"presliding_hysteresis:[\d+]*7", text)
    assert "every constraint holds" in text


def test_the_recipe_of_a_control_loop_renews_a_certified_fit():
    text = (DOCS / "performance.md").read_text(encoding="utf-8")
    found = re.search(r"## In a control loop.*?^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    recipe = found.group(1).replace('"panda"', '"two_link"')
    assert len(recipe.splitlines()) <= 30
    run = experiment(load_problem("two_link")).training_run(seed=0)
    middle, end = (float(run.t[0] + share * (run.t[-1] - run.t[0])) for share in (0.5, 1.0))
    names: dict[str, Any] = {"first": run.window(float(run.t[0]), middle)}
    exec(recipe, names)  # our own page
    posed = names["fit"]
    again = names["renew"](run.window(middle, end))
    assert names["fit"] is not posed
    assert names["fit"].gap <= 1e-8
    np.testing.assert_array_equal(again, names["fit"].theta)


def sentences(text: str) -> list[str]:
    """The prose of a page, code and addresses as one word each."""
    text = re.sub(r"```.*?```|<!--.*?-->|^ {7,}\S[^\n]*$", "", text, flags=re.DOTALL | re.MULTILINE)
    out = []
    for part in re.split(r"\n\s*\n|\n(?=\s*[-*|#:] ?|\s*\d+\. )", text):
        if not part.strip().startswith(("|", ":::")):
            part = re.sub(r"\]\([^)]*\)", "]", re.sub(r"`[^`]*`", "code", part))
            out += re.split(r"(?<=[.!?])\s+", part.replace("\n", " "))
    return out


@pytest.mark.parametrize("page", ["../README.md", *(p.name for p in PAGES)])
def test_no_sentence_is_longer_than_35_words(page):
    said = sentences((DOCS / page).read_text(encoding="utf-8"))
    long = [one for one in said if len(one.split()) > 35]
    assert not long, "\n".join(long)


def test_the_documentation_is_short():
    assert sum(len(p.read_text(encoding="utf-8").split()) for p in PAGES) <= 25_000
