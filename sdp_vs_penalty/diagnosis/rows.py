"""The diagnosis's rows: both sides of tau = Y theta filtered alike, at the rate of their bandwidth.

Three grids, all uniform:

- the log's: positions become q, dq, ddq there, and the torque is low-passed there;
- the column grid (30 times the low-pass's cut-off): columns of effects are computed there, fast
  enough for a friction that turns round within milliseconds;
- the rows: twice the cut-off, one row an independent sample. Columns and torque pass the same kernel
  (that of the columns is the other's, sampled on the coarser grid), so that a linear relation between them survives,
  the folding of what lies above the row rate included.

Rows are dropped where the robot stands, and where the motion is sharper than the state filter can
follow (a step in acceleration): there the states are wrong, not the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Block, CurrentModel, Effect, Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.signals.kernels import Kernel, convolve
from sdp_vs_penalty.signals.preprocessing import Preprocessing, _Movement, _rate, _segments

Array = NDArray[np.float64]

#: The column grid's rate in units of the torque low-pass's cut-off.
_COLUMN_RATE = 30.0
#: The dense grid of residuals, for comparing instants one period apart.
_DENSE_RATE = 8.0
#: Motion counts as too sharp where two state filters disagree by this many robust deviations.
_SHARP = 12.0


@dataclass(frozen=True)
class Segment:
    """One uninterrupted piece of a run.

    motion : on the column grid, with the current model's torque and links; t (M,), torque (M, n) :
        the rows; keep (M,) : which of them count; low_pass (M, N), dense (D, N) : from the column
        grid to the rows and to the dense grid t_dense (D,), whose torque is torque_dense (D, n).
    """

    run: int
    motion: Motion
    t: Array
    torque: Array
    keep: NDArray[np.bool_]
    low_pass: sparse.csr_array
    t_dense: Array
    torque_dense: Array
    dense: sparse.csr_array
    q_dense: Array


@dataclass(frozen=True)
class DiagnosisRows:
    """All segments of all runs, their rows stacked in order (M in all)."""

    segments: tuple[Segment, ...]
    n: int
    cutoff: float
    #: Rows a second.
    rate: float
    names: tuple[str, ...]
    #: (n,) extra rows switched off joint by joint, (M, n): events.
    masked: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0), bool))

    @property
    def t(self) -> Array:
        return np.concatenate([s.t for s in self.segments])

    @property
    def run(self) -> NDArray[np.int64]:
        return np.concatenate([np.full(len(s.t), s.run) for s in self.segments])

    @property
    def segment(self) -> NDArray[np.int64]:
        return np.concatenate([np.full(len(s.t), k) for k, s in enumerate(self.segments)])

    @property
    def dq(self) -> Array:
        """(M, n) filtered velocities."""
        return np.concatenate([s.low_pass @ s.motion.dq for s in self.segments])

    @property
    def torque(self) -> Array:
        """(M, n) filtered measured torque."""
        return np.concatenate([s.torque for s in self.segments])

    @property
    def residual(self) -> Array:
        """(M, n) filtered measured less modelled torque."""
        return np.concatenate([s.torque - s.low_pass @ s.motion.model_torque for s in self.segments])

    @property
    def dense_residuals(self) -> list[Array]:
        """The same on the dense grid, per segment (D, n)."""
        return [s.torque_dense - s.dense @ s.motion.model_torque for s in self.segments]

    @property
    def keep(self) -> NDArray[np.bool_]:
        """(M, n) which rows count for which joint."""
        keep = np.repeat(np.concatenate([s.keep for s in self.segments])[:, None], self.n, axis=1)
        return keep & ~self.masked if self.masked.size else keep

    def with_masked(self, masked: NDArray[np.bool_]) -> DiagnosisRows:
        return replace(self, masked=masked)

    def blocks(self, effect: Effect) -> list[Block]:
        """The effect's columns on the rows: blocks of (M, k)."""
        return self._stack([(s.low_pass, effect.blocks(s.motion)) for s in self.segments])

    def column(self, effect: Effect, joint: int) -> Array:
        """(M, k) columns of a joint's own torque only."""
        for block in self.blocks(effect):
            if block.joint == joint:
                return block.columns
        return np.zeros((len(self.t), len(effect.parameters)))

    @staticmethod
    def _stack(parts: Sequence[tuple[sparse.csr_array, list[Block]]]) -> list[Block]:
        first = parts[0][1]
        return [
            Block(
                block.joint,
                block.parameters,
                np.concatenate([low @ blocks[k].columns for low, blocks in parts]),
            )
            for k, block in enumerate(first)
        ]


