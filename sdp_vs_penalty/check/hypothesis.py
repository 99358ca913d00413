"""A hypothesis about what is wrong with a file, and how it is judged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.check.issue import Issue, Repair
from sdp_vs_penalty.check.physics import Physics

#: Of hypotheses that explain about the same, the simpler one is believed.
ABOUT_SAME = 1.5
#: A hypothesis has to leave less than this share of what is unexplained without it: an effect that a
#: model misses explains far less.
BETTER = 0.5
#: Standard deviations by which a power must be negative to call it a flipped sign.
SIGNIFICANT = 5.0
#: Rows for hypotheses that need new columns each.
_FEW_ROWS = 250


@dataclass(frozen=True)
class Hypothesis:
    """Something that may be wrong with the file; ``apply`` turns the test's data into what is right."""

    issue: Issue
    apply: Callable[[Physics], Physics]
    simplicity: int


def propose(
    physics: Physics,
    apply: Callable[[Physics], Physics],
    simplicity: int,
    texts: tuple[str, str, str, str],
    repair: Repair | None,
    gravity: tuple[float, float, float] | None = None,
    **figures: object,
) -> Hypothesis:
    kind, where, what, remedy = texts
    before, after = physics.unexplained, apply(physics).unexplained
    figures |= {"unexplained_before": before, "unexplained_after": after}
    sure = _certainty(before, after)
    issue = Issue(kind, "error", where, what, sure, remedy, repair, figures, gravity)
    return Hypothesis(issue, apply, simplicity)


def _certainty(before: float, after: float) -> str:
    word = "certain" if after < 0.1 * before else "likely"
    return (
        f"{word}: the torque that the arm's dynamics leave unexplained falls from "
        f"{100.0 * np.sqrt(before):.3g} % to {100.0 * np.sqrt(after):.3g} %"
    )


def few_rows(physics: Physics) -> NDArray[np.intp]:
    count = len(physics.motion.t)
    return np.unique(np.linspace(0, count - 1, min(count, _FEW_ROWS)).astype(np.intp))
