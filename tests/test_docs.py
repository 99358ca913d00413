"""The documentation works: its commands run in order, its notebook and its Python run,
its links lead somewhere, its figures are those of results/.
"""

import ast
import importlib
import importlib.util
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from arms import SCARA, write_urdf
from commands import run_cli
from small_runs import write_run

import sdp_vs_penalty
from sdp_vs_penalty import load_estimate, load_problem
from sdp_vs_penalty.api.registration import REGISTRIES
from sdp_vs_penalty.cli.main import VERBS, import_verb
from sdp_vs_penalty.cli.options import Parser
from sdp_vs_penalty.data import save
from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.diagnosis.diagnosis_data import Invisible, Remaining
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.diagnosis.finding import Finding, Retune
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.notices import Notice
from sdp_vs_penalty.diagnosis.passing.cause import PassingCause, Span
from sdp_vs_penalty.effects import effect_name
from sdp_vs_penalty.reports.demo import HIDDEN
from sdp_vs_penalty.simulation import experiment
from sdp_vs_penalty.simulation.hidden_runs import hidden_runs
from sdp_vs_penalty.solvers import SOLVERS
from sdp_vs_penalty.testing import contracts

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(text, language):
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def commands(page):
    """The lines of a page's console blocks that are ours."""
    text = "".join(blocks((DOCS / page).read_text(encoding="utf-8"), "console"))
    return [
        line
        for line in text.splitlines()
        if page != "../README.md" or line.startswith("sdp-vs-")
    ]


def check_printed(page, said):
    """Every line that a page shows of outputs stands in them, however wide the terminal
    is."""
    whole = " ".join(said.split())
    shown = "".join(blocks((DOCS / page).read_text(encoding="utf-8"), "output"))
    for line in (
        " ".join(line.split()) for line in shown.splitlines()
    ):  # * stands for anything
        pattern = (
            re.escape(line)
            .replace(r"\*", ".*?")
            .replace(r"\?", ".")
            .replace(r"\ ", r"\s*")
        )
        assert re.search(pattern, whole), f"{page}: {line}\n{said}"


#: Verbs of docs/commands.md that take long or need the network or another program's
#: file.
TESTED_ELSEWHERE = {
    "demo",
    "tables",
    "figures",
    "excite",
    "shootout",
    "fetch",
    "convert",
    "page",
    "verify",
}


def test_every_verb_is_shown():
    verbs = {verb for some in VERBS.values() for verb in some}
    left = verbs - {shlex.split(line)[1] for line in commands("commands.md")}
    assert not left, f"no command of docs/commands.md shows {left}"


@pytest.mark.long
def test_every_command_runs_in_order(tmp_path, two_link, monkeypatch, capsys):
    """On two joints, of which the third is the second: what a command says is not of
    the arm's size."""
    for seed, name in enumerate(("run1.csv", "run2.csv", "test.csv")):
        write_run(tmp_path / name, two_link, seed=seed)
    shutil.copy(DOCS / "my_arm.urdf", tmp_path)
    write_run(tmp_path / "my_run.csv", load_problem(tmp_path / "my_arm.urdf"))
    monkeypatch.chdir(tmp_path)
    left_out = set(TESTED_ELSEWHERE)
    if importlib.util.find_spec("plotly") is None:
        left_out.add("report")
    lines = [x for x in commands("commands.md") if shlex.split(x)[1] not in left_out]
    run_all(
        [
            x.replace("panda", "two_link").replace("friction:3", "friction:2")
            for x in lines
        ],
        capsys,
    )
    assert (tmp_path / "comparison.json").exists()


def run_all(lines, capsys):
    """Every command in order, each with exit code 0; what they said, by verb (the last
    of each), and all of it under "".
    """
    said = {"": ""}
    for line in lines:
        program, *words = shlex.split(line)
        assert program == "sdp-vs-penalty"
        code = run_cli(*words)
        shown = capsys.readouterr()
        assert code == 0, f"{line}\n{shown.err}"
        assert not re.search(r"\bNone\b(?! of)|\bnan\b", shown.out), (
            f"{line}\n{shown.out}"
        )
        said[words[0]] = shown.out
        said[""] += shown.out
    return said


