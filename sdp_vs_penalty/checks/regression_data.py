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
import scipy
from numpy.typing import NDArray

from sdp_vs_penalty.checks.constants import COULOMB_WIDTHS, ROWS, TRAVELS
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.bristles import dahl
from sdp_vs_penalty.effects.effect import JointEffect, Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import structure
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.constants import SLIDES
from sdp_vs_penalty.signals.filtered import joined
from sdp_vs_penalty.signals.kernels import Decimator
from sdp_vs_penalty.signals.preprocessing import Preprocessing, RunFilter, no_rows
from sdp_vs_penalty.signals.runs import Stretch, moving_joints, split_at_gaps


def _bristles(motion: Motion, travels: Sequence[float]) -> list[Array]:
    return [np.column_stack([dahl(q, d) for q in motion.q.T]) for d in travels]


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
    """At M instants of one log at which the arm moves.

    motion : (M, n) low-passed states; torque : (n,) low-passed channels, a spline over
    time; own_columns : (n, M, k) columns that each joint's own motion makes; laws : those of
    LAWS, as many; heard : (M, n) 1 where a joint slides, 0 where its torque is not
    asked; moving : (n,); shared : the effects whose columns joints share, independent :
    which of these say all that the others do, however the arm is mounted; largest :
    (n,) sizes that the channels reach; cutoff : of the low-pass [Hz].
    """

    shared: Model | None
    independent: tuple[int, ...]
    motion: Motion
    torque: scipy.interpolate.CubicSpline
    own_columns: Array
    laws: dict[str, Array]
    heard: Array
    moving: NDArray[np.bool_]
    largest: Array
    cutoff: float

    @property
    def count(self) -> int:
        return len(self.motion.t)

    def some(self, rows: slice) -> RegressionData:
        """The same at some of the instants."""
        motion = self.motion.part(rows)
        own_columns = self.own_columns[:, rows]
        laws = {name: x[:, rows] for name, x in self.laws.items()}
        return replace(
            self,
            motion=motion,
            own_columns=own_columns,
            laws=laws,
            heard=self.heard[rows],
        )

    def with_laws(self, torque: Array) -> RegressionData:
        """With LAWS, and friction that a torque (M, n) bears, among the own columns."""
        load = np.abs(torque)
        borne = [
            (load * np.tanh(self.motion.dq / width)).T for width in COULOMB_WIDTHS[:2]
        ]
        columns = [
            self.own_columns,
            np.stack(borne, axis=2),
            *self.laws.values(),
        ]
        return replace(self, own_columns=np.concatenate(columns, axis=2))

    @classmethod
    def together(cls, logs: Sequence[RegressionData]) -> RegressionData:
        """Rows of several logs, one after the other, as of one log.

        Parameters
        ----------
        logs : sequence of RegressionData
            Of one problem.

        Returns
        -------
        RegressionData
            With ROWS rows at most. Each log's clock begins a second after the end of the
            one before; each has a constant of its own, the zeros of its torques.
        """
        thinned = [log.some(slice(None, None, len(logs))) for log in logs]
        shifts = _shifts_one_after_the_other(thinned)
        moved = [log.later(shift) for log, shift in zip(thinned, shifts, strict=True)]
        own_columns = []
        for k, log in enumerate(moved):
            zeros = _zeros_of_runs(log, k, len(logs))
            own_columns.append(np.concatenate([log.own_columns, zeros], axis=2))
        laws = {}
        for name in logs[0].laws:
            laws[name] = np.concatenate([log.laws[name] for log in moved], axis=1)
        return replace(
            logs[0],
            motion=joined([log.motion for log in moved]),
            torque=_one_spline([log.torque for log in moved]),
            own_columns=np.concatenate(own_columns, axis=1),
            laws=laws,
            heard=np.concatenate([log.heard * log.moving for log in moved]),
            moving=np.any([log.moving for log in logs], axis=0),
            largest=np.max([log.largest for log in logs], axis=0),
            cutoff=min(log.cutoff for log in logs),
        )

    def later(self, seconds: float) -> RegressionData:
        """The same, so much later [s]."""
        torque = scipy.interpolate.CubicSpline(
            self.torque.x + seconds, self.torque(self.torque.x)
        )
        motion = replace(self.motion, t=self.motion.t + seconds)
        return replace(self, motion=motion, torque=torque)

    @classmethod
    def of(
        cls,
        problem: Problem,
        run: Measurements,
        settings: Preprocessing,
    ) -> RegressionData:
        """The rows of one run, filtered by ``settings``, which are resolved.

        Raises
        ------
        InputError
            For a log that is shorter than the filters need, or in which no joint both
            moves and has a torque that changes.
        """

        assert settings.torque_cutoff is not None
        # As much of the band as the rows can hold, each row independent of the next.
        band = ROWS / (2.0 * max(float(run.t[-1] - run.t[0]), 1e-9))
        cutoff = min(settings.torque_cutoff, band)
        filters = RunFilter(run, replace(settings, torque_cutoff=cutoff))
        frictions, shared = split(problem.model())
        pieces = []
        times = []
        torques = []
        for part, rows in _chosen_rows(run, filters):
            pieces.append(_piece(filters, part, rows, frictions))
            half = filters.column.half
            grid = np.arange(half, part.count - half, filters.stride)
            times.append(part.clock(grid))
            torques.append(filters.torque(part, grid))
        motion = joined([states for states, _ in pieces])
        # A joint moves if its channel is not dead.
        moving = moving_joints(run) & (np.ptp(run.tau, axis=0) > 0.0)
        speeds = np.sqrt(np.mean(motion.dq**2, axis=0))
        slides = np.abs(motion.dq) > SLIDES * speeds
        # Where all have stopped nothing is asked of any joint.
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
            torque=scipy.interpolate.CubicSpline(
                np.concatenate(times), np.concatenate(torques)
            ),
            own_columns=own_columns,
            laws=laws,
            heard=slides[rows].astype(float),
            moving=moving,
            largest=np.abs(run.tau).max(axis=0),
            cutoff=cutoff,
        )


