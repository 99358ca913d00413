"""With which shape constants a search begins: those that stand out of the error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.robot.arrays import Array

#: Forms of an effect on one joint that a search begins with.
_BEGUN_WITH = 4
#: Forms whose columns are in memory at a time.
_AT_A_TIME = 32


def forms_that_stand_out(data: WhiteData, forms: Sequence[Effect]) -> list[Effect]:
    """Choose the forms of one joint's effect that explain most of what the model leaves.

    A form is judged on its own joint's rows alone, also where it acts on others, which
    costs a small part: by the squares of white torque that its columns explain beyond
    all columns that the model has on these rows. Chosen are the best of those that
    explain more than their neighbours. A search refines their constants.

    Parameters
    ----------
    data
        White rows with the model's columns.
    forms
        An effect on one joint with several values of its shape constants, in order.

    Returns
    -------
    list of Effect
        At most _BEGUN_WITH of them.
    """
    if not forms:
        return []
    explained = _squares_explained(data, forms)
    is_peak = explained > 0.0
    is_peak[1:] &= explained[1:] >= explained[:-1]
    is_peak[:-1] &= explained[:-1] >= explained[1:]
    peaks = np.flatnonzero(is_peak)
    best_first = peaks[np.argsort(-explained[peaks], kind="stable")]
    return [forms[i] for i in np.sort(best_first[:_BEGUN_WITH])]


def _squares_explained(data: WhiteData, forms: Sequence[Effect]) -> Array:
    """Return the squares (K,) of white torque that each of K forms explains on its own
    joint, beyond the model's columns there."""
    joint = forms[0].joints[0]
    own = data.X[joint]
    basis, _ = np.linalg.qr(own[:, np.any(own != 0.0, axis=0)])
    residual = data.y[joint] - basis @ (basis.T @ data.y[joint])
    explained = []
    for start in range(0, len(forms), _AT_A_TIME):
        part = forms[start : start + _AT_A_TIME]
        columns = data.white(_own_columns(data, part), joint)
        columns -= basis @ (basis.T @ columns)
        by_form = columns.reshape(len(columns), len(part), -1).transpose(1, 0, 2)
        grams = by_form.transpose(0, 2, 1) @ by_form  # (K, k, k)
        along = residual @ by_form  # (K, k)
        inverses = np.linalg.pinv(grams, rcond=1e-9, hermitian=True)
        explained.append(np.einsum("fi,fij,fj->f", along, inverses, along))
    return np.concatenate(explained)


def _own_columns(data: WhiteData, forms: Sequence[Effect]) -> Array:
    """Return the filtered columns (M, k K) of K forms with k coefficients each, on
    their own joint."""
    kind = type(forms[0])
    parts = [
        segment.low_pass @ kind.own_columns(forms, segment.motion)
        for segment in data.rows.segments
    ]
    return np.concatenate(parts)
