"""Tables as data and files; the published columns verbatim; ours against what they are made from."""

from __future__ import annotations

import csv
import io
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sdp_vs_penalty import InputError, Measurements, Problem, load_problem
from sdp_vs_penalty.estimators import Estimator, estimator_types
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdpEntropic
from sdp_vs_penalty.estimators.ols import Ols, condition_number, standard_deviations
from sdp_vs_penalty.estimators.penalty_paper import PenaltyPaper
from sdp_vs_penalty.estimators.task import make_task
from sdp_vs_penalty.paper.tables import DEFAULT_TABLES, build_tables, emps, make_tables
from sdp_vs_penalty.paper.tables import study as study_module
from sdp_vs_penalty.paper.tables.data import training_windows
from sdp_vs_penalty.paper.tables.study import METHODS, Study
from sdp_vs_penalty.paper.tables.table import (
    Column,
    Table,
    escape_latex,
    number_column,
    plain_number,
    text,
)
from sdp_vs_penalty.problem.published import barycentric_names
from sdp_vs_penalty.regression.regression import LeastSquares, compress, triangular
from sdp_vs_penalty.robot import inertia


class SmallStudy(Study):
    """The same tables with two short runs of the annealing."""

    def estimator(self, method: str) -> Estimator:
        made = super().estimator(method)
        return type(made)(runs=2, evaluations=200) if isinstance(made, PenaltyPaper) else made


@pytest.fixture
def without_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine on which no real run is at hand."""
    (tmp_path / "empty").mkdir()
    monkeypatch.setenv("SDP_VS_PENALTY_DATA", str(tmp_path / "empty"))


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str], Table]:
    """The paper's comparison tables of both problems, simulated only."""
    found = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SDP_VS_PENALTY_DATA", str(tmp_path_factory.mktemp("empty")))
        for name, more in (("panda", ["errata"]), ("two_link", ["VII", "methods"])):
            for table in build_tables([*DEFAULT_TABLES, *more], SmallStudy(load_problem(name))):
                found[name, table.name] = table
    return found


def rows(table: Table) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(table.csv())))


@pytest.mark.parametrize("name", ["III", "IV", "VIII", "IX"])
def test_published_cells_come_first_and_as_printed(
    tables: dict[tuple[str, str], Table], panda: Problem, name: str
) -> None:
    printed = panda.published[f"table_{name}"]
    made = tables["panda", name]
    header = list(printed[0])
    assert [c.name for c in made.columns][: len(header)] == header
    ours = rows(made)
    for published, row in zip(printed, ours, strict=False):
        assert {key: row[key] for key in header} == published
    if name in ("VIII", "IX"):
        assert len(ours) == len(printed)


def test_ours_follow_under_the_names_of_the_methods(tables: dict[tuple[str, str], Table]) -> None:
    for name in ("III", "VIII", "IX"):
        columns = [c.name for c in tables["panda", name].columns]
        assert [f"{m}_simulated" for m in METHODS] == [c for c in columns if c[:-10] in METHODS]
        assert not [c for c in columns if c.endswith("_measured")]
    estimates = [row["estimate"] for row in rows(tables["panda", "IV"])]
    assert [f"{m}_simulated" for m in METHODS] == [e for e in estimates if e[:-10] in METHODS]


def test_a_missing_dataset_is_said(tables: dict[tuple[str, str], Table]) -> None:
    for (_, name), table in tables.items():
        if name in (*DEFAULT_TABLES, "VII"):
            assert "Nothing is measured" in table.caption
            assert "simulated" in table.caption


def test_tables_three_eight_and_nine_are_one_robot(
    tables: dict[tuple[str, str], Table], panda: Problem, without_data: None
) -> None:
    """pi of the links in VIII and IX is III, method by method, to the digits printed."""
    study = Study(panda)
    links = rows(tables["panda", "VIII"]) + rows(tables["panda", "IX"])
    pi = rows(tables["panda", "III"])
    for column in ("true_simulated", "lmi_sdp_simulated", "penalty_simulated"):
        value = {row["parameter"]: float(row[column]) for row in links}
        barycentric = [[value[name] for name in barycentric_names(k)] for k in range(1, 8)]
        got = study.base @ inertia.standard_from_barycentric(barycentric).ravel()
        expected = [float(row[column]) for row in pi[:43]]
        np.testing.assert_allclose(got, expected, atol=2e-3)


