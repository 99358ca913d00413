"""Facts about the channels of a run."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.constants import LOCKSTEP, STUCK, TIMES
from sdp_vs_penalty.checks.glance import READ, Rows, RunSummary
from sdp_vs_penalty.checks.issue import EXPLANATION, Issue, joints_text
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.plausibility import beside_range, far_outside
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.encoder import lattice_step
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.runs import spans
from sdp_vs_penalty.signals.spectrum import highest_harmonic


def never_a_number(g: RunSummary) -> Iterator[Issue]:
    """Channels that hold no number in any row: no row can be saved by deleting others."""
    for name, x in g.run.groups.items():
        for j in np.flatnonzero(~np.any(np.isfinite(x), axis=0)):
            yield Issue.of(
                kind="channel without numbers",
                severity="error",
                joints=[j],
                what=f"{name}{j + 1} is never a number, in any of {len(x)} rows.",
                certainty=READ,
                remedy="find out why the logger wrote none (a driver that does not"
                " report it); there is no repair",
                where=f"{name}{j + 1}",
            )


def wrapped(g: RunSummary) -> Iterator[Issue]:
    """A revolute position that jumps by a turn from one row to the next: by 2 pi, or by
    360, which says that it is in degrees as well."""
    steps = np.abs(np.diff(g.run.q, axis=0))
    turns = np.array([joint.kind == "revolute" for joint in g.robot.joints])
    in_degrees = turns & _jumps_by(steps, 360.0)
    if in_degrees.any():
        yield from _degrees(g, turns, " and wrapped at 360", unwrap=True)
        return
    jumping = turns & _jumps_by(steps, 2.0 * np.pi)
    if jumping.any():
        what = (
            "the position of {where} jumps by a full turn between two rows: the angle"
            " is wrapped."
        )
        yield Issue.of(
            kind="wrapped angle",
            severity="error",
            joints=np.flatnonzero(jumping),
            what=what,
            certainty=READ,
            remedy="unwrap the angle",
            repair=lambda r: replace(
                r, q=np.where(jumping, np.unwrap(r.q, axis=0), r.q)
            ),
        )


def _jumps_by(steps: Array, turn: float) -> Rows:
    """(n,) whether some step of a channel is a turn, and its usual ones are far less."""
    near = np.abs(steps - turn) < 0.05 * turn
    return np.any(near, axis=0) & (np.median(steps, axis=0) < 0.05 * turn)


def _degrees(
    g: RunSummary,
    turns: Rows,
    how: str,
    unwrap: bool,
) -> Iterator[Issue]:
    """All revolute positions in degrees, their jumps by a turn undone."""
    joints = np.flatnonzero(turns)
    reach = float(np.abs(g.run.q[:, joints]).max())
    remedy = "multiply q (and dq) by pi / 180"
    if unwrap:
        remedy = "unwrap q and multiply it by pi / 180"
    yield Issue.of(
        kind="positions in degrees",
        severity="error",
        joints=joints,
        what=f"the positions of {{where}} are in degrees{how}: they reach {reach:.4g}.",
        certainty=READ,
        remedy=f"{remedy} (`convert --units q=deg`)",
        repair=partial(_in_radians, robot=g.robot, turns=turns, unwrap=unwrap),
    )


def _in_radians(
    run: Measurements,
    robot: Robot,
    turns: Rows,
    unwrap: bool,
) -> Measurements:
    """The run with revolute positions in radians, and velocities that are in degrees
    as well."""
    factor = float(np.radians(1.0))
    q = run.q * factor
    if unwrap:
        q = _into_range(robot, np.unwrap(run.q, period=360.0, axis=0) * factor)
    q = np.where(turns, q, run.q)
    if run.dq is None:
        return replace(run, q=q)
    logged = np.abs(run.dq).sum(axis=0)
    derived = np.abs(np.gradient(q, run.t, axis=0)).sum(axis=0)
    in_degrees = turns & (logged > 8.0 * derived)
    return replace(
        run,
        q=q,
        dq=np.where(in_degrees, run.dq * factor, run.dq),
    )


def _into_range(robot: Robot, q: Array) -> Array:
    """(N, n) angles by whole turns nearer to the middles of the joints' ranges."""
    low = np.array([joint.lower for joint in robot.joints])
    high = np.array([joint.upper for joint in robot.joints])
    has_range = np.isfinite(high - low)
    middle = 0.5 * (np.where(has_range, low, 0.0) + np.where(has_range, high, 0.0))
    turns = np.round((np.median(q, axis=0) - middle) / (2.0 * np.pi))
    return np.asarray(q - 2.0 * np.pi * turns)


