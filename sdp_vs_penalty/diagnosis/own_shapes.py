"""The shape constants of the model's own effects: a wrong one must not be taken for a missing effect.

Whatever a search adds is judged beside the constants that explain most: they are profiled on the
search's white rows before the first name is given, and again beside the picks.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.ladder import TOLD_APART
from sdp_vs_penalty.diagnosis.library import Group, spread_columns
from sdp_vs_penalty.diagnosis.stage import MISFIT, white_rows
from sdp_vs_penalty.diagnosis.state import Pick, SearchState
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.shape import Shape
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.shape_profiles import (
    Normal,
    ShapeBank,
    ShapeEstimate,
    alone,
    beside,
    best_shapes,
    fitted,
    with_shapes,
)
from sdp_vs_penalty.robot.arrays import Array

#: A constant that moves by less than this share makes no other columns.
_MOVES = 0.05
#: Values between which a constant is looked for that has no range of its own to be profiled over.
_AROUND = 2.0 ** np.linspace(-2.0, 2.0, 7)
_ROUNDING = 1e-6
#: Turns in which a constant and the sign in the columns beside it are made the same.
_ALIGNED = 2
#: How many candidates a constant is tried with.
_PARTNERS = 3
#: How many values are tried beyond a range.
_WIDE = 9


#: Effect, joint and name of a shape constant.
Key = tuple[str, int, str]


@dataclass(frozen=True)
class _Own:
    """A shape constant of the model on one joint: its effect there, its place in theta."""

    effect: Effect
    joint: int
    name: str
    theta: NDArray[np.intp]

    @property
    def key(self) -> Key:
        return self.effect.name, self.joint, self.name


#: A constant with the values to try, the ends of its range, and what it is compared with.
Tried = tuple[_Own, Array, tuple[float, float], float]


def profiled(first: Estimate, now: Estimate, state: SearchState) -> list[ShapeEstimate]:
    """Every shape constant of the model, as it explains most beside the picks of a search.

    first : the model as it was given, whose constants are the ``before``; now : that of the state.
    """
    own, before = _constants(now), _values_of(first)
    if not own:
        return []
    most = _turned_by(state)
    tried = [(o, *_values(o, before[o.key], most.get(o.joint, np.inf)), before[o.key]) for o in own]
    # The picks' own constants are as free: one would hide what another gets wrong.
    picked = {id(p): _picked(p.candidate.effect) for p in state.picks}
    tried += [(o, *_values(o, v := o.effect.shape[o.name]), v) for o in picked.values() if o]
    rest = [p for p in state.picks if not picked[id(p)]]
    data, banks, base = _compressed(now, state, rest, tried)
    return best_shapes(data, base, banks, 1.0)[: len(own)]


def beside_the_best(first: Estimate, now: Estimate, state: SearchState) -> list[ShapeEstimate]:
    """The constants of joints whose error they alone do not explain, each as it explains most together
    with any one candidate on that joint: a constant that takes what it can of another effect's torque
    would spoil the choice between effects."""
    before, out = _values_of(first), []
    for own in _constants(now):
        unexplained = state.base.weighting.level[own.joint] ** 2 > MISFIT
        if _shape(own).role == "estimated" and unexplained:
            value = _beside_one(now, state, own)
            out.append(ShapeEstimate(*own.key, before[own.key], value, np.inf, 0.0, False))
    return out


def _beside_one(now: Estimate, state: SearchState, own: _Own) -> float:
    """The value of one constant that explains most together with the best candidate on its joint."""
    stage, j, value = state.stage, own.joint, own.effect.shape[own.name]
    values, ends = _values(own, value)
    data, (bank,), base = _compressed(now, state, (), [(own, values, ends, value)], joint=j)
    start = bank.columns.max() + 1
    pool = np.concatenate([bank.columns.ravel(), np.arange(start, len(data.right))])
    rest = beside(data, pool, np.eye(len(data.right))[:, base])
    here = int(np.argmin(np.abs(np.log(values / value))))
    groups = [g for g in stage.white.groups if g.joint == j]
    taken = _with_each(rest, len(values), here, groups)
    trials: dict[Hashable, tuple[float, float]] = {}
    for g in np.argsort(-taken.max(axis=1, initial=0.0)) if taken.size else ():
        effect = groups[g].effect
        partner = _picked(effect)
        fixed = tuple(v for k, v in effect.shape.items() if partner is None or k != partner.name)
        which = effect.name, fixed
        if which in trials or len(trials) == _PARTNERS:
            continue
        if partner is None:
            k = int(np.argmax(taken[g]))
            (alike,) = rest.taken(np.r_[k, len(values) + np.r_[groups[g].columns]][None])
            trials[which] = rest.square - float(alike), float(values[k])
            continue
        begin = {float(values[np.argmax(taken[g])]), value}
        trials[which] = min(_together(now, state, own, partner, v) for v in begin)
    return min(trials.values(), default=(0.0, value))[1]


def _together(
    now: Estimate, state: SearchState, own: _Own, partner: _Own, value: float
) -> tuple[float, float]:
    """The squared error that a constant leaves with a candidate beside it, and the constant: the
    candidate's own constant is as free, and its sign turns as the constant says."""
    values, ends = _values(own, own.effect.shape[own.name])
    error = np.inf
    for _ in range(_ALIGNED):
        was = partner.effect.shape[partner.name]
        tried = [(own, values, ends, value), (partner, *_values(partner, was), was)]
        data, banks, base = _compressed(now, state, (), tried, width=value)
        found = best_shapes(data, base, banks, 1.0)
        error = data.left(fitted(data, base, banks, [f.after for f in found]))
        value, other = (f.after for f in found)
        if partner.name == partner.effect.beyond_turning and other < value:
            return np.inf, value  # no law of its own: both say how dry friction turns round
        partner = replace(partner, effect=alone(partner.effect, own.joint, **{partner.name: other}))
    return error, value


