"""All effects the model might miss, as columns on the diagnosis's rows.

A group is one effect on one joint (or on the whole robot) with one set of shape constants. Groups of
the same effect and joint with different constants form a candidate: what the diagnosis names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import Block, Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.autoregression import Pieces, innovations
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

    @cached_property
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
    """groups, and their filtered columns: of each joint ``parts[j]`` (M, C_j + C), first those of the
    ``own[j]`` = C_j columns of groups on it alone, then those of groups on several; batches : the
    groups, those alike together. Of a weighted one level (n,) : what the columns of each joint are still
    to be divided by, undivided : the same without; of a filtered one plain : without, bent : the joints
    that are filtered."""

    groups: tuple[Group, ...]
    parts: tuple[Array, ...]
    own: tuple[int, ...]
    batches: tuple[Batch, ...]
    level: tuple[float, ...] = ()
    undivided: Library | None = None
    plain: Library | None = None
    bent: frozenset[int] = frozenset()
    _coloured: dict[bytes, ref[Library]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @cached_property
    def joints(self) -> tuple[Array, ...]:
        """(M, C_j) of the groups on one joint."""
        return tuple(Z[:, :k] for Z, k in zip(self.parts, self.own, strict=True))

    @cached_property
    def robot(self) -> tuple[Array, ...]:
        """n times (M, C), of the groups on several."""
        return tuple(Z[:, k:] for Z, k in zip(self.parts, self.own, strict=True))

    @property
    def divisors(self) -> tuple[float, ...]:
        """(n,) what the columns of each joint are to be divided by."""
        return self.level or (1.0,) * len(self.own)

    @property
    def size(self) -> int:
        """How many columns there are to choose from."""
        return sum(self.own) + self.robot[0].shape[1]

    def columns(self, group: Group) -> Array:
        """(n, M, k) of a group."""
        if group.joint is None:
            parts = zip(self.robot, self.divisors, strict=True)
            return np.stack([Z[:, group.columns] / divisor for Z, divisor in parts])
        out = np.zeros((len(self.parts), len(self.parts[0]), group.k))
        out[group.joint] = self.joints[group.joint][:, group.columns] / self.divisors[group.joint]
        return out

    @cached_property
    def grams(self) -> tuple[Array, ...]:
        """Of each batch z_j'z_j (G, k, k) of its groups' columns; on several (n, G, k, k)."""
        if self.undivided is not None:
            share = np.array(self.level) ** -2.0
            each = zip(self.batches, self.undivided.grams, strict=True)
            return tuple(
                gram * (share[:, None, None, None] if b.joint is None else share[b.joint])
                for b, gram in each
            )
        plain = () if self.plain is None else self.plain.grams
        out = []
        for place, batch in enumerate(self.batches):
            j, columns = batch.joint, batch.columns
            if j is None:
                found = [
                    plain[place][k] if plain and k not in self.bent else self._gram(k, own, columns)
                    for k, own in enumerate(self.own)
                ]
                out.append(np.stack(found))
            elif plain and j not in self.bent:
                out.append(plain[place])
            else:
                out.append(self._gram(j, 0, columns))
        return tuple(out)

    def _gram(self, joint: int, first: int, columns: NDArray[np.intp]) -> Array:
        """(G, k, k) products of groups of a joint's columns (G, k), counted from the ``first`` one."""
        if columns.shape[1] == 1:
            return self._squares[joint][first + columns][:, :, None]
        return grams(self.parts[joint][:, first + columns.ravel()], len(columns))

    @cached_property
    def _squares(self) -> dict[int, Array]:
        """(C_j + C,) squared norms of the columns of the joints that are not ``plain``."""
        every = enumerate(self.parts)
        return {j: np.einsum("nc,nc->c", Z, Z) for j, Z in every if self.plain is None or j in self.bent}

    def divided(self, level: Array) -> Library:
        """The same with the columns of each joint divided by its level (n,)."""
        return replace(self, level=tuple(level.tolist()), undivided=self)

    def coloured(self, colour: Array, pieces: Sequence[Pieces]) -> Library:
        """The same behind the joints' filters, ``colour`` (n, order); as long as anyone has it."""
        bent = np.flatnonzero(colour.any(axis=1)).tolist()
        if not bent:
            return self
        known = self._coloured.get(colour.tobytes(), lambda: None)()
        if known is None:
            parts = list(self.parts)
            for j in bent:
                parts[j] = innovations(parts[j], colour[j], pieces[j])
            known = replace(self, parts=tuple(parts), plain=self, bent=frozenset(bent))
            self._coloured.clear()
            self._coloured[colour.tobytes()] = ref(known)
        return known


