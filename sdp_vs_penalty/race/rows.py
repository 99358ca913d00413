"""The rows of one log that hypotheses are judged on, and the columns of an arm's
torque.

Rows are filtered as an identification filters them. Columns are those that joints
share, and those of each joint's own motion: what friction, a rotor and an offset may
look like. Beside the model's they hold laws that the model may lack (sharper and
rounder Coulomb friction, bristles that bend before they slide, Dahl 1968): what they
explain is the model's matter, and no fault of the log.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.bristles import dahl
from sdp_vs_penalty.effects.effect import JointEffect, Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.race.constants import COULOMB_WIDTHS, ROWS, TRAVELS
from sdp_vs_penalty.regression.base_parameters import structure
from sdp_vs_penalty.robot.arrays import Array, Indices, Mask
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.filtered import joined
from sdp_vs_penalty.signals.kernels import Decimator
from sdp_vs_penalty.signals.preprocessing import Preprocessing, RunFilter, no_rows
from sdp_vs_penalty.signals.runs import Stretch, moving_joints, split_at_gaps
from sdp_vs_penalty.signals.splines import CubicSpline
from sdp_vs_penalty.signals.standstill import is_sliding

#: Places among a joint's own columns: of a rotor, the offset, which has no direction,
#: viscous friction, and dry friction of the middle width.
ROTOR, OFFSET, VISCOUS, DRY = 0, 1, 2, 4
#: Time between the end of a log and the next one's begin, put together as one log.
_SECONDS_BETWEEN_LOGS = 1.0


#: Which of the laws of :func:`_laws` change their sign where time runs backwards.
_LAWS_TURN = (False, True, False, *map(bool, TRAVELS["hysteresis"]))


def _bristles(motion: Motion, travels: Sequence[float]) -> list[Array]:
    """Return a column (N, n) of Dahl friction, of unit size, for each travel [rad or m]
    over which the bristles bend before they slide."""
    columns = []
    for travel in travels:
        of_joints = [dahl(q, travel) for q in motion.q.T]
        columns.append(np.column_stack(of_joints))
    return columns


def _laws(motion: Motion) -> list[Array]:
    """List the columns (N, n) of laws that arms have and models often lack: a spring,
    drag, friction that differs by direction, hysteresis. What they explain, of any size,
    is no fault of the log."""
    speed = np.abs(motion.dq)
    laws = [motion.q, motion.dq * speed, speed]
    return laws + _bristles(motion, TRAVELS["hysteresis"])


@dataclass(frozen=True)
class RegressionData:
    """M rows of one log at which the arm moves, of n joints, low-passed."""

    #: Effects whose columns joints share (links, couplings); None without any.
    shared: Model | None
    #: (s, p) coefficients by which s of their columns make all p, however the arm is
    #: mounted.
    dependence: Array
    #: Indices of these s columns.
    independent: tuple[int, ...]
    #: States (M, n) at the rows.
    motion: Motion
    #: The n torque channels as splines over time.
    torque: CubicSpline
    #: (n, M, k) columns that a joint's own motion makes (friction, rotor, offset).
    own_columns: Array
    #: (n, M, r) columns of laws that the model may lack.
    laws: Array
    #: (M, n) 1 where a joint slides, 0 where its torque is not used.
    torque_mask: Array
    #: (n,) whether a joint moves.
    moving: Mask
    #: (n,) largest absolute value of each raw channel.
    largest: Array
    #: Cut-off frequency of the low-pass [Hz].
    cutoff: float
    #: Time from the log's first row to its last, of which the filters cut both ends
    #: [s].
    seconds: float
    #: (M,) number of each row's run, from 0.
    run: Indices
    #: By how much the clock of each run is put forward here [s].
    clock_shifts: tuple[float, ...] = (0.0,)
    #: Of each run the sign of the logged velocity over the positions' derivative; 0 where
    #: none was logged.
    velocity_signs: tuple[float, ...] = (0.0,)
    #: (k,) which own columns change their sign where time runs backwards.
    turns: tuple[bool, ...] = ()

    @property
    def count(self) -> int:
        """Number M of rows."""
        return len(self.motion.t)

    @cached_property
    def digest(self) -> bytes:
        """A SHA-256 hash of all rows and channels: equal data of one robot have equal
        hashes."""
        motion, torque = self.motion, self.torque
        states = motion.t, motion.q, motion.dq, motion.ddq
        columns = self.own_columns, self.laws, self.torque_mask
        channels = torque.x, torque.values, self.moving, self.largest
        numbers = np.array([self.cutoff, self.seconds, *self.velocity_signs])
        digest = hashlib.sha256()
        for array in (*states, *columns, *channels, self.run, numbers):
            digest.update(array.tobytes())
        return digest.digest()

    def select_rows(self, rows: slice | Indices) -> RegressionData:
        """Return the data of some of the rows."""
        return replace(
            self,
            motion=self.motion.part(rows),
            own_columns=self.own_columns[:, rows],
            laws=self.laws[:, rows],
            torque_mask=self.torque_mask[rows],
            run=self.run[rows],
        )

    def with_laws(self, torque: Array) -> RegressionData:
        """Return the data with more own columns: laws, and Coulomb friction that is
        proportional to the size of a torque (M, n) that loads the joints [N m or N]."""
        load = np.abs(torque)
        sharp_widths = COULOMB_WIDTHS[:2]
        load_friction = [
            (load * np.tanh(self.motion.dq / width)).T for width in sharp_widths
        ]
        columns = [self.own_columns, np.stack(load_friction, axis=2), self.laws]
        turns = (*self.turns, *map(bool, sharp_widths), *_LAWS_TURN)
        return replace(self, own_columns=np.concatenate(columns, axis=2), turns=turns)

    @classmethod
    def concatenate(cls, logs: Sequence[RegressionData]) -> RegressionData:
        """Join the rows of several logs, one after the other, as rows of one log.

        Parameters
        ----------
        logs : sequence of RegressionData
            Of one robot and one logger.

        Returns
        -------
        RegressionData
            Of L logs every L-th row, so that it has about as many rows as one log. Each
            log's clock begins a second after the end of the log before, and each log
            has a torque offset of its own: one more column for all but the first.
        """
        parts: list[RegressionData] = []
        shifts: list[float] = []
        begin = 0.0
        for number, of_log in enumerate(logs):
            log = of_log.select_rows(slice(None, None, len(logs)))
            t, knots = log.motion.t, log.torque.x
            first, last = min(t[0], knots[0]), max(t[-1], knots[-1])
            shifts.append(begin - float(first))
            begin += float(last - first) + _SECONDS_BETWEEN_LOGS
            # Column number - 1 is 1 on this log's rows; the first log has the common one.
            offsets = np.zeros((*log.own_columns.shape[:2], len(logs) - 1))
            offsets[:, :, max(number - 1, 0) : number] = 1.0
            moved = replace(
                log,
                motion=replace(log.motion, t=t + shifts[-1]),
                own_columns=np.concatenate([log.own_columns, offsets], axis=2),
                torque_mask=log.torque_mask * log.moving,
                run=np.full(log.count, number),
            )
            parts.append(moved)
        clocks = [x.torque.x + shift for x, shift in zip(logs, shifts, strict=True)]
        torques = [x.torque.values for x in logs]
        return replace(
            logs[0],
            motion=joined([x.motion for x in parts]),
            torque=CubicSpline(np.concatenate(clocks), np.concatenate(torques)),
            own_columns=np.concatenate([x.own_columns for x in parts], axis=1),
            laws=np.concatenate([x.laws for x in parts], axis=1),
            torque_mask=np.concatenate([x.torque_mask for x in parts]),
            moving=np.any([x.moving for x in logs], axis=0),
            largest=np.max([x.largest for x in logs], axis=0),
            cutoff=min(x.cutoff for x in logs),
            seconds=sum(x.seconds for x in logs),
            run=np.concatenate([x.run for x in parts]),
            clock_shifts=tuple(shifts),
            velocity_signs=tuple(x.velocity_signs[0] for x in logs),
            turns=(*logs[0].turns, *(len(logs) - 1) * (False,)),
        )

    @classmethod
    def from_run(
        cls, problem: Problem, run: Measurements, settings: Preprocessing
    ) -> RegressionData:
        """Choose the rows of one run and filter them as an identification does.

        Parameters
        ----------
        problem : Problem
            Of the robot that was logged.
        settings : Preprocessing
            Filters, resolved: their cutoff frequencies are numbers.

        Returns
        -------
        RegressionData
            With ROWS rows at most.

        Raises
        ------
        InputError
            For a log that is shorter than the filters need, or in which no joint both
            moves and has a torque that changes.
        """

        assert settings.torque_cutoff is not None
        # Rows are independent of each other up to half their rate (Nyquist).
        seconds = max(run.seconds, 1e-9)
        half_rate_of_rows = ROWS / (2.0 * seconds)  # [Hz]
        cutoff = min(settings.torque_cutoff, half_rate_of_rows)
        filters = RunFilter(run, replace(settings, torque_cutoff=cutoff))
        frictions, shared = split(problem.model())
        pieces = []
        times = []
        torques = []
        for part, rows in _chosen_rows(run, filters):
            pieces.append(_filter_stretch(filters, part, rows, frictions))
            half = filters.column.half
            grid = np.arange(half, part.count - half, filters.stride)
            times.append(part.clock(grid))
            torques.append(filters.torque(part, grid))
        states, own_columns, laws = zip(*pieces, strict=True)
        motion = joined(states)
        # A joint whose torque channel is dead counts as one that does not move.
        moving = moving_joints(run) & (np.ptp(run.tau, axis=0) > 0.0)
        slides = is_sliding(motion.dq)
        # Rows at which no joint slides say nothing.
        rows = np.flatnonzero(np.any(slides[:, moving], axis=1))
        if not len(rows):
            what = "no joint both moves and has a torque that changes"
            raise InputError(what, "record such a run", run.names[0])
        dependence, independent = base_columns(shared)
        own_of_rows = np.concatenate(own_columns, axis=1)[:, rows]
        return cls(
            shared=shared,
            dependence=dependence,
            independent=independent,
            motion=motion.part(rows),
            torque=CubicSpline(np.concatenate(times), np.concatenate(torques)),
            own_columns=own_of_rows,
            laws=np.concatenate(laws, axis=1)[:, rows],
            torque_mask=slides[rows].astype(float),
            moving=moving,
            largest=np.abs(run.tau).max(axis=0),
            cutoff=cutoff,
            seconds=seconds,
            run=np.zeros(len(rows), np.intp),
            velocity_signs=(_velocity_sign(run),),
            # All but the rotor's inertia and the offset, which come first.
            turns=(False, False, *(own_of_rows.shape[2] - 2) * (True,)),
        )


def _velocity_sign(run: Measurements) -> float:
    """Return the sign of the logged velocity over the positions' derivative; 0 where
    none was logged."""
    if run.dq is None:
        return 0.0
    return float(np.sign(np.sum(run.dq[1:] * np.diff(run.q, axis=0))))


def _chosen_rows(
    run: Measurements, filters: RunFilter
) -> list[tuple[Stretch, NDArray[np.int64]]]:
    """List the stretches without gaps, and of each the numbers of rows at which the arm
    moves: ROWS rows in all, evenly spread.

    Raises InputError where the filters leave no row: near the ends of a stretch they
    need a margin.
    """
    margin = filters.state.half + filters.column.half
    places = []
    for part in split_at_gaps(run):
        rows = np.arange(margin, part.count - margin)
        places.append((part, rows[filters.movement.at(part.clock(rows))]))
    n_rows = sum(len(rows) for _, rows in places)
    if n_rows == 0:
        raise no_rows(run, 2 * margin * filters.dt)
    rows_by_stretch = []
    for part, rows in places:
        count = min(round(ROWS * len(rows) / n_rows), len(rows))
        if count:
            spread = np.linspace(0, len(rows) - 1, count).astype(int)
            rows_by_stretch.append((part, rows[spread]))
    return rows_by_stretch


def _filter_stretch(
    filters: RunFilter,
    part: Stretch,
    at: NDArray[np.int64],
    frictions: Sequence[JointEffect],
) -> tuple[Motion, Array, Array]:
    """Return the low-passed states, own columns (n, M, k) and columns of laws (n, M, r)
    of a stretch without gaps, at its rows ``at`` (M,).

    Columns are made of the motion at every ``stride``-th row, and then low-passed as
    the torque is.
    """
    half = filters.coarse.half
    margin = filters.stride * half
    dense = filters.motion(part, at[0] - margin, at[-1] + margin)
    # Rows of the dense grid nearest to ``at``: off by at most half a step, which motion
    # and columns share.
    local = np.rint((at - at[0] + margin) / filters.stride).astype(np.int64)
    local = np.clip(local, half, len(dense.t) - 1 - half)
    low_pass = Decimator(filters.coarse, local)
    own, laws = (
        np.stack([(low_pass @ column).T for column in columns], axis=2)
        for columns in (_own_columns(dense, frictions), _laws(dense))
    )
    # The links' columns are made of the states at the rows, which pass it as well.
    q, dq, ddq = (low_pass @ x for x in (dense.q, dense.dq, dense.ddq))
    return replace(dense.part(local), q=q, dq=dq, ddq=ddq), own, laws


def _own_columns(motion: Motion, frictions: Sequence[JointEffect]) -> list[Array]:
    """List the columns (N, n) that each joint's own motion makes, for parameters of
    that joint alone: a rotor's inertia, a torque offset, viscous friction, Coulomb
    friction of several widths, the model's frictions, gear bristles."""
    columns = [motion.ddq, np.ones_like(motion.q), motion.dq]
    columns += [np.tanh(motion.dq / width) for width in COULOMB_WIDTHS]
    for effect in frictions:
        of_joints = [effect.column(motion, j) for j in effect.joints]
        columns.append(np.column_stack(of_joints))
    return columns + _bristles(motion, TRAVELS["gear"])


