"""What each part of the diagnosis buys: python results/rules/make.py PART ... [--logs FOLDER]

Diagnose the logs of results/bench (kinds mujoco and worlds, written by its make.py) as they
are, and with one part taken out at a time. Prints a line a part: how many logs are named
rightly and how many have a false word, with it and without; the sum of the logarithms of
mean errors on fresh motion; then each log whose claims differ. PART is a key of PARTS.
"""

import argparse
import importlib
import json
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
sys.path[0] = str(Path(__file__).parents[1])

import numpy as np
from bench import judge

from sdp_vs_penalty import diagnose, identify
from sdp_vs_penalty.estimation.estimate import Estimate, load_estimate

#: By its name the place of a part in `sdp_vs_penalty.diagnosis` (module, class, function)
#: and what stands there without it.
PARTS: dict[str, tuple[str, str, str, Callable[..., Any]]] = {
    "simplest": ("search", "Search", "simplest", lambda _, x: x[0] if x else None),
    "contradictions": ("search", "Search", "_bar_contradictions", lambda _: False),
    "law misfits": ("nuisances", "Nuisances", "with_law_misfits", lambda _, x: [*x]),
    "own at zero": ("evidence", "EvidenceScorer", "_own_below_zero", lambda *_: None),
    "joint's harm": (
        "held_out",
        "HeldOut",
        "drop_harmful_to_a_joint",
        lambda _, x, __: [*x],
    ),
    "forces": ("passing.search", "", "force_laws", lambda _: []),
}


@dataclass(frozen=True)
class Outcome:
    """What is said of a log: claims, those that are sure and false, whether a sure one is
    right, and the mean ratio of errors on fresh motion ("" where nothing was added)."""

    claims: tuple[str, ...]
    false: tuple[str, ...]
    is_right: bool
    ratio: str


def outcome(folder: Path, model: Estimate) -> Outcome:
    """Diagnose one log, add what helps, and judge both."""
    truth = json.loads((folder / "truth.json").read_text("utf-8"))
    found = diagnose(model, sorted(map(str, folder.glob("run*.csv"))))
    claims = [*judge.claims_of_diagnosis(found)]
    right = [c for c in claims if judge.names(c, truth)]
    false = [
        judge.short(c)
        for c in claims
        if c.sure
        and c not in right
        and not judge.matches(truth["besides"], f"{c.by}: {c.text}")
    ]
    ratio = judge.errors_with(folder, model, found)[1] if found.helpful else ""
    said = (f"{'' if c.sure else '(possible) '}{judge.short(c)}" for c in claims)
    is_right = any(c.sure for c in right)
    return Outcome(tuple(said), tuple(false), is_right, ratio)


def model_of(folder: Path) -> Estimate:
    """Identify the model of a log once."""
    path = folder / "before.json"
    if not path.exists():
        robot = json.loads((folder / "truth.json").read_text("utf-8"))["robot"]
        if (folder / robot).exists():
            robot = str(folder / robot)
        identify(robot, sorted(map(str, folder.glob("run*.csv")))).save(path)
    return load_estimate(path)


def without(part: str, folder: Path) -> Outcome:
    """Judge a log with one part taken out."""
    module, owner, name, instead = PARTS[part]
    place = importlib.import_module(f"sdp_vs_penalty.diagnosis.{module}")
    with patch.object(getattr(place, owner) if owner else place, name, instead):
        return outcome(folder, model_of(folder))


def counts(outcomes: Sequence[Outcome]) -> str:
    """How many are right, how many have a false word, and the errors on fresh motion."""
    ratios = [float(x.ratio) for x in outcomes if x.ratio.replace(".", "").isdigit()]
    right = sum(x.is_right for x in outcomes)
    false = sum(bool(x.false) for x in outcomes)
    return f"{right} right, {false} false, {np.sum(np.log(ratios)):.2f}"


def main() -> None:
    """Read the options and run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="+", choices=PARTS, metavar="PART")
    logs = Path(sys.path[0], "bench", "logs")
    parser.add_argument("--logs", type=Path, default=logs)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    found = sorted(x.parent for x in options.logs.glob("*/*/truth.json"))
    folders = [x for x in found if x.parent.name in ("mujoco", "worlds")]
    as_is = [outcome(x, model_of(x)) for x in folders]
    for part in options.parts:
        others = [without(part, x) for x in folders]
        print(f"{part}: {counts(as_is)}; without it {counts(others)}")
        for folder, a, b in zip(folders, as_is, others, strict=True):
            if a.claims != b.claims:
                print(f"  {folder.name}: {a.claims} -> {b.claims}", flush=True)


if __name__ == "__main__":
    main()
