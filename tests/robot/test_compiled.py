"""The optional compiled core says what Python says: the same columns, numbers, errors and optima."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sdp_vs_penalty import identify, load_problem
from sdp_vs_penalty.constraints.constraint import BarycentricBound
from sdp_vs_penalty.data.formats import csv_text
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.certify import versions
from sdp_vs_penalty.problem.load import problem_names
from sdp_vs_penalty.robot import compiled
from sdp_vs_penalty.simulation.experiment import experiment

needs_core = pytest.mark.skipif(
    compiled.core() is None, reason="the compiled core (native/) is not installed"
)


@pytest.fixture
def both(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], Any]], tuple[Any, Any]]:
    """What a call gives without and with the compiled core, errors as their text."""

    def told(call: Callable[[], Any]) -> Any:
        try:
            return call()
        except InputError as error:
            return str(error)

    def run(call: Callable[[], Any]) -> tuple[Any, Any]:
        monkeypatch.setenv(compiled.VARIABLE, "off")
        assert compiled.core() is None
        plain = told(call)
        monkeypatch.delenv(compiled.VARIABLE)
        assert compiled.core() is not None
        return plain, told(call)

    return run


@needs_core
@pytest.mark.parametrize("name", problem_names())
def test_the_regressor_is_pinocchios(name: str, both: Any) -> None:
    robot = load_problem(name).robot
    states = np.random.default_rng(1).normal(size=(3, 19, robot.n))
    plain, native = both(lambda: robot.regressor(*states))
    np.testing.assert_allclose(native, plain, rtol=0.0, atol=1e-12 * np.abs(plain).max())


@needs_core
@pytest.mark.parametrize(
    "rows",
    [
        "1,2\n3,4\n",
        "1,2\n3,4",
        "1,2\r\n3,4\r\n",
        " 1 ,\t2\n-3e-3,.5\n",
        "0.1,1e-320\n4.35,2.2250738585072011e-308\n",
        "1,2\n\n",
        "1,2\n\n3,4\n",
        "1,2\n3\n",
        "1,2,3\n",
        "1,two\n",
        "1,1_0\n",
        "nan,inf\n",
        "+1,2\n",
        "1e999,2\n",
        "1;2\n",
        "",
        "1,2\n3,\n",
        "1,0x10\n",
        "1,2\0\n",
    ],
)
def test_the_reader_reads_and_refuses_the_same(rows: str, tmp_path: Path, both: Any) -> None:
    path = tmp_path / "run.csv"
    path.write_bytes(b"a,b\n" + rows.encode())
    plain, native = both(lambda: csv_text.numbers(path, 2))
    if isinstance(plain, str):
        assert native == plain
    else:
        np.testing.assert_array_equal(native, plain, strict=True)


@needs_core
@pytest.mark.parametrize("method", ["lmi-sdp", "lmi-sdp-thickness", "lmi-sdp-plain"])
def test_an_estimate_is_the_same_and_certified_either_way(method: str, both: Any) -> None:
    problem = load_problem("two_link")
    run = experiment(problem).training_run(seed=0)
    plain, native = both(lambda: identify(problem, run, method))
    assert plain.details["solver"] == "clarabel"
    assert native.details["solver"] == "native"
    assert compiled.MODULE in native.provenance["versions"]
    assert compiled.MODULE not in plain.provenance["versions"]
    for estimate in (plain, native):
        families = estimate.certificate.violations.items()
        assert not any(v for family, v in families if family != BarycentricBound.family)
        assert -1e-9 <= estimate.certificate.gap <= 1e-8
    assert native.certificate.upper == pytest.approx(plain.certificate.upper, rel=2e-8)


def test_switched_off_it_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(compiled.VARIABLE, "off")
    assert compiled.core() is None
    assert compiled.MODULE not in versions()