def _one_spline(
    torques: Sequence[scipy.interpolate.CubicSpline],
) -> scipy.interpolate.CubicSpline:
    """One spline through the knots of several, which follow each other."""
    times = np.concatenate([torque.x for torque in torques])
    values = np.concatenate([torque(torque.x) for torque in torques])
    return scipy.interpolate.CubicSpline(times, values)


def _shifts_one_after_the_other(logs: Sequence[RegressionData]) -> list[float]:
    """By how much [s] the clock of each log is moved, to begin a second after the log
    before."""
    shifts = []
    begin = 0.0
    for log in logs:
        first = min(float(log.motion.t[0]), float(log.torque.x[0]))
        last = max(float(log.motion.t[-1]), float(log.torque.x[-1]))
        shifts.append(begin - first)
        begin += last - first + 1.0
    return shifts


def _zeros_of_runs(log: RegressionData, number: int, n_logs: int) -> Array:
    """(n, M, n_logs - 1) a column for each log but the first: one in this log's."""
    zeros = np.zeros((*log.own_columns.shape[:2], n_logs - 1))
    if number:
        zeros[:, :, number - 1] = 1.0
    return zeros


def _chosen_rows(
    run: Measurements, filters: RunFilter
) -> list[tuple[Stretch, NDArray[np.int64]]]:
    """Rows of each stretch without gaps in which the arm moves, ROWS in all, evenly
    spread. Raises InputError where the filters leave none."""
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


def _piece(
    filters: RunFilter,
    part: Stretch,
    at: NDArray[np.int64],
    frictions: Sequence[JointEffect],
) -> tuple[Motion, Array]:
    """States and own columns (n, M, k) at some rows of one stretch."""
    half = filters.coarse.half
    reach = filters.stride * half
    dense = filters.motion(
        part,
        at[0] - reach,
        at[-1] + reach,
    )
    # Off the column grid by at most half a step: both sides of the relation alike would
    # cost more.
    local = np.rint((at - at[0] + reach) / filters.stride).astype(np.int64)
    local = np.clip(
        local,
        half,
        len(dense.t) - 1 - half,
    )
    low_pass = Decimator(filters.coarse, local)
    columns = [(low_pass @ column).T for column in _own_columns(dense, frictions)]
    return dense.part(local), np.stack(columns, axis=2)


def _own_columns(motion: Motion, frictions: Sequence[JointEffect]) -> list[Array]:
    """(N, n) each: a rotor, an offset, what resists the motion, and LAWS at last."""
    columns = [
        motion.ddq,
        np.ones_like(motion.q),
        motion.dq,
    ]
    for effect in frictions:
        of_joints = [effect.column(motion, j) for j in effect.joints]
        columns.append(np.column_stack(of_joints))
    columns += [np.tanh(motion.dq / width) for width in COULOMB_WIDTHS]
    columns += _bristles(motion, TRAVELS["gear"])
    for law in LAWS.values():
        columns += law(motion)
    return columns


def _without_laws(columns: Array, motion: Motion) -> tuple[Array, dict[str, Array]]:
    """Own columns (n, M, k), and those of LAWS, which are the last of them."""
    laws: dict[str, Array] = {}
    for name, law in reversed(LAWS.items()):
        n_columns = len(law(motion))
        columns, laws[name] = np.split(
            columns,
            [-n_columns],
            axis=2,
        )
    return columns, laws


def split(model: Model) -> tuple[list[JointEffect], Model | None]:
    """Frictions of every joint by its own motion; the model without all that has one
    column on every joint, made by that joint's motion: the links, couplings."""
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
    """The same effects of another robot."""
    effects = [
        type(effect)(robot, effect.asked_joints, **effect.shape)
        for effect in model.effects
    ]
    return Model(robot, tuple(effects))


def _independent(shared: Model | None) -> tuple[int, ...]:
    """The columns that lead the base parameters under a gravity along none of the arm's
    axes."""
    if shared is None:
        return ()
    gravity = tuple(np.random.default_rng(0).normal(size=3).tolist())
    model = on_robot(shared, replace(shared.robot, gravity=gravity))
    n_rows = 2 * len(model.parameters) // shared.robot.n + 1
    q, dq, ddq = shared.robot.random_states
    motion = Motion(
        np.zeros(n_rows),
        q[:n_rows],
        dq[:n_rows],
        ddq[:n_rows],
    )
    return structure(np.concatenate(model.dense_columns(motion)))[1]
