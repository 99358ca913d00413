"""Columns of effects on low-passed rows, each worked out once."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import Block, Effect, Motion
from sdp_vs_penalty.effects.model import depends
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.kernels import Decimator

#: Columns that are low-passed together.
_AT_ONCE = 64


class _Widths(tuple[float, ...]):
    """The velocities over which the joints' signs turn; asked : those that an effect has looked at."""

    def __init__(self, _: Iterable[float]) -> None:
        self.asked: dict[int, float] = {}

    def __getitem__(self, joint: Any) -> Any:
        self.asked[joint] = super().__getitem__(joint)
        return self.asked[joint]

    def same(self, asked: dict[int, float]) -> bool:
        """Whether these are the widths that were asked for; nobody has looked at them."""
        return all(super(_Widths, self).__getitem__(j) == width for j, width in asked.items())


class Columns:
    """parts : low-pass (M, N) and motion of each segment; derived : where columns of the motion alone
    are kept, for each set of those widths of signs that they ask for; modelled : those of the model."""

    def __init__(
        self,
        parts: Sequence[tuple[Decimator, Motion]],
        n: int,
        derived: dict[Hashable, Any],
        modelled: dict[Hashable, Any],
    ) -> None:
        self._derived, self._modelled = derived, modelled
        self._low_passes, self._own = zip(*parts, strict=True)
        self._widths = _Widths(self._own[0].width(j) for j in range(n))
        self._watched = [replace(motion, sign_width=self._widths) for motion in self._own]

    def of(self, effects: Sequence[Effect]) -> list[list[Block]]:
        """Blocks of (M, k) of the true torque, of each effect."""
        out = [self._known(effect) for effect in effects]
        waiting: list[tuple[int, list[list[Block]], dict[int, float]]] = []
        missing, size = [place for place, known in enumerate(out) if known is None], 0
        for place in missing:
            effect = effects[place]
            self._widths.asked.clear()
            motions = self._own if depends(effect) else self._watched
            waiting.append((place, [effect.blocks(m) for m in motions], dict(self._widths.asked)))
            size += sum(b.columns.shape[1] for b in waiting[-1][1][0])
            if size < _AT_ONCE and place != missing[-1]:
                continue
            passed = iter(self._low_passed([made for _, made, _ in waiting]))
            for at, made, asked in waiting:
                blocks = [Block(b.joint, b.parameters, next(passed)) for b in made[0]]
                self._keep(effects[at], blocks, asked)
                out[at] = blocks
            size = 0
            waiting.clear()
        return [blocks for blocks in out if blocks is not None]

    def _low_passed(self, made: Sequence[Sequence[Sequence[Block]]]) -> list[Array]:
        """The rows of all blocks of all effects, from those of each segment."""
        rows = []
        for k, low_pass in enumerate(self._low_passes):
            rows.append(low_pass @ np.hstack([b.columns for parts in made for b in parts[k]]))
        ends = np.cumsum([b.columns.shape[1] for parts in made for b in parts[0]])
        return [x.copy() for x in np.split(np.concatenate(rows), ends[:-1], axis=1)]

    def _known(self, effect: Effect) -> list[Block] | None:
        kept = (self._modelled if depends(effect) else self._derived).get(_key(effect))
        for asked, blocks in () if kept is None else kept[1]:
            if self._widths.same(asked):
                found: list[Block] = blocks
                return found
        return None

    def _keep(self, effect: Effect, blocks: list[Block], asked: dict[int, float]) -> None:
        if effect_types().get(effect.name) is type(effect):
            # The robot is kept as well: its number in the key stays its own.
            kept = self._modelled if depends(effect) else self._derived
            kept.setdefault(_key(effect), (effect.robot, []))[1].append((asked, blocks))


def _key(effect: Effect) -> Hashable:
    return type(effect), effect.joints, tuple(effect.shape.items()), id(effect.robot)
