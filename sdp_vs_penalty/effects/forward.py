"""A model run forward: from joint torques, or what drives are told, to motion.

    M(q) ddq = tau - b(q, dq) - f(q, dq, z, t),   dz/ds = law of the friction's internal
    states

M and b are the links' (Pinocchio), and f everything else that the model knows. Dry
friction turns round over velocities that a step of a millisecond passes many times
over: what it does within a step is solved for (Moreau's time stepping), and whatever
else grows with velocity or travel is linearised at the step's end (linearly implicit
midpoint rule), so that stiff friction is stable at any step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.effects.bristles import StatefulEffect
from sdp_vs_penalty.effects.effect import Array, CurrentModel, Effect, Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.motion import Command
from sdp_vs_penalty.errors import InputError

#: Change of velocity [rad/s, m/s] by which slopes of the force are taken, and the
#: damping of drives, whose laws are linear in it.
_SLOPE = 1e-6
_PUSH = 1e-3
#: Widths beyond which a contact slides to the last bit, Newton steps of a whole step
#: and of one contact.
_SLIDES = 20.0
_STEPS = 12
_INNER = 9
#: Miss of a step, relative to its velocities, that is rounding.
_ARRIVED = 1e-11


class State(NamedTuple):
    """W simulations at one instant: t (W,); q, dq, ddq (W, n), ddq of the last step; z
    (W, k); temperature (W, n) of the joints, NaN where it is not known, which stays as
    it is; sum (W, n) the integrals of q, NaN where nobody knows them."""

    t: Array
    q: Array
    dq: Array
    ddq: Array
    z: Array
    temperature: Array
    position_integral: Array

    def rows(self, which: slice | NDArray[np.intp]) -> State:
        return State(*(x[which] for x in self))


@dataclass(frozen=True)
class _Probe(Motion):
    """A motion whose dry friction is told its direction: signs (N, m) along the
    contacts."""

    contacts: Array | None = None
    signs: Array | None = None

    def sign(
        self,
        joint: int,
        width: float | None = None,
    ) -> Array:
        assert self.signs is not None
        return self.signs[:, joint]

    def sign_along(self, ratios: Array) -> Array:
        assert self.signs is not None
        assert self.contacts is not None
        same = np.all(self.contacts == ratios, axis=1)
        return self.signs[:, int(np.flatnonzero(same)[0])]


class Plant:
    """A model with parameters theta (W, p), one row a simulation, or (p,) for all of
    them.

    Raises InputError where a model has no rigid body.
    """

    def __init__(self, model: Model, theta: Array) -> None:
        self.model = model
        self.robot = model.robot
        self.theta = np.atleast_2d(np.asarray(theta, float))
        if not len(model.rigid_indices):
            raise InputError(
                "the model has no rigid_body effect", "without inertia nothing can move"
            )
        effects_and_indices = model.parts
        self.effects = [
            (e, k)
            for e, k in effects_and_indices
            if e.name != "rigid_body" and e.forward == "torque"
        ]
        self.channels = [
            (e, k) for e, k in effects_and_indices if e.forward == "channel"
        ]
        links = self.theta[:, model.rigid_indices]
        different, which = np.unique(links, axis=0, return_inverse=True)
        self._rigid, self._which = (
            [self.robot.mass_and_bias(row) for row in different],
            which.ravel(),
        )
        #: (m, n) directions along which there may be dry friction, (m,) over what
        #: widths it turns round.
        self.contacts, self.widths = self._contacts()
        self.bristles = [
            e.bristles for e, _ in self.effects if isinstance(e, StatefulEffect)
        ]
        self.states = sum(len(b.distances) for b in self.bristles)
        self._moves = [(e, k) for e, k in self.effects if self._feels_acceleration(e)]

    @property
    def left_out(self) -> tuple[str, ...]:
        """The written form of the effects that have no meaning here."""
        return tuple(e.text for e in self.model.effects if e.forward == "left out")

    def true_torque(self, t: Array, torque: Array) -> Array:
        """Recover the joints' torque from what the channels read.

        Parameters
        ----------
        t
            (N,) instants [s].
        torque
            (N, n) what the channels read [N m, N].

        Returns
        -------
        Array
            (N, n) torque by the first row of parameters [N m, N].
        """
        if self.model.gains is not None:
            torque = torque / np.array(self.model.gains)
        for effect, k in self.channels:
            torque = effect.invert_channel(self.theta[0, k], t, torque)
        return torque

    def remembered(self, motion: Motion) -> Array:
        """Follow the friction's states along a measured motion.

        Parameters
        ----------
        motion
            The motion at N instants.

        Returns
        -------
        Array
            (N, k) states.
        """
        motion = replace(motion, sign_width=self.model.sign_width)
        return np.hstack(
            [
                np.zeros((len(motion.t), 0)),
                *(b.along(motion) for b in self.bristles),
            ]
        )

    def advanced(self, z: Array, travel: Array) -> Array:
        """Advance the friction's states.

        Parameters
        ----------
        z
            (W, k) states.
        travel
            (W, n) displacements [rad, m].

        Returns
        -------
        Array
            (W, k) states after it.
        """
        parts = np.split(
            z,
            np.cumsum([len(b.distances) for b in self.bristles])[:-1],
            axis=1,
        )
        moved = [
            b.advanced(part, travel)
            for b, part in zip(self.bristles, parts, strict=False)
        ]
        return np.hstack(
            [
                np.zeros((len(z), 0)),
                *moved,
            ]
        )

    @property
    def can_move(self) -> bool:
        """Whether M(q) of the first row is positive definite, at poses all over the
        range."""
        first = self if len(self.theta) == 1 else Plant(self.model, self.theta[0])
        return bool(
            np.linalg.eigvalsh(
                first.mass(self.robot.random_configurations(20, 0))
            ).min()
            > 0.0
        )

    def mass(self, q: Array) -> Array:
        """Compute the mass matrices M(q).

        Parameters
        ----------
        q
            (W, n) configurations [rad, m].

        Returns
        -------
        Array
            (W, n, n) mass matrices [kg m^2, kg m, kg].
        """
        return self._mass_and_bias(q, np.zeros_like(q))[0]

    def terms(
        self,
        state: State,
        h: float,
    ) -> tuple[Array, Array, Array, Array]:
        """Compute what moves W simulations at the middle of a step.

        The step is taken as if motion went on as in the last one.

        Parameters
        ----------
        state
            States of W simulations.
        h
            Step [s].

        Returns
        -------
        tuple of Array
            M (W, n, n); force (W, n), which is b + f without dry friction; its slope (W, n)
            over the velocity; the dry forces (W, m) along the contacts.
        """
        dq = state.dq + 0.5 * h * state.ddq
        travel = 0.5 * h * (state.dq + 0.25 * h * state.ddq)
        mass, bias = self._mass_and_bias(state.q + travel, dq)
        delta = np.where(dq < 0.0, -_SLOPE, _SLOPE)
        n = self.robot.n
        m = len(self.contacts)
        # Probes: nothing dry, all joints' friction forwards, each other contact's, a
        # little faster.
        signs = np.zeros((3 + m - n, m))
        signs[1, :n] = 1.0
        signs[2:-1, n:] = np.eye(m - n)
        moves = [(travel, dq)] * (2 + m - n) + [(travel + 0.5 * h * delta, dq + delta)]
        force = self._forces(state, moves, signs, h)
        dry = force[1] - force[0]
        others = [
            np.sum((f - force[0]) * c, axis=1) / float(c @ c)
            for f, c in zip(force[2:-1], self.contacts[n:], strict=True)
        ]
        slope = (force[-1] - force[0]) / delta
        return mass, bias + force[0], slope, np.column_stack([dry, *others])

    def _forces(
        self,
        state: State,
        moves: Sequence[tuple[Array, Array]],
        signs: Array,
        h: float,
    ) -> Array:
        """(P, W, n) f with each of P displacements and velocities (W, n) and signs (P,
        m)."""
        count = len(moves)
        size = len(state.q)
        travel = np.concatenate([way for way, _ in moves])
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
        z = (
            self.advanced(np.tile(state.z, (count, 1)), travel)
            if self.states
            else state.z
        )
        theta = np.tile(self.theta, (count if len(self.theta) > 1 else 1, 1))
        return self._sum(self.effects, motion, z, theta).reshape(
            count,
            size,
            -1,
        )

    def _sum(
        self,
        effects: Sequence[tuple[Effect, NDArray[np.intp]]],
        motion: Motion,
        z: Array,
        theta: Array,
    ) -> Array:
        out = np.zeros_like(motion.q)
        used = 0
        for effect, indices in effects:
            if isinstance(effect, StatefulEffect):
                count = len(effect.bristles.distances)
                blocks = effect.blocks_at(motion, z[:, used : used + count])
                used += count
            else:
                blocks = effect.blocks(motion)
            for block in blocks:
                out[:, block.joint] += (
                    block.columns * theta[:, indices[block.parameters]]
                ).sum(axis=1)
        return out

    def _with_load(self, motion: _Probe, ddq: Array) -> _Probe:
        """With the torque that effects refer to, at the acceleration of the last step."""
        reference = self.model.reference
        assert reference is not None
        links = reference[self.model.rigid_indices].reshape(-1, 10)
        free = [
            (e, k) for e, k in self.effects if not (e.needs_torque or e.needs_links)
        ]
        plain = [(e, k) for e, k in free if not isinstance(e, StatefulEffect)]
        torque = self.robot.inverse_dynamics(
            links,
            motion.q,
            motion.dq,
            ddq,
        )
        torque += self._sum(
            plain,
            motion,
            np.zeros((len(motion.t), 0)),
            reference[None],
        )
        return replace(
            motion,
            ddq=ddq,
            torque=torque,
            current=CurrentModel(self.robot, links),
        )

    def _mass_and_bias(
        self,
        q: Array,
        dq: Array,
    ) -> tuple[Array, Array]:
        if len(self._rigid) == 1:
            mass, bias = self._rigid[0](q, dq)
        else:
            mass = np.empty((*q.shape, q.shape[1]))
            bias = np.empty_like(q)
            for k, terms in enumerate(self._rigid):
                rows = self._which == k
                mass[rows], bias[rows] = terms(q[rows], dq[rows])
        if self._moves:
            mass = mass + self._added_mass(q, self.theta)
        return mass, bias

    def _added_mass(self, q: Array, theta: Array) -> Array:
        """(W, n, n) of the effects that feel an acceleration: rotors, a payload."""
        n = self.robot.n
        size = len(q)
        still = np.zeros((size * n, n))
        signs = np.zeros((size * n, len(self.contacts)))
        unit = np.tile(np.eye(n), (size, 1))
        theta = np.repeat(
            theta,
            n if len(theta) > 1 else 1,
            axis=0,
        )
        place = np.repeat(q, n, axis=0)
        none = np.zeros(size * n)
        rows = _Probe(
            none,
            place,
            still,
            unit,
            contacts=self.contacts,
            signs=signs,
        )
        z = np.zeros((size * n, self.states))
        moved = self._sum(self._moves, rows, z, theta)
        moved -= self._sum(
            self._moves,
            replace(rows, ddq=still),
            z,
            theta,
        )
        return moved.reshape(size, n, n)

    def _feels_acceleration(self, effect: Effect) -> bool:
        """Whether its torque changes with the acceleration itself, not through a
        reference."""
        if effect.needs_torque or effect.needs_links:
            return False
        n = self.robot.n
        q = np.full((1, n), 0.1)
        still = np.zeros((1, n))

        def columns(ddq: Array) -> list[Array]:
            motion = Motion(
                np.zeros(1),
                q,
                still,
                ddq,
                temperature=still,
            )
            return [b.columns for b in effect.blocks(motion)]

        before = columns(still)
        after = columns(np.ones((1, n)))
        return not all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))

    def _contacts(self) -> tuple[Array, Array]:
        """One a joint, and one for each combination of joints on which dry friction
        acts."""
        n = self.robot.n
        widths = list(self.model.sign_width)
        rows = list(np.eye(n))
        for effect, _ in self.effects:
            ratios = effect.contact
            if ratios is not None and not any(
                np.array_equal(ratios, row) for row in rows
            ):
                rows.append(ratios)
                widths.append(max(widths[j] for j in np.flatnonzero(ratios)))
        return np.array(rows), np.array(widths)


def advance(
    plant: Plant,
    state: State,
    torque: Array,
    h: float,
    damping: Array | None = None,
) -> State:
    """Take one step of all simulations; positions move with the mean velocity.

    Parameters
    ----------
    plant
        The robot with its effects.
    state
        States of W simulations.
    torque
        (W, n) torque at the middle of the step, if motion goes on as in the last one.
    h
        Step [s].
    damping
        (W, n, n) how the torque of a controller falls with the velocity there.

    Returns
    -------
    State
        The states after the step.
    """
    mass, force, slope, dry = plant.terms(state, h)
    predicted = state.dq + h * state.ddq
    slopes = slope[:, :, None] * np.eye(slope.shape[1])
    if damping is not None:
        slopes = slopes + damping
    matrix = mass + 0.5 * h * slopes
    # The force was taken at the velocity predicted for the middle, (dq + predicted) /
    # 2.
    push = h * (torque - force) + np.einsum("kij,kj->ki", matrix, predicted)
    push += np.einsum("kij,kj->ki", mass, state.dq - predicted)
    dq = dry_step(
        matrix,
        push,
        state.dq,
        h * dry,
        plant.contacts,
        plant.widths,
    )
    travel = 0.5 * h * (state.dq + dq)
    ddq = (dq - state.dq) / h
    z = plant.advanced(state.z, travel)
    path = state.position_integral + h * (state.q + 0.5 * travel)
    return State(
        state.t + h,
        state.q + travel,
        dq,
        ddq,
        z,
        state.temperature,
        path,
    )


class ServoLoop:
    """A model with servo effects and its parameters theta (p,): the plant, and what
    drives it."""

    def __init__(self, model: Model, theta: Array) -> None:
        self.drives = [(e, theta[k]) for e, k in model.parts if e.forward == "drive"]
        self.plant = Plant(model, theta)

    def drive(self, motion: Motion) -> Array:
        """Compute the torque of the drives.

        Parameters
        ----------
        motion
            The motion at N instants.

        Returns
        -------
        Array
            (N, n) torque [N m, N].
        """
        return -sum(
            (e.torque(indices, motion) for e, indices in self.drives),
            np.zeros_like(motion.q),
        )

    def start(
        self,
        command: Command,
        t: Array,
        q: Array,
        path: Array,
    ) -> State:
        """Make states that start with the velocity of the command.

        Parameters
        ----------
        command
            What the drives were told.
        t
            (W,) instants [s].
        q
            (W, n) positions [rad, m].
        path
            (W, n) integrals of the positions [rad s, m s].

        Returns
        -------
        State
            W states.
        """
        dq = command.velocity(t)
        zero = np.zeros_like(q)
        motion = Motion(
            t,
            q,
            dq,
            zero,
            command=command,
            position_integral=path,
        )
        z = (
            self.plant.remembered(motion)
            if self.plant.states
            else np.zeros((len(t), 0))
        )
        return State(
            t,
            q,
            dq,
            zero,
            z,
            np.full_like(q, np.nan),
            path,
        )

    def step(
        self,
        state: State,
        command: Command,
        h: float,
    ) -> State:
        """Take one step; stiffness and damping of the drives are implicit.

        Parameters
        ----------
        state
            States of W simulations.
        command
            What the drives were told.
        h
            Step [s].

        Returns
        -------
        State
            The states after the step.
        """
        half = 0.5 * h
        dq = state.dq + half * state.ddq
        q = state.q + half * state.dq + 0.5 * half * half * state.ddq
        path = state.position_integral + half * state.q
        middle = Motion(
            state.t + half,
            q,
            dq,
            state.ddq,
            command=command,
            position_integral=path,
        )
        torque = self.drive(middle)
        path = path + 0.5 * half * half * _PUSH
        faster = replace(
            middle,
            q=q + half * _PUSH,
            dq=dq + _PUSH,
            position_integral=path,
        )
        fall = (torque - self.drive(faster)) / _PUSH
        return advance(
            self.plant,
            state,
            torque,
            h,
            fall[:, :, None] * np.eye(q.shape[1]),
        )


# One step with dry friction, its sticking and sliding solved for, not stepped over.


def dry_step(
    matrix: Array,
    push: Array,
    before: Array,
    impulse: Array,
    c: Array,
    w: Array,
) -> Array:
    """Compute the velocities after a step with dry friction.

    A negative impulse (no friction) acts as the velocity before the step says.

    Parameters
    ----------
    matrix
        (W, n, n) K.
    push
        (W, n) impulse of all other forces [N m s].
    before
        (W, n) velocities before the step.
    impulse
        (W, m) p, the largest impulse of each contact.
    c
        (m, n) directions of the contacts.
    w
        (m,) widths of the contacts [rad/s, m/s].

    Returns
    -------
    Array
        (W, n) velocities after the step.
    """
    past = before @ c.T
    rejected = np.minimum(impulse, 0.0)
    push = push - (rejected * np.tanh(past / w)) @ c
    p = impulse - rejected
    right = np.concatenate(
        [push[:, :, None], np.broadcast_to(c.T, (len(push), *c.T.shape))], axis=2
    )
    solved = np.linalg.solve(matrix, right)
    free = solved[:, :, 0]
    response = solved[:, :, 1:]
    y0 = free @ c.T
    coupling = c @ response
    way = np.sign(past)
    friction = p * way
    y = y0 - np.einsum("kij,kj->ki", coupling, friction)
    open_rows = np.flatnonzero(np.any((y * way <= _SLIDES * w) & (p > 0.0), axis=1))
    if len(open_rows):
        friction[open_rows] = _solved(
            y0[open_rows],
            coupling[open_rows],
            p[open_rows],
            past[open_rows],
            w,
        )
    return free - np.einsum("kij,kj->ki", response, friction)


def _solved(
    y0: Array,
    coupling: Array,
    p: Array,
    past: Array,
    w: Array,
) -> Array:
    """(W, m) friction impulses f with y = y0 - G f, f = p tanh(y / w).

    Newton on x = y + g f, g = diag G: y and f are both Lipschitz functions of x,
    whatever w. Where that has not arrived after some steps it goes in circles, which
    half steps leave.
    """
    g = np.einsum("kii->ki", coupling)
    x = np.where(
        np.abs(y0) > g * p,
        y0,
        past,
    )
    scale = np.abs(y0).max(axis=1) + w.min()
    x = _newton(x, y0, coupling, p, w, scale, 1.0)
    miss = (
        x - g * (f := _friction(x, g, p, w)) + np.einsum("kij,kj->ki", coupling, f) - y0
    )
    unsolved = np.flatnonzero(np.abs(miss).max(axis=1) > _ARRIVED * scale)
    if len(unsolved):
        x[unsolved] = _newton(
            x[unsolved],
            y0[unsolved],
            coupling[unsolved],
            p[unsolved],
            w,
            scale[unsolved],
            0.25,
        )
        f = _friction(x, g, p, w)
    return np.clip(f, -p, p)


def _friction(
    x: Array,
    g: Array,
    p: Array,
    w: Array | float,
) -> Array:
    return (x - _resolvent(x, g * p, w)) / g


def _newton(
    x: Array,
    y0: Array,
    coupling: Array,
    p: Array,
    w: Array,
    scale: Array,
    share: float,
) -> Array:
    """(W, m) x after Newton's steps, of which this share is taken."""
    m = len(w)
    g = np.einsum("kii->ki", coupling)
    for _ in range(round(_STEPS / share**3)):
        y = _resolvent(x, g * p, w)
        miss = y + np.einsum("kij,kj->ki", coupling, (x - y) / g) - y0
        if np.all(np.abs(miss).max(axis=1) <= _ARRIVED * scale):
            break
        # dy/dx
        rate = 1.0 / (
            1.0 + g * p / (w * np.cosh(np.minimum(np.abs(y) / w, 300.0)) ** 2)
        )
        jacobian = coupling * ((1.0 - rate) / g)[:, None, :]
        jacobian[:, range(m), range(m)] += rate + 1e-14
        x = x - share * np.linalg.solve(jacobian, miss[:, :, None])[:, :, 0]
    return x


def _resolvent(
    x: Array,
    c: Array,
    w: Array | float,
) -> Array:
    """y with y + c tanh(y / w) = x. Concave for x > 0, so that Newton from below
    arrives from below."""
    size = np.abs(x)
    steepest = c / w
    y = np.maximum(size - c, size / (1.0 + steepest))
    for _ in range(_INNER):
        th = np.tanh(y / w)
        y = y + (size - y - c * th) / (1.0 + steepest * (1.0 - th * th))
    return np.copysign(y, x)
