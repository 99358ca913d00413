"""A robot model: a robot and the list of effects that make its joint torques."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.effect import (
    SIGN_WIDTH,
    Block,
    CurrentModel,
    Effect,
    Motion,
    Parameter,
)
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot

#: Instants whose torque is worked out at a time: columns are many times as large as it.
_PART = 1 << 13


@dataclass(frozen=True)
class JointColumns:
    """The torque on one joint: columns (N, k) and the indices (k,) into theta that they
    meet."""

    indices: NDArray[np.intp]
    columns: Array

    def dense_columns(self, p: int) -> Array:
        """Spread the columns over all parameters.

        Parameters
        ----------
        p
            Number of parameters of the model.

        Returns
        -------
        Array
            (N, p) columns, zero where a parameter does not act on the joint.
        """
        out = np.zeros((len(self.columns), p))
        out[:, self.indices] = self.columns
        return out


@dataclass(frozen=True)
class Model:
    """tau = sum over effects of Y_e theta_e; theta concatenates the effects'
    parameters.

    reference : (p,) the current model that effects refer to whose columns depend on the links
        (elasticity) or on the torque of all that needs none (a gain): only entries of
        what needs no torque are read. None where no effect needs it.
    gains : (n,) what each torque channel reads over the true torque, where that is known: parameters
        are then in true units, and the modelled torque is the channels'. None: they read true.
    allow_duplicates : effects may come a second time, as what has changed since their
        first was identified.
    known : parameters that are given, by name: their torque is taken off what is explained, their
        columns are zero there.
    """

    robot: Robot
    effects: tuple[Effect, ...]
    reference: Array | None = None
    gains: tuple[float, ...] | None = None
    allow_duplicates: bool = False
    known: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names_so_far: set[str] = set()
        for p in () if self.allow_duplicates else self.parameters:
            if p.name in names_so_far:
                raise InputError(
                    f"parameter {p.name} appears twice",
                    f"list effect {p.effect} only once per joint",
                )
            names_so_far.add(p.name)
        if not self.parameters:
            raise InputError(
                "The model has no effect", "name at least one, such as rigid_body"
            )

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """(p,) the parameters of all effects, in the order of theta."""
        return tuple(p for effect in self.effects for p in effect.parameters)

    @property
    def needs_reference(self) -> bool:
        """Whether some effect's columns depend on a current model."""
        return any(depends(effect) for effect in self.effects)

    @cached_property
    def reference_free(self) -> Model:
        """The same model without the effects that depend on a current model."""
        free = tuple(e for e in self.effects if not depends(e))
        return Model(
            self.robot,
            free,
            gains=self.gains,
            known=self.known,
        )

    @cached_property
    def before_channels(self) -> Model:
        """The same model without the effects that its torque passes."""
        before = tuple(e for e in self.effects if not e.needs_torque)
        if len(before) == len(self.effects):
            return self
        part = Model(
            self.robot,
            before,
            gains=self.gains,
            known=self.known,
        )
        known = self.reference
        return (
            part if known is None else replace(part, reference=known[self.places(part)])
        )

    def places(self, part: Model) -> NDArray[np.intp]:
        """Find the parameters of a part of this model in theta.

        Parameters
        ----------
        part
            A model of some of the same effects.

        Returns
        -------
        NDArray
            Indices into theta, in the order of the part.
        """
        return np.concatenate(
            [
                np.arange(0),
                *(k for e, k in self.parts if e in part.effects),
            ]
        )

    @cached_property
    def without_drives(self) -> Model:
        """The same model without the drives' laws."""
        return replace(
            self, effects=tuple(e for e in self.effects if e.forward != "drive")
        )

    @cached_property
    def indices(self) -> tuple[NDArray[np.intp], ...]:
        """Where each effect's parameters sit in theta."""
        ends = np.cumsum([len(effect.parameters) for effect in self.effects])
        return tuple(np.split(np.arange(ends[-1]), ends[:-1]))

    @property
    def parts(self) -> list[tuple[Effect, NDArray[np.intp]]]:
        """Each effect, and where its parameters sit in theta."""
        return list(zip(self.effects, self.indices, strict=True))

    @cached_property
    def rigid_indices(self) -> NDArray[np.intp]:
        """(10 n,) where the links' standard parameters sit in theta; empty without a
        rigid body."""
        return next(
            (k for effect, k in self.parts if effect.name == "rigid_body"), np.arange(0)
        )

    @cached_property
    def drives(self) -> NDArray[np.bool_]:
        """(p,) which parameters are the drives'."""
        flags = [np.full(len(e.parameters), e.forward == "drive") for e in self.effects]
        return np.concatenate(flags)

    @cached_property
    def error_gains(self) -> tuple[int, ...]:
        """(n) where the gain of each joint's position error sits in theta; -1 without a
        servo."""
        servo_parts = [(e, k) for e, k in self.parts if e.position_gains]
        at = {
            j: int(i)
            for e, k in servo_parts
            for j, i in zip(e.joints, k[e.position_gains], strict=True)
        }
        return tuple(at.get(j, -1) for j in range(self.robot.n))

    @cached_property
    def sign_width(self) -> tuple[float, ...]:
        """(n) the velocities over which this model smooths the signs of dry friction
        [rad/s, m/s]."""
        widths = {
            j: e.shape["v_s"]
            for e in self.effects
            if "v_s" in e.shape
            for j in e.joints
        }
        return tuple(widths.get(j, SIGN_WIDTH) for j in range(self.robot.n))

    @cached_property
    def plausible(self) -> Array:
        """(p,) standard deviations of the parameters about zero before anything is
        measured, infinite where nothing is known."""
        return plausible_sizes(self.effects)

    def columns(self, motion: Motion) -> list[JointColumns]:
        """Compute the regressor of a motion, joint by joint.

        Parameters
        ----------
        motion
            The motion at N instants.

        Returns
        -------
        list of JointColumns
            n entries.
        """
        return self.joined(self.blocks(motion), len(motion.t))

    def dense_columns(self, motion: Motion) -> Array:
        """Compute the regressor with columns for all parameters.

        Parameters
        ----------
        motion
            The motion at N instants.

        Returns
        -------
        Array
            (n, N, p) columns, zero where a parameter does not act on a joint.
        """
        blocks = self.blocks(motion)
        out = np.zeros((self.robot.n, len(motion.t), len(self.parameters)))
        for k, indices in enumerate(self.indices):
            for block in blocks.get(k, ()):
                out[block.joint][:, indices[block.parameters]] = block.columns
        if self.gains is not None:
            out *= np.asarray(self.gains)[:, None, None]
        return out

    def blocks(
        self,
        motion: Motion,
        known: Collection[int] = (),
        smooth: Motion | None = None,
    ) -> dict[int, list[Block]]:
        """Compute the columns of each effect.

        Parameters
        ----------
        motion
            The motion at N instants.
        known
            Places of effects whose columns are known already and are left out.
        smooth
            The motion for the columns of smooth effects, if another one.

        Returns
        -------
        dict
            Blocks by the place of their effect in the model.
        """
        if motion.sign_width != self.sign_width:
            motion = replace(motion, sign_width=self.sign_width)
        computed = {
            k: e.blocks(smooth if smooth is not None and e.smooth else motion)
            for k, e in enumerate(self.effects)
            if not (depends(e) or (k in known and not self.needs_reference))
        }
        dependent = {k: e for k, e in enumerate(self.effects) if depends(e)}
        needs_current_model = bool(dependent) and motion.current is None
        if needs_current_model:
            motion = replace(motion, current=self._current(self._referred))
        computed |= {
            k: e.blocks(motion) for k, e in dependent.items() if not e.needs_torque
        }
        if needs_current_model:
            motion = replace(
                motion, torque=self._made(computed, self._referred, motion)
            )
        computed |= {
            k: e.blocks(motion) for k, e in dependent.items() if e.needs_torque
        }
        return {
            k: computed_blocks
            for k, computed_blocks in computed.items()
            if k not in known
        }

    def joined(
        self,
        blocks: Mapping[int, list[Block]],
        count: int,
    ) -> list[JointColumns]:
        """Join the blocks of all effects to the regressor.

        Parameters
        ----------
        blocks
            Blocks by the place of their effect in the model.
        count
            Number of instants.

        Returns
        -------
        list of JointColumns
            n entries.
        """
        parts = [[(np.arange(0), np.zeros((count, 0)))] for _ in range(self.robot.n)]
        for k, indices in enumerate(self.indices):
            for block in blocks.get(k, ()):
                parts[block.joint].append((indices[block.parameters], block.columns))
        pairs_by_joint = (zip(*indices, strict=True) for indices in parts)
        joints = [
            JointColumns(np.concatenate(i), np.hstack(c)) for i, c in pairs_by_joint
        ]
        if self.gains is None:
            return joints
        return [
            replace(c, columns=g * c.columns)
            for c, g in zip(joints, self.gains, strict=True)
        ]

    def without_known(
        self,
        columns: Sequence[JointColumns],
        torque: Array,
    ) -> tuple[list[JointColumns], Array]:
        """Subtract the torque of known parameters, and zero their columns.

        Parameters
        ----------
        columns
            The regressor, joint by joint.
        torque
            (N, n) torque [N m, N].

        Returns
        -------
        tuple
            The columns with zeros for known parameters, and the torque (N, n) that is
            left.
        """
        if not self.known:
            return list(columns), torque
        free = np.array([p.name not in self.known for p in self.parameters])
        value = self.with_known(np.zeros(len(free)))
        known_torque = np.column_stack([c.columns @ value[c.indices] for c in columns])
        return [
            replace(c, columns=c.columns * free[c.indices]) for c in columns
        ], torque - known_torque

    def with_known(self, theta: Array) -> Array:
        """Put the given values into theta.

        Parameters
        ----------
        theta
            (p,) parameters.

        Returns
        -------
        Array
            (p,) parameters with those of ``known`` in their places.
        """
        names = [p.name for p in self.parameters]
        return np.array(
            [self.known.get(name, x) for name, x in zip(names, theta, strict=True)],
            float,
        )

    @property
    def _referred(self) -> Array:
        """(p,) the reference; InputError in a model without one."""
        if self.reference is None:
            name = next(e.name for e in self.effects if depends(e))
            raise InputError(
                f"effect {name} refers to a current model and this one has none",
                "identify the robot without it first, then add it",
            )
        return self.reference

    def _made(
        self,
        blocks: Mapping[int, list[Block]],
        theta: Array,
        motion: Motion,
    ) -> Array:
        """(N, n) torque of blocks."""
        torque = np.zeros_like(motion.q)
        for k, parts in blocks.items():
            coefficients = theta[self.indices[k]]
            for block in parts:
                torque[:, block.joint] += block.columns @ coefficients[block.parameters]
        return torque

    def _current(self, theta: Array) -> CurrentModel:
        """The links as theta (p,) has them; without mass in a model without a rigid
        body."""
        links = theta[self.rigid_indices].reshape(-1, 10)
        return CurrentModel(
            self.robot, links if len(links) else np.zeros((self.robot.links, 10))
        )

    def seen_along(self, theta: Array, motion: Motion) -> Motion:
        """Attach the current model to a motion.

        Parameters
        ----------
        theta
            (p,) parameters.
        motion
            The motion at N instants.

        Returns
        -------
        Motion
            The motion with the links of theta, the torque before the channels, the
            torque as the channels log it, and this model's widths of signs.
        """
        before = self.before_channels
        torque = before.torque(theta[self.places(before)], motion)
        logged = torque if before is self else self.torque(theta, motion)
        attached = replace(motion, torque=torque, current=self._current(theta))
        return replace(attached, logged=logged, sign_width=self.sign_width)

    def torque(
        self,
        theta: Sequence[float] | Array,
        motion: Motion,
    ) -> Array:
        """Compute the torque of the model: tau = Y(motion) theta.

        Parameters
        ----------
        theta
            (p,) parameters.
        motion
            The motion at N instants.

        Returns
        -------
        Array
            (N, n) torque [N m, N].
        """
        theta = np.asarray(theta, float)
        count = len(motion.t)
        if count > _PART and not any(effect.has_memory for effect in self.effects):
            parts = (motion.part(slice(k, k + _PART)) for k in range(0, count, _PART))
            return np.concatenate([self.torque(theta, part) for part in parts])
        if self.needs_reference:
            return np.column_stack(
                [c.columns @ theta[c.indices] for c in self.columns(motion)]
            )
        if motion.sign_width != self.sign_width:
            motion = replace(motion, sign_width=self.sign_width)
        total = sum(
            (e.torque(theta[k], motion) for e, k in self.parts), np.zeros_like(motion.q)
        )
        return total * np.array(self.gains or (1.0,))


