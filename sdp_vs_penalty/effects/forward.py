"""A model run forward: from joint torques, or commands of the drives, to motion.

    M(q) ddq = tau - b(q, dq) - f(q, dq, z, t),   dz/ds = law of the friction's internal
    states

M and b are the links' (Pinocchio), and f everything else that the model knows. Dry
friction turns round over velocities far smaller than the change in a step of a
millisecond. So its impulse in a step is solved for (Moreau's time stepping). All other
forces that grow with velocity or travel are linearised at the step's end (linearly
implicit midpoint rule), so that stiff friction is stable at any step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sdp_vs_penalty.effects.bristles import StatefulEffect
from sdp_vs_penalty.effects.effect import Array, CurrentModel, Effect, Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.motion import Command
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Indices

#: Change of velocity [rad/s, m/s] by which slopes of the force are taken, and the
#: damping of drives, whose laws are linear in it.
_SLOPE_VELOCITY_STEP = 1e-6
_DRIVE_VELOCITY_STEP = 1e-3
#: A contact whose velocity is so many widths slides: tanh is 1 to the last bit.
_SLIDES = 20.0
#: Newton's iterations for all contacts together, and for one contact.
_NEWTON_STEPS = 12
_RESOLVENT_STEPS = 9
#: Residual of a step, relative to its velocities, that counts as rounding.
_ARRIVED = 1e-11


class PlantState(NamedTuple):
    """W simulations at one instant."""

    #: (W,) time [s].
    t: Array
    #: (W, n) positions [rad, m].
    q: Array
    #: (W, n) velocities [rad/s, m/s].
    dq: Array
    #: (W, n) accelerations of the last step [rad/s^2, m/s^2].
    ddq: Array
    #: (W, k) internal states of the friction, in [-1, 1].
    z: Array
    #: (W, n) temperatures of the joints, constant [degrees Celsius]; NaN where unknown.
    temperature: Array
    #: (W, n) integrals of the positions over time [rad s, m s]; NaN where unknown.
    position_integral: Array

    def rows(self, which: slice | Indices) -> PlantState:
        """Return the states of some simulations, chosen by a slice or indices."""
        return PlantState(*(x[which] for x in self))


class MotionTerms(NamedTuple):
    """Terms of the equation of motion of W simulations with n joints."""

    #: (W, n, n) mass matrices [kg m^2, kg].
    mass: Array
    #: (W, n) all forces but dry friction [N m, N].
    bias: Array
    #: (W, n) derivative of the bias by the velocity.
    bias_by_velocity: Array
    #: (W, m) sizes of the dry friction along the m contacts [N m, N].
    dry_friction: Array


@dataclass(frozen=True)
class _Probe(Motion):
    """A motion in which the direction of dry friction is prescribed."""

    #: (m, n) ratios of the joints along which there is dry friction.
    contacts: Array | None = None
    #: (N, m) direction of the friction along each contact, -1 to 1.
    signs: Array | None = None

    def sign(self, joint: int, width: float | None = None) -> Array:
        """Return the prescribed sign (N,) of dry friction on one joint (from 0), in
        place of the velocity's."""
        assert self.signs is not None
        return self.signs[:, joint]

    def sign_ahead(self, joint: int, lead: float) -> Array:
        """Return the prescribed sign (N,) of dry friction on one joint (from 0),
        without the lead [s]."""
        return self.sign(joint)

    def sign_along(self, ratios: Array, width: float | None = None) -> Array:
        """Return the prescribed sign (N,) of dry friction along the contact with these
        ratios (n,), or the smooth sign where no contact has them."""
        assert self.signs is not None
        assert self.contacts is not None
        same = np.flatnonzero(np.all(self.contacts == ratios, axis=1))
        if not len(same):
            return super().sign_along(ratios, width)
        return self.signs[:, int(same[0])]


