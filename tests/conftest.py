"""Fixtures that several test files share."""

import gc
import importlib
import importlib.util
import os
import re
import sys
from pathlib import Path

# Before NumPy is loaded: several workers, each with threads for small matrices, only
# hinder each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Nothing of a test is kept in the user's cache.
os.environ.setdefault("SDP_VS_PENALTY_CACHE", "")
# Nor are projects of the page kept in the folder of the user.
os.environ.setdefault("SDP_VS_PENALTY_PROJECTS", "")

# Where Python is told to write no bytecode, each worker and each command of a test would
# compile the checkout's modules anew: they share it. It lies beside them, as that of other
# packages does, which Python would look for in no other place.
if (
    sys.dont_write_bytecode
    and (spec := importlib.util.find_spec("sdp_vs_penalty"))
    and Path(str(spec.origin)).parents[1] == Path(__file__).parents[1]
    and os.environ.pop("PYTHONDONTWRITEBYTECODE", "")
):
    sys.dont_write_bytecode = False

import pytest

from sdp_vs_penalty import load_measurements, load_problem
from sdp_vs_penalty.records import to_json


def pytest_addoption(parser):
    """Without pytest-xdist its options in pyproject.toml mean nothing."""
    if importlib.util.find_spec("xdist") is None:
        parser.addoption("--numprocesses")
        parser.addoption("--dist")
        parser.addoption("--no-loadscope-reorder", action="store_true")


def real_data_folder():
    """Where the real measurements are: SDP_VS_PENALTY_DATA, or the shared folder beside
    a checkout."""
    named = os.environ.get("SDP_VS_PENALTY_DATA")
    folder = Path(named) if named else Path(__file__).parents[2] / "shared" / "data"
    return folder if folder.is_dir() else None


# An installed package cannot know where this checkout is.
if (found := real_data_folder()) is not None:
    os.environ.setdefault("SDP_VS_PENALTY_DATA", str(found))


#: Files that take longest: a worker that begins one of them last would end last.
LONGEST_FIRST = (
    "test_docs.py",
    "test_diagnosis.py",
    "test_page.py",
    "test_every_problem.py",
    "test_page_work.py",
    "test_payload.py",
    "test_one_voice.py",
    "test_check.py",
    "test_golden.py",
    "test_tables.py",
    "test_corruptions.py",
    "test_printed_commands.py",
    "test_passing.py",
    "test_ratings.py",
    "test_contracts.py",
    "test_shootout.py",
    "test_transformations.py",
    "test_logs.py",
    "test_servo.py",
    "test_equivalence.py",
    "test_challenge.py",
    "test_facts.py",
    "test_contract.py",
    "test_docstrings.py",
    "test_screens.py",
    "test_comparison.py",
    "test_curves.py",
    "test_kills.py",
    "test_splits.py",
    "test_fuzz.py",
    "test_bad_input.py",
    "test_crosstalk.py",
    "test_simulation.py",
    "test_runs_together.py",
)


def pytest_collection_modifyitems(items):
    place = {name: k for k, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: place.get(item.path.name, len(place)))
    if real_data_folder() is None:
        skip = pytest.mark.skip(
            reason="the real measurements are absent: set SDP_VS_PENALTY_DATA"
        )
        for item in items:
            if "real_data" in item.keywords:
                item.add_marker(skip)


def pytest_collection():
    """Of what is collected nothing is garbage before the end: it is not looked through,
    neither now nor in tests."""
    gc.disable()


def pytest_collection_finish():
    """What a test makes is mostly given back without the collector, which looks rarely."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
    gc.enable()


@pytest.fixture(scope="session")
def data_folder():
    """Tests that ask for it are marked as real_data."""
    return Path(os.environ["SDP_VS_PENALTY_DATA"])


@pytest.fixture(scope="session")
def panda_run(data_folder):
    """The 20 544 samples of the paper's identification run."""
    return load_measurements(data_folder / "panda", joints=7)


@pytest.fixture(scope="session")
def panda():
    return load_problem("panda")


@pytest.fixture(scope="session")
def two_link():
    return load_problem("two_link")


@pytest.fixture(scope="session", autouse=True)
def _files_need_not_outlive_a_loss_of_power():
    """No test waits until the disk has what it wrote."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def _issues_say_what_they_mean():
    """Whatever the check says, in any test: no word of Python's, and the joints of its
    figures."""
    from sdp_vs_penalty.checks import Issue

    plain = Issue.__init__

    def told(self, *given, **named):
        plain(self, *given, **named)
        text = " ".join((self.where, self.what, str(self.certainty), self.remedy))
        assert not re.search(r"\b(None|nan|inf)\b", text), text
        joints = self.figures.get("joints", ())
        if 0 < len(joints) <= 2 and not self.where.startswith("all"):
            numbers = {
                int(x) for x in re.findall(r"(?:joints?|q|tau|and) ?(\d+)", self.where)
            }
            assert set(joints) <= numbers, (self.where, joints)

    Issue.__init__ = told
    yield
    Issue.__init__ = plain


@pytest.fixture(scope="session", autouse=True)
def _logs_that_many_tests_check_race_once():
    """The product holds no race twice in one call; here none is held twice in a worker,
    for the same rows of a robot of the same words."""
    from sdp_vs_penalty.race.race import HeldRaces

    outcomes = {}

    class SharedRaces(HeldRaces):
        def hold(self, logs, kinds, is_doubtful):
            robot = repr(to_json(logs[0].problem))
            key = robot, tuple(log.data.digest for log in logs), kinds, is_doubtful
            if key not in outcomes:
                outcomes[key] = super().hold(logs, kinds, is_doubtful)
            return outcomes[key]

    with pytest.MonkeyPatch.context() as patch:
        for home in ("race.race", "checks.check", "checks.fixing", "api.remedies"):
            module = importlib.import_module(f"sdp_vs_penalty.{home}")
            patch.setattr(module, "HeldRaces", SharedRaces)
        yield


@pytest.fixture(scope="session")
def scara_arm(tmp_path_factory):
    from arms import scara

    return load_problem(scara(tmp_path_factory.mktemp("arm")))


@pytest.fixture(scope="session")
def hidden(two_link):
    """Four runs of two joints, the first with pre-sliding hysteresis; of their thousand
    samples a second every fourth, since nothing that is asked of them needs more."""
    from dataclasses import replace

    from sdp_vs_penalty.simulation.hidden_runs import hidden_runs

    effects = [("presliding_hysteresis", [0])]
    made = hidden_runs(two_link, effects, "strong", seed=24)
    runs = tuple(run.rows(slice(None, None, 4)) for run in made.runs)
    return replace(made, runs=runs)


@pytest.fixture(scope="module")
def pool():
    from sdp_vs_penalty.page import WorkerPool

    made = WorkerPool()
    yield made
    made.close()


@pytest.fixture
def sessions(pool):
    from sdp_vs_penalty.page import Sessions

    made = Sessions(pool)
    yield made
    made.close()
