"""Rows behind another filter than ours: what Table IV's errors owe to it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.paper.tables.study import Data
from sdp_vs_penalty.regression.regression import Factor, Regression, TimeBlock, triangular
from sdp_vs_penalty.signals.runs import sample_rate

ORDER = 4
#: Rows a period of the cut-off, and periods at either end that the filter's start spoils.
_ROWS, _SPOILT = 4.0, 4.0


@dataclass(frozen=True)
class Butterworth(Data):
    """A run behind zero-phase Butterworth filters (forward and back) at the cut-offs of its
    preprocessing: positions at the one of states, whose derivatives are differences; torque and columns
    at their own."""

    @property
    def key(self) -> str:
        settings = self.preprocessing
        return f"{self.train.data_hash}, Butterworth {settings.state_cutoff} {settings.torque_cutoff}"

    @cached_property
    def regression(self) -> Regression:
        return self._rows(self.train, self.model)

    def test_with(self, model: Model) -> Regression:
        assert self.test is not None
        return self._rows(self.test, model)

    def _rows(self, run: Measurements, model: Model) -> Regression:
        from scipy import signal

        state, torque = self.preprocessing.state_cutoff, self.preprocessing.torque_cutoff
        assert state is not None
        assert torque is not None
        rate = sample_rate(run)
        t = np.arange(run.t[0], run.t[-1], 1.0 / rate)
        q, tau = (np.column_stack([np.interp(t, run.t, x) for x in y.T]) for y in (run.q, run.tau))
        smooth = signal.sosfiltfilt(signal.butter(ORDER, state, fs=rate, output="sos"), q, axis=0)
        dq = np.gradient(smooth, 1.0 / rate, axis=0)
        motion = Motion(t, smooth, dq, np.gradient(dq, 1.0 / rate, axis=0))
        low_pass = signal.butter(ORDER, torque, fs=rate, output="sos")
        edge = int(_SPOILT * rate / min(state, torque))
        rows = slice(edge, len(t) - edge, max(1, int(rate / (_ROWS * torque))))
        measured = signal.sosfiltfilt(low_pass, tau, axis=0)[rows]
        factors = []
        for j, block in enumerate(model.columns(motion)):
            columns = signal.sosfiltfilt(low_pass, block.columns, axis=0)[rows]
            triangle = triangular([np.column_stack([columns, measured[:, j]])])
            factors.append(Factor(j, 0, block.indices, triangle, len(columns)))
        blocks = (TimeBlock(0, float(t[0]), float(t[-1])),)
        return Regression(model.parameters, model.robot.n, blocks, tuple(factors))
