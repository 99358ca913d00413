"""Check the library of instances from its files alone: proofs, false proofs, three outside programs.

    sdp-vs-penalty shootout --export instances
    python benchmarks/proof_library.py instances [--false 10000] [--out results/shootout/library.md]

The proofs are checked one after the other in this process, by the checker that stands alone. The
programs csdp, sdpa and dsdp5 get problem.dat-s and nothing else, with their own default settings.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from false_proofs import judged

from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.solvers import verify_proof

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
            found = verify_proof.check(verify_proof.read(path))
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
        f"| lines of the checker | {lines} (asked: at most 160) |",
        *(f"| refused | {text} |" for text in refused),
    ]


def false_proofs(count: int) -> list[str]:
    """At least ``count`` files of known truth (benchmarks/false_proofs.py), and how they were judged."""
    right, wrong, longest = judged(count * 4 // 3 + 1)
    made = sum(n for kind, n in right.items() if kind.startswith("genuine"))
    refused = sum(right.values()) - made
    return [
        f"| false and malformed files | {refused} refused, longest {longest:.2f} s |",
        f"| genuine random ones | {made} accepted |",
        f"| judged wrong | {len(wrong)} |",
    ]


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
    parser.add_argument("--false", type=int, default=10_000)
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
        *false_proofs(chosen.false),
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