def diagnosis_rows(
    measurements: Measurements, estimate: Estimate, settings: Preprocessing
) -> DiagnosisRows:
    """Filter all runs; ``settings`` must be resolved. The current model is the estimate.

    Raises InputError where no run is long enough for the filters.
    """
    segments: list[Segment] = []
    rate = 0.0
    names = []
    for index, run in enumerate(measurements.runs()):
        names.append(run.names[0])
        for segment, row_rate in _run_segments(run, index, estimate, settings):
            segments.append(segment)
            rate = row_rate
    if not segments:
        raise InputError(
            f"{', '.join(names)}: no rows are left after filtering: record longer runs in which the "
            "robot moves, or raise the cut-offs."
        )
    assert settings.torque_cutoff is not None
    return DiagnosisRows(tuple(segments), measurements.n, settings.torque_cutoff, rate, tuple(names))


def _run_segments(
    run: Measurements, index: int, estimate: Estimate, settings: Preprocessing
) -> list[tuple[Segment, float]]:
    assert settings.state_cutoff is not None
    assert settings.torque_cutoff is not None
    dt = 1.0 / _rate(run)
    cutoff = settings.torque_cutoff
    state, torque_kernel = Kernel(settings.state_cutoff, dt), Kernel(cutoff, dt)
    wider = Kernel(1.6 * settings.state_cutoff, dt)
    stride = max(1, int(1.0 / (_COLUMN_RATE * cutoff * dt)))
    coarse = torque_kernel.sampled(stride)
    half = coarse.half
    step = max(1, int(1.0 / (2.0 * cutoff * dt * stride)))
    dense_step = max(1, int(1.0 / (_DENSE_RATE * cutoff * dt * stride)))
    moving = _Movement(run, settings.standstill)
    out = []
    for t, q, tau in _segments(run, dt):
        count = (len(t) - 2 * state.half + stride - 1) // stride
        if count < 2 * half + 1 + 2 * step:
            continue
        grid = state.half + stride * np.arange(count)
        states = [x[::stride] for x in state.states(q)]
        motion = Motion(t[grid], states[0], states[1], states[2])
        current = CurrentModel(estimate.robot, _links(estimate))
        motion = replace(
            motion,
            torque=estimate.torque(motion),
            current=current,
            sign_width=estimate.model.sign_width,
        )
        rows = np.arange(half, count - half, step)
        dense = np.arange(half, count - half, dense_step)
        low_pass, low_dense = coarse.decimator(count, rows), coarse.decimator(count, dense)

        # Two state filters that disagree on the acceleration: the motion is too sharp for them.
        (second,) = convolve(q - q[:1], wider.second)
        offset = state.half - wider.half
        apart = np.abs(low_pass @ (states[2] - second[offset + stride * np.arange(count)]))
        keep = moving.at(t[grid[rows]])
        scale = 1.4826 * np.median(apart[keep], axis=0) if keep.any() else np.ones(run.n)
        keep &= ~np.any(apart > _SHARP * np.maximum(scale, 1e-12), axis=1)
        if not keep.any():
            continue
        segment = Segment(
            index,
            motion,
            motion.t[rows],
            torque_kernel.decimator(len(tau), grid[rows]) @ tau,
            keep,
            low_pass,
            motion.t[dense],
            torque_kernel.decimator(len(tau), grid[dense]) @ tau,
            low_dense,
            motion.q[dense],
        )
        out.append((segment, 1.0 / (dt * stride * step)))
    return out


def _links(estimate: Estimate) -> Array:
    links = estimate.links
    return links if len(links) else np.zeros((estimate.robot.n, 10))