class Plant:
    """A robot model that can be simulated, with its parameters.

    Raises InputError where the model has no rigid body: without inertia nothing can
    move.
    """

    def __init__(self, model: Model, theta: Array) -> None:
        """Sort the model's effects by their role in a simulation, and prepare the
        links' dynamics.

        theta is (p,), or (W, p) with one row for each of W simulations; simulations
        with equal link parameters share one set of dynamics. The plant keeps pairs of
        an effect and its parameters' places in theta: ``effects`` that make torque on
        the joints, among them those that depend on accelerations
        (``_accelerated_effects``), and ``channels`` that only distort what is logged.
        """
        self.model = model
        self.robot = model.robot
        self.theta = np.atleast_2d(np.asarray(theta, float))
        if not len(model.rigid_indices):
            raise InputError(
                "the model has no rigid_body effect", "without inertia nothing can move"
            )
        # Effects that make a torque on the joints, and effects that only distort what
        # the torque channels read; each with the places of its parameters in theta.
        effects_and_indices = model.parts
        self.effects = [
            (e, k)
            for e, k in effects_and_indices
            if e.name != "rigid_body" and e.forward == "torque"
        ]
        self.channels = [
            (e, k) for e, k in effects_and_indices if e.forward == "channel"
        ]
        # One function for each distinct set of link parameters, which computes the mass
        # matrix and the bias torque; and the index of each simulation's function.
        links = self.theta[:, model.rigid_indices]
        distinct, which = np.unique(links, axis=0, return_inverse=True)
        self._mass_and_bias_functions = [
            self.robot.mass_and_bias(row) for row in distinct
        ]
        self._function_index = which.ravel()
        #: (m, n) directions along which there may be dry friction, (m,) over what
        #: widths it turns round.
        self.contacts, self.widths = self._contacts()
        self.bristles = [
            e.bristles for e, _ in self.effects if isinstance(e, StatefulEffect)
        ]
        self.states = sum(len(b.distances) for b in self.bristles)
        self._accelerated_effects = [
            (e, k) for e, k in self.effects if self._feels_acceleration(e)
        ]

    @property
    def left_out(self) -> tuple[str, ...]:
        """Text of the effects that cannot be simulated and are left out."""
        return tuple(e.text for e in self.model.effects if e.forward == "left out")

    def true_torque(self, t: Array, torque: Array) -> Array:
        """Recover the joints' torque (N, n) [N m, N], by the first row of parameters,
        from what the channels read (N, n) [N m, N] at instants t (N,) [s]."""
        if self.model.gains is not None:
            torque = torque / np.array(self.model.gains)
        for effect, k in self.channels:
            torque = effect.invert_channel(self.theta[0, k], t, torque)
        return torque

    def inner_states(self, motion: Motion) -> Array:
        """Follow the friction's internal states along a measured motion.

        Parameters
        ----------
        motion
            The motion at N instants.

        Returns
        -------
        Array
            (N, k) states in [-1, 1], the stateful effects one after the other.
        """
        motion = motion.with_sign_width(self.model.sign_width)
        states = [bristles.along(motion) for bristles in self.bristles]
        return np.hstack([np.zeros((len(motion.t), 0)), *states])

    def advanced(self, z: Array, travel: Array) -> Array:
        """Advance the friction's internal states by a displacement.

        Parameters
        ----------
        z
            (W, k) states, the stateful effects one after the other.
        travel
            (W, n) displacements [rad, m].

        Returns
        -------
        Array
            (W, k) states after it.
        """
        n_states = [len(bristles.distances) for bristles in self.bristles]
        parts = np.split(z, np.cumsum(n_states)[:-1], axis=1)
        moved = [np.zeros((len(z), 0))]
        # Without stateful effects np.split still returns one part, of no columns.
        for bristles, part in zip(self.bristles, parts, strict=False):
            moved.append(bristles.advanced(part, travel))
        return np.hstack(moved)

    @property
    def can_move(self) -> bool:
        """Whether M(q) is positive definite at 20 random poses, for the first row of
        parameters."""
        first = self if len(self.theta) == 1 else Plant(self.model, self.theta[0])
        poses = self.robot.random_configurations(20, 0)
        return bool(np.linalg.eigvalsh(first.mass(poses)).min() > 0.0)

    def mass(self, q: Array) -> Array:
        """Compute the mass matrices M(q) (W, n, n) [kg m^2, kg m, kg] of configurations
        q (W, n) [rad, m]."""
        return self._mass_and_bias(q, np.zeros_like(q))[0]

    def terms(self, state: PlantState, h: float) -> MotionTerms:
        """Compute the terms of the equation of motion for W simulations at the middle
        of a step h [s], predicted as if the acceleration of the last step went on.
        """
        dq = state.dq + 0.5 * h * state.ddq
        travel = 0.5 * h * (state.dq + 0.25 * h * state.ddq)
        mass, bias = self._mass_and_bias(state.q + travel, dq)
        delta = np.where(dq < 0.0, -_SLOPE_VELOCITY_STEP, _SLOPE_VELOCITY_STEP)
        n = self.robot.n
        n_combinations = len(self.contacts) - n
        # The forces are computed for several variants of the motion at once: without
        # dry friction (0), with that of all joints forwards (1), with that of each
        # combination of joints forwards (2 ...), and a little faster (-1).
        signs = np.zeros((3 + n_combinations, len(self.contacts)))
        signs[1, :n] = 1.0
        signs[2:-1, n:] = np.eye(n_combinations)
        moves = [(travel, dq)] * (2 + n_combinations)
        moves.append((travel + 0.5 * h * delta, dq + delta))
        force = self._forces(state, moves, signs, h)  # (variants, W, n)
        smooth = force[0]
        dry = [force[1] - smooth]
        for with_friction, ratios in zip(force[2:-1], self.contacts[n:], strict=True):
            # The force f c on the joints gives back f as f c . c / c . c.
            along = np.sum((with_friction - smooth) * ratios, axis=1)
            dry.append(along / float(ratios @ ratios))
        slope = (force[-1] - smooth) / delta
        return MotionTerms(mass, bias + smooth, slope, np.column_stack(dry))

    def _forces(
        self,
        state: PlantState,
        moves: Sequence[tuple[Array, Array]],
        signs: Array,
        h: float,
    ) -> Array:
        """Compute f, the force of all effects but the links', for P variants of the
        motion.

        ``moves`` holds P pairs of displacement and velocity (W, n), ``signs`` (P, m)
        the directions of dry friction along the m contacts. Returns (P, W, n) forces [N
        m, N].
        """
        # All P variants of W simulations are one motion of P W instants.
        count = len(moves)
        size = len(state.q)
        travel = np.concatenate([displacement for displacement, _ in moves])
        dq = np.concatenate([velocity for _, velocity in moves])
        still = np.zeros_like(dq)
        motion = _Probe(
            np.tile(state.t + 0.5 * h, count),
            np.tile(state.q, (count, 1)) + travel,
            dq,
            still,
            sign_width=self.model.sign_width,
            contacts=self.contacts,
            signs=np.repeat(signs, size, axis=0),
            temperature=np.tile(state.temperature, (count, 1)),
        )
        if self.model.needs_reference:
            motion = self._with_load(motion, np.tile(state.ddq, (count, 1)))
        # Friction states after the displacement of each variant.
        z = (
            self.advanced(np.tile(state.z, (count, 1)), travel)
            if self.states
            else state.z
        )
        # One row of parameters for all instants, or a row for each.
        theta = np.tile(self.theta, (count if len(self.theta) > 1 else 1, 1))
        return self._sum(self.effects, motion, z, theta).reshape(count, size, -1)

    def _sum(
        self,
        effects: Sequence[tuple[Effect, Indices]],
        motion: Motion,
        z: Array,
        theta: Array,
    ) -> Array:
        """Sum the torque (N, n) [N m, N] of some effects along a motion.

        ``z`` (N, k) holds the friction states of the stateful effects one after the
        other; ``theta`` is (1, p), or (N, p) with one row of parameters for each
        instant.
        """
        torque = np.zeros_like(motion.q)
        n_states_used = 0
        for effect, indices in effects:
            if isinstance(effect, StatefulEffect):
                end = n_states_used + len(effect.bristles.distances)
                blocks = effect.blocks_at(motion, z[:, n_states_used:end])
                n_states_used = end
            else:
                blocks = effect.blocks(motion)
            for block in blocks:
                parameters = theta[:, indices[block.parameters]]
                torque[:, block.joint] += (block.columns * parameters).sum(axis=1)
        return torque

    def _with_load(self, motion: _Probe, ddq: Array) -> _Probe:
        """Attach the current model's torque and links, to which some effects refer, to
        a motion.

        ``ddq`` (N, n) is the acceleration of the last step: that of this step is not
        known yet.
        """
        reference = self.model.reference
        assert reference is not None
        links = reference[self.model.rigid_indices].reshape(-1, 10)
        # Effects that do not refer to a current model; then those without friction
        # states.
        free = [
            (e, k) for e, k in self.effects if not (e.needs_torque or e.needs_links)
        ]
        plain = [(e, k) for e, k in free if not isinstance(e, StatefulEffect)]
        # Torque of the links plus that of these effects.
        torque = self.robot.inverse_dynamics(links, motion.q, motion.dq, ddq)
        torque += self._sum(
            plain, motion, np.zeros((len(motion.t), 0)), reference[None]
        )
        return replace(
            motion, ddq=ddq, torque=torque, current=CurrentModel(self.robot, links)
        )

    def _mass_and_bias(self, q: Array, dq: Array) -> tuple[Array, Array]:
        """Compute the mass matrices (W, n, n), with rotors and payload, and the bias
        torques (W, n) of the links [N m, N] (gravity and velocity terms)."""
        if len(self._mass_and_bias_functions) == 1:
            mass, bias = self._mass_and_bias_functions[0](q, dq)
        else:  # simulations with different links
            mass = np.empty((*q.shape, q.shape[1]))
            bias = np.empty_like(q)
            for k, mass_and_bias in enumerate(self._mass_and_bias_functions):
                rows = self._function_index == k
                mass[rows], bias[rows] = mass_and_bias(q[rows], dq[rows])
        if self._accelerated_effects:
            mass = mass + self._added_mass(q, self.theta)
        return mass, bias

    def _added_mass(self, q: Array, theta: Array) -> Array:
        """Compute the mass matrices (W, n, n) of the effects that depend on
        accelerations, such as rotor inertias and a payload.

        Column j is their torque at unit acceleration of joint j, less that at rest.
        """
        n = self.robot.n
        n_simulations = len(q)
        n_rows = n_simulations * n  # each simulation n times: each joint accelerates
        at_rest = np.zeros((n_rows, n))
        if len(theta) > 1:
            theta = np.repeat(theta, n, axis=0)
        accelerated = _Probe(
            t=np.zeros(n_rows),
            q=np.repeat(q, n, axis=0),
            dq=at_rest,
            ddq=np.tile(np.eye(n), (n_simulations, 1)),
            contacts=self.contacts,
            signs=np.zeros((n_rows, len(self.contacts))),
        )
        resting = replace(accelerated, ddq=at_rest)
        z = np.zeros((n_rows, self.states))
        torque = self._sum(self._accelerated_effects, accelerated, z, theta)
        torque -= self._sum(self._accelerated_effects, resting, z, theta)
        return torque.reshape(n_simulations, n, n)

    def _feels_acceleration(self, effect: Effect) -> bool:
        """Tell whether an effect's torque depends on the acceleration directly, not
        through the torque of a current model."""
        if effect.needs_torque or effect.needs_links:
            return False
        n = self.robot.n
        # Any pose will do.
        q = np.full((1, n), 0.1)
        still = np.zeros((1, n))

        def columns(ddq: Array) -> list[Array]:
            """Columns of the effect at one pose, at rest, with an acceleration (1, n)."""
            motion = Motion(np.zeros(1), q, dq=still, ddq=ddq, temperature=still)
            return [block.columns for block in effect.blocks(motion)]

        before = columns(still)
        after = columns(np.ones((1, n)))
        return not all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))

    def _contacts(self) -> tuple[Array, Array]:
        """List the m directions along which dry friction may act: each joint, and each
        combination of joints of an effect.

        They are ratios of the joints (m, n), with widths (m,) [rad/s, m/s] over which
        the friction turns.
        """
        n = self.robot.n
        widths = list(self.model.sign_width)
        rows = list(np.eye(n))
        for effect, _ in self.effects:
            ratios = effect.contact
            if ratios is None or any(np.array_equal(ratios, row) for row in rows):
                continue
            rows.append(ratios)
            widths.append(max(widths[j] for j in np.flatnonzero(ratios)))
        return np.array(rows), np.array(widths)