@pytest.mark.parametrize("page", [path.name for path in PAGES])
def test_every_command_parses_and_every_link_leads_somewhere(page):
    for line in commands(page):
        _, verb, *words = shlex.split(line)
        Parser(verb, import_verb(verb)).parse_words(words)
    text = (DOCS / page).read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert (DOCS / target).resolve().is_file(), f"{page}: {target}"


#: The command that a command prints to be run next.
NEXT = "^Next: sdp-vs-penalty (.*)$"
READABILITY = runpy.run_path(str(ROOT / "docs" / "tools" / "readability.py"))


def test_the_documentation_has_short_sentences():
    """A mean of 16 words over all pages."""
    lengths = [
        READABILITY["n_words"](sentence)
        for page in PAGES
        for sentence in READABILITY["sentences"](page.read_text(encoding="utf-8"))
    ]
    assert len(lengths) > 500
    assert sum(lengths) / len(lengths) <= READABILITY["MEAN"]


@pytest.mark.nightly
@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda p: p.name)
def test_no_sentence_is_longer_than_thirty_words(page):
    for sentence in READABILITY["sentences"](page.read_text(encoding="utf-8")):
        assert READABILITY["n_words"](sentence) <= READABILITY["LONGEST"], sentence


def test_sentences_are_told_from_code_lists_and_abbreviated_numbers():
    text = "One `a. B` of 1.5 m. Two [is. linked](x.md) now.\n\n- Three\n- Four: five;"
    text += " six\n\n| a table. Of cells |\n\n```python\nno. Sentence\n```\n"
    assert READABILITY["sentences"](text) == [
        "One Code of 1.5 m.",
        "Two is. linked now.",
        "Three",
        "Four: five; six",
    ]


def test_traces_of_the_successor_name_what_is_there():
    """Each path of a trace exists, and each name of code stands in a file of its line."""
    source = ROOT / "sdp_vs_penalty"
    traces = blocks((DOCS / "successor.md").read_text(encoding="utf-8"), "text")[1:]
    n_names = 0
    for line in "".join(traces).splitlines():
        files = list[Path]()
        for path in re.findall(r"[a-z_]+/(?:[a-z_]+/)*(?:[a-z_]+\.py)?", line):
            place = source / path
            assert place.exists(), line
            files += [place] if place.is_file() else place.rglob("*.py")
        code = "".join(file.read_text(encoding="utf-8") for file in files)
        called = re.split(r"  +(?=[a-z_]+/)", re.sub(r"^[|' -]*", "", line))[0]
        for name in re.findall(r"\b\w*(?:[a-z]_|_[a-z]|[a-z][A-Z]|[A-Z]_)\w*", called):
            n_names += 1
            defines = rf"(?:def|class) {name}\b|^{name}: "
            assert re.search(defines, code, re.MULTILINE), line
    assert n_names > 30


