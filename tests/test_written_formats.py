"""Hostile names in every format that is written: a parser of that format reads them
back."""

import csv
import io
import json
import shutil
import subprocess
from dataclasses import replace
from xml.etree import ElementTree

import pytest
from hostile_names import hostile_names
from lxml import html
from markdown_it import MarkdownIt
from small_runs import small_model

import sdp_vs_penalty as sdp
from sdp_vs_penalty.errors import printable
from sdp_vs_penalty.exporters.content import xml_name
from sdp_vs_penalty.paper.tables import StudyTable
from sdp_vs_penalty.results import Shown
from sdp_vs_penalty.results.table import escape_latex

NAMES = list(hostile_names(200, of_files=False, seed=7))


@pytest.fixture
def model():
    return small_model()


def named(model, name):
    """The model with the name for its robot and, with its number, for each joint."""
    joints = tuple(
        replace(joint, name=f"{name}{k}") for k, joint in enumerate(model.robot.joints)
    )
    robot = replace(model.robot, name=name, joints=joints)
    problem = replace(model.problem, robot=robot)
    return replace(
        model, problem=problem, model=replace(model.model, robot=robot), method=name
    )


def exported(model, ending, folder, n_names):
    """Names, and the files that hold them."""
    for name in NAMES[:n_names]:
        path = folder / f"out{ending}"
        sdp.export(named(model, name), path)
        yield name, path


@pytest.mark.parametrize("ending", [".urdf", ".drake.urdf", ".sdf", ".xml"])
def test_xml_holds_each_name(ending, model, tmp_path):
    for name, path in exported(model, ending, tmp_path, 15):
        root = ElementTree.parse(path).getroot()
        attributes = {value for x in root.iter() for value in x.attrib.values()}
        assert xml_name(f"{name}0") in attributes


def strings_of(content):
    """All texts in a JSON document."""
    if isinstance(content, str):
        return {content}
    if isinstance(content, dict):
        content = list(content.values())
    items = content if isinstance(content, list) else []
    return {text for item in items for text in strings_of(item)}


def test_json_holds_each_name(model, tmp_path):
    for name, path in exported(model, ".json", tmp_path, 15):
        content = json.loads(path.read_text("utf-8"))
        assert f"{name}0" in strings_of(content)


def test_a_table_of_friction_has_as_many_cells_in_each_row(model, tmp_path):
    for _, path in exported(model, ".csv", tmp_path, 10):
        lines = [x for x in path.read_text().splitlines() if not x.startswith("#")]
        assert len({len(row) for row in csv.reader(lines)}) == 1


def test_c_compiles_with_each_name(model, tmp_path):
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    for _, path in exported(model, ".h", tmp_path, 8):
        options = ["-std=c99", "-Wall", "-Werror", "-fsyntax-only", "-x", "c"]
        done = subprocess.run(
            [compiler, *options, path], capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr


def test_a_model_holds_each_name(model, tmp_path):
    for name in NAMES[:15]:
        named(model, name).save(tmp_path / "model.json")
        assert sdp.load_estimate(tmp_path / "model.json").robot.name == name


def test_latex_holds_each_name():
    """As pylatexenc reads it."""
    latex2text = pytest.importorskip("pylatexenc.latex2text")
    latexwalker = pytest.importorskip("pylatexenc.latexwalker")
    commands = latex2text.get_default_latex_context_db()
    # Of LaTeX's own characters those that pylatexenc leaves out.
    characters = {
        "textless": "<",
        "textgreater": ">",
        "textbar": "|",
        "textasciicircum": "^",
        "textasciitilde": "~",
    }
    specs = [latex2text.MacroTextSpec(*pair) for pair in characters.items()]
    commands.add_context_category("characters", macros=specs, prepend=True)
    reader = latex2text.LatexNodes2Text(
        latex_context=commands, strict_latex_spaces=True
    )
    for name in map(printable, NAMES):
        text = escape_latex(name)
        latexwalker.LatexWalker(text, tolerant_parsing=False).get_latex_nodes()
        read = reader.latex_to_text(text)
        assert "".join(read.split()) == "".join(name.split()), text


def test_a_latex_table_holds_each_name_in_its_cell():
    latexwalker = pytest.importorskip("pylatexenc.latexwalker")
    rows = [{"name": name, NAMES[k - 1]: "1 "} for k, name in enumerate(NAMES[:20])]
    table = StudyTable(NAMES[0], rows, notes=NAMES[:3], caption=NAMES[1], name="III")
    text = table.form.latex()
    walker = latexwalker.LatexWalker(text, tolerant_parsing=False)
    walker.get_latex_nodes()
    assert r"\input" not in text


def test_markdown_shows_each_name_in_its_cell():
    """As markdown-it reads it, with tables."""
    rows = [{"name": name, "next": "1"} for name in NAMES]
    table = StudyTable(NAMES[0], rows, name="III")
    parser = MarkdownIt("commonmark").enable(["table", "strikethrough"])
    tree = html.fromstring(f"<div>{parser.render(table.form.markdown())}</div>")
    shown = [cell.text_content() for cell in tree.findall(".//tbody/tr/td")[::2]]
    assert shown == [" ".join(printable(name).split()) for name in NAMES]
    assert not tree.xpath("//td/*")
    assert tree.find(".//h1").text_content() == " ".join(printable(NAMES[0]).split())


#: Of a summary in a notebook; backquotes set a command as code.
TAGS = {"div", "p", "b", "table", "tbody", "tr", "td", "code"}


def test_html_shows_each_name():
    class Named(Shown):
        def __init__(self, name):
            self.name = name

        def _summary(self):
            return self.name, [(self.name, self.name)]

    for name in NAMES:
        shown = printable(name).replace("`", "")
        tree = html.fromstring(Named(name)._repr_html_())
        assert {x.tag for x in tree.iter()} <= TAGS
        cells = [cell.text_content() for cell in tree.iter("td")]
        assert [cell.replace("`", "") for cell in cells] == [shown] * 2


def test_a_csv_table_holds_each_name():
    rows = [{"name": name, "next": 1.5} for name in NAMES]
    text = StudyTable("t", rows, name="III").form.csv()
    read = list(csv.DictReader(io.StringIO(text, newline="")))
    assert [row["name"] for row in read] == [printable(name) for name in NAMES]