def degrees(g: RunSummary) -> Iterator[Issue]:
    """Positions that are far outside the joints' ranges, and inside them as degrees."""
    turns = np.array([joint.kind == "revolute" for joint in g.robot.joints])
    far = far_outside(g.robot, g.run.q)
    if len(far) and turns[list(far)].all():
        q = np.where(
            turns,
            np.radians(g.run.q),
            g.run.q,
        )
        if not far_outside(g.robot, q) and len(far) * 2 > turns.sum():
            yield from _degrees(g, turns, "", unwrap=False)


def lockstep(g: RunSummary) -> Iterator[Issue]:
    """Joints that move in proportion: what one of them does, the others do as well."""
    moving = np.flatnonzero(g.moving)
    if len(moving) < 2:
        return
    together = lockstep_groups(g.run.q[:, moving])
    if not together:
        return
    groups = [[int(moving[k]) for k in group] for group in together]
    joints = sorted(j for group in groups for j in group)
    rank = motion_rank(g.run.q[:, moving])
    names = "; ".join(joints_text(group) for group in groups)
    yield Issue.of(
        kind="lockstep motion",
        severity="warning",
        joints=joints,
        what=f"{names} move in proportion (|correlation| above {LOCKSTEP:g}): the"
        f" motion of {len(moving)} joints has {rank} directions. Their order cannot be"
        " told, nor what belongs to which of them.",
        certainty="certain: read from the positions",
        remedy="move each joint by a signal of its own",
        rank=rank,
        moving=len(moving),
        groups=[[j + 1 for j in group] for group in groups],
    )


def lockstep_groups(q: Array) -> list[list[int]]:
    """Groups of columns of positions (N, n) that correlate with the first of the group;
    no column is in two groups."""
    size = np.std(q, axis=0)
    z = (q - q.mean(axis=0)) / nonzero_or_one(size)
    is_proportional = np.abs(z.T @ z / len(z)) > LOCKSTEP
    groups: list[list[int]] = []
    left = list(range(q.shape[1]))
    while left:
        first = left[0]
        group = [k for k in left if k == first or is_proportional[first, k]]
        left = [k for k in left if k not in group]
        groups += [group] if len(group) > 1 else []
    return groups


def motion_rank(q: Array) -> int:
    """How many directions hold 99.9 % of the variance of positions (N, n), each in
    units of its own scatter."""
    z = (q - q.mean(axis=0)) / nonzero_or_one(np.std(q, axis=0))
    power = np.linalg.svd(z, compute_uv=False) ** 2
    return int(np.searchsorted(np.cumsum(power) / power.sum(), 0.999) + 1)


def idle(g: RunSummary) -> Iterator[Issue]:
    """Joints that never move, or all of them."""
    sure = "certain: the positions change by noise only"
    joints = np.flatnonzero(~g.moving)
    if not g.moving.any():
        what = (
            "no joint moves: these data contain only static friction and the weight in"
            " one pose."
        )
        remedy = "record a motion of all joints"
        yield Issue.of(
            kind="no motion",
            severity="error",
            joints=joints,
            what=what,
            certainty=sure,
            remedy=remedy,
            where="all joints",
        )
    elif len(joints):
        what = (
            "{where} never moves: friction and inertia about that axis are not"
            " identifiable, and the torque there is stiction."
        )
        remedy = "move every joint, or add a run that does"
        yield Issue.of(
            kind="idle joints",
            severity="warning",
            joints=joints,
            what=what,
            certainty=sure,
            remedy=remedy,
        )


