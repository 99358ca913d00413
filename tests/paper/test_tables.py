"""Tables and figures of small studies: as they were, as printed, and against what they
are made from."""

import csv
import io
import re
from dataclasses import replace
from functools import cache
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from arms import THREE, write_urdf
from committed import MADE, RESULTS, as_kept, differences
from random_robots import repeating_run, states
from studies import MeasuredStudy, SimulatedStudy

from sdp_vs_penalty import InputError, Measurements, load_problem
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.paper import figures
from sdp_vs_penalty.paper.figures import FIGURES, make_figures, save
from sdp_vs_penalty.paper.figures.style import legend_below, new_figure
from sdp_vs_penalty.paper.tables import (
    DEFAULT_TABLES,
    Study,
    build_tables,
    emps,
    make_tables,
    study,
    table_v,
    wrenches,
)
from sdp_vs_penalty.paper.tables.table_i import exact_rows, fit_sigmoid, residual_rms
from sdp_vs_penalty.problem import published_links
from sdp_vs_penalty.regression.base_parameters import base_parameters
from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.simulation import engine_types, experiment
from sdp_vs_penalty.solvers import Slice

#: Tables of a small study of each problem, and what it compares: whose optimum is one
#: point.
SMALL = {
    "panda": ("I", "II", "III", "IV", "V", "VIII", "IX", "errata"),
    "two_link": ("III", "IV", "VI", "VII", "VIII", "IX", "methods", "wrenches", "data"),
    "measured": ("III", "IV", "VIII"),
}
METHODS = {
    "ols": "ols",
    "lmi_sdp": "lmi-sdp",
    "lmi_sdp_joint": "lmi-sdp-plain, joint prior",
}


#: Figures that draw every physics engine.
ENGINES = (5, 6)
#: Figures and tables that take a second and more each; of figures those with engines, an
#: area and many panels, since all have one style. The others are slow.
LONG_FIGURES = (2, 5, 8, 9)
SLOW_FIGURES = (1, 3, 6, 7, 10)
LONG_TABLES = ("I", "II", "methods", "data")
#: What another problem's table of the same number shows as well; test_labels.py makes one.
SLOW_CASES = [(p, "IV") for p in SMALL] + [("panda", "VIII"), ("panda", "IX")]


@pytest.fixture(scope="module")
def studies():
    pytest.importorskip("matplotlib")
    small = {
        "duration": 0.2,
        "instants": 3,
        "retrievals": 2,
        "replicates": 1,
        "iterations": 1,
    }
    with pytest.MonkeyPatch.context() as patch:
        effort = replace(study.BUDGETS["quick"], evaluations=200, **small)
        patch.setitem(study.BUDGETS, "quick", effort)
        patch.setattr("sdp_vs_penalty.estimators.PenaltyPaper.runs", 2)
        patch.setattr(study, "METHODS", METHODS)
        patch.setattr("sdp_vs_penalty.paper.tables.unseen._MOST_WINDOWS", 2)
        made = {n: SimulatedStudy(load_problem(n)) for n in ("panda", "two_link")}
        yield made | {"measured": MeasuredStudy(load_problem("two_link"))}


@pytest.fixture(scope="module")
def made(studies, tmp_path_factory):
    """A table of a small study, made when it is asked for first, whatever real runs are
    at hand."""
    empty = str(tmp_path_factory.mktemp("empty"))

    @cache
    def table(problem, name):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("SDP_VS_PENALTY_DATA", empty)
            return build_tables([name], studies[problem])[0]

    return table


@pytest.fixture
def without_data(tmp_path, monkeypatch):
    """A machine on which no real run is at hand."""
    (tmp_path / "empty").mkdir()
    monkeypatch.setenv("SDP_VS_PENALTY_DATA", str(tmp_path / "empty"))


def skip_without_engines():
    """Snapshots that name the physics engines need all of them."""
    for name, kind in engine_types().items():
        if kind.version() is None:
            pytest.skip(f"{name} is not installed: {kind.install}")


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("problem", "name"), [(p, name) for p in SMALL for name in SMALL[p]]
)
def test_a_table_is_as_it_was(problem, name, made):
    if name == "V":
        skip_without_engines()
    table = made(problem, name)
    free = (
        r"seconds|inverse|smallest|violat"
        if name == "methods"
        else r"^$|inverse|lmi_sdp_joint|in_box"
    )
    frame = table.frame.loc[:, ~table.frame.columns.str.contains(free)]
    if name in ("methods", "data"):  # a search by chance; a flat set of optima
        frame = frame[~frame["method"].str.contains("paper|penalty$|plain$|ols$")]
    as_kept(f"{problem}_{name}.md", replace(table, rows=frame).form.markdown())
    assert table.measured == (problem == "measured")


