"""The rows of one log that hypotheses are judged on, and the columns of an arm's
torque.

Rows are filtered as an identification filters them. Columns are those that joints
share, and those of each joint's own motion: what friction, a rotor and an offset may
look like. Beside the model's they hold laws that the model may lack (sharper and
rounder Coulomb friction, bristles that bend before they slide, Dahl 1968): what they
explain is the model's matter, and no fault of the log.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

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
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.filtered import joined
from sdp_vs_penalty.signals.kernels import Decimator
from sdp_vs_penalty.signals.preprocessing import Preprocessing, RunFilter, no_rows
from sdp_vs_penalty.signals.runs import Stretch, moving_joints, split_at_gaps
from sdp_vs_penalty.signals.splines import CubicSpline
from sdp_vs_penalty.signals.standstill import is_sliding

#: Time between the end of a log and the next one's begin, put together as one log.
_SECONDS_BETWEEN_LOGS = 1.0


def _bristles(motion: Motion, travels: Sequence[float]) -> list[Array]:
    """Return a column (N, n) of Dahl friction, of unit size, for each travel [rad or m]
    over which the bristles bend before they slide."""
    columns = []
    for travel in travels:
        of_joints = [dahl(q, travel) for q in motion.q.T]
        columns.append(np.column_stack(of_joints))
    return columns


#: Laws of a joint that arms have and models lack, (N, n) columns by its motion: as
#: strong as they may be, they are no fault of the log.
LAWS: dict[str, Callable[[Motion], list[Array]]] = {
    "a spring": lambda m: [m.q],
    "drag": lambda m: [m.dq * np.abs(m.dq)],
    "friction that differs by direction": lambda m: [np.abs(m.dq)],
    "hysteresis": lambda m: _bristles(m, TRAVELS["hysteresis"]),
}


@dataclass(frozen=True)
class RegressionData:
    """M rows of one log at which the arm moves, of n joints, low-passed."""

    #: Effects whose columns joints share (links, couplings); None without any.
    shared: Model | None
    #: Indices of their columns that span all of them, however the arm is mounted.
    independent: tuple[int, ...]
    #: States (M, n) at the rows.
    motion: Motion
    #: The n torque channels as splines over time.
    torque: CubicSpline
    #: (n, M, k) columns that a joint's own motion makes (friction, rotor, offset).
    own_columns: Array
    #: Columns (n, M, r) of LAWS, by name.
    laws: dict[str, Array]
    #: (M, n) 1 where a joint slides, 0 where its torque is not used.
    torque_mask: Array
    #: (n,) whether a joint moves.
    moving: NDArray[np.bool_]
    #: (n,) largest absolute value of each raw channel.
    largest: Array
    #: Cut-off frequency of the low-pass [Hz].
    cutoff: float
    #: Time from the log's first row to its last, of which the filters cut both ends
    #: [s].
    seconds: float
    #: Logged velocity over the positions' derivative [-]; NaN where none was logged.
    velocity_gain: float = np.nan

    @property
    def count(self) -> int:
        """Number M of rows."""
        return len(self.motion.t)

    def select_rows(self, rows: slice) -> RegressionData:
        """Return the data of a slice of the rows."""
        laws = {name: columns[:, rows] for name, columns in self.laws.items()}
        return replace(
            self,
            motion=self.motion.part(rows),
            own_columns=self.own_columns[:, rows],
            laws=laws,
            torque_mask=self.torque_mask[rows],
        )

    def with_laws(self, torque: Array) -> RegressionData:
        """Return the data with more own columns: LAWS, Coulomb friction that is
        proportional to the size of a torque (M, n) that loads the joints [N m or N], and
        the acceleration before the torque's low-pass: what the filters differ by."""
        load = np.abs(torque)
        sharp_widths = COULOMB_WIDTHS[:2]
        load_friction = [
            (load * np.tanh(self.motion.dq / width)).T for width in sharp_widths
        ]
        columns = [
            self.own_columns,
            np.stack(load_friction, axis=2),
            self.motion.ddq.T[:, :, None],
            *self.laws.values(),
        ]
        return replace(self, own_columns=np.concatenate(columns, axis=2))

    @classmethod
    def concatenate(cls, logs: Sequence[RegressionData]) -> RegressionData:
        """Put the rows of several logs one after the other, as rows of one log.

        Parameters
        ----------
        logs : sequence of RegressionData
            Of one robot and one logger.

        Returns
        -------
        RegressionData
            With about as many rows as one log: of L logs every L-th row. Each log's
            clock begins a second after the end of the log before. Each log has an
            offset of its torques of its own, as further own columns.
        """
        n_logs = len(logs)
        thinned = _thinned(logs)
        shifts = _seconds_to_follow_each_other(thinned)
        moved = [
            log.with_later_clock(shift)
            for log, shift in zip(thinned, shifts, strict=True)
        ]
        own_columns = []
        for number, log in enumerate(moved):
            offsets = _offset_columns(log, number, n_logs)
            own_columns.append(np.concatenate([log.own_columns, offsets], axis=2))
        laws = {}
        for name in logs[0].laws:
            laws[name] = np.concatenate([log.laws[name] for log in moved], axis=1)
        return replace(
            logs[0],
            motion=joined([log.motion for log in moved]),
            torque=_one_spline([log.torque for log in moved]),
            own_columns=np.concatenate(own_columns, axis=1),
            laws=laws,
            torque_mask=np.concatenate([log.torque_mask * log.moving for log in moved]),
            moving=np.any([log.moving for log in logs], axis=0),
            largest=np.max([log.largest for log in logs], axis=0),
            cutoff=min(log.cutoff for log in logs),
            seconds=sum(log.seconds for log in logs),
        )

    @staticmethod
    def clock_shifts(logs: Sequence[RegressionData]) -> list[float]:
        """List the time [s] by which :meth:`concatenate` puts each log's clock forward;
        0 for a log alone.

        Parameters
        ----------
        logs : sequence of RegressionData
            Of one robot and one logger.
        """
        if len(logs) < 2:
            return [0.0] * len(logs)
        return _seconds_to_follow_each_other(_thinned(logs))

    def with_later_clock(self, seconds: float) -> RegressionData:
        """Return the data with the clock of motion and torque put forward by
        ``seconds`` [s]."""
        torque = CubicSpline(self.torque.x + seconds, self.torque(self.torque.x))
        motion = replace(self.motion, t=self.motion.t + seconds)
        return replace(self, motion=motion, torque=torque)

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
        motion = joined([states for states, _ in pieces])
        # A joint whose torque channel is dead counts as one that does not move.
        moving = moving_joints(run) & (np.ptp(run.tau, axis=0) > 0.0)
        slides = is_sliding(motion.dq)
        # Rows at which no joint slides say nothing.
        rows = np.flatnonzero(np.any(slides[:, moving], axis=1))
        if not len(rows):
            what = "no joint both moves and has a torque that changes"
            raise InputError(what, "record such a run", run.names[0])
        motion = motion.part(rows)
        columns = np.concatenate(
            [columns_of_piece for _, columns_of_piece in pieces], axis=1
        )[:, rows]
        own_columns, laws = _without_laws(columns, motion)
        return cls(
            shared=shared,
            independent=_independent(shared),
            motion=motion,
            torque=CubicSpline(np.concatenate(times), np.concatenate(torques)),
            own_columns=own_columns,
            laws=laws,
            torque_mask=slides[rows].astype(float),
            moving=moving,
            largest=np.abs(run.tau).max(axis=0),
            cutoff=cutoff,
            seconds=seconds,
            velocity_gain=_velocity_gain(run),
        )


