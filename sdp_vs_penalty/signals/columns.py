"""Columns of effects on low-passed rows, each worked out once."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import Block, Effect, Motion
from sdp_vs_penalty.effects.model import depends
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.kernels import Decimator

#: Columns that are low-passed together, and from how many on an effect's are so for each joint.
_AT_ONCE, _WIDE = 64, 12
#: Rows of a wide effect that are worked out together.
_ROWS = 256
#: For how many widths of signs columns are kept, and how much of what was asked for one by one [bytes].
_WIDTHS, _MOST_KEPT = 2, 48_000_000


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
    """parts : low-pass (M, N) and motion of each segment; before : the same of another model, from which
    columns of the motion alone are taken over, for each set of those widths of signs that they ask for.
    """

    def __init__(
        self, parts: Sequence[tuple[Decimator, Motion]], n: int, before: Columns | None = None
    ) -> None:
        self._of_motion: dict[Hashable, Any] = {} if before is None else before._of_motion
        self._of_model: dict[Hashable, Any] = {}
        self._low_passes, self._own = [d for d, _ in parts], [motion for _, motion in parts]
        self._widths = _Widths(motion.width(j) for motion in self._own[:1] for j in range(n))
        self._watched = [replace(motion, sign_width=self._widths) for motion in self._own]

    def of(self, effects: Sequence[Effect]) -> list[list[Block]]:
        """Blocks of (M, k) of the true torque, of each effect."""
        out = [self._known(effect) for effect in effects]
        waiting: list[tuple[int, list[list[Block]], dict[int, float]]] = []
        missing, size = [place for place, known in enumerate(out) if known is None], 0
        for place in missing:
            effect = effects[place]
            self._widths.asked.clear()
            if depends(effect) or effect.has_memory or len(effect.parameters) < _WIDE:
                motions = self._own if depends(effect) else self._watched
                made = [effect.blocks(m) for m in motions]
                waiting.append((place, made, dict(self._widths.asked)))
                size += sum(b.columns.shape[1] for b in made[0])
            else:
                blocks = out[place] = self._by_parts(effect)
                self._keep(effect, blocks, dict(self._widths.asked), len(effects) > 1)
            if not waiting or (size < _AT_ONCE and place != missing[-1]):
                continue
            passed = iter(self._low_passed([made for _, made, _ in waiting]))
            for at, made, asked in waiting:
                blocks = [Block(b.joint, b.parameters, next(passed)) for b in made[0]]
                self._keep(effects[at], blocks, asked, len(effects) > 1)
                out[at] = blocks
            size = 0
            waiting.clear()
        return [blocks for blocks in out if blocks is not None]

    def _by_parts(self, effect: Effect) -> list[Block]:
        """The rows of a wide effect of the motion alone, a few after the other."""
        rows: list[list[Block]] = []
        for low_pass, motion in zip(self._low_passes, self._watched, strict=True):
            for start in range(0, len(low_pass.at), _ROWS):
                few, around = low_pass.part(start, start + _ROWS)
                made = effect.blocks(motion.part(around))
                rows.append([replace(b, columns=few @ b.columns) for b in made])
        return [
            replace(parts[0], columns=np.concatenate([b.columns for b in parts]))
            for parts in zip(*rows, strict=True)
        ]

    def _low_passed(self, made: Sequence[Sequence[Sequence[Block]]]) -> list[Array]:
        """The rows of all blocks of all effects, from those of each segment."""
        parts = []
        for k, low_pass in enumerate(self._low_passes):
            columns = [b.columns for blocks in made for b in blocks[k]]
            narrow = [c for c in columns if c.shape[1] < _WIDE]
            ends = np.cumsum([c.shape[1] for c in narrow])
            few = iter(np.split(low_pass @ np.hstack(narrow), ends[:-1], axis=1) if narrow else ())
            parts.append([next(few) if c.shape[1] < _WIDE else low_pass @ c for c in columns])
        return [np.concatenate(rows) for rows in zip(*parts, strict=True)]

    def _known(self, effect: Effect) -> list[Block] | None:
        kept = (self._of_model if depends(effect) else self._of_motion).get(_key(effect))
        for asked, blocks in () if kept is None or kept[0] is not effect.robot else kept[1]:
            if self._widths.same(asked):
                found: list[Block] = blocks
                return found
        return None

    def _keep(
        self, effect: Effect, blocks: list[Block], asked: dict[int, float], among_many: bool
    ) -> None:
        if effect_types().get(effect.name) is not type(effect):
            return
        kept, key = self._of_model if depends(effect) else self._of_motion, _key(effect)
        robot, known = kept.get(key, (None, []))
        if robot is not effect.robot:
            _, known = kept[key] = effect.robot, []
        known.append((asked, blocks))
        del known[:-_WIDTHS]
        if not among_many:
            alone, sizes = kept.setdefault("alone", (deque(), deque([0])))
            alone.append(key)
            sizes.append(sizes[-1] + sum(b.columns.nbytes for b in blocks))
            while sizes[-1] - sizes[0] > _MOST_KEPT:
                sizes.popleft()
                kept.pop(alone.popleft(), None)


def _key(effect: Effect) -> Hashable:
    return type(effect), effect.joints, tuple(effect.shape.items())
