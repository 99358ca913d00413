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
from typing import TYPE_CHECKING

import numpy as np
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

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline


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
    torque: CubicSpline
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
        dq = self.motion.dq
        borne = [load * np.tanh(dq / w) for w in COULOMB_WIDTHS[:2]]
        columns = [np.stack([x.T for x in borne], axis=2), *self.laws.values()]
        return replace(
            self, own_columns=np.concatenate([self.own_columns, *columns], axis=2)
        )

    @classmethod
    def together(cls, logs: Sequence[RegressionData]) -> RegressionData:
        """The rows of several logs, one after the other, ROWS at most; each log
        has a constant of its own (the zeros of its torques)."""
        from scipy.interpolate import CubicSpline

        thin = len(logs)
        parts = []
        begin = 0.0
        times = []
        torques = []
        owns = []
        for k, log in enumerate(logs):
            some = log.some(slice(None, None, thin))
            shift = begin - min(float(some.motion.t[0]), float(log.torque.x[0]))
            motion = some.motion
            parts.append((some, replace(motion, t=motion.t + shift)))
            times.append(log.torque.x + shift)
            torques.append(log.torque(log.torque.x))
            begin = max(float(times[-1][-1]), float(motion.t[-1] + shift)) + 1.0
            zeros = np.zeros((*some.own_columns.shape[:2], len(logs) - 1))
            zeros[:, :, k - 1 : k] = 1.0 if k else 0.0
            owns.append(np.concatenate([some.own_columns, zeros], axis=2))
        first = logs[0]
        laws = {
            name: np.concatenate([some.laws[name] for some, _ in parts], axis=1)
            for name in first.laws
        }
        heard = [some.heard * some.moving for some, _ in parts]
        spline = CubicSpline(np.concatenate(times), np.concatenate(torques))
        return replace(
            first,
            motion=joined([motion for _, motion in parts]),
            torque=spline,
            own_columns=np.concatenate(owns, axis=1),
            laws=laws,
            heard=np.concatenate(heard),
            moving=np.any([log.moving for log in logs], axis=0),
            largest=np.max([log.largest for log in logs], axis=0),
            cutoff=min(log.cutoff for log in logs),
        )

    @classmethod
    def of(
        cls, problem: Problem, run: Measurements, settings: Preprocessing
    ) -> RegressionData:
        """``settings`` resolved. Raises InputError for a log that is shorter than the
        filters need."""
        from scipy.interpolate import CubicSpline

        assert settings.torque_cutoff is not None
        # As much of the band as the rows can hold, each row independent of the next.
        band = ROWS / (2.0 * max(float(run.t[-1] - run.t[0]), 1e-9))
        cutoff = min(settings.torque_cutoff, band)
        settings = replace(settings, torque_cutoff=cutoff)
        filters, (laws, shared) = RunFilter(run, settings), split(problem.model())
        margin = filters.state.half + filters.column.half
        places = []
        for part in split_at_gaps(run):
            k = np.arange(margin, part.count - margin)
            places.append((part, k[filters.movement.at(part.clock(k))]))
        count = sum(len(k) for _, k in places)
        if count == 0:
            raise no_rows(run, 2 * margin * filters.dt)
        pieces = []
        grid = []
        for part, k in places:
            if some := min(round(ROWS * len(k) / count), len(k)):
                spread = k[np.linspace(0, len(k) - 1, some).astype(int)]
                pieces.append(_piece(filters, part, spread, laws))
                at = np.arange(
                    filters.column.half,
                    part.count - filters.column.half,
                    filters.stride,
                )
                grid.append((part.clock(at), filters.torque(part, at)))
        states, columns = zip(*pieces, strict=True)
        motion = joined(states)
        own_columns = np.concatenate(columns, axis=1)
        times, torque = (np.concatenate(x) for x in zip(*grid, strict=True))
        spline = CubicSpline(times, torque)
        moving = moving_joints(run) & (
            np.ptp(run.tau, axis=0) > 0.0
        )  # and its channel is not dead
        slides = np.abs(motion.dq) > SLIDES * np.sqrt(np.mean(motion.dq**2, axis=0))
        moving_rows = np.flatnonzero(np.any(slides[:, moving], axis=1))
        if not len(moving_rows):
            raise InputError(
                "no joint both moves and has a torque that changes",
                "record such a run",
                run.names[0],
            )
        # Where all have stopped nothing is asked of any joint.
        motion = motion.part(moving_rows)
        heard = slides[moving_rows].astype(float)
        largest = np.abs(run.tau).max(axis=0)
        own_columns = own_columns[:, moving_rows]
        lacking = dict[str, Array]()
        for name, law in reversed(LAWS.items()):  # the last columns
            own_columns, lacking[name] = np.split(
                own_columns, [-len(law(motion))], axis=2
            )
        free = _independent(shared)
        return cls(
            shared,
            free,
            motion,
            spline,
            own_columns,
            lacking,
            heard,
            moving,
            largest,
            cutoff,
        )


def _piece(
    filters: RunFilter,
    part: Stretch,
    at: NDArray[np.int64],
    laws: Sequence[JointEffect],
) -> tuple[Motion, Array]:
    """States and own columns (n, M, k) of one stretch."""
    half = filters.coarse.half
    reach = filters.stride * filters.coarse.half
    dense = filters.motion(part, at[0] - reach, at[-1] + reach)
    # Off the column grid by at most half a step: both sides of the relation alike would
    # cost more.
    local = np.rint((at - at[0] + reach) / filters.stride).astype(np.int64)
    local = np.clip(local, half, len(dense.t) - 1 - half)
    low_pass = Decimator(filters.coarse, local)
    # A rotor, an offset, then everything that resists the motion, and LAWS.
    columns = [dense.ddq, np.ones_like(dense.q), dense.dq]
    columns += [np.column_stack([e.column(dense, j) for j in e.joints]) for e in laws]
    columns += [np.tanh(dense.dq / w) for w in COULOMB_WIDTHS]
    columns += _bristles(dense, TRAVELS["gear"])
    columns += [column for law in LAWS.values() for column in law(dense)]
    own_columns = np.stack([(low_pass @ c).T for c in columns], axis=2)
    return dense.part(local), own_columns


def split(model: Model) -> tuple[list[JointEffect], Model | None]:
    """Frictions of every joint by its own motion; the model without all that has one
    column on every joint, made by that joint's motion: the links, couplings."""
    all_joints = list(range(model.robot.n))
    own_effects = [
        e
        for e in model.effects
        if isinstance(e, JointEffect) and list(e.joints) == all_joints
    ]
    shared_effects = tuple(e for e in model.effects if e not in own_effects)
    return [e for e in own_effects if "friction" in e.name], Model(
        model.robot, shared_effects
    ) if shared_effects else None


def on_robot(model: Model, robot: Robot) -> Model:
    """The same effects of another robot."""
    return Model(
        robot, tuple(type(e)(robot, e.asked_joints, **e.shape) for e in model.effects)
    )


def _independent(shared: Model | None) -> tuple[int, ...]:
    """The columns that lead the base parameters under a gravity along none of the arm's
    axes."""
    if shared is None:
        return ()
    gravity = tuple(np.random.default_rng(0).normal(size=3).tolist())
    model = on_robot(shared, replace(shared.robot, gravity=gravity))
    n_rows = 2 * len(model.parameters) // shared.robot.n + 1
    q, dq, ddq = (states[:n_rows] for states in shared.robot.random_states)
    return structure(
        np.concatenate(model.dense_columns(Motion(np.zeros(n_rows), q, dq, ddq)))
    )[1]
