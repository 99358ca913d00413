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
    """One candidate: an effect on a joint or on the robot, with one set of shape
    constants.

    key : effect name and joint (from 0; None for the whole robot), the same for all
    shape constants. replaces_own_constant : the effect is one that the model has
    already, with another value of its constant, and stands in that one's place; it
    explains torque, but is reported as a re-estimated constant and not as a missing
    effect.
    """

    key: Key
    effect: Effect
    replaces_own_constant: bool = False

    @cached_property
    def n_coefficients(self) -> int:
        """The number of linear parameters k of the effect."""
        return len(self.effect.parameters)

    @cached_property
    def n_constants(self) -> int:
        """The number of continuous shape constants, each of which costs evidence.

        Zero for another value of the model's own constant: it adds no constant to the
        model.
        """
        if self.replaces_own_constant:
            return 0
        return sum(
            self.effect.shapes[x].bounds is not None for x in self.effect.searched
        )

    @cached_property
    def discrete_choice(self) -> tuple[Hashable, ...]:
        """The candidate's key with its discrete choices, such as a law; hashable.

        Two candidates with equal values differ only in continuous constants, which a
        search refines. A shape constant is discrete if it has no bounds; one that
        follows the effect's size (a delay's) is none.
        """
        effect = self.effect
        discrete_values = [
            effect.shape[name]
            for name, constant in effect.shapes.items()
            if constant.bounds is None and name != effect.sized_shape
        ]
        return (*self.key, *discrete_values)

    @cached_property
    def nonnegative(self) -> list[bool]:
        """(k,) flags: which parameters have a lower bound of zero, such as a friction's
        size.
        """
        return [p.lower == 0.0 for p in self.effect.parameters]

    @cached_property
    def plausible(self) -> Array:
        """(k,) standard deviations of the parameters about zero on machines as they are
        built.

        They are in each parameter's SI unit, as the effect declares them; NaN where it
        declares none.
        """
        known = self.effect.plausible
        return np.full(self.n_coefficients, np.nan) if known is None else known

    def refines(self, other: Candidate) -> bool:
        """Return whether this candidate's effect refines the other's, on the same
        joint.

        Presliding hysteresis refines Coulomb friction, for example: it is looked for
        only where Coulomb friction is present.
        """
        return self.key[1] == other.key[1] and other.key[0] in self.effect.refines

    def with_shape(self, **shape: float) -> Candidate:
        """Return the same candidate with some shape constants (SI units) set to other
        values.
        """
        return replace(self, effect=self.effect.with_shape(**shape))

    def bounds(self, name: str) -> tuple[float, float] | None:
        """Return the range (low, high) in which a shape constant is refined, in its SI
        unit.

        None where the constant is not refined. For a constant of the model's own effect
        the range reaches at least up to the widest value that `identify` tries (TURNS).
        """
        joint = self.effect.robot.joints[self.effect.joints[0]]
        limits = self.effect.shapes[name].on(joint.kind).bounds
        if limits is None or not self.replaces_own_constant:
            return limits
        low, high = limits
        return low, max(high, TURNS[-1])


