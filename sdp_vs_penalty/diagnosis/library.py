"""The library of a search: candidates in batches, and how many laws each may follow."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model, depends
from sdp_vs_penalty.estimation.constants import TURNS
from sdp_vs_penalty.robot.arrays import Array, Mask

#: Torque of a unit of an effect, in standard deviations of the noise, beyond which it
#: is an instability; its square is still a number.
_UNBOUNDED = 1e100
#: (effect name, joint from 0; None: the whole robot).
Key = tuple[str, int | None]


@dataclass(frozen=True)
class Candidate:
    """A candidate of a search: an effect on a joint or robot, with shape constants."""

    #: Effect name and joint (from 0; None for the whole robot), the same for all values
    #: of the shape constants (such as a Stribeck velocity).
    key: Key
    #: The effect with one value of each constant.
    effect: Effect
    #: Whether the model has the effect already, and the candidate is another value of
    #: its shape constant. Its column replaces the present one; it is reported as a
    #: re-estimated constant and not as a missing effect.
    replaces_own_constant: bool = False

    @cached_property
    def text(self) -> str:
        """The effect as it is written on the command line."""
        return self.effect.text

    @cached_property
    def n_coefficients(self) -> int:
        """The number of linear parameters k of the effect."""
        return len(self.effect.parameters)

    @cached_property
    def n_constants(self) -> int:
        """The number of continuous shape constants, each of which costs evidence.

        Zero if the candidate replaces the value of a constant that the model has: it
        adds no constant. Constants without bounds are discrete, and do not count.
        """
        if self.replaces_own_constant:
            return 0
        return sum(
            self.effect.shapes[x].bounds is not None for x in self.effect.searched
        )

    @cached_property
    def discrete_choice(self) -> tuple[Hashable, ...]:
        """A hashable name of the candidate's law: its key and its discrete constants.

        It is (effect name, joint, values of the discrete constants ...). Two candidates
        of one law differ only in continuous constants, which a search refines. A shape
        constant is discrete if it has no bounds; a constant that follows from the
        effect's size (as a delay's does) is not counted.
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
        """(k,) flags: which parameters must not be negative, such as a friction torque."""
        return [p.lower == 0.0 for p in self.effect.parameters]

    @cached_property
    def plausible(self) -> Array:
        """(k,) prior standard deviations of the parameters about zero, in SI units.

        The effect declares how large they plausibly are on real machines; NaN: it
        declares nothing.
        """
        declared = self.effect.plausible
        return np.full(self.n_coefficients, np.nan) if declared is None else declared

    def refines(self, other: Candidate) -> bool:
        """Return whether this candidate refines another one on the same joint.

        An effect declares which effects it refines: presliding hysteresis, for example,
        refines Coulomb friction, and is a candidate only where that is present.
        """
        return self.key[1] == other.key[1] and other.key[0] in self.effect.refines

    def generalises(self, other: Candidate) -> bool:
        """Return whether another candidate is this one with parameters at zero.

        An effect declares which effects it generalises: a spring that stiffens, for
        example, generalises a linear one. It acts on a common joint, or on the robot.
        """
        is_there = not set(self.effect.joints).isdisjoint(other.effect.joints)
        return is_there and other.key[0] in self.effect.generalises

    def replaces(self, other: Candidate) -> bool:
        """Return whether both are one cause, of which this candidate is the general law.

        A spring on which its link swings, for example, is the spring that yields slowly
        as well. Effects that may come several times on a joint are causes of their own,
        and a constant of the model stays to be judged.
        """
        is_apart = self.effect.several or other.replaces_own_constant
        return self.generalises(other) and not is_apart

    def with_shape(self, **shape: float) -> Candidate:
        """Return the candidate with other values of some shape constants (SI units).

        Example: ``with_shape(vs=0.1)`` for a Stribeck velocity of 0.1 rad/s. Constants
        that are not named stay.
        """
        return replace(self, effect=self.effect.with_shape(**shape))

    def bounds(self, name: str) -> tuple[float, float] | None:
        """Return the range (low, high) in which a shape constant is refined, in SI units.

        It is None if the constant is discrete. For a constant of an effect that the
        model has already, the upper end is at least the widest one that `identify`
        tries: TURNS are velocities in rad/s or m/s over which friction reverses.
        """
        joint = self.effect.robot.joints[self.effect.joints[0]]
        limits = self.effect.shapes[name].on(joint.kind).bounds
        if limits is None or not self.replaces_own_constant:
            return limits
        low, high = limits
        return low, max(high, TURNS[-1])


