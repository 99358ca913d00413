"""The library: every effect on every joint or on the robot; a form has one set of shape
constants."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.whitening import WhiteData
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import STANDS, Effect
from sdp_vs_penalty.effects.model import Model, depends
from sdp_vs_penalty.estimation.constants import TURNS
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.segments import SegmentedRuns

#: Steps of the lattice on which shape constants are refined, in those of the grid that
#: they begin with.
STEPS = 0.5, 0.25, 0.125

#: (effect name, joint from 0; None: the whole robot).
Key = tuple[str, int | None]


@dataclass(frozen=True)
class Candidate:
    """A candidate with one set of shape constants; replaces_own_constant : another constant of the
    model's own effect, which stands in its place and is a nuisance, no finding."""

    key: Key
    effect: Effect
    replaces_own_constant: bool = False

    @cached_property
    def n_coefficients(self) -> int:
        return len(self.effect.parameters)

    @cached_property
    def constants(self) -> int:
        """Continuous shape constants; none of the model's own effect, whose size is no
        new one."""
        if self.replaces_own_constant:
            return 0
        return sum(
            self.effect.shapes[x].bounds is not None for x in self.effect.searched
        )

    @cached_property
    def discrete_choice(self) -> tuple[Hashable, ...]:
        """Its candidate, and the constants that are choices among which nothing is
        refined."""
        e = self.effect
        chosen = (
            x for x, s in e.shapes.items() if s.bounds is None and x != e.sized_shape
        )
        return (*self.key, *(e.shape[x] for x in chosen))

    @cached_property
    def nonnegative(self) -> list[bool]:
        """(k,) which parameters may not be negative."""
        return [p.lower == 0.0 for p in self.effect.parameters]

    @cached_property
    def plausible(self) -> Array:
        """(k,) standard deviations of its parameters that its effect says, NaN where it
        says none."""
        known = self.effect.plausible
        return np.full(self.n_coefficients, np.nan) if known is None else known

    def refines(self, other: Candidate) -> bool:
        """Whether its effect says that it is a finer form of the other's, on the same
        joint."""
        return self.key[1] == other.key[1] and other.key[0] in self.effect.refines

    def with_shape(self, **shape: float) -> Candidate:
        return replace(self, effect=self.effect.with_shape(**shape))

    def bounds(self, name: str) -> tuple[float, float] | None:
        """Within which a shape constant is looked for; wider for the model's own."""
        limits = (
            self.effect.shapes[name]
            .on(self.effect.robot.joints[self.effect.joints[0]].kind)
            .bounds
        )
        return (
            (limits[0], max(limits[1], TURNS[-1]))
            if self.replaces_own_constant and limits
            else limits
        )


@dataclass(frozen=True, eq=False)
class Batch:
    """Forms with k columns each that change the torque of the same joints: white
    (len(joints), M, F k)."""

    joints: tuple[int, ...]
    forms: tuple[Candidate, ...]
    whitened_columns: Array

    @cached_property
    def signed(self) -> NDArray[np.bool_]:
        """(F,) whether the first parameter may not be negative."""
        return np.array([f.nonnegative[0] for f in self.forms])

    @cached_property
    def plausible(self) -> Array:
        """(F, k)."""
        return np.array([f.plausible for f in self.forms])

    @cached_property
    def grams(self) -> Array:
        """(len(joints), F, k, k) products of each form's columns."""
        k = self.forms[0].n_coefficients
        parts = self.whitened_columns.reshape(
            *self.whitened_columns.shape[:2], len(self.forms), k
        ).transpose(0, 2, 3, 1)
        return np.asarray(parts @ parts.transpose(0, 1, 3, 2))

    @classmethod
    def of(
        cls,
        joints: tuple[int, ...],
        forms: tuple[Candidate, ...],
        white: Sequence[dict[int, Array]],
    ) -> Batch:
        """whitened_columns : of each form, (M, k) by joint."""
        return cls(
            joints, forms, np.stack([np.hstack([z[j] for z in white]) for j in joints])
        )

    def columns(self, f: int) -> dict[int, Array]:
        """(M, k) by joint, of one form."""
        k = self.forms[f].n_coefficients
        return {
            j: self.whitened_columns[a][:, f * k : f * k + k]
            for a, j in enumerate(self.joints)
        }


