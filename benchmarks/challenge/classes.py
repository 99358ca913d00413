"""The classes of the challenge: what is hidden in a case, and how strongly."""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from challenge.worlds.conditions import Conditions
from challenge.worlds.hidden_unknown import disturbance, nameless, unknown
from challenge.worlds.motion import thinned
from sdp_vs_penalty.simulation.worlds.hidden import LEVELS, Hidden, Maker
from sdp_vs_penalty.simulation.worlds.hidden_friction import FRICTION
from sdp_vs_penalty.simulation.worlds.hidden_machine import FROZEN, MACHINE
from sdp_vs_penalty.simulation.worlds.world import TrueMotion, World

#: What every model in question has, unless that is what is hidden.
USUAL = ("rigid_body", "viscous_friction", "coulomb_friction", "torque_offset")
#: What can be hidden from a model that is refitted.
EFFECTS: Mapping[str, Maker] = {**FRICTION, **MACHINE}
#: Energy, white and with the model partialled out, from which a hidden effect counts as identifiable.
IDENTIFIABLE = 30.0
#: Links that stand farther from where the encoders say [rad, m] belong to no machine.
FARTHEST = 0.3


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