def beside(g: RunSummary) -> Iterator[Issue]:
    if joints := beside_range(g.robot, g.run.q):
        yield Issue.of(
            kind="encoder offset",
            severity="warning",
            joints=joints,
            what="{where}: positions outside the range all or part of the time.",
            certainty="likely: outside what the joint can reach, certainly; its zero is"
            " the usual cause",
            remedy="correct the zeros of these joints: the travel fits the range",
        )


def torques(g: RunSummary) -> Iterator[Issue]:
    """Channels that never change, that are clipped, or that lost their sign."""
    unsigned = []
    for j, x in enumerate(g.run.tau.T):
        if not np.ptp(x):
            yield _dead(g, j, float(x[0]))
            continue
        yield from _clipped(g, j, x)
        if g.moving[j] and _is_unsigned(x, g.run.q):
            unsigned.append(j)
    if unsigned:
        yield Issue.of(
            kind="torque magnitude",
            severity="warning",
            joints=unsigned,
            what="{where} never changes sign: the logger wrote magnitudes.",
            certainty="likely: a torque that is as near to zero as often is below it, too",
            remedy="log the torque with its sign",
            where=", ".join(f"tau{j + 1}" for j in unsigned),
            nature=EXPLANATION,
        )


def _dead(g: RunSummary, j: int, value: float) -> Issue:
    """A torque of joint j (from 0) that never changes. Of a joint that rests, nothing
    else is to be expected."""
    return Issue.of(
        kind="dead channel",
        severity="error" if g.moving[j] else "note",
        joints=[j],
        what=f"tau{j + 1} is {value:g} {g.robot.torque_units[j]} in every row.",
        certainty=READ,
        remedy="find out why the logger wrote a constant",
        where=f"tau{j + 1}",
    )


def _clipped(
    g: RunSummary,
    j: int,
    x: Array,
) -> Iterator[Issue]:
    """A torque that stays exactly at its largest value, and is never constant
    elsewhere."""
    parts = spans(np.diff(x) == 0.0)
    lengths = np.diff(parts)[:, 0] + 1
    values = x[parts[:, 0]]
    is_end = np.isin(values, (x.min(), x.max()))
    elsewhere = int(lengths[~is_end].max(initial=1))
    longest = int(lengths[is_end].max(initial=1))
    if longest < max(TIMES * elsewhere, STUCK):
        return
    value = float(values[np.argmax(lengths * is_end)])
    yield Issue.of(
        kind="saturation",
        severity="warning",
        joints=[j],
        what=f"tau{j + 1} is stuck at {value:.6g} {g.robot.torque_units[j]} for up to"
        f" {longest} consecutive samples ({np.sum(x == value)} in total): the channel is"
        " clipped.",
        certainty=f"likely: elsewhere it is never constant for more than {elsewhere}"
        " samples",
        remedy="record again with a larger range, or slower; delete those rows until"
        " then",
        where=f"tau{j + 1}",
        limit=value,
    )


#: Least range of a corner's values, over the height below which it is looked at.
_CORNER_RANGE = 0.7
#: Least mean of a corner's values over that height: of a corner it is 1/2, of a parabola
#: that touches zero 1/3.
_CORNER_MEAN = 0.38
#: Poses of which no joint is farther apart, over the scatter of its positions, are one.
_ONE_POSE = 0.1


