"""All effects the model might miss, as columns on the diagnosis's rows.

A group is one effect on one joint (or on the whole robot) with one set of shape constants. Groups of
the same effect and joint with different constants form a candidate: what the diagnosis names.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.noise import Noise
from sdp_vs_penalty.signals.segments import SegmentedRuns

#: (effect name, joint from 0; None: the whole robot).
Key = tuple[str, int | None]


@dataclass(frozen=True)
class Group:
    """effect : with its joint and shape; joint : whose torque its columns act on, None for several;
    columns : their positions in the library's matrix of that joint (of the robot)."""

    key: Key
    effect: Effect
    joint: int | None
    columns: slice

    @property
    def k(self) -> int:
        return self.columns.stop - self.columns.start

    @property
    def signed(self) -> bool:
        return self.k == 1 and self.effect.parameters[0].lower == 0.0


@dataclass(frozen=True)
class Batch:
    """Groups on one joint (None: on several) with equally many columns: ``groups`` (G,) their places
    in the library, ``columns`` (G, k) those of their columns; signed alike; known (k,) : what
    is known of their parameters beforehand."""

    joint: int | None
    signed: bool
    groups: NDArray[np.intp]
    columns: NDArray[np.intp]
    known: Array | None = None


@dataclass(frozen=True)
class Library:
    """groups, and their filtered columns: ``joints[j]`` (M, C_j) for groups on one joint,
    ``robot`` (n, M, C) for groups on several; batches : the groups, those alike together."""

    groups: tuple[Group, ...]
    joints: tuple[Array, ...]
    robot: Array
    batches: tuple[Batch, ...]

    @property
    def size(self) -> int:
        """How many columns there are to choose from."""
        return sum(m.shape[1] for m in self.joints) + self.robot.shape[2]

    def columns(self, group: Group) -> Array:
        """(n, M, k) of a group."""
        if group.joint is None:
            return self.robot[:, :, group.columns]
        out = np.zeros((len(self.joints), len(self.joints[0]), group.k))
        out[group.joint] = self.joints[group.joint][:, group.columns]
        return out

    @cached_property
    def grams(self) -> tuple[Array, ...]:
        """Of each batch z_j'z_j (G, k, k) of its groups' columns; on several (n, G, k, k)."""
        out = []
        for batch in self.batches:
            count, columns = len(batch.groups), batch.columns.ravel()
            if batch.joint is None:
                out.append(np.stack([grams(Z[:, columns], count) for Z in self.robot]))
            else:
                out.append(grams(self.joints[batch.joint][:, columns], count))
        return tuple(out)

    def whitened(self, noise: Noise, rows: SegmentedRuns) -> Library:
        pieces = [rows.pieces(j) for j in range(rows.n)]
        joints = tuple(noise.whiten(m, j, pieces[j]) for j, m in enumerate(self.joints))
        robot = np.stack([noise.whiten(m, j, pieces[j]) for j, m in enumerate(self.robot)])
        return replace(self, joints=joints, robot=robot)


@dataclass(frozen=True)
class Candidacy:
    """What a library is made of, and the library, made when it is first asked for; keys : of the
    candidates that are to be in it (None: all)."""

    rows: SegmentedRuns
    model: Model
    frozen: bool
    keys: frozenset[Key] | None = None

    @cached_property
    def library(self) -> Library:
        return build_library(self.rows, self.model, self.frozen, self.keys)


def build_library(
    rows: SegmentedRuns, model: Model, frozen: bool, only: Set[Key] | None = None
) -> Library:
    """Columns of every candidate; ``only`` restricts them. Effects that the model already has
    on a joint are left out, unless it is held fixed and they may have changed."""
    robot, n = model.robot, rows.n
    taken = set()
    if not frozen:
        for effect in model.effects:
            if not effect.several:
                joints: Sequence[int | None] = [None] if effect.whole_robot else effect.joints
                taken |= {(effect.name, j) for j in joints}
    start = min(float(s.motion.t[0]) for s in rows.segments)
    warm = all(s.motion.temperature is not None for s in rows.segments)
    own: list[list[tuple[Key, Effect]]] = [[] for _ in range(n)]
    several: list[tuple[Key, Effect]] = []
    for name, kind in effect_types().items():
        if kind.frozen_only and not frozen:
            continue
        for joint in (None,) if kind.whole_robot else range(n):
            key = (name, joint)
            if key in taken or (only is not None and key not in only):
                continue
            if joint is not None and kind.at_rest == ("turns" if rows.holds[joint] else "holds"):
                continue
            spread = several if joint is None or kind.spreads or kind.joins else own[joint]
            spread += [
                (key, effect)
                for effect in kind.candidates(robot, joint, start)
                if (warm or not effect.needs_temperature) and _beyond_turning(rows, effect)
            ]
    groups: list[Group] = []
    matrices = []
    for j in range(n):
        columns = [rows.column(effect, j) for _, effect in own[j]]
        matrices.append(np.hstack([np.zeros((len(rows.t), 0)), *columns]))
        first = 0
        for key, effect in own[j]:
            k = len(effect.parameters)
            groups.append(Group(key, effect, j, slice(first, first + k)))
            first += k
    robot_parts, first = [np.zeros((n, len(rows.t), 0))], 0
    for key, effect in several:
        k = len(effect.parameters)
        groups.append(Group(key, effect, None, slice(first, first + k)))
        first += k
        robot_parts.append(spread_columns(rows, effect))
    robot_columns = np.concatenate(robot_parts, axis=2)
    return Library(tuple(groups), tuple(matrices), robot_columns, _batches(groups))


def _beyond_turning(rows: SegmentedRuns, effect: Effect) -> bool:
    """Whether an effect's velocity lies beyond that over which dry friction turns round in the model."""
    key = effect.beyond_turning
    return not key or effect.shape[key] >= rows.segments[0].motion.width(effect.joints[0])


def grams(columns: Array, count: int) -> Array:
    """(G, k, k) products x'x of ``count`` groups of columns (N, G k) side by side."""
    N, size = columns.shape
    if size == count:
        return np.einsum("nc,nc->c", columns, columns)[:, None, None]
    x = np.ascontiguousarray(columns.reshape(N, count, size // count).transpose(1, 2, 0))
    return np.asarray(x @ x.transpose(0, 2, 1))


def _batches(groups: Sequence[Group]) -> tuple[Batch, ...]:
    places: dict[tuple[int | None, int, bool, str], list[int]] = {}
    for place, g in enumerate(groups):
        alone = "" if g.effect.plausible is None else g.effect.name
        places.setdefault((g.joint, g.k, g.signed, alone), []).append(place)
    return tuple(
        Batch(
            joint,
            signed,
            np.array(p),
            np.array([np.r_[groups[g].columns] for g in p]),
            groups[p[0]].effect.plausible,
        )
        for (joint, _, signed, _), p in places.items()
    )


def spread_columns(rows: SegmentedRuns, effect: Effect) -> Array:
    """(n, M, k) columns of one effect on all joints."""
    out = np.zeros((rows.n, len(rows.t), len(effect.parameters)))
    for block in rows.blocks(effect):
        out[block.joint][:, block.parameters] = block.columns
    return out
