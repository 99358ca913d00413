"""Attacks by single fields of model.json and findings.json, clocks, threads and limits."""

import json
import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas
from mutations import pick

from attacks.attack import Attack, Kind, Rng
from attacks.files import command

#: What a field is changed to: other types, numbers that no model has, options.
VALUES = (
    *(None, True, 0, -1, 1, 0.5, 1e-6, 1e6, 1e300, 10**30, float("nan")),
    *("", "x", "--json", [], [1], ["x"], {}, {"x": 1}, [[1]], [None], ["a", "--json"]),
)
VERBS_OF_MODELS = (
    "compare {} --data run.csv",
    "report {} --data run.csv --out out.html",
    "export {} --out out.h",
    "export {} --out out.xml",
    "diagnose {} --data run.csv --json out.json",
    "add {} joint_spring:1 --data run.csv --out out.json",
    "excite {} --duration 1 --out out.csv",
    "simulate {} --follow run.csv",
    "add {} --from findings.json --data run.csv --out out.json",
)
VERBS_OF_FINDINGS = (
    "add model.json --from {} --data run.csv --out out.json",
    "report model.json --data run.csv --findings {} --out out.html",
)


def field(name: str, verbs: tuple[str, ...]) -> Kind:
    """One field, at any depth, is changed, lost or doubled."""

    def attack(folder: Path, rng: Rng) -> Attack:
        document = json.loads((folder / name).read_text())
        change_a_field(document, rng)
        (folder / name).write_text(json.dumps(document))
        return command(pick(verbs, rng).format(name))

    return attack


def change_a_field(document: Any, rng: Rng) -> None:
    """Walk to a random field of a JSON document, and change it in place."""
    while True:
        keys = list(document) if isinstance(document, dict) else range(len(document))
        key = pick(list(keys), rng)
        below = document[key]
        if not (isinstance(below, dict | list) and below and rng.random() < 0.8):
            break
        document = below
    way = rng.random()
    if way < 0.1:
        del document[key]
    elif way < 0.2 and isinstance(document, list):
        document.append(document[key])
    else:
        document[key] = pick(VALUES, rng)


def clock(folder: Path, rng: Rng) -> Attack:
    """Stamps that pause, jump, stand, run backwards, or are no numbers."""
    table = pandas.read_csv(folder / "run.csv")
    t = table["t"].to_numpy(float).copy()
    k = int(rng.integers(1, len(t) - 1))
    way = int(rng.integers(8))
    if way == 0:
        t[k:] += 10.0 ** rng.uniform(-2.0, 9.0)  # a pause, or the clock was set
    elif way == 1:
        t[k:] -= 10.0 ** rng.uniform(-2.0, 3.0)
    elif way == 2:
        t[k] = pick([np.nan, np.inf, 0.0, 1.7e9, 1e300, -1.0], rng)
    elif way == 3:
        t = np.round(t, int(rng.integers(0, 3)))
    elif way == 4:
        t *= 10.0 ** rng.uniform(-12.0, 12.0)
    elif way == 5:
        t = t[::-1]
    elif way == 6:
        t = rng.permutation(t)
    else:
        t = np.full_like(t, t[k])
    table["t"] = t
    table.to_csv(folder / "run.csv", index=False)
    verbs = (
        "check two_link --data run.csv",
        "identify two_link --data run.csv --out out.json",
        "compare model.json --data run.csv",
        "diagnose model.json --data run.csv --json out.json",
    )
    return command(pick(verbs, rng))


THREADS = """
import resource, sys, threading
import sdp_vs_penalty as sdp
kinds = resource.RLIMIT_DATA, resource.RLIMIT_FSIZE, resource.RLIMIT_AS
before = [resource.getrlimit(kind) for kind in kinds]
errors = []
def read(path):
    try:
        sdp.load_measurements(path)
    except sdp.InputError:
        pass
    except BaseException as error:
        errors.append(repr(error))
threads = [threading.Thread(target=read, args=(path,)) for path in sys.argv[1:]]
[x.start() for x in threads]
[x.join() for x in threads]
assert before == [resource.getrlimit(kind) for kind in kinds], "limits stay lowered"
assert not errors, errors
"""


def threads(folder: Path, rng: Rng) -> Attack:
    """Files, sound and broken ones, that several threads of one process read."""
    suffixes = (".csv", ".npz", ".mat", ".parquet", ".mcap")
    paths = [folder / f"run{pick(suffixes, rng)}" for _ in range(6)]
    if rng.random() < 0.5:
        broken = pick(paths, rng)
        content = broken.read_bytes()
        broken.write_bytes(content[: int(rng.integers(len(content)))])
    words = [sys.executable, "-c", THREADS, *map(str, paths)]
    ended = subprocess.run(words, capture_output=True, text=True, timeout=60)
    if ended.returncode:  # shown as what the command has printed
        text = f"Traceback {ended.stderr[-300:]}"
        return Attack(["list", "methods"], surround=lambda: os.write(2, text.encode()))
    return command("list methods")


def little_memory(folder: Path, rng: Rng) -> Attack:
    """A limit of address space, or a cache that cannot be made."""
    limit = int(rng.integers(300, 1400)) * 2**20

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

    def no_cache() -> None:
        (folder / "no folder").write_text("")
        os.environ["XDG_CACHE_HOME"] = str(folder / "no folder" / "cache")

    verbs = (
        "check two_link --data run.csv",
        "compare model.json --data run.csv",
        "export model.json --out out.h",
    )
    way = pick((limited, no_cache), rng)
    return Attack(pick(verbs, rng).split(), surround=way)


KINDS: dict[str, Kind] = {
    "field of model.json": field("model.json", VERBS_OF_MODELS),
    "field of findings.json": field("findings.json", VERBS_OF_FINDINGS),
    "clock": clock,
    "threads": threads,
    "little memory": little_memory,
}
