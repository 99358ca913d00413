"""How often is the diagnosis right? The classes of cases, and a case from its seed to its record.

Every case is simulated by its own seed, diagnosed without sight of the truth, and then compared with
it. Cases are kept one by one, so that an interrupted challenge goes on where it stopped.
"""

import json
import os
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from challenge.judge import Record, report_text
from challenge.truth import energies, judged_curve, true_floor
from challenge.worlds.conditions import NUISANCES, Conditions, draw_conditions, fair
from challenge.worlds.hidden_unknown import disturbance, nameless, unknown
from challenge.worlds.motion import thinned
from challenge.worlds.runs import Logged, Site, draw_motion, draw_world, log_run, urdf_of
from sdp_vs_penalty.data.measurements import concatenate
from sdp_vs_penalty.diagnosis.diagnose import diagnose
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.identify import identify
from sdp_vs_penalty.files import alone, write_text
from sdp_vs_penalty.parallel import ALONE, Workers, spread
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.simulation.worlds.hidden import FRICTION, FROZEN, LEVELS, MACHINE, Hidden, Maker
from sdp_vs_penalty.simulation.worlds.world import TrueMotion, World

#: What every model in question has, unless that is what is hidden.
USUAL = ("rigid_body", "viscous_friction", "coulomb_friction", "torque_offset")
#: What can be hidden from a model that is refitted.
EFFECTS: Mapping[str, Maker] = {**FRICTION, **MACHINE}


@dataclass(frozen=True)
class CaseClass:
    """what : none, effects, unknown, curves, disturbance or payload; level : of LEVELS; count : effects;
    frozen : the model was identified before, without them."""

    name: str
    what: str
    level: str = "strong"
    count: int = 1
    one_run: bool = False

    @property
    def frozen(self) -> bool:
        return self.what == "payload"

    def conditions(self, drawn: Conditions) -> Conditions:
        return replace(drawn, runs=1, duration=max(drawn.duration, 20.0)) if self.one_run else drawn

    def names(self, seed: int, index: int, rng: np.random.Generator) -> list[str]:
        """Effects of the library to hide: a single one in turn, in an order of the seed's, so that each
        is met equally often; of several none that the model usually has."""
        if self.what != "effects":
            return []
        if self.count == 1:
            every = tuple(EFFECTS)
            order = np.random.default_rng([seed, zlib.crc32(self.name.encode())]).permutation(len(every))
            return [every[order[index % len(every)]]]
        others = [name for name in EFFECTS if name not in USUAL]
        return [str(x) for x in rng.choice(others, self.count, replace=False)]

    def hidden(
        self, names: Sequence[str], world: World, motions: Sequence[TrueMotion], rng: np.random.Generator
    ) -> list[Hidden]:
        """The hidden effects, sized on the motions that are identified from."""
        kinds = {"unknown": unknown, "curves": nameless, "disturbance": disturbance, **FROZEN, **EFFECTS}
        coarse, wanted = [thinned(m, 10) for m in motions], names or {self.what} & set(kinds)
        made = [(x, kinds[x](world, int(rng.integers(world.arm.n)), rng)) for x in wanted]
        called = [replace(one, effect=one.effect or x) for x, one in made]
        return [one.sized(world, coarse, LEVELS[self.level]) for one in called]


CLASSES: Mapping[str, CaseClass] = {
    c.name: c
    for c in (
        CaseClass("clean", "none"),
        CaseClass("strong", "effects", "strong"),
        CaseClass("medium", "effects", "medium"),
        CaseClass("weak", "effects", "weak"),
        CaseClass("one_run", "effects", "strong", one_run=True),
        CaseClass("pairs", "effects", "medium", 2),
        CaseClass("triples", "effects", "medium", 3),
        CaseClass("unknown_strong", "unknown", "strong"),
        CaseClass("unknown_medium", "unknown", "medium"),
        CaseClass("unknown", "curves", "strong"),
        CaseClass("disturbance", "disturbance", "strong"),
        CaseClass("payload", "payload", "strong"),
    )
}


_KEPT = ("effect", "joints", "size", "std", "shape", "confidence", "indistinguishable_from")


@dataclass(frozen=True)
class Case:
    """kind : of CLASSES; nuisance : of NUISANCES; index : of the case, from 0."""

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


@dataclass(frozen=True)
class Sitting:
    """A case as it is simulated: the last of the runs is the test run."""

    world: Site
    hidden: Sequence[Hidden]
    motions: Sequence[TrueMotion]
    logged: Sequence[Logged]
    effects: tuple[str, ...]
    unloaded: Sequence[Logged] = ()


def simulate_case(case: Case) -> Sitting:
    """The world of a case and its runs."""
    kind, rng = CLASSES[case.kind], case.generator()
    conditions = kind.conditions(draw_conditions(case.nuisance, rng))
    names = kind.names(case.seed, case.index, rng)
    if "warming_friction" in names:
        conditions = replace(conditions, thermometer=True)
    world = draw_world(conditions, rng, without=names)
    motions = [draw_motion(world, k, rng) for k in range(conditions.runs + 1)]
    hidden = kind.hidden(names, world, motions[:-1], rng)
    logged = [log_run(world, m, rng, [h.torque(world, m) for h in hidden]) for m in motions]
    unloaded = []
    if kind.frozen:  # the model was identified in another sitting, without the load
        others = [draw_motion(world, k, rng) for k in range(conditions.runs)]
        unloaded = [log_run(world, m, rng) for m in others]
    effects = tuple(name for name in USUAL if name not in names)
    return Sitting(world, hidden, motions, logged, effects, unloaded)