def _velocity_gain(run: Measurements) -> float:
    """Return the factor from the positions' derivative to the logged velocity, by least
    squares; NaN where none was logged."""
    if run.dq is None:
        return np.nan
    slope = np.gradient(run.q, axis=0) / np.gradient(run.t)[:, None]
    energy = float(np.sum(slope**2))
    return float(np.sum(run.dq * slope)) / energy if energy > 0.0 else np.nan


def _one_spline(torques: Sequence[CubicSpline]) -> CubicSpline:
    """Return one spline through the knots of several splines, whose times follow each
    other."""
    times = np.concatenate([torque.x for torque in torques])
    values = np.concatenate([torque(torque.x) for torque in torques])
    return CubicSpline(times, values)


def _thinned(logs: Sequence[RegressionData]) -> list[RegressionData]:
    """Return every L-th row of each of L logs."""
    return [log.select_rows(slice(None, None, len(logs))) for log in logs]


def _seconds_to_follow_each_other(logs: Sequence[RegressionData]) -> list[float]:
    """List the time [s] to add to the clock of each log, so that it begins a second
    after the end of the log before; the first begins at 0."""
    shifts = []
    begin = 0.0
    for log in logs:
        first = min(float(log.motion.t[0]), float(log.torque.x[0]))
        last = max(float(log.motion.t[-1]), float(log.torque.x[-1]))
        shifts.append(begin - first)
        begin += last - first + _SECONDS_BETWEEN_LOGS
    return shifts


