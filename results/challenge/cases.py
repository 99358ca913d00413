"""How often is the diagnosis right? The classes of cases, and a case from its seed to
its record.

Every case is simulated by its own seed, diagnosed without sight of the truth, and then
compared with it. Cases are kept one by one, so that an interrupted challenge goes on
where it stopped.
"""

import json
import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from challenge.judge import Record, report_text
from challenge.truth import energies, judged_curve, true_floor
from challenge.worlds.conditions import (
    NUISANCES,
    Conditions,
    Site,
    draw_conditions,
    fair,
)
from challenge.worlds.hidden_unknown import disturbance, nameless, unknown
from challenge.worlds.runs import Logged, draw_motion, draw_world, log_run, urdf_of
from sdp_vs_penalty.data.measurements import concatenate
from sdp_vs_penalty.diagnosis.diagnose import diagnose
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import PoseOptions, read_and_filter
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.identify import estimate_parameters
from sdp_vs_penalty.files import folder_lock, write_text
from sdp_vs_penalty.parallel import spread
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.simulation.worlds import hidden as makers
from sdp_vs_penalty.simulation.worlds.hidden import LEVELS, Hidden, torques
from sdp_vs_penalty.simulation.worlds.world import TrueMotion

#: What every model in question has, unless that is what is hidden.
USUAL = ("rigid_body", "viscous_friction", "coulomb_friction", "torque_offset")
#: What can be hidden from a model that is refitted.
EFFECTS: Mapping[str, makers.Maker] = {**makers.FRICTION, **makers.MACHINE}
#: What rubs as the world's own friction does, by its name where that turns round over a
#: travel.
SLOW = {"load_dependent_friction": "load_dependent_hysteresis"}


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


@dataclass(frozen=True)
class CaseClass:
    """what : none, effects, unknown, curves, disturbance or payload; level : of LEVELS;
    count : effects; frozen : the model was identified before, without them."""

    what: str
    level: str = "strong"
    count: int = 1
    one_run: bool = False

    @property
    def frozen(self) -> bool:
        return self.what == "payload"

    def conditions(self, drawn: Conditions) -> Conditions:
        return (
            replace(drawn, runs=1, duration=max(drawn.duration, 20.0))
            if self.one_run
            else drawn
        )

    def names(self, case: Case, rng: np.random.Generator) -> list[str]:
        """Effects of the library to hide: a single one in turn, in an order of the
        seed's, so that each is met equally often; of several none that the model
        usually has."""
        if self.what != "effects":
            return []
        if self.count == 1:
            turns = np.random.default_rng([case.seed, zlib.crc32(case.kind.encode())])
            return [str(turns.permutation([*EFFECTS])[case.index % len(EFFECTS)])]
        others = [name for name in EFFECTS if name not in USUAL]
        return [str(x) for x in rng.choice(others, self.count, replace=False)]

    def hidden(
        self,
        names: Sequence[str],
        world: Site,
        motions: Sequence[TrueMotion],
        rng: np.random.Generator,
    ) -> list[Hidden]:
        """The hidden effects, sized on the motions that are identified from."""
        kinds = {"unknown": unknown, "curves": nameless, "disturbance": disturbance}
        kinds |= {**makers.FROZEN, **EFFECTS}
        coarse = [
            replace(m, **{x: v[::10] for x, v in vars(m).items()}) for m in motions
        ]
        wanted = names or {self.what} & set(kinds)
        made = [
            (x, kinds[x](world, int(rng.integers(world.arm.n)), rng)) for x in wanted
        ]
        slow = {} if world.dry.jumps else SLOW
        called = [replace(one, effect=one.effect or slow.get(x, x)) for x, one in made]
        return [one.sized(world, coarse, LEVELS[self.level]) for one in called]