def plausible_sizes(effects: Sequence[Effect]) -> Array:
    """Return how large parameters are before anything is measured.

    Parameters
    ----------
    effects
        The effects, in the order of their parameters.

    Returns
    -------
    Array
        (k,) standard deviations about zero, infinite where nothing is known.
    """
    parts = [
        np.full(len(e.parameters), np.inf) if e.plausible is None else e.plausible
        for e in effects
    ]
    return np.concatenate([np.zeros(0), *parts])


def turning(motion: Motion, effect: Effect) -> Motion:
    """Give a motion the widths of signs that an effect states.

    Parameters
    ----------
    motion
        The motion.
    effect
        An effect with a shape constant ``v_s``, or without one.

    Returns
    -------
    Motion
        The same motion where the effect states no width.
    """
    if "v_s" not in effect.shape:
        return motion
    width = effect.shape["v_s"]
    n = motion.dq.shape[1]
    widths = tuple(width if j in effect.joints else motion.width(j) for j in range(n))
    return replace(motion, sign_width=widths)


def depends(effect: Effect) -> bool:
    """Tell whether an effect's columns need a current model.

    Parameters
    ----------
    effect
        The effect.

    Returns
    -------
    bool
        True where it reads the model's torque or links.
    """
    return effect.needs_torque or effect.needs_links