def _with_each(rest: Normal, count: int, here: int, groups: Sequence[Group]) -> Array:
    """(G, count) what each value of a constant, in the first columns, takes together with each group,
    whose columns come behind. Columns with a sign hold it as it turns ``here``, where the constant is:
    one more of those lets them do without."""
    taken = np.zeros((len(groups), count))
    for size in {g.k for g in groups}:
        which = [i for i, g in enumerate(groups) if g.k == size]
        own = count + np.array([np.r_[groups[i].columns] for i in which])
        for k in range(count):
            shapes = np.tile([here] if k == here else [k, here], (len(own), 1))
            taken[which, k] = rest.taken(np.hstack([shapes, own]))
    return taken


def widened(first: Estimate, now: Estimate, state: SearchState) -> list[ShapeEstimate]:
    """Constants beyond their range, each in the place of a pick that says the same with two laws.

    A sigmoid that takes all of the Coulomb friction is Coulomb friction that turns over a wide velocity:
    where the one law explains as much, it is named.
    """
    before, out = _values_of(first), []
    for pick in state.picks:
        effect = pick.candidate.effect
        if not effect.widens:
            continue
        here = [o for o in _constants(now) if o.joint == pick.candidate.key[1]]
        for own in (o for o in here if o.effect.name in effect.refines):
            shape = _shape(own)
            if shape.earned is None:
                continue
            others = [p for p in state.picks if p is not pick]
            low = 0.25 * shape.grid[-1]
            wide = np.geomspace(low, shape.earned, _WIDE), (low, shape.earned)
            data, (bank,), base = _compressed(now, state, others, [(own, *wide, low)], [pick])
            size = len(data.right)
            both = np.r_[base, bank.columns[0], size - pick.candidate.columns.shape[1] : size]
            (found,) = best_shapes(data, base, [bank], 1.0)
            alone_takes = data.part(np.r_[base, bank.columns[0]]).least() - found.gain
            # In units of the noise: error that nothing explains would make anything seem alike.
            noise = state.base.weighting.level[own.joint] ** 2
            if noise * (alone_takes - data.part(both).least()) < TOLD_APART:
                out.append(replace(found, before=before[own.key]))
    return out


