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
#: Friction laws that a joint may have beside the model's.
_TAKEN = 2
#: Rows for each parameter, below which anything can be explained.
_SPARE = 2.0


def columns(motion: Motion) -> list[Array]:
    """(N, n) on a dense stretch of motion: the rotor's, then each friction law's."""
    joints = range(motion.q.shape[1])
    bent = [np.column_stack([dahl(motion.q[:, j], d) for j in joints]) for d in _TRAVELS]
    return [motion.ddq, *(np.tanh(motion.dq / width) for width in _WIDTHS), *bent]


def widened(physics: Physics, offered: Array) -> Physics:
    """The same with a rotor and two friction laws more on each joint, where the rows suffice.

    offered : (n, M, l) the columns of :func:`columns`, low-passed as the torque is.
    """
    own, n = physics.own, physics.n
    if own is None or len(physics.channels) < _SPARE * (physics.p + n * (1 + _TAKEN)):
        return physics
    chosen = [
        [0, *_chosen(known, y, x)]
        for known, y, x in zip(physics.columns, physics.channels.T, offered, strict=True)
    ]
    taken = np.stack([x[:, k] for x, k in zip(offered, chosen, strict=True)])
    indices = physics.p + n * np.arange(1 + _TAKEN) + np.arange(n)[:, None]
    columns = np.concatenate([own.columns, taken], axis=2)
    return replace(
        physics,
        own=replace(own, columns=columns, indices=np.hstack([own.indices, indices])),
    )


def _chosen(known: Array, y: Array, offered: Array) -> list[int]:
    """Greedily, which laws explain most of y (M,) beside the known columns (M, p) and the rotor."""
    both = np.column_stack([offered, y])
    least = 1e-8 * np.einsum("ij,ij->j", offered, offered)
    both = both - known @ solve(known.T @ known, known.T @ both)
    out = [0]
    for _ in range(_TAKEN):
        last = both[:, out[-1]]
        both = both - np.outer(last, last @ both) / max(float(last @ last), 1e-300)
        size = np.einsum("ij,ij->j", both, both)[:-1]
        gain = np.where(size > least, (both[:, -1] @ both)[:-1] ** 2 / np.maximum(size, 1e-300), -0.5)
        gain[out] = -1.0
        out.append(int(np.argmax(gain)))
    return out[1:]