def run_case(case: Case) -> tuple[str, Record]:
    """The case's key and its record, which is plain JSON."""
    kind, sitting = CLASSES[case.kind], simulate_case(case)
    allowed, abstains = fair(sitting.world.conditions)
    record: Record = {
        "class": case.kind,
        "nuisance": case.nuisance,
        "conditions": asdict(sitting.world.conditions) | {"dry": sitting.world.dry.to_dict()},
        "truth": [h.to_dict() for h in sitting.hidden],
        "deviation": [h.deviation(sitting.world, sitting.motions[0]) for h in sitting.hidden],
        "fair": sorted(allowed),
        "abstains": abstains,
        **{name: [] for name in ("found", "retuned", "events", "after", "energy")},
    }
    try:
        record |= _diagnosed(kind, sitting)
    except InputError as error:
        record |= {"verdict": "refused", "error": str(error)}
    return case.key, rounded(record)


def _diagnosed(kind: CaseClass, sitting: Sitting) -> Record:
    """What the diagnosis says, in how many seconds of the processor, and the truth beside it."""
    *logged, test = sitting.logged
    data = concatenate([x.run for x in logged])
    learnt = concatenate([x.run for x in sitting.unloaded]) if kind.frozen else data
    problem = load_problem(urdf_of(sitting.world.conditions.arm))
    begin = time.process_time()
    estimate = identify(problem, learnt, "ols", effects=list(sitting.effects))
    between = time.process_time()
    diagnosis = diagnose(estimate, data, test.run, frozen=kind.frozen)
    result = diagnosis.to_dict()
    record: Record = {
        "verdict": result["verdict"],
        "found": [{name: f[name] for name in _KEPT} for f in result["effects"]],
        "retuned": result.get("retuned", []),
        "events": result["events"],
        "identify_seconds": between - begin,
        "seconds": time.process_time() - between,
        "curves": [{"joint": c.joint, "of": c.of, "formula": c.formula} for c in diagnosis.curves],
    }
    if kind.what == "curves":
        record["curve"] = judged_curve(diagnosis, sitting.hidden[0], sitting.logged, estimate, data)
    if sitting.hidden:
        record["energy"] = energies(logged, estimate, kind.frozen)
    if kind.what in ("none", "effects"):
        settled = replace(estimate, preprocessing=estimate.preprocessing.resolve(test.run))
        record["after"] = (np.array(result["held_out_rmse"]) / true_floor(test, settled)).tolist()
    return record


def rounded(value: Any) -> Any:
    """The same with all floats at six digits: thousands of records are kept."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {key: rounded(x) for key, x in value.items()}
    return [rounded(x) for x in value] if isinstance(value, (list, tuple)) else value


#: Of the record's format: cases of another version are simulated anew.
VERSION = 3


def run_challenge(
    cases: int,
    seed: int,
    out: Path,
    workers: Workers = ALONE,
    classes: Sequence[str] | None = None,
    nuisances: Sequence[str] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Path]:
    """Run what is missing; write challenge.json, and from all of its cases of this seed challenge.md.

    cases : of each class; of clean robots, of each nuisance; workers : who simulates. Raises InputError
    for a class or a nuisance that does not exist.
    """
    kinds = _known("class", classes, CLASSES)
    conditions = _known("nuisance", nuisances, NUISANCES)
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    store, report = out / "challenge.json", out / "challenge.md"
    records: dict[str, Record] = {}
    with alone(out):
        if store.is_file():
            kept = json.loads(store.read_text())
            records = kept["cases"] if kept.get("version") == VERSION else {}
        todo = [c for c in wanted(cases, seed, kinds, conditions) if c.key not in records]
        found = spread(run_case, todo, workers.scheduler, workers.jobs)
        for done, (key, record) in enumerate(found, start=1):
            records = dict(sorted({**records, key: record}.items(), key=lambda pair: _order(pair[0])))
            progress(f"case {done} of {len(todo)}")
            write_text(store, json.dumps({"version": VERSION, "cases": records}) + "\n")
        mine = {key: r for key, r in records.items() if key.split("/")[2] == str(seed)}
        write_text(report, report_text(mine, seed))
    return [store, report]


def wanted(cases: int, seed: int, kinds: Sequence[str], conditions: Sequence[str]) -> list[Case]:
    """Cases, class by class; what hides an effect meets the nuisances at random."""
    out = []
    for kind, k in product(kinds, range(cases)):
        drawn = np.random.default_rng([seed, list(CLASSES).index(kind), k]).choice(conditions)
        out += [Case(kind, x, seed, k) for x in (conditions if kind == "clean" else [str(drawn)])]
    return out


def _known(what: str, names: Sequence[str] | None, known: Mapping[str, Any]) -> list[str]:
    for name in names or ():
        if name not in known:
            raise InputError(f"{what} {name!r} is unknown", f"choose among: {', '.join(known)}")
    return list(names or known)


def _order(key: str) -> tuple[int, int, int, int]:
    kind, nuisance, seed, index = key.split("/")
    return list(CLASSES).index(kind), list(NUISANCES).index(nuisance), int(seed), int(index)
