"""What does not move: joints that are held, and rows that are poses."""

from collections.abc import Iterator

import numpy as np

from sdp_vs_penalty.checks.certainty import stated, told_by
from sdp_vs_penalty.checks.glance import RunSummary
from sdp_vs_penalty.checks.issue import Issue, Left, make_issue, make_refusal
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import nonzero_or_one

#: Poses are taken so long apart at least [s], and from row to row a joint goes so far [-] of
#: its range: a motion that can be differentiated has over twenty rows a stroke.
_APART = 0.5
_STROKE = 0.05


def find_static_poses(glance: RunSummary) -> Iterator[Issue]:
    """Yield an error where each row is a pose by itself: rows are far apart in time, and
    from one to the next a joint goes as far as a motion does in twenty."""
    if glance.usual_step < _APART:
        return
    steps = np.median(np.abs(np.diff(glance.run.q, axis=0)), axis=0)
    share = float(np.max(steps / nonzero_or_one(np.ptp(glance.run.q, axis=0))))
    if share < _STROKE:
        return
    error = InputError(
        f"the {len(glance.run.t)} rows are static poses, {glance.usual_step:.3g} s apart:"
        f" from row to row a joint goes {100.0 * share:.0f} % of its range, and how it"
        " moves is not in the log",
        "record motions: static poses contain the weight (masses times centres of mass)"
        " and offsets alone, no inertia and no friction",
        glance.run.names[0],
    )
    sure = told_by(
        "a motion has over twenty rows from one end of a stroke to the other"
    )
    yield make_refusal("static poses", error, sure, left=Left.NOTHING)


def find_idle_joints(glance: RunSummary) -> Iterator[Issue]:
    """Yield an error where no joint moves, or a warning about joints that never do."""
    sure = stated("the positions change by noise, or give way to the others, only")
    joints = np.flatnonzero(~glance.moving)
    if not glance.moving.any():
        what = (
            "no joint moves: these data contain only static friction and the weight in"
            " one pose."
        )
        remedy = "record a motion of all joints"
        yield make_issue(
            kind="no motion",
            severity="error",
            joints=joints,
            what=what,
            certainty=sure,
            remedy=remedy,
            where="all joints",
            left=Left.FACTS,
        )
    elif len(joints):
        farthest = float(np.ptp(glance.run.q[:, joints], axis=0).max())
        what = (
            f"no motion of {{where}} (at most {farthest:.2g}, held beside the others):"
            " friction and inertia about that axis are not identifiable, and the torque"
            " there is stiction."
        )
        remedy = "move every joint, or add a run that does"
        yield make_issue(
            kind="idle joints", joints=joints, what=what, certainty=sure, remedy=remedy
        )