def advance(
    plant: Plant,
    state: PlantState,
    torque: Array,
    h: float,
    damping: Array | None = None,
) -> PlantState:
    """Take one step h [s] of all simulations; positions move with the mean velocity of
    the step.

    Friction and everything else that grows with velocity is implicit (see
    ``Plant.terms``).

    Parameters
    ----------
    plant
        The robot with its effects.
    torque
        (W, n) torque at the middle of the step, predicted as if accelerations stayed.
    damping
        (W, n, n) decrease of a controller's torque per unit of velocity there.

    Returns
    -------
    PlantState
        The states after the step.
    """
    mass, force, slope, dry = plant.terms(state, h)
    predicted = state.dq + h * state.ddq
    slopes = slope[:, :, None] * np.eye(slope.shape[1])
    if damping is not None:
        slopes = slopes + damping
    matrix = mass + 0.5 * h * slopes
    # The force was taken at the velocity predicted for the middle, (dq + predicted) / 2:
    # matrix @ dq = h (torque - force) + matrix @ predicted + mass @ (dq_0 - predicted).
    push = h * (torque - force) + np.einsum("kij,kj->ki", matrix, predicted)
    push += np.einsum("kij,kj->ki", mass, state.dq - predicted)
    dq = dry_step(matrix, push, state.dq, h * dry, plant.contacts, plant.widths)
    travel = 0.5 * h * (state.dq + dq)
    ddq = (dq - state.dq) / h
    z = plant.advanced(state.z, travel)
    position_integral = state.position_integral + h * (state.q + 0.5 * travel)
    return PlantState(
        t=state.t + h,
        q=state.q + travel,
        dq=dq,
        ddq=ddq,
        z=z,
        temperature=state.temperature,
        position_integral=position_integral,
    )


