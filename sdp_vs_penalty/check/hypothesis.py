"""A hypothesis about what is wrong with a file, and how it is judged."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check import beyond
from sdp_vs_penalty.check.evidence import PARTS, Evidence, in_parts, solve, without_each
from sdp_vs_penalty.check.issue import Issue, Repair
from sdp_vs_penalty.check.physics import OVERSAMPLING, Physics, settled
from sdp_vs_penalty.robot.arrays import Array

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
#: the file says, or so many beyond what is usual; then it is worth a warning from this gain on, too.
SIGMAS, BEYOND, LEAST = 8.0, 4.0, 0.15
#: Steps to either side, as a share of the number and at most.
_STEP, _LARGEST_STEP = 0.3, 0.05
#: A minimum is refined to this share of the number.
_FINE, _GOLDEN = 0.03, 0.382


@dataclass(frozen=True)
class Number:
    """An estimated number, zero where the file is right; ``at(x)`` applies another one.

    tolerance : what arms and loggers differ by themselves, of the number's own unit; least : gain of the
    score from which on it is worth a warning; where : the data that tell of it.
    """

    value: float
    at: Callable[[float], Callable[[Physics], Physics]]
    tolerance: float = np.inf
    least: float = LEAST
    where: Callable[[Physics], Physics] = lambda physics: physics

    def fitted(self, physics: Physics, grid: Iterable[float], steps: int = 8) -> Number:
        """The same with the value that leaves least unexplained, found from a grid."""
        return all_fitted([self], physics, grid, steps)[0]

    def determined(self, physics: Physics) -> bool:
        """Whether it is certainly not zero, or certainly more than is usual."""
        deviation, size = self.deviation(physics), abs(self.value)
        return bool(size > SIGMAS * deviation or size - self.tolerance > BEYOND * deviation)

    def deviation(self, physics: Physics) -> float:
        """Its standard deviation: that of leaving out parts of the run.

        What the model lacks makes a number wrong by as much as it varies from part to part; the noise
        alone, of which there is little in thousands of rows, would make it look exact. To first order
        the number is one column more beside the arm's, -dr/dx of the residual r = C - Y theta; where
        it scales a channel C, its column is made of Y theta, whose noise would else tell of a gain
        (errors in variables). Leaving out parts in turn (a delete-a-group jackknife) moves its size.
        """
        return self._deviation(*self._tangent(self.where(physics)))

    @staticmethod
    def _deviation(here: Physics, wide: list[Array], weights: Array) -> float:
        parts = in_parts(wide, here.counted)
        found = np.array([e.weighted(weights)[-1] for e in without_each(parts)])
        left_out = (PARTS - 1) / PARTS * np.sum((found - found.mean()) ** 2)
        # Where nothing tells of the number, each part says zero alike: the noise's share speaks then.
        gram = np.tensordot(weights, sum(e.gram for e in parts), 1)
        noise = solve(gram, np.eye(len(gram))[:, -1:])[-1, 0] * OVERSAMPLING / len(here.channels)
        return float(np.sqrt(left_out + max(noise, 0.0)))

    def smallest(self, physics: Physics) -> float:
        """The size from which on it would be named in such a motion, inf where nothing tells of it.

        To first order: an x raises the residual of joint j from r_j to r_j + x^2 d_j, d_j what the arm's
        columns leave of the number's own.
        """
        here, wide, weights = self._tangent(self.where(physics))
        evidence = Evidence.of(wide, here.counted)
        gram = np.tensordot(weights, evidence.gram, 1)
        left = np.append(-solve(gram[:-1, :-1], gram[:-1, -1:])[:, 0], 1.0)
        ratio = np.maximum(evidence.gram @ left @ left, 0.0) * weights
        sizes = np.geomspace(1e-3, 10.0, 200)
        enough = np.log1p(np.outer(sizes**2, ratio)).sum(axis=1) > self.least
        deviation = self._deviation(here, wide, weights)
        known = min(SIGMAS * deviation, self.tolerance + BEYOND * deviation)
        return max(float(sizes[np.argmax(enough)]), known) if enough.any() else np.inf

    def _tangent(self, physics: Physics) -> tuple[Physics, list[Array], Array]:
        """The data with the number as it is; each joint's columns, the number's last; weights."""
        h = min(_STEP * abs(self.value) or np.inf, _LARGEST_STEP)
        low, high = (self.at(self.value + x)(physics) for x in (-h, h))
        here = self.at(self.value)(physics) if self.value else physics
        theta = here.evidence.theta
        change, said = high.counted - low.counted, here.counted
        scaled = np.sum(change * said, axis=0) / np.sum(said**2 + 1e-300, axis=0)
        change = change - scaled * said
        wide = [
            np.column_stack([c, ((a - b - k * c) @ theta - x) / (2.0 * h)])
            for c, a, b, k, x in zip(
                here.columns, high.columns, low.columns, scaled, change.T, strict=True
            )
        ]
        return here, wide, 1.0 / (here.evidence.shares * here.evidence.energy)


def all_fitted(
    numbers: Sequence[Number], physics: Physics, grid: Iterable[float], steps: int = 8
) -> list[Number]:
    """Several numbers, each by itself, with the values that leave least unexplained."""
    if not numbers:
        return []
    told = numbers[0].where(physics)

    def misfits(asked: list[tuple[int, float]]) -> list[float]:
        return [e.misfit for e in settled(numbers[k].at(x)(told) for k, x in asked)]

    found = best_numbers(misfits, [list(grid)] * len(numbers), steps)
    return [replace(number, value=x) for number, x in zip(numbers, found, strict=True)]


@dataclass(frozen=True)
class Hypothesis:
    """Something that may be wrong with the file; ``apply`` turns the test's data into what is right.

    needed : gain of the score below which it is not believed; once : it happens at one moment, or grows,
    and need not show in both halves of a run, but where its joint slides; gross : no arm is like that by
    itself; number : what was estimated, where it is one.
    """

    issue: Issue
    apply: Callable[[Physics], Physics]
    simplicity: int
    needed: float = ENOUGH
    once: bool = False
    gross: bool = False
    number: Number | None = None

    def where(self, physics: Physics) -> Physics:
        """The data that tell of it. Where a joint rests, dry friction holds any torque between two
        limits, another one at every stop: what happens once has to show where it slides."""
        if self.number is not None:
            return self.number.where(physics)
        return physics.sliding if self.once else physics

    def gain(self, physics: Physics) -> float:
        """By how much it raises the score."""
        told = self.where(physics)
        return told.evidence.score - self.apply(told).evidence.score

    def needed_for(self, physics: Physics) -> float:
        """The gain of the score below which it is not believed of these data."""
        if self.gross:
            return min(self.needed, GROSS)
        if self.issue.severity != "error":
            return self.needed
        left = self.apply(physics).evidence.contradiction
        return GROSS if left < _SETTLED * physics.evidence.contradiction else self.needed

    def determined(self, physics: Physics) -> bool:
        """Whether its number is certainly not what the file says; True where it has none.

        What laws of friction or a coupled wrist explain as well is the model's matter, and no fault of
        the file: beside them half of the gain has to remain, or enough by itself.
        """
        if self.number is None or not self.number.determined(physics):
            return self.number is None
        rival = beyond.rival(physics)
        return self.gain(rival) > min(HALF * self.gain(physics), ENOUGH)

    def pays(self, physics: Physics, gain: float) -> bool:
        """Whether it explains parts of the run that the arm was not fitted to, nearly all of them.

        What happens once need not show everywhere, but in most of them; nor need a number that no arm
        has by itself, which has to be the same all over the run (see :class:`Number`).
        """
        # Rows at rest say nothing against what happens once, or no arm has; a small number holds there.
        large = self.number is not None and abs(self.number.value) > 2.0 * self.number.tolerance
        least = _MOST if self.once or large else NEARLY_ALL
        told = [self.where(physics)] if self.once or large else [physics, self.where(physics)]
        for p in told:
            each = np.log(p.left_out / self.apply(p).left_out).sum(axis=1)
            if np.mean(each) <= HALF * min(gain, 3.0) or np.sum(each > 0.0) < least:
                return False
        return True

    def stated(self, physics: Physics) -> Issue:
        """The issue, with what the hypothesis explains of these data."""
        if self.issue.certainty:
            return self.issue
        told = self.where(physics)
        before, after = (p.evidence.shares for p in (told, self.apply(told)))
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
    apply: Callable[[Physics], Physics] | Number,
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
    """A hypothesis: a transformation of the data, or a number that is one at its value, what is said of
    it (kind, place, sentence, remedy), and what repairs the file."""
    if isinstance(apply, Number):
        number, apply = apply, apply.at(apply.value)
    kind, where, what, remedy = texts
    issue = Issue(kind, severity, where, what, certainty, remedy, repair, figures, gravity)
    return Hypothesis(issue, apply, simplicity, needed, once, gross, number)


def few_rows(physics: Physics) -> NDArray[np.intp]:
    count = len(physics.motion.t)
    return np.unique(np.linspace(0, count - 1, min(count, _FEW_ROWS)).astype(np.intp))


def best_numbers(
    scores: Callable[[list[tuple[int, float]]], Sequence[float]],
    grids: Sequence[Sequence[float]],
    steps: int = 8,
) -> list[float]:
    """The numbers with the lowest score, each the best of its grid, refined by parabolas around it.

    scores : of (which number, value), as many as are asked for at once: the searches go side by side.
    """
    searches = [_search(grid, steps) for grid in grids]
    asked = {k: next(search) for k, search in enumerate(searches)}
    found = [0.0] * len(grids)
    while asked:
        flat = [(k, x) for k, wanted in asked.items() for x in wanted]
        answers, going = iter(scores(flat)), {}
        for k, wanted in asked.items():
            try:
                going[k] = searches[k].send([next(answers) for _ in wanted])
            except StopIteration as end:
                found[k] = end.value
        asked = going
    return found


def _search(grid: Sequence[float], steps: int) -> Generator[list[float], list[float], float]:
    """Asks for scores of numbers, and returns the best.

    A logarithm of squares is sharp at its minimum; where a parabola lands beside it the longer side
    is cut by the golden section.
    """
    known = dict(zip(grid, (yield list(grid)), strict=True))
    width = np.inf
    for _ in range(steps):
        places = sorted(known)
        k = min(range(1, len(places) - 1), key=lambda i: known[places[i]])
        a, b, c = places[k - 1 : k + 2]
        if c - a < _FINE * max(abs(b), _FINE):
            break
        left, right = (known[b] - known[a]) / (b - a), (known[c] - known[b]) / (c - b)
        at = 0.5 * (a + b) - 0.5 * left * (c - a) / max(right - left, 1e-300)
        if c - a > 0.5 * width or not a + 0.02 * (c - a) < at < c - 0.02 * (c - a):
            at = b + _GOLDEN * (c - b if c - b > b - a else a - b)
        width = c - a
        if min(abs(at - x) for x in (a, b, c)) < 1e-3 * (c - a):
            break
        (known[at],) = yield [at]
    return min(known, key=lambda x: known[x])
