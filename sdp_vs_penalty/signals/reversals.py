"""When a joint turns round, and how far in time each row is from that."""

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.robot.arrays import Array


def since_reversal(
    t: Array, velocity: Array, segment: NDArray[np.integer] | None = None
) -> tuple[Array, Array]:
    """Compute the time from a joint's nearest reversal, at instants t (M,) [s], and the
    direction after it.

    Parameters
    ----------
    velocity
        (M,) velocity of the joint [rad/s, m/s]; it reverses between two rows whose
        velocities have different signs.
    segment
        (M,) number of each row's uninterrupted piece of the log; default: one piece.

    Returns
    -------
    (M,) array
        Seconds, negative before the reversal; infinite in a piece without one.
    (M,) array
        Sign of the velocity after that reversal; 0 where the joint never reverses.
    """
    pieces = np.zeros(len(t), int) if segment is None else segment
    direction = np.sign(velocity)
    has_turned = direction[1:] != direction[:-1]
    is_same_piece = pieces[1:] == pieces[:-1]
    last_rows = np.flatnonzero(has_turned & is_same_piece)  # before each reversal
    if not len(last_rows):
        return np.full(len(t), np.inf), np.zeros(len(t))
    instants = 0.5 * (t[last_rows] + t[last_rows + 1])
    row_numbers = np.arange(len(t))
    # (2, M) numbers of the reversals before and after each row.
    neighbours = np.searchsorted(last_rows, row_numbers) + np.array([[-1], [0]])
    neighbours = np.clip(neighbours, 0, len(last_rows) - 1)
    is_in_piece = pieces[last_rows[neighbours]] == pieces
    seconds = np.where(is_in_piece, t - instants[neighbours], np.inf)
    nearest = np.argmin(np.abs(seconds), axis=0)
    reversal = neighbours[nearest, row_numbers]
    return seconds[nearest, row_numbers], direction[last_rows[reversal] + 1]