class ServoLoop:
    """A robot model with servo effects: the plant and the control laws of its drives.

    ``theta`` is (p,) parameters.
    """

    def __init__(self, model: Model, theta: Array) -> None:
        """Split the model into the drives' control laws and the plant that they
        drive."""
        #: Each servo effect with its parameters.
        self.drives = [(e, theta[k]) for e, k in model.parts if e.forward == "drive"]
        self.plant = Plant(model, theta)

    def drive_torque(self, motion: Motion) -> Array:
        """Compute the torque of the drives by their control laws.

        Servo effects are written as loads, so the torque of the drives is minus theirs.

        Parameters
        ----------
        motion
            The motion at N instants.

        Returns
        -------
        Array
            (N, n) torque [N m, N].
        """
        load = np.zeros_like(motion.q)
        for effect, parameters in self.drives:
            load = load + effect.torque(parameters, motion)
        return -load

    def start(self, command: Command, t: Array, q: Array, path: Array) -> PlantState:
        """Make the initial states of W simulations at instants t (W,) [s], with
        positions q (W, n) [rad, m], their integrals over time (W, n) [rad s, m s], and
        the velocity of the command."""
        dq = command.velocity(t)
        zero = np.zeros_like(q)
        motion = Motion(t, q, dq, zero, command=command, position_integral=path)
        z = (
            self.plant.inner_states(motion)
            if self.plant.states
            else np.zeros((len(t), 0))
        )
        return PlantState(t, q, dq, zero, z, np.full_like(q, np.nan), path)

    def step(self, state: PlantState, command: Command, h: float) -> PlantState:
        """Take one step h [s] of the simulated control loop.

        The drives' stiffness and damping are implicit: their torque is linearised in
        the velocity at the middle of the step, so that stiff drives are stable.
        """
        # Motion at the middle of the step, as if the acceleration stayed.
        half = 0.5 * h
        dq = state.dq + half * state.ddq
        q = state.q + half * state.dq + 0.5 * half * half * state.ddq
        path = state.position_integral + half * state.q
        middle = Motion(
            state.t + half, q, dq, state.ddq, command=command, position_integral=path
        )
        torque = self.drive_torque(middle)
        # The same middle reached a little faster: its torque gives the damping, the
        # decrease of each drive's torque per unit of velocity, by a difference.
        path = path + 0.5 * half * half * _DRIVE_VELOCITY_STEP
        faster = replace(
            middle,
            q=q + half * _DRIVE_VELOCITY_STEP,
            dq=dq + _DRIVE_VELOCITY_STEP,
            position_integral=path,
        )
        damping = (torque - self.drive_torque(faster)) / _DRIVE_VELOCITY_STEP
        return advance(
            self.plant, state, torque, h, damping[:, :, None] * np.eye(q.shape[1])
        )


