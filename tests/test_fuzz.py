"""Every reader with bytes changed, cut and put in, and logs with absurd numbers: a
result or a sentence.

`pytest -m fuzz` takes about a minute, from the same cases on each time. Others, and more
of them, each night: `SDP_VS_PENALTY_FUZZ=3600s:$(date +%Y%m%d) pytest -n 0 -m fuzz` (an
hour, or how many cases, and the seed). Inputs that fail are kept in data/failed.
"""

import json
import os
import shutil
import time
import warnings
from collections import Counter
from collections.abc import Callable
from functools import partial
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import peak_memory
from mutations import change_structure, sound_meshes
from small_runs import hostile_log, small_run, write_bag

import sdp_vs_penalty as sdp
from sdp_vs_penalty.data import save
from sdp_vs_penalty.diagnosis import load_diagnosis
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.estimation import verify_proof_file
from sdp_vs_penalty.exporters.inertials import check_urdf, massless_links
from sdp_vs_penalty.problem.load import problems_folder
from sdp_vs_penalty.regression import load_answers
from sdp_vs_penalty.robot.mesh import read_mesh

CORPUS = Path(__file__).parent / "data" / "corpus"
#: Where inputs that failed are put, to be mended and moved to the corpus.
FAILED = Path(__file__).parent / "data" / "failed"
#: CPU seconds that one small file may take, and bytes beyond ten times its size.
SECONDS = 20.0
MEMORY = 500e6


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """A bit turned, a part lost, doubled or overwritten by something odd."""
    begin, end = sorted(rng.integers(len(content), size=2).tolist())
    before = content[:begin]
    part = content[begin:end]
    after = content[end:]
    odd = [
        b"\0" * 8,
        b"\xff" * 8,
        b"\x7f\xff\xff\xff",
        b"\x80",
        b",",
        b"\n",
        b'"',
        b"\r",
    ]
    odd += [b"nan", b"-1e999", b"1e300", b"5e-324"]
    new = odd[int(rng.integers(len(odd)))]
    turned = (
        bytes([content[begin] ^ (1 << int(rng.integers(8)))]) + content[begin + 1 :]
    )
    ways = (
        before + turned,
        before + after,
        content[begin:],
        before + part[:200] * 9 + content[begin:],
        before + new + content[begin:],
        before + new + content[begin + len(new) :],
    )
    return ways[int(rng.integers(len(ways)))]


def replaced(content: bytes, rng: np.random.Generator) -> bytes:
    """Another value at any place of a JSON document; damage to what is none."""
    try:
        inner = document = json.loads(content)
    except (ValueError, RecursionError):
        return damaged(content, rng)
    odd = [
        None,
        True,
        -3,
        10**400,
        float("nan"),
        0.5,
        1e300,
        5e-324,
        "x",
        [],
        [0.0],
        {},
        {"a": 1},
    ]
    while isinstance(inner, dict | list) and inner:
        places = list(inner) if isinstance(inner, dict) else range(len(inner))
        place = places[int(rng.integers(len(places)))]
        if not isinstance(inner[place], dict | list) or rng.random() < 0.2:
            inner[place] = odd[int(rng.integers(len(odd)))]
            break
        inner = inner[place]
    return json.dumps(document).encode()


#: Files that are read as a folder: its name, and what reads it.
FOLDERS: dict[str, Callable[[Path], object]] = {
    "arm": sdp.load_problem,
    "log": sdp.load_measurements,
}


def sound_files(folder: Path) -> list[Path]:
    """One of every kind that is read, and the files that broke a reader once."""
    problem = sdp.load_problem("two_link")
    run = small_run(problem, seconds=0.5)
    for suffix in (".csv", ".npz", ".mat", ".parquet"):
        save(run, folder / f"sound{suffix}")
    for name in (".mcap", ".db3"):
        write_bag(folder / f"bag{name}", run, mcap=name == ".mcap")
        (file,) = (folder / f"bag{name}").glob(f"*{name}")
        file.rename(folder / f"sound{name}")
    estimate = sdp.identify(problem, small_run(problem), proof=folder / "proof.json")
    estimate.save(folder / "model.json")
    sdp.export(estimate, folder / "sound.urdf")
    found = sdp.diagnose(estimate, small_run(problem)).to_dict()
    (folder / "findings.json").write_text(json.dumps(found))
    box = {
        "q": np.ones((3, 2)),
        "gravity": np.ones((3, 2)),
        "mass_matrix": np.ones((3, 2, 2)),
    }
    np.savez(folder / "box.npz", **box)
    shutil.copytree(problems_folder() / "emps", folder / "arm")
    (folder / "log").mkdir()
    for name in ("time", "positions", "velocity", "torques"):
        (folder / "log" / f"exciting_traj_{name}.txt").write_text(
            "0.001\n0.002\n0.003\n"
        )
    for suffix, content in sound_meshes().items():
        (folder / f"sound{suffix}").write_bytes(content)
    parts = [p for name in FOLDERS for p in (folder / name).glob("*.*")]
    alone = [*folder.glob("sound.*"), *folder.glob("*.json"), folder / "box.npz"]
    return sorted([*alone, *parts, *CORPUS.iterdir()])


