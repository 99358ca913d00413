"""One case of the challenge: simulate a world, identify, diagnose without sight of the truth."""

from __future__ import annotations

import time
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from sdp_vs_penalty.data.measurements import concatenate
from sdp_vs_penalty.diagnosis.diagnose import diagnose
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.identify import identify
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.simulation.worlds.conditions import draw_conditions, fair
from sdp_vs_penalty.simulation.worlds.world import draw_world, log_run

Record = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """kind : the class; nuisance : of worlds.conditions.NUISANCES; index : of the case, from 0."""

    kind: str
    nuisance: str
    seed: int
    index: int

    @property
    def key(self) -> str:
        return f"{self.kind}/{self.nuisance}/{self.seed}/{self.index}"

    def generator(self) -> np.random.Generator:
        """Its own stream, whatever other cases there are."""
        return np.random.default_rng([self.seed, self.index, zlib.crc32(self.key.encode())])


def run_case(case: Case) -> tuple[str, Record]:
    """The case's key and its record, which is plain JSON."""
    rng = case.generator()
    conditions = draw_conditions(case.nuisance, rng)
    world = draw_world(conditions, rng)
    logged = [log_run(world, k, rng) for k in range(conditions.runs + 1)]
    allowed, abstains = fair(conditions)
    record: Record = {
        "class": case.kind,
        "nuisance": case.nuisance,
        "conditions": world.describe(),
        "fair": sorted(allowed),
        "abstains": abstains,
    }
    data = concatenate([x.run for x in logged[:-1]])
    begin = time.process_time()
    try:
        estimate = identify(load_problem(world.arm.urdf), data, "ols")
        begin = time.process_time()
        result = diagnose(estimate, data, logged[-1].run).to_dict()
    except InputError as error:
        return case.key, rounded(record | {"verdict": "refused", "found": [], "error": str(error)})
    seconds = time.process_time() - begin
    kept = ("effect", "joints", "size", "std", "shape", "confidence", "indistinguishable_from")
    found = [{name: f[name] for name in kept} for f in result["effects"]]
    record |= {
        "verdict": result["verdict"],
        "found": found,
        "retuned": result.get("retuned", []),
        "events": result["events"],
        "seconds": seconds,
    }
    return case.key, rounded(record)


def rounded(value: Any) -> Any:
    """The same with all floats at six digits: thousands of records are kept."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {key: rounded(x) for key, x in value.items()}
    return [rounded(x) for x in value] if isinstance(value, (list, tuple)) else value