CLASSES: Mapping[str, CaseClass] = {
    "clean": CaseClass("none"),
    "strong": CaseClass("effects", "strong"),
    "medium": CaseClass("effects", "medium"),
    "weak": CaseClass("effects", "weak"),
    "one_run": CaseClass("effects", "strong", one_run=True),
    "pairs": CaseClass("effects", "medium", 2),
    "triples": CaseClass("effects", "medium", 3),
    "unknown_strong": CaseClass("unknown", "strong"),
    "unknown_medium": CaseClass("unknown", "medium"),
    "unknown": CaseClass("curves", "strong"),
    "disturbance": CaseClass("disturbance", "strong"),
    "payload": CaseClass("payload", "strong"),
}

_KEPT = ("effect", "joints", "size", "std", "shape", "confidence")


@dataclass(frozen=True)
class BuiltCase:
    """The world of a case, its motions and what was logged of them, the last for the
    test; what is hidden; rng : the case's stream behind all of this."""

    names: list[str]
    conditions: Conditions
    world: Site
    motions: list[TrueMotion]
    hidden: list[Hidden]
    logged: list[Logged]
    rng: np.random.Generator


def build_case(case: Case) -> BuiltCase:
    """A case's world and logs, in a random stream of its own."""
    rng = np.random.default_rng([case.seed, case.index, zlib.crc32(case.key.encode())])
    kind = CLASSES[case.kind]
    conditions = kind.conditions(draw_conditions(case.nuisance, rng))
    names = kind.names(case, rng)
    if "warming_friction" in names:
        conditions = replace(conditions, thermometer=True)
    world = draw_world(conditions, rng, without=names)
    motions = [draw_motion(world, k, rng) for k in range(conditions.runs + 1)]
    hidden = kind.hidden(names, world, motions[:-1], rng)
    logged = [log_run(world, m, rng, torques(world, m, hidden)) for m in motions]
    return BuiltCase(names, conditions, world, motions, hidden, logged, rng)


def identify_case(case: Case, built: BuiltCase) -> Estimate:
    """The model in question. A frozen one was identified in another sitting, without
    what is hidden."""
    learnt: Sequence[Logged] = built.logged[:-1]
    if CLASSES[case.kind].frozen:
        world = built.world
        n_runs = built.conditions.runs
        others = [draw_motion(world, k, built.rng) for k in range(n_runs)]
        learnt = [log_run(world, m, built.rng) for m in others]
    effects = [name for name in USUAL if name not in built.names]
    problem = load_problem(urdf_of(built.conditions.arm))
    runs = concatenate([x.run for x in learnt])
    options = PoseOptions(effects=effects)
    return estimate_parameters(problem, read_and_filter(problem, runs), "ols", options)


def truth_of(case: Case, built: BuiltCase) -> Record:
    """What the judge knows of a case, and nothing of the diagnosis."""
    allowed, abstains = fair(built.conditions)
    world = built.world
    return {
        "class": case.kind,
        "nuisance": case.nuisance,
        "conditions": asdict(built.conditions) | {"dry": world.dry.to_dict()},
        "truth": [h.truth for h in built.hidden],
        "deviation": [deviation(h, world, built.motions[0]) for h in built.hidden],
        "fair": sorted(allowed),
        "abstains": abstains,
        **{
            name: []
            for name in ("found", "retuned", "events", "passing", "after", "energy")
        },
    }


def run_case(case: Case) -> tuple[str, Record]:
    """The case's key and its record, which is plain JSON: its world and runs, the last
    of which is the test run, what the diagnosis says of them, in how many seconds of
    the processor, and the truth."""
    built = build_case(case)
    record = truth_of(case, built)
    begin = time.process_time()
    try:
        estimate = identify_case(case, built)
        record |= _diagnosed(
            CLASSES[case.kind],
            estimate,
            built.logged,
            built.hidden,
            time.process_time() - begin,
        )
    except InputError as error:
        record |= {"verdict": "refused", "error": str(error)}
    return case.key, rounded(record)


