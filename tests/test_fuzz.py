"""Every reader with bytes changed, cut and put in, with the parts of its format lost,
doubled and exchanged, and logs with absurd numbers: a result or a sentence.

`pytest -m fuzz` reads the same cases each time. Others, and more of them, each night:
`SDP_VS_PENALTY_FUZZ=3600s:$(date +%Y%m%d) pytest -n 0 -m fuzz` (an hour, or how many
cases, and the seed); it ends with a report by format. Inputs that fail
are kept in data/failed.
"""

import json
import os
import shutil
import tempfile
import time
import warnings
from collections import Counter
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from commands import peak_memory
from mutations import change_structure, pick, sound_meshes
from scipy import sparse
from small_runs import hostile_log, small_model, small_run, write_bag

import sdp_vs_penalty as sdp
from sdp_vs_penalty.data import save
from sdp_vs_penalty.diagnosis import load_diagnosis
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.estimation import verify_proof_file
from sdp_vs_penalty.exporters.inertials import check_urdf, massless_links
from sdp_vs_penalty.problem import problems_folder
from sdp_vs_penalty.regression import load_answers
from sdp_vs_penalty.robot import read_mesh
from sdp_vs_penalty.solvers import Cone, ConicProblem, solver_types

CORPUS = Path(__file__).parent / "data" / "corpus"
#: Where inputs that failed are put, to be mended and moved to the corpus.
FAILED = Path(__file__).parent / "data" / "failed"
#: CPU seconds that one small file may take, and bytes beyond ten times its size.
SECONDS = 20.0
MEMORY = 500e6


def damaged(content, rng):
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


#: Files that are read as a folder: its name, and what reads it.
FOLDERS = {"arm": sdp.load_problem, "log": sdp.load_measurements}


#: A conic problem of two unknowns, and what the programs csdp and sdpa answer to such.
CONES = ConicProblem(
    sparse.csc_matrix((2, 2)),
    np.ones(2),
    -sparse.eye(4, 2, format="csc"),
    np.ones(4),
    (Cone("psd", 2), Cone("nonnegative", 1)),
)
ANSWERS = {
    "csdp.solution": "1.0 2.0\n1 1 1 1 3.0\n2 1 1 1 0.5\n2 1 1 2 0.1\n2 2 1 1 1e-9\n",
    "sdpa.solution": (
        "phase.value = pdOPT\n   Iteration = 12\nxVec =\n{1.0,2.0}\nxMat =\n{ {1}, {2} }\n"
        "yMat =\n{ { {0.5,0.1}, {0.1,0.5} }, {1e-9} }\nmain loop time = 0.1\n"
    ),
}


def read_answer(path, name):
    """What a solver makes of the answer of a program."""
    is_csdp = name.startswith("csdp")
    program = solver_types()["csdp" if is_csdp else "sdpa-program"]()
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(path, Path(folder) / ("solution" if is_csdp else "answer"))
        program.ended(path.read_text(errors="replace"), 0)
        return program.answer(Path(folder), CONES)


def sound_files(folder):
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
    for name, text in ANSWERS.items():
        (folder / name).write_text(text)
    parts = [p for name in FOLDERS for p in (folder / name).glob("*.*")]
    alone = [*folder.glob("sound.*"), *folder.glob("*.json"), folder / "box.npz"]
    answers = [folder / name for name in ANSWERS]
    return sorted([*alone, *answers, *parts, *CORPUS.iterdir()])


def sources_by_format(sources):
    """The files of each format and kind, so that each is changed as often."""
    groups = {}
    for path in sources:
        kind = path.name if path.suffix == ".json" else path.suffix
        groups.setdefault(kind, []).append(path)
    return list(groups.values())


def read(path, source):
    """What the verbs make of such a file."""
    if source.name == "proof.json":
        return verify_proof_file(path)
    if source.name == "findings.json":
        return load_diagnosis(path)
    if source.name in ANSWERS:
        return read_answer(path, source.name)
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


