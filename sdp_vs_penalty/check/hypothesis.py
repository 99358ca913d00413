"""A hypothesis about what is wrong with a file, and how it is judged."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check.evidence import PARTS, in_parts, without_each
from sdp_vs_penalty.check.issue import Issue, Repair
from sdp_vs_penalty.check.physics import Physics

#: A hypothesis has to raise the score (see evidence.py) by so much: the residual of one joint, or of
#: several together, to an e-th of its energy. On clean logs, where each only trades one small error of
#: the model for another, the best of all of them gains a few tenths.
ENOUGH = 1.1
#: ... and by so much where it is grosser than an arm's own imperfections (a gain of 2, a clock at half
#: its rate), or where it settles most of what the joints say against each other.
GROSS = 0.5
#: Share of the joints' contradiction (see evidence.py) that may be left then.
_SETTLED = 0.35
#: Of hypotheses that gain about the same (this much, and this share of the gain), the simpler one.
ABOUT_SAME = (0.4, 0.07)
#: Left out of the fit, the parts of the run have to show this share of the gain in the mean, and so many
#: of the eight have to speak for it.
HALF, NEARLY_ALL, _MOST = 0.5, 7, 5
#: Of signs that leave about the same, physics chooses.
NEAR = 1.5
#: Standard deviations by which a power must be negative to call it a flipped sign.
SIGNIFICANT = 5.0
#: Correlation of the torque with a plausible arm's weight from which on weight has a sign; below minus
#: this it acts upwards.
AGREES = 0.5
#: Rows for hypotheses that need new columns each.
_FEW_ROWS = 200
#: A number (a gain, a zero, a clock's rate) is known where it lies so many standard deviations from what
#: the file says; then it is worth a warning from this gain on, too.
SIGMAS, LEAST = 8.0, 0.15
#: Steps to either side, as a share of the number.
_STEP = 0.3


@dataclass(frozen=True)
class Number:
    """An estimated number, zero where the file is right; ``at(x)`` applies another one."""

    value: float
    at: Callable[[float], Callable[[Physics], Physics]]

    def sigmas(self, physics: Physics) -> float:
        """How many standard deviations it lies from zero: those of leaving out parts of the run.

        What the model lacks makes a number wrong by as much as it varies from part to part; the noise
        alone, of which there is little in thousands of rows, would make it look exact. Leaving out
        parts in turn (delete-a-group jackknife) moves the minimum of the score, near which it is a
        parabola.
        """
        h = _STEP * self.value
        points = self.value + h * np.array([-1.0, 0.0, 1.0])
        tried = [self.at(float(x))(physics) for x in points]
        scores = np.array(
            [[e.score for e in without_each(in_parts(p.columns, p.channels))] for p in tried]
        )
        bend = scores[0] - 2.0 * scores[1] + scores[2]
        if np.any(bend <= 0.0):
            return 0.0
        found = self.value + 0.5 * h * (scores[0] - scores[2]) / bend
        spread = np.sqrt((PARTS - 1) / PARTS * np.sum((found - found.mean()) ** 2))
        return float(abs(found.mean()) / max(float(spread), 1e-300))


@dataclass(frozen=True)
class Hypothesis:
    """Something that may be wrong with the file; ``apply`` turns the test's data into what is right.

    needed : gain of the score below which it is not believed; once : it happens at one moment, or grows,
    and need not show in both halves of a run; gross : no arm is like that by itself; number : what was
    estimated, where it is one.
    """

    issue: Issue
    apply: Callable[[Physics], Physics]
    simplicity: int
    needed: float = ENOUGH
    once: bool = False
    gross: bool = False
    number: Number | None = None

    def gain(self, physics: Physics) -> float:
        """By how much it raises the score."""
        return physics.evidence.score - self.apply(physics).evidence.score

    def needed_for(self, physics: Physics) -> float:
        """The gain of the score below which it is not believed of these data."""
        if self.gross:
            return min(self.needed, GROSS)
        if self.issue.severity != "error":
            return self.needed
        left = self.apply(physics).evidence.contradiction
        return GROSS if left < _SETTLED * physics.evidence.contradiction else self.needed

    def determined(self, physics: Physics) -> bool:
        """Whether its number is certainly not what the file says; True where it has none."""
        return self.number is None or self.number.sigmas(physics) > SIGMAS

    def pays(self, physics: Physics, gain: float) -> bool:
        """Whether it explains parts of the run that the arm was not fitted to, nearly all of them.

        What happens once need not show everywhere, but in most of them.
        """
        before, after = physics.left_out, self.apply(physics).left_out
        each = np.log(before / after).sum(axis=1)
        least = _MOST if self.once else NEARLY_ALL
        return bool(np.mean(each) > HALF * min(gain, 3.0) and np.sum(each > 0.0) >= least)

    def stated(self, physics: Physics) -> Issue:
        """The issue, with what the hypothesis explains of these data."""
        if self.issue.certainty:
            return self.issue
        before, after = (p.evidence.shares for p in (physics, self.apply(physics)))
        change = np.log(before / after)
        j = int(np.argmax(change))
        word = "certain" if change[j] > np.log(10.0) else "likely"
        sure = (
            f"{word}: what the arm's dynamics leave unexplained of joint {j + 1}'s torque falls from "
            f"{100.0 * np.sqrt(before[j]):.3g} % to {100.0 * np.sqrt(after[j]):.3g} %"
        )
        figures = dict(self.issue.figures)
        figures |= {"unexplained_before": before.tolist(), "unexplained_after": after.tolist()}
        return replace(self.issue, certainty=sure, figures=figures)


def propose(
    apply: Callable[[Physics], Physics],
    simplicity: int,
    texts: tuple[str, str, str, str],
    repair: Repair | None,
    *,
    severity: str = "error",
    needed: float = ENOUGH,
    once: bool = False,
    gross: bool = False,
    number: Number | None = None,
    gravity: tuple[float, float, float] | None = None,
    certainty: str = "",
    **figures: object,
) -> Hypothesis:
    kind, where, what, remedy = texts
    issue = Issue(kind, severity, where, what, certainty, remedy, repair, figures, gravity)
    return Hypothesis(issue, apply, simplicity, needed, once, gross, number)


def few_rows(physics: Physics) -> NDArray[np.intp]:
    count = len(physics.motion.t)
    return np.unique(np.linspace(0, count - 1, min(count, _FEW_ROWS)).astype(np.intp))


def best_number(score: Callable[[float], float], grid: Iterable[float], steps: int = 3) -> float:
    """The number with the lowest score: the best of a grid, refined by parabolas around it."""
    known = {x: score(x) for x in grid}
    for _ in range(steps):
        places = sorted(known)
        k = min(range(1, len(places) - 1), key=lambda i: known[places[i]])
        a, b, c = places[k - 1 : k + 2]
        left, right = (known[b] - known[a]) / (b - a), (known[c] - known[b]) / (c - b)
        if right <= left:
            break
        at = 0.5 * (a + b) - 0.5 * left * (c - a) / (right - left)
        at = min(max(at, a + 0.05 * (b - a)), c - 0.05 * (c - b))
        if min(abs(at - x) for x in (a, b, c)) < 1e-3 * (c - a):
            break
        known[at] = score(at)
    return min(known, key=lambda x: known[x])