@dataclass(frozen=True, eq=False)
class Batch:
    """F candidates with k coefficients each that change the torque of the same joints.

    whitened_columns (n_joints, M, F k) : their columns on the M rows of each of
    ``joints`` (from 0), in units of the noise; columns f k to f k + k - 1 belong to
    candidate f.
    """

    joints: tuple[int, ...]
    forms: tuple[Candidate, ...]
    whitened_columns: Array

    @cached_property
    def signed(self) -> NDArray[np.bool_]:
        """(F,) flags: whether a candidate's first parameter has a lower bound of zero."""
        return np.array([f.nonnegative[0] for f in self.forms])

    @cached_property
    def plausible(self) -> Array:
        """(F, k) standard deviations of the parameters about zero; NaN where none is
        known.
        """
        return np.array([f.plausible for f in self.forms])

    @cached_property
    def grams(self) -> Array:
        """(n_joints, F, k, k) products Z'Z of each candidate's white columns Z (M, k)."""
        k = self.forms[0].n_coefficients
        n_joints, M, _ = self.whitened_columns.shape
        columns = self.whitened_columns.reshape(n_joints, M, len(self.forms), k)
        transposed = columns.transpose(0, 2, 3, 1)  # (n_joints, F, k, M)
        return np.asarray(transposed @ transposed.transpose(0, 1, 3, 2))

    @classmethod
    def of(
        cls,
        joints: tuple[int, ...],
        forms: tuple[Candidate, ...],
        white: Sequence[dict[int, Array]],
    ) -> Batch:
        """Stack candidates into a batch; ``white`` has the (M, k) columns by joint of
        each.
        """
        return cls(
            joints,
            forms,
            np.stack([np.hstack([z[j] for z in white]) for j in joints]),
        )

    def with_columns_on(self, data: WhiteData) -> Batch:
        """Return a batch of the same candidates, with their columns on other white
        rows.
        """
        white = [white_candidate(data, f) for f in self.forms]
        return Batch.of(self.joints, self.forms, white)

    def columns(self, f: int) -> dict[int, Array]:
        """Return the white columns of candidate f, (M, k) by joint (from 0)."""
        k = self.forms[f].n_coefficients
        its_columns = slice(f * k, f * k + k)
        return {
            joint: self.whitened_columns[place][:, its_columns]
            for place, joint in enumerate(self.joints)
        }


@dataclass(frozen=True)
class Library:
    """All candidates of a search, in batches.

    laws : by candidate key the number of its discrete laws, whatever their continuous
    constants; a choice among more laws costs more evidence.
    """

    batches: tuple[Batch, ...] = ()
    laws: Mapping[Key, int] = field(default_factory=dict)

    def with_current_columns(self, data: WhiteData) -> Library:
        """Recompute the columns that depend on the current model, for other data.

        These are columns of effects that need the model's torque or links (a gain, load
        friction); all other columns follow from the motion and stay.
        """
        batches = [
            b.with_columns_on(data) if depends(b.forms[0].effect) else b
            for b in self.batches
        ]
        return replace(self, batches=tuple(batches))

    def only(
        self,
        which: Callable[[Candidate], bool],
        data: WhiteData,
    ) -> Library:
        """Return a library with only the candidates for which ``which`` is true.

        All their columns are computed anew on ``data``.
        """
        parts = [(b, tuple(filter(which, b.forms))) for b in self.batches]
        batches = [
            replace(b, forms=forms).with_columns_on(data) for b, forms in parts if forms
        ]
        return replace(self, batches=tuple(batches))


def white_candidate(data: WhiteData, form: Candidate) -> dict[int, Array]:
    """Compute a candidate's white columns, (M, k) by joint whose torque it changes.

    ``keep=False``: the filtered columns are not cached, since a library has thousands.
    """
    blocks = data.rows.blocks(form.effect, keep=False)
    return {b.joint: data.white(b.columns, b.joint) for b in blocks}


def may_join(
    forms: Sequence[Candidate],
    picked: Sequence[Candidate],
    model: Model,
) -> list[bool]:
    """Return, for each candidate of ``forms``, whether it may be added to those
    ``picked``.

    An effect is added once to a joint, unless it may come several times. An effect that
    refines another one is allowed only where the plainer one is present, among those
    picked or in the model.
    """
    taken = {p.key for p in picked if not p.effect.several}
    of_model = {(e.name, j) for e in model.effects for j in e.joints}
    present = {p.key for p in picked} | of_model

    def is_allowed(form: Candidate) -> bool:
        if form.key in taken:
            return False
        joint = form.key[1]
        plainer = [(name, joint) for name in form.effect.refines]
        return not plainer or any(key in present for key in plainer)

    return [is_allowed(f) for f in forms]


@dataclass(frozen=True, eq=False)
class Nuisance:
    """A small error that is tolerated beside the effects, such as an inexact friction
    law.

    columns : white, (M, k) by joint (from 0); deviations (k,) : standard deviations
    about zero that are expected of the coefficients; text : its name, which identifies
    it.
    """

    text: str
    columns: dict[int, Array]
    deviations: Array
