"""Figures: all of the paper's but the photograph, with units, in colours that all can tell apart."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sdp_vs_penalty import InputError, Measurements, load_problem
from sdp_vs_penalty.estimators.penalty_paper import PenaltyPaper
from sdp_vs_penalty.research import figures
from sdp_vs_penalty.research.figures import FIGURES, make_figures, save
from sdp_vs_penalty.research.tables import study
from sdp_vs_penalty.research.tables.study import METHODS, Study

pytest.importorskip("matplotlib")


class SimulatedStudy(Study):
    """Without the real run, whether it is at hand or not."""

    run: Measurements | None = None  # type: ignore[assignment]


@pytest.fixture(scope="module")
def studies() -> Iterator[dict[str, Study]]:
    patch = pytest.MonkeyPatch()
    small = replace(study.BUDGETS["quick"], duration=0.2, instants=3, retrievals=2)
    patch.setitem(study.BUDGETS, "quick", small)
    patch.setattr(PenaltyPaper, "runs", 2)
    # The paper's own method is slow, and the figures need its estimate for nothing but one line.
    patch.setattr(study, "METHODS", {k: m for k, m in METHODS.items() if k != "penalty_paper"})
    yield {name: SimulatedStudy(load_problem(name)) for name in ("panda", "two_link")}
    patch.undo()


LONG = {n: pytest.param(n, marks=pytest.mark.long) for n in (1, 2, 3, 5, 6, 10)}


@pytest.mark.parametrize("number", [LONG.get(n, n) for n in sorted(FIGURES)])
def test_axes_have_units_and_lines_are_finite(
    number: int, studies: dict[str, Study], tmp_path: Path
) -> None:
    problem, draw = FIGURES[number]
    figure = draw(studies[problem])
    shown = [axis for axis in figure.axes if axis.get_visible() and axis.axison]
    assert shown
    for axis in shown:
        if axis.get_ylabel():
            assert "[" in axis.get_ylabel()
        if axis.get_xlabel():
            assert "[" in axis.get_xlabel()
        for line in axis.get_lines():
            assert np.all(np.isfinite(np.asarray(line.get_ydata(), float)))
    assert sum(bool(axis.get_ylabel()) for axis in shown) >= len(shown) / 4
    png, pdf = save(figure, tmp_path / f"figure_{number}")
    assert png.read_bytes().startswith(b"\x89PNG")
    assert pdf.read_bytes().startswith(b"%PDF")
    assert png.stat().st_size > 20_000


def test_errors_are_drawn_beside_the_torques_that_make_them(studies: dict[str, Study]) -> None:
    axes = FIGURES[9][1](studies["two_link"]).axes
    for torques, errors in zip(axes[::2], axes[1::2], strict=True):
        true, *methods = (np.asarray(line.get_ydata(), float) for line in torques.get_lines())
        assert len(methods) == len(errors.get_lines()) == 2
        for torque, error in zip(methods, errors.get_lines(), strict=True):
            np.testing.assert_allclose(error.get_ydata(), 1e3 * (torque - true), atol=1e-9)


def test_ellipsoids_lie_about_the_links_centres_of_mass(studies: dict[str, Study]) -> None:
    study = studies["two_link"]
    sections = [a for a in FIGURES[8][1](study).axes if "section" in a.get_title()]
    for axis, link in zip(sections, study.experiment.links, strict=True):
        centre = link[1:4] / link[0]
        plane = ["xyz".index(label()[-7]) for label in (axis.get_xlabel, axis.get_ylabel)]
        drawn = [np.array(line.get_data(), float) for line in axis.get_lines()]
        middles = [0.5 * (x.max(axis=1) + x.min(axis=1)) for x in drawn if x.shape[1] == 100]
        assert any(np.allclose(m, centre[plane], rtol=1e-3, atol=1e-3) for m in middles), middles


@pytest.mark.parametrize(("number", "match"), [(4, "photograph"), (11, "choose from 1, 2, 3, 5")])
def test_other_numbers_are_refused_before_anything_is_made(
    number: int, match: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=match):
        make_figures([8, number], out=tmp_path)
    assert not list(tmp_path.iterdir())


def test_files_are_written_where_asked(
    studies: dict[str, Study], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures, "Study", lambda problem, *_: studies[problem.name])
    paths = make_figures([9], out=tmp_path)
    assert [p.name for p in paths] == ["figure_9.png", "figure_9.pdf"]
    assert all(p.is_file() for p in paths)