@pytest.mark.parametrize("problem", ["panda", "two_link"])
def test_links_read_back_from_csv_satisfy_what_they_satisfied(
    tables: dict[tuple[str, str], Table], problem: str, without_data: None
) -> None:
    """With all digits of the files; with the four that are shown they do not."""
    study = Study(load_problem(problem))
    task = study.task(study.simulated)
    both = [tables[problem, name] for name in ("VIII", "IX")]
    columns = [c.name for c in both[0].columns]
    for column, method in (
        ("lmi_sdp_plain_simulated", "lmi-sdp-plain"),
        ("lmi_sdp_simulated", "lmi-sdp"),
    ):
        own = study.result(method, study.simulated).theta
        parts = [dict(zip(columns, row, strict=True)) for t in both for row in t.cells()]
        violations = []
        for read in ([row for t in both for row in rows(t)], parts):
            value = {row["parameter"]: float(row[column]) for row in read}
            links = range(1, study.problem.robot.n + 1)
            barycentric = [[value[name] for name in barycentric_names(k)] for k in links]
            theta = own.copy()
            theta[task.links] = inertia.standard_from_barycentric(barycentric)
            violations.append(max(task.constraints.worst(theta).values()))
        assert violations[0] < max(task.constraints.worst(own).values()) + 1e-12
        if method == "lmi-sdp-plain":  # whose links lie on the boundary
            assert violations[1] > 1e-7


def test_judged_by_the_noise_that_is_left(tables: dict[tuple[str, str], Table]) -> None:
    by_name = {row["estimate"]: row for row in rows(tables["panda", "IV"])}
    truth = float(by_name["p_hat_table_I_simulated"]["relative_error_percent"])
    for method in set(METHODS) - {"penalty_paper"}:  # which is cut short here
        assert truth < float(by_name[f"{method}_simulated"]["relative_error_percent"]) < 5.0 * truth
    # delta is another robot than the simulated one, and it shows.
    assert float(by_name["delta_simulated"]["relative_error_percent"]) > 5.0 * truth


def test_both_methods_reproduce_the_toy_robot(tables: dict[tuple[str, str], Table]) -> None:
    for row in rows(tables["two_link", "III"])[:8]:
        for method in ("penalty", "lmi_sdp"):
            assert float(row[f"{method}_simulated"]) == pytest.approx(float(row["pi_p_real"]), abs=0.01)
    by_name = {row["estimate"]: row for row in rows(tables["two_link", "IV"])}
    floor = float(by_name["p_real_simulated"]["relative_error_percent"])
    for method in ("penalty", "lmi_sdp"):
        assert float(by_name[f"{method}_simulated"]["relative_error_percent"]) < 1.05 * floor


def test_penalty_and_sdp_agree_but_for_the_prior(tables: dict[tuple[str, str], Table]) -> None:
    """Given the same they meet within 0.01 % (tests/estimators/test_penalty.py)."""
    by_name = {row["estimate"]: row for row in rows(tables["panda", "IV"])}
    one, other = (
        float(by_name[f"{m}_simulated"]["relative_error_percent"]) for m in ("penalty", "lmi_sdp")
    )
    assert one == pytest.approx(other, rel=0.01)


def test_all_three_forms_hold_the_same_cells(tables: dict[tuple[str, str], Table]) -> None:
    for table in tables.values():
        cells = table.cells()
        read = list(csv.reader(io.StringIO(table.csv())))
        for row, exact, shown in zip(table.rows, read[1:], cells, strict=True):
            for cell, kept, rounded in zip(row, exact, shown, strict=True):
                if isinstance(cell, float) and np.isfinite(cell):
                    assert float(kept) == cell  # all digits: to compute with
                else:
                    assert kept == rounded
        body = [line for line in table.markdown().splitlines() if line.startswith("| ")][2:]
        plain = [[c.strip() for c in re.split(r"(?<!\\)\|", line)[1:-1]] for line in body]
        assert plain == [[c.replace("|", "\\|") for c in row] for row in cells]
        lines = [line for line in table.latex().splitlines() if line.endswith(r" \\")][1:]
        assert [line.count(" & ") for line in lines] == [len(table.columns) - 1] * len(cells)