def doubted(first: Estimate, now: Estimate, state: SearchState) -> Iterator[SearchState]:
    """The search without the picks that may only mend a constant gone astray, if there are any: first
    without those that turn over velocities, like the constant, then without those with a memory, too, on
    joints whose constant has moved.

    A constant is first profiled beside a joint's other errors, which may carry it away from where it is
    with all of them explained: a law of the same velocities and the constant then make good each other.
    """
    joints, laws = moved(first, now), {(o.effect.name, o.joint) for o in _constants(now)}
    own = [(p, p.candidate.effect, _picked(p.candidate.effect)) for p in state.picks]
    mending = [(p, e, o.joint) for p, e, o in own if o and any((n, o.joint) in laws for n in e.refines)]
    turning = [p for p, e, _ in mending if not e.has_memory]
    both = [p for p, e, j in mending if j in joints or not e.has_memory]
    for out in (turning, both) if len(both) > len(turning) else (turning,):
        if out:
            yield state.with_picks([p for p in state.picks if not any(p is o for o in out)])


def _compressed(
    now: Estimate,
    state: SearchState,
    picks: Sequence[Pick],
    tried: Sequence[Tried],
    apart: Sequence[Pick] = (),
    joint: int | None = None,
    width: float | None = None,
) -> tuple[Normal, list[ShapeBank], NDArray[np.intp]]:
    """White rows of all columns but those of the constants that are ``tried``, of the picks, of each
    constant's bank, of the picks ``apart``, and of all candidates on one ``joint``; the banks; the
    columns before them. width : over which signs turn in what is tried, if not as in the model."""
    stage = state.stage
    free = np.unique(np.concatenate([o.theta for o, *_ in tried]))
    kept = np.setdiff1d(np.arange(stage.columns.shape[2]), free)
    runs = stage.rows
    if width is not None:
        runs = runs.with_model(lambda motion: replace(motion, sign_width=width))
    own, y = stage.white_rows
    y = y + own[:, free] @ now.theta[free]
    picked = [p.candidate.columns for p in picks]
    first = len(kept) + sum(c.shape[1] for c in picked)
    base, parts, banks = np.arange(first), list[Array](), list[ShapeBank]()
    for o, values, ends, was in tried:
        shapes = [alone(o.effect, o.joint, **{o.name: float(v)}) for v in values]
        parts += [spread_columns(runs, effect) for effect in shapes]
        places = first + np.arange(len(values) * len(o.effect.parameters)).reshape(len(values), -1)
        first += places.size
        banks.append(ShapeBank(o.effect, o.joint, o.name, values, was, places, ends))
    white, _ = white_rows(stage.rows, stage.noise, np.concatenate(parts, axis=2), stage.residual)
    last = [p.candidate.columns for p in apart]
    if joint is not None:
        n, M = white.shape[0] // len(stage.rows.t), len(stage.rows.t)
        candidates = np.zeros((n, M, stage.white.joints[joint].shape[1]))
        candidates[joint] = stage.white.joints[joint]
        last.append(candidates.reshape(n * M, -1))
    rows = np.hstack([own[:, kept], *picked, white, *last])
    level = state.base.weighting.level[:, None]
    rows = rows.reshape(len(level), len(stage.rows.t), -1) / level[:, :, None]
    return Normal.of(rows, y.reshape(rows.shape[:2]) / level), banks, base


def adopted(now: Estimate, state: SearchState, found: Sequence[ShapeEstimate]) -> Estimate | None:
    """The model with these constants, refitted beside the picks; None where none of them moves."""
    current = _values_of(now)
    steps = [np.log(s.after / current[s.effect, s.joint, s.shape]) for s in found]
    return refitted_beside(now, state, found) if np.any(np.abs(steps) > _MOVES) else None


