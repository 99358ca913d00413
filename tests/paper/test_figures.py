"""Figures: all of the paper's but the photograph, with units, in colours that all can tell apart."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sdp_vs_penalty import InputError, Measurements, Problem, load_problem
from sdp_vs_penalty.paper import figures
from sdp_vs_penalty.paper.figures import FIGURES, figure_8, make_figures, save
from sdp_vs_penalty.paper.figures.style import BLACK, BLUE, GREEN, LOOKS, ORANGE, PURPLE, RED, SKY
from sdp_vs_penalty.paper.tables import engine_runs, wrench_runs
from sdp_vs_penalty.paper.tables.study import METHODS, Study

pytest.importorskip("matplotlib")


class SimulatedStudy(Study):
    """Without the real run, whether it is at hand or not."""

    run: Measurements | None = None  # type: ignore[assignment]


@pytest.fixture(scope="module")
def studies() -> Iterator[dict[str, Study]]:
    patch = pytest.MonkeyPatch()
    patch.setitem(engine_runs.DURATION, "quick", 0.2)
    patch.setitem(wrench_runs.INSTANTS, "quick", 3)
    patch.setitem(wrench_runs.RETRIEVALS, "quick", 2)
    patch.setattr(wrench_runs, "PENALTY_RUNS", 2)
    # The paper's own method is slow, and the figures need its estimate for nothing but one line.
    patch.setattr(wrench_runs, "METHODS", {k: m for k, m in METHODS.items() if k != "penalty_paper"})
    yield {name: SimulatedStudy(load_problem(name)) for name in ("panda", "two_link")}
    patch.undo()


def test_all_but_the_photograph() -> None:
    assert set(FIGURES) == {1, 2, 3, 5, 6, 7, 8, 9, 10}


@pytest.mark.parametrize("number", sorted(FIGURES))
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


def test_every_joint_is_labelled(studies: dict[str, Study]) -> None:
    import matplotlib.pyplot as plt

    figure = FIGURES[1][1](studies["panda"])
    labels = " ".join(axis.get_ylabel() for axis in figure.axes)
    assert all(f"joint {j}" in labels for j in range(1, 8))
    plt.close(figure)


def test_the_same_numbers_make_the_same_files(studies: dict[str, Study], tmp_path: Path) -> None:
    for folder in ("a", "b"):
        save(FIGURES[9][1](studies["two_link"]), tmp_path / folder / "figure_9")
    for suffix in ("png", "pdf"):
        first, second = ((tmp_path / f / f"figure_9.{suffix}").read_bytes() for f in ("a", "b"))
        assert first == second


#: From linear RGB to what a protanope and a deuteranope see (Machado, Oliveira, Fernandes, IEEE TVCG
#: 2009, severity 1).
_DEFICIENT = {
    "protanopia": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "deuteranopia": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
}


@pytest.mark.parametrize("kind", sorted(_DEFICIENT))
def test_colours_used_together_differ_for_the_colour_blind(kind: str) -> None:
    from matplotlib.colors import to_rgb

    together = [
        [LOOKS[name]["color"] for name in ("measured", "ols", "lmi-sdp", "penalty")],
        [LOOKS[name]["color"] for name in ("MuJoCo", "DART", "ODE", "Bullet", "model")],
        [BLACK, RED, BLUE, GREEN],
        [SKY, ORANGE, RED, BLACK],
    ]
    assert PURPLE in together[1]
    for colours in together:
        seen = [np.clip(np.array(_DEFICIENT[kind]) @ np.array(to_rgb(c)) ** 2.2, 0, 1) for c in colours]
        for one, other in itertools.combinations(seen, 2):
            assert np.linalg.norm(one ** (1 / 2.2) - other ** (1 / 2.2)) > 0.1


@pytest.mark.parametrize(("number", "match"), [(4, "photograph"), (11, "choose from 1, 2, 3, 5")])
def test_other_numbers_are_refused_before_anything_is_made(
    number: int, match: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=match):
        make_figures([8, number], out=tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_shape_without_volume_is_refused(two_link: Problem) -> None:
    flat = tuple(
        replace(cone, radius=0.0, slope=0.0) if cone.link == 1 else cone for cone in two_link.cones
    )
    with pytest.raises(InputError, match="link 2: its shape has no volume"):
        figure_8.radius_profile(replace(two_link, cones=flat), 1)
    with pytest.raises(InputError, match="no shape"):
        figure_8.radius_profile(replace(two_link, cones=()), 0)


def test_files_are_written_where_asked(
    studies: dict[str, Study], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures, "Study", lambda problem, *_: studies[problem.name])
    paths = make_figures([9], out=tmp_path)
    assert [p.name for p in paths] == ["figure_9.png", "figure_9.pdf"]
    assert all(p.is_file() for p in paths)
