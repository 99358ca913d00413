"""What every effect keeps that can be hidden: its columns are the torque of the hidden world, signed.

The hidden world states the torque of an effect a second time; this holds the two against each other.
"""

from __future__ import annotations

import inspect
import sys
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from types import CodeType
from typing import Any

import numpy as np
from effect_contract import Array, wide_columns

from sdp_vs_penalty.diagnosis.explanations import size_of
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import CurrentModel, Effect, Motion
from sdp_vs_penalty.effects.hidden import HiddenEffect, TrueRobot
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.trajectory import FourierTrajectory, random_trajectory
from sdp_vs_penalty.simulation.experiment import experiment
from sdp_vs_penalty.simulation.hidden_runs import hidden_torque, make_hidden, true_robot

#: Of the torque: what sampling, and columns that are of first order in their parameter, may cost.
ACCURACY = 0.02
#: Draws a joint: together they meet every form and every sign of every effect.
DRAWS = 6


@cache
def worlds() -> dict[str, tuple[Problem, TrueRobot]]:
    """A seven-joint arm, and one with a prismatic joint between two revolute ones."""
    urdf = Path(__file__).parent / "slide_arm.urdf"
    problems = {"panda": load_problem("panda"), "slide_arm": load_problem(urdf)}
    return {k: (p, true_robot(p, experiment(p), seed=3)) for k, p in problems.items()}


@dataclass(frozen=True)
class Case:
    """One hidden effect: its torque (n, N); columns (n, N, k) of the effect with the true shape; plain
    (n, N, m) columns of the effects that it refines, where it counts time from elsewhere."""

    where: str
    hidden: HiddenEffect
    effect: Effect
    torque: Array
    columns: Array
    plain: Array


