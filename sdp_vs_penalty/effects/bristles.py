"""Friction that remembers: internal states that follow a path, and the effects that
have them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from sdp_vs_penalty.effects.effect import (
    Array,
    Block,
    Effect,
    JointCoverage,
    JointEffect,
    Motion,
)
from sdp_vs_penalty.effects.motion import Legs
from sdp_vs_penalty.effects.shape import POSITION, ShapeConstant, choice

#: Maps a path, the distance over which its state turns round, and the state at its start
#: to the state z (N,) along it.
Law = Callable[[Array | Legs, float, float], Array]


@dataclass(frozen=True)
class Bristles:
    """k friction states z in [-1, 1] that follow the motion.

    State i turns over the distance d_i of the path s_i = directions_i q.
    """

    #: (k, n) ratios of the joints.
    directions: Array
    #: (k,) travel over which each state turns [rad, m].
    distances: Array
    #: Function that follows a state along a path: :func:`dahl` or :func:`stop`.
    law: Law

    def along(self, motion: Motion) -> Array:
        """Follow the k states along a motion.

        Each state follows the path of one combination of joints (a row of
        ``directions``) over its distance. At the first sample a moving joint counts as
        sliding in its direction; at rest the state begins at zero.

        Parameters
        ----------
        motion
            The motion at N instants.

        Returns
        -------
        Array
            (N, k) states in [-1, 1].
        """
        states = np.empty((len(self.distances), len(motion.t)))
        for i, ratios in enumerate(self.directions):
            path = motion.legs_along(ratios)
            start = float(motion.sign_along(ratios)[0])
            states[i] = self.law(path, self.distances[i], start)
        return states.T

    def advanced(self, z: Array, travel: Array) -> Array:
        """Return the states after one displacement without reversal.

        With x = travel along each direction over its distance d: a spring and slider
        (``stop``) gives z + x, cut off at +-1; Dahl's law gives s + (z - s) exp(-|x|),
        s = sign(x).

        Parameters
        ----------
        z
            (W, k) states of W simulations.
        travel
            (W, n) joint displacements [rad, m].

        Returns
        -------
        Array
            (W, k) states after it.
        """
        x = travel @ self.directions.T / self.distances
        if self.law is stop:
            return np.clip(z + x, -1.0, 1.0)
        s = np.sign(x)
        return s + (z - s) * np.exp(-np.abs(x))


class StatefulEffect(Effect):
    """An effect some of whose columns depend on states that follow the motion."""

    has_memory = True

    @property
    @abstractmethod
    def bristles(self) -> Bristles:
        """The friction states of the effect: directions, distances and the law by which
        they follow the motion; no states if the shape constants choose a law without
        one."""

    @abstractmethod
    def blocks_at(self, motion: Motion, z: Array) -> list[Block]:
        """Compute the columns at N instants whose states z (N, k) are known.

        Parameters
        ----------
        motion
            The motion at N instants.

        Returns
        -------
        list of Block
            The columns, joint by joint.
        """

    def blocks(self, motion: Motion) -> list[Block]:
        """Compute the columns along a motion, after following the friction states along
        it."""
        return self.blocks_at(motion, self.bristles.along(motion))

    def looks_like(self, size: float, coverage: JointCoverage) -> str:
        """Give a reason to doubt friction that changes sign within less than two steps
        of the encoder: any sharp friction makes a similar torque.

        This is asked only of effects whose friction turns over a travel (``at_rest`` =
        "turns").

        Parameters
        ----------
        size
            Size of the effect that was found; 0 where it is asked before a fit.
        coverage
            Travel, resolution and standstills of its joint in the runs.

        Returns
        -------
        str
            The reason, empty if there is none.
        """
        longest_travel = max(self.bristles.distances, default=np.inf)
        is_hidden = longest_travel < 2.0 * coverage.resolution
        if self.at_rest == "turns" and is_hidden:
            return (
                "it turns round within the resolution of the positions: any sharp"
                " friction makes a similar torque"
            )
        return super().looks_like(size, coverage)


def dahl(q: Array | Legs, d: float, start: float = 0.0) -> Array:
    """Follow Dahl's friction state z along a path, from z[0] = ``start``.

    Exact for motion that is monotone between samples: while q runs in direction s, z =
    s + (z_0 - s) exp(-|q - q_0| / d). The loop runs over reversals, not over samples.

    Parameters
    ----------
    q
        (N,) positions, or the legs of a path.
    d
        Travel over which the friction turns [rad, m].

    Returns
    -------
    Array
        (N,) states in [-1, 1].
    """
    legs = q if isinstance(q, Legs) else Legs.along(q)
    # The state at the corners, leg by leg.
    decay_of_leg = np.exp(np.abs(np.diff(legs.corners)) / -d)
    corners = [start]
    for s, decay in zip(legs.direction.tolist(), decay_of_leg.tolist(), strict=True):
        corners.append(s + (corners[-1] - s) * decay)
    # The state at every sample, from the beginning of its leg.
    s = legs.direction
    z_0 = np.array(corners[:-1])
    decay = np.exp(np.abs(legs.travel) / -d)
    z = s[legs.leg] + (z_0 - s)[legs.leg] * decay
    if not s.all():  # a path that never moves
        z = np.where(s[legs.leg] == 0.0, start, z)
    return np.append(start, z)


def stop(q: Array | Legs, d: float, start: float = 0.0) -> Array:
    """Follow the state z of a spring and a slider in series along a path, from z[0] =
    ``start``.

    Exact for motion that is monotone between samples: from one reversal to the next the
    state is the straight line of its spring, cut off at +-1. The loop runs over
    reversals, not over samples.

    Parameters
    ----------
    q
        (N,) positions, or the legs of a path.
    d
        Travel after which the slider moves [rad, m].

    Returns
    -------
    Array
        (N,) states in [-1, 1].
    """
    legs = q if isinstance(q, Legs) else Legs.along(q)
    z = [start]
    for step in (np.diff(legs.corners) / d).tolist():
        z.append(min(max(z[-1] + step, -1.0), 1.0))
    moved = np.array(z[:-1])[legs.leg] + legs.travel / d
    return np.append(start, np.clip(moved, -1.0, 1.0))


#: Travels before sliding from which a search starts [rad].
PRESLIDING_TRAVELS = (0.0001, 0.0005, 0.001, 0.002, 0.004, 0.008, 0.016, 0.032)


class PreslidingHysteresis(StatefulEffect, JointEffect):
    equation = "f_h (z - sign(dq)), dz/dq = (1 - z sign(dq)) / d"
    explanation = (
        "Before surfaces slide their asperities bend like springs: after a reversal the"
        " friction needs a travel of about d to change sign. The way back differs from"
        " the way there (hysteresis), which no function of velocity can imitate."
    )
    in_words = "pre-sliding hysteresis"
    on_the_arm = (
        "after each reversal {joint} gives way like a spring for about {travel} "
        "before its friction of {size} has turned round"
    )
    seen_against = "reversal"
    reference = "Dahl, Aerospace Corp. TR-0158 (1968); AIAA Journal 1976, eq. 5"
    symbol = "f_h"
    lower = 0.0
    refines: tuple[str, ...] = ("coulomb_friction",)
    at_rest: ClassVar[Literal["", "holds", "turns"]] = "turns"
    shapes = {
        "d": ShapeConstant(
            0.003, POSITION, grid=PRESLIDING_TRAVELS, bounds=(0.00005, 0.05)
        )
    }

    @property
    def bristles(self) -> Bristles:
        """One state of Dahl's law for each joint of the effect."""
        joints = list(self.joints)
        return Bristles(
            np.eye(self.robot.n)[joints], np.full(len(joints), self.shape["d"]), dahl
        )

    def blocks_at(self, motion: Motion, z: Array) -> list[Block]:
        """Return the column z_i - sign(dq_i) (N,) of each of the effect's k joints, from
        their friction states z (N, k): what Dahl's law adds to Coulomb's."""
        return self.blocks_per_joint(
            [
                state - motion.sign(joint)
                for joint, state in zip(self.joints, z.T, strict=True)
            ]
        )


