"""Check the library of instances from its files alone: proofs, false proofs, three outside programs.

    sdp-vs-penalty shootout --export instances
    python benchmarks/proof_library.py instances [--mutations 1200] [--out results/shootout/library.md]

The proofs are checked one after the other in this process, by the checker that stands alone. The
programs csdp, sdpa and dsdp5 get problem.dat-s and nothing else, with their own default settings.
"""

from __future__ import annotations

import argparse
import csv
import json
import random
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.solvers import verify_proof

#: Proofs of at most so many bytes are falsified: a refusal takes as long as a check.
_SMALL = 150_000
#: How each program is called on a file, and the line of its output or answer that holds the optimum.
_PROGRAMS = {
    "csdp": (["csdp", "problem.dat-s"], r"^Dual objective value:\s*(\S+)"),
    "sdpa": (["sdpa", "-ds", "problem.dat-s", "-o", "answer"], r"^objValPrimal\s*=\s*(\S+)"),
    "dsdp5": (["dsdp5", "problem.dat-s"], r"^DSDP Solution:\s*(\S+)"),
}
#: DSDP maximises: its optimum is minus that of the file.
_SIGNS = {"dsdp5": -1.0}
#: Seconds that a program may take on one file.
_LIMIT = 20.0


def proofs(folder: Path) -> list[str]:
    """Every proof, checked: how many, how long, how tight, how large."""
    seconds, gaps, sizes, refused = [], [], [], []
    start = time.process_time()
    for path in sorted(folder.rglob("proof.json")):
        begin = time.process_time()
        text = path.read_text()
        try:
            found = verify_proof.check(json.loads(text))
        except ValueError as error:
            refused.append(f"{path}: {error}")
            continue
        seconds.append(time.process_time() - begin)
        sizes.append(len(text))
        if found is not None and found[1] > 0:
            gaps.append(float((found[1] - found[0]) / found[1]))
    total = time.process_time() - start
    lines = len(Path(verify_proof.__file__).read_text().splitlines())
    with (folder / "index.csv").open() as file:
        count = sum(1 for _ in csv.DictReader(file))
    return [
        f"| instances; proofs accepted; refused | {count}; {len(seconds)}; {len(refused)} |",
        f"| all proofs checked, processor time | {total:.1f} s (asked: under 300 s) |",
        f"| one proof | median {1e3 * np.median(seconds):.0f} ms, longest {max(seconds):.1f} s |",
        f"| gap relative to the upper bound | median {np.median(gaps):.1e}, 90 % below "
        f"{np.quantile(gaps, 0.9):.1e} (of {len(gaps)}) |",
        f"| size of a proof | median {1e-3 * np.median(sizes):.0f} kB, largest "
        f"{1e-6 * max(sizes):.1f} MB |",
        f"| lines of the checker | {lines} (asked: at most 150) |",
        *(f"| refused | {text} |" for text in refused),
    ]


def falsified(proof: dict[str, Any], rng: random.Random) -> Iterator[tuple[str, dict[str, Any]]]:
    """(kind, proof): one entry changed anywhere; then false claims, signed with a true digest."""
    key = rng.choice([k for k in proof if k not in ("sha256", "format")])
    yield "any entry changed", {**proof, key: _changed(proof[key], rng)}
    if proof["kind"] == "infeasible":
        return
    lower, upper = Fraction(proof["lower"]), Fraction(proof["upper"])
    width = Fraction(rng.choice([1, 10**3, 10**9]), 10**12) * max(abs(upper), Fraction(1, 10**9))
    theta = [str(-Fraction(x)) for x in proof["theta"]]
    for change in (
        {"lower": str(upper + width)},
        {"upper": str(lower - width)},
        {"kind": "infeasible"},
        {"theta": theta},
    ):
        body = {k: v for k, v in {**proof, **change}.items() if k != "sha256"}
        yield "false claim, signed anew", {**body, "sha256": verify_proof.digest(body)}


