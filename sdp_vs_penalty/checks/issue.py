"""What the data check says: one issue a problem."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import partial
from typing import Any, Literal

from sdp_vs_penalty.checks.certainty import CERTAIN, POSSIBLE, RIVAL_EFFECT, told_by
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.race.fault import PositionError, joints_text
from sdp_vs_penalty.race.records import ArmDifference
from sdp_vs_penalty.records import NOT_STORED, WritesJson
from sdp_vs_penalty.results.issue import Certainty, IssueInWords
from sdp_vs_penalty.results.remedy import Change, Remedy

#: The two natures of an issue.
FACT = "fact"
EXPLANATION = "explanation"
#: Which findings of a diagnosis an issue makes doubtful.
DoubtfulFindings = Literal["none", "on its joints", "all"]


class Left(IntEnum):
    """What is left to be judged beside an issue; each level holds those before it."""

    #: Nothing: rows are no measurements of a motion.
    NOTHING = 0
    #: Facts; no dynamics.
    FACTS = 1
    #: Dynamics too, but for the size of each channel's torques.
    RATIOS = 2
    #: Everything.
    ALL = 3


@dataclass(frozen=True, kw_only=True)
class Issue(IssueInWords, WritesJson):
    """One thing that the check has to say of a run, as a sentence and as figures."""

    derived = ("can_fix", "figures", "remedies")

    #: What most likely made it so, in words: likely at most.
    cause: str = ""
    #: How a run is repaired, where that is safe; ``remedy`` says it in words.
    repair: Callable[[Measurements], Measurements] | None = field(
        default=None, metadata=NOT_STORED
    )
    #: Joints that it is about, from 1; () for an issue about no joint.
    joints: tuple[int, ...] = field(default=(), metadata=NOT_STORED)
    #: Instant of what happens in the run [s].
    at: float | None = field(default=None, metadata=NOT_STORED)
    #: Begin and end of what acts for a part of the time [s].
    span: tuple[float, float] | None = field(default=None, metadata=NOT_STORED)
    #: Name of the one run, or the part of it, that differs from the others.
    run: str | None = field(default=None, metadata=NOT_STORED)
    #: How large that difference is, in its own unit.
    size: float | None = field(default=None, metadata=NOT_STORED)
    #: Share of the rows that its repair loses, where that is most of them [-].
    lost_share: float | None = field(default=None, metadata=NOT_STORED)
    #: Logarithm of the odds that the log is so; None for what no race has judged.
    log_odds: float | None = field(default=None, metadata=NOT_STORED)
    #: How probable it is where it or one of ``rivals`` is so.
    probability: float | None = field(default=None, metadata=NOT_STORED)
    #: Effects of the arm that explain the same torques, in words.
    rival_effects: tuple[str, ...] = field(default=(), metadata=NOT_STORED)
    #: Further numbers behind the issue, by name, for JSON.
    numbers: Mapping[str, Any] = field(default_factory=dict, metadata=NOT_STORED)
    #: Gravity that the torques show instead [m/s^2], for an issue about it.
    gravity: tuple[float, ...] | None = None
    #: FACT, which is read from the file, or EXPLANATION, which a model of the arm
    #: gives: it competes with other explanations and is never an error.
    nature: str = FACT
    #: Whether it says that torque channels have another factor.
    is_gain: bool = field(default=False, metadata=NOT_STORED)
    #: What of positions it says is another, beside their unit.
    of_positions: PositionError | None = field(default=None, metadata=NOT_STORED)
    #: Whether columns hold something else than they are read as: their unit, order or sign.
    is_of_columns: bool = field(default=False, metadata=NOT_STORED)
    #: Whether it says that torques are in another unit.
    is_torque_unit: bool = field(default=False, metadata=NOT_STORED)
    #: Whether it explains what the torques of all its joints show.
    explains_joints: bool = field(default=False, metadata=NOT_STORED)
    #: What of the arm is another one in this run; None for an issue about the log.
    arm_difference: ArmDifference | None = field(default=None, metadata=NOT_STORED)
    #: Whether its repair changes positions.
    changes_positions: bool = field(default=False, metadata=NOT_STORED)
    #: Whether its repair gives joints other channels, to which other repairs then refer.
    changes_order: bool = field(default=False, metadata=NOT_STORED)
    #: Whether logged velocities are in a unit that repaired positions do not have.
    is_velocity_unusable: bool = field(default=False, metadata=NOT_STORED)
    #: What is left to be judged beside it.
    left: Left = field(default=Left.ALL, metadata=NOT_STORED)
    #: Word of `check --fix --apply` for the repair.
    apply: str = ""
    #: What explains as much, in words.
    equivalents: tuple[str, ...] = ()
    #: What of it a change of all rows mends as well as this: one of them is so. A repair of
    #: several faults has several words.
    rivals: tuple["Issue", ...] = field(default=(), metadata=NOT_STORED)
    #: Changes beside the repair and the gravity above that may mend it: other readings
    #: of the file, a motion to record.
    changes: tuple[Change, ...] = ()

    def __post_init__(self) -> None:
        """Refuse an explanation that is called an error: only facts are errors."""
        if self.nature == EXPLANATION and self.severity == "error":
            raise ValueError(f"{self.kind}: an explanation is never an error")

    @property
    def figures(self) -> dict[str, Any]:
        """The numbers behind the issue by name, for JSON."""
        known = {
            "t": self.at,
            "span": self.span,
            "run": self.run,
            "size": self.size,
            "lost_share": self.lost_share,
            "log_odds": self.log_odds,
            "probability": self.probability,
            "rival_effects": self.rival_effects or None,
        }
        stated = {name: value for name, value in known.items() if value is not None}
        return {"joints": [*self.joints], **stated, **self.numbers}

    @property
    def can_fix(self) -> bool:
        """Whether `check --fix` repairs the issue by itself: it is a fact whose repair is
        safe. So is one of single rows and stamps: a wrong one loses a tenth of the rows at
        most, and shows on motion left out. What changes all values, such as a unit, has a
        word, and is repaired unasked only if it is certain."""
        is_safe = not self.apply or self.certainty.grade == CERTAIN
        return self.nature == FACT and is_safe and self.repair is not None

    @property
    def offers_fix(self) -> bool:
        """Whether `check --fix` is offered: it repairs the issue, and most rows are left."""
        return self.can_fix and self.lost_share is None

    @property
    def is_stood_on(self) -> bool:
        """Whether other facts are as sure as they are on its repaired log: it is certain,
        its cause included, or it is an error, without whose repair nothing can be read."""
        is_sure = self.certainty.grade == CERTAIN and not self.cause
        return is_sure or self.severity == "error"

    @property
    def is_likely(self) -> bool:
        """Whether it is likely or certain; one that is only possible decides nothing."""
        return self.certainty.grade != POSSIBLE

    @property
    def repairs_of_rows(self) -> list[Remedy]:
        """What would mend it in all rows: a change of the log, or the gravity."""
        return [x for x in self.remedies if x.change.verb in ("transform", "mount")]

    @property
    def doubtful_findings(self) -> DoubtfulFindings:
        """Which findings of a diagnosis it makes doubtful: a log has one explanation.

        What a repair of all rows would mend has more evidence than any effect of the arm.
        Another explanation is a rival of the findings on its joints. Friction is none: it
        says that it is another one, and the findings by which law.
        """
        if self.nature != EXPLANATION or not self.is_likely:
            return "none"
        if self.repairs_of_rows:
            return "all"
        is_judged = self.log_odds is not None
        is_rival = is_judged and self.arm_difference != "friction"
        return "on its joints" if is_rival else "none"

    @property
    def may_follow(self) -> bool:
        """Whether it may follow from columns that are read wrongly: a warning about the arm
        that no change of the log, the robot or the reading mends."""
        is_warning = self.severity == "warning" and self.nature == EXPLANATION
        return is_warning and not self.remedies

    @property
    def stays_in_rows(self) -> bool:
        """Whether one run differs from the others by it, and no change of the log undoes
        that."""
        return self.run is not None and self.repair is None

    @property
    def remedies(self) -> tuple[Remedy, ...]:
        """What would mend the issue, the likeliest first, then what would if a rival is
        so; none where no change of the log, the robot or the reading does."""
        changes = list[Change]()
        if self.gravity is not None:
            x, y, z = self.gravity
            words = f"set gravity to ({x:g}, {y:g}, {z:g}) m/s^2"
            changes.append(Change("mount", words, {"gravity": [x, y, z]}))
        if self.offers_fix or (self.apply and not self.can_fix):
            named = self.apply.split() if not self.can_fix else []
            changes.append(Change("transform", self.remedy, {"apply": named}))
        changes += self.changes
        grade, why = self.certainty.grade, self.certainty.why
        own = [
            Remedy(self.what, grade, why, change, probability=self.probability)
            for change in changes
        ]
        sets = [own, *(rival.remedies for rival in self.rivals)]
        return tuple(
            replace(
                x,
                certainty=grade,
                why=why,
                rivals=tuple(
                    y.change for others in sets if others is not one for y in others
                ),
                may_be_the_arm=bool(self.rival_effects),
            )
            for one in sets
            for x in one
        )


def make_issue(
    kind: str,
    what: str,
    *,
    remedy: str,
    needs_action: bool = True,
    joints: Any = None,
    where: str = "",
    cause: str = "",
    figures: Mapping[str, Any] | None = None,
    **fields: Any,
) -> Issue:
    """Make an issue, mostly about some joints, and word it.

    Parameters
    ----------
    kind : str
        As the attribute.
    what : str
        What is wrong, in one sentence; ``{where}`` in it stands for the place.
    remedy : str
        What to do, in one sentence.
    needs_action : bool
        False: nothing has to be done, and ``remedy`` says how it is reckoned with.
    joints : sequence of int
        From 0; None for an issue about no joint.
    where : str
        The place; default: the joints in words.
    cause : str
        What most likely made it so: it is said apart, and is likely at most.
    figures : mapping of str to numbers, optional
        Further numbers behind the issue, for JSON.
    **fields
        Other attributes of the issue.

    Returns
    -------
    Issue
        In words for every screen.
    """
    where = where or joints_text(joints)
    if cause:
        what = f"{what} Likely cause: {cause}."
    if not needs_action:
        remedy = ": ".join(filter(None, ("no action needed", remedy)))
    return Issue(
        kind=kind,
        what=what.replace("{where}", where),
        remedy=remedy,
        needs_action=needs_action,
        joints=() if joints is None else tuple(int(j) + 1 for j in joints),
        where=where,
        cause=cause,
        numbers=figures or {},
        **fields,
    )


def leave_out(run: str) -> Change:
    """Return the change that leaves a run out, by its name."""
    return Change("cut", f"leave {run} out", {"run": run})


#: The same for what a model of the arm says.
make_explanation = partial(make_issue, nature=EXPLANATION)


def make_refusal(
    kind: str,
    error: InputError,
    certainty: Certainty,
    joints: Sequence[int] = (),
    left: Left = Left.ALL,
) -> Issue:
    """Make an error from what identification would refuse; joints from 0."""
    return make_issue(
        kind,
        f"{error.what.rstrip('.')}.",
        severity="error",
        joints=joints or None,
        certainty=certainty,
        remedy=error.remedy,
        where="" if joints else "the run",
        left=left,
    )


def mended_unasked(run: Measurements, issues: Sequence[Issue]) -> Measurements:
    """Return a run as the safe repairs of its facts mend it, in the order in which they
    were found: whether rows, joints' ranges or an arm told them."""
    for issue in issues:
        if issue.can_fix:
            assert issue.repair is not None
            run = issue.repair(run)
    return run


