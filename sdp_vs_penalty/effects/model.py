"""A robot model: a robot and the list of effects that make its joint torques."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sdp_vs_penalty.effects.effect import (
    SIGN_WIDTH,
    Block,
    CurrentModel,
    Effect,
    Motion,
    Parameter,
)
from sdp_vs_penalty.errors import InputError, require_known
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask, as_slice
from sdp_vs_penalty.robot.robot import Robot

#: Instants whose torque is computed at a time: the columns take many times its memory.
_PART = 1 << 13


@dataclass(frozen=True)
class JointColumns:
    """The regressor of one joint's torque."""

    #: (k,) indices into theta of the columns' parameters.
    indices: Indices
    #: (N, k) torque [N m, N] from one unit of each parameter.
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
    """A robot and its effects: tau = sum over effects of Y_e theta_e.

    theta (p,) holds the effects' parameters one after the other.
    """

    #: The robot.
    robot: Robot
    #: The effects, in the order of theta.
    effects: tuple[Effect, ...]
    #: (p,) parameters of the current model, to which effects refer whose columns need a
    #: torque (a gain) or the links (elasticity); None where no effect needs it.
    reference: Array | None = None
    #: (n,) reading of each torque channel over the true torque, where it is known:
    #: theta is then in true units, and the modelled torque in those of the channels.
    #: None: 1.
    gains: tuple[float, ...] | None = None
    #: Whether an effect may come twice, the second time for what has changed since the
    #: first was identified.
    allow_duplicates: bool = False
    #: Values of given parameters by name, which no data change: equalities of the
    #: optimisation problem.
    known: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise InputError for a model without effects, or with a parameter that
        appears twice."""
        names_so_far: set[str] = set()
        for p in () if self.allow_duplicates else self.parameters:
            if p.name in names_so_far:
                raise InputError(
                    f"parameter {p.name} appears twice",
                    f"list effect {p.effect} only once per joint; what the model has"
                    " already need not be added",
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
        """The same model without the effects whose columns need the torque or links of
        a current model."""
        free = tuple(e for e in self.effects if not depends(e))
        return Model(self.robot, free, gains=self.gains, known=self.known)

    @cached_property
    def before_channels(self) -> Model:
        """The same model without the effects of the torque channels (gain, delay): it
        gives the true torque, which the channels then distort."""
        before = tuple(e for e in self.effects if not e.needs_torque)
        if len(before) == len(self.effects):
            return self
        part = Model(self.robot, before, gains=self.gains, known=self.known)
        # The current model, if there is one, is cut to the same parameters.
        if self.reference is None:
            return part
        return replace(part, reference=self.reference[self.places(part)])

    def places(self, part: Model) -> Indices:
        """Find where the parameters of a smaller model stand in this model's theta.

        Parameters
        ----------
        part
            A model with some of the same effects.

        Returns
        -------
        NDArray
            Indices into theta, in the order of the smaller model.
        """
        of_part = [k for effect, k in self.parts if effect in part.effects]
        return np.concatenate([np.arange(0), *of_part])

    @cached_property
    def without_drives(self) -> Model:
        """The same model without the control laws of the drives (servo effects)."""
        others = tuple(e for e in self.effects if e.forward != "drive")
        return replace(self, effects=others)

    @cached_property
    def indices(self) -> tuple[Indices, ...]:
        """Indices into theta of each effect's parameters, in the order of the
        effects."""
        ends = np.cumsum([len(effect.parameters) for effect in self.effects])
        return tuple(np.split(np.arange(ends[-1]), ends[:-1]))

    @property
    def parts(self) -> list[tuple[Effect, Indices]]:
        """Pairs of each effect and the indices of its parameters in theta."""
        return list(zip(self.effects, self.indices, strict=True))

    @cached_property
    def rigid_indices(self) -> Indices:
        """(10 n,) indices in theta of the links' ten standard parameters; empty without
        a rigid body."""
        for effect, indices in self.parts:
            if effect.simulator_field == "links":
                return indices
        return np.arange(0)

    @cached_property
    def drives(self) -> Mask:
        """(p,) flags of the parameters that belong to the drives' control laws."""
        flags = [np.full(len(e.parameters), e.forward == "drive") for e in self.effects]
        return np.concatenate(flags)

    @cached_property
    def error_gains(self) -> tuple[int, ...]:
        """(n,) index in theta of the gain of each joint's position error (kp of its
        servo); -1 for a joint without a servo."""
        index_of_joint = dict[int, int]()
        for effect, indices in self.parts:
            if effect.simulator_field != "servo":
                continue
            # The gains of a joint's position error and of its rate take turns.
            for joint, index in zip(effect.joints, indices[::2], strict=True):
                index_of_joint[joint] = int(index)
        return tuple(index_of_joint.get(j, -1) for j in range(self.robot.n))

    @cached_property
    def sign_width(self) -> tuple[float, ...]:
        """(n,) velocities [rad/s, m/s] over which the sign of dry friction is smoothed:
        the shape constant v_s of each joint's Coulomb friction, else the default."""
        width_of_joint = dict[int, float]()
        for effect in self.effects:
            if "v_s" in effect.shape:
                width_of_joint |= dict.fromkeys(effect.joints, effect.shape["v_s"])
        return tuple(width_of_joint.get(j, SIGN_WIDTH) for j in range(self.robot.n))

    @cached_property
    def plausible(self) -> Array:
        """(p,) prior standard deviations of the parameters about zero, in SI units;
        infinite where none is assumed, and of a known value."""
        sizes = plausible_sizes(self.effects)
        sizes[list(self.known_values)] = np.inf
        return sizes

    def columns(self, motion: Motion) -> list[JointColumns]:
        """Compute the regressor of a motion of N instants, joint by joint, for all n
        joints."""
        return self.joined(self.blocks(motion), len(motion.t))

    def dense_columns(
        self, motion: Motion, chosen: Sequence[int] | None = None
    ) -> Array:
        """Compute the regressor with columns for all parameters, or for some.

        Parameters
        ----------
        motion
            The motion at N instants.
        chosen
            Indices of k parameters; default: all.

        Returns
        -------
        Array
            (n, N, k) columns, zero where a parameter does not act on a joint.
        """
        if chosen is None:
            chosen = range(len(self.parameters))
        # The column of each parameter; -1 of those that are not chosen.
        places = np.full(len(self.parameters), -1)
        places[list(chosen)] = np.arange(len(chosen))
        blocks = self.blocks(motion)
        out = np.zeros((self.robot.n, len(motion.t), len(chosen)))
        for k, indices in enumerate(self.indices):
            for block in blocks.get(k, ()):
                of_block = places[indices[block.parameters]]
                used = np.flatnonzero(of_block >= 0)
                into, columns = as_slice(of_block[used]), as_slice(used)
                out[block.joint][:, into] = block.columns[:, columns]
        if self.gains is not None:
            out *= np.asarray(self.gains)[:, None, None]
        return out

    def blocks(
        self, motion: Motion, known: Collection[int] = (), smooth: Motion | None = None
    ) -> dict[int, list[Block]]:
        """Compute the columns of each effect.

        First come the effects that need no current model, then those that need its
        links, then those that need its torque, which is the sum of all before.

        Parameters
        ----------
        motion
            The motion at N instants.
        known
            Places of effects whose columns are known already and are left out.
        smooth
            Another motion for the columns of smooth effects (such as one at a lower
            rate).

        Returns
        -------
        dict
            Blocks by the place of their effect in the model.
        """
        if motion.sign_width != self.sign_width:
            motion = motion.with_sign_width(self.sign_width)
        independent = {k: e for k, e in enumerate(self.effects) if not depends(e)}
        blocks = {
            k: _blocks_of(e, smooth if smooth is not None and e.smooth else motion)
            for k, e in independent.items()
            if k not in known
        }
        dependent = {k: e for k, e in enumerate(self.effects) if depends(e)}
        if not dependent:
            return blocks
        # A motion that has the current model has its torque as well.
        is_made_here = motion.current is None
        if is_made_here:
            motion = replace(motion, current=self._current(self._reference_parameters))
        for k, effect in dependent.items():
            if not effect.needs_torque:
                blocks[k] = _blocks_of(effect, motion)
        if is_made_here and any(e.needs_torque for e in dependent.values()):
            torque = self._summed_torque(blocks, self._reference_parameters, motion)
            for k, effect in independent.items():
                if k in known:  # its columns were not computed here
                    theta = self._reference_parameters[self.indices[k]]
                    torque += effect.torque(theta, motion)
            motion = replace(motion, torque=torque)
        for k, effect in dependent.items():
            if effect.needs_torque:
                blocks[k] = _blocks_of(effect, motion)
        return {k: columns for k, columns in blocks.items() if k not in known}

    def joined(
        self, blocks: Mapping[int, list[Block]], count: int
    ) -> list[JointColumns]:
        """Join the blocks of all effects to the regressor.

        Parameters
        ----------
        blocks
            Blocks by the place of their effect in the model.
        """
        # Of each joint the indices into theta and the columns, to be concatenated.
        indices_of_joint = [[np.arange(0)] for _ in range(self.robot.n)]
        columns_of_joint = [[np.zeros((count, 0))] for _ in range(self.robot.n)]
        for k, indices in enumerate(self.indices):
            for block in blocks.get(k, ()):
                indices_of_joint[block.joint].append(indices[block.parameters])
                columns_of_joint[block.joint].append(block.columns)
        joints = [
            JointColumns(np.concatenate(indices), np.hstack(columns))
            for indices, columns in zip(indices_of_joint, columns_of_joint, strict=True)
        ]
        if self.gains is None:
            return joints
        return [
            replace(joint, columns=gain * joint.columns)
            for joint, gain in zip(joints, self.gains, strict=True)
        ]

    @cached_property
    def known_values(self) -> dict[int, float]:
        """Values of the known parameters by their index in theta."""
        return {
            k: self.known[p.name]
            for k, p in enumerate(self.parameters)
            if p.name in self.known
        }

    def require_known(self, what: str) -> None:
        """Raise InputError for a known value that is not finite, or of a parameter that
        the model does not have; ``what`` names the option or the field."""
        names = [p.name for p in self.parameters]
        for name, value in self.known.items():
            require_known("parameter", name, names, what)
            if not np.isfinite(value):
                raise InputError(f"{name} = {value} is no value", "give a number", what)

    def without_known(
        self, columns: Sequence[JointColumns], torque: Array
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
        if not self.known_values:
            return list(columns), torque
        known_values = self.with_known(np.zeros(len(self.parameters)))
        known_torque = np.column_stack(
            [joint.columns @ known_values[joint.indices] for joint in columns]
        )
        known_indices = list(self.known_values)
        free_columns = [
            replace(
                joint, columns=joint.columns * ~np.isin(joint.indices, known_indices)
            )
            for joint in columns
        ]
        return free_columns, torque - known_torque

    def with_known(self, theta: Array) -> Array:
        """Put the given values into theta.

        Returns
        -------
        Array
            (p,) parameters with those of ``known`` in their places.
        """
        out = np.array(theta, float)
        out[list(self.known_values)] = list(self.known_values.values())
        return out

    @property
    def _reference_parameters(self) -> Array:
        """(p,) parameters of the current model (``reference``), from which the columns
        of some effects are computed; InputError in a model without one."""
        if self.reference is None:
            name = next(e.name for e in self.effects if depends(e))
            raise InputError(
                f"effect {name} refers to a current model and this one has none",
                "identify the robot without it first, then add it",
            )
        return self.reference

    def _summed_torque(
        self, blocks: Mapping[int, list[Block]], theta: Array, motion: Motion
    ) -> Array:
        """Sum the torque (N, n) [N m, N] of some effects' blocks with the parameters
        theta (p,)."""
        torque = np.zeros_like(motion.q)
        for k, parts in blocks.items():
            coefficients = theta[self.indices[k]]
            for block in parts:
                torque[:, block.joint] += block.columns @ coefficients[block.parameters]
        return torque

    def _current(self, theta: Array) -> CurrentModel:
        """Return the links of theta (p,) as the current model; massless links where the
        model has no rigid body."""
        links = theta[self.rigid_indices].reshape(-1, 10)
        massless = np.zeros((self.robot.links, 10))
        return CurrentModel(self.robot, links if len(links) else massless)

    def seen_along(self, theta: Array, motion: Motion) -> Motion:
        """Attach the current model, with parameters theta (p,), to a motion, for
        effects whose columns depend on its links or torque.

        Parameters
        ----------
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

    def torque(self, theta: Sequence[float] | Array, motion: Motion) -> Array:
        """Compute the torque (N, n) [N m, N] of the model with parameters theta (p,)
        along a motion of N instants: tau = Y(motion) theta.

        Long motions are computed part by part, to keep the columns within the memory.
        """
        theta = np.asarray(theta, float)
        count = len(motion.t)
        # Effects with memory need the whole motion at once.
        has_memory = any(effect.has_memory for effect in self.effects)
        if count > _PART and not has_memory:
            parts = (motion.part(slice(k, k + _PART)) for k in range(0, count, _PART))
            return np.concatenate([self.torque(theta, part) for part in parts])
        if self.needs_reference:
            return np.column_stack(
                [c.columns @ theta[c.indices] for c in self.columns(motion)]
            )
        if motion.sign_width != self.sign_width:
            motion = motion.with_sign_width(self.sign_width)
        total = np.zeros_like(motion.q)
        for effect, indices in self.parts:
            total = total + effect.torque(theta[indices], motion)
        return total * np.array(self.gains or (1.0,))


def _blocks_of(effect: Effect, motion: Motion) -> list[Block]:
    """Return the columns of an effect; InputError, which names it, where the code of
    another package's effect breaks or makes columns of another length."""
    if type(effect).__module__.startswith("sdp_vs_penalty."):
        return effect.blocks(motion)
    advice = "correct the class; `sdp_vs_penalty.testing.contracts` tries all of it"
    try:
        blocks = effect.blocks(motion)
    except InputError:
        raise
    except Exception as error:
        what = f"effect {effect.name}: {type(error).__name__}: {error}"
        raise InputError(what, advice) from error
    for block in blocks:
        shape, expected = block.columns.shape, (len(motion.t), len(block.parameters))
        if shape != expected:
            what = f"effect {effect.name}: columns of shape {shape}, not {expected}"
            raise InputError(what, advice)
    return blocks


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


def with_sign_width_of(motion: Motion, effect: Effect) -> Motion:
    """Copy the sign width v_s of a friction effect into a motion, so that sign(dq) of
    the effect's joints is smoothed as tanh(dq / v_s).

    Parameters
    ----------
    effect
        An effect with a shape constant ``v_s`` [rad/s, m/s], or without one.

    Returns
    -------
    Motion
        A copy with these widths; the motion itself if the effect has no such constant.
    """
    if "v_s" not in effect.shape:
        return motion
    width = effect.shape["v_s"]
    n = motion.dq.shape[1]
    widths = tuple(width if j in effect.joints else motion.width(j) for j in range(n))
    return motion.with_sign_width(widths)


def depends(effect: Effect) -> bool:
    """Tell whether an effect's columns need a current model, whose torque or links they
    read."""
    return effect.needs_torque or effect.needs_links