@pytest.mark.long
def test_engines_follow_a_recorded_run(studies):
    """What is left of the torque is the run's noise, and what links and friction fitted
    to it miss."""
    for run in table_v.measured_runs(studies["measured"]).values():
        if not isinstance(run, str):
            assert np.all(run.error.std(axis=0) < 0.15)
            assert np.all(np.abs(run.error.mean(axis=0)) < 0.02)
            assert run.position.max() < 1e-3


def test_halves_are_before_the_cut_and_after_it():
    first, second = study.halves(repeating_run(load_problem("two_link"), 0, 0.2))
    assert (first.t[0], first.t[-1], second.t[0]) == pytest.approx(
        (0.0, 14.0, 14.2), abs=0.011
    )


def shown(figure):
    """What a figure shows, in words and numbers: its title, the names of its lines, and of
    each panel titles, labels, limits and how much is drawn."""
    yield figure.get_suptitle()
    lines = [line for axis in figure.axes for line in axis.get_lines()]
    assert all(np.all(np.isfinite(line.get_ydata())) for line in lines)
    names = {str(line.get_label()) for line in lines}
    yield ", ".join(sorted(x for x in names if not x.startswith("_")))
    for axis in figure.axes:
        words = (axis.get_title(), axis.get_xlabel(), axis.get_ylabel())
        yield "; ".join([*words, axis.get_yscale()])
        limits = " ".join(f"{x:.4g}" for x in (*axis.get_xlim(), *axis.get_ylim()))
        yield f"{limits}; {len(axis.get_lines())} lines, {len(axis.collections)} areas"


@pytest.mark.nightly
@pytest.mark.parametrize("number", sorted(FIGURES))
def test_a_figure_is_as_it_was(number, studies, tmp_path):
    if number in ENGINES:
        skip_without_engines()
    home, draw = FIGURES[number]
    figure = draw(studies[home.PROBLEM])
    as_kept(f"figure_{number}.txt", "\n".join(shown(figure)) + "\n")


def check_room(figure):
    """All texts lie on the figure, and no axes with its texts reaches into another one,
    into the title or into the legend."""
    from matplotlib.transforms import Bbox

    boxes = [axis.get_tightbbox() for axis in figure.axes]
    boxes += [legend.get_window_extent() for legend in figure.legends]
    boxes += [text.get_window_extent() for text in figure.texts]
    for box in boxes:
        assert figure.bbox.x0 <= box.x0 <= box.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= box.y0 <= box.y1 <= figure.bbox.y1
    for one, other in combinations(boxes, 2):
        overlap = Bbox.intersection(one, other)
        assert overlap is None or min(overlap.width, overlap.height) < 2.0  # pixels


@pytest.mark.long
@pytest.mark.parametrize("size", [1234567.0, pytest.param(1.0, marks=pytest.mark.slow)])
def test_texts_have_their_room(size, tmp_path):
    figure, axes = new_figure(3, 2, 5.0, sharex=True)
    for k, axis in enumerate(axes.flat):
        axis.plot([0.0, size], [-size, size / (k + 1)], label="a line of the legend")
        axis.set_ylabel(f"joint {k}\ntorque [N m]")
        axis.set_xlabel("time [s]" if k > 3 else "")
    axes[0, 1].set_title("title of a column")
    axes[2, 1].set_yscale("symlog", linthresh=1e-3 * size)
    legend_below(figure, axes[0, 0])
    figure.suptitle("title of the figure\nin two lines")
    save(figure, tmp_path / "figure")
    check_room(figure)
    left = {axis.yaxis.label.get_window_extent().x0 for axis in axes[:, 0]}
    assert max(left) - min(left) < 1e-6  # on one line