def read(path: Path, source: Path) -> Any:
    """What the verbs make of such a file."""
    if source.name == "proof.json":
        return verify_proof_file(path)
    if source.name == "findings.json":
        return load_diagnosis(path)
    if source.name == "box.npz":
        return load_answers([path])
    if source.parent.name in FOLDERS:
        home = shutil.copytree(
            source.parent,
            path.parent / f"{source.parent.name}_{path.stem}",
            dirs_exist_ok=True,
        )
        path.replace(home / source.name)
        return FOLDERS[source.parent.name](home)
    if path.suffix == ".json":
        estimate = sdp.load_estimate(path)
        rest = np.zeros((3, estimate.robot.n))
        json.dumps(estimate.to_dict())
        return estimate.torque(Motion(np.arange(3.0), rest, rest, rest, rest))
    if path.suffix in sound_meshes():
        return read_mesh(path, np.ones(3))
    if path.suffix == ".urdf":
        return check_urdf(path), massless_links(path), sdp.load_problem(path)
    return sdp.load_measurements(path)


def outcome(case: str, act: Callable[[], object], size: float = np.inf) -> str:
    """What becomes of a case: a result or a sentence, no warning of NumPy, within
    seconds and memory."""
    begin = time.process_time()
    found = "read"
    try:
        with peak_memory() as peak, warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            act()
    except sdp.InputError as error:
        found = (
            "sentence"
            if "\n" not in str(error) and len(str(error)) <= 2000
            else repr(error)
        )
    except Exception as error:
        raise AssertionError(f"{case}: {error!r}") from error
    assert found in ("read", "sentence"), f"{case}: {found}"
    assert not peak or peak[0] < 10 * size + MEMORY, case
    assert time.process_time() - begin < SECONDS, case
    return found


def read_mutated(seed: int, sources: list[Path], folder: Path) -> str:
    """Read one of the files, changed in one to six places; the kind of outcome."""
    rng = np.random.default_rng(seed)
    source = sources[int(rng.integers(len(sources)))]
    content = source.read_bytes()
    for _ in range(int(rng.integers(1, 7))):
        way = rng.random()
        if content and way < 0.4:
            content = change_structure(source.suffix, content, rng)
        elif content:
            content = (replaced if way < 0.55 else damaged)(content, rng)
    path = folder / f"mutated{source.suffix}"
    path.write_bytes(content)
    try:
        found = outcome(
            f"seed {seed} ({source.name})", lambda: read(path, source), len(content)
        )
    except AssertionError:
        FAILED.mkdir(exist_ok=True)
        (FAILED / f"seed_{seed}_{source.name}").write_bytes(content)
        raise
    return f"{source.suffix} {found}"


def verbs() -> dict[str, Callable[[sdp.Measurements], object]]:
    """What is done with a log, by name."""
    problem = sdp.load_problem("two_link")
    model = sdp.identify(problem, small_run(problem))
    first = {
        verb.__name__: partial(verb, problem) for verb in (sdp.identify, sdp.check)
    }
    return first | {
        verb.__name__: partial(verb, model) for verb in (sdp.compare, sdp.diagnose)
    }


@pytest.mark.fuzz
def test_thousands_of_files(tmp_path, capsys):
    """Changed files, and every fiftieth time a log: so many cases, or seconds of them."""
    many, _, seed = os.environ.get("SDP_VS_PENALTY_FUZZ", "60s").partition(":")
    sources = sound_files(tmp_path)
    uses = list(verbs().items())
    seen = Counter[str]()
    first = int(seed or 0) * 1_000_000
    failures = list[str]()
    begin = time.monotonic()
    for k in islice(count(first), None if many.endswith("s") else int(many)):
        if many.endswith("s") and time.monotonic() - begin > float(many[:-1]):
            break
        name, verb = uses[k // 50 % len(uses)]
        try:
            if k % 50:
                seen[read_mutated(k, sources, tmp_path)] += 1
            else:
                log = hostile_log(k)
                act = partial(verb, log)
                seen[f"{name} {outcome(f'{name} of log {k}', act)}"] += 1
        except AssertionError as error:
            failures.append(str(error)[:300])
    with capsys.disabled():
        kinds = dict(sorted(seen.items()))
        print(f"\n{seen.total()} cases, {len(failures)} failures: {kinds}")
        print("\n".join(failures))
    assert len(seen) > 10
    assert not failures


@pytest.mark.parametrize("path", sorted(CORPUS.iterdir()), ids=lambda path: path.name)
def test_what_the_reader_takes_the_check_can_judge(path, two_link):
    """Files that broke a reader once."""
    runs = list[sdp.Measurements]()
    reports = list[Any]()
    size = path.stat().st_size
    outcome(
        f"{path.name} read",
        lambda: runs.append(sdp.load_measurements(path, joints=2)),
        size,
    )
    outcome(
        f"{path.name} checked", lambda: reports.extend(sdp.check(two_link, path)), size
    )
    if not reports:
        assert not runs or not np.any(np.abs(runs[0].tau) > 1e-12)
    elif not runs:
        assert all(report.meaningless for report in reports)


def test_a_models_own_filters_keep_the_budget(two_link, tmp_path):
    run = small_run(two_link, seconds=5.0)
    sdp.identify(two_link, run).save(tmp_path / "model.json")
    content = json.loads((tmp_path / "model.json").read_text())
    content["preprocessing"]["state_cutoff"] = 1e-4
    (tmp_path / "model.json").write_text(json.dumps(content))
    model = sdp.load_estimate(tmp_path / "model.json")
    assert (
        outcome("filters of hours", lambda: sdp.compare(model, run), 0.0) == "sentence"
    )