class Stiction(PreslidingHysteresis):
    equation = "f_s (z - sign(dq)), z the last way of sliding"
    explanation = (
        "Dry friction holds a joint at rest, where a smooth sign of the velocity lets"
        " go: it keeps its last value until the joint slides the other way. While the"
        " joint sticks, the true friction may be anything up to its Coulomb level, and"
        " the positions do not show over what travel it turns round (presliding)."
    )
    on_the_arm = "{joint} sticks at rest with up to {size}"
    seen_against = "reversal"
    reference = (
        "Karnopp, ASME J. Dyn. Sys. Meas. Control 1985; Stewart, SIAM Review 2000"
    )
    symbol = "f_s"
    same_law_as = {"presliding_hysteresis": "d"}
    at_rest = "holds"
    #: Short travels, over which the computed state forgets what the filter makes of a
    #: joint at rest.
    shapes = {
        "d": ShapeConstant(
            0.0001,
            POSITION,
            grid=(0.00001, 0.00003, 0.0001, 0.0003),
            bounds=(0.00001, 0.001),
        )
    }

    def remark(self, size: float) -> str:
        """Say that the travel d [rad, m] over which the friction changed sign is known
        as an upper bound only: the motion did not show it."""
        d = self.shape["d"]
        unit = self.robot.position_units[self.joints[0]]
        return (
            f"It turned round within less than {d:.2g} {unit}; the positions do not show"
            " how much less."
        )