@pytest.mark.parametrize(
    "number",
    [
        pytest.param(
            k,
            marks=[pytest.mark.long] * (k in LONG_FIGURES)
            + [pytest.mark.slow] * (k in SLOW_FIGURES),
        )
        for k in sorted(FIGURES)
    ],
)
def test_a_figure_labels_units_has_room_and_is_written(number, studies, tmp_path):
    home, draw = FIGURES[number]
    figure = draw(studies[home.PROBLEM])
    assert list(shown(figure))
    for axis in figure.axes:
        for label in (axis.get_xlabel(), axis.get_ylabel()) if axis.axison else ():
            assert not label or "[" in label, "a label without its unit"
    png, pdf = save(figure, tmp_path / f"figure_{number}")
    check_room(figure)
    assert png.read_bytes().startswith(b"\x89PNG")
    assert pdf.read_bytes().startswith(b"%PDF")


@pytest.fixture(scope="module")
def whole():
    """What the tables of a problem share is made once."""
    return {name: Study(load_problem(name)) for name in ("panda", "two_link", "emps")}


@pytest.mark.reproduce
@pytest.mark.skipif(not RESULTS.is_dir(), reason="not a checkout: no results/")
@pytest.mark.parametrize(("problem", "name", "folder"), MADE, ids=str)
def test_tables_come_out_as_committed(whole, problem, name, folder):
    (table,) = build_tables([name], whole[problem])
    assert not differences(table, folder)


@pytest.mark.parametrize(
    ("problem", "name"),
    [
        pytest.param(
            p,
            name,
            marks=[pytest.mark.long] * (name in LONG_TABLES)
            + [pytest.mark.slow] * ((p, name) in SLOW_CASES),
        )
        for p in SMALL
        for name in SMALL[p]
    ],
)
def test_all_three_forms_hold_the_same_cells(problem, name, made):
    table = made(problem, name)
    form = table.form
    cells = form.cells()
    read = list(csv.reader(io.StringIO(form.csv())))
    for row, exact, shown in zip(table.frame.to_numpy(), read[1:], cells, strict=True):
        for cell, kept, rounded in zip(row, exact, shown, strict=True):
            if isinstance(cell, float) and np.isfinite(cell):
                assert float(kept) == cell  # all digits: to compute with
            else:
                assert kept == rounded
    body = [line for line in form.markdown().splitlines() if line.startswith("| ")][2:]
    plain = [[c.strip() for c in re.split(r"(?<!\\)\|", line)[1:-1]] for line in body]
    assert plain == [[c.replace("|", "\\|") for c in row] for row in cells]
    lines = [line for line in form.latex().splitlines() if line.endswith(r" \\")][1:]
    assert [line.count(" & ") for line in lines] == [
        len(table.frame.columns) - 1
    ] * len(cells)


def test_files_of_the_names_asked_for_are_written(tmp_path, without_data, studies):
    out = tmp_path / "new"
    ((_, paths),) = make_tables(["viii"], problem="two_link", out=out)
    assert [p.name for p in paths] == [
        "table_VIII.csv",
        "table_VIII.md",
        "table_VIII.tex",
        "table_VIII_all.csv",
    ]
    assert sorted(p.name for p in out.iterdir()) == sorted(p.name for p in paths)


@pytest.mark.long
def test_any_urdf_has_tables_too(tmp_path, studies):
    urdf = write_urdf(tmp_path / "arm.urdf", "arm", THREE[1:])
    made = build_tables(None, SimulatedStudy(load_problem(urdf)))
    assert [table.name for table in made] == list(DEFAULT_TABLES)
    assert "the problem's nominal links" in made[0].caption


@pytest.mark.real_data
def test_the_authors_own_bound_contradicts_table_eight(panda):
    (table,) = build_tables(["errata"], Study(panda))
    assert table.frame["what_shows_it"][6] == "the authors' file reads c5z,-0.35,0.05"


def test_measured_tables_are_not_replaced_by_others(tmp_path, without_data):
    """Without the real run, tables go beside what is measured, and say what they are."""
    held = "estimate,joint_1,data\nols_measured,0.5,measured\n"
    (tmp_path / "table_VI.csv").write_text(held)
    made = make_tables(["VI"], "two_link", out=tmp_path)
    assert (tmp_path / "table_VI.csv").read_text() == held
    ((table, paths),) = made
    assert {path.parent for path in paths} == {tmp_path / "simulated"}
    assert not table.measured
    assert len(table.lines()) == 3
    (tmp_path / "table_VI.csv").write_text("i,a\n1,0.1\n")
    ((_, paths),) = make_tables(["VI"], "two_link", out=tmp_path)
    assert {path.parent for path in paths} == {tmp_path}