@dataclass(frozen=True)
class Candidacy:
    """What a library is made of, and its columns, worked out when they are first asked for; keys : of
    the candidates that are to be in it (None: all)."""

    rows: SegmentedRuns
    model: Model
    frozen: bool
    keys: Set[Key] | None = None

    def white(self, noise: Noise, rows: SegmentedRuns) -> Library:
        """The library's columns, white by a ``noise`` of these rows."""
        return self._library(lambda Z, j: noise.whiten(Z, j, rows.pieces(j)))

    @property
    def library(self) -> Library:
        """The library's columns as they are."""
        return self._library(lambda Z, _: Z)

    @cached_property
    def by_key(self) -> dict[Key, list[int]]:
        """The groups of each candidate."""
        found: dict[Key, list[int]] = {}
        for g, group in enumerate(self._columns[0]):
            found.setdefault(group.key, []).append(g)
        return found

    @cached_property
    def acting(self) -> dict[Key, frozenset[int]]:
        """The joints on which each candidate acts."""
        joints = {key: self._columns[0][g[0]].joint for key, g in self.by_key.items()}
        every = frozenset(range(self.rows.n))
        return {key: every if j is None else frozenset([j]) for key, j in joints.items()}

    @cached_property
    def written(self) -> dict[str, list[int]]:
        """The groups of each effect, as it is written."""
        found: dict[str, list[int]] = {}
        for g, group in enumerate(self._columns[0]):
            found.setdefault(group.effect.text, []).append(g)
        return found

    @cached_property
    def bounded(self) -> list[NDArray[np.bool_]]:
        """Which parameters of each batch's groups (G, k) may not be negative."""
        groups, _, batches, _ = self._columns
        lower = [[p.lower == 0.0 for p in g.effect.parameters] for g in groups]
        return [np.array([lower[g] for g in b.groups]) for b in batches]

    def _library(self, made: Callable[[Array, int], Array]) -> Library:
        """One joint's columns after the other, so that none are there twice."""
        groups, own, batches, columns = self._columns
        none = np.zeros((len(self.rows.t), 0))
        parts = tuple(made(np.hstack([none, *few]), j) for j, few in enumerate(columns))
        return Library(groups, parts, own, batches)

    @cached_property
    def _columns(
        self,
    ) -> tuple[tuple[Group, ...], tuple[int, ...], tuple[Batch, ...], list[list[Array]]]:
        """Groups, how many columns are of those on each joint alone, batches, each joint's columns."""
        n, M = self.rows.n, len(self.rows.t)
        parts = _listed(self.rows, self.model, self.frozen, self.keys)
        made = iter(self.rows.blocks_of([effect for part in parts for _, effect in part]))
        groups, own = list[Group](), list[int]()
        columns: list[list[Array]] = [[] for _ in range(n)]
        for place, part in enumerate(parts):
            first = 0
            for key, effect in part:
                k, blocks = len(effect.parameters), {b.joint: b for b in next(made)}
                joint = place if place < n else None
                groups.append(Group(key, effect, joint, slice(first, first + k)))
                for j in range(n) if joint is None else (joint,):
                    columns[j].append(_filled(blocks.get(j), k, M))
                first += k
            own.append(first)
        return tuple(groups), tuple(own[:n]), _batches(groups), columns


def _filled(block: Block | None, k: int, M: int) -> Array:
    """(M, k) columns of all parameters of an effect, zero where it has none."""
    if block is None:
        return np.broadcast_to(0.0, (M, k))
    if block.columns.shape[1] == k and (k == 1 or np.all(np.diff(block.parameters) > 0)):
        return block.columns
    out = np.zeros((M, k))
    out[:, block.parameters] = block.columns
    return out


def _listed(
    rows: SegmentedRuns, model: Model, frozen: bool, keys: Set[Key] | None
) -> list[list[tuple[Key, Effect]]]:
    """Every candidate, those on one joint by joint, then those on several. Effects that the model
    already has on a joint are left out, unless it is held fixed and they may have changed."""
    robot, n = model.robot, rows.n
    taken = set()
    if not frozen:
        for effect in model.effects:
            if not effect.several:
                joints: Sequence[int | None] = [None] if effect.whole_robot else effect.joints
                taken |= {(effect.name, j) for j in joints}
    own: list[list[tuple[Key, Effect]]] = [[] for _ in range(n)]
    several: list[tuple[Key, Effect]] = []
    for name, kind in effect_types().items():
        if kind.frozen_only and not frozen:
            continue
        for joint in (None,) if kind.whole_robot else range(n):
            key = (name, joint)
            if key in taken or (keys is not None and key not in keys):
                continue
            if joint is not None and kind.at_rest == ("turns" if rows.holds[joint] else "holds"):
                continue
            spread = several if joint is None or kind.spreads or kind.joins else own[joint]
            spread += [
                (key, effect)
                for effect in _forms(rows, robot, kind, joint)
                if effect.shape.get(effect.beyond_turning, np.inf) >= turning(rows, effect)
            ]
    return [*own, several]


def _forms(rows: SegmentedRuns, robot: Robot, kind: type[Effect], joint: int | None) -> list[Effect]:
    """An effect on one joint with all shape constants that a search begins with; kept."""
    key = "forms", kind, joint, id(robot)
    if key not in rows.derived:
        start = min(float(s.motion.t[0]) for s in rows.segments)
        warm = all(s.motion.temperature is not None for s in rows.segments)
        forms = kind.candidates(robot, joint, start)
        rows.derived[key] = robot, [e for e in forms if warm or not e.needs_temperature]
    found: list[Effect] = rows.derived[key][1]
    return found


def turning(rows: SegmentedRuns, effect: Effect) -> float:
    """The velocity over which dry friction turns round on an effect's joint, in the model."""
    return rows.segments[0].motion.width(effect.joints[0])


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
            np.array([groups[g].columns.start for g in p])[:, None] + np.arange(k),
            groups[p[0]].effect.plausible,
        )
        for (joint, k, signed, _), p in places.items()
    )


def spread_columns(rows: SegmentedRuns, effect: Effect) -> Array:
    """(n, M, k) columns of one effect on all joints."""
    out = np.zeros((rows.n, len(rows.t), len(effect.parameters)))
    for block in rows.blocks(effect):
        out[block.joint][:, block.parameters] = block.columns
    return out
