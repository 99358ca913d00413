"""Columns on the rows: worked out again where what they follow from has changed, and only there."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import sparse

from sdp_vs_penalty import Problem
from sdp_vs_penalty.effects import Motion, parse_effects
from sdp_vs_penalty.effects.effect import Block
from sdp_vs_penalty.signals.columns import Columns


def test_columns_are_worked_out_once(two_link: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 1.0, 200)
    q = np.column_stack([np.sin(7.0 * t), np.cos(5.0 * t)])
    dq = np.column_stack([7.0 * np.cos(7.0 * t), -5.0 * np.sin(5.0 * t)])
    motion = Motion(t, q, dq, -q, torque=rng.normal(size=(200, 2)), sign_width=(0.01, 0.02))
    low_pass = sparse.csr_array(rng.normal(size=(50, 200)))
    names = "joint_spring:1,presliding_hysteresis:1,presliding_hysteresis:2,torque_gain:1,global_delay"
    effects = parse_effects(names, two_link.robot)
    made: Counter[str] = Counter()
    for effect in effects:
        kind, plain = type(effect), type(effect).blocks

        def counted(self: Any, motion: Motion, plain: Any = plain) -> list[Block]:
            made[self.text.split("@")[0]] += 1
            return list(plain(self, motion))

        if plain.__name__ != "counted":
            monkeypatch.setattr(kind, "blocks", counted)
    derived: dict[Any, Any] = {}

    def asked(motion: Motion, modelled: dict[Any, Any]) -> set[str]:
        made.clear()
        found = Columns([(low_pass, motion)], 2, derived, modelled).of(effects)
        for effect, blocks in zip(effects, found, strict=True):
            for block, exact in zip(blocks, type(effect).blocks(effect, motion), strict=True):
                np.testing.assert_allclose(block.columns, low_pass @ exact.columns, atol=1e-12)
                made[effect.text.split("@")[0]] -= 1 / len(blocks)
        return {name for name, count in made.items() if round(count) > 0}

    every = {"joint_spring:1", "presliding_hysteresis:1", "presliding_hysteresis:2"}
    modelled: dict[Any, Any] = {}
    assert asked(motion, modelled) == every | {"torque_gain:1", "global_delay"}
    assert asked(motion, modelled) == set()
    # Another width on one joint, another model.
    assert asked(replace(motion, sign_width=(0.01, 0.05)), modelled) == {"presliding_hysteresis:2"}
    other = replace(motion, torque=rng.normal(size=(200, 2)))
    assert asked(other, {}) == {"torque_gain:1", "global_delay"}