# One step with dry friction, its sticking and sliding solved for, not stepped over.


def dry_step(
    matrix: Array, push: Array, before: Array, impulse: Array, c: Array, w: Array
) -> Array:
    """Compute the velocities after a step with dry friction: K dq = push - c^T f, where
    the friction impulse of contact i is f_i = p_i tanh(c_i dq / w_i).

    A negative p (friction that would push) acts with the velocity before the step.

    Parameters
    ----------
    matrix
        (W, n, n) K: mass matrix and half a step of the forces' slope.
    push
        (W, n) impulse of all other forces [N m s].
    before
        (W, n) velocities before the step.
    impulse
        (W, m) p, the largest friction impulse of each contact [N m s].
    c
        (m, n) directions of the contacts.
    w
        (m,) velocities over which the contacts turn [rad/s, m/s].

    Returns
    -------
    Array
        (W, n) velocities after the step.
    """
    past = before @ c.T  # (W, m) velocities along the contacts
    negative = np.minimum(impulse, 0.0)
    push = push - (negative * np.tanh(past / w)) @ c
    p = impulse - negative
    # K^-1 of the push (the velocities without friction) and of each contact.
    directions = np.broadcast_to(c.T, (len(push), *c.T.shape))
    right_sides = np.concatenate([push[:, :, None], directions], axis=2)
    solved = np.linalg.solve(matrix, right_sides)
    frictionless = solved[:, :, 0]  # (W, n)
    response = solved[:, :, 1:]  # (W, n, m) velocities per unit impulse
    y0 = frictionless @ c.T
    coupling = c @ response  # (W, m, m)
    # A contact that goes on sliding has the full impulse against its direction.
    direction = np.sign(past)
    friction = p * direction
    y = y0 - np.einsum("kij,kj->ki", coupling, friction)  # coupling @ friction
    is_undecided = (y * direction <= _SLIDES * w) & (p > 0.0)
    rows = np.flatnonzero(np.any(is_undecided, axis=1))
    if len(rows):
        friction[rows] = _solve_friction_impulses(
            y0=y0[rows], coupling=coupling[rows], p=p[rows], past=past[rows], w=w
        )
    return frictionless - np.einsum("kij,kj->ki", response, friction)