def test_latex_has_no_bare_special_characters(tables: dict[tuple[str, str], Table]) -> None:
    for table in tables.values():
        source = table.latex()
        assert source.isascii()
        for line in source.splitlines():
            if line.startswith("%"):
                continue
            unescaped = re.sub(r"\\[_%&#$]", "", line.split(r"\label")[0])
            assert not re.search(r"[_#]", unescaped.replace("{!}{%", "")), line


def test_escaping_and_number_columns() -> None:
    assert escape_latex(r"a_b 5 % & ^ { \x") == (r"a\_b 5 \% \& \textasciicircum{} \{ \textbackslash{}x")
    assert number_column(["-12.345", "1.2e-05", "", "inf"]) == "S[table-format=-2.3e-1]"
    assert number_column(["3", "14"]) == "S[table-format=2.0]"
    assert plain_number("5.4615e-01") == "0.54615"
    assert plain_number("-2.991e-05") == "-0.00002991"
    assert plain_number("3e-10") == "3e-10"
    assert plain_number("inf") == "inf"
    assert text(-0.0) == "0"
    assert text(float("nan")) == ""
    assert text("-1.0517e-02") == "-1.0517e-02"
    with pytest.raises(ValueError, match="2 cells in 1 columns"):
        Table("X", "x", "x", (Column("a"),), (("1", "2"),))


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is absent")
def test_latex_compiles(tables: dict[tuple[str, str], Table], tmp_path: Path) -> None:
    body = "\n".join(table.latex() + r"\clearpage" for table in tables.values())
    packages = r"\documentclass{article}\usepackage{array,booktabs,siunitx,graphicx}"
    source = packages + r"\begin{document}" + body + r"\end{document}"
    (tmp_path / "all.tex").write_text(source)
    done = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "all.tex"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:]


def test_files_of_the_names_asked_for_are_written(tmp_path: Path, without_data: None) -> None:
    out = tmp_path / "new"
    ((_, paths),) = make_tables(["viii"], problem="two_link", out=out)
    assert [p.name for p in paths] == ["table_VIII.csv", "table_VIII.md", "table_VIII.tex"]
    assert sorted(p.name for p in out.iterdir()) == sorted(p.name for p in paths)


def test_unknown_names_are_refused_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="table 'XII' is unknown"):
        make_tables(["III", "XII"], out=tmp_path / "new")
    with pytest.raises(InputError, match="belongs to two_link"):
        make_tables(["VII"], problem="panda", out=tmp_path / "new")
    with pytest.raises(InputError, match="budget 'huge' is unknown"):
        make_tables(["III"], budget="huge", out=tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_any_urdf_has_tables_too(tmp_path: Path, without_data: None) -> None:
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(
        """<robot name="arm"><link name="base"/><link name="a"/><link name="b"/>
        <joint name="j1" type="revolute"><parent link="base"/><child link="a"/>
          <axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="1" effort="9"/></joint>
        <joint name="j2" type="revolute"><parent link="a"/><child link="b"/>
          <origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
          <limit lower="-2" upper="2" velocity="1" effort="9"/></joint></robot>"""
    )
    made = build_tables(None, SmallStudy(load_problem(urdf)))
    assert [table.name for table in made] == list(DEFAULT_TABLES)
    assert "the problem's nominal links" in made[0].caption


@pytest.mark.real_data
def test_real_data_add_measured_columns(panda: Problem) -> None:
    study = SmallStudy(panda)
    three, four = build_tables(["III", "IV"], study)
    assert {f"{m}_measured" for m in METHODS} <= {c.name for c in three.columns}
    measured = {row["coefficient"]: row for row in rows(three)}
    # The paper's figures for this run: condition number 121.88, relative error 1.41 %.
    assert 90.0 < float(measured["condition number"]["ols_measured"]) < 140.0
    assert 0.9 < float(measured["relative error [%]"]["ols_measured"]) < 1.5
    assert measured["condition number"]["re_simulated"].startswith("48.9")
    # Large base parameters agree with the published least squares within a few percent.
    large = [r for r in rows(three)[:43] if abs(float(r["pi_CLS"])) > 0.4]
    assert len(large) == 8
    for row in large:
        assert float(row["ols_measured"]) == pytest.approx(float(row["pi_CLS"]), rel=0.06)
    by_name = {row["estimate"]: float(row["relative_error_percent"] or "nan") for row in rows(four)}
    assert by_name["lmi_sdp_measured"] < 1.06 * by_name["ols_measured"]
    for published in ("p_hat", "delta", "p_hat_table_I"):
        assert by_name[f"{published}_measured"] > by_name["lmi_sdp_measured"]


def test_each_estimate_is_computed_once(without_data: None, monkeypatch: pytest.MonkeyPatch) -> None:
    study = SmallStudy(load_problem("two_link"))
    calls = []
    real = study_module.certify

    def counted(*arguments: Any) -> Any:
        calls.append(1)
        return real(*arguments)

    monkeypatch.setattr(study_module, "certify", counted)
    build_tables(["III", "IV", "VIII", "IX"], study)
    assert len(calls) == len(METHODS)


def test_standard_deviations_are_those_of_repeated_experiments(two_link: Problem) -> None:
    """Against the spread of estimates over many draws of the noise, oversampling included."""
    study = Study(two_link)
    task = study.task(study.simulated)
    rng = np.random.default_rng(0)
    rows_y = np.vstack([task.data.R] * 3)
    theta = study.experiment.links.ravel()
    sigma, estimates, predicted = 0.05, [], []
    for _ in range(400):
        tau = rows_y @ theta + rng.normal(0.0, sigma, len(rows_y))
        # Every row twice: what oversampling by 2 does, exactly.
        r = triangular([np.column_stack([np.vstack([rows_y] * 2), np.tile(tau, 2)])])
        floor, size = float(r[20, 20]), float(r[:, 20] @ r[:, 20])
        data = LeastSquares(r[:20, :20], r[:20, 20], floor, size, 2 * len(tau))
        drawn = replace(task, data=data)
        pi, std = standard_deviations(drawn, 2.0)
        np.testing.assert_allclose(pi, task.base @ Ols().fit(drawn).theta, atol=1e-12)
        estimates.append(pi)
        predicted.append(std)
    spread = np.std(estimates, axis=0)
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(predicted), axis=0)), spread, rtol=0.12)