@dataclass(frozen=True, eq=False)
class Batch:
    """F candidates with k coefficients each that change the torque of the same joints."""

    #: Numbers of the joints, from 0.
    joints: tuple[int, ...]
    #: The F candidates.
    forms: tuple[Candidate, ...]
    #: (n_joints, M, F k) columns of the candidates on the M rows of each joint, in
    #: units of the noise; columns f k to f k + k - 1 belong to candidate f.
    whitened_columns: Array

    @cached_property
    def plausible(self) -> Array:
        """(F, k) prior standard deviations of the parameters about zero (SI units).

        NaN: the effect declares none.
        """
        return np.array([f.plausible for f in self.forms])

    @cached_property
    def nonnegative(self) -> Mask:
        """(F, k) flags: which coefficients must not be negative."""
        return np.array([f.nonnegative for f in self.forms], bool)

    @cached_property
    def grams(self) -> Array:
        """(n_joints, F, k, k) products Z'Z of each candidate's white columns Z (M, k)."""
        k = self.forms[0].n_coefficients
        n_joints, M, _ = self.whitened_columns.shape
        columns = self.whitened_columns.reshape(n_joints, M, len(self.forms), k)
        transposed = columns.transpose(0, 2, 3, 1)  # (n_joints, F, k, M)
        return transposed @ transposed.transpose(0, 1, 3, 2)

    @classmethod
    def from_columns(
        cls,
        joints: tuple[int, ...],
        forms: tuple[Candidate, ...],
        white: Sequence[dict[int, Array]],
    ) -> Batch:
        """Stack F candidates into a batch.

        Parameters
        ----------
        joints
            The joints (from 0) whose torque all of them change.
        forms
            The F candidates, with k coefficients each.
        white
            For each candidate its white columns, (M, k) by joint.
        """
        columns_by_joint = [np.hstack([z[j] for z in white]) for j in joints]
        return cls(joints, forms, np.stack(columns_by_joint))

    def with_columns_on(self, data: WhiteData) -> Batch:
        """Compute the same candidates' columns on other white rows; return that batch."""
        white = [white_candidate(data, f) for f in self.forms]
        return Batch.from_columns(self.joints, self.forms, white)

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
    """All candidates of a search, in batches."""

    #: The candidates in batches.
    batches: tuple[Batch, ...] = ()
    #: Number of laws of each candidate, by its key (effect name, joint). Laws are an
    #: effect's discrete variants (exponents of Stribeck friction, for example); values
    #: of continuous constants do not count. A choice among more laws costs more
    #: evidence.
    laws: Mapping[Key, int] = field(default_factory=dict)

    def with_current_columns(self, data: WhiteData, before: WhiteData) -> Library:
        """Recompute on ``data`` the columns that depend on the current model.

        These are columns of effects that need the model's torque or links (a gain, load
        friction), and those with the sign of a velocity that turns round over another
        width than ``before``. All other columns follow from the motion alone and stay. A
        batch is recomputed whole.
        """
        both = (x.estimate.model.sign_width for x in (data, before))
        turned = {
            j for j, (now, was) in enumerate(zip(*both, strict=True)) if now != was
        }

        def follows(effect: Effect) -> bool:
            """Return whether an effect's columns have changed with the model."""
            has_turned = not (effect.signless or turned.isdisjoint(effect.joints))
            return has_turned or depends(effect)

        batches = [
            b.with_columns_on(data) if any(follows(f.effect) for f in b.forms) else b
            for b in self.batches
        ]
        return replace(self, batches=tuple(batches))

    def only(self, which: Callable[[Candidate], bool], data: WhiteData) -> Library:
        """Return a library with only the candidates for which ``which`` is true.

        All their columns are computed anew on ``data``.
        """
        parts = [(b, tuple(filter(which, b.forms))) for b in self.batches]
        batches = [
            replace(b, forms=forms).with_columns_on(data) for b, forms in parts if forms
        ]
        return replace(self, batches=tuple(batches))


def white_candidate(data: WhiteData, form: Candidate) -> dict[int, Array]:
    """Compute a candidate's white columns, (M, k) by joint (from 0) that it acts on.

    White columns are filtered and weighted so that the noise has variance 1. Columns
    that grow without bound are set to zero, which no search names: an effect of a
    plug-in that integrates an unstable equation makes such columns.
    """
    # The filtered columns are not cached (keep): a library has thousands.
    blocks = data.rows.blocks(form.effect, keep=False)
    out = {}
    for block in blocks:
        white = data.white(block.columns, block.joint)
        if not np.abs(white).max(initial=0.0) < _UNBOUNDED:  # also refuses NaN
            white = np.zeros_like(white)
        out[block.joint] = white
    return out


def may_join(
    forms: Sequence[Candidate], picked: Sequence[Candidate], model: Model
) -> list[bool]:
    """Return a flag for each candidate of ``forms``: whether it may join the others.

    The others are those ``picked`` and the effects of the model. An effect is added to
    a joint once, unless its class allows several. An effect that refines a simpler one
    (presliding friction refines Coulomb friction) needs that on the same joint. One
    that a picked effect holds as a special case (:meth:`Candidate.replaces`) is the
    same cause told again.
    """
    taken = {p.key for p in picked if not p.effect.several}
    keys_of_model = {(e.name, j) for e in model.effects for j in e.joints}
    present = {p.key for p in picked} | keys_of_model

    def is_allowed(form: Candidate) -> bool:
        """Return whether a candidate is not present yet and has what it refines."""
        if form.key in taken or any(p.replaces(form) for p in picked):
            return False
        joint = form.key[1]
        refined_keys = [(name, joint) for name in form.effect.refines]
        return not refined_keys or any(key in present for key in refined_keys)

    # Many candidates differ in shape constants only.
    laws = {(form.key, form.effect.refines): form for form in forms}
    allowed = {law: is_allowed(form) for law, form in laws.items()}
    return [allowed[form.key, form.effect.refines] for form in forms]


@dataclass(frozen=True, eq=False)
class Nuisance:
    """A small error that a fit tolerates, such as that of an inexact friction law.

    Its coefficients have a prior, so that it can explain a little torque only.
    """

    #: Name that identifies the error.
    text: str
    #: (M, k) white columns, by the joint (from 0) that the error acts on.
    columns: dict[int, Array]
    #: (k,) prior standard deviations of the coefficients about zero.
    deviations: Array
