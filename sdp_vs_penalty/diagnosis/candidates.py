"""Which candidates there are: every effect on every joint or on the robot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterator, Sequence

import numpy as np

from sdp_vs_penalty.diagnosis.library import (
    Batch,
    Candidate,
    Key,
    Library,
    white_candidate,
)
from sdp_vs_penalty.diagnosis.own_constants import own_constant_candidates
from sdp_vs_penalty.diagnosis.white_rows import WhiteData
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import STANDS, Effect
from sdp_vs_penalty.effects.model import Model, depends
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.regression.linalg import span
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.segments import SegmentedRuns

#: Forms of an effect on one joint that a search begins with.
_BEGUN_WITH = 4
#: Forms whose columns are in memory at a time.
_AT_A_TIME = 32


def list_candidates(data: WhiteData, progress: Progress = no_progress) -> Library:
    """List all candidates of a search: effects on joints, and other values of own
    constants.

    Each effect of the library is a candidate on each joint, or on the robot, with the
    shape constants that its class declares as starts. Each of the model's own effects
    is a candidate with other values of its estimated constants. Effects that these rows
    could not tell from others (a ripple of which less than one wave was travelled) are
    left out.

    Parameters
    ----------
    data
        White rows (weighted so that the noise is independent with variance 1) with the
        model.
    progress
        Is called with the number of the candidate at which each effect begins.

    Returns
    -------
    Library
        The candidates with white columns, in batches. A batch holds candidates of the
        same joints and number of coefficients that depend on the current model in the
        same way; each of the model's own constants has its own batch.
    """
    # Candidates with the white columns of each joint, by what a batch has in common.
    groups = dict[Hashable, list[tuple[Candidate, dict[int, Array]]]]()
    forms = [*effect_candidates(data), *own_constant_candidates(data)]
    last_name = ""
    for number, form in enumerate(forms, start=1):
        if form.effect.name != last_name:
            last_name = form.effect.name
            progress(f"trying effects: {number} of {len(forms)}")
        white = white_candidate(data, form)  # columns by joint (from 0)
        if white:  # it changes the torque of some joint
            own_key = form.key if form.replaces_own_constant else None
            joints = tuple(sorted(white))
            group = joints, form.n_coefficients, depends(form.effect), own_key
            groups.setdefault(group, []).append((form, white))
    batches = []
    for key in [*groups]:
        members = groups.pop(key)  # its columns are needed once
        forms_of_batch, columns = zip(*members, strict=True)
        joints = tuple(sorted(columns[0]))
        batches.append(Batch.from_columns(joints, forms_of_batch, columns))
    # A law is an effect on a joint with the same discrete constants: its candidates
    # differ in continuous constants only.
    form_by_law = {f.discrete_choice: f for b in batches for f in b.forms}
    n_laws_by_key = Counter(f.key for f in form_by_law.values())
    return Library(tuple(batches), n_laws_by_key)


def effect_candidates(data: WhiteData) -> Iterator[Candidate]:
    """Yield each effect of the library on each joint, with each of its starting
    constants.

    Left out are effects that the model has on that joint already (unless it is frozen:
    they may have changed), effects that need a motor encoder or a temperature that was
    not logged, effects that show at standstill only, on a joint that never stands, and
    effects that look like others in these rows.
    """
    rows = data.rows
    model = data.estimate.model
    taken = set[Key]() if data.frozen else _keys_of(model)
    start = min(float(s.motion.t[0]) for s in rows.segments)
    # (n,) joints that stand in more than 2 % of the rows.
    stands = np.mean(rows.still > 0.5, axis=0) > STANDS
    is_shown = _Shown(rows)
    for name, kind in effect_types().items():
        if kind.frozen_only and not data.frozen:
            continue
        if kind.needs_motors and not is_shown.has_motors:
            continue
        for joint in (None,) if kind.whole_robot else range(rows.n):
            key = name, joint
            # "holds": an effect that shows at standstill only.
            if key in taken or (kind.at_rest == "holds" and not stands[joint]):
                continue
            forms = kind.candidates(model.robot, joint, start)
            if kind.width_shape and joint is not None:
                forms += _at_own_width(kind, model, joint)
            shown = [effect for effect in forms if is_shown(effect)]
            if kind.starts_stand_out:
                shown = forms_that_stand_out(data, shown)
            for effect in shown:
                yield Candidate(key, effect)


def _at_own_width(kind: type[Effect], model: Model, joint: int) -> list[Effect]:
    """Return the forms of an effect that begin at the width over which the model's
    friction turns round: another law of friction explains much only if its width is within
    a sixth of the true one."""
    width = {kind.width_shape: model.sign_width[joint]}
    if kind.shapes[kind.width_shape].complaint(model.sign_width[joint]):
        return []
    forms = kind.candidates(model.robot, joint, **width)
    return [*{form.text: form for form in forms}.values()]


def _keys_of(model: Model) -> set[Key]:
    """Return the keys of the effects of a model, and of those that they hold as special
    cases: (name, joint from 0, or None for the robot).

    Effects that may come several times on a joint are left out, since more can be
    added.
    """
    types = effect_types()
    return {
        (name, joint)
        for effect in model.effects
        if not effect.several
        for name in (effect.name, *effect.generalises)
        for joint in ((None,) if types[name].whole_robot else effect.joints)
    }


class _Shown:
    """Tells whether the logged rows can show an effect at all.

    They do if all that the effect needs was measured (temperature, motor encoders), and
    if the travelled range is enough to tell it from others, whatever its size.
    """

    def __init__(self, rows: SegmentedRuns) -> None:
        """Collect what the rows show: temperatures, motor encoders, and the range of
        states that each joint covers.
        """
        motions = [s.motion for s in rows.segments]
        self.has_temperature = all(m.temperature is not None for m in motions)
        self.has_motors = all(m.motors is not None for m in motions)
        self.coverage = [rows.coverage(joint) for joint in range(rows.n)]

    def __call__(self, effect: Effect) -> bool:
        """Return whether the rows can show the effect, and tell it from others.

        ``looks_like`` gives a reason for doubt: what else would look the same in the
        covered range. The size 0 stands for an effect whose size is not known yet.
        """
        if effect.needs_temperature and not self.has_temperature:
            return False
        return not effect.looks_like(0.0, self.coverage[effect.joints[0]])


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
    basis = span(data.X[joint])
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