def _changed(value: Any, rng: random.Random) -> Any:
    if isinstance(value, dict) and value:
        key = rng.choice(sorted(value))
        return {**value, key: _changed(value[key], rng)}
    if isinstance(value, list) and value:
        at = rng.randrange(len(value))
        return [*value[:at], _changed(value[at], rng), *value[at + 1 :]]
    try:
        number = Fraction(value)
        return str(number + (1 + abs(number)) / 10**6)  # never the same
    except (TypeError, ValueError):
        return f"{value}x"


def mutations(folder: Path, count: int) -> list[str]:
    """At least ``count`` false proofs of each kind, and how many of them were refused."""
    rng = random.Random(0)
    paths = [p for p in sorted(folder.rglob("proof.json")) if p.stat().st_size <= _SMALL]
    tried: dict[str, int] = {}
    refused: dict[str, int] = {}
    while not tried or min(tried.values()) < count:
        true = json.loads(rng.choice(paths).read_text())
        for kind, mutant in falsified(true, rng):
            tried[kind] = tried.get(kind, 0) + 1
            try:
                verify_proof.check(mutant)
            except (ValueError, KeyError, TypeError):
                refused[kind] = refused.get(kind, 0) + 1
    return [f"| {kind} | {refused.get(kind, 0)} of {tried[kind]} refused |" for kind in tried]


def outside(folder: Path) -> list[str]:
    """Each program on the regular instances' files: how far its loss lies from the proved interval."""
    with (folder / "index.csv").open() as file:
        rows = [r for r in csv.DictReader(file) if r["group"] != "hostile" and r["sha256 problem.dat-s"]]
    rows = [r for r in rows if r["status"] == "optimum proved" and int(r["parameters"]) <= 100][::2]
    text = [
        "| program | files | within 1e-4 of the loss | within 1e-6 | median distance | no optimum |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for program in _PROGRAMS:
        if shutil.which(program) is None:
            text.append(f"| {program} | not installed | | | | |")
            continue
        far = [_distance(folder / r["folder"], program) for r in rows]
        found = np.array([x for x in far if x is not None])
        text.append(
            f"| {program} | {len(far)} | {np.sum(found <= 1e-4)} | {np.sum(found <= 1e-6)} | "
            f"{np.median(found):.1e} | {len(far) - len(found)} |"
        )
    return text


def _distance(place: Path, program: str) -> float | None:
    """Of offset + scale * optimum from the interval, relative to the loss; None without an optimum."""
    command, pattern = _PROGRAMS[program]
    about = json.loads((place / "problem.dat-s.json").read_text())
    with tempfile.TemporaryDirectory() as name:
        shutil.copy(place / "problem.dat-s", name)
        try:
            done = subprocess.run(
                command, cwd=name, capture_output=True, text=True, check=False, timeout=_LIMIT
            )
        except subprocess.TimeoutExpired:
            return None
        answer = Path(name, "answer")
        text = done.stdout + (answer.read_text() if answer.is_file() else "")
    said = re.search(pattern, text, re.M)
    if said is None:
        return None
    loss = about["offset"] + about["scale"] * _SIGNS.get(program, 1.0) * float(said.group(1))
    beyond = max(loss - about["upper"], about["lower"] - loss, 0.0)
    # A loss of zero (two-step, consistent data) is measured in the file's own unit.
    return beyond / max(about["upper"], about["scale"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--mutations", type=int, default=1200)
    parser.add_argument("--out", type=Path, default=Path("results/shootout/library.md"))
    chosen = parser.parse_args()
    text = [
        "# The library of instances, checked",
        "",
        "Made by `sdp-vs-penalty shootout --export instances` and "
        "`python benchmarks/proof_library.py instances`.",
        "",
        "| what | measured |",
        "| --- | --- |",
        *proofs(chosen.folder),
        *mutations(chosen.folder, chosen.mutations),
        "",
        "## Outside programs, from the files alone",
        "",
        "Every second regular instance with a .dat-s file and at most 100 parameters. The program's "
        "optimum becomes a loss by the offset and scale beside the file; its distance from the proved "
        "interval is relative to the loss.",
        "",
        *outside(chosen.folder),
        "",
    ]
    write_text(chosen.out, "\n".join(text))
    print("\n".join(text))


if __name__ == "__main__":
    main()