def _diagnosed(
    kind: CaseClass,
    estimate: Estimate,
    logged: Sequence[Logged],
    hidden: Sequence[Hidden],
    spent: float,
) -> Record:
    """spent : on identifying [s]."""
    *runs, test = logged
    data = concatenate([x.run for x in runs])
    begin = time.process_time()
    diagnosis = diagnose(estimate, data, test.run, frozen=kind.frozen)
    result = diagnosis.to_dict()
    record: Record = {
        "verdict": result["verdict"],
        "found": [
            {name: f[name] for name in _KEPT}
            | {"indistinguishable_from": [rival["name"] for rival in f["rivals"]]}
            for f in result["effects"]
        ],
        "retuned": result.get("retuned", []),
        "events": result["named_by_check"],
        "passing": result["passing"],
        "identify_seconds": spent,
        "seconds": time.process_time() - begin,
        "curves": [
            {"joint": c.joint, "of": c.of, "formula": c.formula}
            for c in diagnosis.curves
        ],
    }
    if kind.what == "curves":
        record["curve"] = judged_curve(diagnosis, hidden[0], logged, estimate)
    if hidden:
        record["energy"] = energies(runs, estimate, kind.frozen)
    if kind.what in ("none", "effects"):
        record["after"] = (diagnosis.ladder[-1] / true_floor(test, estimate)).tolist()
    return record


def deviation(hidden: Hidden, world: Site, m: TrueMotion) -> float:
    """Root mean square of the shift [rad or m]; 0 for an effect that shifts nothing."""
    shift = 0.0 if hidden.shift is None else hidden.shift(world, m, hidden.size)
    return float(np.sqrt(np.mean(np.square(shift))))


def rounded(record: Record) -> Record:
    """As JSON has it, with all floats at six digits: thousands of records are kept."""
    return dict(
        json.loads(json.dumps(record), parse_float=lambda x: float(f"{float(x):.6g}"))
    )


#: Of the record's format: cases of another version are simulated anew.
VERSION = 4


def kept_records(store: Path) -> dict[str, Record]:
    """Read the records of challenge.json by their case, in this version's format; none
    if there is no such file, or it is of another version."""
    if not store.is_file():
        return {}
    kept = json.loads(store.read_text())
    return dict(kept["cases"]) if kept.get("version") == VERSION else {}


def run_challenge(todo: Sequence[Case], seed: int, out: Path, jobs: int) -> list[Path]:
    """Run what is missing; write challenge.json, and from all of its cases of this seed
    challenge.md."""
    store = out / "challenge.json"
    report = out / "challenge.md"
    with folder_lock(out):
        records = kept_records(store)
        todo = [c for c in todo if c.key not in records]
        for done, (_, (key, record)) in enumerate(
            spread(run_case, todo, jobs=jobs), start=1
        ):
            records = dict(
                sorted(
                    {**records, key: record}.items(), key=lambda pair: _order(pair[0])
                )
            )
            print(f"case {done} of {len(todo)}", end="\r")
            write_text(store, json.dumps({"version": VERSION, "cases": records}) + "\n")
        mine = {key: r for key, r in records.items() if key.split("/")[2] == str(seed)}
        write_text(report, report_text(mine, seed))
    return [store, report]


def wanted(
    cases: int, seed: int, kinds: Sequence[str], conditions: Sequence[str]
) -> list[Case]:
    """Cases, class by class; what hides an effect meets the nuisances at random."""
    out = []
    for kind, k in product(kinds, range(cases)):
        drawn = np.random.default_rng([seed, list(CLASSES).index(kind), k]).choice(
            conditions
        )
        out += [
            Case(kind, x, seed, k)
            for x in (conditions if kind == "clean" else [str(drawn)])
        ]
    return out


def _order(key: str) -> tuple[int, int, int, int]:
    kind, nuisance, seed, index = key.split("/")
    return (
        list(CLASSES).index(kind),
        list(NUISANCES).index(nuisance),
        int(seed),
        int(index),
    )