def left_to_judge(issues: Iterable[Issue]) -> Left:
    """Return what is left to be judged beside all of some issues; one that is only
    possible leaves the judgement to the arm."""
    levels = [f.left for f in issues if f.is_likely]
    return min(levels, default=Left.ALL)


def no_surer(issues: Sequence[Issue], others: Sequence[Issue]) -> tuple[Issue, ...]:
    """Return the issues, likely at most where the log without uncertain repairs, which
    has the ``others``, does not show them: no finding is surer than what it stands on."""
    shown = {(issue.kind, issue.where) for issue in others}
    return tuple(
        replace(f, certainty=told_by(f"{f.certainty.why}, in the log as repaired"))
        if f.certainty.grade == CERTAIN and (f.kind, f.where) not in shown
        else f
        for f in issues
    )


def with_rival_effects(issue: Issue, effects: Sequence[str]) -> Issue:
    """Return an explanation that is only possible, because effects of the arm explain
    the same torques; the issue itself where there are none.

    Parameters
    ----------
    effects : sequence of str
        In words, such as "a tilted base".
    """
    if not effects:
        return issue
    return replace(
        issue,
        what=f"{issue.what} It may be instead: {'; '.join(effects)}.",
        certainty=RIVAL_EFFECT,
        equivalents=(*issue.equivalents, *effects),
        rival_effects=tuple(effects),
    )


def rows_text(run: Measurements, places: Any) -> str:
    """Name the rows of ascending samples, from 0, by their numbers in the file: the first
    that follow each other, and how many more there are ("row 12", "rows 12 to 14 and 3
    more")."""
    rows = run.rows_of_file(places)
    n_consecutive = 1
    while n_consecutive < len(rows) and rows[n_consecutive] == rows[0] + n_consecutive:
        n_consecutive += 1
    text = f"row {rows[0]}"
    if n_consecutive > 1:
        text = f"rows {rows[0]} to {rows[n_consecutive - 1]}"
    n_more = len(rows) - n_consecutive
    return f"{text} and {n_more} more" if n_more else text


def gravest_first(issues: Sequence[Issue]) -> tuple[Issue, ...]:
    """Sort issues by severity, errors first; those of one severity keep their order."""
    grave = ("error", "warning", "note").index
    return tuple(sorted(issues, key=lambda issue: grave(issue.severity)))
