"""With which wave numbers a search begins: those that stand out of the error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.robot.arrays import Array

#: Wave numbers of one joint that a search begins with.
_BEGUN_WITH = 4
#: Wave numbers whose columns are in memory at a time.
_AT_A_TIME = 32


def waves_that_stand_out(data: WhiteData, waves: Sequence[Effect]) -> list[Effect]:
    """Choose the waves of one joint that explain most of what the model leaves.

    A wave acts on all joints that its link loads. Here it is judged on its own joint's
    rows alone, which costs a small part: by the squares of white torque that its cosine
    and sine explain beyond all columns that the model has on these rows. Chosen are the
    best of those that explain more than their neighbours.

    Parameters
    ----------
    data
        White rows with the model's columns.
    waves
        The effects of one joint, with ascending wave numbers.

    Returns
    -------
    list of Effect
        At most _BEGUN_WITH of them.
    """
    if not waves:
        return []
    explained = _squares_explained(data, waves)
    is_peak = explained > 0.0
    is_peak[1:] &= explained[1:] >= explained[:-1]
    is_peak[:-1] &= explained[:-1] >= explained[1:]
    peaks = np.flatnonzero(is_peak)
    best_first = peaks[np.argsort(-explained[peaks], kind="stable")]
    return [waves[i] for i in np.sort(best_first[:_BEGUN_WITH])]


def _squares_explained(data: WhiteData, waves: Sequence[Effect]) -> Array:
    """Return the squares (K,) of white torque that each of K waves explains on its own
    joint, beyond the model's columns there."""
    joint = waves[0].joints[0]
    own = data.X[joint]
    basis, _ = np.linalg.qr(own[:, np.any(own != 0.0, axis=0)])
    residual = data.y[joint] - basis @ (basis.T @ data.y[joint])
    explained = list[float]()
    for start in range(0, len(waves), _AT_A_TIME):
        part = waves[start : start + _AT_A_TIME]
        columns = data.white(_own_columns(data, part), joint)
        columns -= basis @ (basis.T @ columns)
        for pair in np.split(columns, len(part), axis=1):
            orthonormal = scipy.linalg.orth(pair)
            explained.append(float(np.sum((orthonormal.T @ residual) ** 2)))
    return np.array(explained)


def _own_columns(data: WhiteData, waves: Sequence[Effect]) -> Array:
    """Return the filtered columns (M, 2 K) of K waves on their own joint."""
    parts = []
    for segment in data.rows.segments:
        columns = [w.own_columns(segment.motion) for w in waves]
        parts.append(segment.low_pass @ np.hstack(columns))
    return np.concatenate(parts)