def _solve_friction_impulses(
    y0: Array, coupling: Array, p: Array, past: Array, w: Array
) -> Array:
    """Solve for the impulses f (W, m) of dry friction in one step.

    The velocity of each contact after the step is y = y0 - G f, with G (W, m, m) the
    ``coupling``; the law of friction is f = p tanh(y / w), with the largest impulse p
    (W, m) and the width w (m,). ``past`` (W, m) are the velocities before the step.
    Newton's method acts on x = y + g f, g = diag G: y and f are Lipschitz functions of x
    whatever the width. Where full steps cycle, quarter steps converge.
    """
    g = np.einsum("kii->ki", coupling)  # (W, m) diagonals
    x = np.where(np.abs(y0) > g * p, y0, past)
    scale = np.abs(y0).max(axis=1) + w.min()
    x = _newton(x, y0, coupling, p, w, scale, share=1.0)
    f = _friction(x, g, p, w)
    residual = x - g * f + np.einsum("kij,kj->ki", coupling, f) - y0
    unsolved = np.flatnonzero(np.abs(residual).max(axis=1) > _ARRIVED * scale)
    if len(unsolved):
        x[unsolved] = _newton(
            x[unsolved],
            y0[unsolved],
            coupling[unsolved],
            p[unsolved],
            w,
            scale[unsolved],
            share=0.25,
        )
        f = _friction(x, g, p, w)
    return np.clip(f, -p, p)


