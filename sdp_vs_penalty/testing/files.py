"""What every format of measurements and every format of export keeps."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np

from sdp_vs_penalty.api.adding import add
from sdp_vs_penalty.api.identification import identify
from sdp_vs_penalty.data.files import load_measurements, save
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects import standard_effect
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import Options
from sdp_vs_penalty.exporters.interface import ExportFormat, Written
from sdp_vs_penalty.plugins import summary_line
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.testing.demand import demand
from sdp_vs_penalty.testing.robots import measured


@cache
def small_run() -> Measurements:
    """Return ten seconds of two joints, with velocities."""
    return measured(load_problem("two_link"), noise=0.1)


@cache
def models() -> tuple[Estimate, Estimate]:
    """Return a model, and the same with a payload."""
    bare = identify("two_link", small_run(), check=False)
    payload = standard_effect("payload").name
    return bare, add(bare, payload, small_run(), frozen=True)


def check_format_is_declared(home: ModuleType) -> None:
    """A format has suffixes or a pattern of folders, a function that reads, and a
    docstring."""
    suffixes = home.SUFFIXES
    lower = all(x.startswith(".") and x == x.lower() for x in suffixes)
    demand(isinstance(suffixes, tuple) and lower, "SUFFIXES is no tuple like ('.x',)")
    demand(suffixes or hasattr(home, "FOLDER"), "it has neither suffixes nor a FOLDER")
    demand(callable(getattr(home, "read", None)), "it has no function read")
    demand(summary_line(home), "its docstring says nothing")


def check_format_reads_what_it_writes(home: ModuleType) -> None:
    """A run comes back to the last bit, where the format can be written."""
    run = small_run()
    with tempfile.TemporaryDirectory() as folder:
        for suffix in home.SUFFIXES if hasattr(home, "write") else ():
            path = Path(folder) / f"run{suffix}"
            save(run, path)
            again = load_measurements(path, joints=run.n)
            for name in ("t", "q", "dq", "tau"):
                same = np.array_equal(getattr(again, name), getattr(run, name))
                demand(same, f"{name} of {path.name} is not what was written")


def check_format_refuses_what_is_none(home: ModuleType) -> None:
    """An empty file and noise are refused in one sentence."""
    noise = np.random.default_rng(0).bytes(1000)
    with tempfile.TemporaryDirectory() as folder:
        for suffix in home.SUFFIXES:
            for content in (b"", noise, noise[:3]):
                path = Path(folder) / f"run{suffix}"
                path.write_bytes(content)
                try:
                    load_measurements(path, joints=2)
                except InputError:
                    continue
                demand(False, f"it reads {len(content)} bytes of noise as a run")


def check_export_is_declared(home: ExportFormat) -> None:
    """An export has an ending, a file's name with it, and says what it is for."""
    demand(home.FILE.endswith(home.ENDING), "FILE has another ending than ENDING")
    demand(home.ABOUT, "ABOUT says nothing")


def check_export_is_repeatable(home: ExportFormat) -> None:
    """A model is twice the same bytes, and what has no place in it is an effect of the
    model; what it cannot hold at all is refused in one sentence."""
    taken = [x for model in models() if (x := _written(home, model)) is not None]
    demand(taken, "it takes neither a model nor one with a payload")
    for model in models():
        first, second = (_written(home, model) for _ in range(2))
        demand(first == second, "a second export has other bytes")
        texts = {e.brief for e in model.model.effects} | {
            e.name for e in model.model.effects
        }
        lost = set() if first is None else set(first[1])
        demand(lost <= texts, f"it leaves out {lost - texts}, which the model lacks")


def _written(home: ExportFormat, model: Estimate) -> Written | None:
    """Return what a format makes of a model; None where it refuses it."""
    try:
        return home.write(model, Options(None, False, (0.0, 0.0, 0.0)))
    except InputError:
        return None


FORMAT_CONTRACTS: tuple[Callable[..., None], ...] = (
    check_format_is_declared,
    check_format_reads_what_it_writes,
    check_format_refuses_what_is_none,
)
EXPORT_CONTRACTS: tuple[Callable[..., None], ...] = (
    check_export_is_declared,
    check_export_is_repeatable,
)