def kinds_of_issues():
    """What `check` may call an issue: the texts that its code gives as kinds."""
    kinds = set()
    for folder in ("checks", "race"):
        for path in (ROOT / "sdp_vs_penalty" / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                found = []
                if isinstance(node, ast.Call):
                    found = [word.value for word in node.keywords if word.arg == "kind"]
                    if getattr(node.func, "id", "") in ("Hypothesis", "Reason"):
                        found += node.args[:1]
                elif isinstance(node, ast.Assign):
                    names = [getattr(target, "id", "") for target in node.targets]
                    found = [node.value] if "kind" in names else []
                texts = [getattr(x, "value", 0) for v in found for x in ast.walk(v)]
                kinds.update(text for text in texts if isinstance(text, str))
    return kinds


def test_every_kind_of_issue_has_a_row_in_troubleshooting():
    page = (DOCS / "troubleshooting.md").read_text(encoding="utf-8")
    rows = " ".join(re.findall(r"^\| ([^|]*) \|", page, re.MULTILINE))
    kinds = kinds_of_issues()
    assert len(kinds) > 50
    assert not [kind for kind in kinds if kind not in rows]


RECORDS = (Diagnosis, Finding, Retune, Curve, PassingCause, Span, Notice)


@pytest.mark.parametrize("record", [*RECORDS, Invisible, Remaining, Doubt])
def test_every_field_of_findings_json_is_said(record):
    text = (DOCS / "files.md").read_text(encoding="utf-8")
    rows = text.partition("## findings.json")[2]
    names = [*(field.name for field in fields(record)), *record.derived]
    assert names
    assert not [name for name in names if f"`{name}`" not in rows]


def test_every_public_name_is_in_the_reference():
    reference = (DOCS / "api.md").read_text(encoding="utf-8")
    public = {name: getattr(sdp_vs_penalty, name) for name in sdp_vs_penalty.__all__}
    lines = [f"::: {x.__module__}.{name}" for name, x in public.items() if callable(x)]
    left = set(lines) - set(reference.splitlines())
    assert not left, f"docs/api.md has no line {left}"


@pytest.fixture(scope="module")
def rehearsed(tmp_path_factory):
    """A folder with what the rehearsal of your-robot.md leaves: runs and a model."""
    folder = tmp_path_factory.mktemp("rehearsed")
    shutil.copy(DOCS / "my_arm.urdf", folder)
    simulate, *_ = commands("your-robot.md")
    runs = "runs/run1.csv runs/run2.csv runs/run3.csv"
    identify = f"identify my_arm.urdf --data {runs} --out model.json"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert run_cli(*shlex.split(simulate)[1:]) == 0
        assert run_cli(*shlex.split(identify)) == 0
    return folder


def in_copy(rehearsed, tmp_path, monkeypatch):
    """Work in a copy of the rehearsal's folder, beside a log with other names."""
    shutil.copytree(rehearsed, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    head, *rows = (Path("runs") / "run1.csv").read_text().splitlines()
    for old, new in (("t", "time"), ("q", "pos_"), ("tau", "effort_")):
        for joint in ("", "1", "2") if old != "t" else ("",):
            word = {"": new, "1": f"{new}a", "2": f"{new}b"}[joint]
            head = re.sub(rf"\b{old}{joint}\b", word, head)
    Path("theirs.csv").write_text("\n".join([head, *rows]) + "\n")


@pytest.mark.long
@pytest.mark.parametrize(
    "page", ["how-to.md", "which-motion.md", "tool.md", "ranges.md"]
)
def test_answers_print_what_they_show(page, rehearsed, tmp_path, monkeypatch, capsys):
    """Every command of the page, in order, in the folder of the rehearsal."""
    in_copy(rehearsed, tmp_path, monkeypatch)
    said = run_all(commands(page), capsys)
    check_printed(page, said[""])
    assert "verify" not in said or "accepted" in said["verify"]
    made = Path("endeffector-config.json")
    assert page != "tool.md" or "mass" in made.read_text()
    for code in blocks((DOCS / page).read_text(encoding="utf-8"), "python"):
        for extra in ("matplotlib", "jinja2"):  # plots, and pandas' LaTeX
            pytest.importorskip(extra)
        exec(code, {})  # our own page


def run_page(page, capsys):
    """Run the Python and the commands of a page in order; return what they said."""
    said = ""
    text = (DOCS / page).read_text(encoding="utf-8")
    names = {}
    for language, code in re.findall(
        r"^```(python|console)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL
    ):
        if language == "python":
            exec(code, names)  # our own page
            said += capsys.readouterr().out
        else:
            said += run_all(code.splitlines(), capsys)[""]
    return said


@pytest.mark.long
def test_what_each_call_returns(rehearsed, tmp_path, monkeypatch, capsys):
    in_copy(rehearsed, tmp_path, monkeypatch)
    check_printed("api.md", run_page("api.md", capsys))


@pytest.mark.long
def test_a_plugin_of_one_file_is_used_and_judged(
    rehearsed, tmp_path, monkeypatch, capsys
):
    """The page's own file: listed, diagnosed beside ours, added, and put to contracts;
    and its own method, whose optimum is certified."""
    pytest.importorskip("cvxpy")
    in_copy(rehearsed, tmp_path, monkeypatch)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    for registry in REGISTRIES:
        monkeypatch.setattr(registry, "_registered", [])
    text = (DOCS / "contracts.md").read_text(encoding="utf-8")
    Path("my_effects.py").write_text(blocks(text, "python")[0])
    shutil.copy(DOCS / "my_method.py", tmp_path)
    try:
        said = run_page("contracts.md", capsys)
    finally:
        for name in ("my_effects", "my_method"):
            sys.modules.pop(name, None)
        for registry in REGISTRIES:
            registry.forget()
    check_printed("contracts.md", said)
    assert said.count("kept:") > 5
    assert float(re.search(r"optimality gap: (\S+)", said)[1]) < 1e-6


@pytest.mark.nightly
def test_the_gallerys_own_solver_keeps_the_contracts(tmp_path, monkeypatch):
    """It calls no empty set optimal, and what it calls optimal is."""
    text = (DOCS / "gallery" / "students_day.py").read_text(encoding="utf-8")
    imports = text[text.index("from dataclasses") : text.index("urdf = ")]
    first, last = "@register\nclass Splitting", 'for solver in ("clarabel"'
    code = text[text.index(first) : text.index(last)]
    (tmp_path / "splitting_of_the_day.py").write_text(f"{imports}\n\n{code}")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(SOLVERS, "_registered", [])
    try:
        solver = importlib.import_module("splitting_of_the_day").Splitting
        for judge in contracts(solver).values():
            judge()
    finally:
        SOLVERS.forget()


@pytest.mark.slow
@pytest.mark.real_data
@pytest.mark.parametrize(
    ("page", "data"),
    [("only-currents.md", ("ur10e", "emps")), ("benchmarks.md", ("emps",))],
)
def test_pages_of_real_logs_run(page, data, data_folder, tmp_path, monkeypatch, capsys):
    for name in data:
        shutil.copytree(data_folder / name, tmp_path / "data" / name)
    monkeypatch.chdir(tmp_path)
    check_printed(page, run_page(page, capsys))


@pytest.mark.long
def test_the_model_in_controllers(rehearsed, tmp_path, monkeypatch, capsys):
    """Python, MuJoCo and C compute one torque, friction and offsets included."""
    pytest.importorskip("mujoco")
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    in_copy(rehearsed, tmp_path, monkeypatch)
    check_printed("controller.md", run_all(commands("controller.md"), capsys)[""])
    text = (DOCS / "controller.md").read_text(encoding="utf-8")
    names = {}
    for code in blocks(text, "python"):
        exec(code, names)  # our own page
    (code,) = blocks(text, "c")
    Path("loop.c").write_text(code)
    subprocess.run(["cc", "loop.c", "-o", "loop", "-lm"], check=True)
    printed = subprocess.run(["./loop"], capture_output=True, text=True, check=True)
    by_c = [float(x) for x in printed.stdout.split()]
    np.testing.assert_allclose(by_c, names["arm"].torque, atol=1e-5)
    by_mujoco = names["data"].qfrc_inverse
    np.testing.assert_allclose(by_mujoco, names["arm"].torque, atol=1e-5)
    np.testing.assert_allclose(names["M"], names["mass_matrix"], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "data"),
    [
        pytest.param("tutorial.md", "panda", marks=pytest.mark.real_data),
        pytest.param("coupled-wrist.md", "tx40", marks=pytest.mark.real_data),
        ("your-robot.md", None),
    ],
)
def test_all_commands_of_a_page_print_what_it_shows(
    page, data, request, tmp_path, monkeypatch, capsys
):
    """The first finding, its joint and the fall of its error among it."""
    if data is not None:
        shutil.copytree(
            request.getfixturevalue("data_folder") / data, tmp_path / "data" / data
        )
    shutil.copy(DOCS / "my_arm.urdf", tmp_path)
    monkeypatch.chdir(tmp_path)
    check_printed(page, run_all(commands(page), capsys)[""])


@pytest.mark.slow
def test_the_hobby_arm(tmp_path, monkeypatch, capsys):
    """The identified MJCF follows an unseen command better than the given one, on every
    joint."""
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(DOCS / "hobby_arm.py"), run_name="__main__")
    said = run_all(commands("hobby-arm.md"), capsys)[""]
    monkeypatch.syspath_prepend(DOCS)
    (code,) = blocks((DOCS / "hobby-arm.md").read_text(encoding="utf-8"), "python")
    exec(code, {})  # our own page
    followed = capsys.readouterr().out
    check_printed("hobby-arm.md", said + followed)
    given, identified = (
        [float(x) for x in line.split()[1:-1]] for line in followed.splitlines()
    )
    assert all(
        2.0 * better < worse for better, worse in zip(identified, given, strict=True)
    )


