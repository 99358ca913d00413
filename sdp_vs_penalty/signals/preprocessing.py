"""From raw logs to regression rows: resampling, states, and one low-pass on both sides.

Three steps, each zero-phase and each with a finite impulse response, so that a run can
be worked through in pieces with exactly the result of the whole:

1. Jittered time stamps are resampled linearly to the median rate. Runs are split at gaps.
2. The position is convolved with a low-pass kernel and its exact first and second derivative:
   q, dq, ddq at one cut-off (``state_cutoff``). Measured velocities are not used: drives filter
   them, with a lag that would have to be known.
3. The model's columns are computed from these states, and columns AND torque pass the same second
   low-pass (``torque_cutoff``), which therefore leaves the linear relation between them intact. It is
   the narrower of the two: what the first low-pass takes from the states it does not take from the
   torque, and dry friction has to turn round when the joint does. Rows are decimated to four times
   its cut-off. Columns are computed at 30 times that cut-off (effects with memory: at the full rate),
   where the low-pass is the same to 1e-4 of the sharpest of them, Coulomb friction's. Smooth ones (the
   links') are no sharper than products of the states, and are computed at a rate at which these do not
   fold back: the same to 1e-5 of the largest one.

The kernel (kernels.py) reaches 2 / cut-off to either side. Rows within the half lengths
of both kernels of the ends of a run would need samples from outside it, and are
dropped.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.stretches.gaps import FINEST
from sdp_vs_penalty.effects.effect import Motion, Sampling
from sdp_vs_penalty.effects.motion import Command
from sdp_vs_penalty.effects.servo import LATEST
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array, Indices
from sdp_vs_penalty.signals.constants import STOP_BAND
from sdp_vs_penalty.signals.kernels import Decimator, Kernel
from sdp_vs_penalty.signals.runs import (
    Movement,
    Stretch,
    moving_joints,
    no_motion,
    sample_rate,
)
from sdp_vs_penalty.signals.spectrum import (
    highest_harmonic,
    sharpest_cutoff,
    smoothed_cutoff,
)

#: Rows are decimated to this multiple of the cut-off: the kernel's stop band starts at
#: 1.4 cut-offs.
OVERSAMPLING = 4.0
#: Columns are computed at this multiple of the cut-off: what they hold above half of it
#: (reversals of friction, products of states) must not fold back below the cut-off.
_COLUMN_RATE = 30.0


@dataclass(frozen=True)
class Preprocessing:
    """Settings of the filters; None is chosen from the data by :meth:`resolve`."""

    #: Cut-off of q, dq, ddq [Hz]. Default: three times the torque's, so that it takes
    #: nothing away that the torque's low-pass passes; less where the positions' noise
    #: would let dry friction turn round at the wrong time.
    state_cutoff: float | None = None
    #: Cut-off of columns and torque [Hz]. Default: ten times the highest excitation
    #: harmonic; less where the torque was smoothed before it was logged.
    torque_cutoff: float | None = None
    #: Share of a joint's maximum velocity [-]. Rows are dropped where no joint has
    #: moved faster than this share of its own maximum for half a second: they repeat
    #: one static friction state that no model of sliding friction explains.
    standstill: float = 2e-3

    def __post_init__(self) -> None:
        """Refuse cut-offs that are no frequencies, and a standstill that is no share."""
        for name in ("state_cutoff", "torque_cutoff"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < np.inf:
                raise InputError(
                    f"preprocessing: {name} {value!r} is not a frequency above 0 Hz",
                    "give one in Hz",
                )
        if not 0.0 <= self.standstill < 1.0:
            raise InputError(
                f"preprocessing: standstill {self.standstill!r} is not a share below 1",
                "give a number from 0 to below 1",
            )

    def resolve(self, measurements: Measurements) -> Preprocessing:
        """Choose the numbers that are None from the measurements, all runs together; no
        cut-off is above a fifth of the sample rate, also a given one."""
        runs = list(measurements.runs())
        highest = min(sample_rate(run) for run in runs) / 5.0
        state = min(self.state_cutoff or highest, highest)
        torque = self.torque_cutoff
        if torque is None:
            torque = 10.0 * max(highest_harmonic(run) for run in runs)
            torque = min(torque, state if self.state_cutoff else 0.5 * highest)
            if measurements.torque_logged:
                torque = smoothed_cutoff(runs, torque)
        torque = min(torque, highest)
        if self.state_cutoff is None:
            state = sharpest_cutoff(runs, torque, highest)
        return replace(self, state_cutoff=state, torque_cutoff=torque)


class RunFilter:
    """The filters of one run, ``settings`` resolved: both sides of tau = Y theta pass
    them alike.

    Positions become states on the column grid, every ``stride``-th sample of the log,
    where columns are computed and pass the low-pass ``coarse``; torque passes
    ``column``, the same low-pass at the log's rate.
    """

    def __init__(self, run: Measurements, settings: Preprocessing) -> None:
        """Make the kernels and grids of the filters; raise InputError for a run that is
        shorter than they are."""
        assert settings.state_cutoff is not None
        assert settings.torque_cutoff is not None
        self.run = run
        self.dt = 1.0 / sample_rate(run)
        # Before any kernel is made: its length is that of the cut-off, not of the run.
        reach = 2.0 / settings.state_cutoff + 2.0 / settings.torque_cutoff
        # The grid of a run whose clock leaps has FINEST points a sample at most.
        span = float(run.t[-1] - run.t[0]) + self.dt
        longest = min(span, 2.0 * FINEST * len(run.t) * self.dt)
        if not reach < longest:
            raise no_rows(run, 2.0 * reach)
        self.state = Kernel(settings.state_cutoff, self.dt)
        self.column = Kernel(settings.torque_cutoff, self.dt)
        self.grid_stride = max(
            1, int(1.0 / (_COLUMN_RATE * self.column.cutoff * self.dt))
        )
        self.stride = self.grid_stride
        self.coarse = self.column.sampled(self.stride)
        # Smooth columns hold products of up to four states, with as many times the
        # bandwidth. Their stride divides the step from row to row, so that rows lie on
        # their grid too.
        step = self.step(OVERSAMPLING)
        highest = settings.torque_cutoff + 4.0 * settings.state_cutoff
        highest_stride = max(1.0, 1.0 / (STOP_BAND * highest * self.dt))
        self.smooth_stride = max(
            k for k in range(1, step + 1) if step % k == 0 and k <= highest_stride
        )
        self.smooth = self.column.sampled(self.smooth_stride)
        self.standstill = settings.standstill

    @property
    def every_sample(self) -> RunFilter:
        """The same filters with columns at the log's rate, for effects with memory,
        whose state is followed sample by sample."""
        fine = copy(self)
        fine.stride = 1
        fine.coarse = self.column
        return fine

    @cached_property
    def movement(self) -> Movement:
        """Which instants of the run become rows: those at which the robot moves."""
        return Movement(self.run, self.standstill)

    def step(self, rate: float) -> int:
        """Return how many samples of the log lie from row to row.

        Parameters
        ----------
        rate
            Rows in a period of the cut-off.

        Returns
        -------
        int
            Samples, a multiple of the grid's stride.
        """
        stride = self.grid_stride
        rows_per_sample = rate * self.column.cutoff * self.dt
        return stride * max(1, int(1.0 / (rows_per_sample * stride)))

    def around(self, part: Stretch, at: Indices) -> tuple[Motion, Motion]:
        """Compute the filtered motion around some samples, for the columns of a model.

        The motion reaches as far beyond the samples as the low-passes of the columns
        look.

        Parameters
        ----------
        at : (M,) array of int
            Ascending samples of the log, which become rows.

        Returns
        -------
        fine : Motion
            On the column grid, every ``stride``-th sample.
        smooth : Motion
            On the coarser grid of columns without jumps, every ``smooth_stride``-th
            sample.
        """
        reach = self.stride * self.coarse.half
        smooth_reach = self.smooth_stride * self.smooth.half
        longest = max(reach, smooth_reach)
        begin = at[0] - longest
        end = at[-1] + longest
        states = self._states(part, part.q, begin, end)
        count = end + 1 - begin

        def on_grid(margin: int, stride: int) -> list[Array]:
            """Return the states at every ``stride``-th sample, without a margin at each
            end."""
            return [x[margin : count - margin : stride] for x in states]

        fine = self.motion(
            part, at[0] - reach, at[-1] + reach, on_grid(longest - reach, self.stride)
        )
        samples = np.arange(
            at[0] - smooth_reach, at[-1] + smooth_reach + 1, self.smooth_stride
        )
        q, dq, ddq = on_grid(longest - smooth_reach, self.smooth_stride)
        return fine, Motion(part.clock(samples), q, dq, ddq)

    def _states(
        self, part: Stretch, q: Array, first: int, last: int
    ) -> tuple[Array, Array, Array]:
        """Return low-passed positions and their first and second derivative, each (K,
        n), at the K samples ``first`` to ``last`` of a stretch; q (N, n) : as logged.
        """
        positions = part.resampled(
            q, first - self.state.half, last + 1 + self.state.half
        )
        return self.state.states(positions)

    def motion(
        self,
        part: Stretch,
        first: int,
        last: int,
        states: Sequence[Array] | None = None,
    ) -> Motion:
        """Compute the motion on the column grid, from sample ``first`` to ``last``.

        Parameters
        ----------
        states : q, dq, ddq, each (K, n), optional
            On the grid, if they are known.

        Returns
        -------
        Motion
            States, and what was logged beside them: temperature, command, the integral
            of the position, the motors' accelerations.
        """
        if states is None:
            at_samples = self._states(part, part.q, first, last)
            states = [_subsample(self.stride, x) for x in at_samples]
        q, dq, ddq = states
        clock = part.clock(np.arange(first, last + 1, self.stride))
        temperature = part.temperature
        if temperature is not None:  # slow: it needs no filter
            at_samples_of_log = part.resampled(temperature, first, last + 1)
            temperature = _subsample(self.stride, at_samples_of_log)
        command = path = motors = None
        if part.qcmd is not None:
            command, path = self._command(part, first, last)
        if part.qmot is not None:
            _, _, acceleration = self._states(part, part.qmot, first, last)
            motors = _subsample(self.stride, acceleration)
        motion = Motion(
            clock,
            q,
            dq,
            ddq,
            temperature=temperature,
            command=command,
            position_integral=path,
            motors=motors,
        )
        return replace(motion, within=Sampling(self.stride, self.dt))

    def _command(self, part: Stretch, first: int, last: int) -> tuple[Command, Array]:
        """Return the command of the drives and the integral of the positions, filtered
        as the positions are, on the column grid up to sample ``last``.

        The command begins before sample ``first``, by the longest delay of a drive; the
        integral (K, n) begins at ``first``.
        """
        assert part.qcmd is not None
        stride = self.stride
        # The search for a delay looks a little beyond the longest one.
        n_before = int(1.2 * LATEST / self.dt)
        n_strides = -(-n_before // stride)  # rounded up
        begin = first - stride * n_strides
        of_command, of_motion = part.integrals
        q, dq, ddq = self._states(part, part.qcmd, begin, last)
        integral = self._states(part, of_command, begin, last)[0]
        path = self._states(part, of_motion, first, last)[0]
        command = Command(
            part.clock(np.arange(begin, last + 1, stride)),
            _subsample(stride, q),
            _subsample(stride, dq),
            _subsample(stride, ddq),
            _subsample(stride, integral),
        )
        return command, _subsample(stride, path)

    def torque(self, part: Stretch, at: Indices) -> Array:
        """Return the low-passed torque (M, n) [N m or N] at samples ``at`` (M,) of the
        log, in ascending order."""
        begin = at[0] - self.column.half
        end = at[-1] + self.column.half + 1
        return Decimator(self.column, at - begin) @ part.resampled(part.tau, begin, end)


def _subsample(stride: int, rows: Array) -> Array:
    """Copy every ``stride``-th of some rows (K, n), so that the others can be
    forgotten."""
    return rows if stride == 1 else rows[::stride].copy(order="K")


def no_rows(run: Measurements, seconds: float) -> InputError:
    """Return the error that the filters leave no row of a run.

    seconds : what the filters need. It says whether no joint moves, the run is too
    short, or its motion is.
    """
    if not moving_joints(run).any():
        return no_motion(run)
    lasts = float(run.t[-1] - run.t[0])
    what = f"the run lasts {lasts:.3g} s, the filters need more than {seconds:.3g} s"
    remedy = "record longer, or raise the cut-offs"
    if lasts > seconds:
        needed = (
            f"no continuous motion longer than {seconds:.3g} s, which the filters need"
        )
        what = f"no rows are left after filtering: {needed}"
        remedy = "record a longer motion, or raise the cut-offs"
    return InputError(what, remedy, run.names[0])