def _friction(x: Array, g: Array, p: Array, w: Array | float) -> Array:
    """Return the friction impulse f (W, m) of each contact from the unknown x = y + g f
    of Newton's method (:func:`_solve_friction_impulses`).

    The velocity y after the step solves y + g p tanh(y / w) = x; then f = (x - y) / g,
    with the velocity g (W, m) per unit impulse.
    """
    return (x - _resolvent(x, g * p, w)) / g


def _newton(
    x: Array, y0: Array, coupling: Array, p: Array, w: Array, scale: Array, share: float
) -> Array:
    """Iterate x (W, m) by Newton's method until y + G f = y0, taking the fraction
    ``share`` of each step.

    It stops where the largest residual of every simulation is below rounding, relative
    to ``scale`` (W,).
    """
    diagonal = range(len(w))
    g = np.einsum("kii->ki", coupling)  # (W, m) diagonals
    # Fractions of steps converge slowly: they may take many more iterations.
    for _ in range(round(_NEWTON_STEPS / share**3)):
        y = _resolvent(x, g * p, w)
        residual = y + np.einsum("kij,kj->ki", coupling, (x - y) / g) - y0
        if np.all(np.abs(residual).max(axis=1) <= _ARRIVED * scale):
            break
        # dy/dx = 1 / (1 + g p / (w cosh^2(y / w))); beyond 300 cosh would overflow.
        cosh = np.cosh(np.minimum(np.abs(y) / w, 300.0))
        dy_dx = 1.0 / (1.0 + g * p / (w * cosh**2))
        jacobian = coupling * ((1.0 - dy_dx) / g)[:, None, :]
        jacobian[:, diagonal, diagonal] += dy_dx + 1e-14  # never singular
        step = np.linalg.solve(jacobian, residual[:, :, None])[:, :, 0]
        x = x - share * step
    return x


def _resolvent(x: Array, c: Array, w: Array | float) -> Array:
    """Solve y + c tanh(y / w) = x for y, elementwise.

    For x > 0 the left side is concave in y, so Newton's method from below converges
    from below without overshoot. A fixed number of steps reaches rounding.
    """
    size = np.abs(x)
    steepest = c / w
    y = np.maximum(size - c, size / (1.0 + steepest))
    for _ in range(_RESOLVENT_STEPS):
        th = np.tanh(y / w)
        y = y + (size - y - c * th) / (1.0 + steepest * (1.0 - th * th))
    return np.copysign(y, x)