@pytest.mark.long
def test_the_demo_tells_the_whole_story(tmp_path, capsys):
    """What is hidden is found without being told, and the error of its joint falls."""
    pytest.importorskip("plotly")
    code = run_cli("demo", "--out", tmp_path / "demo")
    shown = capsys.readouterr()
    assert code == 0, shown.err
    text = " ".join(shown.out.split())
    assert f"Missing: {effect_name(HIDDEN)} on joint 7" in text
    fall = text.partition("neither has seen: joint 7: ")[2].partition(" %)")[0]
    assert int(fall.rpartition("(")[2]) <= -60
    check_printed("demo.md", shown.out)
    ((verb, *words),) = map(shlex.split, re.findall(NEXT, shown.out, re.MULTILINE))
    Parser(verb, import_verb(verb)).parse_words(words)
    check_printed("../README.md", shown.out)
    html = (tmp_path / "demo" / "report.html").read_text()
    assert '<p class="verdict good">' in html
    assert {p.name for p in (tmp_path / "demo").iterdir()} == {
        "run1.csv",
        "run2.csv",
        "test.csv",
        "model.json",
        "better.json",
        "report.html",
    }


@pytest.mark.slow
@pytest.mark.real_data
@pytest.mark.parametrize(
    ("name", "data", "n_pictures", "printed"),
    [
        (
            "panda_hysteresis",
            "panda",
            3,
            r"presliding_hysteresis:[\d+]*7(.|\n)*every constraint holds",
        ),
        ("coupled_wrist", "tx40", 3, "Do not use"),
    ],
)
def test_the_notebook_runs(
    name, data, n_pictures, printed, tmp_path, data_folder, monkeypatch
):
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    # Where `fetch` looks for them before it downloads anything.
    shutil.copytree(data_folder / data, tmp_path / "cache" / "sdp-vs-penalty" / data)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), *sys.path]))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    book = nbformat.read(DOCS / "gallery" / f"{name}.ipynb", as_version=4)
    nbclient.NotebookClient(
        book,
        timeout=300,
        kernel_name="python3",
        resources={"metadata": {"path": str(tmp_path)}},
    ).execute()
    outputs = [output for cell in book.cells for output in cell.get("outputs", [])]
    assert (
        sum("image/png" in output.get("data", {}) for output in outputs) == n_pictures
    )
    text = "\n".join(output.get("text", "") for output in outputs)
    assert re.search(printed, text)