@cache
def hidden_cases(name: str) -> tuple[Case, ...]:
    """What the hidden world draws, wherever it makes a torque: an axis along gravity has no backlash."""
    kind = effect_types()[name]
    cases = []
    for which, (problem, world) in worlds().items():
        trajectory = random_trajectory(problem.robot, 5, 22.0, frequency=2.0 * np.pi / 13.3)
        for joint in [0] if kind.whole_robot else sorted({0, problem.robot.n // 2, problem.robot.n - 1}):
            for draw in range(DRAWS):
                rng = np.random.default_rng([draw, joint])
                hidden = make_hidden(name, joint, world, rng).sized(0.5)
                case = _case(f"{which} joint {joint + 1} draw {draw}", world, hidden, trajectory)
                if np.abs(case.torque).max() > 1e-9:
                    cases.append(case)
    return tuple(cases)


def _case(where: str, world: TrueRobot, hidden: HiddenEffect, trajectory: FourierTrajectory) -> Case:
    kind = effect_types()[hidden.effect]
    # A sign is a sign, but a delayed one has a derivative.
    width = 1e-8 if hidden.late is None else 0.3
    sharp = replace(world, dry_width=width)
    # Derivatives in time are differences; a friction state is integrated here and exact in the columns.
    rate = (1000.0 if hidden.torque else 100.0) if kind.has_memory else 25.0
    motion, torque = hidden_torque(sharp, hidden, trajectory, 0.0, rate)
    motion = replace(
        motion,
        torque=sharp.torque(motion) if kind.needs_torque else None,
        current=CurrentModel(world.robot, world.links),
        sign_width=width,
    )

    def columns(kind: type[Effect], **shape: float) -> tuple[Effect, Array]:
        convention = {k: width for k, s in kind.shapes.items() if s.role == "estimated"}
        effect = kind(world.robot, list(hidden.joints) or None, **convention, **shape)
        return effect, wide_columns(effect, motion)

    effect, own = columns(kind, **hidden.details.get("shape", {}))
    plain = [columns(effect_types()[r])[1] for r in kind.refines if kind.follows_clock]
    none = np.zeros((*own.shape[:2], 0))
    return Case(where, hidden, effect, torque.T, own, np.concatenate([none, *plain], axis=2))


def check_columns_are_the_hidden_torque(name: str) -> None:
    """In amount and sign: torque less columns times the true parameters is next to nothing."""
    met = set()
    for case in hidden_cases(name):
        assert case.hidden.theta is not None
        error = case.torque - case.columns @ (case.hidden.size * np.array(case.hidden.theta))
        left = [
            e - p @ np.linalg.lstsq(p, e)[0] if p.any() else e
            for e, p in zip(error, case.plain, strict=True)
        ]
        share = float(np.linalg.norm(left) / np.linalg.norm(case.torque))
        assert share < ACCURACY, f"{name}, {case.where}: {100 * share:.1f} % is not in the columns"
        met |= {case.effect.robot.joints[j].kind for j in case.hidden.joints}
    assert met == (set() if effect_types()[name].whole_robot else {"revolute", "prismatic"})


def check_the_truth_is_what_a_finding_would_say(name: str) -> None:
    """The true parameters are possible, and bounded by zero exactly where the hidden world never goes
    below; the size that a scorer reads is that of a finding with them; every form is met."""
    kind = effect_types()[name]
    bounded, positive, forms = True, True, set()
    for case in hidden_cases(name):
        hidden, parameters = case.hidden, case.effect.parameters
        assert hidden.effect == name
        assert hidden.theta is not None
        theta = hidden.size * np.array(hidden.theta)
        demands = case.effect.constraints(np.arange(len(theta)))
        assert all(c.margin(theta) >= 0.0 for c in demands), "the truth itself is not possible"
        bounded &= all(p.lower == 0.0 for p in parameters)
        # One channel is late, never early; all of them are early where the positions are late.
        positive &= bool(np.all(theta >= 0.0)) and (hidden.late is None or not kind.whole_robot)
        if kind.one_number:
            size, _ = size_of(case.effect, theta, np.zeros((len(theta),) * 2))
            np.testing.assert_allclose(abs(size), hidden.amplitude, rtol=1e-12)
        forms.add(tuple(case.effect.shape[k] for k, s in kind.shapes.items() if s.choices))
    assert bounded or not positive, f"{name}: what is hidden is never negative; declare lower = 0.0"
    assert positive or not bounded, f"{name}: what is hidden is negative too; leave lower = 0.0 out"
    choices = [len(s.choices) for s in kind.shapes.values() if s.choices]
    assert len(forms) == int(np.prod(choices)), "the hidden world does not meet every form"


def check_the_hidden_world_shares_no_code(name: str) -> None:
    """No code of their folder is reached from both the class and ``hidden``, and ``hidden`` reads of a
    motion only what a motion is: no smoothed sign, no model's torque."""
    kind = effect_types()[name]
    hidden_side = reached(vars(sys.modules[kind.__module__])["hidden"])
    shared = hidden_side & reached(kind)
    assert not shared, f"{name}: {shared} is used by the columns and by the hidden world"
    for _, world in worlds().values():
        still = np.zeros((3, world.robot.n))
        bare = BareMotion(np.arange(3.0), still, still + 0.1, still)
        hidden = make_hidden(name, world.robot.n - 1, world, np.random.default_rng(0))
        for change in (hidden.torque, hidden.encoder):
            if change is not None:
                change(world, bare, 1.0)


class BareMotion(Motion):
    """A motion that refuses what the library derives from it."""

    def __getattribute__(self, word: str) -> Any:
        derived = {a for a in vars(Motion) if not a.startswith("_")} - {f.name for f in fields(Motion)}
        assert word not in derived, f"the hidden world reads Motion.{word}"
        return super().__getattribute__(word)


def reached(thing: object) -> set[object]:
    """The classes and functions of the folder of effects that run when this one does."""
    found: set[object] = set()
    todo = [thing]
    while todo:
        here = todo.pop()
        if here in found or here in (HiddenEffect, TrueRobot):
            continue
        found.add(here)
        if inspect.isclass(here):
            todo += [base for base in here.__bases__ if base.__module__.startswith(_FOLDER)]
        home = vars(sys.modules[here.__module__])
        used = [home.get(word) for code in code_of(here) for word in code.co_names]
        todo += [
            x
            for x in used
            if (inspect.isfunction(x) or inspect.isclass(x)) and x.__module__.startswith(_FOLDER)
        ]
    return found


_FOLDER = "sdp_vs_penalty.effects."


def code_of(thing: object) -> list[CodeType]:
    """The code of a function, or of all methods of a class, with the functions inside."""
    if inspect.isclass(thing):
        return [code for value in vars(thing).values() for code in code_of(value)]
    for wrapped in ("fget", "func", "__func__"):
        thing = getattr(thing, wrapped, None) or thing
    found, todo = [], [code] if isinstance(code := getattr(thing, "__code__", None), CodeType) else []
    while todo:
        found.append(todo.pop())
        todo += [inner for inner in found[-1].co_consts if isinstance(inner, CodeType)]
    return found