def _is_unsigned(torque: Array, q: Array) -> bool:
    """Whether a torque (N,) comes near zero often, and turns back in corners there; q (N,
    n) : positions.

    "Near" is a fifth of the largest torque. A stretch near zero is a corner where its
    values come down from there to within one usual step of zero, which happens by chance
    with odds of that step to the fifth, and their mean is that of a corner. A constant
    level near zero, as of a coarse current at rest, has no such range. Corners in one
    pose, as of a motion that repeats itself, are one.
    """
    if not 0.0 <= torque.min() <= 0.01 * torque.max():
        return False
    steps = np.abs(np.diff(torque))
    near = 0.2 * float(torque.max())
    step = min(float(np.median(steps[steps > 0.0])), near)
    scale = nonzero_or_one(q.std(axis=0))
    poses: list[Array] = []
    for first, end in spans(torque < near):
        part = torque[first:end]
        touches = 0.0 < part.min() < step
        comes_down = np.ptp(part) > _CORNER_RANGE * near
        if touches and comes_down and part.mean() > _CORNER_MEAN * near:
            pose = q[first + np.argmin(part)] / scale
            if all(np.abs(pose - other).max() > _ONE_POSE for other in poses):
                poses.append(pose)
    return bool(len(poses) * np.log(near / step) > c.ODDS)


def counts(g: RunSummary) -> Iterator[Issue]:
    """Torques that are whole numbers in every row and channel: no sensor's N m."""
    tau = g.run.tau[:, g.moving]
    n_values = [len(np.unique(x)) for x in tau.T]
    if np.all(tau == np.round(tau)) and np.min(n_values) > 20:
        largest = float(np.abs(tau).max())
        yield Issue.of(
            kind="torque in counts",
            severity="warning",
            joints=(),
            what=f"every torque is a whole number, up to {largest:.4g}: counts of the drive"
            + (", as permil of its rated torque." if largest <= 4000.0 else "."),
            certainty="likely: the whole numbers are read from the file, not what they"
            " count",
            remedy="multiply each channel by its rated torque / 1000 (or its gain, gear"
            " ratio included); otherwise the model's ratios are right for a joint, its"
            " kilograms are not",
            where="all torque channels",
            largest=largest,
        )


def coarse(
    g: RunSummary,
    motion: Motion,
    settings: Preprocessing,
) -> Iterator[Issue]:
    """Whether the motion's fastest part is sampled often enough to be differentiated
    twice, in positions fine enough for the accelerations of a motion behind the filter
    of these settings."""
    rate = 1.0 / g.step
    highest = highest_harmonic(g.run)
    needed = c.SAMPLES_A_PERIOD * highest
    if rate < needed:
        yield Issue.of(
            kind="low sample rate",
            severity="warning",
            joints=(),
            what=f"the motion reaches {highest:.3g} Hz, and {rate:.3g} samples per second"
            f" are too few to differentiate it twice: {needed:.0f} Hz are needed.",
            certainty="certain: from the spectrum of the positions",
            remedy="log faster, or move slower",
            where="column t",
            rate_hz=rate,
            needed=needed,
        )
    assert settings.state_cutoff is not None
    sizes = motion.ddq.std(axis=0)
    for j in np.flatnonzero(g.moving).tolist():
        yield from _quantised(
            g,
            j,
            float(sizes[j]),
            settings.state_cutoff,
        )


def _quantised(
    g: RunSummary,
    j: int,
    size: float,
    cutoff: float,
) -> Iterator[Issue]:
    """Rounding errors of one position beside its acceleration's size.

    They renew themselves when the level changes; the part below the cut-off [Hz] stays,
    and a second derivative weighs its power with (2 pi f)^4.
    """
    x = g.run.q[:, j]
    step = lattice_step(x)
    n_changes = max(int(np.count_nonzero(np.diff(x))), 1)
    lasts = g.step * len(x) / n_changes
    share_below = max(1.0, 0.5 / (cutoff * lasts))
    noise = (2.0 * np.pi * cutoff) ** 2 * step / np.sqrt(60.0 * share_below)
    if not noise > c.TYPICAL["link"] * size > 0.0:
        return
    yield Issue.of(
        kind="quantisation",
        severity="warning",
        joints=[j],
        what=f"q{j + 1} is quantised in steps of {step:.3g} {g.robot.position_units[j]}:"
        f" noise of about {100.0 * noise / size:.0f} % of the acceleration below"
        f" {cutoff:.3g} Hz.",
        certainty="likely: the steps are read from the file, the noise is estimated",
        remedy="log more digits, or move faster",
        where=f"q{j + 1}",
        step=step,
    )