#: Elements side by side, and how many times farther the next one bends before it slips.
_ELEMENTS = 3
_SPACING = 4.0


class MaxwellSlip(StatefulEffect, JointEffect):
    equation = "sum_i f_m,i z_i, dz_i/dq = 1 / d_i while |z_i| < 1, d_i = d, 4 d, 16 d"
    explanation = (
        "Springs side by side, each with a slider that gives way at its own distance:"
        " after a reversal the friction turns round over several scales, where Dahl's"
        " curve has one. Every element is passive for f_m,i >= 0; with law = even all"
        " are as strong, f_m / 3. What depends on speed once all slip is"
        " stribeck_friction's."
    )
    in_words = "Maxwell slip"
    on_the_arm = (
        "after each reversal of {joint} its friction of {size} builds up step by "
        "step, over travels from {travel} on"
    )
    seen_against = "reversal"
    reference = (
        "Al-Bender, Lampaert, Swevers, IEEE TAC 2005 (generalized Maxwell-slip),"
        " sec. III"
    )
    symbol = "f_m"
    refines: tuple[str, ...] = ("presliding_hysteresis", "coulomb_friction")
    at_rest = "turns"
    sizes_add_up = True  # once all elements slip
    shapes = {
        "d": ShapeConstant(
            0.002,
            POSITION,
            grid=(0.0001, 0.0005, 0.001, 0.002, 0.004, 0.008),
            bounds=(0.00005, 0.05),
        ),
        "law": choice("free", "even"),
    }

    lower = 0.0

    def settle(self) -> None:
        """With law = even the effect has as many parameters as pre-sliding hysteresis
        (Dahl's curve), so a search does not take it for a refinement of that one."""
        if self.even:
            self.refines = self.refines[1:]  # all but presliding_hysteresis (Dahl)

    @property
    def even(self) -> bool:
        """Whether its three elements are equally strong (law = even, number 2), so that
        each joint has one parameter."""
        return self.shape["law"] == 2.0

    def parameter_names_and_units(self, joint: int) -> Iterable[tuple[str, str]]:
        """Name the strength of each element of a joint, "f_m2_1" ...; with law = even
        of all together."""
        base_name = self.parameter_name(joint)
        unit = self.unit_on(joint)
        return [
            (f"{base_name}_{i + 1}", unit) for i in range(1 if self.even else _ELEMENTS)
        ]

    @property
    def bristles(self) -> Bristles:
        """Three spring-and-slider states for each joint of the effect, with the
        distances d, 4 d and 16 d [rad, m] after which the sliders move."""
        directions = np.repeat(
            np.eye(self.robot.n)[list(self.joints)], _ELEMENTS, axis=0
        )
        distances = self.shape["d"] * _SPACING ** np.arange(_ELEMENTS)
        return Bristles(directions, np.tile(distances, len(self.joints)), stop)

    def blocks_at(self, motion: Motion, z: Array) -> list[Block]:
        """Return the states (N, 3) of each of the effect's k joints as its columns, from
        z (N, 3 k); their mean (N,) with law = even."""
        by_joint = np.split(z, len(self.joints), axis=1)
        return self.blocks_per_joint(
            [x.mean(axis=1) for x in by_joint] if self.even else by_joint
        )


class LoadDependentHysteresis(PreslidingHysteresis):
    equation = "f_lh |tau_l| z, tau_l the links' torque, dz/dq = (1 - z sign(dq)) / d"
    explanation = (
        "Teeth that are pressed harder rub more, and at a reversal their friction turns"
        " round over a travel of about d: load-dependent friction with Dahl's memory."
        " f_lh is the share of the transmitted torque that is lost once the teeth"
        " slide; then it only takes energy. Before, they are a spring whose stiffness"
        " follows the load."
    )
    on_the_arm = (
        "the gear of {joint} loses {share} of the torque that it carries, and "
        "yields {travel} after each reversal before it does"
    )
    seen_against = "reversal"
    reference = (
        "Dahl, AIAA Journal 1976, eq. 5; load: Hamon, Gautier, Garrec, IROS 2010"
    )
    symbol = "f_lh"
    units = ("-", "-")
    usual = (0.3, 0.3)  # as load-dependent friction
    #: Where the load hardly changes, or is mostly friction itself, these make the same
    #: torque as this effect.
    refines = ("presliding_hysteresis", "stiction", "coulomb_friction")
    at_rest = ""
    needs_links = True

    def blocks_at(self, motion: Motion, z: Array) -> list[Block]:
        """Return the column |tau_l| z_i (N,) of each of the effect's k joints, from their
        friction states z (N, k); tau_l is the torque of the links."""
        load = np.abs(motion.link_torque)
        return self.blocks_per_joint(
            [
                load[:, joint] * state
                for joint, state in zip(self.joints, z.T, strict=True)
            ]
        )