def test_the_recipe_of_a_control_loop_renews_a_certified_fit():
    recipe = runpy.run_path(str(DOCS / "renewed_fit.py"))
    problem = load_problem("two_link")
    run = experiment(problem).training_run(seed=0)
    middle = float(run.t[0] + 0.5 * (run.t[-1] - run.t[0]))
    fit = recipe["RenewedFit"](problem, run.window(float(run.t[0]), middle))
    first = fit.fit
    again = fit.renew(run.window(middle, float(run.t[-1])))
    assert fit.fit is not first
    assert fit.fit.gap <= 1e-8
    np.testing.assert_array_equal(again, fit.fit.theta)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The files that the README's examples name: a spring is hidden in their arm."""
    out = tmp_path_factory.mktemp("readme")
    problem = load_problem(write_urdf(out / "my_arm.urdf", "my_arm", SCARA[1:3]))
    runs = hidden_runs(problem, [("joint_spring", [1])], "strong", 24, 4).runs
    names = ("run1.csv", "run2.csv", "new.csv", "test.csv")
    for run, name in zip(runs, names, strict=True):
        save(run.rows(slice(None, None, 10)), out / name)
    return out


def hidden_is_added(path):
    """Whether the model of a file has the hidden spring."""
    effects = load_estimate(path).model.effects
    return "joint_spring" in [effect.name for effect in effects]


def test_your_robot_in_eight_commands(folder, monkeypatch, capsys):
    pytest.importorskip("plotly")
    monkeypatch.chdir(folder)
    assert len(commands("../README.md")) == 8
    run_all(commands("../README.md"), capsys)
    assert hidden_is_added("better.json")
    assert not hidden_is_added("model.json")
    assert "my_arm_torque" in Path("model.h").read_text()
    assert Path("identified.urdf").exists()
    assert Path("report.html").exists()


def test_the_python_adds_what_it_has_found(folder, monkeypatch, capsys):
    (code,) = blocks(README, "python")
    (folder / "example.py").write_text(code)
    monkeypatch.chdir(folder)
    runpy.run_path("example.py")
    assert "certified lower bound" in capsys.readouterr().out
    assert hidden_is_added("better.json")