def test_what_is_not_excited_has_no_standard_deviation(two_link: Problem) -> None:
    study = Study(two_link)
    task = study.task(study.simulated)
    w = task.data.R @ np.linalg.pinv(task.base)
    w[:, 2] = 0.0
    hidden = replace(task.data, R=w @ task.base)
    _, std = standard_deviations(replace(task, data=hidden), 2.0)
    assert np.isinf(std[2])
    assert np.all(np.isfinite(np.delete(std, 2)))
    assert condition_number(replace(task, data=hidden)) > 1e12


def test_a_prior_adds_its_quadratic_and_nothing_else(two_link: Problem) -> None:
    study = Study(two_link)
    data = study.task(study.simulated).data
    rng = np.random.default_rng(1)
    scale = np.where(rng.random(20) < 0.5, np.inf, rng.uniform(0.1, 3.0, 20))
    for theta in rng.normal(size=(5, 20)):
        expected = data.loss(theta) + 2.5 * np.sum((theta / scale) ** 2)
        assert data.with_prior(scale, 2.5).loss(theta) == pytest.approx(expected, rel=1e-12)


def test_a_second_of_motion_needs_a_prior_on_friction(panda: Problem) -> None:
    """Where a joint does not reverse, Coulomb friction and offset have the same column."""
    study = Study(panda)
    data = study.simulated
    blocks = compress(data.train, data.model, data.preprocessing, blocks_per_run=21)
    task = make_task(panda, data.model, blocks.select([4]))
    assert task.joint_scale is not None
    rigid = data.model.rigid_indices
    assert np.all(np.isinf(task.joint_scale[rigid]))
    names = [p.name for p in data.model.parameters]
    offset, torque = names.index("f_o1"), blocks.select([4]).per_joint[0].triangle[:, -1]
    root_mean_square = np.linalg.norm(torque) / np.sqrt(blocks.select([4]).joint_rows()[0])
    assert task.joint_scale[offset] == pytest.approx(root_mean_square, rel=1e-6)
    pulled = LmiSdpEntropic().fit(task).theta
    _, error = data.errors(pulled)
    assert error < 30.0
    friction = np.delete(np.abs(pulled) / task.joint_scale, rigid)
    assert friction.max() < 3.0