def _offset_columns(log: RegressionData, number: int, n_logs: int) -> Array:
    """Return the columns (n, M, n_logs - 1) of the torque offsets of all logs but the
    first, at the rows of log ``number``: 1 in its own column, 0 in the others.

    The offset of the first log is an own column of every log.
    """
    columns = np.zeros((*log.own_columns.shape[:2], n_logs - 1))
    if number > 0:
        columns[:, :, number - 1] = 1.0
    return columns


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
    chosen = []
    for part, rows in places:
        count = min(round(ROWS * len(rows) / n_rows), len(rows))
        if count:
            spread = np.linspace(0, len(rows) - 1, count).astype(int)
            chosen.append((part, rows[spread]))
    return chosen


def _filter_stretch(
    filters: RunFilter,
    part: Stretch,
    at: NDArray[np.int64],
    frictions: Sequence[JointEffect],
) -> tuple[Motion, Array]:
    """Return the low-passed states and own columns (n, M, k) of a stretch without gaps,
    at its rows ``at`` (M,).

    Columns are made of the motion at every ``stride``-th row, and then low-passed as
    the torque is.
    """
    half = filters.coarse.half
    reach = filters.stride * half
    dense = filters.motion(part, at[0] - reach, at[-1] + reach)
    # Rows of the dense grid nearest to ``at``: off by at most half a step, which motion
    # and columns share.
    local = np.rint((at - at[0] + reach) / filters.stride).astype(np.int64)
    local = np.clip(local, half, len(dense.t) - 1 - half)
    low_pass = Decimator(filters.coarse, local)
    columns = [(low_pass @ column).T for column in _own_columns(dense, frictions)]
    return dense.part(local), np.stack(columns, axis=2)


def _own_columns(motion: Motion, frictions: Sequence[JointEffect]) -> list[Array]:
    """List the columns (N, n) that each joint's own motion makes, for parameters of
    that joint alone: a rotor's inertia, a torque offset, viscous friction, the model's
    frictions, Coulomb friction of several widths, gear bristles; LAWS come last."""
    columns = [motion.ddq, np.ones_like(motion.q), motion.dq]
    for effect in frictions:
        of_joints = [effect.column(motion, j) for j in effect.joints]
        columns.append(np.column_stack(of_joints))
    columns += [np.tanh(motion.dq / width) for width in COULOMB_WIDTHS]
    columns += _bristles(motion, TRAVELS["gear"])
    for law in LAWS.values():
        columns += law(motion)
    return columns


def _without_laws(columns: Array, motion: Motion) -> tuple[Array, dict[str, Array]]:
    """Split own columns (n, M, k) into those without LAWS and, by name, those of LAWS,
    which come last."""
    laws: dict[str, Array] = {}
    two_rows = motion.part(slice(0, 2))  # enough to count a law's columns
    for name, law in reversed(LAWS.items()):
        n_columns = len(law(two_rows))
        laws[name] = columns[:, :, -n_columns:]
        columns = columns[:, :, :-n_columns]
    return columns, laws


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


def random_rows(shared: Model) -> Array:
    """Return the columns (N, p) of the shared effects for random states under a random
    direction of gravity: they span the columns however the arm is mounted."""
    gravity = tuple(np.random.default_rng(0).normal(size=3).tolist())
    model = on_robot(shared, replace(shared.robot, gravity=gravity))
    n_rows = 2 * len(model.parameters) // shared.robot.n + 1
    q, dq, ddq = shared.robot.random_states
    motion = Motion(np.zeros(n_rows), q[:n_rows], dq[:n_rows], ddq[:n_rows])
    return np.concatenate(model.dense_columns(motion))


def _independent(shared: Model | None) -> tuple[int, ...]:
    """Return the numbers of s columns of the shared effects that span all of them: one
    for each base parameter."""
    return () if shared is None else structure(random_rows(shared))[1]