@dataclass(frozen=True)
class Library:
    """laws : of each candidate how many there are, whatever their constants."""

    batches: tuple[Batch, ...] = ()
    laws: Mapping[Key, int] = field(default_factory=dict)

    def with_current_columns(self, data: WhiteData) -> Library:
        """The same where what refers to the model's torque and links is of another one."""

        def made(b: Batch) -> Batch:
            if not depends(b.forms[0].effect):
                return b
            return Batch.of(b.joints, b.forms, [_white(data, f) for f in b.forms])

        return replace(self, batches=tuple(map(made, self.batches)))


def list_candidates(data: WhiteData) -> Library:
    """All candidates beside the model; their columns white."""
    groups: dict[
        tuple[tuple[int, ...], Hashable], list[tuple[Candidate, dict[int, Array]]]
    ] = {}
    for form in (
        *_forms(data.rows, data.estimate.model, data.frozen),
        *_own_forms(data),
    ):
        if white := _white(data, form):
            group_key = (
                form.n_coefficients,
                depends(form.effect),
                form.key if form.replaces_own_constant else None,
            )
            groups.setdefault((tuple(sorted(white)), group_key), []).append(
                (form, white)
            )
    batches = tuple(
        Batch.of(joints, *zip(*group, strict=True))
        for (joints, _), group in groups.items()
    )
    laws = {f.discrete_choice: f for b in batches for f in b.forms}
    return Library(batches, Counter(f.key for f in laws.values()))


def _white(data: WhiteData, form: Candidate) -> dict[int, Array]:
    """(M, k) white columns by joint, kept for nobody."""
    blocks = data.rows.blocks(form.effect, keep=False)
    return {b.joint: data.white(b.columns, b.joint) for b in blocks}


def _forms(rows: SegmentedRuns, model: Model, frozen: bool) -> Iterator[Candidate]:
    """Every effect of the library. What the model already has on a joint is left out,
    unless it is held fixed and may have changed."""
    taken = set[Key]()
    if not frozen:
        for effect in model.effects:
            if not effect.several:
                where: Sequence[int | None] = (
                    [None] if effect.whole_robot else effect.joints
                )
                taken |= {(effect.name, j) for j in where}
    start = min(float(s.motion.t[0]) for s in rows.segments)
    warm = all(s.motion.temperature is not None for s in rows.segments)
    motors = all(s.motion.motors is not None for s in rows.segments)
    coverage = [rows.seen(joint) for joint in range(rows.n)]
    stands = np.mean(rows.still > 0.5, axis=0) > STANDS

    def tells(effect: Effect) -> bool:
        """Whether what it needs was measured, and nothing else passes for it, whatever
        its size."""
        measured = warm or not effect.needs_temperature
        return measured and not effect.looks_like(0.0, coverage[effect.joints[0]])

    for name, kind in effect_types().items():
        if (kind.frozen_only and not frozen) or (kind.needs_motors and not motors):
            continue
        for joint in (None,) if kind.whole_robot else range(rows.n):
            key = (name, joint)
            if key not in taken and (kind.at_rest != "holds" or stands[joint]):
                effects_to_try = kind.candidates(model.robot, joint, start)
                yield from (Candidate(key, e) for e in effects_to_try if tells(e))


def _own_forms(data: WhiteData) -> Iterator[Candidate]:
    """The model's own effects with other values of the shape constants that are
    estimated."""
    joints = data.estimate.robot.joints
    for key, (effect, _) in data.own_effects.items():
        for name in effect.estimated:
            now = effect.shape[name]
            grid = list(effect.shapes[name].on(joints[key[1]].kind).grid)
            high = max(grid[-1], TURNS[-1])
            while 2.0 * grid[-1] < high:
                grid.append(2.0 * grid[-1])
            # The grid alone did not find a width of 0.058 beside one of 0.032 rad/s.
            ratio = min(b / a for a, b in pairwise(grid))
            near = (float(f"{now * ratio**step:.6g}") for step in (-STEPS[1], STEPS[1]))
            values = sorted(
                {high, *grid, *(x for x in near if grid[0] < x < high)} - {now}
            )
            yield from (
                Candidate(
                    key,
                    effect.with_shape([key[1]], **{name: x}),
                    replaces_own_constant=True,
                )
                for x in values
            )


def may_join(
    forms: Sequence[Candidate], picked: Sequence[Candidate], model: Model
) -> list[bool]:
    """Which forms may join: nothing twice, a finer form only where what it refines is
    there."""
    taken = {p.key for p in picked if not p.effect.several}
    present = {p.key for p in picked} | {
        (e.name, j) for e in model.effects for j in e.joints
    }
    return [
        f.key not in taken
        and (
            not f.effect.refines
            or any((name, f.key[1]) in present for name in f.effect.refines)
        )
        for f in forms
    ]