def test_every_method_has_its_row_in_the_method_table(tables: dict[tuple[str, str], Table]) -> None:
    by_name = {row["method"]: row for row in rows(tables["two_link", "methods"])}
    assert set(by_name) == set(estimator_types())
    assert float(by_name["lmi-sdp-plain"]["excess_loss_percent"]) < 1e-4  # its bound is its optimum
    assert float(by_name["penalty"]["excess_loss_percent"]) < 0.1
    assert by_name["penalty"]["feasible_runs"] == by_name["penalty"]["runs"]
    assert float(by_name["lmi-sdp-thickness"]["smallest_thickness_mm"]) > 19.9
    assert by_name["penalty-paper"]["runs"] == "2"
    # The SDP gets a consequence of the bounds on inertias only, and the table says what came of it.
    assert by_name["lmi-sdp-plain"]["violated_family"] == "barycentric inertia"
    assert by_name["penalty"]["violated_family"] == ""
    for row in by_name.values():
        low, high = (float(row[f"run_excess_loss_percent_{k}"] or 0.0) for k in ("min", "max"))
        assert low <= high
        assert 0.0 <= float(row["positive_definite_percent"]) <= 100.0


def test_errata_are_listed_with_the_numbers_that_show_them(
    tables: dict[tuple[str, str], Table],
) -> None:
    by_number = {row["number"]: row["what_shows_it"] for row in rows(tables["panda", "errata"])}
    assert list(by_number) == [str(k) for k in range(1, 9)]
    assert "0.0271 from the printed value, 0.0276 from the corrected one" in by_number["1"]
    assert by_number["2"].endswith("0.0247 - 0.0322 = -0.0075")
    assert "Izz2 - 0.64 m2" in by_number["3"]
    assert "0.750 m > r1" in by_number["4"]
    assert "(0.9896); with it, 1.3341" in by_number["5"]
    assert "-2.2e-05" in by_number["6"]
    assert "-1.9e-05" in by_number["6"]
    assert "not checked in this run" in by_number["7"]
    assert by_number["8"] == "row 8: -0.0001 and row 24: 0.0008"


@pytest.mark.real_data
def test_the_authors_own_bound_contradicts_table_eight(panda: Problem) -> None:
    (table,) = build_tables(["errata"], Study(panda))
    assert rows(table)[6]["what_shows_it"] == "the authors' file reads c5z,-0.35,0.05"


def test_training_windows_are_whole_and_inside_the_training_part(panda: Problem) -> None:
    data = Study(panda).simulated
    blocks = compress(data.train, data.model, data.preprocessing, blocks_per_run=21)
    for length in (1, 4, 7):
        windows = training_windows(blocks, length)
        assert len(windows) == 6
        assert len({tuple(w) for w in windows}) == 6
        per_window = [blocks.select(w).joint_rows().sum() for w in windows]
        assert min(per_window) > 0.9 * max(per_window)
    assert training_windows(blocks, 30) == []


def test_measured_tables_are_not_replaced_by_others(tmp_path: Path, without_data: None) -> None:
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


@pytest.mark.real_data
def test_folds_of_the_real_run_are_unseen_motion(panda: Problem, data_folder: Path) -> None:
    """Five folds by phase; what repeats is judged far better than what does not."""
    study = SmallStudy(panda)
    assert len(study.folds) == 5
    unseen = study.unseen(lambda fold: study.result("ols", fold).theta)
    assert study.repeated is not None
    repeated = study.repeated.errors(study.result("ols", study.repeated).theta)[1]
    assert unseen.relative > 1.5 * repeated
    assert max(unseen.folds) > unseen.relative > min(unseen.folds)


def test_the_cart_of_the_benchmark_sticks_and_slides() -> None:
    """Below Coulomb friction it stays; above, it slides at (F - F_c - offset) / F_v, and stops again."""
    constants = (100.0, 200.0, 20.0, -3.0, 0.0)
    t = np.arange(0.0, 12.0, 1e-3)
    force = np.where(t < 2.0, 16.0, np.where(t < 8.0, 57.0, 0.0))[:, None]
    q = emps.simulated(Measurements(t, np.zeros((len(t), 1)), force), constants)
    speed = np.gradient(q, t)
    assert np.all(q[t < 2.0] == 0.0)
    assert speed[7900] == pytest.approx((57.0 - 20.0 + 3.0) / 200.0, rel=1e-4)
    assert np.all(speed[-1000:] == 0.0)