def refitted_beside(now: Estimate, state: SearchState, found: Sequence[ShapeEstimate] = ()) -> Estimate:
    """The model refitted beside the picks, with other constants."""
    stage = state.stage
    model = replace(now.model, effects=with_shapes(now.model.effects, found))
    columns, moved = stage.columns.copy(), np.zeros(len(now.theta), bool)
    for effect, indices in zip(model.effects, model.indices, strict=True):
        if any(s.effect == effect.name and s.joint in effect.joints for s in found):
            columns[:, :, indices] = spread_columns(stage.rows, effect)
            moved[indices] = True
    change = columns[:, :, moved] - stage.columns[:, :, moved]
    residual = stage.residual - (change @ now.theta[moved]).T
    # What is known beforehand only would let the links run away: their columns are nearly its own.
    effects = [p.candidate.effect for p in state.picks]
    picks = [spread_columns(stage.rows, e) for e in effects if e.plausible is None]
    refitted = replace(stage, columns=columns, residual=residual)
    step = refitted.least_squares(np.concatenate([columns, *picks], axis=2), balanced=True)
    return replace(now, model=model, theta=now.theta + step[: len(now.theta)])


def moved(before: Estimate, after: Estimate) -> frozenset[int]:
    """The joints on which a shape constant of the model has changed."""
    old, new = _values_of(before), _values_of(after)
    return frozenset(key[1] for key, value in new.items() if abs(np.log(value / old[key])) > _MOVES)


def given_again(first: Estimate, now: Estimate, joints: Collection[int]) -> list[ShapeEstimate]:
    """The constants on some joints as the model was given."""
    before = _values_of(first)
    own = [(key, before[key]) for key in _values_of(now) if key[1] in joints and key in before]
    return [ShapeEstimate(*key, value, value, np.inf, 0.0, False) for key, value in own]


def _constants(estimate: Estimate) -> list[_Own]:
    model, out = estimate.model, []
    for effect, indices in zip(model.effects, model.indices, strict=True):
        if effect.whole_robot or effect.spreads or effect.several or effect.joins:
            continue
        k = len(indices) // len(effect.joints)
        for key in effect.searched:
            if effect.shapes[key].bounds is None:
                continue
            out += [
                _Own(alone(effect, joint), joint, key, indices[k * m : k * m + k])
                for m, joint in enumerate(effect.joints)
            ]
    return out


def _picked(effect: Effect) -> _Own | None:
    """The continuous shape constant of a candidate on one joint, if it has one."""
    if effect.several or effect.joins or len(effect.joints) != 1 or len(effect.parameters) != 1:
        return None
    names = (k for k in effect.searched if effect.shapes[k].bounds and effect.shapes[k].scale == "log")
    name = next(names, None)
    return None if name is None else _Own(effect, effect.joints[0], name, np.arange(0))


def _values_of(estimate: Estimate) -> dict[Key, float]:
    return {o.key: o.effect.shape[o.name] for o in _constants(estimate)}


def _shape(own: _Own) -> Shape:
    return own.effect.shapes[own.name].on(own.effect.robot.joints[own.joint].kind)


def _turned_by(state: SearchState) -> dict[int, float]:
    """The least velocity, by joint, of picks that are laws of their own only beyond the turning."""
    effects = [p.candidate.effect for p in state.picks if p.candidate.effect.beyond_turning]
    found = sorted(((e.shape[e.beyond_turning], e.joints[0]) for e in effects), reverse=True)
    return {joint: value for value, joint in found}


def _values(own: _Own, was: float, most: float = np.inf) -> tuple[Array, tuple[float, float]]:
    """The values to profile a constant over, with that of the given model, and the ends of its range;
    most : what it is at most, unless it is more already."""
    shape, value = _shape(own), own.effect.shape[own.name]
    assert shape.bounds is not None
    low, high = shape.bounds
    high = max(min(high, most), *(v for v in (was, value, 2.0 * low) if v <= high))
    if shape.role == "estimated" and value <= shape.bounds[1] * (1.0 + _ROUNDING):
        return _among(np.array([*(v for v in shape.grid if v < high), high]), was), (low, high)
    # What was found wide once has earned it: it stays in its neighbourhood.
    ends = min(low, value), max(shape.earned or high, value)
    around = value * _AROUND if shape.scale == "log" else value + np.linspace(-0.6, 0.6, 7)
    return _among(np.unique(np.clip(around, *ends)), was), ends


def _among(values: Array, was: float) -> Array:
    """The values with one more among them, in the place of those that are next to equal to it."""
    return np.sort(np.append(values[np.abs(np.log(values / was)) > 0.02], was))
