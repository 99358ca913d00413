"""The library of a search: candidates in batches, and how many laws each may follow."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model, depends
from sdp_vs_penalty.estimation.constants import TURNS
from sdp_vs_penalty.robot.arrays import Array

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
            *self.whitened_columns.shape[:2],
            len(self.forms),
            k,
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
            joints,
            forms,
            np.stack([np.hstack([z[j] for z in white]) for j in joints]),
        )

    def made_anew(self, data: WhiteData) -> Batch:
        """The same candidates with columns of other data."""
        white = [white_candidate(data, f) for f in self.forms]
        return Batch.of(self.joints, self.forms, white)

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
        batches = [
            b.made_anew(data) if depends(b.forms[0].effect) else b for b in self.batches
        ]
        return replace(self, batches=tuple(batches))

    def only(
        self,
        which: Callable[[Candidate], bool],
        data: WhiteData,
    ) -> Library:
        """Some of the candidates, their columns of other data."""
        parts = [(b, tuple(filter(which, b.forms))) for b in self.batches]
        batches = [
            replace(b, forms=forms).made_anew(data) for b, forms in parts if forms
        ]
        return replace(self, batches=tuple(batches))


def white_candidate(data: WhiteData, form: Candidate) -> dict[int, Array]:
    """(M, k) white columns by joint, kept for nobody."""
    blocks = data.rows.blocks(form.effect, keep=False)
    return {b.joint: data.white(b.columns, b.joint) for b in blocks}


def may_join(
    forms: Sequence[Candidate],
    picked: Sequence[Candidate],
    model: Model,
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


@dataclass(frozen=True, eq=False)
class Nuisance:
    """White columns (M, k) by joint, and the deviations (k,) of their coefficients
    about zero."""

    text: str
    columns: dict[int, Array]
    deviations: Array
