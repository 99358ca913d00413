"""Which candidates there are: every effect on every joint or on the robot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterator

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
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.segments import SegmentedRuns


def list_candidates(data: WhiteData) -> Library:
    """Every effect on every joint or on the robot, with the shape constants that its file
    says a search begins with; and the model's own with other constants.

    What is special about an effect (a plausible size, a sign, a plainer form, whether it
    needs a standstill to show) is said in its file and nowhere else. What passes for
    something else in these rows by what its file says (a ripple of less than a wave) is
    no candidate there.
    """
    groups = dict[Hashable, list[tuple[Candidate, dict[int, Array]]]]()
    for form in (*effect_candidates(data), *own_constant_candidates(data)):
        white = white_candidate(data, form)
        if white:
            key = form.key if form.replaces_own_constant else None
            joints = tuple(sorted(white))
            group = joints, form.n_coefficients, depends(form.effect), key
            groups.setdefault(group, []).append((form, white))
    batches = []
    for pairs in groups.values():
        forms, columns = zip(*pairs, strict=True)
        batches.append(
            Batch.of(
                tuple(sorted(columns[0])),
                forms,
                columns,
            )
        )
    laws = {f.discrete_choice: f for b in batches for f in b.forms}
    return Library(tuple(batches), Counter(f.key for f in laws.values()))


def effect_candidates(data: WhiteData) -> Iterator[Candidate]:
    """Every effect of the library.

    What the model already has on a joint is left out, unless it is held fixed and may
    have changed.
    """
    rows = data.rows
    model = data.estimate.model
    taken = set[Key]() if data.frozen else _keys_of(model)
    start = min(float(s.motion.t[0]) for s in rows.segments)
    stands = np.mean(rows.still > 0.5, axis=0) > STANDS
    is_shown = _Shown(rows)
    for name, kind in effect_types().items():
        if kind.frozen_only and not data.frozen:
            continue
        if kind.needs_motors and not is_shown.has_motors:
            continue
        for joint in (None,) if kind.whole_robot else range(rows.n):
            key = name, joint
            if key in taken or (kind.at_rest == "holds" and not stands[joint]):
                continue
            for effect in kind.candidates(model.robot, joint, start):
                if is_shown(effect):
                    yield Candidate(key, effect)


def _keys_of(model: Model) -> set[Key]:
    """Of the effects that a model has, but those that may come several times."""
    out = set[Key]()
    for effect in model.effects:
        if effect.whole_robot and not effect.several:
            out.add((effect.name, None))
        elif not effect.several:
            out |= {(effect.name, j) for j in effect.joints}
    return out


class _Shown:
    """Whether rows show an effect: what it needs was measured, and nothing else passes
    for it, whatever its size."""

    def __init__(self, rows: SegmentedRuns) -> None:
        motions = [s.motion for s in rows.segments]
        self.has_temperature = all(m.temperature is not None for m in motions)
        self.has_motors = all(m.motors is not None for m in motions)
        self.coverage = [rows.seen(joint) for joint in range(rows.n)]

    def __call__(self, effect: Effect) -> bool:
        if effect.needs_temperature and not self.has_temperature:
            return False
        return not effect.looks_like(0.0, self.coverage[effect.joints[0]])
