"""Columns of effects on low-passed rows, each worked out once."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.effects.effect import Block, Effect, Motion
from sdp_vs_penalty.effects.model import depends
from sdp_vs_penalty.signals.kernels import Decimator

#: Effects low-passed together; parameters from which on one is so by itself, a few rows at a time.
_AT_ONCE, _WIDE, _ROWS = 32, 12, 256
#: Effects whose columns are kept.
_MOST = 1024


class Columns:
    """parts : low-pass (M, N) and motion of each segment; before : the same of another model, from which
    columns of the motion alone are taken over."""

    def __init__(self, parts: Sequence[tuple[Decimator, Motion]], before: Columns | None = None) -> None:
        self._parts = parts
        #: What is known of the motion alone and, with the model's torque and links, of this model.
        self._kept: tuple[dict[Hashable, tuple[Effect, list[Block]]], ...]
        self._kept = ({} if before is None else before._kept[0], {})

    def of(self, effects: Sequence[Effect]) -> list[list[Block]]:
        """Blocks of (M, k) of the true torque, of each effect."""
        found = [self._known(effect) for effect in effects]
        missing = [k for k, known in enumerate(found) if known is None]
        wide = [k for k in missing if self._by_parts(effects[k])]
        narrow = [k for k in missing if k not in wide]
        lots = [[k] for k in wide] + [narrow[k : k + _AT_ONCE] for k in range(0, len(narrow), _AT_ONCE)]
        for lot in lots:
            made = self._made([effects[k] for k in lot], lot[0] in wide)
            for k, blocks in zip(lot, made, strict=True):
                found[k] = blocks
                kept = self._kept[depends(effects[k])]
                kept[self._key(effects[k])] = effects[k], blocks
                while len(kept) > _MOST:
                    kept.pop(next(iter(kept)))
        return [blocks for blocks in found if blocks is not None]

    @staticmethod
    def _by_parts(effect: Effect) -> bool:
        whole = depends(effect) or effect.has_memory
        return not whole and len(effect.parameters) >= _WIDE

    def _made(self, effects: Sequence[Effect], by_parts: bool) -> list[list[Block]]:
        rows, made = [], list[list[Block]]()
        for low_pass, motion in self._parts:
            count = len(low_pass.at)
            step = _ROWS if by_parts else count
            for start in range(0, count, step):
                few, around = low_pass.part(start, start + step) if by_parts else (low_pass, slice(None))
                made = [e.blocks(motion.part(around) if by_parts else motion) for e in effects]
                rows.append(few @ np.hstack([b.columns for blocks in made for b in blocks]))
        sizes = [b.columns.shape[1] for blocks in made for b in blocks]
        columns = iter(np.split(np.concatenate(rows), np.cumsum(sizes)[:-1], axis=1))
        return [[replace(b, columns=next(columns)) for b in blocks] for blocks in made]

    def _known(self, effect: Effect) -> list[Block] | None:
        known = self._kept[depends(effect)].get(self._key(effect))
        return known[1] if known is not None and known[0].same_columns(effect) else None

    def _key(self, effect: Effect) -> Hashable:
        width = None if effect.signless or not self._parts else self._parts[0][1].sign_width
        return type(effect), effect.joints, tuple(effect.shape.items()), width