def split(model: Model) -> tuple[list[JointEffect], Model | None]:
    """Split a model into frictions of single joints and what joints share.

    Returns
    -------
    list of JointEffect
        Frictions that act on every joint by its own motion.
    Model or None
        The links and couplings: the model without effects that every joint has by its
        own motion; None where nothing remains.
    """
    all_joints = list(range(model.robot.n))
    of_joints = [
        effect
        for effect in model.effects
        if isinstance(effect, JointEffect) and list(effect.joints) == all_joints
    ]
    shared = tuple(effect for effect in model.effects if effect not in of_joints)
    frictions = [effect for effect in of_joints if "friction" in effect.name]
    return frictions, Model(model.robot, shared) if shared else None


def on_robot(model: Model, robot: Robot) -> Model:
    """Return a model with the same effects of another robot.

    Returns
    -------
    Model
        With effects of the same shapes and joints.
    """
    effects = [
        type(effect)(robot, effect.asked_joints, **effect.shape)
        for effect in model.effects
    ]
    return Model(robot, tuple(effects))


def base_columns(shared: Model | None) -> tuple[Array, tuple[int, ...]]:
    """Return how s columns of the shared effects make all p, (s, p), and their numbers:
    one for each base parameter.

    They are those for random states under a random direction of gravity, and span the
    columns however the arm is mounted.
    """
    if shared is None:
        return np.zeros((0, 0)), ()
    gravity = tuple(np.random.default_rng(0).normal(size=3).tolist())
    model = on_robot(shared, replace(shared.robot, gravity=gravity))
    n_rows = 2 * len(model.parameters) // shared.robot.n + 1
    q, dq, ddq = shared.robot.random_states
    motion = Motion(np.zeros(n_rows), q[:n_rows], dq[:n_rows], ddq[:n_rows])
    return structure(np.concatenate(model.dense_columns(motion)))
