"""The classes of the challenge: what is hidden in a case, drawn at random by its seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects import DEFAULT_EFFECTS, effect_types
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.external_wrench import wrench_torque
from sdp_vs_penalty.effects.hidden import Hidden, World, on_joint
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.simulation.hidden_effects import hideable, lugre
from sdp_vs_penalty.simulation.hidden_runs import starts

Array = NDArray[np.float64]

#: White, partialled energy from which a hidden effect counts as identifiable.
IDENTIFIABLE = 30.0
#: Links that stand elsewhere than the model believes by more than this [rad, m] belong to no machine,
#: and first-order columns end there; on a light link that alone makes the torque that is asked for.
FARTHEST = 0.3


@dataclass(frozen=True)
class CaseClass:
    """name; level : of the hidden torque; what : which draw; runs : of training data; frozen."""

    name: str
    what: str
    level: str | float
    runs: int = 3
    frozen: bool = False


CLASSES: Mapping[str, CaseClass] = {
    c.name: c
    for c in (
        CaseClass("clean", "nothing", 0.0),
        CaseClass("strong", "library", "strong"),
        CaseClass("medium", "library", "medium"),
        CaseClass("weak", "library", "weak"),
        CaseClass("one_run", "library", "strong", runs=1),
        CaseClass("two_effects", "two", "medium"),
        CaseClass("other_forms", "forms", "medium"),
        CaseClass("unknown_strong", "unknown", "strong"),
        CaseClass("unknown_medium", "unknown", "medium"),
        CaseClass("disturbance", "time", "strong"),
        CaseClass("payload", "payload", "strong", frozen=True),
    )
}


@dataclass(frozen=True)
class Draw:
    """effects : names and joints for the simulation; made : hidden effects outside the library."""

    effects: list[tuple[str, list[int]]] = field(default_factory=list)
    made: list[Hidden] = field(default_factory=list)


def draw(case: CaseClass, problem: Problem, world: World, seed: int) -> Draw:
    """What is hidden in the case of this seed."""
    rng = np.random.default_rng([seed, 4])
    n = problem.robot.n
    if case.what == "nothing":
        return Draw()
    if case.what == "library":
        # Every effect in turn, so that each is met equally often.
        names = _drawn()
        return Draw([(names[seed % len(names)], [int(rng.integers(n))])])
    if case.what == "two":
        return Draw(_two(n, rng))
    if case.what == "payload":
        return Draw([("payload", [])])
    joint = int(rng.integers(n))
    if case.what == "forms":
        if rng.random() < 0.5:
            return Draw(made=[lugre(joint, world, rng)])
        return Draw([("torque_delay", [joint])])
    makers: Mapping[str, Callable[..., Hidden]] = {"unknown": unknown, "time": disturbance}
    return Draw(made=[makers[case.what](joint, world, rng)])


def _drawn() -> list[str]:
    """Effects that show against a model which is refitted."""
    return [name for name in hideable() if not effect_types()[name].frozen_only]


def _two(n: int, rng: np.random.Generator) -> list[tuple[str, list[int]]]:
    """Two different effects, not two of one kind that stand for each other (all of one table row)."""
    names = [name for name in _drawn() if name not in DEFAULT_EFFECTS]
    first, second = rng.choice(names, 2, replace=False)
    return [(str(first), [int(rng.integers(n))]), (str(second), [int(rng.integers(n))])]


def unknown(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    """A function of the state that is not in the library."""
    n = world.robot.n
    other = int(rng.choice([i for i in range(n) if i != joint])) if n > 1 else joint
    c = float(rng.uniform(-0.5, 0.5))
    laws: Mapping[str, Callable[[Motion], Array]] = {
        "q dq": lambda m: m.q[:, joint] * m.dq[:, joint],
        "cos(q_i) sign(dq_j)": lambda m: np.cos(2.0 * m.q[:, other] + c) * np.sign(m.dq[:, joint]),
        "sin(2 q_j + 3 q_i)": lambda m: np.sin(2.0 * m.q[:, joint] + 3.0 * m.q[:, other] + c),
        "q_i dq_j": lambda m: m.q[:, other] * m.dq[:, joint],
        "dq_i dq_j": lambda m: m.dq[:, other] * np.abs(m.dq[:, joint]),
        "bumps of q": lambda m: np.exp(-(((m.q[:, joint] - m.q[:, joint].mean() - c) / 0.15) ** 2)),
        "dq ddq": lambda m: m.dq[:, joint] * m.ddq[:, joint],
    }
    name = str(rng.choice(sorted(laws)))
    law = laws[name]
    return Hidden(f"unknown: {name}", (joint,), lambda w, m, a: a * on_joint(joint, n, law(m)))


def disturbance(joint: int, world: World, rng: np.random.Generator) -> Hidden:
    """Something that happens once, or goes on beside the motion: a contact, a knock, a hum."""
    n = world.robot.n
    kind = str(rng.choice(["contact", "hum", "knock"]))
    run = int(rng.integers(3))
    start = starts(run) + float(rng.uniform(3.0, 18.0))  # on the sitting's clock, inside a run
    length = {"contact": rng.uniform(0.3, 2.0), "knock": rng.uniform(0.05, 0.15), "hum": 0.0}[kind]
    frequency, phase = float(rng.uniform(1.0, 7.0)), float(rng.uniform(0.0, 2.0 * np.pi))
    force, moment = rng.normal(size=3), 0.1 * rng.normal(size=3)
    details: dict[str, Any] = {"kind": kind, "t_start": start, "t_end": start + float(length)}

    def torque(w: World, m: Motion, a: float) -> Array:
        if kind == "hum":
            return a * on_joint(joint, n, np.sin(2.0 * np.pi * frequency * m.t + phase))
        inside = (m.t >= start) & (m.t < start + length)
        out = np.zeros_like(m.q)
        if inside.any():
            part = Motion(m.t[inside], m.q[inside], m.dq[inside], m.ddq[inside])
            if kind == "contact":
                ramp = np.sin(np.pi * (part.t - start) / length)[:, None]
                out[inside] = a * ramp * wrench_torque(w, part, force, moment)
            else:
                ring = np.exp(-3.0 * (part.t - start) / length)
                out[inside] = a * on_joint(joint, n, ring)
        return out

    return Hidden(f"disturbance: {kind}", (joint,), torque, details=details)