def test_the_table_equals_the_generated_one():
    results = (ROOT / "results" / "README.md").read_text(encoding="utf-8")
    assert TOOL["dated"](TOOL["with_results"](results, TOOL["all_routes"]())) == results
    headings = re.findall(r"^#+ (.*)$", README, re.MULTILINE)
    anchors = [
        re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-")
        for heading in headings
    ]
    for link in re.findall(r"\]\(([^):]*)\)", README):
        path, _, anchor = link.partition("#")
        assert (ROOT / path).exists(), link
        assert path or anchor in anchors, link


def test_constraints_pin_exact_versions_and_name_no_host():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert pins
    for line in pins:
        assert re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.+!]+", line), line
    assert not re.search(r"://|--", "\n".join(lines))


# --- figures that texts quote, as results/tables/cited.txt says --------------------------

TOOL = runpy.run_path(str(ROOT / "results" / "tables" / "update_readme.py"))
CITED = TOOL["citations"]()


@pytest.mark.parametrize("page", CITED, ids=lambda p: f"{p.parent.name}/{p.name}")
def test_quoted_figures_are_their_sources(page):
    text = page.read_text()
    assert TOOL["refreshed"](text, CITED[page]) == (text, CITED[page])


# --- every block of code is run, or says why not -------------------------------------

#: Blocks that no test runs, by page and language, and why.
NOT_RUN = {
    ("README.md", "console", 0): ".ci/run installs; the demo is run",
    ("README.md", "console", 2): ".ci/run is what it says",
    ("CONTRIBUTING.md", "console", 0): ".ci/run is what it says",
    ("docs/README.md", "sh", 0): ".ci/run installs; the demo is run",
    ("docs/benchmarks.md", "sh", 0): "output error takes many minutes",
    ("docs/contracts.md", "toml", 0): "tests/testing/theirs is such a package",
    ("docs/demo.md", "console", 1): "it only parses: files of the demo, which is run",
    ("docs/demo.md", "console", 2): "tests/page opens the page",
    (
        "docs/parallelogram.md",
        "xml",
        0,
    ): "tests/robot/test_mechanism.py has such joints",
}
#: Pages whose other blocks are run, by the tests of this file or of that one.
RUN_BY = {
    "README.md": (
        test_your_robot_in_eight_commands,
        test_the_python_adds_what_it_has_found,
    ),
    "docs/api.md": (test_what_each_call_returns,),
    "docs/benchmarks.md": (test_pages_of_real_logs_run,),
    "docs/commands.md": (test_every_command_runs_in_order,),
    "docs/contracts.md": (test_a_plugin_of_one_file_is_used_and_judged,),
    "docs/controller.md": (test_the_model_in_controllers,),
    "docs/coupled-wrist.md": (test_all_commands_of_a_page_print_what_it_shows,),
    "docs/demo.md": (test_the_demo_tells_the_whole_story,),
    "docs/hobby-arm.md": (test_the_hobby_arm,),
    "docs/how-to.md": (test_answers_print_what_they_show,),
    "docs/online.md": ("online/test_payload.py",),
    "docs/only-currents.md": (test_pages_of_real_logs_run,),
    "docs/ranges.md": (test_answers_print_what_they_show,),
    "docs/tool.md": (test_answers_print_what_they_show,),
    "docs/tutorial.md": (test_all_commands_of_a_page_print_what_it_shows,),
    "docs/which-motion.md": (test_answers_print_what_they_show,),
    "docs/your-robot.md": (test_all_commands_of_a_page_print_what_it_shows,),
}


def test_every_block_of_code_is_run_or_says_why_not():
    left, reasons = [], dict(NOT_RUN)
    for path in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *PAGES):
        page, counts = path.relative_to(ROOT).as_posix(), {}
        text = path.read_text(encoding="utf-8")
        for language in re.findall(r"^```([a-z]+)$", text, re.MULTILINE):
            k = counts[language] = counts.get(language, -1) + 1
            has_reason = reasons.pop((page, language, k), None)
            if language not in ("output", "text") and not has_reason:
                left += [] if page in RUN_BY else [(page, language, k)]
    assert not left, "add a test, or a reason"
    assert not reasons, "no such blocks"
    for test in (test for tests in RUN_BY.values() for test in tests):
        assert callable(test) or (ROOT / "tests" / test).is_file()