def test_the_cart_of_the_benchmark_sticks_and_slides():
    """Below Coulomb friction it stays; above, it slides at (F - F_c - offset) / F_v,
    and stops again."""
    constants = (100.0, 200.0, 20.0, -3.0, 0.0)
    t = np.arange(0.0, 12.0, 1e-3)
    force = np.where(t < 2.0, 16.0, np.where(t < 8.0, 57.0, 0.0))[:, None]
    q = emps.simulated(Measurements(t, np.zeros((len(t), 1)), force), constants)
    speed = np.gradient(q, t)
    assert np.all(q[t < 2.0] == 0.0)
    assert speed[7900] == pytest.approx((57.0 - 20.0 + 3.0) / 200.0, rel=1e-4)
    assert np.all(speed[-1000:] == 0.0)


def test_without_noise_table_one_is_recovered(panda):
    x = experiment(panda)
    t = np.arange(0.0, x.trajectory.duration, 0.05)
    motion = Motion(t, *x.trajectory.states(t))
    rows = exact_rows(motion, x.torque(motion))
    fit = fit_sigmoid(panda, rows)
    assert np.abs(fit.phi / x.friction - 1.0).max() < 1e-6
    assert residual_rms(panda, [rows], fit).max() < 1e-9


def links_slice(problem, links):
    model = problem.model("rigid_body")
    base, _ = base_parameters(model)
    bound = problem.parameter_bound(model)
    return Slice(problem.constraints(model), base, links.ravel(), bound)


@pytest.mark.parametrize(
    ("name", "column"), [("two_link", "p_real"), ("panda", "p_hat")]
)
def test_wrenches_are_those_of_recursive_newton_euler(name, column):
    problem = load_problem(name)
    robot = problem.robot
    links = published_links(problem, column)
    q, dq, ddq = states(robot, 5)
    made = wrenches.wrench_regressor(robot, q, dq, ddq) @ links.ravel()
    model = robot.pinocchio_model(links)
    data = model.createData()
    for k in range(5):
        pin.rnea(model, data, q[k], dq[k], ddq[k])
        reference = np.array([data.f[j + 1].vector for j in range(robot.n)])
        assert np.abs(made[k] - reference).max() < 1e-10


def test_interval_contains_the_truth_and_is_certified(two_link):
    real = published_links(two_link, "p_real")
    Y = wrenches.wrench_regressor(two_link.robot, *states(two_link.robot, 3))
    intervals = wrenches.wrench_intervals(links_slice(two_link, real), Y)
    true = Y @ real.ravel()
    assert np.all(intervals.lower_bound <= true)
    assert np.all(true <= intervals.upper_bound)
    assert np.all(intervals.lower_bound <= intervals.lower)
    assert np.all(intervals.upper <= intervals.upper_bound)
    assert intervals.slack < 1e-6


def test_a_direction_that_was_solved_for_is_read(two_link, monkeypatch):
    real = published_links(two_link, "p_real")
    feasible = links_slice(two_link, real)
    slope = np.random.default_rng(0).normal(size=20)
    first = feasible.minimum(slope)
    monkeypatch.delattr(Slice, "_solve")
    again = feasible.minimum(3.0 * slope)
    assert again.value == pytest.approx(3.0 * first.value)
    assert again.bound <= again.value
    assert again.bound == pytest.approx(3.0 * first.bound)


def test_a_slice_without_interior_is_refused(two_link):
    impossible = published_links(two_link, "p_real")
    impossible[
        1, 9
    ] = -5.0  # Izz2 is identifiable: no feasible parameters have these torques
    with pytest.raises(InputError, match="strictly inside all constraints"):
        links_slice(two_link, impossible)


def test_figures_of_one_problem_share_a_study(tmp_path, monkeypatch):
    studies = []

    def draw(study):
        studies.append(study)
        return new_figure(1, 1, 2.0)[0]

    one, other = (SimpleNamespace(PROBLEM=name) for name in ("two_link", "panda"))
    known = {1: (one, draw), 2: (other, draw), 3: (one, draw)}
    monkeypatch.setattr(figures, "FIGURES", known)
    paths = make_figures([3, 2, 1], tmp_path)
    names = [f"figure_{n}.{form}" for n in (3, 2, 1) for form in ("png", "pdf")]
    assert [path.name for path in paths] == names
    assert all(path.is_file() for path in paths)
    assert studies[0] is studies[2] is not studies[1]