def outcome(case, act, size=np.inf):
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


def read_mutated(seed, sources, folder):
    """Read one of the files, changed in one to six places; the kind of outcome.

    Half of the files are changed by the parts of their format alone, a quarter by bytes
    alone.
    """
    rng = np.random.default_rng(seed)
    source = pick(pick(sources, rng), rng)
    content = source.read_bytes()
    structured_share = pick((1.0, 1.0, 0.5, 0.0), rng)
    for _ in range(int(rng.integers(1, 7))):
        if content and rng.random() < structured_share:
            content = change_structure(source.suffix, content, rng)
        elif content:
            content = damaged(content, rng)
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


def verbs():
    """What is done with a log, by name."""
    problem = sdp.load_problem("two_link")
    model = small_model()
    first = {
        verb.__name__: partial(verb, problem) for verb in (sdp.identify, sdp.check)
    }
    return first | {
        verb.__name__: partial(verb, model) for verb in (sdp.compare, sdp.diagnose)
    }


#: One case in so many is a log with absurd numbers, which takes a hundred times longer.
CASES_PER_LOG = 200


def numbers_of_cases(amount, first):
    """So many numbers from the first on, or as many as there is time for ("60s")."""
    if not amount.endswith("s"):
        yield from range(first, first + int(amount))
        return
    end = time.monotonic() + float(amount[:-1])
    numbers = count(first)
    while time.monotonic() < end:
        yield next(numbers)


@pytest.mark.fuzz
def test_thousands_of_files(tmp_path, capsys):
    """Changed files, and now and then a log: so many cases, or seconds of them."""
    amount, _, seed = os.environ.get("SDP_VS_PENALTY_FUZZ", "200").partition(":")
    sources = sources_by_format(sound_files(tmp_path))
    uses = list(verbs().items())
    outcomes = Counter[str]()
    failures = []
    for k in numbers_of_cases(amount, int(seed or 0) * 1_000_000):
        try:
            if k % CASES_PER_LOG:
                kind = read_mutated(k, sources, tmp_path)
            else:
                name, verb = pick(uses, np.random.default_rng(k))
                act = partial(verb, hostile_log(k))
                kind = f"{name} {outcome(f'{name} of log {k}', act)}"
            outcomes[kind] += 1
        except AssertionError as error:
            failures.append(str(error)[:300])
    with capsys.disabled():
        n_cases = outcomes.total() + len(failures)
        print(f"\n{n_cases} cases, {len(failures)} failures")
        for kind, number in sorted(outcomes.items()):
            print(f"{kind:24} {number:6}")
        print("\n".join(failures))
    assert len(outcomes) > 10
    assert not failures


#: Files that take a second or more.
LARGE = ("many_columns.csv", "zip_bomb.npz")


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(
            path, id=path.name, marks=pytest.mark.long if path.name in LARGE else ()
        )
        for path in sorted(CORPUS.iterdir())
    ],
)
def test_what_the_reader_takes_the_check_can_judge(path, two_link):
    """Files that broke a reader once."""
    runs = []
    reports = []
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


DOCUMENTS = [
    path for path in sorted(CORPUS.iterdir()) if path.suffix in (".gltf", ".json")
]


@pytest.mark.filterwarnings("ignore:.*this mesh is left out")
@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_a_document_that_broke_a_reader_is_read_or_refused(path, tmp_path):
    copy = Path(shutil.copy(path, tmp_path))
    outcome(path.name, lambda: read(copy, path))


def test_a_model_whose_spread_overflows_is_refused(tmp_path):
    content = json.loads((CORPUS.parent / "written_by_0_1" / "model.json").read_text())
    content["uncertainty"]["spread"][5][1] = 1e300
    path = tmp_path / "model.json"
    path.write_text(json.dumps(content))
    assert outcome("a spread of 1e300", lambda: read(path, path)) == "sentence"


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
