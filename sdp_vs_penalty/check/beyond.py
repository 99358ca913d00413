"""What a joint's own motion makes beyond the model: its rotor's inertia, friction of other laws.

Geared joints carry the inertia of a fast rotor, and most of their torque is friction. Where a model
lacks the one, or has the other's law wrong, a test that knows nothing else explains what is left by a
wrong zero, a delay or a gain. So the arm that everything is judged on has, on each joint, a rotor and
those two of a list of friction laws that explain most of what the model leaves.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.check.evidence import solve
from sdp_vs_penalty.check.physics import Physics
from sdp_vs_penalty.effects.bristles import dahl
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.robot.arrays import Array

#: Velocities over which Coulomb friction may turn [rad/s, m/s].
_WIDTHS = (0.002, 0.03, 0.1)
#: Travels over which it may bend before it slides [rad, m] (Dahl 1968).
_TRAVELS = (0.0002, 0.001, 0.004, 0.02)
#: Velocities over which it falls from stiction (Stribeck) [rad/s, m/s], and that travel of its bristles.
_FALLS, _BRISTLE = (0.03, 0.1), 0.001
#: Of the usual laws every joint takes so many; and so many of all, where a number could be friction's.
_TAKEN, _RIVALS = 2, 4
#: Rows for each parameter, below which anything can be explained.
_SPARE = 2.0


def usual(motion: Motion) -> list[Array]:
    """(N, n) on a dense stretch of motion: the rotor's, then each friction law's."""
    return [motion.ddq, *_slide(motion), *_bent(motion).values()]


def rivals(motion: Motion) -> list[Array]:
    """What only a rival is offered: Stribeck's dip, the pulses at reversals by which friction that leads
    or lags differs, d/dt of the laws, and what a motor that turns with a neighbour as well brings along
    (coupled wrists): its rotor, viscous and dry friction on the sum or the difference.
    """
    bent = _bent(motion)
    dips = [np.exp(-((motion.dq / v) ** 2)) * bent[_BRISTLE] for v in _FALLS]
    laws = (*_slide(motion)[1:], *list(bent.values())[1:3])
    near = [_shifted(motion.dq, step) for step in (-1, 1)]
    wrist = [_shifted(motion.ddq, step) for step in (-1, 1)] + near
    wrist += [np.tanh((motion.dq + sign * dq) / _WIDTHS[1]) for dq in near for sign in (1.0, -1.0)]
    return [*dips, *(np.gradient(x, motion.t, axis=0) for x in laws), *wrist]


def _slide(motion: Motion) -> list[Array]:
    return [np.tanh(motion.dq / width) for width in _WIDTHS]


def _bent(motion: Motion) -> dict[float, Array]:
    return {d: np.column_stack([dahl(q, d) for q in motion.q.T]) for d in _TRAVELS}


def _shifted(x: Array, step: int) -> Array:
    """(N, n) of the joint so many further on; 0 where there is none."""
    out = np.roll(x, -step, axis=1)
    out[:, -1 if step > 0 else 0] = 0.0
    return out


def rival(physics: Physics) -> Physics:
    """The same with four laws of all on each joint, instead of the two usual ones."""
    return widened(physics.narrow, _RIVALS)


def widened(physics: Physics, taken: int = _TAKEN) -> Physics:
    """The same with a rotor and so many friction laws more on each joint, where the rows suffice."""
    own, n = physics.own, physics.n
    if own is None or len(physics.channels) < _SPARE * (physics.p + n * (1 + taken)):
        return physics
    offered = own.offered()
    if taken > _TAKEN:
        offered = np.concatenate([offered, own.rivals()], axis=2)
    chosen = [
        [0, *_chosen(known, y, x, taken)]
        for known, y, x in zip(physics.columns, physics.channels.T, offered, strict=True)
    ]
    more = np.stack([x[:, k] for x, k in zip(offered, chosen, strict=True)])
    indices = physics.p + n * np.arange(1 + taken) + np.arange(n)[:, None]
    wide = np.concatenate([own.columns, more], axis=2)
    return replace(physics, own=replace(own, columns=wide, indices=np.hstack([own.indices, indices])))


def _chosen(known: Array, y: Array, offered: Array, taken: int) -> list[int]:
    """Greedily, which laws explain most of y (M,) beside the known columns (M, p) and the rotor."""
    both = np.column_stack([offered, y])
    least = 1e-8 * np.einsum("ij,ij->j", offered, offered)
    both = both - known @ solve(known.T @ known, known.T @ both)
    out = [0]
    for _ in range(taken):
        last = both[:, out[-1]]
        both = both - np.outer(last, last @ both) / max(float(last @ last), 1e-300)
        size = np.einsum("ij,ij->j", both, both)[:-1]
        gain = np.where(size > least, (both[:, -1] @ both)[:-1] ** 2 / np.maximum(size, 1e-300), -0.5)
        gain[out] = -1.0
        out.append(int(np.argmax(gain)))
    return out[1:]
